//! The twin: the firmware's library on the cores' models, behind the same sockets as the Verilated
//! board.
//!
//! No CPU, no MAC, no frames: a datagram goes into [`firmware::machine::Machine`] as the image
//! would put it there, and the verbs of [`firmware::cores::Board`] become register writes of
//! [`model::Board`]. The pins behave as the gateware's, clock by clock; the times of the firmware's
//! actions are round figures (see [`ANSWER`]), because no instructions are executed here.
//!
//! Time passes from event to event, so an idle board takes almost no computing time.

use std::collections::VecDeque;
use std::time::{Duration, Instant};

use firmware::console::{self, Ask, Vitals};
use firmware::cores::{self, Control, Gate, Ident, Led, Setting};
use firmware::machine::{BEHIND_A_FRAME, IDLE, Machine};
use firmware::postmortem::Record;
use firmware::session::Peer;
use firmware::{dhcp, log, text};
use wire::describe::JobsState;
use wire::flash::Layout;
use wire::images::{Meta, Role, Trailer};
use wire::map::{StepType, StepgenConfig};
use wire::regmap::{self, command, encoder, led, stepgen, timebase, watchdog};
use wire::{MAX_WORDS, ResetReason};

use crate::board::{Clockwork, ETH_CLK_HZ};
use crate::card::Card;
use crate::edges::{Recorder, Timing};
use crate::error::Error;
use crate::exchange::{Meter, StatusHead, is_request, sequence, wants_reply};
use crate::faults::{Act, Cargo, Direction, Line, Plan, Script};
use crate::gmii;
use crate::jobs;
use crate::loader;
use crate::model;
use crate::nor::spi::Shared;
use crate::nor::{Nor, Part};
use crate::plant::Plant;
use crate::report::{Counters, FrameCounts, Report, Seen};
use crate::segment::CONSOLE_PORT;
use crate::server::{Addresses, Device, Reply, Service};
use crate::soc::LINK_1000;
use crate::world::World;

/// Clocks from a request's arrival to its execution, and from there to its answer. The image takes
/// some 970 clocks from the last byte in to the first byte out (`cargo xtask bench exchange`), and
/// acts in the middle.
pub const ANSWER: [u64; 2] = [480, 490];
/// Clocks after a strobe until every word of a sample can be read: `tally.sv`.
const SAMPLED: u64 = 20;
/// Clocks between two slices of an operation of the flash: what a slice takes the image, some 256
/// bytes of SPI.
const SLICE: u64 = 12_000;
/// Clocks until a CPU reaches the firmware's first instruction.
const FIRST: u64 = 64;
/// Clocks of a register access of the CPU.
const ACCESS: u64 = 2;
/// Clocks from a start to the first frame that is looked at: what the image takes on the Verilated
/// board (`ferrocnc-sim --backend rtl` prints 198 662 from power-up with the first question).
pub const STARTING: u64 = 190_000;
/// Bytes around a UDP payload on the wire: preamble, Ethernet, IPv4, UDP, FCS.
const ENVELOPE: usize = 8 + 14 + 20 + 8 + 4;
/// The host's address on the board's cable, as the Verilated board sees it.
const HOST: u32 = 0xc0a8_0201;

/// The FPGA of a twin: what its flash must hold to be loaded. LFE5U-25F, as on every board of ours.
pub const IDCODE: u32 = 0x4111_1043;
/// Unique id of a twin's flash until told otherwise.
pub const UID: u64 = 0xd162_0c8a_1b2c_3d4e;

/// The parts of a twin.
#[derive(Debug)]
pub struct Setup {
    /// The board.
    pub card: Card,
    /// What is wired to it.
    pub plant: Plant,
    /// Its flash. It survives a restart; the next twin with the same flash is the board after a
    /// power cycle.
    pub flash: Shared,
    /// The factory pin is held.
    pub factory: bool,
    /// The register map its gateware was built from. Another than the firmware's means that
    /// gateware and firmware of different builds were flashed.
    pub abi: u32,
    /// What its wall clock shows at the start; it counts clocks since power-up, so 0 unless its end
    /// is to come soon.
    pub wall_clock: u64,
    /// Its SDRAM works; only a board with jobs uses it.
    pub sdram: bool,
    /// Its gateware reads its pads back and counts the Ethernet clock; false is one from before
    /// that.
    pub readback: bool,
    /// How fast the PHY's receive clock is against the board's own, in parts per million of what it
    /// should be.
    pub eth_ppm: i32,
}

impl Setup {
    /// This board with a new flash, nothing held.
    pub fn new(card: Card, plant: Plant) -> Self {
        Setup {
            card,
            plant,
            flash: Shared::new(Nor::new(Part::W25Q32JV, UID)),
            factory: false,
            abi: regmap::ABI,
            wall_clock: 0,
            sdram: true,
            readback: true,
            eth_ppm: 0,
        }
    }
}

/// The trailer of the image that the FPGA loads from this flash, as packing wrote it at the end of
/// the ROM. From a blank flash nothing loads: then the twin is a board that JTAG loaded.
fn trailer(flash: &Nor) -> Trailer {
    let loaded = loader::power_up(flash.cells(), IDCODE);
    let Some((at, layout)) = loaded.image.zip(Layout::of(flash.part().bytes as u32)) else {
        return Trailer::NONE;
    };
    let areas = [
        (layout.slot_a, Role::Image),
        (layout.slot_b, Role::Image),
        (layout.golden, Role::Golden),
    ];
    let found = areas.iter().find(|(area, _)| area.start as usize == at);
    let meta = found.and_then(|(area, role)| {
        let page = flash.cells().get(area.meta() as usize..)?;
        Some((Meta::from_page(page, *area)?, *role))
    });
    meta.map_or(Trailer::NONE, |(meta, role)| Trailer {
        build_id: meta.build_id,
        role,
    })
}

/// The PHY's receive clock, as far as it is counted.
#[derive(Clone, Copy, Debug, Default)]
struct EthClock {
    /// Until this clock of the world.
    clock: u64,
    /// Its clocks, times a million, times the clocks of the board in a second.
    passed: u128,
}

