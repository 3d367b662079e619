//! What a job writes to its board, and how often.

use crate::rig::*;
use crate::stops::client::Client;
use jobs::plan::Planner;
use sim::plant::Plant;
use wire::exchange::Command;
use wire::jobs::{End, Request, UNATTENDED};
use wire::map;

#[test]
fn a_job_gives_the_board_every_setting_of_its_machine() {
    let mut rig = Rig::new(Plant::direct(0));
    let mut machine = with_switches();
    (machine.safe, machine.invert) = (2, 4);
    // Timings that differ, on a board with 250 ns a clock; every polarity; and a debounce beyond
    // what there is.
    for (n, axis) in (1..).zip(&mut machine.axes) {
        (axis.steplen, axis.stepspace) = (1000 * n, 1250 * n);
        (axis.dirsetup, axis.dirhold) = (1500 * n, 1750 * n);
        (axis.step_invert, axis.dir_invert) = (n != 2, n != 1);
        axis.max_accel -= u64::from(n) * 1_000_000_000;
        let home = axis.home.as_mut().unwrap();
        home.debounce = [80, 800, 1_000_000][n as usize - 1];
    }
    rig.ok(&Request::PutMachine(machine));
    let limits = Planner::<32>::new(&planned(&machine)).unwrap().limits();
    // Whatever its end is: there are no switches, and it has begun.
    assert_eq!(
        rig.command_with(11, UNATTENDED | 1, 0, ""),
        wire::jobs::Status::Normal
    );
    rig.run(50 * MS);
    rig.command(0);
    assert_eq!(rig.finish().end, End::Stopped);
    let client = Client {
        command: Command::default(),
    };
    let mut read = |address: u32| client.read(&mut rig, address);
    for (n, mode) in [(0, 1), (1, 2), (2, 3)] {
        let base = map::CONFIG_STEPGEN + n * map::CONFIG_STRIDE;
        let words: [u32; 6] = core::array::from_fn(|word| read(base + 4 * word as u32));
        let n = n + 1;
        let stop = limits[n as usize - 1];
        assert_eq!(words, [4 * n, 5 * n, 6 * n, 7 * n, stop, mode], "axis {n}");
    }
    let looks: [u32; 3] =
        core::array::from_fn(|input| read(map::CONFIG_DEBOUNCE + 4 * input as u32));
    assert_eq!(looks, [10, 100, map::DEBOUNCE_MAX]);
    let board: [u32; 4] = core::array::from_fn(|word| read(map::CONFIG_BOARD + 4 * word as u32));
    let grace = machine.grace(CLOCK as u32);
    assert_eq!(board, [100 * MS as u32, grace, 2, 4]);
}

#[test]
fn the_board_is_spoken_to_every_5_ms_and_every_one_while_a_switch_is_looked_for() {
    let mut rig = Rig::switched();
    let exchanges = |rig: &mut Rig, ms: u64| {
        let before = rig.machine.server.counters().exchanges;
        rig.run(ms * MS);
        rig.machine.server.counters().exchanges - before
    };
    assert_eq!(exchanges(&mut rig, 100), 0, "nothing is going on");
    rig.command_with(11, UNATTENDED, 0, "");
    rig.run(60 * MS);
    let looking = exchanges(&mut rig, 50);
    assert!((45..=50).contains(&looking), "{looking} in 50 ms");
    assert_eq!(rig.finish().end, End::Done);
    let stood = rig.pins();
    rig.start("G1 X50 Y20 F6000\nM2\n");
    rig.run(100 * MS);
    assert_ne!(rig.pins(), stood, "it is not on its way");
    let playing = exchanges(&mut rig, 200);
    assert!((36..=40).contains(&playing), "{playing} in 200 ms");
}
