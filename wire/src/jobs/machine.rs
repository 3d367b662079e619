//! What a board has to know of the machine it moves: `machine.toml`, in binary.
//!
//! ```text
//! version:u8 axes:u8 0:u16  chord_tolerance:u32 junction_deviation:u32 tool_delay:u32  outputs:u32 beam:u16 0:u16 invert:u32 safe:u32
//! then per axis, X first, 84 bytes:
//!   steps_per_km:u64 max_speed:u32 0:u32 max_accel:u64 lowest:i64 highest:i64
//!   steplen:u32 stepspace:u32 dirsetup:u32 dirhold:u32  mode:u8 home:u8 order:u8 input:u8
//!   fast:u32 slow:u32 backoff:u32 travel:u32 timeout:u32 debounce:u32
//! ```
//!
//! `mode` has bit 0 for STEP and bit 1 for DIR inverted. `home` has bit 0 if there is a switch, bit 1 if it lies towards plus, bit 2 if its input
//! is low while it is closed. Axes of the lowest order are homed first, those of one order one after the other, X first.

use super::{Reader, Status, Writer};
use crate::map::{DIR_CLOCKS_MAX, STEP_CLOCKS_MAX};

/// Axes of a job: X, Y, Z.
pub const AXES: usize = 3;

const VERSION: u8 = 1;
/// 10 m: no place of a job is further from home.
const FARTHEST: i64 = 10_000_000_000;
const STEP_INVERT: u8 = 1;
const DIR_INVERT: u8 = 2;
const SWITCH: u8 = 1;
const PLUS: u8 = 2;
const LOW: u8 = 4;

/// The machine.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Machine {
    /// How far chords may be from their arc, in nm.
    pub chord_tolerance: u32,
    /// How far a corner may be rounded, in nm; 0 stops at every corner.
    pub junction_deviation: u32,
    /// How long everything rests after the tool was switched, in microseconds.
    pub tool_delay: u32,
    /// Outputs of the board that follow the job: M3's bit 0 drives 0 and 16, and so on. The others stay low.
    pub outputs: u32,
    /// The job's outputs that are off unless the axes move: a laser.
    pub beam: u16,
    /// Outputs of the board that are active low.
    pub invert: u32,
    /// Levels of the outputs while the board is not armed.
    pub safe: u32,
    /// X, Y, Z.
    pub axes: [Axis; AXES],
}

/// An axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Axis {
    /// Steps in a kilometre: a million times the steps in a millimetre.
    pub steps_per_km: u64,
    /// nm/s.
    pub max_speed: u32,
    /// nm/s^2.
    pub max_accel: u64,
    /// Where it may be, in nm from home.
    pub lowest: i64,
    /// Where it may be, in nm from home.
    pub highest: i64,
    /// How long STEP is active, in ns.
    pub steplen: u32,
    /// How long it is inactive at least, in ns.
    pub stepspace: u32,
    /// From a change of DIR to the next STEP, in ns.
    pub dirsetup: u32,
    /// From the end of a STEP to a change of DIR, in ns.
    pub dirhold: u32,
    /// STEP is active low.
    pub step_invert: bool,
    /// DIR is low for minus.
    pub dir_invert: bool,
    /// Its switch, if it has one. Where the switch opens is 0.
    pub home: Option<Home>,
}

/// The switch of an axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Home {
    /// It lies towards plus.
    pub plus: bool,
    /// The input is low while it is closed.
    pub low: bool,
    /// Which input, 0 to 31.
    pub input: u8,
    /// Lowest first.
    pub order: u8,
    /// nm/s towards the switch.
    pub fast: u32,
    /// nm/s off the switch, for the place that counts.
    pub slow: u32,
    /// How far it goes off the switch between the two, in nm, beyond where it opened.
    pub backoff: u32,
    /// How far the switch may be, in nm.
    pub travel: u32,
    /// How long all of it may take, in ms.
    pub timeout: u32,
    /// How long the input has to stay the same to be believed, in microseconds.
    pub debounce: u32,
}

/// What is wrong with a machine.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Field {
    /// The format.
    Format = 0,
    /// A chord tolerance below 1 um.
    ChordTolerance = 1,
    /// No steps, or more than 100 000 in a millimetre.
    Scale = 2,
    /// No speed, or more than a step in four clocks.
    Speed = 3,
    /// No acceleration, or beyond 100 g, or what a board can say.
    Acceleration = 4,
    /// The lowest is above the highest place, or one is further than 10 m.
    Limits = 5,
    /// Longer than a board can time, or none.
    StepTiming = 6,
    /// A switch at an input there is none of, no speed, a back-off of nothing, no time.
    Home = 7,
    /// This board's jobs have fewer axes or outputs.
    Board = 8,
    /// STEP and its pause do not fit into the period of the largest speed.
    TooFast = 9,
}