/// The firmware's board: registers, pins and what is wired to them.
#[derive(Debug)]
pub struct Desk {
    model: model::Board,
    /// Clocks of the world before this model began: a board that starts anew counts from 0, the
    /// world does not.
    before: u64,
    world: World,
    flash: Shared,
    trailer: Trailer,
    clockwork: Clockwork,
    blob: Vec<u32>,
    ring: log::Ring<2048>,
    record: Record,
    /// When the watchdog was last given a token.
    fed: u64,
    eth_ppm: i32,
    eth: EthClock,
    /// Frames the MAC threw away.
    spoilt: u32,
    step_inverted: u16,
    dir_inverted: u16,
}

impl Desk {
    /// Switches a board on and brings it to where the firmware starts; returns it with its
    /// identity.
    pub fn power_up(setup: Setup) -> (Self, Ident) {
        // Its own time begins anew, its cells do not.
        let trailer = {
            let mut chip = setup.flash.chip();
            chip.power_up();
            trailer(&chip)
        };
        let ident = ident(&setup.card, setup.abi, setup.readback);
        let mut desk = Desk::new(setup, trailer);
        // The pins are seen by the first instruction.
        desk.pass(FIRST);
        (desk, ident)
    }

    /// Pins, edges and plant.
    pub fn world(&mut self) -> &mut World {
        &mut self.world
    }

    /// What the postmortem record says of this start: its number and its reason.
    pub fn boot(&mut self) -> firmware::postmortem::Boot {
        let now = self.clock() as u32;
        self.record.boot(now)
    }

    /// Leaves word why the next start will be one. Without it that start was a jump to where the
    /// firmware begins.
    pub fn part(&mut self, why: ResetReason) {
        self.record.part(why);
    }

    fn new(setup: Setup, trailer: Trailer) -> Self {
        let Setup {
            card,
            plant,
            flash,
            factory,
            abi,
            wall_clock,
            sdram: _,
            readback,
            eth_ppm,
        } = setup;
        let mut world = World::new(plant, card.clock_hz.into());
        world.factory(factory);
        Desk {
            model: model::Board::at(build(&card, abi, readback), wall_clock),
            before: 0u64.wrapping_sub(wall_clock),
            world,
            flash,
            trailer,
            clockwork: Clockwork::new(card.clock_hz.into()),
            blob: card.words(),
            ring: log::Ring::new(),
            record: Record::EMPTY,
            fed: 0,
            eth_ppm,
            eth: EthClock::default(),
            spoilt: 0,
            step_inverted: 0,
            dir_inverted: 0,
        }
    }

    /// Sys clocks since power-up.
    pub fn clock(&self) -> u64 {
        self.before.wrapping_add(self.model.clocks())
    }

    /// Every core as it powers up; what is wired to them stays as it is, and so does the time of
    /// day.
    fn restart(&mut self) {
        self.before = self.clock();
        self.model = model::Board::new(self.model.build().clone());
        (self.step_inverted, self.dir_inverted) = (0, 0);
        self.world.pins.take_outputs(self.model.pins());
        self.world.observe(self.before);
        for n in 0..16 {
            self.world.edges.set_timing(n, Timing::default());
            self.world.edges.set_kind(n, StepType::default());
        }
        self.world.edges.set_polarity(0, 0);
        self.world.look_again();
        // The time a CPU takes to come to its first instruction of ours.
        self.pass(self.clock() + FIRST);
    }

    /// Lets time pass to the sys clock `until`.
    pub fn pass(&mut self, until: u64) {
        while self.clock() < until {
            let target = until.min(self.world.next().max(self.clock() + 1));
            self.model.drive(&self.world.pins);
            let changed = self.model.run(target.wrapping_sub(self.before));
            self.world.pins.take_outputs(self.model.pins());
            let clock = self.clock();
            if changed || clock >= self.world.next() {
                self.world.observe(clock);
            }
        }
    }

    /// The flash, as late as it is here. Its own time passes while it is spoken to, as the CPU's
    /// does.
    fn flash(&mut self) -> &mut Shared {
        let ticks = self.clock() * self.clockwork.sys_period;
        let now = self.clockwork.picoseconds(ticks) / 1000;
        self.flash.chip().it_is(now);
        &mut self.flash
    }

    /// As the firmware asks for the time: the wall clock and the beats of the PHY's clock are
    /// caught together.
    fn snapshot(&mut self) {
        let (now, status) = (self.clock(), self.world.pins.link_status);
        let hz: u64 = match (status & 1, status >> 1 & 3) {
            (1, 0) => 2_500_000,
            (1, 1) => 25_000_000,
            _ => ETH_CLK_HZ,
        };
        let million = (1_000_000 + i64::from(self.eth_ppm)).max(0) as u128;
        self.eth.passed += u128::from(now - self.eth.clock) * u128::from(hz) * million;
        self.eth.clock = now;
        let of_one = u128::from(self.clockwork.sys_hz) * 1_000_000;
        let beat = of_one * u128::from(wire::map::ETH_BEAT_CLOCKS);
        self.model.snapshot((self.eth.passed / beat) as u32);
    }

    fn order(&mut self, page: u32, word: usize, data: u32) {
        self.model.order(page, word as u32, data);
        self.pass(self.clock() + ACCESS);
    }

    /// What a register reads.
    fn read(&mut self, page: u32, word: usize) -> u32 {
        self.model.read(page, word as u32)
    }

    /// Page and word of a register's address.
    fn place(address: u32) -> (u32, usize) {
        let offset = address.wrapping_sub(wire::map::SERVICE);
        let page = regmap::CSR_PAGE as u32;
        (offset / page, (offset % page / 4) as usize)
    }

