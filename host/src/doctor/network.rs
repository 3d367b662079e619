//! Addresses, routes and neighbours on the port.

use super::system::System;
use crate::finding::Finding;
use std::net::Ipv4Addr;

/// All checks of this module.
pub fn examine(system: &System<'_>, interface: &str, board: Option<Ipv4Addr>) -> Vec<Finding> {
    let mut findings = vec![address(system, interface, board), alone(system, interface)];
    if let Some(board) = board {
        findings.push(elsewhere(system, interface, board));
        findings.push(neighbour(system, interface, board));
    }
    findings.extend([reverse_path(system, interface), ipv6(system, interface)]);
    findings
}

/// A line of the kernel's table of routes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Route {
    /// Where it leads.
    pub interface: String,
    /// The first address of its net.
    pub net: u32,
    /// The bits of an address that tell its net.
    pub mask: u32,
}

impl Route {
    /// The address is of its net.
    pub fn holds(&self, ip: Ipv4Addr) -> bool {
        u32::from(ip) & self.mask == self.net
    }

    /// It is the way to every address that has no other.
    pub fn is_default(&self) -> bool {
        (self.net, self.mask) == (0, 0)
    }
}

/// The kernel's table of routes.
pub fn routes(system: &System<'_>) -> Vec<Route> {
    let table = system.read("proc/net/route").unwrap_or_default();
    let lines = table.lines().skip(1).filter_map(|line| {
        let fields: Vec<_> = line.split_whitespace().collect();
        // Hexadecimal, in the order of this processor's bytes, which is little-endian wherever
        // LinuxCNC runs.
        let word = |text: &&str| u32::from_str_radix(text, 16).ok().map(u32::swap_bytes);
        Some(Route {
            interface: (*fields.first()?).to_owned(),
            net: fields.get(1).and_then(word)?,
            mask: fields.get(7).and_then(word)?,
        })
    });
    lines.collect()
}

/// The interface that leads to an address.
pub fn to(system: &System<'_>, ip: Ipv4Addr) -> Option<String> {
    if ip.is_loopback() {
        return Some("lo".to_owned());
    }
    let mut all = routes(system);
    all.retain(|route| route.holds(ip));
    let best = all
        .into_iter()
        .max_by_key(|route| route.mask.count_ones())?;
    Some(best.interface)
}

/// The interface's addresses and the bits of their nets; `None` without `ip`.
pub fn addresses(system: &System<'_>, interface: &str) -> Option<Vec<(Ipv4Addr, u32)>> {
    let text = system.print("ip", &["-4", "-br", "addr", "show", "dev", interface])?;
    let words = text.split_whitespace().filter_map(|word| {
        let (ip, bits) = word.split_once('/')?;
        Some((ip.parse().ok()?, bits.parse().ok()?))
    });
    Some(words.collect())
}

/// The command that sets the port up for the board.
pub fn setup(interface: &str, board: Option<Ipv4Addr>) -> String {
    let board = board.map(|ip| format!(" {ip}")).unwrap_or_default();
    format!("sudo ferrocnc net setup {interface}{board}")
}

fn address(system: &System<'_>, interface: &str, board: Option<Ipv4Addr>) -> Finding {
    let check = "address";
    let Some(ours) = addresses(system, interface) else {
        return Finding::skipped(
            check,
            "not known",
            "there is no `ip`",
            "sudo apt install iproute2",
        );
    };
    let fact = ours
        .iter()
        .map(|(ip, bits)| format!("{ip}/{bits}"))
        .collect::<Vec<_>>()
        .join(", ");
    let setup = setup(interface, board);
    if ours.is_empty() {
        return Finding::bad(check, "none", "the port cannot send to the board", &setup);
    }
    if let Some(board) = board {
        if ours.iter().any(|(ip, _)| *ip == board) {
            return Finding::bad(
                check,
                fact,
                "this computer has the board's address itself",
                &format!(
                    "sudo ip addr del {board} dev {interface}, and another one of the same net"
                ),
            )
            .lasting(&setup);
        }
        let near = |(ip, bits): &(Ipv4Addr, u32)| {
            let mask = u32::MAX.checked_shl(32 - bits.min(&32)).unwrap_or(0);
            (u32::from(*ip) ^ u32::from(board)) & mask == 0
        };
        if !ours.iter().any(near) {
            return Finding::bad(
                check,
                fact,
                "the board is in another net: its frames take a detour",
                &setup,
            );
        }
    }
    match ours.len() {
        1 => Finding::good(check, fact),
        _ => Finding::note(
            check,
            fact,
            "a second net on the port brings frames of others",
            "remove all but the board's: sudo ip addr del",
        )
        .lasting(&setup),
    }
}

