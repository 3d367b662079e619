//! `exchange.time-ns*`: how long exchanges take, and which of them are late or lost.
//!
//! | pin | | |
//! |---|---|---|
//! | `exchange.time-ns-p50` | u32 out | half of the exchanges take no longer, ns |
//! | `exchange.time-ns-p99` | u32 out | 99 of 100 take no longer |
//! | `exchange.time-ns-max` | u32 out | the longest |
//! | `exchange.late` | u32 out | answers that came after `read` had gone on without them |
//! | `exchange.lost` | u32 out | answers that did not come within 64 exchanges, or a session |
//! | `exchange.reset` | bit in | a rising edge begins all of them anew |
//!
//! All of it is since load, or since the last reset. The time is that from the call which sends the
//! command to the moment the kernel has the answer: what the network and the board take, not how
//! late `read` looks. A late answer is only counted. [`crate::histogram`] says how exact the times
//! are; the longest is exact.

use crate::hal::{ExportError, Exporter, In, Out};
use crate::histogram::{Follower, Histogram, Quantile};

/// Exchanges whose answers are still expected: a bit each.
const WINDOW: u32 = u64::BITS;

/// The pins and what they are made of.
#[derive(Debug)]
pub struct Exchanges {
    p50: Out<u32>,
    p99: Out<u32>,
    max: Out<u32>,
    late: Out<u32>,
    lost: Out<u32>,
    reset: In<bool>,
    /// `reset` as it was.
    was_reset: bool,
    histogram: Box<Histogram>,
    followers: [Follower; 2],
    expected: Expected,
}

/// The answers that have not come.
#[derive(Debug, Default)]
pub(crate) struct Expected {
    newest: u32,
    /// Bit n: the one of exchange `newest - n`.
    window: u64,
}

impl Expected {
    /// A command was sent. How many answers are given up for it.
    pub(crate) fn sent(&mut self, sequence: u32) -> u32 {
        let steps = sequence.wrapping_sub(self.newest);
        let (gone, left) = match steps {
            0 => (0, self.window),
            1..WINDOW => (self.window >> (WINDOW - steps), self.window << steps),
            // Another session's numbers.
            _ => (self.window, 0),
        };
        (self.newest, self.window) = (sequence, left | 1);
        gone.count_ones()
    }

    /// An answer has come; `false` if none was expected: another one of it has.
    pub(crate) fn came(&mut self, sequence: u32) -> bool {
        let back = self.newest.wrapping_sub(sequence);
        let bit = 1u64.checked_shl(back).unwrap_or(0);
        let expected = self.window & bit != 0;
        self.window &= !bit;
        expected
    }

    /// The session is over. How many answers are given up.
    pub(crate) fn given_up(&mut self) -> u32 {
        core::mem::take(&mut self.window).count_ones()
    }
}

impl Exchanges {
    /// Exports the pins; the prefix is the board's.
    pub fn export(hal: &mut Exporter<'_>) -> Result<Self, ExportError> {
        let mut hal = hal.under("exchange");
        Ok(Exchanges {
            p50: hal.output("time-ns-p50")?,
            p99: hal.output("time-ns-p99")?,
            max: hal.output("time-ns-max")?,
            late: hal.output("late")?,
            lost: hal.output("lost")?,
            reset: hal.input("reset")?,
            was_reset: false,
            histogram: Box::default(),
            followers: followers(),
            expected: Expected::default(),
        })
    }

    /// A command was sent.
    pub fn sent(&mut self, sequence: u32) {
        let lost = self.expected.sent(sequence);
        self.add_lost(lost);
    }

    /// Its answer came so long after it, while `read` waited for it. Of two answers the first
    /// counts.
    pub fn answered(&mut self, sequence: u32, nanos: u64) {
        if !self.expected.came(sequence) {
            return;
        }
        let counter = self.histogram.record(nanos);
        let pins = [&self.p50, &self.p99];
        for (pin, follower) in pins.into_iter().zip(&mut self.followers) {
            pin.set(to_u32(follower.recorded(&self.histogram, counter)));
        }
        self.max.set(to_u32(self.histogram.max()));
    }

