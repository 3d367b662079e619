//! Faults of everyday use: a late thread, a loose plug, a parameter set by hand, a board that was
//! off for an hour.

#[path = "common/fake_board.rs"]
mod common;

use common::rig::{PERIOD_NS, Rig};
use ferrocnc::clock::Timebase;
use ferrocnc::group::Group;
use std::sync::Arc;
use std::time::Duration;
use wire::{FaultReason, State, map};

/// Clocks of a servo period.
const PERIOD: u64 = 60_000;

/// For datagrams that are lost on purpose.
const HASTY: i32 = 100_000;
const PATIENT: i32 = 200_000_000;

fn timeout(rig: &Rig, nanos: i32) {
    rig.hal.set("ferrocnc.0.packet-read-timeout", nanos);
}

/// Errors told since the last look, without the board's name.
fn errors(rig: &Rig) -> Vec<String> {
    let said = rig.hal.said();
    let errors = said.iter().filter_map(|text| text.strip_prefix("error: "));
    errors
        .map(|text| {
            text.split_once("): ")
                .map_or(text, |(_, text)| text)
                .to_owned()
        })
        .collect()
}

/// An armed rig; the test sets the computer's time.
fn with_time() -> (Rig, Arc<Timebase>) {
    let mut rig = Rig::armed();
    let time = Timebase::scripted();
    rig.driver.join(&time, &Group::new(), 1);
    rig.run(3);
    (rig, time)
}

/// A period later.
fn pass(time: &Timebase, nanos: i64) {
    time.set(time.now() + nanos);
}

/// Until the board has been asked again and has answered.
fn come_back(rig: &mut Rig) {
    for _ in 0..300 {
        timeout(rig, 1_000_000);
        rig.run(1);
        std::thread::sleep(Duration::from_millis(1));
    }
    timeout(rig, PATIENT);
    rig.run(2);
}

#[test]
fn a_board_that_answers_nothing_does_not_refuse_its_settings() {
    let mut rig = Rig::new();
    rig.run(60);
    // Not given up for its silence, which is another message.
    rig.hal.set("ferrocnc.0.packet-error-limit", 1_000_000);
    timeout(&rig, HASTY);
    rig.hal.set("ferrocnc.0.stepgen.x.steplen", 7_000u32);
    rig.board.look().knobs.unplugged = true;
    rig.run(200);
    assert_eq!(errors(&rig), [""; 0]);
    rig.board.look().knobs.unplugged = false;
    timeout(&rig, PATIENT);
    rig.run(60);
    assert_eq!(errors(&rig), [""; 0]);
    let steplen = rig.board.look().config.get(&map::CONFIG_STEPGEN).copied();
    assert_eq!(steplen, Some(420), "7 us are 420 clocks");
}

#[test]
fn a_thread_that_comes_late_costs_no_pulse() {
    for late in [1, 2, 3] {
        let mut rig = Rig::armed();
        rig.travel(6.25, 300);
        for _ in 0..3 {
            // Late, and then twice in a hurry to catch up.
            rig.board.look().advance(PERIOD * late);
            rig.travel(1.0, 150);
        }
        rig.run(60);
        assert!(rig.enabled(), "{late}");
        assert_eq!(rig.board.look().pulses(0), 7400, "{late} periods late");
        assert_eq!(errors(&rig), [""; 0]);
    }
}

#[test]
fn a_thread_held_up_under_way_is_forgiven_until_the_watchdog_bites_and_no_pulse_is_lost() {
    let mut rig = Rig::armed();
    let start = rig.position();
    rig.hal.set("ferrocnc.0.stepgen.x.position-cmd", start);
    rig.hal.set("ferrocnc.0.stepgen.x.enable", true);
    rig.run(2);
    for n in 1..=400 {
        let phase = f64::from(n) / 400.0 * core::f64::consts::PI;
        let at = start + 5.0 * (1.0 - phase.cos());
        rig.hal.set("ferrocnc.0.stepgen.x.position-cmd", at);
        rig.run(1);
        if n % 50 == 0 {
            // 3 ms without a command, of a timeout of 5 ms; then the thread runs two periods at
            // once.
            rig.board.look().advance(3 * PERIOD);
        }
        // 39 units/s at most: three periods of that, and what the loop makes of it.
        assert!((rig.position() - at).abs() < 0.25, "period {n}");
    }
    rig.run(100);
    assert!(rig.enabled());
    assert_eq!(rig.board.look().pulses(0), 8000);
}

