//! FPGA G's words as text, one command a line, and how long they take.
//!
//! ```text
//! # 300 steps with X: faster and faster, as fast, slower and slower
//! GCODE 0x01600001 0x01f40064 0x006401f4 0x00640000
//! START
//! ```
//!
//! `STATUS`, `START`, `STOP` and `EMPTY` stand alone. `GCODE` has the four words of a move or the
//! ten of a curve ([`jobs::fpgag`]). What is in a line is judged before it is sent: the board says
//! only that it refuses an instruction, this module says why.

use jobs::fpgag::{self, CURVE_WORDS, Curve, FpgagCommand, Move, WORDS, status};
use jobs::player::ACCELERATION;
use std::fmt;

/// Ticks of a curve per second.
const TICKS: f64 = 1e6;

/// Names of the commands, as FPGA G has them.
const COMMANDS: [(&str, FpgagCommand); 5] = [
    ("STATUS", FpgagCommand::Status),
    ("START", FpgagCommand::Start),
    ("STOP", FpgagCommand::Stop),
    ("GCODE", FpgagCommand::Gcode),
    ("EMPTY", FpgagCommand::Empty),
];

/// A line: its command and, for GCODE, an instruction.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct WordsLine {
    /// The line's number in its file, from 1.
    pub number: usize,
    /// The command.
    pub command: FpgagCommand,
    /// The form of the instruction: 0 is a move, 1 a curve.
    pub form: u8,
    /// The words of the instruction.
    pub words: Vec<u32>,
}

/// What is wrong with a line.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Wrong {
    /// Not one of the commands.
    Command(String),
    /// Words behind a command that takes none.
    Alone(&'static str, usize),
    /// Neither four words nor ten.
    Count(usize),
    /// Not a number of 32 bits: which of the words, and its text.
    Number(usize, String),
    /// The words are not an instruction.
    Instruction(fpgag::Error),
}

/// A wrong line, with its number.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct WrongLine(pub usize, pub Wrong);

impl fmt::Display for WrongLine {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "line {}: ", self.0)?;
        match &self.1 {
            Wrong::Command(text) => write!(
                f,
                "{text:?} is not a command; write STATUS, START, STOP, EMPTY, or GCODE and its words"
            ),
            Wrong::Alone(command, count) => write!(
                f,
                "{command} has {count} words behind it and takes none; take them out, or write GCODE"
            ),
            Wrong::Count(count) => write!(
                f,
                "GCODE has {count} words; write the {WORDS} of a move or the {CURVE_WORDS} of a curve"
            ),
            Wrong::Number(place, text) => write!(
                f,
                "word {place}, {text:?}, is not a number of 32 bits; write 0x and up to 8 hexadecimal digits, or a decimal number"
            ),
            Wrong::Instruction(error) => write!(f, "{error}; {}", remedy(error)),
        }
    }
}

impl std::error::Error for WrongLine {}

/// What to do about words that are not an instruction.
fn remedy(error: &fpgag::Error) -> &'static str {
    match error {
        fpgag::Error::Command(_) => {
            "the command of a move is 1: the highest byte of a move's first word, the lowest of a curve's"
        }
        fpgag::Error::Padding(_) => "the lower half of the last word of a move is 0",
        fpgag::Error::Ticks(_) => "give the curve fewer ticks, or divide it",
        fpgag::Error::NoAcceleration => "give an acceleration, or 0 steps to speed up or slow down",
        fpgag::Error::Jump => "speed up and slow down before it",
        fpgag::Error::Fast => "make it slower, or correct the machine description",
        fpgag::Error::Bounds => "shorten it, or correct the machine description",
    }
}

impl WordsLine {
    /// From its text; none if there is nothing but a comment.
    pub fn parse(number: usize, text: &str) -> Result<Option<WordsLine>, WrongLine> {
        let text = text.split('#').next().unwrap_or_default();
        let mut parts = text.split_whitespace();
        let Some(name) = parts.next() else {
            return Ok(None);
        };
        let wrong = |wrong| WrongLine(number, wrong);
        let known = COMMANDS
            .iter()
            .find(|(known, _)| known.eq_ignore_ascii_case(name));
        let Some(&(name, command)) = known else {
            return Err(wrong(Wrong::Command(name.to_owned())));
        };
        let words: Result<Vec<u32>, WrongLine> = (1..)
            .zip(parts)
            .map(|(place, text)| {
                word(text).ok_or_else(|| wrong(Wrong::Number(place, text.to_owned())))
            })
            .collect();
        let words = words?;
        let form = match (command, words.len()) {
            (FpgagCommand::Gcode, WORDS) => 0,
            (FpgagCommand::Gcode, CURVE_WORDS) => 1,
            (FpgagCommand::Gcode, count) => return Err(wrong(Wrong::Count(count))),
            (_, 0) => 0,
            (_, count) => return Err(wrong(Wrong::Alone(name, count))),
        };
        let line = WordsLine {
            number,
            command,
            form,
            words,
        };
        line.instruction()
            .map_err(|error| wrong(Wrong::Instruction(error)))?;
        Ok(Some(line))
    }

