//! What the services ask the board about itself when they start, and while the machine rests.

use ::jobs::{Outside, inside};
use wire::etherbone::{OVERHEAD, Request};
use wire::map;
use wire::settings::{self, Settings};

/// Words that are read at most.
const READS: usize = settings::WORDS;

/// Reads `N` words from `address` on, as a client does. `None`: the board refuses, or they are more
/// than [`READS`].
pub fn read<const N: usize>(address: u32, out: &mut impl Outside) -> Option<[u32; N]> {
    let (mut request, mut reply) = ([0; OVERHEAD + READS], [0; OVERHEAD + READS]);
    let addresses: [u32; N] = core::array::from_fn(|n| address + 4 * n as u32);
    inside::ask(
        Request::new(&mut request).read(0, &addresses),
        &mut reply,
        out,
    )
}

/// The settings in force, without the key. `None`: the board does not say them now.
pub fn settings_now(out: &mut impl Outside) -> Option<Settings> {
    let words: [u32; settings::WORDS] = read(map::FLASH_SETTINGS, out)?;
    Settings::parse(&words).ok()
}

/// The same; the settings of a new board if it does not say them.
pub fn settings(out: &mut impl Outside) -> Settings {
    settings_now(out).unwrap_or(Settings::BUILT_IN)
}
