//! `ferrocnc test` in a real terminal, which tmux is, on the twin: keys as a hand presses them,
//! what stands on the screen, and what the pins did. [`pins`] is the same without a terminal, to
//! the step.
//!
//! The twin is in lockstep: its time passes with the exchanges, so a busy computer makes the board
//! slow and never late.

mod pins;

use ferrocnc_tests::{Simulator, control, program, root};
use std::path::PathBuf;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

/// As long as anything may take, on a busy computer, too.
const PATIENCE: Duration = Duration::from_secs(60);

/// A terminal with the tool in it; both end with the test.
struct Terminal {
    socket: PathBuf,
}

impl Terminal {
    fn new(name: &str, arguments: &[&str]) -> Self {
        Self::behind("", name, arguments)
    }

    /// With this in front of the tool's name.
    fn behind(first: &str, name: &str, arguments: &[&str]) -> Self {
        // A socket's path may have 107 bytes.
        let socket = std::env::temp_dir().join(format!("ferrocnc-{name}-{}", std::process::id()));
        let terminal = Terminal { socket };
        let tool = program("ferrocnc").display().to_string();
        let command = [&[tool.as_str()], arguments].concat().join(" ");
        // The pane stays when the tool has ended, so that its last words can be read.
        let command = format!("{first} {command}; echo ended with $?; sleep 1000");
        let new = [
            "-f",
            "/dev/null",
            "new-session",
            "-d",
            "-x",
            "200",
            "-y",
            "40",
        ];
        terminal.tmux(&[&new[..], &[command.as_str()]].concat());
        terminal
    }

    fn tmux(&self, arguments: &[&str]) -> String {
        let done = Command::new("tmux")
            .arg("-S")
            .arg(&self.socket)
            .args(arguments)
            .env("LC_ALL", "C.UTF-8")
            .stdin(Stdio::null())
            .output()
            .expect("tmux, which `cargo xtask setup` installs");
        String::from_utf8_lossy(&done.stdout).into_owned()
    }

    fn screen(&self) -> String {
        self.tmux(&["capture-pane", "-p"])
    }

    fn press(&self, key: &str) {
        self.tmux(&["send-keys", key]);
    }

    /// Holds a key: it comes with its repeats at once, however busy the computer is.
    fn hold(&self, key: &str) {
        self.tmux(&["send-keys", "-N", "3", key]);
    }

    /// Waits until the screen says so.
    fn wait(&self, text: &str) -> String {
        self.until(&format!("{text:?}"), || {
            let screen = self.screen();
            screen.contains(text).then_some(screen)
        })
    }

    fn until<T>(&self, what: &str, mut is: impl FnMut() -> Option<T>) -> T {
        let end = Instant::now() + PATIENCE;
        loop {
            if let Some(found) = is() {
                return found;
            }
            assert!(Instant::now() < end, "never: {what}\n{}", self.screen());
            std::thread::sleep(Duration::from_millis(20));
        }
    }
}

impl Drop for Terminal {
    fn drop(&mut self) {
        self.tmux(&["kill-server"]);
        let _ = std::fs::remove_file(&self.socket);
    }
}

/// Between two exchanges of the tool.
const PERIOD: Duration = Duration::from_millis(5);

/// A twin whose time passes with the exchanges.
fn twin() -> Simulator {
    let period = PERIOD.as_nanos().to_string();
    Simulator::twin(&["--mode", "lockstep", "--period-ns", &period])
}

/// The levels of the outputs' pins.
fn outputs(twin: &Simulator) -> u64 {
    let levels = twin.told("pins", "gpio_out");
    u64::from_str_radix(levels.trim_start_matches("0x"), 16).expect("levels")
}

/// `machine.toml` of the mill, for the board mill6.
fn machine(name: &str) -> PathBuf {
    let folder = root().join("target/tryout").join(name);
    std::fs::create_dir_all(&folder).expect("a folder");
    let sample = std::fs::read_to_string(root().join("machine/templates/mill.toml"));
    let file = folder.join("machine.toml");
    std::fs::write(&file, sample.expect("the sample")).expect("a file");
    file
}

/// The row that the keys are for.
fn selected(terminal: &Terminal) -> String {
    let screen = terminal.tmux(&["capture-pane", "-p", "-e"]);
    let marked = screen
        .lines()
        .find_map(|line| line.split("\u{1b}[7m").nth(1));
    marked.unwrap_or_default().to_owned()
}

/// Selects the row with this name; outputs come first, then motors.
fn select(terminal: &Terminal, name: &str) {
    loop {
        let now = selected(terminal);
        if now.starts_with(&format!("{name} ")) {
            return;
        }
        terminal.press("Down");
        let next = || {
            let next = selected(terminal);
            (!next.is_empty() && next != now).then_some(())
        };
        terminal.until(&format!("a row {name}"), next);
    }
}

/// Waits until the axis has stood for a second of the board's time; where it stands.
fn stands(terminal: &Terminal, twin: &Simulator) -> i64 {
    let clock = || {
        twin.told("counts", "clock")
            .parse::<u64>()
            .expect("a clock")
    };
    let (mut since, mut at) = (clock(), twin.steps());
    terminal.until("it stands", || {
        let (now, here) = (clock(), twin.steps());
        if here != at {
            (since, at) = (now, here);
        }
        (now - since > CLOCK_HZ).then_some(at)
    })
}

/// Of mill6.
const CLOCK_HZ: u64 = 60_000_000;

