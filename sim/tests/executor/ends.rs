//! After every kind of end of a job the position is known, the reason is reported, and the board
//! can execute the next job.

use crate::rig::*;
use firmware::cores::Board as _;
use wire::exchange::StateWord;
use wire::jobs::{End, Request, State, Status, UNATTENDED};
use wire::regmap::{self, segments};
use wire::{FaultReason, ResetReason};

const LONG: &str = "M3\nG1 X100 Y50 F2400\nG1 X0 Y0\nM2\n";

/// The end of a job that was on its way; nothing moves any more, and the position is the pins'.
fn ended(rig: &mut Rig, end: End) {
    let report = rig.finish();
    assert_eq!(
        (report.state, report.end),
        (State::Stopped, end),
        "{report:?}"
    );
    let pins = rig.pins();
    assert_eq!(report.steps.map(i64::from), pins);
    assert!(pins[0] > 0 && pins[0] < 8000, "{pins:?}");
    rig.run(200 * MS);
    assert_eq!(rig.pins(), pins, "moves on");
    assert_eq!(
        rig.machine.board.environment().pins().gpio_out & 1,
        0,
        "the pen is down"
    );
    assert!(
        rig.machine.server.session().owner().is_none(),
        "owned still"
    );
}

/// And the next job ends where it should.
fn goes_on(rig: &mut Rig) {
    rig.start("G1 X10 Y10 F9000\nM2\n");
    let report = rig.finish();
    assert_eq!(
        (report.end, report.steps),
        (End::Done, [800, 800, 0]),
        "{report:?}"
    );
    assert_eq!(rig.pins(), [800, 800, 0]);
}

#[test]
fn stop_comes_to_rest_on_the_path() {
    let mut rig = Rig::plotter();
    rig.start(LONG);
    rig.underway();
    assert_eq!(rig.command(0), Status::Normal);
    ended(&mut rig, End::Stopped);
    let [x, y, _] = rig.pins();
    assert!((x - 2 * y).abs() <= 2, "{x} {y} is off the line");
    goes_on(&mut rig);
}

#[test]
fn a_heavy_machine_comes_to_rest_on_the_path_of_a_dense_job_too() {
    let mut rig = Rig::plotter();
    let mut machine = plotter();
    for axis in &mut machine.axes {
        axis.max_accel = 500_000_000;
    }
    rig.ok(&Request::PutMachine(machine));
    // Half a millimetre at a time: what the core has been given is shorter than the way to rest.
    let lines =
        (1..=500).map(|n| format!("G1 X{} Y{} F9000\n", f64::from(n) / 2.0, f64::from(n) / 4.0));
    rig.start(&format!("{}M2\n", lines.collect::<String>()));
    while rig.pins()[0] < 6000 {
        rig.run(MS);
    }
    assert_eq!(rig.command(0), Status::Normal);
    let report = rig.finish();
    assert_eq!(report.end, End::Stopped, "{report:?}");
    let [x, y, _] = rig.pins();
    println!("stands at {x}, {y}");
    assert!(x < 20_000, "it was drawn to its end");
    assert!((x - 2 * y).abs() <= 2, "{x} {y} is off the line");
}

#[test]
fn stop_is_right_in_a_pause_in_a_program_stop_and_when_nothing_is_going_on() {
    let mut rig = Rig::plotter();
    assert_eq!(rig.command(0), Status::Normal);
    rig.start(LONG);
    rig.underway();
    assert_eq!(rig.command(10), Status::Normal);
    rig.run(300 * MS);
    assert_eq!(rig.command(0), Status::Normal);
    ended(&mut rig, End::Stopped);
    rig.start("G1 X20 Y20 F9000\nM0\nG1 X30\nM2\n");
    while rig.report().state != State::Paused {
        rig.run(10 * MS);
    }
    assert_eq!(rig.command(0), Status::Normal);
    let report = rig.finish();
    assert_eq!((report.end, report.steps), (End::Stopped, [1600, 1600, 0]));
}

#[test]
fn a_job_stopped_before_it_has_begun_never_arms() {
    let mut rig = Rig::plotter();
    // While it is looked through, and with the board taken but not armed.
    for turns in [0, 20, 40, 60] {
        rig.start("G1 X20 Y20 F9000\nM2\n");
        for _ in 0..turns {
            rig.turn();
        }
        assert!(
            rig.jobs.executor().expect("jobs").busy(),
            "after {turns} turns"
        );
        assert_eq!(rig.command(0), Status::Normal);
        let report = rig.finish();
        assert_eq!((report.end, report.steps), (End::Stopped, [0; 3]));
        assert_eq!(rig.pins(), [0; 3]);
        assert!(rig.machine.server.session().owner().is_none());
    }
    goes_on(&mut rig);
}

#[test]
fn a_pause_before_the_first_step_holds_it() {
    for turns in [0, 20, 60] {
        let mut rig = Rig::plotter();
        rig.start("G1 X20 Y20 F9000\nM2\n");
        for _ in 0..turns {
            rig.turn();
        }
        assert_eq!(rig.command(10), Status::Normal);
        rig.run(400 * MS);
        assert_eq!(rig.report().state, State::Paused);
        assert_eq!(rig.pins(), [0; 3], "after {turns} turns");
        assert_eq!(rig.command(1), Status::Normal);
        let report = rig.finish();
        assert_eq!((report.end, report.steps), (End::Done, [1600, 1600, 0]));
    }
}

