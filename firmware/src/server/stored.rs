//! What lies in the flash, as far as the server has to do with it: the settings, and the
//! configuration of the pins. Its channels are the board's, its levels follow the settings, and a
//! bad one prevents arming, as an operation of the flash does while it runs.

use super::Server;
use crate::block::Shape;
use crate::cores::Board;
use wire::describe::{OBSTACLE_FLASH, OBSTACLE_PINS};
use wire::images::Trailer;
use wire::pins::Verdict;

impl Server {
    /// Identifies the flash, and puts the configuration of the pins into force that it holds: from
    /// now on the board has its channels and its description. Is the factory pin active?
    #[inline(never)]
    pub(crate) fn find_pins<B: Board>(&mut self, board: &mut B, trailer: Trailer) -> bool {
        self.flash.find(board.spi(), trailer);
        let layout = self.flash.layout().copied();
        let (loaded, factory) = self.pins.start(board, &mut self.ident, layout);
        self.flash.pins = loaded;
        self.shape = Shape::new(self.ident.channels);
        self.hold();
        factory
    }

    /// The obstacles to arming that may pass or come: an operation of the flash runs; the
    /// configuration of the pins is none for this board.
    pub(super) fn held_by(&self) -> u32 {
        let flash = if self.flash.busy() { OBSTACLE_FLASH } else { 0 };
        match self.flash.pins.verdict.usable() {
            true => flash,
            false => flash | OBSTACLE_PINS,
        }
    }

    /// Prevents arming while there are such obstacles.
    pub(super) fn hold(&mut self) {
        self.safety.hold(self.held_by() != 0);
    }

    /// A setting has changed that `pins::decides`, or it may have: the levels of the pins at rest
    /// follow. Such settings change at rest only.
    #[inline(never)]
    pub(super) fn follow_settings<B: Board>(&mut self, board: &mut B) {
        let pins = &mut self.flash.pins;
        if pins.verdict == Verdict::InForce && self.safety.at_rest() && !self.pins.follow(board) {
            pins.verdict = Verdict::Refused;
            self.hold();
        }
    }

    /// Does a slice of the flash operation. True if that was its last.
    #[inline(never)]
    pub(crate) fn poll_flash<B: Board>(&mut self, board: &mut B) -> bool {
        let now = board.now();
        let done = self.flash.poll(board.spi(), now, self.ident.clock_hz);
        self.hold();
        done
    }

    /// Begins to save settings, for a sender that was not refused.
    pub(crate) fn save<B: Board>(&mut self, board: &mut B, settings: wire::settings::Settings) {
        self.flash.start_save(board.spi(), settings);
        self.hold();
    }
}
