//! Machines to begin with, and answers put into them.

/// The machines there are: a name, what it is, and the file.
pub const TEMPLATES: [(&str, &str, &str); 5] = [
    (
        "mill",
        "three axes, home switches, a spindle with PWM, a probe",
        include_str!("../templates/mill.toml"),
    ),
    (
        "lathe",
        "X and Z, a spindle with an encoder for threads",
        include_str!("../templates/lathe.toml"),
    ),
    (
        "plasma",
        "two motors on Y, a THCAD, QtPlasmaC",
        include_str!("../templates/plasma.toml"),
    ),
    (
        "router",
        "two motors on Y, a spindle with 0 to 10 V, a tool setter",
        include_str!("../templates/router.toml"),
    ),
    (
        "plotter",
        "X, Y and a pen on Z",
        include_str!("../templates/plotter.toml"),
    ),
];

/// The file of this name.
pub fn template(name: &str) -> Option<&'static str> {
    let found = TEMPLATES.iter().find(|(known, _, _)| *known == name);
    found.map(|(_, _, text)| *text)
}

/// A key of a template: its table, which of the tables with that name, and itself. The table of
/// keys at the head of the file has no name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Slot<'s> {
    /// As in `[[axis]]`.
    pub table: &'s str,
    /// From 0.
    pub number: usize,
    /// As in `pitch`.
    pub key: &'s str,
}

impl Slot<'_> {
    /// The line with it.
    fn line(&self, text: &str) -> Option<usize> {
        let (mut table, mut number) = ("", 0);
        for (n, line) in text.lines().enumerate() {
            if line.starts_with('[') {
                let name = line.split('#').next().unwrap_or_default().trim();
                number = text
                    .lines()
                    .take(n)
                    .filter(|line| line.trim() == name)
                    .count();
                table = name;
            }
            let key = line.split_once('=').map(|(key, _)| key.trim());
            if table == self.table && number == self.number && key == Some(self.key) {
                return Some(n);
            }
        }
        None
    }

    /// The value as it is written, without the comment behind it.
    pub fn get(&self, text: &str) -> Option<String> {
        let line = text.lines().nth(self.line(text)?)?;
        let (_, rest) = line.split_once('=')?;
        Some(value(rest).trim().to_owned())
    }

    /// The file with another value there; as it is if it has no such key.
    pub fn set(&self, text: &str, new: &str) -> String {
        let Some(at) = self.line(text) else {
            return text.to_owned();
        };
        let lines = text.split_inclusive('\n').enumerate().map(|(n, line)| {
            let old = line.split_once('=').filter(|_| n == at);
            old.map_or(line.to_owned(), |(key, rest)| {
                let comment = &rest[value(rest).trim_end().len()..];
                format!("{key}= {new}{comment}")
            })
        });
        lines.collect()
    }
}

/// What stands before a comment.
fn value(rest: &str) -> &str {
    let mut quoted = false;
    let end = rest.find(|c| {
        quoted ^= c == '"';
        c == '#' && !quoted
    });
    rest[..end.unwrap_or(rest.len())].trim_end_matches(['\r', '\n'])
}
