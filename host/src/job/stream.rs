//! Executes the jobs of a board without SDRAM on this computer, and streams their segments to the
//! board.
//!
//! ```text
//!   ferrocnc job send|start|.. --TCP--> Streamer: jobs::Jobs --> Far --UDP--> the board's server
//!                                                                             and segments core
//! ```
//!
//! The executor is the same program that other boards run in their SDRAM; here its accesses to the
//! board go over the network. The gateware's FIFO holds 64 segments. Its level is the flow control,
//! an empty FIFO is an underrun with a soft stop, and a silent PC makes the watchdog bite, as under
//! LinuxCNC.
//!
//! A datagram may be lost, late, or come twice. A write to the segments carries a number that the
//! board takes once, an exchange carries its sequence number; everything else can be repeated. A
//! failed write leaves a hole in the path, so nothing is written behind it and the watchdog is not
//! fed any more. The executor then ends the job as it does when the board closes its outputs.

use crate::address::Address;
use crate::client::{Client, ClientError};
use crate::keys::Keys;
use jobs::server::{Answer, BusyReply};
use jobs::{AHEAD, Jobs, Outside};
use std::io::{self, Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};
use wire::describe::{FEATURE_JOBS, JobsState};
use wire::exchange::status_words;
use wire::jobs::{FRAME, JobCommand, Op, Request, SILENCE_SECONDS, State, Status};
use wire::regmap::segments::{BEGUN, CURRENT, LEFT, PUSH, SHAPE, STATUS};
use wire::{MAX_WORDS, Name, Packet, ReplyWriter, etherbone, map, regmap};

/// 10 ms: a board answers within 1 ms, and its watchdog waits for 100 ms.
const TRY: Duration = Duration::from_millis(10);
/// After 1 s without an answer the board is no longer armed: its watchdog has bitten long before.
const PATIENCE: Duration = Duration::from_secs(1);
/// 64 MiB for jobs; a board with SDRAM has 7.5.
const ROOM: usize = 64 << 20;
/// The id of the program; on a board it is the program's CRC.
const PROGRAM: u32 = 0x686f_7374;
/// 1 ms: the most the last status of the segments may be old. A full FIFO lasts for at least 10 ms
/// or so.
const FRESH: Duration = Duration::from_millis(1);
/// Segments in a datagram.
const BATCH: usize = 8;
/// Turns of the program between two looks at the network.
const TURNS: usize = 64;
/// Between two looks while there is nothing to plan.
const NAP: Duration = Duration::from_micros(250);
/// The same without a client and without a job.
const SLEEP: Duration = Duration::from_millis(2);
/// Clients beside the one that is connected; one more, and the first of them has to go.
const CALLERS: usize = 16;
/// The time the axes may take to come to rest when this program is told to end: more than any stop
/// takes. A second signal ends it at once.
const FAREWELL: Duration = Duration::from_secs(60);

/// What is read at once. What is left belongs to a segment: the count is asked in front of it and
/// behind it.
const READS: [usize; 6] = [BEGUN, LEFT, BEGUN, STATUS, CURRENT, SHAPE];

/// Why it does not begin.
#[derive(Debug)]
pub enum StreamError {
    /// The board.
    Client(ClientError),
    /// It has no segments.
    None(Address),
    /// It executes jobs by itself.
    Executes(Address, JobsState),
    /// The address to listen at.
    Listen(SocketAddr, io::Error),
}

impl core::fmt::Display for StreamError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            StreamError::Client(error) => error.fmt(f),
            StreamError::None(address) => write!(
                f,
                "{address} cannot play segments; write jobs = 3 and sdram = false into its board file, and build and flash that"
            ),
            StreamError::Executes(address, state) => write!(
                f,
                "{address} executes jobs by itself ({state}): ferrocnc job send {}; only one with sdram = false in its board file is streamed to",
                address.socket.ip()
            ),
            StreamError::Listen(at, error) => {
                write!(
                    f,
                    "cannot listen at {at} ({error}); --at names another place"
                )
            }
        }
    }
}

impl std::error::Error for StreamError {}

