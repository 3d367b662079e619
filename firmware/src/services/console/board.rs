//! What the machine does and why, its inputs, its log and its flash.

use super::{More, Piece, Reader};
use crate::cores::Gate;
use crate::text::Out;
use ::jobs::Outside;
use wire::channels::WORD_PINS;
use wire::describe::{self, JobsState, address};
use wire::exchange::{StateWord, status_word};
use wire::flash::{OpWord, Running, Slot};
use wire::map::{self, BoardConfig};
use wire::regmap::{self, gpio_high, ident, watchdog};
use wire::{GateClose, LongWay, ResetReason};

/// The step of `status` that is not read from a window.
pub(super) const STACK: u16 = 7;

/// The address of a word of the status block's head.
pub(super) const fn status_at(word: usize) -> u32 {
    map::STATUS + 4 * word as u32
}

const fn board_config(which: BoardConfig) -> u32 {
    map::CONFIG_BOARD + 4 * which as u32
}

const fn watchdog_at(word: usize) -> u32 {
    regmap::address(watchdog::BASE, word)
}

pub(super) fn status(
    step: u16,
    reader: &mut Reader,
    from: &mut impl Outside,
    out: &mut Out,
) -> Piece {
    match step {
        0 => {
            let [word] = reader.words([map::STATUS], from)?;
            let word = StateWord::from_word(word).ok()?;
            out.text("state    ").text(word.state.text());
            out.text(", reason ").text(word.reason.text()).end();
            out.text("gate     ").either(word.enabled, "open", "closed");
            out.text(", positions ")
                .either(word.position_trusted, "trusted", "not trusted")
                .end();
        }
        1 => {
            let [ip, port, last] = reader.words(
                [
                    map::SESSION_OWNER_IP,
                    map::SESSION_OWNER_PORT,
                    map::SESSION_LAST_SEQ,
                ],
                from,
            )?;
            out.text("session  ");
            if (ip, port) == (0, 0) {
                out.text("free").end();
            } else {
                out.address(ip, port as u16).text(", last sequence ");
                out.number(last).end();
            }
        }
        2 => {
            let now = from.now();
            out.text("clock    ").number(reader.clock_hz);
            out.text(" Hz, now 0x");
            out.hex((now >> 32) as u32).hex(now as u32).end();
        }
        3 => {
            let [firmware, gateware, version, gateware_version] =
                reader.block(address(describe::ABI_FIRMWARE_AT), from)?;
            for (name, firmware, gateware) in [
                ("abi      ", firmware, gateware),
                ("version  ", version, gateware_version),
            ] {
                out.text(name).text("firmware ").hex(firmware);
                out.text(", gateware ").hex(gateware).end();
            }
        }
        4 => {
            let [boot, reset] = reader.words(
                [
                    address(describe::BOOT_ID_AT),
                    address(describe::RESET_REASON_AT),
                ],
                from,
            )?;
            let reset = ResetReason::from_code(reset as u8)?;
            out.text("boot     ").hex(boot);
            out.text(", ").text(reset.text()).end();
        }
        5 => {
            let at = wire::refusal::COUNTERS_CALLS;
            let [moving, other, features] =
                reader.words([at, at + 4, address(describe::FEATURES_AT)], from)?;
            out.text("services ").text(JobsState::of(features).text());
            out.text(", longest call ").number(moving);
            out.text(" clocks while a host moved the machine, ");
            out.number(other).text(" else").end();
        }
        6 => {
            let at = wire::refusal::COUNTERS_WAYS;
            let [fast, long, why] = reader.words([at, at + 4, at + 8], from)?;
            out.text("exchange ").number(fast).text(" the fast way, ");
            out.number(long).text(" the long way, why last: ");
            out.text(LongWay::from_code(why)?.text()).end();
        }
        _ => return Some(More::No),
    }
    Some(More::Yes)
}

pub(super) fn gpio(reader: &mut Reader, from: &mut impl Outside, out: &mut Out) -> Piece {
    let [inputs, estop, probe, counts, high] = reader.words(
        [
            status_at(status_word::GPIO_IN),
            status_at(status_word::ESTOP),
            board_config(BoardConfig::Probe),
            address(describe::CHANNELS_AT + 1),
            regmap::address(gpio_high::BASE, gpio_high::IN_NOW),
        ],
        from,
    )?;
    out.text("inputs 0x").hex(inputs);
    if counts & ident::CHANNELS1_INPUTS > WORD_PINS.into() {
        out.text(", from 32 on 0x").hex(high);
    }
    out.text(", e-stop latched 0x").hex(estop).end();
    out.text("probe ");
    if probe & map::PROBE_ENABLE == 0 {
        out.text("none").end();
    } else {
        out.text("input ").number(probe & map::PROBE_INPUT_MASK);
        out.either(probe & map::PROBE_INVERT != 0, ", active low", "")
            .end();
    }
    Some(More::No)
}

