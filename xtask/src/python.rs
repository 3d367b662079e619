//! The pinned Python environment below `target` and the gateware's commands in it.

use crate::{root, target};
use std::path::PathBuf;
use std::process::Command;

/// The environment's interpreter; [`crate::setup`] makes it.
pub fn interpreter() -> PathBuf {
    target("venv/bin/python")
}

/// A call of the gateware's Python side.
pub fn gateware(subcommand: &str) -> Command {
    let mut command = Command::new(interpreter());
    command
        .env("PYTHONPATH", root().join("gateware"))
        .args(["-m", "ferrocnc", subcommand]);
    command
}
