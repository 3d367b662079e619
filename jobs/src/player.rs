//! Executes FPGA G's instructions ([`crate::fpgag`]) as segments: the words define the motion,
//! without look-ahead.
//!
//! FPGA G leaves these points open; they are defined here:
//!
//! * **An acceleration** of a move is in units of 64 steps/s^2. A move begins with the final speed
//!   of the one before. It speeds up for `loops_accel` steps, keeps its speed for `loops_travel`,
//!   and slows down for `loops_decel`. All motors make the same steps; bits 4, 5 and 6 of
//!   `direction`, which the description does not use, let motor 0, 1 or 2 stand.
//! * **A motor cannot jump**: an instruction is refused if it reverses or stops a moving motor,
//!   needs more speed or acceleration than the machine has, or moves without acceleration. A change
//!   of outputs during motion is refused only if its instruction is.
//! * **Bounds hold for the stop, too**: an instruction is refused if a motor leaves its bounds
//!   anywhere in it, or could not brake within them from there. The queue may run empty after every
//!   instruction, and the motors brake then.
//! * **The end**: a queue that runs empty during motion is an underrun.
//!
//! Positions between two instructions are kept with 32 fraction bits, so nothing is lost; at rest
//! the motors are on whole steps, if the words ask for that.

use crate::follower::{Follower, Leg};
use crate::fpgag::{Curve, Error, Move};
use motion::segment::{AXES, MIN_CLOCKS, MotionState, Segment};
use motion::wide::{product, wide};

/// steps/s^2 in a unit of a move's acceleration.
pub const ACCELERATION: u64 = 64;

/// Ticks of a curve per second.
const TICKS_PER_SECOND: u64 = 1_000_000;

/// Number of straight velocity segments that approximate a curve with a third coefficient.
const STRETCHES: i64 = 8;

/// A 16th of a step: how far segments may be off their reference. Motors rest in the middle of a
/// step.
const SLACK: i64 = 1 << 28;

/// Clocks from the end of the last segment to the first in which the motors brake: two for the
/// commit, and one to see that no segment follows.
const LATE: u64 = 3;

/// The motors' capabilities and bounds.
#[derive(Clone, Copy, Debug)]
pub struct Limits {
    /// The board's clock.
    pub clock_hz: u32,
    /// Largest acceleration, in a segment's unit.
    pub accel: [u32; AXES],
    /// Largest speed, steps/s.
    pub speed: [u32; AXES],
    /// Lowest and highest position, in steps from home.
    pub bounds: [(i64, i64); AXES],
}

/// An instruction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Word {
    /// In the form of the description.
    Move(Move),
    /// In the form of the final revision.
    Curve(Curve),
}

/// The reference's state after an instruction.
#[derive(Clone, Copy, Debug)]
struct End {
    /// Integrators.
    position: [i64; AXES],
    /// s32.24, as integrators have it.
    velocity: [i64; AXES],
    /// For a move, (steps/s)^2.
    square: u64,
}

/// Accepts instructions, and makes segments of them.
#[derive(Clone, Debug)]
pub struct Player<const DEPTH: usize> {
    limits: Limits,
    words: [Word; DEPTH],
    head: usize,
    count: usize,
    /// The state after the last instruction accepted, and after the last one begun.
    accepted: End,
    begun: End,
    legs: [Option<Leg>; STRETCHES as usize],
    leg: usize,
    follower: Follower,
}

impl<const DEPTH: usize> Player<DEPTH> {
    /// At rest, at these positions.
    pub fn new(limits: Limits, positions: [i64; AXES]) -> Self {
        let end = End {
            position: positions,
            velocity: [0; AXES],
            square: 0,
        };
        let mut follower = Follower::new(limits.accel);
        for (axis, position) in follower.machine.axes.iter_mut().zip(positions) {
            axis.position = position;
        }
        Player {
            limits,
            words: [Word::Move(Move {
                direction: 0,
                aux: 0,
                acceleration: 0,
                loops_accel: 0,
                loops_travel: 0,
                deceleration: 0,
                loops_decel: 0,
            }); DEPTH],
            head: 0,
            count: 0,
            accepted: end,
            begun: end,
            legs: [None; STRETCHES as usize],
            leg: 0,
            follower,
        }
    }

    /// Is there room for another instruction?
    pub fn full(&self) -> bool {
        self.count == DEPTH
    }

