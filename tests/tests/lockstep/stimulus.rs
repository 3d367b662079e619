//! What is done to the cores and the models alike.

use rand::{Rng, SeedableRng};
use rand_pcg::Pcg32;
use sim::board_facts::BoardFacts;
use sim::model::board::{Bus, pages};
use sim::model::rx_admission::Word;
use sim::pads::Pad;
use sim::soc::Pins;
use sim::stimulus::frames::Owner;
use sim::stimulus::{Chance, Write};
use std::collections::VecDeque;
use wire::describe::Channels;
use wire::regmap::{fast_path, rx_admission, timebase, watchdog};

const ARM: u32 = watchdog::CONTROL_KEY_ARM;
const SOFT: u32 = watchdog::CONTROL_KEY_SOFT;
const STOP: u32 = watchdog::CONTROL_KEY_STOP;
const CLEAR: u32 = watchdog::CONTROL_KEY_CLEAR;

/// A line that walks a quadrature cycle, mostly legally.
#[derive(Clone, Debug, Default)]
struct Shaft {
    phase: u8,
    gap: u32,
    left: u32,
    forward: bool,
    lies: bool,
}

/// What is done to the cores in a clock, and to the models alike.
pub struct Stimulus {
    random: Pcg32,
    channels: Channels,
    estop_mask: u32,
    pub pins: Pins,
    rst: bool,
    /// Bus writes that wait, by page and word.
    writes: VecDeque<Write>,
    /// Registers worth reading.
    registers: Vec<(u32, u32)>,
    shafts: Vec<Shaft>,
    servo: u32,
    servo_every: u32,
    chapter: u32,
    token: u32,
    fed: bool,
    busy: bool,
    reset_left: u32,
    noise: u32,
    /// Clocks between two edges of index and mask pins, on average.
    index_every: u32,
    /// Clocks for which they flap.
    flap: u32,
    owner: Owner,
    /// Words of its frame that are to come, and clocks to the next frame.
    frame: VecDeque<Word>,
    frame_in: u32,
    /// Clocks for which an answer is still being sent.
    pub sending: u32,
}

impl Stimulus {
    pub fn new(seed: u64, facts: &BoardFacts) -> Self {
        let c = facts.channels;
        let mut registers: Vec<(u32, u32)> = Vec::new();
        for (page, words) in [
            (pages::IDENT, 8),
            (pages::TIMEBASE, 14),
            (pages::WATCHDOG, 9),
            (pages::GPIO, 8),
            (pages::LED, 1),
            (pages::DEBOUNCE, 32),
            (pages::COMMAND, 52),
            (pages::STATUS, 128),
            (pages::PADS, 4),
            (pages::RX_ADMISSION, 19),
            (pages::FAST_PATH, 23),
        ] {
            registers.extend((0..words).map(|word| (page, word)));
        }
        for n in 0..16 {
            registers.extend((0..6).map(|word| (pages::STEPGEN + n, word)));
            registers.extend((0..2).map(|word| (pages::ENCODER + n, word)));
            registers.extend((0..2).map(|word| (pages::PWM + n, word)));
        }
        Stimulus {
            random: Pcg32::seed_from_u64(seed),
            channels: c,
            estop_mask: facts.estop_mask,
            pins: Pins::default(),
            rst: false,
            writes: VecDeque::new(),
            registers,
            shafts: vec![Shaft::default(); c.encoders.into()],
            servo: 0,
            servo_every: 500,
            chapter: 0,
            token: 0,
            fed: true,
            busy: true,
            reset_left: 0,
            noise: 20_000,
            index_every: 40,
            flap: 0,
            owner: Owner::new(c),
            frame: VecDeque::new(),
            frame_in: 0,
            sending: 0,
        }
    }

    fn write(&mut self, page: u32, word: u32, data: u32) {
        self.writes.push_back((page, word, data));
    }

