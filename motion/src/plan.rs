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

use crate::circle::Chords;
use crate::instruction::{CENTER_FARTHEST, DWELL_LONGEST, FARTHEST, Feed, Instruction, Place};
use crate::segment::{AXES, Axis, COMMIT_CLOCKS, MAX_CLOCKS, MIN_CLOCKS, Machine, Segment};
use crate::wide::{Inverse, product, quotient, quotient_up, ratio, scaled, wide};
use core::fmt;
use wire::units::Position;

/// One axis of the machine.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct AxisSetup {
    /// Steps in a kilometre: a million times the steps in a millimetre.
    pub steps_per_km: u64,
    /// nm/s.
    pub max_speed: u32,
    /// nm/s^2.
    pub max_accel: u64,
}

/// The machine.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Setup {
    /// The board's clock.
    pub clock_hz: u32,
    /// X, Y, Z.
    pub axes: [AxisSetup; AXES],
    /// Largest distance of a chord from its arc, in nm.
    pub chord_tolerance: u32,
    /// Largest distance of a blend from its corner, in nm. 0 stops at every corner.
    pub junction_deviation: u32,
    /// How long all axes rest after the outputs have changed, in microseconds: a pen needs time to
    /// move.
    pub aux_settle: u32,
}

/// What is wrong with a setup; the number is that of the axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SetupError {
    /// Not between 1 MHz and 1 GHz.
    Clock,
    /// No steps, or more than 100 000 in a millimetre.
    Scale(usize),
    /// Less than three units of rate, or more than a step in four clocks.
    Speed(usize),
    /// More than 100 g or than a segment can represent, or too small for one.
    Accel(usize),
    /// A chord tolerance below 1 um.
    Tolerance,
}

impl fmt::Display for SetupError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let name = |axis: usize| ['X', 'Y', 'Z'].get(axis).copied().unwrap_or('?');
        match *self {
            SetupError::Clock => write!(f, "the clock is between 1 MHz and 1 GHz"),
            SetupError::Scale(axis) => {
                write!(
                    f,
                    "{}: steps per mm are above 0 and at most 100 000",
                    name(axis)
                )
            }
            SetupError::Speed(axis) => {
                write!(
                    f,
                    "{}: the speed is above 3 clock / 2^32 steps/s and at most one step in four clocks",
                    name(axis)
                )
            }
            SetupError::Accel(axis) => write!(
                f,
                "{}: the acceleration in steps/s^2 is between clock^2 / 2^44 and clock^2 / 2^25, and at most 100 g",
                name(axis)
            ),
            SetupError::Tolerance => write!(f, "the chord tolerance is at least 1 um"),
        }
    }
}

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

/// The longest time of a line in clocks, without its ramps: a week at 60 MHz. A lower feed is
/// raised, whatever the override, because time with its 16 fraction bits has 64 bits. That is 300
/// nm/s for a metre.
const LONGEST: u64 = 1 << 45;

/// Directions have 30 fraction bits.
const ONE: i64 = 1 << 30;

/// Two directions this close to each other (8e-9 of a turn's radius) count as one.
const STRAIGHT: u64 = 1 << 3;

/// A setup in the units of the integrators.
#[derive(Clone, Copy, Debug)]
struct Machinery {
    setup: Setup,
    /// 2^64 / clock.
    per_clock: i64,
    /// Steps per nm, 2^64 times.
    scale: [i64; AXES],
    /// nm per step, 2^23 times, rounded up.
    pitch: [u64; AXES],
    /// nm/s. A 4096th and two units of rate below the limit, as room for corrections.
    speed: [u64; AXES],
    /// nm/s^2. A 64th below the limit, for the same reason.
    accel: [u64; AXES],
    /// Units of a segment's acceleration: the limit itself.
    limit: [u32; AXES],
}

