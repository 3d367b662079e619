//! A board on a wire with faulty neighbours: whole Ethernet frames, as `firmware::app` handles
//! them.
//!
//! The input is a script of frames: raw ones, and ones with corrected check sums, which a fuzzer
//! does not guess. The board's frames are checked as a neighbour's stack would: lengths, check
//! sums, addresses. Frames that are not a datagram of ours do not change the board. A frame that
//! the fast path takes as an exchange is an exchange for the full check, too.

use crate::byte_reader::ByteReader;
use crate::server::Bench;
use crate::watched::Inside;
use firmware::block::Request;
use firmware::exchange::{FRAME_FLAGS, SlotReply};
use firmware::net::{self, Class, Datagram, FastPath, Frame, HEADERS, PAYLOAD_WORD, Slot, Us};
use firmware::services::port::Place;
use firmware::services::{self, PORTS, Program};
use wire::{CONSOLE_PORT, MAX_PAYLOAD, MAX_WORDS};

/// Longest frame without its FCS.
const FRAME_MAX: usize = 1514;
/// Calls of the services after a frame.
const TURNS: usize = 16;
/// Longer scripts add nothing.
const FRAMES: usize = 64;

/// A frame as the MAC's slots deliver it; after it there are bytes of an older one.
struct Received<'f>(&'f [u8]);

impl Frame for Received<'_> {
    fn word(&self, index: usize) -> u32 {
        let byte = |at: usize| match at.checked_sub(2) {
            Some(at) => self.0.get(at).copied().unwrap_or(0xa5),
            None => 0x5a,
        };
        u32::from_be_bytes([0, 1, 2, 3].map(|at| byte(4 * index + at)))
    }
}

/// A transmit slot.
#[derive(Default)]
struct Sent(Vec<u32>);

impl Slot for Sent {
    fn put(&mut self, index: usize, word: u32) {
        assert!(index < 2 + FRAME_MAX.div_ceil(4), "word {index} of a slot");
        if self.0.len() <= index {
            self.0.resize(index + 1, 0);
        }
        self.0[index] = word;
    }
}

impl Sent {
    fn frame(&self, length: usize) -> Vec<u8> {
        let mut bytes: Vec<u8> = self
            .0
            .iter()
            .flat_map(|w| w.to_be_bytes())
            .skip(2)
            .collect();
        assert!(length <= bytes.len(), "a frame longer than what was put");
        bytes.truncate(length);
        bytes
    }
}

/// The board's end of the wire.
struct Station<'p> {
    bench: Bench,
    services: Program<'p>,
    fast_path: Option<FastPath>,
    /// The board's last TCP numbers: the next sequence number it expects, and its own next one.
    expected: u32,
    next: u32,
    outcome: Outcome,
}

/// The result of a script.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Outcome {
    /// Frames the board sent.
    pub sent: u32,
    /// Exchanges the fast path executed, and those it refused.
    pub fast_path: [u32; 2],
    /// A client is connected to the console.
    pub visited: bool,
}

/// Runs a script of frames.
pub fn frames(data: &[u8]) {
    script(data);
}

/// Runs a script of frames and returns its result.
pub fn script(data: &[u8]) -> Outcome {
    let mut place = Place::new();
    let mut log = [0; firmware::services::journal::BYTES];
    let mut bench = Bench::new();
    let mut inside = Inside {
        machine: &mut bench.machine,
        sent: Vec::new(),
    };
    let services =
        Program::new(&mut [], &mut log, &mut place, 1, &mut inside).expect("a board that answers");
    let mut station = Station {
        bench,
        services,
        fast_path: None,
        expected: 0,
        next: 0,
        outcome: Outcome::default(),
    };
    let mut input = ByteReader(data);
    for _ in 0..FRAMES {
        if input.is_over() {
            break;
        }
        station.step(&mut input);
    }
    Outcome {
        visited: station.services.visited(),
        ..station.outcome
    }
}

const THEIR_MAC: [u8; 6] = [2, 3, 4, 5, 6, 7];
const THEIR_IP: [u8; 4] = [192, 168, 2, 1];
const THEIR_PORT: u16 = 40_000;

