//! Arms a board and drives only the outputs and jumpers that the command names.
//!
//! While it is armed each exchange feeds the watchdog. Its times are short here: if the self-test
//! dies, the outputs are safe within half a second. Settings it needs are put back before the
//! session is given back.

use super::Time;
use super::gather;
use super::loops::{Counts, Levels, Loop, Output, Sink, Source};
use crate::client::{Client, ClientError, Identity, Session};
use std::time::Duration;
use wire::board::Kind;
use wire::describe::Channels;
use wire::exchange::{Command, PWM_DIRECTION, PWM_ENABLE, PWM_FRACTION, Status, status_words};
use wire::map::{self, BoardConfig, CountMode, StepType, StepgenConfig};
use wire::regmap::pads::{OUTPUTS, PWM, STEP, STEP_N};
use wire::units::{Accel, Velocity};
use wire::{FaultReason, MAX_WORDS};

/// 200 ms without an exchange: this computer promises no period, and no motor hangs on the board.
const TIMEOUT_S: f64 = 0.2;
/// Time for a soft stop after that.
const GRACE_S: f64 = 0.2;
/// Between two exchanges.
const EVERY: Duration = Duration::from_millis(2);
/// For a level to get through a buffer, a divider and a debounce of 0.
const SETTLE: Duration = Duration::from_millis(2);
/// Steps a second into an encoder. Slow for a jumper, and a thousand steps are a fifth of a second.
const VELOCITY: f64 = 5_000.0;
/// Steps a second into an input: four exchanges see each level.
const SLOW: f64 = 100.0;
/// Levels a general input is shown.
const LEVELS: [bool; 8] = [true, false, true, true, false, false, true, false];
/// Levels its second pin is shown beside those: it changes at other moments, so that neither is
/// taken for the other.
const DIRECTIONS: [bool; 8] = [true, true, false, true, true, false, false, true];
/// Clocks of a PWM's period: whole ones are what is wanted of it.
const PWM_PERIOD: u32 = 1_000;
/// Exchanges that may be lost in a row, and looks until it is armed.
const PATIENCE: u32 = 50;
/// Steps a second while pads are looked at: 4 ms each, two exchanges and a read being well below
/// that.
const LOOKED_AT: f64 = 250.0;
/// Steps looked at: each pin twice at each level.
const MOMENTS: usize = 8;

/// The pads' page.
type Pads = [u32; map::PADS_WORDS as usize];

/// A pin of a step generator or PWM.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Pin {
    name: String,
    word: usize,
    bit: usize,
    second: bool,
    inverted: bool,
}

impl Pin {
    fn level(&self, pads: &Pads) -> bool {
        pads[self.word] >> self.bit & 1 != 0
    }
}

/// The pins of a step generator or PWM that the board has.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Pins {
    pins: Vec<Pin>,
    /// All that go with it, a board's pins or not: words and bits.
    own: Vec<(usize, u32)>,
}

impl Pins {
    /// Of step generator `n`; its copies for differential lines only where the board has pins for
    /// them.
    pub fn stepgen(identity: &Identity, n: usize, name: &str) -> Self {
        let pin = |kind: &str, word, second: bool, inverted| Pin {
            name: format!("stepgen {name} {kind}"),
            word,
            bit: n + 16 * usize::from(second),
            second,
            inverted,
        };
        let mut pins = vec![
            pin("STEP", STEP, false, false),
            pin("DIR", STEP, true, false),
        ];
        for (key, kind, second) in [("step_n", "STEP-", false), ("dir_n", "DIR-", true)] {
            if identity.has_pin(b's', n, key) {
                pins.push(pin(kind, STEP_N, second, true));
            }
        }
        let own = vec![(STEP, 0x1_0001 << n), (STEP_N, 0x1_0001 << n)];
        Pins { pins, own }
    }

