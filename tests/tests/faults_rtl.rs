//! The rows of the fault table that must hold without the CPU, on the Verilated board with the
//! CPU's clock stopped; and the part of the release image in the other rows.

use ferrocnc_tests::{BenchMachine, report};
use wire::exchange::Command;
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
