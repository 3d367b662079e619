//! The exchange: one datagram each way per servo period.
//!
//! The host writes a whole [command block](Command) to [`crate::map::COMMAND`]. Unlike every other
//! write, this one is answered: with one record that holds the [status block](Status); its base
//! write address is the command's sequence number. The board checks everything, commits every
//! channel on one clock and samples every channel on one clock.
//!
//! ```text
//!         command                                        status
//!  0      session token                           0      state word
//!  1      sequence number                         1      sequence number echoed
//!  2      flags, stepgen alone 31:16             2, 3   arrival time    lo, hi   clocks
//!  3, 4   apply time lo, hi   clocks              4, 5   sample time     lo, hi   clocks
//!  5      stepgen enable 15:0                     6      watchdog left at arrival, clocks
//!         encoder index arm 31:16                 7      datagrams refused since boot
//!  6      gpio outputs 31:0                       8      boot id
//!  7      stepgen index arm 15:0                  9      e-stop inputs latched
//!         encoder probe arm 31:16                10      gpio inputs 31:0
//!  8      stepgen probe arm 15:0                 11      encoder index latched 15:0
//!         latch select 20:16                             stepgen rate limited 31:16
//!  9..    per stepgen: velocity, acceleration    12      stepgen index latched 15:0
//!  then   per pwm: width | dir | enable                  encoder probe latched 31:16
//!                                                13      stepgen probe latched 15:0
//!                                                        encoder illegal 31:16
//!                                                14      the selected channel's latch
//!                                                15..    per stepgen: position lo, hi, velocity
//!  then   gpio outputs 63:32                      then    per encoder: count, edge
//!                                                then    gpio inputs 63:32
//! ```
//!
//! Only a board with more than 32 outputs has the last word of a command, and one with more than 32
//! inputs that of a status.
//!
//! # Latches
//!
//! A channel has one latch, for the index or the probe: the armed one that comes first sets it. Its
//! flag in the status block says that it holds a value; flag and value stay until the arm bit that
//! set it falls. One value comes per exchange: a host that sees a flag selects that [`Latch`] in
//! its next command and finds the value in the answer. A lost frame only delays this.

use crate::channels::Channels;
use crate::regmap::{command, pwm, status};
use crate::services::JobsState;
use crate::state::{FaultReason, LinkSpeed, State};
use crate::units::{Accel, Clocks, Count, Position, Velocity};
use crate::{Refusal, etherbone, map};

pub use crate::channels::MAX_CHANNELS;

/// Words before the first stepgen in a command block.
pub const COMMAND_HEAD: usize = command_word::PROBE_ARMS + 1;
/// Words per stepgen in a command block: as on the register page, so that they are copied.
pub const COMMAND_STEPGEN: usize = command::STEPGEN_STRIDE;
/// Words before the first stepgen in a status block.
pub const STATUS_HEAD: usize = status_word::LATCH + 1;
/// Words per stepgen in a status block: as on the register page.
pub const STATUS_STEPGEN: usize = status::STEPGEN_STRIDE;
/// Words per encoder in a status block: as on the register page.
pub const STATUS_ENCODER: usize = status::ENCODER_STRIDE;

/// Longest command block: the maximum board's.
pub const COMMAND_MAX: usize = COMMAND_HEAD + MAX_CHANNELS * (COMMAND_STEPGEN + 1) + 1;
/// Longest status block: the maximum board's.
pub const STATUS_MAX: usize = STATUS_HEAD + MAX_CHANNELS * (STATUS_STEPGEN + STATUS_ENCODER) + 1;

// Both must be one Etherbone record: its counts are 8 bits wide.
const _: () = assert!(COMMAND_MAX <= 255 && STATUS_MAX <= 255);

/// Words of a request before its command block: packet header, record header, base address.
pub const REQUEST_OVERHEAD: usize = etherbone::OVERHEAD;

