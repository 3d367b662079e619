//! `ferrocnc doctor`: what of this computer makes exchanges late or loses them.

use anyhow::{Context, Result, bail};
use clap::Args;
use ferrocnc::doctor::system::System;
use ferrocnc::doctor::{Subject, card, examine, without_macs};
use ferrocnc::finding::Verdict;
use std::io::Write;
use std::path::PathBuf;

#[derive(Args)]
pub(crate) struct Doctor {
    /// IP[:port] of the board: the port that leads to it is looked at, and the board itself.
    #[arg(value_name = "BOARD")]
    address: Option<String>,
    /// This port, whatever leads to the board.
    #[arg(long, value_name = "IF")]
    interface: Option<String>,
    /// Write the report there as well, without MAC addresses; JSON if the name ends in .json.
    #[arg(long, value_name = "FILE")]
    report: Option<PathBuf>,
}

pub(crate) fn run(arguments: &Doctor, as_json: bool) -> Result<()> {
    let client = arguments.address.as_deref().map(crate::open).transpose()?;
    let subject = Subject {
        board: client.as_ref().map(|client| *client.address().socket.ip()),
        interface: arguments.interface.clone(),
    };
    let mut report = examine(&System::real(), &subject);
    if let Some(mut client) = client {
        report.findings.extend(card::examine(&mut client));
    }
    let (text, json) = (report.to_text(), format!("{:#}\n", report.to_json()));
    if let Some(file) = &arguments.report {
        let wants_json = as_json || file.extension().is_some_and(|ending| ending == "json");
        let report = without_macs(if wants_json { &json } else { &text });
        std::fs::write(file, report).with_context(|| format!("cannot write {}", file.display()))?;
    }
    std::io::stdout()
        .lock()
        .write_all(if as_json { &json } else { &text }.as_bytes())?;
    match report.count(Verdict::Bad) {
        0 => Ok(()),
        bad => bail!(
            "{bad} of {} findings are bad; each says what to do",
            report.findings.len()
        ),
    }
}
