//! Arcs as chords, with integers only.
//!
//! The middle of a chord is `r (1 - cos(angle / 2)) <= r angle^2 / 8` inside the arc, so chords of
//! `sqrt(8 tolerance / r)` keep the tolerance. Their ends are on the arc to a nanometre, because
//! each is computed from the centre and none from the one before. The planner cuts the corners
//! between chords by less than the chords cut the arc.

use crate::instruction::{Arc, Place};
use motion::wide::{product, quotient, quotient_up, root, scaled, wide};

/// One turn is 2^56 of these units.
type Angle = i64;
const TURN: Angle = 1 << 56;

/// `atan(2^-i)`, in 2^-56 turns.
const ARCTAN: [i64; 48] = [
    0x20000000000000,
    0x12e4051d9df308,
    0x9fb385b5ee39f,
    0x51111d41ddd9a,
    0x28b0d430e589b,
    0x145d7e1590462,
    0xa2f61e5c2826,
    0x517c5511d443,
    0x28be5346d0c3,
    0x145f2ebb30ab,
    0xa2f980091ba,
    0x517cc14a80d,
    0x28be60cdfec,
    0x145f306c173,
    0xa2f9836ae9,
    0x517cc1b6ba,
    0x28be60db86,
    0x145f306dc8,
    0xa2f9836e5,
    0x517cc1b72,
    0x28be60db9,
    0x145f306dd,
    0xa2f9836e,
    0x517cc1b7,
    0x28be60dc,
    0x145f306e,
    0xa2f9837,
    0x517cc1b,
    0x28be60e,
    0x145f307,
    0xa2f983,
    0x517cc2,
    0x28be61,
    0x145f30,
    0xa2f98,
    0x517cc,
    0x28be6,
    0x145f3,
    0xa2fa,
    0x517d,
    0x28be,
    0x145f,
    0xa30,
    0x518,
    0x28c,
    0x146,
    0xa3,
    0x51,
];

/// The length to which 48 rounds of CORDIC shrink a vector of length 1: 2^60 times 0.607.
const SHRUNK: i64 = 700_114_967_507_363_238;

/// After this many rounds the remaining angle is below 2^-24.
const ROUNDS: usize = 26;

/// `2 pi * 2^40`.
const TWO_PI_40: i64 = 6_908_559_991_273;

/// `2 pi * 2^16`, rounded up: better one chord too many.
const TWO_PI_16: u64 = 411_775;

/// No chord turns by more than a twelfth of a circle, whatever the tolerance: so a plotter's
/// smallest arc is round.
const LEAST_PER_TURN: u64 = 12;

/// Direction of a vector: 0 is +X, a quarter turn +Y. 0 for the null vector.
fn direction(x: i64, y: i64) -> Angle {
    // Into the right half plane, then scaled up as far as the growth by 1.65 in the rounds allows.
    let (mut x, mut y, mut angle) = if x < 0 { (-x, -y, TURN / 2) } else { (x, y, 0) };
    let room = (x | y.abs()).leading_zeros().saturating_sub(3);
    (x, y) = (x << room, y << room);
    if (x, y) == (0, 0) {
        return 0;
    }
    for (i, arctan) in ARCTAN.iter().enumerate() {
        if y > 0 {
            (x, y, angle) = (x + (y >> i), y - (x >> i), angle + arctan);
        } else {
            (x, y, angle) = (x - (y >> i), y + (x >> i), angle - arctan);
        }
    }
    angle.rem_euclid(TURN)
}

