//! Text for the operator: values of a board, and the way out.

use anyhow::Result;
use ferrocnc_config::pinout::{self, Pinout};
use std::io::Write;

/// Prints; that what reads it has gone is an error.
pub(crate) fn say(text: &str) -> Result<()> {
    Ok(std::io::stdout().lock().write_all(text.as_bytes())?)
}

/// A drawing of headers, as wide as the terminal.
pub(crate) fn drawn(pinout: &Pinout, coloured: bool) -> String {
    let size = console::Term::stdout().size_checked();
    let width = size.map_or(100, |(_, columns)| usize::from(columns));
    pinout::terminal(pinout, width, coloured)
}

/// A version: `1.2.3`.
pub(crate) fn version(word: u32) -> String {
    format!("{}.{}.{}", word >> 16, word >> 8 & 0xff, word & 0xff)
}

/// What came of a command, for programs and for people.
pub(crate) struct Told {
    pub(crate) json: serde_json::Value,
    pub(crate) text: String,
}

/// Prints it the one way or the other.
pub(crate) fn tell(told: &Told, as_json: bool) -> Result<()> {
    match as_json {
        true => say(&format!("{:#}\n", told.json)),
        false => say(&format!("{}\n", told.text)),
    }
}
