use super::*;
use crate::fake::*;
use hmac::{Hmac, Mac};
use proptest::prelude::*;
use std::vec::Vec;
use wire::auth::{EXAMPLE_CHALLENGE, EXAMPLE_KEY, EXAMPLE_TAG};
use wire::{MAX_WORDS, Request, etherbone, map};

const KEY: Words = [0xfeed_0001, 2, 3, 4];
const WRONG: Words = [0xfeed_0001, 2, 3, 5];

// ---- The tag ------------------------------------------------------------------------------------

fn tag_of_the_hmac_crate(key: &Words, message: &[u32]) -> Words {
    let bytes: Vec<u8> = key.iter().flat_map(|word| word.to_be_bytes()).collect();
    let mut hmac = Hmac::<sha2::Sha256>::new_from_slice(&bytes).unwrap();
    for word in message {
        hmac.update(&word.to_be_bytes());
    }
    let bytes = hmac.finalize().into_bytes();
    core::array::from_fn(|n| u32::from_be_bytes(bytes[4 * n..][..4].try_into().unwrap()))
}

proptest! {
    #[test]
    fn a_tag_is_the_hmac_crates(key: Words, message in proptest::collection::vec(any::<u32>(), 0..46), split in 0..46usize) {
        let split = split.min(message.len());
        prop_assert_eq!(tag(&key, &message[..split], &message[split..]), tag_of_the_hmac_crate(&key, &message));
    }
}

#[test]
fn the_example_of_the_specification_comes_out() {
    let head = Purpose::Acquire.head(EXAMPLE_CHALLENGE);
    assert_eq!(tag(&EXAMPLE_KEY, &head, &[7]), EXAMPLE_TAG);
}

// ---- Challenges ---------------------------------------------------------------------------------

fn acquiring(key: &Words, challenge: Words, nonce: u32) -> Words {
    tag(key, &Purpose::Acquire.head(challenge), &[nonce])
}

fn locked() -> Auth {
    let mut auth = Auth::new(9);
    auth.lock(KEY);
    auth
}

#[test]
fn without_a_key_there_is_no_challenge_and_every_client_is_trusted() {
    let mut auth = Auth::new(9);
    assert_eq!(*auth.challenge(ALICE), NONE);
    assert_eq!(auth.prove(ALICE, Purpose::Acquire, &[7], None), Ok(()));
    assert_eq!((auth.secret(), auth.trusted()), (0, true));
}

#[test]
fn a_challenge_is_one_senders_and_stays_until_it_is_answered_or_old() {
    let mut auth = locked();
    let challenge = *auth.challenge(ALICE);
    let other_port = Peer { port: 1, ..ALICE };
    for stranger in [BOB, other_port, by_port(ALICE.port)] {
        assert_ne!(*auth.challenge(stranger), challenge);
    }
    for _ in 0..LIFE_SECONDS {
        auth.stir(77);
        assert_eq!(*auth.challenge(ALICE), challenge);
        auth.tick();
    }
    assert_ne!(*auth.challenge(ALICE), challenge);
}

#[test]
fn no_challenge_comes_twice_whatever_stands_still() {
    let mut seen = Vec::new();
    for (boot_id, arrivals) in [(1, [1, 2]), (1, [1, 3]), (1, [2, 2]), (2, [1, 2])] {
        let mut auth = Auth::new(boot_id);
        auth.lock(KEY);
        for clock in arrivals {
            auth.stir(clock);
        }
        // The same without another arrival, many times: the number makes the challenges differ.
        for _ in 0..100 {
            let challenge = *auth.challenge(ALICE);
            assert!(!seen.contains(&challenge), "after {}", seen.len());
            seen.push(challenge);
            let answer = acquiring(&KEY, challenge, 7);
            let right = auth.prove(ALICE, Purpose::Acquire, &[7], Some(&answer));
            assert_eq!(right, Ok(()));
        }
    }
}

