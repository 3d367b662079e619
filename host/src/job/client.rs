//! Jobs on a board: [`wire::jobs`] over TCP, with retries after network errors.
//!
//! After a broken connection the client connects again and repeats the unanswered request under its
//! old id; the board acts on it once. An interrupted upload continues where it stopped. The board
//! has one connection for one client, so a client closes it when it has nothing to say:
//! [`Board::hang_up`] between two looks. Stop and Pause are taken without the line: [`halt`].

use crate::address::Address;
use crate::client::{Client, ClientError};
use crate::keys::{KeyError, Keys};
use std::io::{self, Read, Write};
use std::net::{Shutdown, SocketAddr, SocketAddrV4, TcpStream};
use std::time::{Duration, Instant};
use wire::crc::crc32;
use wire::jobs::{
    DATA, Entry, FRAME, Field, Frame, JobCommand, MachineConfig, NAME, Op, Report, Request, Status,
    VERSION, Welcome, Words, word,
};
use wire::{DEFAULT_PORT, Name};

/// A board answers in milliseconds, a simulated one in seconds.
const PATIENCE: Duration = Duration::from_secs(20);
/// A request is sent so many times within [`PATIENCE`].
const TRIES: u32 = 4;
/// Between two tries of a connection that is refused, or that another client has.
const AGAIN: Duration = Duration::from_millis(50);
/// A healthy board hangs up within a round trip.
const FAREWELL: Duration = Duration::from_secs(1);

/// Why a board did not do it.
#[derive(Debug)]
pub enum JobError {
    /// No connection, or it broke and could not be made again.
    Line(SocketAddrV4, io::Error),
    /// It is connected and says nothing.
    Silent(SocketAddrV4, Op),
    /// Its answer is not a valid one.
    Strange(SocketAddrV4, Op),
    /// Of another version.
    Version(SocketAddrV4, u16),
    /// It refused, and said why.
    Refused(Op, Status, Option<Detail>),
    /// A name a board cannot store.
    Name(String),
    /// A job that no board can hold.
    Long(usize),
    /// It has a key, and we have none that fits.
    Key(KeyError),
    /// It has a key, and its unique id could not be read.
    Uid(ClientError),
    /// The board restarted meanwhile.
    Restarted,
}

/// What a refusal carries.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Detail {
    /// Bytes free in the store.
    Free(u32),
    /// The offset of something in the job.
    Offset(u32),
    /// What is wrong with the machine, and with which axis.
    MachineConfig(Field, u8),
}

impl Detail {
    fn parse(status: Status, payload: &[u8]) -> Option<Detail> {
        match status {
            Status::Full => word(payload).map(Detail::Free),
            Status::Offset | Status::Incomplete | Status::NoJob => {
                word(payload).map(Detail::Offset)
            }
            Status::MachineConfig => match *payload {
                [field, axis] => Some(Detail::MachineConfig(Field::from_code(field)?, axis)),
                _ => None,
            },
            _ => None,
        }
    }
}

/// X, Y, Z.
pub fn axis_name(axis: u8) -> &'static str {
    ["X", "Y", "Z"]
        .get(usize::from(axis))
        .copied()
        .unwrap_or("?")
}

impl std::fmt::Display for JobError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            JobError::Line(at, error) => write!(
                f,
                "no connection to the jobs of {at} ({error}); is it a board with jobs (ferrocnc describe), and is this its address?"
            ),
            JobError::Silent(at, op) => write!(
                f,
                "{at} did not answer ({op}) for {} s; check cable and power",
                PATIENCE.as_secs()
            ),
            JobError::Strange(at, op) => write!(
                f,
                "{at} answered {op} with an unknown message; update the board or this program"
            ),
            JobError::Version(at, theirs) => write!(
                f,
                "{at} speaks version {theirs} of the protocol of jobs, this program {VERSION}; update the older one"
            ),
            JobError::Refused(_, status, detail) => {
                f.write_str(status.text())?;
                match *detail {
                    None => Ok(()),
                    Some(Detail::Free(bytes)) => write!(f, " ({bytes} bytes are free)"),
                    Some(Detail::Offset(offset)) => write!(f, " (at byte {offset})"),
                    Some(Detail::MachineConfig(field, axis)) => {
                        write!(f, ": {}: {}", axis_name(axis), field.text())
                    }
                }
            }
            JobError::Name(name) => write!(
                f,
                "{name:?} is not a name for a job on a board: 1 to {NAME} bytes, printable; --name gives another"
            ),
            JobError::Long(bytes) => write!(f, "a job of {bytes} bytes fits on no board"),
            JobError::Key(error) => error.fmt(f),
            JobError::Uid(error) => write!(
                f,
                "the board has a key, but its unique id cannot be read ({error}); name the key's file: --key FILE"
            ),
            JobError::Restarted => f.write_str(
                "the board restarted: its store and its machine are gone; send both again",
            ),
        }
    }
}

