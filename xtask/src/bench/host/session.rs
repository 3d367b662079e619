//! A session of LinuxCNC's realtime for the bench: its HAL file, the board and the responder it
//! talks to, and what it leaves.

use crate::simulated::Simulated;
use crate::{setup, target};
use anyhow::{Context, Result, bail};
use std::collections::BTreeMap;
use std::fmt;
use std::net::UdpSocket;
use std::os::unix::fs::PermissionsExt;
use std::path::PathBuf;
use std::process::{Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, LazyLock};
use std::thread::JoinHandle;
use std::time::Duration;
use wire::describe::Channels;
use wire::exchange::{REQUEST_OVERHEAD, command_words, status_words};

/// Axes that move, so that their position is predicted and their command computed.
const MOVING: [&str; 3] = ["x", "y", "z"];

/// What the C twin has to be like: as many pins and bytes as the driver has.
pub struct Alike {
    /// What the driver reads in a period: input pins and parameters.
    pub inputs: usize,
    /// What it writes.
    pub outputs: usize,
    /// Words of an exchange.
    pub command: usize,
    /// Words of its answer.
    pub status: usize,
    /// As LinuxCNC says.
    pub scheduling: &'static str,
}

impl fmt::Display for Alike {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "both: {} bytes out, {} bytes back, {} pins and parameters read, {} pins written; scheduling: {}",
            4 * self.command,
            4 * self.status,
            self.inputs,
            self.outputs,
            self.scheduling
        )
    }
}

/// The processor of what answers.
const FIRST: &str = "0";

/// The processor of the thread.
fn last() -> String {
    let count = std::thread::available_parallelism().map_or(1, usize::from);
    (count - 1).to_string()
}

/// What a program is started with for a real-time priority: before all ordinary programs of the
/// machine.
const FIFO: [&str; 3] = ["chrt", "-f", "50"];

/// Whether this user may have such a priority.
fn fifo() -> bool {
    static MAY: LazyLock<bool> = LazyLock::new(|| {
        let mut chrt = Command::new(FIFO[0]);
        let done = chrt.args(&FIFO[1..]).arg("true").status();
        done.is_ok_and(|status| status.success())
    });
    *MAY
}

/// A program that keeps to one processor, at a real-time priority if that may be.
fn bound(processor: &str, program: &str) -> Command {
    let taskset = ["taskset", "-c", processor, program];
    let words = match fifo() {
        true => [&FIFO[..], &taskset].concat(),
        false => taskset.to_vec(),
    };
    let mut command = Command::new(words[0]);
    command.args(&words[1..]);
    command
}

/// Keeps this thread to the processor of what answers. Where that fails it runs anywhere.
fn bind() {
    let Ok(this) = std::fs::read_link("/proc/thread-self") else {
        return;
    };
    let Some(number) = this.file_name() else {
        return;
    };
    let mut taskset = Command::new("taskset");
    taskset.args(["-p", "-c", FIRST]).arg(number);
    let _ = taskset.stdout(Stdio::null()).status();
    if fifo() {
        let mut chrt = Command::new(FIFO[0]);
        chrt.args(["-f", "-p", FIFO[2]]).arg(number);
        let _ = chrt.stdout(Stdio::null()).status();
    }
}

/// A twin of the board, on the processor of what answers.
pub fn twin(board: &str, arguments: &[&str]) -> Result<Simulated> {
    let simulator = bound(FIRST, &target("release/ferrocnc-sim").display().to_string());
    let own = ["--board", board, "--silence-ms", "600000"];
    Simulated::start(simulator, &[&own, arguments].concat())
}

/// Answers every datagram with so many bytes, the first of which are the datagram's.
pub struct Responder {
    /// Its UDP port.
    pub port: u16,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Responder {
    /// Starts it.
    pub fn start(bytes: usize) -> Result<Self> {
        let socket = UdpSocket::bind("127.0.0.1:0")?;
        socket.set_read_timeout(Some(Duration::from_millis(200)))?;
        let port = socket.local_addr()?.port();
        let stop = Arc::new(AtomicBool::new(false));
        let asked = Arc::clone(&stop);
        let thread = std::thread::spawn(move || {
            bind();
            let mut buffer = [0; 2048];
            while !asked.load(Ordering::Relaxed) {
                if let Ok((_, from)) = socket.recv_from(&mut buffer) {
                    // Unsent is an answer missing, which is counted there.
                    let _ = socket.send_to(&buffer[..bytes], from);
                }
            }
        });
        Ok(Responder {
            port,
            stop,
            thread: Some(thread),
        })
    }
}

impl Drop for Responder {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            // It has no result.
            let _ = thread.join();
        }
    }
}

