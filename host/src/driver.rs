//! One board in the servo thread: `ferrocnc.<n>.read` and `ferrocnc.<n>.write`.
//!
//! # Timing
//!
//! `write` computes the targets for the coming period and sends the exchange. The board commits
//! them and samples everything on the same clock, and its answer travels back while the thread
//! sleeps. The next `read` normally finds it waiting, so a servo period costs one datagram each way
//! and no round trip. What it finds is one period old; `motion` knows the ramp exactly, so position
//! and velocity are predicted forward by that period before HAL sees them.
//!
//! ```text
//!   servo thread   R ctrl W               R ctrl W               R ctrl W
//!   to the board          \                      \                      \
//!   board                  * commit+sample        *                      *
//!   back                    \____ waits ____/      \____ waits ____/
//!   feedback                                ^ = sample + one period of ramp: valid at the next *
//! ```
//!
//! # Several boards
//!
//! All requests are on their way before `read` waits for the first answer, and it waits for all of
//! them together. With an apply time every board's command takes effect at the same moment: the
//! first `write` of the period says when, each driver says it by its own board's clock
//! ([`crate::clock`]). The prediction is then for the *next* such moment. A stop of one board stops
//! all ([`crate::group`]).
//!
//! `read-request` is optional. It repeats the last command at the beginning of the period to get a
//! new answer, so feedback is some 100 us old when the controller sees it, not a period.
//!
//! ```text
//!   servo thread   Q R ctrl W               Q R ctrl W
//!   to the board    \        \               \        \
//!   board            * sample  * commit       * sample  * commit
//! ```
//!
//! # When an answer does not come
//!
//! `read` waits for it until `packet-read-timeout`, then goes on. One missing answer is bridged by
//! the model: whether the command or its answer was lost, the board holds a velocity meant for this
//! moment. From the second on, feedback stands still and the position loop is off: only the
//! command's own velocity is passed on. The velocity of an outer loop is passed on only if it is
//! not faster than before. The leaky bucket decides when the board is given up: `enabled` falls,
//! `io-error` rises, and the driver asks for the session again ten times a second. Answers to
//! earlier commands are recognised by their sequence number and dropped.
//!
//! # When the thread comes late
//!
//! The board goes on with the velocity it has; what it really did is in its next sample, so nothing
//! adds up. If the thread is later than the watchdog's timeout, the board stops. The message then
//! names the late thread, not the cable. A second `read` in a row does nothing; a second `write`
//! without a `read` between is not sent.
//!
//! # When a board comes back
//!
//! A new session is configured from the parameters again and starts disarmed; arming needs `enable`
//! and a new rising edge of `enable-request`. Positions are the board's and survive. If the fabric
//! was reset, its counts began again: its clock went backwards, or it says that it was switched on
//! and is no older than the silence was long. The difference is kept here: HAL's position does not
//! jump. It is not called trusted until the machine is armed again.
//!
//! `tell` holds the messages to the operator, each given once. `trouble` holds the effects of a
//! fault on this board and on the others of its [`crate::group`].
//!
//! This module does not allocate, lock or block; only [`Link`] makes system calls.

mod command;
mod export;
mod session;
mod state;
mod tell;
mod trouble;

use crate::address::Address;
use crate::blocks::latch::LatchSample;
use crate::blocks::stepgen::Sample;
use crate::blocks::{Period, PredictionBasis};
use crate::client::{CHALLENGE_WORDS, SESSION_WORDS, Session, single_record};
use crate::clock::Timebase;
use crate::fault::Fault;
use crate::glue::Glue;
use crate::group::Group;
use crate::hal::checked::Watch;
use crate::hal::{Catalogue, Level};
use crate::link::{Flood, LOOKS, Link};
use export::Pins;
use state::{Blocks, Condition, Exchange, Membership, Phase, SessionState, Times};
use std::sync::Arc;
use std::time::Instant;
use tell::Notifier;
use wire::describe::Channels;
use wire::exchange::{Command, Latch, Status};
use wire::units::Clocks;
use wire::{ResetReason, State};

pub use trouble::GROUP_REASON;

