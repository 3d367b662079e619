//! Binary G-code of XYPenPlotter (`image.bin` of its `g2b.py`), read and written.
//!
//! A word with a count, then records of seven words, all little endian:
//!
//! | word | type | meaning |
//! |---|---|---|
//! | 0 | i32 | G number, 0 to 4 |
//! | 1, 2, 3 | f32 | X, Y, Z in mm; Z not below 0 lifts the pen, below 0 puts it down |
//! | 4, 5 | f32 | I, J: centre of an arc from its beginning |
//! | 6 | i32 | P: dwell |
//!
//! `0xffffffff` marks a missing field. Where its writers differ, there is a flag in [`Quirks`]:
//!
//! * **count**: `g2b.py` counts fields, seven for each record; its description says instructions.
//! * **sign**: `g2b.py` inverts Y and J, because that plotter's origin is at the top, and does not
//!   change G2 and G3. With the flag both signs are inverted again: the result is the original
//!   G-code, with Y upwards and G2 clockwise.
//! * **dwell**: the controller counts system ticks, its comment says milliseconds.
//!
//! The controller's errors are not reproduced: a missing field is missing in every instruction and
//! not NaN in some, full circles and arcs of up to 2 degrees are drawn as arcs, the last two
//! records are executed once.

use crate::circle::hypot;
use crate::instruction::{AUX_TOOL, Arc, DWELL_LONGEST, FARTHEST, Feed, Instruction, Place};
use core::fmt;

/// Words in a record.
pub const FIELDS: usize = 7;

/// A field that is not there.
pub const MISSING: u32 = u32::MAX;

/// The differences between files.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Quirks {
    /// The first word counts fields (as `g2b.py` writes it), not records.
    pub count_fields: bool,
    /// Y and J are stored with the other sign (as `g2b.py` writes them).
    pub invert_y: bool,
    /// How long P 1 is, in microseconds.
    pub dwell_micros: u32,
    /// The format has no F: speed of G1, G2 and G3.
    pub feed: Feed,
}

impl Quirks {
    /// What `g2b.py` writes.
    pub const G2B: Quirks = Quirks {
        count_fields: true,
        invert_y: true,
        dwell_micros: 1000,
        feed: Feed::Rapid,
    };
}

/// What is wrong with a file; the number is that of the record, from 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Error {
    /// The file is not a word and whole records.
    Length(usize),
    /// The first word does not count what follows.
    Count {
        /// The count in the file.
        said: u32,
        /// The number in the file, counted the same way.
        is: u32,
    },
    /// A G number that is none of 0 to 4.
    Code(usize, i32),
    /// Not a number, or beyond 10 m.
    Number(usize),
    /// An arc without I and J.
    NoCenter(usize),
    /// An arc with its end off its circle.
    OffCircle(usize),
    /// A dwell without P, with one below 0, or longer than a week.
    Dwell(usize),
}

impl fmt::Display for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Error::Length(bytes) => write!(
                f,
                "{bytes} bytes are not a count and whole records of 28 bytes"
            ),
            Error::Count { said, is } => write!(
                f,
                "the count says {said}, the file has {is} (fields or records? see the flag)"
            ),
            Error::Code(record, code) => write!(f, "record {record}: G{code} is not supported"),
            Error::Number(record) => write!(f, "record {record}: not a number of mm within 10 m"),
            Error::NoCenter(record) => write!(f, "record {record}: an arc without I and J"),
            Error::OffCircle(record) => write!(f, "record {record}: the end is not on the circle"),
            Error::Dwell(record) => write!(
                f,
                "record {record}: a dwell needs P, not below 0 and at most a week"
            ),
        }
    }
}

/// One record, with its fields as in the file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Record(pub [u32; FIELDS]);

impl Record {
    /// From its bytes.
    pub fn from_bytes(bytes: &[u8; 4 * FIELDS]) -> Self {
        Record(core::array::from_fn(|i| {
            u32::from_le_bytes([
                bytes[4 * i],
                bytes[4 * i + 1],
                bytes[4 * i + 2],
                bytes[4 * i + 3],
            ])
        }))
    }

