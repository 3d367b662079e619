//! `encoder.<nn>`: counts as position and velocity.
//!
//! | pin | | |
//! |---|---|---|
//! | `rawcounts` | s32 out | counts since load |
//! | `count` | s32 out | counts since the last reset or index |
//! | `position` | float out | `count / scale` |
//! | `position-interp` | float out | the same, carried on from the last edge at `velocity`, by less than one count |
//! | `velocity`, `velocity-rpm` | float out | per second, and times 60 |
//! | `reset` | bit in | while true `count` is 0 |
//! | `enable` | bit in | true; while false `count` stands still and `velocity` is 0 |
//! | `index-enable` | bit io | set it; at the next index `count` restarts there and it falls |
//! | `probe-enable` | bit io | set it; when the probe trips the place is latched and it falls |
//! | `count-latched`, `position-latched` | s32, float out | where the last index or probe was |
//! | `quad-error` | bit out | A and B changed together; latched until `quad-error-enable` falls |
//! | `quad-error-enable` | bit in | false clears `quad-error` |
//! | `quad-errors` | u32 out | illegal transitions since load |
//!
//! | parameter | | |
//! |---|---|---|
//! | `scale` | float | counts per unit |
//! | `vel-timeout` | float | s, 0.5: after this long without an edge the velocity is 0 |
//! | `filter-ns` | u32 | an input must be stable this long to count |
//! | `mode` | u32 | [`CountMode`]: 0 x4, 1 x2, 2 x1, 3 counter on A, 4 step/dir, 5 up/down |
//! | `counter-mode` | bit | hostmot2's: true is `mode` 3 |
//! | `index-invert`, `index-mask`, `index-mask-invert` | bit | the index pin's level; only while the mask pin says so |
//! | `no-clear-on-index` | bit | the index latches only; `count` goes on |
//!
//! Velocity is counts between edges over the time between those edges, by the board's clock, so it
//! has no quantisation at low speed; without a new edge it decays as one count over the time since.

use super::latch::{LatchSample, Latching, Source};
use super::{Period, nanos_to_register};
use crate::hal::checked::{Checked, Rule};
use crate::hal::{ExportError, Exporter, In, Io, Out, Param};
use wire::exchange::{EDGE_TIME_BITS, EncoderStatus};
use wire::map::{
    CountMode, ENCODER_CONFIG_WORDS, ENCODER_FILTER_MAX, ENCODER_INDEX_INVERT, ENCODER_MASK_ENABLE,
    ENCODER_MASK_INVERT,
};
use wire::units::Clocks;

/// As [`CountMode`] numbers them.
const MODES: Rule = Rule::Whole(0, 5);

/// One encoder.
#[derive(Debug)]
pub struct Encoder {
    rawcounts: Out<i32>,
    count: Out<i32>,
    position: Out<f64>,
    position_interp: Out<f64>,
    velocity: Out<f64>,
    velocity_rpm: Out<f64>,
    reset: In<bool>,
    enable: In<bool>,
    index_enable: Io<bool>,
    probe_enable: Io<bool>,
    count_latched: Out<i32>,
    position_latched: Out<f64>,
    quad_error: Out<bool>,
    quad_error_enable: In<bool>,
    quad_errors: Out<u32>,
    scale: Checked<f64>,
    vel_timeout: Checked<f64>,
    filter: Checked<u32>,
    mode: Checked<u32>,
    counter_mode: Param<bool>,
    index_invert: Param<bool>,
    index_mask: Param<bool>,
    index_mask_invert: Param<bool>,
    no_clear: Param<bool>,

    last: Option<EncoderStatus>,
    total: i64,
    zero: i64,
    errors: u32,
    latch: Latching,
    speed: Speed,
}

