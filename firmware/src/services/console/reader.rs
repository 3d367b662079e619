//! Reads the board's windows for the consoles, a few words at a time.

use crate::services::look;
use ::jobs::Outside;
use wire::describe::Channels;

/// What the consoles know of the board.
#[derive(Clone, Debug)]
pub struct Reader {
    /// How many of each channel there are.
    pub channels: Channels,
    /// The board's clock.
    pub clock_hz: u32,
}

impl Reader {
    /// Most words of a question.
    pub const WORDS: usize = 8;

    /// For the board with these channels and this clock.
    pub const fn new(channels: Channels, clock_hz: u32) -> Self {
        Reader { channels, clock_hz }
    }

    /// The words at these addresses. `None`: the board refuses.
    pub fn words<const N: usize>(
        &mut self,
        addresses: [u32; N],
        out: &mut impl Outside,
    ) -> Option<[u32; N]> {
        const { assert!(N <= Self::WORDS) };
        look::ask(addresses, out)
    }

    /// `N` words from this address on.
    pub fn block<const N: usize>(&mut self, base: u32, out: &mut impl Outside) -> Option<[u32; N]> {
        self.words(core::array::from_fn(|n| base + 4 * n as u32), out)
    }
}
