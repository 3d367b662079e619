//! The pre-shared key: a client needs it to acquire a board that has a key.
//!
//! A board with a key ([`crate::describe::FEATURE_KEY`]) asks every client that wants to change
//! something to prove that it has the same key. It sends a challenge that never repeats, and the
//! client answers with a tag over it. The proof does not send the key itself, and no client can
//! read the key back.
//!
//! ```text
//! tag        the first 4 words of HMAC-SHA256 (RFC 2104, FIPS 180-4); key and message as big-endian bytes
//! message    the purpose ([`Purpose`]), the challenge's 4 words, and what the purpose adds
//!
//! purpose    challenge                                   adds                            tag goes to
//! "ACQU"     4 words at map::SESSION_CHALLENGE           the nonce                       map::SESSION_RESPONSE
//! "DSET"     discovery's Prove, the answer to a Set      all words before the tag        the end of a Proven
//! "CONS"     what `login` at the console says, in hex    nothing                         `login TAG`
//! ```
//!
//! A challenge is for one sender (address and port; for discovery the port), for one right answer,
//! and for at most [`LIFE_SECONDS`]. A wrong answer does not use it up: otherwise an attacker could
//! lock all clients out by guessing.
//!
//! All other rules follow from the session: with a key, flash and restart are for the owner alone,
//! as configuration and motion always are. While the session has an owner, other clients read zeros
//! for a challenge.

/// Words of a key, a challenge and a tag: 128 bits.
pub const WORDS: usize = 4;

/// 3 s: many times a round trip, and no longer than a silent session lasts.
pub const LIFE_SECONDS: u8 = 3;

/// The purpose of a tag: it is valid for no other.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum Purpose {
    /// To take the session.
    Acquire = u32::from_be_bytes(*b"ACQU"),
    /// To give settings by discovery.
    Set = u32::from_be_bytes(*b"DSET"),
    /// To get into the console.
    Login = u32::from_be_bytes(*b"CONS"),
    /// The board derives challenges with this purpose; no client signs with it.
    Challenge = u32::from_be_bytes(*b"CHAL"),
}

impl Purpose {
    /// The first words of a message.
    pub const fn head(self, [a, b, c, d]: [u32; WORDS]) -> [u32; 1 + WORDS] {
        [self as u32, a, b, c, d]
    }
}

/// No key, or no challenge.
pub const NONE: [u32; WORDS] = [0; WORDS];

/// A test vector for both ends: [`EXAMPLE_TAG`] acquires with [`EXAMPLE_CHALLENGE`] and nonce 7.
pub const EXAMPLE_KEY: [u32; WORDS] = [0x0001_0203, 0x0405_0607, 0x0809_0a0b, 0x0c0d_0e0f];
/// See [`EXAMPLE_KEY`].
pub const EXAMPLE_CHALLENGE: [u32; WORDS] = [0x1011_1213, 0x1415_1617, 0x1819_1a1b, 0x1c1d_1e1f];
/// See [`EXAMPLE_KEY`].
pub const EXAMPLE_TAG: [u32; WORDS] = [0x50b0_97cd, 0x973a_46bf, 0xc33e_2815, 0x3746_7a70];
