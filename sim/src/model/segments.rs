//! `segments.sv`: plays segments into the first stepgens. Its outputs in a clock depend on whether
//! a pulse waits in that clock, so they are computed in two steps: [`Segments::tells`] before the
//! stepgens' edge, [`Segments::clock`] with it.

use wire::regmap::{self, segments};

/// Room for so many segments.
pub const DEPTH: usize = regmap::JOB_SEGMENTS;
/// The shortest segment.
pub const CLOCKS_MIN: u32 = 64;
/// A pace of 1.
pub const PACE_ONE: u32 = 1 << 16;

/// What it does.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(u32)]
pub enum State {
    /// Nothing.
    #[default]
    Idle = segments::STATUS_STATE_IDLE,
    /// Waits for the stepgens to stand.
    Settle = segments::STATUS_STATE_SETTLE,
    /// Plays.
    Play = segments::STATUS_STATE_PLAY,
    /// Brings the stepgens to rest.
    Halt = segments::STATUS_STATE_HALT,
}

/// Why it ended.
pub mod reason {
    use wire::regmap::segments;

    /// It has not.
    pub const NONE: u8 = segments::STATUS_REASON_NONE as u8;
    /// No segment left, at rest.
    pub const DONE: u8 = segments::STATUS_REASON_DONE as u8;
    /// No segment in time, not at rest.
    pub const UNDERRUN: u8 = segments::STATUS_REASON_UNDERRUN as u8;
    /// Told to.
    pub const QUIT: u8 = segments::STATUS_REASON_QUIT as u8;
    /// The watchdog's soft stop.
    pub const HALTED: u8 = segments::STATUS_REASON_HALTED as u8;
    /// The gate closed.
    pub const CLOSED: u8 = segments::STATUS_REASON_CLOSED as u8;
}

/// What was refused.
pub mod refused {
    /// A push without room.
    pub const FULL: u8 = 1;
    /// One with a word missing.
    pub const INCOMPLETE: u8 = 2;
    /// One too short.
    pub const SHORT: u8 = 4;
    /// One with the gate closed or an end to be cleared.
    pub const NOT_NOW: u8 = 8;
    /// A start.
    pub const START: u8 = 16;
}

/// A command.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Order {
    /// Play.
    Start,
    /// Stop.
    Quit,
    /// Clear the end and its reason.
    Clear,
}

/// Its inputs in a clock.
#[derive(Clone, Copy, Debug, Default)]
pub struct Input {
    /// Outputs are live.
    pub gate: bool,
    /// The watchdog's soft stop.
    pub halt: bool,
    /// A word of a segment, and its place.
    pub word: Option<(usize, u32)>,
    /// The segment is complete.
    pub push: bool,
    /// A command.
    pub order: Option<Order>,
    /// From the next clock on `pace` may be another.
    pub pace_we: bool,
    /// Path clocks per clock, in 1/65536.
    pub pace: u32,
    /// How fast that changes.
    pub slew: u32,
    /// One of its stepgens waits.
    pub waits: bool,
    /// All of them stand.
    pub stopped: bool,
}

/// Its outputs to the stepgens in a clock.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Told {
    /// Path time stands.
    pub still: bool,
    /// Come to rest.
    pub stop: bool,
    /// It owns the stepgens.
    pub busy: bool,
    /// Take the staged command.
    pub commit: bool,
    /// A staged word: 2n the velocity of axis n, 2n + 1 its acceleration.
    pub stage: Option<(usize, u32)>,
}

/// The core.
#[derive(Clone, Debug)]
pub struct Segments {
    words: usize,
    slot: usize,
    memory: Vec<u32>,
    out: u32,
    head: usize,
    tail: usize,
    level: usize,
    seen: u32,
    short: bool,
    at: usize,
    staged: bool,
    fetched: Option<usize>,
    next: u32,
    next_moves: bool,
    left: i64,
    first: bool,
    moves: bool,
    outputs: u16,
    tag: u16,
    scale: u64,
    turned: bool,
    up: bool,
    phase: u32,
    tick: bool,
    state: State,
    reason: u8,
    refused: u8,
    held: bool,
    begun: u32,
}

