//! `debounce.sv`: takes the levels of a group of lines together, once all of them have been stable
//! long enough.

/// A group of lines, one bit each.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Debounce {
    was: u8,
    still: u8,
    level: u8,
    known: bool,
}

impl Debounce {
    /// The debounced levels.
    pub fn level(&self) -> u8 {
        self.level
    }

    /// Since power-up, the level is what the lines were.
    pub fn known(&self) -> bool {
        self.known
    }

    /// One rising edge.
    pub fn clock(&mut self, lines: u8, filter: u8) {
        let moved = lines != self.was;
        let long_enough = self.still == filter;
        if moved {
            self.still = 0;
        } else if long_enough {
            self.level = self.was;
            self.known = true;
        } else {
            self.still = self.still.wrapping_add(1);
        }
        self.was = lines;
    }

    fn left(&self, filter: u8) -> u64 {
        filter.wrapping_sub(self.still).into()
    }

    /// Clocks in which the debounced levels do not change.
    pub fn quiet(&self, lines: u8, filter: u8) -> u64 {
        if lines != self.was {
            0
        } else if self.level == self.was && self.known {
            u64::MAX
        } else {
            self.left(filter)
        }
    }

    /// That many quiet clocks at once.
    pub fn skip(&mut self, clocks: u64, filter: u8) {
        let counted = self.left(filter).min(clocks);
        self.still = self.still.wrapping_add(counted as u8);
    }
}
