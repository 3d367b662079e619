//! `ferrocnc job`: no board, only files.

use jobs::instruction::{Feed, Instruction};
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

/// A folder of this test's own.
fn folder(name: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR"))
        .join("job")
        .join(name);
    let _ = std::fs::remove_dir_all(&folder);
    std::fs::create_dir_all(&folder).unwrap();
    folder
}

fn tool(folder: &Path, arguments: &str) -> Output {
    Command::new(env!("CARGO_BIN_EXE_ferrocnc"))
        .current_dir(folder)
        .arg("job")
        .args(arguments.split_whitespace())
        .output()
        .unwrap()
}

fn answer(folder: &Path, arguments: &str) -> String {
    let output = tool(folder, arguments);
    let error = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{arguments}: {error}");
    String::from_utf8(output.stdout).unwrap()
}

fn complaint(folder: &Path, arguments: &str) -> String {
    let output = tool(folder, arguments);
    assert!(!output.status.success(), "{arguments} succeeded");
    String::from_utf8(output.stderr).unwrap()
}

fn json(folder: &Path, arguments: &str) -> serde_json::Value {
    serde_json::from_str(&answer(folder, &format!("{arguments} --json"))).unwrap()
}

fn with_machine(name: &str) -> PathBuf {
    let folder = folder(name);
    let machine = Path::new(env!("CARGO_MANIFEST_DIR")).join("examples/plotter/machine.toml");
    std::fs::copy(machine, folder.join("machine.toml")).unwrap();
    folder
}

/// Curves, a circle, an arc, a transform and two lines far apart; a font is not needed.
const DRAWING: &str = r#"<svg xmlns="http://www.w3.org/2000/svg" width="100mm" height="80mm" viewBox="0 0 100 80">
  <path d="M90 70 L95 70" stroke="black"/>
  <path d="M10 70 C 30 10, 60 10, 80 70" stroke="black" fill="none"/>
  <g transform="translate(50 30) rotate(45)"><rect x="-5" y="-5" width="10" height="10"/></g>
  <circle cx="50" cy="40" r="20" fill="none" stroke="red"/>
  <path d="M5 5 A 10 10 0 0 1 25 5" stroke="black" fill="none"/>
  <path d="M1 1 L2 2" stroke="black" visibility="hidden"/>
</svg>"#;

#[test]
fn a_drawing_becomes_a_job_that_reads_back_and_is_checked_for_a_machine() {
    let folder = with_machine("drawing");
    std::fs::write(folder.join("drawing.svg"), DRAWING).unwrap();
    let prepared = json(&folder, "prepare drawing.svg -o drawing.job");
    assert_eq!(prepared["strokes"], 5);
    let (before, after) = (
        prepared["travel_as_drawn_mm"].as_f64().unwrap(),
        prepared["travel_mm"].as_f64().unwrap(),
    );
    assert!(after < before, "{after} of {before} mm");
    let checked = json(&folder, "check drawing.job --machine machine.toml");
    let deviation = checked["planned"]["deviation_mm"].as_f64().unwrap();
    println!(
        "{deviation} mm off at most, {} s, {} segments",
        checked["planned"]["seconds"], checked["planned"]["segments"]
    );
    // Corners are rounded by 0.02 mm at most; a step is 0.0125 mm.
    assert!(deviation <= 0.02 + 0.0125, "{deviation} mm");
    assert_eq!(
        checked["planned"]["end_steps"],
        serde_json::json!([0, 0, 0])
    );
    // The circle's left and the arc's top: the drawing's Y points down, the machine's up.
    let drawn =
        ferrocnc::job::program::Program::read(&folder.join("drawing.job"), &Default::default())
            .unwrap();
    let places = drawn
        .instructions
        .iter()
        .filter_map(|(instruction, _)| match instruction {
            Instruction::Line { to, .. } => Some(*to),
            _ => None,
        });
    let places: Vec<[i64; 3]> = places.collect();
    let near = |x: f64, y: f64| {
        places
            .iter()
            .any(|place| (place[0] as f64 / 1e6 - x).hypot(place[1] as f64 / 1e6 - y) < 0.05)
    };
    for (x, y) in [
        (30.0, 40.0),
        (70.0, 40.0),
        (50.0, 60.0),
        (5.0, 75.0),
        (25.0, 75.0),
        (50.0, 50.0 - 50f64.sqrt()),
    ] {
        assert!(near(x, y), "nothing at {x}, {y}");
    }
    assert!(!near(1.0, 79.0), "what is hidden is drawn");
}

