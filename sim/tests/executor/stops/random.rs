//! Stops as a property: random machines are stopped at random moments by random causes, under a
//! host, in a job and during homing. Each axis stops within the distance that its own acceleration
//! allows, and the board reports a trusted position exactly when the position is right.
//!
//! `FERROCNC_STOPS` is how many of each; a few in the gate, thousands by hand. Each prints its seed
//! when it fails, and `FERROCNC_SEED` begins there.
//!
//! # The rows of `docs/safety.md` that stop a machine
//!
//! | row | cause here |
//! |---|---|
//! | frames lost, cable pulled, the host late, killed or flooded; the CPU hangs | `Silence`, `Frozen`; `Hangs` in a job |
//! | link down | `LinkDown` |
//! | LinuxCNC exits, `unloadrt`, a host that panics | `Release`, `Disable`; without a word `Silence` |
//! | one of several boards dies | `Disable`: that is what its neighbours are sent |
//! | the firmware panics, traps, or begins again without a word | `Trap`, `Jump` |
//! | external reset, e-stop | `Reset`, `EStop` |
//! | stop and pause, from any client; the starter falls silent | `Stop`, `Pause`, `Silence` |
//! | no segment in time | `Starved` |
//! | a stop that its grace cuts short | every fifth session has a grace of its own |
//! | settings of an earlier session | before every job |
//!
//! Elsewhere, because another part notices or because nothing is left to be judged: the whole board
//! restarts and its counts with it
//! (`faults_rtl::a_board_that_starts_anew_under_its_host_is_safe_and_not_armed`); numbers from HAL
//! (`host`); FPGA G's words, which end at speed as no job does (`words.rs` beside this); a PC that
//! streams over a real network (`tests/tests/jobs/strikes.rs`).

mod homing;
mod job;
mod player;
mod session;
mod watch;

use rand::{Rng, SeedableRng};
use rand_pcg::Pcg32;
use serde_json::Value;
use sim::figures::Used;
use sim::stimulus::from_environment;

/// Of each kind, unless told otherwise.
const CASES: u64 = 25;

fn seeds() -> std::ops::Range<u64> {
    let first = from_environment("FERROCNC_SEED", 1);
    first..first + from_environment("FERROCNC_STOPS", CASES)
}

/// Runs one of each seed; `target/reports/stops.json` tells what they used.
fn each<Cause: std::fmt::Debug>(part: &str, run: impl Fn(u64) -> (Cause, f64)) {
    let mut used = Used::default();
    for seed in seeds() {
        let (cause, part) = run(seed);
        used.see(cause, part);
    }
    used.report(part, Value::Null);
}

fn dice(seed: u64) -> Pcg32 {
    Pcg32::seed_from_u64(seed)
}

fn one_of<T: Copy>(random: &mut Pcg32, all: &[T]) -> T {
    all[random.random_range(0..all.len())]
}

/// Any magnitude between these is as likely as any other.
fn magnitude(random: &mut Pcg32, range: std::ops::Range<f64>) -> f64 {
    10f64.powf(random.random_range(range.start.log10()..range.end.log10()))
}

/// What an axis can: steps/s^2 over four decades, and steps/s from which that takes 2 to 400 ms to
/// stop.
fn axis(random: &mut Pcg32, takes: f64) -> (f64, f64) {
    let accel = magnitude(random, 40.0..400_000.0);
    let speed = accel * takes * random.random_range(0.3..1.0);
    (accel, speed.clamp(1.0, 150_000.0))
}
