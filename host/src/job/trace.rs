//! A simulated execution of a program: by its geometry alone, or by the planner and the integer
//! model of the board.

use crate::job::machine::MachineFile;
use crate::job::program::Program;
use crate::job::steady::{Steady, steady};
use jobs::circle::Chords;
use jobs::instruction::{AUX_TOOL, Arc, Feed, Instruction, Place};
use jobs::plan::{Output, Planner};
use motion::segment::{self, AXES, Segment};

/// Lines the board looks ahead, and so does this.
pub const LOOK_AHEAD: usize = 32;

/// Chords of arcs, when no machine says how fine.
const TOLERANCE: u32 = 10_000;

/// Part of the path, in mm.
#[derive(Clone, Debug, PartialEq)]
pub struct Stroke {
    /// Without the tool.
    pub travel: bool,
    /// X, Y, Z.
    pub points: Vec<[f64; AXES]>,
}

/// What a program does.
#[derive(Clone, Debug, Default)]
pub struct Trace {
    /// The path.
    pub strokes: Vec<Stroke>,
    /// Smallest and largest X, Y, Z of it, in mm.
    pub extents: [[f64; AXES]; 2],
    /// mm with and without the tool.
    pub drawn: f64,
    /// mm with and without the tool.
    pub travelled: f64,
    /// What the planner adds, if there is a machine.
    pub planned: Option<Planned>,
}

/// What the planner made of it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Planned {
    /// How long it takes, without homing and waiting for the operator.
    pub seconds: f64,
    /// Segments.
    pub segments: u64,
    /// The most segments in a second.
    pub densest: u64,
    /// The farthest the path is from what was programmed, in mm.
    pub deviation: f64,
    /// Where it ends, in steps.
    pub steps: [i64; AXES],
    /// What it would be without acceleration.
    pub steady: Steady,
}

fn mm(place: Place) -> [f64; AXES] {
    place.map(|nm| nm as f64 * 1e-6)
}

fn apart(a: [f64; AXES], b: [f64; AXES]) -> f64 {
    a.iter()
        .zip(b)
        .map(|(a, b)| (a - b).powi(2))
        .sum::<f64>()
        .sqrt()
}

impl Trace {
    /// Draws on from where it ended, or travels.
    pub fn go(&mut self, travel: bool, to: [f64; AXES]) {
        let from = self
            .strokes
            .last()
            .and_then(|stroke| stroke.points.last().copied());
        let from = from.unwrap_or_default();
        *(if travel {
            &mut self.travelled
        } else {
            &mut self.drawn
        }) += apart(from, to);
        for (axis, value) in to.iter().enumerate() {
            self.extents[0][axis] = self.extents[0][axis].min(*value);
            self.extents[1][axis] = self.extents[1][axis].max(*value);
        }
        match self.strokes.last_mut() {
            Some(stroke) if stroke.travel == travel => stroke.points.push(to),
            Some(_) | None => self.strokes.push(Stroke {
                travel,
                points: vec![from, to],
            }),
        }
    }
}

/// Whether an instruction only travels: a rapid, or any motion without the tool in a program that
/// switches it.
struct Travels {
    switches: bool,
    tool: bool,
}

impl Travels {
    fn new(program: &Program) -> Self {
        let switches = |instruction: &Instruction| matches!(instruction, Instruction::Aux { bits } if bits & AUX_TOOL != 0);
        Travels {
            switches: program
                .instructions
                .iter()
                .any(|(instruction, _)| switches(instruction)),
            tool: false,
        }
    }

    fn is(&mut self, instruction: &Instruction) -> bool {
        let feed = match *instruction {
            Instruction::Line { feed, .. } => feed,
            Instruction::Arc(arc) => arc.feed,
            Instruction::Aux { bits } => {
                self.tool = bits & AUX_TOOL != 0;
                return true;
            }
            Instruction::Dwell { .. }
            | Instruction::Home { .. }
            | Instruction::Pause
            | Instruction::End => return true,
        };
        feed == Feed::Rapid || (self.switches && !self.tool)
    }
}

