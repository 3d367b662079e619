use super::*;
use crate::machine::{VISIT_WORDS, Verb, Verdict};
use crate::net::Us;
use ::jobs::Outside;
use smoltcp::phy::ChecksumCapabilities;
use smoltcp::wire::{
    DhcpMessageType, DhcpPacket, DhcpRepr, EthernetAddress, EthernetFrame, EthernetProtocol,
    IpAddress, IpProtocol, Ipv4Address, Ipv4Packet, Ipv4Repr, UdpPacket, UdpRepr,
};
use std::collections::VecDeque;

const MAC: [u8; 6] = [2, 0, 0, 0, 0, 7];
const SERVER: Ipv4Address = Ipv4Address::new(10, 7, 0, 1);
const GIVEN: Ipv4Address = Ipv4Address::new(10, 7, 0, 55);

/// A board that only has a network: what it sent, and what it was told.
#[derive(Default)]
struct Board {
    ip: u32,
    sent: VecDeque<Vec<u8>>,
    leased: Vec<Option<Lease>>,
}

impl Outside for Board {
    fn datagram(&mut self, _: &[u32], _: &mut [u32; wire::MAX_WORDS]) -> usize {
        0
    }
    fn read_segments(&mut self, _: usize) -> u32 {
        0
    }
    fn write_segments(&mut self, _: usize, _: u32) {}
    fn now(&mut self) -> u64 {
        0
    }
}

impl Network for Board {
    fn send_frame(&mut self, frame: &[u8]) {
        self.sent.push_back(frame.to_vec());
    }
    fn us(&mut self) -> Us {
        let (mac, port) = (MAC, 1234);
        Us {
            mac,
            ip: self.ip,
            port,
        }
    }
    fn leased(&mut self, lease: Option<Lease>) {
        self.ip = lease.map_or(0, |lease| lease.ip);
        self.leased.push(lease);
    }
    fn console(&mut self, _: usize, _: Verb, _: &mut [u32; VISIT_WORDS]) -> Verdict {
        Verdict::NotNow
    }
}

/// A message of the client: its type, the number of the exchange, its name, and the sender's
/// address.
fn read(frame: &[u8]) -> Option<(DhcpMessageType, u32, Vec<u8>, Ipv4Address)> {
    let frame = EthernetFrame::new_checked(frame).ok()?;
    if frame.ethertype() != EthernetProtocol::Ipv4 {
        return None;
    }
    let ip = Ipv4Packet::new_checked(frame.payload()).ok()?;
    let udp = UdpPacket::new_checked(ip.payload()).ok()?;
    assert_eq!((udp.src_port(), udp.dst_port()), (PORT, SERVER_PORT));
    let packet = DhcpPacket::new_checked(udp.payload()).ok()?;
    let mut options = packet.options();
    let name = options.find(|option| option.kind == HOST_NAME);
    let name = name.map_or(&[][..], |option| option.data).to_vec();
    let repr = DhcpRepr::parse(&packet).ok()?;
    assert_eq!(repr.client_hardware_address, EthernetAddress(MAC));
    Some((repr.message_type, repr.transaction_id, name, ip.src_addr()))
}

/// A server's answer, as a broadcast.
fn answer(kind: DhcpMessageType, number: u32, seconds: u32) -> Vec<u8> {
    let repr = DhcpRepr {
        message_type: kind,
        transaction_id: number,
        secs: 0,
        client_hardware_address: EthernetAddress(MAC),
        client_ip: Ipv4Address::UNSPECIFIED,
        your_ip: GIVEN,
        server_ip: SERVER,
        router: Some(SERVER),
        subnet_mask: Some(Ipv4Address::new(255, 255, 255, 0)),
        relay_agent_ip: Ipv4Address::UNSPECIFIED,
        broadcast: true,
        requested_ip: None,
        client_identifier: None,
        server_identifier: Some(SERVER),
        parameter_request_list: None,
        dns_servers: None,
        max_size: None,
        lease_duration: Some(seconds),
        renew_duration: None,
        rebind_duration: None,
        additional_options: &[],
    };
    let all = Ipv4Address::BROADCAST;
    let udp = UdpRepr {
        src_port: SERVER_PORT,
        dst_port: PORT,
    };
    let length = repr.buffer_len();
    let ip = Ipv4Repr {
        src_addr: SERVER,
        dst_addr: all,
        next_header: IpProtocol::Udp,
        payload_len: 8 + length,
        hop_limit: 64,
    };
    let sums = ChecksumCapabilities::default();
    let mut bytes = vec![0; 14 + 20 + 8 + length];
    let mut frame = EthernetFrame::new_unchecked(&mut bytes);
    frame.set_dst_addr(EthernetAddress::BROADCAST);
    frame.set_src_addr(EthernetAddress([2, 0, 0, 0, 0, 1]));
    frame.set_ethertype(EthernetProtocol::Ipv4);
    let mut packet = Ipv4Packet::new_unchecked(frame.payload_mut());
    ip.emit(&mut packet, &sums);
    let (from, to) = (IpAddress::Ipv4(SERVER), IpAddress::Ipv4(all));
    udp.emit(
        &mut UdpPacket::new_unchecked(packet.payload_mut()),
        &from,
        &to,
        length,
        |body| {
            repr.emit(&mut DhcpPacket::new_unchecked(body))
                .expect("room")
        },
        &sums,
    );
    bytes
}

