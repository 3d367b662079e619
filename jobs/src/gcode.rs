//! Reads G-code, byte by byte, line by line, into [`Instruction`]s. No word is skipped: a word that
//! is not supported is an error with line and column. So a program that was read to its end does
//! what it says.
//!
//! | words | meaning |
//! |---|---|
//! | `G0 G1 G2 G3` | rapid, line, arc clockwise, arc counterclockwise; modal. Arcs with I and J, or with R (negative: the longer way). End left out or equal to the beginning, with I and J: a full circle. With Z: a helix |
//! | `G4 P` | dwell: **seconds** as in LinuxCNC, or milliseconds when [`Options::dwell`] says so; `G4 S` is always seconds |
//! | `G17` | XY plane, the only one |
//! | `G20 G21` | inches, millimetres (the default) |
//! | `G28` | home the axes named, or all; numbers other than 0 are refused. The axes are at 0 then, and their G92 offsets are cleared |
//! | `G90 G91` | absolute (the default), relative |
//! | `G92` | the words become the coordinates of the current position |
//! | `F` | mm/min or inch/min, along the path |
//! | `M0 M2 M30` | wait for the operator; end. Text after an end is not read |
//! | `M3 M5` | tool (pen, laser) on, off: output 0 |
//! | `G40 G49 G54 G80 G91.1 G94` | accepted: they select what is always in force here |
//! | `N123`, `*71` | line number; checksum of all bytes before the star, exclusive or |
//! | `( )`, `;`, `%` | comments, program mark |
//!
//! Within a line the order is LinuxCNC's: feed, tool, dwell, modes, then G28, G92 or the motion,
//! then the stop. No existing crate fits: `gcode` 0.7 runs on `no_std` and gives spans, but its
//! numbers are `f32`. At a metre they have a resolution of 60 nm, sums of relative moves drift, and
//! a softcore without FPU is slow with them.

mod words;

use self::words::{At, NANO, WORDS, Word, Words};
use crate::circle::hypot;
use crate::instruction::{
    AUX_TOOL, Arc, CENTER_FARTHEST, DWELL_LONGEST, FARTHEST, Feed, Instruction, Place,
};
use core::fmt;
use motion::segment::AXES;

/// RS-274's limit.
pub const LINE_LENGTH: usize = 256;

/// The differences between dialects.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Options {
    /// The unit of `G4 P`.
    pub dwell: DwellUnit,
}

/// The unit of `G4 P`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum DwellUnit {
    /// As LinuxCNC, grbl and RS-274.
    #[default]
    Seconds,
    /// As Marlin and XYPenPlotter.
    Milliseconds,
}

/// An error and its place; line and byte count from 1.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Error {
    /// Line of the text.
    pub line: u32,
    /// Byte of the line.
    pub column: u16,
    /// The kind.
    pub fault: Fault,
}

/// The errors a line can have.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fault {
    /// A word begins with something else than a letter.
    NoWord(u8),
    /// A letter without a number.
    NoNumber(u8),
    /// A number too large for any machine.
    TooLarge,
    /// An unknown G code; ten times its number.
    UnknownG(i64),
    /// An unknown M code; ten times its number.
    UnknownM(i64),
    /// An unknown letter.
    UnknownLetter(u8),
    /// A letter twice.
    Twice(u8),
    /// Two codes that exclude each other.
    Conflict,
    /// A letter that no code of the line uses.
    Unused(u8),
    /// A comment without end.
    OpenComment,
    /// The checksum shows that the line was garbled.
    Checksum {
        /// The checksum in the line.
        said: u8,
        /// The checksum of the line.
        is: u8,
    },
    /// Longer than 256 bytes or 32 words.
    TooLong,
    /// Axis words, but no G0 to G3 yet.
    NoMode,
    /// A cutting motion, but no F yet.
    NoFeed,
    /// F of 0, below it, or beyond 257 m/min.
    BadFeed,
    /// G4 without P or S, with both, below 0, or longer than a week.
    BadDwell,
    /// G28 with a position.
    HomeWithPlace,
    /// G92 without words.
    EmptyOffset,
    /// An arc with neither R nor I and J, or with both.
    NoCenter,
    /// An arc with R that ends at its beginning: every circle with this radius fits.
    RadiusFullCircle,
    /// Its ends are further apart than twice R.
    RadiusTooSmall,
    /// The end is not on the circle; by this many nanometres.
    OffCircle(i64),
    /// More than 10 m from home.
    TooFar,
    /// The centre of an arc, more than 40 m from home.
    CenterTooFar,
}

