//! Answers clients' requests: `wire::jobs`.
//!
//! Requests come as bytes in pieces of any size; each is answered before the next is read. A
//! request that is repeated with the same client's last id gets the same bytes again. A commit
//! waits until the upload has been read through: its last byte is not taken before, so the
//! connection keeps asking. A client that comes while another one is connected goes to the
//! [`Door`], where every client may say Stop and Pause, and anything else is answered with busy.

use super::Outside;
use super::executor::Executor;
use super::store::Store;
use super::words;
use crate::ip::{Taker, Text};
use crate::text::Sink as _;
use motion::segment::AXES;
use wire::Name;
use wire::describe::{Describe, FEATURE_KEY};
use wire::jobs::{
    self, Command, FRAME, Frame, Op, Request, SILENCE_SECONDS, Status, VERSION, Welcome, Writer,
};

/// The state of the connection and of its client.
#[derive(Debug)]
pub struct Desk {
    clock_hz: u32,
    boot_id: u32,
    program: u32,
    key: bool,
    request: [u8; FRAME],
    have: usize,
    /// The current request waits for its answer, and was counted as heard before.
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

/// Writes an answer: its status and its content.
type Tell<'t> = dyn FnMut(Status, &mut dyn FnMut(&mut Writer)) -> Outcome + 't;

/// The outcome of a request.
enum Outcome {
    Now(Status),
    Later,
}

impl Desk {
    /// For this board.
    pub fn new(board: &Describe, program: u32) -> Self {
        Desk {
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
pub struct Counter<'a, 'm, O: Outside> {
    /// The desk.
    pub desk: &'a mut Desk,
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

impl<O: Outside> Taker for Counter<'_, '_, O> {
    fn greet(&mut self, _: &mut Text) {
        self.desk.visit(self.now);
    }

    fn take(&mut self, bytes: &[u8], out: &mut Text) -> usize {
        if self.budget == 0 {
            return 0;
        }
        let Desk { request, have, .. } = &mut *self.desk;
        let (taken, complete) = collect(request, have, bytes);
        if !complete {
            return taken;
        }
        self.budget -= 1;
        self.desk.waits = !self.serve(out);
        if !self.desk.waits {
            return taken;
        }
        // The request's last byte is not taken: so the request comes again, and the connection
        // stays open until it is answered.
        self.desk.have -= 1;
        taken.saturating_sub(1)
    }
}

impl<O: Outside> Counter<'_, '_, O> {
    /// Answers a complete request. False: it has to wait.
    fn serve(&mut self, out: &mut Text) -> bool {
        let bytes = self.desk.request;
        self.desk.heard = self.now;
        let Ok(Some((frame, _))) = Frame::parse(bytes.get(..self.desk.have).unwrap_or(&[])) else {
            self.desk.length = jobs::answer(0, Status::Garbled, 0, &mut self.desk.answer, |_| {});
            self.desk.last = None;
            out.put(self.desk.answer.get(..self.desk.length).unwrap_or(&[]));
            out.close = true;
            return true;
        };
        // A waiting request is not a new sign of life of its client.
        if self.desk.known && !self.desk.waits {
            self.executor.heard(self.desk.client, self.now);
        }
        let number = (self.desk.client, frame.op, frame.id);
        // A new connection's first request is not the one that may be repeated over it.
        let greets = matches!(
            Op::from_code(frame.op),
            Some(Op::Hello | Op::Challenge | Op::Respond)
        );
        let again = !greets && self.desk.known && self.desk.last == Some(number);
        if !again {
            let mut answer = self.desk.answer;
            let mut length = 0;
            let outcome = self.answer(&frame, &mut answer, &mut length);
            let status = match outcome {
                Outcome::Later => return false,
                Outcome::Now(status) => status,
            };
            if status != Status::Normal {
                self.desk.refused = self.desk.refused.wrapping_add(1);
            }
            if greets || self.passes(&frame) {
                self.desk.have = 0;
                out.put(answer.get(..length).unwrap_or(&[]));
                return true;
            }
            (self.desk.answer, self.desk.length) = (answer, length);
            self.desk.last = Some((self.desk.client, frame.op, frame.id));
        }
        self.desk.have = 0;
        out.put(self.desk.answer.get(..self.desk.length).unwrap_or(&[]));
        true
    }

    /// A client that only looks or halts, while the request of another one may come again: that one
    /// stays the last, or its start would be acted on twice, behind a stop.
    fn passes(&self, frame: &Frame) -> bool {
        let anothers = |(client, ..): (u32, u8, u16)| client != self.desk.client;
        let harmless = match Request::parse(frame) {
            Ok(Request::Report | Request::List { .. } | Request::GetMachine) => true,
            Ok(Request::Command { code, .. }) => Command::from_code(code).is_some_and(halts),
            Ok(Request::Segment { command, .. }) => words::halts(command),
            Ok(_) | Err(_) => false,
        };
        harmless && self.desk.last.is_some_and(anothers)
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
            Request::Hello { client } => {
                self.desk.client = client;
                self.desk.known = true;
                self.executor.heard(client, self.now);
                let welcome = Welcome {
                    version: VERSION,
                    axes: AXES as u8,
                    clock_hz: self.desk.clock_hz,
                    boot_id: self.desk.boot_id,
                    room: self.store.room(),
                    free: self.store.free(),
                    program: self.desk.program,
                };
                tell(Status::Normal, &mut |payload| welcome.emit(payload))
            }
            Request::Put { total, crc, name } => {
                let busy = self.executor.executes(self.store, &name);
                let result = if busy && !self.store.same(&name, total, crc) {
                    Err((Status::NotNow, 0))
                } else {
                    let free = self.store.free();
                    let result = self.store.put(name, total, crc);
                    result.map_err(|status| (status, free))
                };
                let (status, word) = word(result);
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
            Request::Commit => match self.store.commit() {
                None => Outcome::Later,
                Some(Ok(entry)) => tell(Status::Normal, &mut |payload| entry.emit(payload)),
                Some(Err((status, word))) => tell(status, &mut |payload| {
                    payload.u32(word);
                }),
            },
            Request::List { index } => match self.store.entry(index) {
                Some(entry) => tell(Status::Normal, &mut |payload| entry.emit(payload)),
                None => tell(Status::NoSuchJob, &mut |_| {}),
            },
            Request::Delete { name } => {
                let result = if self.executor.executes(self.store, &name) {
                    Err(Status::NotNow)
                } else {
                    self.store.delete(&name)
                };
                let free = self.store.free();
                tell(plain(result), &mut |payload| {
                    payload.u32(free);
                })
            }
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
                let client = self.desk.client;
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
            } => {
                let client = self.desk.client;
                let result =
                    self.executor
                        .words((command, form), words, client, self.now, self.out);
                let (status, word) = match result {
                    Ok(word) => (Status::Normal, word),
                    Err(status) => (status, words::NOT_NOW),
                };
                tell(status, &mut |payload| {
                    payload.u32(word);
                })
            }
            Request::Challenge => {
                let words = self.executor.inside().challenge(self.out);
                tell(Status::Normal, &mut |payload| {
                    payload.words(&words);
                })
            }
            Request::Respond { words } => {
                let client = self.desk.client;
                let status = if self.executor.busy() {
                    Status::NotNow
                } else if self.executor.inside().prove(client, words, self.out) {
                    self.desk.proven = true;
                    Status::Normal
                } else {
                    Status::Key
                };
                tell(status, &mut |_| {})
            }
        }
    }

    fn report(&mut self, status: Status, tell: &mut Tell) -> Outcome {
        if status != Status::Normal {
            return tell(status, &mut |_| {});
        }
        let mut report = self.executor.report(self.out);
        report.refused = self.desk.refused;
        tell(status, &mut |payload| report.emit(payload))
    }

    /// Hello first; and with a key, a client that has not proved it may only look and stop.
    fn may(&self, request: &Request) -> Result<(), Status> {
        let stop = |code: u8| {
            let command = Command::from_code(code);
            command.is_none_or(|command| command == Command::Welcome || halts(command))
        };
        match request {
            Request::Hello { .. } => Ok(()),
            _ if !self.desk.known => Err(Status::NoHello),
            _ if !self.desk.key || self.desk.proven => Ok(()),
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
fn halts(command: Command) -> bool {
    matches!(command, Command::Stop | Command::Pause)
}

/// Bytes of the longest request at the door: a command with a name.
const AT_DOOR: usize = 64;

/// A client that comes while another one is connected: one request of it is read. Stop and Pause
/// are executed, without a Hello and without a key, because standing is safe. All other requests
/// get [`Status::Busy`].
#[derive(Clone, Copy, Debug)]
pub struct Door {
    request: [u8; AT_DOOR],
    have: usize,
}

impl Default for Door {
    fn default() -> Self {
        Self::new()
    }
}

impl Door {
    /// Before the first byte.
    pub const fn new() -> Self {
        Door {
            request: [0; AT_DOOR],
            have: 0,
        }
    }
}

/// Everything that handling a request at the door needs.
pub struct Caller<'a, 'm, O: Outside> {
    /// The bytes received so far.
    pub door: &'a mut Door,
    /// The desk, which has another client.
    pub desk: &'a Desk,
    /// The store.
    pub store: &'a Store<'m>,
    /// The executor.
    pub executor: &'a mut Executor,
    /// The board.
    pub out: &'a mut O,
    /// The time.
    pub now: u64,
}

impl<O: Outside> Taker for Caller<'_, '_, O> {
    fn greet(&mut self, out: &mut Text) {
        *self.door = Door::new();
        let mut answer = [0; FRAME];
        let op = Op::Hello.code();
        let length = jobs::answer(op, Status::Busy, 0, &mut answer, |_| {});
        out.put(answer.get(..length).unwrap_or(&[]));
    }

    fn take(&mut self, bytes: &[u8], out: &mut Text) -> usize {
        let Door { request, have } = &mut *self.door;
        let (taken, complete) = collect(request, have, bytes);
        if complete {
            self.serve(out);
        }
        taken
    }
}

impl<O: Outside> Caller<'_, '_, O> {
    fn serve(&mut self, out: &mut Text) {
        let request = self.door.request;
        let have = ::core::mem::take(&mut self.door.have);
        let mut answer = [0; FRAME];
        let said = request.get(..have).unwrap_or(&[]);
        let length = match Frame::parse(said) {
            // The door has already answered Busy.
            Ok(Some((frame, _))) if frame.op == Op::Hello.code() => return,
            Ok(Some((frame, _))) => self.answer(&frame, &mut answer),
            // Too long for the door.
            Ok(None) => {
                let [op, _, id0, id1, ..] = request;
                let id = u16::from_le_bytes([id0, id1]);
                jobs::answer(op, Status::Busy, id, &mut answer, |_| {})
            }
            Err(_) => jobs::answer(0, Status::Garbled, 0, &mut answer, |_| {}),
        };
        out.put(answer.get(..length).unwrap_or(&[]));
        out.close = true;
    }

    fn answer(&mut self, frame: &Frame, answer: &mut [u8; FRAME]) -> usize {
        let (op, id) = (frame.op, frame.id);
        let halt = match Request::parse(frame) {
            Ok(Request::Command { code, .. }) => Command::from_code(code).filter(|c| halts(*c)),
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
        report.refused = self.desk.refused;
        jobs::answer(op, Status::Normal, id, answer, |payload| {
            report.emit(payload);
        })
    }
}
