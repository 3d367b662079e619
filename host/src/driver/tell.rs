//! Messages to the operator: every event once.
//!
//! With a loose plug a board comes and goes many times a second, and each time five answers are
//! missing. For the operator this is one event. So a message is not repeated until the machine is
//! armed again, or the board has answered for [`STEADY_NS`] without a gap.

use crate::hal::{Level, MessageLine, Messenger};
use core::fmt::Arguments;
use wire::FaultReason;

/// 10 s: enough time to push a plug in, and the operator still remembers the last message.
const STEADY_NS: i64 = 10_000_000_000;

/// What may happen.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Event {
    /// The board does not answer.
    Silent,
    /// The servo thread came later than the watchdog waits.
    HeldUp,
    /// The board has restarted.
    Restarted,
    /// Something else answers at its address.
    Stranger,
    /// Another host drives it.
    Owned,
    /// It refuses its settings.
    Settings,
    /// `write` is called without `read`.
    Unread,
    /// Functions of one board are in two threads.
    Collided,
    /// Datagrams without end.
    Flooded,
    /// It stopped by itself.
    Stopped(FaultReason),
}

impl Event {
    fn bit(self) -> u32 {
        let place = match self {
            Event::Silent => 0,
            Event::HeldUp => 1,
            Event::Restarted => 2,
            Event::Stranger => 3,
            Event::Owned => 4,
            Event::Settings => 5,
            Event::Unread => 6,
            Event::Collided => 7,
            Event::Flooded => 31,
            Event::Stopped(reason) => 8 + reason.code(),
        };
        1 << place
    }
}

/// The messages of one board.
pub(super) struct Notifier {
    say: Messenger,
    /// The board's name, at the beginning of every message.
    name: String,
    /// Events told since the machine was in order.
    told: u32,
    /// For how long the board has answered without a gap, ns of servo periods.
    steady: i64,
}

impl Notifier {
    pub(super) fn new(say: Messenger, name: String) -> Self {
        Notifier {
            say,
            name,
            told: 0,
            steady: 0,
        }
    }

    /// Tells of an event, unless it was already told.
    pub(super) fn once(&mut self, event: Event, what: Arguments<'_>) {
        if !self.has_told(event) {
            self.told |= event.bit();
            self.tell(Level::Error, what);
        }
    }

    /// Whether the operator was told.
    pub(super) fn has_told(&self, event: Event) -> bool {
        self.told & event.bit() != 0
    }

    /// Gives a message, even repeatedly.
    pub(super) fn tell(&self, level: Level, what: Arguments<'_>) {
        let line = MessageLine::format(format_args!("{}: {what}", self.name));
        (self.say)(level, line.as_c_str());
    }

    /// The machine was armed: the trouble is over.
    pub(super) fn armed(&mut self) {
        self.told = 0;
    }

    /// A period with an answer.
    pub(super) fn answered(&mut self, period_ns: i64) {
        self.steady = self.steady.saturating_add(period_ns);
        if self.steady >= STEADY_NS {
            self.told = 0;
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
            notifier.once(Event::Silent, format_args!("no answer"));
            assert_eq!(hal.said().len(), times);
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
        silent(&mut notifier, 1);
    }

    #[test]
    fn every_event_is_itself() {
        let stopped = FaultReason::ALL
            .iter()
            .map(|reason| Event::Stopped(*reason));
        let others = [
            Event::Silent,
            Event::HeldUp,
            Event::Restarted,
            Event::Stranger,
            Event::Owned,
            Event::Settings,
            Event::Unread,
            Event::Collided,
            Event::Flooded,
        ];
        let bits: Vec<u32> = stopped.chain(others).map(Event::bit).collect();
        let all = bits.iter().fold(0, |all, bit| all | bit);
        assert_eq!(all.count_ones() as usize, bits.len());
    }
}
