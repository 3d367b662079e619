//! The virtual Ethernet segment at the board's cable: any number of hosts, their ARP, ICMP echo and
//! TCP.
//!
//! UDP goes in and out as datagrams with the times of their first and last byte on the wire; TCP is
//! a smoltcp stack living at [`HOST_IP`]. No TAP, no root: the machine's own network is never
//! touched. It knows neither exchanges nor sockets of the machine ([`crate::server`] does), and its
//! clock is simulated time.

use std::collections::{HashMap, VecDeque};
use std::net::Ipv4Addr;

use smoltcp::iface::{Config, Interface, SocketHandle, SocketSet};
use smoltcp::phy::{ChecksumCapabilities, Device, DeviceCapabilities, Medium, RxToken, TxToken};
use smoltcp::socket::tcp;
use smoltcp::time::Instant;
use smoltcp::wire::{
    ArpOperation, ArpPacket, ArpRepr, EthernetAddress, EthernetFrame, EthernetProtocol,
    EthernetRepr, HardwareAddress, Icmpv4Packet, Icmpv4Repr, IpAddress, IpCidr, IpEndpoint,
    IpProtocol, Ipv4Packet, Ipv4Repr, UdpPacket, UdpRepr,
};

/// The host at the other end of the cable.
pub const HOST_IP: Ipv4Addr = Ipv4Addr::new(192, 168, 2, 1);
/// Its hardware address, locally administered.
pub const HOST_MAC: [u8; 6] = [0x02, 0xfc, 0, 0, 0x02, 0x01];
/// Where a board answers until told otherwise.
pub const BOARD_IP: Ipv4Addr = Ipv4Addr::new(192, 168, 2, 50);
/// The board's Etherbone port until told otherwise.
pub const BOARD_PORT: u16 = wire::DEFAULT_PORT;
/// The board's debug console.
pub const CONSOLE_PORT: u16 = wire::CONSOLE_PORT;

/// Largest UDP payload in one frame: 1500 bytes of MTU, less the IPv4 and UDP headers.
pub const MAX_UDP: usize = wire::MAX_PAYLOAD;

/// An address and a port.
pub type Endpoint = (Ipv4Addr, u16);

/// A UDP datagram from the board.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Datagram {
    /// The sender.
    pub from: Endpoint,
    /// The receiver.
    pub to: Endpoint,
    /// What it says.
    pub payload: Vec<u8>,
    /// Start of its first preamble byte on the wire, ticks.
    pub first: u64,
    /// End of its last FCS byte, ticks.
    pub last: u64,
    /// Bytes on the wire, preamble and FCS included.
    pub wire_len: usize,
}

/// An ICMP echo reply from the board.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Echo {
    /// Identifier of the request.
    pub ident: u16,
    /// Sequence number of the request.
    pub seq_no: u16,
    /// What came back.
    pub payload: Vec<u8>,
    /// See [`Datagram::first`].
    pub first: u64,
}

/// A TCP connection to the board.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Connection(SocketHandle);

/// Frames between smoltcp and the segment.
#[derive(Debug, Default)]
struct Port {
    rx: VecDeque<Vec<u8>>,
    tx: VecDeque<Vec<u8>>,
}

struct Taken(Vec<u8>);
struct Put<'a>(&'a mut VecDeque<Vec<u8>>);

impl RxToken for Taken {
    fn consume<R, F: FnOnce(&[u8]) -> R>(self, f: F) -> R {
        f(&self.0)
    }
}

impl TxToken for Put<'_> {
    fn consume<R, F: FnOnce(&mut [u8]) -> R>(self, len: usize, f: F) -> R {
        let mut frame = vec![0; len];
        let result = f(&mut frame);
        self.0.push_back(frame);
        result
    }
}

impl Device for Port {
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
        let mut caps = DeviceCapabilities::default();
        caps.medium = Medium::Ethernet;
        caps.max_transmission_unit = 1514;
        caps.checksum = ChecksumCapabilities::default();
        caps
    }
}

/// The segment.
pub struct LanSegment {
    board_ip: Ipv4Addr,
    board_mac: Option<[u8; 6]>,
    hosts: HashMap<Ipv4Addr, [u8; 6]>,
    port: Port,
    iface: Interface,
    sockets: SocketSet<'static>,
    datagrams: VecDeque<Datagram>,
    echoes: VecDeque<Echo>,
    next_local_port: u16,
    /// The time to live of the datagrams of every host from now on.
    pub ttl: u8,
    /// Frames from the board that were nothing the segment understands.
    pub odd_frames: u64,
}

