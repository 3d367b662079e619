//! A host reads a description with any errors: words, names, pins in HAL.

use crate::byte_reader::ByteReader;
use host::address::Address;
use host::client::Identity;
use host::driver::Driver;
use host::hal::fake::FakeHal;
use host::link::Link;
use host::names::{self, Scheme};
use std::collections::BTreeSet;
use std::net::{Ipv4Addr, SocketAddrV4, UdpSocket};
use wire::board::{Blob, HAL_NAME_LEN, HAL_NAME_MAX, HEADER_LEN, Kind};
use wire::describe::{self, Channels, Describe, WORDS};
use wire::exchange::{command_words, status_words};

/// The words of a description, and the names after them.
pub fn describe(data: &[u8]) {
    let mut input = ByteReader(data);
    let mode = input.byte();
    let mut words: [u32; WORDS] = std::array::from_fn(|_| input.word());
    if mode & 1 != 0 {
        fitting(&mut words);
    }
    let mut blob = input.0.to_vec();
    if mode & 2 != 0 {
        seal(&mut blob);
    }
    names(&blob);
    let description = match Describe::parse(&words) {
        Ok(description) => description,
        Err(why) => {
            assert!(!why.to_string().is_empty());
            return;
        }
    };
    let again = Describe::parse(&description.to_words());
    assert_eq!(again, Ok(description));
    if let Ok(identity) = Identity::new(description, blob) {
        load(&identity, mode >> 2);
    }
}

/// Makes the words consistent, whatever their values.
fn fitting(words: &mut [u32; WORDS]) {
    words[0] = wire::describe::MAGIC;
    words[1] = wire::WIRE_VERSION;
    words[6] = words[6].max(1);
    let [s, e, p, i, o] = [
        words[7],
        words[7] >> 8,
        words[7] >> 16,
        words[8],
        words[8] >> 8,
    ];
    let most = |count: u32, most: u32| count as u8 % (most as u8 + 1);
    let channels = Channels {
        stepgens: most(s, 16),
        encoders: most(e, 16),
        pwms: most(p, 16),
        inputs: most(i, 32),
        outputs: most(o, 32),
    };
    [words[7], words[8]] = channels.to_words();
    words[describe::COMMAND_WORDS_AT] = command_words(channels) as u32;
    words[describe::STATUS_WORDS_AT] = status_words(channels) as u32;
    words[describe::BLOB_WORDS_AT] %= 512;
    words[describe::STATE_AT] &= 0xffff_0103;
    words[describe::RESET_REASON_AT] %= 4;
    words[describe::GATE_CLOSE_AT] %= 4;
}

/// Adds a header that fits the bytes after it.
fn seal(blob: &mut Vec<u8>) {
    blob.resize(blob.len().max(HEADER_LEN), 0);
    let crc = wire::board::crc32(&blob[HEADER_LEN..]);
    let head = [
        wire::board::MAGIC,
        wire::board::VERSION,
        blob.len() as u32,
        crc,
    ];
    blob[..HEADER_LEN].copy_from_slice(&crate::byte_reader::bytes(&head));
}

fn names(bytes: &[u8]) {
    let Ok(blob) = Blob::new_checked(bytes) else {
        return;
    };
    assert!(
        blob.entries().count() <= bytes.len(),
        "more names than bytes"
    );
    for entry in blob.entries() {
        assert!(entry.value.len() <= 255);
        if let Some(text) = blob.text(entry.kind, entry.channel) {
            assert!(text.len() <= 255);
        }
    }
    assert!(blob.facts().count() <= bytes.len() / 4);
}

thread_local! {
    /// A socket that sends nothing, because the driver needs one.
    static SOCKET: UdpSocket = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).expect("a socket");
}

/// Loads a driver for it, with different schemes of names.
fn load(identity: &Identity, scheme: u8) {
    let socket = SOCKET.with(UdpSocket::try_clone).expect("a socket");
    let link = Link::new(socket).expect("a socket that does not block");
    let mut hal = FakeHal::new();
    let say = hal.messenger();
    let address = Address {
        text: "board".to_owned(),
        socket: SocketAddrV4::new(Ipv4Addr::LOCALHOST, 1234),
    };
    let driver = Driver::export(&mut hal, 0, address, identity, link, say);
    let driver = driver.unwrap_or_else(|error| panic!("{error}"));
    let scheme = match scheme & 7 {
        0 => None,
        1 => Some(Scheme::Lcnc),
        2 => Some(Scheme::LitexCnc(Vec::new())),
        3 => Some(Scheme::LitexCncNamed(vec!["mill".to_owned()])),
        _ => Some(Scheme::LitexCnc(vec!["mill".to_owned()])),
    };
    if let Some(scheme) = &scheme {
        scheme.prefix(0, identity);
        // A scheme may refuse a board; the driver continues without it or says why.
        if let Err(error) = names::export(scheme, &mut hal, 0, identity, &driver) {
            assert!(!error.to_string().is_empty());
        }
    }
    let mut seen = BTreeSet::new();
    let all = hal.list().chain(hal.aliases());
    for (name, _, _) in all {
        let most = match name.starts_with("ferrocnc.0.") {
            true => HAL_NAME_MAX,
            false => HAL_NAME_LEN,
        };
        assert!(name.len() <= most, "{name} is too long for HAL");
        assert!(
            name.bytes().all(|b| b.is_ascii_graphic()),
            "{name:?} is not a valid name in HAL"
        );
        assert!(seen.insert(name), "{name} appears twice");
    }
    for channel in 0..16 {
        identity.step_type(channel);
        identity.pwm_type(channel);
    }
    let _ = identity.blob().text(Kind::Platform, 0);
}
