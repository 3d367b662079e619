//! The job file: [`Instruction`]s, checked, in blocks that can be sent, stored and resumed one by
//! one.
//!
//! ```text
//! file    = block*                      the first is the header, the last the end
//! block   = "FJ" kind:u8 0 length:u32 payload[length] crc:u32        all little endian
//! kind    = 1 header, 2 instructions, 3 end
//! crc     = CRC-32 (Ethernet's) of everything in the block before it, beginning at "FJ"; it continues from the crc
//!           of the block before, so that no block can be lost, doubled or moved
//! header  = version:u8 name (the rest, UTF-8)
//! end     = instructions:u32 lowest:i64 x 3 highest:i64 x 3           the extents in nm
//! ```
//!
//! An instruction is a byte (low half: the kind; high half: the fields that follow), then varints
//! (seven bits a byte, lowest first; signed ones zigzag). Lines, positions and centres are
//! differences to those of the instruction before, so that a short line takes 6 bytes.
//!
//! | low half | instruction | fields, each if its bit is set |
//! |---|---|---|
//! | 0 | rapid | `10` X `20` Y `40` Z `80` source line |
//! | 1 | line | the same; its feed is the last `6` |
//! | 2, 3 | arc clockwise, counterclockwise | the same, then I and J from the beginning |
//! | 4 | dwell, microseconds | `80` source line |
//! | 5 | outputs, bits | `80` source line |
//! | 6 | feed, nm/s | |
//! | 7 | home | `10` X `20` Y `40` Z, `80` source line |
//! | 8, 9 | pause, end of program | `80` source line |
//!
//! No instruction crosses a block's end, and a block holds at most [`BLOCK`] bytes of them. So a
//! reader needs memory for one block, and a sender can continue with the block after the last one
//! that arrived. The state of the differences continues across blocks.

use crate::instruction::{Arc, CENTER_FARTHEST, DWELL_LONGEST, FARTHEST, Feed, Instruction, Place};
use core::fmt;
use wire::crc::Crc32;

/// The only version.
pub const VERSION: u8 = 1;

/// Largest number of instruction bytes in a block.
pub const BLOCK: usize = 1024;

/// Bytes around a block's payload.
pub const FRAME: usize = HEAD + 4;

/// Longest name of a job, in bytes.
pub const NAME: usize = 64;

const HEAD: usize = 8;
const MAGIC: [u8; 2] = *b"FJ";

/// The longest instruction: a byte and seven varints of ten bytes.
const LONGEST: usize = 64;

/// The kind of a block.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Version and name.
    Header,
    /// Instructions.
    Instructions,
    /// Count and extents.
    End,
}

impl Kind {
    const fn code(self) -> u8 {
        match self {
            Kind::Header => 1,
            Kind::Instructions => 2,
            Kind::End => 3,
        }
    }

    const fn from_code(code: u8) -> Option<Kind> {
        match code {
            1 => Some(Kind::Header),
            2 => Some(Kind::Instructions),
            3 => Some(Kind::End),
            _ => None,
        }
    }
}

/// What is wrong with a job file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Error {
    /// There is no block at this place.
    NoBlock,
    /// The file ends within a block, or without its last block.
    Cut,
    /// Garbled, or a block is missing before it.
    Crc {
        /// The CRC in the block.
        said: u32,
        /// The CRC of the block.
        is: u32,
    },
    /// A header, an end or a name at a wrong place.
    Order,
    /// Of another version.
    Version {
        /// Its version.
        theirs: u8,
    },
    /// An unknown instruction, or one with impossible fields.
    Instruction(u8),
    /// The end gives another number of instructions than there are.
    Count {
        /// The number in the end.
        said: u32,
        /// The number of instructions read.
        is: u32,
    },
}

impl fmt::Display for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Error::NoBlock => write!(f, "this is no job file"),
            Error::Cut => write!(f, "the job is not complete"),
            Error::Crc { said, is } => write!(
                f,
                "garbled, or a block is missing: CRC {said:08x} said, {is:08x} counted"
            ),
            Error::Order => write!(f, "a block where it does not belong"),
            Error::Version { theirs } => write!(
                f,
                "the job is of version {theirs}, this reads {VERSION}: prepare it again"
            ),
            Error::Instruction(code) => write!(
                f,
                "instruction {code:#04x} is not known here or has impossible fields"
            ),
            Error::Count { said, is } => {
                write!(f, "the job should have {said} instructions, it has {is}")
            }
        }
    }
}

