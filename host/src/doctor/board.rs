//! What the board itself says: its release, and which way exchanges take.

use crate::client::Client;
use crate::finding::Finding;
use crate::selftest::{gather, ways};
use wire::{FaultReason, ResetReason};

/// Asks it. Takes no session and changes nothing.
pub fn examine(client: &mut Client) -> Vec<Finding> {
    let identity = match client.identify() {
        Ok(identity) => identity,
        Err(error) => {
            let remedy = "power it, look at cable and address: ferrocnc discover";
            return vec![Finding::bad(
                "board",
                "no description",
                &error.to_string(),
                remedy,
            )];
        }
    };
    let mut findings = vec![release(
        identity.describe.firmware_version,
        env!("CARGO_PKG_VERSION"),
    )];
    findings.push(restart(identity.describe.reset_reason));
    findings.push(stop(identity.describe.state.reason));
    if let Ok(facts) = gather::ways(client) {
        findings.push(ways::judge(&facts));
    }
    findings
}

fn restart(reason: ResetReason) -> Finding {
    let check = "last start";
    match reason {
        ResetReason::PowerUp | ResetReason::Requested => Finding::good(check, reason.to_string()),
        ResetReason::Panic | ResetReason::Trap | ResetReason::Unknown => Finding::note(
            check,
            reason.to_string(),
            "the firmware failed, or lost its supply for a moment",
            "look at the supply of 5 V; `ferrocnc log BOARD`, and report what it says",
        ),
    }
}

fn stop(reason: FaultReason) -> Finding {
    let check = "last stop";
    match reason {
        FaultReason::None | FaultReason::HostDisable => Finding::good(check, reason.to_string()),
        other => Finding::note(
            check,
            other.to_string(),
            "the machine stopped by itself",
            other.remedy(),
        ),
    }
}

fn release(word: u32, tool: &str) -> Finding {
    let check = "release";
    let board = format!("{}.{}.{}", word >> 16, word >> 8 & 0xff, word & 0xff);
    if board == tool {
        return Finding::good(check, format!("{board}, board and tool"));
    }
    Finding::note(
        check,
        format!("board {board}, tool {tool}"),
        "they are of two releases",
        "ferrocnc update BOARD FILE with the image of the tool's release",
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::finding::Verdict::{Good, Note};

    #[test]
    fn a_start_or_a_stop_that_was_not_asked_for_is_told() {
        for reason in ResetReason::ALL {
            let asked = matches!(reason, ResetReason::PowerUp | ResetReason::Requested);
            assert_eq!(restart(*reason).verdict, if asked { Good } else { Note });
        }
        for reason in FaultReason::ALL {
            let finding = stop(*reason);
            let asked = matches!(reason, FaultReason::None | FaultReason::HostDisable);
            assert_eq!(finding.verdict, if asked { Good } else { Note });
            assert!(asked || finding.remedy == reason.remedy(), "{finding:?}");
        }
    }

    #[test]
    fn board_and_tool_are_of_one_release() {
        assert_eq!(release(0x01_0203, "1.2.3").verdict, Good);
        let other = release(0x01_0203, "1.2.4");
        assert_eq!(other.verdict, Note);
        assert!(other.fact.contains("board 1.2.3, tool 1.2.4"));
    }
}
