//! Looks a job through before anything moves: is every place within the limits, was every axis found, how long does it take.
//!
//! The time is nominal: lengths by speeds, nothing for speeding up and slowing down. Progress is the part of it that is done, so
//! it is by the path's time and not by lines; what is missing in it is made up for by how long the part that is done has taken.

use motion::circle::Chords;
use motion::instruction::{Arc, Feed, Instruction, Place};
use motion::segment::AXES;
use wire::jobs::{End, Machine};

/// Chords looked at in a call.
const CHORDS: usize = 16;

/// What is wrong with a job.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Trouble {
    /// [`End::Limits`] or [`End::NotHomed`].
    pub end: End,
    /// Of which axis.
    pub axis: u8,
    /// In which line.
    pub line: u32,
}

/// A job looked at.
#[derive(Debug)]
pub struct Check {
    at: Place,
    homed: [bool; AXES],
    line: u32,
    chords: Option<Chords>,
    /// Nominal time so far, in microseconds.
    pub micros: u64,
}

impl Check {
    /// From the beginning, with these axes where they are known to be.
    pub fn new(homed: [bool; AXES]) -> Self {
        Check {
            at: [0; AXES],
            homed,
            line: 0,
            chords: None,
            micros: 0,
        }
    }

    /// There is still something of the last instruction to look at: [`Check::go_on`].
    pub fn busy(&self) -> bool {
        self.chords.is_some()
    }

    /// The next instruction.
    pub fn instruction(
        &mut self,
        instruction: &Instruction,
        line: u32,
        machine: &Machine,
    ) -> Result<(), Trouble> {
        self.line = line;
        self.micros += nominal(&self.at, instruction, machine);
        match *instruction {
            Instruction::Line { to, .. } => {
                self.moves(&to, machine)?;
                self.at = to;
            }
            Instruction::Arc(arc) => {
                self.moves(&arc.to, machine)?;
                let chords = Chords::new(self.at, arc, machine.chord_tolerance);
                if !contains(&arc, chords.radius(), machine) {
                    self.chords = Some(chords);
                }
                self.at = arc.to;
            }
            Instruction::Home { axes } => {
                for (axis, found) in axes.iter().enumerate().filter(|(_, found)| **found) {
                    if let (Some(at), Some(homed)) =
                        (self.at.get_mut(axis), self.homed.get_mut(axis))
                    {
                        (*at, *homed) = (0, *found);
                    }
                    if machine
                        .axes
                        .get(axis)
                        .is_some_and(|axis| axis.home.is_none())
                    {
                        return Err(self.trouble(End::NoSwitch, axis));
                    }
                }
            }
            Instruction::Dwell { .. }
            | Instruction::Aux { .. }
            | Instruction::Pause
            | Instruction::End => {}
        }
        Ok(())
    }

    /// Some more of the chords of an arc.
    pub fn go_on(&mut self, machine: &Machine) -> Result<(), Trouble> {
        for _ in 0..CHORDS {
            match self.chords.as_mut().and_then(Iterator::next) {
                Some(place) => self.within(&place, machine)?,
                None => self.chords = None,
            }
        }
        Ok(())
    }

    /// Every axis has been found before the first line, and the line ends within the limits.
    fn moves(&self, to: &Place, machine: &Machine) -> Result<(), Trouble> {
        match self.homed.iter().position(|homed| !homed) {
            Some(axis) => Err(self.trouble(End::NotHomed, axis)),
            None => self.within(to, machine),
        }
    }

    fn within(&self, place: &Place, machine: &Machine) -> Result<(), Trouble> {
        let mut axes = machine.axes.iter().zip(place);
        match axes.position(|(axis, nm)| *nm < axis.lowest || *nm > axis.highest) {
            Some(axis) => Err(self.trouble(End::Limits, axis)),
            None => Ok(()),
        }
    }

    fn trouble(&self, end: End, axis: usize) -> Trouble {
        Trouble {
            end,
            axis: axis as u8,
            line: self.line,
        }
    }
}

/// The whole circle lies within the limits, so no part of it can be outside. (Where it begins and ends was asked before.)
fn contains(arc: &Arc, radius: i64, machine: &Machine) -> bool {
    let inside = |(axis, center): (&wire::jobs::Axis, &i64)| {
        center - radius >= axis.lowest && center + radius <= axis.highest
    };
    machine.axes.iter().zip(&arc.center).all(inside)
}

/// How long an instruction takes that begins there, in microseconds, if nothing had to be sped up.
pub fn nominal(from: &Place, instruction: &Instruction, machine: &Machine) -> u64 {
    let along = |length_nm: u64, to: &Place, feed: Feed| {
        let fed = match feed {
            Feed::Rapid => 0,
            Feed::Rate(rate) => micros(length_nm, rate),
        };
        let slowest = machine.axes.iter().zip(from.iter().zip(to));
        let slowest = slowest.map(|(axis, (from, to))| micros(to.abs_diff(*from), axis.max_speed));
        slowest.fold(fed, u64::max)
    };
    match *instruction {
        Instruction::Line { to, feed } => along(distance(from, &to), &to, feed),
        Instruction::Arc(arc) => {
            let length = Chords::new(*from, arc, machine.chord_tolerance).length();
            let top = |axis: usize| machine.axes.get(axis).map_or(1, |axis| axis.max_speed);
            let round = micros(length, top(0).min(top(1)));
            along(length, &arc.to, arc.feed).max(round)
        }
        Instruction::Dwell { micros } => micros,
        Instruction::Aux { .. } => machine.tool_delay.into(),
        Instruction::Home { .. } | Instruction::Pause | Instruction::End => 0,
    }
}

fn micros(nm: u64, speed: u32) -> u64 {
    // 2^34 nm by 2^20: both fit.
    nm.saturating_mul(1_000_000) / u64::from(speed.max(1))
}

/// In nm; rounded to 32 of them, so that squares fit.
fn distance(from: &Place, to: &Place) -> u64 {
    let parts = from
        .iter()
        .zip(to)
        .map(|(from, to)| to.abs_diff(*from) >> 5);
    // 2^30 each at most.
    let square: u64 = parts.map(|part| part * part).sum();
    square.isqrt() << 5
}
