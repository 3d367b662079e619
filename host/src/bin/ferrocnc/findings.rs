//! Shows the findings of `selftest` and `doctor`.

use anyhow::{Context, Result, bail};
use ferrocnc::finding::{Report, Verdict, without_macs};
use serde_json::Value;
use std::io::Write;
use std::path::Path;

/// Prints a report, and writes it into a file for others; JSON if the name ends in `.json`. An
/// error if a finding is bad.
pub(crate) fn tell(report: &Report, file: Option<&Path>, as_json: bool) -> Result<()> {
    tell_as(report, &report.to_text(), &report.to_json(), file, as_json)
}

/// The same with a text and a JSON that say more than the report.
pub(crate) fn tell_as(
    report: &Report,
    text: &str,
    json: &Value,
    file: Option<&Path>,
    as_json: bool,
) -> Result<()> {
    let json = format!("{json:#}\n");
    if let Some(file) = file {
        let wants_json = as_json || file.extension().is_some_and(|ending| ending == "json");
        let report = without_macs(if wants_json { &json } else { text });
        std::fs::write(file, report).with_context(|| format!("cannot write {}", file.display()))?;
    }
    std::io::stdout()
        .lock()
        .write_all(if as_json { &json } else { text }.as_bytes())?;
    match report.count(Verdict::Bad) {
        0 => Ok(()),
        bad => bail!(
            "{bad} of {} findings are bad; each says what to do",
            report.findings.len()
        ),
    }
}
