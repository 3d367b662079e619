//! Motion segments, as the `segments` core plays them into the stepgens, and the integer model that
//! predicts every edge.
//!
//! A segment gives its duration, each axis' velocity at its end and the acceleration to it. The
//! stepgens' own integrators make the motion ([`crate::ramp`]); they keep the last bit from one
//! segment to the next.
//!
//! ```text
//! clock       0    1    2    3   ...  N-2  N-1      of a segment of N clocks
//! position    +v0  +v0  +v1  +v2      +vm' +vm      m = N-2 moves of at most `accel` towards `velocity`:
//! velocity    v0 ------|v1  |v2  ...  |vm ------    the first and the last clock belong to the commits (gateware/rtl/segments.sv)
//! ```
//!
//! A stepgen never passes its target. So a segment with sufficient acceleration ends at exactly its
//! velocity, a whole number, and a rounding error lasts no longer than its segment. The integrators
//! at the beginning and the segments determine every edge: [`Play::clock`] is the definition,
//! [`Play::after`] gives the same bits in closed form, [`Edges`] the clocks in which a step is due.
//! A pulse that has to wait for its pins' times (`steplen`, `dirsetup`) stops the time of all axes:
//! edges come later, but none changes.

use crate::ramp::{Ramp, VELOCITY_FRACTION};
use wire::units::{Accel, Position, Velocity};

pub use wire::jobs::AXES;

/// Words of a segment at the core's window.
pub const WORDS: usize = 2 + 2 * AXES;
/// The pace at which a clock of the path takes one clock: `segments.pace` counts in 1/65536.
pub const PACE_ONE: u32 = 1 << 16;

/// Its duration, the velocities at its end, and its outputs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Segment {
    /// Duration in clocks; at least [`MIN_CLOCKS`].
    pub clocks: u32,
    /// Velocity at its end: `f_clk / 2^32` steps/s, signed.
    pub velocity: [i32; AXES],
    /// By how much the velocities change in a clock: `f_clk^2 / 2^56` steps/s^2. 0 is at once.
    pub accel: [u32; AXES],
    /// The outputs, from the first clock on.
    pub aux: u16,
    /// A number that the core reports back, to identify the segment.
    pub tag: u16,
}

impl Segment {
    /// In the core's format: window words from 0 on, then the push.
    pub fn words(&self) -> [u32; WORDS] {
        let mut words = [0; WORDS];
        words[0] = self.clocks;
        words[1] = u32::from(self.tag) << 16 | u32::from(self.aux);
        for axis in 0..AXES {
            words[2 + 2 * axis] = self.velocity[axis] as u32;
            words[3 + 2 * axis] = self.accel[axis];
        }
        words
    }

    /// The segment for one axis.
    pub const fn play(&self, axis: usize) -> Play {
        Play {
            clocks: self.clocks,
            velocity: Velocity(self.velocity[axis]),
            accel: Accel(self.accel[axis]),
        }
    }
}

/// The shortest segment: about a microsecond, enough time for a core to fetch the next one.
pub const MIN_CLOCKS: u32 = 64;

/// Clocks of a segment in which no velocity changes.
pub const COMMIT_CLOCKS: u32 = 2;

/// The longest segment that accelerates. Its velocity is a whole number, so it is off by up to half
/// a unit in each clock; in 2^20 clocks (17 ms at 60 MHz) that makes 1.2e-4 steps, which the next
/// segment corrects.
pub const MAX_CLOCKS: u32 = 1 << 20;

/// The two integrators of one stepgen.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Axis {
    /// s32.32 steps; wraps like the register.
    pub position: i64,
    /// s32.24: units of `Velocity` with 24 more fraction bits.
    pub velocity: i64,
}

impl Default for Axis {
    fn default() -> Self {
        Axis::at(0)
    }
}

impl Axis {
    /// At rest in the middle of a step, as a stepgen after power-up.
    pub const fn at(step: i32) -> Self {
        Axis {
            position: ((step as i64) << 32) + Position::ZERO.0,
            velocity: 0,
        }
    }

    /// Steps emitted, signed.
    pub const fn steps(&self) -> i64 {
        self.position >> 32
    }

    /// A clock in which the velocity does not change.
    const fn hold(&mut self, clocks: u32) {
        let way = (self.velocity >> VELOCITY_FRACTION).wrapping_mul(clocks as i64);
        self.position = self.position.wrapping_add(way);
    }

