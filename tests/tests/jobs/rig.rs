//! Programs, and the host that streams them.

use ferrocnc_tests::drawing::{self, TOLERANCE};
use ferrocnc_tests::pins::{self, Pin};
use ferrocnc_tests::plotter::Plotter;
use host::client::Client;
use host::job::client::Board;
use host::job::program::{Dialect, Program};
use host::keys::Keys;
use std::fmt::Write;
use std::io::{BufRead as _, BufReader};
use std::net::SocketAddrV4;
use std::process::{Child, Command, Stdio};
use std::time::Duration;
use wire::exchange::{STATUS_HEAD, STATUS_STEPGEN, StateWord};
use wire::jobs::End;
use wire::map;

/// A program of these lines.
pub fn program(gcode: &[u8]) -> Program {
    let program = Program::from_gcode(gcode, Dialect::default().dwell);
    program.unwrap_or_else(|error| panic!("{error}"))
}

/// Sends this with the drawing's machine.
pub fn send(board: &mut Board, name: &str, program: &Program) {
    let machine = drawing::machine().to_board();
    board.put_machine(&machine).expect("a machine");
    let entry = board.send(name, &program.to_job(), |_, _| ());
    assert!(entry.expect("the job is taken").ready);
}

/// The same, and starts it unattended.
pub fn begin(board: &mut Board, name: &str, program: &Program) {
    send(board, name, program);
    board.start(name, None).expect("it begins");
}

/// So many times slower than real time: a busy computer streams as fast as a board executes.
pub const SLOWER: u32 = 10;

/// As CAM programs go: a face in many passes, each a run of lines a third of a millimetre long over
/// a wavy surface, arcs at its ends, the tool lifted between layers. `lines` lines of G-code.
pub fn cam(lines: usize) -> String {
    let mut text =
        String::from("%\n(made by the tests)\nN10 G21 G90 G17\nN20 G0 X10 Y10 Z2\nN30 M3\n");
    let (mut written, mut row) = (5, 0u32);
    while written + 4 < lines {
        let (y, forth) = (10.0 + f64::from(row % 200) * 0.4, row.is_multiple_of(2));
        for n in 0..200u32 {
            let along = if forth { n } else { 199 - n };
            let x = 10.0 + f64::from(along) / 3.0;
            let z = (x / 7.0).sin() * (y / 5.0).cos() * 0.3;
            // Modal, as they are: the feed once, what does not change not at all.
            let feed = if n == 0 { " F18000" } else { "" };
            let _ = writeln!(text, "G1 X{x:.3} Y{y:.3} Z{z:.3}{feed}");
            written += 1;
            if written + 4 >= lines {
                break;
            }
        }
        let (side, code) = if forth { (0.2, 3) } else { (0.2, 2) };
        let _ = writeln!(text, "G{code} Y{:.3} J{side} (turn)", y + 0.4);
        written += 1;
        row += 1;
    }
    text.push_str("G0 Z2\nM5\nG0 X0 Y0 Z0\nM30\n");
    text
}

/// `ferrocnc job serve`, as a program of its own.
pub struct Serving {
    pub child: Child,
    pub at: SocketAddrV4,
}

impl Serving {
    pub fn begin(plotter: &Plotter) -> Self {
        let mut tool = Command::new(ferrocnc_tests::program("ferrocnc"));
        let board = plotter.udp.to_string();
        tool.args(["--json", "job", "serve", &board, "--at", "127.0.0.1:0"]);
        let mut child = tool.stdout(Stdio::piped()).spawn().expect("the tool runs");
        let mut line = String::new();
        let mut out = BufReader::new(child.stdout.take().expect("its output"));
        out.read_line(&mut line).expect("what it says");
        let said: serde_json::Value = serde_json::from_str(&line).unwrap_or_default();
        let at = said["jobs"].as_str().and_then(|at| at.parse().ok());
        let at = at.unwrap_or_else(|| panic!("it does not say where the jobs are: {line:?}"));
        Serving { child, at }
    }

    pub fn board(&self) -> Board {
        let patience = Duration::from_secs(120);
        let board = Board::with_patience(self.at, Keys::default(), patience);
        board.unwrap_or_else(|error| panic!("{error}"))
    }

    /// Sends this, and starts it unattended.
    pub fn start(&self, program: &Program) -> Board {
        let mut board = self.board();
        begin(&mut board, "job", program);
        board
    }

    /// Lets the drawing come so far that all three axes and the pen have been at work, and 64
    /// segments wait.
    pub fn draw_a_little(&self) {
        let mut board = self.start(&drawing::program(TOLERANCE));
        loop {
            let report = board.report().unwrap_or_else(|error| panic!("{error}"));
            assert_eq!(report.end, End::None, "{report:?}");
            if report.segments > 150 {
                return;
            }
            std::thread::sleep(Duration::from_millis(20));
        }
    }
}

impl Drop for Serving {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// The board's state once nothing moves, read without the session; its axes' steps, and when that
/// was.
pub fn at_rest(plotter: &Plotter) -> (StateWord, [i64; 3], u64) {
    let mut client = Client::open(&plotter.address()).expect("a socket");
    loop {
        let words = client.read(&[map::STATUS, map::SESSION_OWNER_PORT]);
        let words = words.unwrap_or_else(|error| panic!("{error}"));
        let state = StateWord::from_word(words[0]).expect("a state");
        if !state.enabled && words[1] == 0 {
            // An idle board samples a hundred times a second of its own.
            plotter.waits_for_its_pc(false);
            std::thread::sleep(Duration::from_millis(20 * u64::from(SLOWER)));
            let place = |axis: usize| STATUS_HEAD + axis * STATUS_STEPGEN + 1;
            let addresses = [4, 5, place(0), place(1), place(2)];
            let addresses = addresses.map(|word| map::STATUS + 4 * word as u32);
            let words = client.read(&addresses).expect("the counters");
            let clock = u64::from(words[1]) << 32 | u64::from(words[0]);
            let steps = [2, 3, 4].map(|word| i64::from(words[word] as i32));
            return (state, steps, clock);
        }
        std::thread::sleep(Duration::from_millis(20));
    }
}

pub fn steps_of(events: &[pins::Event]) -> [i64; 3] {
    let mut steps = [0; 3];
    for (_, pin) in events {
        if let Pin::Step { axis, forward } = *pin {
            steps[axis] += if forward { 1 } else { -1 };
        }
    }
    steps
}

/// Longer than any question to the board goes unanswered.
pub const PATIENCE: Duration = Duration::from_secs(120);
pub const STATUS: u32 = wire::regmap::segments::STATUS as u32;
