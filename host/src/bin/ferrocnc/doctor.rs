//! `ferrocnc doctor`: what of this computer makes exchanges late or loses them.

use crate::{consent, findings, soak};
use anyhow::{Context, Error, Result, anyhow, bail};
use clap::Args;
use ferrocnc::doctor::files::Files;
use ferrocnc::doctor::fix::{Fix, before, fixes, undo_file, written};
use ferrocnc::doctor::system::System;
use ferrocnc::doctor::{Subject, board, examine, line, machine, names};
use ferrocnc::finding::Report;
use serde::Deserialize;
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use std::time::Duration;

/// An hour: longer ones are a mistake.
const LONGEST: f64 = 3600.0;

#[derive(Args)]
pub(crate) struct Doctor {
    /// IP[:port] of the board: the port that leads to it is looked at, and the board itself.
    #[arg(value_name = "BOARD")]
    address: Option<String>,
    /// This port, whatever leads to the board.
    #[arg(long, value_name = "IF")]
    interface: Option<String>,
    /// Write the report there as well, without MAC addresses; JSON if the name ends in .json.
    #[arg(long, value_name = "FILE")]
    report: Option<PathBuf>,
    /// Measure the exchange with the board, a thousand times a second for so many seconds (60), as
    /// LinuxCNC's servo thread does. The board is taken for that time, and nothing moves.
    #[arg(long, value_name = "SECONDS", num_args = 0..=1, default_missing_value = "60",
          requires = "address", conflicts_with_all = ["interface", "fix", "undo"])]
    soak: Option<f64>,
    /// Draw the soak there: SVG, or PNG if the name ends in .png.
    #[arg(long, value_name = "FILE", requires = "soak")]
    plot: Option<PathBuf>,
    /// Count for so many seconds (10) the frames that this computer sends to the port by itself.
    #[arg(long, value_name = "SECONDS", num_args = 0..=1, default_missing_value = "10",
          conflicts_with_all = ["soak", "fix", "undo"])]
    listen: Option<f64>,
    /// Ping the board a thousand times a second at real-time priority for so many seconds (30): on
    /// whichever processor, then on LinuxCNC's.
    #[arg(long, value_name = "SECONDS", num_args = 0..=1, default_missing_value = "30",
          requires = "address", conflicts_with_all = ["soak", "fix", "undo"])]
    ping: Option<f64>,
    /// Look at this LinuxCNC configuration, too: its HAL files against the board, step timing,
    /// limits, homing, watchdog, e-stop.
    #[arg(long, value_name = "FILE.ini", conflicts_with_all = ["soak", "fix", "undo"])]
    ini: Option<PathBuf>,
    /// Repair CPU frequency, real-time throttling and power of PCIe, now and for every start of the
    /// computer; asks for each. `ferrocnc net setup` repairs the port.
    #[arg(long, conflicts_with_all = ["address", "interface", "report"])]
    fix: bool,
    /// Take back what --fix did; asks for each.
    #[arg(long, conflicts_with_all = ["fix", "address", "interface", "report"])]
    undo: bool,
    /// Do not ask.
    #[arg(long, short)]
    yes: bool,
}

pub(crate) fn run(arguments: &Doctor, as_json: bool) -> Result<()> {
    let system = System::real();
    if as_json && (arguments.fix || arguments.undo) {
        bail!("--fix and --undo tell what they do as text; leave --json out");
    }
    match (arguments.fix, arguments.undo) {
        (true, _) => return fix(&system, arguments.yes),
        (_, true) => return undo(&system, arguments.yes),
        (false, false) => {}
    }
    if let Some(seconds) = arguments.soak {
        let Some(address) = &arguments.address else {
            bail!("name the board to measure: ferrocnc doctor BOARD --soak");
        };
        let client = crate::open(address)?;
        let options = soak::Options {
            seconds,
            plot: arguments.plot.as_deref(),
            report: arguments.report.as_deref(),
            as_json,
        };
        return soak::run(&system, client, &options);
    }
    let report = report(&Questions {
        address: arguments.address.as_deref(),
        interface: arguments.interface.clone(),
        listen: time("--listen 10", arguments.listen)?,
        ping: time("--ping 30", arguments.ping)?,
        ini: arguments.ini.as_deref(),
    })?;
    findings::tell(&report, arguments.report.as_deref(), as_json)
}

/// The time of an option; what is to be said instead if it is none.
fn time(usual: &str, seconds: Option<f64>) -> Result<Option<Duration>> {
    let is_one = |seconds: f64| seconds > 0.0 && seconds <= LONGEST;
    if !seconds.is_none_or(is_one) {
        let option = usual.split(' ').next().unwrap_or_default();
        bail!("{option} takes seconds, more than 0 and at most an hour: {usual}");
    }
    Ok(seconds.map(Duration::from_secs_f64))
}

/// What is to be looked at besides this computer.
#[derive(Default)]
pub(crate) struct Questions<'q> {
    pub(crate) address: Option<&'q str>,
    pub(crate) interface: Option<String>,
    pub(crate) listen: Option<Duration>,
    pub(crate) ping: Option<Duration>,
    pub(crate) ini: Option<&'q Path>,
}

