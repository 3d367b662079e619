//! `ferrocnc-sim`: the simulated board as a program. See `ferrocnc-sim --help`.

use std::io::Write;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::{Duration, Instant};

use anyhow::{Context, bail};
use clap::{CommandFactory, Parser, ValueEnum};
use sim::board::TraceWindow;
use sim::board_facts::BoardFacts;
use sim::faults::{Plan, Rejected};
use sim::model_board;
use sim::nor::spi::Shared;
use sim::nor::{Nor, Part};
use sim::plant::{Axis, Plant};
use sim::plug::Plug;
use sim::rig::{Rig, Setup};
use sim::server::{Device, Mode, Options, Server};
use sim::twin::Twin;
use wire::describe::Channels;

#[cfg(test)]
mod pages;

const PLANT_HELP: &str = concat!(
    "The machine that is wired to the board. Its axes and spindles replace the encoders on the motors. Such a file:\n\n",
    include_str!("../plant.example.toml")
);

const FAULT_HELP: &str = "\
Faults from the start on, as words in one argument or several. The control command `fault` takes the same words and counts
their times from that moment:

  loss=P dup=P reorder=P corrupt=P   a frame is lost, comes twice, is overtaken by the next, has a flipped bit; 0.01 or 1%
  truncate=P                         a datagram loses its end, its checksums fit the rest
  drop=N                             the next N frames are lost
  delay=TIME[..TIME]                 a frame comes later, uniformly distributed; 2s, 1.5ms, 20us
  rate=BITS                          bits per second of the wire: 10Mbit, 500kbit
  pull plug                          the cable is pulled, is plugged in again
  host-pause@TIME..TIME              the host neither sends nor receives; afterwards all frames arrive at once
  freeze                             the CPU's clock stops
  reboot power                       the board restarts; power also clears what a restart keeps (--backend model)
  off seed=N                         all faults end; the seed of the random numbers

to-board: or from-board: before a word limits it to one direction; @TIME or @TIME..TIME after it, in the board's time, says when:

  --fault 'loss=0.1% from-board:delay=1ms..3ms@2s..10s seed=7' --fault reboot@12s";

fn parse_fault(text: &str) -> Result<Plan, Rejected> {
    text.parse()
}

/// How simulated time passes.
#[derive(Clone, Copy, Debug, ValueEnum)]
enum TimeMode {
    /// One servo period of board time per exchange: cycle-exact even on a slow machine.
    Lockstep,
    /// By itself, as fast as it goes or paced.
    Free,
}

/// What stands behind the sockets.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Backend {
    /// The Verilated gateware with the release image inside: exact, some 0.9 million clocks a
    /// second.
    Rtl,
    /// The twin, firmware library on models of the cores: the same pins, faster than real time,
    /// needs no FPGA tool.
    Model,
}

