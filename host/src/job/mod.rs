//! Jobs on the PC: drawings and programs become job files, are looked at and checked. No board is needed.
//!
//! [`program`] reads and writes them, [`svg`] makes one of a drawing, [`machine`] knows what will execute it, [`trace`] executes it with
//! the planner and the integer model the board has, [`preview`] draws what came out; [`pins`] holds what a
//! board did against it; [`client`] speaks to boards, [`stream`] executes jobs for one that has no room for them; [`fonts`] finds letters for both. Docs: `docs/jobs.md`.

pub mod client;
pub mod fonts;
pub mod machine;
pub mod pins;
pub mod preview;
pub mod program;
pub mod stream;
pub mod svg;
pub mod trace;
