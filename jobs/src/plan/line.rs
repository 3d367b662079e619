//! The lines of the look-ahead, with the plan of each.

use super::FASTEST;
use motion::segment::AXES;
use motion::wide::{product, quotient, scaled};

/// The longest time of a line in clocks, without its ramps: a week at 60 MHz. A lower feed is
/// raised, whatever the override, because time with its 16 fraction bits has 64 bits. That is 300
/// nm/s for a metre.
pub(super) const LONGEST: u64 = 1 << 45;

/// A line in the buffer.
#[derive(Clone, Copy, Debug)]
pub(super) struct PlannedLine {
    /// nm.
    pub(super) length: u64,
    /// Unit vector.
    pub(super) direction: [i64; AXES],
    /// Steps per nm, 2^64 times.
    pub(super) slope: [i64; AXES],
    /// The integrators' positions at its end, without the corner's blend.
    pub(super) end: [i64; AXES],
    /// Acceleration along it, nm/s^2.
    pub(super) accel: u64,
    /// The axes' limit, nm/s.
    pub(super) top: u64,
    /// The speed that takes [`LONGEST`] for it, nm/s; at most `top`.
    pub(super) slowest: u64,
    /// The commanded speed, nm/s, at 100 %.
    pub(super) feed: u32,
    /// The speed it will be drawn with, nm/s, and its square.
    pub(super) held: u64,
    pub(super) fastest: u64,
    /// How far the blend at its beginning reaches into it, nm.
    pub(super) cut: u64,
    /// Square of the largest speed through that blend.
    pub(super) corner: u64,
    /// Square of the planned speed there.
    pub(super) entry: u64,
    /// The tag of the instruction it comes from.
    pub(super) tag: u32,
}

impl PlannedLine {
    pub(super) const NONE: PlannedLine = PlannedLine {
        length: 0,
        direction: [0; AXES],
        slope: [0; AXES],
        end: [0; AXES],
        accel: 0,
        top: 0,
        slowest: 0,
        feed: 0,
        held: 0,
        fastest: 0,
        cut: 0,
        corner: 0,
        entry: 0,
        tag: 0,
    };

    /// The integrators' positions when `left` nm (with 16 fraction bits) are left to the corner.
    pub(super) fn position(&self, axis: usize, left: i64) -> i64 {
        self.end[axis] - scaled(self.slope[axis], left, 48)
    }

    /// The speed it will be drawn with, nm/s.
    pub(super) fn at(&self, percent: u32) -> u64 {
        let feed = match percent {
            100 => self.feed.into(),
            _ => quotient(u64::from(self.feed) * u64::from(percent), 100),
        };
        feed.clamp(self.slowest, self.top)
    }

    /// Asks for another speed.
    pub(super) fn set_override(&mut self, percent: u32) {
        self.held = self.at(percent);
        self.fastest = square(self.held);
    }

    /// `w + 2 a l`: the square of the speed after `length` nm of acceleration.
    pub(super) fn gained(&self, square: u64, length: u64) -> u64 {
        square.saturating_add(gain(self.accel, length)).min(FASTEST)
    }
}

/// `2 a l`.
pub(super) fn gain(accel: u64, length: u64) -> u64 {
    match product(accel, length) {
        [half, 0] => half.saturating_mul(2).min(FASTEST),
        _ => FASTEST,
    }
}

pub(super) fn square(speed: u64) -> u64 {
    speed.saturating_mul(speed).min(FASTEST)
}