impl std::fmt::Debug for LanSegment {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("LanSegment")
            .field("board_ip", &self.board_ip)
            .field("board_mac", &self.board_mac)
            .finish_non_exhaustive()
    }
}

impl LanSegment {
    /// A segment with the default host on it and a board expected at `board_ip`.
    pub fn new(board_ip: Ipv4Addr) -> Self {
        let mut port = Port::default();
        let mut config = Config::new(HardwareAddress::Ethernet(EthernetAddress(HOST_MAC)));
        // Fixed: the same run has the same TCP sequence numbers on every machine.
        config.random_seed = 0x4665_7272_6f43_4e43;
        let mut iface = Interface::new(config, &mut port, Instant::ZERO);
        iface.update_ip_addrs(|addresses| {
            // One address into a list with room for at least one.
            let _ = addresses.push(IpCidr::new(IpAddress::Ipv4(HOST_IP), 24));
        });
        LanSegment {
            board_ip,
            board_mac: None,
            hosts: HashMap::from([(HOST_IP, HOST_MAC)]),
            port,
            iface,
            sockets: SocketSet::new(Vec::new()),
            datagrams: VecDeque::new(),
            echoes: VecDeque::new(),
            next_local_port: 49152,
            ttl: 64,
            odd_frames: 0,
        }
    }

    /// The board's address.
    pub fn board_ip(&self) -> Ipv4Addr {
        self.board_ip
    }

    /// The board's hardware address, once it has answered an ARP request.
    pub fn board_mac(&self) -> Option<[u8; 6]> {
        self.board_mac
    }

    /// Forget the board's hardware address (after a reset).
    pub fn forget_board(&mut self) {
        self.board_mac = None;
    }

    /// Hardware address of a host; a new host is plugged in when there is none at `ip`.
    pub fn host_mac(&mut self, ip: Ipv4Addr) -> [u8; 6] {
        let [_, _, c, d] = ip.octets();
        *self.hosts.entry(ip).or_insert([0x02, 0xfc, 0, 0, c, d])
    }

    fn header(&mut self, from: Ipv4Addr, protocol: EthernetProtocol) -> EthernetRepr {
        EthernetRepr {
            src_addr: EthernetAddress(self.host_mac(from)),
            dst_addr: EthernetAddress(self.board_mac.unwrap_or([0xff; 6])),
            ethertype: protocol,
        }
    }

    /// The frame of an ARP request for the board.
    pub fn arp_request(&mut self, from: Ipv4Addr) -> Vec<u8> {
        let arp = ArpRepr::EthernetIpv4 {
            operation: ArpOperation::Request,
            source_hardware_addr: EthernetAddress(self.host_mac(from)),
            source_protocol_addr: from,
            target_hardware_addr: EthernetAddress([0; 6]),
            target_protocol_addr: self.board_ip,
        };
        let header = EthernetRepr {
            dst_addr: EthernetAddress::BROADCAST,
            ..self.header(from, EthernetProtocol::Arp)
        };
        arp_frame(header, arp)
    }

    /// The frame of a UDP datagram; longer payloads than [`MAX_UDP`] make a frame no Ethernet
    /// carries, if asked for.
    pub fn udp(&mut self, from: Endpoint, port: u16, payload: &[u8]) -> Vec<u8> {
        self.udp_to(from, (self.board_ip, port), payload)
    }

    /// The same as a broadcast: to 255.255.255.255 in a broadcast frame.
    pub fn broadcast(&mut self, from: Endpoint, port: u16, payload: &[u8]) -> Vec<u8> {
        let mut frame = self.udp_to(from, (Ipv4Addr::BROADCAST, port), payload);
        frame[..6].fill(0xff);
        frame
    }

    fn udp_to(&mut self, from: Endpoint, to: Endpoint, payload: &[u8]) -> Vec<u8> {
        let udp = UdpRepr {
            src_port: from.1,
            dst_port: to.1,
        };
        let ip = Ipv4Repr {
            src_addr: from.0,
            dst_addr: to.0,
            next_header: IpProtocol::Udp,
            payload_len: udp.header_len() + payload.len(),
            hop_limit: self.ttl,
        };
        let (mut frame, at) = self.ip_frame(from.0, &ip);
        udp.emit(
            &mut UdpPacket::new_unchecked(&mut frame[at..]),
            &from.0.into(),
            &to.0.into(),
            payload.len(),
            |buffer| buffer.copy_from_slice(payload),
            &ChecksumCapabilities::default(),
        );
        frame
    }

