//! Executes commands of clients: decides which command is allowed in which phase, and what it
//! changes.

use super::Executor;
use super::order::{Order, Starter, Work, asked};
use super::phase::{Hold, Phase};
use super::setup::limits;
use crate::check::Check;
use crate::inside::Look;
use crate::instruction::Instruction;
use crate::plan::Output;
use crate::store::Store;
use crate::words::Words;
use crate::{Outside, fpgag};
use motion::segment::AXES;
use wire::Name;
use wire::jobs::{self, End, JobCommand, Status};

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
        let command = JobCommand::from_code(code).ok_or(Status::UnknownCode)?;
        let clock_hz = self.board.clock_hz;
        let starter = || Starter::new(client, (flags, keepalive), clock_hz, now);
        match command {
            JobCommand::Welcome => {}
            JobCommand::Stop => self.stop(End::Stopped, out),
            JobCommand::Continue | JobCommand::Unpause => self.hold(false, out)?,
            JobCommand::Pause => self.hold(true, out)?,
            JobCommand::Start => {
                let job = store.get(name)?;
                let starter = starter()?;
                self.may_begin(out)?;
                self.begin(Order::new(starter, Work::Job(job), *name), Phase::Check);
                self.path.program.job(store, job);
                self.check = Check::new(self.known.homed);
            }
            JobCommand::Calibrate => {
                let starter = starter()?;
                let axes = self.asked(flags, Status::NoSwitch, |axis| axis.home.is_some())?;
                self.may_begin(out)?;
                let order = Order::new(starter, Work::Homing, Name::EMPTY);
                self.begin(order, Phase::Open(0));
                self.path.program.only(Instruction::Home { axes });
            }
            JobCommand::Here => {
                let axes = self.asked(flags, Status::HasSwitch, |axis| axis.home.is_none())?;
                self.may_begin(out)?;
                self.here(axes, out)?;
            }
        }
        Ok(())
    }

    /// The axes a command names, or all that are fit for it.
    fn asked(
        &self,
        flags: u8,
        refusal: Status,
        fit: impl Fn(&jobs::Axis) -> bool,
    ) -> Result<[bool; AXES], Status> {
        let machine = self.machine.as_ref().ok_or(Status::NoMachine)?;
        asked(flags, machine.axes.each_ref().map(fit), refusal)
    }

    /// Declares that these axes are at 0.
    fn here(&mut self, axes: [bool; AXES], out: &mut impl Outside) -> Result<(), Status> {
        let look = self.board.inside.look(out);
        let Look {
            state, positions, ..
        } = look.ok_or(Status::NotNow)?;
        if state.enabled {
            // The axis may still be on its way to rest.
            return Err(Status::NotNow);
        }
        self.known.at(positions);
        let chosen = positions.into_iter().zip(axes).enumerate();
        for (axis, (position, _)) in chosen.filter(|(_, (_, chosen))| *chosen) {
            self.known.zero(axis, position);
        }
        self.path.settle(self.known.places());
        Ok(())
    }

    fn may_begin(&mut self, out: &mut impl Outside) -> Result<(), Status> {
        if self.busy() {
            Err(Status::NotNow)
        } else if self.machine.is_none() {
            Err(Status::NoMachine)
        } else if self.board.inside.owned(out) {
            Err(Status::Owned)
        } else {
            self.look_for_cuts(out);
            Ok(())
        }
    }

    fn begin(&mut self, order: Order, phase: Phase) {
        self.order = order;
        self.phase = phase;
        self.outcome.begin();
        self.reached.clear();
        if let Some(machine) = &self.machine {
            self.path.clear(machine, self.board.clock_hz);
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
        let command = fpgag::FpgagCommand::from_code(command).ok_or(Status::UnknownCode)?;
        if self.busy() && !self.order.streams() {
            // Whatever moves, a client that says stop means it.
            if command == fpgag::FpgagCommand::Stop {
                self.stop(End::Stopped, out);
                return Ok(0);
            }
            return Err(Status::NotNow);
        }
        let machine = self.machine.as_ref().ok_or(Status::NoMachine)?;
        match command {
            fpgag::FpgagCommand::Empty => Ok(0),
            fpgag::FpgagCommand::Status => Ok(self.words.as_ref().map_or(0, Words::status)),
            fpgag::FpgagCommand::Stop => {
                if let Some(words) = &mut self.words {
                    words.executes = false;
                }
                Ok(0)
            }
            fpgag::FpgagCommand::Gcode => {
                let limits = limits(machine, &self.path.limits(), self.board.clock_hz);
                let opens = matches!(self.phase, Phase::Open(_));
                if self.words.is_none() && (opens || !self.busy()) {
                    // Right behind START the board is being armed: the axes are where they were.
                    if !opens {
                        let look = self.board.inside.look(out);
                        self.known.at(look.ok_or(Status::NotNow)?.positions);
                    }
                    self.words = Some(Words::new(limits, self.known.places()));
                }
                let queue = self.words.as_mut().ok_or(Status::NotNow)?;
                // The machine may have been changed since the first words came.
                queue.set_limits(limits);
                Ok(queue.gcode(client, form, words.iter()))
            }
            fpgag::FpgagCommand::Start => {
                if let (true, Some(words)) = (self.busy(), &mut self.words) {
                    words.executes = true;
                    return Ok(0);
                }
                self.look_for_cuts(out);
                if !self.known.all_homed() {
                    return Err(Status::NotNow);
                }
                let clock_hz = self.board.clock_hz;
                let starter = Starter::new(client, (0, WORDS_KEEPALIVE_MS), clock_hz, now)?;
                self.may_begin(out)?;
                let order = Order::new(starter, Work::Words, Name::EMPTY);
                self.begin(order, Phase::Open(0));
                Ok(0)
            }
        }
    }

    /// Pause, or continue.
    fn hold(&mut self, pause: bool, out: &mut impl Outside) -> Result<(), Status> {
        match (self.phase.hold(self.order.homes()), pause) {
            (Hold::Path, _) => {
                let paused = core::mem::replace(&mut self.order.paused, pause);
                if pause || paused {
                    self.board.core.pass(!pause, out);
                }
            }
            (Hold::Waits, true) => {}
            (Hold::Waits, false) => self.phase = Phase::Play,
            (Hold::Ends, true) => self.stop(End::Stopped, out),
            (Hold::Ends, false) | (Hold::Refused, _) => return Err(Status::NotNow),
        }
        Ok(())
    }

    /// Ends the current work, along the path.
    pub(super) fn stop(&mut self, why: End, out: &mut impl Outside) {
        let Some(next) = self.phase.stopped() else {
            return;
        };
        if next == Phase::Idle {
            return self.over(why);
        }
        if self.phase == Phase::Lift {
            // The program must not begin after the switches were found.
            self.path.waiting = Some(Output::End);
        }
        if next == Phase::Brake {
            self.board.core.pass(false, out);
        }
        self.outcome.ending = why;
        self.phase = next;
    }
}
