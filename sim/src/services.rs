//! The services of a twin whose network is Ethernet frames: [`firmware::services::Program`], with
//! smoltcp, the consoles, the status page, names, DHCP and jobs, as the image calls it.
//!
//! A twin behind this machine's sockets has parts of it instead ([`crate::jobs`],
//! [`crate::lease`]): there TCP and ARP are this machine's.

use crate::jobs::{Outer, PROGRAM, ROOM, TURN};
use crate::model_board::ModelBoard;
use firmware::machine::{Guest, Lease, Machine, VISIT_WORDS, Verb, Verdict};
use firmware::net::Us;
use firmware::services::port::Place;
use firmware::services::{Network, Program, journal};
use firmware::session::Peer;
use jobs::Outside;
use wire::MAX_WORDS;

/// The image calls services that have nothing to do so often.
const IDLE_MS: u64 = 10;

/// The board as the services see it, and the frames they send.
pub struct Cable<'a> {
    board: Outer<'a>,
    /// What was sent.
    pub sent: Vec<Vec<u8>>,
}

impl<'a> Cable<'a> {
    /// A cable on which nothing was sent.
    pub fn of(machine: Guest<'a, ModelBoard>) -> Self {
        Cable {
            board: Outer(machine),
            sent: Vec::new(),
        }
    }
}

/// Does a host move the machine?
pub fn moving(machine: &Machine<ModelBoard>) -> bool {
    let owner = machine.session().owner();
    owner.is_some_and(|owner| owner != Peer::INSIDE) && !machine.at_rest()
}

impl Outside for Cable<'_> {
    fn datagram(&mut self, request: &[u32], reply: &mut [u32; MAX_WORDS]) -> usize {
        self.board.datagram(request, reply)
    }
    fn read_segments(&mut self, word: usize) -> u32 {
        self.board.read_segments(word)
    }
    fn write_segments(&mut self, word: usize, value: u32) {
        self.board.write_segments(word, value);
    }
    fn now(&mut self) -> u64 {
        self.board.now()
    }
}

impl Network for Cable<'_> {
    fn send_frame(&mut self, frame: &[u8]) {
        self.sent.push(frame.to_vec());
    }
    fn us(&mut self) -> Us {
        self.board.us()
    }
    fn moving(&mut self) -> bool {
        moving(&self.board.0)
    }
    fn leased(&mut self, lease: Option<Lease>) {
        self.board.leased(lease);
    }
    fn console(&mut self, visitor: usize, verb: Verb, words: &mut [u32; VISIT_WORDS]) -> Verdict {
        self.board.console(visitor, verb, words)
    }
}

/// The program.
#[derive(Debug)]
pub struct Services {
    program: Program<'static>,
    per_ms: u64,
}

impl Services {
    /// On this board; `None` if it does not answer.
    pub fn start(machine: Guest<'_, ModelBoard>, clock_hz: u32) -> Option<Self> {
        // Never freed: there are few boards, and each lives as long as its simulator.
        let [memory, log] = [ROOM, journal::BYTES].map(|bytes| vec![0; bytes].leak());
        let place = Box::leak(Box::new(Place::new()));
        let mut cable = Cable::of(machine);
        Some(Services {
            program: Program::new(memory, log, place, PROGRAM, &mut cable)?,
            per_ms: u64::from(clock_hz / 1000),
        })
    }

    /// Takes a frame; returns what was sent.
    pub fn frame(&mut self, frame: &[u8], machine: Guest<'_, ModelBoard>) -> Vec<Vec<u8>> {
        let mut cable = Cable::of(machine);
        self.program.frame(frame, &mut cable);
        cable.sent
    }

    /// A turn: what was sent, and the clocks until the next turn.
    pub fn turn(&mut self, machine: Guest<'_, ModelBoard>) -> (Vec<Vec<u8>>, u64) {
        let mut cable = Cable::of(machine);
        let works = self.program.poll(&mut cable);
        let next = if works { TURN } else { IDLE_MS * self.per_ms };
        (cable.sent, next)
    }
}
