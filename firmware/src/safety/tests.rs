use super::*;
use proptest::prelude::*;
use std::collections::BTreeSet;
use std::sync::OnceLock;

/// Clocks a soft stop may take.
const GRACE: u32 = 1_000;
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

impl Safety {
    /// What a step makes of it.
    fn stepped(mut self, event: Event, now: u64) -> (Safety, Effects) {
        let effects = self.step(event, now);
        (self, effects)
    }
}

/// A step, and the server's reaction when it opens the gate. Every step is checked against the
/// invariants.
fn step(machine: Safety, event: Event, now: u64) -> (Safety, Effects) {
    let (mut after, effects) = machine.stepped(event, now);
    if effects.order == Some(Control::Arm) {
        after.opens(GRACE, now as u32);
    }
    (after, effects)
}

fn run(events: &[Event]) -> Safety {
    events
        .iter()
        .fold(Safety::new(), |machine, event| step(machine, *event, 0).0)
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

/// Longer than any stop.
const LONG: u64 = GRACE as u64 + STOP_SLACK_CLOCKS as u64;

/// One machine for each possible combination of state and flags, found by a search.
fn reachable() -> &'static [Safety] {
    static FOUND: OnceLock<Vec<Safety>> = OnceLock::new();
    FOUND.get_or_init(walk)
}

fn walk() -> Vec<Safety> {
    let mut found = vec![Safety::new()];
    let mut known = BTreeSet::new();
    let mut next = 0;
    while let Some(machine) = found.get(next).copied() {
        next += 1;
        for event in all_events() {
            for now in [0, u64::from(GRACE), LONG] {
                let (mut after, _) = step(machine, event, now);
                // Times do not distinguish states.
                (after.stop_since, after.seen, after.grace) = (0, 0, GRACE);
                for held in [false, true] {
                    after.hold(held);
                    if known.insert(place(&after)) {
                        found.push(after);
                    }
                }
            }
        }
    }
    found
}

