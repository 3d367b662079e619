//! Bitstreams in flash as plain data: which is whole, and which loads.
//!
//! **Meta page**, the first page of the last sector of a slot or of golden, written last: [`Meta`].
//!
//! **Stub**, a page of the first two sectors: a bitstream of nothing but the preamble and a JUMP to
//! a slot ([`Stub`]). The FPGA reads from address 0 until it finds a preamble, so it loads the
//! first live stub.
//!
//! ```text
//!   offset 0    16 bytes ff          24   22 00 00 00 00 00 00 00   control register 0 := 0
//!          16   ff ff bd b3          32   7e 00 00 00               JUMP
//!          20   ff ff ff ff          36   03 aa aa aa               SPI read, 24-bit address
//!                                    40.. ff
//! ```
//!
//! A stub is written without its preamble. Then the preamble is added, its first byte last. A stub
//! is disabled by clearing that byte. Each of the two is one byte, so after an interruption a stub
//! is either live or not, never anything else.
//!
//! **Services**, after the bitstream of a board with SDRAM. Their last two words are the last ones
//! of the image: their length in bytes and [`PROGRAM_MAGIC`], each lowest byte first
//! ([`program_length`]). The FPGA does not read that far.
//!
//! **Trailer**, the last four words of the firmware's ROM ([`Trailer`]): the id of this build.

use crate::crc::crc32_words;
use crate::flash::{Area, Layout, PAGE, Running, Slot};
use crate::{Name, regmap, words_from_bytes, words_to_bytes};

/// "FIMG".
pub const MAGIC: u32 = 0x4649_4d47;
/// Version of the meta page's layout.
pub const VERSION: u32 = 1;
/// Used words of a meta page; the rest of the page is erased.
pub const META_WORDS: usize = 6 + 2 * Name::WORDS + 1;
/// The same in bytes.
pub const META_BYTES: usize = META_WORDS * 4;

/// "FJOB".
pub const PROGRAM_MAGIC: u32 = 0x424f_4a46;
/// Longest services: 512 KiB, the part of the SDRAM for it.
pub const PROGRAM_MAX: usize = 512 * 1024;

/// Bytes of the services at the end of an image, from the image's last two words; `None` if
/// there is none.
pub const fn program_length(last: [u32; 2]) -> Option<usize> {
    let [length, magic] = last;
    let right =
        magic == PROGRAM_MAGIC && length.is_multiple_of(4) && length as usize <= PROGRAM_MAX;
    if right { Some(length as usize) } else { None }
}

/// The description of an image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Meta {
    /// Bytes of the image from the slot's start.
    pub length: u32,
    /// Their CRC-32.
    pub crc: u32,
    /// First 32 bits of the build's SHA-256.
    pub build_id: u32,
    /// The FPGA it is for ([`idcode_of`]).
    pub idcode: u32,
    /// The configuration's name.
    pub configuration: Name,
    /// The platform's name.
    pub platform: Name,
}

impl Meta {
    /// As words, CRC included.
    pub fn to_words(&self) -> [u32; META_WORDS] {
        let mut words = [0; META_WORDS];
        let head = [
            MAGIC,
            VERSION,
            self.length,
            self.crc,
            self.build_id,
            self.idcode,
        ];
        let names = self.configuration.to_words().into_iter();
        let all = head
            .into_iter()
            .chain(names)
            .chain(self.platform.to_words());
        for (place, word) in words.iter_mut().zip(all) {
            *place = word;
        }
        words[META_WORDS - 1] = sum(&words);
        words
    }

    /// Reads and checks; `None` if it is not a meta page, or if its length does not fit `area`.
    pub fn parse(words: &[u32; META_WORDS], area: Area) -> Option<Self> {
        let [magic, version, length, crc, build_id, idcode, names @ .., _] = words;
        let (configuration, platform) = names.split_first_chunk::<{ Name::WORDS }>()?;
        let right = *magic == MAGIC && *version == VERSION && words[META_WORDS - 1] == sum(words);
        if !right || *length == 0 || *length > area.image_max() {
            return None;
        }
        Some(Meta {
            length: *length,
            crc: *crc,
            build_id: *build_id,
            idcode: *idcode,
            configuration: Name::from_words(configuration).ok()?,
            platform: Name::from_words(platform.first_chunk()?).ok()?,
        })
    }

    /// As the bytes of its page.
    pub fn to_page(&self) -> [u8; PAGE as usize] {
        let mut page = [0xff; PAGE as usize];
        words_to_bytes(&self.to_words(), &mut page);
        page
    }

    /// From the first bytes of its page.
    pub fn from_page(page: &[u8], area: Area) -> Option<Self> {
        let mut words = [0; META_WORDS];
        words_from_bytes(page.get(..META_BYTES)?, &mut words).ok()?;
        Self::parse(&words, area)
    }
}

