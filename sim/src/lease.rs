//! Runs the services' DHCP client beside the firmware of a twin: [`firmware::services::lease`].
//!
//! The client uses frames, the twin's network datagrams of this computer's sockets. What is around
//! a datagram is added here and taken off, and ARP, which this machine's kernel does, is answered
//! here.

use crate::jobs::Outer;
use crate::model_board::ModelBoard;
use crate::services::Cable;
use firmware::machine::Guest;
use firmware::services::lease::{Client, PORT, Place, SERVER_PORT};
use firmware::services::stack::Stack;
use firmware::services::{Network, facts};
use jobs::Outside;
use smoltcp::phy::ChecksumCapabilities;
use smoltcp::time::Instant;
use smoltcp::wire::{
    ArpOperation, ArpPacket, ArpRepr, EthernetAddress, EthernetFrame, EthernetProtocol, IpAddress,
    IpProtocol, Ipv4Address, Ipv4Packet, Ipv4Repr, UdpPacket, UdpRepr,
};

const ETHERNET: usize = 14;
const HEADERS: usize = ETHERNET + 20 + 8;
/// The byte of a DHCP message with the flag that asks for an answer to all, and the flag.
const FLAGS: usize = 10;
const TO_ALL: u8 = 0x80;
/// Every other station on the cable.
const OTHERS: EthernetAddress = EthernetAddress([2, 0, 0, 0, 0, 1]);
/// A server's address, as far as the client needs one.
const SERVER: Ipv4Address = Ipv4Address::new(169, 254, 0, 1);

/// The client on its cable.
pub struct DhcpClient {
    client: Client<'static>,
    stack: Stack,
    per_ms: u64,
}

impl core::fmt::Debug for DhcpClient {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str("DhcpClient")
    }
}

impl DhcpClient {
    /// On a board whose settings ask for it.
    pub fn start(machine: Guest<'_, ModelBoard>, clock_hz: u32) -> Option<Self> {
        let mut board = Outer(machine);
        let settings = facts::settings(&mut board);
        if !settings.dhcp {
            return None;
        }
        // Never freed: there are few boards, and each lives as long as its simulator.
        let place = Box::leak(Box::new(Place::new()));
        let seed = board.now();
        Some(DhcpClient {
            client: Client::new(place, &settings.name),
            stack: Stack::new(seed, &mut board),
            per_ms: u64::from(clock_hz / 1000),
        })
    }

    fn instant(&self, now: u64) -> Instant {
        Instant::from_millis((now / self.per_ms) as i64)
    }

    /// A server's datagram.
    pub fn take(&mut self, payload: &[u8], machine: Guest<'_, ModelBoard>) {
        let mut cable = Cable::of(machine);
        let now = self.instant(cable.now());
        let frame = framed(payload);
        self.client.take(&frame, &mut self.stack, now, &mut cable);
    }

    /// Does what is due; the payload of a datagram for servers.
    pub fn turn(&mut self, machine: Guest<'_, ModelBoard>) -> Option<Vec<u8>> {
        let mut cable = Cable::of(machine);
        let now = self.instant(cable.now());
        let us = cable.us();
        self.stack.settle(us);
        self.client.turn(&mut self.stack, now, &mut cable);
        let frame = cable.sent.pop()?;
        if let Some(answer) = arp_answer(&frame) {
            self.client.take(&answer, &mut self.stack, now, &mut cable);
            return None;
        }
        payload(&frame)
    }
}

/// A datagram from a server, as it comes to every client.
pub fn framed(payload: &[u8]) -> Vec<u8> {
    let all = Ipv4Address::BROADCAST;
    let udp = UdpRepr {
        src_port: SERVER_PORT,
        dst_port: PORT,
    };
    let ip = Ipv4Repr {
        src_addr: SERVER,
        dst_addr: all,
        next_header: IpProtocol::Udp,
        payload_len: HEADERS - ETHERNET - 20 + payload.len(),
        hop_limit: 64,
    };
    let sums = ChecksumCapabilities::default();
    let mut bytes = vec![0; HEADERS + payload.len()];
    let mut frame = EthernetFrame::new_unchecked(&mut bytes);
    frame.set_dst_addr(EthernetAddress::BROADCAST);
    frame.set_src_addr(OTHERS);
    frame.set_ethertype(EthernetProtocol::Ipv4);
    let mut packet = Ipv4Packet::new_unchecked(frame.payload_mut());
    ip.emit(&mut packet, &sums);
    udp.emit(
        &mut UdpPacket::new_unchecked(packet.payload_mut()),
        &IpAddress::Ipv4(SERVER),
        &IpAddress::Ipv4(all),
        payload.len(),
        |body| body.copy_from_slice(payload),
        &sums,
    );
    bytes
}

/// What a datagram of the client carries. A board hears a frame for an address that it does not
/// have yet; a socket of the operating system does not. So the server is asked to answer to all
/// (RFC 2131, 4.1).
pub fn payload(frame: &[u8]) -> Option<Vec<u8>> {
    let frame = EthernetFrame::new_checked(frame).ok()?;
    let ip = Ipv4Packet::new_checked(frame.payload()).ok()?;
    let udp = UdpPacket::new_checked(ip.payload()).ok()?;
    let mut payload = udp.payload().to_vec();
    *payload.get_mut(FLAGS)? |= TO_ALL;
    Some(payload)
}

/// The answer to the client's ARP request.
fn arp_answer(frame: &[u8]) -> Option<Vec<u8>> {
    let asked = EthernetFrame::new_checked(frame).ok()?;
    if asked.ethertype() != EthernetProtocol::Arp {
        return None;
    }
    let repr = ArpRepr::parse(&ArpPacket::new_checked(asked.payload()).ok()?).ok()?;
    let ArpRepr::EthernetIpv4 {
        source_hardware_addr,
        source_protocol_addr,
        target_protocol_addr,
        ..
    } = repr
    else {
        return None;
    };
    let answer = ArpRepr::EthernetIpv4 {
        operation: ArpOperation::Reply,
        source_hardware_addr: OTHERS,
        source_protocol_addr: target_protocol_addr,
        target_hardware_addr: source_hardware_addr,
        target_protocol_addr: source_protocol_addr,
    };
    let mut bytes = vec![0; ETHERNET + answer.buffer_len()];
    let mut frame = EthernetFrame::new_unchecked(&mut bytes);
    frame.set_dst_addr(source_hardware_addr);
    frame.set_src_addr(OTHERS);
    frame.set_ethertype(EthernetProtocol::Arp);
    answer.emit(&mut ArpPacket::new_unchecked(frame.payload_mut()));
    Some(bytes)
}
