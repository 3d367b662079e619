//! `ferrocnc machine`: a machine for LinuxCNC. It needs no board.

mod new;
mod page;

pub(crate) use page::{Answer, Sample, judged, put, questions, samples};

use crate::consent;
use crate::text::{drawn, say};
use anyhow::{Context, Result, bail};
use clap::{Args, Subcommand};
use ferrocnc::replace::replace;
use ferrocnc_config::pinout::Pinout;
use ferrocnc_config::source::{Folder, read_text};
use ferrocnc_config::{Board, Error, read_board};
use ferrocnc_machine::plan::{Change, Files, Plan, Wishes, plan};
use ferrocnc_machine::plant::plant;
use ferrocnc_machine::{CncMachine, check, read};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};

#[derive(Subcommand)]
pub(crate) enum MachineCommand {
    /// Write a machine.toml to begin with: asks step by step, or takes a sample as it is.
    New(new::New),
    /// Read a machine.toml and say everything that is wrong with it.
    Check {
        /// The file.
        #[arg(value_name = "MACHINE.toml", default_value = "machine.toml")]
        file: PathBuf,
    },
    /// Write board file, HAL file and INI file beside it: shows what changes, and asks. Your own
    /// lines stay.
    Write(MachineWrite),
    /// What the simulated board needs to be this machine: switches that its axes run into, a
    /// spindle that turns. It is the file of `ferrocnc-sim --plant`.
    Plant {
        /// The file.
        #[arg(value_name = "MACHINE.toml", default_value = "machine.toml")]
        file: PathBuf,
        /// Write it here; printed if not given.
        #[arg(long, short, value_name = "PLANT.toml")]
        output: Option<PathBuf>,
    },
}

#[derive(Args)]
pub(crate) struct MachineWrite {
    /// The file.
    #[arg(value_name = "MACHINE.toml", default_value = "machine.toml")]
    file: PathBuf,
    /// Do not ask.
    #[arg(long, short)]
    yes: bool,
    /// Show what would change, and end.
    #[arg(long, conflicts_with = "yes")]
    dry_run: bool,
    /// Also write NAME-twin.ini, which starts the machine on the simulated board, without a card.
    #[arg(long)]
    twin: bool,
    /// Lose what was written into the generated HAL files by hand.
    #[arg(long)]
    discard_edits: bool,
}

pub(crate) fn run(command: &MachineCommand, as_json: bool) -> Result<()> {
    match command {
        MachineCommand::New(new) => new::run(new),
        MachineCommand::Check { file } => self::check_file(file, as_json),
        MachineCommand::Write(arguments) => write(arguments, as_json),
        MachineCommand::Plant { file, output } => write_plant(file, output.as_deref()),
    }
}

/// The folder of a machine's file.
struct Beside(PathBuf);

impl Beside {
    fn new(file: &Path) -> Self {
        Beside(file.parent().unwrap_or(Path::new("")).to_owned())
    }
}

/// Where the package has board files.
const INSTALLED: &str = "/usr/share/ferrocnc/boards";

impl Files for Beside {
    fn text(&self, name: &str) -> Result<Option<String>, Error> {
        let path = self.0.join(name);
        match path.try_exists() {
            Ok(false) => Ok(None),
            _ => read_text(&path).map(Some),
        }
    }

    fn board(&self, name: &str) -> Result<Board, Error> {
        let own = self.0.join(name);
        let installed = Path::new(INSTALLED).join(name);
        match !own.exists() && installed.exists() {
            true => read_board(&installed),
            false => read_board(&own),
        }
    }
}

/// What a plan, or a check, has found.
struct Told {
    machine: Option<CncMachine>,
    plan: Option<Plan>,
    bad: Vec<Error>,
    notes: Vec<Error>,
}

/// Reads a machine and makes the plan of its files.
fn look(file: &Path, wishes: Wishes) -> Result<Told> {
    let text = read_text(file).map_err(|mut error| {
        error.remedy = "`ferrocnc machine new` writes one".to_owned();
        error
    })?;
    Ok(look_at(file, &text, &Beside::new(file), wishes))
}

