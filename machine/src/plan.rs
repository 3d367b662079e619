//! What is to be written, and how the files that are there change. It writes nothing.

use crate::board::propose;
use crate::channels;
use crate::check::check;
use crate::hal;
use crate::ini::edit::{Conflict, Edited, edit};
use crate::ini::{
    CUSTOM_HAL, CUSTOM_POST_GUI_HAL, Entry, MAIN_HAL, POST_GUI_HAL, TOOL_TABLE, wanted,
};
use crate::model::{BoardSource, CncMachine};
use crate::twin::{self, TWIN_HAL};
use crate::wiring::wiring;
use ferrocnc_config::board::Platforms;
use ferrocnc_config::pinout::{Pinout, svg};
use ferrocnc_config::{Board, Error, Place, Report};
use similar::TextDiff;
use std::fmt::Write as _;

/// The files that are there.
pub trait Files {
    /// The text of the file with this name, in the machine's folder; nothing if there is none.
    fn text(&self, name: &str) -> Result<Option<String>, Error>;
    /// A board file that the machine names, read.
    fn board(&self, name: &str) -> Result<Board, Error>;
}

/// A file that is to be written.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Change {
    /// Its name, in the machine's folder.
    pub name: String,
    /// What is there.
    pub before: Option<String>,
    /// What is to be there.
    pub after: String,
}

impl Change {
    /// The difference, as `diff -u` shows it. Of a drawing only that there is one.
    pub fn diff(&self) -> String {
        if self.name.ends_with(".svg") {
            return format!("+++ {}\n+(a drawing)\n", self.name);
        }
        let before = self.before.as_deref().unwrap_or_default();
        let diff = TextDiff::from_lines(before, &self.after);
        let old = match self.before {
            Some(_) => &self.name,
            None => "/dev/null",
        };
        diff.unified_diff()
            .context_radius(3)
            .header(old, &self.name)
            .to_string()
    }
}

/// What is to be written.
#[derive(Clone, Debug)]
pub struct Plan {
    /// Only files that change, in the order in which they are written.
    pub changes: Vec<Change>,
    /// The board, as its file will describe it.
    pub board: Board,
    /// What a person should know.
    pub notes: Vec<String>,
    /// Lines of the user's that have the last word.
    pub conflicts: Vec<Error>,
}

/// What the user wants besides the files.
#[derive(Clone, Copy, Debug, Default)]
pub struct Wishes {
    /// Lines that were written into generated files are lost.
    pub discard: bool,
    /// A second INI file, which starts the machine on the simulated board. One that is there is
    /// kept up without this wish.
    pub twin: bool,
}

/// Makes the plan, or says everything that is in the way.
pub fn plan(
    machine: &CncMachine,
    files: &dyn Files,
    platforms: &dyn Platforms,
    wishes: Wishes,
) -> Result<Plan, Vec<Error>> {
    let found = check(machine);
    if !found.bad.is_empty() {
        return Err(found.bad);
    }
    let mut plan = board(machine, files, platforms).map_err(|error| vec![error])?;
    let missing = channels::missing(machine, &plan.board);
    if !missing.is_empty() {
        return Err(missing);
    }
    write_files(machine, files, wishes, &mut plan).map_err(|error| vec![error])?;
    plan.changes
        .retain(|change| change.before.as_ref() != Some(&change.after));
    Ok(plan)
}

/// The board, and its file if it is ours to write.
fn board(
    machine: &CncMachine,
    files: &dyn Files,
    platforms: &dyn Platforms,
) -> Result<Plan, Error> {
    let mut changes = Vec::new();
    let (board, notes) = match &machine.board.source {
        BoardSource::File(file) => (files.board(file)?, Vec::new()),
        BoardSource::Platform(platform, modified) => {
            let name = format!("{}.toml", machine.name);
            if machine.file.rsplit('/').next() == Some(&name) {
                return Err(machine.error(
                    "name",
                    format!("{:?}", machine.name),
                    format!("would make {name} the board file, and that is this file"),
                    "give the machine, or this file, another name: machine.toml",
                ));
            }
            let there = files.text(&name)?;
            let there = there.as_deref();
            let made = propose(
                machine,
                platform,
                modified.as_deref(),
                &name,
                there,
                platforms,
            )?;
            changes.push(Change {
                name,
                before: there.map(str::to_owned),
                after: made.text,
            });
            (made.board, made.notes)
        }
    };
    Ok(Plan {
        changes,
        board,
        notes,
        conflicts: Vec::new(),
    })
}

