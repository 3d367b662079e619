//! Holds the axes on their path when they have to stop without the host: all of them reach rest together.
//!
//! In the core every step generator brakes at its own `stop_accel`, alone and without a CPU. Left at what the host
//! configured, an axis that moves slowly would stand long before a fast one, and the tool would leave the line it was
//! on. So behind the answer of every command that is executed the decelerations are made to fit each other: with
//! `v` the rates as they will be when the watchdog bites and `a` the configured decelerations,
//!
//! ```text
//!   T = max v[j] / a[j]        the axis that needs longest sets the time
//!   stop_accel[i] = v[i] / T   everybody takes just as long; nobody brakes harder than configured
//! ```
//!
//! What is written waits in the cores; whoever stops the machine softly, the gateware alone or the firmware, stops it
//! so. At rest the cores hold what the host configured.
//!
//! On the path is who is enabled, moves, and was not said to be alone (a spindle, a conveyor: velocity mode). Everybody
//! else keeps what was configured; so does who was configured with 0, which stops at once.
//!
//! # How exact
//!
//! * An axis stops never later than the one that sets the time, and earlier by at most two parts in `stop_accel[i]`:
//!   that is the rounding, upwards, and less than `T^2 / 20` steps off the line at 60 MHz, with `T` in seconds.
//! * No axis brakes at less than 1/256 of what was configured ([`FLOOR_SHIFT`]). Where the line asks for less, an axis
//!   deviates by less than a thousandth of the way it would take to stop from a `T` long run-up. This is for the some hundred clocks
//!   between a commit and what is computed here: should the CPU die in them, an axis brakes at what was meant for
//!   the command before, and must come to rest all the same.
//! * The rate at the bite is known: the ramp goes on for the watchdog's timeout. A stop that somebody orders
//!   while an axis still ramps, within the period of the command, finds it up to one period's ramp off.

use crate::cores::{Board, LATCH_STEPGEN, STAGE_ENABLES, STAGE_STEPGEN, Setting};
use wire::exchange::{
    COMMAND_STEPGEN, FLAG_ALONE_SHIFT, FLAG_APPLY_TIME, MAX_CHANNELS, STATUS_STEPGEN,
};
use wire::map::{BoardConfig, StepgenConfig};

/// 1/256: from the ramp of one period at 1 kHz, the most an axis can be faster than was known, to rest in a quarter of a second.
pub const FLOOR_SHIFT: u32 = 8;
/// Fraction bits of a stepgen's velocity below its unit: by what an acceleration moves it each clock.
const FRACTION: u32 = 24;

/// What the host configured, while the cores hold something else.
#[derive(Clone, Debug)]
pub(crate) struct PathStop {
    /// The cores may hold ours.
    active: bool,
    axes: [Axis; MAX_CHANNELS],
    /// The watchdog's, in clocks.
    timeout: u32,
    /// Flags of the command that was executed and not yet looked at; 0 if there is none.
    flags: u32,
}

/// A step generator, as far as stopping it goes.
#[derive(Clone, Copy, Debug)]
struct Axis {
    /// What the host configured.
    configured: u32,
    /// How fast it will be on the path; 0 if it is not on it.
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

    /// The machine is about to be armed: what the cores hold is what the host configured.
    pub(crate) fn begin(&mut self, board: &mut impl Board, stepgens: usize) {
        if !self.active {
            self.active = true;
            for (n, axis) in (0u8..).zip(self.axes.iter_mut().take(stepgens)) {
                axis.configured = board.setting(stop_accel(n));
            }
            self.timeout = board.setting(Setting::Board(BoardConfig::WatchdogTimeout));
        }
    }

    /// The machine is at rest: gives the cores back what was configured.
    pub(crate) fn end(&mut self, board: &mut impl Board, stepgens: usize) {
        if self.active {
            self.active = false;
            self.flags = 0;
            for (n, axis) in self.axes.iter().take(stepgens).enumerate() {
                board.set_stop_accel(n, axis.configured);
            }
        }
    }

    /// What the host configured, if the core may hold something else.
    pub(crate) fn configured(&self, which: Setting) -> Option<u32> {
        match which {
            Setting::Stepgen(n, StepgenConfig::StopAccel) if self.active => {
                self.axes.get(usize::from(n)).map(|axis| axis.configured)
            }
            _ => None,
        }
    }

    /// A command with these flags, never 0, was executed; [`PathStop::hold`] shall see to it when there is time.
    #[inline(always)]
    pub(crate) fn executed(&mut self, flags: u32) {
        self.flags = flags;
    }

    /// Was a command executed since [`PathStop::hold`]?
    #[inline(always)]
    pub(crate) fn owed(&self) -> bool {
        self.flags != 0
    }

    /// Makes the decelerations fit the command that was executed last.
    #[inline(always)]
    pub(crate) fn hold(&mut self, board: &mut impl Board, stepgens: usize) {
        let flags = core::mem::take(&mut self.flags);
        let timed = flags & FLAG_APPLY_TIME != 0;
        // Still staged: what was executed is what was staged last.
        let mut members = board.staged(STAGE_ENABLES) & !(flags >> FLAG_ALONE_SHIFT);
        let axes = self.axes.get_mut(..stepgens).unwrap_or(&mut []);
        let mut slowest = Slowest::NOBODY;
        for (n, axis) in axes.iter_mut().enumerate() {
            axis.speed = 0;
            if members & 1 != 0 && axis.configured != 0 {
                let at = STAGE_STEPGEN + n * COMMAND_STEPGEN;
                let (target, limit) = (board.staged(at) as i32, board.staged(at + 1));
                let now = board.latched(LATCH_STEPGEN + n * STATUS_STEPGEN + 2) as i32;
                axis.speed = speed_after(now, target, limit, self.timeout);
                if timed {
                    // Until its time comes the command before is in force.
                    axis.speed = axis.speed.max(now.unsigned_abs());
                }
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

/// How fast a stepgen will be `clocks` from `now`, either way, if it ramps towards `target` by at most `limit` a clock.
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

/// The axis that takes longest to stop, of those met so far.
#[derive(Clone, Copy, Debug)]
struct Slowest {
    speed: u32,
    accel: u32,
}

impl Slowest {
    const NOBODY: Slowest = Slowest { speed: 0, accel: 1 };

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
            // The top bit goes to bit 30, so that no remainder outgrows a word.
            while rest >> 30 == 0 {
                rest <<= 1;
                shift += 1;
            }
            while divisor >> 30 == 0 {
                divisor <<= 1;
                shift = shift.wrapping_sub(1);
            }
            // Or from bit 31: rounded up, and a speed has it only in -2^31.
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

/// A deceleration for every speed, so that all take the same time.
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
        // One more for the fraction: rather a step early than a step late.
        let share = (exact + 1).min(axis.configured.into()) as u32;
        share.max(axis.configured >> FLOOR_SHIFT)
    }
}

#[cfg(test)]
mod tests;
