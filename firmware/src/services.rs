//! The services: TCP/IP, consoles and jobs. This is a separate program in SDRAM, because the ROM
//! has no room for it, and because the machine has to outlive it: a panic in here ends the
//! services, not the motion.
//!
//! ```text
//!   frames --> stack (smoltcp) --> port --+--> consoles, and job_lines for jobs
//!                                         +--> jobs::Jobs --> datagram, segments core
//!                                         +--> http: the status page
//!                                         +--> status: names, log, events, time
//!                                         +--> lease: an address from a DHCP server
//! ```
//!
//! Jobs are there on boards with the segments core, and only in the program that is built for them
//! (feature `jobs`). They are in the crate [`jobs`](::jobs), which a PC can run, too. This module
//! has what only a board has: TCP without an operating system ([`stack`], [`port`]), the consoles'
//! commands about jobs, the interface to the ROM ([`abi`]) and the test of the SDRAM ([`memory`]).

pub mod abi;
pub mod console;
pub mod events;
pub mod facts;
pub mod http;
pub mod journal;
pub mod lease;
pub mod line_editor;
pub mod look;
pub mod mdns;
pub mod memory;
pub mod port;
pub mod post;
pub mod sntp;
pub mod stack;
pub mod status;
pub mod syslog;
pub mod telnet;

mod job_lines;
mod shut;
#[cfg(test)]
mod tests;

use self::port::{Place, Port};
use crate::machine::{Lease, VISIT_WORDS, Verb, Verdict};
use crate::net::{UdpPorts, Us};
use crate::text::{Sink, Text};
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
    /// Judges what the client of console `visitor` asks for: [`crate::machine::Machine::visit`].
    fn console(&mut self, visitor: usize, verb: Verb, words: &mut [u32; VISIT_WORDS]) -> Verdict;
}

/// UDP ports the program listens at.
pub const PORTS: UdpPorts = [lease::PORT, wire::mdns::PORT, sntp::PORT, 0, 0, 0, 0, 0];

/// The jobs, where the program is built with them. Without them there is no such value, and the
/// compiler leaves out all that works with one.
#[derive(Debug)]
struct Part<'m> {
    jobs: Jobs<'m>,
    #[cfg(not(feature = "jobs"))]
    never: core::convert::Infallible,
}

impl<'m> Part<'m> {
    #[cfg(feature = "jobs")]
    fn new(memory: &'m mut [u8], program: u32, out: &mut impl Outside) -> Option<Self> {
        let jobs = Jobs::new(memory, program, out)?;
        Some(Part { jobs })
    }

    #[cfg(not(feature = "jobs"))]
    fn new(_: &'m mut [u8], _: u32, _: &mut impl Outside) -> Option<Self> {
        None
    }

    fn jobs(&mut self) -> &mut Jobs<'m> {
        #[cfg(not(feature = "jobs"))]
        match self.never {}
        #[cfg(feature = "jobs")]
        &mut self.jobs
    }
}

/// The program.
#[derive(Debug)]
pub struct Program<'m> {
    /// Not on boards without the segments core.
    part: Option<Part<'m>>,
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
    /// A program that keeps its jobs in `memory`, its log in `log`, and its sockets in `place`.
    /// `program` is the CRC-32 that identifies it. There is no program for a board that does not
    /// answer.
    pub fn new(
        memory: &'m mut [u8],
        log: &'m mut [u8],
        place: &'m mut Place<'m>,
        program: u32,
        out: &mut impl Network,
    ) -> Option<Self> {
        let (_, board) = Inside::new(out)?;
        let part = Part::new(memory, program, out);
        let port = Port::new(place, log, part.is_some(), &board, out);
        Some(Program { part, port })
    }

    /// The executor, on boards with jobs.
    pub fn executor(&self) -> Option<&Executor> {
        self.part.as_ref().map(|part| part.jobs.executor())
    }

    /// Takes a frame of [`crate::net::Class::Services`].
    pub fn frame(&mut self, frame: &[u8], out: &mut impl Network) {
        self.port
            .frame(self.part.as_mut().map(Part::jobs), frame, out);
    }

    /// A client is there, over a connection that is not this program's: the simulator has its own
    /// sockets.
    pub fn visit(&mut self, out: &mut impl Outside) {
        if let Some(jobs) = self.jobs() {
            jobs.visit(out);
        }
    }

    /// Takes bytes of that connection: [`Jobs::said`].
    pub fn said(&mut self, bytes: &[u8], answer: &mut Text, out: &mut impl Outside) -> usize {
        self.jobs().map_or(0, |jobs| jobs.said(bytes, answer, out))
    }

    /// Takes bytes of another connection while there is one: [`Jobs::busy_reply`].
    pub fn busy_reply(
        &mut self,
        busy: &mut BusyReply,
        bytes: &[u8],
        answer: &mut Text,
        out: &mut impl Outside,
    ) -> usize {
        self.jobs()
            .map_or(0, |jobs| jobs.busy_reply(busy, bytes, answer, out))
    }

    /// The jobs, on boards that have them.
    pub fn jobs(&mut self) -> Option<&mut Jobs<'m>> {
        self.part.as_mut().map(Part::jobs)
    }

    /// Does a piece of work: a segment, a frame, a block of a job. True while there is more work.
    pub fn poll(&mut self, out: &mut impl Network) -> bool {
        let Program { part, port } = self;
        let works = match part.as_mut().map(Part::jobs) {
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
