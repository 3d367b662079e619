//! Everything at a board's pins: the check of its edges, the plant, and a log of its other outputs.
//!
//! The Verilated board and the twin both use it: the code that makes time pass calls
//! [`PinEnvironment::observe`] after each sys clock in which an output changed or
//! [`PinEnvironment::next`] has come.

use crate::edges::EdgeWatch;
use crate::plant::Plant;
use crate::soc::Pins;

/// A watched output.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Output {
    /// The output gate.
    Gate,
    /// The status LED.
    Led,
    /// General output n.
    Gpio(u8),
    /// PWM output n.
    Pwm(u8),
}

/// An output changed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PinEvent {
    /// Sys clock.
    pub clock: u64,
    /// Which.
    pub output: Output,
    /// Its new level.
    pub level: bool,
}

/// Which outputs leave [`PinEvent`]s.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PinWatch {
    /// The gate (on by default: it rarely changes and is always important).
    pub gate: bool,
    /// The LED.
    pub led: bool,
    /// General outputs.
    pub gpio: u64,
    /// PWM outputs.
    pub pwm: u16,
}

impl Default for PinWatch {
    fn default() -> Self {
        PinWatch {
            gate: true,
            led: false,
            gpio: 0,
            pwm: 0,
        }
    }
}

/// The last whole cycle of a PWM output, in sys clocks.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PwmCycle {
    /// Clock of the last rising edge.
    pub last_rise: Option<u64>,
    /// High time of the last cycle.
    pub high: Option<u64>,
    /// Rise to rise of the last cycle.
    pub period: Option<u64>,
}

/// The pins and everything wired to them.
#[derive(Debug)]
pub struct PinEnvironment {
    /// The pins as they stand; the environment sets the inputs.
    pub(crate) pins: Pins,
    seen: Pins,
    /// STEP/DIR pins.
    pub edges: EdgeWatch,
    /// What is wired to the board. Change it freely; [`Self::settle`] puts its levels on the pins
    /// at once.
    pub plant: Plant,
    /// Which other outputs to log.
    pub watch: PinWatch,
    events: Vec<PinEvent>,
    pwm: [PwmCycle; 16],
    gpio_in: u64,
}

impl PinEnvironment {
    /// A plant at pins that are all low, on a board of this clock.
    pub fn new(mut plant: Plant, sys_hz: u64) -> Self {
        plant.set_clock(sys_hz);
        let mut environment = PinEnvironment {
            pins: Pins::default(),
            seen: Pins::default(),
            edges: EdgeWatch::default(),
            plant,
            watch: PinWatch::default(),
            events: Vec::new(),
            pwm: Default::default(),
            gpio_in: 0,
        };
        environment.settle();
        environment
    }

    /// All pins as they stand.
    pub fn pins(&self) -> &Pins {
        &self.pins
    }

    /// Drive the external reset pin.
    pub fn ext_reset(&mut self, high: bool) {
        self.pins.ext_reset = high.into();
    }

    /// Drive the factory pin: the button or jumper that makes a board forget its settings while it
    /// is held at start.
    pub fn factory(&mut self, active: bool) {
        self.pins.factory = active.into();
    }

    /// What the PHY says of its link, as [`crate::soc::LINK_1000`]; 0 is down.
    pub fn link(&mut self, status: u8) {
        self.pins.link_status = status;
    }

    /// What is wrong with the driven pads from now on.
    pub fn pads(&mut self, fault: crate::pads::Fault) {
        fault.put(&mut self.pins);
    }

    /// Drive the general inputs that the plant does not.
    pub fn gpio_in(&mut self, levels: u64) {
        self.gpio_in = levels;
        self.settle();
    }