fn ones(bytes: &[u8], from: u32) -> u32 {
    let sum = bytes.chunks(2).fold(from, |sum, pair| {
        sum + u32::from(u16::from_be_bytes([
            pair[0],
            pair.get(1).copied().unwrap_or(0),
        ]))
    });
    let sum = (sum >> 16) + (sum & 0xffff);
    (sum >> 16) + (sum & 0xffff)
}

/// Ones' complement sum over a UDP or TCP segment with its pseudo header.
fn segment_sum(source: [u8; 4], destination: [u8; 4], protocol: u8, segment: &[u8]) -> u32 {
    let mut pseudo = [source, destination].concat();
    pseudo.extend([0, protocol]);
    pseudo.extend((segment.len() as u16).to_be_bytes());
    ones(segment, ones(&pseudo, 0))
}

/// The deviations of a packet that is built: bits of a byte of the script.
struct Oddities(u8);

impl Oddities {
    fn has(&self, bit: u8) -> bool {
        self.0 >> bit & 1 != 0
    }
}

/// A whole IPv4 frame to the board.
fn packet(us: &Us, protocol: u8, body: &[u8], odd: &Oddities, input: &mut ByteReader) -> Vec<u8> {
    let options = if odd.has(0) {
        usize::from(input.byte() % 11)
    } else {
        0
    };
    let fragment = if odd.has(1) { input.half() } else { 0x4000 };
    let total = 20 + 4 * options + body.len();
    let total = if odd.has(2) {
        total.wrapping_add_signed((input.byte() as i8).into())
    } else {
        total
    };
    let mut ip = vec![0x45 + options as u8, 0];
    ip.extend((total as u16).to_be_bytes());
    ip.extend([0x12, 0x34]);
    ip.extend(fragment.to_be_bytes());
    ip.extend([64, protocol, 0, 0]);
    ip.extend(THEIR_IP);
    let to = if odd.has(3) {
        [255; 4]
    } else {
        us.ip.to_be_bytes()
    };
    ip.extend(to);
    ip.resize(20 + 4 * options, 1);
    let sum = !ones(&ip, 0) as u16;
    ip[10..12].copy_from_slice(&sum.to_be_bytes());
    let mac = if odd.has(3) { [255; 6] } else { us.mac };
    let mut frame = mac.to_vec();
    frame.extend(THEIR_MAC);
    frame.extend([8, 0]);
    frame.extend(ip);
    frame.extend(body);
    if odd.has(4) {
        frame.extend(input.some());
    }
    if odd.has(5) {
        let at = usize::from(input.half()) % frame.len();
        frame[at] ^= input.byte();
    }
    if odd.has(6) {
        frame.truncate(input.half().into());
    }
    frame.resize(frame.len().max(if odd.has(6) { 0 } else { 60 }), 0);
    frame.truncate(FRAME_MAX);
    frame
}

