//! Bitstreams: a board file or a platform in, `NAME.bit`, `NAME-golden.bit`, `NAME.svf` and
//! `NAME.flash` out, below `target/bitstream`. `gateware/ferrocnc/build.py` knows the build steps.
//! This module passes the options and prints the expected time.

use crate::{build, deb, python, root, setup, step, target};
use anyhow::{Context, Result, bail};
use clap::Args;
use std::ffi::OsString;
use std::path::{Path, PathBuf};
use wire::images::{Role, Trailer};

/// What `--all` builds: Lcnc's eight configurations, and the two machines that demo and tests run.
pub const ALL: [&str; 10] = [
    "75b_v6_14o11i6s6e6p",
    "75b_v6_26o23i6p",
    "75b_v7_14o11i6s6e6p",
    "75b_v7_26o23i6p",
    "75b_v8_14o11i6s6e6p",
    "75b_v8_26o23i6p",
    "75e_v6_v8_30o29i9s9e8p",
    "75e_v7_30o29i9s9e8p",
    build::BOARD,
    build::JOBS_BOARD,
];

/// The one the gate builds, `tests/boards/smallest.toml`: with no step generator, no encoder and no
/// SDRAM it is the smallest.
pub const SMALLEST: &str = "smallest";

/// What a bitstream build can be told.
#[derive(Args)]
pub struct Options {
    /// Board configuration, such as boards/mill6.toml.
    #[arg(required_unless_present_any = ["all", "platform"])]
    board: Option<PathBuf>,
    /// Lcnc's eight configurations, mill6 and plotter; writes their table in docs/timing.md.
    #[arg(long, conflicts_with_all = ["board", "platform"])]
    all: bool,
    /// The image of a card, such as 5a-75b-8.0: its pins are configured on the board.
    #[arg(long, conflicts_with = "board")]
    platform: Option<String>,
    /// Of an image: step generators, encoders, PWM generators. 8/8/8 if not said.
    #[arg(long, requires = "platform", conflicts_with_all = ["board", "all"])]
    channels: Option<String>,
    /// Built-in IP address instead of the board file's.
    #[arg(long, requires = "board")]
    ip: Option<String>,
    /// Built-in UDP port instead of the board file's.
    #[arg(long, requires = "board")]
    port: Option<String>,
    /// Built-in MAC address instead of the board file's.
    #[arg(long, requires = "board")]
    mac: Option<String>,
    #[command(flatten)]
    search: Search,
    /// A configuration that has no pins for all it names, such as boards/max.toml, too; it gets no
    /// images.
    #[arg(long)]
    without_pins: bool,
    /// Put new firmware into the existing routed design, even if the gateware has changed since.
    #[arg(long)]
    firmware_only: bool,
}

/// How long to look for a placement that meets every clock.
#[derive(Args)]
pub struct Search {
    /// How many placement seeds to try.
    #[arg(long, default_value_t = 6)]
    seeds: u32,
    /// The first of them.
    #[arg(long, default_value_t = 1)]
    first_seed: u32,
    /// Tools running at once, half a gigabyte each; one per core if not said.
    #[arg(long)]
    jobs: Option<u32>,
    /// Per cent of its frequency every clock must have to spare.
    #[arg(long, default_value_t = 5.0)]
    slack: f32,
}

impl Search {
    fn arguments(&self) -> Vec<String> {
        let values = [
            ("--seeds", Some(self.seeds.to_string())),
            ("--first-seed", Some(self.first_seed.to_string())),
            ("--jobs", self.jobs.map(|jobs| jobs.to_string())),
            ("--slack", Some(self.slack.to_string())),
        ];
        said(values)
    }
}

/// What is built.
enum Subjects {
    BoardFiles(Vec<PathBuf>),
    /// Platforms, and the channels if they are not the usual ones.
    Images(Vec<String>, Option<String>),
}

impl Subjects {
    /// What they are called while they are built: a board file's images keep that name.
    fn names(&self) -> Result<Vec<String>> {
        match self {
            Subjects::BoardFiles(files) => {
                let name = |file: &PathBuf| {
                    let stem = file.file_stem().context("the board needs a file name")?;
                    Ok(stem.to_string_lossy().into_owned())
                };
                files.iter().map(name).collect()
            }
            Subjects::Images(platforms, None) => Ok(platforms.clone()),
            Subjects::Images(platforms, Some(channels)) => {
                let name = |platform| format!("{platform} with {channels}");
                Ok(platforms.iter().map(name).collect())
            }
        }
    }

    fn arguments(&self) -> Vec<OsString> {
        match self {
            Subjects::BoardFiles(files) => {
                let files = files.iter().map(OsString::from);
                std::iter::once("--board".into()).chain(files).collect()
            }
            Subjects::Images(platforms, channels) => {
                let channels = channels.iter().flat_map(|it| ["--channels", it.as_str()]);
                let platforms =
                    std::iter::once("--platform").chain(platforms.iter().map(String::as_str));
                channels.chain(platforms).map(OsString::from).collect()
            }
        }
    }
}