/// Cosine and sine, 2^60 times.
fn unit(angle: Angle) -> [i64; 2] {
    // The rounds reach a quarter turn to either side.
    let angle = angle.rem_euclid(TURN);
    let half = angle > TURN / 4 && angle <= TURN / 4 * 3;
    let mut left = if half {
        angle - TURN / 2
    } else if angle > TURN / 4 * 3 {
        angle - TURN
    } else {
        angle
    };
    let (mut x, mut y) = (SHRUNK, 0i64);
    for (i, arctan) in ARCTAN.iter().enumerate().take(ROUNDS) {
        if left >= 0 {
            (x, y, left) = (x - (y >> i), y + (x >> i), left - arctan);
        } else {
            (x, y, left) = (x + (y >> i), y - (x >> i), left + arctan);
        }
    }
    // The remaining angle is so small that it equals its sine, and half of its square is 0.
    let left = scaled(left, TWO_PI_40, 36);
    (x, y) = (x - scaled(y, left, 60), y + scaled(x, left, 60));
    if half { [-x, -y] } else { [x, y] }
}

/// `sqrt(x^2 + y^2)` to the nearest, of numbers below 2^61.
pub(crate) fn hypot(x: i64, y: i64) -> i64 {
    let square = |part: i64| product(part.unsigned_abs(), part.unsigned_abs());
    let ([x0, x1], [y0, y1]) = (square(x), square(y));
    let (low, carry) = x0.overflowing_add(y0);
    let high = x1.wrapping_add(y1).wrapping_add(carry.into());
    // Twice the root, then rounded by the last bit.
    root([low << 2, high << 2 | low >> 62]).div_ceil(2) as i64
}

/// The ends of an arc's chords; the last one is the arc's own end.
#[derive(Clone, Debug)]
pub struct Chords {
    from: Place,
    arc: Arc,
    /// Directions from the centre.
    begin: Angle,
    sweep: Angle,
    /// Distances from the centre: an arc may end a little nearer or farther than it began.
    radii: [i64; 2],
    done: u32,
    count: u32,
}

impl Chords {
    /// The chords of the arc that begins at `from`, no further than `tolerance` nm from it.
    pub fn new(from: Place, arc: Arc, tolerance: u32) -> Chords {
        let seen = |place: Place| [place[0] - arc.center[0], place[1] - arc.center[1]];
        let (first, last) = (seen(from), seen(arc.to));
        let radii = [hypot(first[0], first[1]), hypot(last[0], last[1])];
        let begin = direction(first[0], first[1]);
        let turned = direction(last[0], last[1]) - begin;
        let full = first == last;
        let sweep = match (arc.clockwise, full) {
            (_, true) => TURN,
            (false, false) => turned.rem_euclid(TURN),
            (true, false) => (-turned).rem_euclid(TURN),
        };
        Chords {
            from,
            arc,
            begin,
            sweep: if arc.clockwise { -sweep } else { sweep },
            radii,
            done: 0,
            count: count(sweep, radii[0].max(radii[1]), tolerance),
        }
    }

    /// The number of chords.
    pub fn count(&self) -> u32 {
        self.count
    }

    /// The length of the arc, in nm; for a helix, the length seen from above.
    pub fn length(&self) -> u64 {
        let radius = self.radius().unsigned_abs();
        let [low, high] = product(radius, self.sweep.unsigned_abs());
        // 2 pi with 16 fraction bits.
        let [low, high] = product(high << 32 | low >> 32, TWO_PI_16);
        high << 24 | low >> 40
    }

    /// The largest distance from the centre.
    pub fn radius(&self) -> i64 {
        self.radii[0].max(self.radii[1])
    }

    fn end(&self, index: u32) -> Place {
        let part = |whole: i64| {
            let all = product(whole.unsigned_abs(), index.into());
            let size = wide(all, self.count.into()) as i64;
            if whole < 0 { -size } else { size }
        };
        let radius = self.radii[0] + part(self.radii[1] - self.radii[0]);
        let [x, y] =
            unit(self.begin + part(self.sweep)).map(|unit| (scaled(radius, unit, 59) + 1) >> 1);
        let z = self.from[2] + part(self.arc.to[2] - self.from[2]);
        [self.arc.center[0] + x, self.arc.center[1] + y, z]
    }
}

impl Iterator for Chords {
    type Item = Place;

