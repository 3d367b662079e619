//! Which settings exist, what they may be, and which may change under a running machine.

use crate::cores::Setting;
use wire::Refusal;
use wire::describe::Channels;
use wire::map::{self, BoardConfig, StepgenConfig};

/// Gateware width of the two step timings.
const STEP_CLOCKS_MAX: u32 = (1 << 16) - 1;
/// Gateware width of the two direction timings and of a PWM period.
const LONG_CLOCKS_MAX: u32 = (1 << 24) - 1;
/// 0.1 ms: a tenth of the shortest servo period anybody runs. Shorter only ever bites by accident.
const TIMEOUT_MIN_PER_SECOND: u32 = 10_000;
/// 10 s: longer is no watchdog.
const TIMEOUT_MAX_SECONDS: u64 = 10;

/// The setting at this byte address of the config window, if this board has it.
#[inline(never)]
pub fn setting_at(address: u32, channels: Channels) -> Option<Setting> {
    let offset = address.checked_sub(map::CONFIG)?;
    let channel = (offset % 0x400 / map::CONFIG_STRIDE) as u8;
    let word = offset % map::CONFIG_STRIDE / 4;
    let setting = match offset {
        0..0x400 if channel < channels.stepgens => {
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
        0x400..0x800 if channel < channels.pwms => match word {
            0 => Setting::PwmPeriod(channel),
            1 => Setting::PwmMode(channel),
            _ => return None,
        },
        0x800..0xc00 if channel < channels.encoders => match word {
            0 => Setting::EncoderMode(channel),
            1 => Setting::EncoderFilter(channel),
            _ => return None,
        },
        0xc00..0xc10 => Setting::Board(match word {
            0 => BoardConfig::WatchdogTimeout,
            1 => BoardConfig::WatchdogGrace,
            2 => BoardConfig::GpioSafe,
            _ => BoardConfig::GpioInvert,
        }),
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
        | Setting::Board(_) => false,
    }
}

/// Is `value` one this setting can have on this board?
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
        Setting::Stepgen(_, StepgenConfig::Dirsetup | StepgenConfig::Dirhold) => {
            0..=LONG_CLOCKS_MAX
        }
        Setting::Stepgen(_, StepgenConfig::StopAccel) => 0..=u32::MAX,
        Setting::Stepgen(_, StepgenConfig::Mode) => 0..=3,
        Setting::PwmPeriod(_) => 0..=LONG_CLOCKS_MAX,
        Setting::PwmMode(_) => 0..=1,
        Setting::EncoderMode(_) => 0..=0,
        Setting::EncoderFilter(_) => 0..=255,
        Setting::Board(BoardConfig::WatchdogTimeout) => {
            let most = clocks(TIMEOUT_MAX_SECONDS * u64::from(clock_hz));
            clock_hz / TIMEOUT_MIN_PER_SECOND..=*most.end()
        }
        Setting::Board(BoardConfig::WatchdogGrace) => {
            clocks(TIMEOUT_MAX_SECONDS * u64::from(clock_hz))
        }
        Setting::Board(BoardConfig::GpioSafe | BoardConfig::GpioInvert) => {
            0..=mask(channels.outputs)
        }
    };
    if range.contains(&value) {
        Ok(())
    } else {
        Err(Refusal::Value)
    }
}

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
        assert_eq!(found.len(), 6 * 6 + 6 * 2 + 6 * 2 + 4);
        assert_eq!(setting_at(map::CONFIG + map::CONFIG_LEN, SIX), None);
        assert_eq!(setting_at(0, SIX), None);
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
            assert!(!ok(setting, 0) && ok(setting, 1) && ok(setting, 65535) && !ok(setting, 65536));
        }
        for field in [StepgenConfig::Dirsetup, StepgenConfig::Dirhold] {
            let setting = Setting::Stepgen(0, field);
            assert!(ok(setting, 0) && ok(setting, 0xff_ffff) && !ok(setting, 0x100_0000));
        }
    }

    #[test]
    fn reserved_mode_bits_are_refused() {
        assert!(ok(Setting::Stepgen(0, StepgenConfig::Mode), 3));
        assert!(!ok(Setting::Stepgen(0, StepgenConfig::Mode), 4));
        assert!(!ok(Setting::PwmMode(0), 2));
        assert!(!ok(Setting::EncoderMode(0), 1));
        assert!(ok(Setting::EncoderFilter(0), 255) && !ok(Setting::EncoderFilter(0), 256));
    }

    #[test]
    fn a_watchdog_can_neither_be_configured_away_nor_bite_within_a_servo_period() {
        let timeout = Setting::Board(BoardConfig::WatchdogTimeout);
        assert!(!ok(timeout, 0) && !ok(timeout, 5_999) && ok(timeout, 6_000));
        assert!(ok(timeout, 600_000_000) && !ok(timeout, 600_000_001));
    }

    #[test]
    fn outputs_the_board_does_not_have_cannot_be_configured() {
        let safe = Setting::Board(BoardConfig::GpioSafe);
        assert!(ok(safe, 0xfff) && !ok(safe, 0x1000));
        let all = Channels { outputs: 32, ..SIX };
        assert!(check(safe, u32::MAX, all, CLOCK).is_ok());
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
