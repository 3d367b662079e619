//! Reads `machine.toml`. The first key that cannot be read ends it; what is wrong about the machine
//! as a whole is [`crate::check`]'s.

use crate::drive::{self, Timing};
use crate::keys::{DRIVE, KEYS};
use crate::model::{
    Axis, BoardSource, BoardWanted, CncMachine, Control, End, Estop, Gui, Home, Limits, Method,
    Motor, Plasma, PlasmaInput, Relay, Spindle, SpindleEncoder, Switch, Units,
};
use crate::units::{Acceleration, Hertz, Length, Nanoseconds, Rpm, Scale, Speed};
use ferrocnc_config::platform::Level;
use ferrocnc_config::tree::{At, Node, Value, nearest, parse_toml};
use ferrocnc_config::{Error, Place};
use std::collections::BTreeMap;

/// Reads the file's text.
pub fn read(file: &str, text: &str) -> Result<CncMachine, Error> {
    let tree = parse_toml(file, text).map_err(|mut error| {
        error.remedy = "`ferrocnc machine new` writes one to begin with".to_owned();
        error
    })?;
    of_a_job(file, &tree)?;
    let at = At::new(file, "", &tree, KEYS)?;
    let name = at.text("name").unwrap_or_default();
    if !is_file_name(name) {
        return Err(at.error(
            "name",
            &format!("{name:?}"),
            "is not a name for files",
            "write up to 32 letters, digits, - and _, as in \"mill\"",
        ));
    }
    let mut places = BTreeMap::new();
    collect(&tree, "", &mut places);
    let axes = at.tables("axis")?;
    if axes.is_empty() {
        return Err(at.error("axis", "", "is empty", "write at least one [[axis]]"));
    }
    let coolant = at.table("coolant")?;
    let relays = coolant.iter().flat_map(|at| {
        let named = Relay::ALL.into_iter();
        named.filter_map(|(key, relay)| Some((relay, at.text(key)?.to_owned())))
    });
    let drives = at.table("drives")?;
    Ok(CncMachine {
        file: file.to_owned(),
        name: name.to_owned(),
        units: match at.text("units") {
            Some("inch") => Units::Inch,
            _ => Units::Mm,
        },
        gui: word(&at, "gui", &Gui::ALL).unwrap_or(Gui::Axis),
        lathe: at.flag("lathe").unwrap_or(false),
        manual_tool_change: at.text("tool_change") != Some("none"),
        servo_period: nanoseconds(&at, "servo_period").unwrap_or(Nanoseconds(1_000_000)),
        board: board(&at)?,
        axes: axes.iter().map(axis).collect::<Result<_, _>>()?,
        drive_enable: drives.and_then(|at| at.text("enable").map(str::to_owned)),
        estop: estop(&at)?,
        spindle: at.table("spindle")?.map(|at| spindle(&at)).transpose()?,
        probe: switch(&at, "probe")?,
        tool_setter: switch(&at, "tool_setter")?,
        coolant: relays.collect(),
        plasma: at.table("plasma")?.map(|at| plasma(&at)).transpose()?,
        places,
    })
}

/// The machine of `ferrocnc job` is another file, which may have the same name.
fn of_a_job(file: &str, tree: &Node) -> Result<(), Error> {
    let Value::Table(entries) = &tree.value else {
        return Ok(());
    };
    let found = entries.iter().find(|(key, _, _)| key == "chord_tolerance");
    found.map_or(Ok(()), |(key, place, _)| {
        Err(Error::from(ferrocnc_config::Report {
            file: file.to_owned(),
            place: *place,
            key: key.clone(),
            value: String::new(),
            problem: "is of a machine for `ferrocnc job`".to_owned(),
            remedy: "`ferrocnc machine new` writes one for LinuxCNC; give it another name"
                .to_owned(),
        }))
    })
}

fn is_file_name(name: &str) -> bool {
    let letter = |c: char| c.is_ascii_alphanumeric() || c == '-' || c == '_';
    (1..=32).contains(&name.len()) && name.chars().all(letter)
}

