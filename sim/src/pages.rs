//! Checks that this program takes every `ferrocnc-sim` command of the documentation.

use super::Arguments;
use clap::Parser;
use std::path::Path;

/// The words of a command, as a shell has them: `'...'` is one word.
fn words(command: &str) -> Vec<String> {
    let (mut words, mut quoted) = (vec![String::new()], false);
    for sign in command.chars() {
        match sign {
            '\'' => quoted = !quoted,
            ' ' if !quoted => words.push(String::new()),
            _ => words.last_mut().expect("a word").push(sign),
        }
    }
    words.retain(|word| !word.is_empty());
    words
}

/// The commands of a page, in blocks and in the text, from the name of the program on.
fn commands(page: &str) -> Vec<String> {
    let page = page.replace("\\\n", " ");
    let page = page.replace("-p ferrocnc-sim -- ", "ferrocnc-sim ");
    let found = page.match_indices("ferrocnc-sim --").map(|(at, _)| {
        let rest = &page[at..];
        let end = rest.find(['`', '\n']).unwrap_or(rest.len());
        rest[..end].to_owned()
    });
    found.collect()
}

#[test]
fn every_command_of_the_simulator_on_a_page_is_taken() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let mut tried = 0;
    for page in [
        "docs/architecture.md",
        "docs/bringup.md",
        "docs/guide/first-machine.md",
        "docs/guide/jobs.md",
        "docs/jobs.md",
        "docs/provisioning.md",
        "docs/simulation.md",
    ] {
        let text = std::fs::read_to_string(root.join(page)).expect("a page");
        let commands = commands(&text);
        assert!(!commands.is_empty(), "{page} names no command");
        for command in commands {
            if let Err(error) = Arguments::try_parse_from(words(&command)) {
                use clap::error::ErrorKind::{DisplayHelp, MissingRequiredArgument};
                // A page may name an option without the rest.
                let named = [DisplayHelp, MissingRequiredArgument].contains(&error.kind());
                assert!(named, "{page}: {command}\n{error}");
            }
            tried += 1;
        }
    }
    assert!(tried > 7, "only {tried} commands found");
}