#[test]
fn outputs_are_switched_an_axis_is_jogged_while_the_key_repeats_and_its_scale_is_written() {
    let twin = twin();
    let file = machine("jog-file");
    let board = twin.udp().to_string();
    let file_name = file.display().to_string();
    let arguments = [
        "test",
        &board,
        "--machine",
        &file_name,
        "--patience",
        "1000",
    ];
    let terminal = Terminal::new("jog", &arguments);
    terminal.wait("a arms; nothing is driven before");
    assert!(!twin.is_open());

    // Another program is refused meanwhile.
    let second = Command::new(program("ferrocnc"))
        .args(["watch", &board, "--once", "--json"])
        .output()
        .expect("the tool");
    assert!(second.status.success(), "looking is free");
    let refused = Terminal::new("second", &["test", &board]);
    refused.wait("is driven by");
    drop(refused);

    terminal.press("a");
    terminal.wait("ARMED");
    assert!(twin.is_open());
    select(&terminal, "flood");
    let off = outputs(&twin);
    terminal.press("Enter");
    let on = terminal.until("the output is on", || {
        let on = outputs(&twin) ^ off;
        // A busy computer may have looked away for its three seconds.
        if on == 0 && terminal.screen().contains("flood is off again") {
            terminal.press("Enter");
        }
        (on != 0).then_some(on)
    });
    assert_eq!(on.count_ones(), 1);
    terminal.wait("flood is off again");
    assert_eq!(outputs(&twin), off);

    select(&terminal, "x");
    terminal.press("Right");
    terminal.wait("released before it moved");
    assert_eq!(twin.steps(), 0, "a press alone");
    terminal.until("1 mm, of one jog or several", || {
        terminal.hold("Right");
        (twin.steps() >= 320).then_some(())
    });
    let from = stands(&terminal, &twin);
    // The next one is released on the way: it stops short of its 10 mm.
    terminal.press("z");
    terminal.press("d");
    terminal.until("it moves again", || {
        terminal.hold("Right");
        (twin.steps() > from + 100).then_some(())
    });
    terminal.wait("released");
    let at = stands(&terminal, &twin);
    assert!(at < from + 3200, "{at} of {}", from + 3200);

    // What it has gone was two percent less on the ruler: the pitch of 5 becomes 4.9.
    let millimetres = (at - from) as f64 / 320.0 * 0.98;
    terminal.press("m");
    terminal.press(&format!("{millimetres:.8}"));
    terminal.press("Enter");
    terminal.wait("w writes it");
    terminal.press("w");
    terminal.wait("then ferrocnc machine write");
    let text = std::fs::read_to_string(&file).expect("the file");
    let pitch = text.lines().find_map(|line| line.strip_prefix("pitch = "));
    let pitch = pitch.and_then(|line| line.split_whitespace().next()?.parse::<f64>().ok());
    assert!((pitch.expect("a pitch") - 4.9).abs() < 1e-4, "{text}");
    assert!(
        text.contains("# mm in a turn of the screw"),
        "comments stay"
    );

    terminal.press("q");
    terminal.wait("ended with 0");
    twin.run_ms(1000);
    assert!(!twin.is_open());
}

#[test]
fn a_lost_link_stops_the_axis_and_nothing_moves_until_it_is_armed_again() {
    let twin = twin();
    let terminal = Terminal::new(
        "lost",
        &["test", &twin.udp().to_string(), "--patience", "1000"],
    );
    terminal.wait("a arms; nothing is driven before");
    terminal.press("a");
    terminal.wait("ARMED");
    select(&terminal, "x");
    for _ in 0..2 {
        terminal.press("d");
    }
    terminal.until("it moves", || {
        terminal.hold("Right");
        (twin.steps() > 20).then_some(())
    });
    control(twin.control(), "fault pull");
    terminal.wait("NO ANSWER");
    twin.run_ms(1000);
    assert!(!twin.is_open());
    let stopped = twin.steps();
    control(twin.control(), "fault plug");
    terminal.until("the board answers", || {
        twin.run_ms(10);
        terminal.screen().contains("OFF").then_some(())
    });
    for _ in 0..3 {
        terminal.hold("Right");
        terminal.wait("a arms first");
    }
    assert_eq!(stands(&terminal, &twin), stopped);
    assert!(!twin.is_open());
}

#[test]
fn a_terminal_that_is_closed_switches_off() {
    closed("", "closed");
}

/// In a session of its own: the tool sees only the terminal's end, as in the moment before the
/// shell passes the signal on.
#[test]
fn a_terminal_that_is_closed_switches_off_before_the_signal_comes() {
    let file = std::env::temp_dir().join(format!("ferrocnc-status-{}", std::process::id()));
    let _ = std::fs::remove_file(&file);
    let keeps = format!("sh -c '\"$@\"; echo $? > \"{}\"' sh", file.display());
    let terminal = closed(&format!("setsid --wait {keeps}"), "gone");
    let status = terminal.until("the tool has ended", || {
        let status = std::fs::read_to_string(&file).ok()?;
        status.ends_with('\n').then_some(status)
    });
    assert_eq!(status, "0\n", "the tool's exit status");
    let _ = std::fs::remove_file(file);
}

fn closed(first: &str, name: &str) -> Terminal {
    let twin = twin();
    let arguments = ["test", &twin.udp().to_string(), "--patience", "1000"];
    let terminal = Terminal::behind(first, name, &arguments);
    terminal.wait("a arms; nothing is driven before");
    terminal.press("a");
    terminal.wait("ARMED");
    terminal.tmux(&["kill-server"]);
    terminal.until("the gate is closed", || (!twin.is_open()).then_some(()));
    terminal
}

#[test]
fn it_is_refused_where_there_is_no_terminal() {
    let twin = twin();
    let done = Command::new(program("ferrocnc"))
        .args(["test", &twin.udp().to_string()])
        .stdin(Stdio::null())
        .output()
        .expect("the tool");
    assert!(!done.status.success());
    let said = String::from_utf8_lossy(&done.stderr);
    assert!(said.contains("draws on a terminal"), "{said}");
}