impl std::error::Error for JobError {}

/// The payload of an answer without a refusal.
type Payload = Vec<u8>;

/// A board that executes jobs, and the line to it while there is one.
#[derive(Debug)]
pub struct Board {
    at: SocketAddrV4,
    client: u32,
    id: u16,
    line: Option<Connection>,
    welcome: Welcome,
    keys: Keys,
    patience: Duration,
}

#[derive(Debug)]
struct Connection {
    stream: TcpStream,
    heard: Vec<u8>,
}

/// How one try went wrong.
enum Broken {
    Io(io::Error),
    Busy,
    Silent,
    Strange,
}

impl Board {
    /// Connects, and gets to know it.
    pub fn open(address: &Address, keys: Keys) -> Result<Board, JobError> {
        Board::with_patience(address.socket, keys, PATIENCE)
    }

    /// As [`Board::open`], giving up after this long.
    pub fn with_patience(
        at: SocketAddrV4,
        keys: Keys,
        patience: Duration,
    ) -> Result<Board, JobError> {
        let mut board = Board {
            at,
            client: number(),
            id: 0,
            line: None,
            welcome: Welcome::default(),
            keys,
            patience,
        };
        board.connect()?;
        Ok(board)
    }

    /// What it said of itself.
    pub fn welcome(&self) -> &Welcome {
        &self.welcome
    }

    /// Closes the connection, so that another client can connect. The next request makes a new one.
    pub fn hang_up(&mut self) {
        let Some(line) = self.line.take() else {
            return;
        };
        // We close first and wait until the board closes, so that it is free for the next client.
        // An error here does no harm.
        let _ = line.stream.shutdown(Shutdown::Write);
        let _ = line.stream.set_read_timeout(Some(FAREWELL));
        let mut rest = [0; 256];
        while let Ok(1..) = (&line.stream).read(&mut rest) {}
    }

    fn connect(&mut self) -> Result<(), JobError> {
        if self.line.is_some() {
            return Ok(());
        }
        let began = Instant::now();
        loop {
            let broken = match self.try_connect() {
                Ok(()) if self.welcome.version == VERSION => return Ok(()),
                Ok(()) => return Err(JobError::Version(self.at, self.welcome.version)),
                Err(broken) => broken,
            };
            self.line = None;
            let late = began.elapsed() >= self.patience;
            match broken {
                Broken::Io(error) if late || error.kind() == io::ErrorKind::ConnectionRefused => {
                    return Err(JobError::Line(self.at, error));
                }
                Broken::Busy if late => {
                    return Err(JobError::Refused(Op::Hello, Status::Busy, None));
                }
                Broken::Silent if late => return Err(JobError::Silent(self.at, Op::Hello)),
                Broken::Strange => return Err(JobError::Strange(self.at, Op::Hello)),
                Broken::Io(_) | Broken::Busy | Broken::Silent => std::thread::sleep(AGAIN),
            }
        }
    }

    fn try_connect(&mut self) -> Result<(), Broken> {
        let stream = TcpStream::connect_timeout(&SocketAddr::V4(self.at), self.patience / TRIES);
        let stream = stream.map_err(Broken::Io)?;
        // Requests are small and waited for.
        stream.set_nodelay(true).map_err(Broken::Io)?;
        self.line = Some(Connection {
            stream,
            heard: Vec::new(),
        });
        let client = self.client;
        self.id = self.id.wrapping_add(1);
        let (status, payload) = self.exchange(&Request::Hello { client }, self.id)?;
        match (status, Welcome::parse(&payload)) {
            (Status::Busy, _) => Err(Broken::Busy),
            (Status::Normal, Some(welcome)) => {
                self.welcome = welcome;
                Ok(())
            }
            _ => Err(Broken::Strange),
        }
    }