    /// Put the plant's levels on the pins (after changing the plant by hand).
    pub fn settle(&mut self) {
        let levels = self.plant.levels();
        let mask = self.plant.gpio_mask();
        self.pins.enc_a = levels.a;
        self.pins.enc_b = levels.b;
        self.pins.enc_i = levels.index;
        self.pins.step_index = levels.step_index;
        self.pins.gpio_in = (self.gpio_in & !mask) | (levels.gpio & mask);
    }

    /// A setting has changed the polarity of the step pins: takes the new levels without counting.
    pub(crate) fn look_again(&mut self) {
        let p = &self.pins;
        self.edges.adopt(p.step, p.dir);
        (self.seen.step, self.seen.dir) = (p.step, p.dir);
    }

    /// Changes of watched outputs since the last call.
    pub fn take_events(&mut self) -> Vec<PinEvent> {
        std::mem::take(&mut self.events)
    }

    /// The last cycle of a PWM output.
    pub fn pwm_cycle(&self, n: usize) -> PwmCycle {
        self.pwm[n]
    }

    /// The next sys clock after which [`Self::observe`] must be called even if no output changes.
    #[inline]
    pub fn next(&self) -> u64 {
        self.plant.next()
    }

    /// The sys clock `clock` has passed, the pins are as they are after it.
    #[inline]
    pub fn observe(&mut self, clock: u64) {
        let (p, s) = (&self.pins, &self.seen);
        if (p.step, p.dir, p.gate) != (s.step, s.dir, s.gate) {
            let (forward, backward) = self.edges.change(clock, p.step, p.dir, p.gate != 0);
            let jumpers = self.plant.motion(p.step, p.dir);
            if forward | backward != 0 {
                self.plant.steps(forward, backward);
            }
            if jumpers || forward | backward != 0 {
                self.settle();
            }
        }
        let (p, s) = (&self.pins, &self.seen);
        if (p.gpio_out, p.pwm_out, p.pwm_dir, p.led, p.gate)
            != (s.gpio_out, s.pwm_out, s.pwm_dir, s.led, s.gate)
        {
            self.outputs_changed(clock);
        }
        self.seen = self.pins;
        if clock >= self.plant.next() && self.plant.turn(clock) {
            self.settle();
        }
    }

    #[cold]
    fn outputs_changed(&mut self, clock: u64) {
        let watch = self.watch;
        let (pins, seen) = (self.pins, self.seen);
        let mut log = |output, level| {
            self.events.push(PinEvent {
                clock,
                output,
                level,
            })
        };
        if watch.gate && pins.gate != seen.gate {
            log(Output::Gate, pins.gate != 0);
        }
        if watch.led && pins.led != seen.led {
            log(Output::Led, pins.led != 0);
        }
        let gpio = pins.gpio_out ^ seen.gpio_out;
        for n in bits(gpio & watch.gpio) {
            log(Output::Gpio(n), pins.gpio_out >> n & 1 != 0);
        }
        let pwm = pins.pwm_out ^ seen.pwm_out;
        for n in bits(u64::from(pwm)) {
            let high = pins.pwm_out >> n & 1 != 0;
            if watch.pwm >> n & 1 != 0 {
                log(Output::Pwm(n), high);
            }
            let cycle = &mut self.pwm[usize::from(n)];
            if high {
                cycle.period = cycle.last_rise.map(|t| clock - t);
                cycle.last_rise = Some(clock);
            } else {
                cycle.high = cycle.last_rise.map(|t| clock - t);
            }
        }
        if (pins.pwm_out, pins.pwm_dir) != (seen.pwm_out, seen.pwm_dir) {
            self.plant.pwm(clock, pins.pwm_out, pins.pwm_dir);
            self.settle();
        }
        if gpio != 0 {
            self.plant.outputs(pins.gpio_out);
            self.settle();
        }
    }
}

fn bits(mut word: u64) -> impl Iterator<Item = u8> {
    std::iter::from_fn(move || {
        let n = word.trailing_zeros();
        (n < 64).then(|| {
            word &= word - 1;
            n as u8
        })
    })
}
