//! The channel counts of a board: they determine the length of the exchange's blocks.

use crate::Refusal;
use crate::regmap::{self, ENCODER_MAX, IN_MAX, OUT_MAX, PWM_MAX, STEPGEN_MAX};

/// Largest number of stepgens, of encoders and of PWMs on a board.
pub const MAX_CHANNELS: usize = STEPGEN_MAX;

const _: () = assert!(ENCODER_MAX == MAX_CHANNELS && PWM_MAX == MAX_CHANNELS);

/// Inputs or outputs of a word. Only those of the first can be outputs of a job and, of a board
/// whose pins are fixed, e-stop inputs.
pub const WORD_PINS: u8 = regmap::WORD_PINS as u8;

/// How many channels of each kind a board has.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Channels {
    /// Step generators, at most 16.
    pub stepgens: u8,
    /// Encoders, at most 16.
    pub encoders: u8,
    /// PWM outputs, at most 16.
    pub pwms: u8,
    /// Inputs, at most 64.
    pub inputs: u8,
    /// Outputs, at most 64.
    pub outputs: u8,
}

impl Channels {
    /// From the two `channels` words; refused if a count is larger than the maximum.
    pub const fn from_words(channels0: u32, channels1: u32) -> Result<Self, Refusal> {
        let channels = Channels {
            stepgens: channels0 as u8,
            encoders: (channels0 >> 8) as u8,
            pwms: (channels0 >> 16) as u8,
            inputs: channels1 as u8,
            outputs: (channels1 >> 8) as u8,
        };
        let most = MAX_CHANNELS as u8;
        if channels.stepgens > most
            || channels.encoders > most
            || channels.pwms > most
            || channels.inputs > IN_MAX as u8
            || channels.outputs > OUT_MAX as u8
        {
            return Err(Refusal::Value);
        }
        Ok(channels)
    }

    /// Words for the inputs behind the first 32: one, or none.
    pub const fn inputs_high(self) -> usize {
        (self.inputs > WORD_PINS) as usize
    }

    /// Words for the outputs behind the first 32: one, or none.
    pub const fn outputs_high(self) -> usize {
        (self.outputs > WORD_PINS) as usize
    }

    /// As the two `channels` words.
    pub const fn to_words(self) -> [u32; 2] {
        [
            self.stepgens as u32 | (self.encoders as u32) << 8 | (self.pwms as u32) << 16,
            self.inputs as u32 | (self.outputs as u32) << 8,
        ]
    }
}
