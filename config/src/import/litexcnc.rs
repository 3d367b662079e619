//! LiteX-CNC's JSON, of both generations: `ethphy`, `etherbone`, `watchdog.pin` and one-pin PWMs
//! until 1.2, `connection`, watchdog functions, e-stops and PWM types from there on.

use super::ini::refuse_machine;
use super::json::parse;
use super::{Draft, Imported, mac};
use crate::board::{Channel, Class, Platforms};
use crate::error::Error;
use crate::platform::Level;
use crate::tree::{At, Key, Kind, Node, Value, may, must};
use wire::board::HAL_NAME_LEN;
use wire::regmap::{ENCODER_MAX, IN_MAX, OUT_MAX, PWM_MAX, STEPGEN_MAX};

const PIN: &str = "a pin, as in \"j1:0\"";
const IO_STANDARD: Key = may(
    "io_standard",
    Kind::OneOf(&["LVCMOS33", "LVTTL33"]),
    "\"LVCMOS33\", what all pins of these boards have, or nothing",
);
const NAME: Key = may("name", Kind::Text, "a name for HAL");

const ETHPHY: &[Key] = &[
    may(
        "tx_delay",
        Kind::Number,
        "the delay of the transmit clock in seconds",
    ),
    may(
        "rx_delay",
        Kind::Number,
        "the delay of the receive clock in seconds",
    ),
    may("with_hw_init_reset", Kind::Flag, "true or false"),
];
const ETHERBONE: &[Key] = &[
    may(
        "ip_address",
        Kind::Text,
        "an IPv4 address, as in \"192.168.0.50\"",
    ),
    must(
        "mac_address",
        Kind::Text,
        "a MAC address, as in \"0x10e2d5000000\"",
    ),
];
const CONNECTION: &[Key] = &[
    may(
        "connection_type",
        Kind::OneOf(&["etherbone"]),
        "\"etherbone\": this board is reached by Ethernet; SPI is not spoken here",
    ),
    may(
        "tx_delay",
        Kind::Number,
        "the delay of the transmit clock in seconds",
    ),
    may(
        "rx_delay",
        Kind::Number,
        "the delay of the receive clock in seconds",
    ),
    may("with_hw_init_reset", Kind::Flag, "true or false"),
    may(
        "ip_address",
        Kind::Text,
        "an IPv4 address, as in \"192.168.0.50\"",
    ),
    must(
        "mac_address",
        Kind::Text,
        "a MAC address, as in \"0x10e2d5000000\"",
    ),
];
const FUNCTION: &[Key] = &[
    must(
        "function_type",
        Kind::OneOf(&["enable", "heartbeat"]),
        "\"enable\" or \"heartbeat\"",
    ),
    must("pin", Kind::Text, PIN),
    may("invert_output", Kind::Flag, "true or false"),
    may("pwm_frequency", Kind::Number, "a frequency in hertz"),
    may("waveform", Kind::Any, "a name or a list of numbers"),
    may("speed", Kind::Number, "a frequency in hertz"),
    IO_STANDARD,
];
const ESTOP: &[Key] = &[
    must("pin", Kind::Text, PIN),
    must(
        "trigger",
        Kind::Flag,
        "true if high stops the machine, false if low does",
    ),
    NAME,
    IO_STANDARD,
];
const WATCHDOG: &[Key] = &[
    may("pin", Kind::Text, PIN),
    IO_STANDARD,
    may(
        "functions",
        Kind::Tables(FUNCTION, 32),
        "a list of functions",
    ),
    may("estop", Kind::Tables(ESTOP, 32), "a list of e-stop inputs"),
];
const MODULE: &[Key] = &[
    must(
        "module_type",
        Kind::OneOf(&["gpio", "pwm", "encoder", "stepgen"]),
        "\"gpio\", \"pwm\", \"encoder\" or \"stepgen\": others have no counterpart here",
    ),
    may("instances", Kind::Any, "a list of instances"),
    may(
        "instance",
        Kind::Any,
        "the same, as the manual spells it: a list of instances",
    ),
];
const BOARD: &[Key] = &[
    must("board_name", Kind::Text, "the board's name in HAL"),
    must(
        "board_type",
        Kind::OneOf(&BOARD_TYPES),
        "the PCB, as in \"5A-75B v8.0\"",
    ),
    may("clock_frequency", Kind::Number, "a frequency in hertz"),
    may("ethphy", Kind::Table(ETHPHY), "a table"),
    may(
        "etherbone",
        Kind::Table(ETHERBONE),
        "a table with ip_address and mac_address",
    ),
    may(
        "connection",
        Kind::Any,
        "a table with connection_type, ip_address and mac_address",
    ),
    must(
        "watchdog",
        Kind::Table(WATCHDOG),
        "a table, which may be empty",
    ),
    may("modules", Kind::Tables(MODULE, 32), "a list of modules"),
];
const BOARD_TYPES: [&str; 8] = [
    "5A-75B v6.1",
    "5A-75B v7.0",
    "5A-75B v8.0",
    "5A-75B v8.2",
    "5A-75E v6.0",
    "5A-75E v7.1",
    "5A-75E v8.0",
    "5A-75E v8.2",
];

