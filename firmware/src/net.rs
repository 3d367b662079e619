//! Recognises the frames the Etherbone server wants without an IP stack, and checks them whole.
//!
//! UDP to our address and port in one IPv4 packet, with IP options or without: that is every frame
//! Etherbone comes in. Everything else (ARP, ping, TCP, fragments, broadcast) is [`Class::Other`] and
//! goes to smoltcp. A frame that is ours but damaged is refused here with its reason.
//!
//! Frames are read as big-endian words as the MAC's slots deliver them. The UDP payload begins at
//! byte 42, half way into word 10:
//!
//! ```text
//! word  0       1        2       3        4        5       6       7       8       9       10
//!      |dst mac    |src mac     |0800 45 |len  id |frag ttl|sum src|src dst|dst sport|dport|sum payload...
//! ```

use crate::session::Peer;
use wire::Refusal;

/// Bytes before the UDP payload.
pub const HEADERS: usize = 42;
/// Frames are at least this long on the wire (without FCS); shorter ones are padded.
pub const FRAME_MIN: usize = 60;
/// Word the payload begins in the middle of.
pub const PAYLOAD_WORD: usize = 10;

/// Ethertype, IP version 4 and a header of five words, as they lie in the upper bytes of word 3.
const ETHERTYPE_IPV4_IHL5: u32 = 0x0008_0045;
const ETHERTYPE_IPV4: u32 = ETHERTYPE_IPV4_IHL5 >> 4;
const PROTOCOL_UDP: u32 = 17;
/// More-fragments flag, fragment offset and the reserved bit; don't-fragment may be either.
const FRAGMENT: u32 = 0xbfff;
const IP_HEADER: usize = 20;
/// IHL is four bits: at most fifteen words, five of which are no options.
const OPTIONS_MAX: usize = 10;
const UDP_HEADER: usize = 8;
const ETHERNET_HEADER: usize = 14;

/// A received frame as big-endian words. Words past the frame's end read as anything.
pub trait Frame {
    /// Bytes `4 * index ..` of the frame.
    fn word(&self, index: usize) -> u32;
}

/// A frame to be sent, as big-endian words.
pub trait Slot {
    /// Sets bytes `4 * index ..`.
    fn put(&mut self, index: usize, word: u32);
}

/// Our side of the wire.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Us {
    /// MAC address.
    pub mac: [u8; 6],
    /// IPv4 address.
    pub ip: u32,
    /// UDP port of the Etherbone server.
    pub port: u16,
}

/// What a frame is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Class {
    /// A datagram for the Etherbone server.
    Ours(Datagram),
    /// Meant for the Etherbone server, but damaged.
    Refused(Refusal),
    /// Somebody else's business.
    Other,
}

/// A checked datagram: its headers are right and its payload lies inside the frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Datagram {
    /// Who sent it.
    pub peer: Peer,
    /// MAC address to answer to: upper 16, lower 32 bits.
    pub mac: (u16, u32),
    /// Payload length in bytes.
    pub length: usize,
    /// Words of IP options: the payload lies that much further behind.
    pub options: usize,
}

