//! The state that a driver keeps about its board, one type per concern.

use crate::blocks::arming::ArmRequest;
use crate::blocks::encoder::Encoder;
use crate::blocks::ethernet::Ethernet;
use crate::blocks::exchange::Exchanges;
use crate::blocks::gpio;
use crate::blocks::packets::Packets;
use crate::blocks::pwm::Pwm;
use crate::blocks::stepgen::Stepgen;
use crate::blocks::wallclock::Wallclock;
use crate::blocks::watchdog::Watchdog;
use crate::blocks::ways::Ways;
use crate::clock::{BoardClock, Timebase};
use crate::group::Group;
use crate::keys::Key;
use crate::settings::{Disarmed, Periods, Sync};
use std::sync::Arc;
use wire::describe::Describe;
use wire::exchange::Command;
use wire::units::Clocks;
use wire::{FaultReason, State};

/// The parts of the board that have pins of their own.
pub(super) struct Blocks {
    pub(super) packets: Packets,
    pub(super) watchdog: Watchdog,
    pub(super) wallclock: Wallclock,
    pub(super) ethernet: Ethernet,
    pub(super) ways: Ways,
    pub(super) exchanges: Exchanges,
    pub(super) stepgens: Vec<Stepgen>,
    pub(super) encoders: Vec<Encoder>,
    pub(super) pwms: Vec<Pwm>,
    pub(super) inputs: Vec<gpio::Input>,
    pub(super) outputs: Vec<gpio::Output>,
}

impl Blocks {
    /// The fabric began to count again.
    pub(super) fn rebase(&mut self) {
        for stepgen in &mut self.stepgens {
            stepgen.rebase();
        }
        for encoder in &mut self.encoders {
            encoder.rebase();
        }
    }

    /// A new session: no latch is armed.
    pub(super) fn forget_latches(&mut self) {
        for stepgen in &mut self.stepgens {
            stepgen.forget_latch();
        }
        for encoder in &mut self.encoders {
            encoder.forget_latch();
        }
    }
}

/// Whether the board is ours.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Phase {
    /// Asking for the session; so many periods until the next time.
    Acquiring { wait: u32, tag: u32 },
    /// Exchanging.
    Online { token: u32 },
}

/// The session, and what the board was told in it.
pub(super) struct SessionState {
    pub(super) phase: Phase,
    /// To take the board again with, if it has one.
    pub(super) key: Option<Key>,
    pub(super) boot_id: u32,
    /// The foreign owner of the session that the operator was told of.
    pub(super) foreign_owner: Option<(u32, u32)>,
    pub(super) tag: u32,
    pub(super) arm: ArmRequest,
    pub(super) disarmed_settings: Sync<Disarmed>,
    pub(super) periods: Sync<Periods>,
    /// An answer came in this session: the board has seen our `enable-request` low.
    pub(super) answered: bool,
    /// The next answer is the first of this session.
    pub(super) first_answer: bool,
}

impl SessionState {
    pub(super) fn new(boot_id: u32) -> Self {
        SessionState {
            // Loading took seconds, longer than an idle session lasts: ask for the session again
            // first.
            phase: Phase::Acquiring { wait: 0, tag: 0 },
            key: None,
            boot_id,
            foreign_owner: None,
            tag: 0,
            arm: ArmRequest::default(),
            disarmed_settings: Sync::default(),
            periods: Sync::default(),
            answered: false,
            first_answer: false,
        }
    }

    /// The board is ours: what it was told before, it has forgotten.
    pub(super) fn opened(&mut self, token: u32) {
        self.phase = Phase::Online { token };
        self.disarmed_settings.forget();
        self.periods.forget();
        self.arm.forget();
        self.first_answer = true;
        self.answered = false;
    }
}

