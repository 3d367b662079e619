//! `stepgen.sv`: velocity in, pulses out. The ramp is [`motion::ramp`]'s; this adds the commit, the
//! pins and their timing.

use motion::ramp::{Ramp, VELOCITY_FRACTION};
use wire::map::{DIR_CLOCKS_MAX, STEP_CLOCKS_MAX, StepType};
use wire::units::{Accel, Velocity};

/// One channel. `pulses` is the wide counter's total with its delta: the count as a sample in this
/// clock would see it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Stepgen {
    halted: bool,
    fresh: bool,
    braking: bool,
    target: i32,
    limit: u32,
    v: i64,
    up: bool,
    jump: bool,
    fraction: u32,
    pulses: i32,
    pulse: bool,
    reverse: bool,
    setup: bool,
    step: Timer<{ STEP_CLOCKS_MAX }>,
    direction: Timer<{ DIR_CLOCKS_MAX }>,
    stopped: bool,
    /// Quadrature: A and B.
    phase: [bool; 2],
    pins: [bool; 2],
}

impl Default for Stepgen {
    fn default() -> Self {
        Stepgen {
            halted: true,
            fresh: false,
            braking: true,
            target: 0,
            limit: 0,
            v: 0,
            up: true,
            jump: true,
            fraction: 0x8000_0000,
            pulses: 0,
            pulse: false,
            reverse: false,
            setup: false,
            step: Timer::OVER,
            direction: Timer::OVER,
            stopped: false,
            phase: [false; 2],
            pins: [false; 2],
        }
    }
}

/// Counts up from an event; a time is over from the clock on in which they are equal, as found a
/// clock ahead. Times of 0 and 1 are over at once.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Timer<const MASK: u32> {
    clock: u32,
    done: bool,
}

impl<const MASK: u32> Timer<MASK> {
    const OVER: Self = Timer {
        clock: 1,
        done: true,
    };

    /// `event`: what begins now takes so long. Without one the present `time` goes on.
    fn clock(&mut self, event: Option<u32>, time: u32) {
        match event {
            Some(time) => {
                *self = Timer {
                    clock: 1,
                    done: time < 2,
                }
            }
            None => self.skip(1, time),
        }
    }

    /// Clocks until it is done.
    fn left(&self, time: u32) -> u64 {
        if self.done {
            0
        } else {
            u64::from(time.wrapping_sub(self.clock + 1) & MASK) + 1
        }
    }

    fn skip(&mut self, clocks: u64, time: u32) {
        self.done = self.left(time) <= clocks;
        self.clock = (u64::from(self.clock).wrapping_add(clocks) & u64::from(MASK)) as u32;
    }
}

/// The settings page.
#[derive(Clone, Copy, Debug, Default)]
pub struct Settings {
    /// Clocks, 0 as 1.
    pub steplen: u32,
    /// Clocks, 0 as 1.
    pub stepspace: u32,
    /// Clocks.
    pub dirsetup: u32,
    /// Clocks.
    pub dirhold: u32,
    /// Deceleration of a stop.
    pub stop_accel: u32,
    /// The mode register.
    pub mode: u32,
}

impl Settings {
    fn kind(&self) -> StepType {
        let code = self.mode >> wire::map::STEPGEN_TYPE_SHIFT & 3;
        StepType::from_code(code).unwrap_or_default()
    }
}

/// Its inputs in a clock.
#[derive(Clone, Copy, Debug, Default)]
pub struct Input {
    /// Outputs are live.
    pub gate: bool,
    /// Come to rest.
    pub stop: bool,
    /// Take the command.
    pub commit: bool,
    /// The command: follow it.
    pub enable: bool,
    /// Its velocity.
    pub velocity: i32,
    /// Its acceleration limit.
    pub accel: u32,
    /// Path time stands.
    pub still: bool,
    /// Settings.
    pub set: Settings,
}

impl Stepgen {
    /// Pulses emitted, signed.
    pub fn pulses(&self) -> i32 {
        self.pulses
    }

    /// As if it had emitted so many.
    pub fn preset(&mut self, pulses: i32) {
        self.pulses = pulses;
    }

    /// Fraction of the position.
    pub fn fraction(&self) -> u32 {
        self.fraction
    }

    /// Velocity, integer part.
    pub fn velocity(&self) -> i32 {
        (self.v >> VELOCITY_FRACTION) as i32
    }

    /// A stop has been obeyed.
    pub fn stopped(&self) -> bool {
        self.stopped
    }

    /// The two pins.
    pub fn pins(&self) -> [bool; 2] {
        self.pins
    }

