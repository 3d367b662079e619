//! `ferrocnc config`: writes, checks, shows and draws board files, imports those of other
//! projects, and gives them to boards whose pins are configured. Only `diff`, `apply` and `read`
//! need a board.

mod check;
mod diff;
mod drawing;
mod pins;

pub(crate) use check::check_text;
pub(crate) use diff::differences;
pub(crate) use drawing::{pinout_of, pinout_to_json};
pub(crate) use pins::{Wanted as Applied, kept};

use crate::consent;
use crate::hal_file::{self, Rewritten};
use crate::text::say;
use anyhow::{Result, anyhow, bail};
use clap::{Args, Subcommand, ValueEnum};
use ferrocnc_config::board::Platforms;
use ferrocnc_config::import::{Imported, lcnc, litexcnc};
use ferrocnc_config::new::{Wanted, layout};
use ferrocnc_config::peers;
use ferrocnc_config::source::{Folder, read_text};
use ferrocnc_config::{Board, Platform, export, first_light, read_board, schema, show, write};
use serde::Deserialize;
use serde_json::{Value, json};
use std::path::{Path, PathBuf};

#[derive(Subcommand)]
pub(crate) enum ConfigCommand {
    /// Write a configuration to begin with.
    New(New),
    /// Read configurations and platforms and say what is wrong with them.
    Check {
        /// Board files; files in a folder `platforms` are platforms.
        #[arg(value_name = "BOARD.toml", required = true)]
        files: Vec<PathBuf>,
    },
    /// Show a configuration: every channel, its HAL name, its pins and balls.
    Show {
        /// A board file.
        #[arg(value_name = "BOARD.toml")]
        file: PathBuf,
        /// As a board file, in the order and form we would write it.
        #[arg(long)]
        toml: bool,
    },
    /// What a board's image has other than a configuration: channels, their names and pins.
    Diff {
        /// A board file.
        #[arg(value_name = "BOARD.toml")]
        file: PathBuf,
        /// IP[:port] of the board.
        #[arg(value_name = "BOARD")]
        address: String,
    },
    /// Give a board whose pins are configured this board file: checked, stored beside the one in
    /// force, and in force after the restart that ends the command.
    Apply(pins::Apply),
    /// The board file that a board's pins follow, as it was applied.
    Read(pins::Read),
    /// Draw the headers with what is on every pin: in the terminal, or as SVG to print and solder
    /// by.
    Pinout {
        /// A board file, or the name of a platform.
        #[arg(value_name = "BOARD.toml|PLATFORM")]
        what: PathBuf,
        /// Write SVG to this file.
        #[arg(long, short, value_name = "FILE.svg")]
        output: Option<PathBuf>,
        /// Colour in the terminal.
        #[arg(long, value_enum, default_value_t = When::Auto)]
        color: When,
    },
    /// Import a configuration of another project.
    Import {
        /// The other project.
        #[arg(value_enum)]
        from: From,
        /// Lcnc's conf.ini or LiteX-CNC's JSON.
        #[arg(value_name = "FILE")]
        file: PathBuf,
        /// What to call it; the file's name if not given.
        #[arg(long)]
        name: Option<String>,
        /// The file, or the folder, to write to; the current folder if not given.
        #[arg(long, short, value_name = "BOARD.toml")]
        output: Option<PathBuf>,
        /// LiteX-CNC's HAL file: write FILE-ferrocnc.hal beside it, with our loadrt line, if every
        /// name of the board in it exists.
        #[arg(long, value_name = "FILE.hal")]
        hal: Option<PathBuf>,
        /// Overwrite what is there.
        #[arg(long)]
        force: bool,
    },
    /// Write a board file as a configuration of another project, if that can say all of it.
    Export {
        /// The other project.
        #[arg(value_enum)]
        to: From,
        /// A board file.
        #[arg(value_name = "BOARD.toml")]
        file: PathBuf,
        /// The file to write; NAME.ini or NAME.json in the current folder if not given.
        #[arg(long, short, value_name = "FILE")]
        output: Option<PathBuf>,
        /// Overwrite it.
        #[arg(long)]
        force: bool,
    },
    /// Write a HAL file for the first look at a board: it loads the driver, arms nothing, and says
    /// what to type to see every channel work.
    FirstLight {
        /// A board file.
        #[arg(value_name = "BOARD.toml")]
        file: PathBuf,
        /// The board's address, as `boards=` of the driver has it; the board file's if not given.
        #[arg(long, value_name = "ADDRESS")]
        at: Option<String>,
        /// The file to write; NAME-first-light.hal in the current folder if not given.
        #[arg(long, short, value_name = "FILE.hal")]
        output: Option<PathBuf>,
        /// Overwrite it.
        #[arg(long)]
        force: bool,
    },
    /// The JSON schema of board files, for editors.
    Schema {
        /// Of platform files instead.
        #[arg(long)]
        platform: bool,
    },
}

