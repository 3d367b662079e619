//! How often an exchange took how long: 1601 counters, and quantiles that are always there.
//!
//! A counter holds times that differ by less than 1/64: below 128 ns each time has its own, above
//! that each power of two has 64 (a log-linear histogram, as hdrhistogram's). A time is told as the
//! longest of its counter, so it is never too short, and too long by at most 1/64, 1.6 %. What
//! takes [`LONGEST`] or more is counted together. The longest time of all is kept as it is.
//!
//! [`Follower`] follows one quantile: a new time moves its rank by one at most, so it moves by one
//! used counter at most, and a map of the used ones finds that in [`WORDS`] words. Nothing here
//! allocates or loops over what was measured: the servo thread records into it.

/// Counters of a power of two: 2^6.
const FINE: u32 = 6;
/// 2^30 ns, 1.07 s: longer than any servo period, and than any timeout of a sane configuration.
const TOP: u32 = 30;
/// What takes this long, or longer, has one counter.
pub const LONGEST: u64 = 1 << TOP;
/// All counters.
const COUNTERS: usize = (((TOP - FINE + 1) << FINE) + 1) as usize;
/// Words of the map of used counters.
const WORDS: usize = COUNTERS.div_ceil(64);

/// A quantile as a fraction, so that its rank is exact.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Quantile {
    /// Of so many times,
    pub of: u64,
    /// so many are not longer.
    pub within: u64,
}

impl Quantile {
    /// Half of them.
    pub const P50: Quantile = Quantile { within: 1, of: 2 };
    /// 99 of 100.
    pub const P99: Quantile = Quantile {
        within: 99,
        of: 100,
    };
    /// 999 of 1000.
    pub const P99_9: Quantile = Quantile {
        within: 999,
        of: 1000,
    };

    /// Which of `total` sorted times it is, counted from 1; 0 of none.
    fn rank(self, total: u64) -> u64 {
        let rank = u128::from(total) * u128::from(self.within);
        rank.div_ceil(u128::from(self.of.max(1))) as u64
    }
}

/// The counters.
#[derive(Clone, Debug)]
pub struct Histogram {
    counts: [u64; COUNTERS],
    used: [u64; WORDS],
    total: u64,
    max: u64,
}

impl Default for Histogram {
    fn default() -> Self {
        Histogram {
            counts: [0; COUNTERS],
            used: [0; WORDS],
            total: 0,
            max: 0,
        }
    }
}

/// The counter of a time.
fn counter(nanos: u64) -> usize {
    if nanos >= LONGEST {
        return COUNTERS - 1;
    }
    // Below 2^7 a counter per ns.
    let coarse = (63 - (nanos | 1).leading_zeros()).saturating_sub(FINE);
    ((coarse as usize) << FINE) + (nanos >> coarse) as usize
}

/// The longest time of a counter.
fn longest(counter: usize) -> u64 {
    if counter == COUNTERS - 1 {
        return u64::MAX;
    }
    let coarse = (counter >> FINE).saturating_sub(1);
    let shortest = (counter - (coarse << FINE)) as u64;
    ((shortest + 1) << coarse) - 1
}

impl Histogram {
    /// Counts a time; its counter, for the followers.
    pub fn record(&mut self, nanos: u64) -> usize {
        let at = counter(nanos);
        self.counts[at] += 1;
        self.used[at / 64] |= 1 << (at % 64);
        self.total += 1;
        self.max = self.max.max(nanos);
        at
    }

    /// Forgets all of them.
    pub fn clear(&mut self) {
        self.counts.fill(0);
        self.used.fill(0);
        (self.total, self.max) = (0, 0);
    }

    /// How many times were counted.
    pub fn total(&self) -> u64 {
        self.total
    }

    /// The longest of them, exactly; 0 of none.
    pub fn max(&self) -> u64 {
        self.max
    }

    /// A quantile, by going through all counters; 0 of none.
    pub fn quantile(&self, quantile: Quantile) -> u64 {
        let rank = quantile.rank(self.total);
        let mut seen = 0;
        for (at, count) in self.counts.iter().enumerate() {
            seen += count;
            if seen >= rank && rank > 0 {
                return self.at_most(at);
            }
        }
        0
    }

    /// The used counters: the longest time of each, and how many there are.
    pub fn counted(&self) -> impl Iterator<Item = (u64, u64)> + '_ {
        let all = self.counts.iter().enumerate();
        all.filter(|(_, count)| **count > 0)
            .map(|(at, count)| (self.at_most(at), *count))
    }

    /// The longest time a counter may have counted.
    fn at_most(&self, at: usize) -> u64 {
        longest(at).min(self.max)
    }

    /// The next used counter above.
    fn above(&self, at: usize) -> Option<usize> {
        let (word, bit) = (at / 64, at % 64);
        let here = self.used[word] & (u64::MAX << bit) & !(1 << bit);
        let rest = self.used.iter().copied().enumerate().skip(word + 1);
        let mut words = core::iter::once((word, here)).chain(rest);
        let (word, bits) = words.find(|(_, bits)| *bits != 0)?;
        Some(word * 64 + bits.trailing_zeros() as usize)
    }

    /// The next used counter below.
    fn below(&self, at: usize) -> Option<usize> {
        let (word, bit) = (at / 64, at % 64);
        let here = self.used[word] & ((1 << bit) - 1);
        let rest = self.used[..word].iter().copied().enumerate().rev();
        let mut words = core::iter::once((word, here)).chain(rest);
        let (word, bits) = words.find(|(_, bits)| *bits != 0)?;
        Some(word * 64 + 63 - bits.leading_zeros() as usize)
    }
}