    /// Its answer came, and `read` does not wait for it any more.
    pub fn late(&mut self, sequence: u32) {
        if self.expected.came(sequence) {
            self.late.set(self.late.get().wrapping_add(1));
        }
    }

    /// A session is over: its answers come no more.
    pub fn given_up(&mut self) {
        let lost = self.expected.given_up();
        self.add_lost(lost);
    }

    fn add_lost(&self, lost: u32) {
        if lost > 0 {
            self.lost.set(self.lost.get().wrapping_add(lost));
        }
    }

    /// Begins anew at a rising edge of `reset`.
    pub fn follow_reset(&mut self) {
        let now = self.reset.get();
        if core::mem::replace(&mut self.was_reset, now) || !now {
            return;
        }
        self.histogram.clear();
        self.followers = followers();
        for pin in [&self.p50, &self.p99, &self.max, &self.late, &self.lost] {
            pin.set(0);
        }
    }
}

fn followers() -> [Follower; 2] {
    [Quantile::P50, Quantile::P99].map(Follower::new)
}

fn to_u32(nanos: u64) -> u32 {
    u32::try_from(nanos).unwrap_or(u32::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hal::fake::FakeHal;

    fn exported() -> (FakeHal, Exchanges) {
        let mut hal = FakeHal::new();
        let exchanges = Exchanges::export(&mut Exporter::new(&mut hal, "b")).unwrap();
        (hal, exchanges)
    }

    fn told(hal: &FakeHal) -> [u32; 5] {
        ["time-ns-p50", "time-ns-p99", "time-ns-max", "late", "lost"]
            .map(|name| hal.get(&format!("b.exchange.{name}")))
    }

    #[test]
    fn the_pins_say_median_99th_percentile_and_longest() {
        let (hal, mut exchanges) = exported();
        for n in 1..=100 {
            exchanges.sent(n);
            exchanges.answered(n, u64::from(n));
        }
        assert_eq!(told(&hal), [50, 99, 100, 0, 0]);
        exchanges.sent(101);
        exchanges.answered(101, u64::MAX);
        assert_eq!(told(&hal), [51, 100, u32::MAX, 0, 0]);
    }

    #[test]
    fn an_answer_is_late_when_it_comes_after_all_and_lost_when_it_does_not() {
        let (hal, mut exchanges) = exported();
        // Numbers go on over their end.
        let at = |n: u32| (u32::MAX - 9).wrapping_add(n);
        for n in 0..10 {
            exchanges.sent(at(n));
        }
        exchanges.late(at(7));
        exchanges.late(at(7));
        exchanges.answered(at(8), 100);
        exchanges.late(at(8));
        assert_eq!(told(&hal)[3..], [1, 0], "7 is late, once; 8 was in time");
        for n in 10..10 + WINDOW {
            exchanges.sent(at(n));
            exchanges.answered(at(n), 100);
        }
        assert_eq!(told(&hal)[3..], [1, 8]);
        exchanges.late(at(0));
        assert_eq!(told(&hal)[3..], [1, 8], "it was given up");
    }

    #[test]
    fn what_a_session_has_not_answered_is_lost_with_it() {
        let (hal, mut exchanges) = exported();
        for n in 1..=3 {
            exchanges.sent(n);
        }
        exchanges.answered(2, 100);
        exchanges.given_up();
        exchanges.sent(900);
        exchanges.late(1);
        exchanges.answered(900, 100);
        exchanges.sent(5);
        assert_eq!(told(&hal)[3..], [0, 2]);
    }

    #[test]
    fn a_rising_edge_of_reset_begins_anew_and_a_high_one_counts_on() {
        let (hal, mut exchanges) = exported();
        exchanges.sent(1);
        exchanges.sent(2);
        exchanges.late(1);
        exchanges.answered(2, 5000);
        hal.set("b.exchange.reset", true);
        exchanges.follow_reset();
        assert_eq!(told(&hal), [0; 5]);
        exchanges.sent(3);
        exchanges.answered(3, 40);
        exchanges.follow_reset();
        assert_eq!(told(&hal), [40, 40, 40, 0, 0]);
        hal.set("b.exchange.reset", false);
        exchanges.follow_reset();
        assert_eq!(told(&hal), [40, 40, 40, 0, 0]);
    }
}
