//! The machine a job is for: a TOML file. Every value must be given; there are no defaults.

use ::jobs::plan::{AxisSetup, Planner, Setup};
use motion::segment::AXES;
use serde::Deserialize;
use std::path::Path;
use wire::jobs;

/// A machine.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MachineFile {
    /// The board's clock, in Hz.
    pub clock: u32,
    /// How far chords may be from their arc, in mm.
    pub chord_tolerance: f64,
    /// How far a corner may be rounded, in mm.
    pub junction_deviation: f64,
    /// How long everything rests after the tool was switched, in seconds.
    pub tool_delay: f64,
    /// Outputs of the board that follow the job: 0 and 16 are M3's. The others stay low.
    pub outputs: Vec<u8>,
    /// Outputs of the job (0 is M3's) that are off unless the axes move: a laser.
    pub beam: Vec<u8>,
    /// Outputs of the board that are active low.
    pub active_low: Vec<u8>,
    /// Outputs of the board that are high while it is not armed.
    pub safe_high: Vec<u8>,
    /// Axes.
    pub x: Axis,
    /// Axes.
    pub y: Axis,
    /// Axes.
    pub z: Axis,
}

/// An axis of it.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Axis {
    /// Steps in a millimetre.
    pub steps_per_mm: f64,
    /// mm/s.
    pub speed: f64,
    /// mm/s^2.
    pub acceleration: f64,
    /// Where it may be, in mm from home.
    pub min: f64,
    /// Where it may be, in mm from home.
    pub max: f64,
    /// How long STEP is active, in ns.
    pub steplen: u32,
    /// How long it is inactive at least, in ns.
    pub stepspace: u32,
    /// From a change of DIR to the next STEP, in ns.
    pub dirsetup: u32,
    /// From the end of a STEP to a change of DIR, in ns.
    pub dirhold: u32,
    /// STEP is active low.
    pub step_inverted: bool,
    /// DIR is low for minus.
    pub dir_inverted: bool,
    /// Its switch; an axis without one is at 0 where it was started.
    pub home: Option<Home>,
}

/// The switch of an axis: where it opens is 0.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Home {
    /// In which direction it lies.
    pub towards: Direction,
    /// Input of the board.
    pub input: u8,
    /// Its level while the switch is closed.
    pub closed: Level,
    /// Axes with the lowest number are homed first.
    pub order: u8,
    /// mm/s towards it.
    pub fast: f64,
    /// mm/s off it, for the place that counts.
    pub slow: f64,
    /// How far off it between the two, in mm.
    pub backoff: f64,
    /// How far it may be, in mm.
    pub travel: f64,
    /// How long all of it may take, in seconds.
    pub timeout: f64,
    /// How long the input has to stay the same, in microseconds.
    pub debounce: u32,
}

/// Of an axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Direction {
    /// Towards smaller numbers.
    Minus,
    /// Towards larger ones.
    Plus,
}

/// Of a pin.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Level {
    /// 0 V.
    Low,
    /// The other.
    High,
}

impl MachineFile {
    /// From a file.
    pub fn read(file: &Path) -> Result<MachineFile, String> {
        let name = file.display();
        let text = std::fs::read_to_string(file).map_err(|error| format!("{name}: {error}"))?;
        let machine = MachineFile::parse(&text).map_err(|error| format!("{name}: {error}"))?;
        Ok(machine)
    }

    /// From its text.
    pub fn parse(text: &str) -> Result<MachineFile, String> {
        let machine: MachineFile = toml::from_str(text).map_err(|error| error.to_string())?;
        for (axis, name) in machine.axes().iter().zip(["x", "y", "z"]) {
            if axis.min.is_nan() || axis.max.is_nan() || axis.min > axis.max {
                return Err(format!("{name}: min is above max"));
            }
        }
        Planner::<3>::new(&machine.setup()).map_err(|error| error.to_string())?;
        let pins = [
            ("outputs", &machine.outputs, 32),
            ("beam", &machine.beam, 16),
            ("active_low", &machine.active_low, 32),
            ("safe_high", &machine.safe_high, 32),
        ];
        for (name, pins, end) in pins {
            if let Some(pin) = pins.iter().find(|pin| **pin >= end) {
                return Err(format!("{name}: {pin} is not one of 0 to {}", end - 1));
            }
        }
        // The board itself checks the values that depend on its pins.
        let board = machine.to_board();
        board
            .check(machine.clock, 32, 32)
            .map_err(|(field, axis)| {
                format!("{}: {}", ["x", "y", "z"][usize::from(axis)], field.text())
            })?;
        Ok(machine)
    }

    /// As a board is told.
    pub fn to_board(&self) -> jobs::MachineConfig {
        let setup = self.setup();
        let bits = |pins: &[u8]| pins.iter().fold(0u32, |bits, pin| bits | 1 << (pin & 31));
        let nm = |mm: f64| (mm * 1e6).round();
        let axis = |index: usize| {
            let (axis, setup) = (self.axes()[index], &setup.axes[index]);
            jobs::Axis {
                steps_per_km: setup.steps_per_km,
                max_speed: setup.max_speed,
                max_accel: setup.max_accel,
                lowest: nm(axis.min) as i64,
                highest: nm(axis.max) as i64,
                steplen: axis.steplen,
                stepspace: axis.stepspace,
                dirsetup: axis.dirsetup,
                dirhold: axis.dirhold,
                step_invert: axis.step_inverted,
                dir_invert: axis.dir_inverted,
                home: axis.home.as_ref().map(|home| jobs::Home {
                    plus: home.towards == Direction::Plus,
                    low: home.closed == Level::Low,
                    input: home.input,
                    order: home.order,
                    fast: nm(home.fast) as u32,
                    slow: nm(home.slow) as u32,
                    backoff: nm(home.backoff) as u32,
                    travel: nm(home.travel) as u32,
                    timeout: (home.timeout * 1e3).round() as u32,
                    debounce: home.debounce,
                }),
            }
        };
        jobs::MachineConfig {
            chord_tolerance: setup.chord_tolerance,
            junction_deviation: setup.junction_deviation,
            tool_delay: setup.aux_settle,
            outputs: bits(&self.outputs),
            beam: bits(&self.beam) as u16,
            invert: bits(&self.active_low),
            safe: bits(&self.safe_high),
            axes: [axis(0), axis(1), axis(2)],
        }
    }

    /// X, Y, Z.
    pub fn axes(&self) -> [&Axis; AXES] {
        [&self.x, &self.y, &self.z]
    }

    /// As the planner wants it.
    pub fn setup(&self) -> Setup {
        // `as` saturates, and the planner refuses what is out of bounds.
        Setup {
            clock_hz: self.clock,
            axes: self.axes().map(|axis| AxisSetup {
                steps_per_km: (axis.steps_per_mm * 1e6).round() as u64,
                max_speed: (axis.speed * 1e6).round() as u32,
                max_accel: (axis.acceleration * 1e6).round() as u64,
            }),
            chord_tolerance: (self.chord_tolerance * 1e6).round() as u32,
            junction_deviation: (self.junction_deviation * 1e6).round() as u32,
            aux_settle: (self.tool_delay * 1e6).round() as u32,
        }
    }

    /// A place in mm that this axis cannot reach.
    pub fn outside(&self, axis: usize, mm: f64) -> bool {
        let limits = self.axes()[axis];
        mm < limits.min || mm > limits.max
    }
}
