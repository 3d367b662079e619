//! A Verilated board that executes jobs, at a socket of this machine: the tool's own client sends
//! it jobs and starts them.
//!
//! ```text
//! host::job::client::Board --- loopback ---> Wired --- frames of the virtual Ethernet ---> the board's TCP
//! ```
//!
//! The board's time passes while the client does something, and when a test says so; otherwise it
//! stands still.

pub use crate::flash::{program, program_without_jobs};
use crate::pins::{Event, Pin};

use crate::{BenchMachine, flash, parts};
use host::job::client::Board;
use host::keys::Keys;
use motion::segment::AXES;
use sim::edges::Timing;
use sim::environment::Output;
use sim::lan_segment::Connection;
use sim::nor::spi::Shared;
use sim::nor::{Nor, Part, Times};
use sim::rig::Setup;
use std::collections::BTreeMap;
use std::io::{ErrorKind, Read, Write};
use std::net::{Ipv4Addr, Shutdown, SocketAddr, SocketAddrV4, TcpListener, TcpStream};
use std::time::Duration;
use wire::flash::{Area, Layout};
use wire::images::{Role, Trailer};

/// As long as the client waits, even on a busy computer.
const PATIENCE: Duration = Duration::from_secs(480);
/// Clocks between two looks at the sockets: a sixtieth of a millisecond.
const TURN: u64 = 1000;
/// Clocks between two looks at the program counter. A prime, so that no loop is always seen at the
/// same place.
const SAMPLE: u64 = 61;
/// 2 ms from what the board says to what the client answers, and of that one frame after the other.
/// The board has four places for frames and the program takes up to 2 ms for each; what is lost
/// comes again after most of a second, which is minutes here.
const THINKS: u64 = 120_000;
/// Bytes of one frame, as the board says in its handshake.
const PIECE: usize = 1460;
/// Where the jobs program lies.
const PROGRAM: u32 = wire::regmap::SDRAM_BASE as u32;

/// A board with jobs, with this after the bitstream in its flash; its image runs from slot A.
pub fn setup(behind: &[u8]) -> Setup {
    let trailer = Trailer {
        build_id: flash::FIRST,
        role: Role::Image,
    };
    preloaded(trailer, |layout| layout.slot_a, behind)
}

/// The board of most tests with the services in its flash. To load them takes a quarter of a minute
/// of a core, with jobs half of one, so most tests do without.
pub fn mill() -> Setup {
    without_jobs(setup(&program_without_jobs()))
}

/// The same flash on a board without jobs.
pub fn without_jobs(mut setup: Setup) -> Setup {
    (setup.soc_dir, _) = parts();
    setup
}

/// As [`setup`], but the golden image runs and is followed by this.
pub fn golden(behind: &[u8]) -> Setup {
    let trailer = Trailer {
        build_id: flash::GOLDEN,
        role: Role::Golden,
    };
    preloaded(trailer, |layout| layout.golden, behind)
}

fn preloaded(trailer: Trailer, area: impl Fn(&Layout) -> Area, behind: &[u8]) -> Setup {
    let mut nor = flash::factory(Part::W25Q32JV.with(Times::QUICK), 7);
    let image = flash::with_program(&flash::image(trailer.build_id, 3), behind);
    let area = area(&flash::layout(&nor));
    nor.preload(area.start as usize, &image);
    let meta = flash::meta(&image, trailer.build_id);
    nor.preload(area.meta() as usize, &meta.to_page());
    on_flash(trailer, nor)
}

/// A board with jobs that runs what lies in this flash.
pub fn on_flash(trailer: Trailer, nor: Nor) -> Setup {
    let (mill, firmware) = parts();
    let soc = mill.with_file_name("plotter");
    let mut setup = Setup::new(&soc, &firmware);
    setup.flash = Some(Shared::new(nor));
    setup.trailer = trailer;
    setup
}

