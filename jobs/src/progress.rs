//! Maps segments to instructions and path times: two rings, each longer than what planner and FIFO
//! hold.

/// More than the planner looks ahead.
const INSTRUCTIONS: usize = 128;
/// More than the FIFO holds.
const SEGMENTS: usize = 128;

/// An instruction's place in its program.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Mark {
    /// Its line.
    pub line: u32,
    /// Nominal time at its beginning, in microseconds.
    pub micros: u64,
}

/// Both rings.
#[derive(Debug)]
pub struct Progress {
    instructions: [Mark; INSTRUCTIONS],
    count: u32,
    segments: [(u32, u64); SEGMENTS],
    pushed: u32,
    clocks: u64,
}

impl Progress {
    /// Empty.
    pub const fn new() -> Self {
        Progress {
            instructions: [Mark { line: 0, micros: 0 }; INSTRUCTIONS],
            count: 0,
            segments: [(0, 0); SEGMENTS],
            pushed: 0,
            clocks: 0,
        }
    }

    /// Empties both rings.
    pub fn clear(&mut self) {
        (self.count, self.pushed, self.clocks) = (0, 0, 0);
    }

    /// Gives this instruction the next number.
    pub fn instruction(&mut self, mark: Mark) -> u32 {
        let number = self.count;
        if let Some(place) = self.instructions.get_mut(number as usize % INSTRUCTIONS) {
            *place = mark;
        }
        self.count = number.wrapping_add(1);
        number
    }

    /// A segment of this instruction was pushed.
    pub fn segment(&mut self, instruction: u32, clocks: u32) {
        self.clocks += u64::from(clocks);
        if let Some(place) = self.segments.get_mut(self.pushed as usize % SEGMENTS) {
            *place = (instruction, self.clocks);
        }
        self.pushed = self.pushed.wrapping_add(1);
    }

    /// Number of segments pushed.
    pub fn pushed(&self) -> u32 {
        self.pushed
    }

    /// The instruction that is being drawn and the clocks that have passed, after `begun` segments
    /// have begun and with `left` clocks of the last one left.
    pub fn at(&self, begun: u32, left: u32) -> (Mark, u64) {
        let Some(last) = begun.checked_sub(1) else {
            return (Mark::default(), 0);
        };
        let (instruction, end) = self.segments[last as usize % SEGMENTS];
        let mark = self.instructions[instruction as usize % INSTRUCTIONS];
        (mark, end.saturating_sub(left.into()))
    }
}
