//! The description of a board: the first words of the describe window.
//!
//! ```text
//!  0 magic "FCR1"            6 clock, Hz                       12 status block words
//!  1 wire version            7 stepgens | encoders<<8 | pwms<<16   13 board blob words
//!  2 ABI of the firmware     8 inputs | outputs<<8             14 state word
//!  3 ABI of the gateware     9 features                        15 obstacles to arming
//!  4 firmware version       10 boot id                         16 why the firmware started last
//!  5 gateware version       11 command block words             17 why the gate closed last
//!                                                              18..63 zero
//!                                                              64.. the board blob
//! ```

pub use crate::channels::Channels;
use crate::exchange;
use crate::regmap::ident;
pub use crate::services::JobsState;
use crate::state::{GateClose, ResetReason};

/// "FCR1".
pub const MAGIC: u32 = 0x4643_5231;
/// Words before the board blob.
pub const WORDS: usize = 18;
/// Where the wire version is, in words.
pub const WIRE_VERSION_AT: usize = 1;
/// Where the firmware's register map is, in words.
pub const ABI_FIRMWARE_AT: usize = 2;
/// Where the gateware's register map is, in words.
pub const ABI_GATEWARE_AT: usize = 3;
/// Where the firmware's version is, in words.
pub const FIRMWARE_VERSION_AT: usize = 4;
/// Where the gateware's version is, in words.
pub const GATEWARE_VERSION_AT: usize = 5;
/// Where the clock is, in words.
pub const CLOCK_HZ_AT: usize = 6;
/// Where the first of the two words with the channels is, in words.
pub const CHANNELS_AT: usize = 7;
/// Where the features are, in words.
pub const FEATURES_AT: usize = 9;
/// Where the boot id is, in words.
pub const BOOT_ID_AT: usize = 10;
/// Where the length of a command block is, in words.
pub const COMMAND_WORDS_AT: usize = 11;
/// Where the length of a status block is, in words.
pub const STATUS_WORDS_AT: usize = 12;
/// Where the length of the board blob is, in words.
pub const BLOB_WORDS_AT: usize = 13;
/// Where the state is, in words.
pub const STATE_AT: usize = 14;
/// Where the obstacles are, in words.
pub const OBSTACLES_AT: usize = 15;
/// Where the reason of the last start is, in words.
pub const RESET_REASON_AT: usize = 16;
/// Where the reason of the gate's last close is, in words.
pub const GATE_CLOSE_AT: usize = 17;
/// Where the board blob begins, in words.
pub const BLOB_AT: usize = 64;

/// The address of a word of the description.
pub const fn address(word: usize) -> u32 {
    crate::map::DESCRIBE + 4 * word as u32
}

/// Obstacle to arming: gateware and firmware were built from different register maps.
pub const OBSTACLE_ABI: u32 = 1 << 0;
/// Obstacle to arming: a flash operation is running; it ends within seconds.
pub const OBSTACLE_FLASH: u32 = 1 << 1;

/// Obstacle to arming: a configuration of the pins is stored, and it is not one for this board
/// ([`crate::map::FLASH_PINS`] says why not).
pub const OBSTACLE_PINS: u32 = 1 << 2;

/// Feature: a key is set, and a client has to prove that it has the key before it may change
/// anything ([`crate::auth`]). The bits below 16 are the gateware's.
pub const FEATURE_KEY: u32 = 1 << 31;

/// A feature: the gateware plays segments, `ident.features` bit 0.
pub const FEATURE_JOBS: u32 = ident::FEATURES_JOBS;

/// A feature: the gateware reads the pads it drives ([`crate::map::PADS`]) and counts the Ethernet
/// clock ([`crate::map::ETH_BEATS`]), `ident.features` bit 1. 0 in gateware from before them.
pub const FEATURE_READBACK: u32 = ident::FEATURES_READBACK;

/// A feature: the functions of the pins are configured ([`crate::pins`]), `ident.features` bit 2.
/// Inputs and outputs have the numbers of their pins, and only those the blob names are there.
pub const FEATURE_PINS: u32 = ident::FEATURES_PINS;

/// The description of a board, which a client reads first.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Describe {
    /// Version of this crate on the board.
    pub wire_version: u32,
    /// Hash of the register map the firmware was built for.
    pub abi_firmware: u32,
    /// Hash of the register map the gateware was built from.
    pub abi_gateware: u32,
    /// Major << 16 | minor << 8 | patch.
    pub firmware_version: u32,
    /// Major << 16 | minor << 8 | patch.
    pub gateware_version: u32,
    /// Clock of everything that counts clocks.
    pub clock_hz: u32,
    /// Channel counts.
    pub channels: Channels,
    /// Features besides the channels: [`FEATURE_KEY`], [`FEATURE_JOBS`].
    pub features: u32,
    /// Changes with every start of the firmware.
    pub boot_id: u32,
    /// Words in the board blob that follows it.
    pub blob_words: u32,
    /// As the first word of a status block.
    pub state: exchange::StateWord,
    /// Why the board will not arm at all ([`OBSTACLE_ABI`], [`OBSTACLE_FLASH`]); 0 if it can arm.
    pub obstacles: u32,
    /// Why the firmware started last.
    pub reset_reason: ResetReason,
    /// Why the gate closed last.
    pub gate_close: GateClose,
}

/// Why a describe block cannot be understood; the text says what to do.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DescribeError {
    /// Not a FerroCNC board.
    Magic(u32),
    /// Another version of the protocol.
    Version {
        /// This side's.
        ours: u32,
        /// The board's.
        theirs: u32,
    },
    /// It contradicts itself.
    Malformed,
}

