//! Motion segments, as the `segments` core executes them, and the integer model that predicts every edge.
//!
//! A segment says for how many clocks each axis accelerates by how much. There is no velocity in it and no
//! target: the integrators of the stepgens run on from where the segment before left them.
//!
//! ```text
//! every clock:   position += floor(velocity / 2^24)      s32.32 += s32     as in ramp.rs and stepgen.sv
//!                velocity += accel                       s32.24 += s32
//! ```
//!
//! So nothing is ever dropped between two segments, and whoever knows the integrators at the beginning and
//! the segments knows every edge: [`Axis::clock`] is the definition, [`Axis::advance`] the same bits in closed
//! form, [`Edges`] the clocks in which a step is due. What the pins' timing (`steplen`, `dirsetup`) may add to
//! an edge is the stepgen's business, not this module's.

use crate::ramp::sum_of_floors;
use wire::units::Position;

/// Axes of a job: X, Y, Z.
pub const AXES: usize = 3;

/// For how long, how much, and with which outputs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Segment {
    /// Clocks it lasts; at least [`MIN_CLOCKS`].
    pub clocks: u32,
    /// What is added to each velocity in each of these clocks: `f_clk^2 / 2^56` steps/s^2, signed.
    pub accel: [i32; AXES],
    /// The outputs, from the first clock on.
    pub aux: u16,
}

/// No segment is shorter: about a microsecond, time enough for a core to fetch the next one.
pub const MIN_CLOCKS: u32 = 64;

/// No segment that accelerates is longer. Its acceleration is a whole number, so the velocity at its end is
/// off by up to half a unit for each clock; in 2^20 clocks (17 ms at 60 MHz) that makes 6e-6 steps.
pub const MAX_CLOCKS: u32 = 1 << 20;

/// The two integrators of one stepgen.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Axis {
    /// s32.32 steps; wraps like the register.
    pub position: i64,
    /// s32.24: units of `StepRate` with 24 more fraction bits.
    pub velocity: i64,
}

impl Default for Axis {
    fn default() -> Self {
        Axis::at(0)
    }
}

impl Axis {
    /// At rest in the middle of a step, as a stepgen wakes up.
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

    /// One clock: the definition.
    pub const fn clock(&mut self, accel: i32) {
        self.position = self.position.wrapping_add(self.velocity >> 24);
        self.velocity += accel as i64;
    }

    /// `clocks` clocks at once, with the same result as that many calls of [`Axis::clock`].
    pub fn advance(&mut self, clocks: u32, accel: i32) {
        let travelled = sum_of_floors(clocks.into(), self.velocity, accel.into());
        self.position = self.position.wrapping_add(travelled as i64);
        self.velocity += i64::from(accel) * i64::from(clocks);
    }

    fn after(mut self, clocks: u32, accel: i32) -> Self {
        self.advance(clocks, accel);
        self
    }

    /// The clocks of a segment in which a step is due.
    pub fn edges(self, clocks: u32, accel: i32) -> Edges {
        Edges {
            axis: self,
            accel,
            done: 0,
            clocks,
        }
    }
}

/// A step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Edge {
    /// The clock of the segment (from 0) that takes the position across the edge.
    pub clock: u32,
    /// Towards plus.
    pub forward: bool,
}

/// The edges of one axis in one segment, in order, found by bisection of the closed form.
#[derive(Clone, Debug)]
pub struct Edges {
    axis: Axis,
    accel: i32,
    done: u32,
    clocks: u32,
}

impl Edges {
    /// Clocks from now in which the velocity keeps its sign, and the position so its direction.
    fn one_way(&self) -> u32 {
        let left = self.clocks - self.done;
        let (velocity, accel) = (self.axis.velocity, i64::from(self.accel));
        let turns = if velocity >= 0 && accel < 0 {
            velocity / -accel + 1
        } else if velocity < 0 && accel > 0 {
            velocity.unsigned_abs().div_ceil(accel.unsigned_abs()) as i64
        } else {
            return left;
        };
        u32::try_from(turns).map_or(left, |turns| turns.min(left))
    }
}

impl Iterator for Edges {
    type Item = Edge;

