//! Reads the board's windows for the consoles, a few words at a time.

use ::jobs::Outside;
use wire::MAX_WORDS;
use wire::describe::Channels;
use wire::etherbone::{HEADER, record};

/// Header, padding, the record's header and the base its answer goes to.
const HEAD: usize = 4;

/// What the consoles know of the board, and room for its answers.
#[derive(Clone, Debug)]
pub struct Reader {
    /// How many of each channel there are.
    pub channels: Channels,
    /// The board's clock.
    pub clock_hz: u32,
    /// Kept, because to clear it for every question takes as long as to read thirty words.
    reply: [u32; MAX_WORDS],
}

impl Reader {
    /// Most words of a question.
    pub const WORDS: usize = 8;

    /// For the board with these channels and this clock.
    pub const fn new(channels: Channels, clock_hz: u32) -> Self {
        Reader {
            channels,
            clock_hz,
            reply: [0; MAX_WORDS],
        }
    }

    /// The words at these addresses. `None`: the board refuses.
    pub fn words<const N: usize>(
        &mut self,
        addresses: [u32; N],
        out: &mut impl Outside,
    ) -> Option<[u32; N]> {
        const { assert!(N <= Self::WORDS) };
        let mut request = [0; HEAD + Self::WORDS];
        let all = [HEADER, 0, record(0, N), 0].into_iter().chain(addresses);
        for (place, word) in request.iter_mut().zip(all) {
            *place = word;
        }
        let length = out.datagram(request.get(..HEAD + N)?, &mut self.reply);
        self.reply.get(HEAD..length)?.first_chunk().copied()
    }

    /// `N` words from this address on.
    pub fn block<const N: usize>(&mut self, base: u32, out: &mut impl Outside) -> Option<[u32; N]> {
        self.words(core::array::from_fn(|n| base + 4 * n as u32), out)
    }
}
