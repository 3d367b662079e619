//! Makes a program of a drawing: every visible path, text included, as lines within a tolerance, in
//! an order with short travel.
//!
//! The outlines of what is filled are drawn like strokes, and hatched if it is wished. Dashes are
//! drawn as dashes, and clip paths are applied. Masks and pictures are left out; a note says so.

mod area;
mod clip;
mod lines;
#[cfg(test)]
mod tests;

pub use area::Hatch;

use crate::job::fonts;
use crate::job::order::{self, Point, Tell, distance};
use crate::job::program::Program;
use area::{Within, cut};
use clip::{Clip, affine};
use jobs::instruction::{AUX_TOOL, Feed, Instruction, Place};
use kurbo::Affine;
use lines::Frame;
use resvg::tiny_skia::Path as Outline;
use resvg::usvg::fontdb::Database;
use resvg::usvg::{self, Group, ImageHrefResolver, ImageKind, Node, Tree, roxmltree};
use std::path::PathBuf;
use std::sync::Arc;

/// How the tool is put down and lifted.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Tool {
    /// With the output of M3 and M5.
    Output,
    /// With Z, in mm.
    Z {
        /// To travel.
        up: f64,
        /// To draw.
        down: f64,
    },
}

/// What to make of a drawing.
#[derive(Clone, Debug)]
pub struct Wish {
    /// Width and height in mm to fit it on, scaled and centred; none: its own size, its lower left
    /// corner at 0.
    pub page: Option<[f64; 2]>,
    /// mm to keep free at the page's edges.
    pub margin: f64,
    /// How far lines may be from the curves they stand for, in mm.
    pub tolerance: f64,
    /// Drawing speed in mm/min.
    pub feed: f64,
    /// How to lift the tool.
    pub tool: Tool,
    /// Hatch what is filled.
    pub hatch: Option<Hatch>,
    /// Order the paths to travel less; otherwise as in the file.
    pub order: bool,
    /// Files with more fonts than the system has.
    pub fonts: Vec<PathBuf>,
}

/// A drawing made into a program.
#[derive(Clone, Debug)]
pub struct Prepared {
    /// The program.
    pub program: Program,
    /// What was left out.
    pub notes: Vec<String>,
    /// Paths drawn.
    pub strokes: usize,
    /// mm travelled with the tool up, as in the file and as ordered.
    pub travel: [f64; 2],
}

/// Points a drawing may have as lines: a day of drawing at 100 lines a second, and some hundred MB
/// while it is made.
const MOST_POINTS: usize = 10_000_000;

/// Bytes of a drawing that takes long enough to be told of: a second or so.
const LARGE: usize = 1_000_000;

const TOO_MANY: &str = "with every <use> put in its place it has more than a million elements, or they lie more than 1024 deep, or one contains itself; draw it in parts, or ungroup it";

/// Of an SVG's text. What takes long is told.
pub fn prepare(name: &str, text: &[u8], wish: &Wish, tell: Tell<'_>) -> Result<Prepared, String> {
    if text.len() > LARGE {
        tell("reading", 0.0);
    }
    let options = fonts::options(&wish.fonts)?;
    let tree = tree(text, options)?;
    let frame = Frame::new(&tree, wish)?;
    let mut found = Found {
        fonts: tree.fontdb(),
        frame,
        tolerance: wish.tolerance,
        hatch: wish.hatch,
        clips: Vec::new(),
        strokes: Vec::new(),
        paths: 0,
        points: 0,
        notes: Vec::new(),
    };
    found.group(tree.root())?;
    let mut strokes = found.strokes;
    if strokes.is_empty() {
        return Err("there is nothing to draw in it".to_owned());
    }
    let mut travel = [travelled(&strokes); 2];
    if wish.order {
        let ordered = order::nearest_next(&strokes, tell).0;
        let length = travelled(&ordered);
        // The nearest next path is mostly, not always, better.
        if length < travel[0] {
            (strokes, travel[1]) = (ordered, length);
        }
    }
    Ok(Prepared {
        strokes: strokes.len(),
        program: Program {
            name: name.to_owned(),
            instructions: instructions(&strokes, wish)?,
        },
        notes: found.notes,
        travel,
    })
}