    /// The frame of an ICMP echo request.
    pub fn echo_request(
        &mut self,
        from: Ipv4Addr,
        ident: u16,
        seq_no: u16,
        data: &[u8],
    ) -> Vec<u8> {
        let icmp = Icmpv4Repr::EchoRequest {
            ident,
            seq_no,
            data,
        };
        let ip = Ipv4Repr {
            src_addr: from,
            dst_addr: self.board_ip,
            next_header: IpProtocol::Icmp,
            payload_len: icmp.buffer_len(),
            hop_limit: 64,
        };
        let (mut frame, at) = self.ip_frame(from, &ip);
        icmp.emit(
            &mut Icmpv4Packet::new_unchecked(&mut frame[at..]),
            &ChecksumCapabilities::default(),
        );
        frame
    }

    /// A frame with Ethernet and IPv4 headers filled in, and where the rest begins.
    fn ip_frame(&mut self, from: Ipv4Addr, ip: &Ipv4Repr) -> (Vec<u8>, usize) {
        let header = self.header(from, EthernetProtocol::Ipv4);
        let at = header.buffer_len() + ip.buffer_len();
        let mut frame = vec![0; at + ip.payload_len];
        header.emit(&mut EthernetFrame::new_unchecked(&mut frame));
        ip.emit(
            &mut Ipv4Packet::new_unchecked(&mut frame[header.buffer_len()..]),
            &ChecksumCapabilities::default(),
        );
        (frame, at)
    }

    /// A frame from the board, without preamble and FCS. `first` and `last` are the times of its
    /// bytes on the wire.
    pub fn receive(&mut self, frame: &[u8], first: u64, last: u64) {
        if self.understand(frame, first, last).is_none() {
            self.odd_frames += 1;
        }
    }

    fn understand(&mut self, frame: &[u8], first: u64, last: u64) -> Option<()> {
        let ethernet = EthernetFrame::new_checked(frame).ok()?;
        match ethernet.ethertype() {
            EthernetProtocol::Arp => {
                let arp = ArpRepr::parse(&ArpPacket::new_checked(ethernet.payload()).ok()?).ok()?;
                let ArpRepr::EthernetIpv4 {
                    operation,
                    source_hardware_addr,
                    source_protocol_addr,
                    target_protocol_addr,
                    ..
                } = arp
                else {
                    return None;
                };
                if source_protocol_addr == self.board_ip {
                    self.board_mac = Some(source_hardware_addr.0);
                }
                if operation == ArpOperation::Request && target_protocol_addr != HOST_IP {
                    // The smoltcp stack answers for its own address only; the other hosts are ours.
                    if let Some(mac) = self.hosts.get(&target_protocol_addr).copied() {
                        let reply = ArpRepr::EthernetIpv4 {
                            operation: ArpOperation::Reply,
                            source_hardware_addr: EthernetAddress(mac),
                            source_protocol_addr: target_protocol_addr,
                            target_hardware_addr: source_hardware_addr,
                            target_protocol_addr: source_protocol_addr,
                        };
                        let header = EthernetRepr {
                            src_addr: EthernetAddress(mac),
                            dst_addr: source_hardware_addr,
                            ethertype: EthernetProtocol::Arp,
                        };
                        self.port.tx.push_back(arp_frame(header, reply));
                    }
                    return Some(());
                }
                self.port.rx.push_back(frame.to_vec());
            }
            EthernetProtocol::Ipv4 => {
                let packet = Ipv4Packet::new_checked(ethernet.payload()).ok()?;
                let checksums = ChecksumCapabilities::default();
                let ip = Ipv4Repr::parse(&packet, &checksums).ok()?;
                match ip.next_header {
                    IpProtocol::Udp => {
                        let packet = UdpPacket::new_checked(packet.payload()).ok()?;
                        let (src, dst) = (ip.src_addr.into(), ip.dst_addr.into());
                        let udp = UdpRepr::parse(&packet, &src, &dst, &checksums).ok()?;
                        self.datagrams.push_back(Datagram {
                            from: (ip.src_addr, udp.src_port),
                            to: (ip.dst_addr, udp.dst_port),
                            payload: packet.payload().to_vec(),
                            first,
                            last,
                            wire_len: frame.len() + 8 + 4,
                        });
                    }
                    IpProtocol::Icmp => {
                        let packet = Icmpv4Packet::new_checked(packet.payload()).ok()?;
                        match Icmpv4Repr::parse(&packet, &checksums).ok()? {
                            Icmpv4Repr::EchoReply {
                                ident,
                                seq_no,
                                data,
                            } => {
                                self.echoes.push_back(Echo {
                                    ident,
                                    seq_no,
                                    payload: data.to_vec(),
                                    first,
                                });
                            }
                            _ => self.port.rx.push_back(frame.to_vec()),
                        }
                    }
                    _ => self.port.rx.push_back(frame.to_vec()),
                }
            }
            _ => return None,
        }
        Some(())
    }

