//! The drawing on the Verilated cores.

use crate::rig::STATUS;
use ferrocnc_tests::drawing::{self, TOLERANCE, Watch};
use ferrocnc_tests::pins::{self, Prediction};
use sim::model::board::pages;
use sim::soc::{Cores, CoresPins};
use sim::stimulus::before_a_job;
use std::collections::VecDeque;
use std::path::PathBuf;

const PUSH: u32 = wire::regmap::segments::PUSH as u32;

const CONTROL: u32 = wire::regmap::segments::CONTROL as u32;

const MASK: u32 = wire::regmap::segments::MASK as u32;

const START: u32 = wire::regmap::segments::CONTROL_COMMAND_START;

/// Plays a prediction on the bare cores: writes its segments as they have room.
fn play(told: &Prediction, timing: [u32; 4]) -> Vec<pins::Event> {
    let folder = std::env::var_os("FERROCNC_JOBS_CORES").map_or_else(
        || ferrocnc_tests::root().join("target/sim/cores-jobs"),
        PathBuf::from,
    );
    let mut cores = Cores::load(&folder).unwrap_or_else(|error| panic!("{error}"));
    let mut pins = CoresPins::default();
    let [steplen, stepspace, dirsetup, dirhold] = timing;
    let words = [steplen, stepspace, dirsetup, dirhold, 1 << 24, 0];
    let mut writes = VecDeque::from_iter(before_a_job(3, words));
    writes.push_back((pages::SEGMENTS, MASK, 1));
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
        pins.coming = pages::SEGMENTS << 9 | STATUS;
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
