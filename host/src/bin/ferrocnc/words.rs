//! `ferrocnc words`: FPGA G's STATUS, START, STOP and GCODE, from a file or from the keyboard.
//!
//! All lines of a file are judged before the first one is sent. The board keeps 64 instructions;
//! while they are FULL, the tool waits for a place. At the end it waits until they are executed,
//! and gives the board back.

use anyhow::{Context, Result, anyhow, bail};
use clap::Args;
use ferrocnc::job::client::{Board, JobError};
use ferrocnc::job::words::{self, WordsLine};
use jobs::fpgag::{FpgagCommand, status};
use serde_json::json;
use std::io::{BufRead, IsTerminal, Write};
use std::path::{Path, PathBuf};
use std::sync::mpsc::{self, RecvTimeoutError};
use std::time::Duration;
use wire::jobs::{End, JobCommand, Report, State, Status};

/// The board takes a client that is silent for 5 s as gone.
const LOOK: Duration = Duration::from_secs(1);
/// Between two questions for a place in the queue, or for the end.
const AGAIN: Duration = Duration::from_millis(20);

#[derive(Args)]
pub(crate) struct WordsArguments {
    /// IP[:port] of the board.
    #[arg(value_name = "ADDR")]
    address: String,
    /// A file of lines: STATUS, START, STOP, or GCODE and the 4 words of a move or the 10 of a
    /// curve. From the keyboard if not given.
    #[arg(value_name = "FILE")]
    file: Option<PathBuf>,
    /// Tell the board which machine it moves first.
    #[arg(long, short, value_name = "MACHINE.toml")]
    machine: Option<PathBuf>,
}

pub(crate) fn run(arguments: &WordsArguments, as_json: bool) -> Result<()> {
    let lines = arguments.file.as_deref().map(read).transpose()?;
    let address = crate::parse(&arguments.address, wire::jobs::PORT)?;
    let mut board = Board::open(&address, crate::keys())?;
    crate::job::tell(&mut board, arguments.machine.as_deref())?;
    let mut session = Session {
        board,
        as_json,
        sent: 0,
        seconds: 0.0,
        speed: 0.0,
        runs: false,
        acquired: false,
    };
    let done = match lines {
        Some(lines) => lines.iter().try_for_each(|line| session.patiently(line)),
        None => session.keyboard(),
    };
    session.end(done)
}

fn read(file: &Path) -> Result<Vec<WordsLine>> {
    let shown = file.display();
    let text = std::fs::read_to_string(file).with_context(|| shown.to_string())?;
    WordsLine::all(&text).map_err(|error| anyhow!("{shown}: {error}"))
}

struct Session {
    board: Board,
    as_json: bool,
    /// Instructions that the board has taken, how long they take, and the speed at their end.
    sent: usize,
    seconds: f64,
    speed: f64,
    /// The words are executed: START came, and no STOP since.
    runs: bool,
    /// START has acquired the board.
    acquired: bool,
}

impl Session {
    /// Sends a line; the status word, which is shown.
    fn say(&mut self, line: &WordsLine) -> Result<u32> {
        let answer = self
            .board
            .words(line.command.code(), line.form, &line.words);
        let word = answer.map_err(|error| anyhow!("line {}: {}", line.number, hinted(error)))?;
        match line.command {
            FpgagCommand::Start => (self.runs, self.acquired) = (true, true),
            FpgagCommand::Stop => self.runs = false,
            FpgagCommand::Gcode if word == 0 => {
                let (seconds, speed) = line.lasts(self.speed);
                self.sent += 1;
                self.seconds += seconds;
                self.speed = speed;
            }
            FpgagCommand::Gcode | FpgagCommand::Status | FpgagCommand::Empty => {}
        }
        let bits = words::bits(word);
        if self.as_json {
            crate::text::say(&format!(
                "{}\n",
                json!({ "line": line.number, "command": line.name(), "status": word, "bits": bits })
            ))?;
        } else {
            let shown = match bits.is_empty() {
                true => "normal".to_owned(),
                false => bits.join(" "),
            };
            crate::text::say(&format!("{:>5} {:<6} {shown}\n", line.number, line.name()))?;
        }
        Ok(word)
    }

    /// As [`Session::say`], but waits for a place in the queue, and a refusal is an error.
    fn patiently(&mut self, line: &WordsLine) -> Result<()> {
        loop {
            let word = self.say(line)?;
            if line.command != FpgagCommand::Gcode || word == 0 {
                return Ok(());
            }
            if word != status::FULL {
                bail!("line {}: {}", line.number, refused(word));
            }
            if !self.runs {
                bail!(
                    "line {}: the queue of the board is full and nothing is executed; put START before this line",
                    line.number
                );
            }
            let report = self.board.report()?;
            self.alive(&report)?;
            std::thread::sleep(AGAIN);
        }
    }

