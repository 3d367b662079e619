//! Each channel's cores, and the hub with the cores that are there once. Each knows
//! until when it is quiet, and catches up when it is needed.

use super::registers::Regs;
use super::{Build, Common, Strobes, bit};
use crate::model::encoder::{self, Encoder};
use crate::model::extreset::Extreset;
use crate::model::gpio::{self, Gpio};
use crate::model::latch::{self, Latch};
use crate::model::led::Led;
use crate::model::pwm::{self, Pwm};
use crate::model::segments::Told;
use crate::model::stepgen::{self, Stepgen};
use crate::model::timebase::Timebase;
use crate::model::watchdog::Watchdog;
use crate::model::wide_counter::{ROTATION, WideCounter};
use wire::channels::WORD_PINS;
use wire::map::{PROBE_ENABLE, PROBE_INPUT_MASK, PROBE_INVERT};

impl Regs {
    pub(super) fn stepgen_input(&self, n: usize, common: &Common, commit: bool) -> stepgen::Input {
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

    pub(super) fn stepgen_latch(
        &self,
        n: usize,
        index: bool,
        pending: bool,
        common: &Common,
    ) -> latch::Input {
        latch::Input {
            pending,
            arm_index: bit(self.arms_now, n),
            arm_probe: bit(self.probe_arms_now, n),
            index,
            probe: common.probe,
        }
    }

    pub(super) fn encoder_latch(
        &self,
        n: usize,
        index: bool,
        pending: bool,
        common: &Common,
    ) -> latch::Input {
        latch::Input {
            pending,
            arm_index: bit(self.enables_now, 16 + n),
            arm_probe: bit(self.arms_now, 16 + n),
            index,
            probe: common.probe,
        }
    }

    pub(super) fn pwm_input(&self, n: usize, common: &Common, commit: bool) -> pwm::Input {
        pwm::Input {
            gate: common.gate,
            commit,
            command: self.pwm[n],
            period: self.pwm_set[n][0],
            mode: self.pwm_set[n][1],
        }
    }

    pub(super) fn commit_at(&self) -> u64 {
        u64::from(self.commit_at[1]) << 32 | u64::from(self.commit_at[0])
    }
}

#[derive(Clone, Debug, Default)]
pub(super) struct StepgenChannel {
    pub(super) at: u64,
    pub(super) core: Stepgen,
    pub(super) latch: Latch,
    pub(super) wide_counter: WideCounter,
    pub(super) pin: bool,
    pub(super) meta: bool,
    pub(super) index: bool,
    pub(super) waited: bool,
    /// Fraction and velocity as the strobe has caught them; as read; and the clock in which the one
    /// becomes the other: the channels hand them on to LUT RAM, one a clock.
    pub(super) caught: [u32; 2],
    pub(super) sampled: [u32; 2],
    pub(super) handed_on: Option<u64>,
}

impl StepgenChannel {
    pub(super) fn clock(&mut self, n: usize, regs: &Regs, common: &Common, s: &Strobes) {
        let input = regs.stepgen_input(n, common, s.commit);
        let latch = regs.stepgen_latch(n, self.index, self.wide_counter.pending(), common);
        let capture = self.latch.capture(&latch);
        let visit = self.at % ROTATION == n as u64;
        let count = self.core.pulses() as u32;
        self.wide_counter.clock(visit, s.sample, capture, count);
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

    pub(super) fn quiet(&self, n: usize, regs: &Regs, common: &Common) -> u64 {
        let input = regs.stepgen_input(n, common, false);
        let index = self.pin != (input.set.mode & wire::map::STEPGEN_INDEX_INVERT != 0);
        let rest = self.meta == self.pin
            && self.index == index
            && self.wide_counter.quiet()
            && self.handed_on.is_none()
            && self
                .latch
                .quiet(&regs.stepgen_latch(n, index, false, common));
        if rest { self.core.quiet(&input) } else { 0 }
    }

    pub(super) fn catch_up(&mut self, to: u64, n: usize, regs: &Regs, common: &Common) {
        if self.at < to {
            let input = regs.stepgen_input(n, common, false);
            self.core.skip(to - self.at, &input);
            self.at = to;
        }
    }
}

#[derive(Clone, Debug, Default)]
pub(super) struct EncoderChannel {
    pub(super) at: u64,
    pub(super) core: Encoder,
    pub(super) latch: Latch,
    pub(super) wide_counter: WideCounter,
    pub(super) edge: WideCounter,
    pub(super) pins: [bool; 4],
    pub(super) waited: bool,
}

impl EncoderChannel {
    pub(super) fn input(&self, n: usize, regs: &Regs, now: u64) -> encoder::Input {
        encoder::Input {
            pins: self.pins,
            mode: regs.encoder[n][0],
            filter: regs.encoder[n][1] as u8,
            now: now as u32,
            clear: false,
            visit: self.at % ROTATION == n as u64,
        }
    }

    pub(super) fn clock(&mut self, n: usize, regs: &Regs, common: &Common, s: &Strobes) {
        let mut input = self.input(n, regs, s.now);
        let latch = regs.encoder_latch(
            n,
            self.core.index_level(),
            self.wide_counter.pending(),
            common,
        );
        let capture = self.latch.capture(&latch);
        let clears = input.mode & wire::map::ENCODER_CLEAR_ON_INDEX != 0;
        // A probe latches and clears nothing.
        input.clear = capture && clears && self.latch.index_rises(&latch);
        let turn = input.visit;
        self.wide_counter
            .clock(turn, s.sample, capture, self.core.count() as u32);
        self.edge.clock(turn, s.sample, false, self.core.edge());
        let out = self.core.clock(&input);
        self.waited = out.illegal || (self.waited && !s.sample);
        self.latch.clock(&latch);
        self.at += 1;
    }

