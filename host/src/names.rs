//! `names=lcnc` and `names=litexcnc[:NAME,...]`: the pins of other drivers for the same boards, so that a
//! HAL file written for one of them loads unchanged but for its `loadrt` line.
//!
//! Where their pin is one of ours in type, direction and unit it becomes a HAL alias: one pin with two
//! names. Where it differs it is a pin of its own, coupled to ours by a bit of glue that runs before `write`
//! and after `read`. What is written to such a pin is passed on when it *changes*, so a file that uses both
//! names for one thing gets the last word said, and a pin nobody touches changes nothing.
//!
//! The ordinary names stay. What each name means here, and where that is not what it meant there, is in
//! `docs/pins.md`.

use crate::client::Identity;
use crate::driver::Driver;
use crate::hal::{Backend, Catalogue, Direction, ExportError, Exported, Exporter, Handle, Type};
use Direction::{In, Io, Out, ReadOnly, ReadWrite};
use Type::{Bit, Float, U32};

/// Whose names.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Scheme {
    /// `Lcnc.NN.*`.
    Lcnc,
    /// `NAME.*`: a name per board; the board's own configuration name where none is given.
    LitexCnc(Vec<String>),
}

/// `names=` is not understood.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NamesError(String);

impl core::fmt::Display for NamesError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(
            f,
            "\"{}\" are no names; say names=lcnc, names=litexcnc or names=litexcnc:NAME[,NAME...], one per board",
            self.0
        )
    }
}

impl std::error::Error for NamesError {}

impl Scheme {
    /// The module parameter; empty is none.
    pub fn parse(text: &str) -> Result<Option<Scheme>, NamesError> {
        let error = || NamesError(text.to_owned());
        match text.trim() {
            "" => Ok(None),
            "lcnc" => Ok(Some(Scheme::Lcnc)),
            "litexcnc" => Ok(Some(Scheme::LitexCnc(Vec::new()))),
            other => {
                let names = other.strip_prefix("litexcnc:").ok_or_else(error)?;
                let names: Vec<String> = names
                    .split(',')
                    .map(|name| name.trim().to_owned())
                    .collect();
                if names.iter().any(|name| !is_name(name)) {
                    return Err(error());
                }
                Ok(Some(Scheme::LitexCnc(names)))
            }
        }
    }

    /// What everything of board `index` begins with.
    pub fn prefix(&self, index: usize, identity: &Identity) -> String {
        match self {
            Scheme::Lcnc => format!("Lcnc.{index:02}"),
            Scheme::LitexCnc(names) => {
                let blob = identity.blob();
                let own = blob.text(wire::board::Kind::Configuration, 0);
                let given = names.get(index).map(String::as_str);
                given
                    .or(own.filter(|own| is_name(own)))
                    .unwrap_or("test")
                    .to_owned()
            }
        }
    }

    /// The realtime functions: name after the prefix, and what they do.
    pub fn functions(&self) -> &'static [(&'static str, Does)] {
        match self {
            Scheme::Lcnc => &[("update", Does::Both)],
            Scheme::LitexCnc(_) => &[("read", Does::Read), ("write", Does::Write)],
        }
    }
}

/// What a function of theirs does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Does {
    /// Our `read`.
    Read,
    /// Our `write`.
    Write,
    /// One after the other.
    Both,
}

/// LiteX-CNC allows 16 characters; more would not leave its longest pin enough room either.
fn is_name(name: &str) -> bool {
    let good = |b: u8| b.is_ascii_alphanumeric() || b == b'-' || b == b'_';
    !name.is_empty() && name.len() <= 16 && name.bytes().all(good)
}

type Step = Box<dyn FnMut() + Send>;

/// What runs beside a driver to keep other names alive.
#[derive(Default)]
pub struct Glue {
    inputs: Vec<Step>,
    outputs: Vec<Step>,
}

impl Glue {
    /// Before our pins are read.
    pub fn inputs(&mut self) {
        for step in &mut self.inputs {
            step();
        }
    }

    /// After our pins were written.
    pub fn outputs(&mut self) {
        for step in &mut self.outputs {
            step();
        }
    }
}

/// Exports the names of a scheme for a board.
pub fn export(
    scheme: &Scheme,
    backend: &mut dyn Backend,
    index: usize,
    identity: &Identity,
    driver: &Driver,
) -> Result<Glue, ExportError> {
    let prefix = scheme.prefix(index, identity);
    let mut names = Names {
        hal: Exporter::new(backend, prefix).with_foreign_names(),
        ours: driver.catalogue(),
        glue: Glue::default(),
    };
    match scheme {
        Scheme::Lcnc => lcnc(&mut names, driver)?,
        Scheme::LitexCnc(_) => litexcnc(&mut names, identity, driver)?,
    }
    Ok(names.glue)
}

