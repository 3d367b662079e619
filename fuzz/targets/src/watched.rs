//! The firmware on the model board, with a recorder of its effects.

use firmware::cores::{Board, Control, Gate, Ident, Led, Link, Setting};
use firmware::log;
use firmware::machine::{IDLE, Machine};
use sim::card::Card;
use sim::desk::{Desk, Setup};
use sim::nor::spi::Shared;
use sim::nor::{Nor, Part, Times};
use sim::plant::Plant;
use std::cell::RefCell;
use wire::regmap::{self, segments, timebase};

/// The segments core's mask of outputs.
const OUTPUTS_OF_A_JOB: u32 = regmap::address(segments::BASE, segments::MASK);

/// The effects on the board.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Deeds {
    /// Words staged; that alone has no effect.
    pub staged: u32,
    /// Samples; they have no effect.
    pub samples: u32,
    /// Commits, now or later.
    pub commits: u32,
    /// Tokens the watchdog was fed.
    pub fed: u32,
    /// Settings and raw registers written.
    pub written: u32,
    /// The flash was accessed.
    pub flash: u32,
    /// Orders to arm.
    pub armed: u32,
    /// Other orders to the gate.
    pub closed: u32,
}

impl Deeds {
    /// Did anything take effect? Orders that close the gate do not count.
    pub fn took_effect(&self) -> bool {
        let Deeds {
            staged: _,
            samples: _,
            commits,
            fed,
            written,
            flash,
            armed,
            closed: _,
        } = *self;
        commits + fed + written + flash + armed != 0
    }
}

/// The model board, with its recorder.
#[derive(Debug)]
pub struct Watched {
    /// The board.
    pub desk: Desk,
    /// Since the last [`Watched::take`].
    pub deeds: Deeds,
}

impl Watched {
    /// The effects since the last call.
    pub fn take(&mut self) -> Deeds {
        std::mem::take(&mut self.deeds)
    }
}

impl Board for Watched {
    type Spi = Shared;

    fn spi(&mut self) -> &mut Shared {
        self.deeds.flash += 1;
        self.desk.spi()
    }
    fn trailer(&mut self) -> [u32; 4] {
        self.desk.trailer()
    }
    fn factory_pin(&mut self) -> bool {
        self.desk.factory_pin()
    }
    fn link(&mut self) -> Link {
        self.desk.link()
    }
    fn now(&mut self) -> u64 {
        self.desk.now()
    }
    fn now_lo(&mut self) -> u32 {
        self.desk.now_lo()
    }
    fn arrival_lo(&mut self) -> u32 {
        self.desk.arrival_lo()
    }
    fn arrival_hi(&mut self) -> u32 {
        self.desk.arrival_hi()
    }
    fn stage(&mut self, word: usize, value: u32) {
        self.deeds.staged += 1;
        self.desk.stage(word, value);
    }
    fn staged(&mut self, word: usize) -> u32 {
        self.desk.staged(word)
    }
    fn latched(&mut self, word: usize) -> u32 {
        self.desk.latched(word)
    }
    fn commit_at(&mut self, at: u64) {
        // "Never" is not a commit.
        self.deeds.commits += u32::from(at != u64::MAX);
        self.desk.commit_at(at);
    }
    fn strobe(&mut self, strobes: u32) {
        let commits = strobes & (timebase::STROBE_COMMIT | timebase::STROBE_COMMIT_AT) != 0;
        self.deeds.commits += u32::from(commits);
        self.deeds.samples += u32::from(!commits);
        self.desk.strobe(strobes);
    }
    fn watchdog_left(&mut self) -> u32 {
        self.desk.watchdog_left()
    }
    fn feed(&mut self, token: u32) {
        self.deeds.fed += 1;
        self.desk.feed(token);
    }
    fn gate(&mut self) -> Gate {
        self.desk.gate()
    }
    fn last_close(&mut self) -> u32 {
        self.desk.last_close()
    }
    fn control(&mut self, order: Control) {
        match order {
            Control::Arm => self.deeds.armed += 1,
            Control::SoftStop | Control::Close | Control::Clear => self.deeds.closed += 1,
        }
        self.desk.control(order);
    }
    fn setting(&mut self, which: Setting) -> u32 {
        self.desk.setting(which)
    }
    fn set(&mut self, which: Setting, value: u32) {
        self.deeds.written += 1;
        self.desk.set(which, value);
    }
    fn set_stop_accel(&mut self, stepgen: usize, value: u32) {
        self.desk.set_stop_accel(stepgen, value);
    }
    fn csr_read(&mut self, address: u32) -> u32 {
        self.desk.csr_read(address)
    }
    fn csr_write(&mut self, address: u32, value: u32) {
        // At rest the outputs of a job follow the commands again: this is the only write that
        // happens by itself.
        if (address, value) != (OUTPUTS_OF_A_JOB, 0) {
            self.deeds.written += 1;
        }
        self.desk.csr_write(address, value);
    }
    fn blob(&mut self, word: usize) -> u32 {
        self.desk.blob(word)
    }
    fn led(&mut self, pattern: Led) {
        self.desk.led(pattern);
    }
    fn log(&mut self, read: log::Read) -> u32 {
        self.desk.log(read)
    }
    fn panic(&mut self, offset: u32) -> u32 {
        self.desk.panic(offset)
    }
    fn rename_boot(&mut self, seed: u32) -> u32 {
        self.desk.rename_boot(seed)
    }
}

thread_local! {
    /// A chip that was never written: to erase megabytes for every input would take most of the
    /// time.
    static BLANK: RefCell<Option<Shared>> = const { RefCell::new(None) };
    static CARD: Card = Card::named("mill6").expect("a committed board");
}

/// A board after power-up, with a new flash.
pub fn start() -> Machine<Watched> {
    let blank = BLANK.take().filter(|flash| {
        let chip = flash.chip();
        chip.programs() == 0 && chip.steps() == 0
    });
    let flash = blank.unwrap_or_else(|| {
        let part = Part::W25Q16JV.with(Times::QUICK);
        Shared::new(Nor::new(part, 0xd162_0c8a_1b2c_3d4e))
    });
    BLANK.set(Some(flash.clone()));
    let setup = Setup {
        flash,
        ..Setup::new(CARD.with(Card::clone), Plant::direct(3))
    };
    let (mut desk, ident) = Desk::power_up(setup);
    let boot = desk.boot();
    let deeds = Deeds::default();
    let mut machine = Machine::start(Watched { desk, deeds }, ident, regmap::ABI, boot);
    machine.board.take();
    machine
}

/// The firmware's register map.
pub fn ident(machine: &Machine<Watched>) -> &Ident {
    machine.server.ident()
}

/// Lets this many clocks pass, with this many runs of the housekeeping.
pub fn pass(machine: &mut Machine<Watched>, clocks: u64, looks: u64) {
    for _ in 0..looks.max(1) {
        let until = machine.board.desk.clock() + clocks / looks.max(1);
        machine.board.desk.pass(until);
        if machine.due(IDLE) {
            machine.chores();
        }
    }
}