impl fmt::Display for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "line {}, column {}: {}",
            self.line, self.column, self.fault
        )
    }
}

/// A code from its tenfold number.
struct Code(char, i64);

impl fmt::Display for Code {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.1 % 10 {
            0 => write!(f, "{}{}", self.0, self.1 / 10),
            tenth => write!(f, "{}{}.{}", self.0, self.1 / 10, tenth.abs()),
        }
    }
}

impl fmt::Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Fault::NoWord(byte) => write!(f, "{:?} does not begin a word", char::from(byte)),
            Fault::NoNumber(letter) => write!(f, "{} without a number", char::from(letter)),
            Fault::TooLarge => write!(f, "a number beyond a million"),
            Fault::UnknownG(code) => write!(f, "{} is not supported", Code('G', code)),
            Fault::UnknownM(code) => write!(f, "{} is not supported", Code('M', code)),
            Fault::UnknownLetter(letter) => {
                write!(f, "{} words are not supported", char::from(letter))
            }
            Fault::Twice(letter) => write!(f, "{} twice", char::from(letter)),
            Fault::Conflict => write!(f, "this excludes another code of the line"),
            Fault::Unused(letter) => write!(f, "no code of this line uses {}", char::from(letter)),
            Fault::OpenComment => write!(f, "a comment that does not end"),
            Fault::Checksum { said, is } => {
                write!(f, "checksum {said}, the line has {is}: it was garbled")
            }
            Fault::TooLong => write!(f, "more than {LINE_LENGTH} bytes or {WORDS} words"),
            Fault::NoMode => write!(f, "axis words, but no G0, G1, G2 or G3 so far"),
            Fault::NoFeed => write!(f, "a feed is needed, but no F so far"),
            Fault::BadFeed => write!(f, "F must be above 0 and below 257 m/min"),
            Fault::BadDwell => write!(f, "G4 needs one of P and S, not below 0 and at most a week"),
            Fault::HomeWithPlace => write!(
                f,
                "G28 homes the axes; a number other than 0 has no meaning here"
            ),
            Fault::EmptyOffset => write!(f, "G92 without an axis"),
            Fault::NoCenter => write!(f, "an arc needs either R, or I and J"),
            Fault::RadiusFullCircle => {
                write!(f, "a full circle needs I and J: R fits any number of them")
            }
            Fault::RadiusTooSmall => write!(f, "the ends are further apart than twice R"),
            Fault::OffCircle(nm) => {
                write!(
                    f,
                    "the end is {}.{:03} mm off the circle",
                    nm / 1_000_000,
                    nm / 1000 % 1000
                )
            }
            Fault::TooFar => write!(f, "more than 10 m from home"),
            Fault::CenterTooFar => write!(
                f,
                "the arc's centre is more than 40 m from home; a line does it"
            ),
        }
    }
}

/// The result of a line, in order.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Instructions {
    items: [Option<Instruction>; 4],
    next: usize,
}

impl Instructions {
    fn add(&mut self, instruction: Instruction) {
        // Tool, dwell, one of motion and G28, stop: at most one of each.
        if let Some(free) = self.items.iter_mut().find(|item| item.is_none()) {
            *free = Some(instruction);
        }
    }
}

impl Iterator for Instructions {
    type Item = Instruction;

    fn next(&mut self) -> Option<Instruction> {
        let item = self.items.get_mut(self.next)?.take();
        self.next += 1;
        item
    }
}

