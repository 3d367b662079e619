//! The pre-shared key: who has it may take a board, whose key it is.
//!
//! A board with a key ([`crate::describe::FEATURE_KEY`]) asks whoever wants to change something to prove that he has
//! it, too: it gives a challenge that never comes again, and is answered with a tag over it. The key itself is never sent
//! to prove it, and is read back by nobody.
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
//! A challenge is for one sender (address and port; discovery: port), for one right answer, and for [`LIFE_SECONDS`] at the
//! most. A wrong answer does not use it up: else anybody could keep everybody out by guessing.
//!
//! Everything else follows from the session: with a key set flash and restart are the owner's alone, as configuration and
//! motion always are. While somebody owns the session, strangers read zeros for a challenge.

/// Words of a key, a challenge and a tag: 128 bits.
pub const WORDS: usize = 4;

/// 3 s: a round trip many times over, and no longer than a silent session lives.
pub const LIFE_SECONDS: u8 = 3;

/// What a tag is for: it is good for nothing else.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum Purpose {
    /// To take the session.
    Acquire = u32::from_be_bytes(*b"ACQU"),
    /// To give settings by discovery.
    Set = u32::from_be_bytes(*b"DSET"),
    /// To get into the console.
    Login = u32::from_be_bytes(*b"CONS"),
    /// What a board makes a challenge of; nobody signs that.
    Challenge = u32::from_be_bytes(*b"CHAL"),
}

impl Purpose {
    /// How a message begins.
    pub const fn head(self, [a, b, c, d]: [u32; WORDS]) -> [u32; 1 + WORDS] {
        [self as u32, a, b, c, d]
    }
}

/// No key, or no challenge.
pub const NONE: [u32; WORDS] = [0; WORDS];

/// An example both ends are held against: [`EXAMPLE_TAG`] acquires with [`EXAMPLE_CHALLENGE`] and nonce 7.
pub const EXAMPLE_KEY: [u32; WORDS] = [0x0001_0203, 0x0405_0607, 0x0809_0a0b, 0x0c0d_0e0f];
/// See [`EXAMPLE_KEY`].
pub const EXAMPLE_CHALLENGE: [u32; WORDS] = [0x1011_1213, 0x1415_1617, 0x1819_1a1b, 0x1c1d_1e1f];
/// See [`EXAMPLE_KEY`].
pub const EXAMPLE_TAG: [u32; WORDS] = [0x50b0_97cd, 0x973a_46bf, 0xc33e_2815, 0x3746_7a70];
