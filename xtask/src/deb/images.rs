//! What the package `ferrocnc-images` takes of `target/bitstream`: one folder per board file that
//! `cargo xtask bitstream` has built, and SHA-256 sums of all.

use crate::{root, setup, tree};
use anyhow::{Context, Result};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

/// What a board's folder must have, after its name.
const FILES: [&str; 3] = [".bit", "-golden.bit", ".flash"];

/// What it may have, too: the texts of `ferrocnc log`. Images packed before it was there have none.
const TEXTS: &str = ".elf";

/// A board file without pins, which gets no images.
const WITHOUT: &str = "max";

/// The boards whose images are there, and those whose are not.
pub struct Gathered {
    found: Vec<String>,
    missing: Vec<String>,
}

impl Gathered {
    /// What is missing, and how to get it.
    pub fn sentence(&self) -> String {
        let missing = self.missing.join(", ");
        match (self.found.is_empty(), self.missing.is_empty()) {
            (true, _) => format!(
                "no package of images: target/bitstream has those of no board; `cargo xtask bitstream --all` or `cargo xtask bitstream boards/NAME.toml` builds them ({missing})"
            ),
            (false, true) => format!("images of all {} boards", self.found.len()),
            (false, false) => format!(
                "images of {}; missing, because target/bitstream does not have them: {missing}",
                self.found.join(", ")
            ),
        }
    }
}

/// Copies the images, and writes their sums. Without any the folder is not made.
pub fn gather(from: &Path, to: &Path) -> Result<Gathered> {
    let (mut found, mut missing) = (Vec::new(), Vec::new());
    for file in tree::with_ending(&root().join("boards"), "toml")? {
        let in_a_folder = file.parent().is_some_and(|folder| folder != Path::new(""));
        let name = file.file_stem().context("a name")?.to_string_lossy();
        if in_a_folder || name == WITHOUT {
            continue;
        }
        let folder = from.join(&*name);
        let files = FILES.map(|end| format!("{name}{end}"));
        if !files.iter().all(|file| folder.join(file).is_file()) {
            missing.push(name.into_owned());
            continue;
        }
        let copies = to.join(&*name);
        fs::create_dir_all(&copies)?;
        let texts = format!("{name}{TEXTS}");
        let there = folder.join(&texts).is_file();
        for file in files.into_iter().chain(there.then_some(texts)) {
            fs::copy(folder.join(&file), copies.join(&file)).with_context(|| file.clone())?;
        }
        found.push(name.into_owned());
    }
    if !found.is_empty() {
        fs::write(to.join("SHA256SUMS"), sums(to)?)?;
    }
    Ok(Gathered { found, missing })
}

/// `sha256sum` of every file, by its name below the folder.
pub fn sums(folder: &Path) -> Result<String> {
    sums_of(folder, tree::files(folder)?)
}

/// `sha256sum` of the files of this image that are given out.
pub fn sums_of_image(folder: &Path, name: &str) -> Result<String> {
    sums_of(folder, FILES.map(|end| format!("{name}{end}").into()))
}

fn sums_of(folder: &Path, files: impl IntoIterator<Item = PathBuf>) -> Result<String> {
    let mut sum = Command::new("sha256sum");
    sum.current_dir(folder).args(files);
    setup::output(&mut sum).context("sha256sum failed")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::target;

    #[test]
    fn whole_folders_are_taken_and_the_others_are_named() {
        let at = target("tmp/images");
        let _ = fs::remove_dir_all(&at);
        let (from, to) = (at.join("from"), at.join("to"));
        let none = gather(&from, &to).unwrap();
        assert!(none.sentence().starts_with("no package of images"));
        assert!(!to.exists());
        for (board, ends) in [("mill6", &FILES[..]), ("plotter", &FILES[..1])] {
            fs::create_dir_all(from.join(board)).unwrap();
            for end in ends {
                fs::write(from.join(format!("{board}/{board}{end}")), board).unwrap();
            }
        }
        fs::write(from.join("mill6/mill6.elf"), "texts").unwrap();
        let some = gather(&from, &to).unwrap();
        let sums = fs::read_to_string(to.join("SHA256SUMS")).unwrap();
        fs::remove_dir_all(&at).unwrap();
        assert_eq!(some.found, ["mill6"]);
        let said = some.sentence();
        assert!(said.starts_with("images of mill6; missing"), "{said}");
        assert!(said.contains("plotter") && !said.contains("max"), "{said}");
        assert_eq!(sums.lines().count(), FILES.len() + 1);
        assert!(sums.contains("  mill6/mill6.flash\n"), "{sums}");
    }
}
