//! Asks before something is changed that outlasts the command.

use anyhow::{Result, bail};
use std::io::{BufRead, Write};
use std::os::unix::fs::MetadataExt;
use std::path::Path;

/// A file that is there is overwritten only by --force.
pub(crate) fn may_write(file: &Path, force: bool) -> Result<()> {
    if file.exists() && !force {
        bail!("{} is there already; --force overwrites it", file.display());
    }
    Ok(())
}

/// The command is for root.
pub(crate) fn needs_root(what: &str, command: &str) -> Result<()> {
    // Its owner is the user whose rights this program has.
    let user = std::fs::metadata("/proc/self").map(|it| it.uid());
    if user.is_ok_and(|user| user != 0) {
        bail!("this changes {what} and needs root: sudo ferrocnc {command}");
    }
    Ok(())
}

/// The answer to a question is yes.
pub(crate) fn is_yes(question: &str) -> Result<bool> {
    eprint!("{question} Type yes: ");
    std::io::stderr().flush()?;
    let mut answer = String::new();
    std::io::stdin().lock().read_line(&mut answer)?;
    Ok(answer.trim() == "yes")
}
