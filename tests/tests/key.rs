//! A board with a pre-shared key: the release image on the Verilated board, with the key in its
//! flash.
//!
//! `firmware/src/auth/tests.rs` tests every case of the check. These tests show that the image on
//! real wires makes challenges that differ, and accepts the key and nothing else.

use ferrocnc_tests::flash::{self, factory};
use ferrocnc_tests::{to_bytes, to_words, wait_for_services};
use host::keys::Key;
use sim::lan_segment::{BOARD_IP, HOST_IP};
use sim::nor::spi::Shared;
use sim::nor::{Nor, Part, Times};
use sim::rig::Rig;
use std::net::Ipv4Addr;
use wire::describe::{self, FEATURE_KEY};
use wire::discovery::{Body, Message, WORDS_MAX, proof};
use wire::flash::{Op, OpResult};
use wire::settings::Settings;
use wire::{CONSOLE_PORT, DISCOVERY_PORT, MAX_WORDS, Refusal, Request, map};

const UID: [u32; 2] = [0xd162_0c8a, 0x1b2c_3d4e];
const KEY: [u32; 4] = [0x5eed_0001, 0x5eed_0002, 0x5eed_0003, 0x5eed_0004];
/// The host's ports.
const ALICE: u16 = 40_000;
const MALLORY: u16 = 40_001;
/// In front of every datagram.
const PAUSE_MS: u64 = 4;

fn key() -> Key {
    Key::new(KEY).expect("not all zeros")
}

fn wrong_key() -> Key {
    let [first, rest @ ..] = KEY;
    let [b, c, d] = rest;
    Key::new([first ^ 1, b, c, d]).expect("not all zeros")
}

const PART: Part = Part::W25Q32JV;
const UID64: u64 = (UID[0] as u64) << 32 | UID[1] as u64;

/// A flash with the key among its settings.
fn locked_flash() -> Shared {
    locked(factory(PART.with(Times::QUICK), UID64))
}

/// The same with services, which are the console.
fn locked_flash_with_services() -> Shared {
    locked(flash::with_services(PART.with(Times::QUICK), UID64))
}

fn locked(mut nor: Nor) -> Shared {
    let settings = Settings {
        sequence: 1,
        key: KEY,
        ..Settings::default()
    };
    let bytes = to_bytes(&settings.to_words());
    let at = flash::layout(&nor).settings;
    nor.preload(at as usize, &bytes);
    Shared::new(nor)
}

fn power_up(flash: &Shared, factory_pin: bool) -> Rig {
    let mut rig = flash::power_up(flash, BOARD_IP, factory_pin);
    // A tag is eight runs over 64 bytes at the most, and an acquisition makes two.
    rig.patience *= 8;
    rig
}

/// One datagram with these records from this port; the words read, if it was answered.
fn ask(rig: &mut Rig, port: u16, writes: &[(u32, &[u32])], reads: &[u32]) -> Option<Vec<u32>> {
    let mut words = [0; MAX_WORDS];
    let mut request = Request::new(&mut words);
    for (base, words) in writes {
        request = request.write(*base, words);
    }
    let request = request.read(7, reads).words().expect("room");
    send(rig, port, &to_bytes(request))
}

/// Sends four milliseconds after the datagram before: while a host owns the session one frame of
/// others comes in with each housekeeping, every three milliseconds if nothing is exchanged.
fn send(rig: &mut Rig, port: u16, datagram: &[u8]) -> Option<Vec<u32>> {
    rig.run_ms(PAUSE_MS);
    let reply = rig.request((HOST_IP, port), wire::DEFAULT_PORT, datagram)?;
    Some(to_words(&reply.payload).into_iter().skip(4).collect())
}

fn challenge(rig: &mut Rig, port: u16) -> [u32; 4] {
    let addresses = [0, 4, 8, 12].map(|at| map::SESSION_CHALLENGE + at);
    let words = ask(rig, port, &[], &addresses).expect("reads are answered");
    words.try_into().expect("four words")
}

