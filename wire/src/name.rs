//! Names of 32 bytes: of a board, a configuration, a platform.

use crate::Refusal;

/// UTF-8 without control characters, padded with zeros.
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct Name([u8; Name::LEN]);

impl Name {
    /// Bytes, all of which may be used.
    pub const LEN: usize = 32;
    /// Words it takes on the wire.
    pub const WORDS: usize = Self::LEN / 4;
    /// No name.
    pub const EMPTY: Name = Name([0; Self::LEN]);

    /// Refused (`value`) if it is too long or contains a control character.
    pub fn new(text: &str) -> Result<Self, Refusal> {
        let mut bytes = [0; Self::LEN];
        bytes
            .get_mut(..text.len())
            .ok_or(Refusal::Value)?
            .copy_from_slice(text.as_bytes());
        Self::from_bytes(bytes)
    }

    /// The beginning of a text that may be too long; empty if it contains a control character.
    pub fn cut(text: &str) -> Self {
        let end = (0..=text.len().min(Self::LEN))
            .rev()
            .find(|end| text.is_char_boundary(*end));
        let head = end.and_then(|end| text.get(..end)).unwrap_or("");
        Self::new(head).unwrap_or(Self::EMPTY)
    }

    /// From its padded bytes.
    pub fn from_bytes(bytes: [u8; Self::LEN]) -> Result<Self, Refusal> {
        let end = bytes.iter().position(|byte| *byte == 0);
        let (text, padding) = bytes
            .split_at_checked(end.unwrap_or(Self::LEN))
            .ok_or(Refusal::Value)?;
        let text = core::str::from_utf8(text).map_err(|_| Refusal::Value)?;
        // C0, DEL and C1: characters that could disturb a terminal.
        let control = |c: char| (c as u32) < 0x20 || (0x7f..0xa0).contains(&(c as u32));
        if text.chars().any(control) || padding.iter().any(|byte| *byte != 0) {
            return Err(Refusal::Value);
        }
        Ok(Name(bytes))
    }

    /// From its words.
    pub fn from_words(words: &[u32; Self::WORDS]) -> Result<Self, Refusal> {
        let mut bytes = [0; Self::LEN];
        crate::words_to_bytes(words, &mut bytes);
        Self::from_bytes(bytes)
    }

    /// As words.
    pub fn to_words(self) -> [u32; Self::WORDS] {
        let (chunks, _) = self.0.as_chunks::<4>();
        core::array::from_fn(|n| chunks.get(n).map_or(0, |chunk| u32::from_be_bytes(*chunk)))
    }

    /// As text.
    pub fn text(&self) -> &str {
        let end = self.0.iter().position(|byte| *byte == 0);
        let text = self.0.get(..end.unwrap_or(Self::LEN)).unwrap_or(&[]);
        core::str::from_utf8(text).unwrap_or("") // `from_bytes` checked
    }

    /// Is it empty?
    pub fn is_empty(&self) -> bool {
        self.0[0] == 0
    }
}

impl Default for Name {
    fn default() -> Self {
        Self::EMPTY
    }
}

impl core::fmt::Debug for Name {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(f, "{:?}", self.text())
    }
}

impl core::fmt::Display for Name {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(self.text())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_survives_the_wire() {
        for text in [
            "",
            "mill",
            "Fr\u{e4}se 2",
            "0123456789abcdef0123456789abcdef",
        ] {
            let name = Name::new(text).unwrap();
            assert_eq!(Name::from_words(&name.to_words()), Ok(name));
            assert_eq!(name.text(), text);
        }
    }

    #[test]
    fn what_is_too_long_or_upsets_a_terminal_is_no_name() {
        assert_eq!(
            Name::new("0123456789abcdef0123456789abcdefg"),
            Err(Refusal::Value)
        );
        for text in ["a\x1b[2J", "a\0b", "\u{85}", "\x7f"] {
            assert_eq!(Name::new(text), Err(Refusal::Value), "{text:?}");
        }
        let mut bytes = [0; Name::LEN];
        bytes[0] = 0xff;
        assert_eq!(Name::from_bytes(bytes), Err(Refusal::Value), "not UTF-8");
    }

    #[test]
    fn a_text_that_is_too_long_is_cut_between_characters() {
        assert_eq!(
            Name::cut("0123456789abcdef0123456789abcde\u{e4}")
                .text()
                .len(),
            31
        );
        assert_eq!(Name::cut("mill").text(), "mill");
    }
}
