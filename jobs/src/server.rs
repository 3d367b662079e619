//! Answers the requests of clients, as `wire::jobs` specifies.
//!
//! Requests come as bytes in pieces of any size; each is answered before the next is read. A
//! request that is repeated with the same client's last id gets the same bytes again. A commit
//! waits until the upload has been read through: its last byte is not taken before, so the
//! connection keeps asking. A client that comes while another one is connected gets a
//! [`BusyReply`]: Stop and Pause are taken from every client, anything else is answered with busy.

use crate::Outside;
use crate::executor::Executor;
use crate::store::Store;
use crate::words;
use motion::segment::AXES;
use wire::Name;
use wire::describe::{Describe, FEATURE_KEY};
use wire::jobs::{
    self, FRAME, Frame, JobCommand, Op, Request, SILENCE_SECONDS, Status, VERSION, Welcome, Writer,
};

/// The state of the connection and of its client.
#[derive(Debug)]
pub struct JobServer {
    clock_hz: u32,
    boot_id: u32,
    program: u32,
    key: bool,
    request: [u8; FRAME],
    have: usize,
    /// The current request waits for its answer; it has already restarted the time of silence.
    waits: bool,
    /// The client that spoke last, over this connection or an earlier one.
    client: u32,
    /// This connection has sent its Hello.
    known: bool,
    proven: bool,
    /// The answer to the client's last request, and that request's id.
    answer: [u8; FRAME],
    length: usize,
    last: Option<(u32, u8, u16)>,
    heard: u64,
    refused: u16,
}

/// A place for answers.
pub trait Answer {
    /// Appends bytes of an answer.
    fn put(&mut self, bytes: &[u8]);
    /// Ends the connection after them.
    fn close(&mut self);
}

/// Writes an answer: its status and its content.
type Tell<'t> = dyn FnMut(Status, &mut dyn FnMut(&mut Writer)) -> Outcome + 't;

/// The outcome of a request.
enum Outcome {
    Now(Status),
    Later,
}

impl JobServer {
    /// For this board.
    pub fn new(board: &Describe, program: u32) -> Self {
        JobServer {
            clock_hz: board.clock_hz,
            boot_id: board.boot_id,
            program,
            key: board.features & FEATURE_KEY != 0,
            request: [0; FRAME],
            have: 0,
            waits: false,
            client: 0,
            known: false,
            proven: false,
            answer: [0; FRAME],
            length: 0,
            last: None,
            heard: 0,
            refused: 0,
        }
    }

    /// The client has been silent for too long.
    pub fn silent(&self, now: u64) -> bool {
        now.wrapping_sub(self.heard) >= u64::from(SILENCE_SECONDS) * u64::from(self.clock_hz)
    }

    /// A new connection.
    pub fn visit(&mut self, now: u64) {
        (self.have, self.waits) = (0, false);
        (self.known, self.proven) = (false, false);
        self.heard = now;
    }
}

/// Takes bytes of a request into `place`. Returns how many, and whether the request is complete, or
/// longer than `place`.
fn collect(place: &mut [u8], have: &mut usize, bytes: &[u8]) -> (usize, bool) {
    let mut taken = 0;
    loop {
        let known = place.get(..*have).unwrap_or(&[]);
        let needs = Frame::needs(known).min(place.len());
        if *have >= needs {
            return (taken, true);
        }
        let rest = bytes.get(taken..).unwrap_or(&[]);
        let count = rest.len().min(needs - *have);
        if count == 0 {
            return (taken, false);
        }
        let room = place.get_mut(*have..*have + count);
        if let (Some(room), Some(rest)) = (room, rest.get(..count)) {
            room.copy_from_slice(rest);
        }
        *have += count;
        taken += count;
    }
}

/// Everything that handling a request needs.
pub struct RequestContext<'a, 'm, O: Outside> {
    /// The server.
    pub server: &'a mut JobServer,
    /// The store.
    pub store: &'a mut Store<'m>,
    /// The executor.
    pub executor: &'a mut Executor,
    /// The board.
    pub out: &'a mut O,
    /// The time.
    pub now: u64,
    /// The number of requests that may be answered in this call.
    pub budget: u8,
}

impl<O: Outside> RequestContext<'_, '_, O> {
    /// A client has connected.
    pub fn greet(&mut self) {
        self.server.visit(self.now);
    }

    /// Takes bytes of that client, at most one request; returns how many. 0: ask again later.
    pub fn take(&mut self, bytes: &[u8], out: &mut impl Answer) -> usize {
        if self.budget == 0 {
            return 0;
        }
        let JobServer { request, have, .. } = &mut *self.server;
        let (taken, complete) = collect(request, have, bytes);
        if !complete {
            return taken;
        }
        self.budget -= 1;
        self.server.waits = !self.serve(out);
        if !self.server.waits {
            return taken;
        }
        // The request's last byte is not taken: so the request comes again, and the connection
        // stays open until it is answered.
        self.server.have -= 1;
        taken.saturating_sub(1)
    }

