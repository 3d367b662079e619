//! Checks a whole job before it moves anything: the limits, the homed axes, and how long it takes.
//!
//! The time is nominal: lengths divided by speeds, without accelerations. Progress is the part of
//! this time that is done, so it follows the path's time and not the lines. The remaining time is
//! corrected by the time that the finished part has really taken.

use crate::circle::Chords;
use crate::instruction::{Arc, Feed, Instruction, Place};
use motion::segment::AXES;
use wire::jobs::{End, MachineConfig};

/// Chords checked in a call.
const CHORDS: usize = 16;

/// An error in a job.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Trouble {
    /// [`End::Limits`] or [`End::NotHomed`].
    pub end: End,
    /// The axis.
    pub axis: u8,
    /// The line.
    pub line: u32,
}

/// The check of a job.
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
    /// From the beginning of a job, with these axes homed.
    pub fn new(homed: [bool; AXES]) -> Self {
        Check {
            at: [0; AXES],
            homed,
            line: 0,
            chords: None,
            micros: 0,
        }
    }

    /// A part of the last instruction is still to be checked: [`Check::go_on`].
    pub fn busy(&self) -> bool {
        self.chords.is_some()
    }

    /// The next instruction.
    pub fn instruction(
        &mut self,
        instruction: &Instruction,
        line: u32,
        machine: &MachineConfig,
    ) -> Result<(), Trouble> {
        self.line = line;
        let micros = nominal(&self.at, instruction, machine);
        self.micros = self.micros.saturating_add(micros);
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

    /// Checks some more chords of an arc.
    pub fn go_on(&mut self, machine: &MachineConfig) -> Result<(), Trouble> {
        for _ in 0..CHORDS {
            match self.chords.as_mut().and_then(Iterator::next) {
                Some(place) => self.within(&place, machine)?,
                None => self.chords = None,
            }
        }
        Ok(())
    }

    /// Are all axes homed before the first line, and does this line end within the limits?
    fn moves(&self, to: &Place, machine: &MachineConfig) -> Result<(), Trouble> {
        match self.homed.iter().position(|homed| !homed) {
            Some(axis) => Err(self.trouble(End::NotHomed, axis)),
            None => self.within(to, machine),
        }
    }

    fn within(&self, place: &Place, machine: &MachineConfig) -> Result<(), Trouble> {
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

/// Is the whole circle within the limits? Then every part of it is. (Its start and end were checked
/// before.)
fn contains(arc: &Arc, radius: i64, machine: &MachineConfig) -> bool {
    let inside = |(axis, center): (&wire::jobs::Axis, &i64)| {
        center - radius >= axis.lowest && center + radius <= axis.highest
    };
    machine.axes.iter().zip(&arc.center).all(inside)
}

/// The nominal time of an instruction that begins at `from`, in microseconds, without
/// accelerations.
pub fn nominal(from: &Place, instruction: &Instruction, machine: &MachineConfig) -> u64 {
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
