//! Compares the pins of a board with the program: the clock of every step and of every change of
//! the tool, and the distance of the drawn path from the programmed one.
//!
//! It uses edges only: the position of an axis is the sum of its pulses, and the tool is down while
//! its output is high.

use host::job::machine::MachineFile;
use host::job::preview;
use host::job::program::Program;
use host::job::trace::{LOOK_AHEAD, Trace};
use jobs::circle::Chords;
use jobs::instruction::{AUX_TOOL, Instruction, Place};
use jobs::plan::{Output, Planner};
use motion::segment::{self, AXES, Segment};

/// Something at the pins.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pin {
    /// A pulse of an axis.
    Step {
        /// X, Y, Z.
        axis: usize,
        /// Towards plus.
        forward: bool,
    },
    /// The tool's output is high from now on, or low.
    Tool(bool),
}

/// When, in clocks, and what.
pub type Event = (u64, Pin);

/// The prediction of a job.
#[derive(Clone, Debug, Default)]
pub struct Prediction {
    /// Its segments, and the clocks in which they begin.
    pub segments: Vec<(u64, Segment)>,
    /// Every edge and every change of the tool; a change on its segment's first clock.
    pub events: Vec<Event>,
    /// How long it takes.
    pub clocks: u64,
    /// Where it ends, in steps.
    pub steps: [i64; AXES],
}

/// The planner's segments for a program, and every edge they will make. A program that homes or
/// pauses depends on inputs and has no prediction.
pub fn predict(program: &Program, machine: &MachineFile) -> Result<Prediction, String> {
    let mut planner =
        Planner::<LOOK_AHEAD>::new(&machine.setup()).map_err(|error| error.to_string())?;
    let mut told = Prediction::default();
    let mut instructions = (0..).zip(&program.instructions);
    let (mut state, mut tool) = (segment::MotionState::default(), false);
    loop {
        while planner.accepts() {
            let (tag, instruction) = match instructions.next() {
                Some((tag, (instruction, _))) => (tag, *instruction),
                None => (u32::MAX, Instruction::End),
            };
            if !planner.push(&instruction, tag) {
                return Err(format!("instruction {tag} is out of bounds"));
            }
            if instruction == Instruction::End {
                break;
            }
        }
        match planner.poll() {
            Some(Output::Segment(segment)) => {
                told.play(&mut state, &segment, &mut tool);
            }
            Some(Output::End) => break,
            Some(Output::Home(_) | Output::Pause) => {
                return Err("a program that homes or pauses cannot be predicted".to_owned());
            }
            None => {}
        }
    }
    told.steps = state.steps();
    told.events.sort_by_key(|(clock, _)| *clock);
    Ok(told)
}

impl Prediction {
    fn play(&mut self, state: &mut segment::MotionState, segment: &Segment, tool: &mut bool) {
        let begin = self.clocks;
        self.segments.push((begin, *segment));
        let down = segment.aux & AUX_TOOL != 0;
        if std::mem::replace(tool, down) != down {
            self.events.push((begin, Pin::Tool(down)));
        }
        for axis in 0..AXES {
            let edges = segment.play(axis).edges(state.axes[axis]);
            self.events.extend(edges.map(|edge| {
                let forward = edge.forward;
                (begin + u64::from(edge.clock), Pin::Step { axis, forward })
            }));
        }
        state.run(segment);
        self.clocks += u64::from(segment.clocks);
    }

    /// Compares emitted events with it. Both are counted from their first step.
    pub fn compare(&self, emitted: &[Event]) -> Difference {
        let steps = |events: &[Event]| -> [Vec<(u64, bool)>; AXES] {
            let mut steps: [Vec<(u64, bool)>; AXES] = Default::default();
            for (clock, pin) in events {
                if let Pin::Step { axis, forward } = *pin {
                    steps[axis].push((*clock, forward));
                }
            }
            steps
        };
        let first = |events: &[Event]| {
            let step = events
                .iter()
                .find(|(_, pin)| matches!(pin, Pin::Step { .. }));
            step.map_or(0, |(clock, _)| *clock)
        };
        let (ours, theirs) = (first(&self.events), first(emitted));
        let mut difference = Difference::default();
        for (ours_at, theirs_at) in steps(&self.events).iter().zip(&steps(emitted)) {
            difference.edges += ours_at.len() as u64;
            let same = ours_at
                .iter()
                .zip(theirs_at)
                .filter(|(a, b)| (a.0.wrapping_sub(ours), a.1) == (b.0.wrapping_sub(theirs), b.1));
            let same = same.count();
            difference.wrong += (ours_at.len().max(theirs_at.len()) - same) as u64;
        }
        let tools = |events: &[Event]| -> Vec<Event> {
            let tools = events.iter().filter(|(_, pin)| matches!(pin, Pin::Tool(_)));
            tools.copied().collect()
        };
        let (mine, seen) = (tools(&self.events), tools(emitted));
        difference.switches = seen.len() as u64;
        let alike = mine.len() == seen.len() && mine.iter().zip(&seen).all(|(a, b)| a.1 == b.1);
        difference.late = alike.then(|| {
            let late = mine.iter().zip(&seen);
            let late = late.map(|(a, b)| (b.0 as i64 - theirs as i64) - (a.0 as i64 - ours as i64));
            late.max_by_key(|clocks| clocks.abs()).unwrap_or(0)
        });
        difference
    }
}

