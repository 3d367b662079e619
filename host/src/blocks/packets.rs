//! `packet-error*`: hostmot2's leaky bucket, and how long `read` waits.
//!
//! | name | | |
//! |---|---|---|
//! | `packet-error` | bit out | an answer of the last period did not come in time |
//! | `packet-error-level` | s32 out | rises by `-increment` per period with a missing answer, falls by `-decrement` per period without |
//! | `packet-error-exceeded` | bit out | the level has reached `packet-error-limit`: the board is given up until it answers again |
//! | `packet-error-total` | u32 out | periods with a missing answer since load |
//! | `packet-discarded-total` | u32 out | datagrams discarded unread since load, after more than a board sends in a period |
//! | `packet-read-timeout` | s32 param | 0 or less: 80 % of the period; below 100: percent of the period; else ns. Never below 100 us |
//!
//! Limit, increment and decrement of 0 count as 1, as in hostmot2: the bucket must be able to fill.
//! Negative ones are refused. The timeout counts from `read-request` where there is one, or else
//! from the first board's `read`.

use crate::hal::checked::{Checked, Rule};
use crate::hal::{ExportError, Exporter, Out};
use std::time::Duration;

/// 80 % of the period, hostmot2's default.
const DEFAULT_READ_TIMEOUT: i32 = 80;
/// 0 counts as 1.
const LEVELS: Rule = Rule::Whole(0, i32::MAX);

/// The counters and their parameters.
#[derive(Debug)]
pub struct Packets {
    error: Out<bool>,
    level: Out<i32>,
    exceeded: Out<bool>,
    total: Out<u32>,
    discarded: Out<u32>,
    limit: Checked<i32>,
    increment: Checked<i32>,
    decrement: Checked<i32>,
    read_timeout: Checked<i32>,
}

impl Packets {
    /// Exports the pins; the prefix is the board's.
    pub fn export(hal: &mut Exporter<'_>) -> Result<Self, ExportError> {
        Ok(Packets {
            error: hal.output("packet-error")?,
            level: hal.output("packet-error-level")?,
            exceeded: hal.output("packet-error-exceeded")?,
            total: hal.output("packet-error-total")?,
            discarded: hal.output("packet-discarded-total")?,
            limit: hal.setting("packet-error-limit", 10, LEVELS)?,
            increment: hal.setting("packet-error-increment", 2, LEVELS)?,
            decrement: hal.setting("packet-error-decrement", 1, LEVELS)?,
            read_timeout: hal.setting("packet-read-timeout", DEFAULT_READ_TIMEOUT, Rule::Any)?,
        })
    }

    /// An answer came in time.
    pub fn good(&self) {
        self.error.set(false);
        let level = self.level.get().saturating_sub(self.decrement.get().max(1));
        self.level.set(level.max(0));
    }

    /// An answer is missing; `true` if the level has reached the limit.
    #[must_use]
    pub fn missing(&self) -> bool {
        self.error.set(true);
        self.total.set(self.total.get().wrapping_add(1));
        let limit = self.limit.get().max(1);
        let level = self.level.get().saturating_add(self.increment.get().max(1));
        self.level.set(level.min(limit));
        let exceeded = level >= limit;
        if exceeded {
            self.exceeded.set(true);
        }
        exceeded
    }

    /// So many datagrams were thrown away unread.
    pub fn discarded(&self, unread: u32) {
        self.discarded
            .set(self.discarded.get().wrapping_add(unread));
    }

    /// The board answers again: start with an empty bucket.
    pub fn recovered(&self) {
        self.error.set(false);
        self.level.set(0);
        self.exceeded.set(false);
    }

    /// Whether the board is given up.
    pub fn exceeded(&self) -> bool {
        self.exceeded.get()
    }

    /// How long `read` may still wait in a period of this length, so long after asking.
    pub fn left(&self, period_ns: i64, since_ns: i64) -> Duration {
        let patience = patience_ns(self.read_timeout.get(), period_ns);
        Duration::from_nanos(patience.saturating_sub(since_ns.max(0) as u64))
    }
}

/// What `read` waits in a period of this length, if HAL says nothing else.
#[cfg(feature = "tool")]
pub(crate) fn default_timeout_ns(period_ns: i64) -> u64 {
    patience_ns(DEFAULT_READ_TIMEOUT, period_ns)
}

/// hostmot2's meaning of `packet-read-timeout`.
fn patience_ns(timeout: i32, period_ns: i64) -> u64 {
    let percent = |percent: i64| period_ns.max(0) * percent / 100;
    let wanted = match timeout {
        ..=0 => percent(80),
        1..100 => percent(i64::from(timeout)),
        100.. => i64::from(timeout),
    };
    // 100 us: less than that no network stack can promise.
    wanted.max(100_000) as u64
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hal::fake::FakeHal;

    #[test]
    fn the_read_timeout_means_what_it_means_in_hostmot2() {
        for (timeout, period, expected) in [
            (80, 1_000_000, 800_000),
            (0, 1_000_000, 800_000),
            (-5, 1_000_000, 800_000),
            (50, 1_000_000, 500_000),
            (99, 1_000_000, 990_000),
            (100, 1_000_000, 100_000),
            (300_000, 1_000_000, 300_000),
            (10, 100_000, 100_000),
            (2_000_000_000, 1_000_000, 2_000_000_000),
        ] {
            assert_eq!(patience_ns(timeout, period), expected, "{timeout}");
        }
    }

    #[test]
    fn the_fifth_missing_answer_in_a_row_is_one_too_many() {
        let mut hal = FakeHal::new();
        let packets = Packets::export(&mut Exporter::new(&mut hal, "b")).unwrap();
        for _ in 0..4 {
            assert!(!packets.missing());
        }
        assert!(packets.missing());
        assert!(hal.get::<bool>("b.packet-error-exceeded"));
        assert_eq!(hal.get::<u32>("b.packet-error-total"), 5);
    }

    #[test]
    fn one_missing_answer_in_three_never_adds_up() {
        let mut hal = FakeHal::new();
        let packets = Packets::export(&mut Exporter::new(&mut hal, "b")).unwrap();
        for _ in 0..1000 {
            assert!(!packets.missing());
            packets.good();
            packets.good();
        }
        assert_eq!(hal.get::<i32>("b.packet-error-level"), 0);
    }
}