fn write_files(
    machine: &CncMachine,
    files: &dyn Files,
    wishes: Wishes,
    plan: &mut Plan,
) -> Result<(), Error> {
    let discard = wishes.discard;
    let main = files.text(MAIN_HAL)?;
    let before = entries(MAIN_HAL, main.as_deref(), discard)?;
    let ini = format!("{}.ini", machine.name);
    let there = files.text(&ini)?;
    let text = there.as_deref().unwrap_or_default();
    let Edited {
        text,
        ours,
        conflicts,
    } = edit(text, &before, &wanted(machine));
    let conflicts = conflicts.iter().filter(|it| it.wanted.key != PICKERS);
    let told = conflicts.map(|it| conflict(&ini, it));
    plan.conflicts.extend(told);
    plan.changes.push(Change {
        name: MAIN_HAL.to_owned(),
        before: main,
        after: HAL.sealed(machine, &(hal::main(machine) + &record(&ini, &ours))),
    });
    if let Some(body) = hal::post_gui(machine) {
        let there = files.text(POST_GUI_HAL)?;
        entries(POST_GUI_HAL, there.as_deref(), discard)?;
        plan.changes.push(Change {
            name: POST_GUI_HAL.to_owned(),
            before: there,
            after: HAL.sealed(machine, &body),
        });
    }
    for (name, text) in [
        (
            CUSTOM_HAL,
            "# Your own HAL lines, after ferrocnc.hal. `ferrocnc machine write` never writes this file again.\n",
        ),
        (
            CUSTOM_POST_GUI_HAL,
            "# Your own HAL lines, when the user interface runs. `ferrocnc machine write` never writes this file\n# again.\n",
        ),
        (TOOL_TABLE, "T1 P1 D3.0 ;the first tool\n"),
    ] {
        if files.text(name)?.is_none() {
            plan.changes.push(Change {
                name: name.to_owned(),
                before: None,
                after: text.to_owned(),
            });
        }
    }
    draw(machine, files, discard, plan)?;
    let twin_ini = format!("{}-twin.ini", machine.name);
    let there_too = files.text(&twin_ini)?;
    if wishes.twin || there_too.is_some() {
        simulated(machine, files, discard, &text, plan)?;
    }
    // Last: without it nothing uses the others.
    plan.changes.push(Change {
        name: ini,
        before: there,
        after: text,
    });
    Ok(())
}

/// The variant on the simulated board, of the INI file as it will be; and what LinuxCNC's picker
/// shows beside both INI files.
fn simulated(
    machine: &CncMachine,
    files: &dyn Files,
    discard: bool,
    ini: &str,
    plan: &mut Plan,
) -> Result<(), Error> {
    let name = &machine.name;
    for (name, seal, body) in [
        (TWIN_HAL.to_owned(), &HAL, twin::hal(machine)),
        (format!("{name}-twin.ini"), &TWIN_INI, twin::ini(ini)),
    ] {
        let there = files.text(&name)?;
        if let Some(text) = &there {
            seal.opened(&name, text, discard)?;
        }
        plan.changes.push(Change {
            name,
            before: there,
            after: seal.sealed(machine, &body),
        });
    }
    for (name, text) in [
        (format!("{name}.txt"), twin::about(machine, &plan.board)),
        (format!("{name}-twin.txt"), twin::about_twin(machine)),
    ] {
        if files.text(&name)?.is_none() {
            plan.changes.push(Change {
                name,
                before: None,
                after: text,
            });
        }
    }
    Ok(())
}

/// The wiring table and the drawing of the headers.
fn draw(
    machine: &CncMachine,
    files: &dyn Files,
    discard: bool,
    plan: &mut Plan,
) -> Result<(), Error> {
    let name = format!("{}-wiring.md", machine.name);
    let there = files.text(&name)?;
    if let Some(text) = &there {
        PAGE.opened(&name, text, discard)?;
    }
    plan.changes.push(Change {
        name,
        before: there,
        after: PAGE.sealed(machine, &wiring(machine, &plan.board)),
    });
    let name = format!("{}.svg", machine.name);
    plan.changes.push(Change {
        before: files.text(&name)?,
        name,
        after: svg(&Pinout::of_board(&plan.board)),
    });
    Ok(())
}

/// How a generated file begins: two lines of comment, and what is said of its edits.
struct Seal {
    /// A comment begins so.
    open: &'static str,
    /// And ends so.
    close: &'static str,
    /// Said behind it.
    advice: &'static str,
    /// Where lines of the user's go.
    refuge: &'static str,
    /// A line that begins so may change.
    free: Option<&'static str>,
}