    /// All lines of a file, or the first that is wrong.
    pub fn all(text: &str) -> Result<Vec<WordsLine>, WrongLine> {
        (1..)
            .zip(text.lines())
            .filter_map(|(number, text)| WordsLine::parse(number, text).transpose())
            .collect()
    }

    /// The command's name.
    pub fn name(&self) -> &'static str {
        let mut names = COMMANDS.iter();
        let known = names.find(|(_, command)| *command == self.command);
        known.map_or("", |(name, _)| name)
    }

    fn instruction(&self) -> Result<Option<Instruction>, fpgag::Error> {
        if let Ok(words) = <[u32; WORDS]>::try_from(&self.words[..]) {
            return Move::parse(words).map(|moved| Some(Instruction::Move(moved)));
        }
        match <[u32; CURVE_WORDS]>::try_from(&self.words[..]) {
            Ok(words) => Curve::parse(words).map(|curve| Some(Instruction::Curve(curve))),
            Err(_) => Ok(None),
        }
    }

    /// How long the instruction takes, in seconds, and how fast the motors are at its end, in
    /// steps/s, if it begins with this speed.
    pub fn lasts(&self, speed: f64) -> (f64, f64) {
        match self.instruction() {
            Ok(Some(Instruction::Move(moved))) => {
                let unit = |acceleration: u16| (ACCELERATION * u64::from(acceleration)) as f64;
                let [up, on, down] =
                    [moved.loops_accel, moved.loops_travel, moved.loops_decel].map(f64::from);
                let most = (speed * speed + 2.0 * unit(moved.acceleration) * up).sqrt();
                let last = (most * most - 2.0 * unit(moved.deceleration) * down)
                    .max(0.0)
                    .sqrt();
                let way = |steps: f64, speed: f64| if steps > 0.0 { steps / speed } else { 0.0 };
                let ramps =
                    way(up, f64::midpoint(speed, most)) + way(down, f64::midpoint(most, last));
                (ramps + way(on, most), last)
            }
            Ok(Some(Instruction::Curve(curve))) => {
                let t = f64::from(curve.ticks);
                let speeds = curve.motors.map(|[c0, c1, c2]| {
                    let [c0, c1, c2] = [c0, c1, c2].map(f64::from);
                    (((3.0 * c2 * t + 2.0 * c1) * t + c0) / 2f64.powi(31) * TICKS).abs()
                });
                (t / TICKS, speeds.into_iter().fold(0.0, f64::max))
            }
            Ok(None) | Err(_) => (0.0, speed),
        }
    }
}

enum Instruction {
    Move(Move),
    Curve(Curve),
}

/// 32 bits: hexadecimal behind 0x, otherwise decimal; a negative one as its two's complement, as
/// the coefficients of a curve are.
fn word(text: &str) -> Option<u32> {
    let digits = |text: &str| !text.starts_with(['+', '-']);
    match text.strip_prefix("0x").or_else(|| text.strip_prefix("0X")) {
        Some(hex) => digits(hex)
            .then(|| u32::from_str_radix(hex, 16).ok())
            .flatten(),
        None if text.starts_with('-') => text.parse::<i32>().ok().map(|word| word as u32),
        None => digits(text).then(|| text.parse().ok()).flatten(),
    }
}

