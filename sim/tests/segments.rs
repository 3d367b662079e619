//! Jobs on the Verilated cores of `tests/boards/jobs.toml`: `segments` with its stepgens, outputs
//! and banks against the models, clock by clock, under random stimulus; and every edge of a long
//! job where the integer model has it.
//!
//! Run as `cargo test --profile tests -p ferrocnc-sim --test segments` after
//! `sim/verilator/cores.sh jobs`.
//!
//! | variable | meaning | default |
//! |---|---|---|
//! | `FERROCNC_JOBS_CORES` | folder of `libferrocnc_cores.so`, as `sim/verilator/cores.sh` leaves it | `target/sim/cores-jobs` |
//! | `FERROCNC_CLOCKS` | clocks to compare, in all | 12000000 |
//! | `FERROCNC_SEGMENTS` | segments of the job with predicted edges | 10000 |
//! | `FERROCNC_SEED` | seed; printed | from the clock |

use motion::segment::{MotionState, Segment};
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg32;
use sim::model::Board;
use sim::model::board::{Build, Bus, pages};
use sim::model::segments::{reason, refused};
use sim::soc::{Cores, CoresPins, Pins};
use sim::stimulus::{Chance, Write, before_a_job, from_environment, seed};
use std::collections::{BTreeMap, VecDeque};
use std::path::{Path, PathBuf};
use wire::describe::Channels;
use wire::regmap::{segments, watchdog};

const ARM: u32 = watchdog::CONTROL_KEY_ARM;
const SOFT: u32 = watchdog::CONTROL_KEY_SOFT;
const STOP: u32 = watchdog::CONTROL_KEY_STOP;
const CLEAR: u32 = watchdog::CONTROL_KEY_CLEAR;

const PUSH: u32 = segments::PUSH as u32;
const CONTROL: u32 = segments::CONTROL as u32;
const PACE: u32 = segments::PACE as u32;
const SLEW: u32 = segments::SLEW as u32;
const MASK: u32 = segments::MASK as u32;
const STATUS: u32 = segments::STATUS as u32;
const BEGUN: u32 = segments::BEGUN as u32;
const LEFT: u32 = segments::LEFT as u32;
const START: u32 = segments::CONTROL_COMMAND_START;
const QUIT: u32 = segments::CONTROL_COMMAND_QUIT;
const FORGET: u32 = segments::CONTROL_COMMAND_CLEAR;

const CHANNELS: Channels = Channels {
    stepgens: 4,
    encoders: 1,
    pwms: 1,
    inputs: 4,
    outputs: 20,
};
const AXES: usize = 3;

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .parent()
        .expect("the workspace")
}

/// The Verilated cores and their model, side by side.
struct Pair {
    cores: Cores,
    pins: CoresPins,
    board: Board,
    seed: u64,
    clock: u64,
    /// What the cores read in this clock: they were told in the one before.
    reading: u32,
}

impl Pair {
    fn new(seed: u64) -> Self {
        let folder: PathBuf =
            from_environment("FERROCNC_JOBS_CORES", root().join("target/sim/cores-jobs"));
        let mut cores = Cores::load(&folder).unwrap_or_else(|error| panic!("{error}"));
        let mut pins = CoresPins {
            coming: pages::IDENT << 9 | 7,
            ..CoresPins::default()
        };
        cores.rise(&mut pins);
        cores.rise(&mut pins);
        let board = Board::at(
            Build {
                channels: CHANNELS,
                clock_hz: 60_000_000,
                estop_mask: 8,
                estop_level: 8,
                abi: 0,
                version: 0x00_0100,
                rom_words: pins.dat_r,
                jobs: AXES as u8,
                readback: true,
            },
            0,
        );
        let mut pair = Pair {
            cores: Cores::load(&folder).unwrap_or_else(|error| panic!("{error}")),
            pins: CoresPins::default(),
            board,
            seed,
            clock: 0,
            reading: 0,
        };
        pair.board.drive(&Pins::default());
        pair
    }

