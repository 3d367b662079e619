//! The registers: the values that the bus wrote, and the value that each reads.

use super::{Board, CHANNELS, pages};
use crate::model::gpio::Gpio;
use crate::model::lowest;
use crate::model::segments::{self, State, Told};
use crate::model::stepgen;
use motion::segment::PACE_ONE;
use wire::exchange::PWM_PERIOD_MAX;
use wire::map::{DIR_CLOCKS_MAX, PROBE_ENABLE, PROBE_INPUT_MASK, PROBE_INVERT, STEP_CLOCKS_MAX};
use wire::regmap::{self, command, status};

/// Bits of a word's number in the address of a bus cycle.
pub(super) const WORD_BITS: u32 = (regmap::CSR_PAGE / 4).trailing_zeros();

/// Page and word of the address of a bus cycle.
pub(super) fn place(address: u32) -> (u32, usize) {
    (
        address >> WORD_BITS,
        (address & ((1 << WORD_BITS) - 1)) as usize,
    )
}

/// Words of the command page from which on the stepgens' and the PWMs' are.
const STEPGENS: usize = command::STEPGEN0_VELOCITY;

const PWMS: usize = command::PWM0_WIDTH;

const PROBE: u32 = PROBE_INPUT_MASK | PROBE_ENABLE | PROBE_INVERT;

const STEPGEN_MODE: u32 = regmap::stepgen::MODE_STEP_INVERT
    | regmap::stepgen::MODE_DIR_INVERT
    | regmap::stepgen::MODE_KIND
    | regmap::stepgen::MODE_INDEX_INVERT;

const PWM_MODE: u32 = regmap::pwm::MODE_INVERT
    | regmap::pwm::MODE_KIND
    | regmap::pwm::MODE_DITHER
    | regmap::pwm::MODE_SWAP;

const CONDITION: u32 = regmap::fast_path::GATE_STATUS
    | regmap::fast_path::GATE_EXECUTES
    | regmap::fast_path::GATE_TIMED;

/// Which stepgen a word of the command page is for, and which of its words it is: 0 velocity, 1
/// acceleration.
fn stepgen_word(word: usize) -> (usize, usize) {
    let at = word - STEPGENS;
    (at / command::STEPGEN_STRIDE, at % command::STEPGEN_STRIDE)
}

/// Registers that only hold the value that was written.
#[derive(Clone, Debug)]
pub(super) struct Regs {
    pub(super) timeout: u32,
    pub(super) grace: u32,
    pub(super) commit_at: [u32; 2],
    /// The guard is closed. There is no bus here whose stores it would refuse.
    pub(super) guarded: bool,
    /// Of the outputs' first word, and of the one behind it.
    pub(super) safe: [u32; 2],
    pub(super) invert: [u32; 2],
    pub(super) probe: u32,
    pub(super) led: u32,
    pub(super) enables: u32,
    pub(super) outputs: [u32; 2],
    pub(super) arms: u32,
    pub(super) probe_arms: u32,
    /// The three words of bits as committed.
    pub(super) enables_now: u32,
    pub(super) arms_now: u32,
    pub(super) probe_arms_now: u32,
    /// As the bus wrote them, and as they are.
    pub(super) velocity: [u32; CHANNELS],
    pub(super) accel: [u32; CHANNELS],
    pub(super) staged: [[u32; 2]; CHANNELS],
    pub(super) pwm: [u32; CHANNELS],
    pub(super) stepgen: [stepgen::Settings; CHANNELS],
    pub(super) encoder: [[u32; 2]; CHANNELS],
    pub(super) pwm_set: [[u32; 2]; CHANNELS],
    pub(super) debounce: [u16; regmap::IN_MAX],
    pub(super) jobs: usize,
    pub(super) pace: u32,
    pub(super) slew: u32,
    pub(super) beam: u16,
    pub(super) mask: u32,
    /// Of the fast path, and of the filter.
    pub(super) ip_sum: u16,
    pub(super) udp_sum: u16,
    pub(super) condition: u32,
    pub(super) length: u32,
    pub(super) mode: u32,
    /// The outputs of the segments.
    pub(super) aux: u32,
}