#[test]
fn one_arrival_a_clock_later_makes_another_challenge() {
    let with = |clock| {
        let mut auth = locked();
        auth.stir(clock);
        auth.stir(1);
        *auth.challenge(ALICE)
    };
    assert_ne!(with(1_000_000), with(1_000_001));
}

#[test]
fn both_halves_of_the_pool_go_into_a_challenge() {
    let stirred = |clocks: [u32; 2]| {
        let mut auth = locked();
        clocks.into_iter().for_each(|clock| auth.stir(clock));
        (auth.pool, *auth.challenge(ALICE))
    };
    // The second arrival undoes in the lower half what the first did there.
    let low = |clock: u32| clock.wrapping_mul(0x1b3);
    let (a, b) = (0x1234_5678, 0x9abc_def0);
    let (one, other) = (stirred([a, 7]), stirred([b, 7 ^ low(a) ^ low(b)]));
    assert_eq!(one.0 as u32, other.0 as u32);
    assert_ne!(one.0, other.0);
    assert_ne!(one.1, other.1);
}

#[test]
fn a_challenge_for_a_port_is_that_ports() {
    let mut auth = locked();
    let ports = [0, 7, wire::CONSOLE_PORT].map(|port| *auth.challenge(by_port(port)));
    assert!(ports[0] != ports[1] && ports[1] != ports[2] && ports[0] != ports[2]);
}

#[test]
fn a_tag_is_good_for_one_purpose() {
    for made_for in [Purpose::Acquire, Purpose::Set, Purpose::Login] {
        for used_for in [Purpose::Acquire, Purpose::Set, Purpose::Login] {
            let mut auth = locked();
            let answer = tag(&KEY, &made_for.head(*auth.challenge(ALICE)), &[7]);
            let judged = auth.prove(ALICE, used_for, &[7], Some(&answer));
            assert_eq!(judged.is_ok(), made_for == used_for, "{made_for:?}");
        }
    }
}

// ---- Acquiring: every refusal -------------------------------------------------------------------

/// An acquisition, as a host sends it.
fn acquisition(nonce: u32, answer: Words) -> Vec<u32> {
    let mut words = [0; MAX_WORDS];
    let request = Request::new(&mut words)
        .write(map::SESSION_RESPONSE, &answer)
        .write(map::SESSION_ACQUIRE, &[nonce])
        .read(0x77, &[map::SESSION_TOKEN]);
    request.words().unwrap().to_vec()
}

impl Rig {
    fn locked() -> Self {
        let mut rig = Rig::new();
        rig.server.auth.lock(KEY);
        rig
    }

    fn challenge(&mut self, peer: Peer) -> Words {
        [0, 4, 8, 12].map(|at| self.read_as(peer, map::SESSION_CHALLENGE + at).unwrap())
    }

    fn answer(&mut self, peer: Peer, key: &Words, nonce: u32) -> Words {
        acquiring(key, self.challenge(peer), nonce)
    }

    /// Acquires with the key; returns the datagram that did it.
    fn unlock(&mut self, peer: Peer) -> Vec<u32> {
        let answer = self.answer(peer, &KEY, 7);
        let words = acquisition(7, answer);
        let reply = self.send_as(peer, &words).expect("the right answer");
        assert_ne!(reply[4], 0, "a token");
        words
    }

    fn refused_for_key(&self) -> u32 {
        self.server.counters().refused[Refusal::Key.index()]
    }

    fn freed(&mut self, peer: Peer) {
        let token = self.read_as(peer, map::SESSION_TOKEN).unwrap();
        self.write_as(peer, map::SESSION_RELEASE, token).unwrap();
    }
}

/// The describe block's features.
const FEATURES: u32 = wire::describe::address(wire::describe::FEATURES_AT);

