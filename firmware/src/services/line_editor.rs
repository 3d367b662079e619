//! A line of a console on its way: keys come in, and the line comes out when it is complete.
//!
//! With an echo ([`super::telnet`]) each key is shown as it comes, and the keys of other shells
//! edit the line: arrows, Home, End, Delete, Ctrl-A, B, E, F, K, U, W, and Ctrl-L to draw it again.
//! Up and down find the last eight lines again. Ctrl-C forgets the line, Ctrl-D at an empty one
//! hangs up.
//!
//! Without an echo the client edits its lines itself. Only backspace means anything then; sequences
//! of a terminal's keys and other control characters are dropped.
//!
//! A line ends with LF, CR LF, CR NUL or CR.

use crate::text::{Out, Sink};
use heapless::Vec;

/// Longest line. The longest command with its argument is a quarter of this.
pub const LINE_MAX: usize = 64;
/// Lines that are kept.
const KEPT: usize = 8;
/// What the user sees of the board, in front of each line.
pub const PROMPT: &str = "ferrocnc> ";
/// What is said about a line that is too long.
pub const TOO_LONG: &str = "a line has at most 64 characters";
const _: () = assert!(LINE_MAX == 64);
/// Most bytes that one key writes: the hint, the prompt and the line.
pub const ECHO_MAX: usize = 4 + TOO_LONG.len() + PROMPT.len() + LINE_MAX + 10;

const BELL: &str = "\x07";
const ERASE_TO_END: &str = "\x1b[K";

type InputLine = Vec<u8, LINE_MAX>;

/// What a key completes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum End {
    /// A line ([`LineEditor::line`]).
    Line,
    /// The line was given up: a new prompt is wanted.
    Abandoned,
    /// The user wants to leave.
    Close,
}

/// A line is too long.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TooLong;

/// The meaning of a byte, or of a sequence of bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Key {
    Text(u8),
    Enter,
    Left,
    Right,
    Up,
    Down,
    Home,
    End,
    Backspace,
    Delete,
    /// Delete to the line's beginning, to its end, the word before the cursor.
    KillBefore,
    KillBehind,
    KillWord,
    Redraw,
    Abandon,
    DeleteOrClose,
    None,
}

impl Key {
    fn of(byte: u8) -> Key {
        match byte {
            b' '..=b'~' => Key::Text(byte),
            b'\r' | b'\n' => Key::Enter,
            0x01 => Key::Home,
            0x02 => Key::Left,
            0x03 => Key::Abandon,
            0x04 => Key::DeleteOrClose,
            0x05 => Key::End,
            0x06 => Key::Right,
            0x08 | 0x7f => Key::Backspace,
            0x0b => Key::KillBehind,
            0x0c => Key::Redraw,
            0x0e => Key::Down,
            0x10 => Key::Up,
            0x15 => Key::KillBefore,
            0x17 => Key::KillWord,
            _ => Key::None,
        }
    }

    /// Of a terminal's sequence: its last byte and its first number.
    fn of_sequence(last: u8, number: u8) -> Key {
        match (last, number) {
            (b'A', _) => Key::Up,
            (b'B', _) => Key::Down,
            (b'C', _) => Key::Right,
            (b'D', _) => Key::Left,
            (b'H', _) | (b'~', 1 | 7) => Key::Home,
            (b'F', _) | (b'~', 4 | 8) => Key::End,
            (b'~', 3) => Key::Delete,
            _ => Key::None,
        }
    }
}

/// Where the next byte of a terminal's sequence belongs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Escape {
    None,
    /// Behind ESC.
    Begun,
    /// Behind ESC O.
    Short,
    /// Behind ESC \[ and a number; true: behind the number.
    Long(u8, bool),
}