impl From<ClientError> for StreamError {
    fn from(error: ClientError) -> Self {
        StreamError::Client(error)
    }
}

/// Executes jobs for a board, and answers the clients.
#[derive(Debug)]
pub struct Streamer {
    jobs: Jobs<'static>,
    far: Far,
    listener: TcpListener,
    at: SocketAddr,
    connection: Option<Connection>,
    /// They came while another client was connected.
    callers: Vec<Caller>,
}

impl Streamer {
    /// For this board, at this place.
    pub fn open(board: &Address, keys: Keys, at: SocketAddr) -> Result<Self, StreamError> {
        let mut client = Client::open(board)?.with_keys(keys);
        let identity = client.identify()?;
        client.check(&identity)?;
        let features = identity.describe.features;
        match JobsState::of(features) {
            _ if features & FEATURE_JOBS == 0 => return Err(StreamError::None(board.clone())),
            JobsState::Streamed => {}
            state => return Err(StreamError::Executes(board.clone(), state)),
        }
        let listener = || {
            let listener = TcpListener::bind(at)?;
            listener.set_nonblocking(true)?;
            let at = listener.local_addr()?;
            Ok((listener, at))
        };
        let (listener, at) = listener().map_err(|error| StreamError::Listen(at, error))?;
        let mut far = Far {
            client: client.hurried(TRY, PATIENCE),
            status_words: status_words(identity.describe.channels),
            clock_hz: identity.describe.clock_hz,
            started: Instant::now(),
            owns: false,
            sequence: 0,
            number: None,
            waiting: Vec::new(),
            pushes: 0,
            known: [0; SHAPE + 1],
            known_at: None,
            counted: false,
            hole: false,
            wrote: false,
        };
        // Never freed: there is one program for one board.
        let jobs = Jobs::new(vec![0; ROOM].leak(), PROGRAM, &mut far);
        Ok(Streamer {
            jobs: jobs.ok_or_else(|| StreamError::None(board.clone()))?,
            far,
            listener,
            at,
            connection: None,
            callers: Vec::new(),
        })
    }

    /// Where the jobs are.
    pub fn at(&self) -> SocketAddr {
        self.at
    }

    /// Until told to stop; what moves then comes to rest first.
    pub fn run(&mut self, stop: &AtomicBool) {
        while !stop.load(Ordering::Relaxed) {
            self.accept_client();
            self.hear_callers();
            self.go_on();
        }
        self.connection = None;
        self.stop();
        let end = Instant::now() + FAREWELL;
        while self.jobs.executor().busy() && Instant::now() < end {
            self.go_on();
        }
    }

    /// Some turns of the program, then a pause if it had nothing to do.
    fn go_on(&mut self) {
        let mut lively = false;
        for _ in 0..TURNS {
            if let Some(connection) = &mut self.connection {
                lively |= connection.serve(&mut self.jobs, &mut self.far);
            }
            self.jobs.poll(&mut self.far);
        }
        let executor = self.jobs.executor();
        lively |= core::mem::take(&mut self.far.wrote) || executor.state() == State::Checking;
        if !lively {
            let idle = self.connection.is_none() && !executor.busy();
            std::thread::sleep(if idle { SLEEP } else { NAP });
        }
    }

    /// Stops the job along the path, as an operator's stop does.
    fn stop(&mut self) {
        let mut frame = [0; FRAME];
        let requests = [
            Request::Hello { client: PROGRAM },
            Request::Command {
                code: JobCommand::Stop.code(),
                flags: 0,
                keepalive: 0,
                name: Name::EMPTY,
            },
        ];
        self.jobs.visit(&mut self.far);
        for (id, request) in (1..).zip(requests) {
            let length = request.emit(id, &mut frame);
            let mut rest = &frame[..length];
            while !rest.is_empty() {
                let taken = self.jobs.said(rest, &mut Answers::default(), &mut self.far);
                rest = &rest[taken..];
            }
        }
    }

    /// Reads the clients that connected while another one was there: they may send a stop.
    fn hear_callers(&mut self) {
        let Streamer {
            jobs, far, callers, ..
        } = self;
        callers.retain_mut(|caller| caller.hear(jobs, far));
    }