    /// Of PWM `n`; the second one only where the board has it.
    pub fn pwm(identity: &Identity, n: usize, name: &str) -> Self {
        let pin = |kind: &str, second: bool| Pin {
            name: format!("pwm {name}{kind}"),
            word: PWM,
            bit: n + 16 * usize::from(second),
            second,
            inverted: false,
        };
        let mut pins = vec![pin("", false)];
        if identity.has_pin(b'p', n, "dir") {
            pins.push(pin(" DIR", true));
        }
        let own = vec![(PWM, 0x1_0001 << n)];
        Pins { pins, own }
    }

    /// What each pin did, of the levels it was driven to and the pads then.
    fn judge(&self, outputs: &[String], levels: impl Fn(&Pin) -> Vec<(bool, Pads)>) -> Vec<Output> {
        let judge = |pin: &Pin| {
            let (levels, mut others) = (levels(pin), Follow::new(&self.own));
            for (level, pads) in &levels {
                others.see(*level, *pads);
            }
            Output {
                name: pin.name.clone(),
                pad: levels
                    .iter()
                    .map(|(level, pads)| (*level, pin.level(pads)))
                    .collect(),
                joined: others.names(outputs),
                ..Output::default()
            }
        };
        self.pins.iter().map(judge).collect()
    }
}

/// Which pads went with a level at each of its changes.
struct Follow {
    with: Pads,
    last: Option<(bool, Pads)>,
    changes: usize,
}

impl Follow {
    /// All but these, by word and bits.
    fn new(own: &[(usize, u32)]) -> Self {
        let mut with = [u32::MAX; map::PADS_WORDS as usize];
        for (word, bits) in own {
            with[*word] &= !bits;
        }
        Follow {
            with,
            last: None,
            changes: 0,
        }
    }

    fn see(&mut self, level: bool, pads: Pads) {
        if let Some((then, was)) = self.last.replace((level, pads)) {
            self.changes += usize::from(then != level);
            for (with, (was, is)) in self.with.iter_mut().zip(was.into_iter().zip(pads)) {
                let changed = was ^ is;
                *with &= if then == level { !changed } else { changed };
            }
        }
    }

    fn names(&self, outputs: &[String]) -> Vec<String> {
        if self.changes == 0 {
            return Vec::new();
        }
        let bits = (0..self.with.len()).flat_map(|word| (0..32).map(move |bit| (word, bit)));
        bits.filter(|(word, bit)| self.with[*word] >> bit & 1 != 0)
            .map(|(word, bit)| {
                let n = bit % 16;
                match (word, bit / 16) {
                    (0, 0) => format!("STEP {n}"),
                    (0, _) => format!("DIR {n}"),
                    (1, 0) => format!("STEP- {n}"),
                    (1, _) => format!("DIR- {n}"),
                    (2, 0) => format!("PWM {n}"),
                    (2, _) => format!("PWM DIR {n}"),
                    _ => {
                        let n = (word - OUTPUTS) * u32::BITS as usize + bit;
                        let number = || format!("output {n}");
                        outputs
                            .get(n)
                            .map_or_else(number, |name| format!("output {name}"))
                    }
                }
            })
            .collect()
    }
}

/// Word and bit of the pad of output `n`.
fn output_pad(n: usize) -> (usize, u32) {
    (
        OUTPUTS + n / u32::BITS as usize,
        1 << (n % u32::BITS as usize),
    )
}

/// The level at the pad of output `n`.
fn of_output(pads: &Pads, n: usize) -> bool {
    let (word, bit) = output_pad(n);
    pads[word] & bit != 0
}

/// The word of the board's settings for all outputs, and the one for those behind the first 32.
const SAFE: [BoardConfig; 2] = [BoardConfig::GpioSafe, BoardConfig::GpioSafeHigh];
const INVERT: [BoardConfig; 2] = [BoardConfig::GpioInvert, BoardConfig::GpioInvertHigh];

/// Why it was not driven.
#[derive(Debug)]
pub enum DriveError {
    /// The board, or the way to it.
    Client(ClientError),
    /// It does not arm.
    NotArmed {
        /// What holds it.
        why: String,
    },
    /// It stopped while it was driven.
    Stopped(FaultReason),
    /// Exchanges are not answered.
    Silent,
}