impl Escape {
    /// Takes a byte; returns a key if there is one. A control character ends the sequence.
    fn take(&mut self, byte: u8) -> Key {
        let here = core::mem::replace(self, Escape::None);
        match (here, byte) {
            (_, 0x1b) => *self = Escape::Begun,
            (Escape::None, _) | (_, ..b' ' | 0x7f..) => return Key::of(byte),
            (Escape::Begun, b'[') => *self = Escape::Long(0, false),
            (Escape::Begun, b'O') => *self = Escape::Short,
            (Escape::Begun, _) => {}
            (Escape::Short, last) => return Key::of_sequence(last, 0),
            (Escape::Long(number, false), digit @ b'0'..=b'9') => {
                let number = number.saturating_mul(10).saturating_add(digit - b'0');
                *self = Escape::Long(number, false);
            }
            (Escape::Long(number, _), b' '..=b'?') => *self = Escape::Long(number, true),
            (Escape::Long(number, _), last) => return Key::of_sequence(last, number),
        }
        Key::None
    }
}

/// A client's line.
#[derive(Clone, Debug)]
pub struct LineEditor {
    text: InputLine,
    cursor: usize,
    /// Of a line that is too long: there was no room for a character.
    too_long: bool,
    escape: Escape,
    /// The last byte was CR: LF or NUL belongs to it.
    after_cr: bool,
    /// The line is complete, and kept until the next byte comes.
    complete: bool,
    /// The last lines, newest first.
    kept: Vec<InputLine, KEPT>,
    /// How many lines back the user looks; 0 is the line of their own.
    back: usize,
    /// The line of their own meanwhile.
    own: InputLine,
}

impl Default for LineEditor {
    fn default() -> Self {
        Self::new()
    }
}

impl LineEditor {
    /// No byte yet.
    pub const fn new() -> Self {
        LineEditor {
            text: Vec::new(),
            cursor: 0,
            too_long: false,
            escape: Escape::None,
            after_cr: false,
            complete: false,
            kept: Vec::new(),
            back: 0,
            own: Vec::new(),
        }
    }

    /// The line that is complete, until the next byte comes.
    pub fn line(&self) -> Result<&str, TooLong> {
        match self.too_long {
            true => Err(TooLong),
            // It is ASCII.
            false => Ok(core::str::from_utf8(&self.text).unwrap_or("")),
        }
    }

    /// Takes a byte. `echo`: what happens to the line is shown in `out`.
    pub fn push(&mut self, byte: u8, echo: bool, out: &mut dyn Sink) -> Option<End> {
        if self.complete {
            self.clear();
        }
        let after_cr = core::mem::replace(&mut self.after_cr, byte == b'\r');
        if after_cr && matches!(byte, b'\n' | 0) {
            return None;
        }
        let key = self.escape.take(byte);
        if echo {
            return self.edit(key, &mut Out(out));
        }
        match key {
            Key::Text(byte) => self.too_long |= self.text.push(byte).is_err(),
            Key::Backspace => {
                self.text.pop();
            }
            Key::Enter => return Some(self.finish()),
            Key::Left
            | Key::Right
            | Key::Up
            | Key::Down
            | Key::Home
            | Key::End
            | Key::Delete
            | Key::KillBefore
            | Key::KillBehind
            | Key::KillWord
            | Key::Redraw
            | Key::Abandon
            | Key::DeleteOrClose
            | Key::None => {}
        }
        self.cursor = self.text.len();
        None
    }

    fn clear(&mut self) {
        self.text.clear();
        self.own.clear();
        (self.cursor, self.back) = (0, 0);
        (self.too_long, self.complete) = (false, false);
    }

    /// The line is complete. Lines that are good only once are not kept.
    fn finish(&mut self) -> End {
        self.complete = true;
        let line = self.text.trim_ascii();
        let new = self.kept.first().is_none_or(|last| *last != self.text);
        if new && !line.is_empty() && !line.starts_with(b"login") && !self.too_long {
            if self.kept.is_full() {
                self.kept.pop();
            }
            // There is room.
            let _ = self.kept.insert(0, self.text.clone());
        }
        End::Line
    }

