//! What the plan depends on.

use super::paths::{INTERFACES, Paths, own};
use super::record::Record;
use crate::doctor::network::{Route, addresses, routes};
use crate::doctor::others;
use crate::doctor::port::Coalescing;
use crate::doctor::system::System;
use std::collections::BTreeMap;
use std::net::Ipv4Addr;

/// A board at the port.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Board {
    /// Its address.
    pub ip: Ipv4Addr,
    /// Its hardware address.
    pub mac: [u8; 6],
}

/// What kind of interface has the name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// None.
    Absent,
    /// This computer itself.
    Loopback,
    /// Radio.
    Wireless,
    /// Part of a bridge or bond.
    Part,
    /// What a board can be plugged into.
    Wired,
}

/// What sets ports up on this computer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Manager {
    /// It runs.
    NetworkManager,
    /// Debian's `/etc/network/interfaces`.
    Ifupdown,
    /// Neither is there.
    Nothing,
}

/// A program, and the package of Debian that has it.
pub type Program = (&'static str, &'static str);

/// The computer, as far as the port is concerned.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Facts {
    /// The port's name.
    pub interface: String,
    /// What it is.
    pub kind: Kind,
    /// It is switched on.
    pub up: bool,
    /// Its addresses and the bits of their nets.
    pub addresses: Vec<(Ipv4Addr, u32)>,
    /// Its routes that do not come with an address, as `ip route` prints them.
    pub routes: Vec<String>,
    /// This computer's table of routes.
    pub table: Vec<Route>,
    /// What sets ports up.
    pub manager: Manager,
    /// `/etc/network/interfaces` reads `interfaces.d`.
    pub reads_folder: bool,
    /// What else sets up this port: a file, or a service.
    pub claim: Option<String>,
    /// The connection of NetworkManager that it has now.
    pub connection: Option<String>,
    /// Whether the card holds frames back.
    pub coalescing: Coalescing,
    /// Settings of the kernel for the port that it has: name and value now.
    pub kernel: BTreeMap<String, String>,
    /// Programs that are not there.
    pub missing: Vec<Program>,
    /// Our files that are there: path and content.
    pub files: BTreeMap<String, String>,
    /// What undoes an earlier setup.
    pub record: Option<Record>,
}

impl Facts {
    /// Reads them. An error is a record of an earlier setup that cannot be read.
    pub fn read(system: &System<'_>, interface: &str) -> Result<Self, String> {
        let path = |name: &str| format!("sys/class/net/{interface}/{name}");
        let has = |name: &str| system.exists(&path(name));
        let kind = match () {
            () if !has("mtu") => Kind::Absent,
            () if interface == "lo" => Kind::Loopback,
            () if has("wireless") || has("phy80211") => Kind::Wireless,
            () if has("master") => Kind::Part,
            () => Kind::Wired,
        };
        let manager = manager(system);
        let own = Paths::of(interface);
        let present = own.all().into_iter().filter_map(|path| {
            let text = std::fs::read(system.root.join(path)).ok()?;
            Some((path.to_owned(), String::from_utf8_lossy(&text).into_owned()))
        });
        let settings = kernel(interface).into_iter().filter_map(|(key, _)| {
            let value = system.read(&format!("proc/sys/{}", key.replace('.', "/")))?;
            Some((key, value))
        });
        let record = system.read(&own.record);
        Ok(Facts {
            interface: interface.to_owned(),
            kind,
            up: is_up(system.read(&path("flags"))),
            addresses: addresses(system, interface).unwrap_or_default(),
            routes: routes_of(system, interface),
            table: routes(system),
            manager,
            reads_folder: reads_folder(&system.read(INTERFACES).unwrap_or_default()),
            claim: claim(system, interface),
            connection: match manager {
                Manager::NetworkManager => connection(system, interface),
                Manager::Ifupdown | Manager::Nothing => None,
            },
            coalescing: Coalescing::of(system.print("ethtool", &["-c", interface]).as_deref()),
            kernel: settings.collect(),
            missing: missing(system),
            files: present.collect(),
            record: match record {
                Some(text) => {
                    Some(Record::parse(&text).map_err(|why| format!("/{} {why}", own.record))?)
                }
                None => None,
            },
        })
    }

