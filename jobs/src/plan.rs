//! The look-ahead planner: [`Instruction`]s in, [`Segment`]s out, integers only, memory fixed at
//! compile time.
//!
//! The motion is what the integrators can do exactly: constant acceleration for whole clocks. A
//! line is accelerated, held and decelerated within the limits of every axis. At a corner the
//! velocity does not jump, because no machine could follow, but takes a parabola tangent to both
//! lines:
//!
//! ```text
//!            corner          The blend begins d before the corner and ends d after it, at one speed u, in 2d/u.
//!        ----.-.----+        Its acceleration is u^2 |difference of directions| / 2d: within every axis' limit by choice of u.
//!                 `. \       It passes the corner at |difference| d / 4: within the junction deviation by choice of d.
//!               d   `.|      d is at most 2/5 of either line. It does not depend on the speed in the end, so a feed override
//!                     |      or a pause changes when the machine is somewhere, never where.
//! ```
//!
//! Speeds: the planner stores squares of speeds, so that braking is linear: `w_in <= w_out + 2 a
//! l`. A pass backwards through the buffer gives the largest speeds from which the end can be
//! reached at rest. The last known line counts as 2/5 shorter than it is, because the next corner
//! may take that much. A line begins when the buffer is full or no more instructions will come. By
//! then its final speed is fixed, and whatever follows, the machine can still brake.
//!
//! Exactness: the reference is continuous, in steps with 32 fraction bits and clocks with 16. A
//! segment lasts whole clocks. It starts from where the integrators *are* (computed with the
//! arithmetic of the gateware, bit by bit) and aims at the reference's velocity at its end; the
//! missing position is spread over the next 2^21 clocks. So no error accumulates. At a stop (tool,
//! dwell, home, pause, end) the position is a whole step, and the last segment's velocity is 0.

mod line;
mod setup;

pub use self::setup::{AxisSetup, Setup, SetupError};

use self::line::{LONGEST, PlannedLine, gain, square};
use self::setup::Machinery;
use crate::circle::Chords;
use crate::follower::{Follower, Leg};
use crate::instruction::{CENTER_FARTHEST, DWELL_LONGEST, FARTHEST, Feed, Instruction, Place};
use motion::segment::{AXES, Axis, MIN_CLOCKS, MotionState, Segment};
use motion::wide::{Inverse, product, quotient, quotient_up, scaled, wide};
use wire::units::Position;

/// The planner's next output.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Output {
    /// Execute this segment.
    Segment(Segment),
    /// All axes rest: home these axes. They are at step 0 then.
    Home([bool; AXES]),
    /// All axes rest: wait for the operator.
    Pause,
    /// All axes rest: the job has ended.
    End,
}

/// The result of one piece of work.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Work {
    /// Do this next.
    Output(Output),
    /// No output yet: there is more work.
    More,
    /// It needs another instruction to continue.
    Starved,
}

/// The largest square of a speed, in (nm/s)^2.
const FASTEST: u64 = 1 << 63;

/// Directions have 30 fraction bits.
const ONE: i64 = 1 << 30;

/// Two directions this close to each other (8e-9 of a turn's radius) count as one.
const STRAIGHT: u64 = 1 << 3;

/// The instruction that is not planned yet, because the next one decides whether it ends on a whole
/// step.
#[derive(Clone, Copy, Debug)]
struct Pending {
    to: Place,
    feed: Feed,
    tag: u32,
}

/// What waits until all axes rest.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Then {
    Aux(u16),
    /// Clocks left.
    Dwell(u64),
    Home([bool; AXES]),
    Pause,
    End,
}

/// The stretches of the current line that are still to come.
#[derive(Clone, Copy, Debug, Default)]
struct Stretch {
    /// Speeds, nm/s.
    from: u64,
    to: u64,
    /// Clocks, 16 fraction bits.
    duration: i64,
    /// To the corner at the beginning, nm with 16 fraction bits.
    left: i64,
    /// Round the corner, not along the line.
    blend: bool,
}

#[derive(Clone, Copy, Debug)]
struct Running {
    line: PlannedLine,
    /// Slope of the line after it.
    next: [i64; AXES],
    stretches: [Stretch; 4],
    index: usize,
}

