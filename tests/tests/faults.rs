//! The fault table of docs/safety.md, a test for each row: the real driver, the real firmware
//! library, the cores' bit-exact models, and between them a cable with injected faults. Every test
//! makes the fault happen and watches the pins.
//!
//! All of them take seconds, on any machine with Rust. The rows that must work without the CPU are
//! on the Verilated board in `faults_rtl.rs`; `linuxcnc.rs` and `twin.rs` have the tests with
//! LinuxCNC.

use ferrocnc_tests::bench::Bench;
use ferrocnc_tests::flash::{Boots, FIRST, SECOND, UID, boots, factory};
use ferrocnc_tests::mill::{AXES, Mill, Owner, SCALE, facts, words};
use host::client::ClientError;
use sim::model_board::Setup;
use sim::nor::{Cut, Order, Part, Times};
use sim::server::Device;
use sim::twin::Twin;
use wire::units::Accel;
use wire::{FaultReason, Refusal, map};

/// The default timeout of the driver's watchdog.
const TIMEOUT_MS: u64 = 5;
/// 40 units/s at 550 units/s^2, and what `path ratio` may add: nothing takes longer to stop.
const STOP_MS: u64 = 80;

fn said(mill: &Mill, what: &str) -> usize {
    mill.hal
        .said()
        .iter()
        .filter(|line| line.contains(what))
        .count()
}

// ---- the rows -----------------------------------------------------------------------------------

#[test]
fn powered_cpu_not_running() {
    let mut mill = Mill::board(Mill::setup());
    mill.twin.trouble(&"freeze".parse().unwrap()).unwrap();
    mill.run(100);
    assert!(mill.all_safe());
    // No datagram has an effect, because the CPU does not run.
    let mut owner = Owner::of(mill.twin);
    owner.command.enable = true;
    owner.command.enable_request = true;
    for _ in 0..100 {
        assert_eq!(owner.exchange(), None);
    }
    let pins = owner.twin.environment().pins();
    assert_eq!(
        (
            pins.gate,
            pins.gpio_out,
            owner.twin.environment().edges.pulses()
        ),
        (0, 0, 0)
    );
}

#[test]
fn abi_mismatch() {
    let setup = || Setup {
        abi: 0xdead_beef,
        ..Mill::setup()
    };
    let mut mill = Mill::board(setup());
    let error = mill.load().expect_err("loadrt must fail");
    assert!(matches!(error, ClientError::Abi { .. }), "{error}");
    let error = error.to_string();
    let ours = format!(
        "{:#010x}",
        abi_of(&mut Owner::of(Twin::power_up(Mill::setup())))
    );
    assert!(
        error.contains("0xdeadbeef") && error.contains(&ours),
        "{error}"
    );
    // A host that ignores the mismatch cannot arm the board.
    let mut owner = Owner::of(Twin::power_up(setup()));
    owner.write(map::SESSION_ACQUIRE, &[7]);
    owner.command.token = owner.read(map::SESSION_TOKEN);
    owner.command.enable = true;
    for request in [false, true, true, false, true, true] {
        owner.command.enable_request = request;
        if let Some(status) = owner.exchange() {
            assert!(!status.state.enabled);
        }
    }
    assert_eq!(owner.twin.environment().pins().gate, 0);
}

/// The register map this firmware was built for, as a whole board says it.
fn abi_of(owner: &mut Owner) -> u32 {
    owner.read(wire::describe::address(wire::describe::ABI_FIRMWARE_AT))
}

#[test]
fn wire_version_mismatch() {
    let mut mill = Mill::board(Mill::setup());
    // An answer that carries the describe block's first words says a version of its own.
    mill.meddle = Some(|payload| {
        let magic = wire::describe::MAGIC.to_be_bytes();
        if payload.len() >= 24 && payload[16..20] == magic {
            payload[20..24].copy_from_slice(&99u32.to_be_bytes());
        }
    });
    let error = mill.load().expect_err("loadrt must fail").to_string();
    let ours = wire::WIRE_VERSION.to_string();
    assert!(error.contains("99") && error.contains(&ours), "{error}");
    mill.run(10);
    assert!(mill.all_safe());
}

