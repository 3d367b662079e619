//! The steps that give a port to the board, or why it is refused.

use super::facts::{Board, Facts, Kind, Manager, Program, kernel};
use super::files::{Content, File};
use super::paths::{Paths, own};
use super::record::{Record, Undo, shown};
use std::net::Ipv4Addr;

/// 192.168.2.50: the address of a board that was given none.
pub const FACTORY: Ipv4Addr = Ipv4Addr::from_bits(wire::settings::Settings::BUILT_IN.ip);

/// What is asked for.
#[derive(Clone, Debug, Default)]
pub struct Wish {
    /// The board's address, if the operator named it.
    pub board: Option<Ipv4Addr>,
    /// Boards that answer at the port.
    pub boards: Vec<Board>,
    /// Also a port that has the default route.
    pub force: bool,
}

/// Something to do.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Act {
    /// The file has this content.
    Write(File),
    /// The program runs.
    Run(Vec<String>),
}

impl core::fmt::Display for Act {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Act::Write(file) => {
                write!(f, "write  /{}", file.path)?;
                file.text
                    .lines()
                    .try_for_each(|line| write!(f, "\n         {line}"))
            }
            Act::Run(words) => write!(f, "run    {}", shown(words)),
        }
    }
}

/// Something to do, and what undoes it. Either may be nothing: programs do more than one thing.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Step {
    /// There.
    pub act: Option<Act>,
    /// And back.
    pub undo: Option<Undo>,
}

/// What to do.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Plan {
    /// The port.
    pub interface: String,
    /// Its address, of a net of 24 bits.
    pub address: Ipv4Addr,
    /// Boards whose hardware addresses the kernel is told.
    pub boards: Vec<Board>,
    /// In this order; none if the port is set up already.
    pub steps: Vec<Step>,
    /// What undoes it and every earlier setup of this port.
    pub record: Record,
    /// The port was set up before, in another way: a step that fails undoes that, too.
    pub again: bool,
}

/// Why a port is not set up.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Refusal {
    /// Characters that files and shells take for something else.
    Name(String),
    /// There is no such interface.
    Absent(String),
    /// This computer itself.
    Loopback,
    /// Radio.
    Wireless(String),
    /// Part of a bridge or bond.
    Part(String),
    /// Without it this computer has no network.
    DefaultRoute(String),
    /// Neither NetworkManager nor ifupdown.
    NoManager,
    /// Programs that are needed.
    Missing(Vec<Program>),
    /// `/etc/network/interfaces` would not read our file.
    NotRead,
    /// Something else sets it up.
    Claimed(String, String),
    /// A file with our name of which nothing is recorded.
    Foreign(String),
    /// Set up for another manager than the one that runs.
    OtherManager(String),
    /// The net is at another port, too.
    Elsewhere(Ipv4Addr, String),
    /// Two boards with one address.
    Shared(Ipv4Addr),
    /// Boards of two nets, and none is named.
    Nets(Ipv4Addr, Ipv4Addr),
    /// Every address of the net is a board's.
    Full(Ipv4Addr),
}

