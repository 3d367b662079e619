//! One board in the servo thread: `ferrocnc.<n>.read` and `ferrocnc.<n>.write`.
//!
//! # Timing
//!
//! `write` computes the targets for the coming period and sends the exchange. The board commits
//! them and samples everything on the same clock, and its answer travels back while the thread sleeps.
//! The next `read` normally finds it waiting, so a servo period costs one datagram each way and no
//! round trip. What it finds is one period old; `motion` knows the ramp exactly, so position and
//! velocity are predicted forward by that period before HAL sees them.
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
//! All requests are on their way before `read` waits for the first answer, and it waits for all of them
//! together. With an apply time every board's command takes effect at the same moment: the first `write` of
//! the period says when, each driver says it by its own board's clock ([`crate::clock`]). What is predicted is
//! then the place at the *next* such moment.
//!
//! `read-request`, if it is there, repeats the last command at the beginning of the period for its answer's
//! sake: feedback is some 100 us old when the controller sees it, not a period.
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
//! moment. From the second on, feedback stands still and so does the position loop's opinion: only
//! the command's own velocity is passed on. The leaky bucket decides when the board is given up:
//! `enabled` falls, `io-error` rises, and the driver asks for the session again ten times a second.
//! Answers to earlier commands are recognised by their sequence number and dropped.
//!
//! # When a board comes back
//!
//! A new session is configured from the parameters again and starts disarmed; arming needs `enable`
//! and a new rising edge of `enable-request`. Positions are the board's and survive. If its clock
//! went backwards the fabric was reset, counts began anew, and the difference is kept here: HAL's
//! position does not jump.
//!
//! Nothing in here allocates, locks or blocks, and nothing but [`Link`] makes a system call.

use crate::address::Address;
use crate::blocks::arming::ArmRequest;
use crate::blocks::encoder::Encoder;
use crate::blocks::ethernet::Ethernet;
use crate::blocks::gpio;
use crate::blocks::latch::Sight;
use crate::blocks::packets::Packets;
use crate::blocks::pwm::Pwm;
use crate::blocks::stepgen::{Sample, Stepgen};
use crate::blocks::wallclock::Wallclock;
use crate::blocks::watchdog::Watchdog;
use crate::blocks::{Feedback, Outlook, Period};
use crate::client::{Identity, SESSION_WORDS, Session, single_record};
use crate::clock::{BoardClock, Timebase};
use crate::hal::{
    Backend, Catalogue, ExportError, Exporter, In, Level, Line, Messenger, Out, Param,
};
use crate::link::Link;
use crate::names::Glue;
use crate::settings::{Disarmed, INPUTS, Periods, Sync};
use std::net::Ipv4Addr;
use std::sync::Arc;
use std::time::{Duration, Instant};
use wire::board::Kind;
use wire::describe::Channels;
use wire::exchange::{COMMAND_MAX, Command, Latch, MAX_CHANNELS, REQUEST_OVERHEAD, Status};
use wire::map::{PROBE_ENABLE, PROBE_INPUT_MASK, PROBE_INVERT};
use wire::units::Clocks;
use wire::{FaultReason, MAX_WORDS, ReplyWriter, State, etherbone, map};

/// 100 ms between two requests for the session: a board that starts is found soon, one that is off
/// costs next to nothing.
const ACQUIRE_NS: i64 = 100_000_000;
/// Tags of our requests lie up here, exchange answers are told apart by their length anyway.
const TAG_BASE: u32 = 0xfe00_0000;
/// Our token, then who owns the board: what `Driver::owned` understands.
const OWNER_WORDS: [u32; 3] = [
    map::SESSION_TOKEN,
    map::SESSION_OWNER_IP,
    map::SESSION_OWNER_PORT,
];
/// 250 us: four commands are sent in some 60 us and are there some 50 us later, so all boards have theirs
/// when the moment comes, and the rest of the period is left for what comes late.
const APPLY_DELAY_NS: u32 = 250_000;
/// Tries after which settings without a receipt are worth a message: 5 x 20 periods.
const REFUSED_TRIES: u32 = 5;

/// Whether the board is ours.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Phase {
    /// Asking for the session; so many periods until the next time.
    Acquiring {
        wait: u32,
        tag: u32,
        announced: bool,
    },
    /// Exchanging.
    Online { token: u32 },
}