    fn ramp(&self, play: &Play) -> Ramp {
        Ramp {
            position: self.position,
            velocity: self.velocity,
            target: play.velocity,
            accel: play.accel,
        }
    }
}

/// A segment as one axis plays it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Play {
    /// Duration in clocks.
    pub clocks: u32,
    /// The velocity at its end.
    pub velocity: Velocity,
    /// The change in a clock.
    pub accel: Accel,
}

impl Play {
    /// Clocks in which the velocity changes.
    const fn moves(&self) -> u32 {
        self.clocks.saturating_sub(COMMIT_CLOCKS)
    }

    /// Clock number `clock` (from 0): the definition.
    pub fn clock(&self, axis: &mut Axis, clock: u32) {
        if clock == 0 || clock > self.moves() {
            axis.hold(1);
        } else {
            let mut ramp = axis.ramp(self);
            ramp.clock();
            (axis.position, axis.velocity) = (ramp.position, ramp.velocity);
        }
    }

    /// The first `clocks` of its clocks at once, with the same result as that many calls of
    /// [`Play::clock`].
    pub fn after(&self, mut axis: Axis, clocks: u32) -> Axis {
        let clocks = clocks.min(self.clocks);
        let moves = clocks.saturating_sub(1).min(self.moves());
        axis.hold(clocks.min(1));
        let mut ramp = axis.ramp(self);
        ramp.advance(moves.into());
        (axis.position, axis.velocity) = (ramp.position, ramp.velocity);
        axis.hold(clocks.saturating_sub(1) - moves);
        axis
    }

    /// The clocks in which a step is due.
    pub fn edges(&self, axis: Axis) -> Edges {
        Edges {
            play: *self,
            begin: axis,
            axis,
            done: 0,
            turn: self.turn(&axis),
        }
    }

    /// The clock at which the direction changes; before it, and from it on, the position moves in
    /// one direction.
    fn turn(&self, axis: &Axis) -> u32 {
        let goal = i64::from(self.velocity.0) << VELOCITY_FRACTION;
        let (velocity, accel) = (axis.velocity, i64::from(self.accel.0));
        let moves = if (velocity < 0) == (goal < 0) {
            return self.clocks;
        } else if accel == 0 {
            1
        } else if velocity < 0 {
            velocity.unsigned_abs().div_ceil(accel as u64) as i64
        } else {
            velocity / accel + 1
        };
        // Clock 0 holds, and the clock after a move sees it.
        u32::try_from(moves + 1).map_or(self.clocks, |turn| turn.min(self.clocks))
    }
}

/// A step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Edge {
    /// The clock of the segment (from 0) that takes the position across the edge.
    pub clock: u32,
    /// In the direction of plus.
    pub forward: bool,
}

/// The edges of one axis in one segment, in order, found by bisection of the closed form.
#[derive(Clone, Debug)]
pub struct Edges {
    play: Play,
    begin: Axis,
    axis: Axis,
    done: u32,
    turn: u32,
}

impl Iterator for Edges {
    type Item = Edge;

    fn next(&mut self) -> Option<Edge> {
        while self.done < self.play.clocks {
            let here = self.axis.steps();
            let (mut low, mut high) = (
                self.done,
                if self.done < self.turn {
                    self.turn
                } else {
                    self.play.clocks
                },
            );
            let end = self.play.after(self.begin, high);
            if end.steps() == here {
                (self.axis, self.done) = (end, high);
                continue;
            }
            // After `low` clocks the position is still before the edge, after `high` no more.
            while high - low > 1 {
                let middle = low + (high - low) / 2;
                if self.play.after(self.begin, middle).steps() == here {
                    low = middle;
                } else {
                    high = middle;
                }
            }
            (self.axis, self.done) = (self.play.after(self.begin, high), high);
            return Some(Edge {
                clock: self.done - 1,
                forward: self.axis.steps() > here,
            });
        }
        None
    }
}

/// All axes and the outputs: the effect of a job on the machine.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct MotionState {
    /// The integrators.
    pub axes: [Axis; AXES],
    /// The outputs.
    pub aux: u16,
    /// Clocks since the beginning.
    pub clocks: u64,
}

impl MotionState {
    /// Executes a segment.
    pub fn run(&mut self, segment: &Segment) {
        *self = self.within(segment, segment.clocks);
    }

