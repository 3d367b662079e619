//! The wiring table: which pin of which header goes to which terminal of the machine.
//!
//! Terminals have the names that are printed on drives (PUL, DIR, ENA). A pin is named as on the
//! card's silk screen, from 1, and as in the board file, from 0. A table names no part that the
//! machine's file does not name: what goes between header and terminal is docs/guide/breakout.md's.

use crate::model::{CncMachine, Control, Estop, PlasmaInput, Relay, Switch};
use ferrocnc_config::platform::{HEADER, Level, Role, split};
use ferrocnc_config::{Board, Class};
use std::fmt::Write as _;

/// The page, without its head.
pub fn wiring(machine: &CncMachine, board: &Board) -> String {
    let mut page = Page {
        board,
        text: String::new(),
        headers: Vec::new(),
    };
    let _ = write!(
        page.text,
        "# Wiring of {0}\n\nOn a {1}. `{0}.svg` draws the headers. Pin numbers are the card's, from 1; the board\nfile counts from 0. Levels, currents and what goes between: the page on break-out boards.\n",
        machine.name, board.platform.title,
    );
    page.drives(machine);
    page.spindle(machine);
    page.outputs(machine);
    page.inputs(machine);
    page.grounds();
    page.text
}

struct Page<'b> {
    board: &'b Board,
    text: String,
    /// Those that have been named.
    headers: Vec<String>,
}

/// `J1 pin 1` of `j1:0`.
fn on_card(pin: &str) -> String {
    match split(pin) {
        Some((header, index)) => format!("{} pin {}", header.to_uppercase(), index + 1),
        None => pin.to_uppercase(),
    }
}