/// Keeps a quantile of a growing histogram.
#[derive(Clone, Copy, Debug)]
pub struct Follower {
    quantile: Quantile,
    /// The counter with the quantile.
    at: usize,
    /// Times in the counters below it.
    before: u64,
}

impl Follower {
    /// Of an empty histogram.
    pub fn new(quantile: Quantile) -> Self {
        Follower {
            quantile,
            at: 0,
            before: 0,
        }
    }

    /// A time was recorded in this counter; the quantile now.
    pub fn recorded(&mut self, histogram: &Histogram, counter: usize) -> u64 {
        if histogram.total == 1 {
            (self.at, self.before) = (counter, 0);
        } else if counter < self.at {
            self.before += 1;
        }
        let rank = self.quantile.rank(histogram.total);
        if self.before >= rank {
            if let Some(below) = histogram.below(self.at) {
                self.at = below;
                self.before -= histogram.counts[below];
            }
        } else if self.before + histogram.counts[self.at] < rank
            && let Some(above) = histogram.above(self.at)
        {
            self.before += histogram.counts[self.at];
            self.at = above;
        }
        histogram.at_most(self.at)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const QUANTILES: [Quantile; 4] = [
        Quantile::P50,
        Quantile::P99,
        Quantile::P99_9,
        Quantile { within: 1, of: 1 },
    ];

    #[test]
    fn the_counters_follow_one_another_without_gap_and_none_is_wider_than_a_64th() {
        let mut expected = 0;
        for at in 0..COUNTERS - 1 {
            assert_eq!(counter(expected), at, "the first of {at}");
            let last = longest(at);
            assert_eq!(counter(last), at, "the last of {at}");
            assert!(last - expected <= expected / 64, "{at}");
            expected = last + 1;
        }
        assert_eq!(expected, LONGEST);
        assert_eq!(counter(u64::MAX), COUNTERS - 1);
    }

    #[test]
    fn an_empty_histogram_says_0() {
        let histogram = Histogram::default();
        assert_eq!((histogram.total(), histogram.max()), (0, 0));
        assert_eq!(histogram.quantile(Quantile::P99), 0);
        assert_eq!(histogram.counted().count(), 0);
    }

    #[test]
    fn a_cleared_histogram_is_as_a_new_one() {
        let mut histogram = Histogram::default();
        for nanos in [5, 70_000, u64::MAX] {
            histogram.record(nanos);
        }
        assert_eq!(histogram.quantile(Quantile::P99), u64::MAX);
        histogram.clear();
        let mut follower = Follower::new(Quantile::P50);
        let counter = histogram.record(1000);
        assert_eq!(follower.recorded(&histogram, counter), 1000);
        assert_eq!(histogram.counted().collect::<Vec<_>>(), [(1000, 1)]);
    }

    /// As exchanges are: around a place, with rare ones far away, and anything.
    fn times() -> impl Strategy<Value = Vec<u64>> {
        let time = prop_oneof![
            8 => 60_000..90_000u64,
            1 => 0..2_000_000u64,
            1 => (0..63u32).prop_map(|bits| 1 << bits),
        ];
        prop::collection::vec(time, 1..400)
    }

    proptest! {
        #[test]
        fn every_quantile_is_the_exact_one_or_longer_by_less_than_a_64th(times in times()) {
            let mut histogram = Histogram::default();
            let mut followers = QUANTILES.map(Follower::new);
            let mut sorted = Vec::new();
            for nanos in times {
                let counter = histogram.record(nanos);
                let place = sorted.partition_point(|it| *it < nanos);
                sorted.insert(place, nanos);
                for follower in &mut followers {
                    let said = follower.recorded(&histogram, counter);
                    let quantile = follower.quantile;
                    prop_assert_eq!(said, histogram.quantile(quantile), "{:?}", quantile);
                    let exact = sorted[quantile.rank(sorted.len() as u64) as usize - 1];
                    prop_assert!(said >= exact, "{said} of {exact}");
                    if exact < LONGEST {
                        prop_assert!(said - exact <= exact / 64, "{said} of {exact}");
                    }
                }
                prop_assert_eq!(histogram.max(), sorted[sorted.len() - 1]);
                prop_assert_eq!(histogram.total(), sorted.len() as u64);
            }
        }
    }
}
