//! The test pyramid, one line per level. Lower levels need nothing but Rust.

use crate::{bitstream, build, faults, fuzz, regen, setup, step, target};
use anyhow::{Result, bail};
use clap::{Args, ValueEnum};
use std::process::Command;
use std::time::Instant;

/// Which levels to run.
#[derive(Args, Default)]
pub struct Options {
    /// Levels to run; all when none is named.
    #[arg(value_enum)]
    levels: Vec<Level>,
}

/// A level of the pyramid.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Level {
    /// Arithmetic, parsing, every state and event: plain `cargo test`.
    Unit,
    /// The committed generated files are the ones the generators write.
    Generated,
    /// The promises of the cores, proven, each with a broken core that the proof must catch.
    Formal,
    /// The cores at their pins, random stimulus.
    Core,
    /// Every core against its bit-exact model, clock by clock.
    Lockstep,
    /// A drawing as a job: the path rebuilt from the pins' edges, over the drawing. Jobs on the whole Verilated board, and how they end.
    Jobs,
    /// The Verilated board with the release image: boot, exchange, malformed frames, faults.
    Soc,
    /// The fault table: every row with the real driver against the twin, the gateware's rows on the RTL with the CPU stopped.
    Faults,
    /// Defects of the controllers before us, each shown not to be ours.
    Peers,
    /// Flash, settings, discovery and updates with the plug pulled everywhere; real `ferrocnc` on a segment of boards.
    Provision,
    /// LiteX's own client, ping and a console session.
    Clients,
    /// Real LinuxCNC, our driver, the twin: homing, probing, threading, four boards, other drivers' HAL files; cables pulled,
    /// boards restarted, processes killed, frames lost.
    Twin,
    /// Real LinuxCNC, our driver, the simulated board.
    Linuxcnc,
    /// Everything that comes from outside, 60 s of inputs nobody would think of for each parser.
    Fuzz,
    /// The smallest configuration as bitstream: every clock met, the release firmware inside, files the host and an ECP5 take.
    Bitstream,
}

/// An hour is `cargo xtask fuzz --seconds 3600`.
const FUZZ_SECONDS: u32 = 60;

const ALL: &[Level] = &[
    Level::Unit,
    Level::Generated,
    Level::Formal,
    Level::Core,
    Level::Lockstep,
    Level::Jobs,
    Level::Soc,
    Level::Faults,
    Level::Peers,
    Level::Provision,
    Level::Clients,
    Level::Twin,
    Level::Linuxcnc,
    Level::Fuzz,
    Level::Bitstream,
];

/// Runs the levels and prints one line for each.
pub fn run(options: &Options) -> Result<()> {
    let levels = if options.levels.is_empty() {
        ALL
    } else {
        &options.levels
    };
    if levels.iter().any(|level| *level != Level::Unit) {
        setup::run(setup::Need::Everything)?;
    }
    let needs_board = |level: &Level| {
        matches!(
            level,
            Level::Soc | Level::Faults | Level::Peers | Level::Clients | Level::Linuxcnc
        )
    };
    if levels.iter().any(needs_board) {
        build::everything()?;
    }
    if levels.contains(&Level::Soc) || levels.contains(&Level::Jobs) {
        build::simulated_board(build::JOBS_BOARD)?;
    }
    if levels.contains(&Level::Lockstep) {
        build::simulated_cores(build::BOARD)?;
        build::simulated_cores(build::CORES_BOARD)?;
    }
    if levels.contains(&Level::Jobs) {
        build::firmware()?;
        build::simulated_cores(build::CORES_BOARD)?;
    }
    if levels.contains(&Level::Provision) || levels.contains(&Level::Jobs) {
        build::host()?;
    }
    let needs_driver = |level: &Level| matches!(level, Level::Twin | Level::Linuxcnc);
    if levels.iter().any(needs_driver) {
        build::host()?;
        build::install_driver()?;
    }
    let mut lines = Vec::new();
    let (mut passed, mut failed) = (0, 0);
    for level in levels {
        step::heading(&format!("test: {}", level.title()));
        let begun = Instant::now();
        let outcome = level.run();
        let seconds = begun.elapsed().as_secs_f32();
        match outcome {
            Ok(count) => {
                passed += count;
                lines.push(format!(
                    "  ok      {:<60} {count:>5} tests  {seconds:>6.1} s",
                    level.title()
                ));
            }
            Err(error) => {
                failed += 1;
                lines.push(format!(
                    "  FAILED  {:<60}        {seconds:>9.1} s\n          {error:#}",
                    level.title()
                ));
            }
        }
    }
    step::heading("the pyramid");
    println!("{}\n", lines.join("\n"));
    println!("{passed} passed, {failed} failed");
    if failed > 0 {
        bail!(
            "{failed} of {} levels failed; their logs are in target/logs",
            levels.len()
        );
    }
    Ok(())
}