    /// Accepts an instruction, for which there must be room, or refuses it without an effect.
    pub fn push(&mut self, word: Word) -> Result<(), Error> {
        let (_, end) = self.legs_of(&word, &self.accepted)?;
        if self.full() {
            return Ok(());
        }
        self.words[(self.head + self.count) % DEPTH] = word;
        self.count += 1;
        self.accepted = end;
        Ok(())
    }

    /// Sets the limits for new instructions. [`Player::begin_at`] checks the waiting ones again.
    pub fn set_limits(&mut self, limits: Limits) {
        self.limits = limits;
    }

    /// Sets the motors' positions and limits before the first instruction begins. The waiting
    /// instructions are checked again; after an error the rest is discarded.
    pub fn begin_at(&mut self, limits: Limits, positions: [i64; AXES]) -> Result<(), Error> {
        self.limits = limits;
        self.follower = Follower::new(limits.accel);
        let (head, count) = (self.head, core::mem::take(&mut self.count));
        let end = End {
            position: positions,
            velocity: [0; AXES],
            square: 0,
        };
        (self.accepted, self.begun) = (end, end);
        for (axis, position) in self.follower.machine.axes.iter_mut().zip(positions) {
            axis.position = position;
        }
        for index in 0..count {
            self.push(self.words[(head + index) % DEPTH])?;
        }
        Ok(())
    }

    /// The motors' positions after all outputs of [`Player::poll`].
    pub fn machine(&self) -> &MotionState {
        &self.follower.machine
    }

    /// The next segment; `next`: another instruction may be begun. `None`: there is none.
    pub fn poll(&mut self, next: bool) -> Option<Segment> {
        loop {
            if let Some(segment) = self.follower.piece(0) {
                return Some(segment);
            }
            if let Some(Some(leg)) = self.legs.get(self.leg).copied() {
                self.leg += 1;
                let at = -self.follower.ahead;
                self.follower.leg = Some(Leg { at, ..leg });
                continue;
            }
            // Coefficients are rounded: a velocity that a motor can stop from in the shortest
            // segment counts as 0.
            let slow = |(velocity, accel): (&i64, &u32)| {
                velocity.unsigned_abs() <= u64::from(*accel) * u64::from(MIN_CLOCKS)
            };
            let stands = self.begun.velocity.iter().zip(&self.limits.accel).all(slow);
            if stands && !self.follower.machine.rests() {
                return Some(self.follower.come_to_rest(0));
            }
            if stands {
                self.follower.ahead = 0;
            }
            if self.count == 0 || !next {
                return None;
            }
            let word = self.words[self.head];
            self.head = (self.head + 1) % DEPTH;
            self.count -= 1;
            // It was checked when it was accepted.
            let (legs, end) = self.legs_of(&word, &self.begun).ok()?;
            (self.legs, self.leg, self.begun) = (legs, 0, end);
            self.follower.machine.aux = match word {
                Word::Move(word) => word.aux,
                Word::Curve(curve) => curve.aux.into(),
            };
        }
    }

    fn legs_of(&self, word: &Word, from: &End) -> Result<(Legs, End), Error> {
        let (legs, end) = match word {
            Word::Move(word) => self.move_legs(word, from)?,
            Word::Curve(curve) => self.curve_legs(curve, from)?,
        };
        self.within(&legs, from, &end)?;
        Ok((legs, end))
    }

    /// Is every motor within its bounds in all these legs, and slow enough to stop within them?
    /// With no more acceleration than the limit the stopping point moves on with the motor, so the
    /// ends of the legs and the turning points are sufficient.
    fn within(&self, legs: &Legs, from: &End, end: &End) -> Result<(), Error> {
        let mut legs = legs.iter().flatten().peekable();
        let mut inside = true;
        while let Some(leg) = legs.next() {
            let next = legs.peek();
            let positions = next.map_or(&end.position, |next| &next.position);
            let velocities = next.map_or(&end.velocity, |next| &next.velocity);
            for axis in 0..AXES {
                let (position, begin) = (leg.position[axis], leg.velocity[axis]);
                let finish = velocities[axis];
                inside &= self.stops(axis, position, begin, self.braking(axis, begin));
                inside &= self.stops(axis, positions[axis], finish, self.braking(axis, finish));
                if begin.signum() == -finish.signum() {
                    let turn = turning(begin, finish, leg.duration);
                    inside &= self.stops(axis, position, begin, turn);
                }
            }
        }
        for axis in 0..AXES {
            let (before, behind) = (from.position[axis], end.position[axis]);
            let slack = if before == behind { 0 } else { SLACK };
            inside &= self.holds(axis, behind, [true; 2], slack);
        }
        inside.then_some(()).ok_or(Error::Bounds)
    }

