//! A board made of `wire` and `motion` behind a real UDP socket on loopback.
//!
//! It knows the session, the state machine's outline, the watchdog and exact ramps; it has no
//! timing of pulses and no gateware. That is enough for the driver and for LinuxCNC. It can also
//! give wrong answers: every knob in [`Knobs`] is a fault of a real board or network.
//!
//! Time is either the wall clock or, in lockstep, one servo period per exchange.
#![allow(dead_code)]

pub mod flash;
pub mod rig;

use ferrocnc::clock::Timebase;
use ferrocnc::keys::Key;
use motion::Ramp;
use motion::ramp::COMMIT_CLOCKS;
use std::collections::HashMap;
use std::net::{SocketAddr, SocketAddrV4, UdpSocket};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard};
use std::time::{Duration, Instant};
use wire::board;
use wire::describe::{self, Channels, Describe};
use wire::exchange::{self, Command, EncoderStatus, Latch, StateWord, Status};
use wire::units::{Accel, Clocks, Count, Position, StepRate};
use wire::{
    FaultReason, GateClose, MAX_PAYLOAD, MAX_WORDS, Packet, Refusal, ReplyWriter, ResetReason,
    State, etherbone, map,
};

pub const CLOCK_HZ: u32 = 60_000_000;
pub const ABI: u32 = 0xfe44_0c4c;
const RESPONSE_END: u32 = map::SESSION_RESPONSE + 16;

/// The `mill6` board's names.
pub const MILL6: &[(u8, u8, &str)] = &[
    (1, 0, "fake"),
    (13, 0, "LFE5U-25F-6BG256C"),
    (14, 0, "5a-75b-8.0"),
    (2, 0, "mill6"),
    (3, 0, "x"),
    (3, 1, "y"),
    (3, 2, "z"),
    (3, 3, "a"),
    (3, 4, "b"),
    (3, 5, "c"),
    (4, 0, "x"),
    (4, 1, "y"),
    (4, 2, "z"),
    (4, 3, "a"),
    (4, 4, "b"),
    (4, 5, "spindle"),
    (5, 0, "spindle"),
    (5, 1, "coolant"),
    (5, 2, "laser"),
    (5, 3, "fan"),
    (5, 4, "aux-0"),
    (5, 5, "aux-1"),
    (6, 0, "limit-x"),
    (6, 1, "limit-y"),
    (6, 2, "limit-z"),
    (6, 3, "home-x"),
    (6, 4, "home-y"),
    (6, 5, "home-z"),
    (6, 6, "probe"),
    (6, 7, "door"),
    (7, 0, "drive-enable"),
    (7, 1, "spindle-on"),
    (7, 2, "spindle-reverse"),
    (7, 3, "mist"),
    (7, 4, "flood"),
    (7, 5, "brake"),
    (7, 6, "lamp"),
    (6, 11, "estop"),
    (8, 0, "sstep=j1:0 dir=j1:1"),
    (8, 2, "sstep=j1:4 dir=j1:5 type=quadrature"),
    (8, 3, "sstep=j1:6 dir=j2:0 type=of-next-year"),
    (8, 1, "ppin=j3:1 dir=j3:2"),
    (8, 4, "ppin=j3:4 type=pdm"),
    (8, 11, "ipin=bus:7 estop=high"),
];

/// What an import of LiteX-CNC's would say of this board: outputs and inputs in turn.
pub const MILL6_ROW: &[(u8, u8, &str)] = &[
    (8, 0, "ogpio=0"),
    (8, 0, "igpio=1"),
    (8, 1, "ogpio=2"),
    (8, 1, "igpio=3"),
    (8, 2, "ogpio=4"),
    (8, 3, "ogpio=5"),
    (8, 2, "igpio=6"),
    (8, 6, "igpio=7"),
    (8, 4, "ogpio=8"),
];

