//! The machine a job is for: a TOML file. Everything in it must be said; nothing has a default.

use motion::plan::{AxisSetup, Planner, Setup};
use motion::segment::AXES;
use serde::Deserialize;
use std::path::Path;

/// A machine.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Machine {
    /// The board's clock, in Hz.
    pub clock: u32,
    /// How far chords may be from their arc, in mm.
    pub chord_tolerance: f64,
    /// How far a corner may be rounded, in mm.
    pub junction_deviation: f64,
    /// How long everything rests after the tool was switched, in seconds.
    pub tool_delay: f64,
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
}

impl Machine {
    /// From a file.
    pub fn read(file: &Path) -> Result<Machine, String> {
        let name = file.display();
        let text = std::fs::read_to_string(file).map_err(|error| format!("{name}: {error}"))?;
        let machine = Machine::parse(&text).map_err(|error| format!("{name}: {error}"))?;
        Ok(machine)
    }

    /// From its text.
    pub fn parse(text: &str) -> Result<Machine, String> {
        let machine: Machine = toml::from_str(text).map_err(|error| error.to_string())?;
        for (axis, name) in machine.axes().iter().zip(["x", "y", "z"]) {
            if axis.min.is_nan() || axis.max.is_nan() || axis.min > axis.max {
                return Err(format!("{name}: min is above max"));
            }
        }
        Planner::<3>::new(&machine.setup()).map_err(|error| error.to_string())?;
        Ok(machine)
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