/// The drawing with everything put in its place. A drawing that would need too much memory is
/// refused first.
fn tree(text: &[u8], mut options: usvg::Options<'_>) -> Result<Tree, String> {
    // Pictures are not drawn, so none is read: neither other files nor drawings within this one.
    let pixel = || Some(ImageKind::PNG(Arc::new(PIXEL.to_vec())));
    options.image_href_resolver = ImageHrefResolver {
        resolve_data: Box::new(move |_, _, _| pixel()),
        resolve_string: Box::new(move |_, _| pixel()),
    };
    if text.starts_with(&[0x1f, 0x8b]) {
        return Err(
            "is compressed, and may be of any size: uncompress it first (gunzip)".to_owned(),
        );
    }
    let text = std::str::from_utf8(text).map_err(|_| "is not UTF-8 text".to_owned())?;
    let reading = roxmltree::ParsingOptions {
        allow_dtd: true,
        ..Default::default()
    };
    let xml = roxmltree::Document::parse_with_options(text, reading);
    let xml = xml.map_err(|error| error.to_string())?;
    markers(&xml)?;
    Tree::from_xmltree(&xml, &options).map_err(|error| match error {
        usvg::Error::ElementsLimitReached => TOO_MANY.to_owned(),
        usvg::Error::ParsingFailed(error) if error.to_string().contains("limit") => {
            TOO_MANY.to_owned()
        }
        error => error.to_string(),
    })
}

/// A marker is put at every point of a path: 20 kB of text can be 20 million elements, and a
/// marker's own paths may have markers. Refuses what that would be if every path had the largest
/// one.
fn markers(xml: &roxmltree::Document<'_>) -> Result<(), String> {
    let points = |node: roxmltree::Node<'_, '_>| -> usize {
        let numbers = |text: &str| text.split(|c: char| !"0123456789.eE".contains(c)).count();
        let told = ["d", "points"]
            .into_iter()
            .filter_map(|key| node.attribute(key));
        told.map(|text| numbers(text) / 2 + 1).sum()
    };
    let all: usize = xml.descendants().map(points).sum();
    let is =
        |name: &'static str| move |node: &roxmltree::Node<'_, '_>| node.tag_name().name() == name;
    let speaks = |node: roxmltree::Node<'_, '_>| {
        let mut told = node.attributes();
        told.any(|told| {
            told.name().starts_with("marker-")
                || told.name() == "marker"
                || told.value().contains("marker")
        })
    };
    let mut sheets = xml.descendants().filter(is("style"));
    let sheet = sheets.any(|sheet| sheet.text().is_some_and(|text| text.contains("marker")));
    for marker in xml.descendants().filter(is("marker")) {
        let elements = marker
            .descendants()
            .filter(roxmltree::Node::is_element)
            .count();
        let within = marker.descendants().skip(1).any(speaks) || sheet;
        let again: usize = match within {
            true => marker.descendants().map(points).sum::<usize>() + 1,
            false => 1,
        };
        if all.saturating_mul(elements).saturating_mul(again) > MOST_POINTS / 10 {
            return Err(format!(
                "marker {:?} has {elements} elements and the drawing up to {all} points to put them at, which is more than memory may hold; make the marker simpler, or take it out",
                marker.attribute("id").unwrap_or_default()
            ));
        }
    }
    Ok(())
}

/// A PNG of one pixel, in place of every picture.
const PIXEL: &[u8] = b"\x89\x50\x4e\x47\x0d\x0a\x1a\x0a\x00\x00\x00\x0d\x49\x48\x44\x52\x00\x00\x00\x01\x00\x00\x00\x01\x08\x00\x00\x00\x00\x3a\x7e\x9b\x55\x00\x00\x00\x0a\x49\x44\x41\x54\x78\x9c\x63\x60\x00\x00\x00\x02\x00\x01\x48\xaf\xa4\x71\x00\x00\x00\x00\x49\x45\x4e\x44\xae\x42\x60\x82";

struct Found<'a> {
    fonts: &'a Database,
    frame: Frame,
    tolerance: f64,
    hatch: Option<Hatch>,
    /// Those of the groups around, outermost first.
    clips: Vec<Clip>,
    strokes: Vec<Vec<Point>>,
    /// Paths seen; points of the strokes made of them, and of clips.
    paths: usize,
    points: usize,
    notes: Vec<String>,
}

