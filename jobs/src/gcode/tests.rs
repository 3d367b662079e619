extern crate std;
use super::*;
use proptest::prelude::*;
use std::string::{String, ToString};
use std::vec::Vec;

fn read_with(options: Options, program: &str) -> Result<Vec<Instruction>, Error> {
    let mut reader = Reader::new(options);
    let mut all = Vec::new();
    for byte in program.bytes() {
        all.extend(reader.byte(byte)?);
    }
    all.extend(reader.finish()?);
    Ok(all)
}

fn read(program: &str) -> Vec<Instruction> {
    read_with(Options::default(), program).unwrap()
}

fn complaint(program: &str) -> String {
    read_with(Options::default(), program)
        .unwrap_err()
        .to_string()
}

fn line(x: i64, y: i64, z: i64, mm_per_minute: u32) -> Instruction {
    Instruction::Line {
        to: [x, y, z],
        feed: Feed::Rate(((u64::from(mm_per_minute) * 100_000 + 3) / 6) as u32),
    }
}

fn rapid(x: i64, y: i64, z: i64) -> Instruction {
    Instruction::Line {
        to: [x, y, z],
        feed: Feed::Rapid,
    }
}

fn arc(to: Place, center: [i64; 2], clockwise: bool) -> Instruction {
    Instruction::Arc(Arc {
        to,
        center,
        clockwise,
        feed: Feed::Rate(1_000_000_000),
    })
}

#[test]
fn lines_modes_and_comments() {
    let program =
        "%\n(part) G21 G90 G17\nN10 g0x1.5 y-2 ; go\nG1 Z-.25 F600\nX2\n\nM2\nwhatever comes now\n";
    assert_eq!(
        read(program),
        [
            rapid(1_500_000, -2_000_000, 0),
            line(1_500_000, -2_000_000, -250_000, 600),
            line(2_000_000, -2_000_000, -250_000, 600),
            Instruction::End
        ]
    );
}

#[test]
fn inches_are_exact_and_so_are_sums_of_them() {
    assert_eq!(read("G20 G0 X1 Y0.0001"), [rapid(25_400_000, 2_540, 0)]);
    let mut program = String::from("G20 G91\n");
    for _ in 0..1000 {
        program.push_str("G0 X0.001\n");
    }
    assert_eq!(read(&program).last(), Some(&rapid(25_400_000, 0, 0)));
}

#[test]
fn feed_in_inches_is_inches_per_minute() {
    let expected = Instruction::Line {
        to: [25_400_000, 0, 0],
        feed: Feed::Rate(4_233_333),
    };
    assert_eq!(read("G20 G1 X1 F10"), [expected]);
}

#[test]
fn relative_and_offset_coordinates() {
    assert_eq!(
        read("G0 X10 Y10\nG92 X0\nG0 X5 Y5\nG91 X1 Y1\nG90 G0 X0 Y0"),
        [
            rapid(10_000_000, 10_000_000, 0),
            rapid(15_000_000, 5_000_000, 0),
            rapid(16_000_000, 6_000_000, 0),
            rapid(10_000_000, 0, 0)
        ]
    );
}

#[test]
fn a_dwell_is_at_most_a_week() {
    let week = Instruction::Dwell {
        micros: DWELL_LONGEST,
    };
    assert_eq!(read("G4 P604800\n"), [week]);
    for text in ["G4 P604800.001\n", "G4 S1000000\n", "G4 P-1\n"] {
        let complaint = complaint(text);
        assert!(complaint.contains("at most a week"), "{text}: {complaint}");
    }
    // 2^64 microseconds, and one less.
    for text in ["G4 P18446744073709.551616\n", "G4 P18446744073709.551615\n"] {
        assert!(read_with(Options::default(), text).is_err(), "{text}");
    }
}

#[test]
fn a_dwell_is_in_seconds_unless_milliseconds_are_asked_for() {
    let p = "G4 P1.5\nG4 S2";
    let dwell = |micros| Instruction::Dwell { micros };
    assert_eq!(read(p), [dwell(1_500_000), dwell(2_000_000)]);
    let marlin = Options {
        dwell: DwellUnit::Milliseconds,
    };
    assert_eq!(
        read_with(marlin, p).unwrap(),
        [dwell(1_500), dwell(2_000_000)]
    );
}

