//! Curves as lines: where the drawing lies on the page, and its outlines and dashes there.

use super::{MOST_POINTS, Wish};
use crate::job::order::Point;
use kurbo::{Affine, BezPath, PathEl, Shape};
use resvg::tiny_skia::{Path as Outline, PathSegment};
use resvg::usvg::{LineCap, Stroke, Tree};

/// From the drawing's pixels to the machine's millimetres.
#[derive(Clone, Copy, Debug)]
pub(super) struct Frame {
    scale: f64,
    left: f64,
    top: f64,
}

impl Frame {
    pub(super) fn new(tree: &Tree, wish: &Wish) -> Result<Frame, String> {
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
        if !(scale.is_finite() && scale > 0.0) {
            return Err(format!(
                "a drawing of {} x {} mm cannot be scaled to a page; correct its width, height or viewBox",
                size[0], size[1]
            ));
        }
        Ok(Frame {
            scale: pixel * scale,
            left: (page[0] - size[0] * scale) / 2.0,
            top: (page[1] + size[1] * scale) / 2.0,
        })
    }

    /// An SVG's Y points down, a machine's up.
    pub(super) fn place(&self, point: kurbo::Point) -> Point {
        [
            self.left + point.x * self.scale,
            self.top - point.y * self.scale,
        ]
    }
}

/// A path as it is drawn.
fn elements(path: &Outline, place: Affine) -> impl Iterator<Item = PathEl> {
    let point = |p: resvg::tiny_skia::Point| kurbo::Point::new(p.x.into(), p.y.into());
    path.segments().map(move |segment| {
        place
            * match segment {
                PathSegment::MoveTo(p) => PathEl::MoveTo(point(p)),
                PathSegment::LineTo(p) => PathEl::LineTo(point(p)),
                PathSegment::QuadTo(a, p) => PathEl::QuadTo(point(a), point(p)),
                PathSegment::CubicTo(a, b, p) => PathEl::CurveTo(point(a), point(b), point(p)),
                PathSegment::Close => PathEl::ClosePath,
            }
    })
}

/// A path's outlines in mm.
pub(super) fn outlines(
    path: &Outline,
    place: Affine,
    frame: Frame,
    tolerance: f64,
) -> Vec<Vec<Point>> {
    flat(elements(path, place), frame, tolerance)
}

/// A path's dashes in mm. Their lengths are those of the path as it was before it was placed. None:
/// it has none. An error: how many there would be, if that is more than fit into memory.
pub(super) fn dashes(
    path: &Outline,
    place: Affine,
    stroke: &Stroke,
    frame: Frame,
    tolerance: f64,
) -> Result<Option<Vec<Vec<Point>>>, f64> {
    let Some(lengths) = stroke.dasharray() else {
        return Ok(None);
    };
    let lengths: Vec<f64> = lengths.iter().copied().map(f64::from).collect();
    let scale = place.determinant().abs().sqrt() * frame.scale;
    let Some((lengths, shift)) = seen(&lengths, tolerance / scale) else {
        return Ok(None);
    };
    let own: BezPath = elements(path, Affine::IDENTITY).collect();
    let periods = own.perimeter(tolerance) / lengths.iter().sum::<f64>();
    let count = periods * lengths.len() as f64 / 2.0;
    // Each has two points. What is not a number is not fewer.
    if count.is_nan() || count > MOST_POINTS as f64 / 2.0 {
        return Err(count);
    }
    let dashed = kurbo::dash(
        own.into_iter(),
        f64::from(stroke.dashoffset()) - shift,
        &lengths,
    );
    let mut dashes = flat(dashed.map(|element| place * element), frame, tolerance);
    if stroke.linecap() == LineCap::Butt {
        // A dash without a length is a dot if its ends are round or square, and otherwise nothing.
        dashes.retain(|dash| dash.iter().any(|at| *at != dash[0]));
    }
    Ok(Some(dashes))
}

/// The pattern without the gaps that are too short to be seen, and how much later it begins; none
/// if no gap is left: then the line is whole.
fn seen(lengths: &[f64], least: f64) -> Option<(Vec<f64>, f64)> {
    let is_gap = |n: &usize| n % 2 == 1 && lengths[*n] >= least;
    // It is turned so that it ends with a gap that is seen.
    let first = (0..lengths.len()).find(is_gap)? + 1;
    let turned = [&lengths[first..], &lengths[..first]].concat();
    let (mut pattern, mut dash) = (Vec::new(), 0.0);
    for pair in turned.as_chunks::<2>().0 {
        let [drawn, gap] = *pair;
        dash += drawn;
        match gap >= least {
            true => pattern.extend([std::mem::take(&mut dash), gap]),
            false => dash += gap,
        }
    }
    Some((pattern, lengths[..first].iter().sum()))
}

/// As lines within the tolerance.
fn flat(elements: impl Iterator<Item = PathEl>, frame: Frame, tolerance: f64) -> Vec<Vec<Point>> {
    let (mut strokes, mut stroke) = (Vec::new(), Vec::new());
    let mut end = |stroke: &mut Vec<Point>| {
        if stroke.len() > 1 {
            strokes.push(std::mem::take(stroke));
        }
        stroke.clear();
    };
    kurbo::flatten(elements, tolerance / frame.scale, |element| match element {
        PathEl::MoveTo(p) => {
            end(&mut stroke);
            stroke.push(frame.place(p));
        }
        PathEl::LineTo(p) => stroke.push(frame.place(p)),
        PathEl::ClosePath => {
            let first = stroke.first().copied();
            stroke.extend(first);
            end(&mut stroke);
            // A line after a close without a move begins at the start of the path.
            stroke.extend(first);
        }
        PathEl::QuadTo(..) | PathEl::CurveTo(..) => {}
    });
    end(&mut stroke);
    strokes
}
