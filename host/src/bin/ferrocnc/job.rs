//! `ferrocnc job`: makes jobs of drawings and programs, draws and checks them (without a board),
//! and sends them to a board for execution.

mod board;
mod page;

pub(crate) use board::tell;
pub(crate) use page::{Parcel, Sheet, Told, look, open};

use crate::consent;
use crate::progress::Bar;
use crate::text::say;
use anyhow::{Context, Result, anyhow, bail};
use clap::{Args, Subcommand, ValueEnum};
use ferrocnc::job::machine::MachineFile;
use ferrocnc::job::pen::{self, Heights};
use ferrocnc::job::preview::{self, duration};
use ferrocnc::job::program::{Dialect, Program, ending};
use ferrocnc::job::svg::{self, Hatch, Tool, Wish};
use ferrocnc::job::trace::{self, Trace};
use jobs::gcode::DwellUnit;
use jobs::instruction::Feed;
use jobs::xypen::Quirks;
use serde_json::{Value, json};
use std::cell::RefCell;
use std::path::{Path, PathBuf};

#[derive(Subcommand)]
pub(crate) enum JobToolCommand {
    /// Make a job of a drawing (.svg), of G-code or of XYPenPlotter's binary (.bin).
    Prepare(Prepare),
    /// Draw a job or a program: SVG or PNG, with travel moves, extents and time.
    Preview {
        #[command(flatten)]
        source: Source,
        /// The picture; PNG if it ends in .png.
        #[arg(long, short, value_name = "FILE.svg|FILE.png")]
        output: PathBuf,
        /// Pixels from left to right, of a PNG.
        #[arg(long, default_value_t = 1200, value_parser = clap::value_parser!(u32).range(16..=16384))]
        width: u32,
        /// Overwrite it.
        #[arg(long)]
        force: bool,
    },
    /// Read a job or a program to its end: unsupported words, extents; with a machine also its
    /// limits, the time, the deviation.
    Check {
        #[command(flatten)]
        source: Source,
    },
    #[command(flatten)]
    Board(board::BoardJobCommand),
}

/// The source, and the machine.
#[derive(Args)]
pub(crate) struct Source {
    /// A job (.job), XYPenPlotter's binary (.bin) or G-code.
    #[arg(value_name = "FILE")]
    file: PathBuf,
    /// The machine that will execute it (see host/examples/plotter/machine.toml).
    #[arg(long, short, value_name = "MACHINE.toml")]
    machine: Option<PathBuf>,
    #[command(flatten)]
    dialect: Spoken,
}

/// What a file does not say.
#[derive(Args)]
pub(crate) struct Spoken {
    /// What `G4 P` counts in G-code.
    #[arg(long, value_enum, default_value_t = DwellP::Seconds)]
    dwell_p: DwellP,
    /// What the first word of a .bin counts.
    #[arg(long, value_enum, default_value_t = Count::Fields)]
    bin_count: Count,
    /// Y and J of a .bin are as in G-code; without this option they are inverted, as XYPenPlotter's
    /// converter writes them.
    #[arg(long)]
    bin_upright: bool,
    /// Feed of a .bin, which has none of its own, in mm/min; rapids if not given.
    #[arg(long, value_name = "MM/MIN", value_parser = feed)]
    bin_feed: Option<u32>,
}

#[derive(Clone, Copy, ValueEnum)]
enum DwellP {
    /// As LinuxCNC and grbl.
    Seconds,
    /// As Marlin.
    Milliseconds,
}

#[derive(Clone, Copy, ValueEnum)]
enum Count {
    /// As its converter writes.
    Fields,
    /// As its description says.
    Records,
}

