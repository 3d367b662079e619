//! Integer motion maths: one definition of a stepgen's behaviour for all code that has to know it.
//!
//! The gateware executes ramps and segments; the driver predicts feedback with them, the jobs'
//! planner makes segments, simulations and tests compare against both.
//! This crate knows no registers, no sockets and no floating point, and it never waits. Step
//! timing, which can delay a real stepgen by a few clocks, belongs to the gateware.
#![no_std]
#![forbid(unsafe_code)]

pub mod ramp;
pub mod segment;
pub mod wide;

pub use ramp::Ramp;
