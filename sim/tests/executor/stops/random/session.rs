//! Stops under a host, as under LinuxCNC.

use super::super::client::Client;
use super::watch::{HZ, TURN, Watch, exact};
use super::{axis, dice, each, magnitude, one_of};
use crate::rig::*;
use firmware::cores::{Board as _, Control};
use motion::segment::AXES;
use rand::Rng;
use rand_pcg::Pcg32;
use wire::units::{Accel, Velocity};
use wire::{ResetReason, map};

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Cause {
    Silence,
    Frozen,
    LinkDown,
    Disable,
    Release,
    AcquiredAnew,
    EStop,
    Reset,
    /// The firmware traps, which closes the gate, and restarts.
    Trap,
    /// It begins again without a word, as a call to nowhere makes it.
    Jump,
}

const CAUSES: [Cause; 10] = [
    Cause::Silence,
    Cause::Frozen,
    Cause::LinkDown,
    Cause::Disable,
    Cause::Release,
    Cause::AcquiredAnew,
    Cause::EStop,
    Cause::Reset,
    Cause::Trap,
    Cause::Jump,
];

impl Cause {
    /// The gate closes at once, whatever moves.
    fn cuts(self) -> bool {
        matches!(
            self,
            Cause::EStop | Cause::Reset | Cause::Trap | Cause::Jump
        )
    }
}

#[test]
fn in_a_session_every_axis_stands_within_its_own_stop_whatever_the_cause() {
    each("sessions", session);
}

/// A machine, and what its host says of it.
#[derive(Debug)]
struct Drive {
    /// steps/s^2 and steps/s. An acceleration of 0: it stops at once.
    axes: Vec<(f64, f64)>,
    /// Those that are on no path.
    alone: u16,
    timeout: u64,
    grace: u64,
    /// Clocks between two commands.
    period: u64,
}

impl Drive {
    fn of(random: &mut Pcg32) -> Self {
        let count = random.random_range(1..=8usize);
        let takes = magnitude(random, 0.002..0.3);
        let mut axes: Vec<_> = (0..count).map(|_| axis(random, takes)).collect();
        let alone: u16 = if random.random_bool(0.2) { 1 } else { 0 };
        if random.random_bool(0.1) {
            axes[count - 1].0 = 0.0;
        }
        let timeout = random.random_range(2..50) * MS;
        let grace = match random.random_bool(0.2) {
            true => random.random_range(1..100) * MS,
            false => CLOCK,
        };
        Drive {
            axes,
            alone,
            timeout,
            grace,
            period: random.random_range(timeout / 20..timeout / 2),
        }
    }

    fn is_alone(&self, n: usize) -> bool {
        self.alone >> n & 1 == 1
    }

    /// Its host, with the board armed.
    fn armed(&self, rig: &mut Rig) -> Client {
        let mut client = Client::of(rig);
        for (n, (accel, _)) in (0..).zip(&self.axes) {
            let stop = match accel {
                0.0 => 0,
                accel => Accel::from_steps(*accel, HZ).0,
            };
            let base = map::CONFIG_STEPGEN + n * map::CONFIG_STRIDE;
            client.write(rig, base, &[8, 8, 8, 8, stop, 0]);
        }
        let board = [self.timeout as u32, self.grace as u32];
        client.write(rig, map::CONFIG_BOARD, &board);
        client.arm(rig, (1 << self.axes.len()) - 1);
        client.command.stepgen_alone = self.alone;
        client
    }

    /// A new command for some of the axes.
    fn steers(&self, random: &mut Pcg32, client: &mut Client) {
        for (n, (accel, speed)) in self.axes.iter().enumerate() {
            if random.random_bool(0.3) {
                let velocity = match random.random_bool(0.2) {
                    true => 0.0,
                    false => random.random_range(-*speed..*speed),
                };
                let limit = match random.random_bool(0.2) {
                    true => Accel::UNLIMITED,
                    false => Accel::from_steps(accel.max(100.0), HZ),
                };
                client.command.stepgen[n] = (Velocity::from_hz(velocity, HZ), limit);
            }
        }
    }