#[derive(Args)]
pub(crate) struct Prepare {
    /// A drawing, G-code or a .bin.
    #[arg(value_name = "FILE")]
    file: PathBuf,
    /// The job; a .bin is written as XYPenPlotter's binary.
    #[arg(long, short, value_name = "FILE.job")]
    output: PathBuf,
    /// Overwrite it.
    #[arg(long)]
    force: bool,
    /// The job's name; the file's if not given.
    #[arg(long)]
    name: Option<String>,
    /// Scale a drawing to this page and centre it; its own size if not given.
    #[arg(long, value_name = "WIDTHxHEIGHT", value_parser = page)]
    page: Option<[f64; 2]>,
    /// Keep this free at the page's edges, in mm.
    #[arg(long, default_value_t = 0.0, value_name = "MM")]
    margin: f64,
    /// How far lines may be from a drawing's curves, in mm.
    #[arg(long, default_value_t = 0.02, value_name = "MM", value_parser = tolerance)]
    tolerance: f64,
    /// How fast a drawing is drawn, in mm/min.
    #[arg(long, default_value_t = 1500.0, value_name = "MM/MIN")]
    feed: f64,
    /// How a drawing's pen is moved: by the output of M3 and M5, or by Z (`z:2,-0.5`: up at 2, down
    /// at -0.5 mm).
    #[arg(long, default_value = "m3", value_name = "m3|z:UP,DOWN", value_parser = tool, allow_hyphen_values = true)]
    tool: Tool,
    /// How G-code moves its pen: with M3 and M5, or with Z, which is then down below HEIGHT (in mm;
    /// found from the file if not given). If not given, Z moves and M3 switches; a .bin is written
    /// with the pen as Z if the file lifts it with Z.
    #[arg(long, value_name = "m3|z[:HEIGHT]", value_parser = pen_of, allow_hyphen_values = true)]
    pen: Option<Pen>,
    /// Hatch what a drawing fills: mm from line to line, and their direction in degrees,
    /// counterclockwise from X; 45 if not given. White is not hatched.
    #[arg(long, value_name = "MM[:ANGLE]", value_parser = hatch)]
    hatch: Option<Hatch>,
    /// Keep the drawing's own order, even if the travel moves are long.
    #[arg(long)]
    keep_order: bool,
    /// A font file, beside the system's; may be repeated.
    #[arg(long, value_name = "FILE")]
    font: Vec<PathBuf>,
    #[command(flatten)]
    dialect: Spoken,
}

fn feed(text: &str) -> Result<u32, String> {
    let rate = text.parse::<f64>().map_err(|error| error.to_string())? * 1e6 / 60.0;
    match rate.round() {
        rate if rate >= 1.0 && rate <= f64::from(u32::MAX) => Ok(rate as u32),
        _ => Err("above 0 and below 257 m/min".to_owned()),
    }
}

fn page(text: &str) -> Result<[f64; 2], String> {
    let (width, height) = text
        .split_once('x')
        .ok_or("width x height in mm, as 210x297")?;
    let length = |text: &str| match text.parse::<f64>() {
        Ok(length) if length > 0.0 && length <= 1e4 => Ok(length),
        _ => Err(format!("{text:?} is not a length in mm")),
    };
    Ok([length(width)?, length(height)?])
}

fn tolerance(text: &str) -> Result<f64, String> {
    match text.parse() {
        Ok(mm) if (0.001..=10.0).contains(&mm) => Ok(mm),
        _ => Err("from 0.001 to 10 mm".to_owned()),
    }
}

/// What moves the pen of a program.
#[derive(Clone, Copy)]
enum Pen {
    /// M3 and M5.
    Output,
    /// Z, below this many mm, or below what the file has.
    Z(Option<f64>),
}

fn pen_of(text: &str) -> Result<Pen, String> {
    let height = text.strip_prefix("z:").map(str::parse::<f64>);
    match (text, height) {
        ("m3", _) => Ok(Pen::Output),
        ("z", _) => Ok(Pen::Z(None)),
        (_, Some(Ok(height))) if height.is_finite() => Ok(Pen::Z(Some(height))),
        _ => Err("m3, z, or z:HEIGHT in mm".to_owned()),
    }
}

/// The program with the pen as it is wished, and what is to be said of it.
fn penned(program: Program, pen: Option<Pen>, is_bin: bool) -> Result<(Program, Option<String>)> {
    let found = |heights: &Heights| {
        format!(
            "the pen is Z: up at {} mm, down at {} mm, divided at {} mm",
            heights.up,
            heights.down,
            heights.middle()
        )
    };
    match pen {
        Some(Pen::Output) => Ok((program, None)),
        Some(Pen::Z(Some(height))) => Ok((pen::from_z(&program, height), None)),
        Some(Pen::Z(None)) => {
            let heights = Heights::of(&program).context(
                "the file does not show at which Z the pen is down: name the height, --pen z:HEIGHT",
            )?;
            let said = found(&heights);
            Ok((pen::from_z(&program, heights.middle()), Some(said)))
        }
        None if is_bin => match Heights::of(&program) {
            None => Ok((program, None)),
            Some(heights) => {
                let said = found(&heights);
                Ok((pen::from_z(&program, heights.middle()), Some(said)))
            }
        },
        None => {
            let said = pen::lifts_with_z(&program).map(|heights| {
                format!(
                    "M3 stays on while Z lifts the tool (up at {} mm, down at {} mm); for a plotter's pen: --pen z",
                    heights.up, heights.down
                )
            });
            Ok((program, said))
        }
    }
}

fn hatch(text: &str) -> Result<Hatch, String> {
    let (spacing, angle) = text.split_once(':').unwrap_or((text, "45"));
    match (spacing.parse::<f64>(), angle.parse::<f64>()) {
        (Ok(spacing), Ok(angle))
            if (0.05..=1000.0).contains(&spacing) && (-360.0..=360.0).contains(&angle) =>
        {
            Ok(Hatch { spacing, angle })
        }
        _ => Err(
            "MM or MM:ANGLE, from 0.05 to 1000 mm and from -360 to 360 degrees, as 0.8:45"
                .to_owned(),
        ),
    }
}

