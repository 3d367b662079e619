//! Serves a simulated board at real sockets: UDP and a TCP console on loopback, two ways of passing
//! time, a control channel.
//!
//! ```text
//! lockstep   host    |cmd|......computes......|cmd|......computes......|cmd|
//!            board   |== one servo period ==|   |== one servo period ==|
//!                        `-> reply leaves at once, while the rest of the period is still being simulated
//! ```
//!
//! *Lockstep*: simulated time stands still until the host sends an exchange, then advances by
//! exactly one servo period. So LinuxCNC sees a board with a perfect clock, even on a slow machine.
//! Other datagrams advance time until their answer is out. Only what the host reads between two
//! exchanges is behind the second one on the wire, where a real host would have sent it: at the end
//! of a period it would stand in the way of the exchange. A host's first exchange comes a period
//! behind what it asked before. A host that falls silent in the middle of a session must count as
//! dead: after [`Options::silence`] of the machine's time the board runs on by itself for
//! [`Options::orphan_clocks`].
//!
//! *Free*: time runs as fast as it can, or paced. It may wait for a host that has to be in time, on
//! a computer that is not: [`Options::alone`].
//!
//! The only inspection of a datagram is whether it is an exchange, or reads.

mod cable;
mod device;
mod lockstep;

use std::collections::HashMap;
use std::io::{BufRead, BufReader, ErrorKind, Read, Write};
use std::net::{Ipv4Addr, SocketAddr, TcpListener, TcpStream, UdpSocket};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, TryRecvError, channel};
use std::time::{Duration, Instant};

use crate::exchange::Spread;
use crate::faults::{Direction, Plan, WORDS};
use crate::lan_segment::{CONSOLE_PORT, Nat};

use self::cable::Cable;
pub use device::{Addresses, Device, Reply, Service};

/// How simulated time passes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Mode {
    /// One servo period per exchange.
    Lockstep {
        /// The servo period in sys clocks.
        period: u64,
    },
    /// By itself; at most `pace` sys clocks per second of the machine's time.
    Free {
        /// `None` is as fast as it goes.
        pace: Option<f64>,
    },
}

/// Where to listen and how to behave.
#[derive(Clone, Debug)]
pub struct Options {
    /// Loopback address that stands for the board's Etherbone port.
    pub udp: SocketAddr,
    /// Address that stands for the board's discovery port.
    pub discovery: Option<SocketAddr>,
    /// A network interface that is the board's: it is given the board's hardware and IPv4 address
    /// whenever they change, the Etherbone port follows the board's, and discovery is answered by
    /// broadcast. Needs root and a network namespace of its own.
    pub interface: Option<String>,
    /// A TAP interface that the board's cable ends in. Then no socket stands for a port of the
    /// board, and time runs by itself: [`Mode::Free`].
    pub tap: Option<String>,
    /// Loopback address that stands for the board's console port.
    pub console: Option<SocketAddr>,
    /// Loopback address that stands for the board's port of jobs.
    pub jobs: Option<SocketAddr>,
    /// Loopback address that takes control commands, a line each.
    pub control: Option<SocketAddr>,
    /// Take control commands from stdin too.
    pub stdin: bool,
    /// Time.
    pub mode: Mode,
    /// Lockstep: silence of the host, in the machine's time, after which the board runs on by
    /// itself.
    pub silence: Duration,
    /// Lockstep: how far it then runs, sys clocks. Enough for every watchdog and soft stop; not so
    /// much that a forgotten simulator keeps a core busy for ever.
    pub orphan_clocks: u64,
    /// Free: how far the board runs on behind the host's last datagram, sys clocks; then its time
    /// stands still until the next one. The control command `wait-for-host` sets another.
    pub alone: Option<u64>,
    /// Where `stats` and the end of the run write the report.
    pub report: Option<PathBuf>,
}

/// An event from outside.
enum Event {
    Datagram(Service, SocketAddr, Vec<u8>),
    Opened(u64, u16, TcpStream),
    Typed(u64, Vec<u8>),
    Closed(u64),
    Command(String, Option<TcpStream>),
}

