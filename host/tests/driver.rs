//! The driver against a fake HAL on one side and a fake board behind real UDP on the other: the
//! behaviour of the machine in normal operation, and with faults of the network or the board.

#[path = "common/fake_board.rs"]
mod common;

use common::FakeBoard;
use common::rig::{LOCKSTEP, PERIOD_NS, Rig};
use ferrocnc::names::Scheme;
use std::time::Duration;
use wire::{FaultReason, State, map};

#[test]
fn every_name_is_lower_case_with_hyphens_and_at_most_41_characters() {
    let rig = Rig::new();
    let mut count = 0;
    for (name, _, _) in rig.hal.list() {
        let good = name
            .bytes()
            .all(|b| b.is_ascii_lowercase() || b.is_ascii_digit() || b == b'-' || b == b'.');
        assert!(good && name.len() <= 41, "{name}");
        count += 1;
    }
    assert!(count > 200, "{count} pins and parameters");
}

#[test]
fn channels_are_called_what_the_board_calls_them() {
    let rig = Rig::new();
    for name in [
        "ferrocnc.0.stepgen.x.position-cmd",
        "ferrocnc.0.encoder.spindle.index-enable",
        "ferrocnc.0.pwm.spindle.value",
        "ferrocnc.0.gpio.limit-x.in-not",
        "ferrocnc.0.gpio.drive-enable.out",
        "ferrocnc.0.gpio.spindle-reverse.invert",
        "ferrocnc.0.gpio.08.in",
    ] {
        assert!(rig.hal.list().any(|(known, _, _)| known == name), "{name}");
    }
}

#[test]
fn settings_reach_the_board_before_it_can_be_armed() {
    let rig = Rig::armed();
    let board = rig.board.look();
    // 1000 ns at 60 MHz, 5 ms, 1 kHz.
    assert_eq!(board.config[&map::CONFIG_STEPGEN], 60);
    assert_eq!(board.config[&map::CONFIG_BOARD], 300_000);
    assert_eq!(board.config[&map::CONFIG_PWM], 60_000);
}

#[test]
fn what_is_computed_for_another_drivers_names_is_there() {
    let mut rig = Rig::named(&Scheme::LitexCnc(vec!["test".to_owned()]));
    rig.hal.set("test.stepgen.00.steplen", 1000u32);
    rig.hal.set("test.stepgen.00.stepspace", 3000u32);
    rig.run(2);
    assert_eq!(rig.hal.get::<f64>("test.stepgen.00.max-frequency"), 250e3);
}

#[test]
fn a_receipt_counts_for_the_settings_it_was_sent_with_and_for_no_others() {
    let mut rig = Rig::new();
    rig.board.look().knobs.deaf_to = Some(map::CONFIG_STEPGEN);
    rig.hal.set("ferrocnc.0.stepgen.x.steplen", 2000u32);
    rig.hal.set("ferrocnc.0.pwm.spindle.pwm-freq", 20_000.0);
    rig.hal.set("ferrocnc.0.enable", true);
    rig.run(2);
    rig.hal.set("ferrocnc.0.enable-request", true);
    rig.run(60);
    {
        let board = rig.board.look();
        assert_eq!(board.config[&map::CONFIG_PWM], 3_000, "they arrived");
        assert_eq!(board.config[&map::CONFIG_STEPGEN], 60, "these did not");
    }
    assert!(!rig.enabled(), "armed with settings it does not have");
    rig.board.look().knobs.deaf_to = None;
    rig.run(60);
    assert_eq!(rig.board.look().config[&map::CONFIG_STEPGEN], 120);
    assert!(rig.enabled(), "the request is still held");
}

#[test]
fn arming_takes_enable_and_a_rising_edge_of_the_request() {
    let mut rig = Rig::new();
    rig.hal.set("ferrocnc.0.enable", true);
    rig.run(20);
    assert!(!rig.enabled());
    rig.hal.set("ferrocnc.0.enable-request", true);
    rig.run(6);
    assert!(rig.enabled());
    assert_eq!(rig.hal.get::<u32>("ferrocnc.0.state"), State::Armed as u32);
    rig.hal.set("ferrocnc.0.enable", false);
    rig.run(3);
    assert!(!rig.enabled());
    // The request is still high: that is no edge.
    rig.hal.set("ferrocnc.0.enable", true);
    rig.run(20);
    assert!(!rig.enabled());
}

