//! The protocol: which datagrams are valid, and that emitting what was parsed gives the same
//! datagram.

use crate::byte_reader::{ByteReader, bytes, words};
use crate::watched::Watched;
use firmware::machine::{Lease, Machine, VISIT_WORDS, Verb, Verdict};
use firmware::net::Us;
use firmware::services::Network;
use sim::model_board::UID;
use sim::nor::spi::Shared;
use sim::nor::{Nor, Part, Times};
use std::net::Ipv4Addr;
use wire::describe::Channels;
use wire::discovery::{Body, Message, WORDS_MAX};
use wire::etherbone::{HEADER_WORDS, Packet, ReplyWriter};
use wire::exchange::{
    Command, REQUEST_OVERHEAD, Status, command_words, judge_sequence, status_words,
};
use wire::settings::{self, Settings};
use wire::{MAX_PAYLOAD, MAX_WORDS, Name};

/// A UDP payload: a packet with records that are the whole datagram, or a refusal.
pub fn etherbone(data: &[u8]) {
    let mut buffer = [0; MAX_WORDS];
    let Ok(words) = wire::words_from_bytes(data, &mut buffer) else {
        assert!(
            data.len() > MAX_PAYLOAD || !data.len().is_multiple_of(4),
            "{} bytes are a datagram's and were refused as such",
            data.len()
        );
        return;
    };
    let mut back = [0; MAX_PAYLOAD];
    let length = wire::words_to_bytes(words, &mut back);
    assert_eq!(&back[..length], data, "words are the bytes they came from");
    let Ok(packet) = Packet::new_checked(words) else {
        return;
    };
    if packet.is_probe() {
        assert_eq!(packet.records().count(), 0, "a probe has no records");
        assert_eq!(packet.body(), &words[HEADER_WORDS..]);
        return;
    }
    // Written again, the records are the datagram; answered, they fit a frame.
    let (mut request, mut reply) = ([0; MAX_WORDS], [0; MAX_WORDS]);
    let mut request = ReplyWriter::new(&mut request, words[0]);
    let mut reply = ReplyWriter::new(&mut reply, wire::etherbone::HEADER);
    let (mut flags, mut at) = (Vec::new(), HEADER_WORDS);
    for record in packet.records() {
        let (writes, reads) = (record.writes.len(), record.reads.len());
        assert!(writes + reads > 0, "a record of nothing");
        flags.push(words[at] & 0xff00_0000);
        at += 1 + (writes + usize::from(writes > 0)) + (reads + usize::from(reads > 0));
        let head = wire::etherbone::BYTE_ENABLE | (writes as u32) << 8 | reads as u32;
        let mut fits = request.push(head | flags[flags.len() - 1]);
        if writes > 0 {
            fits &= request.push(record.write_base) && request.extend(record.writes);
        }
        if reads > 0 {
            fits &= request.push(record.return_base) && request.extend(record.reads);
            fits &= reply.write_record(record.return_base, reads as u8);
            fits &= reply.extend(record.reads);
        }
        assert!(
            fits,
            "a checked packet, or its answer, is longer than a frame"
        );
    }
    assert!(!flags.is_empty(), "a packet of no records");
    assert_eq!(request.words()[HEADER_WORDS..], words[HEADER_WORDS..]);
    if reply.words().len() > HEADER_WORDS {
        let answer = Packet::new_checked(reply.words());
        assert!(answer.is_ok(), "the answer is no packet: {answer:?}");
    }
}

fn channels(input: &mut ByteReader) -> Channels {
    let [stepgens, encoders, pwms, inputs, outputs] = input.array();
    Channels {
        stepgens: stepgens % 17,
        encoders: encoders % 17,
        pwms: pwms % 17,
        inputs: inputs % 33,
        outputs: outputs % 33,
    }
}

