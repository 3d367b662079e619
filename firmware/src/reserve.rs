//! Answers ARP and ping while there are no services: on boards without SDRAM, until the services
//! are loaded, and after they failed. It answers nothing else; Etherbone and discovery, which an
//! update needs, are in the ROM, too.
//!
//! Answers go to the MAC address the question came from, so the board resolves no addresses.

use crate::net::{Us, add, fold};

/// Room for the longest answer: as long as the longest frame.
pub const ROOM: usize = 1514;

const ETHERNET: usize = 14;
/// The ICMP message in a frame whose IP header has no options.
const MESSAGE: usize = 34;
/// Bytes of an ARP frame, and of a ping without what it carries.
const HEAD: usize = 42;
/// Flags and offset of a fragment: more of them follow, or it is not the first one.
const FRAGMENT: u16 = 0x3fff;
const ICMP: u8 = 1;
const TTL: u8 = 64;

/// Answers a frame into `out`: an ARP request about our address, or a ping to it. Returns the
/// answer's length in bytes.
pub fn answer(frame: &[u8], us: &Us, out: &mut [u8; ROOM]) -> Option<usize> {
    let asked = frame.first_chunk()?;
    match asked[12..ETHERNET] {
        [8, 6] => arp(asked, us, out.first_chunk_mut()?),
        [8, 0] => ping(asked, frame, us, out),
        _ => None,
    }
}

fn arp(asked: &[u8; HEAD], us: &Us, out: &mut [u8; HEAD]) -> Option<usize> {
    let ours = us.ip.to_be_bytes();
    // Ethernet, IPv4, addresses of 6 and 4 bytes, a question.
    if asked[ETHERNET..22] != [0, 1, 8, 0, 6, 4, 0, 1] || asked[38..] != ours {
        return None;
    }
    out[..6].copy_from_slice(&asked[22..28]);
    out[6..12].copy_from_slice(&us.mac);
    out[12..22].copy_from_slice(&[8, 6, 0, 1, 8, 0, 6, 4, 0, 2]);
    out[22..28].copy_from_slice(&us.mac);
    out[28..32].copy_from_slice(&ours);
    out[32..].copy_from_slice(&asked[22..32]);
    Some(HEAD)
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

/// The half word there.
fn half<const AT: usize>(bytes: &[u8; HEAD]) -> u16 {
    u16::from_be_bytes([bytes[AT], bytes[AT + 1]])
}

/// Adds to the checksum there what has been taken from its bytes.
fn adjust<const AT: usize>(bytes: &mut [u8; HEAD], taken: u32) {
    let sum = fold(add(half::<AT>(bytes).into(), taken));
    [bytes[AT], bytes[AT + 1]] = (sum as u16).to_be_bytes();
}

/// Answers a ping, whose IP header has no options. It is a function of its own because a test
/// breaks it to see a trap. smoltcp's way of reading one takes 1 KiB more.
#[inline(never)]
fn ping(asked: &[u8; HEAD], frame: &[u8], us: &Us, out: &mut [u8; ROOM]) -> Option<usize> {
    let length = ETHERNET + usize::from(half::<16>(asked));
    let frame = frame.get(..length)?;
    let ours = us.ip.to_be_bytes();
    let addressed = length >= HEAD
        && asked[ETHERNET] == 0x45
        && half::<20>(asked) & FRAGMENT == 0
        && asked[23] == ICMP
        && asked[30..MESSAGE] == ours
        && asked[MESSAGE..36] == [8, 0];
    let message = frame.get(MESSAGE..)?;
    if !addressed || sum(&asked[ETHERNET..MESSAGE]) != 0xffff || sum(message) != 0xffff {
        return None;
    }
    // The answer is the question with other addresses, type 0 instead of 8, and a new life.
    for (place, byte) in out.iter_mut().zip(frame) {
        *place = *byte;
    }
    let answer = out.first_chunk_mut()?;
    answer[..6].copy_from_slice(&asked[6..12]);
    answer[6..12].copy_from_slice(&us.mac);
    answer[26..30].copy_from_slice(&ours);
    answer[30..MESSAGE].copy_from_slice(&asked[26..30]);
    answer[22] = TTL;
    // 0xffff - TTL << 8 is the negative of it.
    let ttl = (u32::from(asked[22]) << 8) + 0xffff - (u32::from(TTL) << 8);
    adjust::<24>(answer, ttl);
    answer[MESSAGE] = 0;
    adjust::<36>(answer, 0x0800);
    (length <= ROOM).then_some(length)
}

#[cfg(test)]
mod tests;
