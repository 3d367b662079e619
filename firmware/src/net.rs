//! Recognises the frames for the Etherbone server without an IP stack, and checks them completely.
//!
//! An Etherbone frame is UDP to our address and port in one IPv4 packet, with or without IP
//! options. ARP, ping, TCP and the services' UDP ports are [`Class::Services`]; a frame that they
//! would not answer is [`Class::Nothing`], and the words in the slot suffice to tell. Only
//! discovery and the services' ports are accepted for any destination IP address. A damaged frame
//! for us is refused here with its reason.
//!
//! Frames are read as big-endian words as the MAC's slots deliver them, two bytes in, so that all
//! but the Ethernet header lies on words:
//!
//! ```text
//! word  0         1      2      3          4           5         6             7    8    9      10       11
//!      |--  dst..|..dst |src.. |..src 0800|45 tos len |id frag  |ttl 17 sum   |src |dst |ports |len sum |payload
//! ```

use crate::session::Peer;
use wire::{MAX_WORDS, Refusal};

/// Bytes before the UDP payload.
pub const HEADERS: usize = 42;
/// Frames are at least this long on the wire (without FCS); shorter ones are padded.
pub const FRAME_MIN: usize = 60;
/// Word the payload begins at.
pub const PAYLOAD_WORD: usize = 11;

pub(crate) const ETHERTYPE_IPV4: u32 = 0x0800;
const ETHERTYPE_ARP: u32 = 0x0806;
/// Word that holds the address an ARP request asks for.
const ARP_TARGET: usize = 10;
/// Version 4, five words of header, no type of service; the total length goes below.
pub(crate) const IPV4_IHL5: u32 = 0x4500 << 16;
const PROTOCOL_ICMP: u32 = 1;
const PROTOCOL_IGMP: u32 = 2;
const PROTOCOL_TCP: u32 = 6;
pub(crate) const PROTOCOL_UDP: u32 = 17;
/// More-fragments flag, fragment offset and the reserved bit; don't-fragment may be either.
const FRAGMENT: u32 = 0xbfff;
pub(crate) const IP_HEADER: usize = 20;
/// IHL is four bits: at most fifteen words, five of which are no options.
const OPTIONS_MAX: usize = 10;
pub(crate) const UDP_HEADER: usize = 8;
/// UDP port of DHCP clients.
pub const DHCP_CLIENT: u16 = 68;
/// UDP port of DHCP servers.
pub const DHCP_SERVER: u16 = 67;
const ETHERNET_HEADER: usize = 14;

/// Longest ping that is answered while the machine is not at rest: to sum, copy and answer one
/// takes 20 clocks a byte.
const GUEST_FRAME: usize = 256;
/// The same with services, for every frame: smoltcp takes 12 000 clocks before it looks at the
/// first byte of what a segment carries.
pub const GUEST_FRAME_SERVICES: usize = 128;
/// The same for a DHCP server's answer, which has at least BOOTP's 300 bytes: a lease is renewed
/// while the machine moves.
const GUEST_FRAME_DHCP: usize = 350;

/// A received frame as big-endian words, two bytes in. Words past the frame's end read as anything.
pub trait Frame {
    /// Bytes `4 * index - 2 ..` of the frame.
    fn word(&self, index: usize) -> u32;
}

/// A frame to be sent, as big-endian words, two bytes in.
pub trait Slot {
    /// Sets bytes `4 * index - 2 ..`.
    fn put(&mut self, index: usize, word: u32);
}

/// Our side of the wire.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(C)]
pub struct Us {
    /// MAC address.
    pub mac: [u8; 6],
    /// IPv4 address.
    pub ip: u32,
    /// UDP port of the Etherbone server.
    pub port: u16,
}

/// UDP ports that the services listen at; 0 for none. Without this list a flood of datagrams to any
/// port would reach them, and they would answer each with an ICMP message.
pub type UdpPorts = [u16; 8];

