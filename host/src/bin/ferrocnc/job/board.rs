//! `ferrocnc job send|start|pause|...`: jobs on a board.
//!
//! A board has one connection for jobs. A command that watches a job closes it between two
//! requests, so that another terminal can stop the job.

use crate::progress::Bar;
use anyhow::{Context, Result, anyhow, bail};
use clap::{Args, Subcommand};
use ferrocnc::job::client::{self, Board, JobError};
use ferrocnc::job::machine::MachineFile;
use ferrocnc::job::preview::duration;
use ferrocnc::job::program::{Program, ending};
use ferrocnc::job::stream::Streamer;
use serde_json::{Value, json};
use std::io::Write;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::Duration;
use wire::jobs::{End, Entry, JobCommand, KEEPALIVE_MS, Report, State, Status};

/// Time between two requests about a running job; a keepalive is longer.
const LOOK: Duration = Duration::from_millis(250);

/// The board with the jobs.
#[derive(Args)]
pub(crate) struct Where {
    /// IP[:port] of the board.
    #[arg(value_name = "ADDR")]
    address: String,
}

impl Where {
    fn open(&self) -> Result<Board> {
        let address = crate::parse(&self.address, wire::jobs::PORT)?;
        Ok(Board::open(&address, crate::keys())?)
    }

    /// Stop and Pause, also while another client has the line.
    fn halt(&self, code: JobCommand) -> Result<Report> {
        let address = crate::parse(&self.address, wire::jobs::PORT)?;
        Ok(client::halt(address.socket, code)?)
    }
}

#[derive(Subcommand)]
pub(crate) enum BoardJobCommand {
    /// Send a job to a board's store; an interrupted upload continues where it stopped.
    Send {
        #[command(flatten)]
        board: Where,
        /// The job (.job).
        #[arg(value_name = "FILE.job")]
        file: PathBuf,
        /// What it is called there; the file's name if not given.
        #[arg(long)]
        name: Option<String>,
        /// Tell the board which machine it moves, too.
        #[arg(long, short, value_name = "MACHINE.toml")]
        machine: Option<PathBuf>,
    },
    /// Execute a job that is in the store, and watch it: it stops if this program no longer watches
    /// it.
    Start {
        #[command(flatten)]
        board: Where,
        /// Which.
        #[arg(value_name = "NAME")]
        name: String,
        /// Tell the board which machine it moves first.
        #[arg(long, short, value_name = "MACHINE.toml")]
        machine: Option<PathBuf>,
        /// The job goes on to its end without a watching program, even with the cable pulled; this
        /// program ends at once.
        #[arg(long)]
        unattended: bool,
        /// The job stops if this program does not watch it for so long.
        #[arg(long, value_name = "MS", default_value_t = 3000, value_parser = clap::value_parser!(u16).range(i64::from(*KEEPALIVE_MS.start())..=i64::from(*KEEPALIVE_MS.end())))]
        keepalive: u16,
    },
    /// Stand still on the path.
    Pause(Where),
    /// Go on after a pause.
    Continue(Where),
    /// End the job; the axes brake along the path.
    Stop(Where),
    /// Find the switches.
    Home {
        #[command(flatten)]
        board: Where,
        /// Of these axes (xy, z, ...); of all that have one if not given.
        #[arg(value_name = "AXES", value_parser = axes)]
        axes: Option<[bool; 3]>,
        /// Tell the board which machine it moves first.
        #[arg(long, short, value_name = "MACHINE.toml")]
        machine: Option<PathBuf>,
    },
    /// The axes stand where their 0 is: plotters without switches, after an e-stop or a move by
    /// hand.
    Here {
        #[command(flatten)]
        board: Where,
        /// These axes (xy, z, ...); all without a switch if not given.
        #[arg(value_name = "AXES", value_parser = axes)]
        axes: Option<[bool; 3]>,
        /// Tell the board which machine it moves first.
        #[arg(long, short, value_name = "MACHINE.toml")]
        machine: Option<PathBuf>,
    },
    /// Show the status.
    Status(Where),
    /// Show the status until the job is over.
    Watch(Where),
    /// What is in the store.
    List(Where),
    /// Take a job out of the store.
    Delete {
        #[command(flatten)]
        board: Where,
        /// Which.
        #[arg(value_name = "NAME")]
        name: String,
    },
    /// Execute the jobs of a board without SDRAM on this computer; `ferrocnc job send|start|...`
    /// then use this program's address.
    Serve {
        /// IP[:port] of the board.
        #[arg(value_name = "ADDR")]
        address: String,
        /// The address for clients. Any computer that reaches it may move the machine, unless the
        /// board has a key.
        #[arg(long, value_name = "IP:PORT", default_value = "127.0.0.1:7240")]
        at: SocketAddr,
    },
    /// How fast a job is executed, in percent of what it says.
    Feed {
        #[command(flatten)]
        board: Where,
        /// 1 to 200.
        #[arg(value_name = "PERCENT", value_parser = clap::value_parser!(u16).range(1..=200))]
        percent: u16,
    },
}