#[test]
fn a_board_with_a_key_says_so_and_gives_its_session_to_a_client_with_the_key() {
    let mut rig = Rig::new();
    assert_eq!(rig.read(FEATURES), Ok(0));
    rig.server.auth.lock(KEY);
    assert_eq!(rig.read(FEATURES), Ok(wire::describe::FEATURE_KEY));
    assert_eq!(rig.write(map::SESSION_ACQUIRE, 7), Err(Refusal::Key));
    rig.unlock(ALICE);
    assert!(rig.server.session().is_owner(ALICE));
    assert_eq!(rig.refused_for_key(), 1);
}

#[test]
fn a_client_without_the_key_gets_nothing_and_is_counted() {
    let mut rig = Rig::locked();
    let (wrong, right) = (rig.answer(ALICE, &WRONG, 7), rig.answer(ALICE, &KEY, 7));
    let bobs = rig.answer(BOB, &KEY, 7);
    for (peer, nonce, answer, whose) in [
        (ALICE, 7, wrong, "another key's"),
        (ALICE, 8, right, "another nonce's"),
        (BOB, 7, right, "another sender's"),
        (ALICE, 7, bobs, "another sender's"),
        (ALICE, 7, NONE, "none"),
        (
            ALICE,
            7,
            [right[0], right[1], right[2], right[3] ^ 1],
            "one bit off",
        ),
    ] {
        let sent = rig.send_as(peer, &acquisition(nonce, answer));
        assert_eq!(sent, Err(Refusal::Key), "{whose}");
    }
    assert_eq!(rig.refused_for_key(), 6);
    assert_eq!(rig.server.session().owner(), None);
    // No attempt used up the right answer: guessing cannot keep Alice out.
    assert!(rig.send(&acquisition(7, right)).is_ok());
}

#[test]
fn an_answer_is_whole_and_in_front_of_the_nonce_or_there_is_none() {
    let mut rig = Rig::locked();
    let right = rig.answer(ALICE, &KEY, 7);
    let record = |base, words: &[u32]| {
        let head = [etherbone::record(words.len(), 0), base];
        [&head[..], words].concat()
    };
    let packet = |records: &[Vec<u32>]| [&[etherbone::HEADER, 0][..], &records.concat()].concat();
    let nonce = record(map::SESSION_ACQUIRE, &[7]);
    let whole = record(map::SESSION_RESPONSE, &right);
    let three = record(map::SESSION_RESPONSE, &right[..3]);
    let sent = rig.send(&packet(&[three, nonce.clone()]));
    assert_eq!(sent, Err(Refusal::ReadOnly));
    let sent = rig.send(&packet(&[nonce.clone(), whole.clone()]));
    assert_eq!(sent, Err(Refusal::Key));
    // In a datagram of its own the answer is discarded at once.
    assert_eq!(rig.send(&packet(core::slice::from_ref(&whole))), Ok(vec![]));
    assert_eq!(
        rig.send(&packet(core::slice::from_ref(&nonce))),
        Err(Refusal::Key)
    );
    for at in [0, 4, 8, 12] {
        assert_eq!(rig.read(map::SESSION_RESPONSE + at), Ok(0));
    }
    assert_eq!(rig.send(&packet(&[whole, nonce])), Ok(vec![]));
}

#[test]
fn an_answer_that_comes_too_late_is_none() {
    let mut rig = Rig::locked();
    let right = rig.answer(ALICE, &KEY, 7);
    for _ in 0..LIFE_SECONDS {
        rig.server.auth.tick();
    }
    assert_eq!(rig.send(&acquisition(7, right)), Err(Refusal::Key));
}

#[test]
fn a_right_answer_is_used_up_even_if_its_datagram_is_refused_for_something_else() {
    let mut rig = Rig::locked();
    let words = acquisition(7, rig.answer(ALICE, &KEY, 7));
    let unmapped = [&words[..], &[0x000f_0100, 0x0008_0000, 1]].concat();
    assert_eq!(rig.send(&unmapped), Err(Refusal::Unmapped));
    assert_eq!(rig.server.session().owner(), None);
    assert_eq!(rig.send(&words), Err(Refusal::Key));
}

