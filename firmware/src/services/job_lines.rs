//! The debug console's `job` commands: for clients without the `ferrocnc` tool.
//!
//! They ask the store and the executor as [`jobs::server`] does, and refuse with the same words.
//! One difference: a console cannot promise to keep asking, so a job that is started here runs
//! unattended.

use crate::text::{Out, Sink};
use jobs::executor::Executor;
use jobs::store::Store;
use jobs::{Jobs, Outside};
use wire::Name;
use wire::jobs::{AXES, End, Entry, JobCommand, NAME, Report, Status, UNATTENDED};

const HELP: [&str; 10] = [
    "job status        the state of the job",
    "job list          the jobs in the store",
    "job start NAME    execute it, unattended",
    "job pause         stand still on the path",
    "job continue      resume",
    "job stop          end it, softly",
    "job home [AXES]   home the axes (x, z, xy, ...)",
    "job here [AXES]   these axes, without a switch, are at 0",
    "job feed PERCENT  percent of the job's own feed",
    "job delete NAME   delete it from the store",
];

/// No client of the server has this number: the executor does not wait for the client that started
/// this job.
const CLIENT: u32 = 0;

/// The request of a line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Ask {
    Help,
    Status,
    List,
    Delete(Name),
    Feed(u16),
    /// A command with flags, and with a name if it is a start.
    Do(JobCommand, u8, Name),
}

impl Ask {
    /// Reads a line that begins with `job`; `None` if it is not understood.
    fn parse(line: &str) -> Option<Result<Ask, Status>> {
        let (_, line) = word(line);
        let (verb, rest) = word(line);
        let named = |ask: fn(Name) -> Ask| match Name::new(rest) {
            Ok(name) if (1..=NAME).contains(&rest.len()) => Ok(ask(name)),
            Ok(_) | Err(_) => Err(Status::Name),
        };
        let plain = |command| Ok(Ask::Do(command, 0, Name::EMPTY));
        let alone = rest.is_empty();
        Some(match verb {
            "start" => named(|name| Ask::Do(JobCommand::Start, UNATTENDED, name)),
            "delete" => named(Ask::Delete),
            "feed" => Ok(Ask::Feed(rest.parse().ok()?)),
            "home" => {
                let flags = UNATTENDED | axes(rest)?;
                Ok(Ask::Do(JobCommand::Calibrate, flags, Name::EMPTY))
            }
            "here" => Ok(Ask::Do(JobCommand::Here, axes(rest)?, Name::EMPTY)),
            _ if !alone => return None,
            "" | "status" => Ok(Ask::Status),
            "list" => Ok(Ask::List),
            "help" => Ok(Ask::Help),
            "pause" => plain(JobCommand::Pause),
            "continue" => plain(JobCommand::Continue),
            "stop" => plain(JobCommand::Stop),
            _ => return None,
        })
    }

    fn need(self) -> Need {
        match self {
            Ask::Help | Ask::Status | Ask::List => Need::Look,
            Ask::Do(JobCommand::Stop | JobCommand::Pause, ..) => Need::Stop,
            Ask::Delete(_) | Ask::Feed(_) | Ask::Do(..) => Need::Change,
        }
    }
}

/// What a client has to be allowed for a line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Need {
    /// It only reads.
    Look,
    /// It stops a job: every client may, with a key or without.
    Stop,
    /// It changes something.
    Change,
}

/// What this line needs. One that is not understood changes nothing.
pub fn need(line: &str) -> Need {
    match Ask::parse(line) {
        Some(Ok(ask)) => ask.need(),
        Some(Err(_)) | None => Need::Look,
    }
}

/// The first word, and the rest. The standard library's search and `trim`, which know Unicode, took
/// 3000 clocks of each piece of an answer.
fn word(text: &str) -> (&str, &str) {
    let text = text.trim_ascii();
    let end = text.bytes().position(|byte| byte == b' ');
    let (word, rest) = text
        .split_at_checked(end.unwrap_or(text.len()))
        .unwrap_or((text, ""));
    (word, rest.trim_ascii_start())
}

/// One bit per axis.
fn axes(text: &str) -> Option<u8> {
    text.bytes().try_fold(0, |axes, letter| {
        let axis = b"xyz".iter().position(|axis| *axis == letter)?;
        Some(axes | 1 << axis)
    })
}

/// Executes a line of a console's client that may do what the line needs, and writes the piece
/// number `step` of the answer. True: there is another piece.
pub fn piece(
    jobs: &mut Jobs,
    line: &str,
    step: u16,
    paper: &mut dyn Sink,
    out: &mut impl Outside,
) -> bool {
    let now = out.now();
    let (store, executor) = jobs.works();
    let mut visit = Visit {
        store,
        executor,
        now,
    };
    let Some(ask) = Ask::parse(line) else {
        Out(paper).text("? try job help").end();
        return false;
    };
    let more = ask.and_then(|ask| visit.obey(ask, step, paper, out));
    more.unwrap_or_else(|status| {
        Out(paper).text("refused: ").text(status.text()).end();
        false
    })
}

