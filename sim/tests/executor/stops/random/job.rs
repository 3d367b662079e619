//! Stops in a job, on a board that executes it itself and on one to which a PC streams it.

use super::player::{Player, Trouble, left_behind};
use super::watch::{HZ, Watch, exact, strays};
use super::{axis, dice, each, magnitude, one_of};
use crate::rig::*;
use firmware::cores::Board as _;
use motion::segment::AXES;
use rand::Rng;
use rand_pcg::Pcg32;
use wire::jobs::{End, MachineConfig, Request, Status, UNATTENDED};
use wire::{Name, map};

const TROUBLES: [Trouble; 10] = [
    Trouble::Hangs,
    Trouble::Frozen,
    Trouble::Stop,
    Trouble::Pause,
    Trouble::Silence,
    Trouble::EStop,
    Trouble::Reset,
    Trouble::Starved,
    Trouble::Trap,
    Trouble::Jump,
];
const LETTERS: [&str; AXES] = ["X", "Y", "Z"];

#[test]
fn in_a_job_every_axis_stands_within_its_own_stop_whatever_the_cause() {
    each("jobs", |seed| job(seed, false));
}

#[test]
fn in_a_streamed_job_every_axis_stands_within_its_own_stop_whatever_the_cause() {
    each("streamed jobs", |seed| job(seed, true));
}

/// A machine, its axes in steps/s^2 and steps/s, and a program that ends at its limits.
struct Drawing {
    machine: MachineConfig,
    axes: [(f64, f64); AXES],
    text: String,
}

impl Drawing {
    /// In one line, or in so many that 64 segments are a part of it.
    fn of(random: &mut Pcg32, lines: usize) -> Self {
        let mut machine = plotter();
        let takes = magnitude(random, 0.002..0.4);
        let mut ways = [0.0; AXES];
        let axes = core::array::from_fn(|n| {
            let (accel, speed) = axis(random, takes);
            let least = (speed / 4000.0).max(10.0);
            let per_mm = magnitude(random, least..2000.0);
            let way = (speed * takes * random.random_range(0.3..1.5) + 5.0) / per_mm;
            let way = if random.random_bool(0.5) { way } else { -way };
            let nm = (way * 1e6).round() as i64;
            ways[n] = nm as f64 / 1e6;
            let axis = &mut machine.axes[n];
            axis.steps_per_km = (per_mm * 1e6) as u64;
            axis.max_speed = ((speed / per_mm * 1e6) as u32).max(1);
            axis.max_accel = ((accel / per_mm * 1e6) as u64).max(1);
            (axis.lowest, axis.highest) = (nm.min(0), nm.max(0));
            (accel, speed)
        });
        let mut text = String::new();
        for line in 1..=lines {
            // Between the limits, here and there beside the straight way to their corner.
            let share = line as f64 / lines as f64;
            let wide = if line == lines {
                0.0
            } else {
                0.2 / lines as f64
            };
            text += "G0";
            for (letter, way) in LETTERS.iter().zip(ways) {
                let at = way * (share + random.random_range(-1.0..=0.0) * wide);
                text += &format!(" {letter}{at:.6}");
            }
            text += "\n";
        }
        text += "M2\n";
        Drawing {
            machine,
            axes,
            text,
        }
    }

    /// Each axis' own way to stop from this speed.
    fn stops_within(&self, n: usize, speed: f64) -> f64 {
        speed * speed / (2.0 * self.axes[n].0)
    }

    /// Seconds: of the axis that takes longest to stop.
    fn longest(&self) -> f64 {
        self.axes.iter().fold(0.0f64, |t, (a, v)| t.max(v / a))
    }

    /// No axis is beyond its limits by more than a step.
    fn holds(&self, stood: [i64; AXES], told: &str) {
        for (n, axis) in self.machine.axes.iter().enumerate() {
            let steps = |nm: i64| nm as f64 * axis.steps_per_km as f64 / 1e12;
            let at = stood[n] as f64;
            let (low, high) = (steps(axis.lowest) - 1.0, steps(axis.highest) + 1.0);
            assert!(
                (low..=high).contains(&at),
                "{told}: axis {n} at {at}, beyond {low}..{high}"
            );
        }
    }
}

