//! All cores of one board behind the register map, as `gateware/ferrocnc/banks.py` wires them.
//!
//! Time passes in one of two ways, with the same bits. [`Board::clock`] makes one rising edge of
//! everything, with the register bus as it stands before it. [`Board::run`] goes from event to
//! event: every channel is a *lane* that knows until when it is quiet, and is left alone until
//! then. What all lanes share (gate, stop, probe, strobes) changes seldom; when it does, one edge
//! of everything is made.

use wire::describe::Channels;
use wire::exchange::PWM_PERIOD_MAX;
use wire::map::{DIR_CLOCKS_MAX, PROBE_ENABLE, PROBE_INPUT_MASK, PROBE_INVERT, STEP_CLOCKS_MAX};
use wire::regmap::{self, command, status};

use super::encoder::{self, Encoder};
use super::extreset::Extreset;
use super::gpio::{self, Gpio};
use super::latch::{self, Latch};
use super::led::Led;
use super::pwm::{self, Pwm};
use super::segments::{self, Order, Segments, State, Told};
use super::stepgen::{self, Stepgen};
use super::tally::{ROTATION, Tally};
use super::timebase::{self, Timebase};
use super::watchdog::{self, Watchdog};
use crate::pads;
use crate::soc::Pins;

/// Pages of the map.
pub mod pages {
    pub use wire::regmap::command::PAGE as COMMAND;
    pub use wire::regmap::debounce::PAGE as DEBOUNCE;
    pub use wire::regmap::encoder::PAGE as ENCODER;
    pub use wire::regmap::gpio::PAGE as GPIO;
    pub use wire::regmap::ident::PAGE as IDENT;
    pub use wire::regmap::led::PAGE as LED;
    pub use wire::regmap::pads::PAGE as PADS;
    pub use wire::regmap::pwm::PAGE as PWM;
    pub use wire::regmap::segments::PAGE as SEGMENTS;
    pub use wire::regmap::status::PAGE as STATUS;
    pub use wire::regmap::stepgen::PAGE as STEPGEN;
    pub use wire::regmap::timebase::PAGE as TIMEBASE;
    pub use wire::regmap::watchdog::PAGE as WATCHDOG;
}

const CHANNELS: usize = regmap::STEPGEN_MAX;
/// Bits of a word's number in the address of a bus cycle.
const WORD_BITS: u32 = (regmap::CSR_PAGE / 4).trailing_zeros();

/// Page and word of the address of a bus cycle.
fn place(address: u32) -> (u32, usize) {
    (
        address >> WORD_BITS,
        (address & ((1 << WORD_BITS) - 1)) as usize,
    )
}

/// Words of the command page from which on the stepgens' and the PWMs' are.
const STEPGENS: usize = command::STEPGEN0_VELOCITY;
const PWMS: usize = command::PWM0_WIDTH;
const PROBE: u32 = PROBE_INPUT_MASK | PROBE_ENABLE | PROBE_INVERT;
const STEPGEN_MODE: u32 = regmap::stepgen::MODE_STEP_INVERT
    | regmap::stepgen::MODE_DIR_INVERT
    | regmap::stepgen::MODE_KIND
    | regmap::stepgen::MODE_INDEX_INVERT;
const PWM_MODE: u32 = regmap::pwm::MODE_INVERT
    | regmap::pwm::MODE_KIND
    | regmap::pwm::MODE_DITHER
    | regmap::pwm::MODE_SWAP;

/// Which stepgen a word of the command page is for, and which of its words it is: 0 velocity, 1
/// acceleration.
fn stepgen_word(word: usize) -> (usize, usize) {
    let at = word - STEPGENS;
    (at / command::STEPGEN_STRIDE, at % command::STEPGEN_STRIDE)
}

/// What a board is built with.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Build {
    /// How many of each.
    pub channels: Channels,
    /// Hertz.
    pub clock_hz: u32,
    /// Inputs that stop the machine.
    pub estop_mask: u32,
    /// The level at which they do.
    pub estop_level: u32,
    /// ABI number.
    pub abi: u32,
    /// Gateware version.
    pub version: u32,
    /// Words of the board information ROM.
    pub rom_words: u32,
    /// Axes of a job; 0: no segments.
    pub jobs: u8,
    /// It reads its pads back and counts the PHY's clock. Gateware from before that does not.
    pub readback: bool,
}

/// The register bus and the MAC's signals before an edge.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Bus {
    /// A write: word address and data.
    pub write: Option<(u32, u32)>,
    /// System reset.
    pub rst: bool,
    /// A frame is complete in this slot.
    pub frame_done: Option<bool>,
    /// The frame in this slot is presented.
    pub frame_pending: Option<bool>,
    /// The PHY's clock has made another beat.
    pub beat: bool,
}

/// What all lanes see alike.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Common {
    gate: bool,
    stop: bool,
    reset_pin: bool,
    estop: bool,
    probe: bool,
    all_stopped: bool,
    job: Told,
}

/// What happens to all lanes in one clock.
#[derive(Clone, Copy, Debug, Default)]
struct Strobes {
    commit: bool,
    sample: bool,
    now: u64,
}

/// Registers that only hold the value that was written.
#[derive(Clone, Debug)]
struct Regs {
    timeout: u32,
    grace: u32,
    commit_at: [u32; 2],
    safe: u32,
    invert: u32,
    probe: u32,
    led: u32,
    enables: u32,
    outputs: u32,
    arms: u32,
    probe_arms: u32,
    /// The three words of bits as committed.
    enables_now: u32,
    arms_now: u32,
    probe_arms_now: u32,
    /// As the bus wrote them, and as they are.
    velocity: [u32; CHANNELS],
    accel: [u32; CHANNELS],
    staged: [[u32; 2]; CHANNELS],
    pwm: [u32; CHANNELS],
    stepgen: [stepgen::Settings; CHANNELS],
    encoder: [[u32; 2]; CHANNELS],
    pwm_set: [[u32; 2]; CHANNELS],
    debounce: [u16; regmap::IN_MAX],
    jobs: usize,
    pace: u32,
    slew: u32,
    beam: u16,
    mask: u32,
    /// The outputs of the segments.
    aux: u32,
}

#[derive(Clone, Debug, Default)]
struct StepLane {
    at: u64,
    core: Stepgen,
    latch: Latch,
    tally: Tally,
    pin: bool,
    meta: bool,
    index: bool,
    waited: bool,
    /// Fraction and velocity as the strobe has caught them; as read; and the clock in which the one
    /// becomes the other: the channels hand them on to LUT RAM, one a clock.
    caught: [u32; 2],
    sampled: [u32; 2],
    handed_on: Option<u64>,
}

#[derive(Clone, Debug, Default)]
struct EncoderLane {
    at: u64,
    core: Encoder,
    latch: Latch,
    tally: Tally,
    edge: Tally,
    pins: [bool; 4],
    waited: bool,
}

#[derive(Clone, Debug, Default)]
struct PwmLane {
    at: u64,
    core: Pwm,
}

#[derive(Clone, Debug)]
struct Hub {
    at: u64,
    extreset: Extreset,
    watchdog: Watchdog,
    timebase: Timebase,
    gpio: Gpio,
    led: Led,
    probe: bool,
    inputs: u32,
    reset: bool,
}