    /// New settings for everything: a chapter of some ten thousand clocks.
    fn settings(&mut self) {
        let c = self.channels;
        for n in 0..c.stepgens.into() {
            let page = pages::STEPGEN + n;
            let short = |s: &mut Self| match s.random.below(6) {
                0 => 0,
                1 => 1,
                2 => s.random.below(8),
                3 => s.random.below(100),
                4 => s.random.below(600),
                _ => s.random.below(1 << 13),
            };
            let (steplen, stepspace) = (short(self), short(self));
            let (dirsetup, dirhold) = (short(self), short(self));
            self.write(page, 0, steplen);
            self.write(page, 1, stepspace);
            let long = self.random.one_in(12);
            let dirsetup = if long {
                self.random.below(1 << 16)
            } else {
                dirsetup
            };
            self.write(page, 2, dirsetup);
            self.write(page, 3, dirhold);
            let stop = if self.random.one_in(3) {
                0
            } else {
                self.random.spread() | 1 << 24
            };
            self.write(page, 4, stop);
            let mode = self.random.below(32);
            self.write(page, 5, mode);
        }
        for n in 0..c.encoders.into() {
            // Only x4 half of the time: that is what machines use.
            let mode = self.random.below(256) & if self.random.one_in(2) { 0xf8 } else { 0xff };
            let filter = match self.random.below(4) {
                0 => 0,
                1 => self.random.below(4),
                2 => self.random.below(30),
                _ => self.random.below(256),
            };
            self.write(pages::ENCODER + n, 0, mode);
            self.write(pages::ENCODER + n, 1, filter);
            let gap = if self.random.one_in(4) {
                3
            } else {
                3 + self.random.below(40)
            };
            let shaft = &mut self.shafts[n as usize];
            shaft.gap = if filter < 40 { gap + filter } else { gap * 8 };
        }
        for n in 0..c.pwms.into() {
            let period = match self.random.below(5) {
                0 => self.random.below(4),
                1 => 3000,
                2 => self.random.below(20),
                _ => self.random.below(400),
            };
            self.write(pages::PWM + n, 0, period);
            let mode = self.random.below(32);
            self.write(pages::PWM + n, 1, mode);
        }
        for (word, data) in [(1, self.random.spread()), (2, self.random.spread())] {
            self.write(pages::GPIO, word, data);
            let high = self.random.spread();
            self.write(pages::GPIO_HIGH, word, high);
        }
        let probe = self.random.below(u32::from(c.inputs.clamp(1, 32))) | self.random.below(4) << 8;
        self.write(pages::GPIO, 7, probe);
        let led = self.random.below(8);
        self.write(pages::LED, 0, led);
        for n in 0..u32::from(c.inputs) {
            let limit = if self.random.one_in(2) {
                0
            } else {
                self.random.below(40)
            };
            self.write(pages::DEBOUNCE, n, limit);
        }
        let timeout = if self.random.one_in(5) {
            self.random.below(3000)
        } else {
            20_000
        };
        self.write(pages::WATCHDOG, 0, timeout);
        let grace = if self.random.one_in(2) {
            self.random.below(500)
        } else {
            8_000
        };
        self.write(pages::WATCHDOG, 1, grace);
        self.servo_every = 60 + self.random.below(3000);
        self.fed = !self.random.one_in(6);
        self.busy = !self.random.one_in(3);
        self.noise = if self.random.one_in(4) { 3000 } else { 60_000 };
    }

    /// What a host does once per servo period.
    fn servo_period(&mut self) {
        let c = self.channels;
        for n in 0..u32::from(c.stepgens) {
            let velocity = match self.random.below(10) {
                0 => 0,
                1 => 1,
                2 => !0,
                3 => 0x7fff_ffff,
                4 => 0x8000_0000,
                5 | 6 => self.random.spread(),
                7 | 8 => self.random.spread().wrapping_neg(),
                _ => self.random.random(),
            };
            let accel = match self.random.below(6) {
                0 => 0,
                1 => u32::MAX,
                _ => self.random.spread() | 1 << 16,
            };
            self.write(pages::COMMAND, 4 + 2 * n, velocity);
            self.write(pages::COMMAND, 5 + 2 * n, accel);
        }
        for n in 0..u32::from(c.pwms) {
            let width = match self.random.below(6) {
                0 => 0,
                1 => 0x1fff_ffff,
                2 => 3000 << 8,
                3 => self.random.below(1 << 25),
                _ => self.random.below(400 << 8),
            };
            let enable = if self.random.one_in(8) { 0 } else { 1 << 30 };
            let direction = self.random.below(2) << 31;
            self.write(pages::COMMAND, 36 + n, width | enable | direction);
        }
        let mostly = |s: &mut Self| s.random.random::<u32>() | s.random.random::<u32>();
        let enables = mostly(self);
        self.write(pages::COMMAND, 0, enables);
        let outputs = self.random.random();
        self.write(pages::COMMAND, 1, outputs);
        let outputs = self.random.random();
        self.write(pages::COMMAND, 52, outputs);
        let arms = mostly(self);
        self.write(pages::COMMAND, 2, arms);
        let probe_arms = mostly(self);
        self.write(pages::COMMAND, 3, probe_arms);
        self.strobe();
        if self.fed {
            self.token = self.token.wrapping_add(1);
            let token = self.token;
            self.write(pages::WATCHDOG, 2, token);
        }
        let key = match self.random.below(12) {
            0..8 => ARM,
            8 if self.random.one_in(2) => CLEAR,
            9 if self.random.one_in(2) => self.random.random(),
            9 => SOFT,
            10 if self.random.one_in(6) => STOP,
            _ => 0,
        };
        if key == ARM {
            self.write(pages::WATCHDOG, 3, CLEAR);
        }
        self.write(pages::WATCHDOG, 3, key);
        if self.random.one_in(4) {
            self.write(pages::TIMEBASE, 2, 0);
        }
        if self.random.one_in(8) {
            let open = self.random.one_in(2);
            let word = if open {
                timebase::GUARD_KEY_OPEN
            } else {
                self.random.random()
            };
            self.write(pages::TIMEBASE, timebase::GUARD as u32, word);
        }
    }