    /// Gives the check at the pins the settings of a stepgen.
    fn tell_the_judge(&mut self, n: u8) {
        let mut read = |field| cores::Board::setting(self, Setting::Stepgen(n, field));
        let timing = Timing {
            steplen: read(StepgenConfig::Steplen).into(),
            stepspace: read(StepgenConfig::Stepspace).into(),
            dirsetup: read(StepgenConfig::Dirsetup).into(),
            dirhold: read(StepgenConfig::Dirhold).into(),
        };
        let mode = read(StepgenConfig::Mode);
        let kind =
            StepType::from_code(mode >> wire::map::STEPGEN_TYPE_SHIFT & 3).unwrap_or_default();
        let put = |word: u16, bit| word & !(1 << n) | u16::from(mode & bit != 0) << n;
        self.step_inverted = put(self.step_inverted, wire::map::STEPGEN_STEP_INVERT);
        self.dir_inverted = put(self.dir_inverted, wire::map::STEPGEN_DIR_INVERT);
        // A change of polarity is not a pulse: the check takes the new level.
        self.pass(self.clock());
        self.model.drive(&self.world.pins);
        while self.model.run(self.model.clocks() + ACCESS) {}
        self.world.pins.take_outputs(self.model.pins());
        let edges = &mut self.world.edges;
        edges.set_timing(n.into(), timing);
        edges.set_kind(n.into(), kind);
        edges.set_polarity(self.step_inverted, self.dir_inverted);
        self.world.look_again();
    }
}

impl cores::Board for Desk {
    type Spi = Shared;

    fn spi(&mut self) -> &mut Shared {
        self.flash()
    }
    fn trailer(&mut self) -> [u32; Trailer::WORDS] {
        self.trailer.to_words()
    }
    fn factory_pin(&mut self) -> bool {
        self.world.pins.factory != 0
    }
    fn link(&mut self) -> cores::Link {
        cores::Link {
            status: self.world.pins.link_status.into(),
            errors: self.spoilt,
        }
    }
    fn now(&mut self) -> u64 {
        self.snapshot();
        self.model.now()
    }
    fn now_lo(&mut self) -> u32 {
        self.snapshot();
        self.model.now() as u32
    }
    fn arrival_lo(&mut self) -> u32 {
        self.model.arrival() as u32
    }
    fn arrival_hi(&mut self) -> u32 {
        (self.model.arrival() >> 32) as u32
    }
    fn stage(&mut self, word: usize, value: u32) {
        self.model.set(command::PAGE, word as u32, value);
    }
    fn staged(&mut self, word: usize) -> u32 {
        self.read(command::PAGE, word)
    }
    fn latched(&mut self, word: usize) -> u32 {
        self.model.status(word)
    }
    fn commit_at(&mut self, at: u64) {
        // Never first, so that no half of an old time and half of a new one can be due.
        let (low, high) = (timebase::COMMIT_AT_LO, timebase::COMMIT_AT_HI);
        for (word, half) in [
            (high, u32::MAX),
            (low, at as u32),
            (high, (at >> 32) as u32),
        ] {
            self.order(timebase::PAGE, word, half);
        }
    }
    fn strobe(&mut self, strobes: u32) {
        self.order(timebase::PAGE, timebase::STROBE, strobes);
        if strobes & timebase::STROBE_SAMPLE != 0 {
            self.pass(self.clock() + SAMPLED);
        }
    }
    fn watchdog_left(&mut self) -> u32 {
        self.read(watchdog::PAGE, watchdog::REMAINING)
    }
    fn feed(&mut self, token: u32) {
        self.fed = self.clock();
        self.order(watchdog::PAGE, watchdog::TOKEN, token);
    }
    fn gate(&mut self) -> Gate {
        Gate(self.read(watchdog::PAGE, watchdog::STATUS))
    }
    fn last_close(&mut self) -> u32 {
        self.read(watchdog::PAGE, watchdog::LAST_CLOSE)
    }
    fn control(&mut self, order: Control) {
        self.order(watchdog::PAGE, watchdog::CONTROL, order.key());
    }
    fn setting(&mut self, which: Setting) -> u32 {
        self.csr_read(which.address() as u32)
    }
    fn set(&mut self, which: Setting, value: u32) {
        let (page, word) = Self::place(which.address() as u32);
        self.order(page, word, value);
        if let Setting::Stepgen(n, _) = which {
            self.tell_the_judge(n);
        }
    }
    fn set_stop_accel(&mut self, stepgen: usize, value: u32) {
        self.order(stepgen::PAGE + stepgen as u32, stepgen::STOP_ACCEL, value);
    }
    fn csr_read(&mut self, address: u32) -> u32 {
        let (page, word) = Self::place(address);
        self.read(page, word)
    }
    fn csr_write(&mut self, address: u32, value: u32) {
        let (page, word) = Self::place(address);
        self.order(page, word, value);
        if (stepgen::PAGE..encoder::PAGE).contains(&page) {
            self.tell_the_judge((page - stepgen::PAGE) as u8);
        }
    }
    fn blob(&mut self, word: usize) -> u32 {
        self.blob.get(word).copied().unwrap_or(0)
    }
    fn led(&mut self, pattern: Led) {
        self.order(led::PAGE, led::PATTERN, pattern as u32);
    }
    fn log(&mut self, read: log::Read) -> u32 {
        self.ring.read(read)
    }
    fn panic(&mut self, offset: u32) -> u32 {
        self.record.word(offset)
    }
    fn rename_boot(&mut self, seed: u32) -> u32 {
        self.record.rename(seed)
    }
}

fn build(card: &Card, abi: u32, readback: bool) -> model::board::Build {
    model::board::Build {
        jobs: card.jobs,
        channels: card.channels,
        clock_hz: card.clock_hz,
        estop_mask: card.estop_mask,
        estop_level: card.estop_level,
        abi,
        version: firmware::VERSION,
        rom_words: card.words().len() as u32,
        readback,
    }
}

/// Text of the console on its way out.
#[derive(Debug, Default)]
struct Paper(Vec<u8>);

impl text::Sink for Paper {
    fn put(&mut self, text: &[u8]) {
        self.0.extend_from_slice(text);
    }
}

/// A client at the console.
#[derive(Debug, Default)]
struct Visitor {
    line: console::Line,
    out: Paper,
    said_goodbye: bool,
    gone: bool,
    /// A client of the jobs, not of the console.
    jobs: bool,
}

/// A datagram on its way to the board.
#[derive(Clone, Debug)]
struct Letter {
    port: u16,
    service: Service,
    payload: Vec<u8>,
}

