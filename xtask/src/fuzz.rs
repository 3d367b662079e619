//! `cargo xtask fuzz`: libFuzzer on every parser of outside input, with the stable toolchain.
//!
//! The coverage that libFuzzer steers by is a pass of LLVM that any rustc runs when it is asked to
//! ([`INSTRUMENT`]), and libFuzzer itself comes as C++ sources in `libfuzzer-sys`: so a C++
//! compiler is enough. `cargo fuzz run TARGET` does the same with a nightly toolchain and an
//! address sanitizer.
//!
//! Findings go to `target/fuzz/findings`, the corpus of libFuzzer to `target/fuzz/corpus`, where
//! the next run begins.

use crate::{root, setup, step, target};
use anyhow::{Context, Result, bail};
use clap::Args;
use indicatif::{MultiProgress, ProgressBar, ProgressStyle};
use serde_json::json;
use std::fs::{self, File};
use std::io::IsTerminal;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

/// What `cargo fuzz` tells rustc, but for the sanitizer, which only a nightly one has, and for
/// `--cfg fuzzing`, with which smoltcp checks no sums: the board does.
const INSTRUMENT: &str = "-Cpasses=sancov-module -Cllvm-args=-sanitizer-coverage-level=4 \
    -Cllvm-args=-sanitizer-coverage-inline-8bit-counters -Cllvm-args=-sanitizer-coverage-pc-table \
    -Cllvm-args=-sanitizer-coverage-trace-compares";
/// Seconds for one input: the slowest there are take 0.7 of a core.
const PATIENCE: u32 = 120;
/// Seconds for making a finding smaller.
const MINIMISE: u32 = 20;
/// An input of so many bytes is printed: nothing else may be left of a run on another machine.
const SHORT: usize = 64;
/// Without a terminal, a line this often.
const TELL: Duration = Duration::from_secs(30);

/// Which targets, and how long.
#[derive(Args)]
pub struct Options {
    /// Targets; all when none is named.
    targets: Vec<String>,
    /// Seconds per target.
    #[arg(long, default_value_t = 60)]
    seconds: u32,
    /// Targets at once.
    #[arg(long, default_value_t = 2)]
    jobs: usize,
    /// The seed of the random numbers; each run has another one if not said, and prints it.
    #[arg(long)]
    seed: Option<u32>,
    /// Run one input and print every step; the name of its folder is the target.
    #[arg(long, value_name = "FILE", conflicts_with_all = ["targets", "seconds", "jobs", "seed"])]
    replay: Option<PathBuf>,
}

/// How long every target is searched, and with which random numbers.
#[derive(Clone, Copy)]
pub struct Search {
    /// Seconds.
    pub seconds: u32,
    /// The seed; another one in each run without.
    pub seed: Option<u32>,
}

/// Fuzzes, or replays an input.
pub fn run(options: &Options) -> Result<()> {
    if let Some(input) = &options.replay {
        return replay(input);
    }
    let known = targets()?;
    for name in &options.targets {
        if !known.contains(name) {
            bail!("there is no target {name}; there are {}", known.join(", "));
        }
    }
    let wanted = match options.targets.is_empty() {
        true => known,
        false => options.targets.clone(),
    };
    setup::run(setup::Need::Fuzz)?;
    let search = Search {
        seconds: options.seconds,
        seed: options.seed,
    };
    fuzz(&wanted, search, options.jobs).map(drop)
}

/// All targets there are, by name.
pub fn targets() -> Result<Vec<String>> {
    let folder = root().join("fuzz/fuzz_targets");
    let entries = fs::read_dir(&folder).with_context(|| format!("no {}", folder.display()))?;
    let mut names: Vec<String> = entries
        .flatten()
        .filter_map(|entry| Some(entry.path().file_stem()?.to_str()?.to_owned()))
        .collect();
    names.sort();
    Ok(names)
}

