//! The board information blob: the names of a board's channels and pins.
//!
//! The gateware build writes it from `boards/*.toml` into a small ROM; the firmware passes it on
//! without reading it; the host parses it here. Big-endian words:
//!
//! ```text
//! word 0   "FBRD"
//! word 1   blob version, 1
//! word 2   total length in bytes, a multiple of 4
//! word 3   CRC-32 (IEEE 802.3) of everything from word 4 on
//! then entries: kind u8, channel u8, length u8, 0, then `length` bytes, zero-padded to a word
//! ```
//!
//! Unknown kinds are skipped, so an older driver can read a newer board's description.
//!
//! 4 KiB have no room for one entry per channel of a large machine, so channels come as lists: an
//! entry of kind [`LIST`] holds a class letter (`s e p i o`) and then a line per channel, the first
//! of them `channel`. A line is a name, then a space and the text of [`Kind::Pins`].
//! [`Blob::entries`] splits lists, so readers see one form:
//!
//! ```text
//! 9 4 29 0 "oflood opin=j4:5\nbrake opin=j4:6"  ->  7 4 "flood", 8 4 "opin=j4:5", 7 5 "brake", 8 5 "opin=j4:6"
//! ```

pub use crate::crc::crc32;

/// "FBRD".
pub const MAGIC: u32 = 0x4642_5244;
/// Version of the layout above.
pub const VERSION: u32 = 1;
/// Code of the entry that names several channels.
pub const LIST: u8 = 9;
/// Bytes before the first entry.
pub const HEADER_LEN: usize = 16;

/// Longest name of a pin or parameter in HAL, which a channel's name is a part of: HAL_NAME_LEN
/// (47) less the `.tmax-increased` and similar suffixes HAL itself appends to functions, and what
/// LinuxCNC's manual promises.
pub const HAL_NAME_MAX: usize = 41;

/// Longest name HAL takes at all: for names that another driver has chosen.
pub const HAL_NAME_LEN: usize = 47;

/// Whether a HAL file can call a channel of another driver so, and not mean a channel's number.
pub fn is_foreign_name(text: &str) -> bool {
    let word = |b: u8| b.is_ascii_alphanumeric() || b"_-:.+/".contains(&b);
    text.bytes().all(word) && text.bytes().any(|b| !b.is_ascii_digit())
}

/// What an entry describes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Name of the PCB.
    Board,
    /// Name of the configuration.
    Configuration,
    /// A stepgen channel's own name.
    Stepgen,
    /// An encoder channel's own name.
    Encoder,
    /// A PWM channel's own name.
    Pwm,
    /// An input's own name.
    Input,
    /// An output's own name.
    Output,
    /// The header pins a channel uses; the first letter is the class (`s e p i o`).
    Pins,
    /// Default MAC address, 6 bytes.
    Mac,
    /// Default IPv4 address, 4 bytes.
    Ipv4,
    /// Default UDP port, 2 bytes, big-endian.
    Port,
    /// The FPGA in its maker's notation, e.g. `LFE5U-25F-6BG256C` ([`crate::images::idcode_of`]).
    Fpga,
    /// File name of the platform, without its ending.
    Platform,
}

impl Kind {
    /// The kind with this code, if this version knows it.
    pub const fn from_code(code: u8) -> Option<Self> {
        Some(match code {
            1 => Kind::Board,
            2 => Kind::Configuration,
            3 => Kind::Stepgen,
            4 => Kind::Encoder,
            5 => Kind::Pwm,
            6 => Kind::Input,
            7 => Kind::Output,
            8 => Kind::Pins,
            10 => Kind::Mac,
            11 => Kind::Ipv4,
            12 => Kind::Port,
            13 => Kind::Fpga,
            14 => Kind::Platform,
            _ => return None,
        })
    }
}

/// One fact from the blob.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Entry<'b> {
    /// What it describes.
    pub kind: Kind,
    /// Which channel, where the kind has channels.
    pub channel: u8,
    /// The bytes: UTF-8 for names and pins.
    pub value: &'b [u8],
}

/// Why a blob cannot be read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BlobError {
    /// Shorter than its header, or than the length in it.
    Truncated,
    /// Does not begin with "FBRD".
    Magic,
    /// Another layout.
    Version(u32),
    /// The CRC does not match the bytes.
    Crc,
    /// An entry reaches past the end.
    Entry,
}

impl core::fmt::Display for BlobError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            BlobError::Truncated => {
                f.write_str("the board information is cut short; rebuild the bitstream")
            }
            BlobError::Magic => {
                f.write_str("the board carries no board information; rebuild the bitstream")
            }
            BlobError::Version(theirs) => {
                write!(
                    f,
                    "the board information has layout {theirs}, this side knows {VERSION}; update it"
                )
            }
            BlobError::Crc => {
                f.write_str("the board information is damaged (CRC); rebuild the bitstream")
            }
            BlobError::Entry => {
                f.write_str("an entry of the board information is cut short; rebuild the bitstream")
            }
        }
    }
}

impl core::error::Error for BlobError {}