struct Console<C> {
    stream: TcpStream,
    connection: C,
    waiting: Vec<u8>,
    ended: bool,
}

/// A board being served.
pub struct Server<D: Device> {
    rig: D,
    options: Options,
    udp: Option<Ear>,
    cable: Option<Cable>,
    discovery: Option<Ear>,
    dhcp: Option<Ear>,
    /// What [`Options::interface`] was told last.
    known: Option<Addresses>,
    sender: Sender<Event>,
    console_address: Option<SocketAddr>,
    jobs_address: Option<SocketAddr>,
    control_address: Option<SocketAddr>,
    events: Receiver<Event>,
    nat: Nat<SocketAddr>,
    consoles: HashMap<u64, Console<D::Console>>,
    stop: Arc<AtomicBool>,
    quit: bool,
    /// Sys clock at which the present servo period ends.
    period_end: u64,
    /// When the host last made an exchange, and whether the silence since has been acted on.
    last_exchange: Option<Instant>,
    /// Lockstep: which host made it.
    exchanger: Option<SocketAddr>,
    /// Lockstep: what such a host has asked since, when, and which.
    asked: Vec<(Instant, SocketAddr, Vec<u8>)>,
    /// Lockstep: the board runs by itself until this sys clock.
    orphan_until: u64,
    /// Paced: since when, and from which sys clock, both clocks are compared.
    pace_from: Option<(Instant, u64)>,
    /// Free: the sys clock of the host's last datagram.
    heard: u64,
}

/// Sys clocks simulated between two looks at the outside world when time runs by itself: about a
/// millisecond of the machine's time.
const SLICE: u64 = 1000;
/// A paced board that is later than this starts counting again instead of hurrying.
const LATE: Duration = Duration::from_millis(100);
/// Shorter sleeps last longer than requested anyway.
const NAP: Duration = Duration::from_micros(50);

impl<D: Device> Server<D> {
    /// Open the sockets. [`Self::run`] ends when `stop` is set, for example by a signal handler.
    pub fn bind(rig: D, options: Options, stop: Arc<AtomicBool>) -> std::io::Result<Self> {
        let (sender, events) = channel();
        let cable = options.tap.as_deref().map(Cable::open).transpose()?;
        let udp = match cable {
            Some(_) => None,
            None => Some(Ear::open(options.udp, Service::Etherbone, &sender)?),
        };
        let discovery = options
            .discovery
            .map(|at| Ear::open(at, Service::Discovery, &sender))
            .transpose()?;
        let dhcp = options.interface.as_ref().map(|_| {
            let at = (Ipv4Addr::UNSPECIFIED, firmware::services::lease::PORT).into();
            Ear::open(at, Service::Dhcp, &sender)
        });
        let dhcp = dhcp.transpose()?;
        for ear in [&discovery, &dhcp].into_iter().flatten() {
            ear.udp.set_broadcast(true)?;
        }
        let console = options.console.map(TcpListener::bind).transpose()?;
        let jobs = options.jobs.map(TcpListener::bind).transpose()?;
        let control = options.control.map(TcpListener::bind).transpose()?;
        let console_address = console.as_ref().map(TcpListener::local_addr).transpose()?;
        let jobs_address = jobs.as_ref().map(TcpListener::local_addr).transpose()?;
        let control_address = control.as_ref().map(TcpListener::local_addr).transpose()?;
        let listeners = [(console, CONSOLE_PORT), (jobs, wire::jobs::PORT)];
        for (first, (listener, port)) in (0..).zip(listeners) {
            let to = sender.clone();
            if let Some(listener) = listener {
                std::thread::spawn(move || accept_visitors(&listener, first, port, &to));
            }
        }
        if let Some(listener) = control {
            let to = sender.clone();
            std::thread::spawn(move || {
                for stream in listener.incoming().flatten() {
                    let to = to.clone();
                    std::thread::spawn(move || {
                        read_commands(BufReader::new(&stream), Some(&stream), &to)
                    });
                }
            });
        }
        if options.stdin {
            let to = sender.clone();
            std::thread::spawn(move || read_commands(std::io::stdin().lock(), None, &to));
        }
        let period_end = rig.clock();
        let mut server = Server {
            rig,
            options,
            udp,
            cable,
            discovery,
            dhcp,
            known: None,
            sender,
            console_address,
            jobs_address,
            control_address,
            events,
            nat: Nat::default(),
            consoles: HashMap::new(),
            stop,
            quit: false,
            period_end,
            last_exchange: None,
            exchanger: None,
            asked: Vec::new(),
            orphan_until: 0,
            pace_from: None,
            heard: 0,
        };
        server.follow_addresses()?;
        Ok(server)
    }

