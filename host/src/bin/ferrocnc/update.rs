//! `ferrocnc update`: writes a new image over the network.

use crate::discover::Where;
use crate::progress::Bar;
use crate::set::parse_uid;
use anyhow::{Context, Result, bail};
use clap::{ArgGroup, Args, ValueEnum};
use ferrocnc::flash::Word;
use ferrocnc::image::Image;
use ferrocnc::provision;
use ferrocnc::update::{Event, Options, Report, update};
use serde_json::json;
use std::cell::RefCell;
use std::path::PathBuf;
use std::time::Duration;

#[derive(Args)]
#[command(group(ArgGroup::new("which").required(true).args(["board", "uid"])), allow_missing_positional = true)]
pub(crate) struct Update {
    /// IP[:port] of the board, unless --uid names it.
    #[arg(value_name = "BOARD")]
    board: Option<String>,
    /// The bitstream, NAME.bit.
    #[arg(value_name = "FILE", required = true)]
    file: PathBuf,
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

pub(crate) fn run(arguments: &Update, as_json: bool) -> Result<()> {
    let file = &arguments.file;
    let bytes = std::fs::read(file).with_context(|| format!("cannot read {}", file.display()))?;
    let image = Image::parse(&bytes).with_context(|| file.display().to_string())?;
    let client = match (&arguments.board, arguments.uid) {
        (Some(address), _) => crate::open(address)?,
        (None, Some(uid)) => provision::reach(&arguments.wherever.finder()?, uid)?
            .1
            .with_keys(crate::keys()),
        (None, None) => bail!("which board? Name its address or --uid"),
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