impl Encoder {
    /// Exports the pins.
    pub fn export(hal: &mut Exporter<'_>) -> Result<Self, ExportError> {
        Ok(Encoder {
            rawcounts: hal.output("rawcounts")?,
            count: hal.output("count")?,
            position: hal.output("position")?,
            position_interp: hal.output("position-interp")?,
            velocity: hal.output("velocity")?,
            velocity_rpm: hal.output("velocity-rpm")?,
            reset: hal.input("reset")?,
            enable: hal.input_from("enable", true)?,
            index_enable: hal.both("index-enable", false)?,
            probe_enable: hal.both("probe-enable", false)?,
            count_latched: hal.output("count-latched")?,
            position_latched: hal.output("position-latched")?,
            quad_error: hal.output("quad-error")?,
            quad_error_enable: hal.input("quad-error-enable")?,
            quad_errors: hal.output("quad-errors")?,
            scale: hal.setting("scale", 1.0, Rule::Divisor)?,
            vel_timeout: hal.setting("vel-timeout", 0.5, Rule::NotNegative)?,
            filter: hal.setting("filter-ns", 100, Rule::Any)?,
            mode: hal.setting("mode", CountMode::X4 as u32, MODES)?,
            counter_mode: hal.param("counter-mode", false)?,
            index_invert: hal.param("index-invert", false)?,
            index_mask: hal.param("index-mask", false)?,
            index_mask_invert: hal.param("index-mask-invert", false)?,
            no_clear: hal.param("no-clear-on-index", false)?,
            last: None,
            total: 0,
            zero: 0,
            errors: 0,
            latch: Latching::default(),
            speed: Speed::default(),
        })
    }

    /// This channel's configuration block: mode and filter.
    pub fn configure(&self, clock_hz: f64) -> [u32; ENCODER_CONFIG_WORDS as usize] {
        let counting = if self.counter_mode.get() {
            CountMode::Counter
        } else {
            CountMode::from_code(self.mode.get()).unwrap_or_default()
        };
        let bit = |parameter: &Param<bool>, bit: u32| u32::from(parameter.get()) * bit;
        let mode = counting as u32
            | bit(&self.index_invert, ENCODER_INDEX_INVERT)
            | bit(&self.index_mask, ENCODER_MASK_ENABLE)
            | bit(&self.index_mask_invert, ENCODER_MASK_INVERT);
        let filter = nanos_to_register(self.filter.get(), clock_hz, 0, ENCODER_FILTER_MAX);
        [mode, filter]
    }

    /// Takes what the board sampled at `now` and publishes it.
    pub fn sampled(
        &mut self,
        status: &EncoderStatus,
        illegal: bool,
        latch_sample: &LatchSample,
        now: Clocks,
        period: Period,
    ) {
        let last = self.last.replace(*status);
        let moved = last.map_or(0, |last| i64::from(status.count.since(last.count)));
        self.total += moved;
        let counts_now = self.enable.get();
        if !counts_now {
            self.zero += moved;
        }
        let scale = self.scale.get();
        if let Some((source, value)) = self.latch.answered(latch_sample) {
            let at = self.total - i64::from(status.count.since(value));
            self.count_latched.set((at - self.zero) as i32);
            self.position_latched.set((at - self.zero) as f64 / scale);
            match source {
                Source::Index => {
                    if !self.no_clear.get() {
                        self.zero = at;
                    }
                    self.index_enable.set(false);
                }
                Source::Probe => self.probe_enable.set(false),
            }
        }
        if self.reset.get() {
            self.zero = self.total;
        }
        self.judge(last, status, illegal);
        let counts = self.total - self.zero;
        self.rawcounts.set(self.total as i32);
        self.count.set(counts as i32);
        self.position.set(counts as f64 / scale);

        let edge = edge_before(now, status.edge_time);
        let timeout = self.vel_timeout.get();
        let counts_per_s = if counts_now {
            self.speed
                .update(moved, edge, now, timeout, period.clock_hz)
        } else {
            self.speed = Speed::default();
            0.0
        };
        self.velocity.set(counts_per_s / scale);
        self.velocity_rpm.set(counts_per_s / scale * 60.0);
        let since = self.speed.since(now, period.clock_hz);
        let beyond = (counts_per_s * since).clamp(-1.0, 1.0);
        self.position_interp.set((counts as f64 + beyond) / scale);
    }