impl Field {
    /// From its code.
    pub const fn from_code(code: u8) -> Option<Field> {
        Some(match code {
            0 => Field::Format,
            1 => Field::ChordTolerance,
            2 => Field::Scale,
            3 => Field::Speed,
            4 => Field::Acceleration,
            5 => Field::Limits,
            6 => Field::StepTiming,
            7 => Field::Home,
            8 => Field::Board,
            9 => Field::TooFast,
            _ => return None,
        })
    }

    /// For people.
    pub const fn text(self) -> &'static str {
        match self {
            Field::Format => "the description has another format",
            Field::ChordTolerance => "the chord tolerance is at least 1 um",
            Field::Scale => "steps per mm are above 0 and at most 100 000",
            Field::Speed => "the speed is above 0 and at most a step in four clocks of the board",
            Field::Acceleration => {
                "the acceleration is above 0 and at most 100 g and what the board can count"
            }
            Field::Limits => "the limits lie within 10 m of home, the lower below the upper",
            Field::StepTiming => {
                "steplen and stepspace are above 0 and at most 136 us, dirsetup and dirhold at most 1.09 ms"
            }
            Field::Home => {
                "a switch needs an input of the board, speeds up to the axis', a way, a back-off and a time"
            }
            Field::Board => "the board has no such output or axis",
            Field::TooFast => "steplen and stepspace do not fit between two steps at the speed",
        }
    }
}

impl Machine {
    /// Bytes of it.
    pub const BYTES: usize = 32 + AXES * 84;

    /// From its bytes. What depends on the board's clock and pins is asked of [`Machine::check`].
    pub fn parse(payload: &[u8]) -> Result<Machine, Status> {
        let mut reader = Reader::new(payload);
        let machine = Machine::fields(&mut reader).ok_or(Status::Malformed)?;
        reader.end(machine).ok_or(Status::Malformed)
    }

    fn fields(reader: &mut Reader) -> Option<Machine> {
        let head = (reader.u8()?, reader.u8()?, reader.u16()?);
        (head == (VERSION, AXES as u8, 0)).then_some(())?;
        let mut machine = Machine {
            chord_tolerance: reader.u32()?,
            junction_deviation: reader.u32()?,
            tool_delay: reader.u32()?,
            outputs: reader.u32()?,
            beam: reader.u16()?,
            invert: {
                reader.u16().filter(|zero| *zero == 0)?;
                reader.u32()?
            },
            safe: reader.u32()?,
            axes: [Axis::NONE; AXES],
        };
        for axis in &mut machine.axes {
            *axis = Axis::fields(reader)?;
        }
        Some(machine)
    }

    /// As bytes.
    pub fn emit<'w, 'p>(&self, payload: &'w mut Writer<'p>) -> &'w mut Writer<'p> {
        payload.u8(VERSION).u8(AXES as u8).u16(0);
        payload.u32(self.chord_tolerance);
        payload.u32(self.junction_deviation).u32(self.tool_delay);
        payload.u32(self.outputs).u16(self.beam).u16(0);
        payload.u32(self.invert).u32(self.safe);
        for axis in &self.axes {
            axis.emit(payload);
        }
        payload
    }

    /// Whether a board with this clock and so many channels can be it. The planner has its own ranges of speed and acceleration.
    pub fn check(&self, clock_hz: u32, inputs: u8, outputs: u8) -> Result<(), (Field, u8)> {
        if self.chord_tolerance < 1000 {
            return Err((Field::ChordTolerance, 0));
        }
        let pins = u32::MAX.checked_shr(32 - u32::from(outputs)).unwrap_or(0);
        if (self.outputs | self.invert | self.safe) & !pins != 0 {
            return Err((Field::Board, 0));
        }
        for (index, axis) in (0..).zip(&self.axes) {
            axis.check(clock_hz, inputs)
                .map_err(|field| (field, index))?;
        }
        Ok(())
    }
}

impl Axis {
    const NONE: Axis = Axis {
        steps_per_km: 0,
        max_speed: 0,
        max_accel: 0,
        lowest: 0,
        highest: 0,
        steplen: 0,
        stepspace: 0,
        dirsetup: 0,
        dirhold: 0,
        step_invert: false,
        dir_invert: false,
        home: None,
    };