impl Regs {
    /// As they are at power-up, of a board with segments for so many axes.
    pub(super) fn new(jobs: usize) -> Self {
        Regs {
            timeout: 0,
            grace: 0,
            commit_at: [0; 2],
            guarded: false,
            safe: [0; 2],
            invert: [0; 2],
            probe: 0,
            led: 0,
            enables: 0,
            outputs: [0; 2],
            arms: 0,
            probe_arms: 0,
            enables_now: 0,
            arms_now: 0,
            probe_arms_now: 0,
            velocity: [0; CHANNELS],
            accel: [0; CHANNELS],
            staged: [[0; 2]; CHANNELS],
            pwm: [0; CHANNELS],
            stepgen: Default::default(),
            encoder: [[0; 2]; CHANNELS],
            pwm_set: [[0; 2]; CHANNELS],
            debounce: [0; regmap::IN_MAX],
            jobs,
            pace: PACE_ONE,
            slew: 0,
            beam: 0,
            mask: 0,
            ip_sum: 0,
            udp_sum: 0,
            condition: 0,
            length: 0,
            mode: 0,
            aux: 0,
        }
    }
}

impl Board {
    /// Writes a register without the bus and its clocks: the next edge sees it. Pulses (strobes,
    /// keys, tokens) go by [`Board::order`].
    pub fn set(&mut self, page: u32, word: u32, data: u32) {
        if page != pages::COMMAND {
            self.catch_up();
        }
        let job = self
            .segments
            .as_ref()
            .map_or(Told::default(), |segments| Told {
                busy: segments.state() != State::Idle,
                ..Told::default()
            });
        self.store(page, word as usize, data, job);
        self.shine();
        if page == pages::DEBOUNCE {
            self.order(page, word, data);
        } else if page != pages::COMMAND {
            self.full = self.clock + 1;
        }
    }

    /// Puts a write into the pipeline: the next edge obeys it.
    pub fn order(&mut self, page: u32, word: u32, data: u32) {
        self.write = Some((page << WORD_BITS | word, data));
        self.full = self.clock + 1;
    }

    pub(super) fn store(&mut self, page: u32, word: usize, data: u32, job: Told) {
        let c = self.build.channels;
        // No outputs at all are one in the gateware.
        let all = lowest(c.outputs.max(1));
        let (outputs, outputs_high) = (all as u32, (all >> u32::BITS) as u32);
        let regs = &mut self.regs;
        let channel = |first: u32, count: u8| {
            (first..first + u32::from(count))
                .contains(&page)
                .then(|| (page - first) as usize)
        };
        match (page, word) {
            (pages::TIMEBASE, regmap::timebase::COMMIT_AT_LO) => regs.commit_at[0] = data,
            (pages::TIMEBASE, regmap::timebase::COMMIT_AT_HI) => regs.commit_at[1] = data,
            (pages::TIMEBASE, regmap::timebase::GUARD) => {
                regs.guarded = data != regmap::timebase::GUARD_KEY_OPEN;
            }
            (pages::WATCHDOG, regmap::watchdog::TIMEOUT) => regs.timeout = data,
            (pages::WATCHDOG, regmap::watchdog::GRACE) => regs.grace = data,
            (pages::GPIO, regmap::gpio::SAFE) => regs.safe[0] = data & outputs,
            (pages::GPIO, regmap::gpio::INVERT_OUT) => regs.invert[0] = data & outputs,
            (pages::GPIO_HIGH, regmap::gpio_high::SAFE) => regs.safe[1] = data & outputs_high,
            (pages::GPIO_HIGH, regmap::gpio_high::INVERT_OUT) => {
                regs.invert[1] = data & outputs_high;
            }
            (pages::GPIO, regmap::gpio::PROBE) => regs.probe = data & PROBE,
            (pages::LED, regmap::led::PATTERN) => regs.led = data & regmap::led::PATTERN_SELECT,
            (pages::DEBOUNCE, _) if word < usize::from(c.inputs) => {
                regs.debounce[word] = data as u16
            }
            (pages::COMMAND, command::ENABLES) => regs.enables = data,
            (pages::COMMAND, command::GPIO_OUT) => regs.outputs[0] = data & outputs,
            (pages::COMMAND, command::GPIO_OUT_HIGH) => regs.outputs[1] = data & outputs_high,
            (pages::COMMAND, command::ARMS) => regs.arms = data,
            (pages::COMMAND, command::PROBE_ARMS) => regs.probe_arms = data,
            (pages::COMMAND, STEPGENS..PWMS) if stepgen_word(word).0 < usize::from(c.stepgens) => {
                let (n, accel) = stepgen_word(word);
                let into = if accel == 0 {
                    &mut regs.velocity
                } else {
                    &mut regs.accel
                };
                into[n] = data;
                let kept = n < regs.jobs && (job.busy || (job.stop && accel == 0));
                if !kept {
                    regs.staged[n][accel] = data;
                }
            }
            (pages::SEGMENTS, regmap::segments::PACE) if regs.jobs != 0 => {
                regs.pace = data & regmap::segments::PACE_SCALE
            }
            (pages::SEGMENTS, regmap::segments::SLEW) if regs.jobs != 0 => regs.slew = data,
            (pages::SEGMENTS, regmap::segments::BEAM) if regs.jobs != 0 => regs.beam = data as u16,
            (pages::SEGMENTS, regmap::segments::MASK) if regs.jobs != 0 => {
                regs.mask = data & outputs
            }
            (pages::FAST_PATH, regmap::fast_path::IP_SUM) => regs.ip_sum = data as u16,
            (pages::FAST_PATH, regmap::fast_path::UDP_SUM) => regs.udp_sum = data as u16,
            (pages::FAST_PATH, regmap::fast_path::LENGTH) => {
                regs.length = data & regmap::fast_path::LENGTH_BYTES;
            }
            (pages::FAST_PATH, regmap::fast_path::GATE) => regs.condition = data & CONDITION,
            (pages::RX_ADMISSION, regmap::rx_admission::MODE) => {
                regs.mode = data & regmap::rx_admission::MODE_SELECT;
            }
            (pages::COMMAND, PWMS..command::GPIO_OUT_HIGH) if word - PWMS < usize::from(c.pwms) => {
                regs.pwm[word - PWMS] = data;
            }
            _ => {
                if let Some(n) = channel(pages::STEPGEN, c.stepgens) {
                    let set = &mut regs.stepgen[n];
                    match word {
                        regmap::stepgen::STEPLEN => set.steplen = data & STEP_CLOCKS_MAX,
                        regmap::stepgen::STEPSPACE => set.stepspace = data & STEP_CLOCKS_MAX,
                        regmap::stepgen::DIRSETUP => set.dirsetup = data & DIR_CLOCKS_MAX,
                        regmap::stepgen::DIRHOLD => set.dirhold = data & DIR_CLOCKS_MAX,
                        regmap::stepgen::STOP_ACCEL => set.stop_accel = data,
                        regmap::stepgen::MODE => set.mode = data & STEPGEN_MODE,
                        _ => {}
                    }
                } else if let Some(n) = channel(pages::ENCODER, c.encoders) {
                    if word < regmap::encoder::WORDS {
                        regs.encoder[n][word] = data & 0xff;
                    }
                } else if let Some(n) = channel(pages::PWM, c.pwms) {
                    match word {
                        regmap::pwm::PERIOD => regs.pwm_set[n][0] = data & PWM_PERIOD_MAX,
                        regmap::pwm::MODE => regs.pwm_set[n][1] = data & PWM_MODE,
                        _ => {}
                    }
                }
            }
        }
    }

