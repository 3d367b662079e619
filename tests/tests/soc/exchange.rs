//! The exchange: what is commanded is at the pins, and what the pins do is reported.

use ferrocnc_tests::{BenchMachine, STRANGER, hex, seed};
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg32;
use sim::lan_segment::{BOARD_PORT, HOST_IP};
use sim::rig::RIG_PORT;
use wire::exchange::{self, Command, Latch};
use wire::state::State;
use wire::units::{Accel, Clocks, Velocity};
use wire::{Refusal, map};

#[test]
fn the_pins_carry_exactly_the_pulses_the_board_reports() {
    let mut machine = BenchMachine::armed();
    let seed = seed();
    let mut random = Pcg32::seed_from_u64(seed);
    let mut command = machine.enabled_command();
    for _ in 0..60 {
        for (velocity, accel) in command.stepgen.iter_mut().take(6) {
            *velocity = Velocity::from_hz(random.random_range(-2e5..2e5), machine.clock_hz());
            *accel = Accel::from_steps(random.random_range(1e6..1e9), machine.clock_hz());
        }
        machine.exchange_and_wait(&mut command);
    }
    command.stepgen = Command::default().stepgen;
    for _ in 0..5 {
        machine.exchange_and_wait(&mut command);
    }
    let status = machine.exchange(&mut command);
    for axis in 0..6 {
        let pins = machine.pulses(axis);
        assert_eq!(
            status.stepgen[axis].0.pulses(),
            pins,
            "seed {seed}: axis {axis}"
        );
        assert!(
            machine.edges(axis) > 100,
            "seed {seed}: axis {axis} hardly moved"
        );
    }
    assert_eq!(machine.timing_violations(), 0, "seed {seed}");
}

#[test]
fn encoders_on_the_motors_count_what_the_motors_turn_and_latch_at_the_index() {
    let mut machine = BenchMachine::armed();
    let mut command = machine.enabled_command();
    command.index_arm = 1 << 0;
    command.latch = Latch::Encoder(0);
    for axis in 0..6 {
        let velocity = if axis % 2 == 0 { 300e3 } else { -200e3 };
        command.stepgen[axis] = (
            Velocity::from_hz(velocity, machine.clock_hz()),
            Accel::UNLIMITED,
        );
    }
    for _ in 0..20 {
        machine.exchange_and_wait(&mut command);
    }
    command.stepgen = Command::default().stepgen;
    for _ in 0..3 {
        machine.exchange_and_wait(&mut command);
    }
    let status = machine.exchange(&mut command);
    for axis in 0..6 {
        let counted = i64::from(status.encoder[axis].count.0 as i32);
        assert_eq!(counted, machine.pulses(axis), "encoder {axis}");
    }
    // The plant's encoders have an index every 4000 counts; axis 0 turned forward through the first
    // of them.
    assert_eq!(status.index_latched, 1, "only encoder 0 was armed");
    assert_eq!(status.latch.0, 4000, "its latch was selected");
    command.index_arm = 0;
    machine.exchange(&mut command);
    let status = machine.exchange(&mut command);
    assert_eq!(status.index_latched, 0, "the arm bit fell");
}

#[test]
fn pwm_and_outputs_appear_at_the_pins_as_commanded() {
    let mut machine = BenchMachine::start();
    machine.acquire();
    machine.configure();
    machine.write(map::CONFIG_PWM, 12_000);
    let mut command = machine.enabled_command();
    machine.rearm(&mut command);
    command.gpio_out = 0xa5a;
    for width in [0, 1, 3_000, 11_999, 12_000] {
        command.pwm[0] = exchange::PWM_ENABLE | width << exchange::PWM_FRACTION;
        for _ in 0..4 {
            machine.exchange_and_wait(&mut command);
        }
        assert_eq!(machine.pwm_high(0), width, "high time of 12000 clocks");
        assert_eq!(machine.outputs(), 0xa5a);
    }
}

#[test]
fn a_duplicated_or_stale_exchange_changes_nothing() {
    let mut machine = BenchMachine::armed();
    let mut command = machine.enabled_command();
    command.stepgen[0] = (
        Velocity::from_hz(50e3, machine.clock_hz()),
        Accel::UNLIMITED,
    );
    machine.exchange_and_wait(&mut command);
    let mut again = command;
    again.stepgen[0].0 = Velocity::from_hz(-50e3, machine.clock_hz());
    for (sequence, reason) in [
        (command.sequence, Refusal::Duplicate),
        (command.sequence - 1, Refusal::Stale),
    ] {
        again.sequence = sequence;
        let counted = machine.refusals(reason);
        let bytes = machine.command_bytes(&again);
        assert_eq!(machine.ask(&bytes), None, "{}", reason.key());
        assert_eq!(machine.refusals(reason), counted + 1);
    }
    let status = machine.exchange(&mut command);
    assert!(status.stepgen[0].1.0 > 0, "the first command still holds");
}

