//! The drawing for the terminal: a header of eight rows, two headers beside each other where there
//! is room.

use super::{Header, Pin, Pinout, Use};
use std::fmt::Write;

/// A header's width: label, pin name, pin, and the same on the other side.
const SIDE: usize = 18;
const WIDTH: usize = 2 * (SIDE + 1 + NAME + 1) + 13;
const NAME: usize = 6;

/// The foreground colour of a use, as terminals count them.
fn colour(usage: Use) -> u8 {
    match usage {
        Use::Stepgen => 34,
        Use::Encoder => 32,
        Use::Pwm => 33,
        Use::Input => 36,
        Use::Output => 35,
        Use::Stop => 31,
        Use::Factory => 93,
        Use::Free | Use::Ground => 90,
    }
}

/// Draws it, `width` characters wide, with colour or without.
pub fn terminal(pinout: &Pinout, width: usize, coloured: bool) -> String {
    let paint = |usage: Use, bold: bool, text: &str| match coloured {
        true => format!(
            "\u{1b}[{}{}m{text}\u{1b}[0m",
            if bold { "1;" } else { "" },
            colour(usage)
        ),
        false => text.to_owned(),
    };
    let mut out = format!("{}\n{}\n\n", pinout.title, pinout.facts);
    let beside = (width / (WIDTH + 2)).max(1);
    for headers in pinout.headers.chunks(beside) {
        let drawn: Vec<Vec<(String, usize)>> =
            headers.iter().map(|header| draw(header, &paint)).collect();
        for row in 0..9 {
            let mut line = String::new();
            for header in &drawn {
                let (text, length) = &header[row];
                line += text;
                line += &" ".repeat((WIDTH + 2).saturating_sub(*length));
            }
            let _ = writeln!(out, "{}", line.trim_end());
        }
        out.push('\n');
    }
    let (usage, label) = &pinout.key;
    let label = if label.is_empty() { "free" } else { label };
    let _ = writeln!(out, "KEY (button): {}\n", paint(*usage, true, label));
    let legend: Vec<String> = pinout
        .uses()
        .map(|usage| {
            format!(
                "{} {}",
                paint(usage, true, &usage.letter().to_string()),
                usage.title()
            )
        })
        .collect();
    let _ = writeln!(
        out,
        "{}   * the same line on every header",
        legend.join("   ")
    );
    out += "From above, pin 1 at the top left; pins count from 0, the silk screen from 1.\n";
    out
}

/// Nine lines and their lengths without colour.
fn draw(header: &Header, paint: &dyn Fn(Use, bool, &str) -> String) -> Vec<(String, usize)> {
    let title = match header.modified.as_str() {
        "" => header.name.to_uppercase(),
        modified => format!("{}  {modified}", header.name.to_uppercase()),
    };
    let padded = format!(
        "{:>at$}{title}",
        "",
        at = (WIDTH.saturating_sub(title.chars().count())) / 2
    );
    let mut lines = vec![(padded.clone(), padded.chars().count())];
    for pair in header.pins.chunks(2) {
        let [left, right] = pair else { continue };
        let text = format!(
            "{} {} \u{2502}{} {} {}\u{2502} {} {}",
            label(left, paint, true),
            number(header, left, true),
            star(left),
            paint(left.usage, true, &left.usage.letter().to_string()),
            paint(right.usage, true, &right.usage.letter().to_string()) + &star(right),
            number(header, right, false),
            label(right, paint, false),
        );
        lines.push((text, WIDTH - 4));
    }
    lines
}

fn star(pin: &Pin) -> String {
    if pin.shared { "*" } else { " " }.to_owned()
}

fn number(header: &Header, pin: &Pin, left: bool) -> String {
    let name = match pin.usage {
        Use::Ground => String::new(),
        _ => format!("{}:{}", header.name, pin.index),
    };
    if left {
        format!("{name:>NAME$}")
    } else {
        format!("{name:<NAME$}")
    }
}

fn label(pin: &Pin, paint: &dyn Fn(Use, bool, &str) -> String, left: bool) -> String {
    let full = match (&pin.same_as, pin.usage) {
        (Some(same), _) => format!("= {same}"),
        (None, Use::Free) => pin.panel.to_lowercase(),
        (None, _) => pin.label.clone(),
    };
    let mut shown: String = full.chars().take(SIDE).collect();
    if full.chars().count() > SIDE {
        shown.pop();
        shown.push('\u{2026}');
    }
    let pad = " ".repeat(SIDE - shown.chars().count());
    let shown = paint(
        pin.usage,
        pin.same_as.is_none() && pin.usage != Use::Free,
        &shown,
    );
    if left { pad + &shown } else { shown + &pad }
}
