//! The pass for the next exchange: how soon it is out.

use ferrocnc_tests::{BenchMachine, report_part};
use wire::units::Velocity;

/// Clocks from the last byte of an answered command to the first of the next, from which on that
/// one finds a pass.
const NEXT_PASS: u64 = 2_000;
/// An answer to a command with a pass.
const FAST: u32 = 20;

#[test]
fn the_next_pass_is_out_soon_behind_an_answer() {
    let mut machine = BenchMachine::armed();
    let mut command = machine.enabled_command();
    for (n, (velocity, _)) in command.stepgen.iter_mut().take(6).enumerate() {
        *velocity = Velocity::from_hz(20e3 * (n as f64 - 2.6), machine.clock_hz());
    }
    for _ in 0..5 {
        machine.exchange_and_wait(&mut command);
    }
    let mut soonest = None;
    for gap in (100..=NEXT_PASS).rev().step_by(100) {
        let mut fast = true;
        for _ in 0..3 {
            machine.exchange(&mut command);
            machine.run_clocks(gap);
            machine.exchange_and_wait(&mut command);
            fast &= machine.turnarounds(1)[0] <= FAST;
        }
        if !fast {
            break;
        }
        soonest = Some(gap);
    }
    println!("the next pass is out {soonest:?} clocks behind an answer");
    report_part("passes", "next_pass_clocks", soonest.into());
    assert!(soonest.is_some(), "not within {NEXT_PASS} clocks");
}
