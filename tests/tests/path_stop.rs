//! Without further commands all axes come to rest together and on their line. Measured at the pins,
//! on the Verilated board with the release image and on the twin.
//!
//! Without the common path each axis would brake as configured: here Y would stand after 1.8 ms, X
//! after 10 ms.

use ferrocnc_tests::BenchMachine;
use ferrocnc_tests::bench::Bench;
use ferrocnc_tests::flash::factory;
use ferrocnc_tests::stops::Used;
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg32;
use sim::edges::Step;
use sim::nor::{Part, Times};
use wire::exchange::Command;
use wire::map;
use wire::regmap::{self, stepgen};
use wire::units::{Accel, Velocity};

/// Steps/s, and steps/s^2 of the configured deceleration. X takes longest: 10 ms and 1000 steps.
const AXES: [(f64, f64); 3] = [(200e3, 2e7), (-73e3, 4e7), (11e3, 1e7)];
const TAKES: f64 = 200e3 / 2e7;
/// Counting the pulses of two axes leaves a line within two steps; one more for rounding.
const OFF_THE_LINE: f64 = 3.0;
const TIMEOUT: f64 = 5e-3;
const GRACE: f64 = 0.1;

/// A board with three axes in motion.
trait Table {
    fn with_axes() -> Self;
    /// One servo period; the clock at which its command arrived.
    fn period(&mut self, command: &mut Command) -> u64;
    /// Clocks from there to the answer: what the command asked for is done before.
    fn turnaround(&self) -> u64;
    /// Milliseconds without a command.
    fn silence(&mut self, millis: u64);
    fn clock_hz(&self) -> f64;
    fn keep_steps(&mut self);
    fn take_steps(&mut self) -> Vec<Step>;
    fn gate_open(&mut self) -> bool;
}

/// What makes a board's settings those of [`AXES`].
fn settings(clock_hz: f64) -> Vec<(u32, u32)> {
    let clocks = |seconds: f64| (seconds * clock_hz) as u32;
    let mut all = vec![
        (map::CONFIG_BOARD, clocks(TIMEOUT)),
        (map::CONFIG_BOARD + 4, clocks(GRACE)),
    ];
    for (n, (_, accel)) in (0..).zip(AXES) {
        let base = map::CONFIG_STEPGEN + n * map::CONFIG_STRIDE;
        // 1 us each.
        all.extend([(base, clocks(1e-6)), (base + 4, clocks(1e-6))]);
        let accel = Accel::from_steps(accel, clock_hz).0;
        all.push((base + 4 * map::StepgenConfig::StopAccel as u32, accel));
    }
    all
}

impl Table for BenchMachine {
    fn with_axes() -> Self {
        let mut machine = BenchMachine::start();
        machine.acquire();
        machine.configure();
        for (address, value) in settings(machine.clock_hz()) {
            machine.write(address, value);
        }
        let mut command = machine.enabled_command();
        machine.rearm(&mut command);
        machine
    }

    fn period(&mut self, command: &mut Command) -> u64 {
        self.exchange_and_wait(command).arrival.0
    }

    fn turnaround(&self) -> u64 {
        self.turnarounds(1)[0].into()
    }

    fn silence(&mut self, millis: u64) {
        self.run_millis(millis);
    }

    fn clock_hz(&self) -> f64 {
        BenchMachine::clock_hz(self)
    }

    fn keep_steps(&mut self) {
        self.edge_watch().keep_steps();
    }

    fn take_steps(&mut self) -> Vec<Step> {
        self.edge_watch().take_steps()
    }

    fn gate_open(&mut self) -> bool {
        BenchMachine::gate_open(self)
    }
}

impl Table for Bench {
    fn with_axes() -> Self {
        let mut bench = Bench::new(factory(Part::W25Q32JV.with(Times::QUICK), 1));
        bench.acquire();
        for (address, value) in settings(bench.clock_hz()) {
            bench.write(address, value);
        }
        bench.arm();
        bench
    }

    fn period(&mut self, command: &mut Command) -> u64 {
        let here = self.command();
        (here.stepgen, here.stepgen_enable) = (command.stepgen, command.stepgen_enable);
        here.enable = command.enable;
        self.exchange().arrival.0
    }

    /// No time passes while the twin's firmware works.
    fn turnaround(&self) -> u64 {
        0
    }

    fn silence(&mut self, millis: u64) {
        self.pass(millis);
    }

    fn clock_hz(&self) -> f64 {
        Bench::clock_hz(self)
    }

    fn keep_steps(&mut self) {
        self.environment().edges.keep_steps();
    }