const GPIO: &[Key] = &[
    must(
        "direction",
        Kind::OneOf(&["in", "out"]),
        "\"in\" or \"out\"",
    ),
    must("pin", Kind::Text, PIN),
    may(
        "safe_state",
        Kind::Flag,
        "true if the output is high while nothing drives it",
    ),
    NAME,
    IO_STANDARD,
];
const PWM: &[Key] = &[
    may("pin", Kind::Text, PIN),
    may(
        "pins",
        Kind::Table(PWM_PINS),
        "a table with output_type and its pins",
    ),
    NAME,
    IO_STANDARD,
];
const PWM_PINS: &[Key] = &[
    may(
        "output_type",
        Kind::OneOf(&["single", "pwmdirection", "updown"]),
        "\"single\", \"pwmdirection\" or \"updown\"",
    ),
    may("pwm", Kind::Text, PIN),
    may("direction", Kind::Text, PIN),
    may("up", Kind::Text, PIN),
    may("down", Kind::Text, PIN),
    IO_STANDARD,
];
const ENCODER: &[Key] = &[
    must("pin_A", Kind::Text, PIN),
    may("pin_B", Kind::Text, PIN),
    may("pin_Z", Kind::Text, PIN),
    may(
        "min_value",
        Kind::Integer {
            min: i64::MIN,
            max: i64::MAX,
        },
        "a count",
    ),
    may(
        "max_value",
        Kind::Integer {
            min: i64::MIN,
            max: i64::MAX,
        },
        "a count",
    ),
    may(
        "reset_value",
        Kind::Integer {
            min: i64::MIN,
            max: i64::MAX,
        },
        "a count",
    ),
    NAME,
    IO_STANDARD,
];
const STEPGEN: &[Key] = &[
    must(
        "pins",
        Kind::Table(STEPGEN_PINS),
        "a table with stepgen_type and its pins",
    ),
    may("max_frequency", Kind::Number, "a frequency in hertz"),
    may("soft_stop", Kind::Flag, "true or false"),
    NAME,
];
const STEPGEN_PINS: &[Key] = &[
    must(
        "stepgen_type",
        Kind::OneOf(&["step_dir", "step_dir_differential"]),
        "\"step_dir\" or \"step_dir_differential\"",
    ),
    may("step_pin", Kind::Text, PIN),
    may("dir_pin", Kind::Text, PIN),
    may("step_pos_pin", Kind::Text, PIN),
    may("step_neg_pin", Kind::Text, PIN),
    may("dir_pos_pin", Kind::Text, PIN),
    may("dir_neg_pin", Kind::Text, PIN),
    may("index_pin", Kind::Text, PIN),
    IO_STANDARD,
];

