//! `Lcnc.NN.*` as `driver/Lcnc.c` exports it.

use super::Names;
use crate::client::Identity;
use crate::driver::Driver;
use crate::hal::Direction::{In, Out, ReadWrite};
use crate::hal::ExportError;
use crate::hal::Type::{Bit, Float, U32};
use crate::hal::checked::Rule;
use wire::board::Kind;
use wire::describe::Channels;

/// Exports all of them.
pub(super) fn export(
    names: &mut Names<'_>,
    identity: &Identity,
    driver: &Driver,
) -> Result<(), ExportError> {
    let channels = driver.channels();
    board(names)?;
    gpio(names, identity)?;
    for n in 0..channels.encoders {
        encoder(names, n)?;
    }
    for n in 0..channels.stepgens {
        stepgen(names, n)?;
    }
    timing(names, channels)?;
    for n in 0..channels.pwms {
        pwm(names, n)?;
    }
    Ok(())
}

fn board(names: &mut Names<'_>) -> Result<(), ExportError> {
    names.alias("enable", "enable")?;
    names.alias("enable-request", "enable-request")?;
    names.alias("enabled", "enabled")?;
    // A missing answer raises our level by 2.
    names.follow(
        ("tx-max-retries", U32, ReadWrite),
        (10.0, Rule::Any),
        &["packet-error-limit"],
        |n| 2.0 * n,
    )?;
    names.show(("watchdog-read", Float, Out), "watchdog.margin-ns", |ns| {
        ns * 1e-9
    })?;
    names.follow(
        ("watchdog-write", Float, ReadWrite),
        (0.01, Rule::NotNegative),
        &["watchdog.timeout-ns"],
        |s| s * 1e9,
    )?;
    names.alias("wallclock.value", "wallclock.ticks-lsb")?;
    names.alias("wallclock.interval", "wallclock.interval")?;
    Ok(())
}

/// Theirs are numbered in the order of the board file, whatever pins they are on.
fn gpio(names: &mut Names<'_>, identity: &Identity) -> Result<(), ExportError> {
    for (theirs, n) in identity.numbers(Kind::Input).into_iter().enumerate() {
        names.alias(&format!("input.{theirs:02}.in"), &format!("gpio.{n}.in"))?;
        names.alias(
            &format!("input.{theirs:02}.in-n"),
            &format!("gpio.{n}.in-not"),
        )?;
    }
    for (theirs, n) in identity.numbers(Kind::Output).into_iter().enumerate() {
        names.alias(&format!("output.{theirs:02}.out"), &format!("gpio.{n}.out"))?;
        names.alias(
            &format!("output.{theirs:02}.inv"),
            &format!("gpio.{n}.invert"),
        )?;
    }
    Ok(())
}

fn encoder(names: &mut Names<'_>, n: u8) -> Result<(), ExportError> {
    let theirs = |pin: &str| format!("encoder.{n:02}.{pin}");
    let ours = |pin: &str| format!("encoder.{n}.{pin}");
    names.alias(&theirs("pos-fb"), &ours("position"))?;
    names.alias(&theirs("vel-fb"), &ours("velocity"))?;
    names.alias(&theirs("reset"), &ours("reset"))?;
    // Theirs counts when it is told to.
    names.alias(&theirs("enable"), &ours("enable"))?;
    names.ours(&ours("enable"))?.handle.set(0.0);
    // Units per count there, counts per unit here.
    let scale = names.told((&theirs("scale"), Float, ReadWrite), 1.0, Rule::Divisor)?;
    let invert = names.lone((&theirs("inv"), Bit, ReadWrite), 0.0)?;
    let reciprocal = move || {
        1.0 / if invert.get() == 0.0 {
            scale.get()
        } else {
            -scale.get()
        }
    };
    names.set(&ours("scale"), reciprocal)?;
    Ok(())
}

