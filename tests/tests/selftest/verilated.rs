//! The self-test on the Verilated board.

use crate::rig::*;
use ferrocnc_tests::parts;
use host::selftest::{Finding, Verdict};
use sim::pads::{Fault, Pad};
use sim::rig::{self, Rig};
use sim::server::Device;
use std::time::Duration;

/// Board time per time of its host: a tenth, so that pauses meant for networks cost less. The
/// board's own clocks do not know.
const HURRY: f64 = 0.1;

impl Board<Rig> {
    fn verilated() -> Self {
        let (soc, firmware) = parts();
        let rig = Rig::boot(rig::Setup::new(&soc, &firmware));
        let rig = rig.unwrap_or_else(|error| panic!("{error}"));
        let mut board = Self::around(rig, 50);
        board.rate = HURRY;
        // It is this computer's time that the host waits, and a Verilated board needs much of that:
        // 60 s were too few beside five other programs on two cores.
        board.patience = Duration::from_secs(600);
        board
    }

    /// The findings about outputs that are bad, and the Ethernet clock's.
    fn pads(&self) -> (Vec<String>, Finding) {
        let report = self.test_with(true, &[], Duration::ZERO, 5);
        let mut about = report
            .findings
            .iter()
            .filter(|f| f.check.starts_with("output"));
        assert!(about.clone().count() > 10, "{}", report.to_text());
        let bad = about.by_ref().filter(|f| f.verdict == Verdict::Bad);
        let bad = bad.map(|f| format!("{}: {}; {}", f.check, f.fact, f.reason));
        (bad.collect(), finding(&report, "ethernet clock").clone())
    }
}

#[test]
fn the_verilated_board_reads_its_pads_and_counts_its_ethernet_clock() {
    let board = Board::verilated();
    let (bad, ethernet) = board.pads();
    assert_eq!(bad, [""; 0]);
    assert_eq!(ethernet.verdict, Verdict::Good, "{ethernet:?}");
    // Both clocks of the simulation are exact: what is left is the counting.
    assert!(
        ethernet.fact.starts_with("+0.") || ethernet.fact.starts_with("-0."),
        "{ethernet:?}"
    );
    for (fault, expected) in [
        (Fault::Low(Pad::Output(2)), &["output 2"][..]),
        (
            Fault::Short(Pad::Step(0), Pad::Pwm(3)),
            &["output stepgen 0", "output pwm 3"],
        ),
    ] {
        board.twin().environment_mut().pads(fault);
        let (bad, _) = board.pads();
        assert_eq!(bad.len(), expected.len(), "{fault:?}: {bad:?}");
        for (said, check) in bad.iter().zip(expected) {
            assert!(said.starts_with(check), "{fault:?}: {said}");
        }
    }
}
