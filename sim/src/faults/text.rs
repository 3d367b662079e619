//! Parses and prints fault plans: `loss=0.1% to-board:delay=1ms..3ms pull@2s..4s seed=7`.

use std::fmt;
use std::str::FromStr;
use std::time::Duration;

use super::{Direction, Ends, Kind, Plan, Rule};

/// All words of a plan, for `--help` and for error messages.
pub const WORDS: &str = "loss=P drop=N dup=P reorder=P delay=TIME[..TIME] corrupt=P truncate=P rate=BITS pull plug host-pause freeze reboot power \
                         off seed=N; P as 0.01 or 1%, TIME as 2s, 1.5ms or 20us, BITS as 10Mbit; in front to-board: or \
                         from-board:, behind @TIME or @TIME..TIME";

/// Why a plan is refused.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{word:?}: {why}")]
pub struct Rejected {
    /// The word.
    pub word: String,
    /// What is wrong, and what would be right.
    pub why: String,
}

fn probability(text: &str) -> Result<f64, String> {
    let (number, scale) = match text.strip_suffix('%') {
        Some(percent) => (percent, 100.0),
        None => (text, 1.0),
    };
    match number.parse::<f64>().map(|p| p / scale) {
        Ok(p) if (0.0..=1.0).contains(&p) => Ok(p),
        _ => Err(format!(
            "{text:?} is not a probability; write 0 to 1, or a percentage such as 0.1%"
        )),
    }
}

fn time(text: &str) -> Result<Duration, String> {
    let wrong = || format!("{text:?} is not a time; write for example 2s, 1.5ms, 20us or 500ns");
    let split = text
        .find(|c: char| c.is_ascii_alphabetic())
        .ok_or_else(wrong)?;
    let (number, unit) = text.split_at(split);
    let nanoseconds = match unit {
        "h" => 3.6e12,
        "min" => 6e10,
        "s" => 1e9,
        "ms" => 1e6,
        "us" => 1e3,
        "ns" => 1.0,
        _ => return Err(wrong()),
    };
    let number: f64 = number.parse().map_err(|_| wrong())?;
    // A week, so that clocks stay far from 2^63.
    if !(0.0..=604_800e9).contains(&(number * nanoseconds)) {
        return Err(format!(
            "{text:?} is not between 0 and a week; say for instance 2s"
        ));
    }
    Ok(Duration::from_nanos((number * nanoseconds).round() as u64))
}

fn range(text: &str) -> Result<(Duration, Option<Duration>), String> {
    let Some((from, to)) = text.split_once("..") else {
        return Ok((time(text)?, None));
    };
    let (from, to) = (time(from)?, time(to)?);
    if from >= to {
        return Err(format!(
            "{text:?} ends before it begins; say the earlier time first"
        ));
    }
    Ok((from, Some(to)))
}

fn rate(text: &str) -> Result<u64, String> {
    let wrong = || format!("{text:?} is not a rate; write for example 10Mbit, 500kbit or 9600bit");
    let number = text.strip_suffix("bit").ok_or_else(wrong)?;
    let (number, scale) = match number.as_bytes().last() {
        Some(b'k') => (&number[..number.len() - 1], 1e3),
        Some(b'M') => (&number[..number.len() - 1], 1e6),
        Some(b'G') => (&number[..number.len() - 1], 1e9),
        _ => (number, 1.0),
    };
    match number.parse::<f64>().map(|n| n * scale) {
        Ok(bits) if (1.0..=1e10).contains(&bits) => Ok(bits as u64),
        _ => Err(wrong()),
    }
}

fn kind(name: &str, value: Option<&str>) -> Result<Kind, String> {
    let given = || value.ok_or(format!("how much? say {name}=..., as in {WORDS}"));
    let kind = match name {
        "loss" => Kind::Loss(probability(given()?)?),
        "drop" => {
            let n = given()?;
            let n = n.parse();
            Kind::Drop(n.map_err(|_| "drop needs a number of frames, as in drop=3".to_string())?)
        }
        "dup" => Kind::Duplicate(probability(given()?)?),
        "reorder" => Kind::Reorder(probability(given()?)?),
        "corrupt" => Kind::Corrupt(probability(given()?)?),
        "truncate" => Kind::Truncate(probability(given()?)?),
        "rate" => Kind::Rate(rate(given()?)?),
        "delay" => {
            let (from, to) = range(given()?)?;
            Kind::Delay(from, to.unwrap_or(from))
        }
        _ => {
            let kind = match name {
                "pull" => Kind::Pull,
                "host-pause" => Kind::HostPause,
                "freeze" => Kind::Freeze,
                "reboot" => Kind::Reboot,
                "power" => Kind::Power,
                _ => return Err(format!("no such fault; there are {WORDS}")),
            };
            if value.is_some() {
                return Err(format!(
                    "{name} takes no value; give its time as {name}@2s..4s"
                ));
            }
            kind
        }
    };
    Ok(kind)
}

impl FromStr for Rule {
    type Err = String;

    fn from_str(word: &str) -> Result<Self, String> {
        let (direction, rest) = match word.split_once(':') {
            Some(("to-board", rest)) => (Some(Direction::ToBoard), rest),
            Some(("from-board", rest)) => (Some(Direction::FromBoard), rest),
            Some((other, _)) => {
                return Err(format!(
                    "{other:?} is not a direction; write to-board: or from-board:, or nothing for both"
                ));
            }
            None => (None, word),
        };
        let (what, when) = match rest.split_once('@') {
            Some((what, when)) => (what, Some(range(when)?)),
            None => (rest, None),
        };
        let (name, value) = match what.split_once('=') {
            Some((name, value)) => (name, Some(value)),
            None => (what, None),
        };
        let kind = kind(name, value)?;
        match (kind, direction, when) {
            (
                Kind::Reboot | Kind::Power | Kind::Freeze | Kind::Pull | Kind::HostPause,
                Some(_),
                _,
            ) => Err(format!(
                "{name} has no direction; remove to-board: or from-board:"
            )),
            (Kind::Reboot | Kind::Power, _, Some((_, Some(_)))) => {
                Err(format!("{name} is a moment; say {name}@3s"))
            }
            (Kind::HostPause, _, Some((_, None)) | None) => Err(format!(
                "a pause needs an end (without one it is a pulled cable); write {name}@2s..3s"
            )),
            _ => Ok(Rule {
                kind,
                direction,
                window: when,
            }),
        }
    }
}

