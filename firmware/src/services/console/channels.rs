//! Channels, one a piece, and raw registers.

use super::board::status_at;
use super::{More, Piece, Reader};
use crate::text::Out;
use ::jobs::Outside;
use wire::exchange::{EDGE_TIME_BITS, STATUS_ENCODER, STATUS_HEAD, STATUS_STEPGEN};
use wire::map::{self, StepgenConfig};
use wire::regmap::{self, CSR_PAGE, ident, status};

/// The pages of our own cores that `regs` shows: those there are once, and in front of the pages of
/// the channels. Then the words of each that it shows of one.
const PAGES: core::ops::Range<u32> = ident::PAGE..status::PAGE + 1;
const LINE: u32 = 8;
const LINES: u16 = 4;

pub(super) fn regs(
    page: Option<u8>,
    step: u16,
    reader: &mut Reader,
    from: &mut impl Outside,
    out: &mut Out,
) -> Piece {
    // 8 words identify a page, 32 fit a screen.
    let (page, line, more) = match page {
        Some(page) => (u32::from(page), u32::from(step), step + 1 < LINES),
        None => {
            let page = PAGES.start + u32::from(step);
            (page, 0, page + 1 < PAGES.end)
        }
    };
    let base = map::SERVICE + page * CSR_PAGE as u32;
    if crate::service::readable(base) {
        let base = base + line * LINE * 4;
        let words: [u32; LINE as usize] = reader.block(base, from)?;
        out.hex(base);
        for word in words {
            out.text(" ").hex(word);
        }
        out.end();
    }
    Some(More::when(more))
}

/// The channel of this step, if there is one, and whether there is another one behind it.
fn chosen(only: Option<u8>, step: u16, count: u8) -> Option<(u32, More)> {
    let n = only.map_or(u32::from(step), u32::from);
    let more = only.is_none() && n + 1 < u32::from(count);
    (n < u32::from(count)).then_some((n, More::when(more)))
}

const fn latch_at(first: usize, n: u32) -> u32 {
    regmap::address(status::BASE, first) + 4 * n
}

pub(super) fn stepgen(
    only: Option<u8>,
    step: u16,
    reader: &mut Reader,
    from: &mut impl Outside,
    out: &mut Out,
) -> Piece {
    let Some((n, more)) = chosen(only, step, reader.channels.stepgens) else {
        return Some(More::No);
    };
    if only.is_none() || step == 0 {
        // The upper word of a position counts pulses.
        let [pulses, velocity] = reader.block(
            status_at(STATUS_HEAD + 1 + n as usize * STATUS_STEPGEN),
            from,
        )?;
        // Steps/s in integers: a softcore has no `f64`.
        let hz = (i64::from(velocity as i32) * i64::from(reader.clock_hz)) >> 32;
        out.number(n).text(": ").signed(pulses as i32);
        out.text(" steps, ").signed(hz as i32).text(" steps/s");
        if only.is_some() {
            return Some(More::Yes);
        }
        out.end();
        return Some(more);
    }
    const FIELDS: [(&str, StepgenConfig); 6] = [
        ("steplen", StepgenConfig::Steplen),
        ("stepspace", StepgenConfig::Stepspace),
        ("dirsetup", StepgenConfig::Dirsetup),
        ("dirhold", StepgenConfig::Dirhold),
        ("stop-accel", StepgenConfig::StopAccel),
        ("mode", StepgenConfig::Mode),
    ];
    let at = |field: StepgenConfig| map::CONFIG_STEPGEN + n * map::CONFIG_STRIDE + 4 * field as u32;
    let [a, b, c, d, e, f] = FIELDS.map(|(_, field)| at(field));
    let latch = latch_at(status::STEPGEN0_LATCH, n);
    let [latch, values @ ..] = reader.words([latch, a, b, c, d, e, f], from)?;
    out.text(", latch ").signed(latch as i32);
    for ((name, _), value) in FIELDS.iter().zip(values) {
        out.text("\r\n    ").text(name).text(" ").number(value);
    }
    out.end();
    Some(More::No)
}

pub(super) fn encoder(
    only: Option<u8>,
    step: u16,
    reader: &mut Reader,
    from: &mut impl Outside,
    out: &mut Out,
) -> Piece {
    let Some((n, more)) = chosen(only, step, reader.channels.encoders) else {
        return Some(More::No);
    };
    let stepgens = usize::from(reader.channels.stepgens) * STATUS_STEPGEN;
    let at = status_at(STATUS_HEAD + stepgens + n as usize * STATUS_ENCODER);
    let config = map::CONFIG_ENCODER + n * map::CONFIG_STRIDE;
    let latch = latch_at(status::ENCODER0_LATCH, n);
    let [count, edge, latch, mode, filter] =
        reader.words([at, at + 4, latch, config, config + 4], from)?;
    out.number(n).text(": ").signed(count as i32);
    out.text(", latch ").signed(latch as i32);
    out.text(", errors ").number(edge >> EDGE_TIME_BITS);
    out.text(", edge at 0x").hex(edge << 8 >> 8);
    if only.is_some() {
        out.text("\r\n    mode 0x").hex(mode);
        out.text(", filter ").number(filter).text(" clocks");
    }
    out.end();
    Some(more)
}

pub(super) fn pwm(
    only: Option<u8>,
    step: u16,
    reader: &mut Reader,
    from: &mut impl Outside,
    out: &mut Out,
) -> Piece {
    let Some((n, more)) = chosen(only, step, reader.channels.pwms) else {
        return Some(More::No);
    };
    let config = map::CONFIG_PWM + n * map::CONFIG_STRIDE;
    let [period, mode] = reader.block(config, from)?;
    out.number(n).text(": period ").number(period);
    out.text(" clocks, mode 0x").hex(mode).end();
    Some(more)
}
