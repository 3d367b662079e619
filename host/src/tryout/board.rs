//! The way to a board that is tried out: its session, its settings, an exchange at a time.
//!
//! If this program stands still or dies, the board's watchdog stops the axes softly and closes its
//! outputs. When it ends, the settings are put back and the session is given back.

use super::{LOST, Layout, Order, Tryout};
use crate::client::{Client, ClientError, Identity, Session};
use std::time::Duration;
use wire::describe::Channels;
use wire::exchange::{Command, StateWord, Status, status_words};
use wire::map::{self, BoardConfig, StepgenConfig};
use wire::units::{Accel, Velocity};
use wire::{MAX_WORDS, etherbone};

/// Seconds without an exchange until the board stops: some ten exchanges, and a terminal that is
/// drawn on over a slow line.
pub const TIMEOUT_S: f64 = 0.2;
/// Seconds for the soft stop after that. The speed is limited so that it is enough.
const GRACE_S: f64 = 0.5;
/// Between two exchanges at the end.
const EVERY: Duration = Duration::from_millis(5);
/// How long to ask for the session.
const PATIENCE: Duration = Duration::from_secs(4);
/// So many exchanges without an answer, and the session is asked for again: the board ends one that
/// is silent for 3 s.
const AGAIN: u32 = 10;
/// Exchanges until it has stopped at the end.
const LAST: u32 = 100;

/// A board with our session.
pub struct Bench {
    client: Client,
    session: Session,
    channels: Channels,
    hz: f64,
    command: Command,
    /// What the outputs are while nothing is on.
    rest: u64,
    accel: Vec<f64>,
    /// Settings that this needs, and those of before that differ.
    wanted: Vec<(u32, u32)>,
    saved: Vec<(u32, u32)>,
    /// The last order was to be enabled.
    enabled: bool,
    /// Exchanges without an answer in a row.
    missing: u32,
    /// Why the session could not be taken again.
    why: Option<ClientError>,
}

/// Why it does not arm.
pub fn held_by(state: &StateWord) -> String {
    match state {
        state if state.estop => "an e-stop input is active".to_owned(),
        state if state.external_reset => "the external reset pin is active".to_owned(),
        state => format!("{}, {}", state.state, state.reason),
    }
}

impl Bench {
    /// Takes the session; refused if another program has it. `every` is how long an answer is
    /// waited for.
    pub fn take(
        client: Client,
        identity: &Identity,
        layout: &Layout,
        every: Duration,
    ) -> Result<Self, ClientError> {
        let mut client = client.hurried(every, PATIENCE.max(every * 10));
        let session = client.acquire()?;
        let hz = f64::from(identity.describe.clock_hz);
        let mut bench = Bench {
            client,
            session,
            channels: identity.describe.channels,
            hz,
            command: Command {
                token: session.token,
                sequence: session.last_sequence,
                ..Command::default()
            },
            rest: 0,
            accel: layout.motors.iter().map(|motor| motor.accel).collect(),
            wanted: Vec::new(),
            saved: Vec::new(),
            enabled: false,
            missing: 0,
            why: None,
        };
        let board = |which: BoardConfig| map::CONFIG_BOARD + 4 * which as u32;
        // Outputs stay at the levels that they have while the gate is closed.
        bench.rest = bench.client.read(&[board(BoardConfig::GpioSafe)])?[0].into();
        if bench.channels.outputs_high() != 0 {
            let high = bench.client.read(&[board(BoardConfig::GpioSafeHigh)])?[0];
            bench.rest |= u64::from(high) << u32::BITS;
        }
        bench.set(board(BoardConfig::WatchdogTimeout), (TIMEOUT_S * hz) as u32)?;
        bench.set(board(BoardConfig::WatchdogGrace), (GRACE_S * hz) as u32)?;
        for (n, motor) in (0..).zip(&layout.motors) {
            let at = map::CONFIG_STEPGEN + n * map::CONFIG_STRIDE;
            let clocks = |ns: u32| (f64::from(ns) * 1e-9 * hz).ceil() as u32;
            let words = [
                StepgenConfig::Steplen,
                StepgenConfig::Stepspace,
                StepgenConfig::Dirsetup,
                StepgenConfig::Dirhold,
            ];
            for (word, ns) in words.into_iter().zip(motor.timing) {
                bench.set(at + 4 * word as u32, clocks(ns))?;
            }
            let stop = Accel::from_steps(motor.accel, hz).0;
            bench.set(at + 4 * StepgenConfig::StopAccel as u32, stop)?;
        }
        Ok(bench)
    }

