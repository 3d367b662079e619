//! Lists the files of the tree, for all code that checks, copies or writes them, and brings back
//! those of a commit.

use crate::root;
use anyhow::{Context, Result, bail};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// Folders that hold nothing of ours.
const SKIPPED: [&str; 4] = ["target", ".git", "__pycache__", "node_modules"];

/// Every file below a folder, relative to it, in the order of their names.
pub fn files(folder: &Path) -> Result<Vec<PathBuf>> {
    let mut found = Vec::new();
    let mut folders = vec![folder.to_owned()];
    while let Some(open) = folders.pop() {
        for entry in fs::read_dir(&open).with_context(|| open.display().to_string())? {
            let path = entry?.path();
            // `.git` is a file in a second work tree.
            if SKIPPED.iter().any(|name| path.ends_with(name)) {
                continue;
            }
            match path.is_dir() {
                true => folders.push(path),
                false => found.push(path.strip_prefix(folder)?.to_owned()),
            }
        }
    }
    found.sort();
    Ok(found)
}

/// Those of them with this ending; that there is none is an error.
pub fn with_ending(folder: &Path, ending: &str) -> Result<Vec<PathBuf>> {
    let mut files = files(folder)?;
    files.retain(|file| file.extension().is_some_and(|known| known == ending));
    if files.is_empty() {
        bail!("there is no .{ending} file below {}", folder.display());
    }
    Ok(files)
}

/// The files of a commit, in a folder of their own.
pub fn check_out(commit: &str, folder: &Path) -> Result<()> {
    if folder.exists() {
        fs::remove_dir_all(folder)?;
    }
    fs::create_dir_all(folder)?;
    let mut archive = Command::new("git")
        .args(["archive", commit])
        .current_dir(root())
        .stdout(Stdio::piped())
        .spawn()
        .context("git")?;
    let files = archive.stdout.take().context("git's output")?;
    let unpacked = Command::new("tar")
        .arg("-xC")
        .arg(folder)
        .stdin(files)
        .status()?;
    if !archive.wait()?.success() || !unpacked.success() {
        bail!("there is no commit {commit} here; a shallow clone does not have it");
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_walk_finds_what_is_ours_in_order() {
        let root = crate::target("tmp/tree");
        for file in ["b.md", "a/c.md", "a/d.rs", "a/target/e.md", ".git"] {
            let file = root.join(file);
            fs::create_dir_all(file.parent().unwrap()).unwrap();
            fs::write(file, "").unwrap();
        }
        let (all, pages) = (files(&root), with_ending(&root, "md"));
        fs::remove_dir_all(&root).unwrap();
        assert_eq!(
            all.unwrap(),
            ["a/c.md", "a/d.rs", "b.md"].map(PathBuf::from)
        );
        assert_eq!(pages.unwrap(), ["a/c.md", "b.md"].map(PathBuf::from));
    }
}
