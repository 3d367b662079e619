//! All cores of one board, connected to the register map as in `gateware/ferrocnc/banks.py`.
//!
//! Time passes in one of two ways, with the same bits. [`Board::clock`] makes one rising edge of
//! everything, with the register bus as it stands before it. [`Board::run`] goes from event to
//! event: every channel knows until when it is quiet, and is left alone until then. What all
//! channels share (gate, stop, probe, strobes) changes seldom; when it does, one edge of everything
//! is made.

mod channels;
mod edge;
mod events;
mod frames;
mod registers;

use super::fast_path::FastPath;
use super::rx_admission::{RxAdmission, Word};
use super::segments::{Segments, Told};
use super::timebase::Timebase;
use crate::pads;
use crate::soc::Pins;
use channels::{EncoderChannel, Hub, PwmChannel, StepgenChannel};
use frames::Transmitter;
use registers::Regs;
use wire::describe::Channels;
use wire::regmap;

/// Pages of the map.
pub mod pages {
    pub use wire::regmap::command::PAGE as COMMAND;
    pub use wire::regmap::debounce::PAGE as DEBOUNCE;
    pub use wire::regmap::encoder::PAGE as ENCODER;
    pub use wire::regmap::fast_path::PAGE as FAST_PATH;
    pub use wire::regmap::gpio::PAGE as GPIO;
    pub use wire::regmap::gpio_high::PAGE as GPIO_HIGH;
    pub use wire::regmap::ident::PAGE as IDENT;
    pub use wire::regmap::led::PAGE as LED;
    pub use wire::regmap::pads::PAGE as PADS;
    pub use wire::regmap::pwm::PAGE as PWM;
    pub use wire::regmap::rx_admission::PAGE as RX_ADMISSION;
    pub use wire::regmap::segments::PAGE as SEGMENTS;
    pub use wire::regmap::status::PAGE as STATUS;
    pub use wire::regmap::stepgen::PAGE as STEPGEN;
    pub use wire::regmap::timebase::PAGE as TIMEBASE;
    pub use wire::regmap::watchdog::PAGE as WATCHDOG;
}

const CHANNELS: usize = regmap::STEPGEN_MAX;

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
    pub frame_done: Option<u8>,
    /// The frame in this slot is presented.
    pub frame_pending: Option<u8>,
    /// The PHY's clock has made another beat.
    pub beat: bool,
    /// A word of a frame on its way into a slot.
    pub word: Option<Word>,
}

/// What all channels see alike.
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

/// What happens to all channels in one clock.
#[derive(Clone, Copy, Debug, Default)]
struct Strobes {
    commit: bool,
    sample: bool,
    now: u64,
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
    admission: RxAdmission,
    fast_path: FastPath,
    /// The way into the answer's slot, and the slot.
    line: Transmitter,
    answer: Vec<u32>,
    /// The word that the fast path read a clock ago.
    gathered: u32,
    steps: Vec<StepgenChannel>,
    encoders: Vec<EncoderChannel>,
    pwms: Vec<PwmChannel>,
    /// A bus write on its way to the registers.
    write: Option<(u32, u32)>,
    now_caught: u64,
    /// Beats of the PHY's clock, and as they were then.
    beats: u32,
    beats_caught: u32,
    slot_time: [u64; regmap::ETHMAC_RX_SLOTS],
    arrival: u64,
    sample: u64,
    gpio_caught: [u32; 2],
    estop_caught: u32,
    left_caught: u32,
    flags_caught: [u32; 3],
    out: Pins,
    /// The same at the pads, and their registers since which clock: now, before, and before that.
    at_pads: Pins,
    seen: [(u64, [u32; 5]); 3],
}

fn bit(word: u32, n: usize) -> bool {
    word >> n & 1 != 0
}

fn put(word: &mut u16, n: usize, on: bool) {
    *word = *word & !(1 << n) | u16::from(on) << n;
}

