//! `encoder.<nn>`: a quadrature count as position and velocity.
//!
//! | name | | |
//! |---|---|---|
//! | `rawcounts` | s32 out | counts since load |
//! | `count` | s32 out | counts since the last reset or index |
//! | `position` | float out | `count / scale` |
//! | `velocity`, `velocity-rpm` | float out | per second, and times 60 |
//! | `reset` | bit in | while true `count` is 0 |
//! | `index-enable` | bit io | set it; at the next index `count` restarts there and it falls |
//! | `scale` | float param | counts per unit |
//! | `vel-timeout` | float param | s, 0.5: after this long without an edge the velocity is 0 |
//! | `filter-ns` | u32 param | an input must be stable this long to count |
//!
//! Velocity is counts between edges over the time between those edges, by the board's clock, so it
//! has no quantisation at low speed; without a new edge it decays as one count over the time since.

use super::{Period, nanos_to_register, scale_or_one};
use crate::hal::{ExportError, Exporter, In, Io, Out, Param};
use wire::exchange::EncoderStatus;
use wire::map::ENCODER_CONFIG_WORDS;
use wire::units::{Clocks, Count};

/// One encoder.
#[derive(Debug)]
pub struct Encoder {
    rawcounts: Out<i32>,
    count: Out<i32>,
    position: Out<f64>,
    velocity: Out<f64>,
    velocity_rpm: Out<f64>,
    reset: In<bool>,
    index_enable: Io<bool>,
    scale: Param<f64>,
    vel_timeout: Param<f64>,
    filter: Param<u32>,

    last: Option<Count>,
    total: i64,
    zero: i64,
    index: Index,
    speed: Speed,
}

/// Where the latch of the index stands. The board's flag stays up until its arm bit falls, so a new
/// wish first waits for that.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Index {
    /// The arm bit is down; the flag may still be up.
    Idle,
    /// The arm bit is up.
    Armed,
}

impl Encoder {
    /// Exports the pins.
    pub fn export(hal: &mut Exporter<'_>) -> Result<Self, ExportError> {
        Ok(Encoder {
            rawcounts: hal.output("rawcounts")?,
            count: hal.output("count")?,
            position: hal.output("position")?,
            velocity: hal.output("velocity")?,
            velocity_rpm: hal.output("velocity-rpm")?,
            reset: hal.input("reset")?,
            index_enable: hal.both("index-enable", false)?,
            scale: hal.param("scale", 1.0)?,
            vel_timeout: hal.param("vel-timeout", 0.5)?,
            filter: hal.param("filter-ns", 100)?,
            last: None,
            total: 0,
            zero: 0,
            index: Index::Idle,
            speed: Speed::default(),
        })
    }

    /// This channel's configuration block: x4 and the filter.
    pub fn configure(&self, clock_hz: f64) -> [u32; ENCODER_CONFIG_WORDS as usize] {
        [0, nanos_to_register(self.filter.get(), clock_hz, 0, 8)]
    }

    /// Takes what the board sampled at `now` and publishes it.
    pub fn sampled(&mut self, status: &EncoderStatus, latched: bool, now: Clocks, period: Period) {
        let moved = match self.last.replace(status.count) {
            Some(last) => i64::from(status.count.since(last)),
            None => 0,
        };
        self.total += moved;
        if self.index == Index::Armed && latched {
            self.zero = self.total - i64::from(status.count.since(status.latch));
            self.index = Index::Idle;
            self.index_enable.set(false);
        } else if self.index == Index::Idle && !latched && self.index_enable.get() {
            self.index = Index::Armed;
        } else if !self.index_enable.get() {
            self.index = Index::Idle;
        }
        if self.reset.get() {
            self.zero = self.total;
        }
        let counts = self.total - self.zero;
        let scale = scale_or_one(self.scale.get());
        self.rawcounts.set(self.total as i32);
        self.count.set(counts as i32);
        self.position.set(counts as f64 / scale);

        let edge = Clocks(
            now.0
                .wrapping_sub(u64::from((now.0 as u32).wrapping_sub(status.edge_time))),
        );
        let per_second =
            self.speed
                .update(moved, edge, now, self.vel_timeout.get(), period.clock_hz)
                / scale;
        self.velocity.set(per_second);
        self.velocity_rpm.set(per_second * 60.0);
    }

    /// The fabric was reset: it counts from nothing, the axis stands where it stood.
    pub fn rebase(&mut self) {
        self.last = None;
        self.speed = Speed::default();
    }

