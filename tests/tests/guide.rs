//! The guide followed as a reader would: each command that its pages print, in order, by a shell,
//! in a folder that has what a checkout has. The boards are twins, at the addresses that are
//! printed: a network namespace has the reader's `eth1`.
//!
//! [`ELSEWHERE`] names the commands that another test runs, and [`NOT_HERE`] those that no test can
//! run as they are printed, with the reason and with what is checked instead. A command of a page
//! that is in no list fails the first test.

use ferrocnc_tests::flash::{FIRST, UID, factory};
use ferrocnc_tests::hal::out;
use ferrocnc_tests::lan::{Lan, Place};
use ferrocnc_tests::{Simulator, program, root};
use sim::nor::Part;
use std::io::{BufRead as _, BufReader};
use std::os::unix::fs::{PermissionsExt as _, symlink};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};

/// Commands that this file runs, by their beginning.
const HERE: [&str; 15] = [
    "export PATH=",
    "cargo run --release -p ferrocnc-sim -- ",
    "linuxcnc host/examples/mill/mill.ini",
    "ferrocnc flash write ",
    "sudo ip address add ",
    "ferrocnc discover",
    "ferrocnc selftest ",
    "ferrocnc describe ",
    "ferrocnc doctor ",
    "ferrocnc job send 192.168.2.50 ",
    "ferrocnc job home 192.168.2.50",
    "ferrocnc job start 192.168.2.50 ",
    "ferrocnc job pause 192.168.2.50",
    "ferrocnc job continue 192.168.2.50",
    "ferrocnc job stop 192.168.2.50",
];

/// Commands that another test runs: their beginning, and the test.
const ELSEWHERE: [(&str, &str); 17] = [
    ("ferrocnc test ", "tests/tests/tryout/main.rs"),
    ("ferrocnc machine ", "host/tests/pages.rs"),
    ("ferrocnc-sim --backend model ", "tests/tests/machines.rs"),
    ("linuxcnc mill.ini", "tests/tests/machines.rs"),
    ("linuxcnc mill-twin.ini", "tests/tests/machines.rs"),
    ("ferrocnc config new ", "host/tests/pages.rs"),
    ("ferrocnc config check ", "host/tests/pages.rs"),
    ("ferrocnc config show ", "host/tests/pages.rs"),
    ("ferrocnc config pinout ", "host/tests/pages.rs"),
    ("ferrocnc config first-light ", "host/tests/pages.rs"),
    ("ferrocnc panel ", "host/tests/pages.rs"),
    ("sudo ferrocnc doctor ", "host/tests/soak.rs"),
    (
        "setp ferrocnc.0.exchange.reset ",
        "host/tests/exchange_times.rs",
    ),
    ("ferrocnc job prepare ", "host/tests/pages.rs"),
    ("ferrocnc job check ", "host/tests/pages.rs"),
    ("ferrocnc job preview ", "host/tests/pages.rs"),
    ("ferrocnc job ", "tests/tests/jobs/guide.rs"),
];

/// Commands that no test runs as they are printed: their beginning, why, and what is checked.
const NOT_HERE: [(&str, &str); 5] = [
    (
        "halrun -I mill6-first-light.hal",
        "it waits at a prompt; tests/tests/twin.rs gives a file like it and what it says to halrun",
    ),
    (
        "cargo xtask setup",
        "it installs packages; every level of the pyramid begins with it, xtask parses the line",
    ),
    (
        "cargo build --release -p ferrocnc",
        "the level builds it before its tests; below, the shell finds what it has made",
    ),
    (
        "sudo ln -sf $PWD/target/release/libferrocnc.so /usr/lib/linuxcnc/modules/ferrocnc.so",
        "it changes this computer; the level installs that file there, which LinuxCNC then loads",
    ),
    (
        "cargo xtask bitstream ",
        "it takes minutes; the level `bitstream` builds the smallest board so, xtask parses the line",
    ),
];

/// The lines of a page's shell blocks, with the number of their line.
fn printed(page: &str) -> Vec<(usize, String)> {
    let path = root().join("docs/guide").join(page);
    let text = std::fs::read_to_string(path).expect("a page");
    let (mut fenced, mut shell, mut lines) = (false, false, Vec::new());
    for (number, line) in (1..).zip(text.lines()) {
        if let Some(language) = line.trim_start().strip_prefix("```") {
            fenced = !fenced;
            shell = fenced && language.is_empty();
        } else if shell {
            lines.push((number, line.trim().to_owned()));
        }
    }
    lines
}

