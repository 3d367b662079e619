//! The address windows of the board. Byte addresses; every access is one aligned 32-bit word.
//!
//! ```text
//! 0x0000_0000  describe   read    what this board is                       see `describe`
//! 0x0001_0000  session    rw      the owner of the motion
//! 0x0002_0000  config     rw      timings, modes, limits; refused while armed unless live-safe
//! 0x0003_0000  command    write   the exchange: one command block          see `exchange`
//! 0x0004_0000  status     read    the last status block, and counters; reading changes nothing
//! 0x0005_0000  log        read    the defmt ring
//! 0x0006_0000  panic      read    the reason of the firmware's last crash
//! 0x0007_0000  flash      rw      the SPI flash: images, settings         see `flash`
//! 0xf000_0000  service    rw      raw CSRs: reads always, writes only disarmed and by the owner
//! 0xf002_1000    segments rw      part of them; if a PC streams jobs, the owner may always write these
//! ```

use crate::regmap::{self, debounce, encoder, gpio, pads, pwm, segments, stepgen, timebase};

/// The description of the board. Words as in [`crate::describe::Describe`], then the board blob.
pub const DESCRIBE: u32 = 0x0000_0000;
/// Length of the describe window in bytes.
pub const DESCRIBE_LEN: u32 = 0x2000;
/// The board information blob ([`crate::board`]).
pub const DESCRIBE_BLOB: u32 = DESCRIBE + 0x100;

/// The owner of the motion.
pub const SESSION: u32 = 0x0001_0000;
/// Write a non-zero nonce to become the owner. Refused (`not-owner`) while another client is the
/// owner. Refused (`key`) on a board with a key, unless the right [`SESSION_RESPONSE`] precedes it
/// in the same datagram.
pub const SESSION_ACQUIRE: u32 = SESSION;
/// Reads as the session token for its owner, as 0 for all other clients.
pub const SESSION_TOKEN: u32 = SESSION + 0x4;
/// IPv4 address of the owner, 0 if none.
pub const SESSION_OWNER_IP: u32 = SESSION + 0x8;
/// UDP port of the owner, 0 if none.
pub const SESSION_OWNER_PORT: u32 = SESSION + 0xc;
/// Write the token to release the session.
pub const SESSION_RELEASE: u32 = SESSION + 0x10;
/// The last accepted sequence number.
pub const SESSION_LAST_SEQ: u32 = SESSION + 0x14;
/// Write [`REBOOT_KEY`] to restart the firmware; only disarmed, and only as the owner or, on a
/// board without a key, while there is no owner.
pub const SESSION_REBOOT: u32 = SESSION + 0x18;
/// Write the last number plus one before the words for [`SEGMENTS`] in the same datagram: so a
/// repeated or late datagram is refused (`stale`). Reads as the last number; a session begins with
/// any.
pub const SESSION_SEGMENTS: u32 = SESSION + 0x1c;
/// 4 words, read in order: the challenge to answer in order to acquire ([`crate::auth`]). Zeros
/// without a key; while there is an owner, zeros for all other clients.
pub const SESSION_CHALLENGE: u32 = SESSION + 0x20;
/// 4 words, written as one record: the answer, for an acquisition after it in the same datagram. It
/// is not kept for later; without a key it is ignored.
pub const SESSION_RESPONSE: u32 = SESSION + 0x30;
/// Length of the session window in bytes.
pub const SESSION_LEN: u32 = 0x40;
/// "RBOT".
pub const REBOOT_KEY: u32 = 0x5242_4f54;

/// Timings, modes, limits.
pub const CONFIG: u32 = 0x0002_0000;
/// Bytes from one channel's block to the next.
pub const CONFIG_STRIDE: u32 = 0x40;
/// Stepgen blocks: words as [`StepgenConfig`] numbers them, which are those of the register page.
pub const CONFIG_STEPGEN: u32 = CONFIG;
/// PWM blocks: 0 period, 1 mode.
pub const CONFIG_PWM: u32 = CONFIG + 0x400;
/// Encoder blocks: 0 mode, 1 filter.
pub const CONFIG_ENCODER: u32 = CONFIG + 0x800;
/// Board block: words as [`BoardConfig`] numbers them.
pub const CONFIG_BOARD: u32 = CONFIG + 0xc00;
/// Length of the config window in bytes.
pub const CONFIG_LEN: u32 = 0x1000;

