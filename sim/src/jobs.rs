//! Runs the program that executes jobs beside the firmware of a twin: [`firmware::services`] with a
//! piece of this computer's memory as SDRAM.
//!
//! Its TCP is the machine's own: a client's bytes go to the job server as they come. On a board the
//! loop calls it; here it is called when something has come and every [`TURN`] while it has work.

use ::jobs::server::BusyReply;
use ::jobs::{AHEAD, Jobs, Outside};
use firmware::machine::{Guest, Lease, VISIT_WORDS, Verb, Verdict};
use firmware::net::Us;
use firmware::services::Network;
use firmware::services::console::{Console, Visit};
use firmware::services::port::Place;
use firmware::text::Text;
use wire::MAX_WORDS;
use wire::jobs::{self, FRAME, Op, Status};
use wire::regmap;

use crate::model_board::ModelBoard;

/// Clocks of a turn of the loop in which it does a piece of work: a segment planned, a block of a
/// job read. A round figure.
pub const TURN: u64 = 12_000;
/// Clocks between two looks while there is nothing to do: what the ROM's loop takes for that.
const IDLE_MS: u64 = 1;
/// The SDRAM, less what the program itself takes at its beginning.
pub(crate) const ROOM: usize = regmap::SDRAM_SIZE - firmware::services::abi::ROOM;
/// The id of the program; on a board it is the program's CRC.
pub(crate) const PROGRAM: u32 = 0x7477_696e;

/// The board as the program sees it from inside.
#[derive(Debug)]
pub struct Outer<'a>(pub Guest<'a, ModelBoard>);

impl Outside for Outer<'_> {
    fn datagram(&mut self, request: &[u32], reply: &mut [u32; MAX_WORDS]) -> usize {
        let answer = self.0.inside(request, reply);
        answer.map_or(0, <[u32]>::len)
    }
    fn read_segments(&mut self, word: usize) -> u32 {
        self.0.read_segments(word)
    }
    fn write_segments(&mut self, word: usize, value: u32) {
        self.0.write_segments(word, value);
    }
    fn now(&mut self) -> u64 {
        self.0.now()
    }
}

impl Network for Outer<'_> {
    fn send_frame(&mut self, _: &[u8]) {}
    fn us(&mut self) -> Us {
        self.0.us
    }
    fn leased(&mut self, lease: Option<Lease>) {
        self.0.leased(lease);
    }
    fn console(&mut self, visitor: usize, verb: Verb, words: &mut [u32; VISIT_WORDS]) -> Verdict {
        self.0.visit(visitor, verb, words)
    }
}

/// All that a console says to these bytes, and whether it hangs up then.
pub fn converse<O: Network>(
    console: &mut Console,
    mut bytes: &[u8],
    visit: &mut Visit<'_, '_, O>,
) -> (Vec<u8>, bool) {
    let (mut said, mut text) = (Vec::new(), Text::new());
    while !text.close && (console.busy() || !bytes.is_empty()) {
        text.clear();
        let ready = if console.busy() { &[] } else { bytes };
        let taken = console.turn(ready, visit, &mut text);
        bytes = &bytes[taken..];
        said.extend(text.bytes());
    }
    (said, text.close)
}

/// The program.
#[derive(Debug)]
pub struct Program {
    jobs: firmware::services::Program<'static>,
    /// The client that has the line.
    visitor: Option<usize>,
    /// Received bytes that are not yet read.
    ahead: Vec<u8>,
    /// Clients that connected meanwhile, with their bytes that are not yet read.
    callers: Vec<(usize, BusyReply, Vec<u8>)>,
    per_ms: u64,
}

/// Output for a client.
#[derive(Clone, Debug, Default)]
pub struct Said {
    /// The client.
    pub visitor: usize,
    /// The bytes.
    pub bytes: Vec<u8>,
    /// Closes the connection afterwards.
    pub close: bool,
}

