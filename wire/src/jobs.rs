//! Jobs over TCP: uploads into the board's store, and an operator's commands to a plotter.
//!
//! ```text
//! request   op:u8        0:u8       id:u16  length:u16  0:u16  payload[length]  crc:u32        all little endian
//! answer    op+0x80:u8  status:u8   id:u16  length:u16  0:u16  payload[length]  crc:u32
//! crc       CRC-32 (Ethernet's) of everything before it, beginning at op
//! ```
//!
//! There is one connection at a time, at TCP port [`PORT`]. The board closes a connection that is
//! silent for [`SILENCE_SECONDS`]. An invalid frame (CRC, reserved bytes, length) ends its
//! connection: the answer is [`Status::Garbled`], and nothing is executed. Every other request has
//! exactly one answer, in order; a client may send requests before earlier answers arrive.
//!
//! **A second client**, which connects while there is another one, gets [`Status::Busy`] as if
//! it had sent a Hello. Then the board reads one request of it. [`JobCommand::Stop`],
//! [`JobCommand::Pause`] and the STOP of Segment are executed and answered, with or without a Hello
//! and the key; any other request gets [`Status::Busy`]. That is the end of the connection. The
//! client need not wait for any answer: Hello and Stop in one packet are right in every case.
//!
//! **A client** is identified by the number in its [`Request::Hello`], the first request of a
//! connection, and not by its address: the same number over a new connection is the same client. A
//! request with the id and the op of the same client's last one is a repetition: it gets the same
//! answer again and is not executed again. The same request with another id is executed.
//!
//! | op | request | answer |
//! |---|---|---|
//! | 1 Hello | client:u32, never 0 | [`Welcome`] |
//! | 2 Put | total:u32 crc:u32 name | offset:u32, from where to go on |
//! | 3 Data | offset:u32 bytes, at most [`DATA`] | offset:u32 of the next |
//! | 4 Commit | | the [`Entry`] |
//! | 5 List | index:u8 | the [`Entry`] |
//! | 6 Delete | name | free:u32 |
//! | 7 GetMachine | | a [`MachineConfig`] |
//! | 8 PutMachine | a [`MachineConfig`] | |
//! | 9 Command | code:u8 flags:u8 keepalive:u16 name | a [`Report`] |
//! | 10 Report | | a [`Report`] |
//! | 11 Segment | command:u8 form:u8 0:u16 words:u32.. | FPGA G's status word |
//! | 12 Feed | percent:u16, 1 to 200 | a [`Report`] |
//! | 13 Challenge | | 4 words, zeros without a key |
//! | 14 Respond | 4 words | |
//!
//! **Upload**: Put names a job, its length and its CRC-32. The board answers how much of exactly
//! this job it already has: 0, the part before an interruption, or all. Data continue in order from
//! there; Commit compares the whole CRC and checks the job. The first Put of another content
//! deletes an older job of that name. An unfinished upload stays until it is continued or deleted,
//! or the power goes off.
//!
//! **MachineConfig**: a job needs one; it holds what the planner and the drives have to know
//! ([`MachineConfig`]). It is kept until the power goes off.
//!
//! **Command** takes XYPenPlotter's codes ([`JobCommand`]); others are refused. Stop is valid in
//! every state. A code that does not fit the state gets [`Status::NotNow`]. A Start is answered
//! before the job is checked: the check's result is the [`End`] of a [`Report`], with axis and
//! line. A refused command is answered without a report.
//!
//! **The key**: on a board with a key, a connection that has not proved it may only read and stop
//! ([`Status::Key`]). It proves the key with the answer ([`crate::auth`], to acquire, its nonce the
//! client's number) to the last Challenge, which the board gives while the session has no owner.
//!
//! **Segment** is FPGA G's protocol (`fpgag` of the crate `jobs`): one of its commands and, for
//! GCODE, words of one or several instructions. The answer is its status word: 0 normal, bit 0
//! FULL, bit 1 DISPATCHERROR. Refused words change nothing; START and STOP need what a start needs.

