//! Scripts of [`crate::frames`]: datagrams, whole and damaged, TCP of the console, and the rest of
//! Ethernet.

use super::{Seed, message};
use crate::byte_reader::bytes;
use firmware::net::{Datagram, Slot, Us, emit_headers, emit_payload};
use wire::discovery::Body;
use wire::{etherbone, map};

type Step = Vec<u8>;

pub(super) fn frames_seeds() -> Vec<Seed> {
    [datagrams(), fast_path(), moving(), console(), others()].concat()
}

fn script<const N: usize>(name: &'static str, steps: [Step; N]) -> Seed {
    ("frames", name, steps.concat())
}

#[derive(Default)]
struct Bytes(Vec<u32>);

impl Slot for Bytes {
    fn put(&mut self, index: usize, word: u32) {
        self.0.resize(self.0.len().max(index + 1), 0);
        self.0[index] = word;
    }
}

/// A raw frame of `frames`: from another board, addressed to ours.
fn frame(payload: &[u32]) -> Vec<u8> {
    let us = Us {
        mac: [2, 3, 4, 5, 6, 7],
        ip: 0xc0a8_0201,
        port: 40_000,
    };
    let to = Datagram {
        peer: firmware::session::Peer {
            ip: 0xc0a8_0232,
            port: 1234,
        },
        mac: (0x10e2, 0xd500_0001),
        length: 0,
        options: 0,
        service: 0,
        ttl: 64,
    };
    let mut slot = Bytes::default();
    emit_headers(&mut slot, &us, &to, 4 * payload.len());
    let length = emit_payload(&mut slot, payload);
    let frame: Vec<u8> = bytes(&slot.0)[2..][..length].to_vec();
    [&[0][..], &(length as u16).to_be_bytes(), &frame].concat()
}

/// A datagram to the board; `odd` says what is wrong with its headers.
fn udp(step: u8, odd: u8, raw: &[u8]) -> Step {
    [&[step, odd][..], &(raw.len() as u16).to_be_bytes(), raw].concat()
}

fn later(step: u8) -> Step {
    vec![7 | step << 3]
}

fn datagrams() -> Vec<Seed> {
    let words = [etherbone::HEADER, 0, 0x000f_0001, 7, 0];
    let read = |odd: u8| udp(1, odd, &bytes(&words));
    vec![
        script("raw_read", [frame(&words)]),
        script("read_with_options", [read(1), vec![3]]),
        script("fragment", [read(2), vec![0x20, 0]]),
        script("total_length_off", [read(4), vec![1]]),
        script("cut_short", [read(0x40), vec![0, 43]]),
        script("one_byte_wrong", [read(0xa0), vec![0, 50, 1]]),
        script(
            "discovery_to_all",
            [udp(1 | 1 << 3, 8, &message(Body::Discover))],
        ),
    ]
}

/// Exchanges; the gateware executes one that is like the one before.
fn fast_path() -> Vec<Seed> {
    let acquire = [etherbone::HEADER, 0, 0x000f_0100, map::SESSION_ACQUIRE, 7];
    let acquire = udp(1, 0x80, &bytes(&acquire));
    let exchange = |flags: u8| vec![2, 0, flags];
    vec![
        script(
            "on_the_fast_path",
            [
                acquire.clone(),
                exchange(0),
                exchange(1),
                exchange(1),
                exchange(3),
                exchange(3),
                exchange(3),
                later(4),
                exchange(0x43),
            ],
        ),
        script(
            "the_fast_path_and_damage",
            [
                acquire,
                exchange(1),
                exchange(1),
                vec![2, 0xa0, 1, 0, 90, 1],
                exchange(1),
            ],
        ),
    ]
}

/// The owner moves the machine; guests come to every port meanwhile.
fn moving() -> Vec<Seed> {
    let acquire = [etherbone::HEADER, 0, 0x000f_0100, map::SESSION_ACQUIRE, 7];
    let exchange = |flags: u8| vec![2, 0, flags];
    let mut moves = vec![udp(1, 0x80, &bytes(&acquire))];
    moves.extend([1, 1, 3, 3, 3, 7, 7].map(exchange));
    let moves = moves.concat();
    let goes_on = exchange(7 | 2 << 3);
    let syn = |step: u8| vec![step, 0, 2, 0, 255, 0];
    let name =
        b"\x00\x00\x00\x00\x00\x01\x00\x00\x00\x00\x00\x00\x04fuzz\x05local\x00\x00\x01\x00\x01";
    let time = [0x24; 48];
    vec![
        script(
            "moving_among_guests",
            [
                moves.clone(),
                vec![6, 0],
                vec![5 | 1 << 6, 0, 0, 8, 0, 7, 0, 1, 1, 2, 3, 4],
                goes_on.clone(),
                syn(4),
                syn(4 | 1 << 6),
                goes_on.clone(),
                udp(1 | 2 << 3, 0, &[1; 300]),
                goes_on.clone(),
            ],
        ),
        script(
            "moving_and_a_long_frame",
            [
                moves,
                udp(1 | 4 << 3, 0, &[0; 200]),
                [&[5, 0, 0, 204][..], &[8; 204]].concat(),
                goes_on,
            ],
        ),
        script("a_page_is_asked_for", {
            let get = b"GET / HTTP/1.0\r\n\r\n";
            let says = [&[4 | 1 << 6, 0, 24, 0, 255, get.len() as u8][..], get];
            [
                syn(4 | 1 << 6),
                vec![4 | 1 << 6, 0, 16, 0, 255, 0],
                says.concat(),
                later(4),
            ]
        }),
        script(
            "a_name_is_asked_for",
            [
                later(10),
                later(10),
                udp(0x80 | 1 | 4 << 3, 0, name),
                later(6),
            ],
        ),
        script(
            "the_time_is_told",
            [later(10), udp(1 | 5 << 3, 0, &time), later(4)],
        ),
    ]
}

fn console() -> Vec<Seed> {
    let tcp =
        |flags: u8, text: &[u8]| [&[3, 0, flags, 0, 255, text.len() as u8][..], text].concat();
    let opened = [tcp(2, b""), tcp(16, b"")].concat();
    vec![
        script(
            "console_says_hello",
            [
                opened.clone(),
                tcp(24, b"status\n"),
                tcp(16, b""),
                later(6),
                tcp(17, b""),
            ],
        ),
        script(
            "console_says_quit",
            [opened.clone(), tcp(24, b"quit\n"), tcp(17, b""), later(9)],
        ),
        script(
            "console_dies",
            [
                opened.clone(),
                tcp(24, b"net\n"),
                later(9),
                later(10),
                later(11),
                later(12),
            ],
        ),
        script("console_is_reset", [opened, tcp(4, b"")]),
        script("a_segment_for_a_closed_port", [tcp(16, b"x")]),
    ]
}

fn others() -> Vec<Seed> {
    vec![
        script("ping", [vec![5 | 1 << 6, 0, 0, 8, 0, 7, 0, 1, 1, 2, 3, 4]]),
        script("arp_request", [vec![6, 0]]),
        script("runt", [vec![0, 0, 3, 1, 2, 3]]),
    ]
}
