//! `cargo xtask mutants [AREA..]`: changes the code in one place at a time and expects a test to
//! fail.
//!
//! An area is some files and their tests (`tests/mutants.toml`). In Rust
//! `cargo-mutants` makes the mutants: one build and one run of the area's tests for each. In the
//! cores `gateware/tests/mutants.sh` has them, written by hand, one bench per area.
//!
//! A mutant that no test notices is a survivor. A survivor needs a new test, or an entry in
//! `tests/mutants.toml` with the reason why no test can tell it from the code. Any other survivor
//! fails the command. An entry of that list which no longer survives is said to be stale.
//!
//! An area that takes longer than there is time for is sampled: `--sample 8` tries one mutant of
//! eight, and its result says so. `--explained` tries only what the list explains: whether its
//! entries are true, in minutes.
//!
//! The last result of every area is kept in `target/reports/mutants.json`.

mod list;

use crate::{root, setup, step, target};
use anyhow::{Context, Result, bail};
use clap::Args;
use list::{Area, List, Survivor, Verdict};
use serde_json::{Value, json};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, ExitStatus};
use std::time::Instant;

/// What `cargo mutants` ends with: all caught, some missed, some ran into the time limit.
const JUDGED: [i32; 3] = [0, 2, 3];

/// 20 s: the tests of an area take seconds, and a mutant that never ends holds a core.
const TIMEOUT_SECONDS: &str = "20";

/// Which areas.
#[derive(Args)]
pub struct Options {
    /// Areas by name, or by the beginning of their names: `firmware` is all of `firmware-*`. All
    /// when none is named.
    areas: Vec<String>,
    /// Only say which areas there are, and how many mutants each has.
    #[arg(long)]
    list: bool,
    /// Only what survived the last time; the others count as they did. For writing the tests: not
    /// after the code has changed.
    #[arg(long, conflicts_with = "list")]
    again: bool,
    /// Of the Rust areas only every Nth mutant, from the first to the last of all files. The result
    /// says so, and `--again` keeps to it.
    #[arg(long, value_name = "N", conflicts_with_all = ["list", "again"], value_parser = clap::value_parser!(u32).range(2..))]
    sample: Option<u32>,
    /// Of the Rust areas only the mutants with the wording of an entry of `tests/mutants.toml`:
    /// which of the entries still survive. Is not kept as a result of the area.
    #[arg(long, conflicts_with_all = ["list", "again", "sample"])]
    explained: bool,
}

/// How an area ended.
#[derive(Debug, Default)]
struct Outcome {
    caught: usize,
    /// Of the caught: a test did not end in time.
    timeouts: usize,
    /// Mutants that do not compile say nothing about the tests.
    unviable: usize,
    /// Every so many-th of the area's mutants was tried; 1 is all of them.
    sample: u32,
    survivors: Vec<Survivor>,
    /// What is wrong with the mutants themselves: a line of `mutants.sh` that no longer fits its
    /// core.
    faults: Vec<String>,
}

/// Runs the areas, or lists them.
pub fn run(options: &Options) -> Result<()> {
    let list = List::read(&root().join("tests/mutants.toml"))?;
    let areas = list.areas(&options.areas)?;
    if areas.iter().any(|area| area.bench.is_some()) && !options.list {
        setup::run(setup::Need::Gateware)?;
    }
    // Before the first area, so that no area of hours ends with a tool that cannot be had.
    let tool = match areas.iter().any(|area| area.bench.is_none()) {
        true => setup::cargo_mutants()?,
        false => PathBuf::new(),
    };
    let mut bad = 0;
    for area in areas {
        if options.list {
            println!(
                "{:<20} {:>4}  {}",
                area.name,
                count(&tool, area)?,
                area.what
            );
            continue;
        }
        step::heading(&format!("mutants: {}, {}", area.name, area.what));
        let begun = Instant::now();
        let entries = match options.explained {
            true => explained(&tool, &list, area)?,
            false => Vec::new(),
        };
        if options.explained && entries.is_empty() {
            step::note("no entries to try");
            continue;
        }
        let outcome = match &area.bench {
            Some(bench) => rtl(area, bench)?,
            None => rust(&tool, area, options, &entries)?,
        };
        let verdict = judge(&list, area, &outcome);
        tell(&outcome, &verdict);
        if options.explained {
            bad += verdict.missed.len();
            continue;
        }
        let before = match options.again {
            true => last(area)["seconds"].as_u64().unwrap_or(0),
            false => 0,
        };
        let seconds = before + begun.elapsed().as_secs();
        report(area, &outcome, &verdict, seconds)?;
        bad += verdict.missed.len() + outcome.faults.len();
    }
    if bad > 0 {
        bail!(
            "{bad} mutants survive and nothing explains them: write the test that kills each, or the reason why none can, \
             in tests/mutants.toml"
        );
    }
    Ok(())
}

