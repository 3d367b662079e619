//! A board's headers with the use of every pin: the wiring sheet, on paper and in the terminal.
//!
//! Each header is drawn as seen from above: two rows of eight, pin 1 marked. A pin has two numbers:
//! the board files' from 0, and the silk screen's from 1. A shared line is drawn on every header.

mod svg;
mod terminal;

pub use svg::svg;
pub use terminal::terminal;

use crate::board::{Board, Class, Modified};
use crate::platform::{FIRST_SHARED, HEADER, Platform, Role};
use std::collections::BTreeMap;

/// What a pin is for, as far as its colour goes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Use {
    /// Step and direction.
    Stepgen,
    /// Encoder inputs.
    Encoder,
    /// PWM outputs.
    Pwm,
    /// Inputs.
    Input,
    /// Outputs.
    Output,
    /// E-stop inputs, the external reset: what stops the machine.
    Stop,
    /// The factory pin.
    Factory,
    /// Nothing yet.
    Free,
    /// Ground.
    Ground,
}

impl Use {
    /// All that may be on a drawing, in the order of its legend.
    pub const ALL: [Use; 9] = [
        Use::Stepgen,
        Use::Encoder,
        Use::Pwm,
        Use::Input,
        Use::Output,
        Use::Stop,
        Use::Factory,
        Use::Free,
        Use::Ground,
    ];

    /// What the legend says.
    pub const fn title(self) -> &'static str {
        match self {
            Use::Stepgen => "step generator",
            Use::Encoder => "encoder",
            Use::Pwm => "PWM",
            Use::Input => "input",
            Use::Output => "output",
            Use::Stop => "stops the machine",
            Use::Factory => "factory settings",
            Use::Free => "free",
            Use::Ground => "ground",
        }
    }

    /// Its name for other programs.
    pub const fn key(self) -> &'static str {
        match self {
            Use::Stepgen => "stepgen",
            Use::Encoder => "encoder",
            Use::Pwm => "pwm",
            Use::Input => "input",
            Use::Output => "output",
            Use::Stop => "stop",
            Use::Factory => "factory",
            Use::Free => "free",
            Use::Ground => "ground",
        }
    }

    /// One letter, for a print without colour.
    pub const fn letter(self) -> char {
        match self {
            Use::Stepgen => 'S',
            Use::Encoder => 'E',
            Use::Pwm => 'P',
            Use::Input => 'I',
            Use::Output => 'O',
            Use::Stop => '!',
            Use::Factory => 'F',
            Use::Free => '\u{b7}',
            Use::Ground => '\u{2013}',
        }
    }
}

/// One pin of a header.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Pin {
    /// From 0; the silk screen says one more.
    pub index: usize,
    /// What it is on a LED panel: R0, CLK ...
    pub panel: &'static str,
    /// What it is for.
    pub usage: Use,
    /// The channel and its pin, as in `x step`; empty when the pin is free.
    pub label: String,
    /// Every header has this line.
    pub shared: bool,
    /// It is named by another header's pin, this one.
    pub same_as: Option<String>,
    /// It is read there, and here a buffer drives what is read.
    pub copy: bool,
}

/// One header.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Header {
    /// `j1`.
    pub name: String,
    /// What was done to it: empty when it is as sold.
    pub modified: String,
    /// Sixteen.
    pub pins: Vec<Pin>,
}

/// Everything a drawing shows.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Pinout {
    /// The configuration, or the platform when there is none.
    pub title: String,
    /// PCB, FPGA, clock, address.
    pub facts: String,
    /// In the order of the board.
    pub headers: Vec<Header>,
    /// The button, and what it is for.
    pub key: (Use, String),
}

impl Pinout {
    /// Of a configuration.
    pub fn of_board(board: &Board) -> Self {
        let [a, b, c, d] = board.ipv4;
        let facts = format!(
            "{} \u{b7} {} \u{b7} {} MHz \u{b7} {a}.{b}.{c}.{d}:{} \u{b7} PHY {}",
            board.platform.title,
            board.platform.device,
            f64::from(board.sys_clk_hz) / 1e6,
            board.udp_port,
            board.phy
        );
        Self::new(
            board.name.clone(),
            facts,
            &board.platform,
            &holders(board),
            &board.modified,
        )
    }

    /// Of a platform with nothing on it.
    pub fn of_platform(platform: &Platform) -> Self {
        let facts = format!("{} \u{b7} {}", platform.title, platform.device);
        Self::new(
            platform.name.clone(),
            facts,
            platform,
            &BTreeMap::new(),
            &Modified::default(),
        )
    }

