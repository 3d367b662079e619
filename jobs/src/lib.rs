//! Jobs: what a board does without LinuxCNC.
//!
//! ```text
//!   G-code, XYPenPlotter's files --> instruction --> job     a file of instructions, in blocks
//!
//!   a client's bytes --> server --> store                    jobs, in memory
//!                           |
//!                           +-----> executor --> check       within the limits? how long?
//!                                      |    \--> homing      finds switches
//!                                      |    \--> words       FPGA G's --> player
//!                                      |
//!                                    plan --> segments       the segments core's FIFO
//!                                      |
//!                                    inside --> datagram     the board's own server
//! ```
//!
//! [`Jobs`] combines all of it over an [`Outside`]. The board's services add the TCP stack and the
//! debug console (`firmware::services`); `ferrocnc job serve` runs it on a PC, for a board without
//! SDRAM; the simulator and the tests run it over models. The host also uses the upper line, and
//! [`plan`] to say how long a job takes.
//!
//! The executor is a client of its own board: it takes the session, configures, arms and exchanges
//! with the same datagrams as a host. So the rules for sessions, e-stops, the watchdog and faults
//! are the same as for LinuxCNC, and a job and LinuxCNC exclude each other. The job's exchanges
//! feed the watchdog, and it makes none unless the job goes on, or is meant to stand.
//!
//! Everything is bounded: a call does one piece of work, and the memory has a fixed size. The crate
//! knows no sockets and no registers. The protocol of jobs is [`wire::jobs`], where every other
//! protocol on the wire is; what ramps and segments do to an axis is in [`motion`].
#![cfg_attr(not(test), no_std)]
#![forbid(unsafe_code)]

pub mod circle;
pub mod executor;
pub mod fpgag;
pub mod gcode;
pub mod inside;
pub mod instruction;
pub mod job;
pub mod plan;
pub mod player;
pub mod segments;
pub mod server;
pub mod store;
pub mod xypen;

mod check;
mod follower;
mod homing;
mod program;
mod words;

use self::executor::Executor;
use self::inside::Inside;
use self::segments::Core;
use self::server::{Answer, BusyReply, Caller, JobServer, RequestContext};
use self::store::Store;
use wire::MAX_WORDS;

/// The interface to the board.
pub trait Outside {
    /// Gives a datagram to the board's own server; returns the answer's words, 0 if there is no
    /// answer.
    fn datagram(&mut self, request: &[u32], reply: &mut [u32; MAX_WORDS]) -> usize;
    /// The same for an answer of a few words; a longer one is cut, and its length says so. On a
    /// board most of the time of a short question would go into clearing room for the longest
    /// answer: it has one room for all ([`Outside::datagram`] writes what it returns).
    fn ask(&mut self, request: &[u32], reply: &mut [u32]) -> usize {
        self.ask_in(&mut [0; MAX_WORDS], request, reply)
    }

    /// [`Outside::ask`] with this room for the whole answer.
    fn ask_in(&mut self, room: &mut [u32; MAX_WORDS], request: &[u32], reply: &mut [u32]) -> usize {
        let length = self.datagram(request, room);
        for (place, word) in reply.iter_mut().zip(room.iter().take(length)) {
            *place = *word;
        }
        length
    }
    /// A register of the segments core, by its word.
    fn read_segments(&mut self, word: usize) -> u32;
    /// See [`Outside::read_segments`].
    fn write_segments(&mut self, word: usize, value: u32);
    /// Clocks since power-up.
    fn now(&mut self) -> u64;
}

/// Bytes a client may send ahead: four requests.
pub const AHEAD: usize = 4096;

/// Server, store and executor of a board.
#[derive(Debug)]
pub struct Jobs<'m> {
    server: JobServer,
    store: Store<'m>,
    executor: Executor,
    turn: u32,
}

impl<'m> Jobs<'m> {
    /// Jobs in `memory`. `program` identifies the program that executes them; on a board it is the
    /// CRC-32 of its image. It asks the board for its description: there are no jobs on a board
    /// that does not answer or has no segments core.
    pub fn new(memory: &'m mut [u8], program: u32, out: &mut impl Outside) -> Option<Self> {
        let (inside, board) = Inside::new(out)?;
        let cuts = inside.cuts(out).unwrap_or(0);
        let executor = Executor::new(inside, &board, Core::new(out)?, cuts);
        Some(Jobs {
            server: JobServer::new(&board, program),
            store: Store::new(memory),
            executor,
            turn: 0,
        })
    }

    /// The executor.
    pub fn executor(&self) -> &Executor {
        &self.executor
    }

    /// The server.
    pub fn server(&self) -> &JobServer {
        &self.server
    }

    /// Store and executor, for a client that does not come to the server.
    pub fn works(&mut self) -> (&mut Store<'m>, &mut Executor) {
        (&mut self.store, &mut self.executor)
    }

    /// A client is there, over a connection.
    pub fn visit(&mut self, out: &mut impl Outside) {
        self.server.visit(out.now());
    }

    /// The server, for one request of that client.
    pub fn request_context<'a, O: Outside>(
        &'a mut self,
        now: u64,
        out: &'a mut O,
    ) -> RequestContext<'a, 'm, O> {
        RequestContext {
            server: &mut self.server,
            store: &mut self.store,
            executor: &mut self.executor,
            out,
            now,
            budget: 1,
        }
    }

    /// The answers for a client that comes while another one is connected.
    pub fn caller<'a, O: Outside>(
        &'a mut self,
        busy: &'a mut BusyReply,
        now: u64,
        out: &'a mut O,
    ) -> Caller<'a, 'm, O> {
        Caller {
            busy,
            server: &self.server,
            store: &self.store,
            executor: &mut self.executor,
            out,
            now,
        }
    }

    /// Takes bytes of the client's connection, at most one request; returns how many. The answer is
    /// appended to `answer`.
    pub fn said(
        &mut self,
        bytes: &[u8],
        answer: &mut impl Answer,
        out: &mut impl Outside,
    ) -> usize {
        let now = out.now();
        self.request_context(now, out).take(bytes, answer)
    }

    /// Takes bytes of another connection while there is one; returns how many. Its client was told
    /// [`wire::jobs::Status::Busy`] before.
    pub fn busy_reply(
        &mut self,
        busy: &mut BusyReply,
        bytes: &[u8],
        answer: &mut impl Answer,
        out: &mut impl Outside,
    ) -> usize {
        let now = out.now();
        self.caller(busy, now, out).take(bytes, answer)
    }

    /// Does a piece of work: a segment, a block of a job. True while there is more work.
    pub fn poll(&mut self, out: &mut impl Outside) -> bool {
        self.poll_beside(out, |_, _, _, _| false)
    }

    /// The same beside other work of the caller. `other` does a piece of that, and says whether
    /// there was one; it gets the turn's number, the time and the board.
    pub fn poll_beside<O: Outside>(
        &mut self,
        out: &mut O,
        other: impl FnOnce(&mut Self, u32, u64, &mut O) -> bool,
    ) -> bool {
        let now = out.now();
        self.turn = self.turn.wrapping_add(1);
        let turn = self.turn;
        // The executor gets three of four turns while it has work.
        let busy = !turn.is_multiple_of(4) && self.executor.poll(&mut self.store, now, out);
        // Clients that keep asking must not stop the check of an upload.
        if !busy && (!other(self, turn, now, out) || turn.is_multiple_of(8)) {
            self.store.poll();
        }
        self.executor.busy() || self.store.reads()
    }
}