impl core::fmt::Display for Refusal {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Refusal::Name(name) => write!(
                f,
                "\"{name}\" is not the name of a port: it may have letters, digits, - and _; ip link shows the names"
            ),
            Refusal::Absent(name) => write!(
                f,
                "this computer has no interface \"{name}\"; ip link shows their names"
            ),
            Refusal::Loopback => f.write_str(
                "lo is this computer itself; name the Ethernet port that the board is at",
            ),
            Refusal::Wireless(name) => write!(
                f,
                "{name} is wireless, which loses frames; connect the board to an Ethernet port by a cable"
            ),
            Refusal::Part(name) => write!(
                f,
                "{name} is part of a bridge or bond; take it out (sudo ip link set {name} nomaster, and in the network's configuration)"
            ),
            Refusal::DefaultRoute(name) => write!(
                f,
                "{name} carries this computer's default route; connect the board to another port, or say --force: this computer then reaches nothing else through {name}"
            ),
            Refusal::NoManager => f.write_str(
                "neither NetworkManager nor ifupdown is here to keep the setup; sudo apt install ifupdown",
            ),
            Refusal::Missing(programs) => {
                let (names, packages): (Vec<_>, Vec<_>) = programs.iter().copied().unzip();
                let (names, packages) = (names.join(", "), packages.join(" "));
                write!(f, "missing: {names}; sudo apt install {packages}")
            }
            Refusal::NotRead => f.write_str(
                "/etc/network/interfaces does not read interfaces.d; add the line `source /etc/network/interfaces.d/*` to it",
            ),
            Refusal::Claimed(name, by) if by.starts_with('/') => write!(
                f,
                "{by} sets {name} up already; sudo ifdown {name}, take its lines out of the file, and again"
            ),
            Refusal::Claimed(name, by) => write!(
                f,
                "{by} manages {name}; take the port out of its configuration, and again"
            ),
            Refusal::Foreign(path) => write!(
                f,
                "/{path} is there, and no record says that `ferrocnc net setup` wrote it; remove the file"
            ),
            Refusal::OtherManager(name) => write!(
                f,
                "{name} was set up when another program managed the network; sudo ferrocnc net remove {name}, and again"
            ),
            Refusal::Elsewhere(net, other) => write!(
                f,
                "the net {net}/24 is at {other}, too, so answers may go astray; give the board an address of another net: ferrocnc set --uid ID --ip ADDRESS"
            ),
            Refusal::Shared(ip) => write!(
                f,
                "several boards have the address {ip}; give all but one another: ferrocnc set --uid ID --ip ADDRESS"
            ),
            Refusal::Nets(one, other) => write!(
                f,
                "the boards {one} and {other} are of two nets; name the one to be set up for"
            ),
            Refusal::Full(net) => write!(
                f,
                "boards have every address of {net}/24; give one of them another: ferrocnc set --uid ID --ip ADDRESS"
            ),
        }
    }
}

impl std::error::Error for Refusal {}

/// The first address of an address's net of 24 bits.
pub fn net(ip: Ipv4Addr) -> Ipv4Addr {
    Ipv4Addr::from_bits(ip.to_bits() & !0xff)
}

/// Decides.
pub fn plan(facts: &Facts, wish: &Wish) -> Result<Plan, Refusal> {
    refuse(facts, wish.force)?;
    let net = chosen_net(facts, wish)?;
    let boards: Vec<Board> = { wish.boards.iter().copied() }
        .filter(|board| self::net(board.ip) == net)
        .collect();
    for (n, board) in boards.iter().enumerate() {
        if boards[..n].iter().any(|other| other.ip == board.ip) {
            return Err(Refusal::Shared(board.ip));
        }
    }
    let address = chosen_address(facts, wish, net)?;
    let content = Content {
        facts,
        address,
        boards: &boards,
    };
    let files = files(&content);
    let planned = |path: &String| files.iter().any(|file| file.path == *path);
    if !facts.files.keys().all(planned) {
        return Err(Refusal::OtherManager(facts.interface.clone()));
    }
    let set_up = |file: &File| facts.files.get(&file.path) == Some(&file.text);
    let steps = match &facts.record {
        Some(_) if files.iter().all(set_up) => Vec::new(),
        Some(_) => renewal(facts, &files),
        None => first(facts, files),
    };
    let undo = steps.iter().rev().filter_map(|step| step.undo.clone());
    let record = match &facts.record {
        Some(record) => record.clone(),
        None => Record(undo.collect()),
    };
    Ok(Plan {
        interface: facts.interface.clone(),
        address,
        boards,
        steps,
        record,
        again: facts.record.is_some(),
    })
}

/// Is it a name that can stand in files and commands as it is?
pub fn is_plain(name: &str) -> bool {
    let plain = |c: char| c.is_ascii_alphanumeric() || c == '-' || c == '_';
    // 15: the kernel's longest.
    (1..=15).contains(&name.len()) && !name.starts_with('-') && name.chars().all(plain)
}

