//! `wallclock.*`: the board's own 64-bit clock, compared with this computer's.
//!
//! `ticks-msb`, `ticks-lsb` (u32 out): clocks since power-up at the last sample.
//! `interval` (float out): seconds from the sample before to the last one, by the board's clock.
//! `offset-ns` (float out): how far the board's clock is ahead of this computer's monotonic clock,
//! ns. `drift-ppm` (float out): how much faster it runs.

use crate::hal::{ExportError, Exporter, Out};
use wire::units::Clocks;

/// The clock's pins.
#[derive(Debug)]
pub struct Wallclock {
    msb: Out<u32>,
    lsb: Out<u32>,
    interval: Out<f64>,
    offset: Out<f64>,
    drift: Out<f64>,
    last: Option<Clocks>,
}

impl Wallclock {
    /// Exports the pins.
    pub fn export(hal: &mut Exporter<'_>) -> Result<Self, ExportError> {
        let mut hal = hal.under("wallclock");
        Ok(Wallclock {
            msb: hal.output("ticks-msb")?,
            lsb: hal.output("ticks-lsb")?,
            interval: hal.output("interval")?,
            offset: hal.output("offset-ns")?,
            drift: hal.output("drift-ppm")?,
            last: None,
        })
    }

    /// Takes the time of a sample. `false`: it went backwards, so the fabric was reset since.
    #[must_use]
    pub fn sampled(&mut self, sample: Clocks, clock_hz: f64) -> bool {
        let last = self.last.replace(sample);
        self.msb.set((sample.0 >> 32) as u32);
        self.lsb.set(sample.0 as u32);
        match last.map(|last| sample.0.checked_sub(last.0)) {
            None => true,
            Some(None) => false,
            Some(Some(clocks)) => {
                self.interval.set(Clocks(clocks).to_seconds(clock_hz));
                true
            }
        }
    }

    /// Takes what has been learnt about the two clocks.
    pub fn compared(&self, offset_ns: f64, drift_ppm: f64) {
        self.offset.set(offset_ns);
        self.drift.set(drift_ppm);
    }
}
