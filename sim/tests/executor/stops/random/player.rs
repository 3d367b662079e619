//! A board and the program that executes its jobs, on the board or at the other end of a cable, and
//! the faults that can happen to them.

use super::super::client::{Client, HOST, post};
use super::watch::{TURN, Watch};
use crate::rig::*;
use ::jobs::Outside;
use firmware::cores::{Board as _, Control};
use firmware::machine::{VISIT_WORDS, Verb, Verdict};
use firmware::net::Us;
use firmware::services::Network;
use rand::Rng;
use rand_pcg::Pcg32;
use wire::describe::JobsState;
use wire::jobs::{self, Request, Status};
use wire::{MAX_WORDS, ResetReason, etherbone, map};

/// Clocks between two calls of a program that is starved: longer than between two of its exchanges,
/// which come first.
const RARELY: u64 = 6 * MS;

/// What goes wrong.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Trouble {
    /// The program.
    Hangs,
    /// The processor.
    Frozen,
    Stop,
    Pause,
    /// The client that started it.
    Silence,
    EStop,
    Reset,
    /// The program comes to speak to the board and to nothing else: no more segments.
    Starved,
    /// The firmware traps, which closes the gate, and restarts.
    Trap,
    /// It begins again without a word.
    Jump,
}

/// The board, from a PC that streams segments to it.
struct Wire<'a> {
    rig: &'a mut firmware::machine::Machine<sim::model_board::ModelBoard>,
    number: &'a mut u32,
}

impl Outside for Wire<'_> {
    fn datagram(&mut self, request: &[u32], reply: &mut [u32; MAX_WORDS]) -> usize {
        post(self.rig, request, reply)
    }
    fn read_segments(&mut self, word: usize) -> u32 {
        self.rig.board.csr_read(map::SEGMENTS + 4 * word as u32)
    }
    fn write_segments(&mut self, word: usize, value: u32) {
        if self.rig.server.session().owner() != Some(HOST) {
            return;
        }
        let next = self.rig.server.session().segments().wrapping_add(1);
        *self.number = next;
        let (header, record) = (etherbone::HEADER, etherbone::record(1, 0));
        let at = map::SEGMENTS + 4 * word as u32;
        let request = [
            header,
            0,
            record,
            map::SESSION_SEGMENTS,
            next,
            record,
            at,
            value,
        ];
        post(self.rig, &request, &mut [0; MAX_WORDS]);
    }
    fn now(&mut self) -> u64 {
        self.rig.board.now()
    }
}

impl Network for Wire<'_> {
    fn send_frame(&mut self, _: &[u8]) {}
    fn us(&mut self) -> Us {
        self.rig.us
    }
    fn leased(&mut self, _: Option<firmware::machine::Lease>) {}
    fn console(&mut self, _: usize, _: Verb, _: &mut [u32; VISIT_WORDS]) -> Verdict {
        Verdict::NotNow
    }
}

/// A board and what executes its jobs.
pub struct Player {
    pub rig: Rig,
    streams: bool,
    number: u32,
    /// The CPU runs.
    runs: bool,
    /// The program is called, and when next.
    called: bool,
    rarely: bool,
    next: u64,
}

impl Player {
    /// Of this board; `streams`: its program is a PC's.
    pub fn new(mut rig: Rig, streams: bool) -> Self {
        if streams {
            rig.machine.server.jobs(JobsState::Streamed);
        }
        Player {
            rig,
            streams,
            number: 0,
            runs: true,
            called: true,
            rarely: false,
            next: 0,
        }
    }

    /// A turn of the firmware's loop.
    pub fn turn(&mut self) {
        let next = self.rig.now() + TURN;
        if self.called && self.runs && self.rig.now() >= self.next {
            self.poll();
            if self.rarely {
                self.next = self.rig.now() + RARELY;
            }
        }
        if self.runs && self.rig.machine.due(firmware::machine::IDLE) {
            self.rig.machine.housekeeping();
        }
        self.rig.machine.board.pass(next);
    }

