//! Executes jobs, and decides how they end.
//!
//! ```text
//! Idle --start--> Check --fits--> Open --armed--> Play --the program ends--> Close --> Idle
//! Idle --home-------------------> Open
//!                                 Play --M0--> Held --continue--> Play
//!                                 Play --G28--> Lift --> Home --found--> Play
//!                                                        Home --stop, pause--> Rest --> Close
//!                                 Play --stop, host lost--> Brake --> Quit --> Close
//!                          what is armed --the gate closes--> Quit --> Close
//! ```
//!
//! A pause is no phase: the core holds the time of the path.
//!
//! | what happens | the axes | the end | afterwards |
//! |---|---|---|---|
//! | the program ends | stand on whole steps | done | position known |
//! | stop | slow down on the path, stand | stopped | known |
//! | the client that started it is silent for too long (attended) | the same | host lost | known |
//! | no segment in time | each brakes | underrun | known |
//! | this program hangs or is not called | each brakes | watchdog | known |
//! | a stop outlasts its grace, or may have | each brakes, then pulses end | as it was | not known |
//! | e-stop, external reset | pulses end on that clock | e-stop, external reset | not known |
//! | the link goes down | nothing by itself: attended jobs end as host lost | | known |
//! | the firmware restarts | each brakes, or pulses end | the board restarted | not known |
//! | pause | slow down on the path, stand | none: continue resumes exactly there | known |
//! | pause while homing | stand | stopped | not known |
//!
//! The step generators count positions, and no command sets them. A switch that was found gives an
//! axis an offset, a whole number of steps. An unknown position becomes known again when the axis
//! finds its switch. On an axis without a switch it becomes known when a client says that the axis
//! is at 0. At power-up such an axis is at 0; after any other start it is in doubt.
//!
//! Each concern is a part. The executor decides which of them acts, and hands on what they say:
//!
//! ```text
//!   order --> check --> path ----segments--\       /--positions--> known -----\
//!       \              /   \--> reached     +--> board --reasons--> outcome --> report
//!        \--> words --/                    |
//!         \-> homing -------velocities-----/
//! ```
//!
//! | part | what it is about |
//! |---|---|
//! | `phase` | what goes on, and what a pause, a stop and an exchange mean then |
//! | `order` | what was ordered, by which client, and how long that client may be silent |
//! | `path` | the program's instructions, the planner, and the segment or output that waits |
//! | `reached` | how far the job is |
//! | `board` | the session, the segments core, and what they said last |
//! | `known` | where the axes are, and whether that is right |
//! | `outcome` | how the work ends, and why |

mod board;
mod commands;
mod known;
mod order;
mod outcome;
mod path;
mod phase;
mod reached;
mod report;
mod setup;

use self::board::Board;
use self::known::Known;
use self::order::Order;
use self::outcome::Outcome;
use self::path::Path;
use self::phase::Phase;
use self::reached::Reached;
use crate::Outside;
use crate::check::{Check, Trouble};
use crate::homing::{Homing, Next};
use crate::inside::{Inside, REST};
use crate::instruction::Instruction;
use crate::plan::Output;
use crate::program::Broken;
use crate::segments::{Core, State as CoreState, reason};
use crate::store::Store;
use crate::words::Words;
use motion::segment::AXES;
use wire::describe::Describe;
use wire::exchange::StateWord;
use wire::jobs::{End, Field, MachineConfig, Status};
use wire::{Name, ResetReason};

/// Lines the planner looks ahead; the host uses the same number when it predicts a job.
pub const LOOK_AHEAD: usize = 32;

/// 100 ms to arm: three exchanges are enough.
const ARMING: u8 = 20;
/// 250 ms to disarm: the board ends a stop with its grace.
const DISARMING: u32 = 400;

/// The executor.
#[derive(Debug)]
pub struct Executor {
    phase: Phase,
    order: Order,
    machine: Option<MachineConfig>,
    check: Check,
    path: Path,
    /// FPGA G's words, from before they are executed.
    words: Option<Words>,
    homing: Homing,
    board: Board,
    known: Known,
    reached: Reached,
    outcome: Outcome,
}

impl Executor {
    /// For this board, whose axes are where they belong though it has seen so many cuts.
    pub fn new(inside: Inside, board: &Describe, core: Core, cuts: u32) -> Self {
        let end = match board.reset_reason {
            ResetReason::PowerUp => End::None,
            ResetReason::Requested
            | ResetReason::Panic
            | ResetReason::Trap
            | ResetReason::Unknown => End::Restart,
        };
        Executor {
            phase: Phase::Idle,
            order: Order::none(),
            machine: None,
            check: Check::new([false; AXES]),
            path: Path::new(),
            words: None,
            homing: Homing::new([false; AXES], REST),
            board: Board::new(inside, board, core),
            known: Known::new(end == End::Restart, cuts),
            reached: Reached::new(),
            outcome: Outcome::new(end),
        }
    }

