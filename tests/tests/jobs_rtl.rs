//! Whole jobs on the Verilated board: real gateware, release image, the jobs program in SDRAM; sent
//! and started over TCP by the tool's own client.
//!
//! `cargo xtask test plotter` builds what this needs, and runs the tests that are ignored, too:
//! what they show is in `sim/tests/executor`, with the models of the cores, and takes minutes here.
//! `FERROCNC_PROFILE=FILE` makes the dense arc write where the processor was while it planned: a
//! line for each address, in hexadecimal, and how many looks found it there.

use ferrocnc_tests::drawing::{self, TOLERANCE};
use ferrocnc_tests::pins::{self, Event, Pin, Prediction};
use ferrocnc_tests::stops::{Job, STEPS, Shape, Used, Way};
use ferrocnc_tests::wired::Wired;
use host::job::client::JobError;
use host::job::machine::{Direction, Home, Level, MachineFile};
use host::job::program::{Dialect, Program};
use host::job::words::WordsLine;
use rand::Rng;
use sim::plant::Switch;
use std::sync::{LazyLock, Mutex, MutexGuard};
use std::time::Duration;
use wire::jobs::{End, JobCommand, Report, State};

const MS: u64 = 60_000;
/// Segments the core holds.
const ROOM: u8 = 64;
/// The way home.
const HOME: &str = "G0 X0 Y0 Z0\nM2\n";

fn gcode(name: &str, text: &str) -> Program {
    let program = Program::from_gcode(text.as_bytes(), Dialect::default().dwell);
    let mut program = program.unwrap_or_else(|error| panic!("{error}"));
    program.name = name.to_owned();
    program
}

fn predict(program: &Program, machine: &MachineFile) -> Prediction {
    pins::predict(program, machine).unwrap_or_else(|error| panic!("{error}"))
}

/// On the board, and its machine.
fn put(wired: &mut Wired, program: &Program, machine: &MachineFile) {
    wired.judge(machine);
    let entry = wired.with(|board| {
        board.put_machine(&machine.to_board())?;
        board.send(&program.name, &program.to_job(), |_, _| ())
    });
    let entry = entry.unwrap_or_else(|error| panic!("{error}"));
    assert!(entry.ready, "{entry:?}");
}

fn report(wired: &mut Wired) -> Report {
    let report = wired.with(|board| board.report());
    report.unwrap_or_else(|error| panic!("{error}"))
}

/// Two turns of a screw with so short chords that it needs more than 1000 segments a second.
fn dense() -> (Program, MachineFile) {
    let mut machine = drawing::machine();
    machine.chord_tolerance = 0.001;
    for axis in [&mut machine.x, &mut machine.y] {
        (axis.speed, axis.acceleration) = (400.0, 100_000.0);
    }
    (machine.z.speed, machine.z.acceleration) = (50.0, 10_000.0);
    let turns = "G0 X5 Y10 Z0\nG2 I5 Z1 F6300\nG2 I5 Z2\nG0 X0 Y0 Z0\nM2\n";
    (gcode("dense", turns), machine)
}

/// Segments a second that a program has to have: of the tenth of a second in which they are
/// densest.
fn asked(told: &Prediction, clock: u32) -> f64 {
    let window = u64::from(clock / 10);
    let begins: Vec<u64> = told.segments.iter().map(|(begin, _)| *begin).collect();
    let most = begins.iter().enumerate().map(|(at, begin)| {
        let end = begins.partition_point(|other| *other < begin + window);
        end - at
    });
    most.max().unwrap_or(0) as f64 * 10.0
}

/// How fast it plans, seen from outside: every millisecond, what was pushed so far and what of it
/// waits.
#[derive(Default)]
struct Planning {
    looks: Vec<(u64, u32, u8)>,
}

impl Planning {
    fn look(&mut self, wired: &mut Wired) {
        let (begun, level) = wired.segments();
        let pushed = begun.wrapping_add(level.into());
        self.looks.push((wired.machine.clock(), pushed, level));
    }

    /// Segments, and the clocks they took, while there was room for more and more to come.
    fn busy(&self) -> (u32, u64) {
        let first = self.looks.first().map_or(0, |look| look.1);
        let last = self.looks.last().map_or(0, |look| look.1);
        let (mut segments, mut clocks) = (0, 0);
        for pair in self.looks.windows(2) {
            let ((from, before, was), (to, after, is)) = (pair[0], pair[1]);
            if before > first && after < last && was.max(is) < ROOM - 2 {
                segments += after - before;
                clocks += to - from;
            }
        }
        (segments, clocks)
    }