    /// Gives the interface the board's addresses.
    fn follow_addresses(&mut self) -> std::io::Result<()> {
        let Some(interface) = &self.options.interface else {
            return Ok(());
        };
        let now = self.rig.addresses();
        let Some(new) = now.filter(|_| now != self.known) else {
            return Ok(());
        };
        let [a, b, c, d, e, f] = new.mac;
        let mac = format!("{a:02x}:{b:02x}:{c:02x}:{d:02x}:{e:02x}:{f:02x}");
        let commands = [
            format!("link set dev {interface} down"),
            format!("link set dev {interface} address {mac}"),
            format!("address flush dev {interface}"),
            format!("link set dev {interface} up"),
            format!(
                "address add {}/{} brd + dev {interface}",
                new.ip, new.prefix
            ),
            // A board sends broadcasts out of its only cable; this machine needs a route for that.
            format!("route replace 255.255.255.255 dev {interface}"),
        ];
        // The board has no address while it asks a DHCP server.
        let without = |command: &&String| !(new.ip.is_unspecified() && command.contains("brd"));
        for command in commands.iter().filter(without) {
            let said = std::process::Command::new("ip")
                .args(command.split(' '))
                .output()?;
            if !said.status.success() {
                let why = String::from_utf8_lossy(&said.stderr);
                return Err(std::io::Error::other(format!("ip {command}: {why}")));
            }
        }
        if let Some(here) = &self.udp
            && here.udp.local_addr()?.port() != new.port
        {
            let at = (Ipv4Addr::UNSPECIFIED, new.port).into();
            self.udp = Some(Ear::open(at, Service::Etherbone, &self.sender)?);
        }
        eprintln!(
            "sim: {interface} is {mac}, {}/{}, port {}",
            new.ip, new.prefix, new.port
        );
        self.known = Some(new);
        Ok(())
    }

    /// The line that tells scripts where everything is; printed when the board answers.
    pub fn ready_line(&self) -> String {
        let mode = match self.options.mode {
            Mode::Lockstep { period } => format!("lockstep period={period}"),
            Mode::Free { pace: None } => "free".into(),
            Mode::Free { pace: Some(pace) } => format!("free pace={pace}"),
        };
        let address = |a: Option<SocketAddr>| a.map_or("-".into(), |a| a.to_string());
        let jobs = self.jobs_address.map(|at| format!(" jobs={at}"));
        let udp = self.udp.as_ref();
        format!(
            "ready udp={} console={} control={} sys_clk_hz={} mode={mode}{}",
            address(udp.and_then(|it| it.udp.local_addr().ok())),
            address(self.console_address),
            address(self.control_address),
            self.rig.clockwork().sys_hz,
            jobs.unwrap_or_default(),
        )
    }

    /// Serve until told to stop; gives the rig back for its report.
    pub fn run(mut self) -> D {
        while !self.quit && !self.stop.load(Ordering::Relaxed) {
            if let Err(error) = self.follow_addresses() {
                eprintln!("sim: {error}");
                break;
            }
            match self.options.mode {
                Mode::Lockstep { period } => self.lockstep(period),
                Mode::Free { pace } => self.free(pace),
            }
        }
        self.rig
    }

