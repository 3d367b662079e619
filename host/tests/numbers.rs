//! Every number that comes from HAL is checked: an invalid value is told once and not used.

#[path = "common/fake_board.rs"]
mod common;

use common::rig::{PERIOD_NS, Rig};
use ferrocnc::hal::checked::Rule;
use ferrocnc::hal::{Direction, Type};
use ferrocnc::names::Scheme;
use wire::map;
use wire::units::{Accel, Velocity};

/// The edges, and the names an operator reads them by.
const EDGES: [(f64, &str); 10] = [
    (0.0, "0"),
    (-0.0, "0"),
    (-1.0, "-1"),
    (f64::NAN, "NaN"),
    (f64::INFINITY, "inf"),
    (f64::NEG_INFINITY, "-inf"),
    (1e308, "1e308"),
    (-1e308, "-1e308"),
    (5e-324, "5e-324"),
    (-5e-324, "-5e-324"),
];

/// The values accepted, by the end of the name: any number; none below 0; none below 0 and not 0;
/// not 0.
const NUMBER: &str = "yyynnnnnyy";
const NOT_NEGATIVE: &str = "yynnnnnnnn";
const POSITIVE: &str = "nnnnnnnnnn";
const DIVISOR: &str = "nnynnnnnnn";
const FLOATS: &[(&str, &str)] = &[
    // Commands.
    ("position-cmd", NUMBER),
    ("velocity-cmd", NUMBER),
    ("vel-cmd", NUMBER),
    ("value", NUMBER),
    // Limits; 0 is none.
    ("maxvel", NOT_NEGATIVE),
    ("max-velocity", NOT_NEGATIVE),
    ("maxaccel", NOT_NEGATIVE),
    ("max-acceleration", NOT_NEGATIVE),
    ("acceleration-cmd", NOT_NEGATIVE),
    ("acc_lim", NOT_NEGATIVE),
    // Divisors.
    ("scale", DIVISOR),
    // Times.
    ("vel-timeout", NOT_NEGATIVE),
    ("watchdog-write", NOT_NEGATIVE),
    ("step_width", NOT_NEGATIVE),
    ("step_space", NOT_NEGATIVE),
    ("dir_width", NOT_NEGATIVE),
    ("setup_time", NOT_NEGATIVE),
    // PWM. Lcnc's frequency is off at 0 and below, LiteX-CNC's at 0 another type.
    ("Lcnc.00.pwm.freq", NUMBER),
    ("test.pwm.pwm-freq", NOT_NEGATIVE),
    ("pwm-freq", POSITIVE),
    ("min-dc", NOT_NEGATIVE),
    ("max-dc", NOT_NEGATIVE),
    ("offset", NUMBER),
    ("offs", NUMBER),
];

/// What is taken of a name's edges.
fn taken(name: &str) -> &'static str {
    // Without the channel, so that a row can name one driver's pin.
    let mut parts: Vec<&str> = name.split('.').collect();
    if parts.len() > 3 {
        parts.remove(parts.len() - 2);
    }
    let row = FLOATS
        .iter()
        .find(|(end, _)| parts.join(".").ends_with(end));
    row.unwrap_or_else(|| panic!("{name}: add a row with the values it accepts"))
        .1
}

fn schemes() -> [Rig; 3] {
    [
        Rig::new(),
        Rig::named(&Scheme::Lcnc),
        Rig::named(&Scheme::LitexCnc(vec!["test".to_owned()])),
    ]
}

/// Longer than what is told of one name is kept apart.
const LATER_NS: i64 = 1_500_000_000;

/// What is said of this name, now.
fn heard(rig: &mut Rig, name: &str) -> Vec<String> {
    rig.driver.write(LATER_NS);
    let mut said = rig.hal.said();
    said.retain(|line| line.contains(&format!(" {name} is ")));
    said
}

