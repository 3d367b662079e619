//! The machine that a board moves: `machine.toml`, in binary.
//!
//! ```text
//! version:u8 axes:u8 0:u16  chord_tolerance:u32 junction_deviation:u32 tool_delay:u32  outputs:u32 beam:u16 0:u16 invert:u32 safe:u32
//! then per axis, X first, 84 bytes:
//!   steps_per_km:u64 max_speed:u32 0:u32 max_accel:u64 lowest:i64 highest:i64
//!   steplen:u32 stepspace:u32 dirsetup:u32 dirhold:u32  mode:u8 home:u8 order:u8 input:u8
//!   fast:u32 slow:u32 backoff:u32 travel:u32 timeout:u32 debounce:u32
//! ```
//!
//! Bit 0 of `mode` inverts STEP and bit 1 inverts DIR. Bit 0 of `home` means that there is a
//! switch, bit 1 that it is in the direction of plus, bit 2 that its input is low while it is
//! closed. Axes of the lowest order are homed first, axes of the same order one after the other, X
//! first.

use super::{Reader, Status, Writer};
use crate::channels::WORD_PINS;
use crate::map::{DIR_CLOCKS_MAX, STEP_CLOCKS_MAX, WATCHDOG_SECONDS_MAX};

/// Axes of a job: X, Y, Z.
pub const AXES: usize = 3;

const VERSION: u8 = 1;
/// 9 s: the longest stop. With one more second ([`GRACE_SECONDS`]) it is the longest grace of a
/// watchdog.
const STOP_SECONDS: u64 = WATCHDOG_SECONDS_MAX - GRACE_SECONDS;
/// 1 s more than the longest stop, so that the grace never ends a stop, and a stop still counts as
/// completed if the firmware did other work for most of a second.
const GRACE_SECONDS: u64 = 1;
/// 10 m: no position of a job is further from home.
const FARTHEST: i64 = 10_000_000_000;
const STEP_INVERT: u8 = 1;
const DIR_INVERT: u8 = 2;
const SWITCH: u8 = 1;
const PLUS: u8 = 2;
const LOW: u8 = 4;

/// The machine.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MachineConfig {
    /// Largest distance of a chord from its arc, in nm.
    pub chord_tolerance: u32,
    /// Largest distance of a rounded corner from its corner, in nm; 0 stops at every corner.
    pub junction_deviation: u32,
    /// How long all axes rest after the tool was switched, in microseconds.
    pub tool_delay: u32,
    /// Outputs of the board that follow the job: bit 0 of M3 drives outputs 0 and 16, and so on.
    /// The others stay low.
    pub outputs: u32,
    /// Outputs of the job that are off unless the axes move: a laser.
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
    /// Lowest position, in nm from home.
    pub lowest: i64,
    /// Highest position, in nm from home.
    pub highest: i64,
    /// How long STEP is active, in ns.
    pub steplen: u32,
    /// Shortest time it is inactive, in ns.
    pub stepspace: u32,
    /// From a change of DIR to the next STEP, in ns.
    pub dirsetup: u32,
    /// From the end of a STEP to a change of DIR, in ns.
    pub dirhold: u32,
    /// STEP is active low.
    pub step_invert: bool,
    /// DIR is low for minus.
    pub dir_invert: bool,
    /// Its switch, if it has one. The position at which the switch opens is 0.
    pub home: Option<Home>,
}

/// The switch of an axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Home {
    /// The switch is in the direction of plus.
    pub plus: bool,
    /// The input is low while it is closed.
    pub low: bool,
    /// Which input, 0 to 31.
    pub input: u8,
    /// Its place in the order of homing, lowest first.
    pub order: u8,
    /// nm/s towards the switch.
    pub fast: u32,
    /// nm/s off the switch, for the position that counts.
    pub slow: u32,
    /// How far the axis moves off the switch in between, in nm, after the switch has opened.
    pub backoff: u32,
    /// Largest distance to the switch, in nm.
    pub travel: u32,
    /// Largest duration of homing, in ms.
    pub timeout: u32,
    /// How long the input has to be stable, in microseconds.
    pub debounce: u32,
}

