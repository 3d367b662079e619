//! Runs the tests in order: first those that change nothing, then those that the command names. A
//! failure ends its part, not the report.

use super::drive::{DriveError, Driven, Pins};
use super::loops::{Loop, Sink, Source, judge_counts, judge_levels, judge_output, judge_rest};
use super::{Finding, Report, Time, board, clock, flash, gather, link, report_of, ways};
use crate::client::{Client, ClientError, Identity, Owner};
use std::net::SocketAddrV4;
use std::time::Duration;
use wire::board::Kind;
use wire::describe::FEATURE_READBACK;
use wire::{State, map};

/// What is to be tested.
#[derive(Clone, Debug)]
pub struct Plan {
    /// How long to look at the clock.
    pub look: Duration,
    /// Questions to ask over the link.
    pub questions: u32,
    /// Bytes of flash by the platform's file.
    pub flash_bytes: Option<u32>,
    /// Arm the board and drive every output: the general ones, STEP and DIR, PWM.
    pub outputs: bool,
    /// Arm the board and drive these jumpers.
    pub loops: Vec<Loop>,
    /// Steps each way through a jumper into an encoder.
    pub steps: u32,
    /// How long to wait for one answer of a board that is driven.
    pub patience: Duration,
}

/// 50 ms: four answers may be late in a row before the watchdog bites.
pub const PATIENCE: Duration = Duration::from_millis(50);

impl Default for Plan {
    /// 5 s: at 200 us of round trip the clock is known to 40 ppm and better. 2000 questions, and a
    /// fifth of a second of steps.
    fn default() -> Self {
        Plan {
            look: Duration::from_secs(5),
            questions: 2_000,
            flash_bytes: None,
            outputs: false,
            loops: Vec::new(),
            steps: 1_000,
            patience: PATIENCE,
        }
    }
}

impl Plan {
    /// Does it arm the board?
    pub fn arms(&self) -> bool {
        self.outputs || !self.loops.is_empty()
    }
}

/// Refuses a board that is in use.
pub fn idle(client: &mut Client, identity: &Identity) -> Result<(), BusyError> {
    let words = client.read(&[map::SESSION_OWNER_IP, map::SESSION_OWNER_PORT])?;
    if let [ip, port] = words[..]
        && ip != 0
    {
        let owner = Owner(SocketAddrV4::new(ip.into(), port as u16), None);
        let address = client.address().clone();
        return Err(BusyError::Client(ClientError::Owned { address, owner }));
    }
    match identity.describe.state.state {
        state @ (State::Boot | State::Armed | State::Stopping) => Err(BusyError::State(state)),
        State::Disarmed | State::Faulted => Ok(()),
    }
}

/// The board is in use, or does not answer.
#[derive(Debug)]
pub enum BusyError {
    /// A host drives it, or it does not answer.
    Client(ClientError),
    /// It is not at rest.
    State(State),
}

impl core::fmt::Display for BusyError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            BusyError::Client(error) => error.fmt(f),
            BusyError::State(state) => {
                write!(f, "the board is {state}; the self-test needs it at rest")
            }
        }
    }
}

impl std::error::Error for BusyError {}

impl From<ClientError> for BusyError {
    fn from(error: ClientError) -> Self {
        BusyError::Client(error)
    }
}

/// A board, the ways to reach it, and where findings go.
pub struct Bench<'b> {
    /// A new socket to the board.
    pub connect: &'b dyn Fn() -> Result<Client, ClientError>,
    /// The host's clock.
    pub time: &'b mut dyn Time,
    /// Receives the name of the running check.
    pub tell: &'b dyn Fn(&str),
}

/// Tests the board.
pub fn run(identity: &Identity, plan: &Plan, bench: &mut Bench<'_>) -> Report {
    let mut report = report_of(identity);
    if let Err(lost) = look(identity, plan, bench, &mut report.findings) {
        report.findings.push(silent(&lost));
        return report;
    }
    if plan.outputs {
        outputs(identity, plan, bench, &mut report.findings);
    }
    for jumper in &plan.loops {
        drive_loop(identity, plan, jumper, bench, &mut report.findings);
    }
    report
}

fn silent(error: &dyn core::fmt::Display) -> Finding {
    // The sentence names the board by its address; a report does not.
    let _ = error;
    Finding::bad(
        "answers",
        "the board stopped answering in the test",
        "its supply, its link or its firmware failed",
        "look at its LED, at `ferrocnc describe`, at the 5 V under load; then test again",
    )
}

