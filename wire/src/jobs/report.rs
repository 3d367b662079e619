//! The report: one block with the complete state of a job.
//!
//! ```text
//! state:u8 progress:u8 end:u8 flags:u8  homed:u8 axis:u8 percent:u16  line:u32  elapsed:u32 remaining:u32
//! board:u32  steps:i32 x 3  outputs:u16 refused:u16  segments:u32  name (the rest)
//! ```

use super::{AXES, Reader, Writer};
use crate::codes::codes;
use crate::name::Name;

codes! {
    /// XYPenPlotter's states, and two that it does not have.
    State: u8 {
        /// No work.
        Stopped = 0, "stopped";
        /// A job, or words of FPGA G's protocol.
        Running = 1, "running";
        /// A job is checked before it moves anything.
        Checking = 2, "checking";
        /// Coming to rest, and ending.
        Stopping = 3, "stopping";
        /// Standing still on the path, or braking for that (then `stands` is false).
        Paused = 10, "paused";
        /// Homing.
        Calibrating = 11, "calibrating";
    }
}

codes! {
    /// The reason of the last end.
    End: u8 {
        /// No work has ended since power-up.
        None = 0, "none";
        /// The job is done.
        Done = 1, "done";
        /// Stop was commanded.
        Stopped = 2, "stopped";
        /// The client that started it became silent.
        HostLost = 3, "host lost";
        /// No segment came in time.
        Underrun = 4, "underrun";
        /// The watchdog bit.
        Watchdog = 5, "watchdog";
        /// An e-stop input.
        EStop = 6, "e-stop";
        /// The external reset pin.
        ExternalReset = 7, "external reset";
        /// The board ended the session, for another reason.
        SessionLost = 8, "session lost";
        /// The job in the store has changed.
        Broken = 9, "the job in the store is broken";
        /// An axis did not find its switch within its way or its time.
        NoSwitch = 10, "switch not found";
        /// An axis' switch did not open.
        StuckSwitch = 11, "switch does not open";
        /// A position of an instruction is out of bounds.
        Limits = 12, "beyond the limits";
        /// The board did not arm.
        NotArmed = 13, "not armed";
        /// The board restarted.
        Restart = 14, "the board restarted";
        /// The job moves an axis that has a switch and was not homed.
        NotHomed = 15, "find the switches first: ferrocnc job home";
    }
}

const STANDS: u8 = 1;
const MACHINE: u8 = 2;
const ATTENDED: u8 = 4;
const KNOWN: u8 = 8;

/// The report.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Report {
    /// The current state.
    pub state: State,
    /// 0 to 100, by path time.
    pub progress: u8,
    /// The reason of the last end.
    pub end: End,
    /// All axes stand.
    pub stands: bool,
    /// A machine was set.
    pub machine: bool,
    /// A client has to keep asking.
    pub attended: bool,
    /// The position is right: nothing that could lose a step has happened since it was set to 0.
    pub known: bool,
    /// One bit per axis that found its switch, or that has no switch and started at 0.
    pub homed: u8,
    /// The axis of a failed homing or limit; 0xff: none.
    pub axis: u8,
    /// The feed override.
    pub percent: u16,
    /// The line of the job's source that is being drawn.
    pub line: u32,
    /// Path time since it began, in ms.
    pub elapsed: u32,
    /// Path time that is left, in ms.
    pub remaining: u32,
    /// The board's state word ([`crate::exchange::StateWord`]).
    pub board: u32,
    /// Whole steps from home.
    pub steps: [i32; AXES],
    /// The job's outputs.
    pub outputs: u16,
    /// Requests refused since the program started.
    pub refused: u16,
    /// Segments begun.
    pub segments: u32,
    /// The current job, or the last one.
    pub name: Name,
}

impl Report {
    /// From a payload.
    pub fn parse(payload: &[u8]) -> Option<Self> {
        let mut reader = Reader::new(payload);
        let (state, progress) = (State::from_code(reader.u8()?)?, reader.u8()?);
        let (end, flags) = (End::from_code(reader.u8()?)?, reader.u8()?);
        (progress <= 100 && flags < 16).then_some(())?;
        let report = Report {
            state,
            progress,
            end,
            stands: flags & STANDS != 0,
            machine: flags & MACHINE != 0,
            attended: flags & ATTENDED != 0,
            known: flags & KNOWN != 0,
            homed: reader.u8()?,
            axis: reader.u8()?,
            percent: reader.u16()?,
            line: reader.u32()?,
            elapsed: reader.u32()?,
            remaining: reader.u32()?,
            board: reader.u32()?,
            steps: [reader.i32()?, reader.i32()?, reader.i32()?],
            outputs: reader.u16()?,
            refused: reader.u16()?,
            segments: reader.u32()?,
            name: reader.name()?,
        };
        reader.end(report)
    }

    /// As a payload.
    pub fn emit(&self, payload: &mut Writer) {
        let flag = |set: bool, bit: u8| if set { bit } else { 0 };
        payload.u8(self.state.code()).u8(self.progress);
        payload.u8(self.end.code()).u8(flag(self.stands, STANDS)
            | flag(self.machine, MACHINE)
            | flag(self.attended, ATTENDED)
            | flag(self.known, KNOWN));
        payload.u8(self.homed).u8(self.axis).u16(self.percent);
        payload.u32(self.line).u32(self.elapsed).u32(self.remaining);
        payload.u32(self.board);
        for steps in self.steps {
            payload.i32(steps);
        }
        payload.u16(self.outputs).u16(self.refused);
        payload.u32(self.segments).name(&self.name);
    }
}