/// 100 ms between two requests for the session: a board that starts is found soon, one that is off
/// costs next to nothing.
const ACQUIRE_NS: i64 = 100_000_000;
/// Tags of our requests lie up here, exchange answers are told apart by their length anyway.
const TAG_BASE: u32 = 0xfe00_0000;
/// 250 us: four commands are sent in some 60 us and are there some 50 us later, so all boards have
/// theirs when the moment comes, and the rest of the period is left for what comes late.
const APPLY_DELAY_NS: u32 = 250_000;

/// Crystals and timers differ by less than 0.1 %.
const YOUNG: f64 = 1.001;
/// 10 ms: a board is on for at least this long before its clock is read, and the error of a clock
/// comparison is smaller.
const JITTER: f64 = 0.01;

/// A board and everything HAL sees of it.
pub struct Driver {
    index: usize,
    address: Address,
    link: Link,
    flood: Flood,
    channels: Channels,
    clock_hz: u32,
    notifier: Notifier,

    pins: Pins,
    blocks: Blocks,
    session: SessionState,
    exchange: Exchange,
    condition: Condition,
    group: Membership,
    times: Times,

    catalogue: Catalogue,
    /// Over every number that comes from HAL.
    watches: Vec<Watch>,
    glue: Glue,
}

impl Driver {
    /// Keeps other names for our pins alive from here on.
    pub fn adopt(&mut self, mut glue: Glue) {
        self.watches.append(&mut glue.watches);
        self.glue = glue;
    }

    /// Makes this one of several boards that act at the same moments. With more than one, commands
    /// carry an apply time from the start; `apply-delay-ns` says otherwise. What stops one stops
    /// them all; `stop-group` says otherwise.
    pub fn join(&mut self, time: &Arc<Timebase>, group: &Arc<Group>, boards: usize) {
        self.times.time = Arc::clone(time);
        self.group.shared = Arc::clone(group);
        self.group.several = boards > 1;
        if self.group.several {
            self.pins.apply_delay.set(APPLY_DELAY_NS);
        }
    }

    /// What was exported, by logical name.
    pub fn catalogue(&self) -> &Catalogue {
        &self.catalogue
    }

    /// How many channels of each kind there are.
    pub fn channels(&self) -> Channels {
        self.channels
    }

    /// Repeats the last command, so that `read` finds feedback from the beginning of this period
    /// instead of the end of the last. Of several boards, all requests go out before the first
    /// answer is waited for.
    pub fn read_request(&mut self, _period_ns: i64) {
        let Phase::Online { .. } = self.session.phase else {
            return;
        };
        let Some(last) = self.exchange.last else {
            return;
        };
        self.exchange.sequence = self.exchange.sequence.wrapping_add(1);
        let command = Command {
            sequence: self.exchange.sequence,
            // Its time has come, or the period is over anyway.
            apply_at: None,
            ..last
        };
        // If it was not sent, only the answer to the command before can come, and `read` reports
        // that.
        self.exchange.awaiting |= self.transmit(&command);
        self.exchange.repeated = true;
        self.exchange.request_seen = true;
    }

    /// Collects the answer to the last command and publishes what it says.
    pub fn read(&mut self, period_ns: i64) {
        let period = Period::new(period_ns, self.clock_hz);
        let mut deadline = Instant::now();
        let now = self.times.now();
        let began = self.times.time.reads.of(&mut self.times.read_moment, now);
        if self.exchange.awaiting {
            // Boards are waited for together: several silent ones cost no more than one. Where the
            // answer was asked for in this period, its time runs from there.
            let since = if self.exchange.repeated {
                self.times.sent[0].1
            } else {
                began
            };
            deadline += self.blocks.packets.left(period_ns, now - since);
        }
        let status = self.collect(deadline);
        self.times.waited += self.times.now() - now;
        match status {
            Some(status) => {
                let whole = status.sequence == self.exchange.sequence;
                self.answered(&status, period);
                if whole {
                    self.blocks.packets.good();
                    self.notifier.answered(period_ns);
                } else {
                    self.notifier.missed();
                    if self.blocks.packets.missing() {
                        self.give_up();
                    }
                }
            }
            None if self.exchange.awaiting => self.unanswered(period),
            None => {}
        }
        self.exchange.awaiting = false;
        self.exchange.repeated = false;
        self.exchange.written = false;
        self.follow_group();
        self.publish_fault();
        self.glue.outputs();
    }

