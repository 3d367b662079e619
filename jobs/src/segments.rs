//! The segments core's registers, as operations. docs/cores/segments.md describes them.

use crate::Outside;
use motion::segment::{AXES, PACE_ONE, Segment};
use wire::regmap::segments::{
    BEAM, BEGUN, CONTROL, CONTROL_COMMAND_CLEAR, CONTROL_COMMAND_QUIT, CONTROL_COMMAND_START,
    CURRENT, LEFT, MASK, PACE, PUSH, SHAPE, SLEW, STATUS, STATUS_LEVEL, STATUS_REASON,
    STATUS_REASON_SHIFT, STATUS_STANDS, STATUS_STATE, STATUS_STATE_IDLE,
};

/// The core's status word.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct State(u32);

/// The reasons of an end.
pub mod reason {
    use wire::regmap::segments;

    /// No segment left, at rest.
    pub const DONE: u8 = segments::STATUS_REASON_DONE as u8;
    /// No segment in time, while moving.
    pub const UNDERRUN: u8 = segments::STATUS_REASON_UNDERRUN as u8;
    /// Commanded.
    pub const QUIT: u8 = segments::STATUS_REASON_QUIT as u8;
    /// The watchdog's soft stop.
    pub const HALTED: u8 = segments::STATUS_REASON_HALTED as u8;
    /// The gate closed.
    pub const CLOSED: u8 = segments::STATUS_REASON_CLOSED as u8;
}

impl State {
    /// Segments waiting.
    pub fn level(self) -> u8 {
        (self.0 & STATUS_LEVEL) as u8
    }

    /// No segment is being played.
    pub fn idle(self) -> bool {
        self.0 & STATUS_STATE == STATUS_STATE_IDLE
    }

    /// The reason of the last end.
    pub fn reason(self) -> u8 {
        ((self.0 & STATUS_REASON) >> STATUS_REASON_SHIFT) as u8
    }

    /// It ended early: it takes no segment before it is cleared.
    pub fn failed(self) -> bool {
        self.reason() > reason::DONE
    }

    /// Path time is stopped.
    pub fn stands(self) -> bool {
        self.0 & STATUS_STANDS != 0
    }
}

/// The core.
#[derive(Clone, Copy, Debug)]
pub struct Core {
    room: u8,
}

impl Core {
    /// `None`: there is no such core, or it has another number of axes.
    pub fn new(out: &mut impl Outside) -> Option<Self> {
        let shape = out.read_segments(SHAPE);
        let [axes, room, ..] = shape.to_le_bytes();
        // A restart in the middle of a job leaves it set.
        out.write_segments(MASK, 0);
        (usize::from(axes) == AXES && room > 0).then_some(Core { room })
    }

    /// The core's status.
    pub fn state(self, out: &mut impl Outside) -> State {
        State(out.read_segments(STATUS))
    }

    /// Does another segment fit?
    pub fn has_room(self, state: State) -> bool {
        state.level() < self.room
    }

    /// Pushes a whole segment. There must be room.
    pub fn push(self, segment: &Segment, out: &mut impl Outside) {
        for (at, word) in segment.words().iter().enumerate() {
            out.write_segments(at, *word);
        }
        out.write_segments(PUSH, 0);
    }

    /// Plays the pushed segments.
    pub fn start(self, out: &mut impl Outside) {
        out.write_segments(CONTROL, CONTROL_COMMAND_START);
    }

    /// Brings all axes to rest, and discards the pushed segments.
    pub fn quit(self, out: &mut impl Outside) {
        out.write_segments(CONTROL, CONTROL_COMMAND_QUIT);
    }

    /// Clears the reason of the last end.
    pub fn clear(self, out: &mut impl Outside) {
        out.write_segments(CONTROL, CONTROL_COMMAND_CLEAR);
    }

    /// Lets path time pass, or stops it.
    pub fn pass(self, passes: bool, out: &mut impl Outside) {
        out.write_segments(PACE, if passes { PACE_ONE } else { 0 });
    }

    /// Sets the rate at which the pace changes, and the outputs that belong to the job.
    pub fn set(self, slew: u32, beam: u16, mask: u32, out: &mut impl Outside) {
        out.write_segments(SLEW, slew);
        out.write_segments(BEAM, beam.into());
        out.write_segments(MASK, mask);
    }

    /// Segments begun, and clocks left of the current one.
    pub fn progress(self, out: &mut impl Outside) -> (u32, u32) {
        // Reads the count once more: a segment that begins in between has another number of clocks
        // left.
        let mut begun = out.read_segments(BEGUN);
        loop {
            let left = out.read_segments(LEFT).wrapping_add(1);
            match out.read_segments(BEGUN) {
                same if same == begun => return (begun, left),
                other => begun = other,
            }
        }
    }

    /// The outputs' state.
    pub fn outputs(self, out: &mut impl Outside) -> u16 {
        out.read_segments(CURRENT) as u16
    }
}
