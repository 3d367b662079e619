//! Whole jobs on the Verilated board: real gateware, release image, the jobs program in SDRAM; sent and started over TCP by the tool's
//! own client.
//!
//! `cargo xtask test jobs` builds what this needs. `FERROCNC_PROFILE=FILE` makes the dense arc write where the processor was while it
//! planned: a line for each address, in hexadecimal, and how many looks found it there.

use ferrocnc_tests::drawing;
use ferrocnc_tests::wired::Wired;
use host::job::machine::Machine;
use host::job::pins::{self, Prediction};
use host::job::program::{Dialect, Program};
use wire::jobs::{End, Report, State};

const MS: u64 = 60_000;
/// Segments the core holds.
const ROOM: u8 = 64;

fn gcode(name: &str, text: &str) -> Program {
    let program = Program::from_gcode(text.as_bytes(), Dialect::default().dwell);
    let mut program = program.unwrap_or_else(|error| panic!("{error}"));
    program.name = name.to_owned();
    program
}

fn predict(program: &Program, machine: &Machine) -> Prediction {
    pins::predict(program, machine).unwrap_or_else(|error| panic!("{error}"))
}

/// On the board, and its machine.
fn put(wired: &mut Wired, program: &Program, machine: &Machine) {
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

/// Two turns of a screw whose chords are so short that more than 1000 segments have to be made in a second.
fn dense() -> (Program, Machine) {
    let mut machine = drawing::machine();
    machine.chord_tolerance = 0.001;
    for axis in [&mut machine.x, &mut machine.y] {
        (axis.speed, axis.acceleration) = (400.0, 100_000.0);
    }
    (machine.z.speed, machine.z.acceleration) = (50.0, 10_000.0);
    let turns = "G0 X5 Y10 Z0\nG2 I5 Z1 F6300\nG2 I5 Z2\nG0 X0 Y0 Z0\nM2\n";
    (gcode("dense", turns), machine)
}

/// Segments a second that a program has to have: of the tenth of a second in which they are densest.
fn asked(told: &Prediction, clock: u32) -> f64 {
    let window = u64::from(clock / 10);
    let begins: Vec<u64> = told.segments.iter().map(|(begin, _)| *begin).collect();
    let most = begins.iter().enumerate().map(|(at, begin)| {
        let end = begins.partition_point(|other| *other < begin + window);
        end - at
    });
    most.max().unwrap_or(0) as f64 * 10.0
}

/// How fast it plans, seen from outside: every millisecond, what was pushed so far and what of it waits.
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
}

#[test]
#[ignore = "487 segments/s of 1070 on 2026-11-22: it ends in an underrun"]
fn a_dense_arc_is_planned_as_fast_as_it_is_drawn() {
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
    let started = wired.with(|board| board.start("dense", None));
    started.unwrap_or_else(|error| panic!("{error}"));
    let profile = std::env::var_os("FERROCNC_PROFILE");
    if profile.is_some() {
        wired.profile();
    }
    let (mut planning, begun) = (Planning::default(), wired.machine.clock());
    let report = loop {
        for _ in 0..50 {
            wired.run(MS);
            planning.look(&mut wired);
        }
        let report = report(&mut wired);
        if report.state == State::Stopped {
            break report;
        }
    };
    if let (Some(path), Some(profile)) = (profile, wired.take_profile()) {
        println!("{} clocks without the ROM at most", profile.longest);
        std::fs::write(path, profile.text()).expect("the profile");
    }
    let (segments, clocks) = planning.busy();
    println!(
        "{segments} segments planned in {clocks} clocks: {:.0} segments/s, {} clocks each; ended {:?} after {} clocks, {} segments",
        f64::from(segments) * f64::from(machine.clock) / clocks as f64,
        clocks / u64::from(segments.max(1)),
        report.end,
        wired.machine.clock() - begun,
        report.segments
    );
    assert_eq!(report.end, End::Done, "{report:?}");
    let difference = told.compare(&wired.events());
    println!("{difference:?}");
    assert_eq!(
        (difference.wrong, report.steps.map(i64::from)),
        (0, told.steps)
    );
}
