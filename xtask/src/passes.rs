//! The numbers in the lines of benches and proofs that begin with PASS, as a report:
//! `PASS stepgen: 20 pulses, gate in 3 clocks` is `{"stepgen": {"# pulses": 20, "gate in # clocks":
//! 3}}`. So a figure of docs/figures.json names a number by the words beside it.

use crate::target;
use anyhow::{Context, Result};
use serde_json::{Map, Value};

/// Writes `target/reports/NAME.json`.
pub fn report(name: &str, lines: &[&str]) -> Result<()> {
    let file = target(&format!("reports/{name}.json"));
    std::fs::create_dir_all(target("reports")).context("no target/reports")?;
    let report: Map<String, Value> = lines.iter().filter_map(|line| numbers(line)).collect();
    std::fs::write(&file, format!("{:#}\n", Value::from(report)))
        .with_context(|| format!("cannot write {}", file.display()))
}

/// The name in a line, and each of its parts that has one number, by its other words.
fn numbers(line: &str) -> Option<(String, Value)> {
    let (name, rest) = line.strip_prefix("PASS ")?.split_once(": ")?;
    let mut found = Map::new();
    for part in rest.split([',', ';', ':']) {
        let words: Vec<&str> = part.split_whitespace().collect();
        let mut numbers = words.iter().filter_map(|word| word.parse::<u64>().ok());
        let (Some(number), None) = (numbers.next(), numbers.next()) else {
            continue;
        };
        let without = |word: &&str| match word.parse::<u64>() {
            Ok(_) => "#".to_owned(),
            Err(_) => (*word).to_owned(),
        };
        let words: Vec<String> = words.iter().map(without).collect();
        found.insert(words.join(" "), number.into());
    }
    Some((name.to_owned(), found.into()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn a_number_is_named_by_the_words_beside_it() {
        let line = "PASS safety: 25 bites, timeout + 1 clocks each; gate in 3, 8.7 Mclk in 0.9 s";
        let wanted = json!({"# bites": 25, "timeout + # clocks each": 1, "gate in #": 3});
        assert_eq!(numbers(line), Some(("safety".to_owned(), wanted)));
        assert_eq!(numbers("FAIL safety: 25 bites"), None);
    }
}
