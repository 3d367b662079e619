//! The services: TCP/IP, consoles and jobs. This is a separate program in SDRAM, because the ROM
//! has no room for it, and because the machine has to outlive it: a panic in here ends the
//! services, not the motion.
//!
//! ```text
//!   frames --> stack (smoltcp) --> port --+--> consoles --> the ROM's text, and job_lines
//!                                         +--> jobs::Jobs --> datagram, segments core
//!                                         +--> lease: an address from a DHCP server
//! ```
//!
//! Jobs are there on boards with the segments core. They are in the crate [`jobs`](::jobs), which a
//! PC can run, too. This module has
//! what only a board has: TCP without an operating system ([`stack`], [`port`]), the consoles'
//! commands about jobs, the interface to the ROM ([`abi`]) and the test of the SDRAM ([`memory`]).

pub mod abi;
pub mod events;
pub mod facts;
pub mod http;
pub mod journal;
pub mod lease;
pub mod look;
pub mod mdns;
pub mod memory;
pub mod port;
pub mod sntp;
pub mod stack;
pub mod syslog;

mod job_lines;
mod shut;
#[cfg(test)]
mod tests;

use self::port::{Place, Port};
use crate::console::{ANSWER_MAX, NO_JOBS, PROMPT};
use crate::machine::{Lease, Reply};
use crate::net::{UdpPorts, Us};
use crate::text::{Out, Paper, Sink, Text};
use ::jobs::executor::Executor;
use ::jobs::inside::Inside;
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
    /// Does a host move the machine? Its next exchange waits for what is done now.
    fn moving(&mut self) -> bool {
        false
    }
    /// A DHCP server has given the board an address, or the lease is over.
    fn leased(&mut self, lease: Option<Lease>);
    /// Answers a line of console `visitor`: [`crate::machine::Machine::converse`].
    fn console(&mut self, visitor: usize, line: Option<&str>, out: &mut dyn Sink) -> Reply;
}

/// Longest answer to a line about jobs: the console's longest answer without the prompt after it.
pub const TEXT_MAX: usize = ANSWER_MAX - PROMPT.len();

/// UDP ports the program listens at.
pub const PORTS: UdpPorts = [lease::PORT, 0, 0, 0, 0, 0, 0, 0];

/// The program.
#[derive(Debug)]
pub struct Program<'m> {
    /// Not on boards without the segments core.
    jobs: Option<Jobs<'m>>,
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
    /// CRC-32 that identifies it. There is no program for a board that does not answer.
    pub fn new(
        memory: &'m mut [u8],
        place: &'m mut Place<'m>,
        program: u32,
        out: &mut impl Network,
    ) -> Option<Self> {
        let (_, board) = Inside::new(out)?;
        let jobs = Jobs::new(memory, program, out);
        let port = Port::new(place, jobs.is_some(), board.clock_hz, out);
        Some(Program { jobs, port })
    }

    /// The executor, on boards with jobs.
    pub fn executor(&self) -> Option<&Executor> {
        self.jobs.as_ref().map(Jobs::executor)
    }

    /// Takes a frame of [`crate::net::Class::Services`].
    pub fn frame(&mut self, frame: &[u8], out: &mut impl Network) {
        self.port.frame(self.jobs.as_mut(), frame, out);
    }

    /// A client is there, over a connection that is not this program's: the simulator has its own
    /// sockets.
    pub fn visit(&mut self, out: &mut impl Outside) {
        if let Some(jobs) = &mut self.jobs {
            jobs.visit(out);
        }
    }

    /// Takes bytes of that connection: [`Jobs::said`].
    pub fn said(&mut self, bytes: &[u8], answer: &mut Text, out: &mut impl Outside) -> usize {
        let jobs = self.jobs.as_mut();
        jobs.map_or(0, |jobs| jobs.said(bytes, answer, out))
    }

    /// Takes bytes of another connection while there is one: [`Jobs::busy_reply`].
    pub fn busy_reply(
        &mut self,
        busy: &mut BusyReply,
        bytes: &[u8],
        answer: &mut Text,
        out: &mut impl Outside,
    ) -> usize {
        let jobs = self.jobs.as_mut();
        jobs.map_or(0, |jobs| jobs.busy_reply(busy, bytes, answer, out))
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
        job_line(self.jobs.as_mut(), line, trusted, &mut paper, out);
        paper.used()
    }

    /// Does a piece of work: a segment, a frame, a block of a job. True while there is more work.
    pub fn poll(&mut self, out: &mut impl Network) -> bool {
        let Program { jobs, port } = self;
        let works = match jobs {
            Some(jobs) => {
                jobs.poll_beside(out, |jobs, _, now, out| port.turn(Some(jobs), now, out))
            }
            None => {
                let now = out.now();
                port.turn(None, now, out)
            }
        };
        works || port.busy()
    }

    /// Is a client connected, at a console or for jobs?
    pub fn visited(&self) -> bool {
        self.port.visited()
    }

    /// Is there work of the connections for the next turn?
    pub fn busy(&self) -> bool {
        self.port.busy()
    }
}

/// Answers a line about jobs.
fn job_line(
    jobs: Option<&mut Jobs>,
    line: &str,
    trusted: bool,
    paper: &mut Paper,
    out: &mut impl Outside,
) {
    match jobs {
        Some(jobs) => {
            let now = out.now();
            job_lines::answer(jobs, line, trusted, now, paper, out);
        }
        None => Out(paper).text(NO_JOBS).end(),
    }
}
