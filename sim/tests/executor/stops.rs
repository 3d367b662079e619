//! The stopping distance of an axis when a job ends: no longer than its own acceleration allows,
//! with any settings that were left in the board.

pub mod client;
mod random;

use crate::rig::*;
use client::Client;
use firmware::cores::Board as _;
use motion::segment::AXES;
use wire::exchange::STATUS_STEPGEN;
use wire::jobs::{End, Field, MachineConfig, Report, Request, Status, UNATTENDED};
use wire::map;
use wire::regmap::{status, timebase};

/// mm/s^2: of a machine that takes a third of a second to stop.
const HEAVY: u64 = 500;
const LONG: &str = "M3\nG1 X100 Y50 F9000\nG1 X0 Y0\nM2\n";

fn heavy(accel: u64) -> MachineConfig {
    let mut machine = plotter();
    for axis in &mut machine.axes {
        axis.max_accel = accel * 1_000_000;
    }
    machine
}

/// Steps/s.
fn velocities(rig: &mut Rig) -> [f64; AXES] {
    let board = &mut rig.machine.board;
    board.strobe(timebase::STROBE_SAMPLE);
    core::array::from_fn(|axis| {
        let velocity = board.latched(status::STEPGEN0_VELOCITY + axis * STATUS_STEPGEN) as i32;
        f64::from(velocity) * CLOCK as f64 / 2f64.powi(32)
    })
}

fn stopping(rig: &mut Rig) -> bool {
    let gate = rig.machine.board.gate();
    gate.stopping() || !gate.open()
}

/// At full speed on its first line.
fn at_speed(rig: &mut Rig) {
    rig.start(LONG);
    for _ in 0..2000 {
        rig.run(MS);
        if rig.pins()[0] > 2500 {
            return;
        }
    }
    panic!("it does not move: {:?}", rig.report());
}

/// From the bite on, each axis in its own way to rest; then the gate is closed, and the counts are
/// the pins'.
fn brakes_as_configured(rig: &mut Rig, accel: u64) {
    while !stopping(rig) {
        rig.run(MS / 10);
    }
    let (from, speeds) = (rig.pins(), velocities(rig));
    assert!(speeds[0] > 9000.0, "not at speed: {speeds:?}");
    let steps = accel as f64 * 80.0;
    let longest = speeds.iter().fold(0.0, |t: f64, v| t.max(v.abs() / steps));
    rig.run((longest * CLOCK as f64) as u64 + MS);
    assert_eq!(velocities(rig), [0.0; AXES], "moves on after {longest} s");
    let to = rig.pins();
    for axis in 0..AXES {
        let way = (to[axis] - from[axis]).abs() as f64;
        let allowed = speeds[axis] * speeds[axis] / (2.0 * steps) + 2.0;
        println!("axis {axis}: {:.1} mm of {:.1}", way / 80.0, allowed / 80.0);
        assert!(
            way <= allowed,
            "axis {axis}: {way} steps, {allowed} are allowed"
        );
    }
    assert!(!rig.machine.board.gate().open(), "the gate is open");
}

/// The program hangs in the job of a heavy axis, until that stands.
fn hangs(rig: &mut Rig) -> Report {
    rig.hangs = true;
    brakes_as_configured(rig, HEAVY);
    rig.hangs = false;
    let report = rig.finish();
    assert!(report.end == End::Watchdog && report.known, "{report:?}");
    report
}

#[test]
fn a_heavy_axis_brakes_as_configured_when_the_program_hangs_in_a_job() {
    let mut rig = Rig::plotter();
    rig.ok(&Request::PutMachine(heavy(HEAVY)));
    at_speed(&mut rig);
    let report = hangs(&mut rig);
    assert_eq!(report.steps.map(i64::from), rig.pins());
}

#[test]
fn a_job_has_the_grace_its_machine_needs_and_not_the_one_that_was_left_behind() {
    let mut rig = Rig::plotter();
    rig.ok(&Request::PutMachine(heavy(HEAVY)));
    let client = Client::of(&mut rig);
    client.write(&mut rig, map::CONFIG_BOARD, &[CLOCK as u32, 10 * MS as u32]);
    assert_eq!(client.read(&mut rig, map::CONFIG_BOARD + 4), 10 * MS as u32);
    client.release(&mut rig);
    at_speed(&mut rig);
    hangs(&mut rig);
}