    /// Work is in progress.
    pub fn busy(&self) -> bool {
        self.phase != Phase::Idle
    }

    /// The board's description of itself that the executor knows.
    pub fn clock_hz(&self) -> u32 {
        self.board.clock_hz
    }

    /// The client on the board.
    pub fn inside(&mut self) -> &mut Inside {
        &mut self.board.inside
    }

    /// The machine.
    pub fn machine(&self) -> Option<&MachineConfig> {
        self.machine.as_ref()
    }

    /// This client sent a request.
    pub fn heard(&mut self, client: u32, now: u64) {
        self.order.heard(client, now);
    }

    /// Is this job being executed?
    pub fn executes(&self, store: &Store, name: &Name) -> bool {
        self.busy() && self.order.job().is_some_and(|id| store.is(id, name))
    }

    /// Sets another machine. The positions of its axes are unknown afterwards.
    pub fn set_machine(&mut self, machine: MachineConfig) -> Result<(), (Status, Field, u8)> {
        if self.busy() {
            return Err((Status::NotNow, Field::Format, 0));
        }
        let wrong = |(field, axis)| (Status::MachineConfig, field, axis);
        let (clock_hz, channels) = (self.board.clock_hz, self.board.channels);
        machine
            .check(clock_hz, channels.inputs, channels.outputs)
            .map_err(wrong)?;
        let planner = setup::planner(&machine, clock_hz).map_err(wrong)?;
        self.path.set_planner(planner);
        if self.machine != Some(machine) {
            self.known.machine(&machine);
        }
        self.machine = Some(machine);
        Ok(())
    }

    /// Sets the feed in percent.
    pub fn feed(&mut self, percent: u16) -> Result<(), Status> {
        if !(1..=200).contains(&percent) {
            return Err(Status::Value);
        }
        self.path.feed(percent);
        Ok(())
    }

    /// Does the next piece of work; false if there is none.
    pub fn poll(&mut self, store: &mut Store, now: u64, out: &mut impl Outside) -> bool {
        if self.phase == Phase::Idle {
            return false;
        }
        if self.order.silent(now) {
            self.stop(End::HostLost, out);
        }
        if let Some(per_second) = self.phase.exchanges()
            && self.board.due(now, per_second)
        {
            self.exchange(now, out);
            return true;
        }
        match self.phase {
            Phase::Check => {
                self.look_through(store);
                true
            }
            Phase::Open(done) if done < 2 => {
                self.open(done, out);
                true
            }
            Phase::Idle
            | Phase::Open(_)
            | Phase::Home
            | Phase::Rest
            | Phase::Close(_)
            | Phase::Held => false,
            Phase::Play => self.play(store, out),
            Phase::Lift => self.lift(out),
            Phase::Brake => {
                self.board.core.pass(false, out);
                let state = self.board.core.state(out);
                if state.stands() || state.idle() {
                    self.board.core.quit(out);
                    self.phase = Phase::Quit;
                    return false;
                }
                // The way to rest may be longer than what the core has.
                let has_more = self.path.segment.is_some() || self.path.waiting.is_none();
                has_more && self.play(store, out)
            }
            Phase::Quit => {
                if self.board.core.state(out).idle() {
                    self.board.core.clear(out);
                    self.phase = Phase::Close(0);
                }
                false
            }
        }
    }

    /// Checks an instruction, or some chords of it.
    fn look_through(&mut self, store: &Store) {
        let Some(machine) = &self.machine else {
            return self.over(End::Broken);
        };
        let seen = if self.check.busy() {
            self.check.go_on(machine)
        } else {
            match self.path.program.next(store) {
                Err(_) => return self.over(End::Broken),
                Ok(None) => Ok(()),
                Ok(Some((Instruction::End, _))) => {
                    self.reached.takes(self.check.micros);
                    if let Some(job) = self.order.job() {
                        self.path.program.job(store, job);
                    }
                    self.phase = Phase::Open(0);
                    return;
                }
                Ok(Some((instruction, line))) => {
                    self.check.instruction(&instruction, line, machine)
                }
            }
        };
        if let Err(Trouble { end, axis, line }) = seen {
            (self.outcome.axis, self.outcome.line) = (axis, Some(line));
            self.over(end);
        }
    }

