//! The same for a page: a drawing or a program becomes a job, is drawn, sent and executed. Nothing
//! is read or written on this computer.

use super::board::{entry_json, report_json};
use super::{facts_of, merge, penned, traced};
use anyhow::{Result, anyhow, bail};
use ferrocnc::job::client::{self, Board};
use ferrocnc::job::machine::MachineFile;
use ferrocnc::job::preview;
use ferrocnc::job::program::{Dialect, Program, ending};
use ferrocnc::job::svg::{self, Tool, Wish};
use ferrocnc::job::trace;
use serde::Deserialize;
use serde_json::{Value, json};
use std::path::Path;
use std::time::Duration;
use wire::jobs::{JobCommand, PORT};

/// The board stops a job on its path if the page has asked nothing for so long.
const KEEPALIVE: Duration = Duration::from_secs(3);

/// A drawing or a program, and how it is to be drawn: the options of `ferrocnc job prepare`.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Sheet {
    /// The file's name; its ending says what it is.
    file: String,
    text: String,
    /// The text of the machine's file.
    machine: Option<String>,
    /// Width and height in mm that a drawing is scaled to.
    page: Option<[f64; 2]>,
    margin: f64,
    tolerance: f64,
    feed: f64,
}

/// A job that was made.
struct Made {
    program: Program,
    machine: Option<MachineFile>,
    notes: Vec<String>,
}

impl Sheet {
    fn made(&self) -> Result<Made> {
        let file = Path::new(&self.file);
        let stem = file.file_stem().unwrap_or_default().to_string_lossy();
        let machine = self.machine.as_deref().map(MachineFile::parse).transpose();
        let machine = machine.map_err(|error| anyhow!("the machine's file: {error}"))?;
        let named = |error: String| anyhow!("{}: {error}", self.file);
        if let Some([width, height]) = self.page
            && !(width > 0.0 && height > 0.0 && width.is_finite() && height.is_finite())
        {
            bail!("a page has a width and a height in mm, as 210 and 297");
        }
        let (mut program, notes) = match ending(file).as_str() {
            "svg" => {
                for (what, value) in [("tolerance", self.tolerance), ("feed", self.feed)] {
                    if !(value > 0.0 && value.is_finite()) {
                        bail!("{what}: {value}; it is more than 0");
                    }
                }
                let wish = Wish {
                    page: self.page,
                    margin: self.margin,
                    tolerance: self.tolerance,
                    feed: self.feed,
                    tool: Tool::Output,
                    hatch: None,
                    order: true,
                    fonts: Vec::new(),
                };
                let made = svg::prepare(&stem, self.text.as_bytes(), &wish, &|_, _| ());
                let made = made.map_err(named)?;
                (made.program, made.notes)
            }
            "job" | "bin" => bail!(
                "{}: this page takes drawings (.svg) and G-code; ferrocnc job send takes a job",
                self.file
            ),
            _ => {
                let dwell = Dialect::default().dwell;
                let read = Program::from_gcode(self.text.as_bytes(), dwell).map_err(named)?;
                let (program, said) = penned(read, None, false)?;
                (program, said.into_iter().collect())
            }
        };
        if program.name.is_empty() {
            program.name = stem.into_owned();
        }
        Ok(Made {
            program,
            machine,
            notes,
        })
    }

    /// As `job preview` draws it, with what `job check` says.
    pub(crate) fn drawn(&self) -> Result<Value> {
        let Made {
            program,
            machine,
            notes,
        } = self.made()?;
        let wrong = machine.as_ref().map_or(Vec::new(), |machine| {
            trace::out_of_bounds(&program, machine)
        });
        let trace = traced(&program, machine.as_ref())?;
        let svg = preview::svg(&program.name, &trace);
        // Of these the page knows where on the drawing the axes are.
        let scale = machine.map(|it| [&it.x, &it.y, &it.z].map(|axis| axis.steps_per_mm));
        let frame = preview::frame(&trace);
        let mut drawn =
            json!({ "svg": svg, "notes": notes, "frame": frame, "steps_per_mm": scale });
        merge(&mut drawn, facts_of(&program, &trace, &wrong));
        Ok(drawn)
    }
}

/// The board of a page; the port of another page is not that of the jobs.
pub(crate) fn open(board: &str) -> Result<Board> {
    let other = format!(":{}", wire::DEFAULT_PORT);
    let board = board.strip_suffix(&other).unwrap_or(board);
    Ok(Board::open(&crate::parse(board, PORT)?, crate::keys())?)
}

/// What a board is to be sent.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Parcel {
    board: String,
    sheet: Sheet,
}

impl Parcel {
    /// `ferrocnc job send`.
    pub(crate) fn send(&self) -> Result<Value> {
        let made = self.sheet.made()?;
        client::name(&made.program.name)?;
        let mut board = open(&self.board)?;
        if let Some(machine) = &made.machine {
            super::board::put(&mut board, machine)?;
        }
        let entry = board.send(&made.program.name, &made.program.to_job(), |_, _| ())?;
        Ok(entry_json(&entry))
    }
}

/// What a board is told.
#[derive(Clone, Copy, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Order {
    Start,
    Pause,
    Continue,
    Stop,
    Home,
}

/// An order, and which job it is for.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Told {
    board: String,
    order: Order,
    name: Option<String>,
}

impl Told {
    /// `ferrocnc job start`, `pause` and so on. A job is attended: the page's stream is the watch.
    pub(crate) fn take(&self) -> Result<Value> {
        let mut board = open(&self.board)?;
        let report = match self.order {
            Order::Start => {
                let name = self.name.as_deref().unwrap_or_default();
                board
                    .start(name, Some(KEEPALIVE))
                    .map_err(super::board::hinted)?
            }
            Order::Pause => board.command(JobCommand::Pause)?,
            Order::Continue => board.command(JobCommand::Continue)?,
            Order::Stop => board.command(JobCommand::Stop)?,
            Order::Home => board.home(Default::default(), Some(KEEPALIVE))?,
        };
        Ok(report_json(&report))
    }
}

/// One look at a board.
pub(crate) fn look(board: &mut Board) -> Result<Value> {
    let report = board.report()?;
    board.hang_up();
    Ok(report_json(&report))
}
