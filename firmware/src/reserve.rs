//! ARP and ping where there are no services: on boards without SDRAM, while the services are being
//! loaded, and after they failed. Nothing else is answered here; what an update needs (Etherbone,
//! discovery) never left the ROM.
//!
//! Answers go to the MAC address the question came from, so the board resolves no addresses.

use crate::net::Us;
use smoltcp::phy::ChecksumCapabilities;
use smoltcp::wire::{
    ArpOperation, ArpPacket, ArpRepr, EthernetAddress, EthernetFrame, EthernetProtocol,
    Icmpv4Packet, Icmpv4Repr, IpProtocol, Ipv4Address, Ipv4Packet, Ipv4Repr,
};

/// Room for the longest answer: as long as the longest frame.
pub const ROOM: usize = 1514;

const ETHERNET: usize = 14;
const IP_HEADER: usize = 20;
const ARP: usize = 28;
const TTL: u8 = 64;

/// Answers a frame into `out`: an ARP request about our address, or a ping to it. Returns the
/// answer's length in bytes.
pub fn answer(frame: &[u8], us: &Us, out: &mut [u8; ROOM]) -> Option<usize> {
    let asked = EthernetFrame::new_checked(frame).ok()?;
    match asked.ethertype() {
        EthernetProtocol::Arp => arp(asked.payload(), us, out),
        EthernetProtocol::Ipv4 => ping(asked.src_addr(), asked.payload(), us, out),
        _ => None,
    }
}

/// The envelope of an answer; behind it is what it carries.
fn envelope(to: EthernetAddress, us: &Us, protocol: EthernetProtocol, out: &mut [u8; ROOM]) {
    let mut frame = EthernetFrame::new_unchecked(&mut out[..]);
    frame.set_dst_addr(to);
    frame.set_src_addr(EthernetAddress(us.mac));
    frame.set_ethertype(protocol);
}

fn arp(asked: &[u8], us: &Us, out: &mut [u8; ROOM]) -> Option<usize> {
    let asked = ArpRepr::parse(&ArpPacket::new_checked(asked).ok()?).ok()?;
    let ArpRepr::EthernetIpv4 {
        operation: ArpOperation::Request,
        source_hardware_addr,
        source_protocol_addr,
        target_protocol_addr,
        ..
    } = asked
    else {
        return None;
    };
    let ours = Ipv4Address::from_bits(us.ip);
    if target_protocol_addr != ours {
        return None;
    }
    let answer = ArpRepr::EthernetIpv4 {
        operation: ArpOperation::Reply,
        source_hardware_addr: EthernetAddress(us.mac),
        source_protocol_addr: ours,
        target_hardware_addr: source_hardware_addr,
        target_protocol_addr: source_protocol_addr,
    };
    envelope(source_hardware_addr, us, EthernetProtocol::Arp, out);
    answer.emit(&mut ArpPacket::new_unchecked(&mut out[ETHERNET..]));
    Some(ETHERNET + ARP)
}

/// Answers a ping. It is a function of its own because a test breaks it to see a trap.
#[inline(never)]
fn ping(to: EthernetAddress, asked: &[u8], us: &Us, out: &mut [u8; ROOM]) -> Option<usize> {
    let sums = ChecksumCapabilities::default();
    let packet = Ipv4Packet::new_checked(asked).ok()?;
    let ip = Ipv4Repr::parse(&packet, &sums).ok()?;
    let whole = !packet.more_frags() && packet.frag_offset() == 0;
    let ours = Ipv4Address::from_bits(us.ip);
    if !whole || ip.dst_addr != ours || ip.next_header != IpProtocol::Icmp {
        return None;
    }
    let message = Icmpv4Packet::new_checked(packet.payload()).ok()?;
    let Icmpv4Repr::EchoRequest {
        ident,
        seq_no,
        data,
    } = Icmpv4Repr::parse(&message, &sums).ok()?
    else {
        return None;
    };
    let answer = Icmpv4Repr::EchoReply {
        ident,
        seq_no,
        data,
    };
    let header = Ipv4Repr {
        src_addr: ours,
        dst_addr: ip.src_addr,
        next_header: IpProtocol::Icmp,
        payload_len: answer.buffer_len(),
        hop_limit: TTL,
    };
    let room = out.get_mut(ETHERNET..ETHERNET + IP_HEADER + answer.buffer_len())?;
    let length = ETHERNET + room.len();
    let (head, body) = room.split_at_mut_checked(IP_HEADER)?;
    header.emit(&mut Ipv4Packet::new_unchecked(head), &sums);
    answer.emit(&mut Icmpv4Packet::new_unchecked(body), &sums);
    envelope(to, us, EthernetProtocol::Ipv4, out);
    Some(length)
}

#[cfg(test)]
mod tests;
