//! `here`: an axis without a switch is at 0 where the operator sets it.

use crate::rig::*;
use crate::stops::client::Client;
use sim::plant::Plant;
use wire::jobs::{End, Report, Request, Status};

const HERE: u8 = 13;
const X: u8 = 1;
const Y: u8 = 2;
const Z: u8 = 4;

fn here(rig: &mut Rig, axes: u8) -> Status {
    rig.command_with(HERE, axes, 0, "")
}

/// A plotter after an e-stop in mid-line: it is somewhere, and nothing is known.
fn lost() -> (Rig, Report) {
    lost_on(Rig::plotter())
}

fn lost_on(mut rig: Rig) -> (Rig, Report) {
    rig.start("G1 X50 Y25 F6000\nM2\n");
    rig.underway();
    rig.estop(true);
    let report = rig.finish();
    assert!(report.end == End::EStop && !report.known, "{report:?}");
    assert!(report.steps[0] > 0 && report.steps[1] > 0, "{report:?}");
    rig.estop(false);
    (rig, report)
}

#[test]
fn after_an_e_stop_it_is_known_again_and_the_next_job_begins_there() {
    let (mut rig, _) = lost();
    let stood = rig.pins();
    assert_eq!(here(&mut rig, 0), Status::Normal);
    let report = rig.report();
    assert!(report.known && report.steps == [0; 3], "{report:?}");
    assert_eq!(rig.pins(), stood, "nothing moves");
    let report = rig.draw("G1 X10 Y5 F6000\nM2\n");
    assert!(report.end == End::Done && report.known, "{report:?}");
    let scales = rig.machine_of().axes;
    for (axis, millimetres) in [10, 5, 0].into_iter().enumerate() {
        let steps = scales[axis].steps_per_km as i64 * millimetres / 1_000_000;
        assert_eq!(rig.pins()[axis] - stood[axis], steps, "axis {axis}");
    }
}

#[test]
fn each_axis_is_known_when_it_was_named() {
    let (mut rig, before) = lost();
    for (axes, known) in [(X, false), (Y, false), (Z, true)] {
        assert_eq!(here(&mut rig, axes), Status::Normal);
        assert_eq!(rig.report().known, known, "{axes}");
        if axes == X {
            let [_, y, z] = before.steps;
            assert_eq!(rig.report().steps, [0, y, z], "the others stay");
        }
    }
}

#[test]
fn an_axis_with_a_switch_has_to_find_it() {
    let mut rig = Rig::switched();
    for axes in [0, X, X | Z] {
        assert_eq!(here(&mut rig, axes), Status::HasSwitch, "{axes}");
    }
    assert_eq!(rig.report().homed, 0);
    // One of three without a switch is the one that is meant.
    let mut machine = with_switches();
    machine.axes[2].home = None;
    rig.ok(&Request::PutMachine(machine));
    assert_eq!(here(&mut rig, X | Z), Status::HasSwitch);
    assert_eq!(here(&mut rig, 0), Status::Normal);
    assert_eq!(rig.report().homed, Z);
}

#[test]
fn it_is_refused_without_a_machine_for_no_axis_while_a_job_goes_and_while_a_session_owns_the_board()
{
    let mut rig = Rig::new(sim::plant::Plant::direct(0));
    assert_eq!(here(&mut rig, 0), Status::NoMachine);
    rig.ok(&Request::PutMachine(plotter()));
    assert_eq!(here(&mut rig, 8), Status::Value);
    rig.start("G1 X50 F6000\nM2\n");
    rig.underway();
    assert_eq!(here(&mut rig, 0), Status::NotNow);
    let report = rig.finish();
    assert_eq!(report.end, End::Done);
    let mut client = Client::of(&mut rig);
    client.arm(&mut rig, 7);
    assert_eq!(here(&mut rig, 0), Status::Owned);
    client.release(&mut rig);
    assert_eq!(rig.report().steps, report.steps, "it is where it was");
}

#[test]
fn the_console_says_it_too_and_asks_for_the_key() {
    let mut rig = Rig::keyed(Plant::direct(0));
    rig.prove();
    rig.ok(&Request::PutMachine(plotter()));
    let (mut rig, _) = lost_on(rig);
    let refused = rig.say("job here", false);
    assert!(refused.contains("has a key"), "{refused}");
    assert!(!rig.report().known, "{refused}");
    let taken = rig.say("job here", true);
    assert!(rig.report().known, "{taken}");
}
