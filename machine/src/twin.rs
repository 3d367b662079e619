//! The machine on the simulated board: a second INI file that starts from LinuxCNC's picker without
//! a card, and what the picker shows beside both.
//!
//! The driver looks for the board when the HAL files are read, which is before LinuxCNC starts what
//! `[APPLICATIONS]` names. So the first HAL file loads the board, as the component `ferrocnc-twin`:
//! LinuxCNC ends its components when it ends.

use crate::ini::Entry;
use crate::model::{BoardSource, CncMachine, Control};
use ferrocnc_config::Board;
use std::fmt::Write as _;

/// The first HAL file of the simulated machine.
pub const TWIN_HAL: &str = "twin.hal";

/// Where the simulated board is; a card has another address.
const ADDRESS: &str = "127.0.0.1:1234";
/// 100 ms: the board's time passes with the exchanges, so the servo thread waits for an answer on a
/// busy computer, and the machine's time is late, not its position.
const READ_TIMEOUT_NS: u32 = 100_000_000;

/// The machine's INI file, with the simulated board in place of the card. Includes, comments and
/// lines of the user's are as they are there.
pub fn ini(text: &str) -> String {
    let mut section = String::new();
    let mut loaded = false;
    let mut out = String::new();
    for line in text.lines() {
        let set = |key: &str, value: String| Entry {
            section: section.clone(),
            key: key.to_owned(),
            value,
        };
        let key = line.split_once('=').map(|(key, _)| key.trim());
        let other = match (section.as_str(), key) {
            ("FERROCNC", Some("BOARD")) => Some(set("BOARD", ADDRESS.to_owned())),
            ("FERROCNC", Some("PACKET_READ_TIMEOUT")) => {
                Some(set("PACKET_READ_TIMEOUT", READ_TIMEOUT_NS.to_string()))
            }
            _ => None,
        };
        out += &other.map_or_else(|| line.to_owned(), |entry| entry.line());
        out += "\n";
        if let Some(name) = line.trim().strip_prefix('[') {
            section = name.split(']').next().unwrap_or_default().trim().to_owned();
            if section == "HAL" && !loaded {
                let _ = writeln!(out, "HALFILE = {TWIN_HAL}");
                loaded = true;
            }
        }
    }
    out
}

/// The HAL file that loads the board.
pub fn hal(machine: &CncMachine) -> String {
    let board = match &machine.board.source {
        BoardSource::Platform(..) => format!("{}.toml", machine.name),
        BoardSource::File(file) => file.clone(),
    };
    format!(
        "# The simulated board and what is behind its pins. It ends with LinuxCNC.\n\
        loadusr -Wn ferrocnc-twin ferrocnc-twin {} {board} [FERROCNC]BOARD\n",
        file(machine)
    )
}

/// The machine's file, in its folder.
fn file(machine: &CncMachine) -> &str {
    machine.file.rsplit('/').next().unwrap_or_default()
}

/// What the picker shows beside the INI file.
pub fn about(machine: &CncMachine, board: &Board) -> String {
    let name = &machine.name;
    let mut text = format!("{}\n\n", summary(machine));
    let _ = write!(
        text,
        "It is for a {} with the image of {}.toml, at {}. {name}-wiring.md says which pin goes to which terminal, {name}.svg draws the headers.\n\n\
        Put your own numbers into {}, then say `ferrocnc machine write` in this folder.\n",
        board.platform.title,
        board.name,
        machine.board.address,
        file(machine)
    );
    let _ = write!(text, "\nWithout a card: {name}-twin.\n");
    text
}

/// The same beside the second INI file.
pub fn about_twin(machine: &CncMachine) -> String {
    let name = &machine.name;
    format!(
        "{} It runs on the simulated board, without a card.\n\n\
        The board, its switches and its spindle start and end with LinuxCNC. The packages ferrocnc and ferrocnc-sim must be installed.\n\n\
        Press F1 and F2, then home all axes. With a card: {name}.\n",
        summary(machine)
    )
}

/// The machine in a sentence.
fn summary(machine: &CncMachine) -> String {
    let axes = machine.axes.iter().map(|axis| {
        let letter = axis.letter.to_uppercase();
        match axis.motors.len() {
            1 => letter.to_string(),
            motors => format!("{letter} with {motors} motors"),
        }
    });
    let axes: Vec<String> = axes.collect();
    let mut parts = vec![axes.join(", ")];
    if let Some(spindle) = &machine.spindle {
        parts.push(
            match (&spindle.control, &spindle.encoder) {
                (_, Some(_)) => "a spindle with an encoder",
                (Control::OnOff, None) => "a spindle",
                (Control::Pwm { volts: true, .. }, None) => "a spindle with 0 to 10 V",
                (Control::Pwm { volts: false, .. }, None) => "a spindle with PWM",
            }
            .to_owned(),
        );
    }
    if machine.probe.is_some() {
        parts.push("a probe".to_owned());
    }
    if machine.plasma.is_some() {
        parts.push("a torch under QtPlasmaC".to_owned());
    }
    format!("{}: {}.", machine.name, parts.join(", "))
}
