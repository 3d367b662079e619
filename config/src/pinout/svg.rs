//! The drawing for paper and browsers. Plain SVG 1.1, no script, no outside font: it prints, and
//! any program shows it.

use super::{Header, Pin, Pinout, Use};
use std::fmt::Write;

const COLUMNS: usize = 4;
/// A header's card.
const CARD: (f64, f64) = (396.0, 296.0);
const GAP: f64 = 20.0;
const MARGIN: f64 = 36.0;
const HEAD: f64 = 132.0;
const FOOT: f64 = 96.0;
const ROW: f64 = 29.0;
/// Where a card's first row of pins is.
const FIRST: f64 = 64.0;

/// Fill and ink of a pin. The palette is Okabe and Ito's, which colour-blind readers can tell
/// apart. The letters are for prints in black and white.
fn colours(usage: Use) -> (&'static str, &'static str) {
    match usage {
        Use::Stepgen => ("#0072b2", "#ffffff"),
        Use::Encoder => ("#009e73", "#ffffff"),
        Use::Pwm => ("#e69f00", "#2b1d00"),
        Use::Input => ("#56b4e9", "#06263a"),
        Use::Output => ("#cc79a7", "#2e0b20"),
        Use::Stop => ("#c8371b", "#ffffff"),
        Use::Factory => ("#f0e442", "#3a3600"),
        Use::Free => ("#ffffff", "#9aa3ad"),
        Use::Ground => ("#23282e", "#ffffff"),
    }
}

/// Draws it.
pub fn svg(pinout: &Pinout) -> String {
    let columns = COLUMNS.min(pinout.headers.len().max(1));
    let rows = pinout.headers.len().div_ceil(columns);
    let width = 2.0 * MARGIN + columns as f64 * (CARD.0 + GAP) - GAP;
    let height = HEAD + rows as f64 * (CARD.1 + GAP) - GAP + FOOT;
    let mut out = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width} {height}\" width=\"{width}\" height=\"{height}\" \
         font-family=\"'DejaVu Sans','Segoe UI','Helvetica Neue',Arial,sans-serif\">\n\
         <title>{title}: pinout</title>\n\
         <rect width=\"{width}\" height=\"{height}\" fill=\"#f4f6f8\"/>\n",
        title = escaped(&pinout.title)
    );
    text(
        &mut out,
        MARGIN,
        56.0,
        "font-size=\"30\" font-weight=\"700\" fill=\"#14181d\"",
        &pinout.title,
    );
    text(
        &mut out,
        MARGIN,
        80.0,
        "font-size=\"14\" fill=\"#4a535d\"",
        &pinout.facts,
    );
    legend(&mut out, pinout);
    for (n, header) in pinout.headers.iter().enumerate() {
        let x = MARGIN + (n % columns) as f64 * (CARD.0 + GAP);
        let y = HEAD + (n / columns) as f64 * (CARD.1 + GAP);
        let _ = writeln!(out, "<g transform=\"translate({x} {y})\">");
        card(&mut out, header);
        out += "</g>\n";
    }
    foot(&mut out, pinout, height);
    out + "</svg>\n"
}

fn legend(out: &mut String, pinout: &Pinout) {
    let mut x = MARGIN + 8.0;
    for usage in pinout.uses() {
        dot(out, x, 106.0, usage, DotShape::Round);
        text(
            out,
            x + 15.0,
            110.5,
            "font-size=\"12.5\" fill=\"#2b323a\"",
            usage.title(),
        );
        x += 15.0 + usage.title().chars().count() as f64 * 7.2 + 34.0;
    }
    ring(out, x, 106.0, "#6b7580");
    text(
        out,
        x + 17.0,
        110.5,
        "font-size=\"12.5\" fill=\"#2b323a\"",
        "the same line on every header: named on one, pale on the others",
    );
}

fn card(out: &mut String, header: &Header) {
    let (width, height) = CARD;
    let middle = width / 2.0;
    let edge = if header.modified.is_empty() {
        "#d5dbe1"
    } else {
        "#009e73"
    };
    let _ = writeln!(
        out,
        "<rect width=\"{width}\" height=\"{height}\" rx=\"10\" fill=\"#ffffff\" stroke=\"{edge}\" stroke-width=\"1.2\"/>"
    );
    text(
        out,
        16.0,
        31.0,
        "font-size=\"20\" font-weight=\"700\" fill=\"#14181d\"",
        &header.name.to_uppercase(),
    );
    let (note, ink) = match header.modified.as_str() {
        "" => ("as sold: 5 V outputs".to_owned(), "#7b8590"),
        modified => (format!("modified: {modified}"), "#00704f"),
    };
    text(
        out,
        width - 16.0,
        30.0,
        &format!("font-size=\"11.5\" text-anchor=\"end\" fill=\"{ink}\""),
        &note,
    );
    // The connector, seen from above.
    let body = FIRST - 20.0;
    let _ = writeln!(
        out,
        "<rect x=\"{}\" y=\"{body}\" width=\"88\" height=\"{}\" rx=\"6\" fill=\"#e9edf1\" stroke=\"#b3bcc5\"/>",
        middle - 44.0,
        8.0 * ROW + 11.0
    );
    // Its mark at pin 1.
    let _ = writeln!(
        out,
        "<path d=\"M {} {} l -9 -5 v 10 z\" fill=\"#14181d\"/>",
        middle - 46.0,
        FIRST
    );
    for pin in &header.pins {
        draw_pin(out, header, pin, middle);
    }
}

