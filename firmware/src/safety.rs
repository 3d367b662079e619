//! Decides when outputs may be live. A pure state machine: an event and the time go in, a new state
//! and orders come out.
//!
//! ```text
//!            booted            edge, then a fresh command
//!   Boot ------------> Disarmed -----------------------> Armed
//!     |                 ^    ^                           |  |
//!     | stopped badly   |    | at rest, host's wish      |  | gate closed by gateware
//!     v                 |    +---------- Stopping <------+  |
//!   Faulted ------------+                 | at rest, fault  |
//!     ^   cause gone, resync, new edge    |                 |
//!     +-----------------------------------+-----------------+
//! ```
//!
//! The gateware closes the gate by itself on a bite, an external reset, an e-stop input or silence;
//! this state machine only learns of it. It decides when the gate may open again, and makes sure
//! that this is never an accident: the ABI must fit, a session must exist, the host must say
//! `enable`, raise `enable-request` after it was low in an earlier command, and send one more
//! command after that.
//!
//! Only a rising edge ends a fault, and only after a full resync: the session must have been
//! acquired again since the cause struck (new token, sequence numbers from 0, earlier edges do not
//! count). That holds if the fault ended the old session (a bite, a release) and if it did not (a
//! pin, the link). So no host continues after a stop with its knowledge from before.
//!
//! The state machine never changes a position: no command can. `position_trusted` says whether
//! pulses were cut off: by the external reset or an e-stop, by a grace period that may have ended
//! before the motors did, or by the firmware's own crash. The gateware does not tell a completed
//! soft stop from one that its grace cut. So a stop counts as completed if less than the grace has
//! passed since the machine was last seen undisturbed.
//!
//! `safety/invariants.rs` states what must hold in every step. It is checked over every state,
//! event and gate, in random sequences, and in every debug build that steps this machine.
//!
//! After a restart the gateware still knows why the gate closed last, and the state machine
//! continues from there: a reset of a hung CPU does not erase a bite or an e-stop.

use crate::cores::{Control, Gate};
use wire::{FaultReason, GateClose, ResetReason, State};

/// 1 s at 60 MHz. The gateware ends a soft stop with its grace; a gate that is still open this long
/// after that does not obey.
pub const STOP_SLACK_CLOCKS: u32 = 60_000_000;

#[cfg(any(test, debug_assertions))]
mod invariants;
#[cfg(test)]
mod tests;

/// An input of the state machine.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Event {
    /// Start-up is over.
    Booted {
        /// Gateware and firmware have the same register map.
        abi_fits: bool,
        /// The reason of the firmware's start.
        reset: ResetReason,
        /// Why the gate closed last, from the gateware.
        close: GateClose,
    },
    /// A host acquired the session: what it saw before does not count any more.
    Acquired,
    /// The session was released or ended.
    Lost,
    /// A fresh and whole command of the owner.
    Command {
        /// The machine may move.
        enable: bool,
        /// Its rising edge asks to arm.
        request: bool,
        /// The gate's state, read with it.
        gate: Gate,
    },
    /// The gate's state.
    Gate(Gate),
    /// The Ethernet link went down.
    LinkDown,
    /// A job ran out of segments.
    JobUnderrun,
}

/// What the caller has to do.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[must_use]
pub struct Effects {
    /// An order for the gate, after the commit.
    pub order: Option<Control>,
    /// Commit the staged command.
    pub execute: bool,
    /// End the session.
    pub end_session: bool,
}

impl Effects {
    const NONE: Effects = Effects {
        order: None,
        execute: false,
        end_session: false,
    };

    fn order(order: Control) -> Effects {
        Effects {
            order: Some(order),
            ..Effects::NONE
        }
    }
}

/// The host's progress towards arming.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Request {
    /// Not seen low yet: a level is not an edge.
    Unknown,
    /// Seen low: the next high is an edge.
    Low,
    /// The edge came; the next fresh command arms.
    Edge,
    /// High and used up.
    High,
}

/// The state machine.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Safety {
    state: State,
    reason: FaultReason,
    /// Where `Stopping` leads.
    after_stop: State,
    /// When a soft stop began, or earlier. Low words suffice: no stop lasts a minute.
    stop_since: u32,
    /// When the gate was last seen in its right state while armed.
    seen: u32,
    /// Longest soft stop the gateware allows, in clocks.
    grace: u32,
    request: Request,
    session: bool,
    /// The session was acquired since the last fault.
    resynced: bool,
    abi_fits: bool,
    /// An operation runs that must not meet an armed machine.
    held: bool,
    position_trusted: bool,
}