/// Words of a command block before those of the channels, [`COMMAND_HEAD`] of them.
pub mod command_word {
    /// Session token.
    pub const TOKEN: usize = 0;
    /// Sequence number.
    pub const SEQUENCE: usize = 1;
    /// Flags, and the stepgens that move alone.
    pub const FLAGS: usize = 2;
    /// Apply time, low.
    pub const APPLY_LO: usize = 3;
    /// Apply time, high.
    pub const APPLY_HI: usize = 4;
    /// Stepgen enables 15:0, encoder index arms 31:16.
    pub const ENABLES: usize = 5;
    /// Outputs 0 to 31.
    pub const GPIO_OUT: usize = 6;
    /// Stepgen index arms 15:0, encoder probe arms 31:16.
    pub const ARMS: usize = 7;
    /// Stepgen probe arms 15:0, then the code of a [`super::Latch`].
    pub const PROBE_ARMS: usize = 8;
    /// Where in that word the code of the latch begins.
    pub const LATCH_SHIFT: u32 = 16;
    /// Bits of that code.
    pub const LATCH_BITS: u32 = 5;
}

/// Words of a status block before those of the channels, [`STATUS_HEAD`] of them.
pub mod status_word {
    /// The state word.
    pub const STATE: usize = 0;
    /// The command's sequence number.
    pub const SEQUENCE: usize = 1;
    /// Arrival time, low.
    pub const ARRIVAL_LO: usize = 2;
    /// Arrival time, high.
    pub const ARRIVAL_HI: usize = 3;
    /// Sample time, low.
    pub const SAMPLE_LO: usize = 4;
    /// Sample time, high.
    pub const SAMPLE_HI: usize = 5;
    /// What was left of the watchdog's time.
    pub const WATCHDOG_LEFT: usize = 6;
    /// Datagrams refused.
    pub const REFUSED: usize = 7;
    /// Boot id.
    pub const BOOT_ID: usize = 8;
    /// Latched e-stop inputs.
    pub const ESTOP: usize = 9;
    /// Inputs 0 to 31.
    pub const GPIO_IN: usize = 10;
    /// Encoder index latched 15:0, stepgen rate limited 31:16.
    pub const FLAGS0: usize = 11;
    /// Stepgen index latched 15:0, encoder probe latched 31:16.
    pub const FLAGS1: usize = 12;
    /// Stepgen probe latched 15:0, encoder illegal 31:16.
    pub const FLAGS2: usize = 13;
    /// The latch of the selected channel.
    pub const LATCH: usize = 14;
}

/// Bit of the flags word: the machine is allowed to move.
pub const FLAG_ENABLE: u32 = 1 << 0;
/// Bit of the flags word: its rising edge asks to arm.
pub const FLAG_ENABLE_REQUEST: u32 = 1 << 1;
/// Bit of the flags word: apply at the given time instead of at once.
pub const FLAG_APPLY_TIME: u32 = 1 << 2;

/// Bits of the flags word from here on, one per stepgen: [`Command::stepgen_alone`].
pub const FLAG_ALONE_SHIFT: u32 = 16;

/// A PWM's word: bits 28:0 active time per period, in 1/256 clock; only dither uses the fraction.
pub const PWM_WIDTH_MASK: u32 = command::PWM0_WIDTH_WIDTH;
/// Fraction bits of a PWM's width.
pub const PWM_FRACTION: u32 = 8;
/// Longest PWM period, in clocks: 21 bits, 35 ms at 60 MHz.
pub const PWM_PERIOD_MAX: u32 = pwm::PERIOD_CLOCKS;
/// A PWM's word: the output is live.
pub const PWM_ENABLE: u32 = command::PWM0_WIDTH_ENABLE;
/// A PWM's word: direction, for the modes that have one.
pub const PWM_DIRECTION: u32 = command::PWM0_WIDTH_DIRECTION;

/// Bits of an encoder's edge word that hold the time; the upper 8 count illegal transitions.
pub const EDGE_TIME_BITS: u32 = status::ENCODER0_EDGE_ERRORS_SHIFT;

/// The latch that an answer carries.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Latch {
    /// Encoder n: its count at the index or probe.
    Encoder(u8),
    /// Stepgen n: its pulses at the index or probe.
    Stepgen(u8),
}

