//! The planner's guarantees, for random machines and random programs.

mod rig;

use jobs::gcode::Reader;
use jobs::instruction::{Arc, CENTER_FARTHEST, DWELL_LONGEST, FARTHEST, Feed, Instruction, Place};
use jobs::plan::{Output, Planner, Setup, SetupError, Work};
use motion::segment::{MotionState, Segment};
use proptest::prelude::*;
use rig::*;

proptest! {
    // A failing case is printed completely; no regression file is written.
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(60) })]

    #[test]
    fn lines_keep_every_limit_and_the_path_and_end_on_the_exact_step(setup in any_setup(), lines in any_lines()) {
        let program: Vec<Instruction> = lines.iter().map(|&(to, feed)| Instruction::Line { to, feed }).collect();
        let run = run(&setup, &program);
        keeps_its_limits(&setup, &run);
        let mut corners = vec![[0; 3]];
        corners.extend(lines.iter().map(|line| line.0));
        keeps_to(&setup, &run, &corners);
        let end = run.states.last().unwrap();
        prop_assert!(end.rests());
        prop_assert_eq!(end.steps(), steps_of(&setup, *corners.last().unwrap()));
    }

    #[test]
    fn every_stop_is_at_rest_and_on_the_exact_step(setup in any_setup(), lines in any_lines(), every in 1..6usize) {
        let mut program = Vec::new();
        let mut stops = Vec::new();
        for (index, &(to, feed)) in lines.iter().enumerate() {
            program.push(Instruction::Line { to, feed });
            if index % every == 0 {
                program.push(Instruction::Pause);
                stops.push(to);
            }
        }
        stops.push(lines.last().unwrap().0);
        let mut planner = Planner::<3>::new(&setup).unwrap();
        let mut instructions = program.iter().chain([&Instruction::End]).peekable();
        let mut reached = Vec::new();
        while reached.len() < stops.len() {
            while planner.accepts() && instructions.peek().is_some() {
                prop_assert!(planner.push(instructions.next().unwrap(), 0));
            }
            if let Some(Output::Pause | Output::End) = planner.poll() {
                prop_assert!(planner.machine().rests());
                reached.push(planner.machine().steps());
            }
        }
        let expected: Vec<[i64; 3]> = stops.iter().map(|stop| steps_of(&setup, *stop)).collect();
        prop_assert_eq!(reached, expected);
    }

    #[test]
    fn a_feed_override_changes_the_time_and_not_the_end_nor_the_limits(setup in any_setup(), lines in any_lines(), percent in 1..200u32) {
        let program: Vec<Instruction> = lines.iter().map(|&(to, feed)| Instruction::Line { to, feed }).collect();
        let run = run_at(&setup, &program, percent);
        keeps_its_limits(&setup, &run);
        prop_assert_eq!(run.states.last().unwrap().steps(), steps_of(&setup, lines.last().unwrap().0));
    }

    #[test]
    fn an_override_changed_at_any_time_breaks_no_limit(setup in any_setup(), lines in any_lines(), percents in proptest::collection::vec(1..200u32, 1..20), every in 1..30usize) {
        let mut planner = Planner::<8>::new(&setup).unwrap();
        let mut machine = MotionState::default();
        let end = [Instruction::End];
        let program: Vec<Instruction> = lines.iter().map(|&(to, feed)| Instruction::Line { to, feed }).collect();
        let mut instructions = program.iter().chain(&end).peekable();
        let mut run = Run { segments: Vec::new(), states: vec![machine], outputs: Vec::new(), limits: planner.limits() };
        let mut percents = percents.iter().cycle();
        loop {
            while planner.accepts() && instructions.peek().is_some() {
                prop_assert!(planner.push(instructions.next().unwrap(), 0));
            }
            match planner.poll() {
                Some(Output::Segment(segment)) => {
                    machine.run(&segment);
                    run.segments.push(segment);
                    run.states.push(machine);
                    if run.segments.len().is_multiple_of(every) {
                        planner.set_override(*percents.next().unwrap());
                    }
                }
                Some(Output::End) => break,
                _ => {}
            }
        }
        keeps_its_limits(&setup, &run);
        prop_assert_eq!(machine.steps(), steps_of(&setup, lines.last().unwrap().0));
    }

    #[test]
    fn circles_stay_within_the_chord_tolerance_and_a_step(setup in any_setup(), radius in 200_000..40_000_000i64, clockwise: bool, mm_per_s in 1..200u32) {
        let setup = Setup { junction_deviation: setup.junction_deviation.max(1000), ..setup };
        let program = [
            Instruction::Line { to: [radius, 0, 0], feed: Feed::Rapid },
            Instruction::Pause,
            Instruction::Arc(Arc { to: [radius, 0, 0], center: [0, 0], clockwise, feed: Feed::Rate(mm_per_s * 1_000_000) }),
        ];
        let run = run(&setup, &program);
        keeps_its_limits(&setup, &run);
        let begin = run.states.iter().position(|state| state.rests() && state.steps()[0] == step_of(&setup, 0, radius)).unwrap();
        let step = setup.axes[..2].iter().map(|axis| 1e6 / axis.steps_per_km as f64).fold(0.0, f64::max);
        let most = f64::from(setup.chord_tolerance) * 1e-6 + step;
        let mut farthest: f64 = 0.0;
        for state in &run.states[begin..] {
            let [x, y, _] = place_of(&setup, state);
            let off = (x.hypot(y) - radius as f64 * 1e-6).abs();
            prop_assert!(off <= most, "{off} mm off, {most} allowed");
            farthest = farthest.max((x - radius as f64 * 1e-6).hypot(y));
        }
        // All the way round, not the chord from the beginning to the end.
        prop_assert!(farthest > radius as f64 * 1.9e-6, "only {farthest} mm away");
        prop_assert_eq!(run.states.last().unwrap().steps(), steps_of(&setup, [radius, 0, 0]));
    }

    #[test]
    fn a_little_work_at_a_time_makes_the_same_segments(setup in any_setup(), lines in any_lines(), radius in 200_000..10_000_000i64, chords in 1..6usize) {
        let circle = |at: Place, feed: Feed| Arc { to: at, center: [at[0] + radius, at[1]], clockwise: radius % 2 == 0, feed };
        let program: Vec<Instruction> = lines.iter().flat_map(|(to, feed)| {
            [Instruction::Line { to: *to, feed: *feed }, Instruction::Arc(circle(*to, *feed))]
        }).chain([Instruction::End]).collect();
        let play = |mut next: Next| {
            let mut planner = Planner::<16>::new(&setup).unwrap();
            let (mut instructions, mut outputs) = (program.iter(), Vec::new());
            while outputs.last() != Some(&Output::End) {
                if planner.accepts() && let Some(instruction) = instructions.next() {
                    assert!(planner.push(instruction, 0));
                    continue;
                }
                outputs.extend(next(&mut planner));
            }
            outputs
        };
        let whole = play(Box::new(|planner| planner.poll()));
        let bit_by_bit = play(Box::new(move |planner| match planner.work(chords) {
            Work::Output(output) => Some(output),
            Work::More | Work::Starved => None,
        }));
        prop_assert!(whole == bit_by_bit);
    }
}