    fn poll(&mut self) {
        if self.streams {
            let mut wire = Wire {
                rig: &mut self.rig.machine,
                number: &mut self.number,
            };
            self.rig.jobs.poll(&mut wire);
        } else {
            let mut outer = Outer {
                machine: &mut self.rig.machine,
                sent: &mut self.rig.sent,
            };
            self.rig.jobs.poll(&mut outer);
        }
    }

    /// A request of one frame.
    pub fn ask(&mut self, request: &Request) -> (Status, Vec<u8>) {
        if !self.streams {
            return self.rig.ask(request);
        }
        let mut out = [0; jobs::FRAME];
        let length = request.emit(self.rig.id, &mut out);
        self.rig.id = self.rig.id.wrapping_add(1);
        let mut text = firmware::text::Text::new();
        let mut taken = 0;
        for _ in 0..100_000 {
            let mut wire = Wire {
                rig: &mut self.rig.machine,
                number: &mut self.number,
            };
            let jobs = &mut self.rig.jobs;
            taken += jobs.said(&out[taken..length], &mut text, &mut wire);
            if taken == length && !text.bytes().is_empty() {
                let (frame, _) = jobs::Frame::parse(text.bytes()).unwrap().unwrap();
                return (frame.answer().unwrap().1, frame.payload.to_vec());
            }
            self.turn();
        }
        panic!("no answer");
    }

    /// One of the commands without a name.
    pub fn command(&mut self, code: u8) -> Status {
        let name = wire::Name::EMPTY;
        let command = Request::Command {
            code,
            flags: 0,
            keepalive: 0,
            name,
        };
        self.ask(&command).0
    }

    pub fn report(&mut self) -> jobs::Report {
        let (_, payload) = self.ask(&Request::Report);
        jobs::Report::parse(&payload).unwrap()
    }

    /// It happens. What it moves on for from here on is told to the watch.
    pub fn suffers(mut self, trouble: Trouble, watch: &mut Watch, told: &str) -> Self {
        match trouble {
            Trouble::Silence => {}
            Trouble::Hangs => self.called = false,
            Trouble::Frozen => self.runs = false,
            Trouble::Starved => self.rarely = true,
            Trouble::Stop => assert_eq!(self.command(0), Status::Normal, "{told}"),
            // It may be over.
            Trouble::Pause => {
                let _over = self.command(10);
            }
            Trouble::EStop => self.rig.estop(true),
            Trouble::Reset => self.rig.machine.board.environment().ext_reset(true),
            Trouble::Trap | Trouble::Jump => return self.restarts(trouble, watch),
        }
        self
    }

    fn restarts(mut self, trouble: Trouble, watch: &mut Watch) -> Self {
        // The first thing that a start does, and a trap before it.
        self.rig.machine.board.control(Control::Close);
        watch.look(&mut self.rig);
        if trouble == Trouble::Trap {
            self.rig.machine.board.part(ResetReason::Trap);
        }
        if self.streams {
            self.rig = self.rig.restart_streamed();
            self.rig.machine.server.jobs(JobsState::Streamed);
        } else {
            self.rig = self.rig.restart();
        }
        self
    }

    /// Everything works again.
    pub fn recovers(&mut self) {
        (self.runs, self.called, self.rarely, self.next) = (true, true, false, 0);
        self.rig.estop(false);
        self.rig.machine.board.environment().ext_reset(false);
    }

    /// Until nothing is going on, and positions were sampled.
    pub fn settles(&mut self) {
        for _ in 0..50_000 {
            if !self.rig.jobs.executor().expect("jobs").busy() {
                break;
            }
            self.turn();
        }
        for _ in 0..300 {
            self.turn();
        }
    }
}

/// The settings that the last owner of a board leaves in it.
pub fn left_behind(rig: &mut Rig, random: &mut Pcg32) {
    let client = Client::of(rig);
    let [timeout, grace] = [
        random.random_range(400..CLOCK) as u32,
        random.random_range(0..CLOCK) as u32,
    ];
    client.write(rig, map::CONFIG_BOARD, &[timeout, grace]);
    for n in 0..4 {
        let base = map::CONFIG_STEPGEN + n * map::CONFIG_STRIDE;
        let (stop, mode) = (random.random(), random.random_range(0..12));
        client.write(rig, base, &[100, 200, 3, 4, stop, mode]);
    }
    client.release(rig);
}