/// `Lcnc.NN.*` as `driver/Lcnc.c` exports it.
fn lcnc(names: &mut Names<'_>, driver: &Driver) -> Result<(), ExportError> {
    let channels = driver.channels();
    names.alias("enable", "enable")?;
    names.alias("enable-request", "enable-request")?;
    names.alias("enabled", "enabled")?;
    // A missing answer raises our level by 2.
    names.follow(
        ("tx-max-retries", U32, ReadWrite),
        10.0,
        &["packet-error-limit"],
        |n| 2.0 * n,
    )?;
    names.show(("watchdog-read", Float, Out), "watchdog.margin-ns", |ns| {
        ns * 1e-9
    })?;
    names.follow(
        ("watchdog-write", Float, ReadWrite),
        0.01,
        &["watchdog.timeout-ns"],
        |s| s * 1e9,
    )?;
    names.alias("wallclock.value", "wallclock.ticks-lsb")?;
    names.alias("wallclock.interval", "wallclock.interval")?;
    for n in 0..channels.inputs {
        names.alias(&format!("input.{n:02}.in"), &format!("gpio.{n}.in"))?;
        names.alias(&format!("input.{n:02}.in-n"), &format!("gpio.{n}.in-not"))?;
    }
    for n in 0..channels.outputs {
        names.alias(&format!("output.{n:02}.out"), &format!("gpio.{n}.out"))?;
        names.alias(&format!("output.{n:02}.inv"), &format!("gpio.{n}.invert"))?;
    }
    for n in 0..channels.encoders {
        let theirs = |pin: &str| format!("encoder.{n:02}.{pin}");
        let ours = |pin: &str| format!("encoder.{n}.{pin}");
        names.alias(&theirs("pos-fb"), &ours("position"))?;
        names.alias(&theirs("vel-fb"), &ours("velocity"))?;
        names.alias(&theirs("reset"), &ours("reset"))?;
        // Ours counts always.
        names.lone((&theirs("enable"), Bit, In), 0.0)?;
        // Units per count there, counts per unit here.
        let scale = names.lone((&theirs("scale"), Float, ReadWrite), 1.0)?;
        let invert = names.lone((&theirs("inv"), Bit, ReadWrite), 0.0)?;
        let reciprocal = move || {
            1.0 / if invert.get() == 0.0 {
                scale.get()
            } else {
                -scale.get()
            }
        };
        names.set(&ours("scale"), reciprocal)?;
    }
    for n in 0..channels.stepgens {
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
        // 0 never moves there and knows no limit here: what nobody sets leaves our cautious default alone.
        let limit = names.lone((&theirs("acc_lim"), Float, In), 0.0)?;
        let default = names.ours(&ours("maxaccel"))?.handle.get();
        names.set(&ours("maxaccel"), move || match limit.get().abs() {
            0.0 => default,
            limit => limit,
        })?;
    }
    // One timing for all. Their gateware holds DIR for `setup_time` after a step: so do we.
    let all = |pin: &str| -> Vec<String> {
        (0..channels.stepgens)
            .map(|n| format!("stepgen.{n}.{pin}"))
            .collect()
    };
    let width = names.lone(("stepgen-step_width", Float, ReadWrite), 100.0)?;
    let space = names.lone(("stepgen-step_space", Float, ReadWrite), 100.0)?;
    let dir = names.lone(("stepgen-dir_width", Float, ReadWrite), 100.0)?;
    let setup = names.lone(("stepgen-setup_time", Float, ReadWrite), 1000.0)?;
    for n in 0..usize::from(channels.stepgens) {
        names.set(&all("steplen")[n], move || width.get())?;
        names.set(&all("stepspace")[n], move || space.get())?;
        names.set(&all("dirsetup")[n], move || setup.get())?;
        names.set(&all("dirhold")[n], move || setup.get().max(dir.get()))?;
    }
    for n in 0..channels.pwms {
        let theirs = |pin: &str| format!("pwm.{n:02}.{pin}");
        let ours = |pin: &str| format!("pwm.{n}.{pin}");
        let frequency = names.lone((&theirs("freq"), Float, In), 0.0)?;
        let value = names.lone((&theirs("value"), Float, In), 0.0)?;
        let enable = names.lone((&theirs("enable"), Bit, In), 0.0)?;
        let scale = names.lone((&theirs("scale"), Float, ReadWrite), 100.0)?;
        let offset = names.lone((&theirs("offs"), Float, ReadWrite), 0.0)?;
        names.alias(&theirs("inv"), &ours("invert-output"))?;
        names.set(&ours("value"), move || value.get())?;
        names.set(&ours("scale"), move || scale.get())?;
        // Added before the scale there, after it here.
        names.set(&ours("offset"), move || offset.get() / scale.get())?;
        // A frequency of 0 and a negative value are off there; without a frequency ours keeps its own.
        let default = names.ours(&ours("pwm-freq"))?.handle.get();
        names.set(&ours("pwm-freq"), move || match frequency.get() {
            hz if hz > 0.0 => hz,
            _ => default,
        })?;
        names.set(&ours("enable"), move || {
            f64::from(enable.get() != 0.0 && frequency.get() > 0.0 && value.get() >= 0.0)
        })?;
    }
    Ok(())
}

