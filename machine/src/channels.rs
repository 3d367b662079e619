//! The channels of the board that a machine needs, and which of its keys asks for each.

use crate::model::{CncMachine, Control, Estop, Switch};
use ferrocnc_config::platform::Level;
use ferrocnc_config::{Board, Class, Error};

/// A channel that is needed.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Wanted {
    /// Its kind.
    pub class: Class,
    /// Its name.
    pub name: String,
    /// Its type, if it is not the usual one.
    pub kind: Option<&'static str>,
    /// Its index pin is needed.
    pub index: bool,
    /// Inputs: the level that stops.
    pub estop: Option<Level>,
    /// The key of the machine that asks for it.
    pub key: String,
}

/// All of them, each once, in the order of the file.
pub fn wanted(machine: &CncMachine) -> Vec<Wanted> {
    let mut all = List(Vec::new());
    for axis in &machine.axes {
        for motor in &axis.motors {
            let key = format!("{}.motors", axis.key);
            let index = axis.home.method.uses_index();
            all.add(Class::Stepgen, &motor.name, key).index = index;
        }
    }
    for axis in &machine.axes {
        for switch in &axis.home.switches {
            all.input(switch, format!("{}.home.inputs", axis.key));
        }
        for (end, switch) in [("min", &axis.limits.min), ("max", &axis.limits.max)] {
            all.maybe(switch, format!("{}.limits.{end}", axis.key));
        }
        all.maybe(&axis.fault, format!("{}.fault", axis.key));
    }
    if let Estop::Input(switch) = &machine.estop {
        let key = "estop.input".to_owned();
        all.add(Class::Input, &switch.input, key).estop = Some(switch.active);
    }
    all.maybe(&machine.probe, "probe".to_owned());
    all.maybe(&machine.tool_setter, "tool_setter".to_owned());
    all.output(machine.drive_enable.as_ref(), "drives.enable");
    if let Some(spindle) = &machine.spindle {
        all.output(spindle.on.as_ref(), "spindle.on");
        all.output(spindle.reverse.as_ref(), "spindle.reverse");
        if let Control::Pwm { name, .. } = &spindle.control {
            all.add(Class::Pwm, name, "spindle.pwm".to_owned());
        }
        if let Some(encoder) = &spindle.encoder {
            let key = "spindle.encoder".to_owned();
            all.add(Class::Encoder, &encoder.name, key).index = true;
        }
    }
    for (_, output) in &machine.coolant {
        all.output(Some(output), "coolant");
    }
    if let Some(plasma) = &machine.plasma {
        all.output(Some(&plasma.torch), "plasma.torch");
        all.output(plasma.ohmic_enable.as_ref(), "plasma.ohmic_enable");
        if let Some(name) = &plasma.arc_voltage {
            let key = "plasma.arc_voltage".to_owned();
            all.add(Class::Encoder, name, key).kind = Some("counter");
        }
        for (_, switch) in &plasma.inputs {
            all.input(switch, "plasma".to_owned());
        }
    }
    all.0
}

/// What is asked for so far.
struct List(Vec<Wanted>);

impl List {
    fn add(&mut self, class: Class, name: &str, key: String) -> &mut Wanted {
        let known = |one: &Wanted| one.class == class && one.name == name;
        let at = self.0.iter().position(known).unwrap_or(self.0.len());
        if at == self.0.len() {
            self.0.push(Wanted {
                class,
                name: name.to_owned(),
                kind: None,
                index: false,
                estop: None,
                key,
            });
        }
        &mut self.0[at]
    }

    fn input(&mut self, switch: &Switch, key: String) {
        self.add(Class::Input, &switch.input, key);
    }

    fn maybe(&mut self, switch: &Option<Switch>, key: String) {
        if let Some(switch) = switch {
            self.input(switch, key);
        }
    }

    fn output(&mut self, name: Option<&String>, key: &str) {
        if let Some(name) = name {
            self.add(Class::Output, name, key.to_owned());
        }
    }
}

/// What this board has not, or has differently.
pub fn missing(machine: &CncMachine, board: &Board) -> Vec<Error> {
    let mut errors = Vec::new();
    for one in wanted(machine) {
        let name = format!("{:?}", one.name);
        let word = one.class.key();
        let Some(channel) = board
            .of(one.class)
            .iter()
            .find(|channel| channel.name == one.name)
        else {
            let has: Vec<&str> = board
                .of(one.class)
                .iter()
                .map(|channel| channel.name.as_str())
                .collect();
            let has = match has.is_empty() {
                true => format!("it has no {word} at all; take another image"),
                false => format!("write one that it has: {}", has.join(", ")),
            };
            errors.push(machine.error(
                &one.key,
                name,
                format!("is not a {word} of {}", board.file),
                has,
            ));
            continue;
        };
        if one.index && channel.pin("index").is_none() && one.class == Class::Stepgen {
            errors.push(machine.error(
                &one.key,
                &name,
                format!("homes to an index, and {word} {name} of {} has no index pin", board.file),
                "write index = \"j8:0\" (the pin it is on) into its table in the board file, or home to a switch",
            ));
        }
        if let Some(kind) = one.kind.filter(|kind| channel.kind != *kind) {
            errors.push(machine.error(
                &one.key,
                &name,
                format!(
                    "has to be of type \"{kind}\", and is \"{}\" in {}",
                    channel.kind, board.file
                ),
                format!("write type = \"{kind}\" into its table in the board file"),
            ));
        }
        if one.estop.is_some() && channel.estop != one.estop {
            let level = one.estop.map_or("high", Level::word);
            errors.push(machine.error(
                &one.key,
                &name,
                format!("does not stop the board: {} gives it no estop = \"{level}\"", board.file),
                format!("write estop = \"{level}\" into its table in the board file, or name the input that has it"),
            ));
        }
    }
    errors
}

/// Names that the board cannot have.
pub fn names(machine: &CncMachine) -> Vec<Error> {
    let mut errors = Vec::new();
    for one in wanted(machine) {
        let room = one.class.hal().room();
        if !ferrocnc_config::hal::is_name(&one.name) || one.name.len() > room {
            let near = ferrocnc_config::hal::nearest_name(&one.name, room);
            let like = match near.is_empty() {
                true => "as in \"home-x\"".to_owned(),
                false => format!("as in {near:?}"),
            };
            errors.push(machine.error(
                &one.key,
                format!("{:?}", one.name),
                "is not a name that HAL can have",
                format!("write at most {room} lower case letters, digits and hyphens, a letter first, {like}"),
            ));
        }
    }
    let outputs = wanted(machine);
    for name in &machine.board.active_low {
        let is = |one: &Wanted| one.class == Class::Output && one.name == *name;
        if !outputs.iter().any(is) {
            errors.push(machine.error(
                "board.active_low",
                format!("{name:?}"),
                "is not an output of this machine",
                "write the name of an output that another key names, or take it away",
            ));
        }
    }
    errors
}