use crate::Name;
use crate::codes::codes;
use crate::crc::crc32;

mod machine;
mod report;

pub use machine::{AXES, Axis, Field, Home, MachineConfig};
pub use report::{End, Report, State};

/// TCP port of jobs: not registered, and below the ports a host uses for its own connections.
pub const PORT: u16 = 724;

/// Version of this module. Both sides must have the same.
pub const VERSION: u16 = 1;

/// Longest payload, in bytes.
pub const PAYLOAD: usize = 1024;

/// Bytes around a payload.
pub const OVERHEAD: usize = HEAD + 4;

/// Longest frame, in bytes.
pub const FRAME: usize = PAYLOAD + OVERHEAD;

/// Largest number of bytes of a job in a Data request.
pub const DATA: usize = PAYLOAD - 4;

/// Longest name of a job, in bytes; the shortest is 1.
pub const NAME: usize = 31;

/// Largest number of words in a Segment request.
pub const WORDS: usize = PAYLOAD / 4 - 1;

/// 10 s without a request: a live client asks for a report more often.
pub const SILENCE_SECONDS: u32 = 10;

const HEAD: usize = 8;
const ANSWER: u8 = 0x80;

codes! {
    /// The kind of a request.
    Op: u8 {
        /// Identifies the client, and asks for the board.
        Hello = 1, "hello";
        /// Begin or continue an upload.
        Put = 2, "put";
        /// Bytes of it.
        Data = 3, "data";
        /// It is complete.
        Commit = 4, "commit";
        /// Read an entry of the store.
        List = 5, "list";
        /// Delete a job.
        Delete = 6, "delete";
        /// Read the machine.
        GetMachine = 7, "get machine";
        /// Set the machine.
        PutMachine = 8, "put machine";
        /// One of XYPenPlotter's codes.
        Command = 9, "command";
        /// Read the report.
        Report = 10, "report";
        /// FPGA G's protocol.
        Segment = 11, "segment";
        /// Set the feed.
        Feed = 12, "feed";
        /// Ask for the challenge to prove the key.
        Challenge = 13, "challenge";
        /// The answer.
        Respond = 14, "respond";
    }
}

codes! {
    /// The outcome of a request. 0 is normal; any other value means that nothing has changed.
    Status: u8 {
        /// Done.
        Normal = 0, "normal";
        /// Another client is connected.
        Busy = 1, "another client is connected to the board's jobs: try again";
        /// The frame's CRC, length or reserved bytes are wrong; the connection is over.
        Garbled = 2, "the frame arrived garbled";
        /// No such op.
        UnknownOp = 3, "the board does not know this request: its firmware is older than this program";
        /// The payload does not fit this op.
        Malformed = 4, "the request has a wrong payload";
        /// The first request of a connection must be Hello.
        NoHello = 5, "the connection did not begin with Hello";
        /// No job of this name, or no upload to continue.
        NoSuchJob = 6, "the board has no such job";
        /// The store has no room; payload: bytes that are free.
        Full = 7, "the board's store is full: delete a job";
        /// These bytes are not the next ones; payload: the offset of the next.
        Offset = 8, "these bytes of the job are not the next ones";
        /// The upload's CRC is not the one in Put; the upload starts again.
        Crc = 9, "the job arrived garbled: send it again";
        /// The upload is not complete; payload: the bytes received.
        Incomplete = 10, "the job is not complete: send the rest";
        /// The upload is complete, but it is not a job that this board can read; payload: offset of
        /// the block.
        NoJob = 11, "this is no job of a version the board can read: prepare it anew";
        /// No machine was set.
        NoMachine = 12, "the board does not know its machine: send a machine description first";
        /// The machine is impossible; payload: [`Field`], axis.
        MachineConfig = 13, "the machine description is not possible";
        /// No such command code.
        UnknownCode = 14, "there is no command with this code";
        /// Not in this state.
        NotNow = 15, "not now: the state of the board does not allow that";
        /// Another client, perhaps LinuxCNC, owns the session.
        Owned = 16, "the board is owned by a session: stop LinuxCNC or the client that owns it";
        /// An axis that is to be homed has no switch, or none of them has.
        NoSwitch = 19, "this axis has no switch";
        /// An axis that is declared to be at 0 has a switch, or all axes have one.
        HasSwitch = 25, "this axis has a switch: home it";
        /// The name is empty, too long or not printable.
        Name = 20, "a job's name has 1 to 31 printable bytes";
        /// The gateware has no segments core, or the memory failed its test.
        NoJobs = 22, "this board cannot execute jobs";
        /// A value is out of its range.
        Value = 23, "a value is out of its range";
        /// The connection has not proved the board's key.
        Key = 24, "the board has a key, and this is not its holder: --key FILE";
    }
}

