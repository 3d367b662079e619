//! A third host on the segment that sends frames of all kinds, as many as the wire takes.
//!
//! The owner's datagrams go out between two of its frames. The loss in a switch when both need more
//! than its port has is not tested here.

use crate::{BenchMachine, STRANGER};
use rand::Rng;
use rand::seq::IndexedRandom;
use rand_pcg::Pcg64Mcg;
use sim::gmii;
use sim::lan_segment::{
    BOARD_IP, BOARD_PORT, CONSOLE_PORT, Connection, Endpoint, HOST_IP, HOST_MAC,
};
use sim::rig::{PROMPT, RIG_PORT};
use std::net::Ipv4Addr;
use wire::board::crc32;
use wire::exchange::{Command, Status};
use wire::map;
use wire::regmap::{self, ethmac, rx_admission};

/// The third host.
pub const INTRUDER_IP: Ipv4Addr = Ipv4Addr::new(192, 168, 2, 9);
const INTRUDER: Endpoint = (INTRUDER_IP, STRANGER);
const BROADCAST: [u8; 6] = [0xff; 6];
/// Longest frame of ordinary Ethernet, without FCS.
pub const LONGEST: usize = 1514;
/// Bytes of the longest pings that are answered while the machine moves: frames of 128 bytes on a
/// board with services, and of 256.
const PING_ARMED: [usize; 2] = [86, 214];
/// Bytes in segments of TCP with such frames.
const TCP_ARMED: [usize; 2] = [74, 202];
/// Ports of a server and a client of DHCP, and bytes in the longest frame that is taken from one
/// while the machine moves.
const DHCP: (u16, u16) = (67, 68);
const DHCP_LONGEST: usize = 350 - 42;
/// The status page's port.
const PAGE_PORT: u16 = 80;
/// Addresses and the port of names on the segment.
const NAMES: ([u8; 6], Ipv4Addr) = ([1, 0, 0x5e, 0, 0, 0xfb], Ipv4Addr::new(224, 0, 0, 251));
const NAMES_PORT: u16 = 5353;
/// Addresses of all that take part in groups, and the protocol of questions about them.
const ALL_SYSTEMS: ([u8; 6], Ipv4Addr) = ([1, 0, 0x5e, 0, 0, 1], Ipv4Addr::new(224, 0, 0, 1));
const IGMP: u8 = 2;
/// The port of servers of the time, and their answer's bytes.
const TIME: (u16, usize) = (123, 48);
const UDP: u8 = 17;
/// Servo periods for a handshake with the console.
const HANDSHAKE: usize = 20;
/// More than the pieces of the longest answer of a console, with their acknowledgements.
const PIECES: usize = 200;
/// Turns with a frame at each of these moments.
const TURNS: usize = 4;
/// Bytes a gigabit wire takes in a servo period of a millisecond, gaps and preambles included.
const WIRE_BYTES: u64 = 125_000;

/// A kind of frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Broadcast ARP requests for an address of the segment, sometimes ours.
    Arp,
    /// To the board's port, as short as Etherbone gets.
    ShortRead,
    /// To the board's port, as many of the slowest reads as a frame holds.
    LongRead,
    /// To the board's port, words of any value, 4 to 1472 bytes.
    Garbage,
    /// To any port of the board.
    OtherPort,
    /// From the owner's address, but not its port.
    OwnersAddress,
    /// Broadcast and multicast: mDNS and its like.
    Multicast,
    /// Discovery questions to all boards.
    Discovery,
    /// Shorter than Ethernet allows, its FCS right.
    Runt,
    /// 9018 bytes, its FCS right.
    Jumbo,
    /// Any other kind, with a wrong FCS.
    BadFcs,
    /// 802.3x.
    Pause,
    /// Ping, short or as long as it gets.
    Ping,
    /// The longest ping that is answered while the machine moves, on every board.
    PingArmed,
    /// The longest on a board without services.
    LongPingArmed,
    /// Opens a connection to the console, or pretends to have one.
    Tcp,
    /// The longest segments that are taken while the machine moves, to no connection there is.
    TcpArmed,
    /// Short and long ones at the port of jobs.
    Jobs,
    /// To the port of DHCP clients, as from a server or not, as long as a lease's answer.
    Dhcp,
    /// Questions for the boards of the segment by their service, one or as many as a frame holds
    /// while the machine moves; to all, or to the board's port of names.
    Names,
    /// As from a server of the time.
    Time,
    /// A router asks for the groups that are wanted.
    Groups,
    /// A part of a datagram to the board's port.
    Fragment,
    /// Any of these.
    Mix,
}

