//! The rows of the fault table that must hold without the CPU, on the Verilated board with the
//! CPU's clock stopped; and the part of the release image in the other rows.

use ferrocnc_tests::{BenchMachine, report, seed, to_words};
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg32;
use wire::exchange::{Command, Status};
use wire::state::State;
use wire::units::{Accel, Velocity};
use wire::{FaultReason, map};

/// Three axes in motion and two outputs on.
fn cutting() -> (BenchMachine, Command) {
    let mut machine = BenchMachine::armed();
    let mut command = machine.enabled_command();
    command.gpio_out = 0x5;
    for (axis, velocity) in [100e3, -60e3, 20e3].into_iter().enumerate() {
        let velocity = Velocity::from_hz(velocity, machine.clock_hz());
        command.stepgen[axis] = (velocity, Accel::from_steps(1e8, machine.clock_hz()));
    }
    for _ in 0..5 {
        machine.exchange_and_wait(&mut command);
    }
    assert_eq!(machine.outputs(), 0x5);
    (machine, command)
}

fn is_safe(machine: &mut BenchMachine) {
    // The outputs' registers follow the gate.
    machine.run_clocks(2);
    assert!(!machine.gate_open(), "the gate must have closed");
    assert_eq!(machine.outputs(), 0, "outputs at their safe level");
    let edges: Vec<u64> = (0..3).map(|axis| machine.edges(axis)).collect();
    machine.run_millis(2);
    for (axis, before) in edges.iter().enumerate() {
        assert_eq!(
            machine.edges(axis),
            *before,
            "axis {axis} moves behind a closed gate"
        );
    }
    assert_eq!(machine.broken_rules(), []);
}

#[test]
fn powered_cpu_not_running() {
    let mut machine = BenchMachine::start();
    machine.freeze_cpu();
    let command = machine.enabled_command();
    for _ in 0..5 {
        let bytes = machine.command_bytes(&command);
        assert_eq!(machine.ask(&bytes), None);
    }
    is_safe(&mut machine);
}

#[test]
fn frames_lost_past_the_timeout() {
    // The CPU stops in the clock after the last answer, so the gateware alone does the rest.
    // Measured from the request's last byte on the wire; the firmware takes up to 1000 clocks of
    // that until it feeds the watchdog.
    let (mut machine, mut command) = cutting();
    let sent = machine.clock();
    machine.exchange(&mut command);
    machine.freeze_cpu();
    let closed = until_closed(&mut machine, 1_000_000);
    let timeout = 300_000;
    let stop = (0..3)
        .map(|axis| machine.soft_stop_clocks(&command, axis))
        .max()
        .expect("axes");
    let took = closed - sent;
    assert!(
        (timeout..=timeout + stop + 2 + 1000 + 1500).contains(&took),
        "{took} clocks, soft stop {stop}"
    );
    is_safe(&mut machine);
}

/// Clock by clock.
fn until_closed(machine: &mut BenchMachine, patience: u64) -> u64 {
    let end = machine.clock() + patience;
    while machine.gate_open() && machine.clock() < end {
        machine.run_clocks(1);
    }
    assert!(!machine.gate_open(), "still open after {patience} clocks");
    machine.clock()
}

#[test]
fn firmware_hangs_or_panics() {
    // A hang here; a trap of the release image is
    // soc::a_trap_closes_the_gate_and_leaves_its_message.
    let (mut machine, _) = cutting();
    machine.freeze_cpu();
    until_closed(&mut machine, 1_000_000);
    is_safe(&mut machine);
}

/// Timeout of the watchdog where it bites again and again, in clocks: 3 ms.
const SHORT: u32 = 180_000;
/// Clocks behind an answer from which on the next pass is out.
const NEXT_PASS: u64 = 5_000;
/// An answer to a command with a pass takes no more clocks.
const FAST: u32 = 20;
/// Moments at which the CPU freezes.
const MOMENTS: usize = 5;
/// The last byte of a frame comes so many clocks behind the bite.
const EDGES: [i64; 5] = [-60, -9, -7, -5, 20];

/// Armed by us, at rest, with the last answer.
fn armed_again(machine: &mut BenchMachine) -> (Command, Status) {
    machine.rig().freeze_cpu(false);
    machine.run_millis(2);
    machine.acquire();
    machine.write(map::CONFIG_BOARD, SHORT);
    let mut command = machine.enabled_command();
    machine.rearm(&mut command);
    machine.run_clocks(NEXT_PASS);
    let status = machine.exchange(&mut command);
    assert!(machine.turnarounds(1)[0] <= FAST, "no pass");
    (command, status)
}

/// When the gate closes, in clocks behind the timeout that began with this answer.
fn closes_behind_its_timeout(machine: &mut BenchMachine, answer: &Status) -> u64 {
    let closed = until_closed(machine, 2 * u64::from(SHORT));
    closed - answer.arrival.0 - u64::from(SHORT)
}

