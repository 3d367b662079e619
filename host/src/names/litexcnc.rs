//! `NAME.*` as LiteX-CNC 1.3's modules export it.

use super::{NameError, Names, RowError};
use crate::client::Identity;
use crate::driver::Driver;
use crate::hal::Direction::{In, Io, Out, ReadOnly, ReadWrite};
use crate::hal::ExportError;
use crate::hal::Type::{Bit, Float, U32};
use crate::hal::checked::Rule;
use wire::board::{HAL_NAME_LEN, Kind, is_foreign_name};

/// A kind of channel: the letter of its pins in the board's description, its class here, and the
/// longest pin of one.
struct Class {
    kind: Kind,
    letter: u8,
    name: &'static str,
    longest: &'static str,
}

const fn class(kind: Kind, letter: u8, name: &'static str, longest: &'static str) -> Class {
    Class {
        kind,
        letter,
        name,
        longest,
    }
}

const STEPGEN: Class = class(Kind::Stepgen, b's', "stepgen", "position-prediction");
const ENCODER: Class = class(Kind::Encoder, b'e', "encoder", "overflow-occurred");
const PWM: Class = class(Kind::Pwm, b'p', "pwm", "curr-pwm-freq");
const INPUT: Class = class(Kind::Input, b'i', "gpio", "in-not");
const OUTPUT: Class = class(Kind::Output, b'o', "gpio", "invert-output");

/// Exports all of them. `named`: channels that have a name in LiteX-CNC's JSON are called by it.
pub(super) fn export(
    names: &mut Names<'_>,
    identity: &Identity,
    driver: &Driver,
    named: bool,
) -> Result<(), ExportError> {
    let called = |class: &Class, number: u8, n| {
        let name = named.then(|| name(identity, class, n)).flatten();
        // As with the row below: `Scheme::check` has refused others.
        let name = name.filter(|name| is_foreign_name(name));
        name.map_or_else(|| format!("{number:02}"), str::to_owned)
    };
    let channels = driver.channels();
    let clock = f64::from(identity.describe.clock_hz);
    names.lone(("debug", Bit, ReadWrite), 0.0)?;
    names.alias("communications.total-read-errors", "packet-error-total")?;
    names.show(
        ("communications.read-errors", U32, Out),
        "packet-error-level",
        |level| level,
    )?;
    // One datagram writes and reads.
    names.lone(("communications.total-write-errors", U32, Out), 0.0)?;
    names.lone(("communications.write-errors", U32, Out), 0.0)?;

    names.alias("watchdog.fpga-timeout", "watchdog.has-bitten")?;
    names.alias("watchdog.comm-timeout", "packet-error-exceeded")?;
    names.alias("watchdog.reset", "enable-request")?;
    let ok = names.lone(("watchdog.ok-in", Bit, In), 1.0)?;
    let fault = names.lone(("watchdog.fault-in", Bit, In), 0.0)?;
    names.set("enable", move || {
        f64::from(ok.get() != 0.0 && fault.get() == 0.0)
    })?;
    names.alias("watchdog.ok-out", "enabled")?;
    names.show(("watchdog.fault-out", Bit, Out), "enabled", |enabled| {
        1.0 - enabled
    })?;
    names.alias("watchdog.timeout-ns", "watchdog.timeout-ns")?;
    let nanos = names.checked("watchdog.timeout-ns")?;
    names.publish(("watchdog.timeout-cycles", U32, ReadOnly), move || {
        nanos.get() * clock / 1e9
    })?;
    let inputs = identity.numbers(Kind::Input).into_iter();
    let estops = inputs.filter(|n| identity.estop_bit(*n).is_some());
    for (estop, input) in estops.enumerate() {
        let ours = format!("gpio.{input}.estop");
        names.alias(&format!("watchdog.estop.{estop:02}.fault-out"), &ours)?;
        names.show(
            (&format!("watchdog.estop.{estop:02}.ok-out"), Bit, Out),
            &ours,
            |fault| 1.0 - fault,
        )?;
    }
    names.alias("wallclock.ticks-msb", "wallclock.ticks-msb")?;
    names.show(
        ("wallclock.ticks-lsb", U32, Io),
        "wallclock.ticks-lsb",
        |ticks| ticks,
    )?;

    // No pins rather than wrong ones: `Scheme::check` has refused such a board.
    for place in row(identity).unwrap_or_default() {
        let pins: &[_] = match place.input {
            true => &[("in", "in"), ("in-not", "in-not")],
            false => &[("out", "out"), ("invert-output", "invert")],
        };
        let class = if place.input { &INPUT } else { &OUTPUT };
        let called = called(class, place.number, place.ours);
        for (their, our) in pins {
            let theirs = format!("gpio.{called}.{their}");
            names.alias(&theirs, &format!("gpio.{}.{our}", place.ours))?;
        }
    }
    for n in 0..channels.stepgens {
        stepgen(names, n, &called(&STEPGEN, n, n))?;
    }
    for n in 0..channels.encoders {
        encoder(names, n, &called(&ENCODER, n, n))?;
    }
    for n in 0..channels.pwms {
        let has_direction = identity.has_pin(b'p', usize::from(n), "dir");
        pwm(names, n, &called(&PWM, n, n), has_direction, clock)?;
    }
    Ok(())
}

