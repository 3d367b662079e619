//! The chip at its four wires, in SPI mode 0, for gateware.
//!
//! ```text
//! cs_n  ‾\________________________________________/‾
//! sck   ____/‾\_/‾\_/‾\_/‾\_/‾\_/‾\_/‾\_/‾\_________     takes MOSI where SCK rises
//! mosi  xx< 7 >< 6 >< 5 >< 4 >< 3 >< 2 >< 1 >< 0 >xx
//! miso  zz< 7 >< 6 >< 5 >< 4 >< 3 >< 2 >< 1 >< 0 >zz     gives MISO where SCK falls
//! ```

use super::Misuse;
use super::spi::Shared;

/// Levels at the wires, and the bits on their way.
#[derive(Clone, Debug)]
pub struct Wires {
    chip: Shared,
    selected: bool,
    sck: bool,
    /// Bits taken since /CS fell, of the byte under way.
    taken: u8,
    count: u8,
}

impl Wires {
    /// Solders the chip on.
    pub fn new(chip: Shared) -> Self {
        Wires {
            chip,
            selected: false,
            sck: false,
            taken: 0,
            count: 0,
        }
    }

    /// The chip.
    pub fn chip(&self) -> &Shared {
        &self.chip
    }

    /// The wires have these levels now, `at` nanoseconds; the level at MISO.
    pub fn set(&mut self, at: u64, cs_n: bool, sck: bool, mosi: bool) -> bool {
        let mut chip = self.chip.chip();
        chip.it_is(at);
        let edge = sck != self.sck;
        if cs_n == self.selected {
            if edge {
                chip.note(Misuse::StrayClock);
            }
            self.selected = !cs_n;
            if self.selected {
                (self.taken, self.count) = (0, 0);
                chip.select();
            } else {
                if self.count == 8 {
                    // A clock that falls with /CS or after it: the bits were there.
                    chip.take(self.taken);
                    self.count = 0;
                }
                chip.deselect(self.count);
            }
        } else if edge && !self.selected {
            chip.note(Misuse::StrayClock);
        } else if edge && sck {
            self.taken = self.taken << 1 | u8::from(mosi);
            self.count += 1;
        } else if edge && self.count == 8 {
            // The level at MISO is held until the clock falls: only now the next byte begins.
            chip.take(self.taken);
            self.count = 0;
        }
        self.sck = sck;
        // A falling clock has put the next bit out; a rising one leaves the one the master is
        // taking.
        let bit = if sck {
            self.count.saturating_sub(1)
        } else {
            self.count
        };
        let out = chip.output().filter(|_| self.selected);
        out.is_none_or(|byte| byte >> (7 - bit.min(7)) & 1 != 0)
    }
}