#[test]
fn a_long_line_is_a_trapezoid_of_the_time_it_should_take() {
    let run = run(&mill(), &[line(100.0, 0.0, 0.0, 50.0)]);
    // 100 mm at 50 mm/s, 0.05 s more for the two ramps of 1000 mm/s^2.
    assert!((seconds(&run) - 2.05).abs() < 0.002, "{} s", seconds(&run));
    assert_eq!(run.states.last().unwrap().steps(), [40_000, 0, 0]);
}

#[test]
fn a_right_angle_is_rounded_within_the_deviation_and_faster_than_a_stop() {
    let corner = [line(20.0, 0.0, 0.0, 50.0), line(20.0, 20.0, 0.0, 50.0)];
    let corners = [[0; 3], [20_000_000, 0, 0], [20_000_000, 20_000_000, 0]];
    let round = run(&mill(), &corner);
    let exact = Setup {
        junction_deviation: 0,
        ..mill()
    };
    let stop = run(&exact, &corner);
    let worst = (
        keeps_to(&mill(), &round, &corners),
        keeps_to(&exact, &stop, &corners),
    );
    println!(
        "rounded {:.1} um in {:.3} s, stopped {:.1} um in {:.3} s",
        worst.0 * 1e3,
        seconds(&round),
        worst.1 * 1e3,
        seconds(&stop)
    );
    assert!(worst.0 > 0.005 && worst.1 < 1e-5);
    assert!(seconds(&round) < seconds(&stop));
}