fn axes(text: &str) -> Result<[bool; 3], String> {
    let mut axes = [false; 3];
    for letter in text.to_lowercase().chars() {
        match "xyz".find(letter) {
            Some(axis) => axes[axis] = true,
            None => return Err(format!("{letter} is not one of x, y, z")),
        }
    }
    Ok(axes)
}

pub(crate) fn run(command: &BoardJobCommand, as_json: bool) -> Result<()> {
    match command {
        BoardJobCommand::Send {
            board,
            file,
            name,
            machine,
        } => send(board, file, name.as_deref(), machine.as_deref(), as_json),
        BoardJobCommand::Start {
            board,
            name,
            machine,
            unattended,
            keepalive,
        } => {
            let mut board = board.open()?;
            tell(&mut board, machine.as_deref())?;
            let keepalive = (!unattended).then(|| Duration::from_millis((*keepalive).into()));
            let report = board.start(name, keepalive).map_err(hinted)?;
            match unattended {
                true => show(&report, as_json),
                false => watch(&mut board, keepalive, as_json),
            }
        }
        BoardJobCommand::Pause(board) => show(&board.halt(JobCommand::Pause)?, as_json),
        BoardJobCommand::Continue(board) => say(board, JobCommand::Continue, as_json),
        BoardJobCommand::Stop(board) => show(&board.halt(JobCommand::Stop)?, as_json),
        BoardJobCommand::Home {
            board,
            axes,
            machine,
        } => {
            let mut board = board.open()?;
            tell(&mut board, machine.as_deref())?;
            let keepalive = Some(Duration::from_secs(3));
            board.home(axes.unwrap_or_default(), keepalive)?;
            watch(&mut board, keepalive, as_json)
        }
        BoardJobCommand::Here {
            board,
            axes,
            machine,
        } => {
            let mut board = board.open()?;
            tell(&mut board, machine.as_deref())?;
            show(&board.here(axes.unwrap_or_default())?, as_json)
        }
        BoardJobCommand::Status(board) => show(&board.open()?.report()?, as_json),
        BoardJobCommand::Watch(board) => watch(&mut board.open()?, None, as_json),
        BoardJobCommand::List(board) => list(&mut board.open()?, as_json),
        BoardJobCommand::Delete { board, name } => {
            let free = board.open()?.delete(name)?;
            match as_json {
                true => {
                    crate::text::say(&format!("{}\n", json!({ "deleted": name, "free": free })))
                }
                false => crate::text::say(&format!("{name} is deleted, {free} bytes are free\n")),
            }
        }
        BoardJobCommand::Serve { address, at } => serve(address, *at, as_json),
        BoardJobCommand::Feed { board, percent } => show(&board.open()?.feed(*percent)?, as_json),
    }
}

