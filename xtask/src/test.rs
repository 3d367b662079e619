//! The test pyramid, one line per level. Lower levels need Rust only.

use crate::{
    bitstream, build, cargo_tests, cost, deb, faults, fuzz, lint, netlist as gates, passes, python,
    regen, setup, slowest, step, target,
};
use anyhow::{Context, Result, bail};
use clap::{Args, ValueEnum};
use serde_json::json;
use std::collections::VecDeque;
use std::process::Command;
use std::sync::{Mutex, PoisonError};
use std::time::Instant;

/// Which levels to run.
#[derive(Args, Default)]
pub struct Options {
    /// Levels to run; all when none is named.
    #[arg(value_enum)]
    levels: Vec<Level>,
    /// While you edit: lint and unit tests only, without any FPGA tool or simulation.
    #[arg(long, conflicts_with = "levels")]
    fast: bool,
}

/// A level of the pyramid.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Level {
    /// Format, clippy, Python, SystemVerilog, licences.
    Lint,
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
    /// A drawing as a job: the path rebuilt from the pins' edges, over the drawing. The tool, and
    /// how jobs end.
    Jobs,
    /// The same on the whole Verilated board with the release image. The tests that the models
    /// have, too, only if it is named.
    Plotter,
    /// The Verilated board with the release image: boot, exchange, malformed frames, faults. Some
    /// boards that differ little from others only if it is named.
    Soc,
    /// The fault table: every row with the real driver against the twin, the gateware's rows on the
    /// RTL with the CPU stopped.
    Faults,
    /// Known defects of other controllers; for each a test that FerroCNC does not have it.
    Peers,
    /// Flash, settings, discovery and updates with power lost at every step; real `ferrocnc` on a
    /// segment of boards.
    Provision,
    /// LiteX's own client, ping and a console session; telnet, curl, avahi and dnsmasq at the
    /// board's own IP stack. That the Verilated board renews its lease only if it is named.
    Clients,
    /// The pages of `ferrocnc ui` in Debian's Chromium, without a screen, against the twin.
    Ui,
    /// Real LinuxCNC, our driver, the twin: homing, probing, threading, four boards, other drivers'
    /// HAL files, every machine that `ferrocnc machine` makes; cables pulled, boards restarted,
    /// processes killed, frames lost.
    Twin,
    /// Real LinuxCNC, our driver, the simulated board.
    Linuxcnc,
    /// Everything that comes from outside, 5 s of random inputs for each parser.
    Fuzz,
    /// The Debian packages: what is in them, and the same bytes twice. Only if it is named: to
    /// build them and the tool that packs them takes ten minutes of a core.
    Packages,
    /// The same, and they are installed in a fresh Debian 12 and a fresh Debian 13, where LinuxCNC
    /// runs a program on the twin, and removed without a trace. Only if it is named: it takes twice
    /// 200 MB of Debian from the network.
    Install,
    /// The smallest configuration as bitstream: every clock met, the release firmware inside, files
    /// the host and an ECP5 take; its routed netlist, simulated, is the RTL clock by clock.
    Bitstream,
}

/// Enough for the committed inputs and what is soon found beside them, with the same random numbers
/// in each run: whether a change passes is no matter of luck. The search is a command of its own:
/// `cargo xtask fuzz --seconds 3600`.
const FUZZ: fuzz::Search = fuzz::Search {
    seconds: 5,
    seed: Some(1),
};

const FAST: &[Level] = &[Level::Lint, Level::Unit];
const ALL: &[Level] = &[
    Level::Lint,
    Level::Unit,
    Level::Generated,
    Level::Formal,
    Level::Core,
    Level::Lockstep,
    Level::Jobs,
    Level::Plotter,
    Level::Soc,
    Level::Faults,
    Level::Peers,
    Level::Provision,
    Level::Clients,
    Level::Ui,
    Level::Twin,
    Level::Linuxcnc,
    Level::Fuzz,
    Level::Bitstream,
];