impl Level {
    fn title(self) -> &'static str {
        match self {
            Level::Unit => "unit: arithmetic, parsing, every (state, event)",
            Level::Generated => "generated: registers, memory map and PAC are fresh",
            Level::Formal => "formal: pulse, count and watchdog promises, proven",
            Level::Core => "core: RTL at its pins under random stimulus",
            Level::Lockstep => "lockstep: RTL and model, clock by clock",
            Level::Jobs => "jobs: a drawing, from SVG to edges and back; jobs' ends",
            Level::Soc => "soc: Verilated board, release image, frames and faults",
            Level::Faults => "faults: every row of the fault table, at the pins",
            Level::Peers => "peers: defects of others, on the RTL board",
            Level::Provision => "provision: flash and network, the plug pulled everywhere",
            Level::Clients => "clients: LiteX RemoteClient, ping, console",
            Level::Twin => "twin: real LinuxCNC, our driver, the cores' models",
            Level::Linuxcnc => "linuxcnc: real LinuxCNC, our driver, simulated board",
            Level::Fuzz => "fuzz: datagrams, frames and files nobody would think of",
            Level::Bitstream => "bitstream: clocks met, release firmware inside, files taken",
        }
    }

    /// Runs the level; says how many tests passed.
    fn run(self) -> Result<usize> {
        match self {
            Level::Unit => {
                cargo_tests("test-unit", "cargo test", "3 min", &["test", "--workspace"])
            }
            Level::Generated => {
                regen::generate(true)?;
                abi_guard()?;
                maximum_board()?;
                Ok(3)
            }
            Level::Formal => script(
                "formal",
                "proofs, and mutations they must catch",
                "6 min",
                "gateware/formal/run.sh",
            ),
            Level::Core => script(
                "core",
                "the cores at their pins",
                "2 min",
                "gateware/tests/run.sh",
            ),
            Level::Lockstep => {
                // Two runs with a seed each, side by side.
                Ok(board_tests("lockstep", "3 min", "2")? + jobs()?)
            }
            // The drawing and the dense arc have a board of their own, the rest of the second's tests share one.
            Level::Jobs => {
                Ok(board_tests("jobs", "3 min", "2")? + board_tests("jobs_rtl", "7 min", "2")?)
            }
            Level::Soc => Ok(board_tests("image", "1 min", "2")?
                + board_tests("jobs_program", "4 min", "2")?
                + board_tests("path_stop", "1 min", "2")?
                + board_tests("soc", "3 min", "2")?
                + board_tests("flood", "5 min", "2")?
                + board_tests("frames", "5 min", "2")?
                + board_tests("flash", "2 min", "2")?
                + board_tests("key", "3 min", "2")?),
            Level::Faults => faults::run(),
            Level::Peers => board_tests("peers", "3 min", "2"),
            Level::Provision => Ok(board_tests("provision", "1 min", "2")?
                + board_tests("segment", "2 min", "2")?
                + board_tests("names", "1 min", "1")?),
            Level::Clients => board_tests("clients", "2 min", "1"),
            Level::Twin => {
                Ok(board_tests("twin", "3 min", "1")? + board_tests("trouble", "7 min", "1")?)
            }
            Level::Linuxcnc => board_tests("linuxcnc", "10 min", "1"),
            // Two at once: as many cores as the smallest machine that runs this has.
            Level::Fuzz => fuzz::fuzz(&fuzz::targets()?, FUZZ_SECONDS, 2),
            Level::Bitstream => {
                let proven = bitstream::prove()?;
                for line in &proven {
                    println!("    {line}");
                }
                Ok(proven.len() + board_tests("bitstream", "1 min", "2")?)
            }
        }
    }
}

