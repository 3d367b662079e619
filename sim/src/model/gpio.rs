//! `gpio.sv`: inputs with their debouncer, e-stop inputs, and outputs with the gate.

use crate::model::lowest;

/// Pins the debouncer visits in turn.
const PINS: usize = wire::channels::WORD_PINS as usize;

/// A word of inputs and outputs.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Gpio {
    estop_mask: u32,
    estop_level: u32,
    inputs: u32,
    outputs: u32,
    meta: u32,
    raw: u32,
    level: u32,
    pin: usize,
    limits: [u16; PINS],
    lefts: [u16; PINS],
    estop: bool,
    estop_latched: u32,
    held: u32,
    live: bool,
    out: u32,
}

/// Its inputs in a clock.
#[derive(Clone, Copy, Debug, Default)]
pub struct Input {
    /// Outputs are live.
    pub gate: bool,
    /// Take `value`.
    pub commit: bool,
    /// Levels of the outputs.
    pub value: u32,
    /// Levels while the gate is closed.
    pub safe: u32,
    /// Polarity at the pins.
    pub invert: u32,
    /// The input pins.
    pub pins: u32,
    /// A debounce limit is written: pin, visits.
    pub limit: Option<(usize, u16)>,
    /// Forget e-stop inputs that are released.
    pub clear: bool,
    /// Outputs that follow a job instead of what was committed.
    pub job_mask: u32,
    /// What it has them carry.
    pub job_value: u32,
}

impl Gpio {
    /// So many pins, of which the inputs in `estop_mask` stop at their bit of `estop_level`.
    pub fn new(inputs: u8, outputs: u8, estop_mask: u32, estop_level: u32) -> Self {
        // No pins at all are one in the gateware.
        let [inputs, outputs] = [inputs, outputs].map(|count| lowest(count.max(1)) as u32);
        let released = estop_mask & !estop_level & inputs;
        Gpio {
            estop_mask,
            estop_level,
            inputs,
            outputs,
            meta: released,
            raw: released,
            level: 0,
            pin: 0,
            limits: [0; PINS],
            lefts: [0; PINS],
            estop: false,
            estop_latched: 0,
            held: 0,
            live: false,
            out: 0,
        }
    }

    /// Debounced inputs.
    pub fn level(&self) -> u32 {
        self.level
    }

    /// Synchronised inputs.
    pub fn raw(&self) -> u32 {
        self.raw
    }

    /// An e-stop input is active.
    pub fn estop(&self) -> bool {
        self.estop
    }

    /// E-stop inputs that have been active.
    pub fn estop_latched(&self) -> u32 {
        self.estop_latched
    }

    /// Output pins.
    pub fn out(&self) -> u32 {
        self.out
    }

    fn active(&self) -> u32 {
        (self.raw ^ !self.estop_level) & self.estop_mask
    }

    fn next_out(&self, i: &Input) -> u32 {
        let level = if i.gate && self.live {
            self.held & !i.job_mask | i.job_value & i.job_mask
        } else {
            i.safe
        };
        (level ^ i.invert) & self.outputs
    }

    /// One rising edge.
    pub fn clock(&mut self, i: &Input) {
        let active = self.active();
        self.estop = active != 0;
        self.estop_latched = active | if i.clear { 0 } else { self.estop_latched };
        let pin = self.pin;
        let differing = (self.raw ^ self.level) >> pin & 1 != 0;
        let believed = differing && self.lefts[pin] == 0;
        self.lefts[pin] = if differing && !believed {
            self.lefts[pin] - 1
        } else {
            self.limits[pin]
        };
        self.level ^= u32::from(believed) << pin;
        if let Some((pin, limit)) = i.limit {
            self.limits[pin] = limit;
        }
        self.raw = self.meta;
        self.meta = i.pins & self.inputs;
        self.pin = (pin + 1) % PINS;

        self.out = self.next_out(i);
        if i.commit {
            self.held = i.value & self.outputs;
        }
        self.live = i.gate && (self.live || i.commit);
    }

    /// Clocks in which nothing visible changes.
    pub fn quiet(&self, i: &Input) -> u64 {
        let still = self.meta == i.pins & self.inputs
            && self.raw == self.meta
            && self.estop == (self.active() != 0)
            && self.estop_latched & self.active() == self.active()
            && self.out == self.next_out(i)
            && (i.gate || !self.live);
        let differs = self.raw ^ self.level;
        match (still, differs) {
            (false, _) => 0,
            (true, 0) => u64::MAX,
            (true, _) => u64::from(differs.rotate_right(self.pin as u32).trailing_zeros()),
        }
    }

    /// That many quiet clocks at once.
    pub fn skip(&mut self, clocks: u64) {
        for n in 0..clocks.min(PINS as u64) as usize {
            let pin = (self.pin + n) % PINS;
            self.lefts[pin] = self.limits[pin];
        }
        self.pin = (self.pin + (clocks % PINS as u64) as usize) % PINS;
    }
}