/// The same of a text, with these files beside it.
fn look_at(file: &Path, text: &str, files: &dyn Files, wishes: Wishes) -> Told {
    let machine: CncMachine = match read(&file.display().to_string(), text) {
        Ok(machine) => machine,
        Err(error) => {
            return Told {
                machine: None,
                plan: None,
                bad: vec![error],
                notes: Vec::new(),
            };
        }
    };
    let notes = check(&machine).notes;
    let made = plan(&machine, files, &Folder::beside(file), wishes);
    let (plan, bad) = match made {
        Ok(plan) => (Some(plan), Vec::new()),
        Err(bad) => (None, bad),
    };
    Told {
        machine: Some(machine),
        plan,
        bad,
        notes,
    }
}

fn to_json(kind: &str, error: &Error) -> Value {
    json!({
        "verdict": kind, "file": error.file, "line": error.place.map(|place| place.line),
        "column": error.place.map(|place| place.column), "key": error.key,
        "value": error.value, "problem": error.problem, "remedy": error.remedy,
    })
}

impl Told {
    /// Every finding, and notes of the plan.
    fn to_json(&self) -> Value {
        let conflicts = self.plan.iter().flat_map(|plan| &plan.conflicts);
        let bad = self.bad.iter().map(|one| to_json("bad", one));
        let notes = self.notes.iter().chain(conflicts);
        let findings: Vec<Value> = bad.chain(notes.map(|one| to_json("note", one))).collect();
        let notes: Vec<&String> = self.plan.iter().flat_map(|plan| &plan.notes).collect();
        json!({ "ok": self.bad.is_empty(), "findings": findings, "notes": notes })
    }

    fn say(&self) -> Result<()> {
        for error in &self.bad {
            say(&format!("{error}\n"))?;
        }
        for error in &self.notes {
            say(&format!("note: {error}\n"))?;
        }
        if let Some(plan) = &self.plan {
            for error in &plan.conflicts {
                say(&format!("note: {error}\n"))?;
            }
            for note in &plan.notes {
                say(&format!("note: {note}\n"))?;
            }
        }
        Ok(())
    }

    /// The plan, or an error that counts what is in the way.
    fn into_plan(self) -> Result<Plan> {
        match (self.plan, self.bad.len()) {
            (Some(plan), _) => Ok(plan),
            (None, 1) => bail!("the machine cannot be made so"),
            (None, many) => bail!("{many} findings are in the way; each says what to do"),
        }
    }
}

fn check_file(file: &Path, as_json: bool) -> Result<()> {
    let told = look(file, Wishes::default())?;
    if as_json {
        say(&format!("{:#}\n", told.to_json()))?;
    } else {
        told.say()?;
    }
    let plan = told.into_plan()?;
    if !as_json {
        let board = &plan.board;
        say(&format!(
            "{}: ok, on {} ({})\n",
            file.display(),
            board.name,
            board.platform.title
        ))?;
    }
    Ok(())
}

fn write_plant(file: &Path, output: Option<&Path>) -> Result<()> {
    // It writes none of the generated files, so it does not matter that one was edited.
    let wishes = Wishes {
        discard: true,
        ..Wishes::default()
    };
    let mut told = look(file, wishes)?;
    for error in &told.bad {
        eprintln!("{error}");
    }
    let machine = told.machine.take();
    let plan = told.into_plan()?;
    let machine = machine.context("the machine cannot be read")?;
    let text = plant(&machine, &plan.board);
    match output {
        Some(path) => {
            std::fs::write(path, text).with_context(|| format!("cannot write {}", path.display()))
        }
        None => say(&text),
    }
}

