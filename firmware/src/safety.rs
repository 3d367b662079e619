//! When outputs may be live. Pure: an event and the time go in, a new state and orders come out.
//!
//! ```text
//!            booted            edge, then a fresh command
//!   Boot ------------> Disarmed -----------------------> Armed
//!     |                 ^    ^                           |  |
//!     | stopped badly   |    | at rest, host's wish      |  | gate closed by gateware
//!     v                 |    +---------- Stopping <------+  |
//!   Faulted ------------+                 | at rest, fault  |
//!     ^   resync, cause gone, new edge    |                 |
//!     +-----------------------------------+-----------------+
//! ```
//!
//! The gateware closes the gate by itself on a bite, an external reset, an e-stop input or silence; this
//! machine only finds out. What it decides is when the gate may open again, and that it is never by accident: the
//! ABI must fit, a session must exist, the host must say `enable`, raise `enable-request` after having
//! been seen with it low, and send one more command after that.
//!
//! It never touches a position. `position_trusted` says whether pulses were cut off: by the external
//! reset or an e-stop, by a grace period that ended before the motors did, by the firmware's own death.
//!
//! After a restart the gateware still knows why the gate closed last, and that is where the machine
//! goes on: a bite or an e-stop under a hung CPU is not forgotten by resetting the CPU.

use crate::cores::{Control, Gate};
use wire::{FaultReason, GateClose, ResetReason, State};

/// 2 s at 60 MHz. A soft stop that takes longer than any watchdog grace is not a stop; the gateware's
/// own limit is `watchdog.grace`, this one catches a grace that was configured away.
pub const STOP_LIMIT_CLOCKS: u64 = 120_000_000;

/// Something happened.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Event {
    /// Start-up is over.
    Booted {
        /// Gateware and firmware know the same registers.
        abi_fits: bool,
        /// Why the firmware started.
        reset: ResetReason,
        /// Why the gate closed last, as the gateware remembers it.
        close: GateClose,
    },
    /// A host acquired the session: what it knew before no longer counts.
    Acquired,
    /// The session was given back or died.
    Lost,
    /// A command of the owner, fresh and whole.
    Command {
        /// The machine may move.
        enable: bool,
        /// Its rising edge asks to arm.
        request: bool,
        /// The gate as read with it.
        gate: Gate,
    },
    /// The gate, looked at.
    Gate(Gate),
    /// The Ethernet link went down.
    LinkDown,
    /// A job ran out of segments.
    JobUnderrun,
}

/// What to do about it.
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