impl Station<'_> {
    fn step(&mut self, input: &mut ByteReader) {
        let us = self.bench.machine.us;
        let step = input.byte();
        match step & 7 {
            0 => {
                let frame = input.many().to_vec();
                self.receive(&frame[..frame.len().min(FRAME_MAX)]);
            }
            1 | 2 => {
                let odd = Oddities(input.byte());
                let port = [us.port, wire::DISCOVERY_PORT, services::lease::PORT, 9]
                    [usize::from(step >> 3) % 4];
                let payload = if step & 7 == 2 {
                    self.exchange(input)
                } else {
                    input.many().to_vec()
                };
                let mut udp = THEIR_PORT.to_be_bytes().to_vec();
                udp.extend(port.to_be_bytes());
                let length = 8 + payload.len() as u16;
                udp.extend(length.to_be_bytes());
                udp.extend([0, 0]);
                udp.extend(payload);
                if odd.has(7) {
                    let sum = segment_sum(THEIR_IP, us.ip.to_be_bytes(), 17, &udp);
                    let sum = if sum == 0xffff { 0xffff } else { !sum as u16 };
                    udp[6..8].copy_from_slice(&sum.to_be_bytes());
                }
                let frame = packet(&us, 17, &udp, &odd, input);
                self.receive(&frame);
            }
            3 | 4 => {
                let [odd, flags, ahead, window] = input.array();
                let port: u16 = 4000 + u16::from(step >> 6);
                let mut tcp = port.to_be_bytes().to_vec();
                tcp.extend(CONSOLE_PORT.to_be_bytes());
                let off = i32::from(ahead as i8);
                tcp.extend(self.expected.wrapping_add_signed(off >> 4).to_be_bytes());
                tcp.extend(self.next.wrapping_add_signed(off << 28 >> 28).to_be_bytes());
                let options = step >> 3 & 7;
                tcp.extend([(5 + options) << 4, flags & 0x3f]);
                tcp.extend((u16::from(window) << 4).to_be_bytes());
                tcp.extend([0; 4]);
                tcp.resize(20 + 4 * usize::from(options), 1);
                tcp.extend(input.some());
                let sum = !segment_sum(THEIR_IP, us.ip.to_be_bytes(), 6, &tcp) as u16;
                tcp[16..18].copy_from_slice(&sum.to_be_bytes());
                let frame = packet(&us, 6, &tcp, &Oddities(odd), input);
                self.receive(&frame);
            }
            5 => {
                let odd = Oddities(input.byte());
                let mut icmp = vec![step >> 3 & 8, 0, 0, 0];
                icmp.extend(input.many());
                let sum = !ones(&icmp, 0) as u16;
                icmp[2..4].copy_from_slice(&sum.to_be_bytes());
                let frame = packet(&us, 1, &icmp, &odd, input);
                self.receive(&frame);
            }
            6 => {
                let mut frame = vec![255; 6];
                frame.extend(THEIR_MAC);
                frame.extend([8, 6, 0, 1, 8, 0, 6, 4, 0, 1 + (step >> 3 & 1)]);
                frame.extend(THEIR_MAC);
                frame.extend(THEIR_IP);
                frame.extend([0; 6]);
                frame.extend(us.ip.to_be_bytes());
                for byte in input.some() {
                    let at = usize::from(input.byte()) % frame.len();
                    frame[at] = *byte;
                }
                frame.resize(60, 0);
                self.receive(&frame);
            }
            _ => {
                let ms = 1u32 << (step >> 3 & 15);
                crate::watched::pass(&mut self.bench.machine, u64::from(ms.min(200)) * 60_000, 2);
                self.talk(None);
            }
        }
    }

    /// The payload of the owner's next command, with different errors.
    fn exchange(&self, input: &mut ByteReader) -> Vec<u8> {
        use wire::exchange::{COMMAND_MAX, Command, REQUEST_OVERHEAD};
        let flags = input.byte();
        let session = self.bench.machine.server.session();
        let peer = session.owner().unwrap_or_default();
        let command = Command {
            token: session.token_for(peer),
            sequence: session.last_sequence().wrapping_add(1),
            enable: flags & 1 != 0,
            enable_request: flags & 2 != 0,
            ..Command::default()
        };
        let channels = crate::watched::ident(&self.bench.machine).channels;
        let mut buffer = [0; REQUEST_OVERHEAD + COMMAND_MAX];
        let request = command
            .emit_request(channels, &mut buffer)
            .expect("it fits");
        let mut payload = crate::byte_reader::bytes(request);
        for _ in 0..flags >> 6 {
            let at = usize::from(input.byte()) % payload.len();
            payload[at] = input.byte();
        }
        payload
    }

    /// Handles a frame as `firmware::app` does.
    fn receive(&mut self, bytes: &[u8]) {
        let frame = Received(bytes);
        let length = bytes.len();
        let us = self.bench.machine.us;
        let class = net::classify(&frame, length, &us, &PORTS);
        if self.fast_path(&frame, length, class) {
            return;
        }
        let counters = self.bench.machine.server.counters_mut();
        counters.frames_rx = counters.frames_rx.wrapping_add(1);
        self.bench.machine.board.take();
        match class {
            Class::Ours(datagram) => {
                let words = payload(&frame, &datagram, bytes);
                if datagram.length.is_multiple_of(4) {
                    self.datagram(&datagram, &words);
                }
            }
            Class::Discovery(datagram) => {
                let words = payload(&frame, &datagram, bytes);
                let mut buffer = [0; MAX_WORDS];
                let answer = self
                    .bench
                    .machine
                    .discover(&words, datagram.peer.port, &mut buffer);
                let us = Us {
                    port: wire::DISCOVERY_PORT,
                    ..us
                };
                let answer = answer.to_vec();
                self.outcome.sent += u32::from(!answer.is_empty());
                if !answer.is_empty() {
                    send(&us, &Datagram::broadcast(datagram.peer.port), &answer);
                }
            }
            Class::Refused(why) => {
                self.bench.machine.server.refuse(why);
                self.untouched("a refused frame");
            }
            Class::Services => {
                self.talk(Some(bytes));
                self.untouched("a frame for the services");
            }
            Class::Nothing => self.untouched("a frame to another station"),
        }
    }

    fn untouched(&mut self, what: &str) {
        let deeds = self.bench.machine.board.take();
        assert_eq!(deeds, Default::default(), "{what} did that");
    }

    /// The fast path: true if it took the frame.
    fn fast_path(&mut self, frame: &Received, length: usize, class: Class) -> bool {
        let Some(fast_path) = &self.fast_path else {
            return false;
        };
        let Some(mut command) = fast_path.open(frame, length) else {
            return false;
        };
        let shape = *self.bench.machine.server.shape();
        let mut words = Vec::new();
        while words.len() < shape.command {
            words.extend(command.take1());
        }
        let whole = command.intact();
        match class {
            Class::Ours(datagram) => {
                assert!(
                    whole,
                    "the fast path finds damage where the full check finds none"
                );
                assert_eq!(
                    (datagram.peer, datagram.options),
                    (fast_path.datagram.peer, 0)
                );
                let long: Vec<u32> = (4..4 + shape.command)
                    .map(|index| net::payload_word(frame, 0, index))
                    .collect();
                assert_eq!(words, long);
            }
            Class::Refused(_) => {
                assert!(
                    !whole,
                    "the fast path takes a frame that is refused: {class:?}"
                )
            }
            Class::Discovery(_) | Class::Services | Class::Nothing => {
                panic!("the fast path takes {class:?}")
            }
        }
        let Some(mut command) = fast_path.open(frame, length) else {
            unreachable!("it was open");
        };
        let machine = &mut self.bench.machine;
        let us = machine.us;
        let mut slot = Sent::default();
        let bytes = SlotReply::<Sent>::frame_length(&shape);
        let datagram = fast_path.datagram;
        SlotReply::prepare(
            &mut slot,
            |slot| net::emit_headers(slot, &us, &datagram, bytes - HEADERS),
            &machine.server,
        );
        let mut reply = SlotReply::resume(&mut slot);
        machine.board.take();
        let served =
            machine
                .server
                .exchange(&mut machine.board, datagram.peer, &mut command, &mut reply);
        match served {
            Ok(()) => {
                assert!(whole, "a damaged command was executed");
                machine.server.exchanged(frame.word(FRAME_FLAGS));
                check(&slot.frame(bytes), &us);
                self.outcome.fast_path[0] += 1;
            }
            Err(why) => {
                machine.server.refuse(why);
                let deeds = machine.board.take();
                assert!(!deeds.took_effect(), "refused for {why:?}, and {deeds:?}");
                self.outcome.fast_path[1] += 1;
            }
        }
        true
    }

    fn datagram(&mut self, datagram: &Datagram, words: &[u32]) {
        let us = self.bench.machine.us;
        let mut buffer = [0; MAX_WORDS];
        let machine = &mut self.bench.machine;
        machine.board.take();
        let served = machine
            .datagram(words, datagram.peer, &mut buffer)
            .map(<[u32]>::to_vec);
        let deeds = machine.board.take();
        match served {
            Ok(reply) if !reply.is_empty() => {
                self.outcome.sent += 1;
                send(&us, datagram, &reply);
            }
            Ok(_) => {}
            Err(why) => assert!(!deeds.took_effect(), "refused for {why:?}, and {deeds:?}"),
        }
        let machine = &self.bench.machine;
        if datagram.options == 0 && machine.server.session().is_owner(datagram.peer) {
            let command = machine.server.shape().command;
            self.fast_path = Some(FastPath::new(&us, *datagram, command));
        }
    }

    /// A call of the services with a frame, and the turns that it leads to.
    fn talk(&mut self, frame: Option<&[u8]>) {
        let us = self.bench.machine.us;
        let mut inside = Inside {
            machine: &mut self.bench.machine,
            sent: Vec::new(),
        };
        if let Some(frame) = frame {
            self.services.frame(frame, &mut inside);
            let answers = inside.sent.len();
            assert!(answers <= 1, "one frame brought {answers} answers at once");
        }
        for _ in 0..TURNS {
            let before = inside.sent.len();
            let busy = self.services.poll(&mut inside);
            let sent = inside.sent.len() - before;
            assert!(sent <= 1, "one turn sent {sent} frames");
            if !busy {
                break;
            }
        }
        let sent = inside.sent;
        for frame in sent {
            self.outcome.sent += 1;
            check(&frame, &us);
            if let Some(tcp) = frame
                .get(34..)
                .filter(|_| frame[12..14] == [8, 0] && frame[23] == 6)
            {
                let word = |at: usize| ByteReader(&tcp[at..]).word();
                let data = tcp.len() - usize::from(tcp[12] >> 4) * 4;
                let control = u32::from(tcp[13] & 1) + u32::from(tcp[13] >> 1 & 1);
                self.next = word(4).wrapping_add(data as u32 + control);
                self.expected = word(8);
            }
        }
    }
}

