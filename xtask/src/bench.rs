//! Measurements. Each prints its figures and leaves them in `target/reports/NAME.json`.

mod host;
mod stops;

use crate::{build, cargo_tests, faults, passes, python, root, setup, step, target};
use anyhow::{Context, Result};
use clap::{Args, ValueEnum};
use std::path::Path;
use std::process::Command;

/// What can be measured.
#[derive(Clone, Copy, ValueEnum)]
pub enum What {
    /// The exchange on simulated boards, fast and long way: turnaround in clock cycles, all of
    /// it in microseconds; size of the image.
    Exchange,
    /// Random frames at a whole board without its processor: only one that is like the pass is
    /// executed (--frames, --seed).
    Frames,
    /// LUTs, flip-flops and memories per core and per board, beside the peers'; writes
    /// docs/size.md.
    Gateware,
    /// What loss on the cable costs a program: real driver, twin, a million exchanges
    /// (--exchanges).
    Loss,
    /// A drawing as a job on the Verilated board, edge by edge at the pins: how many are not where
    /// they are predicted, how far the path is from the drawing; how fast the board plans; writes
    /// docs/img/job.png.
    Jobs,
    /// A day of the board's time on the twin: counters that drift, or do not come round as they
    /// should (--hours).
    Soak,
    /// Random machines, stopped by random causes at random moments, on the models, through the
    /// host's streaming program and on the RTL: how much of the way allowed the worst has used.
    Stops,
    /// What a servo period costs this PC: the real driver in LinuxCNC's realtime on the twin, in
    /// turn with a plain C component with the same system calls, bytes and pins (--rounds); 4 and
    /// 10 kHz.
    Host,
}

/// How much of it.
#[derive(Args)]
pub struct Options {
    /// What to measure.
    #[arg(value_enum)]
    what: What,
    /// Loss: how many exchanges.
    #[arg(long, value_name = "N", default_value_t = 1_000_000)]
    exchanges: u64,
    /// Frames: how many.
    #[arg(long, value_name = "N", default_value_t = 1_000_000)]
    frames: u64,
    /// Frames: the seed of the run.
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u64,
    /// Soak: how many hours of the board's time.
    #[arg(long, value_name = "N", default_value_t = 24)]
    hours: u64,
    /// Host: how many rounds of each shape; the order of both drivers changes from one to the next.
    #[arg(long, value_name = "N", default_value_t = 8, value_parser = clap::value_parser!(u64).range(2..))]
    rounds: u64,
}

/// Measures and prints.
pub fn run(options: &Options) -> Result<()> {
    match options.what {
        What::Exchange => {
            let parts = build::everything(build::driver)?;
            let largest = build::simulated_board(build::LARGEST_BOARD)?;
            exchange(&parts, &largest)
        }
        What::Frames => frames(options.seed, options.frames),
        What::Gateware => gateware(),
        What::Jobs => jobs(),
        What::Loss => faults::measure(
            "loss",
            "random_loss",
            "10 min",
            "FERROCNC_EXCHANGES",
            options.exchanges,
        ),
        What::Stops => stops::run(),
        What::Host => host::run(options.rounds),
        What::Soak => faults::measure(
            "soak",
            "a_day_passes",
            "40 min",
            "FERROCNC_SOAK_SECONDS",
            3600 * options.hours,
        ),
    }
}

/// The exchange bench on parts already built, and on the simulated board with the most channels.
fn exchange(parts: &build::Parts, largest: &Path) -> Result<()> {
    step::heading("bench: exchange");
    std::fs::create_dir_all(target("reports"))?;
    let mut bench = Command::new(build::bench_exchange()?);
    bench
        .env("FERROCNC_SOC", &parts.soc)
        .env("FERROCNC_FIRMWARE", &parts.firmware)
        .arg("--report")
        .arg(target("reports/exchange.json"))
        .arg("--largest")
        .arg(largest);
    let printed = step::run_quietly(
        "bench-exchange",
        "exchange with the simulated boards",
        "3 min",
        &mut bench,
    )?;
    println!("{}", printed.trim_end());
    Ok(())
}

/// The bench of the fast path with many more random frames than the gate sends.
fn frames(seed: u64, count: u64) -> Result<()> {
    setup::run(setup::Need::Everything)?;
    step::heading("bench: frames");
    let mut bench = Command::new("bash");
    bench.args(["gateware/tests/run.sh", "fast_path"]);
    bench.args([seed.to_string(), count.to_string()]);
    bench.env("BOARD", build::BOARD);
    let title = format!("{count} random frames at {}", build::BOARD);
    let printed = step::run_quietly("bench-frames", &title, "10 min", &mut bench)?;
    let results: Vec<_> = printed.lines().filter(|l| l.starts_with("PASS")).collect();
    for line in &results {
        println!("{line}");
    }
    passes::report("frames", &results)
}

/// The drawing, sent to the Verilated board and started there: figures, and the picture in the
/// README. On the cores and the twin, too.
fn jobs() -> Result<()> {
    setup::run(setup::Need::Everything)?;
    build::firmware()?;
    build::test_programs()?;
    build::simulated_board(build::JOBS_BOARD)?;
    build::simulated_cores(build::CORES_BOARD)?;
    step::heading("bench: jobs");
    std::fs::create_dir_all(target("reports"))?;
    let mut bench = cargo_tests::of_boards();
    bench.args(["--test", "jobs", "--test", "jobs_rtl", "--"]);
    bench.args(["a_drawing", "a_dense_arc", "--nocapture"]);
    bench.env("FERROCNC_REPORTS", target("reports"));
    let printed = step::run_quietly("bench-jobs", "a drawing, edge by edge", "8 min", &mut bench)?;
    for line in printed
        .lines()
        .filter(|line| line.contains(" segments ") || line.contains(" segments, "))
    {
        println!("{line}");
    }
    for name in ["jobs.json", "jobs-dense.json"] {
        let report = target("reports").join(name);
        std::fs::metadata(&report).with_context(|| format!("no report at {}", report.display()))?;
    }
    let picture = root().join("docs/img/job.png");
    std::fs::copy(target("reports/job.png"), &picture).context("no picture of the drawing")?;
    println!("picture: {}", picture.display());
    Ok(())
}

fn gateware() -> Result<()> {
    setup::run(setup::Need::Gateware)?;
    step::heading("bench: gateware");
    std::fs::create_dir_all(target("reports"))?;
    let mut bench = python::gateware("bench");
    bench
        .arg("--out")
        .arg(target("gateware/bench"))
        .arg("--json")
        .arg(target("reports/gateware.json"))
        .arg("--document")
        .arg(root().join("docs/size.md"));
    let printed = step::run_quietly(
        "bench-gateware",
        "synthesise and pack the cores and the boards",
        "15 min",
        &mut bench,
    )?;
    println!("{}", printed.trim_end());
    let report = target("reports/gateware.json");
    std::fs::metadata(&report)
        .with_context(|| format!("no report at {}", report.display()))
        .map(drop)
}
