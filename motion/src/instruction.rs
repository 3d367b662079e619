//! What a job is made of: modal states resolved, units metric, every place absolute.
//!
//! The G-code reader, the reader of XYPenPlotter's binary files and the job file all speak these; the planner
//! executes them. A length is in nanometres, so that inches, millimetres and sums of either are exact.

use crate::segment::AXES;

/// A place in nanometres from home.
pub type Place = [i64; AXES];

/// No place of a job is further than 10 m from home.
pub const FARTHEST: i64 = 10_000_000_000;

/// The centre of an arc may be further: a line that is hardly bent. Beyond that it is a line.
pub const CENTER_FARTHEST: i64 = 4 * FARTHEST;

/// How fast along the path.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Feed {
    /// As fast as the axes can.
    Rapid,
    /// In nm/s: 16 667 is 1 mm/min, and the limit 257 m/min. Never 0.
    Rate(u32),
}

/// One thing to do.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Instruction {
    /// A straight line.
    Line {
        /// Its end.
        to: Place,
        /// The speed.
        feed: Feed,
    },
    /// A part of a circle, a whole one, or a helix.
    Arc(Arc),
    /// Nothing moves for this many microseconds.
    Dwell {
        /// How long.
        micros: u64,
    },
    /// The outputs are from now on these.
    Aux {
        /// One bit for each.
        bits: u16,
    },
    /// Find the switches of these axes; their places are 0 then.
    Home {
        /// X, Y, Z.
        axes: [bool; AXES],
    },
    /// Wait for the operator.
    Pause,
    /// The job is over.
    End,
}

/// An arc in the XY plane. One that ends where it begins is a full circle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Arc {
    /// Its end; when its Z is not that of the beginning it is a helix.
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
