//! A board on a wire with faulty neighbours: whole Ethernet frames, as `firmware::app` handles
//! them.
//!
//! The input is a script of frames: raw ones, and ones with corrected check sums, which a fuzzer
//! does not guess. The board's frames are checked as a neighbour's stack would: lengths, check
//! sums, addresses. Frames that are not a datagram of ours do not change the board. A frame that
//! the gateware executes with a pass is an exchange of the owner for the full check, too. The owner
//! may arm the machine and move it: then the services take short frames only, as in the image. What
//! is for the services is shown to the ROM's reserve, too, which answers where they do not run.

use crate::byte_reader::ByteReader;
use crate::watched::{self, Inside, Watched};
use firmware::machine::{Guest, IDLE, Shared};
use firmware::net::{self, Class, Datagram, Frame, HEADERS, PAYLOAD_WORD, Slot, Us};
use firmware::reserve;
use firmware::services::port::Place;
use firmware::services::{PORTS, Program, lease, sntp, syslog};
use wire::settings::Settings;
use wire::units::Velocity;
use wire::{CONSOLE_PORT, MAX_PAYLOAD, MAX_WORDS, Name, PAGE_PORT, Refusal};

/// Longest frame without its FCS.
const FRAME_MAX: usize = 1514;
/// Bytes in front of a frame in its slot.
const PAD: usize = 2;
/// Clocks in which the longest answer has been sent.
const ANSWER: u64 = 1_000;
/// Calls of the services after a frame.
const TURNS: usize = 16;
/// Longer scripts add nothing.
const FRAMES: usize = 64;
/// Steps/s of an axis, times 1 to 8.
const SPEED: f64 = 10e3;

/// Where a datagram may go to: 0 is the board's own port; then those of the ROM and of the
/// services, and some where nothing listens.
const UDP: [u16; 8] = [
    0,
    wire::DISCOVERY_PORT,
    lease::PORT,
    9,
    wire::mdns::PORT,
    sntp::PORT,
    syslog::PORT,
    wire::jobs::PORT,
];
/// Where a connection may go to; on a board without jobs nothing listens at their port.
const TCP: [u16; 4] = [CONSOLE_PORT, PAGE_PORT, wire::jobs::PORT, 7];
const _: () = {
    let mut at = 0;
    while at < PORTS.len() {
        let (mut known, mut n) = (PORTS[at] == 0, 0);
        while n < UDP.len() {
            known |= UDP[n] == PORTS[at];
            n += 1;
        }
        assert!(known, "a port of the services that no script reaches");
        at += 1;
    }
};

/// The port from which the peer of a port sends.
fn peers_port(port: u16) -> u16 {
    match port {
        lease::PORT => lease::SERVER_PORT,
        wire::mdns::PORT | sntp::PORT => port,
        _ => THEIR_PORT,
    }
}

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
    machine: Shared<Watched>,
    services: Program<'p>,
    /// The host whose next exchange can be judged in advance, and its token.
    owner: Option<(Datagram, u32)>,
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
    /// Exchanges that the gateware executed, and those that took the long way.
    pub ways: [u32; 2],
    /// A client is connected to the console.
    pub visited: bool,
    /// Frames for the services that came while the owner moved the machine: those that they took,
    /// and those that were too long.
    pub beside: [u32; 2],
}

/// Runs a script of frames.
pub fn frames(data: &[u8]) {
    script(data);
}

/// Runs a script of frames and returns its result.
pub fn script(data: &[u8]) -> Outcome {
    let mut place = Place::new();
    let mut log = [0; firmware::services::journal::BYTES];
    let mut machine = watched::start_with(&settings());
    let mut inside = Inside {
        machine: Guest::of(&mut machine),
        sent: Vec::new(),
    };
    let services =
        Program::new(&mut [], &mut log, &mut place, 1, &mut inside).expect("a board that answers");
    drop(inside);
    let mut station = Station {
        machine: Shared::new(machine),
        services,
        owner: None,
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
        ways: station.machine.server.counters().ways,
        ..station.outcome
    }
}

