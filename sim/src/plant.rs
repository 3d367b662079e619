//! The machine behind the pins: motors that follow every pulse, encoders on their shafts, wires from outputs to inputs and
//! switches that an axis runs into.
//!
//! It is rigid and ideal: a pulse is a movement. It knows no rates; the edges it makes are as far apart as its encoder's
//! `gap` says and catch up with the pulses as fast as that allows.

use crate::edges::CHANNELS;

/// One axis: a motor on a stepgen and an encoder on the motor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Axis {
    /// Stepgen that turns the motor.
    pub stepgen: usize,
    /// Encoder on its shaft.
    pub encoder: usize,
    /// Quadrature counts (x4) per `per_steps` steps; negative turns the encoder the other way round.
    pub counts: i64,
    /// See `counts`.
    pub per_steps: i64,
    /// Quadrature counts per revolution: the index is high for the one count at each multiple.
    pub counts_per_rev: i64,
    /// Least sys clocks between two encoder edges, at least 1. The gateware's synchroniser and filter need a few.
    pub gap: u32,
}

impl Axis {
    /// Stepgen `n` turns encoder `n`: one count per step, index every 4000 counts (a 1000-line encoder), an edge at most
    /// every 4 clocks (15 MHz count rate at 60 MHz; no machine does that).
    pub fn direct(n: usize) -> Self {
        Axis {
            stepgen: n,
            encoder: n,
            counts: 1,
            per_steps: 1,
            counts_per_rev: 4000,
            gap: 4,
        }
    }
}

/// A switch that an axis holds down from a position on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Switch {
    /// Stepgen whose steps move the dog.
    pub stepgen: usize,
    /// Position in steps where it is pressed.
    pub at: i64,
    /// Pressed at and above `at` (true) or at and below (false).
    pub above: bool,
    /// General input it is wired to.
    pub input: usize,
}

/// A wire from a general output to a general input.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Wire {
    /// General output.
    pub output: usize,
    /// General input.
    pub input: usize,
    /// Through an inverter.
    pub inverted: bool,
}

#[derive(Clone, Copy, Debug)]
struct Shaft {
    axis: Axis,
    /// Encoder count the steps ask for.
    target: i64,
    /// Counts it was turned by hand.
    slip: i64,
    /// Encoder count the phases show.
    shown: i64,
    /// Sys clock from which the next edge may come.
    ready: u64,
}

/// Levels the plant puts on the board's inputs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Levels {
    /// Phase A of each encoder.
    pub a: u16,
    /// Phase B.
    pub b: u16,
    /// Index.
    pub index: u16,
    /// General inputs the plant drives; see [`Plant::gpio_mask`].
    pub gpio: u32,
}

/// The machine.
#[derive(Clone, Debug, Default)]
pub struct Plant {
    shafts: Vec<Shaft>,
    switches: Vec<Switch>,
    wires: Vec<Wire>,
    steps: [i64; CHANNELS],
    levels: Levels,
    gpio_out: u32,
    /// Some shaft's encoder has yet to reach its target.
    moving: bool,
}

impl Plant {
    /// A machine with these axes.
    pub fn new(axes: impl IntoIterator<Item = Axis>) -> Self {
        let mut plant = Plant::default();
        for axis in axes {
            plant.add_axis(axis);
        }
        plant
    }

    /// One [`Axis::direct`] on each of `n` stepgens.
    pub fn direct(n: usize) -> Self {
        Self::new((0..n).map(Axis::direct))
    }

    /// Put another axis on the machine. Its encoder starts at the count its stepgen's pulses so far give.
    pub fn add_axis(&mut self, axis: Axis) {
        let at = Self::count(&axis, self.steps[axis.stepgen]);
        self.shafts.retain(|s| s.axis.encoder != axis.encoder);
        self.shafts.push(Shaft {
            axis,
            target: at,
            slip: 0,
            shown: at,
            ready: 0,
        });
        self.show(self.shafts.len() - 1);
    }

    /// Put a switch on the machine.
    pub fn add_switch(&mut self, switch: Switch) {
        self.switches.push(switch);
        self.settle();
    }

    /// Put a wire on the machine.
    pub fn add_wire(&mut self, wire: Wire) {
        self.wires.push(wire);
        self.settle();
    }

