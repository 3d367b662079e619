//! The board file of a machine: written for a PCB, or added to.
//!
//! What is in the file stays as it is, because it may be wired: a channel keeps its pins, and one
//! that is needed and not there goes on free pins, at the end. A channel that the machine does not
//! need any more stays, too.

use crate::channels::{Wanted, wanted};
use crate::model::{CncMachine, Estop};
use ferrocnc_config::board::Platforms;
use ferrocnc_config::new::blank;
use ferrocnc_config::platform::{Level, Platform, Role, own_pins, shared_pins, split};
use ferrocnc_config::write::{channel, to_toml};
use ferrocnc_config::{Board, Channel, Class, Error};
use std::collections::BTreeSet;

/// The board that is to be, and its file.
#[derive(Clone, Debug)]
pub struct Proposal {
    /// As the file describes it.
    pub board: Board,
    /// The file.
    pub text: String,
    /// What a person should know.
    pub notes: Vec<String>,
}

/// The board file of a machine on this PCB. `there` is the file as it is, and its name.
pub fn propose(
    machine: &CncMachine,
    platform: &str,
    modified: Option<&[String]>,
    file: &str,
    there: Option<&str>,
    platforms: &dyn Platforms,
) -> Result<Proposal, Error> {
    let mut notes = Vec::new();
    let text = match there {
        Some(text) => {
            let board = Board::read(file, &machine.name, text, platforms)?;
            agree(machine, &board, platform, modified)?;
            add(machine, &board, text, &mut notes)?
        }
        None => {
            let board = empty(machine, platform, modified, platforms, &mut notes)?;
            let board = fill(machine, board)?;
            to_toml(
                &board,
                &[format!(
                    "The board of the machine {}: first written by `ferrocnc machine write`, which adds what the machine needs more and leaves the rest as it is. `ferrocnc config pinout` draws it.",
                    machine.name
                )],
            )
        }
    };
    // The reader has the last word on what was written.
    let board = Board::read(file, &machine.name, &text, platforms)?;
    notes.extend(unused(machine, &board));
    Ok(Proposal { board, text, notes })
}

/// The file that is there is for the same PCB.
fn agree(
    machine: &CncMachine,
    board: &Board,
    platform: &str,
    modified: Option<&[String]>,
) -> Result<(), Error> {
    let file = &board.file;
    if board.platform.name != platform {
        return Err(machine.error(
            "board.platform",
            format!("{platform:?}"),
            format!("is not the one of {file}, which is \"{}\"", board.platform.name),
            format!("make them equal, or move {file} away: another one is written, with pins of its own choice"),
        ));
    }
    let has = &board.modified;
    let is = |name: &String| has.bus_switch.contains(name) || has.inputs.contains(name);
    match modified.into_iter().flatten().find(|name| !is(name)) {
        None => Ok(()),
        Some(name) => Err(machine.error(
            "board.modified",
            format!("{name:?}"),
            format!("is not modified in {file}"),
            format!(
                "write it into [modified] bus_switch of {file}, too; a pin that is in use there cannot become an input"
            ),
        )),
    }
}

/// A board without channels.
fn empty(
    machine: &CncMachine,
    name: &str,
    modified: Option<&[String]>,
    platforms: &dyn Platforms,
    notes: &mut Vec<String>,
) -> Result<Board, Error> {
    let Some((file, text)) = platforms.text(name) else {
        return Err(machine.error(
            "board.platform",
            format!("{name:?}"),
            "is not a platform we know",
            format!("write one of {}", platforms.names().join(", ")),
        ));
    };
    let platform = Platform::read(&file, name, &text)?;
    let bus_switch = match modified {
        Some(modified) => modified.to_vec(),
        None => {
            let proposed = headers(machine, &platform);
            if !proposed.is_empty() {
                notes.push(format!("{} of the card get bus switches in place of their buffers: inputs go there. Write modified = [\"{}\"] into [board] if you agree, or others", proposed.join(" and "), proposed.join("\", \"")));
            }
            proposed
        }
    };
    let mut board = blank(&machine.name, platform);
    board.modified.bus_switch = bus_switch;
    if let Estop::External(level) = machine.estop {
        board.ext_reset.active = level;
        // A chain that is open at power-up is not a wish for factory settings.
        board.factory = None;
    }
    let address = machine.board.address.split(':').next().unwrap_or_default();
    let ipv4 = address.parse::<std::net::Ipv4Addr>();
    // The twin's address is this computer's, which no board can have.
    if let Some(address) = ipv4.ok().filter(|address| !address.is_loopback()) {
        board.ipv4 = address.octets();
    }
    Ok(board)
}