/// The board-wide pins.
#[derive(Debug)]
struct Pins {
    enable: In<bool>,
    enable_request: In<bool>,
    enabled: Out<bool>,
    fault_reason: Out<u32>,
    state: Out<u32>,
    position_trusted: Out<bool>,
    refused_total: Out<u32>,
    estop: Out<bool>,
    reset_reason: Out<u32>,
    gate_close: Out<u32>,
    io_error: Param<bool>,
    probe_input: Param<i32>,
    probe_invert: Param<bool>,
    apply_delay: Param<u32>,
}

/// A board and everything HAL sees of it.
pub struct Driver {
    index: usize,
    address: Address,
    link: Link,
    channels: Channels,
    clock_hz: u32,
    boot_id: u32,
    say: Messenger,

    pins: Pins,
    packets: Packets,
    watchdog: Watchdog,
    wallclock: Wallclock,
    ethernet: Ethernet,
    stepgens: Vec<Stepgen>,
    encoders: Vec<Encoder>,
    pwms: Vec<Pwm>,
    inputs: Vec<gpio::Input>,
    outputs: Vec<gpio::Output>,

    phase: Phase,
    arm: ArmRequest,
    disarmed_settings: Sync<Disarmed>,
    periods: Sync<Periods>,
    settings_refused_said: bool,
    /// Somebody else who drives the board, as far as the operator was told.
    foreign_owner: Option<(u32, u32)>,
    tag: u32,
    sequence: u32,
    /// The last command sent in this session.
    last: Option<Command>,
    /// The command just sent awaits its answer.
    awaiting: bool,
    /// It is the repetition of one that was sent last period, so two answers may come.
    repeated: bool,
    /// `read-request` was called since the last `write`.
    request_seen: bool,
    /// Answers missing in a row.
    missing: u32,
    /// An answer came in this session: the board has seen our `enable-request` low.
    answered: bool,
    state: State,
    reason: FaultReason,
    live: bool,

    time: Arc<Timebase>,
    /// The common moments used last.
    read_moment: u64,
    write_moment: u64,
    clock: BoardClock,
    /// Sequence number and time of sending of the last two commands.
    sent: [(u32, i64); 2],
    /// From `read-request` to `write`, as it was last time; `None` without a `read-request`.
    request_to_write: Option<i64>,
    /// When the last answered command arrived there.
    arrival: Option<Clocks>,
    /// When the last command takes effect, if not at once.
    apply_at: Option<Clocks>,

    catalogue: Catalogue,
    glue: Glue,
}

