//! The image on the softcore: start-up, the frame loop, and nothing that decides.
//!
//! ```text
//!   forever
//!     a frame?   in the lane    answer it, then do the chores if they are due
//!                plain UDP      Etherbone server
//!                discovery      found, told who to be; an address from DHCP
//!                anything else  ARP, ping, console
//!     none, and the chores are overdue: do them
//! ```
//!
//! Chores (look at the gate, LED, TCP timers) run right behind an answer, when the next request is a
//! whole servo period away; they never stand between a request and its answer while somebody exchanges.
#![no_std]
#![no_main]

mod app;
mod soc;

use riscv_rt::entry;

#[entry]
fn main() -> ! {
    let parts = soc::start();
    app::App::new(parts).run()
}
