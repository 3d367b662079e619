//! Promises that other controllers break, tested on the RTL board.
//!
//! A test has the name of the promise; its comment says which peer breaks it, and how. Promises of
//! a driver are in `host/tests/peers.rs`, those of the parser of LiteEth in `soc/`, those of job
//! executors in `sim/tests/executor/peers.rs`.

use ferrocnc_tests::BenchMachine;
use wire::describe::Channels;
use wire::exchange::{Latch, PWM_ENABLE, PWM_FRACTION};
use wire::map::{self, StepgenConfig};
use wire::state::{FaultReason, State};
use wire::units::{Accel, Velocity};

/// Address of a word of stepgen `n`'s settings.
fn stepgen(n: u32, word: StepgenConfig) -> u32 {
    map::CONFIG_STEPGEN + n * map::CONFIG_STRIDE + 4 * word as u32
}

/// Lcnc: after a reversal the first step may come before DIR has been stable for the set-up time,
/// and steps are given in the wrong direction while DIR is held.
#[test]
fn no_step_comes_before_the_direction_is_set_up_or_while_it_is_held() {
    let (mut machine, mut command) = BenchMachine::turning(450e3, 3);
    for reversal in 0..40 {
        command.stepgen[0].0 = Velocity(-command.stepgen[0].0.0);
        let status = machine.exchange_and_wait(&mut command);
        assert_eq!(
            status.state.state,
            State::Armed,
            "reversal {reversal} stopped the machine"
        );
    }
    command.stepgen[0].0 = Velocity(0);
    machine.exchange_and_wait(&mut command);
    let status = machine.exchange(&mut command);
    assert_eq!(
        machine.timing_violations(),
        0,
        "DIR set-up and hold at the pins"
    );
    assert_eq!(
        status.stepgen[0].0.pulses(),
        machine.pulses(0),
        "no pulse in the wrong direction"
    );
}

/// Lcnc: pulses merge into one when the step width reaches the period of the step rate asked for.
#[test]
fn pulses_stay_apart_when_the_rate_is_more_than_their_length_allows() {
    // 1 us + 1 us allows 500 kHz; a third more is asked for.
    let (mut machine, mut command) = BenchMachine::turning(666e3, 3);
    let status = machine.exchange_and_wait(&mut command);
    let before = (status.stepgen[0].0.pulses(), status.sample.0);
    let status = machine.exchange_and_wait(&mut command);
    let (pulses, clocks) = (
        status.stepgen[0].0.pulses() - before.0,
        status.sample.0 - before.1,
    );
    // A pulse every 120 clocks, plus the clock in which each waits for its turn at most.
    let slowest = clocks / 121 - 1;
    assert!(
        (slowest..=clocks / 120 + 1).contains(&(pulses as u64)),
        "{pulses} pulses in {clocks} clocks"
    );
    assert_eq!(status.rate_limited & 1, 1, "and says so");
    command.stepgen[0].0 = Velocity(0);
    machine.exchange_and_wait(&mut command);
    let status = machine.exchange(&mut command);
    assert_eq!(status.stepgen[0].0.pulses(), machine.pulses(0));
    assert_eq!(machine.timing_violations(), 0);
}

/// Lcnc: a bite of the watchdog zeroes the counters, and LinuxCNC's position jumps.
#[test]
fn a_bite_keeps_the_counters() {
    let (mut machine, mut command) = BenchMachine::turning(100e3, 3);
    machine.run_millis(20);
    assert!(!machine.gate_open(), "it has bitten");
    let pulses = machine.pulses(0);
    assert!(pulses > 100);
    machine.acquire();
    let status = machine.exchange(&mut command);
    assert_eq!(status.state.reason, FaultReason::Watchdog);
    assert_eq!(status.stepgen[0].0.pulses(), pulses);
    assert_eq!(
        i64::from(status.encoder[0].count.0 as i32),
        pulses,
        "nor the encoder's"
    );
}

