//! `ferrocnc`: the tool for boards on the command line. A command that only reads takes no session
//! and changes nothing, so it works while LinuxCNC drives the board. The board then refuses a
//! command that changes something (`set`, `update`, `flash`) or needs it at rest (`selftest`).
// `describe --json` is one object with many keys.
#![recursion_limit = "256"]

mod card;
mod config;
mod consent;
mod console;
mod describe;
mod discover;
mod doctor;
mod findings;
mod flash;
mod hal_file;
mod images;
mod install_module;
mod job;
mod key;
mod log;
mod machine;
mod manual;
mod net;
#[cfg(test)]
mod pages;
mod panel;
mod progress;
mod selftest;
mod set;
mod soak;
mod text;
mod tryout;
mod ui;
mod update;
mod watch;
mod words;

use anyhow::{Context, Result};
use clap::{Parser, Subcommand};
use ferrocnc::address::{self, Address};
use ferrocnc::client::Client;
use ferrocnc::keys::Keys;
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::OnceLock;

/// Find, look at, set up and update FerroCNC boards.
#[derive(Parser)]
#[command(name = "ferrocnc", version)]
struct Arguments {
    /// Answer in JSON.
    #[arg(long, global = true)]
    json: bool,
    /// The board's key is in this file, not in ~/.config/ferrocnc/keys/UID.key.
    #[arg(long, global = true, value_name = "FILE")]
    key: Option<PathBuf>,
    #[command(subcommand)]
    command: ToolCommand,
}

#[derive(Subcommand)]
enum ToolCommand {
    /// Board files: write, check, show, draw and import them, and give one to a board.
    #[command(subcommand)]
    Config(config::ConfigCommand),
    /// A machine for LinuxCNC: its board file, HAL file and INI file of one machine.toml. No board
    /// is needed.
    #[command(subcommand)]
    Machine(machine::MachineCommand),
    /// Jobs: make them of drawings and G-code, draw and check them; send them to a board that
    /// executes them by itself.
    #[command(subcommand)]
    Job(job::JobToolCommand),
    /// FPGA G's words: STATUS, START, STOP and GCODE, from a file or from the keyboard, with the
    /// bits of the status by name.
    Words(words::WordsArguments),
    /// What the board is: versions, channels and their names, clock, state.
    Describe {
        /// IP[:port] of the board.
        #[arg(value_name = "ADDR")]
        address: String,
    },
    /// What it is doing: state, positions, inputs, counters. No session is taken.
    Watch {
        /// IP[:port] of the board.
        #[arg(value_name = "ADDR")]
        address: String,
        /// Show it once and end.
        #[arg(long)]
        once: bool,
        /// Milliseconds between two looks.
        #[arg(long, default_value_t = 200, value_name = "MS")]
        interval: u64,
    },
    /// The firmware's log.
    Log {
        /// IP[:port] of the board.
        #[arg(value_name = "ADDR")]
        address: String,
        #[command(flatten)]
        texts: log::Texts,
        /// Keep showing what is added.
        #[arg(long, short)]
        follow: bool,
    },
    /// Every board on the segment, at any address.
    Discover(discover::Discover),
    /// Address, name, MAC and port of a board. It restarts with them.
    Set(set::Set),
    /// Is this board all right? Looks at memory, flash, link and clock; with --outputs and --loop
    /// at pins and jumpers, too.
    Selftest(selftest::Selftest),
    /// One output, axis or encoder at a time, by hand, in a terminal; inputs as they are. Nothing
    /// is driven before the key `a`.
    Test(tryout::TestArguments),
    /// What of this computer makes exchanges late or loses them: kernel, processors, network port,
    /// addresses. It only reads, and needs no root, but for --fix and --undo.
    Doctor(doctor::Doctor),
    /// Pages in a browser: boards, a dashboard, a configurator for board files, the doctor. They
    /// show what the commands answer, from a server on this computer alone.
    Ui(ui::Ui),
    /// An Ethernet port of this computer, given to the board so that it lasts, and taken back.
    #[command(subcommand)]
    Net(net::NetCommand),
    /// A panel for LinuxCNC's screen that says what is wrong with a board and what to do about it.
    Panel(panel::Panel),
    /// A new bitstream over the network: written, verified, selected for the next power-up.
    Update(update::Update),
    /// The LinuxCNC driver, put where `loadrt ferrocnc` finds it: in LinuxCNC as installed, or in a
    /// run-in-place build.
    InstallModule(install_module::InstallModule),
    /// Flash by JTAG: once in a board's life, then it is updated over the network.
    Flash {
        #[command(subcommand)]
        what: flash::Flash,
    },
    /// Which card is this? Of its print, and of what its FPGA says by JTAG.
    #[command(subcommand)]
    Card(card::CardCommand),
    /// A board's pre-shared key: only computers with the key can take, configure or flash the
    /// board.
    #[command(subcommand)]
    Key(key::KeyCommand),
    /// The board's debug console.
    Console {
        /// IP[:port] of the console; the port is telnet's if not given.
        #[arg(value_name = "ADDR")]
        address: String,
        /// Run one command and end.
        #[arg(short, long, value_name = "COMMAND")]
        command: Option<String>,
    },
    /// Completions of the commands for a shell: `ferrocnc completions bash > FILE`.
    Completions(manual::Completions),
    /// The manual pages of the commands, written to a folder.
    Man(manual::Manual),
}

