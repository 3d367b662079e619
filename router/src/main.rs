//! `ferrocnc-router`: routes a placed netlist and writes it back.

use anyhow::{Context, Result};
use clap::Parser;
use router::netlist::Netlist;
use router::route::Router;
use std::path::PathBuf;
use std::process::ExitCode;

/// Routes what nextpnr has placed, for nextpnr to look over and pack.
#[derive(Parser)]
struct Args {
    /// nextpnr's chip database.
    #[arg(long)]
    chip: PathBuf,
    /// The netlist as nextpnr has placed it.
    #[arg(long)]
    placed: PathBuf,
    /// The same with routes.
    #[arg(long)]
    routed: PathBuf,
    /// Where to write the target frequencies as constraints for nextpnr: a netlist does not keep
    /// them.
    #[arg(long)]
    constraints: Option<PathBuf>,
    /// CLOCK=MHZ: target frequency of the clock nets with CLOCK in their names. The first match
    /// counts; "" matches all.
    #[arg(long = "clock", value_parser = clock)]
    clocks: Vec<(String, f32)>,
    /// Per cent the clocks should have to spare.
    #[arg(long, default_value_t = 9.0)]
    slack: f32,
    /// Per cent that will do.
    #[arg(long, default_value_t = 6.0)]
    enough: f32,
    /// Give up after this many rounds.
    #[arg(long, default_value_t = 100)]
    rounds: u32,
}

fn clock(text: &str) -> Result<(String, f32), String> {
    let (name, mhz) = text.split_once('=').ok_or("wants CLOCK=MHZ")?;
    let mhz: f32 = mhz
        .parse()
        .map_err(|_| format!("{mhz} is not a number of MHz"))?;
    if mhz > 0.0 {
        Ok((name.to_owned(), mhz))
    } else {
        Err(format!("{mhz} MHz is no clock"))
    }
}

fn main() -> ExitCode {
    match run(&Args::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error:#}");
            ExitCode::FAILURE
        }
    }
}

fn run(args: &Args) -> Result<()> {
    let read = |path: &PathBuf| {
        std::fs::read(path).with_context(|| format!("cannot read {}", path.display()))
    };
    let netlist = Netlist::parse(&String::from_utf8(read(&args.placed)?)?)
        .with_context(|| format!("{} is no netlist of nextpnr's", args.placed.display()))?;
    let clocks = netlist.clocks()?;
    let wanted = |clock: &String| {
        args.clocks
            .iter()
            .find(|(name, _)| clock.contains(name))
            .map_or(1.0, |(_, mhz)| *mhz)
    };
    let with = |slack: f32| -> Vec<f32> {
        clocks
            .iter()
            .map(|clock| 1e6 / wanted(clock) / (1.0 + slack / 100.0))
            .collect()
    };
    if let Some(path) = &args.constraints {
        let lines: Vec<String> = clocks
            .iter()
            .map(|clock| format!("FREQUENCY NET \"{clock}\" {} MHz;\n", wanted(clock)))
            .collect();
        std::fs::write(path, lines.concat())
            .with_context(|| format!("cannot write {}", path.display()))?;
    }
    let (chip, nets) = netlist.nets(read(&args.chip)?, &clocks)?;
    println!(
        "{} nets, {} pins, {} wires",
        nets.len(),
        nets.iter().map(|n| n.sinks.len()).sum::<usize>(),
        chip.wires.len()
    );
    let mut router = Router::new(&chip, &nets, with(args.slack));
    let done = router.run(args.rounds, &with(args.enough), |round| {
        let speed: Vec<String> = clocks
            .iter()
            .zip(&round.longest)
            .map(|(clock, ps)| format!("{clock} {:.1} MHz", 1e6 / ps))
            .collect();
        println!(
            "round {}: {} nets routed, {} wires, {} shared; {}",
            round.number,
            round.nets,
            round.used,
            round.shared,
            speed.join(", ")
        );
    });
    if done.is_err() {
        let (names, blocks) = router.crowds();
        println!("shared: {names:?}");
        blocks.iter().for_each(|row| println!("{row:?}"));
    }
    done?;
    let routes = router.routes()?;
    std::fs::write(&args.routed, netlist.routed(routes)?)
        .with_context(|| format!("cannot write {}", args.routed.display()))
}
