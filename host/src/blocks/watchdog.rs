//! `watchdog.*`: how close it comes to biting, and that it has.
//!
//! | name | | |
//! |---|---|---|
//! | `watchdog.has-bitten` | bit out | latched on the board; only a new start clears it |
//! | `watchdog.timeout-ns` | u32 param | without an accepted command for this long it bites; taken over while disarmed |
//! | `watchdog.grace-ns` | u32 param | a soft stop may take this long before the outputs fall regardless |
//! | `watchdog.margin-ns` | u32 out | what was left when the last command arrived |
//! | `watchdog.margin-ns-min` | u32 out | the least of it since the machine was armed |

use crate::hal::{ExportError, Exporter, Out, Param};
use wire::units::Clocks;

/// 5 ms: five missed 1 kHz periods; hostmot2's default.
const DEFAULT_TIMEOUT_NS: u32 = 5_000_000;
/// 500 ms: an axis at 0.5 m/s and 1 m/s^2 has stopped.
const DEFAULT_GRACE_NS: u32 = 500_000_000;

/// 0.2 ms: boards refuse less than 0.1 ms, which only ever bites by accident.
const LEAST_TIMEOUT_NS: u32 = 200_000;

/// The watchdog's pins.
#[derive(Debug)]
pub struct Watchdog {
    has_bitten: Out<bool>,
    margin: Out<u32>,
    margin_min: Out<u32>,
    timeout: Param<u32>,
    grace: Param<u32>,
}

impl Watchdog {
    /// Exports the pins.
    pub fn export(hal: &mut Exporter<'_>) -> Result<Self, ExportError> {
        let mut hal = hal.under("watchdog");
        Ok(Watchdog {
            has_bitten: hal.output("has-bitten")?,
            margin: hal.output("margin-ns")?,
            margin_min: hal.output("margin-ns-min")?,
            timeout: hal.param("timeout-ns", DEFAULT_TIMEOUT_NS)?,
            grace: hal.param("grace-ns", DEFAULT_GRACE_NS)?,
        })
    }

    /// Timeout and grace in clocks.
    pub fn configure(&self, clock_hz: f64) -> [u32; 2] {
        let clocks = |nanos: u32| {
            let clocks = Clocks::from_nanos_ceil(u64::from(nanos), clock_hz as u32).0;
            u32::try_from(clocks).unwrap_or(u32::MAX)
        };
        [
            clocks(self.timeout.get().max(LEAST_TIMEOUT_NS)),
            clocks(self.grace.get()),
        ]
    }

    /// Timeout in ns.
    pub fn timeout_ns(&self) -> i64 {
        i64::from(self.timeout.get().max(LEAST_TIMEOUT_NS))
    }

    /// Takes what the board says. The margin means something only while it is awake.
    pub fn sampled(&self, bitten: bool, left: u32, awake: bool, clock_hz: f64) {
        self.has_bitten.set(bitten);
        if awake {
            let nanos = (f64::from(left) / clock_hz * 1e9) as u32;
            self.margin.set(nanos);
            self.margin_min.set(nanos.min(self.margin_min.get()));
        }
    }

    /// The machine was armed: the minimum starts anew.
    pub fn armed(&self) {
        self.margin_min.set(u32::MAX);
    }
}
