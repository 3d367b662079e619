//! The board of these tests: the services over a real server, on a fake board.

use crate::cores::{Board as _, Control};
use crate::fake;
use crate::machine::{Lease, VISIT_WORDS, Verb, Verdict};
use crate::net::Us;
use crate::services::console::{Console, Reader, Visit};
use crate::services::port::Place;
use crate::services::{Network, Program};
use crate::session::Peer;
use crate::text::Text;
use ::jobs::Outside;
use ::jobs::inside::Inside;
use std::boxed::Box;
use std::string::String;
use std::vec::Vec;
use std::{format, vec};
use wire::MAX_WORDS;
use wire::regmap::segments;
use wire::settings::Settings;

pub const US: Us = Us {
    mac: [2, 0, 0, 0, 0, 1],
    ip: 0xc0a8_0232,
    port: 1234,
};
/// Clocks of a millisecond.
pub const MS: u64 = fake::CLOCK as u64 / 1000;
/// What a client of the console hears first, and behind every answer.
pub use crate::services::line_editor::PROMPT;
/// Axes of a job.
const AXES: u32 = 3;
/// Bytes for jobs.
const ROOM: usize = 64 * 1024;
/// The ROM calls so often when there is nothing to do.
pub const TICK_MS: u64 = 10;
/// No frame and no moment gives the program more turns of work than this.
const TURNS: usize = 200;

/// What the services see of the board.
pub struct ModelRom {
    server: fake::Rig,
    pub us: Us,
    pub sent: Vec<Vec<u8>>,
    /// Frames to groups: reports of them, and names.
    pub announced: Vec<Vec<u8>>,
    /// How often clients of consoles have typed `login`.
    pub logins: usize,
    /// A host moves the machine.
    pub moving: bool,
}

impl ModelRom {
    /// So many milliseconds after power-up.
    fn new(ms: u64) -> Self {
        ModelRom::of(fake::Rig::with_segments(), ms)
    }

    fn of(mut server: fake::Rig, ms: u64) -> Self {
        server.board.now = ms * MS;
        ModelRom {
            server,
            us: US,
            sent: Vec::new(),
            announced: Vec::new(),
            logins: 0,
            moving: false,
        }
    }

    /// The e-stop input opens, or it closes and what it latched is cleared.
    pub fn estop(&mut self, open: bool) {
        self.server.board.estop = open;
        if !open {
            self.server.board.control(Control::Clear);
        }
    }
}

impl Outside for ModelRom {
    fn datagram(&mut self, request: &[u32], reply: &mut [u32; MAX_WORDS]) -> usize {
        let Ok(answer) = self.server.send_as(Peer::INSIDE, request) else {
            return 0;
        };
        reply[..answer.len()].copy_from_slice(&answer);
        answer.len()
    }
    fn read_segments(&mut self, word: usize) -> u32 {
        match word {
            segments::SHAPE => AXES | 16 << 8,
            _ => 0,
        }
    }
    fn write_segments(&mut self, _: usize, _: u32) {}
    fn now(&mut self) -> u64 {
        self.server.board.now
    }
}

/// What the console says to a line; this board says the same whenever it is asked.
pub fn echo(line: &str) -> String {
    let mut rom = ModelRom::new(1);
    let (_, board) = Inside::new(&mut rom).expect("it describes itself");
    let mut console = Console::new();
    let mut reader = Reader::new(board.channels, board.clock_hz);
    let mut text = Text::new();
    let line = format!("{line}\n");
    let mut visit = Visit {
        visitor: 0,
        reader: &mut reader,
        jobs: None,
        out: &mut rom,
    };
    console.turn(&[], &mut visit, &mut text);
    text.clear();
    assert_eq!(
        console.turn(line.as_bytes(), &mut visit, &mut text),
        line.len()
    );
    while console.busy() {
        console.turn(&[], &mut visit, &mut text);
    }
    String::from_utf8(text.bytes().to_vec()).expect("ASCII")
}

impl Network for ModelRom {
    fn send_frame(&mut self, frame: &[u8]) {
        assert!(frame.len() <= super::super::abi::FRAME_MAX);
        match frame.first_chunk() {
            Some([1, 0, 0x5e]) => self.announced.push(frame.to_vec()),
            _ => self.sent.push(frame.to_vec()),
        }
    }
    fn us(&mut self) -> Us {
        self.us
    }
    fn leased(&mut self, _: Option<Lease>) {}
    fn moving(&mut self) -> bool {
        self.moving
    }
    fn console(&mut self, _: usize, verb: Verb, _: &mut [u32; VISIT_WORDS]) -> Verdict {
        self.logins += usize::from(verb == Verb::Challenge);
        Verdict::Yes
    }
}

pub struct Board {
    pub rom: ModelRom,
    pub program: Program<'static>,
    restless: bool,
}

impl Board {
    pub fn new() -> Self {
        Board::started(1)
    }

    /// A board whose services start so many milliseconds after power-up.
    pub fn started(ms: u64) -> Self {
        Board::on(ModelRom::new(ms))
    }

    /// A board with these settings in its flash.
    pub fn with_settings(settings: &Settings) -> Self {
        Board::on(ModelRom::of(fake::Rig::with_settings(settings), 1))
    }

    fn on(mut rom: ModelRom) -> Self {
        let place = Box::leak(Box::new(Place::new()));
        let memory = vec![0xa5; ROOM].leak();
        let log = vec![0xa5; crate::services::journal::BYTES].leak();
        let program = Program::new(memory, log, place, 0x1234_5678, &mut rom);
        Board {
            program: program.expect("a board with jobs"),
            rom,
            restless: false,
        }
    }

    pub fn ms(&self) -> u64 {
        self.rom.server.board.now / MS
    }

    /// A frame comes in; nothing else happens.
    pub fn take(&mut self, frame: &[u8]) {
        self.program.frame(frame, &mut self.rom);
        self.restless = true;
    }

    /// One call without a frame.
    pub fn turn(&mut self) {
        self.restless = self.program.poll(&mut self.rom);
    }

    /// Turns as long as there is work.
    pub fn work(&mut self) {
        self.turn();
        for _ in 0..TURNS {
            if !self.restless {
                return;
            }
            self.turn();
        }
        panic!("the program is never done, {} ms", self.ms());
    }

    /// A frame, and the board's answers.
    pub fn frame(&mut self, frame: &[u8]) -> Vec<Vec<u8>> {
        self.take(frame);
        self.work();
        self.sent()
    }

    pub fn sent(&mut self) -> Vec<Vec<u8>> {
        std::mem::take(&mut self.rom.sent)
    }

    /// Time passes, and nothing is called.
    pub fn hold(&mut self, clocks: u64) {
        self.rom.server.board.now += clocks;
    }

    /// Time passes, with a turn every 10 ms; the frames that were sent, and when.
    pub fn wait(&mut self, ms: u64) -> Vec<(u64, Vec<u8>)> {
        self.wait_by(ms, TICK_MS)
    }

    /// The same with a turn so often.
    pub fn wait_by(&mut self, ms: u64, tick: u64) -> Vec<(u64, Vec<u8>)> {
        let (end, mut sent) = (self.ms() + ms, Vec::new());
        while self.ms() < end {
            self.hold(tick.min(end - self.ms()) * MS);
            self.work();
            let at = self.ms();
            sent.extend(self.sent().into_iter().map(|frame| (at, frame)));
        }
        sent
    }
}