    /// Drives for a while; the largest speed that each axis may have from the last command on.
    fn goes(&self, random: &mut Pcg32, rig: &mut Rig, client: &mut Client) -> Vec<f64> {
        let mut most = vec![0.0; self.axes.len()];
        for _ in 0..random.random_range(3..40) {
            self.steers(random, client);
            let status = client.exchange(rig).expect("it is alive");
            for (n, most) in most.iter_mut().enumerate() {
                let now = f64::from(status.stepgen[n].1.0);
                let (to, limit) = client.command.stepgen[n];
                let reach = f64::from(limit.0) * self.timeout as f64 / 2f64.powi(24);
                let then = match limit.0 {
                    0 => f64::from(to.0),
                    _ => f64::from(to.0).clamp(now - reach, now + reach),
                };
                *most = now.abs().max(then.abs()) * HZ / 2f64.powi(32);
            }
            rig.run(self.period);
        }
        rig.run(random.random_range(0..self.period / 2));
        most
    }

    /// Seconds to stop from these speeds: of all on the path together, and of the slowest that is
    /// alone.
    fn takes(&self, most: &[f64]) -> (f64, f64) {
        let (mut path, mut alone) = (0.0f64, 0.0f64);
        for (n, (accel, _)) in self.axes.iter().enumerate() {
            if self.is_alone(n) {
                alone = alone.max(most[n] / accel.max(1.0));
            } else if *accel > 0.0 {
                path = path.max(most[n] / accel);
            }
        }
        (path, alone)
    }
}

/// It happens.
fn strikes(cause: Cause, mut rig: Rig, client: &mut Client, watch: &mut Watch) -> Rig {
    match cause {
        Cause::Silence | Cause::Frozen => {}
        Cause::LinkDown => {
            rig.machine.board.environment().link(0);
            rig.machine.board.environment().settle();
        }
        Cause::Disable => {
            client.command.enable = false;
            client.exchange(&mut rig);
        }
        Cause::Release => client.release(&mut rig),
        Cause::AcquiredAnew => client.acquire(&mut rig),
        Cause::EStop => rig.estop(true),
        Cause::Reset => rig.machine.board.environment().ext_reset(true),
        Cause::Trap | Cause::Jump => {
            // The first thing that a start does, and a trap before it.
            rig.machine.board.control(Control::Close);
            watch.look(&mut rig);
            if cause == Cause::Trap {
                rig.machine.board.part(ResetReason::Trap);
            }
            rig = rig.restart();
        }
    }
    rig
}

/// Time passes until every axis must stand.
fn stops(cause: Cause, rig: &mut Rig, clocks: u64, watch: &mut Watch) {
    let end = rig.now() + clocks;
    while rig.now() < end {
        let next = rig.now() + TURN;
        if cause != Cause::Frozen && rig.machine.due(firmware::machine::IDLE) {
            rig.machine.housekeeping();
        }
        rig.machine.board.pass(next);
        watch.look(rig);
    }
}

/// What went wrong, and what was used of the way that is allowed.
fn session(seed: u64) -> (Cause, f64) {
    let mut random = dice(seed);
    let drive = Drive::of(&mut random);
    let mut rig = Rig::with_stepgens(8);
    let mut client = drive.armed(&mut rig);
    let most = drive.goes(&mut random, &mut rig, &mut client);
    let cause = one_of(&mut random, &CAUSES);
    let told = format!("seed {seed}: {cause:?}, {drive:?}, most {most:?}");
    let mut watch = Watch::of(drive.axes.iter().map(|axis| axis.0).collect());
    watch.look(&mut rig);
    let mut rig = strikes(cause, rig, &mut client, &mut watch);
    let (path, alone) = drive.takes(&most);
    let clocks = drive.timeout + ((path.max(alone) * 1.001 + 0.02) * HZ) as u64;
    stops(cause, &mut rig, clocks, &mut watch);
    let used = watch.within(
        &mut rig,
        |n, speed| match drive.axes[n].0 {
            0.0 => 0.0,
            accel if drive.is_alone(n) => speed * speed / (2.0 * accel),
            // On a path all take as long as the slowest.
            _ => speed * path / 2.0,
        },
        &told,
    );
    assert!(watch.closed, "{told}: the gate is open");
    for _ in 0..10 {
        rig.machine.housekeeping();
        rig.machine.board.pass(rig.machine.board.clock() + MS);
    }
    exact(&mut rig, drive.axes.len(), [0; AXES], &told);
    let trusted = rig.machine.server.safety().position_trusted();
    let doubtful = cause.cuts()
        || cause == Cause::Frozen
        || path.max(alone) * HZ + 8.0 * MS as f64 > drive.grace as f64;
    assert!(!(watch.cut && trusted), "{told}: cut off and trusted");
    assert!(
        trusted || doubtful,
        "{told}: not trusted, and nothing was cut off"
    );
    (cause, used)
}
