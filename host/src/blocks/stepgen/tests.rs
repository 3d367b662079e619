use super::*;
use crate::hal::fake::FakeHal;
use proptest::prelude::*;
use wire::units::Clocks;

const CLOCK: u32 = 60_000_000;

/// A stepgen, its HAL, and a fabric that executes what it asks, exact to the clock.
struct Bench {
    hal: FakeHal,
    stepgen: Stepgen,
    fabric: Ramp,
    period: Period,
    sequence: u32,
    latch: Option<u32>,
}

impl Bench {
    fn new(scale: f64, maxaccel: f64) -> Self {
        let mut hal = FakeHal::new();
        let mut stepgen =
            Stepgen::export(&mut Exporter::new(&mut hal, "s"), StepType::StepDir).unwrap();
        hal.set("s.enable", true);
        hal.set("s.position-scale", scale);
        hal.set("s.maxaccel", maxaccel);
        hal.set("s.steplen", 500u32);
        hal.set("s.stepspace", 500u32);
        stepgen.configure(f64::from(CLOCK));
        let mut bench = Bench {
            hal,
            stepgen,
            fabric: Ramp::default(),
            period: Period::new(1_000_000, CLOCK),
            sequence: 0,
            latch: None,
        };
        bench.settle(1);
        bench
    }

    /// One servo period: read, then write as LinuxCNC commands `position`.
    fn step(&mut self, position: f64) -> Target {
        let (sampled, velocity) = (Position(self.fabric.position), self.fabric.velocity());
        self.sequence += 1;
        let sample = Sample {
            position: sampled,
            velocity,
            limited: false,
            latch_sample: LatchSample {
                sequence: self.sequence,
                live: true,
                index: self.latch.is_some(),
                value: self.latch.map(Count),
                ..LatchSample::default()
            },
        };
        let basis = PredictionBasis::Commanded {
            lead: Clocks(0),
            ahead: self.period.clocks,
        };
        self.stepgen.sampled(&sample, basis, self.period);
        self.stepgen.arms(true, self.sequence + 1);
        self.hal.set("s.position-cmd", position);
        // The prediction of this read is for the next command, one period on; the fabric is
        // there when the command it was made from has run.
        let target = self.stepgen.command(true, Feedback::Fresh, self.period);
        self.run(target);
        target
    }

    fn settle(&mut self, periods: usize) {
        let position = self.hal.get("s.position-cmd");
        for _ in 0..periods {
            self.step(position);
        }
    }

    /// The command reaches the board, which had been following the previous one until now.
    fn run(&mut self, target: Target) {
        self.fabric.advance(self.period.clocks.0);
        self.fabric.target = target.velocity;
        self.fabric.accel = target.accel;
    }

    fn pulses(&self) -> i64 {
        Position(self.fabric.position).pulses()
    }
}

/// A trapezoid from 0 to `distance` as the trajectory planner would sample it.
fn trapezoid(distance: f64, velocity: f64, accel: f64) -> impl Iterator<Item = f64> {
    let (mut at, mut speed) = (0.0f64, 0.0f64);
    let step = 0.001;
    core::iter::from_fn(move || {
        let left = distance - at;
        if left <= 0.0 {
            return None;
        }
        let brake = (2.0 * accel * left).sqrt();
        speed = (speed + accel * step).min(velocity).min(brake);
        at = (at + speed.max(accel * step) * step).min(distance);
        Some(at)
    })
}

#[test]
fn a_move_ends_with_exactly_the_commanded_pulses() {
    let mut bench = Bench::new(800.0, 600.0);
    for position in trapezoid(10.0, 25.0, 300.0) {
        bench.step(position);
    }
    bench.settle(100);
    assert_eq!(bench.pulses(), 8000);
    assert_eq!(bench.fabric.velocity, 0);
}

/// How far the pulses are off the command at most while it moves, and the command's
/// acceleration times a period's square, both in steps.
fn worst_in_motion(bench: &mut Bench, scale: f64) -> (f64, f64) {
    let path: Vec<f64> = [0.0, 0.0]
        .into_iter()
        .chain(trapezoid(10.0, 25.0, 300.0))
        .collect();
    let change = |w: &[f64]| (w[2] - 2.0 * w[1] + w[0]).abs() * scale;
    let accel = path.windows(3).map(change).fold(0.0, f64::max);
    let mut worst = 0.0f64;
    for w in path.windows(2) {
        // The command before it has now run its period.
        bench.step(w[1]);
        worst = worst.max((bench.pulses() as f64 - w[0] * scale).abs());
    }
    (worst, accel)
}