#[test]
fn one_frame_lost() {
    for direction in ["to-board", "from-board"] {
        let mut mill = Mill::cutting();
        let (errors, at_pins) = (mill.getp::<u32>("packet-error-total"), mill.pulses());
        mill.trouble(&format!("{direction}:drop=1"));
        mill.run(2);
        assert_eq!(
            mill.getp::<u32>("packet-error-total"),
            errors + 1,
            "{direction}"
        );
        assert_eq!(mill.getp::<i32>("packet-error-level"), 2, "{direction}");
        mill.run(1);
        // Three milliseconds of 40 steps each, the last velocity held.
        let steps = mill.pulses()[0] - at_pins[0];
        assert!((119..=121).contains(&steps), "{direction}: {steps} steps");
        mill.run(20);
        mill.nothing_is_wrong();
        assert!(
            mill.motion.ferror * SCALE <= 60.0,
            "{direction}: {} steps of following error",
            mill.motion.ferror * SCALE
        );
        mill.feed([0.0; 3]);
        mill.run(200);
        mill.all_agree([0; 3]);
    }
}

#[test]
fn frames_lost_past_the_timeout() {
    let mut mill = Mill::cutting();
    mill.twin.environment_mut().edges.keep_steps();
    mill.trouble("loss=1");
    let last_good = mill.twin.clock();
    mill.run(TIMEOUT_MS + STOP_MS);
    let closed = mill.closed_at().expect("the gate must close");
    let ms = (closed - last_good) as f64 / f64::from(facts().clock_hz / 1000);
    assert!(ms <= (TIMEOUT_MS + STOP_MS) as f64, "{ms} ms");
    mill.is_stopped_for_good();
    // It ran down, it was not cut off: steps go on after the timeout, ever further apart.
    let steps = mill.twin.environment_mut().edges.take_steps();
    let x: Vec<u64> = steps
        .iter()
        .filter(|s| s.channel == 0)
        .map(|s| s.clock)
        .collect();
    let n = x.len();
    assert!(x[n - 1] - x[n - 2] > 4 * (x[1] - x[0]), "it stopped dead");
    // What the operator sees: one message for the loss, then the board's reason.
    assert!(mill.getp::<bool>("io-error") && !mill.getp::<bool>("position-trusted"));
    assert_eq!(said(&mill, "answers missing"), 1, "{:?}", mill.hal.said());
    mill.trouble("off");
    mill.run(300);
    assert!(mill.getp::<bool>("watchdog.has-bitten"));
    assert_eq!(
        mill.getp::<u32>("fault-reason"),
        u32::from(FaultReason::Watchdog.code())
    );
    mill.is_stopped_for_good();
    // Counts are kept, and it may be switched on again.
    mill.all_agree([0; 3]);
    mill.switch_on();
    mill.nothing_is_wrong();
}

#[test]
fn duplicated_reordered_stale_frame() {
    let mut mill = Mill::on();
    mill.swing([4.0, -3.0, 1.0], 0.25);
    mill.trouble("seed=11 dup=0.3 to-board:reorder=0.05 from-board:delay=0us..400us");
    mill.run(1000);
    mill.nothing_is_wrong();
    mill.trouble("off");
    let dropped = mill.refusals(Refusal::Duplicate) + mill.refusals(Refusal::Stale);
    assert!(dropped > 200, "{dropped} of some 350 were counted");
    mill.feed([0.0; 3]);
    mill.run(200);
    mill.all_agree([0; 3]);

    // What was good once feeds the watchdog once.
    let mut owner = moving_owner();
    let request = owner.request();
    assert!(owner.ask(&request).is_some());
    let fed = owner.twin.clock();
    while owner.twin.environment().pins().gate != 0 {
        assert_eq!(owner.ask(&request), None);
        let gone = owner.twin.clock() - fed;
        // 50 000 steps/s at 500 000 steps/s^2 stop within 100 ms.
        assert!(
            gone < 60_000 * (TIMEOUT_MS + 101),
            "a repeated frame keeps the machine alive"
        );
    }
}

/// An owner with x at 50 000 steps/s.
fn moving_owner() -> Owner {
    let stop = Accel::from_steps(5e5, f64::from(facts().clock_hz));
    let twin = Twin::power_up(Mill::setup());
    let mut owner = Owner::armed(twin, 300_000, 30_000_000, [stop; 3]);
    owner.velocity(0, 50e3, Accel::from_steps(5e5, f64::from(facts().clock_hz)));
    for _ in 0..150 {
        owner.exchange().expect("an answer");
    }
    owner
}

