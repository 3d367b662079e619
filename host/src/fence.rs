//! The panic fence around everything LinuxCNC calls.
//!
//! A panic that unwinds into C aborts `rtapi_app`, and nothing in LinuxCNC notices: pins keep their
//! last values and the operator sees a machine that is on. So a panic ends at the fence, the board
//! is left to its watchdog, and the fence stays shut: the broken driver is not called again.

use crate::driver::Driver;
use crate::hal::{Level, MessageLine, Messenger};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Once;

/// A driver with all panics caught.
pub struct Fenced {
    driver: Driver,
    say: Messenger,
    halted: bool,
    /// Refused calls of other threads, as far as told.
    collisions: u32,
}

impl Fenced {
    /// Puts a fence around a driver.
    pub fn new(driver: Driver, say: Messenger) -> Self {
        Fenced {
            driver,
            say,
            halted: false,
            collisions: 0,
        }
    }

    /// `ferrocnc.<n>.read`.
    pub fn read(&mut self, period_ns: i64) {
        self.guard(|driver| driver.read(period_ns));
    }

    /// `ferrocnc.<n>.read-request`.
    pub fn read_request(&mut self, period_ns: i64) {
        self.guard(|driver| driver.read_request(period_ns));
    }

    /// `ferrocnc.<n>.write`.
    pub fn write(&mut self, period_ns: i64) {
        self.guard(|driver| driver.write(period_ns));
    }

    /// So many calls of other threads were turned away until now.
    pub fn collided(&mut self, collisions: u32) {
        if core::mem::replace(&mut self.collisions, collisions) != collisions {
            self.guard(Driver::collided);
        }
    }

    /// Runs a function on the driver inside the fence.
    pub fn guard(&mut self, work: impl FnOnce(&mut Driver)) {
        if !self.halted {
            let driver = &mut self.driver;
            // The driver is never used again after a panic, so its state does not matter.
            let Err(payload) = catch_unwind(AssertUnwindSafe(|| work(driver))) else {
                return;
            };
            // Dropping it would free memory in the servo thread.
            core::mem::forget(payload);
            self.halted = true;
            let line = MessageLine::format(format_args!(
                "the driver has stopped after an internal error and the board's watchdog stops the machine; \
                 restart LinuxCNC and report the lines above"
            ));
            (self.say)(Level::Error, line.as_c_str());
        }
        // Every period: `io-error` must not be cleared by hand.
        self.driver.halt();
    }

    /// Gives the session back.
    pub fn release(&mut self) {
        if !self.halted {
            self.driver.release();
        }
    }
}

/// Replaces the default panic hook, which would allocate and unwind symbols in the servo thread (90
/// 000 allocations were counted), by one that says where. The hook is this library's own `std`'s.
pub fn install_quiet_hook(say: impl Fn(&core::ffi::CStr) + Send + Sync + 'static) {
    static ONCE: Once = Once::new();
    ONCE.call_once(|| {
        std::panic::set_hook(Box::new(move |panic| {
            let line = match panic.location() {
                Some(at) => MessageLine::format(format_args!(
                    "internal error at {}:{}",
                    at.file(),
                    at.line()
                )),
                None => MessageLine::format(format_args!("internal error at an unknown place")),
            };
            say(line.as_c_str());
        }));
    });
}
