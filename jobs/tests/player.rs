//! The bounds of FPGA G's words, for random limits and random instructions: no accepted instruction
//! leaves the limits, even if no other follows and every motor has to brake from where it is.

use jobs::fpgag::{Curve, Error, Move};
use jobs::player::{Limits, Player, Word};
use motion::ramp::Ramp;
use motion::segment::{AXES, Axis, MotionState};
use proptest::prelude::*;
use wire::units::{Accel, Position, Velocity};

const CLOCK: u32 = 60_000_000;

/// Where a motor comes to rest if it brakes from here with its limit.
fn braked(axis: &Axis, accel: u32) -> i64 {
    let mut ramp = Ramp {
        position: axis.position,
        velocity: axis.velocity,
        target: Velocity(0),
        accel: Accel(accel),
    };
    // The last velocity holds until the core sees that no segment follows.
    ramp.position += (axis.velocity >> 24) * 3;
    ramp.advance(ramp.clocks_to_target());
    ramp.position >> 32
}

fn limits() -> impl Strategy<Value = Limits> {
    // steps/s^2 over two decades, and bounds near home.
    let axis = || {
        (
            20_000u64..2_000_000,
            1000u32..60_000,
            0i64..2000,
            1i64..2000,
        )
    };
    [axis(), axis(), axis()].prop_map(|axes| {
        let clock = u128::from(CLOCK);
        Limits {
            clock_hz: CLOCK,
            accel: axes.map(|axis| ((u128::from(axis.0) << 56) / clock / clock) as u32),
            speed: axes.map(|axis| axis.1),
            bounds: axes.map(|axis| (-axis.2, axis.3)),
        }
    })
}

fn moves() -> impl Strategy<Value = Word> {
    let loops = || prop_oneof![Just(0u16), 1..200u16, 200..2000u16];
    let accel = || 1..4000u16;
    (any::<u8>(), accel(), loops(), loops(), accel(), loops()).prop_map(|all| {
        let (direction, acceleration, loops_accel, loops_travel, deceleration, loops_decel) = all;
        Word::Move(Move {
            direction: direction & 0x77,
            aux: 0,
            acceleration,
            loops_accel,
            loops_travel,
            deceleration,
            loops_decel,
        })
    })
}

fn curves() -> impl Strategy<Value = Word> {
    let motor = || {
        (-20_000_000..20_000_000i32, -20_000..20_000i32, -20..20i32)
            .prop_map(|(c0, c1, c2)| [c0, c1, c2])
    };
    let smooth = || (-40_000..40_000i32).prop_map(|c1| [0, c1, 0]);
    let any = || prop_oneof![motor(), smooth(), Just([0; 3])];
    (1..=1100u16, [any(), any(), any()]).prop_map(|(ticks, motors)| {
        Word::Curve(Curve {
            aux: 0,
            ticks,
            motors,
        })
    })
}

/// A curve that continues at the final speed of the last one, if that was a curve.
fn joined(last: Option<&Word>, word: Word) -> Word {
    let (Some(Word::Curve(last)), Word::Curve(mut curve)) = (last, word) else {
        return word;
    };
    let t = i64::from(last.ticks);
    for (motor, [c0, c1, c2]) in curve.motors.iter_mut().zip(last.motors) {
        let [c0, c1, c2] = [c0, c1, c2].map(i64::from);
        let speed = c0 + 2 * c1 * t + 3 * c2 * t * t;
        motor[0] = speed.clamp(-1 << 30, 1 << 30) as i32;
    }
    Word::Curve(curve)
}

fn outside(machine: &MotionState, limits: &Limits) -> Option<(usize, i64)> {
    (0..AXES).find_map(|axis| {
        let stands = braked(&machine.axes[axis], limits.accel[axis]);
        let (lowest, highest) = limits.bounds[axis];
        let here = machine.axes[axis].steps();
        [here, stands]
            .into_iter()
            .find(|step| *step < lowest || *step > highest)
            .map(|step| (axis, step))
    })
}