/// Between a prediction and the pins.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Difference {
    /// Edges predicted.
    pub edges: u64,
    /// Of them and of those emitted: how many are not in the same clock, or not there.
    pub wrong: u64,
    /// Changes of the tool's output.
    pub switches: u64,
    /// By how many clocks a change is off its segment's first at most; `None`: there are more or
    /// fewer than predicted.
    pub late: Option<i64>,
}

/// What the pins drew.
#[derive(Clone, Debug)]
pub struct Drawn {
    /// The path, in mm.
    pub trace: Trace,
    /// The farthest any point drawn is from the path it should be on, in mm.
    pub deviation: f64,
    /// The farthest any point of the program is from what was drawn, in mm: nothing was left out.
    pub missing: f64,
    /// Where the axes ended, in steps.
    pub steps: [i64; AXES],
}

/// Rebuilds the path from events, and measures it against a program (the one played, or a finer one
/// of the same drawing). The axes began at 0 with the tool up.
pub fn drawn(program: &Program, machine: &MachineFile, emitted: &[Event]) -> Result<Drawn, String> {
    let wanted = wanted(program, machine);
    let mut pins = Walk::new(machine);
    for (_, pin) in emitted {
        pins.see(*pin);
    }
    let strokes: Vec<&Vec<Point>> = pins
        .drawn
        .iter()
        .filter(|stroke| stroke.len() > 1)
        .collect();
    if strokes.len() != wanted.len() {
        return Err(format!(
            "the pins drew {} strokes, the program has {}",
            strokes.len(),
            wanted.len()
        ));
    }
    let (mut deviation, mut missing): (f64, f64) = (0.0, 0.0);
    for (stroke, wanted) in strokes.iter().zip(&wanted) {
        deviation = deviation.max(farthest(stroke, wanted));
        missing = missing.max(farthest(wanted, stroke));
    }
    Ok(Drawn {
        deviation,
        missing,
        steps: pins.steps,
        trace: pins.trace,
    })
}

type Point = [f64; 2];

/// The strokes of a program, arcs as chords much finer than a step.
fn wanted(program: &Program, machine: &MachineFile) -> Vec<Vec<Point>> {
    let (mut strokes, mut at, mut tool) = (Vec::new(), [0; AXES], false);
    let finest = (machine.setup().chord_tolerance / 10).max(100);
    let point = |place: Place| [place[0] as f64 * 1e-6, place[1] as f64 * 1e-6];
    for (instruction, _) in &program.instructions {
        let places: Vec<Place> = match *instruction {
            Instruction::Line { to, .. } => vec![to],
            Instruction::Arc(arc) => Chords::new(at, arc, finest).collect(),
            Instruction::Aux { bits } => {
                if std::mem::replace(&mut tool, bits & AUX_TOOL != 0) != tool && tool {
                    strokes.push(vec![point(at)]);
                }
                continue;
            }
            Instruction::Home { axes } => {
                vec![core::array::from_fn(
                    |axis| if axes[axis] { 0 } else { at[axis] },
                )]
            }
            Instruction::Dwell { .. } | Instruction::Pause | Instruction::End => continue,
        };
        if let Some(stroke) = strokes.last_mut().filter(|_| tool) {
            stroke.extend(places.iter().map(|place| point(*place)));
        }
        at = places.last().copied().unwrap_or(at);
    }
    strokes.retain(|stroke: &Vec<Point>| stroke.len() > 1);
    strokes
}

/// Of any of these points, how far to the nearest place on the line through `path`.
fn farthest(points: &[Point], path: &[Point]) -> f64 {
    // What a point is near to is mostly near to what the point before was near to.
    let (mut worst, mut hint): (f64, usize) = (0.0, 0);
    let lines = path.len() - 1;
    for point in points {
        let (mut best, mut at) = (f64::MAX, hint);
        for away in 0..lines {
            // Searches outwards from the hint, until the distance is below the worst one so far.
            for line in [hint.checked_sub(away), Some(hint + away)]
                .into_iter()
                .flatten()
            {
                if line >= lines {
                    continue;
                }
                let distance = distance(*point, path[line], path[line + 1]);
                if distance < best {
                    (best, at) = (distance, line);
                }
            }
            if best <= worst {
                break;
            }
        }
        hint = at;
        worst = worst.max(best);
    }
    worst
}

fn distance(point: Point, from: Point, to: Point) -> f64 {
    let along = [to[0] - from[0], to[1] - from[1]];
    let length = along[0] * along[0] + along[1] * along[1];
    let part = match length > 0.0 {
        true => {
            let dot = (point[0] - from[0]) * along[0] + (point[1] - from[1]) * along[1];
            (dot / length).clamp(0.0, 1.0)
        }
        false => 0.0,
    };
    (point[0] - from[0] - along[0] * part).hypot(point[1] - from[1] - along[1] * part)
}