/// The tests of the tool's pages, which leave pictures of them.
pub fn pages() -> Result<()> {
    run(&Options {
        levels: vec![Level::Ui],
        ..Options::default()
    })
}

/// Runs the levels and prints one line for each.
pub fn run(options: &Options) -> Result<()> {
    let levels = match options {
        Options { fast: true, .. } => FAST,
        Options { levels, .. } if levels.is_empty() => ALL,
        Options { levels, .. } => levels,
    };
    let begun = Instant::now();
    prepare(levels)?;
    let outcomes = side_by_side(levels, !options.levels.is_empty());
    report(&outcomes, begun.elapsed().as_secs_f32() / 60.0)?;
    step::heading("the pyramid");
    let (mut passed, mut failed) = (0, 0);
    for outcome in &outcomes {
        let (title, seconds) = (outcome.level.title(), outcome.seconds);
        match &outcome.result {
            Ok(count) => {
                passed += count;
                println!("  ok      {title:<60} {count:>5} tests  {seconds:>6.1} s");
            }
            Err(error) => {
                failed += 1;
                println!("  FAILED  {title:<60}        {seconds:>9.1} s\n          {error:#}");
            }
        }
    }
    println!("\n{passed} passed, {failed} failed");
    if failed > 0 {
        bail!(
            "{failed} of {} levels failed; their logs are in target/logs",
            levels.len()
        );
    }
    Ok(())
}

/// Sets up and builds what the levels need.
fn prepare(levels: &[Level]) -> Result<()> {
    let any = |wanted: fn(Level) -> bool| levels.iter().any(|level| wanted(*level));
    if any(Level::needs_board) {
        build::everything(build::driver)?;
    } else if any(|level| !matches!(level, Level::Lint | Level::Unit)) {
        setup::run(setup::Need::Everything)?;
    } else if any(|level| level == Level::Lint) {
        setup::run(setup::Need::Lint)?;
    }
    // Verilator keeps one core busy for a part of its time, and so does cargo.
    std::thread::scope(|scope| {
        let simulations = scope.spawn(|| simulations(levels));
        if any(Level::runs_linuxcnc) {
            build::driver()?;
            build::install_driver()?;
        }
        if any(Level::takes_boards) {
            build::test_programs()?;
        }
        simulations
            .join()
            .unwrap_or_else(|_| bail!("the build of the simulations panicked"))
    })
}

/// Verilates what the levels need besides the board of the demo.
fn simulations(levels: &[Level]) -> Result<()> {
    let any = |wanted: fn(Level) -> bool| levels.iter().any(|level| wanted(*level));
    // The board is compiled with a profile of what the firmware does on it.
    if any(|level| matches!(level, Level::Jobs | Level::Plotter)) {
        build::firmware()?;
    }
    if any(|level| matches!(level, Level::Soc | Level::Jobs | Level::Plotter)) {
        build::simulated_board(build::JOBS_BOARD)?;
    }
    if any(|level| level == Level::Soc) {
        build::simulated_image()?;
    }
    if any(|level| level == Level::Lockstep) {
        build::simulated_cores(build::WIDE_BOARD)?;
        build::simulated_cores(build::CORES_BOARD)?;
    }
    Ok(())
}

/// What a level came to.
struct Outcome {
    level: Level,
    seconds: f32,
    result: Result<usize>,
}

/// Queues beside the first one. Together they keep two cores busy while LinuxCNC waits for its
/// machine.
const OTHER_QUEUES: usize = 2;

/// Levels that take a core for so long that one of them alone at the end would leave the other core
/// without work: they begin first, the longest before the others.
const LONG: &[Level] = &[
    Level::Plotter,
    Level::Soc,
    Level::Core,
    Level::Formal,
    Level::Bitstream,
    Level::Unit,
    Level::Provision,
    Level::Lockstep,
];