    /// Answers the board's challenge with each key that it may have, in turn. Only then, because
    /// the last request must stay the last one.
    fn prove(&mut self) -> Result<(), JobError> {
        let mut uid = [0; 2];
        let mut left = None;
        let mut tried = Vec::new();
        loop {
            let challenge = self.challenge()?;
            if left.is_none() {
                uid = match self.keys {
                    Keys::File(_) => [0; 2],
                    Keys::ByBoard => self.uid()?,
                };
                left = Some(self.keys.find(uid).map_err(JobError::Key)?.into_iter());
            }
            let Some((key, path)) = left.as_mut().and_then(Iterator::next) else {
                return Err(JobError::Key(KeyError::Wrong(tried)));
            };
            let words = key.acquire(challenge, self.client);
            self.id = self.id.wrapping_add(1);
            match self.exchange(&Request::Respond { words }, self.id) {
                Ok((Status::Normal, _)) => {
                    self.keys.accepted(uid, &path);
                    return Ok(());
                }
                Ok(_) => tried.push(path),
                Err(_) => return Err(JobError::Silent(self.at, Op::Respond)),
            }
        }
    }

    fn challenge(&mut self) -> Result<[u32; wire::auth::WORDS], JobError> {
        self.id = self.id.wrapping_add(1);
        let asked = self.exchange(&Request::Challenge, self.id);
        let challenge = match asked {
            Ok((Status::Normal, payload)) => four(&payload),
            Ok((status, _)) => return Err(JobError::Refused(Op::Challenge, status, None)),
            Err(_) => return Err(JobError::Silent(self.at, Op::Challenge)),
        };
        // While the session has an owner the board gives no challenge.
        challenge
            .filter(|words| *words != wire::auth::NONE)
            .ok_or(JobError::Refused(Op::Challenge, Status::Owned, None))
    }

    fn uid(&self) -> Result<[u32; 2], JobError> {
        let socket = SocketAddrV4::new(*self.at.ip(), DEFAULT_PORT);
        let address = Address {
            text: socket.to_string(),
            socket,
        };
        let mut client = Client::open(&address).map_err(JobError::Uid)?;
        Ok(client.locked().map_err(JobError::Uid)?.1)
    }

    /// One request on the line there is.
    fn exchange(&mut self, request: &Request, id: u16) -> Result<(Status, Payload), Broken> {
        let mut frame = [0; FRAME];
        let length = request.emit(id, &mut frame);
        let line = self.line.as_mut().ok_or(Broken::Silent)?;
        line.stream
            .write_all(&frame[..length])
            .map_err(Broken::Io)?;
        let until = Instant::now() + self.patience / TRIES;
        loop {
            let answer = line.frame(until)?;
            let (frame, _) = Frame::parse(&answer)
                .ok()
                .flatten()
                .ok_or(Broken::Strange)?;
            // While another client is connected the board answers any request with this status.
            if Status::from_code(frame.status) == Some(Status::Busy) {
                return Ok((Status::Busy, Vec::new()));
            }
            let (op, status) = frame.answer().ok_or(Broken::Strange)?;
            if (op, frame.id) == (request.op(), id) {
                return Ok((status, frame.payload.to_vec()));
            }
        }
    }

