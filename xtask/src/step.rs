//! Runs one step of work and prints its title, its time, and on failure the end of its log.

use crate::cost;
use anyhow::{Context, Result, bail};
use indicatif::{MultiProgress, ProgressBar, ProgressStyle};
use std::cell::Cell;
use std::fs::{self, File};
use std::io::{IsTerminal, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use std::process::{Command, ExitStatus, Stdio};
use std::sync::mpsc::RecvTimeoutError;
use std::sync::{LazyLock, mpsc};
use std::time::{Duration, Instant};
use wait4::Wait4;

/// How much of a failed step's log is shown.
const TAIL_LINES: usize = 30;
/// Panics of a step that failed that are said again at its end.
const PANICS: usize = 5;

/// What a command printed, and when it had grown to which length.
#[derive(Debug, Default)]
pub struct Printed {
    /// All of it.
    pub text: String,
    /// Seconds since the start, and bytes by then; both grow.
    pub growth: Vec<(f32, usize)>,
}

impl Printed {
    /// When the byte at this place was there, in seconds.
    pub fn at(&self, byte: usize) -> f32 {
        let later = self.growth.partition_point(|(_, length)| *length <= byte);
        let known = self.growth.get(later).or(self.growth.last());
        known.map_or(0.0, |(seconds, _)| *seconds)
    }
}

/// The spinners of all steps that run at the same time.
static SCREEN: LazyLock<MultiProgress> = LazyLock::new(MultiProgress::new);

/// Prints a line above the spinners.
fn say(line: &str) {
    SCREEN.suspend(|| println!("{line}"));
}

thread_local! {
    static STANDS_BACK: Cell<bool> = const { Cell::new(false) };
}

/// From here on the steps of this thread run at low priority.
pub fn stand_back() {
    STANDS_BACK.set(true);
}

/// The command again, at the priority of this thread's steps: program, arguments, environment and
/// folder.
pub fn at_priority(command: &Command) -> Command {
    let mut same = match STANDS_BACK.get() {
        true => {
            let mut nice = Command::new("nice");
            nice.arg("-n10").arg(command.get_program());
            nice
        }
        false => Command::new(command.get_program()),
    };
    same.args(command.get_args());
    for (name, value) in command.get_envs() {
        match value {
            Some(value) => same.env(name, value),
            None => same.env_remove(name),
        };
    }
    if let Some(folder) = command.get_current_dir() {
        same.current_dir(folder);
    }
    same
}

/// Prints a heading.
pub fn heading(text: &str) {
    say(&format!("\n== {text}"));
}

/// Prints a line that something was found or needs no work.
pub fn note(text: &str) {
    say(&format!("  - {text}"));
}

/// Runs a command with its output in `target/logs/NAME.log`. `expect` is an honest guess such as
/// "2 min", shown while it runs.
pub fn run(name: &str, title: &str, expect: &str, command: &mut Command) -> Result<()> {
    run_quietly(name, title, expect, command).map(drop)
}

/// As [`run`], and hands back what the command printed.
pub fn run_quietly(name: &str, title: &str, expect: &str, command: &mut Command) -> Result<String> {
    Ok(run_timed(name, title, expect, command)?.text)
}

/// As [`run_quietly`], with when the output came.
pub fn run_timed(name: &str, title: &str, expect: &str, command: &mut Command) -> Result<Printed> {
    run_judged(name, title, expect, command, |status| status.success())
}

/// As [`run_quietly`], for a command that says more with its exit code than success and failure.
pub fn run_judged(
    name: &str,
    title: &str,
    expect: &str,
    command: &mut Command,
    fine: impl Fn(ExitStatus) -> bool,
) -> Result<Printed> {
    let log = log_path(name)?;
    let out = File::create(&log).with_context(|| format!("cannot write {}", log.display()))?;
    let program = command.get_program().to_string_lossy().into_owned();
    let begun = Instant::now();
    let mut child = at_priority(command)
        .current_dir(crate::root())
        .stdin(Stdio::null())
        .stdout(out.try_clone()?)
        .stderr(out)
        .spawn()
        .with_context(|| format!("cannot start `{program}` for: {title}"))?;
    let spinner = spinner(title, expect);
    let mut said = Instant::now();
    let mut growth = Vec::new();
    let (ended, end) = mpsc::channel();
    std::thread::spawn(move || ended.send(child.wait4()));
    let ended = loop {
        match end.recv_timeout(Duration::from_millis(100)) {
            Ok(ended) => break ended?,
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => bail!("the end of `{program}` was lost"),
        }
        let length = fs::metadata(&log).map_or(0, |log| log.len() as usize);
        if growth.last().is_none_or(|(_, last)| *last < length) {
            growth.push((begun.elapsed().as_secs_f32(), length));
        }
        spinner.set_message(last_line(&log));
        if !std::io::stderr().is_terminal() && said.elapsed() > Duration::from_secs(30) {
            say(&format!(
                "    ... {title}: {:.0} s, {}",
                begun.elapsed().as_secs_f32(),
                last_line(&log)
            ));
            said = Instant::now();
        }
    };
    spinner.finish_and_clear();
    SCREEN.remove(&spinner);
    let seconds = begun.elapsed().as_secs_f32();
    let used = (ended.rusage.utime + ended.rusage.stime).as_secs_f32();
    cost::note(name, seconds, used);
    if !fine(ended.status) {
        say(&format!("  x {title}  ({seconds:.1} s)"));
        say(&indent(&tail(&log)));
        bail!(
            "{title}: `{program}` failed; the whole log is {}{}",
            log.display(),
            panics(&fs::read(&log).unwrap_or_default())
        );
    }
    say(&format!(
        "  + {title}  ({seconds:.1} s, {used:.0} s of a core)"
    ));
    growth.push((seconds, usize::MAX));
    let text = fs::read(&log).unwrap_or_default();
    Ok(Printed {
        text: String::from_utf8_lossy(&text).into_owned(),
        growth,
    })
}

/// Where the log of a step goes.
pub fn log_path(name: &str) -> Result<PathBuf> {
    let folder = crate::target("logs");
    fs::create_dir_all(&folder).with_context(|| format!("cannot make {}", folder.display()))?;
    Ok(folder.join(format!("{name}.log")))
}

/// The last lines of a log.
pub fn tail(log: &Path) -> String {
    let text = fs::read(log)
        .map(|b| String::from_utf8_lossy(&b).into_owned())
        .unwrap_or_default();
    let lines: Vec<_> = text.lines().collect();
    lines[lines.len().saturating_sub(TAIL_LINES)..].join("\n")
}

/// Where the tests of a log panicked and why, a line each: what a log on a machine out of
/// reach would have said.
fn panics(log: &[u8]) -> String {
    let text = String::from_utf8_lossy(log);
    let mut lines = text.lines();
    let panic = |line: &&str| line.starts_with("thread '") && line.contains(" panicked at ");
    let mut found = Vec::new();
    while let Some(line) = lines.find(panic) {
        let why = lines.next().unwrap_or_default();
        found.push(format!("\n            {line} {why}"));
    }
    found.truncate(PANICS);
    found.concat()
}

fn spinner(title: &str, expect: &str) -> ProgressBar {
    if !std::io::stderr().is_terminal() {
        say(&format!("  . {title} (about {expect})"));
    }
    let bar = SCREEN.add(ProgressBar::new_spinner());
    let style = ProgressStyle::with_template("  {spinner} {prefix} [{elapsed}] {wide_msg:.dim}");
    bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_spinner()));
    bar.set_prefix(format!("{title} (about {expect})"));
    bar.enable_steady_tick(Duration::from_millis(120));
    bar
}