/// Command and status blocks of any board: read, written and read again they are the same.
pub fn exchange(data: &[u8]) {
    let mut input = ByteReader(data);
    let channels = channels(&mut input);
    let mode = input.byte();
    let (last, sequence) = (input.word(), input.word());
    let forth = judge_sequence(sequence, last).is_ok();
    let back = judge_sequence(last, sequence).is_ok();
    assert!(
        !(forth && back),
        "{sequence:#x} and {last:#x} are each ahead"
    );
    let mut block = words(input.0);
    if mode & 1 != 0 {
        block.resize(command_words(channels), 0);
    }
    if mode & 2 != 0 {
        block.resize(status_words(channels), 0);
    }
    match Command::parse(&block, channels) {
        Ok(command) => {
            assert_eq!(block.len(), command_words(channels));
            let mut buffer = [0; REQUEST_OVERHEAD + wire::exchange::COMMAND_MAX];
            let request = command.emit_request(channels, &mut buffer);
            let request = request.expect("the longest command fits");
            let packet = Packet::new_checked(request).expect("a request is a packet");
            let record = packet.records().next().expect("a record");
            let again = Command::parse(record.writes, channels);
            assert_eq!(again, Ok(command));
        }
        Err(_) => assert_ne!(block.len(), command_words(channels)),
    }
    if let Ok(status) = Status::parse(&block, channels) {
        assert_eq!(block.len(), status_words(channels));
        let mut buffer = [0; MAX_WORDS];
        let again = status.emit(channels, &mut buffer).expect("it fits");
        assert_eq!(Status::parse(again, channels), Ok(status));
    }
    if let Ok(status) = Status::parse_reply(&block, channels) {
        assert_eq!(status.sequence, block[3], "the answer to another command");
    }
}

/// Datagrams of discovery, and the settings in them: both ends agree on what is valid.
pub fn discovery(data: &[u8]) {
    let mut input = ByteReader(data);
    let mode = input.byte();
    let mut message = words(input.0);
    if mode & 1 != 0 {
        seal(message.get_mut(wire::discovery::HEAD..).unwrap_or(&mut []));
    }
    let parsed = Message::parse(&message);
    let question = Message::parse_request(&message);
    if let Ok(question) = &question {
        // A board reads a Proven as a Set, and its proof separately.
        let plain = parsed.map(|message| match message.body {
            Body::Proven(settings, _) => Message {
                body: Body::Set(settings),
                ..message
            },
            _ => message,
        });
        assert_eq!(
            plain.as_ref(),
            Ok(question),
            "a question to one, not to all"
        );
    }
    let Ok(understood) = parsed else {
        return;
    };
    let mut buffer = [0; WORDS_MAX];
    let again = Message::parse(understood.emit(&mut buffer));
    assert_eq!(again, Ok(understood));
    match understood.body {
        Body::Discover | Body::Done(_) | Body::Prove(_) => {}
        Body::Here(here) => {
            let found = host::discovery::Found {
                uid: understood.uid,
                here,
            };
            let text = host::uid::uid_text(found.uid);
            assert_eq!(host::uid::uid_parse(&text), Some(found.uid), "{text}");
            found.socket();
            change(&mut input, &host::provision::settings_of(&found));
        }
        Body::Set(settings) | Body::Proven(settings, _) => {
            assert_eq!(
                settings.check(),
                Ok(()),
                "parsed, but not valid for a board"
            );
            let again = Settings::parse(&settings.to_words());
            assert_eq!(again, Ok(settings));
            assert_eq!(settings.blanked().key, [0; 4], "the key is never sent");
            change(&mut input, &settings);
        }
    }
}

/// Corrects the check sum of settings.
fn seal(message: &mut [u32]) {
    if let Some([body @ .., crc]) = message.first_chunk_mut::<{ settings::WORDS }>() {
        *crc = wire::crc::crc32_words(body);
    }
}

/// A user's change gives a board's settings or a refusal.
fn change(input: &mut ByteReader, settings: &Settings) {
    let which = input.byte();
    let (ip, prefix, gateway, port) = (input.word(), input.byte(), input.word(), input.half());
    let given = |bit: u8| which >> bit & 1 != 0;
    let change = host::provision::Change {
        ip: given(0).then_some((Ipv4Addr::from(ip), given(1).then_some(prefix))),
        gateway: given(2).then_some(gateway.into()),
        dhcp: given(3).then_some(given(4)),
        name: given(5).then_some(Name::cut(&String::from_utf8_lossy(input.some()))),
        mac: given(6).then_some(input.array()),
        port: given(7).then_some(port),
        // Bits 0 and 2 mean an address each already; servers come with them.
        syslog: given(0).then_some(gateway.into()),
        sntp: given(2).then_some(ip.into()),
    };
    if let Ok(changed) = change.apply(settings) {
        assert_eq!(Settings::parse(&changed.to_words()), Ok(changed));
    }
}

