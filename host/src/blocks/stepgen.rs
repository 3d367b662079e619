//! `stepgen.<nn>`: a position or velocity command in, STEP and DIR out, and feedback of the emitted
//! pulses.
//!
//! | pin | | |
//! |---|---|---|
//! | `position-cmd` | float in | followed while `control-type` is false |
//! | `velocity-cmd` | float in | followed while `control-type` is true |
//! | `control-type` | bit in | 0 position, 1 velocity; may change while moving |
//! | `enable` | bit in | false: ramps to rest at `maxaccel` |
//! | `counts` | s32 out | pulses emitted, as sampled |
//! | `position-fb` | float out | predicted to the end of the period, sub-step |
//! | `velocity-fb` | float out | the velocity there |
//! | `rate-limited` | bit out | more was asked than the step timing allows |
//! | `position-reset` | bit in | while true `counts` and position are 0; moves nothing |
//! | `index-enable` | bit io | set it; at the next index the position restarts there and it falls |
//! | `probe-enable` | bit io | set it; when the probe trips the place is latched and it falls |
//! | `count-latched`, `position-latched` | s32, float out | where the last index or probe was |
//!
//! Parameters, all read/write: `position-scale` (steps per unit, not 0), `maxvel`, `maxaccel` (0:
//! no limit; never negative), `steplen`, `stepspace` (ns, up to 136 us at 60 MHz), `dirsetup`,
//! `dirhold` (ns, up to 1.09 ms), `step-type` ([`StepType`]: 0 step/dir, 1 up/down, 2 quadrature;
//! the board file's `type` until HAL sets it), `step-invert`, `dir-invert`, `index-invert`. What
//! concerns the pins reaches the board while it is disarmed.
//!
//! # The position loop
//!
//! hostmot2's, on a plant that is a true ramp. The command of period *k* is the position at its
//! end. Feed-forward is the command's own velocity; `seconds_to_match` is how long the fabric's
//! acceleration limit takes to get there; the error expected at that moment is corrected with gain
//! 0.5 per period, or by ramping whichever way makes it smaller when matching takes longer than a
//! period. The result stays within reach of one period at `maxaccel`, so a board that receives no
//! further command holds a velocity that was commanded.
//!
//! While feedback is frozen, an outer loop through `velocity-cmd` sees a false error and would run
//! away. Therefore the velocity may fall then, but not rise or change its sign.
//!
//! When an index or `position-reset` moves the origin, LinuxCNC moves its command by the same
//! amount in the same period. That is not motion, so the feed-forward is computed from the new
//! origin.

use super::latch::{LatchSample, Latching, Source};
use super::{Feedback, Period, PredictionBasis, nanos_to_register};
use crate::hal::checked::{Checked, Rule};
use crate::hal::{ExportError, Exporter, In, Io, Out, Param};
use motion::Ramp;
use motion::ramp::VELOCITY_FRACTION;
use wire::map::{
    DIR_CLOCKS_MAX, STEP_CLOCKS_MAX, STEPGEN_CONFIG_WORDS, STEPGEN_DIR_INVERT,
    STEPGEN_INDEX_INVERT, STEPGEN_STEP_INVERT, STEPGEN_TYPE_SHIFT, StepType,
};
use wire::units::{Accel, Count, Position, Velocity};

/// 5 us: every common driver accepts that; use `setp` for faster ones.
const DEFAULT_STEP_NS: u32 = 5_000;
/// 20 us: the slowest opto-coupled inputs we know of.
const DEFAULT_DIR_NS: u32 = 20_000;
/// As [`StepType`] numbers them.
const STEP_TYPES: Rule = Rule::Whole(0, 2);

/// One stepgen.
#[derive(Debug)]
pub struct Stepgen {
    position_cmd: Checked<f64>,
    velocity_cmd: Checked<f64>,
    enable: In<bool>,
    control_type: In<bool>,
    counts: Out<i32>,
    position_fb: Out<f64>,
    velocity_fb: Out<f64>,
    rate_limited: Out<bool>,
    position_reset: In<bool>,
    index_enable: Io<bool>,
    probe_enable: Io<bool>,
    count_latched: Out<i32>,
    position_latched: Out<f64>,
    position_scale: Checked<f64>,
    maxvel: Checked<f64>,
    maxaccel: Checked<f64>,
    steplen: Checked<u32>,
    stepspace: Checked<u32>,
    dirsetup: Checked<u32>,
    dirhold: Checked<u32>,
    step_type: Checked<u32>,
    step_invert: Param<bool>,
    dir_invert: Param<bool>,
    index_invert: Param<bool>,