    /// Segments a second while it was busy.
    fn rate(&self) -> f64 {
        let (segments, clocks) = self.busy();
        f64::from(segments) * 1e3 * MS as f64 / clocks.max(1) as f64
    }
}

/// The board of the tests in mid-job, for one of them after the other: to switch it on takes longer
/// than such a job. Its axes are at home, and known: a test that ends otherwise has a board of its
/// own.
fn board() -> MutexGuard<'static, Wired> {
    static BOARD: LazyLock<Mutex<Wired>> = LazyLock::new(|| Mutex::new(Wired::boot()));
    let mut board = BOARD.lock().unwrap_or_else(|failed| {
        // The position after a failed test is not known.
        BOARD.clear_poison();
        let mut board = failed.into_inner();
        *board = Wired::boot();
        board
    });
    board.events();
    let left = board.with(|board| board.report()).expect("a report");
    assert!(left.known || !left.machine, "a test left it so: {left:?}");
    board
}

/// Starts a job and lets it come to its end; how fast it was planned.
fn play(wired: &mut Wired, name: &str) -> (Report, Planning) {
    let started = wired.with(|board| board.start(name, None));
    started.unwrap_or_else(|error| panic!("{error}"));
    let mut planning = Planning::default();
    loop {
        for _ in 0..20 {
            wired.run(MS);
            planning.look(wired);
        }
        let report = report(wired);
        if report.state == State::Stopped {
            return (report, planning);
        }
    }
}

#[test]
fn a_drawing_sent_to_the_board_and_started_is_on_its_curves_and_every_edge_in_its_clock() {
    let (machine, program) = (drawing::machine(), drawing::program(TOLERANCE));
    let told = predict(&program, &machine);
    let mut wired = Wired::boot();
    put(&mut wired, &program, &machine);
    let begun = wired.machine.clock();
    let (report, planning) = play(&mut wired, &program.name);
    assert_eq!(
        (report.end, report.progress),
        (End::Done, 100),
        "{report:?}"
    );
    assert_eq!(report.steps.map(i64::from), told.steps);
    assert_eq!(report.segments as usize, told.segments.len());
    let picture = ferrocnc_tests::reports().join("job.png");
    let verdict = drawing::judge(&told, &machine, &wired.events(), &picture);
    println!(
        "{}; {:.2} s of the board's time, planned at {:.0} segments/s",
        verdict.text(),
        (wired.machine.clock() - begun) as f64 / f64::from(machine.clock),
        planning.rate(),
    );
    let player = "the Verilated board with its firmware, started over TCP";
    ferrocnc_tests::report("jobs", &verdict.figures(player, Some(planning.rate())));
    verdict.assert_good(&told);
}

#[test]
#[ignore = "named: cargo xtask test plotter"]
fn a_dense_arc_is_planned_at_a_thousand_segments_a_second_and_every_edge_is_in_its_clock() {
    let (program, machine) = dense();
    let told = predict(&program, &machine);
    println!(
        "{} segments in {:.3} s, {:.0} segments/s where they are densest",
        told.segments.len(),
        told.clocks as f64 / f64::from(machine.clock),
        asked(&told, machine.clock)
    );
    let mut wired = Wired::boot();
    println!("started after {} clocks", wired.machine.clock());
    put(&mut wired, &program, &machine);
    println!("sent after {} clocks", wired.machine.clock());
    let profile = std::env::var_os("FERROCNC_PROFILE");
    if profile.is_some() {
        wired.profile();
    }
    let begun = wired.machine.clock();
    let (report, planning) = play(&mut wired, "dense");
    if let (Some(path), Some(profile)) = (profile, wired.take_profile()) {
        println!("{} clocks without the ROM at most", profile.longest);
        std::fs::write(path, profile.text()).expect("the profile");
    }
    let (segments, clocks) = planning.busy();
    println!(
        "{segments} segments planned in {clocks} clocks: {:.0} segments/s, {} clocks each; ended {:?} after {} clocks, {} segments",
        planning.rate(),
        clocks / u64::from(segments.max(1)),
        report.end,
        wired.machine.clock() - begun,
        report.segments
    );
    let difference = told.compare(&wired.events());
    println!("{difference:?}");
    ferrocnc_tests::report(
        "jobs-dense",
        &serde_json::json!({
            "segments": report.segments, "asked_per_second": asked(&told, machine.clock).round(),
            "planned_per_second": planning.rate().round(), "clocks_per_segment": clocks / u64::from(segments.max(1)),
            "edges": difference.edges, "edge_differences": difference.wrong,
        }),
    );
    assert_eq!(report.end, End::Done, "{report:?}");
    assert!(planning.rate() >= 1000.0, "{} segments/s", planning.rate());
    assert_eq!(
        (difference.wrong, report.steps.map(i64::from)),
        (0, told.steps)
    );
}

