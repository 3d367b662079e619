//! `extreset.sv`: the external reset pin, two flip-flops later.

/// The synchroniser; the pin is active high here, for either polarity of the board.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Extreset {
    meta: bool,
    sync: bool,
}

impl Default for Extreset {
    /// Active until the pin has been seen.
    fn default() -> Self {
        Extreset {
            meta: true,
            sync: true,
        }
    }
}

impl Extreset {
    /// The pin is a reset.
    pub fn active(&self) -> bool {
        self.sync
    }

    /// One rising edge.
    pub fn clock(&mut self, pin: bool) {
        self.sync = self.meta;
        self.meta = pin;
    }

    /// Clocks that change nothing at this level of the pin.
    pub fn quiet(&self, pin: bool) -> u64 {
        if self.sync == pin && self.meta == pin {
            u64::MAX
        } else {
            0
        }
    }
}
