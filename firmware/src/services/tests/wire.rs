//! smoltcp at both ends of a wire that loses, doubles and reorders frames: whatever it does, every
//! byte arrives once and in its order, and the connections end.

use super::rig::{Board, MS, PROMPT, US, echo};
use ::jobs::instruction::{Feed, Instruction};
use ::jobs::job::Writer;
use smoltcp::iface::{Config, Interface, SocketHandle, SocketSet};
use smoltcp::phy::{ChecksumCapabilities, Device, DeviceCapabilities, Medium, RxToken, TxToken};
use smoltcp::socket::{icmp, tcp};
use smoltcp::time::{Duration, Instant};
use smoltcp::wire::{
    EthernetAddress, Icmpv4Packet, Icmpv4Repr, IpAddress, IpCidr, Ipv4Address, Ipv4Cidr,
};
use std::collections::{BTreeMap, VecDeque};
use std::vec;
use std::vec::Vec;
use std::{format, println, string::String};
use wire::crc::crc32;
use wire::jobs::{DATA, Entry, FRAME, Frame, Op, PORT, Request, Status};
use wire::{CONSOLE_PORT, Name};

/// The ends of a connection are known to both sides within this: each side's last segment may be
/// lost several times, and the board waits 30 s for a client that does not end its half.
const ENDS_MS: u64 = 40_000;
/// Nothing on the worst of these wires takes longer.
const LONGEST_MS: u64 = 600_000;

/// Numbers that a seed decides.
struct Dice(u64);

impl Dice {
    fn next(&mut self) -> u32 {
        // SplitMix64.
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut mixed = self.0;
        mixed = (mixed ^ mixed >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        mixed = (mixed ^ mixed >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
        (mixed ^ mixed >> 31) as u32
    }

    /// True in so many of 100 cases.
    fn falls(&mut self, percent: u32) -> bool {
        self.next() % 100 < percent
    }
}

/// What happens to frames, in either direction: of 100 so many are lost, come twice, and come late.
#[derive(Clone, Copy, Debug)]
struct Faults {
    lost: u32,
    doubled: u32,
    late: u32,
}

impl Faults {
    /// smoltcp waits up to 60 s before it repeats a segment that was lost several times, and a
    /// client that was not heard for 92 s is gone: on the worst wires a connection may end early.
    /// What was said over it is right even so.
    fn may_part(self) -> bool {
        self.lost >= 10
    }
}

const CLEAN: Faults = Faults {
    lost: 0,
    doubled: 0,
    late: 0,
};
/// A late frame arrives up to so much later: behind many others.
const LATE_MS: u32 = 40;

/// One direction of the wire.
#[derive(Default)]
struct Direction {
    under_way: BTreeMap<(u64, u64), Vec<u8>>,
    count: u64,
    delivered: u64,
}

impl Direction {
    fn put(&mut self, frame: &[u8], now: u64, faults: Faults, dice: &mut Dice) {
        if dice.falls(faults.lost) {
            return;
        }
        for _ in 0..1 + u32::from(dice.falls(faults.doubled)) {
            let late = match dice.falls(faults.late) {
                true => u64::from(dice.next() % LATE_MS),
                false => 0,
            };
            self.count += 1;
            let place = (now + 1 + late, self.count);
            self.under_way.insert(place, frame.to_vec());
        }
    }

    fn take(&mut self, now: u64) -> Option<Vec<u8>> {
        let first = self.under_way.first_entry()?;
        let due = first.key().0 <= now;
        self.delivered += u64::from(due);
        due.then(|| first.remove())
    }
}

/// The network card of the client.
#[derive(Default)]
struct NetworkCard {
    rx: VecDeque<Vec<u8>>,
    tx: Vec<Vec<u8>>,
}

struct Taken(Vec<u8>);
struct Put<'a>(&'a mut Vec<Vec<u8>>);

impl RxToken for Taken {
    fn consume<R, F: FnOnce(&[u8]) -> R>(self, take: F) -> R {
        take(&self.0)
    }
}

impl TxToken for Put<'_> {
    fn consume<R, F: FnOnce(&mut [u8]) -> R>(self, length: usize, write: F) -> R {
        let mut frame = vec![0; length];
        let result = write(&mut frame);
        self.0.push(frame);
        result
    }
}

impl Device for NetworkCard {
    type RxToken<'a> = Taken;
    type TxToken<'a> = Put<'a>;

    fn receive(&mut self, _: Instant) -> Option<(Taken, Put<'_>)> {
        let frame = self.rx.pop_front()?;
        Some((Taken(frame), Put(&mut self.tx)))
    }

