//! The executor's view of the board: its session and its segments core with their last answers, and
//! whether the next exchange is due.

use super::setup::slew;
use crate::Outside;
use crate::inside::{Inside, Velocities};
use crate::segments::Core;
use motion::segment::AXES;
use wire::describe::{Channels, Describe};
use wire::exchange::Status;
use wire::jobs::MachineConfig;

/// The board.
#[derive(Debug)]
pub struct Board {
    pub inside: Inside,
    pub core: Core,
    pub clock_hz: u32,
    pub channels: Channels,
    /// Its last state word.
    pub word: u32,
    /// All axes stood at the last exchange.
    pub at_rest: bool,
    /// It answered when it was asked last, or is ours.
    pub heard: bool,
    exchanged: u64,
    /// Segments begun and clocks left at that time.
    progress: (u32, u32),
}

impl Board {
    /// Nothing was exchanged yet.
    pub fn new(inside: Inside, board: &Describe, core: Core) -> Self {
        Board {
            inside,
            core,
            clock_hz: board.clock_hz,
            channels: board.channels,
            word: 0,
            at_rest: true,
            heard: false,
            exchanged: 0,
            progress: (0, 0),
        }
    }

    /// Is it time for an exchange? Only once for each.
    pub fn due(&mut self, now: u64, per_second: u64) -> bool {
        let due = now.wrapping_sub(self.exchanged) >= u64::from(self.clock_hz) / per_second;
        if due {
            self.exchanged = now;
        }
        due
    }

    /// Is the watchdog to be fed? Yes if work has progressed, or if no motion is due.
    pub fn goes_on(&mut self, paused: bool, out: &mut impl Outside) -> bool {
        let state = self.core.state(out);
        let now = self.core.progress(out);
        let before = core::mem::replace(&mut self.progress, now);
        before != now || state.idle() || paused && state.stands()
    }

    /// Configures board and core for this machine. False: the board must not be armed.
    #[must_use]
    pub fn configure(
        &self,
        machine: &MachineConfig,
        limits: &[u32; AXES],
        paused: bool,
        out: &mut impl Outside,
    ) -> bool {
        let configured = self.inside.configure(machine, limits, out);
        if configured {
            let slew = slew(machine, self.clock_hz);
            self.core.set(slew, machine.beam, machine.outputs, out);
            self.core.clear(out);
            self.core.pass(!paused, out);
        }
        configured
    }

    /// Exchanges, with the gate as its phase says. `None`: the session is not ours any more.
    pub fn exchange(
        &mut self,
        (enable, request): (bool, bool),
        velocities: &Velocities,
        out: &mut impl Outside,
    ) -> Option<Status> {
        let status = self.inside.exchange(enable, request, velocities, out)?;
        self.word = status.state.to_word();
        let mut axes = status.stepgen.iter().take(AXES);
        self.at_rest = axes.all(|(_, velocity)| velocity.0 == 0);
        Some(status)
    }
}
