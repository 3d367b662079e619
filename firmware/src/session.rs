//! The session: one host at a time owns the motion; all others may only read.
//!
//! A session is bound to the IP address and port that acquired it, and to a token that only its
//! owner can read. It ends when its owner releases it, when the watchdog bites, or, if the machine
//! was never armed in it, after [`SILENCE_SECONDS`] without a datagram. Only then can another host
//! take over: a second LinuxCNC on the network must not be able to steal a moving machine.

use wire::Refusal;

/// 3 s: longer than the longest pause between datagrams in a LinuxCNC start-up, short enough to
/// wait for.
pub const SILENCE_SECONDS: u32 = 3;

/// Where a datagram came from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Peer {
    /// IPv4 address.
    pub ip: u32,
    /// UDP port.
    pub port: u16,
}

impl Peer {
    /// The jobs program on the board itself. No datagram from the wire is ever taken for it.
    pub const INSIDE: Peer = Peer {
        ip: 0x7f00_0001,
        port: 0,
    };
}

/// The session, if there is one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Session {
    owner: Option<Owner>,
    last_sequence: u32,
    /// The last number in front of writes to the segments.
    segments: u32,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Owner {
    peer: Peer,
    token: u32,
    heard: u64,
}

impl Session {
    /// No session.
    pub const fn new() -> Self {
        Session {
            owner: None,
            last_sequence: 0,
            segments: 0,
        }
    }

    /// Makes `peer` the owner. The owner may acquire again, which is how it resynchronises; another
    /// host only when there is no owner. The new session has a new token and sequence 0.
    pub fn acquire(
        &mut self,
        peer: Peer,
        nonce: u32,
        boot_id: u32,
        now: u64,
    ) -> Result<(), Refusal> {
        self.may_acquire(peer, nonce)?;
        self.owner = Some(Owner {
            peer,
            token: token(peer, nonce, boot_id, now),
            heard: now,
        });
        self.last_sequence = 0;
        // Writes on their way from an earlier session have another number.
        self.segments = now as u32;
        Ok(())
    }

    /// Could `peer` acquire with this nonce, as far as the session is concerned?
    pub fn may_acquire(&self, peer: Peer, nonce: u32) -> Result<(), Refusal> {
        if nonce == 0 {
            return Err(Refusal::Value);
        }
        if self.owner.is_some_and(|owner| owner.peer != peer) {
            return Err(Refusal::NotOwner);
        }
        Ok(())
    }

    /// Releases the session; only its owner can, with its token.
    pub fn release(&mut self, peer: Peer, token: u32) -> Result<(), Refusal> {
        self.check(peer, token)?;
        self.owner = None;
        Ok(())
    }

    /// Ends the session without asking its owner.
    pub fn kill(&mut self) {
        self.owner = None;
    }

    /// Is this the owner, with the right token?
    #[inline]
    pub fn check(&self, peer: Peer, token: u32) -> Result<(), Refusal> {
        match self.owner {
            Some(owner) if owner.peer == peer && owner.token == token => Ok(()),
            Some(_) | None => Err(Refusal::NotOwner),
        }
    }

    /// Does `peer` own it?
    pub fn is_owner(&self, peer: Peer) -> bool {
        self.owner.is_some_and(|owner| owner.peer == peer)
    }

    /// The owner, if there is one.
    pub fn owner(&self) -> Option<Peer> {
        self.owner.map(|owner| owner.peer)
    }

    /// The token as `peer` may see it: the owner's own token, or 0.
    pub fn token_for(&self, peer: Peer) -> u32 {
        match self.owner {
            Some(owner) if owner.peer == peer => owner.token,
            Some(_) | None => 0,
        }
    }

    /// The last accepted sequence number; 0 in a fresh session.
    #[inline]
    pub fn last_sequence(&self) -> u32 {
        self.last_sequence
    }

    /// An exchange was accepted.
    #[inline]
    pub fn accept(&mut self, sequence: u32) {
        self.last_sequence = sequence;
    }

    /// The last number in front of writes to the segments.
    pub fn segments(&self) -> u32 {
        self.segments
    }

    /// Takes the next of these numbers.
    pub fn count_segments(&mut self) {
        self.segments = self.segments.wrapping_add(1);
    }

    /// The owner said something.
    pub fn heard(&mut self, now: u64) {
        if let Some(owner) = &mut self.owner {
            owner.heard = now;
        }
    }

    /// Has the owner been silent for too long?
    pub fn silent(&self, now: u64, clock_hz: u32) -> bool {
        let limit = u64::from(SILENCE_SECONDS) * u64::from(clock_hz);
        self.owner
            .is_some_and(|owner| now.wrapping_sub(owner.heard) >= limit)
    }
}

