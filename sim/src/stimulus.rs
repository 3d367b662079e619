//! What tests of the cores share: the seed of a run, random numbers as a stimulus needs them, and
//! the bus writes that bring the cores to where a job can begin.

pub mod frames;

use crate::model::board::pages;
use rand::Rng;
use wire::regmap::{timebase, watchdog};

/// A write on the cores' bus: page, word, data.
pub type Write = (u32, u32, u32);

/// What the environment says, or this.
pub fn from_environment<T>(name: &str, otherwise: T) -> T
where
    T: std::str::FromStr<Err: std::fmt::Display>,
{
    let Ok(text) = std::env::var(name) else {
        return otherwise;
    };
    text.parse()
        .unwrap_or_else(|error| panic!("{name}={text}: {error}"))
}

/// The seed of this run: `FERROCNC_SEED`, or one from the clock. Printed, and part of every message
/// that depends on it.
pub fn seed() -> u64 {
    let now = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH);
    let now = now.map_or(1, |since| since.as_millis() as u64);
    let seed = from_environment("FERROCNC_SEED", now);
    println!("FERROCNC_SEED={seed}");
    seed
}

/// Random numbers as a stimulus needs them.
pub trait Chance: Rng {
    /// Below `n`; 0 if `n` is 0.
    fn below(&mut self, n: u32) -> u32 {
        self.random_range(0..n.max(1))
    }

    /// True once in `n` times.
    fn one_in(&mut self, n: u32) -> bool {
        self.below(n) == 0
    }

    /// Any word, small and large ones alike.
    fn spread(&mut self) -> u32 {
        let shift = self.below(32);
        self.random::<u32>() >> shift
    }
}

impl<R: Rng> Chance for R {}

/// Brings the cores to where a job can begin: these words for each stepgen, a watchdog that does
/// not bite, armed, and one commit.
pub fn before_a_job(stepgens: u32, words: [u32; 6]) -> impl Iterator<Item = Write> {
    let of = move |n| (0..).zip(words).map(move |(at, data)| (n, at, data));
    let settings = (pages::STEPGEN..pages::STEPGEN + stepgens).flat_map(of);
    let watchdog = |word: usize, data| (pages::WATCHDOG, word as u32, data);
    settings.chain([
        watchdog(watchdog::TIMEOUT, u32::MAX),
        watchdog(watchdog::GRACE, 1000),
        watchdog(watchdog::CONTROL, watchdog::CONTROL_KEY_CLEAR),
        watchdog(watchdog::CONTROL, watchdog::CONTROL_KEY_ARM),
        (
            pages::TIMEBASE,
            timebase::STROBE as u32,
            timebase::STROBE_COMMIT,
        ),
    ])
}