    /// One clock with a register read or written; they must agree on every pin and on the word.
    fn clock(&mut self, address: u32, write: Option<u32>) -> u32 {
        let bus = Bus {
            write: write.map(|data| (address, data)),
            ..Bus::default()
        };
        (self.pins.adr, self.pins.coming) = (address, address);
        self.pins.we = write.is_some().into();
        self.pins.dat_w = write.unwrap_or(0);
        let answer = self.board.peek(address >> 9, address & 0x1ff);
        let read = core::mem::replace(&mut self.reading, address);
        let (page, word) = (read >> 9, read & 0x1ff);
        let expected = self.board.peek(page, word);
        self.board.clock(&bus);
        self.cores.rise(&mut self.pins);
        let (p, m) = (&self.pins, self.board.pins());
        let theirs = (
            p.step, p.dir, p.step_n, p.dir_n, p.gpio_out, p.pwm_out, p.gate,
        );
        let ours = (
            m.step, m.dir, m.step_n, m.dir_n, m.gpio_out, m.pwm_out, m.gate,
        );
        assert!(
            theirs == ours,
            "clock {}, seed {}: pins (step, dir, step_n, dir_n, gpio, pwm, gate)\n  gateware {theirs:x?}\n  model    {ours:x?}",
            self.clock,
            self.seed
        );
        assert!(
            p.dat_r == expected,
            "clock {}, seed {}: page {page} word {word}: gateware {:#x}, model {expected:#x}",
            self.clock,
            self.seed,
            p.dat_r
        );
        self.clock += 1;
        answer
    }

    fn status(&self) -> u32 {
        self.board.peek(pages::SEGMENTS, STATUS)
    }
}

struct Stimulus {
    random: Pcg32,
    writes: VecDeque<Write>,
    registers: Vec<(u32, u32)>,
    /// Velocities at the end of the segment pushed last.
    velocity: [i32; AXES],
    /// Segments still to come before one that ends at rest.
    to_go: u32,
    /// All of this job's segments are pushed.
    complete: bool,
    greedy: bool,
    chapter: u32,
    token: u32,
    fast: bool,
}

impl Stimulus {
    fn new(seed: u64) -> Self {
        let mut registers: Vec<(u32, u32)> = (0..30).map(|word| (pages::SEGMENTS, word)).collect();
        for (page, words) in [
            (pages::WATCHDOG, 9),
            (pages::IDENT, 8),
            (pages::GPIO, 8),
            (pages::COMMAND, 12),
            (pages::STATUS, 20),
            (pages::STEPGEN, 6),
        ] {
            registers.extend((0..words).map(|word| (page, word)));
        }
        Stimulus {
            random: Pcg32::seed_from_u64(seed),
            writes: VecDeque::new(),
            registers,
            velocity: [0; AXES],
            to_go: 0,
            complete: false,
            greedy: true,
            chapter: 0,
            token: 0,
            fast: false,
        }
    }

    fn write(&mut self, page: u32, word: u32, data: u32) {
        self.writes.push_back((page, word, data));
    }

    fn settings(&mut self) {
        self.fast = self.random.one_in(3);
        let patient = self.random.one_in(2);
        for n in 0..4 {
            for word in 0..4 {
                let most = if patient { 3 } else { 40 };
                let time = self.random.below(most);
                self.write(pages::STEPGEN + n, word, time);
            }
            let stop = if self.fast || self.random.one_in(4) {
                0
            } else {
                self.random.spread() | 1 << 29
            };
            self.write(pages::STEPGEN + n, 4, stop);
            let mode = self.random.below(32);
            self.write(pages::STEPGEN + n, 5, mode);
        }
        for word in [1, 2] {
            let bits = self.random.random();
            self.write(pages::GPIO, word, bits);
        }
        let slew = if self.random.one_in(3) {
            0
        } else {
            self.random.spread() | 1 << 18
        };
        self.write(pages::SEGMENTS, SLEW, slew);
        for word in [20, 21] {
            let bits = self.random.random();
            self.write(pages::SEGMENTS, word, bits);
        }
        let timeout = if self.random.one_in(6) { 9000 } else { 400_000 };
        self.write(pages::WATCHDOG, 0, timeout);
        let grace = if self.random.one_in(2) { 300 } else { 50_000 };
        self.write(pages::WATCHDOG, 1, grace);
        self.greedy = !self.random.one_in(2);
    }