impl Default for Latch {
    fn default() -> Self {
        Latch::Encoder(0)
    }
}

impl Latch {
    /// Its 5-bit code: encoders first.
    pub const fn code(self) -> u32 {
        match self {
            Latch::Encoder(n) => n as u32 & 15,
            Latch::Stepgen(n) => 16 | n as u32 & 15,
        }
    }

    /// The latch with this code; every 5-bit number is one.
    pub const fn from_code(code: u32) -> Self {
        let n = (code & 15) as u8;
        if code & 16 == 0 {
            Latch::Encoder(n)
        } else {
            Latch::Stepgen(n)
        }
    }
}

/// The host's command for a whole board and the next servo period.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Command {
    /// Session token.
    pub token: u32,
    /// Sequence number; each must be ahead of the last by less than 2^31.
    pub sequence: u32,
    /// The machine is allowed to move.
    pub enable: bool,
    /// Rising edge asks to arm.
    pub enable_request: bool,
    /// When to apply; `None` is at once.
    pub apply_at: Option<Clocks>,
    /// One bit per stepgen.
    pub stepgen_enable: u16,
    /// One bit per stepgen: it shares no path with the others (velocity mode). In a soft stop it
    /// brakes as configured, while the others reach rest together.
    pub stepgen_alone: u16,
    /// One bit per encoder: latch the count at the next index.
    pub index_arm: u16,
    /// One bit per encoder: latch the count when the probe trips.
    pub probe_arm: u16,
    /// One bit per stepgen: latch the pulses at the next index.
    pub stepgen_index_arm: u16,
    /// One bit per stepgen: latch the pulses when the probe trips.
    pub stepgen_probe_arm: u16,
    /// The latch that the answer has to carry.
    pub latch: Latch,
    /// GPIO outputs, one bit per output.
    pub gpio_out: u64,
    /// Velocity target and acceleration limit per stepgen.
    pub stepgen: [(Velocity, Accel); MAX_CHANNELS],
    /// PWM words per channel ([`PWM_WIDTH_MASK`], [`PWM_ENABLE`], [`PWM_DIRECTION`]).
    pub pwm: [u32; MAX_CHANNELS],
}

impl Default for Command {
    fn default() -> Self {
        Command {
            token: 0,
            sequence: 0,
            enable: false,
            enable_request: false,
            apply_at: None,
            stepgen_enable: 0,
            stepgen_alone: 0,
            index_arm: 0,
            probe_arm: 0,
            stepgen_index_arm: 0,
            stepgen_probe_arm: 0,
            latch: Latch::default(),
            gpio_out: 0,
            stepgen: [(Velocity(0), Accel::UNLIMITED); MAX_CHANNELS],
            pwm: [0; MAX_CHANNELS],
        }
    }
}

/// The board's status, once per servo period. Everything was sampled on one clock.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Status {
    /// State, reason and flags.
    pub state: StateWord,
    /// The sequence number of the command this answers.
    pub sequence: u32,
    /// When the last byte of the command had arrived.
    pub arrival: Clocks,
    /// When everything below was sampled.
    pub sample: Clocks,
    /// Clocks the watchdog had left when the command arrived.
    pub watchdog_left: u32,
    /// Datagrams refused since boot.
    pub refused: Count,
    /// Changes with every start of the firmware.
    pub boot_id: u32,
    /// E-stop inputs that have tripped, one bit per input; latched until cleared. They are among
    /// the first 32.
    pub estop: u32,
    /// GPIO inputs, one bit per input.
    pub gpio_in: u64,
    /// One bit per encoder: the index came, its latch is valid.
    pub index_latched: u16,
    /// One bit per encoder: the probe tripped, its latch is valid.
    pub probe_latched: u16,
    /// One bit per encoder: A and B changed together since the sample before.
    pub illegal: u16,
    /// One bit per stepgen: the DDS had to wait for the step timing since the last sample.
    pub rate_limited: u16,
    /// One bit per stepgen: the index came, its latch is valid.
    pub stepgen_index_latched: u16,
    /// One bit per stepgen: the probe tripped, its latch is valid.
    pub stepgen_probe_latched: u16,
    /// The latch the command selected.
    pub latch: Count,
    /// Position and present velocity per stepgen.
    pub stepgen: [(Position, Velocity); MAX_CHANNELS],
    /// Per encoder.
    pub encoder: [EncoderStatus; MAX_CHANNELS],
}

