//! Jobs, drawn. The drawing of `tests/drawing` is prepared, planned and played, and the pen's path is rebuilt from the edges at the pins.
//!
//! `cargo xtask test jobs` builds what this needs. `FERROCNC_JOBS_CORES` is the folder of the Verilated cores of `tests/boards/jobs.toml`;
//! pictures are left in `FERROCNC_REPORTS`, else in `target/reports`.

use ferrocnc_tests::drawing::{self, TOLERANCE, Watch};
use ferrocnc_tests::plotter::{Plotter, Scissors};
use host::job::pins::{self, Prediction};
use host::job::program::{Dialect, Program};
use sim::model::board::pages;
use sim::soc::{Cores, CoresPins};
use std::collections::VecDeque;
use std::fmt::Write;
use std::path::PathBuf;
use wire::crc::crc32;
use wire::jobs::{End, State};

fn picture(name: &str) -> PathBuf {
    let folder = std::env::var_os("FERROCNC_REPORTS").map(PathBuf::from);
    let folder = folder.unwrap_or_else(|| ferrocnc_tests::root().join("target/reports"));
    folder.join(name)
}

const ARM: u32 = 0x4152_4d31;
const CLEAR: u32 = 0x434c_5231;
const PUSH: u32 = 16;
const CONTROL: u32 = 17;
const MASK: u32 = 21;
const STATUS: u32 = 22;
const START: u32 = 1;

/// The bare cores, and somebody who writes a prediction's segments into them as they have room.
fn play(told: &Prediction, timing: [u32; 4]) -> Vec<pins::Event> {
    let folder = std::env::var_os("FERROCNC_JOBS_CORES").map_or_else(
        || ferrocnc_tests::root().join("target/sim/cores-jobs"),
        PathBuf::from,
    );
    let mut cores = Cores::load(&folder).unwrap_or_else(|error| panic!("{error}"));
    let mut pins = CoresPins::default();
    let mut writes: VecDeque<(u32, u32, u32)> = VecDeque::new();
    for n in 0..3 {
        let words = timing.into_iter().chain([1 << 24, 0]);
        writes.extend(
            (0..)
                .zip(words)
                .map(|(word, data)| (pages::STEPGEN + n, word, data)),
        );
    }
    writes.extend([
        (pages::WATCHDOG, 0, u32::MAX),
        (pages::WATCHDOG, 1, 1000),
        (pages::WATCHDOG, 3, CLEAR),
        (pages::WATCHDOG, 3, ARM),
        (pages::TIMEBASE, 7, 1),
        (pages::SEGMENTS, MASK, 1),
    ]);
    let mut segments = told.segments.iter();
    let (mut watch, mut started, mut status) = (Watch::default(), false, 0);
    for clock in 0.. {
        assert!(clock < 2 * told.clocks + 10_000_000, "it never ends");
        if writes.is_empty() {
            let (level, state, reason) = (status & 0xff, status >> 8 & 3, status >> 12 & 7);
            if started && state == 0 && reason != 0 {
                assert_eq!(reason, 1, "it is done, and nothing else");
                break;
            }
            if level < 60
                && let Some((_, segment)) = segments.next()
            {
                let words = (0..).zip(segment.words());
                writes.extend(words.map(|(at, word)| (pages::SEGMENTS, at, word)));
                writes.push_back((pages::SEGMENTS, PUSH, 0));
                // The level is that of before the push until it is read again.
                status += 1;
            } else if !started {
                started = true;
                writes.push_back((pages::SEGMENTS, CONTROL, START));
            }
        }
        let write = writes.pop_front();
        let reads = write.is_none() && clock % 64 < 2;
        let (page, word, data) = write.unwrap_or((pages::SEGMENTS, STATUS, 0));
        (pins.adr, pins.dat_w, pins.we) = (page << 9 | word, data, write.is_some().into());
        cores.rise(&mut pins);
        if reads {
            status = pins.dat_r;
        }
        watch.see(clock, pins.step, pins.dir, pins.gpio_out);
    }
    watch.events
}

