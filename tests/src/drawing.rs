//! The drawing of the tests of jobs, its checks, and the picture of the result.
//!
//! [`crate::pins`] checks the edges. The player of the job (bare cores, the twin, the board
//! with its firmware) only has to supply the edges of its pins.

use crate::pins::{self, Difference, Drawn, Event, Pin, Prediction};
use host::job::machine::MachineFile;
use host::job::preview;
use host::job::program::Program;
use host::job::svg::{self, Tool, Wish};
use motion::segment::AXES;
use std::path::{Path, PathBuf};

/// How far lines may be from the drawing's curves, in mm: `--tolerance` of `ferrocnc job prepare`.
pub const TOLERANCE: f64 = 0.01;
/// `--feed`, in mm/min.
pub const FEED: f64 = 18_000.0;
/// As high as the drawing is, in mm.
pub const HEIGHT: f64 = 30.0;

/// Where it and its machine are.
pub fn folder() -> PathBuf {
    crate::root().join("tests/drawing")
}

/// The drawing.
pub fn text() -> String {
    let path = folder().join("drawing.svg");
    std::fs::read_to_string(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

/// The machine.
pub fn machine() -> MachineFile {
    MachineFile::read(&folder().join("machine.toml")).unwrap_or_else(|error| panic!("{error}"))
}

/// The drawing as a program, its curves as lines within `tolerance` mm. Its letters need a font on
/// this machine, any.
pub fn program(tolerance: f64) -> Program {
    let wish = Wish {
        page: None,
        margin: 0.0,
        tolerance,
        feed: FEED,
        tool: Tool::Output,
        hatch: None,
        order: true,
        fonts: Vec::new(),
    };
    let text = text();
    let prepared = svg::prepare("drawing", text.as_bytes(), &wish, &|_, _| {});
    prepared
        .unwrap_or_else(|error| panic!("drawing.svg: {error}"))
        .program
}

/// The result of a drawing that was executed.
#[derive(Clone, Debug)]
pub struct Verdict {
    /// Edge by edge.
    pub difference: Difference,
    /// The path.
    pub drawn: Drawn,
    /// Chord tolerance and a step, in mm.
    pub allowed: f64,
    /// How long, in clocks.
    pub clocks: u64,
    /// Segments.
    pub segments: usize,
}

/// Compares the pins' edges with the job's prediction and the drawing's own curves, and writes a
/// picture of both.
pub fn judge(
    told: &Prediction,
    machine: &MachineFile,
    emitted: &[Event],
    picture: &Path,
) -> Verdict {
    // Twenty times finer than the job: the curves themselves, for a step of 12.5 um.
    let curves = program(TOLERANCE / 20.0);
    let drawn = pins::drawn(&curves, machine, emitted);
    let drawn = drawn.unwrap_or_else(|error| panic!("{error}"));
    let svg = pins::over("drawing", &text(), HEIGHT, &drawn);
    let png = preview::png(&svg, 1600).unwrap_or_else(|error| panic!("{error}"));
    if let Some(folder) = picture.parent() {
        std::fs::create_dir_all(folder).expect("a folder for the picture");
    }
    std::fs::write(picture, png).unwrap_or_else(|error| panic!("{}: {error}", picture.display()));
    Verdict {
        difference: told.compare(emitted),
        drawn,
        allowed: TOLERANCE + 1.0 / machine.x.steps_per_mm,
        clocks: told.clocks,
        segments: told.segments.len(),
    }
}

impl Verdict {
    /// What issue 6 asks of a drawing.
    pub fn assert_good(&self, told: &Prediction) {
        let Verdict {
            difference, drawn, ..
        } = self;
        assert_eq!(
            difference.wrong, 0,
            "edges not where they are predicted: {difference:?}"
        );
        let late = difference
            .late
            .expect("as many switches of the pen as predicted");
        assert!(
            late.abs() <= 1,
            "the pen switches {late} clocks from its segment's boundary"
        );
        assert!(
            drawn.deviation <= self.allowed,
            "{} mm off the drawing, {} allowed",
            drawn.deviation,
            self.allowed
        );
        assert!(
            drawn.missing <= self.allowed,
            "{} mm of the drawing are missing, {} allowed",
            drawn.missing,
            self.allowed
        );
        assert_eq!(drawn.steps, told.steps, "the axes end elsewhere");
    }

    /// For other programs. `rate`: segments that the board's own processor plans in a second, if it
    /// was that.
    pub fn figures(&self, player: &str, rate: Option<f64>) -> serde_json::Value {
        serde_json::json!({
            "played_by": player, "segments": self.segments, "edges": self.difference.edges, "edge_differences": self.difference.wrong,
            "pen_switches": self.difference.switches, "pen_late_clocks_max": self.difference.late,
            "deviation_max_mm": self.drawn.deviation, "missing_max_mm": self.drawn.missing, "deviation_allowed_mm": self.allowed,
            "end_steps": self.drawn.steps, "segments_per_second": rate.map(f64::round),
        })
    }

    /// One line.
    pub fn text(&self) -> String {
        format!(
            "{} segments, {} edges, {} differ; {} pen switches, at most {} clocks from their segment; {:.1} um off the curves, {:.1} allowed; ends at {:?}",
            self.segments,
            self.difference.edges,
            self.difference.wrong,
            self.difference.switches,
            self.difference.late.unwrap_or(i64::MAX),
            self.drawn.deviation * 1e3,
            self.allowed * 1e3,
            self.drawn.steps
        )
    }
}

/// Makes events of pins, clock by clock.
#[derive(Clone, Debug, Default)]
pub struct Watch {
    /// What was seen.
    pub events: Vec<Event>,
    step: u16,
    tool: bool,
}

impl Watch {
    /// The pins after the clock `clock`: bit n of `step` and `dir` is axis n, bit 0 of `outputs`
    /// the tool.
    pub fn see(&mut self, clock: u64, step: u16, dir: u16, outputs: u32) {
        let risen = step & !std::mem::replace(&mut self.step, step);
        for axis in (0..AXES).filter(|axis| risen >> axis & 1 == 1) {
            let forward = dir >> axis & 1 == 0;
            self.events.push((clock, Pin::Step { axis, forward }));
        }
        let tool = outputs & 1 == 1;
        if std::mem::replace(&mut self.tool, tool) != tool {
            self.events.push((clock, Pin::Tool(tool)));
        }
    }
}