    track: Track,
    latch: Latching,
    /// The stepgen as predicted for the next command; its position counts from `track`.
    ramp: Ramp,
    /// `position-cmd` of the last period, if it was a number.
    last_cmd: Option<f64>,
    /// By how much the origin moved since, in units.
    shifted: f64,
    /// What was asked last.
    sent: Target,
    /// And before that: in force until the last command is applied.
    before: Target,
    /// The step timing as the board has it, in clocks per step.
    clocks_per_step: f64,
    /// The host had to clamp.
    clamped: bool,
}

/// What an answer says about one stepgen.
#[derive(Clone, Copy, Debug)]
pub struct Sample {
    /// Where it was.
    pub position: Position,
    /// How fast.
    pub velocity: Velocity,
    /// The step timing held it back.
    pub limited: bool,
    /// Its latch.
    pub latch_sample: LatchSample,
}

/// What goes into the command block for one stepgen.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Target {
    /// Not ramping to rest.
    pub enable: bool,
    /// Velocity to move towards.
    pub velocity: Velocity,
    /// By at most this per clock.
    pub accel: Accel,
    /// In velocity mode: it is not on a common path with the others.
    pub alone: bool,
}

impl Stepgen {
    /// Exports the pins; `kind` is what the board file says it is.
    pub fn export(hal: &mut Exporter<'_>, kind: StepType) -> Result<Self, ExportError> {
        Ok(Stepgen {
            position_cmd: hal.command("position-cmd")?,
            velocity_cmd: hal.command("velocity-cmd")?,
            enable: hal.input("enable")?,
            control_type: hal.input("control-type")?,
            counts: hal.output("counts")?,
            position_fb: hal.output("position-fb")?,
            velocity_fb: hal.output("velocity-fb")?,
            rate_limited: hal.output("rate-limited")?,
            position_reset: hal.input("position-reset")?,
            index_enable: hal.both("index-enable", false)?,
            probe_enable: hal.both("probe-enable", false)?,
            count_latched: hal.output("count-latched")?,
            position_latched: hal.output("position-latched")?,
            position_scale: hal.setting("position-scale", 1.0, Rule::Divisor)?,
            maxvel: hal.setting("maxvel", 0.0, Rule::Limit)?,
            maxaccel: hal.setting("maxaccel", 1.0, Rule::Limit)?,
            steplen: hal.setting("steplen", DEFAULT_STEP_NS, Rule::Any)?,
            stepspace: hal.setting("stepspace", DEFAULT_STEP_NS, Rule::Any)?,
            dirsetup: hal.setting("dirsetup", DEFAULT_DIR_NS, Rule::Any)?,
            dirhold: hal.setting("dirhold", DEFAULT_DIR_NS, Rule::Any)?,
            step_type: hal.setting("step-type", kind as u32, STEP_TYPES)?,
            step_invert: hal.param("step-invert", false)?,
            dir_invert: hal.param("dir-invert", false)?,
            index_invert: hal.param("index-invert", false)?,
            track: Track::default(),
            latch: Latching::default(),
            ramp: Ramp::default(),
            last_cmd: Some(0.0),
            shifted: 0.0,
            sent: Target::default(),
            before: Target::default(),
            clocks_per_step: 1.0,
            clamped: false,
        })
    }

    /// This channel's configuration block.
    pub fn configure(&mut self, clock_hz: f64) -> [u32; STEPGEN_CONFIG_WORDS as usize] {
        let time = |nanos: &Checked<u32>, least, most| {
            nanos_to_register(nanos.get(), clock_hz, least, most)
        };
        let steplen = time(&self.steplen, 1, STEP_CLOCKS_MAX);
        let stepspace = time(&self.stepspace, 1, STEP_CLOCKS_MAX);
        self.clocks_per_step = f64::from(steplen) + f64::from(stepspace);
        let bit = |parameter: &Param<bool>, bit: u32| u32::from(parameter.get()) * bit;
        let kind = StepType::from_code(self.step_type.get()).unwrap_or_default();
        [
            steplen,
            stepspace,
            time(&self.dirsetup, 0, DIR_CLOCKS_MAX),
            time(&self.dirhold, 0, DIR_CLOCKS_MAX),
            self.stop_accel(clock_hz).0,
            bit(&self.step_invert, STEPGEN_STEP_INVERT)
                | bit(&self.dir_invert, STEPGEN_DIR_INVERT)
                | bit(&self.index_invert, STEPGEN_INDEX_INVERT)
                | (kind as u32) << STEPGEN_TYPE_SHIFT,
        ]
    }