impl core::fmt::Display for DescribeError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            DescribeError::Magic(found) => write!(
                f,
                "not a FerroCNC board: its first word is {found:#010x} instead of {MAGIC:#010x}; check the address, or flash the board"
            ),
            DescribeError::Version { ours, theirs } => write!(
                f,
                "device speaks wire version {theirs}, this driver {ours}; reflash the board or reinstall the driver"
            ),
            DescribeError::Malformed => {
                f.write_str("the board's description contradicts itself; reflash the board")
            }
        }
    }
}

impl core::error::Error for DescribeError {}

impl Describe {
    /// As the first words of the describe window.
    pub fn to_words(&self) -> [u32; WORDS] {
        let [channels0, channels1] = self.channels.to_words();
        [
            MAGIC,
            self.wire_version,
            self.abi_firmware,
            self.abi_gateware,
            self.firmware_version,
            self.gateware_version,
            self.clock_hz,
            channels0,
            channels1,
            self.features,
            self.boot_id,
            exchange::command_words(self.channels) as u32,
            exchange::status_words(self.channels) as u32,
            self.blob_words,
            self.state.to_word(),
            self.obstacles,
            self.reset_reason as u32,
            self.gate_close as u32,
        ]
    }

    /// Reads and checks the first words of the describe window.
    pub fn parse(words: &[u32; WORDS]) -> Result<Self, DescribeError> {
        if words[0] != MAGIC {
            return Err(DescribeError::Magic(words[0]));
        }
        if words[WIRE_VERSION_AT] != crate::WIRE_VERSION {
            return Err(DescribeError::Version {
                ours: crate::WIRE_VERSION,
                theirs: words[WIRE_VERSION_AT],
            });
        }
        let malformed = |_| DescribeError::Malformed;
        let channels =
            Channels::from_words(words[CHANNELS_AT], words[CHANNELS_AT + 1]).map_err(malformed)?;
        let state = exchange::StateWord::from_word(words[STATE_AT]).map_err(malformed)?;
        let reset_reason =
            ResetReason::from_code(words[RESET_REASON_AT] as u8).ok_or(DescribeError::Malformed)?;
        let gate_close =
            GateClose::from_code(words[GATE_CLOSE_AT] as u8).ok_or(DescribeError::Malformed)?;
        let lengths_agree = words[COMMAND_WORDS_AT] as usize == exchange::command_words(channels)
            && words[STATUS_WORDS_AT] as usize == exchange::status_words(channels);
        let blob_fits = words[BLOB_WORDS_AT] <= (crate::map::DESCRIBE_LEN / 4) - BLOB_AT as u32;
        if !lengths_agree || !blob_fits || words[CLOCK_HZ_AT] == 0 {
            return Err(DescribeError::Malformed);
        }
        Ok(Describe {
            wire_version: words[WIRE_VERSION_AT],
            abi_firmware: words[ABI_FIRMWARE_AT],
            abi_gateware: words[ABI_GATEWARE_AT],
            firmware_version: words[FIRMWARE_VERSION_AT],
            gateware_version: words[GATEWARE_VERSION_AT],
            clock_hz: words[CLOCK_HZ_AT],
            channels,
            features: words[FEATURES_AT],
            boot_id: words[BOOT_ID_AT],
            blob_words: words[BLOB_WORDS_AT],
            state,
            obstacles: words[OBSTACLES_AT],
            reset_reason,
            gate_close,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::state::{FaultReason, LinkSpeed, State};

    fn describe() -> Describe {
        Describe {
            wire_version: crate::WIRE_VERSION,
            abi_firmware: 1,
            abi_gateware: 2,
            firmware_version: 0x000100,
            gateware_version: 0x000100,
            clock_hz: 60_000_000,
            channels: Channels {
                stepgens: 6,
                encoders: 6,
                pwms: 6,
                inputs: 12,
                outputs: 12,
            },
            features: 0,
            boot_id: 9,
            blob_words: 100,
            state: exchange::StateWord {
                state: State::Disarmed,
                reason: FaultReason::None,
                position_trusted: true,
                enabled: false,
                session_yours: false,
                bitten: false,
                external_reset: false,
                accepted: false,
                link: true,
                estop: false,
                speed: LinkSpeed::M1000,
                services: JobsState::Ended,
                link_errors: 200,
            },
            obstacles: OBSTACLE_ABI,
            reset_reason: ResetReason::Panic,
            gate_close: GateClose::SystemReset,
        }
    }

    #[test]
    fn a_description_survives_the_wire() {
        assert_eq!(Describe::parse(&describe().to_words()), Ok(describe()));
    }

    #[test]
    fn every_kind_of_wrong_board_is_told_apart() {
        let good = describe().to_words();
        let with = |at: usize, value| {
            let mut words = good;
            words[at] = value;
            Describe::parse(&words)
        };
        assert_eq!(with(0, 0x4c63_6e01), Err(DescribeError::Magic(0x4c63_6e01)));
        assert_eq!(
            with(1, 2),
            Err(DescribeError::Version {
                ours: crate::WIRE_VERSION,
                theirs: 2
            })
        );
        for (at, value) in [
            (6, 0),
            (7, 17),
            (8, 33),
            (11, 24),
            (12, 49),
            (13, 5000),
            (14, 99),
            (16, 5),
            (17, 7),
        ] {
            assert_eq!(
                with(at, value),
                Err(DescribeError::Malformed),
                "word {at} = {value}"
            );
        }
    }
}