impl Segments {
    /// For so many axes.
    pub fn new(axes: usize) -> Self {
        let words = 2 + 2 * axes;
        let slot = words.next_power_of_two();
        Segments {
            words,
            slot,
            memory: vec![0; DEPTH * slot],
            out: 0,
            head: 0,
            tail: 0,
            level: 0,
            seen: 0,
            short: false,
            at: words - 1,
            staged: false,
            fetched: None,
            next: 0,
            next_moves: false,
            left: -1,
            first: true,
            moves: false,
            outputs: 0,
            tag: 0,
            scale: u64::from(PACE_ONE) << 16,
            turned: false,
            up: false,
            phase: 0,
            tick: true,
            state: State::Idle,
            reason: reason::NONE,
            refused: 0,
            held: false,
            begun: 0,
        }
    }

    /// Axes.
    pub fn axes(&self) -> usize {
        self.words / 2 - 1
    }

    /// What it does.
    pub fn state(&self) -> State {
        self.state
    }

    /// Why it ended.
    pub fn reason(&self) -> u8 {
        self.reason
    }

    /// Segments that wait.
    pub fn level(&self) -> usize {
        self.level
    }

    /// Segments begun.
    pub fn begun(&self) -> u32 {
        self.begun
    }

    /// Path clocks left, less 1.
    pub fn left(&self) -> u32 {
        self.left as u32
    }

    /// The same, so many quiet clocks later.
    pub fn left_after(&self, clocks: u64) -> u32 {
        (self.left - clocks as i64).max(-1) as u32
    }

    /// Of the segment begun last.
    pub fn tag(&self) -> u16 {
        self.tag
    }

    /// Path clocks per clock, in 1/65536.
    pub fn pace_now(&self) -> u32 {
        (self.scale >> 16) as u32
    }

    /// Outputs.
    pub fn aux(&self, beam: u16) -> u16 {
        let off = self.state != State::Play || self.pace_now() == 0;
        self.outputs & !if off { beam } else { 0 }
    }

    /// The status register.
    pub fn status(&self) -> u32 {
        let flag = |up: bool, bit: u32| if up { bit } else { 0 };
        self.level as u32
            | (self.state as u32) << segments::STATUS_STATE_SHIFT
            | u32::from(self.reason) << segments::STATUS_REASON_SHIFT
            | u32::from(self.refused) << segments::STATUS_REFUSED_SHIFT
            | flag(self.pace_now() == 0, segments::STATUS_STANDS)
            | flag(self.held, segments::STATUS_HELD)
    }

    fn dead(&self, gate: bool) -> bool {
        self.reason > reason::DONE || !gate
    }

    fn breaks(i: &Input) -> bool {
        !i.gate || i.halt || i.order == Some(Order::Quit)
    }

    /// What its stepgens are told in this clock.
    pub fn tells(&self, i: &Input) -> Told {
        let timed = matches!(self.state, State::Play | State::Halt);
        let advance = !timed || (self.tick && !i.waits);
        Told {
            still: !advance,
            stop: matches!(self.state, State::Settle | State::Halt),
            busy: self.state != State::Idle,
            commit: self.state == State::Play
                && self.staged
                && self.left < 0
                && advance
                && !Self::breaks(i),
            stage: self
                .fetched
                .filter(|at| *at > 1)
                .map(|at| (at - 2, self.out)),
        }
    }