/// Runs until Ctrl-C, which stops the axes first.
fn serve(address: &str, at: SocketAddr, as_json: bool) -> Result<()> {
    let address = crate::parse(address, wire::DEFAULT_PORT)?;
    let mut streamer = Streamer::open(&address, crate::keys(), at)?;
    let stop = Arc::new(AtomicBool::new(false));
    for signal in [signal_hook::consts::SIGINT, signal_hook::consts::SIGTERM] {
        // The second one ends the program at once; then the board's watchdog stops the axes.
        signal_hook::flag::register_conditional_default(signal, stop.clone())
            .and_then(|_| signal_hook::flag::register(signal, stop.clone()))
            .context("cannot take signals")?;
    }
    let at = streamer.at();
    match as_json {
        true => crate::text::say(&format!(
            "{}\n",
            json!({ "board": address.text, "jobs": at.to_string() })
        ))?,
        false => crate::text::say(&format!(
            "the jobs of {address} are at {at}: ferrocnc job send {at} FILE.job; Ctrl-C ends it, and stops what moves\n"
        ))?,
    }
    std::io::stdout().flush()?;
    streamer.run(&stop);
    Ok(())
}

/// Adds the remedy of docs/jobs.md to a refusal.
pub(super) fn hinted(error: JobError) -> anyhow::Error {
    let hint = match &error {
        JobError::Refused(_, Status::NoMachine, _) => Some("--machine MACHINE.toml sends one"),
        JobError::Refused(_, Status::NoSuchJob, _) => Some("ferrocnc job list shows those it has"),
        _ => None,
    };
    match hint {
        Some(hint) => anyhow!("{error} ({hint})"),
        None => anyhow!(error),
    }
}

pub(crate) fn tell(board: &mut Board, machine: Option<&Path>) -> Result<()> {
    let Some(file) = machine else {
        return Ok(());
    };
    let machine = MachineFile::read(file).map_err(|error| anyhow!(error))?;
    put(board, &machine).with_context(|| file.display().to_string())
}

/// Tells the board which machine it moves.
pub(super) fn put(board: &mut Board, machine: &MachineFile) -> Result<()> {
    let theirs = board.welcome().clock_hz;
    if machine.clock != theirs {
        bail!("clock = {}, but the board's is {theirs}", machine.clock);
    }
    Ok(board.put_machine(&machine.to_board())?)
}

fn say(board: &Where, code: JobCommand, as_json: bool) -> Result<()> {
    show(&board.open()?.command(code)?, as_json)
}

fn send(
    board: &Where,
    file: &Path,
    name: Option<&str>,
    machine: Option<&Path>,
    as_json: bool,
) -> Result<()> {
    if ending(file) != "job" {
        bail!(
            "{}: not a job; `ferrocnc job prepare` makes one of it",
            file.display()
        );
    }
    let bytes = std::fs::read(file).with_context(|| file.display().to_string())?;
    // A job that cannot be read is found here, not at the end of the upload.
    Program::from_job(&bytes).map_err(|error| anyhow!("{}: {error}", file.display()))?;
    let stem = file.file_stem().unwrap_or_default().to_string_lossy();
    let name = name.unwrap_or(&stem);
    client::name(name)?;
    let mut board = board.open()?;
    tell(&mut board, machine)?;
    let mut bar = Bar::new(as_json);
    let mut resumed = None;
    let entry = board.send(name, &bytes, |there, all| {
        resumed.get_or_insert(there);
        bar.show("send", there as f64 / all as f64);
    })?;
    drop(bar);
    let resumed = resumed.unwrap_or(0);
    if as_json {
        let mut sent = entry_json(&entry);
        sent["resumed_from"] = json!(resumed);
        return crate::text::say(&format!("{sent:#}\n"));
    }
    let from = match resumed {
        0 => String::new(),
        there => format!(", {there} of them were there already"),
    };
    crate::text::say(&format!(
        "{name} is on the board: {} bytes{from}, {} instructions, CRC {:08x}\n",
        entry.total, entry.instructions, entry.crc
    ))
}

