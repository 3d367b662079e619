//! Does a stop of the board reach LinuxCNC, and LinuxCNC's the board? By a signal, or through
//! components in between.

use super::{Configured, judged};
use crate::finding::Finding;
use std::collections::{BTreeMap, BTreeSet};

/// These know everything, and carry nothing through.
const HUBS: [&str; 6] = [
    "ferrocnc",
    "iocontrol",
    "motion",
    "joint",
    "spindle",
    "halui",
];

impl Configured<'_> {
    pub(super) fn estop(&self) -> Finding {
        let check = "e-stop";
        let (boards, to) = (self.boards(), "iocontrol.0.emc-enable-in");
        let mut wrong = Vec::new();
        // What stops one board stops all of them (`stop-group`), so one is enough.
        let tells = |board: &&str| self.reaches(&format!("{board}.enabled"), to);
        if let Some(first) = boards.first().filter(|_| !boards.iter().any(tells)) {
            wrong.push(format!("{first}.enabled does not reach {to}"));
        }
        for board in boards {
            if self.files.signal_of(&format!("{board}.enable")).is_none() {
                wrong.push(format!("no signal is at {board}.enable"));
            }
        }
        judged(
            check,
            "a stop of the board stops LinuxCNC, and LinuxCNC's stops the board",
            &wrong,
            "one of the two goes on while the other has stopped",
            "net estop-enabled ferrocnc.0.enabled => iocontrol.0.emc-enable-in, and net estop-enable iocontrol.0.user-enable-out => ferrocnc.0.enable",
        )
    }

    /// What `from` says gets to `to`: by a signal, or through components in between.
    fn reaches(&self, from: &str, to: &str) -> bool {
        let mut at: BTreeMap<&str, Vec<&str>> = BTreeMap::new();
        for (signal, pins) in &self.files.signals {
            for (pin, _) in pins {
                let component = pin.rsplit_once('.').map_or(pin.as_str(), |it| it.0);
                let of = component.split('.').next().unwrap_or_default();
                if !HUBS.contains(&of) {
                    at.entry(component).or_default().push(signal);
                    at.entry(signal).or_default().push(component);
                }
            }
        }
        let (Some(first), Some(last)) = (self.files.signal_of(from), self.files.signal_of(to))
        else {
            return false;
        };
        let (mut seen, mut open) = (BTreeSet::from([first]), vec![first]);
        while let Some(here) = open.pop() {
            if here == last {
                return true;
            }
            for next in at.get(here).into_iter().flatten() {
                if seen.insert(next) {
                    open.push(next);
                }
            }
        }
        false
    }
}
