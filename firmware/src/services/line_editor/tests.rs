use super::*;
use proptest::prelude::*;
use std::vec::Vec;

/// What a terminal shows of the line with the cursor.
#[derive(Default)]
struct Screen {
    cells: Vec<u8>,
    column: usize,
    bells: usize,
    lines: Vec<String>,
    sequence: Vec<u8>,
}

impl Sink for Screen {
    fn put(&mut self, text: &[u8]) {
        for byte in text {
            self.show(*byte);
        }
    }
}

impl Screen {
    fn show(&mut self, byte: u8) {
        if !self.sequence.is_empty() {
            self.sequence.push(byte);
            if self.sequence.len() > 2 && byte.is_ascii_alphabetic() {
                self.obey();
                self.sequence.clear();
            }
            return;
        }
        match byte {
            0x1b => self.sequence.push(byte),
            0x07 => self.bells += 1,
            0x08 => self.column = self.column.checked_sub(1).expect("left of the screen"),
            b'\r' => self.column = 0,
            b'\n' => {
                let line = String::from_utf8(std::mem::take(&mut self.cells)).expect("ASCII");
                self.lines.push(line);
            }
            b' '..=b'~' => {
                self.cells
                    .resize(self.cells.len().max(self.column + 1), b' ');
                self.cells[self.column] = byte;
                self.column += 1;
            }
            _ => panic!("a terminal does not know {byte}"),
        }
    }

    fn obey(&mut self) {
        match &self.sequence[2..] {
            b"K" => self.cells.truncate(self.column),
            b"2J" => self.cells.clear(),
            b"H" => self.column = 0,
            [digits @ .., b'D'] => {
                let columns: usize = std::str::from_utf8(digits).unwrap().parse().unwrap();
                self.column = self
                    .column
                    .checked_sub(columns)
                    .expect("left of the screen");
            }
            other => panic!("a terminal does not know {other:?}"),
        }
    }

    fn line(&self) -> &str {
        std::str::from_utf8(&self.cells).expect("ASCII")
    }
}

fn lines(bytes: &[u8], echo: bool) -> Vec<Result<String, TooLong>> {
    let mut editor = LineEditor::new();
    let mut screen = Screen::default();
    let mut lines = Vec::new();
    for byte in bytes {
        if editor.push(*byte, echo, &mut screen) == Some(End::Line) {
            lines.push(editor.line().map(str::to_owned));
        }
    }
    assert!(echo || screen.lines.is_empty() && screen.cells.is_empty());
    lines
}

fn one(bytes: &[u8]) -> String {
    let mut all = lines(&[bytes, b"\r\0"].concat(), true);
    assert_eq!(all.len(), 1);
    all.remove(0).expect("a line")
}

#[test]
fn every_line_end_ends_one_line() {
    for echo in [false, true] {
        for end in ["\n", "\r\n", "\r\0", "\r"] {
            let typed = format!("a{end}b{end}{end}c{end}");
            let said: Vec<_> = lines(typed.as_bytes(), echo);
            let wanted = ["a", "b", "", "c"].map(|line| Ok(line.to_owned()));
            assert_eq!(said, wanted, "{end:?}");
        }
    }
}

#[test]
fn keys_edit_the_line() {
    assert_eq!(one(b"sttus\x1b[D\x1b[D\x1b[Da"), "status");
    assert_eq!(one(b"tatus\x1b[Hs"), "status");
    assert_eq!(one(b"tatus\x01s\x05 1"), "status 1");
    assert_eq!(one(b"statuss\x1b[D\x1b[3~"), "status");
    assert_eq!(one(b"xstatus\x1bOH\x04\x1bOF!\x08"), "status");
    assert_eq!(one(b"regs 1 2 \x17\x17 3"), "regs  3");
    assert_eq!(one(b"abc def\x1b[1~\x1b[C\x1b[C\x1b[C\x0b"), "abc");
    assert_eq!(one(b"abc def\x02\x02\x02\x15"), "def");
    assert_eq!(one(b"statsu\x7f\x7fus"), "status");
}