#[test]
fn a_damaged_exchange_leaves_a_command_that_waits_for_its_time() {
    let mut machine = BenchMachine::armed();
    let mut command = machine.enabled_command();
    machine.exchange_and_wait(&mut command);
    let mut timed = command;
    timed.stepgen[0] = (
        Velocity::from_hz(50e3, machine.clock_hz()),
        Accel::UNLIMITED,
    );
    let apply = machine.clock() + 60_000;
    timed.apply_at = Some(Clocks(apply));
    machine.exchange(&mut timed);
    // The same way back, with its last byte changed on the way: the checksum of UDP says so, that
    // of Ethernet does not.
    let mut back = command;
    back.stepgen[0].0 = Velocity::from_hz(-50e3, machine.clock_hz());
    let bytes = machine.next_command_bytes(&mut back);
    let rig = machine.rig();
    let mut frame = rig.segment.udp((HOST_IP, RIG_PORT), BOARD_PORT, &bytes);
    if let Some(last) = frame.last_mut() {
        *last ^= 1;
    }
    rig.inject_frame(&frame);
    rig.run(8_000);
    assert_eq!(machine.pulses(0), 0, "not before its time");
    // 1 ms of 50 kHz, of a watchdog of five.
    machine.run_clocks((apply + 60_000).saturating_sub(machine.clock()));
    // Before anything is asked, which takes its time.
    let pulses = machine.pulses(0);
    assert!((49..=51).contains(&pulses), "{pulses}");
    assert_eq!(machine.refusals(Refusal::Checksum), 1);
}

#[test]
fn a_foreign_host_may_read_but_not_command() {
    let mut machine = BenchMachine::armed();
    let mut command = machine.enabled_command();
    machine.exchange_and_wait(&mut command);
    let mut foreign = command;
    foreign.sequence += 1;
    foreign.stepgen[0].0 = Velocity::from_hz(100e3, machine.clock_hz());
    let bytes = machine.command_bytes(&foreign);
    assert_eq!(machine.ask_from(STRANGER, &bytes), None);
    assert_eq!(machine.refusals(Refusal::NotOwner), 1);
    // One frame of another host per millisecond arrives, after an answer to the owner.
    machine.exchange_and_wait(&mut command);
    machine.exchange_and_wait(&mut command);
    let read = machine.ask_from(
        STRANGER,
        &hex("4e6f1044 00000000 000f0001 00000007 00000000"),
    );
    assert_eq!(
        read.expect("every host may read")[16..],
        wire::describe::MAGIC.to_be_bytes()
    );
    machine.exchange_and_wait(&mut command);
    machine.exchange_and_wait(&mut command);
    let token = machine.ask_from(
        STRANGER,
        &hex("4e6f1044 00000000 000f0001 00000007 00010004"),
    );
    assert_eq!(
        token.expect("a reply")[16..],
        [0; 4],
        "but the token is the owner's"
    );
    assert_eq!(machine.exchange(&mut command).state.state, State::Armed);
}

#[test]
fn settings_that_shape_pulses_are_refused_while_armed() {
    let mut machine = BenchMachine::armed();
    let before = machine.read(map::CONFIG_STEPGEN);
    machine.write(map::CONFIG_STEPGEN, before + 1);
    assert_eq!(machine.refusals(Refusal::Armed), 1);
    assert_eq!(machine.read(map::CONFIG_STEPGEN), before);
}

#[test]
fn the_probe_latches_every_armed_channel_on_the_same_clock() {
    let mut machine = BenchMachine::start();
    machine.acquire();
    machine.configure();
    let probe = map::CONFIG_BOARD + 4 * map::BoardConfig::Probe as u32;
    machine.write(probe, map::PROBE_ENABLE | 6);
    let mut command = machine.enabled_command();
    machine.rearm(&mut command);
    (command.probe_arm, command.stepgen_probe_arm) = (0x3f, 0x3f);
    for axis in 0..6 {
        let velocity = 50e3 * (axis as f64 - 2.5);
        command.stepgen[axis].0 = Velocity::from_hz(velocity, machine.clock_hz());
    }
    for _ in 0..5 {
        machine.exchange_and_wait(&mut command);
    }
    machine.inputs(1 << 6);
    let touched: Vec<i64> = (0..6).map(|axis| machine.pulses(axis)).collect();
    for _ in 0..5 {
        machine.exchange_and_wait(&mut command);
    }
    for axis in 0..6u8 {
        for latch in [Latch::Stepgen(axis), Latch::Encoder(axis)] {
            command.latch = latch;
            let status = machine.exchange_and_wait(&mut command);
            assert_eq!(status.stepgen_probe_latched, 0x3f);
            assert_eq!(status.probe_latched, 0x3f);
            let off = i64::from(status.latch.0 as i32) - touched[usize::from(axis)];
            // Two clocks of the synchroniser, and for an encoder its edges' way through the plant.
            assert!(off.abs() <= 1, "{latch:?} is {off} steps off");
        }
    }
}