    /// Accepts a client; one at a time.
    fn accept_client(&mut self) {
        if let Some(connection) = &mut self.connection
            && !connection.hear()
        {
            // Requests in front of the end of a connection are executed.
            while !connection.leaves && connection.serve(&mut self.jobs, &mut self.far) {}
            self.connection = None;
        }
        let Ok((mut stream, _)) = self.listener.accept() else {
            return;
        };
        if self.connection.is_some() {
            let mut frame = [0; FRAME];
            let length = wire::jobs::answer(Op::Hello.code(), Status::Busy, 0, &mut frame, |_| {});
            // A client that is gone needs no answer.
            let _ = stream.write_all(&frame[..length]);
            if stream.set_nonblocking(true).is_ok() && stream.set_nodelay(true).is_ok() {
                if self.callers.len() >= CALLERS {
                    self.callers.remove(0);
                }
                self.callers.push(Caller {
                    stream,
                    busy: BusyReply::new(),
                    came: Instant::now(),
                });
            }
        } else if stream.set_nonblocking(true).is_ok() && stream.set_nodelay(true).is_ok() {
            self.jobs.visit(&mut self.far);
            self.connection = Some(Connection {
                stream,
                ahead: Vec::new(),
                answers: Vec::new(),
                heard: Instant::now(),
                leaves: false,
            });
        }
    }
}

/// What a client is answered.
#[derive(Debug, Default)]
struct Answers {
    bytes: Vec<u8>,
    /// Ends the connection after them.
    close: bool,
}

impl Answer for Answers {
    fn put(&mut self, bytes: &[u8]) {
        self.bytes.extend_from_slice(bytes);
    }

    fn close(&mut self) {
        self.close = true;
    }
}

/// A client that came while another one was there.
#[derive(Debug)]
struct Caller {
    stream: TcpStream,
    busy: BusyReply,
    came: Instant,
}

impl Caller {
    /// Reads its requests. False: the client is done.
    fn hear(&mut self, jobs: &mut Jobs<'static>, far: &mut Far) -> bool {
        let mut buffer = [0; AHEAD];
        let mut rest = match self.stream.read(&mut buffer) {
            Ok(0) => return false,
            Ok(count) => &buffer[..count],
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => {
                return self.came.elapsed() < Duration::from_secs(SILENCE_SECONDS.into());
            }
            Err(_) => return false,
        };
        let mut text = Answers::default();
        while !rest.is_empty() && !text.close {
            let taken = jobs.busy_reply(&mut self.busy, rest, &mut text, far);
            rest = &rest[taken..];
        }
        // A hundred bytes, the first it is sent but for the greeting: the computer has room for
        // them.
        let told = self.stream.write_all(&text.bytes).is_ok();
        told && !text.close
    }
}

/// The client of the jobs.
#[derive(Debug)]
struct Connection {
    stream: TcpStream,
    /// Received bytes that are not yet read.
    ahead: Vec<u8>,
    /// Answers that are not yet sent.
    answers: Vec<u8>,
    heard: Instant,
    leaves: bool,
}

impl Connection {
    /// Receives and sends what the network takes. False: the client is gone.
    fn hear(&mut self) -> bool {
        while !self.answers.is_empty() {
            match self.stream.write(&self.answers) {
                Ok(0) => return false,
                Ok(count) => drop(self.answers.drain(..count)),
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => break,
                Err(_) => return false,
            }
        }
        if self.leaves && self.answers.is_empty() {
            return false;
        }
        let mut buffer = [0; AHEAD];
        let room = AHEAD - self.ahead.len();
        match self.stream.read(&mut buffer[..room]) {
            Ok(0) => room == 0,
            Ok(count) => {
                self.ahead.extend_from_slice(&buffer[..count]);
                self.heard = Instant::now();
                true
            }
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => {
                self.heard.elapsed() < Duration::from_secs(SILENCE_SECONDS.into())
            }
            Err(_) => false,
        }
    }

