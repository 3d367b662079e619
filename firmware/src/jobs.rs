//! The jobs program: what the board does without a PC. This is a separate program in SDRAM, because
//! the ROM has no room for it.
//!
//! ```text
//!   frames --> ip ------+
//!                       +--> jobs::Jobs --> datagram, segments core
//!   debug console ------+
//! ```
//!
//! The jobs themselves are in the crate [`jobs`](::jobs), which a PC can run, too. This module has
//! what only a board has: TCP without an operating system, the debug console's commands, the
//! interface to the ROM ([`abi`]) and the test of the SDRAM ([`memory`]).

pub mod abi;
pub mod memory;

mod console;

use crate::ip::{Ip, StreamHandler, Text};
use crate::net::Us;
use crate::text::Sink;
use ::jobs::executor::Executor;
use ::jobs::server::{Answer, BusyReply, Caller, RequestContext};
use ::jobs::{AHEAD, Jobs, Outside};
use core::num::NonZeroU64;
use wire::jobs::SILENCE_SECONDS;

/// The board's network.
pub trait Network: Outside {
    /// Sends an Ethernet frame.
    fn send_frame(&mut self, frame: &[u8]);
    /// Our addresses.
    fn us(&mut self) -> Us;
}

/// Bytes that a client of a [`BusyReply`] may send ahead: a Hello and a command.
const AHEAD_OF_BUSY_REPLY: usize = 128;
/// Clients told Busy at a time, and one place for the next. When a client takes that place, the
/// one that has waited longest is dropped.
const BUSY_CONNECTIONS: usize = 5;
/// Bytes of the longest frame.
const FRAME: usize = 1514;

/// The connection of a client that came while another one was connected.
#[derive(Debug)]
struct BusyConnection {
    ip: Ip<AHEAD_OF_BUSY_REPLY>,
    busy: BusyReply,
    since: u64,
}

/// The program.
#[derive(Debug)]
pub struct Program<'m> {
    jobs: Jobs<'m>,
    port: Port,
}

/// The port of jobs: the connections.
#[derive(Debug)]
struct Port {
    ip: Ip<AHEAD>,
    /// For clients that come while another one is connected: they may say stop. One of them is
    /// always free.
    busy_connections: [BusyConnection; BUSY_CONNECTIONS],
    /// Clocks.
    per_ms: NonZeroU64,
    /// A frame to be sent.
    answer: [u8; FRAME],
}

impl Answer for Text {
    fn put(&mut self, bytes: &[u8]) {
        Sink::put(self, bytes);
    }

    fn close(&mut self) {
        self.close = true;
    }
}

impl<O: Outside> StreamHandler for RequestContext<'_, '_, O> {
    fn greet(&mut self, _: &mut Text) {
        RequestContext::greet(self);
    }

    fn take(&mut self, bytes: &[u8], out: &mut Text) -> usize {
        RequestContext::take(self, bytes, out)
    }
}

impl<O: Outside> StreamHandler for Caller<'_, '_, O> {
    fn greet(&mut self, out: &mut Text) {
        Caller::greet(self, out);
    }

    fn take(&mut self, bytes: &[u8], out: &mut Text) -> usize {
        Caller::take(self, bytes, out)
    }
}

/// Frames too short for Ethernet end in zeros; all other bytes of a frame are written.
fn clean(answer: &mut [u8; FRAME]) -> &mut [u8; FRAME] {
    if let Some(shortest) = answer.first_chunk_mut::<60>() {
        *shortest = [0; 60];
    }
    answer
}

impl<'m> Program<'m> {
    /// A program that keeps its jobs in `memory`. `program` is the CRC-32 that identifies it. There
    /// is no program for a board that does not answer or has no segments core.
    pub fn new(memory: &'m mut [u8], program: u32, out: &mut impl Outside) -> Option<Self> {
        let jobs = Jobs::new(memory, program, out)?;
        let clock_hz = jobs.executor().clock_hz();
        let mut port = Port {
            ip: Ip::new(),
            busy_connections: [const {
                BusyConnection {
                    ip: Ip::new(),
                    busy: BusyReply::new(),
                    since: 0,
                }
            }; BUSY_CONNECTIONS],
            per_ms: NonZeroU64::new(u64::from(clock_hz / 1000)).unwrap_or(NonZeroU64::MIN),
            answer: [0; FRAME],
        };
        port.ip.listen(wire::jobs::PORT, wire::jobs::FRAME);
        for connection in &mut port.busy_connections {
            connection.ip.listen(wire::jobs::PORT, wire::jobs::FRAME);
        }
        Some(Program { jobs, port })
    }

    /// The executor.
    pub fn executor(&self) -> &Executor {
        self.jobs.executor()
    }

    /// Takes a TCP frame for [`wire::jobs::PORT`].
    pub fn frame(&mut self, frame: &[u8], out: &mut impl Network) {
        self.port.frame(&mut self.jobs, frame, out);
    }

    /// A client is there, over a connection that is not this program's: the simulator has its own
    /// sockets.
    pub fn visit(&mut self, out: &mut impl Outside) {
        self.jobs.visit(out);
    }

    /// Takes bytes of that connection: [`Jobs::said`].
    pub fn said(&mut self, bytes: &[u8], answer: &mut Text, out: &mut impl Outside) -> usize {
        self.jobs.said(bytes, answer, out)
    }