/// A whole acquisition with this answer, as it goes over the wire.
fn acquisition(answer: [u32; 4], nonce: u32) -> Vec<u8> {
    let mut words = [0; MAX_WORDS];
    let request = Request::new(&mut words)
        .write(map::SESSION_RESPONSE, &answer)
        .write(map::SESSION_ACQUIRE, &[nonce])
        .read(7, &[map::SESSION_TOKEN]);
    to_bytes(request.words().expect("room"))
}

fn owner(rig: &mut Rig) -> u32 {
    ask(rig, MALLORY, &[], &[map::SESSION_OWNER_PORT]).expect("every host may read")[0]
}

fn features(rig: &mut Rig) -> u32 {
    let word = describe::address(describe::FEATURES_AT);
    ask(rig, MALLORY, &[], &[word]).expect("every host may read")[0]
}

fn refused(rig: &mut Rig) -> u32 {
    let counter = map::COUNTERS_REFUSED + 4 * Refusal::Key.index() as u32;
    ask(rig, MALLORY, &[], &[counter]).expect("every host may read")[0]
}

#[test]
fn a_board_with_a_key_refuses_a_client_without_it_takes_one_with_it_and_refuses_the_replay() {
    let flash = locked_flash();
    let mut rig = power_up(&flash, false);
    assert_eq!(features(&mut rig) & FEATURE_KEY, FEATURE_KEY);

    // Without the key, and with another.
    let nothing = ask(
        &mut rig,
        MALLORY,
        &[(map::SESSION_ACQUIRE, &[7])],
        &[map::SESSION_TOKEN],
    );
    assert_eq!(nothing, None);
    let asked = challenge(&mut rig, MALLORY);
    let wrong = acquisition(wrong_key().acquire(asked, 7), 7);
    assert_eq!(send(&mut rig, MALLORY, &wrong), None);
    let forget: (u32, &[u32]) = (map::FLASH_OP, &[Op::ForgetSettings.code()]);
    assert_eq!(ask(&mut rig, MALLORY, &[forget], &[map::FLASH_OP]), None);
    let restart: (u32, &[u32]) = (map::SESSION_REBOOT, &[map::REBOOT_KEY]);
    assert_eq!(ask(&mut rig, MALLORY, &[restart], &[map::FLASH_OP]), None);
    assert_eq!((owner(&mut rig), refused(&mut rig)), (0, 4));

    // With the key. The cost of a challenge is printed in clocks: no exchange waits longer than
    // that for a stranger.
    let began = rig.clock();
    let asked = challenge(&mut rig, ALICE);
    println!(
        "a challenge came {} clocks after the question was posted",
        rig.clock() - began - PAUSE_MS * 60_000
    );
    let right = acquisition(key().acquire(asked, 7), 7);
    let began = rig.clock();
    let token = send(&mut rig, ALICE, &right).expect("the right answer")[0];
    println!(
        "a session came {} clocks after the answer was posted",
        rig.clock() - began - PAUSE_MS * 60_000
    );
    assert_ne!(token, 0);
    assert_eq!(owner(&mut rig), u32::from(ALICE));

    // The same datagram again: while it holds, after it is given back, from elsewhere, after the
    // power was off.
    assert_eq!(send(&mut rig, ALICE, &right), None, "while she owns it");
    assert_eq!(
        challenge(&mut rig, MALLORY),
        wire::auth::NONE,
        "a host owns the session"
    );
    let release: (u32, &[u32]) = (map::SESSION_RELEASE, &[token]);
    ask(&mut rig, ALICE, &[release], &[map::SESSION_TOKEN]).expect("given back");
    let before = refused(&mut rig);
    for port in [ALICE, MALLORY] {
        assert_eq!(send(&mut rig, port, &right), None);
        assert_ne!(challenge(&mut rig, port), asked);
        assert_eq!(
            send(&mut rig, port, &right),
            None,
            "with a challenge in force"
        );
    }
    assert_eq!((owner(&mut rig), refused(&mut rig)), (0, before + 4));
    let mut rig = power_up(&flash, false);
    assert_ne!(challenge(&mut rig, ALICE), asked);
    assert_eq!(send(&mut rig, ALICE, &right), None);
    assert_eq!(owner(&mut rig), 0);
}