/// A board's cores and banks.
#[derive(Clone, Debug)]
pub struct Board {
    build: Build,
    clock: u64,
    /// The next edge to be made explicitly: the hub, then stepgens, encoders, PWMs.
    next: Vec<u64>,
    /// The next edge to be made of everything.
    full: u64,
    common: Common,
    regs: Regs,
    hub: Hub,
    segments: Option<Segments>,
    segments_at: u64,
    steps: Vec<StepLane>,
    encoders: Vec<EncoderLane>,
    pwms: Vec<PwmLane>,
    /// A bus write on its way to the registers.
    write: Option<(u32, u32)>,
    now_caught: u64,
    /// Beats of the PHY's clock, and as they were then.
    beats: u32,
    beats_caught: u32,
    slot_time: [u64; 2],
    arrival: u64,
    sample: u64,
    gpio_caught: u32,
    estop_caught: u32,
    flags_caught: [u32; 3],
    out: Pins,
    /// The same at the pads, and their registers since which clock: now, before, and before that.
    at_pads: Pins,
    seen: [(u64, [u32; 4]); 3],
}

fn bit(word: u32, n: usize) -> bool {
    word >> n & 1 != 0
}

fn put(word: &mut u16, n: usize, on: bool) {
    *word = *word & !(1 << n) | u16::from(on) << n;
}

impl Regs {
    fn stepgen_input(&self, n: usize, common: &Common, commit: bool) -> stepgen::Input {
        // -2^31 has no positive twin.
        let [velocity, accel] = self.staged[n];
        let velocity = velocity | u32::from(velocity == 0x8000_0000);
        let job = if n < self.jobs {
            common.job
        } else {
            Told::default()
        };
        stepgen::Input {
            gate: common.gate,
            stop: common.stop || job.stop,
            commit: if job.busy { job.commit } else { commit },
            enable: bit(self.enables, n) || job.busy,
            velocity: velocity as i32,
            accel,
            still: job.still,
            set: self.stepgen[n],
        }
    }

    fn stepgen_latch(&self, n: usize, index: bool, pending: bool, common: &Common) -> latch::Input {
        latch::Input {
            pending,
            arm_index: bit(self.arms_now, n),
            arm_probe: bit(self.probe_arms_now, n),
            index,
            probe: common.probe,
        }
    }

    fn encoder_latch(&self, n: usize, index: bool, pending: bool, common: &Common) -> latch::Input {
        latch::Input {
            pending,
            arm_index: bit(self.enables_now, 16 + n),
            arm_probe: bit(self.arms_now, 16 + n),
            index,
            probe: common.probe,
        }
    }

    fn pwm_input(&self, n: usize, common: &Common, commit: bool) -> pwm::Input {
        pwm::Input {
            gate: common.gate,
            commit,
            command: self.pwm[n],
            period: self.pwm_set[n][0],
            mode: self.pwm_set[n][1],
        }
    }

    fn commit_at(&self) -> u64 {
        u64::from(self.commit_at[1]) << 32 | u64::from(self.commit_at[0])
    }
}

impl StepLane {
    fn clock(&mut self, n: usize, regs: &Regs, common: &Common, s: &Strobes) {
        let input = regs.stepgen_input(n, common, s.commit);
        let latch = regs.stepgen_latch(n, self.index, self.tally.pending(), common);
        let capture = self.latch.capture(&latch);
        let visit = self.at % ROTATION == n as u64;
        let count = self.core.pulses() as u32;
        self.tally.clock(visit, s.sample, capture, count);
        if self.handed_on == Some(self.at) {
            self.sampled = self.caught;
            self.handed_on = None;
        }
        if s.sample {
            self.caught = [self.core.fraction(), self.core.velocity() as u32];
            self.handed_on = Some(self.at + 1 + n as u64);
        }
        self.waited = self.core.waits(&input) || (self.waited && !s.sample);
        self.core.clock(&input);
        self.latch.clock(&latch);
        self.index = self.meta != (input.set.mode & wire::map::STEPGEN_INDEX_INVERT != 0);
        self.meta = self.pin;
        self.at += 1;
    }

    fn quiet(&self, n: usize, regs: &Regs, common: &Common) -> u64 {
        let input = regs.stepgen_input(n, common, false);
        let index = self.pin != (input.set.mode & wire::map::STEPGEN_INDEX_INVERT != 0);
        let rest = self.meta == self.pin
            && self.index == index
            && self.tally.quiet()
            && self.handed_on.is_none()
            && self
                .latch
                .quiet(&regs.stepgen_latch(n, index, false, common));
        if rest { self.core.quiet(&input) } else { 0 }
    }

    fn catch_up(&mut self, to: u64, n: usize, regs: &Regs, common: &Common) {
        if self.at < to {
            let input = regs.stepgen_input(n, common, false);
            self.core.skip(to - self.at, &input);
            self.at = to;
        }
    }
}

impl EncoderLane {
    fn input(&self, n: usize, regs: &Regs, now: u64) -> encoder::Input {
        encoder::Input {
            pins: self.pins,
            mode: regs.encoder[n][0],
            filter: regs.encoder[n][1] as u8,
            now: now as u32,
            clear: false,
            visit: self.at % ROTATION == n as u64,
        }
    }

    fn clock(&mut self, n: usize, regs: &Regs, common: &Common, s: &Strobes) {
        let mut input = self.input(n, regs, s.now);
        let latch = regs.encoder_latch(n, self.core.index_level(), self.tally.pending(), common);
        let capture = self.latch.capture(&latch);
        let clears = input.mode & wire::map::ENCODER_CLEAR_ON_INDEX != 0;
        // A probe latches and clears nothing.
        input.clear = capture && clears && self.latch.index_rises(&latch);
        let turn = input.visit;
        self.tally
            .clock(turn, s.sample, capture, self.core.count() as u32);
        self.edge.clock(turn, s.sample, false, self.core.edge());
        let out = self.core.clock(&input);
        self.waited = out.illegal || (self.waited && !s.sample);
        self.latch.clock(&latch);
        self.at += 1;
    }

    fn quiet(&self, n: usize, regs: &Regs, common: &Common) -> u64 {
        let input = self.input(n, regs, 0);
        let latch = regs.encoder_latch(n, self.core.index_level(), false, common);
        let rest = self.tally.quiet() && self.edge.quiet() && self.latch.quiet(&latch);
        if rest { self.core.quiet(&input) } else { 0 }
    }

    fn catch_up(&mut self, to: u64, n: usize, regs: &Regs) {
        if self.at < to {
            self.core.skip(to - self.at, regs.encoder[n][1] as u8);
            self.at = to;
        }
    }
}

impl Hub {
    fn gpio_input(&self, regs: &Regs, common: &Common) -> gpio::Input {
        gpio::Input {
            gate: common.gate,
            commit: false,
            value: regs.outputs,
            safe: regs.safe,
            invert: regs.invert,
            pins: self.inputs,
            limit: None,
            clear: false,
            job_mask: regs.mask,
            job_value: regs.aux,
        }
    }

    fn next_probe(&self, regs: &Regs) -> bool {
        regs.probe & PROBE_ENABLE != 0
            && bit(self.gpio.raw(), (regs.probe & PROBE_INPUT_MASK) as usize)
                != (regs.probe & PROBE_INVERT != 0)
    }

    fn quiet(&self, regs: &Regs, common: &Common) -> u64 {
        if self.probe != self.next_probe(regs) {
            return 0;
        }
        self.extreset
            .quiet(self.reset)
            .min(self.watchdog.quiet())
            .min(self.timebase.quiet(regs.commit_at()))
            .min(self.gpio.quiet(&self.gpio_input(regs, common)))
            .min(self.led.quiet(regs.led))
    }

    fn catch_up(&mut self, to: u64, regs: &Regs) {
        let clocks = to - self.at;
        if clocks != 0 {
            self.watchdog.skip(clocks);
            self.timebase.skip(clocks, regs.commit_at());
            self.gpio.skip(clocks);
            self.led.skip(clocks);
            self.at = to;
        }
    }
}