fn alone(system: &System<'_>, interface: &str) -> Finding {
    let check = "the port is the board's";
    let all = routes(system);
    if !all
        .iter()
        .any(|route| route.interface == interface && route.is_default())
    {
        return Finding::good(check, "no other route leads there");
    }
    Finding::bad(
        check,
        "the default route leads there",
        "everything this computer sends stands in front of the board's frames",
        "connect the rest of the network to another port",
    )
    .lasting(setup(interface, None))
}

fn elsewhere(system: &System<'_>, interface: &str, board: Ipv4Addr) -> Finding {
    let check = "the board's net";
    let other = routes(system)
        .into_iter()
        .find(|route| route.interface != interface && !route.is_default() && route.holds(board));
    match other {
        None => Finding::good(check, "is on this port only"),
        Some(route) => Finding::bad(
            check,
            format!("is on {}, too", route.interface),
            "the kernel may send to the wrong port",
            "give the board an address of another net: ferrocnc set",
        ),
    }
}

fn neighbour(system: &System<'_>, interface: &str, board: Ipv4Addr) -> Finding {
    let check = "neighbour entry";
    if interface == "lo" {
        return Finding::good(check, "none is needed");
    }
    let table = system.read("proc/net/arp").unwrap_or_default();
    let entry = table.lines().find_map(|line| {
        let fields: Vec<_> = line.split_whitespace().collect();
        let [ip, _, flags, mac, _, device] = fields[..] else {
            return None;
        };
        (ip == board.to_string() && device == interface).then(|| {
            let flags = u32::from_str_radix(flags.trim_start_matches("0x"), 16).unwrap_or(0);
            (flags & 4 != 0, mac.to_owned())
        })
    });
    match entry {
        Some((true, _)) => Finding::good(check, "permanent"),
        Some((false, mac)) => Finding::note(
            check,
            "from ARP",
            "the kernel asks for it again from time to time, and holds the command until the answer",
            &format!("sudo ip neigh replace {board} lladdr {mac} nud permanent dev {interface}"),
        )
        .lasting(format!(
            "{}; the board answers ARP in motion, so this is a precaution",
            setup(interface, Some(board))
        )),
        None => Finding::skipped(
            check,
            "none",
            "this computer has not talked to the board yet",
            "ferrocnc describe, then again",
        ),
    }
}

fn reverse_path(system: &System<'_>, interface: &str) -> Finding {
    let check = "reverse-path filter";
    let of = |name: &str| system.read(&format!("proc/sys/net/ipv4/conf/{name}/rp_filter"));
    let Some(strictest) = of("all").max(of(interface)) else {
        return Finding::skipped(check, "not known", "this kernel does not say", "");
    };
    match strictest.as_str() {
        "1" => Finding::note(
            check,
            "strict",
            "a board with an address of another net is not found: its answers are dropped",
            &format!("sudo sysctl -w net.ipv4.conf.{interface}.rp_filter=2"),
        )
        .lasting(setup(interface, None)),
        _ => Finding::good(check, "not strict"),
    }
}

fn ipv6(system: &System<'_>, interface: &str) -> Finding {
    let check = "IPv6 on the port";
    let path = format!("proc/sys/net/ipv6/conf/{interface}/disable_ipv6");
    match system.read(&path).as_deref() {
        Some("0") if interface != "lo" => Finding::note(
            check,
            "on",
            "the kernel sends solicitations that the board does not need",
            &format!("sudo sysctl -w net.ipv6.conf.{interface}.disable_ipv6=1"),
        )
        .lasting(setup(interface, None)),
        _ => Finding::good(check, "off"),
    }
}
