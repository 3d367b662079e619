//! What the board itself says: its release and its halves, the image and the settings it runs with,
//! what it refused, its key, its pins' names, and which way exchanges take.

use super::names;
use super::system::System;
use crate::client::Client;
use crate::finding::Finding;
use crate::flash::Overview;
use crate::keys::Keys;
use crate::pins::{Facts, remedy};
use crate::selftest::{board, gather, ways};
use wire::flash::{Origin, Running, Slot};
use wire::pins::Verdict;
use wire::{FaultReason, Refusal, map};

/// Asks it. Takes no session and changes nothing.
pub fn examine(system: &System<'_>, client: &mut Client, keys: &Keys) -> Vec<Finding> {
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
    let describe = &identity.describe;
    let mut findings = vec![release(
        describe.firmware_version,
        env!("CARGO_PKG_VERSION"),
    )];
    if let Ok(facts) = gather::board(client, *describe) {
        findings.extend(board::judge(&facts));
    }
    if let Ok(facts) = Facts::read(client) {
        findings.push(board_file(facts.loaded.verdict));
    }
    findings.push(stop(describe.state.reason));
    if let Ok(overview) = Overview::read(client) {
        findings.extend([
            image(overview.running, overview.selected),
            protection(overview.jedec, overview.protected),
            settings(overview.origin),
        ]);
    }
    if let Ok(counts) = client.read_from(map::COUNTERS_REFUSED, Refusal::COUNT) {
        findings.push(refusals(&counts));
    }
    if let Ok((locked, uid)) = client.locked() {
        findings.push(key(locked, keys.find(uid).is_ok()));
    }
    let pins = names::pins(&identity).unwrap_or_default();
    findings.push(names::examine(system, &pins));
    if let Ok(facts) = gather::ways(client) {
        findings.push(ways::judge(&facts));
    }
    findings
}

fn image(running: Running, selected: Option<Slot>) -> Finding {
    let check = "image that runs";
    let is_selected = match running {
        Running::A => selected == Some(Slot::A),
        Running::B => selected == Some(Slot::B),
        Running::Volatile | Running::Golden => false,
    };
    if is_selected {
        return Finding::good(check, running.text());
    }
    let fact = running.text();
    match running {
        Running::Golden => Finding::bad(
            check,
            fact,
            "the image that was selected did not load, or none was; this one is to repair the board with",
            "ferrocnc update BOARD",
        ),
        Running::Volatile => Finding::note(
            check,
            fact,
            "it is gone at the next power-up",
            "ferrocnc update BOARD, or ferrocnc flash write, to keep one",
        ),
        Running::A | Running::B => Finding::note(
            check,
            fact,
            "another one is selected for the next power-up",
            "power the board off and on, and look whether the machine is in order",
        ),
    }
}

fn protection(jedec: u32, protected: bool) -> Finding {
    let check = "write protection";
    if jedec == 0 {
        return Finding::note(
            check,
            "the board knows no flash",
            "it cannot be updated over the network, and has no settings of its own",
            "look at the flash: ferrocnc selftest BOARD",
        );
    }
    match protected {
        true => Finding::good(check, "the golden image is protected"),
        false => Finding::note(
            check,
            "the golden image is not protected",
            "a firmware that fails can damage the image that repairs the board",
            "ferrocnc update BOARD protects it where the flash can do that",
        ),
    }
}

fn settings(origin: Origin) -> Finding {
    let check = "settings";
    match origin {
        Origin::Copy0 | Origin::Copy1 => Finding::good(check, origin.text()),
        Origin::BuiltIn => Finding::note(
            check,
            origin.text(),
            "none are saved: an update to another board file changes address and name",
            "ferrocnc set saves them: ferrocnc set BOARD --name NAME",
        ),
        Origin::FactoryPin => Finding::note(
            check,
            origin.text(),
            "the saved ones are not used while the pin is held",
            "release the pin and restart the board",
        ),
    }
}

/// By their counters, in the order of [`Refusal::ALL`].
fn refusals(counts: &[u32]) -> Finding {
    let check = "refused datagrams";
    // Repetitions and questions at a bad moment are part of every day.
    let usual = [Refusal::Duplicate, Refusal::Stale, Refusal::Busy];
    let counted: Vec<(Refusal, u32)> = Refusal::ALL
        .iter()
        .copied()
        .zip(counts.iter().copied())
        .filter(|(refusal, count)| *count > 0 && !usual.contains(refusal))
        .collect();
    let Some((most, _)) = counted.iter().max_by_key(|(_, count)| *count) else {
        return Finding::good(check, "none but repeated ones since the board started");
    };
    let all: Vec<String> = counted
        .iter()
        .map(|(refusal, count)| format!("{} {count}", refusal.key()))
        .collect();
    let remedy = match most {
        Refusal::Key => "store the board's key on the computer that sends: ferrocnc key",
        Refusal::NotOwner => "end the second program or computer that commands the board",
        Refusal::Checksum => "another cable; look at the port's errors",
        _ => {
            "tool, module and board of one release; look for another program that sends to the board's port"
        }
    };
    Finding::note(check, all.join(", "), most.text(), remedy)
}