/// One encoder's words in a status block.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct EncoderStatus {
    /// Quadrature count, wraps.
    pub count: Count,
    /// Low 24 bits of the clock at the last counted edge.
    pub edge_time: u32,
    /// Illegal transitions since power-up, modulo 256.
    pub errors: u8,
}

impl EncoderStatus {
    /// From its two words.
    pub const fn from_words([count, edge]: [u32; STATUS_ENCODER]) -> Self {
        EncoderStatus {
            count: Count(count),
            edge_time: edge & ((1 << EDGE_TIME_BITS) - 1),
            errors: (edge >> EDGE_TIME_BITS) as u8,
        }
    }

    /// As its two words.
    pub const fn to_words(self) -> [u32; STATUS_ENCODER] {
        let time = self.edge_time & ((1 << EDGE_TIME_BITS) - 1);
        [self.count.0, (self.errors as u32) << EDGE_TIME_BITS | time]
    }
}

/// The first word of a status block.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StateWord {
    /// State of the safety state machine.
    pub state: State,
    /// Why it stopped last.
    pub reason: FaultReason,
    /// No step was lost or invented since the positions were last synchronised with the machine.
    pub position_trusted: bool,
    /// The gate is open: outputs are live.
    pub enabled: bool,
    /// The recipient of this answer owns the session.
    pub session_yours: bool,
    /// The watchdog's latched bite.
    pub bitten: bool,
    /// The external reset pin right now.
    pub external_reset: bool,
    /// The command this answers was executed (false: only answered).
    pub accepted: bool,
    /// The Ethernet link is up.
    pub link: bool,
    /// An e-stop input has tripped; latched.
    pub estop: bool,
    /// The link's speed.
    pub speed: LinkSpeed,
    /// What became of the services.
    pub services: JobsState,
    /// Frames the MAC dropped since power-up (CRC, preamble, no slot free), modulo 256.
    pub link_errors: u8,
}

impl StateWord {
    /// Lowest bit of the link's speed: above the state, which never needs six bits.
    pub const SPEED_SHIFT: u32 = 6;
    /// Lowest bit of the services' state: above the reason, which never needs more than four bits.
    pub const SERVICES_SHIFT: u32 = 12;
    /// Lowest bit of the count of errors.
    pub const ERRORS_SHIFT: u32 = 24;
    /// The bit of `enabled`.
    pub const ENABLED: u32 = 1 << 17;
    /// The bit of `session_yours`.
    pub const SESSION_YOURS: u32 = 1 << 18;
    /// The bit of `accepted`.
    pub const ACCEPTED: u32 = 1 << 21;

    /// As a word.
    pub const fn to_word(self) -> u32 {
        self.state as u32
            | (self.speed as u32) << Self::SPEED_SHIFT
            | (self.link_errors as u32) << Self::ERRORS_SHIFT
            | (self.reason as u32) << 8
            | (self.services as u32) << Self::SERVICES_SHIFT
            | (self.position_trusted as u32) << 16
            | (self.enabled as u32 * Self::ENABLED)
            | (self.session_yours as u32 * Self::SESSION_YOURS)
            | (self.bitten as u32) << 19
            | (self.external_reset as u32) << 20
            | (self.accepted as u32 * Self::ACCEPTED)
            | (self.link as u32) << 22
            | (self.estop as u32) << 23
    }

