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

use crate::circle::hypot;
use crate::instruction::{
    AUX_TOOL, Arc, CENTER_FARTHEST, DWELL_LONGEST, FARTHEST, Feed, Instruction, Place,
};
use crate::segment::AXES;
use core::fmt;

/// RS-274's limit.
pub const LINE_LENGTH: usize = 256;

/// Largest number of words in a line; there are fewer different ones.
const WORDS: usize = 32;

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

/// An error and its byte, from 0.
type At = (usize, Fault);

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

/// Numbers are in units of 10^-9.
const NANO: i64 = 1_000_000_000;

#[derive(Clone, Copy, Default)]
struct Word {
    letter: u8,
    value: i64,
    at: usize,
}

impl Word {
    /// Ten times the number, if that is whole and not below 0.
    fn tenths(&self) -> Option<i64> {
        let tenth = NANO / 10;
        (self.value % tenth == 0 && self.value >= 0).then_some(self.value / tenth)
    }
}

struct Words {
    words: [Word; WORDS],
    count: usize,
}

impl Words {
    fn iter(&self) -> impl Iterator<Item = &Word> {
        self.words[..self.count].iter()
    }

    fn find(&self, letter: u8) -> Option<&Word> {
        self.iter().find(|word| word.letter == letter)
    }

    /// The position of the line's first word after its number.
    fn first_at(&self) -> usize {
        self.iter()
            .find(|word| word.letter != b'N')
            .map_or(0, |word| word.at)
    }

    fn parse(text: &[u8]) -> Result<Words, At> {
        let mut words = Words {
            words: [Word::default(); WORDS],
            count: 0,
        };
        let mut at = 0;
        while let Some(&byte) = text.get(at) {
            match byte {
                b' ' | b'\t' | b'\r' => at += 1,
                // Program marks; anything else in their line is a word.
                b'%' => at += 1,
                b';' => break,
                b'(' => at = after_comment(text, at)?,
                b'*' => {
                    check(text, at)?;
                    break;
                }
                _ if byte.is_ascii_alphabetic() => {
                    let letter = byte.to_ascii_uppercase();
                    let (value, end) = number(text, at + 1).map_err(|fault| match fault {
                        Fault::NoNumber(_) => (at, Fault::NoNumber(letter)),
                        other => (at, other),
                    })?;
                    let place = words
                        .words
                        .get_mut(words.count)
                        .ok_or((at, Fault::TooLong))?;
                    *place = Word { letter, value, at };
                    words.count += 1;
                    at = end;
                }
                _ => return Err((at, Fault::NoWord(byte))),
            }
        }
        Ok(words)
    }
}

fn after_comment(text: &[u8], at: usize) -> Result<usize, At> {
    let inside = &text[at + 1..];
    let end = inside.iter().position(|byte| matches!(byte, b'(' | b')'));
    match end.map(|end| (end, inside[end])) {
        Some((end, b')')) => Ok(at + 1 + end + 1),
        _ => Err((at, Fault::OpenComment)),
    }
}

/// `*` and the checksum at `at`, for the bytes before it.
fn check(text: &[u8], at: usize) -> Result<(), At> {
    let (value, end) = number(text, at + 1).map_err(|_| (at, Fault::NoNumber(b'*')))?;
    let is = text[..at].iter().fold(0, |sum, byte| sum ^ byte);
    if value != i64::from(is) * NANO {
        let said = u8::try_from(value / NANO).unwrap_or(u8::MAX);
        return Err((at, Fault::Checksum { said, is }));
    }
    match text[end..]
        .iter()
        .position(|byte| !byte.is_ascii_whitespace())
    {
        None => Ok(()),
        Some(more) if text[end + more] == b';' => Ok(()),
        Some(more) => Err((end + more, Fault::NoWord(text[end + more]))),
    }
}