impl core::fmt::Display for DriveError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            DriveError::Client(error) => error.fmt(f),
            DriveError::NotArmed { why } => write!(f, "the board does not arm: {why}"),
            DriveError::Stopped(reason) => write!(f, "the board stopped by itself: {reason}"),
            DriveError::Silent => f.write_str("the board answers no exchange"),
        }
    }
}

impl std::error::Error for DriveError {}

impl From<ClientError> for DriveError {
    fn from(error: ClientError) -> Self {
        DriveError::Client(error)
    }
}

/// A board with our session. Dropping it disarms the board, puts its settings back and gives the
/// session back.
pub struct Driven<'t> {
    client: Client,
    session: Session,
    channels: Channels,
    /// The numbers of the inputs.
    inputs: Vec<usize>,
    /// The gateware reads the pads, each as that of a channel.
    readback: bool,
    hz: f64,
    command: Command,
    saved: Vec<(u32, u32)>,
    time: &'t mut dyn Time,
}

impl Drop for Driven<'_> {
    fn drop(&mut self) {
        self.disarm();
        for (address, word) in std::mem::take(&mut self.saved).into_iter().rev() {
            // The next owner sets what it needs; what cannot be put back now is forgotten at
            // power-off.
            let _ = self.client.write_then_read(address, &[word], &[address]);
        }
        self.client.release(&self.session);
    }
}

impl<'t> Driven<'t> {
    /// Takes the session; an answer is waited for so long. Nothing is armed yet.
    pub fn take(
        client: Client,
        identity: &Identity,
        patience: Duration,
        time: &'t mut dyn Time,
    ) -> Result<Self, DriveError> {
        let mut client = client.hurried(patience, patience * 80);
        let session = client.acquire()?;
        let hz = f64::from(identity.describe.clock_hz);
        let mut driven = Driven {
            client,
            session,
            channels: identity.describe.channels,
            inputs: gather::numbers(identity, Kind::Input),
            readback: gather::reads_pads(identity),
            hz,
            command: Command {
                token: session.token,
                sequence: session.last_sequence,
                ..Command::default()
            },
            saved: Vec::new(),
            time,
        };
        let board = |which: BoardConfig| map::CONFIG_BOARD + 4 * which as u32;
        // Outputs begin at the levels they have while the gate is closed.
        driven.command.gpio_out = driven.per_output(SAFE)?;
        driven.set(board(BoardConfig::WatchdogTimeout), (TIMEOUT_S * hz) as u32)?;
        driven.set(board(BoardConfig::WatchdogGrace), (GRACE_S * hz) as u32)?;
        for n in 0..u32::from(driven.channels.inputs) {
            driven.set(map::CONFIG_DEBOUNCE + 4 * n, 0)?;
        }
        Ok(driven)
    }

    /// A setting with a bit for each output.
    fn per_output(&mut self, which: [BoardConfig; 2]) -> Result<u64, ClientError> {
        let words = which.map(|which| map::CONFIG_BOARD + 4 * which as u32);
        gather::bits(&mut self.client, self.channels, words)
    }

    /// A setting, remembered as it was.
    fn set(&mut self, address: u32, value: u32) -> Result<(), DriveError> {
        let before = self.client.read(&[address])?[0];
        if before != value {
            self.saved.push((address, before));
            self.client.write_then_read(address, &[value], &[address])?;
        }
        Ok(())
    }

    fn exchange(&mut self) -> Result<Status, DriveError> {
        for _ in 0..PATIENCE {
            self.command.sequence = self.command.sequence.wrapping_add(1);
            let sequence = self.command.sequence;
            let mut words = [0; MAX_WORDS];
            let Some(request) = self.command.emit_request(self.channels, &mut words) else {
                return Err(DriveError::Silent); // a command of this board fits a frame
            };
            let answer =
                self.client
                    .once(request, sequence..=sequence, status_words(self.channels));
            if let Ok(Some((_, words))) = answer
                && let Ok(status) = Status::parse(&words, self.channels)
            {
                return Ok(status);
            }
        }
        Err(DriveError::Silent)
    }