/// Where the board's time comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Time {
    /// The wall clock.
    Wall,
    /// So many clocks pass from one exchange to the next, whatever the wall says.
    Lockstep(u64),
    /// The time of the test, converted by [`Script`].
    Scripted,
}

/// A crystal of its own, and a network with delays.
#[derive(Debug)]
pub struct Script {
    pub host: Arc<Timebase>,
    /// The board's clock is ahead by so much at time 0,
    pub offset_ns: f64,
    /// and runs faster by so much.
    pub ppm: f64,
    /// Delays of datagrams, in ns: this at least, and up to twice as much.
    pub delay_ns: f64,
    pub seed: u64,
}

impl Script {
    /// The board's clock when it is so late here.
    pub fn clocks(&self, host_ns: f64) -> f64 {
        (host_ns * (1.0 + self.ppm * 1e-6) + self.offset_ns) * f64::from(CLOCK_HZ) / 1e9
    }

    /// How late it is here when the board's clock says that.
    pub fn host_ns(&self, clocks: f64) -> f64 {
        (clocks * 1e9 / f64::from(CLOCK_HZ) - self.offset_ns) / (1.0 + self.ppm * 1e-6)
    }

    fn arrival(&mut self) -> u64 {
        self.seed ^= self.seed >> 12;
        self.seed ^= self.seed << 25;
        self.seed ^= self.seed >> 27;
        let random =
            (self.seed.wrapping_mul(0x2545_f491_4f6c_dd1d) >> 40) as f64 / f64::from(1 << 24);
        self.clocks(self.host.now() as f64 + self.delay_ns * (1.0 + random)) as u64
    }
}

/// Ways to go wrong, and what goes in at the pins.
#[derive(Clone, Debug, Default)]
pub struct Knobs {
    /// Swallow so many datagrams before looking at them.
    pub drop_requests: u32,
    /// Execute, but do not answer so many exchanges.
    pub drop_replies: u32,
    /// Answer every exchange twice.
    pub duplicate_replies: bool,
    /// Send so many datagrams without a meaning before and after every answer.
    pub flood: (u32, u32),
    /// Hold every answer back by one exchange.
    pub late_by_one: bool,
    /// Answer this long after execution.
    pub delay: Duration,
    /// Be silent altogether: the cable is out.
    pub unplugged: bool,
    /// The external reset pin.
    pub external_reset: bool,
    /// Levels of the inputs.
    pub gpio_in: u32,
    /// Encoder 0 and stepgen 0 have an index pulse at this count.
    pub index_at: Option<i32>,
    /// They have one every so many counts.
    pub index_every: Option<i32>,
    /// The probe trips when stepgen 0 comes there.
    pub probe_at: Option<i32>,
    /// Encoder 0 counts so many less than stepgen 0.
    pub encoder_lag: i32,
    /// Illegal transitions at encoder 0.
    pub quad_errors: u8,
    /// Encoders that say that they have seen illegal transitions, a bit each.
    pub illegal: u16,
    /// Stepgens that say that their rate is limited, a bit each.
    pub rate_limited: u16,
    /// Swallow datagrams whose first record writes to this address.
    pub deaf_to: Option<u32>,
    /// E-stop inputs pressed.
    pub estop: u32,
    /// Its link is down or slow, and has lost so many frames.
    pub link: Option<(wire::LinkSpeed, u8)>,
    /// Say this instead of our wire version.
    pub wire_version: Option<u32>,
    /// Say this as the gateware's ABI.
    pub abi_gateware: Option<u32>,
    /// Say this as the magic.
    pub magic: Option<u32>,
    /// Damage the board information.
    pub bad_blob: bool,
    /// Another client that keeps the session.
    pub foreign_owner: Option<SocketAddrV4>,
}

#[derive(Clone, Copy, Debug, Default)]
struct Axis {
    ramp: Ramp,
    /// Clocks until a commit reaches the ramp.
    hold: u64,
    next: (StepRate, Accel),
}