    /// A setting, remembered as it was.
    fn set(&mut self, address: u32, value: u32) -> Result<(), ClientError> {
        self.wanted.push((address, value));
        let before = self.client.read(&[address])?[0];
        if before != value {
            self.saved.push((address, before));
            self.client.write_then_read(address, &[value], &[address])?;
        }
        Ok(())
    }

    /// The session once more, which is what ends a fault, and the settings, which a board that has
    /// restarted has lost.
    fn resync(&mut self) -> Result<(), ClientError> {
        self.session = self.client.acquire()?;
        self.command.token = self.session.token;
        self.command.sequence = self.session.last_sequence;
        for (address, value) in &self.wanted {
            self.client
                .write_then_read(*address, &[*value], &[*address])?;
        }
        Ok(())
    }

    /// Takes the session again if the board can be reached and its answers are missing all the
    /// same.
    fn take_again(&mut self) {
        let tag = self.client.next_tag();
        let mut words = [0; 8];
        let request = etherbone::Request::new(&mut words).read(tag, &[map::SESSION_OWNER_PORT]);
        let Some(request) = request.words() else {
            return;
        };
        if matches!(self.client.once(request, tag..=tag, 1), Ok(Some(_))) {
            self.why = self.resync().err();
        }
    }

    /// Tells the board what is wanted of it, and tells that what came of it.
    pub fn turn(&mut self, tryout: &mut Tryout, now: Duration) {
        match self.exchange(&tryout.order()) {
            Some(status) => tryout.answer(&status, now),
            None => tryout.silence(now),
        }
        if let Some(error) = self.why.take() {
            tryout.say(error.to_string());
        }
    }

    /// Tells the board; what it answers, if it does in time. A session that was lost is taken
    /// again, unless the order is to be enabled.
    pub fn exchange(&mut self, order: &Order) -> Option<Status> {
        let answer = self.exchange_once(order);
        self.missing = match answer {
            Some(_) => 0,
            None => self.missing.saturating_add(1),
        };
        if self.missing >= AGAIN && !order.enable {
            self.missing = 0;
            self.take_again();
        }
        answer
    }

    fn exchange_once(&mut self, order: &Order) -> Option<Status> {
        if order.enable && !self.enabled {
            self.resync().ok()?;
        }
        self.enabled = order.enable;
        let command = &mut self.command;
        command.sequence = command.sequence.wrapping_add(1);
        (command.enable, command.enable_request) = (order.enable, order.request);
        command.gpio_out = self.rest ^ order.on;
        command.stepgen_enable = 0;
        for (n, accel) in self.accel.iter().enumerate() {
            // At rest too, so that a jog that has ended brakes as it began.
            command.stepgen[n] = (Velocity(0), Accel::from_steps(*accel, self.hz));
            command.stepgen_enable |= u16::from(order.enable) << n;
        }
        if let Some((motor, speed)) = order.motion {
            command.stepgen[motor].0 = Velocity::from_hz(speed, self.hz);
        }
        let sequence = command.sequence;
        let mut words = [0; MAX_WORDS];
        let request = command.emit_request(self.channels, &mut words)?;
        let count = status_words(self.channels);
        let answer = self.client.once(request, sequence..=sequence, count);
        let (_, words) = answer.ok()??;
        Status::parse(&words, self.channels).ok()
    }
}

impl Drop for Bench {
    fn drop(&mut self) {
        let mut missing = 0;
        for _ in 0..LAST {
            match self.exchange_once(&Order::default()) {
                Some(status) if !status.state.enabled => break,
                Some(_) => {
                    missing = 0;
                    std::thread::sleep(EVERY);
                }
                None if missing < LOST => missing += 1,
                // The watchdog does it, and a board out of reach can be given nothing back.
                None => return,
            }
        }
        for (address, word) in std::mem::take(&mut self.saved).into_iter().rev() {
            // The next owner sets what it needs; what cannot be put back now is forgotten at
            // power-off.
            let back = self.client.write_then_read(address, &[word], &[address]);
            if back.is_err() {
                return;
            }
        }
        self.client.release(&self.session);
    }
}