    /// As its bytes.
    pub fn to_bytes(self) -> [u8; 4 * FIELDS] {
        core::array::from_fn(|i| self.0[i / 4].to_le_bytes()[i % 4])
    }
}

/// Reads a file, record by record.
#[derive(Clone, Debug)]
pub struct Reader<'a> {
    records: &'a [u8],
    quirks: Quirks,
    index: usize,
    at: Place,
    pen_down: bool,
    /// The rest of a record, after its pen.
    then: Option<Instruction>,
}

impl<'a> Reader<'a> {
    /// Checks the file's length and count first; otherwise nothing of it is read.
    pub fn new(file: &'a [u8], quirks: Quirks) -> Result<Self, Error> {
        let (count, records) = file.split_first_chunk().ok_or(Error::Length(file.len()))?;
        if !records.len().is_multiple_of(4 * FIELDS) {
            return Err(Error::Length(file.len()));
        }
        let said = u32::from_le_bytes(*count);
        let unit = if quirks.count_fields { 4 } else { 4 * FIELDS };
        let is = (records.len() / unit) as u32;
        if said != is {
            return Err(Error::Count { said, is });
        }
        Ok(Reader {
            records,
            quirks,
            index: 0,
            at: [0; 3],
            pen_down: false,
            then: None,
        })
    }

    fn nm(&self, field: u32, index: usize) -> Result<Option<i64>, Error> {
        if field == MISSING {
            return Ok(None);
        }
        nanometres(field).map(Some).ok_or(Error::Number(index))
    }

    /// The pen (if it changes), then the motion.
    fn read(&mut self, record: Record) -> Result<(Option<bool>, Option<Instruction>), Error> {
        let index = self.index;
        let sign = if self.quirks.invert_y { -1 } else { 1 };
        let [code, x, y, z, i, j, p] = record.0;
        let (x, y, z) = (self.nm(x, index)?, self.nm(y, index)?, self.nm(z, index)?);
        let from = self.at;
        let to = [
            x.unwrap_or(from[0]),
            y.map_or(from[1], |y| sign * y),
            from[2],
        ];
        let code = code as i32;
        let instruction = match code {
            0 | 1 => {
                let feed = if code == 0 {
                    Feed::Rapid
                } else {
                    self.quirks.feed
                };
                (to != from).then_some(Instruction::Line { to, feed })
            }
            2 | 3 => {
                let (i, j) = (self.nm(i, index)?, self.nm(j, index)?);
                if i.is_none() && j.is_none() {
                    return Err(Error::NoCenter(index));
                }
                let center = [from[0] + i.unwrap_or(0), from[1] + sign * j.unwrap_or(0)];
                let radius = hypot(from[0] - center[0], from[1] - center[1]);
                let off = (hypot(to[0] - center[0], to[1] - center[1]) - radius).abs();
                if radius == 0 || off > (radius / 1000).max(5000) {
                    return Err(Error::OffCircle(index));
                }
                Some(Instruction::Arc(Arc {
                    to,
                    center,
                    clockwise: code == 2,
                    feed: self.quirks.feed,
                }))
            }
            4 => match i32::try_from(p) {
                Ok(ticks) => {
                    // Below 2^31 by 2^32.
                    let micros =
                        u64::from(ticks.unsigned_abs()) * u64::from(self.quirks.dwell_micros);
                    if micros > DWELL_LONGEST {
                        return Err(Error::Dwell(index));
                    }
                    Some(Instruction::Dwell { micros })
                }
                Err(_) => return Err(Error::Dwell(index)),
            },
            other => return Err(Error::Code(index, other)),
        };
        if code != 4 {
            self.at = to;
        }
        Ok((z.map(|z| z < 0), instruction))
    }
}