/// `NAME.*` as LiteX-CNC 1.3's modules export it.
fn litexcnc(
    names: &mut Names<'_>,
    identity: &Identity,
    driver: &Driver,
) -> Result<(), ExportError> {
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
    let nanos = names.ours("watchdog.timeout-ns")?.handle;
    names.publish(("watchdog.timeout-cycles", U32, ReadOnly), move || {
        nanos.get() * clock / 1e9
    })?;
    let estops = (0..usize::from(channels.inputs)).filter(|n| identity.has_pin(b'i', *n, "estop"));
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

    for n in 0..channels.inputs {
        names.alias(&format!("gpio.{n:02}.in"), &format!("gpio.{n}.in"))?;
        names.alias(&format!("gpio.{n:02}.in-not"), &format!("gpio.{n}.in-not"))?;
    }
    for n in 0..channels.outputs {
        names.alias(&format!("gpio.{n:02}.out"), &format!("gpio.{n}.out"))?;
        names.alias(
            &format!("gpio.{n:02}.invert-output"),
            &format!("gpio.{n}.invert"),
        )?;
    }
    for n in 0..channels.stepgens {
        litexcnc_stepgen(names, n)?;
    }
    for n in 0..channels.encoders {
        litexcnc_encoder(names, n)?;
    }
    for n in 0..channels.pwms {
        let has_direction = identity.has_pin(b'p', usize::from(n), "dir");
        litexcnc_pwm(names, n, has_direction, clock)?;
    }
    Ok(())
}

fn litexcnc_stepgen(names: &mut Names<'_>, n: u8) -> Result<(), ExportError> {
    let theirs = |pin: &str| format!("stepgen.{n:02}.{pin}");
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
        // Theirs is an input, so that homing to it never ends. As io it takes the same signals from LinuxCNC.
        ("index-enable", "index-enable"),
    ] {
        names.alias(&theirs(their), &ours(our))?;
    }
    let most = names.ours(&ours("maxaccel"))?.handle.get();
    let most = names.lone((&theirs("max-acceleration"), Float, ReadWrite), most)?;
    let wish = names.lone((&theirs("acceleration-cmd"), Float, In), 0.0)?;
    names.set(&ours("maxaccel"), move || {
        match (wish.get().abs(), most.get()) {
            (0.0, most) => most,
            (wish, 0.0) => wish,
            (wish, most) => wish.min(most),
        }
    })?;
    names.lone((&theirs("debug"), Bit, In), 0.0)?;
    names.show(
        (&theirs("velocity-feedback"), Float, Out),
        &ours("velocity-fb"),
        |v| v,
    )?;
    let scale = names.ours(&ours("position-scale"))?.handle;
    let counts = names.ours(&ours("counts"))?.handle;
    let velocity = names.ours(&ours("velocity-fb"))?.handle;
    let (steplen, stepspace) = (
        names.ours(&ours("steplen"))?.handle,
        names.ours(&ours("stepspace"))?.handle,
    );
    // Theirs is unsigned.
    names.publish((&theirs("counts"), U32, Out), move || {
        f64::from(counts.get() as i32 as u32)
    })?;
    names.publish((&theirs("position-feedback"), Float, Out), move || {
        counts.get() / scale.get()
    })?;
    names.publish((&theirs("frequency"), Float, ReadOnly), move || {
        velocity.get() * scale.get()
    })?;
    names.publish((&theirs("max-frequency"), Float, ReadOnly), move || {
        1e9 / (steplen.get() + stepspace.get()).max(1.0)
    })?;
    names.index_pulse(&theirs("index-pulse"), &ours("index-enable"))
}

