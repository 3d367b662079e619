//! Areas within outlines, what of a stroke lies in them, and the lines that hatch them.
//!
//! A stroke is divided where it meets an outline; what is between two such places lies inside or
//! outside as its middle does. So strokes keep their points, their direction and their order, which
//! a library of polygons that snaps to a grid would not keep; that a place is found twice does no
//! harm. An R-tree has the outlines.

use crate::job::order::Point;
use rstar::primitives::Line;
use rstar::{AABB, PointDistance, RTree};

/// How far from its outline a place counts as in it, mm: a drawing's numbers have 24 bits, and what
/// runs along the outline is to be drawn.
const EDGE: f64 = 1e-3;

/// Which places are inside.
pub(super) trait Within {
    /// This place is, or it is at the edge.
    fn contains(&self, at: Point) -> bool;

    /// Where a line from 0 to 1 may enter or leave.
    fn crossings(&self, line: [Point; 2], found: &mut Vec<f64>);
}

/// What is within outlines, each of them closed.
#[derive(Debug)]
pub(super) struct Area {
    edges: RTree<Line<Point>>,
    bounds: AABB<Point>,
    even_odd: bool,
}

impl Area {
    /// Of these outlines; `even_odd` is the fill rule, otherwise it is `nonzero`.
    pub(super) fn new(outlines: &[Vec<Point>], even_odd: bool) -> Area {
        let edges = outlines.iter().flat_map(|outline| {
            let next = outline.iter().cycle().skip(1);
            outline
                .iter()
                .zip(next)
                .map(|(from, to)| Line::new(*from, *to))
        });
        let edges = RTree::bulk_load(edges.filter(|edge| edge.from != edge.to).collect());
        let bounds = edges.root().envelope();
        Area {
            edges,
            bounds,
            even_odd,
        }
    }

    /// How many edges it has.
    pub(super) fn edges(&self) -> usize {
        self.edges.size()
    }

    /// The smallest box around it.
    pub(super) fn bounds(&self) -> AABB<Point> {
        self.bounds
    }

    fn near(&self, low: Point, high: Point) -> impl Iterator<Item = &Line<Point>> {
        self.edges
            .locate_in_envelope_intersecting(AABB::from_corners(low, high))
    }
}

impl Within for Area {
    fn contains(&self, at: Point) -> bool {
        let [low, high] = [-EDGE, EDGE].map(|more| at.map(|mm| mm + more));
        if self
            .near(low, high)
            .any(|edge| edge.distance_2(&at) <= EDGE * EDGE)
        {
            return true;
        }
        let far = [self.bounds.upper()[0].max(at[0]) + 1.0, at[1]];
        let mut winding = 0;
        for edge in self.near(at, far) {
            let [from, to] = [edge.from, edge.to];
            let rises = from[1] <= at[1];
            if rises == (to[1] <= at[1]) {
                continue;
            }
            let left = cross([from, to], at) > 0.0;
            if rises == left {
                winding += if rises { 1 } else { -1 };
            }
        }
        match self.even_odd {
            true => winding % 2 != 0,
            false => winding != 0,
        }
    }

    fn crossings(&self, line: [Point; 2], found: &mut Vec<f64>) {
        let [a, b] = line;
        let along = [b[0] - a[0], b[1] - a[1]];
        let length = along[0].hypot(along[1]);
        if length == 0.0 {
            return;
        }
        let low = [0, 1].map(|axis| a[axis].min(b[axis]) - EDGE);
        let high = [0, 1].map(|axis| a[axis].max(b[axis]) + EDGE);
        for edge in self.near(low, high) {
            let [from, to] = [cross(line, edge.from), cross(line, edge.to)];
            let ends = [edge.from, edge.to].map(|end| {
                ((end[0] - a[0]) * along[0] + (end[1] - a[1]) * along[1]) / (length * length)
            });
            // An end that touches the line divides it, too.
            for (side, at) in [(from, ends[0]), (to, ends[1])] {
                if side.abs() <= EDGE * length {
                    found.push(at);
                }
            }
            if (from > 0.0) != (to > 0.0) {
                let part = from / (from - to);
                found.push(ends[0] + (ends[1] - ends[0]) * part);
            }
        }
    }
}