#[test]
fn a_drawing_on_the_verilated_cores_is_on_its_curves_and_every_edge_in_its_clock() {
    let machine = drawing::machine();
    let told = pins::predict(&drawing::program(TOLERANCE), &machine)
        .unwrap_or_else(|error| panic!("{error}"));
    let timing = machine.to_board().axes[0].timings(machine.clock);
    let emitted = play(&told, timing);
    let verdict = drawing::judge(&told, &machine, &emitted, &picture("drawing-cores.png"));
    println!(
        "{}; {:.2} s of the board's time",
        verdict.text(),
        verdict.clocks as f64 / f64::from(machine.clock)
    );
    ferrocnc_tests::report(
        "jobs",
        &verdict.figures("Verilated cores, planned on the PC"),
    );
    verdict.assert_good(&told);
}

#[test]
fn a_drawing_sent_to_the_twin_and_started_is_on_its_curves_and_every_edge_in_its_clock() {
    let (machine, program) = (drawing::machine(), drawing::program(TOLERANCE));
    let told = pins::predict(&program, &machine).unwrap_or_else(|error| panic!("{error}"));
    let plotter = Plotter::twin();
    let mut board = plotter.board();
    board.put_machine(&machine.to_board()).expect("a machine");
    let entry = board.send("drawing", &program.to_job(), |_, _| ());
    assert!(entry.expect("the job is taken").ready);
    board.start("drawing", None).expect("it begins");
    let report = plotter.finish(&mut board);
    assert_eq!(
        (report.end, report.progress),
        (End::Done, 100),
        "{report:?}"
    );
    assert_eq!(report.steps.map(i64::from), told.steps);
    drop(board);
    let emitted = plotter.events();
    let verdict = drawing::judge(&told, &machine, &emitted, &picture("drawing.png"));
    println!("{}", verdict.text());
    verdict.assert_good(&told);
}

/// As CAM programs go: a face in many passes, each a run of lines a third of a millimetre long over a wavy surface, arcs at its ends, the
/// tool lifted between layers. `lines` lines of G-code.
fn cam(lines: usize) -> String {
    let mut text =
        String::from("%\n(made by the tests)\nN10 G21 G90 G17\nN20 G0 X10 Y10 Z2\nN30 M3\n");
    let (mut written, mut row) = (5, 0u32);
    while written + 4 < lines {
        let (y, forth) = (10.0 + f64::from(row % 200) * 0.4, row.is_multiple_of(2));
        for n in 0..200u32 {
            let along = if forth { n } else { 199 - n };
            let x = 10.0 + f64::from(along) / 3.0;
            let z = (x / 7.0).sin() * (y / 5.0).cos() * 0.3;
            // Modal, as they are: the feed once, what does not change not at all.
            let feed = if n == 0 { " F18000" } else { "" };
            let _ = writeln!(text, "G1 X{x:.3} Y{y:.3} Z{z:.3}{feed}");
            written += 1;
            if written + 4 >= lines {
                break;
            }
        }
        let (side, code) = if forth { (0.2, 3) } else { (0.2, 2) };
        let _ = writeln!(text, "G{code} Y{:.3} J{side} (turn)", y + 0.4);
        written += 1;
        row += 1;
    }
    text.push_str("G0 Z2\nM5\nG0 X0 Y0 Z0\nM30\n");
    text
}

