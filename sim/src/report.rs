//! The report of a run, as JSON: counts at the pins, times of exchanges, the cost of simulating.

use std::collections::BTreeMap;
use std::path::Path;

use serde::Serialize;

use crate::board::Clockwork;
use crate::edges::CHANNELS;
use crate::environment::PinEnvironment;
use crate::error::Error;
use crate::exchange::{Meter, Spread};

/// Frames that passed the cable.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct FrameCounts {
    /// Fed to the board.
    pub to_board: u64,
    /// Received from the board.
    pub from_board: u64,
    /// From the board, with a bad preamble, length or FCS.
    pub malformed_from_board: u64,
    /// Lost on the way by [`crate::rig::Rig::faults`].
    pub dropped: u64,
}

/// What a report is made of.
pub(crate) struct Seen<'r> {
    pub backend: &'static str,
    pub environment: &'r PinEnvironment,
    pub clockwork: Clockwork,
    pub clocks: u64,
    pub kcycles_per_second: f64,
    pub meter: &'r Meter,
    pub frames: FrameCounts,
}

/// A whole run.
#[derive(Clone, Debug, Serialize)]
pub struct Report {
    /// What made the edges: `rtl` or `model`.
    pub backend: &'static str,
    /// Frequency of the simulated sys clock, Hz.
    pub sys_clk_hz: u64,
    /// Simulated sys clocks.
    pub clocks: u64,
    /// Thousands of sys clocks simulated per second of the machine's time.
    pub kcycles_per_second: f64,
    /// Board time per time of this machine while it simulated.
    pub times_real_time: f64,
    /// Every stepgen that has stepped, and every one before the last such.
    pub axes: Vec<AxisReport>,
    /// Broken rules of step timing in all.
    pub timing_violations: u64,
    /// Exchanges.
    pub exchange: ExchangeReport,
    /// The watchdog.
    pub watchdog: WatchdogReport,
    /// Frames on the cable.
    pub frames: FrameCounts,
    /// The board's own counters; `None` when it did not answer any more.
    pub board: Option<Counters>,
    /// State word of the last status block.
    pub last_state: Option<u32>,
    /// The output gate at the end.
    pub gate_open: bool,
}

/// A stepgen as its pins saw it.
#[derive(Clone, Debug, Serialize)]
pub struct AxisReport {
    /// Stepgen.
    pub channel: usize,
    /// Pulses forward minus pulses backward.
    pub pulses_at_pins: i64,
    /// Pulses either way.
    pub pulses_total: u64,
    /// DIR edges.
    pub reversals: u64,
    /// Count of the encoder on its motor, if there is one on the encoder channel of the same
    /// number.
    pub encoder_at_pins: Option<i64>,
    /// Pulses the board says it has made; `None` when it was not asked or did not answer.
    pub firmware_counts: Option<i64>,
}

/// Exchanges as the cable saw them.
#[derive(Clone, Debug, Serialize)]
pub struct ExchangeReport {
    /// Sent to the board.
    pub requested: u64,
    /// Answered by the board.
    pub answered: u64,
    /// Sent and not answered.
    pub frames_lost: u64,
    /// Datagrams the board refused; `None` when it did not answer any more.
    pub frames_refused: Option<u64>,
    /// Last request byte to first reply byte, sys clocks.
    pub turnaround_cycles: Option<Spread>,
    /// All of them in order.
    pub turnaround_list: Vec<u32>,
    /// Which of them, counted from 1, are [`Meter::unforeseen`].
    pub unforeseen: Vec<usize>,
}

/// The watchdog as reported in the status blocks.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct WatchdogReport {
    /// Least time left at the arrival of a command while the gate was open, sys clocks.
    pub margin_min_clocks: Option<u32>,
    /// The same in milliseconds.
    pub margin_min_ms: Option<f64>,
}

/// The board's own counters (the COUNTERS window).
#[derive(Clone, Debug, Serialize)]
pub struct Counters {
    /// Frames received.
    pub frames_rx: u32,
    /// Frames sent.
    pub frames_tx: u32,
    /// Exchanges executed.
    pub exchanges: u32,
    /// Of these, the ones that the gateware executed and answered by itself, ...
    pub fast: u32,
    /// ... and those that took the long way through the firmware.
    pub long: u32,
    /// Why the last of those did.
    pub long_way: &'static str,
    /// Refused datagrams by reason.
    pub refused: BTreeMap<&'static str, u32>,
    /// Pulses emitted per stepgen, from the last sample (the STATUS window).
    pub positions: Vec<i64>,
}

