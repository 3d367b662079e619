//! Segments that follow a reference, with the integrators' own arithmetic: for the planner and for
//! FPGA G's words.

use motion::segment::{AXES, Axis, COMMIT_CLOCKS, MAX_CLOCKS, MIN_CLOCKS, MotionState, Segment};
use motion::wide::{quotient_up, ratio, scaled};

/// A part of the reference with constant acceleration.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Leg {
    /// Clocks, 16 fraction bits.
    pub(crate) duration: i64,
    /// Time of the last segment's end, in clocks with 16 fraction bits since the leg began; up to
    /// 64 clocks before it.
    pub(crate) at: i64,
    pub(crate) position: [i64; AXES],
    pub(crate) velocity: [i64; AXES],
    /// 2^-72 steps per clock^2.
    pub(crate) accel: [i64; AXES],
}

/// Makes segments that follow a reference, from the integrators' positions.
#[derive(Clone, Debug)]
pub(crate) struct Follower {
    /// The integrators, and the outputs.
    pub(crate) machine: MotionState,
    /// The reference's position and velocity.
    pub(crate) leg: Option<Leg>,
    /// How many clocks (16 fraction bits) the reference is ahead of the segments; below 65.
    pub(crate) ahead: i64,
    limit: [u32; AXES],
}

impl Follower {
    pub(crate) fn new(limit: [u32; AXES]) -> Self {
        Follower {
            machine: MotionState::default(),
            leg: None,
            ahead: 0,
            limit,
        }
    }

    /// The next segment of the leg.
    pub(crate) fn piece(&mut self, tag: u16) -> Option<Segment> {
        let leg = self.leg.as_mut()?;
        let clocks = (leg.duration - leg.at) >> 16;
        if clocks < i64::from(MIN_CLOCKS) {
            self.ahead = leg.duration - leg.at;
            self.leg = None;
            return None;
        }
        // Legs too short for a segment of their own are followed at once, not over the whole of
        // this segment.
        let late = leg.at <= -(1 << 16) && clocks >= 2 * i64::from(MIN_CLOCKS);
        let pieces = (clocks as u64).div_ceil(MAX_CLOCKS.into());
        let clocks = if late {
            MIN_CLOCKS
        } else {
            (clocks as u64).div_ceil(pieces) as u32
        };
        leg.at += i64::from(clocks) << 16;
        let leg = *leg;
        let aims: [(i32, u32); AXES] = core::array::from_fn(|axis| {
            let (position, velocity) = leg.reference(axis);
            let limit = self.limit[axis];
            aim(&self.machine.axes[axis], clocks, position, velocity, limit)
        });
        let segment = Segment {
            clocks,
            velocity: aims.map(|aim| aim.0),
            accel: aims.map(|aim| aim.1),
            aux: self.machine.aux,
            tag,
        };
        self.machine.run(&segment);
        Some(segment)
    }

    /// The segment that ends at rest: as short as the limits allow.
    pub(crate) fn come_to_rest(&mut self, tag: u16) -> Segment {
        let mut clocks = MIN_CLOCKS;
        for (axis, limit) in self.machine.axes.iter().zip(self.limit) {
            let moves = quotient_up(axis.velocity.unsigned_abs(), limit.into());
            clocks = clocks.max(moves as u32 + COMMIT_CLOCKS);
        }
        let accel = self.machine.axes.map(|axis| {
            let moves = u64::from(clocks - COMMIT_CLOCKS);
            quotient_up(axis.velocity.unsigned_abs(), moves).max(1) as u32
        });
        let segment = Segment {
            clocks,
            velocity: [0; AXES],
            accel,
            aux: self.machine.aux,
            tag,
        };
        self.machine.run(&segment);
        segment
    }
}

impl Leg {
    /// A uniform change to these velocities.
    pub(crate) fn steer(&mut self, end: &[i64; AXES]) {
        for (axis, end) in end.iter().enumerate() {
            let by = self.duration.max(1).unsigned_abs();
            self.accel[axis] = ratio(end - self.velocity[axis], 32, by);
        }
    }

    /// The reference's position and speed.
    fn reference(&self, axis: usize) -> (i64, i64) {
        let begin = self.velocity[axis];
        let velocity = begin + scaled(self.accel[axis], self.at, 32);
        let way = scaled(begin + velocity, self.at, 41);
        (self.position[axis] + way, velocity)
    }
}

/// The velocity, and the acceleration to it, that leads to the reference's velocity in this
/// many clocks, and to its position in the 2^21 clocks after that. This is slow enough to be
/// stable for segments of any length up to 2^20.
fn aim(axis: &Axis, clocks: u32, position: i64, velocity: i64, limit: u32) -> (i32, u32) {
    let moves = i64::from(clocks - COMMIT_CLOCKS);
    let sum = axis.velocity + velocity;
    // The last of the moves comes too late to count: v0 v0 v1 .. vm.
    let late = axis.velocity - velocity;
    let mean = scaled(sum, clocks.into(), 25) + (late >> 25);
    let off = axis.position.wrapping_add(mean).wrapping_sub(position);
    // At most half a step in 2^21 clocks, 14 steps/s at 60 MHz: the error is never larger.
    let correction = off.clamp(-(1 << 31), 1 << 31) << 3;
    let most = i64::from(limit) * moves;
    let wanted = velocity - correction;
    // Velocities are whole numbers at the end of a segment, and so at the beginning of the
    // next.
    let nearest = (wanted + (1 << 23)) >> 24;
    let [least, greatest] = [axis.velocity - most, axis.velocity + most];
    let velocity = nearest.clamp(-(-least >> 24), greatest >> 24);
    let change = (velocity << 24).abs_diff(axis.velocity);
    let accel = quotient_up(change, moves as u64).max(1);
    (velocity as i32, accel as u32)
}

#[cfg(test)]
mod tests;