#[derive(Args, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct New {
    /// The configuration's name; the file becomes NAME.toml.
    pub(crate) name: String,
    /// The PCB; without it the command lists the known ones.
    #[arg(long, default_value = "")]
    platform: String,
    /// Step generators.
    #[arg(long, default_value_t = 3)]
    stepgens: usize,
    /// Encoders.
    #[arg(long, default_value_t = 0)]
    encoders: usize,
    /// PWMs.
    #[arg(long, default_value_t = 1)]
    pwms: usize,
    /// Inputs.
    #[arg(long, default_value_t = 0)]
    inputs: usize,
    /// Outputs.
    #[arg(long, default_value_t = 4)]
    outputs: usize,
    /// Headers with bus switches in place of their buffers: encoders and inputs go there.
    #[arg(long, value_delimiter = ',', value_name = "j5,j6..")]
    modified: Vec<String>,
    /// The file, or the folder, to write to; the current folder if not given.
    #[arg(long, short, value_name = "BOARD.toml")]
    #[serde(skip)]
    output: Option<PathBuf>,
    /// Overwrite it.
    #[arg(long)]
    #[serde(skip)]
    force: bool,
}

#[derive(Clone, Copy, ValueEnum)]
pub(crate) enum When {
    Auto,
    Always,
    Never,
}

#[derive(Clone, Copy, ValueEnum, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(crate) enum From {
    Lcnc,
    Litexcnc,
}

pub(crate) fn run(command: &ConfigCommand, as_json: bool) -> Result<()> {
    match command {
        ConfigCommand::New(new) => self::new(new),
        ConfigCommand::Check { files } => check::check(files, as_json),
        ConfigCommand::Show { file, toml } => {
            let board = read_board(file)?;
            let text = match (as_json, toml) {
                (true, _) => format!("{:#}\n", export::export(&board)?),
                (false, true) => write::to_toml(&board, &[]),
                (false, false) => show::show(&board),
            };
            say(&text)
        }
        ConfigCommand::Diff { file, address } => diff::diff(file, address, as_json),
        ConfigCommand::Apply(arguments) => pins::apply(arguments, as_json),
        ConfigCommand::Read(arguments) => pins::read(arguments, as_json),
        ConfigCommand::Pinout {
            what,
            output,
            color,
        } => drawing::draw(what, output.as_deref(), *color, as_json),
        ConfigCommand::Import {
            from,
            file,
            name,
            output,
            hal,
            force,
        } => {
            let to = target(
                name.as_deref().unwrap_or(&stem(file)),
                output.as_deref(),
                *force,
            )?;
            import(*from, file, &to, hal.as_deref(), *force)
        }
        ConfigCommand::Export {
            to,
            file,
            output,
            force,
        } => export_to(*to, file, output.as_deref(), *force),
        ConfigCommand::FirstLight {
            file,
            at,
            output,
            force,
        } => {
            let board = read_board(file)?;
            let to = output
                .clone()
                .unwrap_or_else(|| first_light::file_name(&board).into());
            consent::may_write(&to, *force)?;
            save(&to, &first_light::first_light(&board, at.as_deref()))
        }
        ConfigCommand::Schema { platform } => {
            let schema = if *platform {
                schema::platform()
            } else {
                schema::board()
            };
            say(&format!("{schema:#}\n"))
        }
    }
}

fn new(new: &New) -> Result<()> {
    let file = target(&new.name, new.output.as_deref(), new.force)?;
    save(&file, &new.toml(&file)?)
}

impl New {
    /// The text of the configuration, as this file has it.
    pub(crate) fn toml(&self, file: &Path) -> Result<String> {
        let folder = Folder::beside(file);
        let Some((platform_file, text)) = folder.text(&self.platform) else {
            bail!("--platform is one of {}", folder.names().join(", "));
        };
        let platform = Platform::read(&platform_file, &self.platform, &text)?;
        let wanted = Wanted {
            counts: [
                self.stepgens,
                self.encoders,
                self.pwms,
                self.inputs,
                self.outputs,
            ],
            modified: self.modified.clone(),
        };
        let board = layout(&stem(file), platform, &wanted)?;
        let notes = [
            format!(
                "{}: the use of every pin of a {}. `ferrocnc config pinout` draws it.",
                board.name, board.platform.title
            ),
            "ext_reset: closing the KEY terminal to ground stops the machine. A machine with an emergency-stop chain wires a normally closed contact to ground and says \"high\", so that a broken wire stops it.".to_owned(),
        ];
        let toml = write::to_toml(&board, &notes);
        // The reader must accept what we write. If it does not, the numbers asked for are too
        // large, and its error names them.
        Board::read(&file.display().to_string(), &board.name, &toml, &folder)?;
        Ok(toml)
    }
}

/// The platforms of this folder, else the built-in ones.
pub(crate) fn platforms(folder: &Folder) -> Result<Vec<Platform>> {
    let names = folder.names().into_iter();
    let read = names.filter_map(|name| {
        let (file, text) = folder.text(&name)?;
        Some(Platform::read(&file, &name, &text).map_err(Into::into))
    });
    read.collect()
}

