//! Jobs: what the board does without a PC. A program of its own, in SDRAM; the ROM has no room for it.
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
//! [`Jobs`] is all of it, for whoever has an [`Outside`]: the program on the board, the simulator, the tests. The executor is a client of its own
//! board: it takes the session, configures, arms and exchanges with the datagrams a host would send. So what a session, an e-stop, the
//! watchdog and a fault are is decided where it is for LinuxCNC, and a job and LinuxCNC exclude each other. The watchdog is fed by
//! its exchanges, and it makes none unless the job goes on, or stands because it shall.
//!
//! Everything is bounded: a call does one thing, and memory is what it was given.

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
use self::desk::{Counter, Desk};
use self::executor::Executor;
use self::inside::Inside;
use self::store::Store;
use crate::ip::{Ip, Taker as _, Text};
use crate::net::Us;
use wire::MAX_WORDS;

/// What is outside of the program.
pub trait Outside {
    /// Gives a datagram to the board's own server; words of the answer, 0 if there is none.
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
/// Somebody for whom there is no time may say a Hello.
const AHEAD_OF_DOOR: usize = 64;
/// Bytes of the longest frame.
const FRAME: usize = 1514;

/// The program.
#[derive(Debug)]
pub struct Jobs<'m> {
    ip: Ip<AHEAD>,
    /// Says to others that somebody is there.
    door: Ip<AHEAD_OF_DOOR>,
    desk: Desk,
    store: Store<'m>,
    executor: Executor,
    turn: u32,
    per_ms: u32,
    /// For a frame to be sent.
    answer: [u8; FRAME],
}

/// What is too short for Ethernet ends in zeros; everything else of a frame is written.
fn clean(answer: &mut [u8; FRAME]) -> &mut [u8; FRAME] {
    if let Some(shortest) = answer.first_chunk_mut::<60>() {
        *shortest = [0; 60];
    }
    answer
}

impl<'m> Jobs<'m> {
    /// A program that keeps its jobs in `memory`. `program` is the CRC-32 it is known by. It asks the board who it is; one that does not
    /// answer, or has no segments core, gets no program.
    pub fn new(memory: &'m mut [u8], program: u32, out: &mut impl Outside) -> Option<Self> {
        let (inside, board) = Inside::new(out)?;
        let executor = Executor::new(inside, &board, Core::new(out)?);
        let mut jobs = Jobs {
            ip: Ip::new(),
            door: Ip::new(),
            desk: Desk::new(&board, program),
            store: Store::new(memory),
            executor,
            turn: 0,
            per_ms: (board.clock_hz / 1000).max(1),
            answer: [0; FRAME],
        };
        jobs.ip.listen(wire::jobs::PORT, wire::jobs::FRAME);
        jobs.door.listen(wire::jobs::PORT, wire::jobs::FRAME);
        Some(jobs)
    }

    /// What is executed.
    pub fn executor(&self) -> &Executor {
        &self.executor
    }

    /// Takes a TCP frame for [`wire::jobs::PORT`].
    pub fn frame(&mut self, frame: &[u8], out: &mut impl Outside) {
        let (us, now) = (out.us(), out.now());
        let now_ms = (now / u64::from(self.per_ms)) as u32;
        let answer = clean(&mut self.answer);
        // Who was told that somebody is there says goodbye to whom he was told by, though nobody is there any more.
        let told = self.door.busy() && self.door.is_peer(frame);
        let length = if told || self.ip.busy() && !self.ip.is_peer(frame) {
            if !told {
                // Who was told before may have vanished; he has waited long enough.
                self.door.reset();
            }
            self.door.frame(frame, &us, now_ms, &mut desk::Door, answer)
        } else {
            let nobody = !self.ip.busy();
            let mut counter = Counter {
                desk: &mut self.desk,
                store: &mut self.store,
                executor: &mut self.executor,
                out,
                now,
                budget: 1,
            };
            let length = self.ip.frame(frame, &us, now_ms, &mut counter, answer);
            if nobody && self.ip.busy() {
                // He has the time of silence from his first frame on, not from his predecessor's last.
                self.desk.visit(now);
            }
            length
        };
        if let Some(frame) = length.and_then(|length| answer.get(..length)) {
            out.send_frame(frame);
        }
    }

    /// Somebody is there, over a connection that is not this program's: the simulator has sockets of its own.
    pub fn visit(&mut self, out: &mut impl Outside) {
        self.desk.visit(out.now());
    }

    /// Takes bytes of that connection, at most one request; how many. What is to be answered is behind what is in `answer` already.
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

    /// Answers a line of the debug console into `room`; how many bytes that takes. `trusted`: whoever says it has the board's key, or there is
    /// none.
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

    /// Does a piece of work: a segment, a frame, a block of a job. True while there is more to do than to wait.
    pub fn poll(&mut self, out: &mut impl Outside) -> bool {
        let now = out.now();
        self.turn = self.turn.wrapping_add(1);
        // Three of four turns are the executor's while it has something to do.
        let busy = !self.turn.is_multiple_of(4) && self.executor.poll(&mut self.store, now, out);
        if !busy && !self.speak(now, out) {
            self.store.poll();
        }
        self.executor.busy() || self.ip.busy() || self.door.busy() || self.store.reads()
    }

    /// What TCP has to say now. Whether it was anything.
    fn speak(&mut self, now: u64, out: &mut impl Outside) -> bool {
        if !self.ip.busy() && !self.door.busy() {
            return false;
        }
        let us = out.us();
        let now_ms = (now / u64::from(self.per_ms)) as u32;
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
        let mut length = self.ip.poll(&us, now_ms, &mut counter, answer);
        if length.is_none() {
            length = self.door.poll(&us, now_ms, &mut desk::Door, answer);
        }
        match length.and_then(|length| answer.get(..length)) {
            Some(frame) => out.send_frame(frame),
            None => return false,
        }
        true
    }
}
