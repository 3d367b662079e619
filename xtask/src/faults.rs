//! Runs the tests of the fault table, and prints for each row of docs/safety.md the level that
//! shows it.
//!
//! The table is in the document. A row names its tests as `binary::name`; the results of this level
//! count.

use crate::{cargo_tests, root, step, target};
use anyhow::{Context, Result, bail};
use serde_json::{Value, json};
use std::collections::HashMap;

/// The test binaries of this level.
const BINARIES: [&str; 3] = ["faults", "faults_rtl", "faults_measured"];

/// Runs the level and writes target/reports/faults.json; how many tests passed.
pub fn run() -> Result<usize> {
    let figures = target("reports/faults");
    std::fs::create_dir_all(&figures)?;
    let mut cargo = cargo_tests::of_boards();
    cargo.args(["--no-fail-fast"]);
    for name in BINARIES {
        cargo.args(["--test", name]);
    }
    cargo.args(["--", "--test-threads", "2"]);
    cargo.env("FERROCNC_REPORTS", &figures);
    let title = "the fault table: twin and RTL";
    let outcome = step::run_quietly("test-faults", title, "4 min", &mut cargo);
    let log = std::fs::read_to_string(step::log_path("test-faults")?)?;
    let results = results(&log);
    let document = std::fs::read_to_string(root().join("docs/safety.md"))?;
    let rows: Vec<Value> = rows(&document, &results);
    let read = |name: &str| -> Value {
        let text = std::fs::read_to_string(figures.join(format!("{name}.json")));
        text.ok()
            .and_then(|text| serde_json::from_str(&text).ok())
            .unwrap_or(Value::Null)
    };
    let bite = read("bite");
    let report = json!({
        "rows": rows,
        "bite_clocks": bite["bite_clocks"],
        "bite": bite,
        "reset": read("reset"),
        "reset_rtl": read("reset_rtl"),
        "loss": read("loss"),
        "soak": read("soak"),
    });
    let path = target("reports/faults.json");
    std::fs::write(&path, serde_json::to_string_pretty(&report)?)?;
    outcome?;
    if let Some(row) = rows.iter().find(|row| row["passed"] != true) {
        bail!("{row} in {}", path.display());
    }
    println!(
        "    {} rows shown; bite {} to {} clocks; figures: {}",
        rows.len(),
        bite["bite_clocks"]["min"],
        bite["bite_clocks"]["max"],
        path.display()
    );
    Ok(results.values().filter(|passed| **passed).count())
}

/// A figure that takes long: the test of this name with this in its environment. Its report is
/// `target/reports/NAME.json`.
pub fn measure(name: &str, test: &str, expect: &str, variable: &str, value: u64) -> Result<()> {
    step::heading(&format!("bench: {name}"));
    let mut cargo = cargo_tests::of_boards();
    cargo.args(["--test", "faults_measured", test, "--", "--nocapture"]);
    std::fs::create_dir_all(target("reports"))?;
    cargo.env("FERROCNC_REPORTS", target("reports"));
    cargo.env(variable, value.to_string());
    let printed = step::run_quietly(&format!("bench-{name}"), name, expect, &mut cargo)?;
    let told = ["loss ", "simulated"];
    for line in printed
        .lines()
        .filter(|line| told.iter().any(|word| line.contains(word)))
    {
        println!("{line}");
    }
    let report = target(&format!("reports/{name}.json"));
    std::fs::metadata(&report)
        .with_context(|| format!("no report at {}", report.display()))
        .map(drop)
}

/// What cargo said: `binary::name` and whether it passed.
fn results(log: &str) -> HashMap<String, bool> {
    let mut binary = "";
    let mut results = HashMap::new();
    for line in log.lines() {
        if let Some(running) = line.trim_start().strip_prefix("Running tests/") {
            binary = running.split(".rs").next().unwrap_or_default();
        } else if let Some(test) = line.strip_prefix("test ")
            && let Some((name, said)) = test.split_once(" ... ")
        {
            results.insert(format!("{binary}::{name}"), said.ends_with("ok"));
        }
    }
    results
}

/// The rows of the document's first table that this level has tests for, each with a line per
/// level.
fn rows(document: &str, results: &HashMap<String, bool>) -> Vec<Value> {
    let table = document
        .lines()
        .skip_while(|line| !line.starts_with("| event"));
    let mut rows = Vec::new();
    for line in table.skip(2).take_while(|line| line.starts_with('|')) {
        let event = line.split('|').nth(1).unwrap_or_default().trim();
        for binary in BINARIES {
            let prefix = format!("`{binary}::");
            let mut named = line
                .split(&prefix)
                .skip(1)
                .filter_map(|rest| rest.split('`').next());
            let mut any = false;
            let passed = named.all(|name| {
                any = true;
                results
                    .get(&format!("{binary}::{name}"))
                    .copied()
                    .unwrap_or(false)
            });
            if any {
                rows.push(json!({"event": event, "level": binary, "passed": passed}));
            }
        }
    }
    rows
}

#[cfg(test)]
mod tests {
    use super::*;

    const DOCUMENT: &str = "\
| event | noticed by | test |
|---|---|---|
| one frame lost | host | `faults::one_frame_lost` |
| pulled | gate | `faults::pulled`, `faults_rtl::pulled`; `soc::elsewhere` |

| event | another table |
|---|---|
| x | `faults::x` |
";
    const LOG: &str = "\
     Running tests/faults.rs (target/release/deps/faults-1)
test one_frame_lost ... ok
test pulled ... ok
     Running tests/faults_rtl.rs (target/release/deps/faults_rtl-1)
test pulled ... FAILED
";

    #[test]
    fn a_row_is_shown_at_each_level_it_has_a_test_in() {
        let rows = rows(DOCUMENT, &results(LOG));
        let told: Vec<_> = rows
            .iter()
            .map(|row| format!("{} {} {}", row["event"], row["level"], row["passed"]))
            .collect();
        assert_eq!(
            told,
            [
                "\"one frame lost\" \"faults\" true",
                "\"pulled\" \"faults\" true",
                "\"pulled\" \"faults_rtl\" false"
            ]
        );
    }

    #[test]
    fn a_test_that_did_not_run_shows_nothing() {
        assert_eq!(rows(DOCUMENT, &HashMap::new())[0]["passed"], false);
    }
}
