//! The settings: which exist, their ranges, and which may change while the machine runs.
//!
//! A combination of mode bits without a meaning is refused, not ignored: a machine with accidental
//! settings makes accidental moves.

use crate::cores::Setting;
use wire::Refusal;
use wire::channels::WORD_PINS;
use wire::describe::Channels;
use wire::exchange::PWM_PERIOD_MAX;
use wire::map::{
    self, BoardConfig, CountMode, DEBOUNCE_MAX, DIR_CLOCKS_MAX, ENCODER_FILTER_MAX, PROBE_ENABLE,
    PROBE_INPUT_MASK, PROBE_INVERT, STEP_CLOCKS_MAX, StepType, StepgenConfig, WATCHDOG_SECONDS_MAX,
};
use wire::regmap::{IN_MAX, encoder, pwm, stepgen};

/// Step and direction inversion, step type, index inversion.
const STEPGEN_MODE_BITS: u32 = map::STEPGEN_STEP_INVERT
    | map::STEPGEN_DIR_INVERT
    | stepgen::MODE_KIND
    | map::STEPGEN_INDEX_INVERT;
/// Inversion, type, dither, swapped pins.
const PWM_MODE_BITS: u32 = map::PWM_INVERT | pwm::MODE_KIND | map::PWM_DITHER | map::PWM_SWAP;
/// Counting mode, index and mask polarity, mask, clear on index.
const ENCODER_MODE_BITS: u32 = encoder::MODE_SELECT
    | map::ENCODER_INDEX_INVERT
    | map::ENCODER_MASK_ENABLE
    | map::ENCODER_MASK_INVERT
    | map::ENCODER_CLEAR_ON_INDEX;
/// The input's number, whether it is used, and its polarity.
const PROBE_BITS: u32 = PROBE_INPUT_MASK | PROBE_ENABLE | PROBE_INVERT;
/// A type field of two bits with three meanings.
const NO_TYPE: u32 = 3;
/// 0.1 ms: a tenth of the shortest servo period in use. A shorter timeout could only bite by
/// accident.
const TIMEOUT_MIN_PER_SECOND: u32 = 10_000;

/// Where each kind of setting begins in the window; the kinds with channels are as long as each
/// other.
const PWMS: u32 = map::CONFIG_PWM - map::CONFIG;
const ENCODERS: u32 = map::CONFIG_ENCODER - map::CONFIG;
const BOARD: u32 = map::CONFIG_BOARD - map::CONFIG;
const BOARD_END: u32 = BOARD + 4 * map::BOARD_CONFIG_WORDS;
const KIND: u32 = map::CONFIG_PWM - map::CONFIG_STEPGEN;
const DEBOUNCE: u32 = map::CONFIG_DEBOUNCE - map::CONFIG;
const DEBOUNCE_END: u32 = DEBOUNCE + 4 * IN_MAX as u32;

/// The setting at this byte address of the config window, if this board has it.
#[inline(never)]
pub fn setting_at(address: u32, channels: Channels) -> Option<Setting> {
    let offset = address.checked_sub(map::CONFIG)?;
    let channel = (offset % KIND / map::CONFIG_STRIDE) as u8;
    let word = offset % map::CONFIG_STRIDE / 4;
    let setting = match offset {
        0..PWMS if channel < channels.stepgens => {
            let field = match word {
                0 => StepgenConfig::Steplen,
                1 => StepgenConfig::Stepspace,
                2 => StepgenConfig::Dirsetup,
                3 => StepgenConfig::Dirhold,
                4 => StepgenConfig::StopAccel,
                5 => StepgenConfig::Mode,
                _ => return None,
            };
            Setting::Stepgen(channel, field)
        }
        PWMS..ENCODERS if channel < channels.pwms => match word {
            0 => Setting::PwmPeriod(channel),
            1 => Setting::PwmMode(channel),
            _ => return None,
        },
        ENCODERS..BOARD if channel < channels.encoders => match word {
            0 => Setting::EncoderMode(channel),
            1 => Setting::EncoderFilter(channel),
            _ => return None,
        },
        BOARD..BOARD_END => Setting::Board(match word {
            0 => BoardConfig::WatchdogTimeout,
            1 => BoardConfig::WatchdogGrace,
            2 => BoardConfig::GpioSafe,
            3 => BoardConfig::GpioInvert,
            5 if channels.outputs_high() != 0 => BoardConfig::GpioSafeHigh,
            6 if channels.outputs_high() != 0 => BoardConfig::GpioInvertHigh,
            5.. => return None,
            _ => BoardConfig::Probe,
        }),
        DEBOUNCE..DEBOUNCE_END => {
            let input = ((offset - DEBOUNCE) / 4) as u8;
            if input >= channels.inputs {
                return None;
            }
            Setting::Debounce(input)
        }
        _ => return None,
    };
    Some(setting)
}

