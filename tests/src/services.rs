//! Programs for the SDRAM that fail: the services of the build with other code in a function.

use crate::parts;
use wire::crc::crc32_words;

/// Where the program lies.
const SDRAM: usize = 0x4000_0000;

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

/// Words again behind a change: the CRC made right.
pub fn sealed(mut bytes: Vec<u8>) -> Vec<u8> {
    let (words, _) = bytes.as_chunks();
    let words: Vec<u32> = words.iter().map(|word| u32::from_le_bytes(*word)).collect();
    let crc = crc32_words(&words[1..]);
    bytes[..4].copy_from_slice(&crc.to_le_bytes());
    bytes
}