/// All of them; [`Kind::Mix`] is the last.
pub const KINDS: [Kind; 24] = [
    Kind::Arp,
    Kind::ShortRead,
    Kind::LongRead,
    Kind::Garbage,
    Kind::OtherPort,
    Kind::OwnersAddress,
    Kind::Multicast,
    Kind::Discovery,
    Kind::Runt,
    Kind::Jumbo,
    Kind::BadFcs,
    Kind::Pause,
    Kind::Ping,
    Kind::PingArmed,
    Kind::LongPingArmed,
    Kind::Tcp,
    Kind::TcpArmed,
    Kind::Jobs,
    Kind::Dhcp,
    Kind::Names,
    Kind::Time,
    Kind::Groups,
    Kind::Fragment,
    Kind::Mix,
];

/// An answer to an exchange.
#[derive(Debug)]
pub struct Answer {
    /// What it said.
    pub status: Status,
    /// From the last request byte to the first reply byte, clocks.
    pub turnaround: u64,
}

/// Preamble, these bytes and their FCS, without padding.
pub fn bare(frame: &[u8]) -> Vec<u8> {
    let mut wire = gmii::PREAMBLE.to_vec();
    wire.extend(frame);
    wire.extend(crc32(frame).to_le_bytes());
    wire
}

/// A frame's addresses and type in front of this.
fn ethernet(to: [u8; 6], from: [u8; 6], kind: u16, rest: &[u8]) -> Vec<u8> {
    [&to[..], &from[..], &kind.to_be_bytes(), rest].concat()
}

/// The Internet's checksum.
pub fn checksum(parts: &[&[u8]]) -> [u8; 2] {
    let bytes = parts.concat();
    let sum: u32 = bytes
        .chunks(2)
        .map(|pair| u32::from(pair[0]) << 8 | pair.get(1).copied().map_or(0, u32::from))
        .sum();
    let folded = (sum >> 16) + (sum & 0xffff);
    (!((folded >> 16) + folded) as u16).to_be_bytes()
}

/// A read of these words.
pub fn read_of(addresses: impl Iterator<Item = u32>) -> Vec<u8> {
    let addresses: Vec<u32> = addresses.collect();
    let mut words = vec![wire::etherbone::HEADER, 0];
    for chunk in addresses.chunks(255) {
        words.extend([wire::etherbone::BYTE_ENABLE | chunk.len() as u32, 0]);
        words.extend(chunk);
    }
    crate::to_bytes(&words)
}

