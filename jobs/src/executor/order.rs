//! A client's order to execute a job, and how long the client may be silent.

use crate::store::Id;
use motion::segment::AXES;
use wire::Name;
use wire::jobs::{KEEPALIVE_MS, Status, UNATTENDED};

/// The client that started the work, and how long it may be silent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Starter {
    client: u32,
    /// Clocks; `None` unattended.
    patience: Option<u64>,
    heard: u64,
}

impl Starter {
    /// From a command that comes now.
    pub fn new(
        client: u32,
        (flags, keepalive): (u8, u16),
        clock_hz: u32,
        now: u64,
    ) -> Result<Self, Status> {
        let attended = flags & UNATTENDED == 0;
        if attended && !KEEPALIVE_MS.contains(&keepalive) {
            return Err(Status::Value);
        }
        let per_ms = u64::from(clock_hz / 1000);
        Ok(Starter {
            client,
            patience: attended.then_some(u64::from(keepalive) * per_ms),
            heard: now,
        })
    }
}

/// Kinds of work.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Work {
    /// A job of the store.
    Job(Id),
    /// Homes axes.
    Homing,
    /// FPGA G's words.
    Words,
}

/// The current order, or the last one.
#[derive(Debug)]
pub struct Order {
    starter: Starter,
    work: Work,
    /// The name of the job.
    pub name: Name,
    /// The time of the path is held.
    pub paused: bool,
}

impl Order {
    /// Before the first one.
    pub fn none() -> Self {
        let starter = Starter {
            client: 0,
            patience: None,
            heard: 0,
        };
        Order::new(starter, Work::Homing, Name::EMPTY)
    }

    /// This work.
    pub fn new(starter: Starter, work: Work, name: Name) -> Self {
        Order {
            starter,
            work,
            name,
            paused: false,
        }
    }

    /// This client sent a request.
    pub fn heard(&mut self, client: u32, now: u64) {
        if client == self.starter.client {
            self.starter.heard = now;
        }
    }

    /// Has the client been silent for too long?
    pub fn silent(&self, now: u64) -> bool {
        let silence = now.wrapping_sub(self.starter.heard);
        self.starter.patience.is_some_and(|most| silence > most)
    }

    /// The client has to keep asking.
    pub fn attended(&self) -> bool {
        self.starter.patience.is_some()
    }

    /// The job to execute.
    pub fn job(&self) -> Option<Id> {
        match self.work {
            Work::Job(id) => Some(id),
            Work::Homing | Work::Words => None,
        }
    }

    /// The order is to home axes.
    pub fn homes(&self) -> bool {
        self.work == Work::Homing
    }

    /// The order is to execute words.
    pub fn streams(&self) -> bool {
        self.work == Work::Words
    }
}

/// The axes a command names, all of which have to be `fit`; or all fit ones if it names none.
pub fn asked(flags: u8, fit: [bool; AXES], refusal: Status) -> Result<[bool; AXES], Status> {
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
