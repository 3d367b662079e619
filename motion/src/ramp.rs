//! One stepgen's velocity ramp and phase accumulator, exact to the last bit.
//!
//! ```text
//! every clock:   position += floor(velocity / 2^24)                      s32.32 += s32
//!                velocity += clamp(target - velocity, -accel, +accel)    s32.24
//! ```
//!
//! [`Ramp::clock`] is that definition. [`Ramp::advance`] gives the same bits for any number of
//! clocks in a few dozen operations: a ramp is an arithmetic progression, and a sum of floors of
//! one has a closed form ([`sum_of_floors`]).
//!
//! A new command reaches the ramp [`COMMIT_CLOCKS`] clocks after the strobe that carries it; the
//! same strobe samples position and velocity. So a status block and the command it answers
//! determine the future: [`Ramp::predict`].

use crate::wide::{product, quotient_up, short};
use wire::units::{Accel, Clocks, Position, Velocity};

/// Fraction bits of the velocity below the last bit of the position.
pub const VELOCITY_FRACTION: u32 = 24;

/// Clocks from the commit strobe (that clock included) in which the velocity does not move yet: one
/// to take the target, one to find its direction. `gateware/rtl/stepgen.sv`.
pub const COMMIT_CLOCKS: u64 = 2;

/// Position, velocity and the velocity's target.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Ramp {
    /// Phase accumulator, s32.32 steps; wraps like the register.
    pub position: i64,
    /// Present velocity, s32.24: [`Velocity`] units with 24 more fraction bits.
    pub velocity: i64,
    /// Velocity it moves towards.
    pub target: Velocity,
    /// By at most this much per clock.
    pub accel: Accel,
}

impl Default for Ramp {
    fn default() -> Self {
        Ramp {
            position: Position::ZERO.0,
            velocity: 0,
            target: Velocity(0),
            accel: Accel::UNLIMITED,
        }
    }
}

impl Ramp {
    /// A stepgen's position `clocks` after a strobe that sampled `position` and `velocity` and
    /// committed `target` and `accel`. The sample contains only the velocity's integer part, so the
    /// result is short by less than one unit of velocity.
    pub fn predict(
        position: Position,
        velocity: Velocity,
        target: Velocity,
        accel: Accel,
        clocks: Clocks,
    ) -> Ramp {
        let mut ramp = Ramp {
            position: position.0,
            velocity: i64::from(velocity.0) << VELOCITY_FRACTION,
            target: velocity,
            accel,
        };
        let before = clocks.0.min(COMMIT_CLOCKS);
        ramp.advance(before);
        ramp.target = target;
        ramp.advance(clocks.0 - before);
        ramp
    }

    /// The velocity's integer part: what a status block carries.
    pub const fn velocity(&self) -> Velocity {
        Velocity((self.velocity >> VELOCITY_FRACTION) as i32)
    }

    /// One clock: the definition.
    pub const fn clock(&mut self) {
        self.position = self
            .position
            .wrapping_add(self.velocity >> VELOCITY_FRACTION);
        self.velocity = self.next_velocity();
    }

    /// `clocks` clocks at once, with the same result as that many calls of [`Ramp::clock`].
    pub fn advance(&mut self, clocks: u64) {
        let moving = self.clocks_to_target().min(clocks);
        self.advance_moving(moving);
        let steady = ((clocks - moving) as i64).wrapping_mul(self.velocity >> VELOCITY_FRACTION);
        self.position = self.position.wrapping_add(steady);
    }

    /// Clocks until the velocity has reached its target.
    pub fn clocks_to_target(&self) -> u64 {
        let away = self.goal().abs_diff(self.velocity);
        match self.accel.0 {
            0 => u64::from(away != 0),
            accel => quotient_up(away, accel.into()),
        }
    }

    const fn goal(&self) -> i64 {
        (self.target.0 as i64) << VELOCITY_FRACTION
    }

    const fn next_velocity(&self) -> i64 {
        let goal = self.goal();
        let away = goal - self.velocity;
        let limit = self.accel.0 as i64;
        if limit == 0 || away.abs() <= limit {
            goal
        } else {
            self.velocity + away.signum() * limit
        }
    }