    fn segment(&mut self) {
        self.to_go = match self.to_go.checked_sub(1) {
            Some(left) => left,
            None => 1 + self.random.below(90),
        };
        self.complete = self.to_go == 0 && !self.random.one_in(5);
        let clocks = match self.random.below(12) {
            0 => 64,
            1 => self.random.below(64),
            _ => 64 + self.random.below(700),
        };
        let top = if self.fast { 1 << 28 } else { 1 << 24 };
        let mut words = vec![clocks, self.random.random()];
        for n in 0..AXES {
            let velocity = match self.random.below(8) {
                _ if self.to_go == 0 => 0,
                0 => 0,
                1 => self.velocity[n],
                2 => 1,
                _ => self.random.random_range(-top..top),
            };
            let away = u64::from(velocity.abs_diff(self.velocity[n])) << 24;
            let needed = away.div_ceil(u64::from(clocks.max(64)) - 2);
            let accel = match self.random.below(12) {
                0 => 0,
                1 => self.random.spread(),
                _ => needed.min(u32::MAX.into()) as u32,
            };
            self.velocity[n] = velocity;
            words.extend([velocity as u32, accel]);
        }
        let missing = if self.random.one_in(25) {
            self.random.below(8)
        } else {
            99
        };
        let first = self.random.below(8);
        for n in 0..8 {
            let at = (first + n) % 8;
            if at != missing {
                self.write(pages::SEGMENTS, at, words[at as usize]);
            }
        }
        if self.random.one_in(50) {
            let at = self.random.below(16);
            let data = self.random.random();
            self.write(pages::SEGMENTS, at, data);
        }
        self.write(pages::SEGMENTS, PUSH, 0);
    }

    /// A command of the host, even if the segments own the stepgens.
    fn host(&mut self) {
        for n in 0..4 {
            let velocity = self.random.random_range(-(1i32 << 24)..1 << 24);
            self.write(pages::COMMAND, 4 + 2 * n, velocity as u32);
            let accel = self.random.spread() | 1 << 22;
            self.write(pages::COMMAND, 5 + 2 * n, accel);
        }
        let enables = if self.random.one_in(4) {
            self.random.below(16)
        } else {
            15
        };
        self.write(pages::COMMAND, 0, enables);
        let outputs = self.random.random();
        self.write(pages::COMMAND, 1, outputs);
        let strobe = 1 + self.random.below(3);
        self.write(pages::TIMEBASE, 7, strobe);
    }

    fn deed(&mut self, status: u32) {
        self.chapter += 1;
        if self.chapter % 400 == 1 {
            self.settings();
        }
        let (level, state, why) = (status & 0xff, status >> 8 & 3, (status >> 12 & 7) as u8);
        let failed = why > reason::DONE;
        if state == 0 && level == 0 {
            self.complete = false;
        }
        self.token += 1;
        let token = self.token;
        self.write(pages::WATCHDOG, 2, token);
        if self.random.one_in(100) || (failed && self.random.one_in(4)) {
            self.write(pages::WATCHDOG, 3, CLEAR);
            self.write(pages::WATCHDOG, 3, ARM);
            self.write(pages::TIMEBASE, 7, 1);
        }
        if failed && self.random.one_in(3) {
            self.write(pages::SEGMENTS, CONTROL, FORGET);
        }
        let wants = match () {
            () if self.complete => self.random.one_in(300),
            () if self.greedy => level < 60 || self.random.one_in(6),
            () if state == 0 => level < 10,
            () => self.random.one_in(14),
        };
        if wants {
            self.segment();
        }
        if (state == 0 && (level > 8 || self.complete) && self.random.one_in(3))
            || self.random.one_in(60)
        {
            self.write(pages::SEGMENTS, CONTROL, START);
        }
        match self.random.below(1203) {
            0 | 1 => self.write(pages::WATCHDOG, 3, STOP),
            2 => self.write(pages::WATCHDOG, 3, SOFT),
            3..6 => self.write(pages::SEGMENTS, CONTROL, QUIT),
            6 => {
                let any = self.random.spread();
                self.write(pages::SEGMENTS, CONTROL, any);
            }
            7..12 => self.write(pages::SEGMENTS, CONTROL, FORGET),
            12..20 => self.host(),
            20..32 => self.write(pages::SEGMENTS, PACE, 0),
            32..52 => {
                let pace = self.random.below(70_000);
                self.write(pages::SEGMENTS, PACE, pace);
            }
            52..200 => self.write(pages::SEGMENTS, PACE, 1 << 16),
            200..203 => self.write(pages::SEGMENTS, PUSH, 1),
            1200..1203 => self.write(pages::WATCHDOG, 3, SOFT),
            _ => {}
        }
    }
}

#[derive(Default)]
struct Seen {
    counts: BTreeMap<&'static str, u64>,
    status: u32,
    begun: u32,
    steps: u16,
    outputs: u64,
}

