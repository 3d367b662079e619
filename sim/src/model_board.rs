//! The board for the firmware's library: it implements [`firmware::cores::Board`] with the models
//! of the cores, the pins with their wiring, the flash, and the memory that a restart keeps. It
//! handles no datagrams and no clients; [`crate::twin`] does.

use firmware::block::Shape;
use firmware::cores::{self, Control, Gate, Ident, Led, Setting};
use firmware::log;
use firmware::net::{Datagram, Slot, Us};
use firmware::pass::{self, Expected, FLAGS_PLACE, Pass, SEQUENCE_PLACE};
use firmware::postmortem::Record;
use wire::ResetReason;
use wire::flash::Layout;
use wire::images::{Meta, Role, Trailer};
use wire::map::{StepType, StepgenConfig};
use wire::regmap::{
    self, command, encoder, fast_path, led, rx_admission, stepgen, timebase, watchdog,
};

use crate::board::{Clockwork, ETH_CLK_HZ};
use crate::board_facts::BoardFacts;
use crate::edges::Timing;
use crate::environment::PinEnvironment;
use crate::loader;
use crate::model;
use crate::model::rx_admission::Word;
use crate::nor::spi::Shared;
use crate::nor::{Nor, Part};
use crate::plant::Plant;

/// Clocks after a strobe until every word of a sample can be read: `wide_counter.sv`.
const SAMPLED: u64 = 20;
/// Clocks from the last byte of a frame at the PHY to its last word at the fast path: the commit is
/// 7 clocks behind the byte (`fast_path.sv` on the Verilated board), and 2 behind the word.
pub(crate) const RECEIVING: u64 = 5;
/// Bytes in front of a frame in its slot.
const PAD: usize = 2;
/// Clocks until a CPU reaches the firmware's first instruction.
const FIRST: u64 = 64;
/// Clocks of a register access of the CPU.
pub(crate) const ACCESS: u64 = 2;

/// The FPGA of a twin: what its flash must hold to be loaded. LFE5U-25F, as on every board of ours.
pub const IDCODE: u32 = 0x4111_1043;
/// Unique id of a twin's flash until told otherwise.
pub const UID: u64 = 0xd162_0c8a_1b2c_3d4e;