/// One connection, with the bytes that the board has not taken yet.
struct ClientLine {
    stream: TcpStream,
    line: Connection,
    ahead: Vec<u8>,
    /// When the board spoke last.
    heard: u64,
    /// The client has sent its last request.
    over: bool,
}

/// Where the processor was, and for how many looks.
#[derive(Clone, Debug, Default)]
pub struct Profile {
    /// By address of the instruction that left the pipeline next.
    pub counts: BTreeMap<u32, u64>,
    /// Clocks in which it was looked at without the ROM being seen in between, at most.
    pub longest: u64,
    since: Option<u64>,
}

/// The board and its wire.
pub struct Wired {
    /// The board. What passes here does not pass at the sockets.
    pub machine: BenchMachine,
    at: SocketAddrV4,
    listener: TcpListener,
    lines: Vec<ClientLine>,
    /// After the lines: it closes after the other end is gone.
    client: Option<Board>,
    profile: Option<Profile>,
}

impl Wired {
    /// Switched on, with the jobs program; its steps and its pen are being watched.
    pub fn boot() -> Self {
        Self::around(BenchMachine::boot(setup(&program())))
    }

    /// This board.
    pub fn around(mut machine: BenchMachine) -> Self {
        machine.rig().board.edges.keep_steps();
        machine.rig().board.watch.gpio = 1;
        let any = SocketAddr::from((Ipv4Addr::LOCALHOST, 0));
        let listener = TcpListener::bind(any).expect("a port of this machine");
        listener.set_nonblocking(true).expect("asked now and then");
        let SocketAddr::V4(at) = listener.local_addr().expect("its number") else {
            unreachable!("bound to an IPv4 address");
        };
        Wired {
            machine,
            at,
            listener,
            lines: Vec::new(),
            client: None,
            profile: None,
        }
    }

    /// The tool's client does this, and the board's time passes until it has.
    pub fn with<T: Send>(&mut self, act: impl FnOnce(&mut Board) -> T + Send) -> T {
        let (at, client) = (self.at, self.client.take());
        let connect = move || Board::with_patience(at, Keys::default(), PATIENCE);
        let (client, told) = std::thread::scope(|scope| {
            let host = scope.spawn(move || {
                let client = client.map_or_else(connect, Ok);
                let mut client = client.unwrap_or_else(|error| panic!("{error}"));
                let told = act(&mut client);
                (client, told)
            });
            while !host.is_finished() {
                self.turn(TURN);
            }
            host.join()
                .unwrap_or_else(|panic| std::panic::resume_unwind(panic))
        });
        self.client = Some(client);
        told
    }

    /// Lets time pass.
    pub fn run(&mut self, clocks: u64) {
        let until = self.machine.clock() + clocks;
        while self.machine.clock() < until {
            self.turn(TURN.min(until - self.machine.clock()));
        }
    }

    fn turn(&mut self, clocks: u64) {
        while let Ok((stream, _)) = self.listener.accept() {
            stream.set_nodelay(true).expect("small frames at once");
            stream.set_nonblocking(true).expect("asked now and then");
            let line = self.machine.rig().segment.connect(wire::jobs::PORT);
            self.lines.push(ClientLine {
                stream,
                line,
                ahead: Vec::new(),
                heard: 0,
                over: false,
            });
        }
        let now = self.machine.clock();
        let rig = self.machine.rig();
        self.lines
            .retain_mut(|line| line.serve(&mut rig.segment, now));
        match self.profile.take() {
            None => self.machine.rig().run(clocks),
            Some(mut profile) => {
                self.sample(clocks, &mut profile);
                self.profile = Some(profile);
            }
        }
    }

    /// Lets time pass and looks where the processor is.
    fn sample(&mut self, clocks: u64, profile: &mut Profile) {
        let until = self.machine.clock() + clocks;
        while self.machine.clock() < until {
            self.machine.rig().run(SAMPLE);
            // In a stall what waits is what leaves the pipeline next.
            let mut pc = self.machine.rig().board.silicon().pc();
            while pc.is_none() {
                self.machine.rig().run(1);
                pc = self.machine.rig().board.silicon().pc();
            }
            let now = self.machine.clock();
            let pc = pc.unwrap_or(0);
            *profile.counts.entry(pc).or_default() += 1;
            if pc >= PROGRAM {
                let since = *profile.since.get_or_insert(now);
                profile.longest = profile.longest.max(now - since);
            } else {
                profile.since = None;
            }
        }
    }

