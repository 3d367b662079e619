//! `ferrocnc net`: gives a port of this computer to the board, and takes it back.

use crate::consent;
use anyhow::{Result, bail};
use clap::{Args, Subcommand};
use ferrocnc::discovery::{Finder, Found, WAIT};
use ferrocnc::doctor::system::System;
use ferrocnc::net::act::Hand;
use ferrocnc::net::facts::{Board, Facts, Kind};
use ferrocnc::net::plan::{Plan, Refusal, Wish, is_plain, net, plan, refuse};
use ferrocnc::uid::{mac_text, uid_parse, uid_text};
use serde_json::{Value, json};
use std::net::Ipv4Addr;
use std::time::{Duration, Instant};

/// 15 s: a link of copper needs 2 to 4 s after its port was switched on, a board with a DHCP
/// client 10 s until it has an address.
const PATIENCE: Duration = Duration::from_secs(15);

/// 500 ms: most boards answer within milliseconds, and a busy one is asked again.
const ROUND: Duration = Duration::from_millis(500);

/// Gives an Ethernet port of this computer to the board, so that it lasts; takes it back.
#[derive(Subcommand)]
pub(crate) enum NetCommand {
    /// A static address in the board's net, no default route, no IPv6, no coalescing, a permanent
    /// neighbour entry, and a rule that keeps everything else off the line: shown, then done, then
    /// proven by asking the board.
    Setup(Setup),
    /// Takes back what `net setup` did to the port, and nothing else.
    Remove(Remove),
}

#[derive(Args)]
pub(crate) struct Manner {
    /// Show what would be written and run, and do nothing. Needs no root.
    #[arg(long)]
    dry_run: bool,
    /// Do not ask.
    #[arg(long, short)]
    yes: bool,
}

#[derive(Args)]
pub(crate) struct Setup {
    /// The port that the board is at.
    #[arg(value_name = "IF")]
    interface: String,
    /// IP, name or unique id of the board, if several answer at the port or none does yet.
    #[arg(value_name = "BOARD")]
    board: Option<String>,
    /// Also a port that carries the default route: this computer then reaches nothing else through
    /// it.
    #[arg(long)]
    force: bool,
    #[command(flatten)]
    manner: Manner,
}

#[derive(Args)]
pub(crate) struct Remove {
    /// The port.
    #[arg(value_name = "IF")]
    interface: String,
    #[command(flatten)]
    manner: Manner,
}

pub(crate) fn run(command: &NetCommand, as_json: bool) -> Result<()> {
    match command {
        NetCommand::Setup(arguments) => setup(arguments, as_json),
        NetCommand::Remove(arguments) => remove(arguments, as_json),
    }
}

fn setup(arguments: &Setup, as_json: bool) -> Result<()> {
    let interface = &arguments.interface;
    let manner = &arguments.manner;
    manner.needs_root(&format!("net setup {interface}"))?;
    let facts = facts(interface)?;
    refuse(&facts, arguments.force)?;
    let found = match facts.up {
        true => ask(interface, arguments.board.as_deref())?,
        false => Vec::new(),
    };
    let wish = Wish {
        board: named(arguments.board.as_deref(), &found, interface)?,
        boards: found.iter().map(board).collect(),
        force: arguments.force,
    };
    let plan = plan(&facts, &wish)?;
    if as_json && manner.dry_run {
        println!("{:#}", to_json(&plan, &[]));
        return Ok(());
    }
    if !as_json {
        print!("{}", to_text(&plan));
    }
    if manner.dry_run {
        return Ok(());
    }
    if !plan.steps.is_empty() {
        at_rest(&found)?;
        manner.confirm()?;
        Hand::real().carry_out(&plan)?;
    }
    let answer = prove(&plan, wish.board)?;
    if as_json {
        println!("{:#}", to_json(&plan, &answer));
        return Ok(());
    }
    for found in &answer {
        println!("{} answers at {}", uid_text(found.uid), found.socket());
    }
    let known = |found: &Found| plan.boards.contains(&board(found));
    if !answer.iter().all(known) {
        println!(
            "It did not answer before, so it has no neighbour entry yet: give the command again."
        );
    }
    Ok(())
}

fn remove(arguments: &Remove, as_json: bool) -> Result<()> {
    let interface = &arguments.interface;
    let manner = &arguments.manner;
    manner.needs_root(&format!("net remove {interface}"))?;
    let facts = facts(interface)?;
    let Some(record) = &facts.record else {
        bail!(
            "{interface} is not set up by `ferrocnc net setup`, so there is nothing to take back"
        );
    };
    if !as_json {
        for step in &record.0 {
            println!("{step}");
        }
    }
    if !manner.dry_run {
        if facts.kind == Kind::Wired && facts.up {
            at_rest(&ask(interface, None)?)?;
        }
        manner.confirm()?;
        let failed = Hand::real().undo(interface, record);
        if !failed.is_empty() {
            bail!(
                "{interface} is no longer set up, but this failed: {}",
                failed.join("; ")
            );
        }
    }
    if as_json {
        let steps: Vec<_> = record.0.iter().map(ToString::to_string).collect();
        println!("{:#}", json!({ "interface": interface, "undo": steps }));
    }
    Ok(())
}

impl Manner {
    /// What is only shown needs none.
    fn needs_root(&self, command: &str) -> Result<()> {
        match self.dry_run {
            true => Ok(()),
            false => consent::needs_root("the network of this computer", command),
        }
    }