    /// An exchange of an armed board.
    fn live(&mut self) -> Result<Status, DriveError> {
        self.time.pause(EVERY);
        let status = self.exchange()?;
        match status.state.enabled {
            true => Ok(status),
            false => Err(DriveError::Stopped(status.state.reason)),
        }
    }

    /// What is so some time after the last command.
    fn settled(&mut self) -> Result<Status, DriveError> {
        self.live()?;
        self.time.pause(SETTLE);
        self.live()
    }

    fn arm(&mut self) -> Result<(), DriveError> {
        self.command.enable = true;
        self.command.enable_request = false;
        self.exchange()?;
        self.command.enable_request = true;
        let mut state = None;
        for _ in 0..PATIENCE {
            self.time.pause(EVERY);
            let status = self.exchange()?;
            if status.state.enabled {
                return Ok(());
            }
            state = Some(status.state);
        }
        let why = match state {
            Some(state) if state.estop => "an e-stop input is active".to_owned(),
            Some(state) if state.external_reset => "the external reset pin is active".to_owned(),
            Some(state) => format!("{}, {}", state.state, state.reason),
            None => String::new(),
        };
        Err(DriveError::NotArmed { why })
    }

    fn disarm(&mut self) {
        (self.command.enable, self.command.enable_request) = (false, false);
        self.command.stepgen = [(Velocity(0), Accel::UNLIMITED); 16];
        self.command.stepgen_enable = 0;
        for _ in 0..PATIENCE {
            match self.exchange() {
                Ok(status) if !status.state.enabled => return,
                Ok(_) => self.time.pause(EVERY),
                Err(_) => return, // the watchdog does it
            }
        }
    }

    /// The pads' levels; none if the gateware does not read them.
    fn pads(&mut self) -> Result<Option<Pads>, DriveError> {
        if !self.readback {
            return Ok(None);
        }
        let words = self.client.read_from(map::PADS, map::PADS_WORDS as usize)?;
        Ok(words.try_into().ok())
    }

    /// Each general output high and low, one after the other: what its register says and its pad,
    /// and which inputs and which other pads follow. `numbers` are those of the outputs there are.
    pub fn outputs(
        &mut self,
        names: &[String],
        numbers: &[usize],
    ) -> Result<Vec<Output>, DriveError> {
        let invert = self.per_output(INVERT)?;
        self.arm()?;
        let rest = self.command.gpio_out;
        let mut found = Vec::new();
        for n in numbers.iter().copied() {
            let mut output = Output {
                name: names[n].clone(),
                ..Output::default()
            };
            let own = [output_pad(n)];
            let (mut follows, mut others) = (u64::MAX, Follow::new(&own));
            let mut before = None;
            for level in LEVELS {
                let ordered = level != (invert >> n & 1 != 0);
                self.command.gpio_out = rest & !(1 << n) | u64::from(ordered) << n;
                let inputs = self.settled()?.gpio_in;
                let seen = gather::driven(&mut self.client, self.channels)? >> n & 1 != 0;
                output.levels.push((level, seen));
                if let Some(pads) = self.pads()? {
                    output.pad.push((level, of_output(&pads, n)));
                    others.see(level, pads);
                }
                if let Some((then, was)) = before.replace((level, inputs)) {
                    let changed = was ^ inputs;
                    follows &= if then == level { !changed } else { changed };
                }
            }
            self.command.gpio_out = rest;
            self.settled()?;
            output.joined = others.names(names);
            if let Some((level, _)) = output.pad.iter().find(|(level, seen)| level != seen) {
                let partners = self.partners(n, *level, invert, names)?;
                output.joined.extend(partners);
            }
            output.inputs = { self.inputs.iter().copied() }
                .filter(|input| follows >> input & 1 != 0)
                .collect();
            found.push(output);
        }
        self.disarm();
        Ok(found)
    }

