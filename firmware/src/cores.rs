//! The board as the firmware's logic sees it: a few operations per gateware core.
//!
//! The image (`src/bin/ferrocnc-firmware`) implements [`Board`] with registers, the tests with a
//! record of calls, the simulator with models. Word numbers of the `command` and `status` pages are
//! those of [`wire::regmap`].

pub use crate::gate::Gate;
use crate::pass::Pass;
use wire::describe::Channels;
use wire::map::BoardConfig;
use wire::regmap::{CSR_PAGE, debounce, encoder, gpio, gpio_high, led, pwm, stepgen, watchdog};

/// The gateware's identity.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Ident {
    /// Hash of the register map the gateware was built from.
    pub abi: u32,
    /// Major << 16 | minor << 8 | patch.
    pub version: u32,
    /// Clock of everything that counts clocks.
    pub clock_hz: u32,
    /// How many channels of each kind.
    pub channels: Channels,
    /// What is there besides the channels: [`wire::describe::FEATURE_JOBS`].
    pub features: u32,
    /// Words in the board information ROM.
    pub blob_words: u32,
}

impl Ident {
    /// There is a segments core.
    pub const fn plays_segments(&self) -> bool {
        self.features & wire::describe::FEATURE_JOBS != 0
    }
}

/// Orders to the gate.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[must_use]
pub enum Control {
    /// Open the gate, wake the watchdog.
    Arm,
    /// Bring every stepgen to rest at the deceleration in its core, then close.
    SoftStop,
    /// Close now.
    Close,
    /// Reset a latched bite, reset or e-stop; the gateware obeys only with the gate closed and no
    /// pin active.
    Clear,
}

impl Control {
    /// The key word for the watchdog's `control` register.
    pub const fn key(self) -> u32 {
        match self {
            Control::Arm => watchdog::CONTROL_KEY_ARM,
            Control::SoftStop => watchdog::CONTROL_KEY_SOFT,
            Control::Close => watchdog::CONTROL_KEY_STOP,
            Control::Clear => watchdog::CONTROL_KEY_CLEAR,
        }
    }
}

/// The status LED's patterns.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum Led {
    /// Dark: not started yet.
    Off = led::PATTERN_SELECT_OFF,
    /// Armed.
    On = led::PATTERN_SELECT_ON,
    /// Idle: the session has no owner.
    Slow = led::PATTERN_SELECT_SLOW,
    /// Faulted.
    Fast = led::PATTERN_SELECT_FAST,
    /// A host owns the session, not armed.
    Double = led::PATTERN_SELECT_DOUBLE,
    /// External reset or e-stop, active or not yet cleared.
    Triple = led::PATTERN_SELECT_TRIPLE,
    /// Alive, but no frames arrive: the link is down, as far as known.
    Heartbeat = led::PATTERN_SELECT_HEARTBEAT,
    /// A soft stop is running.
    Flicker = led::PATTERN_SELECT_FLICKER,
}

/// A setting of the config window.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Setting {
    /// A stepgen's.
    Stepgen(u8, wire::map::StepgenConfig),
    /// A PWM's period in clocks.
    PwmPeriod(u8),
    /// A PWM's mode.
    PwmMode(u8),
    /// An encoder's mode.
    EncoderMode(u8),
    /// Clocks an encoder input must be stable.
    EncoderFilter(u8),
    /// Looks an input must be stable for ([`wire::map::DEBOUNCE_CLOCKS`]).
    Debounce(u8),
    /// The board's.
    Board(BoardConfig),
}

impl Setting {
    /// The address of its register.
    #[inline(always)]
    pub const fn address(self) -> usize {
        let (base, channel, word) = match self {
            Setting::Stepgen(n, field) => (stepgen::BASE, n, field as usize),
            Setting::PwmPeriod(n) => (pwm::BASE, n, pwm::PERIOD),
            Setting::PwmMode(n) => (pwm::BASE, n, pwm::MODE),
            Setting::EncoderMode(n) => (encoder::BASE, n, encoder::MODE),
            Setting::EncoderFilter(n) => (encoder::BASE, n, encoder::FILTER),
            Setting::Board(BoardConfig::WatchdogTimeout) => (watchdog::BASE, 0, watchdog::TIMEOUT),
            Setting::Board(BoardConfig::WatchdogGrace) => (watchdog::BASE, 0, watchdog::GRACE),
            Setting::Board(BoardConfig::GpioSafe) => (gpio::BASE, 0, gpio::SAFE),
            Setting::Board(BoardConfig::GpioInvert) => (gpio::BASE, 0, gpio::INVERT_OUT),
            Setting::Board(BoardConfig::Probe) => (gpio::BASE, 0, gpio::PROBE),
            Setting::Board(BoardConfig::GpioSafeHigh) => (gpio_high::BASE, 0, gpio_high::SAFE),
            Setting::Board(BoardConfig::GpioInvertHigh) => {
                (gpio_high::BASE, 0, gpio_high::INVERT_OUT)
            }
            Setting::Debounce(n) => (debounce::BASE, 0, debounce::IN0 + n as usize),
        };
        base + channel as usize * CSR_PAGE + word * 4
    }
}

/// What the PHY reports in band, and how many frames the MAC dropped.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Link {
    /// RGMII's in-band status: bit 0 up, bits 2:1 speed (10, 100, 1000 Mbit/s), bit 3 full duplex.
    pub status: u32,
    /// Frames dropped since power-up: no slot, preamble, CRC.
    pub errors: u32,
}

