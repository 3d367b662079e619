//! The tool and the console.

use crate::rig::*;
use ferrocnc_tests::drawing;
use ferrocnc_tests::pins;
use ferrocnc_tests::plotter::Plotter;
use wire::jobs::End;

/// `ferrocnc job ...`: whether it succeeded, and what it said: on stdout, on stderr.
fn tool(arguments: &[&str]) -> (bool, String, String) {
    let mut tool = std::process::Command::new(ferrocnc_tests::program("ferrocnc"));
    let output = tool.arg("job").args(arguments).output();
    let output = output.expect("the tool runs; `cargo xtask test jobs` builds it");
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    (
        output.status.success(),
        text(&output.stdout),
        text(&output.stderr),
    )
}

#[test]
fn the_tool_sends_a_job_watches_it_to_its_end_and_says_what_is_wrong_with_the_remedy() {
    let folder = std::env::temp_dir().join(format!("ferrocnc-jobs-{}", std::process::id()));
    std::fs::create_dir_all(&folder).expect("a folder");
    let file = folder.join("square.job").display().to_string();
    let square = "G0 X5 Y5\nM3\nG1 X9 F6000\nG1 Y9\nG1 X5\nG1 Y5\nM5\nG0 X0 Y0\nM2\n";
    let mut program = program(square.as_bytes());
    program.name = "square".to_owned();
    std::fs::write(&file, program.to_job()).expect("the job");
    let machine = drawing::folder().join("machine.toml").display().to_string();
    let plotter = Plotter::twin();
    let at = plotter.jobs.to_string();

    let (ok, _, said) = tool(&["start", &at, "square"]);
    assert!(
        !ok && said.contains("ferrocnc job list shows those it has"),
        "{said}"
    );
    let (ok, said, wrong) = tool(&["send", &at, &file]);
    assert!(
        ok && said.starts_with("square is on the board: "),
        "{said}{wrong}"
    );
    let (ok, _, said) = tool(&["start", &at, "square"]);
    assert!(
        !ok && said.contains("--machine MACHINE.toml sends one"),
        "{said}"
    );
    let (ok, said, wrong) = tool(&["list", &at, "--json"]);
    let list: serde_json::Value = serde_json::from_str(&said).unwrap_or_default();
    assert!(
        ok && list["jobs"][0]["name"] == "square" && list["jobs"][0]["ready"] == true,
        "{said}{wrong}"
    );
    let (ok, said, wrong) = tool(&["start", &at, "square", "--machine", &machine, "--json"]);
    assert!(ok, "{said}{wrong}");
    let last: serde_json::Value =
        serde_json::from_str(said.lines().last().unwrap_or_default()).unwrap_or_default();
    assert_eq!(
        (&last["end"], &last["progress"], &last["state"]),
        (&"done".into(), &100.into(), &"stopped".into()),
        "{said}"
    );
    let (ok, said, _) = tool(&["status", &at]);
    assert!(ok && said.contains("ended last: done"), "{said}");
    let (ok, _, said) = tool(&["pause", &at]);
    assert!(!ok && said.contains("not now"), "{said}");
    let (ok, said, _) = tool(&["delete", &at, "square"]);
    assert!(ok && said.starts_with("square is deleted"), "{said}");
    let (ok, _, said) = tool(&["delete", &at, "square"]);
    assert!(!ok && said.contains("the board has no such job"), "{said}");
    let emitted = plotter.events();
    let drawn = pins::drawn(&program, &drawing::machine(), &emitted)
        .unwrap_or_else(|error| panic!("{error}"));
    assert!(
        drawn.deviation < 0.0225 && drawn.missing < 0.0225,
        "{} {}",
        drawn.deviation,
        drawn.missing
    );
    let _ = std::fs::remove_dir_all(&folder);
}

#[test]
fn a_job_that_was_sent_is_started_and_looked_at_from_the_console() {
    let machine = drawing::machine();
    let program = program(b"G1 X3 F6000\nG1 Y2\nM2\n");
    let plotter = Plotter::twin();
    let mut board = plotter.board();
    send(&mut board, "a line", &program);
    let at = plotter.console.to_string();
    let say = |line: &str| {
        let mut tool = std::process::Command::new(ferrocnc_tests::program("ferrocnc"));
        let output = tool.args(["console", &at, "-c", line]).output();
        String::from_utf8_lossy(&output.expect("the tool runs").stdout).into_owned()
    };
    let said = say("job list");
    assert!(said.contains("a line: "), "{said}");
    let said = say("job start a line");
    assert!(said.contains("checking: a line, 0 %"), "{said}");
    let report = plotter.finish(&mut board);
    assert_eq!((report.end, report.attended), (End::Done, false));
    let said = say("job");
    assert!(said.contains("ended last: done"), "{said}");
    let said = say("job pause");
    assert!(said.contains("refused: not now: the state"), "{said}");
    drop(board);
    let told = pins::predict(&program, &machine).unwrap_or_else(|error| panic!("{error}"));
    let difference = told.compare(&plotter.events());
    assert_eq!((difference.wrong, difference.late), (0, Some(0)));
}
