//! The same for a page: the questions of `machine new` with the answers that a text has, and the
//! files that `machine write` would write. Nothing is read or written but boards and platforms.

use super::new::{self, AXIS, MACHINE, Question};
use super::{INSTALLED, look_at};
use crate::config;
use anyhow::Result;
use ferrocnc_config::pinout::Pinout;
use ferrocnc_config::{Board, Error, read_board};
use ferrocnc_machine::plan::{Files, Wishes};
use ferrocnc_machine::template::{Slot, TEMPLATES};
use serde::Deserialize;
use serde_json::{Value, json};
use std::path::Path;

/// A machine with nothing beside it.
struct Alone;

impl Files for Alone {
    fn text(&self, _: &str) -> Result<Option<String>, Error> {
        Ok(None)
    }

    fn board(&self, name: &str) -> Result<Board, Error> {
        read_board(&Path::new(INSTALLED).join(name))
    }
}

/// The samples and what they are.
pub(crate) fn samples() -> Value {
    let samples = TEMPLATES.iter();
    let samples = samples.map(|(name, about, _)| json!({ "name": name, "about": about }));
    samples.collect()
}

/// Which sample.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Sample {
    sample: String,
}

impl Sample {
    /// Its text.
    pub(crate) fn text(&self) -> Result<String> {
        new::sample(&self.sample)
    }
}

/// The questions, each with the answer that the text has.
pub(crate) fn questions(text: &str) -> Vec<Value> {
    let mut asked = Vec::new();
    let mut ask = |number: usize, group: &str, Question { table, key, asks }: &Question| {
        let slot = Slot { table, number, key };
        if let Some(value) = slot.get(text) {
            asked.push(json!({
                "table": table, "number": number, "key": key, "group": group, "asks": asks,
                "value": value.trim_matches('"'),
            }));
        }
    };
    for question in &MACHINE {
        ask(0, "The machine", question);
    }
    for number in 0.. {
        let Some(letter) = new::letter(text, number) else {
            break;
        };
        for question in &AXIS {
            ask(number, &format!("Axis {letter}"), question);
        }
    }
    asked
}

/// An answer.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Answer {
    toml: String,
    table: String,
    number: usize,
    key: String,
    value: String,
}

/// The text with this answer, or why it cannot be read.
pub(crate) fn put(answer: &Answer) -> Result<String> {
    let Answer {
        toml,
        table,
        number,
        key,
        value,
    } = answer;
    new::put(toml, table, *number, key, value)
}

/// What `machine check` says of it, what `machine write` would write into an empty folder, and the
/// card.
pub(crate) fn judged(toml: &str) -> Value {
    let told = look_at(Path::new("machine.toml"), toml, &Alone, Wishes::default());
    let mut json = told.to_json();
    if let Some(plan) = &told.plan {
        let files = plan.changes.iter();
        let files = files.map(|change| json!({ "name": change.name, "text": change.after }));
        json["files"] = files.collect();
        json["drawing"] = config::pinout_to_json(&Pinout::of_board(&plan.board));
    }
    json
}

#[cfg(test)]
mod tests {
    use super::{judged, put, questions};
    use ferrocnc_machine::template::TEMPLATES;

    #[test]
    fn every_sample_has_questions_with_answers_and_files() {
        for (name, _, text) in TEMPLATES {
            let asked = questions(text);
            assert!(asked.len() >= 10, "{name}: {}", asked.len());
            assert!(asked.iter().all(|it| it["value"].is_string()), "{name}");
            let judged = judged(text);
            assert_eq!(judged["ok"], true, "{name}: {judged}");
            let files = judged["files"].as_array().unwrap();
            for ending in [".ini", ".hal", ".toml", ".svg", "-wiring.md"] {
                let has =
                    |file: &serde_json::Value| file["name"].as_str().unwrap().ends_with(ending);
                assert!(files.iter().any(has), "{name}: no {ending}");
            }
        }
    }

    #[test]
    fn an_answer_is_in_the_text_and_one_that_cannot_be_read_changes_nothing() {
        let (_, _, mill) = TEMPLATES[0];
        let answer = |key: &str, value: &str| {
            put(&serde_json::from_value(serde_json::json!({
                "toml": mill, "table": "[[axis]]", "number": 1, "key": key, "value": value,
            }))
            .unwrap())
        };
        let text = answer("pitch", "4").unwrap();
        let lines = text.lines().filter(|line| line.starts_with("pitch = 4"));
        assert_eq!(lines.count(), 1, "{text}");
        let error = answer("pitch", "four").unwrap_err().to_string();
        assert!(error.contains("four"), "{error}");
    }
}