codes! {
    /// XYPenPlotter's codes.
    JobCommand: u8 {
        /// End the current work, along the path.
        Stop = 0, "stop";
        /// Continue after a pause.
        Continue = 1, "continue";
        /// Execute the job of this name.
        Start = 2, "start";
        /// Continue after a pause; a synonym of Continue.
        Unpause = 9, "unpause";
        /// Stand still on the path.
        Pause = 10, "pause";
        /// Home the axes: those with a bit in `flags`, or all that have a switch if there is no
        /// bit.
        Calibrate = 11, "calibrate";
        /// Ask whether the board is there.
        Welcome = 12, "welcome";
        /// Declare the axes to be at 0: those with a bit in `flags`, which have no switch, or all
        /// without a switch if there is no bit. This code is not one of XYPenPlotter's.
        Here = 13, "here";
    }
}

/// Flag of a Start: the job continues if the client stops asking. Without it, `keepalive` is how
/// long the client that started it may be silent.
pub const UNATTENDED: u8 = 1 << 7;

/// The shortest and the longest keepalive, in milliseconds.
pub const KEEPALIVE_MS: core::ops::RangeInclusive<u16> = 100..=60_000;

/// A frame with a right CRC, a request or an answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Frame<'a> {
    /// An op, plus 0x80 in an answer.
    pub op: u8,
    /// The status, in an answer.
    pub status: u8,
    /// The client's number for the request.
    pub id: u16,
    /// The payload of the op.
    pub payload: &'a [u8],
}

/// Bytes that are not a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Garbled;

impl<'a> Frame<'a> {
    /// The frame at the beginning of `bytes`, and its length; `None`: some of it is still missing.
    pub fn parse(bytes: &'a [u8]) -> Result<Option<(Frame<'a>, usize)>, Garbled> {
        let Some(&[op, status, id0, id1, len0, len1, zero0, zero1]) = bytes.first_chunk::<HEAD>()
        else {
            return Ok(None);
        };
        let length = usize::from(u16::from_le_bytes([len0, len1]));
        if length > PAYLOAD || (zero0, zero1) != (0, 0) || (op & ANSWER == 0 && status != 0) {
            return Err(Garbled);
        }
        let Some((content, rest)) = bytes.split_at_checked(HEAD + length) else {
            return Ok(None);
        };
        let Some(crc) = rest.first_chunk() else {
            return Ok(None);
        };
        if u32::from_le_bytes(*crc) != crc32(content) {
            return Err(Garbled);
        }
        let frame = Frame {
            op,
            status,
            id: u16::from_le_bytes([id0, id1]),
            payload: content.get(HEAD..).unwrap_or(&[]),
        };
        Ok(Some((frame, OVERHEAD + length)))
    }