fn litexcnc_encoder(names: &mut Names<'_>, n: u8) -> Result<(), ExportError> {
    let theirs = |pin: &str| format!("encoder.{n:02}.{pin}");
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
    let offset = names.lone((&theirs("position-offset"), Float, ReadWrite), 0.0)?;
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
    // Theirs clears itself when it has been obeyed.
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

fn litexcnc_pwm(
    names: &mut Names<'_>,
    n: u8,
    has_direction: bool,
    clock: f64,
) -> Result<(), ExportError> {
    let theirs = |pin: &str| format!("pwm.{n:02}.{pin}");
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
    for (pin, default) in [
        ("scale", 1.0),
        ("offset", 0.0),
        ("min-dc", 0.0),
        ("max-dc", 1.0),
    ] {
        names.follow((&theirs(pin), Float, In), default, &[&ours(pin)], |value| {
            value
        })?;
    }
    names.follow(
        (&theirs("dither-pwm"), Bit, In),
        0.0,
        &[&ours("dither")],
        |value| value,
    )?;
    // 0 Hz is pulse density, a bit every clock.
    let frequency = names.lone((&theirs("pwm-freq"), Float, In), 100_000.0)?;
    names.set(&ours("pwm-freq"), move || match frequency.get() {
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

/// A name, type and direction of theirs.
type Theirs<'n> = (&'n str, Type, Direction);

/// Names under construction.
struct Names<'b> {
    hal: Exporter<'b>,
    ours: &'b Catalogue,
    glue: Glue,
}

impl<'b> Names<'b> {
    fn ours(&self, logical: &str) -> Result<&'b Exported, ExportError> {
        self.ours.find(logical).ok_or_else(|| ExportError {
            name: logical.to_owned(),
            errno: -libc::ENOENT,
        })
    }

    /// One pin, two names.
    fn alias(&mut self, theirs: &str, ours: &str) -> Result<(), ExportError> {
        let exported = self.ours(ours)?;
        self.hal.alias(exported, theirs)
    }

    /// A pin of theirs nothing is coupled to yet.
    fn lone(
        &mut self,
        (name, ty, direction): Theirs<'_>,
        initial: f64,
    ) -> Result<Handle, ExportError> {
        self.hal.export(name, ty, direction, initial)
    }

    /// Ours is what `value` says, told whenever that changes.
    fn set(
        &mut self,
        ours: &str,
        value: impl Fn() -> f64 + Send + 'static,
    ) -> Result<(), ExportError> {
        let ours = self.ours(ours)?.handle;
        let mut last = value();
        ours.set(last);
        self.glue.inputs.push(Box::new(move || {
            let now = value();
            if now.to_bits() != last.to_bits() {
                last = now;
                ours.set(now);
            }
        }));
        Ok(())
    }

    /// A pin of theirs that sets ours, converted.
    fn follow(
        &mut self,
        theirs: Theirs<'_>,
        initial: f64,
        ours: &[&str],
        convert: fn(f64) -> f64,
    ) -> Result<(), ExportError> {
        let theirs = self.lone(theirs, initial)?;
        for ours in ours {
            self.set(ours, move || convert(theirs.get()))?;
        }
        Ok(())
    }

    /// A pin of theirs that shows what `value` says.
    fn publish(
        &mut self,
        theirs: Theirs<'_>,
        value: impl Fn() -> f64 + Send + 'static,
    ) -> Result<(), ExportError> {
        let theirs = self.lone(theirs, value())?;
        self.glue
            .outputs
            .push(Box::new(move || theirs.set(value())));
        Ok(())
    }

    /// A pin of theirs that shows ours, converted.
    fn show(
        &mut self,
        theirs: Theirs<'_>,
        ours: &str,
        convert: fn(f64) -> f64,
    ) -> Result<(), ExportError> {
        let ours = self.ours(ours)?.handle;
        self.publish(theirs, move || convert(ours.get()))
    }

    /// High for the period in which the index was found: when `index-enable` fell by itself.
    fn index_pulse(&mut self, theirs: &str, ours: &str) -> Result<(), ExportError> {
        let pulse = self.lone((theirs, Bit, Out), 0.0)?;
        let enable = self.ours(ours)?.handle;
        let asked = std::sync::Arc::new(std::sync::atomic::AtomicBool::new(false));
        let relaxed = std::sync::atomic::Ordering::Relaxed;
        let seen = std::sync::Arc::clone(&asked);
        self.glue
            .inputs
            .push(Box::new(move || seen.store(enable.get() != 0.0, relaxed)));
        self.glue.outputs.push(Box::new(move || {
            let found = asked.load(relaxed) && enable.get() == 0.0;
            pulse.set(f64::from(found));
        }));
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_parameter_is_understood_or_refused_by_its_own_text() {
        assert_eq!(Scheme::parse(""), Ok(None));
        assert_eq!(Scheme::parse("lcnc"), Ok(Some(Scheme::Lcnc)));
        assert_eq!(
            Scheme::parse("litexcnc:mill, io_1"),
            Ok(Some(Scheme::LitexCnc(vec![
                "mill".to_owned(),
                "io_1".to_owned()
            ])))
        );
        for text in ["Lcnc", "litexcnc:", "litexcnc:a,,b", "litexcnc:a.b", "mesa"] {
            let message = Scheme::parse(text).unwrap_err().to_string();
            assert!(message.contains(text), "{message}");
        }
    }
}
