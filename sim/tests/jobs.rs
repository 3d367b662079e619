//! Jobs on the Verilated cores of `tests/boards/jobs.toml`: `segments` with its stepgens, outputs and banks against the models, clock
//! by clock, under random stimulus; and every edge of a long job where the integer model has it.
//!
//! Run as `cargo test --release -p ferrocnc-sim --features board --test jobs` after `sim/verilator/cores.sh jobs`.
//!
//! | variable | meaning | default |
//! |---|---|---|
//! | `FERROCNC_JOBS_CORES` | folder of `libferrocnc_cores.so`, as `sim/verilator/cores.sh` leaves it | `target/sim/cores-jobs` |
//! | `FERROCNC_CLOCKS` | clocks to compare, in all | 12000000 |
//! | `FERROCNC_SEED` | seed; printed | from the clock |

use rand::{Rng, SeedableRng};
use rand_pcg::Pcg32;
use sim::model::Board;
use sim::model::board::{Build, Bus, pages};
use sim::model::segments::{reason, refused};
use sim::soc::{Cores, CoresPins, Pins};
use std::collections::{BTreeMap, VecDeque};
use std::path::{Path, PathBuf};
use wire::describe::Channels;

const ARM: u32 = 0x4152_4d31;
const SOFT: u32 = 0x534f_4654;
const STOP: u32 = 0x5354_4f50;
const CLEAR: u32 = 0x434c_5231;

const PUSH: u32 = 16;
const CONTROL: u32 = 17;
const PACE: u32 = 18;
const STATUS: u32 = 22;
const START: u32 = 1;
const QUIT: u32 = 2;
const FORGET: u32 = 3;

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

fn from_environment<T: std::str::FromStr>(name: &str, usual: T) -> T {
    let given = std::env::var(name).ok().and_then(|text| text.parse().ok());
    given.unwrap_or(usual)
}

fn seed() -> u64 {
    let now = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH);
    let now = now.expect("a clock").as_nanos() as u64;
    from_environment("FERROCNC_SEED", now)
}

/// The Verilated cores and their model, side by side.
struct Pair {
    cores: Cores,
    pins: CoresPins,
    board: Board,
    seed: u64,
    clock: u64,
}

impl Pair {
    fn new(seed: u64) -> Self {
        let folder: PathBuf =
            from_environment("FERROCNC_JOBS_CORES", root().join("target/sim/cores-jobs"));
        let mut cores = Cores::load(&folder).unwrap_or_else(|error| panic!("{error}"));
        let mut pins = CoresPins {
            adr: pages::IDENT << 9 | 7,
            ..CoresPins::default()
        };
        cores.rise(&mut pins);
        let board = Board::at(
            Build {
                channels: CHANNELS,
                clock_hz: 60_000_000,
                estop_mask: 0,
                estop_level: 0,
                abi: 0,
                version: 0x00_0100,
                rom_words: pins.dat_r,
                jobs: AXES as u8,
            },
            0,
        );
        let mut pair = Pair {
            cores: Cores::load(&folder).unwrap_or_else(|error| panic!("{error}")),
            pins: CoresPins::default(),
            board,
            seed,
            clock: 0,
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
        self.pins.adr = address;
        self.pins.we = write.is_some().into();
        self.pins.dat_w = write.unwrap_or(0);
        let (page, word) = (address >> 9, address & 0x1ff);
        let expected = self.board.peek(page, word);
        self.board.clock(&bus);
        self.cores.rise(&mut self.pins);
        let (p, m) = (&self.pins, self.board.pins());
        let theirs = (p.step, p.dir, p.step_n, p.dir_n, p.gpio_out, p.pwm_out, p.gate);
        let ours = (m.step, m.dir, m.step_n, m.dir_n, m.gpio_out, m.pwm_out, m.gate);
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
        expected
    }

    fn status(&self) -> u32 {
        self.board.peek(pages::SEGMENTS, STATUS)
    }
}

struct Stimulus {
    random: Pcg32,
    writes: VecDeque<(u32, u32, u32)>,
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

    fn below(&mut self, n: u32) -> u32 {
        self.random.random_range(0..n.max(1))
    }

    fn one_in(&mut self, n: u32) -> bool {
        self.below(n) == 0
    }

    fn spread(&mut self) -> u32 {
        let shift = self.below(32);
        self.random.random::<u32>() >> shift
    }

    fn write(&mut self, page: u32, word: u32, data: u32) {
        self.writes.push_back((page, word, data));
    }

    fn settings(&mut self) {
        self.fast = self.one_in(3);
        let patient = self.one_in(2);
        for n in 0..4 {
            for word in 0..4 {
                let most = if patient { 3 } else { 40 };
                let time = self.below(most);
                self.write(pages::STEPGEN + n, word, time);
            }
            let stop = if self.fast || self.one_in(4) {
                0
            } else {
                self.spread() | 1 << 29
            };
            self.write(pages::STEPGEN + n, 4, stop);
            let mode = self.below(32);
            self.write(pages::STEPGEN + n, 5, mode);
        }
        for word in [1, 2] {
            let bits = self.random.random();
            self.write(pages::GPIO, word, bits);
        }
        let slew = if self.one_in(3) {
            0
        } else {
            self.spread() | 1 << 18
        };
        self.write(pages::SEGMENTS, 19, slew);
        for word in [20, 21] {
            let bits = self.random.random();
            self.write(pages::SEGMENTS, word, bits);
        }
        let timeout = if self.one_in(6) { 9000 } else { 400_000 };
        self.write(pages::WATCHDOG, 0, timeout);
        let grace = if self.one_in(2) { 300 } else { 50_000 };
        self.write(pages::WATCHDOG, 1, grace);
        self.greedy = !self.one_in(2);
    }

