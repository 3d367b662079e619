//! Promises that XYPenPlotter breaks, one test each (`jobs/src/xypen.rs` describes what it does).

use crate::rig::*;
use jobs::instruction::{Arc, Feed, Instruction};
use jobs::xypen;
use wire::Name;
use wire::jobs::{End, Request, State, Status, UNATTENDED};

/// The farthest each axis gets from where it began.
fn extent(rig: &mut Rig) -> [i64; 3] {
    let mut most = [0; 3];
    while rig.jobs.executor().expect("jobs").busy() {
        rig.turn();
        let pins = rig.pins();
        most = core::array::from_fn(|axis| pins[axis].abs().max(most[axis]));
    }
    most
}

#[test]
fn a_full_circle_is_drawn() {
    let mut rig = Rig::plotter();
    rig.start("G2 X0 Y0 I10 J0 F9000\nM2\n");
    let [x, y, _] = extent(&mut rig);
    // 20 mm across, 10 up and down.
    assert!(
        (1598..=1601).contains(&x) && (798..=801).contains(&y),
        "{x} {y}"
    );
    assert_eq!(rig.finish().steps, [0; 3]);
}

#[test]
fn arcs_of_two_degrees_and_less_are_arcs() {
    for degrees in [2.0f64, 1.0, 0.5] {
        let mut rig = Rig::plotter();
        let mut machine = plotter();
        machine.chord_tolerance = 1000;
        machine.junction_deviation = 1000;
        for axis in &mut machine.axes {
            axis.steps_per_km = 1_000_000_000;
            axis.max_speed = 50_000_000;
            axis.max_accel = 400_000_000;
            (axis.steplen, axis.stepspace) = (1000, 1000);
        }
        rig.ok(&Request::PutMachine(machine));
        // Of 200 mm, from its lowest point: it ends higher than any chord of its half.
        let angle = degrees.to_radians();
        let (radius, nm) = (200e6, |value: f64| value.round() as i64);
        let to = [
            nm(radius * angle.sin()),
            nm(radius * (1.0 - angle.cos())),
            0,
        ];
        let arc = Arc {
            to,
            center: [0, nm(radius)],
            clockwise: false,
            feed: Feed::Rate(20_000_000),
        };
        rig.begin(&[(Instruction::Arc(arc), 1), (Instruction::End, 2)]);
        let mut off = 0.0f64;
        while rig.jobs.executor().expect("jobs").busy() {
            rig.turn();
            let [x, y, _] = rig.pins().map(|steps| steps as f64 * 1000.0);
            off = off.max((x.hypot(y - radius) - radius).abs());
        }
        // Tolerance, rounding of the corners and a step each way; the chord alone would miss by 30
        // um at 2 degrees.
        assert!(off <= 1000.0 + 1000.0 + 1500.0, "{degrees}: {off} nm off");
        assert_eq!(rig.finish().end, End::Done);
    }
}

#[test]
fn a_missing_field_moves_nothing() {
    // Seven words: G1 with X only, then with Y only.
    let missing = [0xff; 4];
    let record = |x: [u8; 4], y: [u8; 4]| {
        [1i32.to_le_bytes(), x, y, missing, missing, missing, missing].concat()
    };
    let mut bytes = 14u32.to_le_bytes().to_vec();
    bytes.extend(record(10f32.to_le_bytes(), missing));
    bytes.extend(record(missing, (-5f32).to_le_bytes()));
    let quirks = xypen::Quirks {
        feed: Feed::Rate(100_000_000),
        ..xypen::Quirks::G2B
    };
    let read: Vec<Instruction> = xypen::Reader::new(&bytes, quirks)
        .unwrap()
        .map(Result::unwrap)
        .collect();
    let mut program: Vec<(Instruction, u32)> = (1..).zip(read).map(|(line, i)| (i, line)).collect();
    program.push((Instruction::End, 9));
    let mut rig = Rig::plotter();
    rig.begin(&program);
    assert_eq!(rig.finish().steps, [800, 400, 0]);
}

#[test]
fn a_command_is_acted_on_again_under_a_new_id_and_not_under_the_old_one() {
    let mut rig = Rig::plotter();
    rig.send("job", &file(&program("G91\nG1 X1 F6000\nM2\n")));
    let start = unattended(Name::new("job").unwrap());
    let first = rig.ask_as(900, &start);
    assert_eq!(first.0, Status::Normal);
    assert_eq!(rig.finish().end, End::Done);
    // The answer got lost, the client asks again: over a new connection even.
    let again = rig.ask_as(901, &Request::Report);
    assert_eq!(again.0, Status::Normal);
    let second = rig.ask_as(902, &start);
    assert_eq!(second.0, Status::Normal);
    assert!(
        rig.jobs.executor().expect("jobs").busy(),
        "the same code under a new id is a new command"
    );
    assert_eq!(
        rig.ask_as(902, &start),
        second,
        "answered again, not refused as it runs"
    );
    rig.run(2000 * MS);
    assert!(!rig.jobs.executor().expect("jobs").busy());
    assert_eq!(rig.ask_as(902, &start), second);
    assert!(!rig.jobs.executor().expect("jobs").busy(), "acted on twice");
    // Nor after a new connection: that begins with a Hello.
    rig.connect();
    assert_eq!(rig.ask_as(902, &start), second);
    assert!(!rig.jobs.executor().expect("jobs").busy(), "acted on twice");
    // Pause, and pause again: twice right.
    rig.start("G1 X50 F6000\nM2\n");
    rig.underway();
    assert_eq!(
        (rig.command(10), rig.command(10)),
        (Status::Normal, Status::Normal)
    );
    assert_eq!(
        (rig.command(1), rig.command(10)),
        (Status::Normal, Status::Normal)
    );
    assert_eq!(rig.report().state, State::Paused);
}

