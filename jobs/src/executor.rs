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

mod commands;
mod known;
mod report;
mod setup;

use self::setup::{limits, setup, slew};
use crate::Outside;
use crate::check::{Check, Trouble, nominal};
use crate::homing::{Homing, Next, rest};
use crate::inside::{Inside, REST, Velocities};
use crate::instruction::{Instruction, Place};
use crate::plan::{Output, Planner, SetupError, Work};
use crate::program::Program;
use crate::progress::{Mark, Progress};
use crate::segments::{Core, State as CoreState, reason};
use crate::store::{Id, Store};
use crate::words::Words;
use motion::segment::{AXES, MIN_CLOCKS, Segment};
use wire::describe::{Channels, Describe};
use wire::exchange::StateWord;
use wire::jobs::{End, Field, MachineConfig, Status};
use wire::units::Position;
use wire::{Name, ResetReason};

/// Chords planned in a call. The first chords of an arc fill the look-ahead; all of them in one
/// call take 11 ms, in which no client is served.
const CHORDS: usize = 4;

/// Lines the planner looks ahead; the host uses the same number when it predicts a job.
pub const LOOK_AHEAD: usize = 32;

/// 5 ms: a twentieth of the watchdog's timeout.
const EXCHANGES_PER_SECOND: u64 = 200;
/// 1 ms during homing: the position error is the way in that time at the slow speed.
const LOOKS_PER_SECOND: u64 = 1000;
/// 100 ms to arm: three exchanges are enough.
const ARMING: u8 = 20;
/// 250 ms to disarm: the board ends a stop with its grace.
const DISARMING: u32 = 400;

const _: () = assert!(AXES == wire::jobs::AXES);

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Phase {
    Idle,
    /// Checks the job.
    Check,
    /// Takes the board: this many steps of that are done.
    Open(u8),
    /// Plans, and fills the FIFO.
    Play,
    /// The job waits for the operator.
    Held,
    /// Lifts the tool before homing.
    Lift,
    /// Homes the axes.
    Home,
    /// The axis that was homing comes to rest.
    Rest,
    /// Path time is slowed down to a stand.
    Brake,
    /// The core ends.
    Quit,
    /// Gives the board back: this many exchanges have been made for it.
    Close(u32),
}

/// The client that started the job, and how long it may be silent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Starter {
    client: u32,
    /// Clocks; `None` unattended.
    patience: Option<u64>,
    heard: u64,
}