impl FromStr for Plan {
    type Err = Rejected;

    fn from_str(text: &str) -> Result<Self, Rejected> {
        let mut plan = Plan::default();
        for word in text.split([' ', ',', '\t']).filter(|word| !word.is_empty()) {
            let rejected = |why: String| Rejected {
                word: word.into(),
                why,
            };
            match word.split_once('=') {
                Some(("seed", seed)) => {
                    let seed = seed.parse();
                    plan.seed = Some(
                        seed.map_err(|_| rejected("a seed is a whole number, as seed=7".into()))?,
                    );
                }
                _ if word == "off" => {
                    plan.rules.clear();
                    plan.ends = Some(Ends::Everything);
                }
                _ if word == "plug" => {
                    plan.rules.retain(|rule| rule.kind != Kind::Pull);
                    plan.ends = plan.ends.or(Some(Ends::Pull));
                }
                _ => plan.rules.push(word.parse().map_err(rejected)?),
            }
        }
        Ok(plan)
    }
}

impl fmt::Display for Rule {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.direction {
            Some(Direction::ToBoard) => write!(f, "to-board:")?,
            Some(Direction::FromBoard) => write!(f, "from-board:")?,
            None => {}
        }
        match self.kind {
            Kind::Loss(p) => write!(f, "loss={p}")?,
            Kind::Drop(n) => write!(f, "drop={n}")?,
            Kind::Duplicate(p) => write!(f, "dup={p}")?,
            Kind::Reorder(p) => write!(f, "reorder={p}")?,
            Kind::Delay(from, to) if from == to => write!(f, "delay={}", Time(from))?,
            Kind::Delay(from, to) => write!(f, "delay={}..{}", Time(from), Time(to))?,
            Kind::Corrupt(p) => write!(f, "corrupt={p}")?,
            Kind::Truncate(p) => write!(f, "truncate={p}")?,
            Kind::Rate(bits) => write!(f, "rate={bits}bit")?,
            Kind::Pull => write!(f, "pull")?,
            Kind::HostPause => write!(f, "host-pause")?,
            Kind::Freeze => write!(f, "freeze")?,
            Kind::Reboot => write!(f, "reboot")?,
            Kind::Power => write!(f, "power")?,
        }
        match self.window {
            Some((from, Some(to))) => write!(f, "@{}..{}", Time(from), Time(to)),
            Some((from, None)) => write!(f, "@{}", Time(from)),
            None => Ok(()),
        }
    }
}

/// A time as [`time`] reads it.
struct Time(Duration);

impl fmt::Display for Time {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let ns = self.0.as_nanos();
        let units = [
            ("s", 1_000_000_000),
            ("ms", 1_000_000),
            ("us", 1000),
            ("ns", 1),
        ];
        let whole = units.iter().find(|(_, unit)| ns.is_multiple_of(*unit));
        let (name, unit) = whole.unwrap_or(&units[3]);
        write!(f, "{}{name}", ns / unit)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_typed_is_what_is_told() {
        for word in [
            "loss=0.01",
            "to-board:dup=0.5",
            "from-board:delay=1ms..3ms",
            "delay=20us",
            "corrupt=1@2s..4s",
            "rate=10000000bit",
            "pull@1500ms",
            "host-pause@1s..2s",
            "freeze",
            "reboot@3s",
            "power",
            "drop=7",
        ] {
            assert_eq!(
                word.parse::<Rule>().map(|rule| rule.to_string()),
                Ok(word.into())
            );
        }
    }

    #[test]
    fn words_may_stand_in_one_line_or_behind_commas() {
        let plan: Plan = "loss=1%, seed=7 pull@2s..4s".parse().unwrap();
        assert_eq!((plan.seed, plan.rules.len()), (Some(7), 2));
        assert_eq!(plan.rules[0].kind, Kind::Loss(0.01));
        assert_eq!("".parse::<Plan>(), Ok(Plan::default()));
    }

    #[test]
    fn a_wrong_word_is_named_with_its_remedy() {
        for (text, remedy) in [
            ("loss", "say loss=..."),
            ("loss=2", "0 to 1"),
            ("loss=x", "0.1%"),
            ("loss=-1", "0 to 1"),
            ("loss=nan", "0 to 1"),
            ("los=1", "there are loss=P"),
            ("sideways:loss=1", "to-board:"),
            ("pull@2", "2s"),
            ("pull@4s..2s", "earlier time first"),
            ("pull=3", "pull@2s..4s"),
            ("reboot@1s..2s", "reboot@3s"),
            ("to-board:reboot", "remove to-board:"),
            ("host-pause", "host-pause@2s..3s"),
            ("delay=1..2", "1.5ms"),
            ("delay=9000000s", "a week"),
            ("rate=10", "10Mbit"),
            ("rate=0bit", "10Mbit"),
            ("drop=-1", "drop=3"),
            ("seed=x", "seed=7"),
        ] {
            let error = text.parse::<Plan>().unwrap_err();
            assert_eq!(error.word, text);
            assert!(error.to_string().contains(remedy), "{text}: {error}");
        }
    }
}
