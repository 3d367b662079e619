use super::*;
use crate::fake::ALICE;
use proptest::prelude::*;

const US: Us = Us {
    mac: [0x10, 0xe2, 0xd5, 0, 0, 1],
    ip: 0xc0a8_0232,
    port: 1234,
};
/// Where the services listen.
const PORTS: UdpPorts = [68, 5353, 0, 0, 0, 0, 0, 0];
const THEIR_MAC: [u8; 6] = [2, 3, 4, 5, 6, 7];

/// A frame in bytes, read as the MAC's slots are.
struct Bytes(Vec<u8>);

impl Frame for Bytes {
    fn word(&self, index: usize) -> u32 {
        // After the frame there are bytes of an older frame.
        let byte = |at: usize| match at.checked_sub(2) {
            Some(at) => self.0.get(at).copied().unwrap_or(0xa5),
            None => 0x5a, // the two bytes in front are not part of the frame
        };
        u32::from_be_bytes([0, 1, 2, 3].map(|at| byte(4 * index + at)))
    }
}

#[derive(Default)]
struct Words(Vec<u32>);

impl Slot for Words {
    fn put(&mut self, index: usize, word: u32) {
        if self.0.len() <= index {
            self.0.resize(index + 1, 0);
        }
        self.0[index] = word;
    }
}

impl Words {
    /// The bytes as sent: without the two bytes in front.
    fn bytes(&self) -> Vec<u8> {
        let bytes = self.0.iter().flat_map(|word| word.to_be_bytes());
        bytes.skip(2).collect()
    }
}

fn checksum(bytes: &[u8]) -> u16 {
    let mut sum = 0u32;
    for pair in bytes.chunks(2) {
        sum += u32::from(pair[0]) << 8 | u32::from(*pair.get(1).unwrap_or(&0));
    }
    while sum > 0xffff {
        sum = (sum >> 16) + (sum & 0xffff);
    }
    !(sum as u16)
}

/// A textbook implementation, byte by byte, that shares no code with the tested one.
fn udp_frame(payload: &[u8], with_checksum: bool) -> Vec<u8> {
    let udp_length = (8 + payload.len()) as u16;
    let mut ip = vec![0x45, 0, 0, 0, 0x12, 0x34, 0x40, 0, 63, 17, 0, 0];
    ip[2..4].copy_from_slice(&(20 + udp_length).to_be_bytes());
    ip.extend(ALICE.ip.to_be_bytes());
    ip.extend(US.ip.to_be_bytes());
    let sum = checksum(&ip);
    ip[10..12].copy_from_slice(&sum.to_be_bytes());
    let mut udp = Vec::new();
    udp.extend(ALICE.port.to_be_bytes());
    udp.extend(US.port.to_be_bytes());
    udp.extend(udp_length.to_be_bytes());
    udp.extend([0, 0]);
    udp.extend(payload);
    if with_checksum {
        let mut pseudo = ip[12..20].to_vec();
        pseudo.extend([0, 17]);
        pseudo.extend(udp_length.to_be_bytes());
        pseudo.extend(&udp);
        let sum = match checksum(&pseudo) {
            0 => 0xffff,
            sum => sum,
        };
        udp[6..8].copy_from_slice(&sum.to_be_bytes());
    }
    let mut frame = US.mac.to_vec();
    frame.extend(THEIR_MAC);
    frame.extend([8, 0]);
    frame.extend(ip);
    frame.extend(udp);
    frame
}

fn look(frame: &[u8]) -> Class {
    look_at(frame, &US, &PORTS).0
}

/// What it is, and the words of its payload.
fn look_at(frame: &[u8], us: &Us, ports: &UdpPorts) -> (Class, [u32; MAX_WORDS]) {
    let mut payload = [0; MAX_WORDS];
    let frame = (Bytes(frame.to_vec()), frame.len());
    let class = classify(&frame.0, frame.1, us, ports, &mut payload);
    (class, payload)
}

