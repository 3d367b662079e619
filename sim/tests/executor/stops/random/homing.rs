//! Stops during homing.

use super::player::{Player, Trouble};
use super::watch::{HZ, Watch, exact, strays};
use super::{axis, dice, each, magnitude, one_of};
use crate::rig::*;
use firmware::cores::Board as _;
use motion::segment::AXES;
use rand::Rng;
use rand_pcg::Pcg32;
use sim::plant::{Plant, Switch};
use wire::jobs::{Home, MachineConfig, Request, State, Status, UNATTENDED};
use wire::regmap::{self, segments};

/// A pause is for paths, and nothing is planned that could be missing.
const TROUBLES: [Trouble; 8] = [
    Trouble::Hangs,
    Trouble::Frozen,
    Trouble::Stop,
    Trouble::Silence,
    Trouble::EStop,
    Trouble::Reset,
    Trouble::Trap,
    Trouble::Jump,
];
/// Clocks from what is read at a switch, or from a command, to the exchange that says so: two
/// looks.
const LATE: f64 = 2e-3;

#[test]
fn in_mid_homing_every_axis_stands_within_its_own_stop_whatever_the_cause() {
    each("homings", homing);
}

/// A machine, its axes in steps/s^2 and steps/s of the fast search, and its switches.
struct Search {
    machine: MachineConfig,
    axes: [(f64, f64); AXES],
    /// steps/s, the most there is: of the way back to 0.
    top: [f64; AXES],
    /// Steps that an axis may go for its switch.
    travel: [f64; AXES],
    plant: Plant,
    /// Clocks it may take.
    clocks: u64,
}

impl Search {
    fn of(random: &mut Pcg32) -> Self {
        let mut machine = plotter();
        let takes = magnitude(random, 0.002..0.2);
        let mut plant = Plant::direct(0);
        let (mut top, mut travel) = ([0.0; AXES], [0.0; AXES]);
        let mut seconds = 0.0;
        let axes = core::array::from_fn(|n| {
            let (accel, speed) = axis(random, takes);
            top[n] = speed;
            let least = (speed / 4000.0).max(10.0);
            let per_mm = magnitude(random, least..2000.0);
            let fast = speed * random.random_range(0.3..1.0);
            let distance = speed * takes * random.random_range(0.0..1.5) + 5.0;
            // Some are further away than the search goes.
            travel[n] = distance * random.random_range(0.8..4.0) + 5.0;
            let plus = random.random_bool(0.5);
            let at = distance.round() as i64;
            plant.add_switch(Switch {
                stepgen: n,
                at: if plus { at } else { -at },
                above: plus,
                input: n,
                inverted: false,
            });
            let nm = |steps: f64| ((steps / per_mm * 1e6) as u32).max(1);
            let slow = fast * random.random_range(0.1..0.5);
            let backoff = distance * 0.1;
            let axis = &mut machine.axes[n];
            axis.steps_per_km = (per_mm * 1e6) as u64;
            axis.max_speed = nm(speed);
            axis.max_accel = ((accel / per_mm * 1e6) as u64).max(1);
            axis.home = Some(Home {
                plus,
                low: false,
                input: n as u8,
                order: random.random_range(0..3),
                fast: nm(fast),
                slow: nm(slow),
                backoff: nm(backoff),
                travel: nm(travel[n]),
                timeout: 60_000,
                debounce: 10,
            });
            seconds += distance / fast + backoff / slow + 8.0 * fast / accel;
            (accel, fast)
        });
        Search {
            machine,
            axes,
            top,
            travel,
            plant,
            clocks: (seconds * HZ) as u64,
        }
    }
}

