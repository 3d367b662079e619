//! The release image on the Verilated board: boot, exchange, malformed frames, faults at the pins.
//!
//! All input goes through Ethernet frames; all checks are at the pins.

use ferrocnc_tests::{Machine, STRANGER, hex, seed};
use rand::{Rng, RngCore, SeedableRng};
use rand_pcg::Pcg32;
use sim::rig::RIG_PORT;
use sim::segment::{BOARD_PORT, HOST_IP};
use wire::exchange::{self, Command, Latch};
use wire::regmap::timebase;
use wire::state::{FaultReason, State};
use wire::units::{Accel, Clocks, StepRate};
use wire::{Refusal, map, regmap};

// ---- the golden vectors -----------------------------------------------------------------------------------------------

#[test]
fn a_probe_is_answered_with_its_payload() {
    let mut machine = Machine::start();
    let reply = machine.ask(&hex("4e6f1144 00000000 12345678"));
    assert_eq!(reply, Some(hex("4e6f1244 00000000 12345678")));
    assert_eq!(
        machine.ask(&hex("4e6f1144 00000000")),
        None,
        "a bare probe header has nothing to echo"
    );
}

#[test]
fn two_words_are_read_and_the_return_address_comes_back() {
    let mut machine = Machine::start();
    let words = [machine.read(0x100), machine.read(0x104)];
    let reply = machine
        .ask(&hex(
            "4e6f1044 00000000 000f0002 deadbeef 00000100 00000104",
        ))
        .expect("a reply");
    assert_eq!(reply[..16], hex("4e6f1044 00000000 000f0200 deadbeef")[..]);
    assert_eq!(
        reply[16..],
        [words[0].to_be_bytes(), words[1].to_be_bytes()].concat()
    );
    assert_eq!(
        words[0],
        wire::board::MAGIC,
        "the board blob begins at 0x100"
    );
}

/// `ferrocnc selftest` measures the board's clock by these two words, without a session.
#[test]
fn the_stamp_read_through_the_service_window_is_that_of_the_frame_that_asks() {
    let mut machine = Machine::start();
    let [lo, hi] = [timebase::ARRIVAL_LO, timebase::ARRIVAL_HI]
        .map(|word| regmap::address(timebase::BASE, word));
    for pause in [0, 777, 60_000] {
        machine.run_clocks(pause);
        let before = machine.clock();
        let reply = machine.ask_words(&[0x4e6f_1044, 0, 0x000f_0002, 7, lo, hi]);
        let after = machine.clock();
        let reply = reply.expect("an answer");
        let stamp = u64::from(reply[5]) << 32 | u64::from(reply[4]);
        // The wall clock begins with the end of the reset, some clocks after the simulation.
        assert!(
            (before - 64..after).contains(&stamp),
            "{before} {stamp} {after}"
        );
    }
}

#[test]
fn a_write_to_the_description_changes_nothing_and_is_not_answered() {
    let mut machine = Machine::start();
    let before = machine.registers();
    assert_eq!(
        machine.ask(&hex(
            "4e6f1044 00000000 000f0200 00000020 11223344 55667788"
        )),
        None
    );
    assert_eq!(machine.registers(), before);
    assert_eq!(machine.refusals(Refusal::ReadOnly), 1);
}

#[test]
fn no_reads_means_no_answer() {
    let mut machine = Machine::start();
    assert_eq!(
        machine.ask(&hex("4e6f1444 00000000 000f0001 00000077 00000100")),
        None
    );
    assert_eq!(
        machine.read(0x100),
        wire::board::MAGIC,
        "and the board goes on"
    );
}

#[test]
fn an_empty_record_is_harmless() {
    let mut machine = Machine::start();
    let before = machine.registers();
    assert_eq!(
        machine.ask(&hex("4e6f1044 00000000 000f0000 00000000")),
        None
    );
    assert_eq!(machine.registers(), before);
}

// ---- the behaviours a compatible server must decide on ------------------------------------------------------------------

#[test]
fn the_reply_goes_to_the_senders_port() {
    let mut machine = Machine::start();
    for port in [1234, 2, 65535, 40_000] {
        let reply = machine.ask_from(port, &hex("4e6f1044 00000000 000f0001 00000007 00000000"));
        assert_eq!(
            reply.expect("a reply")[16..],
            wire::describe::MAGIC.to_be_bytes(),
            "port {port}"
        );
    }
}