/// The last command and its answer.
#[derive(Default)]
pub(super) struct Exchange {
    pub(super) sequence: u32,
    /// The last command sent in this session.
    pub(super) last: Option<Command>,
    /// The command just sent awaits its answer.
    pub(super) awaiting: bool,
    /// It is the repetition of one that was sent last period, so two answers may come.
    pub(super) repeated: bool,
    /// `read-request` was called since the last `write`.
    pub(super) request_seen: bool,
    /// `write` was called, `read` not yet.
    pub(super) written: bool,
    /// Answers missing in a row.
    pub(super) missing: u32,
}

impl Exchange {
    /// A new session goes on after this sequence number.
    pub(super) fn opened(&mut self, last_sequence: u32) {
        self.sequence = last_sequence;
        self.last = None;
        self.missing = 0;
    }
}

/// How the machine is: armed, stopped, and why.
pub(super) struct Condition {
    pub(super) state: State,
    pub(super) reason: FaultReason,
    pub(super) live: bool,
    /// It was stopped for ever.
    pub(super) halted: bool,
    /// Commands later than this one say `enable` false until the board has stopped.
    pub(super) halting: Option<u32>,
    /// The board restarted and was not armed since.
    pub(super) restarted: bool,
    /// It said that its fabric is a new one; the first sample will tell.
    pub(super) new_fabric: bool,
    /// `io-error` as it was seen or set last.
    pub(super) io_error: bool,
}

impl Condition {
    /// A stop before this session is not a new event.
    pub(super) fn of(describe: &Describe) -> Self {
        Condition {
            state: describe.state.state,
            reason: describe.state.reason,
            live: false,
            halted: false,
            halting: None,
            restarted: false,
            new_fabric: false,
            io_error: false,
        }
    }
}

/// The boards that stop together.
pub(super) struct Membership {
    pub(super) shared: Arc<Group>,
    /// There are other boards.
    pub(super) several: bool,
    /// The group's alarm heard last.
    pub(super) alarm_heard: u32,
    /// The board with the alarm that stopped this one.
    pub(super) stopped_by: Option<usize>,
}

impl Membership {
    /// A board alone.
    pub(super) fn new() -> Self {
        Membership {
            shared: Group::new(),
            several: false,
            alarm_heard: 0,
            stopped_by: None,
        }
    }
}

/// Moments of the host and of the board.
pub(super) struct Times {
    pub(super) time: Arc<Timebase>,
    /// The common moments used last.
    pub(super) read_moment: u64,
    pub(super) write_moment: u64,
    /// When the commands of this period began to be sent.
    pub(super) writes: i64,
    pub(super) clock: BoardClock,
    /// Sequence number and time of sending of the last two commands.
    pub(super) sent: [(u32, i64); 2],
    /// From `read-request` to `write`, as it was last time; `None` without a `read-request`.
    pub(super) request_to_write: Option<i64>,
    /// When the last answered command arrived there.
    pub(super) arrival: Option<Clocks>,
    /// When the last command takes effect, if not at once.
    pub(super) apply_at: Option<Clocks>,
    /// When the last answer was read.
    pub(super) heard: i64,
    /// When `write` was called last, and for how long `read` has waited since.
    pub(super) wrote: Option<i64>,
    pub(super) waited: i64,
    /// From the last answered `write` to the one after, less what `read` waited, ns.
    pub(super) held_up: i64,
}

impl Times {
    pub(super) fn new(clock_hz: u32) -> Self {
        Times {
            time: Timebase::new(),
            read_moment: 0,
            write_moment: 0,
            writes: 0,
            clock: BoardClock::new(clock_hz),
            sent: [(0, 0); 2],
            request_to_write: None,
            arrival: None,
            apply_at: None,
            heard: 0,
            wrote: None,
            waited: 0,
            held_up: 0,
        }
    }

    pub(super) fn now(&self) -> i64 {
        self.time.now()
    }

    /// `write` begins. Every board takes part in every period, with a session or without one: one
    /// that came in later would be a period behind the others for ever.
    pub(super) fn write_begins(&mut self) {
        let now = self.now();
        self.writes = self.time.writes.of(&mut self.write_moment, now);
    }

    /// A new session: no command is on its way.
    pub(super) fn opened(&mut self) {
        self.arrival = None;
        self.apply_at = None;
    }
}
