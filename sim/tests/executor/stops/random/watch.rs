//! Watches the axes at their pins from the cause of a stop on.

use super::super::stopping;
use crate::rig::*;
use firmware::cores::Board as _;
use motion::segment::AXES;
use wire::exchange::STATUS_STEPGEN;
use wire::map;
use wire::regmap::{status, timebase};

pub const HZ: f64 = CLOCK as f64;
/// Clocks between two looks.
pub const TURN: u64 = 400;
/// A step for the fraction at each end.
const STEPS: f64 = 2.0;

/// The way of each axis since a stop is in force.
pub struct Watch {
    accel: Vec<f64>,
    /// Since a stop is in force: where they were, and how fast.
    since: Option<(Vec<i64>, Vec<f64>)>,
    before: Vec<f64>,
    /// The gate closed on a motor that turned.
    pub cut: bool,
    pub closed: bool,
}

impl Watch {
    /// Of axes with these accelerations, steps/s^2.
    pub fn of(accel: Vec<f64>) -> Self {
        Watch {
            before: vec![0.0; accel.len()],
            accel,
            since: None,
            cut: false,
            closed: false,
        }
    }

    fn velocities(&self, rig: &mut Rig) -> Vec<f64> {
        let board = &mut rig.machine.board;
        board.strobe(timebase::STROBE_SAMPLE);
        let velocity = |n| board.latched(status::STEPGEN0_VELOCITY + n * STATUS_STEPGEN) as i32;
        let all = (0..self.accel.len()).map(velocity);
        all.map(|velocity| f64::from(velocity) * HZ / 2f64.powi(32))
            .collect()
    }

    fn pins(&self, rig: &mut Rig) -> Vec<i64> {
        rig.machine.board.environment().edges.counts()[..self.accel.len()].to_vec()
    }

    /// Once in every turn.
    pub fn look(&mut self, rig: &mut Rig) {
        let (velocities, open) = (self.velocities(rig), rig.machine.board.gate().open());
        if !open && !self.closed {
            self.closed = true;
            // More than what it can lose in the turn between.
            let turn = 1.1 * TURN as f64 / HZ;
            let mut moved = self.before.iter().zip(&self.accel);
            self.cut = moved.any(|(velocity, a)| velocity.abs() > a * turn + 0.1 && *a > 0.0);
        }
        if self.since.is_none() && (stopping(rig) || halts(rig)) {
            self.since = Some((self.pins(rig), velocities.clone()));
        }
        self.before = velocities;
    }

    /// A stop was asked for just now, and is in force from here.
    pub fn asked(&mut self, rig: &mut Rig) {
        self.since = Some((self.pins(rig), self.before.clone()));
    }

    pub fn stands(&self) -> bool {
        self.before.iter().all(|velocity| *velocity == 0.0)
    }

    /// None went on for longer than this, which is asked of each axis with its speed when the stop
    /// began. What the worst has used of it.
    pub fn within(&self, rig: &mut Rig, allowed: impl Fn(usize, f64) -> f64, told: &str) -> f64 {
        let paused = rig.machine.board.csr_read(map::SEGMENTS + 4 * 22) >> 24 & 1 == 1;
        assert!(
            self.stands() || paused,
            "{told}: moves on, {:?} steps/s",
            self.before
        );
        let Some((from, speeds)) = &self.since else {
            return 0.0;
        };
        let mut used = 0.0f64;
        for (n, to) in self.pins(rig).iter().enumerate() {
            let way = (to - from[n]).abs() as f64;
            let most = allowed(n, speeds[n].abs()) * (1.0 + 1e-3) + STEPS;
            assert!(
                way <= most,
                "{told}: axis {n} at {} steps/s, {} steps/s^2 went on for {way} steps, {most} are allowed",
                speeds[n],
                self.accel[n]
            );
            used = used.max(way / most);
        }
        used
    }
}

/// The segments core brings its axes to rest.
fn halts(rig: &mut Rig) -> bool {
    rig.machine.board.csr_read(map::SEGMENTS + 4 * 22) >> 8 & 3 == 3
}

/// What the pins add up to, less what the board has counted: another kind or polarity of steps
/// changes pins that are no steps.
pub fn strays(rig: &mut Rig) -> [i64; AXES] {
    let board = &mut rig.machine.board;
    board.strobe(timebase::STROBE_SAMPLE);
    let pins = board.environment().edges.counts();
    core::array::from_fn(|n| {
        let count = board.latched(status::STEPGEN0_POSITION_HI + n * STATUS_STEPGEN) as i32;
        pins[n] - i64::from(count)
    })
}

/// The counts are the pins', and no pulse was too short.
pub fn exact(rig: &mut Rig, axes: usize, strays: [i64; AXES], told: &str) {
    let board = &mut rig.machine.board;
    board.strobe(timebase::STROBE_SAMPLE);
    let pins = board.environment().edges.counts();
    for (n, pins) in pins.iter().enumerate().take(axes) {
        let count = board.latched(status::STEPGEN0_POSITION_HI + n * STATUS_STEPGEN) as i32;
        let strays = strays.get(n).copied().unwrap_or(0);
        assert_eq!(i64::from(count), *pins - strays, "{told}: axis {n}");
    }
    let edges = &board.environment().edges;
    assert_eq!(edges.violations(), [], "{told}");
}
