//! The simulated board, twice: the Verilated SoC with the release firmware inside it and a virtual
//! Ethernet around it; and its twin, the firmware's library on the cores' models, which needs no
//! FPGA tool and is faster than real time.
//!
//! The Verilated board has no stub inside the PHY's byte interface: frames enter as GMII bytes with
//! preamble and FCS, the firmware is the ELF that goes into the bitstream, and the STEP/DIR pins
//! are counted clock by clock. Ordinary programs reach both through real UDP and TCP sockets on
//! loopback, without root; tests reach the Verilated board also in process ([`Rig`]).
//!
//! ```text
//!   LinuxCNC, litex_server, nc                    tests
//!        | UDP / TCP on 127.0.0.1                   |
//!   [server]  time modes, sockets, report         [rig]  in-process API
//!        |--------------------+---------------------+
//!     [twin]               [lan_segment]  virtual Ethernet: hosts, ARP, ICMP, TCP, NAT of ports
//!        | firmware lib         | Ethernet frames
//!     [model]                [board]  two clocks, GMII bytes, timestamps
//!        |                      |
//!        |                   [soc]  libferrocnc_soc.so: Verilator's model of gateware + firmware ROM
//!        +----------+-----------+
//!                 pins
//!          [environment]  [edges] judge them, [plant] is wired to them
//! ```
//!
//! Time is simulated time, counted in clocks of the board's own `sys` clock. It advances only on
//! request, so the same calls give the same edges on every machine.
//!
//! Everything but [`soc`] is plain Rust over the [`soc::Silicon`] trait and is tested without any
//! FPGA tool.

pub mod board;
pub mod board_facts;
pub mod edges;
pub mod environment;
pub mod error;
pub mod exchange;
pub mod faults;
pub mod figures;
pub mod firmware;
pub mod gmii;
pub mod jobs;
pub mod lan_segment;
pub mod lease;
pub mod loader;
pub mod model;
pub mod model_board;
pub mod nor;
pub mod pads;
pub mod plant;
pub mod plug;
pub mod report;
pub mod rig;
pub mod server;
pub mod services;
pub mod soc;
pub mod stimulus;
pub mod tap;
pub mod twin;

pub use board::Board;
pub use error::Error;
pub use rig::Rig;
pub use soc::{Pins, Soc};
pub use twin::Twin;
