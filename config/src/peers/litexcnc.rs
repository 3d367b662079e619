//! LiteX-CNC's JSON, of 1.3.

use super::{Way, Written, pin};
use crate::board::{Board, Channel, Class};
use crate::error::Error;
use crate::platform::Level;
use serde_json::{Map, Value, json};
use std::net::Ipv4Addr;

/// The cards of 1.3.4, and the platforms.
const CARDS: [(&str, &str); 5] = [
    ("5a-75b-6.1", "5A-75B v6.1"),
    ("5a-75b-7.0", "5A-75B v7.0"),
    ("5a-75b-8.0", "5A-75B v8.0"),
    ("5a-75e-6.0", "5A-75E v6.0"),
    ("5a-75e-7.1", "5A-75E v7.1"),
];
/// Its driver has room for 15 characters and a zero.
const NAME_MAX: usize = 15;
/// 40 MHz: what its manual recommends.
const CLOCK_HZ: u32 = 40_000_000;

/// Writes a board as LiteX-CNC's configuration, or says all that cannot be said in it.
pub fn litexcnc(board: &Board) -> Result<Written, Vec<Error>> {
    let mut way = Way::new(board, "LiteX-CNC");
    let card = card(&mut way);
    network(&mut way);
    way.ours_alone();
    let (functions, estops) = watchdog(&mut way);
    let mut modules = Vec::new();
    let mut module = |kind: &str, instances: Vec<Value>| {
        if !instances.is_empty() {
            modules.push(json!({ "module_type": kind, "instances": instances }));
        }
    };
    module("gpio", gpio(&mut way));
    let kinds: [(&str, Class, Instance); 3] = [
        ("pwm", Class::Pwm, pwm),
        ("encoder", Class::Encoder, encoder),
        ("stepgen", Class::Stepgen, stepgen),
    ];
    for (kind, class, instance) in kinds {
        let instances = (0..board.of(class).len()).map(|n| instance(&mut way, n));
        module(kind, instances.collect());
    }
    let json = json!({
        "board_name": board.name,
        "board_type": card,
        "clock_frequency": CLOCK_HZ,
        "connection": [{
            "connection_type": "etherbone",
            "ip_address": Ipv4Addr::from(board.ipv4).to_string(),
            "mac_address": way.mac(),
        }],
        "watchdog": { "functions": functions, "estop": estops },
        "modules": modules,
    });
    way.note(format!(
        "Its HAL names begin with {}, the board file's name.",
        board.name
    ));
    way.note("Its step generators stop with soft_stop, as ours do.".to_owned());
    way.finish(format!("{json:#}\n"))
}

