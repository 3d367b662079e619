//! `ferrocnc flash load|write|verify`: runs openFPGALoader for a board at a JTAG cable.

use crate::images;
use crate::progress::Bar;
use anyhow::{Context, Result, bail};
use clap::Subcommand;
use ferrocnc::flash_file::FlashFile;
use ferrocnc::image::Image;
use ferrocnc::jtag::{DEFAULT_CABLE, Loader, Progress};
use serde_json::json;
use std::path::{Path, PathBuf};

#[derive(Subcommand)]
pub(crate) enum Flash {
    /// Load a bitstream into the FPGA; gone at power-off. Nothing in the flash changes.
    Load {
        /// NAME.bit
        file: PathBuf,
        #[command(flatten)]
        cable: Cable,
    },
    /// Write the whole flash: the first one of a board's life. Settings on the board are lost.
    Write {
        /// NAME.flash; that of the installed package if --card is given.
        #[arg(required_unless_present = "card")]
        file: Option<PathBuf>,
        #[command(flatten)]
        installed: FromPackage,
        #[command(flatten)]
        cable: Cable,
    },
    /// Read the flash and compare it; settings and slot B are not looked at. The board restarts.
    Verify {
        /// NAME.flash
        file: PathBuf,
        #[command(flatten)]
        cable: Cable,
    },
}

/// An image of the package ferrocnc-images.
#[derive(clap::Args)]
pub(crate) struct FromPackage {
    /// The card, as in 5a-75b-8.0 (ferrocnc card identify). An image for another one is refused.
    #[arg(long, value_name = "CARD")]
    card: Option<String>,
    /// Which of the card's images: the name of its board file.
    #[arg(long, value_name = "NAME", requires = "card")]
    board: Option<String>,
    /// Where installed images are.
    #[arg(long, value_name = "DIR", default_value = images::INSTALLED)]
    images: PathBuf,
}

#[derive(clap::Args)]
pub(crate) struct Cable {
    /// JTAG cable, by openFPGALoader's name for it (openFPGALoader --list-cables).
    #[arg(long, short, default_value = DEFAULT_CABLE)]
    cable: String,
    /// JTAG clock in Hz, for long wires; openFPGALoader's own if not given.
    #[arg(long, value_name = "HZ")]
    freq: Option<u32>,
}

impl Cable {
    fn loader(&self) -> Loader {
        Loader::new(&self.cable).with_frequency(self.freq)
    }
}

pub(crate) fn run(what: &Flash, as_json: bool) -> Result<()> {
    let mut bar = Bar::new(as_json);
    let done = match what {
        Flash::Load { file, cable } => load(file, &cable.loader(), &mut bar),
        Flash::Write {
            file,
            installed,
            cable,
        } => write(file.as_deref(), installed, &cable.loader(), &mut bar),
        Flash::Verify { file, cable } => verify(file, &cable.loader(), &mut bar),
    };
    drop(bar);
    let done = done?;
    if as_json {
        println!("{:#}", json!({ "done": done }));
    } else {
        println!("{done}");
    }
    Ok(())
}

fn read(file: &Path) -> Result<Vec<u8>> {
    std::fs::read(file).with_context(|| format!("cannot read {}", file.display()))
}

fn load(file: &Path, loader: &Loader, bar: &mut Bar) -> Result<String> {
    let bytes = read(file)?;
    let image = Image::parse(&bytes).with_context(|| file.display().to_string())?;
    loader.expect(image.idcode)?;
    let program = image.program();
    if program == 0 {
        loader.load(file, &mut |progress| show(bar, &progress))?;
    } else {
        // The firmware reads the data after the bitstream from the flash. The FPGA would take it
        // for commands.
        let name = format!("ferrocnc-load-{}.bit", std::process::id());
        let alone = std::env::temp_dir().join(name);
        std::fs::write(&alone, bytes.get(..bytes.len() - program).unwrap_or(&bytes))
            .with_context(|| format!("cannot write {}", alone.display()))?;
        let loaded = loader.load(&alone, &mut |progress| show(bar, &progress));
        // A temporary file; an error does no harm.
        let _ = std::fs::remove_file(&alone);
        loaded?;
    }
    let without = if program == 0 {
        ""
    } else {
        ", without the services"
    };
    Ok(format!(
        "loaded: {image}. It runs until power-off{without}; then the board loads from its flash again"
    ))
}

fn write(
    file: Option<&Path>,
    installed: &FromPackage,
    loader: &Loader,
    bar: &mut Bar,
) -> Result<String> {
    let (card, board) = (installed.card.as_deref(), installed.board.as_deref());
    let file = match (file, card) {
        (Some(file), _) => file.to_owned(),
        (None, Some(card)) => images::of_card(&installed.images, card, board)?,
        (None, None) => bail!("name a file, or the card with --card"),
    };
    let file = &*file;
    let flash = FlashFile::parse(read(file)?).with_context(|| file.display().to_string())?;
    let platform = flash.image.platform.to_string();
    if let Some(card) = card.filter(|card| **card != platform) {
        bail!(
            "{} is for {platform}, not for {card}; its pins would be others: take the image of this card",
            file.display()
        );
    }
    loader.expect(flash.image.idcode)?;
    loader.write(file, &mut |progress| show(bar, &progress))?;
    Ok(format!(
        "written and verified: {} on {}, build {:08x} in slot A, golden build {:08x}. Power the board off and on",
        flash.image.configuration,
        flash.image.platform,
        flash.image.build_id,
        flash.golden.build_id
    ))
}

fn verify(file: &Path, loader: &Loader, bar: &mut Bar) -> Result<String> {
    let flash = FlashFile::parse(read(file)?).with_context(|| file.display().to_string())?;
    loader.expect(flash.image.idcode)?;
    let copy = std::env::temp_dir().join(format!("ferrocnc-flash-{}.bin", std::process::id()));
    let dumped = loader.dump(flash.len(), &copy, &mut |progress| show(bar, &progress));
    let bytes = std::fs::read(&copy);
    // The file may not exist; an error does no harm.
    let _ = std::fs::remove_file(&copy);
    dumped?;
    let bytes = bytes.context("openFPGALoader left no copy of the flash")?;
    let differ = flash.compare(&bytes);
    if let Some((piece, at)) = differ.first() {
        let pieces: Vec<&str> = differ.iter().map(|(piece, _)| *piece).collect();
        bail!(
            "the flash differs from {}: {} ({piece} first at {at:#08x}); after an update over the network stubs and slot A do",
            file.display(),
            pieces.join(", ")
        );
    }
    Ok("the flash agrees with the file".to_owned())
}

fn show(bar: &mut Bar, progress: &Progress) {
    bar.show(&progress.step, progress.percent / 100.0);
}
