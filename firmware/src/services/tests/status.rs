//! What the board says of itself: the status page as a browser asks for it, and names as
//! datagrams.

use super::host::{Host, udp_frame};
use super::rig::{Board, US};
use crate::services::mdns;
use serde_json::Value as Json;
use simple_dns::{CLASS, Name, Packet, QCLASS, QTYPE, Question, TYPE};
use smoltcp::wire::{
    EthernetAddress, EthernetFrame, IgmpPacket, IgmpRepr, IpProtocol, Ipv4Address, Ipv4Packet,
    UdpPacket,
};
use std::string::{String, ToString};
use std::vec;
use std::vec::Vec;
use wire::PAGE_PORT;
use wire::mdns::{GROUP, PORT};

const CLIENT: Ipv4Address = Ipv4Address::new(192, 168, 2, 9);
const CLIENT_MAC: EthernetAddress = EthernetAddress([2, 9, 9, 9, 9, 9]);

/// A board that has learned what it says of itself.
fn board() -> Board {
    let mut board = Board::new();
    board.wait(5000);
    board
}

/// What a browser at this port hears.
fn get(board: &mut Board, port: u16, request: &str) -> String {
    let mut host = Host {
        to: PAGE_PORT,
        ..Host::new(7).at(port)
    };
    assert!(host.knocks(board), "a place is free");
    board.frame(&host.nod());
    let heard = host.says(board, request.as_bytes());
    host.leaves(board);
    String::from_utf8(heard).expect("UTF-8")
}

fn content(answer: &str) -> &str {
    answer.split_once("\r\n\r\n").expect("a head").1
}

/// A datagram of mDNS to the group, or to the board alone.
fn datagram(to: u32, payload: &[u8]) -> Vec<u8> {
    between((PORT, PORT), to, payload)
}

/// A datagram of the client between these ports.
fn between(ports: (u16, u16), to: u32, payload: &[u8]) -> Vec<u8> {
    udp_frame((CLIENT_MAC, CLIENT), ports, to, payload)
}

/// The messages of names among these frames; every one is right in all its sums.
fn messages(frames: &[Vec<u8>]) -> Vec<Vec<u8>> {
    let mut all = Vec::new();
    for frame in frames {
        let frame = EthernetFrame::new_checked(frame).expect("Ethernet");
        assert_eq!(frame.dst_addr(), EthernetAddress([1, 0, 0x5e, 0, 0, 251]));
        let ip = Ipv4Packet::new_checked(frame.payload()).expect("IPv4");
        assert!(ip.verify_checksum());
        if ip.next_header() == IpProtocol::Igmp {
            let report = IgmpRepr::parse(&IgmpPacket::new_checked(ip.payload()).expect("IGMP"));
            let group = Ipv4Address::from_bits(GROUP);
            let joined = matches!(report, Ok(IgmpRepr::MembershipReport { group_addr, .. })
                if group_addr == group);
            assert!(joined, "{report:?}");
            continue;
        }
        assert_eq!(ip.hop_limit(), 255, "RFC 6762, 11");
        let udp = UdpPacket::new_checked(ip.payload()).expect("UDP");
        assert!(udp.verify_checksum(&ip.src_addr().into(), &ip.dst_addr().into()));
        assert_eq!((udp.src_port(), udp.dst_port()), (PORT, PORT));
        all.push(udp.payload().to_vec());
    }
    all
}

/// Does a device of this segment ask for the board's address?
fn question(host: &str, kind: TYPE) -> Vec<u8> {
    let mut packet = Packet::new_query(0);
    packet.questions.push(Question::new(
        Name::new(host).expect("a name").into_owned(),
        QTYPE::TYPE(kind),
        QCLASS::CLASS(CLASS::IN),
        false,
    ));
    packet.build_bytes_vec().expect("a message")
}

#[test]
fn a_browser_reads_the_page_and_a_program_reads_the_same_as_json() {
    let mut board = board();
    let page = get(&mut board, 50_000, "GET / HTTP/1.1\r\nHost: x\r\n\r\n");
    assert!(page.starts_with("HTTP/1.1 200 OK\r\n"), "{page}");
    assert!(page.contains("</script>"), "{page}");
    let json = get(&mut board, 50_001, "GET /status.json HTTP/1.0\r\n\r\n");
    let json: Json = serde_json::from_str(content(&json)).expect("JSON");
    assert!(json["machine"].is_object(), "{json}");
    let log = get(&mut board, 50_002, "GET /log HTTP/1.0\r\n\r\n");
    assert!(content(&log).contains("firmware started"), "{log}");
}

#[test]
fn a_request_in_single_bytes_is_one_too() {
    let mut board = board();
    let mut host = Host {
        to: PAGE_PORT,
        ..Host::new(7)
    };
    assert!(host.knocks(&mut board));
    board.frame(&host.nod());
    let mut heard = Vec::new();
    for byte in b"GET /status.json HTTP/1.0\r\n\r\n" {
        heard.extend(host.says(&mut board, &[*byte]));
    }
    let heard = String::from_utf8(heard).expect("UTF-8");
    serde_json::from_str::<Json>(content(&heard)).expect("JSON");
}