    /// Lines as they come; between them the board hears that the client is there.
    fn keyboard(&mut self) -> Result<()> {
        let terminal = std::io::stdin().is_terminal();
        let prompt = || {
            if terminal {
                eprint!("words> ");
                let _ = std::io::stderr().flush();
            }
        };
        let (told, heard) = mpsc::channel();
        std::thread::spawn(move || {
            for line in std::io::stdin().lock().lines() {
                if told.send(line).is_err() {
                    return;
                }
            }
        });
        let (mut number, mut wrong) = (0, 0);
        prompt();
        loop {
            let text = match heard.recv_timeout(LOOK) {
                Ok(text) => text?,
                Err(RecvTimeoutError::Timeout) => {
                    let report = self.board.report()?;
                    self.alive(&report)?;
                    continue;
                }
                Err(RecvTimeoutError::Disconnected) => break,
            };
            number += 1;
            let said = match WordsLine::parse(number, &text) {
                Ok(None) => Ok(()),
                Ok(Some(line)) if terminal => match self.say(&line) {
                    Ok(status::FULL) if line.command == FpgagCommand::Gcode => {
                        Err(anyhow!("refused: send it again when STATUS is not FULL"))
                    }
                    Ok(word) if line.command == FpgagCommand::Gcode && word != 0 => {
                        Err(anyhow!(refused(word)))
                    }
                    other => other.map(drop),
                },
                Ok(Some(line)) => self.patiently(&line),
                Err(error) => Err(anyhow!(error)),
            };
            if let Err(error) = said {
                wrong += 1;
                eprintln!("ferrocnc: {error:#}");
            }
            prompt();
        }
        match wrong {
            0 => Ok(()),
            _ if terminal => Ok(()),
            _ => bail!("{wrong} of {number} lines were refused"),
        }
    }

    /// An error if the board has ended what START began.
    fn alive(&mut self, report: &Report) -> Result<()> {
        if !self.acquired || report.state != State::Stopped {
            return Ok(());
        }
        (self.acquired, self.runs) = (false, false);
        let remedy = match report.end {
            End::Underrun => {
                "; the last instruction has to end at rest, or the next one has to come in time"
            }
            End::Limits => "; the machine description allows less than the words ask for",
            _ => "",
        };
        bail!("the board has ended it: {}{remedy}", report.end.text())
    }

    /// Waits until the words are executed, and gives the board back; after an error at once.
    fn end(&mut self, done: Result<()>) -> Result<()> {
        let done = done.and_then(|()| self.settle());
        if self.acquired {
            let ended = self.board.command(JobCommand::Stop);
            if done.is_ok() {
                ended?;
            }
        } else if done.is_err() {
            self.waiting();
        }
        done
    }

    /// Until the words are executed: their time has passed on the board, and its motors stand.
    fn settle(&mut self) -> Result<()> {
        let least = (self.seconds * 1e3 * 0.9) as u32;
        let mut before = None;
        let report = loop {
            let report = self.board.report()?;
            self.alive(&report)?;
            let begun = self.sent == 0 || report.segments > 0 && report.elapsed >= least;
            let rests = report.stands && before == Some((report.segments, report.steps));
            if !self.runs || begun && rests {
                break report;
            }
            before = Some((report.segments, report.steps));
            std::thread::sleep(AGAIN);
        };
        match self.as_json {
            true => crate::text::say(&format!("{}\n", json!({ "steps": report.steps })))?,
            false => crate::text::say(&format!("at steps {:?}\n", report.steps))?,
        }
        self.waiting();
        Ok(())
    }

    /// The board keeps what was never started, also for the next client.
    fn waiting(&self) {
        if !self.acquired && self.sent > 0 {
            eprintln!(
                "ferrocnc: {} instructions wait on the board; START executes them",
                self.sent
            );
        }
    }
}

/// Why the board says DISPATCHERROR to words that are an instruction.
fn refused(word: u32) -> String {
    match word {
        status::PARSE_ERROR => "the board refuses the instruction: a motor would jump, be faster than the machine, or leave its limits or could not brake within them; check it against the machine description, and the speed at which the one before ends".to_owned(),
        _ => format!("the board refuses the instruction: {}", words::bits(word).join(" ")),
    }
}

/// A refusal with its remedy.
fn hinted(error: JobError) -> String {
    let hint = match &error {
        JobError::Refused(_, Status::NoMachine, _) => "; --machine MACHINE.toml sends one",
        JobError::Refused(_, Status::NotNow, _) => {
            "; a job runs (ferrocnc job status), or an axis has to find its switch (ferrocnc job home)"
        }
        _ => "",
    };
    format!("{error}{hint}")
}
