//! A machine as one commented file: axes, drives, switches, spindle, e-stop, user interface.
//!
//! From it come the board file, the HAL file and the INI file. What the user wrote into them stays:
//! the generated HAL file is the only one that is written anew, and it says so. This crate reads
//! and writes no file: [`plan`](plan::plan) says what is to be written.

pub mod board;
pub mod channels;
pub mod check;
pub mod drive;
pub mod hal;
pub mod ini;
mod keys;
pub mod model;
pub mod plan;
pub mod plant;
pub mod read;
pub mod template;
pub mod twin;
pub mod units;
pub mod wiring;

pub use check::{Findings, check};
pub use model::CncMachine;
pub use read::read;