/// May this setting change while the machine is armed? A PWM's period takes effect at the end of
/// a period and moves nothing; everything else changes what a pulse or a level means.
pub const fn live_safe(setting: Setting) -> bool {
    match setting {
        Setting::PwmPeriod(_) => true,
        Setting::Stepgen(_, _)
        | Setting::PwmMode(_)
        | Setting::EncoderMode(_)
        | Setting::EncoderFilter(_)
        | Setting::Debounce(_)
        | Setting::Board(_) => false,
    }
}

/// Is `value` in this setting's range on this board?
#[inline(never)]
pub fn check(
    setting: Setting,
    value: u32,
    channels: Channels,
    clock_hz: u32,
) -> Result<(), Refusal> {
    let clocks = |most: u64| 0..=u32::try_from(most).unwrap_or(u32::MAX);
    let range = match setting {
        Setting::Stepgen(_, StepgenConfig::Steplen | StepgenConfig::Stepspace) => {
            1..=STEP_CLOCKS_MAX
        }
        Setting::Stepgen(_, StepgenConfig::Dirsetup | StepgenConfig::Dirhold) => 0..=DIR_CLOCKS_MAX,
        Setting::Stepgen(_, StepgenConfig::StopAccel) => 0..=u32::MAX,
        Setting::Stepgen(_, StepgenConfig::Mode) => {
            let kind = value >> map::STEPGEN_TYPE_SHIFT & 3;
            return allow(value & !STEPGEN_MODE_BITS == 0 && kind != NO_TYPE);
        }
        Setting::PwmPeriod(_) => 0..=PWM_PERIOD_MAX,
        Setting::PwmMode(_) => {
            let kind = value >> map::PWM_TYPE_SHIFT & 3;
            return allow(value & !PWM_MODE_BITS == 0 && kind != NO_TYPE);
        }
        Setting::EncoderMode(_) => {
            let counting = CountMode::from_code(value & encoder::MODE_SELECT).is_some();
            return allow(value & !ENCODER_MODE_BITS == 0 && counting);
        }
        Setting::EncoderFilter(_) => 0..=ENCODER_FILTER_MAX,
        Setting::Debounce(_) => 0..=DEBOUNCE_MAX,
        Setting::Board(BoardConfig::Probe) => {
            let there = value & PROBE_INPUT_MASK < u32::from(channels.inputs);
            return allow(value & !PROBE_BITS == 0 && (there || value & PROBE_ENABLE == 0));
        }
        Setting::Board(BoardConfig::WatchdogTimeout) => {
            let most = clocks(WATCHDOG_SECONDS_MAX * u64::from(clock_hz));
            clock_hz / TIMEOUT_MIN_PER_SECOND..=*most.end()
        }
        Setting::Board(BoardConfig::WatchdogGrace) => {
            clocks(WATCHDOG_SECONDS_MAX * u64::from(clock_hz))
        }
        Setting::Board(BoardConfig::GpioSafe | BoardConfig::GpioInvert) => {
            0..=mask(channels.outputs.min(WORD_PINS))
        }
        Setting::Board(BoardConfig::GpioSafeHigh | BoardConfig::GpioInvertHigh) => {
            0..=mask(channels.outputs.saturating_sub(WORD_PINS))
        }
    };
    allow(range.contains(&value))
}

