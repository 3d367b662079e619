//! What clients ask for: which command is taken in which phase, and what it changes.

use super::setup::{limits, setup};
use super::{Executor, Phase, Starter};
use crate::check::Check;
use crate::instruction::Instruction;
use crate::plan::{Output, Planner};
use crate::store::Store;
use crate::words::Words;
use crate::{Outside, fpgag};
use motion::segment::AXES;
use wire::Name;
use wire::jobs::{self, Command, End, KEEPALIVE_MS, Status, UNATTENDED};

/// 5 s: a client that sends words sends the next ones long before that.
const WORDS_KEEPALIVE_MS: u16 = 5000;

impl Executor {
    /// Executes one of XYPenPlotter's commands.
    pub fn command(
        &mut self,
        (code, flags, keepalive): (u8, u8, u16),
        name: &Name,
        client: u32,
        store: &Store,
        now: u64,
        out: &mut impl Outside,
    ) -> Result<(), Status> {
        let command = Command::from_code(code).ok_or(Status::UnknownCode)?;
        match command {
            Command::Welcome => Ok(()),
            Command::Stop => {
                self.stop(End::Stopped, out);
                Ok(())
            }
            Command::Continue | Command::Unpause => self.go_on(out),
            Command::Pause => self.pause(out),
            Command::Start => {
                let job = store.get(name)?;
                let starter = self.starter(client, flags, keepalive, now)?;
                self.may_begin(out)?;
                let homed = self.homed;
                self.begin(starter, Phase::Check);
                self.program.job(store, job);
                (self.job, self.name, self.calibrates) = (Some(job), *name, false);
                self.check = Check::new(homed);
                Ok(())
            }
            Command::Calibrate => {
                let starter = self.starter(client, flags, keepalive, now)?;
                let axes = self.asked(flags, Status::NoSwitch, |axis| axis.home.is_some())?;
                self.may_begin(out)?;
                self.begin(starter, Phase::Open(0));
                self.program.only(Instruction::Home { axes });
                (self.job, self.name, self.calibrates) = (None, Name::EMPTY, true);
                Ok(())
            }
            Command::Here => {
                let axes = self.asked(flags, Status::HasSwitch, |axis| axis.home.is_none())?;
                self.may_begin(out)?;
                self.here(axes, out)
            }
        }
    }

    /// Declares that these axes are at 0.
    fn here(&mut self, axes: [bool; AXES], out: &mut impl Outside) -> Result<(), Status> {
        let (state, positions) = self.inside.look(out).ok_or(Status::NotNow)?;
        if state.enabled {
            // The axis may still be on its way to rest.
            return Err(Status::NotNow);
        }
        self.positions = positions;
        let chosen = axes.into_iter().enumerate().filter(|(_, chosen)| *chosen);
        for (axis, _) in chosen {
            if let Some(position) = positions.get(axis) {
                self.zero(axis, *position);
            }
        }
        self.settle();
        Ok(())
    }

    fn starter(&self, client: u32, flags: u8, keepalive: u16, now: u64) -> Result<Starter, Status> {
        let attended = flags & UNATTENDED == 0;
        if attended && !KEEPALIVE_MS.contains(&keepalive) {
            return Err(Status::Value);
        }
        let per_ms = u64::from(self.clock_hz / 1000);
        Ok(Starter {
            client,
            patience: attended.then_some(u64::from(keepalive) * per_ms),
            heard: now,
        })
    }

    /// The axes a command names, all of which have to be suitable; or all suitable ones if it names
    /// none.
    fn asked(
        &self,
        flags: u8,
        refusal: Status,
        fit: impl Fn(&jobs::Axis) -> bool,
    ) -> Result<[bool; AXES], Status> {
        let machine = self.machine.as_ref().ok_or(Status::NoMachine)?;
        let fit = machine.axes.each_ref().map(fit);
        let asked = flags & !UNATTENDED;
        if asked >> AXES != 0 {
            return Err(Status::Value);
        }
        let axes: [bool; AXES] = core::array::from_fn(|axis| asked >> axis & 1 == 1);
        let refused = axes.iter().zip(fit).any(|(asked, fit)| *asked && !fit);
        match (asked, refused) {
            (0, _) if fit == [false; AXES] => Err(refusal),
            (0, _) => Ok(fit),
            (_, true) => Err(refusal),
            (_, false) => Ok(axes),
        }
    }

    fn may_begin(&mut self, out: &mut impl Outside) -> Result<(), Status> {
        if self.busy() {
            Err(Status::NotNow)
        } else if self.machine.is_none() {
            Err(Status::NoMachine)
        } else if self.inside.owned(out) {
            Err(Status::Owned)
        } else {
            self.look_for_cuts(out);
            Ok(())
        }
    }

