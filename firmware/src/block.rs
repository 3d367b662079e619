//! The lengths of an exchange's blocks on this board. [`crate::exchange`] executes it.

use wire::describe::Channels;
use wire::etherbone;
use wire::exchange::{StateWord, command_words, status_words};

/// Words of an answer before its status block.
pub const REPLY_OVERHEAD: usize = 4;

/// Bits of a state word that are set only in the answer to an accepted command.
pub const STATE_ANSWER: u32 = StateWord::SESSION_YOURS | StateWord::ACCEPTED;

/// The lengths of this board's blocks, computed once.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shape {
    /// Words of the command block.
    pub command: usize,
    /// Words of the status block.
    pub status: usize,
    pub(crate) stepgens: usize,
    pub(crate) encoders: usize,
    pub(crate) pwms: usize,
    pub(crate) outputs_high: usize,
    pub(crate) inputs_high: usize,
}

impl Shape {
    /// The lengths for a board with these channels.
    pub const fn new(channels: Channels) -> Self {
        Shape {
            command: command_words(channels),
            status: status_words(channels),
            stepgens: channels.stepgens as usize,
            encoders: channels.encoders as usize,
            pwms: channels.pwms as usize,
            outputs_high: channels.outputs_high(),
            inputs_high: channels.inputs_high(),
        }
    }
}

/// The words of an answer before its sequence number: header, padding, record header.
pub const fn reply_head(shape: &Shape) -> [u32; 3] {
    [etherbone::HEADER, 0, etherbone::record(shape.status, 0)]
}