/// Where every key stands, by its path.
fn collect(node: &Node, path: &str, places: &mut BTreeMap<String, Place>) {
    let mut note = |path: String, place: Option<Place>, node: &Node| {
        if let Some(place) = node.place.or(place) {
            places.insert(path.clone(), place);
        }
        collect(node, &path, places);
    };
    match &node.value {
        Value::Table(entries) => {
            for (key, place, node) in entries {
                let path = match path {
                    "" => key.clone(),
                    _ => format!("{path}.{key}"),
                };
                note(path, *place, node);
            }
        }
        Value::List(nodes) => {
            for (n, node) in nodes.iter().enumerate() {
                note(format!("{path}[{n}]"), None, node);
            }
        }
        Value::Text(_) | Value::Integer(_) | Value::Flag(_) | Value::Other(_) => {}
    }
}

fn word<T: Copy>(at: &At<'_>, key: &str, words: &[(&str, T)]) -> Option<T> {
    let text = at.text(key)?;
    let found = words.iter().find(|(word, _)| *word == text);
    found.map(|(_, meant)| *meant)
}

/// The number of a key; the list of keys has seen that it is one.
fn float(at: &At<'_>, key: &str) -> Option<f64> {
    let value = at.shown(key)?.parse::<f64>().ok()?;
    value.is_finite().then_some(value)
}

/// A number that must be more than nothing.
fn positive(at: &At<'_>, key: &str) -> Result<Option<f64>, Error> {
    match float(at, key) {
        // 1e9: more of anything is a slip of the key, and sums of it stay numbers.
        Some(value) if value <= 0.0 || value > 1e9 => Err(at.error(
            key,
            &at.shown(key).unwrap_or_default(),
            "is not above 0 and below 1e9",
            "write the number of your machine",
        )),
        other => Ok(other),
    }
}

/// A coordinate.
fn place(at: &At<'_>, key: &str) -> Result<Option<Length>, Error> {
    match float(at, key) {
        Some(value) if value.abs() > 1e9 => Err(at.error(
            key,
            &at.shown(key).unwrap_or_default(),
            "is farther away than 1e9",
            "write the coordinate of your machine",
        )),
        other => Ok(other.map(Length)),
    }
}

fn nanoseconds(at: &At<'_>, key: &str) -> Option<Nanoseconds> {
    let number = at.integer(key)?;
    u32::try_from(number).ok().map(Nanoseconds)
}

fn whole(at: &At<'_>, key: &str) -> u32 {
    let number = at.integer(key).unwrap_or_default();
    u32::try_from(number).unwrap_or_default()
}

fn texts(at: &At<'_>, key: &str) -> Vec<String> {
    let texts = at.texts(key).into_iter();
    texts.map(|(text, _)| text.to_owned()).collect()
}

fn active(at: &At<'_>) -> Level {
    Level::of(at.text("active")).unwrap_or(Level::High)
}

fn switch(at: &At<'_>, key: &str) -> Result<Option<Switch>, Error> {
    let table = at.table(key)?;
    Ok(table.map(|at| Switch {
        input: at.text("input").unwrap_or_default().to_owned(),
        active: active(&at),
    }))
}

fn board(at: &At<'_>) -> Result<BoardWanted, Error> {
    let Some(board) = at.table("board")? else {
        return Err(at.error("board", "", "is missing", "write [board]"));
    };
    let source = match (board.text("platform"), board.text("file")) {
        (Some(platform), None) => {
            let modified = board.any("modified").map(|_| texts(&board, "modified"));
            BoardSource::Platform(platform.to_owned(), modified)
        }
        (None, Some(file)) => BoardSource::File(file.to_owned()),
        (None, None) => {
            return Err(board.error(
                "platform",
                "",
                "is missing",
                "write the PCB, as in platform = \"5a-75b-8.0\", or the board file of the card's image, as in file = \"mill6.toml\"",
            ));
        }
        (Some(_), Some(file)) => {
            return Err(board.error(
                "file",
                &format!("{file:?}"),
                "names a board file, which names its platform",
                "take platform away, or file",
            ));
        }
    };
    let address = board.text("address").unwrap_or_default();
    if address.is_empty() || address.contains(|c: char| c.is_whitespace() || c.is_control()) {
        return Err(board.error(
            "address",
            &format!("{address:?}"),
            "is not an address",
            "write the board's address or name, as in \"192.168.2.50\"",
        ));
    }
    Ok(BoardWanted {
        source,
        address: address.to_owned(),
        debounce: nanoseconds(&board, "debounce").unwrap_or(Nanoseconds(2_000_000)),
        active_low: texts(&board, "active_low"),
    })
}