#[test]
fn home_forgets_the_offset_of_the_axes_it_homes() {
    assert_eq!(
        read("G0 X3 Y4\nG92 X0 Y0\nG28 X0\nG0 X1 Y1\nG28"),
        [
            rapid(3_000_000, 4_000_000, 0),
            Instruction::Home {
                axes: [true, false, false]
            },
            rapid(1_000_000, 5_000_000, 0),
            Instruction::Home { axes: [true; 3] }
        ]
    );
}

#[test]
fn the_tool_is_an_output_and_goes_before_the_motion_of_its_line() {
    assert_eq!(
        read("M3 G0 X1\nM5"),
        [
            Instruction::Aux { bits: 1 },
            rapid(1_000_000, 0, 0),
            Instruction::Aux { bits: 0 }
        ]
    );
}

#[test]
fn arcs_by_centre_by_radius_and_full_circles() {
    let half = [20_000_000, 0, 0];
    assert_eq!(
        read("G2 X20 I10 F60000"),
        [arc(half, [10_000_000, 0], true)]
    );
    assert_eq!(
        read("G3 X20 R10 F60000"),
        [arc(half, [10_000_000, 0], false)]
    );
    // A quarter from (0, 0) to (10, 10): counterclockwise and short, with the centre to the
    // left of the path.
    let quarter = [10_000_000, 10_000_000, 0];
    assert_eq!(
        read("G3 X10 Y10 R10 F60000"),
        [arc(quarter, [0, 10_000_000], false)]
    );
    assert_eq!(
        read("G2 X10 Y10 R10 F60000"),
        [arc(quarter, [10_000_000, 0], true)]
    );
    assert_eq!(
        read("G3 X10 Y10 R-10 F60000"),
        [arc(quarter, [10_000_000, 0], false)]
    );
    assert_eq!(
        read("G2 X10 Y10 R-10 F60000"),
        [arc(quarter, [0, 10_000_000], true)]
    );
    assert_eq!(read("G2 I5 F60000"), [arc([0; 3], [5_000_000, 0], true)]);
    assert_eq!(
        read("G2 X0 Y0 J5 Z-1 F60000"),
        [arc([0, 0, -1_000_000], [0, 5_000_000], true)]
    );
}

#[test]
fn a_half_circle_by_a_rounded_radius_is_a_half_circle() {
    let Instruction::Arc(arc) = read("G2 X1 Y1 R.7071 F100")[0] else {
        panic!("no arc");
    };
    assert_eq!(arc.center, [500_000, 500_000]);
}

#[test]
fn checksums_are_kept_and_garbled_lines_refused() {
    let text = "N3 G1 X10 F60000";
    let sum = text.bytes().fold(0, |sum, byte| sum ^ byte);
    assert_eq!(read(&std::format!("{text}*{sum}\r\n")).len(), 1);
    let garbled = std::format!("{}*{sum}\n", text.replace("X10", "X90"));
    assert!(
        complaint(&garbled).starts_with("line 1, column 17: checksum "),
        "{}",
        complaint(&garbled)
    );
}