/// Builds the image of every card that can have one, and says their SHA-256 sums.
pub fn images_of_all_cards(search: &Search) -> Result<()> {
    setup::run(setup::Need::Gateware)?;
    setup::riscv_core()?;
    step::heading("images");
    let mut more = search.arguments();
    more.extend(document());
    let images = Subjects::Images(build::IMAGES.map(str::to_owned).to_vec(), None);
    println!("{}", summary(&build_images(&images, &more)?));
    for name in images.names()? {
        print!("{}", deb::sums_of_image(&folder(&name), &name)?);
    }
    println!("\n  files are below {}", target("bitstream").display());
    Ok(())
}

fn document() -> [String; 2] {
    let document = root().join("docs/timing.md");
    ["--document".to_owned(), document.display().to_string()]
}

/// Options that have a value.
fn said<const N: usize>(values: [(&str, Option<String>); N]) -> Vec<String> {
    let one = |(name, value): (&str, Option<String>)| Some([name.to_owned(), value?]);
    values.into_iter().filter_map(one).flatten().collect()
}

/// Builds one or all.
pub fn run(options: &Options) -> Result<()> {
    setup::run(setup::Need::Gateware)?;
    setup::riscv_core()?;
    step::heading("bitstream");
    let subjects = match (&options.board, &options.platform) {
        (Some(board), _) => Subjects::BoardFiles(vec![board.clone()]),
        (None, Some(platform)) => {
            Subjects::Images(vec![platform.clone()], options.channels.clone())
        }
        (None, None) => {
            Subjects::BoardFiles(ALL.iter().map(|name| build::board_file(name)).collect())
        }
    };
    let mut more = said([
        ("--ip", options.ip.clone()),
        ("--port", options.port.clone()),
        ("--mac", options.mac.clone()),
    ]);
    more.extend(options.search.arguments());
    if options.firmware_only {
        more.push("--firmware-only".to_owned());
    }
    if options.without_pins {
        more.push("--without-pins".to_owned());
    }
    if options.all {
        more.extend(document());
    }
    let printed = build_images(&subjects, &more)?;
    println!("{}", summary(&printed));
    println!("\n  files are below {}", target("bitstream").display());
    Ok(())
}

/// Builds the smallest configuration, unpacks it and compares. Says what was proven. One seed after
/// the other: the first one that holds ends the search, and a second beside it is four minutes of a
/// core.
pub fn prove() -> Result<Vec<String>> {
    let more = ["--prove", "--jobs", "1"].map(str::to_owned);
    let printed = build_images(&the_smallest(), &more)?;
    let proven: Vec<String> = printed
        .lines()
        .filter_map(|line| line.strip_prefix("PASS "))
        .map(str::to_owned)
        .collect();
    if proven.is_empty() {
        bail!("nothing was proven; see target/logs/bitstream.log");
    }
    Ok(proven)
}

/// Builds the smallest configuration.
pub fn smallest() -> Result<()> {
    build_images(&the_smallest(), &[]).map(drop)
}

fn the_smallest() -> Subjects {
    Subjects::BoardFiles(vec![build::board_file(SMALLEST)])
}

/// Where a board's files go.
pub fn folder(name: &str) -> PathBuf {
    target("bitstream").join(name)
}

fn build_images(subjects: &Subjects, more: &[String]) -> Result<String> {
    let names = subjects.names()?;
    let image = build::firmware()?;
    let router = build::router()?;
    std::fs::create_dir_all(target("reports"))?;
    let mut build = python::gateware("bitstream");
    build.env("FERROCNC_ROUTER", router);
    build.args(subjects.arguments());
    build.arg("--out").arg(target("bitstream"));
    build.arg("--firmware").arg(&image);
    let report = target("reports/bitstream.json");
    build.arg("--json").arg(&report).args(more);
    let title = match names.as_slice() {
        [one] => format!("bitstream of {one}"),
        many => format!("bitstreams of {} configurations", many.len()),
    };
    let printed = step::run_quietly("bitstream", &title, &estimate(&names), &mut build)?;
    let report = std::fs::read_to_string(&report).context("the report of the build")?;
    for name in built(&report)? {
        leave_elf(&image, &folder(&name), &name)?;
    }
    Ok(printed)
}

/// The names of what was built, which are those of the folders.
fn built(report: &str) -> Result<Vec<String>> {
    let report: serde_json::Value = serde_json::from_str(report)?;
    // Of one the report is flat.
    let all = match report["boards"].as_array() {
        Some(boards) => boards.as_slice(),
        None => std::slice::from_ref(&report),
    };
    let name = |one: &serde_json::Value| Some(one["board"].as_str()?.to_owned());
    let names: Option<_> = all.iter().map(name).collect();
    names.context("the report of the build names no board")
}

