//! Programs for the SDRAM that fail: the services of the build, with other code in one function.

use crate::parts;
use wire::crc::crc32_words;

/// Where the program lies.
const SDRAM: usize = 0x4000_0000;
/// Bytes of [`beginning`] before its end: more than one piece of the ROM's, and a part of one.
const BEGINNING: usize = 3_800;

/// The program with this code at the beginning of the first function with `part` in its name.
pub fn broken(mut program: Vec<u8>, part: &str, code: &[u32]) -> Vec<u8> {
    let elf = parts().1.with_file_name("ferrocnc-services.elf");
    let (start, end) = crate::symbol(&elf, part);
    let bytes: Vec<u8> = code.iter().flat_map(|word| word.to_le_bytes()).collect();
    assert!(bytes.len() <= end - start, "{part} is too short for this");
    let at = start - SDRAM;
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

/// The words after a change, with a corrected CRC.
pub fn sealed(mut bytes: Vec<u8>) -> Vec<u8> {
    let (words, _) = bytes.as_chunks();
    let words: Vec<u32> = words.iter().map(|word| u32::from_le_bytes(*word)).collect();
    let crc = crc32_words(&words[1..]);
    bytes[..4].copy_from_slice(&crc.to_le_bytes());
    bytes
}
