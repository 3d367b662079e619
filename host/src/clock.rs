//! Estimates the time of each board's clock, and chooses one common moment for all boards.
//!
//! Every exchange says when this computer sent it and when the board's clock saw its last byte
//! arrive. The difference is the offset between the two clocks plus the time on the way, and the
//! way is never shorter than the cable: of many exchanges the fastest ones are the most exact; the
//! others include delays of a busy computer. So the least difference of every 64 exchanges is kept,
//! a line through those minima gives the drift (a median of slopes: a window in which nothing was
//! fast does not bend it), and the line is laid against them from below.
//!
//! What remains is the fastest way itself, some microseconds that are nearly the same for boards at
//! the same switch. For "all at once" only its differences matter.

use std::sync::Arc;
use std::sync::atomic::{AtomicI64, AtomicU64, Ordering::Relaxed};
use std::time::Instant;
use wire::units::Clocks;

/// Exchanges per minimum: 64 ms at 1 kHz. One in 64 finds the computer idle, unless it is
/// overloaded.
const WINDOW: u32 = 64;
/// Minima the drift is measured over: 1 s at 1 kHz. Crystals do not change in that time.
const MINIMA: usize = 16;
/// Minima before anything is claimed: 256 ms at 1 kHz. Without a drift a crystal 100 ppm off is 12
/// us away after two windows.
const ENOUGH: usize = 4;
/// 500 ppm: two bad crystals are 200 apart. A larger difference is not a crystal's: the board's
/// time is simulated, for example in lockstep, and the clocks cannot be compared.
const DRIFT_MAX: f64 = 500e-6;
/// Minima the offset is taken from: few, so that an error of the drift has no time to grow.
const NEWEST: usize = 4;

/// Compares a board's clock with this computer's.
#[derive(Debug)]
pub struct BoardClock {
    hz: f64,
    /// First moment seen, here (ns) and there (clocks): everything else counts from it.
    start: Option<(i64, u64)>,
    minima: [Point; MINIMA],
    /// Minima taken since the start.
    taken: usize,
    /// Exchanges in the present window, and the best of them.
    seen: u32,
    best: Point,
    /// The line: ns ahead at the start, ns per ns.
    base: f64,
    slope: f64,
}

/// One exchange: when (ns since the start), and how far the board was ahead then (ns).
#[derive(Clone, Copy, Debug, Default)]
struct Point {
    at: f64,
    ahead: f64,
}

impl BoardClock {
    /// For a board of this clock.
    pub fn new(clock_hz: u32) -> Self {
        BoardClock {
            hz: f64::from(clock_hz.max(1)),
            start: None,
            minima: [Point::default(); MINIMA],
            taken: 0,
            seen: 0,
            best: Point::default(),
            base: 0.0,
            slope: 0.0,
        }
    }

    /// The board's clock has jumped: begin again.
    pub fn forget(&mut self) {
        *self = BoardClock::new(self.hz as u32);
    }

    /// An exchange sent at `host` ns arrived at `board`.
    pub fn exchanged(&mut self, host: i64, board: Clocks) {
        let (host0, board0) = *self.start.get_or_insert((host, board.0));
        let at = (host - host0) as f64;
        let there = board.0.wrapping_sub(board0) as i64 as f64 * 1e9 / self.hz;
        let point = Point {
            at,
            ahead: there - at,
        };
        if self.seen == 0 || self.height(point) < self.height(self.best) {
            self.best = point;
        }
        // A faster way than any before: known at once.
        if self.known() {
            self.base = self.base.min(self.height(point));
        }
        self.seen += 1;
        if self.seen == WINDOW {
            self.seen = 0;
            self.minima[self.taken % MINIMA] = self.best;
            self.taken += 1;
            self.fit();
        }
    }

    /// Whether there are enough minima.
    pub fn known(&self) -> bool {
        self.taken >= ENOUGH && self.slope.abs() <= DRIFT_MAX
    }

    /// The board's clock at `host` ns.
    pub fn board_at(&self, host: i64) -> Option<Clocks> {
        let (host0, board0) = self.start.filter(|_| self.known())?;
        let at = (host - host0) as f64;
        let nanos = at + self.base + self.slope * at;
        let clocks = (nanos * self.hz / 1e9).round() as i64;
        Some(Clocks(board0.wrapping_add_signed(clocks)))
    }