/// The planner, looking `DEPTH` lines ahead.
#[derive(Clone, Debug)]
pub struct Planner<const DEPTH: usize> {
    machinery: Machinery,
    percent: u32,
    lines: [PlannedLine; DEPTH],
    head: usize,
    count: usize,
    /// Where the last instruction ends.
    at: Place,
    /// Where the last line of the buffer ends: place and integrators.
    end: (Place, [i64; AXES]),
    pending: Option<Pending>,
    chords: Option<(Chords, Feed)>,
    tag: u32,
    then: Option<Then>,
    /// The final speed of the line being drawn, nm/s.
    speed: u64,
    running: Option<Running>,
    follower: Follower,
}

impl<const DEPTH: usize> Planner<DEPTH> {
    /// At rest, at home, all outputs off.
    pub fn new(setup: &Setup) -> Result<Self, SetupError> {
        const { assert!(DEPTH >= 3, "a line, its successor, and one to look ahead") };
        let machinery = Machinery::new(setup)?;
        Ok(Planner {
            follower: Follower::new(machinery.limit),
            machinery,
            percent: 100,
            lines: [PlannedLine::NONE; DEPTH],
            head: 0,
            count: 0,
            at: [0; AXES],
            end: ([0; AXES], [Position::ZERO.0; AXES]),
            pending: None,
            chords: None,
            tag: 0,
            then: None,
            speed: 0,
            running: None,
        })
    }

    /// Does [`Planner::push`] take an instruction now? If not, [`Planner::poll`] has an output.
    pub fn accepts(&self) -> bool {
        self.then.is_none() && self.chords.is_none() && self.count < DEPTH
    }

    /// Adds the next instruction; `tag` (a line number) is returned by [`Planner::tag`]. False, and
    /// no effect, if [`Planner::accepts`] is false, a position is out of bounds or a dwell is too
    /// long.
    #[must_use]
    pub fn push(&mut self, instruction: &Instruction, tag: u32) -> bool {
        if !self.accepts() {
            return false;
        }
        let far = |place: &Place| {
            place
                .iter()
                .any(|nm| nm.unsigned_abs() > FARTHEST.unsigned_abs())
        };
        match *instruction {
            Instruction::Line { to, feed } => {
                if far(&to) {
                    return false;
                }
                self.tag = tag;
                self.line_to(to, feed);
            }
            Instruction::Arc(arc) => {
                if far(&arc.to)
                    || arc
                        .center
                        .iter()
                        .any(|nm| nm.unsigned_abs() > CENTER_FARTHEST.unsigned_abs())
                {
                    return false;
                }
                self.tag = tag;
                let tolerance = self.machinery.setup.chord_tolerance;
                self.chords = Some((Chords::new(self.at, arc, tolerance), arc.feed));
            }
            Instruction::Dwell { micros } if micros > DWELL_LONGEST => return false,
            Instruction::Dwell { micros } => self.then = Some(Then::Dwell(self.clocks_of(micros))),
            Instruction::Aux { bits } => self.then = Some(Then::Aux(bits)),
            Instruction::Home { axes } => self.then = Some(Then::Home(axes)),
            Instruction::Pause => self.then = Some(Then::Pause),
            Instruction::End => self.then = Some(Then::End),
        }
        true
    }

    /// The next output. `None`: it needs another instruction.
    pub fn poll(&mut self) -> Option<Output> {
        loop {
            match self.work(usize::MAX) {
                Work::Output(output) => return Some(output),
                Work::More => {}
                Work::Starved => return None,
            }
        }
    }

