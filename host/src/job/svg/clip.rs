//! Clip paths: what of a group may be drawn.

use super::area::{Area, Within};
use super::lines::{Frame, outlines};
use crate::job::order::Point;
use kurbo::Affine;
use resvg::usvg::{self, FillRule, Group, Node, Transform};
use rstar::primitives::{GeomWithData, Rectangle};
use rstar::{AABB, RTree};

/// A clip path: the shapes in it together, and what it is clipped by itself.
#[derive(Debug)]
pub(super) struct Clip {
    shapes: Vec<(Area, Option<Clip>)>,
    boxes: RTree<GeomWithData<Rectangle<Point>, usize>>,
    also: Option<Box<Clip>>,
}

impl Clip {
    /// Of a group that is drawn with this transform.
    pub(super) fn new(
        clip: &usvg::ClipPath,
        transform: Transform,
        frame: Frame,
        tolerance: f64,
    ) -> Clip {
        let mut shapes = Vec::new();
        let within = transform.pre_concat(clip.transform());
        gather(clip.root(), within, frame, tolerance, &mut shapes);
        Clip::of(
            shapes,
            clip.clip_path()
                .map(|also| Box::new(Clip::new(also, transform, frame, tolerance))),
        )
    }

    fn of(shapes: Vec<(Area, Option<Clip>)>, also: Option<Box<Clip>>) -> Clip {
        let boxes = shapes
            .iter()
            .enumerate()
            .filter(|(_, (area, _))| area.edges() > 0)
            .map(|(n, (area, _))| GeomWithData::new(Rectangle::from_aabb(area.bounds()), n));
        Clip {
            boxes: RTree::bulk_load(boxes.collect()),
            shapes,
            also,
        }
    }

    /// How many edges it has.
    pub(super) fn edges(&self) -> usize {
        let own = self
            .shapes
            .iter()
            .map(|(area, clip)| area.edges() + clip.as_ref().map_or(0, Clip::edges));
        own.sum::<usize>() + self.also.as_ref().map_or(0, |clip| clip.edges())
    }

    fn near(&self, low: Point, high: Point) -> impl Iterator<Item = &(Area, Option<Clip>)> {
        // As far as an area counts what is at its edge.
        let [low, high] = [(low, -0.01), (high, 0.01)].map(|(at, more)| at.map(|mm| mm + more));
        let found = self
            .boxes
            .locate_in_envelope_intersecting(AABB::from_corners(low, high));
        found.map(|found| &self.shapes[found.data])
    }
}

/// The shapes of a group of a clip path. A child with a clip path of its own is a shape that is
/// clipped.
fn gather(
    group: &Group,
    transform: Transform,
    frame: Frame,
    tolerance: f64,
    shapes: &mut Vec<(Area, Option<Clip>)>,
) {
    for node in group.children() {
        match node {
            Node::Path(path) if path.is_visible() => {
                let even_odd = path
                    .fill()
                    .is_some_and(|fill| fill.rule() == FillRule::EvenOdd);
                let place = affine(transform);
                let outlines = outlines(path.data(), place, frame, tolerance);
                shapes.push((Area::new(&outlines, even_odd), None));
            }
            Node::Path(_) | Node::Image(_) => {}
            Node::Text(text) => gather(text.flattened(), transform, frame, tolerance, shapes),
            Node::Group(group) => {
                let transform = transform.pre_concat(group.transform());
                let Some(clip) = group.clip_path() else {
                    gather(group, transform, frame, tolerance, shapes);
                    continue;
                };
                let mut clipped = Vec::new();
                gather(group, transform, frame, tolerance, &mut clipped);
                for (area, within) in clipped {
                    let clip = Clip::new(clip, transform, frame, tolerance);
                    let both = match within {
                        None => clip,
                        Some(within) => Clip::of(clip.shapes, Some(Box::new(within))),
                    };
                    shapes.push((area, Some(both)));
                }
            }
        }
    }
}

/// A transform of a drawing, for curves.
pub(super) fn affine(transform: Transform) -> Affine {
    let Transform {
        sx,
        ky,
        kx,
        sy,
        tx,
        ty,
    } = transform;
    Affine::new([sx, ky, kx, sy, tx, ty].map(f64::from))
}

impl Within for Clip {
    fn contains(&self, at: Point) -> bool {
        let shape = |(area, clip): &(Area, Option<Clip>)| {
            area.contains(at) && clip.as_ref().is_none_or(|clip| clip.contains(at))
        };
        self.near(at, at).any(shape) && self.also.as_ref().is_none_or(|also| also.contains(at))
    }

    fn crossings(&self, line: [Point; 2], found: &mut Vec<f64>) {
        let [a, b] = line;
        let low = [0, 1].map(|axis| a[axis].min(b[axis]));
        let high = [0, 1].map(|axis| a[axis].max(b[axis]));
        for (area, clip) in self.near(low, high) {
            area.crossings(line, found);
            if let Some(clip) = clip {
                clip.crossings(line, found);
            }
        }
        if let Some(also) = &self.also {
            also.crossings(line, found);
        }
    }
}