    /// One rising edge.
    pub fn clock(&mut self, i: &Input) {
        let told = self.tells(i);
        let (advance, commit) = (!told.still, told.commit);
        let (state, dead) = (self.state, self.dead(i.gate));
        let play = state == State::Play;
        let full = self.level == DEPTH;
        let clear = i.order == Some(Order::Clear);
        let over = self.left < 0 && advance;
        let starts = i.order == Some(Order::Start)
            && state == State::Idle
            && !dead
            && !i.halt
            && self.level != 0;

        // Segment by segment.
        if state == State::Settle {
            self.held = false;
        } else if play && self.tick && i.waits {
            self.held = true;
        }
        let why = match () {
            () if !Self::breaks(i) => reason::NONE,
            () if !i.gate => reason::CLOSED,
            () if i.halt => reason::HALTED,
            () => reason::QUIT,
        };
        let failed = self.reason > reason::DONE;
        (self.state, self.reason) = match state {
            State::Idle if starts => (State::Settle, reason::NONE),
            State::Idle if clear => (State::Idle, reason::NONE),
            State::Idle => (State::Idle, self.reason),
            State::Settle | State::Play if why != reason::NONE => (State::Halt, why),
            State::Settle if i.stopped => (State::Play, self.reason),
            State::Settle => (State::Settle, self.reason),
            State::Play if over && !self.staged && !self.first => {
                let end = if self.moves {
                    reason::UNDERRUN
                } else {
                    reason::DONE
                };
                (State::Halt, end)
            }
            State::Play => (State::Play, self.reason),
            State::Halt => {
                let ends = i.stopped || !i.gate;
                let reason = if !i.gate && !failed {
                    reason::CLOSED
                } else {
                    self.reason
                };
                (if ends { State::Idle } else { State::Halt }, reason)
            }
        };
        if state == State::Settle {
            (self.left, self.first) = (-1, true);
        } else if commit {
            (self.left, self.first) = (i64::from(self.out) - 2, false);
        } else if self.left >= 0 && advance {
            self.left -= 1;
        }
        if commit {
            self.begun = self.begun.wrapping_add(1);
            self.moves = self.next_moves;
            (self.tag, self.outputs) = ((self.next >> 16) as u16, self.next as u16);
        } else if state == State::Idle && dead {
            self.outputs = 0;
        }

        // The next one.
        let fetch = play && !self.staged && self.level != 0;
        if self.fetched == Some(1) {
            self.next = self.out;
        }
        let moves = matches!(told.stage, Some((at, word)) if at & 1 == 0 && word != 0);
        self.next_moves = play && !commit && (self.next_moves || moves);
        self.staged = play && !commit && (self.staged || (fetch && self.at == 0));
        let at = self.at;
        self.fetched = fetch.then_some(at);
        self.at = if !play || commit {
            self.words - 1
        } else if fetch && at != 0 {
            at - 1
        } else {
            at
        };

        // The FIFO.
        self.out = self.memory[self.tail * self.slot + at];
        let whole = self.seen == (1 << self.words) - 1;
        let taken = i.push && !full && !dead && whole && !self.short;
        if i.push {
            self.refused |= match () {
                () if full => refused::FULL,
                () if dead => refused::NOT_NOW,
                () if !whole => refused::INCOMPLETE,
                () if self.short => refused::SHORT,
                () => 0,
            };
        }
        if i.order == Some(Order::Start) && !starts {
            self.refused |= refused::START;
        }
        if clear {
            self.refused = 0;
        }
        let write = i.word.filter(|(at, _)| *at < self.words && !full);
        if let Some((at, word)) = write {
            self.memory[self.head * self.slot + at] = word;
            if at == 0 {
                self.short = word < CLOCKS_MIN;
            }
        }
        if i.push || dead {
            self.seen = 0;
        } else if let Some((at, _)) = write {
            self.seen |= 1 << at;
        }
        let flush = dead || (clear && state == State::Idle);
        (self.tail, self.level) = if flush {
            (self.head, 0)
        } else {
            (
                (self.tail + usize::from(commit)) % DEPTH,
                self.level + usize::from(taken) - usize::from(commit),
            )
        };
        self.head = (self.head + usize::from(taken)) % DEPTH;

        // Time.
        let pace_now = self.pace_now();
        let wanted = u64::from(i.pace.min(PACE_ONE)) << 16;
        let down = !self.up && !self.turned;
        let slew = i64::from(i.slew);
        let moved = self.scale as i64 + if down { -slew } else { slew };
        let below = moved < wanted as i64;
        let there = i.slew == 0 || self.up != below;
        if !matches!(state, State::Play | State::Halt) {
            self.scale = wanted;
        } else if play && !self.turned {
            self.scale = if there { wanted } else { moved as u64 };
        }
        if self.turned {
            self.up = below;
        }
        self.turned = i.pace_we;
        let sum = self.phase + pace_now;
        self.tick = sum >> 16 != 0;
        self.phase = sum & 0xffff;
    }

