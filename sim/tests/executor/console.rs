//! `job` at the debug console: the same store, the same executor, the same refusals as over TCP.

use crate::rig::*;
use sim::plant::Plant;
use wire::jobs::{End, Report, Request, State, Status, UNATTENDED};

/// Says it with the key, or on a board without one.
fn said(rig: &mut Rig, line: &str) -> String {
    rig.say(line, true)
}

#[test]
fn a_job_is_listed_started_paused_stopped_and_deleted() {
    let mut rig = Rig::plotter();
    assert_eq!(
        said(&mut rig, "job list"),
        "1044480 of 1044480 bytes are free\r\n"
    );
    let text = "G1 X20 F6000\nG1 X0\nM2\n";
    let entry = rig.send("my part", &file(&program(text)));
    assert_eq!(
        said(&mut rig, "  job   list "),
        format!(
            "my part: {} bytes, 3 instructions\r\n1040384 of 1044480 bytes are free\r\n",
            entry.total
        )
    );
    assert_eq!(
        said(&mut rig, "job"),
        "stopped\r\nat steps 0, 0, 0\r\n",
        "nothing has been done"
    );
    let started = said(&mut rig, "job start my part");
    assert!(
        started.starts_with("checking: my part, 0 %, line 0, 0.0 s passed, "),
        "{started}"
    );
    rig.underway();
    let status = said(&mut rig, "job status");
    assert!(status.starts_with("running: my part, "), "{status}");
    assert!(status.ends_with(", moving\r\n"), "{status}");
    assert!(said(&mut rig, "job pause").starts_with("paused: "));
    rig.run(300 * MS);
    let status = said(&mut rig, "job");
    assert!(!status.contains("moving"), "{status}");
    let held = rig.report();
    assert!(held.stands && !held.attended, "{held:?}");
    assert_eq!(
        said(&mut rig, "job delete my part"),
        "refused: not now: the state of the board does not allow that\r\n"
    );
    assert!(said(&mut rig, "job feed 50").contains("\r\nfeed 50 %\r\n"));
    assert!(said(&mut rig, "job continue").starts_with("running: "));
    rig.run(50 * MS);
    assert!(said(&mut rig, "job stop").starts_with("stopping: "));
    let report = rig.finish();
    assert_eq!((report.end, report.state), (End::Stopped, State::Stopped));
    assert!(report.known);
    let status = said(&mut rig, "job");
    assert!(status.contains("\r\nended last: stopped\r\n"), "{status}");
    assert_eq!(
        said(&mut rig, "job delete my part"),
        "my part is deleted, 1044480 bytes are free\r\n"
    );
}

#[test]
fn a_time_is_shown_in_tenths_in_minutes_or_in_hours() {
    let text = |ms: u32| match (ms / 3_600_000, ms / 60_000) {
        (0, 0) => format!("{}.{} s", ms / 1000, ms / 100 % 10),
        (0, minutes) => format!("{minutes} min {:02} s", ms / 1000 % 60),
        (hours, minutes) => format!("{hours} h {:02} min", minutes % 60),
    };
    for dwell in [3, 306, 9000] {
        let mut rig = Rig::plotter();
        let lines = format!("G1 X20 F6000\nG1 X0\nG4 P{dwell}\nM2\n");
        rig.send("x", &file(&program(&lines)));
        said(&mut rig, "job start x");
        rig.underway();
        rig.run(170 * MS);
        said(&mut rig, "job pause");
        rig.run(300 * MS);
        let Report {
            elapsed, remaining, ..
        } = rig.report();
        let shown = format!(", {} passed, {} to go\r\n", text(elapsed), text(remaining));
        let status = said(&mut rig, "job");
        assert!(status.contains(&shown), "{status}, not {shown}");
    }
}

#[test]
fn a_job_started_at_the_console_is_drawn_to_its_end_without_further_input() {
    let mut rig = Rig::plotter();
    let program = program("G1 X5 Y3 F6000\nM2\n");
    rig.send("x", &file(&program));
    said(&mut rig, "job start x");
    while rig.jobs.executor().expect("jobs").busy() {
        rig.run(MS);
    }
    let (_, steps) = predict(&program, &rig.machine_of());
    assert_eq!(rig.pins(), steps);
    assert!(said(&mut rig, "job").contains("ended last: done"));
}

#[test]
fn switches_are_found_from_the_console_of_all_axes_or_of_some() {
    let mut rig = Rig::switched();
    let status = said(&mut rig, "job");
    assert!(status.contains("position not trusted"), "{status}");
    assert!(said(&mut rig, "job home z").starts_with("calibrating"));
    assert_eq!(rig.finish().homed, 4);
    said(&mut rig, "job home");
    let report = rig.finish();
    assert_eq!((report.homed, report.end), (7, End::Done));
    assert_eq!(
        said(&mut rig, "job"),
        "stopped\r\nended last: done\r\nat steps 0, 0, 0\r\n"
    );
}

