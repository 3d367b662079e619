//! Moves data from the program to the core: the next instruction, the planner, and the output that
//! waits.
//!
//! ```text
//!   program --instruction--> planner --segment--> until the FIFO has room
//!                                    \-waiting--> until all axes stand: pause, homing, the end
//! ```

use super::reached::Reached;
use super::{LOOK_AHEAD, setup};
use crate::homing::rest;
use crate::inside::Velocities;
use crate::instruction::{Feed, Instruction};
use crate::plan::{Output, Planner, Work};
use crate::program::{Broken, Program};
use crate::store::Store;
use motion::segment::{AXES, MIN_CLOCKS, Segment};
use wire::jobs::MachineConfig;

/// Chords planned in a call. The first chords of an arc fill the look-ahead; all of them in one
/// call take 11 ms, in which no client is served.
const CHORDS: usize = 4;

/// What was planned, and what is to be planned.
#[derive(Debug)]
pub struct Path {
    planner: Option<Planner<LOOK_AHEAD>>,
    pub program: Program,
    /// Read, and not planned yet, with its line.
    instruction: Option<(Instruction, u32)>,
    pub segment: Option<Segment>,
    pub waiting: Option<Output>,
    /// The feed.
    pub percent: u16,
}

impl Path {
    /// No machine, no program.
    pub fn new() -> Self {
        Path {
            planner: None,
            program: Program::nothing(),
            instruction: None,
            segment: None,
            waiting: None,
            percent: 100,
        }
    }

    /// This planner from now on: another machine's.
    pub fn set_planner(&mut self, planner: Planner<LOOK_AHEAD>) {
        self.planner = Some(planner);
    }

    /// Sets the feed in percent.
    pub fn feed(&mut self, percent: u16) {
        self.percent = percent;
        if let Some(planner) = &mut self.planner {
            planner.set_override(percent.into());
        }
    }

    /// Nothing is planned any more. What comes next is of a new program.
    pub fn clear(&mut self, machine: &MachineConfig, clock_hz: u32) {
        (self.instruction, self.segment, self.waiting) = (None, None, None);
        if let Ok(planner) = setup::planner(machine, clock_hz) {
            self.planner = Some(planner);
            self.feed(self.percent);
        }
    }

    /// Accelerations of the axes at most.
    pub fn limits(&self) -> [u32; AXES] {
        self.planner.as_ref().map_or([0; AXES], Planner::limits)
    }

    /// Velocities of axes that rest, or come to rest.
    pub fn rest(&self) -> Velocities {
        rest(&self.limits())
    }

    /// The planner starts from these places.
    pub fn settle(&mut self, places: [i64; AXES]) {
        if let Some(planner) = &mut self.planner {
            let _at_rest = planner.begin_at(places);
        }
    }

    /// The planner's number of the instruction that is being drawn.
    pub fn number(&self) -> u32 {
        self.planner.as_ref().map_or(0, Planner::tag)
    }

    /// One step: an instruction into the planner, or an output out of it.
    pub fn plan(
        &mut self,
        store: &Store,
        machine: &MachineConfig,
        reached: &mut Reached,
    ) -> Result<(), Broken> {
        let planner = self.planner.as_mut().ok_or(Broken)?;
        if planner.accepts() {
            if self.instruction.is_none() {
                self.instruction = self.program.next(store)?;
            }
            let Some((instruction, line)) = self.instruction else {
                return Ok(());
            };
            if !planner.push(&instruction, reached.instruction(line)) {
                return Err(Broken);
            }
            reached.planned(&instruction, machine);
            self.instruction = None;
            return Ok(());
        }
        match planner.work(CHORDS) {
            Work::Output(Output::Segment(segment)) => self.segment = Some(segment),
            Work::Output(output) => self.waiting = Some(output),
            Work::More | Work::Starved => {}
        }
        Ok(())
    }

    /// The tool is lifted, and gets the time it needs.
    pub fn lift(&mut self, machine: &MachineConfig, clock_hz: u32) {
        let clocks = u64::from(machine.tool_delay) * u64::from(clock_hz) / 1_000_000;
        self.segment = Some(Segment {
            clocks: clocks.clamp(MIN_CLOCKS.into(), u32::MAX.into()) as u32,
            ..Segment::default()
        });
    }

    /// Behind a homing, with the axes at these places: those that found their switch go to 0, and
    /// the tool is as it was.
    pub fn homed(&mut self, places: [i64; AXES], found: &[Option<i64>; AXES]) {
        self.settle(places);
        let Some(planner) = &self.planner else {
            return;
        };
        let mut to = planner.target();
        for (to, found) in to.iter_mut().zip(found) {
            *to = if found.is_some() { 0 } else { *to };
        }
        let tool = planner.machine().aux;
        let feed = Feed::Rapid;
        self.program.insert(Instruction::Line { to, feed });
        if tool != 0 {
            self.program.insert(Instruction::Aux { bits: tool });
        }
    }
}