    /// From a word; refused if it has a state, a reason or a state of the services that this
    /// version does not know.
    pub const fn from_word(word: u32) -> Result<Self, Refusal> {
        let (Some(state), Some(reason), Some(speed), Some(services)) = (
            State::from_code(word as u8 & 0x3f),
            FaultReason::from_code((word >> 8) as u8 & 15),
            LinkSpeed::from_code((word >> Self::SPEED_SHIFT) as u8 & 3),
            JobsState::from_code(word >> Self::SERVICES_SHIFT & JobsState::MASK),
        ) else {
            return Err(Refusal::Value);
        };
        Ok(StateWord {
            state,
            reason,
            position_trusted: word >> 16 & 1 != 0,
            enabled: word & Self::ENABLED != 0,
            session_yours: word & Self::SESSION_YOURS != 0,
            bitten: word >> 19 & 1 != 0,
            external_reset: word >> 20 & 1 != 0,
            accepted: word & Self::ACCEPTED != 0,
            link: word >> 22 & 1 != 0,
            estop: word >> 23 & 1 != 0,
            speed,
            services,
            link_errors: (word >> Self::ERRORS_SHIFT) as u8,
        })
    }
}

/// Words in this board's command block.
pub const fn command_words(channels: Channels) -> usize {
    COMMAND_HEAD
        + channels.stepgens as usize * COMMAND_STEPGEN
        + channels.pwms as usize
        + channels.outputs_high()
}

/// Words in this board's status block.
pub const fn status_words(channels: Channels) -> usize {
    STATUS_HEAD
        + channels.stepgens as usize * STATUS_STEPGEN
        + channels.encoders as usize * STATUS_ENCODER
        + channels.inputs_high()
}

impl Command {
    /// Writes the whole request datagram into `buffer`; `None` when it does not fit.
    pub fn emit_request<'b>(&self, channels: Channels, buffer: &'b mut [u32]) -> Option<&'b [u32]> {
        let count = command_words(channels);
        let whole = buffer.get_mut(..REQUEST_OVERHEAD + count)?;
        let (overhead, block) = whole.split_at_mut(REQUEST_OVERHEAD);
        overhead.copy_from_slice(&[
            etherbone::HEADER,
            0,
            etherbone::BYTE_ENABLE | (count as u32) << 8,
            map::COMMAND,
        ]);
        let (head, channels_words) = block.split_first_chunk_mut::<COMMAND_HEAD>()?;
        let apply = self.apply_at.unwrap_or_default().0;
        head[command_word::TOKEN] = self.token;
        head[command_word::SEQUENCE] = self.sequence;
        head[command_word::FLAGS] = (u32::from(self.enable) * FLAG_ENABLE)
            | (u32::from(self.enable_request) * FLAG_ENABLE_REQUEST)
            | (u32::from(self.apply_at.is_some()) * FLAG_APPLY_TIME)
            | u32::from(self.stepgen_alone) << FLAG_ALONE_SHIFT;
        head[command_word::APPLY_LO] = apply as u32;
        head[command_word::APPLY_HI] = (apply >> 32) as u32;
        head[command_word::ENABLES] = pair(self.stepgen_enable, self.index_arm);
        head[command_word::GPIO_OUT] = self.gpio_out as u32;
        head[command_word::ARMS] = pair(self.stepgen_index_arm, self.probe_arm);
        head[command_word::PROBE_ARMS] =
            u32::from(self.stepgen_probe_arm) | self.latch.code() << command_word::LATCH_SHIFT;
        let (steps, pwms) =
            channels_words.split_at_mut(channels.stepgens as usize * COMMAND_STEPGEN);
        let (steps, _) = steps.as_chunks_mut::<COMMAND_STEPGEN>();
        for (words, (velocity, accel)) in steps.iter_mut().zip(&self.stepgen) {
            *words = [velocity.0 as u32, accel.0];
        }
        let (pwms, high) = pwms.split_at_mut(channels.pwms.into());
        for (word, pwm) in pwms.iter_mut().zip(&self.pwm) {
            *word = *pwm;
        }
        for word in high {
            *word = (self.gpio_out >> 32) as u32;
        }
        Some(whole)
    }

    /// Reads a command block of exactly this board's length.
    pub fn parse(words: &[u32], channels: Channels) -> Result<Self, Refusal> {
        if words.len() != command_words(channels) {
            return Err(Refusal::BlockLength);
        }
        let (head, rest) = words
            .split_first_chunk::<COMMAND_HEAD>()
            .ok_or(Refusal::BlockLength)?;
        let flags = head[command_word::FLAGS];
        let enables = head[command_word::ENABLES];
        let arms = head[command_word::ARMS];
        let probe_arms = head[command_word::PROBE_ARMS];
        let apply = [head[command_word::APPLY_LO], head[command_word::APPLY_HI]];
        let mut command = Command {
            token: head[command_word::TOKEN],
            sequence: head[command_word::SEQUENCE],
            enable: flags & FLAG_ENABLE != 0,
            enable_request: flags & FLAG_ENABLE_REQUEST != 0,
            apply_at: (flags & FLAG_APPLY_TIME != 0)
                .then_some(Clocks::from_words(apply[0], apply[1])),
            stepgen_enable: enables as u16,
            stepgen_alone: (flags >> FLAG_ALONE_SHIFT) as u16,
            index_arm: (enables >> 16) as u16,
            gpio_out: head[command_word::GPIO_OUT].into(),
            stepgen_index_arm: arms as u16,
            probe_arm: (arms >> 16) as u16,
            stepgen_probe_arm: probe_arms as u16,
            latch: Latch::from_code(probe_arms >> command_word::LATCH_SHIFT),
            ..Command::default()
        };
        let (steps, pwms) = rest
            .split_at_checked(channels.stepgens as usize * COMMAND_STEPGEN)
            .ok_or(Refusal::BlockLength)?;
        let (steps, _) = steps.as_chunks::<COMMAND_STEPGEN>();
        for (target, &[velocity, accel]) in command.stepgen.iter_mut().zip(steps) {
            *target = (Velocity(velocity as i32), Accel(accel));
        }
        let (pwms, high) = pwms
            .split_at_checked(channels.pwms.into())
            .ok_or(Refusal::BlockLength)?;
        for (target, &word) in command.pwm.iter_mut().zip(pwms) {
            *target = word;
        }
        if let [high] = high {
            command.gpio_out |= u64::from(*high) << 32;
        }
        Ok(command)
    }
}