/// A token that is never 0 and differs from session to session. It prevents accidents, not attacks:
/// the pre-shared key is for those.
fn token(peer: Peer, nonce: u32, boot_id: u32, now: u64) -> u32 {
    let mut hash = 0x811c_9dc5u32; // FNV-1a's offset basis and prime, one word at a time
    for word in [
        peer.ip,
        u32::from(peer.port),
        nonce,
        boot_id,
        now as u32,
        (now >> 32) as u32,
    ] {
        hash = (hash ^ word).wrapping_mul(0x0100_0193);
        hash ^= hash >> 15;
    }
    hash.max(1)
}

#[cfg(test)]
mod tests {
    use super::*;

    const ALICE: Peer = Peer {
        ip: 0xc0a8_0201,
        port: 5000,
    };
    const BOB: Peer = Peer {
        ip: 0xc0a8_0202,
        port: 5000,
    };

    fn owned() -> (Session, u32) {
        let mut session = Session::new();
        session.acquire(ALICE, 7, 1, 100).unwrap();
        (session, session.token_for(ALICE))
    }

    #[test]
    fn the_first_to_ask_owns_it_and_a_stranger_cannot_steal_it() {
        let (mut session, _) = owned();
        assert_eq!(session.acquire(BOB, 9, 1, 200), Err(Refusal::NotOwner));
        assert!(session.is_owner(ALICE));
        let same_host_other_port = Peer {
            port: 5001,
            ..ALICE
        };
        assert_eq!(
            session.acquire(same_host_other_port, 9, 1, 200),
            Err(Refusal::NotOwner)
        );
    }

    #[test]
    fn only_the_owner_sees_the_token_and_only_with_it_may_command() {
        let (session, token) = owned();
        assert_ne!(token, 0);
        assert_eq!(session.token_for(BOB), 0);
        assert_eq!(session.check(ALICE, token), Ok(()));
        assert_eq!(session.check(ALICE, token ^ 1), Err(Refusal::NotOwner));
        assert_eq!(session.check(BOB, token), Err(Refusal::NotOwner));
        assert_eq!(Session::new().check(ALICE, 0), Err(Refusal::NotOwner));
    }

    #[test]
    fn acquiring_again_gives_a_new_token_and_starts_the_sequence_over() {
        let (mut session, token) = owned();
        session.accept(77);
        session.acquire(ALICE, 8, 1, 300).unwrap();
        assert_ne!(session.token_for(ALICE), token);
        assert_eq!(session.last_sequence(), 0);
    }

    #[test]
    fn a_token_is_another_wherever_a_bit_of_what_makes_it_is() {
        let mut tokens = std::collections::BTreeSet::from([token(ALICE, 7, 1, 100)]);
        for bit in 0..64 {
            tokens.insert(token(ALICE, 7, 1, 100 ^ 1 << bit));
            let Some(flip) = 1u32.checked_shl(bit) else {
                continue;
            };
            let ip = ALICE.ip ^ flip;
            let port = ALICE.port ^ flip as u16;
            tokens.insert(token(Peer { ip, ..ALICE }, 7, 1, 100));
            tokens.insert(token(Peer { port, ..ALICE }, 7, 1, 100));
            tokens.insert(token(ALICE, 7 ^ flip, 1, 100));
            tokens.insert(token(ALICE, 7, 1 ^ flip, 100));
        }
        // A port has 16 bits; the 16 flips in the bits above give the first token again.
        assert_eq!(tokens.len(), 1 + 64 + 3 * 32 + 16);
    }

    #[test]
    fn a_nonce_of_zero_is_refused() {
        assert_eq!(Session::new().acquire(ALICE, 0, 1, 0), Err(Refusal::Value));
    }

    #[test]
    fn any_client_can_acquire_a_released_session() {
        let (mut session, token) = owned();
        assert_eq!(session.release(BOB, token), Err(Refusal::NotOwner));
        assert_eq!(session.release(ALICE, token), Ok(()));
        assert_eq!(session.acquire(BOB, 9, 1, 200), Ok(()));
    }

    #[test]
    fn silence_is_counted_from_the_last_word() {
        let (mut session, _) = owned();
        session.heard(1_000);
        let limit = 3 * 60_000_000;
        assert!(!session.silent(1_000 + limit - 1, 60_000_000));
        assert!(session.silent(1_000 + limit, 60_000_000));
        assert!(!Session::new().silent(u64::MAX, 60_000_000));
    }
}