/// Those that a board file here could name, as JSON: in a checkout its own.
pub(crate) fn platforms_to_json() -> Result<Value> {
    let known = platforms(&Folder::beside(Path::new("")))?;
    let facts = known
        .iter()
        .map(|it| json!({ "name": it.name, "title": it.title, "device": it.device }));
    Ok(Value::Array(facts.collect()))
}

fn import(from: From, file: &Path, to: &Path, hal: Option<&Path>, force: bool) -> Result<()> {
    let text = read_text(file)?;
    let shown = file.display().to_string();
    if let (From::Lcnc, Some(_)) = (from, hal) {
        bail!(
            "--hal is for litexcnc; of a HAL file for Lcnc change the one line yourself: loadrt ferrocnc boards=IP names=lcnc"
        );
    }
    let imported = imported(from, &shown, &text, &stem(to), to)?;
    // Before anything is written: its names may not exist.
    let rewritten = hal.map(|hal| rewrite(hal, &imported, force)).transpose()?;
    let Imported {
        board, toml, notes, ..
    } = imported;
    save(to, &toml)?;
    say(&format!("  {}\n", check::counts(&board)))?;
    for note in notes {
        say(&format!("  note: {note}\n"))?;
    }
    if let Some((file, rewritten)) = rewritten {
        let (line, old, new) = rewritten.changed;
        save(&file, &rewritten.text)?;
        say(&format!("  {line} - {old}\n  {line} + {new}\n"))?;
        say(&format!(
            "  all {} names of the board in it exist\n",
            rewritten.names
        ))?;
        for note in rewritten.notes {
            say(&format!("  note: {note}\n"))?;
        }
    }
    Ok(())
}

/// Reads a file of another project as the board file `name`, which is to be written to `to`.
pub(crate) fn imported(
    from: From,
    shown: &str,
    text: &str,
    name: &str,
    to: &Path,
) -> Result<Imported> {
    let folder = Folder::beside(to);
    let imported = match from {
        From::Lcnc => lcnc(shown, text, name, &folder)?,
        From::Litexcnc => litexcnc(shown, text, name, &folder)?,
    };
    ferrocnc_config::blob::blob(&imported.board)?;
    Ok(imported)
}

/// A HAL file for the imported board, and where to write it.
fn rewrite(file: &Path, imported: &Imported, force: bool) -> Result<(PathBuf, Rewritten)> {
    let to = file.with_file_name(format!("{}-ferrocnc.hal", stem(file)));
    consent::may_write(&to, force)?;
    let shown = file.display().to_string();
    let text = read_text(file)?;
    let rewritten = hal_file::rewrite(&shown, &text, &imported.board, &imported.prefix)?;
    Ok((to, rewritten))
}

fn export_to(to: From, file: &Path, output: Option<&Path>, force: bool) -> Result<()> {
    let board = read_board(file)?;
    let (theirs, ending, written) = match to {
        From::Lcnc => ("Lcnc", "ini", peers::lcnc(&board)),
        From::Litexcnc => ("LiteX-CNC", "json", peers::litexcnc(&board)),
    };
    let written = written.map_err(|refusals| {
        let lines: String = refusals.iter().map(|one| format!("{one}\n")).collect();
        anyhow!("{lines}nothing was written: {theirs} cannot say this board")
    })?;
    let name = format!("{}.{ending}", board.name);
    let to = output.map_or_else(|| PathBuf::from(name), Path::to_owned);
    consent::may_write(&to, force)?;
    save(&to, &written.text)?;
    for note in written.notes {
        say(&format!("  note: {note}\n"))?;
    }
    Ok(())
}

/// Where to write a configuration of this name.
pub(crate) fn target(name: &str, output: Option<&Path>, force: bool) -> Result<PathBuf> {
    let file = match output {
        Some(folder) if folder.is_dir() => folder.join(format!("{name}.toml")),
        Some(file) => file.to_owned(),
        None => unsaved(name),
    };
    may_be_board(&file)?;
    consent::may_write(&file, force)?;
    Ok(file)
}

/// Refuses another ending than a board file's.
fn may_be_board(file: &Path) -> Result<()> {
    if file.extension().is_none_or(|ending| ending != "toml") {
        bail!("{}: a board file ends in .toml", file.display());
    }
    Ok(())
}

/// How a board file that is only on a page is called, in the folder where the tool runs.
fn unsaved(name: &str) -> PathBuf {
    PathBuf::from(format!("{name}.toml"))
}

pub(crate) fn stem(path: &Path) -> String {
    path.file_stem()
        .map_or(String::new(), |stem| stem.to_string_lossy().into_owned())
}

fn save(file: &Path, text: &str) -> Result<()> {
    std::fs::write(file, text)
        .map_err(|e| anyhow!("{}: cannot be written ({e})", file.display()))?;
    say(&format!("{}: written\n", file.display()))
}