fn on_the_wire(payload: &[u8]) -> usize {
    (payload.len() + ENVELOPE).max(gmii::MIN_FRAME + 12)
}

impl Cargo for Letter {
    fn wire_bytes(&self) -> usize {
        on_the_wire(&self.payload)
    }
    /// The MAC drops what its checksum does not fit.
    fn damage(&mut self, _: u64) -> bool {
        false
    }
}

impl Cargo for Reply {
    fn wire_bytes(&self) -> usize {
        on_the_wire(&self.payload)
    }
    /// So does the host's.
    fn damage(&mut self, _: u64) -> bool {
        false
    }
}

#[derive(Debug)]
struct Request {
    port: u16,
    service: Service,
    payload: Vec<u8>,
    /// Executed, answered at these clocks.
    due: u64,
    answered: u64,
    reply: Option<Vec<u8>>,
}

/// A twin and the hosts that talk to it.
#[derive(Debug)]
pub struct Twin {
    machine: Machine<Desk>,
    card: Card,
    sdram: bool,
    clockwork: Clockwork,
    requests: VecDeque<Request>,
    replies: Vec<Reply>,
    visitors: Vec<Visitor>,
    meter: Meter,
    script: Script,
    to_board: Line<Letter>,
    from_board: Line<Reply>,
    /// Nothing is heard before this clock: the firmware is starting.
    starting: u64,
    frames: FrameCounts,
    frozen: bool,
    chores_at: u64,
    /// What executes jobs, and when it is called next.
    jobs: Option<jobs::Program>,
    jobs_at: u64,
    busy: Duration,
    busy_clocks: u64,
}

fn payload(words: &[u32]) -> Vec<u8> {
    words.iter().flat_map(|word| word.to_be_bytes()).collect()
}

fn ident(card: &Card, abi: u32, readback: bool) -> Ident {
    Ident {
        abi,
        version: firmware::VERSION,
        clock_hz: card.clock_hz,
        channels: card.channels,
        features: (u32::from(card.jobs > 0) * wire::describe::FEATURE_JOBS)
            | (u32::from(readback) * wire::describe::FEATURE_READBACK),
        blob_words: card.words().len() as u32,
    }
}

fn jobs_program(machine: &mut Machine<Desk>, card: &Card, sdram: bool) -> Option<jobs::Program> {
    if card.jobs == 0 {
        return None;
    }
    if card.streamed {
        machine.server.jobs(JobsState::Streamed);
        return None;
    }
    if !sdram {
        machine.server.jobs(JobsState::Sdram);
        return None;
    }
    let program = jobs::Program::start(machine, card.clock_hz);
    machine.server.jobs(match program {
        Some(_) => JobsState::Alive,
        None => JobsState::Missing,
    });
    program
}

impl Twin {
    /// Switches a twin of this board on; its flash is new.
    pub fn start(card: Card, plant: Plant) -> Self {
        Self::power_up(Setup::new(card, plant))
    }

    /// Switches a board on.
    pub fn power_up(setup: Setup) -> Self {
        let (card, sdram) = (setup.card.clone(), setup.sdram);
        let (mut desk, ident) = Desk::power_up(setup);
        let boot = desk.boot();
        let mut machine = Machine::start(desk, ident, regmap::ABI, boot);
        let jobs = jobs_program(&mut machine, &card, sdram);
        let clockwork = Clockwork::new(card.clock_hz.into());
        Twin {
            chores_at: machine.board.clock(),
            jobs_at: machine.board.clock(),
            jobs,
            machine,
            card,
            sdram,
            clockwork,
            requests: VecDeque::new(),
            replies: Vec::new(),
            visitors: Vec::new(),
            meter: Meter::default(),
            script: Script::new(clockwork.sys_hz),
            to_board: Line::new(Direction::ToBoard),
            from_board: Line::new(Direction::FromBoard),
            starting: 0,
            frames: FrameCounts::default(),
            frozen: false,
            busy: Duration::ZERO,
            busy_clocks: 0,
        }
    }

    /// The sys clock in which the watchdog was last given a token: the write is on the bus.
    pub fn fed(&self) -> u64 {
        self.machine.board.fed
    }

    /// As if stepgen and encoder n had come this far; see [`model::Board::preset`].
    pub fn preset(&mut self, n: usize, pulses: i32, count: i32) {
        self.machine.board.model.preset(n, pulses, count);
    }

    /// Pins, edges and plant.
    pub fn world(&mut self) -> &mut World {
        &mut self.machine.board.world
    }

    /// Stream every step into a file; [`Self::finish`] closes it.
    pub fn record_edges(&mut self, path: &std::path::Path) -> Result<(), Error> {
        let recorder = Recorder::create(path, self.clockwork.sys_hz)?;
        self.world().edges.record(recorder);
        Ok(())
    }

    /// Close the edge file.
    pub fn finish(&mut self) -> Result<u64, Error> {
        self.world().edges.finish_recording()
    }

    fn chores_every(&self) -> u64 {
        match self.machine.server.flash().busy() {
            true => SLICE,
            false => self.clockwork.sys_hz / 1000,
        }
    }

    /// Sends the board's broadcasts.
    fn shout(&mut self) {
        while self.machine.has_to_shout() {
            let mut buffer = [0; MAX_WORDS];
            let Some(shout) = self.machine.shout(&mut buffer) else {
                return;
            };
            self.frames.from_board += 1;
            let reply = Reply {
                service: match shout.from_port {
                    dhcp::PORT => Service::Dhcp,
                    _ => Service::Discovery,
                },
                port: shout.to_port,
                payload: payload(&buffer[..shout.words]),
            };
            self.send(reply);
        }
    }

    /// Puts a reply on the cable.
    fn send(&mut self, mut reply: Reply) {
        let now = self.machine.board.clock();
        let from = Direction::FromBoard;
        self.script.cut(from, now, &mut reply.payload);
        self.from_board.enter(&mut self.script, now, reply);
        self.heard_of(now);
    }