    fn free(&mut self, pace: Option<f64>) {
        if let Some(cable) = &mut self.cable {
            cable.carry(&mut self.rig);
        }
        let event = match self.waits().or_else(|| self.ahead(pace)) {
            // Nothing to do until time goes on or an event comes.
            Some(wait) => self
                .events
                .recv_timeout(wait)
                .map_err(|e| e == RecvTimeoutError::Disconnected),
            None => {
                self.pass(self.rig.clock() + SLICE);
                self.events
                    .try_recv()
                    .map_err(|e| e == TryRecvError::Disconnected)
            }
        };
        match event {
            Ok(Event::Datagram(service, sender, payload)) => {
                self.post(service, sender, &payload);
            }
            Ok(event) => self.handle(event),
            Err(disconnected) => self.quit |= disconnected,
        }
    }

    /// Whether the board waits for a datagram of its host, and how long until it looks whether it
    /// was told to end.
    fn waits(&self) -> Option<Duration> {
        let alone = self.options.alone?;
        (self.rig.clock() >= self.heard + alone).then_some(LATE)
    }

    /// How long a paced board has to wait for this machine's clock; `None` when it has not to.
    fn ahead(&mut self, pace: Option<f64>) -> Option<Duration> {
        let pace = pace?.max(1.0);
        let clock = self.rig.clock();
        let (began, from) = *self.pace_from.get_or_insert((Instant::now(), clock));
        let due = from + (began.elapsed().as_secs_f64() * pace) as u64;
        if due > clock + SLICE {
            // A delay of this machine is made up for, unless it is so long that it would look like
            // a fault.
            if due - clock > (LATE.as_secs_f64() * pace) as u64 {
                self.pace_from = None;
            }
            return None;
        }
        Some(Duration::from_secs_f64((clock + SLICE - due) as f64 / pace).max(NAP))
    }

    /// Put a datagram of the outside world on the segment; the virtual port it comes from there.
    fn post(&mut self, service: Service, sender: SocketAddr, payload: &[u8]) -> u16 {
        let port = self.nat.port(sender);
        self.heard = self.rig.clock();
        self.rig.post(port, service, payload);
        port
    }

    /// Let time pass to the sys clock `until`, forwarding datagrams as they leave the board.
    fn pass(&mut self, until: u64) {
        while self.rig.clock() < until && !self.stop.load(Ordering::Relaxed) {
            self.pass_frame(until);
        }
    }

    /// Let time pass to the next frame or `until`. Returns the virtual ports that datagrams went
    /// to.
    fn pass_frame(&mut self, until: u64) -> Vec<u16> {
        // Slices keep signals and consoles alive in long waits.
        let until = until.min(self.rig.clock() + 20 * SLICE);
        if !self.rig.pass(until) {
            return Vec::new();
        }
        let mut ports = Vec::new();
        for reply in self.rig.take_replies() {
            if let Some(cable) = &mut self.cable {
                cable.send(&reply.payload);
                continue;
            }
            ports.push(reply.port);
            if reply.service == Service::Dhcp {
                if let Some(dhcp) = &self.dhcp {
                    let broadcast = (Ipv4Addr::BROADCAST, reply.port);
                    // There may be no server or no route; the board asks again.
                    let _ = dhcp.udp.send_to(&reply.payload, broadcast);
                }
                continue;
            }
            let (Some(udp), Some(sender)) = (&self.udp, self.nat.sender(reply.port)) else {
                continue;
            };
            // A host that is gone refuses the datagram; a real board would not notice that either.
            let _ = match (reply.service, &self.discovery) {
                (Service::Discovery, Some(discovery)) if self.options.interface.is_some() => {
                    let broadcast = (Ipv4Addr::BROADCAST, sender.port());
                    discovery.udp.send_to(&reply.payload, broadcast)
                }
                (Service::Discovery, Some(discovery)) => {
                    discovery.udp.send_to(&reply.payload, sender)
                }
                _ => udp.udp.send_to(&reply.payload, sender),
            };
        }
        self.pump_consoles();
        ports
    }

