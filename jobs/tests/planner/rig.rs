//! Random machines and programs, and what a program does to a machine.

use jobs::instruction::{Feed, Instruction, Place};
use jobs::plan::{AxisSetup, Output, Planner, Setup};
use motion::segment::{MotionState, Segment};
use proptest::prelude::*;

pub const CLOCK: u32 = 60_000_000;

pub fn axis(steps_per_mm: f64, mm_per_s: f64, mm_per_s2: f64) -> AxisSetup {
    AxisSetup {
        steps_per_km: (steps_per_mm * 1e6) as u64,
        max_speed: (mm_per_s * 1e6) as u32,
        max_accel: (mm_per_s2 * 1e6) as u64,
    }
}

pub fn mill() -> Setup {
    Setup {
        clock_hz: CLOCK,
        axes: [
            axis(400.0, 100.0, 1000.0),
            axis(400.0, 100.0, 1000.0),
            axis(1600.0, 20.0, 300.0),
        ],
        chord_tolerance: 5_000,
        junction_deviation: 10_000,
        aux_settle: 0,
    }
}

/// The effect of a program on the machine.
pub struct Run {
    pub segments: Vec<Segment>,
    /// Integrators before each segment and after the last.
    pub states: Vec<MotionState>,
    pub outputs: Vec<Output>,
    pub limits: [u32; 3],
}

pub fn run_at(setup: &Setup, program: &[Instruction], percent: u32) -> Run {
    let mut planner = Planner::<16>::new(setup).unwrap();
    planner.set_override(percent);
    let mut run = Run {
        segments: Vec::new(),
        states: vec![MotionState::default()],
        outputs: Vec::new(),
        limits: planner.limits(),
    };
    let mut instructions = program.iter().chain([&Instruction::End]);
    loop {
        while planner.accepts() {
            match instructions.next() {
                Some(instruction) => assert!(planner.push(instruction, 0)),
                None => break,
            }
        }
        match planner.poll() {
            None => {}
            Some(Output::Segment(segment)) => {
                let mut machine = *run.states.last().unwrap();
                machine.run(&segment);
                run.segments.push(segment);
                run.states.push(machine);
                assert_eq!(
                    machine.axes,
                    planner.machine().axes,
                    "the planner's machine is the model's"
                );
            }
            Some(output) => {
                let machine = *planner.machine();
                *run.states.last_mut().unwrap() = machine;
                run.outputs.push(output);
                if output == Output::End {
                    return run;
                }
            }
        }
    }
}

pub fn run(setup: &Setup, program: &[Instruction]) -> Run {
    run_at(setup, program, 100)
}

pub fn seconds(run: &Run) -> f64 {
    run.segments
        .iter()
        .map(|segment| f64::from(segment.clocks))
        .sum::<f64>()
        / f64::from(CLOCK)
}

pub fn step_of(setup: &Setup, axis: usize, nm: i64) -> i64 {
    let steps = i128::from(nm) * i128::from(setup.axes[axis].steps_per_km);
    (steps + 500_000_000_000).div_euclid(1_000_000_000_000) as i64
}

pub fn steps_of(setup: &Setup, place: Place) -> [i64; 3] {
    core::array::from_fn(|axis| step_of(setup, axis, place[axis]))
}

/// In mm.
pub fn place_of(setup: &Setup, machine: &MotionState) -> [f64; 3] {
    core::array::from_fn(|axis| {
        let steps = (machine.axes[axis].position - 0x8000_0000) as f64 / 4_294_967_296.0;
        steps / setup.axes[axis].steps_per_km as f64 * 1e6
    })
}

/// The path in mm, eight points in a segment.
pub fn path(setup: &Setup, run: &Run) -> Vec<[f64; 3]> {
    let mut path = vec![place_of(setup, &run.states[0])];
    for (segment, state) in run.segments.iter().zip(&run.states) {
        for part in 0..8u64 {
            let clocks = (u64::from(segment.clocks) * part / 8) as u32;
            path.push(place_of(setup, &state.within(segment, clocks)));
        }
    }
    path.push(place_of(setup, run.states.last().unwrap()));
    path
}

