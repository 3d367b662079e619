//! Writes files and runs programs, as a plan or a record says.

use super::paths::Paths;
use super::plan::{Act, Plan};
use super::record::{Record, Undo, shown};
use crate::replace::replace;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// Runs a program; an error is what it said.
pub type Run<'r> = dyn Fn(&[String]) -> Result<(), String> + 'r;

/// What did not work, and what undid the steps before it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Failed {
    /// The step that failed, and why.
    pub why: String,
    /// Steps back that failed, too.
    pub left: Vec<String>,
}

impl core::fmt::Display for Failed {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(f, "{}; ", self.why)?;
        match self.left.is_empty() {
            true => f.write_str("all steps before it are undone"),
            false => write!(
                f,
                "the steps before it are undone, but for: {}",
                self.left.join("; ")
            ),
        }
    }
}

impl std::error::Error for Failed {}

/// A computer that is changed.
pub struct Hand<'h> {
    /// `/`, or a made-up one.
    pub root: PathBuf,
    /// Runs its programs.
    pub run: &'h Run<'h>,
}

impl Hand<'static> {
    /// This computer.
    pub fn real() -> Self {
        Hand {
            root: PathBuf::from("/"),
            run: &run,
        }
    }
}

/// Runs a program with its words as they are; no shell is between.
fn run(words: &[String]) -> Result<(), String> {
    let Some((program, arguments)) = words.split_first() else {
        return Ok(());
    };
    let mut command = Command::new(program);
    command.args(arguments).stdin(Stdio::null());
    let done = command.output().map_err(|error| error.to_string())?;
    if done.status.success() {
        return Ok(());
    }
    let said = [done.stdout, done.stderr].concat();
    let said = String::from_utf8_lossy(&said);
    let said = said.split_whitespace().collect::<Vec<_>>().join(" ");
    Err(format!("{} {said}", done.status).trim().to_owned())
}

impl Hand<'_> {
    /// Carries a plan out. If a step fails, those before it are undone.
    pub fn carry_out(&self, plan: &Plan) -> Result<(), Failed> {
        if plan.steps.is_empty() {
            return Ok(());
        }
        let record = Paths::of(&plan.interface).record;
        // A computer that is switched off in the middle can be put in order, too.
        if let Err(error) = self.write(&record, &plan.record.to_text(), 0o600) {
            self.forget(&record);
            let why = format!("cannot write /{record}: {error}");
            return Err(Failed {
                why,
                left: Vec::new(),
            });
        }
        for (n, step) in plan.steps.iter().enumerate() {
            let Some(act) = &step.act else { continue };
            let Err(why) = self.act(act) else { continue };
            let done = match plan.again {
                true => plan.record.clone(),
                // That of the failed step, too: it may have done half of its work.
                false => {
                    let done = plan.steps[..=n].iter().rev();
                    Record(done.filter_map(|step| step.undo.clone()).collect())
                }
            };
            let left = self.undo(&plan.interface, &done);
            return Err(Failed { why, left });
        }
        Ok(())
    }

    fn act(&self, act: &Act) -> Result<(), String> {
        match act {
            Act::Write(file) => { self.write(&file.path, &file.text, file.mode) }
                .map_err(|error| format!("cannot write /{}: {error}", file.path)),
            Act::Run(words) => {
                (self.run)(words).map_err(|said| format!("`{}` failed: {said}", shown(words)))
            }
        }
    }

    /// Takes every step back, whatever becomes of those before it; what failed.
    pub fn undo(&self, interface: &str, record: &Record) -> Vec<String> {
        let mut failed = Vec::new();
        for step in &record.0 {
            match step {
                Undo::Remove(path) => {
                    if let Err(error) = self.remove(path) {
                        failed.push(format!("cannot remove /{path}: {error}"));
                    }
                }
                Undo::Run(words) => {
                    if let Err(said) = (self.run)(words) {
                        failed.push(format!("`{}`: {said}", shown(words)));
                    }
                }
            }
        }
        self.forget(&Paths::of(interface).record);
        failed
    }

    fn forget(&self, record: &str) {
        let _ = self.remove(record);
    }

    /// The file, and a folder of ours for it.
    fn write(&self, path: &str, text: &str, mode: u32) -> io::Result<()> {
        let path = self.root.join(path);
        if let Some(folder) = path.parent()
            && is_ours(folder)
            && !folder.exists()
        {
            fs::create_dir(folder)?;
        }
        replace(&path, text.as_bytes(), mode)
    }

    /// The file, if it is there, and a folder of ours that is empty then.
    fn remove(&self, path: &str) -> io::Result<()> {
        let path = self.root.join(path);
        match fs::remove_file(&path) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error),
            Ok(()) | Err(_) => {}
        }
        if let Some(folder) = path.parent().filter(|folder| is_ours(folder)) {
            // Not if it has other files.
            let _ = fs::remove_dir(folder);
        }
        Ok(())
    }
}

fn is_ours(folder: &Path) -> bool {
    folder.file_name().is_some_and(|name| name == "ferrocnc")
}