impl Board {
    /// A board with its wall clock at `clock`: as after so many clocks in which nothing happened.
    pub fn at(build: Build, clock: u64) -> Self {
        let mut board = Self::new(build);
        board.clock = clock;
        board.hub.at = clock;
        board.segments_at = clock;
        board.hub.timebase = Timebase::at(clock);
        for lane in &mut board.steps {
            lane.at = clock;
        }
        for lane in &mut board.encoders {
            lane.at = clock;
        }
        for lane in &mut board.pwms {
            lane.at = clock;
        }
        board.next.fill(clock + 1);
        board.full = clock + 1;
        board
    }

    /// As if a stepgen had emitted, and an encoder counted, this much. For counters that are to
    /// pass their ends.
    pub fn preset(&mut self, n: usize, pulses: i32, count: i32) {
        if let Some(lane) = self.steps.get_mut(n) {
            lane.core.preset(pulses);
        }
        if let Some(lane) = self.encoders.get_mut(n) {
            lane.core.preset(count);
        }
    }

    /// A board as it powers up.
    pub fn new(build: Build) -> Self {
        let c = build.channels;
        let gpio = Gpio::new(
            c.inputs.into(),
            c.outputs.into(),
            build.estop_mask,
            build.estop_level,
        );
        let hub = Hub {
            at: 0,
            extreset: Extreset::default(),
            watchdog: Watchdog::default(),
            timebase: Timebase::default(),
            gpio,
            led: Led::new(u32::BITS - build.clock_hz.leading_zeros()),
            probe: false,
            inputs: 0,
            reset: false,
        };
        // Wires, not registers: they are there before the first clock.
        let copies = pads::registers(&Pins {
            step_n: ((1u32 << c.stepgens) - 1) as u16,
            dir_n: ((1u32 << c.stepgens) - 1) as u16,
            ..Pins::default()
        });
        let lanes = usize::from(c.stepgens) + usize::from(c.encoders) + usize::from(c.pwms);
        Board {
            clock: 0,
            next: vec![1; 1 + lanes],
            full: 1,
            common: Common::default(),
            regs: Regs {
                timeout: 0,
                grace: 0,
                commit_at: [0; 2],
                safe: 0,
                invert: 0,
                probe: 0,
                led: 0,
                enables: 0,
                outputs: 0,
                arms: 0,
                probe_arms: 0,
                enables_now: 0,
                arms_now: 0,
                probe_arms_now: 0,
                velocity: [0; CHANNELS],
                accel: [0; CHANNELS],
                staged: [[0; 2]; CHANNELS],
                pwm: [0; CHANNELS],
                stepgen: Default::default(),
                encoder: [[0; 2]; CHANNELS],
                pwm_set: [[0; 2]; CHANNELS],
                debounce: [0; 32],
                jobs: build.jobs.into(),
                pace: segments::PACE_ONE,
                slew: 0,
                beam: 0,
                mask: 0,
                aux: 0,
            },
            hub,
            segments: (build.jobs != 0).then(|| Segments::new(build.jobs.into())),
            segments_at: 0,
            steps: vec![StepLane::default(); c.stepgens.into()],
            encoders: vec![EncoderLane::default(); c.encoders.into()],
            pwms: vec![PwmLane::default(); c.pwms.into()],
            write: None,
            now_caught: 0,
            beats: 0,
            beats_caught: 0,
            slot_time: [0; 2],
            arrival: 0,
            sample: 0,
            gpio_caught: 0,
            estop_caught: 0,
            flags_caught: [0; 3],
            out: Pins::default(),
            at_pads: Pins::default(),
            seen: [(0, copies); 3],
            build,
        }
    }

    /// What it was built with.
    pub fn build(&self) -> &Build {
        &self.build
    }

    /// Edges since power-up.
    pub fn clocks(&self) -> u64 {
        self.clock
    }

    /// The wall clock.
    pub fn now(&self) -> u64 {
        // It counts edges; a skipped one too.
        self.clock
    }

    /// The output pins, at their pads.
    pub fn pins(&self) -> &Pins {
        &self.at_pads
    }

    /// What drives them.
    pub fn driven(&self) -> &Pins {
        &self.out
    }

    /// Puts levels on the input pins, before the next edge.
    pub fn drive(&mut self, pins: &Pins) {
        let reset = pins.ext_reset != 0;
        if (self.hub.inputs, self.hub.reset) != (pins.gpio_in, reset) {
            self.hub.catch_up(self.clock, &self.regs);
            self.hub.inputs = pins.gpio_in;
            self.hub.reset = reset;
            self.next[0] = self.clock + 1;
        }
        let old = &self.out;
        if (old.enc_a, old.enc_b, old.enc_i, old.enc_mask)
            != (pins.enc_a, pins.enc_b, pins.enc_i, pins.enc_mask)
        {
            let moved = (old.enc_a ^ pins.enc_a)
                | (old.enc_b ^ pins.enc_b)
                | (old.enc_i ^ pins.enc_i)
                | (old.enc_mask ^ pins.enc_mask);
            for (n, lane) in self.encoders.iter_mut().enumerate() {
                if moved >> n & 1 != 0 {
                    lane.catch_up(self.clock, n, &self.regs);
                    lane.pins = [pins.enc_a, pins.enc_b, pins.enc_i, pins.enc_mask]
                        .map(|w| w >> n & 1 != 0);
                    self.next[1 + self.steps.len() + n] = self.clock + 1;
                }
            }
        }
        if old.step_index != pins.step_index {
            let moved = old.step_index ^ pins.step_index;
            for (n, lane) in self.steps.iter_mut().enumerate() {
                if moved >> n & 1 != 0 {
                    lane.catch_up(self.clock, n, &self.regs, &self.common);
                    lane.pin = pins.step_index >> n & 1 != 0;
                    self.next[1 + n] = self.clock + 1;
                }
            }
        }
        self.out.gpio_in = pins.gpio_in;
        self.out.enc_a = pins.enc_a;
        self.out.enc_b = pins.enc_b;
        self.out.enc_i = pins.enc_i;
        self.out.enc_mask = pins.enc_mask;
        self.out.step_index = pins.step_index;
        self.out.ext_reset = pins.ext_reset;
        let wrong = (pins.pad_fault, pins.pad_at, pins.pad_to);
        if (self.out.pad_fault, self.out.pad_at, self.out.pad_to) != wrong {
            (self.out.pad_fault, self.out.pad_at, self.out.pad_to) = wrong;
            self.settle();
        }
    }

    /// The driven pins have changed, or what is wrong with their pads: how those are now, and how
    /// they were.
    fn settle(&mut self) {
        self.at_pads = pads::levels(&self.out);
        let now = (self.clock, pads::registers(&self.at_pads));
        if self.seen[0].0 == now.0 {
            self.seen[0] = now;
        } else if self.seen[0].1 != now.1 {
            self.seen = [now, self.seen[0], self.seen[1]];
        }
    }

    /// What two flip-flops have made of a word of the pads: as it was two clocks ago.
    fn pads(&self, word: usize) -> u32 {
        let Some(then) = self.clock.checked_sub(2) else {
            return 0;
        };
        let known = self.seen.iter().find(|(since, _)| *since <= then);
        let levels = known.unwrap_or(&self.seen[2]).1;
        let c = self.build.channels;
        let mask = |count: u8| ((1u64 << count) - 1) as u32;
        let masks = [c.stepgens, c.stepgens, c.pwms].map(|count| mask(count) * 0x1_0001);
        match word {
            0..3 => levels[word] & masks[word],
            3 => levels[3] & mask(c.outputs),
            _ => 0,
        }
    }

