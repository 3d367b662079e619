use super::*;
use proptest::prelude::*;
use std::vec::Vec;

#[derive(Default)]
struct Bytes(Vec<u8>);

impl Sink for Bytes {
    fn put(&mut self, text: &[u8]) {
        self.0.extend_from_slice(text);
    }
}

/// Data and answers.
fn say(telnet: &mut Telnet, bytes: &[u8]) -> (Vec<u8>, Vec<u8>) {
    let mut out = Bytes::default();
    let data = { bytes.iter() }
        .filter_map(|byte| telnet.push(*byte, &mut out))
        .collect();
    (data, out.0)
}

const OFFER: [u8; 6] = [IAC, WILL, ECHO, IAC, WILL, SUPPRESS_GO_AHEAD];

#[test]
fn a_client_that_does_not_negotiate_hears_nothing() {
    let mut telnet = Telnet::new();
    let (data, answers) = say(&mut telnet, b"status\r\n\x1b[A\x00\xfe");
    assert_eq!(data, b"status\r\n\x1b[A\x00\xfe");
    assert!(answers.is_empty() && !telnet.echoes());
}

#[test]
fn the_first_request_is_answered_with_an_offer_of_an_echo() {
    let mut telnet = Telnet::new();
    // What a telnet program begins with: go-ahead, terminal type, window, speed, flow, line mode,
    // environment, status.
    let first = [
        [IAC, DO, 3],
        [IAC, WILL, 24],
        [IAC, WILL, 31],
        [IAC, WILL, 32],
        [IAC, WILL, 33],
        [IAC, WILL, 34],
        [IAC, WILL, 39],
        [IAC, DO, 5],
    ]
    .concat();
    let (data, answers) = say(&mut telnet, &first);
    let refused = [
        [IAC, DONT, 24],
        [IAC, DONT, 31],
        [IAC, DONT, 32],
        [IAC, DONT, 33],
        [IAC, DONT, 34],
        [IAC, DONT, 39],
        [IAC, WONT, 5],
    ]
    .concat();
    assert_eq!(answers, [&OFFER[..], &refused].concat());
    assert!(data.is_empty() && !telnet.echoes());
    let (_, answers) = say(&mut telnet, &[IAC, DO, ECHO]);
    assert!(answers.is_empty() && telnet.echoes());
}

#[test]
fn a_client_that_wants_no_echo_has_none_and_may_change_its_mind() {
    let mut telnet = Telnet::new();
    say(&mut telnet, &[IAC, DO, SUPPRESS_GO_AHEAD]);
    assert!(say(&mut telnet, &[IAC, DONT, ECHO]).1.is_empty());
    assert!(!telnet.echoes());
    assert_eq!(say(&mut telnet, &[IAC, DO, ECHO]).1, [IAC, WILL, ECHO]);
    assert!(telnet.echoes());
    assert_eq!(say(&mut telnet, &[IAC, DONT, ECHO]).1, [IAC, WONT, ECHO]);
    assert!(!telnet.echoes());
}

#[test]
fn what_is_already_so_is_not_answered() {
    let mut telnet = Telnet::new();
    let (_, first) = say(&mut telnet, &[IAC, WILL, 3]);
    assert_eq!(first, [&OFFER[..], &[IAC, DO, 3]].concat());
    for _ in 0..3 {
        let again = [
            IAC, WILL, 3, IAC, DO, 3, IAC, DO, 1, IAC, WONT, 24, IAC, DONT, 5,
        ];
        assert!(say(&mut telnet, &again).1.is_empty());
    }
}

#[test]
fn parameters_are_skipped_and_commands_are_keys() {
    let mut telnet = Telnet::new();
    let said = [
        &[b'a', IAC, SB, 31, 0, IAC, IAC, 80, 0, 24, IAC, SE, b'b'][..],
        &[IAC, IAC, IAC, 247, IAC, 248, IAC, 244, IAC, 241, b'c'],
    ]
    .concat();
    let (data, answers) = say(&mut telnet, &said);
    assert_eq!(data, [b'a', b'b', 255, 0x7f, 0x15, 3, b'c']);
    assert!(answers.is_empty());
}

proptest! {
    /// Two boards that are connected with each other stop talking.
    #[test]
    fn a_negotiation_ends(first in prop::collection::vec(any::<u8>(), 0..40)) {
        let (mut a, mut b) = (Telnet::new(), Telnet::new());
        let mut wire = first;
        let mut rounds = 0;
        while !wire.is_empty() {
            // Data is not sent back: only answers are.
            wire = say(&mut a, &wire).1;
            wire = say(&mut b, &wire).1;
            rounds += 1;
            prop_assert!(rounds < 6, "{wire:?}");
        }
    }

    /// No more than one answer to each request, and the offer.
    #[test]
    fn there_are_no_more_answers_than_requests(
        requests in prop::collection::vec((WILL..=DONT, any::<u8>()), 0..60)
    ) {
        let mut telnet = Telnet::new();
        let said: Vec<u8> = { requests.iter() }
            .flat_map(|(verb, option)| [IAC, *verb, *option])
            .collect();
        let (data, answers) = say(&mut telnet, &said);
        prop_assert!(data.is_empty());
        prop_assert!(answers.len() <= OFFER.len() + 3 * requests.len());
    }
}
