//! A jog: so far, so fast, and only while a key is held.
//!
//! A terminal says that a key is pressed and then repeats it; few say that it is released. So a
//! press alone moves nothing. The first repeat moves, and 200 ms without another one is the
//! release: it is at most that late. What makes the repeats late also stops the machine.
//!
//! ```text
//!  press      repeat  repeat  repeat                 released
//!    |          |       |       |  .........200 ms.....|
//!    |<-700 ms->|       it moves                       it brakes
//! ```

use std::time::Duration;
use wire::units::Position;

/// Between a press and its first repeat: 660 ms is X's default, 500 ms that of other systems.
const FIRST: Duration = Duration::from_millis(700);
/// Between two repeats: the slowest default is Linux' console with 92 ms.
const REPEAT: Duration = Duration::from_millis(200);
/// Seconds in which the way that is left is to be gone at the end: ten exchanges of 5 ms and more.
const APPROACH_S: f64 = 0.05;
/// Steps from the middle of the target's step at which it is there; half of one is the next step.
const THERE: f64 = 0.25;

/// A direction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Way {
    /// To where coordinates become smaller.
    Minus,
    /// To where they become greater.
    Plus,
}

impl Way {
    pub(super) fn sign(self) -> f64 {
        match self {
            Way::Minus => -1.0,
            Way::Plus => 1.0,
        }
    }
}

/// A key that is held.
#[derive(Clone, Copy, Debug)]
pub(super) struct Hold {
    pub(super) way: Way,
    last: Duration,
    repeats: bool,
}

impl Hold {
    pub(super) fn new(way: Way, now: Duration) -> Self {
        Hold {
            way,
            last: now,
            repeats: false,
        }
    }

    /// A repeat came.
    pub(super) fn again(self, now: Duration) -> Self {
        Hold {
            last: now,
            repeats: true,
            ..self
        }
    }

    /// A repeat has come before.
    pub(super) fn moves(&self) -> bool {
        self.repeats
    }

    /// No repeat has come for so long that it was released.
    pub(super) fn is_over(&self, now: Duration) -> bool {
        let wait = if self.repeats { REPEAT } else { FIRST };
        now.saturating_sub(self.last) > wait
    }
}

/// A jog.
#[derive(Clone, Debug)]
pub(super) struct Jog {
    pub(super) motor: usize,
    /// The pulses to be at.
    pub(super) target: i64,
    /// Steps/s.
    pub(super) speed: f64,
}

impl Jog {
    /// Steps to the middle of the target's step.
    fn left(&self, at: Position) -> f64 {
        self.target as f64 - at.steps()
    }

    pub(super) fn is_there(&self, at: Position) -> bool {
        self.left(at).abs() < THERE
    }

    /// Steps/s from here: as fast as it may, and so that it can stop at the target.
    pub(super) fn velocity(&self, at: Position, accel: f64) -> f64 {
        let left = self.left(at);
        // Half the deceleration there is: the way back to the board takes its time.
        let can_stop = (left.abs() * accel).sqrt();
        let approach = left.abs() / APPROACH_S;
        let speed = self.speed.min(can_stop).min(approach);
        if self.is_there(at) {
            0.0
        } else {
            // At a quarter of a step the approach is 5 steps/s: it arrives.
            speed.copysign(left)
        }
    }
}