    fn common_now(&self) -> Common {
        let (reset_pin, estop) = (self.hub.extreset.active(), self.hub.gpio.estop());
        Common {
            gate: self.hub.watchdog.gate(reset_pin, estop),
            stop: self.hub.watchdog.stop(),
            reset_pin,
            estop,
            probe: self.hub.probe,
            all_stopped: self.steps.iter().all(|lane| lane.core.stopped()),
            job: Told::default(),
        }
    }

    fn catch_up(&mut self) {
        let (regs, common, to) = (&self.regs, &self.common, self.clock);
        self.hub.catch_up(to, regs);
        if let Some(segments) = &mut self.segments {
            segments.skip(to - self.segments_at);
            self.segments_at = to;
        }
        for (n, lane) in self.steps.iter_mut().enumerate() {
            lane.catch_up(to, n, regs, common);
        }
        for (n, lane) in self.encoders.iter_mut().enumerate() {
            lane.catch_up(to, n, regs);
        }
        for (n, lane) in self.pwms.iter_mut().enumerate() {
            if lane.at < to {
                lane.core
                    .skip(to - lane.at, &regs.pwm_input(n, common, false));
                lane.at = to;
            }
        }
    }

    /// One rising edge of everything.
    pub fn clock(&mut self, bus: &Bus) {
        self.edge(bus);
        // The quiet clocks are not yet known: [`Board::run`] begins with an edge of everything.
        self.full = self.clock + 1;
    }

    fn edge(&mut self, bus: &Bus) {
        self.catch_up();
        self.common = self.common_now();
        let job = self.job_input();
        if let Some(segments) = &self.segments {
            self.common.job = segments.tells(&job);
        }
        let (regs, common) = (&mut self.regs, &self.common);
        let hub = &mut self.hub;
        let now = hub.timebase.now();

        // The write that was on the bus one clock ago.
        let (mut strobe, mut control, mut token, mut limit) = (0, 0, None, None);
        let mut snapshot = false;
        if let Some((address, data)) = self.write {
            match place(address) {
                (pages::TIMEBASE, regmap::timebase::SNAPSHOT) => snapshot = true,
                (pages::TIMEBASE, regmap::timebase::STROBE) => strobe = data,
                (pages::WATCHDOG, regmap::watchdog::TOKEN) => token = Some(data),
                (pages::WATCHDOG, regmap::watchdog::CONTROL) => control = data,
                (pages::DEBOUNCE, word)
                    if word < usize::from(self.build.channels.inputs.max(1)) =>
                {
                    limit = Some((word, data as u16));
                }
                _ => {}
            }
        }
        let timed = strobe & regmap::timebase::STROBE_COMMIT_AT != 0;
        let strobes = Strobes {
            commit: strobe & regmap::timebase::STROBE_COMMIT != 0 || hub.timebase.due(timed),
            sample: strobe & regmap::timebase::STROBE_SAMPLE != 0,
            now,
        };

        // What the sample catches stands before the edge.
        if strobes.sample {
            self.sample = now;
            self.gpio_caught = hub.gpio.level();
            self.estop_caught = hub.gpio.estop_latched();
            let mut flags = [0u32; 3];
            for (n, lane) in self.encoders.iter().enumerate() {
                flags[0] |= u32::from(lane.latch.index_latched()) << n;
                flags[1] |= u32::from(lane.latch.probe_latched()) << (16 + n);
                flags[2] |= u32::from(lane.waited) << (16 + n);
            }
            for (n, lane) in self.steps.iter().enumerate() {
                flags[0] |= u32::from(lane.waited) << (16 + n);
                flags[1] |= u32::from(lane.latch.index_latched()) << n;
                flags[2] |= u32::from(lane.latch.probe_latched()) << n;
            }
            self.flags_caught = flags;
        }
        if snapshot {
            self.now_caught = now;
            self.beats_caught = self.beats;
        }
        self.beats = self.beats.wrapping_add(bus.beat.into());
        if let Some(slot) = bus.frame_pending {
            self.arrival = self.slot_time[usize::from(slot)];
        }
        if let Some(slot) = bus.frame_done {
            self.slot_time[usize::from(slot)] = now;
        }

        // The cores.
        for (n, lane) in self.steps.iter_mut().enumerate() {
            lane.clock(n, regs, common, &strobes);
            lane.waited &= !bus.rst;
            lane.handed_on = lane.handed_on.filter(|_| !bus.rst);
        }
        for (n, lane) in self.encoders.iter_mut().enumerate() {
            lane.clock(n, regs, common, &strobes);
            lane.waited &= !bus.rst;
        }
        for (n, lane) in self.pwms.iter_mut().enumerate() {
            lane.core.clock(&regs.pwm_input(n, common, strobes.commit));
            lane.at += 1;
        }
        let orders = watchdog::Input {
            rst: bus.rst,
            ext_reset: common.reset_pin,
            estop: common.estop,
            token,
            arm: control == regmap::watchdog::CONTROL_KEY_ARM,
            soft_stop: control == regmap::watchdog::CONTROL_KEY_SOFT,
            shut: control == regmap::watchdog::CONTROL_KEY_STOP,
            clear: control == regmap::watchdog::CONTROL_KEY_CLEAR,
            timeout: regs.timeout,
            grace: regs.grace,
            all_stopped: common.all_stopped,
        };
        let mut pins = hub.gpio_input(regs, common);
        pins.commit = strobes.commit;
        pins.limit = limit;
        pins.clear = hub.watchdog.cleared(&orders);
        hub.probe = hub.next_probe(regs) && !bus.rst;
        hub.gpio.clock(&pins);
        hub.watchdog.clock(&orders);
        hub.timebase.clock(timebase::Input {
            rst: bus.rst,
            commit_timed: timed,
            commit_at: regs.commit_at(),
        });
        hub.led.clock(regs.led);
        hub.extreset.clock(hub.reset);
        hub.at += 1;

        // The registers.
        if strobes.commit {
            regs.enables_now = regs.enables;
            regs.arms_now = regs.arms;
            regs.probe_arms_now = regs.probe_arms;
        }
        let told = common.job;
        if let Some(segments) = &mut self.segments {
            segments.clock(&job);
            self.segments_at += 1;
            for (n, staged) in regs.staged.iter_mut().take(regs.jobs).enumerate() {
                match told.stage {
                    Some((at, word)) if told.busy && at / 2 == n => staged[at & 1] = word,
                    _ => {}
                }
                if told.stop {
                    staged[0] = 0;
                }
            }
        }
        let write = self.write.take();
        self.clock += 1;
        if let Some((address, data)) = write {
            let (page, word) = place(address);
            self.store(page, word, data, told);
        }
        self.shine();
        self.write = bus.write.filter(|_| !bus.rst);
        self.show_all();
        self.settle();
    }

    /// What the segments are told in this clock.
    fn job_input(&self) -> segments::Input {
        let (regs, common) = (&self.regs, &self.common);
        let mut input = segments::Input {
            gate: common.gate,
            halt: common.stop,
            pace: regs.pace,
            slew: regs.slew,
            stopped: self
                .steps
                .iter()
                .take(regs.jobs)
                .all(|lane| lane.core.stopped()),
            waits: self
                .steps
                .iter()
                .take(regs.jobs)
                .enumerate()
                .any(|(n, lane)| lane.core.waits(&regs.stepgen_input(n, common, false))),
            ..segments::Input::default()
        };
        if let Some((address, data)) = self.write {
            match place(address) {
                (pages::SEGMENTS, at @ 0..regmap::segments::PUSH) => input.word = Some((at, data)),
                (pages::SEGMENTS, regmap::segments::PUSH) => input.push = true,
                (pages::SEGMENTS, regmap::segments::CONTROL) => {
                    input.order = match data {
                        regmap::segments::CONTROL_COMMAND_START => Some(Order::Start),
                        regmap::segments::CONTROL_COMMAND_QUIT => Some(Order::Quit),
                        regmap::segments::CONTROL_COMMAND_CLEAR => Some(Order::Clear),
                        _ => None,
                    }
                }
                (pages::SEGMENTS, regmap::segments::PACE) => input.pace_we = true,
                _ => {}
            }
        }
        input
    }

