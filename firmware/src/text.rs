//! Text in pieces, for the console and for crash reports.
//!
//! `core::fmt` would cost about 8 KiB of this image: a hundred bytes at every `write!`, and the
//! formatting of numbers. Two calls per piece cost eight bytes.

/// A destination for text. What does not fit is lost, without an error.
pub trait Sink {
    /// Appends text.
    fn put(&mut self, text: &[u8]);
}

/// Room for an answer, as bytes; what does not fit is lost.
#[derive(Debug)]
pub struct Paper<'a> {
    bytes: &'a mut [u8],
    used: usize,
}

impl<'a> Paper<'a> {
    /// An empty buffer.
    pub fn new(bytes: &'a mut [u8]) -> Self {
        Paper { bytes, used: 0 }
    }

    /// Bytes used.
    pub fn used(&self) -> usize {
        self.used
    }

    /// Bytes that still fit.
    pub fn room(&self) -> usize {
        self.bytes.len() - self.used
    }
}

impl Sink for Paper<'_> {
    fn put(&mut self, text: &[u8]) {
        if let Some(place) = self.bytes.get_mut(self.used..self.used + text.len()) {
            place.copy_from_slice(text);
            self.used += text.len();
        }
    }
}

/// Writes pieces of text to a sink.
pub struct Out<'s>(pub &'s mut dyn Sink);

impl Out<'_> {
    /// Text as it is.
    pub fn text(&mut self, text: &str) -> &mut Self {
        self.0.put(text.as_bytes());
        self
    }

    /// One of two texts.
    pub fn either(&mut self, which: bool, yes: &str, no: &str) -> &mut Self {
        self.text(if which { yes } else { no })
    }

    /// Decimal.
    pub fn number(&mut self, mut number: u32) -> &mut Self {
        let mut digits = [0; 10];
        let mut first = digits.len();
        loop {
            first -= 1;
            if let Some(digit) = digits.get_mut(first) {
                *digit = b'0' + (number % 10) as u8;
            }
            number /= 10;
            if number == 0 || first == 0 {
                break;
            }
        }
        self.0.put(digits.get(first..).unwrap_or(&[]));
        self
    }

    /// Decimal with a sign.
    pub fn signed(&mut self, number: i32) -> &mut Self {
        if number < 0 {
            self.text("-");
        }
        self.number(number.unsigned_abs())
    }

    /// An IPv4 address and a port.
    pub fn address(&mut self, ip: u32, port: u16) -> &mut Self {
        let [a, b, c, d] = ip.to_be_bytes();
        for byte in [a, b, c] {
            self.number(byte.into()).text(".");
        }
        self.number(d.into()).text(":").number(port.into())
    }

    /// Eight hexadecimal digits.
    pub fn hex(&mut self, number: u32) -> &mut Self {
        let digits: [u8; 8] = core::array::from_fn(|at| {
            let digit = (number >> (28 - 4 * at) & 0xf) as u8;
            digit + if digit < 10 { b'0' } else { b'a' - 10 }
        });
        self.0.put(&digits);
        self
    }

    /// Bytes as ASCII; every byte that could disturb a terminal becomes a dot.
    pub fn ascii(&mut self, bytes: &[u8]) -> &mut Self {
        for byte in bytes {
            let plain = (b' '..=b'~').contains(byte);
            self.0.put(&[if plain { *byte } else { b'.' }]);
        }
        self
    }

    /// Ends a line as telnet requires.
    pub fn end(&mut self) {
        self.text("\r\n");
    }
}

/// Bytes of the longest [`Text`].
pub const TEXT_ROOM: usize = 1536;

/// An answer to a client of a connection, on its way.
#[derive(Clone, Debug)]
pub struct Text {
    bytes: [u8; TEXT_ROOM],
    used: usize,
    /// Close the connection after this text.
    pub close: bool,
}

impl Default for Text {
    fn default() -> Self {
        Self::new()
    }
}

impl Text {
    /// Empty.
    pub const fn new() -> Self {
        Text {
            bytes: [0; TEXT_ROOM],
            used: 0,
            close: false,
        }
    }

    /// All of it.
    pub fn bytes(&self) -> &[u8] {
        self.bytes.get(..self.used).unwrap_or(&[])
    }

    /// Is there anything to be sent, or to be closed?
    pub fn some(&self) -> bool {
        self.used > 0 || self.close
    }

    /// Bytes that still fit.
    pub fn room(&self) -> usize {
        TEXT_ROOM - self.used
    }

    /// Forgets all of it.
    pub fn clear(&mut self) {
        self.used = 0;
        self.close = false;
    }
}

impl Sink for Text {
    fn put(&mut self, text: &[u8]) {
        if let Some(room) = self.bytes.get_mut(self.used..self.used + text.len()) {
            room.copy_from_slice(text);
            self.used += text.len();
        }
    }
}

#[cfg(test)]
impl Sink for String {
    fn put(&mut self, text: &[u8]) {
        self.push_str(std::str::from_utf8(text).expect("whole characters"));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn said(say: impl FnOnce(&mut Out)) -> String {
        let mut text = String::new();
        say(&mut Out(&mut text));
        text
    }

    proptest! {
        #[test]
        fn numbers_look_like_those_of_the_standard_library(number in prop_oneof![any::<u32>(), 0u32..12]) {
            prop_assert_eq!(said(|out| { out.number(number); }), number.to_string());
            prop_assert_eq!(said(|out| { out.hex(number); }), format!("{number:08x}"));
            let signed = number as i32;
            prop_assert_eq!(said(|out| { out.signed(signed); }), signed.to_string());
        }
    }

    #[test]
    fn the_edges_of_numbers_too() {
        assert_eq!(
            said(|out| {
                out.number(u32::MAX).text(" ").signed(i32::MIN);
            }),
            "4294967295 -2147483648"
        );
    }

    #[test]
    fn an_address_looks_like_one() {
        let text = said(|out| {
            out.address(0xc0a8_0232, 1234);
        });
        assert_eq!(text, "192.168.2.50:1234");
    }

    #[test]
    fn what_could_upset_a_terminal_is_a_dot() {
        assert_eq!(
            said(|out| {
                out.ascii(b"a\x1b[2J\xff");
            }),
            "a.[2J."
        );
    }
}