/// A board with a name, which sends its events and takes the time from its neighbour.
fn settings() -> Settings {
    Settings {
        mac: [0x10, 0xe2, 0xd5, 0, 0, 1],
        name: Name::new("fuzz").unwrap_or_default(),
        syslog: u32::from_be_bytes(THEIR_IP),
        sntp: u32::from_be_bytes(THEIR_IP),
        ..Settings::BUILT_IN
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

/// Is it a ping with a wrong sum? The board does not answer one; but smoltcp takes each sum for a
/// right one when it is built with `--cfg fuzzing`, as `cargo fuzz` does, and the sum of an answer
/// of the ROM is as wrong as that of its question.
fn has_wrong_ping_sum(frame: &[u8]) -> bool {
    let header = 4 * usize::from(frame[14] & 15);
    let total = usize::from(u16::from_be_bytes([frame[16], frame[17]]));
    frame[12..14] == [8, 0] && ones(&frame[14 + header..14 + total], 0) != 0xffff
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

/// Addresses of a destination.
type To = ([u8; 6], [u8; 4]);
const ALL: To = ([255; 6], [255; 4]);
/// The group of multicast DNS.
const MDNS: To = ([1, 0, 0x5e, 0, 0, 0xfb], [224, 0, 0, 0xfb]);

/// A whole IPv4 frame to the board, or to all.
fn packet(us: &Us, protocol: u8, body: &[u8], odd: &Oddities, input: &mut ByteReader) -> Vec<u8> {
    let to = if odd.has(3) {
        ALL
    } else {
        (us.mac, us.ip.to_be_bytes())
    };
    packet_to(to, protocol, body, odd, input)
}

/// A whole IPv4 frame.
fn packet_to(to: To, protocol: u8, body: &[u8], odd: &Oddities, input: &mut ByteReader) -> Vec<u8> {
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
    let (mac, address) = to;
    ip.extend(address);
    ip.resize(20 + 4 * options, 1);
    let sum = !ones(&ip, 0) as u16;
    ip[10..12].copy_from_slice(&sum.to_be_bytes());
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
        let us = self.machine.us;
        let step = input.byte();
        match step & 7 {
            0 => {
                let frame = input.many().to_vec();
                self.receive(&frame[..frame.len().min(FRAME_MAX)]);
            }
            1 | 2 => self.udp(step, input),
            3 | 4 => self.tcp(step, input),
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
                self.pass(u64::from(ms.min(200)) * 60_000);
                self.talk(None);
            }
        }
    }

    /// A datagram: to one of the ports; from the port where its peer is, or another one; to the
    /// board, to all, or to the group.
    fn udp(&mut self, step: u8, input: &mut ByteReader) {
        let us = self.machine.us;
        let odd = Oddities(input.byte());
        let port = match UDP[usize::from(step >> 3) % UDP.len()] {
            0 => us.port,
            port => port,
        };
        let from = match step >> 6 & 1 {
            0 => peers_port(port),
            _ => THEIR_PORT,
        };
        let payload = if step & 7 == 2 {
            self.exchange(input)
        } else {
            input.many().to_vec()
        };
        let to = match (odd.has(3), step >> 7) {
            (true, _) => ALL,
            (false, 0) => (us.mac, us.ip.to_be_bytes()),
            (false, _) => MDNS,
        };
        let mut udp = from.to_be_bytes().to_vec();
        udp.extend(port.to_be_bytes());
        let length = 8 + payload.len() as u16;
        udp.extend(length.to_be_bytes());
        udp.extend([0, 0]);
        udp.extend(payload);
        if odd.has(7) {
            let sum = segment_sum(THEIR_IP, to.1, 17, &udp);
            let sum = if sum == 0xffff { 0xffff } else { !sum as u16 };
            udp[6..8].copy_from_slice(&sum.to_be_bytes());
        }
        let frame = packet_to(to, 17, &udp, &odd, input);
        self.receive(&frame);
    }

    /// A segment for the console, or for any port.
    fn tcp(&mut self, step: u8, input: &mut ByteReader) {
        let us = self.machine.us;
        let [odd, flags, ahead, window] = input.array();
        let from: u16 = 4000 + u16::from(step >> 6);
        let to = match step & 7 {
            3 => CONSOLE_PORT,
            _ => TCP[usize::from(step >> 6)],
        };
        let mut tcp = from.to_be_bytes().to_vec();
        tcp.extend(to.to_be_bytes());
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

    /// The payload of the owner's next command, with different errors.
    fn exchange(&self, input: &mut ByteReader) -> Vec<u8> {
        use wire::exchange::{COMMAND_MAX, Command, REQUEST_OVERHEAD};
        let flags = input.byte();
        let session = self.machine.session();
        let peer = session.owner().unwrap_or_default();
        let mut command = Command {
            token: session.token_for(peer),
            sequence: session.last_sequence().wrapping_add(1),
            enable: flags & 1 != 0,
            enable_request: flags & 2 != 0,
            ..Command::default()
        };
        let ident = watched::ident(&self.machine);
        let (channels, hz) = (ident.channels, f64::from(ident.clock_hz));
        if flags & 4 != 0 {
            command.stepgen_enable = u16::MAX;
            command.stepgen[0].0 = Velocity::from_hz(SPEED * f64::from(1 + (flags >> 3 & 7)), hz);
        }
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

    /// Lets clocks pass, with housekeeping before and behind them.
    fn pass(&mut self, clocks: u64) {
        for part in [clocks / 2, clocks - clocks / 2] {
            let board = &mut self.machine.board().model_board;
            let until = board.clock() + part;
            board.pass(until);
            if self.machine.due(IDLE) {
                self.machine.housekeeping();
                let session = self.machine.session();
                if self
                    .owner
                    .is_some_and(|(datagram, _)| !session.is_owner(datagram.peer))
                {
                    self.machine.alone();
                    self.owner = None;
                }
            }
            self.offer();
        }
    }

    /// The next exchange of the owner may be executed by the gateware.
    fn offer(&mut self) {
        if self.machine.owes_path() {
            self.machine.alone().hold_path();
        }
        if self.owner.is_some() {
            self.machine.offer();
        }
    }

    /// Handles a frame as the gateware and `firmware::app` do.
    fn receive(&mut self, bytes: &[u8]) {
        let frame = Received(bytes);
        let length = bytes.len();
        let us = self.machine.us;
        let mut payload = [0; MAX_WORDS];
        let class = net::classify(&frame, length, &us, &PORTS, &mut payload);
        self.machine.board().take();
        if self.gateware(bytes, class) {
            self.machine.alone();
        } else {
            self.machine.received();
            self.long_way(bytes, class, &payload);
        }
        self.offer();
    }

    /// The firmware's part.
    fn long_way(&mut self, bytes: &[u8], class: Class, payload: &[u32; MAX_WORDS]) {
        let us = self.machine.us;
        match class {
            Class::Ours(datagram) => {
                self.datagram(&datagram, taken(payload, &datagram, bytes));
            }
            Class::Discovery(datagram) => {
                let words = taken(payload, &datagram, bytes);
                let mut buffer = [0; MAX_WORDS];
                let port = datagram.peer.port;
                let answer = self
                    .machine
                    .guest()
                    .discover(words, port, &mut buffer)
                    .to_vec();
                let us = Us {
                    port: wire::DISCOVERY_PORT,
                    ..us
                };
                self.outcome.sent += u32::from(!answer.is_empty());
                if !answer.is_empty() {
                    send(&us, &Datagram::broadcast(port), &answer);
                }
            }
            Class::Refused(why) => {
                self.machine.refuse(why);
                self.untouched("a refused frame");
            }
            Class::Services => {
                self.reserve(bytes);
                let moving = self.owner.is_some() && !self.machine.at_rest();
                let long = bytes.len() > net::longest_in_motion(&Received(bytes), true);
                self.outcome.beside[usize::from(long)] += u32::from(moving);
                if moving && long {
                    self.machine.refuse(Refusal::Oversized);
                } else {
                    self.talk(Some(bytes));
                }
                self.untouched("a frame for the services");
            }
            Class::Nothing => self.untouched("a frame to another station"),
        }
    }

    /// What answers where the services do not run.
    fn reserve(&self, bytes: &[u8]) {
        let us = self.machine.us;
        let mut answer = [0; FRAME_MAX];
        let answer = reserve::answer(bytes, &us, &mut answer).map(|length| &answer[..length]);
        if let Some(answer) = answer.filter(|_| !has_wrong_ping_sum(bytes)) {
            check(answer, &us);
        }
    }

    fn untouched(&mut self, what: &str) {
        let deeds = self.machine.board().take();
        assert_eq!(deeds, Default::default(), "{what} did that");
    }

    /// The fast path: true if it executed the frame, and its answer has left.
    fn gateware(&mut self, bytes: &[u8], class: Class) -> bool {
        let Some((owner, _)) = self.owner else {
            return false;
        };
        let frame = Received(bytes);
        let words = 0..(bytes.len() + PAD).div_ceil(4);
        let mut words: Vec<_> = words.map(|n| frame.word(n)).collect();
        words[0] &= 0xffff; // a slot begins with zeros
        let us = self.machine.us;
        let board = &mut self.machine.board().model_board;
        if !board.hear(&words, bytes.len()) {
            return false;
        }
        let Class::Ours(datagram) = class else {
            panic!("the gateware executes {class:?}");
        };
        assert_eq!((datagram.peer, datagram.options), (owner.peer, 0));
        board.pass(board.clock() + ANSWER);
        assert!(board.hears(), "the answer is not written");
        check(&board.answer(), &us);
        true
    }

    fn datagram(&mut self, datagram: &Datagram, words: &[u32]) {
        let us = self.machine.us;
        let mut buffer = [0; MAX_WORDS];
        let peer = datagram.peer;
        let served = match self.machine.session().is_owner(peer) {
            true => self.machine.alone().datagram(words, peer, &mut buffer),
            false => self.machine.guest().datagram(words, peer, &mut buffer),
        };
        let served = served.map(<[u32]>::to_vec);
        let deeds = self.machine.board().take();
        match served {
            Ok(reply) if !reply.is_empty() => {
                self.outcome.sent += 1;
                send(&us, datagram, &reply);
            }
            Ok(_) => {}
            Err(why) => assert!(!deeds.took_effect(), "refused for {why:?}, and {deeds:?}"),
        }
        let session = self.machine.session();
        if datagram.options == 0 && session.is_owner(peer) {
            let whole = Datagram {
                length: 0,
                ..*datagram
            };
            let owner = (whole, session.token_for(peer));
            if self.owner != Some(owner) {
                self.open_fast_path(owner);
            }
        }
    }

    /// This owner's exchanges can be judged in advance from now on.
    fn open_fast_path(&mut self, owner: (Datagram, u32)) {
        let machine = self.machine.alone();
        let (us, shape, boot_id) = (machine.us, *machine.shape(), machine.boot_id());
        let board = &mut machine.board.model_board;
        board.guard(&owner.0, owner.1, &us, &shape, boot_id);
        self.owner = Some(owner);
    }

    /// A call of the services with a frame, and the turns that it leads to.
    fn talk(&mut self, frame: Option<&[u8]>) {
        let us = self.machine.us;
        let mut inside = Inside {
            machine: self.machine.guest(),
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
fn taken<'p>(payload: &'p [u32; MAX_WORDS], datagram: &Datagram, bytes: &[u8]) -> &'p [u32] {
    let from = HEADERS + 4 * datagram.options;
    assert!(
        from + datagram.length <= bytes.len(),
        "{datagram:?} in a frame of {} bytes",
        bytes.len()
    );
    assert!(datagram.length <= MAX_PAYLOAD && datagram.length.is_multiple_of(4));
    let words = &payload[..datagram.words()];
    let theirs = bytes[from..].as_chunks().0;
    let same = words
        .iter()
        .zip(theirs)
        .all(|(word, bytes)| *word == u32::from_be_bytes(*bytes));
    assert!(same, "{datagram:?}: not the payload of its frame");
    words
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
