//! `cargo xtask deb`: the Debian packages, made by cargo-deb from the tables in host/Cargo.toml and
//! sim/Cargo.toml. This module builds the programs, writes what the packages have beside them, and
//! says which images are missing.
//!
//! The same commit gives the same bytes: times are the commit's, and no path of this computer is
//! compiled in.

mod arch;
mod contents;
mod images;
mod install;
mod manual;
mod samples;
mod twin;

pub use images::{sums, sums_of_image};

use crate::{root, setup, step, target};
use anyhow::{Context, Result, bail};
use arch::Arch;
use clap::Args;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

/// For which processor.
#[derive(Args)]
pub struct Options {
    /// The processor, by Debian's name. Packages for arm64 are cross-built, and tried in an
    /// emulator.
    #[arg(long, value_enum, default_value_t = Arch::Amd64)]
    arch: Arch,
}

/// A package: the crate whose table cargo-deb reads, the variant in it, and where cargo built what
/// goes in.
struct Package {
    name: &'static str,
    krate: &'static str,
    variant: Option<&'static str>,
    built: &'static str,
}

/// The tool and the simulator are built to this folder. The realtime module has a folder of its
/// own: it is built without the tool's features, and cargo gives both libraries one name.
const TOOLS: &str = "deb/tools";
const MODULE: &str = "deb/module";

/// Where our sources are, if the programs are asked.
pub const SOURCES: &str = "/usr/src/ferrocnc";

/// All of them; the last one only if there are images.
const PACKAGES: [Package; 4] = [
    Package {
        name: "ferrocnc",
        krate: "ferrocnc",
        variant: None,
        built: TOOLS,
    },
    Package {
        name: "ferrocnc-linuxcnc",
        krate: "ferrocnc",
        variant: Some("linuxcnc"),
        built: MODULE,
    },
    Package {
        name: "ferrocnc-sim",
        krate: "ferrocnc-sim",
        variant: None,
        built: TOOLS,
    },
    Package {
        name: "ferrocnc-images",
        krate: "ferrocnc",
        variant: Some("images"),
        built: TOOLS,
    },
];

/// Builds the packages, says where they are. Those for another processor are checked, too, because
/// no level does it.
pub fn run(options: &Options) -> Result<()> {
    setup::run(setup::Need::Packages)?;
    step::heading("packages");
    let arch = options.arch;
    arch.ready()?;
    build(arch)?;
    let packages = match arch {
        Arch::Amd64 => pack(arch, "deb/packages")?,
        Arch::Arm64 => {
            let packages = pack(arch, "deb/packages-arm64")?;
            contents::check(&packages)?;
            arch::check(&packages)?;
            packages
        }
    };
    for package in packages {
        step::note(&format!("{}", package.display()));
    }
    Ok(())
}

/// Builds, packs, and checks the packages, on a machine that is set up; the packages.
pub fn check() -> Result<Vec<PathBuf>> {
    let arch = Arch::Amd64;
    build(arch)?;
    let packages = pack(arch, "deb/packages")?;
    let again = pack(arch, "deb/again")?;
    for (package, again) in packages.iter().zip(&again) {
        if fs::read(package)? != fs::read(again)? {
            let (package, again) = (package.display(), again.display());
            bail!("{package} has other bytes when it is packed again: {again}");
        }
    }
    contents::check(&packages)?;
    Ok(packages)
}

/// The same, and installs the packages in a fresh Debian; how many tests passed.
pub fn check_installed() -> Result<usize> {
    let packages = check()?;
    Ok(packages.len() + install::check(&packages)?)
}

/// The programs, and the files beside them.
fn build(arch: Arch) -> Result<()> {
    let module = ["ferrocnc", "--lib", "--no-default-features"];
    cargo(arch, MODULE, "the driver", &module)?;
    let simulator = ["ferrocnc-sim", "--bin", "ferrocnc-sim"];
    cargo(arch, TOOLS, "the simulator", &simulator)?;
    cargo(arch, TOOLS, "the tool", &["ferrocnc", "--bin", "ferrocnc"])?;
    files(arch, &target("deb/files"))
}

