//! Builds the parts: simulated board, firmware image, driver and tools, bitstream.

use crate::{python, root, setup, step, target};
use anyhow::{Result, bail};
use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::process::Command;

/// The board the tests use.
pub const BOARD: &str = "mill6";

/// The board with jobs, and so with SDRAM, that the tests use.
pub const JOBS_BOARD: &str = "plotter";
/// The board with the most channels there can be.
pub const LARGEST_BOARD: &str = "max";

/// Where LinuxCNC looks for realtime modules; compiled into its loader.
const MODULES: &str = "/usr/lib/linuxcnc/modules";

/// The pieces every simulated run needs.
pub struct Parts {
    /// Folder with the Verilated board.
    pub soc: PathBuf,
    /// The release image.
    pub firmware: PathBuf,
}

/// Sets up and builds the board of the tests and the firmware, and beside them what `host` builds
/// of the host's programs; what is fresh is left alone.
pub fn everything(host: fn() -> Result<()>) -> Result<Parts> {
    parts(|reader| elaborate_and_verilate(BOARD, reader), host)
}

/// As [`everything`], with the image of [`IMAGE`] in place of the board.
pub fn everything_for_the_image(host: fn() -> Result<()>) -> Result<Parts> {
    parts(verilate_image, host)
}

fn parts(board: fn(&Path) -> Result<PathBuf>, host: fn() -> Result<()>) -> Result<Parts> {
    // The reader of board files comes first: cargo builds one thing at a time in a folder, and
    // LiteX waits for it. It needs nothing of what is set up.
    let reader = std::thread::scope(|scope| {
        let reader = scope.spawn(board_reader);
        setup::run(setup::Need::Everything)?;
        reader
            .join()
            .unwrap_or_else(|_| bail!("the build of the reader panicked"))
    })?;
    step::heading("build: board, firmware, driver");
    // The last crate of the host's keeps one core busy for a minute: the board is built beside it.
    std::thread::scope(|scope| {
        let host = scope.spawn(host);
        let firmware = firmware();
        let soc = board(&reader);
        host.join()
            .unwrap_or_else(|_| bail!("the build of the host panicked"))?;
        Ok(Parts {
            soc: soc?,
            firmware: firmware?,
        })
    })
}

/// The firmware image as an ELF file.
pub fn firmware() -> Result<PathBuf> {
    let mut build = Command::new("bash");
    build.arg("firmware/build.sh");
    step::run(
        "firmware",
        "build the firmware (Rust, riscv32im, no_std)",
        "1 min",
        &mut build,
    )?;
    Ok(image())
}

/// Where the firmware image is built to.
pub fn image() -> PathBuf {
    target("firmware/ferrocnc-firmware.elf")
}

/// Where a board is verilated to.
pub fn soc(board: &str) -> PathBuf {
    target(&format!("sim/{board}"))
}

/// The program that reads board files for LiteX.
fn board_reader() -> Result<PathBuf> {
    let mut build = Command::new("cargo");
    build.args(["build", "--package", "ferrocnc-config"]);
    step::run(
        "board-reader",
        "build the reader of board files (Rust)",
        "30 s",
        &mut build,
    )?;
    Ok(target("debug/ferrocnc-config"))
}

/// Elaborates a board for simulation and verilates it.
pub fn simulated_board(board: &str) -> Result<PathBuf> {
    elaborate_and_verilate(board, &board_reader()?)
}

/// The cards that have an image. The 5A-75B 6.1 has a flash of 2 MiB, where 8 channels of each kind
/// do not fit; those of the 5A-75E have 104 lines, more than the multiplexer has (decision 34).
pub const IMAGES: [&str; 3] = ["5a-75b-7.0", "5a-75b-8.0", "5a-75b-8.2"];

/// The platform of the image that the tests configure.
pub const IMAGE: &str = "5a-75b-8.0";

/// Elaborates the image of [`IMAGE`] for simulation and verilates it.
pub fn simulated_image() -> Result<PathBuf> {
    verilate_image(&board_reader()?)
}

fn verilate_image(reader: &Path) -> Result<PathBuf> {
    verilate(IMAGE, &["--platform".into(), IMAGE.into()], reader)
}

fn elaborate_and_verilate(board: &str, reader: &Path) -> Result<PathBuf> {
    verilate(board, &["--board".into(), board_file(board).into()], reader)
}

/// Elaborates what these arguments say, and verilates it under this name.
fn verilate(board: &str, what: &[OsString], reader: &Path) -> Result<PathBuf> {
    let elaborated = target(&format!("gateware/sim-{board}"));
    let mut elaborate = python::gateware("elaborate");
    elaborate
        .env("FERROCNC_CONFIG", reader)
        .args(["--target", "sim"])
        .args(what)
        .arg("--out")
        .arg(&elaborated);
    step::run(
        "elaborate",
        &format!("elaborate {board} (LiteX)"),
        "10 s",
        &mut elaborate,
    )?;
    let mut verilate = Command::new("bash");
    verilate
        .arg("sim/verilator/build.sh")
        .arg(&elaborated)
        .arg(board);
    step::run(
        "verilate",
        &format!("verilate {board}"),
        "2 min",
        &mut verilate,
    )?;
    Ok(soc(board))
}