#[test]
fn while_a_session_has_an_owner_other_clients_get_no_challenge_and_cost_nothing() {
    let mut rig = Rig::locked();
    let kept = acquisition(7, rig.answer(BOB, &KEY, 7));
    rig.unlock(ALICE);
    assert_eq!(rig.challenge(BOB), NONE);
    assert_eq!(rig.send_as(BOB, &kept), Err(Refusal::NotOwner));
    assert_ne!(rig.challenge(ALICE), NONE, "to synchronise again");
    rig.freed(ALICE);
    assert_eq!(rig.send_as(BOB, &kept), Err(Refusal::Key), "kept for later");
}

#[test]
fn the_owner_needs_the_key_to_acquire_again_too() {
    let mut rig = Rig::locked();
    let first = rig.unlock(ALICE);
    let token = rig.read(map::SESSION_TOKEN);
    assert_eq!(rig.write(map::SESSION_ACQUIRE, 7), Err(Refusal::Key));
    assert_eq!(rig.send(&first), Err(Refusal::Key));
    assert_eq!(rig.read(map::SESSION_TOKEN), token, "nothing changed");
    rig.unlock(ALICE);
    assert_ne!(rig.read(map::SESSION_TOKEN), token);
}

#[test]
fn flash_and_restart_are_the_owners_alone_on_a_board_with_a_key() {
    let mut rig = Rig::locked();
    for (address, value) in [
        (map::FLASH_ADDRESS, 0),
        (map::FLASH_BUFFER, 0),
        (map::FLASH_OP, wire::flash::Op::ForgetSettings.code()),
        (map::SESSION_REBOOT, map::REBOOT_KEY),
    ] {
        assert_eq!(rig.write(address, value), Err(Refusal::Key), "{address:#x}");
    }
    for address in [map::CONFIG_STEPGEN, map::SERVICE + 4] {
        assert_eq!(
            rig.write(address, 60),
            Err(Refusal::NotOwner),
            "{address:#x}"
        );
    }
    rig.unlock(ALICE);
    assert_eq!(rig.write(map::FLASH_ADDRESS, 0), Ok(()));
    assert_eq!(rig.write(map::CONFIG_STEPGEN, 60), Ok(()));
    let denied = rig.write_as(BOB, map::FLASH_ADDRESS, 0);
    assert_eq!(denied, Err(Refusal::NotOwner));
    assert_eq!(rig.write(map::SESSION_REBOOT, map::REBOOT_KEY), Ok(()));
}

#[test]
fn a_token_under_a_key_cannot_be_computed_from_public_words() {
    let mut rig = Rig::locked();
    rig.unlock(ALICE);
    let mut session = crate::session::Session::new();
    // The same sender, nonce, boot id and clock, but not the answer.
    let open = session.acquire(ALICE, 7, BOOT.id, rig.board.now);
    assert_eq!(open, Ok(()));
    assert_ne!(rig.read(map::SESSION_TOKEN), Ok(session.token_for(ALICE)));
}

// ---- Replay -------------------------------------------------------------------------------------

/// The actions of hosts, and the passing of time.
#[derive(Clone, Copy, Debug)]
enum Deed {
    /// Acquires as one of three senders, with the key or another one; the datagram may get lost.
    Acquire {
        peer: usize,
        right: bool,
        lost: bool,
    },
    /// The owner gives the session back.
    Release,
    /// The owner is silent, or a moment passes.
    Time { seconds: u64 },
    /// The firmware restarts, at this clock or later.
    Restart,
}

