//! Programs are executed to the exact step.

use crate::rig::*;
use jobs::instruction::{DWELL_LONGEST, Feed, Instruction};
use proptest::prelude::*;
use sim::plant::Plant;
use wire::Name;
use wire::crc::crc32;
use wire::jobs::{End, Request, State, Status, UNATTENDED};

const ALL: &str = "G21 G90\nM3\nG1 X10 Y5 F6000\nG2 X20 Y5 I5 J0\nG3 X20 Y5 I-3 J0\nG4 P0.02\nM5\nG0 X3 Y-2 Z1\nG91\nG1 X1.5 Y1 F3000\nG20\nG1 X0.1\nG90 G21\nG3 X0 Y0 R30 F9000\nM2\n";

#[test]
fn lines_arcs_a_full_circle_a_dwell_and_the_pen_end_on_the_exact_step() {
    let mut rig = Rig::plotter();
    let report = rig.draw(ALL);
    assert_eq!(report.steps[0], 0);
    assert!(report.known && report.stands);
}

#[test]
fn a_second_job_goes_on_where_the_first_has_left_the_machine() {
    let mut rig = Rig::plotter();
    rig.draw("G1 X10 Y3.3 F6000\nM2\n");
    let first = rig.pins();
    // A job's places are absolute.
    rig.start("G1 X4 Y1 F6000\nM2\n");
    let report = rig.finish();
    assert_eq!((report.end, report.steps), (End::Done, [320, 80, 0]));
    assert_ne!(rig.pins(), first);
    assert_eq!(rig.pins(), [320, 80, 0]);
}

#[test]
fn the_pen_switches_while_everything_stands_and_is_off_in_the_end() {
    let mut rig = Rig::plotter();
    rig.start("G1 X2 F6000\nM3\nG4 P0.05\nG1 X4\nM5\nG1 X6\nM2\n");
    let mut seen = Vec::new();
    while rig.jobs.executor().expect("jobs").busy() {
        rig.turn();
        let pins = *rig.machine.board.environment().pins();
        let (x, pen) = (rig.pins()[0], pins.gpio_out & 1 == 1);
        if seen.last().is_none_or(|(_, last)| *last != pen) {
            seen.push((x, pen));
        }
    }
    assert_eq!(seen, [(0, false), (160, true), (320, false)]);
}

#[test]
fn a_program_stop_waits_for_the_operator() {
    let mut rig = Rig::plotter();
    rig.start("G1 X2 F6000\nM0\nG1 X4\nM2\n");
    rig.run(500 * MS);
    let report = rig.report();
    assert_eq!(
        (report.state, report.stands, report.steps[0]),
        (State::Paused, true, 160)
    );
    assert_eq!(rig.command(9), Status::Normal);
    assert_eq!(rig.finish().steps[0], 320);
}

#[test]
fn progress_is_by_the_time_of_the_path_and_the_line_is_the_one_being_drawn() {
    let mut rig = Rig::plotter();
    // Nine quick lines, and one that takes as long as all of them nine times.
    let mut text: String = (1..10).map(|n| format!("G1 X{n} F6000\n")).collect();
    text += "G1 X90 F6000\nM2\n";
    rig.start(&text);
    let (mut last, mut half) = (rig.report(), None);
    while rig.jobs.executor().expect("jobs").busy() {
        rig.run(10 * MS);
        let report = rig.report();
        if report.state == State::Running {
            assert!(
                report.progress >= last.progress && report.line >= last.line,
                "{report:?}"
            );
            assert!(report.elapsed >= last.elapsed);
        }
        if report.line == 10 && half.is_none() {
            half = Some(report);
        }
        last = report;
    }
    let at_the_long_line = half.unwrap();
    assert!(
        (5..=12).contains(&at_the_long_line.progress),
        "{at_the_long_line:?}"
    );
    assert!(
        (600..1500).contains(&at_the_long_line.remaining),
        "{at_the_long_line:?}"
    );
    assert_eq!((last.progress, last.remaining), (100, 0));
}

#[test]
fn half_the_feed_takes_twice_the_time_and_makes_the_same_steps() {
    let mut times = Vec::new();
    for percent in [100, 50] {
        let mut rig = Rig::plotter();
        rig.ok(&Request::Feed { percent });
        let report = rig.draw("G1 X20 Y10 F3000\nG1 X0 Y0\nM2\n");
        assert_eq!(report.percent, percent);
        times.push(f64::from(report.elapsed));
    }
    let ratio = times[1] / times[0];
    assert!((1.9..2.1).contains(&ratio), "{times:?}");
    let mut rig = Rig::plotter();
    for percent in [0, 201] {
        let status = rig.status(&Request::Feed { percent });
        assert_eq!(status, Status::Value);
    }
}

