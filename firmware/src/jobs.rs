//! Jobs: what the board does without a PC. This is a separate program in SDRAM, because the ROM has
//! no room for it.
//!
//! ```text
//!   frames --> ip --> desk ----> store      jobs, in the SDRAM
//!                      |
//!                      +-------> executor --> check     is it within the limits, and how long is it
//!                                   |    \--> homing    finds switches
//!                                   |    \--> words     FPGA G's
//!                                   |
//!                     motion's planner --> core         the segments FIFO
//!                                   |
//!                                 inside --> datagram   the board's own server
//! ```
//!
//! [`Jobs`] combines all of it over an [`Outside`]: the program on the board, the simulator, the
//! tests. The executor is a client of its own board: it takes the session, configures, arms and
//! exchanges with the same datagrams as a host. So the rules for sessions, e-stops, the watchdog
//! and faults are the same as for LinuxCNC, and a job and LinuxCNC exclude each other. The job's
//! exchanges feed the watchdog, and it makes none unless the job goes on, or is meant to stand.
//!
//! Everything is bounded: a call does one piece of work, and the memory has a fixed size.

pub mod abi;
pub mod core;
pub mod desk;
pub mod executor;
pub mod inside;
pub mod memory;
pub mod store;

mod check;
mod console;
mod homing;
mod marks;
mod program;
mod words;

use self::core::Core;
use self::desk::{Caller, Counter, Desk, Door};
use self::executor::Executor;
use self::inside::Inside;
use self::store::Store;
use crate::ip::{Ip, Taker as _, Text};
use crate::net::Us;
use ::core::num::NonZeroU64;
use wire::MAX_WORDS;
use wire::jobs::SILENCE_SECONDS;

/// The program's interface to the rest of the board.
pub trait Outside {
    /// Gives a datagram to the board's own server; returns the answer's words, 0 if there is no
    /// answer.
    fn datagram(&mut self, request: &[u32], reply: &mut [u32; MAX_WORDS]) -> usize;
    /// Sends an Ethernet frame.
    fn send_frame(&mut self, frame: &[u8]);
    /// A register of the segments core, by its word.
    fn read_segments(&mut self, word: usize) -> u32;
    /// See [`Outside::read_segments`].
    fn write_segments(&mut self, word: usize, value: u32);
    /// Clocks since power-up.
    fn now(&mut self) -> u64;
    /// Our addresses.
    fn us(&mut self) -> Us;
}

/// Bytes a client may send ahead: four requests.
pub const AHEAD: usize = 4096;
/// Bytes that a client of a [`desk::Door`] may send ahead: a Hello and a command.
const AHEAD_OF_DOOR: usize = 128;
/// Clients at the door at a time, and one place for the next. When a client takes that place, the
/// one that has been at the door longest is dropped.
const DOORS: usize = 5;
/// Bytes of the longest frame.
const FRAME: usize = 1514;

/// The connection of a client that came while another one was connected.
#[derive(Debug)]
struct Entrance {
    ip: Ip<AHEAD_OF_DOOR>,
    door: Door,
    since: u64,
}

/// The program.
#[derive(Debug)]
pub struct Jobs<'m> {
    ip: Ip<AHEAD>,
    /// For clients that come while another one is connected: they may say stop. One entrance is
    /// always free.
    doors: [Entrance; DOORS],
    desk: Desk,
    store: Store<'m>,
    executor: Executor,
    turn: u32,
    /// Clocks.
    per_ms: NonZeroU64,
    /// A frame to be sent.
    answer: [u8; FRAME],
}

/// Frames too short for Ethernet end in zeros; all other bytes of a frame are written.
fn clean(answer: &mut [u8; FRAME]) -> &mut [u8; FRAME] {
    if let Some(shortest) = answer.first_chunk_mut::<60>() {
        *shortest = [0; 60];
    }
    answer
}