    /// The same for a caller with other work to do: a call looks at no more than this many chords
    /// of an arc. All calls together give the same outputs as [`Planner::poll`].
    pub fn work(&mut self, chords: usize) -> Work {
        let mut seen = 0;
        loop {
            if let Some(segment) = self.follower.piece(self.tag() as u16) {
                return Work::Output(Output::Segment(segment));
            }
            if self.next_stretch() {
                continue;
            }
            if seen == chords {
                return Work::More;
            }
            if self.next_chord() {
                seen += 1;
                continue;
            }
            if self.last_line() || self.begin_line() {
                continue;
            }
            if self.then.is_none() {
                return Work::Starved;
            }
            if self.count > 0 || self.pending.is_some() {
                continue;
            }
            if !self.follower.machine.rests() {
                let segment = self.follower.come_to_rest(self.tag() as u16);
                return Work::Output(Output::Segment(segment));
            }
            self.follower.ahead = 0;
            return Work::Output(self.at_rest());
        }
    }

    /// Continues from the integrators' positions: at rest, and with nothing planned. Otherwise it
    /// returns false and has no effect. The first line leads from there to its end, and ends on a
    /// whole step like any other.
    #[must_use]
    pub fn begin_at(&mut self, positions: [i64; AXES]) -> bool {
        let busy = self.count > 0
            || self.pending.is_some()
            || self.chords.is_some()
            || self.running.is_some()
            || self.follower.leg.is_some();
        if busy || !self.follower.machine.rests() {
            return false;
        }
        let nm = |axis: usize| {
            // To the 256th of a step: after a stop the position is a whole step to within a ten
            // thousandth, and a program that goes there has arrived.
            let steps = positions[axis].wrapping_sub(Position::ZERO.0);
            let steps = (i128::from(steps) + (1 << 23)) >> 24;
            let per_km = i128::from(self.machinery.setup.axes[axis].steps_per_km);
            ((steps * 2_000_000_000_000 / per_km + (1 << 8)) >> 9) as i64
        };
        self.at = core::array::from_fn(nm);
        self.end = (self.at, positions);
        self.follower.ahead = 0;
        self.speed = 0;
        for (axis, position) in self.follower.machine.axes.iter_mut().zip(positions) {
            *axis = Axis {
                position,
                velocity: 0,
            };
        }
        true
    }

    /// Sets the feed in percent, for all motion that is not completely planned yet, rapids
    /// included. The path stays the same.
    pub fn set_override(&mut self, percent: u32) {
        self.percent = percent.clamp(1, 200);
        for index in 0..self.count {
            let percent = self.percent;
            self.get_mut(index).set_override(percent);
        }
        self.plan(true);
    }

    /// The integrators and outputs after all outputs of [`Planner::poll`].
    pub fn machine(&self) -> &MotionState {
        &self.follower.machine
    }

    /// The tag of the line being drawn.
    pub fn tag(&self) -> u32 {
        self.running
            .as_ref()
            .map_or(self.tag, |running| running.line.tag)
    }

    /// The end of the reference's last instruction.
    pub fn target(&self) -> Place {
        self.at
    }

    /// The limit of an axis' acceleration in a segment's units; every segment keeps it.
    pub fn limits(&self) -> [u32; AXES] {
        self.machinery.limit
    }

    fn clocks_of(&self, micros: u64) -> u64 {
        let clocks = u128::from(micros) * u128::from(self.machinery.setup.clock_hz) / 1_000_000;
        u64::try_from(clocks).unwrap_or(u64::MAX)
    }

    fn get(&self, index: usize) -> &PlannedLine {
        &self.lines[(self.head + index) % DEPTH]
    }

    fn get_mut(&mut self, index: usize) -> &mut PlannedLine {
        &mut self.lines[(self.head + index) % DEPTH]
    }

    // ---- into the buffer ------------------------------------------------------------------------

    fn line_to(&mut self, to: Place, feed: Feed) {
        if to == self.at {
            return;
        }
        self.at = to;
        let tag = self.tag;
        // A line of less than half a step gets no corner; its end goes into the next line.
        match self.pending {
            Some(pending) if !self.is_short(&pending) => self.append(&pending, false),
            Some(_) | None => {}
        }
        self.pending = Some(Pending { to, feed, tag });
    }

    fn is_short(&self, pending: &Pending) -> bool {
        let away = |axis: usize| self.goal(pending, axis, false) - self.end.1[axis];
        (0..AXES).all(|axis| away(axis).abs() < 1 << 31)
    }

