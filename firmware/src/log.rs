//! The log ring: the newest bytes of the defmt stream, readable while it is written.
//!
//! A reader fetches the head, then ring words, then the head again. Bytes that are more than the
//! ring's size before the second head were overwritten during the read. The writer never waits for
//! a reader.

/// A word of the log window.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Read {
    /// Absolute index of the byte after the newest.
    Head,
    /// Ring size in bytes.
    Size,
    /// Four bytes of the ring, big-endian.
    Ring(usize),
}

/// `SIZE` bytes, a power of two, so that the absolute index may wrap.
#[derive(Clone, Debug)]
pub struct Ring<const SIZE: usize> {
    head: u32,
    bytes: [u8; SIZE],
}

impl<const SIZE: usize> Default for Ring<SIZE> {
    fn default() -> Self {
        Self::new()
    }
}

impl<const SIZE: usize> Ring<SIZE> {
    const MASK: usize = {
        assert!(SIZE.is_power_of_two() && SIZE >= 4);
        SIZE - 1
    };

    /// Empty.
    pub const fn new() -> Self {
        Ring {
            head: 0,
            bytes: [0; SIZE],
        }
    }

    /// Appends bytes over the oldest ones.
    pub fn push(&mut self, bytes: &[u8]) {
        for byte in bytes {
            if let Some(slot) = self.bytes.get_mut(self.head as usize & Self::MASK) {
                *slot = *byte;
            }
            self.head = self.head.wrapping_add(1);
        }
    }

    /// A word of the log window; 0 past the ring.
    pub fn read(&self, what: Read) -> u32 {
        match what {
            Read::Head => self.head,
            Read::Size => SIZE as u32,
            Read::Ring(word) => self
                .bytes
                .as_chunks::<4>()
                .0
                .get(word)
                .map_or(0, |chunk| u32::from_be_bytes(*chunk)),
        }
    }
}

/// The stamp of an event: microseconds since power-up, for a time in clocks. Half words of the time
/// are divided one after the other: a division of 64 bits would be 750 bytes of ROM.
pub fn microseconds(clocks: u64, clock_hz: u32) -> u64 {
    let per_us = clock_hz / 1_000_000;
    let (mut time, mut rest) = (0u64, 0u32);
    for shift in [48, 32, 16, 0] {
        // The rest is less than 4295, so this is less than 2^32.
        let part = rest << 16 | (clocks >> shift) as u32 & 0xffff;
        time = time << 16 | u64::from(part.checked_div(per_us).unwrap_or(0));
        rest = part.checked_rem(per_us).unwrap_or(0);
    }
    time
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stamp_is_the_time_divided_by_the_clocks_of_a_microsecond() {
        for clocks in [0, 59, 60, 0xffff_ffff, 1 << 32, u64::MAX / 7, u64::MAX] {
            for clock_hz in [1_000_000, 60_000_000, 125_000_000, u32::MAX] {
                let wanted = clocks / u64::from(clock_hz / 1_000_000);
                assert_eq!(
                    microseconds(clocks, clock_hz),
                    wanted,
                    "{clocks} {clock_hz}"
                );
            }
        }
        assert_eq!(microseconds(u64::MAX, 999_999), 0, "no such clock");
    }

    #[test]
    fn the_newest_bytes_are_where_their_index_says() {
        let mut ring = Ring::<8>::new();
        ring.push(b"abcdefghij");
        assert_eq!(ring.read(Read::Head), 10);
        assert_eq!(ring.read(Read::Size), 8);
        assert_eq!(ring.read(Read::Ring(0)).to_be_bytes(), *b"ijcd");
        assert_eq!(ring.read(Read::Ring(1)).to_be_bytes(), *b"efgh");
        assert_eq!(ring.read(Read::Ring(2)), 0);
    }

    #[test]
    fn the_index_may_wrap() {
        let mut ring = Ring::<8>::new();
        ring.head = u32::MAX;
        ring.push(b"xyz");
        assert_eq!(ring.read(Read::Head), 2);
        assert_eq!(ring.read(Read::Ring(0)).to_be_bytes()[..2], *b"yz");
        assert_eq!(ring.bytes[7], b'x');
    }
}
