//! The clock of the fake board.

use super::CLOCK_HZ;
use ferrocnc::clock::Timebase;
use std::sync::Arc;

/// Where the board's time comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Time {
    /// The wall clock.
    Wall,
    /// So many clocks pass from one exchange to the next, whatever the wall says.
    Lockstep(u64),
    /// The time of the test, converted by [`Script`].
    Scripted,
}

/// A crystal of its own, and a network with delays.
#[derive(Debug)]
pub struct Script {
    pub host: Arc<Timebase>,
    /// The board's clock is ahead by so much at time 0,
    pub offset_ns: f64,
    /// and runs faster by so much.
    pub ppm: f64,
    /// Delays of datagrams, in ns: this at least, and up to twice as much.
    pub delay_ns: f64,
    pub seed: u64,
}

impl Script {
    /// The board's clock when it is so late here.
    pub fn clocks(&self, host_ns: f64) -> f64 {
        (host_ns * (1.0 + self.ppm * 1e-6) + self.offset_ns) * f64::from(CLOCK_HZ) / 1e9
    }

    /// How late it is here when the board's clock says that.
    pub fn host_ns(&self, clocks: f64) -> f64 {
        (clocks * 1e9 / f64::from(CLOCK_HZ) - self.offset_ns) / (1.0 + self.ppm * 1e-6)
    }

    pub(super) fn arrival(&mut self) -> u64 {
        self.seed ^= self.seed >> 12;
        self.seed ^= self.seed << 25;
        self.seed ^= self.seed >> 27;
        let random =
            (self.seed.wrapping_mul(0x2545_f491_4f6c_dd1d) >> 40) as f64 / f64::from(1 << 24);
        self.clocks(self.host.now() as f64 + self.delay_ns * (1.0 + random)) as u64
    }
}