/// One line from a client of the console.
struct Visit<'a, 'm> {
    store: &'a mut Store<'m>,
    executor: &'a mut Executor,
    now: u64,
}

impl Visit<'_, '_> {
    fn obey(
        &mut self,
        ask: Ask,
        step: u16,
        paper: &mut dyn Sink,
        out: &mut impl Outside,
    ) -> Result<bool, Status> {
        match ask {
            Ask::Help => {
                let step = usize::from(step);
                Out(paper).text(HELP.get(step).unwrap_or(&"")).end();
                return Ok(step + 1 < HELP.len());
            }
            Ask::List => return Ok(self.list(step, &mut Out(paper))),
            Ask::Delete(name) => {
                if self.executor.executes(self.store, &name) {
                    return Err(Status::NotNow);
                }
                self.store.delete(&name)?;
                let mut out = Out(paper);
                out.text(name.text()).text(" is deleted, ");
                out.number(self.store.free()).text(" bytes are free").end();
                return Ok(false);
            }
            // The others are answered with the state, in pieces: all at once would take longer than
            // a host that moves the machine should wait.
            Ask::Feed(percent) if step == 0 => self.executor.feed(percent)?,
            Ask::Do(command, flags, name) if step == 0 => {
                let code = (command.code(), flags, 0);
                self.executor
                    .command(code, &name, CLIENT, self.store, self.now, out)?;
            }
            Ask::Status | Ask::Feed(_) | Ask::Do(..) => {
                let first = u16::from(ask != Ask::Status);
                if step > first {
                    status(&self.executor.report_seen(out), &mut Out(paper));
                    return Ok(false);
                }
                self.executor.refresh(out);
            }
        }
        Ok(true)
    }

    /// An entry a piece, and the free bytes in the last one.
    fn list(&self, step: u16, out: &mut Out) -> bool {
        let entry = u8::try_from(step).ok();
        let entry = entry.and_then(|step| self.store.entry(step));
        match &entry {
            Some(entry) => list_entry(entry, out),
            None => {
                out.number(self.store.free()).text(" of ");
                out.number(self.store.room()).text(" bytes are free").end();
            }
        }
        entry.is_some()
    }
}

fn list_entry(entry: &Entry, out: &mut Out) {
    out.text(entry.name.text()).text(": ");
    out.number(entry.total).text(" bytes, ");
    if entry.ready {
        out.number(entry.instructions).text(" instructions").end();
    } else {
        out.number(entry.have);
        out.text(" of them are there: send it again").end();
    }
}

fn status(report: &Report, out: &mut Out) {
    out.text(report.state.text());
    if !report.name.is_empty() {
        out.text(": ").text(report.name.text());
        out.text(", ").number(report.progress.into());
        out.text(" %, line ").number(report.line).text(", ");
        duration(report.elapsed, out);
        out.text(" passed, ");
        duration(report.remaining, out);
        out.text(" to go");
    }
    out.end();
    if report.end != End::None {
        out.text("ended last: ").text(report.end.text());
        if let Some(axis) = ["x", "y", "z"].get(usize::from(report.axis)) {
            out.text(" (").text(axis).text(")");
        }
        out.end();
    }
    const _: () = assert!(AXES == 3);
    let [x, y, z] = report.steps;
    out.text("at steps ").signed(x).text(", ");
    out.signed(y).text(", ").signed(z);
    out.either(report.known, "", ", position not trusted");
    out.either(report.machine, "", ", no machine description");
    out.either(report.stands, "", ", moving").end();
    if report.percent != 100 {
        out.text("feed ").number(report.percent.into());
        out.text(" %").end();
    }
}

/// A duration with useful precision: 3.4 s, 5 min 06 s, 2 h 15 min.
fn duration(millis: u32, out: &mut Out) {
    let seconds = millis / 1000;
    let (minutes, hours) = (seconds / 60 % 60, seconds / 3600);
    let two = |number: u32, out: &mut Out| {
        out.either(number < 10, "0", "").number(number);
    };
    match (hours, minutes) {
        (0, 0) => {
            out.number(seconds).text(".");
            out.number(millis / 100 % 10).text(" s");
        }
        (0, _) => {
            out.number(minutes).text(" min ");
            two(seconds % 60, out);
            out.text(" s");
        }
        (_, _) => {
            out.number(hours).text(" h ");
            two(minutes, out);
            out.text(" min");
        }
    }
}