/// Positive if the place lies left of the line.
fn cross([from, to]: [Point; 2], at: Point) -> f64 {
    (to[0] - from[0]) * (at[1] - from[1]) - (to[1] - from[1]) * (at[0] - from[0])
}

/// What of a stroke lies in all of these, in its order.
pub(super) fn cut(stroke: &[Point], within: &[&dyn Within]) -> Vec<Vec<Point>> {
    let (mut pieces, mut piece) = (Vec::new(), Vec::new());
    for pair in stroke.windows(2) {
        let line = [pair[0], pair[1]];
        let at = |part: f64| match part {
            1.0 => line[1],
            part => [0, 1].map(|axis| line[0][axis] + (line[1][axis] - line[0][axis]) * part),
        };
        let mut parts = vec![0.0, 1.0];
        for area in within {
            area.crossings(line, &mut parts);
        }
        parts.retain(|part| (0.0..=1.0).contains(part));
        parts.sort_by(f64::total_cmp);
        parts.dedup();
        let mut straight = false;
        for part in parts.windows(2) {
            let middle = at((part[0] + part[1]) / 2.0);
            if !within.iter().all(|area| area.contains(middle)) {
                end(&mut piece, &mut pieces);
                straight = false;
                continue;
            }
            if piece.is_empty() {
                piece.push(at(part[0]));
            } else if straight {
                piece.pop();
            }
            piece.push(at(part[1]));
            straight = true;
        }
    }
    end(&mut piece, &mut pieces);
    // A closed one goes on over its seam.
    let closed = stroke.len() > 2 && stroke.first() == stroke.last();
    if closed
        && let [first, .., last] = &mut pieces[..]
        && first.first() == stroke.first()
        && last.last() == stroke.last()
    {
        last.extend(first.drain(..).skip(1));
        pieces.remove(0);
    }
    pieces
}

fn end(piece: &mut Vec<Point>, pieces: &mut Vec<Vec<Point>>) {
    if piece.len() > 1 {
        pieces.push(std::mem::take(piece));
    }
    piece.clear();
}

/// How areas are hatched.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hatch {
    /// mm from line to line.
    pub spacing: f64,
    /// The lines' direction in degrees, counterclockwise from X.
    pub angle: f64,
}

/// Lines that hatch what is within these outlines, every other one backwards. Those of two areas
/// lie on the same lines of the page.
pub(super) fn hatch(outlines: &[Vec<Point>], even_odd: bool, hatch: Hatch) -> Vec<Vec<Point>> {
    let (sine, cosine) = hatch.angle.to_radians().sin_cos();
    let turned = |[x, y]: Point, sine: f64| [x * cosine - y * sine, x * sine + y * cosine];
    let flat: Vec<Vec<Point>> = outlines
        .iter()
        .map(|outline| outline.iter().map(|at| turned(*at, -sine)).collect())
        .collect();
    let area = Area::new(&flat, even_odd);
    let (low, high) = (area.bounds().lower(), area.bounds().upper());
    if area.edges() == 0 {
        return Vec::new();
    }
    // Half a space off, so that lines do not lie on the edges of what has whole millimetres.
    let line = |y: f64| y / hatch.spacing - 0.5;
    let (first, last) = (line(low[1]).ceil() as i64, line(high[1]).floor() as i64);
    let mut lines = Vec::new();
    for n in first..=last {
        let y = (n as f64 + 0.5) * hatch.spacing;
        let mut ends = [[low[0] - 1.0, y], [high[0] + 1.0, y]];
        if n.rem_euclid(2) == 1 {
            ends.reverse();
        }
        for piece in cut(&ends, &[&area]) {
            lines.push(piece.into_iter().map(|at| turned(at, sine)).collect());
        }
    }
    lines
}

/// How many lines a hatch has at most in one direction of this box.
pub(super) fn lines_across(outlines: &[Vec<Point>], hatch: Hatch) -> f64 {
    let points = outlines.iter().flatten().copied();
    let bounds = AABB::from_points(&points.collect::<Vec<Point>>());
    let (low, high) = (bounds.lower(), bounds.upper());
    (high[0] - low[0]).hypot(high[1] - low[1]) / hatch.spacing
}
