//! A board that executes jobs, served over real sockets, and a connection to it that can be cut.

use crate::pins::{Event, Pin};
use host::address::Address;
use host::job::client::Board;
use host::job::stream::Streamer;
use host::keys::Keys;
use motion::segment::AXES;
use sim::Twin;
use sim::board_facts::BoardFacts;
use sim::environment::Output;
use sim::model_board::Setup;
use sim::plant::Plant;
use sim::server::{self, Mode, Options, Server};
use std::io::{Read, Write};
use std::net::{Ipv4Addr, Shutdown, SocketAddr, SocketAddrV4, TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};
use wire::describe::Channels;
use wire::jobs::{Report, State};

/// As long as a test may take, even on a busy computer.
const PATIENCE: Duration = Duration::from_secs(120);
/// Less than the segments of one datagram last, and than the watchdog allows; more than an answer
/// takes.
const ALONE_US: u64 = 250;
/// Far longer than any job takes.
const JOB: Duration = Duration::from_secs(600);

/// The board of the tests: the three axes of a job and one more, a pen at output 0.
const CHANNELS: Channels = Channels {
    stepgens: 4,
    encoders: 0,
    pwms: 0,
    inputs: 4,
    outputs: 4,
};
const CLOCK: u32 = 60_000_000;

/// A twin at sockets of this computer, running as fast as possible.
pub struct Plotter {
    /// Where its jobs are.
    pub jobs: SocketAddrV4,
    /// Where its console is.
    pub console: SocketAddrV4,
    /// Where the board itself is.
    pub udp: SocketAddrV4,
    control: SocketAddrV4,
    stop: Arc<AtomicBool>,
    thread: JoinHandle<Twin>,
    streamer: Option<(Arc<AtomicBool>, JoinHandle<()>)>,
}

impl Plotter {
    /// Switched on; its steps and its pen are being watched.
    pub fn twin() -> Self {
        Plotter::with(true, None, "")
    }

    /// The same, so many times slower than real time: a client that a busy computer makes late is
    /// not one that has gone.
    pub fn paced(slower: u32) -> Self {
        Plotter::with(true, Some(slower), "")
    }

    /// The same without SDRAM, so many times slower than real time. Its time waits for the PC that
    /// streams, which a busy computer makes late: [`Plotter::waits_for_its_pc`]. Its jobs have no
    /// executor yet.
    pub fn without_sdram(slower: u32) -> Self {
        Plotter::with(false, Some(slower), "")
    }

    /// The same with these faults on the wire and with an executor of its jobs in this process.
    pub fn streamed(slower: u32, trouble: &str) -> Self {
        let mut plotter = Plotter::with(false, Some(slower), trouble);
        let any = SocketAddr::from((Ipv4Addr::LOCALHOST, 0));
        let streamer = Streamer::open(&plotter.address(), Keys::default(), any);
        let mut streamer = streamer.unwrap_or_else(|error| panic!("{error}"));
        let SocketAddr::V4(at) = streamer.at() else {
            unreachable!("bound to an IPv4 address");
        };
        plotter.jobs = at;
        let stop = Arc::<AtomicBool>::default();
        let told = stop.clone();
        let thread = std::thread::spawn(move || streamer.run(&told));
        plotter.streamer = Some((stop, thread));
        plotter
    }

