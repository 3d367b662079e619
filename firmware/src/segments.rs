//! The words of the segments core's page (docs/cores/segments.md), for the jobs, which play
//! segments, and for the server and the path stop, which look at the core.

/// Register, by its word: a write pushes the segment in the words before it.
pub const PUSH: usize = 16;
/// Register: start, quit or clear.
pub const CONTROL: usize = 17;
/// Register: how much of a clock the path's time passes in one, 65536ths.
pub const PACE: usize = 18;
/// Register: how much the pace changes in a clock.
pub const SLEW: usize = 19;
/// Register: the outputs that are low unless the axes are on their way.
pub const BEAM: usize = 20;
/// Register: the outputs that belong to the job.
pub const MASK: usize = 21;
/// Register: [`crate::jobs::core::State`].
pub const STATUS: usize = 22;
/// Register: segments begun since power-up.
pub const BEGUN: usize = 23;
/// Register: clocks left of the current segment, less 1.
pub const LEFT: usize = 24;
/// Register: the outputs' state.
pub const CURRENT: usize = 25;
/// Register: number of axes, and number of segments that fit.
pub const SHAPE: usize = 27;
