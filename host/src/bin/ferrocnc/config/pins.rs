//! `ferrocnc config apply` and `ferrocnc config read`: the board file that a board's pins follow.

use super::check::counts;
use super::{save, stem};
use crate::consent;
use crate::discover::Where;
use crate::progress::{Bar, said};
use crate::set::parse_uid;
use crate::text::{Told, say, tell};
use anyhow::{Result, anyhow, bail};
use clap::{ArgGroup, Args};
use ferrocnc::client::Client;
use ferrocnc::pins::{Copies, Event, Facts, PinsError, Report, remedy};
use ferrocnc_config::pins::{Image, Stored, configuration};
use ferrocnc_config::source::read_text;
use ferrocnc_config::{Board, read_board_text};
use serde_json::json;
use std::cell::RefCell;
use std::net::SocketAddrV4;
use std::path::{Path, PathBuf};
use std::time::Duration;
use wire::board::{Blob, Kind};
use wire::pins::{BYTES_MAX, Verdict};

#[derive(Args)]
#[command(group(ArgGroup::new("which").required(true).multiple(true).args(["board", "uid"])))]
pub(crate) struct Apply {
    /// IP[:port] of the board, unless --uid names it.
    #[arg(value_name = "BOARD")]
    board: Option<String>,
    /// A board file.
    #[arg(value_name = "FILE.toml")]
    file: Option<PathBuf>,
    /// The board with this unique id (ferrocnc discover shows ids).
    #[arg(long, value_name = "UID", value_parser = parse_uid)]
    uid: Option<[u32; 2]>,
    /// Wait so many seconds for a board that has fallen silent.
    #[arg(long, value_name = "S", default_value_t = 60)]
    patience: u64,
    #[command(flatten)]
    wherever: Where,
}

#[derive(Args)]
#[command(group(ArgGroup::new("which").required(true).args(["board", "uid"])))]
pub(crate) struct Read {
    /// IP[:port] of the board.
    #[arg(value_name = "BOARD")]
    board: Option<String>,
    /// The board with this unique id (ferrocnc discover shows ids).
    #[arg(long, value_name = "UID", value_parser = parse_uid)]
    uid: Option<[u32; 2]>,
    /// The file to write; the text is printed if not given.
    #[arg(long, short, value_name = "FILE.toml")]
    output: Option<PathBuf>,
    /// Overwrite it.
    #[arg(long)]
    force: bool,
    #[command(flatten)]
    wherever: Where,
}

impl Apply {
    /// The board's address and the file: with --uid, what stands alone is the file.
    fn named(&self) -> Result<(Option<&str>, &Path)> {
        let (board, file) = (self.board.as_deref(), self.file.as_deref());
        match (self.uid, board, file) {
            (Some(_), Some(_), Some(_)) => {
                bail!("--uid names the board already; leave its address out")
            }
            (Some(_), Some(file), None) => Ok((None, Path::new(file))),
            (None, board @ Some(_), Some(file)) => Ok((board, file)),
            (_, _, _) => {
                bail!(
                    "which board file? ferrocnc config apply BOARD FILE.toml, or --uid UID FILE.toml"
                )
            }
        }
    }
}

pub(super) fn apply(arguments: &Apply, as_json: bool) -> Result<()> {
    let (board, file) = arguments.named()?;
    let text = read_text(file)?;
    let wanted = read_board_text(file, &text)?;
    let client = arguments.wherever.client(board, arguments.uid)?;
    let bar = RefCell::new(Bar::new(as_json));
    let show = |event| show(&bar, event);
    let patience = Duration::from_secs(arguments.patience);
    let told = applied(client, &wanted, &text, patience, &show);
    drop(bar);
    tell(&told?, as_json)
}

fn applied(
    mut client: Client,
    board: &Board,
    text: &str,
    patience: Duration,
    show: &dyn Fn(Event),
) -> Result<Told> {
    let address = client.address().clone();
    let facts = Facts::read(&mut client)?;
    let image = Image {
        built: facts.built,
        platform: facts.platform,
        clock_hz: facts.clock_hz,
        features: facts.features,
    };
    // Before the board is asked for anything that it might refuse.
    image.fits(board)?;
    configuration(board, text, facts.built, 0)?;
    let copies = Copies::open(client, &facts, patience, show)?;
    let bytes = configuration(board, text, facts.built, copies.next_generation())?;
    let network = SocketAddrV4::new(board.ipv4.into(), board.udp_port);
    let report = copies.write(&bytes, network)?;
    Ok(Told {
        json: to_json(board, &report),
        text: to_text(board, &address.to_string(), &report),
    })
}

fn to_text(board: &Board, address: &str, report: &Report) -> String {
    let moved = match report.moved {
        Some(moved) => format!("; the board is at {moved} now, as the file has it"),
        None => String::new(),
    };
    format!(
        "{address} has the pins of {}: {} of {BYTES_MAX} bytes in copy {}, in force {:.1} s after the restart{moved}",
        counts(board),
        report.bytes,
        report.copy,
        report.restarted_in.as_secs_f64(),
    )
}

fn to_json(board: &Board, report: &Report) -> serde_json::Value {
    json!({
        "configuration": board.name,
        "platform": board.platform.name,
        "copy": report.copy,
        "generation": report.generation,
        "bytes": report.bytes,
        "restarted_in_s": report.restarted_in.as_secs_f64(),
        "moved": report.moved.map(|moved| moved.to_string()),
    })
}

fn show(bar: &RefCell<Bar>, event: Event) {
    let mut bar = bar.borrow_mut();
    match event {
        Event::Step(step, part) => bar.show(step, part),
        Event::Word(word) => bar.say(&said(word)),
    }
}

pub(super) fn read(arguments: &Read, as_json: bool) -> Result<()> {
    if let Some(file) = &arguments.output {
        super::may_be_board(file)?;
        consent::may_write(file, arguments.force)?;
    }
    let board = arguments.board.as_deref();
    let mut client = arguments.wherever.client(board, arguments.uid)?;
    let facts = Facts::read(&mut client)?;
    let bar = RefCell::new(Bar::new(as_json));
    let show = |event| show(&bar, event);
    let bytes = Copies::open(client, &facts, ferrocnc::client::PATIENCE, &show)
        .and_then(|mut copies| copies.read());
    drop(bar);
    let bytes = bytes?;
    let stored = Stored::new_checked(&bytes).ok_or(PinsError::Nonsense)?;
    let verdict = facts.loaded.verdict;
    if verdict != Verdict::InForce {
        eprintln!("the board does not use it: {verdict}; {}", remedy(verdict));
    }
    let description = Blob::new_checked(stored.description).map_err(|error| anyhow!("{error}"))?;
    let name = description.text(Kind::Configuration, 0).unwrap_or("");
    if let Some(file) = &arguments.output {
        save(file, stored.text)?;
        if stem(file) != name {
            say(&format!(
                "  note: its name is {name}; {name}.toml would be read by the tools\n"
            ))?;
        }
        return Ok(());
    }
    match as_json {
        true => say(&format!(
            "{:#}\n",
            json!({
                "configuration": name,
                "generation": stored.head.generation(),
                "in_force": verdict == Verdict::InForce,
                "verdict": verdict.text(),
                "text": stored.text,
            })
        )),
        false => say(stored.text),
    }
}