    fn new(
        title: String,
        facts: String,
        platform: &Platform,
        holders: &BTreeMap<String, (Use, String)>,
        modified: &Modified,
    ) -> Self {
        let find = |name: &str| holders.get(name).cloned();
        let pin = |header: &str, index: usize, panel: &'static str| {
            let name = format!("{header}:{index}");
            let role = platform.pin(&name).map(|(role, _)| role);
            let shared = index >= FIRST_SHARED && role == Some(Role::Shared);
            let elsewhere = || {
                let mut others = platform
                    .headers
                    .iter()
                    .map(|(other, _)| format!("{other}:{index}"));
                others
                    .find(|other| holders.contains_key(other))
                    .filter(|_| shared)
            };
            let same_as = if holders.contains_key(&name) {
                None
            } else {
                elsewhere()
            };
            let (usage, label) = match (role, find(same_as.as_deref().unwrap_or(&name))) {
                (Some(Role::Ground), _) => (Use::Ground, "GND".to_owned()),
                (_, Some(holder)) => holder,
                (_, None) => (Use::Free, String::new()),
            };
            let read = matches!(usage, Use::Encoder | Use::Input | Use::Stop | Use::Factory);
            let copy = same_as.is_some()
                && read
                && state(modified, &format!("{header}:shared")).is_empty();
            Pin {
                index,
                panel,
                usage,
                label,
                shared,
                same_as,
                copy,
            }
        };
        let header = |(name, _): &(String, Vec<String>)| Header {
            name: name.clone(),
            modified: described(modified, name),
            pins: HEADER
                .iter()
                .enumerate()
                .map(|(index, panel)| pin(name, index, panel))
                .collect(),
        };
        Pinout {
            title,
            facts,
            headers: platform.headers.iter().map(header).collect(),
            key: find("key").unwrap_or((Use::Free, String::new())),
        }
    }

    /// The uses that are on this drawing.
    pub fn uses(&self) -> impl Iterator<Item = Use> {
        let on = |usage: &Use| {
            self.key.0 == *usage
                || self
                    .headers
                    .iter()
                    .flat_map(|header| &header.pins)
                    .any(|pin| pin.usage == *usage)
        };
        Use::ALL.into_iter().filter(on)
    }
}

/// What was done to these lines, `j5` or `j5:shared`: nothing is empty.
fn state(modified: &Modified, lines: &str) -> &'static str {
    let is = |list: &[String]| list.iter().any(|known| known == lines);
    match (is(&modified.bus_switch), is(&modified.inputs)) {
        (true, _) => "bus switch",
        (_, true) => "inputs",
        (false, false) => "",
    }
}

fn described(modified: &Modified, header: &str) -> String {
    let of = |lines: &str| state(modified, lines);
    match (of(header), of(&format!("{header}:shared"))) {
        ("", "") => String::new(),
        (own, "") => own.to_owned(),
        ("", shared) => format!("shared lines: {shared}"),
        (own, shared) if own == shared => format!("{own}, shared lines too"),
        (own, shared) => format!("{own}; shared lines: {shared}"),
    }
}

/// Pin -> its use and its label.
fn holders(board: &Board) -> BTreeMap<String, (Use, String)> {
    let mut holders: BTreeMap<String, (Use, String)> = BTreeMap::new();
    let mut add = |pin: &str, usage: Use, label: String| {
        let entry = holders
            .entry(pin.to_owned())
            .or_insert((usage, String::new()));
        if !entry.1.is_empty() {
            entry.1 += ", ";
        }
        entry.1 += &label;
    };
    for class in Class::ALL {
        for channel in board.of(class) {
            for (key, pin) in &channel.pins {
                let usage = match class {
                    Class::Stepgen => Use::Stepgen,
                    Class::Encoder => Use::Encoder,
                    Class::Pwm => Use::Pwm,
                    Class::Input if channel.estop.is_some() => Use::Stop,
                    Class::Input => Use::Input,
                    Class::Output => Use::Output,
                };
                let name = &channel.name;
                let label = match (class, *key, channel.kind.as_str()) {
                    (Class::Stepgen, key, kind) => format!("{name} {}", stepgen_line(key, kind)),
                    (Class::Encoder, key, _) => format!("{name} {key}"),
                    (Class::Pwm, key, "up_down") => {
                        format!("{name} {}", if key == "pin" { "up" } else { "down" })
                    }
                    (Class::Pwm, "pin", _) => format!("{name} pwm"),
                    (Class::Pwm, key, _) => format!("{name} {key}"),
                    (Class::Input | Class::Output, ..) => name.clone(),
                };
                add(pin, usage, label);
            }
        }
    }
    if let Some(pin) = &board.ext_reset.pin {
        add(
            pin,
            Use::Stop,
            format!("reset if {}", board.ext_reset.active.word()),
        );
    }
    if let Some(factory) = &board.factory
        && let Some(pin) = &factory.pin
    {
        let usage = if board.ext_reset.pin.as_ref() == Some(pin) {
            Use::Stop
        } else {
            Use::Factory
        };
        add(pin, usage, format!("factory if {}", factory.active.word()));
    }
    holders
}

fn stepgen_line(key: &str, kind: &str) -> &'static str {
    match (key, kind) {
        ("step", "up_down") => "up",
        ("step_n", "up_down") => "up\u{2212}",
        ("dir", "up_down") => "down",
        ("dir_n", "up_down") => "down\u{2212}",
        ("step", "quadrature") => "A",
        ("step_n", "quadrature") => "A\u{2212}",
        ("dir", "quadrature") => "B",
        ("dir_n", "quadrature") => "B\u{2212}",
        ("step", _) => "step",
        ("step_n", _) => "step\u{2212}",
        ("dir", _) => "dir",
        ("dir_n", _) => "dir\u{2212}",
        _ => "index",
    }
}