#[test]
fn what_the_job_server_refuses_the_console_refuses_in_the_same_words() {
    let mut rig = Rig::new(Plant::direct(0));
    rig.send("x", &file(&program("G1 X9 F6000\nM2\n")));
    let both = |rig: &mut Rig, line: &str, code: u8, name: &str, status: Status| {
        assert_eq!(rig.command_with(code, UNATTENDED, 0, name), status);
        let text = said(rig, line);
        assert_eq!(text, format!("refused: {}\r\n", status.text()), "{line}");
    };
    both(&mut rig, "job start x", 2, "x", Status::NoMachine);
    both(&mut rig, "job home", 11, "", Status::NoMachine);
    both(&mut rig, "job start y", 2, "y", Status::NoSuchJob);
    both(&mut rig, "job start", 2, "", Status::Name);
    both(&mut rig, "job pause", 10, "", Status::NotNow);
    both(&mut rig, "job continue", 1, "", Status::NotNow);
    rig.ok(&Request::PutMachine(plotter()));
    both(&mut rig, "job home", 11, "", Status::NoSwitch);
    assert!(rig.linuxcnc());
    both(&mut rig, "job start x", 2, "x", Status::Owned);
    assert_eq!(rig.status(&Request::Feed { percent: 201 }), Status::Value);
    let refused = |status: Status| format!("refused: {}\r\n", status.text());
    assert_eq!(said(&mut rig, "job feed 201"), refused(Status::Value));
    assert_eq!(said(&mut rig, "job feed 0"), refused(Status::Value));
    assert_eq!(said(&mut rig, "job delete y"), refused(Status::NoSuchJob));
    let long = format!("job delete {}", "y".repeat(32));
    assert_eq!(said(&mut rig, &long), refused(Status::Name));
    assert_eq!(rig.pins(), [0; 3]);
}

#[test]
fn what_is_not_understood_does_nothing() {
    let mut rig = Rig::plotter();
    rig.start("G1 X20 F6000\nG1 X0\nM2\n");
    rig.underway();
    for line in [
        "job stopp",
        "job stop now",
        "job pause 1",
        "job feed",
        "job feed fast",
        "job feed 99999",
        "job home w",
        "job home 1",
        "job Stop",
    ] {
        assert_eq!(said(&mut rig, line), "? try job help\r\n", "{line}");
    }
    let help = said(&mut rig, "job help");
    for word in [
        "status", "list", "start", "pause", "continue", "stop", "home", "feed", "delete",
    ] {
        assert!(help.contains(&format!("job {word}")), "{word}");
    }
    assert_eq!(rig.finish().end, End::Done);
}

#[test]
fn on_a_board_with_a_key_a_stranger_may_look_and_stop_and_nothing_else() {
    let mut rig = Rig::keyed(Plant::direct(0));
    for line in [
        "job start x",
        "job continue",
        "job home",
        "job feed 50",
        "job delete x",
    ] {
        assert_eq!(
            rig.say(line, false),
            "refused: the board has a key; use `ferrocnc console`\r\n",
            "{line}"
        );
        assert!(!rig.say(line, true).contains("key"), "{line}");
    }
    for line in ["job", "job status", "job list", "job help", "job stop"] {
        assert!(!rig.say(line, false).contains("refused"), "{line}");
    }
    // Not because of the key.
    let refused = format!("refused: {}\r\n", Status::NotNow.text());
    assert_eq!(rig.say("job pause", false), refused);
}

#[test]
fn a_store_that_is_full_of_long_names_is_listed_whole() {
    let mut rig = Rig::plotter();
    let bytes = file(&program("G1 X1 F6000\nM2\n"));
    for n in 0..32 {
        rig.send(&format!("{n:02}{}", "n".repeat(29)), &bytes);
    }
    let list = said(&mut rig, "job list");
    let shown = list.lines().filter(|line| line.contains("nnn")).count();
    assert_eq!((shown, list.lines().count()), (32, 33), "{list}");
    assert!(list.ends_with(" bytes are free\r\n"), "{list}");
}

#[test]
fn an_upload_that_was_cut_is_listed_with_what_to_do() {
    let mut rig = Rig::plotter();
    let bytes = file(&program("G1 X1 F6000\nM2\n"));
    rig.ok(&Request::Put {
        total: bytes.len() as u32,
        crc: wire::crc::crc32(&bytes),
        name: wire::Name::new("cut").unwrap(),
    });
    rig.ok(&Request::Data {
        offset: 0,
        bytes: &bytes[..20],
    });
    let line = format!(
        "cut: {} bytes, 20 of them are there: send it again\r\n",
        bytes.len()
    );
    assert!(said(&mut rig, "job list").starts_with(&line));
    let refused = format!("refused: {}\r\n", Status::Incomplete.text());
    assert_eq!(said(&mut rig, "job start cut"), refused);
}