/// The path as it is programmed.
pub fn programmed(program: &Program) -> Trace {
    let (mut trace, mut at, mut travels) = (Trace::default(), [0; AXES], Travels::new(program));
    for (instruction, _) in &program.instructions {
        let travel = travels.is(instruction);
        match *instruction {
            Instruction::Line { to, .. } => {
                trace.go(travel, mm(to));
                at = to;
            }
            Instruction::Arc(arc) => {
                for place in Chords::new(at, arc, TOLERANCE) {
                    trace.go(travel, mm(place));
                }
                at = arc.to;
            }
            Instruction::Home { axes } => {
                for (nm, _) in at.iter_mut().zip(axes).filter(|(_, homed)| *homed) {
                    *nm = 0;
                }
                trace.go(true, mm(at));
            }
            Instruction::Dwell { .. }
            | Instruction::Aux { .. }
            | Instruction::Pause
            | Instruction::End => {}
        }
    }
    trace
}

/// The path as the integrators of the board will draw it.
pub fn planned(program: &Program, machine: &MachineFile) -> Result<Trace, String> {
    let setup = machine.setup();
    let mut planner = Planner::<LOOK_AHEAD>::new(&setup).map_err(|error| error.to_string())?;
    let mut travels = Travels::new(program);
    let shapes = Shapes::new(program, &mut travels);
    let mut walk = Walk {
        machine,
        trace: Trace::default(),
        planned: Planned::default(),
        clocks: 0,
        second: 0,
        in_second: 0,
    };
    let mut instructions = (0..).zip(
        program
            .instructions
            .iter()
            .map(|(instruction, _)| *instruction),
    );
    let mut ended = false;
    while !ended {
        while planner.accepts() {
            let (index, instruction) = instructions.next().unwrap_or((u32::MAX, Instruction::End));
            if !planner.push(&instruction, index) {
                return Err(format!("instruction {index} is out of bounds"));
            }
            if instruction == Instruction::End {
                break;
            }
        }
        let before = *planner.machine();
        match planner.poll() {
            Some(Output::Segment(segment)) => {
                walk.segment(&before, &segment, planner.tag(), &shapes)
            }
            Some(Output::End) => ended = true,
            Some(Output::Home(_) | Output::Pause) | None => {}
        }
    }
    walk.planned.steps = planner.machine().steps();
    walk.planned.seconds = walk.clocks as f64 / f64::from(machine.clock);
    walk.planned.steady = steady(program, machine);
    walk.trace.planned = Some(walk.planned);
    Ok(walk.trace)
}

struct Walk<'a> {
    machine: &'a MachineFile,
    trace: Trace,
    planned: Planned,
    clocks: u64,
    second: u64,
    in_second: u64,
}

impl Walk<'_> {
    fn segment(
        &mut self,
        before: &segment::MotionState,
        segment: &Segment,
        tag: u32,
        shapes: &Shapes,
    ) {
        self.planned.segments += 1;
        let second = self.clocks / u64::from(self.machine.clock);
        self.in_second = if second == self.second {
            self.in_second + 1
        } else {
            1
        };
        self.second = second;
        self.planned.densest = self.planned.densest.max(self.in_second);
        self.clocks += u64::from(segment.clocks);
        if before.rests() && segment.velocity == [0; AXES] {
            return;
        }
        for part in 1..=4u64 {
            let clocks = (u64::from(segment.clocks) * part / 4) as u32;
            let state = before.within(segment, clocks);
            let place = self.place(&state);
            self.planned.deviation = self
                .planned
                .deviation
                .max(shapes.distance(tag as usize, place));
            self.trace.go(shapes.travels(tag as usize), place);
        }
    }

    /// In mm.
    fn place(&self, state: &segment::MotionState) -> [f64; AXES] {
        let axes = self.machine.axes();
        core::array::from_fn(|axis| {
            wire::units::Position(state.axes[axis].position).steps() / axes[axis].steps_per_mm
        })
    }
}

/// What was programmed, to measure distances to.
struct Shapes(Vec<Shape>);

struct Shape {
    from: [f64; AXES],
    to: [f64; AXES],
    arc: Option<Arc>,
    travel: bool,
    moves: bool,
}