impl Default for Safety {
    fn default() -> Self {
        Self::new()
    }
}

impl Safety {
    /// Before start-up.
    pub const fn new() -> Self {
        Safety {
            state: State::Boot,
            reason: FaultReason::None,
            after_stop: State::Faulted,
            stop_since: 0,
            seen: 0,
            grace: 0,
            request: Request::Unknown,
            session: false,
            resynced: false,
            abi_fits: false,
            held: false,
            position_trusted: true,
        }
    }

    /// Prevents arming, or allows it again. An edge of `enable-request` in between is used up.
    pub(crate) fn hold(&mut self, held: bool) {
        self.held = held;
    }

    /// The gate opens now, and a soft stop may take `grace` clocks.
    pub(crate) fn opens(&mut self, grace: u32, now: u32) {
        self.grace = grace;
        self.seen = now;
    }

    /// The gate was read, and the machine was [`Safety::running`].
    #[inline]
    pub(crate) fn seen(&mut self, now: u32) {
        self.seen = now;
    }

    /// The state.
    pub const fn state(&self) -> State {
        self.state
    }

    /// The reason of the last stop; it stays readable until the machine arms again.
    pub const fn reason(&self) -> FaultReason {
        self.reason
    }

    /// No pulse was cut off since the machine was armed last.
    pub const fn position_trusted(&self) -> bool {
        self.position_trusted
    }

    /// The machine is at rest, so the configuration may change.
    pub const fn at_rest(&self) -> bool {
        match self.state {
            State::Disarmed | State::Faulted => true,
            State::Boot | State::Armed | State::Stopping => false,
        }
    }

    /// Armed, and the gate agrees: an event with this gate would change nothing.
    #[inline]
    pub fn running(&self, gate: Gate) -> bool {
        matches!(self.state, State::Armed) && gate.0 == Gate::LIVE.0
    }

    /// Would this command in this state only be executed, without a decision? The exchange asks
    /// this first; [`Safety::step`] would return the same state and `execute`.
    #[inline]
    pub fn steady(&self, enable: bool, request: bool, gate: Gate) -> bool {
        matches!(self.state, State::Armed)
            && gate.0 == Gate::LIVE.0
            && enable
            && matches!(
                (self.request, request),
                (Request::High, true) | (Request::Low, false)
            )
    }

    /// Would this command neither change the state nor be executed, as from a host that looks and
    /// waits? Asked for the same reason as [`Safety::steady`]. An answer without [`Safety::step`]
    /// needs [`Safety::waited`].
    #[inline]
    pub fn waiting(&self, request: bool, gate: Gate) -> bool {
        self.at_rest()
            && self.session
            && !gate.open()
            && matches!(
                (self.request, request),
                (Request::High | Request::Unknown, true) | (Request::Low | Request::Unknown, false)
            )
    }

    /// All that [`Safety::step`] does with a command that is [`Safety::waiting`]: a request that is
    /// low for the first time in a session counts.
    #[inline]
    pub fn waited(&mut self, request: bool) {
        self.request = self.request.follow(request);
    }

    /// The transition function. It is total: every event in every state.
    pub fn step(&mut self, event: Event, now: u64) -> Effects {
        self.checked(event, |safety| safety.decide(event, now))
    }

    /// [`Safety::step`] for [`Event::Command`], on the way to an answer that a host waits for.
    #[inline]
    pub fn commanded(&mut self, enable: bool, request: bool, gate: Gate, now: u64) -> Effects {
        let event = Event::Command {
            enable,
            request,
            gate,
        };
        self.checked(event, |safety| safety.command(enable, request, gate, now))
    }

    /// A transition. Debug builds check that it keeps the invariants.
    #[inline(always)]
    fn checked(&mut self, _event: Event, transition: impl FnOnce(&mut Self) -> Effects) -> Effects {
        #[cfg(any(test, debug_assertions))]
        let before = *self;
        let effects = transition(self);
        #[cfg(any(test, debug_assertions))]
        if let Err(why) = invariants::hold(&before, _event, self, &effects) {
            panic!("{why}: {before:?} --{_event:?}--> {self:?} {effects:?}");
        }
        effects
    }

