//! The exchange: one datagram each way per servo period.
//!
//! The host writes a whole [command block](Command) to [`crate::map::COMMAND`]; unlike every other
//! write this one is answered: one record with the [status block](Status), its base write address
//! carrying the command's sequence number. The board checks everything, commits every channel on one
//! clock and samples every channel on one clock.
//!
//! ```text
//!         command                                        status
//!  0      session token                           0      state word
//!  1      sequence number                         1      sequence number echoed
//!  2      flags                                   2, 3   arrival time    lo, hi   clocks
//!  3, 4   apply time lo, hi   clocks              4, 5   sample time     lo, hi   clocks
//!  5      enables: stepgen 15:0, index arm 31:16  6      watchdog left at arrival, clocks
//!  6      gpio outputs                            7      datagrams refused since boot
//!  7..    per stepgen: rate, acceleration         8      boot id
//!  then   per pwm: width | dir | enable           9      link
//!                                                10      gpio inputs
//!                                                11      index latched 15:0, rate limited 31:16
//!                                                12..    per stepgen: position lo, hi, rate
//!                                                then    per encoder: count, latch, edge time
//! ```

use crate::describe::Channels;
use crate::state::{FaultReason, State};
use crate::units::{Accel, Clocks, Count, Position, StepRate};
use crate::{Refusal, etherbone, map};

/// Most stepgens, encoders and PWMs a board can have.
pub const MAX_CHANNELS: usize = 16;

/// Words before the first stepgen in a command block.
pub const COMMAND_HEAD: usize = 7;
/// Words per stepgen in a command block.
pub const COMMAND_STEPGEN: usize = 2;
/// Words before the first stepgen in a status block.
pub const STATUS_HEAD: usize = 12;
/// Words per stepgen in a status block.
pub const STATUS_STEPGEN: usize = 3;
/// Words per encoder in a status block.
pub const STATUS_ENCODER: usize = 3;

/// Longest command block: the maximum board's.
pub const COMMAND_MAX: usize = COMMAND_HEAD + MAX_CHANNELS * (COMMAND_STEPGEN + 1);
/// Longest status block: the maximum board's.
pub const STATUS_MAX: usize = STATUS_HEAD + MAX_CHANNELS * (STATUS_STEPGEN + STATUS_ENCODER);

// Both must be one Etherbone record: its counts are 8 bits wide.
const _: () = assert!(COMMAND_MAX <= 255 && STATUS_MAX <= 255);

/// Words of a request before its command block: packet header, record header, base address.
pub const REQUEST_OVERHEAD: usize = etherbone::HEADER_WORDS + 2;

/// Bit of the flags word: the machine is allowed to move.
pub const FLAG_ENABLE: u32 = 1 << 0;
/// Bit of the flags word: its rising edge asks to arm.
pub const FLAG_ENABLE_REQUEST: u32 = 1 << 1;
/// Bit of the flags word: apply at the given time instead of at once.
pub const FLAG_APPLY_TIME: u32 = 1 << 2;

/// A PWM's word: bits 23:0 high time in clocks.
pub const PWM_WIDTH_MASK: u32 = 0x00ff_ffff;
/// A PWM's word: the output is live.
pub const PWM_ENABLE: u32 = 1 << 30;
/// A PWM's word: direction, for the modes that have one.
pub const PWM_DIRECTION: u32 = 1 << 31;

/// What the host wants of a whole board for the next servo period.
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
    /// One bit per encoder: latch the count at the next index.
    pub index_arm: u16,
    /// GPIO outputs.
    pub gpio_out: u32,
    /// Rate target and acceleration limit per stepgen.
    pub stepgen: [(StepRate, Accel); MAX_CHANNELS],
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
            index_arm: 0,
            gpio_out: 0,
            stepgen: [(StepRate(0), Accel::UNLIMITED); MAX_CHANNELS],
            pwm: [0; MAX_CHANNELS],
        }
    }
}

