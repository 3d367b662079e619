//! The place of a netlist's cell on the chip.

use std::fmt;

/// A place on the chip.
#[derive(Clone, PartialEq, Eq)]
pub struct Bel {
    /// Column.
    pub x: usize,
    /// Row.
    pub y: usize,
    /// Its name in that tile.
    pub name: String,
}

impl fmt::Display for Bel {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "X{}/Y{}/{}", self.x, self.y, self.name)
    }
}

impl Bel {
    /// From nextpnr's way to write it: `X12/Y30/SLICEA`.
    pub fn parse(text: &str) -> Option<Self> {
        let mut parts = text.splitn(3, '/');
        let x = parts.next()?.strip_prefix('X')?.parse().ok()?;
        let y = parts.next()?.strip_prefix('Y')?.parse().ok()?;
        Some(Self {
            x,
            y,
            name: parts.next()?.to_owned(),
        })
    }
}