#[test]
fn collinear_lines_are_one_line() {
    let pieces: Vec<Instruction> = (1..=1000)
        .map(|i| line(f64::from(i) * 0.1, 0.0, 0.0, 50.0))
        .collect();
    let run = run(&mill(), &pieces);
    assert!((seconds(&run) - 2.05).abs() < 0.03, "{} s", seconds(&run));
}

#[test]
fn a_circle_by_chords_is_drawn_at_speed() {
    let circle = Instruction::Arc(Arc {
        to: [0, 0, 0],
        center: [10_000_000, 0],
        clockwise: true,
        feed: Feed::Rate(50_000_000),
    });
    let run = run(&mill(), &[circle]);
    let ideal = core::f64::consts::TAU * 10.0 / 50.0 + 0.05;
    assert!(
        seconds(&run) < ideal * 1.03,
        "{} s, {ideal} s at best",
        seconds(&run)
    );
}

#[test]
fn tool_and_dwell_happen_at_rest_and_last_as_long_as_they_say() {
    let setup = Setup {
        aux_settle: 100_000,
        ..mill()
    };
    let program = [
        Instruction::Aux { bits: 1 },
        line(10.0, 0.0, 0.0, 20.0),
        Instruction::Aux { bits: 0 },
        Instruction::Dwell { micros: 250_000 },
        line(0.0, 0.0, 0.0, 20.0),
    ];
    let run = run(&setup, &program);
    let on: Vec<&Segment> = run
        .segments
        .iter()
        .filter(|segment| segment.aux == 1)
        .collect();
    let moving = on.iter().filter(|segment| segment.accel != [0; 3]).count();
    assert!(moving > 0 && on[0].clocks == CLOCK / 10);
    for (segment, before) in run.segments.iter().zip(&run.states) {
        assert!(
            segment.aux == before.aux || before.rests(),
            "{segment:?} switches in motion"
        );
    }
    assert!(
        run.segments
            .iter()
            .any(|segment| segment.clocks == CLOCK / 4 && segment.accel == [0; 3])
    );
}

#[test]
fn the_last_instruction_is_executed_once_and_so_is_the_one_before() {
    let run = run(
        &mill(),
        &[
            line(1.0, 0.0, 0.0, 20.0),
            Instruction::Dwell { micros: 1000 },
            Instruction::Aux { bits: 1 },
        ],
    );
    let still: Vec<u32> = run
        .segments
        .iter()
        .filter(|s| s.accel == [0; 3] && s.clocks != 64)
        .map(|s| s.clocks)
        .collect();
    assert_eq!(
        still
            .iter()
            .filter(|clocks| **clocks == CLOCK / 1000)
            .count(),
        1
    );
    assert_eq!(
        run.segments
            .iter()
            .filter(|segment| segment.aux == 1)
            .count(),
        1
    );
    assert_eq!(run.outputs, [Output::End]);
}

#[test]
fn after_home_the_axis_is_at_zero() {
    let program = [
        line(5.0, 5.0, 0.0, 20.0),
        Instruction::Home {
            axes: [true, false, false],
        },
        line(1.0, 1.0, 0.0, 20.0),
    ];
    let run = run(&mill(), &program);
    assert_eq!(run.outputs[0], Output::Home([true, false, false]));
    assert_eq!(run.states.last().unwrap().steps(), [400, 400, 0]);
}