/// The reader. The meaning of a line depends on the lines before it.
#[derive(Clone, Debug)]
pub struct Reader {
    options: Options,
    buffer: [u8; LINE_LENGTH],
    length: usize,
    line: u32,
    mode: Option<Motion>,
    inches: bool,
    relative: bool,
    feed: Option<u32>,
    /// In machine coordinates.
    at: Place,
    /// G92's offset: it is added to program coordinates to get machine coordinates.
    offset: Place,
    tool: bool,
    ended: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Motion {
    Rapid,
    Line,
    Clockwise,
    Counterclockwise,
}

/// The one code of a line that uses the axis words.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Axial {
    Motion(Motion),
    Home,
    Offset,
}

impl Default for Reader {
    fn default() -> Self {
        Reader::new(Options::default())
    }
}

impl Reader {
    /// At home, millimetres, absolute.
    pub const fn new(options: Options) -> Self {
        Reader {
            options,
            buffer: [0; LINE_LENGTH],
            length: 0,
            line: 0,
            mode: None,
            inches: false,
            relative: false,
            feed: None,
            at: [0; AXES],
            offset: [0; AXES],
            tool: false,
            ended: false,
        }
    }

    /// The line being read or read last, from 1.
    pub fn line_number(&self) -> u32 {
        self.line
    }

    /// M2 or M30 was read.
    pub fn ended(&self) -> bool {
        self.ended
    }

    /// Takes the next byte of the program. At the end of a line it returns the line's result.
    pub fn byte(&mut self, byte: u8) -> Result<Instructions, Error> {
        if byte == b'\n' {
            return self.end_of_line();
        }
        match self.buffer.get_mut(self.length) {
            Some(place) => *place = byte,
            None => {
                self.line += 1;
                self.length = 0;
                return Err(self.error(LINE_LENGTH, Fault::TooLong));
            }
        }
        self.length += 1;
        Ok(Instructions::default())
    }

    /// The end of the program: its last line may lack a line end.
    pub fn finish(&mut self) -> Result<Instructions, Error> {
        match self.length {
            0 => Ok(Instructions::default()),
            _ => self.end_of_line(),
        }
    }

    fn end_of_line(&mut self) -> Result<Instructions, Error> {
        let (buffer, length) = (self.buffer, self.length);
        self.length = 0;
        self.line(&buffer[..length])
    }

    /// Takes a whole line at once, without its end.
    pub fn line(&mut self, text: &[u8]) -> Result<Instructions, Error> {
        self.line += 1;
        if self.ended {
            return Ok(Instructions::default());
        }
        if text.len() > LINE_LENGTH {
            return Err(self.error(LINE_LENGTH, Fault::TooLong));
        }
        let words = Words::parse(text).map_err(|(at, fault)| self.error(at, fault))?;
        self.execute(&words)
            .map_err(|(at, fault)| self.error(at, fault))
    }

    fn error(&self, at: usize, fault: Fault) -> Error {
        Error {
            line: self.line,
            column: at as u16 + 1,
            fault,
        }
    }

