//! A board made of `wire` and `motion` behind a real UDP socket on loopback.
//!
//! It knows the session, the state machine's outline, the watchdog and exact ramps; it has no
//! timing of pulses and no gateware. That is enough for the driver and for LinuxCNC. It can also
//! give wrong answers: every knob in [`Knobs`] is a fault of a real board or network.
//!
//! Time is either the wall clock or, in lockstep, one servo period per exchange.
#![allow(dead_code)]

mod axis;
mod description;
pub mod flash;
mod knobs;
mod pins;
pub mod rig;
mod serve;
mod time;

use axis::{Axis, FakeLatch};
use ferrocnc::keys::Key;
use std::collections::HashMap;
use std::net::{SocketAddr, SocketAddrV4, UdpSocket};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard};
use std::time::{Duration, Instant};
use wire::describe::{Channels, JobsState};
use wire::exchange::{self, Command, StateWord, Status};
use wire::units::{Accel, Velocity};
use wire::{FaultReason, MAX_PAYLOAD, MAX_WORDS, Packet, ResetReason, State, map};

#[allow(unused_imports)]
pub use description::{MILL6, MILL6_ROW};
#[allow(unused_imports)]
pub use knobs::Knobs;
#[allow(unused_imports)]
pub use pins::EIGHT;
#[allow(unused_imports)]
pub use time::{Script, Time};

pub const CLOCK_HZ: u32 = 60_000_000;
pub const ABI: u32 = 0xfe44_0c4c;

/// The board's state. Tests look at it through [`FakeBoard::look`].
#[derive(Debug)]
pub struct Mind {
    pub knobs: Knobs,
    pub channels: Channels,
    time: Time,
    started: Instant,
    pub now: u64,
    pub boot_id: u32,
    pub reset_reason: ResetReason,
    pub state: State,
    pub reason: FaultReason,
    pub gate: bool,
    pub bitten: bool,
    reset_latched: bool,
    pub owner: Option<SocketAddr>,
    token: u32,
    last_sequence: u32,
    /// The key in force: that of the settings at the last start.
    pub key: Option<Key>,
    /// The last answer to a challenge, in the datagram at hand.
    proof: Option<[u32; 4]>,
    /// Challenges answered.
    pub proved: u32,
    request: Option<bool>,
    edge: bool,
    axes: [Axis; exchange::MAX_CHANNELS],
    fed: u64,
    bitten_at: u64,
    /// Config window: byte address to word.
    pub config: HashMap<u32, u32>,
    /// The last command executed.
    pub command: Command,
    /// Exchanges executed.
    pub exchanges: u32,
    /// Datagrams seen of any kind.
    pub datagrams: u32,
    pub refused: u32,
    /// Of encoder 0 and stepgen 0.
    latches: [FakeLatch; 2],
    /// A command that waits for its time.
    pending: Option<Command>,
    /// When commands took effect, by the board's clock.
    pub applied: Vec<u64>,
    estop_latched: u32,
    pub script: Option<Script>,
    pub flash: flash::FakeFlash,
    held_back: Option<Vec<u32>>,
    pub names: Vec<(u8, u8, String)>,
    /// The image's pins are configured.
    pub pins: Option<pins::FakePins>,
    /// A whole description in place of what is made of the names.
    pub described: Option<Vec<u8>>,
    last_status: Status,
}

impl Mind {
    fn new(channels: Channels, time: Time, names: &[(u8, u8, &str)]) -> Self {
        let empty = [0; exchange::STATUS_MAX];
        let last_status =
            Status::parse(&empty[..exchange::status_words(channels)], channels).unwrap();
        Mind {
            knobs: Knobs::default(),
            channels,
            time,
            started: Instant::now(),
            now: 1000,
            boot_id: 1,
            reset_reason: ResetReason::PowerUp,
            state: State::Disarmed,
            reason: FaultReason::None,
            gate: false,
            bitten: false,
            reset_latched: false,
            owner: None,
            token: 0,
            last_sequence: 0,
            key: None,
            proof: None,
            proved: 0,
            request: None,
            edge: false,
            axes: [Axis::default(); exchange::MAX_CHANNELS],
            fed: 0,
            bitten_at: 0,
            config: HashMap::new(),
            command: Command::default(),
            exchanges: 0,
            datagrams: 0,
            refused: 0,
            latches: [FakeLatch::default(); 2],
            pending: None,
            applied: Vec::new(),
            estop_latched: 0,
            script: None,
            flash: flash::FakeFlash::default(),
            held_back: None,
            names: names
                .iter()
                .map(|(kind, channel, text)| (*kind, *channel, (*text).to_owned()))
                .collect(),
            pins: None,
            described: None,
            last_status,
        }
    }