#[test]
fn a_long_program_goes_to_the_twin_over_a_line_that_is_cut_and_not_a_step_is_lost() {
    let lines = ferrocnc_tests::from_environment("FERROCNC_LINES", 100_000) as usize;
    let text = cam(lines);
    assert!(text.lines().count().abs_diff(lines) < 3);
    let mut program = Program::from_gcode(text.as_bytes(), Dialect::default().dwell)
        .unwrap_or_else(|error| panic!("{error}"));
    program.name = "cam".to_owned();
    let (machine, job) = (drawing::machine(), program.to_job());
    let told = pins::predict(&program, &machine).unwrap_or_else(|error| panic!("{error}"));
    let plotter = Plotter::twin();

    // Anywhere in a frame, and in the middle of a Hello.
    let scissors = Scissors::new(
        plotter.jobs,
        &[job.len() / 9, job.len() / 3, 10, job.len() / 4 + 1],
    );
    let mut board = scissors.board();
    board.put_machine(&machine.to_board()).expect("a machine");
    let mut offsets = Vec::new();
    let entry = board.send("cam", &job, |there, _| offsets.push(there));
    let entry = entry.expect("the job is taken");
    assert_eq!(
        scissors.cuts(),
        4,
        "the line was not cut as often as it should have been"
    );
    assert!(entry.ready);
    // The board counts the CRC of what it has, all of it.
    assert_eq!((entry.crc, entry.total as usize), (crc32(&job), job.len()));
    assert!(offsets.is_sorted(), "an upload that went back");
    drop(board);

    let mut board = plotter.board();
    board.start("cam", None).expect("it begins");
    let report = plotter.finish(&mut board);
    assert_eq!(report.end, End::Done, "{report:?}");
    assert_eq!(report.state, State::Stopped);
    assert_eq!(report.steps.map(i64::from), told.steps);
    assert_eq!(report.segments as usize, told.segments.len());
    drop(board);
    let difference = told.compare(&plotter.events());
    println!(
        "{} lines, {} bytes, {} segments, {} edges, {} differ",
        text.lines().count(),
        job.len(),
        told.segments.len(),
        difference.edges,
        difference.wrong
    );
    assert_eq!(
        (difference.wrong, difference.late),
        (0, Some(0)),
        "{difference:?}"
    );
}

/// `ferrocnc job ...`: whether it succeeded, and what it said: on stdout, on stderr.
fn tool(arguments: &[&str]) -> (bool, String, String) {
    let mut tool = std::process::Command::new(ferrocnc_tests::program("ferrocnc"));
    let output = tool.arg("job").args(arguments).output();
    let output = output.expect("the tool runs; `cargo xtask test jobs` builds it");
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    (
        output.status.success(),
        text(&output.stdout),
        text(&output.stderr),
    )
}

#[test]
fn the_tool_sends_a_job_watches_it_to_its_end_and_says_what_is_wrong_with_the_remedy() {
    let folder = std::env::temp_dir().join(format!("ferrocnc-jobs-{}", std::process::id()));
    std::fs::create_dir_all(&folder).expect("a folder");
    let file = folder.join("square.job").display().to_string();
    let square = "G0 X5 Y5\nM3\nG1 X9 F6000\nG1 Y9\nG1 X5\nG1 Y5\nM5\nG0 X0 Y0\nM2\n";
    let mut program = Program::from_gcode(square.as_bytes(), Dialect::default().dwell)
        .unwrap_or_else(|error| panic!("{error}"));
    program.name = "square".to_owned();
    std::fs::write(&file, program.to_job()).expect("the job");
    let machine = drawing::folder().join("machine.toml").display().to_string();
    let plotter = Plotter::twin();
    let at = plotter.jobs.to_string();

    let (ok, _, said) = tool(&["start", &at, "square"]);
    assert!(
        !ok && said.contains("ferrocnc job list shows those it has"),
        "{said}"
    );
    let (ok, said, wrong) = tool(&["send", &at, &file]);
    assert!(
        ok && said.starts_with("square is on the board: "),
        "{said}{wrong}"
    );
    let (ok, _, said) = tool(&["start", &at, "square"]);
    assert!(
        !ok && said.contains("--machine MACHINE.toml sends one"),
        "{said}"
    );
    let (ok, said, wrong) = tool(&["list", &at, "--json"]);
    let list: serde_json::Value = serde_json::from_str(&said).unwrap_or_default();
    assert!(
        ok && list["jobs"][0]["name"] == "square" && list["jobs"][0]["ready"] == true,
        "{said}{wrong}"
    );
    let (ok, said, wrong) = tool(&["start", &at, "square", "--machine", &machine, "--json"]);
    assert!(ok, "{said}{wrong}");
    let last: serde_json::Value =
        serde_json::from_str(said.lines().last().unwrap_or_default()).unwrap_or_default();
    assert_eq!(
        (&last["end"], &last["progress"], &last["state"]),
        (&"done".into(), &100.into(), &"stopped".into()),
        "{said}"
    );
    let (ok, said, _) = tool(&["status", &at]);
    assert!(ok && said.contains("ended last: done"), "{said}");
    let (ok, _, said) = tool(&["pause", &at]);
    assert!(!ok && said.contains("not now"), "{said}");
    let (ok, said, _) = tool(&["delete", &at, "square"]);
    assert!(ok && said.starts_with("square is deleted"), "{said}");
    let (ok, _, said) = tool(&["delete", &at, "square"]);
    assert!(!ok && said.contains("the board has no such job"), "{said}");
    let emitted = plotter.events();
    let drawn = pins::drawn(&program, &drawing::machine(), &emitted)
        .unwrap_or_else(|error| panic!("{error}"));
    assert!(
        drawn.deviation < 0.0225 && drawn.missing < 0.0225,
        "{} {}",
        drawn.deviation,
        drawn.missing
    );
    let _ = std::fs::remove_dir_all(&folder);
}