    /// The outputs that have to be driven to this level as well for the pad of output `n` to have
    /// it.
    fn partners(
        &mut self,
        n: usize,
        level: bool,
        invert: u64,
        names: &[String],
    ) -> Result<Vec<String>, DriveError> {
        let rest = self.command.gpio_out;
        let put = |word: u64, n: usize| {
            let ordered = level != (invert >> n & 1 != 0);
            word & !(1 << n) | u64::from(ordered) << n
        };
        let mut partners = Vec::new();
        for other in (0..names.len()).filter(|other| *other != n) {
            self.command.gpio_out = put(put(rest, n), other);
            self.settled()?;
            if let Some(pads) = self.pads()?
                && of_output(&pads, n) == level
            {
                partners.push(format!("output {}", names[other]));
            }
        }
        self.command.gpio_out = rest;
        self.settled()?;
        Ok(partners)
    }

    /// The pins of each step generator, a step at a time, and of each PWM, off and fully on: what
    /// their pads do. Nothing if the gateware does not read them. `outputs` are the general
    /// outputs' names.
    pub fn motion(
        &mut self,
        motors: &[Pins],
        pwms: &[Pins],
        outputs: &[String],
    ) -> Result<Vec<Output>, DriveError> {
        if !self.readback {
            return Ok(Vec::new());
        }
        for n in 0..motors.len() {
            self.motor(n, StepType::Quadrature)?;
        }
        for n in 0..pwms.len() as u32 {
            let at = map::CONFIG_PWM + n * map::CONFIG_STRIDE;
            self.set(at, PWM_PERIOD)?;
            self.set(at + 4, 0)?;
        }
        self.arm()?;
        let mut found = Vec::new();
        for (n, pins) in motors.iter().enumerate() {
            found.extend(self.motor_pads(n, pins, outputs)?);
        }
        for (n, pins) in pwms.iter().enumerate() {
            found.extend(self.pwm_pads(n, pins, outputs)?);
        }
        self.disarm();
        Ok(found)
    }

    fn motor_pads(
        &mut self,
        n: usize,
        pins: &Pins,
        outputs: &[String],
    ) -> Result<Vec<Output>, DriveError> {
        self.command.stepgen_enable = 1 << n;
        self.command.stepgen[n] = (Velocity::from_hz(LOOKED_AT, self.hz), Accel::UNLIMITED);
        let mut moments: Vec<(i64, Pads)> = Vec::new();
        let deadline = self.time.now() + Duration::from_secs(2);
        while moments.len() < MOMENTS && self.time.now() < deadline {
            let before = self.live()?.stepgen[n].0.pulses();
            let pads = self.pads()?;
            let same = self.exchange()?.stepgen[n].0.pulses() == before;
            // The same before and after, so the pads were looked at between two steps.
            if let (true, Some(pads)) = (same, pads)
                && moments.last().is_none_or(|(count, _)| *count != before)
            {
                moments.push((before, pads));
            }
        }
        self.command.stepgen[n].0 = Velocity(0);
        self.settled()?;
        self.command.stepgen_enable = 0;
        // A leads B, and in which of the four states it begins is not known: as most pins say.
        let high = |begin: i64, count: i64, second: bool| {
            let phase = (count + begin).rem_euclid(4);
            match second {
                false => matches!(phase, 1 | 2),
                true => phase >= 2,
            }
        };
        let right = |begin: i64| -> usize {
            let seen = |(count, pads): &(i64, Pads)| {
                let agrees = |pin: &&Pin| {
                    pin.level(pads) == (high(begin, *count, pin.second) != pin.inverted)
                };
                pins.pins.iter().filter(agrees).count()
            };
            moments.iter().map(seen).sum()
        };
        let begin = (0..4).max_by_key(|begin| right(*begin)).unwrap_or(0);
        Ok(pins.judge(outputs, |pin| {
            let ordered = |(count, pads): &(i64, Pads)| {
                (high(begin, *count, pin.second) != pin.inverted, *pads)
            };
            moments.iter().map(ordered).collect()
        }))
    }