    /// An axis' position at the end of a line. An axis that is not moved keeps its position, to the
    /// last bit.
    fn goal(&self, pending: &Pending, axis: usize, whole: bool) -> i64 {
        let goal = if pending.to[axis] == self.end.0[axis] {
            self.end.1[axis]
        } else {
            self.machinery.position(axis, pending.to[axis])
        };
        if whole {
            goal & !0xffff_ffff | Position::ZERO.0
        } else {
            goal
        }
    }

    /// There must be room for a line.
    fn append(&mut self, pending: &Pending, whole: bool) {
        let machinery = &self.machinery;
        let goal = core::array::from_fn(|axis| self.goal(pending, axis, whole));
        let steps: [i64; AXES] = core::array::from_fn(|axis| goal[axis] - self.end.1[axis]);
        self.end = (pending.to, goal);
        // Lengths are rounded up, each axis' and the total: so a short line is no faster than its
        // axes allow.
        let nm: [i64; AXES] = core::array::from_fn(|axis| {
            let size = nm_of(steps[axis].unsigned_abs(), machinery.pitch[axis]) as i64;
            if steps[axis] < 0 { -size } else { size }
        });
        let length = length(&nm);
        if length == 0 {
            return;
        }
        let by = Inverse::new(length);
        let direction = nm.map(|nm| by.of(nm, ONE.ilog2()));
        let top = smallest(&machinery.speed, &direction).min(u64::from(u32::MAX));
        let [low, high] = product(length, machinery.setup.clock_hz.into());
        let slowest = (low >> LONGEST.ilog2() | high << (64 - LONGEST.ilog2())) + 1;
        let mut line = PlannedLine {
            length,
            direction,
            slope: steps.map(|steps| by.of(steps, 32)),
            end: goal,
            accel: smallest(&machinery.accel, &direction),
            top,
            slowest: slowest.min(top),
            feed: match pending.feed {
                Feed::Rapid => u32::MAX,
                Feed::Rate(rate) => rate,
            },
            held: 0,
            fastest: 0,
            cut: 0,
            corner: 0,
            entry: 0,
            tag: pending.tag,
        };
        line.set_override(self.percent);
        if self.count > 0 {
            (line.cut, line.corner) = self.corner(self.get(self.count - 1), &line);
        }
        self.count += 1;
        *self.get_mut(self.count - 1) = line;
        self.plan(false);
    }

    /// How far before and after the corner its blend reaches, and the square of the largest speed
    /// in it.
    fn corner(&self, before: &PlannedLine, after: &PlannedLine) -> (u64, u64) {
        let change: [i64; AXES] =
            core::array::from_fn(|axis| after.direction[axis] - before.direction[axis]);
        let size = length(&change);
        if size < STRAIGHT {
            return (0, FASTEST);
        }
        // u^2 change / 2d is the blend's acceleration.
        let accel = smallest(&self.machinery.accel, &change);
        let fastest = square(before.at(100).min(after.at(100)));
        let wanted = quotient_up(fastest.div_ceil(2), accel);
        let deviation = product(
            self.machinery.setup.junction_deviation.into(),
            4 * ONE.unsigned_abs(),
        );
        let cut = wanted
            .min(wide(deviation, size))
            .min(most_of(before.length))
            .min(most_of(after.length));
        (cut, gain(accel, cut))
    }

    /// The largest speeds from which everything known can be brought to rest. The initial speed of
    /// the first line is already fixed.
    fn plan(&mut self, all: bool) {
        let Some(last) = self.count.checked_sub(1) else {
            return;
        };
        let known = self.then.is_some() && self.pending.is_none() && self.chords.is_none();
        let mut cut = if known {
            0
        } else {
            most_of(self.get(last).length)
        };
        let mut exit = 0;
        for index in (1..self.count).rev() {
            let line = *self.get(index);
            let before = self.get(index - 1);
            let free = line.length.saturating_sub(line.cut + cut);
            let entry = line
                .gained(exit, free)
                .min(line.corner)
                .min(line.fastest)
                .min(before.fastest);
            let settled = entry == line.entry && index + 2 < self.count;
            if settled && !all {
                return;
            }
            self.get_mut(index).entry = entry;
            (exit, cut) = (entry, line.cut);
        }
    }

