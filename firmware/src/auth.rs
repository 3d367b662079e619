//! The pre-shared key on the board: creates challenges and checks answers ([`wire::auth`] says what
//! is signed).
//!
//! The board has no source of random numbers and needs none. A challenge is the tag, under the key,
//! of words that never repeat. Without the key no client can predict the next challenge, because it
//! cannot compute any tag; and no challenge was ever sent before. The words never repeat because
//! they contain, in this order of strength:
//!
//! * a counter, while the firmware runs;
//! * the boot id, across restarts (it is kept in RAM that survives them);
//! * across power-ups, the clock (16 ns) at which each frame arrived, this one included, mixed into
//!   a pool.
//!
//! The limit: an attacker that can switch the power at will, and is alone on the wire, may with
//! patience reproduce all arrival clocks of an earlier power-up. Such an attacker can also hold the
//! factory pin, which is easier.
//!
//! While a client owns the session, the board does not compute tags for other clients
//! ([`crate::server`] does not ask then): a tag takes long, and the exchange comes first.

use crate::session::Peer;
use sha2::compress256;
use sha2::digest::generic_array::GenericArray;
use subtle::ConstantTimeEq;
use wire::Refusal;
use wire::auth::{LIFE_SECONDS, NONE, Purpose, WORDS};

/// A key, a challenge, a tag.
pub type Words = [u32; WORDS];

/// The recipient of a challenge outside of Etherbone: discovery answers to a port, and there is one
/// console.
pub const fn by_port(port: u16) -> Peer {
    Peer { ip: 0, port }
}

/// The key and the state of its challenges.
#[derive(Clone, Debug)]
pub struct Auth {
    key: Words,
    boot_id: u32,
    /// A hash of the arrival clocks of all frames.
    pool: u64,
    /// The source of the challenges in force, one for each sender: a number, and the pool at the
    /// first request.
    seed: (u32, u64),
    /// Seconds these challenges remain valid; 0 if none is in force.
    left: u8,
    /// The challenge that was computed last.
    shown: Words,
    /// From the last right answer; only its sender has seen it.
    secret: u32,
    /// The client of the console has proved that it has the key.
    friend: bool,
}

impl Auth {
    /// No key.
    pub const fn new(boot_id: u32) -> Self {
        Auth {
            key: NONE,
            boot_id,
            pool: 0,
            seed: (0, 0),
            left: 0,
            shown: NONE,
            secret: 0,
            friend: false,
        }
    }

    /// Puts a key in force; zeros mean no key.
    pub fn lock(&mut self, key: Words) {
        self.key = key;
    }

    /// Is there a key?
    pub fn locked(&self) -> bool {
        self.key != NONE
    }

    /// A frame arrived at this clock.
    pub fn stir(&mut self, clock: u32) {
        // FNV-1a's 64-bit prime: every bit of every arrival reaches the upper half.
        self.pool = (self.pool ^ u64::from(clock)).wrapping_mul(0x0100_0000_01b3);
    }

    /// A second has passed.
    pub fn tick(&mut self) {
        self.left = self.left.saturating_sub(1);
    }

    /// The challenge for this sender. It is a new one if the last was answered or is too old; zeros
    /// without a key.
    #[inline(never)]
    pub fn challenge(&mut self, peer: Peer) -> &Words {
        if !self.locked() {
            return &self.key;
        }
        if self.left == 0 {
            let (number, _) = self.seed;
            self.seed = (number.wrapping_add(1), self.pool);
            self.left = LIFE_SECONDS;
        }
        self.make(peer);
        &self.shown
    }

    /// A word of the challenge for this sender. A sender has to read the first word first.
    pub fn read(&mut self, peer: Peer, word: u32) -> u32 {
        if word == 0 {
            self.challenge(peer);
        }
        self.shown.get(word as usize).copied().unwrap_or(0)
    }