#[test]
fn every_edge_of_a_program_is_predicted() {
    let program = [
        line(3.0, 1.0, -0.5, 50.0),
        line(0.0, 2.0, 0.0, 50.0),
        line(0.0, 0.0, 0.0, 80.0),
    ];
    let run = run(&mill(), &program);
    let mut steps = [0i64; 3];
    for (segment, state) in run.segments.iter().zip(&run.states) {
        for (axis, steps) in steps.iter_mut().enumerate() {
            let mut slow = state.axes[axis];
            let play = segment.play(axis);
            let mut edges = play.edges(slow).peekable();
            for clock in 0..segment.clocks {
                let before = slow.steps();
                play.clock(&mut slow, clock);
                if let Some(edge) = edges.next_if(|edge| edge.clock == clock) {
                    *steps += if edge.forward { 1 } else { -1 };
                }
                assert_eq!(
                    slow.steps(),
                    *steps,
                    "axis {axis} clock {clock} before {before}"
                );
            }
            assert_eq!(edges.next(), None);
        }
    }
    assert_eq!(steps, [0; 3]);
}

#[test]
fn a_machine_that_rests_a_hair_beside_its_step_stands_where_the_program_thinks_it_does() {
    // The position after another program: on the step, to within a ten thousandth.
    for off in [-500_000i64, -5, -1, 1, 5, 500_000] {
        let mut planner = Planner::<16>::new(&mill()).expect("a good machine");
        let at = |step: i64| (step << 32) + 0x8000_0000 + off;
        assert!(planner.begin_at([at(1600), at(0), at(-400)]));
        let feed = Feed::Rapid;
        let to = [4_000_000, 0, -250_000];
        assert!(planner.push(&Instruction::Line { to, feed }, 1));
        assert!(planner.push(&Instruction::End, 2));
        assert_eq!(planner.poll(), Some(Output::End), "{off}");
    }
}

#[test]
fn a_program_of_100_000_lines_streams_through_fixed_memory_and_ends_exactly() {
    let mut reader = Reader::default();
    let setup = mill();
    let mut planner = Planner::<16>::new(&setup).unwrap();
    println!(
        "planner {} bytes, reader {} bytes",
        size_of_val(&planner),
        size_of_val(&reader)
    );
    let (mut machine, mut segments) = (MotionState::default(), 0u64);
    let mut drain = |planner: &mut Planner<16>| {
        while let Some(output) = planner.poll() {
            match output {
                Output::Segment(segment) => {
                    machine.run(&segment);
                    segments += 1;
                }
                other => assert_eq!(other, Output::End),
            }
        }
    };
    let mut last = [0; 3];
    for index in 0..100_000u32 {
        let angle = f64::from(index) * 0.02;
        let radius = 5.0 + f64::from(index) * 0.0005;
        let (x, y) = (radius * angle.cos(), radius * angle.sin());
        let z = -f64::from(index % 7) * 0.01;
        let text = format!("N{index} G1 X{x:.4} Y{y:.4} Z{z:.3} F3000\n");
        for byte in text.bytes() {
            for instruction in reader.byte(byte).unwrap() {
                while !planner.accepts() {
                    drain(&mut planner);
                }
                assert!(planner.push(&instruction, reader.line_number()));
                if let Instruction::Line { to, .. } = instruction {
                    last = to;
                }
            }
        }
    }
    while !planner.accepts() {
        drain(&mut planner);
    }
    assert!(planner.push(&Instruction::End, 0));
    drain(&mut planner);
    println!(
        "{segments} segments, {:.0} s of motion",
        machine.clocks as f64 / f64::from(CLOCK)
    );
    assert!(machine.rests());
    assert_eq!(machine.steps(), steps_of(&setup, last));
}

#[test]
fn a_setup_that_no_board_can_drive_is_refused() {
    let refuse = |change: fn(&mut Setup)| {
        let mut setup = mill();
        change(&mut setup);
        Planner::<4>::new(&setup).unwrap_err()
    };
    assert_eq!(refuse(|s| s.clock_hz = 0), SetupError::Clock);
    assert_eq!(refuse(|s| s.axes[1].steps_per_km = 0), SetupError::Scale(1));
    assert_eq!(refuse(|s| s.axes[2].max_speed = 0), SetupError::Speed(2));
    assert_eq!(
        refuse(|s| (s.axes[0].steps_per_km, s.axes[0].max_speed) = (80_000_000_000, 400_000_000)),
        SetupError::Speed(0)
    );
    assert_eq!(refuse(|s| s.axes[0].max_accel = 0), SetupError::Accel(0));
    assert_eq!(refuse(|s| s.chord_tolerance = 0), SetupError::Tolerance);
}