impl BenchMachine {
    /// A frame of this kind as it goes over the wire.
    pub fn frame(&mut self, kind: Kind, rng: &mut Pcg64Mcg) -> Vec<u8> {
        let short = rng.random_bool(0.5);
        match kind {
            Kind::Arp => {
                let last = *[50, 1, 77].choose(rng).unwrap_or(&50);
                gmii::encode(&self.arp(INTRUDER_IP, Ipv4Addr::new(192, 168, 2, last), BROADCAST))
            }
            Kind::ShortRead => {
                let payload = read_of([map::STATUS].into_iter());
                self.udp(INTRUDER, BOARD_PORT, &payload)
            }
            Kind::LongRead => {
                let payload = read_of((0..360).map(|n| map::DESCRIBE + n % 48 * 4));
                self.udp(INTRUDER, BOARD_PORT, &payload)
            }
            Kind::Garbage => {
                let length = if short { 4 } else { rng.random_range(4..=1472) };
                let payload: Vec<u8> = (0..length).map(|_| rng.random()).collect();
                self.udp(INTRUDER, BOARD_PORT, &payload)
            }
            Kind::OtherPort => {
                let payload = vec![0; if short { 4 } else { 1472 }];
                self.udp(INTRUDER, rng.random(), &payload)
            }
            Kind::OwnersAddress => {
                let payload = read_of([map::STATUS].into_iter());
                let port = rng.random_range(1024..RIG_PORT);
                self.udp((HOST_IP, port), BOARD_PORT, &payload)
            }
            Kind::Multicast => self.multicast(short, rng),
            Kind::Discovery => self.discovery(rng.random()),
            Kind::Runt => {
                let whole = self.rig.segment.udp(INTRUDER, BOARD_PORT, &[0; 4]);
                bare(&whole[..rng.random_range(0..whole.len())])
            }
            Kind::Jumbo => {
                let to = self.board_mac();
                let from = self.rig.segment.host_mac(INTRUDER_IP);
                bare(&ethernet(to, from, 0x0800, &[0x45; 9000]))
            }
            Kind::BadFcs => self.bad_fcs(short, rng),
            Kind::Pause => {
                let from = self.rig.segment.host_mac(INTRUDER_IP);
                let rest = [0, 1, 0xff, 0xff];
                gmii::encode(&ethernet([1, 0x80, 0xc2, 0, 0, 1], from, 0x8808, &rest))
            }
            Kind::Ping => self.echo(if short { 8 } else { 1472 }, rng),
            Kind::PingArmed => self.echo(PING_ARMED[0], rng),
            Kind::LongPingArmed => self.echo(PING_ARMED[1], rng),
            Kind::Tcp => self.short_or_long(CONSOLE_PORT, short, rng),
            Kind::TcpArmed => {
                let to = *[CONSOLE_PORT, PAGE_PORT, wire::jobs::PORT, rng.random()]
                    .choose(rng)
                    .unwrap_or(&CONSOLE_PORT);
                // As SYN of a new client, or of a connection that is none.
                let flags = if short { 2 } else { 0x18 };
                let length = *TCP_ARMED.choose(rng).unwrap_or(&0);
                self.tcp(to, flags, length, rng)
            }
            Kind::Jobs => self.short_or_long(wire::jobs::PORT, short, rng),
            Kind::Dhcp => {
                let from = if short { DHCP.0 } else { rng.random() };
                let length = rng.random_range(300..=DHCP_LONGEST);
                self.udp((INTRUDER_IP, from), DHCP.1, &vec![1; length])
            }
            Kind::Names => self.names(short, rng),
            Kind::Time => {
                let (port, length) = TIME;
                let from = if short { port } else { rng.random() };
                let payload: Vec<u8> = (0..length).map(|_| rng.random()).collect();
                self.udp((INTRUDER_IP, from), port, &payload)
            }
            Kind::Groups => {
                // About all groups, or about that of the names.
                let about = if short { [0; 4] } else { NAMES.1.octets() };
                let [a, b] = checksum(&[&[0x11, 10, 0, 0], &about]);
                let question = [&[0x11, 10, a, b], &about[..]].concat();
                let to = if short { ALL_SYSTEMS } else { NAMES };
                gmii::encode(&self.packet(to, INTRUDER_IP, IGMP, 0, &question))
            }
            Kind::Fragment => {
                let fragment = *[0x2000, 0x2001, 0x0001, 0x1fff].choose(rng).unwrap_or(&1);
                gmii::encode(&self.ip(
                    INTRUDER_IP,
                    UDP,
                    fragment,
                    &vec![0; if short { 26 } else { 1480 }],
                ))
            }
            Kind::Mix => {
                let kind = *KINDS[..KINDS.len() - 1].choose(rng).unwrap_or(&Kind::Arp);
                self.frame(kind, rng)
            }
        }
    }