fn last_line(log: &Path) -> String {
    let mut end = String::new();
    if let Ok(mut file) = File::open(log) {
        let length = file.metadata().map_or(0, |m| m.len());
        let _ = file.seek(SeekFrom::Start(length.saturating_sub(400)));
        let mut bytes = Vec::new();
        let _ = file.read_to_end(&mut bytes);
        end = String::from_utf8_lossy(&bytes).into_owned();
    }
    end.lines()
        .rev()
        .find(|l| !l.trim().is_empty())
        .unwrap_or("")
        .trim()
        .chars()
        .take(100)
        .collect()
}

fn indent(text: &str) -> String {
    text.lines()
        .map(|l| format!("    | {l}"))
        .collect::<Vec<_>>()
        .join("\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_step_that_failed_says_again_where_it_panicked_and_why() {
        let log =
            b"test a ... ok\nthread 'b' (1) panicked at b.rs:2:3:\nX stands at 7 steps\nstack\n\
            thread 'c' panicked at c.rs:1:1:\n";
        let said = panics(log);
        let lines: Vec<&str> = said.lines().skip(1).map(str::trim).collect();
        let first = "thread 'b' (1) panicked at b.rs:2:3: X stands at 7 steps";
        assert_eq!(lines, [first, "thread 'c' panicked at c.rs:1:1:"]);
        assert_eq!(panics(b"nothing of the kind\n"), "");
        assert_eq!(panics(&log.repeat(9)).lines().skip(1).count(), PANICS);
    }
}