    /// The default route leads there.
    pub fn has_default_route(&self) -> bool {
        let here = |route: &Route| route.interface == self.interface && route.is_default();
        self.table.iter().any(here)
    }
}

/// Settings of the kernel for the port, and the values they get.
///
/// rp_filter 2: an answer counts if there is any way to its sender, so boards with an address of
/// another net are found, too. The stricter 1 of all ports does not count then.
pub fn kernel(interface: &str) -> [(String, &'static str); 2] {
    [
        (format!("net.ipv4.conf.{interface}.rp_filter"), "2"),
        (format!("net.ipv6.conf.{interface}.disable_ipv6"), "1"),
    ]
}

fn manager(system: &System<'_>) -> Manager {
    let running = system.print("nmcli", &["-t", "-f", "RUNNING", "general"]);
    match running.is_some_and(|said| said.trim() == "running") {
        true => Manager::NetworkManager,
        false if system.has_program("ifup") => Manager::Ifupdown,
        false => Manager::Nothing,
    }
}

/// ethtool says what the card has, also where NetworkManager sets it.
const NEEDED: [Program; 4] = [
    ("ip", "iproute2"),
    ("sysctl", "procps"),
    ("nft", "nftables"),
    ("ethtool", "ethtool"),
];

fn missing(system: &System<'_>) -> Vec<Program> {
    let missing = |(program, _): &Program| !system.has_program(program);
    NEEDED.into_iter().filter(missing).collect()
}

/// Bit 0 of an interface's flags.
fn is_up(flags: Option<String>) -> bool {
    let flags = flags.unwrap_or_default();
    let flags = u32::from_str_radix(flags.trim_start_matches("0x"), 16);
    flags.is_ok_and(|flags| flags & 1 != 0)
}

/// Routes that the kernel does not make of an address by itself.
fn routes_of(system: &System<'_>, interface: &str) -> Vec<String> {
    let said = system.print("ip", &["-4", "route", "show", "dev", interface]);
    let said = said.unwrap_or_default();
    let lines = said.lines().filter(|line| !line.contains("proto kernel"));
    // What follows is a state, not a part of the route.
    let lines = lines.map(|line| line.replace("linkdown", "").trim().to_owned());
    lines.filter(|line| !line.is_empty()).collect()
}

fn reads_folder(interfaces: &str) -> bool {
    interfaces.lines().any(|line| {
        let mut words = line.split_whitespace();
        matches!(words.next(), Some("source" | "source-directory"))
            && words.any(|word| word.contains("interfaces.d"))
    })
}

/// What sets up the port and is not ours.
fn claim(system: &System<'_>, interface: &str) -> Option<String> {
    let folder = format!("{INTERFACES}.d");
    let mut paths = vec![INTERFACES.to_owned()];
    let others = system.list(&folder).into_iter();
    paths.extend(
        others
            .filter(|name| *name != own(interface))
            .map(|name| format!("{folder}/{name}")),
    );
    let names_it = |path: &String| {
        let text = system.read(path).unwrap_or_default();
        text.lines().any(|line| {
            let mut words = line.split_whitespace();
            words.next() == Some("iface") && words.next() == Some(interface)
        })
    };
    if let Some(path) = paths.iter().find(|path| names_it(path)) {
        return Some(format!("/{path}"));
    }
    others::by_networkd(system, interface).then(|| "systemd-networkd".to_owned())
}

/// The connection of NetworkManager that the port has, if it is not ours.
fn connection(system: &System<'_>, interface: &str) -> Option<String> {
    let arguments = ["-g", "GENERAL.CONNECTION", "device", "show", interface];
    let said = system.print("nmcli", &arguments)?;
    let name = said.trim().replace("\\:", ":");
    (!name.is_empty() && name != "--" && !name.starts_with("Error") && name != own(interface))
        .then_some(name)
}
