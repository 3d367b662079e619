//! The pins `exchange.*` and `fault-code` of a driver, against a fake board behind real UDP.

#[path = "common/fake_board.rs"]
mod common;

use common::rig::Rig;
use std::time::Duration;

fn exchange(rig: &Rig, name: &str) -> u32 {
    rig.hal.get(&format!("ferrocnc.0.exchange.{name}"))
}

fn fault(rig: &Rig) -> u32 {
    rig.hal.get("ferrocnc.0.fault-code")
}

#[test]
fn exchanges_take_what_the_board_takes_until_a_reset_begins_anew() {
    let mut rig = Rig::new();
    let delay = Duration::from_millis(2);
    rig.board.look().knobs.delay = delay;
    rig.hal.set("ferrocnc.0.exchange.reset", true);
    // The answer to the last command of before may have been a fast one.
    rig.run(2);
    rig.hal.set("ferrocnc.0.exchange.reset", false);
    rig.run(1);
    rig.hal.set("ferrocnc.0.exchange.reset", true);
    rig.run(40);
    let [p50, p99, max] = ["p50", "p99", "max"].map(|it| exchange(&rig, &format!("time-ns-{it}")));
    assert!(u128::from(p50) >= delay.as_nanos(), "{p50} ns");
    assert!(p50 <= p99 && p99 <= max, "{p50} {p99} {max} ns");
    rig.hal.set("ferrocnc.0.exchange.reset", false);
    rig.run(1);
    rig.hal.set("ferrocnc.0.exchange.reset", true);
    rig.run(1);
    assert_eq!(exchange(&rig, "time-ns-max"), 0);
}

#[test]
fn every_missing_answer_is_late_or_lost_in_the_end() {
    let mut rig = Rig::new();
    rig.board.look().knobs.late_by_one = true;
    rig.run(3);
    rig.board.look().knobs.late_by_one = false;
    rig.run(1);
    assert_eq!(exchange(&rig, "late"), 2);
    rig.run(70);
    assert_eq!(exchange(&rig, "lost"), 1);
    assert_eq!(rig.hal.get::<u32>("ferrocnc.0.packet-error-total"), 3);
}

#[test]
fn the_fault_code_is_what_the_operator_was_told_last_or_why_the_machine_stopped() {
    let mut rig = Rig::armed();
    assert_eq!(fault(&rig), 0);
    rig.hal.set("ferrocnc.0.enable", false);
    rig.run(5);
    assert_eq!(fault(&rig), 3, "LinuxCNC switched it off");
    rig.hal.set("ferrocnc.0.packet-read-timeout", 100_000);
    rig.board.look().knobs.unplugged = true;
    rig.run(10);
    assert_eq!(fault(&rig), 16, "the board does not answer");
    rig.hal.set("ferrocnc.0.packet-read-timeout", 200_000_000);
    rig.board.look().knobs.unplugged = false;
    rig.run(150);
    assert_eq!(fault(&rig), 16, "that was the last that was told");
    rig.arm();
    assert_eq!(fault(&rig), 0);
}