/// The FerroCNC board in simulation: Verilated gateware and real firmware, or their twin in Rust;
/// real sockets.
///
///   ferrocnc-sim --soc target/sim/mill6 --firmware ELF          the gateware, clock by clock
///   ferrocnc-sim --backend model --board mill6 --mode free      the twin in real time, e.g. for LinuxCNC at 1 kHz
///   ferrocnc-sim --backend model --board mill6 --plant P.toml   in lockstep, with switches, probe and spindle
///
/// Prints one line beginning with `ready` on stdout when the board answers, then serves until
/// SIGINT, SIGTERM or the control command `quit`.
#[derive(Parser, Debug)]
#[command(version, verbatim_doc_comment)]
struct Arguments {
    /// What stands behind the sockets.
    #[arg(long, value_enum, default_value_t = Backend::Rtl)]
    backend: Backend,
    /// Directory of libferrocnc_soc.so and manifest.json (target/sim/NAME); model: of board.bin and
    /// manifest.json.
    #[arg(long, value_name = "DIR", required_if_eq("backend", "rtl"))]
    soc: Option<PathBuf>,
    /// Firmware ELF.
    #[arg(long, value_name = "ELF", required_if_eq("backend", "rtl"))]
    firmware: Option<PathBuf>,
    /// Gateware of an image, whose pins are configured on the board: its headers are wired as this
    /// board file says. Without it every line is pulled up.
    #[arg(long, value_name = "FILE.toml")]
    wired: Option<PathBuf>,
    /// Model: which board: a board file (mill.toml), or the name of one that is carried here
    /// (mill6, max, plotter) or has been elaborated.
    #[arg(long, value_name = "NAME|FILE.toml", default_value = "mill6")]
    board: String,
    /// Model: a board of so many stepgens,encoders,PWMs,inputs,outputs instead of a named one.
    #[arg(long, value_name = "N,N,N,N,N", value_parser = parse_channels)]
    channels: Option<Channels>,
    /// Model: the clock of such a board, Hz.
    #[arg(
        long,
        value_name = "HZ",
        default_value_t = 60_000_000,
        requires = "channels"
    )]
    clock: u32,
    /// Loopback address that stands for the board's UDP port 1234.
    #[arg(long, value_name = "ADDR:PORT", default_value = "127.0.0.1:1234")]
    udp: SocketAddr,
    /// Address that stands for the board's discovery port, UDP 51234. Answers go to the sender of
    /// the question only; with --interface they are broadcasts.
    #[arg(long, value_name = "ADDR:PORT")]
    discovery: Option<SocketAddr>,
    /// Model: be this network interface, e.g. one end of a veth pair in a network namespace of its
    /// own. It is given the board's hardware and IPv4 address, at start and whenever they change;
    /// discovery is answered by broadcast. Listens on every address of the namespace: use --udp
    /// 0.0.0.0:1234 --discovery 0.0.0.0:51234. Needs root there.
    #[arg(long, value_name = "NAME", requires = "discovery")]
    interface: Option<String>,
    /// The board's cable ends in this TAP interface (`ip tuntap add NAME mode tap`): Ethernet
    /// frames go to the board's own IP stack, with ARP, ping, consoles, status page, names and
    /// DHCP. In free time only, and no other socket than the control channel's is opened. Needs
    /// root in the network namespace. A Verilated board has its services if --flash holds its
    /// image.
    #[arg(long, value_name = "NAME", conflicts_with_all = ["interface", "discovery", "jobs"])]
    tap: Option<String>,
    /// Loopback address that stands for the board's console, TCP port 23.
    #[arg(long, value_name = "ADDR:PORT", default_value = "127.0.0.1:2323")]
    console: SocketAddr,
    /// Loopback address that stands for the board's port of jobs, TCP port 724: for `ferrocnc job`,
    /// on boards that execute jobs; one of --channels does if this is given.
    #[arg(long, value_name = "ADDR:PORT")]
    jobs: Option<SocketAddr>,
    /// Model: a board of --channels that has segments and no SDRAM: for `ferrocnc job serve`.
    #[arg(long, requires = "channels", conflicts_with = "jobs")]
    no_sdram: bool,
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
    /// Free: at most this many nanoseconds of board time per second of this machine; 1e9 is real
    /// time, 0 is as fast as it goes. When not given the twin keeps real time and the gateware runs
    /// as fast as it goes.
    #[arg(long, value_name = "NS")]
    pace: Option<f64>,
    /// Lockstep: silence of the host after which the board runs on by itself.
    #[arg(long, value_name = "MS", default_value_t = 3000)]
    silence_ms: u64,
    /// Lockstep: how much board time it then runs on for.
    #[arg(long, value_name = "MS", default_value_t = 2000)]
    orphan_ms: u64,
    /// The board's flash is this file, written as it changes; a killed simulator leaves the flash
    /// as a power failure would. Without the file the chip is new and erased. cargo xtask bitstream
    /// writes whole ones (NAME.flash).
    #[arg(long, value_name = "FILE")]
    flash: Option<PathBuf>,
    /// Unique id of the flash, 16 hexadecimal digits; each board needs another one.
    #[arg(long, value_name = "HEX", default_value_t = format!("{:016x}", sim::model_board::UID), value_parser = parse_uid)]
    uid: String,
    /// The factory pin is held at start: saved settings are not used.
    #[arg(long)]
    factory: bool,
    /// The board's address on its own virtual Ethernet.
    #[arg(long, value_name = "IP", default_value_t = sim::lan_segment::BOARD_IP)]
    board_ip: std::net::Ipv4Addr,
    /// Encoder counts per motor step at the pins (the plant).
    #[arg(long, value_name = "N", default_value_t = 1)]
    encoder_scale: i64,
    /// No encoders at the pins but those of --plant.
    #[arg(long)]
    no_plant: bool,
    /// What else is wired to the board: axes, switches, probes, spindles, wires. `--help` shows
    /// such a file.
    #[arg(long, value_name = "TOML", long_help = PLANT_HELP)]
    plant: Option<PathBuf>,
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
    /// Faults from the start on: loss=0.1%, to-board:delay=1ms..3ms, pull@2s..4s, reboot@3s, seed=7
    /// ... May be given more than once. The control command `fault` changes it while the board
    /// runs.
    #[arg(long, value_name = "WORDS", value_parser = parse_fault, long_help = FAULT_HELP)]
    fault: Vec<Plan>,
    /// Ping the board this often after start and print the round trips.
    #[arg(long, value_name = "N", default_value_t = 0)]
    ping: u32,
    /// Longest wait for the board's first answer, sys clocks.
    #[arg(long, value_name = "CLOCKS", default_value_t = 3_000_000)]
    boot_clocks: u64,
    /// Write the manual page to stdout, for the package, and end.
    #[arg(long, exclusive = true, hide = true)]
    manual: bool,
}