    /// Takes bytes of another connection while there is one: [`Jobs::busy_reply`].
    pub fn busy_reply(
        &mut self,
        busy: &mut BusyReply,
        bytes: &[u8],
        answer: &mut Text,
        out: &mut impl Outside,
    ) -> usize {
        self.jobs.busy_reply(busy, bytes, answer, out)
    }

    /// Answers a line of the debug console into `room`; returns the answer's length in bytes.
    /// `trusted`: the console's client has proved the board's key, or there is no key.
    pub fn line(
        &mut self,
        line: &[u8],
        trusted: bool,
        room: &mut [u8],
        out: &mut impl Outside,
    ) -> usize {
        let line = core::str::from_utf8(line).unwrap_or("");
        let mut paper = console::Paper::new(room);
        let now = out.now();
        let (store, executor) = self.jobs.works();
        let mut visit = console::Visit {
            store,
            executor,
            now,
            trusted,
        };
        visit.answer(line, &mut paper, out);
        paper.used()
    }

    /// Does a piece of work: a segment, a frame, a block of a job. True while there is more work.
    pub fn poll(&mut self, out: &mut impl Network) -> bool {
        let Program { jobs, port } = self;
        let works = jobs.poll_beside(out, |jobs, turn, now, out| port.speak(jobs, turn, now, out));
        works || port.busy()
    }
}

impl Port {
    fn frame(&mut self, jobs: &mut Jobs, frame: &[u8], out: &mut impl Network) {
        let (us, now) = (out.us(), out.now());
        let now_ms = (now / self.per_ms) as u32;
        let answer = clean(&mut self.answer);
        // A client told Busy stays so, even if the server becomes free.
        let told =
            |connection: &&mut BusyConnection| connection.ip.busy() && connection.ip.is_peer(frame);
        let mut connection = self.busy_connections.iter_mut().find(told);
        // The next client replaces a handshake that is not finished.
        if connection.is_none() && self.ip.taken() && !self.ip.is_peer(frame) {
            connection = self
                .busy_connections
                .iter_mut()
                .find(|connection| !connection.ip.busy());
        }
        let length = if let Some(BusyConnection { ip, busy, since }) = connection {
            let before = ip.busy();
            let mut caller = jobs.caller(busy, now, out);
            let length = ip.frame(frame, &us, now_ms, &mut caller, answer);
            if !before && ip.busy() {
                *since = now;
                make_room(&mut self.busy_connections, now);
            }
            length
        } else {
            let mut context = jobs.request_context(now, out);
            if !self.ip.taken() {
                // A client has the time of silence from its first frame on, not from its
                // predecessor's last. Not behind the frame: that may end a late handshake, and have
                // the first request in it.
                context.greet();
            }
            self.ip.frame(frame, &us, now_ms, &mut context, answer)
        };
        if let Some(frame) = length.and_then(|length| answer.get(..length)) {
            out.send_frame(frame);
        }
    }

    fn any_busy_connection(&self) -> bool {
        self.busy_connections
            .iter()
            .any(|connection| connection.ip.busy())
    }

    fn busy(&self) -> bool {
        self.ip.busy() || self.any_busy_connection()
    }

    /// Sends the next TCP segment. True if there was one.
    fn speak(&mut self, jobs: &mut Jobs, turn: u32, now: u64, out: &mut impl Network) -> bool {
        if !self.busy() {
            return false;
        }
        // The server and the busy replies alternate, so neither can delay the other for long.
        match turn.is_multiple_of(8) {
            true => self.send_busy_reply(jobs, now, out) || self.send_answer(jobs, now, out),
            false => self.send_answer(jobs, now, out) || self.send_busy_reply(jobs, now, out),
        }
    }

    fn send_answer(&mut self, jobs: &mut Jobs, now: u64, out: &mut impl Network) -> bool {
        let us = out.us();
        let now_ms = (now / self.per_ms) as u32;
        let answer = clean(&mut self.answer);
        if self.ip.busy() && jobs.server().silent(now) {
            self.ip.reset();
        }
        let mut context = jobs.request_context(now, out);
        let length = self.ip.poll(&us, now_ms, &mut context, answer);
        let Some(frame) = length.and_then(|length| answer.get(..length)) else {
            return false;
        };
        out.send_frame(frame);
        true
    }

    fn send_busy_reply(&mut self, jobs: &mut Jobs, now: u64, out: &mut impl Network) -> bool {
        let us = out.us();
        let now_ms = (now / self.per_ms) as u32;
        let patience = u64::from(SILENCE_SECONDS) * self.per_ms.get() * 1000;
        for BusyConnection { ip, busy, since } in &mut self.busy_connections {
            if ip.busy() && now.wrapping_sub(*since) >= patience {
                ip.reset();
            }
            let answer = clean(&mut self.answer);
            let mut caller = jobs.caller(busy, now, out);
            let length = ip.poll(&us, now_ms, &mut caller, answer);
            if let Some(frame) = length.and_then(|length| answer.get(..length)) {
                out.send_frame(frame);
                return true;
            }
        }
        false
    }
}

/// Keeps one busy connection free: drops the client that has waited longest.
fn make_room(busy_connections: &mut [BusyConnection; BUSY_CONNECTIONS], now: u64) {
    if busy_connections
        .iter()
        .all(|connection| connection.ip.busy())
    {
        let oldest = |connection: &&mut BusyConnection| now.wrapping_sub(connection.since);
        if let Some(connection) = busy_connections.iter_mut().max_by_key(oldest) {
            connection.ip.reset();
        }
    }
}
