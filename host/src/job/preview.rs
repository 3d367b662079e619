//! A picture of a program with its drawn and travel moves, its size and its time.

use crate::job::fonts;
use crate::job::trace::{Planned, Stroke, Trace};
use resvg::tiny_skia::{Pixmap, Transform};
use resvg::usvg::Tree;
use std::fmt::Write;

/// mm round the path, and the height of a line of text.
const EDGE: f64 = 6.0;

/// As SVG, one unit a millimetre, Y upwards.
pub fn svg(name: &str, trace: &Trace) -> String {
    svg_over(name, trace, "")
}

/// Where the picture lies: left, top, width and height in mm, with the top at -Y.
pub fn frame(trace: &Trace) -> [f64; 4] {
    let [low, high] = trace.extents;
    let (width, height) = (high[0] - low[0], high[1] - low[1]);
    let unit = unit(width, height);
    let edge = EDGE * unit;
    let wide = width.max(90.0 * unit) + 2.0 * edge;
    [low[0] - edge, -high[1] - edge, wide, height + 5.0 * edge]
}

/// Text and lines keep their size on the screen: a 200th of the picture's.
fn unit(width: f64, height: f64) -> f64 {
    (width.max(height) / 200.0).max(0.05)
}

/// The same, over something that is SVG already.
pub fn svg_over(name: &str, trace: &Trace, below: &str) -> String {
    let [low, high] = trace.extents;
    let (width, height) = (high[0] - low[0], high[1] - low[1]);
    let unit = unit(width, height);
    let edge = EDGE * unit;
    let [left, top, wide, tall] = frame(trace);
    let mut svg = String::new();
    let _ = writeln!(
        svg,
        r#"<svg xmlns="http://www.w3.org/2000/svg" width="{wide:.3}mm" height="{tall:.3}mm" viewBox="{left:.3} {top:.3} {wide:.3} {tall:.3}">"#
    );
    let _ = writeln!(
        svg,
        r#"<rect x="{left:.3}" y="{top:.3}" width="{wide:.3}" height="{tall:.3}" fill="white"/>"#
    );
    let _ = writeln!(
        svg,
        r##"<rect x="{:.3}" y="{:.3}" width="{width:.3}" height="{height:.3}" fill="none" stroke="#dddddd" stroke-width="{:.3}"/>"##,
        low[0],
        -high[1],
        unit / 4.0
    );
    svg.push_str(below);
    for (travel, color, thick) in [(true, "#e08030", 0.3), (false, "#1040a0", 0.6)] {
        let strokes = trace
            .strokes
            .iter()
            .filter(|stroke| stroke.travel == travel);
        let paths: String = strokes.map(|stroke| path(stroke, unit / 20.0)).collect();
        let _ = writeln!(
            svg,
            r#"<path d="{paths}" fill="none" stroke="{color}" stroke-width="{:.3}" stroke-linecap="round" stroke-linejoin="round"/>"#,
            thick * unit
        );
    }
    for (line, text) in [title(name, trace), caption(trace)].iter().enumerate() {
        let _ = writeln!(
            svg,
            r#"<text x="{:.3}" y="{:.3}" font-family="sans-serif" font-size="{:.3}">{}</text>"#,
            low[0],
            -low[1] + (1.2 + line as f64) * edge,
            edge * 0.6,
            escaped(text)
        );
    }
    svg.push_str("</svg>\n");
    svg
}

/// As PNG, so many pixels wide.
pub fn png(svg: &str, pixels: u32) -> Result<Vec<u8>, String> {
    let options = fonts::options(&[])?;
    let tree = Tree::from_str(svg, &options).map_err(|error| error.to_string())?;
    let scale = pixels as f32 / tree.size().width();
    let tall = (tree.size().height() * scale).ceil() as u32;
    let mut pixmap = Pixmap::new(pixels, tall.max(1))
        .ok_or("a picture of that size does not fit into memory")?;
    resvg::render(
        &tree,
        Transform::from_scale(scale, scale),
        &mut pixmap.as_mut(),
    );
    pixmap.encode_png().map_err(|error| error.to_string())
}

/// Points nearer to each other than `least` mm are one.
fn path(stroke: &Stroke, least: f64) -> String {
    let mut text = String::new();
    let mut at: Option<[f64; 3]> = None;
    for (index, point) in stroke.points.iter().enumerate() {
        let near = at.is_some_and(|at| (at[0] - point[0]).hypot(at[1] - point[1]) < least);
        if near && index + 1 < stroke.points.len() {
            continue;
        }
        let letter = if at.is_none() { 'M' } else { 'L' };
        let _ = write!(text, "{letter}{:.3} {:.3}", point[0], -point[1]);
        at = Some(*point);
    }
    text
}

fn title(name: &str, trace: &Trace) -> String {
    let [low, high] = trace.extents;
    // No minus sign on a value that rounds to 0.
    let short = |mm: f64| (mm * 100.0).round() / 100.0 + 0.0;
    let axis = |axis: usize| format!("{:.2} .. {:.2}", short(low[axis]), short(high[axis]));
    format!("{name}: X {}, Y {}, Z {} mm", axis(0), axis(1), axis(2))
}

fn caption(trace: &Trace) -> String {
    let ways = format!(
        "draws {:.3} m, travels {:.3} m",
        trace.drawn / 1e3,
        trace.travelled / 1e3
    );
    match trace.planned {
        None => format!("{ways} (no machine given, so no time)"),
        Some(Planned { seconds, .. }) => format!("{ways}, takes {}", duration(seconds)),
    }
}

/// Hours, minutes and seconds.
pub fn duration(seconds: f64) -> String {
    let whole = seconds as u64;
    match (whole / 3600, whole / 60 % 60) {
        (0, 0) => format!("{seconds:.1} s"),
        (0, minutes) => format!("{minutes} min {:02} s", whole % 60),
        (hours, minutes) => format!("{hours} h {minutes:02} min"),
    }
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('>', "&gt;")
}
