//! FPGA G's instruction as a parsed type: the 14 bytes of its description, first field in the
//! highest byte.
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
//! Its code had fields that its description does not have, and its last version a third form. It
//! never stated the unit of the acceleration; the executor defines it ([`crate::player`]). This
//! module parses the words, and refuses them if they are not an instruction.

use core::fmt;
use motion::segment::AXES;

/// Length of an instruction in bytes.
pub const BYTES: usize = 14;

/// Number of words it is sent in; the last two bytes of the last word are 0.
pub const WORDS: usize = 4;

/// The command that is sent with a word.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FpgagCommand {
    /// No command.
    Empty,
    /// The word is the next of an instruction.
    Gcode,
    /// The reply is the status.
    Status,
    /// Start execution.
    Start,
    /// Stop execution.
    Stop,
}

impl FpgagCommand {
    /// From its code.
    pub const fn from_code(code: u8) -> Option<FpgagCommand> {
        match code {
            0 => Some(FpgagCommand::Empty),
            1 => Some(FpgagCommand::Gcode),
            2 => Some(FpgagCommand::Status),
            3 => Some(FpgagCommand::Start),
            4 => Some(FpgagCommand::Stop),
            _ => None,
        }
    }

    /// Its code.
    pub const fn code(self) -> u8 {
        match self {
            FpgagCommand::Empty => 0,
            FpgagCommand::Gcode => 1,
            FpgagCommand::Status => 2,
            FpgagCommand::Start => 3,
            FpgagCommand::Stop => 4,
        }
    }
}

/// The reply's status bits; a reply of 0 is normal.
pub mod status {
    /// There is no room for another instruction; this one was refused.
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
    /// Acceleration, in the executor's units.
    pub acceleration: u16,
    /// Number of steps while speeding up.
    pub loops_accel: u16,
    /// Number of steps at constant speed.
    pub loops_travel: u16,
    /// Deceleration, in the same units.
    pub deceleration: u16,
    /// Number of steps while slowing down.
    pub loops_decel: u16,
}

/// Words of an instruction of the final revision, three motors.
pub const CURVE_WORDS: usize = 1 + 3 * AXES;

/// Ticks of a curve that does not give a number: the longest curve.
pub const CURVE_TICKS: u16 = 1100;

/// A curve of the final revision. Word 0 is command (bits 7:0), outputs (15:8) and 16 bits without
/// a use there; here they are the ticks (1 us each, 0 is [`CURVE_TICKS`]). Then there are three
/// signed words per motor.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Curve {
    /// Outputs.
    pub aux: u8,
    /// Duration in ticks, 1 to 1100.
    pub ticks: u16,
    /// Per motor c0, c1, c2: after t ticks it has made `(c0 t + c1 t^2 + c2 t^3) / 2^31` steps.
    pub motors: [[i32; 3]; AXES],
}

impl Curve {
    /// From its words.
    pub fn parse(words: [u32; CURVE_WORDS]) -> Result<Curve, Error> {
        let [head, motors @ ..] = words;
        let [command, aux, ..] = head.to_le_bytes();
        if command != Move::COMMAND {
            return Err(Error::Command(command));
        }
        let ticks = (head >> 16) as u16;
        if ticks > CURVE_TICKS {
            return Err(Error::Ticks(ticks));
        }
        let mut curve = Curve {
            aux,
            ticks: if ticks == 0 { CURVE_TICKS } else { ticks },
            motors: [[0; 3]; AXES],
        };
        for (motor, words) in curve.motors.iter_mut().zip(motors.as_chunks().0) {
            *motor = words.map(|word| word as i32);
        }
        Ok(curve)
    }

    /// As its words.
    pub fn words(&self) -> [u32; CURVE_WORDS] {
        let mut words = [0; CURVE_WORDS];
        let [head, motors @ ..] = &mut words;
        *head = u32::from_le_bytes([Move::COMMAND, self.aux, 0, 0]) | u32::from(self.ticks) << 16;
        for (words, motor) in motors.as_chunks_mut().0.iter_mut().zip(self.motors) {
            *words = motor.map(|word| word as u32);
        }
        words
    }
}

/// What is wrong with an instruction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Error {
    /// Its first byte is not the command of a move.
    Command(u8),
    /// The unused bytes at its end are not 0: the words are out of step.
    Padding(u16),
    /// More ticks than a curve may last.
    Ticks(u16),
    /// A moving motor would reverse or stop at once.
    Jump,
    /// More speed or acceleration than the machine's limits.
    Fast,
    /// It leaves the machine's limits, or could not stop within them.
    Bounds,
    /// It accelerates for some steps with an acceleration of 0.
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
            Error::Ticks(ticks) => write!(f, "{ticks} ticks, of {CURVE_TICKS} at most"),
            Error::Jump => write!(f, "a moving motor would have to jump"),
            Error::Fast => write!(f, "more speed or acceleration than the machine has"),
            Error::Bounds => write!(
                f,
                "it leaves the machine's limits, or could not stop within them"
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

    /// Steps of the motor that makes the most steps.
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
                FpgagCommand::from_code(code).map(FpgagCommand::code),
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
        fn a_curve_that_is_written_is_read(aux: u8, ticks in 1..=CURVE_TICKS, motors: [[i32; 3]; AXES]) {
            let written = Curve { aux, ticks, motors };
            prop_assert_eq!(Curve::parse(written.words()), Ok(written));
            let mut words = written.words();
            words[0] &= 0xffff;
            prop_assert_eq!(Curve::parse(words), Ok(Curve { ticks: CURVE_TICKS, ..written }));
            words[0] |= u32::from(CURVE_TICKS + ticks) << 16;
            prop_assert_eq!(Curve::parse(words), Err(Error::Ticks(CURVE_TICKS + ticks)));
        }

        #[test]
        fn no_words_are_both_refused_and_changed(words: [u32; WORDS]) {
            if let Ok(parsed) = Move::parse(words) {
                prop_assert_eq!(parsed.words(), words);
            }
        }
    }
}