/// Builds a package for others' computers: without symbols, and without paths of this one.
fn cargo(arch: Arch, folder: &str, what: &str, package: &[&str]) -> Result<()> {
    let mut build = Command::new("cargo");
    build.args(["build", "--release", "--locked", "--package"]);
    build.args(package).arg("--target-dir").arg(target(folder));
    build.args(arch.target());
    arch.environment(&mut build);
    release(&mut build)?;
    let name = format!("{}-{}", folder.replace('/', "-"), arch.name());
    let title = format!("build {what} for its package, {} (Rust)", arch.name());
    step::run(&name, &title, "3 min", &mut build)
}

/// The profile of packages. cargo-deb is told, too: otherwise it would strip the programs again.
fn release(command: &mut Command) -> Result<()> {
    let ask = |option: &str| {
        let said = setup::output(Command::new("rustc").args(["--print", option]));
        said.with_context(|| format!("rustc does not say its {option}"))
    };
    let sources = Path::new(ask("sysroot")?.trim()).join("lib/rustlib/src/rust");
    let known = setup::output(Command::new("rustc").arg("-vV")).unwrap_or_default();
    let commit = known
        .lines()
        .find_map(|line| line.strip_prefix("commit-hash: "));
    // The standard library's own paths begin so, unless its sources are installed.
    let standard = format!("/rustc/{}", commit.unwrap_or("unknown"));
    let flags = [
        (root().to_owned(), SOURCES),
        (cargo_home(), "/usr/src/cargo"),
        (sources, &standard),
    ];
    let flags = flags.map(|(from, to)| format!("--remap-path-prefix={}={to}", from.display()));
    command.env("CARGO_ENCODED_RUSTFLAGS", flags.join("\x1f"));
    command.env("CARGO_PROFILE_RELEASE_DEBUG", "0");
    command.env("CARGO_PROFILE_RELEASE_STRIP", "symbols");
    Ok(())
}

/// Where cargo keeps the sources of dependencies.
fn cargo_home() -> PathBuf {
    let home = || PathBuf::from(std::env::var_os("HOME").unwrap_or_default()).join(".cargo");
    std::env::var_os("CARGO_HOME").map_or_else(home, PathBuf::from)
}

/// Writes manual pages, completions, the copyright file, the sample machines and the images'
/// folder.
fn files(arch: Arch, to: &Path) -> Result<()> {
    if to.exists() {
        fs::remove_dir_all(to)?;
    }
    let path = arch.built(TOOLS).join("ferrocnc");
    let tool = || arch.program(&path);
    for folder in ["man1", "man9", "sim", "twin", "completions"] {
        fs::create_dir_all(to.join(folder))?;
    }
    let mut pages = tool();
    pages.arg("man").arg(to.join("man1"));
    step::run(
        "deb-man",
        "write the tool's manual pages",
        "1 s",
        &mut pages,
    )?;
    for shell in ["bash", "zsh", "fish"] {
        let said = setup::output(tool().args(["completions", shell]));
        let said = said.with_context(|| format!("ferrocnc completions {shell} failed"))?;
        fs::write(to.join(format!("completions/ferrocnc.{shell}")), said)?;
    }
    fs::write(to.join("man9/ferrocnc.9"), manual::page()?)?;
    fs::write(to.join("twin/ferrocnc-twin.1"), twin::page()?)?;
    let simulator = arch.built(TOOLS).join("ferrocnc-sim");
    let said = setup::output(arch.program(&simulator).arg("--manual"));
    let said = said.context("ferrocnc-sim --manual failed")?;
    fs::write(to.join("sim/ferrocnc-sim.1"), said)?;
    fs::write(to.join("copyright"), copyright()?)?;
    samples::write(tool, &to.join("samples"))?;
    let gathered = images::gather(&target("bitstream"), &to.join("images"))?;
    step::note(&gathered.sentence());
    Ok(())
}

