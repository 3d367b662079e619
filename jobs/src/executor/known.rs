//! The positions of the axes, and whether they are known: a switch makes a position known, a cut
//! pulse makes it unknown.

use motion::segment::AXES;
use wire::exchange::StateWord;
use wire::jobs::MachineConfig;
use wire::units::Position;

/// What is known of the axes' positions.
#[derive(Debug)]
pub struct Known {
    /// Integrators, when they were last read.
    positions: [i64; AXES],
    /// Where they are at 0.
    offset: [i64; AXES],
    /// Axes that have no switch: they are where they are said to be.
    switchless: [bool; AXES],
    /// Axes that found their switch, or have none.
    pub homed: [bool; AXES],
    /// Pulses may have been cut off while the axis moved, and its switch has not been found since.
    cut: [bool; AXES],
    /// The board's last answer said that no pulses were cut off since it was armed.
    trusted: bool,
    /// How often they were, as far as is known of.
    cuts: u32,
}

impl Known {
    /// Of a board that has seen so many cuts. `restarted`: its counts have started again, wherever
    /// the axes stand.
    pub fn new(restarted: bool, cuts: u32) -> Self {
        Known {
            positions: [Position::ZERO.0; AXES],
            offset: [0; AXES],
            switchless: [false; AXES],
            homed: [false; AXES],
            cut: [restarted; AXES],
            trusted: false,
            cuts,
        }
    }

    /// Another machine: no switch of it was found yet.
    pub fn machine(&mut self, machine: &MachineConfig) {
        self.switchless = machine.axes.map(|axis| axis.home.is_none());
        self.homed = self.switchless;
    }

    /// The integrators were read.
    pub fn at(&mut self, positions: [i64; AXES]) {
        self.positions = positions;
    }

    /// This axis is at 0 where its integrator is at `position`.
    pub fn zero(&mut self, axis: usize, position: i64) {
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

    /// Positions as planner and words use them: 0 is home.
    pub fn places(&self) -> [i64; AXES] {
        let mut places = self.positions;
        for (place, offset) in places.iter_mut().zip(self.offset) {
            *place = place.wrapping_sub(offset);
        }
        places
    }

    /// Takes the board's word on whether pulses may have been cut off since it was armed. From a
    /// restart to the first arming that is in doubt, and the board's counts have started again.
    pub fn seen(&mut self, state: StateWord) {
        let trusted = core::mem::replace(&mut self.trusted, state.position_trusted);
        if trusted && !state.position_trusted {
            self.forget();
        }
    }

    /// Takes the board's count of cuts. It may have armed again after a stop that was cut off, and
    /// then the state says nothing of that.
    pub fn counted(&mut self, cuts: Option<u32>) {
        if let Some(cuts) = cuts
            && core::mem::replace(&mut self.cuts, cuts) != cuts
        {
            self.forget();
        }
    }

    /// Marks all positions as unknown.
    pub fn forget(&mut self) {
        self.cut = [true; AXES];
        for (homed, switchless) in self.homed.iter_mut().zip(self.switchless) {
            *homed &= switchless;
        }
    }

    /// All axes were homed.
    pub fn all_homed(&self) -> bool {
        self.homed == [true; AXES]
    }

    /// All positions are right.
    pub fn complete(&self) -> bool {
        self.all_homed() && self.cut == [false; AXES]
    }
}