    fn handle(&mut self, event: Event) {
        match event {
            Event::Datagram(service, sender, payload) => {
                self.post(service, sender, &payload);
            }
            Event::Opened(id, port, stream) => {
                let connection = self.rig.open(port);
                self.consoles.insert(
                    id,
                    Console {
                        stream,
                        connection,
                        waiting: Vec::new(),
                        ended: false,
                    },
                );
            }
            Event::Typed(id, bytes) => {
                if let Some(console) = self.consoles.get_mut(&id) {
                    console.waiting.extend(bytes);
                }
            }
            Event::Closed(id) => {
                if let Some(console) = self.consoles.get_mut(&id) {
                    console.ended = true;
                }
            }
            Event::Command(line, answer) => {
                let text = self.command(&line);
                match answer {
                    Some(mut stream) => {
                        let _ = writeln!(stream, "{text}");
                    }
                    None => eprintln!("{text}"),
                }
            }
        }
        self.pump_consoles();
    }

    /// Bytes both ways between real console connections and the segment. True while something
    /// moved.
    fn pump_consoles(&mut self) -> bool {
        let rig = &mut self.rig;
        let mut moved = false;
        self.consoles.retain(|_, console| {
            let sent = rig.type_in(console.connection, &console.waiting);
            console.waiting.drain(..sent);
            let heard = rig.heard(console.connection);
            moved |= sent != 0 || !heard.is_empty();
            if !heard.is_empty() && console.stream.write_all(&heard).is_err() {
                // The client is gone. The board still has to be told, or it keeps its only console
                // reserved.
                console.ended = true;
                console.waiting.clear();
            }
            if console.ended && console.waiting.is_empty() && rig.untold(console.connection) == 0 {
                rig.hang_up(console.connection);
            }
            if rig.hung_up(console.connection) {
                // Our side has to close after the board's, or the board waits for it and accepts no
                // other client.
                let _ = console.stream.shutdown(std::net::Shutdown::Both);
                rig.hang_up(console.connection);
            }
            let over = rig.closed(console.connection);
            if over {
                let _ = console.stream.shutdown(std::net::Shutdown::Both);
                rig.forget(console.connection);
            }
            !over
        });
        moved
    }

    /// Lockstep: give the board time in small slices until the consoles have been quiet for 3 ms of
    /// its time (it looks after TCP once a millisecond), at most 20 ms.
    fn settle_consoles(&mut self) {
        let ms = self.rig.clocks(Duration::from_millis(1));
        let end = self.rig.clock() + 20 * ms;
        let mut last = self.rig.clock();
        while !self.consoles.is_empty()
            && self.rig.clock() < end
            && self.rig.clock() < last + 3 * ms
        {
            self.pass_frame(self.rig.clock() + SLICE / 2);
            let busy = self.consoles.values().any(|c| !c.waiting.is_empty());
            if self.pump_consoles() || busy {
                last = self.rig.clock();
            }
        }
    }