    /// Answers a complete request. False: it has to wait.
    fn serve(&mut self, out: &mut impl Answer) -> bool {
        let bytes = self.server.request;
        self.server.heard = self.now;
        let Ok(Some((frame, _))) = Frame::parse(bytes.get(..self.server.have).unwrap_or(&[]))
        else {
            // The last request is kept: what a stranger sends must not make a start be acted on
            // twice.
            let mut answer = [0; FRAME];
            let length = jobs::answer(0, Status::Garbled, 0, &mut answer, |_| {});
            out.put(answer.get(..length).unwrap_or(&[]));
            out.close();
            return true;
        };
        // A waiting request is not a new sign of life of its client.
        if self.server.known && !self.server.waits {
            self.executor.heard(self.server.client, self.now);
        }
        let number = (self.server.client, frame.op, frame.id);
        // A new connection's first request is not the one that may be repeated over it.
        let greets = matches!(
            Op::from_code(frame.op),
            Some(Op::Hello | Op::Challenge | Op::Respond)
        );
        let again = !greets && self.server.known && self.server.last == Some(number);
        if !again {
            let mut answer = [0; FRAME];
            let mut length = 0;
            let outcome = self.answer(&frame, &mut answer, &mut length);
            let status = match outcome {
                Outcome::Later => return false,
                Outcome::Now(status) => status,
            };
            if status != Status::Normal {
                self.server.refused = self.server.refused.wrapping_add(1);
            }
            if greets || !self.admitted() || self.passes(&frame, status) {
                self.server.have = 0;
                out.put(answer.get(..length).unwrap_or(&[]));
                return true;
            }
            (self.server.answer, self.server.length) = (answer, length);
            self.server.last = Some(number);
        }
        self.server.have = 0;
        out.put(self.server.answer.get(..self.server.length).unwrap_or(&[]));
        true
    }

    /// This connection may do more than look and halt.
    fn admitted(&self) -> bool {
        self.server.known && (!self.server.key || self.server.proven)
    }

    /// A client that only looks or halts, or is refused, while the request of another one may come
    /// again: that one stays the last, or its start would be executed twice, after a stop.
    fn passes(&self, frame: &Frame, status: Status) -> bool {
        let anothers = |(client, ..): (u32, u8, u16)| client != self.server.client;
        let harmless = match Request::parse(frame) {
            Ok(Request::Report | Request::List { .. } | Request::GetMachine) => true,
            Ok(Request::Command { code, .. }) => JobCommand::from_code(code).is_some_and(halts),
            Ok(Request::Segment { command, .. }) => words::halts(command),
            Ok(_) | Err(_) => false,
        };
        (harmless || status != Status::Normal) && self.server.last.is_some_and(anothers)
    }

    fn answer(&mut self, frame: &Frame, answer: &mut [u8; FRAME], length: &mut usize) -> Outcome {
        let mut tell = |status: Status, fill: &mut dyn FnMut(&mut Writer)| {
            *length = jobs::answer(frame.op, status, frame.id, answer, fill);
            Outcome::Now(status)
        };
        let request = match Request::parse(frame) {
            Ok(request) => request,
            Err(status) => return tell(status, &mut |_| {}),
        };
        if let Err(status) = self.may(&request) {
            return tell(status, &mut |_| {});
        }
        let word = |result: Result<u32, (Status, u32)>| match result {
            Ok(word) => (Status::Normal, word),
            Err((status, word)) => (status, word),
        };
        let plain = |result: Result<(), Status>| result.err().unwrap_or(Status::Normal);
        match request {
            Request::Hello { client } => self.hello(client, &mut tell),
            Request::Put { total, crc, name } => {
                let (status, word) = word(self.put(name, total, crc));
                tell(status, &mut |payload| {
                    payload.u32(word);
                })
            }
            Request::Data { offset, bytes } => {
                let (status, word) = word(self.store.data(offset, bytes));
                tell(status, &mut |payload| {
                    payload.u32(word);
                })
            }
            Request::Commit => self.commit(&mut tell),
            Request::List { index } => match self.store.entry(index) {
                Some(entry) => tell(Status::Normal, &mut |payload| entry.emit(payload)),
                None => tell(Status::NoSuchJob, &mut |_| {}),
            },
            Request::Delete { name } => self.delete(&name, &mut tell),
            Request::GetMachine => match self.executor.machine() {
                Some(machine) => tell(Status::Normal, &mut |payload| {
                    machine.emit(payload);
                }),
                None => tell(Status::NoMachine, &mut |_| {}),
            },
            Request::PutMachine(machine) => match self.executor.set_machine(machine) {
                Ok(()) => tell(Status::Normal, &mut |_| {}),
                Err((status, field, axis)) => tell(status, &mut |payload| {
                    payload.u8(field as u8).u8(axis);
                }),
            },
            Request::Command {
                code,
                flags,
                keepalive,
                name,
            } => {
                let code = (code, flags, keepalive);
                let client = self.server.client;
                let result = self
                    .executor
                    .command(code, &name, client, self.store, self.now, self.out);
                self.report(plain(result), &mut tell)
            }
            Request::Report => self.report(Status::Normal, &mut tell),
            Request::Feed { percent } => {
                let result = self.executor.feed(percent);
                self.report(plain(result), &mut tell)
            }
            Request::Segment {
                command,
                form,
                words,
            } => self.segment((command, form), words, &mut tell),
            Request::Challenge => {
                let words = self.executor.inside().challenge(self.out);
                tell(Status::Normal, &mut |payload| {
                    payload.words(&words);
                })
            }
            Request::Respond { words } => {
                let status = self.respond(words);
                tell(status, &mut |_| {})
            }
        }
    }

