//! Every test that docs/safety.md names exists, and every test of the fault table is in the
//! document.

use ferrocnc_tests::root;
use std::collections::BTreeSet;
use std::path::Path;

fn document() -> String {
    std::fs::read_to_string(root().join("docs/safety.md")).expect("docs/safety.md")
}

/// Names as `place::test` between backticks.
fn named(text: &str) -> BTreeSet<(String, String)> {
    let quoted = text.split('`').skip(1).step_by(2);
    let pairs = quoted.filter_map(|name| name.split_once("::"));
    let word = |text: &str| {
        !text.is_empty() && text.chars().all(|c| c.is_ascii_alphanumeric() || c == '_')
    };
    pairs
        .filter(|(place, name)| word(place) && word(name))
        .map(|(place, name)| (place.into(), name.into()))
        .collect()
}

/// Everything Rust below a folder, or one file.
fn sources(at: &Path) -> String {
    if at.is_file() {
        return std::fs::read_to_string(at).expect("a source");
    }
    let Ok(folder) = std::fs::read_dir(at) else {
        return String::new();
    };
    let entries = folder.map(|entry| entry.expect("an entry").path());
    let wanted =
        entries.filter(|path| path.is_dir() || path.extension().is_some_and(|e| e == "rs"));
    wanted.map(|path| sources(&path)).collect()
}

/// Where the tests of a place are: in a crate, or in a file here. `jobs` is both.
fn place(name: &str) -> String {
    let crates = [
        "host", "firmware", "sim", "wire", "motion", "jobs", "config",
    ];
    let of_crate = match crates.contains(&name) {
        true => ["src", "tests"]
            .map(|folder| sources(&root().join(name).join(folder)))
            .concat(),
        false => String::new(),
    };
    let here = ["", ".rs"].map(|ending| root().join(format!("tests/tests/{name}{ending}")));
    of_crate + &here.map(|at| sources(&at)).concat()
}

/// The names of the tests in a source.
fn tests(source: &str) -> BTreeSet<String> {
    let mut names = BTreeSet::new();
    let mut marked = false;
    for line in source.lines().map(str::trim) {
        if line.starts_with("#[test]") {
            marked = true;
        } else if let Some(rest) = line.strip_prefix("fn ")
            && std::mem::take(&mut marked)
        {
            names.extend(rest.split('(').next().map(String::from));
        }
    }
    names
}

#[test]
fn every_test_that_is_named_exists() {
    let names = named(&document());
    assert!(names.len() > 30, "only {} names were found", names.len());
    let missing: Vec<_> = names
        .iter()
        .filter(|(at, name)| !tests(&place(at)).contains(name))
        .map(|(at, name)| format!("{at}::{name}"))
        .collect();
    assert!(
        missing.is_empty(),
        "docs/safety.md names tests that do not exist: {missing:?}"
    );
}

#[test]
fn every_row_of_the_design_has_a_test_of_its_name() {
    let rows = [
        "powered, CPU not running",
        "ABI mismatch",
        "wire version mismatch",
        "one frame lost",
        "frames lost past the timeout",
        "duplicated, reordered, stale frame",
        "malformed, truncated, padded, oversized datagram",
        "foreign host writes",
        "cable pulled, replugged",
        "firmware hangs or panics",
        "external reset pin high",
        "host thread panics or overruns",
        "LinuxCNC exits or is killed",
        "counter passes 2^32 or 2^63",
        "rate asks more than the timing allows",
        "power fails during a flash update",
    ];
    let document = document();
    for row in rows {
        let line = document
            .lines()
            .find(|line| line.starts_with(&format!("| {row} |")));
        let line = line.unwrap_or_else(|| panic!("docs/safety.md has no row {row:?}"));
        let plain = row
            .to_lowercase()
            .replace(", ", "_")
            .replace([' ', '^'], "_");
        assert!(
            line.contains(&format!("`faults::{plain}`")),
            "the row {row:?} does not name faults::{plain}"
        );
        let gateware = line.contains("**gateware**");
        assert!(
            !gateware || line.contains("`faults_rtl::"),
            "the row {row:?} is the gateware's and has no test on the RTL"
        );
    }
}

#[test]
fn every_test_of_the_fault_table_is_in_the_document() {
    let names = named(&document());
    for at in ["faults", "faults_rtl"] {
        for test in tests(&place(at)) {
            let listed = names.contains(&(at.into(), test.clone()));
            assert!(listed, "{at}::{test} is in no row of docs/safety.md");
        }
    }
}
