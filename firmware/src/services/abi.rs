//! The interface between the ROM and the services; it is as narrow as possible.
//!
//! The services are a second link unit of this crate (`src/bin/ferrocnc-services.rs`), linked to
//! the beginning of the SDRAM. In its slot of the flash the program follows the bitstream, and its
//! last byte is the image's last:
//!
//! ```text
//!   0 CRC-32 of all words after it   1 interface   2 ABI number   3 entry   4..7 UDP ports
//!   8 where its code and constants end
//!   ... code and data ...
//!   the last two words: length in bytes, magic "FJOB"
//! ```
//!
//! Words have the softcore's byte order, lowest byte first; the CRC takes the highest byte first,
//! as usual. The ROM copies the program page by page while no host owns the board, checks it
//! ([`Check`]) and calls its entry ([`Entry`]) from the frame loop, never between a request and its
//! answer: with a frame for it ([`crate::net::Class::Services`]), and from time to time without
//! one, behind an answer to the board's owner if there is one. The program switches to a stack of
//! its own. It calls back through [`Rom`], and that is the whole interface: it asks the board with
//! the same datagrams as a host, as the peer [`crate::session::Peer::INSIDE`].
//!
//! A call does one thing: it takes a frame, lets one connection answer one request, or sends one
//! segment. A panic or a trap in the program ends the call with [`DEAD`]: the ROM keeps its own
//! registers, and is never called by the program again.

use crate::machine::VISIT_WORDS;
use crate::net::{UdpPorts, Us};
use core::ffi::c_void;
use wire::MAX_WORDS;
use wire::crc::Crc32;
use wire::describe::JobsState;
use wire::images::PROGRAM_MAX;
use wire::regmap::SDRAM_BASE;

/// Version of this interface. The program starts only if both sides have the same.
pub const INTERFACE: u32 = 7;
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
    /// Where the program listens.
    pub ports: UdpPorts,
    /// Behind its code and its constants: what is before it never changes, but for the first word.
    pub fixed_end: &'static u32,
}

/// The word of the header with [`Header::fixed_end`].
pub const FIXED_END_AT: usize = 8;
const _: () = assert!(
    core::mem::offset_of!(Header, fixed_end) == FIXED_END_AT * size_of::<usize>()
        || usize::BITS != 32
);

/// The ROM's call. With a frame: `frame` and its length. Without: null and [`POLL`]. The first
/// calls of all are null and [`START`], `START + 1` and so on, for as long as the result is
/// [`MORE`]. Otherwise the result is [`RESTLESS`], [`FAILED`], [`DEAD`] or 0.
pub type Entry = extern "C" fn(rom: &Rom, frame: *const u8, length: usize) -> u32;

/// Length of a call without a frame: time has passed.
pub const POLL: usize = 0;
/// Length of the first call, without a frame.
pub const START: usize = 1;
/// Result of [`START`]: that was a piece of the beginning. All of it takes milliseconds, and a host
/// that asks meanwhile should not wait for so long.
pub const MORE: u32 = 2;
/// Result: call again in the next turn of the loop. Otherwise 10 ms are soon enough.
pub const RESTLESS: u32 = 1;
/// Result of [`START`]: the SDRAM has an error, and the program must not be called again.
pub const FAILED: u32 = 4;
/// Result that the ROM puts in the program's place: it panicked or trapped, and must not be called
/// again.
pub const DEAD: u32 = 8;

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
    /// Judges what the client of console `visitor` asks for: the code of a
    /// [`crate::machine::Verb`] and its words. Returns that of a [`crate::machine::Verdict`].
    pub console: extern "C" fn(
        context: *mut c_void,
        visitor: usize,
        verb: u32,
        words: &mut [u32; VISIT_WORDS],
    ) -> u32,
    /// A DHCP server's address: [`crate::machine::Lease`]; prefix 0: there is none any more.
    pub leased: extern "C" fn(context: *mut c_void, ip: u32, prefix: u32, gateway: u32),
    /// Room for a frame to be sent; never that of the frame that came.
    pub output: *mut [u8; FRAME_MAX],
    /// The board's addresses.
    pub us: *const Us,
    /// A host moves the machine.
    pub moving: bool,
}

/// Longest frame, without its FCS.
pub const FRAME_MAX: usize = 1514;

