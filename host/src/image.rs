//! A FerroCNC bitstream file: the board it is for, and whether it is whole.
//!
//! Every file for a board's flash goes through [`Image::parse`] first. It refuses a file that is
//! cut, damaged, made for another chip, or made by another project.
//!
//! ```text
//! ff 00                                 comment header: NUL-terminated lines
//!   FerroCNC 0.1.0                        written by the build
//!   Board: mill6                          the configuration
//!   Platform: 5a-75b-8.0                  the PCB
//!   Part: LFE5U-25F-6CABGA256             the FPGA
//!   Build: 89abcdef                       the build id
//!   Length: 458090                        bytes from the preamble on
//!   CRC-32: 01234567                      of these bytes
//! ff                                    end of the header
//! ff ff bd b3                           preamble: the image begins here, this goes into the flash
//! ff .. 3b 000000 e2 000000 IDCODE ..   commands; VERIFY_ID names the FPGA it will load into
//! ```
//!
//! The header's own text is not under the CRC. Its fields are either compared (length, CRC, part
//! with the FPGA id, platform with the board's) or only names.

use wire::Name;
use wire::board::crc32;
use wire::images::{Meta, idcode_of, program_length};

/// Where the configuration begins: two dummy bytes, then the key.
const PREAMBLE: [u8; 4] = [0xff, 0xff, 0xbd, 0xb3];
/// The first bytes of a file with a comment header.
const COMMENT: [u8; 2] = [0xff, 0x00];
/// Begins the line that names the project.
const MARK: &str = "FerroCNC";
/// 16 KiB: a header has some 200 bytes; a longer one is refused.
const HEADER_MOST: usize = 16 * 1024;
/// 4 MiB: the largest flash there is.
const FILE_MOST: usize = 4 << 20;

/// ECP5 commands before VERIFY_ID: LSC_RESET_CRC and the SPI mode, each with three operand bytes.
const PASSED_OVER: [u8; 2] = [0x3b, 0x79];
/// Three operand bytes, then the idcode.
const VERIFY_ID: u8 = 0xe2;

/// An image that is whole, and what its file says of it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Image {
    /// FerroCNC's version that built it.
    pub version: String,
    /// The configuration: the board file's name.
    pub configuration: String,
    /// The PCB.
    pub platform: String,
    /// The FPGA with speed grade and package.
    pub part: String,
    /// The build id, as the running board says it.
    pub build: u32,
    /// The FPGA's id, from the image itself.
    pub idcode: u32,
    /// Of [`Image::bytes`].
    pub crc: u32,
    /// From the preamble on.
    pub bytes: Vec<u8>,
}

/// Why a file is no image for a board; it says what to do.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum ImageError {
    /// No bitstream at all.
    NoBitstream,
    /// A bitstream, but not of ours.
    Foreign,
    /// The header lacks a line.
    Missing(&'static str),
    /// The header has a line twice, and they differ.
    Twice(&'static str),
    /// A line of the header is invalid.
    Field {
        /// Which line.
        line: &'static str,
        /// What it says.
        value: String,
    },
    /// It ends before it should.
    Truncated {
        /// Bytes there should be.
        length: usize,
        /// Bytes there are.
        found: usize,
    },
    /// There is data after its end.
    Longer {
        /// Bytes there should be.
        length: usize,
        /// Bytes there are.
        found: usize,
    },
    /// The bytes are not those that were built.
    Crc {
        /// Of the file.
        header: u32,
        /// Of the bytes.
        bytes: u32,
    },
    /// It does not say for which FPGA it is.
    NoIdcode,
    /// The header names one FPGA and the image another.
    Part {
        /// As the header says.
        part: String,
        /// As the image says.
        idcode: u32,
    },
}

impl core::fmt::Display for ImageError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            ImageError::NoBitstream => f.write_str(
                "it is not an ECP5 bitstream; give the .bit file that cargo xtask bitstream wrote",
            ),
            ImageError::Foreign => f.write_str(
                "it is a bitstream, but not one of FerroCNC's; give the .bit file that cargo xtask bitstream wrote",
            ),
            ImageError::Missing(line) => write!(
                f,
                "its header has no line \"{line}\"; build it again with cargo xtask bitstream"
            ),
            ImageError::Twice(line) => {
                write!(f, "its header has two different lines \"{line}\": it is damaged; copy or build it again")
            }
            ImageError::Field { line, value } => write!(
                f,
                "its header says \"{line}: {value}\", which is invalid: the file is damaged; copy or build it again"
            ),
            ImageError::Truncated { length, found } => write!(
                f,
                "it is cut short: {found} of {length} bytes are there; copy it again"
            ),
            ImageError::Longer { length, found } => write!(
                f,
                "it has {found} bytes where its header says {length}: it is damaged; copy it again"
            ),
            ImageError::Crc { header, bytes } => write!(
                f,
                "it is damaged: its CRC is {bytes:08x} where its header says {header:08x}; copy it again"
            ),
            ImageError::NoIdcode => f.write_str(
                "it does not say for which FPGA it is; build it again with cargo xtask bitstream",
            ),
            ImageError::Part { part, idcode } => write!(
                f,
                "its header says {part}, its contents are for {}: it is damaged; build it again",
                fpga_name(*idcode)
            ),
        }
    }
}

