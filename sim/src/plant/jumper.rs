//! Wires between header pins: from an output of any kind to an input of any kind, also broken ones.
//!
//! A jumper takes the level of its output pin, polarity included, and overrides everything else at
//! its input.

use serde::Deserialize;

use super::{Levels, put};
use crate::edges::CHANNELS;

/// An end of a jumper at which a level is seen.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(try_from = "String")]
pub enum Source {
    /// The first pin of a stepgen.
    Step(usize),
    /// The second pin of a stepgen.
    Dir(usize),
    /// The first pin of a PWM.
    Pwm(usize),
    /// A general output.
    Output(usize),
    /// A pin that always stays at one level: ground, a supply, a defective driver.
    Stuck(bool),
}

/// The end of a jumper that the board reads.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(try_from = "String")]
pub enum Sink {
    /// Phase A of an encoder.
    A(usize),
    /// Phase B.
    B(usize),
    /// Its index.
    Index(usize),
    /// A general input.
    Input(usize),
}

/// A wire from an output pin to an input pin.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Jumper {
    /// `step.N`, `dir.N`, `pwm.N`, `output.N`, `low` or `high`.
    pub from: Source,
    /// `encoder.N.a`, `encoder.N.b`, `encoder.N.index` or `input.N`.
    pub to: Sink,
    /// Every n-th pulse does not arrive, as with a level near the threshold; 0: all arrive.
    #[serde(default)]
    pub misses: u64,
}

fn channel(text: &str, number: &str, most: usize) -> Result<usize, String> {
    match number.parse() {
        Ok(n) if n < most => Ok(n),
        _ => Err(format!("\"{text}\": there are {most} at most, from 0")),
    }
}

impl TryFrom<String> for Source {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        match text.split_once('.') {
            None if text == "low" => Ok(Source::Stuck(false)),
            None if text == "high" => Ok(Source::Stuck(true)),
            Some(("step", n)) => channel(&text, n, CHANNELS).map(Source::Step),
            Some(("dir", n)) => channel(&text, n, CHANNELS).map(Source::Dir),
            Some(("pwm", n)) => channel(&text, n, CHANNELS).map(Source::Pwm),
            Some(("output", n)) => channel(&text, n, 32).map(Source::Output),
            _ => Err(format!(
                "\"{text}\" is not one of step.N, dir.N, pwm.N, output.N, low, high"
            )),
        }
    }
}

impl TryFrom<String> for Sink {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        let parts: Vec<&str> = text.split('.').collect();
        match parts[..] {
            ["input", n] => channel(&text, n, 32).map(Sink::Input),
            ["encoder", n, "a"] => channel(&text, n, CHANNELS).map(Sink::A),
            ["encoder", n, "b"] => channel(&text, n, CHANNELS).map(Sink::B),
            ["encoder", n, "index"] => channel(&text, n, CHANNELS).map(Sink::Index),
            _ => Err(format!(
                "\"{text}\" is not one of encoder.N.a, encoder.N.b, encoder.N.index, input.N"
            )),
        }
    }
}

/// A jumper in its place.
#[derive(Clone, Copy, Debug)]
pub(super) struct Plugged {
    jumper: Jumper,
    source: bool,
    level: bool,
    rises: u64,
}

/// Levels of the pins that can be an output's.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Outputs {
    pub(super) step: u16,
    pub(super) dir: u16,
    pub(super) pwm: u16,
    pub(super) gpio: u64,
}

impl Plugged {
    pub(super) fn new(jumper: Jumper, pins: &Outputs) -> Self {
        let mut plugged = Plugged {
            jumper,
            source: false,
            level: false,
            rises: 0,
        };
        // A level that is there when the wire is put in is no pulse.
        plugged.source = plugged.seen(pins);
        plugged.level = plugged.source;
        plugged
    }

    fn seen(&self, pins: &Outputs) -> bool {
        match self.jumper.from {
            Source::Step(n) => pins.step >> n & 1 != 0,
            Source::Dir(n) => pins.dir >> n & 1 != 0,
            Source::Pwm(n) => pins.pwm >> n & 1 != 0,
            Source::Output(n) => pins.gpio >> n & 1 != 0,
            Source::Stuck(level) => level,
        }
    }

    /// The pins are like this now.
    pub(super) fn look(&mut self, pins: &Outputs) {
        let source = self.seen(pins);
        if source == self.source {
            return;
        }
        self.source = source;
        self.rises += u64::from(source);
        let every = self.jumper.misses;
        self.level = source && (every == 0 || !self.rises.is_multiple_of(every));
    }

    /// Puts its level on its input.
    pub(super) fn show(&self, levels: &mut Levels) {
        match self.jumper.to {
            Sink::A(n) => put(&mut levels.a, n, self.level),
            Sink::B(n) => put(&mut levels.b, n, self.level),
            Sink::Index(n) => put(&mut levels.index, n, self.level),
            Sink::Input(n) => {
                levels.gpio = levels.gpio & !(1 << n) | u64::from(self.level) << n;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::Plant;

    fn plant(text: &str) -> Plant {
        let mut plant = Plant::default();
        plant.parse(text).expect("a plant");
        plant
    }

    #[test]
    fn a_jumper_carries_the_level_of_its_pin() {
        let mut plant = plant(
            "[[jumper]]\nfrom = \"step.1\"\nto = \"encoder.2.a\"\n\
             [[jumper]]\nfrom = \"dir.1\"\nto = \"encoder.2.b\"\n\
             [[jumper]]\nfrom = \"output.3\"\nto = \"input.5\"\n\
             [[jumper]]\nfrom = \"high\"\nto = \"input.6\"",
        );
        assert_eq!(plant.gpio_mask(), 1 << 5 | 1 << 6);
        assert_eq!(plant.levels().gpio, 1 << 6);
        plant.motion(1 << 1, 1 << 1);
        plant.outputs(1 << 3);
        let levels = plant.levels();
        assert_eq!((levels.a, levels.b, levels.gpio), (4, 4, 1 << 5 | 1 << 6));
        plant.motion(0, 1 << 1);
        let levels = plant.levels();
        assert_eq!((levels.a, levels.b), (0, 4));
    }

    #[test]
    fn a_jumper_that_misses_every_third_pulse_carries_two_of_three() {
        let mut plant = plant("[[jumper]]\nfrom = \"step.0\"\nto = \"encoder.0.a\"\nmisses = 3");
        let rises = (0..9).filter(|_| {
            plant.motion(1, 0);
            let high = plant.levels().a & 1 != 0;
            plant.motion(0, 0);
            assert_eq!(plant.levels().a & 1, 0);
            high
        });
        assert_eq!(rises.count(), 6);
    }

    #[test]
    fn a_jumper_outranks_an_axis_at_its_pin() {
        let mut plant = Plant::direct(1);
        plant
            .parse("[[jumper]]\nfrom = \"low\"\nto = \"encoder.0.index\"")
            .expect("a plant");
        assert_eq!(plant.levels().index, 0);
    }

    #[test]
    fn a_jumper_between_pins_that_are_none_is_refused() {
        for (from, to) in [
            ("step.16", "input.0"),
            ("spindle.0", "input.0"),
            ("step.0", "input.32"),
            ("step.0", "encoder.0"),
        ] {
            let text = format!("[[jumper]]\nfrom = \"{from}\"\nto = \"{to}\"");
            let refused = Plant::default().parse(&text);
            assert!(refused.is_err(), "{text}");
        }
    }
}
