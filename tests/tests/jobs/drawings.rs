//! Whole programs, sent or streamed: every edge in its clock.

use crate::rig::*;
use ferrocnc_tests::drawing::{self, TOLERANCE};
use ferrocnc_tests::pins;
use ferrocnc_tests::plotter::{Plotter, Scissors};
use wire::crc::crc32;
use wire::jobs::{End, State};

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

#[test]
fn a_drawing_streamed_to_a_board_without_sdram_is_on_its_curves_and_every_edge_in_its_clock() {
    draws(Plotter::streamed(SLOWER, ""), "drawing-streamed.png");
}

#[test]
fn a_long_program_goes_to_the_twin_over_a_line_that_is_cut_and_not_a_step_is_lost() {
    let lines: usize = ferrocnc_tests::from_environment("FERROCNC_LINES", 100_000);
    let text = cam(lines);
    assert!(text.lines().count().abs_diff(lines) < 3);
    let mut program = program(text.as_bytes());
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
