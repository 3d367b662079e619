//! `cargo xtask`: sets up a fresh machine, builds the parts in their order, runs the demo and the
//! tests. It starts other tools and prints their results.

mod bench;
mod bitstream;
mod build;
mod cargo_tests;
mod cost;
mod counts;
mod deb;
mod demo;
mod docs;
mod faults;
mod figures;
mod fuzz;
mod lint;
mod mutants;
mod netlist;
mod passes;
mod pictures;
mod python;
mod regen;
mod release;
mod setup;
mod simulated;
mod slowest;
mod step;
mod test;
mod tree;

use clap::{Parser, Subcommand};
use std::path::{Path, PathBuf};

/// Build, test and measure FerroCNC: one command per task.
#[derive(Parser)]
#[command(name = "cargo xtask", version)]
struct Cli {
    #[command(subcommand)]
    task: Task,
}

#[derive(Subcommand)]
enum Task {
    /// Install what the rest needs and say what was found. Safe to repeat.
    Setup,
    /// LinuxCNC cuts a program through real firmware on real gateware; ends with a picture.
    Demo(demo::Options),
    /// Run the tests: all levels, or those named.
    Test(test::Options),
    /// Write the generated files again from the register map; --check only compares.
    Regen {
        /// Change nothing; fail if a committed file is stale.
        #[arg(long)]
        check: bool,
    },
    /// Build the bitstreams of a board configuration, of all, or of a card. A clock that misses its
    /// constraint fails.
    Bitstream(bitstream::Options),
    /// Build the image of every card that can have one, and say their SHA-256 sums.
    Images(bitstream::Search),
    /// Simulate what nextpnr made of the smallest board beside its RTL: the same pins in every
    /// clock.
    Netlist(netlist::Options),
    /// Make the Debian packages: tool, LinuxCNC driver, simulator, and the images that are built.
    Deb(deb::Options),
    /// Make a release: packages, images, bills of materials, notes and sums in one folder.
    Release(release::Options),
    /// Measure something and print the figures.
    Bench(bench::Options),
    /// Build the documentation site into target/book, after a check of all links.
    Docs,
    /// Take the pictures of the tool's pages in docs/ui.md anew.
    Pictures,
    /// Write docs/figures.md and the marked places of other pages from docs/figures.json.
    Figures(figures::Options),
    /// Count the lines of each crate, circles of modules, what is too long and clippy's warnings,
    /// now and before the tree was put in order.
    Counts(counts::Options),
    /// Feed what comes from outside with random inputs: 60 s per target, or as long as said.
    Fuzz(fuzz::Options),
    /// Mutation tests: change the code in one place at a time, and list each change that no test
    /// notices. All areas take hours; `--list` names them.
    Mutants(mutants::Options),
    /// Check format, clippy, Python, SystemVerilog and licences; change nothing.
    Lint,
    /// What the gate runs: the same as `test`.
    Ci,
}

fn main() -> std::process::ExitCode {
    let cli = Cli::parse();
    let done = match cli.task {
        Task::Setup => setup::run(setup::Need::Everything),
        Task::Demo(options) => demo::run(&options),
        Task::Test(options) => test::run(&options),
        Task::Regen { check } => regen::run(check),
        Task::Bitstream(options) => bitstream::run(&options),
        Task::Images(search) => bitstream::images_of_all_cards(&search),
        Task::Netlist(options) => netlist::run(&options),
        Task::Deb(options) => deb::run(&options),
        Task::Release(options) => release::run(&options),
        Task::Bench(options) => bench::run(&options),
        Task::Docs => docs::run(),
        Task::Pictures => pictures::run(),
        Task::Figures(options) => figures::run(&options),
        Task::Counts(options) => counts::run(&options),
        Task::Fuzz(options) => fuzz::run(&options),
        Task::Lint => lint::run(),
        Task::Mutants(options) => mutants::run(&options),
        Task::Ci => test::run(&test::Options::default()),
    };
    match done {
        Ok(()) => std::process::ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("\nxtask: {error:#}");
            std::process::ExitCode::FAILURE
        }
    }
}

/// The root of the checkout.
pub fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .parent()
        .expect("xtask lies in the workspace")
}

/// A path below `target`.
pub fn target(relative: &str) -> PathBuf {
    root().join("target").join(relative)
}