pub(super) fn watchdog(
    step: u16,
    reader: &mut Reader,
    from: &mut impl Outside,
    out: &mut Out,
) -> Piece {
    if step == 0 {
        let [gate] = reader.words([watchdog_at(watchdog::STATUS)], from)?;
        let gate = Gate(gate);
        out.either(gate.awake(), "awake", "asleep");
        out.either(gate.stopping(), ", stopping", "");
        out.either(gate.bitten(), ", has bitten", "").end();
        out.text("external reset ")
            .either(gate.reset_pin(), "high", "low");
        out.either(gate.reset(), ", latched", "").end();
        out.text("e-stop ")
            .either(gate.estop_pin(), "active", "idle");
        out.either(gate.estop(), ", latched", "").end();
        return Some(More::Yes);
    }
    let [close, timeout, left] = reader.words(
        [
            watchdog_at(watchdog::LAST_CLOSE),
            board_config(BoardConfig::WatchdogTimeout),
            status_at(status_word::WATCHDOG_LEFT),
        ],
        from,
    )?;
    let close = GateClose::from_code(close as u8).unwrap_or(GateClose::SystemReset);
    let per_us = (reader.clock_hz / 1_000_000).max(1);
    out.text("gate closed last: ").text(close.text()).end();
    out.text("timeout ").number(timeout / per_us);
    out.text(" us, left ").number(left / per_us);
    out.text(" us").end();
    Some(More::No)
}

/// Bytes of the last panic's text in a piece.
const PANIC_PIECE: u32 = 28;

pub(super) fn log(step: u16, reader: &mut Reader, from: &mut impl Outside, out: &mut Out) -> Piece {
    match step {
        0 => {
            let [head, size] = reader.block(map::LOG, from)?;
            out.number(head).text(" bytes logged, the last ");
            out.number(head.min(size));
            out.text(" kept; `ferrocnc log` decodes them").end();
            Some(More::Yes)
        }
        1 => {
            let [boot, deaths] = reader.words([map::LOG + 8, map::PANIC], from)?;
            out.text("boot ").hex(boot);
            out.text(", deaths since power-up ").number(deaths).end();
            Some(More::Yes)
        }
        _ => {
            let offset = PANIC_PIECE * u32::from(step - 2);
            let first = map::PANIC_TEXT + offset;
            let [a, b, c, d, e, f, g] = [0, 4, 8, 12, 16, 20, 24].map(|at| first + at);
            let last = map::PANIC_TEXT + map::PANIC_TEXT_LEN - 4;
            let addresses = [map::PANIC + 4, a, b, c, d, e, f, g].map(|at| at.min(last));
            let [length, words @ ..] = reader.words(addresses, from)?;
            let length = length.min(map::PANIC_TEXT_LEN);
            let mut left = length.saturating_sub(offset);
            for word in words {
                let bytes = word.to_be_bytes();
                out.ascii(bytes.get(..left.min(4) as usize).unwrap_or(&[]));
                left = left.saturating_sub(4);
            }
            if left == 0 && length > 0 {
                out.end();
            }
            Some(More::when(left > 0))
        }
    }
}

pub(super) fn flash(
    step: u16,
    reader: &mut Reader,
    from: &mut impl Outside,
    out: &mut Out,
) -> Piece {
    if step == 0 {
        let [jedec, uid_hi, uid_lo, size] = reader.block(map::FLASH_JEDEC, from)?;
        out.text("chip     ").hex(jedec);
        out.text(", ").number(size >> 10).text(" KiB, id ");
        out.hex(uid_hi).hex(uid_lo).end();
        return Some(More::Yes);
    }
    let [running, build, selected, protected, op] = reader.words(
        [
            map::FLASH_RUNNING,
            map::FLASH_BUILD_ID,
            map::FLASH_SELECTED,
            map::FLASH_PROTECTED,
            map::FLASH_OP,
        ],
        from,
    )?;
    out.text("runs     ")
        .text(Running::from_code(running)?.text());
    out.text(", build ").hex(build).end();
    let selected = Slot::from_code(selected).map_or("golden", Slot::text);
    out.text("next     ").text(selected).end();
    out.text("golden   ")
        .either(protected != 0, "protected", "not protected")
        .end();
    let word = OpWord::from_word(op)?;
    if let Some(op) = word.op {
        out.text("last     ").text(op.text()).text(": ");
        out.text(word.result.text()).end();
    }
    Some(More::No)
}
