//! A syslog server and one of the time, on the segment of a board that has both addresses among its
//! settings: from an event to the datagram on the wire, and from the question for the time to the
//! date in the log.

use super::host::{Host, udp_frame};
use super::rig::{Board, US};
use crate::services::{sntp, syslog};
use smoltcp::phy::ChecksumCapabilities;
use smoltcp::wire::{
    ArpOperation, ArpPacket, ArpRepr, EthernetAddress, EthernetFrame, EthernetProtocol, IpProtocol,
    Ipv4Address, Ipv4Packet, Ipv4Repr, UdpPacket, UdpRepr,
};
use std::string::String;
use std::vec;
use std::vec::Vec;
use wire::PAGE_PORT;
use wire::settings::Settings;

type Party = (EthernetAddress, Ipv4Address);

const EVENTS: Party = party(1);
const TIME: Party = party(3);
/// 2023-11-14T22:13:20Z, in seconds since 1900.
const SECONDS: u32 = 2_208_988_800 + 1_700_000_000;
/// What the log has of an e-stop, and how bad it is.
const TRIPPED: &str = "e-stop tripped";
const WARNING: &str = "<132>1 ";

const fn party(last: u8) -> Party {
    (
        EthernetAddress([2, 7, 7, 7, 7, last]),
        Ipv4Address::new(192, 168, 2, last),
    )
}

/// A board, and the two servers beside it.
struct LanSegment {
    board: Board,
    /// They answer questions for their addresses.
    there: bool,
    /// The messages of syslog.
    events: Vec<String>,
    /// The questions for the time, and when they came.
    questions: Vec<(u64, Vec<u8>)>,
    /// How often the board has asked for a server's hardware address.
    looked_for: u32,
}

impl LanSegment {
    fn new() -> Self {
        let settings = Settings {
            syslog: EVENTS.1.to_bits(),
            sntp: TIME.1.to_bits(),
            ..Settings::BUILT_IN
        };
        LanSegment {
            board: Board::with_settings(&settings),
            there: true,
            events: Vec::new(),
            questions: Vec::new(),
            looked_for: 0,
        }
    }

    /// Time passes; the servers hear what is for them.
    fn wait(&mut self, ms: u64) {
        let end = self.board.ms() + ms;
        while self.board.ms() < end {
            for (_, frame) in self.board.wait(10) {
                self.hears(&frame);
            }
        }
    }

    fn hears(&mut self, bytes: &[u8]) {
        let frame = EthernetFrame::new_checked(bytes).expect("Ethernet");
        if frame.ethertype() == EthernetProtocol::Arp {
            return self.where_is(&frame);
        }
        let sums = ChecksumCapabilities::default();
        let packet = Ipv4Packet::new_checked(frame.payload()).expect("IPv4");
        let ip = Ipv4Repr::parse(&packet, &sums).expect("a right header");
        assert_eq!(ip.next_header, IpProtocol::Udp);
        let packet = UdpPacket::new_checked(packet.payload()).expect("UDP");
        let (from, to) = (ip.src_addr.into(), ip.dst_addr.into());
        let udp = UdpRepr::parse(&packet, &from, &to, &sums).expect("a right datagram");
        assert_eq!(ip.src_addr, Ipv4Address::from_bits(US.ip));
        assert_eq!(udp.src_port, udp.dst_port);
        let payload = packet.payload().to_vec();
        match ((frame.dst_addr(), ip.dst_addr), udp.dst_port) {
            (EVENTS, syslog::PORT) => {
                self.events.push(String::from_utf8(payload).expect("UTF-8"));
            }
            (TIME, sntp::PORT) => self.questions.push((self.board.ms(), payload)),
            (to, port) => panic!("to {to:?}, port {port}"),
        }
    }

    /// A question for a server's hardware address, and the answer.
    fn where_is(&mut self, frame: &EthernetFrame<&[u8]>) {
        let arp = ArpPacket::new_checked(frame.payload()).expect("ARP");
        let Ok(ArpRepr::EthernetIpv4 {
            target_protocol_addr: ip,
            ..
        }) = ArpRepr::parse(&arp)
        else {
            panic!("{arp:?}");
        };
        assert_eq!(arp.operation(), ArpOperation::Request);
        self.looked_for += 1;
        let party = [EVENTS, TIME].into_iter().find(|party| party.1 == ip);
        let (mac, _) = party.expect("a server");
        if !self.there {
            return;
        }
        let us = EthernetAddress(US.mac);
        let answer = ArpRepr::EthernetIpv4 {
            operation: ArpOperation::Reply,
            source_hardware_addr: mac,
            source_protocol_addr: ip,
            target_hardware_addr: us,
            target_protocol_addr: Ipv4Address::from_bits(US.ip),
        };
        let mut bytes = vec![0; 14 + answer.buffer_len()];
        let mut frame = EthernetFrame::new_unchecked(&mut bytes);
        frame.set_src_addr(mac);
        frame.set_dst_addr(us);
        frame.set_ethertype(EthernetProtocol::Arp);
        answer.emit(&mut ArpPacket::new_unchecked(frame.payload_mut()));
        for frame in self.board.frame(&bytes) {
            self.hears(&frame);
        }
    }