/// Looks for what no board at the port changes.
pub fn refuse(facts: &Facts, force: bool) -> Result<(), Refusal> {
    let name = || facts.interface.clone();
    match facts.kind {
        _ if !is_plain(&facts.interface) => return Err(Refusal::Name(name())),
        Kind::Absent => return Err(Refusal::Absent(name())),
        Kind::Loopback => return Err(Refusal::Loopback),
        Kind::Wireless => return Err(Refusal::Wireless(name())),
        Kind::Part => return Err(Refusal::Part(name())),
        Kind::Wired => {}
    }
    if facts.has_default_route() && !force {
        return Err(Refusal::DefaultRoute(name()));
    }
    if facts.manager == Manager::Nothing {
        return Err(Refusal::NoManager);
    }
    if !facts.missing.is_empty() {
        return Err(Refusal::Missing(facts.missing.clone()));
    }
    if facts.manager == Manager::Ifupdown && !facts.reads_folder {
        return Err(Refusal::NotRead);
    }
    if let Some(by) = &facts.claim {
        return Err(Refusal::Claimed(name(), by.clone()));
    }
    match facts.files.keys().next() {
        Some(path) if facts.record.is_none() => Err(Refusal::Foreign(path.clone())),
        Some(_) | None => Ok(()),
    }
}

/// The net of the board: of the one that is named, of those that answer, or the factory's.
fn chosen_net(facts: &Facts, wish: &Wish) -> Result<Ipv4Addr, Refusal> {
    let first = wish.boards.first().map(|board| board.ip);
    let ip = wish.board.or(first).unwrap_or(FACTORY);
    let other = wish.boards.iter().find(|board| net(board.ip) != net(ip));
    if let (None, Some(other)) = (wish.board, other) {
        return Err(Refusal::Nets(ip, other.ip));
    }
    let here = |interface: &str| interface == facts.interface;
    let elsewhere = facts
        .table
        .iter()
        .find(|route| !here(&route.interface) && !route.is_default() && route.holds(ip));
    match elsewhere {
        Some(route) => Err(Refusal::Elsewhere(net(ip), route.interface.clone())),
        None => Ok(net(ip)),
    }
}

/// An address that the port has in the net already, or the lowest that no board has.
fn chosen_address(facts: &Facts, wish: &Wish, net: Ipv4Addr) -> Result<Ipv4Addr, Refusal> {
    let is_free =
        |ip: &Ipv4Addr| wish.board != Some(*ip) && wish.boards.iter().all(|board| board.ip != *ip);
    let had = { facts.addresses.iter() }
        .filter(|(ip, bits)| self::net(*ip) == net && *bits == 24)
        .map(|(ip, _)| *ip);
    let all = (1..255).map(|host| Ipv4Addr::from_bits(net.to_bits() | host));
    had.chain(all).find(is_free).ok_or(Refusal::Full(net))
}

fn files(content: &Content<'_>) -> Vec<File> {
    let facts = content.facts;
    let at = Paths::of(&facts.interface);
    let file = |path: &str, text: String, mode: u32| File {
        path: path.to_owned(),
        text,
        mode,
    };
    let mut files = vec![
        file(&at.kernel, content.kernel(), 0o644),
        file(&at.egress, content.egress(), 0o644),
    ];
    match facts.manager {
        Manager::NetworkManager => files.extend([
            file(&at.dispatcher, content.dispatcher(), 0o755),
            // NetworkManager reads no profile that others than root may read.
            file(&at.profile, content.profile(), 0o600),
        ]),
        Manager::Ifupdown => files.push(file(&at.stanza, content.stanza(), 0o644)),
        Manager::Nothing => {}
    }
    files
}

fn words(command: &str) -> Vec<String> {
    command.split_whitespace().map(str::to_owned).collect()
}

fn run(command: &str) -> Option<Act> {
    Some(Act::Run(words(command)))
}

fn back(command: &str) -> Option<Undo> {
    Some(Undo::Run(words(command)))
}