    /// How far the board is ahead at `host`, ns, and how much faster it runs, ppm.
    pub fn compared(&self, host: i64) -> Option<(f64, f64)> {
        let (host0, board0) = self.start.filter(|_| self.known())?;
        let at = (host - host0) as f64;
        let start = board0 as f64 * 1e9 / self.hz - host0 as f64;
        Some((start + self.base + self.slope * at, self.slope * 1e6))
    }

    /// How far a point is above a line of the present slope through the start.
    fn height(&self, point: Point) -> f64 {
        point.ahead - self.slope * point.at
    }

    fn fit(&mut self) {
        let count = self.taken.min(MINIMA);
        // Oldest first.
        let minimum = |n: usize| self.minima[(self.taken - count + n) % MINIMA];
        let half = count / 2;
        let mut slopes = [0.0; MINIMA / 2];
        for (n, slope) in slopes[..half].iter_mut().enumerate() {
            let (early, late) = (minimum(n), minimum(n + count - half));
            *slope = (late.ahead - early.ahead) / (late.at - early.at).max(1.0);
        }
        let slopes = &mut slopes[..half];
        slopes.sort_unstable_by(f64::total_cmp);
        let slope = slopes.get(half / 2).copied().unwrap_or(0.0);
        let newest = (count.saturating_sub(NEWEST)..count).map(minimum);
        let base = newest
            .map(|point| point.ahead - slope * point.at)
            .fold(f64::INFINITY, f64::min);
        (self.slope, self.base) = (slope, base);
    }
}

/// This computer's time, and the moments from which all boards of a servo period count.
#[derive(Debug)]
pub struct Timebase {
    epoch: Instant,
    /// The time, when a test says it; negative: the clock's.
    scripted: AtomicI64,
    /// When this period's answers began to be waited for.
    pub reads: Moment,
    /// When this period's commands began to be sent.
    pub writes: Moment,
}

/// One moment of a servo period that several drivers share. A driver that asks for the second time
/// begins the next moment, so no driver has to be the first.
#[derive(Debug, Default)]
pub struct Moment {
    generation: AtomicU64,
    at: AtomicI64,
}

impl Moment {
    /// The moment, ns; `used` is what the caller was given last and begins as 0.
    pub fn of(&self, used: &mut u64, now: i64) -> i64 {
        let generation = self.generation.load(Relaxed);
        if *used == generation {
            self.at.store(now, Relaxed);
            self.generation.store(generation + 1, Relaxed);
        }
        *used = self.generation.load(Relaxed);
        self.at.load(Relaxed)
    }
}

impl Timebase {
    /// The monotonic clock.
    pub fn new() -> Arc<Self> {
        Self::starting(-1)
    }

    /// A clock that stands until [`Timebase::set`] moves it.
    pub fn scripted() -> Arc<Self> {
        Self::starting(0)
    }

    fn starting(scripted: i64) -> Arc<Self> {
        Arc::new(Timebase {
            epoch: Instant::now(),
            scripted: AtomicI64::new(scripted),
            reads: Moment::default(),
            writes: Moment::default(),
        })
    }

    /// ns since it was made.
    pub fn now(&self) -> i64 {
        match self.scripted.load(Relaxed) {
            ..0 => i64::try_from(self.epoch.elapsed().as_nanos()).unwrap_or(i64::MAX),
            scripted => scripted,
        }
    }