    /// The server of the time answers the last question.
    fn says_the_time(&mut self) {
        let (_, question) = self.questions.last().expect("a question");
        let mut answer = [0; sntp::PACKET];
        // Version 4, a server whose clock is set; stratum 2.
        (answer[0], answer[1]) = (4 << 3 | 4, 2);
        answer[24..32].copy_from_slice(&question[40..]);
        answer[40..44].copy_from_slice(&SECONDS.to_be_bytes());
        let ports = (sntp::PORT, sntp::PORT);
        self.board.frame(&udp_frame(TIME, ports, US.ip, &answer));
    }

    /// The log, as the status page has it.
    fn log(&mut self) -> String {
        let mut reader = Host {
            to: PAGE_PORT,
            ..Host::new(7)
        };
        assert!(reader.knocks(&mut self.board), "a place is free");
        self.board.frame(&reader.nod());
        let log = reader.says(&mut self.board, b"GET /log HTTP/1.0\r\n\r\n");
        reader.leaves(&mut self.board);
        String::from_utf8(log).expect("UTF-8")
    }
}

#[test]
fn an_event_is_a_datagram_of_syslog_and_has_the_date_once_a_server_has_said_the_time() {
    let mut segment = LanSegment::new();
    segment.wait(5_000);
    // Services that have just started have no name yet.
    let started = "firmware started: reboot requested";
    assert_eq!(segment.events.len(), 1, "{:?}", segment.events);
    assert!(segment.events[0].starts_with("<134>1 - "));
    assert!(segment.events[0].ends_with(started), "{:?}", segment.events);
    segment.board.rom.estop(true);
    segment.wait(200);
    let name = "ferrocnc-05060708";
    let event = |date: &str| std::format!("{WARNING}{date} {name} ferrocnc 9 - - {TRIPPED}");
    assert_eq!(segment.events[1..], [event("-")]);

    let (_, question) = segment.questions.first().expect("a question");
    assert_eq!((question.len(), question[0]), (48, 4 << 3 | 3));
    assert_ne!(question[40..], [0; 8], "a stamp that an answer repeats");
    segment.says_the_time();
    segment.board.rom.estop(false);
    segment.wait(61_000);
    segment.board.rom.estop(true);
    segment.wait(200);
    // What comes while a host moves the machine is sent, too.
    segment.board.rom.moving = true;
    segment.wait(800);
    segment.board.rom.estop(false);
    segment.wait(200);
    segment.board.rom.moving = false;
    assert_eq!(segment.events.len(), 5, "{:#?}", segment.events);
    assert_eq!(segment.events[3], event("2023-11-14T22:14:21Z"));
    let cleared = "2023-11-14T22:14:22Z ferrocnc-05060708 ferrocnc 9 - - e-stop cleared";
    assert!(segment.events[4].ends_with(cleared), "{:?}", segment.events);
    let log = segment.log();
    let line = |date: &str| {
        log.lines()
            .any(|it| it.contains(date) && it.ends_with(TRIPPED))
    };
    assert!(line("2023-11-14T22:14:21Z"), "{log}");
}

#[test]
fn the_time_is_asked_for_again_until_it_is_answered_and_then_once_an_hour() {
    let mut segment = LanSegment::new();
    segment.wait(60_000);
    let [first, second, third] = &segment.questions[..] else {
        panic!("{:?}", segment.questions);
    };
    // The first one waits for the server's hardware address.
    assert!((15_000..=16_020).contains(&(second.0 - first.0)));
    assert!((31_980..=32_020).contains(&(third.0 - second.0)));
    segment.says_the_time();
    segment.wait(3_599_000);
    assert_eq!(segment.questions.len(), 3);
    segment.wait(2_000);
    assert_eq!(segment.questions.len(), 4);
}

#[test]
fn servers_that_are_not_there_are_looked_for_once_a_second_and_hold_up_no_client() {
    let mut segment = LanSegment::new();
    segment.there = false;
    segment.wait(20_000);
    assert!(
        (10..=20).contains(&segment.looked_for),
        "{}",
        segment.looked_for
    );
    assert!(segment.events.is_empty() && segment.questions.is_empty());
    assert!(segment.log().contains("firmware started"));
    segment.there = true;
    segment.wait(3_000);
    assert_eq!(segment.events.len(), 1, "{:?}", segment.events);
    // The one that waited, and the one that has become due.
    assert_eq!(segment.questions.len(), 2);
    segment.says_the_time();
    segment.board.rom.estop(true);
    segment.wait(200);
    assert!(segment.events[1].starts_with("<132>1 2023-11-14T22:13:2"));
}
