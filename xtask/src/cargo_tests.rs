//! `cargo test` as a step: says where the simulated board, the image and the bitstream are, and
//! counts the tests that passed.

use crate::{bitstream, build, slowest, step};
use anyhow::{Result, bail};
use std::process::Command;

/// `cargo test`, told where the simulated board, the image and the bitstream are.
pub fn command() -> Command {
    let mut cargo = Command::new("cargo");
    cargo.arg("test");
    cargo.env("FERROCNC_SOC", build::soc(build::BOARD));
    cargo.env("FERROCNC_FIRMWARE", build::image());
    cargo.env("FERROCNC_BITSTREAM", bitstream::folder(bitstream::SMALLEST));
    cargo
}

/// The same for programs that need a board, whose names are still to come.
pub fn of_boards() -> Command {
    let mut cargo = command();
    cargo.args(build::BOARD_TESTS);
    cargo
}

/// Runs such a command, as a step with this name; returns how many tests passed.
pub fn run(name: &str, title: &str, expect: &str, cargo: &mut Command) -> Result<usize> {
    let printed = step::run_timed(name, title, expect, cargo)?;
    if let Some(threads) = threads(cargo) {
        slowest::note(name.trim_start_matches("test-"), &printed, threads);
    }
    let count = printed
        .text
        .lines()
        .filter_map(|line| {
            line.strip_prefix("test result: ok. ")?
                .split_once(" passed")?
                .0
                .parse::<usize>()
                .ok()
        })
        .sum();
    if count == 0 {
        bail!("{title}: no test ran");
    }
    Ok(count)
}

/// How many tests of one program the command runs at a time, if it says so.
fn threads(cargo: &Command) -> Option<usize> {
    let mut arguments = cargo
        .get_args()
        .skip_while(|word| *word != "--test-threads");
    arguments.nth(1)?.to_str()?.parse().ok()
}