/// How many pins that read a machine needs.
fn inputs(machine: &CncMachine) -> usize {
    let all = wanted(machine);
    let pins = all.iter().flat_map(|one| pins(one).into_iter());
    pins.filter(|(_, drives)| !drives).count()
}

/// As few headers as have room for the inputs, from the last on.
fn headers(machine: &CncMachine, platform: &Platform) -> Vec<String> {
    let needed = inputs(machine).div_ceil(ferrocnc_config::platform::OWN);
    let names = platform.headers.iter().rev().map(|(name, _)| name.clone());
    // One at least stays for what drives.
    let most = platform.headers.len().saturating_sub(1);
    let mut names: Vec<String> = names.take(needed.min(most)).collect();
    names.reverse();
    names
}

/// The pins that a channel needs, and whether they drive.
fn pins(one: &Wanted) -> Vec<(&'static str, bool)> {
    match one.class {
        Class::Stepgen if one.index => vec![("step", true), ("dir", true), ("index", false)],
        Class::Stepgen => vec![("step", true), ("dir", true)],
        Class::Encoder if one.kind == Some("counter") => vec![("a", false)],
        Class::Encoder if one.index => vec![("a", false), ("b", false), ("index", false)],
        Class::Encoder => vec![("a", false), ("b", false)],
        Class::Pwm | Class::Output => vec![("pin", true)],
        Class::Input => vec![("pin", false)],
    }
}

/// The pins that are free, in the order in which they are given away.
struct Free {
    outputs: Vec<String>,
    inputs: Vec<String>,
    used: BTreeSet<String>,
}

/// A shared line is one on all headers.
fn line(platform: &Platform, pin: &str) -> String {
    match (platform.pin(pin), split(pin)) {
        (Some((Role::Shared, _)), Some((_, number))) => format!("shared:{number}"),
        _ => pin.to_owned(),
    }
}

impl Free {
    fn new(board: &Board) -> Self {
        let platform = &board.platform;
        let reads = |lines: &String| {
            let lists = [&board.modified.bus_switch, &board.modified.inputs];
            lists.iter().any(|list| list.contains(lines))
        };
        let names = || platform.headers.iter().map(|(name, _)| name);
        let (reading, driving): (Vec<&String>, Vec<&String>) =
            names().partition(|name| reads(name));
        let of = |header: &&String| reads(&format!("{header}:shared"));
        let mut outputs: Vec<String> = driving.iter().flat_map(|name| own_pins(name)).collect();
        let mut inputs: Vec<String> = reading.iter().flat_map(|name| own_pins(name)).collect();
        inputs.extend(names().filter(of).flat_map(|name| shared_pins(name)));
        if let Some(first) = names().find(|name| !of(name)) {
            outputs.extend(shared_pins(first));
        }
        let channels = board.channels.iter().flatten();
        let pins = channels.flat_map(|channel| channel.pins.iter().map(|(_, pin)| pin));
        let control = [Some(&board.ext_reset), board.factory.as_ref()];
        let control = control.into_iter().flatten();
        let pins = pins.chain(control.filter_map(|control| control.pin.as_ref()));
        let used = pins.map(|pin| line(platform, pin)).collect();
        Free {
            outputs,
            inputs,
            used,
        }
    }