    /// Turn a shaft by hand: `counts` encoder counts, no steps.
    pub fn slip(&mut self, encoder: usize, counts: i64) {
        for shaft in self.shafts.iter_mut().filter(|s| s.axis.encoder == encoder) {
            shaft.slip += counts;
            shaft.target += counts;
            self.moving = true;
        }
    }

    /// General inputs that wires or switches drive.
    pub fn gpio_mask(&self) -> u32 {
        self.wires
            .iter()
            .map(|w| 1u32 << w.input)
            .chain(self.switches.iter().map(|s| 1u32 << s.input))
            .fold(0, |m, b| m | b)
    }

    /// What the plant puts on the inputs now.
    pub fn levels(&self) -> Levels {
        self.levels
    }

    /// Count the encoder shows now; `None` when no axis has it.
    pub fn encoder_count(&self, encoder: usize) -> Option<i64> {
        self.shafts
            .iter()
            .find(|s| s.axis.encoder == encoder)
            .map(|s| s.shown)
    }

    /// Still turning: [`Self::turn`] must be called every clock.
    #[inline]
    pub fn moving(&self) -> bool {
        self.moving
    }

    /// These stepgens stepped.
    pub fn steps(&mut self, forward: u16, backward: u16) {
        for n in 0..CHANNELS {
            self.steps[n] += i64::from(forward >> n & 1) - i64::from(backward >> n & 1);
        }
        for shaft in &mut self.shafts {
            shaft.target = Self::count(&shaft.axis, self.steps[shaft.axis.stepgen]) + shaft.slip;
            self.moving |= shaft.target != shaft.shown;
        }
        if !self.switches.is_empty() {
            self.settle();
        }
    }

    /// The general outputs changed.
    pub fn outputs(&mut self, gpio_out: u32) {
        self.gpio_out = gpio_out;
        self.settle();
    }

    /// One sys clock of turning: at most one encoder edge per shaft, `gap` clocks apart. True when a level changed.
    pub fn turn(&mut self, clock: u64) -> bool {
        let mut changed = false;
        self.moving = false;
        for i in 0..self.shafts.len() {
            let shaft = &mut self.shafts[i];
            if shaft.shown == shaft.target {
                continue;
            }
            if clock >= shaft.ready {
                shaft.shown += (shaft.target - shaft.shown).signum();
                shaft.ready = clock + u64::from(shaft.axis.gap.max(1));
                changed = true;
                self.show(i);
            }
            self.moving |= self.shafts[i].shown != self.shafts[i].target;
        }
        changed
    }

    fn count(axis: &Axis, steps: i64) -> i64 {
        (steps * axis.counts).div_euclid(axis.per_steps.max(1))
    }

    /// Phases of a count: A leads B when counting up.
    fn show(&mut self, i: usize) {
        let Shaft { axis, shown, .. } = self.shafts[i];
        let bit = 1u16 << axis.encoder;
        let phase = shown.rem_euclid(4);
        let put = |word: &mut u16, on: bool| if on { *word |= bit } else { *word &= !bit };
        put(&mut self.levels.a, phase == 1 || phase == 2);
        put(&mut self.levels.b, phase >= 2);
        put(
            &mut self.levels.index,
            shown.rem_euclid(axis.counts_per_rev.max(1)) == 0,
        );
    }