    /// The work is over: it ended before the motion began, or the board was given back.
    fn over(&mut self, why: End) {
        if self.order.streams() {
            // What was not executed now must not be executed later.
            self.words = None;
        }
        self.outcome.over(why);
        self.phase = Phase::Idle;
    }

    /// All axes stand, and the work ends like this: gives the board back.
    fn close(&mut self, why: End) {
        self.outcome.ending = why;
        self.phase = Phase::Close(0);
    }

    /// Another client may have driven the axes.
    fn look_for_cuts(&mut self, out: &mut impl Outside) {
        if let Some(state) = self.board.inside.state(out) {
            self.known.seen(state);
        }
        self.known.counted(self.board.inside.cuts(out));
    }

    fn open(&mut self, done: u8, out: &mut impl Outside) {
        if done == 0 {
            if !self.board.inside.acquire(out) {
                return self.over(End::NotArmed);
            }
            let homed = self.known.homed;
            self.look_for_cuts(out);
            if !self.order.homes() && self.known.homed != homed {
                // While the job was looked through, which was with switches found.
                self.board.inside.release(out);
                return self.over(End::NotHomed);
            }
        } else {
            let (limits, paused) = (self.path.limits(), self.order.paused);
            let configured = match &self.machine {
                Some(machine) => self.board.configure(machine, &limits, paused, out),
                None => false,
            };
            if !configured {
                self.board.inside.release(out);
                return self.over(End::NotArmed);
            }
        }
        self.phase = Phase::Open(done + 1);
    }

    /// Exchanges with the board: feeds its watchdog if there is a reason to, and reads its state.
    fn exchange(&mut self, now: u64, out: &mut impl Outside) {
        if self.phase == Phase::Play && !self.board.goes_on(self.order.paused, out) {
            return;
        }
        let velocities = if self.phase == Phase::Home {
            self.homing.velocities
        } else {
            self.path.rest()
        };
        let answer = self.board.exchange(self.phase.gate(), &velocities, out);
        let Some(status) = answer else {
            if matches!(self.phase, Phase::Close(_)) {
                return self.closed(out);
            }
            let state = self.board.inside.state(out);
            self.board.word = state.map_or(self.board.word, StateWord::to_word);
            return self.lost(state, out);
        };
        self.known.seen(status.state);
        let mut positions = [0; AXES];
        for (place, (position, _)) in positions.iter_mut().zip(&status.stepgen) {
            *place = position.0;
        }
        self.known.at(positions);
        let opened = status.state.enabled;
        match self.phase {
            Phase::Open(_) if opened => self.opened(out),
            Phase::Open(ARMING) => self.close(End::NotArmed),
            Phase::Open(done) => self.phase = Phase::Open(done + 1),
            Phase::Close(count) if !opened || count >= DISARMING => self.closed(out),
            Phase::Close(count) => self.phase = Phase::Close(count + 1),
            _ if !opened => self.lost(Some(status.state), out),
            Phase::Home => self.home(&status, now, out),
            Phase::Rest if self.board.at_rest => self.phase = Phase::Close(0),
            Phase::Idle
            | Phase::Check
            | Phase::Play
            | Phase::Held
            | Phase::Lift
            | Phase::Rest
            | Phase::Brake
            | Phase::Quit => {}
        }
    }

    /// The board is disarmed, or out of reach.
    fn closed(&mut self, out: &mut impl Outside) {
        if self.outcome.torn {
            let state = self.board.inside.state(out);
            if state.is_some_and(|state| state.state == wire::State::Stopping) {
                // Whether pulses are cut off is known only when the axes stand, or when the grace
                // is over.
                return;
            }
            self.outcome.torn = false;
            self.explain(state);
        }
        self.board.inside.release(out);
        self.over(self.outcome.ending);
    }

    /// The board is armed.
    fn opened(&mut self, out: &mut impl Outside) {
        let (begun, _) = self.board.core.progress(out);
        self.reached.begins(begun);
        let places = self.known.places();
        self.path.settle(places);
        self.phase = Phase::Play;
        let machine = self.machine.as_ref().filter(|_| self.order.streams());
        if let Some(machine) = machine {
            let limits = setup::limits(machine, &self.path.limits(), self.board.clock_hz);
            // The axes may have been moved since the first words came, and another machine sent.
            let words = self.words.get_or_insert_with(|| Words::new(limits, places));
            if words.begin(limits, places).is_err() {
                self.close(End::Limits);
            }
        }
    }

