//! What the services ask the board about itself when they start, and while the machine rests.

use ::jobs::Outside;
use wire::etherbone::{HEADER, record};
use wire::map;
use wire::settings::{self, Settings};

/// Words that are read at most.
const READS: usize = settings::WORDS;

/// Reads `N` words from `address` on, as a client does. `None`: the board refuses, or they are more
/// than [`READS`].
pub fn read<const N: usize>(address: u32, out: &mut impl Outside) -> Option<[u32; N]> {
    let mut request = [0; 4 + READS];
    let mut reply = [0; 4 + READS];
    let (head, addresses) = request.get_mut(..4 + N)?.split_at_mut(4);
    head.copy_from_slice(&[HEADER, 0, record(0, N), 0]);
    for (place, address) in addresses.iter_mut().zip((address..).step_by(4)) {
        *place = address;
    }
    let length = out.ask(request.get(..4 + N)?, &mut reply);
    reply.get(..length)?.get(4..)?.first_chunk().copied()
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
