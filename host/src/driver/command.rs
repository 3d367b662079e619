//! Sends the command to the board in every period, and the settings it lacks.

use super::Driver;
use crate::blocks::encoder::Encoder;
use crate::blocks::stepgen::Stepgen;
use crate::blocks::{Feedback, Period};
use crate::fault::Fault;
use crate::settings::{Disarmed, Periods};
use wire::exchange::{COMMAND_MAX, Command, Latch, REQUEST_OVERHEAD};
use wire::map::{PROBE_ENABLE, PROBE_INPUT_MASK, PROBE_INVERT};
use wire::units::Clocks;
use wire::{MAX_WORDS, State};

/// Tries after which settings without a receipt are worth a message: 5 x 20 periods.
const REFUSED_TRIES: u32 = 5;

/// What the board is to have.
pub(super) struct Wanted {
    periods: Periods,
    /// At rest only.
    disarmed: Option<Disarmed>,
}

impl Driver {
    /// The settings of the pins in this period.
    pub(super) fn wanted_settings(&mut self, clock_hz: f64) -> Wanted {
        let mut periods = Periods::default();
        for (word, pwm) in periods.0.iter_mut().zip(&self.blocks.pwms) {
            *word = pwm.period(clock_hz);
        }
        let at_rest = match self.condition.state {
            State::Disarmed | State::Faulted => !self.condition.live,
            State::Boot | State::Armed | State::Stopping => false,
        };
        let disarmed = at_rest.then(|| self.gather(clock_hz));
        Wanted { periods, disarmed }
    }

    /// Does the board, at rest, have all of these settings?
    pub(super) fn settled(&self, wanted: &Wanted) -> bool {
        let session = &self.session;
        let disarmed = wanted.disarmed.as_ref();
        disarmed.is_some_and(|disarmed| session.disarmed_settings.settled(disarmed))
            && session.periods.settled(&wanted.periods)
    }

    /// Sends settings the board lacks. A datagram that was not sent gets no answer, so it is due
    /// again. They wait while the board answers nothing at all: that is silence, and no refusal.
    pub(super) fn send_settings(&mut self, wanted: &Wanted) {
        if self.exchange.missing > 0 {
            return;
        }
        let mut words = [0; MAX_WORDS];
        let tag = self.next_tag();
        if let Some(request) =
            self.session
                .periods
                .due(&wanted.periods, self.channels, tag, &mut words)
        {
            let _ = self.link.send(request);
        }
        let Some(disarmed) = &wanted.disarmed else {
            return;
        };
        let tag = self.next_tag();
        if let Some(request) =
            self.session
                .disarmed_settings
                .due(disarmed, self.channels, tag, &mut words)
        {
            let _ = self.link.send(request);
        }
        let refused = self
            .session
            .disarmed_settings
            .tries()
            .max(self.session.periods.tries())
            > REFUSED_TRIES;
        if refused {
            self.notifier.once(
                Fault::Settings,
                format_args!(
                    "{} and cannot be enabled; {} {}",
                    Fault::Settings.text(),
                    Fault::Settings.remedy(),
                    self.address.text
                ),
            );
        }
    }

    pub(super) fn gather(&mut self, clock_hz: f64) -> Disarmed {
        let mut wanted = Disarmed {
            watchdog: self.blocks.watchdog.configure(clock_hz),
            ..Disarmed::default()
        };
        for (words, stepgen) in wanted.stepgen.iter_mut().zip(&mut self.blocks.stepgens) {
            *words = stepgen.configure(clock_hz);
        }
        let input = usize::try_from(self.pins.probe_input.get()).ok();
        if let Some(input) = input.and_then(|input| self.blocks.inputs.get(input)) {
            wanted.probe = input.number() as u32 & PROBE_INPUT_MASK | PROBE_ENABLE;
            if self.pins.probe_invert.get() {
                wanted.probe |= PROBE_INVERT;
            }
        }
        for input in &self.blocks.inputs {
            if let Some(looks) = wanted.debounce.get_mut(input.number()) {
                *looks = input.debounce(clock_hz);
            }
        }
        for (words, encoder) in wanted.encoder.iter_mut().zip(&self.blocks.encoders) {
            *words = encoder.configure(clock_hz);
        }
        for (word, pwm) in wanted.pwm_mode.iter_mut().zip(&mut self.blocks.pwms) {
            *word = pwm.configure();
        }
        for output in &self.blocks.outputs {
            wanted.gpio_safe |= output.at(output.safe());
            wanted.gpio_invert |= output.at(output.inverted());
        }
        wanted
    }

    pub(super) fn send_command(&mut self, token: u32, settled: bool, period: Period) {
        self.exchange.sequence = self.exchange.sequence.wrapping_add(1);
        let mut command = self.make_command(token, settled, period);
        self.times.apply_at = self.apply_time(period).filter(|_| self.condition.live);
        command.apply_at = self.times.apply_at;
        self.exchange.last = Some(command);
        let repeated_at = self.times.sent[0].1;
        let repeated = self.exchange.request_seen;
        // Unsent is unanswered, and the next `read` counts it; it does not wait for it though.
        if self.transmit(&command) {
            self.exchange.awaiting = true;
        } else {
            self.unanswered(period);
        }
        self.times.request_to_write = repeated.then(|| self.times.sent[0].1 - repeated_at);
        self.exchange.request_seen = false;
    }

