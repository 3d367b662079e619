//! The sample machines of the package `ferrocnc-linuxcnc`: a folder for each, which the tool writes
//! and LinuxCNC's picker lists, because it looks below `/usr/share/linuxcnc/aux_examples`.

use crate::{root, setup, tree};
use anyhow::{Context, Result, bail};
use std::fs;
use std::path::Path;
use std::process::Command;

/// What a folder has, with `NAME` for the machine's name.
const FILES: [&str; 13] = [
    // Shown by the picker while the folder is chosen, and while an INI file is.
    "README",
    "NAME.txt",
    "NAME-twin.txt",
    "NAME.ini",
    "NAME-twin.ini",
    "NAME.toml",
    "NAME-wiring.md",
    "NAME.svg",
    "machine.toml",
    "ferrocnc.hal",
    "custom.hal",
    "custom_postgui.hal",
    "twin.hal",
];

/// HAL files that are LinuxCNC's own: it looks for them in its library.
const LINUXCNCS: [&str; 1] = ["qtplasmac_comp.hal"];

/// Keys of an INI file that name a file beside it.
const NAMES: [&str; 3] = ["HALFILE", "POSTGUI_HALFILE", "TOOL_TABLE"];

/// Jobs for the plotter without LinuxCNC, from here.
const JOBS: &str = "host/examples/plotter";

/// Every machine that `ferrocnc machine new --from` knows.
fn names() -> Result<Vec<String>> {
    let files = tree::with_ending(&root().join("machine/templates"), "toml")?;
    let name = |file: &std::path::PathBuf| Some(file.file_stem()?.to_str()?.to_owned());
    files
        .iter()
        .map(|file| name(file).context("a name"))
        .collect()
}

/// The picker copies a folder to `~/linuxcnc/configs` under this name.
fn folder(name: &str) -> String {
    format!("ferrocnc-{name}")
}

/// Writes all of them with the tool.
pub fn write(tool: impl Fn() -> Command, to: &Path) -> Result<()> {
    for name in names()? {
        let at = to.join(folder(&name));
        fs::create_dir_all(&at)?;
        for arguments in [
            &["machine", "new", "--from", &name][..],
            &["machine", "write", "--twin", "--yes"],
        ] {
            let mut run = tool();
            run.args(arguments).current_dir(&at);
            setup::output(&mut run).with_context(|| format!("{arguments:?} failed for {name}"))?;
        }
        fs::copy(at.join(format!("{name}.txt")), at.join("README"))?;
        if name == "plotter" {
            let jobs = root().join(JOBS);
            fs::create_dir_all(at.join("jobs"))?;
            for file in tree::files(&jobs)? {
                fs::copy(jobs.join(&file), at.join("jobs").join(&file))?;
            }
        }
    }
    Ok(())
}

/// Checks that each is whole below this folder: its files, and those that its INI files name.
pub fn check(examples: &Path) -> Result<()> {
    for name in names()? {
        let at = examples.join(folder(&name));
        for file in FILES {
            let file = at.join(file.replace("NAME", &name));
            if fs::read(&file).is_ok_and(|bytes| bytes.is_empty()) || !file.is_file() {
                bail!("the sample {name} has no {}", file.display());
            }
        }
        for ini in [format!("{name}.ini"), format!("{name}-twin.ini")] {
            let text = fs::read_to_string(at.join(&ini))?;
            for file in named(&text) {
                if !LINUXCNCS.contains(&file) && !at.join(file).is_file() {
                    bail!("{ini} of the sample {name} names {file}, which is not there");
                }
            }
        }
    }
    Ok(())
}

/// The files that an INI file names.
fn named(ini: &str) -> Vec<&str> {
    let lines = ini.lines().filter_map(|line| line.split_once(" = "));
    let files = lines.filter(|(key, _)| NAMES.contains(key));
    files.map(|(_, file)| file).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::target;

    #[test]
    fn a_sample_that_is_not_whole_is_named() {
        let at = target("tmp/samples");
        let _ = fs::remove_dir_all(&at);
        for name in names().unwrap() {
            let folder = at.join(folder(&name));
            fs::create_dir_all(&folder).unwrap();
            for file in FILES {
                let text = "[HAL]\nHALFILE = twin.hal\nHALFILE = qtplasmac_comp.hal\n";
                fs::write(folder.join(file.replace("NAME", &name)), text).unwrap();
            }
        }
        let said = || check(&at).map_err(|error| format!("{error:#}"));
        assert_eq!(said(), Ok(()));
        let ini = at.join("ferrocnc-lathe/lathe-twin.ini");
        fs::write(ini, "[EMCIO]\nTOOL_TABLE = tool.tbl\n").unwrap();
        let wanted = "lathe-twin.ini of the sample lathe names tool.tbl, which is not there";
        assert_eq!(said(), Err(wanted.to_owned()));
        fs::write(at.join("ferrocnc-lathe/lathe.svg"), "").unwrap();
        assert!(
            said().unwrap_err().contains("lathe has no"),
            "an empty drawing"
        );
        fs::remove_dir_all(&at).unwrap();
    }
}