impl Driver {
    /// Exports everything this board has as `ferrocnc.<index>.*`. The link must be the one whose
    /// port owns the session.
    pub fn export(
        backend: &mut dyn Backend,
        index: usize,
        address: Address,
        identity: &Identity,
        link: Link,
        say: Messenger,
    ) -> Result<Self, ExportError> {
        let describe = &identity.describe;
        let channels = describe.channels;
        let blob = identity.blob();
        let names = |kind, class: &str, longest: &str, count: u8| {
            let room = crate::hal::NAME_MAX - format!("ferrocnc.{index}.{class}..{longest}").len();
            channel_names((0..count).map(|n| blob.text(kind, n)), room)
        };
        let mut catalogue = Catalogue::default();
        let mut hal = Exporter::new(backend, format!("ferrocnc.{index}")).listed(&mut catalogue);
        let pins = Pins {
            enable: hal.input("enable")?,
            enable_request: hal.input("enable-request")?,
            enabled: hal.output("enabled")?,
            fault_reason: hal.output("fault-reason")?,
            state: hal.output("state")?,
            position_trusted: hal.output("position-trusted")?,
            refused_total: hal.output("refused-total")?,
            estop: hal.output("estop")?,
            reset_reason: hal.output("last-reset-reason")?,
            gate_close: hal.output("last-gate-close")?,
            io_error: hal.param("io-error", false)?,
            probe_input: hal.param("probe-input", -1)?,
            probe_invert: hal.param("probe-invert", false)?,
            apply_delay: hal.param("apply-delay-ns", 0)?,
        };
        pins.reset_reason
            .set(u32::from(describe.reset_reason.code()));
        pins.gate_close.set(u32::from(describe.gate_close.code()));
        let packets = Packets::export(&mut hal)?;
        let watchdog = Watchdog::export(&mut hal)?;
        let wallclock = Wallclock::export(&mut hal)?;
        let mut ethernet = Ethernet::export(&mut hal)?;
        ethernet.sampled(&describe.state);
        let stepgens = each(
            &mut hal,
            "stepgen",
            names(
                Kind::Stepgen,
                "stepgen",
                "position-scale",
                channels.stepgens,
            ),
            |hal, n| Stepgen::export(hal, identity.step_type(n)),
        )?;
        let encoders = each(
            &mut hal,
            "encoder",
            names(Kind::Encoder, "encoder", "velocity-rpm", channels.encoders),
            |hal, _| Encoder::export(hal),
        )?;
        let pwms = each(
            &mut hal,
            "pwm",
            names(Kind::Pwm, "pwm", "invert-output", channels.pwms),
            |hal, n| {
                let has_direction = identity.has_pin(b'p', n, "dir");
                Pwm::export(hal, has_direction, identity.pwm_type(n))
            },
        )?;
        let inputs = each(
            &mut hal,
            "gpio",
            names(Kind::Input, "gpio", "in-not", channels.inputs),
            |hal, n| gpio::Input::export(hal, identity.has_pin(b'i', n, "estop")),
        )?;
        let outputs = each(
            &mut hal,
            "gpio",
            names(Kind::Output, "gpio", "invert", channels.outputs),
            |hal, n| {
                let said = |key, word| identity.pin(b'o', n, key) == Some(word);
                gpio::Output::export(hal, said("safe", "high"), said("invert", "true"))
            },
        )?;
        Ok(Driver {
            index,
            address,
            link,
            channels,
            clock_hz: describe.clock_hz,
            boot_id: describe.boot_id,
            say,
            pins,
            packets,
            watchdog,
            wallclock,
            ethernet,
            stepgens,
            encoders,
            pwms,
            inputs,
            outputs,
            // Loading took seconds, longer than an idle session lives: begin by asking again.
            phase: Phase::Acquiring {
                wait: 0,
                tag: 0,
                announced: false,
            },
            arm: ArmRequest::default(),
            disarmed_settings: Sync::default(),
            periods: Sync::default(),
            settings_refused_said: false,
            foreign_owner: None,
            tag: 0,
            sequence: 0,
            last: None,
            awaiting: false,
            repeated: false,
            request_seen: false,
            missing: 0,
            answered: false,
            state: describe.state.state,
            // What it stopped for before us is the board's past, not an event.
            reason: describe.state.reason,
            live: false,
            time: Timebase::new(),
            read_moment: 0,
            write_moment: 0,
            clock: BoardClock::new(describe.clock_hz),
            sent: [(0, 0); 2],
            request_to_write: None,
            arrival: None,
            apply_at: None,
            catalogue,
            glue: Glue::default(),
        })
    }

    /// Keeps other names for our pins alive from here on.
    pub fn adopt(&mut self, glue: Glue) {
        self.glue = glue;
    }