    /// Counts illegal transitions. The board's own count is 8 bits and says how many, its flag says
    /// that there were some even if 256 of them look like none.
    fn judge(&mut self, last: Option<EncoderStatus>, status: &EncoderStatus, illegal: bool) {
        let fresh = last.map_or(0, |last| status.errors.wrapping_sub(last.errors));
        let fresh = u32::from(fresh).max(u32::from(illegal && last.is_some()));
        self.errors = self.errors.wrapping_add(fresh);
        self.quad_errors.set(self.errors);
        if !self.quad_error_enable.get() {
            self.quad_error.set(false);
        } else if fresh > 0 {
            self.quad_error.set(true);
        }
    }

    /// The fabric was reset: it counts from 0 again, but the axis has not moved.
    pub fn rebase(&mut self) {
        self.last = None;
        self.speed = Speed::default();
        self.latch.forget();
    }

    /// Nothing is known of the board's latch any more.
    pub fn forget_latch(&mut self) {
        self.latch.forget();
    }

    /// Whether to latch at the next index and at the probe.
    pub fn command(&mut self, live: bool, sequence: u32) -> (bool, bool) {
        let (index, probe) = (self.index_enable.get(), self.probe_enable.get());
        self.latch.command(index, probe, live, sequence)
    }

    /// Whether the latch holds a value to be fetched.
    pub fn wants_value(&self) -> bool {
        self.latch.wants_value()
    }
}

/// The moment of an edge from its 24 bits: the last such moment before `now`.
fn edge_before(now: Clocks, edge_time: u32) -> Clocks {
    let mask = (1u64 << EDGE_TIME_BITS) - 1;
    let age = now.0.wrapping_sub(u64::from(edge_time)) & mask;
    Clocks(now.0.saturating_sub(age))
}

/// Counts over time between edges.
#[derive(Clone, Copy, Debug, Default)]
struct Speed {
    /// The edge the last velocity was measured to.
    edge: Option<Clocks>,
    per_second: f64,
}

impl Speed {
    fn update(
        &mut self,
        moved: i64,
        edge: Clocks,
        now: Clocks,
        timeout: f64,
        clock_hz: f64,
    ) -> f64 {
        if moved != 0 {
            self.per_second = match self.edge {
                Some(last) if edge > last => {
                    moved as f64 / Clocks(edge.0 - last.0).to_seconds(clock_hz)
                }
                // The first edge after standstill: the start of the movement is not known.
                Some(_) | None => 0.0,
            };
            self.edge = Some(edge);
        } else if let Some(last) = self.edge {
            let idle = Clocks(now.0.saturating_sub(last.0)).to_seconds(clock_hz);
            if idle > timeout {
                *self = Speed::default();
            } else if idle > 0.0 {
                // At a higher velocity there would have been an edge by now.
                let most = 1.0 / idle;
                self.per_second = self.per_second.clamp(-most, most);
            }
        }
        self.per_second
    }