    fn edit(&mut self, key: Key, out: &mut Out) -> Option<End> {
        match key {
            Key::Text(byte) => self.insert(byte, out),
            Key::Enter => {
                out.end();
                // Each character that had no room was refused as it came.
                self.too_long = false;
                return Some(self.finish());
            }
            Key::Left if self.cursor > 0 => self.go(self.cursor - 1, out),
            Key::Right if self.cursor < self.text.len() => self.go(self.cursor + 1, out),
            Key::Home => self.go(0, out),
            Key::End => self.go(self.text.len(), out),
            Key::Up => self.recall(self.back + 1, out),
            Key::Down => match self.back.checked_sub(1) {
                Some(back) => self.recall(back, out),
                None => bell(out),
            },
            Key::Backspace if self.cursor > 0 => self.remove(self.cursor - 1, self.cursor, out),
            Key::DeleteOrClose if self.text.is_empty() => {
                out.end();
                return Some(End::Close);
            }
            Key::Delete | Key::DeleteOrClose if self.cursor < self.text.len() => {
                self.remove(self.cursor, self.cursor + 1, out);
            }
            Key::KillBefore => self.remove(0, self.cursor, out),
            Key::KillBehind => self.remove(self.cursor, self.text.len(), out),
            Key::KillWord => self.remove(self.word(), self.cursor, out),
            Key::Redraw => {
                out.text("\x1b[H\x1b[2J");
                self.draw(out);
            }
            Key::Abandon => {
                out.text("^C").end();
                self.clear();
                return Some(End::Abandoned);
            }
            Key::Left | Key::Right | Key::Backspace | Key::Delete | Key::DeleteOrClose => bell(out),
            Key::None => {}
        }
        None
    }

    /// Where the word before the cursor begins.
    fn word(&self) -> usize {
        let before = self.text.get(..self.cursor).unwrap_or(&[]);
        let end = before.trim_ascii_end().len();
        let word = before.get(..end).unwrap_or(&[]);
        { word.iter() }
            .rposition(|byte| *byte == b' ')
            .map_or(0, |at| at + 1)
    }

    fn insert(&mut self, byte: u8, out: &mut Out) {
        if self.text.insert(self.cursor, byte).is_err() {
            bell(out);
            if !core::mem::replace(&mut self.too_long, true) {
                out.end();
                out.text(TOO_LONG).end();
                self.draw(out);
            }
            return;
        }
        self.cursor += 1;
        out.0.put(&[byte]);
        self.behind(out);
    }

    /// Deletes from here to there; the cursor is at one of both.
    fn remove(&mut self, from: usize, to: usize, out: &mut Out) {
        if from == to {
            return;
        }
        self.go(from, out);
        let mut rest = InputLine::new();
        // Both are parts of a line.
        let _ = rest.extend_from_slice(self.text.get(to..).unwrap_or(&[]));
        self.text.truncate(from);
        let _ = self.text.extend_from_slice(&rest);
        out.text(ERASE_TO_END);
        self.behind(out);
    }

    /// Writes what is behind the cursor, and goes back to it.
    fn behind(&self, out: &mut Out) {
        let rest = self.text.get(self.cursor..).unwrap_or(&[]);
        out.0.put(rest);
        back(rest.len(), out);
    }

    fn draw(&self, out: &mut Out) {
        out.text(PROMPT);
        out.0.put(self.text.get(..self.cursor).unwrap_or(&[]));
        self.behind(out);
    }

    fn go(&mut self, to: usize, out: &mut Out) {
        back(self.cursor.saturating_sub(to), out);
        out.0.put(self.text.get(self.cursor..to).unwrap_or(&[]));
        self.cursor = to;
    }

    /// Shows the line that is so many lines back.
    fn recall(&mut self, back: usize, out: &mut Out) {
        if self.back == 0 {
            self.own.clone_from(&self.text);
        }
        let line = match back.checked_sub(1) {
            None => Some(&self.own),
            Some(back) => self.kept.get(back),
        };
        let Some(line) = line.cloned() else {
            return bell(out);
        };
        self.go(0, out);
        (self.text, self.back) = (line, back);
        out.0.put(&self.text);
        out.text(ERASE_TO_END);
        self.cursor = self.text.len();
    }
}

fn bell(out: &mut Out) {
    out.text(BELL);
}

/// Moves the cursor to the left.
fn back(columns: usize, out: &mut Out) {
    match columns {
        0 => {}
        1..4 => {
            for _ in 0..columns {
                out.text("\x08");
            }
        }
        _ => {
            out.text("\x1b[").number(columns as u32).text("D");
        }
    }
}

#[cfg(test)]
mod tests;
