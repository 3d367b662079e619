//! The jobs port, from bytes to pins: requests of clients, in any order and in pieces of any size,
//! go to the server with the store and the executor, on the firmware's library and the models of
//! the cores.
//!
//! The input is a script of steps: one byte for the kind, then the bytes the step needs. What must
//! hold:
//!
//! * every answer is a frame, answers the request that was asked, and has the right payload;
//! * no request but a Hello is executed on a connection that has not begun with one;
//! * a refused request has changed nothing (a Commit of a garbled upload starts it again, and says
//!   so);
//! * a repeated request has the same answer, to the byte, and is not executed again, unless it
//!   only looks or halts, or was refused, beside the last request of another client;
//! * the console's answers fit their buffer and do not disturb a terminal;
//! * the machine is armed only while the executor is busy, and no pulse leaves while it is not.

use crate::byte_reader::ByteReader;
use ::jobs::Outside;
use ::jobs::inside::Inside;
use ::jobs::instruction::{Arc, Feed, Instruction};
use ::jobs::job::Writer;
use firmware::machine::{Guest, IDLE, Lease, Machine, VISIT_WORDS, Verb, Verdict};
use firmware::net::Us;
use firmware::services::console::{Console, Reader, Visit};
use firmware::services::line_editor::{End, LineEditor, PROMPT};
use firmware::services::port::Place;
use firmware::services::{Network, Program};
use firmware::text::Text;
use motion::segment::AXES;
use sim::board_facts::BoardFacts;
use sim::jobs::{Outer, converse};
use sim::model_board::{ModelBoard, Setup, UID};
use sim::nor::spi::Shared;
use sim::nor::{Nor, Part, Times};
use sim::plant::{Plant, Switch};
use std::cell::RefCell;
use std::sync::atomic::Ordering::Relaxed;
use wire::crc::crc32;
use wire::describe::Channels;
use wire::jobs::{
    self, Axis, DATA, Entry, FRAME, Frame, Home, Op, Report, Request, Status, Welcome,
};
use wire::{MAX_WORDS, Name, State};

/// Longer scripts add nothing.
const STEPS: usize = 120;
/// Slower than any board, because the models go clock by clock while axes move.
const CLOCK: u32 = 4_000_000;
/// Half a simulated second: simulated time is expensive here.
const CLOCKS: u64 = 2_000_000;
/// Clocks of a turn of the firmware's loop.
const TURN: u64 = 400;
/// Memory for jobs: little, so that it is full soon.
const ROOM: usize = 40 * 1024;
/// The input that stops all axes, active high.
const ESTOP_INPUT: u32 = 1 << 3;

thread_local! {
    static FLASH: RefCell<Option<Shared>> = const { RefCell::new(None) };
}

/// The state that a client can read, and that a refusal must not change.
#[derive(Debug, PartialEq)]
struct Shot {
    list: String,
    status: String,
    machine: Option<jobs::MachineConfig>,
}

struct Bench<'m> {
    machine: Machine<ModelBoard>,
    jobs: Program<'m>,
    reader: Reader,
    /// Bytes sent and not read yet; requests read and not answered yet.
    ahead: Vec<u8>,
    reading: Vec<u8>,
    /// This connection has begun with a Hello.
    known: bool,
    id: u16,
    /// This connection's client, and the one whose request the board keeps.
    client: u32,
    kept: Option<u32>,
    /// The last request and its answer, if a repetition must get the same.
    last: Option<(Vec<u8>, Vec<u8>)>,
    story: Vec<String>,
}

/// The board with a client at its console that is trusted, or is not.
struct ConsoleNetwork<'a>(Outer<'a>, bool);

