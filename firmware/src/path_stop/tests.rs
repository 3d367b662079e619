use super::*;
use crate::cores::{Control, Gate};
use crate::fake::*;
use proptest::prelude::*;
use wire::exchange::Command;
use wire::map;
use wire::regmap::status;
use wire::units::{Accel, Velocity};

/// Clocks until an axis of this speed stands with this deceleration.
fn clocks_to_rest(speed: u32, accel: u32) -> f64 {
    f64::from(speed) * f64::from(1 << FRACTION) / f64::from(accel)
}

fn shares(axes: &[(u32, u32)]) -> Vec<u32> {
    let mut slowest = Slowest::NONE;
    let axis = |&(speed, configured): &(u32, u32)| Axis { configured, speed };
    axes.iter().for_each(|pair| slowest.meet(&axis(pair)));
    let pace = slowest.pace();
    axes.iter().map(|pair| pace.share(&axis(pair))).collect()
}

/// A speed or an acceleration of any magnitude.
fn any_size() -> impl Strategy<Value = u32> {
    (0u32..32, any::<u32>()).prop_map(|(shift, value)| value >> shift)
}

proptest! {
    #[test]
    fn all_axes_take_the_time_of_the_slowest_and_none_brakes_harder_than_configured(
        axes in proptest::collection::vec((any_size(), any_size().prop_map(|a| a.max(1))), 1..=16)
    ) {
        let axes: Vec<_> = axes.into_iter().map(|(v, a)| (v.min(1 << 31), a)).collect();
        let most = axes
            .iter()
            .map(|(speed, accel)| clocks_to_rest(*speed, *accel))
            .fold(0.0, f64::max);
        for ((speed, configured), share) in axes.iter().zip(shares(&axes)) {
            prop_assert!(share >= 1 && share <= *configured, "{share} of {configured}");
            if *speed == 0 {
                prop_assert_eq!(share, *configured);
                continue;
            }
            let exact = f64::from(*speed) * f64::from(1 << FRACTION) / most;
            let takes = clocks_to_rest(*speed, share);
            prop_assert!(takes <= most * (1.0 + 1e-12), "late: {} of {} clocks", takes, most);
            if share > configured >> FLOOR_SHIFT {
                let slack = 2.0 + exact * 4e-9;
                prop_assert!(f64::from(share) <= exact + slack, "{} for {}", share, exact);
            }
        }
    }

    #[test]
    fn beside_an_axis_that_brakes_as_hard_as_can_be_said_none_is_late_by_a_single_unit(
        accel in 1u32 << 31..=u32::MAX, speed in 1u32..=1 << 31, shift in 0u32..7, part in 0u32..=1000
    ) {
        let slowest = (speed >> shift).max(1);
        let speed = (u64::from(slowest) * u64::from(part) / 1000) as u32;
        prop_assume!(speed > 0 && u64::from(speed) * u64::from(accel) <= u64::from(slowest) * u64::from(u32::MAX));
        let [first, share] = shares(&[(slowest, accel), (speed, u32::MAX)])[..] else {
            unreachable!()
        };
        prop_assert_eq!(first, accel);
        // share / speed >= accel / slowest, in whole numbers.
        let (have, need) = (u128::from(share) * u128::from(slowest), u128::from(speed) * u128::from(accel));
        prop_assert!(have >= need, "{} for {}", share, need / u128::from(slowest));
        let most = need / u128::from(slowest) + 2 + ((need / u128::from(slowest)) >> 27);
        prop_assert!(u128::from(share) <= most.max(u128::from(u32::MAX >> FLOOR_SHIFT)), "{} of {}", share, most);
    }

    #[test]
    fn the_speed_after_a_while_is_the_ramps(
        now in any::<i32>(), target in any::<i32>(), limit in any_size(), clocks in 0u32..60_000_000
    ) {
        let now = now.max(-i32::MAX);
        let (v, to) = (f64::from(now), f64::from(target));
        let reach = (f64::from(limit) * f64::from(clocks) / f64::from(1 << FRACTION)).floor();
        let want = if limit == 0 { to } else { to.clamp(v - reach, v + reach) };
        let want = want.clamp(-2_147_483_648.0, 2_147_483_647.0);
        prop_assert_eq!(f64::from(speed_after(now, target, limit, clocks)), want.abs());
    }
}

#[test]
fn an_axis_half_as_fast_brakes_half_as_hard() {
    let [x, y] = shares(&[(1_000_000, 80_000), (500_000, 80_000)])[..] else {
        unreachable!()
    };
    assert_eq!(x, 80_000);
    assert!((40_000..=40_001).contains(&y), "{y}");
}

#[test]
fn the_axis_that_needs_longest_sets_the_time_not_the_fastest() {
    // Z is slow and brakes gently: 100 against 20.
    let [x, z] = shares(&[(1_000_000, 50_000), (100_000, 1_000)])[..] else {
        unreachable!()
    };
    assert_eq!(z, 1_000);
    assert!((10_000..=10_001).contains(&x), "{x}");
}