    fn next_chord(&mut self) -> bool {
        if self.count == DEPTH {
            return false;
        }
        let Some((chords, feed)) = &mut self.chords else {
            return false;
        };
        let feed = *feed;
        match chords.next() {
            Some(place) => self.line_to(place, feed),
            None => self.chords = None,
        }
        true
    }

    /// Before a stop the waiting line ends on a whole step.
    fn last_line(&mut self) -> bool {
        if self.then.is_none() || self.chords.is_some() || self.count == DEPTH {
            return false;
        }
        let Some(pending) = self.pending.take() else {
            return false;
        };
        self.append(&pending, true);
        self.plan(true);
        true
    }

    // ---- out of the buffer ----------------------------------------------------------------------

    fn begin_line(&mut self) -> bool {
        let flushing = self.then.is_some() && self.chords.is_none() && self.pending.is_none();
        if self.count == 0 || !(flushing || self.count == DEPTH) {
            return false;
        }
        let line = *self.get(0);
        self.head = (self.head + 1) % DEPTH;
        self.count -= 1;
        let next = if self.count > 0 {
            *self.get(0)
        } else {
            PlannedLine::NONE
        };
        let length = line.length - line.cut - next.cut;
        let begin = square(self.speed);
        // An override may need more braking than there is room for.
        let brake = begin.saturating_sub(line.gained(0, length));
        let end = next
            .entry
            .min(line.gained(begin, length))
            .max(brake)
            .isqrt();
        let end = if next.cut > 0 { end.max(1) } else { end };
        let stretches = self.profile(&line, length, end, next.cut);
        self.speed = end;
        if self.count > 0 {
            self.get_mut(0).entry = square(end);
        }
        self.running = Some(Running {
            line,
            next: next.slope,
            stretches,
            index: 0,
        });
        true
    }

    /// Speed up, hold, slow down, and round the corner.
    fn profile(&self, line: &PlannedLine, length: u64, end: u64, cut: u64) -> [Stretch; 4] {
        let machinery = &self.machinery;
        let begin = self.speed;
        let half = square(begin) / 2 + square(end) / 2;
        let peak = half
            .saturating_add(gain(line.accel, length) / 2)
            .min(FASTEST)
            .isqrt();
        let top = peak.min(line.held).max(begin.min(end));
        let time = |from: u64, to: u64| {
            if from == to {
                return 0;
            }
            let clocks = product(from.abs_diff(to) << 16, machinery.setup.clock_hz.into());
            wide(clocks, line.accel).min(FASTEST / 2) as i64
        };
        // Half of the sum of the speeds, per clock.
        let way = |from: u64, to: u64, time: i64| match time {
            0 => 0,
            _ => scaled(
                scaled((from + to) as i64, machinery.per_clock, 16),
                time,
                49,
            ),
        };
        let all = (length << 16) as i64;
        let (first, last) = (time(begin, top), time(top, end));
        let ways = (way(begin, top, first).min(all), way(top, end, last));
        let hold = (all - ways.0 - ways.1).max(0);
        let cut = (cut << 16) as i64;
        let stretch = |from, to, duration, left, blend| Stretch {
            from,
            to,
            duration,
            left,
            blend,
        };
        [
            stretch(begin, top, first, all + cut, false),
            stretch(
                top,
                top,
                machinery.clocks(hold, top),
                all - ways.0 + cut,
                false,
            ),
            stretch(top, end, last, ways.1.min(all) + cut, false),
            stretch(end, end, machinery.clocks(2 * cut, end), cut, true),
        ]
    }

