//! The phases of work, as tables: what a pause, a stop and an exchange mean in each of them.

use wire::jobs::State;

/// 5 ms: a twentieth of the watchdog's timeout.
const EXCHANGES_PER_SECOND: u64 = 200;
/// 1 ms during homing: the position error is the way in that time at the slow speed.
const LOOKS_PER_SECOND: u64 = 1000;

/// What the executor is doing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Phase {
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

/// What pause and continue do.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Hold {
    /// Pause stops the time of the path, continue lets it pass.
    Path,
    /// The job waits already; continue resumes it.
    Waits,
    /// A homing is not a path that can be held: pause ends it. So there is nothing to continue.
    Ends,
    /// Neither is taken.
    Refused,
}

impl Phase {
    /// The effect of pause and continue; `homes`: in a homing that a client requested.
    pub fn hold(self, homes: bool) -> Hold {
        match self {
            Phase::Check | Phase::Open(_) | Phase::Play if !homes => Hold::Path,
            Phase::Check | Phase::Open(_) | Phase::Play | Phase::Lift | Phase::Home => Hold::Ends,
            Phase::Held => Hold::Waits,
            Phase::Idle | Phase::Rest | Phase::Brake | Phase::Quit | Phase::Close(_) => {
                Hold::Refused
            }
        }
    }

    /// The phase that a stop leads to; `None`: the work is about to end already.
    pub fn stopped(self) -> Option<Phase> {
        match self {
            Phase::Check | Phase::Open(0) => Some(Phase::Idle),
            Phase::Open(_) | Phase::Held => Some(Phase::Close(0)),
            Phase::Play | Phase::Lift => Some(Phase::Brake),
            Phase::Home => Some(Phase::Rest),
            Phase::Idle | Phase::Rest | Phase::Brake | Phase::Quit | Phase::Close(_) => None,
        }
    }

    /// Exchanges per second; `None`: the board is not taken yet, or the core has to end first.
    pub fn exchanges(self) -> Option<u64> {
        match self {
            Phase::Idle | Phase::Check | Phase::Open(0 | 1) | Phase::Quit => None,
            Phase::Home | Phase::Rest | Phase::Close(_) => Some(LOOKS_PER_SECOND),
            Phase::Open(_) | Phase::Play | Phase::Held | Phase::Lift | Phase::Brake => {
                Some(EXCHANGES_PER_SECOND)
            }
        }
    }

    /// An exchange's enable and its request to arm. The board arms at an edge of the request.
    pub fn gate(self) -> (bool, bool) {
        match self {
            Phase::Close(_) => (false, false),
            Phase::Open(done) => (true, done > 2),
            Phase::Idle
            | Phase::Check
            | Phase::Play
            | Phase::Held
            | Phase::Lift
            | Phase::Home
            | Phase::Rest
            | Phase::Brake
            | Phase::Quit => (true, true),
        }
    }

    /// The state that clients are told.
    pub fn state(self, homes: bool, paused: bool) -> State {
        match self {
            Phase::Idle => State::Stopped,
            Phase::Check => State::Checking,
            Phase::Lift | Phase::Home => State::Calibrating,
            Phase::Open(_) | Phase::Play if homes => State::Calibrating,
            Phase::Held => State::Paused,
            Phase::Open(_) | Phase::Play if paused => State::Paused,
            Phase::Open(_) | Phase::Play => State::Running,
            Phase::Rest | Phase::Brake | Phase::Quit | Phase::Close(_) => State::Stopping,
        }
    }
}