/// What the loop lags behind a command that accelerates, in the command's acceleration times a
/// period's square, when that acceleration is `ratio` of `maxaccel` and no more than a half.
/// `tests/demo/report.py` has the arithmetic.
fn lag(ratio: f64) -> f64 {
    ratio - ratio * (1.0 - ratio / 2.0).powi(2) / 2.0
}

#[test]
fn in_motion_the_pulses_stay_within_half_a_step_and_the_loops_lag_of_the_command() {
    for maxaccel in [600.0, 1200.0, 6000.0] {
        let mut bench = Bench::new(800.0, maxaccel);
        let (worst, accel) = worst_in_motion(&mut bench, 800.0);
        let allowed = 0.5 + lag(accel / (maxaccel * 800.0 * 1e-6)) * accel + 1e-3;
        assert!(worst <= allowed, "{worst} of {allowed} steps at {maxaccel}");
    }
}

#[test]
fn no_course_of_the_command_lags_more_than_one_that_keeps_accelerating() {
    // In the command's acceleration and periods; every sequence of accelerations -1, 0 and 1 of
    // 11 periods.
    for ratio in [0.5, 0.25] {
        let accel = 1.0 / ratio;
        let mut all = vec![(0.0f64, 0.0f64)]; // error, and speed beyond the command's
        for _ in 0..11 {
            all = all
                .into_iter()
                .flat_map(|(error, speed)| [-1.0, 0.0, 1.0].map(|u| (error, speed + u)))
                .map(|(error, speed)| {
                    let now = Motion {
                        position: error,
                        velocity: speed,
                    };
                    let velocity = approach(now, 0.0, 0.0, accel, 1.0);
                    let missing = speed - velocity;
                    let lost = missing * missing.abs() / (2.0 * accel);
                    (error + velocity + lost, velocity)
                })
                .collect();
        }
        let worst = all.iter().map(|(error, _)| error.abs()).fold(0.0, f64::max);
        let most = lag(ratio);
        assert!(worst <= most, "{worst} at {ratio}, not {most}");
        assert!(worst > 0.999 * lag(ratio), "{worst} at {ratio}: not tight");
    }
}

#[test]
fn ten_percent_more_acceleration_than_the_planner_is_headroom_enough() {
    for maxaccel in [330.0, 450.0, 3000.0, 0.0] {
        let mut bench = Bench::new(800.0, maxaccel);
        let (worst, accel) = worst_in_motion(&mut bench, 800.0);
        let allowed = 0.5 + accel;
        assert!(worst <= allowed, "{worst} of {allowed} steps at {maxaccel}");
        bench.settle(100);
        assert_eq!(bench.pulses(), 8000, "{maxaccel}");
    }
}

#[test]
fn the_prediction_is_what_the_fabric_then_does() {
    let mut bench = Bench::new(800.0, 600.0);
    for position in trapezoid(5.0, 25.0, 300.0) {
        let target = bench.stepgen.sent;
        let sampled = bench.fabric;
        bench.step(position);
        let steps = bench.stepgen.steps();
        let there = Ramp::predict(
            Position(sampled.position),
            sampled.velocity(),
            target.velocity,
            target.accel,
            Clocks(60_000),
        );
        assert_eq!(steps, Position(there.position).steps());
        // Sampling drops the velocity's fraction: up to 1/2^32 step per clock.
        assert!((steps - Position(bench.fabric.position).steps()).abs() < 2e-3);
    }
}

#[test]
fn a_negative_scale_reverses_the_motor_not_the_feedback() {
    let mut bench = Bench::new(-400.0, 1000.0);
    for position in trapezoid(2.0, 10.0, 300.0) {
        bench.step(position);
    }
    bench.settle(100);
    assert_eq!(bench.pulses(), -800);
    assert!((bench.hal.get::<f64>("s.position-fb") - 2.0).abs() < 1e-6);
}

#[test]
fn control_type_switches_while_moving() {
    let mut bench = Bench::new(100.0, 1000.0);
    bench.hal.set("s.control-type", true);
    bench.hal.set("s.velocity-cmd", 10.0);
    bench.settle(50);
    assert!((bench.hal.get::<f64>("s.velocity-fb") - 10.0).abs() < 1e-3);
    let here = bench.hal.get::<f64>("s.position-fb").ceil();
    bench.hal.set("s.control-type", false);
    bench.hal.set("s.position-cmd", here);
    bench.settle(200);
    assert_eq!(bench.pulses(), (here * 100.0) as i64);
}