    fn next(&mut self) -> Option<Place> {
        if self.done == self.count {
            return None;
        }
        self.done += 1;
        Some(if self.done == self.count {
            self.arc.to
        } else {
            self.end(self.done)
        })
    }
}

/// Chords for an arc of this radius, at least one.
fn count(sweep: Angle, radius: i64, tolerance: u32) -> u32 {
    let sweep = sweep.unsigned_abs();
    // sqrt(r / 8 tolerance), 2^20 times, rounded up.
    let (radius, by) = (radius.unsigned_abs(), 8 * u64::from(tolerance.max(1)));
    let high = quotient(radius >> 24, by);
    let low = wide([radius << 40, (radius >> 24).wrapping_sub(high * by)], by);
    let fineness = root([low, high]) + 1;
    // The arc's turn in this unit, as a part of a full turn: 2^92 for each chord, rounded up.
    let [first, second] = product(sweep, TWO_PI_16);
    let [low, middle] = product(first, fineness);
    let high = middle + second * fineness;
    let fine = (high >> 28) + u64::from(high << 36 != 0 || low != 0);
    let coarse = quotient_up(sweep * LEAST_PER_TURN, TURN as u64);
    fine.max(coarse).clamp(1, u32::MAX.into()) as u32
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use crate::instruction::Feed;
    use proptest::prelude::*;
    use std::f64::consts::TAU;
    use std::vec::Vec;

    fn arc(to: Place, center: [i64; 2], clockwise: bool) -> Arc {
        Arc {
            to,
            center,
            clockwise,
            feed: Feed::Rapid,
        }
    }

    fn radius_of(place: Place, center: [i64; 2]) -> f64 {
        ((place[0] - center[0]) as f64).hypot((place[1] - center[1]) as f64)
    }

    proptest! {
        #[test]
        fn lengths_and_counts_are_those_of_wider_numbers(
            x in -1i64 << 36..1 << 36, y in -1i64 << 36..1 << 36, sweep in 0..=TURN, tolerance: u32, less in 0u32..32,
        ) {
            let (x, y, tolerance) = (x >> less, y >> less, tolerance >> less);
            let square = u128::from(x.unsigned_abs()).pow(2) + u128::from(y.unsigned_abs()).pow(2);
            let radius = hypot(x, y);
            prop_assert_eq!(radius as u128, (4 * square).isqrt().div_ceil(2));
            let (turns, two_pi) = (sweep as u128, u128::from(TWO_PI_16));
            let root = (((radius as u128) << 40) / (8 * u128::from(tolerance.max(1)))).isqrt() + 1;
            let fine = (turns * two_pi * root).div_ceil(1 << (56 + 16 + 20));
            let coarse = (turns * u128::from(LEAST_PER_TURN)).div_ceil(TURN as u128);
            prop_assert_eq!(u128::from(count(sweep, radius, tolerance)), fine.max(coarse).clamp(1, u32::MAX.into()));
            let chords = Chords { sweep: -sweep, radii: [radius; 2], ..Chords::new([0; 3], arc([1, 0, 0], [0, 0], true), 1) };
            prop_assert_eq!(u128::from(chords.length()), ((((radius as u128) * turns) >> 32) * two_pi) >> 40);
        }

        #[test]
        fn directions_and_units_agree_with_the_library(x in -1i64 << 34..1 << 34, y in -1i64 << 34..1 << 34) {
            prop_assume!((x, y) != (0, 0));
            let expected = (y as f64).atan2(x as f64).rem_euclid(TAU);
            let angle = direction(x, y) as f64 / TURN as f64 * TAU;
            let off = (angle - expected).abs();
            prop_assert!(off.min(TAU - off) < 1e-12, "{angle} for {expected}");
            let [cosine, sine] = unit(direction(x, y)).map(|unit| unit as f64 / (1i64 << 60) as f64);
            prop_assert!((cosine - expected.cos()).abs() < 1e-12 && (sine - expected.sin()).abs() < 1e-12);
        }

        #[test]
        fn every_chord_keeps_the_tolerance_and_the_last_ends_at_the_end(
            radius in 1_000i64..2_000_000_000, begin in 0.0..TAU, sweep in 0.0001..TAU, clockwise: bool, tolerance in 1_000u32..100_000,
        ) {
            let at = |angle: f64| [(radius as f64 * angle.cos()).round() as i64, (radius as f64 * angle.sin()).round() as i64, 0];
            let from = at(begin);
            let to = at(if clockwise { begin - sweep } else { begin + sweep });
            prop_assume!(from != to);
            let mut before = from;
            let mut length = 0.0;
            for place in Chords::new(from, arc(to, [0, 0], clockwise), tolerance) {
                let middle = [(before[0] + place[0]) / 2, (before[1] + place[1]) / 2, 0];
                let inside = radius as f64 - radius_of(middle, [0, 0]);
                prop_assert!(inside <= f64::from(tolerance) + 3.0 && inside >= -3.0, "{inside} nm off");
                prop_assert!((radius_of(place, [0, 0]) - radius as f64).abs() < 3.0);
                length += ((place[0] - before[0]) as f64).hypot((place[1] - before[1]) as f64);
                before = place;
            }
            prop_assert_eq!(before, to);
            // The arc turned in the commanded direction, not the other one.
            let whole = radius as f64 * sweep;
            prop_assert!(length <= whole + 10.0 && length >= whole * 0.98 - 10.0, "{} of {}", length, whole);
        }
    }

    #[test]
    fn an_arc_that_ends_where_it_begins_is_a_full_circle_both_ways() {
        for clockwise in [false, true] {
            let from = [10_000_000, 0, 0];
            let chords: Vec<Place> =
                Chords::new(from, arc(from, [0, 0], clockwise), 10_000).collect();
            assert!(chords.len() > 60, "{} chords", chords.len());
            assert_eq!(chords.last(), Some(&from));
            let quarter = chords[chords.len() / 4];
            assert_eq!(quarter[1] > 9_000_000, !clockwise, "{quarter:?}");
        }
    }

    #[test]
    fn arcs_of_two_degrees_and_less_are_arcs() {
        // 100 mm, 2 degrees: 15 um high. A single chord would miss a tolerance of 1 um.
        for degrees in [2.0f64, 1.0, 0.5, 0.01] {
            let angle = degrees.to_radians();
            let to = [
                (1e8 * angle.cos()).round() as i64,
                (1e8 * angle.sin()).round() as i64,
                0,
            ];
            let chords: Vec<Place> =
                Chords::new([100_000_000, 0, 0], arc(to, [0, 0], false), 1_000).collect();
            let height = 1e8 * (1.0 - (angle / 2.0).cos());
            assert_eq!(
                chords.len() > 1,
                height > 1_000.0,
                "{degrees}: {height} nm high, {chords:?}"
            );
            assert!(
                chords
                    .iter()
                    .all(|place| (radius_of(*place, [0, 0]) - 1e8).abs() < 2.0)
            );
            assert_eq!(chords.last(), Some(&to));
        }
    }

    #[test]
    fn a_helix_climbs_evenly() {
        let from = [5_000_000, 0, 0];
        let chords: Vec<Place> =
            Chords::new(from, arc([5_000_000, 0, -1_000_000], [0, 0], false), 5_000).collect();
        let step = 1_000_000 / chords.len() as i64;
        let mut before = 0;
        for place in &chords {
            assert!((before - place[2] - step).abs() <= 1, "{place:?}");
            before = place[2];
        }
        assert_eq!(before, -1_000_000);
    }

    #[test]
    fn a_tiny_circle_is_round_still() {
        let chords = Chords::new([1_000, 0, 0], arc([1_000, 0, 0], [0, 0], true), 100_000);
        assert_eq!(chords.count(), 12);
    }
}
