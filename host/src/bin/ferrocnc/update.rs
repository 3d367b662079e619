//! `ferrocnc update`: writes a new image over the network.

use crate::discover::Where;
use crate::images;
use crate::progress::{Bar, Progress, show};
use crate::set::parse_uid;
use crate::text::{Told, tell};
use anyhow::{Context, Result, bail};
use clap::{ArgGroup, Args, ValueEnum};
use ferrocnc::client::Client;
use ferrocnc::image::Image;
use ferrocnc::update::{Event, Options, Report, back, update};
use serde::Deserialize;
use serde_json::json;
use std::cell::RefCell;
use std::path::{Path, PathBuf};
use std::time::Duration;
use wire::board::Kind;

#[derive(Args)]
#[command(group(ArgGroup::new("which").required(true).multiple(true).args(["board", "uid"])))]
pub(crate) struct Update {
    /// IP[:port] of the board, unless --uid names it.
    #[arg(value_name = "BOARD")]
    board: Option<String>,
    /// The bitstream, NAME.bit; that of the installed package for the board's card and board file
    /// if not given.
    #[arg(value_name = "FILE")]
    file: Option<PathBuf>,
    /// Take the installed image of this board file instead, for the same card.
    #[arg(
        id = "configuration",
        long = "board",
        value_name = "NAME",
        conflicts_with = "file"
    )]
    configuration: Option<String>,
    /// Where installed images are.
    #[arg(long, value_name = "DIR", default_value = images::INSTALLED)]
    images: PathBuf,
    /// The board with this unique id (ferrocnc discover shows ids).
    #[arg(long, value_name = "UID", value_parser = parse_uid)]
    uid: Option<[u32; 2]>,
    /// Write this slot; the one that is not selected if not given.
    #[arg(long, value_enum, ignore_case = true)]
    slot: Option<Slot>,
    /// Write nothing: select the image in the other slot, which was selected before the last
    /// update. The board sums it up first.
    #[arg(long, conflicts_with_all = ["file", "configuration", "slot", "quick"])]
    back: bool,
    /// Trust the board's CRC, do not read every byte back.
    #[arg(long)]
    quick: bool,
    /// Write an image made for another platform's pins.
    #[arg(long)]
    force_platform: bool,
    /// Wait so many seconds for a board that has fallen silent.
    #[arg(long, value_name = "S", default_value_t = 60)]
    patience: u64,
    #[command(flatten)]
    wherever: Where,
}

#[derive(Clone, Copy, ValueEnum)]
enum Slot {
    A,
    B,
}

impl Update {
    /// The board's address and the file, of those that are named: with --uid, what stands alone is
    /// the file.
    fn named(&self) -> Result<(Option<&str>, Option<&Path>)> {
        let (board, file) = (self.board.as_deref(), self.file.as_deref());
        match (self.uid, board, file) {
            (Some(_), Some(_), Some(_)) => {
                bail!("--uid names the board already; leave its address out")
            }
            (Some(_), Some(_), None) if self.configuration.is_some() => {
                bail!("a file and --board; name one of the two")
            }
            (Some(_), file, None) => Ok((None, file.map(Path::new))),
            (_, board, file) => Ok((board, file)),
        }
    }

    fn client(&self, board: Option<&str>) -> Result<Client> {
        self.wherever.client(board, self.uid)
    }
}

/// The installed image for the card that the board says it is, of this board file or of the one
/// that it runs.
fn installed(folder: &Path, configuration: Option<&str>, client: &mut Client) -> Result<PathBuf> {
    let identity = client.identify()?;
    let blob = identity.blob();
    let said = |kind| blob.text(kind, 0).filter(|text| !text.is_empty());
    let Some(card) = said(Kind::Platform) else {
        bail!(
            "the board does not say which card it is; name a file: ferrocnc update BOARD NAME.bit"
        );
    };
    // An image whose pins are configured has the name of its card, whatever is applied to it.
    let runs = match identity.has_configured_pins() {
        true => Some(card),
        false => said(Kind::Configuration),
    };
    let board = configuration.or(runs);
    Ok(images::of_card(folder, card, board)?.with_extension("bit"))
}

fn read(file: &Path) -> Result<Image> {
    let bytes = std::fs::read(file).with_context(|| format!("cannot read {}", file.display()))?;
    Image::parse(&bytes).with_context(|| file.display().to_string())
}

