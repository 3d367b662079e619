//! Measures the stack: it is filled with a pattern at start, and checked later.

use core::arch::asm;
use core::ptr::{read_volatile, write_volatile};

const PAINT: u32 = 0x5afe_57ac;
/// Words at the bottom that must never be used; below them is the memory that must survive a
/// restart.
const GUARD: usize = 8;

unsafe extern "C" {
    static mut __estack: u32;
    static mut __sstack: u32;
}

fn bounds() -> (*mut u32, *mut u32) {
    // The linker's names: `__estack` is the lower end.
    (&raw mut __estack, &raw mut __sstack)
}

/// Fills everything below the current frame.
pub fn paint() {
    let (low, _) = bounds();
    let sp: usize;
    // SAFETY: reads a register.
    unsafe { asm!("mv {}, sp", out(reg) sp, options(nomem, nostack)) };
    let mut at = low;
    // 128 bytes are left free for this function's own frame.
    while (at as usize) < sp - 128 {
        // SAFETY: between the end of all variables and the stack pointer: not in use.
        unsafe {
            write_volatile(at, PAINT);
            at = at.add(1);
        }
    }
}

/// Words that are looked at in one call. A look at all of an 18 KiB RAM's stack took 16 000 clocks.
const PART: usize = 512;

/// Bytes ever used, and the stack's size; `None` if this part of it, from the bottom, never was.
pub fn used(part: u32) -> Option<(u32, u32)> {
    let (low, high) = bounds();
    let words = (high as usize - low as usize) / 4;
    let from = words.min(PART.saturating_mul(part as usize));
    let to = words.min(from + PART);
    // SAFETY: inside the stack region.
    let painted = |at: usize| unsafe { read_volatile(low.add(at)) } == PAINT;
    let first = (from..to).find(|at| !painted(*at));
    let first = first.or((to == words).then_some(words))?;
    Some((4 * (words - first) as u32, 4 * words as u32))
}

/// Panics when the stack came too close to its end: a restart is better than a corrupted record.
#[inline]
pub fn check() {
    let (low, _) = bounds();
    // SAFETY: inside the stack region.
    let touched = (0..GUARD).any(|word| unsafe { read_volatile(low.add(word)) } != PAINT);
    if touched {
        panic!("stack overflow");
    }
}