    fn next(&mut self) -> Option<Edge> {
        while self.done < self.clocks {
            let here = self.axis.steps();
            let (mut low, mut high) = (0, self.one_way());
            let end = self.axis.after(high, self.accel);
            if end.steps() == here {
                self.axis = end;
                self.done += high;
                continue;
            }
            // After `low` clocks we are still here, after `high` no more.
            while high - low > 1 {
                let middle = low + (high - low) / 2;
                if self.axis.after(middle, self.accel).steps() == here {
                    low = middle;
                } else {
                    high = middle;
                }
            }
            self.axis.advance(high, self.accel);
            self.done += high;
            return Some(Edge {
                clock: self.done - 1,
                forward: self.axis.steps() > here,
            });
        }
        None
    }
}

/// All axes and the outputs: what a job does to the machine.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Machine {
    /// The integrators.
    pub axes: [Axis; AXES],
    /// The outputs.
    pub aux: u16,
    /// Clocks since the beginning.
    pub clocks: u64,
}

impl Machine {
    /// Executes a segment.
    pub fn run(&mut self, segment: &Segment) {
        for (axis, accel) in self.axes.iter_mut().zip(segment.accel) {
            axis.advance(segment.clocks, accel);
        }
        self.aux = segment.aux;
        self.clocks += u64::from(segment.clocks);
    }

    /// Steps emitted by each axis.
    pub fn steps(&self) -> [i64; AXES] {
        self.axes.map(|axis| axis.steps())
    }

    /// Nothing moves, to the last bit.
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
        // A step every fourth clock at most, so that no acceleration below overflows the velocity.
        let velocity = prop_oneof![
            Just(0),
            Just(-1),
            Just(1),
            -1i64 << 30..1 << 30,
            -1i64 << 54..1 << 54
        ];
        (any::<i64>(), velocity).prop_map(|(position, velocity)| Axis { position, velocity })
    }

    fn any_accel() -> impl Strategy<Value = i32> {
        prop_oneof![
            Just(0),
            -10..10i32,
            -1_000_000..1_000_000i32,
            -i32::MAX..i32::MAX
        ]
    }

    fn edges_by_clock(mut axis: Axis, clocks: u32, accel: i32) -> Vec<Edge> {
        let mut edges = Vec::new();
        for clock in 0..clocks {
            let before = axis.steps();
            axis.clock(accel);
            // Across 2^63 the direction is the difference's, not the comparison's.
            match axis.steps().wrapping_sub(before) << 32 >> 32 {
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
        fn any_number_of_clocks_at_once_is_the_same_as_one_by_one(axis in any_axis(), accel in any_accel(), clocks in 0..3000u32) {
            let mut slow = axis;
            for _ in 0..clocks {
                slow.clock(accel);
            }
            prop_assert_eq!(axis.after(clocks, accel), slow);
        }

        #[test]
        fn the_closed_form_finds_every_edge_and_its_clock(axis in any_axis(), accel in any_accel(), clocks in 0..5000u32) {
            // Away from the wrap, where a direction by comparison would be wrong.
            let axis = Axis { position: axis.position >> 8, ..axis };
            prop_assert_eq!(axis.edges(clocks, accel).collect::<Vec<_>>(), edges_by_clock(axis, clocks, accel));
        }
    }

    #[test]
    fn a_reversal_within_a_segment_gives_back_the_steps_it_took() {
        let axis = Axis {
            velocity: 1 << 50,
            ..Axis::at(0)
        };
        let accel = -(1 << 30);
        let edges: Vec<Edge> = axis.edges(1 << 21, accel).collect();
        let forward = edges.iter().filter(|edge| edge.forward).count();
        assert_eq!(edges, edges_by_clock(axis, 1 << 21, accel));
        assert!(forward > 5 && forward * 2 >= edges.len() - 1, "{edges:?}");
    }

    #[test]
    fn a_segment_without_acceleration_at_rest_is_a_dwell() {
        let mut machine = Machine::default();
        machine.run(&Segment {
            clocks: u32::MAX,
            accel: [0; AXES],
            aux: 5,
        });
        assert!(machine.rests());
        assert_eq!((machine.steps(), machine.aux), ([0; AXES], 5));
        assert_eq!(machine.clocks, u64::from(u32::MAX));
    }
}