fn stepgen(names: &mut Names<'_>, n: u8, called: &str) -> Result<(), ExportError> {
    let theirs = |pin: &str| format!("stepgen.{called}.{pin}");
    let ours = |pin: &str| format!("stepgen.{n}.{pin}");
    for (their, our) in [
        ("max-velocity", "maxvel"),
        ("position-scale", "position-scale"),
        ("steplen", "steplen"),
        ("stepspace", "stepspace"),
        ("dir-setup-time", "dirsetup"),
        ("dir-hold-time", "dirhold"),
        ("position-prediction", "position-fb"),
        ("velocity-prediction", "velocity-fb"),
        ("enable", "enable"),
        ("velocity-mode", "control-type"),
        ("position-cmd", "position-cmd"),
        ("velocity-cmd", "velocity-cmd"),
        // Theirs is an input, so homing to the index never ends. As io it takes the same signals
        // from LinuxCNC.
        ("index-enable", "index-enable"),
    ] {
        names.alias(&theirs(their), &ours(our))?;
    }
    let most = names.ours(&ours("maxaccel"))?.handle.get();
    let most = names.told(
        (&theirs("max-acceleration"), Float, ReadWrite),
        most,
        Rule::Limit,
    )?;
    let wish = names.told((&theirs("acceleration-cmd"), Float, In), 0.0, Rule::Limit)?;
    names.set(&ours("maxaccel"), move || match (wish.get(), most.get()) {
        (0.0, most) => most,
        (wish, 0.0) => wish,
        (wish, most) => wish.min(most),
    })?;
    names.lone((&theirs("debug"), Bit, In), 0.0)?;
    names.show(
        (&theirs("velocity-feedback"), Float, Out),
        &ours("velocity-fb"),
        |v| v,
    )?;
    let scale = names.checked(&ours("position-scale"))?;
    let counts = names.ours(&ours("counts"))?.handle;
    let velocity = names.ours(&ours("velocity-fb"))?.handle;
    let steplen = names.checked(&ours("steplen"))?;
    let stepspace = names.checked(&ours("stepspace"))?;
    let steps = scale.clone();
    // Theirs is unsigned.
    names.publish((&theirs("counts"), U32, Out), move || {
        f64::from(counts.get() as i32 as u32)
    })?;
    names.publish((&theirs("position-feedback"), Float, Out), move || {
        counts.get() / scale.get()
    })?;
    names.publish((&theirs("frequency"), Float, ReadOnly), move || {
        velocity.get() * steps.get()
    })?;
    names.publish((&theirs("max-frequency"), Float, ReadOnly), move || {
        1e9 / (steplen.get() + stepspace.get()).max(1.0)
    })?;
    // As it wrote them before 1.2, and still does in its manual. A pin has one alias, so two are
    // copies.
    names.second(&theirs("position-feedback"), &theirs("position_fb"))?;
    names.second(&theirs("velocity-feedback"), &theirs("speed_fb"))?;
    for (their, our) in [
        ("position_prediction", "position-fb"),
        ("speed_prediction", "velocity-fb"),
    ] {
        names.show((&theirs(their), Float, Out), &ours(our), |value| value)?;
    }
    names.index_pulse(&theirs("index-pulse"), &ours("index-enable"))
}