#[test]
fn a_velocity_beyond_the_step_timing_is_clamped_and_said() {
    let mut bench = Bench::new(1000.0, 0.0);
    bench.hal.set("s.control-type", true);
    bench.hal.set("s.velocity-cmd", 5000.0);
    let target = bench.step(0.0);
    bench.step(0.0);
    // 500 ns + 500 ns: one step per microsecond.
    assert_eq!(target.velocity, Velocity::from_hz(1e6, f64::from(CLOCK)));
    assert!(bench.hal.get::<bool>("s.rate-limited"));
}

#[test]
fn maxvel_holds_in_both_directions() {
    let mut bench = Bench::new(100.0, 0.0);
    bench.hal.set("s.maxvel", 3.0);
    bench.hal.set("s.control-type", true);
    for (asked, given) in [(50.0, 300.0), (-50.0, -300.0), (f64::NAN, 0.0)] {
        bench.hal.set("s.velocity-cmd", asked);
        let velocity = bench.step(0.0).velocity;
        assert_eq!(velocity, Velocity::from_hz(given, f64::from(CLOCK)));
    }
}

#[test]
fn disabled_or_not_live_asks_for_rest() {
    let mut bench = Bench::new(100.0, 1000.0);
    bench.hal.set("s.position-cmd", 5.0);
    let period = bench.period;
    let command = bench.stepgen.command(false, Feedback::Fresh, period);
    assert_eq!((command.enable, command.velocity), (false, Velocity(0)));
    bench.hal.set("s.enable", false);
    let command = bench.stepgen.command(true, Feedback::Fresh, period);
    assert_eq!((command.enable, command.velocity), (false, Velocity(0)));
}

#[test]
fn a_fabric_reset_does_not_move_the_position() {
    let mut bench = Bench::new(100.0, 1000.0);
    for position in trapezoid(1.0, 10.0, 300.0) {
        bench.step(position);
    }
    bench.settle(100);
    bench.stepgen.rebase();
    bench.fabric = Ramp::default();
    bench.settle(3);
    assert_eq!(bench.hal.get::<i32>("s.counts"), 100);
    assert!((bench.hal.get::<f64>("s.position-fb") - 1.0).abs() < 1e-6);
    // And it goes on from there.
    bench.hal.set("s.position-cmd", 1.5);
    bench.settle(300);
    assert_eq!(bench.hal.get::<i32>("s.counts"), 150);
    assert_eq!(bench.pulses(), 50);
}

#[test]
fn the_count_goes_on_when_the_register_wraps() {
    let mut track = Track::default();
    track.update(Position(i64::MAX - 5));
    track.update(Position(i64::MIN + 5));
    assert_eq!(track.pulses(), 1 << 31);
    assert!((track.steps(i64::MIN + 5) - 2_147_483_647.5).abs() < 1e-6);
}

#[test]
fn timings_in_nanoseconds_become_clocks_rounded_up() {
    let mut bench = Bench::new(1.0, 1.0);
    bench.hal.set("s.steplen", 0u32);
    bench.hal.set("s.stepspace", 1001u32);
    bench.hal.set("s.dirsetup", u32::MAX);
    bench.hal.set("s.dirhold", 0u32);
    bench.hal.set("s.dir-invert", true);
    let words = bench.stepgen.configure(f64::from(CLOCK));
    assert_eq!(words[..4], [1, 61, 0xffff, 0]);
    assert_eq!(words[5], 2);
    bench.hal.set("s.steplen", u32::MAX);
    bench.hal.set("s.step-type", 2u32);
    bench.hal.set("s.index-invert", true);
    let words = bench.stepgen.configure(f64::from(CLOCK));
    assert_eq!((words[0], words[5]), (8191, 2 | 2 << 2 | 1 << 4));
    // There is no such type: the last good one stays.
    bench.hal.set("s.step-type", 3u32);
    let words = bench.stepgen.configure(f64::from(CLOCK));
    assert_eq!(words[5], 2 | 2 << 2 | 1 << 4);
}