    /// Is this the answer to the sender's challenge? A right answer is used up. Without a key every
    /// answer is right.
    #[inline(never)]
    pub fn prove(
        &mut self,
        peer: Peer,
        purpose: Purpose,
        rest: &[u32],
        answer: Option<&Words>,
    ) -> Result<(), Refusal> {
        if !self.locked() || peer == Peer::INSIDE && answer.is_none() {
            return Ok(());
        }
        let (Some(answer), 1..) = (answer, self.left) else {
            return Err(Refusal::Key);
        };
        self.make(peer);
        let right = tag(&self.key, &purpose.head(self.shown), rest);
        if right.as_slice().ct_eq(answer).into() {
            self.left = 0;
            let [secret, ..] = right;
            self.secret = secret;
            Ok(())
        } else {
            Err(Refusal::Key)
        }
    }

    /// A number for a session's token that only its owner and the board know; 0 without a key.
    pub fn secret(&self) -> u32 {
        self.secret
    }

    /// A new client is at the console.
    pub fn greet(&mut self) {
        self.friend = false;
    }

    /// Another client of the console has the word: `friend` says whether it has proved that it has
    /// the key. Returns that of the client before.
    pub fn change(&mut self, friend: bool) -> bool {
        core::mem::replace(&mut self.friend, friend)
    }

    /// Checks the console client's answer to the challenge for [`by_port`] of the console.
    pub fn login(&mut self, answer: &Words) -> Result<(), Refusal> {
        self.friend = false;
        let console = by_port(wire::CONSOLE_PORT);
        self.prove(console, Purpose::Login, &[], Some(answer))?;
        self.friend = true;
        Ok(())
    }

    /// May the client of the console do more than look?
    pub fn trusted(&self) -> bool {
        self.friend || !self.locked()
    }

    /// Computes the challenge in force for this sender.
    fn make(&mut self, peer: Peer) {
        let (number, pool) = self.seed;
        let head =
            Purpose::Challenge.head([self.boot_id, number, (pool >> 32) as u32, pool as u32]);
        self.shown = tag(&self.key, &head, &[peer.ip, peer.port.into()]);
    }
}

/// The first 128 bits of HMAC-SHA256. HMAC is implemented here because the key has one length and
/// messages are words: 1.2 KiB less than the `hmac` crate, which it is tested against.
#[inline(never)]
pub fn tag(key: &Words, head: &[u32], rest: &[u32]) -> Words {
    let inner = digest(key, 0x3636_3636, head, rest);
    let [a, b, c, d, ..] = digest(key, 0x5c5c_5c5c, &inner, &[]);
    [a, b, c, d]
}

/// Words of a block.
const BLOCK: usize = 16;
/// Blocks of the longest message, a Proven, after the padded key.
const BLOCKS: usize = 4;

const _: () = {
    let longest = 1 + WORDS + wire::discovery::WORDS_MAX - WORDS;
    // One bit after the message, and the length in the last two words.
    assert!(BLOCK + longest + 3 <= BLOCK * BLOCKS);
};

/// SHA-256 of the padded key and the message after it.
#[inline(never)]
fn digest(key: &Words, pad: u32, head: &[u32], rest: &[u32]) -> [u32; 8] {
    // FIPS 180-4, 5.3.3.
    let mut state = [
        0x6a09_e667,
        0xbb67_ae85,
        0x3c6e_f372,
        0xa54f_f53a,
        0x510e_527f,
        0x9b05_688c,
        0x1f83_d9ab,
        0x5be0_cd19,
    ];
    let mut words = [pad; BLOCK * BLOCKS];
    let (first, message) = words.split_at_mut(BLOCK);
    for (place, word) in first.iter_mut().zip(key) {
        *place ^= word;
    }
    message.fill(0);
    let mut place = message.iter_mut();
    for part in [head, rest, &[0x8000_0000]] {
        for (word, place) in part.iter().zip(place.by_ref()) {
            *place = *word;
        }
    }
    let length = BLOCK + head.len() + rest.len();
    let blocks = (length + 3).div_ceil(BLOCK);
    if let Some(last) = words.get_mut(blocks * BLOCK - 1) {
        *last = 32 * length as u32;
    }
    for block in words.as_chunks::<BLOCK>().0.iter().take(blocks) {
        let mut bytes = GenericArray::from([0; 4 * BLOCK]);
        for (place, word) in bytes.as_chunks_mut().0.iter_mut().zip(block) {
            *place = word.to_be_bytes();
        }
        compress256(&mut state, core::slice::from_ref(&bytes));
    }
    state
}

#[cfg(test)]
mod tests;