/// How far the host has come on its way to arming.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Request {
    /// Not seen low yet: a level is no edge.
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
    stop_since: u64,
    request: Request,
    session: bool,
    abi_fits: bool,
    /// Something runs that must not meet an armed machine.
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
            request: Request::Unknown,
            session: false,
            abi_fits: false,
            held: false,
            position_trusted: true,
        }
    }

    /// Keeps the machine from being armed, or no longer. An edge of `enable-request` meanwhile is used up.
    pub(crate) fn hold(&mut self, held: bool) {
        self.held = held;
    }

    /// The state.
    pub const fn state(&self) -> State {
        self.state
    }

    /// Why it stopped last; stays readable until it arms again.
    pub const fn reason(&self) -> FaultReason {
        self.reason
    }

    /// No pulse was cut off since the machine was armed last.
    pub const fn position_trusted(&self) -> bool {
        self.position_trusted
    }

    /// Nothing can change under the outputs' feet: configuration may.
    pub const fn at_rest(&self) -> bool {
        match self.state {
            State::Disarmed | State::Faulted => true,
            State::Boot | State::Armed | State::Stopping => false,
        }
    }

    /// Armed, and the gate agrees: looking at it changes nothing.
    #[inline]
    pub fn running(&self, gate: Gate) -> bool {
        matches!(self.state, State::Armed) && gate.0 == Gate::LIVE.0
    }

    /// Would this command in this state only be executed, with nothing to decide? The exchange asks
    /// this first; [`Safety::step`] would return the same machine and `execute`.
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

    /// Would this command change nothing and not be executed either: a host that looks and waits? Asked
    /// like [`Safety::steady`], for the same reason.
    #[inline]
    pub fn waiting(&self, request: bool, gate: Gate) -> bool {
        self.at_rest()
            && !gate.open()
            && matches!(
                (self.request, request),
                (Request::High | Request::Unknown, true) | (Request::Low, false)
            )
    }

    /// The one function. Total: every event in every state.
    pub fn step(self, event: Event, now: u64) -> (Safety, Effects) {
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
            Event::Gate(gate) => self.gate(gate, now),
            Event::LinkDown => self.soft_stop(FaultReason::LinkDown, State::Faulted, now),
            Event::JobUnderrun => self.soft_stop(FaultReason::JobUnderrun, State::Faulted, now),
        }
    }

    fn booted(mut self, abi_fits: bool, reset: ResetReason, close: GateClose) -> (Safety, Effects) {
        match self.state {
            State::Boot => {}
            State::Disarmed | State::Armed | State::Stopping | State::Faulted => {
                return (self, Effects::NONE);
            }
        }
        self.abi_fits = abi_fits;
        self.reason = match (reset, close) {
            (ResetReason::Panic | ResetReason::Trap, _) => FaultReason::FirmwareFault,
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
        // A bite stops softly; everything else cuts pulses off.
        self.position_trusted = matches!(self.reason, FaultReason::None | FaultReason::Watchdog);
        if !abi_fits {
            self.state = State::Faulted;
            self.reason = FaultReason::AbiMismatch;
        }
        (self, Effects::order(Control::Close))
    }

    fn acquired(mut self, now: u64) -> (Safety, Effects) {
        let (mut next, effects) = match self.state {
            // Whoever resynchronises does not know what the machine is doing: stop it.
            State::Armed => self.soft_stop(FaultReason::SessionLost, State::Faulted, now),
            State::Boot | State::Disarmed | State::Stopping | State::Faulted => {
                self.request = Request::Unknown;
                (self, Effects::NONE)
            }
        };
        next.session = true;
        (next, effects)
    }

    fn lost(self, now: u64) -> (Safety, Effects) {
        let (mut next, effects) = self.soft_stop(FaultReason::SessionLost, State::Faulted, now);
        next.session = false;
        next.request = Request::Unknown;
        (next, effects)
    }

    fn command(self, enable: bool, request: bool, gate: Gate, now: u64) -> (Safety, Effects) {
        // What the gate says comes first: a command must not outrun a bite.
        let (mut next, mut effects) = self.gate(gate, now);
        if effects.end_session || !next.session {
            return (next, effects);
        }
        let before = next.request;
        next.request = before.follow(request);
        if !next.at_rest() && next.request == Request::Edge {
            // Whoever asks a machine to arm that is running or stopping has to ask again.
            next.request = Request::High;
        }
        match next.state {
            State::Armed if !enable => {
                return next.soft_stop(FaultReason::HostDisable, State::Disarmed, now);
            }
            State::Armed => effects.execute = true,
            State::Disarmed if before == Request::Edge && request => {
                if enable && next.abi_fits && !next.held && Self::clear_to_arm(gate) {
                    next.state = State::Armed;
                    next.reason = FaultReason::None;
                    next.position_trusted = true;
                    effects.execute = true;
                    effects.order = Some(Control::Arm);
                }
                next.request = Request::High;
            }
            State::Disarmed if next.request == Request::Edge => {
                // A bite, reset or e-stop that came while disarmed is latched in gateware, too.
                if gate.latched() {
                    effects.order = Some(Control::Clear);
                }
            }
            State::Faulted if next.request == Request::Edge => {
                // The cause must be gone, and a wrong ABI is never gone.
                if next.abi_fits && !gate.open() && !gate.pinned_now() {
                    next.state = State::Disarmed;
                    effects.order = Some(Control::Clear);
                } else {
                    next.request = Request::High;
                }
            }
            State::Boot | State::Disarmed | State::Stopping | State::Faulted => {}
        }
        (next, effects)
    }

    fn gate(mut self, gate: Gate, now: u64) -> (Safety, Effects) {
        match self.state {
            State::Boot => (self, Effects::NONE),
            State::Armed => {
                if gate.pinned() {
                    self.pinned(gate)
                } else if gate.bitten() {
                    self.bitten(gate, now)
                } else if !gate.open() {
                    // Nobody we know closed it. Believe the gate.
                    self.position_trusted = false;
                    self.enter_fault(FaultReason::Watchdog)
                } else {
                    (self, Effects::NONE)
                }
            }
            State::Stopping => {
                if gate.pinned() {
                    return self.pinned(gate);
                }
                let bitten_meanwhile = gate.bitten() && self.reason != FaultReason::Watchdog;
                if bitten_meanwhile {
                    self.reason = FaultReason::Watchdog;
                    self.after_stop = State::Faulted;
                    self.session = false;
                    self.request = Request::Unknown;
                }
                let mut effects = Effects {
                    end_session: bitten_meanwhile,
                    ..Effects::NONE
                };
                if !gate.open() {
                    self.state = self.after_stop;
                } else if now.wrapping_sub(self.stop_since) >= STOP_LIMIT_CLOCKS {
                    self.position_trusted = false;
                    self.state = self.after_stop;
                    effects.order = Some(Control::Close);
                }
                (self, effects)
            }
            // An open gate without an armed machine is nobody's wish.
            State::Disarmed | State::Faulted if gate.open() => {
                (self, Effects::order(Control::Close))
            }
            State::Disarmed | State::Faulted => (self, Effects::NONE),
        }
    }

    /// The gateware's watchdog bit; it is already stopping everything.
    fn bitten(mut self, gate: Gate, now: u64) -> (Safety, Effects) {
        self.session = false;
        self.reason = FaultReason::Watchdog;
        self.request = Request::Unknown;
        self.after_stop = State::Faulted;
        self.stop_since = now;
        self.state = if gate.open() {
            State::Stopping
        } else {
            State::Faulted
        };
        let effects = Effects {
            end_session: true,
            ..Effects::NONE
        };
        (self, effects)
    }

    /// A pin closed the gate in mid-step.
    fn pinned(mut self, gate: Gate) -> (Safety, Effects) {
        self.position_trusted = false;
        self.enter_fault(if gate.reset() || gate.reset_pin() {
            FaultReason::ExternalReset
        } else {
            FaultReason::EStop
        })
    }

    fn enter_fault(mut self, reason: FaultReason) -> (Safety, Effects) {
        self.state = State::Faulted;
        self.reason = reason;
        self.request = Request::Unknown;
        (self, Effects::order(Control::Close))
    }

    fn soft_stop(mut self, reason: FaultReason, after: State, now: u64) -> (Safety, Effects) {
        match self.state {
            State::Armed => {
                self.state = State::Stopping;
                self.reason = reason;
                self.after_stop = after;
                self.stop_since = now;
                self.request = Request::Unknown;
                (self, Effects::order(Control::SoftStop))
            }
            State::Stopping => {
                // A fault on the way to rest outweighs the host's wish, the first fault any later one.
                if self.after_stop == State::Disarmed && after == State::Faulted {
                    self.after_stop = after;
                    self.reason = reason;
                }
                (self, Effects::NONE)
            }
            State::Boot | State::Disarmed | State::Faulted => (self, Effects::NONE),
        }
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

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const CLOSED: Gate = Gate(0);
    const LIVE: Gate = Gate::LIVE;
    const BITTEN_STOPPING: Gate = Gate(0b10_0111);
    const BITTEN: Gate = Gate(0b00_0100);
    const RESET_HIGH: Gate = Gate(0b01_1000);
    const RESET_LATCHED: Gate = Gate(0b00_1000);
    const ESTOP_ACTIVE: Gate = Gate(0b1100_0000);
    const ESTOP_LATCHED: Gate = Gate(0b0100_0000);

    fn command(enable: bool, request: bool, gate: Gate) -> Event {
        Event::Command {
            enable,
            request,
            gate,
        }
    }

    fn run(events: &[Event]) -> Safety {
        events
            .iter()
            .fold(Safety::new(), |machine, event| machine.step(*event, 0).0)
    }

    const BOOTED: Event = Event::Booted {
        abi_fits: true,
        reset: ResetReason::PowerUp,
        close: GateClose::Never,
    };

    fn booted(reset: ResetReason, close: GateClose) -> Safety {
        let abi_fits = true;
        run(&[Event::Booted {
            abi_fits,
            reset,
            close,
        }])
    }

    fn ready() -> Vec<Event> {
        vec![
            BOOTED,
            Event::Acquired,
            command(true, false, CLOSED),
            command(true, true, CLOSED),
        ]
    }

    fn armed() -> Safety {
        let mut events = ready();
        events.push(command(true, true, CLOSED));
        run(&events)
    }

    /// One machine for every way to be in a state, found by walking.
    fn reachable() -> Vec<Safety> {
        let mut found = vec![Safety::new()];
        let mut next = 0;
        while let Some(machine) = found.get(next).copied() {
            next += 1;
            for event in all_events() {
                for now in [0, STOP_LIMIT_CLOCKS] {
                    let (mut after, _) = machine.step(event, now);
                    after.stop_since = 0; // time is not part of where one can be
                    if !found.contains(&after) {
                        found.push(after);
                    }
                }
            }
        }
        found
    }

    fn all_events() -> Vec<Event> {
        let mut events = vec![
            Event::Acquired,
            Event::Lost,
            Event::LinkDown,
            Event::JobUnderrun,
        ];
        for abi_fits in [false, true] {
            for &reset in ResetReason::ALL {
                for &close in GateClose::ALL {
                    events.push(Event::Booted {
                        abi_fits,
                        reset,
                        close,
                    });
                }
            }
        }
        for gate in (0..256).map(Gate) {
            events.push(Event::Gate(gate));
            for enable in [false, true] {
                for request in [false, true] {
                    events.push(command(enable, request, gate));
                }
            }
        }
        events
    }

    /// What must hold of every step from anywhere.
    fn check(before: Safety, event: Event, after: Safety, effects: Effects) {
        let context = format!("{before:?} --{event:?}--> {after:?} {effects:?}");
        if effects.order == Some(Control::Arm) {
            let Event::Command {
                enable,
                request,
                gate,
            } = event
            else {
                panic!("armed without a command: {context}");
            };
            assert!(
                enable && request && before.request == Request::Edge,
                "{context}"
            );
            assert!(before.session && before.abi_fits, "{context}");
            assert!(!gate.pinned() && !gate.latched(), "{context}");
            assert_eq!(before.state, State::Disarmed, "{context}");
        }
        let became_armed = before.state != State::Armed && after.state == State::Armed;
        assert_eq!(
            became_armed,
            effects.order == Some(Control::Arm),
            "{context}"
        );
        if effects.execute {
            assert_eq!(
                after.state,
                State::Armed,
                "executed while not armed: {context}"
            );
        }
        if after.state == State::Armed {
            assert!(after.session && after.abi_fits, "{context}");
            assert_eq!(after.reason, FaultReason::None, "{context}");
        }
        if after.state == State::Faulted {
            assert_ne!(after.reason, FaultReason::None, "{context}");
        }
        if before.state == State::Faulted && after.state != State::Faulted {
            assert_eq!(after.state, State::Disarmed, "{context}");
            assert!(
                matches!(event, Event::Command { request: true, .. }),
                "{context}"
            );
            assert_eq!(before.request, Request::Low, "{context}");
        }
        if let Event::Command { gate, .. } | Event::Gate(gate) = event
            && (gate.pinned() || gate.bitten() || !gate.open())
            && !became_armed
        {
            assert_ne!(
                after.state,
                State::Armed,
                "armed against the gate: {context}"
            );
        }
        if !before.position_trusted && after.position_trusted {
            assert!(became_armed, "trust came back by itself: {context}");
        }
        if effects.end_session {
            assert!(!after.session, "{context}");
        }
        if after.state != State::Boot {
            assert!(
                before.state != State::Boot || matches!(event, Event::Booted { .. }),
                "{context}"
            );
        }
    }

    #[test]
    fn every_state_meets_every_event_and_no_invariant_breaks() {
        let machines = reachable();
        for state in State::ALL {
            assert!(
                machines.iter().any(|m| m.state == *state),
                "{state} is never reached"
            );
        }
        for machine in machines {
            for event in all_events() {
                for now in [0, 1, STOP_LIMIT_CLOCKS, u64::MAX] {
                    let (after, effects) = machine.step(event, now);
                    check(machine, event, after, effects);
                }
            }
        }
    }

    #[test]
    fn steady_says_yes_only_where_a_full_step_would_change_nothing_and_execute() {
        for machine in reachable() {
            for event in all_events() {
                let Event::Command {
                    enable,
                    request,
                    gate,
                } = event
                else {
                    continue;
                };
                if machine.steady(enable, request, gate) {
                    let (after, effects) = machine.step(event, 5);
                    assert_eq!(after, machine, "{event:?}");
                    assert_eq!(
                        effects,
                        Effects {
                            execute: true,
                            ..Effects::NONE
                        }
                    );
                }
            }
        }
        assert!(
            armed()
                .step(command(true, true, LIVE), 0)
                .0
                .steady(true, true, LIVE)
        );
    }

    #[test]
    fn waiting_says_yes_only_where_a_full_step_would_do_nothing() {
        let mut times = 0;
        for machine in reachable() {
            for event in all_events() {
                let Event::Command { request, gate, .. } = event else {
                    continue;
                };
                if machine.waiting(request, gate) {
                    assert_eq!(
                        machine.step(event, 5),
                        (machine, Effects::NONE),
                        "{event:?}"
                    );
                    times += 1;
                }
            }
        }
        assert!(times > 0);
    }

    proptest! {
        #[test]
        fn no_sequence_of_events_breaks_an_invariant(
            picks in proptest::collection::vec((0usize..1 << 14, 0u64..STOP_LIMIT_CLOCKS), 1..200)
        ) {
            let events = all_events();
            let (mut machine, mut now) = (Safety::new(), 0u64);
            for (pick, wait) in picks {
                now += wait;
                let event = events[pick % events.len()];
                let (after, effects) = machine.step(event, now);
                check(machine, event, after, effects);
                machine = after;
            }
        }
    }

    #[test]
    fn arming_takes_session_enable_an_edge_and_a_fresh_command_after_it() {
        let machine = run(&ready());
        assert_eq!(machine.state(), State::Disarmed);
        let (machine, effects) = machine.step(command(true, true, CLOSED), 0);
        assert_eq!(machine.state(), State::Armed);
        assert_eq!((effects.order, effects.execute), (Some(Control::Arm), true));
    }

    #[test]
    fn a_request_that_was_high_from_the_start_never_arms() {
        let mut machine = run(&[BOOTED, Event::Acquired]);
        for _ in 0..10 {
            machine = machine.step(command(true, true, CLOSED), 0).0;
        }
        assert_eq!(machine.state(), State::Disarmed);
    }

    #[test]
    fn without_enable_the_edge_is_used_up() {
        let machine = run(&[
            BOOTED,
            Event::Acquired,
            command(false, false, CLOSED),
            command(false, true, CLOSED),
        ]);
        let (machine, _) = machine.step(command(false, true, CLOSED), 0);
        let (machine, _) = machine.step(command(true, true, CLOSED), 0);
        assert_eq!(machine.state(), State::Disarmed);
    }

    #[test]
    fn a_wrong_abi_never_arms_and_says_why() {
        let mut machine = run(&[
            Event::Booted {
                abi_fits: false,
                reset: ResetReason::PowerUp,
                close: GateClose::Never,
            },
            Event::Acquired,
        ]);
        for level in [false, true, true, false, true, true] {
            machine = machine.step(command(true, level, CLOSED), 0).0;
        }
        assert_eq!(
            (machine.state(), machine.reason()),
            (State::Faulted, FaultReason::AbiMismatch)
        );
    }

    #[test]
    fn a_bite_ends_the_session_and_commands_without_a_resync_do_nothing() {
        let (machine, effects) = armed().step(Event::Gate(BITTEN_STOPPING), 0);
        assert!(effects.end_session);
        assert_eq!(
            (machine.state(), machine.reason()),
            (State::Stopping, FaultReason::Watchdog)
        );
        let (mut machine, _) = machine.step(Event::Gate(BITTEN), 1);
        assert_eq!(machine.state(), State::Faulted);
        for level in [false, true, true] {
            machine = machine.step(command(true, level, BITTEN), 2).0;
        }
        assert_eq!(machine.state(), State::Faulted, "a pet cleared a bite");
    }

    #[test]
    fn after_a_bite_a_resync_and_a_new_edge_bring_it_back() {
        let mut machine = armed().step(Event::Gate(BITTEN), 0).0;
        machine = machine.step(Event::Acquired, 1).0;
        machine = machine.step(command(true, false, BITTEN), 2).0;
        let (machine, effects) = machine.step(command(true, true, BITTEN), 3);
        assert_eq!(effects.order, Some(Control::Clear));
        assert_eq!(
            (machine.state(), machine.reason()),
            (State::Disarmed, FaultReason::Watchdog)
        );
        let (machine, effects) = machine.step(command(true, true, CLOSED), 4);
        assert_eq!(effects.order, Some(Control::Arm));
        assert_eq!(machine.reason(), FaultReason::None);
    }

    #[test]
    fn after_a_bite_a_request_still_high_does_not_rearm() {
        let mut machine = armed().step(Event::Gate(BITTEN), 0).0;
        machine = machine.step(Event::Acquired, 1).0;
        for _ in 0..5 {
            machine = machine.step(command(true, true, BITTEN), 2).0;
        }
        assert_eq!(machine.state(), State::Faulted);
    }

    #[test]
    fn an_external_reset_faults_at_once_and_holds_until_the_pin_is_low() {
        let (mut machine, effects) = armed().step(Event::Gate(RESET_HIGH), 0);
        assert_eq!(effects.order, Some(Control::Close));
        assert_eq!(machine.reason(), FaultReason::ExternalReset);
        assert!(!machine.position_trusted());
        for level in [false, true, true] {
            machine = machine.step(command(true, level, RESET_HIGH), 1).0;
        }
        assert_eq!(machine.state(), State::Faulted);
        machine = machine.step(command(true, false, RESET_LATCHED), 2).0;
        machine = machine.step(command(true, true, RESET_LATCHED), 2).0;
        machine = machine.step(command(true, true, CLOSED), 3).0;
        assert_eq!(machine.state(), State::Armed);
        assert!(
            machine.position_trusted(),
            "arming is the host's word that it took note"
        );
    }

    #[test]
    fn taking_enable_away_stops_softly_and_is_no_fault() {
        let (machine, effects) = armed().step(command(false, true, LIVE), 0);
        assert_eq!(effects.order, Some(Control::SoftStop));
        assert!(!effects.execute);
        assert_eq!(machine.state(), State::Stopping);
        let (machine, _) = machine.step(Event::Gate(CLOSED), 10);
        assert_eq!(
            (machine.state(), machine.reason()),
            (State::Disarmed, FaultReason::HostDisable)
        );
        assert!(machine.position_trusted());
    }

    #[test]
    fn a_released_session_stops_the_machine() {
        let (machine, effects) = armed().step(Event::Lost, 0);
        assert_eq!(effects.order, Some(Control::SoftStop));
        let machine = machine.step(Event::Gate(CLOSED), 10).0;
        assert_eq!(
            (machine.state(), machine.reason()),
            (State::Faulted, FaultReason::SessionLost)
        );
    }

    #[test]
    fn a_stop_that_never_ends_is_ended() {
        let machine = armed().step(command(false, true, LIVE), 5).0;
        let (machine, effects) = machine.step(Event::Gate(Gate(0b10_0011)), 5 + STOP_LIMIT_CLOCKS);
        assert_eq!(effects.order, Some(Control::Close));
        assert!(!machine.position_trusted());
        assert_eq!(machine.state(), State::Disarmed);
    }

    #[test]
    fn an_e_stop_stops_hard_and_holds_until_the_input_is_idle_and_an_edge_clears_it() {
        let (mut machine, effects) = armed().step(Event::Gate(ESTOP_ACTIVE), 0);
        assert_eq!(effects.order, Some(Control::Close));
        assert!(!effects.end_session, "the host shall tell its operator");
        assert_eq!(
            (machine.state(), machine.reason()),
            (State::Faulted, FaultReason::EStop)
        );
        assert!(!machine.position_trusted());
        for level in [false, true, true] {
            machine = machine.step(command(true, level, ESTOP_ACTIVE), 1).0;
        }
        assert_eq!(machine.state(), State::Faulted);
        machine = machine.step(command(true, true, ESTOP_LATCHED), 2).0;
        assert_eq!(machine.state(), State::Faulted, "a level is no edge");
        machine = machine.step(command(true, false, ESTOP_LATCHED), 3).0;
        let (machine, effects) = machine.step(command(true, true, ESTOP_LATCHED), 4);
        assert_eq!(effects.order, Some(Control::Clear));
        assert_eq!(machine.reason(), FaultReason::EStop);
        assert_eq!(
            machine.step(command(true, true, CLOSED), 5).0.state(),
            State::Armed
        );
    }

    #[test]
    fn an_e_stop_during_a_soft_stop_is_the_reason() {
        let machine = armed().step(command(false, true, LIVE), 0).0;
        let machine = machine.step(Event::Gate(ESTOP_ACTIVE), 1).0;
        assert_eq!(
            (machine.state(), machine.reason()),
            (State::Faulted, FaultReason::EStop)
        );
    }

    #[test]
    fn an_e_stop_while_disarmed_keeps_it_from_arming_until_cleared() {
        let mut machine = run(&[BOOTED, Event::Acquired]);
        for gate in [ESTOP_ACTIVE, ESTOP_LATCHED] {
            machine = machine.step(command(true, false, gate), 0).0;
            let (edge, effects) = machine.step(command(true, true, gate), 0);
            assert_eq!(effects.order, Some(Control::Clear));
            machine = edge.step(command(true, true, gate), 0).0;
            assert_eq!(machine.state(), State::Disarmed);
        }
    }

    #[test]
    fn after_a_restart_the_machine_goes_on_where_the_gate_closed() {
        use FaultReason as Why;
        use ResetReason as Reset;
        for (reset, close, reason, trusted) in [
            (Reset::PowerUp, GateClose::Never, Why::None, true),
            (Reset::Requested, GateClose::SoftStop, Why::None, true),
            (Reset::Unknown, GateClose::Order, Why::None, true),
            (Reset::Unknown, GateClose::Bite, Why::Watchdog, true),
            (
                Reset::Unknown,
                GateClose::ExternalReset,
                Why::ExternalReset,
                false,
            ),
            (Reset::Unknown, GateClose::EStop, Why::EStop, false),
            (
                Reset::PowerUp,
                GateClose::SystemReset,
                Why::FirmwareFault,
                false,
            ),
            (Reset::Panic, GateClose::Order, Why::FirmwareFault, false),
            (Reset::Trap, GateClose::Order, Why::FirmwareFault, false),
            (Reset::Trap, GateClose::EStop, Why::FirmwareFault, false),
        ] {
            let machine = booted(reset, close);
            let state = if reason == Why::None {
                State::Disarmed
            } else {
                State::Faulted
            };
            assert_eq!(
                (
                    machine.state(),
                    machine.reason(),
                    machine.position_trusted()
                ),
                (state, reason, trusted),
                "{reset}, {close}"
            );
        }
    }
}
