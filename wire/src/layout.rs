//! The layout of the exchange as text. The ABI number is a hash of it and of the register map.
//!
//! All facts here are derived from the code. Every field of [`Command`] and [`Status`] is set bit
//! by bit and emitted, and a line says where the bits appear; the addresses and codes are the
//! constants of this crate. `cargo xtask regen` writes the text to `wire/layout.txt`; the
//! gateware's generator hashes that file into the ABI number. So a field that moves changes the
//! number, and a gateware and a firmware with different layouts never arm together.
//!
//! A field that is not listed here does not compile; a constant that is not listed fails a test.
//! The firmware does not use this module.

use crate::describe::{Channels, JobsState};
use crate::exchange::{self, Command, EncoderStatus, Latch, StateWord, Status};
use crate::map::{self, BoardConfig, CountMode, PwmType, StepType, StepgenConfig};
use crate::state::{FaultReason, GateClose, LinkSpeed, ResetReason, State};
use crate::units::{Accel, Clocks, Count, Position, Velocity};
use core::fmt::{Result, Write};

/// The example board: two channels of each kind, so that the stride from one to the next is
/// visible.
const BOARD: Channels = Channels {
    stepgens: 2,
    encoders: 2,
    pwms: 2,
    inputs: 64,
    outputs: 64,
};

/// Words of the longest request.
const WORDS: usize = exchange::REQUEST_OVERHEAD + exchange::COMMAND_MAX;

/// Writes a command's whole datagram, or a status block, for [`BOARD`].
type Emit<'e, T> = &'e dyn Fn(&T, &mut [u32; WORDS]);

/// The whole layout, one fact per line.
pub fn write(out: &mut impl Write) -> Result {
    writeln!(out, "wire {}", crate::WIRE_VERSION)?;
    command(out, &|command, words| {
        let _ = command.emit_request(BOARD, words);
    })?;
    status(out, &|status, words| {
        let _ = status.emit(BOARD, words);
    })?;
    constants(out)
}

/// Where each bit of a field appears: `name word.high:low`, the field's upper bits first.
fn field<T>(
    out: &mut impl Write,
    name: core::fmt::Arguments<'_>,
    width: u32,
    emit: Emit<'_, T>,
    with: impl Fn(u64) -> T,
) -> Result {
    let mut rest = [0; WORDS];
    emit(&with(0), &mut rest);
    write!(out, "  {name}:")?;
    // The current run of bits: its word, its highest and its lowest bit.
    let mut run: Option<(usize, u32, u32)> = None;
    for bit in (0..width).rev() {
        let mut set = [0; WORDS];
        emit(&with(1 << bit), &mut set);
        for (word, (set, rest)) in set.iter().zip(&rest).enumerate() {
            for at in (0..32).rev().filter(|at| (set ^ rest) >> at & 1 != 0) {
                run = match run {
                    Some((same, high, low)) if same == word && at + 1 == low => {
                        Some((word, high, at))
                    }
                    Some((before, high, low)) => {
                        write!(out, " {before}.{high}:{low}")?;
                        Some((word, at, at))
                    }
                    None => Some((word, at, at)),
                };
            }
        }
    }
    if let Some((word, high, low)) = run {
        write!(out, " {word}.{high}:{low}")?;
    }
    writeln!(out)
}

/// A line per field: its name, its number of bits, and how a value gets into it. The type is
/// destructured without `..`, so that a field that is missing here does not compile.
macro_rules! fields {
    ($out:ident, $emit:ident, $type:ident, $base:expr; $($field:ident $width:literal |$it:ident, $bits:ident| $set:expr;)+) => {
        const _: fn($type) = |all| { let $type { $($field: _),+ } = all; };
        $(field($out, format_args!(stringify!($field)), $width, $emit, |$bits: u64| {
            let rest = || -> $type { $base };
            let mut $it = rest();
            $set;
            $it
        })?;)+
    };
}

