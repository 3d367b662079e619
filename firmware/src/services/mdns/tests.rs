//! Boards on a segment with devices that have their names, and with clients that use another DNS
//! library.

use super::*;
use proptest::prelude::*;
use simple_dns::rdata::RData;
use simple_dns::{CLASS, Name as DnsName, Packet, PacketFlag, QCLASS, QTYPE, TYPE};

const UID: [u32; 2] = [0xd162_0c8a, 0x1b2c_3d4e];
const CLIENT: Party = Party {
    ip: 0xc0a8_0201,
    port: PORT,
};

fn identity(name: &str, last: u32) -> Identity {
    Identity {
        name: wire::Name::new(name).unwrap(),
        uid: [UID[0], UID[1] + last],
        ip: 0xc0a8_0200 + last,
        port: 1234,
    }
}

/// What it sends until this time, each with its time.
fn run(board: &mut Responder, clock: &mut u32, until: u32) -> Vec<(u32, Party, Vec<u8>)> {
    let mut sent = Vec::new();
    while *clock < until {
        *clock += 10;
        let mut room = [0; MESSAGE];
        while let Some((to, length)) = board.poll(*clock, &mut room) {
            sent.push((*clock, to, room[..length].to_vec()));
        }
    }
    sent
}

/// A board that has its name.
fn ready(name: &str) -> (Responder, u32) {
    let mut clock = 1000;
    let mut board = Responder::new(identity(name, 50), clock);
    run(&mut board, &mut clock, 6000);
    assert_eq!(board.phase, Phase::Ready);
    (board, clock)
}

fn question(name: &str, kind: TYPE, unicast: bool) -> Vec<u8> {
    let mut packet = Packet::new_query(0);
    packet.questions.push(simple_dns::Question::new(
        DnsName::new(name).unwrap().into_owned(),
        QTYPE::TYPE(kind),
        QCLASS::CLASS(CLASS::IN),
        unicast,
    ));
    packet.build_bytes_vec().unwrap()
}

/// Every message has to be one for the other library, too.
fn read(bytes: &[u8]) -> Packet<'_> {
    Packet::parse(bytes).expect("a DNS message")
}

fn address(packet: &Packet) -> Option<u32> {
    let mut all = packet.answers.iter().chain(&packet.additional_records);
    all.find_map(|record| match &record.rdata {
        RData::A(a) => Some(a.address),
        _ => None,
    })
}

#[test]
fn a_name_becomes_a_legal_label() {
    for (name, wanted) in [
        ("mill", "mill"),
        ("Fr\u{e4}se 2", "fr-se-2"),
        ("-_-", "ferrocnc-1b2c3d4e"),
        ("", "ferrocnc-1b2c3d4e"),
        ("a.local", "a-local"),
        ("<b>&", "b"),
    ] {
        let name = wire::Name::new(name).unwrap();
        assert_eq!(label(&name, UID), wanted);
    }
}

#[test]
fn it_asks_three_times_and_says_it_twice() {
    let mut clock = 1000;
    let mut board = Responder::new(identity("mill", 50), clock);
    let sent = run(&mut board, &mut clock, 20_000);
    let probes: Vec<_> = sent
        .iter()
        .filter(|(_, _, bytes)| !read(bytes).has_flags(PacketFlag::RESPONSE))
        .collect();
    assert_eq!((probes.len(), sent.len()), (3, 5));
    assert!(probes[0].0 <= 1000 + PROBE_MS + 10);
    assert!(sent.windows(2).all(|two| two[1].0 - two[0].0 >= PROBE_MS));
    for (_, to, bytes) in &probes {
        let packet = read(bytes);
        assert_eq!(*to, ALL_HOSTS);
        assert!(packet.questions.iter().all(|it| it.unicast_response));
        assert_eq!(packet.questions[0].qname.to_string(), "mill.local");
        assert_eq!(packet.name_servers.len(), 3);
    }
    let said = read(&sent[4].2);
    assert_eq!(said.answers.len(), ITEMS.len());
    assert_eq!(address(&said), Some(0xc0a8_0232));
    for record in &said.answers {
        let shared = matches!(record.rdata, RData::PTR(_));
        assert_eq!(record.cache_flush, !shared, "{record:?}");
    }
}

#[test]
fn its_address_is_told_to_the_group_at_once_and_once_a_second() {
    let (mut board, mut clock) = ready("mill");
    let ask = question("MILL.local", TYPE::A, false);
    board.take(&ask, CLIENT, clock);
    let sent = run(&mut board, &mut clock, 6020);
    assert_eq!(sent.len(), 1);
    let (at, to, bytes) = &sent[0];
    assert_eq!((*at, *to), (6010, ALL_HOSTS));
    let packet = read(bytes);
    assert!(packet.questions.is_empty() && packet.id() == 0);
    assert_eq!(address(&packet), Some(0xc0a8_0232));
    board.take(&ask, CLIENT, clock);
    assert!(run(&mut board, &mut clock, 6500).is_empty());
    clock += AGAIN_MS;
    board.take(&ask, CLIENT, clock);
    assert_eq!(run(&mut board, &mut clock, 7600).len(), 1);
}

