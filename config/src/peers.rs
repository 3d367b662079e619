//! Writes board files as configurations of other projects: the way back of [`import`].
//!
//! What the other project cannot say is refused, all of it at once, each with its key and what to
//! do: a board built from the result would do something else. What it need not know, such as our
//! own names, gets a note.
//!
//! [`import`]: crate::import

mod lcnc;
mod litexcnc;

pub use lcnc::lcnc;
pub use litexcnc::litexcnc;

use crate::board::{Board, Channel, Class};
use crate::error::{Error, Report};

/// A configuration of another project.
#[derive(Clone, Debug)]
pub struct Written {
    /// The file.
    pub text: String,
    /// What a person should know: what has no counterpart there, what was assumed.
    pub notes: Vec<String>,
}

/// What cannot be said and what should be known, so far.
struct Way<'b> {
    board: &'b Board,
    /// The other project.
    theirs: &'static str,
    refusals: Vec<Error>,
    notes: Vec<String>,
}

impl<'b> Way<'b> {
    fn new(board: &'b Board, theirs: &'static str) -> Self {
        Way {
            board,
            theirs,
            refusals: Vec::new(),
            notes: Vec::new(),
        }
    }

    /// What stands at `key` cannot be said there.
    fn refuse(&mut self, key: &str, value: &str, why: &str, remedy: &str) {
        let value = match value {
            "" => String::new(),
            value => format!("{value:?}"),
        };
        self.refusals.push(Error::from(Report {
            file: self.board.file.clone(),
            place: None,
            key: key.to_owned(),
            value,
            problem: format!("cannot be said to {}: {why}", self.theirs),
            remedy: remedy.to_owned(),
        }));
    }

    fn note(&mut self, note: String) {
        self.notes.push(note);
    }

    /// Refuses a type and pins that are none of these, and a channel without pins.
    fn only(&mut self, class: Class, n: usize, kinds: &[&str], pins: &[&str]) {
        let channel = &self.board.of(class)[n];
        let key = format!("{}[{n}]", class.key());
        if !channel.kind.is_empty() && !kinds.contains(&channel.kind.as_str()) {
            let why = format!("its {} have no such type", class.key());
            let remedy = format!("write type = \"{}\"", kinds.join("\" or \""));
            self.refuse(&format!("{key}.type"), &channel.kind, &why, &remedy);
        }
        for (pin, name) in &channel.pins {
            if !pins.contains(pin) {
                let why = format!("its {} have no such pin", class.key());
                self.refuse(&format!("{key}.{pin}"), name, &why, "take it away");
            }
        }
        if channel.pins.is_empty() {
            self.refuse(
                &key,
                "",
                "it has no pins",
                "give it pins, or take the channel away",
            );
        }
    }

    /// Refuses jobs, and says which keys only concern a board of ours.
    fn ours_alone(&mut self) {
        if self.board.jobs != 0 {
            self.refuse(
                "jobs",
                &self.board.jobs.to_string(),
                "its boards move nothing without a PC",
                "take the key away",
            );
        }
        self.note("Clock, factory pin, SDRAM and modified headers are not in the file.".to_owned());
    }

    /// The MAC address in the form of both.
    fn mac(&mut self) -> String {
        match self.board.mac {
            Some(mac) => mac
                .iter()
                .fold("0x".to_owned(), |text, byte| format!("{text}{byte:02x}")),
            None => {
                self.note(format!("The board makes its own MAC address; {} has one in the file: give each board another.", self.theirs));
                "0x10e2d5000000".to_owned()
            }
        }
    }

    fn finish(self, text: String) -> Result<Written, Vec<Error>> {
        match self.refusals.is_empty() {
            true => Ok(Written {
                text,
                notes: self.notes,
            }),
            false => Err(self.refusals),
        }
    }
}

/// A pin of a channel whose pins were looked at.
fn pin<'c>(channel: &'c Channel, key: &str) -> &'c str {
    channel.pin(key).unwrap_or("none")
}