fn command(out: &mut impl Write, emit: Emit<'_, Command>) -> Result {
    writeln!(out, "command, datagram of {BOARD:?}")?;
    let mut rest = [0; WORDS];
    emit(&Command::default(), &mut rest);
    write!(out, "  at rest:")?;
    for word in rest.iter().take(exchange::REQUEST_OVERHEAD) {
        write!(out, " {word:08x}")?;
    }
    let most = Channels {
        stepgens: 16,
        encoders: 16,
        pwms: 16,
        ..BOARD
    };
    writeln!(
        out,
        ", {} words of {}",
        exchange::command_words(BOARD),
        exchange::command_words(most)
    )?;
    fields! { out, emit, Command, Command::default();
        token 32 |it, bits| it.token = bits as u32;
        sequence 32 |it, bits| it.sequence = bits as u32;
        enable 1 |it, bits| it.enable = bits != 0;
        enable_request 1 |it, bits| it.enable_request = bits != 0;
        apply_at 64 |it, bits| it.apply_at = Some(Clocks(bits));
        stepgen_enable 16 |it, bits| it.stepgen_enable = bits as u16;
        stepgen_alone 16 |it, bits| it.stepgen_alone = bits as u16;
        index_arm 16 |it, bits| it.index_arm = bits as u16;
        probe_arm 16 |it, bits| it.probe_arm = bits as u16;
        stepgen_index_arm 16 |it, bits| it.stepgen_index_arm = bits as u16;
        stepgen_probe_arm 16 |it, bits| it.stepgen_probe_arm = bits as u16;
        latch 5 |it, bits| it.latch = Latch::from_code(bits as u32);
        gpio_out 64 |it, bits| it.gpio_out = bits;
        stepgen 32 |it, bits| it.stepgen[0].0 = Velocity(bits as u32 as i32);
        pwm 32 |it, bits| it.pwm[0] = bits as u32;
    }
    field(out, format_args!("apply_at given"), 1, emit, |bits| {
        Command {
            apply_at: (bits != 0).then_some(Clocks(0)),
            ..Command::default()
        }
    })?;
    for n in 0..2 {
        field(
            out,
            format_args!("stepgen {n} velocity"),
            32,
            emit,
            |bits| {
                let mut it = Command::default();
                it.stepgen[n].0 = Velocity(bits as u32 as i32);
                it
            },
        )?;
        field(out, format_args!("stepgen {n} accel"), 32, emit, |bits| {
            let mut it = Command::default();
            it.stepgen[n].1 = Accel(bits as u32);
            it
        })?;
        field(out, format_args!("pwm {n}"), 32, emit, |bits| {
            let mut it = Command::default();
            it.pwm[n] = bits as u32;
            it
        })?;
    }
    Ok(())
}

fn status(out: &mut impl Write, emit: Emit<'_, Status>) -> Result {
    let rest = || Status {
        state: rest_word(),
        sequence: 0,
        arrival: Clocks(0),
        sample: Clocks(0),
        watchdog_left: 0,
        refused: Count(0),
        boot_id: 0,
        estop: 0,
        gpio_in: 0,
        index_latched: 0,
        probe_latched: 0,
        illegal: 0,
        rate_limited: 0,
        stepgen_index_latched: 0,
        stepgen_probe_latched: 0,
        latch: Count(0),
        stepgen: [(Position(0), Velocity(0)); exchange::MAX_CHANNELS],
        encoder: [EncoderStatus::default(); exchange::MAX_CHANNELS],
    };
    let most = Channels {
        stepgens: 16,
        encoders: 16,
        pwms: 16,
        ..BOARD
    };
    writeln!(
        out,
        "status, {} words of {}",
        exchange::status_words(BOARD),
        exchange::status_words(most)
    )?;
    fields! { out, emit, Status, rest();
        state 1 |it, bits| it.state.link = bits != 0;
        sequence 32 |it, bits| it.sequence = bits as u32;
        arrival 64 |it, bits| it.arrival = Clocks(bits);
        sample 64 |it, bits| it.sample = Clocks(bits);
        watchdog_left 32 |it, bits| it.watchdog_left = bits as u32;
        refused 32 |it, bits| it.refused = Count(bits as u32);
        boot_id 32 |it, bits| it.boot_id = bits as u32;
        estop 32 |it, bits| it.estop = bits as u32;
        gpio_in 64 |it, bits| it.gpio_in = bits;
        index_latched 16 |it, bits| it.index_latched = bits as u16;
        probe_latched 16 |it, bits| it.probe_latched = bits as u16;
        illegal 16 |it, bits| it.illegal = bits as u16;
        rate_limited 16 |it, bits| it.rate_limited = bits as u16;
        stepgen_index_latched 16 |it, bits| it.stepgen_index_latched = bits as u16;
        stepgen_probe_latched 16 |it, bits| it.stepgen_probe_latched = bits as u16;
        latch 32 |it, bits| it.latch = Count(bits as u32);
        stepgen 64 |it, bits| it.stepgen[0].0 = Position(bits as i64);
        encoder 32 |it, bits| it.encoder[0].count = Count(bits as u32);
    }
    for n in 0..2 {
        field(
            out,
            format_args!("stepgen {n} position"),
            64,
            emit,
            |bits| {
                let mut it = rest();
                it.stepgen[n].0 = Position(bits as i64);
                it
            },
        )?;
        field(
            out,
            format_args!("stepgen {n} velocity"),
            32,
            emit,
            |bits| {
                let mut it = rest();
                it.stepgen[n].1 = Velocity(bits as u32 as i32);
                it
            },
        )?;
        encoder(out, emit, n, &rest)?;
    }
    state_word(out)
}

