//! A drawing as a program: every visible path, text included, as lines within a tolerance; in an order that travels little.
//!
//! The outlines of what is filled are drawn like strokes; there is no hatching. Clips, masks and pictures are left out, and said.

use crate::job::fonts;
use crate::job::program::Program;
use kurbo::PathEl;
use motion::instruction::{AUX_TOOL, Feed, Instruction, Place};
use resvg::tiny_skia::PathSegment;
use resvg::usvg::fontdb::Database;
use resvg::usvg::{Group, Node, Tree};
use std::path::PathBuf;

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
    /// Width and height in mm to fit it on, scaled and centred; none: its own size, its lower left corner at 0.
    pub page: Option<[f64; 2]>,
    /// mm to keep free at the page's edges.
    pub margin: f64,
    /// How far lines may be from the curves they stand for, in mm.
    pub tolerance: f64,
    /// Drawing speed in mm/min.
    pub feed: f64,
    /// How to lift the tool.
    pub tool: Tool,
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

type Point = [f64; 2];

/// Of an SVG's text.
pub fn prepare(name: &str, text: &[u8], wish: &Wish) -> Result<Prepared, String> {
    let options = fonts::options(&wish.fonts)?;
    let tree = Tree::from_data(text, &options).map_err(|error| error.to_string())?;
    let frame = Frame::new(&tree, wish)?;
    let mut found = Found {
        fonts: tree.fontdb(),
        frame,
        tolerance: wish.tolerance,
        strokes: Vec::new(),
        notes: Vec::new(),
    };
    found.group(tree.root())?;
    let mut strokes = found.strokes;
    if strokes.is_empty() {
        return Err("there is nothing to draw in it".to_owned());
    }
    let mut travel = [travelled(&strokes); 2];
    if wish.order {
        let ordered = ordered(&strokes);
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

/// From the drawing's pixels to the machine's millimetres.
#[derive(Clone, Copy, Debug)]
struct Frame {
    scale: f64,
    left: f64,
    top: f64,
}

impl Frame {
    fn new(tree: &Tree, wish: &Wish) -> Result<Frame, String> {
        // CSS: 96 pixels are an inch.
        let pixel = 25.4 / 96.0;
        let size =
            [tree.size().width(), tree.size().height()].map(|pixels| f64::from(pixels) * pixel);
        let Some(page) = wish.page else {
            return Ok(Frame {
                scale: pixel,
                left: 0.0,
                top: size[1],
            });
        };
        let room = page.map(|length| length - 2.0 * wish.margin);
        if !room.iter().all(|length| *length > 0.0) {
            return Err("the margins leave no room on the page".to_owned());
        }
        let scale = (room[0] / size[0]).min(room[1] / size[1]);
        Ok(Frame {
            scale: pixel * scale,
            left: (page[0] - size[0] * scale) / 2.0,
            top: (page[1] + size[1] * scale) / 2.0,
        })
    }

    /// An SVG's Y points down, a machine's up.
    fn place(&self, point: kurbo::Point) -> Point {
        [
            self.left + point.x * self.scale,
            self.top - point.y * self.scale,
        ]
    }
}

struct Found<'a> {
    fonts: &'a Database,
    frame: Frame,
    tolerance: f64,
    strokes: Vec<Vec<Point>>,
    notes: Vec<String>,
}

impl Found<'_> {
    fn note(&mut self, note: &str) {
        if !self.notes.iter().any(|known| known == note) {
            self.notes.push(note.to_owned());
        }
    }

    fn group(&mut self, group: &Group) -> Result<(), String> {
        if group.clip_path().is_some() || group.mask().is_some() {
            self.note("clips and masks are not applied: what they hide is drawn");
        }
        for node in group.children() {
            match node {
                Node::Group(group) => self.group(group)?,
                Node::Path(path) if path.is_visible() => {
                    let path = path.data().clone().transform(path.abs_transform());
                    self.path(path.ok_or("a path beyond all bounds")?.segments());
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

    fn path(&mut self, segments: impl Iterator<Item = PathSegment>) {
        let point = |p: resvg::tiny_skia::Point| kurbo::Point::new(p.x.into(), p.y.into());
        let elements = segments.map(|segment| match segment {
            PathSegment::MoveTo(p) => PathEl::MoveTo(point(p)),
            PathSegment::LineTo(p) => PathEl::LineTo(point(p)),
            PathSegment::QuadTo(a, p) => PathEl::QuadTo(point(a), point(p)),
            PathSegment::CubicTo(a, b, p) => PathEl::CurveTo(point(a), point(b), point(p)),
            PathSegment::Close => PathEl::ClosePath,
        });
        let (frame, mut stroke) = (self.frame, Vec::new());
        let strokes = &mut self.strokes;
        let mut end = |stroke: &mut Vec<Point>| {
            if stroke.len() > 1 {
                strokes.push(std::mem::take(stroke));
            }
            stroke.clear();
        };
        kurbo::flatten(
            elements,
            self.tolerance / frame.scale,
            |element| match element {
                PathEl::MoveTo(p) => {
                    end(&mut stroke);
                    stroke.push(frame.place(p));
                }
                PathEl::LineTo(p) => stroke.push(frame.place(p)),
                PathEl::ClosePath => {
                    let first = stroke.first().copied();
                    stroke.extend(first);
                    end(&mut stroke);
                    // What follows without a move begins where the path began.
                    stroke.extend(first);
                }
                PathEl::QuadTo(..) | PathEl::CurveTo(..) => {}
            },
        );
        end(&mut stroke);
    }
}

fn distance(a: Point, b: Point) -> f64 {
    (a[0] - b[0]).hypot(a[1] - b[1])
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

/// Always the nearest end next; an open path may be drawn from either, a closed one from any of its points.
fn ordered(strokes: &[Vec<Point>]) -> Vec<Vec<Point>> {
    let mut left: Vec<&Vec<Point>> = strokes.iter().collect();
    let (mut at, mut done) = ([0.0; 2], Vec::with_capacity(strokes.len()));
    while !left.is_empty() {
        let near =
            |stroke: &[Point]| distance(at, stroke[0]).min(distance(at, stroke[stroke.len() - 1]));
        let nearest = left.iter().map(|stroke| near(stroke)).enumerate();
        let (index, _) = nearest.fold(
            (0, f64::MAX),
            |best, this| if this.1 < best.1 { this } else { best },
        );
        let mut stroke = left.swap_remove(index).clone();
        let last = stroke.len() - 1;
        if stroke[0] == stroke[last] {
            let points = stroke[..last]
                .iter()
                .map(|point| distance(at, *point))
                .enumerate();
            let (start, _) = points.fold(
                (0, f64::MAX),
                |best, this| if this.1 < best.1 { this } else { best },
            );
            stroke.pop();
            stroke.rotate_left(start);
            stroke.push(stroke[0]);
        } else if distance(at, stroke[last]) < distance(at, stroke[0]) {
            stroke.reverse();
        }
        at = stroke[stroke.len() - 1];
        done.push(stroke);
    }
    done
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
            .all(|nm| nm.abs() <= motion::instruction::FARTHEST)
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
