//! What the board itself says: its release, and which way exchanges take.

use crate::client::Client;
use crate::finding::Finding;
use crate::selftest::{gather, ways};

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
    if let Ok(facts) = gather::ways(client) {
        findings.push(ways::judge(&facts));
    }
    findings
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
    fn board_and_tool_are_of_one_release() {
        assert_eq!(release(0x01_0203, "1.2.3").verdict, Good);
        let other = release(0x01_0203, "1.2.4");
        assert_eq!(other.verdict, Note);
        assert!(other.fact.contains("board 1.2.3, tool 1.2.4"));
    }
}
