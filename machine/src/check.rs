//! What is wrong about a machine as a whole: all of it, each with its key, line and remedy.

use crate::channels;
use crate::model::{Axis, CncMachine, Control, End, Estop, Gui, Method, PlasmaInput};
use crate::units::{Hertz, Scale, Speed, number};
use ferrocnc_config::Error;
use std::collections::BTreeMap;

/// What was found.
#[derive(Clone, Debug, Default)]
pub struct Findings {
    /// The machine cannot be made so.
    pub bad: Vec<Error>,
    /// It can, and it is worth knowing.
    pub notes: Vec<Error>,
}

/// The board's clock. Every configuration closes at it.
const CLOCK: f64 = 60e6;
/// Clocks that a step's length is counted in: 13 bits.
const STEP_CLOCKS: f64 = 8191.0;
/// Clocks that a direction's times are counted in: 16 bits.
const DIR_CLOCKS: f64 = 65535.0;
/// Clocks that a PWM's period is counted in: 21 bits.
const PWM_CLOCKS: f64 = 2_097_151.0;
/// LinuxCNC's EMCMOT_MAX_JOINTS.
const JOINTS: usize = 16;

/// Looks at everything that needs no board file.
pub fn check(machine: &CncMachine) -> Findings {
    let mut found = Findings {
        bad: channels::names(machine),
        notes: Vec::new(),
    };
    axes(machine, &mut found);
    for axis in &machine.axes {
        travel(machine, axis, &mut found);
        timing(machine, axis, &mut found);
        homing(machine, axis, &mut found);
    }
    shared_switches(machine, &mut found);
    interface(machine, &mut found);
    spindle(machine, &mut found);
    estop(machine, &mut found);
    found
}

fn key(axis: &Axis, name: &str) -> String {
    format!("{}.{name}", axis.key)
}

/// Letters and motors, each once.
fn axes(machine: &CncMachine, found: &mut Findings) {
    let (mut letters, mut motors) = (BTreeMap::new(), BTreeMap::new());
    for axis in &machine.axes {
        if let Some(other) = letters.insert(axis.letter, &axis.key) {
            found.bad.push(machine.error(
                &key(axis, "letter"),
                format!("\"{}\"", axis.letter),
                format!("is already {other}'s"),
                "give every axis a letter of its own; an axis with two motors names both in motors",
            ));
        }
        for motor in &axis.motors {
            if let Some(other) = motors.insert(&motor.name, &axis.key) {
                found.bad.push(machine.error(
                    &key(axis, "motors"),
                    format!("{:?}", motor.name),
                    format!("is already a motor of {other}"),
                    "give every motor a step generator of its own",
                ));
            }
        }
    }
    if motors.len() > JOINTS {
        found.bad.push(machine.error(
            "axis",
            "",
            format!("has {} motors", motors.len()),
            format!("LinuxCNC and the board have {JOINTS}; take some away"),
        ));
    }
}

fn travel(machine: &CncMachine, axis: &Axis, found: &mut Findings) {
    let (min, max, home) = (axis.min, axis.max, axis.home.position);
    if min >= max {
        found.bad.push(machine.error(
            &key(axis, "max"),
            max,
            format!("is not above min, which is {min}"),
            "write the end with the greater coordinate",
        ));
    } else if home < min || home > max {
        found.bad.push(machine.error(
            &key(axis, "home.position"),
            home,
            format!("is outside {min} to {max}"),
            "write a place within min and max of the axis",
        ));
    }
    if axis.backlash.0 < 0.0 {
        found.bad.push(machine.error(
            &key(axis, "backlash"),
            axis.backlash,
            "is negative",
            "write how much the screw turns before the table follows, as in 0.02",
        ));
    }
}

/// The drive's timing against the speed, and against what the board counts.
fn timing(machine: &CncMachine, axis: &Axis, found: &mut Findings) {
    let rate = axis.scale.rate(axis.speed);
    let period = axis.timing.period();
    let most = Hertz(1e9 / f64::from(period.0));
    let fastest = Speed(most.0 / axis.scale.0.abs());
    if rate > most {
        found.bad.push(machine.error(
            &key(axis, "speed"),
            axis.speed,
            format!(
                "is {} steps/s at {} steps a unit, and the drive's steplen and stepspace, together {period} ns, allow {}",
                number(rate.0.round()), axis.scale, number(most.0.floor())
            ),
            format!(
                "write at most {}, fewer microsteps, or shorter times if the drive's data sheet allows them",
                number((fastest.0 / HEADROOM * 1e3).floor() / 1e3)
            ),
        ));
    } else if rate.0 * HEADROOM > most.0 {
        found.notes.push(machine.error(
            &key(axis, "speed"),
            axis.speed,
            format!(
                "leaves the stepgen less than a quarter to catch up: the drive's timing allows {}",
                fastest
            ),
            format!(
                "write at most {}",
                number((fastest.0 / HEADROOM * 1e3).floor() / 1e3)
            ),
        ));
    }
    let times = axis.timing;
    for (name, time, clocks) in [
        ("steplen", times.steplen, STEP_CLOCKS),
        ("stepspace", times.stepspace, STEP_CLOCKS),
        ("dirsetup", times.dirsetup, DIR_CLOCKS),
        ("dirhold", times.dirhold, DIR_CLOCKS),
    ] {
        let longest = (clocks / CLOCK * 1e9).floor();
        if f64::from(time.0) > longest {
            found.bad.push(machine.error(
                &key(axis, &format!("drive.{name}")),
                time,
                "is longer than the board can count",
                format!("write at most {longest} ns"),
            ));
        } else if time >= machine.servo_period {
            found.bad.push(machine.error(
                &key(axis, &format!("drive.{name}")),
                time,
                format!(
                    "is not below the servo period of {} ns",
                    machine.servo_period
                ),
                "write what the drive's data sheet says, in nanoseconds",
            ));
        }
    }
    // A unit must be more than a step, or nothing can be said about where the axis is.
    if axis.scale < Scale(1.0) {
        found.notes.push(machine.error(
            &key(axis, "pitch"),
            "",
            format!("makes {} steps a unit", axis.scale),
            "look at motor_steps, microsteps, gear and pitch again",
        ));
    }
}

