//! `led.sv`: the blinking of the status LED.

/// The LED's counter.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Led {
    bits: u32,
    count: u64,
    lit: bool,
}

impl Led {
    /// A cycle of 2^`bits` clocks.
    pub fn new(bits: u32) -> Self {
        Led {
            bits,
            count: 0,
            lit: false,
        }
    }

    /// At the pin.
    pub fn lit(&self) -> bool {
        self.lit
    }

    fn slot(&self) -> u64 {
        self.count >> (self.bits - 5)
    }

    fn next(&self, pattern: u32) -> bool {
        let slot = self.slot();
        let bit = |n: u32| slot >> n & 1 != 0;
        match pattern & 7 {
            0 => false,
            1 => true,
            2 => bit(4),
            3 => bit(2),
            4 => !bit(4) && !bit(2),
            5 => slot < 24 && !bit(2),
            6 => slot >> 1 == 0 || slot >> 1 == 2,
            _ => !bit(0),
        }
    }

    /// One rising edge.
    pub fn clock(&mut self, pattern: u32) {
        self.lit = self.next(pattern);
        self.count = (self.count + 1) & ((1 << self.bits) - 1);
    }

    /// Clocks in which the pin stays as it is.
    pub fn quiet(&self, pattern: u32) -> u64 {
        if self.next(pattern) != self.lit {
            return 0;
        }
        let slot = 1u64 << (self.bits - 5);
        slot - self.count % slot
    }

    /// That many quiet clocks at once.
    pub fn skip(&mut self, clocks: u64) {
        self.count = self.count.wrapping_add(clocks) & ((1 << self.bits) - 1);
    }
}