    /// The way a motor with this velocity needs to stop, as a way of its integrator.
    fn braking(&self, axis: usize, velocity: i64) -> u64 {
        // v^2 / 2a: 2^-44 steps per clock are left of 2^-56, so that steps with 32 fraction bits
        // come out.
        let speed = (velocity.unsigned_abs() >> 12) + 1;
        let way = wide(
            product(speed, speed),
            2 * u64::from(self.limits.accel[axis]),
        );
        way.saturating_add(((velocity.unsigned_abs() >> 24) + 1) * LATE)
    }

    /// Is the motor within its bounds after this way in the direction of its velocity? A motor at
    /// rest is.
    fn stops(&self, axis: usize, position: i64, velocity: i64, way: u64) -> bool {
        let stands = i64::try_from(way).ok();
        let stands = stands.and_then(|way| position.checked_add(way * velocity.signum()));
        let sides = [velocity < 0, velocity > 0];
        velocity == 0 || stands.is_some_and(|place| self.holds(axis, place, sides, SLACK))
    }

    /// Is this position within those of the two bounds that are to be checked?
    fn holds(&self, axis: usize, place: i64, [low, high]: [bool; 2], slack: i64) -> bool {
        let Some(&(lowest, highest)) = self.limits.bounds.get(axis) else {
            return false;
        };
        let below = place.saturating_sub(slack) >> 32 < lowest;
        let above = place.saturating_add(slack) >> 32 > highest;
        !(low && below || high && above)
    }

    fn move_legs(&self, word: &Move, from: &End) -> Result<(Legs, End), Error> {
        let bit = |at: usize| word.direction >> at & 1 == 1;
        let signs: [i64; AXES] = core::array::from_fn(|axis| match (bit(axis + 4), bit(axis)) {
            (true, _) => 0,
            (false, true) => -1,
            (false, false) => 1,
        });
        let moving = from.velocity != [0; AXES];
        let square = if moving { from.square } else { 0 };
        let turns = |(sign, velocity): (&i64, &i64)| *sign != velocity.signum();
        if moving && (square == 0 || signs.iter().zip(&from.velocity).any(turns)) {
            return Err(Error::Jump);
        }
        let gain = |accel: u16, loops: u16| 2 * ACCELERATION * u64::from(accel) * u64::from(loops);
        let top = square + gain(word.acceleration, word.loops_accel);
        let slower = gain(word.deceleration, word.loops_decel);
        let last = top.checked_sub(slower).ok_or(Error::NoAcceleration)?;
        if top == 0 && word.loops() > 0 {
            return Err(Error::NoAcceleration);
        }
        let accel = u64::from(word.acceleration.max(word.deceleration)) * ACCELERATION;
        for (axis, _) in signs.iter().enumerate().filter(|(_, sign)| **sign != 0) {
            if top.isqrt() >= u64::from(self.limits.speed[axis]) || accel >= self.accel(axis) {
                return Err(Error::Fast);
            }
        }
        let mut end = *from;
        let mut legs = [None; STRETCHES as usize];
        let parts = [
            (word.loops_accel, square, top),
            (word.loops_travel, top, top),
            (word.loops_decel, top, last),
        ];
        let parts = parts.into_iter().filter(|(loops, ..)| *loops > 0);
        for (leg, (loops, begin, finish)) in legs.iter_mut().zip(parts) {
            *leg = Some(self.straight(&mut end, &signs, loops.into(), [begin, finish]));
        }
        end.square = last;
        if last == 0 {
            end.velocity = [0; AXES];
        }
        Ok((legs, end))
    }

    /// steps/s^2.
    fn accel(&self, axis: usize) -> u64 {
        let clock = u128::from(self.limits.clock_hz);
        let accel = (u128::from(self.limits.accel[axis]) * clock * clock) >> 56;
        u64::try_from(accel).unwrap_or(u64::MAX)
    }

