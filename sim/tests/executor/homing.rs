//! Homing to switches: fast, off, slow, off again; every failure of it ends with a reason.

use crate::rig::*;
use sim::plant::{Plant, Switch};
use wire::jobs::{End, Request, State, Status, UNATTENDED};

/// Where the switches of [`switched`] are, to a step: X and Y are pressed at -500 and below, Z at
/// 800 and above.
const SWITCHES: [i64; 3] = [-500, -500, 800];

fn home(rig: &mut Rig, axes: u8) {
    assert_eq!(
        rig.command_with(11, UNATTENDED | axes, 0, ""),
        Status::Normal
    );
}

#[test]
fn every_axis_finds_its_switch_and_stands_where_it_opened() {
    let mut rig = Rig::switched();
    assert!(!rig.report().known);
    home(&mut rig, 0);
    let report = rig.finish();
    assert_eq!(
        (report.end, report.steps),
        (End::Done, [0; 3]),
        "{report:?}"
    );
    assert!(report.known && report.homed == 7 && report.stands);
    for (pin, switch) in rig.pins().into_iter().zip(SWITCHES) {
        // 160 steps/s looked at every millisecond, and 10 us of debounce.
        assert!((pin - switch).abs() <= 2, "{pin} instead of {switch}");
    }
}

#[test]
fn the_order_is_the_machines_and_the_pen_is_up_before_anything_moves() {
    let mut rig = Rig::switched();
    home(&mut rig, 0);
    let mut order = Vec::new();
    while rig.jobs.executor().expect("jobs").busy() {
        rig.run(5 * MS);
        let report = rig.report();
        if report.state == State::Calibrating
            && report.axis != 0xff
            && order.last() != Some(&report.axis)
        {
            order.push(report.axis);
        }
        assert_eq!(rig.machine.board.environment().pins().gpio_out & 1, 0);
    }
    assert_eq!(order, [2, 0, 1]);
}

#[test]
fn a_switch_that_is_closed_at_the_start_is_left_first() {
    let mut rig = Rig::switched();
    home(&mut rig, 0);
    rig.finish();
    // Moves X two steps into its switch with a machine that has its home elsewhere.
    let mut machine = with_switches();
    machine.axes[0].lowest = -400_000_000;
    rig.ok(&Request::PutMachine(machine));
    home(&mut rig, 0);
    rig.finish();
    rig.start("G1 X-3 F6000\nM2\n");
    assert_eq!(rig.finish().end, End::Done);
    assert!(rig.pins()[0] < -700);
    home(&mut rig, 1);
    let report = rig.finish();
    assert_eq!((report.end, report.steps[0]), (End::Done, 0), "{report:?}");
    assert!((rig.pins()[0] - SWITCHES[0]).abs() <= 2);
}

#[test]
fn a_switch_that_is_not_there_is_not_looked_for_for_ever() {
    let mut rig = Rig::new(Plant::direct(0));
    let mut machine = with_switches();
    machine.axes[2].home = None;
    for axis in &mut machine.axes[..2] {
        axis.home.as_mut().unwrap().travel = 10_000_000;
    }
    rig.ok(&Request::PutMachine(machine));
    home(&mut rig, 0);
    let report = rig.finish();
    assert_eq!((report.end, report.axis), (End::NoSwitch, 0), "{report:?}");
    assert!(!report.known);
    assert!((-860..-799).contains(&rig.pins()[0]), "{:?}", rig.pins());
    // In time, too.
    machine.axes[0].home.as_mut().unwrap().timeout = 50;
    rig.ok(&Request::PutMachine(machine));
    let from = rig.pins()[0];
    home(&mut rig, 0);
    assert_eq!(rig.finish().end, End::NoSwitch);
    assert!(rig.pins()[0] > from - 400, "{:?}", rig.pins());
    // One that has none at all.
    assert_eq!(
        rig.command_with(11, UNATTENDED | 4, 0, ""),
        Status::NoSwitch
    );
}

#[test]
fn a_switch_that_never_opens_is_said() {
    let mut plant = switched();
    plant.add_switch(Switch {
        stepgen: 3,
        at: -1,
        above: true,
        input: 0,
        inverted: false,
    });
    let mut rig = Rig::new(plant);
    let mut machine = with_switches();
    machine.axes[0].home.as_mut().unwrap().travel = 5_000_000;
    rig.ok(&Request::PutMachine(machine));
    home(&mut rig, 1);
    let report = rig.finish();
    assert_eq!(
        (report.end, report.axis),
        (End::StuckSwitch, 0),
        "{report:?}"
    );
}