    /// The segments' outputs as they are now.
    fn shine(&mut self) {
        if let Some(segments) = &self.segments {
            let aux = u32::from(segments.aux(self.regs.beam));
            self.regs.aux = aux << 16 | aux;
        }
    }

    fn store(&mut self, page: u32, word: usize, data: u32, job: Told) {
        let c = self.build.channels;
        let outputs = 1u32
            .checked_shl(c.outputs.max(1).into())
            .unwrap_or(0)
            .wrapping_sub(1);
        let regs = &mut self.regs;
        let channel = |first: u32, count: u8| {
            (first..first + u32::from(count))
                .contains(&page)
                .then(|| (page - first) as usize)
        };
        match (page, word) {
            (pages::TIMEBASE, regmap::timebase::COMMIT_AT_LO) => regs.commit_at[0] = data,
            (pages::TIMEBASE, regmap::timebase::COMMIT_AT_HI) => regs.commit_at[1] = data,
            (pages::WATCHDOG, regmap::watchdog::TIMEOUT) => regs.timeout = data,
            (pages::WATCHDOG, regmap::watchdog::GRACE) => regs.grace = data,
            (pages::GPIO, regmap::gpio::SAFE) => regs.safe = data & outputs,
            (pages::GPIO, regmap::gpio::INVERT_OUT) => regs.invert = data & outputs,
            (pages::GPIO, regmap::gpio::PROBE) => regs.probe = data & PROBE,
            (pages::LED, regmap::led::PATTERN) => regs.led = data & regmap::led::PATTERN_SELECT,
            (pages::DEBOUNCE, _) if word < usize::from(c.inputs) => {
                regs.debounce[word] = data as u16
            }
            (pages::COMMAND, command::ENABLES) => regs.enables = data,
            (pages::COMMAND, command::GPIO_OUT) => regs.outputs = data & outputs,
            (pages::COMMAND, command::ARMS) => regs.arms = data,
            (pages::COMMAND, command::PROBE_ARMS) => regs.probe_arms = data,
            (pages::COMMAND, STEPGENS..PWMS) if stepgen_word(word).0 < usize::from(c.stepgens) => {
                let (n, accel) = stepgen_word(word);
                let into = if accel == 0 {
                    &mut regs.velocity
                } else {
                    &mut regs.accel
                };
                into[n] = data;
                let kept = n < regs.jobs && (job.busy || (job.stop && accel == 0));
                if !kept {
                    regs.staged[n][accel] = data;
                }
            }
            (pages::SEGMENTS, regmap::segments::PACE) if regs.jobs != 0 => {
                regs.pace = data & regmap::segments::PACE_SCALE
            }
            (pages::SEGMENTS, regmap::segments::SLEW) if regs.jobs != 0 => regs.slew = data,
            (pages::SEGMENTS, regmap::segments::BEAM) if regs.jobs != 0 => regs.beam = data as u16,
            (pages::SEGMENTS, regmap::segments::MASK) if regs.jobs != 0 => {
                regs.mask = data & outputs
            }
            (pages::COMMAND, PWMS..command::WORDS) if word - PWMS < usize::from(c.pwms) => {
                regs.pwm[word - PWMS] = data;
            }
            _ => {
                if let Some(n) = channel(pages::STEPGEN, c.stepgens) {
                    let set = &mut regs.stepgen[n];
                    match word {
                        regmap::stepgen::STEPLEN => set.steplen = data & STEP_CLOCKS_MAX,
                        regmap::stepgen::STEPSPACE => set.stepspace = data & STEP_CLOCKS_MAX,
                        regmap::stepgen::DIRSETUP => set.dirsetup = data & DIR_CLOCKS_MAX,
                        regmap::stepgen::DIRHOLD => set.dirhold = data & DIR_CLOCKS_MAX,
                        regmap::stepgen::STOP_ACCEL => set.stop_accel = data,
                        regmap::stepgen::MODE => set.mode = data & STEPGEN_MODE,
                        _ => {}
                    }
                } else if let Some(n) = channel(pages::ENCODER, c.encoders) {
                    if word < regmap::encoder::WORDS {
                        regs.encoder[n][word] = data & 0xff;
                    }
                } else if let Some(n) = channel(pages::PWM, c.pwms) {
                    match word {
                        regmap::pwm::PERIOD => regs.pwm_set[n][0] = data & PWM_PERIOD_MAX,
                        regmap::pwm::MODE => regs.pwm_set[n][1] = data & PWM_MODE,
                        _ => {}
                    }
                }
            }
        }
    }

    /// What a register reads in this clock.
    pub fn read(&mut self, page: u32, word: u32) -> u32 {
        self.hub.catch_up(self.clock, &self.regs);
        self.peek(page, word)
    }

