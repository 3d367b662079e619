//! Answers ARP and ping while there are no services: on boards without SDRAM, until the services
//! are loaded, and after they failed. It answers nothing else; Etherbone and discovery, which an
//! update needs, are in the ROM, too.
//!
//! Answers go to the MAC address the question came from, so the board resolves no addresses.

use crate::net::{Us, add, fold};
use smoltcp::phy::ChecksumCapabilities;
use smoltcp::wire::{
    EthernetFrame, EthernetProtocol, Icmpv4Packet, Icmpv4Repr, IpProtocol, Ipv4Address, Ipv4Packet,
    Ipv4Repr,
};

/// Room for the longest answer: as long as the longest frame.
pub const ROOM: usize = 1514;

const ETHERNET: usize = 14;
const IP_HEADER: usize = 20;
/// Bytes of an ARP message.
const ARP: usize = 28;

/// Answers a frame into `out`: an ARP request about our address, or a ping to it. Returns the
/// answer's length in bytes.
pub fn answer(frame: &[u8], us: &Us, out: &mut [u8; ROOM]) -> Option<usize> {
    let asked = EthernetFrame::new_checked(frame).ok()?;
    match asked.ethertype() {
        EthernetProtocol::Arp => arp(asked.payload(), us, out),
        EthernetProtocol::Ipv4 => ping(asked.src_addr().0, asked.payload(), us, out),
        _ => None,
    }
}

/// Writes these parts one after the other; returns how long they are together. smoltcp's own way of
/// writing has indices that the compiler cannot see to be in range, and the ROM has no panics.
fn put(parts: &[&[u8]], out: &mut [u8; ROOM]) -> usize {
    let bytes = parts.iter().copied().flatten();
    let pairs = out.iter_mut().zip(bytes);
    pairs.map(|(place, byte)| *place = *byte).count()
}

fn arp(asked: &[u8], us: &Us, out: &mut [u8; ROOM]) -> Option<usize> {
    // Ethernet, IPv4, addresses of 6 and 4 bytes, a question.
    let [0, 1, 8, 0, 6, 4, 0, 1, rest @ ..] = asked.first_chunk::<ARP>()? else {
        return None;
    };
    let (sender, rest) = rest.split_first_chunk::<10>()?;
    let (mac, _) = sender.split_first_chunk::<6>()?;
    let ours = us.ip.to_be_bytes();
    if rest.last_chunk() != Some(&ours) {
        return None;
    }
    let head = [8, 6, 0, 1, 8, 0, 6, 4, 0, 2];
    let parts: [&[u8]; 6] = [mac, &us.mac, &head, &us.mac, &ours, sender];
    Some(put(&parts, out))
}

/// Answers a ping. It is a function of its own because a test breaks it to see a trap.
#[inline(never)]
fn ping(to: [u8; 6], asked: &[u8], us: &Us, out: &mut [u8; ROOM]) -> Option<usize> {
    let sums = ChecksumCapabilities::default();
    let packet = Ipv4Packet::new_checked(asked).ok()?;
    let ip = Ipv4Repr::parse(&packet, &sums).ok()?;
    let whole = !packet.more_frags() && packet.frag_offset() == 0;
    if !whole || ip.dst_addr != Ipv4Address::from_bits(us.ip) || ip.next_header != IpProtocol::Icmp
    {
        return None;
    }
    // Inside the frame, as `new_checked` has found; the compiler does not see it in `payload`.
    let body = asked.get(packet.header_len().into()..packet.total_len().into())?;
    let message = Icmpv4Packet::new_checked(body).ok()?;
    let Icmpv4Repr::EchoRequest { .. } = Icmpv4Repr::parse(&message, &sums).ok()? else {
        return None;
    };
    // The answer is the question with type 0 instead of 8; its sum grows by as much.
    let [_, code, high, low, rest @ ..] = body else {
        return None;
    };
    let sum = u32::from(u16::from_be_bytes([*high, *low]));
    let [high, low] = (fold(add(sum, 0x0800)) as u16).to_be_bytes();
    let length = (IP_HEADER + body.len()) as u32;
    let theirs = ip.src_addr.to_bits();
    // As `net::emit_headers`: identification 0, don't fragment, TTL 64, ICMP.
    let words = [0x4500 << 16 | length, 0x4000, 0x4001 << 16, us.ip, theirs];
    let check = !fold(words.into_iter().fold(0, add)) & 0xffff;
    let [w0, w1, w2, w3, w4] = words.map(u32::to_be_bytes);
    let [_, _, check_high, check_low] = check.to_be_bytes();
    let [ttl, protocol, ..] = w2;
    let parts: [&[u8]; 10] = [
        &to,
        &us.mac,
        &[8, 0],
        &w0,
        &w1,
        &[ttl, protocol, check_high, check_low],
        &w3,
        &w4,
        &[0, *code, high, low],
        rest,
    ];
    (ETHERNET + length as usize <= ROOM).then(|| put(&parts, out))
}

#[cfg(test)]
mod tests;