impl<'m> Jobs<'m> {
    /// A program that keeps its jobs in `memory`. `program` is the CRC-32 that identifies it. It
    /// asks the board for its description. There is no program for a board that does not answer or
    /// has no segments core.
    pub fn new(memory: &'m mut [u8], program: u32, out: &mut impl Outside) -> Option<Self> {
        let (inside, board) = Inside::new(out)?;
        let cuts = inside.cuts(out).unwrap_or(0);
        let executor = Executor::new(inside, &board, Core::new(out)?, cuts);
        let mut jobs = Jobs {
            ip: Ip::new(),
            doors: [const {
                Entrance {
                    ip: Ip::new(),
                    door: Door::new(),
                    since: 0,
                }
            }; DOORS],
            desk: Desk::new(&board, program),
            store: Store::new(memory),
            executor,
            turn: 0,
            per_ms: NonZeroU64::new(u64::from(board.clock_hz / 1000)).unwrap_or(NonZeroU64::MIN),
            answer: [0; FRAME],
        };
        jobs.ip.listen(wire::jobs::PORT, wire::jobs::FRAME);
        for entrance in &mut jobs.doors {
            entrance.ip.listen(wire::jobs::PORT, wire::jobs::FRAME);
        }
        Some(jobs)
    }

    /// The executor.
    pub fn executor(&self) -> &Executor {
        &self.executor
    }

    /// Takes a TCP frame for [`wire::jobs::PORT`].
    pub fn frame(&mut self, frame: &[u8], out: &mut impl Outside) {
        let (us, now) = (out.us(), out.now());
        let now_ms = (now / self.per_ms) as u32;
        let answer = clean(&mut self.answer);
        // A client at the door stays at the door, even if the desk becomes free.
        let told = |entrance: &&mut Entrance| entrance.ip.busy() && entrance.ip.is_peer(frame);
        let mut entrance = self.doors.iter_mut().find(told);
        // The next client replaces a handshake that is not finished.
        if entrance.is_none() && self.ip.taken() && !self.ip.is_peer(frame) {
            entrance = self.doors.iter_mut().find(|entrance| !entrance.ip.busy());
        }
        let length = if let Some(Entrance { ip, door, since }) = entrance {
            let before = ip.busy();
            let mut caller = Caller {
                door,
                desk: &self.desk,
                store: &self.store,
                executor: &mut self.executor,
                out,
                now,
            };
            let length = ip.frame(frame, &us, now_ms, &mut caller, answer);
            if !before && ip.busy() {
                *since = now;
                make_room(&mut self.doors, now);
            }
            length
        } else {
            if !self.ip.taken() {
                // A client has the time of silence from its first frame on, not from its
                // predecessor's last. Not behind the frame: that may end a late handshake, and have
                // the first request in it.
                self.desk.visit(now);
            }
            let mut counter = Counter {
                desk: &mut self.desk,
                store: &mut self.store,
                executor: &mut self.executor,
                out,
                now,
                budget: 1,
            };
            self.ip.frame(frame, &us, now_ms, &mut counter, answer)
        };
        if let Some(frame) = length.and_then(|length| answer.get(..length)) {
            out.send_frame(frame);
        }
    }

    /// A client is there, over a connection that is not this program's: the simulator has its own
    /// sockets.
    pub fn visit(&mut self, out: &mut impl Outside) {
        self.desk.visit(out.now());
    }

    /// Takes bytes of that connection, at most one request; returns how many. The answer is
    /// appended to `answer`.
    pub fn said(&mut self, bytes: &[u8], answer: &mut Text, out: &mut impl Outside) -> usize {
        let now = out.now();
        let mut counter = Counter {
            desk: &mut self.desk,
            store: &mut self.store,
            executor: &mut self.executor,
            out,
            now,
            budget: 1,
        };
        counter.take(bytes, answer)
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
        let line = ::core::str::from_utf8(line).unwrap_or("");
        let mut paper = console::Paper::new(room);
        let now = out.now();
        let mut visit = console::Visit {
            store: &mut self.store,
            executor: &mut self.executor,
            now,
            trusted,
        };
        visit.answer(line, &mut paper, out);
        paper.used()
    }