/// Debian's copyright file. MIT is written out, the GPL is on every Debian.
fn copyright() -> Result<String> {
    let text = fs::read_to_string(root().join("LICENSE-MIT")).context("LICENSE-MIT")?;
    let holder = text
        .lines()
        .find_map(|line| line.strip_prefix("Copyright (c) "));
    let holder = holder.context("LICENSE-MIT has no holder")?;
    let mut mit = String::new();
    for line in text.trim_end().lines() {
        let line = if line.is_empty() { "." } else { line };
        mit += &format!(" {line}\n");
    }
    Ok(format!(
        "Format: https://www.debian.org/doc/packaging-manuals/copyright-format/1.0/\n\
        Upstream-Name: FerroCNC\nSource: https://github.com/ferrocnc/ferrocnc\n\n\
        Files: *\nCopyright: {holder}\nLicense: MIT or GPL-2.0+\n\n\
        Files: host/src/bin/ferrocnc/ui/web/vendor/*\n\
        Copyright: Jason Miller (Preact), Google Inc. (htm), Leon Sorokin (uPlot)\nLicense: MIT and Apache-2.0\n\n\
        License: MIT\n{mit}\n\
        License: GPL-2.0+\n On Debian its text is /usr/share/common-licenses/GPL-2; a later version\n \
        may be taken instead.\n\n\
        License: Apache-2.0\n On Debian its text is /usr/share/common-licenses/Apache-2.0.\n"
    ))
}

/// Packs what is built, into this folder below `target`; the packages.
fn pack(arch: Arch, folder: &str) -> Result<Vec<PathBuf>> {
    let tool = setup::cargo_deb()?;
    let to = target(folder);
    if to.exists() {
        fs::remove_dir_all(&to)?;
    }
    fs::create_dir_all(&to)?;
    let time = time_of_the_commit()?;
    let images = target("deb/files/images").exists();
    let wanted = PACKAGES
        .iter()
        .filter(|package| images || package.variant != Some("images"));
    for package in wanted {
        let mut pack = Command::new(&tool);
        pack.args(["--no-build", "--locked", "--package", package.krate]);
        if let Some(variant) = package.variant {
            pack.args(["--variant", variant]);
        }
        pack.args(arch.target());
        // A folder, because of the slash.
        pack.arg("--output").arg(to.join(""));
        release(&mut pack)?;
        pack.env("CARGO_TARGET_DIR", target(package.built));
        pack.env("SOURCE_DATE_EPOCH", &time);
        let title = format!("pack {}", package.name);
        step::run(&format!("pack-{}", package.name), &title, "5 s", &mut pack)?;
    }
    let mut packed: Vec<PathBuf> = fs::read_dir(&to)?
        .map(|entry| Ok(entry?.path()))
        .collect::<Result<_>>()?;
    packed.sort();
    Ok(packed)
}

/// When the commit was made: the time of every file in a package.
pub fn time_of_the_commit() -> Result<String> {
    if let Ok(said) = std::env::var("SOURCE_DATE_EPOCH") {
        return Ok(said);
    }
    let mut log = Command::new("git");
    log.current_dir(root()).args(["log", "-1", "--format=%ct"]);
    let said = setup::output(&mut log).context(
        "git does not say the time of the commit; set SOURCE_DATE_EPOCH to the time of the packages' files, in seconds since 1970",
    )?;
    Ok(said.trim().to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_copyright_file_has_both_licences_and_no_empty_line_in_one() {
        let said = copyright().unwrap();
        assert!(said.contains("License: MIT or GPL-2.0+"), "{said}");
        let (_, mit) = said.split_once("\nLicense: MIT\n").unwrap();
        let (mit, _) = mit.split_once("\n\nLicense: GPL-2.0+\n").unwrap();
        assert!(mit.lines().all(|line| line.starts_with(' ')), "{mit}");
        assert!(mit.contains(" .\n") && mit.contains("WITHOUT WARRANTY"));
    }
}