    fn execute(&mut self, words: &Words) -> Result<Instructions, At> {
        let mut used = Used::default();
        let (mut axial, mut dwell, mut stop, mut tool) = (None, None, None, None);
        let (mut inches, mut relative) = (None, None);
        for word in words.iter() {
            match (word.letter, word.tenths()) {
                (b'G', Some(code)) => match code {
                    0 => set(&mut axial, Axial::Motion(Motion::Rapid), word)?,
                    10 => set(&mut axial, Axial::Motion(Motion::Line), word)?,
                    20 => set(&mut axial, Axial::Motion(Motion::Clockwise), word)?,
                    30 => set(&mut axial, Axial::Motion(Motion::Counterclockwise), word)?,
                    40 => set(&mut dwell, word.at, word)?,
                    200 => set(&mut inches, true, word)?,
                    210 => set(&mut inches, false, word)?,
                    280 => set(&mut axial, Axial::Home, word)?,
                    900 => set(&mut relative, false, word)?,
                    910 => set(&mut relative, true, word)?,
                    920 => set(&mut axial, Axial::Offset, word)?,
                    170 | 400 | 490 | 540 | 800 | 911 | 940 => {}
                    other => return Err((word.at, Fault::UnknownG(other))),
                },
                (b'M', Some(code)) => match code {
                    0 => set(&mut stop, Instruction::Pause, word)?,
                    20 | 300 => set(&mut stop, Instruction::End, word)?,
                    30 => set(&mut tool, true, word)?,
                    50 => set(&mut tool, false, word)?,
                    other => return Err((word.at, Fault::UnknownM(other))),
                },
                (b'G', None) => return Err((word.at, Fault::UnknownG(word.value / (NANO / 10)))),
                (b'M', None) => return Err((word.at, Fault::UnknownM(word.value / (NANO / 10)))),
                (b'N', _) => {}
                (b'F' | b'I' | b'J' | b'P' | b'R' | b'S' | b'X' | b'Y' | b'Z', _) => {
                    if !used.first(word.letter) {
                        return Err((word.at, Fault::Twice(word.letter)));
                    }
                }
                (letter, _) => return Err((word.at, Fault::UnknownLetter(letter))),
            }
        }
        // The changes are made to a copy, which replaces the state only if the whole line is valid.
        let mut next = self.modes(inches, relative);
        let mut out = Instructions::default();
        if let Some(word) = words.find(b'F') {
            next.feed = Some(next.feed_of(word)?);
        }
        if let Some(on) = tool {
            next.tool = on;
            out.add(Instruction::Aux {
                bits: if on { AUX_TOOL } else { 0 },
            });
        }
        if let Some(at) = dwell {
            let micros = next.dwell(words, at)?;
            out.add(Instruction::Dwell { micros });
        } else if let Some(word) = words.find(b'P').or(words.find(b'S')) {
            return Err((word.at, Fault::Unused(word.letter)));
        }
        let some_axis = words.iter().find(|word| matches!(word.letter, b'X'..=b'Z'));
        let arc_word = words
            .iter()
            .find(|word| matches!(word.letter, b'I' | b'J' | b'R'));
        let axial = match (axial, some_axis.or(arc_word)) {
            (Some(axial), _) => Some(axial),
            (None, None) => None,
            (None, Some(word)) => {
                let mode = next.mode.ok_or((word.at, Fault::NoMode))?;
                Some(Axial::Motion(mode))
            }
        };
        if let Some(word) = arc_word {
            let arc = matches!(
                axial,
                Some(Axial::Motion(Motion::Clockwise | Motion::Counterclockwise))
            );
            if !arc {
                return Err((word.at, Fault::Unused(word.letter)));
            }
        }
        match axial {
            None => {}
            Some(Axial::Home) => out.add(next.home(words)?),
            Some(Axial::Offset) => next.set_offset(words)?,
            Some(Axial::Motion(motion)) => {
                next.mode = Some(motion);
                if let Some(instruction) = next.motion(motion, words)? {
                    out.add(instruction);
                }
            }
        }
        if let Some(stop) = stop {
            next.ended = stop == Instruction::End;
            out.add(stop);
        }
        self.take(&next);
        Ok(out)
    }

    /// The modal state without the buffer.
    fn modes(&self, inches: Option<bool>, relative: Option<bool>) -> Modes {
        Modes {
            dwell: self.options.dwell,
            mode: self.mode,
            inches: inches.unwrap_or(self.inches),
            relative: relative.unwrap_or(self.relative),
            feed: self.feed,
            at: self.at,
            offset: self.offset,
            tool: self.tool,
            ended: false,
        }
    }

    fn take(&mut self, modes: &Modes) {
        self.mode = modes.mode;
        self.inches = modes.inches;
        self.relative = modes.relative;
        self.feed = modes.feed;
        self.at = modes.at;
        self.offset = modes.offset;
        self.tool = modes.tool;
        self.ended = modes.ended;
    }
}