fn encoder(
    out: &mut impl Write,
    emit: Emit<'_, Status>,
    n: usize,
    rest: &dyn Fn() -> Status,
) -> Result {
    let EncoderStatus {
        count: _,
        edge_time: _,
        errors: _,
    } = EncoderStatus::default();
    field(out, format_args!("encoder {n} count"), 32, emit, |bits| {
        let mut it = rest();
        it.encoder[n].count = Count(bits as u32);
        it
    })?;
    field(
        out,
        format_args!("encoder {n} edge_time"),
        24,
        emit,
        |bits| {
            let mut it = rest();
            it.encoder[n].edge_time = bits as u32;
            it
        },
    )?;
    field(out, format_args!("encoder {n} errors"), 8, emit, |bits| {
        let mut it = rest();
        it.encoder[n].errors = bits as u8;
        it
    })
}

/// A state word of zeros.
fn rest_word() -> StateWord {
    StateWord {
        state: State::Boot,
        reason: FaultReason::None,
        position_trusted: false,
        enabled: false,
        session_yours: false,
        bitten: false,
        external_reset: false,
        accepted: false,
        link: false,
        estop: false,
        speed: LinkSpeed::Down,
        services: JobsState::None,
        link_errors: 0,
    }
}

fn state_word(out: &mut impl Write) -> Result {
    writeln!(out, "state word, at rest {:08x}", rest_word().to_word())?;
    let emit: Emit<'_, StateWord> = &|word, words| words[0] = word.to_word();
    fields! { out, emit, StateWord, rest_word();
        state 1 |it, bits| it.state = if bits == 0 { State::Boot } else { State::Disarmed };
        reason 1 |it, bits| it.reason = if bits == 0 { FaultReason::None } else { FaultReason::Watchdog };
        position_trusted 1 |it, bits| it.position_trusted = bits != 0;
        enabled 1 |it, bits| it.enabled = bits != 0;
        session_yours 1 |it, bits| it.session_yours = bits != 0;
        bitten 1 |it, bits| it.bitten = bits != 0;
        external_reset 1 |it, bits| it.external_reset = bits != 0;
        accepted 1 |it, bits| it.accepted = bits != 0;
        link 1 |it, bits| it.link = bits != 0;
        estop 1 |it, bits| it.estop = bits != 0;
        speed 1 |it, bits| it.speed = if bits == 0 { LinkSpeed::Down } else { LinkSpeed::M10 };
        services 1 |it, bits| it.services = if bits == 0 { JobsState::None } else { JobsState::Alive };
        link_errors 8 |it, bits| it.link_errors = bits as u8;
    }
    Ok(())
}

/// A line per constant, by its own name.
macro_rules! values {
    ($out:ident; $module:ident: $($name:ident)+) => {
        writeln!($out, stringify!($module))?;
        $(writeln!($out, "  {} {:x}", stringify!($name), $module::$name)?;)+
    };
}

/// A line per value of an enum.
macro_rules! codes {
    ($out:ident; $type:ident: $($name:ident)+) => {
        writeln!($out, stringify!($type))?;
        const _: fn($type) = |it| match it { $($type::$name => ()),+ };
        $(writeln!($out, "  {} {}", stringify!($name), $type::$name as u32)?;)+
    };
}

