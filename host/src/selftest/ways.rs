//! Checks which way the exchanges took since the board started: its gateware answers most of them
//! by itself, in some 20 clocks. One that is not as its firmware expected goes the long way through
//! the firmware, in some 3600: right, but later.

use super::Finding;
use wire::LongWay;

/// The first exchanges of a session have no pass, nor have those that arm; five sessions have about
/// this many.
const FEW: u32 = 50;

/// The facts, since the board started.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Facts {
    /// Exchanges the gateware executed and answered.
    pub fast: u32,
    /// Those that took the long way.
    pub long: u32,
    /// Why the last of these did; none for a code that this tool does not know.
    pub why: Option<LongWay>,
}

impl Facts {
    /// From the counters window, [`wire::refusal::COUNTERS_WAYS`].
    pub fn from_words([fast, long, why]: [u32; 3]) -> Self {
        let why = LongWay::from_code(why);
        Facts { fast, long, why }
    }

    /// Why the last one took the long way, for people.
    pub fn text(&self) -> &'static str {
        self.why
            .map_or("for a reason this tool does not know", LongWay::text)
    }
}

impl core::fmt::Display for Facts {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(f, "{} the fast way, {} the long way", self.fast, self.long)?;
        match self.long {
            0 => Ok(()),
            _ => write!(f, " (the last: {})", self.text()),
        }
    }
}

/// Judges them.
pub fn judge(facts: &Facts) -> Finding {
    let (check, fact) = ("exchanges", facts.to_string());
    if (facts.fast, facts.long) == (0, 0) {
        return Finding::skipped(
            check,
            "none since the board started",
            "no host has driven it",
            "let LinuxCNC run for a minute, stop it, and test again",
        );
    }
    if facts.long <= FEW || facts.long <= facts.fast {
        return Finding::good(check, fact);
    }
    let reason = "most took the long way: their answers come later, and what the board does beside them gets less time";
    Finding::note(check, fact, reason, remedy(facts.why))
}

fn remedy(why: Option<LongWay>) -> &'static str {
    match why {
        None => "use a `ferrocnc` of the board's version",
        Some(LongWay::None) => "restart the board; if it stays, report it with this text",
        Some(LongWay::NoPass) => {
            "leave the board time between two exchanges: a longer servo period, no second program that asks it (`watch`, \
             `console`) meanwhile"
        }
        Some(LongWay::Sequence) => {
            "frames get lost: another cable and port, no Wi-Fi; look at packet-error-total"
        }
        Some(LongWay::Flags) => {
            "hold `enable` and `enable-request` instead of changing them in every period"
        }
        Some(LongWay::Timed) => {
            "make apply-delay-ns shorter than the servo period, or 0 for a board alone"
        }
        Some(LongWay::Frame) => {
            "the host changes TOS or TTL from frame to frame: remove the rules for this interface (iptables, nft, tc), and no router \
             or VPN between"
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::selftest::Verdict::{Good, Note, Skipped};
    use std::collections::BTreeSet;

    #[test]
    fn only_a_board_that_takes_the_long_way_mostly_is_told_of() {
        for (fast, long, verdict) in [
            (0, 0, Skipped),
            (0, FEW, Good),
            (0, FEW + 1, Note),
            (60, 61, Note),
            (61, 61, Good),
            (u32::MAX, 100, Good),
            (0, u32::MAX, Note),
        ] {
            let found = judge(&Facts::from_words([fast, long, LongWay::Frame as u32]));
            assert_eq!(found.verdict, verdict, "{fast} fast, {long} long");
            assert_eq!(
                found.remedy.contains("TOS or TTL"),
                verdict == Note,
                "{found:?}"
            );
        }
    }

    #[test]
    fn every_reason_has_a_remedy_of_its_own() {
        let mut seen = BTreeSet::new();
        for code in 0..=LongWay::ALL.len() as u32 {
            let found = judge(&Facts::from_words([1, 1000, code]));
            assert!(seen.insert(found.remedy.clone()), "{}", found.remedy);
            assert!(found.fact.starts_with("1 the fast way, 1000 the long way"));
        }
    }
}