const fn allow(yes: bool) -> Result<(), Refusal> {
    if yes { Ok(()) } else { Err(Refusal::Value) }
}

const _: () = assert!(StepType::from_code(NO_TYPE).is_none());

/// The lowest `count` bits.
fn mask(count: u8) -> u32 {
    1u32.checked_shl(u32::from(count))
        .unwrap_or(0)
        .wrapping_sub(1)
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIX: Channels = Channels {
        stepgens: 6,
        encoders: 6,
        pwms: 6,
        inputs: 12,
        outputs: 12,
    };
    const CLOCK: u32 = 60_000_000;

    fn ok(setting: Setting, value: u32) -> bool {
        check(setting, value, SIX, CLOCK).is_ok()
    }

    #[test]
    fn every_address_of_the_window_is_one_setting_or_none() {
        let mut found = Vec::new();
        for address in (map::CONFIG..map::CONFIG + map::CONFIG_LEN).step_by(4) {
            if let Some(setting) = setting_at(address, SIX) {
                assert!(!found.contains(&setting), "{setting:?} twice");
                found.push(setting);
            }
        }
        assert_eq!(found.len(), 6 * 6 + 6 * 2 + 6 * 2 + 5 + 12);
        let behind = map::CONFIG + map::CONFIG_LEN;
        for address in (behind..map::COMMAND).step_by(4).chain([0]) {
            assert_eq!(setting_at(address, SIX), None, "{address:#x}");
        }
    }

    #[test]
    fn a_channel_the_board_does_not_have_has_no_settings() {
        let seventh = map::CONFIG_STEPGEN + 6 * map::CONFIG_STRIDE;
        assert_eq!(setting_at(seventh, SIX), None);
        assert_eq!(
            setting_at(map::CONFIG_PWM + 6 * map::CONFIG_STRIDE, SIX),
            None
        );
        assert_eq!(
            setting_at(map::CONFIG_ENCODER + 6 * map::CONFIG_STRIDE, SIX),
            None
        );
    }

    #[test]
    fn timings_are_refused_beyond_what_the_gateware_can_count() {
        for field in [StepgenConfig::Steplen, StepgenConfig::Stepspace] {
            let setting = Setting::Stepgen(0, field);
            assert!(!ok(setting, 0) && ok(setting, 1) && ok(setting, 8191) && !ok(setting, 8192));
        }
        for field in [StepgenConfig::Dirsetup, StepgenConfig::Dirhold] {
            let setting = Setting::Stepgen(0, field);
            assert!(ok(setting, 0) && ok(setting, 65_535) && !ok(setting, 65_536));
        }
        let period = Setting::PwmPeriod(0);
        assert!(ok(period, 0x1f_ffff) && !ok(period, 0x20_0000));
        let debounce = Setting::Debounce(0);
        assert!(ok(debounce, 0) && ok(debounce, 65_535) && !ok(debounce, 65_536));
        assert!(ok(Setting::EncoderFilter(0), 255) && !ok(Setting::EncoderFilter(0), 256));
    }

    #[test]
    fn a_mode_is_refused_unless_every_bit_of_it_means_something() {
        for value in (0..0x400).chain([1 << 10, 1 << 31, u32::MAX]) {
            let (kind, counting) = (value >> 2 & 3, value & 7);
            let stepgen = Setting::Stepgen(0, StepgenConfig::Mode);
            assert_eq!(ok(stepgen, value), value < 32 && kind != 3, "{value:#x}");
            let kind = value >> 1 & 3;
            let pwm = Setting::PwmMode(0);
            assert_eq!(ok(pwm, value), value < 32 && kind != 3, "{value:#x}");
            let encoder = Setting::EncoderMode(0);
            let meant = value < 256 && counting < 6 && value & 8 == 0;
            assert_eq!(ok(encoder, value), meant, "{value:#x}");
        }
    }

    #[test]
    fn the_probe_is_an_input_the_board_has_or_none() {
        let probe = Setting::Board(BoardConfig::Probe);
        for input in 0..64 {
            assert!(ok(probe, input), "disabled, with any input");
            assert_eq!(ok(probe, input | PROBE_ENABLE), input < 12, "{input}");
            assert_eq!(ok(probe, input | PROBE_ENABLE | PROBE_INVERT), input < 12);
        }
        assert!(!ok(probe, 1 << 6) && !ok(probe, 1 << 10) && !ok(probe, 1 << 31));
    }

    #[test]
    fn every_input_has_its_own_debounce() {
        let setting = |input: u32| setting_at(map::CONFIG_DEBOUNCE + 4 * input, SIX);
        assert_eq!(setting(0), Some(Setting::Debounce(0)));
        assert_eq!(setting(11), Some(Setting::Debounce(11)));
        assert_eq!(setting(12), None, "an input the board does not have");
        let all = Channels { inputs: 32, ..SIX };
        let last = setting_at(map::CONFIG_DEBOUNCE + 4 * 31, all);
        assert_eq!(last, Some(Setting::Debounce(31)));
        assert_eq!(setting_at(map::CONFIG_DEBOUNCE + 4 * 32, all), None);
    }

    #[test]
    fn a_watchdog_can_neither_be_configured_away_nor_bite_within_a_servo_period() {
        let timeout = Setting::Board(BoardConfig::WatchdogTimeout);
        assert!(!ok(timeout, 0) && !ok(timeout, 5_999) && ok(timeout, 6_000));
        assert!(ok(timeout, 600_000_000) && !ok(timeout, 600_000_001));
    }

    #[test]
    fn a_grace_may_be_none_and_no_longer_than_a_timeout() {
        let grace = Setting::Board(BoardConfig::WatchdogGrace);
        assert!(ok(grace, 0) && ok(grace, 600_000_000) && !ok(grace, 600_000_001));
    }

    #[test]
    fn outputs_the_board_does_not_have_cannot_be_configured() {
        let safe = Setting::Board(BoardConfig::GpioSafe);
        assert!(ok(safe, 0xfff) && !ok(safe, 0x1000));
        let all = Channels { outputs: 32, ..SIX };
        assert!(check(safe, u32::MAX, all, CLOCK).is_ok());
    }

    #[test]
    fn outputs_behind_the_first_32_have_settings_of_their_own() {
        let at = |word: u32| map::CONFIG_BOARD + 4 * word;
        let high = |outputs| [5, 6].map(|word| setting_at(at(word), Channels { outputs, ..SIX }));
        assert_eq!(high(32), [None, None]);
        let there = [BoardConfig::GpioSafeHigh, BoardConfig::GpioInvertHigh].map(Setting::Board);
        assert_eq!(high(33), there.map(Some));
        assert_eq!(setting_at(at(7), Channels { outputs: 64, ..SIX }), None);
        for setting in there {
            let with = |outputs, value| {
                let channels = Channels { outputs, ..SIX };
                check(setting, value, channels, CLOCK).is_ok()
            };
            assert!(with(33, 1) && !with(33, 2) && with(64, u32::MAX));
        }
        // All of the first word, as before.
        let safe = Setting::Board(BoardConfig::GpioSafe);
        let channels = Channels { outputs: 64, ..SIX };
        assert!(check(safe, u32::MAX, channels, CLOCK).is_ok());
    }

    #[test]
    fn only_the_pwm_period_may_change_under_way() {
        let live: Vec<_> = (map::CONFIG..map::CONFIG + map::CONFIG_LEN)
            .step_by(4)
            .filter_map(|address| setting_at(address, SIX))
            .filter(|setting| live_safe(*setting))
            .collect();
        assert_eq!(live, (0..6).map(Setting::PwmPeriod).collect::<Vec<_>>());
    }
}