/// Builds the targets and runs them, `jobs` at once; says how many found nothing. A finding is an
/// error.
pub fn fuzz(names: &[String], search: Search, jobs: usize) -> Result<usize> {
    let seconds = search.seconds;
    let binaries = build()?;
    step::heading(&format!("fuzz: {} targets, {seconds} s each", names.len()));
    let screen = MultiProgress::new();
    let mut waiting = names.iter();
    let mut running: Vec<Run> = Vec::new();
    let mut done: Vec<Outcome> = Vec::new();
    loop {
        while running.len() < jobs.max(1)
            && let Some(name) = waiting.next()
        {
            running.push(Run::start(name, &binaries, search, &screen)?);
        }
        if running.is_empty() {
            break;
        }
        std::thread::sleep(Duration::from_millis(250));
        for mut run in std::mem::take(&mut running) {
            match run.child.try_wait()? {
                Some(status) => done.push(run.finish(status.success())?),
                None => {
                    run.tell();
                    running.push(run);
                }
            }
        }
    }
    done.sort_by(|a, b| a.name.cmp(&b.name));
    report(&done, seconds)?;
    let found: Vec<&Outcome> = done.iter().filter(|outcome| !outcome.clean).collect();
    for outcome in &found {
        outcome.explain(&binaries)?;
    }
    if found.is_empty() {
        return Ok(done.len());
    }
    let names: Vec<_> = found.iter().map(|outcome| outcome.name.as_str()).collect();
    bail!("findings in {}; each is explained above", names.join(", "))
}

/// Builds all of them; says where they are.
fn build() -> Result<PathBuf> {
    let host = setup::host()?;
    let mut cargo = Command::new("cargo");
    cargo
        .args([
            "build",
            "--locked",
            "--release",
            "--bins",
            "--manifest-path",
        ])
        .args([
            root().join("fuzz/Cargo.toml"),
            "--target".into(),
            host.clone().into(),
        ])
        .arg("--target-dir")
        .arg(target("fuzz"))
        .env("RUSTFLAGS", INSTRUMENT)
        .env_remove("CARGO_ENCODED_RUSTFLAGS");
    step::run(
        "fuzz-build",
        "build the fuzz targets, instrumented",
        "4 min the first time",
        &mut cargo,
    )
    .context(
        "when its lock file is behind: cargo update --workspace --manifest-path fuzz/Cargo.toml",
    )?;
    Ok(target("fuzz").join(host).join("release"))
}

/// A target at work.
struct Run {
    name: String,
    child: Child,
    log: PathBuf,
    begun: Instant,
    seconds: u32,
    told: Instant,
    bar: ProgressBar,
}

impl Run {
    fn start(name: &str, binaries: &Path, search: Search, screen: &MultiProgress) -> Result<Self> {
        let seconds = search.seconds;
        let corpus = target("fuzz/corpus").join(name);
        let findings = findings(name);
        for folder in [&corpus, &findings] {
            fs::create_dir_all(folder).with_context(|| format!("no {}", folder.display()))?;
        }
        let log = step::log_path(&format!("fuzz-{name}"))?;
        let out = File::create(&log).with_context(|| format!("cannot write {}", log.display()))?;
        let mut command = Command::new(binaries.join(name));
        command
            .arg(format!("-max_total_time={seconds}"))
            .arg(format!("-timeout={PATIENCE}"))
            .arg("-print_final_stats=1")
            .arg(format!("-artifact_prefix={}/", findings.display()))
            .arg(&corpus)
            .args(committed(name))
            .current_dir(root());
        if let Some(seed) = search.seed {
            command.arg(format!("-seed={seed}"));
        }
        let child = step::at_priority(&command)
            .stdin(Stdio::null())
            .stdout(out.try_clone()?)
            .stderr(out)
            .spawn()
            .with_context(|| format!("cannot start {name}"))?;
        let bar = screen.add(ProgressBar::new(seconds.into()));
        let style = ProgressStyle::with_template("  {prefix:14} {bar:20} {pos:>5}/{len} s  {msg}");
        bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()));
        bar.set_prefix(name.to_owned());
        Ok(Run {
            name: name.to_owned(),
            child,
            log,
            begun: Instant::now(),
            seconds,
            told: Instant::now(),
            bar,
        })
    }

    /// Says how far it is.
    fn tell(&mut self) {
        let seconds = self.begun.elapsed().as_secs();
        self.bar.set_position(seconds.min(self.seconds.into()));
        let pulse = Pulse::last(&fs::read_to_string(&self.log).unwrap_or_default());
        self.bar.set_message(pulse.to_string());
        if !std::io::stderr().is_terminal() && self.told.elapsed() >= TELL {
            self.told = Instant::now();
            println!(
                "    ... {}: {seconds} of {} s, {pulse}",
                self.name, self.seconds
            );
        }
    }

    fn finish(self, success: bool) -> Result<Outcome> {
        let log = fs::read(&self.log).with_context(|| format!("no {}", self.log.display()))?;
        let log = String::from_utf8_lossy(&log).into_owned();
        self.bar.finish_and_clear();
        let outcome = Outcome::read(&self.name, &log, success, self.begun.elapsed().as_secs());
        println!(
            "  {} {:<14} {}",
            if success { '+' } else { 'x' },
            outcome.name,
            outcome.pulse
        );
        Ok(outcome)
    }
}