impl Outside for ConsoleNetwork<'_> {
    fn datagram(&mut self, request: &[u32], reply: &mut [u32; MAX_WORDS]) -> usize {
        self.0.datagram(request, reply)
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

impl Network for ConsoleNetwork<'_> {
    fn send_frame(&mut self, frame: &[u8]) {
        self.0.send_frame(frame);
    }
    fn us(&mut self) -> Us {
        self.0.us()
    }
    fn leased(&mut self, lease: Option<Lease>) {
        self.0.leased(lease);
    }
    fn console(&mut self, visitor: usize, verb: Verb, words: &mut [u32; VISIT_WORDS]) -> Verdict {
        match self.0.console(visitor, verb, words) {
            Verdict::Yes if verb == Verb::Change && !self.1 => Verdict::Key,
            verdict => verdict,
        }
    }
}

/// Runs a script.
pub fn jobs(data: &[u8]) {
    script(data);
}

/// Runs a script; returns the final state as the console prints it.
pub fn script(data: &[u8]) -> String {
    let mut memory = vec![0xa5; ROOM];
    let mut machine = board();
    let mut place = Place::new();
    let program = Program::new(
        &mut memory,
        &mut [],
        &mut place,
        7,
        &mut Outer(Guest::of(&mut machine)),
    );
    let (_, board) = Inside::new(&mut Outer(Guest::of(&mut machine))).expect("a board at rest");
    let mut bench = Bench {
        reader: Reader::new(board.channels, board.clock_hz),
        jobs: program.expect("a board with jobs"),
        machine,
        ahead: Vec::new(),
        reading: Vec::new(),
        known: false,
        id: 0,
        client: 0,
        kept: None,
        last: None,
        story: Vec::new(),
    };
    bench.visit();
    let mut input = ByteReader(data);
    let end = bench.machine.board.clock() + CLOCKS;
    for _ in 0..STEPS {
        if input.is_over() || bench.machine.board.clock() > end {
            break;
        }
        bench.step(&mut input);
    }
    bench.line("job status", true)
}

/// With switches at -500 steps of X and Y, and at 800 of Z.
fn board() -> Machine<ModelBoard> {
    let flash = FLASH.take().unwrap_or_else(|| {
        let part = Part::W25Q16JV.with(Times::QUICK);
        Shared::new(Nor::new(part, UID))
    });
    FLASH.set(Some(flash.clone()));
    let channels = Channels {
        stepgens: 3,
        encoders: 0,
        pwms: 0,
        inputs: 4,
        outputs: 4,
    };
    let mut facts = BoardFacts::plain(channels, CLOCK);
    facts.jobs = AXES as u8;
    (facts.estop_mask, facts.estop_level) = (ESTOP_INPUT, ESTOP_INPUT);
    let mut plant = Plant::direct(0);
    for (stepgen, at, above) in [(0, -500, false), (1, -500, false), (2, 800, true)] {
        plant.add_switch(Switch {
            stepgen,
            at,
            above,
            input: stepgen,
            inverted: above,
        });
    }
    let mut setup = Setup::new(facts, plant);
    setup.flash = flash;
    let (mut model_board, ident) = ModelBoard::power_up(setup);
    let boot = model_board.boot();
    Machine::start(model_board, ident, wire::regmap::ABI, boot)
}

/// 80 steps/mm, 200 mm/s, 4000 mm/s^2; with or without those switches.
pub(crate) fn machine(switches: bool) -> jobs::MachineConfig {
    let axis = |input: u8| Axis {
        steps_per_km: 80_000_000,
        max_speed: 200_000_000,
        max_accel: 4_000_000_000,
        lowest: -10_000_000,
        highest: 30_000_000,
        steplen: 2000,
        stepspace: 2000,
        dirsetup: 1000,
        dirhold: 1000,
        step_invert: false,
        dir_invert: false,
        home: switches.then_some(Home {
            plus: input == 2,
            low: input == 2,
            input,
            order: if input == 2 { 0 } else { 1 },
            fast: 50_000_000,
            slow: 2_000_000,
            backoff: 500_000,
            travel: 50_000_000,
            timeout: 5000,
            debounce: 10,
        }),
    };
    jobs::MachineConfig {
        chord_tolerance: 10_000,
        junction_deviation: 20_000,
        tool_delay: 1000,
        outputs: 1,
        beam: 0,
        invert: 0,
        safe: 0,
        axes: [axis(0), axis(1), axis(2)],
    }
}