    /// Pulses of one stepgen since power-up.
    pub fn pulses(&self, stepgen: usize) -> i64 {
        self.axes[stepgen].pulses()
    }

    /// Whether any stepgen moves.
    pub fn moving(&self) -> bool {
        self.axes.iter().any(|axis| axis.ramp.velocity != 0)
    }

    /// The firmware starts again; the fabric goes on.
    pub fn reboot(&mut self) {
        self.boot_id += 1;
        self.reset_reason = ResetReason::Panic;
        self.close(State::Faulted, FaultReason::FirmwareFault);
        self.owner = None;
        self.key = Key::new(self.flash.settings.key);
        self.load_pins();
    }

    /// Everything starts again.
    pub fn power_cycle(&mut self) {
        self.reboot();
        self.reset_reason = ResetReason::PowerUp;
        self.reason = FaultReason::None;
        self.state = State::Disarmed;
        self.now = 1000;
        self.started = Instant::now();
        self.axes = [Axis::default(); exchange::MAX_CHANNELS];
        self.bitten = false;
    }

    /// Lets time pass on the clock of the board.
    fn tick(&mut self, exchange: bool) {
        let now = match self.time {
            Time::Wall => {
                1000 + (self.started.elapsed().as_nanos() * u128::from(CLOCK_HZ) / 1_000_000_000)
                    as u64
            }
            Time::Lockstep(clocks) => self.now + if exchange { clocks } else { 0 },
            Time::Scripted => match &mut self.script {
                Some(script) if exchange => script.arrival().max(self.now),
                Some(_) | None => self.now,
            },
        };
        self.advance(now.saturating_sub(self.now));
    }

    /// Lets so many clocks pass.
    pub fn advance(&mut self, clocks: u64) {
        let end = self.now + clocks;
        let timeout = u64::from(self.setting(map::CONFIG_BOARD).max(60));
        if self.gate && !self.bitten {
            let bites_at = self.fed + timeout;
            if end > bites_at {
                self.run(bites_at.saturating_sub(self.now));
                self.bitten = true;
                self.bitten_at = bites_at;
                self.owner = None;
                self.stop(FaultReason::Watchdog);
            }
        }
        self.run(end - self.now);
        let grace = u64::from(self.setting(map::CONFIG_BOARD + 4));
        if self.state == State::Stopping
            && (!self.moving() || (self.bitten && self.now > self.bitten_at + grace))
        {
            let next = match self.reason {
                FaultReason::HostDisable => State::Disarmed,
                _ => State::Faulted,
            };
            self.close(next, self.reason);
        }
        if self.knobs.estop != 0 {
            self.estop_latched |= self.knobs.estop;
            if self.gate {
                self.close(State::Faulted, FaultReason::EStop);
            }
        }
        if self.knobs.external_reset && self.gate {
            self.reset_latched = true;
            self.close(State::Faulted, FaultReason::ExternalReset);
        }
    }

    fn run(&mut self, clocks: u64) {
        let at = self.pending.and_then(|command| command.apply_at);
        if let Some(at) = at.filter(|at| at.0 < self.now + clocks) {
            let before = at.0.saturating_sub(self.now);
            let command = self.pending.take().expect("it has a time");
            self.run(before);
            self.commit(&command);
            return self.run(clocks - before);
        }
        for axis in &mut self.axes {
            axis.advance(clocks);
        }
        self.now += clocks;
    }