/// The board that searches, with its kind of steps told to the judge, and what its pins add up to
/// without having been a step.
fn searches(search: &mut Search, streams: bool, trouble: Trouble) -> (Player, [i64; AXES]) {
    let mut rig = Rig::new(core::mem::take(&mut search.plant));
    rig.ok(&Request::PutMachine(search.machine));
    let mut player = Player::new(rig, streams);
    let (flags, keepalive) = match trouble {
        Trouble::Silence => (0, 100),
        _ => (UNATTENDED, 0),
    };
    let calibrate = Request::Command {
        code: 11,
        flags,
        keepalive,
        name: wire::Name::EMPTY,
    };
    assert_eq!(player.ask(&calibrate).0, Status::Normal);
    while !player.rig.machine.board.gate().open() {
        player.turn();
    }
    let strays = strays(&mut player.rig);
    player
        .rig
        .machine
        .board
        .environment()
        .edges
        .clear_violations();
    (player, strays)
}

/// What went wrong, and what was used of the way that is allowed.
fn homing(seed: u64) -> (Trouble, f64) {
    let mut random = dice(seed ^ 2 << 32);
    let mut search = Search::of(&mut random);
    let streams = random.random_bool(0.5);
    let trouble = one_of(&mut random, &TROUBLES);
    let told = format!(
        "seed {seed}, streamed {streams}: {trouble:?} in a search with {:?} steps/s^2, steps/s, travel {:?} steps",
        search.axes, search.travel
    );
    let (mut player, strays) = searches(&mut search, streams, trouble);
    let moment = player.rig.now() + random.random_range(0..search.clocks);
    while player.rig.now() < moment {
        player.turn();
    }
    let longest = search
        .axes
        .iter()
        .zip(search.top)
        .fold(0.0f64, |t, (axis, top)| t.max(top / axis.0));
    let mut watch = Watch::of(search.axes.iter().map(|axis| axis.0).collect());
    watch.look(&mut player.rig);
    let stopped =
        |player: &Player| player.rig.jobs.executor().expect("jobs").state() == State::Stopping;
    // The switches were found, and the axes were on their way to 0, which is a path.
    let begun = regmap::address(segments::BASE, segments::BEGUN);
    let drives = |player: &mut Player| player.rig.machine.board.csr_read(begun) > 0;
    let mut on_path = drives(&mut player);
    let before = stopped(&player);
    let mut player = player.suffers(trouble, &mut watch, &told);
    // Nothing at the gate says that a client stopped it: it is the next velocity.
    let mut asked = before || !matches!(trouble, Trouble::Stop | Trouble::Silence);
    let late = if asked { 0.0 } else { LATE };
    let patience = search.axes.iter().fold(0.0f64, |t, (a, v)| t.max(v / a));
    let end = player.rig.now() + ((0.5 + patience) * HZ) as u64;
    while player.rig.now() < end && !(watch.closed && watch.stands()) {
        if !asked && stopped(&player) {
            watch.look(&mut player.rig);
            watch.asked(&mut player.rig);
            asked = true;
        }
        if !asked {
            on_path = drives(&mut player);
        }
        player.turn();
        watch.look(&mut player.rig);
    }
    let allowed = |n: usize, speed: f64| {
        if on_path && late > 0.0 {
            // Path time comes to a stand in four times what the slowest axis takes; half of it
            // passes.
            return search.top[n] * 2.0 * longest;
        }
        let accel = search.axes[n].0;
        // It may have sped up until the exchange that says stop.
        let speed = speed + accel * late;
        speed * speed / (2.0 * accel) + speed * late
    };
    let used = watch.within(&mut player.rig, allowed, &told);
    exact(&mut player.rig, AXES, strays, &told);
    let pins = player.rig.pins();
    player.recovers();
    player.settles();
    assert_eq!(player.rig.pins(), pins, "{told}: it moves again");
    let report = player.report();
    assert!(
        !(watch.cut && report.known),
        "{told}: cut off and known, {report:?}"
    );
    assert!(
        !report.known || report.homed == 7,
        "{told}: known without its switches, {report:?}"
    );
    (trouble, used)
}