    /// The number of bytes [`Frame::parse`] needs, as far as these bytes tell: with fewer it
    /// returns `None`.
    pub fn needs(bytes: &[u8]) -> usize {
        match bytes.first_chunk::<HEAD>() {
            Some(&[.., len0, len1, _, _]) => {
                OVERHEAD + usize::from(u16::from_le_bytes([len0, len1])).min(PAYLOAD)
            }
            None => HEAD,
        }
    }

    /// For an answer: the request it answers, and the status.
    pub fn answer(&self) -> Option<(Op, Status)> {
        let op = Op::from_code(self.op.checked_sub(ANSWER)?)?;
        Some((op, Status::from_code(self.status)?))
    }
}

/// Writes a request to `out`; returns its length. `fill` writes the payload.
pub fn request(op: Op, id: u16, out: &mut [u8; FRAME], fill: impl FnOnce(&mut Writer)) -> usize {
    emit(op.code(), 0, id, out, fill)
}

/// Writes an answer to op `op` (as it came) to `out`; returns its length.
pub fn answer(
    op: u8,
    status: Status,
    id: u16,
    out: &mut [u8; FRAME],
    fill: impl FnOnce(&mut Writer),
) -> usize {
    emit(op | ANSWER, status.code(), id, out, fill)
}

fn emit(
    op: u8,
    status: u8,
    id: u16,
    out: &mut [u8; FRAME],
    fill: impl FnOnce(&mut Writer),
) -> usize {
    let (head, rest) = out.split_at_mut(HEAD);
    let (payload, _) = rest.split_at_mut(PAYLOAD);
    let mut writer = Writer {
        bytes: payload,
        used: 0,
    };
    fill(&mut writer);
    // The writer ensures this already; repeated here, so that no check is needed below.
    let length = writer.used.min(PAYLOAD);
    let ([id0, id1], [len0, len1]) = (id.to_le_bytes(), (length as u16).to_le_bytes());
    head.copy_from_slice(&[op, status, id0, id1, len0, len1, 0, 0]);
    let (content, crc) = out.split_at_mut(HEAD + length);
    crc[..4].copy_from_slice(&crc32(content).to_le_bytes());
    OVERHEAD + length
}

/// A payload being written. Data that does not fit is left out.
#[derive(Debug)]
pub struct Writer<'a> {
    bytes: &'a mut [u8],
    used: usize,
}

impl Writer<'_> {
    /// Bytes as they are.
    pub fn bytes(&mut self, bytes: &[u8]) -> &mut Self {
        if let Some(place) = self.bytes.get_mut(self.used..self.used + bytes.len()) {
            place.copy_from_slice(bytes);
            self.used += bytes.len();
        }
        self
    }

    /// One byte.
    pub fn u8(&mut self, value: u8) -> &mut Self {
        self.bytes(&[value])
    }

    /// Little endian.
    pub fn u16(&mut self, value: u16) -> &mut Self {
        self.bytes(&value.to_le_bytes())
    }

    /// Little endian.
    pub fn u32(&mut self, value: u32) -> &mut Self {
        self.bytes(&value.to_le_bytes())
    }

    /// Little endian.
    pub fn i32(&mut self, value: i32) -> &mut Self {
        self.bytes(&value.to_le_bytes())
    }

    /// Little endian.
    pub fn u64(&mut self, value: u64) -> &mut Self {
        self.bytes(&value.to_le_bytes())
    }

    /// Little endian.
    pub fn i64(&mut self, value: i64) -> &mut Self {
        self.bytes(&value.to_le_bytes())
    }

    /// Little endian.
    pub fn words(&mut self, words: &[u32; 4]) -> &mut Self {
        let [a, b, c, d] = *words;
        self.u32(a).u32(b).u32(c).u32(d)
    }

    fn name(&mut self, name: &Name) -> &mut Self {
        self.bytes(name.text().as_bytes())
    }
}

/// A payload being read.
#[derive(Clone, Copy, Debug)]
pub struct Reader<'a>(&'a [u8]);