fn with(at: usize, value: u8) -> Vec<u8> {
    let mut frame = udp_frame(&[0; 24], true);
    frame[at] = value;
    frame
}

/// Corrects the IP header's checksum after a change.
fn rechecked(mut frame: Vec<u8>) -> Vec<u8> {
    frame[24..26].fill(0);
    let sum = checksum(&frame[14..34]);
    frame[24..26].copy_from_slice(&sum.to_be_bytes());
    frame
}

#[test]
fn plain_udp_to_our_port_is_ours_with_and_without_checksum() {
    for with_checksum in [false, true] {
        for length in [0, 1, 2, 3, 4, 5, 100, 116, wire::MAX_PAYLOAD, 1472] {
            let payload: Vec<u8> = (0..length).map(|i| (i * 37) as u8).collect();
            let frame = udp_frame(&payload, with_checksum);
            if let Err(why) = payload_words(length) {
                assert_eq!(look(&frame), Class::Refused(why), "{length}");
                continue;
            }
            let expected = Datagram {
                peer: ALICE,
                mac: (0x0203, 0x0405_0607),
                length,
                options: 0,
                service: 0,
                ttl: 63,
            };
            assert_eq!(look(&frame), Class::Ours(expected), "{length}");
        }
    }
}

#[test]
fn payload_words_are_the_payload() {
    let payload: Vec<u8> = (0..40).collect();
    let frame = udp_frame(&payload, true);
    let (_, words) = look_at(&frame, &US, &PORTS);
    for (word, chunk) in words.iter().zip(payload.chunks(4)) {
        assert_eq!(word.to_be_bytes(), *chunk);
    }
}

#[test]
fn ping_tcp_and_arp_about_us_are_left_to_the_services_and_nothing_else_is() {
    let arp = |about: [u8; 4]| {
        let mut frame = with(13, 6);
        frame[38..42].copy_from_slice(&about);
        frame
    };
    for (what, frame, class) in [
        ("another MAC", with(5, 2), Class::Nothing),
        ("broadcast", with(0, 0xff), Class::Nothing),
        ("ARP about us", arp([192, 168, 2, 50]), Class::Services),
        ("ARP about another", arp([192, 168, 2, 51]), Class::Nothing),
        ("IPv6", with(14, 0x65), Class::Nothing),
        ("an IP header too short", with(14, 0x44), Class::Nothing),
        ("more fragments", with(20, 0x20), Class::Nothing),
        ("a fragment's tail", with(21, 1), Class::Nothing),
        ("ICMP", with(23, 1), Class::Services),
        ("TCP", with(23, 6), Class::Services),
        ("another IP", with(33, 0x33), Class::Nothing),
        ("another port", with(37, 80), Class::Nothing),
        (
            "a stub",
            udp_frame(&[], false)[..41].to_vec(),
            Class::Nothing,
        ),
        ("nothing", vec![], Class::Nothing),
    ] {
        assert_eq!(look(&frame), class, "{what}");
    }
}

/// A datagram to this port, MAC and IP address.
fn to(port: u16, mac: [u8; 6], ip: [u8; 4]) -> Vec<u8> {
    let mut frame = udp_frame(&[1, 2, 3, 4], false);
    frame[..6].copy_from_slice(&mac);
    frame[30..34].copy_from_slice(&ip);
    frame[36..38].copy_from_slice(&port.to_be_bytes());
    rechecked(frame)
}

#[test]
fn discovery_and_the_services_ports_are_taken_whatever_address_they_are_sent_to() {
    for port in [51234u16, 68, 5353, 1234, 9, 0] {
        for address in [[255, 255, 255, 255], [10, 0, 0, 255], [192, 168, 2, 50]] {
            let class = look(&to(port, [0xff; 6], address));
            let right = match port {
                51234 => matches!(class, Class::Discovery(_)),
                68 | 5353 => class == Class::Services,
                _ => class == Class::Nothing,
            };
            assert!(right, "port {port} at {address:?}: {class:?}");
            let mut other = US.mac;
            other[5] ^= 1;
            assert_eq!(look(&to(port, other, address)), Class::Nothing);
        }
    }
}

