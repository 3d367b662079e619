//! The instructions of a job: modal states resolved, units metric, every position absolute.
//!
//! The G-code reader, the reader of XYPenPlotter's binary files and the job file all use them; the
//! planner executes them. A length is in nanometres, so that inches, millimetres and their sums are
//! exact.

use motion::segment::AXES;

/// A position in nanometres from home.
pub type Place = [i64; AXES];

/// No position of a job is further than 10 m from home.
pub const FARTHEST: i64 = 10_000_000_000;

/// The centre of an arc may be further away, because a nearly straight arc has a distant one.
/// Beyond this limit it is a line.
pub const CENTER_FARTHEST: i64 = 4 * FARTHEST;

/// The longest dwell, in microseconds: a week, as for a line. So sums of them do not overflow.
pub const DWELL_LONGEST: u64 = 7 * 24 * 3600 * 1_000_000;

/// The speed along the path.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Feed {
    /// As fast as the axes can.
    Rapid,
    /// In nm/s: 16 667 is 1 mm/min, and the limit 257 m/min. Never 0.
    Rate(u32),
}

/// An instruction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Instruction {
    /// A straight line.
    Line {
        /// Its end.
        to: Place,
        /// The speed.
        feed: Feed,
    },
    /// A part of a circle, a full circle, or a helix.
    Arc(Arc),
    /// All axes rest for this many microseconds.
    Dwell {
        /// The duration, at most [`DWELL_LONGEST`].
        micros: u64,
    },
    /// Sets the outputs.
    Aux {
        /// One bit for each output.
        bits: u16,
    },
    /// Homes these axes; their positions are 0 then.
    Home {
        /// X, Y, Z.
        axes: [bool; AXES],
    },
    /// Wait for the operator.
    Pause,
    /// The end of the job.
    End,
}

/// An arc in the XY plane. If it ends at its beginning, it is a full circle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Arc {
    /// Its end; if its Z differs from that of the beginning, the arc is a helix.
    pub to: Place,
    /// Centre, X and Y.
    pub center: [i64; 2],
    /// G2, seen from above.
    pub clockwise: bool,
    /// The speed.
    pub feed: Feed,
}

/// The output M3 switches on and M5 off.
pub const AUX_TOOL: u16 = 1;