/// The state that a line leaves to the lines after it.
struct Modes {
    dwell: DwellUnit,
    mode: Option<Motion>,
    inches: bool,
    relative: bool,
    feed: Option<u32>,
    at: Place,
    offset: Place,
    tool: bool,
    ended: bool,
}

impl Modes {
    /// Nanometres of a word, rounded to the nearest.
    fn length(&self, word: &Word) -> i64 {
        match self.inches {
            false => rounded(word.value, 1000),
            // 25 400 000 nm in an inch, of 10^9.
            true => rounded(word.value * 127, 5000),
        }
    }

    fn feed_of(&self, word: &Word) -> Result<u32, At> {
        let rate = rounded(self.length(word), 60);
        match u32::try_from(rate) {
            Ok(rate) if rate > 0 => Ok(rate),
            _ => Err((word.at, Fault::BadFeed)),
        }
    }

    fn dwell(&self, words: &Words, at: usize) -> Result<u64, At> {
        let (p, s) = (words.find(b'P'), words.find(b'S'));
        let (word, milli) = match (p, s) {
            (Some(word), None) => (word, self.dwell == DwellUnit::Milliseconds),
            (None, Some(word)) => (word, false),
            (None, None) | (Some(_), Some(_)) => return Err((at, Fault::BadDwell)),
        };
        let micros = rounded(word.value, if milli { 1_000_000 } else { 1000 });
        let micros = u64::try_from(micros).ok();
        let micros = micros.filter(|micros| *micros <= DWELL_LONGEST);
        micros.ok_or((word.at, Fault::BadDwell))
    }

    /// The end position of the axis words.
    fn target(&self, words: &Words) -> Result<Place, At> {
        let mut to = self.at;
        for (axis, letter) in (b'X'..=b'Z').enumerate() {
            if let Some(word) = words.find(letter) {
                let from = if self.relative {
                    self.at[axis]
                } else {
                    self.offset[axis]
                };
                to[axis] = from + self.length(word);
                if to[axis].abs() > FARTHEST {
                    return Err((word.at, Fault::TooFar));
                }
            }
        }
        Ok(to)
    }

    fn home(&mut self, words: &Words) -> Result<Instruction, At> {
        let mut axes = [false; AXES];
        for (axis, letter) in (b'X'..=b'Z').enumerate() {
            if let Some(word) = words.find(letter) {
                if word.value != 0 {
                    return Err((word.at, Fault::HomeWithPlace));
                }
                axes[axis] = true;
            }
        }
        if axes == [false; AXES] {
            axes = [true; AXES];
        }
        for (axis, homed) in axes.iter().enumerate() {
            if *homed {
                (self.at[axis], self.offset[axis]) = (0, 0);
            }
        }
        Ok(Instruction::Home { axes })
    }

    fn set_offset(&mut self, words: &Words) -> Result<(), At> {
        let mut some = false;
        for (axis, letter) in (b'X'..=b'Z').enumerate() {
            if let Some(word) = words.find(letter) {
                self.offset[axis] = self.at[axis] - self.length(word);
                some = true;
            }
        }
        match some {
            true => Ok(()),
            false => Err((words.first_at(), Fault::EmptyOffset)),
        }
    }

    fn motion(&mut self, motion: Motion, words: &Words) -> Result<Option<Instruction>, At> {
        let to = self.target(words)?;
        let from = core::mem::replace(&mut self.at, to);
        let clockwise = match motion {
            Motion::Rapid | Motion::Line => {
                if !words.iter().any(|word| matches!(word.letter, b'X'..=b'Z')) {
                    return Ok(None);
                }
                let feed = match motion {
                    Motion::Line => self.cutting(words)?,
                    _ => Feed::Rapid,
                };
                return Ok(Some(Instruction::Line { to, feed }));
            }
            Motion::Clockwise => true,
            Motion::Counterclockwise => false,
        };
        let feed = self.cutting(words)?;
        let center = self.center(from, to, clockwise, words)?;
        if center.iter().any(|nm| nm.abs() > CENTER_FARTHEST) {
            return Err((words.first_at(), Fault::CenterTooFar));
        }
        let arc = Arc {
            to,
            center,
            clockwise,
            feed,
        };
        Ok(Some(Instruction::Arc(arc)))
    }