    /// One control command; see `help`.
    fn command(&mut self, line: &str) -> String {
        let words: Vec<&str> = line.split_whitespace().collect();
        let number = |text: &str| match text.strip_prefix("0x") {
            Some(hex) => u64::from_str_radix(hex, 16).ok(),
            None => text.parse().ok(),
        };
        let level = |text: Option<&&str>| text.map_or(Some(1), |t| number(t));
        let rest = words.get(1);
        match words.first().copied().unwrap_or_default() {
            "" => String::new(),
            "help" => format!(
                "freeze-cpu [0|1], ext-reset [0|1], gpio-in MASK, ping, run CLOCKS, run-ms MS, \
                 wait-for-host US, mode lockstep NS, fault [WORDS], drop-to-board N, drop-from-board N, pins, counts, stats, report, quit; WORDS of fault: {WORDS}"
            ),
            "fault" => self.fault(line.trim_start().trim_start_matches("fault")),
            "freeze-cpu" => match level(rest) {
                Some(on) => {
                    self.rig.freeze_cpu(on != 0);
                    format!("ok cpu_freeze={}", u8::from(on != 0))
                }
                None => "error: freeze-cpu takes 0 or 1".into(),
            },
            "ext-reset" => match level(rest) {
                Some(on) => {
                    self.rig.environment_mut().ext_reset(on != 0);
                    format!("ok ext_reset={}", u8::from(on != 0))
                }
                None => "error: ext-reset takes 0 or 1".into(),
            },
            "gpio-in" => match rest.and_then(|t| number(t)) {
                Some(mask) => {
                    self.rig.environment_mut().gpio_in(mask);
                    format!("ok gpio_in={mask:#010x}")
                }
                None => "error: gpio-in takes a mask".into(),
            },
            "run" | "run-ms" => match rest.and_then(|t| number(t)) {
                Some(n) => {
                    let ms = self.rig.clocks(Duration::from_millis(1));
                    let clocks = if words[0] == "run" { n } else { n * ms };
                    self.pass(self.rig.clock() + clocks);
                    format!("ok clock={}", self.rig.clock())
                }
                None => "error: run takes a number of clocks, run-ms of milliseconds".into(),
            },
            "wait-for-host" => match rest.and_then(|t| number(t)) {
                Some(us) => {
                    let clocks = self.rig.clocks(Duration::from_micros(us));
                    self.options.alone = (us > 0).then_some(clocks);
                    format!("ok wait_for_host={us}")
                }
                None => "error: wait-for-host takes microseconds, 0 for not at all".into(),
            },
            "mode" => self.begin_lockstep(&words[1..]),
            "drop-to-board" | "drop-from-board" => match rest.and_then(|t| number(t)) {
                Some(n) if words[0] == "drop-to-board" => {
                    let faults = self.rig.faults();
                    faults.drop_next(Direction::ToBoard, n as u32);
                    format!("ok drop_to_board={n}")
                }
                Some(n) => {
                    let faults = self.rig.faults();
                    faults.drop_next(Direction::FromBoard, n as u32);
                    format!("ok drop_from_board={n}")
                }
                None => "error: how many frames?".into(),
            },
            "ping" => match self.rig.ping() {
                Some(clocks) => format!("ok ping={clocks} clocks"),
                None => "error: no answer".into(),
            },
            "pins" => self.told_pins(),
            "counts" => {
                let counts = self.rig.environment().edges.counts().map(|n| n.to_string());
                format!("ok clock={} counts={}", self.rig.clock(), counts.join(","))
            }
            "stats" => self.told_stats(),
            "report" => self.write_report(),
            "quit" => {
                self.quit = true;
                "ok".into()
            }
            other => format!("error: no command {other:?}; try help"),
        }
    }

    fn fault(&mut self, words: &str) -> String {
        let plan = words.parse::<Plan>().map_err(|error| error.to_string());
        match plan.and_then(|plan| self.rig.trouble(&plan)) {
            Ok(()) => {
                let clock = self.rig.clock();
                format!("ok clock={clock} {}", self.rig.faults().told(clock))
            }
            Err(why) => format!("error: {why}"),
        }
    }

    /// From here on time passes with the exchanges, as if the board had begun so.
    fn begin_lockstep(&mut self, words: &[&str]) -> String {
        let period = match words {
            ["lockstep", ns] => ns.parse().map(Duration::from_nanos),
            _ => return "error: mode takes lockstep and nanoseconds".into(),
        };
        let period = period.map_or(0, |period| self.rig.clocks(period));
        if period == 0 {
            return "error: a period of lockstep is nanoseconds, a clock or more".into();
        }
        if self.options.tap.is_some() {
            return "error: a board on a cable has no lockstep: any program may ask it".into();
        }
        self.options.mode = Mode::Lockstep { period };
        self.period_end = self.rig.clock();
        (self.last_exchange, self.exchanger) = (None, None);
        format!("ok clock={} mode=lockstep", self.rig.clock())
    }

    fn told_pins(&self) -> String {
        let p = self.rig.environment().pins();
        format!(
            "ok clock={} gate={} step={:#06x} dir={:#06x} pwm={:#06x} gpio_out={:#010x} gpio_in={:#010x} led={} drives={:#016x}",
            self.rig.clock(),
            p.gate,
            p.step,
            p.dir,
            p.pwm_out,
            p.gpio_out,
            p.gpio_in,
            p.led,
            p.header_drives
        )
    }

