//! `cargo xtask counts`: lines of each crate, circles of modules, files and functions that are too
//! long, and warnings of clippy, of the tree and of the commit before it was put in order, by the
//! same code.

use crate::lint::{circles, lengths};
use crate::{root, step, target, tree};
use anyhow::{Context, Result};
use clap::Args;
use serde_json::{Map, Value, json};
use std::collections::BTreeSet;
use std::fs;
use std::path::Path;
use std::process::Command;

/// The last commit before the tree was put in order.
const BEFORE: &str = "f03de04";

/// What can be counted.
#[derive(Args)]
pub struct Options {
    /// The commit to compare with.
    #[arg(long, value_name = "COMMIT", default_value = BEFORE)]
    before: String,
}

/// Counts both, prints the table and leaves it in `target/reports/counts.json`.
pub fn run(options: &Options) -> Result<()> {
    step::heading("counts");
    let folder = target("tmp/before");
    tree::check_out(&options.before, &folder)?;
    let (mut before, mut now) = (of(&folder)?, of(root())?);
    before.insert(
        "clippy_warnings".into(),
        warnings(&folder, "before")?.into(),
    );
    now.insert("clippy_warnings".into(), warnings(root(), "now")?.into());
    let rows = beside(&before, &now);
    for row in &rows {
        let count = |key: &str| row[key].as_u64().unwrap_or(0);
        let name = row["name"].as_str().unwrap_or_default();
        println!("{name:<34} {:>8} {:>8}", count("before"), count("now"));
    }
    fs::remove_dir_all(&folder).context("the checkout of before")?;
    let report = json!({ "commit": options.before, "rows": rows });
    let file = target("reports/counts.json");
    fs::create_dir_all(target("reports")).context("no target/reports")?;
    fs::write(&file, format!("{report:#}\n")).with_context(|| format!("no {}", file.display()))
}

/// The counts of a tree, by name.
fn of(root: &Path) -> Result<Map<String, Value>> {
    let (mut counts, mut files, mut functions) = (Map::new(), 0, 0);
    for file in tree::with_ending(root, "rs")? {
        let text = fs::read_to_string(root.join(&file))?;
        if text.starts_with(lengths::GENERATED) {
            continue;
        }
        let name = file.components().next().context("a file has a name")?;
        let name = format!("lines of {}", name.as_os_str().to_string_lossy());
        let lines = counts.get(&name).and_then(Value::as_u64).unwrap_or(0);
        counts.insert(name, (lines + text.lines().count() as u64).into());
        let (file, long) = lengths::too_long(&file.display().to_string(), &text);
        files += u64::from(file.is_some());
        functions += long.len() as u64;
    }
    let circles = circles::all(root)?.len();
    counts.insert("uses in circles of modules".into(), circles.into());
    counts.insert("files above 800 lines".into(), files.into());
    counts.insert("functions above 100 lines".into(), functions.into());
    Ok(counts)
}

/// Warnings of clippy in a tree, with its own settings.
fn warnings(root: &Path, name: &str) -> Result<u64> {
    let mut clippy = Command::new("cargo");
    clippy.args(["clippy", "--workspace", "--all-targets", "--message-format"]);
    clippy.args(["json", "--quiet"]).current_dir(root);
    clippy.env("CARGO_TARGET_DIR", target(&format!("clippy-{name}")));
    let title = format!("clippy: {name}");
    let printed = step::run_quietly(&format!("clippy-{name}"), &title, "3 min", &mut clippy)?;
    Ok(told(&printed))
}

/// How many different warnings are in cargo's messages: a target and its tests tell the same.
fn told(printed: &str) -> u64 {
    let messages = printed.lines().filter_map(|line| {
        let message: Value = serde_json::from_str(line).ok()?;
        let message = &message["message"];
        // What has no code sums up the others.
        let warns = message["level"] == "warning" && !message["code"].is_null();
        warns.then(|| message["rendered"].to_string())
    });
    messages.collect::<BTreeSet<_>>().len() as u64
}

/// A row for each count of both; what one of them does not have is 0 there.
fn beside(before: &Map<String, Value>, now: &Map<String, Value>) -> Vec<Value> {
    let mut names: Vec<&String> = before.keys().chain(now.keys()).collect();
    names.sort();
    names.dedup();
    let row = |name: &&String| {
        let count = |of: &Map<String, Value>| of.get(*name).cloned().unwrap_or(0.into());
        json!({ "name": name, "before": count(before), "now": count(now) })
    };
    names.iter().map(row).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tree_is_counted_and_a_crate_of_one_of_two_trees_has_no_lines_in_the_other() {
        let folder = target("tmp/counts");
        for (file, text) in [
            ("a/src/lib.rs", "mod x;\nmod y;\n".to_owned()),
            ("a/src/x.rs", "use crate::y;\n".to_owned()),
            ("a/src/y.rs", "use crate::x;\n".to_owned()),
            (
                "a/src/z.rs",
                "fn f() {\n".to_owned() + &"\n".repeat(800) + "}\n",
            ),
        ] {
            let file = folder.join(file);
            fs::create_dir_all(file.parent().unwrap()).unwrap();
            fs::write(file, text).unwrap();
        }
        let counts = of(&folder);
        fs::remove_dir_all(&folder).unwrap();
        let wanted = json!({
            "lines of a": 806,
            "uses in circles of modules": 2,
            "files above 800 lines": 1,
            "functions above 100 lines": 1,
        });
        let counts = counts.unwrap();
        assert_eq!(Value::from(counts.clone()), wanted);
        let rows = beside(&Map::new(), &counts);
        let lines = json!({"name": "lines of a", "before": 0, "now": 806});
        assert!(rows.contains(&lines), "{rows:?}");
    }

    #[test]
    fn a_warning_counts_once_and_their_sum_does_not() {
        let warning = |code: &str, text: &str| {
            format!(
                r#"{{"message": {{"level": "warning", "code": {code}, "rendered": "{text}"}}}}"#
            )
        };
        let [one, two] = ["one", "two"].map(|text| warning("{}", text));
        let sum = warning("null", "2 warnings emitted");
        let built = r#"{"reason": "build-finished"}"#;
        let printed = [&one, &two, &one, &sum, built].map(str::to_owned);
        assert_eq!(told(&printed.join("\n")), 2);
    }
}