#[test]
fn up_and_down_find_the_last_lines_and_the_own_one() {
    let typed = b"one\r\ntwo\r\ntwo\r\nmi\x1b[A\x1b[A\x1b[A\r\n\x10\x10\x0e\r\n12\x1b[A\x1b[B3\r\n";
    let said: Vec<_> = lines(typed, true).into_iter().flatten().collect();
    assert_eq!(said, ["one", "two", "two", "one", "one", "123"]);
    // Eight are kept, and no line that is good for one login only.
    let mut typed: Vec<u8> = (0..12)
        .flat_map(|n| format!("{n}\r").into_bytes())
        .collect();
    typed.extend(b"login 00\r");
    typed.extend(b"\x1b[A".repeat(20));
    typed.extend(b"\r");
    assert_eq!(lines(&typed, true).last(), Some(&Ok("4".to_owned())));
}

#[test]
fn a_line_that_is_too_long_rings_and_says_so() {
    let mut editor = LineEditor::new();
    let mut screen = Screen::default();
    for byte in [b'x'; 70] {
        assert_eq!(editor.push(byte, true, &mut screen), None);
    }
    assert_eq!(screen.bells, 6);
    assert_eq!(screen.lines.len(), 2, "{:?}", screen.lines);
    assert_eq!(screen.lines[1], TOO_LONG);
    assert_eq!(screen.line(), format!("{PROMPT}{}", "x".repeat(64)));
    editor.push(b'\n', true, &mut screen);
    assert_eq!(editor.line(), Ok(&*"x".repeat(64)));
    // Without an echo no key is refused, so the line is.
    let said = lines(&[&[b'x'; 65][..], b"\nhelp\n"].concat(), false);
    assert_eq!(said, [Err(TooLong), Ok("help".to_owned())]);
}

#[test]
fn without_an_echo_the_keys_of_a_terminal_are_dropped() {
    assert_eq!(
        lines(b"\x1b[Asta\x1b[Dtus\x15\x03\x04\x08s\xc3\xa9\n", false),
        [Ok("status".to_owned())]
    );
    // A sequence that breaks off takes no line end with it.
    assert_eq!(lines(b"net\x1b[\r\n", false), [Ok("net".to_owned())]);
}

#[test]
fn control_c_forgets_the_line_and_control_d_leaves_at_an_empty_one() {
    let mut editor = LineEditor::new();
    let mut screen = Screen::default();
    editor.push(b'x', true, &mut screen);
    assert_eq!(editor.push(4, true, &mut screen), None);
    assert_eq!(screen.bells, 1);
    assert_eq!(editor.push(3, true, &mut screen), Some(End::Abandoned));
    assert_eq!(editor.push(4, true, &mut screen), Some(End::Close));
}

/// A line as a plain vector with a cursor.
#[derive(Default)]
struct Model {
    text: Vec<u8>,
    cursor: usize,
    kept: Vec<Vec<u8>>,
    back: usize,
    own: Vec<u8>,
}

#[derive(Clone, Copy, Debug)]
enum Stroke {
    Text(u8),
    Enter,
    Left,
    Right,
    Home,
    End,
    Back,
    Delete,
    Before,
    Behind,
    Word,
    Up,
    Down,
    Redraw,
}

impl Stroke {
    fn bytes(self) -> Vec<u8> {
        let text: &[u8] = match self {
            Stroke::Text(byte) => return vec![byte],
            Stroke::Enter => b"\r\0",
            Stroke::Left => b"\x1b[D",
            Stroke::Right => b"\x1bOC",
            Stroke::Home => b"\x1b[1~",
            Stroke::End => b"\x1b[F",
            Stroke::Back => b"\x7f",
            Stroke::Delete => b"\x1b[3~",
            Stroke::Before => b"\x15",
            Stroke::Behind => b"\x0b",
            Stroke::Word => b"\x17",
            Stroke::Up => b"\x1b[1;5A",
            Stroke::Down => b"\x1b[B",
            Stroke::Redraw => b"\x0c",
        };
        text.to_vec()
    }
}

