//! Jobs from the drawing to the pins. The drawing of `tests/drawing` is prepared, planned and
//! played, and the pen's path is rebuilt from the edges at the pins.
//!
//! `cargo xtask test jobs` builds what this needs. `FERROCNC_JOBS_CORES` is the folder of the
//! Verilated cores of `tests/boards/jobs.toml`; pictures are left in `FERROCNC_REPORTS`, else in
//! `target/reports`.

use ferrocnc_tests::drawing::{self, TOLERANCE, Watch};
use ferrocnc_tests::plotter::{Plotter, Scissors};
use ferrocnc_tests::stops::{Job, Shape, Used, Way};
use host::client::Client;
use host::job::client::{self, Board};
use host::job::pins::{self, Pin, Prediction};
use host::job::program::{Dialect, Program};
use host::job::stream::Streamer;
use host::keys::Keys;
use rand::Rng as _;
use sim::model::board::pages;
use sim::soc::{Cores, CoresPins};
use std::collections::VecDeque;
use std::fmt::Write;
use std::io::{BufRead as _, BufReader, Read as _, Write as _};
use std::net::{Ipv4Addr, Shutdown, SocketAddr, SocketAddrV4, TcpStream};
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};
use wire::crc::crc32;
use wire::exchange::{STATUS_HEAD, STATUS_STEPGEN, StateWord};
use wire::jobs::{Command as Code, End, FRAME, Request, State};
use wire::{FaultReason, Name, Refusal, map};

const ARM: u32 = wire::regmap::watchdog::CONTROL_KEY_ARM;
const CLEAR: u32 = wire::regmap::watchdog::CONTROL_KEY_CLEAR;
const PUSH: u32 = wire::regmap::segments::PUSH as u32;
const CONTROL: u32 = wire::regmap::segments::CONTROL as u32;
const MASK: u32 = wire::regmap::segments::MASK as u32;
const STATUS: u32 = wire::regmap::segments::STATUS as u32;
const START: u32 = wire::regmap::segments::CONTROL_COMMAND_START;

/// Plays a prediction on the bare cores: writes its segments as they have room.
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
    let verdict = drawing::judge(
        &told,
        &machine,
        &emitted,
        &ferrocnc_tests::reports().join("drawing-cores.png"),
    );
    println!(
        "{}; {:.2} s of the board's time",
        verdict.text(),
        verdict.clocks as f64 / f64::from(machine.clock)
    );
    ferrocnc_tests::report(
        "jobs-cores",
        &verdict.figures("Verilated cores, planned on the PC", None),
    );
    verdict.assert_good(&told);
}

/// Sends this with the drawing's machine, and starts it unattended.
fn begin(board: &mut Board, name: &str, program: &Program) {
    let machine = drawing::machine().to_board();
    board.put_machine(&machine).expect("a machine");
    let entry = board.send(name, &program.to_job(), |_, _| ());
    assert!(entry.expect("the job is taken").ready);
    board.start(name, None).expect("it begins");
}

/// The drawing, sent and started: it is on its curves, every edge in its clock.
fn draws(plotter: Plotter, picture: &str) {
    let (machine, program) = (drawing::machine(), drawing::program(TOLERANCE));
    let told = pins::predict(&program, &machine).unwrap_or_else(|error| panic!("{error}"));
    let mut board = plotter.board();
    begin(&mut board, "drawing", &program);
    let report = plotter.finish(&mut board);
    assert_eq!(
        (report.end, report.progress),
        (End::Done, 100),
        "{report:?}"
    );
    assert_eq!(report.steps.map(i64::from), told.steps);
    assert_eq!(report.segments as usize, told.segments.len());
    drop(board);
    let emitted = plotter.events();
    let picture = ferrocnc_tests::reports().join(picture);
    let verdict = drawing::judge(&told, &machine, &emitted, &picture);
    println!("{}", verdict.text());
    verdict.assert_good(&told);
}

#[test]
fn a_drawing_sent_to_the_twin_and_started_is_on_its_curves_and_every_edge_in_its_clock() {
    draws(Plotter::twin(), "drawing.png");
}