#[test]
fn a_pulse_of_one_period_is_enough_to_arm() {
    let mut rig = Rig::new();
    rig.hal.set("ferrocnc.0.enable", true);
    rig.run(2);
    rig.hal.set("ferrocnc.0.enable-request", true);
    rig.run(1);
    rig.hal.set("ferrocnc.0.enable-request", false);
    rig.run(8);
    assert!(rig.enabled());
}

#[test]
fn a_move_ends_with_exactly_the_commanded_pulses() {
    let mut rig = Rig::armed();
    rig.travel(12.5, 600);
    rig.run(60);
    assert_eq!(rig.board.look().pulses(0), 10_000);
    assert_eq!(rig.hal.get::<i32>("ferrocnc.0.stepgen.x.counts"), 10_000);
    assert!((rig.position() - 12.5).abs() < 1e-6);
    assert_eq!(rig.hal.get::<u32>("ferrocnc.0.packet-error-total"), 0);
}

#[test]
fn feedback_is_where_the_board_is_when_the_next_command_arrives() {
    let mut rig = Rig::armed();
    let mut predicted = rig.position();
    let mut worst = 0.0f64;
    rig.hal.set("ferrocnc.0.stepgen.x.enable", true);
    for n in 0..400 {
        let phase = f64::from(n) / 400.0 * core::f64::consts::PI;
        let at = 10.0 * (1.0 - phase.cos());
        rig.hal.set("ferrocnc.0.stepgen.x.position-cmd", at);
        rig.driver.read(PERIOD_NS);
        // What the board sampled for the answer just read was predicted one period ago.
        let sampled: i32 = rig.hal.get("ferrocnc.0.stepgen.x.counts");
        worst = worst.max((f64::from(sampled) - predicted * 800.0).abs());
        predicted = rig.position();
        rig.driver.write(PERIOD_NS);
    }
    assert!(worst <= 0.51, "{worst} steps");
}

#[test]
fn one_lost_command_or_answer_is_bridged_and_costs_no_pulse() {
    for answer in [false, true] {
        let mut rig = Rig::armed();
        rig.travel(6.25, 300);
        rig.run(60);
        {
            let mut board = rig.board.look();
            if answer {
                board.knobs.drop_replies = 1;
            } else {
                board.knobs.drop_requests = 1;
            }
        }
        let before = rig.position();
        rig.travel(6.25, 300);
        rig.run(60);
        assert!((rig.position() - before - 6.25).abs() < 1e-6);
        assert_eq!(rig.board.look().pulses(0), 10_000, "answer lost: {answer}");
        assert_eq!(rig.hal.get::<u32>("ferrocnc.0.packet-error-total"), 1);
        assert!(rig.enabled());
    }
}

#[test]
fn late_and_repeated_answers_are_recognised_by_their_sequence_number() {
    let mut rig = Rig::armed();
    rig.board.look().knobs.duplicate_replies = true;
    rig.travel(2.0, 200);
    rig.run(60);
    assert_eq!(rig.hal.get::<u32>("ferrocnc.0.packet-error-total"), 0);
    assert_eq!(rig.board.look().pulses(0), 1600);
    rig.board.look().knobs.late_by_one = true;
    rig.hal.set("ferrocnc.0.packet-read-timeout", 2_000_000);
    rig.run(2);
    assert!(rig.hal.get::<bool>("ferrocnc.0.packet-error"));
}

#[test]
fn a_command_that_is_repeated_for_its_answer_is_executed_like_any_other() {
    let mut rig = Rig::armed();
    let before = rig.board.look().exchanges;
    for _ in 0..5 {
        let seen = rig.board.look().datagrams;
        rig.driver.read_request(PERIOD_NS);
        while rig.board.look().datagrams == seen {
            std::thread::sleep(Duration::from_micros(100));
        }
        rig.run(1);
    }
    assert_eq!(rig.board.look().exchanges, before + 10);
    assert_eq!(rig.board.look().refused, 0);
    assert_eq!(rig.hal.get::<u32>("ferrocnc.0.packet-error-total"), 0);
    assert!(rig.enabled());
}

