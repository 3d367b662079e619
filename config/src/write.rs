//! A configuration as TOML, in the form of a file written by hand.

use crate::board::{Board, Channel, Class, ControlInput};
use crate::platform::Level;
use std::fmt::Write;

/// Writes a board file. `notes` go to its head as comments, a paragraph each.
pub fn to_toml(board: &Board, notes: &[String]) -> String {
    let mut out = String::from("#:schema board.schema.json\n");
    for (n, note) in notes.iter().enumerate() {
        out += if n == 0 { "" } else { "#\n" };
        for line in wrap(note, 100) {
            let _ = writeln!(out, "# {line}");
        }
    }
    let _ = write!(
        out,
        "\nname = {}\nplatform = {}\nsys_clk_hz = {}\n",
        quoted(&board.name),
        quoted(&board.platform.name),
        grouped(board.sys_clk_hz)
    );
    if board.phy != 0 {
        let _ = writeln!(out, "phy = {}", board.phy);
    }
    let _ = writeln!(out, "ext_reset = {}", line(&board.ext_reset));
    if let Some(factory) = &board.factory {
        let _ = writeln!(out, "factory = {}", line(factory));
    }
    if board.jobs != 0 {
        let _ = writeln!(out, "jobs = {}", board.jobs);
    }
    if !board.sdram && (board.platform.sdram.is_some() || board.jobs != 0) {
        let _ = writeln!(out, "sdram = false");
    }
    let modified = &board.modified;
    if *modified != Default::default() {
        out += "\n[modified]\n";
        for (key, headers) in [
            ("bus_switch", &modified.bus_switch),
            ("inputs", &modified.inputs),
        ] {
            if !headers.is_empty() {
                let headers: Vec<String> = headers.iter().map(|header| quoted(header)).collect();
                let _ = writeln!(out, "{key} = [{}]", headers.join(", "));
            }
        }
    }
    out += "\n[network]\n";
    if let Some(mac) = board.mac {
        let bytes: Vec<String> = mac.iter().map(|byte| format!("{byte:02x}")).collect();
        let _ = writeln!(out, "mac = \"{}\"", bytes.join(":"));
    }
    let [a, b, c, d] = board.ipv4;
    let _ = write!(
        out,
        "ipv4 = \"{a}.{b}.{c}.{d}\"\nudp_port = {}\n",
        board.udp_port
    );
    for class in Class::ALL {
        for one in board.of(class) {
            channel(&mut out, class, one);
        }
    }
    out
}

/// Adds the table of one channel.
pub fn channel(out: &mut String, class: Class, channel: &Channel) {
    let _ = write!(
        out,
        "\n[[{}]]\nname = {}\n",
        class.key(),
        quoted(&channel.name)
    );
    if class
        .types()
        .first()
        .is_some_and(|meant| *meant != channel.kind)
    {
        let _ = writeln!(out, "type = {}", quoted(&channel.kind));
    }
    for (key, pin) in &channel.pins {
        let _ = writeln!(out, "{key} = {}", quoted(pin));
    }
    for (key, level) in [("estop", channel.estop), ("safe", channel.safe)] {
        if let Some(level) = level {
            let _ = writeln!(out, "{key} = \"{}\"", level.word());
        }
    }
    if channel.invert {
        *out += "invert = true\n";
    }
    if let Some(number) = channel.litexcnc {
        let _ = writeln!(out, "litexcnc = {number}");
    }
    if let Some(name) = &channel.litexcnc_name {
        let _ = writeln!(out, "litexcnc_name = {}", quoted(name));
    }
}

fn line(line: &ControlInput) -> String {
    let pin = line.pin.as_deref().unwrap_or("none");
    format!(
        "{{ pin = {}, active = \"{}\" }}",
        quoted(pin),
        Level::word(line.active)
    )
}

/// A TOML basic string.
fn quoted(text: &str) -> String {
    let mut out = String::from('"');
    for c in text.chars() {
        match c {
            '"' | '\\' => out.extend(['\\', c]),
            c if c.is_control() => {
                let _ = write!(out, "\\u{:04X}", c as u32);
            }
            c => out.push(c),
        }
    }
    out + "\""
}

/// 60_000_000.
fn grouped(number: u32) -> String {
    let digits = number.to_string();
    let mut out = String::new();
    for (n, digit) in digits.chars().enumerate() {
        if n > 0 && (digits.len() - n).is_multiple_of(3) {
            out.push('_');
        }
        out.push(digit);
    }
    out
}

fn wrap(text: &str, width: usize) -> Vec<String> {
    let mut lines = vec![String::new()];
    for word in text.split_whitespace() {
        let full = lines
            .last()
            .is_some_and(|line| !line.is_empty() && line.len() + 1 + word.len() > width);
        if full {
            lines.push(String::new());
        }
        if let Some(line) = lines.last_mut() {
            if !line.is_empty() {
                line.push(' ');
            }
            *line += word;
        }
    }
    lines
}
