//! Jobs from the drawing to the pins. The drawing of `tests/drawing` is prepared, planned and
//! played, and the pen's path is rebuilt from the edges at the pins.
//!
//! Pictures are left in `FERROCNC_REPORTS`, else in `target/reports`.

mod clients;
mod drawings;
mod guide;
mod pen;
mod rig;
mod streamed;
mod strikes;
mod tool;
mod words;
