//! `ferrocnc config import litexcnc --hal`: a HAL file for LiteX-CNC becomes one for us.
//!
//! Its one `loadrt litexcnc` line changes. Every other name of the board in it is looked up among
//! what a board of the imported configuration would export, so that a wrong one is found here and
//! not when the machine starts. It never changes another line.

use anyhow::{Context, Result, anyhow, bail};
use ferrocnc::address::{self, Address};
use ferrocnc::client::Identity;
use ferrocnc::driver::Driver;
use ferrocnc::hal::fake::FakeHal;
use ferrocnc::link::Link;
use ferrocnc::names::{self, Scheme};
use ferrocnc_config::{Board, blob};
use std::collections::{BTreeMap, BTreeSet};
use std::net::{Ipv4Addr, UdpSocket};
use wire::describe::Describe;
use wire::exchange::StateWord;
use wire::{GateClose, ResetReason};

/// A HAL file with our `loadrt` line.
#[derive(Debug)]
pub(crate) struct Rewritten {
    /// All of it.
    pub text: String,
    /// Number of the line that changed, from 1, and how it was and is.
    pub changed: (usize, String, String),
    /// What a person should know.
    pub notes: Vec<String>,
    /// How many names of the board it has.
    pub names: usize,
}

/// Rewrites `text` for a board whose names began with `prefix`. Refused with the line numbers of
/// names that it would not have.
pub(crate) fn rewrite(file: &str, text: &str, board: &Board, prefix: &str) -> Result<Rewritten> {
    let (line, old, boards) = loadrt(file, text, board)?;
    let used = names_in(text, prefix);
    // By number, as the driver of 1.3 has them, unless more of the file is there by name.
    let ways = ["litexcnc", "litexcnc-named"].map(|scheme| -> Result<_> {
        let scheme = format!("{scheme}:{prefix}");
        let missing = exported(board, &scheme)?.missing(&used);
        Ok((scheme, missing))
    });
    let [by_number, by_name] = ways;
    let (by_number, by_name) = (by_number?, by_name?);
    let (scheme, missing) = match by_name.1.len() < by_number.1.len() {
        true => by_name,
        false => by_number,
    };
    if !missing.is_empty() {
        let lines = missing
            .iter()
            .map(|(line, why)| format!("{file}:{line}: {why}\n"));
        let lines: String = lines.collect();
        bail!(
            "{lines}{} of {} names in {file} would not exist; correct these lines, or import without --hal. Nothing was written",
            missing.len(),
            used.len()
        );
    }
    let (code, comment) = old.split_at(code(&old).len());
    let indent = &code[..code.len() - code.trim_start().len()];
    let space = &code[code.trim_end().len()..];
    let new = format!("{indent}loadrt ferrocnc boards={boards} names={scheme}{space}{comment}");
    let lines = text.split_inclusive('\n').enumerate().map(|(n, whole)| {
        let ending = &whole[whole.trim_end_matches(['\r', '\n']).len()..];
        match n + 1 == line {
            true => format!("{new}{ending}"),
            false => whole.to_owned(),
        }
    });
    Ok(Rewritten {
        text: lines.collect(),
        changed: (line, old.clone(), new.clone()),
        notes: notes(text, &boards, board, scheme.starts_with("litexcnc-named")),
        names: used.len(),
    })
}