#[test]
fn from_the_second_missing_answer_on_feedback_stands_still() {
    let mut rig = Rig::armed();
    rig.hal.set("ferrocnc.0.stepgen.x.control-type", true);
    rig.hal.set("ferrocnc.0.stepgen.x.velocity-cmd", 10.0);
    rig.hal.set("ferrocnc.0.stepgen.x.enable", true);
    rig.run(100);
    rig.board.look().knobs.drop_replies = 3;
    let mut positions = vec![rig.position()];
    for timeout in [200_000_000, 100_000, 100_000, 100_000] {
        rig.hal.set("ferrocnc.0.packet-read-timeout", timeout);
        rig.run(1);
        positions.push(rig.position());
    }
    rig.hal.set("ferrocnc.0.packet-read-timeout", 200_000_000);
    assert!(positions[1] > positions[0]);
    assert!((positions[2] - positions[1] - 0.01).abs() < 1e-6, "bridged");
    assert_eq!(positions[2], positions[3], "frozen");
    assert_eq!(positions[3], positions[4], "frozen");
    rig.run(1);
    assert!(rig.position() > positions[4] + 0.015, "and true again");
}

#[test]
fn a_pulled_cable_stops_the_machine_and_plugging_it_in_again_does_not_move_it() {
    let mut rig = Rig::armed();
    rig.travel(5.0, 200);
    rig.hal.set("ferrocnc.0.stepgen.x.control-type", true);
    rig.hal.set("ferrocnc.0.stepgen.x.velocity-cmd", 10.0);
    rig.run(50);
    rig.hal.set("ferrocnc.0.packet-read-timeout", 1_000_000);
    rig.board.look().knobs.unplugged = true;
    rig.run(10);
    assert!(!rig.enabled());
    assert!(rig.hal.get::<bool>("ferrocnc.0.io-error"));
    assert!(rig.hal.get::<bool>("ferrocnc.0.packet-error-exceeded"));
    assert_eq!(rig.reason(), u32::from(FaultReason::LinkDown.code()));
    let said = rig.hal.said();
    assert_eq!(said.len(), 1, "{said:?}");
    assert!(said[0].contains("check cable"), "{said:?}");
    assert!(
        !said[0].contains("other boards"),
        "there are none: {said:?}"
    );

    // The board lived on: its watchdog bites, it comes to rest.
    rig.board.look().advance(60_000 * 200);
    let rest = {
        let mut board = rig.board.look();
        assert!(board.bitten && !board.gate && !board.moving());
        board.knobs.unplugged = false;
        board.pulses(0)
    };
    rig.hal.set("ferrocnc.0.packet-read-timeout", 200_000_000);
    rig.hal.set("ferrocnc.0.enable-request", true);
    for _ in 0..300 {
        rig.run(1);
        std::thread::sleep(Duration::from_millis(1));
    }
    // Exchanging again, watchdog known, but not re-armed by a level.
    assert_eq!(rig.reason(), u32::from(FaultReason::Watchdog.code()));
    assert!(rig.hal.get::<bool>("ferrocnc.0.watchdog.has-bitten"));
    assert!(!rig.enabled());
    assert_eq!(rig.board.look().pulses(0), rest);
    assert!((rig.position() - rest as f64 / 800.0).abs() < 1.0 / 800.0);

    // An edge arms; LinuxCNC's command has followed the feedback meanwhile.
    rig.hal.set("ferrocnc.0.stepgen.x.control-type", false);
    let here = rig.position();
    rig.hal.set("ferrocnc.0.stepgen.x.position-cmd", here);
    rig.arm();
    assert!(rig.enabled());
    rig.run(20);
    assert_eq!(rig.board.look().pulses(0), rest);
    assert!(!rig.hal.get::<bool>("ferrocnc.0.io-error"));
}

