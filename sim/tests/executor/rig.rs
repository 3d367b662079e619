//! A board that executes jobs, and a client.

use ::jobs::inside::Inside;
use ::jobs::instruction::Instruction;
use ::jobs::plan::{AxisSetup, Output, Planner, Setup as Planned};
use ::jobs::{Outside, gcode, job};
use firmware::cores::Board as _;
use firmware::machine::{IDLE, Machine, VISIT_WORDS, Verb, Verdict};
use firmware::net::Us;
use firmware::services::console::{Console, Reader, Visit};
use firmware::services::port::Place;
use firmware::services::{Network, Program};
use firmware::session::Peer;
use firmware::text::Text;
use motion::segment::{AXES, Segment};
use sim::board_facts::BoardFacts;
use sim::jobs::converse;
use sim::model_board::{ModelBoard, Setup};
use sim::nor::spi::Shared;
use sim::nor::{Nor, Part};
use sim::plant::{Plant, Switch};
use wire::crc::crc32;
use wire::describe::Channels;
use wire::flash::Layout;
use wire::jobs::{
    self, Axis, End, Entry, FRAME, Frame, Home, Report, Request, State, Status, UNATTENDED, Welcome,
};
use wire::regmap::{self, segments};
use wire::settings::Settings;
use wire::{MAX_WORDS, Name, etherbone};

/// Slower than any board: the models go clock by clock while axes move.
pub const CLOCK: u64 = 4_000_000;
pub const MS: u64 = CLOCK / 1000;
/// Clocks of a turn of the firmware's loop.
const TURN: u64 = 400;
/// What stops everything, high.
pub const ESTOP_INPUT: u32 = 1 << 3;

pub struct Outer<'a> {
    pub machine: &'a mut Machine<ModelBoard>,
    pub sent: &'a mut Vec<Vec<u8>>,
}

impl Outside for Outer<'_> {
    fn datagram(&mut self, request: &[u32], reply: &mut [u32; MAX_WORDS]) -> usize {
        let answer = self.machine.inside(request, reply, Machine::hold_path);
        answer.map_or(0, <[u32]>::len)
    }
    fn read_segments(&mut self, word: usize) -> u32 {
        let address = regmap::address(segments::BASE, word);
        self.machine.board.csr_read(address)
    }
    fn write_segments(&mut self, word: usize, value: u32) {
        let address = regmap::address(segments::BASE, word);
        self.machine.board.csr_write(address, value);
    }
    fn now(&mut self) -> u64 {
        self.machine.board.now()
    }
}

impl Network for Outer<'_> {
    fn send_frame(&mut self, frame: &[u8]) {
        self.sent.push(frame.to_vec());
    }
    fn us(&mut self) -> Us {
        self.machine.us
    }
    fn leased(&mut self, lease: Option<firmware::machine::Lease>) {
        self.machine.leased(lease);
    }
    fn console(&mut self, visitor: usize, verb: Verb, words: &mut [u32; VISIT_WORDS]) -> Verdict {
        self.machine.visit(visitor, verb, words)
    }
}

pub struct Rig {
    pub machine: Machine<ModelBoard>,
    pub jobs: Program<'static>,
    pub sent: Vec<Vec<u8>>,
    text: Text,
    pub client: u32,
    pub id: u16,
    /// The program hangs: it is not called any more.
    pub hangs: bool,
    pub unattended: bool,
    pub turn: u64,
    keyed: bool,
    reader: Reader,
}

/// Switches at -500 steps of X and Y and at 800 of Z, which is normally closed; nothing else is
/// wired.
pub fn switched() -> Plant {
    let mut plant = Plant::direct(0);
    for (stepgen, at, above, inverted) in [
        (0, -500, false, false),
        (1, -500, false, false),
        (2, 800, true, true),
    ] {
        plant.add_switch(Switch {
            stepgen,
            at,
            above,
            input: stepgen,
            inverted,
        });
    }
    plant
}