    fn hello(&mut self, client: u32, tell: &mut Tell) -> Outcome {
        self.server.client = client;
        self.server.known = true;
        self.executor.heard(client, self.now);
        let welcome = Welcome {
            version: VERSION,
            axes: AXES as u8,
            clock_hz: self.server.clock_hz,
            boot_id: self.server.boot_id,
            room: self.store.room(),
            free: self.store.free(),
            program: self.server.program,
        };
        tell(Status::Normal, &mut |payload| welcome.emit(payload))
    }

    fn put(&mut self, name: Name, total: u32, crc: u32) -> Result<u32, (Status, u32)> {
        let busy = self.executor.executes(self.store, &name);
        if busy && !self.store.same(&name, total, crc) {
            return Err((Status::NotNow, 0));
        }
        let free = self.store.free();
        let result = self.store.put(name, total, crc);
        result.map_err(|status| (status, free))
    }

    fn commit(&mut self, tell: &mut Tell) -> Outcome {
        match self.store.commit() {
            None => Outcome::Later,
            Some(Ok(entry)) => tell(Status::Normal, &mut |payload| entry.emit(payload)),
            Some(Err((status, word))) => tell(status, &mut |payload| {
                payload.u32(word);
            }),
        }
    }

    fn delete(&mut self, name: &Name, tell: &mut Tell) -> Outcome {
        let result = if self.executor.executes(self.store, name) {
            Err(Status::NotNow)
        } else {
            self.store.delete(name)
        };
        let free = self.store.free();
        tell(result.err().unwrap_or(Status::Normal), &mut |payload| {
            payload.u32(free);
        })
    }

    fn segment(&mut self, what: (u8, u8), words: jobs::Words, tell: &mut Tell) -> Outcome {
        let client = self.server.client;
        let result = self.executor.words(what, words, client, self.now, self.out);
        let (status, word) = match result {
            Ok(word) => (Status::Normal, word),
            Err(status) => (status, words::NOT_NOW),
        };
        tell(status, &mut |payload| {
            payload.u32(word);
        })
    }

    fn respond(&mut self, words: [u32; 4]) -> Status {
        let client = self.server.client;
        if self.executor.busy() {
            Status::NotNow
        } else if self.executor.inside().prove(client, words, self.out) {
            self.server.proven = true;
            Status::Normal
        } else {
            Status::Key
        }
    }

    fn report(&mut self, status: Status, tell: &mut Tell) -> Outcome {
        if status != Status::Normal {
            return tell(status, &mut |_| {});
        }
        let mut report = self.executor.report(self.out);
        report.refused = self.server.refused;
        tell(status, &mut |payload| report.emit(payload))
    }

    /// Hello first; and with a key, a client that has not proved it may only look and stop.
    fn may(&self, request: &Request) -> Result<(), Status> {
        let stop = |code: u8| {
            let command = JobCommand::from_code(code);
            command.is_none_or(|command| command == JobCommand::Welcome || halts(command))
        };
        match request {
            Request::Hello { .. } => Ok(()),
            _ if !self.server.known => Err(Status::NoHello),
            _ if self.admitted() => Ok(()),
            Request::Command { code, .. } if stop(*code) => Ok(()),
            Request::Segment { command, .. } if words::harmless(*command) => Ok(()),
            Request::List { .. }
            | Request::GetMachine
            | Request::Report
            | Request::Challenge
            | Request::Respond { .. } => Ok(()),
            Request::Put { .. }
            | Request::Data { .. }
            | Request::Commit
            | Request::Delete { .. }
            | Request::PutMachine(_)
            | Request::Command { .. }
            | Request::Segment { .. }
            | Request::Feed { .. } => Err(Status::Key),
        }
    }
}