#[test]
fn every_float_from_hal_is_told_once_when_it_is_no_good_and_the_last_good_one_stays() {
    for mut rig in schemes() {
        let from_hal = |direction| {
            matches!(
                direction,
                Direction::In | Direction::Io | Direction::ReadWrite
            )
        };
        let floats: Vec<String> = rig
            .hal
            .list()
            .filter(|(_, ty, direction)| *ty == Type::Float && from_hal(*direction))
            .map(|(name, _, _)| name.to_owned())
            .collect();
        assert!(floats.len() > 70, "{floats:?}");
        for name in floats {
            for ((edge, text), good) in EDGES.into_iter().zip(taken(&name).chars()) {
                rig.hal.set(&name, 7.0);
                assert_eq!(heard(&mut rig, &name), [""; 0], "7 is a good number");
                rig.hal.set(&name, edge);
                let said = heard(&mut rig, &name);
                let in_force = rig.driver.catalogue().iter();
                let in_force = in_force
                    .filter(|exported| exported.name.to_str() == Ok(&name))
                    .find_map(|exported| exported.source.as_ref())
                    .map(|source| (source.get(), source.rule()));
                if good == 'y' {
                    assert_eq!(said, [""; 0], "{name} = {text}");
                    assert!(
                        in_force.is_none_or(|(now, _)| now == edge),
                        "{name} = {text}"
                    );
                    continue;
                }
                assert_eq!(said.len(), 1, "{name} = {text}: {said:?}");
                let whole = [format!("{name} is {text}"), "board 0".to_owned()];
                for part in whole {
                    assert!(said[0].contains(&part), "{said:?}");
                }
                match in_force {
                    Some((_, Rule::Command)) => assert!(said[0].contains("comes to rest")),
                    Some((now, _)) => {
                        assert_eq!(now, 7.0, "{name} = {text}");
                        assert!(said[0].contains("7 stays in force; set "), "{said:?}");
                    }
                    None => assert!(said[0].contains("; "), "{said:?}"),
                }
                assert!(said[0].len() < 250, "cut: {said:?}");
                assert_eq!(
                    heard(&mut rig, &name),
                    [""; 0],
                    "{name} = {text}: told twice"
                );
            }
            rig.hal.set(&name, 7.0);
        }
    }
}

#[test]
fn every_integer_from_hal_is_checked_and_those_that_mean_nothing_are_told() {
    for mut rig in schemes() {
        let all: Vec<(String, Type)> = rig
            .driver
            .catalogue()
            .iter()
            .filter(|exported| exported.direction == Direction::ReadWrite)
            .map(|exported| {
                (
                    exported.name.to_str().unwrap().to_owned(),
                    exported.handle.ty(),
                )
            })
            .collect();
        for (name, ty) in all {
            let last = name.rsplit('.').next().unwrap();
            let good = |value: f64| match last {
                "step-type" => (0.0..=2.0).contains(&value),
                "mode" => (0.0..=5.0).contains(&value),
                "output-type" => (1.0..=4.0).contains(&value),
                "probe-input" => (-1.0..=63.0).contains(&value),
                "packet-error-limit" | "packet-error-increment" | "packet-error-decrement" => {
                    value >= 0.0
                }
                _ => true,
            };
            match ty {
                Type::U32 => {
                    for value in [0, 1, 3, 5, 6, i32::MAX as u32, u32::MAX] {
                        rig.hal.set(&name, 1u32);
                        heard(&mut rig, &name);
                        rig.hal.set(&name, value);
                        let said = heard(&mut rig, &name).len();
                        assert_eq!(said == 0, good(f64::from(value)), "{name} = {value}");
                    }
                }
                Type::S32 => {
                    for value in [0, -1, -2, 31, 32, i32::MAX, i32::MIN] {
                        rig.hal.set(&name, 1);
                        heard(&mut rig, &name);
                        rig.hal.set(&name, value);
                        let said = heard(&mut rig, &name).len();
                        assert_eq!(said == 0, good(f64::from(value)), "{name} = {value}");
                    }
                }
                Type::Bit | Type::Float => {}
            }
        }
    }
}

#[test]
fn no_number_comes_from_hal_unchecked() {
    for rig in schemes() {
        for exported in rig.driver.catalogue().iter() {
            let ours = matches!(exported.direction, Direction::Out | Direction::ReadOnly);
            let number = exported.handle.ty() != Type::Bit;
            let checked = exported.source.is_some();
            assert_eq!(checked, number && !ours, "{:?}", exported.name);
        }
    }
}

/// What the board was told last of axis x, and the deceleration of its soft stop.
fn axis(rig: &Rig) -> ((Velocity, Accel), u32) {
    let board = rig.board.look();
    let stop = board.config.get(&(map::CONFIG_STEPGEN + 16)).copied();
    (board.command.stepgen[0], stop.unwrap_or_default())
}

