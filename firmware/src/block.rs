//! The traits with which an exchange reads a command block and writes a status block, and the
//! lengths of both on this board. [`crate::exchange`] executes them.

use wire::describe::Channels;
use wire::etherbone;
use wire::exchange::{command_words, status_words};

/// Words of an answer before its status block.
pub const REPLY_OVERHEAD: usize = 4;

/// The command block's words, each once, in order. Several words are loaded before the first is
/// used: on the softcore a word that is used right after its load costs two more clocks.
pub trait Request {
    /// The next word.
    fn take1(&mut self) -> [u32; 1];
    /// The next two words.
    fn take2(&mut self) -> [u32; 2];
    /// The next four words.
    fn take4(&mut self) -> [u32; 4];
    /// The next nine words.
    fn take9(&mut self) -> [u32; 9];
    /// Did the whole command arrive as it was sent? Asked after the last word, before anything
    /// takes effect.
    fn intact(&mut self) -> bool;
    /// The same question with the last `rest` words not yet taken.
    fn sound(&self, rest: usize) -> bool;
}

/// Takes the status block's words in order.
pub trait Reply {
    /// The next word.
    fn put(&mut self, word: u32);

    /// The next word, which does not change until the next start. A reply that already holds it
    /// skips it.
    #[inline(always)]
    fn keep(&mut self, word: u32) {
        self.put(word);
    }
}

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
        }
    }
}

/// The words of an answer before its sequence number: header, padding, record header.
pub const fn reply_head(shape: &Shape) -> [u32; 3] {
    [etherbone::HEADER, 0, etherbone::record(shape.status, 0)]
}

/// A command block in memory, already checked to be whole.
#[derive(Debug)]
pub struct SliceRequest<'w>(pub &'w [u32]);

impl SliceRequest<'_> {
    fn next<const N: usize>(&mut self) -> [u32; N] {
        match self.0.split_first_chunk() {
            Some((words, rest)) => {
                self.0 = rest;
                *words
            }
            None => [0; N], // unreachable: the block has this board's length
        }
    }
}

impl Request for SliceRequest<'_> {
    fn take1(&mut self) -> [u32; 1] {
        self.next()
    }

    fn take2(&mut self) -> [u32; 2] {
        self.next()
    }

    fn take4(&mut self) -> [u32; 4] {
        self.next()
    }

    fn take9(&mut self) -> [u32; 9] {
        self.next()
    }

    fn intact(&mut self) -> bool {
        true
    }

    fn sound(&self, _: usize) -> bool {
        true
    }
}

impl Reply for etherbone::ReplyWriter<'_> {
    fn put(&mut self, word: u32) {
        // The caller provides a buffer for the longest answer.
        let _ = self.push(word);
    }
}