/// The executor.
#[derive(Debug)]
pub struct Executor {
    inside: Inside,
    core: Core,
    clock_hz: u32,
    channels: Channels,
    phase: Phase,
    /// How the current work will end.
    ending: End,
    /// How the last work ended.
    end: End,
    trouble: (u8, Option<u32>),
    machine: Option<MachineConfig>,
    planner: Option<Planner<LOOK_AHEAD>>,
    program: Program,
    calibrates: bool,
    /// FPGA G's words, and whether they are being executed.
    words: Option<Words>,
    streams: bool,
    job: Option<Id>,
    name: Name,
    instruction: Option<(Instruction, u32)>,
    from: Place,
    /// The planner's number of the last instruction pushed, and the nominal time up to its end.
    micros: u64,
    total: u64,
    check: Check,
    segment: Option<Segment>,
    waiting: Option<Output>,
    reached: Progress,
    /// Segments begun before this job.
    base: u32,
    homing: Homing,
    velocities: Velocities,
    paused: bool,
    starter: Starter,
    percent: u16,
    offset: [i64; AXES],
    homed: [bool; AXES],
    /// Pulses may have been cut off while the axis moved, and its switch has not been found since.
    cut: [bool; AXES],
    /// The board's last answer said that no pulses were cut off since it was armed.
    trusted: bool,
    /// How often they were, as far as is known of.
    cuts: u32,
    /// Integrators at the last exchange.
    positions: [i64; AXES],
    at_rest: bool,
    /// The board ended the job.
    torn: bool,
    board: u32,
    exchanged: u64,
    /// Segments begun and clocks left at that time.
    progress: (u32, u32),
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
            inside,
            core,
            clock_hz: board.clock_hz,
            channels: board.channels,
            phase: Phase::Idle,
            ending: End::None,
            end,
            trouble: (0xff, None),
            machine: None,
            planner: None,
            program: Program::nothing(),
            calibrates: false,
            words: None,
            streams: false,
            job: None,
            name: Name::EMPTY,
            instruction: None,
            from: [0; AXES],
            micros: 0,
            total: 0,
            check: Check::new([false; AXES]),
            segment: None,
            waiting: None,
            reached: Progress::new(),
            base: 0,
            homing: Homing::new([false; AXES], REST),
            velocities: REST,
            paused: false,
            starter: Starter {
                client: 0,
                patience: None,
                heard: 0,
            },
            percent: 100,
            offset: [0; AXES],
            homed: [false; AXES],
            // The counts have started again, wherever the axes stand.
            cut: [end == End::Restart; AXES],
            trusted: false,
            cuts,
            positions: [Position::ZERO.0; AXES],
            at_rest: true,
            torn: false,
            board: 0,
            exchanged: 0,
            progress: (0, 0),
        }
    }

    /// Work is in progress.
    pub fn busy(&self) -> bool {
        self.phase != Phase::Idle
    }

    /// The board's description of itself that the executor knows.
    pub fn clock_hz(&self) -> u32 {
        self.clock_hz
    }

    /// The client on the board.
    pub fn inside(&mut self) -> &mut Inside {
        &mut self.inside
    }

    /// The machine.
    pub fn machine(&self) -> Option<&MachineConfig> {
        self.machine.as_ref()
    }

    /// This client sent a request.
    pub fn heard(&mut self, client: u32, now: u64) {
        if client == self.starter.client {
            self.starter.heard = now;
        }
    }

    /// Is this job being executed?
    pub fn executes(&self, store: &Store, name: &Name) -> bool {
        self.busy() && self.job.is_some_and(|id| store.is(id, name))
    }

    /// Sets another machine. The positions of its axes are unknown afterwards.
    pub fn set_machine(&mut self, machine: MachineConfig) -> Result<(), (Status, Field, u8)> {
        if self.busy() {
            return Err((Status::NotNow, Field::Format, 0));
        }
        let wrong = |(field, axis)| (Status::MachineConfig, field, axis);
        let (inputs, outputs) = (self.channels.inputs, self.channels.outputs);
        machine
            .check(self.clock_hz, inputs, outputs)
            .map_err(wrong)?;
        let setup = setup(&machine, self.clock_hz);
        let planner = Planner::new(&setup).map_err(|error| {
            wrong(match error {
                SetupError::Clock => (Field::Board, 0),
                SetupError::Scale(axis) => (Field::Scale, axis as u8),
                SetupError::Speed(axis) => (Field::Speed, axis as u8),
                SetupError::Accel(axis) => (Field::Acceleration, axis as u8),
                SetupError::Tolerance => (Field::ChordTolerance, 0),
            })
        })?;
        if self.machine != Some(machine) {
            self.homed = machine.axes.map(|axis| axis.home.is_none());
        }
        self.planner = Some(planner);
        self.machine = Some(machine);
        Ok(())
    }

    /// Sets the feed in percent.
    pub fn feed(&mut self, percent: u16) -> Result<(), Status> {
        if !(1..=200).contains(&percent) {
            return Err(Status::Value);
        }
        self.percent = percent;
        if let Some(planner) = &mut self.planner {
            planner.set_override(percent.into());
        }
        Ok(())
    }

    fn rest(&self) -> Velocities {
        rest(&self.limits())
    }

    fn limits(&self) -> [u32; AXES] {
        self.planner.as_ref().map_or([0; AXES], Planner::limits)
    }

    /// Does the next piece of work; false if there is none.
    pub fn poll(&mut self, store: &mut Store, now: u64, out: &mut impl Outside) -> bool {
        if self.phase == Phase::Idle {
            return false;
        }
        if let Some(patience) = self.starter.patience
            && now.wrapping_sub(self.starter.heard) > patience
        {
            self.stop(End::HostLost, out);
        }
        match self.phase {
            Phase::Idle => false,
            Phase::Check => {
                self.look_through(store);
                true
            }
            Phase::Open(done) if done < 2 => {
                self.open(done, out);
                true
            }
            _ if self.phase != Phase::Quit && self.due(now) => {
                self.exchanged = now;
                self.exchange(now, out);
                true
            }
            Phase::Open(_) | Phase::Home | Phase::Rest | Phase::Close(_) | Phase::Held => false,
            Phase::Play => self.play(store, out),
            Phase::Lift => self.lift(out),
            Phase::Brake => {
                self.core.pass(false, out);
                let state = self.core.state(out);
                if state.stands() || state.idle() {
                    self.core.quit(out);
                    self.phase = Phase::Quit;
                    return false;
                }
                // The way to rest may be longer than what the core has.
                (self.segment.is_some() || self.waiting.is_none()) && self.play(store, out)
            }
            Phase::Quit => {
                if self.core.state(out).idle() {
                    self.core.clear(out);
                    self.phase = Phase::Close(0);
                }
                false
            }
        }
    }

    fn due(&self, now: u64) -> bool {
        let per_second = match self.phase {
            Phase::Home | Phase::Rest | Phase::Close(_) => LOOKS_PER_SECOND,
            _ => EXCHANGES_PER_SECOND,
        };
        now.wrapping_sub(self.exchanged) >= u64::from(self.clock_hz) / per_second
    }

    /// Checks an instruction, or some chords of it.
    fn look_through(&mut self, store: &Store) {
        let Some(machine) = &self.machine else {
            return self.over(End::Broken);
        };
        let seen = if self.check.busy() {
            self.check.go_on(machine)
        } else {
            match self.program.next(store) {
                Err(_) => return self.over(End::Broken),
                Ok(None) => Ok(()),
                Ok(Some((Instruction::End, _))) => {
                    self.total = self.check.micros;
                    if let Some(job) = self.job {
                        self.program.job(store, job);
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
            self.trouble = (axis, Some(line));
            self.over(end);
        }
    }

    /// The work ended before the motion began.
    fn over(&mut self, why: End) {
        if self.streams {
            // What was not executed now must not be executed later.
            self.words = None;
        }
        (self.end, self.ending) = (why, why);
        self.phase = Phase::Idle;
    }

    fn open(&mut self, done: u8, out: &mut impl Outside) {
        let Some(machine) = &self.machine else {
            return self.over(End::Broken);
        };
        if done == 0 {
            if !self.inside.acquire(out) {
                return self.over(End::NotArmed);
            }
            let homed = self.homed;
            self.look_for_cuts(out);
            if !self.calibrates && self.homed != homed {
                // While the job was looked through, which was with switches found.
                self.inside.release(out);
                return self.over(End::NotHomed);
            }
        } else {
            let limits = self.limits();
            if !self.inside.configure(machine, &limits, out) {
                self.inside.release(out);
                return self.over(End::NotArmed);
            }
            self.core.set(
                slew(machine, self.clock_hz),
                machine.beam,
                machine.outputs,
                out,
            );
            self.core.clear(out);
            self.core.pass(!self.paused, out);
            self.velocities = self.rest();
        }
        self.phase = Phase::Open(done + 1);
    }

    /// Exchanges with the board: feeds its watchdog if there is a reason to, and reads its state.
    fn exchange(&mut self, now: u64, out: &mut impl Outside) {
        if self.phase == Phase::Play && !self.goes_on(out) {
            return;
        }
        let (enable, request) = match self.phase {
            Phase::Close(_) => (false, false),
            Phase::Open(done) => (true, done > 2),
            _ => (true, true),
        };
        let answer = self.inside.exchange(enable, request, &self.velocities, out);
        let Some(status) = answer else {
            if matches!(self.phase, Phase::Close(_)) {
                return self.closed(out);
            }
            let state = self.inside.state(out);
            self.board = state.map_or(self.board, StateWord::to_word);
            return self.lost(state, out);
        };
        self.board = status.state.to_word();
        self.seen(status.state);
        for (place, (position, _)) in self.positions.iter_mut().zip(&status.stepgen) {
            *place = position.0;
        }
        let velocities = || status.stepgen.iter().take(AXES);
        self.at_rest = velocities().all(|(_, velocity)| velocity.0 == 0);
        match self.phase {
            Phase::Open(_) if status.state.enabled => self.opened(out),
            Phase::Open(ARMING) => {
                self.ending = End::NotArmed;
                self.phase = Phase::Close(0);
            }
            Phase::Open(done) => self.phase = Phase::Open(done + 1),
            Phase::Close(count) if !status.state.enabled || count >= DISARMING => {
                self.closed(out);
            }
            Phase::Close(count) => self.phase = Phase::Close(count + 1),
            _ if !status.state.enabled => self.lost(Some(status.state), out),
            Phase::Home => self.home(&status, now, out),
            Phase::Rest if self.at_rest => self.phase = Phase::Close(0),
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

    fn closed(&mut self, out: &mut impl Outside) {
        if self.torn {
            let state = self.inside.state(out);
            if state.is_some_and(|state| state.state == wire::State::Stopping) {
                // Whether pulses are cut off is known only when the axes stand, or when the grace
                // is over.
                return;
            }
            self.torn = false;
            self.explain(state);
        }
        self.inside.release(out);
        self.over(self.ending);
    }

    /// Is the watchdog to be fed? Yes if work has progressed, or if no motion is due.
    fn goes_on(&mut self, out: &mut impl Outside) -> bool {
        let state = self.core.state(out);
        let now = self.core.progress(out);
        let before = core::mem::replace(&mut self.progress, now);
        before != now || state.idle() || self.paused && state.stands()
    }

    /// The board is armed.
    fn opened(&mut self, out: &mut impl Outside) {
        (self.base, _) = self.core.progress(out);
        self.settle();
        self.phase = Phase::Play;
        if self.streams {
            let at = self.places();
            let machine = self.machine.as_ref();
            let limits = machine.map(|machine| limits(machine, &self.limits(), self.clock_hz));
            match (&mut self.words, limits) {
                (Some(words), Some(limits)) => {
                    // The axes may have been moved since the first words came, and another machine
                    // sent.
                    if words.begin(limits, at).is_err() {
                        self.ending = End::Limits;
                        self.phase = Phase::Close(0);
                    }
                }
                (None, Some(limits)) => self.words = Some(Words::new(limits, at)),
                (_, None) => {}
            }
        }
    }

    /// The board closed its gate, or ended the session.
    fn lost(&mut self, state: Option<StateWord>, out: &mut impl Outside) {
        let underrun = self.core.state(out).reason() == reason::UNDERRUN;
        self.ending = if underrun {
            End::Underrun
        } else {
            End::SessionLost
        };
        self.torn = true;
        self.explain(state);
        self.core.quit(out);
        self.phase = Phase::Quit;
    }

    /// Plans, or fills the FIFO. False when the FIFO is full, or the next output has to wait.
    fn play(&mut self, store: &Store, out: &mut impl Outside) -> bool {
        let state = self.core.state(out);
        if state.failed() {
            self.failed(state, out);
            return true;
        }
        if let Some(segment) = &self.segment {
            if !self.core.has_room(state) {
                if state.idle() {
                    self.core.start(out);
                }
                return false;
            }
            self.core.push(segment, out);
            let number = self.planner.as_ref().map_or(0, Planner::tag);
            self.reached.segment(number, segment.clocks);
            self.segment = None;
            if self.streams {
                return true;
            }
            // The next one in the same call: a turn of the ROM's loop in between takes half as long
            // as the planning.
        }
        if let Some(output) = self.waiting {
            if !state.idle() {
                return false;
            }
            if state.level() > 0 {
                self.core.start(out);
                return false;
            }
            self.waiting = None;
            self.arrived(output);
            return true;
        }
        if !self.streams {
            self.plan(store);
            return true;
        }
        let words = self.words.as_mut();
        self.segment = words.and_then(|words| {
            let executes = words.executes;
            words.player().poll(executes)
        });
        if self.segment.is_none() && state.idle() && state.level() > 0 {
            self.core.start(out);
        }
        self.segment.is_some()
    }

    /// The core ended by itself.
    fn failed(&mut self, state: CoreState, out: &mut impl Outside) {
        if !state.idle() {
            return;
        }
        if state.reason() == reason::UNDERRUN {
            self.ending = End::Underrun;
            self.core.clear(out);
            self.phase = Phase::Close(0);
        } else {
            let state = self.inside.state(out);
            self.lost(state, out);
        }
    }

    /// One step: an instruction into the planner, or a segment out of it.
    fn plan(&mut self, store: &Store) {
        let (Some(planner), Some(machine)) = (&mut self.planner, &self.machine) else {
            return self.broken();
        };
        if self.instruction.is_none() && planner.accepts() {
            match self.program.next(store) {
                Ok(Some(next)) => self.instruction = Some(next),
                Ok(None) => return,
                Err(_) => return self.broken(),
            }
        }
        if let Some((instruction, line)) = self.instruction
            && planner.accepts()
        {
            let mark = Mark {
                line,
                micros: self.micros,
            };
            let number = self.reached.instruction(mark);
            if !planner.push(&instruction, number) {
                return self.broken();
            }
            let micros = nominal(&self.from, &instruction, machine);
            self.micros = self.micros.saturating_add(micros);
            self.from = match instruction {
                Instruction::Line { to, .. } => to,
                Instruction::Arc(arc) => arc.to,
                Instruction::Home { axes } => {
                    let from = self.from;
                    core::array::from_fn(|axis| match (axes.get(axis), from.get(axis)) {
                        (Some(false), Some(nm)) => *nm,
                        _ => 0,
                    })
                }
                Instruction::Dwell { .. }
                | Instruction::Aux { .. }
                | Instruction::Pause
                | Instruction::End => self.from,
            };
            self.instruction = None;
            return;
        }
        match planner.work(CHORDS) {
            Work::Output(Output::Segment(segment)) => self.segment = Some(segment),
            Work::Output(output) => self.waiting = Some(output),
            Work::More | Work::Starved => {}
        }
    }

    /// The job in the store has changed: the planned part is drawn up to where it can stop.
    fn broken(&mut self) {
        self.ending = End::Broken;
        self.phase = Phase::Brake;
    }

    /// All axes stand, and this output is next.
    fn arrived(&mut self, output: Output) {
        match output {
            Output::Segment(segment) => self.segment = Some(segment),
            Output::Pause => self.phase = Phase::Held,
            Output::End => self.phase = Phase::Close(0),
            Output::Home(axes) => {
                self.homing = Homing::new(axes, self.rest());
                let delay = self
                    .machine
                    .as_ref()
                    .map_or(0, |machine| machine.tool_delay);
                let clocks = u64::from(delay) * u64::from(self.clock_hz) / 1_000_000;
                // The tool is lifted, and gets the time it needs.
                self.segment = Some(Segment {
                    clocks: clocks.clamp(MIN_CLOCKS.into(), u32::MAX.into()) as u32,
                    ..Segment::default()
                });
                self.phase = Phase::Lift;
            }
        }
    }

    fn lift(&mut self, out: &mut impl Outside) -> bool {
        let state = self.core.state(out);
        if state.failed() {
            self.failed(state, out);
        } else if let Some(segment) = self.segment.take() {
            self.core.push(&segment, out);
            self.reached.segment(0, segment.clocks);
            self.core.start(out);
            return true;
        } else if state.idle() && state.level() == 0 {
            self.phase = Phase::Home;
        }
        false
    }

    fn home(&mut self, status: &wire::exchange::Status, now: u64, out: &mut impl Outside) {
        let Some(machine) = &self.machine else {
            return self.broken();
        };
        let next = self.homing.step(machine, self.clock_hz, status, now);
        self.velocities = self.homing.velocities;
        match next {
            Next::Go => {}
            Next::Failed(why, axis) => {
                self.trouble = (axis, None);
                self.stop(why, out);
            }
            Next::Done => self.found(),
        }
    }

    /// Each switch's opening position becomes 0, and the axes go there.
    fn found(&mut self) {
        self.velocities = self.rest();
        let mut to = [0; AXES];
        for (axis, found) in self.homing.found.into_iter().enumerate() {
            if let Some(found) = found {
                self.zero(axis, found);
            }
        }
        let tool = self
            .planner
            .as_ref()
            .map_or(0, |planner| planner.machine().aux);
        self.settle();
        if let Some(planner) = &self.planner {
            let at = planner.target();
            for ((to, at), found) in to.iter_mut().zip(at).zip(&self.homing.found) {
                *to = if found.is_some() { 0 } else { at };
            }
        }
        let feed = crate::instruction::Feed::Rapid;
        self.program.insert(Instruction::Line { to, feed });
        if tool != 0 {
            self.program.insert(Instruction::Aux { bits: tool });
        }
        self.phase = Phase::Play;
    }
}