    fn udp(&mut self, from: (Ipv4Addr, u16), port: u16, payload: &[u8]) -> Vec<u8> {
        gmii::encode(&self.rig.segment.udp(from, port, payload))
    }

    fn echo(&mut self, length: usize, rng: &mut Pcg64Mcg) -> Vec<u8> {
        let (payload, number) = (vec![0x5a; length], rng.random());
        let segment = &mut self.rig.segment;
        gmii::encode(&segment.echo_request(INTRUDER_IP, 1, number, &payload))
    }

    fn short_or_long(&mut self, to: u16, short: bool, rng: &mut Pcg64Mcg) -> Vec<u8> {
        let (flags, length) = if short { (2, 0) } else { (rng.random(), 1400) };
        self.tcp(to, flags, length, rng)
    }

    fn tcp(&mut self, to: u16, flags: u8, length: usize, rng: &mut Pcg64Mcg) -> Vec<u8> {
        let data = vec![b'x'; length];
        let tcp = tcp_segment_to(to, rng.random(), flags, rng.random(), 0, &data);
        gmii::encode(&self.ip(INTRUDER_IP, 6, 0, &tcp))
    }

    fn names(&mut self, short: bool, rng: &mut Pcg64Mcg) -> Vec<u8> {
        // PTR, and an answer to the asker alone or to all.
        const NAME: &[u8] = b"\x09_ferrocnc\x04_udp\x05local\0\0\x0c";
        let count = if short { 1 } else { 2 };
        let class = if rng.random_bool(0.5) { 0x8001u16 } else { 1 };
        let question = [NAME, &class.to_be_bytes()].concat();
        let head = [0, 0, 0, 0, 0, count, 0, 0, 0, 0, 0, 0];
        let payload = [&head[..], &question.repeat(usize::from(count))].concat();
        if rng.random_bool(0.5) {
            return self.udp((INTRUDER_IP, NAMES_PORT), NAMES_PORT, &payload);
        }
        let length = (payload.len() + 8) as u16;
        let ports = [NAMES_PORT.to_be_bytes(), NAMES_PORT.to_be_bytes()].concat();
        // A datagram without a checksum.
        let datagram = [&ports[..], &length.to_be_bytes(), &[0, 0], &payload].concat();
        gmii::encode(&self.packet(NAMES, INTRUDER_IP, UDP, 0, &datagram))
    }

    fn multicast(&mut self, short: bool, rng: &mut Pcg64Mcg) -> Vec<u8> {
        let to = *[
            [1, 0, 0x5e, 0, 0, 0xfb],
            [0x33, 0x33, 0, 0, 0, 1],
            BROADCAST,
        ]
        .choose(rng)
        .unwrap_or(&BROADCAST);
        let from = self.rig.segment.host_mac(INTRUDER_IP);
        let rest = vec![0x45; if short { 46 } else { 1500 }];
        gmii::encode(&ethernet(
            to,
            from,
            *[0x0800, 0x86dd, 0x88cc].choose(rng).unwrap_or(&0),
            &rest,
        ))
    }

    /// A question to all boards, as it goes over the wire.
    pub fn discovery(&mut self, nonce: u32) -> Vec<u8> {
        let ask = wire::discovery::Message {
            nonce,
            uid: [0, 0],
            body: wire::discovery::Body::Discover,
        };
        let mut buffer = [0; wire::discovery::WORDS_MAX];
        let payload = crate::to_bytes(ask.emit(&mut buffer));
        let segment = &mut self.rig.segment;
        gmii::encode(&segment.broadcast(INTRUDER, wire::DISCOVERY_PORT, &payload))
    }