#[test]
fn a_job_of_100_000_lines_streams_without_loss() {
    let mut rig = Rig::new(Plant::direct(0));
    // Quick, and no finer than it has to be: this is about the stream.
    let mut machine = plotter();
    for axis in &mut machine.axes {
        (axis.steps_per_km, axis.max_speed) = (8_000_000, 2_000_000_000);
        axis.max_accel = 50_000_000_000;
    }
    rig.ok(&Request::PutMachine(machine));
    rig.turn = 100;
    // As a slicer writes it: short lines round and round, relative, with a rounding that does not
    // close.
    let mut text = String::from("G91\nG1 F120000\n");
    for n in 0..100_000u32 {
        let angle = f64::from(n) * 0.01;
        text += &format!("G1 X{:.3} Y{:.3}\n", 0.5 * angle.cos(), 0.5 * angle.sin());
    }
    text += "M2\n";
    let program = program(&text);
    assert!(program.len() > 100_000);
    rig.send("long", &file(&program));
    assert_eq!(rig.command_with(2, UNATTENDED, 0, "long"), Status::Normal);
    let report = rig.finish();
    assert_eq!(report.end, End::Done, "{report:?}");
    assert_eq!(report.line, 100_002);
    let (segments, steps) = predict(&program, &machine);
    assert_eq!(report.segments as usize, segments.len());
    assert_eq!(rig.pins(), steps);
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(8) })]

    #[test]
    fn pauses_at_any_moment_change_no_step(
        places in proptest::collection::vec((-20..60i32, -20..60i32), 3..8), pauses in proptest::collection::vec((1..150u64, 1..100u64), 1..6),
    ) {
        let mut rig = Rig::plotter();
        let mut text = String::from("G1 F9000\n");
        for (n, (x, y)) in places.iter().enumerate() {
            text += &format!("G1 X{x} Y{y}\n{}\n", if n % 3 == 1 { "M3" } else { "" });
        }
        text += "M2\n";
        let program = rig.start(&text);
        for (runs, waits) in pauses {
            rig.run(runs * MS);
            if rig.report().state != State::Running {
                break;
            }
            prop_assert_eq!(rig.command(10), Status::Normal);
            // 200 mm/s, braked with a quarter of 4000 mm/s^2.
            rig.run(250 * MS);
            let stood = rig.report();
            if stood.state == State::Paused {
                prop_assert!(stood.stands, "{:?}", stood);
                let pins = rig.pins();
                rig.run(waits * MS);
                prop_assert_eq!(rig.pins(), pins);
                prop_assert_eq!(rig.command(1), Status::Normal);
            }
        }
        let report = rig.finish();
        prop_assert_eq!(report.end, End::Done);
        let (_, steps) = predict(&program, &rig.machine_of());
        prop_assert_eq!(rig.pins(), steps);
    }
}

#[test]
fn a_dwell_of_any_length_is_refused_or_waited_for() {
    let mut rig = Rig::plotter();
    let dwell = |micros| [(Instruction::Dwell { micros }, 1), (Instruction::End, 2)];
    for micros in [DWELL_LONGEST + 1, u64::MAX / 60, u64::MAX] {
        let bytes = file(&dwell(micros));
        let total = bytes.len() as u32;
        let put = Request::Put {
            total,
            crc: crc32(&bytes),
            name: Name::new("long").unwrap(),
        };
        rig.ok(&put);
        let (offset, bytes) = (0, &bytes[..]);
        rig.ok(&Request::Data { offset, bytes });
        assert_eq!(rig.status(&Request::Commit), Status::NoJob, "{micros}");
    }
    // A week of it, and the operator does not want to wait.
    rig.begin(&dwell(DWELL_LONGEST));
    rig.run(500 * MS);
    let report = rig.report();
    assert_eq!((report.state, report.progress), (State::Running, 0));
    assert!(report.remaining > 6 * 24 * 3600 * 1000, "{report:?}");
    rig.ok(&Request::Command {
        code: 0,
        flags: 0,
        keepalive: 0,
        name: Name::EMPTY,
    });
    assert_eq!(rig.finish().end, End::Stopped);
}

#[test]
fn a_program_that_would_take_longer_than_there_is_time_is_at_its_beginning() {
    let mut rig = Rig::new(Plant::direct(0));
    let mut machine = plotter();
    for axis in &mut machine.axes {
        (axis.lowest, axis.highest) = (-10_000_000_000, 10_000_000_000);
    }
    rig.ok(&Request::PutMachine(machine));
    // 600 years each at 1 nm/s, 2^64 microseconds after 922 of them.
    let lines = (0..2000).map(|n| {
        let x = if n % 2 == 0 {
            10_000_000_000
        } else {
            -10_000_000_000
        };
        let (to, feed) = ([x, 0, 0], Feed::Rate(1));
        (Instruction::Line { to, feed }, n)
    });
    let program: Vec<_> = lines.chain([(Instruction::End, 2000)]).collect();
    rig.begin(&program);
    rig.run(1000 * MS);
    let report = rig.report();
    assert_eq!((report.state, report.progress), (State::Running, 0));
    assert_eq!(report.remaining, u32::MAX);
    assert_eq!(rig.command(0), Status::Normal);
    assert_eq!(rig.finish().end, End::Stopped);
}
