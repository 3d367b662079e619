//! The end of a job and its reason: the first reason counts, unless the board reports a more exact
//! one.

use wire::FaultReason;
use wire::jobs::End;

/// The end of the last work, or of the current one.
#[derive(Debug)]
pub struct Outcome {
    /// How the current work will end.
    pub ending: End,
    /// How the last work ended.
    pub end: End,
    /// The axis of it; 0xff: none.
    pub axis: u8,
    /// The line of it.
    pub line: Option<u32>,
    /// The board ended the job.
    pub torn: bool,
}

impl Outcome {
    /// Of what was before the board's start.
    pub fn new(end: End) -> Self {
        Outcome {
            ending: End::None,
            end,
            axis: 0xff,
            line: None,
            torn: false,
        }
    }

    /// Work begins.
    pub fn begin(&mut self) {
        (self.ending, self.end) = (End::Done, End::None);
        (self.axis, self.line) = (0xff, None);
    }

    /// Work has ended.
    pub fn over(&mut self, why: End) {
        (self.ending, self.end) = (why, why);
    }

    /// Takes the board's reason, if that says more.
    pub fn explain(&mut self, reason: FaultReason) {
        self.ending = match reason {
            FaultReason::EStop => End::EStop,
            FaultReason::ExternalReset => End::ExternalReset,
            FaultReason::Watchdog => End::Watchdog,
            FaultReason::None
            | FaultReason::HostDisable
            | FaultReason::SessionLost
            | FaultReason::LinkDown
            | FaultReason::FirmwareFault
            | FaultReason::JobUnderrun
            | FaultReason::AbiMismatch => self.ending,
        };
    }
}
