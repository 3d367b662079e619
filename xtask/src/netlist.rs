//! Simulates the netlist of the smallest board, as yosys and nextpnr made it, beside its RTL
//! (docs/netlist.md).

use crate::{bitstream, build, cargo_tests, python, setup, step, target};
use anyhow::Result;
use clap::Args;
use std::process::Command;

/// What the netlist's test can be told.
#[derive(Args)]
pub struct Options {
    /// How often the comparison runs, each time with other random contents and frames.
    #[arg(long, default_value_t = 1)]
    seeds: u32,
    /// The first seed; one from the clock if not said.
    #[arg(long)]
    seed: Option<u64>,
}

/// Builds the bitstream if it is not there, then [`compare`].
pub fn run(options: &Options) -> Result<()> {
    setup::run(setup::Need::Gateware)?;
    setup::riscv_core()?;
    step::heading("netlist");
    bitstream::smallest()?;
    let count = compare(options.seeds, options.seed)?;
    println!("\n  {count} tests passed; target/logs/test-netlist.log has the figures");
    Ok(())
}

/// The routed netlist of the smallest board against its RTL; the bitstream has been built. Says how
/// many tests passed.
pub fn compare(seeds: u32, seed: Option<u64>) -> Result<usize> {
    let name = bitstream::SMALLEST;
    build::simulated_board(name)?;
    let folder = target(&format!("gateware/gates-{name}"));
    let mut write = python::gateware("gates");
    write
        .arg("--board")
        .arg(build::board_file(name))
        .arg("--built")
        .arg(bitstream::folder(name))
        .arg("--out")
        .arg(&folder);
    step::run(
        "gates",
        &format!("the routed netlist of {name} as Verilog"),
        "5 s",
        &mut write,
    )?;
    let gates = format!("{name}-gates");
    let mut verilate = Command::new("bash");
    verilate
        .arg("sim/verilator/build.sh")
        .arg(&folder)
        .arg(&gates);
    step::run(
        "verilate-gates",
        "verilate the netlist",
        "1 min",
        &mut verilate,
    )?;
    let mut more = vec![
        ("FERROCNC_SOC", build::soc(name).display().to_string()),
        ("FERROCNC_GATES", build::soc(&gates).display().to_string()),
        ("FERROCNC_NETLIST_SEEDS", seeds.to_string()),
    ];
    more.extend(seed.map(|seed| ("FERROCNC_SEED", seed.to_string())));
    against_rtl(&more)
}

/// The routed netlist beside the RTL, told where both are.
fn against_rtl(more: &[(&str, String)]) -> Result<usize> {
    let mut cargo = cargo_tests::of_boards();
    cargo.args(["--test", "netlist", "--", "--nocapture"]);
    cargo.envs(more.iter().map(|(name, value)| (name, value)));
    let title = "what nextpnr made beside the RTL, clock by clock";
    cargo_tests::run("test-netlist", title, "20 s", &mut cargo)
}
