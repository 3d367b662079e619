//! What the services ask the board about itself when they start.

use ::jobs::Outside;
use wire::etherbone::{HEADER, record};
use wire::settings::{self, Settings};
use wire::{MAX_WORDS, map};

/// Reads `N` words from `address` on, as a client does. `None`: the board refuses.
pub fn read<const N: usize>(address: u32, out: &mut impl Outside) -> Option<[u32; N]> {
    let mut request = [0; MAX_WORDS];
    let mut reply = [0; MAX_WORDS];
    let (head, addresses) = request.get_mut(..4 + N)?.split_at_mut(4);
    head.copy_from_slice(&[HEADER, 0, record(0, N), 0]);
    for (place, address) in addresses.iter_mut().zip((address..).step_by(4)) {
        *place = address;
    }
    let length = out.datagram(request.get(..4 + N)?, &mut reply);
    reply.get(4..length)?.first_chunk().copied()
}

/// The settings in force, without the key.
pub fn settings(out: &mut impl Outside) -> Settings {
    let words: Option<[u32; settings::WORDS]> = read(map::FLASH_SETTINGS, out);
    words
        .and_then(|words| Settings::parse(&words).ok())
        .unwrap_or(Settings::BUILT_IN)
}
