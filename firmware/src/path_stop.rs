//! Keeps the axes on their path when they have to stop without the host: all of them reach rest at
//! the same time.
//!
//! In gateware every step generator brakes alone, at its own `stop_accel` and without a CPU. With
//! the values the host configured, a slow axis would stand long before a fast one, and the tool
//! would leave its line. So after the answer to every executed command the firmware adapts the
//! decelerations to each other: with `v` the largest velocities between the command and the
//! watchdog's bite and `a` the configured decelerations,
//!
//! ```text
//!   T = max v[j] / a[j]        the axis that needs longest sets the time
//!   stop_accel[i] = v[i] / T   all take equally long; none brakes harder than configured
//! ```
//!
//! The values wait in the cores. Every soft stop uses them, both a stop by the gateware alone and
//! one by the firmware. At rest the cores hold the host's values.
//!
//! An axis is on the path if it is enabled, moves, and was not declared alone (a spindle, a
//! conveyor: velocity mode). Every other axis keeps its configured value. So does an axis that is
//! configured with 0, which stops at once.
//!
//! While the segments core is not idle, all axes keep their configured values. The command's
//! velocities are 0 then and do not describe the motion, and the motion will have changed when the
//! watchdog bites. In a soft stop a job leaves its path, but keeps its acceleration limits.
//!
//! # How exact
//!
//! * An axis never stops later than the axis that sets the time. It stops earlier by at most two
//!   parts in `stop_accel[i]`. That is the upward rounding, and less than `T^2 / 20` steps off the
//!   line at 60 MHz, with `T` in seconds.
//! * No axis brakes at less than 1/256 of its configured value ([`FLOOR_SHIFT`]). Where the line
//!   asks for less, an axis deviates by less than a thousandth of the way it would take to stop
//!   from a `T` long run-up. The floor is for the few hundred clocks between a commit and the end
//!   of this computation: if the CPU dies in them, an axis brakes with the value for the command
//!   before, and must still come to rest.
//! * If the stop comes between the command and the bite, all axes stand within `T`: none is faster
//!   than the velocity its deceleration was computed for. On a straight line all velocities change
//!   in proportion, and the axes stay on it. In a corner an axis that slows down stands earlier, by
//!   what its velocity has changed since the command.

use crate::cores::{Board, Setting};
use wire::exchange::{COMMAND_STEPGEN, FLAG_ALONE_SHIFT, MAX_CHANNELS, STATUS_STEPGEN};
use wire::map::{BoardConfig, StepgenConfig};
use wire::regmap::{self, command, segments, status};

/// 1/256: from the ramp of one period at 1 kHz, the most an axis can be faster than was known, to
/// rest in a quarter of a second.
pub const FLOOR_SHIFT: u32 = 8;
/// Fraction bits of a stepgen's velocity below its unit: an acceleration is added there each clock.
const FRACTION: u32 = 24;

/// The segments core's status, and what of it says that the core is not idle.
const SEGMENTS_STATUS: u32 = regmap::address(segments::BASE, segments::STATUS);
const SEGMENTS_BUSY: u32 = segments::STATUS_STATE;

/// The host's configured values, while the cores hold others.
#[derive(Clone, Debug)]
pub(crate) struct PathStop {
    /// The cores may hold our values.
    active: bool,
    axes: [Axis; MAX_CHANNELS],
    /// The watchdog's timeout, in clocks.
    timeout: u32,
    /// Flags of the command that was executed and not yet handled; 0 if there is none.
    flags: u32,
}

/// A step generator, as far as stopping it goes.
#[derive(Clone, Copy, Debug)]
struct Axis {
    /// What the host configured.
    configured: u32,
    /// Its velocity on the path; 0 if it is not on the path.
    speed: u32,
}

impl PathStop {
    pub(crate) const fn new() -> Self {
        let axis = Axis {
            configured: 0,
            speed: 0,
        };
        PathStop {
            active: false,
            axes: [axis; MAX_CHANNELS],
            timeout: 0,
            flags: 0,
        }
    }

    /// The machine has been armed: the cores hold the host's values.
    fn begin(&mut self, board: &mut impl Board, stepgens: usize) {
        self.active = true;
        for (n, axis) in (0u8..).zip(self.axes.iter_mut().take(stepgens)) {
            axis.configured = board.setting(stop_accel(n));
        }
        self.timeout = board.setting(Setting::Board(BoardConfig::WatchdogTimeout));
    }

    /// The machine is at rest: restores the configured values in the cores.
    pub(crate) fn end(&mut self, board: &mut impl Board, stepgens: usize) {
        if self.active {
            self.active = false;
            self.flags = 0;
            for (n, axis) in self.axes.iter().take(stepgens).enumerate() {
                board.set_stop_accel(n, axis.configured);
            }
        }
    }

    /// The configured value, if the core may hold another one.
    pub(crate) fn configured(&self, which: Setting) -> Option<u32> {
        match which {
            Setting::Stepgen(n, StepgenConfig::StopAccel) if self.active => {
                self.axes.get(usize::from(n)).map(|axis| axis.configured)
            }
            _ => None,
        }
    }

    /// A command with these flags, never 0, was executed; [`PathStop::hold`] has to run for it
    /// later.
    #[inline(always)]
    pub(crate) fn executed(&mut self, flags: u32) {
        self.flags = flags;
    }