/// The bits of a status word by their names; of unknown bits, their numbers.
pub fn bits(word: u32) -> Vec<String> {
    let set = (0..32).filter(|bit| word >> bit & 1 == 1);
    set.map(|bit| match 1 << bit {
        status::FULL => "FULL".to_owned(),
        status::PARSE_ERROR => "DISPATCHERROR".to_owned(),
        _ => format!("bit {bit}"),
    })
    .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use motion::segment::AXES;
    use proptest::prelude::*;

    fn wrong(text: &str) -> String {
        let error = WordsLine::all(text).expect_err("a wrong line");
        error.to_string()
    }

    #[test]
    fn a_file_has_commands_words_and_comments() {
        let text =
            "# a move\n\nGCODE 0x01600001 0x01f40064 6554100 0x00640000 # X\nstart\nStatus\n";
        let lines = WordsLine::all(text).unwrap();
        let told: Vec<_> = lines
            .iter()
            .map(|line| (line.number, line.name()))
            .collect();
        assert_eq!(told, [(3, "GCODE"), (4, "START"), (5, "STATUS")]);
        assert_eq!(
            lines[0].words,
            [0x0160_0001, 0x01f4_0064, 0x0064_01f4, 0x0064_0000]
        );
        // 32 000 steps/s^2 for 100 steps, 100 at that speed, 100 to come to rest.
        let (seconds, speed) = lines[0].lasts(0.0);
        assert!(
            (seconds - 0.1976).abs() < 1e-3 && speed < 1e-3,
            "{seconds} {speed}"
        );
    }

    #[test]
    fn a_wrong_word_is_named_with_its_line_and_the_remedy() {
        let cases = [
            (
                "START\nSTRAT\n",
                "line 2: \"STRAT\" is not a command; write STATUS, START, STOP, EMPTY, or GCODE",
            ),
            (
                "STOP 1",
                "line 1: STOP has 1 words behind it and takes none",
            ),
            (
                "\nGCODE 1 2 3",
                "line 2: GCODE has 3 words; write the 4 of a move or the 10 of a curve",
            ),
            (
                "GCODE 0x01000000 0x12g4 0 0",
                "line 1: word 2, \"0x12g4\", is not a number of 32 bits; write 0x",
            ),
            (
                "GCODE 0x101000000 0 0 0",
                "line 1: word 1, \"0x101000000\", is not a number of 32 bits",
            ),
            ("GCODE 0x+1 0 0 0", "line 1: word 1, \"0x+1\", is not a"),
            (
                "GCODE 0x02000000 0 0 0",
                "line 1: instruction 2 is not a move; the command of a move is 1",
            ),
            (
                "GCODE 0x01000000 0 0 7",
                "line 1: 0x7 where an instruction's unused bytes are: words are missing; the lower",
            ),
            (
                "GCODE 0x01000000 5 0 0",
                "line 1: steps of acceleration without an acceleration; give an acceleration",
            ),
            (
                "GCODE 0x04b10001 0 0 0 0 0 0 0 0 0",
                "line 1: 1201 ticks, of 1100 at most; give the curve fewer ticks",
            ),
        ];
        for (text, said) in cases {
            assert!(wrong(text).starts_with(said), "{text}: {}", wrong(text));
        }
    }

    #[test]
    fn the_bits_of_the_status_have_their_names() {
        assert_eq!(bits(0), Vec::<String>::new());
        assert_eq!(bits(1), ["FULL"]);
        assert_eq!(bits(3), ["FULL", "DISPATCHERROR"]);
        assert_eq!(bits(0x8000_0002), ["DISPATCHERROR", "bit 31"]);
    }

    proptest! {
        #[test]
        fn an_instruction_that_is_written_is_read(direction: u8, aux: u16, loops: [u16; 3], motors: [[i32; 3]; AXES]) {
            let [loops_accel, loops_travel, loops_decel] = loops;
            let moved = Move { direction, aux, acceleration: 7, loops_accel, loops_travel, deceleration: 9, loops_decel };
            let curve = Curve { aux: aux as u8, ticks: 77, motors };
            for (form, words) in [(0, moved.words().to_vec()), (1, curve.words().to_vec())] {
                let hex: Vec<String> = words.iter().map(|word| format!("{word:#x}")).collect();
                let signed: Vec<String> = words.iter().map(|word| (*word as i32).to_string()).collect();
                for text in [hex, signed] {
                    let line = WordsLine::parse(1, &format!("GCODE {}", text.join(" "))).unwrap().unwrap();
                    prop_assert_eq!((line.form, &line.words), (form, &words));
                }
            }
        }

        #[test]
        fn any_text_is_a_line_or_a_complaint_that_names_it(text in "[ -~]{0,60}") {
            if let Err(error) = WordsLine::parse(7, &text) {
                prop_assert!(error.to_string().starts_with("line 7: "));
            }
        }
    }
}