    fn fields(reader: &mut Reader) -> Option<Axis> {
        let mut axis = Axis {
            steps_per_km: reader.u64()?,
            max_speed: reader.u32()?,
            ..Axis::NONE
        };
        reader.u32().filter(|zero| *zero == 0)?;
        axis.max_accel = reader.u64()?;
        (axis.lowest, axis.highest) = (reader.i64()?, reader.i64()?);
        (axis.steplen, axis.stepspace) = (reader.u32()?, reader.u32()?);
        (axis.dirsetup, axis.dirhold) = (reader.u32()?, reader.u32()?);
        let (mode, bits) = (reader.u8()?, reader.u8()?);
        (mode & !(STEP_INVERT | DIR_INVERT) == 0 && bits & !(SWITCH | PLUS | LOW) == 0)
            .then_some(())?;
        axis.step_invert = mode & STEP_INVERT != 0;
        axis.dir_invert = mode & DIR_INVERT != 0;
        let home = Home {
            plus: bits & PLUS != 0,
            low: bits & LOW != 0,
            order: reader.u8()?,
            input: reader.u8()?,
            fast: reader.u32()?,
            slow: reader.u32()?,
            backoff: reader.u32()?,
            travel: reader.u32()?,
            timeout: reader.u32()?,
            debounce: reader.u32()?,
        };
        axis.home = (bits & SWITCH != 0).then_some(home);
        (axis.home.is_some() || home == Home::NONE).then_some(axis)
    }

    fn emit(&self, payload: &mut Writer) {
        let flag = |set: bool, bit: u8| if set { bit } else { 0 };
        payload.u64(self.steps_per_km).u32(self.max_speed).u32(0);
        payload.u64(self.max_accel);
        payload.i64(self.lowest).i64(self.highest);
        payload.u32(self.steplen).u32(self.stepspace);
        payload.u32(self.dirsetup).u32(self.dirhold);
        payload.u8(flag(self.step_invert, STEP_INVERT) | flag(self.dir_invert, DIR_INVERT));
        let home = self.home.unwrap_or(Home::NONE);
        let switch = flag(self.home.is_some(), SWITCH);
        payload.u8(switch | flag(home.plus, PLUS) | flag(home.low, LOW));
        payload.u8(home.order).u8(home.input);
        payload.u32(home.fast).u32(home.slow).u32(home.backoff);
        payload
            .u32(home.travel)
            .u32(home.timeout)
            .u32(home.debounce);
    }

    fn check(&self, clock_hz: u32, inputs: u8) -> Result<(), Field> {
        let clocks = |ns: u32| clocks(ns, clock_hz);
        if !(1..=100_000_000_000).contains(&self.steps_per_km) {
            return Err(Field::Scale);
        }
        if self.max_speed == 0 {
            return Err(Field::Speed);
        }
        if !(1..=1_000_000_000_000).contains(&self.max_accel) {
            return Err(Field::Acceleration);
        }
        let near = -FARTHEST..=FARTHEST;
        if !near.contains(&self.lowest)
            || !near.contains(&self.highest)
            || self.lowest > self.highest
        {
            return Err(Field::Limits);
        }
        let (step, dir) = (1..=STEP_CLOCKS_MAX, 0..=DIR_CLOCKS_MAX);
        let timed = step.contains(&clocks(self.steplen))
            && step.contains(&clocks(self.stepspace))
            && dir.contains(&clocks(self.dirsetup))
            && dir.contains(&clocks(self.dirhold));
        if !timed {
            return Err(Field::StepTiming);
        }
        // Clocks from step to step, times nm/s, times steps/km (1e12 nm): at most a second's clocks.
        let period = u64::from(clocks(self.steplen) + clocks(self.stepspace));
        let busy = u128::from(period * u64::from(self.max_speed)) * u128::from(self.steps_per_km);
        if busy > u128::from(clock_hz) * 1_000_000_000_000 {
            return Err(Field::TooFast);
        }
        match self.home {
            Some(home) if !home.possible(self, inputs) => Err(Field::Home),
            Some(_) | None => Ok(()),
        }
    }
}

/// Rounded up, so that no driver gets less than it needs.
pub(super) fn clocks(ns: u32, clock_hz: u32) -> u32 {
    let clocks = (u64::from(ns) * u64::from(clock_hz)).div_ceil(1_000_000_000);
    u32::try_from(clocks).unwrap_or(u32::MAX)
}

impl Home {
    const NONE: Home = Home {
        plus: false,
        low: false,
        input: 0,
        order: 0,
        fast: 0,
        slow: 0,
        backoff: 0,
        travel: 0,
        timeout: 0,
        debounce: 0,
    };

    fn possible(&self, axis: &Axis, inputs: u8) -> bool {
        let speed = 1..=axis.max_speed;
        self.input < inputs
            && speed.contains(&self.fast)
            && speed.contains(&self.slow)
            && self.backoff > 0
            && self.travel > 0
            && self.timeout > 0
    }
}

impl Axis {
    /// Step timings in clocks, as a step generator's configuration wants them.
    pub fn timings(&self, clock_hz: u32) -> [u32; 4] {
        [self.steplen, self.stepspace, self.dirsetup, self.dirhold].map(|ns| clocks(ns, clock_hz))
    }
}