    /// What a register reads in this clock.
    pub fn read(&mut self, page: u32, word: u32) -> u32 {
        self.hub.catch_up(self.clock, &self.regs);
        self.peek(page, word)
    }

    /// The same where every edge so far was made by [`Board::clock`].
    pub fn peek(&self, page: u32, word: u32) -> u32 {
        let c = self.build.channels;
        let (regs, hub) = (&self.regs, &self.hub);
        let at = word as usize;
        let channel = |first: u32, count: u8| {
            (first..first + u32::from(count))
                .contains(&page)
                .then(|| (page - first) as usize)
        };
        match (page, at) {
            (pages::IDENT, regmap::ident::MAGIC) => regmap::IDENT_MAGIC,
            (pages::IDENT, regmap::ident::ABI) => self.build.abi,
            (pages::IDENT, regmap::ident::GATEWARE_VERSION) => self.build.version,
            (pages::IDENT, regmap::ident::SYS_CLK_HZ) => self.build.clock_hz,
            (pages::IDENT, regmap::ident::CHANNELS0) => {
                u32::from_le_bytes([c.stepgens, c.encoders, c.pwms, 0])
            }
            (pages::IDENT, regmap::ident::CHANNELS1) => {
                u32::from_le_bytes([c.inputs, c.outputs, 0, 0])
            }
            (pages::IDENT, regmap::ident::FEATURES) => {
                let bit = |there: bool, bit: u32| if there { bit } else { 0 };
                bit(self.build.jobs != 0, regmap::ident::FEATURES_JOBS)
                    | bit(self.build.readback, regmap::ident::FEATURES_READBACK)
            }
            (pages::IDENT, regmap::ident::BOARD_ROM_WORDS) => self.build.rom_words,
            (pages::TIMEBASE, regmap::timebase::NOW_LO) => self.now_caught as u32,
            (pages::TIMEBASE, regmap::timebase::NOW_HI) => (self.now_caught >> 32) as u32,
            (pages::TIMEBASE, regmap::timebase::ARRIVAL_LO) => self.arrival as u32,
            (pages::TIMEBASE, regmap::timebase::ARRIVAL_HI) => (self.arrival >> 32) as u32,
            (pages::TIMEBASE, regmap::timebase::COMMIT_AT_LO) => regs.commit_at[0],
            (pages::TIMEBASE, regmap::timebase::COMMIT_AT_HI) => regs.commit_at[1],
            (pages::TIMEBASE, regmap::timebase::STATUS) => hub.timebase.pending().into(),
            (pages::TIMEBASE, regmap::timebase::GUARD_STATUS) => regs.guarded.into(),
            (pages::TIMEBASE, regmap::timebase::ETH_BEATS) if self.build.readback => {
                self.beats_caught
            }
            (pages::PADS, _) if self.build.readback => self.pads(at),
            (pages::WATCHDOG, regmap::watchdog::TIMEOUT) => regs.timeout,
            (pages::WATCHDOG, regmap::watchdog::GRACE) => regs.grace,
            (pages::WATCHDOG, regmap::watchdog::STATUS) => {
                hub.watchdog.status(hub.extreset.active(), hub.gpio.estop())
            }
            (pages::WATCHDOG, regmap::watchdog::REMAINING) => hub.watchdog.remaining(),
            (pages::WATCHDOG, regmap::watchdog::LAST_TOKEN) => hub.watchdog.last_token(),
            (pages::WATCHDOG, regmap::watchdog::BITES) => hub.watchdog.bites(),
            (pages::WATCHDOG, regmap::watchdog::LAST_CLOSE) => hub.watchdog.last_close().into(),
            (pages::GPIO, regmap::gpio::IN_NOW) if c.inputs != 0 => hub.gpio.level(),
            (pages::GPIO, regmap::gpio::SAFE) if c.outputs != 0 => regs.safe[0],
            (pages::GPIO, regmap::gpio::INVERT_OUT) if c.outputs != 0 => regs.invert[0],
            (pages::GPIO, regmap::gpio::OUT_NOW) if c.outputs != 0 => hub.gpio.out(),
            (pages::GPIO, regmap::gpio::RAW_NOW) if c.inputs != 0 => hub.gpio.raw(),
            (pages::GPIO, regmap::gpio::ESTOP_MASK) => self.build.estop_mask,
            (pages::GPIO, regmap::gpio::ESTOP_LEVEL) => self.build.estop_level,
            (pages::GPIO, regmap::gpio::PROBE) => regs.probe,
            (pages::GPIO_HIGH, _) => self.gpio_high_word(at),
            (pages::LED, regmap::led::PATTERN) => regs.led,
            (pages::DEBOUNCE, 0..regmap::debounce::WORDS) => regs.debounce[at].into(),
            (pages::COMMAND, command::ENABLES) => regs.enables,
            (pages::COMMAND, command::GPIO_OUT) if c.outputs != 0 => regs.outputs[0],
            (pages::COMMAND, command::GPIO_OUT_HIGH) => regs.outputs[1],
            (pages::COMMAND, command::ARMS) => regs.arms,
            (pages::COMMAND, command::PROBE_ARMS) => regs.probe_arms,
            (pages::COMMAND, STEPGENS..PWMS) => match stepgen_word(at) {
                (n, 0) => regs.velocity[n],
                (n, _) => regs.accel[n],
            },
            (pages::COMMAND, PWMS..command::GPIO_OUT_HIGH) => regs.pwm[at - PWMS],
            (pages::RX_ADMISSION, regmap::rx_admission::MODE) => regs.mode,
            (pages::RX_ADMISSION, regmap::rx_admission::REFUSED) => self.admission.refused(),
            (pages::FAST_PATH, regmap::fast_path::STATUS) => self.pass_status(),
            (pages::SEGMENTS, _) => self.job_word(at),
            (pages::STATUS, _) => self.status(at),
            _ => {
                if let Some(n) = channel(pages::STEPGEN, c.stepgens) {
                    let s = &regs.stepgen[n];
                    [
                        s.steplen,
                        s.stepspace,
                        s.dirsetup,
                        s.dirhold,
                        s.stop_accel,
                        s.mode,
                    ]
                    .get(at)
                    .copied()
                    .unwrap_or(0)
                } else if let Some(n) = channel(pages::ENCODER, c.encoders) {
                    regs.encoder[n].get(at).copied().unwrap_or(0)
                } else if let Some(n) = channel(pages::PWM, c.pwms) {
                    regs.pwm_set[n].get(at).copied().unwrap_or(0)
                } else {
                    0
                }
            }
        }
    }