/// Looks at a frame of `length` bytes.
pub fn classify(frame: &impl Frame, length: usize, us: &Us) -> Class {
    let [mac0, mac1] = mac_words(us.mac);
    let [w0, w1, w2, w3, w4, w5, w6, w7, w8] = core::array::from_fn(|index| frame.word(index));
    let destination = (w7 << 16) | (w8 >> 16);
    let options = (w3 >> 8 & 0xf).wrapping_sub(5) as usize;
    let recognised = length >= HEADERS
        && w0 == mac0
        && w1 >> 16 == mac1 >> 16
        && w3 >> 12 == ETHERTYPE_IPV4
        && options <= OPTIONS_MAX
        && w5 & 0xff == PROTOCOL_UDP
        && w5 >> 16 & FRAGMENT == 0
        && destination == us.ip;
    // From here on, words count from the last one of the IP header.
    let ports = frame.word(8 + options);
    let lengths = frame.word(9 + options);
    let checksum = frame.word(10 + options);
    if !recognised || lengths >> 16 != u32::from(us.port) {
        return Class::Other;
    }
    let mut ip_sum = add(add(add(add(w3 & 0xffff, w4), w5), w6), w7);
    for index in 8..8 + options {
        ip_sum = add(ip_sum, frame.word(index));
    }
    if fold(add(ip_sum, ports & 0xffff_0000)) != 0xffff {
        return Class::Refused(Refusal::Checksum);
    }
    let ip_length = (w4 >> 16) as usize;
    let udp_length = (lengths & 0xffff) as usize;
    let consistent = udp_length >= UDP_HEADER
        && ip_length == udp_length + IP_HEADER + 4 * options
        && length >= ip_length + ETHERNET_HEADER
        // Padding is for short frames; anything else that is longer than it says is not from a stack.
        && (length == ip_length + ETHERNET_HEADER || length <= FRAME_MIN);
    if !consistent {
        return Class::Refused(Refusal::Truncated);
    }
    if checksum >> 16 != 0 {
        let pseudo = add(add(w6 & 0xffff, w7), w8 & 0xffff_0000);
        let pseudo = add(pseudo, PROTOCOL_UDP + udp_length as u32);
        if !udp_checksum_fits(frame, 8 + options, pseudo, udp_length) {
            return Class::Refused(Refusal::Checksum);
        }
    }
    Class::Ours(Datagram {
        peer: Peer {
            ip: w6 << 16 | w7 >> 16,
            port: ports as u16,
        },
        mac: (w1 as u16, w2),
        length: udp_length - UDP_HEADER,
        options,
    })
}

/// A payload word: two halves of two frame words.
pub fn payload_word(frame: &impl Frame, options: usize, index: usize) -> u32 {
    let at = PAYLOAD_WORD + options + index;
    frame.word(at) << 16 | frame.word(at + 1) >> 16
}

/// Writes the eleven words before and around the first payload half: `to` is answered. UDP checksum
/// 0, which IPv4 allows: the MAC's CRC covers the same bytes and nobody routes a servo period.
pub fn emit_headers(slot: &mut impl Slot, us: &Us, to: &Datagram, payload_bytes: usize) {
    let ip_length = (IP_HEADER + UDP_HEADER + payload_bytes) as u32;
    let [mac0, mac1] = mac_words(us.mac);
    let ours = us.ip;
    let theirs = to.peer.ip;
    // Don't fragment, identification 0 (RFC 6864 allows it for atomic datagrams), TTL 64.
    let sum = [0x4500, ip_length, 0x4000, 0x4011, ours, theirs]
        .iter()
        .fold(0, |sum, word| add(sum, *word));
    let checksum = !fold(sum) & 0xffff;
    let words = [
        u32::from(to.mac.0) << 16 | to.mac.1 >> 16,
        to.mac.1 << 16 | mac0 >> 16,
        mac0 << 16 | mac1 >> 16,
        0x0800_4500,
        ip_length << 16,
        0x4000_4011,
        checksum << 16 | ours >> 16,
        ours << 16 | theirs >> 16,
        theirs << 16 | u32::from(us.port),
        u32::from(to.peer.port) << 16 | (UDP_HEADER + payload_bytes) as u32,
    ];
    for (index, word) in words.into_iter().enumerate() {
        slot.put(index, word);
    }
}

/// Copies a payload behind the headers; returns the frame's length in bytes.
pub fn emit_payload(slot: &mut impl Slot, payload: &[u32]) -> usize {
    let mut carry = 0;
    for (index, word) in payload.iter().enumerate() {
        slot.put(PAYLOAD_WORD + index, carry << 16 | word >> 16);
        carry = *word;
    }
    slot.put(PAYLOAD_WORD + payload.len(), carry << 16);
    HEADERS + payload.len() * 4
}