/// A blob with a right CRC and right entries.
#[derive(Clone, Copy, Debug)]
pub struct Blob<'b> {
    entries: &'b [u8],
}

impl<'b> Blob<'b> {
    /// Checks header, CRC and the extent of every entry. Bytes after the blob are ignored.
    pub fn new_checked(bytes: &'b [u8]) -> Result<Self, BlobError> {
        let word = |at: usize| -> Result<u32, BlobError> {
            let bytes = bytes.get(at..at + 4).and_then(|b| b.first_chunk::<4>());
            bytes
                .map(|b| u32::from_be_bytes(*b))
                .ok_or(BlobError::Truncated)
        };
        if word(0)? != MAGIC {
            return Err(BlobError::Magic);
        }
        if word(4)? != VERSION {
            return Err(BlobError::Version(word(4)?));
        }
        let length = word(8)? as usize;
        let entries = bytes.get(HEADER_LEN..length).ok_or(BlobError::Truncated)?;
        if crc32(entries) != word(12)? {
            return Err(BlobError::Crc);
        }
        let mut rest = entries;
        while !rest.is_empty() {
            rest = split_entry(rest).ok_or(BlobError::Entry)?.1;
        }
        Ok(Blob { entries })
    }

    /// The entries this version knows, in order, each channel of a list as entries of its own.
    pub fn entries(&self) -> impl Iterator<Item = Entry<'b>> + use<'b> {
        self.raw().flat_map(split_list)
    }

    /// The same, to be read a piece at a time.
    pub fn pieces(&self) -> Pieces {
        Pieces {
            at: HEADER_LEN,
            end: HEADER_LEN + self.entries.len(),
        }
    }

    /// Like [`Blob::entries`], but without the lists: the facts about the board itself.
    pub fn facts(&self) -> impl Iterator<Item = Entry<'b>> + use<'b> {
        self.raw().filter_map(|(code, channel, value)| {
            Some(Entry {
                kind: Kind::from_code(code)?,
                channel,
                value,
            })
        })
    }

    fn raw(&self) -> impl Iterator<Item = RawEntry<'b>> + use<'b> {
        let mut rest = self.entries;
        core::iter::from_fn(move || {
            let (raw, after) = split_entry(rest)?;
            rest = after;
            Some(raw)
        })
    }

    /// The text of the first entry of this kind and channel.
    pub fn text(&self, kind: Kind, channel: u8) -> Option<&'b str> {
        let entry = self
            .entries()
            .find(|e| e.kind == kind && e.channel == channel)?;
        core::str::from_utf8(entry.value).ok()
    }
}

/// How far the entries of a checked blob are read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Pieces {
    at: usize,
    end: usize,
}

impl Pieces {
    /// The next entries of the blob in these bytes, one or those of one list, so 255 bytes of them
    /// at most; nothing behind the last ones.
    pub fn next_of<'b>(
        &mut self,
        bytes: &'b [u8],
    ) -> Option<impl Iterator<Item = Entry<'b>> + use<'b>> {
        let rest = bytes.get(self.at..self.end)?;
        let (raw, after) = split_entry(rest)?;
        self.at = self.end - after.len();
        Some(split_list(raw))
    }
}

/// An entry, or each channel of a list as entries of its own.
fn split_list((code, channel, value): RawEntry) -> impl Iterator<Item = Entry> {
    let one = Kind::from_code(code).map(|kind| Entry {
        kind,
        channel,
        value,
    });
    let list = if code == LIST { value } else { &[] };
    one.into_iter().chain(channels_of(channel, list))
}

/// The channels of a list, each with its name and its pins.
fn channels_of(first: u8, list: &[u8]) -> impl Iterator<Item = Entry<'_>> {
    let (class, lines) = list.split_first().unwrap_or((&0, &[]));
    let class = match class {
        b's' => Some(Kind::Stepgen),
        b'e' => Some(Kind::Encoder),
        b'p' => Some(Kind::Pwm),
        b'i' => Some(Kind::Input),
        b'o' => Some(Kind::Output),
        _ => None,
    };
    let lines = lines.split(|byte| *byte == b'\n').zip(u16::from(first)..);
    lines.flat_map(move |(line, channel)| {
        let channel = class.and(u8::try_from(channel).ok());
        let end = line.iter().position(|byte| *byte == b' ');
        let entry = |kind, value| {
            Some(Entry {
                kind,
                channel: channel?,
                value,
            })
        };
        let name = class.and_then(|kind| entry(kind, line.get(..end.unwrap_or(line.len()))?));
        let pins = end.and_then(|end| entry(Kind::Pins, line.get(end + 1..)?));
        name.into_iter().chain(pins)
    })
}

type RawEntry<'b> = (u8, u8, &'b [u8]);

