//! One rising edge of all parts, in the order of the hardware: bus writes, samples, cores,
//! registers, pins.

use super::registers::place;
use super::{Board, Bus, Strobes, pages, put};
use crate::model::segments::{self, Order};
use crate::model::{gpio, lowest, timebase, watchdog};
use wire::channels::WORD_PINS;
use wire::regmap;

/// Pins of a word.
const WORD: usize = WORD_PINS as usize;

/// What the fast path has executed, in the clock in which it happens.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Executes {
    pub(super) taken: bool,
    pub(super) commit: bool,
    pub(super) commit_timed: bool,
}

/// What the bus write of one clock ago asks of the cores in this clock.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Pulses {
    strobe: u32,
    control: u32,
    token: Option<u32>,
    /// A debounce limit, and its input.
    limit: Option<(usize, u16)>,
    snapshot: bool,
    /// An expected word of the owner's frames, and a run of the fast path.
    pub(super) header: Option<(usize, u32)>,
    pub(super) run: Option<(usize, u32)>,
    pub(super) admit: bool,
    pub(super) pass: bool,
    pub(super) revoke: bool,
    /// What the fast path executes.
    pub(super) executes: Executes,
}

impl Pulses {
    fn commit_at(&self) -> bool {
        self.strobe & regmap::timebase::STROBE_COMMIT_AT != 0 || self.executes.commit_timed
    }
}

impl Board {
    pub(super) fn edge(&mut self, bus: &Bus) {
        self.catch_up();
        self.common = self.common_now();
        let job = self.job_input();
        if let Some(segments) = &self.segments {
            self.common.job = segments.tells(&job);
        }
        let mut pulses = self.pulses();
        let staged = self.frames_clock(bus, &mut pulses);
        let (strobe, timebase) = (pulses.strobe, &self.hub.timebase);
        let strobes = Strobes {
            commit: strobe & regmap::timebase::STROBE_COMMIT != 0
                || pulses.executes.commit
                || timebase.due(pulses.commit_at()),
            sample: strobe & regmap::timebase::STROBE_SAMPLE != 0 || pulses.executes.taken,
            now: timebase.now(),
        };
        // What is caught stands before the edge.
        if strobes.sample {
            self.catch_sample(strobes.now);
        }
        self.catch_times(bus, strobes.now, pulses.snapshot);
        self.lanes_clock(bus.rst, &strobes);
        self.hub_clock(bus.rst, strobes.commit, &pulses);
        self.registers_clock(&job, strobes.commit);
        let write = self.write.take();
        self.clock += 1;
        if let Some((address, data)) = write {
            let (page, word) = place(address);
            self.store(page, word, data, self.common.job);
        }
        self.regs.guarded &= !bus.rst;
        self.shine();
        self.write = staged.or(bus.write).filter(|_| !bus.rst);
        self.show_all();
        self.settle();
    }

    pub(super) fn pulses(&self) -> Pulses {
        let mut pulses = Pulses::default();
        if let Some((address, data)) = self.write {
            match place(address) {
                (pages::RX_ADMISSION, at) if at < regmap::rx_admission::MODE => {
                    pulses.header = Some((at, data));
                }
                (pages::RX_ADMISSION, regmap::rx_admission::ADMIT) => pulses.admit = true,
                (pages::FAST_PATH, at) if at < regmap::fast_path::IP_SUM => {
                    pulses.run = Some((at, data));
                }
                (pages::FAST_PATH, regmap::fast_path::PASS) => pulses.pass = true,
                (pages::FAST_PATH, regmap::fast_path::REVOKE) => pulses.revoke = true,
                (pages::TIMEBASE, regmap::timebase::SNAPSHOT) => pulses.snapshot = true,
                (pages::TIMEBASE, regmap::timebase::STROBE) => pulses.strobe = data,
                (pages::WATCHDOG, regmap::watchdog::TOKEN) => pulses.token = Some(data),
                (pages::WATCHDOG, regmap::watchdog::CONTROL) => pulses.control = data,
                (pages::DEBOUNCE, word)
                    if word < usize::from(self.build.channels.inputs.max(1)) =>
                {
                    pulses.limit = Some((word, data as u16));
                }
                _ => {}
            }
        }
        pulses
    }

    fn catch_sample(&mut self, now: u64) {
        self.sample = now;
        self.gpio_caught = self.hub.levels();
        self.estop_caught = self.hub.gpio.estop_latched();
        self.left_caught = self.hub.watchdog.remaining();
        let mut flags = [0u32; 3];
        for (n, channel) in self.encoders.iter().enumerate() {
            flags[0] |= u32::from(channel.latch.index_latched()) << n;
            flags[1] |= u32::from(channel.latch.probe_latched()) << (16 + n);
            flags[2] |= u32::from(channel.waited) << (16 + n);
        }
        for (n, channel) in self.steps.iter().enumerate() {
            flags[0] |= u32::from(channel.waited) << (16 + n);
            flags[1] |= u32::from(channel.latch.index_latched()) << n;
            flags[2] |= u32::from(channel.latch.probe_latched()) << n;
        }
        self.flags_caught = flags;
    }

