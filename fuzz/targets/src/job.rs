//! Programs: read to their end or refused with a place, and what was read is motion the machine can make.

use crate::tape::Tape;
use motion::gcode::{DwellUnit, Options, Reader};
use motion::instruction::{FARTHEST, Feed, Instruction, Place};
use motion::plan::{AxisSetup, Output, Planner, Setup};
use motion::segment::{AXES, MAX_CLOCKS, MIN_CLOCKS};

/// A circle of ten metres has more chords than a fuzzer has time.
const OUTPUTS: u32 = 20_000;
/// As many lines as the board looks ahead.
const DEPTH: usize = 16;

/// A plotter's: 80 steps/mm, 100 mm/s, 1 m/s^2 in the plane, slower in Z.
const PLOTTER: Setup = Setup {
    clock_hz: 60_000_000,
    axes: [
        AxisSetup {
            steps_per_km: 80_000_000,
            max_speed: 100_000_000,
            max_accel: 1_000_000_000,
        },
        AxisSetup {
            steps_per_km: 80_000_000,
            max_speed: 100_000_000,
            max_accel: 1_000_000_000,
        },
        AxisSetup {
            steps_per_km: 400_000_000,
            max_speed: 10_000_000,
            max_accel: 200_000_000,
        },
    ],
    chord_tolerance: 5_000,
    junction_deviation: 20_000,
    aux_settle: 1_000,
};

/// G-code: what a line asks for, and the segments that come of it.
pub fn gcode(data: &[u8]) {
    let mut tape = Tape(data);
    let [mode, percent] = tape.array();
    let dwell = match mode & 1 {
        0 => DwellUnit::Seconds,
        _ => DwellUnit::Milliseconds,
    };
    let mut reader = Reader::new(Options { dwell });
    let setup = Setup {
        junction_deviation: if mode & 2 == 0 {
            PLOTTER.junction_deviation
        } else {
            0
        },
        ..PLOTTER
    };
    let mut bench = Bench {
        planner: Planner::new(&setup).expect("a plotter"),
        outputs: 0,
    };
    if mode & 4 != 0 {
        bench.planner.set_override(percent.into());
    }
    for byte in tape.0.iter().copied().map(Some).chain([None]) {
        let lines = reader.line_number();
        let ended = reader.ended();
        let read = match byte {
            Some(byte) => reader.byte(byte),
            None => reader.finish(),
        };
        let instructions = match read {
            Ok(instructions) => instructions,
            Err(error) => {
                assert!(error.line == lines + 1 && error.column >= 1, "{error:?}");
                assert!(!error.to_string().is_empty());
                // Nobody begins a program that is refused.
                return;
            }
        };
        for instruction in instructions {
            assert!(!ended, "{instruction:?} behind the end");
            possible(&instruction);
            bench.execute(&instruction, reader.line_number());
            if bench.outputs >= OUTPUTS {
                return;
            }
        }
    }
    bench.execute(&Instruction::End, reader.line_number());
}

/// An instruction a machine can be asked for.
fn possible(instruction: &Instruction) {
    let near = |place: &Place| place.iter().all(|nm| nm.abs() <= FARTHEST);
    let (to, feed) = match instruction {
        Instruction::Line { to, feed } => (to, feed),
        Instruction::Arc(arc) => (&arc.to, &arc.feed),
        Instruction::Dwell { .. }
        | Instruction::Aux { .. }
        | Instruction::Home { .. }
        | Instruction::Pause
        | Instruction::End => return,
    };
    assert!(near(to), "{instruction:?} is too far");
    assert!(*feed != Feed::Rate(0), "{instruction:?} never comes there");
}

struct Bench {
    planner: Planner<DEPTH>,
    outputs: u32,
}

impl Bench {
    fn execute(&mut self, instruction: &Instruction, line: u32) {
        while !self.planner.accepts() {
            if !self.output() {
                return;
            }
        }
        assert!(
            self.planner.push(instruction, line),
            "read and not taken: {instruction:?}"
        );
        while self.output() {}
    }

    /// What comes next; false when nothing does.
    fn output(&mut self) -> bool {
        if self.outputs >= OUTPUTS {
            return false;
        }
        self.outputs += 1;
        let aux = self.planner.machine().aux;
        let Some(output) = self.planner.poll() else {
            return false;
        };
        match output {
            Output::Segment(segment) => {
                assert!(segment.clocks >= MIN_CLOCKS, "{segment:?}");
                let still = segment.accel == [0; AXES];
                assert!(still || segment.clocks <= MAX_CLOCKS, "{segment:?}");
                for (accel, limit) in segment.accel.iter().zip(self.planner.limits()) {
                    assert!(*accel <= limit, "{segment:?}, {limit}");
                }
                let rests = self.planner.machine().rests();
                assert!(
                    aux == segment.aux || rests,
                    "outputs changed in motion: {segment:?}"
                );
            }
            Output::Home(_) | Output::Pause | Output::End => {
                assert!(self.planner.machine().rests(), "{output:?} in motion");
                if !matches!(output, Output::Home(_)) {
                    self.arrived();
                }
            }
        }
        true
    }

    /// At rest the machine is where the program says, to the step.
    fn arrived(&self) {
        let (steps, target) = (self.planner.machine().steps(), self.planner.target());
        for (axis, (steps, nm)) in steps.into_iter().zip(target).enumerate() {
            let per_km = i128::from(PLOTTER.axes[axis].steps_per_km);
            // Twice the distance to the target, in 10^-12 of a step.
            let off = 2 * (i128::from(nm) * per_km - i128::from(steps) * 1_000_000_000_000);
            assert!(
                off.abs() <= 1_000_000_000_000 + 1_000_000,
                "axis {axis} at step {steps} is not at {nm} nm"
            );
        }
    }
}
