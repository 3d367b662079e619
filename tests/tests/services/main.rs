//! The services fail while the machine moves: the Verilated board with a program that panics, or
//! meets an instruction that is none, when a ping comes; or their SDRAM rots, or is dead. Updates
//! without them, what is told of it, what they do with their clients, and what outlives a restart.
//!
//! Panics cannot be excluded here as in the ROM's image (`image`): smoltcp has some 90 places that
//! may panic, and other ones with each release. These tests are in that list's place.
//!
//! To load the services takes longer than anything else here. Where only the ROM's part counts a
//! small program is in their place ([`ferrocnc_tests::services::small`]).

use ferrocnc_tests::{BenchMachine, take_late_answers};
use wire::describe::{self, FEATURES_AT, JobsState};
use wire::exchange::Command;
use wire::units::{Accel, Velocity};

mod failures;
mod guests;
mod jobs;
mod memory;
mod told;
mod update;

/// An exchange with a pass: the gateware answers, whatever the CPU does.
const FAST: u64 = 20;
/// As in `flood`: clocks of an exchange without a pass, behind any call of the services.
const LATE: u64 = 18_000;
/// Clocks the ROM gives the services while an owner moves the machine. An exchange without a pass
/// may come behind so long a call.
const LEASH: u64 = 20_000;
/// What `panic!` is in them.
const EBREAK: u32 = 0x0010_0073;

/// While the services start, which is one call of some milliseconds, a read has no answer.
fn state(machine: &mut BenchMachine) -> JobsState {
    let states = (0..20).find_map(|_| asked(machine));
    states.expect("the board answers")
}

/// Longer than the services start.
const STARTING_MS: u64 = 8;

/// What it says, if it answers. If it does not, its answer comes late.
fn asked(machine: &mut BenchMachine) -> Option<JobsState> {
    let rig = machine.rig();
    let features = rig.read_word(describe::address(FEATURES_AT));
    if features.is_none() {
        take_late_answers(rig, STARTING_MS);
    }
    features.map(JobsState::of)
}

fn moving(machine: &mut BenchMachine) -> Command {
    machine.make_ready();
    let mut command = machine.enabled_command();
    let axes = usize::from(machine.channels().stepgens);
    for (n, (velocity, accel)) in command.stepgen.iter_mut().take(axes).enumerate() {
        *velocity = Velocity::from_hz(20e3 * (n as f64 - 1.4), machine.clock_hz());
        *accel = Accel::from_steps(1e8, machine.clock_hz());
    }
    for _ in 0..5 {
        machine.exchange_and_wait(&mut command);
    }
    command
}

/// Runs until the services are in this state. The board answers no read while they start.
fn becomes(machine: &mut BenchMachine, wanted: JobsState, millis: u64) -> bool {
    (0..millis / 5).any(|_| {
        machine.run_millis(5);
        asked(machine) == Some(wanted)
    })
}
