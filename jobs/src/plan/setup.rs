//! The machine in the units of the planner and of the integrators.

use super::FASTEST;
use core::fmt;
use motion::segment::AXES;
use motion::wide::{product, scaled, wide};
use wire::units::Position;

/// One axis of the machine.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct AxisSetup {
    /// Steps in a kilometre: a million times the steps in a millimetre.
    pub steps_per_km: u64,
    /// nm/s.
    pub max_speed: u32,
    /// nm/s^2.
    pub max_accel: u64,
}

/// The machine.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Setup {
    /// The board's clock.
    pub clock_hz: u32,
    /// X, Y, Z.
    pub axes: [AxisSetup; AXES],
    /// Largest distance of a chord from its arc, in nm.
    pub chord_tolerance: u32,
    /// Largest distance of a blend from its corner, in nm. 0 stops at every corner.
    pub junction_deviation: u32,
    /// How long all axes rest after the outputs have changed, in microseconds: a pen needs time to
    /// move.
    pub aux_settle: u32,
}

/// What is wrong with a setup; the number is that of the axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SetupError {
    /// Not between 1 MHz and 1 GHz.
    Clock,
    /// No steps, or more than 100 000 in a millimetre.
    Scale(usize),
    /// Less than three units of velocity, or more than a step in four clocks.
    Speed(usize),
    /// More than 100 g or than a segment can represent, or too small for one.
    Accel(usize),
    /// A chord tolerance below 1 um.
    Tolerance,
}

impl fmt::Display for SetupError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let name = |axis: usize| ['X', 'Y', 'Z'].get(axis).copied().unwrap_or('?');
        match *self {
            SetupError::Clock => write!(f, "the clock is between 1 MHz and 1 GHz"),
            SetupError::Scale(axis) => {
                write!(
                    f,
                    "{}: steps per mm are above 0 and at most 100 000",
                    name(axis)
                )
            }
            SetupError::Speed(axis) => {
                write!(
                    f,
                    "{}: the speed is above 3 clock / 2^32 steps/s and at most one step in four clocks",
                    name(axis)
                )
            }
            SetupError::Accel(axis) => write!(
                f,
                "{}: the acceleration in steps/s^2 is between clock^2 / 2^44 and clock^2 / 2^25, and at most 100 g",
                name(axis)
            ),
            SetupError::Tolerance => write!(f, "the chord tolerance is at least 1 um"),
        }
    }
}

/// A setup in the units of the integrators.
#[derive(Clone, Copy, Debug)]
pub(super) struct Machinery {
    pub(super) setup: Setup,
    /// 2^64 / clock.
    pub(super) per_clock: i64,
    /// Steps per nm, 2^64 times.
    pub(super) scale: [i64; AXES],
    /// nm per step, 2^23 times, rounded up.
    pub(super) pitch: [u64; AXES],
    /// nm/s. A 4096th and two units of velocity below the limit, as room for corrections.
    pub(super) speed: [u64; AXES],
    /// nm/s^2. A 64th below the limit, for the same reason.
    pub(super) accel: [u64; AXES],
    /// Units of a segment's acceleration: the limit itself.
    pub(super) limit: [u32; AXES],
}

impl Machinery {
    pub(super) fn new(setup: &Setup) -> Result<Self, SetupError> {
        if !(1_000_000..=1_000_000_000).contains(&setup.clock_hz) {
            return Err(SetupError::Clock);
        }
        if setup.chord_tolerance < 1000 {
            return Err(SetupError::Tolerance);
        }
        let clock = i128::from(setup.clock_hz);
        let mut machinery = Machinery {
            setup: *setup,
            per_clock: ((1 << 64) / clock) as i64,
            scale: [0; AXES],
            pitch: [0; AXES],
            speed: [0; AXES],
            accel: [0; AXES],
            limit: [0; AXES],
        };
        for (index, axis) in setup.axes.iter().enumerate() {
            if !(1..=100_000_000_000).contains(&axis.steps_per_km) {
                return Err(SetupError::Scale(index));
            }
            let scale = (i128::from(axis.steps_per_km) << 64) / 1_000_000_000_000;
            // Steps per clock, 2^64 times; a quarter at most.
            let velocity = i128::from(axis.max_speed) * scale / clock;
            if axis.max_speed == 0 || velocity > 1 << 62 {
                return Err(SetupError::Speed(index));
            }
            // f^2 / 2^56 steps/s^2 is the unit.
            let limit = (i128::from(axis.max_accel) * scale / (clock * clock)) >> 8;
            if axis.max_accel > 1_000_000_000_000 || !(1 << 12..1 << 31).contains(&limit) {
                return Err(SetupError::Accel(index));
            }
            machinery.scale[index] = scale as i64;
            machinery.pitch[index] = (1_000_000_000_000u64 << 23).div_ceil(axis.steps_per_km);
            // A unit of velocity is 2^-32 steps per clock.
            let unit = u64::try_from((clock << 32) / scale).unwrap_or(u64::MAX);
            let speed =
                u64::from(axis.max_speed - axis.max_speed / 4096).saturating_sub(2 * (unit + 1));
            if speed == 0 {
                return Err(SetupError::Speed(index));
            }
            machinery.speed[index] = speed;
            machinery.accel[index] = axis.max_accel - axis.max_accel / 64;
            machinery.limit[index] = limit as u32;
        }
        Ok(machinery)
    }

    /// An integrator's position for a position of the job.
    pub(super) fn position(&self, axis: usize, nm: i64) -> i64 {
        scaled(nm, self.scale[axis], 32) + Position::ZERO.0
    }

    /// Clocks (with 16 fraction bits) for `distance` nm (with 16 fraction bits) at `speed` nm/s.
    pub(super) fn clocks(&self, distance: i64, speed: u64) -> i64 {
        let all = product(distance.unsigned_abs(), self.setup.clock_hz.into());
        wide(all, speed.max(1)).min(FASTEST / 2) as i64
    }

    /// An integrator's velocity for a speed along a path with so many steps per nm (2^64 times).
    pub(super) fn velocity(&self, speed: u64, slope: i64) -> i64 {
        scaled(scaled(speed as i64, slope, 32), self.per_clock, 40)
    }
}