    fn take(&mut self, platform: &Platform, drives: bool) -> Option<String> {
        let list = match drives {
            true => &self.outputs,
            false => &self.inputs,
        };
        let pin = list
            .iter()
            .find(|pin| !self.used.contains(&line(platform, pin)))?;
        self.used.insert(line(platform, pin));
        Some(pin.clone())
    }
}

/// The channels that are needed and not there, on free pins.
fn new_channels(machine: &CncMachine, board: &Board) -> Result<Vec<(Class, Channel)>, Error> {
    let mut free = Free::new(board);
    let mut made = Vec::new();
    for one in wanted(machine) {
        let there = board.of(one.class).iter();
        if { there }.any(|channel| channel.name == one.name) {
            continue;
        }
        let mut named = Vec::new();
        for (key, drives) in pins(&one) {
            let Some(pin) = free.take(&board.platform, drives) else {
                return Err(no_room(machine, board, &one, drives));
            };
            named.push((key, pin));
        }
        let mut channel = Channel::new(one.class, one.name.clone(), named);
        if let Some(kind) = one.kind {
            channel.kind = kind.to_owned();
        }
        channel.estop = one.estop;
        if one.class == Class::Output && machine.board.active_low.contains(&one.name) {
            channel.invert = true;
            channel.safe = Some(Level::High);
        }
        made.push((one.class, channel));
    }
    Ok(made)
}

fn no_room(machine: &CncMachine, board: &Board, one: &Wanted, drives: bool) -> Error {
    let platform = &board.platform.name;
    let name = format!("{:?}", one.name);
    if drives {
        return machine.error(
            &one.key,
            name,
            format!("needs an output pin, and {platform} has none left"),
            "take outputs away, or leave more headers as they are sold",
        );
    }
    let modified = &board.modified.bus_switch;
    let headers = board.platform.headers.iter().rev();
    let mut unmodified = headers.filter(|(name, _)| !modified.contains(name));
    let more = unmodified.next().map_or("j8", |(name, _)| name);
    machine.error(
        &one.key,
        name,
        format!(
            "needs an input pin, and the modified headers have none left ({} input pins in all)",
            inputs(machine)
        ),
        format!(
            "replace the buffers of another header and write it into [board] modified, as in \"{more}\" or \"{more}:shared\""
        ),
    )
}

/// A new board with all that is needed.
fn fill(machine: &CncMachine, mut board: Board) -> Result<Board, Error> {
    for (class, channel) in new_channels(machine, &board)? {
        board.channels[class as usize].push(channel);
    }
    Ok(board)
}

/// The file that is there, with what is needed and not there at its end.
fn add(
    machine: &CncMachine,
    board: &Board,
    text: &str,
    notes: &mut Vec<String>,
) -> Result<String, Error> {
    let new = new_channels(machine, board)?;
    let mut text = text.to_owned();
    if !new.is_empty() && !text.ends_with('\n') {
        text.push('\n');
    }
    for (class, one) in &new {
        channel(&mut text, *class, one);
    }
    if !new.is_empty() {
        let names: Vec<&str> = new.iter().map(|(_, one)| one.name.as_str()).collect();
        notes.push(format!(
            "{} of the board file is new: the card needs a new image",
            names.join(", ")
        ));
    }
    Ok(text)
}

/// Channels that the machine does not use.
fn unused(machine: &CncMachine, board: &Board) -> Option<String> {
    let wanted = wanted(machine);
    let mut idle = Vec::new();
    for class in Class::ALL {
        for channel in board.of(class) {
            let is = |one: &Wanted| one.class == class && one.name == channel.name;
            if !wanted.iter().any(is) {
                idle.push(format!("{} {}", class.key(), channel.name));
            }
        }
    }
    (!idle.is_empty()).then(|| {
        format!(
            "{} is not used by the machine: it is custom.hal's, or may go out of the board file",
            idle.join(", ")
        )
    })
}