#[test]
fn a_group_is_heard_at_the_services_ports_only_and_not_without_services() {
    let (mac, ip) = ([1, 0, 0x5e, 0, 0, 0xfb], [224, 0, 0, 251]);
    assert_eq!(look(&to(5353, mac, ip)), Class::Services);
    assert_eq!(look(&to(51234, mac, ip)), Class::Nothing);
    assert_eq!(look(&to(1234, mac, [192, 168, 2, 50])), Class::Nothing);
    let mut query = to(5353, [1, 0, 0x5e, 0, 0, 1], [224, 0, 0, 1]);
    query[23] = 2;
    assert_eq!(look(&query), Class::Services, "a router's query");
    let (unheard, _) = look_at(&query, &US, &[0; 8]);
    assert_eq!(unheard, Class::Nothing);
    // The neighbours of that MAC address.
    for mac in [
        [1, 0, 0x5f, 0, 0, 0xfb],
        [0, 0, 0x5e, 0, 0, 0xfb],
        [1, 1, 0x5e, 0, 0, 0xfb],
    ] {
        assert_eq!(look(&to(5353, mac, ip)), Class::Nothing, "{mac:x?}");
    }
}

#[test]
fn without_an_address_only_the_services_ports_and_discovery_are_heard() {
    let us = Us { ip: 0, ..US };
    let look = |frame: Vec<u8>| look_at(&frame, &us, &PORTS).0;
    assert_eq!(look(to(68, US.mac, [10, 0, 0, 9])), Class::Services);
    assert_eq!(look(to(68, [0xff; 6], [255; 4])), Class::Services);
    for protocol in [1, 6] {
        let mut frame = to(68, US.mac, [0; 4]);
        frame[23] = protocol;
        assert_eq!(look(frame), Class::Nothing, "protocol {protocol}");
    }
    let mut arp = with(13, 6);
    arp[38..42].fill(0);
    assert_eq!(look(arp), Class::Nothing);
}

#[test]
fn a_dhcp_servers_frame_is_told_from_others() {
    let comes = |frame: Vec<u8>| comes_from_dhcp(&Bytes(frame));
    let from = |port: u16, mut frame: Vec<u8>| {
        frame[34..36].copy_from_slice(&port.to_be_bytes());
        frame
    };
    assert!(comes(from(67, to(68, [0xff; 6], [255; 4]))));
    assert!(!comes(from(68, to(68, [0xff; 6], [255; 4]))));
    assert!(!comes(from(67, to(5353, [0xff; 6], [255; 4]))));
    let mut tcp = from(67, to(68, US.mac, [192, 168, 2, 50]));
    tcp[23] = 6;
    assert!(!comes(tcp));
}

#[test]
fn a_broadcast_is_addressed_to_all() {
    let mut slot = Words::default();
    let us = Us {
        ip: 0,
        port: 68,
        ..US
    };
    emit_headers(&mut slot, &us, &Datagram::broadcast(67), 300);
    let frame = slot.bytes();
    assert_eq!(frame[..6], [0xff; 6]);
    assert_eq!(
        frame[26..38],
        [0, 0, 0, 0, 255, 255, 255, 255, 0, 68, 0, 67]
    );
    assert_eq!(checksum(&frame[14..34]), 0);
}

#[test]
fn a_wrong_checksum_is_refused_and_none_is_not_wrong() {
    assert_eq!(
        look(&with(22, 9)),
        Class::Refused(Refusal::Checksum),
        "IP header"
    );
    assert_eq!(
        look(&with(60, 9)),
        Class::Refused(Refusal::Checksum),
        "UDP payload"
    );
    let mut frame = udp_frame(&[0; 24], false);
    frame[60] = 9;
    assert!(matches!(look(&frame), Class::Ours(_)));
}