/// `cargo mutants` on the files of an area.
fn cargo_mutants(tool: &Path, area: &Area) -> Result<Command> {
    let package = area
        .package
        .as_deref()
        .context("an area of Rust has a package")?;
    let mut command = Command::new(tool);
    command.args(["mutants", "--package", package]);
    for file in &area.files {
        command.args(["--file", file]);
    }
    command.current_dir(root());
    Ok(command)
}

/// How many mutants an area has.
fn count(tool: &Path, area: &Area) -> Result<usize> {
    if let Some(bench) = &area.bench {
        let script = fs::read_to_string(root().join("gateware/tests/mutants.sh"))?;
        let mine = format!("mutant {bench} ");
        return Ok(script
            .lines()
            .filter(|line| line.starts_with(&mine))
            .count());
    }
    Ok(listed(tool, area)?.lines().count())
}

/// The names of an area's mutants of Rust, a line each.
fn listed(tool: &Path, area: &Area) -> Result<String> {
    let listed = setup::output(cargo_mutants(tool, area)?.arg("--list"));
    listed.context("cargo mutants --list failed")
}

/// The mutants of an area that the list explains, if they survive.
fn explained(tool: &Path, list: &List, area: &Area) -> Result<Vec<String>> {
    if area.bench.is_some() {
        return Ok(Vec::new());
    }
    let mut names = Vec::new();
    for name in listed(tool, area)?.lines() {
        if list.explains(&survivor(name)?) {
            names.push(name.to_owned());
        }
    }
    Ok(names)
}

/// What `cargo mutants` calls so, with its line of the source.
fn survivor(name: &str) -> Result<Survivor> {
    Survivor::of_rust(name, |file| Ok(fs::read_to_string(root().join(file))?))
}

/// The survivors beside the list. Of a sample no entry is stale: its mutant may not have been
/// tried.
fn judge(list: &List, area: &Area, outcome: &Outcome) -> Verdict {
    let mut verdict = list.judge(area, &outcome.survivors);
    if outcome.sample != 1 {
        verdict.stale.clear();
    }
    verdict
}

/// Mutants of Rust: a copy of the tree, a target folder of their own that every area shares.
/// `entries` are the names of those that `--explained` means.
fn rust(tool: &Path, area: &Area, options: &Options, entries: &[String]) -> Result<Outcome> {
    let again = options.again;
    // `--again` reads what a run of the area left.
    let out = match options.explained {
        true => target("mutants/explained").join(&area.name),
        false => target("mutants").join(&area.name),
    };
    fs::create_dir_all(&out).with_context(|| format!("cannot make {}", out.display()))?;
    let profile = match area.optimised {
        true => "mutants-optimised",
        false => "mutants",
    };
    let mut command = cargo_mutants(tool, area)?;
    command
        .args(["--profile", profile, "--jobs", "1", "--colors", "never"])
        .args(["--caught", "--minimum-test-timeout", TIMEOUT_SECONDS])
        .arg("--output")
        .arg(&out)
        .env("CARGO_TARGET_DIR", target("mutants/target"));
    let last = last(area);
    let before = |key: &str| match again {
        true => last[key].as_u64().unwrap_or(0) as usize,
        false => 0,
    };
    let lines = |name: &str| -> Result<Vec<String>> {
        let file = out.join("mutants.out").join(format!("{name}.txt"));
        let text = fs::read_to_string(&file).with_context(|| format!("no {}", file.display()))?;
        Ok(text.lines().map(str::to_owned).collect())
    };
    let sample = match again {
        true => before("sample").max(1) as u32,
        false => options.sample.unwrap_or(1),
    };
    let mut meant = Vec::new();
    if again {
        meant = lines("missed").with_context(|| format!("{} has not been run", area.name))?;
        if meant.is_empty() {
            return Ok(Outcome {
                caught: before("caught"),
                timeouts: before("timeouts"),
                unviable: before("unviable"),
                sample,
                ..Outcome::default()
            });
        }
        command.arg("--iterate");
    } else if options.explained {
        meant = entries.to_vec();
    } else if sample > 1 {
        command.args(["--shard", &format!("0/{sample}"), "--sharding=round-robin"]);
    }
    // After `--iterate`, too: what a sample has left out was not caught, and stays out.
    command.args(meant.iter().map(|name| format!("--re={}", exactly(name))));
    for argument in &area.targets {
        command.arg(format!("--cargo-arg={argument}"));
    }
    if let Some(package) = &area.tests_of {
        baseline(area, package, profile)?;
        command.args(["--test-package", package, "--baseline=skip"]);
        command.args(["--timeout", "60"]);
    }
    command.args(["--", "--"]).args(&area.filter);
    judged(area, &mut command, |code| JUDGED.contains(&code))?;
    let of = |name: &str| -> Result<Vec<String>> {
        let mut found = lines(name)?;
        // `--re` lets every mutant pass that deletes a field: only those that are meant count.
        found.retain(|name| meant.is_empty() || meant.contains(name));
        Ok(found)
    };
    let (missed, caught, timeouts) = (of("missed")?, of("caught")?, of("timeout")?);
    let survivors: Result<_> = missed.iter().map(|name| survivor(name)).collect();
    Ok(Outcome {
        caught: before("caught") + caught.len() + timeouts.len(),
        timeouts: before("timeouts") + timeouts.len(),
        unviable: match again {
            true => before("unviable"),
            false => of("unviable")?.len(),
        },
        sample,
        survivors: survivors?,
        faults: Vec::new(),
    })
}