// ---- in the middle of a job ---------------------------------------------------------------------

/// The inputs of the board that the tests press.
const SWITCH: usize = 0;
const ESTOP: u32 = 1 << 3;
/// A way that is on a line, with the pen down.
const LONG: &str = "M3\nG1 X40 Y20 F12000\nG1 X0 Y0\nM5\nM2\n";

/// The tests' machine, which brakes for a pause in a fiftieth of a second instead of a twelfth.
fn brisk() -> MachineFile {
    let mut machine = drawing::machine();
    for axis in [&mut machine.x, &mut machine.y] {
        (axis.speed, axis.acceleration) = (200.0, 40_000.0);
    }
    (machine.z.speed, machine.z.acceleration) = (5.0, 1000.0);
    machine
}

/// A job under way, with X somewhere on it.
fn under_way(wired: &mut Wired, text: &str, machine: &MachineFile, keepalive: Option<Duration>) {
    put(wired, &gcode("under way", text), machine);
    let pulses = wired.machine.edges(0);
    let started = wired.with(|board| board.start("under way", keepalive));
    started.unwrap_or_else(|error| panic!("{error}"));
    for _ in 0..200 {
        if wired.machine.edges(0) > pulses + 400 {
            return;
        }
        wired.run(MS);
        if keepalive.is_some() {
            report(wired);
        }
    }
    panic!("it does not begin: {:?}", report(wired));
}

fn command(wired: &mut Wired, code: JobCommand) {
    let answer = wired.with(|board| board.command(code));
    answer.unwrap_or_else(|error| panic!("{error}"));
}

/// Looks until it is so.
fn until(wired: &mut Wired, so: impl Fn(&Report) -> bool) -> Report {
    for _ in 0..500 {
        let report = report(wired);
        if so(&report) {
            return report;
        }
        wired.run(2 * MS);
    }
    panic!("it never is: {:?}", report(wired));
}

/// The job is over, for this reason. Nothing moves any more, the pen is up, and the board has
/// counted what left its pins since `began`.
fn ended(wired: &mut Wired, end: End, began: &Began) -> Report {
    let report = until(wired, |report| report.state == State::Stopped);
    assert_eq!(report.end, end, "{report:?}");
    let stood = wired.steps();
    let made = std::array::from_fn(|axis| stood[axis] - began.pins[axis] + began.told[axis]);
    assert_eq!(report.steps.map(i64::from), made, "not what left the pins");
    wired.run(10 * MS);
    assert_eq!(wired.steps(), stood, "moves on");
    assert_eq!(wired.machine.outputs() & 1, 0, "the pen is down");
    report
}

/// Where it was before a job: what the pins add up to, and what it says itself.
struct Began {
    pins: [i64; 3],
    told: [i64; 3],
}

fn began(wired: &mut Wired) -> Began {
    let told = report(wired).steps.map(i64::from);
    Began {
        pins: wired.steps(),
        told,
    }
}

/// The next job ends where it should: at home.
fn goes_on(wired: &mut Wired) {
    put(wired, &gcode("home", HOME), &brisk());
    let (report, _) = play(wired, "home");
    assert_eq!(
        (report.end, report.steps),
        (End::Done, [0; 3]),
        "{report:?}"
    );
    wired.events();
}

/// What a pause must not change: the pulses of each axis in their order, and where the axes are
/// when the pen switches.
#[derive(Default, PartialEq)]
struct Path {
    pulses: [Vec<bool>; 3],
    switches: Vec<([i64; 3], bool)>,
}

fn path(events: &[Event]) -> Path {
    let (mut path, mut at) = (Path::default(), [0; 3]);
    for (_, pin) in events {
        match *pin {
            Pin::Step { axis, forward } => {
                path.pulses[axis].push(forward);
                at[axis] += if forward { 1 } else { -1 };
            }
            Pin::Tool(down) => path.switches.push((at, down)),
        }
    }
    path
}

