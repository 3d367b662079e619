//! `ferrocnc doctor`: what of this computer makes exchanges late or loses them.

use crate::findings;
use anyhow::Result;
use clap::Args;
use ferrocnc::doctor::system::System;
use ferrocnc::doctor::{Subject, board, examine};
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
        report.findings.extend(board::examine(&mut client));
    }
    findings::tell(&report, arguments.report.as_deref(), as_json)
}
