//! A channel: the exact ramp of a step generator, and the latch of index and probe.

use motion::Ramp;
use motion::ramp::COMMIT_CLOCKS;
use wire::units::{Accel, Position, Velocity};

#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Axis {
    pub(super) ramp: Ramp,
    /// Clocks until a commit reaches the ramp.
    hold: u64,
    next: (Velocity, Accel),
}

impl Axis {
    pub(super) fn commit(&mut self, velocity: Velocity, accel: Accel) {
        self.next = (velocity, accel);
        self.hold = COMMIT_CLOCKS;
        self.ramp.target = self.ramp.velocity();
        self.ramp.accel = Accel::UNLIMITED;
    }

    pub(super) fn advance(&mut self, clocks: u64) {
        let held = clocks.min(self.hold);
        if held > 0 {
            let step = i64::from(self.ramp.velocity().0);
            self.ramp.position = self.ramp.position.wrapping_add(step * held as i64);
            self.hold -= held;
        }
        if self.hold == 0 {
            (self.ramp.target, self.ramp.accel) = self.next;
            self.ramp.advance(clocks - held);
        }
    }

    pub(super) fn pulses(&self) -> i64 {
        Position(self.ramp.position).pulses()
    }
}

/// One channel's latch.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct FakeLatch {
    index: bool,
    probe: bool,
    /// Caught by the index (or else the probe), and where.
    pub(super) caught: Option<(bool, i32)>,
    before: i32,
}

impl FakeLatch {
    pub(super) fn turn(&mut self, count: i32, index_at: Option<i32>, probe_at: Option<i32>) {
        let passed = |at: &i32| self.before < *at && *at <= count;
        if self.caught.is_none() {
            if let Some(at) = index_at.filter(|at| self.index && passed(at)) {
                self.caught = Some((true, at));
            } else if let Some(at) = probe_at.filter(|at| self.probe && passed(at)) {
                self.caught = Some((false, at));
            }
        }
        self.before = count;
    }

    pub(super) fn arm(&mut self, index: bool, probe: bool) {
        (self.index, self.probe) = (index, probe);
        if let Some((by_index, _)) = self.caught
            && !(if by_index { index } else { probe })
        {
            self.caught = None;
        }
    }

    pub(super) fn flags(&self) -> (u16, u16) {
        match self.caught {
            Some((by_index, _)) => (by_index.into(), (!by_index).into()),
            None => (0, 0),
        }
    }
}