    /// Arms and strobes as close together as the bus can carry them: what a rotation of the wide
    /// counters has to sort out.
    fn storm(&mut self) {
        for _ in 0..8 {
            let word = [0, 2, 3][self.random.below(3) as usize];
            let arms = if self.random.one_in(2) { 0 } else { !0 };
            // Enables of stepgens stay: a storm is about latches.
            let arms = if word == 0 { arms | 0xffff } else { arms };
            self.write(pages::COMMAND, word, arms);
            let strobes = 1 + self.random.below(3);
            self.write(pages::TIMEBASE, 7, strobes);
        }
        self.index_every = 4 + self.random.below(40);
        self.flap = 40;
    }

    fn strobe(&mut self) {
        let strobes = match self.random.below(8) {
            0 => 1,
            1 => 2,
            2 => self.random.below(8),
            3 => 6,
            _ => 3,
        };
        if strobes & 4 != 0 {
            // Times just past and just to come, and never.
            let now = u64::from(self.chapter_clock());
            let at = match self.random.below(5) {
                0 => u64::MAX,
                1 => 0,
                _ => now + u64::from(self.random.below(400)),
            };
            self.write(pages::TIMEBASE, 6, u32::MAX);
            self.write(pages::TIMEBASE, 5, at as u32);
            self.write(pages::TIMEBASE, 6, (at >> 32) as u32);
        }
        self.write(pages::TIMEBASE, 7, strobes);
    }

    fn chapter_clock(&self) -> u32 {
        self.chapter
    }

    pub fn move_pins(&mut self) {
        for n in 0..self.shafts.len() {
            let bit = 1u16 << n;
            if self.shafts[n].left > 0 {
                self.shafts[n].left -= 1;
                continue;
            }
            if self.random.one_in(50) {
                self.shafts[n].forward = !self.shafts[n].forward;
            }
            let lies = self.shafts[n].lies && self.random.one_in(20);
            if self.random.one_in(400) {
                self.shafts[n].lies = !self.shafts[n].lies;
            }
            let gap = self.shafts[n].gap;
            let jitter = if self.random.one_in(4) {
                self.random.below(3 * gap + 1)
            } else {
                0
            };
            let shaft = &mut self.shafts[n];
            let by = if lies {
                2
            } else if shaft.forward {
                1
            } else {
                3
            };
            shaft.phase = (shaft.phase + by) & 3;
            shaft.left = (gap.max(1) - 1) + jitter;
            let put = |word: &mut u16, on: bool| *word = *word & !bit | if on { bit } else { 0 };
            put(&mut self.pins.enc_a, shaft.phase == 1 || shaft.phase == 2);
            put(&mut self.pins.enc_b, shaft.phase >= 2);
        }
        if self.flap > 0 {
            self.flap -= 1;
            self.pins.enc_i ^= self.random.random::<u16>() & self.random.random::<u16>();
            self.pins.step_index ^= self.random.random::<u16>() & self.random.random::<u16>();
        }
        if self.random.one_in(self.index_every) {
            let n = self.random.below(16);
            match self.random.below(4) {
                0 | 1 => self.pins.enc_i ^= 1 << n,
                2 => self.pins.enc_mask ^= 1 << n,
                _ => self.pins.step_index ^= 1 << n,
            }
        }
        // Glitches of a clock or two.
        if self.random.one_in(500) {
            let n = self.random.below(16);
            self.pins.enc_a ^= 1 << n;
        }
        if self.random.one_in(150) {
            let n = self.random.below(self.channels.inputs.into());
            // E-stop inputs seldom, or the gate never stays open.
            let stops = u64::from(self.estop_mask) >> n & 1 != 0;
            if !stops || self.random.one_in(self.noise / 100) || self.pins.gpio_in >> n & 1 != 0 {
                self.pins.gpio_in ^= 1 << n;
            }
        }
        if self.reset_left > 0 {
            self.reset_left -= 1;
            if self.reset_left == 0 {
                self.pins.ext_reset = 0;
            }
        } else if self.random.one_in(self.noise * 3) {
            self.pins.ext_reset = 1;
            self.reset_left = 1 + self.random.below(20);
        }
        // A short that comes and goes. It is seen, and what drives the pins does not know of it.
        if self.random.one_in(3000) {
            self.pins.pad_fault = self.random.below(4) as u8;
            (self.pins.pad_at, self.pins.pad_to) = (self.pad(), self.pad());
        }
        self.rst = self.random.one_in(self.noise * 5);
    }

