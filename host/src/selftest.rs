//! The self-test for the first power-up: tests a board and its wiring before they drive a machine.
//!
//! Two halves. The checks ([`board`], [`flash`], [`link`], [`ways`], [`clock`], [`loops`]) are
//! pure: facts go in, [`Finding`]s come out, each with the fact, a verdict, its reason and a
//! remedy. [`gather`] asks a board for the facts and changes nothing; [`drive`] arms it, and drives
//! only what was asked for.
//!
//! A report is meant to be sent to others, so it holds nothing that identifies a single board: no
//! unique id (a MAC address is made from it), no MAC address, no key, no IP address, no name.

pub mod board;
pub mod clock;
pub mod drive;
pub mod flash;
pub mod gather;
pub mod link;
pub mod loops;
pub mod run;
pub mod ways;

use crate::client::Identity;
use serde_json::{Value, json};
use std::time::{Duration, Instant};
use wire::board::Kind;

/// The verdict on a fact.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Verdict {
    /// As it should be.
    Good,
    /// Not looked at, and why.
    Skipped,
    /// Works, and is worth knowing.
    Note,
    /// Wrong.
    Bad,
}

impl Verdict {
    /// As reports say it.
    pub const fn text(self) -> &'static str {
        match self {
            Verdict::Good => "good",
            Verdict::Skipped => "skipped",
            Verdict::Note => "note",
            Verdict::Bad => "BAD",
        }
    }
}

/// One thing looked at.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Finding {
    /// What was looked at.
    pub check: String,
    /// What was found.
    pub fact: String,
    /// The verdict on it.
    pub verdict: Verdict,
    /// Why; empty when it is good.
    pub reason: String,
    /// What to do; empty when there is nothing to be done.
    pub remedy: String,
}

impl Finding {
    fn new(verdict: Verdict, check: &str, fact: impl Into<String>, why: &str, what: &str) -> Self {
        Finding {
            check: check.to_owned(),
            fact: fact.into(),
            verdict,
            reason: why.to_owned(),
            remedy: what.to_owned(),
        }
    }

    fn good(check: &str, fact: impl Into<String>) -> Self {
        Finding::new(Verdict::Good, check, fact, "", "")
    }

    fn note(check: &str, fact: impl Into<String>, reason: &str, remedy: &str) -> Self {
        Finding::new(Verdict::Note, check, fact, reason, remedy)
    }

    fn bad(check: &str, fact: impl Into<String>, reason: &str, remedy: &str) -> Self {
        Finding::new(Verdict::Bad, check, fact, reason, remedy)
    }

    fn skipped(check: &str, fact: impl Into<String>, reason: &str, remedy: &str) -> Self {
        Finding::new(Verdict::Skipped, check, fact, reason, remedy)
    }
}

/// What was found, in the order in which it was looked for.
#[derive(Clone, Debug, Default)]
pub struct Report {
    /// What kind of board it is, as name and value.
    pub head: Vec<(&'static str, String)>,
    /// The findings.
    pub findings: Vec<Finding>,
}

impl Report {
    /// Of this board, with nothing found yet.
    pub fn of(identity: &Identity) -> Self {
        let (describe, blob) = (&identity.describe, identity.blob());
        let text = |kind| blob.text(kind, 0).unwrap_or("unnamed").to_owned();
        let version = |word: u32| format!("{}.{}.{}", word >> 16, word >> 8 & 0xff, word & 0xff);
        let c = describe.channels;
        Report {
            head: vec![
                ("tool", env!("CARGO_PKG_VERSION").to_owned()),
                ("board", text(Kind::Board)),
                ("configuration", text(Kind::Configuration)),
                ("platform", text(Kind::Platform)),
                ("fpga", text(Kind::Fpga)),
                ("firmware", version(describe.firmware_version)),
                ("gateware", version(describe.gateware_version)),
                ("abi", format!("{:#010x}", describe.abi_gateware)),
                ("clock_hz", describe.clock_hz.to_string()),
                (
                    "channels",
                    format!(
                        "{} stepgens, {} encoders, {} PWMs, {} inputs, {} outputs",
                        c.stepgens, c.encoders, c.pwms, c.inputs, c.outputs
                    ),
                ),
            ],
            findings: Vec::new(),
        }
    }

    /// The worst there is.
    pub fn worst(&self) -> Verdict {
        let all = self.findings.iter().map(|finding| finding.verdict);
        all.max().unwrap_or(Verdict::Skipped)
    }

    /// How many have this verdict.
    pub fn count(&self, verdict: Verdict) -> usize {
        let all = self.findings.iter();
        all.filter(|finding| finding.verdict == verdict).count()
    }

    /// For other programs.
    pub fn to_json(&self) -> Value {
        let head = self
            .head
            .iter()
            .map(|(name, value)| ((*name).to_owned(), json!(value)));
        let findings: Vec<Value> = self
            .findings
            .iter()
            .map(|finding| {
                json!({
                    "check": finding.check,
                    "fact": finding.fact,
                    "verdict": finding.verdict.text().to_lowercase(),
                    "reason": finding.reason,
                    "remedy": finding.remedy,
                })
            })
            .collect();
        json!({
            "board": head.collect::<serde_json::Map<_, _>>(),
            "findings": findings,
            "bad": self.count(Verdict::Bad),
        })
    }

    /// For people.
    pub fn to_text(&self) -> String {
        let mut text = String::new();
        for (name, value) in &self.head {
            text += &format!("{name:<14} {value}\n");
        }
        text += "\n";
        for finding in &self.findings {
            let verdict = finding.verdict.text();
            text += &format!("{verdict:<8} {:<22} {}\n", finding.check, finding.fact);
            for (what, line) in [("why", &finding.reason), ("do", &finding.remedy)] {
                if !line.is_empty() {
                    text += &format!("{:<8} {what:>6}: {line}\n", "");
                }
            }
        }
        let [good, note, skipped, bad] =
            [Verdict::Good, Verdict::Note, Verdict::Skipped, Verdict::Bad].map(|v| self.count(v));
        text += &format!("\n{good} good, {note} to know, {skipped} skipped, {bad} bad\n");
        text
    }
}

/// The host's clock. A test has its own clock, so that its board and its clock agree on a busy
/// computer, too.
pub trait Time {
    /// Monotonic time since any moment.
    fn now(&mut self) -> Duration;
    /// Lets so much of it pass.
    fn pause(&mut self, time: Duration);
}

/// This computer's.
#[derive(Clone, Copy, Debug)]
pub struct Wall(Instant);

impl Default for Wall {
    fn default() -> Self {
        Wall(Instant::now())
    }
}

impl Time for Wall {
    fn now(&mut self) -> Duration {
        self.0.elapsed()
    }

    fn pause(&mut self, time: Duration) {
        std::thread::sleep(time);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_report_says_verdict_fact_reason_and_remedy() {
        let report = Report {
            head: vec![("board", "b".into())],
            findings: vec![
                Finding::good("clock", "60 MHz"),
                Finding::bad("link", "half duplex", "collisions", "another switch"),
            ],
        };
        assert_eq!(report.worst(), Verdict::Bad);
        let text = report.to_text();
        for part in [
            "good     clock ",
            "BAD      link ",
            "why: collisions",
            "do: another switch",
            "1 good, 0 to know, 0 skipped, 1 bad",
        ] {
            assert!(text.contains(part), "{part}: {text}");
        }
        let json = report.to_json();
        assert_eq!(json["bad"], 1);
        assert_eq!(json["findings"][1]["remedy"], "another switch");
    }
}