#[test]
fn a_cpu_that_freezes_with_a_pass_out_answers_once_more_and_the_watchdog_bites_at_its_time() {
    let seed = seed();
    let mut random = Pcg32::seed_from_u64(seed);
    let mut machine = BenchMachine::start();
    machine.acquire();
    machine.configure();
    let patience = machine.rig().patience;
    // The wall clock begins some clocks after the simulation; a soft stop at rest takes none.
    let mut bites = Vec::new();
    for _ in 0..MOMENTS {
        let (mut command, _) = armed_again(&mut machine);
        let (freezes, sends) = (
            random.random_range(NEXT_PASS..60_000),
            random.random_range(0..60_000),
        );
        let when =
            format!("seed {seed}: {freezes} clocks behind an answer, {sends} before the next");
        machine.run_clocks(freezes);
        machine.freeze_cpu();
        machine.run_clocks(sends);
        let last = machine.exchange(&mut command);
        assert!(machine.turnarounds(1)[0] <= FAST, "{when}");
        machine.rig().patience = 3_000;
        for _ in 0..2 {
            let bytes = machine.next_command_bytes(&mut command);
            assert_eq!(machine.ask(&bytes), None, "{when}: another answer");
        }
        machine.rig().patience = patience;
        bites.push(closes_behind_its_timeout(&mut machine, &last));
        is_safe(&mut machine);
    }
    // A frame that comes when it bites is executed or is not: if it is, the time begins again.
    let mut executed = Vec::new();
    for edge in EDGES {
        let (mut command, before) = armed_again(&mut machine);
        machine.run_clocks(NEXT_PASS);
        machine.freeze_cpu();
        let bytes = machine.next_command_bytes(&mut command);
        let on_wire = machine.clocks_on_wire(bytes.len());
        let bite = before.arrival.0 + u64::from(SHORT) + bites[0];
        let sent = (bite - on_wire).saturating_add_signed(edge);
        let now = machine.clock();
        machine.run_clocks(sent - now);
        machine.rig().patience = 3_000;
        let answer = machine.ask_words(&to_words(&bytes));
        machine.rig().patience = patience;
        executed.push(answer.is_some());
        match answer {
            None => assert!(!machine.gate_open(), "{edge}: neither executed nor closed"),
            Some(words) => {
                assert!(machine.gate_open(), "{edge}: executed and closed");
                let status = Status::parse_reply(&words, machine.channels()).expect("a status");
                bites.push(closes_behind_its_timeout(&mut machine, &status));
            }
        }
        is_safe(&mut machine);
    }
    println!("seed {seed}: bites {bites:?}; executed around a bite {executed:?}");
    assert!(
        executed.is_sorted_by(|before, after| before >= after),
        "{executed:?}"
    );
    assert!(executed[0] && !executed[EDGES.len() - 1], "{executed:?}");
    let (least, most) = (bites.iter().min(), bites.iter().max());
    assert!(
        most <= least.map(|least| least + 1).as_ref() && most < Some(&64),
        "{bites:?}"
    );
}

#[test]
fn external_reset_pin_high() {
    let mut most = 0;
    for wait in [7, 60, 1001, 4242] {
        let (mut machine, _) = cutting();
        machine.freeze_cpu();
        machine.run_clocks(wait);
        assert!(machine.gate_open());
        let clocks = machine.external_reset_until_safe();
        assert!(clocks <= 4, "{clocks} clocks, {wait} after the last answer");
        most = most.max(clocks);
        is_safe(&mut machine);
    }
    println!("reset pin to safe outputs on the RTL: at most {most} clocks");
    report(
        "reset_rtl",
        &serde_json::json!({ "clocks": { "max": most } }),
    );
}

#[test]
fn rate_asks_more_than_the_timing_allows() {
    let (mut machine, mut command) = cutting();
    let velocity = Velocity::from_hz(29e6, machine.clock_hz());
    command.stepgen[0] = (velocity, Accel::UNLIMITED);
    machine.exchange(&mut command);
    // What the watchdog leaves of it runs without a CPU, soft stop included.
    machine.freeze_cpu();
    until_closed(&mut machine, 1_000_000);
    assert!(machine.edges(0) > 2000, "{}", machine.edges(0));
    is_safe(&mut machine);
}

#[test]
fn cable_pulled_replugged() {
    let (mut machine, mut command) = cutting();
    machine.trouble("pull");
    machine.run_millis(20);
    is_safe(&mut machine);
    let at: Vec<i64> = (0..3).map(|axis| machine.pulses(axis)).collect();
    machine.trouble("plug");
    machine.run_millis(5);
    machine.acquire();
    command.enable_request = true;
    let status = machine.exchange_and_wait(&mut command);
    assert_eq!(
        (status.state.state, status.state.reason),
        (State::Faulted, FaultReason::Watchdog)
    );
    command.stepgen = Command::default().stepgen;
    machine.rearm(&mut command);
    for (axis, at) in at.iter().enumerate() {
        assert_eq!(machine.pulses(axis), *at, "axis {axis} jumped");
        let status = machine.exchange(&mut command);
        assert_eq!(
            status.stepgen[axis].0.pulses(),
            *at,
            "axis {axis}: the position is kept"
        );
    }
}

#[test]
fn a_board_that_starts_anew_under_its_host_is_safe_and_not_armed() {
    // The board is restarted under its host: outputs are safe at once, and the board is not
    // armed afterwards.
    let (mut machine, mut command) = cutting();
    machine.trouble("reboot");
    assert!(!machine.gate_open());
    assert_eq!(machine.outputs(), 0);
    let bytes = machine.command_bytes(&command);
    for _ in 0..10 {
        assert_eq!(
            machine.ask(&bytes),
            None,
            "a token from before the restart is not valid"
        );
    }
    machine.run_millis(5);
    is_safe(&mut machine);
    assert_eq!(machine.read(map::SESSION_TOKEN), 0);
    machine.acquire();
    command.stepgen = Command::default().stepgen;
    command.enable_request = true;
    assert!(
        !machine.exchange_and_wait(&mut command).state.enabled,
        "a level is not an edge"
    );
}