    /// Let the TCP stack work at `now_us` of simulated time.
    pub fn poll(&mut self, now_us: u64) {
        self.iface.poll(
            Instant::from_micros(now_us as i64),
            &mut self.port,
            &mut self.sockets,
        );
    }

    /// Some TCP connection exists, so that [`Self::poll`] is wanted now and then even without
    /// frames.
    pub fn has_connections(&self) -> bool {
        self.sockets.iter().next().is_some()
    }

    /// A frame on its way to the board.
    pub fn take_frame(&mut self) -> Option<Vec<u8>> {
        self.port.tx.pop_front()
    }

    /// A UDP datagram that came from the board.
    pub fn take_datagram(&mut self) -> Option<Datagram> {
        self.datagrams.pop_front()
    }

    /// An echo reply that came from the board.
    pub fn take_echo(&mut self) -> Option<Echo> {
        self.echoes.pop_front()
    }

    /// Open a TCP connection to the board's `port`; poll until [`Self::established`].
    pub fn connect(&mut self, port: u16) -> Connection {
        let buffer = || tcp::SocketBuffer::new(vec![0; 8192]);
        let mut socket = tcp::Socket::new(buffer(), buffer());
        socket.set_nagle_enabled(false);
        // Simulated milliseconds are expensive; an acknowledgement is not.
        socket.set_ack_delay(None);
        let local = self.next_local_port;
        self.next_local_port = local.checked_add(1).unwrap_or(49152);
        let remote = IpEndpoint::new(IpAddress::Ipv4(self.board_ip), port);
        // A fresh socket with a non-zero port cannot be refused.
        let _ = socket.connect(self.iface.context(), remote, local);
        Connection(self.sockets.add(socket))
    }

    fn tcp(&mut self, connection: Connection) -> &mut tcp::Socket<'static> {
        self.sockets.get_mut(connection.0)
    }

    /// The connection is up for sending.
    pub fn established(&mut self, connection: Connection) -> bool {
        self.tcp(connection).may_send()
    }

    /// The board has ended a connection, and all it had said was taken.
    pub fn hung_up(&mut self, connection: Connection) -> bool {
        let socket = self.tcp(connection);
        socket.state() == tcp::State::CloseWait && !socket.can_recv()
    }

    /// Both sides have ended a connection, and all the board had said was taken.
    pub fn closed(&mut self, connection: Connection) -> bool {
        let socket = self.tcp(connection);
        matches!(socket.state(), tcp::State::Closed | tcp::State::TimeWait) && !socket.can_recv()
    }

    /// Send what fits; how many bytes that was.
    pub fn send(&mut self, connection: Connection, bytes: &[u8]) -> usize {
        self.tcp(connection).send_slice(bytes).unwrap_or(0)
    }

    /// Bytes accepted for sending and not yet acknowledged by the board.
    pub fn unsent(&mut self, connection: Connection) -> usize {
        self.tcp(connection).send_queue()
    }

    /// What has arrived.
    pub fn recv(&mut self, connection: Connection) -> Vec<u8> {
        let socket = self.tcp(connection);
        let mut bytes = vec![0; socket.recv_queue()];
        let n = socket.recv_slice(&mut bytes).unwrap_or(0);
        bytes.truncate(n);
        bytes
    }

    /// Start an orderly close.
    pub fn close(&mut self, connection: Connection) {
        self.tcp(connection).close();
    }

    /// Break the connection: a reset goes out with the next poll.
    pub fn abort(&mut self, connection: Connection) {
        self.tcp(connection).abort();
    }

    /// Our port of it; 0 once it is over.
    pub fn local_port(&mut self, connection: Connection) -> u16 {
        self.tcp(connection)
            .local_endpoint()
            .map_or(0, |end| end.port)
    }

    /// Forget the connection.
    pub fn drop_connection(&mut self, connection: Connection) {
        self.sockets.remove(connection.0);
    }
}

