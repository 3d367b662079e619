//! The interface between the ROM and the jobs program; it is as narrow as possible.
//!
//! The program is a second link unit of this crate (`src/bin/ferrocnc-jobs.rs`), linked to the
//! beginning of the SDRAM. In its slot of the flash it follows the bitstream, and its last byte is
//! the image's last:
//!
//! ```text
//!   0 CRC-32 of all words after it   1 interface   2 ABI number   3 entry
//!   ... code and data ...
//!   the last two words: length in bytes, magic "FJOB"
//! ```
//!
//! Words have the softcore's byte order, lowest byte first; the CRC takes the highest byte first,
//! as usual. The ROM copies the program, checks it ([`check`]) and calls its entry ([`Entry`]) from
//! the frame loop, never between a request and its answer: with a frame for its port ([`ours`]),
//! and from time to time without one, behind an answer to the board's owner if there is one. The program switches to a stack of its own. It calls back
//! through [`Rom`], and that is the whole interface: it asks the board with the same datagrams as a
//! host, as the peer [`crate::session::Peer::INSIDE`].

use crate::console::{ANSWER_MAX, PROMPT};
use crate::net::Us;
use core::ffi::c_void;
use wire::MAX_WORDS;
use wire::crc::crc32_words;
use wire::describe::JobsState;
use wire::images::PROGRAM_MAX;

/// Version of this interface. The program starts only if both sides have the same.
pub const INTERFACE: u32 = 3;
/// Bytes at the beginning of the SDRAM for the program: code, data and stack. The jobs get the
/// rest.
pub const ROOM: usize = PROGRAM_MAX;

/// The header.
#[derive(Clone, Copy, Debug)]
#[repr(C)]
pub struct Header {
    /// CRC-32 of all words after this one. Inserted after linking.
    pub crc: u32,
    /// [`INTERFACE`].
    pub interface: u32,
    /// The register map the program was built for.
    pub abi: u32,
    /// The function to call.
    pub entry: Entry,
}

/// The ROM's call. With a frame: `frame` and its length. Without: null and [`POLL`]; the first call
/// of all is null and [`START`]. The result contains [`RESTLESS`]. A line about jobs
/// from the debug console comes in the frame's place, with [`LINE`] added to its length; [`TEXT`]
/// then gives the answer's length.
pub type Entry = extern "C" fn(rom: &Rom, frame: *const u8, length: usize) -> u32;

/// Length of a call without a frame: time has passed.
pub const POLL: usize = 0;
/// Length of the first call, without a frame.
pub const START: usize = 1;
/// Added to a length: the bytes are not a frame but a line of the debug console, ASCII, its first
/// word `job`.
pub const LINE: usize = 1 << 16;
/// Added to [`LINE`]: the console's client has proved the board's key, or there is no key.
pub const TRUSTED: usize = 1 << 17;
/// Result: call again in the next turn of the loop. Otherwise 10 ms are soon enough.
pub const RESTLESS: u32 = 1;
/// Result of [`START`]: the SDRAM has an error, and the program must not be called again.
pub const FAILED: u32 = 4;

/// Result of a [`LINE`]: from this bit on, the number of bytes of [`Rom::output`] that are text for
/// the client.
pub const TEXT: u32 = 8;
/// Longest such text: the console's longest answer without the prompt after it.
pub const TEXT_MAX: usize = ANSWER_MAX - PROMPT.len();

/// The functions and data the program may use; valid for one call.
#[derive(Clone, Copy, Debug)]
#[repr(C)]
pub struct Rom {
    /// Argument of the functions below.
    pub context: *mut c_void,
    /// Executes a datagram of `words` words on this board's own server, with room for its answer.
    /// Returns the answer's words, or -1 less the code of the [`wire::Refusal`].
    pub datagram: extern "C" fn(
        context: *mut c_void,
        request: *const u32,
        words: usize,
        reply: &mut [u32; MAX_WORDS],
    ) -> isize,
    /// Sends this many bytes of `output` as an Ethernet frame, without its FCS.
    pub send: extern "C" fn(context: *mut c_void, length: usize),
    /// Room for a frame to be sent. It may overlap the received frame, but no data that is kept.
    pub output: *mut [u8; FRAME_MAX],
    /// The board's addresses.
    pub us: *const Us,
}

/// Longest frame, without its FCS.
pub const FRAME_MAX: usize = 1514;

const _: () = assert!(FRAME_MAX < LINE && TEXT_MAX <= FRAME_MAX);

/// Is this frame for the program: TCP to the port of jobs? The ROM asks before it calls, because a
/// call from a cold cache takes thousands of clocks.
pub fn ours(frame: &[u8]) -> bool {
    let ip = frame.get(12..14) == Some(&[8, 0]) && frame.get(23) == Some(&6);
    let header = frame.get(14).map_or(0, |byte| usize::from(byte & 15) * 4);
    ip && frame.get(14 + header + 2..14 + header + 4) == Some(&wire::jobs::PORT.to_be_bytes())
}

/// Is this a program for this ROM? `words` is the SDRAM's content, with the length that its last
/// words give.
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

    /// A program that consists of data only.
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

    /// An IPv4 frame of this protocol, its header so many words long, to this TCP or UDP port.
    fn frame(protocol: u8, words: u8, port: u16) -> Vec<u8> {
        let mut frame = vec![0; 14 + usize::from(words) * 4 + 20];
        frame[12..14].copy_from_slice(&[8, 0]);
        frame[14] = 0x40 | words;
        frame[23] = protocol;
        let at = 14 + usize::from(words) * 4 + 2;
        frame[at..at + 2].copy_from_slice(&port.to_be_bytes());
        frame
    }

    #[test]
    fn the_programs_frames_are_tcp_to_its_port_and_no_others() {
        for words in [5, 6, 15] {
            assert!(ours(&frame(6, words, wire::jobs::PORT)), "{words} words");
        }
        assert!(!ours(&frame(6, 5, 23)), "the console's");
        assert!(!ours(&frame(17, 5, wire::jobs::PORT)), "UDP");
        assert!(!ours(&frame(1, 5, wire::jobs::PORT)), "a ping");
        let mut arp = frame(6, 5, wire::jobs::PORT);
        arp[13] = 6;
        assert!(!ours(&arp), "ARP");
        let whole = frame(6, 15, wire::jobs::PORT);
        for length in 0..14 + 60 + 4 {
            assert!(!ours(&whole[..length]), "{length} bytes of it");
        }
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
