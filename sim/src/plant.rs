//! The machine at the pins: motors that follow every pulse, encoders on their shafts, a spindle at
//! a PWM, wires from outputs to inputs, jumpers between header pins, and switches and probes that
//! an axis runs into.
//!
//! Axes are rigid and ideal: a pulse is a movement. The edges they make are as far apart as the
//! encoder's `gap` says and catch up with the pulses as fast as that allows. A spindle has inertia:
//! its speed follows the PWM's duty with a first-order lag.
//!
//! A plant can be written down as TOML ([`Plant::read`]):
//!
//! ```toml
#![doc = include_str!("../plant.example.toml")]
//! ```

use std::path::Path;

use serde::Deserialize;

use crate::edges::CHANNELS;
use crate::error::Error;

mod jumper;

pub use jumper::{Jumper, Sink, Source};
use jumper::{Outputs, Plugged};

/// One axis: a motor on a stepgen and an encoder on the motor.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Axis {
    /// Stepgen that turns the motor.
    pub stepgen: usize,
    /// Encoder on its shaft.
    pub encoder: usize,
    /// Quadrature counts (x4) per `per_steps` steps; negative turns the encoder the other way
    /// round.
    #[serde(default = "one")]
    pub counts: i64,
    /// See `counts`.
    #[serde(default = "one")]
    pub per_steps: i64,
    /// Quadrature counts per revolution: the index is high for the one count at each multiple.
    #[serde(default = "thousand_lines")]
    pub counts_per_rev: i64,
    /// Counts from zero to the index.
    #[serde(default)]
    pub index_at: i64,
    /// The index also reaches the stepgen's own index pin.
    #[serde(default = "yes")]
    pub stepgen_index: bool,
    /// Least sys clocks between two encoder edges, at least 1. The gateware's synchroniser and
    /// filter need a few.
    #[serde(default = "few")]
    pub gap: u32,
}

const fn one() -> i64 {
    1
}
const fn thousand_lines() -> i64 {
    4000
}
const fn few() -> u32 {
    4
}
const fn yes() -> bool {
    true
}

impl Axis {
    /// Stepgen `n` turns encoder `n`: one count per step, index every 4000 counts (a 1000-line
    /// encoder), an edge at most every 4 clocks (15 MHz count rate at 60 MHz; no machine does
    /// that).
    pub fn direct(n: usize) -> Self {
        Axis {
            stepgen: n,
            encoder: n,
            counts: one(),
            per_steps: one(),
            counts_per_rev: thousand_lines(),
            index_at: 0,
            stepgen_index: yes(),
            gap: few(),
        }
    }
}

/// A switch that an axis holds down from a position on, or a probe that touches there.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Switch {
    /// Stepgen that moves the dog.
    pub stepgen: usize,
    /// Position in steps where it is pressed.
    pub at: i64,
    /// Pressed at and above `at` (true) or at and below (false).
    pub above: bool,
    /// General input it is wired to.
    pub input: usize,
    /// Normally closed: low when pressed.
    #[serde(default)]
    pub inverted: bool,
}

/// A wire from a general output to a general input.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Wire {
    /// General output.
    pub output: usize,
    /// General input.
    pub input: usize,
    /// Through an inverter.
    #[serde(default)]
    pub inverted: bool,
}

/// A spindle: speed from the duty of a PWM, an encoder with an index.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Spindle {
    /// PWM that commands it.
    pub pwm: usize,
    /// False: the PWM's second pin says which way. True: pulses on the second pin turn backwards.
    #[serde(default)]
    pub up_down: bool,
    /// Encoder on its shaft.
    pub encoder: usize,
    /// Quadrature counts per revolution, one index each.
    #[serde(default = "hundred_lines")]
    pub counts_per_rev: i64,
    /// Revolutions per second at 100 % duty.
    pub max_rps: f64,
    /// Time constant of its speed, milliseconds.
    #[serde(default = "brisk")]
    pub lag_ms: f64,
    /// General output that must be high for it to turn.
    #[serde(default)]
    pub enable_output: Option<usize>,
    /// General output that turns it over.
    #[serde(default)]
    pub reverse_output: Option<usize>,
}

