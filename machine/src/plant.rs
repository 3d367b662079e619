//! What the simulated board has at its pins when it is this machine: home and limit switches that
//! the axes run into, a probe and a float switch that touch, a spindle that turns. It is
//! `ferrocnc-sim --plant`'s file. Everything stands where it is not pressed.

use crate::model::{Axis, CncMachine, Control, End, Estop, Joint, PlasmaInput, Switch};
use crate::units::{Length, Scale, number};
use ferrocnc_config::platform::Level;
use ferrocnc_config::{Board, Class};
use std::fmt::Write as _;

/// How far from its home switch an axis stands, in seconds of the search for it.
const SEARCH_SECONDS: f64 = 1.0;

/// The file.
pub fn plant(machine: &CncMachine, board: &Board) -> String {
    let mut file = File {
        board,
        text: format!(
            "# The machine {} behind the pins of the simulated board. Positions are steps.\n",
            machine.name
        ),
        wired: Vec::new(),
    };
    for joint in machine.joints() {
        file.joint(&joint);
    }
    file.touching(machine);
    file.spindle(machine);
    file.released(machine);
    file.text
}

struct File<'b> {
    board: &'b Board,
    text: String,
    /// Inputs that have something.
    wired: Vec<String>,
}

/// Where a joint's coordinates are, as steps since power-up count.
struct Place {
    /// The coordinate at power-up.
    start: f64,
    scale: Scale,
}

impl Place {
    fn of(joint: &Joint<'_>) -> Self {
        let (axis, home) = (joint.axis, &joint.axis.home);
        // It stands short of its switch, by no more than a quarter of its travel.
        let travel = axis.max.0 - axis.min.0;
        let short = (home.search.0.abs() * SEARCH_SECONDS).min(travel / 4.0);
        let start = match (home.method.searches(), home.end) {
            (false, _) => home.position.0,
            (true, End::Min) => home.offset.0 + short,
            (true, End::Max) => home.offset.0 - short,
        };
        Place {
            start,
            scale: joint.scale(),
        }
    }

    fn steps(&self, coordinate: f64) -> i64 {
        ((coordinate - self.start) * self.scale.0).round() as i64
    }
}

/// Farther than the axis goes while it stops from its speed of search.
fn behind(axis: &Axis) -> f64 {
    let way = axis.home.search.0 * axis.home.search.0 / axis.acceleration.0;
    way.max((axis.max.0 - axis.min.0) / 100.0)
}

impl File<'_> {
    fn number(&self, class: Class, name: &str) -> Option<usize> {
        let mut channels = self.board.of(class).iter();
        channels.position(|channel| channel.name == name)
    }

    /// A switch that is pressed from this coordinate on, towards that end.
    fn switch(&mut self, switch: &Switch, joint: &Joint<'_>, coordinate: f64, end: End) {
        let place = Place::of(joint);
        let (Some(input), Some(stepgen)) = (
            self.number(Class::Input, &switch.input),
            self.number(Class::Stepgen, &joint.motor.name),
        ) else {
            return;
        };
        let above = (end == End::Max) == (place.scale.0 > 0.0);
        let _ = write!(
            self.text,
            "\n[[switch]] # {}, at {} of {}\nstepgen = {stepgen}\nat = {}\nabove = {above}\ninput = {input}\ninverted = {}\n",
            switch.input,
            number(coordinate),
            joint.motor.name,
            place.steps(coordinate),
            switch.active == Level::Low,
        );
        self.wired.push(switch.input.clone());
    }

    fn joint(&mut self, joint: &Joint<'_>) {
        let (axis, home) = (joint.axis, &joint.axis.home);
        if home.method.searches()
            && let Some(switch) = joint.home_switch()
        {
            let at = home.offset.0 + joint.motor.square.0;
            self.switch(&switch.clone(), joint, at, home.end);
        }
        for (end, limit) in [(End::Min, &axis.limits.min), (End::Max, &axis.limits.max)] {
            let is_home = home.method.by_limit() && home.end == end;
            let Some(limit) = limit.as_ref().filter(|_| !is_home) else {
                continue;
            };
            let homes_here = home.method.searches() && home.end == end;
            let outermost = |Length(own): Length| match (homes_here, end) {
                (false, _) => own,
                (true, End::Min) => own.min(home.offset.0),
                (true, End::Max) => own.max(home.offset.0),
            };
            let at = match end {
                End::Min => outermost(axis.min) - behind(axis),
                End::Max => outermost(axis.max) + behind(axis),
            };
            self.switch(limit, joint, at, end);
        }
    }

    /// Probe and float switch: they touch near the lower end of Z.
    fn touching(&mut self, machine: &CncMachine) {
        let float = machine.plasma.iter().flat_map(|plasma| &plasma.inputs);
        let float = float.filter(|(what, _)| *what == PlasmaInput::Float);
        let switches = float.map(|(_, switch)| switch).chain(&machine.probe);
        for switch in switches {
            for joint in machine.joints() {
                if joint.axis.letter == 'z' {
                    let axis = joint.axis;
                    let table = axis.min.0 + (axis.max.0 - axis.min.0) / 10.0;
                    self.switch(switch, &joint, table, End::Min);
                }
            }
        }
    }

    fn spindle(&mut self, machine: &CncMachine) {
        let Some(spindle) = &machine.spindle else {
            return;
        };
        let (Control::Pwm { name, full, .. }, Some(encoder)) = (&spindle.control, &spindle.encoder)
        else {
            return;
        };
        let (Some(pwm), Some(number)) = (
            self.number(Class::Pwm, name),
            self.number(Class::Encoder, &encoder.name),
        ) else {
            return;
        };
        let _ = write!(
            self.text,
            "\n[[spindle]]\npwm = {pwm}\nencoder = {number}\ncounts_per_rev = {}\nmax_rps = {:.6}\nlag_ms = 100.0\n",
            encoder.counts,
            full.0 / 60.0,
        );
        let outputs = [
            ("enable_output", &spindle.on),
            ("reverse_output", &spindle.reverse),
        ];
        for (key, output) in outputs {
            if let Some(output) = output
                .as_ref()
                .and_then(|it| self.number(Class::Output, it))
            {
                let _ = writeln!(self.text, "{key} = {output}");
            }
        }
    }

    /// What nothing presses is held at the level of a switch at rest.
    fn released(&mut self, machine: &CncMachine) {
        let mut switches: Vec<&Switch> = Vec::new();
        if let Estop::Input(switch) = &machine.estop {
            switches.push(switch);
        }
        switches.extend(machine.axes.iter().filter_map(|axis| axis.fault.as_ref()));
        switches.extend(&machine.probe);
        switches.extend(&machine.tool_setter);
        let plasma = machine.plasma.iter().flat_map(|plasma| &plasma.inputs);
        switches.extend(plasma.map(|(_, switch)| switch));
        for switch in switches {
            let Some(input) = self.number(Class::Input, &switch.input) else {
                continue;
            };
            if !self.wired.contains(&switch.input) {
                let level = match switch.active {
                    Level::High => "low",
                    Level::Low => "high",
                };
                let _ = write!(
                    self.text,
                    "\n[[jumper]] # {} is at rest\nfrom = \"{level}\"\nto = \"input.{input}\"\n",
                    switch.input
                );
                self.wired.push(switch.input.clone());
            }
        }
    }
}
