//! The segments core's registers, as verbs. docs/cores/segments.md says what they do.

use super::Outside;
use motion::segment::{AXES, Segment};

/// Register, by its word: the words before it are a segment, whole.
pub const PUSH: usize = 16;
const CONTROL: usize = 17;
const PACE: usize = 18;
const SLEW: usize = 19;
const BEAM: usize = 20;
const MASK: usize = 21;
/// Register: [`State`].
pub const STATUS: usize = 22;
/// Register: segments begun since power-up.
pub const BEGUN: usize = 23;
/// Register: clocks left of the present one, less 1.
pub const LEFT: usize = 24;
/// Register: outputs as they are.
pub const CURRENT: usize = 25;
/// Register: how many axes, and room for how many segments.
pub const SHAPE: usize = 27;

const START: u32 = 1;
const QUIT: u32 = 2;
const CLEAR: u32 = 3;
const PACE_ONE: u32 = 1 << 16;

/// What it does, in one word.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct State(u32);

/// Why it ended.
pub mod reason {
    /// No segment left, at rest.
    pub const DONE: u8 = 1;
    /// No segment in time, not at rest.
    pub const UNDERRUN: u8 = 2;
    /// Told to.
    pub const QUIT: u8 = 3;
    /// The watchdog's soft stop.
    pub const HALTED: u8 = 4;
    /// The gate closed.
    pub const CLOSED: u8 = 5;
}

impl State {
    /// Segments that wait.
    pub fn level(self) -> u8 {
        self.0 as u8
    }

    /// It plays nothing.
    pub fn idle(self) -> bool {
        self.0 >> 8 & 3 == 0
    }

    /// Why it ended.
    pub fn reason(self) -> u8 {
        (self.0 >> 12 & 7) as u8
    }

    /// It ended, and not because all was done: it takes nothing before it is cleared.
    pub fn failed(self) -> bool {
        self.reason() > reason::DONE
    }

    /// The path's time stands.
    pub fn stands(self) -> bool {
        self.0 >> 24 & 1 == 1
    }
}

/// The core.
#[derive(Clone, Copy, Debug)]
pub struct Core {
    room: u8,
}

impl Core {
    /// `None`: there is none, or it has other axes.
    pub fn new(out: &mut impl Outside) -> Option<Self> {
        let shape = out.read_segments(SHAPE);
        let [axes, room, ..] = shape.to_le_bytes();
        (usize::from(axes) == AXES && room > 0).then_some(Core { room })
    }

    /// What it does.
    pub fn state(self, out: &mut impl Outside) -> State {
        State(out.read_segments(STATUS))
    }

    /// Does another segment fit?
    pub fn has_room(self, state: State) -> bool {
        state.level() < self.room
    }

    /// A segment, whole. There must be room.
    pub fn push(self, segment: &Segment, out: &mut impl Outside) {
        for (at, word) in segment.words().iter().enumerate() {
            out.write_segments(at, *word);
        }
        out.write_segments(PUSH, 0);
    }

    /// Plays what was pushed.
    pub fn start(self, out: &mut impl Outside) {
        out.write_segments(CONTROL, START);
    }

    /// Brings everything to rest, and forgets what was pushed.
    pub fn quit(self, out: &mut impl Outside) {
        out.write_segments(CONTROL, QUIT);
    }

    /// Forgets why it ended.
    pub fn clear(self, out: &mut impl Outside) {
        out.write_segments(CONTROL, CLEAR);
    }

    /// Path time passes, or stands.
    pub fn pass(self, passes: bool, out: &mut impl Outside) {
        out.write_segments(PACE, if passes { PACE_ONE } else { 0 });
    }

    /// How fast the pace changes, and which outputs are the job's.
    pub fn set(self, slew: u32, beam: u16, mask: u32, out: &mut impl Outside) {
        out.write_segments(SLEW, slew);
        out.write_segments(BEAM, beam.into());
        out.write_segments(MASK, mask);
    }

    /// Segments begun, and clocks left of the present one.
    pub fn progress(self, out: &mut impl Outside) -> (u32, u32) {
        // The count once more: a segment that begins in between has another rest.
        let mut begun = out.read_segments(BEGUN);
        loop {
            let left = out.read_segments(LEFT).wrapping_add(1);
            match out.read_segments(BEGUN) {
                same if same == begun => return (begun, left),
                other => begun = other,
            }
        }
    }

    /// Outputs as they are.
    pub fn outputs(self, out: &mut impl Outside) -> u16 {
        out.read_segments(CURRENT) as u16
    }
}