    fn take_steps(&mut self) -> Vec<Step> {
        self.environment().edges.take_steps()
    }

    fn gate_open(&mut self) -> bool {
        self.environment().pins().gate != 0
    }
}

/// At speed on the line; the clock of the last command.
fn at_speed(table: &mut impl Table) -> (Command, u64) {
    let clock_hz = table.clock_hz();
    let mut command = Command {
        enable: true,
        enable_request: true,
        stepgen_enable: 0b111,
        ..Command::default()
    };
    // Up along the line, so that no axis leaves it on the way.
    let mut last = 0;
    for part in (1..=25).map(|n| f64::from(n.min(20)) / 20.0) {
        for (axis, (velocity, _)) in AXES.into_iter().enumerate() {
            let velocity = Velocity::from_hz(velocity * part, clock_hz);
            command.stepgen[axis] = (velocity, Accel::UNLIMITED);
        }
        if part == 1.0 {
            table.keep_steps();
        }
        last = table.period(&mut command);
    }
    (command, last)
}

/// From here on: on the line at every step, and at rest within a moment of each other, when the
/// slowest must be, if the stop begins at `stop` or so many clocks later.
fn ends_on_the_line_at(table: &mut impl Table, stop: u64, late: u64) {
    let clock_hz = table.clock_hz();
    assert!(!table.gate_open(), "the gate must have closed");
    let steps = table.take_steps();
    let first = |axis: u8| steps.iter().find(|step| step.channel == axis);
    let origin = [0, 1, 2].map(|axis| first(axis).expect("it moved").count);
    let mut at = origin;
    let mut worst: f64 = 0.0;
    let mut last = [0; 3];
    for step in &steps {
        let axis = usize::from(step.channel);
        at[axis] = step.count;
        last[axis] = step.clock;
        let travelled = |axis: usize| f64::from(at[axis] - origin[axis]);
        for axis in [1, 2] {
            let line = travelled(0) * AXES[axis].0 / AXES[0].0;
            worst = worst.max((travelled(axis) - line).abs());
        }
    }
    println!("{worst:.2} steps off the line at most");
    assert!(worst <= OFF_THE_LINE, "{worst} steps off the line");
    // The last whole step of an axis comes when less than one step is left to go: that long before
    // its rest.
    let rest = stop as f64 + TAKES * clock_hz;
    for (axis, clock) in last.into_iter().enumerate() {
        let braking = AXES[axis].0.abs() / TAKES;
        let one_step = (2.0 / braking).sqrt() * clock_hz;
        let early = rest - clock as f64;
        println!("axis {axis}: {early:.0} clocks before rest, one step is {one_step:.0}");
        // 2 clocks for the stop itself, and what passes between arrival and the watchdog's food.
        assert!(
            (-1000.0 - late as f64..=one_step + 1000.0).contains(&early),
            "axis {axis} ended {early} clocks before the slowest axis must be at rest"
        );
    }
}

fn timeout(table: &impl Table) -> u64 {
    (TIMEOUT * table.clock_hz()) as u64
}

fn the_host_dies(mut table: impl Table) {
    let (_, last) = at_speed(&mut table);
    table.silence(25);
    let stop = last + timeout(&table);
    ends_on_the_line_at(&mut table, stop, 0);
}

fn the_host_lets_go(mut table: impl Table) {
    let (mut command, _) = at_speed(&mut table);
    command.enable = false;
    let stop = table.period(&mut command);
    // Other flags than before: the firmware reads the command and gives the order.
    let late = table.turnaround();
    println!("the answer left {late} clocks behind the command");
    for _ in 0..15 {
        table.period(&mut command);
    }
    ends_on_the_line_at(&mut table, stop, late);
}

#[test]
fn when_the_host_dies_mid_move_all_axes_end_together_on_the_line() {
    the_host_dies(BenchMachine::with_axes());
}

#[test]
fn when_the_host_dies_mid_move_all_axes_end_together_on_the_line_on_the_twin() {
    the_host_dies(Bench::with_axes());
}

#[test]
fn when_the_host_takes_enable_away_all_axes_end_together_on_the_line() {
    the_host_lets_go(BenchMachine::with_axes());
}

#[test]
fn when_the_host_takes_enable_away_all_axes_end_together_on_the_line_on_the_twin() {
    the_host_lets_go(Bench::with_axes());
}