    fn negative(&self) -> bool {
        self.v < 0
    }

    fn step_time(&self, set: &Settings) -> u32 {
        if self.pulse {
            set.steplen
        } else {
            set.stepspace
        }
    }

    fn dir_time(&self, set: &Settings) -> u32 {
        if self.setup {
            set.dirsetup
        } else {
            set.dirhold
        }
    }

    fn sum(&self) -> i64 {
        i64::from(self.fraction) + (self.v >> VELOCITY_FRACTION)
    }

    /// The integer part of the position is due to change in this clock.
    fn due(&self) -> bool {
        self.sum() >> 32 != 0
    }

    fn ready(&self) -> bool {
        !self.pulse
            && self.step.done
            && self.reverse == self.negative()
            && (!self.setup || self.direction.done)
    }

    /// A pulse is due in this clock and has to wait. Says nothing about `still`.
    pub fn waits(&self, i: &Input) -> bool {
        i.gate && self.due() && !self.ready()
    }

    /// The velocity has the other direction.
    fn wants_turn(&self) -> bool {
        match self.negative() {
            true => !self.reverse,
            false => self.reverse && self.v >> VELOCITY_FRACTION != 0,
        }
    }

    fn turns(&self, i: &Input) -> bool {
        i.gate && !self.pulse && (self.setup || self.direction.done) && self.wants_turn()
    }

    /// By how much the velocity may move in a clock.
    fn reach(&self, set: &Settings) -> u32 {
        if self.braking {
            set.stop_accel
        } else {
            self.limit
        }
    }

    /// One rising edge. True when a pulse starts with it.
    pub fn clock(&mut self, i: &Input) -> bool {
        let set = &i.set;
        let halt = i.stop || !i.gate;
        let take = i.commit && !halt;
        let pause = self.fresh || take || (halt && !self.halted);
        let holds = pause || (i.still && !self.braking);

        // Velocity. In the clock after a new target the adder tries a move upwards, and only its
        // comparison is used.
        let reach = i64::from(self.reach(set));
        let down = !self.up && !self.fresh;
        let moved = if down { self.v - reach } else { self.v + reach };
        let below = moved >> VELOCITY_FRACTION < i64::from(self.target);
        let arrived = self.jump || self.up != below;

        // Position.
        let (due, ready) = (self.due(), self.ready());
        let emit = i.gate && due && ready && !i.still;
        let turn = self.turns(i);
        if !i.still && i.gate && (!due || ready) {
            self.fraction = self.sum() as u32;
        }
        if emit {
            self.pulses = self.pulses.wrapping_add(if self.reverse { -1 } else { 1 });
        }

        // Timing.
        let quadrature = set.kind() == StepType::Quadrature;
        let fall = self.pulse && (self.step.done || (!i.gate && !quadrature));
        let (step_time, dir_time) = (self.step_time(set), self.dir_time(set));
        let falls = |time| fall.then_some(time);
        let begins = emit.then_some(set.steplen).or(falls(set.stepspace));
        self.step.clock(begins, step_time);
        let begins = turn.then_some(set.dirsetup).or(falls(set.dirhold));
        self.direction.clock(begins, dir_time);
        self.setup = turn || (self.setup && !fall);
        let pulse = emit || (self.pulse && !fall);

        // Pins.
        if emit {
            let [a, b] = self.phase;
            let line = usize::from((a != b) != self.reverse);
            self.phase[line] = !self.phase[line];
        }
        self.pins = self.polarised(set, pulse, self.reverse, self.reverse != turn);
        self.stopped = halt && self.halted && !pause && arrived && !pulse;
        self.pulse = pulse;
        self.reverse ^= turn;

        // Ramp and target.
        if !i.gate {
            self.v = 0;
        } else if !holds {
            self.v = if arrived {
                i64::from(self.target) << VELOCITY_FRACTION
            } else {
                moved
            };
        }
        if self.fresh || (self.up && !i.gate) {
            self.jump = reach == 0;
        }
        if !i.gate {
            self.up = true;
        } else if self.fresh {
            self.up = below;
        }
        let waits = self.fresh && i.still && !self.braking;
        if halt || (take && !i.enable) {
            self.target = 0;
            self.braking = true;
        } else if take {
            self.target = i.velocity;
            self.braking = false;
        }
        if take {
            self.limit = i.accel;
        }
        self.fresh = take || (halt && !self.halted) || waits;
        self.halted = halt;
        emit
    }