impl<'a> Reader<'a> {
    /// Of these bytes.
    pub const fn new(bytes: &'a [u8]) -> Self {
        Reader(bytes)
    }

    fn chunk<const N: usize>(&mut self) -> Option<[u8; N]> {
        let (chunk, rest) = self.0.split_first_chunk()?;
        self.0 = rest;
        Some(*chunk)
    }

    /// One byte.
    pub fn u8(&mut self) -> Option<u8> {
        self.chunk().map(u8::from_le_bytes)
    }

    /// Little endian.
    pub fn u16(&mut self) -> Option<u16> {
        self.chunk().map(u16::from_le_bytes)
    }

    /// Little endian.
    pub fn u32(&mut self) -> Option<u32> {
        self.chunk().map(u32::from_le_bytes)
    }

    /// Little endian.
    pub fn i32(&mut self) -> Option<i32> {
        self.chunk().map(i32::from_le_bytes)
    }

    /// Little endian.
    pub fn u64(&mut self) -> Option<u64> {
        self.chunk().map(u64::from_le_bytes)
    }

    /// Little endian.
    pub fn i64(&mut self) -> Option<i64> {
        self.chunk().map(i64::from_le_bytes)
    }

    /// Little endian.
    pub fn words(&mut self) -> Option<[u32; 4]> {
        Some([self.u32()?, self.u32()?, self.u32()?, self.u32()?])
    }

    /// All remaining bytes.
    pub fn rest(&mut self) -> &'a [u8] {
        core::mem::take(&mut self.0)
    }

    /// The value if no byte is left, otherwise `None`.
    pub fn end<T>(&self, value: T) -> Option<T> {
        self.0.is_empty().then_some(value)
    }

    fn name(&mut self) -> Option<Name> {
        let text = core::str::from_utf8(self.rest()).ok()?;
        (text.len() <= NAME).then_some(())?;
        Name::new(text).ok()
    }
}

/// A parsed request.
#[expect(
    clippy::large_enum_variant,
    reason = "there is one at a time, and nowhere to put a box"
)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Request<'a> {
    /// Identifies the client.
    Hello {
        /// Its number, never 0.
        client: u32,
    },
    /// Begins or continues an upload.
    Put {
        /// Bytes of the whole job.
        total: u32,
        /// CRC-32 of all its bytes.
        crc: u32,
        /// Its name.
        name: Name,
    },
    /// The next bytes of the upload.
    Data {
        /// Offset of the first of them.
        offset: u32,
        /// At least one.
        bytes: &'a [u8],
    },
    /// The upload is complete.
    Commit,
    /// Reads an entry of the store.
    List {
        /// From 0.
        index: u8,
    },
    /// Deletes a job, or a part of one.
    Delete {
        /// Its name.
        name: Name,
    },
    /// Reads the machine.
    GetMachine,
    /// Sets the machine.
    PutMachine(MachineConfig),
    /// XYPenPlotter's code. The code is checked later, so that an unknown code and a malformed
    /// request have different answers.
    Command {
        /// [`JobCommand`].
        code: u8,
        /// [`UNATTENDED`] and axes.
        flags: u8,
        /// Milliseconds the client may be silent.
        keepalive: u16,
        /// Name of the job to be started, else empty.
        name: Name,
    },
    /// Reads the report.
    Report,
    /// FPGA G's command.
    Segment {
        /// Its code.
        command: u8,
        /// 0: the 14 bytes of the description; 1: the final revision.
        form: u8,
        /// The words, as bytes.
        words: Words<'a>,
    },
    /// Sets the feed.
    Feed {
        /// Percent of the job's feed.
        percent: u16,
    },
    /// Asks for the challenge.
    Challenge,
    /// Answers the challenge.
    Respond {
        /// The answer to the last challenge.
        words: [u32; 4],
    },
}

/// Words of a payload.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Words<'a>(&'a [[u8; 4]]);

