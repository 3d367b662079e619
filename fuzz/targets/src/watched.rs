//! The firmware on the model board, with a recorder of its effects.

use firmware::cores::{Board, Control, Gate, Ident, Led, Link, Setting};
use firmware::log;
use firmware::machine::{Guest, IDLE, Lease, Machine, VISIT_WORDS, Verb, Verdict};
use firmware::net::Us;
use firmware::pass::Pass;
use firmware::services::Network;
use firmware::services::abi::FRAME_MAX;
use jobs::Outside;
use sim::board_facts::BoardFacts;
use sim::model_board::{ModelBoard, Setup, UID};
use sim::nor::spi::Shared;
use sim::nor::{Nor, Part, Times};
use sim::plant::Plant;
use std::cell::RefCell;
use std::thread::LocalKey;
use wire::MAX_WORDS;
use wire::flash::Layout;
use wire::regmap::{self, segments, timebase};
use wire::settings::Settings;

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
    pub model_board: ModelBoard,
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
        self.model_board.spi()
    }
    fn trailer(&mut self) -> [u32; 4] {
        self.model_board.trailer()
    }
    fn factory_pin(&mut self) -> bool {
        self.model_board.factory_pin()
    }
    fn link(&mut self) -> Link {
        self.model_board.link()
    }
    fn now(&mut self) -> u64 {
        self.model_board.now()
    }
    fn now_lo(&mut self) -> u32 {
        self.model_board.now_lo()
    }
    fn arrival_lo(&mut self) -> u32 {
        self.model_board.arrival_lo()
    }
    fn arrival_hi(&mut self) -> u32 {
        self.model_board.arrival_hi()
    }
    fn stage(&mut self, word: usize, value: u32) {
        self.deeds.staged += 1;
        self.model_board.stage(word, value);
    }
    fn staged(&mut self, word: usize) -> u32 {
        self.model_board.staged(word)
    }
    fn latched(&mut self, word: usize) -> u32 {
        self.model_board.latched(word)
    }
    fn commit_at(&mut self, at: u64) {
        // "Never" is not a commit.
        self.deeds.commits += u32::from(at != u64::MAX);
        self.model_board.commit_at(at);
    }
    fn strobe(&mut self, strobes: u32) {
        let commits = strobes & (timebase::STROBE_COMMIT | timebase::STROBE_COMMIT_AT) != 0;
        self.deeds.commits += u32::from(commits);
        self.deeds.samples += u32::from(!commits);
        self.model_board.strobe(strobes);
    }
    fn watchdog_left(&mut self) -> u32 {
        self.model_board.watchdog_left()
    }
    fn feed(&mut self, token: u32) {
        self.deeds.fed += 1;
        self.model_board.feed(token);
    }
    fn hand_out(&mut self, pass: &Pass) {
        self.model_board.hand_out(pass);
    }
    fn revoke(&mut self) -> bool {
        self.model_board.revoke()
    }
    fn executed(&mut self) -> bool {
        self.model_board.executed()
    }
    fn sending(&mut self) -> bool {
        self.model_board.sending()
    }
    fn prepared(&mut self, word: usize) -> u32 {
        self.model_board.prepared(word)
    }
    fn gate(&mut self) -> Gate {
        self.model_board.gate()
    }
    fn last_close(&mut self) -> u32 {
        self.model_board.last_close()
    }
    fn control(&mut self, order: Control) {
        match order {
            Control::Arm => self.deeds.armed += 1,
            Control::SoftStop | Control::Close | Control::Clear => self.deeds.closed += 1,
        }
        self.model_board.control(order);
    }
    fn setting(&mut self, which: Setting) -> u32 {
        self.model_board.setting(which)
    }
    fn set(&mut self, which: Setting, value: u32) {
        self.deeds.written += 1;
        self.model_board.set(which, value);
    }
    fn set_stop_accel(&mut self, stepgen: usize, value: u32) {
        self.model_board.set_stop_accel(stepgen, value);
    }
    fn csr_read(&mut self, address: u32) -> u32 {
        self.model_board.csr_read(address)
    }
    fn csr_write(&mut self, address: u32, value: u32) {
        // At rest the outputs of a job follow the commands again: this is the only write that
        // happens by itself.
        if (address, value) != (OUTPUTS_OF_A_JOB, 0) {
            self.deeds.written += 1;
        }
        self.model_board.csr_write(address, value);
    }
    fn blob(&mut self, word: usize) -> u32 {
        self.model_board.blob(word)
    }
    fn led(&mut self, pattern: Led) {
        self.model_board.led(pattern);
    }
    fn log(&mut self, read: log::Read) -> u32 {
        self.model_board.log(read)
    }
    fn panic(&mut self, offset: u32) -> u32 {
        self.model_board.panic(offset)
    }
    fn rename_boot(&mut self, seed: u32) -> u32 {
        self.model_board.rename_boot(seed)
    }
}

