//! Imports configurations of other projects as board files.
//!
//! The imported board file is then read as any other: a pin that is used twice is refused here too.
//! The message names the pin as the imported file does. A key without a counterpart gets a note and
//! is never dropped silently; an unknown key is refused.

mod ini;
mod json;
mod lcnc;
mod litexcnc;

pub use lcnc::lcnc;
pub(crate) use lcnc::{CHANNELS as LCNC_CHANNELS, PLATFORMS as LCNC_PLATFORMS};
pub use litexcnc::litexcnc;

use crate::board::{Board, Channel, Class, ControlInput, Platforms};
use crate::error::{Error, Place, Report};
use crate::hal;
use crate::new::blank;
use crate::platform::{Level, Platform, Role, split};
use crate::write::to_toml;

/// An imported configuration.
#[derive(Clone, Debug)]
pub struct Imported {
    /// It, read back from what is written.
    pub board: Board,
    /// The board file.
    pub toml: String,
    /// What the other driver's HAL names begin with.
    pub prefix: String,
    /// What a person should know: what had no counterpart, what was assumed.
    pub notes: Vec<String>,
}

/// A board in the making, and where its parts come from.
struct Draft<'p> {
    file: String,
    platforms: &'p dyn Platforms,
    board: Board,
    notes: Vec<String>,
    /// What the other driver's HAL names begin with.
    prefix: String,
    /// LiteX-CNC's step generators that stop at once.
    hard_stops: Vec<String>,
    /// Key of ours, their key, its place.
    origins: Vec<(String, String, Option<Place>)>,
}

impl<'p> Draft<'p> {
    fn new(
        file: &str,
        name: &str,
        platform: &str,
        platforms: &'p dyn Platforms,
    ) -> Result<Self, Error> {
        let Some((platform_file, text)) = platforms.text(platform) else {
            return Err(Error::from(Report {
                file: file.to_owned(),
                place: None,
                key: String::new(),
                value: format!("{platform:?}"),
                problem: "is not a platform we know".to_owned(),
                remedy: format!("there is {}", platforms.names().join(", ")),
            }));
        };
        let platform = Platform::read(&platform_file, platform, &text)?;
        let board = Board {
            file: file.to_owned(),
            ext_reset: ControlInput {
                pin: None,
                active: Level::High,
            },
            // The button is the factory pin. If the configuration uses it, `finish` removes this.
            factory: Some(ControlInput {
                pin: Some("key".to_owned()),
                active: Level::Low,
            }),
            ipv4: [0; 4],
            ..blank(name, platform)
        };
        Ok(Draft {
            file: file.to_owned(),
            platforms,
            board,
            notes: Vec::new(),
            prefix: String::new(),
            hard_stops: Vec::new(),
            origins: Vec::new(),
        })
    }

    /// Adds a channel. A name ours cannot be is changed, and said so; without a name it gets its
    /// number.
    fn push(
        &mut self,
        class: Class,
        name: Option<&str>,
        mut channel: Channel,
        origin: String,
        place: Option<Place>,
    ) {
        let number = self.board.of(class).len();
        let numbered = class.numbered(number);
        let room = class.hal().room();
        let wanted = name.unwrap_or(&numbered);
        let mut ours = match hal::is_name(wanted) && wanted.len() <= room {
            true => wanted.to_owned(),
            false => hal::nearest_name(wanted, room),
        };
        if ours.is_empty() || self.board.of(class).iter().any(|other| other.name == ours) {
            ours.clone_from(&numbered);
        }
        if name.is_some_and(|name| name != ours) {
            let kept = match &channel.litexcnc_name {
                Some(_) => "; `names=litexcnc-named` keeps the old one",
                None => "",
            };
            self.notes.push(format!("{origin}: the name {wanted:?} became \"{ours}\": our names have lower case, digits and hyphens, and {room} characters here{kept}."));
        }
        channel.name = ours;
        self.origins
            .push((format!("{}[{number}]", class.key()), origin, place));
        self.board.channels[class as usize].push(channel);
    }

    fn origin(&mut self, ours: &str, theirs: &str, place: Option<Place>) {
        self.origins
            .push((ours.to_owned(), theirs.to_owned(), place));
    }