fn axis(at: &At<'_>) -> Result<Axis, Error> {
    let letter = at.text("letter").and_then(|text| text.chars().next());
    let letter = letter.unwrap_or('x');
    let [steps, microsteps] = ["motor_steps", "microsteps"].map(|key| f64::from(whole(at, key)));
    let gear = positive(at, "gear")?.unwrap_or(1.0);
    let pitch = positive(at, "pitch")?.unwrap_or(1.0);
    let limits = limits(at)?;
    let speed = Speed(positive(at, "speed")?.unwrap_or(1.0));
    let (home, squares) = home(at, &limits, speed)?;
    Ok(Axis {
        key: at.path.clone(),
        letter,
        motors: motors(at, letter, &squares)?,
        scale: Scale(steps * microsteps * gear / pitch),
        backlash: place(at, "backlash")?.unwrap_or(Length(0.0)),
        min: place(at, "min")?.unwrap_or(Length(0.0)),
        max: place(at, "max")?.unwrap_or(Length(0.0)),
        speed,
        acceleration: Acceleration(positive(at, "acceleration")?.unwrap_or(1.0)),
        timing: timing(at)?,
        limits,
        home,
        fault: switch(at, "fault")?,
    })
}

fn motors(at: &At<'_>, letter: char, squares: &[f64]) -> Result<Vec<Motor>, Error> {
    let mut names = texts(at, "motors");
    if names.is_empty() {
        names.push(letter.to_string());
    }
    let reversed = texts(at, "reversed");
    if let Some(unknown) = reversed.iter().find(|name| !names.contains(name)) {
        return Err(at.error(
            "reversed",
            &format!("{unknown:?}"),
            format!("is not a motor of {}", letter.to_uppercase()),
            format!("write one of {}", names.join(", ")),
        ));
    }
    let one = |(n, name): (usize, String)| Motor {
        reversed: reversed.contains(&name),
        square: Length(squares.get(n).copied().unwrap_or(0.0)),
        name,
    };
    Ok(names.into_iter().enumerate().map(one).collect())
}

/// A preset, or a table.
fn timing(at: &At<'_>) -> Result<Timing, Error> {
    let Some(node) = at.any("drive") else {
        return Err(at.error("drive", "", "is missing", "write drive = \"generic\""));
    };
    if let Value::Text(name) = &node.value {
        return Timing::of(name).ok_or_else(|| {
            let near = nearest(name, drive::NAMES.into_iter());
            let near = near.map_or(String::new(), |near| format!(" (did you mean {near}?)"));
            at.error(
                "drive",
                &format!("{name:?}"),
                format!("is not a drive we know{near}"),
                format!(
                    "write one of {}, or {{ steplen = 2500, stepspace = 2500, dirsetup = 5000, dirhold = 5000 }} in ns",
                    drive::NAMES.join(", ")
                ),
            )
        });
    }
    let table = At::new(at.file(), &at.key("drive"), node, DRIVE)?;
    Ok(Timing {
        steplen: Nanoseconds(whole(&table, "steplen")),
        stepspace: Nanoseconds(whole(&table, "stepspace")),
        dirsetup: Nanoseconds(whole(&table, "dirsetup")),
        dirhold: Nanoseconds(whole(&table, "dirhold")),
    })
}

fn limits(at: &At<'_>) -> Result<Limits, Error> {
    let Some(table) = at.table("limits")? else {
        return Ok(Limits::default());
    };
    let active = active(&table);
    let one = |key| {
        table.text(key).map(|input| Switch {
            input: input.to_owned(),
            active,
        })
    };
    Ok(Limits {
        min: one("min"),
        max: one("max"),
    })
}