impl Seen {
    fn add(&mut self, what: &'static str, n: u64) {
        *self.counts.entry(what).or_default() += n;
    }

    fn look(&mut self, pair: &Pair) {
        let status = pair.status();
        let (was, now) = ((self.status >> 12 & 7) as u8, (status >> 12 & 7) as u8);
        if was != now {
            let what = match now {
                reason::DONE => "jobs done",
                reason::UNDERRUN => "underruns",
                reason::QUIT => "jobs quit",
                reason::HALTED => "soft stops in a job",
                reason::CLOSED => "gates closed in a job",
                _ => "ends cleared, jobs begun",
            };
            self.add(what, 1);
        }
        let risen = (status & !self.status) >> 16 & 31;
        for (bit, what) in [
            (refused::FULL, "pushes without room"),
            (refused::INCOMPLETE, "pushes with a word missing"),
            (refused::SHORT, "pushes of too few clocks"),
            (refused::NOT_NOW, "pushes after an end"),
            (refused::START, "starts refused"),
        ] {
            self.add(what, u64::from(risen & u32::from(bit) != 0));
        }
        let plays = status >> 8 & 3 == 2;
        self.add("clocks of pause", u64::from(plays && status >> 24 & 1 != 0));
        self.add(
            "starts after which a pulse held time",
            u64::from((status & !self.status) >> 25 & 1),
        );
        let begun = pair.board.peek(pages::SEGMENTS, BEGUN);
        self.add("segments", begun.wrapping_sub(self.begun).into());
        let m = pair.board.pins();
        self.add("edges of STEP", (m.step ^ self.steps).count_ones().into());
        self.add(
            "edges of outputs",
            (m.gpio_out ^ self.outputs).count_ones().into(),
        );
        (self.status, self.begun, self.steps, self.outputs) = (status, begun, m.step, m.gpio_out);
    }
}

fn random(seed: u64, clocks: u64) -> (BTreeMap<&'static str, u64>, f64) {
    let started = std::time::Instant::now();
    let mut pair = Pair::new(seed);
    let mut stimulus = Stimulus::new(seed);
    let mut seen = Seen::default();
    let mut gap = 0;
    while pair.clock < clocks {
        if stimulus.writes.is_empty() {
            if gap == 0 {
                stimulus.deed(pair.status());
                gap = stimulus.random.below(300);
            }
            gap -= u32::from(gap != 0);
        }
        let pause = stimulus.random.one_in(3);
        match stimulus.writes.pop_front() {
            Some((page, word, data)) if !pause => {
                pair.clock(page << 9 | word, Some(data));
            }
            later => {
                stimulus.writes.extend(later);
                let last = stimulus.writes.len();
                if later.is_some() {
                    stimulus.writes.rotate_right(1);
                }
                debug_assert_eq!(last, stimulus.writes.len());
                let at = stimulus.random.below(stimulus.registers.len() as u32) as usize;
                let (page, word) = stimulus.registers[at];
                pair.clock(page << 9 | word, None);
            }
        }
        seen.look(&pair);
    }
    (seen.counts, started.elapsed().as_secs_f64())
}

/// The least number of each event per million clocks; with fewer the run proves nothing about it.
const LEAST_PER_MILLION: &[(&str, u64)] = &[
    ("segments", 400),
    ("edges of STEP", 5000),
    ("edges of outputs", 500),
    ("jobs done", 2),
    ("underruns", 2),
    ("jobs quit", 1),
    ("soft stops in a job", 1),
    ("clocks of pause", 1000),
    ("starts after which a pulse held time", 1),
    ("pushes with a word missing", 1),
    ("pushes of too few clocks", 1),
    ("pushes after an end", 1),
    ("starts refused", 1),
];

#[test]
fn segments_and_their_model_agree_on_every_pin_and_register_in_every_clock() {
    let clocks: u64 = from_environment("FERROCNC_CLOCKS", 12_000_000);
    let seed = seed();
    let halves = [seed, seed ^ 0x5eed_0000_0001]
        .map(|seed| std::thread::spawn(move || (seed, random(seed, clocks / 2))));
    let mut happened: BTreeMap<&str, u64> = BTreeMap::new();
    for half in halves {
        let (seed, (counts, seconds)) = match half.join() {
            Ok(run) => run,
            Err(panic) => std::panic::resume_unwind(panic),
        };
        for (what, n) in counts {
            *happened.entry(what).or_default() += n;
        }
        let rate = clocks as f64 / 2.0 / seconds / 1e3;
        println!(
            "seed {seed}: {} clocks, {rate:.0} kclk/s, no difference",
            clocks / 2
        );
    }
    for (what, n) in &happened {
        println!("  {what}: {n}");
    }
    for (what, least) in LEAST_PER_MILLION {
        let n = happened.get(what).copied().unwrap_or(0);
        let wanted = least * (clocks / 1_000_000);
        assert!(
            n >= wanted,
            "{what}: {n} in {clocks} clocks, wanted {wanted}"
        );
    }
}

