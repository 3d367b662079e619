//! The image on the softcore: start-up and the frame loop. All decisions are in the library.
//!
//! ```text
//!   forever
//!     a command was executed by the gateware?  what is left to do, and the next pass
//!     a frame?   plain UDP      Etherbone server
//!                discovery      found, gets settings
//!                anything else  ARP, ping, TCP, UDP ports of the services in SDRAM; without them
//!                               ARP and ping from here
//!     none, and housekeeping is overdue: do it
//! ```
//!
//! Housekeeping (looks at the gate, LED, services) runs right after the answer to an exchange, when
//! the next one is a whole servo period away. Behind other requests of a host it waits for a pause:
//! the next one may be the first exchange. While a host exchanges without a pass, it never runs
//! between a request and its answer.
#![no_std]
#![no_main]
#![expect(
    clippy::deref_addrof,
    reason = "its remedy, a reference to a `static mut`, is an error of the compiler's"
)]

mod app;
mod soc;

use core::arch::global_asm;
use riscv_rt::entry;

global_asm!(include_str!("../saves.s"));

#[entry]
fn main() -> ! {
    let parts = soc::start();
    app::App::new(parts).run()
}