#[test]
fn lengths_that_contradict_each_other_are_refused() {
    let cut = udp_frame(&[0; 24], true);
    assert_eq!(
        look(&cut[..cut.len() - 1]),
        Class::Refused(Refusal::Truncated)
    );
    let mut longer = udp_frame(&[0; 24], true);
    longer.push(0);
    assert_eq!(look(&longer), Class::Refused(Refusal::Truncated));
    for udp_length in [0u8, 7, 31, 33] {
        assert_eq!(
            look(&with(39, udp_length)),
            Class::Refused(Refusal::Truncated),
            "{udp_length}"
        );
    }
    let ip_longer = rechecked(with(17, 53));
    assert_eq!(look(&ip_longer), Class::Refused(Refusal::Truncated));
}

#[test]
fn ip_options_are_stepped_over() {
    for options in 1..=10usize {
        let payload: Vec<u8> = (0..20).collect();
        let mut frame = udp_frame(&payload, true);
        frame[14] = 0x45 + options as u8;
        frame[17] += 4 * options as u8;
        // Eight no-operations, an end of list, and random bytes after it.
        frame.splice(
            34..34,
            (0..4 * options).map(|at| [1, 1, 1, 1, 1, 1, 1, 1, 0, 0xee][at.min(9)]),
        );
        frame[24..26].fill(0);
        let sum = checksum(&frame[14..34 + 4 * options]);
        frame[24..26].copy_from_slice(&sum.to_be_bytes());
        let Class::Ours(datagram) = look(&frame) else {
            panic!("{options}: {:?}", look(&frame));
        };
        assert_eq!(
            (datagram.options, datagram.length, datagram.peer),
            (options, 20, ALICE)
        );
        let (_, words) = look_at(&frame, &US, &PORTS);
        assert_eq!(words[..2], [0x0001_0203, 0x0405_0607]);
        frame[34] ^= 4;
        assert_eq!(look(&frame), Class::Refused(Refusal::Checksum));
    }
}

#[test]
fn ethernet_padding_is_no_payload() {
    let mut frame = udp_frame(&[1, 2, 3, 4], true);
    frame.resize(FRAME_MIN, 0xee);
    assert!(matches!(
        look(&frame),
        Class::Ours(Datagram { length: 4, .. })
    ));
}

#[test]
fn our_answers_satisfy_our_own_checks_seen_from_the_other_side() {
    let Class::Ours(datagram) = look(&udp_frame(&[0; 8], true)) else {
        panic!()
    };
    let mut slot = Words::default();
    emit_headers(&mut slot, &US, &datagram, 8);
    let length = emit_payload(&mut slot, &[0x1122_3344, 0x5566_7788]);
    let bytes = slot.bytes();
    assert_eq!(bytes.len(), length);
    let them = Us {
        mac: THEIR_MAC,
        ip: ALICE.ip,
        port: ALICE.port,
    };
    let (seen, words) = look_at(&bytes, &them, &[0; 8]);
    assert_eq!(words[..2], [0x1122_3344, 0x5566_7788]);
    let expected = Datagram {
        peer: crate::session::Peer {
            ip: US.ip,
            port: US.port,
        },
        mac: (0x10e2, 0xd500_0001),
        length: 8,
        options: 0,
        service: 0,
        ttl: 64,
    };
    assert_eq!(seen, Class::Ours(expected));
    assert_eq!(
        bytes[42..],
        [0x11, 0x22, 0x33, 0x44, 0x55, 0x66, 0x77, 0x88]
    );
}

proptest! {
    #[test]
    fn no_bytes_whatever_panic(bytes in proptest::collection::vec(any::<u8>(), 0..200), at in 0usize..60) {
        let _ = look(&bytes);
        let mut frame = udp_frame(&[0; 20], true);
        let end = (at + bytes.len()).min(frame.len());
        if at < end {
            frame[at..end].copy_from_slice(&bytes[..end - at]);
        }
        let _ = look(&frame);
    }
}