fn sum(words: &[u32; META_WORDS]) -> u32 {
    let [body @ .., _] = words;
    crc32_words(body)
}

/// A page that sends the FPGA to an address.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stub {
    /// The target: the start of an image.
    pub target: u32,
}

impl Stub {
    /// Offset of the preamble in its page.
    pub const PREAMBLE_AT: usize = 16;
    /// The bytes the FPGA looks for; the first two only keep a distance.
    pub const PREAMBLE: [u8; 4] = [0xff, 0xff, 0xbd, 0xb3];
    /// The byte that enables a stub: programmed last, cleared to disable the stub.
    pub const SWITCH_AT: usize = Self::PREAMBLE_AT + 2;
    /// Bytes of the page that are not left erased.
    pub const BYTES: usize = 40;

    /// Its page.
    pub fn to_page(self) -> [u8; PAGE as usize] {
        let [_, a, b, c] = self.target.to_be_bytes();
        let mut page = [0xff; PAGE as usize];
        let [p0, p1, p2, p3] = Self::PREAMBLE;
        let body = [
            p0, p1, p2, p3, 0xff, 0xff, 0xff,
            0xff, // LSC_PROG_CNTRL0, three unused bytes, the register
            0x22, 0, 0, 0, 0, 0, 0, 0, // JUMP, three unused bytes, SPI's slow read
            0x7e, 0, 0, 0, 0x03, a, b, c,
        ];
        for (place, byte) in page.iter_mut().skip(Self::PREAMBLE_AT).zip(body) {
            *place = byte;
        }
        page
    }

    /// The stub in the first [`Stub::BYTES`] bytes of a page, if it is live.
    pub fn from_page(page: &[u8]) -> Option<Self> {
        let page = page.first_chunk::<{ Self::BYTES }>()?;
        let [.., a, b, c] = *page;
        let stub = Stub {
            target: u32::from_be_bytes([0, a, b, c]),
        };
        stub.to_page().starts_with(page).then_some(stub)
    }

    /// Would the FPGA take this page as a bitstream, whatever follows the preamble?
    pub fn has_preamble(page: &[u8]) -> bool {
        page.get(Self::SWITCH_AT..Self::SWITCH_AT + 2) == Some(&[0xbd, 0xb3])
    }

    /// The slot it selects.
    pub fn slot(self, layout: &Layout) -> Option<Slot> {
        [Slot::A, Slot::B]
            .into_iter()
            .find(|slot| layout.slot(*slot).start == self.target)
    }
}

/// The last words of the firmware's ROM, patched when a bitstream is packed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Trailer {
    /// Build id; an image's meta page has the same.
    pub build_id: u32,
    /// Image or golden.
    pub role: Role,
}

/// How an image was packed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum Role {
    /// Not packed: a simulation.
    None = 0,
    /// An image for a slot, or to be loaded by JTAG.
    Image = regmap::ROLE_IMAGE,
    /// The golden image.
    Golden = regmap::ROLE_GOLDEN,
}

impl Trailer {
    /// "FTRL".
    pub const MAGIC: u32 = regmap::TRAILER_MAGIC;
    /// Words at the end of the ROM: magic, build id, role, 0.
    pub const WORDS: usize = 4;
    /// The trailer of a ROM without one.
    pub const NONE: Trailer = Trailer {
        build_id: 0,
        role: Role::None,
    };

    /// From the ROM's last words; [`Trailer::NONE`] if they are no trailer.
    pub const fn from_words([magic, build_id, role, _]: [u32; Self::WORDS]) -> Self {
        let role = match role {
            regmap::ROLE_IMAGE => Role::Image,
            regmap::ROLE_GOLDEN => Role::Golden,
            _ => return Self::NONE,
        };
        if magic == Self::MAGIC {
            Trailer { build_id, role }
        } else {
            Self::NONE
        }
    }

    /// As the ROM's last words.
    pub const fn to_words(self) -> [u32; Self::WORDS] {
        [Self::MAGIC, self.build_id, self.role as u32, 0]
    }

    /// The image that runs, given the selected slot and its meta page's build id.
    pub fn running(self, selected: Option<(Slot, u32)>) -> Running {
        match (self.role, selected) {
            (Role::Golden, _) => Running::Golden,
            (Role::Image, Some((Slot::A, id))) if id == self.build_id => Running::A,
            (Role::Image, Some((Slot::B, id))) if id == self.build_id => Running::B,
            (Role::None | Role::Image, _) => Running::Volatile,
        }
    }
}