/// The one line of a page that begins so.
fn line(page: &str, begins: &str) -> String {
    let all = printed(page).into_iter().map(|(_, line)| line);
    let mut found: Vec<String> = all.filter(|line| line.starts_with(begins)).collect();
    assert!(!found.is_empty(), "docs/guide/{page} has no `{begins}`");
    found.swap_remove(0)
}

const PAGES: [&str; 9] = [
    "breakout.md",
    "first-light.md",
    "first-machine.md",
    "jobs.md",
    "machine.md",
    "plotter.md",
    "test.md",
    "troubleshooting.md",
    "tuning.md",
];

#[test]
fn every_printed_command_is_run_or_it_is_said_why_not() {
    let pages = std::fs::read_dir(root().join("docs/guide")).expect("the guide");
    assert_eq!(pages.count(), PAGES.len(), "a page is not read here");
    let known: Vec<&str> = HERE.into_iter().chain(ELSEWHERE.map(|it| it.0)).collect();
    let known: Vec<&str> = known.into_iter().chain(NOT_HERE.map(|it| it.0)).collect();
    let mut seen = vec![false; known.len()];
    for page in PAGES {
        for (number, line) in printed(page) {
            let at = known.iter().position(|begins| line.starts_with(begins));
            let at = at.unwrap_or_else(|| panic!("docs/guide/{page}:{number}: {line}: not run"));
            seen[at] = true;
        }
    }
    let unseen = known.iter().zip(seen).filter(|(_, seen)| !seen);
    let unseen: Vec<_> = unseen.map(|(begins, _)| begins).collect();
    assert!(unseen.is_empty(), "the guide prints no {unseen:?}");
}

/// A reader with a shell, in a checkout of their own.
struct Reader<'lan> {
    checkout: PathBuf,
    place: &'lan Place,
}

/// Ends with the test.
struct Ends(Child);

impl Drop for Ends {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

impl<'lan> Reader<'lan> {
    /// In a new folder, with the programs that the level has built, and a cable whose board is
    /// `board.bin`.
    fn new(name: &str, place: &'lan Place) -> Self {
        let name = format!("ferrocnc-guide-{name}-{}", std::process::id());
        let checkout = std::env::temp_dir().join(name);
        let _ = std::fs::remove_dir_all(&checkout);
        let release = checkout.join("target/release");
        std::fs::create_dir_all(&release).expect("a folder");
        std::fs::create_dir_all(checkout.join("bin")).expect("a folder");
        for name in ["boards", "host", "tests"] {
            symlink(root().join(name), checkout.join(name)).expect("a link");
        }
        symlink(program("ferrocnc"), release.join("ferrocnc")).expect("a link");
        let cable = root().join("host/tests/fake-openFPGALoader.sh");
        symlink(cable, checkout.join("bin/openFPGALoader")).expect("a link");
        let sudo = checkout.join("bin/sudo");
        std::fs::write(&sudo, "#!/bin/sh\nexec \"$@\"\n").expect("a file");
        let mode = std::fs::Permissions::from_mode(0o755);
        std::fs::set_permissions(&sudo, mode).expect("it can run");
        Reader { checkout, place }
    }

    /// A shell of the reader, which has done what step 2 says, with this line.
    fn shell(&self, line: &str) -> Command {
        let path = self::line("first-machine.md", "export PATH=");
        let mut shell = self.place.command("bash");
        shell.arg("-c").arg(format!("{path}; {line}"));
        let bin = self.checkout.join("bin").display().to_string();
        let system = std::env::var("PATH").unwrap_or_default();
        shell.env("PATH", format!("{bin}:{system}"));
        shell.env("FAKE", "fine");
        shell.env("FAKE_LOG", self.checkout.join("cable.log"));
        shell.env("FAKE_FLASH", self.checkout.join("board.bin"));
        shell.current_dir(&self.checkout).stdin(Stdio::null());
        shell
    }

    /// Types a line; it has to succeed. What it printed.
    fn types(&self, line: &str) -> String {
        let (output, said) = self.tries(line);
        assert!(output.status.success(), "{line}\n{said}");
        said
    }

    fn tries(&self, line: &str) -> (Output, String) {
        let output = self.shell(line).output().expect("a shell");
        let said = [&output.stdout, &output.stderr].map(|it| String::from_utf8_lossy(it));
        let said = said.concat();
        (output, said)
    }
}

impl Drop for Reader<'_> {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.checkout);
    }
}

/// The network of step 8: the reader's computer, whose `eth1` has no address yet, and a place for a
/// board.
fn cable() -> (Lan, Place, Place) {
    let mut lan = Lan::new();
    let (computer, board) = (lan.plug(None), lan.plug(None));
    computer.ip("link set eth0 down");
    computer.ip("link set eth0 name eth1");
    computer.ip("link set eth1 up");
    (lan, computer, board)
}

