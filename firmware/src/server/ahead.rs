//! Judges the owner's next command before it comes, and settles what the gateware has executed.

use super::Server;
use crate::block::STATE_ANSWER;
use crate::cores::Board;
use crate::pass::Pass;
use crate::session::Peer;
use wire::LongWay;
use wire::exchange::{FLAG_APPLY_TIME, FLAG_ENABLE, FLAG_ENABLE_REQUEST, command_word};
use wire::regmap::command;

impl Server {
    /// The next command, if it has the number behind the last one's and the same flags, and nothing
    /// has to be decided for it: an armed machine executes it, or a machine at rest only looks.
    pub(crate) fn judge_ahead<B: Board>(&self, board: &mut B) -> Option<Pass> {
        self.session
            .owner()
            .filter(|owner| *owner != Peer::INSIDE)?;
        let flags = self.flags;
        let enable = flags & FLAG_ENABLE != 0;
        let request = flags & FLAG_ENABLE_REQUEST != 0;
        let gate = board.gate();
        let executes = self.safety.steady(enable, request, gate);
        if !executes && !self.safety.waiting(request, gate) {
            return None;
        }
        Some(Pass {
            sequence: self.session.last_sequence().wrapping_add(1),
            flags,
            gate,
            executes,
            state: self.state_word(gate) | STATE_ANSWER,
            refused: self.counters.refused_total,
        })
    }

    /// A pass is back. If a command was executed with it: what the long way does behind its answer.
    pub(crate) fn settle<B: Board>(&mut self, board: &mut B, pass: &Pass, executed: bool) {
        if !executed {
            self.returned = Some(*pass);
            return;
        }
        self.session.accept(pass.sequence);
        if !pass.executes {
            self.safety.waited(pass.flags & FLAG_ENABLE_REQUEST != 0);
        }
        self.select = board.staged(command::PROBE_ARMS) >> command_word::LATCH_SHIFT;
        self.commit_pending |= pass.timed();
        let counters = &mut self.counters;
        counters.frames_rx = counters.frames_rx.wrapping_add(1);
        counters.frames_tx = counters.frames_tx.wrapping_add(1);
        let [fast, _] = &mut counters.ways;
        *fast = fast.wrapping_add(1);
        self.exchanged(pass.flags);
    }

    /// Counts a command that takes the long way, and finds out why.
    pub(crate) fn took_long_way(&mut self, sequence: u32, flags: u32) {
        let [_, long] = &mut self.counters.ways;
        *long = long.wrapping_add(1);
        self.counters.long_way = match self.returned.take() {
            None => LongWay::NoPass,
            Some(pass) if pass.sequence != sequence => LongWay::Sequence,
            Some(pass) if pass.flags != flags => LongWay::Flags,
            Some(pass) if pass.flags & FLAG_APPLY_TIME != 0 => LongWay::Timed,
            Some(_) => LongWay::Frame,
        };
    }
}