    fn bad_fcs(&mut self, short: bool, rng: &mut Pcg64Mcg) -> Vec<u8> {
        let mut wire = if short {
            // The owner's own, spoilt on the way.
            let command = self.enabled_command();
            let bytes = self.command_bytes(&command);
            self.udp((HOST_IP, RIG_PORT), BOARD_PORT, &bytes)
        } else {
            self.frame(Kind::Garbage, rng)
        };
        let at = rng.random_range(gmii::PREAMBLE.len()..wire.len());
        wire[at] ^= 1 << rng.random_range(0..8);
        wire
    }

    /// The board's MAC address, which it told when it started.
    pub fn board_mac(&self) -> [u8; 6] {
        self.rig
            .segment
            .board_mac()
            .expect("the board has answered ARP")
    }

    /// An ARP request by `asks` about this address, in a frame to `to`.
    pub fn arp(&mut self, asks: Ipv4Addr, about: Ipv4Addr, to: [u8; 6]) -> Vec<u8> {
        let from = self.rig.segment.host_mac(asks);
        let rest = [
            &[0, 1, 8, 0, 6, 4, 0, 1][..],
            &from,
            &asks.octets(),
            &[0; 6],
            &about.octets(),
        ];
        ethernet(to, from, 0x0806, &rest.concat())
    }

    /// An IP packet to the board.
    pub fn ip(&mut self, from: Ipv4Addr, protocol: u8, fragment: u16, body: &[u8]) -> Vec<u8> {
        let to = (self.board_mac(), BOARD_IP);
        self.packet(to, from, protocol, fragment, body)
    }

    /// An IP packet to these addresses.
    fn packet(
        &mut self,
        to: ([u8; 6], Ipv4Addr),
        from: Ipv4Addr,
        protocol: u8,
        fragment: u16,
        body: &[u8],
    ) -> Vec<u8> {
        let length = (20 + body.len()) as u16;
        let mut header = [
            &[0x45, 0][..],
            &length.to_be_bytes(),
            &[0, 7],
            &fragment.to_be_bytes(),
            &[64, protocol, 0, 0],
            &from.octets(),
            &to.1.octets(),
        ]
        .concat();
        let sum = checksum(&[&header]);
        header[10..12].copy_from_slice(&sum);
        let mac = self.rig.segment.host_mac(from);
        ethernet(to.0, mac, 0x0800, &[&header[..], body].concat())
    }

    /// A servo period in which these frames and no others are on the wire, the owner's exchange in
    /// front of number `at` of them.
    pub fn period_with(
        &mut self,
        command: &mut Command,
        frames: &[Vec<u8>],
        at: usize,
    ) -> Option<Answer> {
        let end = self.clock() + self.rig.clocks(std::time::Duration::from_millis(1));
        let (before, after) = frames.split_at(at.min(frames.len()));
        for wire in before {
            self.rig.inject_wire(wire.clone());
        }
        let bytes = self.next_command_bytes(command);
        self.rig.post((HOST_IP, RIG_PORT), BOARD_PORT, &bytes);
        for wire in after {
            self.rig.inject_wire(wire.clone());
        }
        self.rig.run(end - self.clock());
        let channels = self.channels();
        self.rig
            .take_datagrams()
            .into_iter()
            .find_map(|(datagram, timing)| {
                let status =
                    Status::parse_reply(&crate::to_words(&datagram.payload), channels).ok()?;
                (status.sequence == command.sequence).then_some(Answer {
                    status,
                    turnaround: timing?.turnaround,
                })
            })
    }

    /// A servo period with the wire full of frames of this kind, the exchange anywhere between
    /// them.
    pub fn period_under(
        &mut self,
        command: &mut Command,
        kind: Kind,
        rng: &mut Pcg64Mcg,
    ) -> Option<Answer> {
        let frames = self.wireful(kind, rng);
        self.period_anywhere(command, &frames, rng)
    }