    /// A word of the inputs and outputs behind the first 32.
    fn gpio_high_word(&self, word: usize) -> u32 {
        let (regs, hub) = (&self.regs, &self.hub);
        let high = lowest(self.build.channels.outputs) >> u32::BITS;
        match word {
            regmap::gpio_high::IN_NOW => hub.levels()[1],
            regmap::gpio_high::SAFE => regs.safe[1],
            regmap::gpio_high::INVERT_OUT => regs.invert[1],
            regmap::gpio_high::OUT_NOW => (hub.out() >> u32::BITS & high) as u32,
            regmap::gpio_high::RAW_NOW => hub.gpio_high.as_ref().map_or(0, Gpio::raw),
            _ => 0,
        }
    }

    fn job_word(&self, word: usize) -> u32 {
        let regs = &self.regs;
        self.segments.as_ref().map_or(0, |segments| match word {
            regmap::segments::PACE => regs.pace,
            regmap::segments::SLEW => regs.slew,
            regmap::segments::BEAM => regs.beam.into(),
            regmap::segments::MASK => regs.mask,
            regmap::segments::STATUS => segments.status(),
            regmap::segments::BEGUN => segments.begun(),
            regmap::segments::LEFT => segments.left_after(self.clock - self.segments_at),
            regmap::segments::CURRENT => {
                u32::from(segments.tag()) << regmap::segments::CURRENT_TAG_SHIFT
                    | u32::from(segments.aux(regs.beam))
            }
            regmap::segments::PACE_NOW => segments.pace_now(),
            regmap::segments::SHAPE => {
                (segments.axes() | segments::DEPTH << regmap::segments::SHAPE_SEGMENTS_SHIFT) as u32
            }
            _ => 0,
        })
    }