#[test]
fn a_thread_later_than_the_watchdog_waits_is_told_as_that_and_not_as_a_cable() {
    let (mut rig, time) = with_time();
    // Long enough to know that the board's time is this computer's.
    for _ in 0..1200 {
        pass(&time, PERIOD_NS);
        rig.run(1);
    }
    rig.board.look().advance(PERIOD * 53);
    pass(&time, 54 * PERIOD_NS);
    timeout(&rig, HASTY);
    for _ in 0..8 {
        rig.run(1);
        pass(&time, PERIOD_NS);
    }
    assert!(!rig.enabled());
    assert_eq!(rig.reason(), u32::from(FaultReason::Watchdog.code()));
    assert!(rig.hal.get::<bool>("ferrocnc.0.io-error"));
    come_back(&mut rig);
    assert!(rig.hal.get::<bool>("ferrocnc.0.watchdog.has-bitten"));
    let told = errors(&rig);
    assert_eq!(told.len(), 1, "{told:?}");
    assert!(
        told[0].contains("came 54.0 ms late, the watchdog waits 5.0 ms"),
        "{told:?}"
    );
}

#[test]
fn a_repeated_command_does_not_wait_for_a_time_that_is_over() {
    let (mut rig, time) = with_time();
    rig.hal.set("ferrocnc.0.apply-delay-ns", 250_000u32);
    // Long enough to know how its clock runs.
    for _ in 0..1200 {
        pass(&time, PERIOD_NS);
        rig.run(1);
    }
    let (seen, waits) = {
        let board = rig.board.look();
        (board.datagrams, board.command.apply_at)
    };
    assert!(waits.is_some(), "a command has a time");
    rig.driver.read_request(PERIOD_NS);
    while rig.board.look().datagrams == seen {
        std::thread::sleep(Duration::from_micros(100));
    }
    assert_eq!(rig.board.look().command.apply_at, None);
}

#[test]
fn read_twice_is_read_once_and_write_twice_is_told_and_ignored() {
    let mut rig = Rig::armed();
    rig.travel(5.0, 200);
    let seen = rig.board.look().exchanges;
    rig.driver.read(PERIOD_NS);
    let before = rig.position();
    rig.driver.read(PERIOD_NS);
    assert_eq!(rig.position(), before);
    for _ in 0..3 {
        rig.driver.write(PERIOD_NS);
    }
    for _ in 0..3 {
        rig.run(1);
    }
    assert_eq!(rig.board.look().exchanges, seen + 4);
    assert_eq!(rig.hal.get::<u32>("ferrocnc.0.packet-error-total"), 0);
    let told = errors(&rig);
    assert_eq!(told.len(), 1, "{told:?}");
    assert!(told[0].contains("addf ferrocnc.0.read before"), "{told:?}");
}

#[test]
fn a_plug_that_is_half_out_is_one_event() {
    let mut rig = Rig::armed();
    for _ in 0..6 {
        rig.board.look().knobs.unplugged = true;
        timeout(&rig, HASTY);
        rig.run(10);
        rig.board.look().advance(PERIOD * 60);
        rig.board.look().knobs.unplugged = false;
        come_back(&mut rig);
    }
    let told = errors(&rig);
    assert_eq!(told.len(), 1, "{told:?}");
    assert!(told[0].contains("check cable"), "{told:?}");
    // Armed again it is a new event.
    rig.arm();
    assert!(rig.enabled());
    rig.board.look().knobs.unplugged = true;
    timeout(&rig, HASTY);
    rig.run(10);
    assert_eq!(errors(&rig).len(), 1);
}

#[test]
fn an_io_error_cleared_by_hand_asks_the_board_at_once_and_comes_back_if_it_is_silent() {
    let mut rig = Rig::armed();
    let io_error = |rig: &Rig| rig.hal.get::<bool>("ferrocnc.0.io-error");
    rig.board.look().knobs.unplugged = true;
    timeout(&rig, HASTY);
    rig.run(10);
    assert!(io_error(&rig));
    rig.hal.set("ferrocnc.0.io-error", false);
    rig.run(1);
    assert!(!io_error(&rig));
    // Asked every 100 periods.
    rig.run(101);
    assert!(io_error(&rig), "it is silent still");

    rig.board.look().advance(PERIOD * 100);
    rig.board.look().knobs.unplugged = false;
    let exchanges = rig.board.look().exchanges;
    rig.hal.set("ferrocnc.0.io-error", false);
    timeout(&rig, PATIENT);
    for _ in 0..8 {
        rig.run(1);
        std::thread::sleep(Duration::from_millis(2));
    }
    assert!(rig.board.look().exchanges > exchanges, "asked at once");
    assert!(!io_error(&rig));
    assert!(!rig.hal.get::<bool>("ferrocnc.0.packet-error-exceeded"));
    assert_eq!(rig.hal.get::<i32>("ferrocnc.0.packet-error-level"), 0);
    assert!(!rig.enabled(), "clearing arms nothing");
    assert_eq!(errors(&rig).len(), 1);
}

