//! The machine while the gateware's fast path may execute a command of its own
//! ([`crate::pass`]).
//!
//! Both write staged words, the session's last number and the fast path's transmit slot. The rule:
//! **what changes session, state, staged words or that slot takes the pass back first, and settles
//! what was executed with it.** [`Shared::alone`] does both, and is the only way to change the
//! machine, but for [`Shared::guest`]: it serves other clients while a host moves the machine. They
//! can change none of the four. Every debug build checks that for session and state.

use super::Machine;
use crate::cores::Board;
use crate::pass::Pass;
use crate::safety::Safety;
use crate::session::{Peer, Session};
use core::ops::{Deref, DerefMut};
use wire::{FaultReason, Refusal, State};

/// A machine, and the pass that is out.
#[derive(Debug)]
pub struct Shared<B> {
    machine: Machine<B>,
    pass: Option<Pass>,
}

impl<B: Board> Shared<B> {
    /// No pass is out.
    pub fn new(machine: Machine<B>) -> Self {
        Shared {
            machine,
            pass: None,
        }
    }

    /// Takes the pass back and settles what was executed with it. The machine is the caller's alone
    /// until [`Shared::offer`].
    #[inline(never)]
    pub fn alone(&mut self) -> &mut Machine<B> {
        let Machine { board, server, .. } = &mut self.machine;
        // One that came back earlier is not why this command takes the long way.
        server.returned = None;
        if let Some(pass) = self.pass.take() {
            let executed = board.revoke();
            server.settle(board, &pass, executed);
        }
        &mut self.machine
    }

    /// Has a command been executed with the pass that is out?
    #[inline(always)]
    pub fn executed(&mut self) -> bool {
        self.pass.is_some() && self.machine.board.executed()
    }

    /// Hands out a pass if there is none, the next command can be judged in advance, and the answer
    /// to the last one has left.
    #[inline(never)]
    pub fn offer(&mut self) {
        let Machine { board, server, .. } = &mut self.machine;
        if self.pass.is_some() || server.owes_path() || board.sending() {
            return;
        }
        if let Some(pass) = server.judge_ahead(board) {
            board.hand_out(&pass);
            self.pass = Some(pass);
        }
    }

    /// [`Machine::housekeeping`]. While a host moves the machine undisturbed, the pass stays out.
    pub fn housekeeping(&mut self) -> Option<(State, FaultReason)> {
        if self.pass.is_some() && self.machine.glance() {
            return None;
        }
        self.alone().housekeeping()
    }

    /// The machine for clients that do not own it. While a host moves it, the pass stays out.
    pub fn guest(&mut self) -> Guest<'_, B> {
        let owner = self.session().owner();
        let moved_by_host = owner.is_some_and(|owner| owner != Peer::INSIDE) && !self.at_rest();
        if !moved_by_host {
            self.alone();
        }
        let before = (moved_by_host && cfg!(debug_assertions))
            .then_some((self.machine.server.session, self.machine.server.safety));
        Guest {
            machine: &mut self.machine,
            before,
        }
    }

    /// The board, for a simulator that lets its time pass and carries its frames.
    pub fn board(&mut self) -> &mut B {
        &mut self.machine.board
    }

    /// Counts a frame that came.
    pub fn received(&mut self) {
        self.machine.received();
    }

    /// Counts frames that were sent.
    pub fn sent(&mut self, frames: u32) {
        self.machine.sent(frames);
    }

    /// Counts a refusal.
    pub fn refuse(&mut self, why: Refusal) {
        self.machine.refuse(why);
    }

    /// [`Machine::due`].
    #[inline(always)]
    pub fn due(&mut self, periods: u32) -> bool {
        self.machine.due(periods)
    }

    /// Low word of the wall clock.
    pub fn now_lo(&mut self) -> u32 {
        self.machine.board.now_lo()
    }
}

/// What can be read, can be read at any time.
impl<B> Deref for Shared<B> {
    type Target = Machine<B>;

    fn deref(&self) -> &Machine<B> {
        &self.machine
    }
}

/// The machine for clients that do not own it.
#[derive(Debug)]
pub struct Guest<'m, B> {
    machine: &'m mut Machine<B>,
    before: Option<(Session, Safety)>,
}

impl<B> Deref for Guest<'_, B> {
    type Target = Machine<B>;

    fn deref(&self) -> &Machine<B> {
        self.machine
    }
}

impl<B> DerefMut for Guest<'_, B> {
    fn deref_mut(&mut self) -> &mut Machine<B> {
        self.machine
    }
}

impl<B> Drop for Guest<'_, B> {
    fn drop(&mut self) {
        if let Some(before) = self.before {
            let server = &self.machine.server;
            debug_assert_eq!(before, (server.session, server.safety));
        }
    }
}

#[cfg(test)]
mod tests;