/// A plotter without switches: 80 steps/mm, 200 mm/s, 4000 mm/s^2.
pub fn plotter() -> jobs::MachineConfig {
    let axis = Axis {
        steps_per_km: 80_000_000,
        max_speed: 200_000_000,
        max_accel: 4_000_000_000,
        lowest: -100_000_000,
        highest: 300_000_000,
        steplen: 2000,
        stepspace: 2000,
        dirsetup: 1000,
        dirhold: 1000,
        step_invert: false,
        dir_invert: false,
        home: None,
    };
    jobs::MachineConfig {
        chord_tolerance: 10_000,
        junction_deviation: 20_000,
        tool_delay: 1000,
        outputs: 1,
        beam: 0,
        invert: 0,
        safe: 0,
        axes: [axis; AXES],
    }
}

/// The same with switches as [`switched`] has them.
pub fn with_switches() -> jobs::MachineConfig {
    let mut machine = plotter();
    for (input, axis) in (0..).zip(&mut machine.axes) {
        axis.home = Some(Home {
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
        });
    }
    machine
}

pub fn program(text: &str) -> Vec<(Instruction, u32)> {
    let mut reader = gcode::Reader::new(gcode::Options {
        dwell: gcode::DwellUnit::Seconds,
    });
    let mut all = Vec::new();
    for byte in text.bytes() {
        let read = reader.byte(byte).expect("a program");
        all.extend(read.map(|instruction| (instruction, reader.line_number())));
    }
    let read = reader.finish().expect("a program");
    all.extend(read.map(|instruction| (instruction, reader.line_number())));
    all
}

/// As a job file.
pub fn file(program: &[(Instruction, u32)]) -> Vec<u8> {
    let mut writer = job::Writer::new("test");
    let mut bytes = writer.header().to_vec();
    for (instruction, line) in program {
        writer.add(instruction, *line, |block| bytes.extend(block));
    }
    writer.finish(|block| bytes.extend(block));
    bytes
}

/// The request to start this job without a client that watches.
pub fn unattended(name: Name) -> Request<'static> {
    Request::Command {
        code: 2,
        flags: UNATTENDED,
        keepalive: 0,
        name,
    }
}

/// The machine as the planner knows it.
pub fn planned(machine: &jobs::MachineConfig) -> Planned {
    Planned {
        clock_hz: CLOCK as u32,
        axes: machine.axes.map(|axis| AxisSetup {
            steps_per_km: axis.steps_per_km,
            max_speed: axis.max_speed,
            max_accel: axis.max_accel,
        }),
        chord_tolerance: machine.chord_tolerance,
        junction_deviation: machine.junction_deviation,
        aux_settle: machine.tool_delay,
    }
}

/// What the planner says it is, from home: its segments, and the steps of each axis at its end.
pub fn predict(
    program: &[(Instruction, u32)],
    machine: &jobs::MachineConfig,
) -> (Vec<Segment>, [i64; 3]) {
    let setup = planned(machine);
    let mut planner = Planner::<32>::new(&setup).unwrap();
    let mut rest = program.iter().map(|(instruction, _)| *instruction);
    let mut segments = Vec::new();
    loop {
        while planner.accepts() {
            assert!(planner.push(&rest.next().unwrap_or(Instruction::End), 0));
        }
        match planner.poll() {
            Some(Output::Segment(segment)) => segments.push(segment),
            Some(Output::End) => return (segments, planner.machine().steps()),
            Some(Output::Pause | Output::Home(_)) | None => {}
        }
    }
}

impl Rig {
    pub fn new(plant: Plant) -> Self {
        Rig::with_room(plant, 1 << 20)
    }

    pub fn with_room(plant: Plant, room: usize) -> Self {
        Rig::built(plant, room, false, 4)
    }

    /// With so many step generators, of which a job has the first three.
    pub fn with_stepgens(stepgens: u8) -> Self {
        Rig::built(Plant::direct(0), 1 << 20, false, stepgens)
    }

    /// A board with the example's key.
    pub fn keyed(plant: Plant) -> Self {
        Rig::built(plant, 1 << 20, true, 4)
    }

