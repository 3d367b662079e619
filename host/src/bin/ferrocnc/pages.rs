//! Checks that this program takes every `ferrocnc` command of the documentation, options included.

use super::Arguments;
use clap::Parser;
use std::fs;
use std::path::{Path, PathBuf};

/// The pages: README, `docs/` and the examples.
fn pages() -> Vec<PathBuf> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let mut found = vec![root.join("README.md")];
    let mut folders = vec![root.join("docs"), root.join("host/examples")];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(&folder).expect("a folder") {
            let path = entry.expect("an entry").path();
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|ending| ending == "md") {
                found.push(path);
            }
        }
    }
    found
}

/// The commands in the fenced blocks of a page; `a|b` in one of them makes two.
fn commands(page: &str) -> Vec<String> {
    let mut found = Vec::new();
    let mut fenced = false;
    for line in page.lines() {
        let line = line.trim_start().trim_start_matches("$ ");
        if line.starts_with("```") {
            fenced = !fenced;
            continue;
        }
        let line = line.trim_start_matches("target/release/");
        if !fenced || !line.starts_with("ferrocnc ") {
            continue;
        }
        // What explains the command: a comment, or text after two blanks.
        let command = line.split(" #").next().expect("a part");
        let command = command.split("  ").next().expect("a part");
        let choice = command.split(' ').find(|word| word.contains('|'));
        match choice {
            None => found.push(command.to_owned()),
            Some(words) => {
                found.extend(
                    words
                        .split('|')
                        .map(|word| command.replacen(words, word, 1)),
                );
            }
        }
    }
    found
}

#[test]
fn every_command_of_the_documentation_is_taken() {
    let mut tried = 0;
    for page in pages() {
        let text = fs::read_to_string(&page).expect("a page");
        for command in commands(&text) {
            if let Err(error) = Arguments::try_parse_from(command.split_whitespace()) {
                panic!("{}: {command}\n{error}", page.display());
            }
            tried += 1;
        }
    }
    assert!(tried > 40, "only {tried} commands found");
}

#[test]
fn a_command_is_what_a_reader_would_type() {
    let page = "ferrocnc no\n```\n$ ferrocnc a|b x   what it does\nferrocnc c   # why\n```\n";
    assert_eq!(
        commands(page),
        ["ferrocnc a x", "ferrocnc b x", "ferrocnc c"]
    );
}
