//! `ferrocnc config check`: is it a board file or a platform that can be built, and what is wrong?

use super::stem;
use crate::text::say;
use anyhow::{Result, bail};
use ferrocnc_config::source::read_text;
use ferrocnc_config::{Board, Error, Platform, read_board_text};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};

pub(super) fn check(files: &[PathBuf], as_json: bool) -> Result<()> {
    let results: Vec<(&PathBuf, Result<Read, Error>)> =
        files.iter().map(|file| (file, read(file))).collect();
    let wrong = results.iter().filter(|(_, result)| result.is_err()).count();
    if as_json {
        let list: Vec<Value> = results
            .iter()
            .map(|(file, result)| verdict(file, result))
            .collect();
        say(&format!("{:#}\n", Value::Array(list)))?;
    } else {
        for (file, result) in &results {
            match result {
                Ok(Read::Board(board)) => say(&format!(
                    "{}: ok, {}{}\n",
                    file.display(),
                    counts(board),
                    pinless(board)
                ))?,
                Ok(Read::Platform(platform)) => {
                    say(&format!("{}: ok, {}\n", file.display(), platform.title))?
                }
                Err(error) => say(&format!("{error}\n"))?,
            }
        }
    }
    match (wrong, files.len()) {
        (0, _) => Ok(()),
        (_, 1) => bail!("it cannot be built"),
        (wrong, all) => bail!("{wrong} of {all} cannot be built"),
    }
}

enum Read {
    Board(Box<Board>),
    Platform(Box<Platform>),
}

/// A configuration is good when its description fits the board, too.
fn read(file: &Path) -> Result<Read, Error> {
    if is_of_platforms(file) {
        let platform = Platform::read(&file.display().to_string(), &stem(file), &read_text(file)?)?;
        return Ok(Read::Platform(Box::new(platform)));
    }
    let board = described(file, &read_text(file)?)?;
    Ok(Read::Board(Box::new(board)))
}

/// The same of a board file that is not written yet; what `check --json` says of a file.
pub(crate) fn check_text(name: &str, toml: &str) -> Value {
    let file = super::unsaved(name);
    let read = described(&file, toml);
    verdict(&file, &read.map(|board| Read::Board(Box::new(board))))
}

/// The board of a board file with this text, whose description fits it.
pub(super) fn described(file: &Path, toml: &str) -> Result<Board, Error> {
    let board = read_board_text(file, toml)?;
    ferrocnc_config::blob::blob(&board)?;
    Ok(board)
}

pub(super) fn is_of_platforms(file: &Path) -> bool {
    let folder = file.parent().and_then(Path::file_name);
    folder.is_some_and(|folder| folder == "platforms")
}

fn verdict(file: &Path, result: &Result<Read, Error>) -> Value {
    match result {
        Ok(Read::Platform(platform)) => {
            json!({ "file": file, "ok": true, "platform": platform.name })
        }
        Ok(Read::Board(board)) => {
            json!({ "file": file, "ok": true, "name": board.name, "platform": board.platform.name, "missing_pins": board.missing_pins() })
        }
        Err(error) => json!({
            "file": error.file, "ok": false, "line": error.place.map(|place| place.line), "column": error.place.map(|place| place.column),
            "key": error.key, "value": error.value, "problem": error.problem, "remedy": error.remedy,
        }),
    }
}

pub(super) fn counts(board: &Board) -> String {
    let some = |class: ferrocnc_config::Class| match board.of(class).len() {
        0 => None,
        count => Some(format!("{count} {}", class.key())),
    };
    let counts: Vec<String> = ferrocnc_config::Class::ALL
        .into_iter()
        .filter_map(some)
        .collect();
    format!(
        "{} on {}: {}",
        board.name,
        board.platform.title,
        counts.join(", ")
    )
}

fn pinless(board: &Board) -> String {
    match board.missing_pins().as_slice() {
        [] => String::new(),
        [first, ..] => format!("\n  for simulation only: {first} and others have no pins"),
    }
}