fn parse_channels(text: &str) -> Result<Channels, String> {
    let counts: Vec<u8> = text
        .split(',')
        .map(|count| count.trim().parse().map_err(|e| format!("{count:?}: {e}")))
        .collect::<Result<_, _>>()?;
    let [stepgens, encoders, pwms, inputs, outputs] = counts[..] else {
        return Err(format!("five counts, not {}", counts.len()));
    };
    if [stepgens, encoders, pwms].iter().any(|n| *n > 16) || inputs > 32 || outputs > 32 {
        return Err("at most 16,16,16,32,32".into());
    }
    Ok(Channels {
        stepgens,
        encoders,
        pwms,
        inputs,
        outputs,
    })
}

fn parse_uid(text: &str) -> Result<String, String> {
    let digits: String = text.chars().filter(|c| !"-:".contains(*c)).collect();
    match u64::from_str_radix(&digits, 16) {
        Ok(_) if digits.len() == 16 => Ok(digits),
        _ => Err("16 hexadecimal digits, as d162-0c8a-1b2c-3d4e".into()),
    }
}

impl Arguments {
    /// The board's flash.
    fn flash(&self) -> anyhow::Result<Shared> {
        let uid = u64::from_str_radix(&self.uid, 16)?;
        let part = Part::W25Q32JV;
        Ok(Shared::new(match &self.flash {
            Some(path) => Nor::in_file(path, part, uid)?,
            None => Nor::new(part, uid),
        }))
    }

    fn plant(&self) -> anyhow::Result<Plant> {
        let mut plant = match self.no_plant {
            true => Plant::default(),
            false => Plant::new((0..16).map(|n| Axis {
                counts: self.encoder_scale,
                ..Axis::direct(n)
            })),
        };
        if let Some(path) = &self.plant {
            plant.read(path)?;
        }
        Ok(plant)
    }

    /// The Verilated board, answering.
    fn gateware(&self) -> anyhow::Result<Rig> {
        let missing = "the rtl backend needs --soc and --firmware";
        let soc = self.soc.as_ref().context(missing)?;
        let firmware = self.firmware.as_ref().context(missing)?;
        let mut setup = Setup::new(soc, firmware);
        setup.board_ip = self.board_ip;
        setup.boot_clocks = self.boot_clocks;
        setup.plant = self.plant()?;
        let flash = self.flash()?;
        setup.trailer = model_board::trailer(&flash.chip());
        setup.flash = Some(flash);
        setup.factory = self.factory;
        if let Some(path) = &self.wired {
            setup.plug = Some(Plug::of(&ferrocnc_config::read_board(path)?));
        }
        setup.trace = self.trace.as_ref().map(|path| TraceWindow {
            path: path.clone(),
            from: self.trace_from,
            clocks: self.trace_cycles,
        });
        let started = Instant::now();
        let mut rig = if self.tap.is_some() {
            // It is heard on the cable when it answers.
            let mut rig = Rig::power_up(setup)?;
            rig.unplug_hosts();
            rig
        } else {
            let rig = Rig::boot(setup)?;
            eprintln!(
                "sim: the board answers after {} clocks ({:.1} s)",
                rig.clock(),
                started.elapsed().as_secs_f64()
            );
            rig
        };
        if let Some(path) = &self.edges {
            rig.record_edges(path)?;
        }
        Ok(rig)
    }