/// Looks at this computer, at the board and at a configuration, if they are named.
pub(crate) fn report(questions: &Questions<'_>) -> Result<Report> {
    let system = System::real();
    let client = questions.address.map(crate::open).transpose()?;
    let board = client.as_ref().map(|client| *client.address().socket.ip());
    let subject = Subject {
        board,
        interface: questions.interface.clone(),
        listen: questions.listen,
        ping: questions.ping,
    };
    let files = questions.ini.map(|ini| read(&system, ini)).transpose()?;
    let mut report = examine(&system, &subject);
    let mut pins = None;
    if let Some(mut client) = client {
        let asked = board::examine(&system, &mut client, &crate::keys());
        report.findings.extend(asked);
        if files.is_some() {
            pins = client.identify().ok().and_then(|it| names::pins(&it));
        }
        // Behind the count of frames, which these questions would be part of.
        let port = subject.port(&system).unwrap_or_default();
        report.findings.extend(line::boards(&system, &port));
        let owners = board.map(|ip| line::owners(&system, &port, ip));
        report.findings.extend(owners);
    }
    if let Some(files) = files {
        let found = machine::examine(&files, pins.as_deref());
        report.findings.extend(found);
    }
    Ok(report)
}

fn read(system: &System<'_>, ini: &Path) -> Result<Files> {
    // Relative to where the command is given, not to the root.
    let path = std::path::absolute(ini)?;
    Files::read(system, &path.to_string_lossy()).with_context(|| {
        format!(
            "cannot read {}; name the .ini file that LinuxCNC starts with",
            ini.display()
        )
    })
}

fn fix(system: &System<'_>, yes: bool) -> Result<()> {
    consent::needs_root("values of the kernel", "doctor --fix")?;
    let all = fixes(system);
    if all.is_empty() {
        println!(
            "nothing to repair: CPU frequency, real-time throttling and power of PCIe are as they should be"
        );
    }
    for fix in &all {
        print!("{}", to_text(fix));
        if !(yes || consent::is_yes("Is this to be done?")?) {
            println!("{}: left as it is", fix.check);
            continue;
        }
        fix.apply(system).map_err(anyhow::Error::msg)?;
        println!("{}: repaired", fix.check);
    }
    Ok(())
}

fn to_text(fix: &Fix) -> String {
    let mut text = format!("{}\n", fix.check);
    for value in &fix.values {
        let (path, now, wanted) = (&value.path, &value.now, value.wanted);
        text += &format!("  /{path}: {now}, to be {wanted}\n");
    }
    text + &format!("  /{} makes it last\n", fix.path())
}

/// For a page: each repair with all that it would write, and what takes back each that was made.
pub(crate) fn repairs() -> Value {
    let system = System::real();
    let root = consent::needs_root("values of the kernel", "doctor --fix");
    json!({
        "fixes": fixes(&system).iter().map(|fix| fix_to_json(&system, fix)).collect::<Vec<_>>(),
        "undo": written(&system).iter().map(|path| undo_to_json(&system, path)).collect::<Vec<_>>(),
        "refused": root.err().map(|why| why.to_string()),
    })
}

fn fix_to_json(system: &System<'_>, fix: &Fix) -> Value {
    let mut writes: Vec<Value> = fix
        .values
        .iter()
        .map(|value| json!({ "path": format!("/{}", value.path), "now": value.now, "text": value.wanted }))
        .collect();
    let now = system.read(&fix.path());
    let text = fix.text(now.as_deref());
    writes.push(json!({ "path": format!("/{}", fix.path()), "now": now, "text": text }));
    json!({ "check": fix.check, "writes": writes })
}

fn undo_to_json(system: &System<'_>, path: &str) -> Value {
    let text = system.read(path).unwrap_or_default();
    let mut writes: Vec<Value> = before(&text)
        .map(|(file, value)| {
            json!({ "path": format!("/{file}"), "now": system.read(file), "text": value })
        })
        .collect();
    writes.push(json!({ "path": format!("/{path}"), "now": text, "text": null }));
    json!({ "check": path, "writes": writes })
}

/// One repair that a page has shown, or the end of one: done only if it would still write what was
/// shown.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Shown {
    undo: bool,
    shown: Value,
}

impl Shown {
    pub(crate) fn take(&self) -> Result<()> {
        let system = System::real();
        consent::needs_root("values of the kernel", "doctor --fix")?;
        let stale = || {
            anyhow!("what would be written is not what was shown any more; look again, then decide")
        };
        if self.undo {
            let all = written(&system);
            let path = all
                .iter()
                .find(|path| undo_to_json(&system, path) == self.shown);
            return undo_file(&system, path.ok_or_else(stale)?).map_err(Error::msg);
        }
        let all = fixes(&system);
        let fix = all
            .iter()
            .find(|fix| fix_to_json(&system, fix) == self.shown);
        fix.ok_or_else(stale)?.apply(&system).map_err(Error::msg)
    }
}

fn undo(system: &System<'_>, yes: bool) -> Result<()> {
    consent::needs_root("values of the kernel", "doctor --undo")?;
    let all = written(system);
    if all.is_empty() {
        bail!(
            "there is nothing to take back: no file of `ferrocnc doctor --fix` is in /etc/tmpfiles.d"
        );
    }
    for path in &all {
        println!("remove /{path}");
        for (file, value) in before(&system.read(path).unwrap_or_default()) {
            println!("  /{file}: to be {value}");
        }
        if yes || consent::is_yes("Is this to be done?")? {
            undo_file(system, path).map_err(anyhow::Error::msg)?;
        }
    }
    Ok(())
}
