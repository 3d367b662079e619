//! `ferrocnc config apply` and `ferrocnc config read`: the board file that a board's pins follow.

use super::check::counts;
use super::{save, stem};
use crate::consent;
use crate::discover::Where;
use crate::progress::{Bar, Progress, show};
use crate::set::parse_uid;
use crate::text::{Told, say, tell};
use anyhow::{Result, anyhow, bail};
use clap::{ArgGroup, Args};
use ferrocnc::client::Client;
use ferrocnc::flash::PATIENCE;
use ferrocnc::pins::{Copies, Event, Facts, PinsError, Report, remedy};
use ferrocnc_config::pins::{Image, Stored, configuration};
use ferrocnc_config::source::read_text;
use ferrocnc_config::{Board, read_board_text};
use serde::Deserialize;
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
    let show = |event: Event| show(&bar, event.into());
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

/// What a page wants to be applied: the text of the file is in the request.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Wanted {
    board: String,
    /// The file's, without its ending.
    name: String,
}

impl Wanted {
    /// `ferrocnc config apply`: its progress goes to `say`.
    pub(crate) fn take(&self, text: &str, say: &dyn Fn(Progress)) -> Result<Told> {
        let wanted = read_board_text(&super::unsaved(&self.name), text)?;
        let client = crate::open(&self.board)?;
        applied(client, &wanted, text, PATIENCE, &|event| say(event.into()))
    }
}

/// The file that a board has stored.
struct Kept {
    name: String,
    text: String,
    generation: u32,
    verdict: Verdict,
}

impl Kept {
    fn read(mut client: Client, show: &dyn Fn(Event)) -> Result<Self> {
        let facts = Facts::read(&mut client)?;
        let mut copies = Copies::open(client, &facts, ferrocnc::client::PATIENCE, show)?;
        let bytes = copies.read()?;
        let stored = Stored::new_checked(&bytes).ok_or(PinsError::Nonsense)?;
        let description =
            Blob::new_checked(stored.description).map_err(|error| anyhow!("{error}"))?;
        let name = description.text(Kind::Configuration, 0).unwrap_or("");
        Ok(Kept {
            name: name.to_owned(),
            text: stored.text.to_owned(),
            generation: stored.head.generation(),
            verdict: facts.loaded.verdict,
        })
    }

    /// Why the board does not use it, if so.
    fn note(&self) -> Option<String> {
        let verdict = self.verdict;
        (verdict != Verdict::InForce)
            .then(|| format!("the board does not use it: {verdict}; {}", remedy(verdict)))
    }

    fn to_json(&self) -> serde_json::Value {
        json!({
            "configuration": self.name,
            "generation": self.generation,
            "in_force": self.verdict == Verdict::InForce,
            "verdict": self.verdict.text(),
            "note": self.note(),
            "text": self.text,
        })
    }
}

/// `ferrocnc config read` of a page.
pub(crate) fn kept(address: &str) -> Result<serde_json::Value> {
    Ok(Kept::read(crate::open(address)?, &|_| {})?.to_json())
}

pub(super) fn read(arguments: &Read, as_json: bool) -> Result<()> {
    if let Some(file) = &arguments.output {
        super::may_be_board(file)?;
        consent::may_write(file, arguments.force)?;
    }
    let board = arguments.board.as_deref();
    let client = arguments.wherever.client(board, arguments.uid)?;
    let bar = RefCell::new(Bar::new(as_json));
    let kept = Kept::read(client, &|event| show(&bar, event.into()));
    drop(bar);
    let kept = kept?;
    if let Some(note) = kept.note() {
        eprintln!("{note}");
    }
    if let Some(file) = &arguments.output {
        save(file, &kept.text)?;
        if stem(file) != kept.name {
            say(&format!(
                "  note: its name is {0}; {0}.toml would be read by the tools\n",
                kept.name
            ))?;
        }
        return Ok(());
    }
    match as_json {
        true => say(&format!("{:#}\n", kept.to_json())),
        false => say(&kept.text),
    }
}
