//! Promises that other drivers break. A test has the name of the promise; its comment says which
//! peer breaks it, and how.
//!
//! The defects were found by reading and simulating Lcnc, LiteX-CNC, hostmot2 and Remora. Those
//! that concern gateware are in `tests/tests/peers.rs`.

#[path = "common/fake_board.rs"]
mod common;

use common::rig::{PERIOD_NS, Rig, load_with};
use common::{CLOCK_HZ, FakeBoard, Time};
use ferrocnc::blocks::Period;
use ferrocnc::blocks::encoder::Encoder;
use ferrocnc::blocks::latch::LatchSample;
use ferrocnc::blocks::pwm::Pwm;
use ferrocnc::blocks::stepgen::Stepgen;
use ferrocnc::blocks::wallclock::Wallclock;
use ferrocnc::hal::fake::FakeHal;
use ferrocnc::hal::{Direction, Exporter};
use ferrocnc::names::Scheme;
use wire::describe::Channels;
use wire::exchange::{EncoderStatus, PWM_FRACTION};
use wire::map::{PwmType, StepType};
use wire::units::{Clocks, Count, Velocity};
use wire::{FaultReason, map};

/// `Lcnc.c` 841: the old position is taken after the new one was stored.
#[test]
fn an_encoder_that_turns_has_its_velocity() {
    let mut rig = Rig::named(&Scheme::Lcnc);
    rig.hal.set("Lcnc.00.stepgen.00.scale", 100.0);
    rig.hal.set("Lcnc.00.stepgen.00.acc_lim", 5000.0);
    rig.hal.set("Lcnc.00.encoder.00.scale", 0.01);
    rig.hal.set("Lcnc.00.encoder.00.enable", true);
    rig.arm();
    rig.hal.set("Lcnc.00.stepgen.00.enable", true);
    rig.hal.set("Lcnc.00.stepgen.00.vel-cmd", 20.0);
    rig.run(100);
    let velocity: f64 = rig.hal.get("Lcnc.00.encoder.00.vel-fb");
    assert!((velocity - 20.0).abs() < 0.5, "{velocity}");
}

/// Lcnc's encoder counts while its `enable` is true, which nothing but HAL sets.
#[test]
fn an_encoder_counts_while_it_is_enabled() {
    let mut rig = Rig::named(&Scheme::Lcnc);
    let turn = |rig: &mut Rig, on: bool| {
        rig.hal.set("Lcnc.00.encoder.00.enable", on);
        rig.run(50);
        let at: f64 = rig.hal.get("Lcnc.00.encoder.00.pos-fb");
        at
    };
    rig.hal.set("Lcnc.00.stepgen.00.scale", 100.0);
    rig.hal.set("Lcnc.00.stepgen.00.acc_lim", 5000.0);
    rig.arm();
    rig.hal.set("Lcnc.00.stepgen.00.enable", true);
    rig.hal.set("Lcnc.00.stepgen.00.vel-cmd", 20.0);
    assert_eq!(turn(&mut rig, false), 0.0, "nothing has enabled it");
    let once = turn(&mut rig, true);
    assert!(once > 0.0, "{once}");
    assert_eq!(turn(&mut rig, false), once);
    assert!(turn(&mut rig, true) > once);
}

/// `Lcnc.c` 806: operands are swapped when the counter wrapped, every 107 s at 40 MHz.
#[test]
fn the_wallclock_interval_is_right_where_32_bits_wrap() {
    let mut hal = FakeHal::new();
    let mut clock = Wallclock::export(&mut Exporter::new(&mut hal, "b")).unwrap();
    for n in 0..10u64 {
        let now = (1 << 32) - 4 * 60_000 + n * 60_000;
        assert!(clock.sampled(Clocks(now), f64::from(CLOCK_HZ)));
        if n > 0 {
            assert_eq!(hal.get::<f64>("b.wallclock.interval"), 0.001, "at {now:#x}");
        }
    }
}