    /// From now on the program counter is looked at.
    pub fn profile(&mut self) {
        self.profile = Some(Profile::default());
    }

    /// What it was, if it was.
    pub fn take_profile(&mut self) -> Option<Profile> {
        self.profile.take()
    }

    /// Segments begun since power-up, and those that wait.
    pub fn segments(&mut self) -> (u32, u8) {
        let segments = self.machine.rig().board.silicon().segments();
        segments.expect("a board with jobs, verilated by this build")
    }

    /// Gives the check at the pins the timing of this machine's drives.
    pub fn judge(&mut self, machine: &host::job::machine::MachineFile) {
        let axes = machine.to_board().axes;
        for (axis, told) in axes.iter().enumerate() {
            let [steplen, stepspace, dirsetup, dirhold] =
                told.timings(machine.clock).map(u64::from);
            let timing = Timing {
                steplen,
                stepspace,
                dirsetup,
                dirhold,
            };
            self.machine.rig().board.edges.set_timing(axis, timing);
        }
    }

    /// Everything the pins did since this was asked last.
    pub fn events(&mut self) -> Vec<Event> {
        let board = &mut self.machine.rig().board;
        assert_eq!(board.edges.violations(), [], "timing at the pins");
        let steps = board.edges.take_steps().into_iter();
        let mut events: Vec<Event> = steps
            .map(|step| {
                let (axis, forward) = (usize::from(step.channel), step.forward);
                (step.clock, Pin::Step { axis, forward })
            })
            .collect();
        events.extend(board.take_events().into_iter().filter_map(|event| {
            let pen = event.output == Output::Gpio(0);
            pen.then_some((event.clock, Pin::Tool(event.level)))
        }));
        events.sort_by_key(|(clock, _)| *clock);
        events
    }

    /// Where its pulses add up to.
    pub fn steps(&self) -> [i64; AXES] {
        std::array::from_fn(|axis| self.machine.pulses(axis))
    }
}

impl ClientLine {
    /// Passes data between both ends; false when both have closed.
    fn serve(&mut self, segment: &mut sim::lan_segment::LanSegment, now: u64) -> bool {
        let mut buffer = [0; 2048];
        while !self.over && self.ahead.is_empty() {
            match self.stream.read(&mut buffer) {
                Ok(0) => self.over = true,
                Ok(length) => self.ahead.extend(&buffer[..length]),
                Err(error) if error.kind() == ErrorKind::WouldBlock => break,
                Err(_) => self.over = true,
            }
        }
        let quiet = segment.unsent(self.line) == 0 && now >= self.heard + THINKS;
        if segment.established(self.line) && quiet {
            let piece = self.ahead.len().min(PIECE);
            let taken = segment.send(self.line, &self.ahead[..piece]);
            self.ahead.drain(..taken);
            if self.over && self.ahead.is_empty() {
                segment.close(self.line);
            }
        }
        let heard = segment.recv(self.line);
        if !heard.is_empty() {
            self.heard = now;
        }
        // The client has room for more than a frame; one that is gone hears nothing.
        let _ = self.stream.write_all(&heard);
        let closed = segment.closed(self.line);
        if segment.hung_up(self.line) || closed {
            let _ = self.stream.shutdown(Shutdown::Write);
            segment.close(self.line);
        }
        if closed {
            segment.drop_connection(self.line);
        }
        !closed
    }
}

impl Profile {
    /// A line for each address: in hexadecimal, and how often.
    pub fn text(&self) -> String {
        let lines = self.counts.iter();
        lines
            .map(|(pc, count)| format!("{pc:08x} {count}\n"))
            .collect()
    }
}