/// Everything of a machine except its times.
fn place(machine: &Safety) -> [u8; 9] {
    [
        machine.state as u8,
        machine.reason as u8,
        machine.after_stop as u8,
        machine.request as u8,
        machine.session.into(),
        machine.resynced.into(),
        machine.abi_fits.into(),
        machine.held.into(),
        machine.position_trusted.into(),
    ]
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

#[test]
fn every_state_meets_every_event_and_no_invariant_breaks() {
    let machines = reachable();
    for state in State::ALL {
        assert!(
            machines.iter().any(|m| m.state == *state),
            "{state} is never reached"
        );
    }
    println!("{} machines", machines.len());
    for &machine in machines {
        for event in all_events() {
            for now in [0, 1, u64::from(GRACE), LONG, u64::MAX] {
                let _ = machine.stepped(event, now); // it panics if an invariant breaks
            }
        }
    }
}

#[test]
fn steady_says_yes_only_where_a_full_step_would_change_nothing_and_execute() {
    for &machine in reachable() {
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
                let (after, effects) = machine.stepped(event, 5);
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
            .stepped(command(true, true, LIVE), 0)
            .0
            .steady(true, true, LIVE)
    );
}

#[test]
fn waiting_says_yes_only_where_a_full_step_would_do_no_more_than_waited() {
    let mut times = 0;
    for &machine in reachable() {
        for event in all_events() {
            let Event::Command { request, gate, .. } = event else {
                continue;
            };
            if machine.waiting(request, gate) {
                let mut after = machine;
                after.waited(request);
                assert_eq!(
                    machine.stepped(event, 5),
                    (after, Effects::NONE),
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
        picks in proptest::collection::vec((0usize..1 << 14, 0u64..LONG, any::<bool>()), 1..200)
    ) {
        let events = all_events();
        let (mut machine, mut now) = (Safety::new(), 0u64);
        for (pick, wait, held) in picks {
            now += wait;
            let event = events[pick % events.len()];
            machine.hold(held && wait % 8 == 0);
            machine = step(machine, event, now).0;
        }
    }
}

#[test]
fn arming_takes_session_enable_an_edge_and_a_fresh_command_after_it() {
    let machine = run(&ready());
    assert_eq!(machine.state(), State::Disarmed);
    let (machine, effects) = machine.stepped(command(true, true, CLOSED), 0);
    assert_eq!(machine.state(), State::Armed);
    assert_eq!((effects.order, effects.execute), (Some(Control::Arm), true));
}

#[test]
fn a_request_that_was_high_from_the_start_never_arms() {
    let mut machine = run(&[BOOTED, Event::Acquired]);
    for _ in 0..10 {
        machine = machine.stepped(command(true, true, CLOSED), 0).0;
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
    let (machine, _) = machine.stepped(command(false, true, CLOSED), 0);
    let (machine, _) = machine.stepped(command(true, true, CLOSED), 0);
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
        machine = machine.stepped(command(true, level, CLOSED), 0).0;
    }
    assert_eq!(
        (machine.state(), machine.reason()),
        (State::Faulted, FaultReason::AbiMismatch)
    );
}

#[test]
fn a_bite_ends_the_session_and_commands_without_a_resync_do_nothing() {
    let (machine, effects) = armed().stepped(Event::Gate(BITTEN_STOPPING), 0);
    assert!(effects.end_session);
    assert_eq!(
        (machine.state(), machine.reason()),
        (State::Stopping, FaultReason::Watchdog)
    );
    let (mut machine, _) = machine.stepped(Event::Gate(BITTEN), 1);
    assert_eq!(machine.state(), State::Faulted);
    for level in [false, true, true] {
        machine = machine.stepped(command(true, level, BITTEN), 2).0;
    }
    assert_eq!(
        machine.state(),
        State::Faulted,
        "a watchdog feed cleared a bite"
    );
}

#[test]
fn after_a_bite_a_resync_and_a_new_edge_bring_it_back() {
    let mut machine = armed().stepped(Event::Gate(BITTEN), 0).0;
    machine = machine.stepped(Event::Acquired, 1).0;
    machine = machine.stepped(command(true, false, BITTEN), 2).0;
    let (machine, effects) = machine.stepped(command(true, true, BITTEN), 3);
    assert_eq!(effects.order, Some(Control::Clear));
    assert_eq!(
        (machine.state(), machine.reason()),
        (State::Disarmed, FaultReason::Watchdog)
    );
    let (machine, effects) = machine.stepped(command(true, true, CLOSED), 4);
    assert_eq!(effects.order, Some(Control::Arm));
    assert_eq!(machine.reason(), FaultReason::None);
}

#[test]
fn after_a_bite_a_request_still_high_does_not_rearm() {
    let mut machine = armed().stepped(Event::Gate(BITTEN), 0).0;
    machine = machine.stepped(Event::Acquired, 1).0;
    for _ in 0..5 {
        machine = machine.stepped(command(true, true, BITTEN), 2).0;
    }
    assert_eq!(machine.state(), State::Faulted);
}

#[test]
fn an_external_reset_faults_at_once_and_holds_until_the_pin_is_low() {
    let (mut machine, effects) = armed().stepped(Event::Gate(RESET_HIGH), 0);
    assert_eq!(effects.order, Some(Control::Close));
    assert_eq!(machine.reason(), FaultReason::ExternalReset);
    assert!(!machine.position_trusted());
    for level in [false, true, true] {
        machine = machine.stepped(command(true, level, RESET_HIGH), 1).0;
    }
    assert_eq!(machine.state(), State::Faulted);
    machine = machine.stepped(Event::Acquired, 2).0;
    machine = machine.stepped(command(true, false, RESET_LATCHED), 2).0;
    machine = machine.stepped(command(true, true, RESET_LATCHED), 2).0;
    machine = machine.stepped(command(true, true, CLOSED), 3).0;
    assert_eq!(machine.state(), State::Armed);
    assert!(
        machine.position_trusted(),
        "only arming shows that the host took note"
    );
}

#[test]
fn taking_enable_away_stops_softly_and_is_no_fault() {
    let (machine, effects) = armed().stepped(command(false, true, LIVE), 0);
    assert_eq!(effects.order, Some(Control::SoftStop));
    assert!(!effects.execute);
    assert_eq!(machine.state(), State::Stopping);
    let (machine, _) = machine.stepped(Event::Gate(CLOSED), 10);
    assert_eq!(
        (machine.state(), machine.reason()),
        (State::Disarmed, FaultReason::HostDisable)
    );
    assert!(machine.position_trusted());
}

#[test]
fn a_released_session_stops_the_machine() {
    let (machine, effects) = armed().stepped(Event::Lost, 0);
    assert_eq!(effects.order, Some(Control::SoftStop));
    let machine = machine.stepped(Event::Gate(CLOSED), 10).0;
    assert_eq!(
        (machine.state(), machine.reason()),
        (State::Faulted, FaultReason::SessionLost)
    );
}

#[test]
fn a_stop_that_never_ends_is_ended() {
    let machine = armed().stepped(command(false, true, LIVE), 5).0;
    let (machine, effects) = machine.stepped(Event::Gate(Gate(0b10_0011)), 5 + LONG);
    assert_eq!(effects.order, Some(Control::Close));
    assert!(!machine.position_trusted());
    assert_eq!(machine.state(), State::Disarmed);
}

#[test]
fn an_e_stop_stops_hard_and_holds_until_the_input_is_idle_and_an_edge_clears_it() {
    let (mut machine, effects) = armed().stepped(Event::Gate(ESTOP_ACTIVE), 0);
    assert_eq!(effects.order, Some(Control::Close));
    assert!(!effects.end_session, "the host has to tell its operator");
    assert_eq!(
        (machine.state(), machine.reason()),
        (State::Faulted, FaultReason::EStop)
    );
    assert!(!machine.position_trusted());
    machine = machine.stepped(Event::Acquired, 1).0;
    for level in [false, true, true] {
        machine = machine.stepped(command(true, level, ESTOP_ACTIVE), 1).0;
    }
    assert_eq!(machine.state(), State::Faulted);
    machine = machine.stepped(command(true, true, ESTOP_LATCHED), 2).0;
    assert_eq!(machine.state(), State::Faulted, "a level is no edge");
    machine = machine.stepped(command(true, false, ESTOP_LATCHED), 3).0;
    let (machine, effects) = machine.stepped(command(true, true, ESTOP_LATCHED), 4);
    assert_eq!(effects.order, Some(Control::Clear));
    assert_eq!(machine.reason(), FaultReason::EStop);
    assert_eq!(
        machine.stepped(command(true, true, CLOSED), 5).0.state(),
        State::Armed
    );
}

#[test]
fn an_e_stop_during_a_soft_stop_is_the_reason() {
    let machine = armed().stepped(command(false, true, LIVE), 0).0;
    let machine = machine.stepped(Event::Gate(ESTOP_ACTIVE), 1).0;
    assert_eq!(
        (machine.state(), machine.reason()),
        (State::Faulted, FaultReason::EStop)
    );
}

#[test]
fn an_e_stop_while_disarmed_keeps_it_from_arming_until_cleared() {
    let mut machine = run(&[BOOTED, Event::Acquired]);
    for gate in [ESTOP_ACTIVE, ESTOP_LATCHED] {
        machine = machine.stepped(command(true, false, gate), 0).0;
        let (edge, effects) = machine.stepped(command(true, true, gate), 0);
        assert_eq!(effects.order, Some(Control::Clear));
        machine = edge.stepped(command(true, true, gate), 0).0;
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
        (Reset::Requested, GateClose::Bite, Why::Watchdog, true),
        (Reset::Unknown, GateClose::Never, Why::None, true),
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

#[test]
fn a_start_that_was_not_asked_for_may_have_cut_pulses_off() {
    use FaultReason as Why;
    // A jump to where the firmware begins leaves no word, or has spoilt the record: then it looks
    // like power-up.
    for reset in [ResetReason::Unknown, ResetReason::PowerUp] {
        for (close, reason) in [
            // The start closed the gate itself, on axes that moved, for all that is known.
            (GateClose::Order, Why::FirmwareFault),
            (GateClose::SoftStop, Why::FirmwareFault),
            // And a bite stays the reason when the start has cut its stop short.
            (GateClose::Bite, Why::Watchdog),
        ] {
            let machine = booted(reset, close);
            assert_eq!(
                (machine.state(), machine.reason()),
                (State::Faulted, reason)
            );
            assert!(!machine.position_trusted(), "{reset}, {close}");
        }
    }
}

// ---- resync -------------------------------------------------------------------------------------

/// Request low, high, high: arms if nothing prevents it.
fn ask(mut machine: Safety, gate: Gate) -> Safety {
    for level in [false, true, true] {
        machine = step(machine, command(true, level, gate), 0).0;
    }
    machine
}

#[test]
fn no_fault_is_left_without_a_resync_whatever_struck() {
    let faults: [(&str, &[Event], Gate); 5] = [
        ("reset", &[Event::Gate(RESET_HIGH)], RESET_LATCHED),
        ("e-stop", &[Event::Gate(ESTOP_ACTIVE)], ESTOP_LATCHED),
        ("link", &[Event::LinkDown, Event::Gate(CLOSED)], CLOSED),
        ("job", &[Event::JobUnderrun, Event::Gate(CLOSED)], CLOSED),
        ("bite", &[Event::Gate(BITTEN)], BITTEN),
    ];
    for (name, events, gate) in faults {
        let machine = events
            .iter()
            .fold(armed(), |machine, event| step(machine, *event, 1).0);
        assert_eq!(machine.state(), State::Faulted, "{name}");
        let asked = ask(machine, gate);
        assert_eq!(asked.state(), State::Faulted, "{name}: without a resync");
        let machine = step(asked, Event::Acquired, 2).0;
        let machine = step(machine, command(true, false, gate), 3).0;
        let machine = step(machine, command(true, true, gate), 4).0;
        assert_eq!(machine.state(), State::Disarmed, "{name}: with one");
        let machine = step(machine, command(true, true, CLOSED), 5).0;
        assert_eq!(machine.state(), State::Armed, "{name}");
    }
}

#[test]
fn a_resync_while_it_still_stops_counts_and_one_before_the_fault_does_not() {
    let stopping = step(armed(), Event::LinkDown, 0).0;
    let resynced = step(stopping, Event::Acquired, 1).0;
    for (machine, state) in [(stopping, State::Faulted), (resynced, State::Disarmed)] {
        let machine = step(machine, Event::Gate(CLOSED), 2).0;
        let machine = step(machine, command(true, false, CLOSED), 3).0;
        let machine = step(machine, command(true, true, CLOSED), 4).0;
        assert_eq!(machine.state(), state);
    }
}

#[test]
fn the_hosts_own_stop_is_no_fault_and_needs_no_resync() {
    let machine = step(armed(), command(false, true, LIVE), 0).0;
    let machine = step(machine, Event::Gate(CLOSED), 1).0;
    assert_eq!(ask(machine, CLOSED).state(), State::Armed);
}

#[test]
fn an_open_gate_at_rest_is_closed_before_anything_is_cleared() {
    let machine = run(&[BOOTED, Event::Acquired, command(true, false, CLOSED)]);
    let (_, effects) = machine.stepped(command(true, true, BITTEN_STOPPING), 0);
    assert_eq!(effects.order, Some(Control::Close));
}

// ---- reasons and trust --------------------------------------------------------------------------

#[test]
fn the_first_fault_is_the_reason_and_a_fault_outweighs_the_hosts_wish() {
    let machine = step(armed(), Event::LinkDown, 0).0;
    let machine = step(machine, Event::JobUnderrun, 1).0;
    assert_eq!(machine.reason(), FaultReason::LinkDown);
    let machine = step(armed(), command(false, true, LIVE), 0).0;
    let machine = step(machine, Event::Lost, 1).0;
    assert_eq!(machine.reason(), FaultReason::SessionLost);
    let machine = step(machine, Event::Gate(CLOSED), 2).0;
    assert_eq!(machine.state(), State::Faulted);
}

#[test]
fn the_reason_stays_readable_until_it_arms_again() {
    let machine = step(armed(), Event::Gate(ESTOP_ACTIVE), 0).0;
    let machine = step(machine, Event::Acquired, 1).0;
    let disarmed = step(
        step(machine, command(true, false, ESTOP_LATCHED), 2).0,
        command(true, true, ESTOP_LATCHED),
        3,
    );
    assert_eq!(
        (disarmed.0.state(), disarmed.0.reason()),
        (State::Disarmed, FaultReason::EStop)
    );
    let armed = ask(disarmed.0, CLOSED);
    assert_eq!(
        (armed.state(), armed.reason()),
        (State::Armed, FaultReason::None)
    );
}

/// Armed, seen undisturbed at 100.
fn seen() -> Safety {
    step(armed(), Event::Gate(LIVE), 100).0
}

#[test]
fn a_soft_stop_within_its_grace_leaves_the_position_trusted() {
    let in_time = 100 + u64::from(GRACE) - 1;
    let bitten = step(seen(), Event::Gate(BITTEN_STOPPING), 300).0;
    assert!(
        step(bitten, Event::Gate(BITTEN), in_time)
            .0
            .position_trusted()
    );
    assert!(
        step(seen(), Event::Gate(BITTEN), in_time)
            .0
            .position_trusted()
    );
    let ordered = step(seen(), Event::LinkDown, 300).0;
    let closed = step(ordered, Event::Gate(CLOSED), 300 + u64::from(GRACE) - 1).0;
    assert!(closed.position_trusted());
}

#[test]
fn a_soft_stop_that_the_grace_may_have_ended_does_not() {
    let late = 100 + u64::from(GRACE);
    let bitten = step(seen(), Event::Gate(BITTEN_STOPPING), 300).0;
    assert!(!step(bitten, Event::Gate(BITTEN), late).0.position_trusted());
    assert!(!step(seen(), Event::Gate(BITTEN), late).0.position_trusted());
    let ordered = step(seen(), Event::LinkDown, 300).0;
    let closed = step(ordered, Event::Gate(CLOSED), 300 + u64::from(GRACE)).0;
    assert!(!closed.position_trusted());
    assert_eq!(closed.reason(), FaultReason::LinkDown);
}

#[test]
fn a_bite_that_was_faster_than_our_order_counts_from_before_it() {
    let ordered = step(seen(), command(false, true, LIVE), 600).0;
    let (stopping, effects) = step(ordered, Event::Gate(BITTEN_STOPPING), 601);
    assert_eq!(stopping.reason(), FaultReason::Watchdog);
    assert!(effects.end_session);
    let closed = step(stopping, Event::Gate(BITTEN), 100 + u64::from(GRACE)).0;
    assert!(!closed.position_trusted());
}

#[test]
fn a_pin_during_a_soft_stop_takes_the_trust() {
    let machine = step(seen(), Event::LinkDown, 110).0;
    let machine = step(machine, Event::Gate(RESET_HIGH), 120).0;
    assert!(!machine.position_trusted());
    assert_eq!(machine.reason(), FaultReason::ExternalReset);
}

#[test]
fn a_pin_while_nothing_moves_takes_no_trust() {
    let machine = run(&[BOOTED, Event::Acquired]);
    let machine = step(machine, Event::Gate(ESTOP_ACTIVE), 0).0;
    assert!(machine.position_trusted());
    assert_eq!(machine.state(), State::Disarmed);
}

#[test]
fn an_edge_in_the_very_command_that_finds_it_at_rest_has_to_be_asked_again() {
    let stopping = step(armed(), Event::LinkDown, 0).0;
    let machine = step(stopping, Event::Acquired, 1).0;
    let machine = step(machine, command(true, false, BITTEN_STOPPING), 2).0;
    let machine = step(machine, Event::Acquired, 3).0;
    let machine = step(machine, command(true, false, LIVE), 4).0;
    let machine = step(machine, command(true, true, CLOSED), 5).0;
    assert_eq!(machine.state(), State::Faulted, "it has to be seen there");
    assert_eq!(ask(machine, CLOSED).state(), State::Armed);
}

#[test]
fn an_edge_while_it_still_stops_has_to_be_asked_again() {
    let machine = step(armed(), command(false, true, LIVE), 0).0;
    let machine = step(machine, command(true, false, LIVE), 1).0;
    let machine = step(machine, command(true, true, LIVE), 2).0;
    let machine = step(machine, Event::Gate(CLOSED), 3).0;
    let machine = step(machine, command(true, true, CLOSED), 4).0;
    assert_eq!(machine.state(), State::Disarmed, "not asked for at rest");
    assert_eq!(ask(machine, CLOSED).state(), State::Armed);
}

#[test]
fn a_request_that_is_low_while_it_still_stops_may_rise_as_soon_as_it_rests() {
    let machine = step(armed(), command(false, true, LIVE), 0).0;
    let machine = step(machine, command(true, false, LIVE), 1).0;
    let machine = step(machine, Event::Gate(CLOSED), 2).0;
    let machine = step(machine, command(true, true, CLOSED), 3).0;
    let machine = step(machine, command(true, true, CLOSED), 4).0;
    assert_eq!(machine.state(), State::Armed);
}

#[test]
fn what_is_held_is_not_armed_and_asks_again_when_it_is_let_go() {
    let mut machine = run(&ready());
    machine.hold(true);
    let mut machine = step(machine, command(true, true, CLOSED), 0).0;
    assert_eq!(machine.state(), State::Disarmed);
    machine.hold(false);
    let machine = step(machine, command(true, true, CLOSED), 1).0;
    assert_eq!(machine.state(), State::Disarmed, "the edge is used up");
    assert_eq!(ask(machine, CLOSED).state(), State::Armed);
}

#[test]
fn a_pin_is_the_reason_whether_it_is_still_active_or_was_for_a_moment() {
    use FaultReason::{EStop, ExternalReset};
    for (gate, reason) in [
        (0b0000_1000, ExternalReset),
        (0b0001_0000, ExternalReset),
        (0b0001_1000, ExternalReset),
        (0b0100_0000, EStop),
        (0b1000_0000, EStop),
        (0b1100_0000, EStop),
    ] {
        let machine = step(armed(), Event::Gate(Gate(gate)), 0).0;
        assert_eq!(machine.reason(), reason, "{gate:08b}");
    }
}