/// A setting of the kernel and, to undo it, its value now.
fn settings(facts: &Facts) -> Vec<Step> {
    let wanted = kernel(&facts.interface).into_iter();
    let steps = wanted.filter_map(|(key, value)| {
        let now = facts.kernel.get(&key)?;
        Some(Step {
            act: run(&format!("sysctl -q -w {key}={value}")),
            undo: back(&format!("sysctl -q -w {key}={now}")),
        })
    });
    steps.collect()
}

/// The port is given up by what it has now, and put back in the other order: switched on, then
/// addresses, then the routes that need them.
fn cleared(facts: &Facts) -> Vec<Step> {
    let interface = &facts.interface;
    let mut steps = Vec::new();
    for route in facts.routes.iter().rev() {
        steps.push(Step {
            act: run(&format!("ip -4 route del {route} dev {interface}")),
            undo: back(&format!("ip -4 route replace {route} dev {interface}")),
        });
    }
    for (ip, bits) in facts.addresses.iter().rev() {
        steps.push(Step {
            act: run(&format!("ip -4 addr del {ip}/{bits} dev {interface}")),
            undo: back(&format!("ip -4 addr replace {ip}/{bits} dev {interface}")),
        });
    }
    if let Some(now) = facts.coalescing.now() {
        steps.push(Step {
            act: None,
            undo: back(&format!("ethtool -C {interface} {now}")),
        });
    }
    if facts.up {
        steps.push(Step {
            act: None,
            undo: back(&format!("ip link set {interface} up")),
        });
    }
    steps
}

/// What a manager is told when its file is written.
fn activation(facts: &Facts) -> Vec<Step> {
    let interface = &facts.interface;
    let (own, at) = (own(interface), Paths::of(interface));
    match facts.manager {
        Manager::NetworkManager => vec![
            Step {
                act: run(&format!("nmcli connection load /{}", at.profile)),
                undo: back(&format!("nmcli connection delete id {own}")),
            },
            Step {
                act: run(&format!("nmcli --wait 30 connection up id {own}")),
                undo: None,
            },
            // NetworkManager runs it, too, but does not say when.
            Step {
                act: run(&format!("/{} {interface} up", at.dispatcher)),
                undo: back(&format!("/{} {interface} down", at.dispatcher)),
            },
        ],
        Manager::Ifupdown => vec![Step {
            act: run(&format!("ifup {interface}")),
            // Forced: also one that ifup has not finished.
            undo: back(&format!("ifdown --force {interface}")),
        }],
        Manager::Nothing => Vec::new(),
    }
}

/// The steps on a port that was not set up.
fn first(facts: &Facts, files: Vec<File>) -> Vec<Step> {
    let mut steps = settings(facts);
    match (facts.manager, &facts.connection) {
        (Manager::NetworkManager, Some(name)) => {
            let up = ["nmcli", "--wait", "0", "connection", "up", "id", name];
            let up: Vec<_> = up.iter().map(|word| (*word).to_owned()).collect();
            steps.push(Step {
                act: None,
                undo: Some(Undo::Run(up)),
            });
        }
        (Manager::NetworkManager, None) => {}
        (Manager::Ifupdown | Manager::Nothing, _) => steps.extend(cleared(facts)),
    }
    steps.extend(files.into_iter().map(|file| Step {
        undo: Some(Undo::Remove(file.path.clone())),
        act: Some(Act::Write(file)),
    }));
    steps.extend(activation(facts));
    steps
}

/// The steps on a port that was set up in another way: what undoes the first setup stays.
fn renewal(facts: &Facts, files: &[File]) -> Vec<Step> {
    let mut acts = Vec::new();
    if facts.manager == Manager::Ifupdown {
        acts.extend(run(&format!("ifdown --force {}", facts.interface)));
    }
    acts.extend(files.iter().cloned().map(Act::Write));
    acts.extend(settings(facts).into_iter().filter_map(|step| step.act));
    acts.extend(activation(facts).into_iter().filter_map(|step| step.act));
    let steps = acts.into_iter().map(|act| Step {
        act: Some(act),
        undo: None,
    });
    steps.collect()
}