/// A board that asks for an address, and the frames its client sends.
struct Cable {
    machine: Machine<Watched>,
    sent: Vec<Vec<u8>>,
}

impl Cable {
    fn new() -> Self {
        let settings = Settings {
            dhcp: true,
            ..Settings::BUILT_IN
        };
        let mut nor = Nor::new(Part::W25Q16JV.with(Times::QUICK), UID);
        let layout = wire::flash::Layout::of(nor.part().bytes as u32).expect("a known size");
        nor.preload(
            layout.settings_copy(0) as usize,
            &bytes(&settings.to_words()),
        );
        Cable {
            machine: crate::watched::start_on(Shared::new(nor)),
            sent: Vec::new(),
        }
    }
}

impl jobs::Outside for Cable {
    fn datagram(&mut self, request: &[u32], reply: &mut [u32; MAX_WORDS]) -> usize {
        let answer = self.machine.inside(request, reply, Machine::hold_path);
        answer.map_or(0, <[u32]>::len)
    }
    fn read_segments(&mut self, _: usize) -> u32 {
        0
    }
    fn write_segments(&mut self, _: usize, _: u32) {}
    fn now(&mut self) -> u64 {
        0
    }
}

impl Network for Cable {
    fn send_frame(&mut self, frame: &[u8]) {
        self.sent.push(frame.to_vec());
    }
    fn us(&mut self) -> Us {
        self.machine.us
    }
    fn leased(&mut self, lease: Option<Lease>) {
        self.machine.leased(lease);
    }
    fn console(&mut self, _: usize, _: Verb, _: &mut [u32; VISIT_WORDS]) -> Verdict {
        Verdict::NotNow
    }
}

/// A malicious DHCP server: its lease is an address a host can have, or there is none.
pub fn dhcp(data: &[u8]) {
    use firmware::services::lease::{Client, Place};
    use firmware::services::stack::Stack;
    use sim::lease::{framed, payload};
    use smoltcp::time::Instant;
    let mut input = ByteReader(data);
    let mut board = Cable::new();
    let mut place = Place::new();
    let mut client = Client::new(&mut place, &Name::cut("board"));
    let mut stack = Stack::new(input.word().into(), &mut board);
    let mut ms = 0i64;
    let mut asked = Vec::new();
    while !input.is_over() {
        let step = input.byte();
        match step & 3 {
            0 => ms += i64::from(input.word() >> (step >> 3)),
            1 => {
                let frame = framed(input.many());
                client.take(&frame, &mut stack, Instant::from_millis(ms), &mut board);
            }
            // Answers to what was asked, with any address and options.
            _ => {
                let mut offered = vec![0; 240];
                offered[..4].copy_from_slice(&[2, 1, 6, 0]);
                offered[4..8].copy_from_slice(asked.get(4..8).unwrap_or(&[0; 4]));
                offered[16..20].copy_from_slice(&input.word().to_be_bytes());
                offered[28..34].copy_from_slice(&board.machine.us.mac);
                offered[236..240].copy_from_slice(&[0x63, 0x82, 0x53, 0x63]);
                offered.extend([53, 1, step >> 2]);
                offered.extend(input.some());
                let frame = framed(&offered);
                client.take(&frame, &mut stack, Instant::from_millis(ms), &mut board);
            }
        }
        for _ in 0..4 {
            let us = board.us();
            stack.settle(us);
            client.turn(&mut stack, Instant::from_millis(ms), &mut board);
        }
        for frame in board.sent.drain(..) {
            if let Some(bytes) = payload(&frame) {
                asked = bytes;
            }
        }
        let (ip, (prefix, _)) = (board.machine.us.ip, board.machine.net);
        assert!(
            ip == 0 || wire::settings::unicast(ip),
            "{} is no host's address",
            Ipv4Addr::from(ip)
        );
        assert!(prefix <= 32, "a netmask of {prefix} bits");
    }
}