/// The board. Every method except those of the flash is a few register accesses and cannot fail.
pub trait Board {
    /// The flash's SPI.
    type Spi: embedded_hal::spi::SpiDevice;

    /// The flash's SPI.
    fn spi(&mut self) -> &mut Self::Spi;
    /// The last four words of the ROM ([`wire::images::Trailer`]).
    fn trailer(&mut self) -> [u32; 4];
    /// Is the factory pin active now?
    fn factory_pin(&mut self) -> bool;
    /// The link's state now.
    fn link(&mut self) -> Link;

    /// The wall clock.
    fn now(&mut self) -> u64;
    /// Its low word.
    fn now_lo(&mut self) -> u32;
    /// The wall clock at the end of the last received frame, low word.
    fn arrival_lo(&mut self) -> u32;
    /// Its high word.
    fn arrival_hi(&mut self) -> u32;
    /// Stages a word of the `command` page.
    fn stage(&mut self, word: usize, value: u32);
    /// Reads a staged word of the `command` page back.
    fn staged(&mut self, word: usize) -> u32;
    /// Reads a word of the `status` page.
    fn latched(&mut self, word: usize) -> u32;
    /// When a timed commit happens; `u64::MAX` is never.
    fn commit_at(&mut self, at: u64);
    /// Commit and sample: bits of [`wire::regmap::timebase::STROBE`].
    fn strobe(&mut self, strobes: u32);
    /// Clocks until the watchdog bites.
    fn watchdog_left(&mut self) -> u32;
    /// Feeds the watchdog with a new token.
    fn feed(&mut self, token: u32);
    /// Hands out a pass for one command. A board without a fast path never does.
    fn hand_out(&mut self, _pass: &Pass) {}
    /// Takes the pass back. Was a command executed with it? The answer is final.
    fn revoke(&mut self) -> bool {
        false
    }
    /// Has a command been executed with the pass that is out?
    fn executed(&mut self) -> bool {
        false
    }
    /// The fast path's answer has not left yet: no pass can be handed out.
    fn sending(&mut self) -> bool {
        true
    }
    /// Reads a word of the fast path's transmit slot, where it can be read: debug builds on a PC
    /// check that nothing has changed it ([`crate::machine::Shared`]).
    fn prepared(&mut self, _word: usize) -> u32 {
        0
    }
    /// The gate.
    fn gate(&mut self) -> Gate;
    /// Why the gate closed last ([`wire::GateClose`]); the gateware remembers it through a restart.
    fn last_close(&mut self) -> u32;
    /// Orders the gate.
    fn control(&mut self, order: Control);
    /// Reads a setting.
    fn setting(&mut self, which: Setting) -> u32;
    /// Changes a setting; [`crate::config::check`] said yes.
    fn set(&mut self, which: Setting, value: u32);
    /// Changes the deceleration in a stepgen's core, for the time being ([`crate::path_stop`]).
    fn set_stop_accel(&mut self, stepgen: usize, value: u32);
    /// Reads a raw CSR; [`crate::service::readable`] said yes.
    fn csr_read(&mut self, address: u32) -> u32;
    /// Writes a raw CSR; [`crate::service::check_write`] said yes.
    fn csr_write(&mut self, address: u32, value: u32);
    /// Reads the board information.
    fn blob(&mut self, word: usize) -> u32;
    /// Writes the board information, on boards whose pins are configured.
    fn describe(&mut self, _word: usize, _value: u32) {}
    /// Sets the status LED.
    fn led(&mut self, pattern: Led);
    /// Reads the log window's head or ring ([`crate::log::Ring`]).
    fn log(&mut self, read: crate::log::Read) -> u32;
    /// Reads the panic window, by byte offset.
    fn panic(&mut self, offset: u32) -> u32;
    /// Derives another boot id for this start from `seed`, and returns it.
    fn rename_boot(&mut self, seed: u32) -> u32;
    /// Bytes of the firmware's stack that were ever used, and its size; zeros if unknown. It looks
    /// at one part of the stack, counted from its end; `None` if that was never used: ask for the
    /// next.
    fn stack(&mut self, _part: u32) -> Option<(u32, u32)> {
        Some((0, 0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_order_s_key_is_a_word_that_says_it() {
        let orders = [
            Control::Arm,
            Control::SoftStop,
            Control::Close,
            Control::Clear,
        ];
        let keys = orders.map(|order| order.key().to_be_bytes());
        assert_eq!(keys, [*b"ARM1", *b"SOFT", *b"STOP", *b"CLR1"]);
    }

    #[test]
    fn every_bit_of_the_gate_says_what_the_watchdog_s_register_says() {
        assert_eq!(Gate::LIVE.0, 0b0010_0001);
        for bits in 0..256 {
            let gate = Gate(bits);
            let one = |bit: u32| bits >> bit & 1 == 1;
            let seen = [
                gate.open(),
                gate.stopping(),
                gate.bitten(),
                gate.reset(),
                gate.reset_pin(),
                gate.awake(),
                gate.estop(),
                gate.estop_pin(),
            ];
            assert_eq!(seen, [0, 1, 2, 3, 4, 5, 6, 7].map(one), "{bits:08b}");
            let pins = one(3) || one(4) || one(6) || one(7);
            assert_eq!(gate.pinned(), pins, "{bits:08b}");
            assert_eq!(gate.pinned_now(), one(4) || one(7), "{bits:08b}");
            let latched = one(2) || one(3) || one(6);
            assert_eq!(gate.latched(), latched, "{bits:08b}");
        }
    }
}
