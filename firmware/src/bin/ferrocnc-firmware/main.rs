//! The image on the softcore: start-up and the frame loop. All decisions are in the library.
//!
//! ```text
//!   forever
//!     a frame?   fast path      answer it, then the housekeeping that is due
//!                plain UDP      Etherbone server
//!                discovery      found, gets settings; an address from DHCP
//!                anything else  ARP, ping, TCP: the services in SDRAM, or what there is of it here
//!     none, and housekeeping is overdue: do it
//! ```
//!
//! Housekeeping (looks at the gate, LED, TCP timers) runs right after an answer, when the next
//! request is a whole servo period away. While a host exchanges, it never runs between a request
//! and its answer.
#![no_std]
#![no_main]

mod app;
mod memory;
mod soc;

use core::arch::global_asm;
use riscv_rt::entry;

global_asm!(include_str!("../saves.s"));

#[entry]
fn main() -> ! {
    let parts = soc::start();
    app::App::new(parts).run()
}