/// A HAL file that grows, and what the session left.
pub struct Session {
    folder: PathBuf,
    load: String,
    thread: String,
    begin: String,
    arm: String,
    end: String,
}

impl Session {
    /// An empty one.
    pub fn new(name: &str, period_ns: u64) -> Self {
        Session {
            folder: target("bench-host").join(name),
            load: format!("loadrt threads name1=servo-thread period1={period_ns}\n"),
            thread: String::new(),
            begin: String::new(),
            arm: String::new(),
            end: "show pin\nshow param\n".to_owned(),
        }
    }

    /// With the driver; it is armed and moves its axes.
    pub fn ferrocnc(&mut self, port: u16) {
        self.load += &format!("loadrt ferrocnc boards=127.0.0.1:{port}\n");
        self.begin += "setp ferrocnc.0.enable 1\n";
        self.arm += "setp ferrocnc.0.enable-request 1\n";
        for axis in MOVING {
            let pin = |name: &str, value: &str| {
                format!("setp ferrocnc.0.stepgen.{axis}.{name} {value}\n")
            };
            self.begin += &pin("control-type", "1");
            self.begin += &pin("position-scale", "400");
            self.begin += &pin("maxaccel", "100");
            self.begin += &pin("enable", "1");
            self.begin += &pin("velocity-cmd", "10");
        }
    }

    /// With the C twin.
    pub fn benchudp(&mut self, port: u16, like: &Alike) {
        self.load += &format!(
            "loadrt benchudp port={port} command={} status={} personality={}\n",
            like.command,
            like.status,
            like.inputs | like.outputs << 16
        );
    }

    /// Calls these functions in this order, with a stamp in front of each and at the end, and one
    /// more in front.
    pub fn stamped(&mut self, functions: &[&str], periods: u64) {
        let count = functions.len() + 2;
        self.load += &format!(
            "loadrt benchstamp count={count} periods={periods} file={}\n",
            self.stamps().display()
        );
        let stamp = |n: usize| format!("addf benchstamp.{n} servo-thread\n");
        self.thread += &stamp(0);
        for (n, function) in functions.iter().enumerate() {
            self.thread += &format!("{}addf {function} servo-thread\n", stamp(n + 1));
        }
        self.thread += &stamp(count - 1);
    }

    /// Another command for the last seconds.
    pub fn with(&mut self, command: &str) {
        self.end = format!("{command}\n{}", self.end);
    }

    fn stamps(&self) -> PathBuf {
        self.folder.join("stamps.txt")
    }

    /// Runs it for a second to settle and so many more; what HAL showed.
    pub fn run(&self, seconds: u64) -> Result<String> {
        std::fs::create_dir_all(&self.folder)?;
        // The process with the threads may have another user's rights.
        std::fs::write(self.stamps(), "")?;
        let open = std::fs::Permissions::from_mode(0o666);
        std::fs::set_permissions(self.stamps(), open)?;
        let file = self.folder.join("session.hal");
        let text = format!(
            "{}{}{}start\n{}loadusr -w sleep 1\n{}loadusr -w sleep {seconds}\n{}",
            self.load,
            self.thread,
            self.begin,
            self.priority()?,
            self.arm,
            self.end
        );
        std::fs::write(&file, text)?;
        let mut halrun = bound(&last(), "timeout");
        halrun.args(["-k", "5", "120", "halrun"]).arg(&file);
        if setup::is_root() {
            halrun.env("RTAPI_UID", "1000");
        }
        let fifo = format!("/tmp/ferrocnc_bench_fifo_{}", std::process::id());
        let done = halrun
            .env("RTAPI_FIFO_PATH", fifo)
            .stdin(Stdio::null())
            .output()
            .context("halrun, which `cargo xtask setup` installs")?;
        let said =
            [done.stdout, done.stderr].map(|said| String::from_utf8_lossy(&said).into_owned());
        let said = said.concat();
        std::fs::write(self.folder.join("said.txt"), &said)?;
        match done.status.success() {
            true => Ok(said),
            false => bail!("halrun {} failed:\n{said}", file.display()),
        }
    }

    /// The command that gives the servo thread its priority: without the right to lock memory,
    /// LinuxCNC takes an ordinary one.
    fn priority(&self) -> Result<String> {
        if !fifo() {
            return Ok(String::new());
        }
        let script = self.folder.join("priority.sh");
        let chrt = FIFO.join(" ");
        std::fs::write(
            &script,
            chrt.replace("-f", "-a -f -p") + " \"$(pgrep -n -x rtapi_app)\"\n",
        )?;
        Ok(format!("loadusr -w bash {}\n", script.display()))
    }