    fn transmit(&mut self, _: Instant) -> Option<Put<'_>> {
        Some(Put(&mut self.tx))
    }

    fn capabilities(&self) -> DeviceCapabilities {
        let mut capabilities = DeviceCapabilities::default();
        capabilities.medium = Medium::Ethernet;
        capabilities.max_transmission_unit = 1514;
        capabilities
    }
}

/// A board, a PC, and the wire between them.
struct Lan {
    board: Board,
    iface: Interface,
    card: NetworkCard,
    sockets: SocketSet<'static>,
    there: Direction,
    back: Direction,
    faults: Faults,
    dice: Dice,
    port: u16,
}

impl Lan {
    fn new(seed: u64, faults: Faults) -> Self {
        let mut config = Config::new(EthernetAddress([2, 0, 0, 0, 1, 9]).into());
        config.random_seed = seed;
        let mut card = NetworkCard::default();
        let mut iface = Interface::new(config, &mut card, Instant::ZERO);
        iface.update_ip_addrs(|all| {
            let ours = Ipv4Cidr::new(Ipv4Address::new(192, 168, 2, 9), 24);
            all.push(IpCidr::Ipv4(ours)).expect("room for an address");
        });
        Lan {
            board: Board::new(),
            iface,
            card,
            sockets: SocketSet::new(vec![]),
            there: Direction::default(),
            back: Direction::default(),
            faults,
            dice: Dice(seed),
            port: 50_000,
        }
    }

    fn now(&self) -> u64 {
        self.board.ms()
    }

    /// A millisecond.
    fn pass(&mut self) {
        self.board.hold(MS);
        let now = self.now();
        while let Some(frame) = self.there.take(now) {
            self.board.take(&frame);
            self.board.turn();
        }
        self.board.work();
        for frame in self.board.sent() {
            self.back.put(&frame, now, self.faults, &mut self.dice);
        }
        while let Some(frame) = self.back.take(now) {
            self.card.rx.push_back(frame);
        }
        let instant = Instant::from_millis(now as i64);
        self.iface.poll(instant, &mut self.card, &mut self.sockets);
        for frame in core::mem::take(&mut self.card.tx) {
            self.there.put(&frame, now, self.faults, &mut self.dice);
        }
    }

    fn connect(&mut self, to: u16) -> SocketHandle {
        let buffer = |bytes| tcp::SocketBuffer::new(vec![0; bytes]);
        let mut socket = tcp::Socket::new(buffer(2048), buffer(4096));
        // As a client that wants to know whether the board is there.
        socket.set_keep_alive(Some(Duration::from_secs(5)));
        let handle = self.sockets.add(socket);
        self.port += 1;
        let board = (IpAddress::Ipv4(Ipv4Address::from_bits(US.ip)), to);
        let socket = self.sockets.get_mut::<tcp::Socket>(handle);
        let begun = socket.connect(self.iface.context(), board, self.port);
        begun.expect("a new port");
        handle
    }

    fn socket(&mut self, handle: SocketHandle) -> &mut tcp::Socket<'static> {
        self.sockets.get_mut(handle)
    }

    /// A connection to this port within so many milliseconds; SYNs are sent again as smoltcp does.
    fn enters(&mut self, to: u16, ms: u64) -> Option<SocketHandle> {
        let (handle, end) = (self.connect(to), self.now() + ms);
        while self.now() < end {
            self.pass();
            if self.socket(handle).may_send() {
                return Some(handle);
            }
        }
        None
    }
}

/// A client that says its bytes as fast as it is allowed to, keeps what it hears, and ends.
struct Client {
    handle: SocketHandle,
    to_say: Vec<u8>,
    heard: Vec<u8>,
    expected: Vec<u8>,
    /// Ends its half when it has heard everything; otherwise the board does.
    ends_first: bool,
    piece: usize,
}

impl Client {
    fn turn(&mut self, lan: &mut Lan) {
        let limit = 1 + lan.dice.next() as usize % self.piece;
        let socket = lan.sockets.get_mut::<tcp::Socket>(self.handle);
        if socket.can_send() && !self.to_say.is_empty() {
            let piece = &self.to_say[..limit.min(self.to_say.len())];
            let said = socket.send_slice(piece).expect("it can send");
            self.to_say.drain(..said);
        }
        while socket.can_recv() {
            let taken = socket.recv(|bytes| (bytes.len(), bytes.to_vec()));
            self.heard.extend(taken.expect("it can receive"));
        }
        let done = self.heard.len() >= self.expected.len() && self.to_say.is_empty();
        // The board's end is answered with ours.
        let ended = socket.state() == tcp::State::CloseWait;
        if ended || self.ends_first && done {
            socket.close();
        }
    }