/// What is wrong with a machine: the invalid field.
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
    /// No acceleration, or more than 100 g, or more than a board can represent.
    Acceleration = 4,
    /// The lowest position is above the highest, or one is more than 10 m away.
    Limits = 5,
    /// Longer than a board can time, or 0.
    StepTiming = 6,
    /// A missing input, no speed, no back-off, no time.
    Home = 7,
    /// This board's jobs have fewer axes or outputs.
    Board = 8,
    /// STEP and its pause do not fit into the period of the largest speed.
    TooFast = 9,
    /// A stop takes longer than a board waits for it.
    Stop = 10,
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
            10 => Field::Stop,
            _ => return None,
        })
    }

    /// A text for the operator.
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
            Field::Stop => {
                "to stop from its speed takes the axis longer than the 9 s its board waits: lower the speed or raise the acceleration"
            }
        }
    }
}

impl MachineConfig {
    /// Bytes of it.
    pub const BYTES: usize = 32 + AXES * 84;

    /// From its bytes. [`MachineConfig::check`] checks what depends on the board's clock and pins.
    pub fn parse(payload: &[u8]) -> Result<MachineConfig, Status> {
        let mut reader = Reader::new(payload);
        let machine = MachineConfig::fields(&mut reader).ok_or(Status::Malformed)?;
        reader.end(machine).ok_or(Status::Malformed)
    }

    fn fields(reader: &mut Reader) -> Option<MachineConfig> {
        let head = (reader.u8()?, reader.u8()?, reader.u16()?);
        (head == (VERSION, AXES as u8, 0)).then_some(())?;
        let mut machine = MachineConfig {
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

    /// The watchdog's grace for a soft stop, in clocks: the time the slowest axis takes to stop
    /// from its largest speed, and a second.
    pub fn grace(&self, clock_hz: u32) -> u32 {
        let stop = self.axes.iter().map(|axis| axis.stop(clock_hz)).max();
        let clocks = stop.unwrap_or(0) + GRACE_SECONDS * u64::from(clock_hz);
        u32::try_from(clocks).unwrap_or(u32::MAX)
    }

    /// Can a board with this clock and this number of channels drive this machine? The planner has
    /// its own ranges of speed and acceleration.
    pub fn check(&self, clock_hz: u32, inputs: u8, outputs: u8) -> Result<(), (Field, u8)> {
        if self.chord_tolerance < 1000 {
            return Err((Field::ChordTolerance, 0));
        }
        // A job controls outputs of the first word.
        let none = WORD_PINS.saturating_sub(outputs);
        let pins = u32::MAX.checked_shr(none.into()).unwrap_or(0);
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
        // Clocks from step to step, times nm/s, times steps/km (1e12 nm): at most a second's
        // clocks.
        let period = u64::from(clocks(self.steplen) + clocks(self.stepspace));
        let busy = u128::from(period * u64::from(self.max_speed)) * u128::from(self.steps_per_km);
        if busy > u128::from(clock_hz) * 1_000_000_000_000 {
            return Err(Field::TooFast);
        }
        if self.stop(clock_hz) > STOP_SECONDS * u64::from(clock_hz) {
            return Err(Field::Stop);
        }
        match self.home {
            Some(home) if !home.possible(self, inputs) => Err(Field::Home),
            Some(_) | None => Ok(()),
        }
    }
}

impl Axis {
    /// Clocks to stop from the largest speed.
    fn stop(&self, clock_hz: u32) -> u64 {
        (u64::from(self.max_speed) * u64::from(clock_hz)).div_ceil(self.max_accel.max(1))
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
    /// Step timings in clocks, for a step generator's configuration.
    pub fn timings(&self, clock_hz: u32) -> [u32; 4] {
        [self.steplen, self.stepspace, self.dirsetup, self.dirhold].map(|ns| clocks(ns, clock_hz))
    }
}