pub fn distance_to_line(p: [f64; 3], a: [f64; 3], b: [f64; 3]) -> f64 {
    let sub = |a: [f64; 3], b: [f64; 3]| [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
    let dot = |a: [f64; 3], b: [f64; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
    let (along, to) = (sub(b, a), sub(p, a));
    let length = dot(along, along);
    let t = if length == 0.0 {
        0.0
    } else {
        (dot(to, along) / length).clamp(0.0, 1.0)
    };
    let off = sub(to, along.map(|x| x * t));
    dot(off, off).sqrt()
}

/// The limits of every axis, in every segment, without a tolerance.
pub fn keeps_its_limits(setup: &Setup, run: &Run) {
    for (segment, after) in run.segments.iter().zip(&run.states[1..]) {
        for (i, axis) in setup.axes.iter().enumerate() {
            assert!(segment.accel[i] <= run.limits[i], "axis {i}: {segment:?}");
            // The acceleration suffices: the segment reaches its velocity.
            let reached = i64::from(segment.velocity[i]) << 24;
            assert_eq!(after.axes[i].velocity, reached, "axis {i}: {segment:?}");
            let steps_per_s =
                after.axes[i].velocity as f64 / 2f64.powi(56) * f64::from(setup.clock_hz);
            let most = f64::from(axis.max_speed) * 1e-12 * axis.steps_per_km as f64;
            assert!(
                steps_per_s.abs() <= most,
                "axis {i}: {steps_per_s} steps/s of {most}"
            );
        }
        assert!((64..=1 << 31).contains(&segment.clocks), "{segment:?}");
    }
}

pub fn mm(place: Place) -> [f64; 3] {
    place.map(|nm| nm as f64 * 1e-6)
}

/// Every point of the path is near the polyline, and every corner of the polyline near the path.
pub fn keeps_to(setup: &Setup, run: &Run, corners: &[Place]) -> f64 {
    let step = setup
        .axes
        .iter()
        .map(|axis| 1e6 / axis.steps_per_km as f64)
        .fold(0.0, f64::max);
    let most = f64::from(setup.junction_deviation) * 1e-6 + step;
    let path = path(setup, run);
    let mut worst: f64 = 0.0;
    for point in &path {
        let lines = corners
            .windows(2)
            .map(|ends| distance_to_line(*point, mm(ends[0]), mm(ends[1])));
        let off = lines.fold(f64::MAX, f64::min);
        assert!(
            off <= most,
            "{point:?} is {off} mm off the lines, {most} allowed"
        );
        worst = worst.max(off);
    }
    for corner in corners {
        let lines = path
            .windows(2)
            .map(|ends| distance_to_line(mm(*corner), ends[0], ends[1]));
        let off = lines.fold(f64::MAX, f64::min);
        assert!(
            off <= most,
            "corner {corner:?} is {off} mm off the path, {most} allowed"
        );
    }
    worst
}

pub fn line(x: f64, y: f64, z: f64, mm_per_s: f64) -> Instruction {
    Instruction::Line {
        to: [x, y, z].map(|mm| (mm * 1e6) as i64),
        feed: Feed::Rate((mm_per_s * 1e6) as u32),
    }
}

pub fn any_setup() -> impl Strategy<Value = Setup> {
    let axis = (5.0..3000.0f64, 1.0..400.0f64, 50.0..20_000.0f64).prop_filter_map(
        "a machine the board can drive",
        |(scale, speed, accel)| {
            let speed = speed.min(5e6 / scale);
            Some(axis(scale, speed, accel))
        },
    );
    (
        proptest::array::uniform3(axis),
        prop_oneof![Just(0), 1_000..100_000u32],
        1_000..50_000u32,
    )
        .prop_map(|(axes, junction_deviation, chord_tolerance)| Setup {
            clock_hz: CLOCK,
            axes,
            chord_tolerance,
            junction_deviation,
            aux_settle: 0,
        })
}

pub fn any_place() -> impl Strategy<Value = Place> {
    let large = proptest::array::uniform3(-50_000_000..50_000_000i64);
    let flat =
        (-20_000_000..20_000_000i64, -20_000_000..20_000_000i64).prop_map(|(x, y)| [x, y, 0]);
    prop_oneof![large, flat]
}

pub fn any_feed() -> impl Strategy<Value = Feed> {
    prop_oneof![
        Just(Feed::Rapid),
        (100_000..300_000_000u32).prop_map(Feed::Rate)
    ]
}

/// Places far apart, near each other, and the same twice.
pub fn any_lines() -> impl Strategy<Value = Vec<(Place, Feed)>> {
    let near = proptest::array::uniform3(-200_000..200_000i64);
    let move_ = prop_oneof![
        3 => (any_place(), any_feed()).prop_map(|(place, feed)| (Some(place), [0; 3], feed)),
        3 => (near, any_feed()).prop_map(|(by, feed)| (None, by, feed)),
        1 => any_feed().prop_map(|feed| (None, [1, 0, -1], feed)),
    ];
    proptest::collection::vec(move_, 1..40).prop_map(|moves| {
        let mut at = [0; 3];
        let mut lines = Vec::new();
        for (place, by, feed) in moves {
            at = place.unwrap_or([at[0] + by[0], at[1] + by[1], at[2] + by[2]]);
            lines.push((at, feed));
        }
        lines
    })
}

/// What makes the next output of a planner.
pub type Next = Box<dyn FnMut(&mut Planner<16>) -> Option<Output>>;
