//! `exchange.*`: how the board answers the exchange, with or without its firmware.
//!
//! | pin | | |
//! |---|---|---|
//! | `exchange.fast-way` | u32 out | exchanges the gateware executed and answered since the board started |
//! | `exchange.long-way` | u32 out | exchanges that took the long way through the firmware |
//! | `exchange.long-way-reason` | u32 out | [`wire::LongWay`]: why the last of those did |
//!
//! No answer to an exchange carries them. The driver asks once a second, behind its command, so the
//! question delays no command.

use crate::hal::{ExportError, Exporter, Out};
use wire::Request;
use wire::refusal::COUNTERS_WAYS;

/// 1 s between two questions: soon enough for a person at a meter, and one datagram in a thousand
/// for the board.
const EVERY_NS: i64 = 1_000_000_000;

/// Where they are, in the pins' order.
pub const WORDS: [u32; 3] = [COUNTERS_WAYS, COUNTERS_WAYS + 4, COUNTERS_WAYS + 8];

/// The pins, and the question on its way.
#[derive(Debug)]
pub struct Ways {
    fast: Out<u32>,
    long: Out<u32>,
    reason: Out<u32>,
    /// Since the last question, ns of servo periods.
    since: i64,
    /// Of the last question, if it has no answer yet.
    tag: Option<u32>,
}

impl Ways {
    /// Exports the pins; the prefix is the board's.
    pub fn export(hal: &mut Exporter<'_>) -> Result<Self, ExportError> {
        let mut hal = hal.under("exchange");
        Ok(Ways {
            fast: hal.output("fast-way")?,
            long: hal.output("long-way")?,
            reason: hal.output("long-way-reason")?,
            since: 0,
            tag: None,
        })
    }

    /// A period has passed; `true` if a question is due.
    #[must_use]
    pub fn due(&mut self, period_ns: i64) -> bool {
        self.since = self.since.saturating_add(period_ns.max(0));
        if self.since < EVERY_NS {
            return false;
        }
        self.since = 0;
        true
    }

    /// The question with this tag. Without an answer there is another one in a second.
    pub fn ask<'w>(&mut self, tag: u32, words: &'w mut [u32]) -> Option<&'w [u32]> {
        self.tag = Some(tag);
        Request::new(words).read(tag, &WORDS).words()
    }

    /// An answer of this tag; `true` if it was to the last question.
    pub fn answered(&mut self, tag: u32, words: &[u32]) -> bool {
        let [fast, long, reason] = *words else {
            return false;
        };
        if self.tag != Some(tag) {
            return false;
        }
        self.tag = None;
        self.fast.set(fast);
        self.long.set(long);
        self.reason.set(reason);
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hal::fake::FakeHal;
    use wire::{LongWay, Packet};

    #[test]
    fn the_board_is_asked_once_a_second_at_any_period() {
        for period in [125_000, 1_000_000, 10_000_000] {
            let mut hal = FakeHal::new();
            let mut ways = Ways::export(&mut Exporter::new(&mut hal, "b")).unwrap();
            let periods = 3 * EVERY_NS / period;
            let asked = (0..periods).filter(|_| ways.due(period)).count();
            assert_eq!(asked, 3, "{period} ns");
        }
    }

    #[test]
    fn the_pins_follow_the_answer_to_the_last_question_and_no_other() {
        let mut hal = FakeHal::new();
        let mut ways = Ways::export(&mut Exporter::new(&mut hal, "b")).unwrap();
        let frame = LongWay::Frame as u32;
        let answer = [1000, 7, frame];
        assert!(!ways.answered(0, &answer), "nothing was asked");
        let mut words = [0; 16];
        let request = ways.ask(8, &mut words).unwrap();
        let packet = Packet::new_checked(request).unwrap();
        assert_eq!(packet.records().map(|r| r.writes.len()).sum::<usize>(), 0);
        let _ = ways.ask(9, &mut words);
        assert!(!ways.answered(8, &answer), "an old question");
        assert!(!ways.answered(9, &answer[..1]), "a receipt has one word");
        assert_eq!(hal.get::<u32>("b.exchange.fast-way"), 0);
        assert!(ways.answered(9, &answer));
        assert!(!ways.answered(9, &answer), "it came twice");
        assert_eq!(hal.get::<u32>("b.exchange.fast-way"), 1000);
        assert_eq!(hal.get::<u32>("b.exchange.long-way"), 7);
        assert_eq!(hal.get::<u32>("b.exchange.long-way-reason"), frame);
    }
}