fn constants(out: &mut impl Write) -> Result {
    codes! { out; State: Boot Disarmed Armed Stopping Faulted }
    codes! { out; FaultReason: None Watchdog ExternalReset HostDisable SessionLost LinkDown FirmwareFault JobUnderrun
    AbiMismatch EStop }
    codes! { out; ResetReason: PowerUp Requested Panic Trap Unknown }
    codes! { out; GateClose: Never Bite ExternalReset Order SoftStop EStop SystemReset }
    codes! { out; LinkSpeed: Down M10 M100 M1000 }
    codes! { out; JobsState: None Alive Sdram Missing Damaged Foreign Streamed Ended Loading GivenUp }
    codes! { out; StepgenConfig: Steplen Stepspace Dirsetup Dirhold StopAccel Mode }
    codes! { out; StepType: StepDir UpDown Quadrature }
    codes! { out; CountMode: X4 X2 X1 Counter StepDir UpDown }
    codes! { out; PwmType: Pwm UpDown Pdm }
    codes! { out; BoardConfig: WatchdogTimeout WatchdogGrace GpioSafe GpioInvert Probe GpioSafeHigh GpioInvertHigh }
    values! { out; exchange: MAX_CHANNELS COMMAND_HEAD COMMAND_STEPGEN STATUS_HEAD STATUS_STEPGEN STATUS_ENCODER COMMAND_MAX
    STATUS_MAX REQUEST_OVERHEAD FLAG_ENABLE FLAG_ENABLE_REQUEST FLAG_APPLY_TIME FLAG_ALONE_SHIFT PWM_WIDTH_MASK PWM_FRACTION
    PWM_PERIOD_MAX PWM_ENABLE PWM_DIRECTION EDGE_TIME_BITS }
    values! { out; map: DESCRIBE DESCRIBE_LEN DESCRIBE_BLOB SESSION SESSION_ACQUIRE SESSION_TOKEN SESSION_OWNER_IP
    SESSION_OWNER_PORT SESSION_RELEASE SESSION_LAST_SEQ SESSION_REBOOT SESSION_SEGMENTS SESSION_CHALLENGE SESSION_RESPONSE
    SESSION_LEN REBOOT_KEY CONFIG CONFIG_STRIDE CONFIG_STEPGEN CONFIG_PWM CONFIG_ENCODER CONFIG_BOARD CONFIG_LEN
    WATCHDOG_SECONDS_MAX STEP_CLOCKS_MAX DIR_CLOCKS_MAX STEPGEN_STEP_INVERT STEPGEN_DIR_INVERT STEPGEN_TYPE_SHIFT STEPGEN_INDEX_INVERT
    ENCODER_INDEX_INVERT ENCODER_MASK_ENABLE ENCODER_MASK_INVERT ENCODER_CLEAR_ON_INDEX ENCODER_FILTER_MAX PWM_INVERT
    PWM_TYPE_SHIFT PWM_DITHER PWM_SWAP PROBE_INPUT_MASK PROBE_ENABLE PROBE_INVERT STEPGEN_CONFIG_WORDS PWM_CONFIG_WORDS
    ENCODER_CONFIG_WORDS BOARD_CONFIG_WORDS CONFIG_DEBOUNCE DEBOUNCE_CLOCKS DEBOUNCE_MAX COMMAND STATUS COUNTERS
    COUNTERS_REFUSED LOG LOG_RING PANIC PANIC_TEXT PANIC_TEXT_LEN FLASH FLASH_OP FLASH_ADDRESS FLASH_OP_LENGTH FLASH_CRC
    FLASH_JEDEC FLASH_UID_HI FLASH_UID_LO FLASH_SIZE FLASH_RUNNING FLASH_SELECTED FLASH_BUILD_ID FLASH_ORIGIN FLASH_LINK
    FLASH_PROTECTED FLASH_IP FLASH_PINS FLASH_BUFFER FLASH_BUFFER_WORDS FLASH_SETTINGS FLASH_LEN SERVICE SEGMENTS SEGMENTS_WRITABLE
    PADS PADS_WORDS TIMEBASE_NOW ETH_BEATS ETH_BEAT_CLOCKS }
    Ok(())
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use std::string::String;
    use std::vec::Vec;

    fn text() -> String {
        let mut text = String::new();
        write(&mut text).unwrap();
        text
    }

    #[test]
    fn the_file_the_abi_number_is_made_of_is_the_layout_of_this_crate() {
        let committed = include_str!("../layout.txt");
        let facts: String = committed.split_inclusive('\n').skip(1).collect();
        assert!(committed.starts_with('#'));
        assert_eq!(
            facts,
            text(),
            "run `cargo xtask regen` and commit layout.txt"
        );
    }

    #[test]
    fn a_bit_that_moves_is_seen() {
        let shown = |moved: &dyn Fn(&mut [u32; WORDS])| {
            let mut text = String::new();
            command(&mut text, &|command, words| {
                let _ = command.emit_request(BOARD, words);
                moved(words);
            })
            .unwrap();
            text
        };
        let flags = exchange::REQUEST_OVERHEAD + 2;
        let ours = shown(&|_| {});
        // As with wire version 4: bits without a meaning got one.
        let before = shown(&|words| words[flags] &= (1 << exchange::FLAG_ALONE_SHIFT) - 1);
        let changed: Vec<_> = ours
            .lines()
            .zip(before.lines())
            .filter(|(a, b)| a != b)
            .collect();
        assert_eq!(changed, [("  stepgen_alone: 6.31:16", "  stepgen_alone:")]);
        // A shift by one bit, and two exchanged words.
        assert_ne!(
            ours,
            shown(&|words| words[flags] = words[flags].rotate_left(1))
        );
        assert_ne!(ours, shown(&|words| words.swap(flags, flags + 1)));
    }

    #[test]
    fn no_constant_of_the_exchange_or_of_the_map_is_forgotten() {
        let text = text();
        let listed = |name: &str| {
            text.lines()
                .any(|line| line.split_whitespace().next() == Some(name))
        };
        for source in [include_str!("exchange.rs"), include_str!("map.rs")] {
            for line in source.lines() {
                let Some(rest) = line.strip_prefix("pub const ") else {
                    continue;
                };
                let Some((name, _)) = rest
                    .split_once(": ")
                    .filter(|(name, _)| !name.contains(' '))
                else {
                    continue;
                };
                assert!(listed(name), "{name} is not in layout.rs");
            }
        }
    }
}