/// The file of a board: one that users can take, or one that only the tests have.
pub fn board_file(name: &str) -> PathBuf {
    let file = format!("{name}.toml");
    let [users, tests] = ["boards", "tests/boards"].map(|folder| root().join(folder).join(&file));
    if users.exists() { users } else { tests }
}

/// `tests/boards/NAME.toml`: more inputs and outputs than a word has bits.
pub const WIDE_BOARD: &str = "wide";

/// `tests/boards/NAME.toml`: what a job needs.
pub const CORES_BOARD: &str = "jobs";

/// Verilates the cores and banks of a board without the processor, for the comparison with their
/// models.
pub fn simulated_cores(board: &str) -> Result<()> {
    let mut build = Command::new("bash");
    build.args(["sim/verilator/cores.sh", board]);
    step::run(
        "verilate-cores",
        &format!("verilate the cores of {board}"),
        "1 min",
        &mut build,
    )
}

/// What the demo needs: driver, simulator and tool. The tool's SVG and fonts are most of the host's
/// build, so it is not optimised, and what xtask has of it is not built again.
pub fn driver_simulator_and_tool() -> Result<()> {
    driver_and_simulator()?;
    let mut tool = Command::new("cargo");
    tool.args(["build", "--package", "ferrocnc", "--bin", "ferrocnc"]);
    step::run("tool", "build the tool (Rust)", "2 min", &mut tool)
}

/// The driver and the simulator's front end.
pub fn driver_and_simulator() -> Result<()> {
    let simulator = ["--package", "ferrocnc-sim", "--bin", "ferrocnc-sim"];
    let title = "build the driver and the simulator (Rust)";
    step::run("driver", title, "1 min", release_driver().args(simulator))
}

/// The driver alone, which the tests need: they build the simulator and the tool with their own
/// profile.
pub fn driver() -> Result<()> {
    let title = "build the driver (Rust)";
    step::run("driver", title, "15 s", &mut release_driver())
}

fn release_driver() -> Command {
    let mut build = Command::new("cargo");
    build.args(["build", "--release", "--no-default-features"]);
    build.args(["--package", "ferrocnc", "--lib"]);
    build
}

/// Every program of the tests that need a board, and the tool they start, in two calls of cargo:
/// both cores have work while they are built.
pub fn test_programs() -> Result<()> {
    let mut tool = Command::new("cargo");
    tool.arg("build").args(BOARD_TESTS);
    tool.args(["--package", "ferrocnc", "--bin", "ferrocnc"]);
    step::run(
        "test-tool",
        "build the tool for the tests (Rust)",
        "2 min",
        &mut tool,
    )?;
    let mut build = Command::new("cargo");
    build.args(["test", "--no-run"]).args(BOARD_TESTS);
    build.args(["--test", "*"]);
    step::run(
        "test-programs",
        "build the tests against the simulated board (Rust)",
        "3 min",
        &mut build,
    )
}

/// The program that measures exchanges. Returns where it is.
pub fn bench_exchange() -> Result<PathBuf> {
    let mut build = Command::new("cargo");
    build.arg("build").args(BOARD_TESTS);
    build.args(["--bin", "bench-exchange"]);
    step::run(
        "bench-exchange-build",
        "build the bench of the exchange (Rust)",
        "2 min",
        &mut build,
    )?;
    Ok(target("tests/bench-exchange"))
}

/// What cargo is told of them, the same in every call: for other packages at once it would find
/// other features of what they share, and build the twin and the firmware's library again.
pub const BOARD_TESTS: [&str; 6] = [
    "--profile",
    "tests",
    "--package",
    "ferrocnc-tests",
    "--package",
    "ferrocnc-sim",
];

/// The router of every board (decision 11). Returns where it is.
pub fn router() -> Result<PathBuf> {
    let mut build = Command::new("cargo");
    build.args(["build", "--release", "--package", "ferrocnc-router"]);
    step::run("router", "build the router (Rust)", "30 s", &mut build)?;
    Ok(target("release/ferrocnc-router"))
}

/// Makes `loadrt ferrocnc` find the driver just built.
pub fn install_driver() -> Result<()> {
    install_module(&target("release/libferrocnc.so"), "ferrocnc")
}

/// Makes `loadrt NAME` find a module just built.
pub fn install_module(built: &Path, name: &str) -> Result<()> {
    let module = Path::new(MODULES).join(format!("{name}.so"));
    let command = format!(
        "cp --remove-destination {} {}",
        built.display(),
        module.display()
    );
    if !Path::new(MODULES).exists() {
        bail!("{MODULES} does not exist: LinuxCNC is not installed; run `cargo xtask setup`");
    }
    if !setup::is_root() {
        if std::fs::read(&module).ok() == std::fs::read(built).ok() {
            step::note(&format!("{name}: already installed"));
            return Ok(());
        }
        bail!(
            "installing a realtime module needs root; run\n\n  sudo {command}\n\nand start this command again"
        );
    }
    let mut install = Command::new("cp");
    install.arg("--remove-destination").arg(built).arg(&module);
    let title = format!("install {name} for loadrt");
    step::run(&format!("install-{name}"), &title, "1 s", &mut install)
}
