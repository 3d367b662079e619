//! Checks the pages: no link is dead, every page is in the summary, every decision in the index,
//! every `cargo xtask` command exists, and every message of the troubleshooting page is in the
//! source. Tests of `host` check the commands of `ferrocnc` (`tests/pages.rs`, and beside its
//! `main`).

use super::*;
use clap::CommandFactory;
use std::path::PathBuf;

/// The files below a folder of the repository with this ending.
fn files(folder: &str, ending: &str) -> Vec<PathBuf> {
    let folder = root().join(folder);
    let found = tree::with_ending(&folder, ending).unwrap();
    found.iter().map(|file| folder.join(file)).collect()
}

fn read(path: &Path) -> String {
    fs::read_to_string(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

#[test]
fn no_link_of_any_page_is_dead() {
    let dead = links::dead(root()).unwrap();
    assert!(dead.is_empty(), "dead links:\n{}", dead.join("\n"));
}

#[test]
fn every_page_is_in_the_summary() {
    let summary = read(&root().join("docs/SUMMARY.md"));
    for page in files("docs", "md") {
        let name = page.strip_prefix(root().join("docs")).unwrap();
        let entry = format!("({})", name.display());
        assert!(
            name == Path::new("SUMMARY.md") || summary.contains(&entry),
            "docs/SUMMARY.md has no {entry}"
        );
    }
}

#[test]
fn every_decision_is_in_the_index_with_its_status_and_date() {
    let index = read(&root().join("docs/decisions/README.md"));
    for page in files("docs/decisions", "md") {
        let name = page.file_name().unwrap().to_string_lossy().into_owned();
        if name == "README.md" {
            continue;
        }
        let text = read(&page);
        let said = |what: &str| {
            let line = text.lines().find_map(|line| line.strip_prefix(what));
            line.unwrap_or_else(|| panic!("{name} has no line `{what}`"))
        };
        let title = text.lines().next().unwrap();
        let title = title.split_once(". ").unwrap().1;
        let row = format!(
            "({name}) | {title} | {} | {} |",
            said("* Status: "),
            said("* Date: ")
        );
        assert!(
            index.contains(&row),
            "docs/decisions/README.md has no row\n{row}"
        );
    }
}

/// The `cargo xtask ...` commands in fenced blocks and code spans of a page.
fn xtask_commands(page: &str) -> Vec<String> {
    let mut found = Vec::new();
    let mut fenced = false;
    for line in page.lines() {
        if line.trim_start().starts_with("```") {
            fenced = !fenced;
        } else if fenced {
            let line = line.trim_start().trim_start_matches("$ ");
            if line.starts_with("cargo xtask ") {
                found.push(line.to_owned());
            }
        } else {
            let spans = line.split('`').skip(1).step_by(2);
            found.extend(
                spans
                    .filter(|s| s.starts_with("cargo xtask "))
                    .map(str::to_owned),
            );
        }
    }
    found
}

/// The word after each `cargo xtask` in code spans of a source's messages and comments.
fn xtask_words(text: &str) -> Vec<&str> {
    let spans = text.split("`cargo xtask ").skip(1);
    let end = |span: &str| span.find(|c: char| !c.is_ascii_lowercase() && c != '-');
    spans
        .map(|span| &span[..end(span).unwrap_or(span.len())])
        .filter(|word| !word.is_empty())
        .collect()
}

#[test]
fn every_command_of_xtask_in_a_source_is_one() {
    let known = crate::Cli::command();
    let (mut wrong, mut tried) = (Vec::new(), 0);
    for ending in ["rs", "py", "sh", "sv", "cpp", "toml", "hal", "yml"] {
        for file in tree::with_ending(root(), ending).unwrap() {
            for word in xtask_words(&read(&root().join(&file))) {
                tried += 1;
                if known.find_subcommand(word).is_none() {
                    wrong.push(format!("{}: cargo xtask {word}", file.display()));
                }
            }
        }
    }
    assert!(tried > 40, "only {tried} commands found");
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

/// The words of a command without what explains it: a comment, or text after two blanks. Words that
/// stand for others (`NAME`, `..`, `[..]`, `a|b`) are left out with all behind them; then it is not
/// whole.
fn words(command: &str) -> (Vec<&str>, bool) {
    let command = command.split(" #").next().unwrap();
    let command = command.split("  ").next().unwrap();
    let placeholder = |word: &&str| {
        word.contains(['|', '[', ']', '\\'])
            || word.contains("..")
            || word.ends_with(char::is_uppercase)
    };
    let all: Vec<_> = command.split_whitespace().skip(1).collect();
    let known: Vec<_> = all
        .iter()
        .copied()
        .take_while(|word| !placeholder(word))
        .collect();
    let whole = known.len() == all.len();
    (known, whole)
}

#[test]
fn every_command_of_xtask_on_a_page_is_one() {
    let mut pages = files("docs", "md");
    pages.extend(["README.md", "CONTRIBUTING.md", "fuzz/README.md"].map(|p| root().join(p)));
    let mut tried = 0;
    for page in pages.iter().filter(|page| page.exists()) {
        for command in xtask_commands(&read(page)) {
            // `cargo xtask ...` is all of them.
            let (words, whole) = words(&command);
            if words.len() < 2 {
                continue;
            }
            let parsed = crate::Cli::command().try_get_matches_from(words);
            tried += 1;
            if let Err(error) = parsed {
                use clap::error::ErrorKind::*;
                // A page may name a command without the argument it needs.
                let named = match error.kind() {
                    MissingRequiredArgument | MissingSubcommand | DisplayHelp => true,
                    InvalidValue => !whole,
                    _ => false,
                };
                assert!(named, "{}: {command}\n{error}", page.display());
            }
        }
    }
    assert!(tried > 40, "only {tried} commands found");
}

#[test]
fn every_message_of_the_troubleshooting_page_is_in_the_source() {
    let mut sources = String::new();
    for crate_ in [
        "host/src",
        "config/src",
        "wire/src",
        "motion/src",
        "jobs/src",
        "firmware/src",
    ] {
        for file in files(crate_, "rs") {
            sources += &read(&file);
        }
    }
    // A text that goes on in the next line of the source.
    let mut joined = String::new();
    let mut rest = sources.as_str();
    while let Some((before, behind)) = rest.split_once("\\\n") {
        joined += before;
        rest = behind.trim_start();
    }
    joined += rest;
    let page = read(&root().join("docs/guide/troubleshooting.md"));
    let rows = page.lines().filter_map(|line| line.strip_prefix("| `"));
    let mut messages = 0;
    for row in rows {
        let message = row.split('`').next().unwrap();
        for part in message
            .split("...")
            .map(str::trim)
            .filter(|part| !part.is_empty())
        {
            assert!(
                joined.contains(part),
                "no message says {part:?} (of {message:?})"
            );
        }
        messages += 1;
    }
    assert!(messages > 20, "only {messages} messages found");
}

/// It has one line per page.
const SUMMARY: &str = "docs/SUMMARY.md";

#[test]
fn prose_is_narrow() {
    let mut wrong = Vec::new();
    for page in tree::with_ending(root(), "md").unwrap() {
        let name = page.display().to_string();
        if name == SUMMARY {
            continue;
        }
        let text = read(&root().join(&page));
        links::each_line_of_prose(&text, |number, line| {
            // Marks of figures are not shown.
            let shown: String = line
                .split("<!--")
                .enumerate()
                .map(|(n, part)| match n {
                    0 => part,
                    _ => part.split_once("-->").map_or("", |(_, behind)| behind),
                })
                .collect();
            let wide = shown.chars().count() > 100;
            if wide && !shown.starts_with(['|', '!']) {
                wrong.push(format!("{name}:{number}: wider than 100 columns"));
            }
        });
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn no_file_has_the_marks_of_a_merge() {
    let marks = ["<", ">"].map(|mark| mark.repeat(7) + " ");
    let mut wrong = Vec::new();
    for file in tree::files(root()).unwrap() {
        // What is no text has no lines.
        let Ok(text) = fs::read_to_string(root().join(&file)) else {
            continue;
        };
        let lines = text.lines().enumerate();
        let marked = lines.filter(|(_, line)| marks.iter().any(|mark| line.starts_with(mark)));
        wrong.extend(marked.map(|(n, _)| format!("{}:{}", file.display(), n + 1)));
    }
    assert_eq!(wrong, Vec::<String>::new());
}

#[test]
fn every_file_that_contributing_names_is_there() {
    let text = read(&root().join("CONTRIBUTING.md"));
    let mut named = 0;
    for span in text.split('`').skip(1).step_by(2) {
        let file = span.contains('/') && !span.contains([' ', '*', ':']);
        if file {
            assert!(root().join(span).exists(), "CONTRIBUTING.md names {span}");
            named += 1;
        }
    }
    assert!(named > 25, "only {named} files found");
}

#[test]
fn a_link_out_of_docs_leads_to_the_repository() {
    let page = "[a](../README.md) [b](pins.md#x) [c](https://x.y) [d](cores/README.md#e)";
    let wanted = format!(
        "[a]({REPOSITORY}/README.md) [b](pins.md#x) [c](https://x.y) [d](cores/index.md#e)"
    );
    assert_eq!(for_the_site(page, Path::new("docs/page.md")), wanted);
}