fn tool(text: &str) -> Result<Tool, String> {
    if text == "m3" {
        return Ok(Tool::Output);
    }
    let heights = text
        .strip_prefix("z:")
        .and_then(|heights| heights.split_once(','));
    let (up, down) = heights.ok_or("m3, or z:UP,DOWN in mm")?;
    match (up.parse::<f64>(), down.parse::<f64>()) {
        (Ok(up), Ok(down)) if up.is_finite() && down.is_finite() => Ok(Tool::Z { up, down }),
        _ => Err("z:UP,DOWN in mm".to_owned()),
    }
}

impl Spoken {
    fn dialect(&self) -> Dialect {
        Dialect {
            dwell: match self.dwell_p {
                DwellP::Seconds => DwellUnit::Seconds,
                DwellP::Milliseconds => DwellUnit::Milliseconds,
            },
            quirks: Quirks {
                count_fields: matches!(self.bin_count, Count::Fields),
                invert_y: !self.bin_upright,
                feed: self.bin_feed.map_or(Feed::Rapid, Feed::Rate),
                ..Quirks::G2B
            },
        }
    }
}

impl Source {
    fn read(&self) -> Result<(Program, Option<MachineFile>)> {
        if ending(&self.file) == "svg" {
            bail!(
                "{}: a drawing; `ferrocnc job prepare` makes a job of it",
                self.file.display()
            );
        }
        let program =
            Program::read(&self.file, &self.dialect.dialect()).map_err(|error| anyhow!(error))?;
        let machine = self.machine.as_deref().map(MachineFile::read).transpose();
        Ok((program, machine.map_err(|error| anyhow!(error))?))
    }
}

pub(crate) fn run(command: &JobToolCommand, as_json: bool) -> Result<()> {
    match command {
        JobToolCommand::Prepare(prepare) => self::prepare(prepare, as_json),
        JobToolCommand::Preview {
            source,
            output,
            width,
            force,
        } => {
            let (program, machine) = source.read()?;
            let trace = traced(&program, machine.as_ref())?;
            let svg = preview::svg(&program.name, &trace);
            let picture = match ending(output).as_str() {
                "png" => preview::png(&svg, *width).map_err(|error| anyhow!(error))?,
                "svg" => svg.into_bytes(),
                _ => bail!("{}: a picture ends in .svg or .png", output.display()),
            };
            save(output, &picture, *force)?;
            report(&program, &trace, &[], as_json)
        }
        JobToolCommand::Board(command) => board::run(command, as_json),
        JobToolCommand::Check { source } => {
            let (program, machine) = source.read()?;
            let wrong = machine.as_ref().map_or(Vec::new(), |machine| {
                trace::out_of_bounds(&program, machine)
            });
            let trace = traced(&program, machine.as_ref())?;
            report(&program, &trace, &wrong, as_json)?;
            match wrong.len() {
                0 => Ok(()),
                1 => bail!("{}: a place is out of bounds", source.file.display()),
                places => bail!(
                    "{}: {places} places are out of bounds",
                    source.file.display()
                ),
            }
        }
    }
}

fn traced(program: &Program, machine: Option<&MachineFile>) -> Result<Trace> {
    match machine {
        None => Ok(trace::programmed(program)),
        Some(machine) => trace::planned(program, machine).map_err(|error| anyhow!(error)),
    }
}

