//! What is drawn of dashes, clips and fills.

use super::area::{Area, Hatch, Within, cut, hatch};
use super::*;
use proptest::prelude::*;

/// A drawing of 100 x 100 mm.
fn svg(content: &str) -> String {
    format!(
        r#"<svg xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink" width="100mm" height="100mm" viewBox="0 0 100 100">{content}</svg>"#
    )
}

fn wish(hatch: Option<Hatch>) -> Wish {
    Wish {
        page: None,
        margin: 0.0,
        tolerance: 0.005,
        feed: 1500.0,
        tool: Tool::Output,
        hatch,
        order: false,
        fonts: Vec::new(),
    }
}

fn drawn(content: &str, hatch: Option<Hatch>) -> Prepared {
    let prepared = prepare("test", svg(content).as_bytes(), &wish(hatch), &|_, _| ());
    prepared.unwrap_or_else(|error| panic!("{error}: {content}"))
}

/// The strokes of a program, in mm.
fn strokes(prepared: &Prepared) -> Vec<Vec<Point>> {
    let (mut strokes, mut down, mut at) = (Vec::new(), false, [0.0; 2]);
    for (instruction, _) in &prepared.program.instructions {
        match instruction {
            Instruction::Aux { bits } => {
                down = bits & AUX_TOOL != 0;
                if down {
                    strokes.push(vec![at]);
                }
            }
            Instruction::Line { to, .. } => {
                at = [0, 1].map(|axis| to[axis] as f64 / 1e6);
                if down {
                    strokes.last_mut().expect("the pen was put down").push(at);
                }
            }
            _ => {}
        }
    }
    strokes
}

fn length(strokes: &[Vec<Point>]) -> f64 {
    let lines = strokes.iter().flat_map(|stroke| stroke.windows(2));
    lines.map(|line| distance(line[0], line[1])).sum()
}

fn close(a: f64, b: f64, by: f64) -> bool {
    (a - b).abs() <= by
}

#[test]
fn a_dashed_line_is_drawn_as_its_dashes() {
    let line = r#"<path d="M10 50 H90" stroke="black" stroke-dasharray="10 5 2" stroke-dashoffset="3" fill="none"/>"#;
    let mut strokes = strokes(&drawn(line, None));
    strokes.sort_by(|a, b| a[0][0].total_cmp(&b[0][0]));
    // 10 5 2 10 5 2, from 3 on: what is drawn, and what is not.
    let told: Vec<[f64; 2]> = strokes
        .iter()
        .map(|stroke| [stroke[0][0], stroke[1][0]].map(|mm| (mm * 1e3).round() / 1e3))
        .collect();
    let expected = [
        [10.0, 17.0],
        [22.0, 24.0],
        [34.0, 39.0],
        [41.0, 51.0],
        [56.0, 58.0],
        [68.0, 73.0],
        [75.0, 85.0],
    ];
    assert_eq!(told, expected);
    assert!(strokes.iter().flatten().all(|at| close(at[1], 50.0, 1e-3)));
}

#[test]
fn dashes_are_as_long_as_the_path_was_before_it_was_scaled() {
    let line = r#"<g transform="scale(1 3)"><path d="M10 2 V22" stroke="black" stroke-dasharray="2 3"/></g>"#;
    let strokes = strokes(&drawn(line, None));
    assert_eq!(strokes.len(), 4);
    for stroke in &strokes {
        assert!(close(length(std::slice::from_ref(stroke)), 6.0, 1e-3));
    }
}

#[test]
fn a_dash_that_goes_over_the_start_of_a_closed_path_is_one_stroke() {
    // 160 round, a dash of 30 and a gap of 10: four dashes, one of them over the corner.
    let square = r#"<rect x="10" y="10" width="40" height="40" fill="none" stroke="black" stroke-dasharray="30 10" stroke-dashoffset="15"/>"#;
    let strokes = strokes(&drawn(square, None));
    assert_eq!(strokes.len(), 4);
    assert!(close(length(&strokes), 120.0, 1e-2));
}

#[test]
fn a_dot_is_drawn_if_its_ends_are_round() {
    for (cap, dots) in [("round", 5), ("square", 5), ("butt", 0)] {
        let line = format!(
            r#"<path d="M1 1 H2" stroke="black"/><path d="M10 50 H55" stroke="black" stroke-dasharray="0 10" stroke-linecap="{cap}"/>"#
        );
        assert_eq!(strokes(&drawn(&line, None)).len() - 1, dots, "{cap}");
    }
}