pub(crate) fn run(arguments: &Update, as_json: bool) -> Result<()> {
    let (board, file) = arguments.named()?;
    let options = Options {
        slot: arguments.slot.map(|slot| match slot {
            Slot::A => wire::flash::Slot::A,
            Slot::B => wire::flash::Slot::B,
        }),
        force_platform: arguments.force_platform,
        quick: arguments.quick,
        patience: Duration::from_secs(arguments.patience),
    };
    let bar = RefCell::new(Bar::new(as_json));
    let shown = |event: Event| show(&bar, event.into());
    let told = match (arguments.back, file) {
        (true, Some(file)) => bail!("{}: --back takes no file", file.display()),
        (true, None) => turned_back(arguments.client(board)?, &options, &shown),
        (false, Some(file)) => {
            let image = read(file)?;
            updated(arguments.client(board)?, &image, &options, &shown)
        }
        (false, None) => {
            let mut client = arguments.client(board)?;
            let configuration = arguments.configuration.as_deref();
            let image = read(&installed(&arguments.images, configuration, &mut client)?)?;
            updated(client, &image, &options, &shown)
        }
    };
    drop(bar);
    tell(&told?, as_json)
}

fn updated(client: Client, image: &Image, options: &Options, show: &dyn Fn(Event)) -> Result<Told> {
    let report = update(client, image, options, show)?;
    Ok(Told {
        json: to_json(&report),
        text: to_text(&report, image),
    })
}

fn turned_back(client: Client, options: &Options, show: &dyn Fn(Event)) -> Result<Told> {
    let (report, meta) = back(client, options, show)?;
    let text = format!(
        "slot {} holds {} on {}, build {:08x}, and is selected\n{}",
        report.slot,
        meta.configuration,
        meta.platform,
        meta.build_id,
        powered(&report)
    );
    Ok(Told {
        json: to_json(&report),
        text,
    })
}

/// What a page wants to be updated.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Wanted {
    board: String,
    /// The bitstream's name: its bytes are in the request. The installed image if there is none.
    #[serde(default)]
    file: String,
    /// Back to the image in the other slot.
    #[serde(default)]
    back: bool,
}

impl Wanted {
    /// `ferrocnc update`: its progress goes to `say`.
    pub(crate) fn take(&self, bytes: &[u8], say: &dyn Fn(Progress)) -> Result<Told> {
        let options = Options::default();
        let show = |event: Event| say(event.into());
        let mut client = crate::open(&self.board)?;
        match (self.back, self.file.as_str()) {
            (true, "") => turned_back(client, &options, &show),
            (true, file) => bail!("{file}: back to the image before takes no file"),
            (false, "") => {
                let path = installed(Path::new(images::INSTALLED), None, &mut client)?;
                updated(client, &read(&path)?, &options, &show)
            }
            (false, file) => {
                let image = Image::parse(bytes).with_context(|| file.to_owned())?;
                updated(client, &image, &options, &show)
            }
        }
    }
}

fn to_text(report: &Report, image: &Image) -> String {
    let blocks = match (report.written, report.kept) {
        (0, _) => "it was there already".to_owned(),
        (written, 0) => format!("{written} blocks written"),
        (written, kept) => format!("{written} blocks written, {kept} were right already"),
    };
    format!(
        "slot {} holds {image} ({blocks}), verified and selected\n{}",
        report.slot,
        powered(report)
    )
}

/// What runs now, and what after the next power-up.
fn powered(report: &Report) -> String {
    let next = match report.running_build == report.selected_build {
        true => "It runs already",
        false => "Power the board off and on to run it",
    };
    format!(
        "runs now:              {}, build {:08x}\nafter next power-up:   slot {}, build {:08x}\n{next}",
        report.running, report.running_build, report.slot, report.selected_build
    )
}

fn to_json(report: &Report) -> serde_json::Value {
    json!({
        "slot": report.slot.text(),
        "blocks_written": report.written,
        "blocks_kept": report.kept,
        "running": report.running.text(),
        "running_build": format!("{:08x}", report.running_build),
        "selected": report.selected.map(|slot| slot.text()),
        "selected_build": format!("{:08x}", report.selected_build),
    })
}