    /// A servo period with these frames, the exchange anywhere between them, but early enough to be
    /// answered in it.
    pub fn period_anywhere(
        &mut self,
        command: &mut Command,
        frames: &[Vec<u8>],
        rng: &mut Pcg64Mcg,
    ) -> Option<Answer> {
        self.period_with(command, frames, rng.random_range(0..=frames.len() * 2 / 3))
    }

    /// As many frames of this kind as a wire takes in a millisecond, an exchange among them.
    pub fn wireful(&mut self, kind: Kind, rng: &mut Pcg64Mcg) -> Vec<Vec<u8>> {
        let on_wire = |wire: &Vec<u8>| wire.len() as u64 + u64::from(gmii::INTER_FRAME_GAP);
        let mut left = WIRE_BYTES - 250;
        let mut frames = Vec::new();
        while let wire = self.frame(kind, rng)
            && on_wire(&wire) <= left
        {
            left -= on_wire(&wire);
            frames.push(wire);
        }
        frames
    }
}

/// A TCP segment to the console, its checksum right.
pub fn tcp_segment(port: u16, flags: u8, sequence: u32, ack: u32, data: &[u8]) -> Vec<u8> {
    tcp_segment_to(CONSOLE_PORT, port, flags, sequence, ack, data)
}

/// A TCP segment to this port of the board, its checksum right.
fn tcp_segment_to(to: u16, port: u16, flags: u8, sequence: u32, ack: u32, data: &[u8]) -> Vec<u8> {
    let mut tcp = [
        &port.to_be_bytes()[..],
        &to.to_be_bytes(),
        &sequence.to_be_bytes(),
        &ack.to_be_bytes(),
        &[0x50, flags, 0x10, 0, 0, 0, 0, 0],
        data,
    ]
    .concat();
    let length = (tcp.len() as u32).to_be_bytes();
    let sum = checksum(&[
        &INTRUDER_IP.octets(),
        &BOARD_IP.octets(),
        &[0, 6],
        &length[2..],
        &tcp,
    ]);
    tcp[16..18].copy_from_slice(&sum);
    tcp
}

/// Counts of the frames that were sent to the board, by their fate.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Mail {
    /// The CPU got them.
    pub taken: u32,
    /// Guests without a ticket.
    pub guests: u32,
    /// All slots were full.
    pub no_slot: u32,
    /// Wrong preamble.
    pub preamble: u32,
    /// Wrong FCS.
    pub fcs: u32,
}

impl Mail {
    /// What has happened since then.
    pub fn since(&self, then: &Mail) -> Mail {
        Mail {
            taken: self.taken.wrapping_sub(then.taken),
            guests: self.guests.wrapping_sub(then.guests),
            no_slot: self.no_slot.wrapping_sub(then.no_slot),
            preamble: self.preamble.wrapping_sub(then.preamble),
            fcs: self.fcs.wrapping_sub(then.fcs),
        }
    }

    /// Is every one of so many frames counted? One with a wrong FCS that finds no slot either is
    /// counted twice.
    pub fn accounts_for(&self, frames: u64) -> bool {
        let all = [
            self.taken,
            self.guests,
            self.no_slot,
            self.preamble,
            self.fcs,
        ];
        let all: u64 = all.iter().map(|count| u64::from(*count)).sum();
        (all - u64::from(self.fcs)..=all).contains(&frames)
    }
}

impl BenchMachine {
    /// The counts as they stand; reading them is a frame, too, and counted.
    pub fn mail(&mut self) -> Mail {
        let addresses = [
            map::COUNTERS,
            regmap::address(rx_admission::BASE, rx_admission::REFUSED),
            regmap::address(ethmac::BASE, ethmac::SRAM_WRITER_ERRORS),
            regmap::address(ethmac::BASE, ethmac::RX_DATAPATH_PREAMBLE_ERRORS),
            regmap::address(ethmac::BASE, ethmac::RX_DATAPATH_CRC_ERRORS),
        ];
        let words = self.rig.read_words(&addresses).expect("the counters");
        Mail {
            taken: words[0],
            guests: words[1],
            no_slot: words[2],
            preamble: words[3],
            fcs: words[4],
        }
    }