impl Page<'_> {
    fn heading(&mut self, title: &str) {
        let _ = write!(
            self.text,
            "\n## {title}\n\n| terminal | card | board file | |\n|---|---|---|---|\n"
        );
    }

    fn row(&mut self, terminal: &str, pin: &str, about: &str) {
        if let Some((header, _)) = split(pin)
            && !self.headers.iter().any(|known| known == header)
        {
            self.headers.push(header.to_owned());
        }
        let _ = writeln!(
            self.text,
            "| {terminal} | {} | `{pin}` | {about} |",
            on_card(pin)
        );
    }

    /// A row for every pin that the channel has, with the terminal of its key.
    fn channel(
        &mut self,
        class: Class,
        name: &str,
        terminal: impl Fn(&str) -> String,
        about: &str,
    ) {
        let board = self.board;
        let channel = board.of(class).iter().find(|it| it.name == name);
        for (key, pin) in channel.into_iter().flat_map(|channel| &channel.pins) {
            self.row(&terminal(key), pin, about);
        }
    }

    fn output(&mut self, name: &str, terminal: &str) {
        let mut channels = self.board.of(Class::Output).iter();
        let invert = channels.any(|it| it.name == name && it.invert);
        let level = match invert {
            true => "low is on",
            false => "high is on",
        };
        let about = format!("`{name}`: {level}");
        self.channel(Class::Output, name, |_| terminal.to_owned(), &about);
    }

    fn drives(&mut self, machine: &CncMachine) {
        self.heading("Drives");
        for joint in machine.joints() {
            let letter = joint.axis.letter.to_uppercase();
            let name = &joint.motor.name;
            let drive = match joint.axis.motors.len() {
                1 => format!("drive {letter}"),
                _ => format!("drive {letter}, motor `{name}`"),
            };
            let terminal = |key: &str| {
                let terminal = match key {
                    "step" => "PUL+",
                    "step_n" => "PUL\u{2212}",
                    "dir" => "DIR+",
                    "dir_n" => "DIR\u{2212}",
                    _ => "index",
                };
                format!("{drive}: {terminal}")
            };
            let about = match joint.motor.reversed {
                true => "turns the other way: the scale is negative, not the wires",
                false => "",
            };
            self.channel(Class::Stepgen, name, terminal, about);
        }
        if let Some(enable) = &machine.drive_enable {
            self.output(enable, "every drive: ENA");
        }
        let single = |one: &ferrocnc_config::board::Channel| one.pin("step_n").is_none();
        if self.board.of(Class::Stepgen).iter().any(single) {
            self.text += "\nPUL\u{2212} and DIR\u{2212} go to ground. Some drives are off while ENA is on: see theirs.\n";
        }
    }

    fn spindle(&mut self, machine: &CncMachine) {
        let Some(spindle) = &machine.spindle else {
            return;
        };
        self.heading("Spindle");
        if let Control::Pwm { name, volts, .. } = &spindle.control {
            let terminal = match volts {
                true => "converter from PWM to 0\u{2013}10 V: its input",
                false => "spindle: PWM",
            };
            self.channel(Class::Pwm, name, |_| terminal.to_owned(), "");
        }
        if let Some(on) = &spindle.on {
            self.output(on, "spindle: run, or forward");
        }
        if let Some(reverse) = &spindle.reverse {
            self.output(reverse, "spindle: reverse");
        }
        if let Some(encoder) = &spindle.encoder {
            let terminal = |key: &str| match key {
                "index" => "spindle encoder: Z (index)".to_owned(),
                key => format!("spindle encoder: {}", key.to_uppercase()),
            };
            self.channel(Class::Encoder, &encoder.name, terminal, "");
        }
    }

    fn outputs(&mut self, machine: &CncMachine) {
        let relays = machine.coolant.iter().map(|(relay, output)| {
            let terminal = match relay {
                Relay::Flood => "relay of the coolant pump",
                Relay::Mist => "relay of the mist",
                Relay::Air => "valve of the air",
                Relay::Lube => "relay of the lubrication",
            };
            (output.clone(), terminal)
        });
        let mut outputs: Vec<(String, &str)> = relays.collect();
        if let Some(plasma) = &machine.plasma {
            outputs.push((plasma.torch.clone(), "plasma source: start"));
            if let Some(ohmic) = &plasma.ohmic_enable {
                outputs.push((ohmic.clone(), "relay of the ohmic sensing"));
            }
        }
        if outputs.is_empty() {
            return;
        }
        self.heading("Relays and valves");
        for (output, terminal) in outputs {
            self.output(&output, terminal);
        }
    }

    fn inputs(&mut self, machine: &CncMachine) {
        // An input may be used for several purposes: one row says all of them.
        let mut all: Vec<(&Switch, Vec<String>)> = Vec::new();
        let mut add = |switch, what: String| {
            let known = all.iter_mut().find(|(known, _)| *known == switch);
            match known {
                Some((_, uses)) => uses.push(what),
                None => all.push((switch, vec![what])),
            }
        };
        for axis in &machine.axes {
            let letter = axis.letter.to_uppercase();
            let many = axis.home.switches.len() > 1;
            for (switch, motor) in axis.home.switches.iter().zip(&axis.motors) {
                let motor = match many {
                    true => format!(", motor `{}`", motor.name),
                    false => String::new(),
                };
                add(switch, format!("home switch {letter}{motor}"));
            }
            for (end, switch) in [("minimum", &axis.limits.min), ("maximum", &axis.limits.max)] {
                if let Some(switch) = switch {
                    add(switch, format!("limit switch {letter}, {end}"));
                }
            }
            if let Some(switch) = &axis.fault {
                add(switch, format!("drive {letter}: ALM"));
            }
        }
        if let Estop::Input(switch) = &machine.estop {
            add(switch, "e-stop".to_owned());
        }
        if let Some(switch) = &machine.probe {
            add(switch, "probe".to_owned());
        }
        if let Some(switch) = &machine.tool_setter {
            add(switch, "tool setter".to_owned());
        }
        for (what, switch) in machine.plasma.iter().flat_map(|plasma| &plasma.inputs) {
            let what = match what {
                PlasmaInput::ArcOk => "plasma source: arc OK",
                PlasmaInput::Float => "float switch",
                PlasmaInput::Ohmic => "ohmic sensing",
                PlasmaInput::Breakaway => "breakaway switch of the torch",
                PlasmaInput::MoveUp => "torch height control: up",
                PlasmaInput::MoveDown => "torch height control: down",
            };
            add(switch, what.to_owned());
        }
        self.heading("Switches and sensors");
        for (switch, uses) in all {
            let about = match switch.active {
                Level::High => "high if pressed: a contact to ground that opens",
                Level::Low => "low if pressed: a contact to ground that closes",
            };
            let about = format!("`{}`: {about}", switch.input);
            self.channel(Class::Input, &switch.input, |_| uses.join("; "), &about);
        }
        let volts = machine
            .plasma
            .iter()
            .filter_map(|it| it.arc_voltage.as_ref());
        for name in volts {
            let about = format!("`{name}`: the output of the THCAD, isolated");
            self.channel(Class::Encoder, name, |_| "THCAD: FOUT".to_owned(), &about);
        }
        if let Estop::External(level) = machine.estop {
            let about = format!("stops while it is {}", level.word());
            self.row("e-stop chain", "key", &about);
        }
    }

    fn grounds(&mut self) {
        self.text += "\n## Ground\n\nUse every ground of a header, and one wire from the supply of the machine's electronics to the\ncard's.\n\n| header | ground |\n|---|---|\n";
        self.headers.sort_by_key(|header| {
            let mut known = self.board.platform.headers.iter();
            known.position(|(name, _)| name == header)
        });
        for header in &self.headers {
            let is_ground = |index: &usize| {
                let role = self.board.platform.pin(&format!("{header}:{index}"));
                role.is_some_and(|(role, _)| role == Role::Ground)
            };
            let pins: Vec<String> = (0..HEADER.len())
                .filter(is_ground)
                .map(|index| format!("pin {}", index + 1))
                .collect();
            let _ = writeln!(
                self.text,
                "| {} | {} |",
                header.to_uppercase(),
                pins.join(", ")
            );
        }
    }
}