#[test]
fn a_job_that_was_sent_is_started_and_looked_at_from_the_console() {
    let machine = drawing::machine();
    let program = Program::from_gcode(b"G1 X3 F6000\nG1 Y2\nM2\n", Dialect::default().dwell)
        .unwrap_or_else(|error| panic!("{error}"));
    let plotter = Plotter::twin();
    let mut board = plotter.board();
    board.put_machine(&machine.to_board()).expect("a machine");
    let sent = board.send("a line", &program.to_job(), |_, _| ());
    sent.expect("the job is taken");
    let at = plotter.console.to_string();
    let say = |line: &str| {
        let mut tool = std::process::Command::new(ferrocnc_tests::program("ferrocnc"));
        let output = tool.args(["console", &at, "-c", line]).output();
        String::from_utf8_lossy(&output.expect("the tool runs").stdout).into_owned()
    };
    let said = say("job list");
    assert!(said.contains("a line: "), "{said}");
    let said = say("job start a line");
    assert!(said.contains("checking: a line, 0 %"), "{said}");
    let report = plotter.finish(&mut board);
    assert_eq!((report.end, report.attended), (End::Done, false));
    let said = say("job");
    assert!(said.contains("ended last: done"), "{said}");
    let said = say("job pause");
    assert!(said.contains("refused: not now: the state"), "{said}");
    drop(board);
    let told = pins::predict(&program, &machine).unwrap_or_else(|error| panic!("{error}"));
    let difference = told.compare(&plotter.events());
    assert_eq!((difference.wrong, difference.late), (0, Some(0)));
}

#[test]
fn a_start_whose_answer_is_lost_is_asked_again_and_acted_on_once() {
    let machine = drawing::machine();
    let program = Program::from_gcode(b"G1 X3 F6000\nG1 Y2\nM2\n", Dialect::default().dwell)
        .unwrap_or_else(|error| panic!("{error}"));
    let plotter = Plotter::twin();
    let mut board = plotter.board();
    board.put_machine(&machine.to_board()).expect("a machine");
    board
        .send("line", &program.to_job(), |_, _| ())
        .expect("the job is taken");
    drop(board);
    // The answer to the Hello comes, the one to the Start does not.
    let welcome = wire::jobs::OVERHEAD + 24;
    let scissors = Scissors::deaf(plotter.jobs, &[welcome]);
    let mut board = scissors.board();
    let report = board
        .start("line", None)
        .expect("it is begun once, and said twice");
    assert_eq!(scissors.cuts(), 1);
    assert_ne!(report.state, State::Stopped, "{report:?}");
    let report = plotter.finish(&mut board);
    assert_eq!((report.end, report.refused), (End::Done, 0), "{report:?}");
    drop(board);
    let drawn = plotter.events();
    assert_eq!(
        drawn.len(),
        5 * 80,
        "one line of 3 mm and one of 2, and no more"
    );
}