    /// What its stepgens are told in the quiet clocks of a segment.
    pub fn steady(&self) -> Told {
        Told {
            busy: self.state != State::Idle,
            ..Told::default()
        }
    }

    /// Clocks in which it does nothing by itself but count: its phase, and a segment's clocks at
    /// full pace. This holds as long as none of its stepgens waits and there is no bus write.
    pub fn quiet(&self, gate: bool, pace: u32) -> u64 {
        let dead = self.dead(gate);
        if self.state == State::Play {
            let steady = !self.turned
                && !dead
                && self.fetched.is_none()
                && (self.staged || self.level == 0)
                && self.tick
                && pace >= PACE_ONE
                && self.scale == u64::from(PACE_ONE) << 16;
            // The last clock, and the commit behind it, are made one by one.
            return if steady { self.left.max(0) as u64 } else { 0 };
        }
        let settled = self.state == State::Idle
            && !self.turned
            && self.fetched.is_none()
            && !self.staged
            && !self.next_moves
            && self.at == self.words - 1
            && self.scale == u64::from(pace.min(PACE_ONE)) << 16
            && !(dead && (self.outputs != 0 || self.level != 0 || self.seen != 0));
        if settled { u64::MAX } else { 0 }
    }

    /// That many quiet clocks at once.
    pub fn skip(&mut self, clocks: u64) {
        if clocks == 0 {
            return;
        }
        let before = u64::from(self.phase) + (clocks - 1) * u64::from(self.pace_now());
        let sum = (before & 0xffff) as u32 + self.pace_now();
        self.tick = sum >> 16 != 0;
        self.phase = sum & 0xffff;
        // It counts to its end even after the job has ended.
        self.left = (self.left - clocks as i64).max(-1);
        self.out = self.memory[self.tail * self.slot + self.at];
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::board::{Build, pages};
    use crate::model::{Board, board::Bus};
    use motion::instruction::{Feed, Instruction};
    use motion::plan::{AxisSetup, Output, Planner, Setup};
    use motion::segment::{AXES, Segment};
    use proptest::prelude::*;
    use std::collections::VecDeque;
    use wire::describe::Channels;

    fn board(times: [u32; 4]) -> Board {
        let mut board = Board::new(Build {
            channels: Channels {
                stepgens: 3,
                encoders: 0,
                pwms: 0,
                inputs: 0,
                outputs: 16,
            },
            clock_hz: 10_000_000,
            estop_mask: 0,
            estop_level: 0,
            abi: 0,
            version: 0,
            rom_words: 0,
            jobs: AXES as u8,
            readback: true,
        });
        for n in 0..3 {
            for (word, time) in (0..).zip(times) {
                write(&mut board, pages::STEPGEN + n, word, time);
            }
        }
        write(
            &mut board,
            pages::WATCHDOG,
            regmap::watchdog::TIMEOUT,
            u32::MAX,
        );
        write(
            &mut board,
            pages::WATCHDOG,
            regmap::watchdog::CONTROL,
            regmap::watchdog::CONTROL_KEY_CLEAR,
        );
        write(
            &mut board,
            pages::WATCHDOG,
            regmap::watchdog::CONTROL,
            regmap::watchdog::CONTROL_KEY_ARM,
        );
        write(
            &mut board,
            pages::TIMEBASE,
            regmap::timebase::STROBE,
            regmap::timebase::STROBE_COMMIT,
        );
        board
    }

    /// As the bus does it: an access every second clock.
    fn write(board: &mut Board, page: u32, word: usize, data: u32) {
        board.order(page, word as u32, data);
        board.clock(&Bus::default());
        board.clock(&Bus::default());
    }

    fn push(board: &mut Board, segment: &Segment) {
        for (at, word) in (0..).zip(segment.words()) {
            write(board, pages::SEGMENTS, at, word);
        }
        write(board, pages::SEGMENTS, segments::PUSH, 0);
    }

    fn status(board: &Board) -> u32 {
        board.peek(pages::SEGMENTS, segments::STATUS as u32)
    }

    fn position(board: &mut Board, axis: u32) -> i64 {
        write(
            board,
            pages::TIMEBASE,
            regmap::timebase::STROBE,
            regmap::timebase::STROBE_SAMPLE,
        );
        for _ in 0..20 {
            board.clock(&Bus::default());
        }
        let at = 8 + 3 * axis;
        let low = u64::from(board.peek(pages::STATUS, at));
        (u64::from(board.peek(pages::STATUS, at + 1)) << 32 | low) as i64
    }

    fn setup() -> Setup {
        let axis = |steps_per_mm: u64, mm_per_s: u32, mm_per_s2: u64| AxisSetup {
            steps_per_km: steps_per_mm * 1_000_000,
            max_speed: mm_per_s * 1_000_000,
            max_accel: mm_per_s2 * 1_000_000,
        };
        Setup {
            clock_hz: 10_000_000,
            axes: [
                axis(80, 200, 8000),
                axis(100, 150, 6000),
                axis(400, 40, 2000),
            ],
            chord_tolerance: 5000,
            junction_deviation: 20_000,
            aux_settle: 0,
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(4) })]

