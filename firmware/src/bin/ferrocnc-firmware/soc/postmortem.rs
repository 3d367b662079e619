//! The end of a crashed firmware: close the gate, record the reason, restart.
//!
//! The gate is closed first, with one store, before anything that could fail a second time.

use super::logger;
use core::arch::asm;
use core::mem::MaybeUninit;
use core::panic::{Location, PanicInfo};
use core::ptr::null;
use firmware::cores::Control;
use firmware::postmortem::{Boot, Record};
use litex_pac::Watchdog;
use riscv::register::{mcause, mepc, mtval};
use wire::ResetReason;

#[unsafe(link_section = ".uninit.record")]
static mut RECORD: MaybeUninit<Record> = MaybeUninit::uninit();

fn record() -> &'static mut Record {
    // SAFETY: any bit pattern is a `Record`; its checksum says whether it is valid. One hart, and
    // no caller keeps the reference.
    unsafe { (*(&raw mut RECORD)).assume_init_mut() }
}

/// Counts this start.
pub fn boot(seed: u32) -> Boot {
    record().boot(seed)
}

/// Derives another number for this start.
pub fn rename(seed: u32) -> u32 {
    record().rename(seed)
}

/// A word of the panic window.
pub fn word(offset: u32) -> u32 {
    record().word(offset)
}

/// The cause of the last trap, and where it came from.
pub fn last_trap() -> (u32, u32) {
    (mcause::read().code() as u32, mepc::read() as u32)
}

/// Restarts on request.
pub fn restart() -> ! {
    record().part(ResetReason::Requested);
    again()
}

/// Starts the firmware again. The gateware keeps its positions and its clock.
fn again() -> ! {
    close_gate();
    // SAFETY: the reset vector; everything is initialised again from there. Interrupts are
    // enabled in a call of the services only.
    unsafe { asm!("fence.i", "jr zero", options(noreturn)) }
}

fn close_gate() {
    // SAFETY: one store to a register that can only close the gate with this key.
    let watchdog = unsafe { Watchdog::steal() };
    watchdog
        .control()
        .write(|w| unsafe { w.bits(Control::Close.key()) });
}

/// The location of a panic, for the trap handler.
static mut PANIC_AT: *const Location<'static> = null();

/// A panic traps, so that there is one writer of crash reports. This function is small enough to be
/// inlined where a panic begins. So the optimiser sees that the message is not read, and all of
/// `core::fmt` stays out of the image, 3 KiB (see `build.sh`); file and line identify the panic.
#[panic_handler]
fn panic(info: &PanicInfo<'_>) -> ! {
    // SAFETY: one hart; only the trap handler reads it, and this never returns. `ebreak` traps.
    unsafe {
        PANIC_AT = info.location().map_or(null(), |at| (&raw const *at).cast());
        asm!("ebreak", options(noreturn, nostack))
    }
}

#[unsafe(export_name = "ExceptionHandler")]
fn exception(_frame: &riscv_rt::TrapFrame) -> ! {
    die()
}

#[unsafe(export_name = "DefaultHandler")]
fn interrupt() -> ! {
    die()
}

fn die() -> ! {
    close_gate();
    // SAFETY: written by `panic` only, and locations are statics.
    let panic = unsafe { PANIC_AT.as_ref() };
    let why = match panic {
        Some(_) => ResetReason::Panic,
        None => ResetReason::Trap,
    };
    record().die(why, |out| {
        if let Some(at) = panic {
            out.text("panic at ")
                .text(at.file())
                .text(":")
                .number(at.line());
            return;
        }
        let cause = mcause::read();
        // The leash's interrupt does not come here; if another one does, report it.
        out.either(cause.is_interrupt(), "interrupt ", "trap: cause ");
        out.number(cause.code() as u32);
        out.text(" at 0x").hex(mepc::read() as u32);
        out.text(", address 0x").hex(mtval::read() as u32);
    });
    if !logger::busy() {
        defmt::error!("died: {=[u8]:a}", record().text());
    }
    again()
}
