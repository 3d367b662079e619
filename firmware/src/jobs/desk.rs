//! What clients say, and what they are answered: `wire::jobs`.
//!
//! Requests come as bytes in any pieces; each is answered before the next is looked at. A request that comes again, with the same client's last
//! id, gets the same bytes again. Two things are kept waiting: a commit until the job was read through, and whoever comes while somebody is
//! there, who is told so by [`Door`].

use super::Outside;
use super::executor::Executor;
use super::store::Store;
use super::words;
use crate::ip::{Taker, Text};
use crate::text::Sink as _;
use motion::segment::AXES;
use wire::describe::{Describe, FEATURE_KEY};
use wire::jobs::{
    self, Command, FRAME, Frame, Op, Request, SILENCE_SECONDS, Status, VERSION, Welcome, Writer,
};

/// What belongs to the connection, and to the client.
#[derive(Debug)]
pub struct Desk {
    clock_hz: u32,
    boot_id: u32,
    program: u32,
    key: bool,
    request: [u8; FRAME],
    have: usize,
    /// Who spoke last, over this connection or the one before.
    client: u32,
    /// This connection said who it is.
    known: bool,
    proven: bool,
    /// The answer to the client's last request, and what that was.
    answer: [u8; FRAME],
    length: usize,
    last: Option<(u32, u8, u16)>,
    heard: u64,
    refused: u16,
}

/// Writes an answer: its status, and what is in it.
type Tell<'t> = dyn FnMut(Status, &mut dyn FnMut(&mut Writer)) -> Outcome + 't;

/// What came of a request.
enum Outcome {
    Now(Status),
    Later,
}

impl Desk {
    /// Of this board.
    pub fn new(board: &Describe, program: u32) -> Self {
        Desk {
            clock_hz: board.clock_hz,
            boot_id: board.boot_id,
            program,
            key: board.features & FEATURE_KEY != 0,
            request: [0; FRAME],
            have: 0,
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

    /// Nobody has said anything for too long.
    pub fn silent(&self, now: u64) -> bool {
        now.wrapping_sub(self.heard) >= u64::from(SILENCE_SECONDS) * u64::from(self.clock_hz)
    }

    /// A new connection.
    pub fn visit(&mut self, now: u64) {
        (self.have, self.known, self.proven) = (0, false, false);
        self.heard = now;
    }

    /// Takes bytes of a request; how many, and whether it is complete.
    fn collect(&mut self, bytes: &[u8]) -> (usize, bool) {
        let mut taken = 0;
        loop {
            let known = self.request.get(..self.have).unwrap_or(&[]);
            let needs = Frame::needs(known);
            if self.have >= needs {
                return (taken, true);
            }
            let rest = bytes.get(taken..).unwrap_or(&[]);
            let count = rest.len().min(needs - self.have);
            if count == 0 {
                return (taken, false);
            }
            let place = self.request.get_mut(self.have..self.have + count);
            if let (Some(place), Some(rest)) = (place, rest.get(..count)) {
                place.copy_from_slice(rest);
            }
            self.have += count;
            taken += count;
        }
    }
}

/// Everything a request is about, for as long as it is.
pub struct Counter<'a, 'm, O: Outside> {
    /// The desk.
    pub desk: &'a mut Desk,
    /// The store.
    pub store: &'a mut Store<'m>,
    /// The executor.
    pub executor: &'a mut Executor,
    /// The board.
    pub out: &'a mut O,
    /// What time it is.
    pub now: u64,
    /// So many requests may be answered.
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
        let (taken, complete) = self.desk.collect(bytes);
        if complete {
            self.budget -= 1;
            self.serve(out);
        }
        taken
    }
}

impl<O: Outside> Counter<'_, '_, O> {
    /// Answers the request that is complete; one that has to wait stays there.
    fn serve(&mut self, out: &mut Text) {
        let bytes = self.desk.request;
        self.desk.heard = self.now;
        let Ok(Some((frame, _))) = Frame::parse(bytes.get(..self.desk.have).unwrap_or(&[])) else {
            self.desk.length = jobs::answer(0, Status::Garbled, 0, &mut self.desk.answer, |_| {});
            self.desk.last = None;
            out.put(self.desk.answer.get(..self.desk.length).unwrap_or(&[]));
            out.close = true;
            return;
        };
        if self.desk.known {
            self.executor.heard(self.desk.client, self.now);
        }
        let number = (self.desk.client, frame.op, frame.id);
        // What a new connection begins with is not the request that may come again over it.
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
                Outcome::Later => return,
                Outcome::Now(status) => status,
            };
            if status != Status::Normal {
                self.desk.refused = self.desk.refused.wrapping_add(1);
            }
            if greets {
                self.desk.have = 0;
                out.put(answer.get(..length).unwrap_or(&[]));
                return;
            }
            (self.desk.answer, self.desk.length) = (answer, length);
            self.desk.last = Some((self.desk.client, frame.op, frame.id));
        }
        self.desk.have = 0;
        out.put(self.desk.answer.get(..self.desk.length).unwrap_or(&[]));
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

    /// Hello first; and with a key, who has not proven it may look and stop.
    fn may(&self, request: &Request) -> Result<(), Status> {
        let stop = |code: u8| {
            let harmless = [Command::Stop, Command::Welcome, Command::Pause];
            Command::from_code(code).is_none_or(|command| harmless.contains(&command))
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

/// Tells whoever comes while somebody is there.
#[derive(Clone, Copy, Debug)]
pub struct Door;

impl Taker for Door {
    fn greet(&mut self, out: &mut Text) {
        let mut answer = [0; FRAME];
        let op = Op::Hello.code();
        let length = jobs::answer(op, Status::Busy, 0, &mut answer, |_| {});
        out.put(answer.get(..length).unwrap_or(&[]));
        out.close = true;
    }

    fn take(&mut self, bytes: &[u8], _: &mut Text) -> usize {
        bytes.len()
    }
}