fn list(board: &mut Board, as_json: bool) -> Result<()> {
    let entries = board.list()?;
    let welcome = *board.welcome();
    if as_json {
        let jobs: Vec<Value> = entries.iter().map(entry_json).collect();
        let all = json!({ "jobs": jobs, "room": welcome.room, "free": welcome.free });
        return crate::text::say(&format!("{all:#}\n"));
    }
    for entry in &entries {
        let state = match entry.ready {
            true => format!("{} instructions", entry.instructions),
            false => format!("{} bytes of it are there: send it again", entry.have),
        };
        crate::text::say(&format!(
            "{:<32} {:>9} bytes  {state}\n",
            entry.name.text(),
            entry.total
        ))?;
    }
    crate::text::say(&format!(
        "{} of {} bytes are free\n",
        welcome.free, welcome.room
    ))
}

pub(super) fn entry_json(entry: &Entry) -> Value {
    json!({
        "name": entry.name.text(), "ready": entry.ready, "bytes": entry.total, "arrived": entry.have,
        "crc": format!("{:08x}", entry.crc), "instructions": entry.instructions,
    })
}

pub(super) fn report_json(report: &Report) -> Value {
    let axis = (report.axis != 0xff).then(|| client::axis_name(report.axis));
    json!({
        "state": report.state.text(), "name": report.name.text(), "progress": report.progress, "line": report.line,
        "elapsed_s": f64::from(report.elapsed) / 1e3, "remaining_s": f64::from(report.remaining) / 1e3,
        "end": report.end.text(), "end_axis": axis, "stands": report.stands, "attended": report.attended,
        "machine": report.machine, "position_known": report.known, "homed": (0..3).map(|axis| report.homed >> axis & 1 == 1).collect::<Vec<_>>(),
        "steps": report.steps, "outputs": report.outputs, "feed_percent": report.percent, "segments": report.segments,
        "refused": report.refused, "state_word": report.board,
    })
}

fn show(report: &Report, as_json: bool) -> Result<()> {
    match as_json {
        true => crate::text::say(&format!("{:#}\n", report_json(report))),
        false => crate::text::say(&text(report)),
    }
}

fn text(report: &Report) -> String {
    let seconds = |millis: u32| duration(f64::from(millis) / 1e3);
    let mut text = report.state.text().to_owned();
    if !report.name.is_empty() {
        text += &format!(
            ": {}, {} %, line {}, {} passed, {} to go",
            report.name.text(),
            report.progress,
            report.line,
            seconds(report.elapsed),
            seconds(report.remaining)
        );
    }
    text.push('\n');
    if report.end != End::None {
        text += &format!("ended last: {}\n", ended(report));
    }
    text += &format!(
        "at steps {:?}{}{}{}\n",
        report.steps,
        if report.known {
            ""
        } else {
            ", position not trusted"
        },
        if report.machine {
            ""
        } else {
            ", no machine description"
        },
        if report.stands { "" } else { ", moving" },
    );
    text
}

fn ended(report: &Report) -> String {
    match report.axis {
        0xff => report.end.text().to_owned(),
        axis => format!("{} ({})", report.end.text(), client::axis_name(axis)),
    }
}

/// Watches until the job is over; any end but a good one is an error.
fn watch(board: &mut Board, keepalive: Option<Duration>, as_json: bool) -> Result<()> {
    let every = keepalive.map_or(LOOK, |keepalive| LOOK.min(keepalive / 4));
    let mut bar = Bar::new(as_json);
    let mut last: Option<Report> = None;
    let report = loop {
        let report = board.report()?;
        let over = matches!(report.state, State::Stopped);
        if as_json && last != Some(report) {
            crate::text::say(&format!("{}\n", report_json(&report)))?;
        }
        last = Some(report);
        if over {
            break report;
        }
        let step = match report.state {
            State::Running => format!("{} {}", report.state.text(), report.name.text()),
            _ => report.state.text().to_owned(),
        };
        let all = (report.elapsed + report.remaining).max(1);
        bar.show_remaining(
            &step,
            f64::from(report.elapsed) / f64::from(all),
            &duration(f64::from(report.remaining) / 1e3),
        );
        board.hang_up();
        std::thread::sleep(every);
    };
    drop(bar);
    if !as_json {
        crate::text::say(&text(&report))?;
    }
    if matches!(report.end, End::None | End::Done) {
        return Ok(());
    }
    bail!("the job did not reach its end: {}", ended(&report))
}
