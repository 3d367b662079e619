//! `ferrocnc test`: inputs are looked at, one output is switched on, an axis jogged, an encoder
//! turned, in a terminal.
//!
//! One thread exchanges with the board, reads keys and draws. What holds it up (a terminal that
//! takes no more, a closed lid) ends the exchanges, and the board's watchdog stops the axes.

mod keys;
mod machine;
mod screen;

pub(crate) use machine::{layout, name};

use anyhow::{Context, Result, bail};
use clap::Args;
use ferrocnc::client::{Client, Identity};
use ferrocnc::selftest::run::{BusyError, idle};
use ferrocnc::tryout::board::Bench;
use ferrocnc::tryout::{Act, Tryout};
use ratatui::crossterm::event::{
    self, Event, KeyboardEnhancementFlags, PopKeyboardEnhancementFlags,
    PushKeyboardEnhancementFlags,
};
use ratatui::crossterm::execute;
use ratatui::crossterm::terminal::supports_keyboard_enhancement;
use signal_hook::consts::{SIGHUP, SIGTERM};
use std::io::{IsTerminal, stdout};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// Between two exchanges: a fortieth of the watchdog's time.
pub(crate) const EVERY: Duration = Duration::from_millis(5);
/// Between two drawings.
pub(crate) const SHOWN: Duration = Duration::from_millis(50);

/// Switch one output, jog one axis, turn an encoder, look at the inputs: by hand, in a terminal.
/// Nothing is driven before the key `a`. Refused while another program owns the board.
#[derive(Args)]
pub(crate) struct TestArguments {
    /// IP[:port] of the board.
    #[arg(value_name = "ADDR")]
    address: String,
    /// Distances in units, and the drives' timings and speeds: of this machine. What is measured
    /// is offered to it.
    #[arg(long, short, value_name = "MACHINE.toml")]
    machine: Option<PathBuf>,
    /// How long to wait for one answer. Three in a row that are missing switch everything off.
    #[arg(long, value_name = "MS", default_value_t = 20, value_parser = clap::value_parser!(u64).range(1..=1000))]
    patience: u64,
}

pub(crate) fn run(arguments: &TestArguments, as_json: bool) -> Result<()> {
    if as_json || !stdout().is_terminal() {
        bail!("this draws on a terminal; ferrocnc watch BOARD --json is for other programs");
    }
    let (client, identity) = ready(&arguments.address)?;
    let patience = Duration::from_millis(arguments.patience);
    let machine = arguments.machine.as_deref();
    let mut machine = machine.map(machine::File::read).transpose()?;
    let layout = layout(&identity, machine.as_ref());
    let title = format!("{} at {}", name(&identity), client.address());
    // Asks the terminal, which may take its time: before the board waits for us.
    let tells_release = supports_keyboard_enhancement().unwrap_or(false);
    let mut bench = Bench::take(client, &identity, &layout, patience)?;
    let mut tryout = Tryout::new(layout);
    let mut lines = Vec::new();
    let mut terminal = ratatui::try_init().context("no terminal")?;
    if tells_release {
        let flags = KeyboardEnhancementFlags::REPORT_EVENT_TYPES
            | KeyboardEnhancementFlags::DISAMBIGUATE_ESCAPE_CODES;
        let _ = execute!(stdout(), PushKeyboardEnhancementFlags(flags));
    }
    let ended = drive(
        &mut terminal,
        &mut bench,
        &mut tryout,
        &title,
        |found, tryout| match &mut machine {
            Some(machine) => machine.take(found, tryout),
            None => {
                let name = &tryout.layout.motors[found.motor].line.name;
                lines.push(format!("{name}: {}", found.line("unit")));
                tryout.say("printed when this ends");
            }
        },
    );
    // The machine is at rest before anything else.
    drop(bench);
    if is_gone() {
        // It would be told that the cursor cannot be shown again, which fails, too.
        std::mem::forget(terminal);
        return Ok(());
    }
    if tells_release {
        let _ = execute!(stdout(), PopKeyboardEnhancementFlags);
    }
    ratatui::restore();
    for line in lines {
        crate::text::say(&format!("{line}\n"))?;
    }
    ended
}

/// A board that no other program drives, at rest.
pub(crate) fn ready(address: &str) -> Result<(Client, Identity)> {
    let mut client = crate::open(address)?;
    let identity = client.identify()?;
    client.check(&identity)?;
    match idle(&mut client, &identity) {
        Ok(()) => Ok((client, identity)),
        Err(BusyError::State(state)) => bail!("the board is {state}; this needs it at rest"),
        Err(error) => Err(error.into()),
    }
}

/// Whether the terminal has been closed. The keys may come from another place than our standard
/// input; what we draw on is one.
fn is_gone() -> bool {
    let mut terminal = libc::pollfd {
        fd: libc::STDOUT_FILENO,
        events: 0,
        revents: 0,
    };
    // SAFETY: it points to one descriptor, which lives until the call is over; it does not wait.
    let found = unsafe { libc::poll(&raw mut terminal, 1, 0) };
    found > 0 && terminal.revents & (libc::POLLHUP | libc::POLLERR | libc::POLLNVAL) != 0
}

fn drive(
    terminal: &mut ratatui::DefaultTerminal,
    bench: &mut Bench,
    tryout: &mut Tryout,
    title: &str,
    mut write: impl FnMut(&ferrocnc::tryout::measured::Measured, &mut Tryout),
) -> Result<()> {
    let ends = Arc::new(AtomicBool::new(false));
    for signal in [SIGTERM, SIGHUP] {
        signal_hook::flag::register(signal, ends.clone()).context("no signals")?;
    }
    let begin = Instant::now();
    let mut drawn = None;
    while !ends.load(Ordering::Relaxed) && !is_gone() {
        let now = begin.elapsed();
        // At the end of a terminal that is gone crossterm would read for ever, and the signal may
        // come later.
        while !is_gone() && event::poll(Duration::ZERO)? {
            let Event::Key(pressed) = event::read()? else {
                continue;
            };
            let Some(key) = keys::key(&pressed, tryout.typed().is_some()) else {
                continue;
            };
            match tryout.key(key, now) {
                Some(Act::Quit) => return Ok(()),
                Some(Act::Write(found)) => write(&found, tryout),
                None => {}
            }
        }
        bench.turn(tryout, now);
        if drawn.is_none_or(|last| now.saturating_sub(last) >= SHOWN) {
            terminal.draw(|frame| screen::draw(frame, tryout, title))?;
            drawn = Some(now);
        }
        std::thread::sleep((now + EVERY).saturating_sub(begin.elapsed()));
    }
    Ok(())
}