/// The stepgen may be a quarter faster than the axis, to catch up.
pub const HEADROOM: f64 = 1.25;

fn homing(machine: &CncMachine, axis: &Axis, found: &mut Findings) {
    let home = &axis.home;
    let method = Method::ALL.into_iter().find(|(_, it)| *it == home.method);
    let method = method.map_or("", |(name, _)| name);
    if home.method.searches() && home.switches.is_empty() {
        let (problem, remedy) = match home.method.by_limit() {
            true => (
                "needs a limit switch at the end it says",
                "write limits = { min = \"limit-x\", max = \"limit-x\" } into the axis",
            ),
            false => (
                "needs a switch",
                "write inputs = [\"home-x\"], the input it is on",
            ),
        };
        let method = format!("\"{method}\"");
        let error = machine.error(&key(axis, "home.method"), method, problem, remedy);
        found.bad.push(error);
    }
    let (switches, motors) = (home.switches.len(), axis.motors.len());
    if switches > 1 && switches != motors {
        found.bad.push(machine.error(
            &key(axis, "home.inputs"),
            "",
            format!("has {switches} switches for {motors} motors"),
            "write one for each motor, or one for all",
        ));
    }
    if !home.method.searches() && !home.switches.is_empty() {
        found.bad.push(machine.error(
            &key(axis, "home.inputs"),
            "",
            format!("is not used: the method is \"{method}\""),
            "write method = \"switch\" or \"switch_index\", or take inputs away",
        ));
    }
    for (name, speed) in [("search", home.search), ("latch", home.latch)] {
        if speed > axis.speed {
            found.bad.push(machine.error(
                &key(axis, &format!("home.{name}")),
                speed,
                format!("is faster than the axis, which is {}", axis.speed),
                "write less than speed",
            ));
        }
    }
    if home.latch > home.search && home.method.searches() {
        found.bad.push(machine.error(
            &key(axis, "home.latch"),
            home.latch,
            format!("is faster than search, which is {}", home.search),
            "write less: the edge is taken once a servo period",
        ));
    }
    let middle = (axis.min.0 + axis.max.0) / 2.0;
    let far = match home.end {
        End::Min => home.offset.0 > middle,
        End::Max => home.offset.0 < middle,
    };
    if home.method.searches() && far {
        let end = match home.end {
            End::Min => "min",
            End::Max => "max",
        };
        found.bad.push(machine.error(
            &key(axis, "home.offset"),
            home.offset,
            format!("is nearer to the other end: the switch is said to be at {end}"),
            format!(
                "write the coordinate of the switch, near {}",
                match home.end {
                    End::Min => axis.min,
                    End::Max => axis.max,
                }
            ),
        ));
    }
    if motors > 1 && home.switches.len() == 1 {
        found.notes.push(machine.error(
            &key(axis, "home.inputs"),
            "",
            format!("has one switch for {motors} motors: homing does not square the axis"),
            "write a switch for each motor if it is to",
        ));
    }
}

/// A switch that homes several axes: one after the other only.
fn shared_switches(machine: &CncMachine, found: &mut Findings) {
    let mut users: BTreeMap<&str, &Axis> = BTreeMap::new();
    for axis in &machine.axes {
        for switch in axis.home.switches.iter().take(1) {
            let Some(other) = users.insert(&switch.input, axis) else {
                continue;
            };
            if other.home.sequence == axis.home.sequence {
                found.bad.push(machine.error(
                    &key(axis, "home.sequence"),
                    axis.home.sequence,
                    format!(
                        "homes at once with {}, by the same switch, {:?}",
                        other.letter.to_uppercase(),
                        switch.input
                    ),
                    "write another sequence: they cannot tell which of them is on the switch",
                ));
            }
        }
    }
}