    fn commit(&mut self, command: &Command) {
        if self.state != State::Armed {
            return;
        }
        self.applied.push(self.now);
        for (n, axis) in self.axes.iter_mut().enumerate() {
            let (velocity, accel) = command.stepgen[n];
            if command.stepgen_enable >> n & 1 != 0 {
                axis.commit(velocity, accel);
            } else {
                axis.commit(Velocity(0), accel);
            }
        }
        let bit = |arms: u16| arms & 1 != 0;
        self.latches[0].arm(bit(command.index_arm), bit(command.probe_arm));
        self.latches[1].arm(
            bit(command.stepgen_index_arm),
            bit(command.stepgen_probe_arm),
        );
    }

    fn stop(&mut self, reason: FaultReason) {
        self.state = State::Stopping;
        self.pending = None;
        self.reason = reason;
        self.request = None;
        for n in 0..exchange::MAX_CHANNELS {
            let accel = self.setting(map::CONFIG_STEPGEN + n as u32 * map::CONFIG_STRIDE + 16);
            self.axes[n].commit(Velocity(0), Accel(accel));
        }
    }

    fn close(&mut self, state: State, reason: FaultReason) {
        self.state = state;
        self.reason = reason;
        self.gate = false;
        self.request = None;
        for axis in &mut self.axes {
            axis.ramp.velocity = 0;
            axis.commit(Velocity(0), Accel::UNLIMITED);
        }
    }

    fn setting(&self, address: u32) -> u32 {
        self.config.get(&address).copied().unwrap_or(0)
    }

    fn link(&self) -> (wire::LinkSpeed, u8) {
        self.knobs.link.unwrap_or((wire::LinkSpeed::M1000, 0))
    }

    fn state_word(&self, answer: bool) -> StateWord {
        StateWord {
            state: self.state,
            reason: self.reason,
            position_trusted: true,
            enabled: self.gate,
            session_yours: answer,
            bitten: self.bitten,
            external_reset: self.knobs.external_reset,
            accepted: answer,
            link: self.link().0 != wire::LinkSpeed::Down,
            estop: self.estop_latched != 0,
            speed: self.link().0,
            services: self.knobs.services.unwrap_or(JobsState::None),
            link_errors: self.link().1,
        }
    }
}

/// A running fake board. Dropping it ends its thread.
pub struct FakeBoard {
    pub address: SocketAddrV4,
    mind: Arc<Mutex<Mind>>,
    stop: Arc<AtomicBool>,
    thread: Option<std::thread::JoinHandle<()>>,
}

impl FakeBoard {
    /// `mill6` on a free port.
    pub fn mill6(time: Time) -> Self {
        Self::start("127.0.0.1:0", time)
    }

    /// `mill6` with a clock of its own.
    pub fn scripted(script: Script) -> Self {
        let board = Self::mill6(Time::Scripted);
        board.look().script = Some(script);
        board
    }

    /// `mill6` at an address.
    pub fn start(address: &str, time: Time) -> Self {
        let channels = Channels {
            stepgens: 6,
            encoders: 6,
            pwms: 6,
            inputs: 12,
            outputs: 12,
        };
        Self::of(address, channels, time)
    }

    /// `mill6` with these entries added to its description.
    pub fn saying(more: &[(u8, u8, &str)]) -> Self {
        let board = Self::mill6(Time::Lockstep(60_000));
        let owned = more
            .iter()
            .map(|(kind, channel, text)| (*kind, *channel, (*text).to_owned()));
        board.look().names.extend(owned);
        board
    }

    /// One with as many channels as asked.
    pub fn of(address: &str, channels: Channels, time: Time) -> Self {
        let socket = UdpSocket::bind(address).expect("a free UDP port");
        let SocketAddr::V4(address) = socket.local_addr().expect("its address") else {
            panic!("IPv4 only");
        };
        let mind = Arc::new(Mutex::new(Mind::new(channels, time, MILL6)));
        let stop = Arc::new(AtomicBool::new(false));
        let thread = std::thread::spawn({
            let (mind, stop) = (Arc::clone(&mind), Arc::clone(&stop));
            move || run(&socket, &mind, &stop)
        });
        FakeBoard {
            address,
            mind,
            stop,
            thread: Some(thread),
        }
    }