    /// This connection shows that it has the example's key.
    pub fn prove(&mut self) {
        let payload = self.ok(&Request::Challenge);
        let challenge = jobs::Reader::new(&payload).words().unwrap();
        let head = wire::auth::Purpose::Acquire.head(challenge);
        let words = firmware::auth::tag(&wire::auth::EXAMPLE_KEY, &head, &[self.client]);
        self.ok(&Request::Respond { words });
    }

    /// The connection is over; another comes, and says nothing.
    pub fn hang_up(&mut self) {
        let mut outer = Outer {
            machine: &mut self.machine,
            sent: &mut self.sent,
        };
        self.jobs.visit(&mut outer);
    }

    fn built(plant: Plant, room: usize, keyed: bool, stepgens: u8) -> Self {
        let channels = Channels {
            stepgens,
            encoders: 0,
            pwms: 0,
            inputs: 4,
            outputs: 4,
        };
        let mut facts = BoardFacts::plain(channels, CLOCK as u32);
        facts.jobs = 3;
        (facts.estop_mask, facts.estop_level) = (ESTOP_INPUT, ESTOP_INPUT);
        let mut setup = Setup::new(facts, plant);
        if keyed {
            let settings = Settings {
                key: wire::auth::EXAMPLE_KEY,
                sequence: 1,
                ..Settings::default()
            };
            let mut bytes = [0; 4 * wire::settings::WORDS];
            wire::words_to_bytes(&settings.to_words(), &mut bytes);
            let mut flash = Nor::new(Part::W25Q32JV, 1);
            let layout = Layout::of(flash.part().bytes as u32).unwrap();
            flash.preload(layout.settings as usize, &bytes);
            setup.flash = Shared::new(flash);
        }
        let (mut server, ident) = ModelBoard::power_up(setup);
        let boot = server.boot();
        let mut rig = Rig::of(Machine::start(server, ident, regmap::ABI, boot), room);
        rig.keyed = keyed;
        rig.connect();
        rig
    }

    fn of(mut machine: Machine<ModelBoard>, room: usize) -> Self {
        let mut sent = Vec::new();
        let memory = vec![0xa5; room].leak();
        let mut outer = Outer {
            machine: &mut machine,
            sent: &mut sent,
        };
        let (_, board) = Inside::new(&mut outer).expect("a board that describes itself");
        let place = Box::leak(Box::new(Place::new()));
        let jobs = Program::new(memory, &mut [], place, 0x1234_5678, &mut outer);
        let jobs = jobs.expect("a board with jobs");
        Rig {
            machine,
            jobs,
            sent,
            text: Text::new(),
            client: 7,
            id: 0,
            hangs: false,
            unattended: true,
            turn: TURN,
            keyed: false,
            reader: Reader::new(board.channels, board.clock_hz),
        }
    }

    /// One that knows its machine.
    pub fn plotter() -> Self {
        let mut rig = Rig::new(Plant::direct(0));
        rig.ok(&Request::PutMachine(plotter()));
        rig
    }

    /// One with switches.
    pub fn switched() -> Self {
        let mut rig = Rig::new(switched());
        rig.ok(&Request::PutMachine(with_switches()));
        rig
    }

    /// The firmware restarts; memory, gateware and machine are what they were.
    pub fn restart(self) -> Self {
        let ident = *self.machine.server.ident();
        let mut server = self.machine.board;
        let boot = server.boot();
        let mut rig = Rig::of(Machine::start(server, ident, regmap::ABI, boot), 1 << 20);
        rig.connect();
        rig
    }

    /// The firmware of a board that a PC streams to restarts; the PC's program runs on.
    pub fn restart_streamed(mut self) -> Self {
        let ident = *self.machine.server.ident();
        let mut server = self.machine.board;
        let boot = server.boot();
        self.machine = Machine::start(server, ident, regmap::ABI, boot);
        self
    }

    pub fn now(&self) -> u64 {
        self.machine.board.clock()
    }

