//! Changes that a test can make to the fake board.

use std::net::SocketAddrV4;
use std::time::Duration;

/// Ways to go wrong, and what goes in at the pins.
#[derive(Clone, Debug, Default)]
pub struct Knobs {
    /// Swallow so many datagrams before looking at them.
    pub drop_requests: u32,
    /// Execute, but do not answer so many exchanges.
    pub drop_replies: u32,
    /// Answer every exchange twice.
    pub duplicate_replies: bool,
    /// Send so many datagrams without a meaning before and after every answer.
    pub flood: (u32, u32),
    /// Hold every answer back by one exchange.
    pub late_by_one: bool,
    /// Answer this long after execution.
    pub delay: Duration,
    /// Be silent altogether: the cable is out.
    pub unplugged: bool,
    /// The external reset pin.
    pub external_reset: bool,
    /// Levels of the inputs.
    pub gpio_in: u64,
    /// Encoder 0 and stepgen 0 have an index pulse at this count.
    pub index_at: Option<i32>,
    /// They have one every so many counts.
    pub index_every: Option<i32>,
    /// The probe trips when stepgen 0 comes there.
    pub probe_at: Option<i32>,
    /// Encoder 0 counts so many less than stepgen 0.
    pub encoder_lag: i32,
    /// Illegal transitions at encoder 0.
    pub quad_errors: u8,
    /// Encoders that say that they have seen illegal transitions, a bit each.
    pub illegal: u16,
    /// Stepgens that say that their rate is limited, a bit each.
    pub rate_limited: u16,
    /// Swallow datagrams whose first record writes to this address.
    pub deaf_to: Option<u32>,
    /// E-stop inputs pressed.
    pub estop: u32,
    /// Its link is down or slow, and has lost so many frames.
    pub link: Option<(wire::LinkSpeed, u8)>,
    /// What became of its services.
    pub services: Option<wire::describe::JobsState>,
    /// Exchanges of the fast and the long way, and why the last of those took it.
    pub ways: [u32; 3],
    /// Say this instead of our wire version.
    pub wire_version: Option<u32>,
    /// Say this as the gateware's ABI.
    pub abi_gateware: Option<u32>,
    /// Say this as the magic.
    pub magic: Option<u32>,
    /// Damage the board information.
    pub bad_blob: bool,
    /// Another client that keeps the session.
    pub foreign_owner: Option<SocketAddrV4>,
}