    fn settle(&mut self) {
        let mut gpio = 0;
        for wire in &self.wires {
            gpio |=
                u32::from((self.gpio_out >> wire.output & 1 != 0) != wire.inverted) << wire.input;
        }
        for switch in &self.switches {
            let at = self.steps[switch.stepgen];
            let pressed = if switch.above {
                at >= switch.at
            } else {
                at <= switch.at
            };
            gpio |= u32::from(pressed) << switch.input;
        }
        self.levels.gpio = gpio;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A quadrature counter as simple as can be.
    #[derive(Default)]
    struct Counter {
        count: i64,
        last: (u16, u16),
        illegal: u32,
    }

    impl Counter {
        fn see(&mut self, levels: Levels) {
            let now = (levels.a & 1, levels.b & 1);
            let state = |(a, b): (u16, u16)| i64::from(if b == 0 { a } else { 3 - a });
            match (state(now) - state(self.last)).rem_euclid(4) {
                1 => self.count += 1,
                3 => self.count -= 1,
                2 => self.illegal += 1,
                _ => {}
            }
            self.last = now;
        }
    }

    fn follow(axis: Axis, steps: &[(u64, i64)], clocks: u64) -> (Counter, Plant) {
        let mut plant = Plant::new([axis]);
        let mut counter = Counter::default();
        let mut steps = steps.iter().peekable();
        for clock in 0..clocks {
            if let Some((_, by)) = steps.next_if(|(at, _)| *at == clock) {
                plant.steps(u16::from(*by > 0), u16::from(*by < 0));
            }
            if plant.moving() {
                plant.turn(clock);
            }
            counter.see(plant.levels());
        }
        (counter, plant)
    }

    #[test]
    fn counts_follow_steps_both_ways() {
        let steps: Vec<_> = (0..100)
            .map(|i| (i * 10, if i < 70 { 1 } else { -1 }))
            .collect();
        let (counter, plant) = follow(Axis::direct(0), &steps, 2000);
        assert_eq!((counter.count, counter.illegal), (40, 0));
        assert_eq!(plant.encoder_count(0), Some(40));
        assert!(!plant.moving());
    }

    #[test]
    fn a_finer_encoder_makes_every_edge_in_between() {
        let axis = Axis {
            counts: 10,
            per_steps: 1,
            ..Axis::direct(0)
        };
        let (counter, _) = follow(axis, &[(0, 1), (100, 1), (200, -1)], 1000);
        assert_eq!((counter.count, counter.illegal), (10, 0));
    }

    #[test]
    fn a_coarser_and_a_mirrored_encoder() {
        let axis = Axis {
            counts: -1,
            per_steps: 4,
            ..Axis::direct(0)
        };
        let steps: Vec<_> = (0..40).map(|i| (i * 10, 1)).collect();
        let (counter, _) = follow(axis, &steps, 1000);
        assert_eq!((counter.count, counter.illegal), (-10, 0));
    }

    #[test]
    fn edges_keep_their_gap() {
        let mut plant = Plant::new([Axis {
            counts: 100,
            gap: 7,
            ..Axis::direct(0)
        }]);
        plant.steps(1, 0);
        let edges: Vec<u64> = (0..1000).filter(|clock| plant.turn(*clock)).collect();
        assert_eq!(edges.len(), 100);
        assert!(edges.windows(2).all(|w| w[1] - w[0] == 7));
    }

    #[test]
    fn index_comes_once_per_revolution() {
        let mut plant = Plant::new([Axis {
            counts_per_rev: 8,
            gap: 1,
            ..Axis::direct(0)
        }]);
        let mut seen = vec![];
        for clock in 0..17 {
            if plant.levels().index & 1 != 0 {
                seen.push(plant.encoder_count(0).unwrap());
            }
            plant.steps(1, 0);
            plant.turn(clock);
        }
        assert_eq!(seen, [0, 8, 16]);
    }

    #[test]
    fn wires_and_switches_reach_the_inputs() {
        let mut plant = Plant::default();
        plant.add_wire(Wire {
            output: 3,
            input: 5,
            inverted: false,
        });
        plant.add_wire(Wire {
            output: 4,
            input: 6,
            inverted: true,
        });
        plant.add_switch(Switch {
            stepgen: 1,
            at: -2,
            above: false,
            input: 9,
        });
        assert_eq!(plant.gpio_mask(), 1 << 5 | 1 << 6 | 1 << 9);
        assert_eq!(plant.levels().gpio, 1 << 6);
        plant.outputs(0x18);
        assert_eq!(plant.levels().gpio, 1 << 5);
        plant.steps(0, 2);
        assert_eq!(plant.levels().gpio, 1 << 5);
        plant.steps(0, 2);
        assert_eq!(plant.levels().gpio, 1 << 5 | 1 << 9);
    }

    #[test]
    fn a_slipped_shaft_stays_slipped() {
        let mut plant = Plant::direct(1);
        plant.slip(0, 25);
        for clock in 0..1000 {
            plant.turn(clock);
        }
        plant.steps(1, 0);
        for clock in 1000..1100 {
            plant.turn(clock);
        }
        assert_eq!(plant.encoder_count(0), Some(26));
    }
}