impl Axis {
    fn commit(&mut self, rate: StepRate, accel: Accel) {
        self.next = (rate, accel);
        self.hold = COMMIT_CLOCKS;
        self.ramp.target = self.ramp.rate();
        self.ramp.accel = Accel::UNLIMITED;
    }

    fn advance(&mut self, clocks: u64) {
        let held = clocks.min(self.hold);
        if held > 0 {
            let step = i64::from(self.ramp.rate().0);
            self.ramp.position = self.ramp.position.wrapping_add(step * held as i64);
            self.hold -= held;
        }
        if self.hold == 0 {
            (self.ramp.target, self.ramp.accel) = self.next;
            self.ramp.advance(clocks - held);
        }
    }

    fn pulses(&self) -> i64 {
        Position(self.ramp.position).pulses()
    }
}

/// One channel's latch.
#[derive(Clone, Copy, Debug, Default)]
struct FakeLatch {
    index: bool,
    probe: bool,
    /// Caught by the index (or else the probe), and where.
    caught: Option<(bool, i32)>,
    before: i32,
}

impl FakeLatch {
    fn turn(&mut self, count: i32, index_at: Option<i32>, probe_at: Option<i32>) {
        let passed = |at: &i32| self.before < *at && *at <= count;
        if self.caught.is_none() {
            if let Some(at) = index_at.filter(|at| self.index && passed(at)) {
                self.caught = Some((true, at));
            } else if let Some(at) = probe_at.filter(|at| self.probe && passed(at)) {
                self.caught = Some((false, at));
            }
        }
        self.before = count;
    }

    fn arm(&mut self, index: bool, probe: bool) {
        (self.index, self.probe) = (index, probe);
        if let Some((by_index, _)) = self.caught
            && !(if by_index { index } else { probe })
        {
            self.caught = None;
        }
    }