    fn with(sdram: bool, slower: Option<u32>, trouble: &str) -> Self {
        let mut facts = BoardFacts::plain(CHANNELS, CLOCK);
        (facts.jobs, facts.sdram) = (AXES as u8, sdram);
        let pace = slower.map(|slower| f64::from(CLOCK) / f64::from(slower));
        let streamed = !sdram;
        let alone = streamed.then(|| u64::from(CLOCK) / 1_000_000 * ALONE_US);
        let mut twin = Twin::power_up(Setup::new(facts, Plant::default()));
        if !trouble.is_empty() {
            let plan = trouble.parse().expect("words for trouble");
            server::Device::trouble(&mut twin, &plan).expect("a twin can be troubled");
        }
        twin.environment().edges.keep_steps();
        twin.environment().watch.gpio = 1;
        let any = SocketAddr::from((Ipv4Addr::LOCALHOST, 0));
        let options = Options {
            udp: any,
            discovery: None,
            interface: None,
            tap: None,
            console: Some(any),
            jobs: (!streamed).then_some(any),
            control: Some(any),
            stdin: false,
            mode: Mode::Free { pace },
            silence: PATIENCE,
            orphan_clocks: 0,
            alone,
            report: None,
        };
        let stop = Arc::<AtomicBool>::default();
        let (told, hear) = std::sync::mpsc::channel();
        let stopped = stop.clone();
        let thread = std::thread::spawn(move || {
            let server = Server::bind(twin, options, stopped).expect("sockets of this machine");
            told.send(server.ready_line())
                .expect("a plotter that waits");
            server.run()
        });
        let ready = hear.recv().expect("a server");
        let place = |key: &str| -> Option<SocketAddrV4> {
            let mut words = ready.split(' ');
            words.find_map(|word| word.strip_prefix(key))?.parse().ok()
        };
        let udp = place("udp=").expect("it says where it is");
        let jobs = match streamed {
            // Until its jobs have an executor.
            true => udp,
            false => place("jobs=").expect("it says where its jobs are"),
        };
        Plotter {
            jobs,
            udp,
            console: place("console=").expect("it says where its console is"),
            control: place("control=").expect("it says where it is controlled"),
            stop,
            thread,
            streamer: None,
        }
    }

    /// The board's.
    pub fn address(&self) -> Address {
        Address {
            text: self.udp.to_string(),
            socket: self.udp,
        }
    }

    /// A client.
    pub fn board(&self) -> Board {
        let board = Board::with_patience(self.jobs, Keys::default(), PATIENCE);
        board.unwrap_or_else(|error| panic!("{error}"))
    }

