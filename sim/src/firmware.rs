//! The firmware ELF as words of the boot ROM.

use std::path::Path;

use object::read::elf::{ElfFile32, ProgramHeader};
use object::{Endianness, elf};
use wire::images::Trailer;

use crate::error::Error;

/// A firmware image, ready to be put into the ROM array of the simulated SoC.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Image {
    /// ROM contents from address 0 on, where the memory map (`memory.x`) has the ROM; little-endian
    /// words.
    pub words: Vec<u32>,
}

impl Image {
    /// Read the loadable segments of a riscv32 ELF at their load addresses, at most `rom_words`
    /// words.
    pub fn read(path: &Path, rom_words: usize) -> Result<Self, Error> {
        let data = std::fs::read(path).map_err(|source| Error::Read {
            path: path.into(),
            source,
        })?;
        Self::parse(&data, rom_words).map_err(|why| Error::Firmware {
            path: path.into(),
            why,
        })
    }

    /// Puts a trailer into the last words of a ROM of this size, as packing does.
    pub fn trailer(&mut self, trailer: Trailer, rom_words: usize) {
        self.words.resize(rom_words - Trailer::WORDS, 0);
        self.words.extend(trailer.to_words());
    }

    fn parse(data: &[u8], rom_words: usize) -> Result<Self, String> {
        let file = ElfFile32::<Endianness>::parse(data).map_err(|e| e.to_string())?;
        let endian = file.endian();
        if file.elf_header().e_machine.get(endian) != elf::EM_RISCV {
            return Err("not a RISC-V executable".into());
        }
        let mut bytes: Vec<u8> = Vec::new();
        for segment in file.elf_program_headers() {
            if segment.p_type(endian) != elf::PT_LOAD || segment.p_filesz(endian) == 0 {
                continue;
            }
            let at = segment.p_paddr(endian);
            let contents = segment
                .data(endian, data)
                .map_err(|()| "a segment lies outside the file".to_string())?;
            let end = at as usize + contents.len();
            if end > rom_words * 4 {
                return Err(format!(
                    "a segment loads to {at:#x}..{end:#x}, outside the {} byte ROM",
                    rom_words * 4
                ));
            }
            if bytes.len() < end {
                bytes.resize(end, 0);
            }
            bytes[at as usize..end].copy_from_slice(contents);
        }
        if bytes.is_empty() {
            return Err("nothing to load in it".into());
        }
        bytes.resize(bytes.len().next_multiple_of(4), 0);
        let words = bytes
            .chunks_exact(4)
            .map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]))
            .collect();
        Ok(Image { words })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A minimal ELF32 with one loadable segment at `paddr`.
    fn elf(machine: u16, paddr: u32, body: &[u8]) -> Vec<u8> {
        let mut e = vec![0x7f, b'E', b'L', b'F', 1, 1, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0];
        e.extend(2u16.to_le_bytes());
        e.extend(machine.to_le_bytes());
        for word in [1u32, 0, 52, 0, 0] {
            e.extend(word.to_le_bytes());
        }
        for half in [52u16, 32, 1, 0, 0, 0] {
            e.extend(half.to_le_bytes());
        }
        for word in [
            1,
            84,
            0x1000_0000,
            paddr,
            body.len() as u32,
            body.len() as u32,
            5,
            4,
        ] {
            e.extend(word.to_le_bytes());
        }
        e.extend(body);
        e
    }

    #[test]
    fn loads_at_the_load_address() {
        let image = Image::parse(&elf(243, 8, &[1, 2, 3, 4, 5]), 16).unwrap();
        assert_eq!(image.words, [0, 0, 0x0403_0201, 5]);
    }

    #[test]
    fn refuses_what_does_not_fit() {
        assert!(
            Image::parse(&elf(243, 8, &[0; 60]), 16)
                .unwrap_err()
                .contains("outside the 64 byte ROM")
        );
        assert!(Image::parse(&elf(243, 0x1000_0000, &[0; 4]), 16).is_err());
    }

    #[test]
    fn refuses_another_machine_and_rubbish() {
        assert!(
            Image::parse(&elf(62, 0, &[0; 4]), 16)
                .unwrap_err()
                .contains("RISC-V")
        );
        assert!(Image::parse(b"hello", 16).is_err());
    }
}