#[test]
fn when_the_cpu_freezes_mid_move_all_axes_end_together_on_the_line() {
    let mut machine = BenchMachine::with_axes();
    let (mut command, _) = at_speed(&mut machine);
    machine.freeze_cpu();
    // The host goes on. There is a pass for one more command; the others the frozen CPU does not
    // receive.
    let last = machine.period(&mut command);
    for _ in 0..20 {
        command.sequence = command.sequence.wrapping_add(1);
        let bytes = machine.command_bytes(&command);
        machine.tell_from(sim::rig::RIG_PORT, &bytes);
        machine.run_millis(1);
    }
    let stop = last + timeout(&machine);
    ends_on_the_line_at(&mut machine, stop, 0);
}

#[test]
fn what_was_configured_is_read_back_in_motion_and_in_the_cores_again_at_rest() {
    let mut machine = BenchMachine::with_axes();
    let (mut command, _) = at_speed(&mut machine);
    let configured = |machine: &mut BenchMachine, axis: u32| {
        let base = map::CONFIG_STEPGEN + axis * map::CONFIG_STRIDE;
        machine.read(base + 4 * map::StepgenConfig::StopAccel as u32)
    };
    // The core's own register.
    let core = |machine: &mut BenchMachine, axis: u32| {
        let page = stepgen::BASE + axis as usize * regmap::CSR_PAGE;
        machine.read(regmap::address(page, stepgen::STOP_ACCEL))
    };
    let clock_hz = BenchMachine::clock_hz(&machine);
    for (axis, (velocity, accel)) in (0..).zip(AXES) {
        let accel = Accel::from_steps(accel, clock_hz).0;
        assert_eq!(configured(&mut machine, axis), accel);
        let held = Accel::from_steps(velocity.abs() / TAKES, clock_hz).0;
        let core = core(&mut machine, axis);
        // A velocity is a whole number of units: 11 kHz are 787 000 of them.
        assert!(
            core.abs_diff(held) <= 2 + held / 100_000,
            "axis {axis}: {core}, not {held}"
        );
    }
    command.enable = false;
    for _ in 0..15 {
        machine.exchange_and_wait(&mut command);
    }
    for (axis, (_, accel)) in (0..).zip(AXES) {
        let accel = Accel::from_steps(accel, clock_hz).0;
        assert_eq!(configured(&mut machine, axis), accel);
        assert_eq!(core(&mut machine, axis), accel);
    }
}

#[test]
fn the_decelerations_are_ready_a_fraction_of_a_period_after_the_answer() {
    let mut machine = BenchMachine::with_axes();
    let (mut command, _) = at_speed(&mut machine);
    // There is no pass for the next exchange before they are computed.
    machine.exchange(&mut command);
    machine.run_clocks((BenchMachine::clock_hz(&machine) / 1000.0) as u64 / 10);
    machine.exchange(&mut command);
    let second = machine.turnarounds(1)[0];
    println!("turnaround {second} clocks, a tenth of a period behind another");
    assert!(second <= 20, "{second} clocks");
}

// ---- any machine --------------------------------------------------------------------------------

/// How many machines are tried, unless `FERROCNC_STOPS` gives another number.
const MACHINES: u64 = 16;
/// 0.3 ms, the watchdog's time on these machines.
const SHORT: f64 = 3e-4;
/// A stop takes up to half a second. The gate looks at its first 6 ms; with `FERROCNC_STOPS` every
/// stop of at most 0.35 s is looked at to its end.
const LOOKED_AT: [f64; 2] = [6e-3, 0.35];
/// Clocks from a request to the stop at most: for an exchange or the watchdog, and for a datagram
/// that the firmware reads while it has other work.
const LATE: [u64; 2] = [1500, 18_000];
/// Steps that an axis may be off its ramp, besides what it makes between two such candidates.
const OFF: f64 = 3.0;
/// Clocks between two candidates for the clock of the stop.
const GRID: u64 = 100;

#[derive(Clone, Copy, Debug)]
enum Cause {
    Silence,
    Frozen,
    Disable,
    Release,
    AcquiredAnew,
    Reset,
}

const CAUSES: [Cause; 6] = [
    Cause::Silence,
    Cause::Frozen,
    Cause::Disable,
    Cause::Release,
    Cause::AcquiredAnew,
    Cause::Reset,
];

impl Cause {
    /// Clocks to the stop at most.
    fn late(self) -> u64 {
        match self {
            Cause::Release | Cause::AcquiredAnew => LATE[1],
            Cause::Silence | Cause::Frozen | Cause::Disable | Cause::Reset => LATE[0],
        }
    }
}

