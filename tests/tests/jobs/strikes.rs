//! Random stops of streamed jobs.

use crate::rig::*;
use ferrocnc_tests::plotter::Plotter;
use ferrocnc_tests::stops::{Job, STEPS, Shape, Used, Way};
use host::job::client::Board;
use rand::Rng as _;
use std::time::{Duration, Instant};
use wire::jobs::{JobCommand, State};

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
        if matches!(self, Strikes::Pulled | Strikes::Frozen | Strikes::Reset) {
            plotter.waits_for_its_pc(false);
        }
        match self {
            Strikes::Pulled => drop(plotter.control("fault pull")),
            Strikes::Frozen => drop(plotter.control("freeze-cpu 1")),
            Strikes::Reset => drop(plotter.control("ext-reset 1")),
            Strikes::Silence => {}
            Strikes::CtrlC => plotter.end_streaming(),
            Strikes::Stop => {
                board.command(JobCommand::Stop).expect("it is taken");
            }
            Strikes::Pause => {
                // It may be over.
                let _over = board.command(JobCommand::Pause);
            }
        }
    }

    fn over(plotter: &Plotter) {
        for command in ["fault plug", "freeze-cpu 0", "ext-reset 0"] {
            plotter.control(command);
        }
    }
}

/// Until the gate is closed and the pins are at rest, or in a pause.
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
        // A pause that came after the end is refused.
        let _over = board.command(JobCommand::Stop);
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
    let allowed = serde_json::json!({ "steps_allowed": STEPS });
    used.report("streamed over UDP", allowed);
}