/// Segment, clock of it, and direction of each edge.
type Edges = VecDeque<(usize, u32, bool)>;

/// What the axes come to, and every edge on the way, from the words alone.
fn prediction(segments: &[Segment]) -> (MotionState, [Edges; AXES]) {
    let mut machine = MotionState::default();
    let mut expected: [Edges; AXES] = Default::default();
    for (number, segment) in segments.iter().enumerate() {
        for (axis, expected) in expected.iter_mut().enumerate() {
            let edges = segment.play(axis).edges(machine.axes[axis]);
            expected.extend(edges.map(|edge| (number, edge.clock, edge.forward)));
        }
        machine.run(segment);
    }
    assert!(machine.rests());
    (machine, expected)
}

/// Brings the cores to where a job can begin.
fn preparation() -> VecDeque<Write> {
    let mut writes = VecDeque::from_iter(before_a_job(4, [4, 4, 1, 1, 1 << 24, 0]));
    writes.extend([
        (pages::SEGMENTS, SLEW, 1 << 20),
        (pages::SEGMENTS, MASK, 0xf_ffff),
    ]);
    writes
}

/// The wide counts are where the axes are.
fn counts_agree(pair: &mut Pair, machine: &MotionState) {
    pair.clock(pages::TIMEBASE << 9 | 7, Some(2));
    for _ in 0..40 {
        pair.clock(0, None);
    }
    for (axis, state) in machine.axes.iter().enumerate() {
        let at = pages::STATUS << 9 | (8 + 3 * axis as u32);
        let fraction = u64::from(pair.clock(at, None));
        let pulses = u64::from(pair.clock(at + 1, None));
        assert_eq!(
            (pulses << 32 | fraction) as i64,
            state.position,
            "seed {}: axis {axis}",
            pair.seed
        );
    }
}

/// Plays a random job of so many segments and returns (edges, clocks, clocks in which time stood).
/// Every edge must come in the clock of the path in which the integer model has it; and when
/// nothing scales time and no pulse waits, that is every clock.
fn predicted(seed: u64, segments: usize, scaled: bool) -> (u64, u64, u64) {
    let mut random = Pcg32::seed_from_u64(seed);
    let mut pair = Pair::new(seed);
    let segments: Vec<Segment> = job(&mut random, segments);
    let (machine, mut expected) = prediction(&segments);
    let edges = expected.iter().map(|edges| edges.len() as u64).sum();

    let mut writes = preparation();
    let mut to_push = segments.iter().enumerate();
    let (mut asked, mut started, mut first, mut stood, mut begun_at) =
        (false, false, None, 0, vec![0u64]);
    let mut ticks = 0;
    for segment in &segments {
        begun_at.push(begun_at.last().unwrap() + u64::from(segment.clocks));
    }
    loop {
        let status = pair.status();
        let (level, state, why) = (status & 0xff, status >> 8 & 3, (status >> 12 & 7) as u8);
        if started && state == 0 {
            assert_eq!(why, reason::DONE, "seed {seed}: it ended before its end");
            break;
        }
        ticks += 1;
        assert!(ticks < 60_000_000, "seed {seed}: it never ends");
        if writes.is_empty() {
            if !asked && (level == 60 || to_push.len() == 0) {
                writes.push_back((pages::SEGMENTS, CONTROL, START));
            } else if level < 60
                && let Some((_, segment)) = to_push.next()
            {
                let words = segment.words();
                writes.extend(
                    (0..)
                        .zip(words)
                        .map(|(at, word)| (pages::SEGMENTS, at, word)),
                );
                writes.push_back((pages::SEGMENTS, PUSH, 0));
            } else if scaled && random.random_range(0..700) == 0 {
                let pace = match random.random_range(0..6) {
                    0 | 1 => 0,
                    2 => 0x1_0000,
                    _ => random.random_range(0..0x1_0000),
                };
                writes.push_back((pages::SEGMENTS, PACE, pace));
            }
        }
        asked |= writes.front() == Some(&(pages::SEGMENTS, CONTROL, START));
        started |= state != 0;

        let begun = pair.board.peek(pages::SEGMENTS, BEGUN) as usize;
        let left = pair.board.peek(pages::SEGMENTS, LEFT);
        let pins = pair.pins;
        let write = writes.pop_front();
        let address = write.map_or(0, |(page, word, _)| page << 9 | word);
        pair.clock(address, write.map(|(_, _, data)| data));
        if first.is_none() && begun == 1 {
            first = Some(pair.clock);
        }
        stood +=
            u64::from(state == 2 && pair.board.peek(pages::SEGMENTS, LEFT) == left && begun > 0);
        let risen = pair.pins.step & !pins.step;
        for (axis, expected) in expected.iter_mut().enumerate() {
            if risen >> axis & 1 == 0 {
                continue;
            }
            let number = begun - 1;
            let clock = segments[number].clocks.wrapping_sub(2).wrapping_sub(left);
            let forward = pair.pins.dir >> axis & 1 == 0;
            assert_eq!(
                Some((number, clock, forward)),
                expected.pop_front(),
                "seed {seed}, clock {}: an edge of axis {axis} (segment, clock of it, forward): emitted, predicted",
                pair.clock
            );
            let held = pair.status() >> 25 & 1 != 0;
            if !scaled && !held {
                let path = begun_at[number] + u64::from(clock);
                let real = pair.clock - first.expect("begun");
                assert_eq!(
                    real, path,
                    "seed {seed}: time passed differently without a pace or a pulse that waits"
                );
            }
        }
    }
    let missing: usize = expected.iter().map(VecDeque::len).sum();
    assert_eq!(missing, 0, "seed {seed}: edges predicted and not emitted");
    assert_eq!(
        pair.board.peek(pages::SEGMENTS, BEGUN) as usize,
        segments.len()
    );
    counts_agree(&mut pair, &machine);
    (edges, pair.clock, stood)
}