    /// Makes this one of several boards that act at the same moments. With more than one, commands carry an
    /// apply time from the start; `apply-delay-ns` says otherwise.
    pub fn join(&mut self, time: &Arc<Timebase>, boards: usize) {
        self.time = Arc::clone(time);
        if boards > 1 {
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

    /// Repeats the last command, so that `read` finds feedback from the beginning of this period instead of
    /// the end of the last. Of several boards, all requests go out before the first answer is waited for.
    pub fn read_request(&mut self, _period_ns: i64) {
        let Phase::Online { .. } = self.phase else {
            return;
        };
        let Some(last) = self.last else { return };
        self.sequence = self.sequence.wrapping_add(1);
        let command = Command {
            sequence: self.sequence,
            // Its time has come, or the period is over anyway.
            apply_at: None,
            ..last
        };
        // Not sent: then the answer to the command before is all there will be, and `read` says so.
        self.awaiting |= self.transmit(&command);
        self.repeated = true;
        self.request_seen = true;
    }

    /// Collects the answer to the last command and publishes what it says.
    pub fn read(&mut self, period_ns: i64) {
        let period = Period::new(period_ns, self.clock_hz);
        let mut deadline = Instant::now();
        let now = self.time.now();
        let began = self.time.reads.of(&mut self.read_moment, now);
        if self.awaiting {
            // Boards are waited for together: several silent ones cost no more than one.
            let waited = Duration::from_nanos(u64::try_from(now - began).unwrap_or(0));
            deadline += self.packets.patience(period_ns).saturating_sub(waited);
        }
        match self.collect(deadline) {
            Some(status) => {
                let whole = status.sequence == self.sequence;
                self.answered(&status, period);
                if !whole {
                    self.packets.one_of_two_missing();
                }
            }
            None if self.awaiting => self.unanswered(period),
            None => {}
        }
        self.awaiting = false;
        self.repeated = false;
        self.glue.outputs();
    }

    /// Sends what is wanted of the board in the coming period.
    pub fn write(&mut self, period_ns: i64) {
        self.glue.inputs();
        let period = Period::new(period_ns, self.clock_hz);
        match self.phase {
            Phase::Online { token } => {
                let settled = self.send_settings(period.clock_hz);
                self.send_command(token, settled, period);
            }
            Phase::Acquiring {
                wait: 0, announced, ..
            } => {
                // Keeps following its pins, so that nothing jumps later.
                let _ = self.make_command(0, false, period);
                let tag = self.send_acquire();
                self.phase = Phase::Acquiring {
                    wait: u32::try_from(ACQUIRE_NS / period_ns.max(1)).unwrap_or(1),
                    tag,
                    announced,
                };
            }
            Phase::Acquiring {
                wait,
                tag,
                announced,
            } => {
                let _ = self.make_command(0, false, period);
                self.phase = Phase::Acquiring {
                    wait: wait - 1,
                    tag,
                    announced,
                };
            }
        }
    }

    /// Something in the servo thread went wrong beyond repair: nothing is sent from here on and the
    /// board's watchdog stops the machine.
    pub fn halt(&mut self) {
        self.pins.enabled.set(false);
        self.pins.io_error.set(true);
        self.pins.position_trusted.set(false);
        self.live = false;
    }

    /// The session's token, to give it back with.
    pub fn token(&self) -> Option<u32> {
        match self.phase {
            Phase::Online { token } => Some(token),
            Phase::Acquiring { .. } => None,
        }
    }

    /// Gives the session back, if there is one. One datagram: if it is lost the watchdog does it.
    pub fn release(&mut self) {
        if let Some(token) = self.token() {
            let mut words = [0; 8];
            let mut request = ReplyWriter::new(&mut words, etherbone::HEADER);
            if request.write_record(map::SESSION_RELEASE, 1) && request.push(token) {
                // Nothing to be done about a network that is gone.
                let _ = self.link.send(request.words());
            }
        }
    }

    /// Receives until the answer to the last command is there or the deadline has passed; whatever
    /// else arrives is seen to on the way. If the last command repeated the one before, the answer to that
    /// one is the next best.
    fn collect(&mut self, deadline: Instant) -> Option<Status> {
        let status_words = wire::exchange::status_words(self.channels);
        let mut second_best = None;
        while let Some(words) = self.link.receive(deadline) {
            let Some((base, payload)) = single_record(words) else {
                continue;
            };
            if payload.len() == status_words {
                let newest = base == self.sequence;
                let repeats = self.repeated && base == self.sequence.wrapping_sub(1);
                if self.awaiting
                    && (newest || repeats)
                    && let Ok(status) = Status::parse_reply(words, self.channels)
                {
                    if newest {
                        return Some(status);
                    }
                    second_best = Some(status);
                }
            } else if let [token, ip, port] = *payload {
                if let Phase::Acquiring { tag, .. } = self.phase
                    && base == tag
                {
                    self.owned(token, ip, port);
                }
            } else if let [_] = payload {
                let _ = self.disarmed_settings.receipt(base) || self.periods.receipt(base);
            } else if payload.len() == SESSION_WORDS.len()
                && let Phase::Acquiring { tag, announced, .. } = self.phase
                && base == tag
                && tag != 0
            {
                let session = Session::from_words(payload);
                self.acquired(session, announced);
            }
        }
        second_best
    }

    fn acquired(&mut self, session: Option<Session>, announced: bool) {
        // No token: the answer to the question for the owner will say why.
        let Some(session) = session else { return };
        if session.wire_version != wire::WIRE_VERSION
            || session.channels != self.channels.to_words()
        {
            return self.announce_once(
                "another board or firmware answers at this address; restart LinuxCNC to use it",
            );
        }
        if session.boot_id != self.boot_id {
            self.boot_id = session.boot_id;
            self.ethernet.forget();
            self.error(format_args!(
                "the board has restarted; enable again when the machine is in order"
            ));
        } else if announced {
            self.info(format_args!("the board answers again"));
        }
        self.pins.reset_reason.set(session.reset_reason);
        self.pins.gate_close.set(session.gate_close);
        self.sequence = session.last_sequence;
        self.last = None;
        self.arrival = None;
        self.apply_at = None;
        for stepgen in &mut self.stepgens {
            stepgen.forget_latch();
        }
        for encoder in &mut self.encoders {
            encoder.forget_latch();
        }
        self.phase = Phase::Online {
            token: session.token,
        };
        self.disarmed_settings.forget();
        self.periods.forget();
        self.settings_refused_said = false;
        self.arm.forget();
        self.answered = false;
        self.missing = 0;
        self.packets.recovered();
    }

    fn answered(&mut self, status: &Status, period: Period) {
        self.packets.good();
        self.missing = 0;
        self.answered = true;
        self.arm.accepted(status.sequence);
        self.follow_clock(status, period.clock_hz);
        self.follow_state(status, period.clock_hz);

        let outlook = self.outlook(status, period);
        let selected = self.last.map_or(Latch::Encoder(u8::MAX), |last| last.latch);
        let sight = |latch: Latch, index: u16, probe: u16| {
            let (Latch::Encoder(n) | Latch::Stepgen(n)) = latch;
            Sight {
                sequence: status.sequence,
                live: status.state.enabled && status.state.state == State::Armed,
                index: index >> n & 1 != 0,
                probe: probe >> n & 1 != 0,
                value: (selected == latch).then_some(status.latch),
            }
        };
        for (n, stepgen) in self.stepgens.iter_mut().enumerate() {
            let (position, rate) = status.stepgen[n];
            let (index, probe) = (status.stepgen_index_latched, status.stepgen_probe_latched);
            let sample = Sample {
                position,
                rate,
                limited: status.rate_limited >> n & 1 != 0,
                sight: sight(Latch::Stepgen(n as u8), index, probe),
            };
            stepgen.sampled(&sample, outlook, period);
        }
        for (n, encoder) in self.encoders.iter_mut().enumerate() {
            let (index, probe) = (status.index_latched, status.probe_latched);
            let sight = sight(Latch::Encoder(n as u8), index, probe);
            let illegal = status.illegal >> n & 1 != 0;
            encoder.sampled(&status.encoder[n], illegal, &sight, status.sample, period);
        }
        for (n, input) in self.inputs.iter().enumerate() {
            input.sampled(status.gpio_in >> n & 1 != 0, status.estop >> n & 1 != 0);
        }
    }

    /// The board's clock: for the operator, for the apply time, and to notice that the fabric was reset.
    fn follow_clock(&mut self, status: &Status, clock_hz: f64) {
        if !self.wallclock.sampled(status.sample, clock_hz) {
            self.clock.forget();
            for stepgen in &mut self.stepgens {
                stepgen.rebase();
            }
            for encoder in &mut self.encoders {
                encoder.rebase();
            }
        }
        self.arrival = Some(status.arrival);
        let sent = self.sent.iter().find(|sent| sent.0 == status.sequence);
        if let Some((_, host)) = sent {
            self.clock.exchanged(*host, status.arrival);
            if let Some((offset, drift)) = self.clock.compared(*host) {
                self.wallclock.compared(offset, drift);
            }
        }
    }

    /// What the board does from this sample to the moment the next command takes effect.
    fn outlook(&self, status: &Status, period: Period) -> Outlook {
        let repeated = self.repeated && status.sequence == self.sequence;
        let ahead = match self.request_to_write {
            // The command has been in force for a while; the next one is due after what the last one took.
            Some(nanos) if repeated => {
                let delay = i64::from(self.apply_delay());
                let clocks = (nanos + delay) as f64 * 1e-9 * period.clock_hz;
                Clocks((clocks as u64).min(2 * period.clocks.0))
            }
            Some(_) | None => period.clocks,
        };
        match (status.state.enabled, status.state.state) {
            (true, State::Armed) => {
                let lead = match self.apply_at {
                    Some(at) if !repeated => at.0.saturating_sub(status.sample.0),
                    Some(_) | None => 0,
                };
                let lead = Clocks(lead.min(2 * period.clocks.0));
                Outlook::Commanded { lead, ahead }
            }
            (true, State::Boot | State::Disarmed | State::Stopping | State::Faulted) => {
                Outlook::Stopping { ahead }
            }
            (false, _) => Outlook::Still,
        }
    }

    fn follow_state(&mut self, status: &Status, clock_hz: f64) {
        let word = status.state;
        let armed = word.state == State::Armed && word.enabled;
        if armed && !self.live {
            self.watchdog.armed();
            self.pins.io_error.set(false);
        }
        // When the command that armed arrived the watchdog was still asleep: what it had left means
        // something from the next one on.
        let awake = armed && self.live;
        self.watchdog
            .sampled(word.bitten, status.watchdog_left, awake, clock_hz);
        self.pins.enabled.set(armed);
        self.pins.state.set(u32::from(word.state.code()));
        self.pins.fault_reason.set(u32::from(word.reason.code()));
        self.pins.position_trusted.set(word.position_trusted);
        self.pins.refused_total.set(status.refused.0);
        self.pins.estop.set(word.estop);
        self.ethernet.sampled(&word);
        self.live = armed;
        self.state = word.state;
        if word.reason != self.reason {
            self.reason = word.reason;
            match word.reason {
                FaultReason::None => {}
                FaultReason::HostDisable => self.info(format_args!("{}", word.reason)),
                FaultReason::Watchdog
                | FaultReason::ExternalReset
                | FaultReason::SessionLost
                | FaultReason::LinkDown
                | FaultReason::FirmwareFault
                | FaultReason::JobUnderrun
                | FaultReason::AbiMismatch
                | FaultReason::EStop => self.error(format_args!(
                    "the board stopped the machine: {}; remove the cause, then enable again",
                    word.reason
                )),
            }
        }
    }

    fn unanswered(&mut self, period: Period) {
        self.missing = self.missing.saturating_add(1);
        if self.missing == 1 && self.live {
            for stepgen in &mut self.stepgens {
                stepgen.bridge(period);
            }
        }
        if !self.packets.missing() {
            return;
        }
        // Nobody who is not answered for this long may believe the machine is still driven.
        self.pins.enabled.set(false);
        self.pins.position_trusted.set(false);
        self.pins.io_error.set(true);
        self.ethernet.lost();
        let was_live = core::mem::replace(&mut self.live, false);
        if was_live {
            self.reason = FaultReason::LinkDown;
            self.pins
                .fault_reason
                .set(u32::from(FaultReason::LinkDown.code()));
        }
        self.error(format_args!(
            "{} answers missing in a row; check cable and power of the board",
            self.missing
        ));
        self.phase = Phase::Acquiring {
            wait: 0,
            tag: 0,
            announced: true,
        };
    }

    /// Sends settings the board lacks; `true` when it lacks none.
    fn send_settings(&mut self, clock_hz: f64) -> bool {
        let mut words = [0; MAX_WORDS];
        let mut periods = Periods::default();
        for (word, pwm) in periods.0.iter_mut().zip(&self.pwms) {
            *word = pwm.period(clock_hz);
        }
        let tag = self.next_tag();
        if let Some(request) = self.periods.due(&periods, self.channels, tag, &mut words) {
            // Unsent is unanswered: it is due again.
            let _ = self.link.send(request);
        }
        let at_rest = match self.state {
            State::Disarmed | State::Faulted => !self.live,
            State::Boot | State::Armed | State::Stopping => false,
        };
        if !at_rest {
            return false;
        }
        let wanted = self.gather(clock_hz);
        let tag = self.next_tag();
        if let Some(request) = self
            .disarmed_settings
            .due(&wanted, self.channels, tag, &mut words)
        {
            let _ = self.link.send(request);
        }
        let refused = self.disarmed_settings.tries().max(self.periods.tries()) > REFUSED_TRIES;
        if refused && !self.settings_refused_said {
            self.settings_refused_said = true;
            self.error(format_args!(
                "the board refuses its settings and cannot be enabled; compare versions with ferrocnc describe {}",
                self.address.text
            ));
        }
        self.disarmed_settings.settled(&wanted) && self.periods.settled(&periods)
    }

    fn gather(&mut self, clock_hz: f64) -> Disarmed {
        let mut wanted = Disarmed {
            watchdog: self.watchdog.configure(clock_hz),
            ..Disarmed::default()
        };
        for (words, stepgen) in wanted.stepgen.iter_mut().zip(&mut self.stepgens) {
            *words = stepgen.configure(clock_hz);
        }
        let input = self.pins.probe_input.get();
        if (0..INPUTS as i32).contains(&input) {
            wanted.probe = input as u32 & PROBE_INPUT_MASK | PROBE_ENABLE;
            if self.pins.probe_invert.get() {
                wanted.probe |= PROBE_INVERT;
            }
        }
        for (looks, input) in wanted.debounce.iter_mut().zip(&self.inputs) {
            *looks = input.debounce(clock_hz);
        }
        for (words, encoder) in wanted.encoder.iter_mut().zip(&self.encoders) {
            *words = encoder.configure(clock_hz);
        }
        for (word, pwm) in wanted.pwm_mode.iter_mut().zip(&mut self.pwms) {
            *word = pwm.configure();
        }
        for (n, output) in self.outputs.iter().enumerate() {
            wanted.gpio_safe |= u32::from(output.safe()) << n;
            wanted.gpio_invert |= u32::from(output.inverted()) << n;
        }
        wanted
    }

    fn send_command(&mut self, token: u32, settled: bool, period: Period) {
        self.sequence = self.sequence.wrapping_add(1);
        let mut command = self.make_command(token, settled, period);
        self.apply_at = self.apply_time(period).filter(|_| self.live);
        command.apply_at = self.apply_at;
        self.last = Some(command);
        let repeated_at = self.sent[0].1;
        let repeated = self.request_seen;
        // Unsent is unanswered, and the next `read` counts it; it does not wait for it though.
        if self.transmit(&command) {
            self.awaiting = true;
        } else {
            self.unanswered(period);
        }
        self.request_to_write = repeated.then(|| self.sent[0].1 - repeated_at);
        self.request_seen = false;
    }

    /// Sends a command; `false` if the network would not take it.
    fn transmit(&mut self, command: &Command) -> bool {
        let mut words = [0; REQUEST_OVERHEAD + COMMAND_MAX];
        let Some(request) = command.emit_request(self.channels, &mut words) else {
            return false;
        };
        self.sent = [(command.sequence, self.time.now()), self.sent[0]];
        self.link.send(request)
    }

    /// The moment all boards apply this period's command, by this one's clock.
    fn apply_time(&mut self, period: Period) -> Option<Clocks> {
        let delay = self.apply_delay();
        if delay == 0 {
            return None;
        }
        let now = self.time.now();
        let moment = self.time.writes.of(&mut self.write_moment, now);
        // Longer than a period and the next command would replace it before its time.
        let delay = i64::from(delay).min((period.seconds * 1e9) as i64);
        let at = self.clock.board_at(moment + delay)?;
        // However wrong the clocks are compared, a command must not wait for its successor. Half a period of
        // jitter is forgiven; what comes too early here is applied on arrival.
        let delay = Clocks((delay as f64 * 1e-9 * period.clock_hz) as u64);
        let latest = self.arrival?.0 + period.clocks.0 * 3 / 2 + delay.0;
        Some(at.min(Clocks(latest)))
    }

    fn apply_delay(&self) -> u32 {
        self.pins.apply_delay.get()
    }

    fn make_command(&mut self, token: u32, settled: bool, period: Period) -> Command {
        let enable = self.pins.enable.get();
        let ready = enable && settled && self.answered;
        let mut command = Command {
            token,
            sequence: self.sequence,
            enable,
            enable_request: self.arm.flag(
                self.pins.enable_request.get(),
                ready || (self.live && enable),
                self.sequence,
            ),
            ..Command::default()
        };
        let live = self.live && enable;
        let feedback = match self.missing {
            0 => Feedback::Fresh,
            1 => Feedback::Bridged,
            2.. => Feedback::Frozen,
        };
        for (n, stepgen) in self.stepgens.iter_mut().enumerate() {
            let target = stepgen.command(live, feedback, period);
            command.stepgen[n] = (target.rate, target.accel);
            command.stepgen_enable |= u16::from(target.enable) << n;
        }
        let sequence = self.sequence;
        for (n, stepgen) in self.stepgens.iter_mut().enumerate() {
            let (index, probe) = stepgen.arms(live, sequence);
            command.stepgen_index_arm |= u16::from(index) << n;
            command.stepgen_probe_arm |= u16::from(probe) << n;
        }
        for (n, encoder) in self.encoders.iter_mut().enumerate() {
            let (index, probe) = encoder.command(live, sequence);
            command.index_arm |= u16::from(index) << n;
            command.probe_arm |= u16::from(probe) << n;
        }
        command.latch = self.next_latch();
        let arrived = self.periods.arrived();
        for (n, (word, pwm)) in command.pwm.iter_mut().zip(&self.pwms).enumerate() {
            let has = arrived.map_or(u32::MAX, |periods| periods.0[n]);
            *word = pwm.command(has, period.clock_hz);
        }
        for (n, output) in self.outputs.iter().enumerate() {
            command.gpio_out |= u32::from(output.command()) << n;
        }
        command
    }

    /// Whose latch to ask for: the next after the last one that has something, so that nobody waits for ever.
    fn next_latch(&self) -> Latch {
        let last = self.last.map_or(0, |last| last.latch.code());
        let wants = |latch: &Latch| match *latch {
            Latch::Encoder(n) => self.encoders.get(usize::from(n)).map(Encoder::wants_value),
            Latch::Stepgen(n) => self.stepgens.get(usize::from(n)).map(Stepgen::wants_value),
        };
        let mut latches = (1..=32).map(|n| Latch::from_code((last + n) & 31));
        latches
            .find(|latch| wants(latch) == Some(true))
            .unwrap_or_default()
    }

    fn send_acquire(&mut self) -> u32 {
        let tag = self.next_tag();
        let mut words = [0; 16];
        let mut request = ReplyWriter::new(&mut words, etherbone::HEADER);
        let fits = request.write_record(map::SESSION_ACQUIRE, 1)
            && request.push(tag)
            && request.read_record(tag, &SESSION_WORDS);
        debug_assert!(fits, "an acquisition is 13 words");
        // Unsent is unanswered: it is due again in a moment.
        let _ = self.link.send(request.words());
        // Refused is unanswered, too. Reads are always answered, and tell the two apart.
        let mut request = ReplyWriter::new(&mut words, etherbone::HEADER);
        if request.read_record(tag, &OWNER_WORDS) {
            let _ = self.link.send(request.words());
        }
        tag
    }

    /// Who owns the board after we asked for it: if not us, the operator should know.
    fn owned(&mut self, token: u32, ip: u32, port: u32) {
        let owner = (token == 0 && ip != 0).then_some((ip, port));
        if owner.is_some() && owner != self.foreign_owner {
            self.error(format_args!(
                "the board is driven by {}:{port} now; stop LinuxCNC there to have it back",
                Ipv4Addr::from_bits(ip)
            ));
        }
        self.foreign_owner = owner;
    }

    fn next_tag(&mut self) -> u32 {
        self.tag = self.tag.wrapping_add(1);
        TAG_BASE | (self.tag & 0x00ff_ffff).max(1)
    }

    fn announce_once(&mut self, what: &str) {
        if let Phase::Acquiring {
            wait,
            tag,
            announced: false,
        } = self.phase
        {
            self.phase = Phase::Acquiring {
                wait,
                tag,
                announced: true,
            };
            self.error(format_args!("{what}"));
        }
    }

    fn error(&self, what: core::fmt::Arguments<'_>) {
        self.tell(Level::Error, what);
    }

    fn info(&self, what: core::fmt::Arguments<'_>) {
        self.tell(Level::Info, what);
    }

    fn tell(&self, level: Level, what: core::fmt::Arguments<'_>) {
        let line = Line::format(format_args!(
            "board {} ({}): {what}",
            self.index, self.address.text
        ));
        (self.say)(level, line.as_c_str());
    }
}

/// One block per name, under `class.name`.
fn each<T>(
    hal: &mut Exporter<'_>,
    class: &str,
    names: Vec<String>,
    mut export: impl FnMut(&mut Exporter<'_>, usize) -> Result<T, ExportError>,
) -> Result<Vec<T>, ExportError> {
    let each = names.iter().enumerate();
    each.map(|(n, name)| export(&mut hal.channel(class, name, n), n))
        .collect()
}

/// What channels are called: the board's names where they make good HAL names of at most `room`
/// characters, two digits otherwise.
fn channel_names<'n>(names: impl Iterator<Item = Option<&'n str>>, room: usize) -> Vec<String> {
    let mut result: Vec<String> = Vec::with_capacity(MAX_CHANNELS);
    for (n, name) in names.enumerate() {
        let good = name.filter(|name| {
            !name.is_empty()
                && name.len() <= room
                && name
                    .bytes()
                    .all(|b| b.is_ascii_lowercase() || b.is_ascii_digit() || b == b'-')
                // Digits alone could be taken for another channel's number.
                && !name.bytes().all(|b| b.is_ascii_digit())
                && !result.iter().any(|known| known == name)
        });
        result.push(good.map_or_else(|| format!("{n:02}"), str::to_owned));
    }
    result
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_channel_is_called_what_the_board_calls_it_if_hal_can_bear_that() {
        let names = [
            Some("x"),
            None,
            Some("Y"),
            Some("spindle-on"),
            Some("x"),
            Some("3"),
        ];
        assert_eq!(
            channel_names(names.into_iter(), 9),
            ["x", "01", "02", "03", "04", "05"]
        );
        assert_eq!(
            channel_names([Some("spindle-on")].into_iter(), 10),
            ["spindle-on"]
        );
    }
}