#[test]
fn homing_can_be_stopped_at_any_moment_and_a_pause_is_a_stop() {
    const STOP: u8 = 0;
    const PAUSE: u8 = 10;
    let moments = [1, 30, 100, 250, 400, 700];
    for (after, code) in moments
        .into_iter()
        .flat_map(|after| [(after, STOP), (after, PAUSE)])
    {
        let mut rig = Rig::switched();
        home(&mut rig, 0);
        rig.run(after * MS);
        assert_eq!(rig.command(code), Status::Normal);
        let report = rig.finish();
        assert_eq!(report.end, End::Stopped, "after {after} ms: {report:?}");
        assert!(!report.known);
        let stood = rig.pins();
        rig.run(100 * MS);
        assert_eq!(rig.pins(), stood);
        // And is done again.
        home(&mut rig, 0);
        assert_eq!(rig.finish().end, End::Done);
    }
}

#[test]
fn a_homing_that_goes_on_is_not_continued_and_goes_on() {
    const CONTINUE: [u8; 2] = [1, 9];
    for after in [1, 30, 100, 250, 400, 700] {
        let mut rig = Rig::switched();
        home(&mut rig, 0);
        rig.run(after * MS);
        for code in CONTINUE {
            assert_eq!(rig.command(code), Status::NotNow, "after {after} ms");
        }
        let report = rig.finish();
        assert_eq!(report.end, End::Done, "after {after} ms: {report:?}");
        assert!(report.known);
    }
}

#[test]
fn a_job_may_find_the_switches_itself_and_its_pen_comes_back() {
    let mut rig = Rig::switched();
    rig.start("G28\nG1 X5 F6000\nM3\nG1 X10\nG28 X0\nG1 X2 Y4\nM2\n");
    let mut last = false;
    while rig.jobs.executor().expect("jobs").busy() {
        rig.turn();
        let pen = rig.machine.board.environment().pins().gpio_out & 1 == 1;
        let state = rig.jobs.executor().expect("jobs").state();
        assert!(
            !(pen && state == State::Calibrating && last),
            "the pen is down"
        );
        last = pen && state == State::Calibrating;
    }
    let report = rig.finish();
    assert_eq!(
        (report.end, report.steps),
        (End::Done, [160, 320, 0]),
        "{report:?}"
    );
}

#[test]
fn a_homing_in_a_job_is_the_line_it_stands_on_while_the_tool_is_lifted() {
    let mut rig = Rig::switched();
    let mut machine = with_switches();
    machine.tool_delay = 100_000;
    rig.ok(&Request::PutMachine(machine));
    rig.start("G28\nG1 X5 F6000\nM3\nG1 X10\nG28 X0\nG1 X2 Y4\nM2\n");
    let (mut line, mut progress) = (0, 0);
    while rig.jobs.executor().expect("jobs").busy() {
        let report = rig.report();
        assert!(
            report.line >= line && report.progress >= progress,
            "back from line {line}, {progress} %: {report:?}"
        );
        (line, progress) = (report.line, report.progress);
        rig.run(5 * MS);
    }
    assert_eq!(rig.finish().end, End::Done);
}

/// A tool that takes 100 ms to lift, about to be lifted before the switches are looked for.
fn slow_tool() -> Rig {
    let mut rig = Rig::new(switched());
    let mut machine = with_switches();
    machine.tool_delay = 100_000;
    rig.ok(&Request::PutMachine(machine));
    home(&mut rig, 0);
    rig
}

#[test]
fn the_tool_has_its_time_to_lift_before_a_switch_is_looked_for() {
    let mut rig = slow_tool();
    rig.run(100 * MS);
    assert_eq!(rig.pins(), [0; 3]);
    assert_eq!(rig.report().state, State::Calibrating);
    // To arm takes some exchanges, a velocity one more.
    rig.run(60 * MS);
    assert_ne!(rig.pins(), [0; 3]);
    assert_eq!(rig.finish().end, End::Done);
}

#[test]
fn stop_is_right_while_the_tool_is_lifted() {
    let mut rig = slow_tool();
    rig.run(60 * MS);
    assert_eq!(rig.command(0), Status::Normal);
    assert_eq!(rig.report().state, State::Stopping);
    let report = rig.finish();
    assert_eq!((report.end, rig.pins()), (End::Stopped, [0; 3]));
    home(&mut rig, 0);
    assert_eq!(rig.finish().end, End::Done);
}
