//! Faults at the pins: without a host, without a CPU, with the external reset or an e-stop.

use ferrocnc_tests::BenchMachine;
use wire::exchange::Command;
use wire::map;
use wire::state::{FaultReason, State};
use wire::units::{Accel, Velocity};

#[test]
fn outputs_are_safe_before_the_machine_is_armed() {
    let mut machine = BenchMachine::start();
    machine.acquire();
    let mut command = machine.enabled_command();
    command.enable_request = false;
    command.gpio_out = u64::MAX;
    command.stepgen[0].0 = Velocity::from_hz(100e3, machine.clock_hz());
    for _ in 0..5 {
        machine.exchange_and_wait(&mut command);
    }
    assert_eq!((machine.edges(0), machine.gate_open()), (0, false));
    assert_eq!(machine.outputs(), 0);
}

#[test]
fn killing_the_host_mid_move_stops_the_steps_and_keeps_the_position() {
    let mut machine = BenchMachine::armed();
    let mut command = machine.enabled_command();
    command.gpio_out = 0x5;
    for axis in 0..3 {
        let velocity = [100e3, -60e3, 20e3][axis];
        command.stepgen[axis] = (
            Velocity::from_hz(velocity, machine.clock_hz()),
            Accel::from_steps(1e8, machine.clock_hz()),
        );
    }
    for _ in 0..20 {
        machine.exchange_and_wait(&mut command);
    }
    assert_eq!(machine.outputs(), 0x5);
    machine.exchange(&mut command);
    let last_good_frame = machine.clock();

    // The host is gone. Timeout plus soft stop, and nothing moves any more.
    // A plain read is no command and must not keep the watchdog quiet.
    let timeout = u64::from(machine.read(map::CONFIG_BOARD));
    machine.run_millis(30);
    assert!(!machine.gate_open(), "the gate must have closed");
    assert_eq!(machine.outputs(), 0, "outputs at their safe level");
    // They end together: the slowest axis decides when.
    let each = (0..3).map(|axis| machine.soft_stop_clocks(&command, axis));
    let soft_stop = each.max().unwrap_or(0);
    for axis in 0..3 {
        let last = machine.last_step(axis).expect("it moved");
        assert!(
            last <= last_good_frame + timeout + soft_stop + 2,
            "axis {axis}: last step {} clocks after the last frame, timeout {timeout}, soft stop {soft_stop}",
            last - last_good_frame
        );
    }

    // The host comes back with the same wishes: nothing moves without a rising edge, and nothing
    // jumps.
    let stopped_at: Vec<_> = (0..3).map(|axis| machine.pulses(axis)).collect();
    machine.acquire();
    command.enable_request = true;
    command.stepgen = Command::default().stepgen;
    let status = machine.exchange_and_wait(&mut command);
    assert_eq!(
        (status.state.state, status.state.reason),
        (State::Faulted, FaultReason::Watchdog)
    );
    for (axis, at) in stopped_at.iter().enumerate() {
        assert_eq!(
            status.stepgen[axis].0.pulses(),
            *at,
            "axis {axis}: the position is kept"
        );
    }
    for _ in 0..5 {
        let status = machine.exchange_and_wait(&mut command);
        assert!(!status.state.enabled, "a level is not an edge");
    }
    machine.rearm(&mut command);
    for (axis, at) in stopped_at.iter().enumerate() {
        assert_eq!(
            machine.pulses(axis),
            *at,
            "axis {axis}: arming moves nothing"
        );
    }
}

#[test]
fn a_frozen_cpu_leaves_the_outputs_safe() {
    let mut machine = BenchMachine::armed();
    let mut command = machine.enabled_command();
    command.gpio_out = 0xff;
    command.stepgen[0] = (
        Velocity::from_hz(150e3, machine.clock_hz()),
        Accel::UNLIMITED,
    );
    for _ in 0..5 {
        machine.exchange_and_wait(&mut command);
    }
    machine.exchange(&mut command);
    // A plain read is no command and must not keep the watchdog quiet.
    let timeout = u64::from(machine.read(map::CONFIG_BOARD));
    let frozen_at = machine.clock();
    machine.freeze_cpu();
    // Frames keep coming; the CPU does not read them.
    let last_command = machine.clock();
    machine.run_millis(30);
    assert!(!machine.gate_open());
    assert_eq!(machine.outputs(), 0);
    let last = machine.last_step(0).expect("it moved");
    let bound = timeout + machine.soft_stop_clocks(&command, 0) + 2;
    assert!(
        last <= frozen_at.max(last_command) + bound,
        "steps went on for {} clocks",
        last - frozen_at
    );
    let quiet = machine.edges(0);
    machine.run_millis(5);
    assert_eq!(machine.edges(0), quiet, "and stay stopped");
}