fn stepgen(names: &mut Names<'_>, n: u8) -> Result<(), ExportError> {
    let theirs = |pin: &str| format!("stepgen.{n:02}.{pin}");
    let ours = |pin: &str| format!("stepgen.{n}.{pin}");
    names.alias(&theirs("vel-cmd"), &ours("velocity-cmd"))?;
    names.alias(&theirs("vel-fb"), &ours("velocity-fb"))?;
    names.alias(&theirs("pos-fb"), &ours("position-fb"))?;
    names.alias(&theirs("enable"), &ours("enable"))?;
    names.alias(&theirs("reset"), &ours("position-reset"))?;
    names.alias(&theirs("scale"), &ours("position-scale"))?;
    names.alias(&theirs("step_inv"), &ours("step-invert"))?;
    names.alias(&theirs("dir_inv"), &ours("dir-invert"))?;
    names.ours(&ours("control-type"))?.handle.set(1.0);
    // 0 means no motion there and no limit here. A pin that HAL does not set keeps our cautious
    // default.
    let limit = names.told((&theirs("acc_lim"), Float, In), 0.0, Rule::NotNegative)?;
    // As the readme has it.
    names.second(&theirs("acc_lim"), &theirs("acc-lim"))?;
    let default = names.ours(&ours("maxaccel"))?.handle.get();
    names.set(&ours("maxaccel"), move || match limit.get() {
        0.0 => default,
        limit => limit,
    })?;
    Ok(())
}

/// One timing for all step generators. Their gateware holds DIR for `setup_time` after a step: so
/// do we.
fn timing(names: &mut Names<'_>, channels: Channels) -> Result<(), ExportError> {
    let all = |pin: &str| -> Vec<String> {
        (0..channels.stepgens)
            .map(|n| format!("stepgen.{n}.{pin}"))
            .collect()
    };
    let mut time =
        |pin: &str, nanos: f64| names.told((pin, Float, ReadWrite), nanos, Rule::NotNegative);
    let width = time("stepgen-step_width", 100.0)?;
    let space = time("stepgen-step_space", 100.0)?;
    let dir = time("stepgen-dir_width", 100.0)?;
    let setup = time("stepgen-setup_time", 1000.0)?;
    for n in 0..usize::from(channels.stepgens) {
        let (width, space) = (width.clone(), space.clone());
        let (dir, setup, held) = (dir.clone(), setup.clone(), setup.clone());
        names.set(&all("steplen")[n], move || width.get())?;
        names.set(&all("stepspace")[n], move || space.get())?;
        names.set(&all("dirsetup")[n], move || setup.get())?;
        names.set(&all("dirhold")[n], move || held.get().max(dir.get()))?;
    }
    Ok(())
}

fn pwm(names: &mut Names<'_>, n: u8) -> Result<(), ExportError> {
    let theirs = |pin: &str| format!("pwm.{n:02}.{pin}");
    let ours = |pin: &str| format!("pwm.{n}.{pin}");
    let frequency = names.told((&theirs("freq"), Float, In), 0.0, Rule::Number)?;
    let value = names.told((&theirs("value"), Float, In), 0.0, Rule::Command)?;
    let enable = names.lone((&theirs("enable"), Bit, In), 0.0)?;
    let scale = names.told((&theirs("scale"), Float, ReadWrite), 100.0, Rule::Divisor)?;
    let offset = names.told((&theirs("offs"), Float, ReadWrite), 0.0, Rule::Number)?;
    names.alias(&theirs("inv"), &ours("invert-output"))?;
    let (asked, divisor) = (value.clone(), scale.clone());
    let wanted = frequency.clone();
    // A value that is not a number is refused under both names: the output rests.
    names.set(&ours("value"), move || {
        asked.look().unwrap_or_else(|bad| bad)
    })?;
    names.set(&ours("scale"), move || divisor.get())?;
    // Added before the scale there, after it here.
    names.set(&ours("offset"), move || offset.get() / scale.get())?;
    // A frequency of 0 and a negative value are off there; without a frequency ours keeps its
    // own.
    let default = names.ours(&ours("pwm-freq"))?.handle.get();
    names.set(&ours("pwm-freq"), move || match wanted.get() {
        hz if hz > 0.0 => hz,
        _ => default,
    })?;
    names.set(&ours("enable"), move || {
        f64::from(enable.get() != 0.0 && frequency.get() > 0.0 && value.get() >= 0.0)
    })?;
    Ok(())
}