    /// Sends what is wanted of the board in the coming period.
    pub fn write(&mut self, period_ns: i64) {
        self.glue.inputs();
        self.blocks.exchanges.follow_reset();
        for watch in &mut self.watches {
            watch.look(period_ns, |what| self.notifier.tell(Level::Error, what));
        }
        if core::mem::replace(&mut self.exchange.written, true) {
            return self.notifier.once(
                Fault::Unread,
                format_args!(
                    "write was called again without a read between; addf ferrocnc.{0}.read before ferrocnc.{0}.write, to one thread",
                    self.index
                ),
            );
        }
        self.times.write_begins();
        self.mind_the_time();
        self.tell_group();
        self.follow_group();
        self.follow_io_error();
        self.publish_fault();
        let period = Period::new(period_ns, self.clock_hz);
        match self.session.phase {
            Phase::Online { token } => {
                let wanted = self.wanted_settings(period.clock_hz);
                let settled = self.settled(&wanted);
                self.send_command(token, settled, period);
                // Behind the command, so that its answer does not wait for theirs.
                self.send_settings(&wanted);
                self.ask_for_ways(period_ns);
            }
            Phase::Acquiring { wait: 0, tag } => {
                // Keeps following its pins, so that nothing jumps later.
                let _ = self.make_command(0, false, period);
                if tag != 0 && self.blocks.packets.exceeded() {
                    // It stays set, even if the operator cleared it.
                    self.raise_io_error();
                }
                let tag = self.send_acquire();
                let wait = u32::try_from(ACQUIRE_NS / period_ns.max(1)).unwrap_or(1);
                self.session.phase = Phase::Acquiring { wait, tag };
            }
            Phase::Acquiring { wait, tag } => {
                let _ = self.make_command(0, false, period);
                self.session.phase = Phase::Acquiring {
                    wait: wait - 1,
                    tag,
                };
            }
        }
    }

    /// Something in the servo thread went wrong beyond repair: nothing is sent from here on, the
    /// board's watchdog stops the machine, and the other boards stop with it.
    pub fn halt(&mut self) {
        self.pins.enabled.set(false);
        self.pins.position_trusted.set(false);
        if self.grouped() && !core::mem::replace(&mut self.condition.halted, true) {
            self.group.shared.answers(self.index, false);
            self.group.shared.raise(self.index);
        }
        self.raise_io_error();
        self.condition.live = false;
        self.pins.fault_code.set(Fault::Halted.code());
    }

    /// Another thread called while this one was inside, and was sent away.
    pub fn collided(&mut self) {
        self.notifier.once(
            Fault::Collided,
            format_args!(
                "two threads call its functions at once, and one was sent away; addf ferrocnc.{0}.read and ferrocnc.{0}.write to \
                 one thread",
                self.index
            ),
        );
    }

    /// System calls made in the servo thread so far.
    pub fn calls(&self) -> u64 {
        self.link.calls()
    }

    /// The session's token, to give it back with.
    pub fn token(&self) -> Option<u32> {
        match self.session.phase {
            Phase::Online { token } => Some(token),
            Phase::Acquiring { .. } => None,
        }
    }

    /// Gives the session back, if there is one. One datagram: if it is lost the watchdog does it.
    pub fn release(&mut self) {
        if let Some(token) = self.token() {
            let mut words = [0; 8];
            if let Some(request) = session::release(token, &mut words) {
                // Without a network there is nothing to do.
                let _ = self.link.send(request);
            }
        }
    }

    /// The answer to the last command, if it comes before the deadline and among the first
    /// [`LOOKS`] datagrams.
    fn collect(&mut self, deadline: Instant) -> Option<Status> {
        let mut looks = LOOKS;
        let status = self.look_for_answer(deadline, &mut looks);
        let flood = self.flood.looked(LOOKS - looks);
        if flood.discard {
            let unread = self.link.discard();
            self.blocks.packets.discarded(unread);
        }
        if flood.tell {
            self.notifier.once(
                Fault::Flooded,
                format_args!("{}; {}", Fault::Flooded.text(), Fault::Flooded.remedy()),
            );
        }
        status
    }

