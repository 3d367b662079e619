//! Messages to the operator: every event once.
//!
//! With a loose plug a board comes and goes many times a second, and each time five answers are
//! missing. For the operator this is one event. So a message is not repeated until the machine is
//! armed again, or the board has answered for [`STEADY_NS`] without a gap.

use crate::fault::Fault;
use crate::hal::{Level, MessageLine, Messenger};
use core::fmt::Arguments;

/// 10 s: enough time to push a plug in, and the operator still remembers the last message.
const STEADY_NS: i64 = 10_000_000_000;

/// The messages of one board.
pub(super) struct Notifier {
    say: Messenger,
    /// The board's name, at the beginning of every message.
    name: String,
    /// Faults told since the machine was in order.
    told: u32,
    /// The last of them.
    latest: Option<Fault>,
    /// For how long the board has answered without a gap, ns of servo periods.
    steady: i64,
}

impl Notifier {
    pub(super) fn new(say: Messenger, name: String) -> Self {
        Notifier {
            say,
            name,
            told: 0,
            latest: None,
            steady: 0,
        }
    }

    /// Tells of an event, unless it was already told.
    pub(super) fn once(&mut self, event: Fault, what: Arguments<'_>) {
        if !self.has_told(event) {
            self.told |= 1 << event.code();
            self.latest = Some(event);
            self.tell(Level::Error, what);
        }
    }

    /// Whether the operator was told.
    pub(super) fn has_told(&self, event: Fault) -> bool {
        self.told & 1 << event.code() != 0
    }

    /// Gives a message, even repeatedly.
    pub(super) fn tell(&self, level: Level, what: Arguments<'_>) {
        let line = MessageLine::format(format_args!("{}: {what}", self.name));
        (self.say)(level, line.as_c_str());
    }

    /// What was told last.
    pub(super) fn latest(&self) -> Option<Fault> {
        self.latest
    }

    /// The machine was armed: the trouble is over.
    pub(super) fn armed(&mut self) {
        (self.told, self.latest) = (0, None);
    }

    /// A period with an answer.
    pub(super) fn answered(&mut self, period_ns: i64) {
        self.steady = self.steady.saturating_add(period_ns);
        if self.steady >= STEADY_NS {
            self.armed();
        }
    }

    /// A period without.
    pub(super) fn missed(&mut self) {
        self.steady = 0;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hal::fake::FakeHal;

    const PERIOD_NS: i64 = 1_000_000;

    #[test]
    fn an_event_is_told_once_until_the_board_has_been_steady_or_was_armed() {
        let hal = FakeHal::new();
        let mut notifier = Notifier::new(hal.messenger(), "board 0".to_owned());
        let silent = |notifier: &mut Notifier, times: usize| {
            notifier.missed();
            notifier.once(Fault::Silent, format_args!("no answer"));
            assert_eq!(hal.said().len(), times);
            assert_eq!(notifier.latest(), Some(Fault::Silent));
        };
        silent(&mut notifier, 1);
        for _ in 0..9_999 {
            notifier.answered(PERIOD_NS);
        }
        silent(&mut notifier, 0);
        for _ in 0..10_000 {
            notifier.answered(PERIOD_NS);
        }
        silent(&mut notifier, 1);
        notifier.armed();
        assert_eq!(notifier.latest(), None);
        silent(&mut notifier, 1);
        notifier.once(Fault::Owned, format_args!("another host"));
        assert_eq!(notifier.latest(), Some(Fault::Owned), "the last one told");
    }
}
