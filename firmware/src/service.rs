//! Raw registers for developers and for LiteX's own tools: all can be read, few can be written.
//!
//! A read changes no CSR of this SoC. Writes are allowed for registers that configure and cannot
//! move anything: never the gate, never the network, never the command page. The segments are the
//! exception, on boards with jobs streamed by a PC: the server judges those writes.

use crate::config;
use crate::cores::Setting;
use wire::Refusal;
use wire::describe::Channels;
use wire::map::{self, BoardConfig};
use wire::regmap::{
    self, ctrl, debounce, encoder, ethmac, ethphy, flash, gpio, gpio_high, ident, identifier_mem,
    led, pads, pwm, rx_admission, segments, stepgen,
};

const PAGE: u32 = regmap::CSR_PAGE as u32;
/// LiteX's controller has a scratch register for tests.
const SCRATCH: u32 = regmap::address(ctrl::BASE, ctrl::SCRATCH);
/// Pages of LiteX and ours; no client reads the flash or the SDRAM past the firmware.
const PAGES: u64 = 1 << ctrl::PAGE
    | 1 << identifier_mem::PAGE
    | 1 << ethmac::PAGE
    | 1 << ethphy::PAGE
    | !0 << ident::PAGE;

/// The meaning of a raw write.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Target {
    Setting(Setting),
    /// Without any danger, whatever the value.
    Harmless,
}

/// Is there a register page at this address?
pub const fn readable(address: u32) -> bool {
    let offset = address.wrapping_sub(map::SERVICE);
    let page = offset / PAGE;
    page < flash::PAGE && PAGES >> page & 1 != 0
        || matches!(
            page,
            rx_admission::PAGE | segments::PAGE | pads::PAGE | gpio_high::PAGE
        )
}

/// May this be written at all, and with this value? The caller has checked ownership and rest.
pub fn check_write(
    address: u32,
    value: u32,
    channels: Channels,
    clock_hz: u32,
) -> Result<(), Refusal> {
    match target(address, channels)? {
        Target::Setting(setting) => config::check(setting, value, channels, clock_hz),
        Target::Harmless => Ok(()),
    }
}