/// What a board says of itself once per servo period. Everything was sampled on one clock.
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
    /// Link state word: reserved, 0.
    pub link: u32,
    /// GPIO inputs.
    pub gpio_in: u32,
    /// One bit per encoder: the index came, `latch` is valid.
    pub index_latched: u16,
    /// One bit per stepgen: the DDS had to wait for the step timing since the last sample.
    pub rate_limited: u16,
    /// Position and present rate per stepgen.
    pub stepgen: [(Position, StepRate); MAX_CHANNELS],
    /// Per encoder.
    pub encoder: [EncoderStatus; MAX_CHANNELS],
}

/// One encoder's words in a status block.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct EncoderStatus {
    /// Quadrature count, wraps.
    pub count: Count,
    /// Count at the index.
    pub latch: Count,
    /// Low half of the clock at the last edge.
    pub edge_time: u32,
}

/// The first word of a status block.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StateWord {
    /// State of the safety state machine.
    pub state: State,
    /// Why it stopped last.
    pub reason: FaultReason,
    /// No step was lost or invented since the positions were last in step with the machine.
    pub position_trusted: bool,
    /// The gate is open: outputs are live.
    pub enabled: bool,
    /// The session belongs to whoever this goes to.
    pub session_yours: bool,
    /// The watchdog's latched bite.
    pub bitten: bool,
    /// The external reset pin right now.
    pub external_reset: bool,
    /// The command this answers was executed (false: only answered).
    pub accepted: bool,
    /// The Ethernet link is up.
    pub link: bool,
}

impl StateWord {
    /// As a word.
    pub const fn to_word(self) -> u32 {
        self.state as u32
            | (self.reason as u32) << 8
            | (self.position_trusted as u32) << 16
            | (self.enabled as u32) << 17
            | (self.session_yours as u32) << 18
            | (self.bitten as u32) << 19
            | (self.external_reset as u32) << 20
            | (self.accepted as u32) << 21
            | (self.link as u32) << 22
    }

    /// From a word; refused when it names a state or reason this version does not know.
    pub const fn from_word(word: u32) -> Result<Self, Refusal> {
        let (Some(state), Some(reason)) = (
            State::from_code(word as u8),
            FaultReason::from_code((word >> 8) as u8),
        ) else {
            return Err(Refusal::Value);
        };
        Ok(StateWord {
            state,
            reason,
            position_trusted: word >> 16 & 1 != 0,
            enabled: word >> 17 & 1 != 0,
            session_yours: word >> 18 & 1 != 0,
            bitten: word >> 19 & 1 != 0,
            external_reset: word >> 20 & 1 != 0,
            accepted: word >> 21 & 1 != 0,
            link: word >> 22 & 1 != 0,
        })
    }
}

/// Words in this board's command block.
pub const fn command_words(channels: Channels) -> usize {
    COMMAND_HEAD + channels.stepgens as usize * COMMAND_STEPGEN + channels.pwms as usize
}

