//! `timebase.sv`: the wall clock and the commit that waits for its time.

/// The wall clock.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Timebase {
    next: u64,
    now: u64,
    due: bool,
    pending: bool,
}

impl Default for Timebase {
    fn default() -> Self {
        Timebase {
            next: 1,
            now: 0,
            due: false,
            pending: false,
        }
    }
}

/// Its inputs in a clock.
#[derive(Clone, Copy, Debug, Default)]
pub struct Input {
    /// Reset: forgets a pending commit.
    pub rst: bool,
    /// Pulse: commit when the time has come.
    pub commit_timed: bool,
    /// That time.
    pub commit_at: u64,
}

impl Timebase {
    /// A wall clock that shows this.
    pub fn at(now: u64) -> Self {
        Timebase {
            next: now.wrapping_add(1),
            now,
            ..Timebase::default()
        }
    }

    /// The wall clock, clocks since power-up.
    pub fn now(&self) -> u64 {
        self.now
    }

    /// A timed commit waits.
    pub fn pending(&self) -> bool {
        self.pending
    }

    /// A timed commit happens in this clock, unless it is being replaced.
    pub fn due(&self, replaced: bool) -> bool {
        self.pending && self.due && !replaced
    }

    /// One rising edge.
    pub fn clock(&mut self, input: Input) {
        self.pending = !input.rst && (input.commit_timed || (self.pending && !self.due));
        self.due = self.next >= input.commit_at;
        self.now = self.next;
        self.next = self.next.wrapping_add(1);
    }

    /// Clocks in which nothing is due.
    pub fn quiet(&self, commit_at: u64) -> u64 {
        if !self.pending {
            u64::MAX
        } else if self.due {
            0
        } else {
            commit_at.saturating_sub(self.next)
        }
    }

    /// That many quiet clocks at once.
    pub fn skip(&mut self, clocks: u64, commit_at: u64) {
        if clocks == 0 {
            return;
        }
        self.next = self.next.wrapping_add(clocks);
        self.now = self.next.wrapping_sub(1);
        self.due = self.now >= commit_at;
    }
}