impl Model {
    /// True: a line is complete.
    fn press(&mut self, stroke: Stroke) -> bool {
        match stroke {
            Stroke::Text(byte) if self.text.len() < LINE_MAX => {
                self.text.insert(self.cursor, byte);
                self.cursor += 1;
            }
            Stroke::Left => self.cursor = self.cursor.saturating_sub(1),
            Stroke::Right => self.cursor = self.text.len().min(self.cursor + 1),
            Stroke::Home => self.cursor = 0,
            Stroke::End => self.cursor = self.text.len(),
            Stroke::Back if self.cursor > 0 => {
                self.cursor -= 1;
                self.text.remove(self.cursor);
            }
            Stroke::Delete if self.cursor < self.text.len() => {
                self.text.remove(self.cursor);
            }
            Stroke::Before => {
                self.text.drain(..self.cursor);
                self.cursor = 0;
            }
            Stroke::Behind => self.text.truncate(self.cursor),
            Stroke::Word => {
                let mut at = self.cursor;
                while at > 0 && self.text[at - 1] == b' ' {
                    at -= 1;
                }
                while at > 0 && self.text[at - 1] != b' ' {
                    at -= 1;
                }
                self.text.drain(at..self.cursor);
                self.cursor = at;
            }
            Stroke::Up if self.back < self.kept.len() => self.recall(self.back + 1),
            Stroke::Down if self.back > 0 => self.recall(self.back - 1),
            Stroke::Enter => {
                let blank = self.text.iter().all(|byte| *byte == b' ');
                if !blank && self.kept.first() != Some(&self.text) {
                    self.kept.insert(0, self.text.clone());
                    self.kept.truncate(8);
                }
                return true;
            }
            _ => {}
        }
        false
    }

    fn recall(&mut self, back: usize) {
        if self.back == 0 {
            self.own = self.text.clone();
        }
        self.back = back;
        self.text = match back {
            0 => self.own.clone(),
            _ => self.kept[back - 1].clone(),
        };
        self.cursor = self.text.len();
    }
}

fn strokes() -> impl Strategy<Value = Vec<Stroke>> {
    let letter = prop_oneof![Just(b' '), Just(b'~'), b'a'..=b'e'];
    let key = prop_oneof![
        12 => letter.prop_map(Stroke::Text),
        1 => Just(Stroke::Enter),
        2 => Just(Stroke::Left),
        1 => Just(Stroke::Right),
        1 => Just(Stroke::Home),
        1 => Just(Stroke::End),
        2 => Just(Stroke::Back),
        1 => Just(Stroke::Delete),
        1 => Just(Stroke::Before),
        1 => Just(Stroke::Behind),
        1 => Just(Stroke::Word),
        2 => Just(Stroke::Up),
        1 => Just(Stroke::Down),
        1 => Just(Stroke::Redraw),
    ];
    prop::collection::vec(key, 0..300)
}

proptest! {
    #[test]
    fn the_line_and_the_screen_are_those_of_a_plain_vector_with_a_cursor(strokes in strokes()) {
        let (mut model, mut editor) = (Model::default(), LineEditor::new());
        let mut screen = Screen::default();
        screen.put(PROMPT.as_bytes());
        for stroke in strokes {
            let mut end = None;
            for byte in stroke.bytes() {
                let mut counted = Counted(&mut screen, 0);
                end = end.or(editor.push(byte, true, &mut counted));
                prop_assert!(counted.1 <= ECHO_MAX, "{} bytes", counted.1);
                if end == Some(End::Line) && byte == b'\r' {
                    let line = editor.line().map(str::as_bytes);
                    prop_assert_eq!(line, Ok(&*model.text));
                }
            }
            let whole = model.press(stroke);
            prop_assert_eq!(whole, end == Some(End::Line));
            if whole {
                let shown = screen.lines.pop().unwrap();
                let typed = std::str::from_utf8(&model.text).unwrap();
                prop_assert_eq!(shown, format!("{PROMPT}{typed}"));
                model = Model { kept: model.kept, ..Model::default() };
                screen.put(PROMPT.as_bytes());
            }
            let typed = std::str::from_utf8(&model.text).unwrap();
            prop_assert_eq!(screen.line(), format!("{PROMPT}{typed}"));
            prop_assert_eq!(screen.column, PROMPT.len() + model.cursor);
        }
    }

    #[test]
    fn no_bytes_break_it(bytes in prop::collection::vec(any::<u8>(), 0..400), echo in any::<bool>()) {
        let mut editor = LineEditor::new();
        let mut screen = Screen::default();
        screen.put(PROMPT.as_bytes());
        for byte in bytes {
            if let Some(End::Line | End::Abandoned) = editor.push(byte, echo, &mut screen) {
                let _ = editor.line();
                screen.put(PROMPT.as_bytes());
            }
        }
    }
}

/// A screen, and the bytes it was sent.
struct Counted<'a>(&'a mut Screen, usize);

impl Sink for Counted<'_> {
    fn put(&mut self, text: &[u8]) {
        self.1 += text.len();
        self.0.put(text);
    }
}
