//! The machine while the gateware's fast path may execute a command of its own
//! ([`crate::pass`]).
//!
//! Both write staged words, the session's last number and the fast path's transmit slot. The rule:
//! **what changes session, state, staged words or that slot takes the pass back first, and settles
//! what was executed with it.** [`Shared::alone`] does both, and is the only way to the machine as
//! something that can be changed. [`Guest`] serves other clients while a host moves the machine,
//! with the pass out: its methods can change none of the four. Every debug build checks that, and
//! that nothing has changed while a pass was out ([`Witness`]).

use super::{Lease, Machine, VISIT_WORDS, Verb, Verdict};
use crate::cores::Board;
use crate::pass::Pass;
use crate::session::Peer;
use core::ops::Deref;
use wire::regmap::{self, segments};
use wire::{FaultReason, MAX_WORDS, Refusal, State};

mod witness;
use witness::Witness;

/// A machine, and the pass that is out.
#[derive(Debug)]
pub struct Shared<B> {
    machine: Machine<B>,
    pass: Option<Pass>,
    /// The machine when the pass was handed out.
    promised: Witness,
}

impl<B: Board> Shared<B> {
    /// No pass is out.
    pub fn new(machine: Machine<B>) -> Self {
        Shared {
            machine,
            pass: None,
            promised: Witness::NONE,
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
            self.promised.has_kept(&mut self.machine, executed);
            let Machine { board, server, .. } = &mut self.machine;
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
            self.promised = Witness::of(&mut self.machine);
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
            return Guest::of(self.alone());
        }
        let before = Witness::of(&mut self.machine);
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

/// The machine for clients that do not own it. It can be read, and these methods can be called;
/// nothing else can be changed:
///
/// ```
/// use firmware::{cores::Board, machine::{Guest, Lease}};
/// fn asks<B: Board>(guest: &mut Guest<'_, B>) -> bool {
///     guest.leased(None);
///     guest.at_rest()
/// }
/// ```
///
/// ```compile_fail
/// use firmware::{cores::Board, machine::Guest};
/// fn changes<B: Board>(guest: &mut Guest<'_, B>) {
///     guest.housekeeping();
/// }
/// ```
///
/// ```compile_fail
/// use firmware::{cores::Board, machine::Guest};
/// fn stages<B: Board>(guest: &mut Guest<'_, B>) {
///     guest.board.stage(0, 1);
/// }
/// ```
#[derive(Debug)]
pub struct Guest<'m, B: Board> {
    machine: &'m mut Machine<B>,
    before: Witness,
}

impl<'m, B: Board> Guest<'m, B> {
    /// Of a machine for which no pass is out.
    pub fn of(machine: &'m mut Machine<B>) -> Self {
        Guest {
            machine,
            before: Witness::NONE,
        }
    }

    /// [`Machine::datagram`].
    #[inline(always)]
    pub fn datagram<'r>(
        &mut self,
        words: &[u32],
        peer: Peer,
        reply: &'r mut [u32; MAX_WORDS],
    ) -> Result<&'r [u32], Refusal> {
        self.machine.datagram(words, peer, reply)
    }

    /// [`Machine::payload`].
    pub fn payload<'r>(
        &mut self,
        bytes: &[u8],
        peer: Peer,
        reply: &'r mut [u32; MAX_WORDS],
    ) -> Result<&'r [u32], Refusal> {
        self.machine.payload(bytes, peer, reply)
    }

    /// [`Machine::inside`]. If the services own the machine, no pass is out.
    #[inline(always)]
    pub fn inside<'r>(
        &mut self,
        words: &[u32],
        reply: &'r mut [u32; MAX_WORDS],
    ) -> Result<&'r [u32], Refusal> {
        self.machine.inside(words, reply, hold_path)
    }

    /// [`Machine::discover`].
    #[inline(always)]
    pub fn discover<'r>(
        &mut self,
        words: &[u32],
        port: u16,
        reply: &'r mut [u32; MAX_WORDS],
    ) -> &'r [u32] {
        self.machine.discover(words, port, reply)
    }

    /// [`Machine::visit`].
    #[inline(always)]
    pub fn visit(&mut self, visitor: usize, verb: Verb, words: &mut [u32; VISIT_WORDS]) -> Verdict {
        self.machine.visit(visitor, verb, words)
    }

    /// [`Machine::leased`].
    #[inline(always)]
    pub fn leased(&mut self, lease: Option<Lease>) {
        self.machine.leased(lease);
    }

    /// [`Machine::called`].
    #[inline(always)]
    pub fn called(&mut self, clocks: u32, moving: bool) {
        self.machine.called(clocks, moving);
    }

    /// Reads a register of the segments core, which the image's services do without the ROM.
    pub fn read_segments(&mut self, word: usize) -> u32 {
        let address = regmap::address(segments::BASE, word);
        self.machine.board.csr_read(address)
    }

    /// Writes one.
    pub fn write_segments(&mut self, word: usize, value: u32) {
        let address = regmap::address(segments::BASE, word);
        self.machine.board.csr_write(address, value);
    }

    /// The wall clock.
    pub fn now(&mut self) -> u64 {
        self.machine.board.now()
    }
}

impl<B: Board> Deref for Guest<'_, B> {
    type Target = Machine<B>;

    fn deref(&self) -> &Machine<B> {
        self.machine
    }
}

impl<B: Board> Drop for Guest<'_, B> {
    fn drop(&mut self) {
        self.before.is_unchanged(self.machine);
    }
}

/// The answer is on its way: now there is time to adapt the axes' decelerations.
#[inline(never)]
pub fn hold_path<B: Board>(machine: &mut Machine<B>) {
    machine.hold_path();
}

#[cfg(test)]
mod tests;