#[test]
fn an_acceleration_that_is_none_lets_an_axis_neither_move_nor_stop_without_a_limit() {
    for bad in [
        -500.0,
        -0.5,
        f64::NAN,
        f64::INFINITY,
        f64::NEG_INFINITY,
        1e308,
        5e-324,
    ] {
        let mut rig = Rig::new();
        // At rest and disarmed, so that the board's own stop is set again, too.
        let ((_, _), stop) = axis(&rig);
        assert_eq!(stop, Accel::from_steps(1000.0 * 800.0, 60e6).0);
        rig.hal.set("ferrocnc.0.stepgen.x.maxaccel", bad);
        rig.run(30);
        let ((_, accel), stop) = axis(&rig);
        let limit = Accel::from_steps(1000.0 * 800.0, 60e6);
        assert_eq!((accel, stop), (limit, limit.0), "stopping with {bad}");
        rig.arm();
        assert!(rig.enabled());
        rig.hal.set("ferrocnc.0.stepgen.x.control-type", true);
        rig.hal.set("ferrocnc.0.stepgen.x.velocity-cmd", 10.0);
        rig.hal.set("ferrocnc.0.stepgen.x.enable", true);
        rig.run(30);
        let ((velocity, accel), _) = axis(&rig);
        assert!(velocity.0 > 0);
        assert_eq!(accel, limit, "moving with {bad}");
        rig.hal.set("ferrocnc.0.stepgen.x.enable", false);
        rig.run(2);
        assert_eq!(
            axis(&rig).0,
            (Velocity(0), limit),
            "coming to rest with {bad}"
        );
        let said = rig.hal.said();
        let told = said
            .iter()
            .filter(|line| line.contains("stepgen.x.maxaccel"));
        assert_eq!(told.count(), 1, "{said:?}");
    }
}

#[test]
fn a_command_that_is_no_number_brings_its_axis_to_rest_and_a_good_one_moves_it_again() {
    for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 1e308] {
        let mut rig = Rig::armed();
        rig.travel(2.0, 100);
        rig.hal.set("ferrocnc.0.stepgen.x.position-cmd", bad);
        rig.run(60);
        assert_eq!(axis(&rig).0.0, Velocity(0), "{bad}");
        let there = rig.position();
        assert!((there - 2.0).abs() < 0.1, "it went to {there} for {bad}");
        assert!(rig.enabled());
        rig.hal.set("ferrocnc.0.stepgen.x.position-cmd", there);
        rig.run(5);
        rig.travel(1.0, 100);
        rig.run(60);
        assert!(
            (rig.position() - there - 1.0).abs() < 0.01,
            "{}",
            rig.position()
        );
        let said = rig.hal.said();
        assert_eq!(said.len(), 1, "{said:?}");
        assert!(said[0].contains("stepgen.x.position-cmd is"), "{said:?}");
    }
}

#[test]
fn a_signal_that_is_wrong_a_thousand_times_a_second_is_told_once_a_second() {
    let mut rig = Rig::new();
    rig.hal.said();
    for n in 0..2500 {
        let value = if n % 2 == 0 { f64::NAN } else { -f64::from(n) };
        rig.hal.set("ferrocnc.0.stepgen.x.maxvel", value);
        rig.driver.write(PERIOD_NS);
    }
    let said = rig.hal.said();
    let told = said.iter().filter(|line| line.contains("stepgen.x.maxvel"));
    assert_eq!(told.count(), 3, "{said:?}");
}

/// LiteX-CNC divides by it.
#[test]
fn a_scale_of_zero_leaves_position_feedback_of_the_litexcnc_names_a_number() {
    let mut rig = Rig::named(&Scheme::LitexCnc(vec!["test".to_owned()]));
    rig.hal.set("test.stepgen.00.position-scale", 100.0);
    rig.hal.set("test.stepgen.00.max-acceleration", 1000.0);
    rig.arm();
    rig.hal.set("test.stepgen.00.velocity-mode", true);
    rig.hal.set("test.stepgen.00.enable", true);
    rig.hal.set("test.stepgen.00.velocity-cmd", 20.0);
    rig.run(100);
    rig.hal.set("test.stepgen.00.velocity-cmd", 0.0);
    rig.run(60);
    let before: f64 = rig.hal.get("test.stepgen.00.position-feedback");
    assert!(before > 0.5, "it moved: {before}");
    for scale in [0.0, -0.0, f64::NAN, f64::INFINITY, 5e-324] {
        rig.hal.set("test.stepgen.00.position-scale", scale);
        rig.run(5);
        for pin in ["position-feedback", "position-prediction"] {
            let at: f64 = rig.hal.get(&format!("test.stepgen.00.{pin}"));
            assert!(
                (at - before).abs() < 0.02,
                "{pin} is {at} at a scale of {scale}"
            );
        }
        assert!(rig.hal.get::<f64>("test.stepgen.00.frequency").is_finite());
    }
}