/// The tests of another package on the code as it is: `cargo mutants` would look for them in the
/// package it mutates. In a target folder of their own: what the last mutant left in theirs is
/// newer than this tree's sources.
fn baseline(area: &Area, package: &str, profile: &str) -> Result<()> {
    let mut command = Command::new("cargo");
    command
        .args(["test", "--profile", profile, "--package", package])
        .args(&area.targets)
        .arg("--")
        .args(&area.filter)
        .env("CARGO_TARGET_DIR", target("mutants/baseline"));
    let name = format!("mutants-{}-baseline", area.name);
    step::run(&name, "its tests as they are", "5 min", &mut command)
}

/// The regular expression that a mutant's name fits, and no other's.
fn exactly(name: &str) -> String {
    let mut expression = String::from("^");
    for c in name.chars() {
        if r"\.+*?()|[]{}^$#&-~".contains(c) {
            expression.push('\\');
        }
        expression.push(c);
    }
    expression.push('$');
    expression
}

/// Mutants of a core, at its bench.
fn rtl(area: &Area, bench: &str) -> Result<Outcome> {
    let mut command = Command::new("bash");
    command.arg("gateware/tests/mutants.sh").arg(bench);
    let said = judged(area, &mut command, |code| code == 0 || code == 1)?;
    Ok(of_bench(&said))
}

/// What `mutants.sh` said, a line for each mutant.
fn of_bench(said: &str) -> Outcome {
    let mut outcome = Outcome {
        sample: 1,
        ..Outcome::default()
    };
    for line in said.lines() {
        match line.split_once(' ') {
            Some(("caught", _)) => outcome.caught += 1,
            Some(("SURVIVED", what)) => outcome.survivors.push(Survivor::of_rtl(what.trim())),
            Some(("STALE" | "SLOW" | "BROKEN", _)) => outcome.faults.push(line.to_owned()),
            Some(_) | None => {}
        }
    }
    outcome
}

/// Runs a command that says with its exit code how the mutants fared.
fn judged(area: &Area, command: &mut Command, fine: fn(i32) -> bool) -> Result<String> {
    let name = format!("mutants-{}", area.name);
    let title = format!("mutants of {}", area.name);
    let fine = |status: ExitStatus| status.code().is_some_and(fine);
    step::run_judged(
        &name,
        &title,
        &format!("{} min", area.minutes),
        command,
        fine,
    )
    .map(|printed| printed.text)
}

