//! Dying well: close the gate, write down why, start again.
//!
//! The gate goes first, by one store, before anything that could fail a second time.

use super::logger;
use core::arch::asm;
use core::mem::MaybeUninit;
use core::panic::PanicInfo;
use firmware::postmortem::{Boot, Record};
use firmware::text::Out;
use litex_pac::{Ident, Timebase, Watchdog, abi};
use riscv::register::{mcause, mepc, mtval};
use wire::ResetReason;

#[unsafe(link_section = ".uninit.record")]
static mut RECORD: MaybeUninit<Record> = MaybeUninit::uninit();

fn record() -> &'static mut Record {
    // SAFETY: any bit pattern is a `Record`; its checksum says whether it is one. One hart, and no caller
    // keeps the reference.
    unsafe { (*(&raw mut RECORD)).assume_init_mut() }
}

/// Counts this start.
pub fn boot(seed: u32) -> Boot {
    record().boot(seed)
}

/// A word of the panic window.
pub fn word(offset: u32) -> u32 {
    record().word(offset)
}

/// Microseconds since power-up, for log stamps.
pub fn microseconds() -> u64 {
    // SAFETY: reads, and a snapshot that everybody who wants the time takes anew.
    let (timebase, ident) = unsafe { (Timebase::steal(), Ident::steal()) };
    timebase.snapshot().write(|w| unsafe { w.bits(1) });
    let now = u64::from(timebase.now_hi().read().bits()) << 32
        | u64::from(timebase.now_lo().read().bits());
    now / u64::from((ident.sys_clk_hz().read().bits() / 1_000_000).max(1))
}

/// Somebody asked for it.
pub fn restart() -> ! {
    record().part(ResetReason::Requested);
    again()
}

/// Starts the firmware again. The gateware keeps its positions and its clock.
fn again() -> ! {
    close_gate();
    // SAFETY: the reset vector; everything is initialised anew from there. Interrupts were never enabled.
    unsafe { asm!("fence.i", "jr zero", options(noreturn)) }
}

fn close_gate() {
    // SAFETY: one store to a register that only ever closes the gate with this key.
    let watchdog = unsafe { Watchdog::steal() };
    watchdog
        .control()
        .write(|w| unsafe { w.bits(abi::KEY_STOP) });
}

fn die(why: ResetReason, cause: impl FnOnce(&mut Out)) -> ! {
    close_gate();
    record().die(why, cause);
    if !logger::busy() {
        defmt::error!("died: {=[u8]:a}", record().text());
    }
    again()
}

#[panic_handler]
fn panic(info: &PanicInfo<'_>) -> ! {
    die(ResetReason::Panic, |out| {
        // The message would bring all of `core::fmt` into the image, 5 KiB; file and line say which panic
        // it was.
        out.text("panic");
        if let Some(at) = info.location() {
            out.text(" at ").text(at.file()).text(":").number(at.line());
        }
    })
}

#[unsafe(export_name = "ExceptionHandler")]
fn exception(_frame: &riscv_rt::TrapFrame) -> ! {
    die(ResetReason::Trap, |out| {
        out.text("trap: cause ")
            .number(mcause::read().code() as u32);
        out.text(" at 0x").hex(mepc::read() as u32);
        out.text(", address 0x").hex(mtval::read() as u32);
    })
}

#[unsafe(export_name = "DefaultHandler")]
fn interrupt() -> ! {
    die(ResetReason::Trap, |out| {
        out.text("an interrupt, and nobody enabled one");
    })
}
