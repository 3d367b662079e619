//! The acknowledgement in a segment that a shut window refuses.
//!
//! A client that may send nothing more asks with a byte beyond the window, or behind it, and that
//! segment may be the only one that says what the client has received. RFC 9293 (3.10.7.4) wants a
//! valid acknowledgement taken from it; smoltcp drops it with the byte. The board takes no line
//! before there is room for its answer, so both sides would wait for ever: the board for an
//! acknowledgement, the client for room.

use smoltcp::phy::ChecksumCapabilities;
use smoltcp::wire::{
    IpAddress, IpProtocol, Ipv4Packet, Ipv4Repr, TcpControl, TcpPacket, TcpRepr, TcpSeqNumber,
};

const ETHERNET: usize = 14;
const IP: usize = 20;
const TCP: usize = 20;
/// Bytes of a frame with an acknowledgement and nothing else.
pub const NOD: usize = ETHERNET + IP + TCP;

/// The acknowledgement of this segment as a frame of its own, with the number the board expects
/// `next`; if the segment is whole, has one, and is one of those that ask for room.
pub fn nod(frame: &[u8], next: u32) -> Option<[u8; NOD]> {
    let sums = ChecksumCapabilities::default();
    let (ethernet, packet) = frame.split_at_checked(ETHERNET)?;
    let packet = Ipv4Packet::new_checked(packet).ok()?;
    let ip = Ipv4Repr::parse(&packet, &sums).ok()?;
    let tcp = TcpPacket::new_checked(packet.payload()).ok()?;
    let next = TcpSeqNumber(next as i32);
    let asks = [next - 1, next, next + 1].contains(&tcp.seq_number());
    let (from, to) = (IpAddress::Ipv4(ip.src_addr), IpAddress::Ipv4(ip.dst_addr));
    if !asks || tcp.syn() || tcp.rst() || !tcp.ack() || !tcp.verify_checksum(&from, &to) {
        return None;
    }
    let tcp = TcpRepr {
        src_port: tcp.src_port(),
        dst_port: tcp.dst_port(),
        control: TcpControl::None,
        seq_number: next,
        ack_number: Some(tcp.ack_number()),
        window_len: tcp.window_len(),
        window_scale: None,
        max_seg_size: None,
        sack_permitted: false,
        sack_ranges: [None; 3],
        timestamp: None,
        payload: &[],
    };
    let ip = Ipv4Repr {
        next_header: IpProtocol::Tcp,
        payload_len: TCP,
        ..ip
    };
    let mut nod = [0; NOD];
    let (header, rest) = nod.split_at_mut(ETHERNET);
    header.copy_from_slice(ethernet);
    let mut packet = Ipv4Packet::new_unchecked(rest);
    ip.emit(&mut packet, &sums);
    let mut packet = TcpPacket::new_unchecked(packet.payload_mut());
    tcp.emit(&mut packet, &from, &to, &sums);
    Some(nod)
}