    /// Waits until nothing is going on, for as long as any job of the tests takes.
    pub fn finish(&self, board: &mut Board) -> Report {
        let end = Instant::now() + JOB;
        loop {
            let report = board.report().unwrap_or_else(|error| panic!("{error}"));
            if report.state == State::Stopped {
                return report;
            }
            assert!(Instant::now() < end, "it does not end: {report:?}");
            board.hang_up();
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    /// One of the simulator's control commands; its answer.
    pub fn control(&self, command: &str) -> String {
        crate::control(self.control.into(), command)
    }

    /// Whether time waits for a PC that is silent, or goes on without it.
    pub fn waits_for_its_pc(&self, waits: bool) {
        let us = if waits { ALONE_US } else { 0 };
        self.control(&format!("wait-for-host {us}"));
    }

    /// Pulses at the pins of each axis, and whether the gate is open, as they are now.
    pub fn pins(&self) -> ([i64; AXES], bool) {
        let gate = self.control("pins").contains("gate=1");
        let said = self.control("counts");
        let (_, counts) = said.split_once("counts=").expect("counts");
        let mut counts = counts
            .trim()
            .split(',')
            .map(|n| n.parse().expect("a count"));
        let counts = std::array::from_fn(|_| counts.next().expect("of each axis"));
        (counts, gate)
    }

    /// Tells the streamer to end, as Ctrl-C does, and waits until it has.
    pub fn end_streaming(&mut self) {
        if let Some((stop, thread)) = self.streamer.take() {
            stop.store(true, Ordering::Relaxed);
            thread.join().expect("the streamer's thread");
        }
    }

    /// Switched off: everything its pins did.
    pub fn events(mut self) -> Vec<Event> {
        self.end_streaming();
        self.stop.store(true, Ordering::Relaxed);
        let mut twin = self.thread.join().expect("the twin's thread");
        let environment = twin.environment();
        assert_eq!(environment.edges.violations(), [], "timing at the pins");
        let steps = environment.edges.take_steps().into_iter().map(|step| {
            let axis = usize::from(step.channel);
            let forward = step.forward;
            (step.clock, Pin::Step { axis, forward })
        });
        let mut events: Vec<Event> = steps.collect();
        let tools = environment.take_events().into_iter().filter_map(|event| {
            let pen = event.output == Output::Gpio(0);
            pen.then_some((event.clock, Pin::Tool(event.level)))
        });
        events.extend(tools);
        events.sort_by_key(|(clock, _)| *clock);
        events
    }
}

/// A line to a board that is cut after so many bytes of what the host says, several times.
pub struct Scissors {
    at: SocketAddrV4,
    cuts: Arc<AtomicUsize>,
}

impl Scissors {
    /// In front of the board at `to`; a connection lasts for the first of `lengths` until one was
    /// cut, then for the second, and so on; those after them last.
    pub fn new(to: SocketAddrV4, lengths: &[usize]) -> Self {
        Scissors::cutting(
            to,
            lengths.iter().map(|length| (*length, usize::MAX)).collect(),
        )
    }

    /// The same, counting what the board answers; what it answers beyond that is lost.
    pub fn deaf(to: SocketAddrV4, lengths: &[usize]) -> Self {
        Scissors::cutting(
            to,
            lengths.iter().map(|length| (usize::MAX, *length)).collect(),
        )
    }

    fn cutting(to: SocketAddrV4, lengths: Vec<(usize, usize)>) -> Self {
        let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).expect("a port");
        let SocketAddr::V4(at) = listener.local_addr().expect("its number") else {
            unreachable!("bound to an IPv4 address");
        };
        let cuts = Arc::<AtomicUsize>::default();
        let told = cuts.clone();
        std::thread::spawn(move || {
            for host in listener.incoming().flatten() {
                // A connection that the host gave up is not the one to be cut: the next one is.
                let length = lengths.get(told.load(Ordering::Relaxed)).copied();
                let Ok(board) = TcpStream::connect(to) else {
                    continue;
                };
                serve(
                    host,
                    board,
                    length.unwrap_or((usize::MAX, usize::MAX)),
                    &told,
                );
            }
        });
        Scissors { at, cuts }
    }

    /// A client at the near end.
    pub fn board(&self) -> Board {
        let board = Board::with_patience(self.at, Keys::default(), PATIENCE);
        board.unwrap_or_else(|error| panic!("{error}"))
    }

    /// How often it was cut.
    pub fn cuts(&self) -> usize {
        self.cuts.load(Ordering::Relaxed)
    }
}

/// Both ways, until either end hangs up or the length is used up.
fn serve(
    mut host: TcpStream,
    mut board: TcpStream,
    (mut left, answered): (usize, usize),
    cuts: &Arc<AtomicUsize>,
) {
    let (Ok(mut back), Ok(mut from)) = (host.try_clone(), board.try_clone()) else {
        return;
    };
    let told = cuts.clone();
    let answers = std::thread::spawn(move || {
        let _ = std::io::copy(&mut (&mut from).take(answered as u64), &mut back);
        if answered != usize::MAX {
            // The next one is made, and does not arrive.
            let _ = from.read(&mut [0]);
            told.fetch_add(1, Ordering::Relaxed);
        }
        let _ = back.shutdown(Shutdown::Both);
        let _ = from.shutdown(Shutdown::Both);
    });
    let mut buffer = [0; 4096];
    loop {
        let room = left.min(buffer.len());
        let count = host.read(&mut buffer[..room]).unwrap_or(0);
        if count == 0 || board.write_all(&buffer[..count]).is_err() {
            break;
        }
        left -= count;
        if left == 0 {
            cuts.fetch_add(1, Ordering::Relaxed);
            break;
        }
    }
    // Either end sees it go at once, as with a router that forgets.
    let _ = host.shutdown(Shutdown::Both);
    let _ = board.shutdown(Shutdown::Both);
    let _ = answers.join();
}