#[test]
fn while_a_host_moves_the_machine_the_page_is_busy_and_says_when_to_come_again() {
    let mut board = board();
    board.rom.moving = true;
    let said = get(&mut board, 50_000, "GET / HTTP/1.1\r\nHost: x\r\n\r\n");
    assert!(said.starts_with("HTTP/1.1 503 "), "{said}");
    assert!(said.contains("Retry-After: 2\r\n"), "{said}");
    board.rom.moving = false;
    let said = get(&mut board, 50_001, "GET / HTTP/1.1\r\nHost: x\r\n\r\n");
    assert!(said.starts_with("HTTP/1.1 200 "), "{said}");
}

#[test]
fn readers_that_say_nothing_leave_their_places_within_five_seconds() {
    let mut board = board();
    for port in [50_000, 50_001] {
        let mut silent = Host {
            to: PAGE_PORT,
            ..Host::new(7).at(port)
        };
        assert!(silent.knocks(&mut board));
        board.frame(&silent.nod());
    }
    let mut third = Host {
        to: PAGE_PORT,
        ..Host::new(8)
    };
    assert!(!third.knocks(&mut board), "both places are taken");
    board.wait(5100);
    let page = get(&mut board, 50_002, "GET / HTTP/1.0\r\n\r\n");
    assert!(page.starts_with("HTTP/1.1 200 OK\r\n"), "{page}");
}

#[test]
fn a_board_asks_three_times_for_its_name_and_announces_it_twice() {
    let board = board();
    let all = messages(&board.rom.announced);
    let all: Vec<_> = all
        .iter()
        .map(|message| Packet::parse(message).expect("a DNS message"))
        .collect();
    let probes = all.iter().filter(|packet| !packet.questions.is_empty());
    let announced = all.iter().filter(|packet| !packet.answers.is_empty());
    assert_eq!((probes.count(), announced.count()), (3, 2));
}

#[test]
fn a_board_has_a_name_a_second_after_its_start() {
    // Up to 250 ms, and three probes with 250 ms behind each; nothing is waited for before.
    let mut board = Board::new();
    board.wait(1_100);
    let name = board_name(&board);
    assert!(name.starts_with("ferrocnc-"), "{name}");
    assert!(get(&mut board, 50_000, "GET /status.json HTTP/1.0\r\n\r\n").contains(&name[..17]));
}

#[test]
fn a_question_for_the_name_is_answered_to_the_group() {
    let mut board = board();
    let name = board_name(&board);
    board.wait(2000);
    board.rom.announced.clear();
    board.frame(&datagram(GROUP, &question(&name, TYPE::A)));
    board.wait(200);
    let answers = messages(&board.rom.announced);
    let answer = Packet::parse(answers.last().expect("an answer")).expect("a DNS message");
    assert!(answer.answers.iter().any(|it| it.name.to_string() == name));
}

/// The name it has announced.
fn board_name(board: &Board) -> String {
    let all = messages(&board.rom.announced);
    let mut names = all.iter().filter_map(|message| {
        let packet = Packet::parse(message).ok()?;
        let mut addresses = packet.answers.iter();
        let address = addresses.find(|it| it.rdata.type_code() == TYPE::A)?;
        Some(address.name.to_string())
    });
    names.next().expect("a name")
}

#[test]
fn while_a_host_moves_the_machine_names_are_not_answered_and_nothing_piles_up() {
    let mut board = board();
    let name = board_name(&board);
    board.wait(2000);
    board.rom.announced.clear();
    board.rom.moving = true;
    for _ in 0..50 {
        board.frame(&datagram(GROUP, &question(&name, TYPE::A)));
        board.wait(20);
    }
    assert!(board.rom.announced.is_empty());
    board.rom.moving = false;
    board.wait(1000);
    assert!(board.rom.announced.is_empty(), "an answer that is too late");
}

#[test]
fn garbage_at_the_port_of_names_disturbs_no_console() {
    let mut board = board();
    let mut visitor = super::host::visitor(&mut board, 1);
    for length in [0, 1, 11, 12, 13, 300, mdns::MESSAGE, 1472] {
        for to in [GROUP, US.ip] {
            board.frame(&datagram(to, &vec![0xff; length]));
        }
        assert!(visitor.is_heard(&mut board), "{length} bytes");
    }
}

#[test]
fn what_comes_to_the_port_of_dhcp_clients_without_one_has_no_answer() {
    let mut board = board();
    for (from, length) in [(67, 300), (68, 300), (4000, 4)] {
        let sent = board.frame(&between((from, 68), US.ip, &vec![1; length]));
        assert_eq!(sent, Vec::<Vec<u8>>::new(), "from port {from}");
    }
    let sent = board.frame(&between((4000, 69), US.ip, &[1; 4]));
    assert_ne!(sent, Vec::<Vec<u8>>::new(), "another port is closed");
}
