//! Drivers with embedded-hal's faces, for whatever is a driver in its sense.

use super::Soc;
use core::convert::Infallible;
use embedded_hal::delay::DelayNs;
use embedded_hal::digital::{ErrorType, OutputPin, StatefulOutputPin};
use firmware::cores::{Board as _, Led};

/// The status LED: a pin when one wants a pin, patterns otherwise.
pub struct StatusLed<'r>(&'r litex_pac::Led);

impl<'r> StatusLed<'r> {
    /// The one on the board.
    pub fn new(regs: &'r litex_pac::Led) -> Self {
        StatusLed(regs)
    }

    /// Shows a pattern.
    pub fn show(&mut self, pattern: Led) {
        // SAFETY: every pattern is a value of the field.
        self.0
            .pattern()
            .write(|w| unsafe { w.bits(pattern as u32) });
    }
}

impl ErrorType for StatusLed<'_> {
    type Error = Infallible;
}

impl OutputPin for StatusLed<'_> {
    fn set_low(&mut self) -> Result<(), Infallible> {
        self.show(Led::Off);
        Ok(())
    }

    fn set_high(&mut self) -> Result<(), Infallible> {
        self.show(Led::On);
        Ok(())
    }
}

impl StatefulOutputPin for StatusLed<'_> {
    fn is_set_high(&mut self) -> Result<bool, Infallible> {
        Ok(self.0.pattern().read().bits() == Led::On as u32)
    }

    fn is_set_low(&mut self) -> Result<bool, Infallible> {
        Ok(self.0.pattern().read().bits() == Led::Off as u32)
    }
}

impl DelayNs for Soc {
    /// Waits by the wall clock; at least as long as asked.
    fn delay_ns(&mut self, ns: u32) {
        let per_us = u64::from(self.ident().clock_hz / 1_000_000);
        let clocks = (u64::from(ns) * per_us).div_ceil(1000);
        let start = self.now();
        while self.now() - start < clocks {}
    }
}