    fn next_stretch(&mut self) -> bool {
        let Some(running) = &mut self.running else {
            return false;
        };
        let Some(stretch) = running.stretches.get(running.index) else {
            self.running = None;
            return false;
        };
        running.index += 1;
        if stretch.duration == 0 {
            return true;
        }
        let line = &running.line;
        let after = if stretch.blend {
            &running.next
        } else {
            &line.slope
        };
        let mut leg = Leg {
            duration: stretch.duration,
            at: -self.follower.ahead,
            position: [0; AXES],
            velocity: [0; AXES],
            accel: [0; AXES],
        };
        let holds = stretch.from == stretch.to && !stretch.blend;
        let by = (!holds).then(|| Inverse::new(stretch.duration.unsigned_abs()));
        for (axis, &after) in after.iter().enumerate() {
            let begin = self.machinery.velocity(stretch.from, line.slope[axis]);
            leg.position[axis] = line.position(axis, stretch.left);
            leg.velocity[axis] = begin;
            if let Some(by) = by {
                let end = self.machinery.velocity(stretch.to, after);
                leg.accel[axis] = by.of(end - begin, 32);
            }
        }
        self.follower.leg = Some(leg);
        true
    }

    fn at_rest(&mut self) -> Output {
        let output = match self.then {
            Some(Then::Aux(bits)) => {
                self.follower.machine.aux = bits;
                let settle = self.clocks_of(self.machinery.setup.aux_settle.into());
                self.then = Some(Then::Dwell(settle.max(MIN_CLOCKS.into())));
                return self.at_rest();
            }
            Some(Then::Dwell(clocks)) => {
                // Half of 2^32 at a time, so that the rest is never too short for a segment.
                let now = clocks.max(MIN_CLOCKS.into());
                let now = if now >> 31 > 1 {
                    1 << 31
                } else {
                    now.min(u32::MAX.into())
                };
                let left = clocks.saturating_sub(now);
                self.then = (left > 0).then_some(Then::Dwell(left));
                let segment = Segment {
                    clocks: now as u32,
                    aux: self.follower.machine.aux,
                    tag: self.tag() as u16,
                    ..Segment::default()
                };
                self.follower.machine.run(&segment);
                return Output::Segment(segment);
            }
            Some(Then::Home(axes)) => {
                for (axis, homed) in axes.iter().enumerate() {
                    if *homed {
                        self.follower.machine.axes[axis] = Axis::default();
                        self.at[axis] = 0;
                        self.end.0[axis] = 0;
                        self.end.1[axis] = Position::ZERO.0;
                    }
                }
                Output::Home(axes)
            }
            Some(Then::Pause) => Output::Pause,
            Some(Then::End) | None => Output::End,
        };
        self.then = None;
        output
    }
}

/// How much of a line its corners may take at each end: two fifths.
fn most_of(length: u64) -> u64 {
    // Lengths are below 2^40.
    (length * 102) >> 8
}

/// The length in nm of this many steps (32 fraction bits), rounded up.
fn nm_of(steps: u64, pitch: u64) -> u64 {
    let [low, high] = product(steps, pitch);
    let down = high << 9 | low >> 55;
    down + u64::from(low << 9 != 0)
}

/// The largest value along a vector (30 fraction bits) that exceeds no axis' limit.
fn smallest(limits: &[u64; AXES], vector: &[i64; AXES]) -> u64 {
    // limit / part, with parts below 2^26: products are enough to find the smallest.
    let part = |part: &i64| (part.unsigned_abs() >> 6) + 1;
    let mut least = (u64::MAX >> 24, 1);
    for (&limit, vector) in limits.iter().zip(vector) {
        let part = part(vector);
        if less(product(limit, least.1), product(least.0, part)) {
            least = (limit, part);
        }
    }
    quotient(least.0 << 24, least.1)
}

fn less(a: [u64; 2], b: [u64; 2]) -> bool {
    (a[1], a[0]) < (b[1], b[0])
}

/// Rounded up.
fn length(vector: &[i64; AXES]) -> u64 {
    let largest = vector.iter().fold(0, |all, part| all | part.unsigned_abs());
    if largest < 1 << 31 {
        let square = vector
            .iter()
            .map(|part| part.unsigned_abs().pow(2))
            .sum::<u64>();
        let root = square.isqrt();
        root + u64::from(root * root < square)
    } else {
        let square = |part: &i64| u128::from(part.unsigned_abs()).pow(2);
        let square = vector.iter().map(square).sum::<u128>();
        let root = square.isqrt();
        (root + u128::from(root * root < square)) as u64
    }
}
