//! An input that is read to its end; zeros follow the end, so that every input is valid.

/// The rest of an input.
#[derive(Clone, Copy, Debug)]
pub struct ByteReader<'d>(pub &'d [u8]);

impl<'d> ByteReader<'d> {
    /// Has everything been read?
    pub fn is_over(&self) -> bool {
        self.0.is_empty()
    }

    /// The next byte.
    pub fn byte(&mut self) -> u8 {
        let [byte] = self.array();
        byte
    }

    /// The next two, the most significant first.
    pub fn half(&mut self) -> u16 {
        u16::from_be_bytes(self.array())
    }

    /// The next four.
    pub fn word(&mut self) -> u32 {
        u32::from_be_bytes(self.array())
    }

    /// At most this many bytes.
    pub fn take(&mut self, most: usize) -> &'d [u8] {
        let (head, rest) = self.0.split_at(most.min(self.0.len()));
        self.0 = rest;
        head
    }

    /// A byte with a length, and that many bytes.
    pub fn some(&mut self) -> &'d [u8] {
        let count = self.byte();
        self.take(count.into())
    }

    /// Two bytes with a length, and that many bytes.
    pub fn many(&mut self) -> &'d [u8] {
        let count = self.half();
        self.take(count.into())
    }

    /// This many bytes.
    pub fn array<const N: usize>(&mut self) -> [u8; N] {
        let mut bytes = [0; N];
        let head = self.take(N);
        bytes[..head.len()].copy_from_slice(head);
        bytes
    }
}

/// Bytes as words, the last one filled up with zeros.
pub fn words(bytes: &[u8]) -> Vec<u32> {
    let mut input = ByteReader(bytes);
    let mut words = Vec::with_capacity(bytes.len().div_ceil(4));
    while !input.is_over() {
        words.push(input.word());
    }
    words
}

/// Words as bytes.
pub fn bytes(words: &[u32]) -> Vec<u8> {
    words.iter().flat_map(|word| word.to_be_bytes()).collect()
}
