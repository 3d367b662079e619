//! For which processors there are packages: this computer's, or arm64, cross-built with Debian's
//! compiler. What is built for arm64 runs here in `qemu-aarch64`, which is no such computer: the
//! tool and the simulated board are tried so, of the module only its file is read.

use super::contents::dpkg;
use crate::simulated::Simulated;
use crate::{setup, step, target};
use anyhow::{Context, Result, bail};
use clap::ValueEnum;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

/// A processor, by Debian's name.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Arch {
    /// This computer's.
    Amd64,
    /// Cross-built; a Raspberry Pi has such a processor.
    Arm64,
}

/// Rust's name of an arm64 Linux.
const ARM64: &str = "aarch64-unknown-linux-gnu";
/// What links for it, and what runs its programs here.
const LINKER: &str = "aarch64-linux-gnu-gcc";
const QEMU: &str = "qemu-aarch64";
/// What has them, and the libraries that dpkg-shlibdeps and qemu look for.
const SETUP: &str = "sudo dpkg --add-architecture arm64 && sudo apt-get update && sudo apt-get install -y --no-install-recommends gcc-aarch64-linux-gnu libc6-dev-arm64-cross qemu-user libc6:arm64 libgcc-s1:arm64";
/// ELF's number of the processor, at byte 18 of a file.
const MACHINE: [u8; 2] = 183u16.to_le_bytes();
/// What `loadrt` looks for in a module.
const EXPORTS: [&str; 4] = [
    "rtapi_app_main",
    "rtapi_app_exit",
    "rtapi_info_type_boards",
    "rtapi_info_address_boards",
];

impl Arch {
    /// Debian's name.
    pub const fn name(self) -> &'static str {
        match self {
            Arch::Amd64 => "amd64",
            Arch::Arm64 => "arm64",
        }
    }

    /// What cargo and cargo-deb are told.
    pub const fn target(self) -> &'static [&'static str] {
        match self {
            Arch::Amd64 => &[],
            Arch::Arm64 => &["--target", ARM64],
        }
    }

    /// What they are told by the environment.
    pub fn environment(self, command: &mut Command) {
        if self == Arch::Arm64 {
            command.env("CARGO_TARGET_AARCH64_UNKNOWN_LINUX_GNU_LINKER", LINKER);
        }
    }

    /// Where cargo leaves programs below its folder.
    pub fn built(self, folder: &str) -> PathBuf {
        match self {
            Arch::Amd64 => target(folder).join("release"),
            Arch::Arm64 => target(folder).join(ARM64).join("release"),
        }
    }

    /// Starts a program that is built for it.
    pub fn program(self, path: &Path) -> Command {
        match self {
            Arch::Amd64 => Command::new(path),
            Arch::Arm64 => {
                let mut command = Command::new(QEMU);
                command.arg(path);
                command
            }
        }
    }

    /// What it takes is there, or the commands that install it are told.
    pub fn ready(self) -> Result<()> {
        if self == Arch::Amd64 {
            return Ok(());
        }
        let runs = |program| setup::output(Command::new(program).arg("--version")).is_some();
        let libraries = Path::new("/lib/aarch64-linux-gnu/libc.so.6");
        if !(runs(LINKER) && runs(QEMU) && libraries.exists()) {
            bail!(
                "the packages for arm64 need a compiler, an emulator and libraries; run\n\n  {SETUP}"
            );
        }
        let mut ask = Command::new("rustc");
        ask.args(["--print", "target-libdir"]).args(self.target());
        let library = setup::output(&mut ask).context("rustc does not say where its library is")?;
        if !Path::new(library.trim()).exists() {
            let mut add = Command::new("rustup");
            add.args(["target", "add", ARM64]);
            step::run("deb-arm64", "Rust's library for arm64", "1 min", &mut add)?;
        }
        Ok(())
    }
}