impl Found<'_> {
    fn note(&mut self, note: &str) {
        if !self.notes.iter().any(|known| known == note) {
            self.notes.push(note.to_owned());
        }
    }

    fn group(&mut self, group: &Group) -> Result<(), String> {
        if group.mask().is_some() {
            self.note("masks are not applied: what they hide is drawn");
        }
        let clips = self.clips.len();
        if let Some(path) = group.clip_path() {
            let clip = Clip::new(path, group.abs_transform(), self.frame, self.tolerance);
            self.points += clip.edges();
            if self.points > MOST_POINTS {
                return Err(format!(
                    "clip path {:?}: the drawing has more than {MOST_POINTS} lines up to here; clip fewer groups, or make the path simpler",
                    path.id()
                ));
            }
            self.clips.push(clip);
        }
        let drawn = self.children(group);
        self.clips.truncate(clips);
        drawn
    }

    fn children(&mut self, group: &Group) -> Result<(), String> {
        for node in group.children() {
            match node {
                Node::Group(group) => self.group(group)?,
                Node::Path(path) if path.is_visible() => {
                    self.paths += 1;
                    self.path(path)?;
                    if self.points > MOST_POINTS {
                        return Err(format!(
                            "{}: the drawing has more than {MOST_POINTS} lines up to here; a larger --tolerance needs fewer, or prepare it in parts",
                            self.called(path)
                        ));
                    }
                }
                Node::Path(_) => {}
                Node::Image(_) => self.note("pictures made of pixels are not drawn"),
                Node::Text(text) => {
                    let letters: String = text.chunks().iter().map(|chunk| chunk.text()).collect();
                    for name in text
                        .chunks()
                        .iter()
                        .filter_map(|chunk| fonts::missing(self.fonts, chunk))
                    {
                        self.note(&format!("no font {name} here: its text is drawn with another; --font FILE adds one"));
                    }
                    let before = self.strokes.len();
                    self.group(text.flattened())?;
                    if !letters.trim().is_empty() && self.strokes.len() == before {
                        let shown: String = letters.chars().take(40).collect();
                        return Err(format!(
                            "no font for the text {shown:?}; --font FILE adds one"
                        ));
                    }
                }
            }
        }
        Ok(())
    }

    /// The element's name for a message.
    fn called(&self, path: &usvg::Path) -> String {
        match path.id() {
            "" => format!("path {} of the drawing, which has no id", self.paths),
            id => format!("path \"{id}\""),
        }
    }

    /// The path where it is drawn. Refused before a curve is made into lines: a curve with a huge
    /// coordinate would need more lines than fit into memory.
    fn within(&self, path: &usvg::Path) -> Result<Outline, String> {
        let farthest = jobs::instruction::FARTHEST as f64 / 1e6;
        let too_far = |at: Point, why: String| {
            format!(
                "{}: the point {}, {} {why}; a job reaches {} m. Correct this coordinate or its transform in the drawing, or take the path out",
                self.called(path),
                at[0],
                at[1],
                farthest / 1e3
            )
        };
        let own = path.data();
        let points = || {
            own.points()
                .iter()
                .map(|p| [f64::from(p.x), f64::from(p.y)])
        };
        let Some(whole) = own.clone().transform(path.abs_transform()) else {
            let far = |p: &Point| p[0].abs().max(p[1].abs());
            let most = points().max_by(|a, b| far(a).total_cmp(&far(b)));
            return Err(too_far(
                most.unwrap_or_default(),
                "is not finite".to_owned(),
            ));
        };
        for (at, drawn) in points().zip(whole.points()) {
            let drawn = self
                .frame
                .place(kurbo::Point::new(drawn.x.into(), drawn.y.into()));
            // A value that is not a number is not within the limits.
            if !drawn.iter().all(|mm| mm.abs() <= farthest) {
                return Err(too_far(
                    at,
                    format!("would be drawn at {:.3e}, {:.3e} mm", drawn[0], drawn[1]),
                ));
            }
        }
        Ok(whole)
    }

    fn path(&mut self, path: &usvg::Path) -> Result<(), String> {
        let whole = self.within(path)?;
        let (frame, tolerance) = (self.frame, self.tolerance);
        let outlines = lines::outlines(&whole, Affine::IDENTITY, frame, tolerance);
        let hatched = self.hatched(path, &outlines)?;
        let place = affine(path.abs_transform());
        let dashed = match path.stroke() {
            None => None,
            Some(stroke) => {
                let dashes = lines::dashes(path.data(), place, stroke, frame, tolerance);
                dashes.map_err(|count| {
                    format!(
                        "{}: it has {count:.1e} dashes, which is more than memory may hold; make them longer",
                        self.called(path)
                    )
                })?
            }
        };
        for stroke in dashed.unwrap_or(outlines).into_iter().chain(hatched) {
            let clips: Vec<&dyn Within> = self.clips.iter().map(|clip| clip as _).collect();
            let pieces = match clips.is_empty() {
                true => vec![stroke],
                false => cut(&stroke, &clips),
            };
            self.points += pieces.iter().map(Vec::len).sum::<usize>();
            self.strokes.extend(pieces);
            if self.points > MOST_POINTS {
                return Ok(());
            }
        }
        Ok(())
    }

    /// The lines that hatch the path, if it is wished and the path is filled. White is the paper.
    fn hatched(
        &mut self,
        path: &usvg::Path,
        outlines: &[Vec<Point>],
    ) -> Result<Vec<Vec<Point>>, String> {
        let (Some(hatch), Some(fill)) = (self.hatch, path.fill()) else {
            return Ok(Vec::new());
        };
        if matches!(fill.paint(), usvg::Paint::Color(color) if *color == usvg::Color::white()) {
            self.note("what is filled with white is not hatched");
            return Ok(Vec::new());
        }
        if area::lines_across(outlines, hatch) > MOST_POINTS as f64 / 10.0 {
            return Err(format!(
                "{}: hatching it needs more than {} lines; a larger space between them needs fewer",
                self.called(path),
                MOST_POINTS / 10
            ));
        }
        Ok(area::hatch(
            outlines,
            fill.rule() == usvg::FillRule::EvenOdd,
            hatch,
        ))
    }
}