/// A job file from the input.
fn file(input: &mut ByteReader) -> Vec<u8> {
    let mut writer = Writer::new("fuzz");
    let mut bytes = writer.header().to_vec();
    for line in 0..u32::from(input.byte() % 24) {
        let [kind, x, y] = input.array();
        let place = |n: u8| i64::from(n as i8) * 100_000;
        let to = [place(x), place(y), 0];
        let feed = match kind & 16 {
            0 => Feed::Rapid,
            _ => Feed::Rate(100_000_000),
        };
        let instruction = match kind & 15 {
            0..=7 => Instruction::Line { to, feed },
            8 | 9 => Instruction::Arc(Arc {
                to,
                center: [place(y), place(x)],
                clockwise: kind & 32 != 0,
                feed,
            }),
            10 => Instruction::Dwell {
                micros: u64::from(x) * 100,
            },
            11 => Instruction::Aux {
                bits: u16::from(x & 1),
            },
            12 => Instruction::Pause,
            13 => Instruction::Home {
                axes: [x & 1 != 0, x & 2 != 0, x & 4 != 0],
            },
            14 => Instruction::End,
            _ => Instruction::Line {
                to: [to[0], to[1], place(kind)],
                feed,
            },
        };
        writer.add(&instruction, line, |block| bytes.extend(block));
    }
    writer.finish(|block| bytes.extend(block));
    bytes
}

fn name(input: &mut ByteReader) -> Name {
    match input.byte() {
        n @ 0..=63 => {
            Name::cut(["a", "b", "c", "a longer name, of 31 characters"][usize::from(n % 4)])
        }
        _ => Name::cut(&String::from_utf8_lossy(input.some())),
    }
}

/// Only looks or halts.
fn harmless(request: Request) -> bool {
    match request {
        Request::Report | Request::List { .. } | Request::GetMachine => true,
        Request::Command { code, .. } => {
            let command = jobs::JobCommand::from_code(code);
            matches!(
                command,
                Some(jobs::JobCommand::Stop | jobs::JobCommand::Pause)
            )
        }
        Request::Segment { command, .. } => {
            ::jobs::fpgag::FpgagCommand::from_code(command)
                == Some(::jobs::fpgag::FpgagCommand::Stop)
        }
        _ => false,
    }
}