/// Lcnc: `assert < 16` and `< 32` make 15 and 31 the real limits.
#[test]
fn sixteen_channels_and_thirty_two_pins_are_there() {
    assert!(Channels::from_words(16 | 16 << 8 | 16 << 16, 32 | 32 << 8).is_ok());
    // The sixteenth has its settings and its latch; `boards/max.toml`, which is elaborated in the
    // tests, has all of them.
    const { assert!(map::CONFIG_STEPGEN + 16 * map::CONFIG_STRIDE <= map::CONFIG_PWM) };
    assert_eq!(Latch::Stepgen(15).code(), 31);
}

/// LiteX-CNC: the speed's fixed point is off by two, and the top octave wraps into the other
/// direction.
#[test]
fn the_highest_rates_keep_their_sign() {
    let mut machine = BenchMachine::start();
    machine.acquire();
    machine.configure();
    for word in [StepgenConfig::Steplen, StepgenConfig::Stepspace] {
        machine.write(stepgen(0, word), 1);
    }
    let mut command = machine.enabled_command();
    machine.rearm(&mut command);
    for velocity in [i32::MAX, -i32::MAX, i32::MIN] {
        let before = machine.exchange(&mut command);
        command.stepgen[0] = (Velocity(velocity), Accel::UNLIMITED);
        machine.exchange(&mut command);
        let first = machine.exchange(&mut command);
        let second = machine.exchange(&mut command);
        let moved = second.stepgen[0].0.pulses() - first.stepgen[0].0.pulses();
        let clocks = (second.sample.0 - first.sample.0) as i64;
        assert_eq!(
            moved.signum(),
            i64::from(velocity.signum()),
            "velocity {velocity}: {moved} steps in {clocks} clocks"
        );
        assert!(
            (moved.abs() - clocks / 2).abs() <= 1,
            "velocity {velocity}: {moved} steps in {clocks} clocks is not half the clock"
        );
        assert!(before.state.enabled);
        command.stepgen[0].0 = Velocity(0);
        machine.exchange(&mut command);
    }
}

/// LiteX-CNC: the direction's set-up time counts from the last step, so a DIR edge long after it is
/// followed by a step one clock later.
#[test]
fn the_direction_is_set_up_from_its_own_edge() {
    let (mut machine, mut command) = BenchMachine::turning(50e3, 3);
    // A long rest first: the last step is far away when the direction changes.
    command.stepgen[0].0 = Velocity(0);
    for _ in 0..3 {
        machine.exchange_and_wait(&mut command);
    }
    command.stepgen[0].0 = Velocity::from_hz(-450e3, machine.clock_hz());
    machine.exchange_and_wait(&mut command);
    assert!(machine.edges(0) > 100);
    assert_eq!(machine.timing_violations(), 0);
}

/// LiteX-CNC: a bite is not latched; the next frame lets the machine go on.
#[test]
fn a_bite_is_latched() {
    let (mut machine, mut command) = BenchMachine::turning(100e3, 3);
    machine.run_millis(20);
    let pulses = machine.edges(0);
    machine.acquire();
    for _ in 0..10 {
        let status = machine.exchange_and_wait(&mut command);
        assert!(status.state.bitten && !status.state.enabled);
    }
    assert_eq!(machine.edges(0), pulses, "nothing moved");
}

/// LiteX-CNC: `enable` of a stepgen never reaches the FPGA.
#[test]
fn enable_reaches_its_stepgen() {
    let (mut machine, mut command) = BenchMachine::turning(100e3, 3);
    command.stepgen_enable = 0;
    machine.exchange_and_wait(&mut command);
    machine.exchange_and_wait(&mut command);
    let edges = machine.edges(0);
    for _ in 0..3 {
        machine.exchange_and_wait(&mut command);
    }
    assert_eq!(
        machine.edges(0),
        edges,
        "the velocity is still commanded, the enable is gone"
    );
    assert!(
        machine.gate_open(),
        "and the board is armed: only this channel stands"
    );
}

