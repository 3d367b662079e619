//! What happened in a run.

use sim::model::Board;
use sim::model::board::{Bus, pages};
use sim::model::fast_path::Output;
use sim::soc::Pins;
use std::collections::BTreeMap;
use wire::regmap::timebase;

/// What happened, by core.
#[derive(Default)]
pub struct EventCounts {
    pub counts: BTreeMap<&'static str, u64>,
    was: Pins,
    status_was: [u32; 8],
    high_was: u32,
    bites: u32,
}

impl EventCounts {
    pub fn add(&mut self, what: &'static str, n: u32) {
        *self.counts.entry(what).or_default() += u64::from(n);
    }

    pub fn clock(&mut self, pins: &Pins) {
        let was = self.was;
        self.add(
            "stepgen: edges of STEP",
            (pins.step ^ was.step).count_ones(),
        );
        self.add("stepgen: edges of DIR", (pins.dir ^ was.dir).count_ones());
        self.add("pwm: edges", (pins.pwm_out ^ was.pwm_out).count_ones());
        self.add(
            "pwm: edges of the second pin",
            (pins.pwm_dir ^ was.pwm_dir).count_ones(),
        );
        self.add(
            "gpio: edges of outputs",
            (pins.gpio_out ^ was.gpio_out).count_ones(),
        );
        self.add(
            "gpio: edges of outputs behind the first word",
            ((pins.gpio_out ^ was.gpio_out) >> 32).count_ones(),
        );
        self.add("led: edges", u32::from(pins.led != was.led));
        self.add("watchdog: openings", u32::from(pins.gate > was.gate));
        self.was = *pins;
    }

    pub fn frames(&mut self, does: &Output, bus: &Bus, refuses: bool) {
        let (commit, timed) = (does.commit, does.commit_timed);
        let last = bus.word.is_some_and(|word| word.last);
        for (what, happens) in [
            ("fast path: words staged", does.stages.is_some()),
            ("fast path: frames", last),
            ("fast path: commands committed", commit),
            ("fast path: commands committed at their time", timed),
            (
                "fast path: commands only answered",
                does.taken && !commit && !timed,
            ),
            ("fast path: words of answers", does.puts.is_some()),
            ("rx_admission: frames refused", last && refuses),
        ] {
            self.add(what, happens.into());
        }
    }

    /// Seldom: what only registers show.
    pub fn look(&mut self, board: &Board) {
        let status: [u32; 8] = std::array::from_fn(|word| board.status(word));
        let was = self.status_was;
        let risen = |word: usize| status[word] & !was[word];
        let half = |word: u32| ((word & 0xffff).count_ones(), (word >> 16).count_ones());
        let (encoder_index, limited) = half(risen(3));
        let (stepgen_index, encoder_probe) = half(risen(4));
        let (stepgen_probe, illegal) = half(risen(5));
        self.add("gpio: debounced changes", (status[2] ^ was[2]).count_ones());
        let high = board.status(wire::regmap::status::GPIO_IN_HIGH);
        self.add(
            "gpio: debounced changes behind the first word",
            (high ^ self.high_was).count_ones(),
        );
        self.high_was = high;
        self.add("encoder: index latches", encoder_index);
        self.add("encoder: probe latches", encoder_probe);
        self.add("encoder: illegal transitions", illegal);
        self.add("stepgen: index latches", stepgen_index);
        self.add("stepgen: probe latches", stepgen_probe);
        self.add("stepgen: channels that had to wait", limited);
        self.add("gpio: e-stops latched", risen(6).count_ones());
        self.add("timebase: samples", u32::from(status[0] != was[0]));
        self.status_was = status;
        let bites = board.peek(pages::WATCHDOG, 7);
        self.add("watchdog: bites", bites.wrapping_sub(self.bites));
        self.bites = bites;
        let why = board.peek(pages::WATCHDOG, 8);
        let reason = match why {
            1 => "watchdog: looks after a bite",
            2 => "watchdog: looks after an external reset",
            3 => "watchdog: looks after the stop key",
            4 => "watchdog: looks after a soft stop",
            5 => "watchdog: looks after an e-stop",
            6 => "watchdog: looks after a system reset",
            _ => "watchdog: looks before the first opening",
        };
        self.add(reason, 1);
        self.add(
            "timebase: timed commits seen waiting",
            board.peek(pages::TIMEBASE, 8),
        );
        self.add(
            "guard: looks while it is closed",
            board.peek(pages::TIMEBASE, timebase::GUARD_STATUS as u32),
        );
    }
}

/// The least number of each event per million clocks; with fewer the run proves nothing about it.
pub const LEAST_PER_MILLION: &[(&str, u64)] = &[
    ("stepgen: edges of STEP", 10_000),
    ("stepgen: edges of DIR", 2_000),
    ("stepgen: index latches", 20),
    ("stepgen: probe latches", 20),
    ("stepgen: channels that had to wait", 50),
    ("encoder: index latches", 20),
    ("encoder: probe latches", 20),
    ("encoder: illegal transitions", 50),
    ("pwm: edges", 5_000),
    ("pwm: edges of the second pin", 2_000),
    ("gpio: edges of outputs", 500),
    ("gpio: edges of outputs behind the first word", 50),
    ("gpio: debounced changes", 100),
    ("gpio: debounced changes behind the first word", 20),
    ("pads: clocks with a short", 100_000),
    ("timebase: samples", 200),
    ("timebase: timed commits seen waiting", 5),
    ("watchdog: openings", 10),
    ("watchdog: bites", 3),
    ("fast path: words staged", 2_000),
    ("fast path: commands committed", 40),
    ("fast path: commands committed at their time", 20),
    ("fast path: commands only answered", 20),
    ("rx_admission: frames refused", 20),
];