    fn over(&self, lan: &mut Lan) -> bool {
        let state = lan.socket(self.handle).state();
        matches!(state, tcp::State::Closed | tcp::State::TimeWait)
    }

    /// A console's client with so many lines; with `quit` the board ends the connection.
    fn of_console(lan: &mut Lan, lines: u32, quit: bool) -> Self {
        let (mut to_say, mut expected) = (Vec::new(), String::from(PROMPT));
        for n in 0..lines {
            let line = match lan.dice.next() % 7 {
                0 => "help".to_owned(),
                1 => format!("regs {}", 8 + lan.dice.next() % 8),
                _ => format!("stepgen {}", (n + lan.dice.next()) % 6),
            };
            to_say.extend(line.bytes().chain(*b"\r\n"));
            expected += &echo(&line);
        }
        if quit {
            to_say.extend(b"quit\n");
            expected += "bye\r\n";
        }
        Client {
            handle: lan.connect(CONSOLE_PORT),
            to_say,
            heard: Vec::new(),
            expected: expected.into_bytes(),
            ends_first: !quit,
            piece: 100,
        }
    }
}

/// A client that uploads a job, in requests that it does not wait with. The board hangs up after
/// ten seconds of silence, which such a wire may bring; then the client goes on where it was.
struct Upload {
    client: Client,
    bytes: Vec<u8>,
    /// What was asked over this connection, and when it was opened; how often one was.
    asked: Vec<Op>,
    since: u64,
    connections: u32,
    entry: Option<Entry>,
}

/// A connection that has said nothing for so long is given up.
const PATIENCE_MS: u64 = 60_000;

impl Upload {
    fn new(lan: &mut Lan, bytes: Vec<u8>) -> Self {
        let client = Client {
            handle: lan.connect(PORT),
            to_say: Vec::new(),
            heard: Vec::new(),
            expected: Vec::new(),
            ends_first: false,
            piece: 4096,
        };
        let mut upload = Upload {
            client,
            bytes,
            asked: Vec::new(),
            since: lan.now(),
            connections: 1,
            entry: None,
        };
        upload.begin();
        upload
    }

    fn ask(&mut self, request: &Request) {
        let mut out = [0; FRAME];
        self.asked.push(request.op());
        let length = request.emit(self.asked.len() as u16, &mut out);
        self.client.to_say.extend(&out[..length]);
    }

    fn begin(&mut self) {
        let put = Request::Put {
            total: self.bytes.len() as u32,
            crc: crc32(&self.bytes),
            name: Name::new("upload").expect("a name"),
        };
        self.ask(&Request::Hello { client: 9 });
        self.ask(&put);
    }

    /// The rest of the file from here on.
    fn go_on(&mut self, offset: u32) {
        let bytes = self.bytes.clone();
        let rest = &bytes[offset as usize..];
        for (offset, bytes) in (offset..).step_by(DATA).zip(rest.chunks(DATA)) {
            self.ask(&Request::Data { offset, bytes });
        }
        self.ask(&Request::Commit);
    }

    /// The whole answers over this connection.
    fn answers(&self) -> Vec<(Op, Status, Vec<u8>)> {
        let (mut rest, mut answers) = (&self.client.heard[..], Vec::new());
        while let Some((frame, length)) = Frame::parse(rest).expect("frames") {
            assert_eq!(usize::from(frame.id), answers.len() + 1, "in order");
            let (op, status) = frame.answer().expect("an answer");
            answers.push((op, status, frame.payload.to_vec()));
            rest = &rest[length..];
        }
        answers
    }

    fn turn(&mut self, lan: &mut Lan) {
        let before = self.client.heard.len();
        self.client.turn(lan);
        if self.client.heard.len() > before {
            self.since = lan.now();
        }
        let answers = match self.refused() {
            true => Vec::new(),
            false => self.answers(),
        };
        for (asked, (op, status, _)) in self.asked.iter().zip(&answers) {
            assert_eq!((op, status), (asked, &Status::Normal));
        }
        match &answers[..] {
            [_, (_, _, offset)] if self.asked.len() == 2 => {
                let offset = wire::jobs::word(offset).expect("an offset");
                self.go_on(offset);
            }
            [.., (Op::Commit, _, entry)] => {
                self.entry = Entry::parse(entry);
                self.client.ends_first = true;
            }
            _ => {}
        }
        let silent = lan.now() > self.since + PATIENCE_MS;
        if self.entry.is_none() && (silent || self.client.over(lan)) {
            self.again(lan);
        }
    }