/// Words that are summed at a time: a small part of what a guest's frame takes.
const PATROL: usize = 32;

/// Sums the program's code and constants, a piece at a time and again from the beginning: the SDRAM
/// may lose a bit, and what runs then is another program.
#[derive(Clone, Copy, Debug)]
pub struct Patrol {
    /// Words at the beginning of the program that never change; 0: not known.
    end: usize,
    /// Their sum as they were loaded.
    sum: u32,
    done: usize,
    crc: Crc32,
}

impl Default for Patrol {
    fn default() -> Self {
        Self::new()
    }
}

impl Patrol {
    /// Of no program.
    pub const fn new() -> Self {
        Patrol {
            end: 0,
            sum: 0,
            done: 0,
            crc: Crc32::new(),
        }
    }

    /// So many words of the program have come, which `words` begin with, and `check` has taken
    /// them. The piece that ends with the code says its sum.
    pub fn loaded(&mut self, words: &[u32], done: usize, check: &Check) {
        let end = words.get(FIXED_END_AT).copied().unwrap_or(0);
        let bytes = end.wrapping_sub(SDRAM_BASE as u32) as usize;
        if done * 4 == bytes {
            (self.end, self.done, self.sum) = (done, done, check.crc.value());
        }
    }

    /// Sums the next piece of the program, which `words` begin with. False: it is not the program
    /// that was loaded.
    pub fn step(&mut self, words: &[u32]) -> bool {
        if self.done >= self.end {
            // The first word is the CRC itself.
            (self.done, self.crc) = (usize::from(self.end > 0), Crc32::new());
        }
        let next = self.end.min(self.done + PATROL);
        let piece = words.get(self.done..next).unwrap_or(&[]);
        self.crc.update_words(piece);
        self.done = next;
        next < self.end || self.end == 0 || self.crc.value() == self.sum
    }
}

/// Is this a program for this ROM, and has the SDRAM kept it? It takes the words as the flash gives
/// them, with the length that the last ones give, and then all of them again as the SDRAM does:
/// behind the last one, because what is written to one place may change another.
///
/// The CRC takes longer than to read a word from the SDRAM, and the flash leaves time for it. So
/// what the SDRAM gives is only compared, by a hash.
#[derive(Clone, Copy, Debug)]
pub struct Check {
    crc: Crc32,
    begun: bool,
    came: Hash,
    kept: Hash,
}

/// A hash of words in their order: each word changes it one to one, so that a single wrong word
/// always shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Hash(u32);

impl Hash {
    /// An odd number with bits everywhere: 2^32 divided by the golden ratio.
    const FACTOR: u32 = 0x9e37_79b1;

    /// A multiplication moves bits up only; the rotation brings them down again.
    fn add(&mut self, word: u32) {
        self.0 = (self.0 ^ word).rotate_left(7).wrapping_mul(Self::FACTOR);
    }
}

impl Default for Check {
    fn default() -> Self {
        Self::new()
    }
}

impl Check {
    /// Before the first word.
    pub const fn new() -> Self {
        Check {
            crc: Crc32::new(),
            begun: false,
            came: Hash(0),
            kept: Hash(0),
        }
    }

    /// The next word of the flash.
    pub fn came(&mut self, word: u32) {
        self.came.add(word);
        // The first word is the CRC itself.
        if self.begun {
            self.crc.update_words(&[word]);
        }
        self.begun = true;
    }

    /// The next words of the SDRAM.
    pub fn kept(&mut self, words: &[u32]) {
        words.iter().for_each(|word| self.kept.add(*word));
    }

