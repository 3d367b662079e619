//! Values as HTML and as JSON: one description of the page, two forms.
//!
//! Each value has a place in the JSON, `axes.0.position`, and its cell in the HTML has that place
//! as `data-k`: so the page's script needs no list of its own.

use crate::text::{Out, Sink};

/// Longest piece of an answer.
pub const PIECE: usize = 1024;

/// HTML or JSON.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Form {
    /// Rows of tables.
    Html,
    /// Members of objects.
    Json,
}

/// A value.
#[derive(Clone, Copy, Debug)]
pub enum Value<'v> {
    /// Text, of any characters.
    Text(&'v str),
    /// A count.
    Number(u32),
    /// A count with a sign.
    Signed(i32),
    /// A time, in seconds since 1970.
    Date(u32),
    /// With two decimals: in 2^-32, as the board counts steps.
    Fixed(i64),
    /// Yes or no.
    Flag(bool),
    /// Hexadecimal digits.
    Hex(u32),
    /// A version, 8 bits each but for the first.
    Version(u32),
    /// An IPv4 address.
    Ip(u32),
    /// Not known.
    Nothing,
}

impl From<Option<u32>> for Value<'_> {
    fn from(number: Option<u32>) -> Self {
        number.map_or(Value::Nothing, Value::Number)
    }
}

impl From<Option<bool>> for Value<'_> {
    fn from(flag: Option<bool>) -> Self {
        flag.map_or(Value::Nothing, Value::Flag)
    }
}

/// A piece of an answer. Text that does not fit marks it as too long, and its writer takes the
/// last step back.
#[derive(Debug)]
pub struct Piece {
    bytes: [u8; PIECE],
    used: usize,
    full: bool,
}

impl Default for Piece {
    fn default() -> Self {
        Self::new()
    }
}

impl Piece {
    /// Empty.
    pub const fn new() -> Self {
        Piece {
            bytes: [0; PIECE],
            used: 0,
            full: false,
        }
    }

    /// What is in it.
    pub fn bytes(&self) -> &[u8] {
        self.bytes.get(..self.used).unwrap_or(&[])
    }

    /// Has something not fitted?
    pub fn full(&self) -> bool {
        self.full
    }

    /// Only the first `used` bytes of it.
    pub fn back_to(&mut self, used: usize) {
        self.used = self.used.min(used);
        self.full = false;
    }
}

impl Sink for Piece {
    fn put(&mut self, text: &[u8]) {
        match self.bytes.get_mut(self.used..self.used + text.len()) {
            Some(place) if !self.full => {
                place.copy_from_slice(text);
                self.used += text.len();
            }
            _ => self.full = true,
        }
    }
}

/// Text in which markup is only text.
pub fn escape_html(text: &str, out: &mut Out) {
    for c in text.chars() {
        match c {
            '&' => out.text("&amp;"),
            '<' => out.text("&lt;"),
            '>' => out.text("&gt;"),
            '"' => out.text("&quot;"),
            '\'' => out.text("&#39;"),
            // Control characters are not allowed in HTML.
            c if (c as u32) < 0x20 || (0x7f..0xa0).contains(&(c as u32)) => out.text("\u{fffd}"),
            c => out.text(c.encode_utf8(&mut [0; 4])),
        };
    }
}

/// A JSON string, with its quotes.
pub fn escape_json(text: &str, out: &mut Out) {
    out.text("\"");
    for c in text.chars() {
        match c {
            '"' => out.text("\\\""),
            '\\' => out.text("\\\\"),
            c if (c as u32) < 0x20 => {
                out.text("\\u00")
                    .text(if c as u32 & 0x10 == 0 { "0" } else { "1" });
                let digit = (c as u8) & 15;
                let digit = digit + if digit < 10 { b'0' } else { b'a' - 10 };
                out.text(char::from(digit).encode_utf8(&mut [0; 4]))
            }
            c => out.text(c.encode_utf8(&mut [0; 4])),
        };
    }
    out.text("\"");
}

