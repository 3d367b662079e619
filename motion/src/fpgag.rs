//! FPGA G's instruction as a parsed type: the 14 bytes of its description, first field in the highest byte.
//!
//! | bytes | field | meaning |
//! |---|---|---|
//! | 1 | command | 1: a move; 0: nothing |
//! | 1 | direction | one bit for each motor, 1 backwards |
//! | 2 | aux | outputs |
//! | 2, 2 | acceleration, loops accel | how many steps speed up, and how fast |
//! | 2 | loops travel | how many steps keep their speed |
//! | 2, 2 | deceleration, loops decel | how many steps slow down, and how fast |
//!
//! Its code had fields its description has not, and its last version a third form. What the unit of the acceleration is, it never
//! said; whoever executes this says it. Here the words are taken apart, and refused when they are no instruction.

use core::fmt;

/// Bytes of an instruction.
pub const BYTES: usize = 14;

/// Words it is sent in; the last two bytes of the last are 0.
pub const WORDS: usize = 4;

/// The command beside a word.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Command {
    /// Nothing.
    Empty,
    /// The word is the next of an instruction.
    Gcode,
    /// The reply is the status.
    Status,
    /// Execute.
    Start,
    /// Execute no more.
    Stop,
}

impl Command {
    /// From its code.
    pub const fn from_code(code: u8) -> Option<Command> {
        match code {
            0 => Some(Command::Empty),
            1 => Some(Command::Gcode),
            2 => Some(Command::Status),
            3 => Some(Command::Start),
            4 => Some(Command::Stop),
            _ => None,
        }
    }

    /// Its code.
    pub const fn code(self) -> u8 {
        match self {
            Command::Empty => 0,
            Command::Gcode => 1,
            Command::Status => 2,
            Command::Start => 3,
            Command::Stop => 4,
        }
    }
}

/// The reply's status bits; a reply of 0 is normal.
pub mod status {
    /// No room for another instruction; this one was refused.
    pub const FULL: u32 = 1;
    /// Not an instruction; it was refused.
    pub const PARSE_ERROR: u32 = 2;
}

/// A move.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Move {
    /// One bit for each motor, 1 backwards.
    pub direction: u8,
    /// Outputs.
    pub aux: u16,
    /// Acceleration, in units of the executor.
    pub acceleration: u16,
    /// Steps speeding up.
    pub loops_accel: u16,
    /// Steps at speed.
    pub loops_travel: u16,
    /// Deceleration, likewise.
    pub deceleration: u16,
    /// Steps slowing down.
    pub loops_decel: u16,
}

/// What is wrong with an instruction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Error {
    /// Its first byte is not that of a move.
    Command(u8),
    /// The unused bytes at its end are not 0: the words are out of step.
    Padding(u16),
    /// It speeds up or slows down for some steps at no acceleration.
    NoAcceleration,
}

impl fmt::Display for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Error::Command(code) => write!(f, "instruction {code} is not a move"),
            Error::Padding(bytes) => write!(
                f,
                "{bytes:#x} where an instruction's unused bytes are: words are missing"
            ),
            Error::NoAcceleration => write!(f, "steps of acceleration without an acceleration"),
        }
    }
}

impl Move {
    /// The command byte of a move.
    pub const COMMAND: u8 = 1;

    /// From its words.
    pub fn parse(words: [u32; WORDS]) -> Result<Move, Error> {
        let [head, accel, travel, decel] = words;
        let (high, low) = (|word: u32| (word >> 16) as u16, |word: u32| word as u16);
        let command = (head >> 24) as u8;
        if command != Move::COMMAND {
            return Err(Error::Command(command));
        }
        if low(decel) != 0 {
            return Err(Error::Padding(low(decel)));
        }
        let parsed = Move {
            direction: (head >> 16) as u8,
            aux: low(head),
            acceleration: high(accel),
            loops_accel: low(accel),
            loops_travel: high(travel),
            deceleration: low(travel),
            loops_decel: high(decel),
        };
        let nothing = |accel: u16, loops: u16| accel == 0 && loops != 0;
        if nothing(parsed.acceleration, parsed.loops_accel)
            || nothing(parsed.deceleration, parsed.loops_decel)
        {
            return Err(Error::NoAcceleration);
        }
        Ok(parsed)
    }

    /// As its words.
    pub fn words(&self) -> [u32; WORDS] {
        let word = |high: u16, low: u16| u32::from(high) << 16 | u32::from(low);
        [
            u32::from(Move::COMMAND) << 24 | u32::from(self.direction) << 16 | u32::from(self.aux),
            word(self.acceleration, self.loops_accel),
            word(self.loops_travel, self.deceleration),
            word(self.loops_decel, 0),
        ]
    }

    /// Steps of the motor that makes the most.
    pub fn loops(&self) -> u32 {
        u32::from(self.loops_accel) + u32::from(self.loops_travel) + u32::from(self.loops_decel)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn the_fields_are_where_the_description_has_them() {
        let words = [0x0105_00ff, 0x1234_0010, 0x0200_4321, 0x0020_0000];
        let expected = Move {
            direction: 5,
            aux: 0xff,
            acceleration: 0x1234,
            loops_accel: 0x10,
            loops_travel: 0x200,
            deceleration: 0x4321,
            loops_decel: 0x20,
        };
        assert_eq!(Move::parse(words), Ok(expected));
        assert_eq!((expected.words(), expected.loops()), (words, 0x230));
    }

    #[test]
    fn what_is_no_move_is_refused() {
        assert_eq!(Move::parse([0x0200_0000, 0, 0, 0]), Err(Error::Command(2)));
        assert_eq!(Move::parse([0x0100_0000, 0, 0, 7]), Err(Error::Padding(7)));
        assert_eq!(
            Move::parse([0x0100_0000, 1, 0, 0]),
            Err(Error::NoAcceleration)
        );
        assert_eq!(
            Move::parse([0x0100_0000, 0, 0, 1 << 16]),
            Err(Error::NoAcceleration)
        );
    }

    #[test]
    fn unknown_commands_are_none() {
        for code in 0..=255 {
            assert_eq!(
                Command::from_code(code).map(Command::code),
                (code < 5).then_some(code)
            );
        }
    }

    proptest! {
        #[test]
        fn what_is_written_is_read(direction: u8, aux: u16, acceleration in 1..u16::MAX, deceleration in 1..u16::MAX, loops: [u16; 3]) {
            let [loops_accel, loops_travel, loops_decel] = loops;
            let written = Move { direction, aux, acceleration, loops_accel, loops_travel, deceleration, loops_decel };
            prop_assert_eq!(Move::parse(written.words()), Ok(written));
        }

        #[test]
        fn no_words_are_both_refused_and_changed(words: [u32; WORDS]) {
            if let Ok(parsed) = Move::parse(words) {
                prop_assert_eq!(parsed.words(), words);
            }
        }
    }
}
