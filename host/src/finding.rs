//! What was looked at, and what comes of it: the findings of [`crate::selftest`] and
//! [`crate::doctor`], as text and as JSON.

use serde_json::{Value, json};

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
    /// What makes the remedy outlast a restart of the computer; empty if it does so by itself.
    pub lasting: String,
}

impl Finding {
    pub(crate) fn new(
        verdict: Verdict,
        check: &str,
        fact: impl Into<String>,
        why: &str,
        what: &str,
    ) -> Self {
        Finding {
            check: check.to_owned(),
            fact: fact.into(),
            verdict,
            reason: why.to_owned(),
            remedy: what.to_owned(),
            lasting: String::new(),
        }
    }

    pub(crate) fn good(check: &str, fact: impl Into<String>) -> Self {
        Finding::new(Verdict::Good, check, fact, "", "")
    }

    pub(crate) fn note(check: &str, fact: impl Into<String>, reason: &str, remedy: &str) -> Self {
        Finding::new(Verdict::Note, check, fact, reason, remedy)
    }

    pub(crate) fn bad(check: &str, fact: impl Into<String>, reason: &str, remedy: &str) -> Self {
        Finding::new(Verdict::Bad, check, fact, reason, remedy)
    }

    pub(crate) fn skipped(
        check: &str,
        fact: impl Into<String>,
        reason: &str,
        remedy: &str,
    ) -> Self {
        Finding::new(Verdict::Skipped, check, fact, reason, remedy)
    }

    /// With what makes the remedy stay.
    pub(crate) fn lasting(mut self, how: impl Into<String>) -> Self {
        self.lasting = how.into();
        self
    }
}

/// What was found, in the order in which it was looked for.
#[derive(Clone, Debug, Default)]
pub struct Report {
    /// What the head describes, as JSON names it: `board` or `computer`.
    pub about: &'static str,
    /// What kind of board or computer it is, as name and value.
    pub head: Vec<(&'static str, String)>,
    /// The findings.
    pub findings: Vec<Finding>,
}

impl Report {
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
                    "lasting": finding.lasting,
                })
            })
            .collect();
        json!({
            self.about: head.collect::<serde_json::Map<_, _>>(),
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
            text += &format!("{verdict:<8} {:<26} {}\n", finding.check, finding.fact);
            for (what, line) in [
                ("why", &finding.reason),
                ("do", &finding.remedy),
                ("keep", &finding.lasting),
            ] {
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

/// A report to send to others: without hardware addresses.
pub fn without_macs(text: &str) -> String {
    let is_mac = |word: &str| {
        let bytes: Vec<_> = word.split(':').collect();
        bytes.len() == 6
            && bytes
                .iter()
                .all(|byte| byte.len() == 2 && u8::from_str_radix(byte, 16).is_ok())
    };
    let words = text
        .split(' ')
        .map(|word| if is_mac(word) { "MAC" } else { word });
    words.collect::<Vec<_>>().join(" ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_report_says_verdict_fact_reason_and_remedy() {
        let report = Report {
            about: "board",
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
