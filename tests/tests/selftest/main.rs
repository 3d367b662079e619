//! The self-test of a new board, on the twin: it finds no defect on a good board, and names each
//! defect correctly. The parts in gateware (pads, the Ethernet clock) are also tested on the
//! Verilated board with the release image.
//!
//! The test reaches the board through a real socket, and its time passes only with its datagrams.
//! The host's clock is the board's times a rate the test chooses, so nothing here depends on this
//! computer's clock or on how busy it is.

mod defects;
mod manners;
mod pads;
mod rig;
mod verilated;