#[test]
fn malformed_truncated_padded_oversized_datagram() {
    let mut mill = Mill::on();
    mill.swing([4.0, -3.0, 1.0], 0.25);
    mill.trouble("seed=5 truncate=0.02");
    mill.run(1000);
    mill.trouble("off");
    mill.nothing_is_wrong();
    let cut = mill.twin.faults().counts.truncated;
    assert!(cut > 20, "{cut} were cut");

    // The same from a hostile host: each is counted under its own name, and nothing changes at the
    // pins.
    let mut owner = moving_owner();
    let good = owner.request();
    owner.ask(&good).expect("the real one is answered");
    let mut padded = good.clone();
    padded.extend([0; 4]);
    let bad: [(Refusal, Vec<u8>); 6] = [
        (Refusal::Truncated, good[..good.len() - 4].to_vec()),
        (Refusal::Ragged, good[..good.len() - 1].to_vec()),
        (Refusal::Short, good[..4].to_vec()),
        (Refusal::Padded, padded),
        (Refusal::Magic, vec![0x55; 64]),
        (
            Refusal::BlockLength,
            words(&[0x4e6f_1044, 0, 0x000f_0300, map::COMMAND, 1, 2, 3]),
        ),
    ];
    for (reason, datagram) in bad {
        let at = map::COUNTERS_REFUSED + 4 * reason.index() as u32;
        let before = owner.read(at);
        let velocity = steps_in_a_millisecond(&mut owner);
        assert_eq!(owner.ask(&datagram), None, "{reason:?}");
        assert_eq!(owner.read(at), before + 1, "{reason:?}");
        let after = steps_in_a_millisecond(&mut owner);
        assert!(
            velocity.abs_diff(after) <= 1,
            "{reason:?}: {velocity} steps, then {after}"
        );
        owner.exchange().expect("and it goes on");
    }
    assert_ne!(owner.twin.environment().pins().gate, 0);
}

fn steps_in_a_millisecond(owner: &mut Owner) -> u64 {
    let before = owner.twin.environment().edges.pulses();
    owner.pass(60_000);
    owner.twin.environment().edges.pulses() - before
}

#[test]
fn foreign_host_writes() {
    let mut mill = Mill::cutting();
    let refused = mill.refusals(Refusal::NotOwner);
    let token = mill.look(map::SESSION_OWNER_PORT);
    for (address, value) in [
        (map::CONFIG_STEPGEN, 1),
        (map::CONFIG_BOARD, 0xffff_ffff),
        (map::SESSION_RELEASE, 1),
        (map::SESSION_ACQUIRE, 99),
        (map::SESSION_REBOOT, map::REBOOT_KEY),
    ] {
        let write = words(&[0x4e6f_1044, 0, 0x000f_0100, address, value]);
        assert_eq!(mill.stranger(50_505, &write), None);
        mill.period();
    }
    // A command that is right in everything but its sender.
    let mut thief = Owner::of(Twin::power_up(Mill::setup()));
    thief.command.token = mill.look(map::SESSION_TOKEN);
    thief.command.sequence = mill.look(map::SESSION_LAST_SEQ);
    let request = thief.request();
    assert_eq!(mill.stranger(50_505, &request), None);
    mill.run(50);
    mill.nothing_is_wrong();
    assert_eq!(mill.look(map::SESSION_OWNER_PORT), token);
    assert!(mill.refusals(Refusal::NotOwner) >= refused + 3);
    mill.feed([0.0; 3]);
    mill.run(200);
    mill.all_agree([0; 3]);
}

#[test]
fn cable_pulled_replugged() {
    let mut mill = Mill::cutting();
    mill.trouble("pull");
    mill.run(300);
    mill.is_stopped_for_good();
    assert_eq!(
        mill.getp::<u32>("fault-reason"),
        u32::from(FaultReason::LinkDown.code())
    );
    let believed = mill.feedback();
    let at = mill.pulses();

    mill.trouble("plug");
    mill.run(500);
    mill.is_stopped_for_good();
    assert_eq!(mill.pulses(), at, "plugging in moved something");
    // LinuxCNC's position may jump to the machine's position; the machine never moves to
    // LinuxCNC's.
    mill.all_agree([0; 3]);
    assert!(believed != [0.0; 3]);

    mill.switch_on();
    mill.run(50);
    mill.nothing_is_wrong();
    assert_eq!(mill.pulses(), at, "switching on moved something");
    mill.motion.ferror = 0.0;
    mill.feed([-40.0, 25.0, -10.0]);
    mill.run(300);
    mill.feed([0.0; 3]);
    mill.run(200);
    mill.nothing_is_wrong();
    mill.all_agree([0; 3]);
    assert!(mill.motion.ferror * SCALE < 60.0, "{}", mill.motion.ferror);
    assert_eq!(said(&mill, "answers missing"), 1, "{:?}", mill.hal.said());
}