#[test]
fn every_malformed_datagram_is_refused_for_its_own_reason_and_changes_nothing() {
    let cases: &[(&str, &str, Refusal)] = &[
        (
            "wrong magic",
            "4e6e1044 00000000 000f0001 00000000 00000100",
            Refusal::Magic,
        ),
        (
            "wrong version",
            "4e6f2044 00000000 000f0001 00000000 00000100",
            Refusal::Version,
        ),
        (
            "wrong widths",
            "4e6f1011 00000000 000f0001 00000000 00000100",
            Refusal::Width,
        ),
        (
            "a probe's reply",
            "4e6f1244 00000000 00000000",
            Refusal::ProbeReply,
        ),
        (
            "half a word enabled",
            "4e6f1044 00000000 00030100 00020000 00000001",
            Refusal::ByteEnable,
        ),
        (
            "FIFO access",
            "4e6f1044 00000000 400f0100 00020000 00000001",
            Refusal::RecordFlags,
        ),
        (
            "unaligned read",
            "4e6f1044 00000000 000f0001 00000000 00000101",
            Refusal::Alignment,
        ),
        (
            "unaligned write",
            "4e6f1044 00000000 000f0100 00020002 00000001",
            Refusal::Alignment,
        ),
        (
            "unmapped read",
            "4e6f1044 00000000 000f0001 00000000 40000000",
            Refusal::Unmapped,
        ),
        (
            "unmapped write",
            "4e6f1044 00000000 000f0100 40000000 00000001",
            Refusal::Unmapped,
        ),
        (
            "truncated write",
            "4e6f1044 00000000 000f0200 00020000 00000001",
            Refusal::Truncated,
        ),
        (
            "truncated read",
            "4e6f1044 00000000 000f0002 00000000 00000100",
            Refusal::Truncated,
        ),
        (
            "read of 255 in a short datagram",
            "4e6f1044 00000000 000f00ff 00000000 00000100",
            Refusal::Truncated,
        ),
        (
            "padded write",
            "4e6f1044 00000000 000f0100 00020000 00000001 00000000",
            Refusal::Padded,
        ),
        (
            "padded read",
            "4e6f1044 00000000 000f0001 00000000 00000100 00000000",
            Refusal::Padded,
        ),
        (
            "second record bad",
            "4e6f1044 00000000 000f0100 00020000 00000001 000f0300 00020004 00000002",
            Refusal::Truncated,
        ),
        (
            "ragged",
            "4e6f1044 00000000 000f0001 00000000 000001",
            Refusal::Ragged,
        ),
        ("header only", "4e6f1044 00000000", Refusal::Short),
        ("half a header", "4e6f1044", Refusal::Short),
        (
            "write without a session",
            "4e6f1044 00000000 000f0100 00020000 00000001",
            Refusal::NotOwner,
        ),
        (
            "command of another board",
            "4e6f1044 00000000 000f0100 00030000 00000001",
            Refusal::BlockLength,
        ),
    ];
    let mut machine = Machine::start();
    let before = machine.registers();
    for (name, datagram, reason) in cases {
        let counted = machine.refusals(*reason);
        assert_eq!(
            machine.ask(&hex(datagram)),
            None,
            "{name}: must not be answered"
        );
        assert_eq!(
            machine.refusals(*reason),
            counted + 1,
            "{name}: must be counted as {}",
            reason.key()
        );
    }
    assert_eq!(machine.registers(), before, "no register may have changed");
}

#[test]
fn an_empty_datagram_and_one_longer_than_a_frame_carries_are_dropped() {
    let mut machine = Machine::start();
    let before = machine.registers();
    assert_eq!(machine.ask(&[]), None);
    let mut longest = hex("4e6f1044 00000000");
    longest.resize(wire::MAX_PAYLOAD, 0);
    assert_eq!(machine.ask(&longest), None);
    longest.resize(wire::MAX_PAYLOAD + 128, 0);
    assert_eq!(machine.ask(&longest), None, "a jumbo frame");
    assert_eq!(machine.registers(), before);
}

#[test]
fn writes_and_reads_share_a_record_and_records_share_a_datagram() {
    let mut machine = Machine::start();
    machine.acquire();
    let steplen = map::CONFIG_STEPGEN;
    let request = [
        0x4e6f_1044,
        0,
        0x000f_0101,
        steplen,
        77,
        0xaaaa,
        steplen,
        0x000f_0001,
        0xbbbb,
        0x0,
    ];
    let reply = machine.ask_words(&request).expect("a reply");
    let expected = [
        0x4e6f_1044,
        0,
        0x000f_0100,
        0xaaaa,
        77,
        0x000f_0100,
        0xbbbb,
        wire::describe::MAGIC,
    ];
    assert_eq!(reply, expected, "the record reads what it has just written");
}

#[test]
fn a_long_read_is_answered_whole_and_the_board_goes_on() {
    let mut machine = Machine::start();
    let addresses: Vec<u32> = (0..255).map(|i| map::DESCRIBE + 4 * (i % 64)).collect();
    let mut request = vec![0x4e6f_1044, 0, 0x000f_00ff, 9];
    request.extend(addresses);
    let reply = machine.ask_words(&request).expect("a reply");
    assert_eq!((reply.len(), reply[2], reply[3]), (4 + 255, 0x000f_ff00, 9));
    assert_eq!(reply[4], wire::describe::MAGIC);
}