    /// What the stamps say behind the first periods: per period, wall and CPU time at each.
    fn times(&self, skip: usize) -> Result<Vec<Vec<[i64; 2]>>> {
        let text = std::fs::read_to_string(self.stamps())?;
        let rows: Vec<Vec<[i64; 2]>> = text
            .lines()
            .skip(skip)
            .map(|line| {
                let mut words = line.split_whitespace().map(str::parse::<i64>);
                let mut row = Vec::new();
                while let (Some(wall), Some(cpu)) = (words.next(), words.next()) {
                    row.push([wall?, cpu?]);
                }
                Ok(row)
            })
            .collect::<Result<_>>()?;
        match rows.is_empty() {
            true => bail!("no stamps in {}; see said.txt there", self.folder.display()),
            false => Ok(rows),
        }
    }

    /// From stamp to stamp.
    pub fn intervals(&self, skip: usize) -> Result<Vec<Vec<[i64; 2]>>> {
        let times = self.times(skip)?;
        let differ = |row: &Vec<[i64; 2]>| {
            row.windows(2)
                .map(|pair| [0, 1].map(|clock: usize| pair[1][clock] - pair[0][clock]))
                .collect()
        };
        Ok(times.iter().map(differ).collect())
    }

    /// When each period began.
    pub fn starts(&self, skip: usize) -> Result<Vec<i64>> {
        Ok(self.times(skip)?.iter().map(|row| row[0][0]).collect())
    }
}

/// The value of a pin or parameter in what `show` printed.
pub fn value(said: &str, name: &str) -> Option<f64> {
    let line = said
        .lines()
        .find(|line| line.split_whitespace().any(|word| word == name))?;
    let word = line.split_whitespace().nth(3)?;
    match word {
        "TRUE" => Some(1.0),
        "FALSE" => Some(0.0),
        hexadecimal if hexadecimal.starts_with("0x") => {
            let number = u32::from_str_radix(&hexadecimal[2..], 16).ok()?;
            Some(f64::from(number))
        }
        decimal => decimal.parse().ok(),
    }
}

/// Loads the driver once and looks at what it exports.
pub fn alike(board: &str) -> Result<Alike> {
    let twin = twin(board, &["--mode", "lockstep"])?;
    let mut session = Session::new("alike", 1_000_000);
    session.ferrocnc(twin.port);
    session.stamped(&["ferrocnc.0.read", "ferrocnc.0.write"], 10);
    let said = session.run(1)?;
    let (mut inputs, mut outputs, mut channels) = (0, 0, Channels::default());
    for line in said.lines() {
        let words: Vec<&str> = line.split_whitespace().collect();
        let [_, _, direction, _, name, ..] = words[..] else {
            continue;
        };
        let Some(name) = name.strip_prefix("ferrocnc.0.") else {
            continue;
        };
        match direction {
            "IN" | "I/O" | "IO" => inputs += 1,
            "RW" if !name.ends_with(".tmax") => inputs += 1,
            "OUT" => outputs += 1,
            _ => {}
        }
        let mut parts = name.split('.');
        match (parts.next(), parts.nth(1)) {
            (Some("stepgen"), Some("position-fb")) => channels.stepgens += 1,
            (Some("encoder"), Some("position")) => channels.encoders += 1,
            (Some("pwm"), Some("value")) => channels.pwms += 1,
            _ => {}
        }
    }
    let scheduling = match (said.contains("POSIX non-realtime"), fifo()) {
        (true, true) => "SCHED_FIFO without locked memory",
        (true, false) => "SCHED_OTHER",
        (false, _) => "SCHED_FIFO with locked memory",
    };
    Ok(Alike {
        inputs,
        outputs,
        command: REQUEST_OVERHEAD + command_words(channels),
        status: REQUEST_OVERHEAD + status_words(channels),
        scheduling,
    })
}

/// A session with one driver, and what it talks to.
pub fn one(
    board: &str,
    shape: &str,
    functions: &[&str],
    like: &Alike,
) -> Result<(Session, (Simulated, Responder))> {
    let ours = functions[0].starts_with("ferrocnc");
    let driver = if ours { "ferrocnc" } else { "c" };
    let mut session = Session::new(&format!("{shape}-{driver}"), 1_000_000);
    let twin = twin(board, &["--mode", "lockstep"])?;
    let responder = Responder::start(4 * like.status)?;
    match ours {
        true => session.ferrocnc(twin.port),
        false => session.benchudp(responder.port, like),
    }
    Ok((session, (twin, responder)))
}