fn write(arguments: &MachineWrite, as_json: bool) -> Result<()> {
    if as_json && !(arguments.yes || arguments.dry_run) {
        bail!("--json does not ask; say --yes or --dry-run, too");
    }
    let wishes = Wishes {
        discard: arguments.discard_edits,
        twin: arguments.twin,
    };
    let told = look(&arguments.file, wishes)?;
    let mut json = told.to_json();
    if !as_json {
        told.say()?;
    }
    let plan = match told.into_plan() {
        Ok(plan) => plan,
        Err(error) => {
            if as_json {
                say(&format!("{json:#}\n"))?;
            }
            return Err(error);
        }
    };
    let folder = Beside::new(&arguments.file);
    let wanted = if as_json {
        let files = plan.changes.iter().map(|change| {
            json!({ "file": change.name, "new": change.before.is_none(), "diff": change.diff() })
        });
        json["files"] = files.collect();
        json["written"] = json!(arguments.yes);
        arguments.yes
    } else if arguments.yes {
        // It is written even if what reads our output has gone.
        let _ = show(&plan);
        true
    } else {
        show(&plan)? && !arguments.dry_run && consent::is_yes("Write this?")?
    };
    if wanted {
        for change in &plan.changes {
            save(&folder, change)?;
        }
        for change in plan.changes.iter().filter(|_| !as_json) {
            say(&format!("{}: written\n", change.name))?;
        }
    }
    if as_json {
        say(&format!("{json:#}\n"))?;
    }
    Ok(())
}

/// Shows the board as it will be, and what changes; false if nothing does.
fn show(plan: &Plan) -> Result<bool> {
    if plan.changes.is_empty() {
        say("nothing changes\n")?;
        return Ok(false);
    }
    let board_file = format!("{}.toml", plan.board.name);
    if plan.changes.iter().any(|change| change.name == board_file) {
        say(&drawn(&Pinout::of_board(&plan.board), false))?;
    }
    for change in &plan.changes {
        say(&change.diff())?;
    }
    Ok(true)
}

fn save(folder: &Beside, change: &Change) -> Result<()> {
    let path = folder.0.join(&change.name);
    replace(&path, change.after.as_bytes(), 0o644)
        .with_context(|| format!("cannot write {}", path.display()))
}

#[cfg(test)]
mod tests {
    use super::Beside;
    use crate::hal_file::own_names;
    use ferrocnc_config::source::Folder;
    use ferrocnc_machine::plan::{Wishes, plan};
    use ferrocnc_machine::template::TEMPLATES;
    use ferrocnc_machine::{CncMachine, read};

    /// Every sample, and each of them with more of what a machine may have.
    fn machines() -> Vec<CncMachine> {
        let more = |text: &str| {
            let home = text.replacen("method = \"switch\"", "method = \"switch_index\"", 1);
            home.replacen("microsteps", "fault = { input = \"alarm\" }\nmicrosteps", 1)
        };
        let texts = TEMPLATES.map(|(_, _, text)| [text.to_owned(), more(text)]);
        let read = |text: String| read("machine.toml", &text).expect("a machine");
        texts.into_iter().flatten().map(read).collect()
    }

    #[test]
    fn every_name_of_the_board_in_a_generated_file_exists() {
        for machine in machines() {
            let nowhere = Beside("/nonexistent".into());
            let made = plan(&machine, &nowhere, &Folder(None), Wishes::default()).expect("a plan");
            let known = own_names(&made.board).expect("a board");
            let hal = made.changes.iter().find(|it| it.name == "ferrocnc.hal");
            let hal = &hal.expect("the file").after;
            let lines = hal.lines().filter(|line| !line.starts_with('#'));
            let words = lines.flat_map(str::split_whitespace);
            let words: Vec<&str> = words
                .filter(|word| word.starts_with("ferrocnc.0."))
                .collect();
            assert!(words.len() > 30, "{hal}");
            for word in words {
                let is_function = matches!(word, "ferrocnc.0.read" | "ferrocnc.0.write");
                assert!(
                    is_function || known.contains(word),
                    "{}: {word}",
                    machine.name
                );
            }
        }
    }
}