    /// A turn of the firmware's loop.
    pub fn turn(&mut self) {
        if !self.hangs {
            let mut outer = Outer {
                machine: &mut self.machine,
                sent: &mut self.sent,
            };
            self.jobs.poll(&mut outer);
        }
        if self.machine.due(IDLE) {
            self.machine.housekeeping();
        }
        self.machine.board.pass(self.now() + self.turn);
    }

    pub fn run(&mut self, clocks: u64) {
        let end = self.now() + clocks;
        while self.now() < end {
            self.turn();
        }
    }

    /// A new connection.
    pub fn knock(&mut self) {
        let mut outer = Outer {
            machine: &mut self.machine,
            sent: &mut self.sent,
        };
        self.jobs.visit(&mut outer);
    }

    /// A new connection of this client.
    pub fn connect(&mut self) -> Welcome {
        self.knock();
        let client = self.client;
        let (status, payload) = self.ask(&Request::Hello { client });
        assert_eq!(status, Status::Normal);
        Welcome::parse(&payload).unwrap()
    }

    /// A line at a console of a client that has just connected and, on a board with a key, has
    /// proved that it has the key; returns the answer.
    pub fn say(&mut self, line: &str, trusted: bool) -> String {
        let mut outer = Outer {
            machine: &mut self.machine,
            sent: &mut self.sent,
        };
        let mut console = Console::new();
        let mut visit = Visit {
            visitor: 0,
            reader: &mut self.reader,
            jobs: self.jobs.jobs(),
            out: &mut outer,
        };
        let (prompt, _) = converse(&mut console, &[], &mut visit);
        if trusted && self.keyed {
            let mut words = [0; VISIT_WORDS];
            visit.out.console(0, Verb::Challenge, &mut words);
            let [a, b, c, d, ..] = words;
            let head = wire::auth::Purpose::Login.head([a, b, c, d]);
            let [a, b, c, d] = firmware::auth::tag(&wire::auth::EXAMPLE_KEY, &head, &[]);
            let welcome = visit.out.console(0, Verb::Answer, &mut [a, b, c, d, 0, 0]);
            assert_eq!(welcome, Verdict::Yes);
        }
        let (said, _) = converse(&mut console, format!("{line}\n").as_bytes(), &mut visit);
        let said = said.strip_suffix(&prompt[..]).expect("a prompt");
        String::from_utf8(said.to_vec()).unwrap()
    }

    /// Bytes as they are; what is answered.
    pub fn bytes(&mut self, bytes: &[u8]) -> Vec<u8> {
        self.text.clear();
        let mut taken = 0;
        for _ in 0..100_000 {
            let mut outer = Outer {
                machine: &mut self.machine,
                sent: &mut self.sent,
            };
            taken += self.jobs.said(&bytes[taken..], &mut self.text, &mut outer);
            if taken == bytes.len() && !self.text.bytes().is_empty() {
                return self.text.bytes().to_vec();
            }
            if taken == bytes.len() && bytes.len() < jobs::OVERHEAD {
                return Vec::new();
            }
            self.turn();
        }
        panic!("no answer");
    }

    /// A request with this id.
    pub fn ask_as(&mut self, id: u16, request: &Request) -> (Status, Vec<u8>) {
        let mut out = [0; FRAME];
        let length = request.emit(id, &mut out);
        let answer = self.bytes(&out[..length]);
        let (frame, whole) = Frame::parse(&answer).unwrap().unwrap();
        assert_eq!((whole, frame.id), (answer.len(), id));
        let (op, status) = frame.answer().unwrap();
        assert_eq!(op, request.op());
        (status, frame.payload.to_vec())
    }

    pub fn ask(&mut self, request: &Request) -> (Status, Vec<u8>) {
        self.id = self.id.wrapping_add(1);
        self.ask_as(self.id, request)
    }

    pub fn status(&mut self, request: &Request) -> Status {
        self.ask(request).0
    }

    pub fn ok(&mut self, request: &Request) -> Vec<u8> {
        let (status, payload) = self.ask(request);
        assert_eq!(status, Status::Normal, "{request:?}");
        payload
    }