/// Velocity (steps/s) and deceleration (steps/s^2) of each axis. The slowest axis takes between one
/// millisecond and half a second to stop.
fn any_machine(random: &mut Pcg32) -> Vec<(f64, f64)> {
    let takes = 10f64.powf(random.random_range(-3.0..-0.3));
    let axis = |random: &mut Pcg32| {
        let velocity = 10f64.powf(random.random_range(2.0..5.3));
        let sign = if random.random_bool(0.5) { 1.0 } else { -1.0 };
        (
            sign * velocity,
            velocity / (takes * random.random_range(0.05..1.0)),
        )
    };
    let count = random.random_range(1..=6);
    (0..count).map(|_| axis(random)).collect()
}

/// Arms the machine and moves it at these velocities; returns the last command and its clock.
fn drives(machine: &mut BenchMachine, axes: &[(f64, f64)]) -> (Command, u64) {
    let clock_hz = BenchMachine::clock_hz(machine);
    machine.acquire();
    for n in 0..6 {
        let accel = axes.get(n).map_or(0.0, |axis| axis.1);
        let base = map::CONFIG_STEPGEN + n as u32 * map::CONFIG_STRIDE;
        let accel = Accel::from_steps(accel, clock_hz).0;
        machine.write(base + 4 * map::StepgenConfig::StopAccel as u32, accel);
    }
    machine.write(map::CONFIG_BOARD, (SHORT * clock_hz) as u32);
    machine.write(map::CONFIG_BOARD + 4, clock_hz as u32);
    let mut command = machine.enabled_command();
    for request in [false, true, true] {
        command.enable_request = request;
        machine.exchange(&mut command);
    }
    for (n, (velocity, _)) in axes.iter().enumerate() {
        command.stepgen[n].0 = Velocity::from_hz(*velocity, clock_hz);
    }
    machine.exchange(&mut command);
    machine.run_clocks(6000);
    let last = machine.exchange(&mut command);
    assert!(last.state.enabled, "{axes:?}: {:?}", last.state);
    machine.edge_watch().keep_steps();
    machine.edge_watch().take_steps();
    machine.run_clocks(6000);
    (command, last.arrival.0)
}

/// Finds the clock, at most `late` clocks after `asked`, from which every axis brakes along a ramp
/// that takes all of them the same time. Returns the clocks from `asked` to it, and the largest
/// share of its way to rest that an axis has used.
fn brakes_in_its_own_way(
    machine: &mut BenchMachine,
    axes: &[(f64, f64)],
    (asked, late): (u64, u64),
    told: &str,
) -> (u64, f64) {
    let clock_hz = BenchMachine::clock_hz(machine);
    let steps = machine.edge_watch().take_steps();
    let mut nearest = (f64::INFINITY, String::new());
    for stop in (asked..=asked + late).step_by(GRID as usize) {
        match braking_since(&steps, axes, stop, clock_hz) {
            Ok(used) => return (stop - asked, used),
            Err(off) if off.0 < nearest.0 => nearest = off,
            Err(_) => {}
        }
    }
    panic!(
        "{told}: no stop within {late} clocks; the nearest: {}",
        nearest.1
    );
}

/// If all axes brake from the clock `stop` on: the largest share of its way to rest that an axis
/// has used. If not: by how many steps the worst axis is off.
fn braking_since(
    steps: &[Step],
    axes: &[(f64, f64)],
    stop: u64,
    clock_hz: f64,
) -> Result<f64, (f64, String)> {
    let takes = axes.iter().fold(0.0f64, |t, (v, a)| t.max(v.abs() / a));
    let (mut used, mut worst) = (0.0f64, (0.0, String::new()));
    for (n, (velocity, accel)) in axes.iter().enumerate() {
        let velocity = velocity.abs();
        let share = (velocity / takes).max(accel / 256.0);
        let slack = OFF + velocity * GRID as f64 / clock_hz;
        let mut made = 0.0;
        for step in steps.iter().filter(|step| usize::from(step.channel) == n) {
            let Some(since) = step.clock.checked_sub(stop) else {
                continue;
            };
            made += 1.0;
            let t = (since as f64 / clock_hz).min(velocity / share);
            let ideal = velocity * t - share * t * t / 2.0;
            let off = (made - ideal).abs() - slack;
            if off > worst.0 {
                let text =
                    format!("stop at {stop}: axis {n} made {made} steps in {t} s, not {ideal}");
                worst = (off, text);
            }
        }
        used = used.max(made / (velocity * velocity / (2.0 * share) + slack));
    }
    if worst.0 > 0.0 { Err(worst) } else { Ok(used) }
}