/// Follows the pins.
struct Walk {
    pitch: [f64; AXES],
    steps: [i64; AXES],
    tool: bool,
    /// Each of the ways with the tool down.
    drawn: Vec<Vec<Point>>,
    trace: Trace,
}

impl Walk {
    fn new(machine: &MachineFile) -> Walk {
        Walk {
            pitch: machine.axes().map(|axis| 1.0 / axis.steps_per_mm),
            steps: [0; AXES],
            tool: false,
            drawn: Vec::new(),
            trace: Trace::default(),
        }
    }

    fn place(&self) -> Point {
        [0, 1].map(|axis| self.steps[axis] as f64 * self.pitch[axis])
    }

    fn see(&mut self, pin: Pin) {
        match pin {
            Pin::Step { axis, forward } => {
                self.steps[axis] += if forward { 1 } else { -1 };
            }
            Pin::Tool(down) => {
                self.tool = down;
                if down {
                    self.drawn.push(Vec::new());
                }
            }
        }
        let [x, y] = self.place();
        self.trace.go(!self.tool, [x, y, 0.0]);
        if let Some(way) = self.drawn.last_mut().filter(|_| self.tool) {
            way.push([x, y]);
        }
    }
}

/// What the pins drew over the drawing it was made from: an SVG `height` mm high, as it lies on the
/// page when nothing scales it.
pub fn over(name: &str, drawing: &str, height: f64, drawn: &Drawn) -> String {
    let below = drawing.find("<svg").map_or(drawing, |at| &drawing[at..]);
    // 96 pixels are an inch: that is what its millimetres become inside of another.
    let below = format!(
        r#"<g transform="translate(0 {:.3}) scale({:.6})" opacity="0.45">{below}</g>"#,
        -height,
        25.4 / 96.0
    );
    preview::svg_over(name, &drawn.trace, &below)
}

#[cfg(test)]
mod tests {
    use super::*;
    use jobs::gcode::DwellUnit;

    fn machine() -> MachineFile {
        MachineFile::parse(include_str!("../../host/examples/plotter/machine.toml")).unwrap()
    }

    fn program(text: &str) -> Program {
        Program::from_gcode(text.as_bytes(), DwellUnit::Seconds).unwrap()
    }

    const CIRCLE: &str = "G0 X10 Y10\nM3\nG2 I5 F3000\nM5\nG0 X0 Y0\nM2\n";

    #[test]
    fn pins_that_do_as_predicted_draw_the_program() {
        let (machine, program) = (machine(), program(CIRCLE));
        let told = predict(&program, &machine).unwrap();
        let difference = told.compare(&told.events);
        assert_eq!(
            (difference.wrong, difference.switches, difference.late),
            (0, 2, Some(0))
        );
        assert!(difference.edges > 2000);
        let drawn = drawn(&program, &machine, &told.events).unwrap();
        assert!(drawn.deviation <= 0.01 + 0.0125, "{}", drawn.deviation);
        assert!(drawn.missing <= 0.01 + 0.0125, "{}", drawn.missing);
        assert!(
            (drawn.trace.drawn - 10.0 * std::f64::consts::PI * 4.0 / std::f64::consts::PI).abs()
                < 1.0
        );
        assert_eq!((drawn.steps, told.steps), ([0; 3], [0; 3]));
    }

    #[test]
    fn a_step_a_clock_late_one_missing_and_a_late_pen_are_seen() {
        let (machine, program) = (machine(), program(CIRCLE));
        let told = predict(&program, &machine).unwrap();
        let mut late = told.events.clone();
        late[700].0 += 1;
        assert_eq!(told.compare(&late).wrong, 1);
        let mut short = told.events.clone();
        let last = short
            .iter()
            .rposition(|(_, pin)| matches!(pin, Pin::Step { .. }));
        short.remove(last.unwrap());
        assert_eq!(told.compare(&short).wrong, 1);
        let mut pen = told.events.clone();
        let down = pen.iter_mut().find(|(_, pin)| *pin == Pin::Tool(true));
        down.unwrap().0 += 3;
        assert_eq!(told.compare(&pen).late, Some(3));
        let without: Vec<Event> = told
            .events
            .iter()
            .copied()
            .filter(|(_, pin)| *pin != Pin::Tool(false))
            .collect();
        assert_eq!(told.compare(&without).late, None);
    }

    #[test]
    fn half_a_circle_is_not_a_circle() {
        let machine = machine();
        let half = predict(
            &program("G0 X10 Y10\nM3\nG2 X20 I5 F3000\nM5\nM2\n"),
            &machine,
        )
        .unwrap();
        let drawn = drawn(&program(CIRCLE), &machine, &half.events).unwrap();
        assert!(drawn.missing > 4.0 && drawn.deviation < 0.0225, "{drawn:?}");
    }
}
