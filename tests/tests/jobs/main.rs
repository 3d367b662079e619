//! Jobs from the drawing to the pins. The drawing of `tests/drawing` is prepared, planned and
//! played, and the pen's path is rebuilt from the edges at the pins.
//!
//! `cargo xtask test jobs` builds what this needs. `FERROCNC_JOBS_CORES` is the folder of the
//! Verilated cores of `tests/boards/jobs.toml`; pictures are left in `FERROCNC_REPORTS`, else in
//! `target/reports`.

mod clients;
mod cores;
mod drawings;
mod guide;
mod rig;
mod streamed;
mod strikes;
mod tool;