    /// Receives until the answer to the last command is there, the deadline has passed or
    /// everything has been looked at that may be; other datagrams are handled on the way. If the
    /// last command repeated the one before, the answer to that one is the next best.
    fn look_for_answer(&mut self, deadline: Instant, looks: &mut u32) -> Option<Status> {
        let status_words = wire::exchange::status_words(self.channels);
        let mut second_best = None;
        while let Some(words) = self.link.receive(deadline, looks) {
            let Some((base, payload)) = single_record(words) else {
                continue;
            };
            if payload.len() == status_words {
                let newest = base == self.exchange.sequence;
                let repeats =
                    self.exchange.repeated && base == self.exchange.sequence.wrapping_sub(1);
                if !(self.exchange.awaiting && (newest || repeats)) {
                    self.blocks.exchanges.late(base);
                } else if let Ok(status) = Status::parse_reply(words, self.channels) {
                    self.timed(base);
                    if newest {
                        return Some(status);
                    }
                    second_best = Some(status);
                }
            } else if self.blocks.ways.answered(base, payload) {
                // Its pins have it.
            } else if let [token, ip, port] = *payload {
                if let Phase::Acquiring { tag, .. } = self.session.phase
                    && base == tag
                {
                    self.owned(token, ip, port);
                }
            } else if let Some(challenge) = payload.first_chunk()
                && payload.len() == CHALLENGE_WORDS.len()
            {
                if let Phase::Acquiring { tag, .. } = self.session.phase
                    && base == tag
                {
                    let challenge = *challenge;
                    self.prove(tag, challenge);
                }
            } else if let [_] = payload {
                let _ = self.session.disarmed_settings.receipt(base)
                    || self.session.periods.receipt(base);
            } else if payload.len() == SESSION_WORDS.len()
                && let Phase::Acquiring { tag, .. } = self.session.phase
                && base == tag
                && tag != 0
            {
                let session = Session::from_words(payload);
                self.acquired(session);
            }
        }
        second_best
    }

    /// An exchange was answered: how long that took is counted.
    fn timed(&mut self, sequence: u32) {
        let sent = self.times.sent.iter().find(|sent| sent.0 == sequence);
        let Some((_, sent)) = sent else { return };
        let all = u64::try_from(self.times.now() - sent).unwrap_or(0);
        let unread = self.link.unread_for().as_nanos();
        // If it says more than all, the wall clock was set meanwhile.
        let unread = u64::try_from(unread).unwrap_or(u64::MAX);
        let nanos = all.checked_sub(unread).unwrap_or(all);
        self.blocks.exchanges.answered(sequence, nanos);
    }

    fn answered(&mut self, status: &Status, period: Period) {
        self.exchange.missing = 0;
        self.session.answered = true;
        self.session.arm.accepted(status.sequence);
        self.follow_clock(status, period.clock_hz);
        self.follow_state(status, period.clock_hz);

        let basis = self.basis(status, period);
        let selected = self
            .exchange
            .last
            .map_or(Latch::Encoder(u8::MAX), |last| last.latch);
        let latch_sample = |latch: Latch, index: u16, probe: u16| {
            let (Latch::Encoder(n) | Latch::Stepgen(n)) = latch;
            LatchSample {
                sequence: status.sequence,
                live: status.state.enabled && status.state.state == State::Armed,
                index: index >> n & 1 != 0,
                probe: probe >> n & 1 != 0,
                value: (selected == latch).then_some(status.latch),
            }
        };
        for (n, stepgen) in self.blocks.stepgens.iter_mut().enumerate() {
            let (position, velocity) = status.stepgen[n];
            let (index, probe) = (status.stepgen_index_latched, status.stepgen_probe_latched);
            let sample = Sample {
                position,
                velocity,
                limited: status.rate_limited >> n & 1 != 0,
                latch_sample: latch_sample(Latch::Stepgen(n as u8), index, probe),
            };
            stepgen.sampled(&sample, basis, period);
        }
        for (n, encoder) in self.blocks.encoders.iter_mut().enumerate() {
            let (index, probe) = (status.index_latched, status.probe_latched);
            let latch_sample = latch_sample(Latch::Encoder(n as u8), index, probe);
            let illegal = status.illegal >> n & 1 != 0;
            encoder.sampled(
                &status.encoder[n],
                illegal,
                &latch_sample,
                status.sample,
                period,
            );
        }
        for input in &self.blocks.inputs {
            input.sampled(status.gpio_in, status.estop);
        }
    }