/// From home, between the strokes, and home again.
fn travelled(strokes: &[Vec<Point>]) -> f64 {
    let (mut at, mut length) = ([0.0; 2], 0.0);
    for stroke in strokes {
        length += distance(at, stroke[0]);
        at = stroke[stroke.len() - 1];
    }
    length + distance(at, [0.0; 2])
}

fn instructions(strokes: &[Vec<Point>], wish: &Wish) -> Result<Vec<(Instruction, u32)>, String> {
    let rate = (wish.feed * 1e6 / 60.0).round();
    if !(1.0..=f64::from(u32::MAX)).contains(&rate) {
        return Err("the feed must be above 0 and below 257 m/min".to_owned());
    }
    let feed = Feed::Rate(rate as u32);
    let nm = |mm: f64| (mm * 1e6).round() as i64;
    let height = |down: bool| match wish.tool {
        Tool::Output => 0,
        Tool::Z { up, down: low } => nm(if down { low } else { up }),
    };
    let place = |point: Point, down: bool| -> Result<Place, String> {
        let place = [nm(point[0]), nm(point[1]), height(down)];
        match place
            .iter()
            .all(|nm| nm.abs() <= jobs::instruction::FARTHEST)
        {
            true => Ok(place),
            false => Err("the drawing reaches further than 10 m".to_owned()),
        }
    };
    let mut program = Vec::new();
    let switch = |program: &mut Vec<_>, at: Point, down: bool| -> Result<(), String> {
        program.push(match wish.tool {
            Tool::Output => Instruction::Aux {
                bits: if down { AUX_TOOL } else { 0 },
            },
            Tool::Z { .. } => Instruction::Line {
                to: place(at, down)?,
                feed: if down { feed } else { Feed::Rapid },
            },
        });
        Ok(())
    };
    switch(&mut program, [0.0; 2], false)?;
    for stroke in strokes {
        program.push(Instruction::Line {
            to: place(stroke[0], false)?,
            feed: Feed::Rapid,
        });
        switch(&mut program, stroke[0], true)?;
        for point in &stroke[1..] {
            program.push(Instruction::Line {
                to: place(*point, true)?,
                feed,
            });
        }
        switch(&mut program, stroke[stroke.len() - 1], false)?;
    }
    program.push(Instruction::Line {
        to: place([0.0; 2], false)?,
        feed: Feed::Rapid,
    });
    program.push(Instruction::End);
    Ok(program.into_iter().zip(1..).collect())
}
