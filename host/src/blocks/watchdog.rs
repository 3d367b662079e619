//! `watchdog.*`: timeouts, the margin before a bite, and whether it has bitten.
//!
//! | name | | |
//! |---|---|---|
//! | `watchdog.has-bitten` | bit out | latched on the board; only a new start clears it |
//! | `watchdog.timeout-ns` | u32 param | without an accepted command for this long it bites; taken over while disarmed |
//! | `watchdog.grace-ns` | u32 param | a soft stop may take this long before the outputs fall regardless |
//! | `watchdog.margin-ns` | u32 out | what was left when the last command arrived |
//! | `watchdog.margin-ns-min` | u32 out | the least of it since the machine was armed |

use crate::hal::checked::{Checked, Rule};
use crate::hal::{ExportError, Exporter, Out};
use wire::units::Clocks;

/// 5 ms: five missed 1 kHz periods; hostmot2's default.
pub(crate) const DEFAULT_TIMEOUT_NS: u32 = 5_000_000;
/// 500 ms: an axis at 0.5 m/s and 1 m/s^2 has stopped.
const DEFAULT_GRACE_NS: u32 = 500_000_000;

/// 0.2 ms: boards refuse less than 0.1 ms, because so short a timeout only bites by accident.
const LEAST_TIMEOUT_NS: u32 = 200_000;

/// The watchdog's pins.
#[derive(Debug)]
pub struct Watchdog {
    has_bitten: Out<bool>,
    margin: Out<u32>,
    margin_min: Out<u32>,
    timeout: Checked<u32>,
    grace: Checked<u32>,
}

impl Watchdog {
    /// Exports the pins.
    pub fn export(hal: &mut Exporter<'_>) -> Result<Self, ExportError> {
        let mut hal = hal.under("watchdog");
        Ok(Watchdog {
            has_bitten: hal.output("has-bitten")?,
            margin: hal.output("margin-ns")?,
            margin_min: hal.output("margin-ns-min")?,
            timeout: hal.setting("timeout-ns", DEFAULT_TIMEOUT_NS, Rule::Any)?,
            grace: hal.setting("grace-ns", DEFAULT_GRACE_NS, Rule::Any)?,
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

    /// The machine was armed: the minimum starts again.
    pub fn armed(&self) {
        self.margin_min.set(u32::MAX);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hal::fake::FakeHal;

    const CLOCK: f64 = 60e6;

    fn exported() -> (FakeHal, Watchdog) {
        let mut hal = FakeHal::new();
        let watchdog = Watchdog::export(&mut Exporter::new(&mut hal, "b")).unwrap();
        (hal, watchdog)
    }

    #[test]
    fn timeout_and_grace_reach_the_board_in_its_clocks_and_no_timeout_is_below_the_least() {
        let (hal, watchdog) = exported();
        assert_eq!(watchdog.configure(CLOCK), [300_000, 30_000_000]);
        assert_eq!(watchdog.timeout_ns(), 5_000_000);
        hal.set("b.watchdog.timeout-ns", 0u32);
        hal.set("b.watchdog.grace-ns", 1_001u32);
        assert_eq!(watchdog.configure(CLOCK), [12_000, 61], "rounded up");
        assert_eq!(watchdog.timeout_ns(), 200_000);
    }

    #[test]
    fn the_margin_is_the_last_commands_and_its_minimum_begins_anew_when_the_machine_is_armed() {
        let (hal, watchdog) = exported();
        let told = || {
            let margin = hal.get::<u32>("b.watchdog.margin-ns");
            let least = hal.get::<u32>("b.watchdog.margin-ns-min");
            (hal.get::<bool>("b.watchdog.has-bitten"), margin, least)
        };
        watchdog.armed();
        for (left, wanted) in [
            (240_000, (false, 4_000_000, 4_000_000)),
            (150_000, (false, 2_500_000, 2_500_000)),
            (180_000, (false, 3_000_000, 2_500_000)),
        ] {
            watchdog.sampled(false, left, true, CLOCK);
            assert_eq!(told(), wanted);
        }
        // Asleep it counts nothing.
        watchdog.sampled(true, 6, false, CLOCK);
        assert_eq!(told(), (true, 3_000_000, 2_500_000));
        watchdog.armed();
        watchdog.sampled(false, 200_000, true, CLOCK);
        assert_eq!(told(), (false, 3_333_333, 3_333_333));
    }
}