    /// The twin, switched on.
    fn twin(&self) -> anyhow::Result<Twin> {
        if self.wired.is_some() {
            bail!(
                "--wired is for the gateware of an image (--backend rtl); the model has the pins of its board file, which --board names"
            );
        }
        let facts = match (&self.channels, &self.soc) {
            (Some(channels), _) => {
                let has = self.no_sdram || self.jobs.is_some();
                BoardFacts {
                    jobs: u8::from(has) * motion::segment::AXES as u8,
                    sdram: !self.no_sdram,
                    ..BoardFacts::plain(*channels, self.clock)
                }
            }
            (None, Some(folder)) => BoardFacts::read(folder)?,
            (None, None) => BoardFacts::named(&self.board)?,
        };
        let mut twin = Twin::power_up(model_board::Setup {
            flash: self.flash()?,
            factory: self.factory,
            ..model_board::Setup::new(facts, self.plant()?)
        });
        if let Some(path) = &self.edges {
            twin.record_edges(path)?;
        }
        if self.tap.is_some() {
            twin.plug_in();
        }
        Ok(twin)
    }

    /// Serves a board until told to stop, and gives it back.
    fn serve<D: Device>(&self, mut device: D) -> anyhow::Result<D> {
        let stop = Arc::new(AtomicBool::new(false));
        for signal in [signal_hook::consts::SIGINT, signal_hook::consts::SIGTERM] {
            signal_hook::flag::register(signal, stop.clone()).context("cannot take signals")?;
        }
        for _ in 0..self.ping {
            match device.ping() {
                Some(clocks) => eprintln!("sim: ping {clocks} clocks"),
                None => eprintln!("sim: ping: no answer"),
            }
        }
        for plan in &self.fault {
            let begun = device.trouble(plan);
            begun.map_err(|why| anyhow::anyhow!("--fault {why}"))?;
        }
        let sys_hz = device.clockwork().sys_hz as f64;
        let real_time = match self.backend {
            Backend::Rtl => None,
            Backend::Model => Some(1e9),
        };
        let mode = match self.mode {
            TimeMode::Lockstep if self.tap.is_none() => Mode::Lockstep {
                period: device.clocks(Duration::from_nanos(self.period_ns)),
            },
            TimeMode::Lockstep | TimeMode::Free => Mode::Free {
                pace: self
                    .pace
                    .or(real_time)
                    .filter(|ns| *ns > 0.0)
                    .map(|ns| ns * 1e-9 * sys_hz),
            },
        };
        let options = Options {
            udp: self.udp,
            discovery: self.discovery,
            interface: self.interface.clone(),
            tap: self.tap.clone(),
            console: self.tap.is_none().then_some(self.console),
            jobs: self.jobs,
            control: self.control,
            stdin: self.stdin,
            mode,
            silence: Duration::from_millis(self.silence_ms),
            orphan_clocks: device.clocks(Duration::from_millis(self.orphan_ms)),
            alone: None,
            report: self.report.clone(),
        };
        let server = Server::bind(device, options, stop).context("cannot listen")?;
        println!("{}", server.ready_line());
        std::io::stdout().flush()?;
        let mut device = server.run();
        let report = device.report();
        eprintln!(
            "sim: {} clocks at {:.0} kcycle/s, {:.2} times real time",
            report.clocks, report.kcycles_per_second, report.times_real_time
        );
        if let Some(path) = &self.report {
            report.write(path)?;
            eprintln!("sim: report in {}", path.display());
        }
        Ok(device)
    }
}

fn main() -> anyhow::Result<()> {
    let arguments = Arguments::parse();
    if arguments.manual {
        let page = clap_mangen::Man::new(Arguments::command());
        return Ok(page.render(&mut std::io::stdout())?);
    }
    let steps = match arguments.backend {
        Backend::Rtl => arguments.serve(arguments.gateware()?)?.finish()?,
        Backend::Model => arguments.serve(arguments.twin()?)?.finish()?,
    };
    if let Some(path) = &arguments.edges {
        eprintln!("sim: {steps} steps in {}", path.display());
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_model_has_no_headers_to_wire() {
        let arguments =
            Arguments::parse_from(["ferrocnc-sim", "--backend", "model", "--wired", "mill.toml"]);
        let why = arguments.twin().err().unwrap().to_string();
        assert!(why.contains("--board"), "{why}");
    }
}