impl Status {
    /// Writes the status block into `words` (the board's side, for models and tests; the firmware
    /// copies registers directly into the frame). `None` if it does not fit.
    pub fn emit<'b>(&self, channels: Channels, words: &'b mut [u32]) -> Option<&'b [u32]> {
        let block = words.get_mut(..status_words(channels))?;
        let (head, rest) = block.split_first_chunk_mut::<STATUS_HEAD>()?;
        head[status_word::STATE] = self.state.to_word();
        head[status_word::SEQUENCE] = self.sequence;
        head[status_word::ARRIVAL_LO] = self.arrival.0 as u32;
        head[status_word::ARRIVAL_HI] = (self.arrival.0 >> 32) as u32;
        head[status_word::SAMPLE_LO] = self.sample.0 as u32;
        head[status_word::SAMPLE_HI] = (self.sample.0 >> 32) as u32;
        head[status_word::WATCHDOG_LEFT] = self.watchdog_left;
        head[status_word::REFUSED] = self.refused.0;
        head[status_word::BOOT_ID] = self.boot_id;
        head[status_word::ESTOP] = self.estop;
        head[status_word::GPIO_IN] = self.gpio_in as u32;
        head[status_word::FLAGS0] = pair(self.index_latched, self.rate_limited);
        head[status_word::FLAGS1] = pair(self.stepgen_index_latched, self.probe_latched);
        head[status_word::FLAGS2] = pair(self.stepgen_probe_latched, self.illegal);
        head[status_word::LATCH] = self.latch.0;
        let (steps, encoders) = rest.split_at_mut(channels.stepgens as usize * STATUS_STEPGEN);
        let (steps, _) = steps.as_chunks_mut::<STATUS_STEPGEN>();
        for (words, (position, velocity)) in steps.iter_mut().zip(&self.stepgen) {
            *words = [
                position.0 as u32,
                (position.0 >> 32) as u32,
                velocity.0 as u32,
            ];
        }
        let (encoders, high) =
            encoders.split_at_mut(usize::from(channels.encoders) * STATUS_ENCODER);
        let (encoders, _) = encoders.as_chunks_mut::<STATUS_ENCODER>();
        for (words, encoder) in encoders.iter_mut().zip(&self.encoder) {
            *words = encoder.to_words();
        }
        for word in high {
            *word = (self.gpio_in >> 32) as u32;
        }
        Some(block)
    }

    /// Reads a status block of exactly this board's length.
    pub fn parse(words: &[u32], channels: Channels) -> Result<Self, Refusal> {
        if words.len() != status_words(channels) {
            return Err(Refusal::BlockLength);
        }
        let (head, rest) = words
            .split_first_chunk::<STATUS_HEAD>()
            .ok_or(Refusal::BlockLength)?;
        let mut status = Status {
            state: StateWord::from_word(head[status_word::STATE])?,
            sequence: head[status_word::SEQUENCE],
            arrival: Clocks::from_words(
                head[status_word::ARRIVAL_LO],
                head[status_word::ARRIVAL_HI],
            ),
            sample: Clocks::from_words(head[status_word::SAMPLE_LO], head[status_word::SAMPLE_HI]),
            watchdog_left: head[status_word::WATCHDOG_LEFT],
            refused: Count(head[status_word::REFUSED]),
            boot_id: head[status_word::BOOT_ID],
            estop: head[status_word::ESTOP],
            gpio_in: head[status_word::GPIO_IN].into(),
            index_latched: head[status_word::FLAGS0] as u16,
            rate_limited: (head[status_word::FLAGS0] >> 16) as u16,
            stepgen_index_latched: head[status_word::FLAGS1] as u16,
            probe_latched: (head[status_word::FLAGS1] >> 16) as u16,
            stepgen_probe_latched: head[status_word::FLAGS2] as u16,
            illegal: (head[status_word::FLAGS2] >> 16) as u16,
            latch: Count(head[status_word::LATCH]),
            stepgen: [(Position::ZERO, Velocity(0)); MAX_CHANNELS],
            encoder: [EncoderStatus::default(); MAX_CHANNELS],
        };
        let (steps, encoders) = rest
            .split_at_checked(channels.stepgens as usize * STATUS_STEPGEN)
            .ok_or(Refusal::BlockLength)?;
        let (steps, _) = steps.as_chunks::<STATUS_STEPGEN>();
        for (target, &[lo, hi, velocity]) in status.stepgen.iter_mut().zip(steps) {
            *target = (Position::from_words(lo, hi), Velocity(velocity as i32));
        }
        let (encoders, high) = encoders
            .split_at_checked(usize::from(channels.encoders) * STATUS_ENCODER)
            .ok_or(Refusal::BlockLength)?;
        if let [high] = high {
            status.gpio_in |= u64::from(*high) << 32;
        }
        let (encoders, _) = encoders.as_chunks::<STATUS_ENCODER>();
        for (target, words) in status.encoder.iter_mut().zip(encoders) {
            *target = EncoderStatus::from_words(*words);
        }
        Ok(status)
    }

    /// Reads a whole reply datagram: one record with the sequence number as its base.
    pub fn parse_reply(words: &[u32], channels: Channels) -> Result<Self, Refusal> {
        let packet = etherbone::Packet::new_checked(words)?;
        let mut records = packet.records();
        let (Some(record), None) = (records.next(), records.next()) else {
            return Err(Refusal::NotAlone);
        };
        let status = Status::parse(record.writes, channels)?;
        if status.sequence != record.write_base {
            return Err(Refusal::Value);
        }
        Ok(status)
    }
}

/// Two sets of 16 flags in a word, the first in its low half.
const fn pair(low: u16, high: u16) -> u32 {
    low as u32 | (high as u32) << 16
}

/// Judges a sequence number against the last accepted one.
pub const fn judge_sequence(sequence: u32, last: u32) -> Result<(), Refusal> {
    match sequence.wrapping_sub(last) as i32 {
        0 => Err(Refusal::Duplicate),
        ahead if ahead > 0 => Ok(()),
        _ => Err(Refusal::Stale),
    }
}

#[cfg(test)]
mod tests;