impl Iterator for Reader<'_> {
    type Item = Result<Instruction, Error>;

    fn next(&mut self) -> Option<Self::Item> {
        loop {
            if let Some(instruction) = self.then.take() {
                return Some(Ok(instruction));
            }
            let (record, rest) = self.records.split_first_chunk()?;
            self.records = rest;
            let read = self.read(Record::from_bytes(record));
            self.index += 1;
            let (down, instruction) = match read {
                Ok(read) => read,
                Err(error) => {
                    self.records = &[];
                    return Some(Err(error));
                }
            };
            self.then = instruction;
            if let Some(down) = down.filter(|down| *down != self.pen_down) {
                self.pen_down = down;
                return Some(Ok(Instruction::Aux {
                    bits: if down { AUX_TOOL } else { 0 },
                }));
            }
        }
    }
}

/// Instructions that the format cannot represent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Unwritable {
    /// Z: in this format it is the pen.
    Height,
    /// No code for it.
    NoCode,
    /// A dwell that is not a whole number of its ticks.
    Dwell,
}

impl fmt::Display for Unwritable {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Unwritable::Height => write!(f, "the format has no height: its Z is the pen"),
            Unwritable::NoCode => write!(
                f,
                "the format has no code for home, pause and outputs but the pen"
            ),
            Unwritable::Dwell => write!(f, "the dwell is not a whole number of the format's ticks"),
        }
    }
}

/// Makes records from instructions. The caller writes the count first: [`Writer::count`] returns it
/// at the end.
#[derive(Clone, Debug)]
pub struct Writer {
    quirks: Quirks,
    at: Place,
    records: u32,
}

impl Writer {
    /// From home, pen up.
    pub const fn new(quirks: Quirks) -> Self {
        Writer {
            quirks,
            at: [0; 3],
            records: 0,
        }
    }

    /// The file's first word.
    pub fn count(&self) -> u32 {
        if self.quirks.count_fields {
            self.records * FIELDS as u32
        } else {
            self.records
        }
    }

    /// Its record; none for the end. Feeds are lost, because the format has none.
    pub fn record(&mut self, instruction: &Instruction) -> Result<Option<Record>, Unwritable> {
        let sign = if self.quirks.invert_y { -1 } else { 1 };
        let mut fields = [MISSING; FIELDS];
        match *instruction {
            Instruction::Line { to, feed } => {
                fields[0] = u32::from(feed != Feed::Rapid);
                self.go(to, sign, &mut fields)?;
            }
            Instruction::Arc(arc) => {
                fields[0] = if arc.clockwise { 2 } else { 3 };
                fields[4] = millimetres(arc.center[0] - self.at[0]);
                fields[5] = millimetres(sign * (arc.center[1] - self.at[1]));
                self.go(arc.to, sign, &mut fields)?;
            }
            Instruction::Dwell { micros } => {
                let tick = u64::from(self.quirks.dwell_micros.max(1));
                let ticks = i32::try_from(micros / tick)
                    .ok()
                    .filter(|_| micros.is_multiple_of(tick));
                fields[0] = 4;
                fields[6] = ticks.ok_or(Unwritable::Dwell)? as u32;
            }
            Instruction::Aux { bits } if bits & !AUX_TOOL == 0 => {
                fields[0] = 0;
                fields[3] = (if bits == 0 { 1.0f32 } else { -1.0 }).to_bits();
            }
            Instruction::End => return Ok(None),
            Instruction::Aux { .. } | Instruction::Home { .. } | Instruction::Pause => {
                return Err(Unwritable::NoCode);
            }
        }
        self.records += 1;
        Ok(Some(Record(fields)))
    }

    fn go(&mut self, to: Place, sign: i64, fields: &mut [u32; FIELDS]) -> Result<(), Unwritable> {
        if to[2] != self.at[2] {
            return Err(Unwritable::Height);
        }
        fields[1] = millimetres(to[0]);
        fields[2] = millimetres(sign * to[1]);
        self.at = to;
        Ok(())
    }
}