/// Words in this board's status block.
pub const fn status_words(channels: Channels) -> usize {
    STATUS_HEAD
        + channels.stepgens as usize * STATUS_STEPGEN
        + channels.encoders as usize * STATUS_ENCODER
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
        let (head, channels_words) = block.split_at_mut(COMMAND_HEAD);
        let apply = self.apply_at.unwrap_or_default().0;
        head.copy_from_slice(&[
            self.token,
            self.sequence,
            (u32::from(self.enable) * FLAG_ENABLE)
                | (u32::from(self.enable_request) * FLAG_ENABLE_REQUEST)
                | (u32::from(self.apply_at.is_some()) * FLAG_APPLY_TIME),
            apply as u32,
            (apply >> 32) as u32,
            u32::from(self.stepgen_enable) | u32::from(self.index_arm) << 16,
            self.gpio_out,
        ]);
        let (steps, pwms) =
            channels_words.split_at_mut(channels.stepgens as usize * COMMAND_STEPGEN);
        let (steps, _) = steps.as_chunks_mut::<COMMAND_STEPGEN>();
        for (words, (rate, accel)) in steps.iter_mut().zip(&self.stepgen) {
            *words = [rate.0 as u32, accel.0];
        }
        for (word, pwm) in pwms.iter_mut().zip(&self.pwm) {
            *word = *pwm;
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
        let &[
            token,
            sequence,
            flags,
            apply_lo,
            apply_hi,
            enables,
            gpio_out,
        ] = head;
        let mut command = Command {
            token,
            sequence,
            enable: flags & FLAG_ENABLE != 0,
            enable_request: flags & FLAG_ENABLE_REQUEST != 0,
            apply_at: (flags & FLAG_APPLY_TIME != 0)
                .then_some(Clocks::from_words(apply_lo, apply_hi)),
            stepgen_enable: enables as u16,
            index_arm: (enables >> 16) as u16,
            gpio_out,
            ..Command::default()
        };
        let (steps, pwms) = rest
            .split_at_checked(channels.stepgens as usize * COMMAND_STEPGEN)
            .ok_or(Refusal::BlockLength)?;
        let (steps, _) = steps.as_chunks::<COMMAND_STEPGEN>();
        for (target, &[rate, accel]) in command.stepgen.iter_mut().zip(steps) {
            *target = (StepRate(rate as i32), Accel(accel));
        }
        for (target, &word) in command.pwm.iter_mut().zip(pwms) {
            *target = word;
        }
        Ok(command)
    }
}

impl Status {
    /// Writes the status block into `words` (the board's side, for models and tests; the firmware
    /// copies registers straight into the frame). `None` when it does not fit.
    pub fn emit<'b>(&self, channels: Channels, words: &'b mut [u32]) -> Option<&'b [u32]> {
        let block = words.get_mut(..status_words(channels))?;
        let (head, rest) = block.split_first_chunk_mut::<STATUS_HEAD>()?;
        *head = [
            self.state.to_word(),
            self.sequence,
            self.arrival.0 as u32,
            (self.arrival.0 >> 32) as u32,
            self.sample.0 as u32,
            (self.sample.0 >> 32) as u32,
            self.watchdog_left,
            self.refused.0,
            self.boot_id,
            self.link,
            self.gpio_in,
            u32::from(self.index_latched) | u32::from(self.rate_limited) << 16,
        ];
        let (steps, encoders) = rest.split_at_mut(channels.stepgens as usize * STATUS_STEPGEN);
        let (steps, _) = steps.as_chunks_mut::<STATUS_STEPGEN>();
        for (words, (position, rate)) in steps.iter_mut().zip(&self.stepgen) {
            *words = [position.0 as u32, (position.0 >> 32) as u32, rate.0 as u32];
        }
        let (encoders, _) = encoders.as_chunks_mut::<STATUS_ENCODER>();
        for (words, encoder) in encoders.iter_mut().zip(&self.encoder) {
            *words = [encoder.count.0, encoder.latch.0, encoder.edge_time];
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
            state: StateWord::from_word(head[0])?,
            sequence: head[1],
            arrival: Clocks::from_words(head[2], head[3]),
            sample: Clocks::from_words(head[4], head[5]),
            watchdog_left: head[6],
            refused: Count(head[7]),
            boot_id: head[8],
            link: head[9],
            gpio_in: head[10],
            index_latched: head[11] as u16,
            rate_limited: (head[11] >> 16) as u16,
            stepgen: [(Position::ZERO, StepRate(0)); MAX_CHANNELS],
            encoder: [EncoderStatus::default(); MAX_CHANNELS],
        };
        let (steps, encoders) = rest
            .split_at_checked(channels.stepgens as usize * STATUS_STEPGEN)
            .ok_or(Refusal::BlockLength)?;
        let (steps, _) = steps.as_chunks::<STATUS_STEPGEN>();
        for (target, &[lo, hi, rate]) in status.stepgen.iter_mut().zip(steps) {
            *target = (Position::from_words(lo, hi), StepRate(rate as i32));
        }
        let (encoders, _) = encoders.as_chunks::<STATUS_ENCODER>();
        for (target, &[count, latch, edge_time]) in status.encoder.iter_mut().zip(encoders) {
            *target = EncoderStatus {
                count: Count(count),
                latch: Count(latch),
                edge_time,
            };
        }
        Ok(status)
    }

    /// Reads a whole reply datagram: one record whose base is the sequence number.
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