/// The fast lane: the headers of the exchange that ran last, so that the next one from the same host
/// is recognised by comparing words, and its answer's headers are already in the slot.
#[derive(Clone, Copy, Debug)]
pub struct Lane {
    /// Destination and source MAC, as the request carries them.
    macs: [u32; 3],
    /// Total IP length, upper half of word 4.
    ip_length: u32,
    /// Words 7..=9: addresses, ports, UDP length; and the low half of word 6.
    source_high: u32,
    tail: [u32; 3],
    /// Ones' complement sum of the IP header without TOS, id, flags, TTL and checksum.
    ip_sum: u32,
    /// Ones' complement sum of pseudo header and UDP header without its checksum.
    udp_sum: u32,
    /// The third Etherbone word.
    record: u32,
    /// Whose lane it is.
    pub datagram: Datagram,
}

impl Lane {
    /// A lane for exchanges of `command_words` words from the sender of `datagram`.
    pub fn new(us: &Us, datagram: Datagram, command_words: usize) -> Self {
        let [mac0, mac1] = mac_words(us.mac);
        let payload = (wire::exchange::REQUEST_OVERHEAD + command_words) * 4;
        let udp_length = (UDP_HEADER + payload) as u32;
        let ip_length = udp_length + IP_HEADER as u32;
        let (theirs, ours) = (datagram.peer.ip, us.ip);
        let ports = u32::from(datagram.peer.port) << 16 | u32::from(us.port);
        let sum = |words: &[u32]| words.iter().fold(0, |sum, word| add(sum, *word));
        Lane {
            macs: [mac0, mac1 | u32::from(datagram.mac.0), datagram.mac.1],
            ip_length,
            source_high: theirs >> 16,
            tail: [
                theirs << 16 | ours >> 16,
                ours << 16 | u32::from(datagram.peer.port),
                u32::from(us.port) << 16 | udp_length,
            ],
            ip_sum: fold(sum(&[0x4500, ip_length, PROTOCOL_UDP, theirs, ours])),
            udp_sum: fold(sum(&[
                theirs,
                ours,
                PROTOCOL_UDP,
                udp_length,
                ports,
                udp_length,
            ])),
            record: wire::etherbone::BYTE_ENABLE | (command_words as u32) << 8,
            datagram,
        }
    }

    /// Is this frame an exchange in this lane? If so, the command block behind its headers, whose
    /// UDP checksum is known to be right or wrong once it has been read to its end. A `None` says
    /// nothing against the frame: the long way round finds out what it is.
    #[inline(always)]
    pub fn open<'f, F: Frame>(&self, frame: &'f F, length: usize) -> Option<Command<'f, F>> {
        let (w0, w1, w2, w3) = (frame.word(0), frame.word(1), frame.word(2), frame.word(3));
        let (w4, w5, w6, w7) = (frame.word(4), frame.word(5), frame.word(6), frame.word(7));
        let (w8, w9, w10) = (frame.word(8), frame.word(9), frame.word(PAYLOAD_WORD));
        let macs = w0 ^ self.macs[0] | w1 ^ self.macs[1] | w2 ^ self.macs[2];
        let shape = w3 >> 8 ^ ETHERTYPE_IPV4_IHL5
            | w4 >> 16 ^ self.ip_length
            | w5 & (FRAGMENT << 16 | 0xff) ^ PROTOCOL_UDP
            | w6 & 0xffff ^ self.source_high
            | length as u32 ^ self.ip_length + ETHERNET_HEADER as u32;
        let tail = w7 ^ self.tail[0] | w8 ^ self.tail[1] | w9 ^ self.tail[2];
        if macs | shape | tail != 0 {
            return None;
        }
        // Sums of a few 16-bit numbers: no carry is lost. PROTOCOL_UDP is in `ip_sum` already.
        let ip_sum =
            self.ip_sum + (w3 & 0xff) + (w4 & 0xffff) + (w5 >> 16) + (w5 & 0xff00) + (w6 >> 16);
        if fold(ip_sum) != 0xffff {
            return None;
        }
        let mut command = Command {
            frame,
            index: PAYLOAD_WORD,
            carry: w10,
            low: w10 & 0xffff,
            high: 0,
            udp_sum: self.udp_sum,
            checksum: w10 >> 16,
        };
        let [header, _padding, record, base] = command.take4();
        let difference =
            header ^ wire::etherbone::HEADER | record ^ self.record | base ^ wire::map::COMMAND;
        (difference == 0).then_some(command)
    }
}

