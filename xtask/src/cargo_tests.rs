//! `cargo test` as a step: says where the simulated board, the image and the bitstream are, and
//! counts the tests that passed.

use crate::{bitstream, build, step};
use anyhow::{Result, bail};
use std::process::Command;

/// Runs `cargo` with these arguments, as a step with this name; returns how many tests passed.
pub fn run(name: &str, title: &str, expect: &str, arguments: &[&str]) -> Result<usize> {
    run_with(name, title, expect, arguments, &[])
}

/// The same with more variables in its environment.
pub fn run_with(
    name: &str,
    title: &str,
    expect: &str,
    arguments: &[&str],
    more: &[(&str, String)],
) -> Result<usize> {
    let mut cargo = Command::new("cargo");
    cargo.args(arguments);
    cargo.env("FERROCNC_SOC", build::soc(build::BOARD));
    cargo.env("FERROCNC_FIRMWARE", build::image());
    cargo.env("FERROCNC_BITSTREAM", bitstream::folder(bitstream::SMALLEST));
    cargo.envs(more.iter().map(|(name, value)| (name, value)));
    let printed = step::run_quietly(name, title, expect, &mut cargo)?;
    let count = printed
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