    /// Takes bytes of another connection while there is one; returns how many. Its client was told
    /// [`wire::jobs::Status::Busy`] before.
    pub fn knock(
        &mut self,
        door: &mut Door,
        bytes: &[u8],
        answer: &mut Text,
        out: &mut impl Outside,
    ) -> usize {
        let now = out.now();
        let mut caller = Caller {
            door,
            desk: &self.desk,
            store: &self.store,
            executor: &mut self.executor,
            out,
            now,
        };
        caller.take(bytes, answer)
    }

    fn anybody_at_door(&self) -> bool {
        self.doors.iter().any(|entrance| entrance.ip.busy())
    }

    /// Does a piece of work: a segment, a frame, a block of a job. True while there is more work.
    pub fn poll(&mut self, out: &mut impl Outside) -> bool {
        let now = out.now();
        self.turn = self.turn.wrapping_add(1);
        // The executor gets three of four turns while it has work.
        let busy = !self.turn.is_multiple_of(4) && self.executor.poll(&mut self.store, now, out);
        // Clients that keep asking must not stop the check of an upload.
        if !busy && (!self.speak(now, out) || self.turn.is_multiple_of(8)) {
            self.store.poll();
        }
        self.executor.busy() || self.ip.busy() || self.anybody_at_door() || self.store.reads()
    }

    /// Sends the next TCP segment. True if there was one.
    fn speak(&mut self, now: u64, out: &mut impl Outside) -> bool {
        if !self.ip.busy() && !self.anybody_at_door() {
            return false;
        }
        // The desk and the doors alternate, so neither can delay the other for long.
        match self.turn.is_multiple_of(8) {
            true => self.speak_at_door(now, out) || self.speak_at_desk(now, out),
            false => self.speak_at_desk(now, out) || self.speak_at_door(now, out),
        }
    }

    fn speak_at_desk(&mut self, now: u64, out: &mut impl Outside) -> bool {
        let us = out.us();
        let now_ms = (now / self.per_ms) as u32;
        let answer = clean(&mut self.answer);
        if self.ip.busy() && self.desk.silent(now) {
            self.ip.reset();
        }
        let mut counter = Counter {
            desk: &mut self.desk,
            store: &mut self.store,
            executor: &mut self.executor,
            out,
            now,
            budget: 1,
        };
        let length = self.ip.poll(&us, now_ms, &mut counter, answer);
        let Some(frame) = length.and_then(|length| answer.get(..length)) else {
            return false;
        };
        out.send_frame(frame);
        true
    }

    fn speak_at_door(&mut self, now: u64, out: &mut impl Outside) -> bool {
        let us = out.us();
        let now_ms = (now / self.per_ms) as u32;
        let patience = u64::from(SILENCE_SECONDS) * self.per_ms.get() * 1000;
        for Entrance { ip, door, since } in &mut self.doors {
            if ip.busy() && now.wrapping_sub(*since) >= patience {
                ip.reset();
            }
            let answer = clean(&mut self.answer);
            let mut caller = Caller {
                door,
                desk: &self.desk,
                store: &self.store,
                executor: &mut self.executor,
                out,
                now,
            };
            let length = ip.poll(&us, now_ms, &mut caller, answer);
            if let Some(frame) = length.and_then(|length| answer.get(..length)) {
                out.send_frame(frame);
                return true;
            }
        }
        false
    }
}

/// Keeps one entrance free: drops the client that has been at the door longest.
fn make_room(doors: &mut [Entrance; DOORS], now: u64) {
    if doors.iter().all(|entrance| entrance.ip.busy()) {
        let oldest = |entrance: &&mut Entrance| now.wrapping_sub(entrance.since);
        if let Some(entrance) = doors.iter_mut().max_by_key(oldest) {
            entrance.ip.reset();
        }
    }
}
