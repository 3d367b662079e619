//! A host that streams disappears, is stopped, or has a bad network.

use crate::rig::*;
use ferrocnc_tests::drawing::{self, TOLERANCE};
use ferrocnc_tests::pins::{self, Pin, Prediction};
use ferrocnc_tests::plotter::Plotter;
use host::client::Client;
use std::process::Command;
use std::time::Instant;
use wire::jobs::End;
use wire::{FaultReason, Refusal, map};

#[test]
fn a_pc_without_its_cable_claims_to_know_no_position_until_it_is_back() {
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
    plotter.waits_for_its_pc(false);
    plotter.control("fault pull");
    until(false);
    plotter.control("fault plug");
    until(true);
    drop(board);
    plotter.events();
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
    plotter.waits_for_its_pc(true);
    let serving = Serving::begin(&plotter);
    let mut board = serving.start(&program(BACK));
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
    plotter.waits_for_its_pc(false);
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
    let program = program(cam(600).as_bytes());
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