    pub(super) fn quiet(&self, n: usize, regs: &Regs, common: &Common) -> u64 {
        let input = self.input(n, regs, 0);
        let latch = regs.encoder_latch(n, self.core.index_level(), false, common);
        let rest = self.wide_counter.quiet() && self.edge.quiet() && self.latch.quiet(&latch);
        if rest { self.core.quiet(&input) } else { 0 }
    }

    pub(super) fn catch_up(&mut self, to: u64, n: usize, regs: &Regs) {
        if self.at < to {
            self.core.skip(to - self.at, regs.encoder[n][1] as u8);
            self.at = to;
        }
    }
}

#[derive(Clone, Debug, Default)]
pub(super) struct PwmChannel {
    pub(super) at: u64,
    pub(super) core: Pwm,
}

#[derive(Clone, Debug)]
pub(super) struct Hub {
    pub(super) at: u64,
    pub(super) extreset: Extreset,
    pub(super) watchdog: Watchdog,
    pub(super) timebase: Timebase,
    pub(super) gpio: Gpio,
    /// The pins behind the first word, where there are any.
    pub(super) gpio_high: Option<Gpio>,
    pub(super) led: Led,
    pub(super) probe: bool,
    pub(super) inputs: u64,
    pub(super) reset: bool,
}

impl Hub {
    pub(super) fn new(build: &Build) -> Self {
        let c = &build.channels;
        Hub {
            at: 0,
            extreset: Extreset::default(),
            watchdog: Watchdog::default(),
            timebase: Timebase::default(),
            gpio: Gpio::new(c.inputs, c.outputs, build.estop_mask, build.estop_level),
            gpio_high: (c.inputs.max(c.outputs) > WORD_PINS).then(|| {
                let behind = |count: u8| count.saturating_sub(WORD_PINS);
                Gpio::new(behind(c.inputs), behind(c.outputs), 0, 0)
            }),
            led: Led::new(u32::BITS - build.clock_hz.leading_zeros()),
            probe: false,
            inputs: 0,
            reset: false,
        }
    }

    pub(super) fn gpio_input(&self, regs: &Regs, common: &Common) -> gpio::Input {
        gpio::Input {
            gate: common.gate,
            commit: false,
            value: regs.outputs[0],
            safe: regs.safe[0],
            invert: regs.invert[0],
            pins: self.inputs as u32,
            limit: None,
            clear: false,
            job_mask: regs.mask,
            job_value: regs.aux,
        }
    }

    /// Of the pins behind the first word. No job controls them.
    pub(super) fn gpio_high_input(&self, regs: &Regs, common: &Common) -> gpio::Input {
        gpio::Input {
            gate: common.gate,
            value: regs.outputs[1],
            safe: regs.safe[1],
            invert: regs.invert[1],
            pins: (self.inputs >> u32::BITS) as u32,
            ..gpio::Input::default()
        }
    }

    /// Debounced inputs, a bit each.
    pub(super) fn levels(&self) -> [u32; 2] {
        let high = self.gpio_high.as_ref().map_or(0, Gpio::level);
        [self.gpio.level(), high]
    }

    /// Output pins, a bit each.
    pub(super) fn out(&self) -> u64 {
        let high = self.gpio_high.as_ref().map_or(0, Gpio::out);
        u64::from(high) << u32::BITS | u64::from(self.gpio.out())
    }

    pub(super) fn next_probe(&self, regs: &Regs) -> bool {
        let input = regs.probe & PROBE_INPUT_MASK;
        let word = match input / u32::from(WORD_PINS) {
            0 => self.gpio.raw(),
            _ => self.gpio_high.as_ref().map_or(0, Gpio::raw),
        };
        regs.probe & PROBE_ENABLE != 0
            && bit(word, (input % u32::from(WORD_PINS)) as usize)
                != (regs.probe & PROBE_INVERT != 0)
    }

    pub(super) fn quiet(&self, regs: &Regs, common: &Common) -> u64 {
        if self.probe != self.next_probe(regs) {
            return 0;
        }
        self.extreset
            .quiet(self.reset)
            .min(self.watchdog.quiet())
            .min(self.timebase.quiet(regs.commit_at()))
            .min(self.gpio.quiet(&self.gpio_input(regs, common)))
            .min(self.gpio_high.as_ref().map_or(u64::MAX, |gpio| {
                gpio.quiet(&self.gpio_high_input(regs, common))
            }))
            .min(self.led.quiet(regs.led))
    }

    pub(super) fn catch_up(&mut self, to: u64, regs: &Regs) {
        let clocks = to - self.at;
        if clocks != 0 {
            self.watchdog.skip(clocks);
            self.timebase.skip(clocks, regs.commit_at());
            self.gpio.skip(clocks);
            if let Some(gpio) = &mut self.gpio_high {
                gpio.skip(clocks);
            }
            self.led.skip(clocks);
            self.at = to;
        }
    }
}