impl Words<'_> {
    /// One by one.
    pub fn iter(&self) -> impl ExactSizeIterator<Item = u32> {
        self.0.iter().map(|word| u32::from_le_bytes(*word))
    }
}

impl<'a> Request<'a> {
    /// From a frame; an error is the status to answer with.
    pub fn parse(frame: &Frame<'a>) -> Result<Request<'a>, Status> {
        let op = Op::from_code(frame.op).ok_or(Status::UnknownOp)?;
        if op == Op::PutMachine {
            return MachineConfig::parse(frame.payload).map(Request::PutMachine);
        }
        let mut reader = Reader(frame.payload);
        let request = Request::fields(op, &mut reader).ok_or(Status::Malformed)?;
        let name = match request {
            Request::Put { name, .. } | Request::Delete { name } => Some(name),
            Request::Command { code, name, .. } if code == JobCommand::Start.code() => Some(name),
            _ => None,
        };
        if name.is_some_and(|name| name.is_empty()) {
            return Err(Status::Name);
        }
        reader.end(request).ok_or(Status::Malformed)
    }

    fn fields(op: Op, reader: &mut Reader<'a>) -> Option<Request<'a>> {
        Some(match op {
            Op::Hello => Request::Hello {
                client: reader.u32().filter(|client| *client != 0)?,
            },
            Op::Put => Request::Put {
                total: reader.u32().filter(|total| *total != 0)?,
                crc: reader.u32()?,
                name: reader.name()?,
            },
            Op::Data => Request::Data {
                offset: reader.u32()?,
                bytes: Some(reader.rest()).filter(|bytes| !bytes.is_empty())?,
            },
            Op::Commit => Request::Commit,
            Op::List => Request::List {
                index: reader.u8()?,
            },
            Op::Delete => Request::Delete {
                name: reader.name()?,
            },
            Op::GetMachine | Op::PutMachine => Request::GetMachine,
            Op::Command => Request::Command {
                code: reader.u8()?,
                flags: reader.u8()?,
                keepalive: reader.u16()?,
                name: reader.name()?,
            },
            Op::Report => Request::Report,
            Op::Segment => {
                let (command, form) = (reader.u8()?, reader.u8()?);
                reader.u16().filter(|zero| *zero == 0)?;
                let (words, rest) = reader.rest().as_chunks();
                rest.is_empty().then_some(())?;
                Request::Segment {
                    command,
                    form,
                    words: Words(words),
                }
            }
            Op::Feed => Request::Feed {
                percent: reader.u16()?,
            },
            Op::Challenge => Request::Challenge,
            Op::Respond => Request::Respond {
                words: reader.words()?,
            },
        })
    }

    /// Its op.
    pub const fn op(&self) -> Op {
        match self {
            Request::Hello { .. } => Op::Hello,
            Request::Put { .. } => Op::Put,
            Request::Data { .. } => Op::Data,
            Request::Commit => Op::Commit,
            Request::List { .. } => Op::List,
            Request::Delete { .. } => Op::Delete,
            Request::GetMachine => Op::GetMachine,
            Request::PutMachine(_) => Op::PutMachine,
            Request::Command { .. } => Op::Command,
            Request::Report => Op::Report,
            Request::Segment { .. } => Op::Segment,
            Request::Feed { .. } => Op::Feed,
            Request::Challenge => Op::Challenge,
            Request::Respond { .. } => Op::Respond,
        }
    }

    /// As a frame; returns its length. Bytes or words that do not fit are left out, so pass at most
    /// [`DATA`] and [`WORDS`].
    pub fn emit(&self, id: u16, out: &mut [u8; FRAME]) -> usize {
        request(self.op(), id, out, |payload| {
            match self {
                Request::Hello { client } => payload.u32(*client),
                Request::Put { total, crc, name } => payload.u32(*total).u32(*crc).name(name),
                Request::Data { offset, bytes } => payload.u32(*offset).bytes(bytes),
                Request::List { index } => payload.u8(*index),
                Request::Delete { name } => payload.name(name),
                Request::Commit | Request::GetMachine | Request::Report | Request::Challenge => {
                    payload
                }
                Request::Respond { words } => payload.words(words),
                Request::PutMachine(machine) => machine.emit(payload),
                Request::Command {
                    code,
                    flags,
                    keepalive,
                    name,
                } => payload.u8(*code).u8(*flags).u16(*keepalive).name(name),
                Request::Segment {
                    command,
                    form,
                    words,
                } => payload
                    .u8(*command)
                    .u8(*form)
                    .u16(0)
                    .bytes(words.0.as_flattened()),
                Request::Feed { percent } => payload.u16(*percent),
            };
        })
    }
}

impl<'a> Words<'a> {
    /// Little-endian bytes of words.
    pub const fn new(bytes: &'a [[u8; 4]]) -> Self {
        Words(bytes)
    }
}

/// The answer to a Hello.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Welcome {
    /// [`VERSION`] of the board.
    pub version: u16,
    /// Axes of its jobs.
    pub axes: u8,
    /// Its clock.
    pub clock_hz: u32,
    /// Changes with every start of the board.
    pub boot_id: u32,
    /// Bytes of its store.
    pub room: u32,
    /// Free bytes of the store.
    pub free: u32,
    /// CRC-32 of the program that executes jobs.
    pub program: u32,
}

impl Welcome {
    /// From a payload.
    pub fn parse(payload: &[u8]) -> Option<Self> {
        let mut reader = Reader(payload);
        let version = reader.u16()?;
        let (axes, zero) = (reader.u8()?, reader.u8()?);
        (zero == 0).then_some(())?;
        let welcome = Welcome {
            version,
            axes,
            clock_hz: reader.u32()?,
            boot_id: reader.u32()?,
            room: reader.u32()?,
            free: reader.u32()?,
            program: reader.u32()?,
        };
        reader.end(welcome)
    }