/// Makes the cause happen; returns the clock of the stop. `bite`: the clock at which the watchdog
/// bites, unless the stop comes first.
fn strikes(
    machine: &mut BenchMachine,
    cause: Cause,
    command: &mut Command,
    bite: u64,
    told: &str,
) -> u64 {
    match cause {
        Cause::Silence => bite,
        Cause::Frozen => {
            machine.freeze_cpu();
            bite
        }
        Cause::Disable => {
            command.enable = false;
            machine.exchange(command).arrival.0
        }
        Cause::Release => {
            let token = machine.read(map::SESSION_TOKEN);
            let asked = machine.clock();
            machine.write(map::SESSION_RELEASE, token);
            asked.min(bite)
        }
        Cause::AcquiredAnew => {
            let asked = machine.clock();
            machine.write(map::SESSION_ACQUIRE, 0x8765_4321);
            asked.min(bite)
        }
        Cause::Reset => {
            assert!(machine.external_reset_until_safe() <= 4, "{told}");
            machine.clock()
        }
    }
}

#[test]
fn any_machine_brakes_each_axis_in_its_own_way_whatever_strikes() {
    let first = ferrocnc_tests::from_environment("FERROCNC_SEED", 1);
    let looked_at = LOOKED_AT[usize::from(std::env::var_os("FERROCNC_STOPS").is_some())];
    let mut machine = BenchMachine::start();
    machine.acquire();
    machine.configure();
    let mut used = Used::default();
    let machines = ferrocnc_tests::from_environment("FERROCNC_STOPS", MACHINES);
    let mut late_max = [0; 2];
    for seed in first..first + machines {
        let stop = any_session(&mut machine, seed, looked_at);
        if let Some(part) = stop.used {
            used.see(stop.cause, part);
        }
        let by_datagram = usize::from(stop.cause.late() == LATE[1]);
        late_max[by_datagram] = stop.late.max(late_max[by_datagram]);
    }
    let more = serde_json::json!({
        "machines": machines, "late_clocks_max": late_max, "steps_off_allowed": OFF,
    });
    used.report("sessions on the RTL", more);
}

/// How a random machine stopped.
struct Stop {
    cause: Cause,
    /// Clocks from the request to the stop.
    late: u64,
    /// The largest share of the way to rest that was used, if the stop was seen to its end.
    used: Option<f64>,
}

/// Stops a random machine for a random cause and looks at it for `looked_at` seconds.
fn any_session(machine: &mut BenchMachine, seed: u64, looked_at: f64) -> Stop {
    let clock_hz = BenchMachine::clock_hz(machine);
    let mut random = Pcg32::seed_from_u64(seed);
    let axes = any_machine(&mut random);
    let cause = CAUSES[random.random_range(0..CAUSES.len())];
    let told = format!("FERROCNC_SEED={seed}, {cause:?}, {axes:?}");
    let (mut command, last) = drives(machine, &axes);
    let bite = last + (SHORT * clock_hz) as u64;
    let stop = strikes(machine, cause, &mut command, bite, &told);
    let takes = axes.iter().fold(0.0f64, |t, (v, a)| t.max(v.abs() / a));
    let whole = takes + 1e-3 < looked_at;
    machine.run_clocks(((SHORT + takes.min(looked_at) + 5e-4) * clock_hz) as u64);
    let (late, used) = match cause {
        Cause::Reset => {
            let steps = machine.edge_watch().take_steps();
            let late = steps.iter().filter(|step| step.clock > stop + 4);
            assert_eq!(late.count(), 0, "{told}");
            (0, 0.0)
        }
        _ => {
            let (late, used) = brakes_in_its_own_way(machine, &axes, (stop, cause.late()), &told);
            println!("seed {seed}, {cause:?}: braking {late} clocks after it was asked for");
            (late, used)
        }
    };
    assert!(
        !whole || !BenchMachine::gate_open(machine),
        "{told}: the gate is open"
    );
    // Nothing waits for the heavy ones to stand.
    machine.external_reset_until_safe();
    machine.rig().ext_reset(false);
    machine.rig().freeze_cpu(false);
    machine.run_millis(4);
    machine.acquire();
    let status = machine.exchange(&mut Command::default());
    for (n, (position, _)) in status.stepgen.iter().enumerate().take(6) {
        assert_eq!(position.0 >> 32, machine.pulses(n), "{told}: axis {n}");
    }
    assert_eq!(machine.broken_rules(), [], "{told}");
    let used = whole.then_some(used);
    Stop { cause, late, used }
}