    /// A third host's read.
    pub fn read_frame(&mut self, addresses: impl Iterator<Item = u32>) -> Vec<u8> {
        let payload = read_of(addresses);
        gmii::encode(&self.rig.segment.udp(INTRUDER, BOARD_PORT, &payload))
    }

    /// The owner's host asks the board itself whether it is still where it was.
    pub fn owners_arp(&mut self) -> Vec<u8> {
        let board = self.board_mac();
        let frame = self.arp(HOST_IP, BOARD_IP, board);
        gmii::encode(&frame)
    }

    /// Keeps what the board sends from now on.
    pub fn capture(&mut self) {
        self.rig.capture_frames();
        self.rig.take_frames();
    }

    /// Did it, since [`BenchMachine::capture`]?
    pub fn told_the_owner_its_address(&mut self) -> bool {
        let told = |frame: &Vec<u8>| {
            frame.starts_with(&HOST_MAC) && frame[12..22] == [8, 6, 0, 1, 8, 0, 6, 4, 0, 2]
        };
        self.rig.take_frames().iter().any(told)
    }

    /// A millisecond with the wire full of these frames and somewhere among them an attempt to
    /// acquire the free board.
    pub fn acquires_under(&mut self, kind: Kind, rng: &mut Pcg64Mcg) -> bool {
        let frames = self.wireful(kind, rng);
        let (before, after) = frames.split_at(rng.random_range(0..frames.len()));
        for wire in before {
            self.rig.inject_wire(wire.clone());
        }
        let acquire = [
            wire::etherbone::HEADER,
            0,
            wire::etherbone::BYTE_ENABLE | 1 << 8 | 1,
            map::SESSION_ACQUIRE,
            0x1234_5678,
            0,
            map::SESSION_TOKEN,
        ];
        let from = (HOST_IP, RIG_PORT);
        self.rig.post(from, BOARD_PORT, &crate::to_bytes(&acquire));
        for wire in after {
            self.rig.inject_wire(wire.clone());
        }
        self.rig.run_ms(1);
        let replies = self.rig.take_datagrams();
        replies.iter().any(|(datagram, _)| {
            let token = crate::to_words(&datagram.payload).last().copied();
            datagram.to == from && token.is_some_and(|token| token != 0)
        })
    }

    /// Lets the CPU's clock run again.
    pub fn thaw_cpu(&mut self) {
        self.rig.freeze_cpu(false);
    }

    /// The longest time of an exchange that comes right after one of these lines at the console, or
    /// after a piece of its answer, in clocks.
    pub fn console_costs<'l>(
        &mut self,
        command: &mut Command,
        lines: &[&'l str],
    ) -> Vec<(&'l str, Option<u64>)> {
        let connection = self.console_beside(command);
        let settle = |machine: &mut Self, command: &mut Command| {
            for _ in 0..6 {
                machine.period_with(command, &[], 0);
                machine.rig.segment.recv(connection);
            }
        };
        let mut costs = Vec::new();
        for line in lines {
            settle(self, command);
            let text = format!("{line}\n");
            self.rig.segment.send(connection, text.as_bytes());
            // Out of the host's stack, so that it is on the wire in front of the exchange.
            let clockwork = self.rig.board.clockwork();
            let now = clockwork.microseconds(self.rig.board.now());
            self.rig.segment.poll(now);
            while let Some(frame) = self.rig.segment.take_frame() {
                self.rig.inject_frame(&frame);
            }
            // The answer comes in pieces, after the owner's answers.
            let (mut worst, mut heard) = (Some(0), Vec::new());
            for _ in 0..PIECES {
                let answer = self.period_with(command, &[], 0);
                worst = worst.max(answer.as_ref().map(|answer| answer.turnaround));
                assert!(answer.is_some(), "{line}: no answer");
                heard.extend(self.rig.segment.recv(connection));
                if heard.ends_with(PROMPT.as_bytes()) {
                    break;
                }
            }
            let heard = String::from_utf8_lossy(&heard);
            let whole = heard.ends_with(PROMPT) && !heard.contains("not while armed");
            assert!(whole, "{line}: {heard}");
            costs.push((*line, worst));
        }
        settle(self, command);
        self.rig.segment.close(connection);
        costs
    }
}

