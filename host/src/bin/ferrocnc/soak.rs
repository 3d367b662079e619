//! `ferrocnc doctor BOARD --soak`: the exchange itself, measured for a while.

use crate::findings;
use crate::progress::Bar;
use anyhow::{Context, Result, bail};
use ferrocnc::client::Client;
use ferrocnc::doctor::port::Errors;
use ferrocnc::doctor::soak::run::{Plan, measure};
use ferrocnc::doctor::soak::{Measured, PERIOD, picture, refusal};
use ferrocnc::doctor::system::System;
use ferrocnc::doctor::{cpu, network};
use ferrocnc::job::preview;
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

/// Pixels of a PNG's width.
const WIDE: u32 = 960;
/// Between two looks at how far it is.
const LOOK: Duration = Duration::from_millis(50);
/// A day: longer ones are a mistake.
const LONGEST: f64 = 86_400.0;

/// What is to be done besides measuring.
pub(crate) struct Options<'o> {
    pub seconds: f64,
    pub plot: Option<&'o Path>,
    pub report: Option<&'o Path>,
    pub as_json: bool,
}

pub(crate) fn run(system: &System<'_>, client: Client, options: &Options<'_>) -> Result<()> {
    if let Some(why) = refusal(system) {
        bail!(why);
    }
    if !(options.seconds > 0.0 && options.seconds <= LONGEST) {
        bail!("--soak takes seconds, more than 0 and at most a day: --soak 60");
    }
    let exchanges = (options.seconds / PERIOD.as_secs_f64()).ceil() as u64;
    let plan = Plan {
        period: PERIOD,
        exchanges,
        cpu: cpu::isolated(system),
    };
    let board = client.address().text.clone();
    let port = network::to(system, *client.address().socket.ip()).unwrap_or_default();
    let before = Errors::read(system, &port);
    let measured = watched(client, &plan, options.as_json)?;
    if let Some(file) = options.plot {
        plot(&measured, &board, file)?;
    }
    let mut report = measured.report(board);
    let errors = Errors::read(system, &port).since(before);
    report.findings.push(errors);
    let mut json = report.to_json();
    json["measured"] = measured.to_json();
    let columns = usize::from(console::Term::stdout().size().1);
    let text = picture::text(&measured.exchange, columns) + "\n" + &report.to_text();
    findings::tell_as(&report, &text, &json, options.report, options.as_json)
}

/// Measures, and shows how far it is; not in the thread that measures, because a terminal is slow.
fn watched(client: Client, plan: &Plan, quiet: bool) -> Result<Measured> {
    let done = AtomicU64::new(0);
    std::thread::scope(|scope| {
        let thread = scope.spawn(|| {
            measure(client, plan, |n| {
                done.store(n, Ordering::Relaxed);
                true
            })
        });
        let mut bar = Bar::new(quiet);
        while !thread.is_finished() {
            let part = done.load(Ordering::Relaxed) as f64 / plan.exchanges as f64;
            bar.show("exchanges", part);
            std::thread::sleep(LOOK);
        }
        let measured = thread.join();
        Ok(measured.map_err(|_| anyhow::anyhow!("the thread that measures failed"))??)
    })
}

fn plot(measured: &Measured, board: &str, file: &Path) -> Result<()> {
    let title = format!("{} exchanges with {board}", measured.asked);
    let svg = picture::svg(measured, &title).map_err(anyhow::Error::msg)?;
    let is_png = file.extension().is_some_and(|ending| ending == "png");
    let bytes = match is_png {
        true => preview::png(&svg, WIDE).map_err(anyhow::Error::msg)?,
        false => svg.into_bytes(),
    };
    std::fs::write(file, bytes).with_context(|| format!("cannot write {}", file.display()))
}