/// The words of a datagram's payload, which lies inside its frame.
fn payload(frame: &Received, datagram: &Datagram, bytes: &[u8]) -> Vec<u32> {
    let from = HEADERS + 4 * datagram.options;
    assert!(
        from + datagram.length <= bytes.len(),
        "{datagram:?} in a frame of {} bytes",
        bytes.len()
    );
    assert!(datagram.length <= MAX_PAYLOAD);
    let count = datagram.length.div_ceil(4);
    (0..count)
        .map(|index| net::payload_word(frame, datagram.options, index))
        .collect()
}

/// Sends words, and checks the frame.
fn send(us: &Us, to: &Datagram, words: &[u32]) {
    let mut slot = Sent::default();
    net::emit_headers(&mut slot, us, to, words.len() * 4);
    let length = net::emit_payload(&mut slot, words);
    assert_eq!(length, HEADERS + 4 * words.len());
    assert!(slot.0.len() >= PAYLOAD_WORD + words.len());
    check(&slot.frame(length), us);
}

/// Checks one of our frames as a neighbour's stack would.
fn check(frame: &[u8], us: &Us) {
    assert!(
        (42..=FRAME_MAX).contains(&frame.len()),
        "{} bytes",
        frame.len()
    );
    assert_eq!(frame[6..12], us.mac, "the sender's address is wrong");
    match frame[12..14] {
        [8, 6] => {
            // The services send an ARP request for an unknown neighbour.
            assert!(
                matches!(frame[20..22], [0, 1 | 2]),
                "ARP, neither question nor answer"
            );
            assert_eq!(frame[22..28], us.mac, "the sender's address is wrong");
            assert_eq!(
                frame[28..32],
                us.ip.to_be_bytes(),
                "the sender's address is wrong"
            );
        }
        [8, 0] => {
            assert_eq!(frame[14], 0x45);
            let total = usize::from(u16::from_be_bytes([frame[16], frame[17]]));
            let padded = total + 14 < 60 && frame.len() == 60;
            assert!(
                total + 14 == frame.len() || padded,
                "{total} in {}",
                frame.len()
            );
            assert_eq!(ones(&frame[14..34], 0), 0xffff, "the header's sum");
            let body = &frame[34..14 + total];
            let address = |at: usize| -> [u8; 4] { std::array::from_fn(|n| frame[at + n]) };
            match frame[23] {
                1 => assert_eq!(ones(body, 0), 0xffff, "the ping's sum"),
                2 => {
                    assert_eq!(body[0], 0x16, "IGMP, and no report of version 2");
                    assert_eq!(ones(body, 0), 0xffff, "the report's sum");
                    assert_eq!(address(30), address(38), "a report goes to its group");
                }
                6 => {
                    let sum = segment_sum(address(26), address(30), 6, body);
                    assert_eq!(sum, 0xffff, "the segment's sum");
                }
                17 => {
                    let length = usize::from(u16::from_be_bytes([body[4], body[5]]));
                    assert_eq!(length, body.len());
                }
                other => panic!("protocol {other}"),
            }
        }
        ref other => panic!("type {other:x?}"),
    }
}
