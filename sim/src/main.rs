//! `ferrocnc-sim`: the simulated board as a program. See `ferrocnc-sim --help`.

use std::io::Write;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::{Duration, Instant};

use anyhow::Context;
use clap::{Parser, ValueEnum};
use sim::board::TraceWindow;
use sim::rig::{Rig, Setup};
use sim::server::{Mode, Options, Server};

/// How simulated time passes.
#[derive(Clone, Copy, Debug, ValueEnum)]
enum TimeMode {
    /// One servo period of board time per exchange: cycle-exact however slow this machine is.
    Lockstep,
    /// By itself, as fast as it goes or paced.
    Free,
}

/// The FerroCNC board in simulation: Verilated gateware, real firmware, real sockets.
///
/// Prints one line beginning with `ready` on stdout when the board answers, then serves until SIGINT, SIGTERM or the control
/// command `quit`.
#[derive(Parser, Debug)]
#[command(version)]
struct Arguments {
    /// Directory of libferrocnc_soc.so and manifest.json (target/sim/NAME).
    #[arg(long, value_name = "DIR")]
    soc: PathBuf,
    /// Firmware ELF.
    #[arg(long, value_name = "ELF")]
    firmware: PathBuf,
    /// Loopback address that stands for the board's UDP port 1234.
    #[arg(long, value_name = "ADDR:PORT", default_value = "127.0.0.1:1234")]
    udp: SocketAddr,
    /// Loopback address that stands for the board's console, TCP port 23.
    #[arg(long, value_name = "ADDR:PORT", default_value = "127.0.0.1:2323")]
    console: SocketAddr,
    /// Take control commands, one per line, on this TCP address (`help` lists them).
    #[arg(long, value_name = "ADDR:PORT")]
    control: Option<SocketAddr>,
    /// Take control commands from stdin too.
    #[arg(long)]
    stdin: bool,
    /// How simulated time passes.
    #[arg(long, value_enum, default_value_t = TimeMode::Lockstep)]
    mode: TimeMode,
    /// Lockstep: the servo period in nanoseconds.
    #[arg(long, value_name = "NS", default_value_t = 1_000_000)]
    period_ns: u64,
    /// Free: at most this many nanoseconds of board time per second of this machine (1e9 is real time).
    #[arg(long, value_name = "NS")]
    pace: Option<f64>,
    /// Lockstep: silence of the host after which the board runs on by itself.
    #[arg(long, value_name = "MS", default_value_t = 3000)]
    silence_ms: u64,
    /// Lockstep: how much board time it then runs on for.
    #[arg(long, value_name = "MS", default_value_t = 2000)]
    orphan_ms: u64,
    /// The board's address on its own virtual Ethernet.
    #[arg(long, value_name = "IP", default_value_t = sim::segment::BOARD_IP)]
    board_ip: std::net::Ipv4Addr,
    /// Encoder counts per motor step at the pins (the plant).
    #[arg(long, value_name = "N", default_value_t = 1)]
    encoder_scale: i64,
    /// No encoders at the pins.
    #[arg(long)]
    no_plant: bool,
    /// Write the report here at the end.
    #[arg(long, value_name = "JSON")]
    report: Option<PathBuf>,
    /// Stream every step at the pins into this file.
    #[arg(long, value_name = "FILE")]
    edges: Option<PathBuf>,
    /// Write waveforms (needs the library built with --trace).
    #[arg(long, value_name = "FILE")]
    trace: Option<PathBuf>,
    /// First sys clock of the waveforms.
    #[arg(long, value_name = "CLOCK", default_value_t = 0)]
    trace_from: u64,
    /// Sys clocks of waveforms.
    #[arg(long, value_name = "CLOCKS", default_value_t = 200_000)]
    trace_cycles: u64,
    /// Ping the board this often after start and print the round trips.
    #[arg(long, value_name = "N", default_value_t = 0)]
    ping: u32,
    /// Longest wait for the board's first answer, sys clocks.
    #[arg(long, value_name = "CLOCKS", default_value_t = 3_000_000)]
    boot_clocks: u64,
}

fn main() -> anyhow::Result<()> {
    let arguments = Arguments::parse();
    let stop = Arc::new(AtomicBool::new(false));
    for signal in [signal_hook::consts::SIGINT, signal_hook::consts::SIGTERM] {
        signal_hook::flag::register(signal, stop.clone()).context("cannot take signals")?;
    }

    let mut setup = Setup::new(&arguments.soc, &arguments.firmware);
    setup.board_ip = arguments.board_ip;
    setup.boot_clocks = arguments.boot_clocks;
    setup.plant = match arguments.no_plant {
        true => sim::plant::Plant::default(),
        false => sim::plant::Plant::new((0..16).map(|n| sim::plant::Axis {
            counts: arguments.encoder_scale,
            ..sim::plant::Axis::direct(n)
        })),
    };
    setup.trace = arguments.trace.map(|path| TraceWindow {
        path,
        from: arguments.trace_from,
        clocks: arguments.trace_cycles,
    });
    let started = Instant::now();
    let mut rig = Rig::boot(setup)?;
    eprintln!(
        "sim: the board answers after {} clocks ({:.1} s)",
        rig.clock(),
        started.elapsed().as_secs_f64()
    );
    for _ in 0..arguments.ping {
        match rig.ping() {
            Some(clocks) => eprintln!("sim: ping {clocks} clocks"),
            None => eprintln!("sim: ping: no answer"),
        }
    }
    if let Some(path) = &arguments.edges {
        rig.record_edges(path)?;
    }

    let sys_hz = rig.board.clockwork().sys_hz;
    let mode = match arguments.mode {
        TimeMode::Lockstep => Mode::Lockstep {
            period: rig.clocks(Duration::from_nanos(arguments.period_ns)),
        },
        TimeMode::Free => Mode::Free {
            pace: arguments.pace.map(|ns| ns * 1e-9 * sys_hz as f64),
        },
    };
    let options = Options {
        udp: arguments.udp,
        console: Some(arguments.console),
        control: arguments.control,
        stdin: arguments.stdin,
        mode,
        silence: Duration::from_millis(arguments.silence_ms),
        orphan_clocks: rig.clocks(Duration::from_millis(arguments.orphan_ms)),
        report: arguments.report.clone(),
    };
    let server = Server::bind(rig, options, stop).context("cannot listen")?;
    println!("{}", server.ready_line());
    std::io::stdout().flush()?;
    let mut rig = server.run();

    let report = rig.report();
    let steps = rig.finish()?;
    if let Some(path) = &arguments.edges {
        eprintln!("sim: {steps} steps in {}", path.display());
    }
    eprintln!(
        "sim: {} clocks at {:.0} kcycle/s",
        report.clocks, report.kcycles_per_second
    );
    if let Some(path) = &arguments.report {
        report.write(path)?;
        eprintln!("sim: report in {}", path.display());
    }
    Ok(())
}
