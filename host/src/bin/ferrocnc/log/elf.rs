//! The firmware's ELF that belongs to a running board, found by its build id.
//!
//! `cargo xtask bitstream` leaves `NAME.elf` beside the image: the firmware's ELF, and behind it
//! the trailer that the ROM of this image has (`FTRL`, build id, role, 0; docs/images.md). Readers
//! of ELF files do not see what is behind the end.

use anyhow::{Context, Result, bail};
use std::path::{Path, PathBuf};
use wire::images::Trailer;

/// Where images are: as built, and as the package `ferrocnc-images` has them.
pub(super) const FOLDERS: [&str; 3] = [
    "target/bitstream",
    "target/firmware",
    "/usr/share/ferrocnc/images",
];

/// As the firmware is built, without a build id: a board that was never packed has none either.
const UNPACKED: &str = "target/firmware/ferrocnc-firmware.elf";

/// An ELF, and what is to be said of it.
#[derive(Debug)]
pub(super) struct Chosen {
    pub file: PathBuf,
    pub bytes: Vec<u8>,
    pub note: Option<String>,
}

/// The build id behind the end of an ELF; none if it has no trailer.
fn build_of(bytes: &[u8]) -> Option<u32> {
    let (_, last) = bytes.split_last_chunk::<{ 4 * Trailer::WORDS }>()?;
    let mut words = [0; Trailer::WORDS];
    for (word, bytes) in words.iter_mut().zip(last.as_chunks::<4>().0) {
        *word = u32::from_le_bytes(*bytes);
    }
    let trailer = Trailer::from_words(words);
    (trailer != Trailer::NONE).then_some(trailer.build_id)
}

fn read(file: &Path) -> Result<Vec<u8>> {
    std::fs::read(file).with_context(|| {
        format!(
            "cannot read {}; name the firmware's ELF with --elf, or a folder that has it with --elf-dir",
            file.display()
        )
    })
}

/// The named ELF if it may be that of the build.
pub(super) fn named(file: &Path, build: u32) -> Result<Chosen> {
    let bytes = read(file)?;
    let shown = file.display();
    let note = match build_of(&bytes) {
        Some(theirs) if theirs == build => None,
        Some(theirs) => bail!(
            "{shown} is the firmware of build {theirs:08x}, but the board runs build {build:08x}; leave out --elf, or name the folder of its images with --elf-dir"
        ),
        None => Some(format!(
            "{shown} does not say its build; the texts are right only if the board runs it (build {build:08x})"
        )),
    };
    let file = file.to_owned();
    Ok(Chosen { file, bytes, note })
}

/// The ELF of the build: the first that is found in the folders, or one folder below them.
pub(super) fn found(folders: &[PathBuf], build: u32) -> Result<Chosen> {
    for folder in folders {
        for file in elves(folder, 1) {
            let bytes = read(&file)?;
            if build_of(&bytes) == Some(build) {
                let note = None;
                return Ok(Chosen { file, bytes, note });
            }
        }
    }
    if build == 0 {
        return named(Path::new(UNPACKED), build);
    }
    let folders: Vec<String> = folders
        .iter()
        .map(|folder| folder.display().to_string())
        .collect();
    bail!(
        "the board runs build {build:08x}, and no ELF of this build is in {}; name its folder with --elf-dir, or pack the image again (`cargo xtask bitstream BOARD.toml`), which leaves the ELF beside it",
        folders.join(", ")
    )
}

/// The ELF files of a folder in the order of their names, then those of the folders in it. What
/// cannot be listed has none.
fn elves(folder: &Path, deeper: u32) -> Vec<PathBuf> {
    let Ok(entries) = std::fs::read_dir(folder) else {
        return Vec::new();
    };
    let mut entries: Vec<PathBuf> = entries.flatten().map(|entry| entry.path()).collect();
    entries.sort();
    let is_elf = |file: &&PathBuf| file.extension().is_some_and(|ending| ending == "elf");
    let mut found: Vec<PathBuf> = entries.iter().filter(is_elf).cloned().collect();
    if deeper > 0 {
        let folders = entries.iter().filter(|entry| entry.is_dir());
        found.extend(folders.flat_map(|folder| elves(folder, deeper - 1)));
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;
    use wire::images::Role;

    /// A file that is said to be of this build.
    fn marked(build_id: u32) -> Vec<u8> {
        let role = Role::Image;
        let words = Trailer { build_id, role }.to_words();
        let mut bytes = b"\x7fELF and more".to_vec();
        bytes.extend(words.iter().flat_map(|word| word.to_le_bytes()));
        bytes
    }

    fn folder(name: &str, files: &[(&str, Vec<u8>)]) -> PathBuf {
        let name = format!("ferrocnc-elf-{}-{name}", std::process::id());
        let folder = std::env::temp_dir().join(name);
        for (file, bytes) in files {
            let file = folder.join(file);
            std::fs::create_dir_all(file.parent().expect("a folder")).expect("a folder");
            std::fs::write(file, bytes).expect("a file");
        }
        folder
    }

    #[test]
    fn the_elf_is_found_by_the_build_of_the_board_wherever_it_lies() {
        let files = [
            ("a.elf", b"\x7fELF".to_vec()),
            ("mill6/mill6.elf", marked(7)),
            ("plotter/plotter.elf", marked(9)),
            ("plotter/plotter.bit", marked(8)),
        ];
        let folder = folder("found", &files);
        let folders = [PathBuf::from("/nowhere"), folder.clone()];
        let chosen = found(&folders, 9).expect("it is there");
        assert_eq!(chosen.file, folder.join("plotter/plotter.elf"));
        assert_eq!((chosen.note, chosen.bytes), (None, marked(9)));
        let error = found(&folders, 8)
            .expect_err("a bitstream is none")
            .to_string();
        let said = "the board runs build 00000008, and no ELF of this build is in /nowhere, ";
        assert!(
            error.starts_with(said) && error.contains("--elf-dir"),
            "{error}"
        );
        let _ = std::fs::remove_dir_all(folder);
    }

    #[test]
    fn an_elf_of_another_build_is_refused_and_one_without_a_build_is_told() {
        let files = [("right.elf", marked(7)), ("plain.elf", b"\x7fELF".to_vec())];
        let folder = folder("named", &files);
        let right = folder.join("right.elf");
        assert!(named(&right, 7).expect("the same build").note.is_none());
        let error = named(&right, 9).expect_err("another build").to_string();
        let said = "is the firmware of build 00000007, but the board runs build 00000009; ";
        assert!(error.contains(said), "{error}");
        let plain = named(&folder.join("plain.elf"), 9).expect("it may be right");
        let note = plain.note.expect("a note");
        assert!(note.contains("plain.elf does not say its build"), "{note}");
        let error = named(&folder.join("none.elf"), 9).expect_err("no file");
        assert!(format!("{error:#}").contains("--elf-dir"), "{error:#}");
        let _ = std::fs::remove_dir_all(folder);
    }
}