#[test]
fn firmware_hangs_or_panics() {
    let mut mill = Mill::cutting();
    mill.trouble("freeze");
    mill.run(TIMEOUT_MS + STOP_MS);
    mill.is_stopped_for_good();
    let at = mill.pulses();
    // The reset button is pressed.
    mill.trouble("off reboot");
    mill.run(500);
    assert_eq!(mill.pulses(), at);
    mill.is_stopped_for_good();
    assert_eq!(said(&mill, "has restarted"), 1, "{:?}", mill.hal.said());
    // Counts began again in the board; LinuxCNC's position did not jump, and none of them moves.
    mill.switch_on();
    mill.run(50);
    mill.nothing_is_wrong();
    assert_eq!(mill.pulses(), at);
}

#[test]
fn external_reset_pin_high() {
    for frozen in [false, true] {
        let mut mill = Mill::cutting();
        if frozen {
            mill.trouble("freeze");
        }
        mill.closed_at();
        let pressed = mill.twin.clock();
        mill.twin.environment_mut().ext_reset(true);
        mill.run(2);
        let closed = mill.closed_at().expect("the gate must close");
        assert!(closed - pressed <= 4, "{} clocks", closed - pressed);
        assert!(mill.all_safe());
        if !frozen {
            assert!(!mill.enabled());
            assert_eq!(
                mill.getp::<u32>("fault-reason"),
                u32::from(FaultReason::ExternalReset.code())
            );
            assert_eq!(said(&mill, "external reset"), 1, "{:?}", mill.hal.said());
            mill.switch_on();
            assert!(!mill.enabled(), "it is still pressed");
            mill.twin.environment_mut().ext_reset(false);
            mill.run(50);
            mill.is_stopped_for_good();
            mill.switch_on();
            mill.nothing_is_wrong();
        }
    }
}

#[test]
fn host_thread_panics_or_overruns() {
    let mut mill = Mill::cutting();
    mill.guard(|_| panic!("on purpose: this is the test of what happens then"));
    assert!(!mill.enabled() && mill.getp::<bool>("io-error"));
    mill.run(TIMEOUT_MS + STOP_MS);
    mill.is_stopped_for_good();
    assert_eq!(said(&mill, "internal error"), 1, "{:?}", mill.hal.said());

    // One period late is nothing; twenty are a watchdog.
    let mut mill = Mill::cutting();
    mill.board_period();
    mill.run(20);
    mill.nothing_is_wrong();
    for _ in 0..TIMEOUT_MS + STOP_MS {
        mill.board_period();
    }
    assert!(mill.all_safe());
    mill.run(20);
    mill.is_stopped_for_good();
    mill.feed([0.0; 3]);
    mill.all_agree([0; 3]);
}

#[test]
fn linuxcnc_exits_or_is_killed() {
    for killed in [false, true] {
        let mut mill = Mill::cutting();
        if killed {
            mill.kill();
        } else {
            mill.unload();
        }
        mill.run(TIMEOUT_MS + STOP_MS);
        assert!(mill.all_safe(), "killed {killed}");
        let at = mill.pulses();
        // The next LinuxCNC: nothing moves by itself, positions are where they were.
        mill.load()
            .unwrap_or_else(|error| panic!("killed {killed}: {error}"));
        mill.run(300);
        mill.is_stopped_for_good();
        assert_eq!(mill.pulses(), at);
        mill.all_agree([0; 3]);
        mill.switch_on();
        mill.run(50);
        mill.nothing_is_wrong();
        assert_eq!(mill.pulses(), at);
    }
}