#[test]
#[ignore = "named: cargo xtask test plotter"]
fn pauses_at_any_moment_change_no_step() {
    let seed = ferrocnc_tests::seed();
    let mut random = rand_pcg::Pcg32::new(seed, 1);
    let text = "M3\nG1 X12 Y5 F12000\nG2 X12 Y15 J5\nG3 X22 Y25 I10\nG1 X0 Y20 Z0.1\nM5\nG0 X0 Y0 Z0\nM2\n";
    let (program, machine) = (gcode("pauses", text), brisk());
    let told = predict(&program, &machine);
    let mut wired = board();
    put(&mut wired, &program, &machine);
    let started = wired.with(|board| board.start("pauses", None));
    started.unwrap_or_else(|error| panic!("{error}"));
    for _ in 0..2 {
        let before = until(&mut wired, |report| report.state == State::Running);
        assert_eq!(before.end, End::None);
        wired.run(random.random_range(1..told.clocks / 4));
        command(&mut wired, JobCommand::Pause);
        let stood = until(&mut wired, |report| report.stands);
        assert_eq!(stood.state, State::Paused, "seed {seed}: {stood:?}");
        let steps = wired.steps();
        wired.run(5 * MS);
        assert_eq!(wired.steps(), steps, "seed {seed}: moves in a pause");
        command(&mut wired, JobCommand::Continue);
    }
    let report = until(&mut wired, |report| report.state == State::Stopped);
    assert_eq!(report.end, End::Done, "seed {seed}: {report:?}");
    assert_eq!(report.steps.map(i64::from), told.steps, "seed {seed}");
    assert!(
        path(&wired.events()) == path(&told.events),
        "seed {seed}: another path"
    );
}

#[test]
#[ignore = "named: cargo xtask test plotter"]
fn stop_comes_to_rest_on_the_path_and_the_next_job_goes_on_from_there() {
    let mut wired = board();
    let began = began(&mut wired);
    under_way(&mut wired, LONG, &brisk(), None);
    command(&mut wired, JobCommand::Stop);
    let report = ended(&mut wired, End::Stopped, &began);
    assert!(report.known, "{report:?}");
    let [x, y, _] = report.steps;
    assert!(x > 400 && (x - 2 * y).abs() <= 2, "{x} {y} is off the line");
    goes_on(&mut wired);
}

#[test]
#[ignore = "named: cargo xtask test plotter"]
fn words_of_fpga_g_move_a_motor_to_the_step_and_switch_the_pen() {
    // 180 steps with X and the pen down, 100 back with the pen up.
    let text = "GCODE 0x01600001 0x01f40028 0x006401f4 0x00280000\nSTART\nSTATUS\nGCODE 0x01610000 0x01f40014 0x003c01f4 0x00140000\n";
    let lines = WordsLine::all(text).unwrap_or_else(|error| panic!("{error}"));
    let mut wired = board();
    goes_on(&mut wired);
    let began = began(&mut wired);
    for line in &lines {
        let status = wired.with(|board| board.words(line.command.code(), line.form, &line.words));
        assert_eq!(status.unwrap_or_else(|error| panic!("{error}")), 0);
    }
    let there = began.told[0] + 80;
    until(&mut wired, |report| {
        report.stands && i64::from(report.steps[0]) == there && report.outputs & 1 == 0
    });
    command(&mut wired, JobCommand::Stop);
    ended(&mut wired, End::Stopped, &began);
    let path = path(&wired.events());
    let pulses: Vec<bool> = [vec![true; 180], vec![false; 100]].concat();
    assert_eq!(path.pulses[0], pulses);
    assert_eq!(
        path.switches,
        [([0, 0, 0], true), ([180, 0, 0], false)],
        "the pen"
    );
    goes_on(&mut wired);
}