impl Counters {
    /// Asks the board; `None` when it does not answer. `read` gives words from an address on.
    pub(crate) fn gather(mut read: impl FnMut(u32, u32) -> Option<Vec<u32>>) -> Option<Self> {
        let counters = read(wire::map::COUNTERS, COUNTERS)?;
        let describe = read(wire::map::DESCRIBE, 9)?;
        let stepgens = describe.get(7)? & 0xff;
        let status = read(wire::map::STATUS, status_words(stepgens));
        let ways = read(wire::refusal::COUNTERS_WAYS, 3)?;
        let ways = *ways.first_chunk()?;
        Some(Self::from_words(
            &counters,
            ways,
            &status.unwrap_or_default(),
        ))
    }

    fn from_words(counters: &[u32], [fast, long, why]: [u32; 3], status: &[u32]) -> Self {
        let head = wire::exchange::STATUS_HEAD;
        // s32.32 starting at half a step: the integer part is the pulses emitted.
        let positions = status
            .get(head..)
            .unwrap_or_default()
            .chunks_exact(3)
            .map(|w| i64::from(w[1] as i32))
            .collect();
        Counters {
            frames_rx: counters[0],
            frames_tx: counters[1],
            exchanges: counters[2],
            fast,
            long,
            long_way: wire::LongWay::from_code(why).map_or("for an unknown reason", |w| w.text()),
            refused: wire::Refusal::ALL
                .iter()
                .map(|r| r.key())
                .zip(counters[3..].iter().copied())
                .collect(),
            positions,
        }
    }
}

/// Words of the counter window.
const COUNTERS: u32 = 3 + wire::Refusal::ALL.len() as u32;

fn status_words(stepgens: u32) -> u32 {
    wire::exchange::STATUS_HEAD as u32 + 3 * stepgens
}

impl Report {
    pub(crate) fn of(seen: &Seen, board: Option<Counters>) -> Self {
        let sys_clk_hz = seen.clockwork.sys_hz;
        let (edges, plant) = (&seen.environment.edges, &seen.environment.plant);
        let used = (0..CHANNELS)
            .rev()
            .find(|n| edges.channel(*n).pulses != 0)
            .map_or(0, |n| n + 1);
        let known = board.as_ref().map_or(0, |b| b.positions.len());
        let axes = (0..used.max(known)).map(|n| {
            let channel = edges.channel(n);
            AxisReport {
                channel: n,
                pulses_at_pins: channel.count,
                pulses_total: channel.pulses,
                reversals: channel.reversals,
                encoder_at_pins: plant.encoder_count(n),
                firmware_counts: board.as_ref().and_then(|b| b.positions.get(n).copied()),
            }
        });
        let meter = seen.meter;
        let margin = meter.watchdog_margin;
        let round = |figure: f64| (figure * 10.0).round() / 10.0;
        Report {
            backend: seen.backend,
            sys_clk_hz,
            clocks: seen.clocks,
            kcycles_per_second: round(seen.kcycles_per_second),
            times_real_time: round(seen.kcycles_per_second * 1e3 / sys_clk_hz as f64),
            axes: axes.collect(),
            timing_violations: edges.violation_count(),
            exchange: ExchangeReport {
                requested: meter.requested,
                answered: meter.answered,
                frames_lost: meter.requested - meter.answered,
                frames_refused: board
                    .as_ref()
                    .map(|b| b.refused.values().map(|n| u64::from(*n)).sum()),
                turnaround_cycles: Spread::of(&meter.turnarounds),
                turnaround_list: meter.turnarounds.clone(),
                unforeseen: meter.unforeseen.clone(),
            },
            watchdog: WatchdogReport {
                margin_min_clocks: margin,
                margin_min_ms: margin.map(|m| f64::from(m) * 1e3 / sys_clk_hz as f64),
            },
            frames: seen.frames,
            board,
            last_state: meter.last_state,
            gate_open: seen.environment.pins().gate != 0,
        }
    }

    /// Write it as JSON.
    pub fn write(&self, path: &Path) -> Result<(), Error> {
        let fail = |source| Error::Write {
            path: path.into(),
            source,
        };
        if let Some(parent) = path.parent() {
            std::fs::create_dir_all(parent).map_err(fail)?;
        }
        let text = serde_json::to_string_pretty(self).map_err(|e| fail(e.into()))?;
        std::fs::write(path, text + "\n").map_err(fail)
    }
}
