//! Random machines, stopped by random causes at random moments: many more of them than the gate
//! tries.

use crate::{build, cargo_tests, step, target};
use anyhow::{Context, Result};

/// What is run: a name for its log, the test program, the tests in it, and how many machines are
/// tried. A stop on the RTL takes a minute, one on the models a fraction of a second.
const RUNS: [(&str, &str, &str, u64); 4] = [
    ("models", "executor", "stops::random", 1000),
    ("streamed", "jobs", "any_streamed", 36),
    ("rtl", "path_stop", "any_machine", 24),
    ("jobs-rtl", "jobs_rtl", "any_job", 12),
];

/// Runs them; the figures are in `target/reports/stops.json`.
pub fn run() -> Result<()> {
    build::everything(build::driver)?;
    build::test_programs()?;
    build::simulated_board(build::JOBS_BOARD)?;
    build::simulated_cores(build::CORES_BOARD)?;
    step::heading("bench: stops");
    for (name, program, tests, machines) in RUNS {
        let mut cargo = cargo_tests::of_boards();
        cargo.args([
            "--test",
            program,
            "--",
            tests,
            "--nocapture",
            "--include-ignored",
        ]);
        cargo.env("FERROCNC_STOPS", machines.to_string());
        let title = format!("{machines} machines: {program}");
        let log = format!("bench-stops-{name}");
        let printed = step::run_quietly(&log, &title, "30 min", &mut cargo)?;
        for line in printed.lines().filter(|line| line.contains("at most")) {
            println!("{line}");
        }
    }
    let report = target("reports/stops.json");
    std::fs::metadata(&report)
        .with_context(|| format!("no report at {}", report.display()))
        .map(drop)
}