    fn polarised(&self, set: &Settings, pulse: bool, reverse: bool, dir: bool) -> [bool; 2] {
        let [step, dir] = match set.kind() {
            StepType::StepDir => [pulse, dir],
            StepType::UpDown => [pulse && !reverse, pulse && reverse],
            StepType::Quadrature => self.phase,
        };
        [
            step != (set.mode & wire::map::STEPGEN_STEP_INVERT != 0),
            dir != (set.mode & wire::map::STEPGEN_DIR_INVERT != 0),
        ]
    }

    fn ramp(&self, set: &Settings) -> Ramp {
        Ramp {
            position: i64::from(self.fraction),
            velocity: self.v,
            target: Velocity(self.target),
            accel: Accel(self.reach(set)),
        }
    }

    /// Clocks (a lower bound) in which no pin changes, no pulse is due and `stopped` stays, the
    /// inputs being as they are.
    pub fn quiet(&self, i: &Input) -> u64 {
        let set = &i.set;
        let halt = i.stop || !i.gate;
        if self.fresh
            || self.halted != halt
            || i.still
            || self.jump != (self.reach(set) == 0)
            || self.pins != self.polarised(set, self.pulse, self.reverse, self.reverse)
        {
            return 0;
        }
        if !i.gate {
            let rest = self.v == 0
                && !self.pulse
                && self.up
                && self.stopped
                && self.braking
                && self.target == 0;
            return if rest { u64::MAX } else { 0 };
        }
        if self.due() || self.turns(i) {
            return 0;
        }
        let mut clocks = u64::MAX;
        let arrives = self.ramp(set).clocks_to_target();
        // `stopped` rises when a halt has brought the velocity to rest and the pulse is over.
        if self.stopped != (halt && arrives == 0 && !self.pulse) {
            return 0;
        }
        if halt && arrives != 0 {
            clocks = arrives - 1;
        }
        if self.pulse {
            clocks = clocks.min(self.step.left(set.steplen));
        } else if self.wants_turn() {
            clocks = clocks.min(self.direction.left(self.dir_time(set)));
        }
        if self.v == 0 && arrives == 0 {
            return clocks;
        }
        clocks
            .min(self.clocks_to_turn(arrives, set))
            .min(self.clocks_to_due(arrives, set))
    }

    /// No fewer than these clocks until a turn is wanted that is not wanted now.
    fn clocks_to_turn(&self, arrives: u64, set: &Settings) -> u64 {
        let goal = i64::from(self.target) << VELOCITY_FRACTION;
        // The velocity at which DIR would move: below 0 going down, a whole unit going up.
        let edge = if self.reverse {
            1 << VELOCITY_FRACTION
        } else {
            0
        };
        let (from, to) = (self.v >= edge, goal >= edge);
        if arrives == 0 || from == to {
            return u64::MAX;
        }
        match u64::from(self.reach(set)) {
            0 => 0,
            limit => (self.v.abs_diff(edge) / limit).min(arrives - 1),
        }
    }

    /// At least this many clocks until the integer part of the position changes.
    fn clocks_to_due(&self, arrives: u64, set: &Settings) -> u64 {
        let velocity = self.v >> VELOCITY_FRACTION;
        // Clocks at a constant velocity until the fraction leaves 0..2^32.
        let steady = |fraction: u32, velocity: i64| match velocity {
            0 => u64::MAX,
            1.. => ((1u64 << 32) - u64::from(fraction)).div_ceil(velocity as u64) - 1,
            _ => u64::from(fraction) / velocity.unsigned_abs(),
        };
        if arrives == 0 {
            return steady(self.fraction, velocity);
        }
        // While it ramps no clock moves further than the faster of both ends.
        let fastest = velocity.abs().max(i64::from(self.target).abs()) + 1;
        let up = steady(self.fraction, fastest).min(steady(self.fraction, -fastest));
        if up >= 64 {
            return up;
        }
        // Close to it: count the clocks one by one, which is as fast as the closed form.
        let (mut ramp, mut clocks) = (self.ramp(set), 0);
        while clocks < 4096 {
            let sum = ramp.position + (ramp.velocity >> VELOCITY_FRACTION);
            if sum >> 32 != 0 {
                break;
            }
            ramp.clock();
            clocks += 1;
        }
        clocks
    }

    /// That many quiet clocks at once.
    pub fn skip(&mut self, clocks: u64, i: &Input) {
        if clocks == 0 {
            return;
        }
        self.step.skip(clocks, self.step_time(&i.set));
        self.direction.skip(clocks, self.dir_time(&i.set));
        if i.gate {
            let mut ramp = self.ramp(&i.set);
            ramp.advance(clocks);
            self.fraction = ramp.position as u32;
            self.v = ramp.velocity;
        }
    }
}