/// Runs the levels in some queues, because most levels wait for something for a part of their time.
/// The first queue begins with the levels whose programs keep a pace, and then helps the others.
/// Those run at low priority: LinuxCNC and a streamed job keep their pace beside them. One level
/// alone, or one core, makes one queue.
fn side_by_side(levels: &[Level], named: bool) -> Vec<Outcome> {
    let (paced, mut others): (VecDeque<Level>, VecDeque<Level>) =
        levels.iter().partition(|level| level.keeps_a_pace());
    if !named {
        let place = |level: &Level| LONG.iter().position(|long| long == level);
        let others = others.make_contiguous();
        others.sort_by_key(|level| place(level).unwrap_or(LONG.len()));
    }
    let waiting = Mutex::new((paced, others));
    let done = Mutex::new(Vec::new());
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let apart = levels.len() > 1 && cores > 1;
    let queue = |first: bool| {
        loop {
            let level = {
                let mut waiting = waiting.lock().unwrap_or_else(PoisonError::into_inner);
                let (paced, others) = &mut *waiting;
                match first {
                    true => paced.pop_front().or_else(|| others.pop_front()),
                    false => others.pop_front(),
                }
            };
            let Some(level) = level else { break };
            if !level.keeps_a_pace() && apart {
                step::stand_back();
            }
            step::heading(&format!("test: {}", level.title()));
            let begun = Instant::now();
            let result = level.run(named);
            let seconds = begun.elapsed().as_secs_f32();
            let mut done = done.lock().unwrap_or_else(PoisonError::into_inner);
            done.push(Outcome {
                level,
                seconds,
                result,
            });
        }
    };
    std::thread::scope(|scope| {
        if apart {
            for _ in 0..OTHER_QUEUES {
                scope.spawn(|| queue(false));
            }
        }
        queue(true);
    });
    let mut outcomes = done.into_inner().unwrap_or_else(PoisonError::into_inner);
    outcomes.sort_by_key(|outcome| ALL.iter().position(|level| *level == outcome.level));
    outcomes
}

/// Writes target/reports/pyramid.json: the levels, all their minutes with what was built for them,
/// what each step cost, and the slowest of the tests with a board.
fn report(outcomes: &[Outcome], minutes: f32) -> Result<()> {
    let levels: Vec<_> = outcomes
        .iter()
        .map(|outcome| {
            json!({
                "name": outcome.level.to_possible_value().map(|value| value.get_name().to_owned()),
                "tests": outcome.result.as_ref().ok(),
                "seconds": outcome.seconds.round(),
            })
        })
        .collect();
    let path = target("reports/pyramid.json");
    std::fs::create_dir_all(target("reports"))?;
    let slowest: Vec<_> = slowest::slowest()
        .into_iter()
        .map(|(test, seconds)| json!({ "test": test, "seconds": seconds.round() }))
        .collect();
    let whole = outcomes.len() == ALL.len();
    let steps: Vec<_> = cost::dearest()
        .into_iter()
        .map(|cost| {
            json!({
                "step": cost.step,
                "seconds": cost.seconds.round(),
                "core_seconds": cost.core_seconds.round(),
            })
        })
        .collect();
    let report = json!({
        "steps": steps,
        "levels": levels, "whole": u32::from(whole), "minutes": minutes.round(), "slowest": slowest,
    });
    std::fs::write(&path, format!("{report:#}\n"))
        .with_context(|| format!("cannot write {}", path.display()))
}

impl Level {
    /// It runs the Verilated board that the demo runs.
    fn needs_board(self) -> bool {
        matches!(
            self,
            Level::Soc
                | Level::Faults
                | Level::Peers
                | Level::Provision
                | Level::Clients
                | Level::Linuxcnc
        )
    }

    /// LinuxCNC's HAL is one per machine.
    fn runs_linuxcnc(self) -> bool {
        matches!(self, Level::Twin | Level::Linuxcnc)
    }

