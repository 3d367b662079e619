//! What there is to try out: of the board's description, and of a machine's file if there is one.

use anyhow::{Context, Result, anyhow};
use ferrocnc::client::Identity;
use ferrocnc::replace::replace;
use ferrocnc::tryout::measured::{Change, Measured, number};
use ferrocnc::tryout::{Labelled, Layout, Motor, Tryout};
use ferrocnc_config::source::read_text;
use ferrocnc_machine::template::Slot;
use ferrocnc_machine::{CncMachine, read};
use std::path::{Path, PathBuf};
use wire::board::Kind;

/// Steps/s of a motor of which nothing is known: at 1600 steps a turn a little more than one turn.
const UNKNOWN_MOST: f64 = 2_000.0;
/// It is there in a quarter of a second.
const UNKNOWN_ACCEL: f64 = 8_000.0;
/// Seconds in which any motor is to stop: the board's watchdog gives it half a second.
const STOPS_IN: f64 = 0.4;
/// LinuxCNC's `generic` drive: slow enough for most of them.
const UNKNOWN_TIMING: [u32; 4] = [5_000, 5_000, 20_000, 20_000];

/// A machine's file.
pub(crate) struct File {
    path: PathBuf,
    machine: CncMachine,
}

impl File {
    pub(super) fn read(path: &Path) -> Result<Self> {
        let text = read_text(path)?;
        let machine =
            read(&path.display().to_string(), &text).map_err(|error| anyhow!("{error}"))?;
        Ok(File {
            path: path.to_owned(),
            machine,
        })
    }

    /// Takes the scale into the file; what was done, or why not, is said.
    pub(super) fn take(&mut self, found: &Measured, tryout: &mut Tryout) {
        let said = self.write(found, tryout);
        tryout.say(said.unwrap_or_else(|error| format!("{error:#}")));
    }

    fn write(&self, found: &Measured, tryout: &mut Tryout) -> Result<String> {
        let name = tryout.layout.motors[found.motor].line.name.clone();
        let shown = self.path.display();
        let mut axes = self.machine.axes.iter();
        let has = |axis: &&_| -> bool {
            let axis: &ferrocnc_machine::model::Axis = axis;
            axis.motors.iter().any(|motor| motor.name == name)
        };
        let axis = axes.position(|axis| has(&axis));
        let axis = axis.with_context(|| format!("{shown} has no motor {name}"))?;
        if found.is_reversed() {
            anyhow::bail!(
                "it turns the other way: write reversed = [\"{name}\"] into axis[{axis}] of {shown}, or take it out of there"
            );
        }
        let change = found.change().context("no scale to compare with")?;
        let (key, factor) = match change {
            Change::Microsteps(factor) => ("microsteps", factor),
            Change::Pitch(factor) => ("pitch", factor),
        };
        let slot = Slot {
            table: "[[axis]]",
            number: axis,
            key,
        };
        let text = read_text(&self.path)?;
        let old = slot.get(&text).and_then(|old| old.parse::<f64>().ok());
        let old = old.with_context(|| {
            format!("{shown} has no {key} of axis[{axis}] on a line of its own; make it {} times as much", number(factor))
        })?;
        let new = number(old * factor);
        replace(&self.path, slot.set(&text, &new).as_bytes(), 0o644)
            .with_context(|| format!("cannot write {shown}"))?;
        let of_axis: Vec<String> = { self.machine.axes[axis].motors.iter() }
            .map(|motor| motor.name.clone())
            .collect();
        for motor in &mut tryout.layout.motors {
            if of_axis.contains(&motor.line.name)
                && let Some(scale) = &mut motor.scale
            {
                *scale = found.scale.abs().copysign(*scale);
            }
        }
        Ok(format!(
            "{shown}: {key} = {new}, was {}; then ferrocnc machine write",
            number(old)
        ))
    }
}

/// The board's name.
pub(crate) fn name(identity: &Identity) -> String {
    let name = identity
        .blob()
        .text(Kind::Configuration, 0)
        .map(str::to_owned);
    name.unwrap_or_else(|| "a board".to_owned())
}

/// Names and pins of the board, and what the machine's file says of its motors.
pub(crate) fn layout(identity: &Identity, file: Option<&File>) -> Layout {
    let blob = identity.blob();
    let lines = |kind: Kind, letter: u8, keys: &[&str]| -> Vec<Labelled> {
        let line = |n: u8| {
            let pins = keys
                .iter()
                .filter_map(|key| identity.pin(letter, n.into(), key));
            Labelled {
                name: blob.text(kind, n).unwrap_or("").to_owned(),
                pins: pins.collect::<Vec<_>>().join(" "),
                bit: n,
            }
        };
        identity.numbers(kind).into_iter().map(line).collect()
    };
    let motors = lines(Kind::Stepgen, b's', &["step", "dir"]);
    let outputs = lines(Kind::Output, b'o', &["pin"]);
    let machine = file.map(|file| &file.machine);
    let enable = machine.and_then(|machine| machine.drive_enable.as_ref());
    let drive_enable = enable.and_then(|name| outputs.iter().position(|it| it.name == *name));
    Layout {
        inputs: lines(Kind::Input, b'i', &["pin"]),
        motors: motors
            .into_iter()
            .map(|line| motor(line, machine))
            .collect(),
        encoders: lines(Kind::Encoder, b'e', &["a", "b", "index"]),
        drive_enable,
        outputs,
        unit: machine
            .map_or("steps", |machine| machine.units.word())
            .to_owned(),
    }
}

fn motor(line: Labelled, machine: Option<&CncMachine>) -> Motor {
    let joints = machine.map(CncMachine::joints).unwrap_or_default();
    let joint = joints.iter().find(|joint| joint.motor.name == line.name);
    let Some(joint) = joint else {
        return Motor {
            line,
            scale: None,
            most: UNKNOWN_MOST,
            accel: UNKNOWN_ACCEL,
            timing: UNKNOWN_TIMING,
        };
    };
    let (axis, scale) = (joint.axis, joint.scale().0);
    let accel = axis.acceleration.0 * scale.abs();
    let timing = axis.timing;
    let timing = [
        timing.steplen,
        timing.stepspace,
        timing.dirsetup,
        timing.dirhold,
    ];
    Motor {
        line,
        scale: Some(scale),
        // Half of what the machine may.
        most: (axis.speed.0 * scale.abs() / 2.0).min(accel * STOPS_IN),
        accel,
        timing: timing.map(|ns| ns.0),
    }
}
