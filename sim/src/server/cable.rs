//! The board's cable as a TAP interface of this machine: frames both ways, one after the other.

use std::collections::VecDeque;

use super::{Device, Service};
use crate::tap::Tap;

/// More frames than this do not wait for the board; a switch has a limit, too.
const WAITING: usize = 256;

/// One end is the interface, the other a [`Device`] whose network is frames.
#[derive(Debug)]
pub struct Cable {
    tap: Tap,
    /// On their way to the board.
    waiting: VecDeque<Vec<u8>>,
    /// The next one goes at this sys clock.
    free: u64,
}

impl Cable {
    /// A cable to this interface.
    pub fn open(name: &str) -> std::io::Result<Self> {
        Ok(Cable {
            tap: Tap::open(name)?,
            waiting: VecDeque::new(),
            free: 0,
        })
    }

    /// Frames from this machine to the board.
    pub fn carry(&mut self, rig: &mut impl Device) {
        while self.waiting.len() < WAITING
            && let Some(frame) = self.tap.receive()
        {
            self.waiting.push_back(frame);
        }
        while rig.clock() >= self.free
            && let Some(frame) = self.waiting.pop_front()
        {
            rig.post(0, Service::Cable, &frame);
            self.free = rig.clock() + rig.between_frames();
        }
    }

    /// A frame from the board to this machine.
    pub fn send(&mut self, frame: &[u8]) {
        self.tap.send(frame);
    }
}