#[test]
fn a_watchdog_bite_is_told_once_and_needs_a_new_edge() {
    let mut rig = Rig::armed();
    rig.board.look().advance(60_000 * 100);
    rig.hal.set("ferrocnc.0.packet-read-timeout", 1_000_000);
    for _ in 0..300 {
        rig.run(1);
        std::thread::sleep(Duration::from_millis(1));
    }
    let said = rig.hal.said();
    let errors = said.iter().filter(|s| s.starts_with("error"));
    let told: Vec<_> = errors.filter(|s| s.contains("watchdog")).collect();
    assert_eq!(told.len(), 1, "{said:?}");
    assert!(!rig.enabled());
    rig.hal.set("ferrocnc.0.packet-read-timeout", 200_000_000);
    rig.arm();
    assert!(rig.enabled());
}

#[test]
fn a_restarted_board_is_never_re_armed_silently_and_the_position_does_not_jump() {
    let mut rig = Rig::armed();
    rig.travel(5.0, 300);
    rig.run(60);
    let before = rig.position();
    rig.hal.set("ferrocnc.0.enable-request", true);
    rig.board.look().power_cycle();
    rig.hal.set("ferrocnc.0.packet-read-timeout", 1_000_000);
    for _ in 0..300 {
        rig.run(1);
        std::thread::sleep(Duration::from_millis(1));
    }
    rig.hal.set("ferrocnc.0.packet-read-timeout", 200_000_000);
    assert!(!rig.enabled());
    assert_eq!(rig.board.look().pulses(0), 0);
    assert!((rig.position() - before).abs() < 1e-6);
    assert_eq!(rig.hal.get::<i32>("ferrocnc.0.stepgen.x.counts"), 4000);
    assert!(rig.hal.said().iter().any(|s| s.contains("restarted")));

    rig.arm();
    assert!(rig.enabled());
    rig.travel(1.0, 200);
    rig.run(60);
    assert_eq!(rig.board.look().pulses(0), 800);
    assert!((rig.position() - before - 1.0).abs() < 1e-6);
}

#[test]
fn the_external_reset_is_named_and_holds_until_it_is_gone() {
    let mut rig = Rig::armed();
    rig.board.look().knobs.external_reset = true;
    rig.run(3);
    assert!(!rig.enabled());
    assert_eq!(rig.reason(), u32::from(FaultReason::ExternalReset.code()));
    rig.arm();
    assert!(!rig.enabled());
    rig.board.look().knobs.external_reset = false;
    rig.arm();
    assert!(rig.enabled());
}

#[test]
fn pins_behind_the_first_32_travel_with_the_exchange_and_have_all_settings() {
    let channels = wire::describe::Channels {
        stepgens: 1,
        encoders: 0,
        pwms: 0,
        inputs: 64,
        outputs: 56,
    };
    let mut rig = Rig::of(FakeBoard::of("127.0.0.1:0", channels, LOCKSTEP));
    rig.hal.set("ferrocnc.0.gpio.40.invert", true);
    rig.hal.set("ferrocnc.0.gpio.63.debounce-ns", 1_000_000u32);
    rig.hal.set("ferrocnc.0.probe-input", 63);
    rig.arm();
    assert!(rig.enabled(), "{:?}", rig.hal.said());
    rig.board.look().knobs.gpio_in = 1 << 63 | 1 << 31;
    rig.hal.set("ferrocnc.0.gpio.55.out", true);
    rig.run(3);
    for n in 20..64 {
        let level = rig.hal.get::<bool>(&format!("ferrocnc.0.gpio.{n:02}.in"));
        assert_eq!(level, n == 31 || n == 63, "input {n}");
    }
    let board = rig.board.look();
    assert_eq!(board.command.gpio_out, 1 << 55);
    let setting = |which: map::BoardConfig| board.config[&(map::CONFIG_BOARD + 4 * which as u32)];
    assert_eq!(setting(map::BoardConfig::GpioInvertHigh), 1 << 8);
    assert_eq!(setting(map::BoardConfig::GpioInvert), 0);
    assert_eq!(
        setting(map::BoardConfig::Probe),
        63 | map::PROBE_ENABLE,
        "any input can be the probe"
    );
    assert_eq!(board.config[&(map::CONFIG_DEBOUNCE + 4 * 63)], 1875);
}

