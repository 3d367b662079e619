//! A text console for `telnet` or `nc`: it shows everything and changes almost nothing.
//!
//! ```text
//!   bytes --> telnet --> line_editor --> Ask --> pieces of an answer, one a turn --> text
//!                                                  |                  |
//!                                      the board's windows    Machine::visit: may this client?
//! ```
//!
//! It reads the board's windows as every client does, and only what changes nothing. What needs a
//! judgment (`login`, `restart`, `job start`) is asked of the ROM ([`Verb`]); the text is from
//! here. So it answers while a host moves the machine, too.
//!
//! The owner's exchange waits for each call of the services, so a turn makes a piece of an answer:
//! it asks for at most [`Reader::WORDS`] words with one datagram, and writes at most [`PIECE_MAX`]
//! bytes.

mod ask;
mod board;
mod channels;
mod network;
mod reader;

pub use ask::Ask;
pub use reader::Reader;

use super::line_editor::{ECHO_MAX, End, LineEditor, PROMPT, TOO_LONG};
use super::telnet::Telnet;
use super::{Network, job_lines};
use crate::machine::{VISIT_WORDS, Verb, Verdict};
use crate::text::{Out, Sink, Text};
use ::jobs::Jobs;

/// `login` answers this, the challenge in 32 hex digits, and the board's unique id in 16.
pub const CHALLENGE: &str = "challenge ";
/// `login ANSWER` answers this if the answer is right.
pub const WELCOME: &str = "welcome";
/// The answer to `job` on a board without jobs.
pub const NO_JOBS: &str = "no jobs here; `ferrocnc describe` says why";
/// Most bytes of a turn's text.
pub const PIECE_MAX: usize = 400;
/// Bytes of echo behind which a turn takes no more keys.
const ECHO: usize = 200;
const _: () = assert!(ECHO + ECHO_MAX + PROMPT.len() <= PIECE_MAX);

const HELP: [&str; 17] = [
    "help          this",
    "status        what the machine is doing, and why it stopped",
    "net           frames and refusals by reason",
    "regs [page]   the CSR pages, or the first words of one",
    "stepgen [n]   positions, velocities, timings",
    "encoder [n]   counts, latches, errors, modes",
    "pwm [n]       periods and modes",
    "gpio          inputs, e-stop, probe",
    "watchdog      timeout, time left, what closed the gate",
    "log           where the log stands, and the last obituary",
    "link          speed, and what got lost",
    "flash         the chip, running and next image",
    "settings      name and addresses, and their source",
    "job           what jobs do; try job help",
    "login         with the key; `ferrocnc console` does it",
    "restart       start the firmware anew",
    "quit          good bye",
];

/// Has a piece been the last one of its answer? `None`: the board refuses to be read.
type Piece = Option<More>;

/// Is there another piece of this answer?
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum More {
    Yes,
    No,
}

impl More {
    fn when(more: bool) -> Self {
        if more { More::Yes } else { More::No }
    }
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Stage {
    /// The client has just connected.
    #[default]
    New,
    /// It types.
    Typing,
    /// It is answered: the next piece.
    Answering(Ask, u16),
    /// The connection is to be closed.
    Closed,
}

/// The console of one client.
#[derive(Clone, Debug, Default)]
pub struct Console {
    telnet: Telnet,
    editor: LineEditor,
    stage: Stage,
}

/// A client at a console, and what its answers need besides the board.
pub struct Visit<'a, 'm, O> {
    /// The number of the console.
    pub visitor: usize,
    /// How to read the board.
    pub reader: &'a mut Reader,
    /// On boards with jobs.
    pub jobs: Option<&'a mut Jobs<'m>>,
    /// The board.
    pub out: &'a mut O,
}

impl Console {
    /// For a new client.
    pub const fn new() -> Self {
        Console {
            telnet: Telnet::new(),
            editor: LineEditor::new(),
            stage: Stage::New,
        }
    }

    /// A new client is there. What its predecessor typed is forgotten in the next turn: the call
    /// with its first frame is the longest of all.
    pub fn open(&mut self) {
        self.stage = Stage::New;
    }

    /// Is there something to say before the client's next byte is taken?
    pub fn busy(&self) -> bool {
        matches!(self.stage, Stage::New | Stage::Answering(..))
    }

    /// A turn: takes some of the client's bytes and returns how many, or makes a piece of an
    /// answer.
    pub fn turn<O: Network>(
        &mut self,
        bytes: &[u8],
        visit: &mut Visit<'_, '_, O>,
        text: &mut Text,
    ) -> usize {
        match self.stage {
            Stage::New => {
                *self = Console::new();
                visit.ask(Verb::Connect);
                self.prompt(text);
                0
            }
            Stage::Typing => self.take(bytes, text),
            Stage::Answering(ask, step) => {
                let line = self.editor.line().unwrap_or("");
                match visit.piece(ask, step, line, text) {
                    Some(More::Yes) => self.stage = Stage::Answering(ask, step.saturating_add(1)),
                    Some(More::No) if ask == Ask::Quit => self.close(text),
                    Some(More::No) => self.prompt(text),
                    None => {
                        Out(text).text("? the board does not answer").end();
                        self.prompt(text);
                    }
                }
                0
            }
            Stage::Closed => bytes.len(),
        }
    }

    fn prompt(&mut self, text: &mut Text) {
        self.stage = Stage::Typing;
        Sink::put(text, PROMPT.as_bytes());
    }

    fn close(&mut self, text: &mut Text) {
        self.stage = Stage::Closed;
        text.close = true;
    }