fn split_entry(bytes: &[u8]) -> Option<(RawEntry<'_>, &[u8])> {
    let (&[code, channel, length, _reserved], rest) = bytes.split_first_chunk::<4>()?;
    let value = rest.get(..usize::from(length))?;
    let rest = rest.get(usize::from(length).next_multiple_of(4)..)?;
    Some(((code, channel, value), rest))
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use std::vec::Vec;

    fn blob(entries: &[(u8, u8, &[u8])]) -> Vec<u8> {
        let mut body = Vec::new();
        for (code, channel, value) in entries {
            body.extend([*code, *channel, value.len() as u8, 0]);
            body.extend_from_slice(value);
            body.resize(body.len().next_multiple_of(4), 0);
        }
        let mut bytes = Vec::new();
        for word in [
            MAGIC,
            VERSION,
            (HEADER_LEN + body.len()) as u32,
            crc32(&body),
        ] {
            bytes.extend(word.to_be_bytes());
        }
        bytes.extend(body);
        bytes
    }

    #[test]
    fn a_foreign_name_is_a_word_of_a_hal_file_and_no_number() {
        for name in ["j1:10", "Spindle_On", "24V-ok", "x", "a.b"] {
            assert!(is_foreign_name(name), "{name}");
        }
        for name in ["", "7", "00", "a b", "a#", "a=b", "$a", "[a]", "\u{e4}"] {
            assert!(!is_foreign_name(name), "{name}");
        }
    }

    #[test]
    fn pieces_are_the_entries_in_their_order_and_none_is_longer_than_a_list() {
        let bytes = blob(&[
            (1, 0, b"5a-75b-8.0"),
            (200, 0, b"???"),
            (LIST, 4, b"oflood opin=j4:5\nbrake opin=j4:6"),
            (3, 2, b"z"),
        ]);
        let checked = Blob::new_checked(&bytes).unwrap();
        let mut pieces = checked.pieces();
        let mut counts = Vec::new();
        let mut entries = Vec::new();
        while let Some(piece) = pieces.next_of(&bytes) {
            let before = entries.len();
            entries.extend(piece);
            counts.push(entries.len() - before);
        }
        assert_eq!(counts, [1, 0, 4, 1]);
        assert_eq!(entries, checked.entries().collect::<Vec<_>>());
        assert!(pieces.next_of(&bytes).is_none());
        assert!(
            checked.pieces().next_of(&bytes[..20]).is_none(),
            "other bytes"
        );
    }

    #[test]
    fn names_come_back_and_unknown_kinds_are_skipped() {
        let bytes = blob(&[
            (1, 0, b"5a-75b-8.0"),
            (200, 0, b"???"),
            (3, 2, b"z"),
            (12, 0, &[4, 210]),
        ]);
        let checked = Blob::new_checked(&bytes).unwrap();
        assert_eq!(checked.text(Kind::Board, 0), Some("5a-75b-8.0"));
        assert_eq!(checked.text(Kind::Stepgen, 2), Some("z"));
        assert_eq!(checked.text(Kind::Stepgen, 1), None);
        assert_eq!(checked.entries().count(), 3);
    }

    #[test]
    fn a_list_reads_as_its_channels() {
        let bytes = blob(&[
            (2, 0, b"mill6"),
            (
                LIST,
                4,
                b"oflood opin=j4:5\nbrake\nlamp opin=j5:0 safe=high",
            ),
            (LIST, 0, b"?x y"),
            (LIST, 0, b""),
            (LIST, 255, b"ilast\nbeyond"),
        ]);
        let checked = Blob::new_checked(&bytes).unwrap();
        let found: Vec<_> = checked
            .entries()
            .map(|e| (e.kind, e.channel, e.value))
            .collect();
        let wanted: [(Kind, u8, &[u8]); 7] = [
            (Kind::Configuration, 0, b"mill6"),
            (Kind::Output, 4, b"flood"),
            (Kind::Pins, 4, b"opin=j4:5"),
            (Kind::Output, 5, b"brake"),
            (Kind::Output, 6, b"lamp"),
            (Kind::Pins, 6, b"opin=j5:0 safe=high"),
            (Kind::Input, 255, b"last"),
        ];
        assert_eq!(found, wanted);
        assert_eq!(checked.text(Kind::Output, 5), Some("brake"));
        assert_eq!(checked.facts().count(), 1);
    }

    #[test]
    fn any_flipped_bit_is_noticed() {
        let good = blob(&[(1, 0, b"board"), (2, 0, b"mill6")]);
        for bit in 0..good.len() * 8 {
            let mut bad = good.clone();
            bad[bit / 8] ^= 1 << (bit % 8);
            assert!(Blob::new_checked(&bad).is_err(), "bit {bit}");
        }
    }

    #[test]
    fn every_prefix_is_refused() {
        let good = blob(&[(1, 0, b"board")]);
        for length in 0..good.len() {
            assert!(
                Blob::new_checked(&good[..length]).is_err(),
                "{length} bytes"
            );
        }
    }

    #[test]
    fn an_entry_reaching_past_the_end_is_refused_even_with_a_right_crc() {
        let body = [3u8, 0, 200, 0];
        let mut bytes = Vec::new();
        for word in [
            MAGIC,
            VERSION,
            (HEADER_LEN + body.len()) as u32,
            crc32(&body),
        ] {
            bytes.extend(word.to_be_bytes());
        }
        bytes.extend(body);
        assert_eq!(Blob::new_checked(&bytes).unwrap_err(), BlobError::Entry);
    }
}