const FIRST_MACHINE: &str = "first-machine.md";

#[test]
fn a_new_card_is_flashed_found_tested_and_watched() {
    let (_lan, computer, place) = cable();
    let reader = Reader::new("card", &computer);
    let found = reader.types("command -v ferrocnc");
    assert!(
        found.trim().ends_with("/target/release/ferrocnc"),
        "{found}"
    );

    // Step 6 takes minutes: a small image instead, which an ECP5 loads.
    let flash = factory(Part::W25Q32JV, UID);
    let folder = reader.checkout.join("target/bitstream/mill");
    std::fs::create_dir_all(&folder).expect("a folder");
    std::fs::write(folder.join("mill.flash"), flash.cells()).expect("the image");
    let said = reader.types(&line(FIRST_MACHINE, "ferrocnc flash write "));
    assert!(said.contains(&format!("{FIRST:08x}")), "{said}");

    // Off and on: the board has what the cable has written.
    let _board = Simulator::at(&place, &reader.checkout.join("board.bin"), UID);
    reader.types(&line(FIRST_MACHINE, "sudo ip address add "));
    let said = reader.types(&line(FIRST_MACHINE, "ferrocnc discover"));
    assert!(said.contains("192.168.2.50"), "{said}");
    // The twin's clock is this computer's, which other programs hold up.
    let (_, said) = reader.tries(&line(FIRST_MACHINE, "ferrocnc selftest "));
    let bad = said.lines().filter(|line| line.starts_with("BAD "));
    let bad: Vec<&str> = bad
        .filter(|line| !line.contains(" system clock "))
        .collect();
    assert!(
        bad.is_empty() && said.contains("questions answered"),
        "{said}"
    );
    let report = std::fs::read_to_string(reader.checkout.join("card.txt"));
    assert!(
        report.is_ok_and(|report| report.contains("golden")),
        "{said}"
    );
    let said = reader.types(&line(FIRST_MACHINE, "ferrocnc describe "));
    assert!(said.contains("5A-75B V8.0"), "{said}");
    // This computer is not the one that the page describes, so it may find something.
    let (_, said) = reader.tries(&line("tuning.md", "ferrocnc doctor "));
    assert!(
        said.contains("192.168.2.1/24") && said.contains("board and tool"),
        "{said}"
    );
    // A second instead of ten.
    let listen = line("tuning.md", "ferrocnc doctor 192.168.2.50 --listen");
    let (_, said) = reader.tries(&format!("{listen} 1"));
    let counted = said
        .lines()
        .find(|line| line.contains(" frames sent there"));
    assert!(counted.is_some_and(|it| it.contains(" in 1 s")), "{said}");
    let ping = line("tuning.md", "sudo ferrocnc doctor 192.168.2.50 --ping");
    let (_, said) = reader.tries(&format!("{ping} 1"));
    let may = Command::new("chrt").args(["-f", "99", "true"]).status();
    for check in [" round trip of a ping ", " the same on CPU "] {
        let found = said.lines().find(|line| line.contains(check));
        let found = found.unwrap_or_else(|| panic!("{said}"));
        let wanted = match may.as_ref().is_ok_and(|may| may.success()) {
            true => " of 1000 pings",
            false => "not measured",
        };
        assert!(found.contains(wanted), "{found}");
    }
    // The page's reader is in the configuration's folder.
    let files = line("tuning.md", "ferrocnc doctor 192.168.2.50 --ini");
    let files = files.replace("mill.ini", "host/examples/mill/mill.ini");
    let (_, said) = reader.tries(&files);
    assert!(said.contains("leaves room for every axis"), "{said}");

    let page = std::fs::read_to_string(root().join("docs/guide").join(FIRST_MACHINE));
    let page = page.expect("a page");
    let watch = "ferrocnc watch 192.168.2.50";
    assert!(page.contains(&format!("`{watch}`")), "step 10");
    let shell = reader
        .shell(&format!("exec {watch}"))
        .stdout(Stdio::piped())
        .spawn();
    let mut shell = Ends(shell.expect("a shell"));
    let mut first = String::new();
    let output = shell.0.stdout.take().expect("its output");
    let read = BufReader::new(output).read_line(&mut first);
    assert!(read.is_ok() && !first.trim().is_empty(), "{first:?}");
}

/// The words of the simulator's line, without the program.
fn simulator(page: &str) -> Vec<String> {
    let begins = "cargo run --release -p ferrocnc-sim -- ";
    let line = line(page, begins);
    let words = line.strip_prefix(begins).expect("it begins so");
    words.split_whitespace().map(str::to_owned).collect()
}