    /// At most [`Ramp::clocks_to_target`] clocks: all but the last of them move by exactly `accel`.
    fn advance_moving(&mut self, clocks: u64) {
        if clocks == 0 {
            return;
        }
        let away = self.goal() - self.velocity;
        let per_clock = away.signum() * i64::from(self.accel.0);
        let travelled = sum_of_floors(clocks, self.velocity, per_clock);
        self.position = self.position.wrapping_add(travelled);
        self.velocity += per_clock * (clocks - 1) as i64;
        self.velocity = self.next_velocity();
    }
}

/// `sum of floor((start + i * step) / 2^24) for i in 0..terms`, its lowest 64 bits.
///
/// The quotients of `start` and `step` come out of the floor at once; the rest counts lattice
/// points under a line and shrinks as in Euclid's algorithm. With 24 bits that ends after at most
/// about 35 rounds. It is valid for `terms` below 2^40 (five hours of clocks).
pub fn sum_of_floors(terms: u64, start: i64, step: i64) -> i64 {
    let rest = |x: i64| (x & ((1 << VELOCITY_FRACTION) - 1)) as u32;
    let [low, high] = product(terms, terms.wrapping_sub(1));
    let pairs = (low >> 1 | high << 63) as i64;
    let sum = pairs.wrapping_mul(step >> VELOCITY_FRACTION);
    let sum = sum.wrapping_add((terms as i64).wrapping_mul(start >> VELOCITY_FRACTION));
    let (start, step) = (rest(start), rest(step));
    if step == 0 {
        return sum;
    }
    // A softcore has to compute this for every segment, and no segment that accelerates is longer.
    sum.wrapping_add(match u32::try_from(terms) {
        Ok(terms) if terms >> 31 == 0 => lattice_points(terms, start, step) as i64,
        _ => wide_lattice_points(terms, start.into(), step.into()) as i64,
    })
}

/// `sum of floor((start + i * step) / 2^24)` of fractions: `start` and `step` below 2^24.
fn lattice_points(mut terms: u32, mut start: u32, mut step: u32) -> u64 {
    let mut modulus = 1u32 << VELOCITY_FRACTION;
    let mut sum = 0u64;
    loop {
        let top = u64::from(step) * u64::from(terms) + u64::from(start);
        if top < modulus.into() {
            return sum;
        }
        // `step` is less than `modulus`: there are no more of them than of terms.
        (terms, start) = short(top, modulus);
        (modulus, step) = (step, modulus);
        // Now the line is steeper than 1: the whole part comes out.
        let pairs = u64::from(terms) * u64::from(terms.wrapping_sub(1)) / 2;
        sum += pairs * u64::from(step / modulus) + u64::from(terms) * u64::from(start / modulus);
        step %= modulus;
        start %= modulus;
    }
}

