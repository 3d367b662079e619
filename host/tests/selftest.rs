//! `ferrocnc selftest` at the command line: its question before it arms anything, and the place of
//! its report. What it finds is tested on the twin (`tests/tests/selftest`).

#[path = "common/fake_board.rs"]
mod common;
#[path = "common/tool.rs"]
mod tool;

use common::{FakeBoard, Time};
use std::process::{Command, Stdio};

/// As few looks as there can be: the fake board has no clock to look at and nothing to find.
const SHORT: [&str; 4] = ["--seconds", "0.5", "--questions", "5"];

#[test]
fn a_report_is_written_as_text_and_as_json_and_a_bad_finding_ends_in_an_error() {
    let board = FakeBoard::mill6(Time::Wall);
    board.look().knobs.ways = [10, 1000, wire::LongWay::Frame as u32];
    let folder = std::env::temp_dir().join(format!("ferrocnc-selftest-{}", std::process::id()));
    std::fs::create_dir_all(&folder).expect("a folder");
    for ending in ["txt", "json"] {
        let file = folder.join(format!("card.{ending}"));
        let at = board.text();
        let mut arguments = vec!["selftest", &at, "--report", file.to_str().expect("a path")];
        arguments.extend(SHORT);
        let output = tool::tool(&arguments);
        let said = String::from_utf8_lossy(&output.stdout).into_owned();
        let error = String::from_utf8_lossy(&output.stderr).into_owned();
        // A fake board's wall clock stands.
        assert!(
            !output.status.success() && error.contains("findings are bad"),
            "{error}"
        );
        assert!(said.contains("system clock"), "{said}");
        assert!(said.contains("TOS or TTL from frame to frame"), "{said}");
        let report = std::fs::read_to_string(&file).expect("the report");
        match ending {
            "txt" => assert_eq!(report, said),
            _ => {
                let report: serde_json::Value = serde_json::from_str(&report).expect("JSON");
                assert!(report["bad"].as_u64() > Some(0), "{report}");
            }
        }
    }
    std::fs::remove_dir_all(&folder).expect("our folder");
}

#[test]
fn nothing_is_armed_before_yes_was_said() {
    let board = FakeBoard::mill6(Time::Wall);
    let asked = |arguments: &[&str]| {
        let output = Command::new(env!("CARGO_BIN_EXE_ferrocnc"))
            .args(["selftest", &board.text()])
            .args(SHORT)
            .args(arguments)
            .stdin(Stdio::null())
            .output()
            .expect("the tool runs");
        (
            output.status.success(),
            String::from_utf8_lossy(&output.stderr).into_owned(),
        )
    };
    for arguments in [&["--outputs"][..], &["--loop", "stepgen.0=encoder.0"]] {
        let before = board.look().exchanges;
        let (ok, said) = asked(arguments);
        assert!(!ok && said.contains("nothing was armed"), "{said}");
        assert!(
            said.contains("pull the plugs of every motor driver"),
            "{said}"
        );
        assert_eq!(board.look().exchanges, before);
    }
    assert!(
        asked(&["--loop", "stepgen.0=encoder.0"])
            .1
            .contains("3.3 V")
    );
}

#[test]
fn the_help_says_which_options_arm_the_board() {
    let help = tool::answer(&["selftest", "--help"]);
    assert_eq!(help.matches("Arm the board").count(), 2, "{help}");
}

#[test]
fn a_jumper_that_cannot_be_is_refused_with_the_way_to_say_it() {
    let board = FakeBoard::mill6(Time::Wall);
    for (jumper, said) in [
        ("x", "is not SOURCE=SINK"),
        (
            "nowhere=encoder.0",
            "no stepgen, no output, no pwm of this board",
        ),
        ("stepgen.6=encoder.0", "no stepgen"),
        ("stepgen.0=encoder.9", "no encoder, no input"),
        ("output.0=encoder.0", "an encoder counts steps"),
        ("output.0.dir=input.0", "no stepgen"),
    ] {
        let complaint = tool::complaint(&["selftest", &board.text(), "--loop", jumper]);
        assert!(complaint.contains(said), "{jumper}: {complaint}");
    }
}