    fn flags(&self) -> (u16, u16) {
        match self.caught {
            Some((by_index, _)) => (by_index.into(), (!by_index).into()),
            None => (0, 0),
        }
    }
}

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

    /// Lets time pass by the clock the board lives by.
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
            let (rate, accel) = command.stepgen[n];
            if command.stepgen_enable >> n & 1 != 0 {
                axis.commit(rate, accel);
            } else {
                axis.commit(StepRate(0), accel);
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
            self.axes[n].commit(StepRate(0), Accel(accel));
        }
    }

    fn close(&mut self, state: State, reason: FaultReason) {
        self.state = state;
        self.reason = reason;
        self.gate = false;
        self.request = None;
        for axis in &mut self.axes {
            axis.ramp.velocity = 0;
            axis.commit(StepRate(0), Accel::UNLIMITED);
        }
    }

    fn setting(&self, address: u32) -> u32 {
        self.config.get(&address).copied().unwrap_or(0)
    }

    fn serve(&mut self, words: &[u32], from: SocketAddr) -> Result<Option<Vec<u32>>, Refusal> {
        let packet = Packet::new_checked(words)?;
        let record = packet.records().next().ok_or(Refusal::Short)?;
        if record.write_base == map::COMMAND && !record.writes.is_empty() {
            self.tick(true);
            return self.exchange(record.writes, from).map(Some);
        }
        self.tick(false);
        self.proof = None;
        for record in packet.records() {
            if record.write_base == map::SESSION_RESPONSE {
                self.proof = record.writes.try_into().ok();
            }
            for (n, word) in record.writes.iter().enumerate() {
                self.may_write(record.write_base + 4 * n as u32, *word, from)?;
            }
        }
        let mut buffer = vec![0; MAX_WORDS];
        let mut writer = ReplyWriter::new(&mut buffer, etherbone::HEADER);
        for record in packet.records() {
            for (n, word) in record.writes.iter().enumerate() {
                self.write(record.write_base + 4 * n as u32, *word, from)?;
            }
            if !record.reads.is_empty() {
                writer.write_record(record.return_base, record.reads.len() as u8);
                for address in record.reads {
                    writer.push(self.read(*address, from));
                }
            }
        }
        let used = writer.words().len();
        buffer.truncate(used);
        Ok((used > etherbone::HEADER_WORDS).then_some(buffer))
    }

    /// Never the same twice: the number of answers is part of it.
    fn challenge(&self, from: SocketAddr) -> [u32; 4] {
        let free = self.owner.is_none_or(|owner| owner == from);
        match self.key {
            Some(_) if free => [self.boot_id, self.proved, from.port().into(), 77],
            Some(_) | None => wire::auth::NONE,
        }
    }

    fn may_write(&mut self, address: u32, word: u32, from: SocketAddr) -> Result<(), Refusal> {
        let owner = self.owner == Some(from);
        match address {
            map::SESSION_RESPONSE..RESPONSE_END => Ok(()),
            map::SESSION_ACQUIRE => {
                let free = self.owner.is_none_or(|owner| owner == from);
                if !free || self.knobs.foreign_owner.is_some() {
                    return Err(Refusal::NotOwner);
                }
                let Some(key) = self.key else { return Ok(()) };
                if self.proof != Some(key.acquire(self.challenge(from), word)) {
                    return Err(Refusal::Key);
                }
                self.proved += 1;
                Ok(())
            }
            map::SESSION_RELEASE if owner => Ok(()),
            map::CONFIG..map::COMMAND if owner => {
                let live_safe = (0x400..0x800).contains(&(address & 0xfff)) && address & 0x3c == 0;
                if self.gate && !live_safe {
                    Err(Refusal::Armed)
                } else {
                    Ok(())
                }
            }
            map::FLASH..map::SERVICE | map::SESSION_REBOOT => match self.state {
                State::Armed | State::Stopping => Err(Refusal::Armed),
                _ if self.owner.is_some_and(|owner| owner != from) => Err(Refusal::NotOwner),
                _ if self.knobs.foreign_owner.is_some() => Err(Refusal::NotOwner),
                _ if self.key.is_some() && !owner => Err(Refusal::Key),
                _ if self.flash.busy() => Err(Refusal::Busy),
                _ => Ok(()),
            },
            map::SESSION_RELEASE | map::CONFIG..map::COMMAND => Err(Refusal::NotOwner),
            _ => Err(Refusal::ReadOnly),
        }
    }

    fn write(&mut self, address: u32, word: u32, from: SocketAddr) -> Result<(), Refusal> {
        match address {
            map::SESSION_ACQUIRE => {
                if self.state == State::Armed {
                    self.stop(FaultReason::SessionLost);
                }
                self.owner = Some(from);
                self.token = word ^ 0x5a5a_0000 ^ self.boot_id;
                self.last_sequence = 0;
                self.request = None;
            }
            map::SESSION_RELEASE => {
                if word != self.token {
                    return Err(Refusal::NotOwner);
                }
                if self.state == State::Armed {
                    self.stop(FaultReason::SessionLost);
                }
                self.owner = None;
            }
            map::FLASH..map::SERVICE => self.flash.write(address, word),
            map::SESSION_REBOOT => self.reboot(),
            map::SESSION_RESPONSE..RESPONSE_END => {}
            _ => {
                self.config.insert(address, word);
            }
        }
        Ok(())
    }

    fn read(&mut self, address: u32, from: SocketAddr) -> u32 {
        let foreign = self.knobs.foreign_owner.map(SocketAddr::V4);
        let owner = foreign.or(self.owner).and_then(|owner| match owner {
            SocketAddr::V4(owner) => Some(owner),
            SocketAddr::V6(_) => None,
        });
        match address {
            map::DESCRIBE..map::DESCRIBE_BLOB => {
                let words = self.describe().to_words();
                let mut word = words.get(address as usize / 4).copied().unwrap_or(0);
                match address / 4 {
                    0 => word = self.knobs.magic.unwrap_or(word),
                    1 => word = self.knobs.wire_version.unwrap_or(word),
                    _ => {}
                }
                word
            }
            map::DESCRIBE_BLOB..map::SESSION => {
                let blob = self.blob();
                let at = (address - map::DESCRIBE_BLOB) as usize;
                blob.get(at..at + 4)
                    .map_or(0, |b| u32::from_be_bytes(b.try_into().unwrap()))
            }
            map::SESSION_TOKEN if self.owner == Some(from) => self.token,
            map::SESSION_OWNER_IP => owner.map_or(0, |owner| (*owner.ip()).into()),
            map::SESSION_OWNER_PORT => owner.map_or(0, |owner| owner.port().into()),
            map::SESSION_LAST_SEQ => self.last_sequence,
            map::SESSION_CHALLENGE..map::SESSION_RESPONSE => {
                self.challenge(from)[(address - map::SESSION_CHALLENGE) as usize / 4]
            }
            map::CONFIG..map::COMMAND => self.setting(address),
            map::FLASH..map::SERVICE => {
                let link = self.link();
                self.flash.read(address, link)
            }
            map::STATUS..map::COUNTERS => {
                let mut words = [0; exchange::STATUS_MAX];
                let words = self.last_status.emit(self.channels, &mut words).unwrap();
                let at = (address - map::STATUS) as usize / 4;
                words.get(at).copied().unwrap_or(0)
            }
            _ => 0,
        }
    }

    fn exchange(&mut self, words: &[u32], from: SocketAddr) -> Result<Vec<u32>, Refusal> {
        let command = Command::parse(words, self.channels)?;
        if self.owner != Some(from) || command.token != self.token {
            return Err(Refusal::NotOwner);
        }
        exchange::judge_sequence(command.sequence, self.last_sequence)?;
        let left =
            (self.fed + u64::from(self.setting(map::CONFIG_BOARD))).saturating_sub(self.now) as u32;
        // Sampled on the clock of the commit: before it takes effect.
        let mut stepgen = [(Position::ZERO, StepRate(0)); exchange::MAX_CHANNELS];
        let mut encoder = [EncoderStatus::default(); exchange::MAX_CHANNELS];
        for (n, axis) in self.axes.iter().enumerate() {
            stepgen[n] = (Position(axis.ramp.position), axis.ramp.rate());
            encoder[n].count = Count(axis.pulses() as u32);
            encoder[n].edge_time = self.now as u32 & 0x00ff_ffff;
        }
        let here = self.axes[0].pulses() as i32;
        let counted = here - self.knobs.encoder_lag;
        encoder[0].count = Count(counted as u32);
        encoder[0].errors = self.knobs.quad_errors;
        let lag = self.knobs.encoder_lag;
        // Upwards: the last index that was passed. No test goes downwards.
        let index_at = |here: i32| match self.knobs.index_every {
            Some(every) => Some(here.div_euclid(every) * every),
            None => self.knobs.index_at,
        };
        let (index_0, index_1) = (index_at(counted), index_at(here));
        let probe_at = self.knobs.probe_at;
        self.latches[0].turn(counted, index_0, probe_at.map(|at| at - lag));
        self.latches[1].turn(here, index_1, probe_at);
        let [encoder_flags, stepgen_flags] = self.latches.map(|latch| latch.flags());
        // A channel that was not selected gives a value, too.
        let latch = match command.latch {
            Latch::Encoder(0) => self.latches[0].caught.map_or(-1, |(_, at)| at),
            Latch::Stepgen(0) => self.latches[1].caught.map_or(-1, |(_, at)| at),
            Latch::Encoder(_) | Latch::Stepgen(_) => -1,
        };
        self.decide(&command);
        self.pending = None;
        match command.apply_at {
            Some(at) if self.state == State::Armed && at.0 > self.now => {
                self.pending = Some(command);
            }
            Some(_) | None => self.commit(&command),
        }
        self.fed = self.now;
        self.last_sequence = command.sequence;
        self.exchanges += 1;
        self.command = command;
        let status = Status {
            state: self.state_word(true),
            sequence: command.sequence,
            arrival: Clocks(self.now),
            sample: Clocks(self.now),
            watchdog_left: left,
            refused: Count(self.refused),
            boot_id: self.boot_id,
            estop: self.estop_latched,
            gpio_in: self.knobs.gpio_in,
            index_latched: encoder_flags.0,
            probe_latched: encoder_flags.1,
            illegal: self.knobs.illegal,
            rate_limited: self.knobs.rate_limited,
            stepgen_index_latched: stepgen_flags.0,
            stepgen_probe_latched: stepgen_flags.1,
            latch: Count(latch as u32),
            stepgen,
            encoder,
        };
        self.last_status = status;
        let mut block = [0; exchange::STATUS_MAX];
        let block = status.emit(self.channels, &mut block).unwrap();
        let mut buffer = vec![0; MAX_WORDS];
        let mut writer = ReplyWriter::new(&mut buffer, etherbone::HEADER);
        writer.write_record(command.sequence, block.len() as u8);
        writer.extend(block);
        let used = writer.words().len();
        buffer.truncate(used);
        Ok(buffer)
    }

    /// The firmware's rule for arming: seen low, then high, then one more command.
    fn decide(&mut self, command: &Command) {
        let edge = self.request == Some(false) && command.enable_request;
        self.request = match (self.request, command.enable_request) {
            (_, false) => Some(false),
            (None, true) => None,
            (Some(_), true) => Some(true),
        };
        match self.state {
            State::Armed if !command.enable => self.stop(FaultReason::HostDisable),
            State::Disarmed | State::Faulted if edge => {
                if !self.knobs.external_reset && self.knobs.estop == 0 {
                    self.state = State::Disarmed;
                    self.bitten = false;
                    self.estop_latched = 0;
                    self.reset_latched = false;
                    self.edge = true;
                    return;
                }
            }
            State::Disarmed if self.edge && command.enable_request && command.enable => {
                if !self.knobs.external_reset && !self.bitten {
                    self.state = State::Armed;
                    self.reason = FaultReason::None;
                    self.gate = true;
                }
            }
            State::Boot | State::Disarmed | State::Armed | State::Stopping | State::Faulted => {}
        }
        self.edge = false;
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
            link_errors: self.link().1,
        }
    }

    fn describe(&self) -> Describe {
        let abi_gateware = self.knobs.abi_gateware.unwrap_or(ABI);
        Describe {
            wire_version: wire::WIRE_VERSION,
            abi_firmware: ABI,
            abi_gateware,
            firmware_version: 0x0000_0100,
            gateware_version: 0x0000_0100,
            clock_hz: CLOCK_HZ,
            channels: self.channels,
            features: match self.key {
                Some(_) => describe::FEATURE_KEY,
                None => 0,
            },
            boot_id: self.boot_id,
            blob_words: self.blob().len() as u32 / 4,
            state: self.state_word(false),
            obstacles: if abi_gateware == ABI {
                0
            } else {
                describe::OBSTACLE_ABI
            },
            reset_reason: self.reset_reason,
            gate_close: GateClose::Never,
        }
    }

    fn blob(&self) -> Vec<u8> {
        if let Some(blob) = &self.described {
            return blob.clone();
        }
        let mut body = Vec::new();
        for (kind, channel, text) in &self.names {
            body.extend([*kind, *channel, text.len() as u8, 0]);
            body.extend_from_slice(text.as_bytes());
            body.resize(body.len().next_multiple_of(4), 0);
        }
        let crc = board::crc32(&body) ^ u32::from(self.knobs.bad_blob);
        let mut bytes = Vec::new();
        for word in [
            board::MAGIC,
            board::VERSION,
            (board::HEADER_LEN + body.len()) as u32,
            crc,
        ] {
            bytes.extend(word.to_be_bytes());
        }
        bytes.extend(body);
        bytes
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