        /// A plan, pushed as words and played by the cores' models, ends at rest with every axis on
        /// the exact step and the exact fraction of it. This holds for any step timing (which may
        /// hold path time) and any number of pauses.
        #[test]
        fn a_planned_job_ends_exactly_where_the_planner_says(
            places in proptest::collection::vec((-1_000_000..1_000_000i64, -1_000_000..1_000_000i64, -200_000..200_000i64), 1..6),
            times in (1..20u32, 1..20u32, 1..60u32, 1..60u32),
            paces in proptest::collection::vec(prop_oneof![Just(0u32), Just(PACE_ONE), 20_000..PACE_ONE], 1..20),
        ) {
            let mut planner = Planner::<16>::new(&setup()).unwrap();
            let lines = places.iter().enumerate().flat_map(|(n, &(x, y, z))| {
                let line = Instruction::Line { to: [x, y, z], feed: Feed::Rate(100_000_000) };
                let tool = (n % 3 == 2).then_some(Instruction::Aux { bits: n as u16 });
                [Some(line), tool].into_iter().flatten()
            });
            let mut program = lines.chain([Instruction::End]).peekable();
            let mut segments = VecDeque::new();
            loop {
                while planner.accepts() && program.peek().is_some() {
                    prop_assert!(planner.push(&program.next().unwrap(), 0));
                }
                match planner.poll() {
                    Some(Output::Segment(segment)) => segments.push_back(segment),
                    Some(Output::End) => break,
                    _ => {}
                }
            }
            let all = segments.len() as u32;
            let mut board = board([times.0, times.1, times.2, times.3]);
            write(&mut board, pages::SEGMENTS, segments::SLEW, 1 << 20);
            let (mut started, mut paces, mut clocks) = (false, paces.iter().cycle(), 0u64);
            loop {
                let now = status(&board);
                if started && now >> 8 & 3 == 0 {
                    prop_assert_eq!((now >> 12 & 7) as u8, reason::DONE);
                    break;
                }
                if now & 0xff < 60 && let Some(segment) = segments.pop_front() {
                    push(&mut board, &segment);
                } else if !started {
                    write(&mut board, pages::SEGMENTS, segments::CONTROL, segments::CONTROL_COMMAND_START);
                    started = true;
                } else {
                    for _ in 0..100 {
                        board.clock(&Bus::default());
                    }
                    clocks += 100;
                    if clocks.is_multiple_of(20_000) {
                        let pace = *paces.next().unwrap();
                        // A pause ends some time.
                        let pace = if clocks.is_multiple_of(40_000) { PACE_ONE } else { pace };
                        write(&mut board, pages::SEGMENTS, segments::PACE, pace);
                    }
                }
            }
            prop_assert_eq!(board.peek(pages::SEGMENTS, segments::BEGUN as u32), all);
            for axis in 0..AXES {
                prop_assert_eq!(position(&mut board, axis as u32), planner.machine().axes[axis].position, "axis {}", axis);
            }
            prop_assert!(planner.machine().rests());
        }
    }

    #[test]
    fn an_underrun_brakes_and_says_so_and_nothing_starts_before_clear() {
        let mut board = board([1, 1, 1, 1]);
        for n in 0..3 {
            write(
                &mut board,
                pages::STEPGEN + n,
                regmap::stepgen::STOP_ACCEL,
                1 << 28,
            );
        }
        let segment = Segment {
            clocks: 2000,
            velocity: [1 << 16, -(1 << 15), 0],
            accel: [1 << 30; 3],
            ..Segment::default()
        };
        push(&mut board, &segment);
        push(&mut board, &segment);
        write(
            &mut board,
            pages::SEGMENTS,
            segments::CONTROL,
            segments::CONTROL_COMMAND_START,
        );
        let mut clocks = 0;
        while status(&board) >> 8 & 3 != 0 {
            board.clock(&Bus::default());
            clocks += 1;
        }
        assert!((4000..10_000).contains(&clocks), "{clocks} clocks");
        assert_eq!((status(&board) >> 12 & 7) as u8, reason::UNDERRUN);
        let rest = position(&mut board, 0);
        push(&mut board, &segment);
        write(
            &mut board,
            pages::SEGMENTS,
            segments::CONTROL,
            segments::CONTROL_COMMAND_START,
        );
        let refused = (status(&board) >> 16 & 31) as u8;
        assert_eq!(refused, refused::NOT_NOW | refused::START);
        for _ in 0..5000 {
            board.clock(&Bus::default());
        }
        assert_eq!(position(&mut board, 0), rest);
        write(
            &mut board,
            pages::SEGMENTS,
            segments::CONTROL,
            segments::CONTROL_COMMAND_CLEAR,
        );
        push(&mut board, &segment);
        write(
            &mut board,
            pages::SEGMENTS,
            segments::CONTROL,
            segments::CONTROL_COMMAND_START,
        );
        assert_eq!(status(&board) >> 8 & 3, State::Settle as u32);
    }

    proptest! {
        #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(48) })]

        /// [`Board::run`], which skips quiet clocks, and clock by clock: the same pins and
        /// registers at every look.
        #[test]
        fn many_clocks_of_a_segment_at_once_are_those_clocks_one_by_one(
            rates in proptest::collection::vec((64..5000u32, -(1i32 << 28)..1 << 28, -(1i32 << 26)..1 << 26, 0..4u16), 1..12),
            times in (1..20u32, 1..20u32, 1..60u32, 1..60u32),
            looks in proptest::collection::vec((1..900u64, 0..40u8), 20..200),
        ) {
            let (mut slow, mut fast) = (board([times.0, times.1, times.2, times.3]), board([times.0, times.1, times.2, times.3]));
            for board in [&mut slow, &mut fast] {
                write(board, pages::SEGMENTS, segments::SLEW, 1 << 20);
                write(board, pages::SEGMENTS, segments::MASK, 3);
                for (clocks, x, y, aux) in &rates {
                    let segment = Segment { clocks: *clocks, velocity: [*x, *y, 0], accel: [1 << 24, 0, 1], aux: *aux, tag: 7 };
                    push(board, &segment);
                }
                write(board, pages::SEGMENTS, segments::CONTROL, segments::CONTROL_COMMAND_START);
            }
            for (clocks, deed) in looks {
                let until = slow.clocks() + clocks;
                while slow.clocks() < until {
                    slow.clock(&Bus::default());
                }
                while fast.clocks() < until {
                    fast.run(until);
                }
                prop_assert_eq!(slow.pins(), fast.pins(), "clock {}", until);
                for word in 22..27 {
                    prop_assert_eq!(slow.peek(pages::SEGMENTS, word), fast.peek(pages::SEGMENTS, word), "word {} in clock {}", word, until);
                }
                // Now and then a pause, a stop, another segment.
                let (word, data) = match deed {
                    0 | 1 => (18, 0),
                    2..6 => (18, PACE_ONE),
                    6 => (18, PACE_ONE / 3),
                    7 => (17, 2),
                    8 => (17, 3),
                    9..14 => (16, 0),
                    _ => continue,
                };
                for board in [&mut slow, &mut fast] {
                    if word == 16 {
                        push(board, &Segment { clocks: 700, velocity: [1 << 25, 0, 0], accel: [1 << 22, 0, 1], aux: 1, tag: 8 });
                    } else {
                        write(board, pages::SEGMENTS, word, data);
                    }
                }
            }
        }
    }
}