/// The content of the end.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Summary {
    /// Instructions of the program, feeds not counted.
    pub instructions: u32,
    /// The smallest X, Y and Z of any instruction's end, in nm. (An arc may reach further.)
    pub lowest: Place,
    /// The largest.
    pub highest: Place,
}

impl Summary {
    const NONE: Summary = Summary {
        instructions: 0,
        lowest: [0; 3],
        highest: [0; 3],
    };
    const BYTES: usize = 4 + 6 * 8;

    fn add(&mut self, at: &Place) {
        self.instructions = self.instructions.saturating_add(1);
        for (axis, nm) in at.iter().enumerate() {
            self.lowest[axis] = self.lowest[axis].min(*nm);
            self.highest[axis] = self.highest[axis].max(*nm);
        }
    }

    fn bytes(&self) -> [u8; Summary::BYTES] {
        let mut bytes = [0; Summary::BYTES];
        bytes[..4].copy_from_slice(&self.instructions.to_le_bytes());
        for (place, nm) in bytes[4..]
            .chunks_exact_mut(8)
            .zip(self.lowest.iter().chain(&self.highest))
        {
            place.copy_from_slice(&nm.to_le_bytes());
        }
        bytes
    }

    fn parse(bytes: &[u8]) -> Option<Summary> {
        let bytes: &[u8; Summary::BYTES] = bytes.try_into().ok()?;
        let (count, places) = bytes.split_first_chunk()?;
        let nm = |index: usize| {
            let place = places.get(8 * index..8 * index + 8)?;
            Some(i64::from_le_bytes(place.try_into().ok()?))
        };
        Some(Summary {
            instructions: u32::from_le_bytes(*count),
            lowest: [nm(0)?, nm(1)?, nm(2)?],
            highest: [nm(3)?, nm(4)?, nm(5)?],
        })
    }
}

/// The state that the differences refer to.
#[derive(Clone, Copy, Debug)]
struct State {
    at: Place,
    feed: Option<u32>,
    line: u32,
}

const START: State = State {
    at: [0; 3],
    feed: None,
    line: 0,
};

/// Writes a job into blocks. The caller takes each block (writes it, sends it) before the next is
/// made.
#[derive(Clone, Debug)]
pub struct Writer {
    block: [u8; HEAD + BLOCK + 4],
    length: usize,
    crc: u32,
    state: State,
    summary: Summary,
}

impl Writer {
    /// The first block, and the writer of the others. A name is cut at 64 bytes.
    pub fn new(name: &str) -> Self {
        let mut writer = Writer {
            block: [0; HEAD + BLOCK + 4],
            length: HEAD,
            crc: 0,
            state: START,
            summary: Summary::NONE,
        };
        let end = (0..=NAME.min(name.len()))
            .rev()
            .find(|end| name.is_char_boundary(*end));
        writer.append(&[VERSION]);
        writer.append(&name.as_bytes()[..end.unwrap_or(0)]);
        writer
    }

    /// The block of the name: the first.
    pub fn header(&mut self) -> &[u8] {
        self.close(Kind::Header)
    }

