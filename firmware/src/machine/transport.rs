//! The calls of a transport to the [`Machine`], so that a transport does not use the server
//! directly. All of them are inlined, because each is a line or two.

use super::Machine;
use crate::block::Shape;
use crate::cores::Board;
use crate::session::Session;
use wire::Refusal;
use wire::describe::JobsState;

impl<B: Board> Machine<B> {
    /// Counts a frame that came.
    #[inline(always)]
    pub fn received(&mut self) {
        let counters = self.server.counters_mut();
        counters.frames_rx = counters.frames_rx.wrapping_add(1);
    }

    /// Counts frames that were sent.
    #[inline(always)]
    pub fn sent(&mut self, frames: u32) {
        let counters = self.server.counters_mut();
        counters.frames_tx = counters.frames_tx.wrapping_add(frames);
    }

    /// Counts a refusal.
    #[inline(always)]
    pub fn refuse(&mut self, why: Refusal) {
        self.server.refuse(why);
    }

    /// The session.
    #[inline(always)]
    pub fn session(&self) -> &Session {
        self.server.session()
    }

    /// The lengths of this board's blocks.
    #[inline(always)]
    pub fn shape(&self) -> &Shape {
        self.server.shape()
    }

    /// Nothing moves, and nothing is armed to move.
    #[inline(always)]
    pub fn at_rest(&self) -> bool {
        self.server.safety().at_rest()
    }

    /// The number of this start.
    #[inline(always)]
    pub fn boot_id(&self) -> u32 {
        self.server.boot().id
    }

    /// Is [`Machine::hold_path`] due?
    #[inline(always)]
    pub fn owes_path(&self) -> bool {
        self.server.owes_path()
    }

    /// A client with the right to do so has requested a restart.
    #[inline(always)]
    pub fn wants_restart(&self) -> bool {
        self.server.wants_restart()
    }

    /// Has the gateware a core that plays segments?
    #[inline(always)]
    pub fn plays_segments(&self) -> bool {
        self.server.ident().plays_segments()
    }

    /// Records in the description what became of the services.
    #[inline(always)]
    pub fn jobs(&mut self, state: JobsState) {
        self.server.jobs(state);
    }

    /// Counts a call of the services that took so many clocks; did a host move the machine then?
    #[inline(always)]
    pub fn called(&mut self, clocks: u32, moving: bool) {
        let [while_moving, other] = &mut self.server.counters_mut().calls;
        let longest = if moving { while_moving } else { other };
        *longest = clocks.max(*longest);
    }

    /// Where the image that runs lies in the flash: its first byte and its length.
    #[inline(always)]
    pub fn image(&mut self) -> Option<(u32, u32)> {
        self.server.flash().image(self.board.spi())
    }

    /// May the services be loaded now? That reads the flash, and each piece takes as long as a
    /// guest's frame.
    #[inline(always)]
    pub fn may_load(&self) -> bool {
        self.session().owner().is_none() && !self.server.flash().busy()
    }
}