/// The area's result for a reader.
fn tell(outcome: &Outcome, verdict: &Verdict) {
    let sample = match outcome.sample {
        1 => String::new(),
        nth => format!("a sample, one mutant of {nth}: "),
    };
    step::note(&format!(
        "{sample}{} caught ({} of them by the time limit), {} explained, {} missed; {} do not compile",
        outcome.caught,
        outcome.timeouts,
        verdict.explained,
        verdict.missed.len(),
        outcome.unviable
    ));
    for survivor in &verdict.missed {
        println!("  x {survivor}");
    }
    for fault in &outcome.faults {
        println!("  x {fault}");
    }
    for stale in &verdict.stale {
        println!("  ! stale, it no longer survives; strike it from tests/mutants.toml: {stale}");
    }
}

/// Puts an area into `target/reports/mutants.json`, beside what others left there, and adds up.
fn report(area: &Area, outcome: &Outcome, verdict: &Verdict, seconds: u64) -> Result<()> {
    let file = target("reports/mutants.json");
    fs::create_dir_all(target("reports")).context("no target/reports")?;
    let commit = setup::output(Command::new("git").args(["rev-parse", "--short", "HEAD"]));
    let result = json!({
        "sample": outcome.sample,
        "caught": outcome.caught,
        "timeouts": outcome.timeouts,
        "unviable": outcome.unviable,
        "explained": verdict.explained,
        "missed": verdict.missed.len(),
        "stale": verdict.stale.len(),
        "faults": outcome.faults.len(),
        "survivors": verdict.missed.iter().map(ToString::to_string).collect::<Vec<_>>(),
        "seconds": seconds,
        "commit": commit.map(|text| text.trim().to_owned()),
    });
    let report = beside(read_report(&file), &area.name, result);
    fs::write(&file, format!("{report:#}\n")).with_context(|| format!("no {}", file.display()))
}

/// An area's last result.
fn last(area: &Area) -> Value {
    read_report(&target("reports/mutants.json"))["areas"][&area.name].clone()
}

fn read_report(file: &Path) -> Value {
    let text = fs::read_to_string(file).unwrap_or_default();
    serde_json::from_str(&text).unwrap_or_else(|_| json!({}))
}

/// The report with this area's result in it, and the sums over all areas.
fn beside(old: Value, name: &str, result: Value) -> Value {
    let mut areas = old["areas"].as_object().cloned().unwrap_or_default();
    areas.insert(name.to_owned(), result);
    let sum = |key: &str| {
        areas
            .values()
            .filter_map(|area| area[key].as_u64())
            .sum::<u64>()
    };
    json!({
        "command": "cargo xtask mutants",
        "caught": sum("caught"),
        "explained": sum("explained"),
        "missed": sum("missed"),
        "areas": areas,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_line_of_the_benches_counts_as_what_it_says() {
        let outcome = of_bench(
            "caught   pwm: period one long -- FAIL at 12\n\
             SURVIVED pwm: both pins at once\n\
             STALE    pwm: dither is a no-op (nothing to change)\n\
             %Warning: something else\n",
        );
        assert_eq!((outcome.caught, outcome.faults.len()), (1, 1));
        assert_eq!(outcome.survivors[0].mutation, "pwm: both pins at once");
    }

    #[test]
    fn a_survivor_is_asked_for_by_its_whole_name_and_as_it_is_written() {
        let name = "a.rs:3:9: replace Axis::lost -> [i32; 2] with [1; 2]";
        let said = r"^a\.rs:3:9: replace Axis::lost \-> \[i32; 2\] with \[1; 2\]$";
        assert_eq!(exactly(name), said);
    }

    #[test]
    fn an_entry_is_stale_only_where_every_mutant_was_tried() {
        let list = List::read(&root().join("tests/mutants.toml")).unwrap();
        let area = list.areas(&["firmware-server".to_owned()]).unwrap()[0];
        let stale = |sample| {
            let outcome = Outcome {
                sample,
                ..Outcome::default()
            };
            judge(&list, area, &outcome).stale.len()
        };
        assert!(stale(1) > 0);
        assert_eq!(stale(8), 0);
    }

    #[test]
    fn an_area_that_runs_again_replaces_its_own_result_only() {
        let area = |caught: u32| json!({ "caught": caught, "explained": 1, "missed": 0 });
        let report = beside(json!({}), "one", area(5));
        let report = beside(report, "two", area(7));
        let report = beside(report, "one", area(6));
        assert_eq!(
            (report["caught"].as_u64(), report["explained"].as_u64()),
            (Some(13), Some(2))
        );
    }
}