/// System calls per period, by name, in a session of its own under strace; the sleep at the end of
/// the period and the stamps are not among them. Empty without strace.
pub fn calls(
    board: &str,
    shape: &str,
    functions: &[&str],
    like: &Alike,
) -> Result<BTreeMap<String, f64>> {
    let (mut session, _ends) = one(board, &format!("calls-{shape}"), functions, like)?;
    session.stamped(functions, 60_000);
    std::fs::create_dir_all(&session.folder)?;
    let trace = session.folder.join("strace.txt");
    let script = session.folder.join("strace.sh");
    let text = format!(
        "timeout -s INT 2 strace -f -o {} -p \"$(pgrep -n -x rtapi_app)\"\ntrue\n",
        trace.display()
    );
    std::fs::write(&script, text)?;
    session.with(&format!("loadusr -w bash {}", script.display()));
    session.run(1)?;
    let text = std::fs::read_to_string(&trace).unwrap_or_default();
    Ok(count(&text, functions.len() + 2))
}

/// What a stamp calls, and no driver does.
const STAMP: &str = "clock_gettime";
/// The end of a period, unless it is late.
const SLEEP: &str = "clock_nanosleep";

/// Per period of the thread with so many stamps; a line of strace begins with the thread's number.
fn count(trace: &str, stamps: usize) -> BTreeMap<String, f64> {
    let mut threads: BTreeMap<&str, BTreeMap<&str, u32>> = BTreeMap::new();
    for line in trace.lines() {
        let Some((thread, call)) = line.split_once(' ') else {
            continue;
        };
        if let Some((name, _)) = call.trim_start().split_once('(')
            && name.chars().all(|c| c == '_' || c.is_ascii_alphanumeric())
        {
            let calls = threads.entry(thread).or_default();
            *calls.entry(name).or_default() += 1;
        }
    }
    let servo = threads.values().find(|calls| calls.contains_key(STAMP));
    let Some(servo) = servo else {
        return BTreeMap::new();
    };
    let periods = f64::from(servo[STAMP]) / stamps as f64;
    servo
        .iter()
        .filter(|(name, _)| ![STAMP, SLEEP].contains(name))
        .map(|(name, calls)| ((*name).to_owned(), f64::from(*calls) / periods))
        .collect()
}

/// Counts as a line.
pub fn told(calls: &BTreeMap<String, f64>) -> String {
    match calls.is_empty() {
        true => "not counted, strace is not installed".to_owned(),
        false => {
            let each = calls.iter().map(|(name, n)| format!("{name} {n:.2}"));
            each.collect::<Vec<_>>().join(", ")
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_value_is_read_as_hal_shows_it() {
        let said = "\
             8  bit   OUT          TRUE  b.enabled
             8  u32   OUT    0x000007B6  b.total ==> elsewhere
             8  s32   OUT           -12  b.level
";
        assert_eq!(value(said, "b.enabled"), Some(1.0));
        assert_eq!(value(said, "b.total"), Some(1974.0));
        assert_eq!(value(said, "b.level"), Some(-12.0));
        assert_eq!(value(said, "b.lev"), None);
    }

    #[test]
    fn the_calls_of_the_thread_with_the_socket_are_counted_per_period() {
        let trace = "\
7 clock_gettime(CLOCK_THREAD_CPUTIME_ID, {tv_sec=0}) = 0
7 recvfrom(5, \"x\", 1472, 0, NULL, NULL) = 188
8 read(3, \"\", 1) = 0
7 clock_gettime(CLOCK_THREAD_CPUTIME_ID, {tv_sec=0}) = 0
7 sendto(5, \"x\", 124, MSG_NOSIGNAL, NULL, 0) = 124
7 clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, {tv_sec=1}, NULL) = 0
7 clock_gettime(CLOCK_THREAD_CPUTIME_ID, {tv_sec=0}) = 0
7 recvfrom(5,  <unfinished ...>
7 <... recvfrom resumed>\"(\", 1472, 0, NULL, NULL) = -1 EAGAIN
7 recvfrom(5, \"x\", 1472, 0, NULL, NULL) = 188
7 clock_gettime(CLOCK_THREAD_CPUTIME_ID, {tv_sec=0}) = 0
7 sendto(5, \"x\", 124, MSG_NOSIGNAL, NULL, 0) = 124
";
        let calls = count(trace, 2);
        assert_eq!(calls["sendto"], 1.0);
        assert_eq!(calls["recvfrom"], 1.5);
        assert_eq!(calls.len(), 2);
        assert!(count("", 2).is_empty());
    }
}