#[test]
fn a_client_of_plain_dns_gets_its_question_back() {
    let (mut board, mut clock) = ready("mill");
    let from = Party {
        port: 40_000,
        ..CLIENT
    };
    let mut ask = question("mill.local", TYPE::A, false);
    ask[..2].copy_from_slice(&[0x12, 0x34]);
    board.take(&ask, from, clock);
    let sent = run(&mut board, &mut clock, 6200);
    assert_eq!((sent.len(), sent[0].1), (1, from));
    let packet = read(&sent[0].2);
    assert_eq!((packet.id(), packet.questions.len()), (0x1234, 1));
    assert_eq!(address(&packet), Some(0xc0a8_0232));
    for record in packet.answers.iter().chain(&packet.additional_records) {
        assert!(!record.cache_flush && record.ttl <= LEGACY);
    }
}

#[test]
fn a_service_leads_to_the_host_in_one_answer() {
    let (mut board, mut clock) = ready("mill");
    for (service, port) in [("_ferrocnc._udp.local", 1234), ("_http._tcp.local", 80)] {
        board.take(&question(service, TYPE::PTR, true), CLIENT, clock);
        let sent = run(&mut board, &mut clock, 6200);
        assert_eq!((sent.len(), sent[0].1), (1, CLIENT));
        let packet = read(&sent[0].2);
        let RData::PTR(instance) = &packet.answers[0].rdata else {
            panic!("{packet:?}");
        };
        assert_eq!(instance.0.to_string(), format!("mill.{service}"));
        let srv = packet
            .additional_records
            .iter()
            .find_map(|record| match &record.rdata {
                RData::SRV(srv) => Some((srv.port, srv.target.to_string())),
                _ => None,
            });
        assert_eq!(srv, Some((port, "mill.local".to_owned())));
        assert_eq!(address(&packet), Some(0xc0a8_0232));
        clock = 6000;
    }
}

#[test]
fn answers_that_others_may_give_too_wait_a_little() {
    let (mut board, mut clock) = ready("mill");
    let ask = question("_ferrocnc._udp.local", TYPE::PTR, false);
    board.take(&ask, CLIENT, clock);
    let sent = run(&mut board, &mut clock, 6300);
    assert_eq!(sent.len(), 1);
    assert!((6020..=6130).contains(&sent[0].0), "{}", sent[0].0);
}

#[test]
fn what_the_client_knows_is_not_repeated() {
    for (ttl, silent) in [(LONG, true), (LONG / 2, true), (LONG / 2 - 1, false)] {
        let (mut board, mut clock) = ready("mill");
        let bytes = question("_ferrocnc._udp.local", TYPE::PTR, false);
        let mut packet = Packet::parse(&bytes).unwrap();
        let to = DnsName::new("mill._ferrocnc._udp.local").unwrap();
        packet.answers.push(simple_dns::ResourceRecord::new(
            DnsName::new("_ferrocnc._udp.local").unwrap(),
            CLASS::IN,
            ttl,
            RData::PTR(simple_dns::rdata::PTR(to)),
        ));
        // With compression: the names of the answer are jumps.
        let bytes = packet.build_bytes_vec_compressed().unwrap();
        board.take(&bytes, CLIENT, clock);
        let sent = run(&mut board, &mut clock, 6300);
        assert_eq!(sent.is_empty(), silent, "{ttl}");
    }
}

#[test]
fn there_is_no_ipv6_address_and_it_says_so() {
    let (mut board, mut clock) = ready("mill");
    board.take(&question("mill.local", TYPE::AAAA, true), CLIENT, clock);
    let sent = run(&mut board, &mut clock, 6200);
    let packet = read(&sent[0].2);
    assert!(
        matches!(packet.answers[0].rdata, RData::NSEC(_)),
        "{packet:?}"
    );
}

#[test]
fn other_names_and_kinds_are_not_answered() {
    let (mut board, mut clock) = ready("mill");
    for (name, kind) in [
        ("mill2.local", TYPE::A),
        ("mill", TYPE::A),
        ("mill.local.local", TYPE::A),
        ("mill.local", TYPE::MX),
        ("_ferrocnc._tcp.local", TYPE::PTR),
    ] {
        board.take(&question(name, kind, false), CLIENT, clock);
        board.take(&question(name, kind, true), CLIENT, clock);
    }
    assert!(run(&mut board, &mut clock, 8000).is_empty());
}