    /// The board says that another client has the line: the connection before this one, which it
    /// believes to be there. That answer has no id.
    fn refused(&self) -> bool {
        let first = Frame::parse(&self.client.heard).expect("frames");
        let status = first.and_then(|(frame, _)| frame.answer());
        status.is_some_and(|(_, status)| status == Status::Busy)
    }

    fn again(&mut self, lan: &mut Lan) {
        lan.socket(self.client.handle).abort();
        self.client.handle = lan.connect(PORT);
        self.client.heard.clear();
        self.client.to_say.clear();
        self.asked.clear();
        self.since = lan.now();
        self.connections += 1;
        self.begin();
    }
}

/// A ping every 10 ms, and what came back.
struct Pings {
    handle: SocketHandle,
    sent: u16,
    heard: u32,
}

impl Pings {
    const IDENT: u16 = 0x1234;

    fn new(lan: &mut Lan) -> Self {
        let buffer = || {
            let headers = vec![icmp::PacketMetadata::EMPTY; 8];
            icmp::PacketBuffer::new(headers, vec![0; 2048])
        };
        let mut socket = icmp::Socket::new(buffer(), buffer());
        let bound = socket.bind(icmp::Endpoint::Ident(Self::IDENT));
        bound.expect("a socket that is not bound");
        Pings {
            handle: lan.sockets.add(socket),
            sent: 0,
            heard: 0,
        }
    }

    fn data(seq_no: u16) -> Vec<u8> {
        (0..1 + seq_no % 97).map(|n| (n ^ seq_no) as u8).collect()
    }

    fn turn(&mut self, lan: &mut Lan) {
        let now = lan.now();
        let socket = lan.sockets.get_mut::<icmp::Socket>(self.handle);
        let sums = ChecksumCapabilities::default();
        if now.is_multiple_of(10) && socket.can_send() {
            self.sent += 1;
            let data = Self::data(self.sent);
            let ping = Icmpv4Repr::EchoRequest {
                ident: Self::IDENT,
                seq_no: self.sent,
                data: &data,
            };
            let to = IpAddress::Ipv4(Ipv4Address::from_bits(US.ip));
            let room = socket.send(ping.buffer_len(), to).expect("room");
            ping.emit(&mut Icmpv4Packet::new_unchecked(room), &sums);
        }
        while let Ok((packet, _)) = socket.recv() {
            let packet = Icmpv4Packet::new_checked(packet).expect("a packet");
            let reply = Icmpv4Repr::parse(&packet, &sums).expect("ICMP");
            let Icmpv4Repr::EchoReply { seq_no, data, .. } = reply else {
                panic!("{reply:?}");
            };
            assert_eq!(data, Self::data(seq_no), "ping {seq_no}");
            self.heard += 1;
        }
    }
}

/// A job of some kilobytes.
fn job(dice: &mut Dice) -> Vec<u8> {
    let mut writer = Writer::new("test");
    let mut bytes = writer.header().to_vec();
    for line in 0..1000 {
        let place = |n: u32| i64::from(n % 100) * 1_000_000;
        let to = [place(dice.next()), place(dice.next()), 0];
        let feed = Feed::Rate(100_000_000);
        let instruction = Instruction::Line { to, feed };
        writer.add(&instruction, line, |block| bytes.extend(block));
    }
    writer.add(&Instruction::End, 1000, |block| bytes.extend(block));
    writer.finish(|block| bytes.extend(block));
    assert!(bytes.len() > 5 * DATA, "{} bytes", bytes.len());
    bytes
}

/// How far the clients are.
fn states<'c>(lan: &mut Lan, clients: impl Iterator<Item = &'c Client>) -> Vec<String> {
    let state = |it: &Client| {
        let state = lan.socket(it.handle).state();
        let (heard, of) = (it.heard.len(), it.expected.len());
        format!("{state}, {heard} bytes of {of}, {} to say", it.to_say.len())
    };
    clients.map(state).collect()
}