    /// The owner's next frame, and what firmware writes in front of it.
    fn next_frame(&mut self, gate: u32) {
        if self.random.one_in(40) || self.chapter < 1000 {
            let mode = self.random.below(4);
            self.writes.extend(self.owner.prepare(mode));
        }
        let pass = !self.random.one_in(8);
        if pass {
            let writes = self.owner.hand_out(&mut self.random, gate);
            self.writes.extend(writes);
        }
        let at = match self.random.below(5) {
            0 => u64::MAX,
            1 => 0,
            _ => u64::from(self.chapter_clock() + self.random.below(600)),
        };
        self.frame = self.owner.frame(&mut self.random, at).into();
        if self.random.one_in(10) {
            self.write(pages::FAST_PATH, fast_path::REVOKE as u32, 1);
        }
        if self.random.one_in(12) {
            self.write(pages::RX_ADMISSION, rx_admission::ADMIT as u32, 1);
        }
        self.frame_in = 20 + self.random.below(1200);
    }

    /// A word of it in this clock. Most frames begin when firmware is done with its writes.
    fn word(&mut self, gate: u32) -> Option<Word> {
        self.frame_in = self.frame_in.saturating_sub(1);
        if self.frame.is_empty() && self.frame_in == 0 && self.writes.is_empty() {
            self.next_frame(gate);
        }
        let comes = self.writes.is_empty() || self.random.one_in(40);
        if comes && self.random.one_in(2) {
            self.frame.pop_front()
        } else {
            None
        }
    }

    /// The answer's slot can be sent, is being sent.
    pub fn line(&mut self) -> (bool, bool) {
        self.sending = self.sending.saturating_sub(1);
        let sending = self.sending != 0;
        (!sending && !self.random.one_in(30), sending)
    }

    /// A pad that there is, by number.
    fn pad(&mut self) -> u8 {
        let c = self.channels;
        let pads = match self.random.below(7) {
            0 => (0..c.stepgens).map(Pad::Step).collect::<Vec<_>>(),
            1 => (0..c.stepgens).map(Pad::Dir).collect(),
            2 => (0..c.stepgens).map(Pad::StepN).collect(),
            3 => (0..c.stepgens).map(Pad::DirN).collect(),
            4 => (0..c.pwms).map(Pad::Pwm).collect(),
            5 => (0..c.pwms).map(Pad::PwmDir).collect(),
            _ => (0..c.outputs).map(Pad::Output).collect(),
        };
        let n = self.random.below(pads.len() as u32) as usize;
        pads.get(n).map_or(0, |pad| pad.number())
    }

    /// The MAC in this clock.
    pub fn mac(&mut self, gate: u32) -> Bus {
        self.chapter = self.chapter.wrapping_add(1);
        if self.chapter % 30_000 == 1 {
            self.settings();
        }
        if self.random.one_in(1500) && self.writes.is_empty() {
            self.storm();
        }
        self.servo += 1;
        if self.servo >= self.servo_every && self.writes.is_empty() {
            self.servo = 0;
            self.servo_period();
        }
        let mut bus = Bus {
            rst: self.rst,
            ..Bus::default()
        };
        if self.random.one_in(700) {
            bus.frame_done = Some(self.random.below(4) as u8);
        }
        bus.beat = self.random.one_in(2);
        if self.random.one_in(300) {
            bus.frame_pending = Some(self.random.below(4) as u8);
        }
        bus.word = self.word(gate);
        bus
    }

    /// What is written in this clock: address and data. The bus master waits while the fast path
    /// has the registers.
    pub fn write_now(&mut self, hold: bool) -> Option<(u32, u32)> {
        // Writes as close as the bus can carry them, and with the CPU's pauses.
        let writes = if self.busy { 1 } else { 3 };
        if hold || self.writes.is_empty() || !self.random.one_in(writes) {
            return None;
        }
        let (page, word, data) = self.writes.pop_front()?;
        Some((page << 9 | word, data))
    }

    /// The address of a read.
    pub fn read_at(&mut self) -> u32 {
        if self.random.one_in(60) {
            return self.random.below(1 << 15);
        }
        let at = self.random.below(self.registers.len() as u32) as usize;
        let (page, word) = self.registers[at];
        page << 9 | word
    }
}
