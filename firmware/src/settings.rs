//! The two copies of the settings in flash, and which of them is in force.
//!
//! The newest whole copy is in force. A save or an erase begins with the other one, so that an
//! interrupted operation always leaves one whole copy ([`crate::flash`] writes).

use crate::nor::Nor;
use embedded_hal::spi::SpiDevice;
use wire::flash::{Layout, OpResult};
use wire::settings::{Settings, WORDS};

/// What the two sectors hold.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Copies([Option<Settings>; 2]);

/// Reads both.
pub fn load<S: SpiDevice>(nor: &mut Nor<S>, layout: &Layout) -> Result<Copies, OpResult> {
    let mut copies = [None; 2];
    for (copy, place) in (0..).zip(&mut copies) {
        let mut words = [0; WORDS];
        nor.words(layout.settings_copy(copy), &mut words)?;
        *place = Settings::parse(&words).ok();
    }
    Ok(Copies(copies))
}

impl Copies {
    /// The newest whole copy, and its number.
    pub fn newest(self) -> Option<(Settings, u32)> {
        match self.0 {
            [Some(a), Some(b)] if b.newer_than(&a) => Some((b, 1)),
            [Some(a), _] => Some((a, 0)),
            [None, Some(b)] => Some((b, 1)),
            [None, None] => None,
        }
    }

    /// The copy to write or erase first: not the newest.
    pub fn older(self) -> u32 {
        self.newest().map_or(0, |(_, copy)| 1 - copy)
    }
}