    /// Takes the datagrams that have arrived by now.
    fn heard_of(&mut self, now: u64) {
        while let Some(letter) = self.to_board.due(now) {
            self.take_in(letter);
        }
        while let Some(reply) = self.from_board.due(now) {
            self.replies.push(reply);
        }
        self.frames.dropped = self.script.tally.lost;
    }

    fn take_in(&mut self, letter: Letter) {
        self.frames.to_board += 1;
        let now = self.machine.board.clock();
        if self.frozen || now < self.starting {
            return;
        }
        let last = self.requests.back();
        let free = last.map_or(0, |last| last.due.max(last.answered));
        self.requests.push_back(Request {
            port: letter.port,
            service: letter.service,
            payload: letter.payload,
            due: now.max(free) + ANSWER[0],
            answered: 0,
            reply: None,
        });
    }

    /// Applies the due faults of the board itself.
    fn suffer(&mut self) {
        while let Some(act) = self.script.due(self.machine.board.clock()) {
            match act {
                Act::Link(up) => self.world().link(if up { LINK_1000 } else { 0 }),
                Act::Freeze(frozen) => self.freeze_cpu(frozen),
                Act::Reboot(power) => self.reboot(power),
            }
        }
    }

    /// The whole board starts anew, as its reset pin makes it; with `power` the memory of its last
    /// start is lost as well.
    pub fn reboot(&mut self, power: bool) {
        let board = &mut self.machine.board;
        let before = board.clock();
        board.restart();
        if power {
            board.record = Record::EMPTY;
            board.flash.chip().power_up();
        }
        self.requests.clear();
        for visitor in &mut self.visitors {
            *visitor = Visitor {
                said_goodbye: true,
                ..Visitor::default()
            };
        }
        self.begin();
        self.starting = before + STARTING;
        self.chores_at = self.starting;
        self.jobs_at = self.starting;
    }

    /// The firmware starts on the board as it stands.
    fn begin(&mut self) {
        let board = &mut self.machine.board;
        let boot = board.record.boot(board.model.clocks() as u32);
        let (flash, trailer) = (board.flash.clone(), board.trailer);
        let (gateware, readback) = {
            let build = board.model.build();
            (build.abi, build.readback)
        };
        let spare = Setup {
            flash,
            ..Setup::new(self.card.clone(), Plant::default())
        };
        let spare = Desk::new(spare, trailer);
        let desk = std::mem::replace(&mut self.machine.board, spare);
        self.machine = Machine::start(
            desk,
            ident(&self.card, gateware, readback),
            regmap::ABI,
            boot,
        );
        self.jobs = jobs_program(&mut self.machine, &self.card, self.sdram);
    }

    fn chores(&mut self) {
        if let Some((state, reason)) = self.machine.chores() {
            // The image logs this for `ferrocnc log`, which needs the image's strings; here it is
            // printed.
            eprintln!("sim: {state}, reason {reason}");
        }
        self.shout();
        if self.machine.server.wants_restart() {
            self.machine.board.record.part(ResetReason::Requested);
            self.begin();
        }
    }

    fn execute(&mut self, mut request: Request) {
        let peer = Peer {
            ip: HOST,
            port: request.port,
        };
        self.machine.board.model.arrive();
        let mut buffer = [0; MAX_WORDS];
        let words = || {
            let mut words = [0; MAX_WORDS];
            let count =
                wire::words_from_bytes(&request.payload, &mut words).map_or(0, <[u32]>::len);
            (words, count)
        };
        let reply = match request.service {
            Service::Etherbone => {
                let reply = self.machine.payload(&request.payload, peer, &mut buffer);
                reply.unwrap_or(&[])
            }
            Service::Discovery => {
                let (words, count) = words();
                let words = &words[..count];
                self.machine.discover(words, request.port, &mut buffer)
            }
            Service::Dhcp => {
                let (words, count) = words();
                self.machine.offered(&words[..count], request.payload.len());
                &[]
            }
        };
        if !reply.is_empty() {
            request.reply = Some(payload(reply));
        }
        if self.machine.server.owes_path() {
            self.machine.hold_path();
        }
        self.shout();
        request.answered = self.machine.board.clock() + ANSWER[1];
        if self.machine.due(BEHIND_A_FRAME) {
            self.chores();
        }
        self.requests.push_front(request);
    }

    /// The program of jobs has a turn. True if it said something.
    fn do_jobs(&mut self) -> bool {
        let now = self.machine.board.clock();
        let Some(program) = self.jobs.as_mut().filter(|_| !self.frozen) else {
            self.jobs_at = u64::MAX;
            return false;
        };
        let (said, due) = program.turn(&mut self.machine);
        self.jobs_at = now + due;
        let Some(said) = said else {
            return false;
        };
        let visitor = &mut self.visitors[said.visitor];
        visitor.out.0.extend(said.bytes);
        visitor.said_goodbye |= said.close;
        true
    }

    fn answer(&mut self, request: Request) -> bool {
        let Some(payload) = request.reply else {
            return false;
        };
        self.frames.from_board += 1;
        if let Some(head) = sequence(&request.payload).and_then(|s| StatusHead::parse(&payload, s))
        {
            self.meter.answer(head);
        }
        self.send(Reply {
            service: request.service,
            port: request.port,
            payload,
        });
        !self.replies.is_empty()
    }

    fn report_now(&mut self) -> Report {
        let own = if self.frozen {
            None
        } else {
            let peer = Peer { ip: HOST, port: 0 };
            let mut word = |address| {
                let words = [
                    wire::etherbone::HEADER,
                    0,
                    wire::etherbone::BYTE_ENABLE | 1,
                    0,
                    address,
                ];
                let mut buffer = [0; MAX_WORDS];
                let reply = self.machine.datagram(&words, peer, &mut buffer).ok()?;
                reply.get(4).copied()
            };
            Counters::gather(|base, words| (0..words).map(|n| word(base + 4 * n)).collect())
        };
        Report::of(
            &Seen {
                backend: "model",
                world: &self.machine.board.world,
                clockwork: self.clockwork,
                clocks: self.machine.board.clock(),
                kcycles_per_second: self.kcycles_per_second(),
                meter: &self.meter,
                frames: self.frames,
            },
            own,
        )
    }
}

impl Device for Twin {
    type Console = usize;

