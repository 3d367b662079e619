//! Sorts strokes for short travel: the next stroke is always the one with the nearest end.
//!
//! The ends lie in an R-tree, so the next one is found among 60 000 by looking at some dozen. Ends
//! at the same place are one entry of it: a drawing of a thousand strokes from one point is found
//! as fast as any.

use rstar::{AABB, PointDistance, RTree, RTreeObject};
use std::cell::Cell;
use std::collections::HashMap;

/// A place on the paper, mm.
pub(super) type Point = [f64; 2];

/// How far a step has come, of 1.
pub type Tell<'t> = &'t dyn Fn(&str, f64);

/// mm between two places.
pub(super) fn distance(a: Point, b: Point) -> f64 {
    (a[0] - b[0]).hypot(a[1] - b[1])
}

/// A place where strokes begin or end.
struct Spot<'c> {
    at: Point,
    /// Distances worked out.
    looks: &'c Cell<u64>,
}

impl RTreeObject for Spot<'_> {
    type Envelope = AABB<Point>;

    fn envelope(&self) -> Self::Envelope {
        AABB::from_point(self.at)
    }
}

impl PointDistance for Spot<'_> {
    fn distance_2(&self, point: &Point) -> f64 {
        self.looks.set(self.looks.get() + 1);
        (self.at[0] - point[0]).powi(2) + (self.at[1] - point[1]).powi(2)
    }
}

impl PartialEq for Spot<'_> {
    fn eq(&self, other: &Self) -> bool {
        self.at == other.at
    }
}

/// A place as a key. -0 is 0.
fn key(at: Point) -> [u64; 2] {
    at.map(|mm| (mm + 0.0).to_bits())
}

/// The strokes in their new order, and how many distances were worked out for it; an open one may
/// be drawn from either end, a closed one from any of its points.
pub(super) fn nearest_next(strokes: &[Vec<Point>], tell: Tell<'_>) -> (Vec<Vec<Point>>, u64) {
    let looks = Cell::new(0);
    let mut ends: HashMap<[u64; 2], Vec<usize>> = HashMap::new();
    // Backwards: of strokes that begin at one place the first in the file is taken first.
    for (n, stroke) in strokes.iter().enumerate().rev() {
        for end in [stroke[0], stroke[stroke.len() - 1]] {
            ends.entry(key(end)).or_default().push(n);
        }
    }
    let mut spots = Vec::with_capacity(ends.len());
    // In the order of the file, so that the same drawing always becomes the same job.
    let mut seen = std::collections::HashSet::with_capacity(ends.len());
    for stroke in strokes {
        for at in [stroke[0], stroke[stroke.len() - 1]] {
            if seen.insert(key(at)) {
                let looks = &looks;
                spots.push(Spot { at, looks });
            }
        }
    }
    let mut tree = RTree::bulk_load(spots);
    let mut drawn = vec![false; strokes.len()];
    let (mut at, mut done) = ([0.0; 2], Vec::with_capacity(strokes.len()));
    while let Some(place) = tree.nearest_neighbor(at).map(|spot| spot.at) {
        let waiting = ends.get_mut(&key(place));
        let next = waiting.and_then(|waiting| {
            while let Some(n) = waiting.pop() {
                if !drawn[n] {
                    return Some(n);
                }
            }
            None
        });
        let Some(n) = next else {
            let looks = &looks;
            tree.remove(&Spot { at: place, looks });
            continue;
        };
        drawn[n] = true;
        let stroke = begun_nearest(&strokes[n], at);
        at = stroke[stroke.len() - 1];
        done.push(stroke);
        if done.len() % 1024 == 0 {
            tell("ordering", done.len() as f64 / strokes.len() as f64);
        }
    }
    (done, looks.get())
}