/// Lcnc: no sequence numbers: whatever arrives first is the answer.
#[test]
fn a_late_reply_is_not_taken_as_current() {
    let mut rig = Rig::armed();
    rig.hal.set("ferrocnc.0.packet-read-timeout", 20_000_000);
    rig.hal.set("ferrocnc.0.packet-error-limit", 100);
    rig.board.look().knobs.late_by_one = true;
    let before: i32 = rig.hal.get("ferrocnc.0.packet-error-level");
    let counts: i32 = rig.hal.get("ferrocnc.0.stepgen.x.counts");
    rig.run(4);
    assert!(rig.hal.get::<bool>("ferrocnc.0.packet-error"));
    assert!(rig.hal.get::<i32>("ferrocnc.0.packet-error-level") > before);
    assert_eq!(rig.hal.get::<i32>("ferrocnc.0.stepgen.x.counts"), counts);
}

/// Lcnc: `F_FPGA 40000000` whatever the board was built with.
#[test]
fn the_clock_is_that_of_the_board() {
    let mut hal = FakeHal::new();
    let mut stepgen =
        Stepgen::export(&mut Exporter::new(&mut hal, "s"), StepType::StepDir).unwrap();
    hal.set("s.steplen", 1000u32);
    for (clock, clocks) in [(40e6, 40), (50e6, 50), (60e6, 60)] {
        assert_eq!(stepgen.configure(clock)[0], clocks, "1 us at {clock} Hz");
    }
}

/// Lcnc: the stepgens forget where they are, and the driver adds the difference.
#[test]
fn the_position_stays_when_the_watchdog_bites() {
    let mut rig = Rig::armed();
    rig.travel(5.0, 200);
    rig.run(60);
    let before: f64 = rig.hal.get("ferrocnc.0.stepgen.x.position-fb");
    rig.board.look().advance(60_000 * 100);
    rig.hal.set("ferrocnc.0.packet-read-timeout", 1_000_000);
    for _ in 0..300 {
        rig.run(1);
        std::thread::sleep(std::time::Duration::from_millis(1));
    }
    let reason: u32 = rig.hal.get("ferrocnc.0.fault-reason");
    assert_eq!(reason, u32::from(FaultReason::Watchdog.code()));
    let after: f64 = rig.hal.get("ferrocnc.0.stepgen.x.position-fb");
    assert!((after - before).abs() < 1e-6, "{before} became {after}");
}

/// Lcnc: `assert < 16` and `< 32`: 15 and 31 are the most.
#[test]
fn all_channels_of_the_largest_board_are_there() {
    let most = Channels {
        stepgens: 16,
        encoders: 16,
        pwms: 16,
        inputs: 32,
        outputs: 32,
    };
    let board = FakeBoard::of("127.0.0.1:0", most, Time::Lockstep(60_000));
    let mut hal = FakeHal::new();
    let (mut driver, _) = load_with(&board, &mut hal, 0);
    for name in [
        "ferrocnc.0.stepgen.15.position-cmd",
        "ferrocnc.0.encoder.15.position-latched",
        "ferrocnc.0.pwm.15.value",
        "ferrocnc.0.gpio.31.in",
        "ferrocnc.0.gpio.31.out",
    ] {
        assert!(hal.list().any(|(known, _, _)| known == name), "{name}");
    }
    // And the largest board can be talked to: its settings and its exchange fit their datagrams.
    hal.set("ferrocnc.0.packet-read-timeout", 200_000_000);
    hal.set("ferrocnc.0.gpio.31.debounce-ns", 1_000_000u32);
    for _ in 0..100 {
        driver.read(PERIOD_NS);
        driver.write(PERIOD_NS);
        std::thread::sleep(std::time::Duration::from_millis(1));
    }
    let board = board.look();
    assert!(board.exchanges > 10, "{} exchanges", board.exchanges);
    assert_eq!(board.refused, 0);
    assert_eq!(board.config[&(map::CONFIG_DEBOUNCE + 4 * 31)], 1875);
}

/// Lcnc: the readme says `acc-lim`, the code exports `acc_lim`.
#[test]
fn a_pin_has_the_name_of_the_code_and_that_of_the_readme() {
    let rig = Rig::named(&Scheme::Lcnc);
    for (n, name) in [(0, "acc_lim"), (1, "acc-lim")] {
        rig.hal
            .set(&format!("Lcnc.00.stepgen.{n:02}.{name}"), 700.0);
        for same in ["acc_lim", "acc-lim"] {
            let value: f64 = rig.hal.get(&format!("Lcnc.00.stepgen.{n:02}.{same}"));
            assert_eq!(value, 700.0, "{same} after {name}");
        }
    }
    // `tests/pins.rs` compares every name with `docs/pins.md`.
}