/// The line that loads LiteX-CNC: its number, itself, and what `boards=` says in its place.
fn loadrt(file: &str, text: &str, board: &Board) -> Result<(usize, String, String)> {
    let mut found = (1..).zip(text.lines()).filter(|(_, line)| {
        let mut words = code(line).split_whitespace();
        words.next() == Some("loadrt") && words.next() == Some("litexcnc")
    });
    let Some((number, line)) = found.next() else {
        bail!(
            "{file}: no line begins with loadrt litexcnc; a HAL file for LiteX-CNC is wanted, as the machine's INI names it in HALFILE"
        );
    };
    if let Some((other, _)) = found.next() {
        bail!(
            "{file}:{other}: loads litexcnc a second time, after line {number}; leave one of the two lines"
        );
    }
    let at = |problem: String| anyhow!("{file}:{number}: {problem}");
    let mut connections = None;
    for word in code(line).split_whitespace().skip(2) {
        if word == "\\" {
            return Err(at("goes on in the next line; make it one line".to_owned()));
        }
        match word.trim_matches('"').split_once('=') {
            Some(("connections", value)) => connections = Some(value.trim_matches('"')),
            _ => {
                return Err(at(format!(
                    "{word} has no counterpart here; take it away, or import without --hal"
                )));
            }
        }
    }
    let Some(connections) = connections else {
        return Err(at(
            "has no connections=; write it as in connections=\"eth:192.168.2.50\"".to_owned(),
        ));
    };
    let boards = match connections.strip_prefix("eth:") {
        Some(address) => {
            let boards = address::parse_list(address)
                .map_err(|error| at(format!("connections={connections:?}: {error}")))?;
            match boards.as_slice() {
                [Address { text, .. }] => text.clone(),
                _ => {
                    return Err(at(format!(
                        "connections={connections:?} are several boards, and this imports one; write loadrt ferrocnc boards=IP,IP names=litexcnc:NAME,NAME yourself, and import each board without --hal"
                    )));
                }
            }
        }
        // The INI file says it, which is not here.
        None if connections.starts_with('[') => Ipv4Addr::from(board.ipv4).to_string(),
        None => {
            return Err(at(format!(
                "connections={connections:?} is not by Ethernet; write it as in connections=\"eth:192.168.2.50\""
            )));
        }
    };
    Ok((number, line.to_owned(), boards))
}

/// A line without its comment, which halcmd sees in quotes, too.
fn code(line: &str) -> &str {
    line.split('#').next().unwrap_or_default()
}

/// A name of the board in a HAL file.
struct Used {
    line: usize,
    name: String,
    /// `alias pin OLD NEW` makes this one, out of the one before it.
    made: bool,
}

/// The names of the board in a HAL file, in its order.
fn names_in(text: &str, prefix: &str) -> Vec<Used> {
    let mut found = Vec::new();
    let mut goes_on = false;
    for (number, line) in (1..).zip(text.lines()) {
        let words = code(line).split_whitespace();
        let words: Vec<&str> = words.map(|word| word.trim_matches('"')).collect();
        // A command, and the signal behind some, which may be called anything.
        let skipped = match words.first() {
            _ if goes_on => 0,
            Some(&("net" | "newsig" | "delsig" | "sets" | "stype" | "linksp" | "unlinksp")) => 2,
            Some(_) | None => 1,
        };
        goes_on = words.last() == Some(&"\\");
        let alias = words.first() == Some(&"alias");
        for (at, word) in words.into_iter().enumerate().skip(skipped) {
            let own = word
                .strip_prefix(prefix)
                .and_then(|rest| rest.strip_prefix('.'));
            if let Some(rest) = own.or_else(|| after_ini(word)) {
                found.push(Used {
                    line: number,
                    name: format!("{prefix}.{rest}"),
                    made: alias && at == 3,
                });
            }
        }
    }
    found
}

/// What is behind a board's name that the INI file says, `[LITEXCNC](NAME).` in the manual's
/// examples: it is the board's if no other component has such names.
fn after_ini(word: &str) -> Option<&str> {
    let (section, rest) = word.strip_prefix('[')?.split_once(']')?;
    let (_, rest) = rest.split_once('.')?;
    let class = rest.split('.').next();
    let classes = [
        "stepgen",
        "encoder",
        "pwm",
        "gpio",
        "watchdog",
        "wallclock",
        "communications",
    ];
    (section == "LITEXCNC" || classes.contains(&class?)).then_some(rest)
}

/// The names that HAL would have of a board.
struct Known {
    all: BTreeSet<String>,
    /// Those of them that are second names of our pins: HAL has room for one each.
    second: BTreeSet<String>,
}

impl Known {
    /// Those of a file that would not exist where they stand, with their lines, and why.
    fn missing(mut self, used: &[Used]) -> Vec<(usize, String)> {
        let mut missing = Vec::new();
        let mut renamed: BTreeMap<&str, usize> = BTreeMap::new();
        let mut before: Option<&Used> = None;
        for one in used {
            let Used { line, name, made } = one;
            let old = before.replace(one).filter(|old| *made && old.line == *line);
            if let Some(old) = old {
                self.all.insert(name.clone());
                if self.second.contains(&old.name) {
                    self.all.remove(&old.name);
                    renamed.insert(&old.name, *line);
                }
            } else if !self.all.contains(name) {
                let why = match renamed.get(name.as_str()) {
                    Some(by) => format!(
                        "{name} would not exist any more: line {by} gives the pin another name in its place"
                    ),
                    None => format!("{name} would not exist on the imported board"),
                };
                missing.push((*line, why));
            }
        }
        missing
    }
}