/// Judges a sequence number against the last accepted one.
pub const fn judge_sequence(sequence: u32, last: u32) -> Result<(), Refusal> {
    match sequence.wrapping_sub(last) as i32 {
        0 => Err(Refusal::Duplicate),
        ahead if ahead > 0 => Ok(()),
        _ => Err(Refusal::Stale),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIX: Channels = Channels {
        stepgens: 6,
        encoders: 6,
        pwms: 6,
        inputs: 12,
        outputs: 12,
    };
    const MOST: Channels = Channels {
        stepgens: 16,
        encoders: 16,
        pwms: 16,
        inputs: 32,
        outputs: 32,
    };

    fn command() -> Command {
        let mut command = Command {
            token: 0x1234_5678,
            sequence: u32::MAX,
            enable: true,
            apply_at: Some(Clocks(1 << 40 | 7)),
            stepgen_enable: 0x3f,
            index_arm: 0x21,
            gpio_out: 0xa5,
            ..Command::default()
        };
        command.stepgen[5] = (StepRate(-i32::MAX), Accel(u32::MAX));
        command.pwm[5] = PWM_ENABLE | 1234;
        command
    }

    #[test]
    fn a_six_axis_command_is_25_words_and_its_status_48() {
        assert_eq!((command_words(SIX), status_words(SIX)), (25, 48));
    }

    #[test]
    fn a_command_survives_the_wire() {
        for channels in [SIX, MOST] {
            let mut buffer = [0; REQUEST_OVERHEAD + COMMAND_MAX];
            let request = command().emit_request(channels, &mut buffer).unwrap();
            let packet = etherbone::Packet::new_checked(request).unwrap();
            let record = packet.records().next().unwrap();
            assert_eq!(record.write_base, map::COMMAND);
            assert_eq!(Command::parse(record.writes, channels), Ok(command()));
        }
    }

    #[test]
    fn a_command_block_for_another_board_is_refused() {
        let words = [0; COMMAND_MAX];
        assert_eq!(Command::parse(&words[..24], SIX), Err(Refusal::BlockLength));
        assert_eq!(Command::parse(&words[..26], SIX), Err(Refusal::BlockLength));
    }

    #[test]
    fn a_status_survives_the_wire() {
        let mut status = Status::parse(&[0; STATUS_MAX][..status_words(MOST)], MOST).unwrap();
        status.state.state = State::Faulted;
        status.state.reason = FaultReason::ExternalReset;
        status.state.accepted = true;
        status.arrival = Clocks(u64::MAX);
        status.stepgen[15] = (Position(i64::MIN), StepRate(-1));
        status.encoder[15].count = Count(u32::MAX);
        status.rate_limited = 0x8000;
        let mut words = [0; STATUS_MAX];
        assert_eq!(
            Status::parse(status.emit(MOST, &mut words).unwrap(), MOST),
            Ok(status)
        );
    }

    #[test]
    fn a_state_this_version_does_not_know_is_refused_not_guessed() {
        assert_eq!(StateWord::from_word(0x0000_00ff), Err(Refusal::Value));
        assert_eq!(StateWord::from_word(0x0000_ff00), Err(Refusal::Value));
    }

    #[test]
    fn sequence_numbers_are_judged_right_across_their_wrap() {
        assert_eq!(judge_sequence(1, 0), Ok(()));
        assert_eq!(judge_sequence(0, u32::MAX), Ok(()));
        assert_eq!(judge_sequence(7, 7), Err(Refusal::Duplicate));
        assert_eq!(judge_sequence(u32::MAX, 0), Err(Refusal::Stale));
        assert_eq!(judge_sequence(0x8000_0000, 0), Err(Refusal::Stale));
    }
}
