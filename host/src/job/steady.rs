//! A program executed at constant speed, without acceleration, as XYPenPlotter does: how long it
//! would take, and what the motors would have to do where a line ends.
//!
//! Every line and chord has its feed from its first step to its last, as far as no axis exceeds its
//! speed. What a motor would have to do is a jump of its velocity, within a step or not at all.

use crate::job::machine::MachineFile;
use crate::job::program::Program;
use jobs::circle::Chords;
use jobs::instruction::{Feed, Instruction, Place};
use motion::segment::AXES;

/// What it would be like.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Steady {
    /// How long it would take, tool and dwells included.
    pub seconds: f64,
    /// The largest jump of an axis' velocity, in mm/s.
    pub jump: f64,
    /// Jumps of an axis that its acceleration does not make within a step.
    pub impossible: u64,
    /// Of all of them, the acceleration that would, in multiples of the axis' own.
    pub times: f64,
}

struct Walk<'a> {
    machine: &'a MachineFile,
    at: Place,
    velocity: [f64; AXES],
    found: Steady,
}

/// Executes it.
pub fn steady(program: &Program, machine: &MachineFile) -> Steady {
    let mut walk = Walk {
        machine,
        at: [0; AXES],
        velocity: [0.0; AXES],
        found: Steady::default(),
    };
    let chord_tolerance = machine.setup().chord_tolerance;
    for (instruction, _) in &program.instructions {
        match *instruction {
            Instruction::Line { to, feed } => walk.line(to, feed),
            Instruction::Arc(arc) => {
                for to in Chords::new(walk.at, arc, chord_tolerance) {
                    walk.line(to, arc.feed);
                }
            }
            Instruction::Dwell { micros } => walk.rest(micros as f64 * 1e-6),
            Instruction::Aux { .. } => walk.rest(machine.tool_delay),
            Instruction::Home { axes } => {
                walk.rest(0.0);
                for (place, _) in walk.at.iter_mut().zip(axes).filter(|(_, homed)| *homed) {
                    *place = 0;
                }
            }
            Instruction::Pause | Instruction::End => walk.rest(0.0),
        }
    }
    walk.rest(0.0);
    walk.found
}

impl Walk<'_> {
    fn line(&mut self, to: Place, feed: Feed) {
        let way: [f64; AXES] =
            core::array::from_fn(|axis| (to[axis] - self.at[axis]) as f64 * 1e-6);
        self.at = to;
        let length = way.iter().map(|way| way * way).sum::<f64>().sqrt();
        if length == 0.0 {
            return;
        }
        let slowest = (way.iter().zip(self.machine.axes()))
            .map(|(way, axis)| axis.speed * length / way.abs())
            .fold(f64::INFINITY, f64::min);
        let speed = match feed {
            Feed::Rapid => slowest,
            Feed::Rate(rate) => slowest.min(f64::from(rate) * 1e-6),
        };
        self.found.seconds += length / speed;
        self.turn(way.map(|way| way / length * speed));
    }

    fn rest(&mut self, seconds: f64) {
        self.found.seconds += seconds;
        self.turn([0.0; AXES]);
    }

    /// From one velocity to the next, at once.
    fn turn(&mut self, velocity: [f64; AXES]) {
        let before = core::mem::replace(&mut self.velocity, velocity);
        for (axis, limits) in self.machine.axes().iter().enumerate() {
            let jump = (velocity[axis] - before[axis]).abs();
            // v^2 = 2 a s, with a step as the way.
            let needed = jump * jump * limits.steps_per_mm / 2.0;
            let times = needed / limits.acceleration;
            self.found.jump = self.found.jump.max(jump);
            self.found.times = self.found.times.max(times);
            self.found.impossible += u64::from(times > 1.0);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::job::program::Dialect;

    fn of(text: &str) -> Steady {
        let file = concat!(env!("CARGO_MANIFEST_DIR"), "/examples/plotter/machine.toml");
        let machine = MachineFile::read(file.as_ref()).unwrap();
        let program = Program::from_gcode(text.as_bytes(), Dialect::default().dwell);
        steady(&program.unwrap(), &machine)
    }

    #[test]
    fn a_square_takes_its_length_at_its_feed_and_its_corners_are_jumps() {
        // 100 mm/s, 2000 mm/s^2, 80 steps/mm: 100^2 * 80 / 2 / 2000.
        let square = of("G1 X10 F6000\nG1 Y10\nG1 X0\nG1 Y0\nM2\n");
        assert!((square.seconds - 0.4).abs() < 1e-9, "{square:?}");
        assert!((square.jump - 100.0).abs() < 1e-9, "{square:?}");
        assert!((square.times - 200.0).abs() < 1e-9, "{square:?}");
        // Off, at three corners both axes, and to rest.
        assert_eq!(square.impossible, 8);
    }

    #[test]
    fn a_straight_line_in_pieces_jumps_at_its_ends_only_and_a_rapid_is_as_fast_as_the_axes() {
        let line = of("G1 X10 F6000\nG1 X20\nG1 X30\nG0 X230\nM3\nG4 P1\nM2\n");
        // 30 mm at 100 mm/s, 200 mm at 200 mm/s, the tool, a second.
        assert!(
            (line.seconds - (0.3 + 1.0 + 0.15 + 1.0)).abs() < 1e-9,
            "{line:?}"
        );
        assert_eq!((line.impossible, line.jump), (3, 200.0));
    }

    #[test]
    fn a_reversal_jumps_by_twice_the_speed_and_what_an_axis_can_do_in_a_step_does_not_count() {
        assert_eq!(of("G1 X10 F6000\nG1 X0\nM2\n").jump, 200.0);
        // 7 mm/s within 12.5 um: 1960 mm/s^2.
        let slow = of("G1 X10 F420\nM2\n");
        assert_eq!(slow.impossible, 0, "{slow:?}");
    }
}