    fn clock(&self) -> u64 {
        self.machine.board.clock()
    }

    fn clockwork(&self) -> Clockwork {
        self.clockwork
    }

    fn post(&mut self, port: u16, service: Service, payload: &[u8]) {
        self.meter.requested += u64::from(is_request(payload));
        let mut letter = Letter {
            port,
            service,
            payload: payload.to_vec(),
        };
        let now = self.clock();
        let to = Direction::ToBoard;
        self.script.cut(to, now, &mut letter.payload);
        self.to_board.enter(&mut self.script, now, letter);
        self.machine.board.spoilt = self.to_board.spoilt();
        self.heard_of(now);
    }

    fn pass(&mut self, until: u64) -> bool {
        let (started, before) = (Instant::now(), self.clock());
        let mut told = false;
        while self.clock() < until && !told {
            let next = match self.requests.front() {
                Some(request) if request.answered != 0 => request.answered,
                Some(request) => request.due,
                None => u64::MAX,
            };
            let chores = if self.frozen {
                u64::MAX
            } else {
                self.chores_at
            };
            let cable = self.to_board.next().min(self.from_board.next());
            let trouble = self.script.next(self.clock()).min(cable);
            let board = &mut self.machine.board;
            let stop = until.min(next).min(chores).min(trouble).min(self.jobs_at);
            board.pass(stop.max(board.clock() + 1));
            if self.clock() >= trouble {
                self.suffer();
                self.heard_of(self.clock());
                told |= !self.replies.is_empty();
                continue;
            }
            if self.clock() >= self.jobs_at {
                told |= self.do_jobs();
            }
            if self.clock() >= chores {
                if self.machine.due(IDLE) {
                    self.chores();
                }
                self.chores_at = self.clock() + self.chores_every();
                told |= !self.replies.is_empty();
            }
            if self.clock() >= next
                && let Some(request) = self.requests.pop_front()
            {
                if request.answered == 0 {
                    self.execute(request);
                    if self.machine.server.flash().busy() {
                        self.chores_at = self.chores_at.min(self.clock() + SLICE);
                    }
                } else {
                    told |= self.answer(request);
                }
            }
        }
        self.busy += started.elapsed();
        self.busy_clocks += self.clock() - before;
        told
    }

    fn take_replies(&mut self) -> Vec<Reply> {
        std::mem::take(&mut self.replies)
    }

    fn addresses(&self) -> Option<Addresses> {
        let us = &self.machine.us;
        Some(Addresses {
            mac: us.mac,
            ip: us.ip.into(),
            prefix: self.machine.net.0,
            port: us.port,
        })
    }

    fn wait_for(&self, service: Service, payload: &[u8]) -> u64 {
        if service == Service::Discovery || wants_reply(payload) {
            2000
        } else {
            ANSWER[0] + 100
        }
    }

    fn open(&mut self, port: u16) -> usize {
        let mut visitor = Visitor::default();
        if port == CONSOLE_PORT {
            self.machine.greet();
            visitor.out.0.extend(console::PROMPT.bytes());
        } else {
            visitor.jobs = true;
            let number = self.visitors.len();
            let program = self.jobs.as_mut();
            match program.map(|program| program.open(number, &mut self.machine)) {
                Some(None) => self.jobs_at = self.jobs_at.min(self.clock() + ACCESS),
                Some(Some(busy)) => visitor.out.0.extend(busy),
                // No service listens there.
                None => visitor.said_goodbye = true,
            }
        }
        self.visitors.push(visitor);
        self.visitors.len() - 1
    }

    fn type_in(&mut self, console: usize, bytes: &[u8]) -> usize {
        if self.frozen || !self.script.link() || self.clock() < self.starting {
            return 0;
        }
        if self.visitors[console].jobs {
            let program = self.jobs.as_mut();
            self.jobs_at = self.jobs_at.min(self.machine.board.clock() + ACCESS);
            return program.map_or(bytes.len(), |program| program.type_in(console, bytes));
        }
        let visitor = &mut self.visitors[console];
        for byte in bytes {
            let Some(ask) = visitor.line.push(*byte) else {
                continue;
            };
            match self.jobs.as_mut().filter(|_| ask == Ask::Job) {
                Some(program) => {
                    let text = program.line(visitor.line.job(), &mut self.machine);
                    visitor.out.0.extend(text);
                    self.jobs_at = self.machine.board.clock() + ACCESS;
                }
                None => self
                    .machine
                    .answer(ask, &Vitals::default(), &mut visitor.out),
            }
            if ask == Ask::Quit {
                visitor.said_goodbye = true;
                break;
            }
            visitor.out.0.extend(console::PROMPT.bytes());
        }
        bytes.len()
    }

    fn heard(&mut self, console: usize) -> Vec<u8> {
        if !self.script.link() {
            return Vec::new();
        }
        std::mem::take(&mut self.visitors[console].out.0)
    }

    fn untold(&mut self, console: usize) -> usize {
        let program = self.jobs.as_ref();
        program.map_or(0, |program| program.untold(console))
    }

    fn hang_up(&mut self, console: usize) {
        self.visitors[console].gone = true;
        if let Some(program) = &mut self.jobs {
            program.close(console);
        }
    }

    fn hung_up(&mut self, console: usize) -> bool {
        self.visitors[console].said_goodbye
    }

    fn closed(&mut self, console: usize) -> bool {
        self.visitors[console].gone
    }

    fn forget(&mut self, console: usize) {
        // The numbers of other clients must not change; an empty entry takes a few words.
        self.visitors[console] = Visitor::default();
    }

    fn world(&self) -> &World {
        &self.machine.board.world
    }

    fn world_mut(&mut self) -> &mut World {
        &mut self.machine.board.world
    }

    fn freeze_cpu(&mut self, frozen: bool) {
        self.frozen = frozen;
        self.jobs_at = self.jobs_at.min(self.clock());
        if frozen {
            self.requests.clear();
        }
    }

    fn faults(&mut self) -> &mut Script {
        &mut self.script
    }

    fn trouble(&mut self, plan: &Plan) -> Result<(), String> {
        self.script.follow(plan, self.machine.board.clock());
        self.suffer();
        Ok(())
    }

