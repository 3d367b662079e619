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

#[cfg(test)]
mod tests {
    use super::*;

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
