//! Integer motion maths: one truth for everyone who has to know what a stepgen will do.
//!
//! The gateware executes it, the driver predicts feedback with it, simulations and tests compare
//! against it. Nothing here knows registers, sockets or floating point, and nothing here waits: the
//! step timing that can make a real stepgen late by a few clocks is the gateware's business.
#![no_std]
#![forbid(unsafe_code)]

pub mod ramp;

pub use ramp::Ramp;