    /// A request, until it is answered: over a new connection under its old id if need be.
    pub fn ask(&mut self, request: &Request) -> Result<Payload, JobError> {
        let op = request.op();
        self.connect()?;
        self.id = self.id.wrapping_add(1);
        let mut id = self.id;
        let (began, boot) = (Instant::now(), self.welcome.boot_id);
        let mut proven = false;
        loop {
            let broken = match self.exchange(request, id) {
                Ok((Status::Normal, payload)) => return Ok(payload),
                Ok((Status::Key, _)) if !proven => {
                    self.prove()?;
                    proven = true;
                    // Another request: this one was answered.
                    self.id = self.id.wrapping_add(1);
                    id = self.id;
                    continue;
                }
                Ok((Status::Busy | Status::Garbled, _)) => Broken::Silent,
                Ok((status, payload)) => {
                    return Err(JobError::Refused(
                        op,
                        status,
                        Detail::parse(status, &payload),
                    ));
                }
                Err(broken) => broken,
            };
            self.line = None;
            if began.elapsed() >= self.patience {
                return Err(match broken {
                    Broken::Io(error) => JobError::Line(self.at, error),
                    Broken::Busy | Broken::Silent => JobError::Silent(self.at, op),
                    Broken::Strange => JobError::Strange(self.at, op),
                });
            }
            proven = false;
            // For the board the Hello is not this client's last request; the repeated one is.
            self.connect()?;
            if self.welcome.boot_id != boot {
                return Err(JobError::Restarted);
            }
        }
    }

    fn strange(&self, op: Op) -> JobError {
        JobError::Strange(self.at, op)
    }

    /// Puts a job into the store; what was cut goes on where it was cut. `shown` is told bytes
    /// there and bytes in all.
    pub fn send(
        &mut self,
        name: &str,
        job: &[u8],
        mut shown: impl FnMut(usize, usize),
    ) -> Result<Entry, JobError> {
        let put = Request::Put {
            total: u32::try_from(job.len()).map_err(|_| JobError::Long(job.len()))?,
            crc: crc32(job),
            name: self::name(name)?,
        };
        let mut offset = self.offset(&put)?;
        loop {
            shown(offset, job.len());
            let Some(rest) = job.get(offset..).filter(|rest| !rest.is_empty()) else {
                break;
            };
            let bytes = &rest[..rest.len().min(DATA)];
            let data = Request::Data {
                offset: offset as u32,
                bytes,
            };
            offset = match self.offset(&data) {
                Ok(offset) => offset,
                // Another client came between, or an answer was lost: the board knows the offset.
                Err(JobError::Refused(
                    _,
                    Status::Offset | Status::NoSuchJob | Status::NoHello,
                    _,
                )) => self.offset(&put)?,
                Err(error) => return Err(error),
            };
        }
        let payload = match self.ask(&Request::Commit) {
            Err(JobError::Refused(_, Status::NoSuchJob, _)) => {
                self.offset(&put)?;
                self.ask(&Request::Commit)?
            }
            other => other?,
        };
        Entry::parse(&payload).ok_or_else(|| self.strange(Op::Commit))
    }

    fn offset(&mut self, request: &Request) -> Result<usize, JobError> {
        let payload = self.ask(request)?;
        let offset = word(&payload).ok_or_else(|| self.strange(request.op()))?;
        Ok(offset as usize)
    }

    /// What is in the store.
    pub fn list(&mut self) -> Result<Vec<Entry>, JobError> {
        let mut entries: Vec<Entry> = Vec::new();
        loop {
            let index = entries.len() as u8;
            let payload = match self.ask(&Request::List { index }) {
                Err(JobError::Refused(_, Status::NoSuchJob, _)) => return Ok(entries),
                other => other?,
            };
            let entry = Entry::parse(&payload).ok_or_else(|| self.strange(Op::List))?;
            entries.push(entry);
            if entries.len() >= usize::from(entry.count) {
                return Ok(entries);
            }
        }
    }

    /// Takes a job out of the store; how many bytes are free then.
    pub fn delete(&mut self, name: &str) -> Result<u32, JobError> {
        let name = self::name(name)?;
        let payload = self.ask(&Request::Delete { name })?;
        word(&payload).ok_or_else(|| self.strange(Op::Delete))
    }

    /// Tells it which machine it moves.
    pub fn put_machine(&mut self, machine: &MachineConfig) -> Result<(), JobError> {
        self.ask(&Request::PutMachine(*machine)).map(drop)
    }

    /// The board's report.
    pub fn report(&mut self) -> Result<Report, JobError> {
        let payload = self.ask(&Request::Report)?;
        Report::parse(&payload).ok_or_else(|| self.strange(Op::Report))
    }