impl Machinery {
    fn new(setup: &Setup) -> Result<Self, SetupError> {
        if !(1_000_000..=1_000_000_000).contains(&setup.clock_hz) {
            return Err(SetupError::Clock);
        }
        if setup.chord_tolerance < 1000 {
            return Err(SetupError::Tolerance);
        }
        let clock = i128::from(setup.clock_hz);
        let mut machinery = Machinery {
            setup: *setup,
            per_clock: ((1 << 64) / clock) as i64,
            scale: [0; AXES],
            pitch: [0; AXES],
            speed: [0; AXES],
            accel: [0; AXES],
            limit: [0; AXES],
        };
        for (index, axis) in setup.axes.iter().enumerate() {
            if !(1..=100_000_000_000).contains(&axis.steps_per_km) {
                return Err(SetupError::Scale(index));
            }
            let scale = (i128::from(axis.steps_per_km) << 64) / 1_000_000_000_000;
            // Steps per clock, 2^64 times; a quarter at most.
            let rate = i128::from(axis.max_speed) * scale / clock;
            if axis.max_speed == 0 || rate > 1 << 62 {
                return Err(SetupError::Speed(index));
            }
            // f^2 / 2^56 steps/s^2 is the unit.
            let limit = (i128::from(axis.max_accel) * scale / (clock * clock)) >> 8;
            if axis.max_accel > 1_000_000_000_000 || !(1 << 12..1 << 31).contains(&limit) {
                return Err(SetupError::Accel(index));
            }
            machinery.scale[index] = scale as i64;
            machinery.pitch[index] = (1_000_000_000_000u64 << 23).div_ceil(axis.steps_per_km);
            // A unit of rate is 2^-32 steps per clock.
            let unit = u64::try_from((clock << 32) / scale).unwrap_or(u64::MAX);
            let speed =
                u64::from(axis.max_speed - axis.max_speed / 4096).saturating_sub(2 * (unit + 1));
            if speed == 0 {
                return Err(SetupError::Speed(index));
            }
            machinery.speed[index] = speed;
            machinery.accel[index] = axis.max_accel - axis.max_accel / 64;
            machinery.limit[index] = limit as u32;
        }
        Ok(machinery)
    }

    /// An integrator's position for a position of the job.
    fn position(&self, axis: usize, nm: i64) -> i64 {
        scaled(nm, self.scale[axis], 32) + Position::ZERO.0
    }

    /// Clocks (with 16 fraction bits) for `distance` nm (with 16 fraction bits) at `speed` nm/s.
    fn clocks(&self, distance: i64, speed: u64) -> i64 {
        let all = product(distance.unsigned_abs(), self.setup.clock_hz.into());
        wide(all, speed.max(1)).min(FASTEST / 2) as i64
    }

    /// An integrator's velocity for a speed along a path with so many steps per nm (2^64 times).
    fn velocity(&self, speed: u64, slope: i64) -> i64 {
        scaled(scaled(speed as i64, slope, 32), self.per_clock, 40)
    }
}

/// A line in the buffer.
#[derive(Clone, Copy, Debug)]
struct Line {
    /// nm.
    length: u64,
    /// Unit vector.
    direction: [i64; AXES],
    /// Steps per nm, 2^64 times.
    slope: [i64; AXES],
    /// The integrators' positions at its end, without the corner's blend.
    end: [i64; AXES],
    /// Acceleration along it, nm/s^2.
    accel: u64,
    /// The axes' limit, nm/s.
    top: u64,
    /// The speed that takes [`LONGEST`] for it, nm/s; at most `top`.
    slowest: u64,
    /// The commanded speed, nm/s, at 100 %.
    feed: u32,
    /// The speed it will be drawn with, nm/s, and its square.
    held: u64,
    fastest: u64,
    /// How far the blend at its beginning reaches into it, nm.
    cut: u64,
    /// Square of the largest speed through that blend.
    corner: u64,
    /// Square of the planned speed there.
    entry: u64,
    /// The tag of the instruction it comes from.
    tag: u32,
}

impl Line {
    const NONE: Line = Line {
        length: 0,
        direction: [0; AXES],
        slope: [0; AXES],
        end: [0; AXES],
        accel: 0,
        top: 0,
        slowest: 0,
        feed: 0,
        held: 0,
        fastest: 0,
        cut: 0,
        corner: 0,
        entry: 0,
        tag: 0,
    };

    /// The integrators' positions when `left` nm (with 16 fraction bits) are left to the corner.
    fn position(&self, axis: usize, left: i64) -> i64 {
        self.end[axis] - scaled(self.slope[axis], left, 48)
    }

