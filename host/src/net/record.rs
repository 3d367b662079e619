//! What undoes a setup, written down before its first step.

use serde_json::{Value, json};

/// A step back.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Undo {
    /// The file goes, if it is there.
    Remove(String),
    /// The program runs.
    Run(Vec<String>),
}

impl core::fmt::Display for Undo {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Undo::Remove(path) => write!(f, "remove /{path}"),
            Undo::Run(words) => write!(f, "run    {}", shown(words)),
        }
    }
}

/// A command as it would be typed.
pub fn shown(words: &[String]) -> String {
    let plain = |c: char| c.is_ascii_alphanumeric() || "-_./:=,".contains(c);
    let quoted = words.iter().map(|word| match word.chars().all(plain) {
        true => word.clone(),
        false => format!("'{}'", word.replace('\'', r"'\''")),
    });
    quoted.collect::<Vec<_>>().join(" ")
}

/// All of them, in order.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Record(pub Vec<Undo>);

impl Record {
    /// As a file.
    pub fn to_text(&self) -> String {
        let steps = self.0.iter().map(|step| match step {
            Undo::Remove(path) => json!({ "remove": path }),
            Undo::Run(words) => json!({ "run": words }),
        });
        format!("{:#}\n", json!({ "undo": steps.collect::<Vec<_>>() }))
    }

    /// From a file; an error says what to do.
    pub fn parse(text: &str) -> Result<Self, String> {
        let whole: Option<Value> = serde_json::from_str(text).ok();
        let steps = whole.as_ref().and_then(|it| it["undo"].as_array());
        let steps = steps.and_then(|steps| steps.iter().map(step).collect::<Option<Vec<_>>>());
        steps.map(Record).ok_or_else(|| {
            "is damaged: it said how to undo an earlier setup; undo that by hand, then remove the file"
                .to_owned()
        })
    }
}

fn step(value: &Value) -> Option<Undo> {
    if let Some(path) = value["remove"].as_str() {
        return Some(Undo::Remove(path.to_owned()));
    }
    let words = value["run"].as_array()?.iter();
    let words: Option<Vec<_>> = words.map(|word| Some(word.as_str()?.to_owned())).collect();
    words.filter(|words| !words.is_empty()).map(Undo::Run)
}