/// Words of a stepgen's configuration block.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum StepgenConfig {
    /// Clocks STEP stays active, 1..=[`STEP_CLOCKS_MAX`].
    Steplen = stepgen::STEPLEN as u32,
    /// Clocks STEP stays inactive at least, 1..=[`STEP_CLOCKS_MAX`].
    Stepspace = stepgen::STEPSPACE as u32,
    /// Clocks from a DIR edge to the next STEP rise, 0..=[`DIR_CLOCKS_MAX`].
    Dirsetup = stepgen::DIRSETUP as u32,
    /// Clocks from STEP's fall to a DIR edge, 0..=[`DIR_CLOCKS_MAX`].
    Dirhold = stepgen::DIRHOLD as u32,
    /// Deceleration of a soft stop, in the unit of [`crate::units::Accel`]; 0 stops at once.
    StopAccel = stepgen::STOP_ACCEL as u32,
    /// [`STEPGEN_STEP_INVERT`], [`STEPGEN_DIR_INVERT`], [`StepType`], [`STEPGEN_INDEX_INVERT`].
    Mode = stepgen::MODE as u32,
}

/// 10 s: the longest timeout and the longest grace of a watchdog. A longer one would not protect.
pub const WATCHDOG_SECONDS_MAX: u64 = 10;

/// Longest steplen and stepspace: 13 bits, 136 us at 60 MHz.
pub const STEP_CLOCKS_MAX: u32 = stepgen::STEPLEN_CLOCKS;
/// Longest dirsetup and dirhold: 16 bits, 1.09 ms at 60 MHz.
pub const DIR_CLOCKS_MAX: u32 = stepgen::DIRSETUP_CLOCKS;

/// Stepgen mode: STEP is active low.
pub const STEPGEN_STEP_INVERT: u32 = stepgen::MODE_STEP_INVERT;
/// Stepgen mode: DIR is low for negative.
pub const STEPGEN_DIR_INVERT: u32 = stepgen::MODE_DIR_INVERT;
/// Stepgen mode: where its [`StepType`] begins.
pub const STEPGEN_TYPE_SHIFT: u32 = stepgen::MODE_KIND_SHIFT;
/// Stepgen mode: the index pin is active low.
pub const STEPGEN_INDEX_INVERT: u32 = stepgen::MODE_INDEX_INVERT;

/// The signals at a stepgen's two pins; the numbers of LinuxCNC and hostmot2.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(u32)]
pub enum StepType {
    /// STEP pulses, DIR says which way.
    #[default]
    StepDir = stepgen::MODE_KIND_STEP_DIR,
    /// STEP pulses forwards, DIR pulses backwards.
    UpDown = stepgen::MODE_KIND_UP_DOWN,
    /// A and B, one line changes per step.
    Quadrature = stepgen::MODE_KIND_QUADRATURE,
}

impl StepType {
    /// The type with this number.
    pub const fn from_code(code: u32) -> Option<Self> {
        match code {
            stepgen::MODE_KIND_STEP_DIR => Some(StepType::StepDir),
            stepgen::MODE_KIND_UP_DOWN => Some(StepType::UpDown),
            stepgen::MODE_KIND_QUADRATURE => Some(StepType::Quadrature),
            _ => None,
        }
    }
}

/// What an encoder counts: bits 2:0 of its mode.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(u32)]
pub enum CountMode {
    /// Every edge of A and B.
    #[default]
    X4 = encoder::MODE_SELECT_X4,
    /// Every edge of A.
    X2 = encoder::MODE_SELECT_X2,
    /// One edge per line.
    X1 = encoder::MODE_SELECT_X1,
    /// A rises: up. One-channel counters.
    Counter = encoder::MODE_SELECT_COUNTER,
    /// A rises: up while B is low, down while it is high.
    StepDir = encoder::MODE_SELECT_STEP_DIR,
    /// A rises: up. B rises: down.
    UpDown = encoder::MODE_SELECT_UP_DOWN,
}

impl CountMode {
    /// The mode with this number.
    pub const fn from_code(code: u32) -> Option<Self> {
        match code {
            encoder::MODE_SELECT_X4 => Some(CountMode::X4),
            encoder::MODE_SELECT_X2 => Some(CountMode::X2),
            encoder::MODE_SELECT_X1 => Some(CountMode::X1),
            encoder::MODE_SELECT_COUNTER => Some(CountMode::Counter),
            encoder::MODE_SELECT_STEP_DIR => Some(CountMode::StepDir),
            encoder::MODE_SELECT_UP_DOWN => Some(CountMode::UpDown),
            _ => None,
        }
    }
}

/// Encoder mode: the index is active low.
pub const ENCODER_INDEX_INVERT: u32 = encoder::MODE_INDEX_INVERT;
/// Encoder mode: the index counts only while the mask pin is active.
pub const ENCODER_MASK_ENABLE: u32 = encoder::MODE_MASK_ENABLE;
/// Encoder mode: the mask pin is active low.
pub const ENCODER_MASK_INVERT: u32 = encoder::MODE_MASK_INVERT;
/// Encoder mode: the count restarts at the latched index.
pub const ENCODER_CLEAR_ON_INDEX: u32 = encoder::MODE_CLEAR_ON_INDEX;
/// Longest encoder filter, in clocks.
pub const ENCODER_FILTER_MAX: u32 = encoder::FILTER_CLOCKS;