#[test]
fn an_e_stop_ends_the_pulses_in_its_clock_and_the_switch_has_to_be_found_again() {
    let mut machine = brisk();
    machine.x.home = Some(Home {
        towards: Direction::Minus,
        input: SWITCH as u8,
        closed: Level::High,
        order: 0,
        fast: 40.0,
        slow: 4.0,
        backoff: 0.2,
        travel: 60.0,
        timeout: 5.0,
        debounce: 10,
    });
    // Its axes without a switch stay unknown.
    let mut wired = Wired::boot();
    let at = wired.machine.pulses(0) - 80;
    wired.machine.rig().board.plant.add_switch(Switch {
        stepgen: 0,
        at,
        above: false,
        input: SWITCH,
        inverted: false,
    });
    put(&mut wired, &gcode("home", HOME), &machine);
    let find = |wired: &mut Wired| {
        let found = wired.with(|board| board.home([true, false, false], None));
        found.unwrap_or_else(|error| panic!("{error}"));
        let report = until(wired, |report| report.state == State::Stopped);
        assert_eq!(report.end, End::Done, "{report:?}");
        assert!(report.homed & 1 == 1 && report.steps[0] == 0, "{report:?}");
        report.known
    };
    assert!(find(&mut wired));
    let began = began(&mut wired);
    under_way(&mut wired, "G1 X8 Y4 F9000\nG1 X0 Y0\nM2\n", &machine, None);
    let clocks = wired.machine.inputs_until_safe(ESTOP.into());
    let pressed = wired.machine.clock();
    println!("safe {clocks} clocks after the e-stop");
    assert!(clocks < 100, "safe only {clocks} clocks after the e-stop");
    let report = ended(&mut wired, End::EStop, &began);
    let last = wired.machine.last_step(0).expect("it moved");
    assert!(last <= pressed, "a pulse {} clocks late", last - pressed);
    assert!(!report.known && report.homed & 1 == 0, "{report:?}");
    wired.machine.inputs(0);
    let refused = play(&mut wired, "home").0;
    assert_eq!((refused.end, refused.axis), (End::NotHomed, 0));
    // The axes without a switch are not known before the board restarts.
    assert!(!find(&mut wired));
    goes_on(&mut wired);
}

#[test]
#[ignore = "named: cargo xtask test plotter"]
fn the_cable_pulled_in_mid_job_stops_an_attended_job_and_an_unattended_one_is_drawn_to_its_end() {
    let mut wired = board();
    let attended = began(&mut wired);
    let text = "M3\nG1 X40 Y20 F4000\nG1 X0 Y0\nM5\nM2\n";
    under_way(&mut wired, text, &brisk(), Some(Duration::from_millis(150)));
    wired.machine.trouble("pull");
    wired.run(250 * MS);
    let stood = wired.steps();
    wired.run(10 * MS);
    assert_eq!(wired.steps(), stood, "moves without its starter");
    wired.machine.trouble("plug");
    let report = ended(&mut wired, End::HostLost, &attended);
    let [x, y, _] = report.steps;
    assert!(report.known && x > 400, "{report:?}");
    assert!((x - 2 * y).abs() <= 2, "{x} {y} is off the line");
    goes_on(&mut wired);

    let text = "M3\nG1 X10 Y5 F12000\nG1 X0 Y0\nM5\nM2\n";
    let told = predict(&gcode("under way", text), &brisk());
    let unattended = began(&mut wired);
    under_way(&mut wired, text, &brisk(), None);
    wired.machine.trouble("pull");
    wired.run(told.clocks + 100 * MS);
    assert!(path(&wired.events()) == path(&told.events), "another path");
    wired.machine.trouble("plug");
    let report = ended(&mut wired, End::Done, &unattended);
    assert_eq!(report.steps.map(i64::from), told.steps);
}

#[test]
#[ignore = "named: cargo xtask test plotter"]
fn when_the_board_restarts_in_the_middle_of_a_job_it_says_so_and_knows_neither_job_nor_place() {
    let mut wired = board();
    under_way(&mut wired, LONG, &brisk(), None);
    // Its gate is closed when this comes back.
    wired.machine.trap_cpu();
    let stood = wired.steps();
    wired.run(20_000_000);
    assert_eq!(wired.steps(), stood, "moves on");
    let first = wired.with(|board| board.report());
    assert!(matches!(first, Err(JobError::Restarted)), "{first:?}");
    let report = report(&mut wired);
    assert_eq!((report.state, report.end), (State::Stopped, End::Restart));
    assert!(!report.known && !report.machine, "{report:?}");
    let list = wired.with(|board| board.list());
    assert_eq!(list.expect("none").len(), 0);
    goes_on(&mut wired);
    // A job does not make them known; the operator does. The next test has them at home and known.
    let report = wired.with(|board| board.report()).expect("a report");
    assert!(!report.known, "{report:?}");
    let report = wired.with(|board| board.here([true; 3]));
    assert!(report.expect("no axis has a switch").known);
}