#[test]
fn the_external_reset_pin_needs_no_cpu() {
    let mut machine = BenchMachine::armed();
    let mut command = machine.enabled_command();
    command.gpio_out = 0xff;
    command.stepgen[0] = (Velocity::from_hz(1e6, machine.clock_hz()), Accel::UNLIMITED);
    for _ in 0..3 {
        machine.exchange_and_wait(&mut command);
    }
    machine.freeze_cpu();
    assert!(machine.gate_open());
    let clocks = machine.external_reset_until_safe();
    assert!(
        clocks <= 4,
        "it took {clocks} clocks from the pin to safe outputs"
    );
    assert_eq!(machine.outputs(), 0);
    let edges = machine.edges(0);
    machine.run_millis(1);
    assert_eq!(machine.edges(0), edges);
}

/// `estop` in boards/mill6.toml: input 11, high trips.
const ESTOP: u32 = 1 << 11;

#[test]
fn an_estop_input_needs_no_cpu() {
    let mut machine = BenchMachine::armed();
    let mut command = machine.enabled_command();
    command.gpio_out = 0xff;
    command.stepgen[0] = (Velocity::from_hz(1e5, machine.clock_hz()), Accel::UNLIMITED);
    for _ in 0..3 {
        machine.exchange_and_wait(&mut command);
    }
    machine.freeze_cpu();
    let clocks = machine.inputs_until_safe(ESTOP.into());
    assert!(
        clocks <= 4,
        "it took {clocks} clocks from the pin to safe outputs"
    );
    let edges = machine.edges(0);
    machine.run_millis(1);
    assert_eq!(machine.edges(0), edges);
}

#[test]
fn an_estop_is_latched_until_it_is_released_and_asked_for_again() {
    let (mut machine, mut command) = BenchMachine::turning(1e5, 3);
    machine.inputs_until_safe(ESTOP.into());
    let status = machine.exchange_and_wait(&mut command);
    assert_eq!(
        (status.state.state, status.state.reason, status.estop),
        (State::Faulted, FaultReason::EStop, ESTOP)
    );
    let stood = machine.pulses(0);
    for request in [false, true, false, true] {
        command.enable_request = request;
        machine.exchange_and_wait(&mut command);
        assert!(!machine.gate_open(), "pressed, nothing arms");
    }
    machine.inputs(0);
    machine.exchange_and_wait(&mut command);
    assert!(!machine.gate_open(), "released is not asked for");
    command.stepgen[0].0 = Velocity(0);
    for request in [false, true, true] {
        command.enable_request = request;
        machine.exchange_and_wait(&mut command);
    }
    assert!(!machine.gate_open(), "asked for, but not resynchronised");
    machine.acquire();
    machine.rearm(&mut command);
    assert_eq!(machine.pulses(0), stood, "no step on the way");
}

#[test]
fn a_trap_closes_the_gate_and_leaves_its_message() {
    let (mut machine, mut command) = BenchMachine::turning(100e3, 5);
    assert_eq!(machine.read(map::PANIC), 0, "nothing has gone wrong yet");
    let boot_id = machine.exchange(&mut command).boot_id;
    machine.trap_cpu();
    machine.run_millis(20);
    assert!(!machine.gate_open());
    let pulses = machine.pulses(0);
    assert_eq!(
        machine.read(map::PANIC),
        1,
        "the restarted firmware knows it died"
    );
    let text = machine.panic_text();
    assert!(!text.is_empty(), "and of what");
    machine.acquire();
    let status = machine.exchange(&mut command);
    assert_ne!(status.boot_id, boot_id);
    assert_eq!(status.state.reason, FaultReason::FirmwareFault);
    assert_eq!(
        status.stepgen[0].0.pulses(),
        pulses,
        "counts survive the restart: {text}"
    );
}
