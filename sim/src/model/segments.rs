//! `segments.sv`: plays segments into the first stepgens. Its outputs in a clock depend on whether
//! a pulse waits in that clock, so they are computed in two steps: [`Segments::tells`] before the
//! stepgens' edge, [`Segments::clock`] with it.

use motion::segment::PACE_ONE;
use wire::regmap::{self, segments};

/// Room for so many segments.
pub const DEPTH: usize = regmap::JOB_SEGMENTS;
/// The shortest segment.
pub const CLOCKS_MIN: u32 = 64;

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

/// What the parts of an edge need as it stands before it.
struct Before {
    advance: bool,
    commit: bool,
    state: State,
    dead: bool,
    full: bool,
    clear: bool,
    starts: bool,
    /// The word that is fetched.
    at: usize,
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
        let dead = self.dead(i.gate);
        let before = Before {
            advance: !told.still,
            commit: told.commit,
            state: self.state,
            dead,
            full: self.level == DEPTH,
            clear: i.order == Some(Order::Clear),
            starts: i.order == Some(Order::Start)
                && self.state == State::Idle
                && !dead
                && !i.halt
                && self.level != 0,
            at: self.at,
        };
        self.clock_state(i, &before);
        self.clock_segment(&before);
        self.clock_fetch(&told, &before);
        self.clock_fifo(i, &before);
        self.clock_pace(i, &before);
    }

    /// What it does, and why it ended.
    fn clock_state(&mut self, i: &Input, b: &Before) {
        if b.state == State::Settle {
            self.held = false;
        } else if b.state == State::Play && self.tick && i.waits {
            self.held = true;
        }
        let why = match () {
            () if !Self::breaks(i) => reason::NONE,
            () if !i.gate => reason::CLOSED,
            () if i.halt => reason::HALTED,
            () => reason::QUIT,
        };
        let over = self.left < 0 && b.advance;
        let failed = self.reason > reason::DONE;
        (self.state, self.reason) = match b.state {
            State::Idle if b.starts => (State::Settle, reason::NONE),
            State::Idle if b.clear => (State::Idle, reason::NONE),
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
    }

    /// The segment that plays: its clocks, its tag and its outputs.
    fn clock_segment(&mut self, b: &Before) {
        if b.state == State::Settle {
            (self.left, self.first) = (-1, true);
        } else if b.commit {
            (self.left, self.first) = (i64::from(self.out) - 2, false);
        } else if self.left >= 0 && b.advance {
            self.left -= 1;
        }
        if b.commit {
            self.begun = self.begun.wrapping_add(1);
            self.moves = self.next_moves;
            (self.tag, self.outputs) = ((self.next >> 16) as u16, self.next as u16);
        } else if b.state == State::Idle && b.dead {
            self.outputs = 0;
        }
    }

    /// The next segment, word by word.
    fn clock_fetch(&mut self, told: &Told, b: &Before) {
        let play = b.state == State::Play;
        let fetch = play && !self.staged && self.level != 0;
        if self.fetched == Some(1) {
            self.next = self.out;
        }
        let moves = matches!(told.stage, Some((at, word)) if at & 1 == 0 && word != 0);
        self.next_moves = play && !b.commit && (self.next_moves || moves);
        self.staged = play && !b.commit && (self.staged || (fetch && b.at == 0));
        self.fetched = fetch.then_some(b.at);
        self.at = if !play || b.commit {
            self.words - 1
        } else if fetch && b.at != 0 {
            b.at - 1
        } else {
            b.at
        };
    }

    fn clock_fifo(&mut self, i: &Input, b: &Before) {
        self.out = self.memory[self.tail * self.slot + b.at];
        let whole = self.seen == (1 << self.words) - 1;
        let taken = i.push && !b.full && !b.dead && whole && !self.short;
        if i.push {
            self.refused |= match () {
                () if b.full => refused::FULL,
                () if b.dead => refused::NOT_NOW,
                () if !whole => refused::INCOMPLETE,
                () if self.short => refused::SHORT,
                () => 0,
            };
        }
        if i.order == Some(Order::Start) && !b.starts {
            self.refused |= refused::START;
        }
        if b.clear {
            self.refused = 0;
        }
        let write = i.word.filter(|(at, _)| *at < self.words && !b.full);
        if let Some((at, word)) = write {
            self.memory[self.head * self.slot + at] = word;
            if at == 0 {
                self.short = word < CLOCKS_MIN;
            }
        }
        if i.push || b.dead {
            self.seen = 0;
        } else if let Some((at, _)) = write {
            self.seen |= 1 << at;
        }
        let flush = b.dead || (b.clear && b.state == State::Idle);
        (self.tail, self.level) = if flush {
            (self.head, 0)
        } else {
            (
                (self.tail + usize::from(b.commit)) % DEPTH,
                self.level + usize::from(taken) - usize::from(b.commit),
            )
        };
        self.head = (self.head + usize::from(taken)) % DEPTH;
    }

    /// How fast path time passes.
    fn clock_pace(&mut self, i: &Input, b: &Before) {
        let pace_now = self.pace_now();
        let wanted = u64::from(i.pace.min(PACE_ONE)) << 16;
        let down = !self.up && !self.turned;
        let slew = i64::from(i.slew);
        let moved = self.scale as i64 + if down { -slew } else { slew };
        let below = moved < wanted as i64;
        let there = i.slew == 0 || self.up != below;
        if !matches!(b.state, State::Play | State::Halt) {
            self.scale = wanted;
        } else if b.state == State::Play && !self.turned {
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
            // The last clock, and the commit after it, are made one by one.
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
mod tests;