    /// The board's state, to look at or to tamper with.
    pub fn look(&self) -> MutexGuard<'_, Mind> {
        self.mind.lock().expect("the board's thread is well")
    }

    /// Its address as `boards=` takes it.
    pub fn text(&self) -> String {
        self.address.to_string()
    }
}

impl Drop for FakeBoard {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// Does this datagram order to save settings?
fn is_save(bytes: &[u8]) -> bool {
    let mut words = [0; MAX_WORDS];
    let packet = wire::words_from_bytes(bytes, &mut words).and_then(Packet::new_checked);
    packet.is_ok_and(|packet| {
        packet.records().any(|record| {
            record.write_base == map::FLASH_OP
                && record.writes == [wire::flash::Op::SaveSettings.code()]
        })
    })
}

/// Does this datagram begin with a write to this address?
fn writes_to(bytes: &[u8], address: u32) -> bool {
    let mut words = [0; MAX_WORDS];
    let packet = wire::words_from_bytes(bytes, &mut words).and_then(Packet::new_checked);
    let first = packet.ok().and_then(|packet| packet.records().next());
    first.is_some_and(|record| record.write_base == address && !record.writes.is_empty())
}

fn run(socket: &UdpSocket, mind: &Mutex<Mind>, stop: &AtomicBool) {
    socket
        .set_read_timeout(Some(Duration::from_millis(20)))
        .expect("a timeout");
    let mut bytes = [0; MAX_PAYLOAD + 1];
    let mut words = [0; MAX_WORDS];
    while !stop.load(Ordering::Relaxed) {
        let Ok((length, from)) = socket.recv_from(&mut bytes) else {
            // An idle board's time passes, too.
            let mut mind = mind.lock().expect("the test is well");
            if mind.time == Time::Wall {
                mind.tick(false);
            }
            continue;
        };
        let mut mind = mind.lock().expect("the test is well");
        if mind.flash.silent_after == Some(0) {
            mind.flash.silent_after = None;
            mind.knobs.unplugged = true;
        }
        if mind.flash.lose_save && is_save(&bytes[..length]) {
            mind.knobs.unplugged = true;
        }
        if mind.knobs.unplugged {
            continue;
        }
        mind.datagrams += 1;
        if mind.knobs.drop_requests > 0 {
            mind.knobs.drop_requests -= 1;
            continue;
        }
        if let Some(address) = mind.knobs.deaf_to
            && writes_to(&bytes[..length], address)
        {
            continue;
        }
        let exchanges = mind.exchanges;
        let served = wire::words_from_bytes(&bytes[..length], &mut words)
            .and_then(|words| mind.serve(words, from));
        let reply = match served {
            Ok(reply) => reply,
            Err(_) => {
                mind.refused += 1;
                continue;
            }
        };
        let Some(mut reply) = reply else { continue };
        let mut copies = 1;
        if mind.exchanges != exchanges {
            if mind.knobs.drop_replies > 0 {
                mind.knobs.drop_replies -= 1;
                continue;
            }
            if mind.knobs.late_by_one {
                let Some(before) = mind.held_back.replace(reply) else {
                    continue;
                };
                reply = before;
            }
            copies += usize::from(mind.knobs.duplicate_replies);
        }
        let delay = mind.knobs.delay;
        let (before, after) = mind.knobs.flood;
        drop(mind);
        let flood = |count| {
            // Not even whole words.
            for _ in 0..count {
                let _ = socket.send_to(b"flood", from);
            }
        };
        std::thread::sleep(delay);
        let mut out = [0; MAX_PAYLOAD];
        let length = wire::words_to_bytes(&reply, &mut out);
        flood(before);
        for _ in 0..copies {
            let _ = socket.send_to(&out[..length], from);
        }
        flood(after);
    }
}