const fn hundred_lines() -> i64 {
    400
}
const fn brisk() -> f64 {
    50.0
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

/// Speed and angle are integrated in ticks of a tenth of a millisecond; in between the speed is
/// constant.
const TICKS_PER_SECOND: u64 = 10_000;

#[derive(Clone, Copy, Debug)]
struct Rotor {
    spindle: Spindle,
    /// Counts per clock, signed.
    speed: f64,
    /// Encoder count the phases show.
    shown: i64,
    /// How far past `shown`, in counts, at the clock `since`; 0 to 1.
    fraction: f64,
    since: u64,
    /// Levels of the PWM's two pins, and the clocks they have been high since the last tick.
    pins: [bool; 2],
    pins_since: u64,
    high: [u64; 2],
    /// Next tick; `u64::MAX` at rest.
    tick: u64,
    last_tick: u64,
    /// Next encoder edge at this speed; `u64::MAX` is none.
    edge: u64,
}

impl Rotor {
    fn next(&self) -> u64 {
        self.tick.min(self.edge)
    }

    fn wake(&mut self, clock: u64, hz: u64) {
        if self.tick == u64::MAX {
            self.since = clock;
            self.last_tick = clock;
            self.tick = clock + (hz / TICKS_PER_SECOND).max(1);
        }
    }

    /// The pins have been as they were until now.
    fn account(&mut self, clock: u64) {
        let clocks = clock - self.pins_since.max(self.last_tick).min(clock);
        for (high, pin) in self.high.iter_mut().zip(self.pins) {
            *high += clocks * u64::from(pin);
        }
        self.pins_since = clock;
    }

    /// Move to `clock`; true when the count changed.
    fn turn(&mut self, clock: u64, hz: u64, outputs: u64) -> bool {
        let before = self.shown;
        self.fraction += self.speed * (clock - self.since) as f64;
        self.since = clock;
        if clock >= self.edge {
            // The edge was due by this clock; rounding must not make it due again in the next.
            let up = self.speed > 0.0;
            self.shown += if up { 1 } else { -1 };
            self.fraction = (self.fraction - if up { 1.0 } else { -1.0 }).clamp(0.0, BELOW_ONE);
        }
        self.fraction = self.fraction.clamp(0.0, BELOW_ONE);
        if clock >= self.tick {
            self.accelerate(clock, hz, outputs);
        }
        self.edge = match self.speed {
            v if v > 0.0 => clock + clocks_for((1.0 - self.fraction) / v),
            v if v < 0.0 => clock + clocks_for(self.fraction / -v),
            _ => u64::MAX,
        };
        before != self.shown
    }

    fn accelerate(&mut self, clock: u64, hz: u64, outputs: u64) {
        self.account(clock);
        let clocks = (clock - self.last_tick) as f64;
        let [first, second] = self.high.map(|high| high as f64 / clocks);
        let s = &self.spindle;
        let on = |output: Option<usize>| output.map(|n| outputs >> n & 1 != 0);
        let duty = match (s.up_down, on(s.enable_output).unwrap_or(true)) {
            (_, false) => 0.0,
            (true, true) => first - second,
            (false, true) if second > 0.5 => -first,
            (false, true) => first,
        };
        let duty = if on(s.reverse_output).unwrap_or(false) {
            -duty
        } else {
            duty
        };
        let full = s.max_rps * s.counts_per_rev as f64 / hz as f64;
        let share = (clocks / (s.lag_ms.max(1e-3) * 1e-3 * hz as f64)).min(1.0);
        self.speed += (duty * full - self.speed) * share;
        self.high = [0; 2];
        self.last_tick = clock;
        let pulses = self.pins[0] || (self.spindle.up_down && self.pins[1]);
        let still = duty == 0.0 && !pulses;
        if still && self.speed.abs() < full.abs() * 1e-4 {
            self.speed = 0.0;
            self.tick = u64::MAX;
        } else {
            self.tick = clock + (hz / TICKS_PER_SECOND).max(1);
        }
    }
}

/// The largest fraction of a count that is not a whole one.
const BELOW_ONE: f64 = 1.0 - f64::EPSILON;

/// At least one clock, and no more than an hour of them.
fn clocks_for(clocks: f64) -> u64 {
    clocks.ceil().clamp(1.0, 2e11) as u64
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
    /// Index pins of the stepgens.
    pub step_index: u16,
    /// General inputs the plant drives; see [`Plant::gpio_mask`].
    pub gpio: u64,
}

/// The machine.
#[derive(Clone, Debug)]
pub struct Plant {
    hz: u64,
    shafts: Vec<Shaft>,
    rotors: Vec<Rotor>,
    switches: Vec<Switch>,
    wires: Vec<Wire>,
    jumpers: Vec<Plugged>,
    steps: [i64; CHANNELS],
    levels: Levels,
    gpio_mask: u64,
    /// Levels of the board's output pins.
    pins: Outputs,
    /// Sys clock of the next edge or tick; 0 is "look", `u64::MAX` is rest.
    next: u64,
}

impl Default for Plant {
    fn default() -> Self {
        Plant {
            hz: 60_000_000,
            shafts: Vec::new(),
            rotors: Vec::new(),
            switches: Vec::new(),
            wires: Vec::new(),
            jumpers: Vec::new(),
            steps: [0; CHANNELS],
            levels: Levels::default(),
            gpio_mask: 0,
            pins: Outputs::default(),
            next: u64::MAX,
        }
    }
}

/// What a plant file may hold.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    #[serde(default)]
    axis: Vec<Axis>,
    #[serde(default)]
    switch: Vec<Switch>,
    #[serde(default)]
    spindle: Vec<Spindle>,
    #[serde(default)]
    wire: Vec<Wire>,
    #[serde(default)]
    jumper: Vec<Jumper>,
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

    /// Adds what a TOML file says; an axis or spindle replaces the one that had its encoder.
    pub fn read(&mut self, path: &Path) -> Result<(), Error> {
        let text = std::fs::read_to_string(path).map_err(|source| Error::Read {
            path: path.into(),
            source,
        })?;
        self.parse(&text).map_err(|why| Error::Plant {
            path: path.into(),
            why,
        })
    }

    fn parse(&mut self, text: &str) -> Result<(), String> {
        let file: File = toml::from_str(text).map_err(|e| e.to_string())?;
        let channel = |what: &str, n: usize, most: usize| match n < most {
            true => Ok(()),
            false => Err(format!("{what} {n}: there are {most} at most, from 0")),
        };
        for axis in file.axis {
            channel("axis.stepgen", axis.stepgen, CHANNELS)?;
            channel("axis.encoder", axis.encoder, CHANNELS)?;
            self.add_axis(axis);
        }
        for spindle in file.spindle {
            channel("spindle.pwm", spindle.pwm, CHANNELS)?;
            channel("spindle.encoder", spindle.encoder, CHANNELS)?;
            for output in [spindle.enable_output, spindle.reverse_output] {
                channel("spindle output", output.unwrap_or(0), 32)?;
            }
            self.add_spindle(spindle);
        }
        for switch in file.switch {
            channel("switch.stepgen", switch.stepgen, CHANNELS)?;
            channel("switch.input", switch.input, 32)?;
            self.add_switch(switch);
        }
        for wire in file.wire {
            channel("wire.output", wire.output, 32)?;
            channel("wire.input", wire.input, 32)?;
            self.add_wire(wire);
        }
        for jumper in file.jumper {
            self.add_jumper(jumper);
        }
        Ok(())
    }

    /// How many sys clocks a second has; only spindles care.
    pub fn set_clock(&mut self, sys_hz: u64) {
        self.hz = sys_hz.max(TICKS_PER_SECOND);
    }

    /// Put another axis on the machine. Its encoder starts at the count its stepgen's pulses so far
    /// give.
    pub fn add_axis(&mut self, axis: Axis) {
        self.free_encoder(axis.encoder);
        let at = Self::count(&axis, self.steps[axis.stepgen]);
        self.shafts.push(Shaft {
            axis,
            target: at,
            slip: 0,
            shown: at,
            ready: 0,
        });
        self.show_shaft(self.shafts.len() - 1);
    }

    /// Put a spindle on the machine; it stands.
    pub fn add_spindle(&mut self, spindle: Spindle) {
        self.free_encoder(spindle.encoder);
        self.rotors.push(Rotor {
            spindle,
            speed: 0.0,
            shown: 0,
            fraction: 0.0,
            since: 0,
            pins: [false; 2],
            pins_since: 0,
            high: [0; 2],
            tick: u64::MAX,
            last_tick: 0,
            edge: u64::MAX,
        });
        self.show_rotor(self.rotors.len() - 1);
    }

    fn free_encoder(&mut self, encoder: usize) {
        self.shafts.retain(|s| s.axis.encoder != encoder);
        self.rotors.retain(|r| r.spindle.encoder != encoder);
    }

    /// Put a switch on the machine.
    pub fn add_switch(&mut self, switch: Switch) {
        self.switches.push(switch);
        self.gpio_mask |= 1 << switch.input;
        self.settle();
    }

    /// Put a wire on the machine.
    pub fn add_wire(&mut self, wire: Wire) {
        self.wires.push(wire);
        self.gpio_mask |= 1 << wire.input;
        self.settle();
    }

    /// Put a jumper between two header pins.
    pub fn add_jumper(&mut self, jumper: Jumper) {
        self.jumpers.push(Plugged::new(jumper, &self.pins));
        if let Sink::Input(n) = jumper.to {
            self.gpio_mask |= 1 << n;
        }
    }

    /// Turn a shaft by hand: `counts` encoder counts, no steps.
    pub fn slip(&mut self, encoder: usize, counts: i64) {
        for shaft in self.shafts.iter_mut().filter(|s| s.axis.encoder == encoder) {
            shaft.slip += counts;
            shaft.target += counts;
            self.next = 0;
        }
    }

    /// General inputs that wires or switches drive.
    pub fn gpio_mask(&self) -> u64 {
        self.gpio_mask
    }

    /// What the plant puts on the inputs now.
    pub fn levels(&self) -> Levels {
        let mut levels = self.levels;
        for plugged in &self.jumpers {
            plugged.show(&mut levels);
        }
        levels
    }

    /// Count the encoder shows now; `None` when nothing has it.
    pub fn encoder_count(&self, encoder: usize) -> Option<i64> {
        let axis = self.shafts.iter().find(|s| s.axis.encoder == encoder);
        let spindle = self.rotors.iter().find(|r| r.spindle.encoder == encoder);
        axis.map(|s| s.shown).or(spindle.map(|r| r.shown))
    }

    /// Speed of the spindle on this encoder, revolutions per second.
    pub fn spindle_rps(&self, encoder: usize) -> Option<f64> {
        let rotor = self.rotors.iter().find(|r| r.spindle.encoder == encoder)?;
        Some(rotor.speed * self.hz as f64 / rotor.spindle.counts_per_rev as f64)
    }

    /// The next sys clock in which something moves by itself: [`Self::turn`] must be called then.
    /// `u64::MAX` is rest.
    #[inline]
    pub fn next(&self) -> u64 {
        self.next
    }

    /// These stepgens stepped.
    pub fn steps(&mut self, forward: u16, backward: u16) {
        let mut moved = forward | backward;
        while moved != 0 {
            let n = moved.trailing_zeros() as usize;
            moved &= moved - 1;
            self.steps[n] += i64::from(forward >> n & 1) - i64::from(backward >> n & 1);
        }
        for shaft in &mut self.shafts {
            if (forward | backward) >> shaft.axis.stepgen & 1 != 0 {
                shaft.target =
                    Self::count(&shaft.axis, self.steps[shaft.axis.stepgen]) + shaft.slip;
                if shaft.target != shaft.shown {
                    self.next = 0;
                }
            }
        }
        if !self.switches.is_empty() {
            self.settle();
        }
    }

    /// The general outputs changed.
    pub fn outputs(&mut self, gpio_out: u64) {
        self.pins.gpio = gpio_out;
        self.look();
        self.settle();
    }

    /// Pins of step generators changed: levels of first and second pins. True when a jumper carries
    /// them.
    #[inline]
    pub fn motion(&mut self, step: u16, dir: u16) -> bool {
        (self.pins.step, self.pins.dir) = (step, dir);
        self.look();
        !self.jumpers.is_empty()
    }

    #[inline]
    fn look(&mut self) {
        for plugged in &mut self.jumpers {
            plugged.look(&self.pins);
        }
    }

    /// PWM pins changed at `clock`: levels of first and second pins.
    pub fn pwm(&mut self, clock: u64, out: u16, dir: u16) {
        self.pins.pwm = out;
        self.look();
        for rotor in &mut self.rotors {
            let pins = [out, dir].map(|word| word >> rotor.spindle.pwm & 1 != 0);
            if pins != rotor.pins {
                rotor.account(clock);
                rotor.pins = pins;
                rotor.wake(clock, self.hz);
                self.next = self.next.min(rotor.next());
            }
        }
    }

    /// Moves everything that moves by itself to sys clock `clock`: at most one encoder edge per
    /// shaft, `gap` clocks apart. True when a level changed.
    pub fn turn(&mut self, clock: u64) -> bool {
        let mut changed = false;
        self.next = u64::MAX;
        for i in 0..self.shafts.len() {
            let shaft = &mut self.shafts[i];
            if shaft.shown == shaft.target {
                continue;
            }
            if clock >= shaft.ready {
                shaft.shown += (shaft.target - shaft.shown).signum();
                shaft.ready = clock + u64::from(shaft.axis.gap.max(1));
                changed = true;
                self.show_shaft(i);
            }
            if self.shafts[i].shown != self.shafts[i].target {
                self.next = self.next.min(self.shafts[i].ready);
            }
        }
        for i in 0..self.rotors.len() {
            let rotor = &mut self.rotors[i];
            if clock >= rotor.next() && rotor.turn(clock, self.hz, self.pins.gpio) {
                changed = true;
                self.show_rotor(i);
            }
            self.next = self.next.min(self.rotors[i].next());
        }
        changed
    }

    fn count(axis: &Axis, steps: i64) -> i64 {
        (steps * axis.counts).div_euclid(axis.per_steps.max(1))
    }

    fn show_shaft(&mut self, i: usize) {
        let Shaft { axis, shown, .. } = self.shafts[i];
        let index = self.show(axis.encoder, shown, axis.counts_per_rev, axis.index_at);
        if axis.stepgen_index {
            put(&mut self.levels.step_index, axis.stepgen, index);
        }
    }

    fn show_rotor(&mut self, i: usize) {
        let Rotor { spindle, shown, .. } = self.rotors[i];
        self.show(spindle.encoder, shown, spindle.counts_per_rev, 0);
    }

    /// Phases of a count: A leads B when counting up. Returns the index.
    fn show(&mut self, encoder: usize, count: i64, per_rev: i64, index_at: i64) -> bool {
        let phase = count.rem_euclid(4);
        let index = (count - index_at).rem_euclid(per_rev.max(1)) == 0;
        put(&mut self.levels.a, encoder, phase == 1 || phase == 2);
        put(&mut self.levels.b, encoder, phase >= 2);
        put(&mut self.levels.index, encoder, index);
        index
    }

    fn settle(&mut self) {
        let mut gpio = 0;
        for wire in &self.wires {
            gpio |=
                u64::from((self.pins.gpio >> wire.output & 1 != 0) != wire.inverted) << wire.input;
        }
        // Several switches at one input are a chain: each of them presses it.
        let (mut pressed, mut inverted) = (0, 0);
        for switch in &self.switches {
            let at = self.steps[switch.stepgen];
            let is_pressed = if switch.above {
                at >= switch.at
            } else {
                at <= switch.at
            };
            pressed |= u64::from(is_pressed) << switch.input;
            inverted |= u64::from(switch.inverted) << switch.input;
        }
        self.levels.gpio = gpio | (pressed ^ inverted);
    }
}

fn put(word: &mut u16, n: usize, on: bool) {
    let bit = 1u16 << n;
    *word = if on { *word | bit } else { *word & !bit };
}

#[cfg(test)]
mod tests;