    /// Moves a scripted clock.
    pub fn set(&self, nanos: i64) {
        self.scripted.store(nanos, Relaxed);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    struct Random(u64);

    impl Random {
        fn next(&mut self) -> u64 {
            self.0 ^= self.0 >> 12;
            self.0 ^= self.0 << 25;
            self.0 ^= self.0 >> 27;
            self.0.wrapping_mul(0x2545_f491_4f6c_dd1d)
        }

        /// 5 us of cable and stack, up to 200 us of a busy computer, rarely more.
        fn delay(&mut self) -> f64 {
            let busy = self.next() % 200_000;
            let slow = if self.next().is_multiple_of(50) {
                2_000_000
            } else {
                0
            };
            // A third of the exchanges finds the way free, within 1 us.
            let busy = if self.next().is_multiple_of(3) {
                busy % 1000
            } else {
                busy
            };
            5_000.0 + (busy + slow) as f64
        }
    }

    /// A board's clock as physics has it.
    struct True {
        hz: f64,
        offset: f64,
        ppm: f64,
    }

    impl True {
        fn at(&self, nanos: f64) -> f64 {
            (nanos * (1.0 + self.ppm * 1e-6) + self.offset) * self.hz / 1e9
        }

        fn nanos(&self, clocks: f64) -> f64 {
            (clocks * 1e9 / self.hz - self.offset) / (1.0 + self.ppm * 1e-6)
        }
    }

    #[test]
    fn four_boards_with_other_clocks_agree_on_a_moment_within_3_us() {
        for seed in 1..=20u64 {
            let mut random = Random(seed.wrapping_mul(0x9e37_79b9_7f4a_7c15));
            let boards = [
                True {
                    hz: 60e6,
                    offset: 5e12,
                    ppm: 43.0,
                },
                True {
                    hz: 50e6,
                    offset: 1e9,
                    ppm: -61.0,
                },
                True {
                    hz: 60e6,
                    offset: 7.7e15,
                    ppm: 0.0,
                },
                True {
                    hz: 40e6,
                    offset: 3e3,
                    ppm: 99.0,
                },
            ];
            let mut clocks = boards
                .each_ref()
                .map(|board| BoardClock::new(board.hz as u32));
            let mut worst = 0.0f64;
            for period in 0..20_000i64 {
                let now = period * 1_000_000;
                for (clock, board) in clocks.iter_mut().zip(&boards) {
                    let arrival = board.at(now as f64 + random.delay());
                    clock.exchanged(now, Clocks(arrival as u64));
                }
                if period < 500 {
                    continue;
                }
                // The moment each board will act, in true time.
                let moments = clocks
                    .each_ref()
                    .map(|clock| clock.board_at(now + 250_000).unwrap());
                let acts: Vec<f64> = moments
                    .iter()
                    .zip(&boards)
                    .map(|(at, board)| board.nanos(at.0 as f64))
                    .collect();
                let (first, last) = acts
                    .iter()
                    .fold((f64::MAX, f64::MIN), |(a, b), t| (a.min(*t), b.max(*t)));
                worst = worst.max(last - first);
            }
            assert!(worst < 3_000.0, "seed {seed}: {worst} ns");
            let (_, ppm) = clocks[0].compared(20_000_000_000).unwrap();
            assert!((ppm - 43.0).abs() < 2.0, "seed {seed}: {ppm} ppm");
        }
    }

    #[test]
    fn nothing_is_claimed_before_the_fourth_window_and_after_a_jump() {
        let mut clock = BoardClock::new(60_000_000);
        for n in 0..i64::from(WINDOW) * ENOUGH as i64 {
            assert!(clock.board_at(0).is_none());
            clock.exchanged(n * 1_000_000, Clocks(n as u64 * 60_000));
        }
        assert_eq!(clock.board_at(100_000_000), Some(Clocks(6_000_000)));
        clock.forget();
        assert!(clock.board_at(0).is_none());
    }

    #[test]
    fn a_board_clock_too_far_off_for_a_crystal_is_not_used() {
        let mut clock = BoardClock::new(60_000_000);
        for n in 0..10_000 {
            // A millisecond there for two here.
            clock.exchanged(n * 2_000_000, Clocks(n as u64 * 60_000));
        }
        assert!(clock.board_at(20_000_000_000).is_none());
    }

    #[test]
    fn the_moment_of_a_period_is_the_same_for_all_drivers_in_any_order() {
        let (moment, mut a, mut b) = (Moment::default(), 0, 0);
        for period in 1..=10 {
            let (one, other) = if period % 2 == 0 {
                (&mut a, &mut b)
            } else {
                (&mut b, &mut a)
            };
            let first = moment.of(one, period * 1000);
            let second = moment.of(other, period * 1000 + 77);
            assert_eq!((first, second), (period * 1000, period * 1000), "{period}");
        }
    }
}