fn encoder(names: &mut Names<'_>, n: u8, called: &str) -> Result<(), ExportError> {
    let theirs = |pin: &str| format!("encoder.{called}.{pin}");
    let ours = |pin: &str| format!("encoder.{n}.{pin}");
    for (their, our) in [
        ("raw-counts", "rawcounts"),
        ("counts", "count"),
        ("velocity", "velocity"),
        ("velocity-rpm", "velocity-rpm"),
        ("position-scale", "scale"),
        // An input there: see the stepgens.
        ("index-enable", "index-enable"),
    ] {
        names.alias(&theirs(their), &ours(our))?;
    }
    names.index_pulse(&theirs("index-pulse"), &ours("index-enable"))?;
    // Ours goes on counting beyond 2^31.
    names.lone((&theirs("overflow-occurred"), Bit, Out), 0.0)?;
    let offset = names.told(
        (&theirs("position-offset"), Float, ReadWrite),
        0.0,
        Rule::Number,
    )?;
    let position = names.ours(&ours("position"))?.handle;
    names.publish((&theirs("position"), Float, Out), move || {
        position.get() + offset.get()
    })?;
    let quadruple = names.lone((&theirs("x4-mode"), Bit, ReadWrite), 0.0)?;
    names.set(&ours("mode"), move || {
        use wire::map::CountMode;
        let mode = if quadruple.get() == 0.0 {
            CountMode::X1
        } else {
            CountMode::X4
        };
        f64::from(mode as u32)
    })?;
    // Theirs clears itself after the reset.
    let reset = names.lone((&theirs("reset"), Bit, Io), 0.0)?;
    let obey = names.ours(&ours("reset"))?.handle;
    names.glue.inputs.push(Box::new(move || {
        if reset.get() != 0.0 {
            obey.set(1.0);
        }
    }));
    names.glue.outputs.push(Box::new(move || {
        if reset.get() != 0.0 && obey.get() != 0.0 {
            obey.set(0.0);
            reset.set(0.0);
        }
    }));
    Ok(())
}

fn pwm(
    names: &mut Names<'_>,
    n: u8,
    called: &str,
    has_direction: bool,
    clock: f64,
) -> Result<(), ExportError> {
    let theirs = |pin: &str| format!("pwm.{called}.{pin}");
    let ours = |pin: &str| format!("pwm.{n}.{pin}");
    for pin in [
        "enable",
        "value",
        "curr-dc",
        "curr-pwm-freq",
        "curr-period",
        "curr-width",
        "direction",
        "invert-output",
    ] {
        names.alias(&theirs(pin), &ours(pin))?;
    }
    for (pin, default, rule) in [
        ("scale", 1.0, Rule::Divisor),
        ("offset", 0.0, Rule::Number),
        ("min-dc", 0.0, Rule::NotNegative),
        ("max-dc", 1.0, Rule::NotNegative),
    ] {
        names.follow(
            (&theirs(pin), Float, In),
            (default, rule),
            &[&ours(pin)],
            |value| value,
        )?;
    }
    let dither = names.lone((&theirs("dither-pwm"), Bit, In), 0.0)?;
    names.set(&ours("dither"), move || dither.get())?;
    // 0 Hz is pulse density, a bit every clock.
    let frequency = names.told(
        (&theirs("pwm-freq"), Float, In),
        100_000.0,
        Rule::NotNegative,
    )?;
    let wanted = frequency.clone();
    names.set(&ours("pwm-freq"), move || match wanted.get() {
        0.0 => clock,
        hz => hz.max(1.0),
    })?;
    let otherwise = names.ours(&ours("output-type"))?.handle.get();
    names.set(&ours("output-type"), move || match frequency.get() {
        0.0 => 3.0,
        _ => otherwise,
    })?;
    names.lone((&theirs("type"), U32, ReadOnly), f64::from(has_direction))?;
    Ok(())
}