/// A register that is a setting has the same place on its page as in its block of the config
/// window.
#[inline(never)]
fn target(address: u32, channels: Channels) -> Result<Target, Refusal> {
    if !readable(address) {
        return Err(Refusal::Unmapped);
    }
    if address == SCRATCH {
        return Ok(Target::Harmless);
    }
    let offset = address - map::SERVICE;
    let (page, word) = (offset / PAGE, offset % PAGE / 4);
    let block = page % 16 * map::CONFIG_STRIDE;
    let in_block = word < map::CONFIG_STRIDE / 4;
    let config = match (page, word as usize) {
        (led::PAGE, led::PATTERN) => return Ok(Target::Harmless),
        (gpio::PAGE, gpio::SAFE) => map::CONFIG_BOARD + 4 * BoardConfig::GpioSafe as u32,
        (gpio::PAGE, gpio::INVERT_OUT) => map::CONFIG_BOARD + 4 * BoardConfig::GpioInvert as u32,
        (gpio_high::PAGE, gpio_high::SAFE) => {
            map::CONFIG_BOARD + 4 * BoardConfig::GpioSafeHigh as u32
        }
        (gpio_high::PAGE, gpio_high::INVERT_OUT) => {
            map::CONFIG_BOARD + 4 * BoardConfig::GpioInvertHigh as u32
        }
        (gpio::PAGE, gpio::PROBE) => map::CONFIG_BOARD + 4 * BoardConfig::Probe as u32,
        (debounce::PAGE, 0..debounce::WORDS) => map::CONFIG_DEBOUNCE + 4 * word,
        (stepgen::PAGE..encoder::PAGE, _) if in_block => map::CONFIG_STEPGEN + block + 4 * word,
        (encoder::PAGE..pwm::PAGE, _) if in_block => map::CONFIG_ENCODER + block + 4 * word,
        (pwm::PAGE..flash::PAGE, _) if in_block => map::CONFIG_PWM + block + 4 * word,
        _ => return Err(Refusal::ReadOnly),
    };
    config::setting_at(config, channels)
        .map(Target::Setting)
        .ok_or(Refusal::ReadOnly)
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

    fn write(page: u32, word: u32, value: u32) -> Result<(), Refusal> {
        check_write(
            map::SERVICE + page * PAGE + word * 4,
            value,
            SIX,
            60_000_000,
        )
    }

    #[test]
    fn the_identifier_and_every_core_can_be_read() {
        for page in [
            0, 1, 3, 4, 8, 9, 10, 11, 12, 13, 14, 15, 16, 31, 32, 48, 63, 65, 66, 67,
        ] {
            assert!(readable(map::SERVICE + page * PAGE), "page {page}");
        }
        for page in [2, 5, 6, 7, 64, 68, 1000] {
            assert!(!readable(map::SERVICE + page * PAGE), "page {page}");
        }
        assert!(!readable(0x8000_0000) && !readable(0));
    }

    #[test]
    fn nothing_that_opens_the_gate_moves_an_axis_or_cuts_the_network_can_be_written() {
        for page in [1, 3, 4, 8, 9, 10, 14, 15, 65, 66, 67] {
            for word in 0..64 {
                assert_eq!(
                    write(page, word, 0),
                    Err(Refusal::ReadOnly),
                    "page {page} word {word}"
                );
            }
        }
        assert_eq!(write(0, 0, 1), Err(Refusal::ReadOnly), "the SoC's reset");
    }

    #[test]
    fn the_scratch_register_is_there_to_be_written() {
        assert_eq!(write(0, 1, 0xffff_ffff), Ok(()));
    }

    #[test]
    fn raw_settings_have_the_limits_of_the_config_window() {
        assert_eq!(write(16, 0, 1), Ok(()));
        assert_eq!(write(16, 0, 0), Err(Refusal::Value));
        assert_eq!(
            write(22, 0, 1),
            Err(Refusal::ReadOnly),
            "a stepgen the board does not have"
        );
        assert_eq!(write(11, 1, 0xfff), Ok(()));
        assert_eq!(write(11, 1, 0x1000), Err(Refusal::Value));
        assert_eq!(write(48, 0, 3000), Ok(()));
        assert_eq!(write(48, 1, 6), Err(Refusal::Value));
        assert_eq!(write(32, 0, 0xf5), Ok(()));
        assert_eq!(write(32, 0, 0xf6), Err(Refusal::Value));
        assert_eq!(write(13, 11, 1000), Ok(()));
        assert_eq!(write(13, 12, 1000), Err(Refusal::ReadOnly));
        assert_eq!(write(11, 7, 0x10b), Ok(()));
        assert_eq!(write(11, 7, 0x10c), Err(Refusal::Value));
    }

    #[test]
    fn the_register_of_a_setting_is_that_setting() {
        let window = (map::CONFIG..map::CONFIG + map::CONFIG_LEN).step_by(4);
        let mut watchdogs = 0;
        for setting in window.filter_map(|address| config::setting_at(address, SIX)) {
            let expected = match setting {
                // Only the config window changes the watchdog.
                Setting::Board(BoardConfig::WatchdogTimeout | BoardConfig::WatchdogGrace) => {
                    watchdogs += 1;
                    Err(Refusal::ReadOnly)
                }
                other => Ok(Target::Setting(other)),
            };
            assert_eq!(
                target(setting.address() as u32, SIX),
                expected,
                "{setting:?}"
            );
        }
        assert_eq!(watchdogs, 2);
    }

    #[test]
    fn what_is_not_a_setting_is_read_only() {
        for (page, word) in [
            (11, 0),
            (11, 3),
            (11, 4),
            (11, 5),
            (11, 6),
            (11, 8),
            (12, 1),
            (13, 32),
            (16, 6),
            (16, 16),
            (32, 2),
            (32, 16),
            (48, 2),
        ] {
            assert_eq!(
                write(page, word, 0),
                Err(Refusal::ReadOnly),
                "page {page} word {word}"
            );
        }
    }
}