    /// Is there an executed command that [`PathStop::hold`] has not run for?
    #[inline(always)]
    pub(crate) fn owed(&self) -> bool {
        self.flags != 0
    }

    /// Makes the decelerations fit the command that was executed last. `segments`: the board can
    /// play them. The first time after arming it notes the host's values, which takes longer: here,
    /// behind the answer, and not in front of it.
    #[inline(always)]
    pub(crate) fn hold(&mut self, board: &mut impl Board, stepgens: usize, segments: bool) {
        if !self.active {
            self.begin(board, stepgens);
        }
        let flags = core::mem::take(&mut self.flags);
        // The command is still staged: the one that was staged last was executed.
        let mut members = board.staged(command::ENABLES) & !(flags >> FLAG_ALONE_SHIFT);
        if segments && board.csr_read(SEGMENTS_STATUS) & SEGMENTS_BUSY != 0 {
            members = 0;
        }
        let axes = self.axes.get_mut(..stepgens).unwrap_or(&mut []);
        let mut slowest = Slowest::NONE;
        for (n, axis) in axes.iter_mut().enumerate() {
            axis.speed = 0;
            if members & 1 != 0 && axis.configured != 0 {
                let at = command::STEPGEN0_VELOCITY + n * COMMAND_STEPGEN;
                let (target, limit) = (board.staged(at) as i32, board.staged(at + 1));
                let now = board.latched(status::STEPGEN0_VELOCITY + n * STATUS_STEPGEN) as i32;
                let then = speed_after(now, target, limit, self.timeout);
                // The stop may come at once, or before the time of a timed command.
                axis.speed = then.max(now.unsigned_abs());
                slowest.meet(axis);
            }
            members >>= 1;
        }
        let pace = slowest.pace();
        for (n, axis) in axes.iter().enumerate() {
            board.set_stop_accel(n, pace.share(axis));
        }
    }
}

const fn stop_accel(n: u8) -> Setting {
    Setting::Stepgen(n, StepgenConfig::StopAccel)
}

/// A stepgen's speed `clocks` after `now`, in either direction, if it ramps towards `target` by at
/// most `limit` a clock.
#[inline(always)]
fn speed_after(now: i32, target: i32, limit: u32, clocks: u32) -> u32 {
    let reach = (u64::from(limit) * u64::from(clocks)) >> FRACTION;
    let then = if limit == 0 || reach >= u64::from(now.abs_diff(target)) {
        target
    } else if target > now {
        now.wrapping_add(reach as i32)
    } else {
        now.wrapping_sub(reach as i32)
    };
    then.unsigned_abs()
}

/// The axis that takes longest to stop, among those seen so far.
#[derive(Clone, Copy, Debug)]
struct Slowest {
    speed: u32,
    accel: u32,
}

impl Slowest {
    const NONE: Slowest = Slowest { speed: 0, accel: 1 };

    #[inline(always)]
    fn meet(&mut self, axis: &Axis) {
        let (speed, accel) = (axis.speed, axis.configured);
        // speed / accel > self.speed / self.accel, without a division.
        if u64::from(speed) * u64::from(self.accel) > u64::from(self.speed) * u64::from(accel) {
            *self = Slowest { speed, accel };
        }
    }

    /// Its deceleration per speed, `accel / speed`, as 32 significant bits, rounded up.
    #[inline(always)]
    fn pace(self) -> Pace {
        let (mut rest, mut divisor, mut shift) = (self.accel, self.speed, 0u32);
        if divisor != 0 {
            // Shifts the top bit to bit 30, so that no remainder exceeds a word.
            while rest >> 30 == 0 {
                rest <<= 1;
                shift += 1;
            }
            while divisor >> 30 == 0 {
                divisor <<= 1;
                shift = shift.wrapping_sub(1);
            }
            // Or from bit 31: rounded up, and only a speed of -2^31 has that bit.
            if rest >> 31 != 0 {
                rest = (rest >> 1) + 1;
                shift = shift.wrapping_sub(1);
            }
            if divisor >> 31 != 0 {
                divisor >>= 1;
                shift = shift.wrapping_add(1);
            }
        }
        let mut ratio = 0u32;
        for _ in 0..u32::BITS {
            let fits = rest >= divisor;
            rest = rest.wrapping_sub(if fits { divisor } else { 0 }) << 1;
            ratio = ratio << 1 | u32::from(fits);
        }
        Pace {
            ratio: ratio.saturating_add(1),
            shift: (u32::BITS - 1).wrapping_add(shift),
        }
    }
}

/// A deceleration per speed, so that all axes take the same time.
#[derive(Clone, Copy, Debug)]
struct Pace {
    ratio: u32,
    shift: u32,
}

impl Pace {
    #[inline(always)]
    fn share(self, axis: &Axis) -> u32 {
        if axis.speed == 0 {
            return axis.configured;
        }
        let exact = (u64::from(axis.speed) * u64::from(self.ratio)) >> (self.shift & 63);
        // One more for the fraction: better a step early than a step late.
        let share = (exact + 1).min(axis.configured.into()) as u32;
        share.max(axis.configured >> FLOOR_SHIFT)
    }
}

#[cfg(test)]
mod tests;