/// Commands that every client may give: they bring the machine to a stand.
fn halts(command: JobCommand) -> bool {
    matches!(command, JobCommand::Stop | JobCommand::Pause)
}

/// Bytes of the longest request of a client that is told to wait: a command with a name.
const BUSY_REQUEST: usize = 64;

/// A client that comes while another one is connected: one request of it is read. Stop and Pause
/// are executed, without a Hello and without a key, because standing is safe. All other requests
/// get [`Status::Busy`].
#[derive(Clone, Copy, Debug)]
pub struct BusyReply {
    request: [u8; BUSY_REQUEST],
    have: usize,
}

impl Default for BusyReply {
    fn default() -> Self {
        Self::new()
    }
}

impl BusyReply {
    /// Before the first byte.
    pub const fn new() -> Self {
        BusyReply {
            request: [0; BUSY_REQUEST],
            have: 0,
        }
    }
}

/// Everything that handling a request of a waiting client needs.
pub struct Caller<'a, 'm, O: Outside> {
    /// The bytes received so far.
    pub busy: &'a mut BusyReply,
    /// The server, which has another client.
    pub server: &'a JobServer,
    /// The store.
    pub store: &'a Store<'m>,
    /// The executor.
    pub executor: &'a mut Executor,
    /// The board.
    pub out: &'a mut O,
    /// The time.
    pub now: u64,
}

impl<O: Outside> Caller<'_, '_, O> {
    /// A client has connected: it is told that another one is there.
    pub fn greet(&mut self, out: &mut impl Answer) {
        *self.busy = BusyReply::new();
        let mut answer = [0; FRAME];
        let op = Op::Hello.code();
        let length = jobs::answer(op, Status::Busy, 0, &mut answer, |_| {});
        out.put(answer.get(..length).unwrap_or(&[]));
    }

    /// Takes bytes of that client; returns how many.
    pub fn take(&mut self, bytes: &[u8], out: &mut impl Answer) -> usize {
        let BusyReply { request, have } = &mut *self.busy;
        let (taken, complete) = collect(request, have, bytes);
        if complete {
            self.serve(out);
        }
        taken
    }

    fn serve(&mut self, out: &mut impl Answer) {
        let request = self.busy.request;
        let have = core::mem::take(&mut self.busy.have);
        let mut answer = [0; FRAME];
        let said = request.get(..have).unwrap_or(&[]);
        let length = match Frame::parse(said) {
            // The client has been told Busy already.
            Ok(Some((frame, _))) if frame.op == Op::Hello.code() => return,
            Ok(Some((frame, _))) => self.answer(&frame, &mut answer),
            // Too long for a client that waits.
            Ok(None) => {
                let [op, _, id0, id1, ..] = request;
                let id = u16::from_le_bytes([id0, id1]);
                jobs::answer(op, Status::Busy, id, &mut answer, |_| {})
            }
            Err(_) => jobs::answer(0, Status::Garbled, 0, &mut answer, |_| {}),
        };
        out.put(answer.get(..length).unwrap_or(&[]));
        out.close();
    }

    fn answer(&mut self, frame: &Frame, answer: &mut [u8; FRAME]) -> usize {
        let (op, id) = (frame.op, frame.id);
        let halt = match Request::parse(frame) {
            Ok(Request::Command { code, .. }) => JobCommand::from_code(code).filter(|c| halts(*c)),
            Ok(Request::Segment { command, words, .. }) if words::halts(command) => {
                let done = self
                    .executor
                    .words((command, 0), words, 0, self.now, self.out);
                let (status, word) = match done {
                    Ok(word) => (Status::Normal, word),
                    Err(status) => (status, words::NOT_NOW),
                };
                return jobs::answer(op, status, id, answer, |payload| {
                    payload.u32(word);
                });
            }
            Ok(_) | Err(_) => None,
        };
        let Some(halt) = halt else {
            return jobs::answer(op, Status::Busy, id, answer, |_| {});
        };
        let code = (halt.code(), 0, 0);
        let done = self
            .executor
            .command(code, &Name::EMPTY, 0, self.store, self.now, self.out);
        if let Err(status) = done {
            return jobs::answer(op, status, id, answer, |_| {});
        }
        let mut report = self.executor.report(self.out);
        report.refused = self.server.refused;
        jobs::answer(op, Status::Normal, id, answer, |payload| {
            report.emit(payload);
        })
    }
}