    fn meter(&self) -> &Meter {
        &self.meter
    }

    fn frames(&self) -> FrameCounts {
        self.frames
    }

    fn ping(&mut self) -> Option<u64> {
        (!self.frozen).then_some(ANSWER[0] + ANSWER[1])
    }

    fn kcycles_per_second(&self) -> f64 {
        self.busy_clocks as f64 / self.busy.as_secs_f64().max(1e-9) / 1e3
    }

    fn report(&mut self) -> Report {
        self.report_now()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plant::{Axis, Spindle, Switch};
    use wire::describe::Channels;
    use wire::exchange::{Command, Latch, REQUEST_OVERHEAD, Status};
    use wire::map;
    use wire::units::{Accel, StepRate};

    const SIX: Channels = Channels {
        stepgens: 6,
        encoders: 6,
        pwms: 6,
        inputs: 12,
        outputs: 12,
    };
    const HZ: u32 = 60_000_000;
    const MS: u64 = 60_000;

    /// A host on port 40000 of a twin.
    struct Bench {
        twin: Twin,
        command: Command,
    }

    impl Bench {
        fn new(plant: Plant) -> Self {
            Bench {
                twin: Twin::start(Card::plain(SIX, HZ), plant),
                command: Command::default(),
            }
        }

        fn ask(&mut self, words: &[u32]) -> Option<Vec<u32>> {
            let payload: Vec<u8> = words.iter().flat_map(|word| word.to_be_bytes()).collect();
            self.twin.post(40_000, Service::Etherbone, &payload);
            let until = self.twin.clock() + 3000;
            while !self.twin.pass(until) && self.twin.clock() < until {}
            let reply = self.twin.take_replies().pop()?;
            assert_eq!((reply.service, reply.port), (Service::Etherbone, 40_000));
            let (chunks, _) = reply.payload.as_chunks();
            Some(chunks.iter().map(|c| u32::from_be_bytes(*c)).collect())
        }

        fn read(&mut self, address: u32) -> u32 {
            self.ask(&[0x4e6f_1044, 0, 0x000f_0001, 0, address])
                .expect("an answer")[4]
        }

        fn write(&mut self, address: u32, value: u32) {
            assert_eq!(
                self.ask(&[0x4e6f_1044, 0, 0x000f_0100, address, value]),
                None
            );
        }

        /// One servo period.
        fn exchange(&mut self) -> Status {
            self.command.sequence += 1;
            let mut buffer = [0; REQUEST_OVERHEAD + wire::exchange::COMMAND_MAX];
            let request = self
                .command
                .emit_request(SIX, &mut buffer)
                .expect("it fits")
                .to_vec();
            let end = self.twin.clock() + MS;
            let reply = self.ask(&request).expect("the exchange is answered");
            while self.twin.clock() < end {
                self.twin.pass(end);
            }
            Status::parse_reply(&reply, SIX).expect("a status")
        }

        fn armed(plant: Plant) -> Self {
            Self::configured(plant, &[])
        }

        /// Armed, with ordinary timings and these settings.
        fn configured(plant: Plant, settings: &[(u32, u32)]) -> Self {
            let mut bench = Bench::new(plant);
            bench.write(map::SESSION_ACQUIRE, 7);
            bench.command.token = bench.read(map::SESSION_TOKEN);
            for n in 0..6 {
                let at = map::CONFIG_STEPGEN + n * map::CONFIG_STRIDE;
                for (word, value) in [(0, 60), (1, 60), (2, 120), (3, 120), (4, 50_000_000)] {
                    bench.write(at + 4 * word, value);
                }
            }
            for (address, value) in settings {
                bench.write(*address, *value);
            }
            bench.command.enable = true;
            bench.command.stepgen_enable = 0x3f;
            bench.command.stepgen = [(StepRate(0), Accel(50_000_000)); 16];
            bench.exchange();
            bench.command.enable_request = true;
            bench.exchange();
            assert!(bench.exchange().state.enabled);
            bench
        }

        fn rate(&mut self, axis: usize, steps_per_second: f64) {
            let rate = steps_per_second * 2f64.powi(32) / f64::from(HZ);
            self.command.stepgen[axis].0 = StepRate(rate as i32);
        }

        fn periods(&mut self, n: usize) -> Status {
            (0..n).map(|_| self.exchange()).last().expect("a period")
        }
    }

    #[test]
    fn it_says_what_it_is() {
        let mut bench = Bench::new(Plant::default());
        assert_eq!(bench.read(0x18), HZ);
        assert_eq!(bench.read(map::DESCRIBE_BLOB), wire::board::MAGIC);
        assert_eq!(
            bench.read(regmap::address(regmap::ident::BASE, regmap::ident::MAGIC)),
            regmap::IDENT_MAGIC
        );
    }

    #[test]
    fn what_the_host_asks_for_happens_at_the_pins_and_at_the_encoders() {
        let mut bench = Bench::armed(Plant::direct(6));
        bench.rate(0, 50_000.0);
        bench.rate(1, -12_345.0);
        bench.periods(100);
        bench.rate(0, 0.0);
        bench.rate(1, 0.0);
        let status = bench.periods(40);
        let edges = &bench.twin.world().edges;
        for n in 0..2 {
            let (count, pins) = ((status.stepgen[n].0.0 >> 32) as i32, edges.channel(n).count);
            assert_eq!(
                (i64::from(count), status.encoder[n].count.0 as i32),
                (pins, count)
            );
        }
        assert!(
            (edges.channel(0).count - 5000).abs() < 20,
            "{}",
            edges.channel(0).count
        );
        assert!((edges.channel(1).count + 1234).abs() < 20);
        assert_eq!(edges.violations(), []);
        let report = Device::report(&mut bench.twin);
        assert_eq!(
            report.axes[0].firmware_counts,
            Some(report.axes[0].pulses_at_pins)
        );
    }

    #[test]
    fn silence_stops_the_machine_and_closes_the_gate() {
        let mut bench = Bench::armed(Plant::default());
        bench.rate(0, 100_000.0);
        bench.periods(10);
        let end = bench.twin.clock() + 50 * MS;
        while bench.twin.clock() < end {
            bench.twin.pass(end);
        }
        assert_eq!(bench.twin.world().pins().gate, 0);
        assert_eq!(bench.twin.world().edges.violations(), []);
        let close = bench.read(regmap::address(watchdog::BASE, watchdog::LAST_CLOSE));
        assert_eq!(close, wire::GateClose::Bite as u32);
    }

    #[test]
    fn an_index_and_a_probe_are_latched_to_the_step() {
        let mut plant = Plant::new([Axis {
            counts_per_rev: 1000,
            index_at: 333,
            ..Axis::direct(0)
        }]);
        plant.add_switch(Switch {
            stepgen: 1,
            at: -200,
            above: false,
            input: 5,
            inverted: false,
        });
        let mut bench = Bench::configured(
            plant,
            &[(
                map::CONFIG_BOARD + 4 * map::BoardConfig::Probe as u32,
                5 | map::PROBE_ENABLE,
            )],
        );
        bench.command.index_arm = 1;
        bench.command.stepgen_index_arm = 1;
        bench.command.stepgen_probe_arm = 2;
        bench.rate(0, 20_000.0);
        bench.rate(1, -20_000.0);
        bench.periods(40);
        let mut latched = |latch| {
            bench.command.latch = latch;
            let status = bench.exchange();
            assert_eq!(
                (
                    status.index_latched,
                    status.stepgen_index_latched,
                    status.stepgen_probe_latched
                ),
                (1, 1, 2)
            );
            status.latch.0 as i32
        };
        assert_eq!(latched(Latch::Encoder(0)), 333);
        assert_eq!(latched(Latch::Stepgen(0)), 333);
        assert_eq!(latched(Latch::Stepgen(1)), -200);
    }

    #[test]
    fn a_spindle_turns_as_its_pwm_says() {
        let mut plant = Plant::default();
        plant.add_spindle(Spindle {
            pwm: 0,
            up_down: false,
            encoder: 5,
            counts_per_rev: 4000,
            max_rps: 50.0,
            lag_ms: 20.0,
            enable_output: None,
            reverse_output: None,
        });
        let mut bench = Bench::configured(plant, &[(map::CONFIG_PWM, 3000)]);
        bench.command.pwm[0] = 750 << wire::exchange::PWM_FRACTION | wire::exchange::PWM_ENABLE;
        let before = bench.periods(200).encoder[5].count.0;
        let after = bench.periods(100).encoder[5].count.0;
        // A quarter of 50 revolutions per second, a tenth of a second, 4000 counts each.
        let counts = after.wrapping_sub(before) as i32;
        assert!((counts - 5000).abs() < 60, "{counts}");
    }

    #[test]
    fn a_visitor_is_greeted_answered_and_let_go() {
        let mut twin = Twin::start(Card::plain(SIX, HZ), Plant::default());
        let visitor = twin.open(CONSOLE_PORT);
        assert_eq!(twin.heard(visitor), console::PROMPT.as_bytes());
        twin.type_in(visitor, b"status\nquit\n");
        let heard = String::from_utf8(twin.heard(visitor)).expect("text");
        assert!(heard.contains("disarmed"), "{heard}");
        assert!(twin.hung_up(visitor) && !twin.closed(visitor));
        twin.hang_up(visitor);
        assert!(twin.closed(visitor));
    }

    #[test]
    fn a_board_that_starts_anew_forgets_its_session_and_its_counts_but_the_machine_stays_where_it_is()
     {
        for word in ["reboot", "power"] {
            let mut bench = Bench::armed(Plant::direct(6));
            let boot = bench.read(map::DESCRIBE + 4 * 10);
            bench.rate(0, 50_000.0);
            bench.periods(20);
            let there = bench.twin.world().edges.channel(0).count;
            assert!(there > 400, "{there}");
            let clock = bench.twin.clock();
            bench.twin.trouble(&word.parse().unwrap()).unwrap();
            assert_eq!(bench.twin.world().pins().gate, 0, "{word}");
            // The firmware has not started yet.
            assert_eq!(bench.ask(&[0x4e6f_1044, 0, 0x000f_0001, 0, 0]), None);
            bench.twin.pass(clock + STARTING);
            assert_eq!(bench.read(map::SESSION_TOKEN), 0, "{word}");
            assert_ne!(bench.read(map::DESCRIBE + 4 * 10), boot, "{word}");
            assert_eq!(bench.twin.world().edges.channel(0).count, there);
            assert_eq!(bench.twin.world().edges.violations(), []);
        }
    }

    #[test]
    fn a_pulled_cable_stops_the_machine_and_the_phy_says_so() {
        let mut bench = Bench::armed(Plant::default());
        bench.rate(0, 100_000.0);
        bench.periods(10);
        bench
            .twin
            .trouble(&"pull@1ms..60ms".parse().unwrap())
            .unwrap();
        let end = bench.twin.clock() + 50 * MS;
        while bench.twin.clock() < end {
            bench.twin.pass(end);
        }
        let pins = bench.twin.world().pins();
        assert_eq!((pins.gate, pins.link_status), (0, 0));
        let end = bench.twin.clock() + 20 * MS;
        while bench.twin.clock() < end {
            bench.twin.pass(end);
        }
        assert_eq!(bench.twin.world().pins().link_status, LINK_1000);
        // The session died with its watchdog: what its host still says is refused, and nothing
        // opens the gate.
        assert_eq!(bench.read(map::SESSION_TOKEN), 0);
        assert_eq!(bench.twin.world().pins().gate, 0);
    }

    #[test]
    fn a_frozen_cpu_answers_nothing_and_the_watchdog_bites_all_the_same() {
        let mut bench = Bench::armed(Plant::default());
        bench.twin.freeze_cpu(true);
        assert_eq!(bench.ask(&[0x4e6f_1044, 0, 0x000f_0001, 0, 0]), None);
        let end = bench.twin.clock() + 8 * MS;
        while bench.twin.clock() < end {
            bench.twin.pass(end);
        }
        assert_eq!(bench.twin.world().pins().gate, 0);
    }
}
