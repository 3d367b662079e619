//! The self-test of a new board, on the twin: a healthy board is found healthy, and each defect is
//! found as itself. What the gateware does for it (pads, the Ethernet clock) on the Verilated board
//! as well, with the release image.
//!
//! The board is behind a real socket and its time passes with its datagrams only. The host's clock
//! is the board's times a rate the test chooses, so nothing here depends on this computer's clock
//! or on how busy it is.

mod defects;
mod manners;
mod pads;
mod rig;
mod verilated;