/// Whether a planner can be had for the mill with this change, and with which limits.
fn limits_of(change: impl Fn(&mut Setup)) -> Result<[u32; 3], SetupError> {
    let mut setup = mill();
    change(&mut setup);
    Planner::<4>::new(&setup).map(|planner| planner.limits())
}

#[test]
fn each_bound_of_a_setup_is_where_the_refusal_says() {
    let clock = |hz| limits_of(|s| s.clock_hz = hz) != Err(SetupError::Clock);
    let clocks = [999_999, 1_000_000, 1_000_000_000, 1_000_000_001];
    assert_eq!(clocks.map(clock), [false, true, true, false]);
    let tolerance = |nm| limits_of(|s| s.chord_tolerance = nm).is_ok();
    assert_eq!([999, 1000].map(tolerance), [false, true]);
    let scale =
        |per_km| limits_of(|s| s.axes[0].steps_per_km = per_km) != Err(SetupError::Scale(0));
    assert_eq!([100_000_000_000, 100_000_000_001].map(scale), [true, false]);
    // A step in four clocks is 187.5 mm/s with 80 000 steps in a mm.
    let fast = |nm_per_s| {
        limits_of(|s| (s.axes[0].steps_per_km, s.axes[0].max_speed) = (80_000_000_000, nm_per_s))
    };
    assert!(fast(187_500_000).is_ok());
    assert_eq!(fast(187_500_001), Err(SetupError::Speed(0)));
    // A unit of velocity is 34.9 nm/s, and two of them are kept back.
    let slow = |nm_per_s| limits_of(|s| s.axes[0].max_speed = nm_per_s);
    assert_eq!(slow(70), Err(SetupError::Speed(0)));
    assert!(slow(71).is_ok());
    // 100 g, with few steps.
    let hard =
        |accel| limits_of(|s| (s.axes[0].steps_per_km, s.axes[0].max_accel) = (1_000_000, accel));
    assert!(hard(1_000_000_000_000).is_ok());
    assert_eq!(hard(1_000_000_000_001), Err(SetupError::Accel(0)));
}

/// The smallest number that is `true`.
fn first(mut low: u64, mut high: u64, is: impl Fn(u64) -> bool) -> u64 {
    while high - low > 1 {
        let middle = low + (high - low) / 2;
        if is(middle) {
            high = middle;
        } else {
            low = middle;
        }
    }
    high
}

#[test]
fn the_accelerations_are_those_that_a_segment_can_say() {
    let limit = |per_km, accel| {
        limits_of(|s| (s.axes[1].steps_per_km, s.axes[1].max_accel) = (per_km, accel))
            .map(|limits| limits[1])
    };
    let least = first(0, 1_000_000_000, |accel| limit(400_000_000, accel).is_ok());
    assert_eq!(limit(400_000_000, least), Ok(1 << 12));
    // clock^2 / 2^44 steps/s^2.
    let steps = least as f64 * 400e-6;
    assert!(
        (steps / (6e7f64.powi(2) / 2f64.powi(44)) - 1.0).abs() < 1e-5,
        "{steps}"
    );
    let most = first(1, 1_000_000_000_000, |accel| {
        limit(100_000_000_000, accel).is_err()
    }) - 1;
    // A nm/s^2 is two units there.
    let greatest = limit(100_000_000_000, most).unwrap();
    assert!(((1 << 31) - 2..1 << 31).contains(&greatest), "{greatest}");
    assert_eq!(limit(100_000_000_000, most + 1), Err(SetupError::Accel(1)));
}

#[test]
fn a_refused_setup_names_its_axis() {
    let said: Vec<String> = [
        SetupError::Scale(0),
        SetupError::Speed(1),
        SetupError::Accel(2),
    ]
    .map(|error| error.to_string())
    .into();
    for (said, axis) in said.iter().zip(["X: ", "Y: ", "Z: "]) {
        assert!(said.starts_with(axis), "{said}");
    }
    assert!(SetupError::Clock.to_string().contains("1 MHz"));
    assert!(SetupError::Tolerance.to_string().contains("1 um"));
}