    fn pwm_pads(
        &mut self,
        n: usize,
        pins: &Pins,
        outputs: &[String],
    ) -> Result<Vec<Output>, DriveError> {
        let mut moments = Vec::new();
        for (level, direction) in LEVELS.into_iter().zip(DIRECTIONS) {
            let width = (u32::from(level) * PWM_PERIOD) << PWM_FRACTION;
            let direction_bit = if direction { PWM_DIRECTION } else { 0 };
            self.command.pwm[n] = PWM_ENABLE | width | direction_bit;
            self.settled()?;
            if let Some(pads) = self.pads()? {
                moments.push((level, direction, pads));
            }
        }
        self.command.pwm[n] = 0;
        self.settled()?;
        Ok(pins.judge(outputs, |pin| {
            let ordered = |(first, second, pads): &(bool, bool, Pads)| {
                (if pin.second { *second } else { *first }, *pads)
            };
            moments.iter().map(ordered).collect()
        }))
    }

    /// A level through a jumper: from an output, a PWM's pin, or a step generator's pins a step at
    /// a time.
    pub fn levels(&mut self, jumper: &Loop, input: usize) -> Result<Levels, DriveError> {
        let mut levels = Levels {
            name: jumper.text.clone(),
            driven: Vec::new(),
            inputs: Vec::new(),
            wanted: input,
            there: self.inputs.clone(),
        };
        match jumper.source {
            Source::Output(n) => self.output_levels(n, &mut levels)?,
            Source::Pwm(n) => self.pwm_levels(n, &mut levels)?,
            Source::Step(n) | Source::Dir(n) => self.step_levels(n, &mut levels)?,
        }
        self.disarm();
        Ok(levels)
    }

    fn output_levels(&mut self, n: usize, levels: &mut Levels) -> Result<(), DriveError> {
        let inverted = self.per_output(INVERT)? >> n & 1 != 0;
        self.arm()?;
        let rest = self.command.gpio_out;
        for level in LEVELS {
            self.command.gpio_out = rest & !(1 << n) | u64::from(level != inverted) << n;
            levels.inputs.push(self.settled()?.gpio_in);
        }
        self.command.gpio_out = rest;
        levels.driven = vec![LEVELS.to_vec()];
        Ok(())
    }

    fn pwm_levels(&mut self, n: usize, levels: &mut Levels) -> Result<(), DriveError> {
        let at = map::CONFIG_PWM + n as u32 * map::CONFIG_STRIDE;
        self.set(at, PWM_PERIOD)?;
        self.set(at + 4, 0)?;
        self.arm()?;
        for level in LEVELS {
            let width = (u32::from(level) * PWM_PERIOD) << PWM_FRACTION;
            self.command.pwm[n] = PWM_ENABLE | width;
            levels.inputs.push(self.settled()?.gpio_in);
        }
        self.command.pwm[n] = 0;
        levels.driven = vec![LEVELS.to_vec()];
        Ok(())
    }

    /// In quadrature a step is one edge, and the levels stay until the next. Which of the four
    /// states it begins in is not known.
    fn step_levels(&mut self, n: usize, levels: &mut Levels) -> Result<(), DriveError> {
        self.motor(n, StepType::Quadrature)?;
        self.arm()?;
        self.command.stepgen_enable = 1 << n;
        self.command.stepgen[n] = (Velocity::from_hz(SLOW, self.hz), Accel::UNLIMITED);
        let (mut last, mut counts) = (None, Vec::new());
        let deadline = self.time.now() + Duration::from_secs(2);
        while counts.len() < 2 * LEVELS.len() && self.time.now() < deadline {
            let status = self.live()?;
            let count = status.stepgen[n].0.pulses();
            // Twice the same, so the level has been there for a while.
            if last == Some(count) && counts.last() != Some(&count) {
                counts.push(count);
                levels.inputs.push(status.gpio_in);
            }
            last = Some(count);
        }
        self.command.stepgen[n].0 = Velocity(0);
        self.settled()?;
        let pattern = |begin: i64| -> Vec<bool> {
            let high = |count: &i64| matches!((count + begin).rem_euclid(4), 1 | 2);
            counts.iter().map(high).collect()
        };
        levels.driven = (0..4).map(pattern).collect();
        Ok(())
    }