#[test]
fn an_index_moves_the_origin_and_not_the_motor() {
    let mut bench = Bench::new(100.0, 1000.0);
    bench.hal.set("s.index-enable", true);
    let mut command = 0.0;
    for _ in 0..200 {
        command += 0.01;
        bench.step(command);
    }
    assert!(bench.hal.get::<bool>("s.index-enable"));
    // The index was 20 pulses ago.
    let before: f64 = bench.hal.get("s.position-fb");
    let there = bench.pulses() - 20;
    bench.latch = Some(there as u32);
    let velocity = bench.fabric.velocity;
    for n in 0..50 {
        // LinuxCNC reads the feedback, then moves its command by as much in the same period.
        let followed = command - there as f64 / 100.0;
        command = followed + 0.01;
        let target = if n == 0 {
            bench.step(command)
        } else {
            command = bench.hal.get::<f64>("s.position-cmd") + 0.01;
            bench.step(command)
        };
        bench.latch = None;
        let velocity = target.velocity.to_hz(f64::from(CLOCK));
        assert!((velocity - 1000.0).abs() < 20.0, "{n}: {velocity} steps/s");
    }
    assert!(!bench.hal.get::<bool>("s.index-enable"));
    assert_eq!(bench.hal.get::<i32>("s.count-latched"), there as i32);
    let after: f64 = bench.hal.get("s.position-fb");
    let travelled = 0.5;
    assert!((after - (before - there as f64 / 100.0) - travelled).abs() < 0.03);
    assert!((bench.fabric.velocity - velocity).abs() < velocity / 20);
}

#[test]
fn a_command_that_does_not_follow_the_origin_is_no_jump_either() {
    let mut bench = Bench::new(100.0, 1000.0);
    bench.stepgen.shifted = 5.0;
    bench.stepgen.last_cmd = Some(1.0);
    assert_eq!(bench.stepgen.advance_of(Some(1.25)), 0.25);
    bench.stepgen.shifted = 5.0;
    assert_eq!(bench.stepgen.advance_of(Some(-3.75)), 0.25);
    assert_eq!(bench.stepgen.shifted, 0.0);
}

#[test]
fn a_position_reset_holds_the_count_at_zero_and_moves_nothing() {
    let mut bench = Bench::new(100.0, 1000.0);
    for position in trapezoid(1.0, 10.0, 300.0) {
        bench.step(position);
    }
    bench.settle(100);
    bench.hal.set("s.position-reset", true);
    for _ in 0..5 {
        bench.step(0.0);
    }
    bench.hal.set("s.position-reset", false);
    bench.settle(20);
    assert_eq!(bench.hal.get::<i32>("s.counts"), 0);
    assert_eq!(bench.pulses(), 100);
}

#[test]
fn a_command_applied_later_is_predicted_from_then_on() {
    let mut bench = Bench::new(1.0, 0.0);
    bench.stepgen.before = Target {
        velocity: Velocity::from_hz(1000.0, f64::from(CLOCK)),
        ..Target::default()
    };
    bench.stepgen.sent.velocity = Velocity::from_hz(2000.0, f64::from(CLOCK));
    let sample = Sample {
        position: Position::ZERO,
        velocity: bench.stepgen.before.velocity,
        limited: false,
        latch_sample: LatchSample::default(),
    };
    let basis = PredictionBasis::Commanded {
        lead: Clocks(30_000),
        ahead: Clocks(60_000),
    };
    bench.stepgen.sampled(&sample, basis, bench.period);
    // Half a millisecond at 1 kHz, one at 2 kHz.
    let fb: f64 = bench.hal.get("s.position-fb");
    assert!((fb - 2.5).abs() < 1e-3, "{fb}");
}

/// What the board says when nothing is latched.
fn seen(position: Position, velocity: Velocity) -> Sample {
    Sample {
        position,
        velocity,
        limited: false,
        latch_sample: LatchSample::default(),
    }
}

fn hz(velocity: f64) -> Velocity {
    Velocity::from_hz(velocity, f64::from(CLOCK))
}

#[test]
fn an_axis_that_stops_by_itself_is_predicted_to_brake_and_one_behind_a_closed_gate_to_stand() {
    let mut bench = Bench::new(100.0, 1000.0);
    let at = Position::from_words(0x8000_0000, 700);
    let sample = seen(at, hz(2000.0));
    let stopping = PredictionBasis::Stopping {
        ahead: bench.period.clocks,
    };
    bench.stepgen.sampled(&sample, stopping, bench.period);
    // 2 steps less half of 100 000 steps/s^2 in a millisecond.
    let fb = bench.hal.get::<f64>("s.position-fb");
    assert!((fb - 7.0195).abs() < 1e-4, "{fb}");
    let velocity = bench.hal.get::<f64>("s.velocity-fb");
    assert!((velocity - 19.0).abs() < 0.01, "{velocity}");
    bench
        .stepgen
        .sampled(&sample, PredictionBasis::Still, bench.period);
    assert_eq!(bench.hal.get::<f64>("s.position-fb"), 7.0);
    assert_eq!(bench.hal.get::<f64>("s.velocity-fb"), 0.0);
}

