//! Integer motion maths: one definition of a stepgen's behaviour for all code that has to know it.
//!
//! The gateware executes ramps and segments; the driver predicts feedback with them, simulations
//! and tests compare against them. G-code and arcs become segments here, on a PC and on the board.
//! This crate knows no registers, no sockets and no floating point, and it never waits. Step
//! timing, which can delay a real stepgen by a few clocks, belongs to the gateware.
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