    pub fn report(&mut self) -> Report {
        Report::parse(&self.ok(&Request::Report)).unwrap()
    }

    pub fn command(&mut self, code: u8) -> Status {
        self.command_with(code, 0, 1000, "x")
    }

    pub fn command_with(&mut self, code: u8, flags: u8, keepalive: u16, name: &str) -> Status {
        let name = Name::new(name).unwrap();
        self.status(&Request::Command {
            code,
            flags,
            keepalive,
            name,
        })
    }

    /// Uploads a job.
    pub fn send(&mut self, name: &str, bytes: &[u8]) -> Entry {
        let total = bytes.len() as u32;
        let put = Request::Put {
            total,
            crc: crc32(bytes),
            name: Name::new(name).unwrap(),
        };
        let mut offset = jobs::word(&self.ok(&put)).unwrap();
        while offset < total {
            let rest = &bytes[offset as usize..];
            let bytes = &rest[..rest.len().min(jobs::DATA)];
            offset = jobs::word(&self.ok(&Request::Data { offset, bytes })).unwrap();
        }
        Entry::parse(&self.ok(&Request::Commit)).unwrap()
    }

    /// Uploads it and starts it.
    pub fn start(&mut self, text: &str) -> Vec<(Instruction, u32)> {
        let program = program(text);
        self.begin(&program);
        program
    }

    pub fn begin(&mut self, program: &[(Instruction, u32)]) {
        self.send("job", &file(program));
        let flags = if self.unattended { UNATTENDED } else { 0 };
        assert_eq!(self.command_with(2, flags, 1000, "job"), Status::Normal);
    }

    /// Until nothing is going on; how it ended.
    pub fn finish(&mut self) -> Report {
        for _ in 0..200_000 {
            if !self.jobs.executor().expect("jobs").busy() {
                // Positions are sampled now and then.
                self.run(30 * MS);
                return self.report();
            }
            self.run(2 * MS);
        }
        panic!("no end: {:?}", self.report());
    }

    /// Until the axes are on their way.
    pub fn underway(&mut self) {
        for _ in 0..1000 {
            self.run(MS);
            if self.report().segments > 3 {
                return;
            }
        }
        panic!("nothing moves: {:?}", self.report());
    }

    /// Pulses at the pins, each axis.
    pub fn pins(&mut self) -> [i64; AXES] {
        let counts = self.machine.board.environment().edges.counts();
        core::array::from_fn(|axis| counts[axis])
    }

    /// A job from its beginning to its end, as predicted.
    pub fn draw(&mut self, text: &str) -> Report {
        let from = self.pins();
        let program = self.start(text);
        let report = self.finish();
        assert_eq!(report.end, End::Done, "{report:?}");
        assert_eq!((report.state, report.progress), (State::Stopped, 100));
        let (_, steps) = predict(&program, &self.machine_of());
        let pins = self.pins();
        let made: [i64; AXES] = core::array::from_fn(|axis| pins[axis] - from[axis]);
        assert_eq!(made, steps);
        assert_eq!(report.steps.map(i64::from), steps);
        report
    }

    pub fn machine_of(&self) -> jobs::MachineConfig {
        *self.jobs.executor().expect("jobs").machine().unwrap()
    }

    /// A LinuxCNC somewhere takes the session; false: it cannot.
    pub fn linuxcnc(&mut self) -> bool {
        let request = [
            etherbone::HEADER,
            0,
            etherbone::record(1, 1),
            wire::map::SESSION_ACQUIRE,
            7,
            0,
            wire::map::SESSION_TOKEN,
        ];
        let mut reply = [0; MAX_WORDS];
        let alice = Peer {
            ip: 0xc0a8_0201,
            port: 5000,
        };
        let answer = self.machine.datagram(&request, alice, &mut reply);
        answer.is_ok_and(|reply| reply[4] != 0)
    }

    pub fn estop(&mut self, pressed: bool) {
        let levels = if pressed { ESTOP_INPUT } else { 0 };
        self.machine.board.environment().gpio_in(levels.into());
        self.machine.board.environment().settle();
    }
}