fn arp_frame(header: EthernetRepr, arp: ArpRepr) -> Vec<u8> {
    let at = header.buffer_len();
    let mut frame = vec![0; at + arp.buffer_len()];
    header.emit(&mut EthernetFrame::new_unchecked(&mut frame));
    arp.emit(&mut ArpPacket::new_unchecked(&mut frame[at..]));
    frame
}

/// Maps senders of the real world to source ports on the segment and back, so that the board can
/// tell them apart.
///
/// Ports are given out once and never reused before the range is exhausted: a session on the board
/// is bound to one.
#[derive(Debug)]
pub struct Nat<K> {
    by_key: HashMap<K, u16>,
    by_port: HashMap<u16, K>,
    next: u16,
}

impl<K> Default for Nat<K> {
    fn default() -> Self {
        Nat {
            by_key: HashMap::new(),
            by_port: HashMap::new(),
            next: Self::FIRST,
        }
    }
}

impl<K> Nat<K> {
    /// First port given out.
    pub const FIRST: u16 = 40000;
    /// Last port given out.
    pub const LAST: u16 = 48999;
}

impl<K: Copy + Eq + std::hash::Hash> Nat<K> {
    /// The port of a sender, new or known.
    pub fn port(&mut self, key: K) -> u16 {
        if let Some(port) = self.by_key.get(&key) {
            return *port;
        }
        let port = self.next;
        self.next = if port == Self::LAST {
            Self::FIRST
        } else {
            port + 1
        };
        if let Some(evicted) = self.by_port.insert(port, key) {
            self.by_key.remove(&evicted);
        }
        self.by_key.insert(key, port);
        port
    }