#[test]
fn a_stop_that_the_grace_may_have_cut_short_is_said_for_axes_without_switches_too() {
    let mut rig = Rig::plotter();
    rig.ok(&Request::PutMachine(heavy(HEAVY)));
    at_speed(&mut rig);
    assert!(rig.report().known);
    // So short that it ends on a motor at speed; no job can be given such a one.
    let grace = firmware::cores::Setting::Board(map::BoardConfig::WatchdogGrace);
    rig.machine.board.set(grace, 20 * MS as u32);
    // And the processor is away for longer than any grace.
    let end = rig.now() + 3 * CLOCK;
    rig.machine.board.pass(end);
    let report = rig.finish();
    assert!(report.end == End::Watchdog && !report.known, "{report:?}");
    assert_eq!(
        report.steps.map(i64::from),
        rig.pins(),
        "the count is what left the pins"
    );
    let said = rig.say("job status", true);
    assert!(said.contains("position not trusted"), "{said}");
    // A job may be drawn, and does not make it known.
    rig.start("G1 X10 Y10 F9000\nM2\n");
    let report = rig.finish();
    assert!(report.end == End::Done && !report.known, "{report:?}");
    // A restart knows no more. The axes are put where they belong, and the operator says so.
    let mut rig = rig.restart();
    rig.ok(&Request::PutMachine(heavy(HEAVY)));
    assert!(!rig.report().known);
    assert_eq!(rig.command_with(13, 0, 0, ""), Status::Normal);
    assert!(rig.report().known);
}

#[test]
fn an_e_stop_leaves_the_position_of_axes_without_switches_unknown_too() {
    let mut rig = Rig::plotter();
    rig.start(LONG);
    rig.underway();
    rig.estop(true);
    let report = rig.finish();
    assert!(report.end == End::EStop && !report.known, "{report:?}");
}

#[test]
fn switches_have_to_be_found_again_after_the_stop_of_another_session_was_cut_off() {
    let mut rig = Rig::switched();
    assert_eq!(rig.command_with(11, UNATTENDED, 0, ""), Status::Normal);
    assert!(rig.finish().known);
    let mut client = Client::of(&mut rig);
    client.arm(&mut rig, 7);
    rig.estop(true);
    rig.run(5 * MS);
    rig.estop(false);
    client.release(&mut rig);
    rig.run(5 * MS);
    rig.start("G1 X10 Y10 F9000\nM2\n");
    let report = rig.finish();
    assert!(report.end == End::NotHomed && !report.known, "{report:?}");
}

#[test]
fn a_machine_that_takes_longer_to_stop_than_its_board_waits_is_refused() {
    let mut rig = Rig::plotter();
    // 200 mm/s: 9 s are 22.2 mm/s^2.
    for (accel, taken) in [(23, true), (22, false)] {
        let mut machine = plotter();
        machine.axes[1].max_accel = accel * 1_000_000;
        let (status, payload) = rig.ask(&Request::PutMachine(machine));
        if taken {
            assert_eq!(status, Status::Normal);
        } else {
            assert_eq!(
                (status, &payload[..]),
                (Status::MachineConfig, &[Field::Stop as u8, 1][..])
            );
        }
    }
}

#[test]
fn what_linuxcnc_switches_after_a_job_is_not_the_jobs_any_more() {
    let mut rig = Rig::plotter();
    rig.draw("M3\nG1 X5 F6000\nM5\nM2\n");
    let mut client = Client::of(&mut rig);
    client.arm(&mut rig, 0);
    client.command.gpio_out = 1;
    client.exchange(&mut rig);
    rig.machine.board.environment().settle();
    rig.machine.board.pass(rig.machine.board.clock() + 10);
    assert_eq!(rig.machine.board.environment().pins().gpio_out & 1, 1);
}