    fn told_stats(&self) -> String {
        let meter = self.rig.meter();
        let spread = Spread::of(&meter.turnarounds).unwrap_or_default();
        format!(
            "ok clock={} kcycles_per_second={:.0} exchanges={} answered={} turnaround={}/{}/{} violations={} frames={}/{}",
            self.rig.clock(),
            self.rig.kcycles_per_second(),
            meter.requested,
            meter.answered,
            spread.min,
            spread.median,
            spread.max,
            self.rig.environment().edges.violation_count(),
            self.rig.frames().to_board,
            self.rig.frames().from_board
        )
    }

    fn write_report(&mut self) -> String {
        match self.options.report.clone() {
            Some(path) => match self.rig.report().write(&path) {
                Ok(()) => format!("ok report={}", path.display()),
                Err(e) => format!("error: {e}"),
            },
            None => "error: started without --report".into(),
        }
    }
}

/// A socket with its reading thread; both end when this is dropped.
struct Ear {
    udp: UdpSocket,
    deaf: Arc<AtomicBool>,
}

impl Ear {
    fn open(at: SocketAddr, service: Service, to: &Sender<Event>) -> std::io::Result<Self> {
        let udp = UdpSocket::bind(at)?;
        // How long a port that was given up still listens.
        udp.set_read_timeout(Some(Duration::from_millis(200)))?;
        let deaf = Arc::<AtomicBool>::default();
        let (reader, to, told) = (udp.try_clone()?, to.clone(), deaf.clone());
        std::thread::spawn(move || read_datagrams(&reader, service, &to, &told));
        Ok(Ear { udp, deaf })
    }
}

impl Drop for Ear {
    fn drop(&mut self) {
        self.deaf.store(true, Ordering::Relaxed);
    }
}

fn read_datagrams(udp: &UdpSocket, service: Service, to: &Sender<Event>, deaf: &AtomicBool) {
    let mut buffer = vec![0; 65536];
    loop {
        let heard = udp.recv_from(&mut buffer);
        if deaf.load(Ordering::Relaxed) {
            return;
        }
        match heard {
            Ok((n, sender)) => {
                if to
                    .send(Event::Datagram(service, sender, buffer[..n].to_vec()))
                    .is_err()
                {
                    return;
                }
            }
            // Linux reports a peer's closed port on the next receive; it is not an error here.
            Err(e)
                if matches!(
                    e.kind(),
                    ErrorKind::ConnectionRefused
                        | ErrorKind::Interrupted
                        | ErrorKind::WouldBlock
                        | ErrorKind::TimedOut
                ) => {}
            Err(e) => {
                eprintln!("sim: UDP: {e}");
                return;
            }
        }
    }
}

/// Clients are numbered `first`, `first` + 2, ..: there are two listeners.
fn accept_visitors(listener: &TcpListener, first: u64, port: u16, to: &Sender<Event>) {
    for (id, stream) in (first..).step_by(2).zip(listener.incoming().flatten()) {
        let Ok(mut reader) = stream.try_clone() else {
            continue;
        };
        if to.send(Event::Opened(id, port, stream)).is_err() {
            return;
        }
        let to = to.clone();
        std::thread::spawn(move || {
            let mut buffer = [0; 4096];
            loop {
                match reader.read(&mut buffer) {
                    Ok(0) | Err(_) => {
                        let _ = to.send(Event::Closed(id));
                        return;
                    }
                    Ok(n) => {
                        if to.send(Event::Typed(id, buffer[..n].to_vec())).is_err() {
                            return;
                        }
                    }
                }
            }
        });
    }
}

fn read_commands(lines: impl BufRead, answer: Option<&TcpStream>, to: &Sender<Event>) {
    for line in lines.lines().map_while(Result::ok) {
        let answer = answer.and_then(|stream| stream.try_clone().ok());
        if to.send(Event::Command(line, answer)).is_err() {
            return;
        }
    }
}

#[cfg(test)]
mod tests;
