//! The guide's commands that need no board, as a reader would type them: page by page, in order, in
//! a folder that has what a checkout has. The others are parsed beside the tool's `main`.

use std::fs;
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};
use std::process::Command;

/// What runs without a board.
const HERE: [&str; 9] = [
    "ferrocnc machine ",
    "ferrocnc config new ",
    "ferrocnc config check ",
    "ferrocnc config show ",
    "ferrocnc config pinout ",
    "ferrocnc config first-light ",
    "ferrocnc job prepare ",
    "ferrocnc job check ",
    "ferrocnc job preview ",
];

/// A folder of its own for a page, with the checkout's folders that the guide names.
fn checkout(page: &str) -> PathBuf {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("guide-{page}"));
    let _ = fs::remove_dir_all(&folder);
    fs::create_dir_all(&folder).expect("a folder");
    for name in ["boards", "host", "tests"] {
        symlink(root.join(name), folder.join(name)).expect("a link");
    }
    folder
}

/// Runs a page's commands; how many there were.
fn run(page: &str) -> usize {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("../docs/guide/{page}.md"));
    let text = fs::read_to_string(path).expect("a page");
    let folder = checkout(page);
    let mut ran = 0;
    let lines = text.lines().map(str::trim_start);
    for line in lines.filter(|line| HERE.iter().any(|known| line.starts_with(known))) {
        let mut command = Command::new(env!("CARGO_BIN_EXE_ferrocnc"));
        command.current_dir(&folder);
        command.args(line.split_whitespace().skip(1));
        let done = command.output().expect("the tool starts");
        assert!(
            done.status.success(),
            "docs/guide/{page}.md: {line}\n{}{}",
            String::from_utf8_lossy(&done.stdout),
            String::from_utf8_lossy(&done.stderr)
        );
        ran += 1;
    }
    let _ = fs::remove_dir_all(&folder);
    ran
}

#[test]
fn the_first_machine_is_described_checked_and_drawn() {
    assert_eq!(run("first-machine"), 4);
}

#[test]
fn a_machine_of_one_file_is_made_checked_and_written() {
    assert_eq!(run("machine"), 6);
}

#[test]
fn the_first_light_of_a_board_is_written() {
    assert_eq!(run("first-light"), 1);
}

/// The page names a folder of the reader's.
#[test]
fn a_panel_is_written() {
    let folder = checkout("panel");
    for kind in ["pyvcp", "qtvcp"] {
        let mut command = Command::new(env!("CARGO_BIN_EXE_ferrocnc"));
        command.args(["panel", kind]).arg(&folder);
        let done = command.output().expect("the tool starts");
        let said = String::from_utf8_lossy(&done.stdout).into_owned();
        assert!(done.status.success(), "{kind}: {done:?}");
        let written = fs::read_dir(&folder).expect("a folder").count();
        // Three links are there before.
        assert!(written > 3, "{kind}: {said}");
    }
    let _ = fs::remove_dir_all(&folder);
}

#[test]
fn a_drawing_becomes_a_job() {
    assert_eq!(run("jobs"), 3);
}

#[test]
fn the_plotter_is_checked_and_drawn() {
    assert_eq!(run("plotter"), 2);
}
