//! The source of the files: a folder, or the built-in copies.

use crate::board::{Board, Platforms};
use crate::error::{Error, Report};
use std::path::{Path, PathBuf};

/// The platforms of `boards/platforms`, so that the tool needs no checkout.
pub const BUILT_IN: &[(&str, &str)] = &[
    (
        "5a-75b-6.1",
        include_str!("../../boards/platforms/5a-75b-6.1.toml"),
    ),
    (
        "5a-75b-7.0",
        include_str!("../../boards/platforms/5a-75b-7.0.toml"),
    ),
    (
        "5a-75b-8.0",
        include_str!("../../boards/platforms/5a-75b-8.0.toml"),
    ),
    (
        "5a-75b-8.2",
        include_str!("../../boards/platforms/5a-75b-8.2.toml"),
    ),
    (
        "5a-75e-6.0",
        include_str!("../../boards/platforms/5a-75e-6.0.toml"),
    ),
    (
        "5a-75e-7.1",
        include_str!("../../boards/platforms/5a-75e-7.1.toml"),
    ),
    (
        "5a-75e-8.2",
        include_str!("../../boards/platforms/5a-75e-8.2.toml"),
    ),
];

/// A folder of platform files; the built-in ones are used for names that it does not have.
#[derive(Clone, Debug, Default)]
pub struct Folder(pub Option<PathBuf>);

impl Folder {
    /// The `platforms` beside a board file.
    pub fn beside(board: &Path) -> Self {
        let folder = board.parent().unwrap_or(Path::new("")).join("platforms");
        Folder(folder.is_dir().then_some(folder))
    }
}

impl Platforms for Folder {
    fn text(&self, name: &str) -> Option<(String, String)> {
        // A name, not a path.
        if name.contains(['/', '\\']) || name.starts_with('.') {
            return None;
        }
        let file = self
            .0
            .as_ref()
            .map(|folder| folder.join(format!("{name}.toml")));
        if let Some(file) = file.filter(|file| file.is_file()) {
            return Some((
                file.display().to_string(),
                std::fs::read_to_string(&file).ok()?,
            ));
        }
        let (_, text) = BUILT_IN.iter().find(|(known, _)| *known == name)?;
        Some((format!("{name}.toml"), (*text).to_owned()))
    }

    fn names(&self) -> Vec<String> {
        let mut names: Vec<String> = BUILT_IN
            .iter()
            .map(|(name, _)| (*name).to_owned())
            .collect();
        let files = self
            .0
            .iter()
            .filter_map(|folder| std::fs::read_dir(folder).ok())
            .flatten()
            .flatten();
        let own = files
            .map(|file| file.path())
            .filter(|path| path.extension().is_some_and(|ending| ending == "toml"));
        names.extend(own.filter_map(|path| Some(path.file_stem()?.to_str()?.to_owned())));
        names.sort();
        names.dedup();
        names
    }
}

/// Reads a file's text.
pub fn read_text(path: &Path) -> Result<String, Error> {
    let error = |problem: String, remedy: &str| {
        Error::from(Report {
            file: path.display().to_string(),
            place: None,
            key: String::new(),
            value: String::new(),
            problem,
            remedy: remedy.to_owned(),
        })
    };
    let bytes = std::fs::read(path).map_err(|e| {
        error(
            format!("cannot be read ({e})"),
            "board files live in boards/",
        )
    })?;
    String::from_utf8(bytes).map_err(|_| error("is not UTF-8".to_owned(), "save it as UTF-8"))
}

/// Reads a board file and its platform.
pub fn read_board(path: &Path) -> Result<Board, Error> {
    read_board_text(path, &read_text(path)?)
}

/// Reads a configuration whose file has, or is to have, this text.
pub fn read_board_text(path: &Path, text: &str) -> Result<Board, Error> {
    let stem = path
        .file_stem()
        .and_then(|stem| stem.to_str())
        .unwrap_or_default();
    Board::read(
        &path.display().to_string(),
        stem,
        text,
        &Folder::beside(path),
    )
}
