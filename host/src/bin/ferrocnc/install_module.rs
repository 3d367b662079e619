//! `ferrocnc install-module`: puts the realtime module where `loadrt ferrocnc` finds it, in
//! LinuxCNC as installed or in a run-in-place build. The package `ferrocnc-linuxcnc` does the first
//! by itself.

use anyhow::{Context, Result, bail};
use clap::Args;
use ferrocnc::doctor::system::{Rights, System};
use serde_json::json;
use std::fs;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

/// Where LinuxCNC as installed looks for modules.
const INSTALLED: &str = "/usr/lib/linuxcnc/modules";

/// What `loadrt` calls in a module, and nothing else has.
const ENTRY: &[u8] = b"rtapi_app_main";

#[derive(Args)]
pub(crate) struct InstallModule {
    /// The folder of a run-in-place build of LinuxCNC, the one with bin, rtlib and src.
    #[arg(long, value_name = "DIR")]
    rip: Option<PathBuf>,
    /// The module; if not given, libferrocnc.so beside this program, or the installed package's.
    #[arg(long, value_name = "FILE")]
    from: Option<PathBuf>,
}

pub(crate) fn run(arguments: &InstallModule, as_json: bool) -> Result<()> {
    let to = folder(arguments.rip.as_deref())?.join("ferrocnc.so");
    let from = source(arguments.from.as_deref())?;
    let module = fs::read(&from).with_context(|| format!("cannot read {}", from.display()))?;
    let is_module =
        module.starts_with(b"\x7fELF") && module.windows(ENTRY.len()).any(|bytes| bytes == ENTRY);
    if !is_module {
        bail!("{} is no realtime module", from.display());
    }
    let there = fs::read(&to).is_ok_and(|found| found == module);
    if !there {
        write(&module, &to)?;
    }
    // LinuxCNC's package gives its own rtapi_app the rights; `ferrocnc doctor` looks at them.
    let rights = arguments.rip.as_deref().map(has_rights);
    if as_json {
        println!(
            "{}",
            json!({ "module": to, "from": from, "new": !there, "realtime_rights": rights })
        );
        return Ok(());
    }
    match there {
        true => println!("{} is the module already", to.display()),
        false => println!(
            "{} is the module now, from {}",
            to.display(),
            from.display()
        ),
    }
    if rights == Some(false) {
        println!(
            "rtapi_app there has no rights to run in real time; in its folder src: sudo make setuid"
        );
    }
    Ok(())
}

/// Where modules are.
fn folder(rip: Option<&Path>) -> Result<PathBuf> {
    let Some(rip) = rip else {
        let folder = PathBuf::from(INSTALLED);
        if !folder.is_dir() {
            bail!(
                "LinuxCNC is not installed ({INSTALLED} is missing); --rip names a run-in-place build"
            );
        }
        return Ok(folder);
    };
    let folder = rip.join("rtlib");
    if !(folder.is_dir() && rip.join("bin/rtapi_app").is_file()) {
        bail!(
            "{} is no run-in-place build of LinuxCNC: it needs rtlib and bin/rtapi_app, which `make` in its folder src makes",
            rip.display()
        );
    }
    Ok(folder)
}

/// The module to install.
fn source(named: Option<&Path>) -> Result<PathBuf> {
    if let Some(file) = named {
        return Ok(file.to_owned());
    }
    let program = std::env::current_exe().context("where is this program?")?;
    let places = [
        program.with_file_name("libferrocnc.so"),
        Path::new(INSTALLED).join("ferrocnc.so"),
    ];
    let found = places.iter().find(|file| file.is_file());
    found.cloned().context(
        "no module beside this program, and the package ferrocnc-linuxcnc is not installed; --from names one",
    )
}

/// A LinuxCNC that runs keeps the module it has loaded: the file is replaced, not written over.
fn write(module: &[u8], to: &Path) -> Result<()> {
    let part = to.with_extension("part");
    let written = fs::write(&part, module).and_then(|()| fs::rename(&part, to));
    if let Err(error) = written {
        let _ = fs::remove_file(&part);
        match error.kind() {
            ErrorKind::PermissionDenied => bail!(
                "no permission to write {}; give the command with sudo",
                to.display()
            ),
            _ => return Err(error).with_context(|| format!("cannot write {}", to.display())),
        }
    }
    Ok(())
}

/// Whether a build's rtapi_app may run in real time: as root's, or by capabilities.
fn has_rights(rip: &Path) -> bool {
    let system = System {
        root: rip.to_owned(),
        ..System::real()
    };
    system.rights("bin/rtapi_app") != Rights::User
}