fn wide_lattice_points(terms: u64, start: u64, step: u64) -> i128 {
    let (mut terms, mut start, mut step) = (i128::from(terms), i128::from(start), i128::from(step));
    let mut modulus = 1i128 << VELOCITY_FRACTION;
    let mut sum = 0;
    loop {
        let top = step * terms + start;
        if top < modulus {
            return sum;
        }
        terms = top / modulus;
        start = top % modulus;
        (modulus, step) = (step, modulus);
        sum += (terms - 1) * terms / 2 * (step / modulus) + terms * (start / modulus);
        step %= modulus;
        start %= modulus;
    }
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use proptest::prelude::*;

    fn by_clock(mut ramp: Ramp, clocks: u64) -> Ramp {
        for _ in 0..clocks {
            ramp.clock();
        }
        ramp
    }

    /// The definition, term by term.
    fn floors_one_by_one(terms: u64, start: i64, step: i64) -> i128 {
        (0..i128::from(terms))
            .map(|i| (i128::from(start) + i * i128::from(step)) >> VELOCITY_FRACTION)
            .sum()
    }

    fn at_once(mut ramp: Ramp, clocks: u64) -> Ramp {
        ramp.advance(clocks);
        ramp
    }

    fn any_ramp() -> impl Strategy<Value = Ramp> {
        let velocity = prop_oneof![
            Just(0),
            Just(1),
            Just(-1),
            Just(i32::MAX),
            Just(-i32::MAX),
            -100_000..100_000i32,
            -i32::MAX..=i32::MAX
        ];
        let accel = prop_oneof![
            Just(0),
            Just(1),
            Just(u32::MAX),
            1..1000u32,
            1..50_000_000u32,
            1..=u32::MAX
        ];
        (
            any::<i64>(),
            velocity.clone(),
            0..1i64 << VELOCITY_FRACTION,
            velocity,
            accel,
        )
            .prop_map(|(position, velocity, fraction, target, accel)| Ramp {
                position,
                velocity: (i64::from(velocity) << VELOCITY_FRACTION) + fraction,
                target: Velocity(target),
                accel: Accel(accel),
            })
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(2000))]

        #[test]
        fn any_number_of_clocks_at_once_is_the_same_as_one_by_one(ramp in any_ramp(), clocks in 0..3000u64) {
            prop_assert_eq!(at_once(ramp, clocks), by_clock(ramp, clocks));
        }

        #[test]
        fn two_advances_are_one(ramp in any_ramp(), first in 0..1u64 << 30, second in 0..1u64 << 30) {
            prop_assert_eq!(at_once(at_once(ramp, first), second), at_once(ramp, first + second));
        }

        #[test]
        fn the_velocity_never_moves_faster_than_the_limit_nor_past_the_target(ramp in any_ramp(), clocks in 0..10_000u64) {
            let after = at_once(ramp, clocks);
            if ramp.accel.0 != 0 {
                let most = u128::from(clocks) * u128::from(ramp.accel.0);
                prop_assert!(u128::from(after.velocity.abs_diff(ramp.velocity)) <= most);
            }
            let side = |velocity: i64| (ramp.goal() - velocity).signum();
            prop_assert!(side(after.velocity) == 0 || side(after.velocity) == side(ramp.velocity));
        }
    }

    proptest! {
        #[test]
        fn sums_of_floors_are_the_sums_of_the_floors(terms in 0..2000u64, start in -1i64 << 55..1 << 55, step in -1i64 << 32..1 << 32) {
            prop_assert_eq!(sum_of_floors(terms, start, step), floors_one_by_one(terms, start, step) as i64);
        }

        #[test]
        fn the_way_in_64_bits_is_the_wide_way(terms in 1..1u32 << 31, start in 0..1u32 << VELOCITY_FRACTION, step in 1..1u32 << VELOCITY_FRACTION) {
            prop_assert_eq!(i128::from(lattice_points(terms, start, step)), wide_lattice_points(terms.into(), start.into(), step.into()));
        }
    }

    #[test]
    fn a_servo_period_at_60_mhz_is_exact() {
        let ramp = Ramp {
            target: Velocity(1_431_655),
            accel: Accel(700),
            ..Ramp::default()
        };
        assert_eq!(at_once(ramp, 60_000), by_clock(ramp, 60_000));
    }

    #[test]
    fn without_a_limit_the_velocity_jumps_after_one_clock_at_the_old_one() {
        let mut ramp = Ramp {
            target: Velocity(1000),
            ..Ramp::default()
        };
        ramp.clock();
        assert_eq!(
            (ramp.position, ramp.velocity()),
            (0x8000_0000, Velocity(1000))
        );
        ramp.clock();
        assert_eq!(ramp.position, 0x8000_0000 + 1000);
    }

    #[test]
    fn a_stop_ends_exactly_at_rest_and_stays_there() {
        let mut ramp = Ramp {
            velocity: (12_345i64 << VELOCITY_FRACTION) + 77,
            accel: Accel(1000),
            ..Ramp::default()
        };
        ramp.advance(ramp.clocks_to_target());
        assert_eq!(ramp.velocity, 0);
        let rest = ramp.position;
        ramp.advance(1 << 40);
        assert_eq!(ramp.position, rest);
    }

    #[test]
    fn a_prediction_keeps_the_old_velocity_for_the_commit_clocks() {
        let predict = |clocks| {
            Ramp::predict(
                Position::ZERO,
                Velocity(10),
                Velocity(1000),
                Accel::UNLIMITED,
                Clocks(clocks),
            )
            .position
                - Position::ZERO.0
        };
        assert_eq!(
            [predict(0), predict(1), predict(2), predict(3), predict(4)],
            [0, 10, 20, 30, 1030]
        );
    }

    #[test]
    fn a_position_wraps_like_the_register() {
        let mut ramp = Ramp {
            position: i64::MAX,
            velocity: 1 << VELOCITY_FRACTION,
            target: Velocity(1),
            ..Ramp::default()
        };
        ramp.advance(1);
        assert_eq!(ramp.position, i64::MIN);
    }
}
