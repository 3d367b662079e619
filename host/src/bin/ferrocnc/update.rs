//! `ferrocnc update`: writes a new image over the network.

use crate::discover::Where;
use crate::images;
use crate::progress::Bar;
use crate::set::parse_uid;
use anyhow::{Context, Result, bail};
use clap::{ArgGroup, Args, ValueEnum};
use ferrocnc::client::Client;
use ferrocnc::flash::Word;
use ferrocnc::image::Image;
use ferrocnc::provision;
use ferrocnc::update::{Event, Options, Report, update};
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
        match (board, self.uid) {
            (Some(address), _) => crate::open(address),
            (None, Some(uid)) => Ok(provision::reach(&self.wherever.finder()?, uid)?
                .1
                .with_keys(crate::keys())),
            (None, None) => bail!("which board? Name its address or --uid"),
        }
    }

    /// The installed image for the card that the board says it is.
    fn installed(&self, client: &mut Client) -> Result<PathBuf> {
        let identity = client.identify()?;
        let blob = identity.blob();
        let said = |kind| blob.text(kind, 0).filter(|text| !text.is_empty());
        let Some(card) = said(Kind::Platform) else {
            bail!(
                "the board does not say which card it is; name a file: ferrocnc update BOARD NAME.bit"
            );
        };
        let board = self.configuration.as_deref();
        let board = board.or_else(|| said(Kind::Configuration));
        Ok(images::of_card(&self.images, card, board)?.with_extension("bit"))
    }
}

fn read(file: &Path) -> Result<Image> {
    let bytes = std::fs::read(file).with_context(|| format!("cannot read {}", file.display()))?;
    Image::parse(&bytes).with_context(|| file.display().to_string())
}

pub(crate) fn run(arguments: &Update, as_json: bool) -> Result<()> {
    let (board, file) = arguments.named()?;
    let (image, client) = match file {
        Some(file) => (read(file)?, arguments.client(board)?),
        None => {
            let mut client = arguments.client(board)?;
            (read(&arguments.installed(&mut client)?)?, client)
        }
    };
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
    let report = update(client, &image, &options, &|event| show(&bar, event));
    drop(bar);
    let report = report?;
    if as_json {
        println!("{:#}", to_json(&report));
    } else {
        println!("{}", to_text(&report, &image));
    }
    Ok(())
}

fn show(bar: &RefCell<Bar>, event: Event) {
    let mut bar = bar.borrow_mut();
    match event {
        Event::Step(step, part) => bar.show(step, part),
        Event::Word(Word::Silent(patience)) => bar.say(&format!(
            "the board does not answer; waiting up to {} s",
            patience.as_secs()
        )),
        Event::Word(Word::Back) => bar.say("the board answers again"),
        Event::NoGolden => bar.say(
            "warning: there is no golden image in this board's flash; if both slots fail the board needs JTAG",
        ),
        Event::Unprotected => {
            bar.say("warning: the board's flash does not protect its golden image");
        }
    }
}

fn to_text(report: &Report, image: &Image) -> String {
    let blocks = match (report.written, report.kept) {
        (0, _) => "it was there already".to_owned(),
        (written, 0) => format!("{written} blocks written"),
        (written, kept) => format!("{written} blocks written, {kept} were right already"),
    };
    let running = format!("{}, build {:08x}", report.running, report.running_build);
    let next = match report.running_build == image.build {
        true => "It runs already".to_owned(),
        false => "Power the board off and on to run it".to_owned(),
    };
    format!(
        "slot {} holds {image} ({blocks}), verified and selected\nruns now:              {running}\nafter next power-up:   slot {}, build {:08x}\n{next}",
        report.slot, report.slot, report.selected_build
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
