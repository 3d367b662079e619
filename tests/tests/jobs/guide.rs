//! The guide's page on jobs, followed without a board: the commands that a reader copies, in order.
//! `host/tests/pages.rs` runs those of the other pages that need neither a board nor a simulator.

use ferrocnc_tests::{program, root};
use std::io::{BufRead as _, BufReader};
use std::net::TcpListener;
use std::path::Path;
use std::process::{Child, Command, Stdio};

/// The address on the page.
const PRINTED: &str = "127.0.0.1:7240";

/// Ends with the test.
struct Ends(Child);

impl Drop for Ends {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn free() -> String {
    let at = TcpListener::bind("127.0.0.1:0").and_then(|it| it.local_addr());
    at.expect("a free port").to_string()
}

/// The lines of a page's code blocks from this heading on, up to the next one.
fn block<'t>(page: &'t str, heading: &str) -> Vec<&'t str> {
    let from = page.split_once(&format!("\n## {heading}\n"));
    let section = from.unwrap_or_else(|| panic!("no heading {heading}")).1;
    let section = section.split("\n## ").next().expect("a part");
    let code = section.split("```").skip(1).step_by(2);
    code.flat_map(|block| block.trim().lines()).collect()
}

/// The tool as a line of the page calls it.
fn tool(line: &str, jobs: &str, folder: &Path) {
    let arguments = line.strip_prefix("ferrocnc ").expect("the tool");
    let mut command = Command::new(program("ferrocnc"));
    command.args(arguments.replace(PRINTED, jobs).split_whitespace());
    let output = command.current_dir(folder).output();
    let output = output.expect("the tool runs; `cargo xtask test jobs` builds it");
    assert!(
        output.status.success(),
        "docs/guide/jobs.md: {line}\n{}{}",
        String::from_utf8_lossy(&output.stdout),
        String::from_utf8_lossy(&output.stderr)
    );
}

#[test]
fn the_guide_is_followed_from_a_drawing_to_the_end_of_its_job_without_a_board() {
    let folder = std::env::temp_dir().join(format!("ferrocnc-guide-{}", std::process::id()));
    let _ = std::fs::remove_dir_all(&folder);
    std::fs::create_dir_all(&folder).expect("a folder");
    for name in ["host", "tests"] {
        std::os::unix::fs::symlink(root().join(name), folder.join(name)).expect("a link");
    }
    let page = std::fs::read_to_string(root().join("docs/guide/jobs.md")).expect("the page");
    let jobs = free();
    for line in block(&page, "Prepare") {
        tool(line, &jobs, &folder);
    }
    let lines = block(&page, "Try it without a board");
    let (start, lines) = lines.split_first().expect("a simulator");
    let start = start.strip_prefix("cargo run --release -p ferrocnc-sim -- ");
    let start = start.expect("a simulator").replace(PRINTED, &jobs);
    let mut simulator = Command::new(program("ferrocnc-sim"));
    simulator.args(start.split_whitespace());
    // Other tests have boards on the ports that the page leaves as they are.
    simulator.args(["--udp", &free(), "--console", &free()]);
    let simulator = simulator.current_dir(&folder).stdout(Stdio::piped());
    let mut simulator = Ends(simulator.spawn().expect("the simulator runs"));
    let mut ready = String::new();
    let said = simulator.0.stdout.take().expect("its output");
    let read = BufReader::new(said).read_line(&mut ready);
    assert!(read.is_ok() && ready.starts_with("ready"), "{ready:?}");
    assert_eq!(lines.len(), 3, "send, home, start");
    for line in lines {
        tool(line, &jobs, &folder);
    }
    let _ = std::fs::remove_dir_all(&folder);
}