fn look(
    identity: &Identity,
    plan: &Plan,
    bench: &mut Bench<'_>,
    findings: &mut Vec<Finding>,
) -> Result<(), ClientError> {
    let mut client = (bench.connect)()?;
    (bench.tell)("description");
    findings.extend(board::judge(&gather::board(
        &mut client,
        identity.describe,
    )?));
    (bench.tell)("flash");
    match gather::flash((bench.connect)()?, identity, plan.flash_bytes) {
        Ok(facts) => findings.extend(flash::judge(&facts)),
        Err(crate::flash::FlashError::Client(error)) => return Err(error),
        Err(_) => findings.push(Finding::bad(
            "flash",
            "an operation of the flash failed",
            "the chip returns its id, but reads fail; or another program uses the board",
            "test again; if it stays, reflow the flash",
        )),
    }
    (bench.tell)("link");
    let facts = gather::link(&mut client, identity, plan.questions, bench.time)?;
    findings.extend(link::judge(&facts));
    findings.push(ways::judge(&gather::ways(&mut client)?));
    (bench.tell)("clock");
    let (speed, readback) = (facts.after.speed, readback(identity));
    let samples = gather::clock(&mut client, readback, plan.look, bench.time)?;
    let hz = identity.describe.clock_hz;
    findings.extend(clock::judge(&samples, hz, speed, readback));
    findings.push(match (gather::reads_pads(identity), readback) {
        (true, _) => {
            let [driven, seen] = gather::rest(&mut client, identity.describe.channels)?;
            judge_rest(driven, seen, &output_names(identity))
        }
        (false, true) => Finding::skipped(
            "output pads",
            "not judged",
            "the pins of this board are configured, and its read-back does not know which channel is on which pin",
            "a jumper from the pin to an input: --loop",
        ),
        (false, false) => Finding::skipped(
            "output pads",
            "not read",
            "this board's gateware has no read-back",
            "build and flash it again: `ferrocnc update` with a .bit of this version; or a jumper from the pin to an input: --loop",
        ),
    });
    Ok(())
}

/// The gateware reads its pads and counts the Ethernet clock.
fn readback(identity: &Identity) -> bool {
    identity.describe.features & FEATURE_READBACK != 0
}

fn output_names(identity: &Identity) -> Vec<String> {
    let count = usize::from(identity.describe.channels.outputs);
    (0..count)
        .map(|n| name(identity, Kind::Output, n))
        .collect()
}

/// Number and name of a channel.
fn name(identity: &Identity, kind: Kind, n: usize) -> String {
    let number = n.to_string();
    match identity.blob().text(kind, n as u8) {
        Some(name) if name != number => format!("{n} {name}"),
        _ => number,
    }
}

fn outputs(identity: &Identity, plan: &Plan, bench: &mut Bench<'_>, findings: &mut Vec<Finding>) {
    (bench.tell)("outputs");
    let names = output_names(identity);
    let numbers = gather::numbers(identity, Kind::Output);
    match driven(identity, plan, bench, |driven| {
        driven.outputs(&names, &numbers)
    }) {
        Ok(mut found) => {
            for (n, output) in numbers.iter().copied().zip(&mut found) {
                // What a jumper joins is no news.
                output.inputs.retain(|input| {
                    let joins = |jumper: &Loop| {
                        (jumper.source, jumper.sink) == (Source::Output(n), Sink::Input(*input))
                    };
                    !plan.loops.iter().any(joins)
                });
            }
            findings.extend(found.iter().map(judge_output));
        }
        Err(error) => return findings.push(not_driven("outputs", &error)),
    }
    let channels = identity.describe.channels;
    let motors: Vec<Pins> = (0..usize::from(channels.stepgens))
        .map(|n| Pins::stepgen(identity, n, &name(identity, Kind::Stepgen, n)))
        .collect();
    let pwms: Vec<Pins> = (0..usize::from(channels.pwms))
        .map(|n| Pins::pwm(identity, n, &name(identity, Kind::Pwm, n)))
        .collect();
    (bench.tell)("STEP, DIR and PWM pins");
    match driven(identity, plan, bench, |driven| {
        driven.motion(&motors, &pwms, &names)
    }) {
        Ok(found) => findings.extend(found.iter().map(judge_output)),
        Err(error) => findings.push(not_driven("STEP, DIR and PWM pins", &error)),
    }
}

fn drive_loop(
    identity: &Identity,
    plan: &Plan,
    jumper: &Loop,
    bench: &mut Bench<'_>,
    findings: &mut Vec<Finding>,
) {
    (bench.tell)(&jumper.text);
    let finding = match jumper.sink {
        Sink::Encoder(_) => driven(identity, plan, bench, |driven| {
            driven.counts(jumper, plan.steps)
        })
        .map(|facts| judge_counts(&facts)),
        Sink::Input(n) => driven(identity, plan, bench, |driven| driven.levels(jumper, n))
            .map(|facts| judge_levels(&facts)),
    };
    let failed = |error| not_driven(&format!("loop {}", jumper.text), &error);
    findings.push(finding.unwrap_or_else(failed));
}

fn driven<R>(
    identity: &Identity,
    plan: &Plan,
    bench: &mut Bench<'_>,
    what: impl FnOnce(&mut Driven<'_>) -> Result<R, DriveError>,
) -> Result<R, DriveError> {
    let mut driven = Driven::take((bench.connect)()?, identity, plan.patience, bench.time)?;
    what(&mut driven)
}

fn not_driven(check: &str, error: &DriveError) -> Finding {
    match error {
        DriveError::Client(ClientError::Key(..)) => Finding::bad(
            check,
            "not driven: the board has a key",
            "only a computer with the key may arm it",
            "`--key FILE`, or run the test where the key is",
        ),
        DriveError::Client(error) => silent(error),
        DriveError::NotArmed { .. } => Finding::bad(
            check,
            error.to_string(),
            "nothing moves while the gate is closed",
            "release e-stop inputs and the external reset pin, then test again",
        ),
        DriveError::Stopped(_) | DriveError::Silent => Finding::bad(
            check,
            error.to_string(),
            "the cable, or this computer was too busy to feed the watchdog for 0.2 s",
            "test again with nothing else running; see `traffic`",
        ),
    }
}