/// A chip that no board has written to. To erase megabytes for every input would take most of the
/// time.
type Fresh = RefCell<Option<Shared>>;

thread_local! {
    static BLANK: Fresh = const { RefCell::new(None) };
    static SET: Fresh = const { RefCell::new(None) };
    static FACTS: BoardFacts = BoardFacts::named("mill6").expect("a committed board");
}

/// A board after power-up, with a new flash.
pub fn start() -> Machine<Watched> {
    start_on(fresh(&BLANK, |_| ()))
}

/// A board after power-up with these settings; the same in every call.
pub fn start_with(settings: &Settings) -> Machine<Watched> {
    start_on(fresh(&SET, |nor| {
        let layout = Layout::of(nor.part().bytes as u32).expect("a known size");
        let words = crate::byte_reader::bytes(&settings.to_words());
        nor.preload(layout.settings_copy(0) as usize, &words);
    }))
}

/// The chip that is kept there, if it is as `prepare` leaves one.
fn fresh(kept: &'static LocalKey<Fresh>, prepare: impl FnOnce(&mut Nor)) -> Shared {
    let untouched = kept.take().filter(|flash| {
        let chip = flash.chip();
        chip.programs() == 0 && chip.steps() == 0
    });
    let flash = untouched.unwrap_or_else(|| {
        let mut nor = Nor::new(Part::W25Q16JV.with(Times::QUICK), UID);
        prepare(&mut nor);
        Shared::new(nor)
    });
    kept.set(Some(flash.clone()));
    flash
}

/// A board with this flash.
pub fn start_on(flash: Shared) -> Machine<Watched> {
    let setup = Setup {
        flash,
        ..Setup::new(FACTS.with(BoardFacts::clone), Plant::direct(3))
    };
    let (mut model_board, ident) = ModelBoard::power_up(setup);
    let boot = model_board.boot();
    let watched = Watched {
        model_board,
        deeds: Deeds::default(),
    };
    let mut machine = Machine::start(watched, ident, regmap::ABI, boot);
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
        let until = machine.board.model_board.clock() + clocks / looks.max(1);
        machine.board.model_board.pass(until);
        if machine.due(IDLE) {
            machine.housekeeping();
        }
    }
}

/// The board as the services see it, and the frames they send.
pub(crate) struct Inside<'a> {
    pub machine: Guest<'a, Watched>,
    pub sent: Vec<Vec<u8>>,
}

impl Outside for Inside<'_> {
    fn datagram(&mut self, request: &[u32], reply: &mut [u32; MAX_WORDS]) -> usize {
        let answer = self.machine.inside(request, reply);
        answer.map_or(0, <[u32]>::len)
    }
    fn read_segments(&mut self, word: usize) -> u32 {
        self.machine.read_segments(word)
    }
    fn write_segments(&mut self, word: usize, value: u32) {
        self.machine.write_segments(word, value);
    }
    fn now(&mut self) -> u64 {
        self.machine.now()
    }
}

impl Network for Inside<'_> {
    fn send_frame(&mut self, frame: &[u8]) {
        assert!(frame.len() <= FRAME_MAX, "{} bytes", frame.len());
        self.sent.push(frame.to_vec());
    }
    fn us(&mut self) -> Us {
        self.machine.us
    }
    fn moving(&mut self) -> bool {
        let owned = self.machine.session().owner().is_some();
        owned && !self.machine.at_rest()
    }
    fn leased(&mut self, lease: Option<Lease>) {
        self.machine.leased(lease);
    }
    fn console(&mut self, visitor: usize, verb: Verb, words: &mut [u32; VISIT_WORDS]) -> Verdict {
        self.machine.visit(visitor, verb, words)
    }
}