#[test]
fn counter_passes_2_32_or_2_63() {
    // Counts at the end of 31 bits, of 32 bits, and of nothing; wall clocks at the end of 32 and of
    // 63 bits. A position is 32 bits of steps and 32 of fraction, so the first of them is 2^63 of
    // its own units.
    for (count, wall) in [
        (i32::MAX - 3000, (1 << 32) - 40_000_000),
        (-3000, (1 << 63) - 40_000_000),
        (i32::MIN + 3000, (1 << 63) + (1 << 32) - 40_000_000),
    ] {
        let mut mill = Mill::board(Setup {
            wall_clock: wall,
            ..Mill::setup()
        });
        for n in 0..6 {
            mill.twin.preset(n, count, count);
        }
        mill.load().unwrap_or_else(|error| panic!("{error}"));
        mill.switch_on();
        let story = format!("count {count}, wall clock {wall:#x}");
        assert!(mill.enabled(), "{story}: {:?}", mill.hal.said());
        let (there, at_pins) = (mill.feedback(), mill.pulses());
        let encoder: f64 = mill.getp("encoder.x.position");
        let mut last = there;
        // There and back, past the end twice. All in one direction and then the other, so that
        // every axis passes it.
        for feed in [[40.0, 40.0, 40.0], [-40.0, -40.0, -40.0]] {
            mill.feed(feed);
            for _ in 0..400 {
                mill.period();
                let now = mill.feedback();
                for (was, is) in last.iter().zip(now) {
                    assert!(
                        (is - was).abs() < 0.06,
                        "{story}: a jump from {was} to {is}"
                    );
                }
                last = now;
            }
            mill.nothing_is_wrong();
            assert!(mill.getp::<bool>("position-trusted"), "{story}");
        }
        mill.feed([0.0; 3]);
        mill.run(300);
        mill.nothing_is_wrong();
        for n in 0..3 {
            let moved = (mill.feedback()[n] - there[n]) * SCALE;
            let pulses = (mill.pulses()[n] - at_pins[n]) as f64;
            assert!(
                (moved - pulses).abs() <= 1.0,
                "{story}, axis {n}: {moved} steps, at the pins {pulses}"
            );
        }
        let turned: f64 = mill.getp::<f64>("encoder.x.position") - encoder;
        assert_eq!(turned, (mill.pulses()[0] - at_pins[0]) as f64, "{story}");
        assert!(
            mill.motion.ferror * SCALE < 60.0,
            "{story}: {}",
            mill.motion.ferror
        );
    }
}

#[test]
fn rate_asks_more_than_the_timing_allows() {
    // The host holds it back: 100 kHz with these pulses, a million asked for.
    let mut mill = Mill::board(Mill::setup());
    mill.load().unwrap_or_else(|error| panic!("{error}"));
    for name in ["steplen", "stepspace"] {
        mill.setp(&format!("stepgen.x.{name}"), 5000u32);
    }
    mill.setp("stepgen.x.control-type", true);
    mill.setp("stepgen.x.maxaccel", 1e6);
    mill.switch_on();
    mill.setp("stepgen.x.velocity-cmd", 1000.0);
    mill.run(100);
    let before = mill.pulses()[0];
    mill.run(100);
    let steps = mill.pulses()[0] - before;
    assert!((9_900..=10_000).contains(&steps), "{steps} in 100 ms");
    assert!(mill.getp::<bool>("stepgen.x.rate-limited"));
    mill.setp("stepgen.x.velocity-cmd", -1000.0);
    mill.run(100);
    mill.nothing_is_wrong();
    mill.setp("stepgen.x.velocity-cmd", 0.0);
    mill.run(100);
    mill.all_agree([0; 3]);

    // The gateware holds it back: a host that asks for all there is.
    let mut owner = moving_owner();
    owner.velocity(0, 29e6, Accel::UNLIMITED);
    for _ in 0..100 {
        owner.exchange().expect("an answer");
    }
    owner.velocity(0, 0.0, Accel::UNLIMITED);
    let status = (0..50)
        .map(|_| owner.exchange())
        .last()
        .flatten()
        .expect("an answer");
    let edges = &owner.twin.environment().edges;
    assert_eq!(edges.violations(), []);
    // 60 clocks on, 60 off: half a million steps a second.
    let steps = edges.channel(0).count;
    assert!(steps > 49_000, "{steps}");
    assert_eq!(
        status.stepgen[0].0.pulses(),
        steps,
        "none was lost, none merged"
    );
}

#[test]
fn power_fails_during_a_flash_update() {
    let part = Part::ALL[0].with(Times::QUICK);
    let nor = factory(part, UID);
    let mut whole = Bench::new(nor.copy());
    let begun = whole.nor().steps();
    assert_eq!(whole.update(SECOND, 14), None);
    let steps = whole.nor().steps() - begun;
    // Twenty moments; provision tries every one there is.
    for n in 0..20 {
        let mut bench = Bench::new(nor.copy());
        let step = bench.nor().steps() + steps * n / 20;
        bench.cut_at(Cut {
            step,
            seed: n,
            order: Order::InOrder,
        });
        bench.update(SECOND, 14);
        let now = boots(&bench.nor());
        let old_or_new = matches!(now, Boots::Slot(_, build) if build == FIRST || build == SECOND);
        assert!(old_or_new, "cut {n} of 20: {now:?}");
        let mut bench = bench.power_cycle();
        assert_eq!(bench.environment().pins().gate, 0);
        assert_eq!(
            bench.update(SECOND, 14),
            None,
            "and the next try goes through"
        );
    }
}