/// LiteX-CNC: `max-frequency` is twice what the gateware can do, and the speed word wraps to the
/// other sign.
#[test]
fn the_top_speed_is_what_the_gateware_can_do_and_keeps_its_sign() {
    let mut rig = Rig::armed();
    rig.hal.set("ferrocnc.0.stepgen.x.control-type", true);
    rig.hal.set("ferrocnc.0.stepgen.x.maxaccel", 0.0);
    rig.hal.set("ferrocnc.0.stepgen.x.enable", true);
    // 1 us + 1 us: 500 kHz.
    let clock = f64::from(CLOCK_HZ);
    for (asked, hz) in [(1e3, 500e3), (-1e3, -500e3), (1e12, 500e3), (-1e20, -500e3)] {
        rig.hal.set("ferrocnc.0.stepgen.x.velocity-cmd", asked);
        rig.run(2);
        let (velocity, _) = rig.board.look().command.stepgen[0];
        assert_eq!(velocity, Velocity::from_hz(hz, clock), "asked for {asked}");
        assert!(rig.hal.get::<bool>("ferrocnc.0.stepgen.x.rate-limited"));
    }
    let mut rig = Rig::named(&Scheme::LitexCnc(vec!["test".to_owned()]));
    rig.hal.set("test.stepgen.00.steplen", 1000u32);
    rig.hal.set("test.stepgen.00.stepspace", 1000u32);
    rig.run(2);
    assert_eq!(rig.hal.get::<f64>("test.stepgen.00.max-frequency"), 500e3);
}

/// LiteX-CNC: a pet after the bite opens the outputs again.
#[test]
fn a_bite_is_latched() {
    let mut rig = Rig::named(&Scheme::LitexCnc(vec!["test".to_owned()]));
    rig.hal.set("test.watchdog.reset", true);
    rig.run(8);
    assert!(rig.hal.get::<bool>("test.watchdog.ok-out"));
    rig.board.look().advance(60_000 * 100);
    rig.hal.set("ferrocnc.0.packet-read-timeout", 1_000_000);
    for _ in 0..300 {
        rig.run(1);
        std::thread::sleep(std::time::Duration::from_millis(1));
    }
    rig.hal.set("ferrocnc.0.packet-read-timeout", 200_000_000);
    assert!(!rig.hal.get::<bool>("test.watchdog.ok-out"));
    assert!(rig.hal.get::<bool>("test.watchdog.fpga-timeout"));
    // Only a new edge.
    rig.hal.set("test.watchdog.reset", false);
    rig.run(3);
    rig.hal.set("test.watchdog.reset", true);
    rig.run(8);
    assert!(rig.hal.get::<bool>("test.watchdog.ok-out"));
    assert!(!rig.hal.get::<bool>("test.watchdog.fpga-timeout"));
}

/// LiteX-CNC: `a & 0x7FFFFFFF + flag`: the flag never arrives, the reverse speed is damaged.
#[test]
fn index_enable_is_sent_and_leaves_the_speed_as_it_is() {
    let mut rig = Rig::named(&Scheme::LitexCnc(vec!["test".to_owned()]));
    rig.hal.set("test.stepgen.00.max-acceleration", 0.0);
    rig.hal.set("test.stepgen.00.velocity-mode", true);
    rig.hal.set("test.stepgen.00.position-scale", 1000.0);
    rig.hal.set("test.watchdog.reset", true);
    rig.run(8);
    rig.hal.set("test.stepgen.00.enable", true);
    rig.hal.set("test.stepgen.00.velocity-cmd", -0.5);
    rig.run(2);
    let speed = rig.board.look().command.stepgen[0];
    rig.hal.set("test.stepgen.00.index-enable", true);
    rig.run(4);
    let board = rig.board.look();
    assert_eq!(board.command.stepgen_index_arm, 1);
    assert_eq!(board.command.stepgen[0], speed, "the speed is untouched");
}

