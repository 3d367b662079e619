//! The two ways of an exchange: through the gateware alone, or through the firmware. How long each
//! takes, how many took it, and why not the other one.

use ferrocnc_tests::{BenchMachine, Ways, report_part};
use serde_json::json;
use sim::exchange::Spread;
use wire::LongWay;
use wire::exchange::{self, Command};
use wire::units::{Accel, Clocks, Velocity};

/// Last byte in to first byte out, clocks: the gateware's own 16 or 17, and some for the crossing
/// to the MAC's clock.
const FAST: u64 = 20;
/// The same through the firmware.
const LONG: u64 = 5000;
/// First byte on the wire in to last byte out, microseconds: half of what LiteX-CNC takes.
const WHOLE: f64 = 4.0;

/// All six axes move.
fn moving(machine: &BenchMachine) -> Command {
    let mut command = machine.enabled_command();
    for (n, (velocity, accel)) in command.stepgen.iter_mut().take(6).enumerate() {
        *velocity = Velocity::from_hz(10e3 * (n as f64 + 1.0), machine.clock_hz());
        *accel = Accel::from_steps(1e7, machine.clock_hz());
    }
    command
}

/// The counters, and time for the next pass behind the answer that has them.
fn ways(machine: &mut BenchMachine) -> Ways {
    let ways = machine.ways();
    machine.run_millis(1);
    ways
}

/// The last so many exchanges.
fn spread(machine: &BenchMachine, last: usize) -> Spread {
    let spread = machine.turnaround_spread(last);
    println!("{last} exchanges: {spread:?}");
    spread
}

#[test]
fn the_six_axis_exchange_turns_around_within_20_clocks_after_the_second() {
    let mut machine = BenchMachine::armed();
    let mut command = moving(&machine);
    assert_eq!(exchange::command_words(machine.channels()), 27);
    let before = ways(&mut machine);
    for _ in 0..202 {
        machine.exchange_and_wait(&mut command);
    }
    let longest = spread(&machine, 200).max;
    assert!(longest <= FAST, "the longest of 200 took {longest} clocks");
    let whole = machine.total_spread(200).max;
    let micros = whole as f64 * 1e6 / machine.clock_hz();
    assert!(micros < WHOLE, "{micros} us, the wire included");
    let after = ways(&mut machine);
    assert!(after.long - before.long <= 2, "{before:?} {after:?}");
    assert_eq!(machine.timing_violations(), 0);
}

/// Clocks after the answer to a request of a host that takes the session: as soon as a program
/// can, a network's time, and in the housekeeping of a pause.
const BEHIND_A_REQUEST: [u64; 8] = [0, 300, 900, 1_300, 2_100, 3_400, 9_000, 120_000];

#[test]
fn the_first_exchange_of_a_session_takes_5000_clocks_whatever_it_waits_for() {
    let mut machine = BenchMachine::start();
    let mut all = Vec::new();
    for gap in BEHIND_A_REQUEST {
        machine.acquire();
        machine.configure();
        machine.run_clocks(gap);
        let mut command = machine.enabled_command();
        // As LinuxCNC begins.
        (command.enable, command.enable_request) = (false, false);
        let parts = machine.exchange_in_parts(&mut command);
        println!("{gap} clocks behind a request: {parts:?}");
        assert!(parts.takes <= LONG, "{gap}: {parts:?}");
        let sum = parts.waits + parts.takes;
        assert!(sum <= LONG, "{gap}: {parts:?}");
        // The first one comes too soon for a pass.
        assert!(gap > 0 || sum > FAST, "{parts:?}");
        all.push(json!({"behind_a_request": gap, "waits": parts.waits, "takes": parts.takes}));
        machine.run_millis(1);
        machine.release();
        machine.run_millis(1);
    }
    report_part("ways", "first_of_a_session", all.into());
}

#[test]
fn an_exchange_of_the_long_way_turns_around_within_5000_clocks() {
    let mut machine = BenchMachine::start();
    machine.acquire();
    machine.configure();
    let mut command = machine.enabled_command();
    machine.exchange_and_wait(&mut command);
    let first = spread(&machine, 1).max;
    assert!((FAST + 1..=LONG).contains(&first), "{first} clocks");
    changes_and_odd_senders(machine, command);
}

/// Arming, and a host whose TTL changes from frame to frame.
fn changes_and_odd_senders(mut machine: BenchMachine, mut command: Command) {
    machine.rearm(&mut command);
    let arming = spread(&machine, 6).max;
    assert!((FAST + 1..=LONG).contains(&arming), "{arming} clocks");
    let mut command = moving(&machine);
    for n in 0..100 {
        machine.rig().segment.ttl = 63 - n % 2;
        machine.exchange_and_wait(&mut command);
    }
    let others = spread(&machine, 100);
    assert!(
        others.min > FAST && others.max <= LONG,
        "{others:?}: none has the TTL of the one before"
    );
}

#[test]
fn every_exchange_is_counted_by_its_way_and_the_reason_for_the_long_one_is_named() {
    let mut machine = BenchMachine::start();
    let none = ways(&mut machine);
    assert_eq!((none.fast, none.long, none.why), (0, 0, LongWay::None));
    machine.acquire();
    machine.configure();
    machine.run_millis(1);
    let mut command = machine.enabled_command();
    // The first of a session, which is expected to look only.
    machine.exchange_and_wait(&mut command);
    let first = ways(&mut machine);
    assert_eq!((first.fast, first.long, first.why), (0, 1, LongWay::Flags));
    machine.rearm(&mut command);
    for _ in 0..5 {
        machine.exchange_and_wait(&mut command);
    }

    type Change = fn(&mut BenchMachine, &mut Command);
    let kinds: [(&str, Change, LongWay); 4] = [
        (
            "other flags",
            |_, command| command.enable_request ^= true,
            LongWay::Flags,
        ),
        (
            "a lost frame",
            |machine, command| {
                let _ = machine.next_command_bytes(command);
            },
            LongWay::Sequence,
        ),
        (
            "another TTL",
            |machine, _| machine.rig().segment.ttl -= 1,
            LongWay::Frame,
        ),
        (
            "a timed one behind a timed one",
            |machine, command| {
                for _ in 0..2 {
                    command.apply_at = Some(Clocks(machine.clock() + 90_000));
                    machine.exchange_and_wait(command);
                }
                command.apply_at = Some(Clocks(machine.clock() + 30_000));
            },
            LongWay::Timed,
        ),
    ];
    for (what, change, why) in kinds {
        for _ in 0..3 {
            machine.exchange_and_wait(&mut command);
        }
        let before = ways(&mut machine);
        change(&mut machine, &mut command);
        machine.exchange_and_wait(&mut command);
        let took = spread(&machine, 1).max;
        assert!((FAST + 1..=LONG).contains(&took), "{what}: {took} clocks");
        let after = ways(&mut machine);
        println!("{what}: {before:?} {after:?}");
        assert!(after.long > before.long, "{what}: {before:?} {after:?}");
        assert_eq!(after.why, why, "{what}");
        // The next ones are as before again.
        command.apply_at = None;
        for _ in 0..2 {
            machine.exchange_and_wait(&mut command);
        }
        let settled = ways(&mut machine);
        for _ in 0..20 {
            machine.exchange_and_wait(&mut command);
        }
        let end = ways(&mut machine);
        assert_eq!(end.fast - settled.fast, 20, "{what}: {settled:?} {end:?}");
        assert_eq!(end.long, settled.long, "{what}");
    }
}