fn deed() -> impl Strategy<Value = Deed> {
    prop_oneof![
        4 => (0..3usize, any::<bool>(), any::<bool>())
            .prop_map(|(peer, right, lost)| Deed::Acquire { peer, right, lost }),
        2 => Just(Deed::Release),
        1 => (0..5u64).prop_map(|seconds| Deed::Time { seconds }),
        1 => Just(Deed::Restart),
    ]
}

const PEERS: [Peer; 3] = [
    ALICE,
    BOB,
    Peer {
        ip: 0xc0a8_0209,
        port: 40_000,
    },
];

proptest! {
    // A tag is 4 compressions, slow without optimisation, and this makes thousands.
    #![proptest_config(ProptestConfig::with_cases(64))]
    /// Every datagram that arrived is sent again: from the same address and from every other, in
    /// order and in reverse, at once and after each later action. None of them ever makes its
    /// sender the owner.
    #[test]
    fn no_recorded_exchange_of_datagrams_opens_a_board_again(deeds in proptest::collection::vec(deed(), 1..14)) {
        let mut rig = Rig::locked();
        let mut recorded: Vec<Vec<u32>> = Vec::new();
        for deed in deeds {
            match deed {
                Deed::Acquire { peer, right, lost } => {
                    let peer = PEERS[peer];
                    let key = if right { KEY } else { WRONG };
                    let words = acquisition(7, rig.answer(peer, &key, 7));
                    if !lost {
                        let mine = rig.server.session().owner().is_none_or(|owner| owner == peer);
                        let taken = rig.send_as(peer, &words).is_ok();
                        prop_assert_eq!(taken, right && mine);
                        recorded.push(words);
                    }
                }
                Deed::Release => {
                    if let Some(owner) = rig.server.session().owner() {
                        rig.freed(owner);
                    }
                }
                Deed::Time { seconds } => {
                    rig.server.poll(&mut rig.board);
                    rig.board.now += seconds * u64::from(CLOCK);
                    rig.server.poll(&mut rig.board);
                    (0..seconds).for_each(|_| rig.server.auth.tick());
                }
                Deed::Restart => {
                    let boot = crate::postmortem::Boot { id: rig.server.boot().id + 1, ..BOOT };
                    rig.server = crate::server::Server::new(*rig.server.ident(), ABI, boot);
                    rig.server.start(&mut rig.board);
                    rig.server.auth.lock(KEY);
                }
            }
            let session = *rig.server.session();
            let backwards = recorded.iter().rev();
            for words in recorded.iter().chain(backwards) {
                for peer in PEERS {
                    prop_assert!(rig.send_as(peer, words).is_err());
                }
            }
            prop_assert_eq!(*rig.server.session(), session, "the same owner, token and sequence");
        }
    }
}

// ---- The console --------------------------------------------------------------------------------

fn asked(auth: &mut Auth) -> Words {
    let challenge = *auth.challenge(by_port(wire::CONSOLE_PORT));
    tag(&KEY, &Purpose::Login.head(challenge), &[])
}

#[test]
fn the_console_knows_a_friend_by_a_fresh_answer_only() {
    let mut auth = locked();
    assert!(!auth.trusted());
    assert_eq!(
        auth.login(&NONE),
        Err(Refusal::Key),
        "no challenge was asked for"
    );
    let right = asked(&mut auth);
    assert_eq!(auth.login(&NONE), Err(Refusal::Key));
    assert_eq!(auth.login(&right), Ok(()));
    assert!(auth.trusted());
    assert_eq!(auth.login(&right), Err(Refusal::Key), "a replay");
    assert!(!auth.trusted(), "a replayed answer proves nothing");
    let late = asked(&mut auth);
    (0..LIFE_SECONDS).for_each(|_| auth.tick());
    assert_eq!(auth.login(&late), Err(Refusal::Key));
}

#[test]
fn the_next_visitor_is_a_stranger_again() {
    let mut auth = locked();
    let right = asked(&mut auth);
    auth.login(&right).unwrap();
    auth.greet();
    assert!(!auth.trusted());
}