/// From an f32 in mm, to the nearest; with integers, for the softcore.
fn nanometres(bits: u32) -> Option<i64> {
    let exponent = (bits >> 23 & 0xff) as i32;
    let mantissa = i128::from(bits & 0x7f_ffff);
    let (mantissa, exponent) = match exponent {
        0xff => return None,
        0 => (mantissa, 1 - 127 - 23),
        normal => (mantissa | 0x80_0000, normal - 127 - 23),
    };
    let scaled = mantissa * 1_000_000;
    let size = match exponent {
        // 2^24 * 2^20 * 2^30 is far beyond 10 m already.
        30.. => return None,
        0..30 => scaled << exponent,
        -64..0 => (scaled + (1 << (-exponent - 1))) >> -exponent,
        _ => 0,
    };
    let size = i64::try_from(size).ok().filter(|size| *size <= FARTHEST)?;
    Some(if bits >> 31 == 1 { -size } else { size })
}

/// The nearest f32 in mm, as its bits. Only a PC writes this format.
fn millimetres(nm: i64) -> u32 {
    ((nm as f64 / 1e6) as f32).to_bits()
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use proptest::prelude::*;
    use std::string::ToString;
    use std::vec::Vec;

    const NO: u32 = MISSING;

    fn mm(value: f32) -> u32 {
        value.to_bits()
    }

    fn file(count: u32, records: &[[u32; 7]]) -> Vec<u8> {
        let words = core::iter::once(count).chain(records.iter().flatten().copied());
        words.flat_map(u32::to_le_bytes).collect()
    }

    fn read(records: &[[u32; 7]]) -> Result<Vec<Instruction>, Error> {
        Reader::new(&file(7 * records.len() as u32, records), Quirks::G2B)?.collect()
    }

    fn line(x: i64, y: i64) -> Instruction {
        Instruction::Line {
            to: [x, y, 0],
            feed: Feed::Rapid,
        }
    }

    #[test]
    fn a_drawing_as_g2b_writes_it() {
        let drawing = [
            [0, NO, NO, mm(5.0), NO, NO, NO],
            [0, mm(10.0), mm(-20.0), NO, NO, NO, NO],
            [1, NO, NO, mm(-1.0), NO, NO, NO],
            [1, mm(12.5), NO, mm(-1.0), NO, NO, NO],
            [4, NO, NO, NO, NO, NO, 150],
        ];
        assert_eq!(
            read(&drawing).unwrap(),
            [
                line(10_000_000, 20_000_000),
                Instruction::Aux { bits: 1 },
                line(12_500_000, 20_000_000),
                Instruction::Dwell { micros: 150_000 }
            ]
        );
    }

    #[test]
    fn a_missing_field_is_missing_in_every_instruction() {
        let arc = [
            [0, mm(5.0), NO, NO, NO, NO, NO],
            [3, NO, NO, NO, mm(-5.0), NO, NO],
        ];
        let Instruction::Arc(arc) = read(&arc).unwrap()[1] else {
            panic!("no arc");
        };
        // A full circle round the origin.
        assert_eq!(
            (arc.to, arc.center, arc.clockwise),
            ([5_000_000, 0, 0], [0, 0], false)
        );
        assert_eq!(
            read(&[[2, mm(1.0), NO, NO, NO, NO, NO]]),
            Err(Error::NoCenter(0))
        );
        assert_eq!(read(&[[4, NO, NO, NO, NO, NO, NO]]), Err(Error::Dwell(0)));
        // 2^31 ticks of a millisecond are 24 days.
        let long = [4, NO, NO, NO, NO, NO, i32::MAX as u32];
        assert_eq!(read(&[long]), Err(Error::Dwell(0)));
    }

    #[test]
    fn the_count_is_of_fields_or_of_records_as_the_flag_says() {
        let records = [[0, mm(1.0), NO, NO, NO, NO, NO]; 2];
        let instructions = Quirks {
            count_fields: false,
            ..Quirks::G2B
        };
        assert!(Reader::new(&file(14, &records), Quirks::G2B).is_ok());
        assert!(Reader::new(&file(2, &records), instructions).is_ok());
        let error = Reader::new(&file(2, &records), Quirks::G2B).unwrap_err();
        assert_eq!(error, Error::Count { said: 2, is: 14 });
    }

    #[test]
    fn the_sign_of_y_is_as_the_flag_says() {
        let upright = Quirks {
            invert_y: false,
            ..Quirks::G2B
        };
        let bytes = file(7, &[[2, NO, mm(2.0), NO, NO, mm(1.0), NO]]);
        let arc = |quirks| match Reader::new(&bytes, quirks).unwrap().next() {
            Some(Ok(Instruction::Arc(arc))) => (arc.to[1], arc.center[1], arc.clockwise),
            other => panic!("{other:?}"),
        };
        assert_eq!(arc(upright), (2_000_000, 1_000_000, true));
        assert_eq!(arc(Quirks::G2B), (-2_000_000, -1_000_000, true));
    }

    #[test]
    fn what_the_format_has_not_is_refused() {
        assert_eq!(
            read(&[[28, NO, NO, NO, NO, NO, NO]]),
            Err(Error::Code(0, 28))
        );
        assert_eq!(
            read(&[[0, f32::INFINITY.to_bits(), NO, NO, NO, NO, NO]]),
            Err(Error::Number(0))
        );
        assert_eq!(
            read(&[[0, mm(1e30), NO, NO, NO, NO, NO]]),
            Err(Error::Number(0))
        );
        let off = [2, mm(3.0), NO, NO, mm(1.0), NO, NO];
        assert_eq!(
            read(&[off]).unwrap_err().to_string(),
            "record 0: the end is not on the circle"
        );
        assert_eq!(
            Reader::new(&[0; 5], Quirks::G2B).unwrap_err(),
            Error::Length(5)
        );
    }

    #[test]
    fn every_record_is_read_once_the_last_two_too() {
        let records: Vec<[u32; 7]> = (1..=5)
            .map(|i| [0, mm(i as f32), NO, NO, NO, NO, NO])
            .collect();
        let expected: Vec<Instruction> = (1..=5).map(|i| line(i * 1_000_000, 0)).collect();
        assert_eq!(read(&records).unwrap(), expected);
    }

    proptest! {
        #[test]
        fn what_is_written_is_read(places in proptest::collection::vec((-60_000i64..60_000, -60_000i64..60_000), 1..20), pens in any::<u32>(), count_fields: bool, invert_y: bool) {
            let quirks = Quirks { count_fields, invert_y, ..Quirks::G2B };
            let mut program = Vec::new();
            let (mut at, mut down) = ((0, 0), false);
            for (index, &(x, y)) in places.iter().enumerate() {
                let pen = pens >> (index % 32) & 1 == 1;
                if pen != down {
                    down = pen;
                    program.push(Instruction::Aux { bits: pen.into() });
                }
                // An f32 holds every 64th of a millimetre.
                if (x, y) != at {
                    program.push(line(x * 15_625, y * 15_625));
                }
                at = (x, y);
                program.push(Instruction::Dwell { micros: index as u64 * 1000 });
            }
            let mut writer = Writer::new(quirks);
            let mut records = Vec::new();
            for instruction in &program {
                records.extend(writer.record(instruction).unwrap());
            }
            let mut bytes = writer.count().to_le_bytes().to_vec();
            bytes.extend(records.into_iter().flat_map(Record::to_bytes));
            let again: Result<Vec<Instruction>, Error> = Reader::new(&bytes, quirks).unwrap().collect();
            prop_assert_eq!(again.unwrap(), program);
        }

        #[test]
        fn numbers_are_those_of_the_library(value in -9_999.0f32..9_999.0) {
            let expected = (f64::from(value) * 1e6).round() as i64;
            prop_assert!((nanometres(value.to_bits()).unwrap() - expected).abs() <= 1);
        }

        #[test]
        fn no_bytes_make_it_panic(bytes in proptest::collection::vec(any::<u8>(), 0..200)) {
            let mut file = ((bytes.len() / 4) as u32).to_le_bytes().to_vec();
            file.extend(bytes);
            if let Ok(reader) = Reader::new(&file, Quirks::G2B) {
                let _ = reader.count();
            }
        }
    }
}