#[test]
fn an_io_error_set_by_hand_stops_the_machine_and_arming_clears_it() {
    let mut rig = Rig::armed();
    rig.hal.set("ferrocnc.0.stepgen.x.control-type", true);
    rig.hal.set("ferrocnc.0.stepgen.x.velocity-cmd", 10.0);
    rig.hal.set("ferrocnc.0.stepgen.x.enable", true);
    rig.run(50);
    rig.hal.set("ferrocnc.0.io-error", true);
    rig.run(1);
    assert!(!rig.enabled());
    rig.run(60);
    assert!(!rig.enabled());
    assert!(!rig.board.look().gate && !rig.board.look().moving());
    assert!(rig.hal.get::<bool>("ferrocnc.0.io-error"));
    rig.hal.set("ferrocnc.0.stepgen.x.velocity-cmd", 0.0);
    rig.arm();
    assert!(rig.enabled());
    assert!(!rig.hal.get::<bool>("ferrocnc.0.io-error"));
}

#[test]
fn a_machine_that_still_comes_to_rest_is_not_enabled_any_more() {
    let mut rig = Rig::armed();
    rig.hal.set("ferrocnc.0.stepgen.x.control-type", true);
    rig.hal.set("ferrocnc.0.stepgen.x.velocity-cmd", 10.0);
    rig.hal.set("ferrocnc.0.stepgen.x.enable", true);
    rig.run(50);
    rig.hal.set("ferrocnc.0.enable", false);
    // 10 units/s at 1000 units/s^2 are 10 ms.
    rig.run(3);
    {
        let board = rig.board.look();
        assert_eq!((board.state, board.gate), (State::Stopping, true));
    }
    assert!(!rig.enabled());
}

#[test]
fn a_bucket_that_is_told_not_to_fill_fills_and_the_level_stays_within_its_limit() {
    let mut rig = Rig::armed();
    rig.hal.set("ferrocnc.0.packet-error-increment", 0);
    rig.board.look().knobs.unplugged = true;
    timeout(&rig, HASTY);
    for n in 1..=9 {
        rig.run(1);
        assert_eq!(rig.hal.get::<i32>("ferrocnc.0.packet-error-level"), n - 1);
    }
    assert!(!rig.hal.get::<bool>("ferrocnc.0.packet-error-exceeded"));
    rig.run(2);
    assert_eq!(rig.hal.get::<i32>("ferrocnc.0.packet-error-level"), 10);
    assert!(rig.hal.get::<bool>("ferrocnc.0.packet-error-exceeded"));
    assert!(!rig.enabled());
}

#[test]
fn of_two_answers_one_that_is_missing_fills_the_bucket() {
    let mut rig = Rig::armed();
    let level = |rig: &Rig| rig.hal.get::<i32>("ferrocnc.0.packet-error-level");
    for n in 1..=4 {
        // The answer to what `write` asked comes, the one to `read-request` does not.
        rig.board.look().knobs.drop_requests = 1;
        rig.driver.read_request(PERIOD_NS);
        std::thread::sleep(Duration::from_millis(3));
        timeout(&rig, HASTY);
        rig.run(1);
        assert!(rig.hal.get::<bool>("ferrocnc.0.packet-error"));
        assert_eq!(level(&rig), 2 * n);
    }
    assert!(rig.enabled());
    timeout(&rig, PATIENT);
    rig.run(8);
    assert_eq!(level(&rig), 0);
    assert_eq!(rig.hal.get::<u32>("ferrocnc.0.packet-error-total"), 4);
}

#[test]
fn a_board_off_for_longer_than_it_had_been_on_moves_no_position() {
    let (mut rig, time) = with_time();
    rig.travel(5.0, 300);
    rig.run(60);
    let before = rig.position();
    assert!((before - 5.0).abs() < 1e-6);
    rig.board.look().knobs.unplugged = true;
    timeout(&rig, HASTY);
    rig.run(10);
    {
        let mut board = rig.board.look();
        board.power_cycle();
        // Its clock is beyond where it was: that it began again cannot be seen there.
        board.advance(60_000_000 * 600);
        board.knobs.unplugged = false;
    }
    pass(&time, 700_000_000_000);
    come_back(&mut rig);
    assert_eq!(rig.board.look().pulses(0), 0);
    assert!((rig.position() - before).abs() < 1e-6, "{}", rig.position());
}