#[test]
fn inputs_outputs_and_pwm_travel_with_the_exchange() {
    let mut rig = Rig::armed();
    rig.board.look().knobs.gpio_in = 1 << 1 | 1 << 10;
    rig.hal.set("ferrocnc.0.gpio.spindle-reverse.out", true);
    rig.hal.set("ferrocnc.0.pwm.spindle.value", 0.5);
    rig.hal.set("ferrocnc.0.pwm.spindle.enable", true);
    rig.run(2);
    assert!(rig.hal.get::<bool>("ferrocnc.0.gpio.limit-y.in"));
    assert!(!rig.hal.get::<bool>("ferrocnc.0.gpio.limit-y.in-not"));
    assert!(rig.hal.get::<bool>("ferrocnc.0.gpio.10.in"));
    let board = rig.board.look();
    assert_eq!(board.command.gpio_out, 1 << 2);
    assert_eq!(
        board.command.pwm[0],
        wire::exchange::PWM_ENABLE | 30_000 << 8
    );
}

#[test]
fn illegal_transitions_and_a_limited_rate_are_those_of_their_channel() {
    let mut rig = Rig::armed();
    {
        let mut board = rig.board.look();
        (board.knobs.illegal, board.knobs.rate_limited) = (1 << 1, 1 << 1);
    }
    rig.run(3);
    let errors = |name: &str| {
        rig.hal
            .get::<u32>(&format!("ferrocnc.0.encoder.{name}.quad-errors"))
    };
    assert_eq!([errors("x") > 0, errors("y") > 0], [false, true]);
    let limited = |name: &str| {
        rig.hal
            .get::<bool>(&format!("ferrocnc.0.stepgen.{name}.rate-limited"))
    };
    assert_eq!(["x", "y"].map(limited), [false, true]);
}

#[test]
fn settings_change_while_disarmed_only_but_a_pwm_period_at_any_time() {
    let mut rig = Rig::armed();
    rig.hal.set("ferrocnc.0.stepgen.x.steplen", 2000u32);
    rig.hal.set("ferrocnc.0.pwm.spindle.pwm-freq", 20_000.0);
    rig.run(30);
    {
        let board = rig.board.look();
        assert_eq!(board.config[&map::CONFIG_STEPGEN], 60);
        assert_eq!(board.config[&map::CONFIG_PWM], 3_000);
        assert_eq!(board.refused, 0);
    }
    rig.hal.set("ferrocnc.0.enable", false);
    rig.run(30);
    assert_eq!(rig.board.look().config[&map::CONFIG_STEPGEN], 120);
}

#[test]
fn the_index_restarts_the_encoder_and_clears_its_pin() {
    let mut rig = Rig::armed();
    rig.board.look().knobs.index_at = Some(800);
    rig.hal.set("ferrocnc.0.encoder.x.index-enable", true);
    rig.travel(2.0, 200);
    rig.run(60);
    assert!(!rig.hal.get::<bool>("ferrocnc.0.encoder.x.index-enable"));
    assert_eq!(rig.hal.get::<i32>("ferrocnc.0.encoder.x.count"), 800);
    assert_eq!(rig.hal.get::<i32>("ferrocnc.0.encoder.x.rawcounts"), 1600);
}

#[test]
fn a_stepgens_index_is_where_its_position_is_zero_from_then_on() {
    let mut rig = Rig::armed();
    rig.board.look().knobs.index_at = Some(1000);
    rig.hal.set("ferrocnc.0.stepgen.x.index-enable", true);
    rig.run(4);
    rig.travel(1.0, 100);
    assert!(rig.hal.get::<bool>("ferrocnc.0.stepgen.x.index-enable"));
    // As LinuxCNC's homing does it: on at one speed until the index came, then the command follows.
    let mut command: f64 = rig.hal.get("ferrocnc.0.stepgen.x.position-cmd");
    let mut before = rig.position();
    for _ in 0..300 {
        rig.run(1);
        let found = !rig.hal.get::<bool>("ferrocnc.0.stepgen.x.index-enable");
        let fb = rig.position();
        if found && fb < before - 0.5 {
            // The jump of the feedback is the jump of the command.
            command += fb - before - 0.005;
            assert_eq!(
                rig.hal.get::<i32>("ferrocnc.0.stepgen.x.count-latched"),
                1000
            );
        } else if !found {
            command += 0.005;
        }
        before = fb;
        rig.hal.set("ferrocnc.0.stepgen.x.position-cmd", command);
    }
    rig.hal.set("ferrocnc.0.stepgen.x.position-cmd", 0.25);
    rig.run(300);
    // 0.25 units beyond the index, from any start.
    assert_eq!(rig.board.look().pulses(0), 1000 + 200);
    assert_eq!(rig.hal.get::<i32>("ferrocnc.0.stepgen.x.counts"), 200);
    assert!((rig.position() - 0.25).abs() < 1e-6);
}