/// What HAL would have of this board with `names=scheme`.
fn exported(board: &Board, scheme: &str) -> Result<Known> {
    let parsed = Scheme::parse(scheme).context("board_name of the JSON cannot be used")?;
    let scheme = parsed.with_context(|| format!("names={scheme} names nothing"))?;
    let identity = identity(board)?;
    scheme.check(0, &identity)?;
    let mut hal = FakeHal::new();
    let driver = driver(&mut hal, &identity)?;
    names::export(&scheme, &mut hal, 0, &identity, &driver)?;
    let own = |name: &str| name.starts_with("ferrocnc.");
    let second = hal.aliases_of().filter(|(_, of)| own(of));
    let second: BTreeSet<String> = second.map(|(name, _)| name.to_owned()).collect();
    let all = hal.list().chain(hal.aliases());
    let mut all: BTreeSet<String> = all.map(|(name, _, _)| name.to_owned()).collect();
    let prefix = scheme.prefix(0, &identity);
    for (function, _) in scheme.functions() {
        // HAL makes the last three itself.
        for ending in ["", ".time", ".tmax", ".tmax-increased"] {
            all.insert(format!("{prefix}.{function}{ending}"));
        }
    }
    Ok(Known { all, second })
}

/// The driver's pins and parameters for a board, in a HAL of its own.
fn driver(hal: &mut FakeHal, identity: &Identity) -> Result<Driver> {
    // The driver needs a socket; this one sends nothing.
    let socket = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0))?;
    let address = address::parse_list("127.0.0.1")?.swap_remove(0);
    let say = hal.messenger();
    Ok(Driver::export(
        hal,
        0,
        address,
        identity,
        Link::new(socket)?,
        say,
    )?)
}

/// The names that a board of this configuration has in HAL, without those of other projects.
#[cfg(test)]
pub(crate) fn own_names(board: &Board) -> Result<BTreeSet<String>> {
    let mut hal = FakeHal::new();
    driver(&mut hal, &identity(board)?)?;
    let all = hal.list().chain(hal.aliases());
    Ok(all.map(|(name, _, _)| name.to_owned()).collect())
}

/// What a board of this configuration would say of itself.
fn identity(board: &Board) -> Result<Identity> {
    let blob = blob::blob(board)?;
    let state = StateWord::from_word(0).map_err(|_| anyhow!("no state is 0"))?;
    let describe = Describe {
        wire_version: wire::WIRE_VERSION,
        abi_firmware: 0,
        abi_gateware: 0,
        firmware_version: 0,
        gateware_version: 0,
        clock_hz: board.sys_clk_hz,
        channels: board.channels(),
        features: 0,
        boot_id: 0,
        blob_words: u32::try_from(blob.len() / 4)?,
        state,
        obstacles: 0,
        reset_reason: ResetReason::PowerUp,
        gate_close: GateClose::Never,
    };
    Ok(Identity::new(describe, blob)?)
}

fn notes(text: &str, boards: &str, board: &Board, named: bool) -> Vec<String> {
    let mut notes = Vec::new();
    let built_in = Ipv4Addr::from(board.ipv4).to_string();
    if boards.split(':').next() != Some(built_in.as_str()) {
        notes.push(format!("The HAL file has the board at {boards}, the JSON at {built_in}; `ferrocnc set {built_in} --ip` moves the board."));
    }
    for (number, line) in (1..).zip(text.lines()) {
        if code(line).split_whitespace().next() == Some("source") {
            let named = match named {
                true => {
                    " If it is LiteX-CNC's alias.hal, take the line away: names=litexcnc-named has its names."
                }
                false => "",
            };
            notes.push(format!(
                "Line {number} reads another file, which was not looked at.{named}"
            ));
        }
    }
    notes
}