fn interface(machine: &CncMachine, found: &mut Findings) {
    let is_plasma = machine.gui == Gui::QtPlasmaC;
    match (&machine.plasma, is_plasma) {
        (None, true) => found.bad.push(machine.error(
            "gui",
            "\"qtplasmac\"",
            "needs to know the torch",
            "write [plasma] with mode and torch",
        )),
        (Some(_), false) => found.bad.push(machine.error(
            "plasma",
            "",
            "is for QtPlasmaC",
            "write gui = \"qtplasmac\", or take [plasma] away",
        )),
        _ => {}
    }
    if let Some(plasma) = &machine.plasma {
        let has = |wanted| plasma.inputs.iter().any(|(input, _)| *input == wanted);
        if plasma.mode != 2 && plasma.arc_voltage.is_none() {
            found.bad.push(machine.error(
                "plasma.arc_voltage",
                "",
                format!("is missing for mode {}", plasma.mode),
                "write the encoder that counts the THCAD's pulses, or mode = 2",
            ));
        }
        let mut needed = vec![(2, PlasmaInput::MoveUp), (2, PlasmaInput::MoveDown)];
        needed.extend([(1, PlasmaInput::ArcOk), (2, PlasmaInput::ArcOk)]);
        for (mode, input) in needed {
            let name = PlasmaInput::ALL.into_iter().find(|(_, it, _)| *it == input);
            let name = name.map_or("", |(name, _, _)| name);
            if plasma.mode == mode && !has(input) {
                found.bad.push(machine.error(
                    &format!("plasma.{name}"),
                    "",
                    format!("is missing for mode {mode}"),
                    format!(
                        "write {name} = {{ input = \"{}\" }}",
                        name.replace('_', "-")
                    ),
                ));
            }
        }
        for letter in ['x', 'y', 'z'] {
            if !machine.axes.iter().any(|axis| axis.letter == letter) {
                found.bad.push(machine.error(
                    "gui",
                    "\"qtplasmac\"",
                    format!("needs an axis {}", letter.to_uppercase()),
                    "write one, or take another gui",
                ));
            }
        }
        if machine.spindle.is_some() {
            found.bad.push(machine.error(
                "spindle",
                "",
                "cannot be beside a torch: QtPlasmaC starts the torch with M3",
                "take [spindle] away",
            ));
        }
    }
    let has = |letter| machine.axes.iter().any(|axis| axis.letter == letter);
    if machine.lathe && !(has('x') && has('z')) {
        found.bad.push(machine.error(
            "lathe",
            "true",
            "needs the axes X and Z",
            "write them, or take lathe away",
        ));
    }
}

fn spindle(machine: &CncMachine, found: &mut Findings) {
    let Some(spindle) = &machine.spindle else {
        return;
    };
    if spindle.min < crate::units::Rpm(0.0) || spindle.min > spindle.max {
        found.bad.push(machine.error(
            "spindle.min_rpm",
            spindle.min,
            format!("is not from 0 to max_rpm, which is {}", spindle.max),
            "write its least speed in turns a minute",
        ));
    }
    match &spindle.control {
        Control::OnOff if spindle.on.is_none() => found.bad.push(machine.error(
            "spindle.on",
            "",
            "is missing",
            "write the output that switches it on, as in \"spindle-on\"",
        )),
        Control::OnOff => {}
        Control::Pwm {
            frequency, full, ..
        } => {
            let least = (CLOCK / PWM_CLOCKS).ceil();
            // 1000 steps from 0 to full speed.
            let most = CLOCK / 1000.0;
            if frequency.0 < least || frequency.0 > most {
                found.bad.push(machine.error(
                    "spindle.frequency",
                    frequency,
                    "is not what the board makes a thousand steps of speed with",
                    format!("write {least} to {most} Hz"),
                ));
            }
            if full.0 < spindle.max.0 {
                found.bad.push(machine.error(
                    "spindle.full_rpm",
                    full,
                    format!("is less than max_rpm, {}", spindle.max),
                    "write the speed at a duty of 1, or at 10 V, which is the most there is",
                ));
            }
        }
    }
    let near = spindle.encoder.as_ref().map_or(0.0, |encoder| encoder.near);
    if !(0.0..1.0).contains(&near) {
        found.bad.push(machine.error(
            "spindle.at_speed",
            number(near),
            "is not a part of the speed",
            "write 0 to 0.5, as in 0.05",
        ));
    }
}

fn estop(machine: &CncMachine, found: &mut Findings) {
    if machine.estop == Estop::Software {
        found.notes.push(machine.error(
            "estop.source",
            "\"software\"",
            "stops nothing if the computer does not answer",
            "wire a contact to an input or to the KEY terminal, and to the supply of the drives",
        ));
    }
    // A switch that stops the board is nothing else.
    if let Estop::Input(stop) = &machine.estop {
        let others = channels::wanted(machine).into_iter();
        let mut twice = others
            .filter(|one| one.name == stop.input && one.class == ferrocnc_config::Class::Input);
        if let Some(other) = twice.find(|one| one.key != "estop.input") {
            found.bad.push(machine.error(
                "estop.input",
                format!("{:?}", stop.input),
                format!("is also {}'s", other.key),
                "give the e-stop an input of its own",
            ));
        }
    }
}