    fn confirm(&self) -> Result<()> {
        if self.yes || consent::is_yes("Is this to be done?")? {
            return Ok(());
        }
        bail!("nothing was changed; --yes answers yes without the question")
    }
}

fn facts(interface: &str) -> Result<Facts> {
    if !is_plain(interface) {
        return Err(Refusal::Name(interface.to_owned()).into());
    }
    Facts::read(&System::real(), interface).map_err(anyhow::Error::msg)
}

fn board(found: &Found) -> Board {
    Board {
        ip: found.here.ip.into(),
        mac: found.here.mac,
    }
}

/// The boards that answer at the port; a board that is named is waited for.
fn ask(interface: &str, name: Option<&str>) -> Result<Vec<Found>> {
    let began = Instant::now();
    loop {
        let found = match Finder::everywhere(Some(interface))?.all(WAIT) {
            Ok(found) => found,
            // A port that is down or has no cable: no board is heard there.
            Err(_) => return Ok(Vec::new()),
        };
        let is_there = name.is_none_or(|name| found.iter().any(|found| is_called(found, name)));
        if is_there || began.elapsed() > PATIENCE {
            return Ok(found);
        }
    }
}

/// The operator's name for a board is its address, its name or its unique id.
fn is_called(found: &Found, name: &str) -> bool {
    let own = found.here.name.text();
    name.parse() == Ok(Ipv4Addr::from(found.here.ip))
        || uid_parse(name) == Some(found.uid)
        || (!own.is_empty() && name.strip_suffix(".local").unwrap_or(name) == own)
}

/// The address of the board that the operator names.
fn named(name: Option<&str>, found: &[Found], interface: &str) -> Result<Option<Ipv4Addr>> {
    let Some(name) = name else { return Ok(None) };
    if let Some(found) = found.iter().find(|found| is_called(found, name)) {
        return Ok(Some(found.here.ip.into()));
    }
    match name.parse() {
        // It may be plugged in later.
        Ok(ip) if found.is_empty() => return Ok(Some(ip)),
        _ if found.is_empty() => bail!(
            "no board answers at {interface}, so the address of {name} is not known; name its IP address, or look at power and cable"
        ),
        Ok(_) | Err(_) => {}
    }
    let others: Vec<String> = found
        .iter()
        .map(|found| found.socket().to_string())
        .collect();
    bail!(
        "no board called {name} answers at {interface}, but {}; leave the name out, or power that board",
        others.join(", ")
    )
}

/// While LinuxCNC runs, nothing is changed on the line.
fn at_rest(found: &[Found]) -> Result<()> {
    match found
        .iter()
        .find(|found| found.here.armed || found.here.owned)
    {
        None => Ok(()),
        Some(found) => bail!(
            "LinuxCNC drives the board at {}; stop it first",
            found.socket()
        ),
    }
}

/// Waits until the boards answer the broadcast, and each of them at its own address, too: through
/// the port's address, the neighbour entry and the egress rule.
fn prove(plan: &Plan, named: Option<Ipv4Addr>) -> Result<Vec<Found>> {
    let interface = &plan.interface;
    let began = Instant::now();
    loop {
        let found = Finder::everywhere(Some(interface))?.all(ROUND);
        let mut found = found.unwrap_or_default();
        // A board of another net cannot be reached yet.
        found.retain(|found| net(found.here.ip.into()) == net(plan.address));
        let answers = |ip| {
            found
                .iter()
                .any(|found| Ipv4Addr::from(found.here.ip) == ip)
        };
        let mut wanted = plan.boards.iter().map(|board| board.ip).chain(named);
        let late = began.elapsed() > PATIENCE;
        match wanted.find(|ip| !answers(*ip)) {
            None if !found.is_empty() => {
                let away = found
                    .iter()
                    .find(|found| Found::read(found.socket()).is_err());
                match away {
                    None => return Ok(found),
                    Some(away) if late => bail!(
                        "{interface} is set up, and the board at {} answers broadcasts only; look for its address elsewhere (ip route get {}), or for another board with it",
                        away.socket(),
                        away.socket().ip()
                    ),
                    Some(_) => {}
                }
            }
            missing if late => {
                let silent = missing.map_or("no board answers".to_owned(), |ip| {
                    format!("the board at {ip} does not answer")
                });
                bail!(
                    "{interface} is set up, but {silent}; look at power and cable, then: ferrocnc discover --interface {interface}"
                )
            }
            Some(_) | None => {}
        }
    }
}

fn to_text(plan: &Plan) -> String {
    let interface = &plan.interface;
    let mut text = format!("{interface}: {}/24", plan.address);
    for board in &plan.boards {
        text += &format!(", board {} ({})", board.ip, mac_text(board.mac));
    }
    text.push('\n');
    if plan.steps.is_empty() {
        return text + "It is set up already.\n";
    }
    for act in plan.steps.iter().filter_map(|step| step.act.as_ref()) {
        text += &format!("{act}\n");
    }
    text + &format!("`ferrocnc net remove {interface}` takes it back.\n")
}

fn to_json(plan: &Plan, answer: &[Found]) -> Value {
    let acts = plan.steps.iter().filter_map(|step| step.act.as_ref());
    json!({
        "interface": plan.interface,
        "address": format!("{}/24", plan.address),
        "steps": acts.map(ToString::to_string).collect::<Vec<_>>(),
        "undo": plan.record.0.iter().map(ToString::to_string).collect::<Vec<_>>(),
        "boards": answer.iter().map(crate::discover::to_json).collect::<Vec<_>>(),
    })
}
