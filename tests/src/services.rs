//! Programs for the SDRAM that fail: the services of the build with other code in a function, and
//! an SDRAM that does not keep them.

use crate::{BenchMachine, flash, parts};
use rand::Rng;
use rand_pcg::Pcg64Mcg;
use std::ops::Range;
use std::path::PathBuf;
use wire::crc::crc32_words;
use wire::refusal::COUNTERS_CALLS;
use wire::regmap::SDRAM_BASE;

/// Bytes of [`beginning`] before its end: more than one piece of the ROM's, and a part of one.
const BEGINNING: usize = 3_800;

/// What this program of the build was before it was packed.
pub fn elf(program: &[u8]) -> PathBuf {
    let name = match program.len() == flash::program_without_jobs().len() {
        true => "ferrocnc-services-without-jobs.elf",
        false => "ferrocnc-services.elf",
    };
    parts().1.with_file_name(name)
}

/// The program with this code at the beginning of the first function with `part` in its name.
pub fn broken(mut program: Vec<u8>, part: &str, code: &[u32]) -> Vec<u8> {
    let (start, end) = crate::symbol(&elf(&program), part);
    let bytes: Vec<u8> = code.iter().flat_map(|word| word.to_le_bytes()).collect();
    assert!(bytes.len() <= end - start, "{part} is too short for this");
    let at = start - SDRAM_BASE;
    program[at..at + bytes.len()].copy_from_slice(&bytes);
    program
}

/// The first bytes of the program, with the length and the magic that end one. The ROM loads it in
/// a fiftieth of the time; nothing in it is to be called.
pub fn beginning(program: &[u8]) -> Vec<u8> {
    let mut bytes = program[..BEGINNING].to_vec();
    bytes.extend((BEGINNING as u32 + 8).to_le_bytes());
    bytes.extend(&program[program.len() - 4..]);
    sealed(bytes)
}

/// Where the code of [`small`] begins: behind the header, at a line of the cache.
const CODE_AT: usize = 64;
/// Where it says that its code ends: behind a piece of the ROM's.
const CODE_END: usize = 3_584;

/// A program of nothing but a beginning that is over at once and, in a call with a frame, this
/// code; it has no stack of its own. The ROM loads it in a fiftieth of the time of the services.
pub fn small(program: &[u8], code: &[u32]) -> Vec<u8> {
    let beginning = [
        0x0005_9663, // bnez a1, 1f
        0x0000_0513, // li a0, 0
        0x0000_8067, // ret
    ];
    begins_with(program, &[&beginning[..], code].concat())
}

/// The same with this code in every call.
pub fn begins_with(program: &[u8], code: &[u32]) -> Vec<u8> {
    let mut bytes = beginning(program);
    let words = |at: usize| at..at + 4;
    bytes[words(12)].copy_from_slice(&((SDRAM_BASE + CODE_AT) as u32).to_le_bytes());
    bytes[words(32)].copy_from_slice(&((SDRAM_BASE + CODE_END) as u32).to_le_bytes());
    for (n, word) in code.iter().enumerate() {
        bytes[words(CODE_AT + 4 * n)].copy_from_slice(&word.to_le_bytes());
    }
    assert!(CODE_AT + 4 * code.len() <= CODE_END, "too much code");
    sealed(bytes)
}

/// The program in words.
fn words(program: &[u8]) -> Vec<u32> {
    let (words, _) = program.as_chunks();
    words.iter().map(|word| u32::from_le_bytes(*word)).collect()
}

/// What the ROM judges a program by, besides its sum: the words of its header, and the two at its
/// end by which it is found.
pub fn judged_by(program: &[u8]) -> Vec<u32> {
    let words = words(program);
    [&words[..HEADER], &words[words.len() - 2..]].concat()
}

/// The words after a change, with a corrected CRC.
pub fn sealed(mut bytes: Vec<u8>) -> Vec<u8> {
    let crc = crc32_words(&words(&bytes)[1..]);
    bytes[..4].copy_from_slice(&crc.to_le_bytes());
    bytes
}

/// A part of the SDRAM.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Part {
    /// Code and constants of the services.
    Code,
    /// What they write: variables, sockets, and the upper end of their stack.
    Data,
}

/// Words of the header, which the ROM reads only behind a check.
const HEADER: usize = 9;
/// Bytes of the stack that are used.
const STACK: usize = 4096;

impl Part {
    /// Its words.
    pub fn words(self, program: &[u8]) -> Vec<Range<usize>> {
        let fixed_end = program[32..36].try_into().expect("four bytes");
        let fixed_end = u32::from_le_bytes(fixed_end) as usize - SDRAM_BASE;
        assert!(fixed_end < program.len() && fixed_end.is_multiple_of(256));
        let word = |address: usize| (address - SDRAM_BASE) / 4;
        match self {
            Part::Code => {
                let all = HEADER..fixed_end / 4;
                Vec::from([all])
            }
            Part::Data => {
                let elf = elf(program);
                let end = crate::place(&elf, "__services_bss_end");
                let top = crate::place(&elf, "__services_stack");
                vec![fixed_end / 4..word(end), word(top - STACK)..word(top)]
            }
        }
    }
}

impl BenchMachine {
    /// Clocks of the longest call of the services since the start, while a host moved the machine
    /// and at any other time.
    pub fn longest_calls(&mut self) -> [u32; 2] {
        [COUNTERS_CALLS, COUNTERS_CALLS + 4].map(|at| self.read(at))
    }

    /// Turns so many bits over in these words of the SDRAM.
    pub fn turn_over(&mut self, words: &[Range<usize>], bits: usize, rng: &mut Pcg64Mcg) {
        let all: usize = words.iter().map(Range::len).sum();
        for _ in 0..bits {
            let mut at = rng.random_range(0..all);
            let range = words.iter().find(|range| {
                let here = at < range.len();
                at -= if here { 0 } else { range.len() };
                here
            });
            let word = range.map_or(0, |range| range.start + at);
            let bit = 1 << rng.random_range(0..32);
            assert!(self.rig.board.silicon().turn_sdram(word, bit));
        }
    }
}