/// With two decimals, cut towards 0. No division of 64 bits.
fn fixed(value: i64, out: &mut Out) {
    let size = value.unsigned_abs();
    let hundredths = (((size & 0xffff_ffff) * 100) >> 32) as u32;
    let whole = (size >> 32) as u32;
    out.text(if value < 0 && (whole | hundredths) != 0 {
        "-"
    } else {
        ""
    });
    out.number(whole).text(".");
    out.either(hundredths < 10, "0", "").number(hundredths);
}

impl Value<'_> {
    /// Numbers, and what looks the same in both forms.
    fn plain(self, out: &mut Out) {
        match self {
            Value::Number(number) => {
                out.number(number);
            }
            Value::Signed(number) => {
                out.signed(number);
            }
            Value::Date(unix) => super::super::sntp::date(unix, out),
            Value::Fixed(value) => fixed(value, out),
            Value::Hex(number) => {
                out.hex(number);
            }
            Value::Version(version) => {
                out.number(version >> 16).text(".");
                out.number(version >> 8 & 0xff).text(".");
                out.number(version & 0xff);
            }
            Value::Ip(ip) => {
                for (n, byte) in ip.to_be_bytes().into_iter().enumerate() {
                    out.text(if n == 0 { "" } else { "." }).number(byte.into());
                }
            }
            Value::Text(_) | Value::Flag(_) | Value::Nothing => {}
        }
    }

    fn html(self, out: &mut Out) {
        match self {
            Value::Text(text) => escape_html(text, out),
            Value::Flag(flag) => {
                out.either(flag, "yes", "no");
            }
            Value::Nothing => {
                out.text("-");
            }
            Value::Number(_)
            | Value::Signed(_)
            | Value::Date(_)
            | Value::Fixed(_)
            | Value::Hex(_)
            | Value::Version(_)
            | Value::Ip(_) => self.plain(out),
        }
    }

    fn json(self, out: &mut Out) {
        match self {
            Value::Text(text) => escape_json(text, out),
            Value::Flag(flag) => {
                out.either(flag, "true", "false");
            }
            Value::Nothing => {
                out.text("null");
            }
            Value::Number(_) | Value::Signed(_) | Value::Fixed(_) => self.plain(out),
            Value::Hex(_) | Value::Version(_) | Value::Ip(_) | Value::Date(_) => {
                out.text("\"");
                self.plain(out);
                out.text("\"");
            }
        }
    }
}

/// A part of the page: an object of the JSON, or a list of objects.
#[derive(Clone, Copy, Debug)]
pub struct Section {
    /// Its name in the JSON.
    pub key: &'static str,
    /// Its heading.
    pub title: &'static str,
    /// The columns, if it is a list.
    pub columns: &'static [&'static str],
}

/// Where the writing stands in the punctuation of a form.
#[derive(Clone, Copy, Debug)]
pub struct Place {
    section: bool,
    element: bool,
    field: bool,
}

impl Place {
    /// Nothing stands before.
    pub const START: Place = Place {
        section: false,
        element: false,
        field: false,
    };
}

/// A section's words on their way into a piece.
pub struct Sheet<'p> {
    /// Which form.
    pub form: Form,
    /// Where it stands.
    pub place: &'p mut Place,
    /// Which section.
    pub section: &'static Section,
    /// The number in a list.
    pub element: Option<usize>,
    /// Where it goes.
    pub out: Out<'p>,
}