#[test]
fn a_missing_answer_is_bridged_by_what_was_commanded() {
    let mut bench = Bench::new(100.0, 0.0);
    bench.hal.set("s.control-type", true);
    bench.hal.set("s.velocity-cmd", 20.0);
    bench.settle(5);
    let before = bench.hal.get::<f64>("s.position-fb");
    bench.stepgen.bridge(bench.period);
    let after = bench.hal.get::<f64>("s.position-fb");
    assert!((after - before - 0.02).abs() < 1e-6, "{before} {after}");
}

#[test]
fn while_feedback_is_frozen_a_velocity_falls_and_neither_rises_nor_turns() {
    for (before, asked, given) in [
        (20.0, 10.0, 10.0),
        (20.0, 30.0, 20.0),
        (20.0, -5.0, 0.0),
        (-20.0, -10.0, -10.0),
        (-20.0, -30.0, -20.0),
        (-20.0, 5.0, 0.0),
    ] {
        let mut bench = Bench::new(100.0, 0.0);
        let period = bench.period;
        bench.hal.set("s.control-type", true);
        bench.hal.set("s.velocity-cmd", before);
        bench.settle(3);
        bench.hal.set("s.velocity-cmd", asked);
        let target = bench.stepgen.command(true, Feedback::Frozen, period);
        assert_eq!(target.velocity, hz(100.0 * given), "{asked} after {before}");
        let target = bench.stepgen.command(true, Feedback::Bridged, period);
        assert_eq!(target.velocity, hz(100.0 * asked), "one answer is bridged");
    }
}

#[test]
fn while_feedback_is_frozen_a_position_is_followed_by_its_own_velocity_alone() {
    let mut bench = Bench::new(100.0, 0.0);
    let period = bench.period;
    // An uncertain error of 10 units, and a command that moves.
    bench.stepgen.last_cmd = Some(10.0);
    bench.hal.set("s.position-cmd", 10.02);
    let target = bench.stepgen.command(true, Feedback::Frozen, period);
    assert!((target.velocity.to_hz(f64::from(CLOCK)) - 2000.0).abs() < 0.1);
    bench.stepgen.last_cmd = Some(10.0);
    let target = bench.stepgen.command(true, Feedback::Bridged, period);
    assert!(target.velocity.to_hz(f64::from(CLOCK)) > 100_000.0);
    // With a limit, no more than it allows in the period.
    bench.hal.set("s.maxaccel", 10.0);
    bench.stepgen.last_cmd = Some(10.0);
    let target = bench.stepgen.command(true, Feedback::Frozen, period);
    assert_eq!(target.velocity, hz(1.0));
}

#[test]
fn a_match_that_takes_long_is_begun_at_once_unless_a_detour_brings_it_nearer() {
    // From 100 steps/s to rest at 10 000 steps/s^2: 10 ms and half a step. One period the other
    // way adds 0.2 steps.
    let now = Motion {
        position: 0.0,
        velocity: 100.0,
    };
    for (target, velocity) in [
        (0.5, 90.0),
        (0.6, 90.0),
        (0.69, 90.0),
        (0.71, 110.0),
        (1.5, 110.0),
        (0.4, 90.0),
        (-3.0, 90.0),
    ] {
        let given = approach(now, target, 0.0, 10_000.0, 0.001);
        assert!((given - velocity).abs() < 1e-9, "{given} to {target}");
    }
}

#[test]
fn the_limit_of_acceleration_goes_with_every_command_and_into_the_board_s_settings() {
    let mut bench = Bench::new(-400.0, 1000.0);
    let limit = Accel::from_steps(400_000.0, f64::from(CLOCK));
    let period = bench.period;
    for live in [true, false] {
        let target = bench.stepgen.command(live, Feedback::Fresh, period);
        assert_eq!((target.enable, target.accel), (live, limit));
    }
    assert_eq!(bench.stepgen.configure(f64::from(CLOCK))[4], limit.0);
}

#[test]
fn a_velocity_that_the_step_timing_just_allows_is_not_said_to_be_limited() {
    let mut bench = Bench::new(1000.0, 0.0);
    bench.hal.set("s.control-type", true);
    for (asked, limited) in [(1000.0, false), (1000.001, true), (-1000.0, false)] {
        bench.hal.set("s.velocity-cmd", asked);
        bench.settle(2);
        assert_eq!(bench.hal.get::<bool>("s.rate-limited"), limited, "{asked}");
    }
    // steplen and stepspace add up.
    bench.hal.set("s.stepspace", 1_500u32);
    bench.stepgen.configure(f64::from(CLOCK));
    assert_eq!(bench.step(0.0).velocity, hz(-500_000.0));
}