fn key(locked: bool, ours: bool) -> Finding {
    let check = "key";
    match (locked, ours) {
        (false, _) => Finding::good(check, "the board has none"),
        (true, true) => Finding::good(check, "the board has one, and this user has its file"),
        (true, false) => Finding::bad(
            check,
            "the board has one, and this user has no file for it",
            "LinuxCNC cannot take the board",
            "copy the file of the key from the computer that set it, or --key FILE (ferrocnc key --help)",
        )
        .lasting("~/.config/ferrocnc/keys, readable by this user alone"),
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

/// Of a board whose pins are configured.
fn board_file(verdict: Verdict) -> Finding {
    let check = "board file on the board";
    let effect = match verdict.usable() {
        true => "the board drives nothing",
        false => "the board drives nothing and does not arm",
    };
    match verdict {
        Verdict::InForce => Finding::good(check, verdict.text()),
        _ if verdict.usable() => Finding::note(check, verdict.text(), effect, remedy(verdict)),
        _ => Finding::bad(check, verdict.text(), effect, remedy(verdict)),
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
        "ferrocnc update BOARD with the image of the tool's release",
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::finding::Verdict::{Bad, Good, Note};

    #[test]
    fn a_stop_that_was_not_asked_for_is_told() {
        for reason in FaultReason::ALL {
            let finding = stop(*reason);
            let asked = matches!(reason, FaultReason::None | FaultReason::HostDisable);
            assert_eq!(finding.verdict, if asked { Good } else { Note });
            assert!(asked || finding.remedy == reason.remedy(), "{finding:?}");
        }
    }

    #[test]
    fn only_the_selected_slot_is_as_it_should_be() {
        let verdict = |running, selected| image(running, selected).verdict;
        assert_eq!(verdict(Running::A, Some(Slot::A)), Good);
        assert_eq!(verdict(Running::A, Some(Slot::B)), Note);
        assert_eq!(verdict(Running::B, None), Note);
        assert_eq!(verdict(Running::Volatile, Some(Slot::A)), Note);
        let golden = image(Running::Golden, Some(Slot::A));
        assert_eq!(golden.verdict, Bad);
        assert!(golden.remedy.contains("update"), "{golden:?}");
    }

    #[test]
    fn a_flash_without_protection_and_settings_that_are_not_saved_are_told() {
        assert_eq!(protection(0xef4016, true).verdict, Good);
        assert_eq!(protection(0xef4016, false).verdict, Note);
        assert!(protection(0, false).fact.contains("no flash"));
        for (origin, verdict) in [
            (Origin::Copy0, Good),
            (Origin::Copy1, Good),
            (Origin::BuiltIn, Note),
            (Origin::FactoryPin, Note),
        ] {
            assert_eq!(settings(origin).verdict, verdict, "{origin:?}");
        }
    }

    #[test]
    fn a_refusal_is_told_with_the_remedy_of_the_most_frequent_one() {
        let with = |all: &[(Refusal, u32)]| {
            let mut counts = vec![0; Refusal::COUNT];
            for (refusal, count) in all {
                counts[*refusal as usize] = *count;
            }
            refusals(&counts)
        };
        assert_eq!(with(&[(Refusal::Stale, 9)]).verdict, Good);
        let finding = with(&[(Refusal::Key, 7), (Refusal::Checksum, 2)]);
        assert_eq!(finding.verdict, Note);
        assert_eq!(finding.fact, "checksum 2, key 7");
        assert!(finding.remedy.contains("ferrocnc key"), "{finding:?}");
        assert_eq!(refusals(&[]).verdict, Good);
    }

    #[test]
    fn a_key_that_this_user_does_not_have_is_bad() {
        assert_eq!(key(false, false).verdict, Good);
        assert_eq!(key(true, true).verdict, Good);
        assert_eq!(key(true, false).verdict, Bad);
    }

    #[test]
    fn a_board_file_that_is_not_in_force_is_told_with_its_remedy() {
        assert_eq!(board_file(super::Verdict::InForce).verdict, Good);
        assert_eq!(board_file(super::Verdict::Missing).verdict, Note);
        let other = board_file(super::Verdict::Counts);
        assert_eq!(other.verdict, Bad);
        assert!(other.remedy.contains("config apply"), "{other:?}");
    }

    #[test]
    fn board_and_tool_are_of_one_release() {
        assert_eq!(release(0x01_0203, "1.2.3").verdict, Good);
        let other = release(0x01_0203, "1.2.4");
        assert_eq!(other.verdict, Note);
        assert!(other.fact.contains("board 1.2.3, tool 1.2.4"));
    }
}