#[test]
fn an_axis_at_rest_keeps_what_was_configured() {
    assert_eq!(shares(&[(0, 77), (0, 99)]), [77, 99]);
    assert_eq!(shares(&[(0, 77), (5_000, 99)]), [77, 99]);
}

#[test]
fn no_axis_brakes_at_less_than_its_floor() {
    let [_, y] = shares(&[(1 << 24, 80_000), (1, 80_000)])[..] else {
        unreachable!()
    };
    assert_eq!(y, 80_000 >> FLOOR_SHIFT);
}

// ---- through the server -------------------------------------------------------------------------

const CONFIGURED: [u32; 3] = [80_000, 80_000, 40_000];

/// Armed, three axes configured.
fn armed() -> Rig {
    armed_of(Rig::new())
}

fn armed_of(mut rig: Rig) -> Rig {
    rig.board
        .set(Setting::Board(BoardConfig::WatchdogTimeout), 300_000);
    rig.acquire();
    for (n, accel) in (0..).zip(CONFIGURED) {
        rig.write(address(n), accel).unwrap();
    }
    rig.arm();
    rig
}

fn address(n: u32) -> u32 {
    map::CONFIG_STEPGEN + n * map::CONFIG_STRIDE + 4 * StepgenConfig::StopAccel as u32
}

/// The decelerations in the cores.
fn cores(rig: &mut Rig) -> [u32; 3] {
    [0, 1, 2].map(|n| rig.board.setting(stop_accel(n)))
}

/// A command that moves the three axes at these velocities, which they already have.
fn moving(rig: &mut Rig, velocities: [i32; 3]) -> Command {
    let mut command = rig.command(true, true);
    for (n, velocity) in velocities.into_iter().enumerate() {
        command.stepgen[n] = (Velocity(velocity), Accel(100_000));
        rig.board.latched[status::STEPGEN0_VELOCITY + n * STATUS_STEPGEN] = velocity as u32;
    }
    command
}

fn exchange(rig: &mut Rig, command: &Command) {
    rig.exchange_as(ALICE, command).unwrap();
    if rig.server.owes_path() {
        rig.server.hold_path(&mut rig.board);
    }
}

#[test]
fn behind_a_command_the_cores_hold_decelerations_that_fit_each_other() {
    let mut rig = armed();
    let command = moving(&mut rig, [1_000_000, -500_000, 0]);
    exchange(&mut rig, &command);
    assert_eq!(cores(&mut rig), [80_000, 40_001, 40_000]);
    let command = moving(&mut rig, [500_000, -500_000, 1_000_000]);
    exchange(&mut rig, &command);
    assert_eq!(cores(&mut rig), [20_001, 20_001, 40_000]);
}

#[test]
fn it_is_done_once_for_a_command_and_never_for_a_refused_one() {
    let mut rig = armed();
    let command = moving(&mut rig, [1_000_000, -500_000, 0]);
    exchange(&mut rig, &command);
    assert!(!rig.server.owes_path(), "done");
    let mut stale = moving(&mut rig, [1, 1, 1]);
    stale.sequence -= 1;
    assert!(rig.exchange_as(ALICE, &stale).is_err());
    assert!(!rig.server.owes_path());
}

#[test]
fn an_axis_alone_or_disabled_keeps_its_configuration_and_delays_no_other() {
    let mut rig = armed();
    let mut command = moving(&mut rig, [1_000_000, -500_000, 20_000_000]);
    command.stepgen_alone = 0b100;
    exchange(&mut rig, &command);
    assert_eq!(cores(&mut rig), [80_000, 40_001, 40_000]);
    let mut command = moving(&mut rig, [20_000_000, 1_000_000, -500_000]);
    command.stepgen_enable = 0b110;
    exchange(&mut rig, &command);
    assert_eq!(cores(&mut rig), [80_000, 80_000, 40_000]);
}

#[test]
fn an_axis_configured_to_stop_at_once_does_and_delays_no_other() {
    let mut rig = Rig::new();
    rig.acquire();
    rig.write(address(0), 0).unwrap();
    rig.write(address(1), 80_000).unwrap();
    rig.arm();
    let command = moving(&mut rig, [20_000_000, 1_000_000, 0]);
    exchange(&mut rig, &command);
    assert_eq!(cores(&mut rig), [0, 80_000, 0]);
}

#[test]
fn an_axis_that_brakes_towards_zero_is_not_taken_for_one_that_stands() {
    let mut rig = armed();
    let mut command = moving(&mut rig, [16_000_000, 1_000_000, 0]);
    // At 1000 a clock X loses 17 units in the 300 000 clocks to the bite.
    command.stepgen[0] = (Velocity(0), Accel(1000));
    exchange(&mut rig, &command);
    let [x, y, _] = cores(&mut rig);
    assert_eq!(x, 80_000, "{y}");
    assert!((5_000..=5_002).contains(&y), "{y}");
}

