//! `ferrocnc completions` and `ferrocnc man`: what a package installs beside the tool, made of the
//! commands as they are.

use super::Arguments;
use anyhow::{Context, Result, bail};
use clap::{Args, CommandFactory};
use clap_complete::Shell;
use std::fs;
use std::io::{self, Write};
use std::path::PathBuf;

/// Writes the completions of a shell to the standard output.
#[derive(Args)]
pub struct Completions {
    /// The shell.
    #[arg(value_name = "SHELL")]
    shell: Shell,
}

/// Writes the manual pages: `ferrocnc.1` and one of each command.
#[derive(Args)]
pub struct Manual {
    /// The folder they are written to. It must exist.
    #[arg(value_name = "FOLDER")]
    folder: PathBuf,
}

/// `ferrocnc completions SHELL`.
pub fn completions(arguments: &Completions) -> Result<()> {
    let mut text = Vec::new();
    clap_complete::generate(
        arguments.shell,
        &mut Arguments::command(),
        "ferrocnc",
        &mut text,
    );
    io::stdout().write_all(&text)?;
    Ok(())
}

/// `ferrocnc man FOLDER`.
pub fn manual(arguments: &Manual) -> Result<()> {
    let folder = &arguments.folder;
    if !folder.is_dir() {
        bail!("{} is not a folder; create it first", folder.display());
    }
    let mut command = Arguments::command();
    command.build();
    page(&command, "ferrocnc", folder)
}

/// The page of a command, and those of its subcommands: `ferrocnc-job-send.1`.
fn page(command: &clap::Command, name: &str, folder: &std::path::Path) -> Result<()> {
    let path = folder.join(format!("{name}.1"));
    let mut text = Vec::new();
    clap_mangen::Man::new(command.clone().display_name(name))
        .title(name)
        .render(&mut text)?;
    fs::write(&path, text).with_context(|| format!("cannot write {}", path.display()))?;
    for inner in command.get_subcommands() {
        if inner.get_name() != "help" && !inner.is_hide_set() {
            page(inner, &format!("{name}-{}", inner.get_name()), folder)?;
        }
    }
    Ok(())
}
