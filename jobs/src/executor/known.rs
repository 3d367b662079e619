//! What is known of the axes' positions: a switch makes one known, a cut pulse makes it doubtful.

use super::Executor;
use crate::Outside;
use motion::segment::AXES;
use wire::FaultReason;
use wire::exchange::StateWord;
use wire::jobs::End;

impl Executor {
    /// This axis is at 0 where its integrator is at `position`.
    pub(super) fn zero(&mut self, axis: usize, position: i64) {
        if let (Some(offset), Some(homed), Some(cut)) = (
            self.offset.get_mut(axis),
            self.homed.get_mut(axis),
            self.cut.get_mut(axis),
        ) {
            // Whole steps: the offset has no fraction, the integrator keeps its own.
            *offset = position & !0xffff_ffff;
            (*homed, *cut) = (true, false);
        }
    }

    /// Another client may have driven the axes.
    pub(super) fn look_for_cuts(&mut self, out: &mut impl Outside) {
        if let Some(state) = self.inside.state(out) {
            self.seen(state);
        }
        self.count_cuts(out);
    }

    /// It may have armed again behind a stop that was cut off, and then the state says nothing of
    /// that.
    pub(super) fn count_cuts(&mut self, out: &mut impl Outside) {
        if let Some(cuts) = self.inside.cuts(out)
            && core::mem::replace(&mut self.cuts, cuts) != cuts
        {
            self.forget();
        }
    }

    /// Positions as planner and words use them: 0 is home.
    pub(super) fn places(&self) -> [i64; AXES] {
        core::array::from_fn(|axis| {
            let offset = self.offset.get(axis).copied().unwrap_or(0);
            let position = self.positions.get(axis).copied().unwrap_or(0);
            position.wrapping_sub(offset)
        })
    }

    /// The planner starts from the axes' current positions.
    pub(super) fn settle(&mut self) {
        let at = self.places();
        if let Some(planner) = &mut self.planner {
            let _at_rest = planner.begin_at(at);
        }
    }

    /// Records the reason. The gateware is faster than the firmware's state machine, so this runs
    /// once more at the end.
    pub(super) fn explain(&mut self, state: Option<StateWord>) {
        self.ending = match state.map_or(FaultReason::None, |state| state.reason) {
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
        match state {
            Some(state) => self.seen(state),
            None => self.forget(),
        }
    }

    /// Takes the board's word on whether pulses may have been cut off since it was armed. From a
    /// restart to the first arming that is in doubt, and the board's counts have started again.
    pub(super) fn seen(&mut self, state: StateWord) {
        let trusted = core::mem::replace(&mut self.trusted, state.position_trusted);
        if trusted && !state.position_trusted {
            self.forget();
        }
    }

    /// Marks all positions as unknown.
    pub(super) fn forget(&mut self) {
        self.cut = [true; AXES];
        if let Some(machine) = &self.machine {
            for (homed, axis) in self.homed.iter_mut().zip(&machine.axes) {
                *homed &= axis.home.is_none();
            }
        }
    }
}
