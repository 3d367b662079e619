//! `ferrocnc selftest`: tests a new board and its wiring, and writes a report to send in.

use crate::findings;
use anyhow::{Result, bail};
use clap::Args;
use ferrocnc::client::Identity;
use ferrocnc::selftest::loops::{Loop, Sink, Source};
use ferrocnc::selftest::run::{Bench, PATIENCE, Plan, idle, run as test};
use ferrocnc::selftest::{Wall, gather};
use ferrocnc_config::Platform;
use ferrocnc_config::source::BUILT_IN;
use std::io::{BufRead, IsTerminal, Write};
use std::path::PathBuf;
use std::time::Duration;
use wire::board::Kind;

#[derive(Args)]
pub(crate) struct Selftest {
    /// IP[:port] of the board.
    #[arg(value_name = "BOARD")]
    address: String,
    /// Arm the board and switch every output pin, one after the other: general ones, STEP, DIR,
    /// PWM.
    #[arg(long)]
    outputs: bool,
    /// Arm the board and test this jumper: x=spindle (STEP to A, DIR to B), x=door, x.dir=door,
    /// output.2=door, pwm.0=door.
    #[arg(long = "loop", value_name = "SOURCE=SINK")]
    loops: Vec<String>,
    /// Steps each way through a jumper into an encoder.
    #[arg(long, default_value_t = 1_000, value_name = "N", value_parser = clap::value_parser!(u32).range(10..=100_000))]
    steps: u32,
    /// How long to compare the board's clock with this computer's.
    #[arg(long, default_value_t = 5.0, value_name = "S", value_parser = seconds)]
    seconds: f64,
    /// Questions to ask over the link.
    #[arg(long, default_value_t = 2_000, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    questions: u32,
    /// Everything named below is disconnected: do not ask.
    #[arg(long)]
    yes: bool,
    /// Write the report there as well; JSON if the name ends in .json.
    #[arg(long, value_name = "FILE")]
    report: Option<PathBuf>,
}

fn seconds(text: &str) -> Result<f64, String> {
    let right = text.parse().ok().filter(|s| (0.5..=3600.0).contains(s));
    right.ok_or_else(|| "seconds, from 0.5 to 3600".to_owned())
}

pub(crate) fn run(arguments: &Selftest, as_json: bool) -> Result<()> {
    let mut client = crate::open(&arguments.address)?;
    let identity = client.identify()?;
    idle(&mut client, &identity)?;
    let loops: Result<Vec<Loop>, String> = arguments
        .loops
        .iter()
        .map(|text| Loop::parse(&identity, text))
        .collect();
    let plan = Plan {
        look: Duration::from_secs_f64(arguments.seconds),
        questions: arguments.questions,
        flash_bytes: identity
            .blob()
            .text(Kind::Platform, 0)
            .and_then(flash_bytes),
        outputs: arguments.outputs,
        loops: loops.map_err(anyhow::Error::msg)?,
        steps: arguments.steps,
        patience: PATIENCE,
    };
    if plan.arms() {
        confirm(&identity, &plan, arguments.yes)?;
    }
    let address = client.address().clone();
    let connect = || Ok(ferrocnc::client::Client::open(&address)?.with_keys(crate::keys()));
    let quiet = as_json || !std::io::stderr().is_terminal();
    let tell = |what: &str| {
        if !quiet {
            eprintln!("looking at: {what}");
        }
    };
    let report = test(
        &identity,
        &plan,
        &mut Bench {
            connect: &connect,
            time: &mut Wall::default(),
            tell: &tell,
        },
    );
    findings::tell(&report, arguments.report.as_deref(), as_json)
}

/// Bytes of the flash on a platform this tool knows.
fn flash_bytes(platform: &str) -> Option<u32> {
    let (name, text) = BUILT_IN.iter().find(|(name, _)| *name == platform)?;
    let platform = Platform::read(&format!("{name}.toml"), name, text).ok()?;
    Some(platform.flash_bytes)
}

/// Where a channel's pins are, by the board file.
fn pins(identity: &Identity, class: u8, n: usize) -> String {
    let blob = identity.blob();
    let entry = blob.entries().find(|entry| {
        entry.kind == Kind::Pins
            && usize::from(entry.channel) == n
            && entry.value.first() == Some(&class)
    });
    let text = entry.and_then(|entry| std::str::from_utf8(entry.value.get(1..)?).ok());
    text.map_or_else(String::new, |text| format!(" ({text})"))
}

/// What will move, and what must not be connected.
fn warning(identity: &Identity, plan: &Plan) -> String {
    let mut text = String::from("This arms the board. First, with the power off:\n");
    text += "  * pull the plugs of every motor driver, spindle, laser and relay off the headers:\n";
    text += "    every output is live while the board is armed, not only the ones tested;\n";
    text += "  * leave the motors' supply off.\n";
    if plan.outputs {
        let outputs = identity.numbers(Kind::Output);
        text += &format!(
            "It switches {} outputs, one after the other:\n",
            outputs.len()
        );
        for n in outputs {
            let name = identity.blob().text(Kind::Output, n).unwrap_or("");
            text += &format!("  output {n} {name}{}\n", pins(identity, b'o', n.into()));
        }
        let channels = identity.describe.channels;
        let moving = [
            ("stepgen", Kind::Stepgen, b's', channels.stepgens),
            ("pwm", Kind::Pwm, b'p', channels.pwms),
        ];
        if gather::reads_pads(identity) {
            text += "It steps every step generator a few times and turns every PWM fully on:\n";
            for (kind, name, class, count) in moving {
                for n in 0..count {
                    let name = identity.blob().text(name, n).unwrap_or("");
                    let pins = pins(identity, class, n.into());
                    text += &format!("  {kind} {n} {name}{pins}\n");
                }
            }
        }
    }
    if !plan.loops.is_empty() {
        text += "Buffered outputs have 5 V and a bus-switch input takes 3.3 V: such a jumper needs a divider\n";
        text += "(1 kOhm from the output, 1.8 kOhm to ground). It drives these jumpers:\n";
    }
    for jumper in &plan.loops {
        let (class, n) = match jumper.source {
            Source::Step(n) | Source::Dir(n) => (b's', n),
            Source::Pwm(n) => (b'p', n),
            Source::Output(n) => (b'o', n),
        };
        let (to, m) = match jumper.sink {
            Sink::Encoder(m) => (b'e', m),
            Sink::Input(m) => (b'i', m),
        };
        let (from, to) = (pins(identity, class, n), pins(identity, to, m));
        text += &format!("  {}: from{from} to{to}\n", jumper.text);
    }
    text
}

fn confirm(identity: &Identity, plan: &Plan, yes: bool) -> Result<()> {
    eprint!("{}", warning(identity, plan));
    if yes {
        return Ok(());
    }
    eprint!("Is all of this done? Type yes: ");
    std::io::stderr().flush()?;
    let mut answer = String::new();
    std::io::stdin().lock().read_line(&mut answer)?;
    match answer.trim() {
        "yes" => Ok(()),
        _ => bail!("nothing was armed; --yes answers yes without the question"),
    }
}
