//! `names=lcnc` and `names=litexcnc[:NAME,...]`: the pins of other drivers for the same boards, so
//! that a HAL file for one of them needs only another `loadrt` line. Tests run LinuxCNC with the
//! two files in `host/examples/peers`.
//!
//! If a pin of the other driver equals one of ours in type, direction and unit, it becomes a HAL
//! alias: one pin with two names. If it differs, it is a pin of its own, coupled to ours by glue
//! code that runs before `write` and after `read`. A value written to such a pin is passed on when
//! it *changes*, so if a file uses both names for one pin, the last write counts, and a pin without
//! a write changes nothing.
//!
//! The ordinary names stay. `docs/pins.md` lists the meaning of each name here, and each difference
//! from the other driver.

use crate::client::Identity;
use crate::driver::Driver;
use crate::glue::Glue;
use crate::hal::checked::{Rule, Source, Watch};
use crate::hal::{Backend, Catalogue, Direction, ExportError, Exported, Exporter, Handle, Type};
use Direction::{In, Io, Out, ReadOnly, ReadWrite};
use Type::{Bit, Float, U32};

/// The driver with the names.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Scheme {
    /// `Lcnc.NN.*`.
    Lcnc,
    /// `NAME.*`: a name per board; the board's own configuration name where none is given.
    LitexCnc(Vec<String>),
}

/// Why a board does not get others' names.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum NamesError {
    /// `names=` is not understood.
    Scheme(String),
    /// This board does not say which number LiteX-CNC gave its inputs and outputs, and our numbers
    /// differ.
    Row(String, RowError),
}

/// What is wrong with the numbers of a board's inputs and outputs in LiteX-CNC's row.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum RowError {
    /// It gives no number, and has channels that shift the numbers.
    Unsaid,
    /// This is not a number of the row.
    NoNumber(String),
    /// Two channels have this one.
    Twice(u8),
}

impl core::fmt::Display for NamesError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            NamesError::Scheme(text) => write!(
                f,
                "\"{text}\" is not valid for names=; write names=lcnc, names=litexcnc or names=litexcnc:NAME[,NAME...], one per board"
            ),
            NamesError::Row(prefix, wrong) => {
                write!(f, "names=litexcnc cannot number gpio of \"{prefix}\": ")?;
                match wrong {
                    RowError::Unsaid => f.write_str(
                        "LiteX-CNC numbers inputs and outputs in one row, in the order of its JSON, and the board does not say which number each had, so that its HAL file would switch the wrong outputs",
                    ),
                    RowError::NoNumber(text) => {
                        write!(f, "the board says {text:?}, which is no number from 0 to 63")
                    }
                    RowError::Twice(number) => {
                        write!(f, "the board gives the number {number} to two channels")
                    }
                }?;
                f.write_str(
                    "; import that JSON again (ferrocnc config import litexcnc), or write litexcnc = NUMBER beside each [[gpio_in]] and [[gpio_out]] of the board file, then build and update the board",
                )
            }
        }
    }
}

impl std::error::Error for NamesError {}

impl Scheme {
    /// The module parameter; empty means no other names.
    pub fn parse(text: &str) -> Result<Option<Scheme>, NamesError> {
        let error = || NamesError::Scheme(text.to_owned());
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

    /// Refuses a board if the other driver's names would belong to other pins.
    pub fn check(&self, index: usize, identity: &Identity) -> Result<(), NamesError> {
        match self {
            Scheme::Lcnc => Ok(()),
            Scheme::LitexCnc(_) => match row(identity) {
                Ok(_) => Ok(()),
                Err(wrong) => Err(NamesError::Row(self.prefix(index, identity), wrong)),
            },
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
    let channels = identity.describe.channels;
    let all = || {
        let inputs = (0..channels.inputs).map(|n| (true, n));
        inputs.chain((0..channels.outputs).map(|n| (false, n)))
    };
    let letter = |input: bool| if input { b'i' } else { b'o' };
    let mut row: Vec<Place> = Vec::new();
    for (input, ours) in all() {
        let Some(text) = identity.pin(letter(input), usize::from(ours), "gpio") else {
            continue;
        };
        let number = text.parse().ok().filter(|number| *number < 64);
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
        let name = || blob.text(wire::board::Kind::Output, n);
        match input {
            true => identity.has_pin(b'i', usize::from(n), "estop"),
            false => matches!(name(), Some("watchdog" | "heartbeat")),
        }
    });
    if moved || (channels.inputs > 0 && channels.outputs > 0) {
        return Err(RowError::Unsaid);
    }
    let own = all().map(|(input, ours)| Place {
        number: ours,
        input,
        ours,
    });
    Ok(own.collect())
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
    let mut theirs = Catalogue::default();
    let mut names = Names {
        hal: Exporter::new(backend, prefix)
            .with_foreign_names()
            .listed(&mut theirs),
        ours: driver.catalogue(),
        glue: Glue::default(),
    };
    match scheme {
        Scheme::Lcnc => lcnc(&mut names, driver)?,
        Scheme::LitexCnc(_) => litexcnc(&mut names, identity, driver)?,
    }
    let mut glue = names.glue;
    glue.watches = theirs.iter().filter_map(Watch::of).collect();
    Ok(glue)
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
        // Our encoder always counts.
        names.lone((&theirs("enable"), Bit, In), 0.0)?;
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
        // 0 means no motion there and no limit here. A pin that HAL does not set keeps our cautious
        // default.
        let limit = names.told((&theirs("acc_lim"), Float, In), 0.0, Rule::NotNegative)?;
        let default = names.ours(&ours("maxaccel"))?.handle.get();
        names.set(&ours("maxaccel"), move || match limit.get() {
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
    for n in 0..channels.pwms {
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
    let nanos = names.checked("watchdog.timeout-ns")?;
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

    // No pins rather than wrong ones: `Scheme::check` has refused such a board.
    for place in row(identity).unwrap_or_default() {
        let pins: &[_] = match place.input {
            true => &[("in", "in"), ("in-not", "in-not")],
            false => &[("out", "out"), ("invert-output", "invert")],
        };
        for (their, our) in pins {
            let theirs = format!("gpio.{:02}.{their}", place.number);
            names.alias(&theirs, &format!("gpio.{}.{our}", place.ours))?;
        }
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

    /// A number of ours that HAL sets, as it is in force.
    fn checked(&self, logical: &str) -> Result<Source, ExportError> {
        let source = self.ours(logical)?.source.clone();
        source.ok_or_else(|| ExportError {
            name: logical.to_owned(),
            errno: -libc::EINVAL,
        })
    }

    /// A number of theirs that HAL sets.
    fn told(
        &mut self,
        (name, ty, direction): Theirs<'_>,
        initial: f64,
        rule: Rule,
    ) -> Result<Source, ExportError> {
        self.hal.checked(name, ty, direction, initial, rule)
    }

    /// A pin of theirs nothing is coupled to yet, a bit or one that we write.
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

    /// A number of theirs that sets ours, converted.
    fn follow(
        &mut self,
        theirs: Theirs<'_>,
        (initial, rule): (f64, Rule),
        ours: &[&str],
        convert: fn(f64) -> f64,
    ) -> Result<(), ExportError> {
        let theirs = self.told(theirs, initial, rule)?;
        for ours in ours {
            let theirs = theirs.clone();
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