/// The board with this drawing on its way, and where it was started: what its pins add up to
/// without having been a step.
fn begun(mut rig: Rig, drawing: &Drawing, trouble: Trouble, streams: bool) -> Player {
    rig.ok(&Request::PutMachine(drawing.machine));
    rig.send("job", &file(&program(&drawing.text)));
    let mut player = Player::new(rig, streams);
    let (flags, keepalive) = match trouble {
        Trouble::Silence => (0, 100),
        _ => (UNATTENDED, 0),
    };
    let name = Name::new("job").unwrap();
    let start = Request::Command {
        code: 2,
        flags,
        keepalive,
        name,
    };
    assert_eq!(player.ask(&start).0, Status::Normal);
    let begun = |player: &mut Player| player.rig.machine.board.csr_read(map::SEGMENTS + 4 * 23);
    for _ in 0..2000 {
        if begun(&mut player) != 0 {
            return player;
        }
        player.turn();
    }
    panic!("it does not begin: {:?}", player.report());
}

/// What went wrong, and what was used of the way that is allowed.
fn job(seed: u64, streams: bool) -> (Trouble, f64) {
    let mut random = dice(seed ^ u64::from(streams) << 32);
    let trouble = one_of(&mut random, &TROUBLES);
    let lines = match trouble {
        Trouble::Starved => random.random_range(50..300),
        _ => 1,
    };
    let drawing = Drawing::of(&mut random, lines);
    let told = format!(
        "seed {seed}, streamed {streams}: {trouble:?} of {lines} lines to {:?} with {:?} steps/s^2, steps/s",
        drawing.text.lines().nth_back(1),
        drawing.axes
    );
    let mut rig = Rig::with_stepgens(4);
    left_behind(&mut rig, &mut random);
    let mut player = begun(rig, &drawing, trouble, streams);
    let strays = strays(&mut player.rig);
    player
        .rig
        .machine
        .board
        .environment()
        .edges
        .clear_violations();
    let (segments, _) = predict(&program(&drawing.text), &drawing.machine);
    let clocks: u64 = segments.iter().map(|one| u64::from(one.clocks)).sum();
    let moment = player.rig.now() + random.random_range(0..clocks);
    while player.rig.now() < moment {
        player.turn();
    }
    let mut watch = Watch::of(drawing.axes.iter().map(|axis| axis.0).collect());
    watch.look(&mut player.rig);
    let mut player = player.suffers(trouble, &mut watch, &told);
    // A pause adds a quarter of what the axis that can bear the least has; the queue may hold all
    // of the job.
    let patience = (0.25 + 4.0 * drawing.longest()) * HZ;
    let end = player.rig.now() + clocks + patience as u64;
    while player.rig.now() < end && !(watch.closed && watch.stands()) {
        player.turn();
        watch.look(&mut player.rig);
    }
    let used = watch.within(&mut player.rig, |n, v| drawing.stops_within(n, v), &told);
    exact(&mut player.rig, AXES, strays, &told);
    let pins = player.rig.pins();
    let stood = core::array::from_fn(|n| pins[n] - strays[n]);
    drawing.holds(stood, &told);
    said(&mut player, trouble, &watch, (pins, stood), &told);
    (trouble, used)
}

/// What the board says when it is asked again, and that nothing moves by itself.
fn said(
    player: &mut Player,
    trouble: Trouble,
    watch: &Watch,
    (pins, stood): ([i64; AXES], [i64; AXES]),
    told: &str,
) {
    player.recovers();
    if trouble == Trouble::Pause && player.rig.jobs.executor().expect("jobs").busy() {
        let report = player.report();
        assert!(report.stands && report.known, "{told}: {report:?}");
        return;
    }
    player.settles();
    assert_eq!(player.rig.pins(), pins, "{told}: it moves again");
    let report = player.report();
    assert_eq!(report.steps.map(i64::from), stood, "{told}");
    // A gate that closes at once leaves a doubt, though the axes may have stood already.
    let cuts = matches!(report.end, End::EStop | End::ExternalReset)
        || matches!(
            trouble,
            Trouble::EStop | Trouble::Reset | Trouble::Trap | Trouble::Jump
        );
    assert!(
        !(watch.cut && report.known),
        "{told}: cut off and known, {report:?}"
    );
    assert!(
        report.known || cuts,
        "{told}: not known, and nothing was cut off, {report:?}"
    );
}