    /// Whether to latch at the next index.
    pub fn command(&self) -> bool {
        self.index == Index::Armed && self.index_enable.get()
    }
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
                // The first edge after standing still: when the movement began is not known.
                Some(_) | None => 0.0,
            };
            self.edge = Some(edge);
        } else if let Some(last) = self.edge {
            let idle = Clocks(now.0.saturating_sub(last.0)).to_seconds(clock_hz);
            if idle > timeout {
                *self = Speed::default();
            } else if idle > 0.0 {
                // It would have shown an edge by now if it were faster than this.
                let most = 1.0 / idle;
                self.per_second = self.per_second.clamp(-most, most);
            }
        }
        self.per_second
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hal::fake::FakeHal;

    struct Bench {
        hal: FakeHal,
        encoder: Encoder,
        now: u64,
    }

    impl Bench {
        fn new() -> Self {
            let mut hal = FakeHal::new();
            let encoder = Encoder::export(&mut Exporter::new(&mut hal, "e")).unwrap();
            let mut bench = Bench {
                hal,
                encoder,
                now: 1 << 40,
            };
            bench.sample(0, 0, false, 0);
            bench
        }

        /// One period later; the last edge was `ago` clocks before.
        fn sample(&mut self, count: u32, latch: u32, latched: bool, ago: u64) {
            self.now += 60_000;
            let status = EncoderStatus {
                count: Count(count),
                latch: Count(latch),
                edge_time: (self.now - ago) as u32,
            };
            let period = Period::new(1_000_000, 60_000_000);
            self.encoder
                .sampled(&status, latched, Clocks(self.now), period);
        }
    }

    #[test]
    fn the_count_is_right_across_its_wrap() {
        let mut bench = Bench::new();
        bench.sample(u32::MAX, 0, false, 0);
        bench.sample(u32::MAX - 9, 0, false, 0);
        assert_eq!(bench.hal.get::<i32>("e.count"), -10);
        bench.hal.set("e.scale", 4.0);
        bench.sample(10, 0, false, 0);
        assert_eq!(bench.hal.get::<f64>("e.position"), 2.5);
    }

    #[test]
    fn the_index_restarts_the_count_where_it_was_and_clears_its_pin() {
        let mut bench = Bench::new();
        bench.hal.set("e.index-enable", true);
        bench.sample(100, 0, false, 0);
        assert!(bench.encoder.command());
        bench.sample(200, 150, true, 0);
        assert_eq!(bench.hal.get::<i32>("e.count"), 50);
        assert_eq!(bench.hal.get::<i32>("e.rawcounts"), 200);
        assert!(!bench.hal.get::<bool>("e.index-enable"));
        assert!(!bench.encoder.command());
    }

    #[test]
    fn a_latch_left_over_from_the_last_index_is_not_taken_again() {
        let mut bench = Bench::new();
        bench.hal.set("e.index-enable", true);
        bench.sample(100, 50, true, 0);
        assert!(!bench.encoder.command());
        assert!(bench.hal.get::<bool>("e.index-enable"));
        bench.sample(100, 50, false, 0);
        assert!(bench.encoder.command());
    }

    #[test]
    fn reset_holds_the_count_at_zero() {
        let mut bench = Bench::new();
        bench.hal.set("e.reset", true);
        bench.sample(77, 0, false, 0);
        assert_eq!(bench.hal.get::<i32>("e.count"), 0);
        assert_eq!(bench.hal.get::<i32>("e.rawcounts"), 77);
    }

    #[test]
    fn velocity_is_measured_between_edges_and_decays_without_them() {
        let mut bench = Bench::new();
        bench.sample(1, 0, false, 0);
        bench.sample(2, 0, false, 30_000);
        // One count in half a period: 2000 counts per second.
        assert!((bench.hal.get::<f64>("e.velocity") - 2000.0).abs() < 1e-6);
        assert!((bench.hal.get::<f64>("e.velocity-rpm") - 120_000.0).abs() < 1e-3);
        bench.sample(2, 0, false, 90_000);
        assert!((bench.hal.get::<f64>("e.velocity") - 1000.0 * 60.0 / 90.0).abs() < 1e-6);
        for i in 0..600 {
            bench.sample(2, 0, false, 150_000 + i * 60_000);
        }
        assert_eq!(bench.hal.get::<f64>("e.velocity"), 0.0);
    }

    #[test]
    fn a_fabric_reset_does_not_move_the_position() {
        let mut bench = Bench::new();
        bench.sample(500, 0, false, 0);
        bench.encoder.rebase();
        bench.now = 0;
        bench.sample(0, 0, false, 0);
        assert_eq!(bench.hal.get::<i32>("e.count"), 500);
    }
}