// ---- known accidents of other boards ------------------------------------------------------------

#[test]
fn axes_do_not_jump_on_reconnect_wherever_the_cable_was_pulled() {
    let mut mill = Mill::on();
    mill.swing([4.0, -3.0, 1.0], 0.25);
    for n in 0..12 {
        // Another moment of the swing each time, and another time without a cable: none that the
        // watchdog notices, and long ones.
        mill.run(100 + 7 * n);
        mill.trouble("pull");
        mill.run(n * n / 2);
        mill.trouble("plug");
        mill.run(150);
        mill.twin.environment_mut().edges.keep_steps();
        if !mill.enabled() {
            let at = mill.pulses();
            mill.switch_on();
            mill.run(20);
            assert_eq!(mill.pulses(), at, "cable {n}: a jump");
            mill.swing([4.0, -3.0, 1.0], 0.25);
        }
        mill.nothing_is_wrong();
    }
    mill.feed([0.0; 3]);
    mill.run(200);
    mill.all_agree([0; 3]);
}

#[test]
fn no_network_however_bad_makes_an_axis_run_away() {
    for seed in 1..=6 {
        let mut mill = Mill::on();
        mill.swing([2.0, -2.0, 1.0], 0.25);
        mill.trouble(&format!(
            "seed={seed} loss=5% dup=5% reorder=5% corrupt=2% truncate=2% delay=0us..2ms host-pause@300ms..304ms"
        ));
        for _ in 0..1000 {
            mill.period();
            for (n, pulses) in mill.pulses().iter().enumerate() {
                // Amplitudes are 2000 and 1000 steps, out and back; the rest is what a soft stop
                // needs.
                assert!(pulses.abs() < 6500, "seed {seed}: axis {n} is at {pulses}");
            }
        }
        assert_eq!(
            mill.twin.environment().edges.violations(),
            [],
            "seed {seed}"
        );
        mill.trouble("off");
        mill.run(300);
        if !mill.enabled() {
            mill.is_stopped_for_good();
        }
        mill.all_settled();
    }
}

#[test]
fn a_bite_is_told_once_and_stays_until_the_operator_acts() {
    let mut mill = Mill::cutting();
    mill.hal.said();
    mill.trouble("to-board:loss=1@0ms..100ms");
    mill.run(500);
    mill.is_stopped_for_good();
    assert!(mill.getp::<bool>("watchdog.has-bitten"));
    let told = mill.hal.said();
    // One alarm for one event, and the board's own reason once it answers again.
    let alarms = told.iter().filter(|line| line.starts_with("error")).count();
    let reasons = told
        .iter()
        .filter(|line| line.contains("no accepted command"));
    assert_eq!((alarms, reasons.count()), (1, 1), "{told:?}");
    mill.run(2000);
    assert_eq!(mill.hal.said(), [""; 0], "it repeats itself");
    // A level is no edge.
    assert!(mill.getp::<bool>("enable-request"));
    mill.is_stopped_for_good();
}

#[test]
fn after_a_disconnection_every_axis_moves_both_ways_and_encoders_count() {
    let mut mill = Mill::cutting();
    // In the middle of a datagram as well as between two: its end is missing.
    mill.trouble("seed=2 truncate=1@0ms..40ms pull@40ms..400ms");
    mill.run(800);
    mill.switch_on();
    mill.nothing_is_wrong();
    let edges = |mill: &Mill, n: usize| mill.twin.environment().edges.channel(n).count;
    for (n, axis) in AXES.iter().enumerate() {
        for feed in [30.0, -30.0] {
            let (at, fb): (i64, f64) = (
                edges(&mill, n),
                mill.getp(&format!("encoder.{axis}.position")),
            );
            let mut feeds = [0.0; 3];
            feeds[n] = feed;
            mill.feed(feeds);
            mill.run(200);
            mill.feed([0.0; 3]);
            mill.run(200);
            let went = (edges(&mill, n) - at) as f64;
            assert!(
                went * feed > 0.0 && went.abs() > 4000.0,
                "{axis} at {feed}: {went} steps"
            );
            let counted = mill.getp::<f64>(&format!("encoder.{axis}.position")) - fb;
            assert_eq!(counted, went, "{axis}: what the encoder counts");
        }
    }
    mill.nothing_is_wrong();
    mill.all_agree([0; 3]);
}