    /// The same where every edge so far was made by [`Board::clock`].
    pub fn peek(&self, page: u32, word: u32) -> u32 {
        let c = self.build.channels;
        let (regs, hub) = (&self.regs, &self.hub);
        let at = word as usize;
        let channel = |first: u32, count: u8| {
            (first..first + u32::from(count))
                .contains(&page)
                .then(|| (page - first) as usize)
        };
        match (page, at) {
            (pages::IDENT, regmap::ident::MAGIC) => regmap::IDENT_MAGIC,
            (pages::IDENT, regmap::ident::ABI) => self.build.abi,
            (pages::IDENT, regmap::ident::GATEWARE_VERSION) => self.build.version,
            (pages::IDENT, regmap::ident::SYS_CLK_HZ) => self.build.clock_hz,
            (pages::IDENT, regmap::ident::CHANNELS0) => {
                u32::from_le_bytes([c.stepgens, c.encoders, c.pwms, 0])
            }
            (pages::IDENT, regmap::ident::CHANNELS1) => {
                u32::from_le_bytes([c.inputs, c.outputs, 0, 0])
            }
            (pages::IDENT, regmap::ident::FEATURES) => {
                let bit = |there: bool, bit: u32| if there { bit } else { 0 };
                bit(self.build.jobs != 0, regmap::ident::FEATURES_JOBS)
                    | bit(self.build.readback, regmap::ident::FEATURES_READBACK)
            }
            (pages::IDENT, regmap::ident::BOARD_ROM_WORDS) => self.build.rom_words,
            (pages::TIMEBASE, regmap::timebase::NOW_LO) => self.now_caught as u32,
            (pages::TIMEBASE, regmap::timebase::NOW_HI) => (self.now_caught >> 32) as u32,
            (pages::TIMEBASE, regmap::timebase::ARRIVAL_LO) => self.arrival as u32,
            (pages::TIMEBASE, regmap::timebase::ARRIVAL_HI) => (self.arrival >> 32) as u32,
            (pages::TIMEBASE, regmap::timebase::COMMIT_AT_LO) => regs.commit_at[0],
            (pages::TIMEBASE, regmap::timebase::COMMIT_AT_HI) => regs.commit_at[1],
            (pages::TIMEBASE, regmap::timebase::STATUS) => hub.timebase.pending().into(),
            (pages::TIMEBASE, regmap::timebase::ETH_BEATS) if self.build.readback => {
                self.beats_caught
            }
            (pages::PADS, _) if self.build.readback => self.pads(at),
            (pages::WATCHDOG, regmap::watchdog::TIMEOUT) => regs.timeout,
            (pages::WATCHDOG, regmap::watchdog::GRACE) => regs.grace,
            (pages::WATCHDOG, regmap::watchdog::STATUS) => {
                hub.watchdog.status(hub.extreset.active(), hub.gpio.estop())
            }
            (pages::WATCHDOG, regmap::watchdog::REMAINING) => hub.watchdog.remaining(),
            (pages::WATCHDOG, regmap::watchdog::LAST_TOKEN) => hub.watchdog.last_token(),
            (pages::WATCHDOG, regmap::watchdog::BITES) => hub.watchdog.bites(),
            (pages::WATCHDOG, regmap::watchdog::LAST_CLOSE) => hub.watchdog.last_close().into(),
            (pages::GPIO, regmap::gpio::IN_NOW) if c.inputs != 0 => hub.gpio.level(),
            (pages::GPIO, regmap::gpio::SAFE) if c.outputs != 0 => regs.safe,
            (pages::GPIO, regmap::gpio::INVERT_OUT) if c.outputs != 0 => regs.invert,
            (pages::GPIO, regmap::gpio::OUT_NOW) if c.outputs != 0 => hub.gpio.out(),
            (pages::GPIO, regmap::gpio::RAW_NOW) if c.inputs != 0 => hub.gpio.raw(),
            (pages::GPIO, regmap::gpio::ESTOP_MASK) => self.build.estop_mask,
            (pages::GPIO, regmap::gpio::ESTOP_LEVEL) => self.build.estop_level,
            (pages::GPIO, regmap::gpio::PROBE) => regs.probe,
            (pages::LED, regmap::led::PATTERN) => regs.led,
            (pages::DEBOUNCE, 0..regmap::debounce::WORDS) => regs.debounce[at].into(),
            (pages::COMMAND, command::ENABLES) => regs.enables,
            (pages::COMMAND, command::GPIO_OUT) if c.outputs != 0 => regs.outputs,
            (pages::COMMAND, command::ARMS) => regs.arms,
            (pages::COMMAND, command::PROBE_ARMS) => regs.probe_arms,
            (pages::COMMAND, STEPGENS..PWMS) => match stepgen_word(at) {
                (n, 0) => regs.velocity[n],
                (n, _) => regs.accel[n],
            },
            (pages::COMMAND, PWMS..command::WORDS) => regs.pwm[at - PWMS],
            (pages::SEGMENTS, _) => self.job_word(at),
            (pages::STATUS, _) => self.status(at),
            _ => {
                if let Some(n) = channel(pages::STEPGEN, c.stepgens) {
                    let s = &regs.stepgen[n];
                    [
                        s.steplen,
                        s.stepspace,
                        s.dirsetup,
                        s.dirhold,
                        s.stop_accel,
                        s.mode,
                    ]
                    .get(at)
                    .copied()
                    .unwrap_or(0)
                } else if let Some(n) = channel(pages::ENCODER, c.encoders) {
                    regs.encoder[n].get(at).copied().unwrap_or(0)
                } else if let Some(n) = channel(pages::PWM, c.pwms) {
                    regs.pwm_set[n].get(at).copied().unwrap_or(0)
                } else {
                    0
                }
            }
        }
    }

    fn job_word(&self, word: usize) -> u32 {
        let regs = &self.regs;
        self.segments.as_ref().map_or(0, |segments| match word {
            regmap::segments::PACE => regs.pace,
            regmap::segments::SLEW => regs.slew,
            regmap::segments::BEAM => regs.beam.into(),
            regmap::segments::MASK => regs.mask,
            regmap::segments::STATUS => segments.status(),
            regmap::segments::BEGUN => segments.begun(),
            regmap::segments::LEFT => segments.left_after(self.clock - self.segments_at),
            regmap::segments::CURRENT => {
                u32::from(segments.tag()) << regmap::segments::CURRENT_TAG_SHIFT
                    | u32::from(segments.aux(regs.beam))
            }
            regmap::segments::PACE_NOW => segments.pace_now(),
            regmap::segments::SHAPE => {
                (segments.axes() | segments::DEPTH << regmap::segments::SHAPE_SEGMENTS_SHIFT) as u32
            }
            _ => 0,
        })
    }

    /// A word of the status page.
    pub fn status(&self, word: usize) -> u32 {
        let after = |first: usize| word - first;
        match word {
            status::SAMPLE_LO => self.sample as u32,
            status::SAMPLE_HI => (self.sample >> 32) as u32,
            status::GPIO_IN => self.gpio_caught,
            status::FLAGS0 => self.flags_caught[0],
            status::FLAGS1 => self.flags_caught[1],
            status::FLAGS2 => self.flags_caught[2],
            status::ESTOP => self.estop_caught,
            status::STEPGEN0_POSITION_LO..status::ENCODER0_COUNT => {
                let at = after(status::STEPGEN0_POSITION_LO);
                let lane = self.steps.get(at / status::STEPGEN_STRIDE);
                lane.map_or(0, |lane| match at % status::STEPGEN_STRIDE {
                    0 => lane.sampled[0],
                    1 => lane.tally.sampled(),
                    _ => lane.sampled[1],
                })
            }
            status::ENCODER0_COUNT..status::ENCODER0_LATCH => {
                let at = after(status::ENCODER0_COUNT);
                let lane = self.encoders.get(at / status::ENCODER_STRIDE);
                lane.map_or(0, |lane| match at % status::ENCODER_STRIDE {
                    0 => lane.tally.sampled(),
                    _ => lane.edge.sampled(),
                })
            }
            status::ENCODER0_LATCH..status::STEPGEN0_LATCH => {
                let lane = self.encoders.get(after(status::ENCODER0_LATCH));
                lane.map_or(0, |lane| lane.tally.latched())
            }
            status::STEPGEN0_LATCH..status::WORDS => {
                let lane = self.steps.get(after(status::STEPGEN0_LATCH));
                lane.map_or(0, |lane| lane.tally.latched())
            }
            _ => 0,
        }
    }

    fn show_hub(&mut self) {
        self.out.gpio_out = self.hub.gpio.out()
            & if self.build.channels.outputs == 0 {
                0
            } else {
                !0
            };
        self.out.led = self.hub.led.lit().into();
        let (reset, estop) = (self.hub.extreset.active(), self.hub.gpio.estop());
        self.out.gate = self.hub.watchdog.gate(reset, estop).into();
    }

    fn show_step(&mut self, n: usize) {
        let [step, dir] = self.steps[n].core.pins();
        put(&mut self.out.step, n, step);
        put(&mut self.out.dir, n, dir);
        put(&mut self.out.step_n, n, !step);
        put(&mut self.out.dir_n, n, !dir);
    }

    fn show_pwm(&mut self, n: usize) {
        let [out, dir] = self.pwms[n].core.pins();
        put(&mut self.out.pwm_out, n, out);
        put(&mut self.out.pwm_dir, n, dir);
    }

    fn show_all(&mut self) {
        self.show_hub();
        for n in 0..self.steps.len() {
            self.show_step(n);
        }
        for n in 0..self.pwms.len() {
            self.show_pwm(n);
        }
    }

    fn plan(&mut self, at: usize, quiet: u64) {
        self.next[at] = self.clock.saturating_add(1).saturating_add(quiet);
    }