    /// A step generator with ordinary timing, no polarity, and this way of speaking.
    fn motor(&mut self, n: usize, kind: StepType) -> Result<(), DriveError> {
        let at = map::CONFIG_STEPGEN + n as u32 * map::CONFIG_STRIDE;
        let micros = |us: f64| (us * 1e-6 * self.hz) as u32;
        let mode = (kind as u32) << map::STEPGEN_TYPE_SHIFT;
        for (word, value) in [
            (StepgenConfig::Steplen, micros(10.0)),
            (StepgenConfig::Stepspace, micros(10.0)),
            (StepgenConfig::Dirsetup, micros(50.0)),
            (StepgenConfig::Dirhold, micros(50.0)),
            (StepgenConfig::StopAccel, 0),
            (StepgenConfig::Mode, mode),
        ] {
            self.set(at + 4 * word as u32, value)?;
        }
        Ok(())
    }

    fn encoders(&mut self, mode: CountMode) -> Result<(), DriveError> {
        for n in 0..u32::from(self.channels.encoders) {
            self.set(map::CONFIG_ENCODER + n * map::CONFIG_STRIDE, mode as u32)?;
        }
        Ok(())
    }

    /// Pulses of a step generator through a jumper into an encoder: forwards, then backwards.
    pub fn counts(&mut self, jumper: &Loop, steps: u32) -> Result<Counts, DriveError> {
        let (Source::Step(stepgen), Sink::Encoder(encoder)) = (jumper.source, jumper.sink) else {
            return Ok(Counts::default()); // refused where it was read
        };
        self.motor(stepgen, StepType::StepDir)?;
        self.encoders(CountMode::StepDir)?;
        let mut counts = Counts {
            name: jumper.text.clone(),
            ..Counts::default()
        };
        let moved = self.there_and_back(stepgen, steps)?;
        (counts.forward, counts.backward) = (moved[0].0, moved[1].0);
        counts.counted_forward = moved[0].1[encoder];
        counts.counted_backward = moved[1].1[encoder];
        counts.others = (0..usize::from(self.channels.encoders))
            .filter(|n| *n != encoder && moved.iter().any(|(_, counted)| counted[*n].abs() > 1))
            .collect();
        if moved.iter().all(|(_, counted)| counted[encoder].abs() <= 1) {
            self.encoders(CountMode::UpDown)?;
            let moved = self.there_and_back(stepgen, steps)?;
            counts.up_down = Some((moved[0].1[encoder], moved[1].1[encoder]));
        }
        Ok(counts)
    }

    /// Pulses, and what each encoder counted, both ways.
    fn there_and_back(
        &mut self,
        stepgen: usize,
        steps: u32,
    ) -> Result<[(i64, [i64; 16]); 2], DriveError> {
        self.arm()?;
        self.command.stepgen_enable = 1 << stepgen;
        let ways = [
            self.way(stepgen, steps, 1.0)?,
            self.way(stepgen, steps, -1.0)?,
        ];
        self.disarm();
        Ok(ways)
    }

    fn way(&mut self, n: usize, steps: u32, sign: f64) -> Result<(i64, [i64; 16]), DriveError> {
        let begin = self.settled()?;
        let accel = Accel::from_steps(VELOCITY * 50.0, self.hz);
        self.command.stepgen[n] = (Velocity::from_hz(sign * VELOCITY, self.hz), accel);
        let pulses = |status: &Status| status.stepgen[n].0.pulses() - begin.stepgen[n].0.pulses();
        let deadline =
            self.time.now() + Duration::from_secs_f64(2.0 + 3.0 * f64::from(steps) / VELOCITY);
        while pulses(&self.live()?).abs() < i64::from(steps) && self.time.now() < deadline {}
        self.command.stepgen[n].0 = Velocity(0);
        let mut end = self.settled()?;
        while end.stepgen[n].1 != Velocity(0) && self.time.now() < deadline {
            end = self.settled()?;
        }
        // The last pulse has come by then.
        let end = self.settled()?;
        let counted = |n: usize| i64::from(end.encoder[n].count.since(begin.encoder[n].count));
        Ok((pulses(&end), std::array::from_fn(counted)))
    }
}