impl Shapes {
    fn new(program: &Program, travels: &mut Travels) -> Shapes {
        let mut at = [0; AXES];
        let shape = |(instruction, _): &(Instruction, u32)| {
            let travel = travels.is(instruction);
            let (to, arc, moves) = match *instruction {
                Instruction::Line { to, .. } => (to, None, true),
                Instruction::Arc(arc) => (arc.to, Some(arc), true),
                Instruction::Home { axes } => (
                    core::array::from_fn(|axis| if axes[axis] { 0 } else { at[axis] }),
                    None,
                    false,
                ),
                Instruction::Dwell { .. }
                | Instruction::Aux { .. }
                | Instruction::Pause
                | Instruction::End => (at, None, false),
            };
            let from = std::mem::replace(&mut at, to);
            Shape {
                from: mm(from),
                to: mm(to),
                arc,
                travel,
                moves,
            }
        };
        Shapes(program.instructions.iter().map(shape).collect())
    }

    fn travels(&self, index: usize) -> bool {
        self.0.get(index).is_none_or(|shape| shape.travel)
    }

    /// To the instruction being executed or one near it: corners are rounded, and lines of less
    /// than half a step share one.
    fn distance(&self, index: usize, place: [f64; AXES]) -> f64 {
        let end = self.0.len().min(index.saturating_add(9));
        let near = &self.0[index.saturating_sub(8).min(end)..end];
        let moving = near.iter().filter(|shape| shape.moves);
        let nearest = moving
            .map(|shape| shape.distance(place))
            .fold(f64::MAX, f64::min);
        if nearest == f64::MAX { 0.0 } else { nearest }
    }
}

impl Shape {
    fn distance(&self, place: [f64; AXES]) -> f64 {
        if let Some(arc) = self.arc {
            let [x, y] = [0, 1].map(|axis| arc.center[axis] as f64 * 1e-6);
            let radius = (self.from[0] - x).hypot(self.from[1] - y);
            return ((place[0] - x).hypot(place[1] - y) - radius).abs();
        }
        let sub = |a: [f64; AXES], b: [f64; AXES]| [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
        let dot = |a: [f64; AXES], b: [f64; AXES]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
        let along = sub(self.to, self.from);
        let length = dot(along, along);
        let part = if length == 0.0 {
            0.0
        } else {
            (dot(sub(place, self.from), along) / length).clamp(0.0, 1.0)
        };
        apart(
            place,
            [0, 1, 2].map(|axis| self.from[axis] + along[axis] * part),
        )
    }
}

/// What a machine cannot do of a program.
pub fn out_of_bounds(program: &Program, machine: &MachineFile) -> Vec<String> {
    let mut wrong = Vec::new();
    let mut at = [0; AXES];
    for (instruction, line) in &program.instructions {
        let places: Vec<Place> = match *instruction {
            Instruction::Line { to, .. } => vec![to],
            Instruction::Arc(arc) => {
                Chords::new(at, arc, machine.setup().chord_tolerance).collect()
            }
            Instruction::Home { axes } => {
                vec![core::array::from_fn(
                    |axis| if axes[axis] { 0 } else { at[axis] },
                )]
            }
            Instruction::Dwell { .. }
            | Instruction::Aux { .. }
            | Instruction::Pause
            | Instruction::End => continue,
        };
        for (axis, name) in ["X", "Y", "Z"].iter().enumerate() {
            let outside = places
                .iter()
                .map(|place| mm(*place)[axis])
                .filter(|mm| machine.outside(axis, *mm));
            let worst = outside.reduce(|worst, mm| {
                let limits = machine.axes()[axis];
                let beyond = |mm: f64| (limits.min - mm).max(mm - limits.max);
                if beyond(mm) > beyond(worst) {
                    mm
                } else {
                    worst
                }
            });
            if let Some(mm) = worst {
                let limits = machine.axes()[axis];
                wrong.push(format!(
                    "line {line}: {name} {mm:.3} is not within {} .. {} mm",
                    limits.min, limits.max
                ));
            }
        }
        at = places.last().copied().unwrap_or(at);
    }
    wrong
}
