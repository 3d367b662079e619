//! The CRC-32 of Ethernet, zip and Python's `binascii.crc32`; the project uses no other.

/// A byte at a time. A softcore computes it over a whole image in flash, and again and again over
/// the code in its SDRAM, which is worth a table of 1 KiB.
const TABLE: [u32; 256] = {
    let mut table = [0; 256];
    let mut index = 0;
    while index < 256 {
        let mut crc = index as u32;
        let mut bit = 0;
        while bit < 8 {
            crc = if crc & 1 != 0 {
                crc >> 1 ^ 0xedb8_8320
            } else {
                crc >> 1
            };
            bit += 1;
        }
        table[index] = crc;
        index += 1;
    }
    table
};

/// A CRC in progress.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Crc32(u32);

impl Default for Crc32 {
    fn default() -> Self {
        Self::new()
    }
}

impl Crc32 {
    /// The CRC of no bytes.
    pub const fn new() -> Self {
        Crc32(!0)
    }

    /// Adds these bytes.
    pub fn update(&mut self, bytes: &[u8]) {
        let step = |crc: u32, byte: &u8| {
            let index = crc as u8 ^ byte;
            crc >> 8 ^ TABLE[usize::from(index)]
        };
        self.0 = bytes.iter().fold(self.0, step);
    }

    /// Adds the big-endian bytes of these words. [`Self::update`] takes twice the time for them.
    pub fn update_words(&mut self, words: &[u32]) {
        let step = |crc: u32| crc >> 8 ^ TABLE[usize::from(crc as u8)];
        for word in words {
            // The first byte is the lowest now.
            self.0 = step(step(step(step(self.0 ^ word.swap_bytes()))));
        }
    }

    /// The CRC of everything so far.
    pub const fn value(self) -> u32 {
        !self.0
    }
}

/// The CRC of these bytes.
pub fn crc32(bytes: &[u8]) -> u32 {
    let mut crc = Crc32::new();
    crc.update(bytes);
    crc.value()
}

/// The CRC of the big-endian bytes of these words.
pub fn crc32_words(words: &[u32]) -> u32 {
    let mut crc = Crc32::new();
    crc.update_words(words);
    crc.value()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_crc_is_the_standard_one() {
        assert_eq!(crc32(b"123456789"), 0xcbf4_3926);
        assert_eq!(crc32(b""), 0);
        assert_eq!(crc32_words(&[0x3132_3334, 0x3536_3738]), crc32(b"12345678"));
    }

    #[test]
    fn words_have_the_crc_of_their_bytes() {
        let words = [0, 1, 0x8000_0000, 0x0123_4567, 0xfedc_ba98, u32::MAX];
        let mut crc = Crc32::new();
        for word in words {
            crc.update(&word.to_be_bytes());
        }
        assert_eq!(crc32_words(&words), crc.value());
    }

    #[test]
    fn it_may_be_counted_in_pieces() {
        let mut crc = Crc32::new();
        crc.update(b"1234");
        crc.update(b"56789");
        assert_eq!(crc.value(), crc32(b"123456789"));
    }
}