    fn decide(&mut self, event: Event, now: u64) -> Effects {
        match event {
            Event::Booted {
                abi_fits,
                reset,
                close,
            } => self.booted(abi_fits, reset, close),
            Event::Acquired => self.acquired(now),
            Event::Lost => self.lost(now),
            Event::Command {
                enable,
                request,
                gate,
            } => self.command(enable, request, gate, now),
            Event::Gate(gate) => {
                let effects = self.gate(gate, now);
                if self.running(gate) {
                    self.seen = now as u32;
                }
                effects
            }
            Event::LinkDown => self.soft_stop(FaultReason::LinkDown, State::Faulted, now),
            Event::JobUnderrun => self.soft_stop(FaultReason::JobUnderrun, State::Faulted, now),
        }
    }

    fn booted(&mut self, abi_fits: bool, reset: ResetReason, close: GateClose) -> Effects {
        match self.state {
            State::Boot => {}
            State::Disarmed | State::Armed | State::Stopping | State::Faulted => {
                return Effects::NONE;
            }
        }
        self.abi_fits = abi_fits;
        self.resynced = false;
        self.reason = match (reset, close) {
            (ResetReason::Panic | ResetReason::Trap, _) => FaultReason::FirmwareFault,
            // No client requested it, and the gate was opened before: a jump to where the firmware
            // begins.
            (
                ResetReason::PowerUp | ResetReason::Unknown,
                GateClose::Order | GateClose::SoftStop,
            ) => FaultReason::FirmwareFault,
            (ResetReason::PowerUp | ResetReason::Requested | ResetReason::Unknown, close) => {
                match close {
                    GateClose::Never | GateClose::Order | GateClose::SoftStop => FaultReason::None,
                    GateClose::Bite => FaultReason::Watchdog,
                    GateClose::ExternalReset => FaultReason::ExternalReset,
                    GateClose::EStop => FaultReason::EStop,
                    GateClose::SystemReset => FaultReason::FirmwareFault,
                }
            }
        };
        self.state = if self.reason == FaultReason::None {
            State::Disarmed
        } else {
            State::Faulted
        };
        // A start closes the gate, even if an axis still moves; only after a requested start all
        // axes are at rest. A bite stops softly, everything else cuts pulses off.
        let at_rest = reset == ResetReason::Requested || close == GateClose::Never;
        self.position_trusted =
            at_rest && matches!(self.reason, FaultReason::None | FaultReason::Watchdog);
        if !abi_fits {
            self.state = State::Faulted;
            self.reason = FaultReason::AbiMismatch;
        }
        Effects::order(Control::Close)
    }

    fn acquired(&mut self, now: u64) -> Effects {
        let effects = match self.state {
            // A host that resynchronises does not know what the machine is doing: stop it.
            State::Armed => self.soft_stop(FaultReason::SessionLost, State::Faulted, now),
            State::Boot | State::Disarmed | State::Stopping | State::Faulted => {
                self.request = Request::Unknown;
                Effects::NONE
            }
        };
        self.session = true;
        self.resynced = true;
        effects
    }

    fn lost(&mut self, now: u64) -> Effects {
        let effects = self.soft_stop(FaultReason::SessionLost, State::Faulted, now);
        self.end_session();
        effects
    }

    fn command(&mut self, enable: bool, request: bool, gate: Gate, now: u64) -> Effects {
        // The gate's state comes first: a command must not overtake a bite.
        let rested = self.at_rest();
        let mut effects = self.gate(gate, now);
        if effects.end_session || !self.session {
            return effects;
        }
        let before = self.request;
        self.request = before.follow(request);
        if !rested && self.request == Request::Edge {
            // A host that asks to arm a running or stopping machine has to ask again, even if the
            // machine comes to rest now.
            self.request = Request::High;
        }
        match self.state {
            State::Armed if !enable => {
                return self.soft_stop(FaultReason::HostDisable, State::Disarmed, now);
            }
            State::Armed => effects.execute = true,
            State::Disarmed if before == Request::Edge && request => {
                if enable && self.abi_fits && !self.held && Self::clear_to_arm(gate) {
                    self.state = State::Armed;
                    self.reason = FaultReason::None;
                    self.position_trusted = true;
                    effects.execute = true;
                    effects.order = Some(Control::Arm);
                }
                self.request = Request::High;
            }
            State::Disarmed if self.request == Request::Edge => {
                // The gateware also latches a bite, reset or e-stop that came while disarmed. An
                // open gate is closed first.
                if gate.latched() && !gate.open() {
                    effects.order = Some(Control::Clear);
                }
            }
            State::Faulted if self.request == Request::Edge => {
                // The cause must be gone, and a wrong ABI never goes away.
                if self.resynced && self.abi_fits && !gate.open() && !gate.pinned_now() {
                    self.state = State::Disarmed;
                    effects.order = Some(Control::Clear);
                } else {
                    self.request = Request::High;
                }
            }
            State::Boot | State::Disarmed | State::Stopping | State::Faulted => {}
        }
        effects
    }