/// The parts of a twin.
#[derive(Debug)]
pub struct Setup {
    /// The board.
    pub facts: BoardFacts,
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
    pub fn new(facts: BoardFacts, plant: Plant) -> Self {
        Setup {
            facts,
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
pub fn trailer(flash: &Nor) -> Trailer {
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
    /// Until this clock of the environment.
    clock: u64,
    /// Its clocks, times a million, times the clocks of the board in a second.
    passed: u128,
}

/// The firmware's board: registers, pins and what is wired to them.
#[derive(Debug)]
pub struct ModelBoard {
    pub(crate) model: model::Board,
    /// Clocks of the environment before this model began: a board that restarts counts from 0,
    /// the environment does not.
    before: u64,
    pub(crate) environment: PinEnvironment,
    pub(crate) flash: Shared,
    pub(crate) trailer: Trailer,
    clockwork: Clockwork,
    blob: Vec<u32>,
    ring: log::Ring<2048>,
    pub(crate) record: Record,
    /// When the watchdog was last given a token.
    pub(crate) fed: u64,
    eth_ppm: i32,
    eth: EthClock,
    /// Frames the MAC threw away.
    pub(crate) spoilt: u32,
    step_inverted: u16,
    dir_inverted: u16,
}

impl ModelBoard {
    /// Switches a board on and brings it to where the firmware starts; returns it with its
    /// identity.
    pub fn power_up(setup: Setup) -> (Self, Ident) {
        // Its own time begins again, its cells do not.
        let trailer = {
            let mut chip = setup.flash.chip();
            chip.power_up();
            trailer(&chip)
        };
        let ident = ident(&setup.facts, setup.abi, setup.readback);
        let mut model_board = ModelBoard::new(setup, trailer);
        // The pins are seen by the first instruction.
        model_board.pass(FIRST);
        (model_board, ident)
    }

    /// Pins, edges and plant.
    pub fn environment(&mut self) -> &mut PinEnvironment {
        &mut self.environment
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

    /// A board as it powers up, its time at 0.
    pub(crate) fn new(setup: Setup, trailer: Trailer) -> Self {
        let Setup {
            facts,
            plant,
            flash,
            factory,
            abi,
            wall_clock,
            sdram: _,
            readback,
            eth_ppm,
        } = setup;
        let mut environment = PinEnvironment::new(plant, facts.clock_hz.into());
        environment.factory(factory);
        ModelBoard {
            model: model::Board::at(build(&facts, abi, readback), wall_clock),
            before: 0u64.wrapping_sub(wall_clock),
            environment,
            flash,
            trailer,
            clockwork: Clockwork::new(facts.clock_hz.into()),
            blob: facts.words(),
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
    pub(crate) fn restart(&mut self) {
        self.before = self.clock();
        self.model = model::Board::new(self.model.build().clone());
        (self.step_inverted, self.dir_inverted) = (0, 0);
        self.environment.pins.take_outputs(self.model.pins());
        self.environment.observe(self.before);
        for n in 0..16 {
            self.environment.edges.set_timing(n, Timing::default());
            self.environment.edges.set_kind(n, StepType::default());
        }
        self.environment.edges.set_polarity(0, 0);
        self.environment.look_again();
        // The time a CPU takes to come to its first instruction of ours.
        self.pass(self.clock() + FIRST);
    }

    /// Lets time pass to the sys clock `until`.
    pub fn pass(&mut self, until: u64) {
        while self.clock() < until {
            let target = until.min(self.environment.next().max(self.clock() + 1));
            self.model.drive(&self.environment.pins);
            let changed = self.model.run(target.wrapping_sub(self.before));
            self.environment.pins.take_outputs(self.model.pins());
            let clock = self.clock();
            if changed || clock >= self.environment.next() {
                self.environment.observe(clock);
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
        let (now, status) = (self.clock(), self.environment.pins.link_status);
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

    /// The frames of this owner's exchanges can be judged in advance from now on, and are answered
    /// as prepared here, as the image's `Mac::guard` has it. No pass is out. No frame is refused
    /// here.
    pub fn guard(&mut self, owner: &Datagram, token: u32, us: &Us, shape: &Shape, boot_id: u32) {
        let expected = Expected::new(us, owner, shape.command, token);
        for (place, word) in expected.words.into_iter().enumerate() {
            self.expect(place, word);
        }
        for (number, run) in pass::runs(shape).into_iter().enumerate() {
            self.order(fast_path::PAGE, fast_path::RUN0 + number, run);
        }
        let length = pass::answer_length(shape) + PAD;
        for (word, value) in [
            (fast_path::IP_SUM, expected.ip_sum),
            (fast_path::UDP_SUM, expected.udp_sum),
            (fast_path::LENGTH, length as u32),
        ] {
            self.order(fast_path::PAGE, word, value);
        }
        pass::prepare(&mut Answer(self.model.answer()), us, owner, shape, boot_id);
    }

    fn expect(&mut self, place: usize, word: u32) {
        self.order(rx_admission::PAGE, rx_admission::HEADER0 + place, word);
    }

    /// A frame of so many bytes without FCS has come, in slot words. True if the gateware executes
    /// it: then the answer is there as soon as [`Self::hears`] again.
    pub fn hear(&mut self, words: &[u32], bytes: usize) -> bool {
        let executed = self.model.hear(Word::of_frame(words, bytes + PAD));
        if executed {
            // As with a token on the bus, which takes effect a clock later.
            self.fed = self.clock() + 1;
        }
        executed
    }

    /// The fast path is done with the last frame.
    pub fn hears(&self) -> bool {
        self.model.hears()
    }

    /// The clock by which the answer's slot has been sent.
    pub(crate) fn sent_at(&self) -> u64 {
        self.before.wrapping_add(self.model.sent_at())
    }

    /// The frame in the answer's slot, without FCS.
    pub fn answer(&mut self) -> Vec<u8> {
        let length = self.model.answer_length();
        let words = self.model.answer().iter();
        let bytes: Vec<u8> = words.flat_map(|word| word.to_be_bytes()).collect();
        bytes.get(PAD..length).unwrap_or_default().to_vec()
    }

    /// What has become of the pass.
    fn progress(&mut self) -> u32 {
        self.read(fast_path::PAGE, fast_path::STATUS)
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
        self.model.drive(&self.environment.pins);
        while self.model.run(self.model.clocks() + ACCESS) {}
        self.environment.pins.take_outputs(self.model.pins());
        let edges = &mut self.environment.edges;
        edges.set_timing(n.into(), timing);
        edges.set_kind(n.into(), kind);
        edges.set_polarity(self.step_inverted, self.dir_inverted);
        self.environment.look_again();
    }
}

/// The fast path's transmit slot.
struct Answer<'m>(&'m mut [u32]);

impl Slot for Answer<'_> {
    fn put(&mut self, index: usize, word: u32) {
        self.0[index] = word;
    }
}

impl cores::Board for ModelBoard {
    type Spi = Shared;

    fn spi(&mut self) -> &mut Shared {
        self.flash()
    }
    fn trailer(&mut self) -> [u32; Trailer::WORDS] {
        self.trailer.to_words()
    }
    fn factory_pin(&mut self) -> bool {
        self.environment.pins.factory != 0
    }
    fn link(&mut self) -> cores::Link {
        cores::Link {
            status: self.environment.pins.link_status.into(),
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
    fn hand_out(&mut self, pass: &Pass) {
        self.expect(SEQUENCE_PLACE, pass.sequence);
        self.expect(FLAGS_PLACE, pass.flags);
        for (index, word) in pass.answer() {
            Answer(self.model.answer()).put(index, word);
        }
        self.order(fast_path::PAGE, fast_path::GATE, pass.condition());
        self.order(fast_path::PAGE, fast_path::PASS, 1);
    }
    fn revoke(&mut self) -> bool {
        self.order(fast_path::PAGE, fast_path::REVOKE, 1);
        self.executed()
    }
    fn executed(&mut self) -> bool {
        self.progress() & fast_path::STATUS_EXECUTED != 0
    }
    fn sending(&mut self) -> bool {
        self.progress() & fast_path::STATUS_SENDING != 0
    }
    fn prepared(&mut self, word: usize) -> u32 {
        self.model.answer()[word]
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

fn build(facts: &BoardFacts, abi: u32, readback: bool) -> model::board::Build {
    model::board::Build {
        jobs: facts.jobs,
        channels: facts.channels,
        clock_hz: facts.clock_hz,
        estop_mask: facts.estop_mask,
        estop_level: facts.estop_level,
        abi,
        version: firmware::VERSION,
        rom_words: facts.words().len() as u32,
        readback,
    }
}

/// What its gateware says of itself.
pub(crate) fn ident(facts: &BoardFacts, abi: u32, readback: bool) -> Ident {
    Ident {
        abi,
        version: firmware::VERSION,
        clock_hz: facts.clock_hz,
        channels: facts.channels,
        features: (u32::from(facts.jobs > 0) * wire::describe::FEATURE_JOBS)
            | (u32::from(readback) * wire::describe::FEATURE_READBACK),
        blob_words: facts.words().len() as u32,
    }
}
