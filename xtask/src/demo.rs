//! The main job: LinuxCNC cuts a program through the real driver, over UDP, into the release
//! firmware on the Verilated gateware; then the tool path is rebuilt from the STEP/DIR edges.

use crate::{build, python, step, target};
use anyhow::{Context, Result};
use clap::Args;
use std::process::Command;

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
    println!(
        "The first run installs and builds everything, about 6 minutes on two cores; later ones take 4."
    );
    let parts = build::everything(build::driver_and_simulator)?;
    build::install_driver()?;

    step::heading("run: LinuxCNC, driver, UDP, firmware, gateware");
    let out = target("demo");
    std::fs::create_dir_all(&out)?;
    std::fs::create_dir_all(target("reports"))?;
    let mut demo = Command::new("python3");
    demo.arg("tests/demo/run.py")
        .arg(&parts.soc)
        .arg(&parts.firmware)
        .arg(&out);
    step::run(
        "demo",
        "LinuxCNC homes and runs the program in lockstep",
        "3 min",
        &mut demo,
    )?;

    let mut report = Command::new(python::interpreter());
    report
        .arg("tests/demo/report.py")
        .arg(&out)
        .arg("--json")
        .arg(target("reports/demo.json"));
    let printed = step::run_quietly(
        "demo-report",
        "rebuild the path from the pin edges",
        "20 s",
        &mut report,
    )?;
    println!("\n{}", printed.trim_end());
    let picture = out.join("path.png");
    std::fs::metadata(&picture).with_context(|| format!("no picture at {}", picture.display()))?;
    println!("\npicture: {}", picture.display());
    println!("figures: {}", target("reports/demo.json").display());
    if !options.no_open && std::env::var_os("DISPLAY").is_some() {
        // A missing viewer is not an error.
        let _ = Command::new("xdg-open").arg(&picture).spawn();
    }
    Ok(())
}