/// LiteX-CNC: `read_errors -= 0`, and `comm-timeout` stays up for ever.
#[test]
fn read_errors_fall_again_and_so_does_comm_timeout() {
    let mut rig = Rig::named(&Scheme::LitexCnc(vec!["test".to_owned()]));
    rig.hal.set("ferrocnc.0.packet-read-timeout", 1_000_000);
    rig.board.look().knobs.unplugged = true;
    rig.run(10);
    assert!(rig.hal.get::<bool>("test.watchdog.comm-timeout"));
    assert!(rig.hal.get::<u32>("test.communications.read-errors") > 0);
    rig.board.look().knobs.unplugged = false;
    rig.hal.set("ferrocnc.0.packet-read-timeout", 200_000_000);
    for _ in 0..250 {
        rig.run(1);
        std::thread::sleep(std::time::Duration::from_millis(1));
    }
    assert!(!rig.hal.get::<bool>("test.watchdog.comm-timeout"));
    assert_eq!(rig.hal.get::<u32>("test.communications.read-errors"), 0);
    assert!(rig.hal.get::<u32>("test.communications.total-read-errors") >= 5);
}

/// LiteX-CNC: the stepgen's `enable` is exported and has no effect.
#[test]
fn the_enable_pin_stops_its_axis() {
    let mut rig = Rig::named(&Scheme::LitexCnc(vec!["test".to_owned()]));
    rig.hal.set("test.watchdog.reset", true);
    rig.run(8);
    rig.hal.set("test.stepgen.00.velocity-mode", true);
    rig.hal.set("test.stepgen.00.velocity-cmd", 5.0);
    rig.run(2);
    assert_eq!(rig.board.look().command.stepgen_enable & 1, 0);
    assert_eq!(rig.board.look().command.stepgen[0].0, Velocity(0));
    rig.hal.set("test.stepgen.00.enable", true);
    rig.run(2);
    assert_eq!(rig.board.look().command.stepgen_enable & 1, 1);
    assert_ne!(rig.board.look().command.stepgen[0].0, Velocity(0));
}

/// LiteX-CNC: the driver clips to 11, 11 and 13 bits what has 10, 10 and 12, so one timing
/// overflows into the next.
#[test]
fn a_timing_that_is_too_long_changes_no_other() {
    let mut hal = FakeHal::new();
    let mut stepgen =
        Stepgen::export(&mut Exporter::new(&mut hal, "s"), StepType::StepDir).unwrap();
    let usual = stepgen.configure(60e6);
    for (n, (name, most)) in [
        ("s.steplen", map::STEP_CLOCKS_MAX),
        ("s.stepspace", map::STEP_CLOCKS_MAX),
        ("s.dirsetup", map::DIR_CLOCKS_MAX),
        ("s.dirhold", map::DIR_CLOCKS_MAX),
    ]
    .into_iter()
    .enumerate()
    {
        let before: u32 = hal.get(name);
        hal.set(name, u32::MAX);
        let mut expected = usual;
        expected[n] = most;
        assert_eq!(stepgen.configure(60e6), expected, "{name}");
        hal.set(name, before);
    }
}

/// LiteX-CNC: `dither-pwm` is exported and has no effect.
#[test]
fn dither_reaches_the_gateware() {
    let mut hal = FakeHal::new();
    let mut pwm = Pwm::export(&mut Exporter::new(&mut hal, "p"), false, PwmType::Pwm).unwrap();
    hal.set("p.enable", true);
    hal.set("p.value", 1.0 / 3.0);
    hal.set("p.pwm-freq", 600_000.0);
    let plain = pwm.command(100, 60e6);
    hal.set("p.dither", true);
    assert_ne!(pwm.configure() & map::PWM_DITHER, 0);
    let dithered = pwm.command(100, 60e6);
    assert_eq!(plain & ((1 << PWM_FRACTION) - 1), 0);
    // A third of 100 clocks: 33 and 85/256.
    assert_eq!(dithered & 0xffff, 33 << PWM_FRACTION | 85);
    let mut rig = Rig::named(&Scheme::LitexCnc(vec!["test".to_owned()]));
    rig.hal.set("test.pwm.00.dither-pwm", true);
    rig.run(40);
    let mode = rig.board.look().config[&(map::CONFIG_PWM + 4)];
    assert_ne!(mode & map::PWM_DITHER, 0);
}