    /// After an edge: does the next one have to be made of everything?
    fn plan_common(&mut self) {
        let mut now = self.common_now();
        let mut plays = u64::MAX;
        if let Some(segments) = &mut self.segments {
            segments.skip(self.clock - self.segments_at);
            self.segments_at = self.clock;
            plays = segments.quiet(self.common.gate, self.regs.pace);
            now.job = segments.steady();
            if plays != 0 {
                self.common.job = now.job;
            }
        }
        let changed = now != self.common;
        self.full = if changed || plays == 0 || self.write.is_some() {
            self.clock + 1
        } else {
            self.clock.saturating_add(1).saturating_add(plays)
        };
    }

    /// The next edge is one of a stepgen that plays segments: if it waits, all lanes are affected.
    fn is_of_a_job(&self, edge: u64) -> bool {
        let lanes = self.next.get(1..=self.regs.jobs).unwrap_or(&[]);
        self.common.job.busy && lanes.contains(&edge)
    }

    fn plan_all(&mut self) {
        self.plan_common();
        if self.full == self.clock + 1 {
            return;
        }
        let timed = self.hub.timebase.quiet(self.regs.commit_at());
        self.plan(0, self.hub.quiet(&self.regs, &self.common));
        if timed == 0 {
            self.full = self.clock + 1;
        }
        for n in 0..self.steps.len() {
            let quiet = self.steps[n].quiet(n, &self.regs, &self.common);
            self.plan(1 + n, quiet);
        }
        let first = 1 + self.steps.len();
        for n in 0..self.encoders.len() {
            let quiet = self.encoders[n].quiet(n, &self.regs, &self.common);
            self.plan(first + n, quiet);
        }
        let first = first + self.encoders.len();
        for n in 0..self.pwms.len() {
            let quiet = self.pwms[n]
                .core
                .quiet(&self.regs.pwm_input(n, &self.common, false));
            self.plan(first + n, quiet);
        }
    }

    /// Runs to the edge `until`, but not past one in which an output pin changed. True when one
    /// did.
    pub fn run(&mut self, until: u64) -> bool {
        while self.clock < until {
            // With an edge of everything to come, the lanes have not been asked when they want
            // theirs.
            let next = if self.full == self.clock + 1 {
                self.full
            } else {
                self.next.iter().fold(self.full, |least, at| least.min(*at))
            };
            if next > until {
                self.clock = until;
                return false;
            }
            self.clock = next - 1;
            let before = self.at_pads;
            if self.full == next || self.is_of_a_job(next) {
                self.edge(&Bus::default());
                self.plan_all();
            } else {
                self.events(next);
            }
            if self.at_pads != before {
                return true;
            }
        }
        false
    }

    /// The edge `edge`, of the lanes that want it.
    fn events(&mut self, edge: u64) {
        let strobes = Strobes {
            now: edge - 1,
            ..Strobes::default()
        };
        // A timed commit affects all lanes.
        if self.next[0] == edge {
            self.hub.catch_up(edge - 1, &self.regs);
            if self.hub.timebase.due(false) {
                self.edge(&Bus::default());
                self.plan_all();
                return;
            }
            self.hub_clock();
        }
        self.clock = edge;
        if self.next[0] == edge {
            self.show_hub();
            self.plan(0, self.hub.quiet(&self.regs, &self.common));
        }
        for n in 0..self.steps.len() {
            if self.next[1 + n] == edge {
                let lane = &mut self.steps[n];
                lane.catch_up(edge - 1, n, &self.regs, &self.common);
                lane.clock(n, &self.regs, &self.common, &strobes);
                let quiet = lane.quiet(n, &self.regs, &self.common);
                self.plan(1 + n, quiet);
                self.show_step(n);
            }
        }
        let first = 1 + self.steps.len();
        for n in 0..self.encoders.len() {
            if self.next[first + n] == edge {
                let lane = &mut self.encoders[n];
                lane.catch_up(edge - 1, n, &self.regs);
                lane.clock(n, &self.regs, &self.common, &strobes);
                let quiet = lane.quiet(n, &self.regs, &self.common);
                self.plan(first + n, quiet);
            }
        }
        let first = first + self.encoders.len();
        for n in 0..self.pwms.len() {
            if self.next[first + n] == edge {
                let input = self.regs.pwm_input(n, &self.common, false);
                let lane = &mut self.pwms[n];
                lane.core.skip(edge - 1 - lane.at, &input);
                lane.core.clock(&input);
                lane.at = edge;
                let quiet = lane.core.quiet(&input);
                self.plan(first + n, quiet);
                self.show_pwm(n);
            }
        }
        self.settle();
        self.plan_common();
    }

    /// One edge of everything but the channels, without a bus write.
    fn hub_clock(&mut self) {
        let (regs, common, hub) = (&self.regs, &self.common, &mut self.hub);
        let pins = hub.gpio_input(regs, common);
        hub.probe = hub.next_probe(regs);
        hub.gpio.clock(&pins);
        hub.watchdog.clock(&watchdog::Input {
            ext_reset: common.reset_pin,
            estop: common.estop,
            timeout: regs.timeout,
            grace: regs.grace,
            all_stopped: common.all_stopped,
            ..watchdog::Input::default()
        });
        hub.timebase.clock(timebase::Input {
            commit_at: regs.commit_at(),
            ..timebase::Input::default()
        });
        hub.led.clock(regs.led);
        hub.extreset.clock(hub.reset);
        hub.at += 1;
    }

    /// Writes a register without the bus and its clocks: the next edge sees it. Pulses (strobes,
    /// keys, tokens) go by [`Board::order`].
    pub fn set(&mut self, page: u32, word: u32, data: u32) {
        if page != pages::COMMAND {
            self.catch_up();
        }
        let job = self
            .segments
            .as_ref()
            .map_or(Told::default(), |segments| Told {
                busy: segments.state() != State::Idle,
                ..Told::default()
            });
        self.store(page, word as usize, data, job);
        self.shine();
        if page == pages::DEBOUNCE {
            self.order(page, word, data);
        } else if page != pages::COMMAND {
            self.full = self.clock + 1;
        }
    }

    /// Puts a write into the pipeline: the next edge obeys it.
    pub fn order(&mut self, page: u32, word: u32, data: u32) {
        self.write = Some((page << WORD_BITS | word, data));
        self.full = self.clock + 1;
    }

    /// As a write to the snapshot register, at once and without the bus: the wall clock and the
    /// PHY's beats of this moment.
    pub fn snapshot(&mut self, beats: u32) {
        (self.now_caught, self.beats, self.beats_caught) = (self.now(), beats, beats);
    }

    /// The frame being dealt with arrived now.
    pub fn arrive(&mut self) {
        self.arrival = self.now();
    }