/// Three consoles, an upload and pings over such a wire; then all places are free again.
fn session(seed: u64, faults: Faults) {
    let case = format!("seed {seed}, {faults:?}");
    let mut lan = Lan::new(seed, faults);
    let mut pings = Pings::new(&mut lan);
    let mut consoles: Vec<Client> = [(40, false), (25, true), (1, true)]
        .into_iter()
        .map(|(lines, quit)| Client::of_console(&mut lan, lines, quit))
        .collect();
    let bytes = job(&mut lan.dice);
    let mut upload = Upload::new(&mut lan, bytes);
    let mut since = None;
    loop {
        lan.pass();
        pings.turn(&mut lan);
        for client in &mut consoles {
            client.turn(&mut lan);
        }
        upload.turn(&mut lan);
        let parted: Vec<bool> = consoles.iter().map(|it| it.over(&mut lan)).collect();
        let all = |(it, parted): (&Client, &bool)| {
            let said = it.to_say.is_empty() && it.heard.len() >= it.expected.len();
            said || faults.may_part() && *parted
        };
        let now = lan.now();
        let clients = || consoles.iter().chain([&upload.client]);
        if !consoles.iter().zip(&parted).all(all) || upload.entry.is_none() {
            let late = now >= LONGEST_MS;
            assert!(
                !late,
                "{case}: {now} ms: {:#?}",
                states(&mut lan, clients())
            );
            continue;
        }
        if clients().all(|client| client.over(&mut lan)) {
            break;
        }
        let late = now >= *since.get_or_insert(now) + ENDS_MS;
        assert!(!late, "{case}: no end: {:#?}", states(&mut lan, clients()));
    }
    let mut whole = 0;
    for (n, client) in consoles.iter().enumerate() {
        let heard = String::from_utf8_lossy(&client.heard);
        let expected = String::from_utf8_lossy(&client.expected);
        match faults.may_part() {
            true => assert!(
                expected.starts_with(&*heard),
                "{case}: console {n}: {heard}"
            ),
            false => assert_eq!(heard, expected, "{case}: console {n}"),
        }
        whole += u32::from(heard == expected);
    }
    let entry = upload.entry.expect("the job's");
    assert!(
        entry.ready && entry.crc == crc32(&upload.bytes),
        "{case}: {entry:?}"
    );
    assert!(pings.heard > 0, "{case}: no ping of {}", pings.sent);
    let (frames, uploads) = (lan.there.count, upload.connections);
    let ms = lan.now();
    println!("{case}: {ms} ms, {frames} frames, {whole} consoles whole, {uploads} uploads");
    all_are_free(lan, &case);
}

/// What the wire still has arrives. Then three clients have a console at once, and one the line for
/// jobs.
fn all_are_free(mut lan: Lan, case: &str) {
    lan.faults = CLEAN;
    // A client's last acknowledgement may be lost: the board says its end again, 30 s at most.
    let end = lan.now() + 31_000;
    while lan.now() < end {
        lan.pass();
    }
    for port in [CONSOLE_PORT, CONSOLE_PORT, CONSOLE_PORT] {
        assert!(lan.enters(port, 100).is_some(), "{case}: port {port}");
    }
    let line = lan.enters(PORT, 100).expect("the line for jobs");
    let mut out = [0; FRAME];
    let length = Request::Hello { client: 10 }.emit(1, &mut out);
    let said = lan.socket(line).send_slice(&out[..length]);
    assert_eq!(said, Ok(length));
    for _ in 0..100 {
        lan.pass();
    }
    let heard = lan.socket(line).recv(|bytes| (bytes.len(), bytes.to_vec()));
    let heard = heard.expect("an answer");
    let (frame, _) = Frame::parse(&heard).expect("a frame").expect("all of it");
    assert_eq!(frame.answer(), Some((Op::Hello, Status::Normal)), "{case}");
}

#[test]
fn over_a_wire_without_faults_everything_arrives() {
    session(1, CLEAN);
}

#[test]
fn over_a_wire_that_loses_frames_every_byte_arrives_once_and_in_order() {
    for seed in 10..18 {
        let lost = 5 + (seed as u32 - 10) * 4;
        session(seed, Faults { lost, ..CLEAN });
    }
}

#[test]
fn over_a_wire_that_doubles_frames_every_byte_arrives_once_and_in_order() {
    for seed in 20..26 {
        let doubled = 20 * (seed as u32 - 19);
        session(seed, Faults { doubled, ..CLEAN });
    }
}

#[test]
fn over_a_wire_that_reorders_frames_every_byte_arrives_once_and_in_order() {
    for seed in 30..36 {
        let late = 15 * (seed as u32 - 29);
        session(seed, Faults { late, ..CLEAN });
    }
}

#[test]
fn over_a_wire_that_does_all_of_it_every_byte_arrives_once_and_in_order() {
    for seed in 40..60 {
        let faults = Faults {
            lost: seed as u32 % 5 * 5,
            doubled: seed as u32 % 3 * 20,
            late: 10 + seed as u32 % 4 * 20,
        };
        session(seed, faults);
    }
}