    /// Serves a request, if a whole one is there. True if there was one.
    fn serve(&mut self, jobs: &mut Jobs<'static>, far: &mut Far) -> bool {
        let mut text = Answers::default();
        let taken = jobs.said(&self.ahead, &mut text, far);
        self.ahead.drain(..taken);
        self.answers.extend_from_slice(&text.bytes);
        self.leaves |= text.close;
        if !text.bytes.is_empty() {
            // The client waits for the answer before its next request.
            let _alive = self.hear();
        }
        taken > 0 || !text.bytes.is_empty()
    }
}

/// The board, at the other end of a cable.
#[derive(Debug)]
struct Far {
    client: Client,
    status_words: usize,
    clock_hz: u32,
    started: Instant,
    /// The session is ours, as far as we know.
    owns: bool,
    /// Of the last exchange.
    sequence: u32,
    /// The last in front of words for the segments; `None` until asked.
    number: Option<u32>,
    /// Words for the segments that have not been sent.
    waiting: Vec<(usize, u32)>,
    pushes: usize,
    /// What the segments said last.
    known: [u32; SHAPE + 1],
    known_at: Option<Instant>,
    /// The level has been counted up since it was read or asked for.
    counted: bool,
    /// Something was not written.
    hole: bool,
    wrote: bool,
}

impl Outside for Far {
    fn datagram(&mut self, request: &[u32], reply: &mut [u32; MAX_WORDS]) -> usize {
        let Some((base, words)) = self.ask(request) else {
            return 0;
        };
        let mut writer = ReplyWriter::new(reply, etherbone::HEADER);
        writer.write_record(base, words.len() as u8);
        writer.extend(&words);
        writer.words().len()
    }

    fn read_segments(&mut self, word: usize) -> u32 {
        // A push counts the level up here, and on the board it only falls: a slow computer, too,
        // has a whole batch for a datagram.
        let counted = word == STATUS && core::mem::take(&mut self.counted);
        let fresh = counted || self.known_at.is_some_and(|at| at.elapsed() < FRESH);
        if !fresh && self.settle().is_none() {
            self.failed();
        }
        self.known.get(word).copied().unwrap_or(0)
    }

    fn write_segments(&mut self, word: usize, value: u32) {
        self.wrote = true;
        // Behind a hole orders are taken, segments are not. Without the session nothing is written.
        if !self.owns || self.hole && word <= PUSH {
            return;
        }
        self.waiting.push((word, value));
        if word > PUSH {
            self.known_at = None;
        } else if word == PUSH {
            self.pushes += 1;
            self.known[STATUS] += 1;
            self.counted = true;
            if self.pushes >= BATCH && self.settle().is_none() {
                self.failed();
            }
        }
    }

    fn now(&mut self) -> u64 {
        let passed = self.started.elapsed().as_nanos() * u128::from(self.clock_hz);
        (passed / 1_000_000_000) as u64
    }
}

impl Far {
    /// The board does not answer, or takes nothing from us any more.
    fn failed(&mut self) {
        self.hole |= self.owns;
        self.known = [0; SHAPE + 1];
        self.known_at = Some(Instant::now());
    }

    /// A datagram of the executor's; the answer's base and words.
    fn ask(&mut self, request: &[u32]) -> Option<(u32, Vec<u32>)> {
        let packet = Packet::new_checked(request).ok()?;
        let (mut writes, mut reads) = (Vec::new(), Vec::new());
        for record in packet.records() {
            if !record.writes.is_empty() {
                writes.push((record.write_base, record.writes));
            }
            reads.extend_from_slice(record.reads);
        }
        match writes.first() {
            Some((map::COMMAND, block)) => self.exchange(block),
            Some((map::SESSION_ACQUIRE, _)) => Some((0, vec![self.acquire()])),
            Some((map::SESSION_RELEASE, token)) => {
                self.release(token);
                None
            }
            None => Some((0, self.client.read(&reads).ok()?)),
            Some(_) => {
                if reads.is_empty() {
                    // A receipt.
                    reads.push(map::DESCRIBE);
                }
                Some((0, self.client.transact(&writes, &reads).ok()?))
            }
        }
    }

