//! `encoder.sv` with its channel of `edges.sv`: filters the pins, counts in one of six modes, and
//! reports the index and the time.

use super::debounce::Debounce;
use wire::exchange::EDGE_TIME_BITS;
use wire::map;

/// One channel. `count` is the wide counter's total with its delta: the count as a sample in this
/// clock would see it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Encoder {
    meta: [bool; 4],
    sync: [bool; 4],
    shaft: Debounce,
    mark: Debounce,
    was: [bool; 2],
    live: bool,
    index_level: bool,
    count: i32,
    edge_time: u32,
    errors: u8,
    wrong: bool,
}

impl Default for Encoder {
    fn default() -> Self {
        Encoder {
            meta: [false; 4],
            // A starts with the opposite level of the pin, so that nothing counts before the pin is
            // sampled.
            sync: [true, false, false, false],
            shaft: Debounce::default(),
            mark: Debounce::default(),
            was: [false; 2],
            live: false,
            index_level: false,
            count: 0,
            edge_time: 0,
            errors: 0,
            wrong: false,
        }
    }
}

/// Its inputs in a clock.
#[derive(Clone, Copy, Debug, Default)]
pub struct Input {
    /// Pins: A, B, index, mask.
    pub pins: [bool; 4],
    /// The mode register.
    pub mode: u32,
    /// The filter register.
    pub filter: u8,
    /// The wall clock.
    pub now: u32,
    /// The count restarts in this clock.
    pub clear: bool,
    /// The rotation is at this channel.
    pub visit: bool,
}

impl Input {
    fn select(&self) -> u32 {
        self.mode & wire::regmap::encoder::MODE_SELECT
    }
    fn has(&self, bit: u32) -> bool {
        self.mode & bit != 0
    }
}

const COUNTER: u32 = map::CountMode::Counter as u32;

/// What a clock did.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Output {
    /// Counted.
    pub delta: i32,
    /// A and B changed together.
    pub illegal: bool,
}

impl Encoder {
    /// The count.
    pub fn count(&self) -> i32 {
        self.count
    }

    /// As if it had counted so far.
    pub fn preset(&mut self, count: i32) {
        self.count = count;
    }

    /// The edge word: errors and the time of the last counted edge. Errors within one rotation
    /// count once.
    pub fn edge(&self) -> u32 {
        let errors = self.errors.wrapping_add(self.wrong.into());
        u32::from(errors) << EDGE_TIME_BITS | self.edge_time
    }

    /// The index, filtered, with polarity and mask.
    pub fn index_level(&self) -> bool {
        self.index_level
    }

    fn lines(&self) -> u8 {
        u8::from(self.sync[0]) << 1 | u8::from(self.sync[1])
    }

    fn mark_in(&self, i: &Input) -> u8 {
        let index = self.sync[2] != i.has(map::ENCODER_INDEX_INVERT);
        let mask = self.sync[3] != i.has(map::ENCODER_MASK_INVERT);
        u8::from(index && (mask || !i.has(map::ENCODER_MASK_ENABLE)))
    }

    fn now_levels(&self) -> [bool; 2] {
        [self.shaft.level() & 2 != 0, self.shaft.level() & 1 != 0]
    }

    fn counts(&self, select: u32) -> Output {
        let [a, b] = self.now_levels();
        let [a_was, b_was] = self.was;
        let [a_edge, b_edge] = [a != a_was, b != b_was];
        let [a_rise, b_rise] = [a && !a_was, b && !b_was];
        let (counts, up) = match select {
            0 => (a_edge != b_edge, a != b_was),
            1 => (a_edge && !b_edge, a != b_was),
            2 => (a_edge && !b_edge && !b, a != b_was),
            3 => (a_rise, true),
            4 | 6 => (a_rise, !b),
            _ => (a_rise != b_rise, a_rise),
        };
        let delta = match (self.live && counts, up) {
            (false, _) => 0,
            (true, true) => 1,
            (true, false) => -1,
        };
        Output {
            delta,
            illegal: self.live && a_edge && b_edge && select < COUNTER,
        }
    }

    /// One rising edge.
    pub fn clock(&mut self, i: &Input) -> Output {
        let out = self.counts(i.select());
        let start = if i.clear { 0 } else { self.count };
        self.count = start.wrapping_add(out.delta);
        if out.delta != 0 {
            self.edge_time = i.now & ((1 << EDGE_TIME_BITS) - 1);
        }
        if i.visit {
            self.errors = self.errors.wrapping_add(self.wrong.into());
            self.wrong = false;
        }
        self.wrong |= out.illegal;
        self.index_level = self.mark.level() != 0;
        self.was = self.now_levels();
        self.live = self.shaft.known();
        let (lines, mark) = (self.lines(), self.mark_in(i));
        self.shaft.clock(lines, i.filter);
        self.mark.clock(mark, i.filter);
        self.sync = self.meta;
        self.sync[1] &= i.select() != COUNTER;
        self.meta = i.pins;
        out
    }

    /// Clocks in which nothing is counted and nothing else visible happens.
    pub fn quiet(&self, i: &Input) -> u64 {
        let mut sync = i.pins;
        sync[1] &= i.select() != COUNTER;
        let rest = self.meta == i.pins
            && self.sync == sync
            && self.was == self.now_levels()
            && self.live == self.shaft.known()
            && self.index_level == (self.mark.level() != 0)
            && !self.wrong;
        if !rest {
            return 0;
        }
        let shaft = self.shaft.quiet(self.lines(), i.filter);
        shaft.min(self.mark.quiet(self.mark_in(i), i.filter))
    }

    /// That many quiet clocks at once.
    pub fn skip(&mut self, clocks: u64, filter: u8) {
        self.shaft.skip(clocks, filter);
        self.mark.skip(clocks, filter);
    }
}