    /// Takes bytes up to the end of a line.
    fn take(&mut self, bytes: &[u8], text: &mut Text) -> usize {
        let before = text.bytes().len();
        for (taken, byte) in (1..).zip(bytes) {
            let Some(byte) = self.telnet.push(*byte, text) else {
                continue;
            };
            let end = self.editor.push(byte, self.telnet.echoes(), text);
            match end {
                Some(End::Line) => {
                    let ask = self.editor.line().map_or(Ask::TooLong, Ask::parse);
                    self.stage = Stage::Answering(ask, 0);
                }
                Some(End::Abandoned) => self.prompt(text),
                Some(End::Close) => self.stage = Stage::Answering(Ask::Quit, 0),
                None => {}
            }
            if self.stage != Stage::Typing || text.bytes().len() - before > ECHO {
                return taken;
            }
        }
        bytes.len()
    }
}

/// What a client reads instead of an answer.
fn refusal(verdict: Verdict) -> &'static str {
    match verdict {
        Verdict::Yes => "",
        Verdict::NotNow => "? not while armed",
        Verdict::Key => "refused: the board has a key; use `ferrocnc console`",
        Verdict::Wrong => "refused: wrong answer",
        Verdict::Armed => "refused: the machine is armed",
        Verdict::Owned => "refused: a host drives the board",
        Verdict::Flash => "refused: a flash operation is running",
    }
}

impl<O: Network> Visit<'_, '_, O> {
    fn ask(&mut self, verb: Verb) -> Verdict {
        self.out.console(self.visitor, verb, &mut [0; VISIT_WORDS])
    }

    /// Makes one piece.
    fn piece(&mut self, ask: Ask, step: u16, line: &str, text: &mut Text) -> Piece {
        let mut paper = Out(text);
        let (reader, out) = (&mut *self.reader, &mut *self.out);
        match ask {
            Ask::Nothing => {}
            Ask::Unknown => paper.text("? try help").end(),
            Ask::TooLong => paper.text("? ").text(TOO_LONG).end(),
            Ask::Quit => paper.text("bye").end(),
            Ask::Help => {
                let step = usize::from(step);
                paper.text(HELP.get(step).unwrap_or(&"")).end();
                return Some(More::when(step + 1 < HELP.len()));
            }
            Ask::Status if step >= board::STACK => {
                let mut words = [0; VISIT_WORDS];
                let [part, ..] = &mut words;
                *part = (step - board::STACK).into();
                if out.console(self.visitor, Verb::Stack, &mut words) == Verdict::NotNow {
                    return Some(More::Yes);
                }
                let [used, size, ..] = words;
                paper.text("stack    ").number(used);
                paper.text(" of ").number(size).text(" bytes").end();
            }
            Ask::Status => return board::status(step, reader, out, &mut paper),
            Ask::Gpio => return board::gpio(reader, out, &mut paper),
            Ask::Watchdog => return board::watchdog(step, reader, out, &mut paper),
            Ask::Log => return board::log(step, reader, out, &mut paper),
            Ask::Flash => return board::flash(step, reader, out, &mut paper),
            Ask::Net => return network::net(step, reader, out, &mut paper),
            Ask::Link => return network::link(step, reader, out, &mut paper),
            Ask::Settings => return network::settings(step, reader, out, &mut paper),
            Ask::Regs(page) => return channels::regs(page, step, reader, out, &mut paper),
            Ask::Stepgen(n) => return channels::stepgen(n, step, reader, out, &mut paper),
            Ask::Encoder(n) => return channels::encoder(n, step, reader, out, &mut paper),
            Ask::Pwm(n) => return channels::pwm(n, step, reader, out, &mut paper),
            Ask::Login(answer) => self.login(answer, &mut paper),
            Ask::Restart => match self.ask(Verb::Restart) {
                Verdict::Yes => paper.text("restarting").end(),
                verdict => paper.text(refusal(verdict)).end(),
            },
            Ask::Job => return self.job(step, line, text),
        }
        Some(More::No)
    }

    fn login(&mut self, answer: Option<[u32; 4]>, paper: &mut Out) {
        let verb = match answer {
            None => Verb::Challenge,
            Some(_) => Verb::Answer,
        };
        let [a, b, c, d] = answer.unwrap_or_default();
        let mut words = [a, b, c, d, 0, 0];
        match self.out.console(self.visitor, verb, &mut words) {
            Verdict::Yes if answer.is_none() => {
                paper.text(CHALLENGE);
                for word in words {
                    paper.hex(word);
                }
                paper.end();
            }
            Verdict::Yes => paper.text(WELCOME).end(),
            verdict => paper.text(refusal(verdict)).end(),
        }
    }

    fn job(&mut self, step: u16, line: &str, text: &mut Text) -> Piece {
        let may = match job_lines::need(line) {
            job_lines::Need::Look => Verdict::Yes,
            job_lines::Need::Stop => match self.ask(Verb::Change) {
                // To stop needs no key.
                Verdict::Key => Verdict::Yes,
                verdict => verdict,
            },
            job_lines::Need::Change => self.ask(Verb::Change),
        };
        match (may, &mut self.jobs) {
            (_, None) => Out(text).text(NO_JOBS).end(),
            (Verdict::Yes, Some(jobs)) => {
                return Some(More::when(job_lines::piece(
                    jobs, line, step, text, self.out,
                )));
            }
            (verdict, Some(_)) => Out(text).text(refusal(verdict)).end(),
        }
        Some(More::No)
    }
}

#[cfg(test)]
mod tests;