/// The number at `at` (spaces before it are allowed) and its end. Digits after the ninth decimal
/// are read and ignored.
fn number(text: &[u8], mut at: usize) -> Result<(i64, usize), Fault> {
    while matches!(text.get(at), Some(b' ' | b'\t')) {
        at += 1;
    }
    let negative = text.get(at) == Some(&b'-');
    if negative || text.get(at) == Some(&b'+') {
        at += 1;
    }
    let (mut value, mut digits, mut scale, mut fraction) = (0i64, 0, NANO, false);
    while let Some(&byte) = text.get(at) {
        match byte {
            b'.' if !fraction => fraction = true,
            b'0'..=b'9' => {
                digits += 1;
                let digit = i64::from(byte - b'0');
                if fraction {
                    scale /= 10;
                    value += digit * scale;
                } else {
                    value = value * 10 + digit * NANO;
                }
                if value > 1_000_000 * NANO {
                    return Err(Fault::TooLarge);
                }
            }
            _ => break,
        }
        at += 1;
    }
    match digits {
        0 => Err(Fault::NoNumber(0)),
        _ => Ok((if negative { -value } else { value }, at)),
    }
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use proptest::prelude::*;
    use std::string::{String, ToString};
    use std::vec::Vec;

    fn read_with(options: Options, program: &str) -> Result<Vec<Instruction>, Error> {
        let mut reader = Reader::new(options);
        let mut all = Vec::new();
        for byte in program.bytes() {
            all.extend(reader.byte(byte)?);
        }
        all.extend(reader.finish()?);
        Ok(all)
    }

    fn read(program: &str) -> Vec<Instruction> {
        read_with(Options::default(), program).unwrap()
    }

    fn complaint(program: &str) -> String {
        read_with(Options::default(), program)
            .unwrap_err()
            .to_string()
    }

    fn line(x: i64, y: i64, z: i64, mm_per_minute: u32) -> Instruction {
        Instruction::Line {
            to: [x, y, z],
            feed: Feed::Rate(((u64::from(mm_per_minute) * 100_000 + 3) / 6) as u32),
        }
    }

    fn rapid(x: i64, y: i64, z: i64) -> Instruction {
        Instruction::Line {
            to: [x, y, z],
            feed: Feed::Rapid,
        }
    }

    fn arc(to: Place, center: [i64; 2], clockwise: bool) -> Instruction {
        Instruction::Arc(Arc {
            to,
            center,
            clockwise,
            feed: Feed::Rate(1_000_000_000),
        })
    }

    #[test]
    fn lines_modes_and_comments() {
        let program = "%\n(part) G21 G90 G17\nN10 g0x1.5 y-2 ; go\nG1 Z-.25 F600\nX2\n\nM2\nwhatever comes now\n";
        assert_eq!(
            read(program),
            [
                rapid(1_500_000, -2_000_000, 0),
                line(1_500_000, -2_000_000, -250_000, 600),
                line(2_000_000, -2_000_000, -250_000, 600),
                Instruction::End
            ]
        );
    }

    #[test]
    fn inches_are_exact_and_so_are_sums_of_them() {
        assert_eq!(read("G20 G0 X1 Y0.0001"), [rapid(25_400_000, 2_540, 0)]);
        let mut program = String::from("G20 G91\n");
        for _ in 0..1000 {
            program.push_str("G0 X0.001\n");
        }
        assert_eq!(read(&program).last(), Some(&rapid(25_400_000, 0, 0)));
    }

    #[test]
    fn feed_in_inches_is_inches_per_minute() {
        let expected = Instruction::Line {
            to: [25_400_000, 0, 0],
            feed: Feed::Rate(4_233_333),
        };
        assert_eq!(read("G20 G1 X1 F10"), [expected]);
    }

    #[test]
    fn relative_and_offset_coordinates() {
        assert_eq!(
            read("G0 X10 Y10\nG92 X0\nG0 X5 Y5\nG91 X1 Y1\nG90 G0 X0 Y0"),
            [
                rapid(10_000_000, 10_000_000, 0),
                rapid(15_000_000, 5_000_000, 0),
                rapid(16_000_000, 6_000_000, 0),
                rapid(10_000_000, 0, 0)
            ]
        );
    }

    #[test]
    fn a_dwell_is_at_most_a_week() {
        let week = Instruction::Dwell {
            micros: DWELL_LONGEST,
        };
        assert_eq!(read("G4 P604800\n"), [week]);
        for text in ["G4 P604800.001\n", "G4 S1000000\n", "G4 P-1\n"] {
            let complaint = complaint(text);
            assert!(complaint.contains("at most a week"), "{text}: {complaint}");
        }
        // 2^64 microseconds, and one less.
        for text in ["G4 P18446744073709.551616\n", "G4 P18446744073709.551615\n"] {
            assert!(read_with(Options::default(), text).is_err(), "{text}");
        }
    }

    #[test]
    fn a_dwell_is_in_seconds_unless_milliseconds_are_asked_for() {
        let p = "G4 P1.5\nG4 S2";
        let dwell = |micros| Instruction::Dwell { micros };
        assert_eq!(read(p), [dwell(1_500_000), dwell(2_000_000)]);
        let marlin = Options {
            dwell: DwellUnit::Milliseconds,
        };
        assert_eq!(
            read_with(marlin, p).unwrap(),
            [dwell(1_500), dwell(2_000_000)]
        );
    }

    #[test]
    fn home_forgets_the_offset_of_the_axes_it_homes() {
        assert_eq!(
            read("G0 X3 Y4\nG92 X0 Y0\nG28 X0\nG0 X1 Y1\nG28"),
            [
                rapid(3_000_000, 4_000_000, 0),
                Instruction::Home {
                    axes: [true, false, false]
                },
                rapid(1_000_000, 5_000_000, 0),
                Instruction::Home { axes: [true; 3] }
            ]
        );
    }

    #[test]
    fn the_tool_is_an_output_and_goes_before_the_motion_of_its_line() {
        assert_eq!(
            read("M3 G0 X1\nM5"),
            [
                Instruction::Aux { bits: 1 },
                rapid(1_000_000, 0, 0),
                Instruction::Aux { bits: 0 }
            ]
        );
    }

    #[test]
    fn arcs_by_centre_by_radius_and_full_circles() {
        let half = [20_000_000, 0, 0];
        assert_eq!(
            read("G2 X20 I10 F60000"),
            [arc(half, [10_000_000, 0], true)]
        );
        assert_eq!(
            read("G3 X20 R10 F60000"),
            [arc(half, [10_000_000, 0], false)]
        );
        // A quarter from (0, 0) to (10, 10): counterclockwise and short, with the centre to the
        // left of the path.
        let quarter = [10_000_000, 10_000_000, 0];
        assert_eq!(
            read("G3 X10 Y10 R10 F60000"),
            [arc(quarter, [0, 10_000_000], false)]
        );
        assert_eq!(
            read("G2 X10 Y10 R10 F60000"),
            [arc(quarter, [10_000_000, 0], true)]
        );
        assert_eq!(
            read("G3 X10 Y10 R-10 F60000"),
            [arc(quarter, [10_000_000, 0], false)]
        );
        assert_eq!(
            read("G2 X10 Y10 R-10 F60000"),
            [arc(quarter, [0, 10_000_000], true)]
        );
        assert_eq!(read("G2 I5 F60000"), [arc([0; 3], [5_000_000, 0], true)]);
        assert_eq!(
            read("G2 X0 Y0 J5 Z-1 F60000"),
            [arc([0, 0, -1_000_000], [0, 5_000_000], true)]
        );
    }

    #[test]
    fn a_half_circle_by_a_rounded_radius_is_a_half_circle() {
        let Instruction::Arc(arc) = read("G2 X1 Y1 R.7071 F100")[0] else {
            panic!("no arc");
        };
        assert_eq!(arc.center, [500_000, 500_000]);
    }

    #[test]
    fn checksums_are_kept_and_garbled_lines_refused() {
        let text = "N3 G1 X10 F60000";
        let sum = text.bytes().fold(0, |sum, byte| sum ^ byte);
        assert_eq!(read(&std::format!("{text}*{sum}\r\n")).len(), 1);
        let garbled = std::format!("{}*{sum}\n", text.replace("X10", "X90"));
        assert!(
            complaint(&garbled).starts_with("line 1, column 17: checksum "),
            "{}",
            complaint(&garbled)
        );
    }

    #[test]
    fn what_is_not_supported_says_line_and_column() {
        for (program, message) in [
            ("G0 X1\nG0 X2 G99", "line 2, column 7: G99 is not supported"),
            ("G0 X1\n\n  M6 T1", "line 3, column 3: M6 is not supported"),
            (
                "G1 X1 F100 A3",
                "line 1, column 12: A words are not supported",
            ),
            ("G18", "line 1, column 1: G18 is not supported"),
            ("G90.1", "line 1, column 1: G90.1 is not supported"),
            ("G1.05 X1", "line 1, column 1: G1 is not supported"),
            ("M3 S1000", "line 1, column 4: no code of this line uses S"),
            ("#1=5", "line 1, column 1: '#' does not begin a word"),
            ("/G0 X1", "line 1, column 1: '/' does not begin a word"),
            ("G0 X", "line 1, column 4: X without a number"),
            ("G0 X1 X2", "line 1, column 7: X twice"),
            (
                "G0 G1 X2",
                "line 1, column 4: this excludes another code of the line",
            ),
            (
                "G20 G21",
                "line 1, column 5: this excludes another code of the line",
            ),
            ("G0 (open", "line 1, column 4: a comment that does not end"),
            (
                "X1",
                "line 1, column 1: axis words, but no G0, G1, G2 or G3 so far",
            ),
            (
                "G1 X1",
                "line 1, column 1: a feed is needed, but no F so far",
            ),
            (
                "F0",
                "line 1, column 1: F must be above 0 and below 257 m/min",
            ),
            (
                "F-5",
                "line 1, column 1: F must be above 0 and below 257 m/min",
            ),
            (
                "G4",
                "line 1, column 1: G4 needs one of P and S, not below 0 and at most a week",
            ),
            (
                "G4 P-1",
                "line 1, column 4: G4 needs one of P and S, not below 0 and at most a week",
            ),
            (
                "G28 X5",
                "line 1, column 5: G28 homes the axes; a number other than 0 has no meaning here",
            ),
            ("G92", "line 1, column 1: G92 without an axis"),
            (
                "F9 G2 X1",
                "line 1, column 1: an arc needs either R, or I and J",
            ),
            (
                "F9 G2 X1 R1 I1",
                "line 1, column 10: an arc needs either R, or I and J",
            ),
            (
                "F9 G2 R1",
                "line 1, column 7: a full circle needs I and J: R fits any number of them",
            ),
            (
                "F9 G2 X3 R1",
                "line 1, column 10: the ends are further apart than twice R",
            ),
            (
                "F9 G2 X3 I1",
                "line 1, column 10: the end is 1.000 mm off the circle",
            ),
            ("G0 X1 I1", "line 1, column 7: no code of this line uses I"),
            ("G0 X1 P1", "line 1, column 7: no code of this line uses P"),
            ("G0 X20000", "line 1, column 4: more than 10 m from home"),
            ("G0 X2000000", "line 1, column 4: a number beyond a million"),
        ] {
            assert_eq!(complaint(program), message, "{program}");
        }
        let long = "G0 X1 ".repeat(50);
        assert_eq!(
            complaint(&long),
            "line 1, column 257: more than 256 bytes or 32 words"
        );
    }

    #[test]
    fn a_refused_line_changes_nothing() {
        let mut reader = Reader::default();
        reader.line(b"G1 X1 F60000").unwrap();
        reader.line(b"G91 G20 X5 F1 Q7").unwrap_err();
        let next: Vec<Instruction> = reader.line(b"X2").unwrap().collect();
        assert_eq!(next, [line(2_000_000, 0, 0, 60_000)]);
    }

    #[test]
    fn statements_of_what_is_the_case_are_accepted() {
        assert_eq!(read("G17 G40 G49 G54 G80 G91.1 G94"), []);
    }

    proptest! {
        #[test]
        fn no_bytes_make_it_panic(program in proptest::collection::vec(any::<u8>(), 0..600)) {
            let mut reader = Reader::default();
            for byte in program {
                let _ = reader.byte(byte);
            }
            let _ = reader.finish();
        }

        #[test]
        fn no_words_make_it_panic(program in "([GMXYZIJRFPSN%(;*] ?-?[0-9]{0,8}\\.?[0-9]{0,12} ?){0,20}(\n[GXYIJR]-?[0-9]{1,7}){0,9}") {
            let mut reader = Reader::default();
            for byte in program.bytes() {
                let _ = reader.byte(byte);
            }
            let _ = reader.finish();
        }

        #[test]
        fn a_number_is_read_as_it_is_written(nm in -9_999_999_999i64..=9_999_999_999) {
            let (sign, size) = (if nm < 0 { "-" } else { "" }, nm.abs());
            let text = std::format!("G0 X{sign}{}.{:06}", size / 1_000_000, size % 1_000_000);
            prop_assert_eq!(read(&text), [rapid(nm, 0, 0)]);
        }

        #[test]
        fn the_centre_of_an_arc_by_radius_is_at_that_radius(x in -1_000_000i64..1_000_000, y in -1_000_000i64..1_000_000, more in 0i64..3_000_000, negative: bool) {
            prop_assume!((x, y) != (0, 0));
            let radius = hypot(x, y) / 2 + 1 + more;
            let mm = |nm: i64| std::format!("{}{}.{:06}", if nm < 0 { "-" } else { "" }, nm.abs() / 1_000_000, nm.abs() % 1_000_000);
            let text = std::format!("G2 X{} Y{} R{} F100", mm(x), mm(y), mm(if negative { -radius } else { radius }));
            let Instruction::Arc(arc) = read(&text)[0] else { panic!("no arc") };
            prop_assert!((hypot(arc.center[0], arc.center[1]) - radius).abs() <= 2);
            prop_assert!((hypot(arc.center[0] - x, arc.center[1] - y) - radius).abs() <= 2);
        }
    }
}