/// A script that prints a line beginning with PASS per test.
fn script(name: &str, title: &str, expect: &str, path: &str) -> Result<usize> {
    let log = format!("test-{name}");
    let mut run = Command::new("bash");
    run.arg(path).env("FERROCNC_PYTHON", setup::python());
    let printed = step::run_quietly(&log, title, expect, &mut run)?;
    let results: Vec<_> = printed.lines().filter(|l| l.starts_with("PASS")).collect();
    for line in &results {
        println!("    {line}");
    }
    if results.is_empty() {
        bail!("{title}: nothing ran; see target/logs/{log}.log");
    }
    Ok(results.len())
}

/// The hand-written LinuxCNC bindings against LinuxCNC's own headers.
fn abi_guard() -> Result<()> {
    let mut compile = Command::new("gcc");
    compile.args([
        "-Wall",
        "-Werror",
        "-I/usr/include/linuxcnc",
        "-c",
        "host/abi/abi.c",
        "-o",
        "/dev/null",
    ]);
    step::run(
        "abi",
        "LinuxCNC's headers agree with our bindings",
        "1 s",
        &mut compile,
    )
}

/// The register map holds for the largest board there can be: 16 stepgens, encoders and PWMs, 32 inputs and outputs.
fn maximum_board() -> Result<()> {
    let mut elaborate = build::gateware("elaborate");
    elaborate
        .args(["--target", "sim", "--board", "boards/max.toml", "--out"])
        .arg(target("gateware/sim-max"));
    step::run(
        "elaborate-max",
        "the maximum board elaborates on the same map",
        "2 s",
        &mut elaborate,
    )
}

/// A test binary of the `tests` crate that needs a simulated board, so many tests at once: with LinuxCNC
/// one, for its HAL is one per machine.
fn board_tests(name: &str, expect: &str, threads: &str) -> Result<usize> {
    let arguments = [
        "test",
        "--release",
        "--package",
        "ferrocnc-tests",
        "--features",
        "board",
        "--test",
        name,
        "--",
        "--test-threads",
        threads,
    ];
    cargo_tests(
        &format!("test-{name}"),
        &format!("tests against the simulated board: {name}"),
        expect,
        &arguments,
    )
}

/// The cores of a job, which no board of ours has yet.
fn jobs() -> Result<usize> {
    let arguments = [
        "test",
        "--release",
        "--package",
        "ferrocnc-sim",
        "--features",
        "board",
        "--test",
        "jobs",
        "--test",
        "executor",
        "--",
        "--test-threads",
        "1",
    ];
    cargo_tests(
        "test-segments",
        "segments: RTL and model, clock by clock; edges emitted and predicted; jobs on the models",
        "5 min",
        &arguments,
    )
}

fn cargo_tests(name: &str, title: &str, expect: &str, arguments: &[&str]) -> Result<usize> {
    let mut cargo = Command::new("cargo");
    cargo.args(arguments);
    cargo.env("FERROCNC_SOC", build::soc(build::BOARD));
    cargo.env("FERROCNC_FIRMWARE", build::image());
    cargo.env("FERROCNC_BITSTREAM", bitstream::folder(bitstream::SMALLEST));
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
