//! Homes the axes: finds their switches, one axis after the other.
//!
//! ```text
//!   seek     fast towards the switch, until it closes          (not if it is closed to begin with)
//!   off      fast off it, until it opens, and on for the back-off
//!   near     slow towards it, until it closes
//!   leave    slow off it, until it opens: that place is 0
//! ```
//!
//! Between two of these steps the axis comes to rest. The exchange that commands a velocity reads
//! the switch and the position of one clock, so the error of the position is the way in a
//! millisecond at the slow speed. Each way and the time are limited. A caller that ends homing lets
//! the axis come to rest.

use crate::inside::Velocities;
use motion::segment::AXES;
use wire::exchange::Status;
use wire::jobs::{End, Home, MachineConfig};
use wire::units::{Accel, Velocity};

/// The state of an axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Step {
    /// Reads the switch.
    Begin,
    Seek,
    Off,
    Near,
    Leave,
}

/// What the caller does next.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Next {
    /// Moves on with this velocity.
    Go,
    /// It failed at this axis; it may still move.
    Failed(End, u8),
    /// All axes were homed.
    Done,
}

/// The homing of some axes.
#[derive(Clone, Copy, Debug)]
pub struct Homing {
    left: [bool; AXES],
    axis: Option<usize>,
    step: Step,
    /// This step is complete: the axis comes to rest.
    stops: bool,
    opened: bool,
    from: i64,
    since: u64,
    /// Where each switch opened.
    pub found: [Option<i64>; AXES],
    /// The velocities for the next exchange.
    pub velocities: Velocities,
}

impl Homing {
    /// For these axes; all of them have switches.
    pub fn new(axes: [bool; AXES], rest: Velocities) -> Self {
        Homing {
            left: axes,
            axis: None,
            step: Step::Begin,
            stops: false,
            opened: false,
            from: 0,
            since: 0,
            found: [None; AXES],
            velocities: rest,
        }
    }

    /// The axis that is being homed.
    pub fn axis(&self) -> u8 {
        self.axis.map_or(0xff, |axis| axis as u8)
    }

    /// Takes the last exchange's status and decides.
    pub fn step(
        &mut self,
        machine: &MachineConfig,
        clock_hz: u32,
        status: &Status,
        now: u64,
    ) -> Next {
        let Some(axis) = self.axis.or_else(|| self.next(machine, now)) else {
            return Next::Done;
        };
        let Some((setup, home)) = machine.axes.get(axis).and_then(|a| Some((a, a.home?))) else {
            return Next::Failed(End::NoSwitch, axis as u8);
        };
        let Some((position, velocity)) = status.stepgen.get(axis).copied() else {
            return Next::Failed(End::NoSwitch, axis as u8);
        };
        let closed = (status.gpio_in >> home.input & 1 == 1) != home.low;
        let position = position.0;
        if now.wrapping_sub(self.since) > u64::from(home.timeout) * u64::from(clock_hz / 1000) {
            let stuck = matches!(self.step, Step::Off | Step::Leave) && closed;
            let why = if stuck {
                End::StuckSwitch
            } else {
                End::NoSwitch
            };
            return Next::Failed(why, axis as u8);
        }
        if self.stops {
            if velocity.0 == 0 {
                self.begin(axis, &home, setup, clock_hz, position);
            }
            return Next::Go;
        }
        let way = position.wrapping_sub(self.from).unsigned_abs();
        let steps = |nm: u32| steps(nm, setup.steps_per_km);
        let far = way > steps(home.travel);
        match self.step {
            Step::Begin => {
                // The same state as if the step before had just ended.
                self.step = if closed { Step::Seek } else { Step::Begin };
                self.begin(axis, &home, setup, clock_hz, position);
            }
            Step::Seek | Step::Near if closed => self.stop(axis),
            Step::Seek | Step::Near if far => return Next::Failed(End::NoSwitch, axis as u8),
            Step::Seek | Step::Near => {}
            Step::Off if self.opened && way >= steps(home.backoff) => self.stop(axis),
            Step::Off if self.opened => {}
            Step::Off if !closed => (self.opened, self.from) = (true, position),
            Step::Leave if !closed => {
                if let Some(found) = self.found.get_mut(axis) {
                    *found = Some(position);
                }
                self.stop(axis);
            }
            Step::Off | Step::Leave if far => {
                return Next::Failed(End::StuckSwitch, axis as u8);
            }
            Step::Off | Step::Leave => {}
        }
        if self.axis.is_none() && self.left == [false; AXES] {
            return Next::Done;
        }
        Next::Go
    }

    /// The next axis: the lowest order first, then X before Y.
    fn next(&mut self, machine: &MachineConfig, now: u64) -> Option<usize> {
        let order = |axis: &usize| {
            let home = machine.axes.get(*axis).and_then(|axis| axis.home);
            home.map_or(0, |home| home.order)
        };
        let left = |axis: &usize| self.left.get(*axis) == Some(&true);
        let axis = (0..AXES).filter(left).min_by_key(order)?;
        if let Some(left) = self.left.get_mut(axis) {
            *left = false;
        }
        (self.axis, self.since) = (Some(axis), now);
        (self.step, self.stops, self.opened) = (Step::Begin, false, false);
        Some(axis)
    }

    /// Begins the step after the one that is done.
    fn begin(
        &mut self,
        axis: usize,
        home: &Home,
        setup: &wire::jobs::Axis,
        clock_hz: u32,
        position: i64,
    ) {
        (self.stops, self.opened, self.from) = (false, false, position);
        let (next, speed, towards) = match self.step {
            Step::Begin => (Step::Seek, home.fast, true),
            Step::Seek => (Step::Off, home.fast, false),
            Step::Off => (Step::Near, home.slow, true),
            Step::Near => (Step::Leave, home.slow, false),
            Step::Leave => {
                self.axis = None;
                return;
            }
        };
        self.step = next;
        let velocity = velocity(speed, setup.steps_per_km, clock_hz);
        self.set(
            axis,
            if towards == home.plus {
                velocity
            } else {
                -velocity
            },
        );
    }

    fn stop(&mut self, axis: usize) {
        self.stops = true;
        self.set(axis, 0);
    }

    fn set(&mut self, axis: usize, velocity: i32) {
        if let Some((place, _)) = self.velocities.get_mut(axis) {
            *place = Velocity(velocity);
        }
    }
}

/// A length in an integrator's units.
fn steps(nm: u32, steps_per_km: u64) -> u64 {
    let steps = ((u128::from(nm) * u128::from(steps_per_km)) << 32) / 1_000_000_000_000;
    u64::try_from(steps).unwrap_or(u64::MAX)
}

/// At least one unit.
fn velocity(nm_per_s: u32, steps_per_km: u64, clock_hz: u32) -> i32 {
    let velocity = ((u128::from(nm_per_s) * u128::from(steps_per_km)) << 32)
        / (1_000_000_000_000 * u128::from(clock_hz.max(1)));
    i32::try_from(velocity).unwrap_or(i32::MAX).max(1)
}

/// Velocity 0, reached with these accelerations.
pub fn rest(limits: &[u32; AXES]) -> Velocities {
    limits.map(|limit| (Velocity(0), Accel(limit)))
}