    /// Takes what the board sampled, predicts it to the next command and publishes it.
    pub fn sampled(&mut self, sample: &Sample, basis: PredictionBasis, period: Period) {
        let &Sample {
            position, velocity, ..
        } = sample;
        self.track.update(position);
        self.follow_origin(&sample.latch_sample);
        let predict = |from: Position, velocity, target: Target, clocks| {
            Ramp::predict(from, velocity, target.velocity, target.accel, clocks)
        };
        let stop = Target {
            accel: self.stop_accel(period.clock_hz),
            ..Target::default()
        };
        self.ramp = match basis {
            PredictionBasis::Commanded { lead, ahead } => {
                let applied = predict(position, velocity, self.before, lead);
                let at = Position(applied.position);
                predict(at, applied.velocity(), self.sent, ahead)
            }
            PredictionBasis::Stopping { ahead } => predict(position, velocity, stop, ahead),
            PredictionBasis::Still => Ramp {
                position: position.0,
                ..Ramp::default()
            },
        };
        self.counts.set(self.track.pulses() as i32);
        self.rate_limited.set(sample.limited || self.clamped);
        self.publish(period.clock_hz);
    }

    /// Moves the origin, if an index or the operator says so.
    fn follow_origin(&mut self, latch_sample: &LatchSample) {
        let scale = self.position_scale.get();
        if let Some((source, value)) = self.latch.answered(latch_sample) {
            let at = self.track.pulses_at(value);
            self.count_latched.set(at as i32);
            self.position_latched.set(at as f64 / scale);
            match source {
                Source::Index => {
                    self.track.restart(at);
                    self.shifted += at as f64 / scale;
                    self.index_enable.set(false);
                }
                Source::Probe => self.probe_enable.set(false),
            }
        }
        if self.position_reset.get() {
            let at = self.track.pulses();
            self.track.restart(at);
            self.shifted += at as f64 / scale;
        }
    }

    /// One answer is missing: the board is assumed to do what it was last told.
    pub fn bridge(&mut self, period: Period) {
        self.ramp.advance(period.clocks.0);
        self.publish(period.clock_hz);
    }

    /// The fabric was reset: it counts from 0 again, but the machine has not moved.
    pub fn rebase(&mut self) {
        self.track.rebase();
        self.latch.forget();
    }

    /// Nothing is known of the board's latch any more.
    pub fn forget_latch(&mut self) {
        self.latch.forget();
    }

    /// Whether to latch at the next index and at the probe.
    pub fn arms(&mut self, live: bool, sequence: u32) -> (bool, bool) {
        let (index, probe) = (self.index_enable.get(), self.probe_enable.get());
        self.latch.command(index, probe, live, sequence)
    }

    /// Whether the latch holds a value to be fetched.
    pub fn wants_value(&self) -> bool {
        self.latch.wants_value()
    }

    /// The target of the coming period. Not `live`: rest, for any values of the pins.
    pub fn command(&mut self, live: bool, feedback: Feedback, period: Period) -> Target {
        let scale = self.position_scale.get();
        let cmd = self.position_cmd.now();
        let feed_forward = self.advance_of(cmd) / period.seconds * scale;
        self.last_cmd = cmd;
        self.clamped = false;
        self.before = self.sent;
        if !live || !self.enable.get() {
            self.sent = Target {
                accel: self.stop_accel(period.clock_hz),
                ..Target::default()
            };
            return self.sent;
        }

        let accel = self.maxaccel.get() * scale.abs();
        let now = Motion {
            position: self.steps(),
            velocity: velocity_hz(&self.ramp, period.clock_hz),
        };
        // A command that is not a number counts as no command: the axis comes to rest.
        let wanted = if self.control_type.get() {
            let asked = self.velocity_cmd.now().map_or(0.0, |asked| asked * scale);
            if feedback == Feedback::Frozen {
                towards_rest(asked, self.before.velocity.to_hz(period.clock_hz))
            } else {
                asked
            }
        } else if let Some(cmd) = cmd {
            if feedback == Feedback::Frozen {
                // Two answers are missing: the position is not known, so only the commanded
                // velocity counts.
                within_reach(feed_forward, now.velocity, accel, period.seconds)
            } else {
                approach(now, cmd * scale, feed_forward, accel, period.seconds)
            }
        } else {
            0.0
        };
        let velocity =
            Velocity::from_hz(self.clamp(wanted, scale, period.clock_hz), period.clock_hz);
        self.sent = Target {
            enable: true,
            velocity,
            accel: Accel::from_steps(accel, period.clock_hz),
            alone: self.control_type.get(),
        };
        self.sent
    }

    /// How far the command moved in a period. If the origin moved too, the smaller movement is the
    /// true one: either the command followed the origin or it did not. The first valid position is
    /// not a movement.
    fn advance_of(&mut self, cmd: Option<f64>) -> f64 {
        let shifted = core::mem::take(&mut self.shifted);
        let Some((cmd, last)) = cmd.zip(self.last_cmd) else {
            return 0.0;
        };
        let moved = cmd - last;
        let followed = moved + shifted;
        if followed.abs() < moved.abs() {
            followed
        } else {
            moved
        }
    }

