//! The release image on the Verilated board: boot, exchange and its two ways, malformed frames,
//! faults at the pins.
//!
//! All input goes through Ethernet frames; all checks are at the pins.

mod datagrams;
mod exchange;
mod faults;
mod lengths;
mod passes;
mod ways;