/// PWM mode: the outputs are active low.
pub const PWM_INVERT: u32 = pwm::MODE_INVERT;
/// PWM mode: where its [`PwmType`] begins.
pub const PWM_TYPE_SHIFT: u32 = pwm::MODE_KIND_SHIFT;
/// PWM mode: spread the width's fraction over periods.
pub const PWM_DITHER: u32 = pwm::MODE_DITHER;
/// PWM mode: the two pins change places.
pub const PWM_SWAP: u32 = pwm::MODE_SWAP;

/// What a PWM does with its two pins.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(u32)]
pub enum PwmType {
    /// Pulse width on the first, direction on the second.
    #[default]
    Pwm = pwm::MODE_KIND_PWM,
    /// Pulse width on the first forwards, on the second backwards.
    UpDown = pwm::MODE_KIND_UP_DOWN,
    /// Pulse density on the first, direction on the second; width's bits 24:8 are 1/65536.
    Pdm = pwm::MODE_KIND_PDM,
}

/// Probe setting: which input, bits 4:0.
pub const PROBE_INPUT_MASK: u32 = gpio::PROBE_INPUT;
/// Probe setting: there is one.
pub const PROBE_ENABLE: u32 = gpio::PROBE_ENABLE;
/// Probe setting: it is active low.
pub const PROBE_INVERT: u32 = gpio::PROBE_INVERT;

/// Words in a stepgen's configuration block.
pub const STEPGEN_CONFIG_WORDS: u32 = stepgen::WORDS as u32;
/// Words in a PWM's configuration block.
pub const PWM_CONFIG_WORDS: u32 = pwm::WORDS as u32;
/// Words in an encoder's configuration block.
pub const ENCODER_CONFIG_WORDS: u32 = encoder::WORDS as u32;

/// Words of the board's configuration block.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum BoardConfig {
    /// Clocks without an accepted command until the watchdog bites.
    WatchdogTimeout = 0,
    /// Clocks a soft stop may take after a bite before the gate closes regardless.
    WatchdogGrace = 1,
    /// Levels of outputs 0 to 31 while the gate is closed, one bit per output.
    GpioSafe = 2,
    /// Polarity of outputs 0 to 31, one bit per output; 1 inverts.
    GpioInvert = 3,
    /// Which input is the probe: [`PROBE_INPUT_MASK`], [`PROBE_ENABLE`], [`PROBE_INVERT`].
    Probe = 4,
    /// As [`BoardConfig::GpioSafe`], of outputs 32 to 63.
    GpioSafeHigh = 5,
    /// As [`BoardConfig::GpioInvert`], of outputs 32 to 63.
    GpioInvertHigh = 6,
}

/// Words in the board's configuration block.
pub const BOARD_CONFIG_WORDS: u32 = 7;

/// Debounce: one word per input, in units of [`DEBOUNCE_CLOCKS`], 0..=[`DEBOUNCE_MAX`].
pub const CONFIG_DEBOUNCE: u32 = CONFIG_BOARD + 0x40;
/// Clocks between two looks at an input.
pub const DEBOUNCE_CLOCKS: u32 = 32;
/// Longest debounce, in looks: 35 ms at 60 MHz.
pub const DEBOUNCE_MAX: u32 = debounce::IN0_VISITS;

/// The exchange: a whole command block is written here ([`crate::exchange`]).
pub const COMMAND: u32 = 0x0003_0000;

/// The last status block.
pub const STATUS: u32 = 0x0004_0000;
/// Frames received, frames sent, exchanges executed, then [`COUNTERS_REFUSED`].
pub const COUNTERS: u32 = 0x0004_1000;
/// One counter per [`crate::Refusal`], in its order; after them, how often pulses may have been cut
/// off since the start.
pub const COUNTERS_REFUSED: u32 = COUNTERS + 0xc;

/// The log: +0 head (absolute index of the byte after the newest), +4 ring size, +8 boot id.
pub const LOG: u32 = 0x0005_0000;
/// The ring itself; byte `i` of the log lies at `i % size`, bytes packed big-endian into words.
pub const LOG_RING: u32 = 0x0005_1000;

/// The last panic: +0 number since power-up, +4 length, then the text from [`PANIC_TEXT`].
pub const PANIC: u32 = 0x0006_0000;
/// Text of the last panic, [`PANIC_TEXT_LEN`] bytes, packed big-endian into words.
pub const PANIC_TEXT: u32 = PANIC + 0x10;
/// Longest panic text kept.
pub const PANIC_TEXT_LEN: u32 = 256;