/// What the board broadcasts to this message.
fn discover(rig: &mut Rig, message: &Message) -> Option<Body> {
    let mut buffer = [0; WORDS_MAX];
    let request = to_bytes(message.emit(&mut buffer));
    rig.take_datagrams();
    rig.broadcast((HOST_IP, ALICE), DISCOVERY_PORT, &request);
    for _ in 0..100 {
        rig.run_ms(1);
        for (datagram, _) in rig.take_datagrams() {
            if datagram.to == (Ipv4Addr::BROADCAST, ALICE) {
                let words = to_words(&datagram.payload);
                return Message::parse(&words).ok().map(|answer| answer.body);
            }
        }
    }
    None
}

#[test]
fn discovery_and_console_ask_for_the_key_too_and_the_factory_pin_opens_the_board() {
    let flash = locked_flash_with_services();
    let mut rig = power_up(&flash, false);
    wait_for_services(&mut rig);
    let settings = Settings {
        prefix: 16,
        keep_key: true,
        ..Settings::default()
    };
    let message = |body| Message {
        nonce: 99,
        uid: UID,
        body,
    };
    let proven = |key: &Key, challenge| {
        let unsigned = message(Body::Proven(settings, wire::auth::NONE));
        let mut words = [0; WORDS_MAX];
        let (signed, _) = proof(unsigned.emit(&mut words)).expect("a Proven");
        message(Body::Proven(settings, key.set(challenge, signed)))
    };
    let said = discover(&mut rig, &message(Body::Set(settings)));
    let Some(Body::Prove(challenge)) = said else {
        panic!("{said:?}");
    };
    let said = discover(&mut rig, &proven(&wrong_key(), challenge));
    assert_eq!(
        said,
        Some(Body::Prove(challenge)),
        "guessing uses up nothing"
    );
    assert_eq!(flash.chip().programs(), 0);

    let console = rig.tcp_connect(CONSOLE_PORT).expect("a console");
    assert!(rig.tcp_say(console, "").ends_with("> "), "no greeting");
    let said = rig.tcp_say(console, "restart\r\n");
    assert!(said.contains("refused: the board has a key"), "{said}");
    let said = rig.tcp_say(console, "status\r\n");
    assert!(said.contains("disarmed"), "looking is free: {said}");
    let said = rig.tcp_say(console, "login\r\n");
    let digits = said.split("challenge ").nth(1).expect("a challenge");
    let words: Vec<u32> = (0..6)
        .map(|n| u32::from_str_radix(&digits[8 * n..][..8], 16).expect("hex digits"))
        .collect();
    assert_eq!(words[4..], UID);
    let answer = |key: Key| key.login([words[0], words[1], words[2], words[3]]);
    let login = |answer: [u32; 4]| {
        format!(
            "login {}\r\n",
            answer.map(|word| format!("{word:08x}")).concat()
        )
    };
    let said = rig.tcp_say(console, &login(answer(wrong_key())));
    assert!(said.contains("refused: wrong answer"), "{said}");
    let said = rig.tcp_say(console, &login(answer(key())));
    assert!(said.contains("welcome"), "{said}");

    // The console's right answer made the challenges before it worthless.
    let said = discover(&mut rig, &proven(&key(), challenge));
    let Some(Body::Prove(challenge)) = said else {
        panic!("{said:?}");
    };
    let said = discover(&mut rig, &proven(&key(), challenge));
    assert_eq!(said, Some(Body::Done(OpResult::Ok)));

    // With the factory pin held no client needs a key.
    let mut rig = power_up(&flash, true);
    assert_eq!(features(&mut rig) & FEATURE_KEY, 0);
    let token = ask(
        &mut rig,
        MALLORY,
        &[(map::SESSION_ACQUIRE, &[7])],
        &[map::SESSION_TOKEN],
    );
    assert!(token.is_some_and(|token| token[0] != 0));
}