#[test]
#[ignore = "named: cargo xtask test plotter"]
fn a_job_that_asks_for_more_than_the_planner_makes_brakes_and_says_underrun() {
    let (_, machine) = dense();
    let mut wired = board();
    let began = began(&mut wired);
    // Five times as many segments as in the dense arc.
    let turns = "G0 X5 Y10 Z0\nG2 I5 Z1 F30000\nG2 I5 Z2\nG2 I5 Z3\nG0 X0 Y0 Z0\nM2\n";
    put(&mut wired, &gcode("denser", turns), &machine);
    let started = wired.with(|board| board.start("denser", None));
    started.unwrap_or_else(|error| panic!("{error}"));
    let report = ended(&mut wired, End::Underrun, &began);
    assert!(report.known, "{report:?}");
    goes_on(&mut wired);
}

/// mm/s, and mm/s^2 that take an eighth of a second to stop from it: longer than the watchdog
/// waits.
const SPEED: f64 = 100.0;
const HEAVY: f64 = 800.0;

#[test]
fn a_processor_that_hangs_is_stopped_by_the_watchdog_each_heavy_axis_in_its_own_way_and_no_step_is_lost()
 {
    let mut machine = brisk();
    for axis in [&mut machine.x, &mut machine.y] {
        (axis.speed, axis.acceleration) = (SPEED, HEAVY);
    }
    let mut wired = board();
    let began = began(&mut wired);
    under_way(&mut wired, LONG, &machine, None);
    wired.machine.freeze_cpu();
    // It bites now at the latest.
    wired.machine.rig().run(100 * MS);
    let (from, scales) = (wired.steps(), machine.axes().map(|axis| axis.steps_per_mm));
    let takes = SPEED / HEAVY * f64::from(machine.clock);
    wired.machine.rig().run(takes as u64 + MS);
    assert!(!wired.machine.gate_open(), "an axis moves on");
    let stood = wired.steps();
    // Y has half the speed of X, and stops in half the time.
    for (axis, speed) in [SPEED, SPEED / 2.0].into_iter().enumerate() {
        let way = (stood[axis] - from[axis]) as f64 / scales[axis];
        let allowed = speed * speed / (2.0 * HEAVY) + 2.0 / scales[axis];
        println!("axis {axis}: {way:.2} mm of {allowed:.2}");
        assert!(
            way <= allowed,
            "axis {axis}: {way} mm, {allowed} are allowed"
        );
    }
    wired.machine.rig().freeze_cpu(false);
    let report = ended(&mut wired, End::Watchdog, &began);
    assert_eq!(wired.steps(), stood);
    assert!(report.known, "{report:?}");
    goes_on(&mut wired);
}

// ---- any machine --------------------------------------------------------------------------------

/// What ends a job.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Strikes {
    Stop,
    Frozen,
    Silence,
    EStop,
    Reset,
}

/// By hand, with a board of their own: two of them leave it without a known position.
const STRIKES: [Strikes; 5] = [
    Strikes::Frozen,
    Strikes::Stop,
    Strikes::Silence,
    Strikes::EStop,
    Strikes::Reset,
];

impl Strikes {
    /// Machines that are struck so. On the path a stop takes four times as long as each axis needs,
    /// and a silence lasts 100 ms.
    fn shape(self, asked: bool) -> Shape {
        let (takes, lasts) = match self {
            Strikes::Stop if !asked => (0.002..0.01, 0.0),
            Strikes::Stop => (0.002..0.06, 0.0),
            Strikes::Silence => (0.002..0.06, 0.12),
            Strikes::Frozen => (0.02..0.3, 0.12),
            Strikes::EStop | Strikes::Reset => (0.02..0.3, 0.0),
        };
        // Some 2000 steps at the most, because they have to be gone back.
        let fastest = (1500.0f64 / (takes.end + lasts)).min(20_000.0);
        Shape {
            takes,
            speed: 200.0..fastest,
            lasts,
        }
    }

    fn way(self) -> Way {
        match self {
            Strikes::Frozen => Way::Own,
            Strikes::Stop | Strikes::Silence => Way::Path,
            Strikes::EStop | Strikes::Reset => Way::Cut,
        }
    }

