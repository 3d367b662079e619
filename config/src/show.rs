//! A configuration as a table: every channel with its HAL name, its pins, and where on the header
//! they are.

use crate::board::{Board, Class, ControlInput};
use crate::platform::{HEADER, Platform, Role, split};
use std::fmt::Write;

/// The table.
pub fn show(board: &Board) -> String {
    let platform = &board.platform;
    let [a, b, c, d] = board.ipv4;
    let mac = match board.mac {
        Some(mac) => mac.map(|byte| format!("{byte:02x}")).join(":"),
        None => "made of the flash's serial number".to_owned(),
    };
    let mut out = format!(
        "{} on {} ({}, {})\n\n  clock      {} MHz\n  address    {a}.{b}.{c}.{d}, UDP port {}, PHY {}\n  MAC        {mac}\n",
        board.name,
        platform.title,
        platform.name,
        platform.device,
        f64::from(board.sys_clk_hz) / 1e6,
        board.udp_port,
        board.phy,
    );
    let _ = writeln!(
        out,
        "  reset      {}",
        line(platform, Some(&board.ext_reset))
    );
    let _ = writeln!(
        out,
        "  factory    {}",
        line(platform, board.factory.as_ref())
    );
    for (what, headers) in [
        ("bus switch", &board.modified.bus_switch),
        ("inputs", &board.modified.inputs),
    ] {
        if !headers.is_empty() {
            let _ = writeln!(out, "  {what:<10} {}", headers.join(", "));
        }
    }
    for class in Class::ALL {
        let channels = board.of(class);
        if channels.is_empty() {
            continue;
        }
        let _ = write!(out, "\n{} ({})\n", class.key(), channels.len());
        for (n, channel) in channels.iter().enumerate() {
            let name = format!("{}.{}", class.hal().class, channel.name);
            let mut said = vec![format!("  {n:>2}  {name:<27}")];
            if class
                .types()
                .first()
                .is_some_and(|meant| *meant != channel.kind)
            {
                said.push(format!("type {}", channel.kind));
            }
            said.extend(channel.pins.iter().map(|(key, pin)| {
                let key = if *key == "pin" {
                    String::new()
                } else {
                    format!("{key} ")
                };
                format!("{key}{}", place(platform, pin))
            }));
            said.extend(
                channel
                    .estop
                    .map(|level| format!("stops if {}", level.word())),
            );
            said.extend(channel.safe.map(|level| format!("safe {}", level.word())));
            said.extend(channel.invert.then(|| "inverted".to_owned()));
            said.extend(
                channel
                    .litexcnc
                    .map(|number| format!("gpio.{number:02} of LiteX-CNC")),
            );
            let _ = writeln!(out, "{}", said.join("  ").trim_end());
        }
    }
    out
}

fn line(platform: &Platform, line: Option<&ControlInput>) -> String {
    match line {
        Some(ControlInput {
            pin: Some(pin),
            active,
        }) => format!("{} if {}", place(platform, pin), active.word()),
        _ => "none".to_owned(),
    }
}

/// `j1:7 (E, pin 8, N4)`.
pub(crate) fn place(platform: &Platform, pin: &str) -> String {
    let Some((role, ball)) = platform.pin(pin) else {
        return pin.to_owned();
    };
    let ball = ball.unwrap_or("-");
    match (role, split(pin)) {
        (Role::Key, _) | (_, None) => format!("{pin} (button, {ball})"),
        (_, Some((_, index))) => format!(
            "{pin} ({}, pin {}, {ball})",
            HEADER.get(index).unwrap_or(&"?"),
            index + 1
        ),
    }
}