fn job(random: &mut Pcg32, segments: usize) -> Vec<Segment> {
    let mut before = [0i32; AXES];
    (0..segments)
        .map(|number| {
            let last = number + 1 == segments;
            let clocks = match random.random_range(0..6) {
                0 if !last => 64,
                _ => random.random_range(64..900),
            };
            // What the steepest acceleration reaches: 256 units of velocity a clock. More comes at
            // once, but never through a reversal.
            let most = (i64::from(clocks) - 2) << 8;
            let aims = before.map(|before| {
                let wanted = match random.random_range(0..6) {
                    _ if last => 0,
                    0 => 0,
                    1 => before,
                    _ => random.random_range(-(1i32 << 27)..1 << 27),
                };
                let near =
                    i64::from(wanted).clamp(i64::from(before) - most, i64::from(before) + most);
                let same_way = (before < 0) == (wanted < 0) || wanted == 0;
                let away = (near - i64::from(before)).unsigned_abs() << 24;
                // The whole segment, or less of it: a ramp and then a constant velocity.
                let least = away.div_ceil(u64::from(clocks) - 2).max(1);
                let steeper = random.random_range(1..4);
                match same_way && (last || random.random_range(0..4) == 0) {
                    true => (wanted, 0),
                    false => (near as i32, (least * steeper).min(u32::MAX.into()) as u32),
                }
            });
            let (velocity, accel) = (aims.map(|aim| aim.0), aims.map(|aim| aim.1));
            before = velocity;
            Segment {
                clocks,
                velocity,
                accel,
                aux: random.random(),
                tag: number as u16,
            }
        })
        .collect()
}

#[test]
fn every_edge_of_10_000_segments_is_where_the_integer_model_has_it() {
    let seed = seed();
    let segments: usize = from_environment("FERROCNC_SEGMENTS", 10_000);
    let runs = [false, true].map(|scaled| {
        std::thread::spawn(move || {
            predicted(seed, if scaled { segments / 3 } else { segments }, scaled)
        })
    });
    for (run, what) in runs
        .into_iter()
        .zip(["at full pace", "with random pace and pauses"])
    {
        match run.join() {
            Ok((edges, clocks, stood)) => println!(
                "seed {seed}, {what}: {edges} edges in {clocks} clocks, time stood in {stood}; emitted and predicted differ in 0"
            ),
            Err(panic) => std::panic::resume_unwind(panic),
        }
    }
}