fn play(limits: Limits, words: &[Word]) -> Result<(usize, u64), TestCaseError> {
    let mut player = Player::<64>::new(limits, [Position::ZERO.0; AXES]);
    let (mut accepted, mut last, mut clocks) = (0, None, 0);
    for word in words {
        let word = joined(last.as_ref(), *word);
        if player.push(word).is_err() {
            continue;
        }
        accepted += 1;
        last = Some(word);
        // One at a time, so that the queue runs empty after each.
        loop {
            let before = *player.machine();
            let Some(segment) = player.poll(true) else {
                break;
            };
            clocks += u64::from(segment.clocks);
            for part in 1..=8u64 {
                let within = (u64::from(segment.clocks) * part / 8) as u32;
                let machine = before.within(&segment, within);
                if let Some((axis, step)) = outside(&machine, &limits) {
                    return Err(TestCaseError::fail(format!(
                        "axis {axis} at {step} of {:?} in {word:?}",
                        limits.bounds[axis]
                    )));
                }
            }
        }
    }
    Ok((accepted, clocks))
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]

    #[test]
    fn moves_that_are_accepted_can_stop_within_the_limits_from_everywhere(limits in limits(), words in prop::collection::vec(moves(), 1..60)) {
        play(limits, &words)?;
    }

    #[test]
    fn curves_that_are_accepted_can_stop_within_the_limits_from_everywhere(limits in limits(), words in prop::collection::vec(curves(), 1..60)) {
        play(limits, &words)?;
    }
}

/// Both ends of the curve are within the limits, and the queue may run empty at either; the part in
/// between is not.
#[test]
fn a_curve_that_leaves_the_limits_and_comes_back_is_refused() {
    let of = |c0: i64, c1: i64| Curve {
        aux: 0,
        ticks: 1000,
        motors: [[c0 as i32, c1 as i32, 0], [0; 3], [0; 3]],
    };
    // 0.08 steps a tick: it takes 40 steps to reach that, 15 to brake from it, and 20 to turn in
    // 1000 ticks.
    let speed = (8i64 << 31) / 100;
    let (there, back) = (of(0, speed / 2000), of(speed, -speed / 1000));
    let play = |highest| {
        let limits = Limits {
            clock_hz: CLOCK,
            accel: [u32::MAX; AXES],
            speed: [1_000_000; AXES],
            bounds: [(-1000, highest); AXES],
        };
        let mut player = Player::<4>::new(limits, [Position::ZERO.0; AXES]);
        assert_eq!(player.push(Word::Curve(there)), Ok(()));
        player.push(Word::Curve(back))
    };
    assert_eq!(play(58), Err(Error::Bounds));
    assert_eq!(play(62), Ok(()));
}

/// An ordinary program brakes to a stand on the limit itself, with no more than its largest
/// deceleration.
#[test]
fn a_move_that_stands_on_the_limit_is_accepted_in_one_piece_and_in_two() {
    let accel = ((2_000_000u128 << 56) / u128::from(CLOCK) / u128::from(CLOCK)) as u32;
    let limits = Limits {
        clock_hz: CLOCK,
        accel: [accel; AXES],
        speed: [100_000; AXES],
        bounds: [(-500, 500); AXES],
    };
    // 31 249 units of 64 are 1 999 936 steps/s^2: the largest value below the limit.
    for unit in [100, 10_000, 31_240] {
        for direction in [0, 7] {
            let whole = Move {
                direction,
                aux: 0,
                acceleration: unit,
                loops_accel: 200,
                loops_travel: 100,
                deceleration: unit,
                loops_decel: 200,
            };
            let (first, second) = (
                Move {
                    loops_decel: 0,
                    ..whole
                },
                Move {
                    loops_accel: 0,
                    loops_travel: 0,
                    ..whole
                },
            );
            for words in [vec![whole], vec![first, second]] {
                let mut player = Player::<4>::new(limits, [Position::ZERO.0; AXES]);
                for word in words {
                    assert_eq!(player.push(Word::Move(word)), Ok(()), "{unit} {word:?}");
                }
            }
        }
    }
}