/// A HAL file's.
const HAL: Seal = Seal {
    open: "# ",
    close: "",
    advice: "# Do not edit it: it is written anew. Your own lines go into custom.hal.\n\n",
    refuge: CUSTOM_HAL,
    free: None,
};
/// That of the INI file of the simulated machine.
const TWIN_INI: Seal = Seal {
    open: "# ",
    close: "",
    advice: "# Do not edit it: it is the machine's INI file with another board, and written anew with it.\n\n",
    refuge: "the machine's INI file",
    free: Some(PICKERS),
};
/// A page's.
const PAGE: Seal = Seal {
    open: "<!-- ",
    close: " -->",
    advice: "\n",
    refuge: "a file of your own",
    free: None,
};
/// A key of the INI file that LinuxCNC's picker writes anew in the copy that it makes.
const PICKERS: &str = "PROGRAM_PREFIX";
/// The first line.
const GENERATED: &str = "Generated by `ferrocnc machine write` from ";
/// The second: the sum of what follows.
const SUM: &str = "sum ";
/// Before the lines that are ours in the INI file.
const RECORD: &str = "# By these lines `ferrocnc machine write` knows what it wrote into ";

impl Seal {
    fn sealed(&self, machine: &CncMachine, body: &str) -> String {
        let Seal { open, close, .. } = self;
        let file = machine.file.rsplit('/').next().unwrap_or_default();
        let rest = format!("{}{body}", self.advice);
        let sum = self.sum(&rest);
        format!("{open}{GENERATED}{file}.{close}\n{open}{SUM}{sum}{close}\n{rest}")
    }

    fn sum(&self, rest: &str) -> String {
        let is_free = |line: &&str| self.free.is_some_and(|free| line.starts_with(free));
        let lines = rest.split_inclusive('\n').filter(|line| !is_free(line));
        let summed: String = lines.collect();
        format!("{:08x}", wire::crc::crc32(summed.as_bytes()))
    }

    /// What follows the two lines. An error if it is not as it was generated.
    fn opened<'t>(&self, name: &str, text: &'t str, discard: bool) -> Result<&'t str, Error> {
        let error = |line: usize, problem: &str, remedy: String| {
            Error::from(Report {
                file: name.to_owned(),
                place: Some(Place { line, column: 1 }),
                key: String::new(),
                value: String::new(),
                problem: problem.to_owned(),
                remedy,
            })
        };
        let after_head = text
            .strip_prefix(self.open)
            .and_then(|rest| rest.strip_prefix(GENERATED))
            .and_then(|rest| rest.split_once('\n'))
            .and_then(|(_, rest)| rest.strip_prefix(self.open))
            .and_then(|rest| rest.strip_prefix(SUM))
            .and_then(|rest| rest.split_once('\n'));
        let Some((sum, rest)) = after_head else {
            return Err(error(
                1,
                "was not written by `ferrocnc machine write`",
                format!("move {name} away; its lines may go into {}", self.refuge),
            ));
        };
        let sum = sum.trim_end_matches(self.close);
        if !discard && sum != self.sum(rest) {
            return Err(error(
                2,
                "was edited since it was generated",
                format!(
                    "move your lines into {}, then say --discard-edits, which writes {name} anew",
                    self.refuge
                ),
            ));
        }
        Ok(rest)
    }
}

fn record(ini: &str, ours: &[Entry]) -> String {
    let mut text = format!("\n{RECORD}{ini}:\n");
    for entry in ours {
        let _ = writeln!(text, "# [{}]{}", entry.section, entry.line());
    }
    text
}

/// What a generated file says is ours in the INI file. An error if it is not as it was generated.
fn entries(name: &str, text: Option<&str>, discard: bool) -> Result<Vec<Entry>, Error> {
    let Some(text) = text else {
        return Ok(Vec::new());
    };
    let rest = HAL.opened(name, text, discard)?;
    let recorded = rest.split_once(RECORD).map_or("", |(_, lines)| lines);
    let entry = |line: &str| {
        let (section, rest) = line.strip_prefix("# [")?.split_once(']')?;
        let (key, value) = rest.split_once(" = ")?;
        Some(Entry {
            section: section.to_owned(),
            key: key.to_owned(),
            value: value.to_owned(),
        })
    };
    Ok(recorded.lines().skip(1).filter_map(entry).collect())
}

fn conflict(ini: &str, conflict: &Conflict) -> Error {
    let Entry {
        section,
        key,
        value,
    } = &conflict.wanted;
    Error::from(Report {
        file: ini.to_owned(),
        place: Some(Place {
            line: conflict.line,
            column: 1,
        }),
        key: format!("[{section}]{key}"),
        value: conflict.says.clone(),
        problem: format!("is yours and stays; the machine's file makes it {value}"),
        remedy: "take the line away to have that, or change the machine's file".to_owned(),
    })
}
