//! Random machines that are stopped in the middle of a job, and the allowed behaviour of their
//! pins.
//!
//! What leaves the pins is held against the prediction of the whole job. As far as the two agree
//! nothing has stopped; from there on each axis has the way that its own acceleration takes from
//! the speed the prediction says it had.

use crate::drawing;
use crate::pins::{self, Event, Pin, Prediction};
use host::job::machine::MachineFile;
use host::job::program::{Dialect, Program};
use motion::segment::AXES;
use rand::Rng;
use rand_pcg::Pcg32;
pub use sim::figures::Used;
use std::ops::Range;

/// Steps: the fraction at each end, and a step's error in a speed that is read from the time
/// between two of them.
pub const STEPS: f64 = 4.0;

/// What a machine may be like.
#[derive(Clone, Debug)]
pub struct Shape {
    /// Seconds that its slowest axis takes to stop.
    pub takes: Range<f64>,
    /// steps/s.
    pub speed: Range<f64>,
    /// Seconds that it goes on at full speed.
    pub lasts: f64,
}

/// A job on a machine of its own: one line to the corner of its limits.
#[derive(Clone, Debug)]
pub struct Job {
    /// The machine.
    pub machine: MachineFile,
    /// Of each axis: steps/s, and steps/s^2.
    pub axes: [(f64, f64); AXES],
    /// The line.
    pub program: Program,
    /// What it does when nothing stops it.
    pub told: Prediction,
}

/// How a stop is made.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Way {
    /// Each axis brakes as configured.
    Own,
    /// All of them keep to the path, with a quarter more than its own acceleration for the axis
    /// that can bear the least.
    Path,
    /// Pulses end.
    Cut,
}

/// Any magnitude between these is as likely as any other.
fn magnitude(random: &mut Pcg32, range: &Range<f64>) -> f64 {
    10f64.powf(random.random_range(range.start.log10()..range.end.log10()))
}

impl Job {
    /// Any of this shape.
    pub fn any(random: &mut Pcg32, shape: &Shape) -> Self {
        let mut machine = drawing::machine();
        let takes = magnitude(random, &shape.takes);
        let mut text = String::from("G0");
        let mut axes = [(0.0, 0.0); AXES];
        let places = [&mut machine.x, &mut machine.y, &mut machine.z];
        for (n, place) in places.into_iter().enumerate() {
            let speed = magnitude(random, &shape.speed);
            let accel = speed / (takes * random.random_range(0.3..1.0));
            let per_mm = magnitude(random, &((speed / 4000.0).max(20.0)..2000.0));
            let seconds = takes * random.random_range(1.1..1.6) + shape.lasts;
            let sign = if random.random_bool(0.5) { 1.0 } else { -1.0 };
            let way = sign * (speed * seconds + 5.0) / per_mm;
            // As it is written.
            let way = (way * 1e6).round() / 1e6;
            text += &format!(" {}{way:.6}", ["X", "Y", "Z"][n]);
            place.steps_per_mm = per_mm;
            (place.speed, place.acceleration) = (speed / per_mm, accel / per_mm);
            (place.min, place.max) = (way.min(0.0), way.max(0.0));
            place.home = None;
            axes[n] = (speed, accel);
        }
        text += "\nM2\n";
        let program = Program::from_gcode(text.as_bytes(), Dialect::default().dwell);
        let mut program = program.unwrap_or_else(|error| panic!("{text}: {error}"));
        program.name = "any".to_owned();
        let told = pins::predict(&program, &machine);
        let told = told.unwrap_or_else(|error| panic!("{text}: {error}"));
        Job {
            machine,
            axes,
            program,
            told,
        }
    }

    /// Seconds from full speed to rest on the path.
    fn path_takes(&self) -> f64 {
        let longest = self.axes.iter().fold(0.0f64, |t, (v, a)| t.max(v / a));
        4.0 * longest
    }

    /// From where the pins leave the prediction no axis goes further than this way of stopping
    /// takes, nor a step beyond the machine's limits. What the worst of them has used of that.
    pub fn stands_within(&self, emitted: &[Event], way: Way, told: &str) -> f64 {
        let (expected, emitted) = (steps(&self.told.events), steps(emitted));
        let pairs = expected.iter().zip(&emitted);
        let same = pairs.take_while(|(a, b)| a == b).count();
        let since = same.checked_sub(1).map_or(0, |last| emitted[last].0);
        let mut used = 0.0f64;
        for (n, (_, accel)) in self.axes.iter().enumerate() {
            let hz = f64::from(self.machine.clock);
            let path = self.path_takes();
            let allowed = match way {
                Way::Cut => 0.0,
                Way::Own => self.speed(n, &expected, since, 0).powi(2) / (2.0 * accel),
                // Half of the time passes on the path.
                Way::Path => self.speed(n, &expected, since, (path / 2.0 * hz) as u64) * path / 2.0,
            };
            let made = emitted[same..].iter().filter(|step| step.1 == n).count() as f64;
            let most = allowed * 1.001 + STEPS;
            assert!(
                made <= most,
                "{told}: axis {n} made {made} steps from {since} clocks on, {most} are allowed"
            );
            used = used.max(made / most);
        }
        self.holds(&emitted, told);
        used
    }

    /// steps/s, the most that an axis has from this clock on for so many clocks of the prediction.
    fn speed(&self, axis: usize, expected: &[Edge], since: u64, clocks: u64) -> f64 {
        let own = expected.iter().filter(|step| step.1 == axis);
        let own: Vec<u64> = own.map(|step| step.0).collect();
        let first = own.partition_point(|clock| *clock <= since);
        let last = own.partition_point(|clock| *clock <= since + clocks);
        let near = &own[first.saturating_sub(2)..(last + 1).min(own.len())];
        let shortest = near.windows(2).map(|pair| pair[1] - pair[0]).min();
        shortest.map_or(0.0, |clocks| {
            f64::from(self.machine.clock) / clocks.max(1) as f64
        })
    }

    fn holds(&self, emitted: &[Edge], told: &str) {
        let mut at = [0i64; AXES];
        let (mut low, mut high) = (at, at);
        for (_, axis, forward) in emitted {
            at[*axis] += if *forward { 1 } else { -1 };
            low[*axis] = low[*axis].min(at[*axis]);
            high[*axis] = high[*axis].max(at[*axis]);
        }
        for (n, axis) in self.machine.axes().into_iter().enumerate() {
            let bounds = [axis.min, axis.max].map(|mm| mm * axis.steps_per_mm);
            assert!(
                low[n] as f64 >= bounds[0] - 1.0 && high[n] as f64 <= bounds[1] + 1.0,
                "{told}: axis {n} between {} and {}, beyond {bounds:?}",
                low[n],
                high[n]
            );
        }
    }
}

/// Clock since the first of them, axis, direction.
type Edge = (u64, usize, bool);

fn steps(events: &[Event]) -> Vec<Edge> {
    let steps = events.iter().filter_map(|(clock, pin)| match *pin {
        Pin::Step { axis, forward } => Some((*clock, axis, forward)),
        Pin::Tool(_) => None,
    });
    let mut all: Vec<Edge> = steps.collect();
    all.sort_unstable();
    let first = all.first().map_or(0, |step| step.0);
    for step in &mut all {
        step.0 -= first;
    }
    all
}