impl Sheet<'_> {
    fn comma(&mut self, before: bool) {
        self.out.text(if before { "," } else { "" });
    }

    /// Begins the section.
    pub fn open(&mut self) {
        let Section {
            key,
            title,
            columns,
        } = self.section;
        let list = !columns.is_empty();
        (self.place.element, self.place.field) = (false, false);
        match self.form {
            Form::Html => {
                self.out.text("<section id=").text(key).text("><h2>");
                self.out.text(title).text("</h2><table>");
                if list {
                    self.out.text("<tr>");
                }
                for column in *columns {
                    self.out.text("<th>").text(column);
                }
                self.out.text("\n");
            }
            Form::Json => {
                self.comma(self.place.section);
                escape_json(key, &mut self.out);
                self.out.text(if list { ":[" } else { ":{" });
            }
        }
        self.place.section = true;
    }

    /// Ends the section.
    pub fn close(&mut self) {
        let list = !self.section.columns.is_empty();
        match self.form {
            Form::Html => self.out.text("</table></section>\n"),
            Form::Json => self.out.text(if list { "]\n" } else { "}\n" }),
        };
    }

    /// Begins an element of a list.
    pub fn element(&mut self, number: usize) {
        self.element = Some(number);
        self.place.field = false;
        match self.form {
            Form::Html => {
                self.out.text("<tr>");
            }
            Form::Json => {
                self.comma(self.place.element);
                self.out.text("{");
            }
        }
        self.place.element = true;
    }

    /// Ends it.
    pub fn end(&mut self) {
        match self.form {
            Form::Html => self.out.text("\n"),
            Form::Json => self.out.text("}"),
        };
    }

    /// A value; `label` heads its row unless this is a list.
    pub fn field<'v>(&mut self, key: &str, label: &str, value: impl Into<Value<'v>>) {
        let value = value.into();
        match self.form {
            Form::Html => {
                if self.element.is_none() {
                    self.out.text("<tr><th>").text(label);
                }
                self.out.text("<td data-k=").text(self.section.key);
                if let Some(number) = self.element {
                    self.out.text(".").number(number as u32);
                }
                self.out.text(".").text(key);
                if matches!(value, Value::Fixed(_)) {
                    self.out.text(" class=f");
                }
                self.out.text(">");
                value.html(&mut self.out);
            }
            Form::Json => {
                self.comma(self.place.field);
                escape_json(key, &mut self.out);
                self.out.text(":");
                value.json(&mut self.out);
            }
        }
        self.place.field = true;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn said(value: Value, form: Form) -> String {
        let mut text = String::new();
        match form {
            Form::Html => value.html(&mut Out(&mut text)),
            Form::Json => value.json(&mut Out(&mut text)),
        }
        text
    }

    #[test]
    fn positions_have_two_decimals() {
        for (value, wanted) in [
            (0, "0.00"),
            (1 << 32, "1.00"),
            (-1 << 32, "-1.00"),
            ((5 << 32) / 2, "2.50"),
            (-(5i64 << 32) / 2, "-2.50"),
            (-1, "0.00"),
            (i64::MAX, "2147483647.99"),
            (i64::MIN, "-2147483648.00"),
        ] {
            assert_eq!(said(Value::Fixed(value), Form::Json), wanted);
        }
    }

    #[test]
    fn a_step_that_does_not_fit_is_taken_back() {
        let mut piece = Piece::new();
        piece.put(b"kept");
        piece.put(&[0; PIECE]);
        piece.put(b"lost");
        assert!(piece.full());
        piece.back_to(4);
        assert!(!piece.full() && piece.bytes() == b"kept");
    }

    proptest! {
        #[test]
        fn any_text_is_a_json_string(text: String) {
            let json = said(Value::Text(&text), Form::Json);
            let read: String = serde_json::from_str(&json).unwrap();
            prop_assert_eq!(read, text);
        }

        #[test]
        fn any_text_is_no_markup(text in ".*[<>&\"'].*") {
            let html = said(Value::Text(&text), Form::Html);
            prop_assert!(!html.contains(['<', '>', '"', '\'']), "{}", html);
            for (at, _) in html.match_indices('&') {
                let known = ["&amp;", "&lt;", "&gt;", "&quot;", "&#39;"];
                prop_assert!(known.iter().any(|it| html[at..].starts_with(it)));
            }
        }

        #[test]
        fn a_position_is_what_it_is(value: i64) {
            let read: f64 = said(Value::Fixed(value), Form::Json).parse().unwrap();
            prop_assert!((read - value as f64 / 4_294_967_296.0).abs() < 0.0101);
        }
    }
}
