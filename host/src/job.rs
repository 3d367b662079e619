//! Jobs on the PC: makes job files of drawings and programs, draws and checks them. No board is
//! needed.
//!
//! [`program`] reads and writes them, [`svg`] makes one of a drawing, [`machine`] describes the
//! machine, [`trace`] executes a job with the planner and the integer model of the board,
//! [`steady`] without acceleration, [`preview`] draws the result; [`client`] talks to boards,
//! [`stream`] executes jobs for a board without SDRAM; [`words`] reads FPGA G's words; [`pen`]
//! makes a pen of Z; [`fonts`] finds the fonts. Docs: `docs/jobs.md`.

pub mod client;
#[cfg(feature = "drawing")]
pub mod fonts;
pub mod machine;
#[cfg(feature = "drawing")]
mod order;
pub mod pen;
#[cfg(feature = "drawing")]
pub mod preview;
pub mod program;
pub mod steady;
pub mod stream;
#[cfg(feature = "drawing")]
pub mod svg;
pub mod trace;
pub mod words;