    fn strike(self, wired: &mut Wired) {
        match self {
            // No client sends to it until its keepalive is over.
            Strikes::Silence => wired.run(110 * MS),
            Strikes::Stop => command(wired, JobCommand::Stop),
            Strikes::EStop => {
                assert!(wired.machine.inputs_until_safe(ESTOP.into()) < 100);
                wired.machine.inputs(0);
            }
            Strikes::Reset => {
                assert!(wired.machine.external_reset_until_safe() <= 4);
                wired.machine.rig().ext_reset(false);
            }
            Strikes::Frozen => {
                wired.machine.freeze_cpu();
                for _ in 0..1000 {
                    if !wired.machine.gate_open() {
                        break;
                    }
                    wired.machine.rig().run(MS);
                }
                wired.machine.rig().freeze_cpu(false);
            }
        }
    }
}

/// Back home, as fast as the pins allow: the machines of the tests end anywhere.
fn goes_home(wired: &mut Wired) {
    let mut machine = brisk();
    for axis in [&mut machine.x, &mut machine.y, &mut machine.z] {
        axis.steps_per_mm = 80.0;
        (axis.speed, axis.acceleration) = (1000.0, 100_000.0);
        (axis.min, axis.max) = (-100.0, 100.0);
    }
    put(wired, &gcode("home", HOME), &machine);
    let (report, _) = play(wired, "home");
    assert_eq!((report.end, report.steps), (End::Done, [0; 3]));
    wired.events();
}

/// A job on a random machine, struck at a random moment; what was used of the way allowed, and
/// whether the position is known.
fn struck(wired: &mut Wired, seed: u64, strikes: Strikes, asked: bool) -> (f64, bool) {
    let mut random = rand_pcg::Pcg32::new(seed, 4);
    let job = Job::any(&mut random, &strikes.shape(asked));
    let told = format!("FERROCNC_SEED={seed}: {strikes:?}, {:?}", job.axes);
    put(wired, &job.program, &job.machine);
    let began = began(wired);
    let keepalive = (strikes == Strikes::Silence).then_some(Duration::from_millis(100));
    let started = wired.with(|board| board.start("any", keepalive));
    started.unwrap_or_else(|error| panic!("{told}: {error}"));
    for _ in 0..200 {
        if wired.steps() != began.pins {
            break;
        }
        wired.run(MS / 4);
    }
    if strikes != Strikes::Silence {
        wired.run(random.random_range(0..job.told.clocks));
    }
    strikes.strike(wired);
    let report = until(wired, |report| report.state == State::Stopped);
    let stood = wired.steps();
    let made = std::array::from_fn(|axis| stood[axis] - began.pins[axis] + began.told[axis]);
    assert_eq!(report.steps.map(i64::from), made, "{told}: {report:?}");
    wired.run(5 * MS);
    assert_eq!(wired.steps(), stood, "{told}: moves on");
    let used = job.stands_within(&wired.events(), strikes.way(), &told);
    println!(
        "{told}: {:?}, {used:.3}, known {}",
        report.end, report.known
    );
    (used, report.known)
}

/// Every kind in turn. `FERROCNC_STOPS` is how many; one in the gate, on the board that all share.
#[test]
#[ignore = "named: cargo xtask test plotter"]
fn any_job_stops_each_axis_within_its_own_way_whatever_strikes() {
    let first = ferrocnc_tests::from_environment("FERROCNC_SEED", 1);
    let count = ferrocnc_tests::from_environment("FERROCNC_STOPS", 0);
    let mut used = Used::default();
    if count == 0 {
        let mut wired = board();
        let (_, known) = struck(&mut wired, first, Strikes::Stop, false);
        assert!(known);
        goes_home(&mut wired);
        return;
    }
    for seed in first..first + count {
        let strikes = STRIKES[seed as usize % STRIKES.len()];
        // Each on a board of its own: what a stop leaves of a step shifts the next job's edges.
        let (part, known) = struck(&mut Wired::boot(), seed, strikes, true);
        let told = format!("FERROCNC_SEED={seed}: {strikes:?}");
        match strikes {
            Strikes::EStop | Strikes::Reset => assert!(!known, "{told}"),
            // A processor that was away may have missed the grace's end.
            Strikes::Frozen => {}
            Strikes::Stop | Strikes::Silence => assert!(known, "{told}"),
        }
        used.see(strikes, part);
    }
    let allowed = serde_json::json!({ "steps_allowed": STEPS });
    used.report("jobs on the RTL", allowed);
}