/// What a frame is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Class {
    /// A datagram for the Etherbone server.
    Ours(Datagram),
    /// For [`crate::discovery`], whatever its IP address.
    Discovery(Datagram),
    /// Addressed to one of these two, but damaged.
    Refused(Refusal),
    /// For [`crate::services`], and if there are none for [`crate::reserve`]: ARP about our
    /// address, a ping or TCP to it, or UDP to one of the services' ports. Not checked.
    Services,
    /// Not for this board.
    Nothing,
}

/// A checked datagram: its headers are right, and its payload is whole words inside the frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Datagram {
    /// The sender.
    pub peer: Peer,
    /// MAC address to answer to: upper 16, lower 32 bits.
    pub mac: (u16, u32),
    /// Payload length in bytes.
    pub length: usize,
    /// Words of IP options: the payload begins that many words later.
    pub options: usize,
    /// Type of service.
    pub service: u8,
    /// Time to live.
    pub ttl: u8,
}

impl Datagram {
    /// Words of its payload.
    #[inline(always)]
    pub const fn words(&self) -> usize {
        self.length / 4
    }

    /// A datagram without a sender: an answer to it is broadcast to this port.
    pub const fn broadcast(port: u16) -> Self {
        Datagram {
            peer: Peer { ip: u32::MAX, port },
            mac: (u16::MAX, u32::MAX),
            length: 0,
            options: 0,
            service: 0,
            ttl: 0,
        }
    }
}

/// Looks at a frame of `length` bytes. `ports`: where the services listen. The words of a datagram
/// for us are in `payload` then, so that each is read from its slot once.
pub fn classify(
    frame: &impl Frame,
    length: usize,
    us: &Us,
    ports: &UdpPorts,
    payload: &mut [u32; MAX_WORDS],
) -> Class {
    let (w0, w1) = (frame.word(0), frame.word(1));
    let (w3, w4, w5, w6) = (frame.word(3), frame.word(4), frame.word(5), frame.word(6));
    let (source, destination) = (frame.word(7), frame.word(8));
    let options = (w4 >> 24 & 0xf).wrapping_sub(5) as usize;
    let to = Destination::of(w0, w1, us);
    let udp = length >= HEADERS
        && w3 & 0xffff == ETHERTYPE_IPV4
        && w4 >> 28 == 4
        && options <= OPTIONS_MAX
        && w5 & FRAGMENT == 0
        && w6 >> 16 & 0xff == PROTOCOL_UDP;
    if !udp || to == Destination::Other {
        let protocol = w6 >> 16 & 0xff;
        let ours = match w3 & 0xffff {
            ETHERTYPE_ARP => to != Destination::Other && frame.word(ARP_TARGET) == us.ip,
            ETHERTYPE_IPV4 if protocol == PROTOCOL_ICMP || protocol == PROTOCOL_TCP => {
                to == Destination::Us && destination == us.ip
            }
            // A router asks which groups are wanted.
            ETHERTYPE_IPV4 if protocol == PROTOCOL_IGMP => {
                to == Destination::Group && ports.iter().any(|port| *port != 0)
            }
            _ => false,
        };
        return if ours && us.ip != 0 {
            Class::Services
        } else {
            Class::Nothing
        };
    }
    let words = frame.word(9 + options);
    let lengths = frame.word(10 + options);
    let ours = match words as u16 {
        port if port == us.port && destination == us.ip && to == Destination::Us => true,
        // A host that looks for boards does not know their addresses.
        wire::DISCOVERY_PORT if to != Destination::Group => false,
        // A board that waits for an address has none.
        port if port != 0 && ports.contains(&port) => return Class::Services,
        _ => return Class::Nothing,
    };
    let header = [w4, w5, w6, source, destination];
    if fold(header.into_iter().fold(sum_words(frame, 9, options), add)) != 0xffff {
        return Class::Refused(Refusal::Checksum);
    }
    let ip_length = (w4 & 0xffff) as usize;
    let udp_length = (lengths >> 16) as usize;
    let consistent = udp_length >= UDP_HEADER
        && ip_length == udp_length + IP_HEADER + 4 * options
        && length >= ip_length + ETHERNET_HEADER
        // Padding is for short frames; an IP stack does not send any other frame that is longer
        // than its header says.
        && (length == ip_length + ETHERNET_HEADER || length <= FRAME_MIN);
    if !consistent {
        return Class::Refused(Refusal::Truncated);
    }
    let count = match payload_words(udp_length - UDP_HEADER) {
        Ok(count) => count,
        Err(why) => return Class::Refused(why),
    };
    let pseudo = add(add(source, destination), PROTOCOL_UDP + udp_length as u32);
    let places = payload.get_mut(..count).unwrap_or(&mut []);
    let sum = add(add(pseudo, words), lengths);
    let sum = take_payload(frame, PAYLOAD_WORD + options, places, sum);
    if lengths & 0xffff != 0 && fold(sum) != 0xffff {
        return Class::Refused(Refusal::Checksum);
    }
    let datagram = Datagram {
        peer: Peer {
            ip: source,
            port: (words >> 16) as u16,
        },
        mac: sender(frame),
        length: udp_length - UDP_HEADER,
        options,
        service: (w4 >> 16) as u8,
        ttl: (w6 >> 24) as u8,
    };
    match ours {
        true => Class::Ours(datagram),
        false => Class::Discovery(datagram),
    }
}