/// Step 4, and with another address step 10: E-stop off, machine on, home, a program.
///
/// Two things differ from the page. The twin's time passes with the exchanges, so a busy computer
/// is not late; and `headless.ini` types what the page says, so no screen is needed.
#[test]
fn linuxcnc_drives_the_simulated_board() {
    let begins = "linuxcnc host/examples/mill/";
    assert_eq!(line(FIRST_MACHINE, begins), format!("{begins}mill.ini"));
    let mill = root().join("host/examples/mill");
    let read = |name: &str| std::fs::read_to_string(mill.join(name)).expect("an INI file");
    let (screen, headless) = (read("mill.ini"), read("headless.ini"));
    let own = ["#", "DISPLAY = ", "HALFILE = record.hal"];
    for line in headless
        .lines()
        .filter(|line| !own.iter().any(|it| line.starts_with(it)))
    {
        assert!(screen.contains(line), "mill.ini has no {line}");
    }
    let installed = std::fs::read("/usr/lib/linuxcnc/modules/ferrocnc.so");
    let built = std::fs::read(root().join("target/release/libferrocnc.so"));
    assert!(
        installed.expect("step 4 installs it") == built.expect("step 2 builds it"),
        "LinuxCNC's module is another one"
    );
    let words = simulator(FIRST_MACHINE);
    let words = words.iter().map(|word| match word.as_str() {
        "free" => "lockstep",
        word => word,
    });
    let words: Vec<&str> = words.collect();
    assert_eq!(words[..4], ["--backend", "model", "--board", "mill6"]);
    let mut twin = Simulator::twin_of("mill6", &words[4..]);
    let folder = out("guide");
    let done = twin.linuxcnc(&folder).status();
    twin.finish();
    let said = std::fs::read_to_string(folder.join("run.log")).unwrap_or_default();
    assert!(done.is_ok_and(|done| done.success()), "{said}");
}

#[test]
fn a_job_is_sent_to_a_board_started_paused_and_stopped() {
    let (_lan, computer, place) = cable();
    let reader = Reader::new("jobs", &computer);
    reader.types(&line(FIRST_MACHINE, "sudo ip address add "));
    let mut board = place.service(program("ferrocnc-sim"));
    // The page's simulated plotter, as a board of this network.
    let words = simulator("jobs.md");
    let own = |word: &&String| word.as_str() != "--jobs" && !word.contains(":7240");
    board.args(words.iter().filter(own));
    board.args(["--interface", "eth0", "--udp", "0.0.0.0:1234"]);
    board.args(["--discovery", "0.0.0.0:51234"]);
    board.args(["--console", "0.0.0.0:23", "--jobs", "0.0.0.0:724"]);
    board.current_dir(&reader.checkout).stdout(Stdio::piped());
    let mut board = Ends(board.spawn().expect("the simulator runs"));
    let mut ready = String::new();
    let said = board.0.stdout.take().expect("its output");
    let read = BufReader::new(said).read_line(&mut ready);
    assert!(read.is_ok() && ready.starts_with("ready"), "{ready:?}");

    // "Copy host/examples/plotter/machine.toml and put in your own numbers."
    let machine = Path::new("host/examples/plotter/machine.toml");
    let copy = reader.checkout.join("machine.toml");
    std::fs::copy(reader.checkout.join(machine), copy).expect("a copy");
    reader.types(&line("jobs.md", "ferrocnc job prepare "));
    for begins in ["ferrocnc job send 192", "ferrocnc job home 192"] {
        reader.types(&line("jobs.md", begins));
    }
    let plotter = line("plotter.md", "ferrocnc job start 192");
    assert_eq!(line("jobs.md", "ferrocnc job start 192"), plotter);
    let start = reader.shell(&format!("exec {plotter}"));
    let start = { start }
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn();
    let start = start.expect("a shell");
    // Until it runs, there is nothing to be paused.
    let pause = line("jobs.md", "ferrocnc job pause ");
    let begun = std::time::Instant::now();
    while !reader.tries(&pause).0.status.success() {
        assert!(begun.elapsed().as_secs() < 60, "the job does not begin");
    }
    reader.types(&line("jobs.md", "ferrocnc job continue "));
    reader.types(&line("jobs.md", "ferrocnc job stop "));
    let ended = start.wait_with_output().expect("it ends");
    let said = [&ended.stdout, &ended.stderr]
        .map(|it| String::from_utf8_lossy(it))
        .concat();

    assert!(said.contains("ended last: stopped"), "{said}");
}
