//! Runs the tool `ferrocnc` as a process.
//!
//! It is not in `common`, because only a test's build knows the path of the program, and an example
//! uses the fake board, too.

use std::process::{Command, Output};

/// Runs it.
pub fn tool(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_ferrocnc"))
        .args(arguments)
        .output()
        .unwrap()
}

/// What it says when all is well.
#[track_caller]
pub fn answer(arguments: &[&str]) -> String {
    let output = tool(arguments);
    let error = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{arguments:?}: {error}");
    String::from_utf8(output.stdout).unwrap()
}

/// What it says when it is not.
#[track_caller]
pub fn complaint(arguments: &[&str]) -> String {
    let output = tool(arguments);
    assert!(!output.status.success(), "{arguments:?} succeeded");
    String::from_utf8(output.stderr).unwrap()
}