/// Reads the words from this one on into their places, and adds them to the sum.
#[inline(always)]
fn take_payload(frame: &impl Frame, first: usize, places: &mut [u32], mut sum: u32) -> u32 {
    let mut index = first;
    let (fours, rest) = places.as_chunks_mut::<FOUR>();
    for four in fours {
        let [a, b, c, d] = [
            frame.word(index),
            frame.word(index + 1),
            frame.word(index + 2),
            frame.word(index + 3),
        ];
        *four = [a, b, c, d];
        sum = add(add(add(add(sum, a), b), c), d);
        index += FOUR;
    }
    for place in rest {
        *place = frame.word(index);
        sum = add(sum, *place);
        index += 1;
    }
    sum
}

/// Bytes of the longest frame of [`Class::Services`] that is taken while a host moves the machine;
/// `services`: they run.
pub fn longest_in_motion(frame: &impl Frame, services: bool) -> usize {
    match services {
        true if comes_from_dhcp(frame) => GUEST_FRAME_DHCP,
        true => GUEST_FRAME_SERVICES,
        false => GUEST_FRAME,
    }
}

/// Is this frame of [`Class::Services`] ARP?
pub fn is_arp(frame: &impl Frame) -> bool {
    frame.word(3) & 0xffff == ETHERTYPE_ARP
}

/// The MAC address a frame comes from: upper 16, lower 32 bits.
pub fn sender(frame: &impl Frame) -> (u16, u32) {
    let (w2, w3) = (frame.word(2), frame.word(3));
    ((w2 >> 16) as u16, w2 << 16 | w3 >> 16)
}

/// Does this frame of [`Class::Services`] come from a DHCP server to a client?
fn comes_from_dhcp(frame: &impl Frame) -> bool {
    let udp = frame.word(3) & 0xffff == ETHERTYPE_IPV4
        && frame.word(6) >> 16 & 0xff == PROTOCOL_UDP
        && frame.word(4) >> 24 == IPV4_IHL5 >> 24;
    udp && frame.word(9) == u32::from(DHCP_SERVER) << 16 | u32::from(DHCP_CLIENT)
}

/// Where a frame is addressed to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Destination {
    /// This board.
    Us,
    /// All.
    All,
    /// A group of IPv4.
    Group,
    /// Another board.
    Other,
}

impl Destination {
    /// Of a frame with these first words.
    fn of(w0: u32, w1: u32, us: &Us) -> Self {
        match (w0 as u16, w1) {
            (0xffff, u32::MAX) => Destination::All,
            // A group's addresses are 01:00:5e and 23 bits of its IP address.
            (0x0100, _) if w1 >> 24 == 0x5e => Destination::Group,
            address if address == mac_halves(us.mac) => Destination::Us,
            _ => Destination::Other,
        }
    }
}