#[test]
fn a_crystal_that_runs_fast_does_not_make_a_new_fabric_an_old_one() {
    let (mut rig, time) = with_time();
    rig.travel(5.0, 300);
    rig.run(60);
    let before = rig.position();
    rig.board.look().knobs.unplugged = true;
    timeout(&rig, HASTY);
    rig.run(10);
    {
        let mut board = rig.board.look();
        board.power_cycle();
        // On again at once, and 0.05 % fast since: by its own clock it is older than the silence.
        board.advance(60_000_000 / 1000 * 700_350);
        board.knobs.unplugged = false;
    }
    pass(&time, 700_000_000_000);
    come_back(&mut rig);
    assert!((rig.position() - before).abs() < 1e-6, "{}", rig.position());
}

#[test]
fn a_board_that_starts_with_the_same_boot_id_is_known_by_its_clock() {
    let (mut rig, time) = with_time();
    for off in [1, 600] {
        rig.travel(5.0, 300);
        // Long enough to know how its clock runs.
        for _ in 0..1200 {
            pass(&time, PERIOD_NS);
            rig.run(1);
        }
        let before = rig.position();
        rig.board.look().knobs.unplugged = true;
        timeout(&rig, HASTY);
        rig.run(10);
        {
            let mut board = rig.board.look();
            board.power_cycle();
            board.boot_id = 1;
            board.advance(60_000_000 * off / 2);
            board.knobs.unplugged = false;
        }
        pass(&time, 1_000_000_000 * off as i64);
        rig.hal.said();
        come_back(&mut rig);
        assert_eq!(rig.board.look().pulses(0), 0, "{off} s");
        let now = rig.position();
        assert!((now - before).abs() < 1e-6, "off for {off} s: {now}");
        assert!(
            !rig.hal.get::<bool>("ferrocnc.0.position-trusted"),
            "{off}: {:?}",
            rig.hal.said()
        );
        let told = errors(&rig);
        assert_eq!(told.len(), 1, "{told:?}");
        assert!(
            told[0].contains("has restarted (reason: power-up)"),
            "{told:?}"
        );
        rig.arm();
        assert!(rig.enabled());
    }
}

#[test]
fn a_firmware_that_starts_again_on_a_fabric_that_goes_on_moves_no_position_either() {
    let (mut rig, time) = with_time();
    rig.travel(5.0, 300);
    rig.run(60);
    let before = rig.position();
    rig.board.look().reboot();
    // Even if it has lost its record of the starts before.
    rig.board.look().boot_id += 1 << 16;
    rig.board.look().advance(PERIOD * 100);
    pass(&time, 100 * PERIOD_NS);
    timeout(&rig, HASTY);
    rig.run(10);
    come_back(&mut rig);
    assert_eq!(rig.board.look().pulses(0), 4000);
    assert!((rig.position() - before).abs() < 1e-6, "{}", rig.position());
}

#[test]
fn a_restarted_board_says_why_once_and_its_position_is_not_trusted_until_it_is_armed() {
    let mut rig = Rig::armed();
    let trusted = |rig: &Rig| rig.hal.get::<bool>("ferrocnc.0.position-trusted");
    assert!(trusted(&rig));
    rig.board.look().reboot();
    timeout(&rig, HASTY);
    rig.run(10);
    come_back(&mut rig);
    assert!(!trusted(&rig) && !rig.enabled());
    let told = errors(&rig);
    assert_eq!(told.len(), 2, "{told:?}");
    assert!(told[0].contains("check cable and power"), "{told:?}");
    assert!(
        told[1].contains("restarted (reason: firmware panic)"),
        "{told:?}"
    );
    rig.arm();
    assert!(rig.enabled() && trusted(&rig));
}

#[test]
fn a_loop_outside_does_not_run_away_with_frozen_feedback() {
    let mut rig = Rig::armed();
    let command = |rig: &Rig| rig.board.look().command.stepgen[0].0.to_hz(60e6);
    rig.hal.set("ferrocnc.0.stepgen.x.control-type", true);
    rig.hal.set("ferrocnc.0.stepgen.x.velocity-cmd", 10.0);
    rig.hal.set("ferrocnc.0.stepgen.x.enable", true);
    rig.run(100);
    rig.board.look().knobs.drop_replies = 4;
    timeout(&rig, HASTY);
    // The last answer that comes, and the one that is bridged.
    rig.run(2);
    // The loop sees the axis stand still and raises its command; the axis may brake, but not
    // accelerate again.
    for (asked, given) in [(12.0, 8000.0), (5.0, 4000.0), (-5.0, 0.0)] {
        rig.hal.set("ferrocnc.0.stepgen.x.velocity-cmd", asked);
        rig.run(1);
        let sent = command(&rig);
        assert!((sent - given).abs() < 1.0, "{asked}: {sent} steps/s");
    }
    timeout(&rig, PATIENT);
    rig.run(1);
    assert!((command(&rig) + 4000.0).abs() < 1.0, "known again");
    assert!(rig.enabled());
}
