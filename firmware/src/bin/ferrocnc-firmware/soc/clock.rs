//! The time since power-up, for code that has no [`super::Soc`].

use litex_pac::{Ident, Timebase};

/// Microseconds since power-up, for log stamps.
pub fn microseconds() -> u64 {
    // SAFETY: reads, and a snapshot that every reader of the time takes again.
    let (timebase, ident) = unsafe { (Timebase::steal(), Ident::steal()) };
    timebase.snapshot().write(|w| unsafe { w.bits(1) });
    let now = u64::from(timebase.now_hi().read().bits()) << 32
        | u64::from(timebase.now_lo().read().bits());
    firmware::log::microseconds(now, ident.sys_clk_hz().read().bits())
}