/// Frames that come while the services have a turn.
impl BenchMachine {
    /// Opens a connection to the console; the owner goes on meanwhile.
    pub fn console_beside(&mut self, command: &mut Command) -> Connection {
        let connection = self.rig.segment.connect(CONSOLE_PORT);
        for _ in 0..HANDSHAKE {
            self.period_with(command, &[], 0);
        }
        assert!(self.rig.segment.established(connection), "no console");
        connection
    }

    /// The longest time of an exchange that comes with such a frame in front of it while the
    /// services have their turn, in clocks; `None` if one was not answered. They send pieces of
    /// this console's answer meanwhile.
    pub fn costs_in_a_turn(
        &mut self,
        command: &mut Command,
        console: &mut BusyConsole,
        after: u64,
        frame: impl Fn(&mut Self) -> Vec<u8>,
    ) -> Option<u64> {
        let mut worst = 0;
        for _ in 0..TURNS {
            console.go_on(self);
            // A ticket for the guest.
            self.period_with(command, &[], 0)?;
            self.exchange(command);
            self.rig.run(after);
            let wire = frame(self);
            let answer = self.period_with(command, &[wire], 1)?;
            worst = worst.max(answer.turnaround);
        }
        Some(worst)
    }
}

/// A console that is always in the middle of a long answer.
#[derive(Debug)]
pub struct BusyConsole {
    connection: Connection,
    /// What came since the last line was sent.
    heard: Vec<u8>,
}

impl BusyConsole {
    /// Of a console that waits for a line.
    pub fn new(connection: Connection) -> Self {
        BusyConsole {
            connection,
            heard: PROMPT.as_bytes().to_vec(),
        }
    }

    /// Asks again if it has been answered.
    fn go_on(&mut self, machine: &mut BenchMachine) {
        let segment = &mut machine.rig.segment;
        self.heard.extend(segment.recv(self.connection));
        if self.heard.ends_with(PROMPT.as_bytes()) {
            self.heard.clear();
            segment.send(self.connection, b"help\n");
        }
    }
}

/// Raw frames.
impl BenchMachine {
    /// Puts these bytes on the wire after those that are there.
    pub fn inject(&mut self, wire: Vec<u8>) {
        self.rig.inject_wire(wire);
    }

    /// How many datagrams have come from the board since this was last asked.
    pub fn datagrams(&mut self) -> usize {
        self.rig.take_datagrams().len()
    }

    /// A third host's datagram to the board, as a frame without preamble and FCS.
    pub fn datagram_frame(&mut self, payload: &[u8]) -> Vec<u8> {
        self.rig.segment.udp(INTRUDER, BOARD_PORT, payload)
    }

    /// A third host's read of three words, long enough for Ethernet as it is.
    pub fn plain_read(&mut self) -> Vec<u8> {
        self.datagram_frame(&read_of(
            [map::DESCRIBE, map::STATUS, map::SESSION].into_iter(),
        ))
    }

    /// What the meter and the firmware have counted, for a message.
    pub fn history(&mut self) -> String {
        let words: Vec<u32> = (0..30).map(|n| map::COUNTERS + 4 * n).collect();
        let counters = self.rig.read_words(&words);
        let meter = &self.rig.meter;
        format!(
            "requested {}, answered {}, counters {counters:?}",
            meter.requested, meter.answered
        )
    }

    /// Frames sent to the board so far by all hosts, including answers of the host's stack.
    pub fn sent(&self) -> u64 {
        self.rig.frames.to_board
    }
}