/// Leaves the firmware's ELF beside an image, with the image's build id behind its end: `ferrocnc
/// log` finds it by that. A configuration without images gets none.
fn leave_elf(elf: &Path, folder: &Path, name: &str) -> Result<()> {
    let file = folder.join(format!("{name}.bit"));
    let Ok(image) = std::fs::read(&file) else {
        return Ok(());
    };
    let says = || format!("{}: no build id in its header", file.display());
    let build_id = build_id(&image).with_context(says)?;
    let role = Role::Image;
    let trailer = Trailer { build_id, role }.to_words();
    let mut bytes = std::fs::read(elf).with_context(|| elf.display().to_string())?;
    bytes.extend(trailer.iter().flat_map(|word| word.to_le_bytes()));
    std::fs::write(folder.join(format!("{name}.elf")), bytes)?;
    Ok(())
}

/// The build id in the header of an image: a line of text, between zeros.
fn build_id(image: &[u8]) -> Option<u32> {
    let header = &image[..image.len().min(16 * 1024)];
    let mut lines = header.split(|byte| *byte == 0);
    let build = lines.find_map(|line| line.strip_prefix(b"Build: "))?;
    u32::from_str_radix(std::str::from_utf8(build).ok()?, 16).ok()
}

/// What the same boards took the last time, if they were ever built here.
fn estimate(names: &[String]) -> String {
    let known = std::fs::read_to_string(target("bitstream/durations.json"))
        .ok()
        .and_then(|text| serde_json::from_str::<serde_json::Value>(&text).ok())
        .unwrap_or_default();
    let seconds = |name: &String, stage: &str| known.get(format!("{name}/{stage}"))?.as_f64();
    let whole = |name: &String| {
        Some(seconds(name, "synthesis")? + seconds(name, "place and route")? + 10.0)
    };
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let all: Option<f64> = names.iter().map(whole).sum();
    match all {
        None => "10 min a board: the first build here, so that is a guess".to_owned(),
        Some(all) => format!(
            "{:.0} min; if only the firmware is new, seconds",
            all / cores.min(names.len()).max(1) as f64 / 60.0
        ),
    }
}

fn summary(printed: &str) -> String {
    let (_, text) = printed.split_once("== summary\n").unwrap_or(("", printed));
    text.lines()
        .map(|line| format!("  {line}"))
        .collect::<Vec<_>>()
        .join("\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_report_names_the_folders_of_what_was_built() {
        let one = r#"{ "board": "5a-75b-8.0-4-2-0", "seed": 1 }"#;
        let two = r#"{ "board": "b", "boards": [{ "board": "a" }, { "board": "b" }] }"#;
        assert_eq!(built(one).unwrap(), ["5a-75b-8.0-4-2-0"]);
        assert_eq!(built(two).unwrap(), ["a", "b"]);
        assert!(built("{}").is_err());
    }

    #[test]
    fn every_platform_has_an_image_or_too_many_lines_or_a_small_flash() {
        let platforms = crate::tree::with_ending(&root().join("boards/platforms"), "toml").unwrap();
        for file in platforms {
            let name = file.file_stem().unwrap().to_str().unwrap();
            let none = name.starts_with("5a-75e") || name == "5a-75b-6.1";
            assert_eq!(build::IMAGES.contains(&name), !none, "{name}");
        }
    }

    #[test]
    fn the_elf_beside_an_image_ends_with_the_build_id_of_its_header() {
        let at = target("tmp/elf");
        std::fs::create_dir_all(&at).unwrap();
        std::fs::write(at.join("firmware"), b"\x7fELF").unwrap();
        let header = b"\xff\0FerroCNC 0.1.0\0Board: a\0Build: 89abcdef\0Length: 1\0\xff\xff";
        std::fs::write(at.join("a.bit"), header).unwrap();
        leave_elf(&at.join("firmware"), &at, "a").unwrap();
        // Without an image there is no ELF either.
        leave_elf(&at.join("firmware"), &at, "b").unwrap();
        let bytes = std::fs::read(at.join("a.elf")).unwrap();
        assert!(!at.join("b.elf").exists());
        std::fs::write(at.join("c.bit"), b"\xff\0Board: c\0\xff").unwrap();
        let error = leave_elf(&at.join("firmware"), &at, "c").unwrap_err();
        std::fs::remove_dir_all(&at).unwrap();
        assert!(bytes.starts_with(b"\x7fELF"));
        assert_eq!(bytes[4..12], *b"LRTF\xef\xcd\xab\x89");
        assert!(
            error
                .to_string()
                .ends_with("c.bit: no build id in its header")
        );
    }
}