    /// As a payload.
    pub fn emit(&self, payload: &mut Writer) {
        payload.u16(self.version).u8(self.axes).u8(0);
        payload.u32(self.clock_hz).u32(self.boot_id);
        payload.u32(self.room).u32(self.free).u32(self.program);
    }
}

/// A job in the store.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Entry {
    /// Number of jobs in the store.
    pub count: u8,
    /// It can be started: it is complete and can be read.
    pub ready: bool,
    /// Its length in bytes.
    pub total: u32,
    /// Bytes that have arrived.
    pub have: u32,
    /// CRC-32 of all of it.
    pub crc: u32,
    /// Its number of instructions, once it is ready.
    pub instructions: u32,
    /// Its name.
    pub name: Name,
}

impl Entry {
    /// From a payload.
    pub fn parse(payload: &[u8]) -> Option<Self> {
        let mut reader = Reader(payload);
        let (count, ready) = (reader.u8()?, reader.u8()?);
        reader.u16().filter(|zero| *zero == 0 && ready <= 1)?;
        let entry = Entry {
            count,
            ready: ready == 1,
            total: reader.u32()?,
            have: reader.u32()?,
            crc: reader.u32()?,
            instructions: reader.u32()?,
            name: reader.name()?,
        };
        reader.end(entry)
    }

    /// As a payload.
    pub fn emit(&self, payload: &mut Writer) {
        payload.u8(self.count).u8(self.ready.into()).u16(0);
        payload.u32(self.total).u32(self.have).u32(self.crc);
        payload.u32(self.instructions).name(&self.name);
    }
}

/// A payload of one word: an offset, free bytes, FPGA G's status.
pub fn word(payload: &[u8]) -> Option<u32> {
    let mut reader = Reader(payload);
    let word = reader.u32()?;
    reader.end(word)
}

#[cfg(test)]
mod tests;
