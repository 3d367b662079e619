//! Integer motion maths: one truth for everyone who has to know what a stepgen will do.
//!
//! Ramps and segments are what the gateware executes; the driver predicts feedback with them, simulations and
//! tests compare against them. G-code and arcs become segments here, on a PC and on the board alike. Nothing here
//! knows registers, sockets or floating point, and nothing here waits: the
//! step timing that can make a real stepgen late by a few clocks is the gateware's business.
#![no_std]
#![forbid(unsafe_code)]

pub mod circle;
pub mod fpgag;
pub mod gcode;
pub mod instruction;
pub mod job;
pub mod plan;
pub mod ramp;
pub mod segment;
mod wide;
pub mod words;
pub mod xypen;

pub use ramp::Ramp;