/// Where a target's findings go.
fn findings(name: &str) -> PathBuf {
    target("fuzz/findings").join(name)
}

/// The committed inputs of a target: folders that are there.
fn committed(name: &str) -> impl Iterator<Item = PathBuf> {
    let folders = ["corpus", "regressions"].map(|kind| root().join("fuzz").join(kind).join(name));
    folders.into_iter().filter(|folder| folder.is_dir())
}

/// What libFuzzer says from time to time: inputs run, edges seen, inputs kept.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Pulse {
    executions: u64,
    edges: u64,
    kept: u64,
}

impl Pulse {
    /// The last one in a log: `#1234  NEW    cov: 56 ft: 78 corp: 9/10Kb ...`
    fn last(log: &str) -> Self {
        let after = |line: &str, key: &str| -> Option<u64> {
            let rest = &line[line.find(key)? + key.len()..];
            let digits = rest.trim_start();
            let end = digits
                .find(|c: char| !c.is_ascii_digit())
                .unwrap_or(digits.len());
            digits[..end].parse().ok()
        };
        let mut pulse = Pulse::default();
        for line in log.lines().rev().filter(|line| line.starts_with('#')) {
            pulse.executions = pulse.executions.max(after(line, "#").unwrap_or(0));
            if let (Some(edges), Some(kept)) = (after(line, "cov:"), after(line, "corp:")) {
                return Pulse {
                    edges,
                    kept,
                    ..pulse
                };
            }
        }
        pulse
    }
}

impl core::fmt::Display for Pulse {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(
            f,
            "{} inputs, {} edges, {} kept",
            self.executions, self.edges, self.kept
        )
    }
}

/// How a target ended.
struct Outcome {
    name: String,
    clean: bool,
    pulse: Pulse,
    /// Edges there are in the binary, its dependencies included.
    instrumented: u64,
    seconds: u64,
    peak_mb: u64,
    /// What it said when it found something, and the input.
    said: String,
    input: Option<PathBuf>,
}

impl Outcome {
    fn read(name: &str, log: &str, clean: bool, seconds: u64) -> Self {
        let number = |text: &str| text.trim().parse::<u64>().ok();
        let stat = |key: &str| {
            log.lines().find_map(|line| {
                number(
                    line.strip_prefix("stat::")?
                        .strip_prefix(key)?
                        .strip_prefix(':')?,
                )
            })
        };
        let counters = log.lines().find_map(|line| {
            let (before, _) = line.split_once(" inline 8-bit counters")?;
            number(before.rsplit('(').next()?)
        });
        let mut pulse = Pulse::last(log);
        pulse.executions = stat("number_of_executed_units").unwrap_or(pulse.executions);
        let input = log
            .lines()
            .find_map(|line| Some(line.split_once("Test unit written to ")?.1.trim().into()));
        // A panic's message, or what libFuzzer itself complains of.
        let said = log
            .lines()
            .skip_while(|line| !line.contains("panicked at") && !line.contains("ERROR: libFuzzer"))
            .take_while(|line| !line.starts_with("stack backtrace"))
            .take(20);
        Outcome {
            name: name.to_owned(),
            clean,
            pulse,
            instrumented: counters.unwrap_or(0),
            seconds,
            peak_mb: stat("peak_rss_mb").unwrap_or(0),
            said: said.map(|line| format!("    | {line}\n")).collect(),
            input,
        }
    }

    /// Says what was found, where it lies and what to do with it.
    fn explain(&self, binaries: &Path) -> Result<()> {
        println!(
            "\n  x {}: a finding after {}\n{}",
            self.name, self.pulse, self.said
        );
        let Some(input) = &self.input else {
            println!(
                "    it left no input; its log is target/logs/fuzz-{}.log",
                self.name
            );
            return Ok(());
        };
        let input = self
            .smaller(binaries, input)
            .unwrap_or_else(|| input.clone());
        let shown = input.strip_prefix(root()).unwrap_or(&input).display();
        let bytes = fs::read(&input)?;
        println!("    input      {shown}, {} bytes", bytes.len());
        if bytes.len() <= SHORT {
            println!("    bytes      {bytes:02x?}");
        }
        println!("    see it     cargo xtask fuzz --replay {shown}");
        println!(
            "    keep it    cp {shown} fuzz/regressions/{}/WHAT_IT_SHOWS",
            self.name
        );
        println!(
            "    and then   cargo test -p ferrocnc-fuzz-targets: it fails until the defect is fixed"
        );
        Ok(())
    }