/// A client, its stack, its board, and the time.
struct Bench {
    client: Client<'static>,
    stack: Stack,
    board: Board,
    ms: i64,
}

impl Bench {
    fn new(name: &str) -> Self {
        let mut board = Board::default();
        let place = Box::leak(Box::new(Place::new()));
        Bench {
            client: Client::new(place, &Name::new(name).expect("a name")),
            stack: Stack::new(7, &mut board),
            board,
            ms: 0,
        }
    }

    /// So much time passes, a turn every 10 ms. Frames that the board sends go to `serve`.
    fn pass(&mut self, ms: i64, mut serve: impl FnMut(&[u8], i64) -> Option<Vec<u8>>) {
        let until = self.ms + ms;
        while self.ms < until {
            self.ms += 10;
            let now = Instant::from_millis(self.ms);
            let us = self.board.us();
            self.stack.settle(us);
            self.client.turn(&mut self.stack, now, &mut self.board);
            while let Some(frame) = self.board.sent.pop_front() {
                if let Some(answer) = serve(&frame, self.ms) {
                    let board = &mut self.board;
                    self.client.take(&answer, &mut self.stack, now, board);
                }
            }
        }
    }
}

/// A server that gives leases of this many seconds.
fn serve(seconds: u32) -> impl FnMut(&[u8], i64) -> Option<Vec<u8>> {
    move |frame, _| {
        let (kind, number, ..) = read(frame)?;
        match kind {
            DhcpMessageType::Discover => Some(answer(DhcpMessageType::Offer, number, seconds)),
            DhcpMessageType::Request => Some(answer(DhcpMessageType::Ack, number, seconds)),
            other => panic!("{other:?}"),
        }
    }
}

#[test]
fn a_server_gives_an_address_and_reads_the_boards_name() {
    let mut bench = Bench::new("mill");
    let mut names = Vec::new();
    let mut server = serve(3600);
    bench.pass(1000, |frame, ms| {
        names.push(read(frame).expect("a message").2);
        server(frame, ms)
    });
    let lease = Lease {
        ip: GIVEN.to_bits(),
        prefix: 24,
        gateway: SERVER.to_bits(),
    };
    assert_eq!(bench.board.leased, [Some(lease)]);
    assert_eq!(names, vec![b"mill".to_vec(); 2], "discover and request");
}

#[test]
fn without_a_server_it_asks_three_times_in_ten_seconds_and_goes_on() {
    let mut bench = Bench::new("");
    let mut asked = Vec::new();
    bench.pass(10_000, |frame, ms| {
        let (kind, _, name, from) = read(frame).expect("a message");
        assert_eq!((kind, name.len()), (DhcpMessageType::Discover, 0));
        assert!(from.is_unspecified());
        asked.push(ms);
        None
    });
    assert!(asked.len() >= 3, "asked at {asked:?}");
    bench.pass(60_000, serve(3600));
    assert_eq!(bench.board.leased.len(), 1, "a server that comes later");
}

#[test]
fn a_lease_is_renewed_for_a_day_and_lost_when_the_server_is() {
    let mut bench = Bench::new("mill");
    bench.pass(1000, serve(600));
    // A renewal goes to the server itself, whose MAC address smoltcp knows from nowhere yet.
    let mut messages = 0;
    let mut server = serve(600);
    let mut arp = 0;
    bench.pass(86_400_000, |frame, ms| {
        if frame[12..14] == [8, 6] {
            arp += 1;
            let mut reply = vec![];
            reply.extend(&frame[6..12]);
            reply.extend([2, 0, 0, 0, 0, 1, 8, 6, 0, 1, 8, 0, 6, 4, 0, 2]);
            reply.extend([2, 0, 0, 0, 0, 1]);
            reply.extend(SERVER.octets());
            reply.extend(&frame[6..12]);
            reply.extend(&frame[28..32]);
            return Some(reply);
        }
        messages += 1;
        server(frame, ms)
    });
    assert!(bench.board.leased.iter().all(Option::is_some));
    // Half of ten minutes, a day long.
    assert!(
        (280..=300).contains(&messages),
        "{messages} renewals, {arp} ARP"
    );
    bench.pass(1_300_000, |_, _| None);
    assert_eq!(bench.board.leased.last(), Some(&None), "it is over");
    assert_eq!(bench.board.ip, 0);
}