    /// The board's clock: for the operator, for the apply time, and to notice that the fabric was
    /// reset.
    fn follow_clock(&mut self, status: &Status, clock_hz: f64) {
        let now = self.times.now();
        let silent = (now - core::mem::replace(&mut self.times.heard, now)) as f64 * 1e-9;
        // If the clock went backwards, the fabric was reset. If the board was off for longer than
        // it had been on, it reports a reset, or its clock is behind the expected time; it is also
        // not older than the silence, and its stepgens have never moved. A false reset would move
        // the position, so all of these must hold.
        let first = core::mem::take(&mut self.session.first_answer);
        let sent = self
            .times
            .sent
            .iter()
            .find(|sent| sent.0 == status.sequence);
        let due = sent.and_then(|(_, host)| self.times.clock.board_at(*host));
        let behind = due.is_some_and(|due| {
            let late = Clocks(due.0.saturating_sub(status.arrival.0)).to_seconds(clock_hz);
            late > silent * (YOUNG - 1.0) + JITTER
        });
        let young = status.sample.to_seconds(clock_hz) <= silent * YOUNG;
        let stepgens = &status.stepgen[..self.blocks.stepgens.len()];
        let untouched = stepgens.iter().all(|(position, _)| position.pulses() == 0);
        let says_so = core::mem::take(&mut self.condition.new_fabric);
        let new_fabric = young && untouched && (says_so || first && behind);
        if !self.blocks.wallclock.sampled(status.sample, clock_hz) || new_fabric {
            self.tell_restart(ResetReason::PowerUp);
            self.times.clock.forget();
            self.blocks.rebase();
        }
        self.times.arrival = Some(status.arrival);
        let sent = self
            .times
            .sent
            .iter()
            .find(|sent| sent.0 == status.sequence);
        if let Some((_, host)) = sent {
            self.times.clock.exchanged(*host, status.arrival);
            if let Some((offset, drift)) = self.times.clock.compared(*host) {
                self.blocks.wallclock.compared(offset, drift);
            }
        }
    }

    /// What the board does from this sample to the moment the next command takes effect.
    fn basis(&self, status: &Status, period: Period) -> PredictionBasis {
        let repeated = self.exchange.repeated && status.sequence == self.exchange.sequence;
        let ahead = match self.times.request_to_write {
            // The command has been in force for a while; the next one is due after what the last
            // one took.
            Some(nanos) if repeated => {
                let delay = i64::from(self.apply_delay());
                let clocks = (nanos + delay) as f64 * 1e-9 * period.clock_hz;
                Clocks((clocks as u64).min(2 * period.clocks.0))
            }
            Some(_) | None => period.clocks,
        };
        match (status.state.enabled, status.state.state) {
            (true, State::Armed) => {
                let lead = match self.times.apply_at {
                    Some(at) if !repeated => at.0.saturating_sub(status.sample.0),
                    Some(_) | None => 0,
                };
                let lead = Clocks(lead.min(2 * period.clocks.0));
                PredictionBasis::Commanded { lead, ahead }
            }
            (true, State::Boot | State::Disarmed | State::Stopping | State::Faulted) => {
                PredictionBasis::Stopping { ahead }
            }
            (false, _) => PredictionBasis::Still,
        }
    }

    fn next_tag(&mut self) -> u32 {
        self.session.tag = self.session.tag.wrapping_add(1);
        TAG_BASE | (self.session.tag & 0x00ff_ffff).max(1)
    }
}