/// What LiteX-CNC's JSON calls a channel, as the board's description says it; nothing behind `as=`
/// is its name here.
fn name<'i>(identity: &'i Identity, class: &Class, n: u8) -> Option<&'i str> {
    match identity.pin(class.letter, usize::from(n), "as")? {
        "" => identity.blob().text(class.kind, n),
        said => Some(said),
    }
}

/// Refuses names of channels that HAL cannot have behind this prefix.
pub(super) fn judge_names(identity: &Identity, prefix: &str) -> Result<(), NameError> {
    for class in [&STEPGEN, &ENCODER, &PWM, &INPUT, &OUTPUT] {
        let mut known = Vec::new();
        let numbers = identity.numbers(class.kind).into_iter();
        for name in numbers.filter_map(|n| name(identity, class, n)) {
            if !is_foreign_name(name) {
                return Err(NameError::NoWord(name.to_owned()));
            }
            if known.contains(&name) {
                return Err(NameError::Twice(name.to_owned()));
            }
            known.push(name);
            let pin = format!("{prefix}.{}.{name}.{}", class.name, class.longest);
            if pin.len() > HAL_NAME_LEN {
                return Err(NameError::Long(pin));
            }
        }
    }
    Ok(())
}

/// Refuses a board whose inputs and outputs have no numbers in LiteX-CNC's row.
pub(super) fn judge(identity: &Identity) -> Result<(), RowError> {
    row(identity).map(drop)
}

/// An input or output in LiteX-CNC's one row of both.
struct Place {
    number: u8,
    input: bool,
    /// Ours among its kind.
    ours: u8,
}

/// The row as the board's description says it. Without a word in it our own numbers do where they
/// cannot differ: with inputs or outputs alone, and without what an import puts in front of them,
/// e-stops and the watchdog's pins.
fn row(identity: &Identity) -> Result<Vec<Place>, RowError> {
    let (inputs, outputs) = (
        identity.numbers(Kind::Input),
        identity.numbers(Kind::Output),
    );
    let all = || {
        let inputs = inputs.iter().map(|n| (true, *n));
        inputs.chain(outputs.iter().map(|n| (false, *n)))
    };
    let letter = |input: bool| if input { b'i' } else { b'o' };
    let mut row: Vec<Place> = Vec::new();
    for (input, ours) in all() {
        let Some(text) = identity.pin(letter(input), usize::from(ours), "gpio") else {
            continue;
        };
        let number = text.parse().ok().filter(|number| *number < 128);
        let number = number.ok_or_else(|| RowError::NoNumber(text.to_owned()))?;
        if row.iter().any(|other| other.number == number) {
            return Err(RowError::Twice(number));
        }
        row.push(Place {
            number,
            input,
            ours,
        });
    }
    if !row.is_empty() {
        return Ok(row);
    }
    let blob = identity.blob();
    let moved = all().any(|(input, n)| {
        let name = || blob.text(Kind::Output, n);
        match input {
            true => identity.has_pin(b'i', usize::from(n), "estop"),
            false => matches!(name(), Some("watchdog" | "heartbeat")),
        }
    });
    if moved || !(inputs.is_empty() || outputs.is_empty()) {
        return Err(RowError::Unsaid);
    }
    let own = (0..).zip(all()).map(|(number, (input, ours))| Place {
        number,
        input,
        ours,
    });
    Ok(own.collect())
}