/// So many times slower than real time: then a machine at work, too, is never late for the 64
/// segments a board has in hand.
const SLOWER: u32 = 10;

#[test]
fn a_drawing_streamed_to_a_board_without_sdram_is_on_its_curves_and_every_edge_in_its_clock() {
    draws(Plotter::streamed(SLOWER, ""), "drawing-streamed.png");
}

/// As CAM programs go: a face in many passes, each a run of lines a third of a millimetre long over
/// a wavy surface, arcs at its ends, the tool lifted between layers. `lines` lines of G-code.
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
fn a_start_with_a_lost_answer_is_asked_again_and_acted_on_once() {
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

/// A job waits for the operator, and a client has the line and keeps it.
fn stops_beside(plotter: Plotter) {
    let program = Program::from_gcode(b"G1 X3 F6000\nM0\nG1 Y2\nM2\n", Dialect::default().dwell);
    let program = program.unwrap_or_else(|error| panic!("{error}"));
    let mut holder = plotter.board();
    begin(&mut holder, "held", &program);
    let report = |holder: &mut Board| holder.report().unwrap_or_else(|error| panic!("{error}"));
    while report(&mut holder).state != State::Paused {
        std::thread::sleep(Duration::from_millis(20));
    }
    for (code, state) in [(Code::Pause, State::Paused), (Code::Stop, State::Stopping)] {
        let said = client::halt_within(plotter.jobs, code, Duration::from_secs(120));
        let said = said.unwrap_or_else(|error| panic!("{code}: {error}"));
        assert_eq!(said.state, state, "{said:?}");
        // The other one is still there.
        report(&mut holder);
    }
    assert_eq!(plotter.finish(&mut holder).end, End::Stopped);
    // The line is free now, and it is the same.
    holder.hang_up();
    let said = client::halt_within(plotter.jobs, Code::Stop, Duration::from_secs(120));
    assert_eq!(said.map(|said| said.state).ok(), Some(State::Stopped));
    plotter.events();
}

#[test]
fn stop_and_pause_are_taken_while_another_client_holds_the_line() {
    stops_beside(Plotter::twin());
    stops_beside(Plotter::streamed(SLOWER, ""));
}

#[test]
fn a_pc_whose_cable_is_out_claims_to_know_no_position_until_it_is_back() {
    let plotter = Plotter::streamed(SLOWER, "");
    let mut board = plotter.board();
    board
        .put_machine(&drawing::machine().to_board())
        .expect("a machine");
    let mut until = |known: bool| {
        let end = Instant::now() + PATIENCE;
        while board.report().expect("a report").known != known {
            assert!(Instant::now() < end, "known: {}", !known);
        }
    };
    until(true);
    plotter.control("fault pull");
    until(false);
    plotter.control("fault plug");
    until(true);
    drop(board);
    plotter.events();
}

#[test]
fn a_stop_behind_many_requests_counts_though_its_client_has_closed_its_side() {
    let plotter = Plotter::streamed(SLOWER, "");
    let program = Program::from_gcode(b"G1 X3 F6000\nM0\nG1 Y2\nM2\n", Dialect::default().dwell);
    let program = program.unwrap_or_else(|error| panic!("{error}"));
    let mut board = plotter.board();
    begin(&mut board, "held", &program);
    board.hang_up();
    let stop = Request::Command {
        code: Code::Stop.code(),
        flags: 0,
        keepalive: 0,
        name: Name::EMPTY,
    };
    let looks = std::iter::repeat_n(Request::List { index: 0 }, 150);
    let requests = [Request::Hello { client: 77 }]
        .into_iter()
        .chain(looks)
        .chain([stop]);
    let mut frame = [0; FRAME];
    let mut bytes = Vec::new();
    for (id, request) in (1..).zip(requests) {
        let length = request.emit(id, &mut frame);
        bytes.extend_from_slice(&frame[..length]);
    }
    let mut stream = TcpStream::connect(plotter.jobs).expect("it listens");
    stream.write_all(&bytes).expect("there is room");
    stream.shutdown(Shutdown::Write).expect("half of it");
    let mut answers = Vec::new();
    // The program may close before all answers are read.
    let _ = stream.read_to_end(&mut answers);
    assert_eq!(plotter.finish(&mut board).end, End::Stopped);
    plotter.events();
}

/// `ferrocnc job serve`, as a program of its own.
struct Serving {
    child: Child,
    at: SocketAddrV4,
}

impl Serving {
    fn begin(plotter: &Plotter) -> Self {
        let mut tool = Command::new(ferrocnc_tests::program("ferrocnc"));
        let board = plotter.udp.to_string();
        tool.args(["--json", "job", "serve", &board, "--at", "127.0.0.1:0"]);
        let mut child = tool.stdout(Stdio::piped()).spawn().expect("the tool runs");
        let mut line = String::new();
        let mut out = BufReader::new(child.stdout.take().expect("its output"));
        out.read_line(&mut line).expect("what it says");
        let said: serde_json::Value = serde_json::from_str(&line).unwrap_or_default();
        let at = said["jobs"].as_str().and_then(|at| at.parse().ok());
        let at = at.unwrap_or_else(|| panic!("it does not say where the jobs are: {line:?}"));
        Serving { child, at }
    }

    fn board(&self) -> Board {
        let patience = Duration::from_secs(120);
        let board = Board::with_patience(self.at, Keys::default(), patience);
        board.unwrap_or_else(|error| panic!("{error}"))
    }

    /// Sends this, and starts it unattended.
    fn start(&self, program: &Program) -> Board {
        let mut board = self.board();
        begin(&mut board, "job", program);
        board
    }

    /// Lets the drawing come so far that all three axes and the pen have been at work, and 64
    /// segments wait.
    fn draw_a_little(&self) {
        let mut board = self.start(&drawing::program(TOLERANCE));
        loop {
            let report = board.report().unwrap_or_else(|error| panic!("{error}"));
            assert_eq!(report.end, End::None, "{report:?}");
            if report.segments > 150 {
                return;
            }
            std::thread::sleep(Duration::from_millis(20));
        }
    }
}

impl Drop for Serving {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// The board's state once nothing moves, read without the session; its axes' steps, and when that
/// was.
fn at_rest(plotter: &Plotter) -> (StateWord, [i64; 3], u64) {
    let mut client = Client::open(&plotter.address()).expect("a socket");
    loop {
        let words = client.read(&[map::STATUS, map::SESSION_OWNER_PORT]);
        let words = words.unwrap_or_else(|error| panic!("{error}"));
        let state = StateWord::from_word(words[0]).expect("a state");
        if !state.enabled && words[1] == 0 {
            // An idle board samples a hundred times a second of its own.
            std::thread::sleep(Duration::from_millis(20 * u64::from(SLOWER)));
            let place = |axis: usize| STATUS_HEAD + axis * STATUS_STEPGEN + 1;
            let addresses = [4, 5, place(0), place(1), place(2)];
            let addresses = addresses.map(|word| map::STATUS + 4 * word as u32);
            let words = client.read(&addresses).expect("the counters");
            let clock = u64::from(words[1]) << 32 | u64::from(words[0]);
            let steps = [2, 3, 4].map(|word| i64::from(words[word] as i32));
            return (state, steps, clock);
        }
        std::thread::sleep(Duration::from_millis(20));
    }
}

fn steps_of(events: &[pins::Event]) -> [i64; 3] {
    let mut steps = [0; 3];
    for (_, pin) in events {
        if let Pin::Step { axis, forward } = *pin {
            steps[axis] += if forward { 1 } else { -1 };
        }
    }
    steps
}

/// The clocks of its steps, from the first on.
fn steps_at(events: &[pins::Event]) -> Vec<u64> {
    let steps = events
        .iter()
        .filter(|(_, pin)| matches!(pin, Pin::Step { .. }));
    let clocks: Vec<u64> = steps.map(|(clock, _)| *clock).collect();
    clocks.iter().map(|clock| clock - clocks[0]).collect()
}

/// How many edges were as predicted before the first that was not, and the clock of the last that
/// was, from the first step on.
fn as_told(told: &Prediction, emitted: &[pins::Event]) -> (usize, u64) {
    let (mut told, emitted) = (steps_at(&told.events), steps_at(emitted));
    told.sort_unstable();
    let same = told
        .iter()
        .zip(&emitted)
        .take_while(|(a, b)| a == b)
        .count();
    (same, told[same.saturating_sub(1)])
}

const BACK: &[u8] = b"M5\nG0 X5 Y5\nG0 X0 Y0 Z0\nM2\n";

/// Executes something short from where the axes are to home, with another PC.
fn goes_home(plotter: Plotter) -> Vec<pins::Event> {
    let serving = Serving::begin(&plotter);
    let back = Program::from_gcode(BACK, Dialect::default().dwell);
    let mut board = serving.start(&back.unwrap_or_else(|error| panic!("{error}")));
    let report = plotter.finish(&mut board);
    assert_eq!(
        (report.end, report.steps),
        (End::Done, [0; 3]),
        "{report:?}"
    );
    drop(board);
    drop(serving);
    plotter.events()
}

#[test]
fn a_pc_that_vanishes_while_it_streams_is_a_soft_stop_on_known_positions_and_another_goes_on() {
    let machine = drawing::machine();
    let told = pins::predict(&drawing::program(TOLERANCE), &machine);
    let told = told.unwrap_or_else(|error| panic!("{error}"));
    let plotter = Plotter::without_sdram(SLOWER);
    let mut serving = Serving::begin(&plotter);
    serving.draw_a_little();
    serving.child.kill().expect("it can be killed");
    let (state, steps, clock) = at_rest(&plotter);
    assert_eq!(
        (state.reason, state.position_trusted),
        (FaultReason::Watchdog, true),
        "{state:?}"
    );
    assert_ne!(steps, [0; 3], "it stopped on its way");
    drop(serving);
    let emitted = goes_home(plotter);
    // The counters said what the pins did, and another PC counted from there.
    let there = emitted.partition_point(|(at, _)| *at <= clock);
    assert_eq!(steps_of(&emitted[..there]), steps);
    assert_eq!(steps_of(&emitted), [0; 3]);
    let (same, brakes) = as_told(&told, &emitted[..there]);
    let edges: Vec<u64> = steps_at(&emitted[..there]);
    let ms = |clocks: u64| clocks as f64 * 1e3 / f64::from(machine.clock);
    let (last, before) = (edges[edges.len() - 1], edges[edges.len() - 2]);
    println!(
        "{same} edges as predicted, then {} in {:.1} ms, the last {:.2} ms behind the one before",
        edges.len() - same,
        ms(last - brakes),
        ms(last - before)
    );
    assert!(same > 1000, "{same} edges as predicted");
    assert!(
        ms(last - brakes) < 250.0,
        "longer than the watchdog's grace"
    );
}

#[test]
fn ctrl_c_stops_what_is_streamed_on_its_path_and_gives_the_board_back() {
    let plotter = Plotter::without_sdram(SLOWER);
    let mut serving = Serving::begin(&plotter);
    serving.draw_a_little();
    let id = serving.child.id().to_string();
    let asked = Command::new("kill").args(["-INT", &id]).status();
    assert!(asked.expect("kill").success());
    assert!(serving.child.wait().expect("its end").success());
    let (state, steps, _) = at_rest(&plotter);
    assert!(state.position_trusted, "{state:?}");
    assert_ne!(state.reason, FaultReason::Watchdog, "{state:?}");
    assert_ne!(steps, [0; 3], "it stopped on its way");
    drop(serving);
    assert_eq!(steps_of(&goes_home(plotter)), [0; 3]);
}

#[test]
fn a_wire_that_loses_doubles_and_reorders_datagrams_changes_no_edge_of_what_is_streamed() {
    let program = Program::from_gcode(cam(600).as_bytes(), Dialect::default().dwell)
        .unwrap_or_else(|error| panic!("{error}"));
    let machine = drawing::machine();
    let told = pins::predict(&program, &machine).unwrap_or_else(|error| panic!("{error}"));
    let plotter = Plotter::streamed(SLOWER, "loss=1% dup=1% reorder=1% seed=6");
    let mut board = plotter.board();
    begin(&mut board, "cam", &program);
    let report = plotter.finish(&mut board);
    assert_eq!(report.end, End::Done, "{report:?}");
    assert_eq!(report.steps.map(i64::from), told.steps);
    drop(board);
    let mut client = Client::open(&plotter.address()).expect("a socket");
    let stale = map::COUNTERS_REFUSED + 4 * Refusal::Stale.index() as u32;
    let words = client.read(&[map::COUNTERS, stale]).expect("the counters");
    let difference = told.compare(&plotter.events());
    println!(
        "{} datagrams, {} of them too late or twice; {} edges, {} differ",
        words[0], words[1], difference.edges, difference.wrong
    );
    assert!(words[1] > 0, "the board refused none: no trouble at all");
    assert_eq!(
        (difference.wrong, difference.late),
        (0, Some(0)),
        "{difference:?}"
    );
}

/// What ends a job that is streamed over a network.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Strikes {
    /// The cable.
    Pulled,
    Frozen,
    Reset,
    Stop,
    Pause,
    /// The client that started it.
    Silence,
    CtrlC,
}

/// Longer than any question to the board goes unanswered.
const PATIENCE: Duration = Duration::from_secs(120);
const STRIKES: [Strikes; 7] = [
    Strikes::Pulled,
    Strikes::Stop,
    Strikes::Reset,
    Strikes::Silence,
    Strikes::Frozen,
    Strikes::CtrlC,
    Strikes::Pause,
];
/// Jobs, unless `FERROCNC_STOPS` says another number.
const STREAMED: u64 = 2;
/// So slow that a busy machine, too, has the whole line on the board when it is struck.
const ANY: Shape = Shape {
    takes: 0.004..0.1,
    speed: 500.0..20_000.0,
    lasts: 0.05,
};

impl Strikes {
    fn way(self) -> Way {
        match self {
            Strikes::Pulled | Strikes::Frozen => Way::Own,
            Strikes::Reset => Way::Cut,
            Strikes::Stop | Strikes::Pause | Strikes::Silence | Strikes::CtrlC => Way::Path,
        }
    }

    fn strike(self, plotter: &mut Plotter, board: &mut Board) {
        match self {
            Strikes::Pulled => drop(plotter.control("fault pull")),
            Strikes::Frozen => drop(plotter.control("freeze-cpu 1")),
            Strikes::Reset => drop(plotter.control("ext-reset 1")),
            Strikes::Silence => {}
            Strikes::CtrlC => plotter.end_streaming(),
            Strikes::Stop => {
                board.command(Code::Stop).expect("it is taken");
            }
            Strikes::Pause => {
                // It may be over.
                let _over = board.command(Code::Pause);
            }
        }
    }

    fn over(plotter: &Plotter) {
        for command in ["fault plug", "freeze-cpu 0", "ext-reset 0"] {
            plotter.control(command);
        }
    }
}

/// Until the pins have come to rest behind a closed gate, or in a pause.
fn stood(plotter: &Plotter, board: &mut Board, strikes: Strikes) -> [i64; 3] {
    if strikes == Strikes::Pause {
        loop {
            let report = board.report().unwrap_or_else(|error| panic!("{error}"));
            if report.stands || report.state == State::Stopped {
                return plotter.pins().0;
            }
            std::thread::sleep(Duration::from_millis(5));
        }
    }
    loop {
        let (counts, open) = plotter.pins();
        if !open {
            return counts;
        }
        std::thread::sleep(Duration::from_millis(5));
    }
}

/// Until so many pulses were made, of all axes together, or something else was quicker.
fn until_made(plotter: &Plotter, moment: i64) {
    loop {
        let (counts, open) = plotter.pins();
        let made: i64 = counts.iter().map(|count| count.abs()).sum();
        if made >= moment || made > 0 && !open {
            return;
        }
        std::thread::sleep(Duration::from_millis(1));
    }
}

/// A random machine and a random moment, over real datagrams and through the host's own program;
/// what was used of the way allowed.
fn struck(seed: u64) -> (Strikes, f64) {
    let mut random = rand_pcg::Pcg32::new(seed, 3);
    let strikes = STRIKES[seed as usize % STRIKES.len()];
    let job = Job::any(&mut random, &ANY);
    let told = format!("FERROCNC_SEED={seed}: {strikes:?}, {:?}", job.axes);
    let mut plotter = Plotter::streamed(SLOWER, "");
    let mut board = plotter.board();
    board
        .put_machine(&job.machine.to_board())
        .expect("a machine");
    let entry = board.send("any", &job.program.to_job(), |_, _| ());
    assert!(entry.expect("the job is taken").ready, "{told}");
    let silence = (strikes == Strikes::Silence).then_some(Duration::from_millis(500));
    board.start("any", silence).expect("it begins");
    let most: i64 = job.told.steps.iter().map(|steps| steps.abs()).sum();
    until_made(&plotter, random.random_range(most / 20..most * 9 / 10));
    strikes.strike(&mut plotter, &mut board);
    let counts = stood(&plotter, &mut board, strikes);
    Strikes::over(&plotter);
    if strikes == Strikes::Pause {
        // A pause that came behind the end is refused.
        let _over = board.command(Code::Stop);
    }
    // It may have been over before.
    let cut = strikes == Strikes::Reset && counts != job.told.steps;
    // With the cable out, the PC does not know what the board does.
    let hidden = matches!(strikes, Strikes::Pulled | Strikes::Frozen | Strikes::Reset);
    let end = Instant::now() + PATIENCE;
    // Without its PC there is no report.
    if strikes != Strikes::CtrlC {
        loop {
            let report = plotter.finish(&mut board);
            let right = report.steps.map(i64::from) == counts;
            assert!(
                !report.known || right && !cut,
                "{told}: {report:?}, stands at {counts:?}"
            );
            if right && (report.known || hidden) {
                break;
            }
            // A question to the board may be lost.
            assert!(
                Instant::now() < end,
                "{told}: {report:?}, stands at {counts:?}"
            );
        }
    }
    let (state, steps, _) = at_rest(&plotter);
    assert_eq!(steps, counts, "{told}: {state:?}");
    assert!(!(state.position_trusted && cut), "{told}: {state:?}");
    // A processor that was away may have missed the grace's end.
    let doubtful = matches!(strikes, Strikes::Frozen | Strikes::Reset);
    assert!(state.position_trusted || doubtful, "{told}: {state:?}");
    drop(board);
    let emitted = plotter.events();
    assert_eq!(steps_of(&emitted), counts, "{told}: it moves again");
    (strikes, job.stands_within(&emitted, strikes.way(), &told))
}

#[test]
fn any_streamed_job_stops_each_axis_within_its_own_way_whatever_strikes() {
    let first = ferrocnc_tests::from_environment("FERROCNC_SEED", 1);
    let mut used = Used::default();
    for seed in first..first + ferrocnc_tests::from_environment("FERROCNC_STOPS", STREAMED) {
        let (strikes, part) = struck(seed);
        used.see(strikes, part);
    }
    used.print("streamed over UDP");
}

#[test]
fn a_board_that_executes_jobs_by_itself_refuses_the_window() {
    let plotter = Plotter::twin();
    let any = SocketAddr::from((Ipv4Addr::LOCALHOST, 0));
    let error = Streamer::open(&plotter.address(), Keys::default(), any);
    let error = error.expect_err("it executes jobs itself").to_string();
    assert!(error.contains("executes jobs by itself (ready)"), "{error}");

    let patience = Duration::from_millis(300);
    let mut client = Client::open(&plotter.address()).expect("a socket");
    client.acquire().expect("its session");
    let mut client = client.with_patience(patience);
    let refused = map::COUNTERS_REFUSED + 4 * Refusal::ReadOnly.index() as u32;
    let count = |client: &mut Client| client.read(&[refused]).expect("the counter")[0];
    let before = count(&mut client);
    for base in [map::SEGMENTS, map::SESSION_SEGMENTS] {
        let answer = client.write_then_read(base, &[6000], &[map::DESCRIBE]);
        assert!(answer.is_err(), "{answer:?}");
    }
    assert!(count(&mut client) >= before + 2);
    let status = client.read(&[map::SEGMENTS + 4 * STATUS]);
    assert_eq!(
        status.expect("every host may read it")[0] & 0xff,
        0,
        "nothing waits"
    );
    assert_eq!(plotter.events().len(), 0);
}
