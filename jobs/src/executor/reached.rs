//! How far the job has come: maps segments to instructions and path times. Two rings, each longer
//! than what planner and FIFO hold.

use crate::check::nominal;
use crate::instruction::{Instruction, Place};
use motion::segment::AXES;
use wire::jobs::MachineConfig;

/// More than the planner looks ahead.
const INSTRUCTIONS: usize = 128;
/// More than the FIFO holds.
const SEGMENTS: usize = 128;

/// An instruction's place in its program.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Progress {
    /// Its line.
    line: u32,
    /// Nominal time at its beginning, in microseconds.
    micros: u64,
}

/// What is being drawn.
#[derive(Clone, Copy, Debug, Default)]
pub struct SoFar {
    /// Segments begun.
    pub segments: u32,
    /// The instruction's line.
    pub line: u32,
    /// Nominal time of what is done, in microseconds.
    pub done: u64,
    /// Clocks that have passed on the path.
    pub clocks: u64,
}

/// What was given to planner and core.
#[derive(Debug)]
pub struct Reached {
    instructions: [Progress; INSTRUCTIONS],
    count: u32,
    segments: [(u32, u64); SEGMENTS],
    pushed: u32,
    clocks: u64,
    /// Segments begun before this job.
    base: u32,
    /// Where the next instruction begins, and the nominal time up to there.
    from: Place,
    micros: u64,
    /// The nominal time of the whole job.
    total: u64,
}

impl Reached {
    /// Nothing.
    pub const fn new() -> Self {
        Reached {
            instructions: [Progress { line: 0, micros: 0 }; INSTRUCTIONS],
            count: 0,
            segments: [(0, 0); SEGMENTS],
            pushed: 0,
            clocks: 0,
            base: 0,
            from: [0; AXES],
            micros: 0,
            total: 0,
        }
    }

    /// Empties both rings for the next job.
    pub fn clear(&mut self) {
        (self.count, self.pushed, self.clocks) = (0, 0, 0);
        (self.from, self.micros, self.total) = ([0; AXES], 0, 0);
    }

    /// The job takes so long, nominally.
    pub fn takes(&mut self, micros: u64) {
        self.total = micros;
    }

    /// The core has begun so many segments before the first of this job.
    pub fn begins(&mut self, begun: u32) {
        self.base = begun;
    }

    /// Gives the instruction of this line the next number.
    pub fn instruction(&mut self, line: u32) -> u32 {
        let number = self.count;
        if let Some(place) = self.instructions.get_mut(number as usize % INSTRUCTIONS) {
            let micros = self.micros;
            *place = Progress { line, micros };
        }
        self.count = number.wrapping_add(1);
        number
    }

    /// The planner has taken this instruction: the next one begins after it.
    pub fn planned(&mut self, instruction: &Instruction, machine: &MachineConfig) {
        let micros = nominal(&self.from, instruction, machine);
        self.micros = self.micros.saturating_add(micros);
        match *instruction {
            Instruction::Line { to, .. } => self.from = to,
            Instruction::Arc(arc) => self.from = arc.to,
            Instruction::Home { axes } => {
                for (place, homed) in self.from.iter_mut().zip(axes) {
                    *place = if homed { 0 } else { *place };
                }
            }
            Instruction::Dwell { .. }
            | Instruction::Aux { .. }
            | Instruction::Pause
            | Instruction::End => {}
        }
    }

    /// A segment of this instruction was pushed.
    pub fn segment(&mut self, instruction: u32, clocks: u32) {
        self.clocks += u64::from(clocks);
        if let Some(place) = self.segments.get_mut(self.pushed as usize % SEGMENTS) {
            *place = (instruction, self.clocks);
        }
        self.pushed = self.pushed.wrapping_add(1);
    }

    /// What is being drawn when the core has begun so many segments, and has so many clocks of the
    /// last one left.
    pub fn so_far(&self, (begun, left): (u32, u32)) -> SoFar {
        if self.pushed == 0 {
            return SoFar::default();
        }
        let segments = begun.wrapping_sub(self.base);
        let Some(last) = segments.min(self.pushed).checked_sub(1) else {
            return SoFar::default();
        };
        let (instruction, end) = self.segments[last as usize % SEGMENTS];
        let mark = self.instructions[instruction as usize % INSTRUCTIONS];
        SoFar {
            segments,
            line: mark.line,
            done: mark.micros.min(self.total),
            clocks: end.saturating_sub(left.into()),
        }
    }

    /// The part of the job that is done, in percent; 100 is not reached before its end.
    pub fn percent(&self, so_far: &SoFar) -> u8 {
        // At a feed of 1 nm/s sums can get very large.
        let percent = u128::from(so_far.done) * 100 / u128::from(self.total.max(1));
        percent.min(99) as u8
    }

    /// Milliseconds that the rest of the job takes, when the part that is done took `elapsed` at
    /// this feed in percent.
    pub fn remaining(&self, so_far: &SoFar, elapsed: u32, feed: u16) -> u32 {
        let done = so_far.done;
        let rest = self.total.saturating_sub(done) / 1000 * 100 / u64::from(feed.max(1));
        // If the job has taken longer than planned, the rest will, too.
        let ratio = u64::from(elapsed) * u64::from(feed) * 10 / (done / 1000).max(1);
        let ratio = if done < 1_000_000 {
            1000
        } else {
            ratio.max(1000)
        };
        u32::try_from(rest.saturating_mul(ratio) / 1000).unwrap_or(u32::MAX)
    }
}
