//! Between the ROM and the jobs program: as narrow as it can be.
//!
//! The program is a second link unit of this crate (`src/bin/ferrocnc-jobs.rs`), linked to the beginning of the SDRAM. It lies
//! behind the bitstream in its slot of the flash, its last byte being the image's last:
//!
//! ```text
//!   0 CRC-32 of all words behind it   1 interface   2 ABI number   3 entry
//!   ... code and data ...
//!   the last two words: length in bytes, magic "FJOB"
//! ```
//!
//! Words are the softcore's own, the lowest byte first; the CRC takes them as everybody's CRC of words does, the highest first. The ROM copies it, checks it ([`check`]) and calls its entry ([`Entry`])
//! from the frame loop, never between a request and its answer: with a frame nobody else wants, and now and then
//! without one. The program switches to a stack of its own. It calls back through [`Rom`], and that is all there is between them:
//! what it wants of the board it asks for with the datagrams a host would send, as the peer [`crate::session::Peer::INSIDE`].

use crate::console::{ANSWER_MAX, PROMPT};
use crate::net::Us;
use core::ffi::c_void;
use wire::MAX_WORDS;
use wire::crc::crc32_words;
use wire::describe::JobsState;
use wire::images::PROGRAM_MAX;

/// Version of this module. Unequal ones do not start.
pub const INTERFACE: u32 = 2;
/// Bytes at the beginning of the SDRAM for the program: code, data and stack. What is behind them is the jobs'.
pub const ROOM: usize = PROGRAM_MAX;

/// The header.
#[derive(Clone, Copy, Debug)]
#[repr(C)]
pub struct Header {
    /// CRC-32 of everything behind this word. Put in behind the linker.
    pub crc: u32,
    /// [`INTERFACE`].
    pub interface: u32,
    /// The register map it was built for.
    pub abi: u32,
    /// What to call.
    pub entry: Entry,
}

/// What the ROM calls: something may have come (`frame` and so many bytes), or it is just time (null, [`POLL`]). First of all, once,
/// null and [`START`]. What comes back are [`RESTLESS`] and [`TAKEN`]. Somebody at the debug console said something about jobs: his line
/// in the frame's place, [`LINE`] beside its length; [`TEXT`] has how long the answer is.
pub type Entry = extern "C" fn(rom: &Rom, frame: *const u8, length: usize) -> u32;

/// Length without a frame: it is time.
pub const POLL: usize = 0;
/// Length without a frame: it begins.
pub const START: usize = 1;
/// Beside a length: these are not a frame's bytes but a line of the debug console, ASCII, its first word `job`.
pub const LINE: usize = 1 << 16;
/// Beside [`LINE`]: whoever says it has the board's key, or there is none.
pub const TRUSTED: usize = 1 << 17;
/// Answer: call again in the next turn of the loop. Otherwise 10 ms will do.
pub const RESTLESS: u32 = 1;
/// Answer: the frame was mine.
pub const TAKEN: u32 = 2;

/// Answer to [`START`]: the SDRAM is not what it should be, and the program is not to be called again.
pub const FAILED: u32 = 4;

/// Answer to a [`LINE`]: from this bit on, how many bytes of [`Rom::output`] are text for whoever said it.
pub const TEXT: u32 = 8;
/// Bytes of that text, at most: the console's longest answer, less the prompt behind it.
pub const TEXT_MAX: usize = ANSWER_MAX - PROMPT.len();

/// What the program may use, valid for one call.
#[derive(Clone, Copy, Debug)]
#[repr(C)]
pub struct Rom {
    /// For the functions below.
    pub context: *mut c_void,
    /// A datagram to this board's own server: so many words, and room for its answer. Words of that, or -1 less the code of
    /// the [`wire::Refusal`].
    pub datagram: extern "C" fn(
        context: *mut c_void,
        request: *const u32,
        words: usize,
        reply: &mut [u32; MAX_WORDS],
    ) -> isize,
    /// Sends so many bytes of `output` as an Ethernet frame, without its FCS.
    pub send: extern "C" fn(context: *mut c_void, length: usize),
    /// Room for a frame to be sent. It may be the place of the frame that came, and of nothing that is kept.
    pub output: *mut [u8; FRAME_MAX],
    /// The board's addresses.
    pub us: *const Us,
}

/// Longest frame, without its FCS.
pub const FRAME_MAX: usize = 1514;

const _: () = assert!(FRAME_MAX < LINE && TEXT_MAX <= FRAME_MAX);

/// Is this a program for this ROM? `words` is what lies in the SDRAM, as long as its last words said it is.
pub fn check(words: &[u32], abi: u32) -> JobsState {
    let [crc, rest @ ..] = words else {
        return JobsState::Missing;
    };
    if *crc != crc32_words(rest) {
        JobsState::Damaged
    } else if !rest.starts_with(&[INTERFACE, abi]) {
        JobsState::Foreign
    } else {
        JobsState::Alive
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use wire::images::{PROGRAM_MAGIC as MAGIC, program_length as length};

    const ABI: u32 = 0x1234_5678;

    /// A program of nothing but data.
    fn program() -> Vec<u32> {
        let mut words = vec![0, INTERFACE, ABI, 0x4000_0020];
        words.extend((0..100).map(|n| n * 0x0101_0101));
        words.extend([0, MAGIC]);
        let last = words.len() - 2;
        words[last] = words.len() as u32 * 4;
        sealed(words)
    }

    fn sealed(mut words: Vec<u32>) -> Vec<u32> {
        words[0] = crc32_words(&words[1..]);
        words
    }

    #[test]
    fn a_whole_program_for_this_map_is_started() {
        let words = program();
        assert_eq!(length([words[104], words[105]]), Some(424));
        assert_eq!(check(&words, ABI), JobsState::Alive);
    }

    #[test]
    fn a_bit_that_fell_over_anywhere_starts_nothing() {
        for at in 0..program().len() {
            for bit in [0, 13, 31] {
                let mut words = program();
                words[at] ^= 1 << bit;
                assert_ne!(check(&words, ABI), JobsState::Alive, "word {at} bit {bit}");
            }
        }
    }

    #[test]
    fn a_program_for_another_map_or_interface_says_so() {
        assert_eq!(check(&program(), ABI + 1), JobsState::Foreign);
        let mut words = program();
        words[1] += 1;
        assert_eq!(check(&sealed(words), ABI), JobsState::Foreign);
    }

    #[test]
    fn what_ends_in_no_length_is_no_program() {
        for last in [
            [0xffff_ffff, 0xffff_ffff],
            [440, 0],
            [441, MAGIC],
            [ROOM as u32 + 4, MAGIC],
        ] {
            assert_eq!(length(last), None, "{last:x?}");
        }
        assert_eq!(check(&[], ABI), JobsState::Missing);
    }
}