    /// This many steps from one speed to another, given as squares.
    fn straight(&self, end: &mut End, signs: &[i64; AXES], steps: u64, squares: [u64; 2]) -> Leg {
        // steps/s with 10 fraction bits.
        let [begin, finish] = squares.map(|square| (u128::from(square) << 20).isqrt());
        let clock = u128::from(self.limits.clock_hz);
        let duration = ((2 * u128::from(steps) * clock) << 26) / (begin + finish).max(1);
        let velocity = |speed: u128, sign: i64| ((speed << 46) / clock) as i64 * sign;
        let mut leg = Leg {
            duration: duration as i64,
            at: 0,
            position: end.position,
            velocity: signs.map(|sign| velocity(begin, sign)),
            accel: [0; AXES],
        };
        let last = signs.map(|sign| velocity(finish, sign));
        leg.steer(&last);
        for (position, sign) in end.position.iter_mut().zip(signs) {
            *position = position.wrapping_add(((steps as i64) << 32) * sign);
        }
        end.velocity = last;
        leg
    }

    fn curve_legs(&self, curve: &Curve, from: &End) -> Result<(Legs, End), Error> {
        let bent = curve.motors.iter().any(|motor| motor[2] != 0);
        let count = if bent { STRETCHES } else { 1 };
        let clock = i128::from(self.limits.clock_hz);
        let per_second = i128::from(TICKS_PER_SECOND);
        // A motor's state after this many eighths of the ticks: s32.32 from the beginning, and
        // s32.24 of velocity.
        let at = |motor: &[i32; 3], eighths: i64| {
            let [c0, c1, c2] = motor.map(i128::from);
            let t = i128::from(curve.ticks) * i128::from(eighths) * i128::from(STRETCHES / count);
            let place = 2 * (c0 * t * 64 + c1 * t * t * 8 + c2 * t * t * t) / 512;
            let speed = (c0 * 64 + 2 * c1 * t * 8 + 3 * c2 * t * t) / 64;
            // 2^-31 steps a tick, in 2^-56 steps a clock.
            (place, (speed << 25) * per_second / clock)
        };
        let duration = ((i128::from(curve.ticks) * clock) << 16) / per_second / i128::from(count);
        let duration = duration as i64;
        let mut end = *from;
        end.square = 0;
        let mut legs = [None; STRETCHES as usize];
        for (index, place) in (0..count).zip(&mut legs) {
            let mut leg = Leg {
                duration,
                at: 0,
                position: end.position,
                velocity: [0; AXES],
                accel: [0; AXES],
            };
            let mut last = [0; AXES];
            for (axis, motor) in curve.motors.iter().enumerate() {
                let (_, begin) = at(motor, index);
                let (way, finish) = at(motor, index + 1);
                let most = (i128::from(self.limits.speed[axis]) << 56) / clock;
                let limit = i128::from(self.limits.accel[axis]);
                let jump = begin - i128::from(end.velocity[axis]);
                let change = finish - begin;
                let clocks = i128::from(duration >> 16);
                if begin.abs() > most || finish.abs() > most || change.abs() > limit * clocks {
                    return Err(Error::Fast);
                }
                if jump.abs() > limit * clocks.min(1024) {
                    return Err(Error::Jump);
                }
                leg.velocity[axis] = begin as i64;
                last[axis] = finish as i64;
                let from = from.position[axis];
                let way = i64::try_from(way).map_err(|_| Error::Fast)?;
                end.position[axis] = from.checked_add(way).ok_or(Error::Bounds)?;
            }
            leg.steer(&last);
            end.velocity = last;
            *place = Some(leg);
        }
        Ok((legs, end))
    }
}

/// How far a motor goes on before it turns, in a leg of this duration from one velocity to the
/// opposite one; rounded up.
fn turning(begin: i64, finish: i64, duration: i64) -> u64 {
    let (begin, finish) = (begin.unsigned_abs(), finish.unsigned_abs());
    // The part of the leg in which it slows down, times half of its velocity.
    let part = wide(product(begin, begin), begin.saturating_add(finish));
    let clocks = (duration.unsigned_abs() >> 16) + 1;
    ((part >> 24) + 1).saturating_mul(clocks) / 2 + 1
}

type Legs = [Option<Leg>; STRETCHES as usize];