    /// Declares each header with an input pin as modified: an unmodified header has only outputs.
    fn modify(&mut self) {
        let inputs = |class: Class| {
            class
                .pins()
                .iter()
                .filter(|(_, _, drives)| !drives)
                .map(|(key, _, _)| *key)
        };
        let of_channels = Class::ALL.into_iter().flat_map(|class| {
            let pins = self
                .board
                .of(class)
                .iter()
                .flat_map(|channel| &channel.pins);
            pins.filter(move |(key, _)| inputs(class).any(|input| input == *key))
                .map(|(_, pin)| pin)
        });
        let mut lines: Vec<(u8, String)> = Vec::new();
        for pin in of_channels.chain(&self.board.ext_reset.pin) {
            let Some((header, _)) = split(pin) else {
                continue;
            };
            let line = match self.board.platform.pin(pin) {
                Some((Role::Own, _)) => header.to_owned(),
                Some((Role::Shared, _)) => format!("{header}:shared"),
                _ => continue,
            };
            let number = header.trim_start_matches('j').parse().unwrap_or_default();
            if !lines.iter().any(|(_, known)| *known == line) {
                lines.push((number, line));
            }
        }
        lines.sort();
        self.board.modified.bus_switch = lines.into_iter().map(|(_, line)| line).collect();
        if !self.board.modified.bus_switch.is_empty() {
            let note = format!(
                "The buffers of {} must have been replaced for this to work; if they were turned round instead, write `inputs` for `bus_switch`.",
                self.board.modified.bus_switch.join(", ")
            );
            self.notes.push(note);
        }
    }

    fn finish(mut self, head: String) -> Result<Imported, Error> {
        let key = Some("key");
        let uses_key = |channel: &Channel| {
            channel
                .pins
                .iter()
                .any(|(_, pin)| Some(pin.as_str()) == key)
        };
        if self.board.channels.iter().flatten().any(uses_key) {
            self.board.factory = None;
            self.notes.push("The button has a use here, so there is no factory pin: settings can only be reset with another bitstream, or write `factory` with a free input pin.".to_owned());
        }
        if !self.hard_stops.is_empty() {
            self.notes.push(format!("{}: without soft_stop they stopped at once; here every step generator comes to rest at its own acceleration limit when the host is lost (docs/safety.md).", self.hard_stops.join(", ")));
        }
        self.modify();
        let mut comments = vec![head];
        comments.extend(self.notes.iter().cloned());
        let toml = to_toml(&self.board, &comments);
        match Board::read(&self.file, &self.board.name, &toml, self.platforms) {
            Ok(board) => Ok(Imported {
                board,
                toml,
                prefix: self.prefix,
                notes: self.notes,
            }),
            Err(error) => Err(self.in_their_words(error)),
        }
    }

    /// An error about our keys, told with theirs.
    fn in_their_words(&self, mut error: Error) -> Error {
        error.place = None;
        for (ours, theirs, place) in &self.origins {
            let swap = |text: &str| {
                let at = text.find(ours.as_str())?;
                let rest = &text[at + ours.len()..];
                (!rest.starts_with(|c: char| c.is_ascii_alphanumeric() || c == '_'))
                    .then(|| format!("{}{theirs}{rest}", &text[..at]))
            };
            if let Some(key) = swap(&error.key).filter(|_| error.key.starts_with(ours.as_str())) {
                error.key = key;
                error.place = *place;
            }
            if let Some(problem) = swap(&error.problem) {
                error.problem = problem;
            }
        }
        error
    }
}

/// `0x10e2d5000001`, as both projects write it.
fn mac(text: &str) -> Option<[u8; 6]> {
    let digits = text
        .strip_prefix("0x")
        .or_else(|| text.strip_prefix("0X"))
        .unwrap_or(text);
    if digits.is_empty() || digits.len() > 12 || !digits.bytes().all(|b| b.is_ascii_hexdigit()) {
        return None;
    }
    let number = u64::from_str_radix(digits, 16).ok()?;
    let [_, _, mac @ ..] = number.to_be_bytes();
    Some(mac)
}
