//! defmt's sink: encoded frames go into a ring in RAM that survives a restart, and `ferrocnc log`
//! fetches them over the network. The firmware never waits for a reader.

use core::mem::MaybeUninit;
use firmware::log::{Read, Ring};

/// 2 KiB: about two hundred events, enough for a fault and the events before it.
const SIZE: usize = 2048;
/// "FLOG": tells a ring from the content after power-up.
const VALID: u32 = 0x464c_4f47;

struct Store {
    valid: u32,
    ring: Ring<SIZE>,
}

#[unsafe(link_section = ".uninit.log")]
static mut STORE: MaybeUninit<Store> = MaybeUninit::uninit();
static mut ENCODER: defmt::Encoder = defmt::Encoder::new();
static mut BUSY: bool = false;

#[defmt::global_logger]
struct Logger;

// SAFETY: one hart. The one interrupt, of the leash, logs nothing where it interrupts the ROM, and
// no other trap returns to the code it came from: no other code can interleave. A panic inside a
// log statement finds BUSY set and logs nothing.
unsafe impl defmt::Logger for Logger {
    fn acquire() {
        // SAFETY: see the impl.
        unsafe {
            BUSY = true;
            (*(&raw mut ENCODER)).start_frame(push);
        }
    }

    unsafe fn flush() {}

    unsafe fn release() {
        // SAFETY: see the impl.
        unsafe {
            (*(&raw mut ENCODER)).end_frame(push);
            BUSY = false;
        }
    }

    unsafe fn write(bytes: &[u8]) {
        // SAFETY: see the impl.
        unsafe { (*(&raw mut ENCODER)).write(bytes, push) }
    }
}

fn store() -> &'static mut Store {
    // SAFETY: any bit pattern is a `Store` (words and bytes), and it is RAM, initialised or not;
    // one hart, and no caller keeps the reference.
    unsafe {
        let store = (*(&raw mut STORE)).assume_init_mut();
        if core::ptr::read_volatile(&store.valid) != VALID {
            store.ring = Ring::new();
            store.valid = VALID;
        }
        store
    }
}

fn push(bytes: &[u8]) {
    store().ring.push(bytes);
}

/// Is a log statement running? Then a panic must not start another.
pub fn busy() -> bool {
    // SAFETY: a read of a bool; one hart.
    unsafe { BUSY }
}

/// A word of the log window.
pub fn read(what: Read) -> u32 {
    store().ring.read(what)
}

defmt::timestamp!("{=u64:us}", super::clock::microseconds());