impl std::error::Error for ImageError {}

impl Image {
    /// Takes a file's contents, or says what is wrong with them.
    pub fn parse(file: &[u8]) -> Result<Image, ImageError> {
        let file = file.get(..FILE_MOST + HEADER_MOST).unwrap_or(file);
        let text = file.strip_prefix(&COMMENT).ok_or(ImageError::NoBitstream)?;
        let end = text.iter().take(HEADER_MOST).position(|byte| *byte == 0xff);
        let (text, rest) = text.split_at(end.ok_or(ImageError::NoBitstream)?);
        let header = Header::read(text)?;
        // One 0xff ends the header, the next two belong to the preamble.
        let bytes = rest.get(1..).unwrap_or_default();
        if !bytes.starts_with(&PREAMBLE) {
            return Err(match PREAMBLE.starts_with(bytes) {
                true => ImageError::Truncated {
                    length: header.length,
                    found: bytes.len(),
                },
                false => ImageError::NoBitstream,
            });
        }
        let (length, found) = (header.length, bytes.len());
        if found < length {
            return Err(ImageError::Truncated { length, found });
        }
        if found > length {
            return Err(ImageError::Longer { length, found });
        }
        let crc = crc32(bytes);
        if crc != header.crc {
            return Err(ImageError::Crc {
                header: header.crc,
                bytes: crc,
            });
        }
        let idcode = idcode(bytes).ok_or(ImageError::NoIdcode)?;
        if idcode_of(&header.part) != Some(idcode) {
            return Err(ImageError::Part {
                part: header.part,
                idcode,
            });
        }
        Ok(Image {
            version: header.version,
            configuration: header.configuration,
            platform: header.platform,
            part: header.part,
            build: header.build,
            idcode,
            crc,
            bytes: bytes.to_vec(),
        })
    }
}

impl Image {
    /// Bytes of the services after the bitstream; 0 if there are none. The FPGA must not get it.
    pub fn program(&self) -> usize {
        let last = self.bytes.last_chunk::<8>().map(|last| {
            let [a, b, c, d, e, f, g, h] = *last;
            [[a, b, c, d], [e, f, g, h]].map(u32::from_le_bytes)
        });
        let length = last.and_then(program_length).unwrap_or(0);
        if length < self.bytes.len() { length } else { 0 }
    }

    /// What its slot's meta page says of it.
    pub fn meta(&self) -> Meta {
        Meta {
            length: self.bytes.len() as u32,
            crc: self.crc,
            build_id: self.build,
            idcode: self.idcode,
            configuration: Name::cut(&self.configuration),
            platform: Name::cut(&self.platform),
        }
    }
}

impl core::fmt::Display for Image {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(
            f,
            "{} on {}, build {:08x}, FerroCNC {}",
            self.configuration, self.platform, self.build, self.version
        )
    }
}

/// The header's lines, by name.
struct Header {
    version: String,
    configuration: String,
    platform: String,
    part: String,
    build: u32,
    length: usize,
    crc: u32,
}