    /// When it did.
    pub fn arrival(&self) -> u64 {
        self.arrival
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const BUILD: Build = Build {
        channels: Channels {
            stepgens: 3,
            encoders: 2,
            pwms: 2,
            inputs: 4,
            outputs: 4,
        },
        clock_hz: 60_000,
        estop_mask: 8,
        estop_level: 8,
        abi: 1,
        version: 2,
        rom_words: 3,
        jobs: 2,
        readback: true,
    };

    /// Something a host, a firmware or a machine does, and how many clocks go by before it.
    #[derive(Clone, Debug)]
    enum Deed {
        Write(u32, u32, u32),
        Inputs(u32),
        Shaft(usize, u16),
        Marks(u16, u16, u16),
        Reset(bool),
        /// A whole segment.
        Segment([u32; 6]),
    }

    fn word() -> impl Strategy<Value = u32> {
        (any::<u32>(), 0..32u32).prop_map(|(word, shift)| word >> shift)
    }

    fn deed() -> impl Strategy<Value = Deed> {
        let rate = prop_oneof![
            Just(0),
            Just(i32::MAX),
            Just(-i32::MAX),
            -1000..1000,
            -4_000_000..4_000_000,
            -400_000_000..400_000_000
        ];
        let accel = prop_oneof![Just(0), Just(u32::MAX), 1..1000u32, 1..50_000_000u32];
        let time = prop_oneof![Just(0), Just(1), 0..40u32, 0..2000u32];
        let key = prop_oneof![
            6 => Just(regmap::watchdog::CONTROL_KEY_ARM),
            2 => Just(regmap::watchdog::CONTROL_KEY_CLEAR),
            1 => Just(regmap::watchdog::CONTROL_KEY_SOFT),
            1 => Just(regmap::watchdog::CONTROL_KEY_STOP)
        ];
        let command = pages::COMMAND;
        prop_oneof![
            3 => (0..3u32, rate).prop_map(move |(n, v)| Deed::Write(command, 4 + 2 * n, v as u32)),
            2 => (0..3u32, accel.clone()).prop_map(move |(n, a)| Deed::Write(command, 5 + 2 * n, a)),
            2 => (0..2u32, 0..600u32, any::<bool>(), any::<u8>()).prop_map(move |(n, w, dir, part)| {
                Deed::Write(command, 36 + n, w << 8 | u32::from(part) | 1 << 30 | u32::from(dir) << 31)
            }),
            2 => (0..4u32, any::<u32>()).prop_map(move |(w, bits)| Deed::Write(command, w, bits | 7)),
            6 => prop_oneof![Just(1u32), Just(2), Just(3), Just(4), Just(6)]
                .prop_map(|s| Deed::Write(pages::TIMEBASE, 7, s)),
            1 => (0..2u32, 0..3000u32).prop_map(|(w, at)| Deed::Write(pages::TIMEBASE, 6 - w, at * w)),
            2 => key.prop_map(|key| Deed::Write(pages::WATCHDOG, 3, key)),
            3 => word().prop_map(|token| Deed::Write(pages::WATCHDOG, 2, token)),
            1 => (0..2u32, 0..20_000u32).prop_map(|(w, t)| Deed::Write(pages::WATCHDOG, w, t)),
            3 => (0..3u32, 0..4u32, time).prop_map(|(n, w, t)| Deed::Write(pages::STEPGEN + n, w, t)),
            1 => (0..3u32, accel).prop_map(|(n, a)| Deed::Write(pages::STEPGEN + n, 4, a)),
            1 => (0..3u32, 0..32u32).prop_map(|(n, mode)| Deed::Write(pages::STEPGEN + n, 5, mode)),
            1 => (0..2u32, 0..256u32).prop_map(|(n, mode)| Deed::Write(pages::ENCODER + n, 0, mode)),
            1 => (0..2u32, 0..256u32, 0..8u32).prop_map(|(n, f, less)| Deed::Write(pages::ENCODER + n, 1, f >> less)),
            1 => (0..2u32, 0..800u32).prop_map(|(n, period)| Deed::Write(pages::PWM + n, 0, period)),
            1 => (0..2u32, 0..32u32).prop_map(|(n, mode)| Deed::Write(pages::PWM + n, 1, mode)),
            1 => (1..3u32, 0..16u32).prop_map(|(w, bits)| Deed::Write(pages::GPIO, w, bits)),
            1 => (0..4u32, 0..4u32).prop_map(|(n, how)| Deed::Write(pages::GPIO, 7, n | how << 8)),
            1 => (0..4u32, 0..9u32).prop_map(|(n, limit)| Deed::Write(pages::DEBOUNCE, n, limit)),
            1 => (0..8u32).prop_map(|pattern| Deed::Write(pages::LED, 0, pattern)),
            2 => (18..22u32, word()).prop_map(|(w, data)| Deed::Write(pages::SEGMENTS, w, data)),
            1 => Just(Deed::Write(pages::SEGMENTS, 18, 0x1_0000)),
            2 => (1..4u32).prop_map(|order| Deed::Write(pages::SEGMENTS, 17, order)),
            3 => (64..400u32, any::<u32>(), (-400_000_000..400_000_000i32), word(), any::<bool>()).prop_map(|(clocks, aux, v, a, last)| {
                Deed::Segment([clocks, aux, if last { 0 } else { v as u32 }, a, if last { 0 } else { !v as u32 >> 4 }, a >> 3])
            }),
            2 => (0..8u32).prop_map(Deed::Inputs),
            8 => (0..2usize, 0..4u16).prop_map(|(n, phase)| Deed::Shaft(n, phase)),
            2 => (0..4u16, 0..4u16, 0..8u16).prop_map(|(i, m, s)| Deed::Marks(i, m, s)),
            1 => prop_oneof![9 => Just(false), 1 => Just(true)].prop_map(Deed::Reset),
        ]
    }

    fn registers() -> impl Iterator<Item = (u32, u32)> {
        let wide = (8..16).flat_map(|page| (0..120).map(move |word| (page, word)));
        let wide = wide.chain((0..30).map(|word| (pages::SEGMENTS, word)));
        let wide = wide.chain((0..4).map(|word| (pages::PADS, word)));
        wide.chain((16..64).flat_map(|page| (0..6).map(move |word| (page, word))))
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(150))]

        #[test]
        fn from_event_to_event_is_the_same_as_clock_by_clock(
            story in prop::collection::vec((prop_oneof![0..4u64, 0..200u64, 0..3000u64], deed()), 1..100)
        ) {
            let (mut slow, mut fast) = (Board::new(BUILD), Board::new(BUILD));
            let mut pins = Pins::default();
            let mut made = 0;
            for (wait, deed) in &story {
                // Two clocks at least, as the bus has them between two writes.
                let until = slow.clocks() + wait + 2;
                while fast.clocks() < until {
                    let changed = fast.run(until);
                    while slow.clocks() < fast.clocks() {
                        let before = slow.out;
                        let last = slow.clocks() + 1 == fast.clocks();
                        slow.clock(&Bus::default());
                        made += 1;
                        prop_assert!(last || slow.out == before, "clock {}: a change was skipped", slow.clocks());
                    }
                    prop_assert_eq!(&slow.out, &fast.out, "clock {}, changed {}", slow.clocks(), changed);
                }
                match *deed {
                    Deed::Write(page, word, data) => {
                        slow.order(page, word, data);
                        fast.order(page, word, data);
                    }
                    Deed::Inputs(levels) => pins.gpio_in = levels,
                    Deed::Shaft(n, phase) => {
                        put(&mut pins.enc_a, n, phase & 1 != 0);
                        put(&mut pins.enc_b, n, phase & 2 != 0);
                    }
                    Deed::Marks(index, mask, step) => {
                        (pins.enc_i, pins.enc_mask, pins.step_index) = (index, mask, step);
                    }
                    Deed::Reset(on) => pins.ext_reset = on.into(),
                    Deed::Segment(words) => {
                        for (at, data) in (0..).zip(words).chain([(16, 0)]) {
                            for board in [&mut slow, &mut fast] {
                                board.order(pages::SEGMENTS, at, data);
                            }
                            let until = slow.clocks() + 2;
                            while slow.clocks() < until {
                                slow.clock(&Bus::default());
                            }
                            while fast.clocks() < until {
                                fast.run(until);
                            }
                        }
                    }
                }
                slow.drive(&pins);
                fast.drive(&pins);
            }
            for (page, word) in registers() {
                prop_assert_eq!(slow.read(page, word), fast.read(page, word), "page {} word {} after {} clocks", page, word, made);
            }
        }
    }
}