    /// The sender of a port.
    pub fn sender(&self, port: u16) -> Option<K> {
        self.by_port.get(&port).copied()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const BOARD_MAC: [u8; 6] = [0x10, 0xe2, 0xd5, 0, 0, 1];

    #[test]
    fn senders_keep_their_ports() {
        let mut nat = Nat::default();
        let (a, b) = (nat.port("a"), nat.port("b"));
        assert_ne!(a, b);
        assert_eq!(
            (nat.port("a"), nat.sender(a), nat.sender(b), nat.sender(1)),
            (a, Some("a"), Some("b"), None)
        );
    }

    #[test]
    fn an_exhausted_range_evicts_the_oldest() {
        let mut nat = Nat::default();
        let first = nat.port(0u32);
        for n in 1..=u32::from(Nat::<u32>::LAST - Nat::<u32>::FIRST) {
            nat.port(n);
        }
        assert_eq!(nat.sender(first), Some(0));
        assert_eq!((nat.port(99_999), nat.sender(first)), (first, Some(99_999)));
        assert_ne!(nat.port(0), first);
    }

    /// A second segment plays the board: what one sends the other must read.
    fn arp_reply(
        segment: &mut LanSegment,
        sender: Ipv4Addr,
        target: Ipv4Addr,
        operation: ArpOperation,
    ) -> Vec<u8> {
        let _ = segment;
        let header = EthernetRepr {
            src_addr: EthernetAddress(BOARD_MAC),
            dst_addr: EthernetAddress(HOST_MAC),
            ethertype: EthernetProtocol::Arp,
        };
        let arp = ArpRepr::EthernetIpv4 {
            operation,
            source_hardware_addr: EthernetAddress(BOARD_MAC),
            source_protocol_addr: sender,
            target_hardware_addr: EthernetAddress(HOST_MAC),
            target_protocol_addr: target,
        };
        arp_frame(header, arp)
    }

    #[test]
    fn learns_the_board_from_arp_and_answers_for_its_hosts() {
        let mut s = LanSegment::new(BOARD_IP);
        let reply = arp_reply(&mut s, BOARD_IP, HOST_IP, ArpOperation::Reply);
        s.receive(&reply, 0, 0);
        assert_eq!(s.board_mac(), Some(BOARD_MAC));
        // The stack answers for the default host, the segment for another host it knows; others get
        // no answer.
        let known = Ipv4Addr::new(192, 168, 2, 77);
        s.host_mac(known);
        for (target, answered) in [
            (HOST_IP, true),
            (known, true),
            (Ipv4Addr::new(192, 168, 2, 78), false),
        ] {
            let request = arp_reply(&mut s, BOARD_IP, target, ArpOperation::Request);
            s.receive(&request, 0, 0);
            s.poll(1000);
            let frame = s.take_frame();
            assert_eq!(frame.is_some(), answered, "{target}");
            if let Some(frame) = frame {
                let packet = EthernetFrame::new_checked(&frame[..]).unwrap();
                let arp =
                    ArpRepr::parse(&ArpPacket::new_checked(packet.payload()).unwrap()).unwrap();
                let ArpRepr::EthernetIpv4 {
                    source_protocol_addr,
                    target_hardware_addr,
                    ..
                } = arp
                else {
                    panic!()
                };
                assert_eq!(
                    (source_protocol_addr, target_hardware_addr.0),
                    (target, BOARD_MAC)
                );
            }
        }
    }

    #[test]
    fn datagrams_come_through_with_ports_payload_and_times() {
        // The board's datagram is ours with the roles exchanged.
        let mut board = LanSegment::new(HOST_IP);
        board.board_mac = Some(HOST_MAC);
        let frame = board.udp((BOARD_IP, BOARD_PORT), 40001, b"status");
        let mut s = LanSegment::new(BOARD_IP);
        s.receive(&frame, 100, 200);
        let d = s.take_datagram().unwrap();
        assert_eq!((d.from, d.to), ((BOARD_IP, BOARD_PORT), (HOST_IP, 40001)));
        assert_eq!(
            (&d.payload[..], d.first, d.last),
            (&b"status"[..], 100, 200)
        );
        assert_eq!(s.odd_frames, 0);
    }

    #[test]
    fn a_damaged_datagram_is_odd_and_dropped() {
        let mut board = LanSegment::new(HOST_IP);
        let mut frame = board.udp((BOARD_IP, BOARD_PORT), 40001, b"status");
        *frame.last_mut().unwrap() ^= 1;
        let mut s = LanSegment::new(BOARD_IP);
        s.receive(&frame, 0, 0);
        s.receive(&[1, 2, 3], 0, 0);
        assert!(s.take_datagram().is_none());
        assert_eq!(s.odd_frames, 2);
    }

    #[test]
    fn two_stacks_talk_tcp_over_the_segment() {
        // The far end: a smoltcp listener at the board's address.
        let mut port = Port::default();
        let mut iface = Interface::new(
            Config::new(HardwareAddress::Ethernet(EthernetAddress(BOARD_MAC))),
            &mut port,
            Instant::ZERO,
        );
        iface.update_ip_addrs(|a| a.push(IpCidr::new(IpAddress::Ipv4(BOARD_IP), 24)).unwrap());
        let mut sockets = SocketSet::new(Vec::new());
        let buffer = || tcp::SocketBuffer::new(vec![0; 256]);
        let mut listener = tcp::Socket::new(buffer(), buffer());
        listener.listen(23).unwrap();
        let console = sockets.add(listener);

        let mut s = LanSegment::new(BOARD_IP);
        let connection = s.connect(CONSOLE_PORT);
        let mut heard = vec![];
        for us in (0..100_000).step_by(100) {
            s.poll(us);
            while let Some(frame) = s.take_frame() {
                port.rx.push_back(frame);
            }
            iface.poll(Instant::from_micros(us as i64), &mut port, &mut sockets);
            let socket = sockets.get_mut::<tcp::Socket>(console);
            if socket.can_recv() {
                let said = socket.recv(|b| (b.len(), b.to_vec())).unwrap();
                socket.send_slice(&said).unwrap();
            }
            iface.poll(Instant::from_micros(us as i64), &mut port, &mut sockets);
            while let Some(frame) = port.tx.pop_front() {
                s.receive(&frame, 0, 0);
            }
            if us == 50_000 {
                assert!(s.established(connection));
                assert_eq!(s.send(connection, b"help\n"), 5);
            }
            heard.extend(s.recv(connection));
        }
        assert_eq!(heard, b"help\n");
        s.close(connection);
        s.drop_connection(connection);
        assert!(!s.has_connections());
    }
}