impl Header {
    fn read(text: &[u8]) -> Result<Header, ImageError> {
        let text = core::str::from_utf8(text).map_err(|_| ImageError::NoBitstream)?;
        let lines = || text.split('\0').map(str::trim_end);
        let mut versions = lines().filter_map(|line| line.strip_prefix(MARK)?.strip_prefix(' '));
        let version = versions
            .next()
            .ok_or(ImageError::Foreign)?
            .trim()
            .to_owned();
        let value = |line: &'static str| -> Result<&str, ImageError> {
            let mut values = lines().filter_map(|text| text.strip_prefix(line)?.strip_prefix(':'));
            let value = values.next().ok_or(ImageError::Missing(line))?.trim();
            // The tools may say the same once more.
            match values.all(|again| again.trim() == value) {
                true => Ok(value),
                false => Err(ImageError::Twice(line)),
            }
        };
        // A name: printable, and not longer than the flash's meta page has room for.
        let name = |line| {
            let text = value(line)?;
            match text.bytes().all(|b| b.is_ascii_graphic()) && (1..=32).contains(&text.len()) {
                true => Ok(text.to_owned()),
                false => Err(ImageError::Field {
                    line,
                    value: text.escape_debug().to_string(),
                }),
            }
        };
        let number = |line, radix: u32, digits: core::ops::RangeInclusive<usize>| {
            let text = value(line)?;
            let well_formed =
                digits.contains(&text.len()) && text.chars().all(|c| c.is_digit(radix));
            let number = u32::from_str_radix(text, radix)
                .ok()
                .filter(|_| well_formed);
            number.ok_or_else(|| ImageError::Field {
                line,
                value: text.escape_debug().to_string(),
            })
        };
        Ok(Header {
            version,
            configuration: name("Board")?,
            platform: name("Platform")?,
            part: name("Part")?,
            build: number("Build", 16, 8..=8)?,
            length: number("Length", 10, 1..=10)? as usize,
            crc: number("CRC-32", 16, 8..=8)?,
        })
    }
}

/// The FPGA's id out of a configuration's VERIFY_ID.
pub fn idcode(bytes: &[u8]) -> Option<u32> {
    let mut rest = bytes.strip_prefix(&PREAMBLE)?;
    loop {
        let (command, after) = rest.split_first()?;
        rest = match *command {
            0xff => after,
            VERIFY_ID => {
                let id = after.get(3..)?.first_chunk::<4>()?;
                return Some(u32::from_be_bytes(*id));
            }
            known if PASSED_OVER.contains(&known) => after.get(3..)?,
            _ => return None,
        };
    }
}

/// Names of the chips [`wire::images::idcode_of`] knows.
const FPGAS: [&str; 10] = [
    "LFE5U-12F",
    "LFE5U-25F",
    "LFE5U-45F",
    "LFE5U-85F",
    "LFE5UM-25F",
    "LFE5UM-45F",
    "LFE5UM-85F",
    "LFE5UM5G-25F",
    "LFE5UM5G-45F",
    "LFE5UM5G-85F",
];

/// What people call the FPGA with this id.
pub fn fpga_name(idcode: u32) -> String {
    match FPGAS.iter().find(|name| idcode_of(name) == Some(idcode)) {
        Some(name) => (*name).to_owned(),
        None => format!("an FPGA with id {idcode:#010x}"),
    }
}

/// A file like the build's, for tests.
#[doc(hidden)]
pub mod sample {
    use super::{PREAMBLE, crc32};

    /// A whole file of `length` image bytes.
    pub fn file(configuration: &str, platform: &str, build: u32, length: usize) -> Vec<u8> {
        wrap(
            configuration,
            platform,
            build,
            &body(0x4111_1043, build, length),
        )
    }

    /// Image bytes: preamble, VERIFY_ID, then noise from the seed.
    pub fn body(idcode: u32, seed: u32, length: usize) -> Vec<u8> {
        let mut bytes = PREAMBLE.to_vec();
        bytes.extend([0xff, 0xff, 0xff, 0xff, 0x3b, 0, 0, 0, 0xe2, 0, 0, 0]);
        bytes.extend(idcode.to_be_bytes());
        let mut state = seed | 1;
        while bytes.len() < length {
            state ^= state << 13;
            state ^= state >> 17;
            state ^= state << 5;
            bytes.push(state as u8);
        }
        bytes
    }