    fn cutting(&self, words: &Words) -> Result<Feed, At> {
        let rate = self.feed.ok_or((words.first_at(), Fault::NoFeed))?;
        Ok(Feed::Rate(rate))
    }

    fn center(
        &self,
        from: Place,
        to: Place,
        clockwise: bool,
        words: &Words,
    ) -> Result<[i64; 2], At> {
        let (i, j) = (words.find(b'I'), words.find(b'J'));
        match (words.find(b'R'), i.or(j)) {
            (Some(radius), None) => self.center_by_radius(from, to, clockwise, radius),
            (None, Some(word)) => {
                let nm = |word: Option<&Word>| word.map_or(0, |word| self.length(word));
                let center = [from[0] + nm(i), from[1] + nm(j)];
                let radius = hypot(from[0] - center[0], from[1] - center[1]);
                let off = (hypot(to[0] - center[0], to[1] - center[1]) - radius).abs();
                // LinuxCNC's tolerance: five micrometres, or a thousandth of a large radius.
                match radius {
                    0 => Err((word.at, Fault::NoCenter)),
                    _ if off > (radius / 1000).max(5000) => Err((word.at, Fault::OffCircle(off))),
                    _ => Ok(center),
                }
            }
            (None, None) => Err((words.first_at(), Fault::NoCenter)),
            (Some(word), Some(_)) => Err((word.at, Fault::NoCenter)),
        }
    }

    fn center_by_radius(
        &self,
        from: Place,
        to: Place,
        clockwise: bool,
        word: &Word,
    ) -> Result<[i64; 2], At> {
        let radius = self.length(word);
        let (dx, dy) = (to[0] - from[0], to[1] - from[1]);
        let chord = hypot(dx, dy);
        if chord == 0 {
            return Err((word.at, Fault::RadiusFullCircle));
        }
        // The R of a half circle may be rounded down: the tolerance is the same as for I and J.
        let twice = 2 * radius.abs();
        if chord > twice + (radius.abs() / 1000).max(5000) {
            return Err((word.at, Fault::RadiusTooSmall));
        }
        let square = |x: i64| i128::from(x) * i128::from(x);
        let chord_square = square(dx) + square(dy);
        // From the chord's middle to the centre, twice.
        let height = (square(twice) - chord_square).max(0).isqrt();
        let fine_chord = (chord_square << 40).isqrt();
        // The shorter counterclockwise arc has its centre to the left.
        let left = clockwise == (radius < 0);
        let side = |across: i64| {
            let part = (height * i128::from(across)) << 20;
            let part = (part + part.signum() * (fine_chord / 2)) / fine_chord;
            (if left { part } else { -part }) as i64
        };
        Ok([
            (from[0] + to[0] + side(-dy)) / 2,
            (from[1] + to[1] + side(dx)) / 2,
        ])
    }
}

/// `value / by` to the nearest.
fn rounded(value: i64, by: i64) -> i64 {
    (value + value.signum() * (by / 2)) / by
}

fn set<T>(place: &mut Option<T>, value: T, word: &Word) -> Result<(), At> {
    match place.replace(value) {
        None => Ok(()),
        Some(_) => Err((word.at, Fault::Conflict)),
    }
}

/// The letters found so far.
#[derive(Default)]
struct Used(u32);

impl Used {
    fn first(&mut self, letter: u8) -> bool {
        let bit = 1 << (letter - b'A');
        let new = self.0 & bit == 0;
        self.0 |= bit;
        new
    }
}

#[cfg(test)]
mod tests;