    /// One of XYPenPlotter's codes that needs no more than itself.
    pub fn command(&mut self, code: JobCommand) -> Result<Report, JobError> {
        self.commanded(code, 0, 0, Name::EMPTY)
    }

    /// Starts a job. `keepalive`: how long we may be silent; none: it goes on without us.
    pub fn start(&mut self, name: &str, keepalive: Option<Duration>) -> Result<Report, JobError> {
        let (flags, millis) = attendance(keepalive);
        self.commanded(JobCommand::Start, flags, millis, self::name(name)?)
    }

    /// Finds the switches of these axes; of none: of all that have one.
    pub fn home(
        &mut self,
        axes: [bool; wire::jobs::AXES],
        keepalive: Option<Duration>,
    ) -> Result<Report, JobError> {
        let (flags, millis) = attendance(keepalive);
        self.commanded(
            JobCommand::Calibrate,
            flags | bits(axes),
            millis,
            Name::EMPTY,
        )
    }

    /// These axes, which have no switch, are at 0 where they stand; of none: all that have no
    /// switch.
    pub fn here(&mut self, axes: [bool; wire::jobs::AXES]) -> Result<Report, JobError> {
        self.commanded(JobCommand::Here, bits(axes), 0, Name::EMPTY)
    }

    /// How fast, in percent of what the job says.
    pub fn feed(&mut self, percent: u16) -> Result<Report, JobError> {
        let payload = self.ask(&Request::Feed { percent })?;
        Report::parse(&payload).ok_or_else(|| self.strange(Op::Feed))
    }

    /// A command of FPGA G's protocol, with the words of instructions in this form; the board's
    /// status word.
    pub fn words(&mut self, command: u8, form: u8, words: &[u32]) -> Result<u32, JobError> {
        let bytes: Vec<[u8; 4]> = words.iter().map(|word| word.to_le_bytes()).collect();
        let payload = self.ask(&Request::Segment {
            command,
            form,
            words: Words::new(&bytes),
        })?;
        word(&payload).ok_or_else(|| self.strange(Op::Segment))
    }

    fn commanded(
        &mut self,
        code: JobCommand,
        flags: u8,
        keepalive: u16,
        name: Name,
    ) -> Result<Report, JobError> {
        let payload = self.ask(&Request::Command {
            code: code.code(),
            flags,
            keepalive,
            name,
        })?;
        Report::parse(&payload).ok_or_else(|| self.strange(Op::Command))
    }
}

/// Stops or pauses whatever the board executes, also while another client has the line, and without
/// a key.
pub fn halt(at: SocketAddrV4, code: JobCommand) -> Result<Report, JobError> {
    halt_within(at, code, PATIENCE)
}

/// As [`halt`], giving up after this long.
pub fn halt_within(
    at: SocketAddrV4,
    code: JobCommand,
    patience: Duration,
) -> Result<Report, JobError> {
    let began = Instant::now();
    loop {
        let broken = match try_to_halt(at, code, patience / TRIES) {
            Ok(answered) => return answered,
            Err(broken) => broken,
        };
        let late = began.elapsed() >= patience;
        match broken {
            Broken::Io(error) if late || error.kind() == io::ErrorKind::ConnectionRefused => {
                return Err(JobError::Line(at, error));
            }
            Broken::Busy if late => {
                return Err(JobError::Refused(Op::Command, Status::Busy, None));
            }
            Broken::Silent if late => return Err(JobError::Silent(at, Op::Command)),
            Broken::Strange => return Err(JobError::Strange(at, Op::Command)),
            Broken::Io(_) | Broken::Busy | Broken::Silent => std::thread::sleep(AGAIN),
        }
    }
}