    /// Seconds since the edge.
    fn since(&self, now: Clocks, clock_hz: f64) -> f64 {
        self.edge.map_or(0.0, |edge| {
            Clocks(now.0.saturating_sub(edge.0)).to_seconds(clock_hz)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hal::fake::FakeHal;
    use wire::units::Count;

    struct Bench {
        hal: FakeHal,
        encoder: Encoder,
        now: u64,
        sequence: u32,
    }

    impl Bench {
        fn new() -> Self {
            let mut hal = FakeHal::new();
            let encoder = Encoder::export(&mut Exporter::new(&mut hal, "e")).unwrap();
            let mut bench = Bench {
                hal,
                encoder,
                now: 1 << 40,
                sequence: 0,
            };
            bench.sample(0, 0);
            bench
        }

        /// One period later; the last edge was `ago` clocks before.
        fn sample(&mut self, count: u32, ago: u64) {
            self.answer(count, ago, 0, None);
        }

        /// The same with the error count and a latched index.
        fn answer(&mut self, count: u32, ago: u64, errors: u8, latch: Option<u32>) {
            self.now += 60_000;
            let status = EncoderStatus {
                count: Count(count),
                edge_time: (self.now - ago) as u32 & 0x00ff_ffff,
                errors,
            };
            let latch_sample = LatchSample {
                sequence: self.sequence,
                live: true,
                index: latch.is_some(),
                value: latch.map(Count),
                ..LatchSample::default()
            };
            let period = Period::new(1_000_000, 60_000_000);
            self.encoder
                .sampled(&status, false, &latch_sample, Clocks(self.now), period);
            self.sequence += 1;
            self.encoder.command(true, self.sequence);
        }
    }

    #[test]
    fn the_count_is_right_across_its_wrap() {
        let mut bench = Bench::new();
        bench.sample(u32::MAX, 0);
        bench.sample(u32::MAX - 9, 0);
        assert_eq!(bench.hal.get::<i32>("e.count"), -10);
        bench.hal.set("e.scale", 4.0);
        bench.sample(10, 0);
        assert_eq!(bench.hal.get::<f64>("e.position"), 2.5);
    }

    #[test]
    fn the_index_restarts_the_count_where_it_was_and_clears_its_pin() {
        let mut bench = Bench::new();
        bench.hal.set("e.index-enable", true);
        bench.sample(100, 0);
        bench.sample(100, 0);
        assert_eq!(
            bench.encoder.command(true, bench.sequence + 1),
            (true, false)
        );
        bench.answer(200, 0, 0, Some(150));
        assert_eq!(bench.hal.get::<i32>("e.count"), 50);
        assert_eq!(bench.hal.get::<i32>("e.rawcounts"), 200);
        assert_eq!(bench.hal.get::<i32>("e.count-latched"), 150);
        assert!(!bench.hal.get::<bool>("e.index-enable"));
    }

    #[test]
    fn an_index_that_only_latches_leaves_the_count_alone() {
        let mut bench = Bench::new();
        bench.hal.set("e.no-clear-on-index", true);
        bench.hal.set("e.index-enable", true);
        bench.sample(100, 0);
        bench.sample(100, 0);
        bench.answer(200, 0, 0, Some(150));
        assert_eq!(bench.hal.get::<i32>("e.count"), 200);
        assert_eq!(bench.hal.get::<f64>("e.position-latched"), 150.0);
        assert!(!bench.hal.get::<bool>("e.index-enable"));
    }

    #[test]
    fn reset_holds_the_count_at_zero() {
        let mut bench = Bench::new();
        bench.hal.set("e.reset", true);
        bench.sample(77, 0);
        assert_eq!(bench.hal.get::<i32>("e.count"), 0);
        assert_eq!(bench.hal.get::<i32>("e.rawcounts"), 77);
    }

    #[test]
    fn a_disabled_encoder_does_not_count_and_goes_on_from_where_it_stood() {
        let mut bench = Bench::new();
        bench.sample(10, 0);
        bench.sample(20, 0);
        bench.hal.set("e.enable", false);
        bench.sample(120, 0);
        bench.sample(u32::MAX, 0);
        assert_eq!(bench.hal.get::<i32>("e.count"), 20);
        assert_eq!(bench.hal.get::<f64>("e.position-interp"), 20.0);
        assert_eq!(bench.hal.get::<f64>("e.velocity"), 0.0);
        assert_eq!(bench.hal.get::<i32>("e.rawcounts"), -1);
        bench.hal.set("e.enable", true);
        bench.sample(4, 0);
        assert_eq!(bench.hal.get::<i32>("e.count"), 25);
        // Where the movement began is not known.
        assert_eq!(bench.hal.get::<f64>("e.velocity"), 0.0);
        bench.hal.set("e.enable", false);
        bench.hal.set("e.reset", true);
        bench.sample(9, 0);
        assert_eq!(bench.hal.get::<i32>("e.count"), 0);
    }

    #[test]
    fn velocity_is_measured_between_edges_and_decays_without_them() {
        let mut bench = Bench::new();
        bench.sample(1, 0);
        bench.sample(2, 30_000);
        // One count in half a period: 2000 counts per second.
        assert!((bench.hal.get::<f64>("e.velocity") - 2000.0).abs() < 1e-6);
        assert!((bench.hal.get::<f64>("e.velocity-rpm") - 120_000.0).abs() < 1e-3);
        bench.sample(2, 90_000);
        assert!((bench.hal.get::<f64>("e.velocity") - 1000.0 * 60.0 / 90.0).abs() < 1e-6);
        for i in 0..600 {
            bench.sample(2, 150_000 + i * 60_000);
        }
        assert_eq!(bench.hal.get::<f64>("e.velocity"), 0.0);
    }

    #[test]
    fn one_count_in_a_third_of_a_second_is_still_measured() {
        // 20 million clocks: more than the 24 bits of the edge's time.
        let mut bench = Bench::new();
        let mut count = 0;
        for n in 0..2000u64 {
            let (edges, ago) = (n * 60_000 / 20_000_000, n * 60_000 % 20_000_000);
            count = edges as u32;
            bench.sample(count, ago);
        }
        assert_eq!(count, 5);
        assert!((bench.hal.get::<f64>("e.velocity") - 3.0).abs() < 0.01);
    }

    #[test]
    fn between_two_edges_the_interpolated_position_goes_on_by_less_than_a_count() {
        let mut bench = Bench::new();
        bench.sample(1, 0);
        bench.sample(3, 15_000);
        let interp = bench.hal.get::<f64>("e.position-interp");
        // Two counts in 45 000 clocks, 15 000 clocks ago.
        assert!((interp - (3.0 + 2.0 / 3.0)).abs() < 1e-6, "{interp}");
        bench.sample(3, 75_000);
        let interp = bench.hal.get::<f64>("e.position-interp");
        assert!(interp <= 4.0, "{interp}");
    }

    #[test]
    fn quadrature_errors_are_counted_and_latched_until_cleared() {
        let mut bench = Bench::new();
        bench.hal.set("e.quad-error-enable", true);
        bench.answer(0, 0, 254, None);
        bench.answer(0, 0, 1, None);
        assert_eq!(bench.hal.get::<u32>("e.quad-errors"), 254 + 3);
        bench.answer(0, 0, 1, None);
        assert!(bench.hal.get::<bool>("e.quad-error"));
        bench.hal.set("e.quad-error-enable", false);
        bench.answer(0, 0, 1, None);
        assert!(!bench.hal.get::<bool>("e.quad-error"));
    }

    #[test]
    fn the_mode_word_says_what_the_parameters_say() {
        let bench = Bench::new();
        assert_eq!(bench.encoder.configure(60e6), [0, 6]);
        bench.hal.set("e.mode", 2u32);
        bench.hal.set("e.index-invert", true);
        bench.hal.set("e.index-mask", true);
        bench.hal.set("e.index-mask-invert", true);
        bench.hal.set("e.filter-ns", 1_000_000u32);
        assert_eq!(bench.encoder.configure(60e6), [0x72, 255]);
        bench.hal.set("e.counter-mode", true);
        assert_eq!(bench.encoder.configure(60e6)[0], 0x73);
        bench.hal.set("e.counter-mode", false);
        // There is no such mode: the last good one stays.
        bench.hal.set("e.mode", 99u32);
        assert_eq!(bench.encoder.configure(60e6)[0], 0x72);
    }

    #[test]
    fn a_fabric_reset_does_not_move_the_position() {
        let mut bench = Bench::new();
        bench.sample(500, 0);
        bench.encoder.rebase();
        bench.now = 0;
        bench.sample(0, 0);
        assert_eq!(bench.hal.get::<i32>("e.count"), 500);
    }
}
