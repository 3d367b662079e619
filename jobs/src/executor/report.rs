//! How it goes: the state and the report for clients.

use super::{Executor, Phase};
use crate::Outside;
use crate::progress::Mark;
use motion::segment::AXES;
use wire::jobs::{End, Report, State};

impl Executor {
    /// The current state.
    pub fn state(&self) -> State {
        match self.phase {
            Phase::Idle => State::Stopped,
            Phase::Check => State::Checking,
            Phase::Lift | Phase::Home => State::Calibrating,
            Phase::Open(_) | Phase::Play if self.calibrates => State::Calibrating,
            Phase::Held => State::Paused,
            Phase::Open(_) | Phase::Play if self.paused => State::Paused,
            Phase::Open(_) | Phase::Play => State::Running,
            Phase::Rest | Phase::Brake | Phase::Quit | Phase::Close(_) => State::Stopping,
        }
    }

    /// The complete report.
    pub fn report(&mut self, out: &mut impl Outside) -> Report {
        let (begun, left) = self.core.progress(out);
        let segments = begun.wrapping_sub(self.base);
        let (mark, clocks) = if self.reached.pushed() == 0 {
            (Mark::default(), 0)
        } else {
            self.reached.at(segments.min(self.reached.pushed()), left)
        };
        let mut heard = true;
        if self.phase == Phase::Idle {
            if let Some((state, positions)) = self.inside.look(out) {
                (self.board, self.positions) = (state.to_word(), positions);
                self.seen(state);
                self.count_cuts(out);
                self.at_rest = true;
            } else {
                heard = false;
            }
        }
        let state = self.core.state(out);
        let millis = |clocks: u64| {
            let millis = clocks / u64::from((self.clock_hz / 1000).max(1));
            u32::try_from(millis).unwrap_or(u32::MAX)
        };
        let elapsed = millis(clocks);
        let done = mark.micros.min(self.total);
        // At a feed of 1 nm/s sums can get very large.
        let percent = u128::from(done) * 100 / u128::from(self.total.max(1));
        let progress = match percent {
            _ if self.end == End::Done && !self.busy() => 100,
            percent => percent.min(99) as u8,
        };
        let rest = (self.total - done) / 1000 * 100 / u64::from(self.percent.max(1));
        // If the job has taken longer than planned, the rest will, too.
        let ratio = u64::from(elapsed) * u64::from(self.percent) * 10 / (done / 1000).max(1);
        let ratio = if done < 1_000_000 {
            1000
        } else {
            ratio.max(1000)
        };
        let remaining = if self.busy() {
            rest.saturating_mul(ratio) / 1000
        } else {
            0
        };
        let steps = core::array::from_fn(|axis| {
            let position = self.positions.get(axis).copied().unwrap_or(0);
            let offset = self.offset.get(axis).copied().unwrap_or(0);
            (position.wrapping_sub(offset) >> 32) as i32
        });
        // What a board out of reach did meanwhile is known when it answers again.
        let known = heard
            && self.machine.is_some()
            && self.homed == [true; AXES]
            && self.cut == [false; AXES];
        let bits = self.homed.iter().rev();
        let (axis, line) = self.trouble;
        Report {
            state: self.state(),
            progress,
            end: self.end,
            stands: state.idle() && self.at_rest || state.stands(),
            machine: self.machine.is_some(),
            attended: self.busy() && self.starter.patience.is_some(),
            known,
            homed: bits.fold(0, |bits, homed| bits << 1 | u8::from(*homed)),
            axis: if self.phase == Phase::Home {
                self.homing.axis()
            } else {
                axis
            },
            percent: self.percent,
            line: line.unwrap_or(mark.line),
            elapsed,
            remaining: u32::try_from(remaining).unwrap_or(u32::MAX),
            board: self.board,
            steps,
            outputs: self.core.outputs(out),
            refused: 0,
            segments: if self.reached.pushed() == 0 {
                0
            } else {
                segments
            },
            name: self.name,
        }
    }
}