/// Words of a payload of this many bytes; refused if no datagram may have that length.
pub fn payload_words(bytes: usize) -> Result<usize, Refusal> {
    if bytes > wire::MAX_PAYLOAD {
        return Err(Refusal::Oversized);
    }
    if !bytes.is_multiple_of(4) {
        return Err(Refusal::Ragged);
    }
    Ok(bytes / 4)
}

/// Writes everything in front of the payload, as an answer to `to`. The UDP checksum is 0, which
/// IPv4 allows: the MAC's CRC covers the same bytes, and servo traffic does not pass routers.
pub fn emit_headers(slot: &mut impl Slot, us: &Us, to: &Datagram, payload_bytes: usize) {
    let udp_length = (UDP_HEADER + payload_bytes) as u32;
    let (ours_high, ours_low) = mac_halves(us.mac);
    let (theirs_high, theirs_low) = to.mac;
    // Identification 0, which RFC 6864 allows for atomic datagrams; don't fragment; TTL 64.
    let version = IPV4_IHL5 | (udp_length + IP_HEADER as u32);
    let (fragment, protocol) = (0x4000, 0x4011 << 16);
    let sum = [version, fragment, protocol, us.ip, to.peer.ip]
        .into_iter()
        .fold(0, add);
    slot.put(0, u32::from(theirs_high));
    slot.put(1, theirs_low);
    slot.put(2, u32::from(ours_high) << 16 | ours_low >> 16);
    slot.put(3, ours_low << 16 | ETHERTYPE_IPV4);
    slot.put(4, version);
    slot.put(5, fragment);
    slot.put(6, protocol | !fold(sum) & 0xffff);
    slot.put(7, us.ip);
    slot.put(8, to.peer.ip);
    slot.put(9, u32::from(us.port) << 16 | u32::from(to.peer.port));
    slot.put(10, udp_length << 16);
}

/// Copies a payload after the headers; returns the frame's length in bytes.
pub fn emit_payload(slot: &mut impl Slot, payload: &[u32]) -> usize {
    let (fours, rest) = payload.as_chunks::<FOUR>();
    let mut at = PAYLOAD_WORD;
    for [a, b, c, d] in fours {
        slot.put(at, *a);
        slot.put(at + 1, *b);
        slot.put(at + 2, *c);
        slot.put(at + 3, *d);
        at += FOUR;
    }
    for word in rest {
        slot.put(at, *word);
        at += 1;
    }
    HEADERS + payload.len() * 4
}

/// Words in one turn of the loops that move most words of an exchange: a turn costs more than the
/// loads and stores of a word.
pub(crate) const FOUR: usize = 4;

/// Ones' complement sum of `count` words.
fn sum_words(frame: &impl Frame, start: usize, count: usize) -> u32 {
    (start..start + count).fold(0, |sum, index| add(sum, frame.word(index)))
}

/// Ones' complement addition of words; halves may be folded at the end because 2^16 = 1 mod 2^16 -
/// 1.
#[inline(always)]
pub(crate) const fn add(sum: u32, word: u32) -> u32 {
    let (sum, carry) = sum.overflowing_add(word);
    sum + carry as u32
}

/// Folds a 32-bit ones' complement sum into 16 bits.
#[inline(always)]
pub(crate) const fn fold(sum: u32) -> u32 {
    let sum = (sum >> 16) + (sum & 0xffff);
    (sum >> 16) + (sum & 0xffff)
}

/// The first words of a frame to this MAC address.
pub fn to_mac(mac: [u8; 6]) -> [u32; 2] {
    let (high, low) = mac_halves(mac);
    [u32::from(high), low]
}

/// A MAC address split into its first 16 and its last 32 bits.
const fn mac_halves(mac: [u8; 6]) -> (u16, u32) {
    let [a, b, c, d, e, f] = mac;
    (u16::from_be_bytes([a, b]), u32::from_be_bytes([c, d, e, f]))
}

#[cfg(test)]
mod tests;