fn arc(to: Place, center: [i64; 2]) -> Instruction {
    let (clockwise, feed) = (false, Feed::Rapid);
    Instruction::Arc(Arc {
        to,
        center,
        clockwise,
        feed,
    })
}

fn rapid(to: Place) -> Instruction {
    let feed = Feed::Rapid;
    Instruction::Line { to, feed }
}

#[test]
fn what_is_out_of_bounds_is_not_taken_and_changes_nothing() {
    let planner = || Planner::<8>::new(&mill()).unwrap();
    let mut empty = planner();
    let mut both = |near: &Instruction, far: &Instruction| {
        assert!(planner().push(near, 7), "{near:?}");
        assert!(!empty.push(far, 7), "{far:?}");
        assert_eq!((empty.target(), empty.tag()), ([0; 3], 0));
        assert!(empty.accepts());
        assert_eq!(empty.poll(), None);
    };
    for sign in [1, -1] {
        for axis in 0..3 {
            let place = |nm| core::array::from_fn(|n| if n == axis { sign * nm } else { 0 });
            both(&rapid(place(FARTHEST)), &rapid(place(FARTHEST + 1)));
            let center = [1_000_000, 0];
            both(
                &arc(place(FARTHEST), center),
                &arc(place(FARTHEST + 1), center),
            );
        }
        for axis in 0..2 {
            let center = |nm| core::array::from_fn(|n| if n == axis { sign * nm } else { 0 });
            let to = [1_000_000, 0, 0];
            both(
                &arc(to, center(CENTER_FARTHEST)),
                &arc(to, center(CENTER_FARTHEST + 1)),
            );
        }
    }
    let dwell = |micros| Instruction::Dwell { micros };
    both(&dwell(DWELL_LONGEST), &dwell(DWELL_LONGEST + 1));
}

#[test]
fn a_planner_begins_elsewhere_at_rest_only_and_with_nothing_planned() {
    let elsewhere = [(5 << 32) + (1 << 31); 3];
    for instruction in [
        rapid([1_000_000, 0, 0]),
        arc([2_000_000, 0, 0], [1_000_000, 0]),
    ] {
        let mut planner = Planner::<64>::new(&mill()).unwrap();
        assert!(planner.push(&instruction, 0));
        assert!(!planner.begin_at(elsewhere), "planned: {instruction:?}");
        assert!(planner.poll().is_none(), "all chords have room");
        assert!(!planner.begin_at(elsewhere), "in the buffer");
        assert!(planner.push(&Instruction::End, 0));
        while let Some(Output::Segment(_)) = planner.poll() {
            let stands = planner.machine().rests();
            assert!(stands || !planner.begin_at(elsewhere), "being drawn");
        }
        assert!(planner.begin_at(elsewhere), "all of it is done");
        assert_eq!(planner.machine().steps(), [5; 3]);
    }
}

#[test]
fn an_override_is_from_1_to_200_percent() {
    let program = [line(20.0, 5.0, 0.0, 10.0), line(0.0, 0.0, 0.0, 10.0)];
    let clocks = |percent| seconds(&run_at(&mill(), &program, percent));
    assert_eq!(clocks(0), clocks(1));
    assert_eq!(clocks(201), clocks(200));
    assert!(clocks(1) > 1.9 * clocks(2) && clocks(199) > clocks(200));
}

#[test]
fn the_tag_is_that_of_the_line_being_drawn() {
    let mut planner = Planner::<8>::new(&mill()).unwrap();
    let corners = [[9, 0, 0], [9, 9, 0], [0, 9, 0]];
    for (tag, corner) in (70_001..).zip(corners) {
        assert!(planner.push(&rapid(corner.map(|mm| mm * 1_000_000)), tag));
    }
    assert!(planner.push(&Instruction::End, 9));
    let mut tags = Vec::new();
    while let Some(Output::Segment(segment)) = planner.poll() {
        assert_eq!(segment.tag, planner.tag() as u16);
        if tags.last() != Some(&planner.tag()) {
            tags.push(planner.tag());
        }
    }
    assert_eq!(tags, [70_001, 70_002, 70_003]);
}