#[test]
fn what_is_not_supported_says_line_and_column() {
    for (program, message) in [
        ("G0 X1\nG0 X2 G99", "line 2, column 7: G99 is not supported"),
        ("G0 X1\n\n  M6 T1", "line 3, column 3: M6 is not supported"),
        (
            "G1 X1 F100 A3",
            "line 1, column 12: A words are not supported",
        ),
        ("G18", "line 1, column 1: G18 is not supported"),
        ("G90.1", "line 1, column 1: G90.1 is not supported"),
        ("G1.05 X1", "line 1, column 1: G1 is not supported"),
        ("M3 S1000", "line 1, column 4: no code of this line uses S"),
        ("#1=5", "line 1, column 1: '#' does not begin a word"),
        ("/G0 X1", "line 1, column 1: '/' does not begin a word"),
        ("G0 X", "line 1, column 4: X without a number"),
        ("G0 X1 X2", "line 1, column 7: X twice"),
        (
            "G0 G1 X2",
            "line 1, column 4: this excludes another code of the line",
        ),
        (
            "G20 G21",
            "line 1, column 5: this excludes another code of the line",
        ),
        ("G0 (open", "line 1, column 4: a comment that does not end"),
        (
            "X1",
            "line 1, column 1: axis words, but no G0, G1, G2 or G3 so far",
        ),
        (
            "G1 X1",
            "line 1, column 1: a feed is needed, but no F so far",
        ),
        (
            "F0",
            "line 1, column 1: F must be above 0 and below 257 m/min",
        ),
        (
            "F-5",
            "line 1, column 1: F must be above 0 and below 257 m/min",
        ),
        (
            "G4",
            "line 1, column 1: G4 needs one of P and S, not below 0 and at most a week",
        ),
        (
            "G4 P-1",
            "line 1, column 4: G4 needs one of P and S, not below 0 and at most a week",
        ),
        (
            "G28 X5",
            "line 1, column 5: G28 homes the axes; a number other than 0 has no meaning here",
        ),
        ("G92", "line 1, column 1: G92 without an axis"),
        (
            "F9 G2 X1",
            "line 1, column 1: an arc needs either R, or I and J",
        ),
        (
            "F9 G2 X1 R1 I1",
            "line 1, column 10: an arc needs either R, or I and J",
        ),
        (
            "F9 G2 R1",
            "line 1, column 7: a full circle needs I and J: R fits any number of them",
        ),
        (
            "F9 G2 X3 R1",
            "line 1, column 10: the ends are further apart than twice R",
        ),
        (
            "F9 G2 X3 I1",
            "line 1, column 10: the end is 1.000 mm off the circle",
        ),
        ("G0 X1 I1", "line 1, column 7: no code of this line uses I"),
        ("G0 X1 P1", "line 1, column 7: no code of this line uses P"),
        ("G0 X20000", "line 1, column 4: more than 10 m from home"),
        ("G0 X2000000", "line 1, column 4: a number beyond a million"),
    ] {
        assert_eq!(complaint(program), message, "{program}");
    }
    let long = "G0 X1 ".repeat(50);
    assert_eq!(
        complaint(&long),
        "line 1, column 257: more than 256 bytes or 32 words"
    );
}

#[test]
fn a_refused_line_changes_nothing() {
    let mut reader = Reader::default();
    reader.line(b"G1 X1 F60000").unwrap();
    reader.line(b"G91 G20 X5 F1 Q7").unwrap_err();
    let next: Vec<Instruction> = reader.line(b"X2").unwrap().collect();
    assert_eq!(next, [line(2_000_000, 0, 0, 60_000)]);
}

#[test]
fn statements_of_what_is_the_case_are_accepted() {
    assert_eq!(read("G17 G40 G49 G54 G80 G91.1 G94"), []);
}

proptest! {
    #[test]
    fn no_bytes_make_it_panic(program in proptest::collection::vec(any::<u8>(), 0..600)) {
        let mut reader = Reader::default();
        for byte in program {
            let _ = reader.byte(byte);
        }
        let _ = reader.finish();
    }

    #[test]
    fn no_words_make_it_panic(program in "([GMXYZIJRFPSN%(;*] ?-?[0-9]{0,8}\\.?[0-9]{0,12} ?){0,20}(\n[GXYIJR]-?[0-9]{1,7}){0,9}") {
        let mut reader = Reader::default();
        for byte in program.bytes() {
            let _ = reader.byte(byte);
        }
        let _ = reader.finish();
    }

    #[test]
    fn a_number_is_read_as_it_is_written(nm in -9_999_999_999i64..=9_999_999_999) {
        let (sign, size) = (if nm < 0 { "-" } else { "" }, nm.abs());
        let text = std::format!("G0 X{sign}{}.{:06}", size / 1_000_000, size % 1_000_000);
        prop_assert_eq!(read(&text), [rapid(nm, 0, 0)]);
    }

    #[test]
    fn the_centre_of_an_arc_by_radius_is_at_that_radius(x in -1_000_000i64..1_000_000, y in -1_000_000i64..1_000_000, more in 0i64..3_000_000, negative: bool) {
        prop_assume!((x, y) != (0, 0));
        let radius = hypot(x, y) / 2 + 1 + more;
        let mm = |nm: i64| std::format!("{}{}.{:06}", if nm < 0 { "-" } else { "" }, nm.abs() / 1_000_000, nm.abs() % 1_000_000);
        let text = std::format!("G2 X{} Y{} R{} F100", mm(x), mm(y), mm(if negative { -radius } else { radius }));
        let Instruction::Arc(arc) = read(&text)[0] else { panic!("no arc") };
        prop_assert!((hypot(arc.center[0], arc.center[1]) - radius).abs() <= 2);
        prop_assert!((hypot(arc.center[0] - x, arc.center[1] - y) - radius).abs() <= 2);
    }
}