/// LiteX-CNC: as an input it cannot be cleared, and homing to the index never ends.
#[test]
fn index_enable_can_be_cleared_by_the_driver() {
    let mut rig = Rig::named(&Scheme::LitexCnc(vec!["test".to_owned()]));
    for name in [
        "test.encoder.00.index-enable",
        "test.stepgen.00.index-enable",
    ] {
        let found = rig.hal.aliases().find(|(known, _, _)| *known == name);
        assert_eq!(
            found.map(|(_, _, direction)| direction),
            Some(Direction::Io)
        );
    }
    rig.hal.set("test.watchdog.reset", true);
    rig.run(8);
    rig.board.look().knobs.index_at = Some(20);
    rig.hal.set("test.stepgen.00.velocity-mode", true);
    rig.hal.set("test.stepgen.00.max-acceleration", 0.0);
    rig.hal.set("test.stepgen.00.velocity-cmd", 1000.0);
    rig.hal.set("test.encoder.00.index-enable", true);
    rig.run(4);
    rig.hal.set("test.stepgen.00.enable", true);
    let mut pulses = 0;
    for _ in 0..40 {
        rig.run(1);
        pulses += i32::from(rig.hal.get::<bool>("test.encoder.00.index-pulse"));
    }
    assert!(!rig.hal.get::<bool>("test.encoder.00.index-enable"));
    assert_eq!(pulses, 1, "index-pulse for one period");
}

/// LiteX-CNC: buffers of 271 bytes for up to 255 bytes of payload; more channels than that overflow
/// them.
#[test]
fn the_longest_exchange_fits_a_datagram() {
    const {
        assert!(wire::exchange::COMMAND_MAX + wire::exchange::REQUEST_OVERHEAD <= wire::MAX_WORDS);
        assert!(wire::exchange::STATUS_MAX + 4 <= wire::MAX_WORDS);
    }
    // The rest is `all_channels_of_the_largest_board_are_there`: the largest board, talked to.
}

/// Remora: `*data->stepperEnable == 0` compares joint 0's pin pointer with NULL: a disabled joint
/// moves.
#[test]
fn a_disabled_joint_stands() {
    let mut rig = Rig::armed();
    rig.hal.set("ferrocnc.0.stepgen.y.enable", true);
    for axis in ["x", "y"] {
        for (pin, value) in [("velocity-cmd", 1000.0), ("maxaccel", 0.0)] {
            rig.hal
                .set(&format!("ferrocnc.0.stepgen.{axis}.{pin}"), value);
        }
        rig.hal
            .set(&format!("ferrocnc.0.stepgen.{axis}.control-type"), true);
    }
    rig.run(50);
    let board = rig.board.look();
    assert_eq!(board.command.stepgen_enable, 0b10);
    assert_eq!(board.pulses(0), 0);
    assert!(board.pulses(1) > 0);
}

/// hostmot2: `accumulator` wraps and the driver corrects by 2^32 - 1: a subcount per wrap.
#[test]
fn a_position_is_exact_where_the_counter_wraps() {
    let mut hal = FakeHal::new();
    let mut encoder = Encoder::export(&mut Exporter::new(&mut hal, "e")).unwrap();
    let (mut count, mut now) = (0u32, 1u64 << 40);
    let period = Period::new(1_000_000, CLOCK_HZ);
    // Eight turns of the counter, up and then down, in steps of a quarter.
    for n in 0..=64u32 {
        let status = EncoderStatus {
            count: Count(count),
            edge_time: now as u32 & 0x00ff_ffff,
            errors: 0,
        };
        encoder.sampled(&status, false, &LatchSample::default(), Clocks(now), period);
        let turns = if n <= 32 { n } else { 64 - n };
        let expected = f64::from(turns) * f64::from(1 << 30);
        assert_eq!(hal.get::<f64>("e.position"), expected, "after {n}");
        count = if n < 32 {
            count.wrapping_add(1 << 30)
        } else {
            count.wrapping_sub(1 << 30)
        };
        now += 60_000;
    }
}