fn prepare(prepare: &Prepare, as_json: bool) -> Result<()> {
    let file = &prepare.file;
    let dialect = prepare.dialect.dialect();
    let stem = || {
        file.file_stem()
            .unwrap_or_default()
            .to_string_lossy()
            .into_owned()
    };
    let name = prepare.name.clone();
    let (mut program, mut facts, notes) = if ending(file) == "svg" {
        if prepare.pen.is_some() {
            bail!(
                "{}: --pen is for G-code; a drawing's pen is --tool",
                file.display()
            );
        }
        let text = std::fs::read(file).with_context(|| file.display().to_string())?;
        let wish = Wish {
            page: prepare.page,
            margin: prepare.margin,
            tolerance: prepare.tolerance,
            feed: prepare.feed,
            tool: prepare.tool,
            hatch: prepare.hatch,
            order: !prepare.keep_order,
            fonts: prepare.font.clone(),
        };
        let bar = RefCell::new(Bar::new(as_json));
        let prepared = svg::prepare(&stem(), &text, &wish, &|step, part| {
            bar.borrow_mut().show(step, part);
        });
        drop(bar);
        let prepared = prepared.map_err(|error| anyhow!("{}: {error}", file.display()))?;
        let facts = json!({ "strokes": prepared.strokes, "travel_as_drawn_mm": prepared.travel[0], "travel_mm": prepared.travel[1], "notes": prepared.notes });
        (prepared.program, facts, prepared.notes)
    } else {
        let program = Program::read(file, &dialect).map_err(|error| anyhow!(error))?;
        let is_bin = ending(&prepare.output) == "bin";
        let (program, said) =
            penned(program, prepare.pen, is_bin).with_context(|| file.display().to_string())?;
        let notes: Vec<String> = said.into_iter().collect();
        (program, json!({ "notes": notes }), notes)
    };
    if let Some(name) = name {
        program.name = name;
    }
    let bytes = match ending(&prepare.output).as_str() {
        "job" => program.to_job(),
        "bin" => program
            .to_binary(dialect.quirks)
            .map_err(|error| anyhow!("{}: {error}", file.display()))?,
        _ => bail!(
            "{}: a job ends in .job (or .bin, for XYPenPlotter)",
            prepare.output.display()
        ),
    };
    save(&prepare.output, &bytes, prepare.force)?;
    let trace = trace::programmed(&program);
    if as_json {
        facts["file"] = json!(prepare.output);
        facts["bytes"] = json!(bytes.len());
        merge(&mut facts, facts_of(&program, &trace, &[]));
        return say(&format!("{facts:#}\n"));
    }
    say(&format!(
        "{}: written, {} bytes\n",
        prepare.output.display(),
        bytes.len()
    ))?;
    if let (Some(strokes), Some(before), Some(after)) = (
        facts["strokes"].as_u64(),
        facts["travel_as_drawn_mm"].as_f64(),
        facts["travel_mm"].as_f64(),
    ) {
        say(&format!(
            "  {strokes} paths, travel {before:.0} mm as drawn, {after:.0} mm as ordered\n"
        ))?;
    }
    for note in notes {
        say(&format!("  note: {note}\n"))?;
    }
    report(&program, &trace, &[], false)
}

fn facts_of(program: &Program, trace: &Trace, wrong: &[String]) -> Value {
    let planned = trace.planned.map(|planned| {
        json!({
            "seconds": planned.seconds, "segments": planned.segments, "most_segments_in_a_second": planned.densest,
            "deviation_mm": planned.deviation, "end_steps": planned.steps,
            "without_acceleration": {
                "seconds": planned.steady.seconds, "largest_jump_mm_s": planned.steady.jump,
                "impossible_jumps": planned.steady.impossible, "times_acceleration": planned.steady.times,
            },
        })
    });
    json!({
        "name": program.name, "instructions": program.instructions.len(), "lowest_mm": trace.extents[0], "highest_mm": trace.extents[1],
        "drawn_mm": trace.drawn, "travelled_mm": trace.travelled, "planned": planned, "out_of_bounds": wrong,
    })
}

fn merge(into: &mut Value, from: Value) {
    if let (Value::Object(into), Value::Object(from)) = (into, from) {
        into.extend(from);
    }
}

fn report(program: &Program, trace: &Trace, wrong: &[String], as_json: bool) -> Result<()> {
    if as_json {
        return say(&format!("{:#}\n", facts_of(program, trace, wrong)));
    }
    let [low, high] = trace.extents;
    // No minus sign on a value that rounds to 0.
    let short = |mm: f64| (mm * 1e3).round() / 1e3 + 0.0;
    let axis = |name: &str, axis: usize| {
        format!("{name} {:.3} .. {:.3}", short(low[axis]), short(high[axis]))
    };
    say(&format!(
        "{}: {} instructions, {}, {}, {} mm\n  draws {:.1} mm, travels {:.1} mm\n",
        program.name,
        program.instructions.len(),
        axis("X", 0),
        axis("Y", 1),
        axis("Z", 2),
        trace.drawn,
        trace.travelled
    ))?;
    if let Some(planned) = trace.planned {
        say(&format!(
            "  takes {}, {} segments, at most {} in a second\n  at most {:.1} um from the path programmed; ends at steps {:?}\n",
            duration(planned.seconds),
            planned.segments,
            planned.densest,
            planned.deviation * 1e3,
            planned.steps
        ))?;
        let steady = planned.steady;
        say(&format!(
            "  at constant speed, without acceleration: {}; an axis jumps {} times by more than it can, by up to {:.0} mm/s ({:.0} times its acceleration)\n",
            duration(steady.seconds),
            steady.impossible,
            steady.jump,
            steady.times
        ))?;
    }
    for wrong in wrong {
        say(&format!("  {wrong}\n"))?;
    }
    Ok(())
}

fn save(file: &Path, bytes: &[u8], force: bool) -> Result<()> {
    consent::may_write(file, force)?;
    std::fs::write(file, bytes)
        .map_err(|error| anyhow!("{}: cannot be written ({error})", file.display()))
}