    /// The token, 0 without.
    fn acquire(&mut self) -> u32 {
        let session = self.client.acquire().ok();
        self.waiting.clear();
        (self.number, self.known_at, self.counted) = (None, None, false);
        (self.hole, self.pushes) = (false, 0);
        self.owns = session.is_some();
        self.sequence = session.map_or(0, |session| session.last_sequence);
        session.map_or(0, |session| session.token)
    }

    /// One that is lost ends by itself, 3 s later.
    fn release(&mut self, token: &[u32]) {
        if !self.waiting.is_empty() {
            let _given = self.settle();
        }
        self.owns = false;
        let mut words = [0; 8];
        let tag = self.client.next_tag();
        let request = etherbone::Request::new(&mut words)
            .write(map::SESSION_RELEASE, token)
            .read(tag, &[map::SESSION_OWNER_PORT]);
        if let Some(request) = request.words() {
            let _gone = self.client.once(request, tag..=tag, 1);
        }
    }

    /// Each try has a sequence number of its own: one that was executed is not executed again, and
    /// feeds nothing.
    fn exchange(&mut self, block: &[u32]) -> Option<(u32, Vec<u32>)> {
        if !self.waiting.is_empty() && self.settle().is_none() {
            self.failed();
        }
        if self.hole {
            return None;
        }
        let end = Instant::now() + PATIENCE;
        let first = self.sequence.wrapping_add(1);
        let (mut words, mut block) = ([0; MAX_WORDS], block.to_vec());
        while Instant::now() < end {
            self.sequence = self.sequence.wrapping_add(1);
            *block.get_mut(1)? = self.sequence;
            let request = etherbone::Request::new(&mut words).write(map::COMMAND, &block);
            let tags = first..=self.sequence;
            match self.client.once(request.words()?, tags, self.status_words) {
                Ok(Some(answer)) => return Some(answer),
                Ok(None) => {}
                Err(_) => std::thread::sleep(TRY),
            }
        }
        None
    }

    /// Sends what waits for the segments, and asks them how they are.
    fn settle(&mut self) -> Option<()> {
        let waiting = core::mem::take(&mut self.waiting);
        self.pushes = 0;
        let addresses = READS.map(address);
        let mut said = if waiting.is_empty() {
            self.client.read(&addresses).ok()?
        } else {
            self.write(&waiting, &addresses)?
        };
        loop {
            let words: &[u32; READS.len()] = said.first_chunk()?;
            for (word, said) in READS.iter().zip(words) {
                self.known[*word] = *said;
            }
            self.known_at = Some(Instant::now());
            let [before, _, behind, ..] = words;
            if before == behind {
                return Some(());
            }
            said = self.client.read(&addresses).ok()?;
        }
    }

    /// Writes these once.
    fn write(&mut self, waiting: &[(usize, u32)], reads: &[u32]) -> Option<Vec<u32>> {
        let last = match self.number {
            Some(number) => number,
            None => *self.client.read(&[map::SESSION_SEGMENTS]).ok()?.first()?,
        };
        let number = last.wrapping_add(1);
        let mut words = [0; MAX_WORDS];
        let mut request =
            etherbone::Request::new(&mut words).write(map::SESSION_SEGMENTS, &[number]);
        for run in waiting.chunk_by(|(one, _), (next, _)| one + 1 == *next) {
            let values: Vec<u32> = run.iter().map(|(_, value)| *value).collect();
            request = request.write(address(run[0].0), &values);
        }
        let tag = self.client.next_tag();
        let request = request.read(tag, reads).words()?;
        let end = Instant::now() + PATIENCE;
        while Instant::now() < end {
            if let Ok(Some((_, said))) = self.client.once(request, tag..=tag, reads.len()) {
                self.number = Some(number);
                return Some(said);
            }
            // Was the request lost, or its answer?
            match self.client.read(&[map::SESSION_SEGMENTS]).ok()?.first() {
                Some(there) if *there == number => {
                    self.number = Some(number);
                    return self.client.read(reads).ok();
                }
                Some(there) if *there == last => {}
                Some(_) | None => return None,
            }
        }
        None
    }
}

fn address(word: usize) -> u32 {
    regmap::address(regmap::segments::BASE, word)
}