impl Board {
    /// A board with its wall clock at `clock`: as after so many clocks in which nothing happened.
    pub fn at(build: Build, clock: u64) -> Self {
        let mut board = Self::new(build);
        board.clock = clock;
        board.hub.at = clock;
        board.segments_at = clock;
        board.hub.timebase = Timebase::at(clock);
        for channel in &mut board.steps {
            channel.at = clock;
        }
        for channel in &mut board.encoders {
            channel.at = clock;
        }
        for channel in &mut board.pwms {
            channel.at = clock;
        }
        board.next.fill(clock + 1);
        board.full = clock + 1;
        board
    }

    /// As if a stepgen had emitted, and an encoder counted, this much. For counters that are to
    /// pass their ends.
    pub fn preset(&mut self, n: usize, pulses: i32, count: i32) {
        if let Some(channel) = self.steps.get_mut(n) {
            channel.core.preset(pulses);
        }
        if let Some(channel) = self.encoders.get_mut(n) {
            channel.core.preset(count);
        }
    }

    /// A board as it powers up.
    pub fn new(build: Build) -> Self {
        let c = build.channels;
        // Wires, not registers: they are there before the first clock.
        let copies = pads::registers(&Pins {
            step_n: ((1u32 << c.stepgens) - 1) as u16,
            dir_n: ((1u32 << c.stepgens) - 1) as u16,
            ..Pins::default()
        });
        let channels = usize::from(c.stepgens) + usize::from(c.encoders) + usize::from(c.pwms);
        Board {
            clock: 0,
            next: vec![1; 1 + channels],
            full: 1,
            common: Common::default(),
            regs: Regs::new(build.jobs.into()),
            hub: Hub::new(&build),
            segments: (build.jobs != 0).then(|| Segments::new(build.jobs.into())),
            segments_at: 0,
            admission: RxAdmission::default(),
            fast_path: FastPath::default(),
            line: Transmitter::Until(0),
            answer: vec![0; frames::SLOT],
            gathered: 0,
            steps: vec![StepgenChannel::default(); c.stepgens.into()],
            encoders: vec![EncoderChannel::default(); c.encoders.into()],
            pwms: vec![PwmChannel::default(); c.pwms.into()],
            write: None,
            now_caught: 0,
            beats: 0,
            beats_caught: 0,
            slot_time: [0; regmap::ETHMAC_RX_SLOTS],
            arrival: 0,
            sample: 0,
            gpio_caught: [0; 2],
            estop_caught: 0,
            left_caught: 0,
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
            for (n, channel) in self.encoders.iter_mut().enumerate() {
                if moved >> n & 1 != 0 {
                    channel.catch_up(self.clock, n, &self.regs);
                    channel.pins = [pins.enc_a, pins.enc_b, pins.enc_i, pins.enc_mask]
                        .map(|w| w >> n & 1 != 0);
                    self.next[1 + self.steps.len() + n] = self.clock + 1;
                }
            }
        }
        if old.step_index != pins.step_index {
            let moved = old.step_index ^ pins.step_index;
            for (n, channel) in self.steps.iter_mut().enumerate() {
                if moved >> n & 1 != 0 {
                    channel.catch_up(self.clock, n, &self.regs, &self.common);
                    channel.pin = pins.step_index >> n & 1 != 0;
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

    fn common_now(&self) -> Common {
        let (reset_pin, estop) = (self.hub.extreset.active(), self.hub.gpio.estop());
        Common {
            gate: self.hub.watchdog.gate(reset_pin, estop),
            stop: self.hub.watchdog.stop(),
            reset_pin,
            estop,
            probe: self.hub.probe,
            all_stopped: self.steps.iter().all(|channel| channel.core.stopped()),
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
        for (n, channel) in self.steps.iter_mut().enumerate() {
            channel.catch_up(to, n, regs, common);
        }
        for (n, channel) in self.encoders.iter_mut().enumerate() {
            channel.catch_up(to, n, regs);
        }
        for (n, channel) in self.pwms.iter_mut().enumerate() {
            if channel.at < to {
                channel
                    .core
                    .skip(to - channel.at, &regs.pwm_input(n, common, false));
                channel.at = to;
            }
        }
    }

    /// One rising edge of everything.
    pub fn clock(&mut self, bus: &Bus) {
        self.edge(bus);
        // The quiet clocks are not yet known: [`Board::run`] begins with an edge of everything.
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
mod tests;
