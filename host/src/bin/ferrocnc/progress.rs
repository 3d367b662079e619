//! Shows progress: a bar on a terminal, otherwise one line per step. A page of `ferrocnc ui` gets
//! the same words.

use ferrocnc::flash::Word;
use ferrocnc::{pins, update};
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::cell::RefCell;
use std::io::IsTerminal;

/// What is going on, in words.
pub(crate) enum Progress {
    /// So much of a step is done, of 1.
    Step(&'static str, f64),
    /// A sentence.
    Word(String),
}

impl From<update::Event> for Progress {
    fn from(event: update::Event) -> Self {
        let word = match event {
            update::Event::Step(step, part) => return Progress::Step(step, part),
            update::Event::Word(word) => said(word),
            update::Event::NoGolden => "warning: there is no golden image in this board's flash; if both slots fail the board needs JTAG".to_owned(),
            update::Event::Unprotected => {
                "warning: the board's flash does not protect its golden image".to_owned()
            }
        };
        Progress::Word(word)
    }
}

impl From<pins::Event> for Progress {
    fn from(event: pins::Event) -> Self {
        match event {
            pins::Event::Step(step, part) => Progress::Step(step, part),
            pins::Event::Word(word) => Progress::Word(said(word)),
        }
    }
}

/// Shows on a terminal what is going on.
pub(crate) fn show(bar: &RefCell<Bar>, progress: Progress) {
    let mut bar = bar.borrow_mut();
    match progress {
        Progress::Step(step, part) => bar.show(step, part),
        Progress::Word(word) => bar.say(&word),
    }
}

/// That the board falls silent, or is back.
pub(crate) fn said(word: Word) -> String {
    match word {
        Word::Silent(patience) => format!(
            "the board does not answer; waiting up to {} s",
            patience.as_secs()
        ),
        Word::Back => "the board answers again".to_owned(),
    }
}

/// Shows the progress of a long operation.
pub(crate) struct Bar {
    bar: ProgressBar,
    step: String,
    lines: bool,
}

impl Bar {
    /// Nothing is shown when `quiet`: the answer is for a program.
    pub(crate) fn new(quiet: bool) -> Self {
        let terminal = std::io::stderr().is_terminal();
        let target = match terminal && !quiet {
            true => ProgressDrawTarget::stderr(),
            false => ProgressDrawTarget::hidden(),
        };
        let bar = ProgressBar::with_draw_target(Some(1000), target);
        if let Ok(style) = ProgressStyle::with_template("{msg:<24} [{bar:40}] {percent:>3} % {eta}")
        {
            bar.set_style(style.progress_chars("=> "));
        }
        Bar {
            bar,
            step: String::new(),
            lines: !terminal && !quiet,
        }
    }

    /// `part` of 1 of a step is done.
    pub(crate) fn show(&mut self, step: &str, part: f64) {
        if self.step != step {
            step.clone_into(&mut self.step);
            self.bar.reset();
            self.bar.set_message(step.to_owned());
            if self.lines {
                eprintln!("{step} ...");
            }
        }
        self.bar.set_position((part * 1000.0) as u64);
    }

    /// As [`Bar::show`], with the remaining time given by the caller.
    pub(crate) fn show_remaining(&mut self, step: &str, part: f64, remaining: &str) {
        self.show(step, part);
        self.bar.set_prefix(format!("{remaining} to go"));
        if let Ok(style) =
            ProgressStyle::with_template("{msg:<24} [{bar:40}] {percent:>3} % {prefix}")
        {
            self.bar.set_style(style.progress_chars("=> "));
        }
    }

    /// A sentence between bars.
    pub(crate) fn say(&self, text: &str) {
        if self.lines {
            eprintln!("{text}");
        } else {
            self.bar.println(text);
        }
    }
}

impl Drop for Bar {
    fn drop(&mut self) {
        self.bar.finish_and_clear();
    }
}