    /// The snapshot, the PHY's beats, and when frames came.
    fn catch_times(&mut self, bus: &Bus, now: u64, snapshot: bool) {
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
    }

    fn lanes_clock(&mut self, rst: bool, strobes: &Strobes) {
        let (regs, common) = (&self.regs, &self.common);
        for (n, channel) in self.steps.iter_mut().enumerate() {
            channel.clock(n, regs, common, strobes);
            channel.waited &= !rst;
            channel.handed_on = channel.handed_on.filter(|_| !rst);
        }
        for (n, channel) in self.encoders.iter_mut().enumerate() {
            channel.clock(n, regs, common, strobes);
            channel.waited &= !rst;
        }
        for (n, channel) in self.pwms.iter_mut().enumerate() {
            channel
                .core
                .clock(&regs.pwm_input(n, common, strobes.commit));
            channel.at += 1;
        }
    }

    /// One edge of everything but the channels.
    #[inline]
    pub(super) fn hub_clock(&mut self, rst: bool, commit: bool, pulses: &Pulses) {
        let (regs, common, hub) = (&self.regs, &self.common, &mut self.hub);
        let orders = watchdog::Input {
            rst,
            ext_reset: common.reset_pin,
            estop: common.estop,
            token: pulses.token,
            feed: pulses.executes.taken,
            arm: pulses.control == regmap::watchdog::CONTROL_KEY_ARM,
            soft_stop: pulses.control == regmap::watchdog::CONTROL_KEY_SOFT,
            shut: pulses.control == regmap::watchdog::CONTROL_KEY_STOP,
            clear: pulses.control == regmap::watchdog::CONTROL_KEY_CLEAR,
            timeout: regs.timeout,
            grace: regs.grace,
            all_stopped: common.all_stopped,
        };
        let mut pins = hub.gpio_input(regs, common);
        pins.commit = commit;
        pins.limit = pulses.limit.filter(|(pin, _)| *pin < WORD);
        pins.clear = hub.watchdog.cleared(&orders);
        hub.probe = hub.next_probe(regs) && !rst;
        hub.gpio.clock(&pins);
        let high = hub.gpio_high_input(regs, common);
        if let Some(gpio) = &mut hub.gpio_high {
            let limit = pulses.limit;
            gpio.clock(&gpio::Input {
                commit,
                limit: limit.and_then(|(pin, looks)| Some((pin.checked_sub(WORD)?, looks))),
                ..high
            });
        }
        hub.watchdog.clock(&orders);
        hub.timebase.clock(timebase::Input {
            rst,
            commit_timed: pulses.commit_at(),
            commit_at: regs.commit_at(),
        });
        hub.led.clock(regs.led);
        hub.extreset.clock(hub.reset);
        hub.at += 1;
    }

    /// The registers that a commit and the segments write, and the segments.
    fn registers_clock(&mut self, job: &segments::Input, commit: bool) {
        let (regs, told) = (&mut self.regs, self.common.job);
        if commit {
            regs.enables_now = regs.enables;
            regs.arms_now = regs.arms;
            regs.probe_arms_now = regs.probe_arms;
        }
        if let Some(segments) = &mut self.segments {
            segments.clock(job);
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
                .all(|channel| channel.core.stopped()),
            waits: self
                .steps
                .iter()
                .take(regs.jobs)
                .enumerate()
                .any(|(n, channel)| channel.core.waits(&regs.stepgen_input(n, common, false))),
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
    pub(super) fn shine(&mut self) {
        if let Some(segments) = &self.segments {
            let aux = u32::from(segments.aux(self.regs.beam));
            self.regs.aux = aux << 16 | aux;
        }
    }

    pub(super) fn show_hub(&mut self) {
        self.out.gpio_out = self.hub.out() & lowest(self.build.channels.outputs);
        self.out.led = self.hub.led.lit().into();
        let (reset, estop) = (self.hub.extreset.active(), self.hub.gpio.estop());
        self.out.gate = self.hub.watchdog.gate(reset, estop).into();
    }

    pub(super) fn show_step(&mut self, n: usize) {
        let [step, dir] = self.steps[n].core.pins();
        put(&mut self.out.step, n, step);
        put(&mut self.out.dir, n, dir);
        put(&mut self.out.step_n, n, !step);
        put(&mut self.out.dir_n, n, !dir);
    }

    pub(super) fn show_pwm(&mut self, n: usize) {
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
}