#[test]
fn an_e_stop_ends_it_and_where_the_machine_is_is_known_no_more() {
    let mut rig = Rig::switched();
    assert_eq!(rig.command_with(11, UNATTENDED, 0, ""), Status::Normal);
    assert_eq!(rig.finish().end, End::Done);
    let home = rig.pins();
    rig.start("G1 X50 Y20 F9000\nM2\n");
    rig.underway();
    rig.estop(true);
    let report = rig.finish();
    assert_eq!(
        (report.state, report.end),
        (State::Stopped, End::EStop),
        "{report:?}"
    );
    assert!(!report.known && report.homed == 0, "{report:?}");
    let made: [i64; 3] = core::array::from_fn(|axis| rig.pins()[axis] - home[axis]);
    assert_eq!(
        report.steps.map(i64::from),
        made,
        "the count is what left the pins"
    );
    let word = StateWord::from_word(report.board).unwrap();
    assert_eq!((word.reason, word.estop), (FaultReason::EStop, true));
    // Pressed still: it does not arm. Released: not before the switches were found.
    assert_eq!(rig.command_with(11, UNATTENDED, 0, ""), Status::Normal);
    assert_eq!(rig.finish().end, End::NotArmed);
    rig.estop(false);
    assert_eq!(rig.command_with(2, UNATTENDED, 0, "job"), Status::Normal);
    let report = rig.finish();
    assert_eq!(
        (report.end, report.axis, report.line),
        (End::NotHomed, 0, 1)
    );
    assert_eq!(rig.command_with(11, UNATTENDED, 0, ""), Status::Normal);
    let report = rig.finish();
    assert!(report.end == End::Done && report.known, "{report:?}");
}

#[test]
fn an_attended_job_stops_on_its_path_when_its_client_falls_silent() {
    let mut rig = Rig::plotter();
    rig.unattended = false;
    rig.start(LONG);
    // Asked for often enough it runs on, by another connection of the same client, too.
    rig.run(600 * MS);
    rig.connect();
    rig.run(600 * MS);
    assert!(rig.report().attended);
    rig.run(500 * MS);
    rig.client = 8;
    rig.connect();
    for _ in 0..8 {
        // Another client's questions do not count.
        rig.run(100 * MS);
        rig.report();
    }
    ended(&mut rig, End::HostLost);
    goes_on(&mut rig);
}

#[test]
fn an_unattended_job_runs_on_with_the_cable_pulled() {
    let mut rig = Rig::plotter();
    let program = rig.start("G1 X20 Y10 F9000\nG1 X0 Y7\nM2\n");
    rig.underway();
    rig.machine.board.environment().link(0);
    rig.machine.board.environment().settle();
    let report = rig.finish();
    assert_eq!(report.end, End::Done, "{report:?}");
    let (_, steps) = predict(&program, &rig.machine_of());
    assert_eq!(rig.pins(), steps);
}

#[test]
fn a_program_that_hangs_is_stopped_by_the_watchdog_or_the_empty_queue() {
    let mut rig = Rig::plotter();
    rig.start(LONG);
    rig.underway();
    rig.hangs = true;
    rig.run(1000 * MS);
    let stood = rig.pins();
    rig.run(500 * MS);
    assert_eq!(rig.pins(), stood);
    rig.hangs = false;
    ended(&mut rig, End::Watchdog);
    assert_eq!(rig.pins(), stood);
    goes_on(&mut rig);
}

#[test]
fn a_path_that_stands_though_it_should_pass_is_ended_by_the_watchdog() {
    let mut rig = Rig::plotter();
    rig.start(LONG);
    rig.underway();
    // Not by a pause: something is wrong with the core. The program runs, but feeds nothing that
    // does not go on.
    let pace = regmap::address(segments::BASE, segments::PACE);
    rig.machine.board.csr_write(pace, 0);
    rig.run(600 * MS);
    let gate = rig.machine.board.gate();
    assert!(gate.stopping() || !gate.open(), "the watchdog is fed");
    ended(&mut rig, End::Watchdog);
    goes_on(&mut rig);
}

#[test]
fn an_underrun_brakes_and_says_so() {
    let mut rig = Rig::plotter();
    // A move of FPGA G's protocol that ends at speed, and no further one.
    let word = |high: u32, low: u32| (high << 16 | low).to_le_bytes();
    let words = [word(0x0160, 0), word(400, 1000), word(1000, 0), word(0, 0)];
    for (command, words) in [(1, &words[..]), (3, &[])] {
        let words = wire::jobs::Words::new(words);
        rig.ok(&Request::Segment {
            command,
            form: 0,
            words,
        });
    }
    ended(&mut rig, End::Underrun);
}

#[test]
fn a_restart_in_mid_job_is_said() {
    let mut rig = Rig::switched();
    assert_eq!(rig.command_with(11, UNATTENDED, 0, ""), Status::Normal);
    assert!(rig.finish().known);
    rig.start("G1 X50 Y20 F9000\nM2\n");
    rig.underway();
    let mut rig = rig.restart();
    let report = rig.report();
    assert_eq!((report.state, report.end), (State::Stopped, End::Restart));
    assert!(!report.known && !report.machine);
    let stood = rig.pins();
    rig.run(200 * MS);
    assert_eq!(rig.pins(), stood);
    rig.ok(&Request::PutMachine(with_switches()));
    assert_eq!(rig.command_with(2, UNATTENDED, 0, "job"), Status::NoSuchJob);
}

#[test]
fn after_a_restart_an_axis_without_a_switch_is_known_when_the_operator_says_so() {
    let mut rig = Rig::plotter();
    assert!(rig.report().known, "at power-up it stands at 0");
    rig.start("G1 X50 Y20 F9000\nM2\n");
    rig.underway();
    rig.machine.board.part(ResetReason::Trap);
    let mut rig = rig.restart();
    rig.ok(&Request::PutMachine(plotter()));
    assert!(!rig.report().known);
    assert_eq!(rig.command_with(13, 0, 0, ""), Status::Normal);
    assert!(rig.report().known);
}