#[test]
fn back_to_back_datagrams_are_both_answered() {
    let mut machine = Machine::start();
    let request = hex("4e6f1044 00000000 000f0001 00000001 00000000");
    assert_eq!(
        machine.ask_back_to_back(&[request.clone(), request]).len(),
        2
    );
}

#[test]
fn ten_thousand_random_datagrams_later_a_normal_exchange_still_works() {
    let mut machine = Machine::start();
    let seed = seed();
    let mut random = Pcg32::seed_from_u64(seed);
    let before = machine.registers();
    for _ in 0..10_000 {
        let mut datagram = match random.random_range(0..4) {
            // Noise, noise behind a good header, and good datagrams with a few bits or their end
            // knocked off.
            0 => vec![0; random.random_range(0..64)],
            1 => [
                hex("4e6f1044 00000000"),
                vec![0; random.random_range(0..64)],
            ]
            .concat(),
            2 => hex("4e6f1044 00000000 000f0101 00020000 00000001 00000000 00000100"),
            _ => machine.command_bytes(&Command {
                token: random.next_u32(),
                ..Command::default()
            }),
        };
        let noise_from = if datagram.len() > 8 { 8 } else { 0 };
        if datagram[noise_from..].iter().all(|byte| *byte == 0) {
            random.fill_bytes(&mut datagram[noise_from..]);
        } else {
            for _ in 0..random.random_range(1..4) {
                let bit = random.random_range(0..datagram.len() * 8);
                datagram[bit / 8] ^= 1 << (bit % 8);
            }
            let length = random.random_range(0..=datagram.len());
            datagram.truncate(length);
        }
        machine.tell_from(random.random_range(1024..u16::MAX), &datagram);
    }
    assert_eq!(
        machine.registers(),
        before,
        "seed {seed}: a register changed"
    );
    machine.acquire();
    let status = machine.exchange(&mut Command::default());
    assert!(
        status.state.accepted,
        "seed {seed}: the exchange was not executed"
    );
}

// ---- the exchange -----------------------------------------------------------------------------------------------------

