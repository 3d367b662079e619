//! Checks the board's own reports: gateware and firmware, SDRAM, reset reason, and obstacles to
//! arming.

use super::{Finding, Verdict};
use wire::describe::{Describe, JobsState};
use wire::{ResetReason, State};

/// The facts.
#[derive(Clone, Debug)]
pub struct Facts {
    /// Its description.
    pub describe: Describe,
    /// Panics of the firmware since power-up.
    pub panics: u32,
    /// Text of the last one.
    pub panic: String,
}

/// Judges them.
pub fn judge(facts: &Facts) -> Vec<Finding> {
    vec![halves(facts), sdram(facts), start(facts), gate(facts)]
}

fn halves(facts: &Facts) -> Finding {
    let (check, describe) = ("gateware and firmware", &facts.describe);
    let (firmware, gateware) = (describe.abi_firmware, describe.abi_gateware);
    if firmware == gateware {
        return Finding::good(check, format!("both of register map {gateware:#010x}"));
    }
    Finding::bad(
        check,
        format!("firmware of register map {firmware:#010x}, gateware of {gateware:#010x}"),
        "they were built apart, and this board never arms",
        "flash a matching pair: one .bit holds both",
    )
}

fn sdram(facts: &Facts) -> Finding {
    let check = "sdram";
    match JobsState::of(facts.describe.features) {
        JobsState::Alive => {
            Finding::good(check, "passed its test at start; the services run in it")
        }
        JobsState::Streamed | JobsState::None => {
            Finding::skipped(check, "not used", "the board file says sdram = false", "")
        }
        JobsState::Sdram => Finding::bad(
            check,
            "failed its test at start",
            "it does not keep what is written into it: a solder joint, a shorted line, a bad chip",
            "reflow the SDRAM's pins and look for bridges; with `sdram = false` in the board file the board works without it",
        ),
        // The services test it, and these were not started.
        state @ (JobsState::Missing | JobsState::Foreign) => Finding::note(
            check,
            format!("not tested; services: {}", state.text()),
            "the flash has no complete services of this build",
            "`ferrocnc update` with this board's .bit",
        ),
        state @ JobsState::Damaged => Finding::note(
            check,
            format!("not tested; services: {}", state.text()),
            "the flash has other services than were written, or the SDRAM does not keep them",
            "`ferrocnc update` with this board's .bit; if that changes nothing, `ferrocnc flash verify` tells which of the two",
        ),
        JobsState::Loading => Finding::note(
            check,
            "not tested yet",
            "the services are loaded while no host owns the board",
            "run this again in a second, without LinuxCNC",
        ),
        JobsState::Ended | JobsState::GivenUp => Finding::bad(
            check,
            "passed its test at start; the services failed since",
            "the SDRAM loses what is in it, or the services have a defect",
            "restart the board; if it happens again, send the log (`ferrocnc log`)",
        ),
    }
}

fn start(facts: &Facts) -> Finding {
    let (check, reason) = ("start", facts.describe.reset_reason);
    if facts.panics > 0 || matches!(reason, ResetReason::Panic | ResetReason::Trap) {
        let fact = format!(
            "{} panics since power-up, the last: {}",
            facts.panics, facts.panic
        );
        return Finding::bad(
            check,
            fact,
            "the firmware met a state that must not occur",
            "send this report; a supply below 4.5 V or a bad bit in the ROM can be the cause",
        );
    }
    match reason {
        ResetReason::Unknown => Finding::note(
            check,
            "started without a record of the reason",
            "a reset that the firmware did not ask for, such as a dip of the supply",
            "measure the 5 V at the board under load",
        ),
        ResetReason::PowerUp | ResetReason::Requested | ResetReason::Panic | ResetReason::Trap => {
            Finding::good(check, format!("{}, no panic since", reason.text()))
        }
    }
}

fn gate(facts: &Facts) -> Finding {
    let (check, state) = ("gate", &facts.describe.state);
    let fact = format!(
        "{}, closed last: {}",
        state.state, facts.describe.gate_close
    );
    let (verdict, reason, remedy) = if state.external_reset {
        (
            Verdict::Note,
            "the external reset pin is active or was",
            "release it; a pin without a switch must rest low",
        )
    } else if state.estop {
        (
            Verdict::Note,
            "an e-stop input is active or was",
            "release it; an open contact counts as pressed",
        )
    } else if state.state == State::Faulted {
        (Verdict::Note, state.reason.text(), "arming clears it")
    } else {
        (Verdict::Good, "", "")
    };
    Finding::new(verdict, check, fact, reason, remedy)
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use wire::exchange::StateWord;
    use wire::{FaultReason, GateClose, LinkSpeed};

    pub(in crate::selftest) fn healthy() -> Describe {
        Describe {
            wire_version: wire::WIRE_VERSION,
            abi_firmware: 7,
            abi_gateware: 7,
            firmware_version: 0x100,
            gateware_version: 0x100,
            clock_hz: 60_000_000,
            channels: wire::describe::Channels::default(),
            features: JobsState::Alive.code() << JobsState::AT,
            boot_id: 1,
            blob_words: 4,
            state: StateWord {
                state: State::Disarmed,
                reason: FaultReason::None,
                position_trusted: true,
                enabled: false,
                session_yours: false,
                bitten: false,
                external_reset: false,
                accepted: false,
                link: true,
                estop: false,
                speed: LinkSpeed::M1000,
                services: JobsState::None,
                link_errors: 0,
            },
            obstacles: 0,
            reset_reason: ResetReason::PowerUp,
            gate_close: GateClose::Never,
        }
    }

    fn verdicts(change: impl Fn(&mut Facts)) -> Vec<Verdict> {
        let mut facts = Facts {
            describe: healthy(),
            panics: 0,
            panic: String::new(),
        };
        change(&mut facts);
        judge(&facts)
            .iter()
            .map(|finding| finding.verdict)
            .collect()
    }

    #[test]
    fn a_healthy_board_is_good_and_each_defect_is_its_own_finding() {
        use Verdict::{Bad, Good, Note, Skipped};
        assert_eq!(verdicts(|_| {}), [Good; 4]);
        assert_eq!(
            verdicts(|f| f.describe.abi_firmware = 8),
            [Bad, Good, Good, Good]
        );
        assert_eq!(
            verdicts(|f| f.describe.features = 0),
            [Good, Skipped, Good, Good]
        );
        let sdram =
            |state: JobsState| verdicts(|f| f.describe.features = state.code() << JobsState::AT)[1];
        assert_eq!(sdram(JobsState::Sdram), Bad);
        assert_eq!(sdram(JobsState::Damaged), Note);
        assert_eq!(sdram(JobsState::Loading), Note);
        assert_eq!(sdram(JobsState::Ended), Bad);
        assert_eq!(sdram(JobsState::GivenUp), Bad);
        assert_eq!(sdram(JobsState::Streamed), Skipped);
        assert_eq!(verdicts(|f| f.panics = 1), [Good, Good, Bad, Good]);
        assert_eq!(
            verdicts(|f| f.describe.state.estop = true),
            [Good, Good, Good, Note]
        );
    }
}
