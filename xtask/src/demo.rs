//! The main job: an empty card gets a board file over the simulated wire; LinuxCNC cuts a program
//! through the real driver, over UDP, into the release firmware on the Verilated image; the tool
//! path is rebuilt from the STEP/DIR edges. Then the card gets another board file, without a build.

use crate::{build, python, step, target};
use anyhow::{Context, Result};
use clap::Args;
use std::ffi::OsStr;
use std::process::Command;

/// The board file that an empty card is given, and the one after it.
const FIRST: &str = "mill6";
const SECOND: &str = "75b_v8_14o11i6s6e6p";

/// What the demo can be told.
#[derive(Args)]
pub struct Options {
    /// Leave the picture alone after writing it.
    #[arg(long)]
    no_open: bool,
}

/// Sets up, builds, runs, draws.
pub fn run(options: &Options) -> Result<()> {
    println!("FerroCNC demo: LinuxCNC cuts a program through the simulated board.");
    println!("An empty card gets {FIRST} as its pins, then {SECOND}, without a build in between.");
    println!(
        "The first run installs and builds everything, about 12 minutes on two cores; later ones take 9."
    );
    let parts = build::everything_for_the_image(build::driver_simulator_and_tool)?;
    build::install_driver()?;
    let [first, second] = [FIRST, SECOND].map(build::board_file);
    let tool = target("debug/ferrocnc");

    step::heading("run: LinuxCNC, driver, UDP, firmware, gateware");
    let out = target("demo");
    std::fs::create_dir_all(&out)?;
    std::fs::create_dir_all(target("reports"))?;
    let figures = target("reports/demo.json");
    let mut demo = Command::new("python3");
    demo.arg("tests/demo/run.py")
        .args([&parts.soc, &parts.firmware, &out])
        .args([OsStr::new("--card"), first.as_ref()])
        .args([OsStr::new("--tool"), tool.as_ref()]);
    let title =
        format!("an empty card gets {FIRST}; LinuxCNC homes and runs the program in lockstep");
    step::run("demo", &title, "8 min", &mut demo)?;

    let mut report = Command::new(python::interpreter());
    report.arg("tests/demo/report.py").arg(&out);
    report.arg("--json").arg(&figures);
    let printed = step::run_quietly(
        "demo-report",
        "rebuild the path from the pin edges",
        "20 s",
        &mut report,
    )?;
    println!("\n{}\n", printed.trim_end());
    let picture = out.join("path.png");
    std::fs::metadata(&picture).with_context(|| format!("no picture at {}", picture.display()))?;

    let mut other = Command::new("python3");
    other
        .arg("tests/demo/card.py")
        .args([&parts.soc, &parts.firmware, &out, &second])
        .args([OsStr::new("--tool"), tool.as_ref()])
        .args([OsStr::new("--json"), figures.as_ref()]);
    let title = format!("the same card gets {SECOND}; its pins are checked at the pads");
    let printed = step::run_quietly("demo-card", &title, "2 min", &mut other)?;
    let told = printed.lines().filter(|line| !line.starts_with("sim:"));
    println!("\n{}", told.collect::<Vec<_>>().join("\n"));
    println!("\npicture: {}", picture.display());
    println!("figures: {}", figures.display());
    if !options.no_open && std::env::var_os("DISPLAY").is_some() {
        // A missing viewer is not an error.
        let _ = Command::new("xdg-open").arg(&picture).spawn();
    }
    Ok(())
}