#[test]
fn a_position_reset_that_the_command_follows_asks_for_no_motion() {
    let mut bench = Bench::new(100.0, 1000.0);
    for position in trapezoid(1.3, 10.0, 300.0) {
        bench.step(position);
    }
    bench.settle(100);
    bench.hal.set("s.position-reset", true);
    for _ in 0..5 {
        let velocity = bench.step(0.0).velocity.to_hz(f64::from(CLOCK));
        assert!(velocity.abs() < 1.0, "{velocity} steps/s");
    }
    assert_eq!(bench.pulses(), 130);
}

#[test]
fn index_and_probe_are_armed_each_by_its_pin_and_latch_the_place() {
    let mut bench = Bench::new(100.0, 1000.0);
    let at = Position::from_words(0x8000_0000, 345);
    let mut sequence = 10;
    let mut exchange = |bench: &mut Bench, index, probe, value: Option<u32>| {
        let mut sample = seen(at, Velocity(0));
        sample.latch_sample = LatchSample {
            sequence,
            live: true,
            index,
            probe,
            value: value.map(Count),
        };
        let period = bench.period;
        bench
            .stepgen
            .sampled(&sample, PredictionBasis::Still, period);
        sequence += 1;
        bench.stepgen.arms(true, sequence)
    };
    for (pin, armed, flags) in [
        ("s.index-enable", (true, false), (true, false)),
        ("s.probe-enable", (false, true), (false, true)),
    ] {
        for _ in 0..3 {
            let nothing = exchange(&mut bench, false, false, None);
            assert_eq!(nothing, (false, false));
        }
        bench.hal.set(pin, true);
        assert_eq!(exchange(&mut bench, false, false, None), armed, "{pin}");
        assert!(!bench.stepgen.wants_value());
        let _ = exchange(&mut bench, flags.0, flags.1, None);
        assert!(bench.stepgen.wants_value(), "{pin}");
        let latched = exchange(&mut bench, flags.0, flags.1, Some(320));
        assert_eq!(latched, (false, false));
        assert!(!bench.hal.get::<bool>(pin) && !bench.stepgen.wants_value());
        let (count, place) = match flags.0 {
            // The index becomes the origin: the probe's place is counted from there.
            true => (320, 3.2),
            false => (0, 0.0),
        };
        assert_eq!(bench.hal.get::<i32>("s.count-latched"), count);
        assert_eq!(bench.hal.get::<f64>("s.position-latched"), place);
        assert_eq!(bench.hal.get::<i32>("s.counts"), 25);
    }
    // What the board may have forgotten is not fetched.
    bench.hal.set("s.probe-enable", true);
    for _ in 0..3 {
        let _ = exchange(&mut bench, false, false, None);
    }
    let _ = exchange(&mut bench, false, true, None);
    assert!(bench.stepgen.wants_value());
    bench.stepgen.forget_latch();
    assert!(!bench.stepgen.wants_value());
}

proptest! {
    #[test]
    fn no_more_is_asked_than_the_acceleration_reaches_in_a_period(
        velocity in -1e5..1e5f64, error in -1e4..1e4f64, feed_forward in -1e5..1e5f64, accel in 1.0..1e6f64
    ) {
        // A board that receives nothing more goes on with the last command.
        let now = Motion { position: 0.0, velocity };
        let given = approach(now, error, feed_forward, accel, 0.001);
        prop_assert!((given - velocity).abs() <= accel * 0.001 + 1e-6, "{} from {}", given, velocity);
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn any_jump_of_the_command_ends_on_its_pulse(
        steps in -3000..3000i64,
        scale in prop_oneof![Just(1.0), Just(-37.5), 10.0..4000.0f64],
        maxaccel in prop_oneof![Just(0.0), 2000.0..50_000.0f64],
    ) {
        let mut bench = Bench::new(scale, maxaccel / scale.abs());
        bench.hal.set("s.maxvel", 4000.0 / scale.abs());
        bench.hal.set("s.position-cmd", steps as f64 / scale);
        bench.settle(6000);
        prop_assert_eq!(bench.pulses(), steps);
        prop_assert_eq!(bench.fabric.velocity, 0);
    }
}