#[test]
fn a_start_that_comes_again_behind_another_clients_stop_starts_nothing() {
    let mut rig = Rig::plotter();
    rig.send("job", &file(&program("G1 X50 F6000\nM2\n")));
    let start = unattended(Name::new("job").unwrap());
    let first = rig.ask_as(900, &start);
    assert_eq!(first.0, Status::Normal);
    rig.run(200 * MS);
    // The answer is lost with its connection. Meanwhile another client looks, stops the job, and
    // looks again.
    let owner = std::mem::replace(&mut rig.client, 8);
    rig.connect();
    assert_eq!(rig.report().state, State::Running);
    assert_eq!(rig.command(0), Status::Normal);
    assert_eq!(rig.finish().end, End::Stopped);
    rig.client = owner;
    rig.connect();
    assert_eq!(rig.ask_as(900, &start), first, "acted on once, long ago");
    assert!(!rig.jobs.executor().expect("jobs").busy(), "it was stopped");
}

#[test]
fn a_start_that_comes_again_behind_a_refused_stranger_starts_nothing() {
    let mut rig = Rig::plotter();
    rig.send("job", &file(&program("G1 X50 F6000\nM2\n")));
    let start = unattended(Name::new("job").unwrap());
    let first = rig.ask_as(900, &start);
    assert_eq!(first.0, Status::Normal);
    rig.run(2000 * MS);
    assert!(!rig.jobs.executor().expect("jobs").busy(), "done");
    // The answer is lost with its connection. A stranger sends no frame, or none that it may.
    let owner = rig.client;
    rig.knock();
    rig.bytes(&[0xff; wire::jobs::FRAME]);
    rig.knock();
    assert_eq!(rig.ask_as(1, &start).0, Status::NoHello);
    rig.client = 8;
    rig.connect();
    assert_eq!(
        rig.command_with(2, UNATTENDED, 0, "none"),
        Status::NoSuchJob
    );
    rig.client = owner;
    rig.connect();
    assert_eq!(rig.ask_as(900, &start), first, "acted on once, long ago");
    assert!(!rig.jobs.executor().expect("jobs").busy(), "started twice");
}

#[test]
fn the_last_instructions_are_executed_once() {
    let mut rig = Rig::plotter();
    rig.start("G91\nG1 X1 F6000\nG1 X1\nG1 X1\nM2\n");
    let report = rig.finish();
    assert_eq!((report.steps, report.progress), ([240, 0, 0], 100));
    let pulses = rig.machine.board.environment().edges.pulses();
    assert_eq!(pulses, 240, "no step more, forwards or backwards");
}

#[test]
fn an_unknown_code_is_refused_and_changes_nothing() {
    let mut rig = Rig::plotter();
    rig.start("G1 X50 F6000\nM2\n");
    rig.underway();
    for code in (3..9).chain(14..=255) {
        assert_eq!(rig.command(code), Status::UnknownCode, "{code}");
    }
    assert_eq!(rig.report().state, State::Running);
    assert_eq!(rig.finish().end, End::Done);
}

#[test]
fn codes_that_do_not_fit_the_state_are_refused() {
    let mut rig = Rig::new(sim::plant::Plant::direct(0));
    assert_eq!(rig.command(2), Status::NoSuchJob);
    rig.send("x", &file(&program("G1 X9 F6000\nM2\n")));
    assert_eq!(rig.command_with(2, UNATTENDED, 0, "x"), Status::NoMachine);
    assert_eq!(rig.command_with(11, UNATTENDED, 0, ""), Status::NoMachine);
    rig.ok(&Request::PutMachine(plotter()));
    assert_eq!(
        rig.command_with(2, 0, 99, "x"),
        Status::Value,
        "a keepalive that no client can keep"
    );
    for code in [1, 9, 10] {
        assert_eq!(rig.command(code), Status::NotNow, "{code}");
    }
    assert_eq!(rig.command(12), Status::Normal);
    assert_eq!(rig.command_with(2, UNATTENDED, 0, "x"), Status::Normal);
    assert_eq!(rig.command_with(2, UNATTENDED, 0, "x"), Status::NotNow);
    assert_eq!(rig.status(&Request::PutMachine(plotter())), Status::NotNow);
    let delete = Request::Delete {
        name: Name::new("x").unwrap(),
    };
    assert_eq!(rig.status(&delete), Status::NotNow);
    assert_eq!(rig.finish().end, End::Done);
    assert_eq!(rig.status(&delete), Status::Normal);
}

#[test]
fn a_place_beyond_the_limits_is_found_before_anything_moves() {
    let limits = [
        ("G1 X10 F6000\nG1 X301\nM2\n", 0, 2),
        ("G1 X10 F6000\nG1 Y-100.001\nM2\n", 1, 2),
        // Ends within, and bulges out.
        ("G1 X299 F6000\nG2 X299 Y-10 I0 J-5\nM2\n", 0, 2),
        ("G1 Z400 F6000\nM2\n", 2, 1),
    ];
    for (text, axis, line) in limits {
        let mut rig = Rig::plotter();
        rig.start(text);
        let report = rig.finish();
        assert_eq!(
            (report.end, report.axis, report.line),
            (End::Limits, axis, line),
            "{text}"
        );
        assert_eq!(rig.pins(), [0; 3]);
    }
    // A circle that fits is accepted.
    let mut rig = Rig::plotter();
    rig.start("G1 X295 F12000\nG2 X295 Y-10 I0 J-5\nM2\n");
    assert_eq!(rig.finish().end, End::Done);
}
