//! The driver against a fake HAL on one side and a fake board behind real UDP on the other: what the
//! machine does when everything is well, and what it does when the network or the board is not.

mod common;

use common::rig::{PERIOD_NS, Rig};
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
    let told: Vec<_> = said.iter().filter(|s| s.contains("watchdog")).collect();
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
fn a_board_somebody_else_has_taken_meanwhile_is_told_once_with_who() {
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