/// Imports a JSON file's text under a name of its own.
pub fn litexcnc(
    file: &str,
    text: &str,
    name: &str,
    platforms: &dyn Platforms,
) -> Result<Imported, Error> {
    refuse_machine(
        file,
        text,
        "the JSON with board_type and modules that `litexcnc build_firmware` read",
    )?;
    let tree = parse(file, text)?;
    let at = At::new(file, "", &tree, BOARD)?;
    let board_type = at.text("board_type").unwrap_or_default();
    let platform = match board_type {
        // The same PCB as far as is known (chubby75).
        "5A-75E v8.0" => "5a-75e-6.0".to_owned(),
        other => other.to_lowercase().replace(" v", "-"),
    };
    let mut draft = Draft::new(file, name, &platform, platforms)?;
    let board_name = at.text("board_name").unwrap_or_default();
    if let Some(hz) = at.shown("clock_frequency") {
        draft.notes.push(format!(
            "The clock is 60 MHz, not {hz} Hz: the driver asks the board, nothing in HAL changes."
        ));
    }
    board_name.clone_into(&mut draft.prefix);
    network(&mut draft, file, &at)?;
    if let Some(watchdog) = at.table("watchdog")? {
        self::watchdog(&mut draft, &watchdog)?;
    }
    // Their HAL numbers inputs and outputs in one row, in the order of the file; e-stops and the
    // watchdog's pins are not in it.
    let mut row = 0;
    for module in at.tables("modules")? {
        let key = instances(&module)?;
        let nodes = module.nodes(key)?;
        for (n, node) in nodes.iter().enumerate() {
            let path = format!("{}[{n}]", module.key(key));
            match module.text("module_type") {
                Some("gpio") => {
                    gpio(&mut draft, &At::new(file, &path, node, GPIO)?, row)?;
                    row += 1;
                }
                Some("pwm") => pwm(&mut draft, &At::new(file, &path, node, PWM)?)?,
                Some("encoder") => encoder(&mut draft, &At::new(file, &path, node, ENCODER)?)?,
                _ => stepgen(&mut draft, &At::new(file, &path, node, STEPGEN)?)?,
            }
        }
    }
    for (class, most) in [
        (Class::Stepgen, STEPGEN_MAX),
        (Class::Encoder, ENCODER_MAX),
        (Class::Pwm, PWM_MAX),
        (Class::Input, IN_MAX),
        (Class::Output, OUT_MAX),
    ] {
        if draft.board.of(class).len() > most {
            let problem = format!(
                "has {} of what becomes {}, and the gateware has {most}",
                draft.board.of(class).len(),
                class.key()
            );
            return Err(at.error(
                "modules",
                "",
                problem,
                "take some away, or spread the machine over two boards",
            ));
        }
    }
    draft.notes.push("Such a file has no external reset pin, so the board file has none: write `ext_reset` if the machine has one.".to_owned());
    let head = format!(
        "Imported from LiteX-CNC. `names=litexcnc:{board_name}` gives the channels their old HAL names, by number; `names=litexcnc-named:{board_name}` those with a name by it (docs/migration.md)."
    );
    draft.finish(head)
}