/// A channel as an instance of a module.
type Instance = fn(&mut Way<'_>, usize) -> Value;

fn card(way: &mut Way<'_>) -> &'static str {
    let name = &way.board.platform.name;
    match CARDS.iter().find(|(platform, _)| platform == name) {
        Some((_, card)) => card,
        None => {
            let known: Vec<&str> = CARDS.iter().map(|(platform, _)| *platform).collect();
            let known = format!("it knows {}", known.join(", "));
            way.refuse("platform", name, "it does not know the card", &known);
            ""
        }
    }
}

fn network(way: &mut Way<'_>) {
    let board = way.board;
    let word = |b: u8| b.is_ascii_alphanumeric() || b == b'-' || b == b'_';
    if board.name.len() > NAME_MAX || !board.name.bytes().all(word) {
        let why = format!("its boards have names of letters, digits, - and _, at most {NAME_MAX}");
        way.refuse("name", &board.name, &why, "give the file a shorter name");
    }
    if let Some(pin) = &board.ext_reset.pin {
        way.refuse(
            "ext_reset.pin",
            pin,
            "it has no reset pin",
            "write the pin as a [[gpio_in]] with estop, and ext_reset with pin = \"none\"",
        );
    }
    if board.phy != 0 {
        way.refuse(
            "phy",
            &board.phy.to_string(),
            "it uses the first jack",
            "write 0, and use the other jack",
        );
    }
    if board.udp_port != wire::DEFAULT_PORT {
        way.refuse(
            "network.udp_port",
            &board.udp_port.to_string(),
            "its boards listen at 1234",
            "write 1234",
        );
    }
}

/// Whether an output is what an import makes of a function of the watchdog.
fn function(channel: &Channel) -> Option<&'static str> {
    match channel.name.as_str() {
        _ if channel.litexcnc.is_some() => None,
        "watchdog" => Some("enable"),
        "heartbeat" => Some("heartbeat"),
        _ => None,
    }
}

/// The watchdog's functions and the emergency stops.
fn watchdog(way: &mut Way<'_>) -> (Vec<Value>, Vec<Value>) {
    let (mut functions, mut estops) = (Vec::new(), Vec::new());
    let board = way.board;
    for (n, channel) in board.of(Class::Output).iter().enumerate() {
        let Some(function) = function(channel) else {
            continue;
        };
        way.only(Class::Output, n, &[], &["pin"]);
        // While the watchdog has bitten, the pin is what `false` makes of it.
        if (channel.safe == Some(Level::High)) != channel.invert {
            way.refuse(
                &format!("gpio_out[{n}].safe"),
                channel.safe.map_or("", Level::word),
                "a function of its watchdog rests at its inactive level",
                "write \"high\" with invert = true, or \"low\" without",
            );
        }
        functions.push(json!({
            "function_type": function, "pin": pin(channel, "pin"), "invert_output": channel.invert,
        }));
    }
    for (n, channel) in board.of(Class::Input).iter().enumerate() {
        let Some(level) = channel.estop else {
            continue;
        };
        way.only(Class::Input, n, &[], &["pin"]);
        if let Some(number) = channel.litexcnc {
            way.refuse(
                &format!("gpio_in[{n}].litexcnc"),
                &number.to_string(),
                "its e-stops are not in the row of inputs and outputs",
                "take litexcnc away",
            );
        }
        let mut estop = Map::new();
        estop.insert("pin".to_owned(), json!(button(pin(channel, "pin"))));
        estop.insert("trigger".to_owned(), json!(level == Level::High));
        if channel.name != format!("estop-{:02}", estops.len()) {
            estop.insert("name".to_owned(), json!(channel.name));
        }
        estops.push(Value::Object(estop));
    }
    (functions, estops)
}

/// Inputs and outputs in one row, by their numbers in it; those without one are behind the others.
fn gpio(way: &mut Way<'_>) -> Vec<Value> {
    let board = way.board;
    let mut row: Vec<(u8, Class, usize)> = Vec::new();
    for class in [Class::Input, Class::Output] {
        for (n, channel) in board.of(class).iter().enumerate() {
            if channel.estop.is_none() && function(channel).is_none() {
                row.push((channel.litexcnc.unwrap_or(u8::MAX), class, n));
            }
        }
    }
    // Stable: inputs before outputs, each in their order, where no number says another.
    row.sort_by_key(|(number, _, _)| *number);
    let mut instances = Vec::new();
    for (place, (number, class, n)) in row.into_iter().enumerate() {
        let channel = &board.of(class)[n];
        let key = format!("{}[{n}]", class.key());
        if number != u8::MAX && usize::from(number) != place {
            way.refuse(
                &format!("{key}.litexcnc"),
                &number.to_string(),
                &format!("its row has no gaps, and this one would be {place}"),
                "number them without gaps, from 0",
            );
        }
        way.only(class, n, &[], &["pin"]);
        if channel.invert {
            way.refuse(
                &format!("{key}.invert"),
                "true",
                "only HAL inverts there",
                "take it away, and set gpio.NN.invert-output in HAL",
            );
        }
        let mut instance = Map::new();
        let (direction, pin) = match class {
            Class::Input => ("in", button(pin(channel, "pin"))),
            _ => ("out", pin(channel, "pin").to_owned()),
        };
        instance.insert("direction".to_owned(), json!(direction));
        instance.insert("pin".to_owned(), json!(pin));
        if channel.safe == Some(Level::High) {
            instance.insert("safe_state".to_owned(), json!(true));
        }
        instances.push(named(way, instance, class, n));
    }
    instances
}

fn pwm(way: &mut Way<'_>, n: usize) -> Value {
    way.only(Class::Pwm, n, &["pwm", "up_down"], &["pin", "dir"]);
    let channel = &way.board.of(Class::Pwm)[n];
    let (first, second) = (pin(channel, "pin"), pin(channel, "dir"));
    let pins = match (channel.kind.as_str(), channel.pin("dir")) {
        ("up_down", _) => json!({ "output_type": "updown", "up": first, "down": second }),
        (_, Some(_)) => {
            json!({ "output_type": "pwmdirection", "pwm": first, "direction": second })
        }
        (_, None) => json!({ "output_type": "single", "pwm": first }),
    };
    let instance = Map::from_iter([("pins".to_owned(), pins)]);
    named(way, instance, Class::Pwm, n)
}

fn encoder(way: &mut Way<'_>, n: usize) -> Value {
    let kinds = ["quadrature", "counter"];
    way.only(Class::Encoder, n, &kinds, &["a", "b", "index"]);
    no_button(way, Class::Encoder, n);
    let channel = &way.board.of(Class::Encoder)[n];
    if channel.kind == "counter"
        && let Some(index) = channel.pin("index")
    {
        way.refuse(
            &format!("encoder[{n}].index"),
            index,
            "its counters have no index",
            "take it away",
        );
    }
    let pins = [("a", "pin_A"), ("b", "pin_B"), ("index", "pin_Z")];
    let pins = pins.into_iter().filter_map(|(ours, theirs)| {
        let name = channel.pin(ours)?;
        Some((theirs.to_owned(), json!(name)))
    });
    named(way, pins.collect(), Class::Encoder, n)
}

fn stepgen(way: &mut Way<'_>, n: usize) -> Value {
    let pins = ["step", "step_n", "dir", "dir_n", "index"];
    way.only(Class::Stepgen, n, &["step_dir"], &pins);
    no_button(way, Class::Stepgen, n);
    let channel = &way.board.of(Class::Stepgen)[n];
    let wanted: &[(&str, &str)] = match (channel.pin("step_n"), channel.pin("dir_n")) {
        (None, None) => &[("step", "step_pin"), ("dir", "dir_pin")],
        (Some(_), Some(_)) => &[
            ("step", "step_pos_pin"),
            ("step_n", "step_neg_pin"),
            ("dir", "dir_pos_pin"),
            ("dir_n", "dir_neg_pin"),
        ],
        (step_n, _) => {
            let missing = if step_n.is_some() { "dir_n" } else { "step_n" };
            way.refuse(
                &format!("stepgen[{n}].{missing}"),
                "",
                "both of its lines are differential, or none",
                "write it too, or take the other away",
            );
            &[]
        }
    };
    let kind = match wanted.len() {
        2 => "step_dir",
        _ => "step_dir_differential",
    };
    let mut pins = Map::from_iter([("stepgen_type".to_owned(), json!(kind))]);
    for (ours, theirs) in wanted {
        pins.insert((*theirs).to_owned(), json!(pin(channel, ours)));
    }
    if let Some(index) = channel.pin("index") {
        pins.insert("index_pin".to_owned(), json!(index));
    }
    let instance = [
        ("pins".to_owned(), Value::Object(pins)),
        ("soft_stop".to_owned(), json!(true)),
    ];
    named(way, Map::from_iter(instance), Class::Stepgen, n)
}

/// Only inputs and e-stops may be the button there.
fn no_button(way: &mut Way<'_>, class: Class, n: usize) {
    let pins = way.board.of(class)[n].pins.iter();
    if let Some((key, _)) = pins.clone().find(|(_, pin)| pin == "key") {
        way.refuse(
            &format!("{}[{n}].{key}", class.key()),
            "key",
            "only inputs may be the button",
            "write a pin of a header",
        );
    }
}

/// Adds the name it had there, or ours if it is more than a number.
fn named(way: &mut Way<'_>, mut instance: Map<String, Value>, class: Class, n: usize) -> Value {
    let channel = &way.board.of(class)[n];
    let own = Some(&channel.name).filter(|name| **name != class.numbered(n));
    if let Some(name) = channel.litexcnc_name.as_ref().or(own) {
        instance.insert("name".to_owned(), json!(name));
        let pin = class.hal().litexcnc_pin(&way.board.name, name);
        if pin.len() > wire::board::HAL_NAME_LEN {
            let why = format!(
                "HAL takes {} characters and {pin} has {}",
                wire::board::HAL_NAME_LEN,
                pin.len()
            );
            let key = format!("{}[{n}].name", class.key());
            way.refuse(&key, name, &why, "shorten it, or the name of the file");
        }
    }
    Value::Object(instance)
}

fn button(pin: &str) -> String {
    match pin {
        "key" => "user_btn:0".to_owned(),
        pin => pin.to_owned(),
    }
}