/// Checks arm64 packages, as far as this computer can.
pub fn check(packages: &[PathBuf]) -> Result<()> {
    let folder = target("deb/arm64");
    let _ = fs::remove_dir_all(&folder);
    let at = folder.display().to_string();
    for package in packages {
        let said = dpkg(&["--field"], package, &["Architecture"])?;
        if said.trim() != Arch::Arm64.name() {
            bail!("{} is for {}", package.display(), said.trim());
        }
        dpkg(&["--extract"], package, &[&at])?;
    }
    module(&folder.join("usr/lib/linuxcnc/modules/ferrocnc.so"))?;
    step::note("ferrocnc.so: for arm64, with what loadrt looks for; it was not loaded");
    let [tool, simulator] = ["ferrocnc", "ferrocnc-sim"].map(|name| {
        let path = folder.join("usr/bin").join(name);
        move || Arch::Arm64.program(&path)
    });
    for (program, name) in [(tool(), "ferrocnc "), (simulator(), "ferrocnc-sim ")] {
        let said = said(program, &["--version"])?;
        if !said.starts_with(name) {
            bail!("{name} --version says {said}");
        }
        step::note(&format!("in {QEMU}: {}", said.trim()));
    }
    let board = Simulated::start(simulator(), &["--mode", "free"])?;
    let said = said(tool(), &["describe", &format!("127.0.0.1:{}", board.port)])?;
    drop(board);
    step::note(&format!(
        "in {QEMU}: ferrocnc describes the board that ferrocnc-sim simulates, in {} lines",
        said.lines().count()
    ));
    fs::remove_dir_all(&folder).context("deb/arm64")
}

/// What a program prints; it has to succeed.
fn said(mut program: Command, arguments: &[&str]) -> Result<String> {
    program.args(arguments);
    setup::output(&mut program).with_context(|| format!("{program:?} failed"))
}

/// The module's file is for arm64 and exports what it has to.
fn module(path: &Path) -> Result<()> {
    let bytes = fs::read(path).with_context(|| path.display().to_string())?;
    if !bytes.starts_with(b"\x7fELF") || bytes.get(18..20) != Some(&MACHINE) {
        bail!("{} is no file for arm64", path.display());
    }
    let mut read = Command::new("readelf");
    read.args(["--wide", "--dyn-syms"]).arg(path);
    let table = setup::output(&mut read).context("readelf, of the package binutils")?;
    match missing(&table) {
        None => Ok(()),
        Some(name) => bail!("{} exports no {name}", path.display()),
    }
}

/// The first name that is not exported in this table of readelf.
fn missing(table: &str) -> Option<&'static str> {
    let exported = |name: &&str| {
        table.lines().any(|line| {
            let words: Vec<&str> = line.split_whitespace().collect();
            words.contains(&"GLOBAL") && !words.contains(&"UND") && words.last() == Some(name)
        })
    };
    EXPORTS.into_iter().find(|name| !exported(name))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_module_does_not_export_is_named() {
        let line = |name: &str, place: &str| {
            format!("     9: 0000000000012340    52 FUNC    GLOBAL DEFAULT  {place} {name}\n")
        };
        let table: String = EXPORTS.map(|name| line(name, "12")).concat();
        assert_eq!(missing(&table), None);
        assert_eq!(missing(""), Some("rtapi_app_main"));
        let wanted = table.replace(
            &line("rtapi_app_exit", "12"),
            &line("rtapi_app_exit", "UND"),
        );
        assert_eq!(missing(&wanted), Some("rtapi_app_exit"));
    }

    #[test]
    fn a_file_for_another_processor_is_no_module() {
        let path = target("tmp/module.so");
        fs::create_dir_all(target("tmp")).unwrap();
        for bytes in [&b"\x7fELF"[..], &[0x7f; 64]] {
            fs::write(&path, bytes).unwrap();
            let error = module(&path).unwrap_err().to_string();
            assert!(error.contains("no file for arm64"), "{error}");
        }
        fs::remove_file(&path).unwrap();
    }
}
