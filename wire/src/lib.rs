//! The FerroCNC protocol: Etherbone over UDP, safe against malformed datagrams.
//!
//! Both ends link this crate, the firmware on the softcore and the driver in LinuxCNC. So a fact
//! about the wire is written once, and this rustdoc is the specification. The crate knows no
//! sockets and no clocks and accesses no register; it has no dependencies, allocates nothing, and
//! after a successful `new_checked` no function of it can panic.
//!
//! | module | content |
//! |---|---|
//! | [`etherbone`] | packet and record layout; the whole datagram is checked before anything runs |
//! | [`map`] | the meaning of the address windows |
//! | [`channels`] | the channel counts of a board |
//! | [`describe`] | the description of a board |
//! | [`board`] | the names of its channels: the board information blob |
//! | [`exchange`] | one command block out, one status block back, once per servo period |
//! | [`state`] | the states of the machine, and why it stopped |
//! | [`flash`] | the layout of the SPI flash, and the operations of the flash window |
//! | [`auth`] | the pre-shared key: challenges and what is signed |
//! | [`settings`] | the settings of a board that outlive a power cycle |
//! | [`images`] | bitstreams in flash: meta page, stub pages, the trailer of the ROM |
//! | [`discovery`] | finding boards at any address, and giving them an address |
//! | [`mdns`] | multicast DNS: `NAME.local`, and which boards there are |
//! | [`jobs`] | over TCP: programs the board executes by itself, and its operator's commands |
//! | [`name`] | names of 32 bytes |
//! | [`crc`] | the CRC of the whole project |
//! | [`refusal`] | every reason why a datagram is dropped, each with its own counter |
//! | [`layout`] | the layout of the exchange as text, for the ABI number |
//! | [`regmap`] | the register map: what lies in the service window, and the board's memory |
//! | [`units`] | velocity, acceleration, position and counts as types |
//!
//! Everything on the wire except [`jobs`] and [`mdns`] is big-endian 32-bit words. In memory, words
//! are `u32` in the machine's own order: a transport converts once ([`words_from_bytes`],
//! [`words_to_bytes`]), all other code reads numbers.
#![no_std]
#![forbid(unsafe_code)]

pub mod auth;
pub mod board;
pub mod channels;
mod codes;
pub mod crc;
pub mod describe;
pub mod discovery;
pub mod etherbone;
pub mod exchange;
pub mod flash;
pub mod images;
pub mod jobs;
pub mod layout;
pub mod map;
pub mod mdns;
pub mod name;
pub mod pins;
pub mod refusal;
pub mod regmap;
pub mod services;
pub mod settings;
pub mod state;
pub mod units;

pub use etherbone::{Packet, Record, ReplyWriter, Request};
pub use name::Name;
pub use refusal::{LongWay, Refusal};
pub use state::{FaultReason, GateClose, LinkSpeed, ResetReason, State};

/// Version of everything in this crate. Host and board must agree; unequal versions never arm. It
/// is part of the ABI number ([`layout`]), so that gateware, firmware and host use the same one.
pub const WIRE_VERSION: u32 = 5;

/// UDP port of the Etherbone server. LiteX's and Lcnc's default (CERN's would be 60368).
pub const DEFAULT_PORT: u16 = 1234;

/// UDP port of [`discovery`]: from the dynamic range, where nothing is registered.
pub const DISCOVERY_PORT: u16 = 51234;

/// TCP port of the debug console: telnet's.
pub const CONSOLE_PORT: u16 = 23;
/// TCP port of the status page.
pub const PAGE_PORT: u16 = 80;

/// Largest UDP payload in one Ethernet frame without fragments: 1500 - 20 (IPv4) - 8 (UDP).
pub const MAX_PAYLOAD: usize = 1472;

/// The same in 32-bit words.
pub const MAX_WORDS: usize = MAX_PAYLOAD / 4;

/// Longest datagram of a guest, a client that does not own an armed machine, in 32-bit words:
/// [`GUEST_READS`] in one record. A word takes about 250 of the board's clocks, and the owner's
/// next exchange may have to wait for all of them.
pub const GUEST_WORDS: usize = GUEST_READS + etherbone::OVERHEAD;

/// Words that a guest can read at once while the machine is armed.
pub const GUEST_READS: usize = 16;

/// Converts a UDP payload into words. An empty, ragged (not whole words) or oversized payload is
/// refused before any byte is read.
pub fn words_from_bytes<'w>(bytes: &[u8], words: &'w mut [u32]) -> Result<&'w [u32], Refusal> {
    if bytes.len() > MAX_PAYLOAD || bytes.len() / 4 > words.len() {
        return Err(Refusal::Oversized);
    }
    if !bytes.len().is_multiple_of(4) {
        return Err(Refusal::Ragged);
    }
    let (chunks, _) = bytes.as_chunks::<4>();
    for (word, chunk) in words.iter_mut().zip(chunks) {
        *word = u32::from_be_bytes(*chunk);
    }
    words.get(..chunks.len()).ok_or(Refusal::Oversized)
}

/// Converts words into the bytes of a UDP payload; returns the number of bytes. Words that do not
/// fit are left out, so pass `4 * words.len()` bytes.
pub fn words_to_bytes(words: &[u32], bytes: &mut [u8]) -> usize {
    let (chunks, _) = bytes.as_chunks_mut::<4>();
    let mut written = 0;
    for (chunk, word) in chunks.iter_mut().zip(words) {
        *chunk = word.to_be_bytes();
        written += 4;
    }
    written
}