#[test]
fn an_index_homes_to_the_same_place_over_any_lossy_wire() {
    for seed in 1..=6u64 {
        let mut random = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15);
        let mut next = |limit: u64| {
            random ^= random >> 12;
            random ^= random << 25;
            random ^= random >> 27;
            (random.wrapping_mul(0x2545_f491_4f6c_dd1d) >> 33) % limit
        };
        let mut rig = Rig::armed();
        rig.hal.set("ferrocnc.0.packet-error-limit", 1000);
        rig.hal.set("ferrocnc.0.stepgen.x.control-type", true);
        rig.hal.set("ferrocnc.0.stepgen.x.velocity-cmd", 10.0);
        rig.board.look().knobs.index_every = Some(1000);
        // The encoder counts from somewhere else than the stepgen.
        rig.board.look().knobs.encoder_lag = 137;
        rig.run(3);
        rig.hal.set("ferrocnc.0.stepgen.x.enable", true);
        for home in 0..3 {
            rig.hal.set("ferrocnc.0.encoder.x.index-enable", true);
            rig.hal.set("ferrocnc.0.stepgen.x.index-enable", true);
            for _ in 0..600 {
                let lose = next(5) == 0;
                rig.hal.set(
                    "ferrocnc.0.packet-read-timeout",
                    if lose { 100_000 } else { 200_000_000 },
                );
                if lose {
                    let mut board = rig.board.look();
                    if next(2) == 0 {
                        board.knobs.drop_requests = 1;
                    } else {
                        board.knobs.drop_replies = 1;
                    }
                }
                rig.run(1);
                // What was dropped does not come: no need to wait for it in vain.
                rig.hal.set("ferrocnc.0.packet-read-timeout", 100_000);
                rig.driver.read(PERIOD_NS);
                let (a, b) = (
                    rig.hal.get::<bool>("ferrocnc.0.encoder.x.index-enable"),
                    rig.hal.get::<bool>("ferrocnc.0.stepgen.x.index-enable"),
                );
                if !a && !b {
                    break;
                }
            }
            rig.hal.set("ferrocnc.0.packet-read-timeout", 200_000_000);
            rig.run(3);
            for pin in ["encoder.x.index-enable", "stepgen.x.index-enable"] {
                let waiting: bool = rig.hal.get(&format!("ferrocnc.0.{pin}"));
                assert!(!waiting, "seed {seed}, {home}: {pin}");
            }
            let board = rig.board.look();
            let counts = i64::from(rig.hal.get::<i32>("ferrocnc.0.stepgen.x.counts"));
            let count = i64::from(rig.hal.get::<i32>("ferrocnc.0.encoder.x.count"));
            // Zero is at an index, and not at one of long ago. The answer is one period old.
            let (pulses, moved) = (board.pulses(0), 8 + 1);
            let off = (pulses - counts).rem_euclid(1000);
            assert!(off <= moved, "seed {seed}, {home}: stepgen {off} off");
            let off = (pulses - 137 - count).rem_euclid(1000);
            assert!(off <= moved, "seed {seed}, {home}: encoder {off} off");
            assert!((0..2000).contains(&counts), "seed {seed}: {counts}");
        }
    }
}

#[test]
fn the_probe_latches_where_it_tripped() {
    let mut rig = Rig::armed();
    rig.board.look().knobs.probe_at = Some(1234);
    rig.board.look().knobs.encoder_lag = 34;
    rig.hal.set("ferrocnc.0.stepgen.x.probe-enable", true);
    rig.hal.set("ferrocnc.0.encoder.x.probe-enable", true);
    rig.run(4);
    rig.travel(2.0, 200);
    rig.run(20);
    assert!(!rig.hal.get::<bool>("ferrocnc.0.stepgen.x.probe-enable"));
    assert!(!rig.hal.get::<bool>("ferrocnc.0.encoder.x.probe-enable"));
    let latched: f64 = rig.hal.get("ferrocnc.0.stepgen.x.position-latched");
    assert!((latched - 1234.0 / 800.0).abs() < 1e-9, "{latched}");
    assert_eq!(
        rig.hal.get::<i32>("ferrocnc.0.encoder.x.count-latched"),
        1200
    );
    // It moved no origin.
    assert_eq!(rig.hal.get::<i32>("ferrocnc.0.stepgen.x.counts"), 1600);
}