/// The command block of a frame in the lane, read word by word, each word once. It sums the UDP
/// checksum on the way.
///
/// With `a_k` the frame words and `h_k` their upper halves, the payload's ones' complement sum is
/// `sum(a_k mod 2^16) + sum(h_k)`, and `sum(a_k mod 2^16) = sum(a_k) - 2^16 sum(h_k)`, exactly, in 32
/// bits, as long as there are fewer than 2^16 words. That is two additions per word; the shift that
/// makes `h_k` is needed for the payload anyway.
#[derive(Debug)]
pub struct Command<'f, F> {
    frame: &'f F,
    index: usize,
    carry: u32,
    low: u32,
    high: u32,
    udp_sum: u32,
    checksum: u32,
}

impl<F: Frame> Command<'_, F> {
    #[inline(always)]
    fn load(&mut self) -> u32 {
        self.index += 1;
        self.frame.word(self.index)
    }

    #[inline(always)]
    fn combine(&mut self, word: u32) -> u32 {
        let high = word >> 16;
        self.high = self.high.wrapping_add(high);
        self.low = self.low.wrapping_add(word);
        let payload = self.carry << 16 | high;
        self.carry = word;
        payload
    }
}

/// Loads first, uses later: see [`crate::exchange::Request`].
macro_rules! take {
    ($self:ident, $($word:ident),+) => {{
        $(let $word = $self.load();)+
        [$($self.combine($word)),+]
    }};
}

impl<F: Frame> crate::exchange::Request for Command<'_, F> {
    #[inline(always)]
    fn take1(&mut self) -> [u32; 1] {
        take!(self, a)
    }

    #[inline(always)]
    fn take2(&mut self) -> [u32; 2] {
        take!(self, a, b)
    }

    #[inline(always)]
    fn take4(&mut self) -> [u32; 4] {
        take!(self, a, b, c, d)
    }

    #[inline(always)]
    fn take7(&mut self) -> [u32; 7] {
        take!(self, a, b, c, d, e, f, g)
    }

    #[inline(always)]
    fn intact(&mut self) -> bool {
        if self.checksum == 0 {
            return true;
        }
        // `low` began with the lower half of word 10 and holds the last word's lower half, which is
        // behind the payload.
        let lows = self
            .low
            .wrapping_sub(self.high << 16)
            .wrapping_sub(self.carry & 0xffff);
        let sum = add(add(add(self.udp_sum, self.checksum), lows), self.high);
        fold(sum) == 0xffff
    }
}

use crate::exchange::Request as _;

/// Sums the UDP part, which begins in the lower half of word `start`.
fn udp_checksum_fits(frame: &impl Frame, start: usize, pseudo: u32, udp_length: usize) -> bool {
    let mut sum = add(pseudo, frame.word(start) & 0xffff);
    let bytes = udp_length - 2;
    for index in 0..bytes / 4 {
        sum = add(sum, frame.word(start + 1 + index));
    }
    let rest = bytes % 4;
    if rest != 0 {
        let keep = !(u32::MAX >> (8 * rest));
        sum = add(sum, frame.word(start + 1 + bytes / 4) & keep);
    }
    fold(sum) == 0xffff
}

/// Ones' complement addition of words; halves may be folded at the end because 2^16 = 1 mod 2^16 - 1.
#[inline(always)]
const fn add(sum: u32, word: u32) -> u32 {
    let (sum, carry) = sum.overflowing_add(word);
    sum + carry as u32
}

/// Folds a 32-bit ones' complement sum into 16 bits.
#[inline(always)]
const fn fold(sum: u32) -> u32 {
    let sum = (sum >> 16) + (sum & 0xffff);
    (sum >> 16) + (sum & 0xffff)
}

/// A MAC address as the first 32 bits and, in the upper half, the last 16.
const fn mac_words(mac: [u8; 6]) -> [u32; 2] {
    let [a, b, c, d, e, f] = mac;
    [
        u32::from_be_bytes([a, b, c, d]),
        u32::from_be_bytes([e, f, 0, 0]),
    ]
}

#[cfg(test)]
mod tests;