#[test]
fn gaps_that_are_too_short_to_be_seen_are_drawn() {
    for (dashes, count) in [("1e-4", 1), ("10 1e-4 5 10", 4), ("1 10 2 1e-4", 8)] {
        let line = format!(r#"<path d="M0 50 H90" stroke="black" stroke-dasharray="{dashes}"/>"#);
        assert_eq!(strokes(&drawn(&line, None)).len(), count, "{dashes}");
    }
}

#[test]
fn more_dashes_than_fit_into_memory_are_refused_by_the_paths_name() {
    let content = r#"<path id="fine" d="M0 0 H100" stroke="black" stroke-dasharray="1e-7"/>"#;
    let wish = Wish {
        tolerance: 1e-9,
        ..wish(None)
    };
    let error = prepare("test", svg(content).as_bytes(), &wish, &|_, _| ()).expect_err("too many");
    let said = "path \"fine\": it has 5.0e8 dashes, which is more";
    assert!(error.starts_with(said), "{error}");
}

/// A square of 40 in the middle, as a clip path.
const MIDDLE: &str =
    r#"<defs><clipPath id="c"><rect x="30" y="30" width="40" height="40"/></clipPath></defs>"#;

#[test]
fn what_a_clip_path_hides_is_not_drawn() {
    let content = format!(r#"{MIDDLE}<path d="M0 50 H100" stroke="black" clip-path="url(#c)"/>"#);
    let prepared = drawn(&content, None);
    let strokes = strokes(&prepared);
    assert_eq!(prepared.notes, Vec::<String>::new());
    assert_eq!(strokes.len(), 1);
    assert!(close(strokes[0][0][0], 30.0, 1e-3) && close(strokes[0][1][0], 70.0, 1e-3));
}

#[test]
fn what_runs_along_the_edge_of_its_clip_path_is_drawn_whole() {
    let content = format!(
        r#"{MIDDLE}<g clip-path="url(#c)"><rect x="30" y="30" width="40" height="40" stroke="black"/></g>"#
    );
    let strokes = strokes(&drawn(&content, None));
    assert_eq!(strokes.len(), 1);
    assert!(close(length(&strokes), 160.0, 1e-2), "{strokes:?}");
}

#[test]
fn clip_paths_within_groups_and_of_clip_paths_count_together() {
    // Moved by the group, one within the other, and clipped itself.
    let content = r#"<defs>
        <clipPath id="a"><rect x="0" y="0" width="50" height="100"/></clipPath>
        <clipPath id="b"><rect x="20" y="0" width="100" height="100"/></clipPath>
        <clipPath id="c" clip-path="url(#a)"><rect x="10" y="0" width="100" height="100"/></clipPath>
        <clipPath id="d"><rect x="0" y="0" width="30" height="9" clip-path="url(#b)"/><circle cx="60" cy="5" r="4"/></clipPath>
        </defs>
        <g transform="translate(5 0)" clip-path="url(#a)"><path d="M0 10 H90" stroke="black" clip-path="url(#b)"/></g>
        <path d="M0 20 H100" stroke="black" clip-path="url(#c)"/>
        <path d="M0 5 H100" stroke="black" clip-path="url(#d)"/>"#;
    let strokes = strokes(&drawn(content, None));
    let told: Vec<[f64; 2]> = strokes
        .iter()
        .map(|stroke| [stroke[0][0], stroke[1][0]].map(|mm| (mm * 100.0).round() / 100.0))
        .collect();
    assert_eq!(
        told,
        [[25.0, 55.0], [10.0, 50.0], [20.0, 30.0], [56.0, 64.0]]
    );
}

#[test]
fn a_clip_path_without_shapes_hides_everything() {
    let content = r#"<defs><clipPath id="c"/></defs><path d="M1 1 H9" stroke="black"/><path d="M0 50 H100" stroke="black" clip-path="url(#c)"/>"#;
    assert_eq!(strokes(&drawn(content, None)).len(), 1);
}

#[test]
fn masks_are_still_left_out_and_said() {
    let content = r#"<defs><mask id="m"><rect width="9" height="9" fill="white"/></mask></defs><path d="M0 50 H100" stroke="black" mask="url(#m)"/>"#;
    let prepared = drawn(content, None);
    assert!(
        prepared.notes[0].starts_with("masks are not applied"),
        "{:?}",
        prepared.notes
    );
}

const EVERY: Hatch = Hatch {
    spacing: 1.0,
    angle: 0.0,
};

/// Two squares of 60 and 20 in one path, drawn the same way round.
fn squares(rule: &str) -> String {
    format!(r#"<path fill-rule="{rule}" d="M20 20 h60 v60 h-60 z M40 40 h20 v20 h-20 z"/>"#)
}

#[test]
fn a_filled_path_is_hatched_by_its_fill_rule() {
    for (rule, hatched) in [("nonzero", 60.0 * 60.0), ("evenodd", 60.0 * 60.0 - 400.0)] {
        let strokes = strokes(&drawn(&squares(rule), Some(EVERY)));
        let hatch = length(&strokes) - 4.0 * 60.0 - 4.0 * 20.0;
        assert!(close(hatch, hatched, 0.1), "{rule}: {hatch}");
    }
}

#[test]
fn what_is_not_filled_and_what_is_white_is_not_hatched() {
    let content = r#"<rect x="1" y="1" width="9" height="9" fill="none" stroke="black"/><rect x="20" y="1" width="9" height="9" fill="white"/>"#;
    let prepared = drawn(content, Some(EVERY));
    assert_eq!(prepared.strokes, 2);
    assert_eq!(prepared.notes, ["what is filled with white is not hatched"]);
}

#[test]
fn hatching_is_clipped_and_turned() {
    let content = format!(
        r#"{MIDDLE}<rect x="0" y="0" width="100" height="100" fill="red" clip-path="url(#c)"/>"#
    );
    let angle = 30.0;
    let strokes = strokes(&drawn(&content, Some(Hatch { angle, ..EVERY })));
    assert!(
        close(length(&strokes), 1600.0, 40.0),
        "{}",
        length(&strokes)
    );
    for line in &strokes {
        let [a, b] = [line[0], line[1]];
        let turned = (b[1] - a[1]).atan2(b[0] - a[0]).to_degrees();
        assert!(close(turned.rem_euclid(180.0), angle, 0.01), "{turned}");
        assert!(line.iter().flatten().all(|mm| (29.99..70.01).contains(mm)));
    }
}

/// Where an area is not.
struct Outside<'a>(&'a Area);

impl Within for Outside<'_> {
    fn contains(&self, at: Point) -> bool {
        !self.0.contains(at)
    }

    fn crossings(&self, line: [Point; 2], found: &mut Vec<f64>) {
        self.0.crossings(line, found);
    }
}

/// Whether a place is inside by the definition: how often the outline goes round it.
fn winds(outlines: &[Vec<Point>], at: Point) -> i32 {
    let mut turned = 0.0;
    for outline in outlines {
        for (from, to) in outline.iter().zip(outline.iter().cycle().skip(1)) {
            let angle = |p: &Point| (p[1] - at[1]).atan2(p[0] - at[0]);
            let mut by = angle(to) - angle(from);
            if by > std::f64::consts::PI {
                by -= std::f64::consts::TAU;
            } else if by < -std::f64::consts::PI {
                by += std::f64::consts::TAU;
            }
            turned += by;
        }
    }
    (turned / std::f64::consts::TAU).round() as i32
}

/// mm from a place to the nearest outline.
fn to_the_edge(outlines: &[Vec<Point>], at: Point) -> f64 {
    let edges = outlines.iter().flat_map(|outline| {
        let next = outline.iter().cycle().skip(1);
        outline.iter().copied().zip(next.copied())
    });
    let way = edges.map(|(from, to)| {
        let along = [to[0] - from[0], to[1] - from[1]];
        let square = along[0].powi(2) + along[1].powi(2);
        let part = match square {
            0.0 => 0.0,
            _ => ((at[0] - from[0]) * along[0] + (at[1] - from[1]) * along[1]) / square,
        };
        let part = part.clamp(0.0, 1.0);
        distance(at, [from[0] + along[0] * part, from[1] + along[1] * part])
    });
    way.fold(f64::INFINITY, f64::min)
}

/// Points on whole millimetres meet vertices and run along edges often.
fn outline(points: usize) -> impl Strategy<Value = Vec<Point>> {
    let mm = || prop_oneof![(0..20i32).prop_map(f64::from), 0.0..20.0f64];
    prop::collection::vec([mm(), mm()], 3..points)
}

proptest! {
    // Each makes and reads whole drawings, or some hundred lines.
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn the_dashes_of_a_line_are_as_long_as_the_pattern_says(
        lengths in prop::collection::vec(0.5..9.0f64, 1..5), offset in -30.0..30.0f64, from in 0.0..10.0f64, long in 20.0..80.0f64
    ) {
        let list: Vec<String> = lengths.iter().map(f64::to_string).collect();
        let line = format!(
            r#"<path d="M{from} 50 h{long}" stroke="black" stroke-dasharray="{}" stroke-dashoffset="{offset}"/>"#,
            list.join(" ")
        );
        let mut pattern = lengths.clone();
        if lengths.len() % 2 == 1 {
            pattern.extend(&lengths);
        }
        let period: f64 = pattern.iter().sum();
        // Drawn up to a place of the pattern, which begins anew before 0, too.
        let until = |place: f64| {
            let mut rest = place.rem_euclid(period);
            let mut drawn = place.div_euclid(period) * pattern.iter().step_by(2).sum::<f64>();
            for (n, dash) in pattern.iter().enumerate() {
                drawn += if n % 2 == 0 { rest.clamp(0.0, *dash) } else { 0.0 };
                rest -= dash;
            }
            drawn
        };
        let strokes = strokes(&drawn(&format!(r#"{line}<path d="M1 1 h1" stroke="black"/>"#), None));
        let expected = until(offset + long) - until(offset) + 1.0;
        prop_assert!(close(length(&strokes), expected, 0.01), "{} {expected}", length(&strokes));
    }

    #[test]
    fn a_stroke_is_cut_into_what_is_inside_and_what_is_outside(
        outlines in prop::collection::vec(outline(7), 1..3), stroke in outline(8), even_odd: bool, closed: bool
    ) {
        let mut stroke = stroke;
        if closed {
            stroke.push(stroke[0]);
        }
        let area = Area::new(&outlines, even_odd);
        let inside = cut(&stroke, &[&area]);
        let outside = cut(&stroke, &[&Outside(&area)]);
        let whole = length(&[stroke]);
        prop_assert!(close(length(&inside) + length(&outside), whole, 1e-6));
        for (pieces, within) in [(&inside, true), (&outside, false)] {
            for line in pieces.iter().flat_map(|piece| piece.windows(2)) {
                for part in [0.01, 0.3, 0.5, 0.77, 0.99] {
                    let at = [0, 1].map(|axis| line[0][axis] + (line[1][axis] - line[0][axis]) * part);
                    let winds = winds(&outlines, at);
                    let is = if even_odd { winds % 2 != 0 } else { winds != 0 };
                    let edge = to_the_edge(&outlines, at);
                    prop_assert!(is == within || edge < 0.003, "{at:?} {edge} from the edge");
                }
            }
        }
    }

    #[test]
    fn hatch_lines_lie_in_the_filled_area_and_fill_it(
        outlines in prop::collection::vec(outline(6), 1..3), even_odd: bool, spacing in 0.1..2.0f64, angle in -180.0..180.0f64
    ) {
        let lines = hatch(&outlines, even_odd, Hatch { spacing, angle });
        for line in &lines {
            for part in [0.01, 0.25, 0.5, 0.75, 0.99] {
                let at = [0, 1].map(|axis| line[0][axis] + (line[line.len() - 1][axis] - line[0][axis]) * part);
                let winds = winds(&outlines, at);
                let is = if even_odd { winds % 2 != 0 } else { winds != 0 };
                prop_assert!(is || to_the_edge(&outlines, at) < 0.003, "{at:?}");
            }
        }
        // Every place inside that is further than a space from the edge has a line near by.
        for n in 0..40 {
            let at = [f64::from(n * 7 % 20) + 0.3, f64::from(n * 13 % 20) + 0.7];
            let winds = winds(&outlines, at);
            let is = if even_odd { winds % 2 != 0 } else { winds != 0 };
            if is && to_the_edge(&outlines, at) > spacing {
                let near = lines.iter().any(|line| to_the_edge(std::slice::from_ref(line), at) < spacing * 0.501);
                prop_assert!(near, "{at:?}");
            }
        }
    }
}