fn draw_pin(out: &mut String, header: &Header, pin: &Pin, middle: f64) {
    let left = pin.index.is_multiple_of(2);
    let side = if left { -1.0 } else { 1.0 };
    let y = FIRST + (pin.index / 2) as f64 * ROW;
    let x = middle + side * 27.0;
    let shape = match (pin.index, &pin.same_as) {
        (0, _) => DotShape::Square,
        (_, Some(_)) => DotShape::Echo,
        (_, None) => DotShape::Round,
    };
    dot(out, x, y, pin.usage, shape);
    if pin.shared {
        ring(
            out,
            x,
            y,
            if pin.usage == Use::Free {
                "#9aa3ad"
            } else {
                colours(pin.usage).0
            },
        );
    }
    // The silk screen's number, between the rows.
    let anchor = if left { "end" } else { "start" };
    text(
        out,
        middle - side * -7.0 + if left { 5.5 } else { -5.5 },
        y + 3.2,
        &format!("font-size=\"8.5\" text-anchor=\"{anchor}\" fill=\"#5c6670\""),
        &(pin.index + 1).to_string(),
    );
    let name = if pin.usage == Use::Ground {
        String::new()
    } else {
        format!("{}:{}", header.name, pin.index)
    };
    let at = middle + side * 60.0;
    let anchor = if left { "end" } else { "start" };
    if pin.usage == Use::Ground {
        text(
            out,
            at,
            y + 4.0,
            &format!("font-size=\"11\" text-anchor=\"{anchor}\" fill=\"#23282e\""),
            "GND",
        );
        return;
    }
    let small = match &pin.same_as {
        Some(same) if pin.copy => format!("{name}: 5 V copy of {same}"),
        Some(same) => format!("{name} \u{2261} {same}"),
        None => format!("{name}  {}", pin.panel),
    };
    if pin.label.is_empty() {
        text(
            out,
            at,
            y + 4.0,
            &format!("font-size=\"10.5\" text-anchor=\"{anchor}\" fill=\"#98a1ab\""),
            &small,
        );
        return;
    }
    let (weight, ink) = if pin.same_as.is_some() {
        ("400", "#6b7580")
    } else {
        ("700", "#14181d")
    };
    // Longest names first shrink, so that nothing leaves its card.
    let size = (130.0 / (pin.label.chars().count() as f64 * 0.66)).min(13.0);
    text(
        out,
        at,
        y + 0.5,
        &format!(
            "font-size=\"{size:.1}\" font-weight=\"{weight}\" text-anchor=\"{anchor}\" fill=\"{ink}\""
        ),
        &pin.label,
    );
    text(
        out,
        at,
        y + 11.5,
        &format!("font-size=\"9\" text-anchor=\"{anchor}\" fill=\"#7b8590\""),
        &small,
    );
}

/// How a pin is drawn.
#[derive(Clone, Copy, PartialEq, Eq)]
enum DotShape {
    Round,
    /// Pin 1, as its pad on the board.
    Square,
    /// A shared line where it has no name of its own.
    Echo,
}

fn dot(out: &mut String, x: f64, y: f64, usage: Use, shape: DotShape) {
    let (colour, ink) = colours(usage);
    let edge = if usage == Use::Free {
        "#b3bcc5"
    } else {
        colour
    };
    let (fill, ink) = match shape {
        DotShape::Echo => ("#ffffff", edge),
        DotShape::Round | DotShape::Square => (colour, ink),
    };
    let shape = match shape {
        DotShape::Square => format!(
            "rect x=\"{}\" y=\"{}\" width=\"17\" height=\"17\"",
            x - 8.5,
            y - 8.5
        ),
        DotShape::Round | DotShape::Echo => format!("circle cx=\"{x}\" cy=\"{y}\" r=\"8.8\""),
    };
    let _ = writeln!(
        out,
        "<{shape} fill=\"{fill}\" stroke=\"{edge}\" stroke-width=\"1.2\"/>"
    );
    let letter = usage.letter().to_string();
    text(
        out,
        x,
        y + 3.9,
        &format!("font-size=\"11\" font-weight=\"700\" text-anchor=\"middle\" fill=\"{ink}\""),
        &letter,
    );
}

/// Around the pin of a shared line.
fn ring(out: &mut String, x: f64, y: f64, ink: &str) {
    let _ = writeln!(
        out,
        "<circle cx=\"{x}\" cy=\"{y}\" r=\"11.6\" fill=\"none\" stroke=\"{ink}\" stroke-width=\"1.3\" stroke-dasharray=\"2.6 2.2\"/>"
    );
}

fn foot(out: &mut String, pinout: &Pinout, height: f64) {
    let y = height - FOOT + 34.0;
    let (usage, label) = &pinout.key;
    dot(out, MARGIN + 9.0, y - 4.0, *usage, DotShape::Round);
    let label = if label.is_empty() { "free" } else { label };
    text(
        out,
        MARGIN + 26.0,
        y,
        "font-size=\"13\" font-weight=\"700\" fill=\"#14181d\"",
        &format!("KEY (button): {label}"),
    );
    for (n, line) in [
        "Each header from above, pin 1 square and marked; j1:0 counts from 0, the small numbers from 1 as the silk screen does.",
        "Pins leave the board through 74HC245 buffers at 5 V. A bus switch is no protection: at most 3.3 V may reach the FPGA (docs/bringup.md).",
    ].into_iter().enumerate() {
        text(out, MARGIN, y + 22.0 + n as f64 * 17.0, "font-size=\"12\" fill=\"#4a535d\"", line);
    }
}

fn text(out: &mut String, x: f64, y: f64, how: &str, what: &str) {
    let _ = writeln!(
        out,
        "<text x=\"{x}\" y=\"{y}\" {how}>{}</text>",
        escaped(what)
    );
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('>', "&gt;")
}