    /// It runs LinuxCNC, which is one per machine, or a PC that streams a job to a twin whose
    /// watchdog goes by the clock on the wall.
    fn keeps_a_pace(self) -> bool {
        self.runs_linuxcnc() || self == Level::Jobs
    }

    /// Its tests are programs of the `tests` crate.
    fn takes_boards(self) -> bool {
        !matches!(
            self,
            Level::Lint
                | Level::Unit
                | Level::Generated
                | Level::Formal
                | Level::Core
                | Level::Fuzz
                | Level::Packages
                | Level::Install
        )
    }

    fn title(self) -> &'static str {
        match self {
            Level::Lint => "lint: format, clippy, Python, SystemVerilog, licences",
            Level::Unit => "unit: arithmetic, parsing, every (state, event)",
            Level::Generated => "generated: registers, memory map and PAC are fresh",
            Level::Formal => "formal: pulse, count and watchdog promises, proven",
            Level::Core => "core: RTL at its pins under random stimulus",
            Level::Lockstep => "lockstep: RTL and model, clock by clock",
            Level::Jobs => "jobs: a drawing, from SVG to edges and back; jobs' ends",
            Level::Plotter => "plotter: jobs on the Verilated board, release image",
            Level::Soc => "soc: Verilated board, release image, frames and faults",
            Level::Faults => "faults: every row of the fault table, at the pins",
            Level::Peers => "peers: defects of others, on the RTL board",
            Level::Provision => "provision: flash and network, power lost at every step",
            Level::Clients => "clients: LiteX RemoteClient, telnet, curl, avahi, dnsmasq",
            Level::Ui => "ui: the tool's pages in Chromium, against the twin",
            Level::Twin => "twin: real LinuxCNC, our driver, the cores' models",
            Level::Linuxcnc => "linuxcnc: real LinuxCNC, our driver, simulated board",
            Level::Fuzz => "fuzz: random datagrams, frames and files",
            Level::Packages => "packages: what is in them, the same bytes twice",
            Level::Install => "install: packages in a fresh Debian, LinuxCNC on the twin",
            Level::Bitstream => "bitstream: clocks met, firmware inside, netlist runs",
        }
    }

    /// Runs the level; says how many tests passed. What takes long and is shown elsewhere, too,
    /// runs only if the level was `named`.
    fn run(self, named: bool) -> Result<usize> {
        match self {
            Level::Lint => lint::check(named),
            Level::Unit => {
                let mut cargo = cargo_tests::command();
                cargo.args(["--profile", "tests", "--workspace", "--no-fail-fast"]);
                cargo_tests::run("test-unit", "cargo test", "3 min", &mut cargo)
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
                "2 min",
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
            Level::Jobs => board_tests("jobs", "3 min", "2"),
            // The drawing and the dense arc have a board of their own, the other tests share one.
            Level::Plotter if named => all_tests_of("jobs_rtl", "13 min", "2"),
            Level::Plotter => board_tests("jobs_rtl", "6 min", "2"),
            Level::Soc => soc(named),
            Level::Faults => faults::run(),
            Level::Peers => board_tests("peers", "3 min", "2"),
            Level::Provision => Ok(board_tests("provision", "1 min", "2")?
                + board_tests("selftest", "5 min", "2")?
                + board_tests("tryout", "1 min", "2")?
                + board_tests("lan", "2 min", "2")?
                + board_tests("net", "1 min", "2")?
                + board_tests("names", "1 min", "1")?),
            // The Verilated board of the second keeps a core busy, its twins do not.
            Level::Clients => Ok(board_tests("clients", "2 min", "1")?
                + match named {
                    true => all_tests_of("network", "7 min", "3")?,
                    false => board_tests("network", "2 min", "3")?,
                }),
            Level::Ui => board_tests("ui", "1 min", "2"),
            Level::Twin => Ok(board_tests("twin", "3 min", "1")?
                + board_tests("machines", "2 min", "1")?
                + board_tests("guide", "2 min", "1")?
                + board_tests("trouble", "7 min", "1")?),
            Level::Linuxcnc => board_tests("linuxcnc", "10 min", "1"),
            // Two at once: as many cores as the smallest machine that runs this has.
            Level::Fuzz => fuzz::fuzz(&fuzz::targets()?, FUZZ, 2),
            Level::Packages => Ok(deb::check()?.len()),
            Level::Install => deb::check_installed(),
            Level::Bitstream => {
                let proven = bitstream::prove()?;
                for line in &proven {
                    println!("    {line}");
                }
                let files = board_tests("bitstream", "1 min", "2")?;
                Ok(proven.len() + files + gates::compare(1, None)?)
            }
        }
    }
}