    fn gate(&mut self, gate: Gate, now: u64) -> Effects {
        match self.state {
            State::Boot => Effects::NONE,
            State::Armed => {
                if gate.pinned() {
                    self.pinned(gate)
                } else if gate.bitten() {
                    self.bitten(gate, now)
                } else if !gate.open() {
                    // The gate closed for an unknown reason. Believe the gate.
                    self.position_trusted = false;
                    self.enter_fault(FaultReason::Watchdog)
                } else {
                    Effects::NONE
                }
            }
            State::Stopping => {
                if gate.pinned() {
                    return self.pinned(gate);
                }
                let bitten_meanwhile = gate.bitten() && self.reason != FaultReason::Watchdog;
                if bitten_meanwhile {
                    // The gate closed before our order, which had no effect.
                    self.stop_since = self.seen;
                    self.reason = FaultReason::Watchdog;
                    self.after_stop = State::Faulted;
                    self.end_session();
                }
                let mut effects = Effects {
                    end_session: bitten_meanwhile,
                    ..Effects::NONE
                };
                if !gate.open() {
                    self.position_trusted &= !self.may_be_cut(now);
                    self.state = self.after_stop;
                } else if self.stops_for(now) >= self.grace.saturating_add(STOP_SLACK_CLOCKS) {
                    self.position_trusted = false;
                    self.state = self.after_stop;
                    effects.order = Some(Control::Close);
                }
                effects
            }
            // No command requested an open gate without an armed machine.
            State::Disarmed | State::Faulted if gate.open() => Effects::order(Control::Close),
            State::Disarmed | State::Faulted => Effects::NONE,
        }
    }

    /// The gateware's watchdog bit; the gateware already stops all axes.
    fn bitten(&mut self, gate: Gate, now: u64) -> Effects {
        self.end_session();
        self.reason = FaultReason::Watchdog;
        self.after_stop = State::Faulted;
        // The bite came at some time since then.
        self.stop_since = self.seen;
        self.state = if gate.open() {
            State::Stopping
        } else {
            self.position_trusted &= !self.may_be_cut(now);
            State::Faulted
        };
        Effects {
            end_session: true,
            ..Effects::NONE
        }
    }

    /// A pin closed the gate in the middle of a step.
    fn pinned(&mut self, gate: Gate) -> Effects {
        self.position_trusted = false;
        self.enter_fault(if gate.reset() || gate.reset_pin() {
            FaultReason::ExternalReset
        } else {
            FaultReason::EStop
        })
    }

    fn enter_fault(&mut self, reason: FaultReason) -> Effects {
        self.state = State::Faulted;
        self.reason = reason;
        self.resynced = false;
        self.request = Request::Unknown;
        Effects::order(Control::Close)
    }

    fn soft_stop(&mut self, reason: FaultReason, after: State, now: u64) -> Effects {
        match self.state {
            State::Armed => {
                self.state = State::Stopping;
                self.reason = reason;
                self.after_stop = after;
                self.stop_since = now as u32;
                self.resynced = false;
                self.request = Request::Unknown;
                Effects::order(Control::SoftStop)
            }
            State::Stopping => {
                // A fault on the way to rest replaces the host's request; the first fault replaces
                // a later one.
                if self.after_stop == State::Disarmed && after == State::Faulted {
                    self.after_stop = after;
                    self.reason = reason;
                    self.resynced = false;
                }
                Effects::NONE
            }
            State::Boot | State::Disarmed | State::Faulted => Effects::NONE,
        }
    }

    fn end_session(&mut self) {
        self.session = false;
        self.resynced = false;
        self.request = Request::Unknown;
    }

    /// Clocks since the soft stop began, or more.
    fn stops_for(&self, now: u64) -> u32 {
        (now as u32).wrapping_sub(self.stop_since)
    }

    /// May the gateware's grace have ended before the motors stood?
    fn may_be_cut(&self, now: u64) -> bool {
        self.stops_for(now) >= self.grace
    }

    fn clear_to_arm(gate: Gate) -> bool {
        !gate.bitten() && !gate.pinned() && !gate.open()
    }
}

impl Request {
    fn follow(self, level: bool) -> Request {
        match (self, level) {
            (_, false) => Request::Low,
            (Request::Low, true) => Request::Edge,
            (Request::Edge | Request::High, true) => Request::High,
            (Request::Unknown, true) => Request::Unknown,
        }
    }
}
