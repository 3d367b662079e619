//! Answers ARP and ping while there are no services: on boards without SDRAM, until the services
//! are loaded, and after they failed. It answers nothing else; Etherbone and discovery, which an
//! update needs, are in the ROM, too.
//!
//! Answers go to the MAC address the question came from, so the board resolves no addresses.

use crate::net::{Us, add, fold};

/// Room for the longest answer: as long as the longest frame.
pub const ROOM: usize = 1514;

const ETHERNET: usize = 14;
const IP_HEADER: usize = 20;
/// Bytes of an ARP message.
const ARP: usize = 28;
/// Flags and offset of a fragment: more of them follow, or it is not the first one.
const FRAGMENT: u16 = 0x3fff;
const ICMP: u8 = 1;

/// Answers a frame into `out`: an ARP request about our address, or a ping to it. Returns the
/// answer's length in bytes.
pub fn answer(frame: &[u8], us: &Us, out: &mut [u8; ROOM]) -> Option<usize> {
    let (head, payload) = frame.split_first_chunk::<ETHERNET>()?;
    let [_, _, _, _, _, _, from @ .., high, low] = head;
    match (high, low) {
        (8, 6) => arp(payload, us, out),
        (8, 0) => ping(from, payload, us, out),
        _ => None,
    }
}

/// Writes these parts one after the other; returns how long they are together.
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

/// The ones' complement sum of bytes: 0xffff if a right checksum is among them.
#[inline(never)]
fn sum(bytes: &[u8]) -> u32 {
    let halves = bytes.chunks(2).map(|pair| match pair {
        [high, low] => u32::from(u16::from_be_bytes([*high, *low])),
        [high] => u32::from(*high) << 8,
        _ => 0,
    });
    // A frame is too short for more than 32 bits.
    fold(halves.fold(0, u32::wrapping_add))
}

/// Answers a ping. It is a function of its own because a test breaks it to see a trap. smoltcp's
/// way of reading one takes 1 KiB more.
#[inline(never)]
fn ping(to: &[u8; 6], asked: &[u8], us: &Us, out: &mut [u8; ROOM]) -> Option<usize> {
    let [
        version,
        _,
        l0,
        l1,
        _,
        _,
        f0,
        f1,
        _,
        protocol,
        _,
        _,
        addresses @ ..,
    ] = asked.first_chunk::<IP_HEADER>()?;
    let (theirs, ours) = addresses.split_first_chunk::<4>()?;
    let header = asked.get(..usize::from(version & 15) * 4)?;
    let body = asked.get(header.len()..u16::from_be_bytes([*l0, *l1]).into())?;
    let addressed = version >> 4 == 4
        && header.len() >= IP_HEADER
        && u16::from_be_bytes([*f0, *f1]) & FRAGMENT == 0
        && *protocol == ICMP
        && *ours == us.ip.to_be_bytes();
    if !addressed || sum(header) != 0xffff || sum(body) != 0xffff {
        return None;
    }
    // The answer is the question with type 0 instead of 8; its sum grows by as much.
    let [8, 0, high, low, rest @ ..] = body else {
        return None;
    };
    rest.first_chunk::<4>()?;
    let sum = u32::from(u16::from_be_bytes([*high, *low]));
    let [high, low] = (fold(add(sum, 0x0800)) as u16).to_be_bytes();
    let length = (IP_HEADER + body.len()) as u32;
    let theirs = u32::from_be_bytes(*theirs);
    // As `net::emit_headers`: identification 0, don't fragment, TTL 64, ICMP.
    let words = [0x4500 << 16 | length, 0x4000, 0x4001 << 16, us.ip, theirs];
    let check = !fold(words.into_iter().fold(0, add)) & 0xffff;
    let [w0, w1, w2, w3, w4] = words.map(u32::to_be_bytes);
    let [_, _, check_high, check_low] = check.to_be_bytes();
    let [ttl, protocol, ..] = w2;
    let parts: [&[u8]; 10] = [
        to,
        &us.mac,
        &[8, 0],
        &w0,
        &w1,
        &[ttl, protocol, check_high, check_low],
        &w3,
        &w4,
        &[0, 0, high, low],
        rest,
    ];
    (ETHERNET + length as usize <= ROOM).then(|| put(&parts, out))
}

#[cfg(test)]
mod tests;