    /// FPGA G's protocol; returns the status word.
    pub fn words(
        &mut self,
        (command, form): (u8, u8),
        words: jobs::Words,
        client: u32,
        now: u64,
        out: &mut impl Outside,
    ) -> Result<u32, Status> {
        let command = fpgag::Command::from_code(command).ok_or(Status::UnknownCode)?;
        if self.busy() && !self.streams {
            // Whatever moves, a client that says stop means it.
            if command == fpgag::Command::Stop {
                self.stop(End::Stopped, out);
                return Ok(0);
            }
            return Err(Status::NotNow);
        }
        let machine = self.machine.ok_or(Status::NoMachine)?;
        match command {
            fpgag::Command::Empty => Ok(0),
            fpgag::Command::Status => Ok(self.words.as_ref().map_or(0, Words::status)),
            fpgag::Command::Stop => {
                if let Some(words) = &mut self.words {
                    words.executes = false;
                }
                Ok(0)
            }
            fpgag::Command::Gcode => {
                let limits = limits(&machine, &self.limits(), self.clock_hz);
                if !self.busy() && self.words.is_none() {
                    let (_, positions) = self.inside.look(out).ok_or(Status::NotNow)?;
                    self.positions = positions;
                    self.words = Some(Words::new(limits, self.places()));
                }
                let queue = self.words.as_mut().ok_or(Status::NotNow)?;
                // The machine may have been changed since the first words came.
                queue.set_limits(limits);
                Ok(queue.gcode(client, form, words.iter()))
            }
            fpgag::Command::Start => {
                if let (true, Some(words)) = (self.busy(), &mut self.words) {
                    words.executes = true;
                    return Ok(0);
                }
                self.look_for_cuts(out);
                if self.homed != [true; AXES] {
                    return Err(Status::NotNow);
                }
                let starter = self.starter(client, 0, WORDS_KEEPALIVE_MS, now)?;
                self.may_begin(out)?;
                self.begin(starter, Phase::Open(0));
                (self.streams, self.calibrates) = (true, false);
                (self.job, self.name) = (None, Name::EMPTY);
                Ok(0)
            }
        }
    }

    pub(super) fn begin(&mut self, starter: Starter, phase: Phase) {
        self.streams = false;
        self.starter = starter;
        self.phase = phase;
        (self.ending, self.end) = (End::Done, End::None);
        self.trouble = (0xff, None);
        (self.instruction, self.segment, self.waiting) = (None, None, None);
        (self.from, self.micros, self.total) = ([0; AXES], 0, 0);
        self.paused = false;
        self.reached.clear();
        if let Some(machine) = &self.machine
            && let Ok(mut planner) = Planner::new(&setup(machine, self.clock_hz))
        {
            planner.set_override(self.percent.into());
            self.planner = Some(planner);
        }
    }

    fn go_on(&mut self, out: &mut impl Outside) -> Result<(), Status> {
        match self.phase {
            Phase::Held => {
                self.phase = Phase::Play;
                Ok(())
            }
            Phase::Check | Phase::Open(_) | Phase::Play if !self.calibrates => {
                if core::mem::take(&mut self.paused) {
                    self.core.pass(true, out);
                }
                Ok(())
            }
            // A homing is never paused, so there is nothing to continue: it goes on as it is.
            Phase::Check
            | Phase::Open(_)
            | Phase::Play
            | Phase::Lift
            | Phase::Home
            | Phase::Idle
            | Phase::Rest
            | Phase::Brake
            | Phase::Quit
            | Phase::Close(_) => Err(Status::NotNow),
        }
    }

    fn pause(&mut self, out: &mut impl Outside) -> Result<(), Status> {
        match self.phase {
            Phase::Held => Ok(()),
            Phase::Check | Phase::Open(_) | Phase::Play if !self.calibrates => {
                self.paused = true;
                self.core.pass(false, out);
                Ok(())
            }
            // A homing is not a path that can be held: a pause ends it.
            Phase::Check | Phase::Open(_) | Phase::Play | Phase::Lift | Phase::Home => {
                self.stop(End::Stopped, out);
                Ok(())
            }
            Phase::Idle | Phase::Rest | Phase::Brake | Phase::Quit | Phase::Close(_) => {
                Err(Status::NotNow)
            }
        }
    }

    /// Ends the current work, along the path.
    pub(super) fn stop(&mut self, why: End, out: &mut impl Outside) {
        match self.phase {
            Phase::Idle | Phase::Brake | Phase::Quit | Phase::Rest | Phase::Close(_) => return,
            Phase::Check | Phase::Open(0) => self.phase = Phase::Idle,
            Phase::Open(_) | Phase::Held => self.phase = Phase::Close(0),
            Phase::Play | Phase::Lift => {
                if self.phase == Phase::Lift {
                    // What the program does behind the switches is not to begin.
                    self.waiting = Some(Output::End);
                }
                self.core.pass(false, out);
                self.phase = Phase::Brake;
            }
            Phase::Home => {
                self.velocities = self.rest();
                self.phase = Phase::Rest;
            }
        }
        self.ending = why;
        if self.phase == Phase::Idle {
            self.over(why);
        }
    }
}