/// The key of a module's instances: one of two.
fn instances(module: &At<'_>) -> Result<&'static str, Error> {
    match (module.any("instances"), module.any("instance")) {
        (Some(_), None) => Ok("instances"),
        (None, Some(_)) => Ok("instance"),
        (Some(_), Some(_)) => Err(module.error(
            "instance",
            "",
            "is there beside instances",
            "leave one of the two, with all of them",
        )),
        (None, None) => {
            Err(module.error("instances", "", "is missing", "write a list of instances"))
        }
    }
}

fn network(draft: &mut Draft<'_>, file: &str, at: &At<'_>) -> Result<(), Error> {
    let connection = match at.nodes("connection")?.as_slice() {
        [] => None,
        [one] => Some(At::new(file, &at.key("connection"), one, CONNECTION)?),
        more => {
            let problem = format!("has {} connections", more.len());
            return Err(at.error(
                "connection",
                "",
                problem,
                "leave the one Ethernet connection",
            ));
        }
    };
    let both = match (connection, at.table("etherbone")?) {
        (Some(_), Some(_)) => {
            return Err(at.error(
                "etherbone",
                "",
                "is there beside connection",
                "leave connection, the newer of the two",
            ));
        }
        (None, None) => {
            return Err(at.error(
                "connection",
                "",
                "is missing",
                "write it, with connection_type, ip_address and mac_address",
            ));
        }
        (Some(connection), None) => connection,
        (None, Some(etherbone)) => etherbone,
    };
    let text = both.text("ip_address").unwrap_or("192.168.0.50");
    let address: std::net::Ipv4Addr = text.parse().map_err(|_| {
        both.error(
            "ip_address",
            &format!("{text:?}"),
            "is not an IPv4 address",
            "write it as in \"192.168.0.50\"",
        )
    })?;
    draft.board.ipv4 = address.octets();
    draft.origin(
        "network.ipv4",
        &both.key("ip_address"),
        both.place("ip_address"),
    );
    let text = both.text("mac_address").unwrap_or_default();
    draft.board.mac = Some(mac(text).ok_or_else(|| {
        both.error(
            "mac_address",
            &format!("{text:?}"),
            "is not a MAC address",
            "write it as in \"0x10e2d5000000\"",
        )
    })?);
    draft.origin(
        "network.mac",
        &both.key("mac_address"),
        both.place("mac_address"),
    );
    let phy = at.table("ethphy")?;
    for table in [Some(&both), phy.as_ref()].into_iter().flatten() {
        for key in ["tx_delay", "rx_delay"] {
            if let Some(delay) = table.shown_if(key).filter(|delay| delay.parse() != Ok(0.0)) {
                draft.notes.push(format!("{} = {delay} has no counterpart: the PHY of these boards delays its clocks itself.", table.key(key)));
            }
        }
        if table.flag_if("with_hw_init_reset") == Some(true) {
            draft.notes.push(format!("{} has no counterpart: the PHYs' reset also stops the FPGA's clock, and nothing here ever drives it.", table.key("with_hw_init_reset")));
        }
    }
    Ok(())
}

fn watchdog(draft: &mut Draft<'_>, at: &At<'_>) -> Result<(), Error> {
    let mut outputs: Vec<(At<'_>, bool, &str)> = Vec::new();
    if at.text("pin").is_some() {
        outputs.push((at.clone(), false, "watchdog"));
    }
    for function in at.tables("functions")? {
        let invert = function.flag("invert_output").unwrap_or(false);
        let name = function.text("function_type").unwrap_or_default();
        let name = if name == "enable" { "watchdog" } else { name };
        if name == "heartbeat" {
            let note = format!(
                "{}: there is no core for a heartbeat's waveform; the pin is an output \"heartbeat\", low until HAL drives it.",
                function.key("")
            );
            draft.notes.push(note);
        }
        outputs.push((function, invert, name));
    }
    for (table, invert, name) in outputs {
        let pin = table.text("pin").unwrap_or_default();
        let mut output = Channel::new(
            Class::Output,
            String::new(),
            vec![("pin", self::pin(&table, "pin", pin)?)],
        );
        output.invert = invert;
        output.safe = Some(if invert { Level::High } else { Level::Low });
        draft.push(
            Class::Output,
            Some(name),
            output,
            table.key(""),
            table.place("pin"),
        );
        if name == "watchdog" {
            draft.notes.push(format!("{}: the watchdog's enable pin is an output \"watchdog\", which the gateware makes safe when the watchdog bites; let HAL drive it: net watchdog ferrocnc.0.enabled => ferrocnc.0.gpio.watchdog.out", table.key("pin")));
        }
    }
    for (n, estop) in at.tables("estop")?.into_iter().enumerate() {
        let pin = estop.text("pin").unwrap_or_default();
        let mut input = Channel::new(
            Class::Input,
            String::new(),
            vec![("pin", self::pin(&estop, "pin", pin)?)],
        );
        input.estop = Some(if estop.flag("trigger") == Some(true) {
            Level::High
        } else {
            Level::Low
        });
        let numbered = format!("estop-{n:02}");
        draft.push(
            Class::Input,
            Some(estop.text("name").unwrap_or(&numbered)),
            input,
            estop.key(""),
            estop.place("pin"),
        );
    }
    Ok(())
}

fn gpio(draft: &mut Draft<'_>, at: &At<'_>, row: usize) -> Result<(), Error> {
    let class = if at.text("direction") == Some("in") {
        Class::Input
    } else {
        Class::Output
    };
    let mut one = Channel::new(
        class,
        String::new(),
        vec![("pin", pin(at, "pin", at.text("pin").unwrap_or_default())?)],
    );
    // More than 64 are refused behind this by their count.
    one.litexcnc = u8::try_from(row).ok();
    match (class, at.flag("safe_state")) {
        (Class::Input, Some(_)) => {
            return Err(at.error(
                "safe_state",
                "",
                "has no meaning for an input",
                "take it away",
            ));
        }
        (_, Some(true)) => one.safe = Some(Level::High),
        _ => {}
    }
    instance(draft, class, at, one)
}

fn pwm(draft: &mut Draft<'_>, at: &At<'_>) -> Result<(), Error> {
    let (mut kind, mut pins) = ("pwm", Vec::new());
    match (at.text("pin"), at.table("pins")?) {
        (Some(name), None) => pins.push(("pin", pin(at, "pin", name)?)),
        (None, Some(table)) => {
            let wanted: &[(&str, &str)] = match table.text("output_type") {
                None | Some("single") => &[("pwm", "pin")],
                Some("pwmdirection") => &[("pwm", "pin"), ("direction", "dir")],
                _ => {
                    kind = "up_down";
                    &[("up", "pin"), ("down", "dir")]
                }
            };
            pins = taken(&table, wanted, &["pwm", "direction", "up", "down"])?;
        }
        (Some(_), Some(_)) => {
            return Err(at.error(
                "pins",
                "",
                "is there beside pin",
                "leave pins, the newer of the two",
            ));
        }
        (None, None) => {
            return Err(at.error(
                "pins",
                "",
                "is missing",
                "write it, as in { \"output_type\": \"single\", \"pwm\": \"j1:0\" }",
            ));
        }
    }
    let mut one = Channel::new(Class::Pwm, String::new(), pins);
    kind.clone_into(&mut one.kind);
    instance(draft, Class::Pwm, at, one)
}

fn encoder(draft: &mut Draft<'_>, at: &At<'_>) -> Result<(), Error> {
    let mut pins = vec![("a", pin(at, "pin_A", at.text("pin_A").unwrap_or_default())?)];
    for (theirs, ours) in [("pin_B", "b"), ("pin_Z", "index")] {
        if let Some(name) = at.text(theirs) {
            pins.push((ours, pin(at, theirs, name)?));
        }
    }
    if at.text("pin_B").is_none() && at.text("pin_Z").is_some() {
        return Err(at.error(
            "pin_Z",
            "",
            "is there without pin_B",
            "write pin_B: a counter has no index",
        ));
    }
    for key in ["min_value", "max_value", "reset_value"] {
        if let Some(value) = at
            .integer(key)
            .filter(|value| key != "reset_value" || *value != 0)
        {
            draft.notes.push(format!("{} = {value} has no counterpart: our counts are never limited or preset; do it in HAL.", at.key(key)));
        }
    }
    let mut one = Channel::new(Class::Encoder, String::new(), pins);
    if at.text("pin_B").is_none() {
        "counter".clone_into(&mut one.kind);
    }
    instance(draft, Class::Encoder, at, one)
}

fn stepgen(draft: &mut Draft<'_>, at: &At<'_>) -> Result<(), Error> {
    let Some(table) = at.table("pins")? else {
        return Ok(());
    };
    let all = [
        "step_pin",
        "dir_pin",
        "step_pos_pin",
        "step_neg_pin",
        "dir_pos_pin",
        "dir_neg_pin",
    ];
    let wanted: &[(&str, &str)] = match table.text("stepgen_type") {
        Some("step_dir") => &[("step_pin", "step"), ("dir_pin", "dir")],
        _ => &[
            ("step_pos_pin", "step"),
            ("step_neg_pin", "step_n"),
            ("dir_pos_pin", "dir"),
            ("dir_neg_pin", "dir_n"),
        ],
    };
    let mut pins = taken(&table, wanted, &all)?;
    if let Some(name) = table.text("index_pin") {
        pins.push(("index", pin(&table, "index_pin", name)?));
    }
    if at.flag("soft_stop") != Some(true) {
        draft.hard_stops.push(at.key(""));
    }
    instance(
        draft,
        Class::Stepgen,
        at,
        Channel::new(Class::Stepgen, String::new(), pins),
    )
}

/// The pins a type has, all of them, and none of another type's.
fn taken(
    table: &At<'_>,
    wanted: &[(&'static str, &'static str)],
    all: &[&str],
) -> Result<Vec<(&'static str, String)>, Error> {
    let mut pins = Vec::new();
    for (theirs, ours) in wanted {
        let name = table
            .text(theirs)
            .ok_or_else(|| table.error(theirs, "", "is missing", format!("write {PIN}")))?;
        pins.push((*ours, pin(table, theirs, name)?));
    }
    match all
        .iter()
        .find(|key| table.text(key).is_some() && !wanted.iter().any(|(theirs, _)| theirs == *key))
    {
        Some(other) => Err(table.error(
            other,
            "",
            "is a pin this type does not have",
            "take it away, or correct the type",
        )),
        None => Ok(pins),
    }
}

/// The name of a pin of theirs; the button is one.
fn pin(at: &At<'_>, key: &str, name: &str) -> Result<String, Error> {
    match name.strip_suffix(":0").unwrap_or(name) {
        "user_btn" | "user_btn_n" => Ok("key".to_owned()),
        "user_led" | "user_led_n" => Err(at.error(
            key,
            &format!("{name:?}"),
            "is the LED, which shows the board's state here",
            "take it away, or use a header's pin",
        )),
        _ => Ok(name.to_owned()),
    }
}

fn push(draft: &mut Draft<'_>, class: Class, at: &At<'_>, channel: Channel) {
    draft.push(class, at.text("name"), channel, at.key(""), at.place(""));
}

/// Adds an instance of a module, which keeps the name it was given.
fn instance(
    draft: &mut Draft<'_>,
    class: Class,
    at: &At<'_>,
    mut channel: Channel,
) -> Result<(), Error> {
    if let Some(name) = at.text("name") {
        channel.litexcnc_name = named(draft, class, at, name)?;
    }
    push(draft, class, at, channel);
    Ok(())
}

/// The name as a HAL file has it; nothing if none can.
fn named(
    draft: &mut Draft<'_>,
    class: Class,
    at: &At<'_>,
    name: &str,
) -> Result<Option<String>, Error> {
    let wrong = |problem: String, remedy: &str| {
        Err(at.error("name", &format!("{name:?}"), problem, remedy))
    };
    if name.bytes().all(|b| b.is_ascii_digit()) {
        return wrong(
            "is a number, which other channels are called by".to_owned(),
            "give it a letter, here and in the HAL file",
        );
    }
    if !wire::board::is_foreign_name(name) {
        draft.notes.push(format!("{}: no HAL file can contain the name {name:?}, so `names=litexcnc-named` calls the channel by its number.", at.key("")));
        return Ok(None);
    }
    let pin = class.hal().litexcnc_pin(&draft.prefix, name);
    if pin.len() > HAL_NAME_LEN {
        let problem = format!(
            "is too long: HAL takes {HAL_NAME_LEN} characters and {pin} has {}",
            pin.len()
        );
        return wrong(
            problem,
            "shorten it or board_name, here and in the HAL file",
        );
    }
    let others = draft.board.of(class);
    match others
        .iter()
        .position(|other| other.litexcnc_name.as_deref() == Some(name))
    {
        Some(other) => wrong(
            format!(
                "is already that of {} {other} (counted from 0)",
                class.key()
            ),
            "give every channel a name of its own, here and in the HAL file",
        ),
        None => Ok(Some(name.to_owned())),
    }
}

impl<'n> At<'n> {
    /// The elements of a list, or a lone table as the one element.
    fn nodes(&self, name: &str) -> Result<Vec<&'n Node>, Error> {
        match self.any(name) {
            None => Ok(Vec::new()),
            Some(Node {
                value: Value::List(nodes),
                ..
            }) => Ok(nodes.iter().collect()),
            Some(
                node @ Node {
                    value: Value::Table(_),
                    ..
                },
            ) if name == "connection" => Ok(vec![node]),
            Some(node) => Err(self.error(
                name,
                &node.value.show(),
                "is not a list",
                "write a list of tables, [ { ... } ]",
            )),
        }
    }
}
