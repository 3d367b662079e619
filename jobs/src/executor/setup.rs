//! The machine in the units of the planner, of FPGA G's words and of the segments core.

use super::LOOK_AHEAD;
use crate::plan::{AxisSetup, Planner, Setup, SetupError};
use crate::player::Limits;
use motion::segment::AXES;
use wire::jobs::{Field, MachineConfig};

/// The planner for this machine, or what it cannot plan with.
pub fn planner(machine: &MachineConfig, clock_hz: u32) -> Result<Planner<LOOK_AHEAD>, (Field, u8)> {
    let setup = Setup {
        clock_hz,
        axes: machine.axes.map(|axis| AxisSetup {
            steps_per_km: axis.steps_per_km,
            max_speed: axis.max_speed,
            max_accel: axis.max_accel,
        }),
        chord_tolerance: machine.chord_tolerance,
        junction_deviation: machine.junction_deviation,
        aux_settle: machine.tool_delay,
    };
    Planner::new(&setup).map_err(|error| match error {
        SetupError::Clock => (Field::Board, 0),
        SetupError::Scale(axis) => (Field::Scale, axis as u8),
        SetupError::Speed(axis) => (Field::Speed, axis as u8),
        SetupError::Accel(axis) => (Field::Acceleration, axis as u8),
        SetupError::Tolerance => (Field::ChordTolerance, 0),
    })
}

/// The limits of the words.
pub fn limits(machine: &MachineConfig, accel: &[u32; AXES], clock_hz: u32) -> Limits {
    let steps = |nm: i64, per_km: u64| {
        (i128::from(nm) * i128::from(per_km)).div_euclid(1_000_000_000_000) as i64
    };
    // The lowest step is the first one inside the lower limit, the highest the last inside the
    // upper one.
    let lowest = |nm: i64, per_km: u64| -steps(-nm, per_km);
    Limits {
        clock_hz,
        accel: *accel,
        speed: machine
            .axes
            .map(|axis| steps(axis.max_speed.into(), axis.steps_per_km) as u32),
        bounds: machine.axes.map(|axis| {
            let per_km = axis.steps_per_km;
            (lowest(axis.lowest, per_km), steps(axis.highest, per_km))
        }),
    }
}

/// How fast path time comes to a stand: at full speed this adds a quarter of the acceleration of
/// the weakest axis.
pub fn slew(machine: &MachineConfig, clock_hz: u32) -> u32 {
    let per_second = machine
        .axes
        .iter()
        .map(|axis| (u128::from(axis.max_accel) << 32) / (4 * u128::from(axis.max_speed.max(1))));
    let slew = per_second.min().unwrap_or(0) / u128::from(clock_hz.max(1));
    u32::try_from(slew).unwrap_or(u32::MAX).max(1)
}