    /// A word of the status page.
    pub fn status(&self, word: usize) -> u32 {
        let after = |first: usize| word - first;
        match word {
            status::SAMPLE_LO => self.sample as u32,
            status::SAMPLE_HI => (self.sample >> 32) as u32,
            status::GPIO_IN => self.gpio_caught[0],
            status::GPIO_IN_HIGH => self.gpio_caught[1],
            status::FLAGS0 => self.flags_caught[0],
            status::FLAGS1 => self.flags_caught[1],
            status::FLAGS2 => self.flags_caught[2],
            status::ESTOP => self.estop_caught,
            status::LEFT => self.left_caught,
            status::STEPGEN0_POSITION_LO..status::ENCODER0_COUNT => {
                let at = after(status::STEPGEN0_POSITION_LO);
                let channel = self.steps.get(at / status::STEPGEN_STRIDE);
                channel.map_or(0, |channel| match at % status::STEPGEN_STRIDE {
                    0 => channel.sampled[0],
                    1 => channel.wide_counter.sampled(),
                    _ => channel.sampled[1],
                })
            }
            status::ENCODER0_COUNT..status::GPIO_IN_HIGH => {
                let at = after(status::ENCODER0_COUNT);
                let channel = self.encoders.get(at / status::ENCODER_STRIDE);
                channel.map_or(0, |channel| match at % status::ENCODER_STRIDE {
                    0 => channel.wide_counter.sampled(),
                    _ => channel.edge.sampled(),
                })
            }
            status::ENCODER0_LATCH..status::STEPGEN0_LATCH => {
                let channel = self.encoders.get(after(status::ENCODER0_LATCH));
                channel.map_or(0, |channel| channel.wide_counter.latched())
            }
            status::STEPGEN0_LATCH..status::WORDS => {
                let channel = self.steps.get(after(status::STEPGEN0_LATCH));
                channel.map_or(0, |channel| channel.wide_counter.latched())
            }
            _ => 0,
        }
    }

    /// What two flip-flops have made of a word of the pads: as it was two clocks ago.
    fn pads(&self, word: usize) -> u32 {
        let Some(then) = self.clock.checked_sub(2) else {
            return 0;
        };
        let known = self.seen.iter().find(|(since, _)| *since <= then);
        let levels = known.unwrap_or(&self.seen[2]).1;
        let c = self.build.channels;
        let masks = [c.stepgens, c.stepgens, c.pwms].map(|count| lowest(count) as u32 * 0x1_0001);
        match word {
            0..3 => levels[word] & masks[word],
            3 => levels[3] & lowest(c.outputs) as u32,
            4 => levels[4] & (lowest(c.outputs) >> u32::BITS) as u32,
            _ => 0,
        }
    }
}
