//! The state and the report for clients.

use super::Executor;
use super::phase::Phase;
use crate::Outside;
use wire::jobs::{End, Report, State};

impl Executor {
    /// The current state.
    pub fn state(&self) -> State {
        self.phase.state(self.order.homes(), self.order.paused)
    }

    /// The complete report.
    pub fn report(&mut self, out: &mut impl Outside) -> Report {
        self.refresh(out);
        self.report_seen(out)
    }

    /// The first half of [`Executor::report`], which takes half of the time: looks at the board.
    pub fn refresh(&mut self, out: &mut impl Outside) {
        // What a board out of reach did meanwhile is known when it answers again.
        self.board.heard = self.busy() || self.look(out);
    }

    /// The second half: the report, with the board as it was seen last.
    pub fn report_seen(&mut self, out: &mut impl Outside) -> Report {
        let so_far = self.reached.so_far(self.board.core.progress(out));
        let core = self.board.core.state(out);
        let per_ms = u64::from((self.board.clock_hz / 1000).max(1));
        let elapsed = u32::try_from(so_far.clocks / per_ms).unwrap_or(u32::MAX);
        let feed = self.path.percent;
        let homed = self.known.homed.iter().rev();
        Report {
            state: self.state(),
            progress: if self.outcome.end == End::Done && !self.busy() {
                100
            } else {
                self.reached.percent(&so_far)
            },
            end: self.outcome.end,
            stands: core.idle() && self.board.at_rest || core.stands(),
            machine: self.machine.is_some(),
            attended: self.busy() && self.order.attended(),
            known: self.board.heard && self.machine.is_some() && self.known.complete(),
            homed: homed.fold(0, |bits, homed| bits << 1 | u8::from(*homed)),
            axis: if self.phase == Phase::Home {
                self.homing.axis()
            } else {
                self.outcome.axis
            },
            percent: feed,
            line: self.outcome.line.unwrap_or(so_far.line),
            elapsed,
            remaining: if self.busy() {
                self.reached.remaining(&so_far, elapsed, feed)
            } else {
                0
            },
            board: self.board.word,
            steps: self.known.places().map(|place| (place >> 32) as i32),
            outputs: self.board.core.outputs(out),
            refused: 0,
            segments: so_far.segments,
            name: self.order.name,
        }
    }

    /// Looks at the board while another client may use it. False: it does not answer.
    fn look(&mut self, out: &mut impl Outside) -> bool {
        let Some(look) = self.board.inside.look(out) else {
            return false;
        };
        self.board.word = look.state.to_word();
        self.board.at_rest = true;
        self.known.at(look.positions);
        self.known.seen(look.state);
        self.known.counted(Some(look.cuts));
        true
    }
}