    /// Asks now and then which way the exchanges take, behind the command of this period.
    pub(super) fn ask_for_ways(&mut self, period_ns: i64) {
        if !self.blocks.ways.due(period_ns) {
            return;
        }
        let tag = self.next_tag();
        let mut words = [0; 8];
        let request = self.blocks.ways.ask(tag, &mut words);
        debug_assert!(request.is_some(), "a question is 7 words");
        if let Some(request) = request {
            // Unsent is unanswered; the next one is due in a second.
            let _ = self.link.send(request);
        }
    }

    /// Sends a command; `false` if the network would not take it.
    pub(super) fn transmit(&mut self, command: &Command) -> bool {
        let mut words = [0; REQUEST_OVERHEAD + COMMAND_MAX];
        let Some(request) = command.emit_request(self.channels, &mut words) else {
            return false;
        };
        self.times.sent = [(command.sequence, self.times.now()), self.times.sent[0]];
        self.blocks.exchanges.sent(command.sequence);
        self.link.send(request)
    }

    /// The moment all boards apply this period's command, by this one's clock.
    pub(super) fn apply_time(&mut self, period: Period) -> Option<Clocks> {
        let delay = self.apply_delay();
        if delay == 0 {
            return None;
        }
        // With a delay longer than a period the next command would replace this one before its
        // time.
        let delay = i64::from(delay).min((period.seconds * 1e9) as i64);
        let at = self.times.clock.board_at(self.times.writes + delay)?;
        // Even with a wrong clock comparison a command must not wait for its successor. Half a
        // period of jitter is allowed; a command with an earlier time is applied on arrival.
        let delay = Clocks((delay as f64 * 1e-9 * period.clock_hz) as u64);
        let latest = self.times.arrival?.0 + period.clocks.0 * 3 / 2 + delay.0;
        Some(at.min(Clocks(latest)))
    }

    pub(super) fn apply_delay(&self) -> u32 {
        self.pins.apply_delay.get()
    }

    pub(super) fn make_command(&mut self, token: u32, settled: bool, period: Period) -> Command {
        let enable = self.pins.enable.get() && self.condition.halting.is_none();
        let pin = self.pins.enable_request.get();
        let alone = self.refuse_alone(pin);
        let ready = enable && settled && self.session.answered && !alone;
        let mut command = Command {
            token,
            sequence: self.exchange.sequence,
            enable,
            enable_request: self.session.arm.flag(
                pin,
                ready || (self.condition.live && enable),
                self.exchange.sequence,
            ),
            ..Command::default()
        };
        let live = self.condition.live && enable;
        let feedback = match self.exchange.missing {
            0 => Feedback::Fresh,
            1 => Feedback::Bridged,
            2.. => Feedback::Frozen,
        };
        for (n, stepgen) in self.blocks.stepgens.iter_mut().enumerate() {
            let target = stepgen.command(live, feedback, period);
            command.stepgen[n] = (target.velocity, target.accel);
            command.stepgen_enable |= u16::from(target.enable) << n;
            command.stepgen_alone |= u16::from(target.alone) << n;
        }
        let sequence = self.exchange.sequence;
        for (n, stepgen) in self.blocks.stepgens.iter_mut().enumerate() {
            let (index, probe) = stepgen.arms(live, sequence);
            command.stepgen_index_arm |= u16::from(index) << n;
            command.stepgen_probe_arm |= u16::from(probe) << n;
        }
        for (n, encoder) in self.blocks.encoders.iter_mut().enumerate() {
            let (index, probe) = encoder.command(live, sequence);
            command.index_arm |= u16::from(index) << n;
            command.probe_arm |= u16::from(probe) << n;
        }
        command.latch = self.next_latch();
        let arrived = self.session.periods.arrived();
        for (n, (word, pwm)) in command.pwm.iter_mut().zip(&self.blocks.pwms).enumerate() {
            let has = arrived.map_or(u32::MAX, |periods| periods.0[n]);
            *word = pwm.command(has, period.clock_hz);
        }
        for output in &self.blocks.outputs {
            command.gpio_out |= output.at(output.command());
        }
        command
    }

    /// The latch to ask for: the next one with a value after the last one asked, so that no channel
    /// waits for ever.
    pub(super) fn next_latch(&self) -> Latch {
        let last = self.exchange.last.map_or(0, |last| last.latch.code());
        let wants = |latch: &Latch| match *latch {
            Latch::Encoder(n) => self
                .blocks
                .encoders
                .get(usize::from(n))
                .map(Encoder::wants_value),
            Latch::Stepgen(n) => self
                .blocks
                .stepgens
                .get(usize::from(n))
                .map(Stepgen::wants_value),
        };
        let mut latches = (1..=32).map(|n| Latch::from_code((last + n) & 31));
        latches
            .find(|latch| wants(latch) == Some(true))
            .unwrap_or_default()
    }
}