#[test]
fn every_point_of_a_circle_is_within_the_tolerance() {
    let folder = folder("circle");
    std::fs::write(folder.join("c.svg"), r#"<svg xmlns="http://www.w3.org/2000/svg" width="100mm" height="100mm" viewBox="0 0 100 100"><circle cx="50" cy="50" r="40"/></svg>"#).unwrap();
    answer(&folder, "prepare c.svg -o c.job --tolerance 0.01");
    let program =
        ferrocnc::job::program::Program::read(&folder.join("c.job"), &Default::default()).unwrap();
    let mut before: Option<[f64; 2]> = None;
    let mut worst: f64 = 0.0;
    for (instruction, _) in &program.instructions {
        let Instruction::Line {
            to,
            feed: Feed::Rate(_),
        } = instruction
        else {
            continue;
        };
        let place = [to[0] as f64 / 1e6 - 50.0, to[1] as f64 / 1e6 - 50.0];
        if let Some(before) = before.replace(place) {
            for part in 0..=10 {
                let part = f64::from(part) / 10.0;
                let point = [0, 1].map(|i| before[i] + (place[i] - before[i]) * part);
                worst = worst.max((point[0].hypot(point[1]) - 40.0).abs());
            }
        }
    }
    println!("{:.1} um off", worst * 1e3);
    // An SVG's circle is four cubic curves, themselves 2.7e-4 of the radius off at most.
    assert!(worst <= 0.01 + 40.0 * 2.8e-4, "{worst} mm");
}

#[test]
fn a_coordinate_light_years_away_is_refused_by_its_elements_name_before_it_takes_the_memory() {
    let folder = folder("far");
    for (name, drawing, parts) in [
        (
            "curve",
            r#"<path id="tail" d="M1 1 C 2 2, 3 3, 1e30 4" stroke="black"/>"#,
            ["tail", "1", "transform"],
        ),
        (
            "nameless",
            r#"<path d="M0 0 L1 1" stroke="black"/><circle cx="5" cy="5" r="1e20" stroke="black"/>"#,
            ["path 2", "e", "no id"],
        ),
        (
            "nested",
            r#"<g transform="scale(1e4)"><g transform="scale(1e4)"><path id="deep" d="M0 0 Q 3 7 5 5" stroke="black"/></g></g>"#,
            ["deep", "7", "transform"],
        ),
        (
            "overflow",
            r#"<g transform="scale(1e30)"><path id="over" d="M0 0 Q 3 1e20 5 5" stroke="black"/></g>"#,
            // The reader of SVG removes values that are not finite.
            ["nothing", "to", "draw"],
        ),
    ] {
        let file = format!("{name}.svg");
        std::fs::write(folder.join(&file), format!(r#"<svg xmlns="http://www.w3.org/2000/svg" width="100mm" height="100mm" viewBox="0 0 100 100">{drawing}</svg>"#)).unwrap();
        let said = complaint(&folder, &format!("prepare {file} -o {name}.job"));
        let how_far = if name == "overflow" { "draw" } else { "10 m" };
        for part in [&parts[..], &[how_far]].concat() {
            assert!(said.contains(part), "{name}: {part:?} is not in: {said}");
        }
        assert!(!folder.join(format!("{name}.job")).exists());
    }
}

#[test]
fn what_small_files_can_ask_for_ends_soon_and_in_words() {
    let folder = folder("bombs");
    let head = r#"<svg xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink" width="100mm" height="100mm" viewBox="0 0 100 100">"#;
    // Ten of ten of ten ...: a billion lines in a page of text.
    let uses: String = (1..9)
        .map(|n| {
            let ten = format!(r##"<use xlink:href="#l{}"/>"##, n - 1).repeat(10);
            format!(r#"<g id="l{n}">{ten}</g>"#)
        })
        .collect();
    let dashes = "0.0001,".repeat(20_000);
    for (name, drawing, fine) in [
        ("uses", format!(r##"<defs><path id="l0" d="M0 0 L1 1"/>{uses}</defs><use xlink:href="#l8"/>"##), false),
        ("dashes", format!(r#"<path d="M0 0 L99 99" stroke="black" stroke-dasharray="{dashes}1"/>"#), true),
        ("deep", format!("{}<path d='M0 0 L1 1' stroke='black'/>{}", "<g opacity='0.5'>".repeat(5_000), "</g>".repeat(5_000)), false),
        ("markers", format!(r##"<marker id="m">{}</marker><path d="M0 0{}" stroke="black" marker-mid="url(#m)"/>"##, "<path d='M0 0 L1 1'/>".repeat(300), "L1 1".repeat(15_000)), false),
        ("nested", format!(r##"<marker id="m"><path d="M0 0{0}" marker-mid="url(#n)"/></marker><marker id="n"><path d="M0 0{0}"/></marker><path d="M0 0{0}" stroke="black" marker-mid="url(#m)"/>"##, "L1 1".repeat(3_000)), false),
        ("arrows", format!(r##"<marker id="m"><path d="M0 0 L1 1 L2 0 Z"/></marker><path d="M0 0{}" stroke="black" marker-end="url(#m)"/>"##, "L1 1".repeat(15_000)), true),
        ("picture", r#"<image width="9" height="9" href="data:image/svg+xml,<svg/>"/><image width="9" height="9" href="/dev/zero"/><path d="M0 0 L1 1" stroke="black"/>"#.replace("<svg/>", "&lt;svg/>"), true),
        ("loop", r##"<g id="a"><use xlink:href="#b"/></g><g id="b"><use xlink:href="#a"/></g><path d="M0 0 L1 1" stroke="black"/>"##.to_owned(), false),
    ] {
        let file = format!("{name}.svg");
        std::fs::write(folder.join(&file), format!("{head}{drawing}</svg>")).unwrap();
        let output = tool(&folder, &format!("prepare {file} -o {name}.job --tolerance 0.001"));
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        // 101 is a panic, none a signal: out of memory, or of stack.
        assert!(matches!(output.status.code(), Some(0 | 1)), "{name}: {:?}: {said}", output.status);
        assert_eq!(output.status.success(), fine, "{name}: {said}");
        let why = ["more than a million", "more than memory may hold"];
        assert!(fine || why.iter().any(|why| said.contains(why)), "{name}: {said}");
        if name == "picture" {
            let notes = String::from_utf8_lossy(&output.stdout).into_owned();
            assert!(notes.contains("pictures made of pixels are not drawn"), "{notes}");
        }
    }
}

#[test]
fn a_page_is_filled_and_the_margin_kept() {
    let folder = folder("page");
    std::fs::write(folder.join("d.svg"), r#"<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 10 20"><rect width="10" height="20"/></svg>"#).unwrap();
    let prepared = json(&folder, "prepare d.svg -o d.job --page 100x100 --margin 10");
    let close = |key: &str, expected: [f64; 2]| {
        let place = &prepared[key];
        (0..2).all(|axis| (place[axis].as_f64().unwrap() - expected[axis]).abs() < 1e-3)
    };
    assert!(close("highest_mm", [70.0, 90.0]), "{prepared}");
}

#[test]
fn the_pen_may_be_z() {
    let folder = folder("z");
    std::fs::write(folder.join("d.svg"), DRAWING).unwrap();
    let prepared = json(&folder, "prepare d.svg -o d.job --tool z:2,-0.5");
    assert_eq!(
        (
            prepared["lowest_mm"][2].as_f64(),
            prepared["highest_mm"][2].as_f64()
        ),
        (Some(-0.5), Some(2.0))
    );
}

#[test]
fn a_fill_is_hatched_on_request_and_a_wrong_hatch_is_told() {
    let folder = folder("hatch");
    std::fs::write(folder.join("d.svg"), r#"<svg xmlns="http://www.w3.org/2000/svg" width="100mm" height="100mm" viewBox="0 0 100 100"><rect x="10" y="10" width="50" height="20"/></svg>"#).unwrap();
    let outline = json(&folder, "prepare d.svg -o d.job");
    let hatched = json(&folder, "prepare d.svg -o h.job --hatch 2:90");
    // 25 lines of 20 mm.
    assert_eq!(outline["strokes"], 1);
    assert_eq!(hatched["strokes"], 26);
    let drawn = hatched["drawn_mm"].as_f64().unwrap() - outline["drawn_mm"].as_f64().unwrap();
    assert!((drawn - 500.0).abs() < 0.1, "{drawn}");
    for wrong in ["0", "1:north", "1:"] {
        let said = complaint(&folder, &format!("prepare d.svg -o w.job --hatch {wrong}"));
        assert!(said.contains("from 0.05 to 1000 mm"), "{said}");
    }
}

/// A file of a plugin that moves its pen with Z, in a folder of the test.
fn plugin(name: &str, file: &str) -> PathBuf {
    let folder = folder(name);
    let programs = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/programs");
    std::fs::copy(programs.join(file), folder.join(file)).unwrap();
    folder
}

#[test]
fn the_pen_of_a_gcodetools_file_is_its_z_and_the_height_is_found_and_said() {
    let folder = plugin("gcodetools", "gcodetools.ngc");
    let said = answer(&folder, "prepare gcodetools.ngc -o a.job --pen z");
    let height = "note: the pen is Z: up at 5 mm, down at -1 mm, divided at 2 mm";
    assert!(said.contains(height), "{said}");
    let prepared = json(&folder, "prepare gcodetools.ngc -o b.job --pen z:-0.5");
    assert_eq!(prepared["notes"], serde_json::json!([]));
    assert_eq!(prepared["lowest_mm"][2].as_f64(), Some(0.0));
    assert_eq!(
        std::fs::read(folder.join("a.job")).unwrap(),
        std::fs::read(folder.join("b.job")).unwrap()
    );
    // As it is, the board would move Z; the note says how to make a pen of it.
    let said = answer(&folder, "prepare gcodetools.ngc -o c.job");
    assert!(said.contains("for a plotter's pen: --pen z"), "{said}");
    let kept = json(&folder, "prepare gcodetools.ngc -o d.job --pen m3");
    assert_eq!(kept["notes"], serde_json::json!([]));
    assert_eq!(kept["highest_mm"][2].as_f64(), Some(5.0));
}

#[test]
fn a_gcodetools_file_is_written_as_xypenplotters_binary_as_it_is() {
    let folder = plugin("gcodetools-bin", "gcodetools.ngc");
    let said = answer(&folder, "prepare gcodetools.ngc -o x.bin");
    assert!(said.contains("note: the pen is Z: up at 5 mm"), "{said}");
    answer(&folder, "prepare gcodetools.ngc -o x.job --pen z");
    let binary = json(&folder, "check x.bin --bin-feed 400");
    let job = json(&folder, "check x.job");
    for key in ["drawn_mm", "travelled_mm"] {
        let [there, here] = [&binary, &job].map(|facts| facts[key].as_f64().unwrap());
        assert!((there - here).abs() < 1e-3, "{key}: {there} {here}");
    }
}

#[test]
fn a_pen_that_cannot_be_found_or_is_none_is_told() {
    let folder = folder("no-pen");
    std::fs::write(folder.join("p.ngc"), "G1 X1 Y1 F600\nM2\n").unwrap();
    std::fs::write(folder.join("d.svg"), DRAWING).unwrap();
    let said = complaint(&folder, "prepare p.ngc -o p.job --pen z");
    assert!(said.contains("p.ngc: the file does not show at which Z the pen is down: name the height, --pen z:HEIGHT"), "{said}");
    let said = complaint(&folder, "prepare p.ngc -o p.job --pen y");
    assert!(said.contains("m3, z, or z:HEIGHT in mm"), "{said}");
    let said = complaint(&folder, "prepare d.svg -o d.job --pen z");
    assert!(said.contains("a drawing's pen is --tool"), "{said}");
}

#[test]
fn text_is_drawn_as_its_outlines() {
    let folder = folder("text");
    std::fs::write(folder.join("t.svg"), r#"<svg xmlns="http://www.w3.org/2000/svg" width="100" height="50"><text x="5" y="40" font-family="DejaVu Sans" font-size="40">oi</text></svg>"#).unwrap();
    let output = tool(&folder, "prepare t.svg -o t.job --json");
    if output.status.success() {
        // o: two outlines; i: a stem and a dot.
        let prepared: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
        assert_eq!(prepared["strokes"], 4);
    } else {
        // A system without any font says so, and draws nothing of the text.
        let error = String::from_utf8(output.stderr).unwrap();
        assert!(
            error.contains("no font for the text \"oi\"; --font FILE adds one"),
            "{error}"
        );
    }
}

#[test]
fn a_font_that_is_not_here_is_said_and_the_text_drawn_all_the_same() {
    let folder = folder("font");
    std::fs::write(folder.join("t.svg"), r#"<svg xmlns="http://www.w3.org/2000/svg" width="100" height="50"><text x="5" y="40" font-family="No Such Font" font-size="40">l</text></svg>"#).unwrap();
    let output = tool(&folder, "prepare t.svg -o t.job --json");
    if output.status.success() {
        let prepared: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
        assert_eq!(prepared["strokes"], 1);
        assert_eq!(
            prepared["notes"][0],
            "no font No Such Font here: its text is drawn with another; --font FILE adds one"
        );
    } else {
        assert!(String::from_utf8_lossy(&output.stderr).contains("no font for the text"));
    }
}

#[test]
fn a_png_has_its_caption_where_there_are_fonts() {
    let any = ferrocnc::job::fonts::options(&[])
        .unwrap()
        .fontdb
        .faces()
        .next()
        .is_some();
    let picture = |caption: &str| {
        let svg = format!(
            r#"<svg xmlns="http://www.w3.org/2000/svg" width="100" height="50"><text x="5" y="40" font-family="sans-serif" font-size="20">{caption}</text></svg>"#
        );
        ferrocnc::job::preview::png(&svg, 100).unwrap()
    };
    assert_eq!(picture("takes 2.5 s") != picture(""), any);
}

#[test]
fn g_code_that_cannot_be_done_says_where_and_no_job_is_written() {
    let folder = folder("unsupported");
    std::fs::write(folder.join("part.ngc"), "G0 X1\nG1 X5 F100\nG1 X7 G43 H1\n").unwrap();
    let error = complaint(&folder, "prepare part.ngc -o part.job");
    assert_eq!(
        error,
        "ferrocnc: part.ngc: line 3, column 7: G43 is not supported\n"
    );
    assert!(!folder.join("part.job").exists());
    assert!(complaint(&folder, "check part.ngc").contains("line 3, column 7"));
}

#[test]
fn a_program_and_its_job_are_the_same() {
    let folder = with_machine("same");
    let text = "G21 G90\nM3\nG1 X50 Y10 F3000\nG2 X50 Y10 I10 J5\nG3 X20 Y30 R40\nG4 P0.5\nM5\nG0 X0 Y0\nM2\n";
    std::fs::write(folder.join("part.ngc"), text).unwrap();
    answer(&folder, "prepare part.ngc -o part.job");
    let of = |file: &str| json(&folder, &format!("check {file} --machine machine.toml"));
    assert_eq!(of("part.ngc"), of("part.job"));
    let deviation = of("part.job")["planned"]["deviation_mm"].as_f64().unwrap();
    println!("{deviation} mm off at most");
    assert!(deviation <= 0.02 + 0.0125, "{deviation} mm");
}

#[test]
fn places_out_of_bounds_are_named_and_fail_the_check() {
    let folder = with_machine("bounds");
    // The second is an arc with both ends within the limits and its middle outside.
    std::fs::write(
        folder.join("part.ngc"),
        "G0 X301\nG0 X290 Y100\nG2 X290 Y80 J-10 F1000\nG3 X290 Y60 J-10\n",
    )
    .unwrap();
    let output = tool(&folder, "check part.ngc --machine machine.toml");
    let text = String::from_utf8(output.stdout).unwrap();
    assert!(!output.status.success());
    assert!(
        text.contains("line 1: X 301.000 is not within 0 .. 300 mm"),
        "{text}"
    );
    assert!(!text.contains("line 2:"), "{text}");
    std::fs::write(
        folder.join("arc.ngc"),
        "G0 X295 Y100\nG2 X295 Y80 J-10 F1000\n",
    )
    .unwrap();
    let output = tool(&folder, "check arc.ngc --machine machine.toml");
    assert!(
        String::from_utf8(output.stdout)
            .unwrap()
            .contains("line 2: X 305.000 is not within")
    );
}

#[test]
fn a_preview_is_a_picture_with_travel_extents_and_time() {
    let folder = with_machine("preview");
    std::fs::write(
        folder.join("part.ngc"),
        "M3 G1 X50 F3000\nY40\nM5\nG0 X0 Y0\n",
    )
    .unwrap();
    answer(
        &folder,
        "preview part.ngc --machine machine.toml -o part.svg",
    );
    let svg = std::fs::read_to_string(folder.join("part.svg")).unwrap();
    for part in [
        "part: X 0.00 .. 50.00, Y 0.00 .. 40.00",
        "takes ",
        "travels 0.064 m",
        "#e08030",
    ] {
        assert!(svg.contains(part), "{part} is missing:\n{svg}");
    }
    answer(&folder, "preview part.ngc -o part.png --width 300");
    let png = std::fs::read(folder.join("part.png")).unwrap();
    assert_eq!(&png[..8], b"\x89PNG\r\n\x1a\n");
    assert_eq!(png[16..20], 300u32.to_be_bytes());
    assert!(complaint(&folder, "preview part.ngc -o part.png").contains("--force"));
}

#[test]
fn binary_files_are_read_and_written() {
    let folder = folder("binary");
    std::fs::write(
        folder.join("part.ngc"),
        "M3 G1 X2 Y-3 F3000\nG2 X2 Y-3 I1\nM5\nG4 P0.25\nG0 X0 Y0\n",
    )
    .unwrap();
    answer(&folder, "prepare part.ngc -o part.bin");
    let bytes = std::fs::read(folder.join("part.bin")).unwrap();
    assert_eq!(bytes.len(), 4 + 28 * 6);
    assert_eq!(bytes[..4], 42u32.to_le_bytes());
    let (text, binary) = (
        json(&folder, "check part.ngc"),
        json(&folder, "check part.bin --bin-feed 3000"),
    );
    for key in [
        "instructions",
        "lowest_mm",
        "highest_mm",
        "drawn_mm",
        "travelled_mm",
    ] {
        assert_eq!(text[key], binary[key], "{key}");
    }
    assert!(
        complaint(&folder, "check part.bin --bin-count records")
            .contains("the count says 42, the file has 6")
    );
}

#[test]
fn a_machine_that_lacks_a_number_is_refused_by_its_name() {
    let folder = with_machine("machine");
    let text = std::fs::read_to_string(folder.join("machine.toml")).unwrap();
    std::fs::write(folder.join("lacks.toml"), text.replacen("max = 300", "", 1)).unwrap();
    std::fs::write(
        folder.join("fast.toml"),
        text.replacen("speed = 200", "speed = 4000", 1).replacen(
            "steps_per_mm = 80",
            "steps_per_mm = 8000",
            1,
        ),
    )
    .unwrap();
    std::fs::write(folder.join("part.ngc"), "G0 X1\n").unwrap();
    assert!(
        complaint(&folder, "check part.ngc --machine lacks.toml").contains("missing field `max`")
    );
    assert!(complaint(&folder, "check part.ngc --machine fast.toml").contains("X: the speed is"));
}

#[test]
fn a_garbled_job_is_refused() {
    let folder = folder("garbled");
    std::fs::write(folder.join("part.ngc"), "G0 X1\nG0 X2\n").unwrap();
    answer(&folder, "prepare part.ngc -o part.job");
    let mut bytes = std::fs::read(folder.join("part.job")).unwrap();
    let at = bytes.len() / 3;
    bytes[at] ^= 0x40;
    std::fs::write(folder.join("part.job"), bytes).unwrap();
    let error = complaint(&folder, "check part.job");
    assert!(error.contains("part.job: "), "{error}");
}