#[test]
fn an_estop_input_stops_is_named_and_holds_until_armed_again() {
    let mut rig = Rig::armed();
    rig.board.look().knobs.estop = 1 << 11;
    rig.run(3);
    assert!(!rig.enabled());
    assert_eq!(rig.reason(), u32::from(FaultReason::EStop.code()));
    assert!(rig.hal.get::<bool>("ferrocnc.0.estop"));
    assert!(rig.hal.get::<bool>("ferrocnc.0.gpio.estop.estop"));
    assert!(rig.hal.said().iter().any(|s| s.contains("e-stop")));
    rig.board.look().knobs.estop = 0;
    rig.run(3);
    assert!(rig.hal.get::<bool>("ferrocnc.0.estop"), "latched");
    rig.arm();
    assert!(rig.enabled());
    assert!(!rig.hal.get::<bool>("ferrocnc.0.estop"));
}

#[test]
fn probe_debounce_and_types_reach_the_board() {
    let mut rig = Rig::new();
    rig.hal.set("ferrocnc.0.probe-input", 6);
    rig.hal.set("ferrocnc.0.probe-invert", true);
    rig.hal
        .set("ferrocnc.0.gpio.limit-z.debounce-ns", 1_000_000u32);
    rig.hal.set("ferrocnc.0.stepgen.y.step-type", 2u32);
    rig.hal.set("ferrocnc.0.encoder.05.index-mask-invert", true);
    rig.hal.set("ferrocnc.0.pwm.coolant.output-type", 2u32);
    rig.run(60);
    let board = rig.board.look();
    let stride = map::CONFIG_STRIDE;
    for (address, value) in [
        (
            map::CONFIG_BOARD + 16,
            6 | map::PROBE_ENABLE | map::PROBE_INVERT,
        ),
        (map::CONFIG_DEBOUNCE + 8, 1875),
        (
            map::CONFIG_STEPGEN + stride + 20,
            2 << map::STEPGEN_TYPE_SHIFT,
        ),
        (map::CONFIG_ENCODER + 5 * stride, map::ENCODER_MASK_INVERT),
        (map::CONFIG_PWM + stride + 4, 1 << map::PWM_TYPE_SHIFT),
    ] {
        assert_eq!(board.config[&address], value, "{address:#x}");
    }
}

#[test]
fn why_the_firmware_started_last_is_told_at_load_and_after_a_restart() {
    let mut rig = Rig::armed();
    let reason = |rig: &Rig| rig.hal.get::<u32>("ferrocnc.0.last-reset-reason");
    assert_eq!(reason(&rig), 0);
    rig.board.look().reboot();
    rig.hal.set("ferrocnc.0.packet-read-timeout", 1_000_000);
    for _ in 0..300 {
        rig.run(1);
        std::thread::sleep(Duration::from_millis(1));
    }
    assert_eq!(reason(&rig), u32::from(wire::ResetReason::Panic.code()));
}

#[test]
fn the_margin_is_what_the_watchdog_had_left() {
    let mut rig = Rig::armed();
    rig.run(10);
    // 5 ms less one period.
    assert_eq!(
        rig.hal.get::<u32>("ferrocnc.0.watchdog.margin-ns"),
        4_000_000
    );
    assert_eq!(
        rig.hal.get::<u32>("ferrocnc.0.watchdog.margin-ns-min"),
        4_000_000
    );
    assert_eq!(rig.hal.get::<f64>("ferrocnc.0.wallclock.interval"), 0.001);
}

#[test]
fn unloading_gives_the_session_back() {
    let mut rig = Rig::armed();
    rig.driver.release();
    for _ in 0..100 {
        if rig.board.look().owner.is_none() {
            return;
        }
        std::thread::sleep(Duration::from_millis(2));
    }
    panic!("still owned");
}