    /// All words have come and were kept; `words` begin as the program does.
    pub fn verdict(&self, words: &[u32], abi: u32) -> JobsState {
        let [crc, rest @ ..] = words else {
            return JobsState::Missing;
        };
        if *crc != self.crc.value() || self.came != self.kept {
            JobsState::Damaged
        } else if !rest.starts_with(&[INTERFACE, abi]) {
            JobsState::Foreign
        } else {
            JobsState::Alive
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use wire::crc::crc32_words;
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

    /// All of it at once, in halves, and word by word.
    fn check(words: &[u32], abi: u32) -> JobsState {
        let verdict = |piece: usize| {
            let mut check = Check::new();
            words.iter().for_each(|word| check.came(*word));
            words.chunks(piece).for_each(|words| check.kept(words));
            check.verdict(words, abi)
        };
        let all = [words.len().max(1), words.len() / 2 + 1, 1].map(verdict);
        assert!(all.iter().all(|state| *state == all[0]), "{all:?}");
        all[0]
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

    /// What the flash gave, and what the SDRAM gives.
    fn kept(came: &[u32], kept: &[u32]) -> JobsState {
        let mut check = Check::new();
        came.iter().for_each(|word| check.came(*word));
        check.kept(kept);
        check.verdict(kept, ABI)
    }

    #[test]
    fn an_sdram_that_does_not_keep_what_came_is_noticed() {
        let came = program();
        assert_eq!(kept(&came, &came), JobsState::Alive);
        for at in 0..came.len() {
            for bit in 0..32 {
                let mut one = came.clone();
                one[at] ^= 1 << bit;
                assert_ne!(kept(&came, &one), JobsState::Alive, "word {at} bit {bit}");
                // The same bit of two words, which a sum would not see.
                one[(at + 1) % came.len()] ^= 1 << bit;
                assert_ne!(kept(&came, &one), JobsState::Alive, "words {at}, bit {bit}");
            }
        }
        for line in 0..32 {
            let low: Vec<u32> = came.iter().map(|word| word & !(1 << line)).collect();
            let high: Vec<u32> = came.iter().map(|word| word | 1 << line).collect();
            for lines in [low, high].iter().filter(|lines| **lines != came) {
                assert_ne!(kept(&came, lines), JobsState::Alive, "line {line}");
            }
        }
        // An address line that is low: a word lies where another one lay, which came last.
        for line in (0..).map(|n| 1 << n).take_while(|line| *line < came.len()) {
            let behind = |at: usize| Some(at | line).filter(|at| *at < came.len());
            let aliased: Vec<u32> = (0..came.len())
                .map(|at| came[behind(at & !line).unwrap_or(at & !line)])
                .collect();
            assert_ne!(kept(&came, &aliased), JobsState::Alive, "line {line}");
        }
        let mut swapped = came.clone();
        swapped.swap(20, 50);
        assert_ne!(kept(&came, &swapped), JobsState::Alive);
    }

    /// A program of which the first `fixed` words never change, and its patrol, loaded in pieces of
    /// 64 words as the ROM does.
    fn loaded(fixed: usize) -> (Vec<u32>, Patrol) {
        let mut words = program();
        words.resize(1000, 0x1234_5678);
        words[FIXED_END_AT] = (SDRAM_BASE + 4 * fixed) as u32;
        let words = sealed(words);
        let (mut check, mut patrol) = (Check::new(), Patrol::new());
        for (n, piece) in words.chunks(64).enumerate() {
            piece.iter().for_each(|word| check.came(*word));
            patrol.loaded(&words, 64 * n + piece.len(), &check);
        }
        (words, patrol)
    }

    #[test]
    fn a_program_that_keeps_its_code_is_never_taken_for_another_whatever_its_data_become() {
        for fixed in [64, 128, 960] {
            let (mut words, mut patrol) = loaded(fixed);
            for turn in 0..1000 {
                assert!(patrol.step(&words), "{fixed} words, turn {turn}");
                // The test of the SDRAM overwrites the first word.
                words[0] = turn;
                words[fixed + turn as usize % (1000 - fixed)] ^= turn;
            }
        }
    }

    #[test]
    fn a_bit_of_the_code_that_turns_over_at_any_time_is_noticed_within_two_sums() {
        let fixed = 128;
        for at in 1..fixed {
            for turns in 0..8 {
                let (mut words, mut patrol) = loaded(fixed);
                (0..turns).for_each(|_| assert!(patrol.step(&words)));
                words[at] ^= 1 << (at % 32);
                let noticed = (0..2 * fixed / PATROL).any(|_| !patrol.step(&words));
                assert!(noticed, "word {at} behind {turns} turns");
            }
        }
    }

    #[test]
    fn a_program_whose_end_of_code_is_nowhere_is_not_summed() {
        for fixed in [63, 65, 1001, usize::MAX / 8] {
            let (mut words, mut patrol) = loaded(fixed);
            words[50] ^= 1;
            assert!((0..100).all(|_| patrol.step(&words)), "{fixed}");
        }
        assert!(Patrol::new().step(&[]));
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