    /// A header before image bytes.
    pub fn wrap(configuration: &str, platform: &str, build: u32, body: &[u8]) -> Vec<u8> {
        let mut file = vec![0xff, 0x00];
        for line in [
            "FerroCNC 0.1.0".to_owned(),
            format!("Board: {configuration:<32}"),
            format!("Platform: {platform:<32}"),
            "Part: LFE5U-25F-6CABGA256".to_owned(),
            format!("Build: {build:08x}"),
            format!("Length: {:<10}", body.len()),
            format!("CRC-32: {:08x}", crc32(body)),
        ] {
            file.extend(line.bytes());
            file.push(0);
        }
        file.push(0xff);
        file.extend(body);
        file
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn file() -> Vec<u8> {
        sample::file("mill6", "5a-75b-8.0", 0x89ab_cdef, 1500)
    }

    fn replaced(from: &str, to: &str) -> Vec<u8> {
        let file = file();
        let at = file.windows(from.len()).position(|w| w == from.as_bytes());
        let at = at.unwrap_or_else(|| panic!("{from} is not in the sample"));
        [&file[..at], to.as_bytes(), &file[at + from.len()..]].concat()
    }

    #[test]
    fn a_whole_file_says_what_it_is() {
        let image = Image::parse(&file()).unwrap();
        assert_eq!(image.configuration, "mill6");
        assert_eq!(image.platform, "5a-75b-8.0");
        assert_eq!(image.build, 0x89ab_cdef);
        assert_eq!(image.idcode, 0x4111_1043);
        assert_eq!(image.bytes.len(), 1500);
        assert_eq!(image.bytes[..4], PREAMBLE);
        assert_eq!(
            image.to_string(),
            "mill6 on 5a-75b-8.0, build 89abcdef, FerroCNC 0.1.0"
        );
    }

    #[test]
    fn a_jobs_program_behind_the_bitstream_is_told_from_it() {
        let end = |length: u32, magic: u32| [length.to_le_bytes(), magic.to_le_bytes()].concat();
        let program = |body: &[u8]| {
            let file = sample::wrap("plotter", "5a-75b-8.0", 1, body);
            Image::parse(&file).unwrap().program()
        };
        let bitstream = sample::body(0x4111_1043, 1, 1500);
        assert_eq!(program(&bitstream), 0);
        let whole = [&bitstream[..], &[0; 92], &end(100, 0x424f_4a46)].concat();
        assert_eq!(program(&whole), 100);
        for (length, magic) in [(100, 0x424f_4a47), (101, 0x424f_4a46), (9_000, 0x424f_4a46)] {
            let whole = [&bitstream[..], &[0; 92], &end(length, magic)].concat();
            assert_eq!(program(&whole), 0, "{length} {magic:x}");
        }
    }

    #[test]
    fn every_way_to_be_wrong_has_its_own_sentence() {
        let mut foreign = replaced("FerroCNC 0.1.0", "SomebodyCNC 1.");
        let error = |file: &[u8]| Image::parse(file).unwrap_err();
        assert_eq!(error(&foreign), ImageError::Foreign);
        foreign.clear();
        assert_eq!(error(&foreign), ImageError::NoBitstream);
        assert_eq!(error(b"\x7fELF and so on"), ImageError::NoBitstream);
        assert_eq!(
            error(&replaced("Build:", "Bauld:")),
            ImageError::Missing("Build")
        );
        assert_eq!(
            error(&replaced("Build: 89abcdef", "Length: 1500   ")),
            ImageError::Missing("Build")
        );
        assert_eq!(
            error(&replaced("FerroCNC 0.1.0\0", "FerroCNC 0.1.0\0Board: b\0")),
            ImageError::Twice("Board")
        );
        assert!(matches!(
            error(&replaced("Build: 89abcdef", "Build: 89abcdeg")),
            ImageError::Field { line: "Build", .. }
        ));
        assert!(matches!(
            error(&replaced("Length: 1500", "Length: +500")),
            ImageError::Field { line: "Length", .. }
        ));
        assert_eq!(
            error(&file()[..file().len() - 1]),
            ImageError::Truncated {
                length: 1500,
                found: 1499
            }
        );
        let mut longer = file();
        longer.push(0);
        assert_eq!(
            error(&longer),
            ImageError::Longer {
                length: 1500,
                found: 1501
            }
        );
        let mut flipped = file();
        *flipped.last_mut().unwrap() ^= 1;
        assert!(matches!(error(&flipped), ImageError::Crc { .. }));
        assert!(matches!(
            error(&replaced("LFE5U-25F", "LFE5U-45F")),
            ImageError::Part {
                idcode: 0x4111_1043,
                ..
            }
        ));
        let mut body = sample::body(0x4111_1043, 1, 400);
        body[12] = 0x55;
        assert_eq!(
            error(&sample::wrap("b", "p", 1, &body)),
            ImageError::NoIdcode
        );
    }

    #[test]
    fn every_prefix_of_a_file_is_refused() {
        let file = file();
        for length in 0..file.len() {
            assert!(Image::parse(&file[..length]).is_err(), "{length} bytes");
        }
    }

    #[test]
    fn every_chip_has_a_name_and_an_unknown_one_its_id() {
        for name in FPGAS {
            assert_eq!(fpga_name(idcode_of(name).unwrap()), name);
        }
        assert!(fpga_name(7).contains("0x00000007"));
    }

    /// Ways files get damaged.
    #[derive(Clone, Debug)]
    enum Damage {
        Flip(usize, u8),
        Cut(usize),
        Insert(usize, u8),
        Remove(usize, usize),
        Overwrite(usize, Vec<u8>),
    }

    fn damage() -> impl Strategy<Value = Damage> {
        // Half of it near the header, where parsing happens.
        let at = prop_oneof![0usize..260, 0usize..1750];
        prop_oneof![
            (at.clone(), 0u8..8).prop_map(|(at, bit)| Damage::Flip(at, bit)),
            at.clone().prop_map(Damage::Cut),
            (at.clone(), any::<u8>()).prop_map(|(at, byte)| Damage::Insert(at, byte)),
            (at.clone(), 1usize..40).prop_map(|(at, count)| Damage::Remove(at, count)),
            (at, proptest::collection::vec(any::<u8>(), 1..40))
                .prop_map(|(at, bytes)| Damage::Overwrite(at, bytes)),
        ]
    }

    fn apply(file: &mut Vec<u8>, damage: &Damage) {
        match damage {
            Damage::Flip(at, bit) => {
                if let Some(byte) = file.get_mut(*at) {
                    *byte ^= 1 << bit;
                }
            }
            Damage::Cut(at) => file.truncate(*at),
            Damage::Insert(at, byte) => file.insert((*at).min(file.len()), *byte),
            Damage::Remove(at, count) => {
                let from = (*at).min(file.len());
                let to = (from + count).min(file.len());
                file.drain(from..to);
            }
            Damage::Overwrite(at, bytes) => {
                for (n, byte) in bytes.iter().enumerate() {
                    if let Some(place) = file.get_mut(at + n) {
                        *place = *byte;
                    }
                }
            }
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(2048))]

        #[test]
        fn a_mangled_file_never_panics_and_never_passes_as_another_image(
            damages in proptest::collection::vec(damage(), 1..4)
        ) {
            let good = Image::parse(&file()).unwrap();
            let mut mangled = file();
            for damage in &damages {
                apply(&mut mangled, damage);
            }
            // What passes has the very bytes that were built, for the FPGA they were built for.
            if let Ok(image) = Image::parse(&mangled) {
                prop_assert_eq!(image.bytes, good.bytes);
                prop_assert_eq!((image.idcode, image.crc), (good.idcode, good.crc));
            }
        }

        #[test]
        fn noise_behind_a_header_never_panics(bytes in proptest::collection::vec(any::<u8>(), 0..400)) {
            let mut file = COMMENT.to_vec();
            file.extend(&bytes);
            prop_assert!(Image::parse(&file).is_err());
            let mut body = PREAMBLE.to_vec();
            body.extend(&bytes);
            let _ = idcode(&body);
            let _ = Image::parse(&sample::wrap("b", "p", 1, &body));
        }
    }
}