/// The IDCODE of a device string such as `LFE5U-25F-6BG256C`.
pub fn idcode_of(device: &str) -> Option<u32> {
    let known = [
        ("LFE5U-12", 0x2111_1043),
        ("LFE5U-25", 0x4111_1043),
        ("LFE5U-45", 0x4111_2043),
        ("LFE5U-85", 0x4111_3043),
        ("LFE5UM-25", 0x0111_1043),
        ("LFE5UM-45", 0x0111_2043),
        ("LFE5UM-85", 0x0111_3043),
        ("LFE5UM5G-25", 0x8111_1043),
        ("LFE5UM5G-45", 0x8111_2043),
        ("LFE5UM5G-85", 0x8111_3043),
    ];
    known
        .into_iter()
        .find(|(name, _)| device.starts_with(name))
        .map(|(_, code)| code)
}

#[cfg(test)]
mod tests {
    use super::*;

    const AREA: Area = Area {
        start: 0x1_0000,
        end: 0x10_0000,
    };

    fn meta() -> Meta {
        Meta {
            length: 300_000,
            crc: 5,
            build_id: 0xdead_beef,
            idcode: 0x4111_1043,
            configuration: Name::new("mill6").unwrap(),
            platform: Name::new("5a-75b-8.0").unwrap(),
        }
    }

    #[test]
    fn a_meta_page_survives_the_flash() {
        assert_eq!(Meta::from_page(&meta().to_page(), AREA), Some(meta()));
    }

    #[test]
    fn any_flipped_bit_of_a_meta_page_is_noticed() {
        let good = meta().to_page();
        for bit in 0..META_BYTES * 8 {
            let mut bad = good;
            bad[bit / 8] ^= 1 << (bit % 8);
            assert_eq!(Meta::from_page(&bad, AREA), None, "bit {bit}");
        }
        assert_eq!(Meta::from_page(&[0xff; 256], AREA), None);
        assert_eq!(Meta::from_page(&good[..META_BYTES - 1], AREA), None);
    }

    #[test]
    fn an_image_longer_than_its_slot_is_none() {
        for (length, fits) in [(0, false), (0xe_f000, true), (0xe_f001, false)] {
            let meta = Meta { length, ..meta() };
            assert_eq!(Meta::from_page(&meta.to_page(), AREA).is_some(), fits);
        }
    }

    #[test]
    fn a_stub_is_what_the_fpgas_own_tools_write() {
        // Byte for byte what libtrellis' `generate_jump` (ecpmulti's jump page) emits for this
        // address.
        let page = Stub { target: 0x30_0000 }.to_page();
        let tool = [
            0xff, 0xff, 0xbd, 0xb3, 0xff, 0xff, 0xff, 0xff, 0x22, 0, 0, 0, 0, 0, 0, 0, 0x7e, 0, 0,
            0, 0x03, 0x30, 0, 0,
        ];
        assert_eq!(page[..16], [0xff; 16]);
        assert_eq!(page[16..40], tool);
        assert!(page[40..].iter().all(|byte| *byte == 0xff));
    }

    #[test]
    fn a_stub_survives_the_flash_and_one_cleared_bit_breaks_it() {
        let layout = Layout::of(0x40_0000).unwrap();
        for slot in [Slot::A, Slot::B] {
            let stub = Stub {
                target: layout.slot(slot).start,
            };
            let page = stub.to_page();
            assert_eq!(Stub::from_page(&page), Some(stub));
            assert_eq!(stub.slot(&layout), Some(slot));
            for bit in 0..8 {
                let mut broken = page;
                broken[Stub::SWITCH_AT] &= !(1 << bit);
                let same = broken == page;
                assert_eq!(Stub::has_preamble(&broken), same);
                assert_eq!(Stub::from_page(&broken).is_some(), same);
            }
        }
        assert_eq!(Stub::from_page(&[0xff; 256]), None);
        assert_eq!(Stub { target: 0x30_0000 }.slot(&layout), None);
    }

    #[test]
    fn the_trailer_says_what_runs() {
        let image = Trailer {
            build_id: 7,
            role: Role::Image,
        };
        assert_eq!(Trailer::from_words(image.to_words()), image);
        assert_eq!(Trailer::from_words([0, 7, 1, 0]), Trailer::NONE);
        assert_eq!(
            Trailer::from_words([Trailer::MAGIC, 7, 9, 0]),
            Trailer::NONE
        );
        assert_eq!(image.running(Some((Slot::B, 7))), Running::B);
        assert_eq!(image.running(Some((Slot::B, 8))), Running::Volatile);
        assert_eq!(image.running(None), Running::Volatile);
        let golden = Trailer {
            role: Role::Golden,
            ..image
        };
        assert_eq!(golden.running(Some((Slot::A, 7))), Running::Golden);
        assert_eq!(Trailer::NONE.running(Some((Slot::A, 0))), Running::Volatile);
    }

    #[test]
    fn devices_have_their_idcode() {
        assert_eq!(idcode_of("LFE5U-25F-6BG256C"), Some(0x4111_1043));
        assert_eq!(idcode_of("LFE5UM5G-85F-8BG381C"), Some(0x8111_3043));
        assert_eq!(idcode_of("XC7A35T"), None);
    }
}
