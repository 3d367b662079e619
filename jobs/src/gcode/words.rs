//! A line as words: letters with numbers, without blanks, comments and the checksum.

use super::Fault;

/// Largest number of words in a line; there are fewer different ones.
pub(super) const WORDS: usize = 32;

/// An error and its byte, from 0.
pub(super) type At = (usize, Fault);

/// Numbers are in units of 10^-9.
pub(super) const NANO: i64 = 1_000_000_000;

#[derive(Clone, Copy, Default)]
pub(super) struct Word {
    pub(super) letter: u8,
    pub(super) value: i64,
    pub(super) at: usize,
}

impl Word {
    /// Ten times the number, if that is whole and not below 0.
    pub(super) fn tenths(&self) -> Option<i64> {
        let tenth = NANO / 10;
        (self.value % tenth == 0 && self.value >= 0).then_some(self.value / tenth)
    }
}

pub(super) struct Words {
    words: [Word; WORDS],
    count: usize,
}

impl Words {
    pub(super) fn iter(&self) -> impl Iterator<Item = &Word> {
        self.words[..self.count].iter()
    }

    pub(super) fn find(&self, letter: u8) -> Option<&Word> {
        self.iter().find(|word| word.letter == letter)
    }

    /// The position of the line's first word after its number.
    pub(super) fn first_at(&self) -> usize {
        self.iter()
            .find(|word| word.letter != b'N')
            .map_or(0, |word| word.at)
    }

    pub(super) fn parse(text: &[u8]) -> Result<Words, At> {
        let mut words = Words {
            words: [Word::default(); WORDS],
            count: 0,
        };
        let mut at = 0;
        while let Some(&byte) = text.get(at) {
            match byte {
                b' ' | b'\t' | b'\r' => at += 1,
                // Program marks; anything else in their line is a word.
                b'%' => at += 1,
                b';' => break,
                b'(' => at = after_comment(text, at)?,
                b'*' => {
                    check(text, at)?;
                    break;
                }
                _ if byte.is_ascii_alphabetic() => {
                    let letter = byte.to_ascii_uppercase();
                    let (value, end) = number(text, at + 1).map_err(|fault| match fault {
                        Fault::NoNumber(_) => (at, Fault::NoNumber(letter)),
                        other => (at, other),
                    })?;
                    let place = words
                        .words
                        .get_mut(words.count)
                        .ok_or((at, Fault::TooLong))?;
                    *place = Word { letter, value, at };
                    words.count += 1;
                    at = end;
                }
                _ => return Err((at, Fault::NoWord(byte))),
            }
        }
        Ok(words)
    }
}

fn after_comment(text: &[u8], at: usize) -> Result<usize, At> {
    let inside = &text[at + 1..];
    let end = inside.iter().position(|byte| matches!(byte, b'(' | b')'));
    match end.map(|end| (end, inside[end])) {
        Some((end, b')')) => Ok(at + 1 + end + 1),
        _ => Err((at, Fault::OpenComment)),
    }
}

/// `*` and the checksum at `at`, for the bytes before it.
fn check(text: &[u8], at: usize) -> Result<(), At> {
    let (value, end) = number(text, at + 1).map_err(|_| (at, Fault::NoNumber(b'*')))?;
    let is = text[..at].iter().fold(0, |sum, byte| sum ^ byte);
    if value != i64::from(is) * NANO {
        let said = u8::try_from(value / NANO).unwrap_or(u8::MAX);
        return Err((at, Fault::Checksum { said, is }));
    }
    match text[end..]
        .iter()
        .position(|byte| !byte.is_ascii_whitespace())
    {
        None => Ok(()),
        Some(more) if text[end + more] == b';' => Ok(()),
        Some(more) => Err((end + more, Fault::NoWord(text[end + more]))),
    }
}

/// The number at `at` (spaces before it are allowed) and its end. Digits after the ninth decimal
/// are read and ignored.
fn number(text: &[u8], mut at: usize) -> Result<(i64, usize), Fault> {
    while matches!(text.get(at), Some(b' ' | b'\t')) {
        at += 1;
    }
    let negative = text.get(at) == Some(&b'-');
    if negative || text.get(at) == Some(&b'+') {
        at += 1;
    }
    let (mut value, mut digits, mut scale, mut fraction) = (0i64, 0, NANO, false);
    while let Some(&byte) = text.get(at) {
        match byte {
            b'.' if !fraction => fraction = true,
            b'0'..=b'9' => {
                digits += 1;
                let digit = i64::from(byte - b'0');
                if fraction {
                    scale /= 10;
                    value += digit * scale;
                } else {
                    value = value * 10 + digit * NANO;
                }
                if value > 1_000_000 * NANO {
                    return Err(Fault::TooLarge);
                }
            }
            _ => break,
        }
        at += 1;
    }
    match digits {
        0 => Err(Fault::NoNumber(0)),
        _ => Ok((if negative { -value } else { value }, at)),
    }
}