#[test]
fn an_axis_that_a_stop_may_meet_at_speed_is_not_taken_for_as_slow_as_it_will_be() {
    let mut rig = armed();
    let mut command = moving(&mut rig, [1_000_000, 500_000, 0]);
    // Y stands nearly at the bite, and still has its old speed if the host stops now.
    command.stepgen[1] = (Velocity(1), Accel::UNLIMITED);
    exchange(&mut rig, &command);
    assert_eq!(cores(&mut rig), [80_000, 40_001, 40_000]);
}

#[test]
fn while_segments_play_every_axis_keeps_what_was_configured() {
    const SEEN: [i32; 3] = [1_000_000, -500_000, 3];
    for state in 1..4 {
        let mut rig = armed_of(Rig::with_segments());
        let mut command = moving(&mut rig, SEEN);
        exchange(&mut rig, &command);
        assert_ne!(cores(&mut rig), CONFIGURED, "as the session left it");
        // The executor's command in a job: no velocities.
        rig.board.segments = state << 8;
        command = moving(&mut rig, SEEN);
        command.stepgen = [(Velocity(0), Accel(500)); 16];
        exchange(&mut rig, &command);
        assert_eq!(cores(&mut rig), CONFIGURED, "state {state}");
    }
}

#[test]
fn a_timed_command_counts_as_fast_as_it_is_or_will_be() {
    let mut rig = armed();
    let mut command = moving(&mut rig, [1_000_000, 500_000, 0]);
    command.stepgen[0].0 = Velocity(250_000);
    command.apply_at = Some(wire::units::Clocks(u64::MAX));
    exchange(&mut rig, &command);
    assert_eq!(cores(&mut rig), [80_000, 40_001, 40_000]);
}

#[test]
fn what_was_configured_reads_back_as_configured_and_is_there_again_at_rest() {
    let mut rig = armed();
    let command = moving(&mut rig, [1_000_000, -500_000, 250_000]);
    exchange(&mut rig, &command);
    assert_ne!(cores(&mut rig), CONFIGURED);
    for (n, accel) in (0..).zip(CONFIGURED) {
        assert_eq!(rig.read(address(n)), Ok(accel));
    }
    let down = rig.command(false, true);
    exchange(&mut rig, &down);
    assert_ne!(cores(&mut rig), CONFIGURED, "needed for the stop");
    rig.board.gate = 0;
    rig.server.poll(&mut rig.board);
    assert_eq!(cores(&mut rig), CONFIGURED);
    assert_eq!(rig.read(address(1)), Ok(CONFIGURED[1]));
}

#[test]
fn a_setting_written_as_soon_as_the_machine_rests_is_not_undone() {
    let mut rig = armed();
    let command = moving(&mut rig, [1_000_000, -500_000, 250_000]);
    exchange(&mut rig, &command);
    rig.board.estop = true;
    let look = rig.command(true, true);
    exchange(&mut rig, &look);
    assert!(rig.server.safety().at_rest());
    // No poll in between.
    rig.write(address(1), 1234).unwrap();
    rig.server.poll(&mut rig.board);
    assert_eq!(cores(&mut rig), [CONFIGURED[0], 1234, CONFIGURED[2]]);
    assert_eq!(rig.read(address(1)), Ok(1234));
}

#[test]
fn each_axis_is_taken_as_fast_as_its_own_command_makes_it_by_the_bite() {
    let from_rest = |commands: [(i32, u32); 3]| {
        let mut rig = armed();
        let mut command = moving(&mut rig, [0, 0, 0]);
        for (n, (velocity, accel)) in commands.into_iter().enumerate() {
            command.stepgen[n] = (Velocity(velocity), Accel(accel));
        }
        exchange(&mut rig, &command);
        cores(&mut rig)
    };
    // At 50 000 000 a clock X has 894 069 units after the 300 000 clocks to the bite; Y has half,
    // Z a quarter of it.
    let far = 2_000_000;
    let ramping = from_rest([(far, 50_000_000), (-far, 25_000_000), (far, 12_500_000)]);
    // Without a limit each has its target.
    let jumping = from_rest([(1_000_000, 0), (-500_000, 0), (250_000, 0)]);
    for [x, y, z] in [ramping, jumping] {
        assert_eq!(x, 80_000);
        assert!((40_000..=40_002).contains(&y), "{y}");
        assert!((20_000..=20_002).contains(&z), "{z}");
    }
}

#[test]
fn an_ordered_stop_is_on_the_path_too() {
    let mut rig = armed();
    let command = moving(&mut rig, [1_000_000, -500_000, 0]);
    exchange(&mut rig, &command);
    let down = rig.command(false, true);
    exchange(&mut rig, &down);
    assert!(rig.board.done.contains(&Change::Order(Control::SoftStop)));
    assert!(Gate(rig.board.gate).stopping());
    assert_eq!(cores(&mut rig), [80_000, 40_001, 40_000]);
}