/// How an axis homes, and how far each motor's switch is off.
fn home(at: &At<'_>, limits: &Limits, speed: Speed) -> Result<(Home, Vec<f64>), Error> {
    let Some(table) = at.table("home")? else {
        return Err(at.error(
            "home",
            "",
            "is missing",
            "write home = { method = \"immediate\" }",
        ));
    };
    let method = word(&table, "method", &Method::ALL).unwrap_or(Method::Immediate);
    let end = word(&table, "end", &[("min", End::Min), ("max", End::Max)]);
    if method.searches() && end.is_none() {
        return Err(table.error(
            "end",
            "",
            "is missing",
            "write \"min\" or \"max\": where the switch is",
        ));
    }
    let end = end.unwrap_or(End::Min);
    let active = active(&table);
    let named = texts(&table, "inputs");
    let mut switches: Vec<Switch> = named
        .into_iter()
        .map(|input| Switch { input, active })
        .collect();
    if method.by_limit() && switches.is_empty() {
        switches.extend(match end {
            End::Min => limits.min.clone(),
            End::Max => limits.max.clone(),
        });
    }
    // A tenth of the axis' speed towards the switch and a hundredth to its edge, unless it is said.
    let search = positive(&table, "search")?.unwrap_or(speed.0 / 10.0);
    let latch = positive(&table, "latch")?.unwrap_or(search / 10.0);
    let home = Home {
        method,
        switches,
        end,
        search: Speed(search),
        latch: Speed(latch),
        travel: positive(&table, "travel")?.map(Speed),
        on_contact: table.text("latch_on") == Some("contact"),
        offset: place(&table, "offset")?.unwrap_or(Length(0.0)),
        position: place(&table, "position")?.unwrap_or(Length(0.0)),
        sequence: whole(&table, "sequence"),
    };
    Ok((home, squares(&table)?))
}

fn squares(at: &At<'_>) -> Result<Vec<f64>, Error> {
    let Some(node) = at.any("square") else {
        return Ok(Vec::new());
    };
    let wrong = || {
        at.error(
            "square",
            &node.value.show(),
            "is not a list of numbers",
            "write for each motor what is added to offset, as in [0, 0.25]",
        )
    };
    let Value::List(nodes) = &node.value else {
        return Err(wrong());
    };
    let number = |node: &Node| {
        let number = node.value.show().parse::<f64>().ok();
        number
            .filter(|number| number.abs() <= 1e9)
            .ok_or_else(wrong)
    };
    nodes.iter().map(number).collect()
}

fn estop(at: &At<'_>) -> Result<Estop, Error> {
    let Some(table) = at.table("estop")? else {
        return Err(at.error("estop", "", "is missing", "write [estop]"));
    };
    Ok(match table.text("source") {
        Some("input") => Estop::Input(Switch {
            input: table.text("input").unwrap_or("estop").to_owned(),
            active: active(&table),
        }),
        Some("external") => Estop::External(active(&table)),
        _ => Estop::Software,
    })
}

fn spindle(at: &At<'_>) -> Result<Spindle, Error> {
    let name = |key: &str| at.text(key).map(str::to_owned);
    let rpm = |key| positive(at, key).map(|rpm| rpm.map(Rpm));
    let max = rpm("max_rpm")?;
    let control = match at.text("control") {
        Some("on_off") => Control::OnOff,
        kind => {
            let Some(max) = max else {
                return Err(at.error(
                    "max_rpm",
                    "",
                    "is missing",
                    "write its greatest speed in turns a minute, as in 24000",
                ));
            };
            Control::Pwm {
                name: name("pwm").unwrap_or_else(|| "spindle".to_owned()),
                frequency: Hertz(positive(at, "frequency")?.unwrap_or(5000.0)),
                full: rpm("full_rpm")?.unwrap_or(max),
                volts: kind == Some("analog"),
            }
        }
    };
    let encoder = match (name("encoder"), at.integer("counts_per_turn")) {
        (None, _) => None,
        (Some(_), None) => {
            return Err(at.error(
                "counts_per_turn",
                "",
                "is missing",
                "write four times the lines of the encoder, as in 4096",
            ));
        }
        (Some(encoder), Some(_)) => Some(SpindleEncoder {
            name: encoder,
            counts: whole(at, "counts_per_turn"),
            near: float(at, "at_speed").unwrap_or(0.05),
        }),
    };
    Ok(Spindle {
        control,
        on: name("on"),
        reverse: name("reverse"),
        min: Rpm(float(at, "min_rpm").unwrap_or(0.0)),
        max: max.unwrap_or(Rpm(1e9)),
        encoder,
    })
}

fn plasma(at: &At<'_>) -> Result<Plasma, Error> {
    let mut inputs = Vec::new();
    for (key, input, _) in PlasmaInput::ALL {
        if let Some(switch) = switch(at, key)? {
            inputs.push((input, switch));
        }
    }
    Ok(Plasma {
        mode: at.integer("mode").map_or(0, |mode| mode as u8),
        torch: at.text("torch").unwrap_or_default().to_owned(),
        arc_voltage: at.text("arc_voltage").map(str::to_owned),
        inputs,
        ohmic_enable: at.text("ohmic_enable").map(str::to_owned),
    })
}