/// The SPI flash ([`crate::flash`]). Every word may be read. [`FLASH_OP`], its operands and the
/// buffer may be written, while disarmed, by the owner or, on a board without a key, while there is
/// no owner.
pub const FLASH: u32 = 0x0007_0000;
/// Write an [`crate::flash::Op`] to start it; reads as an [`crate::flash::OpWord`].
pub const FLASH_OP: u32 = FLASH;
/// Operand: a byte address of the flash, or for `Select` a [`crate::flash::Slot`].
pub const FLASH_ADDRESS: u32 = FLASH + 0x4;
/// Operand: bytes.
pub const FLASH_OP_LENGTH: u32 = FLASH + 0x8;
/// The result of `Crc`.
pub const FLASH_CRC: u32 = FLASH + 0xc;
/// JEDEC id: manufacturer << 16 | type << 8 | capacity; 0 if no flash answers.
pub const FLASH_JEDEC: u32 = FLASH + 0x10;
/// The flash's unique id, upper half; both 0 if it has none.
pub const FLASH_UID_HI: u32 = FLASH + 0x14;
/// The lower half.
pub const FLASH_UID_LO: u32 = FLASH + 0x18;
/// Bytes of the flash; 0 if this version does not know its layout.
pub const FLASH_SIZE: u32 = FLASH + 0x1c;
/// The image that runs ([`crate::flash::Running`]).
pub const FLASH_RUNNING: u32 = FLASH + 0x20;
/// Which slot loads at the next power-up: 0 none (the golden image does), or a
/// [`crate::flash::Slot`].
pub const FLASH_SELECTED: u32 = FLASH + 0x24;
/// Build id of the running image, 0 if it was never packed.
pub const FLASH_BUILD_ID: u32 = FLASH + 0x28;
/// Source of the settings in force ([`crate::flash::Origin`]).
pub const FLASH_ORIGIN: u32 = FLASH + 0x2c;
/// The link ([`crate::flash::LinkWord`]).
pub const FLASH_LINK: u32 = FLASH + 0x30;
/// 1 if the flash itself protects the golden image and nothing else.
pub const FLASH_PROTECTED: u32 = FLASH + 0x34;
/// The address in force, which DHCP may have given.
pub const FLASH_IP: u32 = FLASH + 0x38;
/// The configuration of the pins ([`crate::pins::Loaded`]).
pub const FLASH_PINS: u32 = FLASH + 0x3c;
/// One page, bytes packed big-endian: for `Program` and `SaveSettings`, from `Read`.
pub const FLASH_BUFFER: u32 = FLASH + 0x100;
/// Words of the buffer.
pub const FLASH_BUFFER_WORDS: u32 = 64;
/// The settings in force ([`crate::settings::Settings`] words, the key blanked).
pub const FLASH_SETTINGS: u32 = FLASH + 0x200;
/// Length of the flash window in bytes.
pub const FLASH_LEN: u32 = 0x300;

/// Raw CSRs at the address they have on the board's own bus.
pub const SERVICE: u32 = regmap::CSR_BASE as u32;

/// Levels at the pads the board drives: STEP and DIR, their inverted copies, PWMs, outputs and
/// those from 32 on. Each of the first three words has first pins in its low half and second pins
/// in its high one.
pub const PADS: u32 = pads::BASE as u32;
/// Words there.
pub const PADS_WORDS: u32 = pads::WORDS as u32;
/// The wall clock as caught last, low word; the Ethernet clock's count in [`ETH_BEATS`] is of that
/// moment.
pub const TIMEBASE_NOW: u32 = regmap::address(timebase::BASE, timebase::NOW_LO);
/// The Ethernet receive clock, in units of [`ETH_BEAT_CLOCKS`] of its clocks.
pub const ETH_BEATS: u32 = regmap::address(timebase::BASE, timebase::ETH_BEATS);
/// Clocks of a beat.
pub const ETH_BEAT_CLOCKS: u32 = 4;

/// The registers of the segments core, at their place among the raw ones (docs/cores/segments.md).
/// On a board whose jobs a PC streams ([`crate::describe::JobsState::Streamed`]) its owner may
/// write the first [`SEGMENTS_WRITABLE`] at any time, after [`SESSION_SEGMENTS`].
pub const SEGMENTS: u32 = segments::BASE as u32;
/// The words of a segment, push, control, pace, slew, beam, mask.
pub const SEGMENTS_WRITABLE: u32 = segments::STATUS as u32;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_type_of_a_channel_has_its_code_and_other_codes_are_none() {
        for code in 0..16 {
            let step = StepType::from_code(code).map(|kind| kind as u32);
            assert_eq!(step, (code < 3).then_some(code));
            let count = CountMode::from_code(code).map(|mode| mode as u32);
            assert_eq!(count, (code < 6).then_some(code));
        }
    }
}
