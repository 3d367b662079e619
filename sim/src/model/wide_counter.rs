//! The visible behaviour of `wide_counter.sv`: a value captured in a clock can be read after the
//! next visit of the channel.
//!
//! The wide totals and the five-bit deltas are one number here, which the channel keeps itself: at
//! the pins and registers they cannot be told apart, and the lock-step test says so.

/// Clocks in a rotation.
pub const ROTATION: u64 = 16;

/// What one channel has caught and shows.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct WideCounter {
    /// Caught by the strobe, waits for its turn; then for one clock more.
    caught: Option<u32>,
    writing: Option<u32>,
    sampled: u32,
    held: Option<u32>,
    writing_latch: Option<u32>,
    latched: u32,
}

impl WideCounter {
    /// The sample, as read.
    pub fn sampled(&self) -> u32 {
        self.sampled
    }

    /// The latch, as read.
    pub fn latched(&self) -> u32 {
        self.latched
    }

    /// A capture waits for its turn.
    pub fn pending(&self) -> bool {
        self.held.is_some()
    }

    /// One rising edge: is it our turn, is `word` sampled or captured.
    pub fn clock(&mut self, turn: bool, sample: bool, capture: bool, word: u32) {
        self.sampled = self.writing.take().unwrap_or(self.sampled);
        self.latched = self.writing_latch.take().unwrap_or(self.latched);
        if turn {
            self.writing = self.caught.take();
            self.writing_latch = self.held.take();
        }
        if sample {
            self.caught = Some(word);
        }
        if capture {
            self.held = Some(word);
        }
    }

    /// Nothing is on its way.
    pub fn quiet(&self) -> bool {
        self.caught.is_none()
            && self.writing.is_none()
            && self.held.is_none()
            && self.writing_latch.is_none()
    }
}