/// The stroke, begun as near to this place as it can be.
fn begun_nearest(stroke: &[Point], at: Point) -> Vec<Point> {
    let mut stroke = stroke.to_vec();
    let last = stroke.len() - 1;
    if stroke[0] == stroke[last] {
        let points = stroke[..last].iter().map(|point| distance(at, *point));
        let (start, _) =
            points.enumerate().fold(
                (0, f64::MAX),
                |best, this| if this.1 < best.1 { this } else { best },
            );
        stroke.pop();
        stroke.rotate_left(start);
        stroke.push(stroke[0]);
    } else if distance(at, stroke[last]) < distance(at, stroke[0]) {
        stroke.reverse();
    }
    stroke
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Always different, always the same.
    fn random(seed: &mut u64) -> f64 {
        *seed ^= *seed << 13;
        *seed ^= *seed >> 7;
        *seed ^= *seed << 17;
        (*seed >> 11) as f64 / (1u64 << 53) as f64
    }

    fn strewn(count: usize, mut seed: u64) -> Vec<Vec<Point>> {
        let seed = &mut seed;
        (0..count)
            .map(|_| {
                let from = [random(seed) * 200.0, random(seed) * 200.0];
                vec![from, [from[0] + random(seed), from[1] + random(seed)]]
            })
            .collect()
    }

    fn looks(strokes: &[Vec<Point>]) -> u64 {
        let (ordered, looks) = nearest_next(strokes, &|_, _| {});
        assert_eq!(ordered.len(), strokes.len());
        looks
    }

    /// The definition: compares every end of every remaining stroke.
    fn by_asking_all(strokes: &[Vec<Point>]) -> Vec<Vec<Point>> {
        let (mut left, mut at): (Vec<_>, Point) = (strokes.to_vec(), [0.0; 2]);
        let mut done = Vec::new();
        while !left.is_empty() {
            let near = |stroke: &[Point]| {
                distance(at, stroke[0]).min(distance(at, stroke[stroke.len() - 1]))
            };
            let nearest = (0..left.len())
                .min_by(|a, b| near(&left[*a]).total_cmp(&near(&left[*b])))
                .expect("some are left");
            let stroke = begun_nearest(&left.remove(nearest), at);
            at = stroke[stroke.len() - 1];
            done.push(stroke);
        }
        done
    }

    #[test]
    fn the_tree_finds_the_same_order_as_an_exhaustive_search() {
        for seed in 1..20 {
            let mut strokes = strewn(100, seed);
            let first = strokes[7][0];
            // A closed one is begun anywhere.
            strokes[7].push([first[0], first[1] + 3.0]);
            strokes[7].push(first);
            assert_eq!(
                nearest_next(&strokes, &|_, _| {}).0,
                by_asking_all(&strokes),
                "seed {seed}"
            );
        }
    }

    #[test]
    fn four_times_the_strokes_are_a_little_more_than_four_times_the_work() {
        let rays = |count: usize| -> Vec<Vec<Point>> {
            let end = |n: usize| (n as f64).sin_cos();
            (0..count)
                .map(|n| vec![[50.0, 50.0], [50.0 + end(n).0, 50.0 + end(n).1]])
                .collect()
        };
        let same = |count: usize| vec![vec![[10.0, 10.0], [20.0, 20.0]]; count];
        let row = |count: usize| -> Vec<Vec<Point>> {
            (0..count)
                .map(|n| vec![[n as f64, 0.0], [n as f64, 1.0]])
                .collect()
        };
        let strewn = |count: usize| strewn(count, 0x5eed);
        type Drawing<'a> = &'a dyn Fn(usize) -> Vec<Vec<Point>>;
        let drawings: [(&str, Drawing); 4] = [
            ("strewn", &strewn),
            ("rays", &rays),
            ("same", &same),
            ("row", &row),
        ];
        for (name, drawing) in drawings {
            let [few, many] = [1_000, 4_000].map(|count| looks(&drawing(count)));
            println!("{name}: {few} and {many} distances");
            assert!(
                many <= 6 * few + 1_000,
                "{name}: {few} for 1000, {many} for 4000"
            );
            assert!(many <= 200 * 4_000, "{name}: {many} for 4000");
        }
    }
}
