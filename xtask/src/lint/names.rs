//! Checks that a name means one thing in all crates, and that modules lie at one kind of place.

use crate::{root, tree};
use std::fs;

/// Types whose name has one meaning: another one carries a prefix. `Line` is always prefixed.
const ONCE: [(&str, &str); 4] = [
    ("Segment", "motion/src/segment.rs"),
    ("Command", "wire/src/exchange.rs"),
    ("Machine", "firmware/src/machine.rs"),
    ("Line", ""),
];

/// The names of [`ONCE`] that a line defines as a type.
fn defines(line: &str) -> Option<&str> {
    let split = line.split(|c: char| !(c.is_alphanumeric() || c == '_'));
    let mut words = split.filter(|word| !word.is_empty());
    // `Name: u8 {` begins a type of the macro `codes`.
    let name = match line.trim().split_once(": u") {
        Some((name, "8 {" | "32 {")) => name,
        _ => {
            words.find(|word| ["struct", "enum", "union", "trait", "type"].contains(word))?;
            words.next()?
        }
    };
    ONCE.iter().any(|(once, _)| *once == name).then_some(name)
}

#[test]
fn a_name_has_one_meaning() {
    let mut wrong = Vec::new();
    let mut found = 0;
    for file in tree::with_ending(root(), "rs").unwrap() {
        // The PAC is generated: its types are named after registers. The examples below are text.
        if file.starts_with("pac") || file.ends_with("lint/names.rs") {
            continue;
        }
        let path = file.display().to_string();
        let text = fs::read_to_string(root().join(&file)).unwrap();
        for line in text
            .lines()
            .filter(|line| !line.trim_start().starts_with("//"))
        {
            match defines(line) {
                Some(name) if ONCE.contains(&(name, path.as_str())) => found += 1,
                Some(name) => wrong.push(format!("{path}: {name}")),
                None => {}
            }
        }
    }
    assert_eq!(found, 3, "a name of the list is defined nowhere, or twice");
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn a_module_with_a_folder_lies_beside_it() {
    let mut files = tree::with_ending(root(), "rs").unwrap();
    files.retain(|file| file.ends_with("mod.rs"));
    assert!(files.is_empty(), "x/mod.rs instead of x.rs: {files:?}");
}

#[test]
fn a_definition_is_recognised_and_a_use_is_not() {
    assert_eq!(defines("pub(crate) enum Command {"), Some("Command"));
    assert_eq!(defines("    struct Segment<'a>(u32);"), Some("Segment"));
    assert_eq!(defines("type Line = Vec<u8>;"), Some("Line"));
    assert_eq!(defines("    Command: u8 {"), Some("Command"));
    let others = [
        "let segment = Segment {",
        "struct TcpSegment {",
        "impl Command {",
        "struct",
    ];
    assert!(others.iter().all(|line| defines(line).is_none()));
}