    /// Adds an instruction; `line` is that of its source. When the block is full, the complete
    /// block is returned, and this instruction is in the next.
    pub fn add(&mut self, instruction: &Instruction, line: u32, mut full: impl FnMut(&[u8])) {
        if self.length + 2 * LONGEST > HEAD + BLOCK {
            full(self.close(Kind::Instructions));
        }
        let (to, feed) = match *instruction {
            Instruction::Line { to, feed } => (to, Some(feed)),
            Instruction::Arc(arc) => (arc.to, Some(arc.feed)),
            Instruction::Home { axes } => {
                let at = self.state.at;
                (
                    core::array::from_fn(|axis| if axes[axis] { 0 } else { at[axis] }),
                    None,
                )
            }
            Instruction::Dwell { .. }
            | Instruction::Aux { .. }
            | Instruction::Pause
            | Instruction::End => (self.state.at, None),
        };
        if let Some(Feed::Rate(rate)) = feed.filter(|feed| *feed != Feed::Rapid)
            && self.state.feed.replace(rate) != Some(rate)
        {
            self.append(&[6]);
            self.varint(rate.into());
        }
        let from = core::mem::replace(&mut self.state.at, to);
        let mut fields = if line == self.state.line { 0 } else { 0x80 };
        let code = match *instruction {
            Instruction::Line { feed, .. } => u8::from(feed != Feed::Rapid),
            Instruction::Arc(arc) => {
                if arc.clockwise {
                    2
                } else {
                    3
                }
            }
            Instruction::Dwell { .. } => 4,
            Instruction::Aux { .. } => 5,
            Instruction::Home { .. } => 7,
            Instruction::Pause => 8,
            Instruction::End => 9,
        };
        let moves = code < 4;
        for axis in 0..3 {
            let named = match *instruction {
                Instruction::Home { axes } => axes[axis],
                _ => to[axis] != from[axis],
            };
            fields |= u8::from(named) << (4 + axis);
        }
        self.append(&[code | fields]);
        for axis in (0..3).filter(|axis| moves && fields >> (4 + axis) & 1 == 1) {
            self.signed(to[axis] - from[axis]);
        }
        if fields & 0x80 != 0 {
            self.signed(i64::from(line) - i64::from(self.state.line));
            self.state.line = line;
        }
        match *instruction {
            Instruction::Arc(arc) => {
                self.signed(arc.center[0] - from[0]);
                self.signed(arc.center[1] - from[1]);
            }
            Instruction::Dwell { micros } => self.varint(micros),
            Instruction::Aux { bits } => self.varint(bits.into()),
            Instruction::Line { .. }
            | Instruction::Home { .. }
            | Instruction::Pause
            | Instruction::End => {}
        }
        self.summary.add(&to);
    }

    /// The last instructions and the end.
    pub fn finish(mut self, mut full: impl FnMut(&[u8])) -> Summary {
        if self.length > HEAD {
            full(self.close(Kind::Instructions));
        }
        self.append(&self.summary.bytes());
        full(self.close(Kind::End));
        self.summary
    }

    fn close(&mut self, kind: Kind) -> &[u8] {
        let length = (self.length - HEAD) as u32;
        self.block[..2].copy_from_slice(&MAGIC);
        self.block[2] = kind.code();
        self.block[3] = 0;
        self.block[4..HEAD].copy_from_slice(&length.to_le_bytes());
        self.crc = crc(self.crc, &self.block[..self.length]);
        let end = self.length + 4;
        self.block[self.length..end].copy_from_slice(&self.crc.to_le_bytes());
        self.length = HEAD;
        &self.block[..end]
    }

    fn append(&mut self, bytes: &[u8]) {
        let end = self.length + bytes.len();
        self.block[self.length..end].copy_from_slice(bytes);
        self.length = end;
    }

    fn varint(&mut self, mut value: u64) {
        while value >= 0x80 {
            self.append(&[value as u8 | 0x80]);
            value >>= 7;
        }
        self.append(&[value as u8]);
    }

    fn signed(&mut self, value: i64) {
        self.varint((value << 1 ^ value >> 63) as u64);
    }
}

/// Continues from the block before.
fn crc(before: u32, bytes: &[u8]) -> u32 {
    let mut crc = Crc32::new();
    crc.update(&before.to_le_bytes());
    crc.update(bytes);
    crc.value()
}

/// A block with a right CRC.
#[derive(Clone, Copy, Debug)]
pub struct Block<'a> {
    /// Its kind.
    pub kind: Kind,
    /// Its content.
    pub payload: &'a [u8],
    /// With its frame.
    pub length: usize,
    /// The CRC that the next block continues from.
    pub crc: u32,
}