    fn segment(&mut self) {
        self.to_go = match self.to_go.checked_sub(1) {
            Some(left) => left,
            None => 1 + self.below(90),
        };
        self.complete = self.to_go == 0 && !self.one_in(5);
        let clocks = match self.below(12) {
            0 => 64,
            1 => self.below(64),
            _ => 64 + self.below(700),
        };
        let top = if self.fast { 1 << 28 } else { 1 << 24 };
        let mut words = vec![clocks, self.random.random()];
        for n in 0..AXES {
            let velocity = match self.below(8) {
                _ if self.to_go == 0 => 0,
                0 => 0,
                1 => self.velocity[n],
                2 => 1,
                _ => self.random.random_range(-top..top),
            };
            let away = u64::from(velocity.abs_diff(self.velocity[n])) << 24;
            let needed = away.div_ceil(u64::from(clocks.max(64)) - 2);
            let accel = match self.below(12) {
                0 => 0,
                1 => self.spread(),
                _ => needed.min(u32::MAX.into()) as u32,
            };
            self.velocity[n] = velocity;
            words.extend([velocity as u32, accel]);
        }
        let missing = if self.one_in(25) { self.below(8) } else { 99 };
        let first = self.below(8);
        for n in 0..8 {
            let at = (first + n) % 8;
            if at != missing {
                self.write(pages::SEGMENTS, at, words[at as usize]);
            }
        }
        if self.one_in(50) {
            let at = self.below(16);
            let data = self.random.random();
            self.write(pages::SEGMENTS, at, data);
        }
        self.write(pages::SEGMENTS, PUSH, 0);
    }

    /// A command of the host's, whoever owns the stepgens.
    fn host(&mut self) {
        for n in 0..4 {
            let velocity = self.random.random_range(-(1i32 << 24)..1 << 24);
            self.write(pages::COMMAND, 4 + 2 * n, velocity as u32);
            let accel = self.spread() | 1 << 22;
            self.write(pages::COMMAND, 5 + 2 * n, accel);
        }
        let enables = if self.one_in(4) { self.below(16) } else { 15 };
        self.write(pages::COMMAND, 0, enables);
        let outputs = self.random.random();
        self.write(pages::COMMAND, 1, outputs);
        let strobe = 1 + self.below(3);
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
        if self.one_in(100) || (failed && self.one_in(4)) {
            self.write(pages::WATCHDOG, 3, CLEAR);
            self.write(pages::WATCHDOG, 3, ARM);
            self.write(pages::TIMEBASE, 7, 1);
        }
        if failed && self.one_in(3) {
            self.write(pages::SEGMENTS, CONTROL, FORGET);
        }
        let wants = match () {
            () if self.complete => self.one_in(300),
            () if self.greedy => level < 60 || self.one_in(6),
            () if state == 0 => level < 10,
            () => self.one_in(14),
        };
        if wants {
            self.segment();
        }
        if (state == 0 && (level > 8 || self.complete) && self.one_in(3)) || self.one_in(60) {
            self.write(pages::SEGMENTS, CONTROL, START);
        }
        match self.below(1200) {
            0 | 1 => self.write(pages::WATCHDOG, 3, STOP),
            2 => self.write(pages::WATCHDOG, 3, SOFT),
            3..6 => self.write(pages::SEGMENTS, CONTROL, QUIT),
            6 => {
                let any = self.spread();
                self.write(pages::SEGMENTS, CONTROL, any);
            }
            7..12 => self.write(pages::SEGMENTS, CONTROL, FORGET),
            12..20 => self.host(),
            20..32 => self.write(pages::SEGMENTS, PACE, 0),
            32..52 => {
                let pace = self.below(70_000);
                self.write(pages::SEGMENTS, PACE, pace);
            }
            52..200 => self.write(pages::SEGMENTS, PACE, 1 << 16),
            200..203 => self.write(pages::SEGMENTS, PUSH, 1),
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
    outputs: u32,
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
        self.add("starts after which a pulse held time", u64::from((status & !self.status) >> 25 & 1));
        let begun = pair.board.peek(pages::SEGMENTS, 23);
        self.add("segments", begun.wrapping_sub(self.begun).into());
        let m = pair.board.pins();
        self.add("edges of STEP", (m.step ^ self.steps).count_ones().into());
        self.add("edges of outputs", (m.gpio_out ^ self.outputs).count_ones().into());
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
                gap = stimulus.below(300);
            }
            gap -= u32::from(gap != 0);
        }
        let pause = stimulus.one_in(3);
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
                let at = stimulus.below(stimulus.registers.len() as u32) as usize;
                let (page, word) = stimulus.registers[at];
                pair.clock(page << 9 | word, None);
            }
        }
        seen.look(&pair);
    }
    (seen.counts, started.elapsed().as_secs_f64())
}

/// Less than this of anything, per million clocks, and the run has proven nothing about it.
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
        println!("seed {seed}: {} clocks, {rate:.0} kclk/s, no difference", clocks / 2);
    }
    for (what, n) in &happened {
        println!("  {what}: {n}");
    }
    for (what, least) in LEAST_PER_MILLION {
        let n = happened.get(what).copied().unwrap_or(0);
        let wanted = least * (clocks / 1_000_000);
        assert!(n >= wanted, "{what}: {n} in {clocks} clocks, wanted {wanted}");
    }
}
