//! FPGA G's words from the tool and from the example in Python, to the pins.

use ferrocnc_tests::drawing;
use ferrocnc_tests::pins::{Event, Pin};
use ferrocnc_tests::plotter::Plotter;
use ferrocnc_tests::{program, root};
use std::fmt::Write as _;
use std::io::Write as _;
use std::path::PathBuf;
use std::process::{Command, Output, Stdio};

/// 700 steps there with the pen down, 180 back with the pen up.
const EXAMPLE: &str = "host/examples/plotter/words.txt";
/// 10 steps with X.
const SHORT: &str = "GCODE 0x01600001 0x01f40005 0x000001f4 0x00050000\n";

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

fn machine() -> String {
    drawing::folder().join("machine.toml").display().to_string()
}

/// `ferrocnc words`: whether it succeeded, and what it said: on stdout, on stderr.
fn words(plotter: &Plotter, more: &[&str]) -> (bool, String, String) {
    let mut tool = Command::new(program("ferrocnc"));
    tool.args(["words", &plotter.jobs.to_string()]);
    let Output {
        status,
        stdout,
        stderr,
    } = tool.args(more).output().expect("the tool runs");
    (status.success(), text(&stdout), text(&stderr))
}

/// A file of these lines.
fn file(name: &str, lines: &str) -> PathBuf {
    let name = format!("ferrocnc-words-{}-{name}", std::process::id());
    let file = std::env::temp_dir().join(name);
    std::fs::write(&file, lines).expect("a file");
    file
}

/// The pulses of X in order, true forward, and where the pen switched.
fn drawn(events: &[Event]) -> (Vec<bool>, Vec<(usize, bool)>) {
    let (mut pulses, mut pen) = (Vec::new(), Vec::new());
    for (_, pin) in events {
        match *pin {
            Pin::Step { axis, forward } => {
                assert_eq!(axis, 0);
                pulses.push(forward);
            }
            Pin::Tool(down) => pen.push((pulses.len(), down)),
        }
    }
    (pulses, pen)
}

/// What the example does.
fn is_the_example(plotter: Plotter) {
    let (pulses, pen) = drawn(&plotter.events());
    let there: Vec<bool> = [vec![true; 700], vec![false; 180]].concat();
    assert_eq!((pulses.len(), pulses == there), (880, true));
    assert_eq!(pen, [(0, true), (700, false)]);
}

#[test]
fn a_file_of_words_moves_the_motors_to_the_step_and_shows_the_status() {
    let plotter = Plotter::twin();
    let example = root().join(EXAMPLE).display().to_string();
    let (ok, said, wrong) = words(&plotter, &[&example, "--machine", &machine()]);
    assert!(ok, "{said}{wrong}");
    let told: Vec<Vec<&str>> = said
        .lines()
        .map(|line| line.split_whitespace().skip(1).collect())
        .collect();
    let normal = |command| vec![command, "normal"];
    let expected = [
        normal("GCODE"),
        normal("START"),
        normal("STATUS"),
        normal("GCODE"),
        vec!["steps", "[520,", "0,", "0]"],
    ];
    assert_eq!(told, expected, "{said}");
    is_the_example(plotter);
}

#[test]
fn words_come_from_the_keyboard_and_a_wrong_line_is_said_and_does_no_harm() {
    let plotter = Plotter::twin();
    let mut tool = Command::new(program("ferrocnc"));
    tool.args(["--json", "words", &plotter.jobs.to_string()]);
    tool.args(["--machine", &machine()]);
    tool.stdin(Stdio::piped()).stdout(Stdio::piped());
    let mut child = tool.stderr(Stdio::piped()).spawn().expect("the tool runs");
    let mut keys = child.stdin.take().expect("its keyboard");
    write!(keys, "status\nSTRAT\nGCODE 1 2 3\n{SHORT}START\n").expect("it reads");
    drop(keys);
    let output = child.wait_with_output().expect("it ends");
    let (said, wrong) = (text(&output.stdout), text(&output.stderr));
    assert!(!output.status.success(), "{said}{wrong}");
    for complaint in [
        "line 2: \"STRAT\" is not a command; write STATUS, START, STOP, EMPTY, or GCODE",
        "line 3: GCODE has 3 words; write the 4 of a move",
        "2 of 5 lines were refused",
    ] {
        assert!(wrong.contains(complaint), "{complaint}: {wrong}");
    }
    let told: Vec<serde_json::Value> = said
        .lines()
        .map(|line| serde_json::from_str(line).expect("JSON"))
        .collect();
    assert_eq!(told[0]["command"], "STATUS", "{said}");
    assert_eq!(told[0]["bits"], serde_json::json!([]), "{said}");
    // With wrong lines among them the tool does not wait for the others: the board is given back.
    assert_eq!(told.len(), 3, "{said}");
    drop(plotter.events());
}