    /// The state after this many clocks of a segment that begins now.
    pub fn within(&self, segment: &Segment, clocks: u32) -> Self {
        let clocks = clocks.min(segment.clocks);
        MotionState {
            axes: core::array::from_fn(|axis| segment.play(axis).after(self.axes[axis], clocks)),
            aux: segment.aux,
            clocks: self.clocks + u64::from(clocks),
        }
    }

    /// Steps emitted by each axis.
    pub fn steps(&self) -> [i64; AXES] {
        self.axes.map(|axis| axis.steps())
    }

    /// All axes are at rest, to the last bit.
    pub fn rests(&self) -> bool {
        self.axes.iter().all(|axis| axis.velocity == 0)
    }
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use proptest::prelude::*;
    use std::vec::Vec;

    fn any_axis() -> impl Strategy<Value = Axis> {
        let velocity = prop_oneof![
            Just(0),
            Just(-1),
            Just(1),
            -1i64 << 30..1 << 30,
            -1i64 << 54..1 << 54
        ];
        // Far from the wrap, where a comparison would give a wrong direction.
        (-1i64 << 55..1 << 55, velocity)
            .prop_map(|(position, velocity)| Axis { position, velocity })
    }

    fn any_play() -> impl Strategy<Value = Play> {
        let velocity = prop_oneof![
            Just(0),
            -10..10i32,
            -1_000_000..1_000_000i32,
            -1i32 << 30..1 << 30
        ];
        let accel = prop_oneof![Just(0), 1..10u32, 1..1_000_000u32, any::<u32>()];
        (64..5000u32, velocity, accel).prop_map(|(clocks, velocity, accel)| Play {
            clocks,
            velocity: Velocity(velocity),
            accel: Accel(accel),
        })
    }

    fn edges_by_clock(play: &Play, mut axis: Axis) -> Vec<Edge> {
        let mut edges = Vec::new();
        for clock in 0..play.clocks {
            let before = axis.steps();
            play.clock(&mut axis, clock);
            match axis.steps() - before {
                0 => {}
                difference => edges.push(Edge {
                    clock,
                    forward: difference > 0,
                }),
            }
        }
        edges
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(500))]

        #[test]
        fn any_number_of_clocks_at_once_is_the_same_as_one_by_one(axis in any_axis(), play in any_play(), part in 0..5000u32) {
            let mut slow = axis;
            for clock in 0..part.min(play.clocks) {
                play.clock(&mut slow, clock);
            }
            prop_assert_eq!(play.after(axis, part), slow);
        }

        #[test]
        fn the_closed_form_finds_every_edge_and_its_clock(axis in any_axis(), play in any_play()) {
            prop_assert_eq!(play.edges(axis).collect::<Vec<_>>(), edges_by_clock(&play, axis));
        }
    }

    #[test]
    fn a_reversal_within_a_segment_gives_back_the_steps_it_took() {
        let axis = Axis {
            velocity: 1 << 50,
            ..Axis::at(0)
        };
        let play = Play {
            clocks: 1 << 21,
            velocity: Velocity(-(1 << 26)),
            accel: Accel(1 << 30),
        };
        let edges: Vec<Edge> = play.edges(axis).collect();
        let forward = edges.iter().filter(|edge| edge.forward).count();
        assert_eq!(edges, edges_by_clock(&play, axis));
        assert!(forward > 5 && forward * 2 <= edges.len(), "{edges:?}");
    }

    #[test]
    fn a_machine_rests_when_all_of_its_axes_do() {
        for axis in 0..AXES {
            let mut segment = Segment {
                clocks: 100,
                ..Segment::default()
            };
            segment.velocity[axis] = -1;
            let mut machine = MotionState::default();
            assert!(machine.rests());
            machine.run(&segment);
            assert!(!machine.rests(), "axis {axis} is on its way");
        }
    }

    #[test]
    fn a_segment_at_rest_is_a_dwell() {
        let mut machine = MotionState::default();
        machine.run(&Segment {
            clocks: u32::MAX,
            aux: 5,
            ..Segment::default()
        });
        assert!(machine.rests());
        assert_eq!((machine.steps(), machine.aux), ([0; AXES], 5));
        assert_eq!(machine.clocks, u64::from(u32::MAX));
    }

    #[test]
    fn the_words_are_where_the_core_has_them() {
        let segment = Segment {
            clocks: 1000,
            velocity: [1, -1, 3],
            accel: [4, 5, 6],
            aux: 0x8001,
            tag: 7,
        };
        let words = [1000, 0x7_8001, 1, 4, u32::MAX, 5, 3, 6];
        assert_eq!(segment.words(), words);
    }
}