/// Boards that hear each other. Returns their names in the end.
fn segment(names: &[(&str, u32)], starts: &[u32]) -> Vec<(std::string::String, bool)> {
    let mut boards: Vec<Responder> = names
        .iter()
        .zip(starts)
        .map(|((name, last), start)| Responder::new(identity(name, *last), *start))
        .collect();
    for clock in (0..60_000).step_by(10) {
        for index in 0..boards.len() {
            if clock < starts[index] {
                continue;
            }
            let mut room = [0; MESSAGE];
            if let Some((_, length)) = boards[index].poll(clock, &mut room) {
                let from = Party {
                    ip: boards[index].identity.ip,
                    port: PORT,
                };
                for (other, board) in boards.iter_mut().enumerate() {
                    if other != index && clock >= starts[other] {
                        board.take(&room[..length], from, clock);
                    }
                }
            }
        }
    }
    boards
        .iter()
        .map(|board| (board.name().to_string(), board.settled()))
        .collect()
}

#[test]
fn the_second_board_of_a_name_gets_a_number() {
    let names = segment(
        &[("mill", 50), ("mill", 51), ("mill", 52)],
        &[0, 5000, 9000],
    );
    let wanted = ["mill", "mill-2", "mill-3"].map(|name| (name.to_owned(), true));
    assert_eq!(names, wanted);
}

#[test]
fn boards_switched_on_together_end_with_a_name_each() {
    for last in 0..20 {
        let boards = [("mill", 50), ("mill", 100 + last), ("mill", 150 + last)];
        let mut names = segment(&boards, &[0, 0, 0]);
        names.sort();
        names.dedup();
        assert_eq!(names.len(), 3, "{names:?}");
        assert!(names.iter().all(|(_, settled)| *settled), "{names:?}");
    }
}

#[test]
fn a_long_name_keeps_room_for_its_number() {
    let long = "0123456789abcdef0123456789abcdef";
    let names = segment(&[(long, 50), (long, 51)], &[0, 5000]);
    assert_eq!(names[1].0, format!("{long}-2"));
}

#[test]
fn a_foreign_answer_for_the_name_makes_it_ask_again_and_yield() {
    let (mut board, mut clock) = ready("mill");
    let mut packet = Packet::new_reply(0);
    packet.answers.push(simple_dns::ResourceRecord::new(
        DnsName::new("mill.local").unwrap(),
        CLASS::IN,
        120,
        RData::A(simple_dns::rdata::A { address: 7 }),
    ));
    let bytes = packet.build_bytes_vec().unwrap();
    board.take(&bytes, CLIENT, clock);
    assert!(!board.settled());
    board.take(&bytes, CLIENT, clock);
    run(&mut board, &mut clock, 12_000);
    assert_eq!((board.name(), board.settled()), ("mill-2", true));
}

#[test]
fn a_new_address_is_asked_for_and_announced_and_none_is_silence() {
    let (mut board, mut clock) = ready("mill");
    let mut identity = identity("mill", 50);
    board.settle(identity, clock);
    assert!(board.settled(), "nothing has changed");
    identity.ip = 0;
    board.settle(identity, clock);
    board.take(&question("mill.local", TYPE::A, false), CLIENT, clock);
    assert!(run(&mut board, &mut clock, 9000).is_empty());
    identity.ip = 0x0a00_0007;
    board.settle(identity, clock);
    let sent = run(&mut board, &mut clock, 15_000);
    assert_eq!(address(&read(&sent.last().unwrap().2)), Some(0x0a00_0007));
}

proptest! {
    /// Any bytes, and messages with a few bytes turned over: no panic, at most one message a turn,
    /// and whatever is sent is a message that another library reads.
    #[test]
    fn no_datagram_upsets_it(
        noise in proptest::collection::vec(any::<u8>(), 0..400),
        flips in proptest::collection::vec((any::<usize>(), any::<u8>()), 0..6),
        which in 0..4,
        port in prop_oneof![Just(PORT), any::<u16>()],
    ) {
        let (mut board, mut clock) = ready("mill");
        let mut datagram = match which {
            0 => noise,
            1 => question("mill.local", TYPE::A, false),
            2 => question("_ferrocnc._udp.local", TYPE::PTR, true),
            _ => {
                let mut room = [0; MESSAGE];
                let length = board.say(Items::ALL, 0, &mut room);
                room[..length].to_vec()
            }
        };
        for (at, value) in flips {
            let length = datagram.len().max(1);
            if let Some(byte) = datagram.get_mut(at % length) {
                *byte = value;
            }
        }
        board.take(&datagram, Party { ip: 9, port }, clock);
        for (_, _, bytes) in run(&mut board, &mut clock, 8000) {
            prop_assert!(Packet::parse(&bytes).is_ok());
        }
    }
}