#[test]
fn nothing_of_a_file_with_a_wrong_line_is_sent() {
    let plotter = Plotter::twin();
    let wrong = file("wrong", &format!("{SHORT}START\nGCODE 0x02000000 0 0 0\n"));
    let shown = wrong.display().to_string();
    let (ok, said, told) = words(&plotter, &[&shown, "--machine", &machine()]);
    let complaint =
        format!("{shown}: line 3: instruction 2 is not a move; the command of a move is 1");
    assert!(
        !ok && said.is_empty() && told.contains(&complaint),
        "{told}"
    );
    assert_eq!(plotter.events().len(), 0);
    let _ = std::fs::remove_file(wrong);
}

#[test]
fn what_the_board_refuses_is_said_with_the_line_and_the_remedy() {
    let plotter = Plotter::twin();
    let short = file("short", SHORT);
    let said = words(&plotter, &[&short.display().to_string()]).2;
    assert!(
        said.contains("line 1: ") && said.contains("; --machine MACHINE.toml sends one"),
        "{said}"
    );
    // 64 * 65535 steps/s^2 for 20000 steps.
    let fast = file(
        "fast",
        "GCODE 0x01600001 0xffff4e20 0x0000ffff 0x4e200000\n",
    );
    let said = words(
        &plotter,
        &[&fast.display().to_string(), "--machine", &machine()],
    );
    assert!(!said.0 && said.1.contains("DISPATCHERROR"), "{said:?}");
    assert!(
        said.2
            .contains("line 1: the board refuses the instruction: a motor would jump"),
        "{said:?}"
    );
    let full = file("full", &SHORT.repeat(65));
    let said = words(&plotter, &[&full.display().to_string()]);
    assert!(!said.0 && said.1.contains("   65 GCODE  FULL"), "{said:?}");
    let waiting = "64 instructions wait on the board; START executes them";
    assert!(said.2.contains(waiting), "{said:?}");
    assert!(
        said.2.contains("line 65: the queue of the board is full and nothing is executed; put START before this line"),
        "{said:?}"
    );
    assert_eq!(plotter.events().len(), 0);
    for file in [short, fast, full] {
        let _ = std::fs::remove_file(file);
    }
}

#[test]
fn more_instructions_than_the_queue_holds_wait_for_their_place() {
    let plotter = Plotter::twin();
    let mut lines = String::from("START\n");
    for _ in 0..150 {
        let _ = write!(lines, "{SHORT}");
    }
    let file = file("many", &lines);
    let shown = file.display().to_string();
    let (ok, said, wrong) = words(&plotter, &[&shown, "--machine", &machine()]);
    assert!(
        ok && said.ends_with("at steps [1500, 0, 0]\n"),
        "{said}{wrong}"
    );
    assert_eq!(drawn(&plotter.events()).0, vec![true; 1500]);
    let _ = std::fs::remove_file(file);
}

#[test]
fn the_example_in_python_sends_the_same_file() {
    let plotter = Plotter::twin();
    let mut board = plotter.board();
    let told = board.put_machine(&drawing::machine().to_board());
    told.expect("a machine");
    board.hang_up();
    let output = Command::new("python3")
        .arg(root().join("host/examples/words.py"))
        .args([plotter.jobs.to_string()])
        .arg(root().join(EXAMPLE))
        .output()
        .expect("Python is there");
    let (said, wrong) = (text(&output.stdout), text(&output.stderr));
    assert!(output.status.success(), "{said}{wrong}");
    let told: Vec<&str> = said.lines().map(str::trim_end).collect();
    assert_eq!(told[..4], ["GCODE 0", "START 0", "STATUS 0", "GCODE 0"]);
    // Silent, it counts as gone; by then it is done.
    plotter.finish(&mut board);
    drop(board);
    is_the_example(plotter);
}