#[test]
fn a_board_that_another_host_took_meanwhile_is_told_once_with_its_owner() {
    let mut rig = Rig::armed();
    {
        let mut board = rig.board.look();
        board.advance(60_000 * 100);
        board.knobs.foreign_owner = Some("192.168.2.7:4711".parse().unwrap());
    }
    rig.hal.set("ferrocnc.0.packet-read-timeout", 1_000_000);
    for _ in 0..400 {
        rig.run(1);
        std::thread::sleep(Duration::from_millis(1));
    }
    let said = rig.hal.said();
    let told: Vec<_> = said
        .iter()
        .filter(|s| s.contains("192.168.2.7:4711"))
        .collect();
    assert_eq!(told.len(), 1, "{said:?}");
    assert!(!rig.enabled());
}

#[test]
fn the_link_is_shown_as_the_board_sees_it_and_is_down_when_the_board_is_silent() {
    let mut rig = Rig::new();
    let look = |rig: &Rig| {
        (
            rig.hal.get::<bool>("ferrocnc.0.link.up"),
            rig.hal.get::<i32>("ferrocnc.0.link.speed"),
            rig.hal.get::<u32>("ferrocnc.0.link.errors"),
        )
    };
    assert_eq!(look(&rig), (true, 1000, 0));
    rig.board.look().knobs.link = Some((wire::LinkSpeed::M100, 3));
    rig.run(3);
    assert_eq!(look(&rig), (true, 100, 3));
    rig.hal.set("ferrocnc.0.packet-read-timeout", 100_000);
    rig.board.look().knobs.unplugged = true;
    rig.run(10);
    assert_eq!(look(&rig), (false, 0, 3));
}

#[test]
fn the_ways_of_the_exchanges_are_asked_for_once_a_second_and_cost_no_exchange() {
    let mut rig = Rig::armed();
    let reason = wire::LongWay::Frame as u32;
    let shown = |rig: &Rig| {
        ["fast-way", "long-way", "long-way-reason"]
            .map(|name| rig.hal.get::<u32>(&format!("ferrocnc.0.exchange.{name}")))
    };
    rig.board.look().knobs.ways = [100, 7, reason];
    let before = rig.board.look().datagrams;
    rig.run(2_000);
    let board = rig.board.look();
    assert!(
        (2_001..=2_002).contains(&(board.datagrams - before)),
        "{} datagrams in 2000 periods",
        board.datagrams - before
    );
    drop(board);
    assert_eq!(shown(&rig), [100, 7, reason]);
    assert_eq!(rig.hal.get::<u32>("ferrocnc.0.packet-error-total"), 0);
    assert!(rig.enabled());
    // They are those of the last answer.
    rig.board.look().knobs.ways = [u32::MAX, 8, 2];
    rig.run(1_001);
    assert_eq!(shown(&rig), [u32::MAX, 8, 2]);
}

#[test]
fn services_that_fail_while_armed_are_shown_and_the_machine_stays_armed() {
    use wire::describe::JobsState;
    let mut rig = Rig::new();
    let services = |rig: &Rig| rig.hal.get::<u32>("ferrocnc.0.services");
    rig.arm();
    for state in JobsState::ALL {
        rig.board.look().knobs.services = Some(*state);
        rig.run(3);
        assert_eq!(services(&rig), state.code(), "{state:?}");
        assert!(rig.enabled(), "{state:?}");
        assert_eq!(rig.hal.get::<u32>("ferrocnc.0.fault-reason"), 0);
    }
}

#[test]
fn step_and_output_types_are_the_board_files_until_hal_says_otherwise() {
    let rig = Rig::new();
    let stepgen = |name: &str| {
        rig.hal
            .get::<u32>(&format!("ferrocnc.0.stepgen.{name}.step-type"))
    };
    assert_eq!(["x", "z", "a"].map(stepgen), [0, 2, 0]);
    let pwm = |name: &str| {
        rig.hal
            .get::<u32>(&format!("ferrocnc.0.pwm.{name}.output-type"))
    };
    assert_eq!(["spindle", "aux-0"].map(pwm), [1, 3]);
}
