//! `ferrocnc panel`: panels for LinuxCNC's screens that say what is wrong with a board.

use anyhow::{Context, Result, bail};
use clap::Args;
use clap::ValueEnum;
use ferrocnc::panel::{File, pyvcp, qtvcp};
use std::path::PathBuf;

#[derive(Args)]
pub(crate) struct Panel {
    /// For which kind of screen.
    #[arg(value_enum)]
    kind: Kind,
    /// The folder of the machine's INI file.
    #[arg(value_name = "FOLDER")]
    folder: PathBuf,
    /// PyVCP: the board by its place in `boards=`. QtVCP: how many boards there are, less one.
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = clap::value_parser!(u8).range(0..8))]
    board: u8,
}

#[derive(Clone, Copy, ValueEnum)]
enum Kind {
    /// A panel beside AXIS, Gmoccapy or another screen that takes PyVCP.
    Pyvcp,
    /// A panel of its own.
    Qtvcp,
}

pub(crate) fn run(arguments: &Panel, as_json: bool) -> Result<()> {
    if as_json {
        bail!("`ferrocnc panel` writes files and answers in text; leave --json out");
    }
    if !arguments.folder.is_dir() {
        bail!("{} is no folder", arguments.folder.display());
    }
    let board = usize::from(arguments.board);
    let files = match arguments.kind {
        Kind::Pyvcp => pyvcp(board),
        Kind::Qtvcp => qtvcp(board + 1),
    };
    for File { name, text } in &files {
        let path = arguments.folder.join(name);
        if let Some(folder) = path.parent() {
            std::fs::create_dir_all(folder)
                .with_context(|| format!("cannot make {}", folder.display()))?;
        }
        std::fs::write(&path, text).with_context(|| format!("cannot write {}", path.display()))?;
        println!("{}", path.display());
    }
    match arguments.kind {
        Kind::Pyvcp => println!(
            "in the INI file: [DISPLAY] PYVCP = {}, [HAL] POSTGUI_HALFILE = {}",
            files[0].name, files[1].name
        ),
        Kind::Qtvcp => println!("in the INI file: [HAL] POSTGUI_HALFILE = {}", files[2].name),
    }
    Ok(())
}
