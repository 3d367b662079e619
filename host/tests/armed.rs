//! Which settings reach an armed board, and when, with a fake HAL on one side and a fake board
//! behind real UDP on the other.

#[path = "common/fake_board.rs"]
mod common;

use common::rig::Rig;
use wire::map;

#[test]
fn settings_change_while_disarmed_only_but_a_pwm_period_at_any_time() {
    let mut rig = Rig::armed();
    rig.hal.set("ferrocnc.0.stepgen.x.dir-invert", true);
    rig.hal.set("ferrocnc.0.watchdog.timeout-ns", 6_000_000u32);
    rig.hal.set("ferrocnc.0.pwm.spindle.pwm-freq", 20_000.0);
    rig.run(30);
    let mode = map::CONFIG_STEPGEN + 4 * map::StepgenConfig::Mode as u32;
    {
        let board = rig.board.look();
        assert_eq!(board.config[&mode], 0);
        assert_eq!(board.config[&map::CONFIG_BOARD], 300_000);
        assert_eq!(board.config[&map::CONFIG_PWM], 3_000);
        assert_eq!(board.refused, 0);
    }
    rig.hal.set("ferrocnc.0.enable", false);
    rig.run(30);
    let board = rig.board.look();
    assert_eq!(board.config[&mode], map::STEPGEN_DIR_INVERT);
    assert_eq!(board.config[&map::CONFIG_BOARD], 360_000);
}

#[test]
fn a_watchdog_is_lowered_while_armed_and_back_where_it_was_only_at_rest() {
    let mut rig = Rig::armed();
    let mut timeout = |nanos: u32| {
        rig.hal.set("ferrocnc.0.watchdog.timeout-ns", nanos);
        rig.run(30);
        (rig.board.look().config[&map::CONFIG_BOARD], rig.enabled())
    };
    assert_eq!(timeout(2_000_000), (120_000, true));
    assert_eq!(timeout(5_000_000), (120_000, true));
    rig.hal.set("ferrocnc.0.enable", false);
    rig.run(30);
    let board = rig.board.look();
    assert_eq!(board.config[&map::CONFIG_BOARD], 300_000);
    assert_eq!(board.refused, 0);
}

#[test]
fn step_times_of_an_armed_axis_take_effect_when_it_rests() {
    let mut rig = Rig::armed();
    let steplen = |rig: &Rig| rig.board.look().config[&map::CONFIG_STEPGEN];
    rig.travel(2.0, 40);
    rig.hal.set("ferrocnc.0.stepgen.x.steplen", 2000u32);
    for _ in 0..3 {
        rig.travel(2.0, 40);
        assert_eq!(steplen(&rig), 60, "it moves");
    }
    // Before it has rested for long enough, not even a try.
    rig.run(3);
    assert_eq!(steplen(&rig), 60);
    // Until the position loop asks for nothing any more, and the rest after that.
    rig.run(200);
    assert_eq!(steplen(&rig), 120);
    assert!(rig.enabled());
    assert_eq!(rig.board.look().refused, 0);
    // What the new times allow is the new limit: 1 / (2 us + 1 us) / 800.
    rig.hal.set("ferrocnc.0.stepgen.x.maxaccel", 1e6);
    rig.hal.set("ferrocnc.0.stepgen.x.control-type", true);
    rig.hal.set("ferrocnc.0.stepgen.x.velocity-cmd", 1e3);
    rig.run(20);
    let fast: f64 = rig.hal.get("ferrocnc.0.stepgen.x.velocity-fb");
    assert!((fast - 416.67).abs() < 0.1, "{fast}");
}