/// Says Hello and the command in one go: the board takes the command even if another client has the
/// connection.
fn try_to_halt(
    at: SocketAddrV4,
    code: JobCommand,
    patience: Duration,
) -> Result<Result<Report, JobError>, Broken> {
    let stream = TcpStream::connect_timeout(&SocketAddr::V4(at), patience).map_err(Broken::Io)?;
    stream.set_nodelay(true).map_err(Broken::Io)?;
    let requests = [
        Request::Hello { client: number() },
        Request::Command {
            code: code.code(),
            flags: 0,
            keepalive: 0,
            name: Name::EMPTY,
        },
    ];
    let (mut said, mut frame) = (Vec::new(), [0; FRAME]);
    for (id, request) in (1..).zip(requests) {
        let length = request.emit(id, &mut frame);
        said.extend_from_slice(&frame[..length]);
    }
    let mut line = Connection {
        stream,
        heard: Vec::new(),
    };
    line.stream.write_all(&said).map_err(Broken::Io)?;
    let until = Instant::now() + patience;
    let mut busy = false;
    loop {
        let answer = match line.frame(until) {
            // A board of before said no more than that.
            Err(Broken::Io(_)) if busy => return Err(Broken::Busy),
            answer => answer?,
        };
        let parsed = Frame::parse(&answer).ok().flatten();
        let (frame, _) = parsed.ok_or(Broken::Strange)?;
        match frame.answer().ok_or(Broken::Strange)? {
            (Op::Hello, status) => busy = status == Status::Busy,
            (Op::Command, Status::Normal) => {
                let report = Report::parse(frame.payload);
                return Ok(report.ok_or(JobError::Strange(at, Op::Command)));
            }
            (Op::Command, Status::Busy) => return Err(Broken::Busy),
            (op, status) => return Ok(Err(JobError::Refused(op, status, None))),
        }
    }
}

impl Drop for Board {
    fn drop(&mut self) {
        self.hang_up();
    }
}

impl Connection {
    /// The next whole frame.
    fn frame(&mut self, until: Instant) -> Result<Vec<u8>, Broken> {
        let mut buffer = [0; 2048];
        loop {
            match Frame::parse(&self.heard) {
                Ok(Some((_, length))) => {
                    let rest = self.heard.split_off(length);
                    return Ok(std::mem::replace(&mut self.heard, rest));
                }
                Ok(None) => {}
                Err(_) => return Err(Broken::Strange),
            }
            let left = until.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return Err(Broken::Silent);
            }
            let timeout = self.stream.set_read_timeout(Some(left));
            timeout.map_err(Broken::Io)?;
            match self.stream.read(&mut buffer) {
                Ok(0) => return Err(Broken::Io(io::ErrorKind::UnexpectedEof.into())),
                Ok(length) => self.heard.extend_from_slice(&buffer[..length]),
                Err(error) => match error.kind() {
                    io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut => {
                        return Err(Broken::Silent);
                    }
                    io::ErrorKind::Interrupted => {}
                    _ => return Err(Broken::Io(error)),
                },
            }
        }
    }
}

fn attendance(keepalive: Option<Duration>) -> (u8, u16) {
    match keepalive {
        None => (wire::jobs::UNATTENDED, 0),
        Some(time) => (0, u16::try_from(time.as_millis()).unwrap_or(u16::MAX)),
    }
}

/// A bit for each of them.
fn bits(axes: [bool; wire::jobs::AXES]) -> u8 {
    let bits = (0..).zip(axes).filter(|(_, named)| *named);
    bits.fold(0, |bits, (axis, _)| bits | 1 << axis)
}

fn four(payload: &[u8]) -> Option<[u32; 4]> {
    let (words, rest) = payload.as_chunks::<4>();
    let words: &[[u8; 4]; 4] = words.try_into().ok()?;
    rest.is_empty().then_some(words.map(u32::from_le_bytes))
}

/// A name as the board stores it.
pub fn name(text: &str) -> Result<Name, JobError> {
    let wrong = || JobError::Name(text.to_owned());
    let fits = (1..=NAME).contains(&text.len());
    Name::new(text).ok().filter(|_| fits).ok_or_else(wrong)
}

/// The client's number: random, so that no two clients share one; never 0.
fn number() -> u32 {
    let mut bytes = [0; 4];
    // Without random numbers the process id and the time are used.
    if getrandom::fill(&mut bytes).is_err() {
        bytes = std::process::id().to_le_bytes();
    }
    u32::from_le_bytes(bytes).max(1)
}