fn main() -> ExitCode {
    match run(&Arguments::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        // The reader of our output has closed the pipe, which is not an error.
        Err(error) if is_broken_pipe(&error) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("ferrocnc: {error:#}");
            ExitCode::FAILURE
        }
    }
}

fn run(arguments: &Arguments) -> Result<()> {
    let json = arguments.json;
    // Set once, used by every command that opens a board.
    let _ = KEY.set(Keys::named(arguments.key.as_deref()));
    match &arguments.command {
        ToolCommand::Config(command) => config::run(command, json),
        ToolCommand::Machine(command) => machine::run(command, json),
        ToolCommand::Job(command) => job::run(command, json),
        ToolCommand::Words(arguments) => words::run(arguments, json),
        ToolCommand::Describe { address } => describe::run(&mut open(address)?, json),
        ToolCommand::Watch {
            address,
            once,
            interval,
        } => watch::run(&mut open(address)?, *once, *interval, json),
        ToolCommand::Log {
            address,
            texts,
            follow,
        } => log::run(&mut open(address)?, texts, *follow, json),
        ToolCommand::Discover(arguments) => discover::run(arguments, json),
        ToolCommand::Set(arguments) => set::run(arguments, json),
        ToolCommand::Selftest(arguments) => selftest::run(arguments, json),
        ToolCommand::Test(arguments) => tryout::run(arguments, json),
        ToolCommand::Doctor(arguments) => doctor::run(arguments, json),
        ToolCommand::Ui(arguments) => ui::run(arguments, json),
        ToolCommand::Net(command) => net::run(command, json),
        ToolCommand::Panel(arguments) => panel::run(arguments, json),
        ToolCommand::Update(arguments) => update::run(arguments, json),
        ToolCommand::InstallModule(arguments) => install_module::run(arguments, json),
        ToolCommand::Card(command) => card::run(command, json),
        ToolCommand::Flash { what } => flash::run(what, json),
        ToolCommand::Key(command) => key::run(command, json),
        ToolCommand::Console { address, command } => {
            let address = parse(address, wire::CONSOLE_PORT)?;
            console::run(&address, command.as_deref(), json)
        }
        ToolCommand::Completions(arguments) => manual::completions(arguments),
        ToolCommand::Man(arguments) => manual::manual(arguments),
    }
}

fn parse(text: &str, port: u16) -> Result<Address> {
    Ok(address::parse(text, port)?)
}

fn open(text: &str) -> Result<Client> {
    let address = parse(text, wire::DEFAULT_PORT)?;
    let client = Client::open(&address).context("no socket")?;
    Ok(client.with_keys(keys()))
}

static KEY: OnceLock<Keys> = OnceLock::new();

/// Where boards' keys are.
pub(crate) fn keys() -> Keys {
    KEY.get().cloned().unwrap_or_default()
}

fn is_broken_pipe(error: &anyhow::Error) -> bool {
    error
        .downcast_ref::<std::io::Error>()
        .is_some_and(|error| error.kind() == std::io::ErrorKind::BrokenPipe)
}