impl Program {
    /// On this board; `None` if it does not answer.
    pub fn start(machine: Guest<'_, ModelBoard>, clock_hz: u32) -> Option<Self> {
        // Never freed: there are few boards, and each lives as long as its simulator.
        let memory = vec![0; ROOM].leak();
        let place = Box::leak(Box::new(Place::new()));
        let mut outer = Outer(machine);
        Some(Program {
            jobs: firmware::services::Program::new(memory, &mut [], place, PROGRAM, &mut outer)?,
            visitor: None,
            ahead: Vec::new(),
            callers: Vec::new(),
            per_ms: u64::from(clock_hz / 1000),
        })
    }

    /// A client connects. Returns the answer for it if another client is connected; it may still
    /// send a stop.
    pub fn open(&mut self, visitor: usize, machine: Guest<'_, ModelBoard>) -> Option<Vec<u8>> {
        if self.visitor.is_some() {
            let mut frame = [0; FRAME];
            let length = jobs::answer(Op::Hello.code(), Status::Busy, 0, &mut frame, |_| {});
            self.callers.push((visitor, BusyReply::new(), Vec::new()));
            return Some(frame[..length].to_vec());
        }
        self.visitor = Some(visitor);
        self.ahead.clear();
        self.jobs.visit(&mut Outer(machine));
        None
    }

    /// Bytes from a client; returns how many were taken.
    pub fn type_in(&mut self, visitor: usize, bytes: &[u8]) -> usize {
        if self.visitor != Some(visitor) {
            if let Some((.., ahead)) = self.caller(visitor) {
                ahead.extend(bytes);
            }
            return bytes.len();
        }
        let taken = bytes.len().min(AHEAD.saturating_sub(self.ahead.len()));
        self.ahead.extend(&bytes[..taken]);
        taken
    }

    fn caller(&mut self, visitor: usize) -> Option<&mut (usize, BusyReply, Vec<u8>)> {
        let mut callers = self.callers.iter_mut();
        callers.find(|(caller, ..)| *caller == visitor)
    }

    /// Bytes that have not been read yet.
    pub fn untold(&self, visitor: usize) -> usize {
        match self.visitor == Some(visitor) {
            true => self.ahead.len(),
            false => 0,
        }
    }

    /// The client is gone.
    pub fn close(&mut self, visitor: usize) {
        if self.visitor == Some(visitor) {
            self.visitor = None;
            self.ahead.clear();
        }
        self.callers.retain(|(caller, ..)| *caller != visitor);
    }

    /// The jobs, for the consoles.
    pub fn jobs(&mut self) -> Option<&mut Jobs<'static>> {
        self.jobs.jobs()
    }

    /// A turn of the program: returns its output, and the clocks until the next turn.
    pub fn turn(&mut self, machine: Guest<'_, ModelBoard>) -> (Option<Said>, u64) {
        let mut outer = Outer(machine);
        let said = self.visitor.and_then(|visitor| {
            let mut text = Text::new();
            let taken = self.jobs.said(&self.ahead, &mut text, &mut outer);
            self.ahead.drain(..taken);
            let said = Said {
                visitor,
                bytes: text.bytes().to_vec(),
                close: text.close,
            };
            (said.close || !said.bytes.is_empty()).then_some(said)
        });
        let said = said.or_else(|| self.busy_reply(&mut outer));
        let works = self.jobs.poll(&mut outer) || self.visitor.is_some();
        (said, if works { TURN } else { IDLE_MS * self.per_ms })
    }

    /// The answer to a client that connected while another one was there.
    fn busy_reply(&mut self, outer: &mut Outer) -> Option<Said> {
        let callers = self.callers.iter_mut();
        let (visitor, busy, ahead) = { callers }.find(|(.., ahead)| !ahead.is_empty())?;
        let mut text = Text::new();
        let taken = self.jobs.busy_reply(busy, ahead, &mut text, outer);
        ahead.drain(..taken);
        let said = Said {
            visitor: *visitor,
            bytes: text.bytes().to_vec(),
            close: text.close,
        };
        if said.close {
            ahead.clear();
        }
        (said.close || !said.bytes.is_empty()).then_some(said)
    }
}
