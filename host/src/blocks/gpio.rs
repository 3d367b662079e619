//! `gpio.<nn>`: inputs and outputs, each numbered from 00 or by the board's name for it.
//!
//! An input has `in` and `in-not` (bit out), an output has `out` (bit in) and the parameter
//! `invert`, which reaches the board while it is disarmed. (hostmot2 says `invert_output`; that would leave
//! a name like `spindle-reverse` no room in the 41 characters old HALs have.) While the gate is closed an output
//! carries the board's safe level, whatever `out` says.

use crate::hal::{ExportError, Exporter, In, Out, Param};

/// One input.
#[derive(Debug)]
pub struct Input {
    value: Out<bool>,
    inverse: Out<bool>,
}

impl Input {
    /// Exports the pins.
    pub fn export(hal: &mut Exporter<'_>) -> Result<Self, ExportError> {
        Ok(Input {
            value: hal.output("in")?,
            inverse: hal.output("in-not")?,
        })
    }

    /// Takes the level.
    pub fn sampled(&self, level: bool) {
        self.value.set(level);
        self.inverse.set(!level);
    }
}

/// One output.
#[derive(Debug)]
pub struct Output {
    value: In<bool>,
    invert: Param<bool>,
}

impl Output {
    /// Exports the pins.
    pub fn export(hal: &mut Exporter<'_>) -> Result<Self, ExportError> {
        Ok(Output {
            value: hal.input("out")?,
            invert: hal.param("invert", false)?,
        })
    }

    /// The level wanted.
    pub fn command(&self) -> bool {
        self.value.get()
    }

    /// Whether the board inverts it.
    pub fn inverted(&self) -> bool {
        self.invert.get()
    }
}