    /// Limits a velocity to `maxvel` and to what the step timing allows.
    fn clamp(&mut self, wanted: f64, scale: f64, clock_hz: f64) -> f64 {
        let physical = clock_hz / self.clocks_per_step;
        self.clamped = wanted.abs() > physical;
        let limit = match self.maxvel.get() * scale.abs() {
            0.0 => physical,
            maxvel => maxvel.min(physical),
        };
        wanted.clamp(-limit, limit)
    }

    fn stop_accel(&self, clock_hz: f64) -> Accel {
        let scale = self.position_scale.get();
        Accel::from_steps(self.maxaccel.get() * scale.abs(), clock_hz)
    }

    /// Predicted position in steps.
    fn steps(&self) -> f64 {
        self.track.steps(self.ramp.position)
    }

    fn publish(&self, clock_hz: f64) {
        let scale = self.position_scale.get();
        self.position_fb.set(self.steps() / scale);
        self.velocity_fb
            .set(velocity_hz(&self.ramp, clock_hz) / scale);
    }
}

/// Extends a 32.32 register: wraps and restarts of the board do not show.
#[derive(Clone, Copy, Debug, Default)]
struct Track {
    /// The register as last sampled; `None` before the first sample and after a reset.
    last: Option<Position>,
    /// The same without wraps, in the register's unit, half-step bias included.
    total: i128,
    /// Pulses at which the position is 0.
    origin: i64,
}

impl Track {
    fn update(&mut self, position: Position) {
        self.total = match self.last {
            Some(last) => self.total + i128::from(position.0.wrapping_sub(last.0)),
            // First contact takes the board's count as it is: positions survive this program.
            // After a reset `total` holds the whole steps to go on from.
            None => self.total + i128::from(position.0),
        };
        self.last = Some(position);
    }

    fn rebase(&mut self) {
        if self.last.take().is_some() {
            // Whole pulses only: the fraction is where the new phase begins.
            self.total = (self.total >> 32) << 32;
        }
    }

    /// Pulses from the origin.
    fn pulses(&self) -> i64 {
        (self.total >> 32) as i64 - self.origin
    }

    /// The same where the low half of the register's pulses was `value`, not long ago.
    fn pulses_at(&self, value: Count) -> i64 {
        let last = self.last.map_or(0, Position::pulses);
        self.pulses() - i64::from(Count(last as u32).since(value))
    }

    /// Makes this place, counted from the present origin, the new one.
    fn restart(&mut self, at: i64) {
        self.origin += at;
    }

    /// Steps at `register`, somewhere near the last sample.
    fn steps(&self, register: i64) -> f64 {
        let last = self.last.map_or(register, |position| position.0);
        let here = self.total + i128::from(register.wrapping_sub(last));
        let fraction = (here & 0xffff_ffff) as f64 / 4_294_967_296.0;
        ((here >> 32) as i64 - self.origin) as f64 + (fraction - 0.5)
    }
}

/// Where something is and how fast, in steps.
#[derive(Clone, Copy, Debug)]
struct Motion {
    position: f64,
    velocity: f64,
}

/// The velocity that brings `now` to `target` at the end of the period, or as near as `accel` lets
/// it.
fn approach(now: Motion, target: f64, feed_forward: f64, accel: f64, period: f64) -> f64 {
    let velocity_error = now.velocity - feed_forward;
    let to_match = if accel > 0.0 {
        velocity_error.abs() / accel
    } else {
        0.0
    };
    let travelled = 0.5 * (now.velocity + feed_forward) * to_match;
    // The command is for the end of this period; at the match it will be this much further.
    let target_then = target + feed_forward * (to_match - period);
    let error = now.position + travelled - target_then;
    if to_match < period {
        let wanted = feed_forward - 0.5 * error / period;
        return within_reach(wanted, now.velocity, accel, period);
    }
    let towards = -velocity_error.signum() * accel;
    // Ramping away from the match for one period moves the meeting point by about this much.
    let detour = -2.0 * towards * period * to_match;
    let ramp = if (error + 2.0 * detour).abs() < error.abs() {
        -towards
    } else {
        towards
    };
    now.velocity + ramp * period
}

/// What is asked, if it is no faster than `held` and the same way.
fn towards_rest(asked: f64, held: f64) -> f64 {
    asked.clamp(held.min(0.0), held.max(0.0))
}

fn within_reach(wanted: f64, velocity: f64, accel: f64, period: f64) -> f64 {
    if accel > 0.0 {
        wanted.clamp(velocity - accel * period, velocity + accel * period)
    } else {
        wanted
    }
}

fn velocity_hz(ramp: &Ramp, clock_hz: f64) -> f64 {
    let unit = clock_hz / (1u64 << (32 + VELOCITY_FRACTION)) as f64;
    ramp.velocity as f64 * unit
}

#[cfg(test)]
mod tests;