/// A script that prints a line beginning with PASS per test.
fn script(name: &str, title: &str, expect: &str, path: &str) -> Result<usize> {
    let log = format!("test-{name}");
    let mut run = Command::new("bash");
    run.arg(path).env("FERROCNC_PYTHON", python::interpreter());
    let printed = step::run_quietly(&log, title, expect, &mut run)?;
    let results: Vec<_> = printed.lines().filter(|l| l.starts_with("PASS")).collect();
    for line in &results {
        println!("    {line}");
    }
    if results.is_empty() {
        bail!("{title}: nothing ran; see target/logs/{log}.log");
    }
    passes::report(name, &results)?;
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

/// The register map holds for the largest board there can be: 16 stepgens, encoders and PWMs, 64
/// inputs and outputs.
fn maximum_board() -> Result<()> {
    let mut elaborate = python::gateware("elaborate");
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

/// A test program that needs a simulated board, so many tests at once: with
/// LinuxCNC one, for its HAL is one per machine.
fn board_tests(name: &str, expect: &str, threads: &str) -> Result<usize> {
    tests_of(name, expect, threads, &[])
}

/// The same, and those that run only if their level is named.
fn all_tests_of(name: &str, expect: &str, threads: &str) -> Result<usize> {
    tests_of(name, expect, threads, &["--include-ignored"])
}

/// The same, with more arguments for the program.
fn tests_of(name: &str, expect: &str, threads: &str, arguments: &[&str]) -> Result<usize> {
    let mut cargo = cargo_tests::of_boards();
    cargo.args(["--test", name, "--", "--test-threads", threads]);
    cargo.args(arguments);
    cargo_tests::run(
        &format!("test-{name}"),
        &format!("tests against the simulated board: {name}"),
        expect,
        &mut cargo,
    )
}

/// What needs the whole Verilated board. If the level was not `named`, without those tests that
/// differ from others in the image or the SDRAM of the board only: to start each takes half a
/// minute of a core.
fn soc(named: bool) -> Result<usize> {
    let programs = [
        ("image", "1 min"),
        ("jobs_program", "3 min"),
        ("services", "3 min"),
        ("path_stop", "1 min"),
        ("pinmux", "2 min"),
        ("soc", "3 min"),
        ("flood", "4 min"),
        ("frames", "5 min"),
        ("flash", "2 min"),
        ("key", "3 min"),
    ];
    let run = if named { all_tests_of } else { board_tests };
    programs
        .iter()
        .map(|(name, expect)| run(name, expect, "2"))
        .sum()
}

/// The cores of a job, which no board of ours has yet.
fn jobs() -> Result<usize> {
    let mut cargo = cargo_tests::of_boards();
    cargo.args(["--test", "segments", "--test", "executor"]);
    cargo.args(["--", "--test-threads", "1"]);
    cargo_tests::run(
        "test-segments",
        "segments: RTL and model, clock by clock; edges emitted and predicted; jobs on the models",
        "5 min",
        &mut cargo,
    )
}