    /// The same finding from a smaller input, if libFuzzer comes to one soon.
    fn smaller(&self, binaries: &Path, input: &Path) -> Option<PathBuf> {
        let file = input.file_name()?.to_str()?;
        let smaller = input.with_file_name(format!("smaller-{file}"));
        let mut command = Command::new(binaries.join(&self.name));
        command
            .arg("-minimize_crash=1")
            .arg(format!("-max_total_time={MINIMISE}"))
            .arg(format!("-exact_artifact_path={}", smaller.display()))
            .arg(input)
            .current_dir(root())
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::null());
        let _ = file.starts_with("crash-").then(|| command.status())?;
        smaller.is_file().then_some(smaller)
    }
}

/// `target/reports/fuzz.json`: what ran last, target by target.
fn report(done: &[Outcome], seconds: u32) -> Result<()> {
    let targets: Vec<_> = done
        .iter()
        .map(|outcome| {
            json!({
                "name": outcome.name,
                "seconds": outcome.seconds,
                "executions": outcome.pulse.executions,
                "edges": outcome.pulse.edges,
                "edges_instrumented": outcome.instrumented,
                "inputs_kept": outcome.pulse.kept,
                "peak_mb": outcome.peak_mb,
                "findings": u32::from(!outcome.clean),
            })
        })
        .collect();
    let command = format!("cargo xtask fuzz --seconds {seconds}");
    let report = json!({ "command": command, "seconds_per_target": seconds, "targets": targets });
    let file = target("reports/fuzz.json");
    fs::create_dir_all(target("reports")).context("no target/reports")?;
    fs::write(&file, format!("{report:#}\n")).with_context(|| format!("no {}", file.display()))
}

/// One input through the body of its target, with a print of every step.
fn replay(input: &Path) -> Result<()> {
    let input = fs::canonicalize(input).with_context(|| format!("no {}", input.display()))?;
    let folder = input.parent().and_then(Path::file_name).unwrap_or_default();
    let name = folder.to_string_lossy().into_owned();
    if !targets()?.contains(&name) {
        bail!(
            "{} does not lie in a folder with the name of a target",
            input.display()
        );
    }
    let status = Command::new("cargo")
        .args([
            "test",
            "--quiet",
            "--package",
            "ferrocnc-fuzz-targets",
            "--test",
            "replay",
        ])
        .args(["--", "--ignored", "--nocapture", "one_input_by_hand"])
        .env("FERROCNC_FUZZ_INPUT", &input)
        .env("FERROCNC_FUZZ_TARGET", &name)
        .current_dir(root())
        .status()
        .context("cannot start cargo")?;
    if status.success() {
        println!("  + {name}: nothing is found in {}", input.display());
        return Ok(());
    }
    bail!("{name}: {} is a finding, as said above", input.display())
}

#[cfg(test)]
mod tests {
    use super::*;

    const LOG: &str = "\
INFO: Loaded 1 modules   (28374 inline 8-bit counters): 28374 [0x55, 0x56),
#2\tINITED cov: 10 ft: 11 corp: 1/1b exec/s: 0 rss: 27Mb
#199\tNEW    cov: 1655 ft: 3693 corp: 82/2633b lim: 65 exec/s: 0 rss: 31Mb L: 58/65 MS: 2 InsertByte-CrossOver-

thread '<unnamed>' (5226) panicked at targets/src/frames.rs:504:5:
38 bytes
stack backtrace:
   0: __rustc::rust_begin_unwind
==1== ERROR: libFuzzer: deadly signal
artifact_prefix='x/'; Test unit written to target/fuzz/findings/frames/crash-20e5
stat::number_of_executed_units: 200
stat::peak_rss_mb:              31
";

    #[test]
    fn a_log_says_how_far_it_came_and_what_was_found() {
        let outcome = Outcome::read("frames", LOG, false, 3);
        let pulse = Pulse {
            executions: 200,
            edges: 1655,
            kept: 82,
        };
        assert_eq!(outcome.pulse, pulse);
        assert_eq!((outcome.instrumented, outcome.peak_mb), (28374, 31));
        let input = Path::new("target/fuzz/findings/frames/crash-20e5");
        assert_eq!(outcome.input.as_deref(), Some(input));
        assert!(outcome.said.contains("38 bytes") && !outcome.said.contains("rust_begin"));
    }

    #[test]
    fn a_log_that_has_hardly_begun_says_nothing() {
        assert_eq!(Pulse::last(""), Pulse::default());
        assert_eq!(Pulse::last("INFO: Seed: 1\n#").edges, 0);
    }
}