impl<'a> Block<'a> {
    /// The block at the beginning of `bytes`, which may hold more. `before`: the CRC of the block
    /// before, 0 for the first.
    pub fn parse(bytes: &'a [u8], before: u32) -> Result<Block<'a>, Error> {
        let head: &[u8; HEAD] = bytes.first_chunk().ok_or(Error::Cut)?;
        let [f, j, code, zero, a, b, c, d] = *head;
        let kind = Kind::from_code(code).filter(|_| [f, j] == MAGIC && zero == 0);
        let kind = kind.ok_or(Error::NoBlock)?;
        let length = u32::from_le_bytes([a, b, c, d]) as usize;
        if length > BLOCK {
            return Err(Error::NoBlock);
        }
        let end = HEAD + length;
        let (content, rest) = bytes.split_at_checked(end).ok_or(Error::Cut)?;
        let said = u32::from_le_bytes(*rest.first_chunk().ok_or(Error::Cut)?);
        let is = crc(before, content);
        if said != is {
            return Err(Error::Crc { said, is });
        }
        Ok(Block {
            kind,
            payload: &content[HEAD..],
            length: end + 4,
            crc: is,
        })
    }
}

/// Reads a job, block by block.
#[derive(Clone, Debug)]
pub struct Reader {
    crc: u32,
    state: State,
    summary: Summary,
    begun: bool,
    ended: bool,
}

impl Default for Reader {
    fn default() -> Self {
        Reader {
            crc: 0,
            state: START,
            summary: Summary::NONE,
            begun: false,
            ended: false,
        }
    }
}

impl Reader {
    /// The next block of the file, at the beginning of `bytes`. Its instructions go to `each` with
    /// their source lines; returns the block's length. An error does not affect the blocks before
    /// it.
    pub fn block(
        &mut self,
        bytes: &[u8],
        mut each: impl FnMut(Instruction, u32),
    ) -> Result<usize, Error> {
        let block = Block::parse(bytes, self.crc)?;
        match (block.kind, self.begun, self.ended) {
            (Kind::Header, false, false) => {
                name_of(block.payload)?;
                self.begun = true;
            }
            (Kind::Instructions, true, false) => {
                let mut fields = Fields(block.payload);
                while !fields.0.is_empty() {
                    if let Some(instruction) = self.instruction(&mut fields)? {
                        each(instruction, self.state.line);
                    }
                }
            }
            (Kind::End, true, false) => {
                let said = Summary::parse(block.payload).ok_or(Error::Order)?;
                if said != self.summary {
                    let (said, is) = (said.instructions, self.summary.instructions);
                    return Err(Error::Count { said, is });
                }
                self.ended = true;
            }
            (Kind::Header, ..) | (Kind::Instructions, ..) | (Kind::End, ..) => {
                return Err(Error::Order);
            }
        }
        self.crc = block.crc;
        Ok(block.length)
    }

    /// The end was read, and it was right.
    pub fn summary(&self) -> Option<Summary> {
        self.ended.then_some(self.summary)
    }

    /// None for a feed.
    fn instruction(&mut self, fields: &mut Fields) -> Result<Option<Instruction>, Error> {
        let [first] = fields.bytes().ok_or(Error::Instruction(0))?;
        let read = self.read(first, fields);
        let (to, instruction) = read.ok_or(Error::Instruction(first))?;
        let near = |nm: i64| nm.unsigned_abs() <= FARTHEST.unsigned_abs();
        if !to.iter().all(|nm| near(*nm)) {
            return Err(Error::Instruction(first));
        }
        self.state.at = to;
        if instruction.is_some() {
            self.summary.add(&to);
        }
        Ok(instruction)
    }

