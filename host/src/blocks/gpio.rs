//! `gpio.<nn>`: inputs and outputs, each numbered from 00 or by the board's name for it.
//!
//! An input has `in` and `in-not` (bit out) and the parameter `debounce-ns` (u32): a change must
//! last that long to count, up to 35 ms at 60 MHz. One that the board file calls an e-stop input
//! has `estop` (bit out) besides: it has tripped; latched by the gateware until the machine is
//! armed again. An output has `out` (bit in) and the parameter `invert`, which begins as the board
//! file has it. Parameters reach the board while it is disarmed. (hostmot2 says `invert_output`;
//! that would leave a name like `spindle-reverse` no room in the 41 characters old HALs have.)
//! While the gate is closed the pin carries the board file's safe level, for any values of `out`
//! and `invert`.

use crate::hal::checked::{Checked, Rule};
use crate::hal::{ExportError, Exporter, In, Out, Param};
use wire::map::{DEBOUNCE_CLOCKS, DEBOUNCE_MAX};
use wire::units::Clocks;

/// One input.
#[derive(Debug)]
pub struct Input {
    number: u8,
    value: Out<bool>,
    inverse: Out<bool>,
    /// Its bit among the latches, and the pin.
    estop: Option<(u8, Out<bool>)>,
    debounce: Checked<u32>,
}

impl Input {
    /// Exports the pins of the input with this number. `estop` is its bit among the latches if it
    /// is an e-stop input.
    pub fn export(
        hal: &mut Exporter<'_>,
        number: u8,
        estop: Option<u8>,
    ) -> Result<Self, ExportError> {
        Ok(Input {
            number,
            value: hal.output("in")?,
            inverse: hal.output("in-not")?,
            estop: match estop {
                Some(bit) => Some((bit, hal.output("estop")?)),
                None => None,
            },
            debounce: hal.setting("debounce-ns", 0, Rule::Any)?,
        })
    }

    /// Its number: its bit among the levels.
    pub fn number(&self) -> usize {
        self.number.into()
    }

    /// Takes the levels of all inputs, and which have tripped as an e-stop.
    pub fn sampled(&self, levels: u64, tripped: u32) {
        let level = levels >> self.number & 1 != 0;
        self.value.set(level);
        self.inverse.set(!level);
        if let Some((bit, estop)) = &self.estop {
            estop.set(u64::from(tripped) >> bit & 1 != 0);
        }
    }

    /// How many looks in a row must agree.
    pub fn debounce(&self, clock_hz: f64) -> u32 {
        let nanos = u64::from(self.debounce.get());
        let clocks = Clocks::from_nanos_ceil(nanos, clock_hz as u32).0;
        let looks = clocks.div_ceil(u64::from(DEBOUNCE_CLOCKS));
        looks.min(u64::from(DEBOUNCE_MAX)) as u32
    }
}

/// One output.
#[derive(Debug)]
pub struct Output {
    number: u8,
    value: In<bool>,
    invert: Param<bool>,
    safe: bool,
}

impl Output {
    /// Exports the pins of the output with this number. `safe` and `invert` are what the board file
    /// says of it.
    pub fn export(
        hal: &mut Exporter<'_>,
        number: u8,
        safe: bool,
        invert: bool,
    ) -> Result<Self, ExportError> {
        Ok(Output {
            number,
            value: hal.input("out")?,
            invert: hal.param("invert", invert)?,
            safe,
        })
    }

    /// A level at its bit.
    pub fn at(&self, level: bool) -> u64 {
        u64::from(level) << self.number
    }

    /// The level wanted.
    pub fn command(&self) -> bool {
        self.value.get()
    }

    /// Whether the board inverts it.
    pub fn inverted(&self) -> bool {
        self.invert.get()
    }

    /// The value of the board's safe register. It is before inversion, so that the pin is at the
    /// board file's level with any polarity that HAL sets.
    pub fn safe(&self) -> bool {
        self.safe != self.inverted()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hal::fake::FakeHal;

    #[test]
    fn the_safe_level_is_the_pins_whatever_its_polarity() {
        let mut hal = FakeHal::new();
        for (safe, invert) in [(false, false), (false, true), (true, false), (true, true)] {
            let name = format!("o{}{}", u8::from(safe), u8::from(invert));
            let mut exporter = Exporter::new(&mut hal, name.as_str());
            let output = Output::export(&mut exporter, 0, safe, invert).unwrap();
            for told in [invert, !invert] {
                hal.set(&format!("{name}.invert"), told);
                // What gpio.sv does with the two registers.
                assert_eq!(output.safe() ^ output.inverted(), safe, "{name} {told}");
            }
        }
    }

    #[test]
    fn a_debounce_is_never_shorter_than_asked_and_never_beyond_its_register() {
        let mut hal = FakeHal::new();
        let input = Input::export(&mut Exporter::new(&mut hal, "i"), 0, None).unwrap();
        // One look every 533 ns at 60 MHz.
        for (nanos, looks) in [(0u32, 0), (1, 1), (533, 1), (534, 2), (1_000_000, 1875)] {
            hal.set("i.debounce-ns", nanos);
            assert_eq!(input.debounce(60e6), looks, "{nanos} ns");
        }
        hal.set("i.debounce-ns", u32::MAX);
        assert_eq!(input.debounce(60e6), 65_535);
    }

    #[test]
    fn only_an_estop_input_has_an_estop_pin() {
        let mut hal = FakeHal::new();
        let input = Input::export(&mut Exporter::new(&mut hal, "e"), 50, Some(1)).unwrap();
        input.sampled(!(1 << 50), 1 << 1);
        assert!(hal.get::<bool>("e.estop") && !hal.get::<bool>("e.in"));
        input.sampled(1 << 50, !(1 << 1));
        assert!(!hal.get::<bool>("e.estop") && hal.get::<bool>("e.in"));
        let _ = Input::export(&mut Exporter::new(&mut hal, "i"), 50, None).unwrap();
        assert!(!hal.list().any(|(name, _, _)| name == "i.estop"));
    }
}
