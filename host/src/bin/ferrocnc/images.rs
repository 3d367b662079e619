//! The images of the package `ferrocnc-images`: a folder per board file, with its flash image, and
//! its bitstream beside it.

use anyhow::{Result, bail};
use ferrocnc::flash_file::FlashFile;
use std::path::{Path, PathBuf};

/// Where the package has them.
pub(crate) const INSTALLED: &str = "/usr/share/ferrocnc/images";

/// A flash image.
pub(crate) struct Installed {
    /// The board file it was made of.
    pub(crate) configuration: String,
    /// The card it is for.
    pub(crate) platform: String,
    /// Its file.
    pub(crate) path: PathBuf,
}

/// All whole ones below this folder, by name.
pub(crate) fn all(folder: &Path) -> Vec<Installed> {
    let entries = |path: &Path| {
        let entries = std::fs::read_dir(path).into_iter().flatten().flatten();
        let mut paths: Vec<PathBuf> = entries.map(|entry| entry.path()).collect();
        paths.sort();
        paths
    };
    let files = entries(folder)
        .into_iter()
        .flat_map(|board| entries(&board));
    let flashes = files.filter(|path| path.extension().is_some_and(|end| end == "flash"));
    let whole = flashes.filter_map(|path| {
        let flash = FlashFile::parse(std::fs::read(&path).ok()?).ok()?;
        Some(Installed {
            configuration: flash.image.configuration.to_string(),
            platform: flash.image.platform.to_string(),
            path,
        })
    });
    whole.collect()
}

/// The one image for this card, or that of this board file.
pub(crate) fn of_card(folder: &Path, card: &str, board: Option<&str>) -> Result<PathBuf> {
    let all = all(folder);
    let shown = folder.display();
    if all.is_empty() {
        bail!(
            "no image is in {shown}; install the package ferrocnc-images, or name a file: cargo xtask bitstream makes one"
        );
    }
    let fits = |one: &&Installed| {
        one.platform == card && board.is_none_or(|board| one.configuration == board)
    };
    let found: Vec<&Installed> = all.iter().filter(fits).collect();
    match found[..] {
        [one] => Ok(one.path.clone()),
        [] => {
            let known: Vec<String> = all
                .iter()
                .map(|one| format!("{} for {}", one.configuration, one.platform))
                .collect();
            let what = match board {
                Some(board) => format!("{board} for {card}"),
                None => format!("a {card}"),
            };
            bail!(
                "no image in {shown} is {what}; it has {}: name one with --board, or a file",
                known.join(", ")
            )
        }
        _ => {
            let names: Vec<&str> = found.iter().map(|one| one.configuration.as_str()).collect();
            bail!(
                "{shown} has several images for {card}; say which with --board: {}",
                names.join(", ")
            )
        }
    }
}