impl Bench<'_> {
    fn step(&mut self, input: &mut ByteReader) {
        let idle = (!self.jobs.executor().expect("jobs").busy()).then(|| self.pulses());
        let asked = self.act(input);
        self.holds();
        if let Some(pulses) = idle.filter(|_| !asked && !self.jobs.executor().expect("jobs").busy())
        {
            assert_eq!(
                self.pulses(),
                pulses,
                "pulses without work\n{:#?}",
                self.story
            );
        }
    }

    /// Executes the step; true if the board received a request.
    fn act(&mut self, input: &mut ByteReader) -> bool {
        match input.byte() & 15 {
            0 => self.ask(&Request::Hello {
                client: u32::from(input.byte()) + 1,
            }),
            1 => {
                let bytes = file(input);
                self.upload(&bytes, input);
            }
            2 => {
                let wanted = machine(input.byte() & 1 != 0);
                self.ask(&Request::PutMachine(wanted));
            }
            3 => self.command(input),
            4 => {
                self.pass(1 << (input.byte() % 11));
                return false;
            }
            // Any op, any payload, the CRC right.
            5 => {
                let (op, payload) = (input.byte(), input.many());
                self.frame(op, |writer| {
                    writer.bytes(payload);
                });
            }
            6 => self.say(input.many()),
            7 => self.damaged_machine(input),
            8 => {
                let inputs = u32::from(input.byte() & 15);
                let environment = self.machine.board.environment();
                environment.gpio_in(inputs.into());
                environment.settle();
                self.pass(4);
                return false;
            }
            9 => self.visit(),
            10 => self.console(input),
            11 => self.again(),
            12 => {
                let (command, form, words) = (input.byte() % 8, input.byte() % 3, input.some());
                self.ask(&Request::Segment {
                    command,
                    form,
                    words: jobs::Words::new(words.as_chunks().0),
                });
            }
            13 => self.ask(&Request::Feed {
                percent: input.byte().into(),
            }),
            14 => self.question(input),
            _ => self.in_two_pieces(input),
        }
        true
    }

    fn command(&mut self, input: &mut ByteReader) {
        let [code, flags, keepalive] = input.array();
        let name = name(input);
        self.ask(&Request::Command {
            code: if code < 128 { code % 14 } else { code },
            flags,
            keepalive: u16::from(keepalive) * 20,
            name,
        });
    }

    /// A machine with an inverted byte, the CRC right.
    fn damaged_machine(&mut self, input: &mut ByteReader) {
        let (at, bits) = (input.byte(), input.byte());
        let request = Request::PutMachine(machine(bits & 1 != 0));
        let mut out = [0; FRAME];
        let length = request.emit(0, &mut out);
        let mut payload = out[8..length - 4].to_vec();
        let at = usize::from(at) % payload.len();
        payload[at] ^= bits;
        self.frame(Op::PutMachine.code(), |writer| {
            writer.bytes(&payload);
        });
    }

    fn question(&mut self, input: &mut ByteReader) {
        let which = input.byte();
        let request = match which % 5 {
            0 => Request::Report,
            1 => Request::List { index: which / 5 },
            2 => Request::GetMachine,
            3 => Request::Commit,
            _ => Request::Delete { name: name(input) },
        };
        self.ask(&request);
    }

    /// A request, with a pause in the middle of it.
    fn in_two_pieces(&mut self, input: &mut ByteReader) {
        let mut out = [0; FRAME];
        let length = Request::Report.emit(self.id, &mut out);
        let (head, rest) = out[..length].split_at(usize::from(input.byte()) % length);
        self.say(head);
        self.pass(2);
        self.say(rest);
    }

    fn tell(&mut self, what: impl FnOnce() -> String) {
        if crate::EXPLAIN.load(Relaxed) {
            self.story.push(what());
        }
    }

    fn pulses(&mut self) -> u64 {
        self.machine.board.environment().edges.pulses()
    }

    fn holds(&self) {
        let armed = self.machine.server.safety().state() == State::Armed;
        let busy = self.jobs.executor().expect("jobs").busy();
        assert!(!armed || busy, "armed without work\n{:#?}", self.story);
    }

    fn visit(&mut self) {
        self.jobs.visit(&mut Outer(Guest::of(&mut self.machine)));
        self.ahead.clear();
        self.reading.clear();
        (self.known, self.last) = (false, None);
        self.tell(|| "a new connection".to_owned());
    }

    /// This many turns of the loop.
    fn pass(&mut self, turns: u32) {
        for _ in 0..turns {
            self.serve();
            self.jobs.poll(&mut Outer(Guest::of(&mut self.machine)));
            if self.machine.due(IDLE) {
                self.machine.housekeeping();
            }
            let until = self.machine.board.clock() + TURN;
            self.machine.board.pass(until);
            self.holds();
        }
        self.tell(|| format!("{turns} turns"));
    }

    fn ask(&mut self, request: &Request) {
        self.id = self.id.wrapping_add(1);
        let mut out = [0; FRAME];
        let length = request.emit(self.id, &mut out);
        self.say(&out[..length]);
    }

    fn frame(&mut self, op: u8, fill: impl FnOnce(&mut jobs::Writer)) {
        self.id = self.id.wrapping_add(1);
        let mut out = [0; FRAME];
        // An answer's op without its bit, and a status of 0: a request.
        let length = jobs::answer(op, Status::Normal, self.id, &mut out, fill);
        out[0] = op;
        let crc = crc32(&out[..length - 4]).to_le_bytes();
        out[length - 4..length].copy_from_slice(&crc);
        self.say(&out[..length]);
    }

    fn say(&mut self, bytes: &[u8]) {
        self.ahead.extend(bytes);
        while self.serve() {}
    }

    /// The server takes some bytes; true if it took any, or if it answered.
    fn serve(&mut self) -> bool {
        if self.ahead.is_empty() && self.reading.is_empty() {
            return false;
        }
        let before = self.shot();
        let mut text = Text::new();
        let taken = {
            let outer = &mut Outer(Guest::of(&mut self.machine));
            self.jobs.said(&self.ahead, &mut text, outer)
        };
        assert!(taken <= self.ahead.len());
        self.reading.extend(self.ahead.drain(..taken));
        let answer = text.bytes().to_vec();
        if !answer.is_empty() {
            let request = std::mem::take(&mut self.reading);
            self.judge(&request, &answer, &before, text.close);
        }
        taken > 0 || !answer.is_empty()
    }

    fn judge(&mut self, request: &[u8], answer: &[u8], before: &Shot, closed: bool) {
        let (frame, length) = Frame::parse(answer)
            .ok()
            .flatten()
            .expect("an answer is a frame");
        assert_eq!(length, answer.len(), "one answer");
        let status = Status::from_code(frame.status).expect("a status");
        self.tell(|| format!("{request:02x?}: {status:?}, {:02x?}", frame.payload));
        let story = &self.story;
        let asked = match Frame::parse(request) {
            Ok(Some((asked, length))) => {
                assert_eq!(length, request.len(), "{story:#?}");
                asked
            }
            Ok(None) => panic!("half a request was answered\n{story:#?}"),
            Err(_) => {
                assert!(closed && status == Status::Garbled, "{story:#?}");
                assert_eq!(self.shot(), *before, "garbled, and done");
                return self.visit();
            }
        };
        assert!(!closed && status != Status::Garbled, "{story:#?}");
        assert_eq!(
            (frame.op, frame.id),
            (asked.op | 0x80, asked.id),
            "{story:#?}"
        );
        let op = Op::from_code(asked.op);
        if status == Status::Normal {
            let op = op.expect("an unknown op was executed");
            assert!(self.known || op == Op::Hello, "without a Hello\n{story:#?}");
            self.known = true;
            assert!(payload(op, frame.payload), "{op:?} {:?}", frame.payload);
        } else {
            let anew = op == Some(Op::Commit) && matches!(status, Status::Crc | Status::NoJob);
            let after = self.shot();
            let story = &self.story;
            assert!(
                anew || after == *before,
                "refused: {before:#?} {after:#?}\n{story:#?}"
            );
        }
        let asked = Request::parse(&asked);
        if let (Ok(Request::Hello { client }), Status::Normal) = (&asked, status) {
            self.client = *client;
        }
        let greets = matches!(op, Some(Op::Hello | Op::Challenge | Op::Respond));
        let beside = self.kept.is_some_and(|kept| kept != self.client);
        let passes = beside && (status != Status::Normal || asked.is_ok_and(harmless));
        let repeats = self.known && !greets && !passes;
        if repeats {
            self.kept = Some(self.client);
        }
        self.last = repeats.then(|| (request.to_vec(), answer.to_vec()));
    }

    /// Repeats the last request.
    fn again(&mut self) {
        let Some((request, answer)) = self.last.clone() else {
            return;
        };
        if !self.ahead.is_empty() || !self.reading.is_empty() {
            return;
        }
        let before = self.shot();
        let mut text = Text::new();
        let taken = {
            let outer = &mut Outer(Guest::of(&mut self.machine));
            self.jobs.said(&request, &mut text, outer)
        };
        assert_eq!((taken, text.bytes()), (request.len(), &answer[..]));
        assert_eq!(self.shot(), before, "executed twice\n{:#?}", self.story);
    }

    fn upload(&mut self, bytes: &[u8], input: &mut ByteReader) {
        let (name, total, wrong) = (name(input), bytes.len() as u32, input.byte());
        if name.is_empty() {
            return;
        }
        let crc = crc32(bytes) ^ u32::from(wrong == 255);
        self.ask(&Request::Put { total, crc, name });
        for (n, bytes) in bytes.chunks(DATA.min(60 + usize::from(wrong))).enumerate() {
            let offset = (n * DATA.min(60 + usize::from(wrong))) as u32;
            self.ask(&Request::Data { offset, bytes });
        }
        self.ask(&Request::Commit);
        self.pass(8);
    }

    fn console(&mut self, input: &mut ByteReader) {
        let (how, text) = (input.byte(), input.some());
        let verbs = [
            "status", "list", "start a", "pause", "continue", "stop", "home", "feed 50",
            "delete a", "help", "home xy",
        ];
        let said = String::from_utf8_lossy(text);
        let line = match verbs.get(usize::from(how >> 1)) {
            Some(verb) => format!("job {verb}"),
            None => format!("job {said}"),
        };
        // Without the key no work begins.
        let busy = self.jobs.executor().expect("jobs").busy();
        self.line(&line, how & 1 != 0);
        let begun = !busy && self.jobs.executor().expect("jobs").busy();
        assert!(how & 1 != 0 || !begun, "{line:?}\n{:#?}", self.story);
        self.tell(|| line);
    }

    fn line(&mut self, line: &str, trusted: bool) -> String {
        let mut network = ConsoleNetwork(Outer(Guest::of(&mut self.machine)), trusted);
        let mut visit = Visit {
            visitor: 0,
            reader: &mut self.reader,
            jobs: self.jobs.jobs(),
            out: &mut network,
        };
        let line = format!("{line}\n");
        let (said, _) = converse(&mut Console::new(), line.as_bytes(), &mut visit);
        let text = String::from_utf8(said).expect("text").replace(PROMPT, "");
        // A line that its own backspaces empty is a new prompt and nothing else.
        assert_eq!(text.is_empty(), says_nothing(&line), "{line:?}: {text:?}");
        assert!(
            text.is_empty() || text.ends_with("\r\n"),
            "{line:?}: {text:?}"
        );
        let upsets = |c: char| c.is_control() && c != '\r' && c != '\n';
        assert!(!text.contains(upsets), "{line:?}: {text:?}");
        text
    }

    fn shot(&mut self) -> Shot {
        Shot {
            list: self.line("job list", true),
            status: self.line("job status", true),
            machine: self.jobs.executor().expect("jobs").machine().copied(),
        }
    }
}

/// Is there no command in these lines, once their control characters have edited them?
fn says_nothing(lines: &str) -> bool {
    let (mut editor, mut echo) = (LineEditor::new(), Text::new());
    lines.bytes().all(|byte| {
        let complete = editor.push(byte, false, &mut echo) == Some(End::Line);
        !complete || editor.line().is_ok_and(|line| line.trim().is_empty())
    })
}

/// Is this the right payload for the answer to that op?
fn payload(op: Op, bytes: &[u8]) -> bool {
    match op {
        Op::Hello => Welcome::parse(bytes).is_some(),
        Op::Put | Op::Data | Op::Delete | Op::Segment => jobs::word(bytes).is_some(),
        Op::Commit | Op::List => Entry::parse(bytes).is_some(),
        Op::GetMachine => jobs::MachineConfig::parse(bytes).is_ok(),
        Op::Command | Op::Report | Op::Feed => Report::parse(bytes).is_some(),
        Op::Challenge => bytes.len() == 16,
        Op::PutMachine | Op::Respond => bytes.is_empty(),
    }
}
