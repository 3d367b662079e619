//! What the operator is told: every event once.
//!
//! A cable that is half out makes a board come and go many times a second, and each time it would be true that
//! five answers are missing. To the operator it is one event. So what was told is remembered until the machine is
//! armed again, or the board has answered for [`STEADY_NS`] without a gap; until then the same is not said twice.

use crate::hal::{Level, Line, Messenger};
use core::fmt::Arguments;
use wire::FaultReason;

/// 10 s: longer than anybody needs to push a plug in, shorter than it takes to forget the last message.
const STEADY_NS: i64 = 10_000_000_000;

/// What may happen.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Event {
    /// The board does not answer.
    Silent,
    /// The servo thread came later than the watchdog waits.
    HeldUp,
    /// The board has started anew.
    Restarted,
    /// Something else answers at its address.
    Stranger,
    /// Somebody else drives it.
    Owned,
    /// It refuses its settings.
    Settings,
    /// `write` is called without `read`.
    Unread,
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
            Event::Stopped(reason) => 8 + reason.code(),
        };
        1 << place
    }
}

/// A board's voice.
pub(super) struct Voice {
    say: Messenger,
    /// Which board, as every message begins.
    who: String,
    /// Events told since the machine was in order.
    told: u32,
    /// For how long the board has answered without a gap, ns of servo periods.
    steady: i64,
}

impl Voice {
    pub(super) fn new(say: Messenger, who: String) -> Self {
        Voice {
            say,
            who,
            told: 0,
            steady: 0,
        }
    }

    /// Tells of an event, unless that was done.
    pub(super) fn once(&mut self, event: Event, what: Arguments<'_>) {
        if !self.has_told(event) {
            self.told |= event.bit();
            self.tell(Level::Error, what);
        }
    }

    /// Whether the operator knows.
    pub(super) fn has_told(&self, event: Event) -> bool {
        self.told & event.bit() != 0
    }

    /// Says something whenever it is asked to.
    pub(super) fn tell(&self, level: Level, what: Arguments<'_>) {
        let line = Line::format(format_args!("{}: {what}", self.who));
        (self.say)(level, line.as_c_str());
    }

    /// The machine was armed: whatever it was is over.
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
        let mut voice = Voice::new(hal.messenger(), "board 0".to_owned());
        let silent = |voice: &mut Voice, times: usize| {
            voice.missed();
            voice.once(Event::Silent, format_args!("no answer"));
            assert_eq!(hal.said().len(), times);
        };
        silent(&mut voice, 1);
        for _ in 0..9_999 {
            voice.answered(PERIOD_NS);
        }
        silent(&mut voice, 0);
        for _ in 0..10_000 {
            voice.answered(PERIOD_NS);
        }
        silent(&mut voice, 1);
        voice.armed();
        silent(&mut voice, 1);
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
        ];
        let bits: Vec<u32> = stopped.chain(others).map(Event::bit).collect();
        let all = bits.iter().fold(0, |all, bit| all | bit);
        assert_eq!(all.count_ones() as usize, bits.len());
    }
}
