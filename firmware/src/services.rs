//! The services: TCP/IP, consoles and jobs. This is a separate program in SDRAM, because the ROM has
//! no room for it, and because the machine has to outlive it: a panic in here ends the services,
//! not the motion.
//!
//! ```text
//!   frames --> stack (smoltcp) --> port --+--> consoles --> the ROM's text, and job_lines
//!                                         +--> jobs::Jobs --> datagram, segments core
//! ```
//!
//! The jobs themselves are in the crate [`jobs`](::jobs), which a PC can run, too. This module has
//! what only a board has: TCP without an operating system ([`stack`], [`port`]), the consoles'
//! commands about jobs, the interface to the ROM ([`abi`]) and the test of the SDRAM ([`memory`]).

pub mod abi;
pub mod events;
pub mod http;
pub mod journal;
pub mod look;
pub mod mdns;
pub mod memory;
pub mod port;
pub mod sntp;
pub mod stack;
pub mod syslog;

mod job_lines;

use self::port::{Place, Port};
use crate::console::{ANSWER_MAX, PROMPT};
use crate::ip::Text;
use crate::machine::Reply;
use crate::net::Us;
use crate::text::{Paper, Sink};
use ::jobs::executor::Executor;
use ::jobs::server::{Answer, BusyReply};
use ::jobs::{Jobs, Outside};

/// The board's network, and its console.
pub trait Network: Outside {
    /// Sends an Ethernet frame.
    fn send_frame(&mut self, frame: &[u8]);
    /// Sends an Ethernet frame of this length that `write` writes, over zeros; in the board's own
    /// buffer if it has one, because to copy a frame takes clocks.
    fn send_with<R>(&mut self, length: usize, write: impl FnOnce(&mut [u8]) -> R) -> R {
        let mut frame = [0; abi::FRAME_MAX];
        let (frame, _) = frame.split_at_mut(length.min(abi::FRAME_MAX));
        let result = write(frame);
        self.send_frame(frame);
        result
    }
    /// Our addresses.
    fn us(&mut self) -> Us;
    /// Answers a line of console `visitor`: [`crate::machine::Machine::converse`].
    fn console(&mut self, visitor: usize, line: Option<&str>, out: &mut dyn Sink) -> Reply;
}

/// Longest answer to a line about jobs: the console's longest answer without the prompt after it.
pub const TEXT_MAX: usize = ANSWER_MAX - PROMPT.len();

/// The program.
#[derive(Debug)]
pub struct Program<'m> {
    jobs: Jobs<'m>,
    port: Port<'m>,
}

impl Answer for Text {
    fn put(&mut self, bytes: &[u8]) {
        Sink::put(self, bytes);
    }

    fn close(&mut self) {
        self.close = true;
    }
}

impl<'m> Program<'m> {
    /// A program that keeps its jobs in `memory`, and its sockets in `place`. `program` is the
    /// CRC-32 that identifies it. There is no program for a board that does not answer or has no
    /// segments core.
    pub fn new(
        memory: &'m mut [u8],
        place: &'m mut Place<'m>,
        program: u32,
        out: &mut impl Network,
    ) -> Option<Self> {
        let jobs = Jobs::new(memory, program, out)?;
        let port = Port::new(place, jobs.executor().clock_hz(), out);
        Some(Program { jobs, port })
    }

    /// The executor.
    pub fn executor(&self) -> &Executor {
        self.jobs.executor()
    }

    /// Takes a frame: ARP, a ping, or a TCP segment.
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

    /// Answers a line about jobs into `room`; returns the answer's length in bytes. `trusted`: the
    /// console's client has proved the board's key, or there is no key.
    pub fn line(
        &mut self,
        line: &[u8],
        trusted: bool,
        room: &mut [u8],
        out: &mut impl Outside,
    ) -> usize {
        let line = core::str::from_utf8(line).unwrap_or("");
        let mut paper = Paper::new(room);
        let now = out.now();
        job_lines::answer(&mut self.jobs, line, trusted, now, &mut paper, out);
        paper.used()
    }

    /// Does a piece of work: a segment, a frame, a block of a job. True while there is more work.
    pub fn poll(&mut self, out: &mut impl Network) -> bool {
        let Program { jobs, port } = self;
        let works = jobs.poll_beside(out, |jobs, _, now, out| port.turn(jobs, now, out));
        works || port.busy()
    }

    /// Is there work of the connections for the next turn?
    pub fn busy(&self) -> bool {
        self.port.busy()
    }
}