#[test]
fn the_pins_carry_exactly_the_pulses_the_board_reports() {
    let mut machine = Machine::armed();
    let seed = seed();
    let mut random = Pcg32::seed_from_u64(seed);
    let mut command = machine.enabled_command();
    for _ in 0..60 {
        for (rate, accel) in command.stepgen.iter_mut().take(6) {
            *rate = StepRate::from_hz(random.random_range(-2e5..2e5), machine.clock_hz());
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
    let mut machine = Machine::armed();
    let mut command = machine.enabled_command();
    command.index_arm = 1 << 0;
    command.latch = Latch::Encoder(0);
    for axis in 0..6 {
        let rate = if axis % 2 == 0 { 300e3 } else { -200e3 };
        command.stepgen[axis] = (
            StepRate::from_hz(rate, machine.clock_hz()),
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
    let mut machine = Machine::start();
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
    let mut machine = Machine::armed();
    let mut command = machine.enabled_command();
    command.stepgen[0] = (
        StepRate::from_hz(50e3, machine.clock_hz()),
        Accel::UNLIMITED,
    );
    machine.exchange_and_wait(&mut command);
    let mut again = command;
    again.stepgen[0].0 = StepRate::from_hz(-50e3, machine.clock_hz());
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
    let mut machine = Machine::armed();
    let mut command = machine.enabled_command();
    machine.exchange_and_wait(&mut command);
    let mut timed = command;
    timed.stepgen[0] = (
        StepRate::from_hz(50e3, machine.clock_hz()),
        Accel::UNLIMITED,
    );
    let apply = machine.clock() + 60_000;
    timed.apply_at = Some(Clocks(apply));
    machine.exchange(&mut timed);
    // The same way back, with its last byte changed on the way: the checksum of UDP says so, that
    // of Ethernet does not.
    let mut back = command;
    back.stepgen[0].0 = StepRate::from_hz(-50e3, machine.clock_hz());
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
    let mut machine = Machine::armed();
    let mut command = machine.enabled_command();
    machine.exchange_and_wait(&mut command);
    let mut foreign = command;
    foreign.sequence += 1;
    foreign.stepgen[0].0 = StepRate::from_hz(100e3, machine.clock_hz());
    let bytes = machine.command_bytes(&foreign);
    assert_eq!(machine.ask_from(STRANGER, &bytes), None);
    assert_eq!(machine.refusals(Refusal::NotOwner), 1);
    let read = machine.ask_from(
        STRANGER,
        &hex("4e6f1044 00000000 000f0001 00000007 00000000"),
    );
    assert_eq!(
        read.expect("every host may read")[16..],
        wire::describe::MAGIC.to_be_bytes()
    );
    // One frame of another host a millisecond comes in while a host owns the session.
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
    let mut machine = Machine::armed();
    let before = machine.read(map::CONFIG_STEPGEN);
    machine.write(map::CONFIG_STEPGEN, before + 1);
    assert_eq!(machine.refusals(Refusal::Armed), 1);
    assert_eq!(machine.read(map::CONFIG_STEPGEN), before);
}

// ---- faults -----------------------------------------------------------------------------------------------------------

#[test]
fn outputs_are_safe_before_the_machine_is_armed() {
    let mut machine = Machine::start();
    machine.acquire();
    let mut command = machine.enabled_command();
    command.enable_request = false;
    command.gpio_out = u32::MAX;
    command.stepgen[0].0 = StepRate::from_hz(100e3, machine.clock_hz());
    for _ in 0..5 {
        machine.exchange_and_wait(&mut command);
    }
    assert_eq!((machine.edges(0), machine.gate_open()), (0, false));
    assert_eq!(machine.outputs(), 0);
}

#[test]
fn killing_the_host_mid_move_stops_the_steps_and_keeps_the_position() {
    let mut machine = Machine::armed();
    let mut command = machine.enabled_command();
    command.gpio_out = 0x5;
    for axis in 0..3 {
        let rate = [100e3, -60e3, 20e3][axis];
        command.stepgen[axis] = (
            StepRate::from_hz(rate, machine.clock_hz()),
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
    let mut machine = Machine::armed();
    let mut command = machine.enabled_command();
    command.gpio_out = 0xff;
    command.stepgen[0] = (
        StepRate::from_hz(150e3, machine.clock_hz()),
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
    let mut machine = Machine::armed();
    let mut command = machine.enabled_command();
    command.gpio_out = 0xff;
    command.stepgen[0] = (StepRate::from_hz(1e6, machine.clock_hz()), Accel::UNLIMITED);
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
    let mut machine = Machine::armed();
    let mut command = machine.enabled_command();
    command.gpio_out = 0xff;
    command.stepgen[0] = (StepRate::from_hz(1e5, machine.clock_hz()), Accel::UNLIMITED);
    for _ in 0..3 {
        machine.exchange_and_wait(&mut command);
    }
    machine.freeze_cpu();
    let clocks = machine.inputs_until_safe(ESTOP);
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
    let mut machine = Machine::armed();
    let mut command = machine.enabled_command();
    command.stepgen[0] = (StepRate::from_hz(1e5, machine.clock_hz()), Accel::UNLIMITED);
    for _ in 0..3 {
        machine.exchange_and_wait(&mut command);
    }
    machine.inputs_until_safe(ESTOP);
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
    command.stepgen[0].0 = StepRate(0);
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
fn the_probe_latches_every_armed_channel_on_the_same_clock() {
    let mut machine = Machine::start();
    machine.acquire();
    machine.configure();
    let probe = map::CONFIG_BOARD + 4 * map::BoardConfig::Probe as u32;
    machine.write(probe, map::PROBE_ENABLE | 6);
    let mut command = machine.enabled_command();
    machine.rearm(&mut command);
    (command.probe_arm, command.stepgen_probe_arm) = (0x3f, 0x3f);
    for axis in 0..6 {
        let rate = 50e3 * (axis as f64 - 2.5);
        command.stepgen[axis].0 = StepRate::from_hz(rate, machine.clock_hz());
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

#[test]
fn a_trap_closes_the_gate_and_leaves_its_message() {
    let mut machine = Machine::armed();
    let mut command = machine.enabled_command();
    command.stepgen[0] = (
        StepRate::from_hz(100e3, machine.clock_hz()),
        Accel::UNLIMITED,
    );
    for _ in 0..5 {
        machine.exchange_and_wait(&mut command);
    }
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

// ---- the turnaround -----------------------------------------------------------------------------------------------------

#[test]
fn the_six_axis_exchange_turns_around_within_1000_clocks() {
    let mut machine = Machine::armed();
    let mut command = machine.enabled_command();
    for (n, (rate, accel)) in command.stepgen.iter_mut().take(6).enumerate() {
        *rate = StepRate::from_hz(10e3 * (n as f64 + 1.0), machine.clock_hz());
        *accel = Accel::from_steps(1e7, machine.clock_hz());
    }
    for _ in 0..100 {
        machine.exchange_and_wait(&mut command);
    }
    let turnarounds = machine.turnarounds(100);
    let longest = turnarounds
        .iter()
        .max()
        .copied()
        .expect("there were exchanges");
    assert!(
        longest <= 1000,
        "the longest of {} took {longest} clocks",
        turnarounds.len()
    );
    assert_eq!(exchange::command_words(machine.channels()), 27);
}
