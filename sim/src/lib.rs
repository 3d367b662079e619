//! The simulated board: the Verilated SoC, the release firmware inside it, and a virtual Ethernet around it.
//!
//! Nothing below the MAC's byte interface is stubbed: frames enter as GMII bytes with preamble and FCS, the firmware is the
//! ELF that goes into the bitstream, and what leaves at the STEP/DIR pins is counted clock by clock. Above the MAC the crate
//! offers the board to ordinary programs (real UDP and TCP sockets on loopback, no root) and to tests ([`Rig`]).
//!
//! ```text
//!   LinuxCNC, litex_server, nc                    tests
//!        | UDP / TCP on 127.0.0.1                   |
//!   [server]  time modes, sockets, report         [rig]  in-process API
//!        +----------------------+-------------------+
//!                            [segment]  virtual Ethernet: hosts, ARP, ICMP, TCP, NAT of host ports
//!                               | Ethernet frames
//!   [edges] [plant] <-pins- [board]  two clocks, GMII bytes, timestamps
//!                               |
//!                            [soc]  libferrocnc_soc.so: Verilator's model of gateware + firmware ROM
//! ```
//!
//! Time is simulated time, counted in clocks of the board's own `sys` clock. It advances only when somebody calls for it,
//! so the same calls give the same edges on every machine.
//!
//! Everything but [`soc`] is plain Rust over the [`soc::Silicon`] trait and is tested without any FPGA tool.

pub mod board;
pub mod card;
pub mod edges;
pub mod error;
pub mod exchange;
pub mod firmware;
pub mod gmii;
pub mod model;
pub mod plant;
pub mod report;
pub mod rig;
pub mod segment;
pub mod server;
pub mod soc;
pub mod twin;
pub mod world;

pub use board::Board;
pub use error::Error;
pub use rig::Rig;
pub use soc::{Pins, Soc};
pub use twin::Twin;