    fn read(&mut self, first: u8, fields: &mut Fields) -> Option<(Place, Option<Instruction>)> {
        let (code, has) = (first & 0xf, |bit: usize| first >> (4 + bit) & 1 == 1);
        let axes = core::array::from_fn(has);
        let from = self.state.at;
        let mut to = from;
        if code == 6 {
            let feed = u32::try_from(fields.varint()?)
                .ok()
                .filter(|feed| *feed > 0 && first == 6)?;
            self.state.feed = Some(feed);
            return Some((to, None));
        }
        if code < 4 {
            for axis in (0..3).filter(|axis| axes[*axis]) {
                to[axis] = from[axis].checked_add(fields.signed()?)?;
            }
        } else if code != 7 && axes != [false; 3] {
            return None;
        }
        if has(3) {
            let line = i64::from(self.state.line).checked_add(fields.signed()?)?;
            self.state.line = u32::try_from(line).ok()?;
        }
        let feed = self.state.feed.map(Feed::Rate);
        let instruction = match code {
            0 => Instruction::Line {
                to,
                feed: Feed::Rapid,
            },
            1 => Instruction::Line { to, feed: feed? },
            2 | 3 => {
                let center = [
                    from[0].checked_add(fields.signed()?)?,
                    from[1].checked_add(fields.signed()?)?,
                ];
                let arc = Arc {
                    to,
                    center,
                    clockwise: code == 2,
                    feed: feed?,
                };
                let near = center
                    .iter()
                    .all(|nm| nm.unsigned_abs() <= CENTER_FARTHEST.unsigned_abs());
                near.then_some(Instruction::Arc(arc))?
            }
            4 => Instruction::Dwell {
                micros: fields.varint().filter(|micros| *micros <= DWELL_LONGEST)?,
            },
            5 => Instruction::Aux {
                bits: u16::try_from(fields.varint()?).ok()?,
            },
            7 => {
                to = core::array::from_fn(|axis| if axes[axis] { 0 } else { from[axis] });
                Instruction::Home { axes }
            }
            8 => Instruction::Pause,
            9 => Instruction::End,
            _ => return None,
        };
        Some((to, Some(instruction)))
    }
}

/// Reads a job instruction by instruction, on demand: with memory for one block.
#[derive(Clone, Debug)]
pub struct Pull {
    reader: Reader,
    block: [u8; BLOCK + FRAME],
    /// The number of bytes in it, the start of the next instruction, and the end of the
    /// instructions.
    loaded: usize,
    at: usize,
    end: usize,
}

impl Default for Pull {
    fn default() -> Self {
        Pull {
            reader: Reader::default(),
            block: [0; BLOCK + FRAME],
            loaded: 0,
            at: 0,
            end: 0,
        }
    }
}

impl Pull {
    /// The next instruction and its source line. `None`: there is none now; ask again unless it is
    /// [`Pull::ended`]. `fill` writes the next bytes of the file and returns their number.
    pub fn next(
        &mut self,
        fill: impl FnOnce(&mut [u8]) -> usize,
    ) -> Result<Option<(Instruction, u32)>, Error> {
        while self.at < self.end {
            let mut fields = Fields(self.block.get(self.at..self.end).unwrap_or(&[]));
            let read = self.reader.instruction(&mut fields)?;
            self.at = self.end - fields.0.len();
            if let Some(instruction) = read {
                return Ok(Some((instruction, self.reader.state.line)));
            }
        }
        if self.ended() {
            return Ok(None);
        }
        // The finished block is removed, with its CRC.
        let done = if self.end > 0 { self.end + 4 } else { 0 };
        self.block.copy_within(done..self.loaded, 0);
        self.loaded -= done;
        (self.at, self.end) = (0, 0);
        self.loaded += fill(self.block.get_mut(self.loaded..).unwrap_or(&mut []));
        let known = self.block.get(..self.loaded).unwrap_or(&[]);
        let block = Block::parse(known, self.reader.crc)?;
        let (length, crc) = (block.length, block.crc);
        if block.kind == Kind::Instructions && self.reader.begun && !self.reader.ended {
            self.reader.crc = crc;
            (self.at, self.end) = (HEAD, length - 4);
        } else {
            self.reader.block(known, |_, _| {})?;
            (self.at, self.end) = (length - 4, length - 4);
        }
        Ok(None)
    }

    /// The end was read, and it was right.
    pub fn ended(&self) -> bool {
        self.reader.ended
    }
}

/// Version and name of a header.
pub fn name_of(header: &[u8]) -> Result<&str, Error> {
    match header.split_first() {
        None => Err(Error::Order),
        Some((&VERSION, name)) if name.len() <= NAME => {
            core::str::from_utf8(name).map_err(|_| Error::Order)
        }
        Some((&VERSION, _)) => Err(Error::Order),
        Some((&theirs, _)) => Err(Error::Version { theirs }),
    }
}

/// The rest of a block.
struct Fields<'a>(&'a [u8]);

impl Fields<'_> {
    fn bytes<const N: usize>(&mut self) -> Option<[u8; N]> {
        let (bytes, rest) = self.0.split_first_chunk()?;
        self.0 = rest;
        Some(*bytes)
    }

    fn varint(&mut self) -> Option<u64> {
        let mut value = 0;
        for shift in (0..64).step_by(7) {
            let [byte] = self.bytes()?;
            let bits = u64::from(byte & 0x7f);
            if bits << shift >> shift != bits {
                return None;
            }
            value |= bits << shift;
            if byte < 0x80 {
                return Some(value);
            }
        }
        None
    }

    fn signed(&mut self) -> Option<i64> {
        let value = self.varint()?;
        Some((value >> 1) as i64 ^ -((value & 1) as i64))
    }
}

#[cfg(test)]
mod tests;