    /// The speed it will be drawn with, nm/s.
    fn at(&self, percent: u32) -> u64 {
        let feed = match percent {
            100 => self.feed.into(),
            _ => quotient(u64::from(self.feed) * u64::from(percent), 100),
        };
        feed.clamp(self.slowest, self.top)
    }

    /// Asks for another speed.
    fn set_override(&mut self, percent: u32) {
        self.held = self.at(percent);
        self.fastest = square(self.held);
    }

    /// `w + 2 a l`: the square of the speed after `length` nm of acceleration.
    fn gained(&self, square: u64, length: u64) -> u64 {
        square.saturating_add(gain(self.accel, length)).min(FASTEST)
    }
}

/// `2 a l`.
fn gain(accel: u64, length: u64) -> u64 {
    match product(accel, length) {
        [half, 0] => half.saturating_mul(2).min(FASTEST),
        _ => FASTEST,
    }
}

fn square(speed: u64) -> u64 {
    speed.saturating_mul(speed).min(FASTEST)
}

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

/// A part of the reference with constant acceleration.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Leg {
    /// Clocks, 16 fraction bits.
    pub(crate) duration: i64,
    /// Time of the last segment's end, in clocks with 16 fraction bits since the leg began; up to
    /// 64 clocks before it.
    pub(crate) at: i64,
    pub(crate) position: [i64; AXES],
    pub(crate) velocity: [i64; AXES],
    /// 2^-72 steps per clock^2.
    pub(crate) accel: [i64; AXES],
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
    line: Line,
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
    lines: [Line; DEPTH],
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
            lines: [Line::NONE; DEPTH],
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
    pub fn machine(&self) -> &Machine {
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

    fn get(&self, index: usize) -> &Line {
        &self.lines[(self.head + index) % DEPTH]
    }

    fn get_mut(&mut self, index: usize) -> &mut Line {
        &mut self.lines[(self.head + index) % DEPTH]
    }

    // ---- into the buffer ---------------------------------------------------------------------------------------

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
        let mut line = Line {
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
    fn corner(&self, before: &Line, after: &Line) -> (u64, u64) {
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

    // ---- out of the buffer -------------------------------------------------------------------------------------

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
            Line::NONE
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
    fn profile(&self, line: &Line, length: u64, end: u64, cut: u64) -> [Stretch; 4] {
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

/// Makes segments that follow a reference, from the integrators' positions.
#[derive(Clone, Debug)]
pub(crate) struct Follower {
    /// The integrators, and the outputs.
    pub(crate) machine: Machine,
    /// The reference's position and velocity.
    pub(crate) leg: Option<Leg>,
    /// How many clocks (16 fraction bits) the reference is ahead of the segments; below 65.
    pub(crate) ahead: i64,
    limit: [u32; AXES],
}

impl Follower {
    pub(crate) fn new(limit: [u32; AXES]) -> Self {
        Follower {
            machine: Machine::default(),
            leg: None,
            ahead: 0,
            limit,
        }
    }

    /// The next segment of the leg.
    pub(crate) fn piece(&mut self, tag: u16) -> Option<Segment> {
        let leg = self.leg.as_mut()?;
        let clocks = (leg.duration - leg.at) >> 16;
        if clocks < i64::from(MIN_CLOCKS) {
            self.ahead = leg.duration - leg.at;
            self.leg = None;
            return None;
        }
        // Legs too short for a segment of their own are followed at once, not over the whole of
        // this segment.
        let late = leg.at <= -(1 << 16) && clocks >= 2 * i64::from(MIN_CLOCKS);
        let pieces = (clocks as u64).div_ceil(MAX_CLOCKS.into());
        let clocks = if late {
            MIN_CLOCKS
        } else {
            (clocks as u64).div_ceil(pieces) as u32
        };
        leg.at += i64::from(clocks) << 16;
        let leg = *leg;
        let aims: [(i32, u32); AXES] = core::array::from_fn(|axis| {
            let (position, velocity) = leg.reference(axis);
            let limit = self.limit[axis];
            self.machine.axes[axis].aim(clocks, position, velocity, limit)
        });
        let segment = Segment {
            clocks,
            velocity: aims.map(|aim| aim.0),
            accel: aims.map(|aim| aim.1),
            aux: self.machine.aux,
            tag,
        };
        self.machine.run(&segment);
        Some(segment)
    }

    /// The segment that ends at rest: as short as the limits allow.
    pub(crate) fn come_to_rest(&mut self, tag: u16) -> Segment {
        let mut clocks = MIN_CLOCKS;
        for (axis, limit) in self.machine.axes.iter().zip(self.limit) {
            let moves = quotient_up(axis.velocity.unsigned_abs(), limit.into());
            clocks = clocks.max(moves as u32 + COMMIT_CLOCKS);
        }
        let accel = self.machine.axes.map(|axis| {
            let moves = u64::from(clocks - COMMIT_CLOCKS);
            quotient_up(axis.velocity.unsigned_abs(), moves).max(1) as u32
        });
        let segment = Segment {
            clocks,
            velocity: [0; AXES],
            accel,
            aux: self.machine.aux,
            tag,
        };
        self.machine.run(&segment);
        segment
    }
}

impl Leg {
    /// A uniform change to these velocities.
    pub(crate) fn steer(&mut self, end: &[i64; AXES]) {
        for (axis, end) in end.iter().enumerate() {
            let by = self.duration.max(1).unsigned_abs();
            self.accel[axis] = ratio(end - self.velocity[axis], 32, by);
        }
    }

    /// The reference's position and speed.
    fn reference(&self, axis: usize) -> (i64, i64) {
        let begin = self.velocity[axis];
        let velocity = begin + scaled(self.accel[axis], self.at, 32);
        let way = scaled(begin + velocity, self.at, 41);
        (self.position[axis] + way, velocity)
    }
}

impl Axis {
    /// The velocity, and the acceleration to it, that leads to the reference's velocity in this
    /// many clocks, and to its position in the 2^21 clocks after that. This is slow enough to be
    /// stable for segments of any length up to 2^20.
    fn aim(&self, clocks: u32, position: i64, velocity: i64, limit: u32) -> (i32, u32) {
        let moves = i64::from(clocks - COMMIT_CLOCKS);
        let sum = self.velocity + velocity;
        // The last of the moves comes too late to count: v0 v0 v1 .. vm.
        let late = self.velocity - velocity;
        let mean = scaled(sum, clocks.into(), 25) + (late >> 25);
        let off = self.position.wrapping_add(mean).wrapping_sub(position);
        // At most half a step in 2^21 clocks, 14 steps/s at 60 MHz: the error is never larger.
        let correction = off.clamp(-(1 << 31), 1 << 31) << 3;
        let most = i64::from(limit) * moves;
        let wanted = velocity - correction;
        // Velocities are whole numbers at the end of a segment, and so at the beginning of the
        // next.
        let nearest = (wanted + (1 << 23)) >> 24;
        let [least, greatest] = [self.velocity - most, self.velocity + most];
        let rate = nearest.clamp(-(-least >> 24), greatest >> 24);
        let change = (rate << 24).abs_diff(self.velocity);
        let accel = quotient_up(change, moves as u64).max(1);
        (rate as i32, accel as u32)
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_segment_that_leads_to_the_reference_by_itself_is_not_corrected() {
        // 100 000 steps/s at 60 MHz, in 2^16 moves.
        let fast = 7_158_000i32;
        for (from, to) in [(0, fast), (fast, 0), (fast, -fast), (-fast, fast)] {
            let change = i64::from(to - from).unsigned_abs() << 24;
            let mut segment = Segment {
                clocks: (1 << 16) + COMMIT_CLOCKS,
                ..Segment::default()
            };
            (segment.velocity[0], segment.accel[0]) = (to, (change >> 16) as u32);
            let begin = Axis {
                velocity: i64::from(from) << 24,
                ..Axis::default()
            };
            let end = segment.play(0).after(begin, segment.clocks);
            let aim = begin.aim(segment.clocks, end.position, end.velocity, u32::MAX);
            assert_eq!(aim, (to, segment.accel[0]), "{from} to {to}");
        }
    }
}