    /// The board closed its gate, or ended the session.
    fn lost(&mut self, state: Option<StateWord>, out: &mut impl Outside) {
        let underrun = self.board.core.state(out).reason() == reason::UNDERRUN;
        self.outcome.ending = if underrun {
            End::Underrun
        } else {
            End::SessionLost
        };
        self.outcome.torn = true;
        self.explain(state);
        self.board.core.quit(out);
        self.phase = Phase::Quit;
    }

    /// Records the reason. The gateware is faster than the firmware's state machine, so this runs
    /// once more at the end.
    fn explain(&mut self, state: Option<StateWord>) {
        match state {
            Some(state) => {
                self.outcome.explain(state.reason);
                self.known.seen(state);
            }
            None => self.known.forget(),
        }
    }

    /// Plans, or fills the FIFO. False when the FIFO is full, or the next output has to wait.
    fn play(&mut self, store: &Store, out: &mut impl Outside) -> bool {
        let core = self.board.core;
        let state = core.state(out);
        if state.failed() {
            self.failed(state, out);
            return true;
        }
        if let Some(segment) = &self.path.segment {
            if !core.has_room(state) {
                if state.idle() {
                    core.start(out);
                }
                return false;
            }
            core.push(segment, out);
            self.reached.segment(self.path.number(), segment.clocks);
            self.path.segment = None;
            if self.order.streams() {
                return true;
            }
            // The next one in the same call: a turn of the ROM's loop in between takes half as long
            // as the planning.
        }
        if let Some(output) = self.path.waiting {
            if !state.idle() {
                return false;
            }
            if state.level() > 0 {
                core.start(out);
                return false;
            }
            self.path.waiting = None;
            self.arrived(output);
            return true;
        }
        if !self.order.streams() {
            let planned = match &self.machine {
                Some(machine) => self.path.plan(store, machine, &mut self.reached),
                None => Err(Broken),
            };
            if planned.is_err() {
                // The job in the store has changed: the planned part is drawn up to where it can
                // stop.
                self.outcome.ending = End::Broken;
                self.phase = Phase::Brake;
            }
            return true;
        }
        self.path.segment = self.words.as_mut().and_then(Words::poll);
        if self.path.segment.is_none() && state.idle() && state.level() > 0 {
            core.start(out);
        }
        self.path.segment.is_some()
    }

    /// The core ended by itself.
    fn failed(&mut self, state: CoreState, out: &mut impl Outside) {
        if !state.idle() {
            return;
        }
        if state.reason() == reason::UNDERRUN {
            self.board.core.clear(out);
            self.close(End::Underrun);
        } else {
            let state = self.board.inside.state(out);
            self.lost(state, out);
        }
    }

    /// All axes stand, and this output is next.
    fn arrived(&mut self, output: Output) {
        match output {
            Output::Segment(segment) => self.path.segment = Some(segment),
            Output::Pause => self.phase = Phase::Held,
            Output::End => self.phase = Phase::Close(0),
            Output::Home(axes) => {
                self.homing = Homing::new(axes, self.path.rest());
                if let Some(machine) = &self.machine {
                    self.path.lift(machine, self.board.clock_hz);
                }
                self.phase = Phase::Lift;
            }
        }
    }

    fn lift(&mut self, out: &mut impl Outside) -> bool {
        let core = self.board.core;
        let state = core.state(out);
        if state.failed() {
            self.failed(state, out);
        } else if let Some(segment) = self.path.segment.take() {
            core.push(&segment, out);
            self.reached.segment(self.path.number(), segment.clocks);
            core.start(out);
            return true;
        } else if state.idle() && state.level() == 0 {
            self.phase = Phase::Home;
        }
        false
    }

    fn home(&mut self, status: &wire::exchange::Status, now: u64, out: &mut impl Outside) {
        let Some(machine) = &self.machine else {
            return self.stop(End::Broken, out);
        };
        match self.homing.step(machine, self.board.clock_hz, status, now) {
            Next::Go => {}
            Next::Failed(why, axis) => {
                (self.outcome.axis, self.outcome.line) = (axis, None);
                self.stop(why, out);
            }
            Next::Done => {
                // Each switch's opening position becomes 0, and the axes go there.
                for (axis, found) in self.homing.found.into_iter().enumerate() {
                    if let Some(found) = found {
                        self.known.zero(axis, found);
                    }
                }
                self.path.homed(self.known.places(), &self.homing.found);
                self.phase = Phase::Play;
            }
        }
    }
}