/// LiteX-CNC: `index-enable` of a stepgen is never sent, and arming it corrupts the speed in
/// reverse.
#[test]
fn arming_an_index_leaves_the_speed_in_reverse_as_it_is() {
    let (mut machine, mut command) = BenchMachine::turning(-100e3, 3);
    let velocity = command.stepgen[0].0;
    command.stepgen_index_arm = u16::MAX;
    command.index_arm = u16::MAX;
    command.latch = Latch::Encoder(0);
    for _ in 0..45 {
        let status = machine.exchange_and_wait(&mut command);
        assert_eq!(status.stepgen[0].1, velocity);
    }
    let status = machine.exchange(&mut command);
    assert_eq!(
        status.index_latched & 1,
        1,
        "the arm bit arrived: -4500 counts is past the index at -4000"
    );
    assert!(
        (status.latch.0 as i32 + 4000).abs() <= 1,
        "{}",
        status.latch.0 as i32
    );
}

/// LiteX-CNC: timings wider than their fields overflow into their neighbours.
#[test]
fn a_timing_that_is_too_long_is_refused_and_changes_no_other() {
    let mut machine = BenchMachine::start();
    machine.acquire();
    machine.configure();
    let words = [
        (StepgenConfig::Steplen, map::STEP_CLOCKS_MAX),
        (StepgenConfig::Stepspace, map::STEP_CLOCKS_MAX),
        (StepgenConfig::Dirsetup, map::DIR_CLOCKS_MAX),
        (StepgenConfig::Dirhold, map::DIR_CLOCKS_MAX),
    ];
    for (word, most) in words {
        let others: Vec<u32> = words
            .iter()
            .map(|(w, _)| machine.read(stepgen(0, *w)))
            .collect();
        machine.write(stepgen(0, word), most + 1);
        let after: Vec<u32> = words
            .iter()
            .map(|(w, _)| machine.read(stepgen(0, *w)))
            .collect();
        assert_eq!(others, after, "{word:?} = {} is refused", most + 1);
        machine.write(stepgen(0, word), most);
        assert_eq!(machine.read(stepgen(0, word)), most);
    }
    // 12 775 ns and 409 575 ns at 40 MHz, what the peers promise, fit.
    const { assert!(map::STEP_CLOCKS_MAX >= 511 && map::DIR_CLOCKS_MAX >= 16_383) };
}

/// LiteX-CNC: the pin `dither-pwm` does nothing.
#[test]
fn dither_is_seen_at_the_pin() {
    let mut machine = BenchMachine::start();
    machine.acquire();
    machine.configure();
    // 120 clocks: 100 periods in the 12 000 clocks that are counted.
    machine.write(map::CONFIG_PWM, 120);
    machine.write(map::CONFIG_PWM + 4, map::PWM_DITHER);
    let mut command = machine.enabled_command();
    machine.rearm(&mut command);
    let width = |clocks: f64| PWM_ENABLE | (clocks * f64::from(1 << PWM_FRACTION)) as u32;
    for (asked, expected) in [(60.0, 6000), (60.25, 6025), (60.5, 6050), (60.75, 6075)] {
        command.pwm[0] = width(asked);
        machine.exchange_and_wait(&mut command);
        machine.exchange(&mut command);
        let high = machine.pwm_high(0);
        assert!(
            high.abs_diff(expected) <= 1,
            "{asked} of 120 clocks: {high} of 12 000, not {expected}"
        );
    }
}

/// RIO: the step rate is clock / integer, so the top of the range is coarse, and a shorter period
/// cuts into the running one.
#[test]
fn the_rate_between_two_periods_is_right_on_average() {
    let (mut machine, mut command) = BenchMachine::turning(440e3, 3);
    // 60 MHz / 440 kHz is 136.36 clocks: between two integers. The average must be right.
    let first = machine.exchange_and_wait(&mut command);
    for _ in 0..10 {
        machine.exchange_and_wait(&mut command);
    }
    let last = machine.exchange(&mut command);
    let steps = last.stepgen[0].0.since(first.stepgen[0].0);
    let seconds = (last.sample.0 - first.sample.0) as f64 / machine.clock_hz();
    assert!(
        (steps - 440e3 * seconds).abs() < 1.0,
        "{} steps/s",
        steps / seconds
    );
    // The period shrinks and grows under way: no pulse is cut, none comes early.
    for velocity in [450e3, 30e3, 449e3, 100e3, 450e3] {
        command.stepgen[0].0 = Velocity::from_hz(velocity, machine.clock_hz());
        machine.exchange_and_wait(&mut command);
    }
    assert_eq!(machine.timing_violations(), 0);
}
