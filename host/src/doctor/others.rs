//! What else of this computer uses the port, or stands in front of it: a second manager, DHCP, a
//! firewall, programs that send.

use super::network;
use super::system::System;
use crate::finding::Finding;
use std::net::Ipv4Addr;

/// Programs that send to every port by themselves.
const SENDERS: [&str; 4] = ["avahi-daemon", "lldpd", "chronyd", "ntpd"];

/// All checks of this module.
pub fn examine(system: &System<'_>, interface: &str, board: Option<Ipv4Addr>) -> Vec<Finding> {
    if interface == "lo" {
        return Vec::new();
    }
    vec![
        manager(system, interface, board),
        method(system, interface, board),
        firewall(system, interface, board),
        senders(system, interface, board),
    ]
}

/// The connection of NetworkManager that the port has.
fn connection(system: &System<'_>, interface: &str) -> Option<String> {
    let arguments = ["-g", "GENERAL.CONNECTION", "device", "show", interface];
    let said = system.print("nmcli", &arguments)?;
    let name = said.trim().replace("\\:", ":");
    (!name.is_empty() && name != "--" && !name.starts_with("Error")).then_some(name)
}

/// The way in which ifupdown gives the port an address, if it does.
fn stanza(system: &System<'_>, interface: &str) -> Option<String> {
    let text = system.read("etc/network/interfaces")?;
    text.lines().find_map(|line| {
        let words: Vec<_> = line.split_whitespace().collect();
        match words[..] {
            ["iface", name, "inet", method] if name == interface => Some(method.to_owned()),
            _ => None,
        }
    })
}

/// What systemd-networkd keeps of the port.
fn of_networkd(system: &System<'_>, interface: &str, what: &str) -> Option<String> {
    let index = system.read(&format!("sys/class/net/{interface}/ifindex"))?;
    system.read(&format!("run/systemd/netif/{what}/{index}"))
}

/// systemd-networkd has set the port up, or is about to.
pub fn by_networkd(system: &System<'_>, interface: &str) -> bool {
    let state = of_networkd(system, interface, "links").unwrap_or_default();
    state.lines().any(|line| {
        matches!(
            line.strip_prefix("ADMIN_STATE="),
            Some("configured" | "configuring" | "pending" | "degraded")
        )
    })
}

fn manager(system: &System<'_>, interface: &str, board: Option<Ipv4Addr>) -> Finding {
    let check = "manager of the port";
    let remedies = [
        (
            stanza(system, interface).map(|_| "/etc/network/interfaces".to_owned()),
            format!("remove `iface {interface}` from /etc/network/interfaces"),
        ),
        (
            by_networkd(system, interface).then(|| "systemd-networkd".to_owned()),
            format!(
                "remove the file of /etc/systemd/network that matches {interface} (networkctl status {interface} names it)"
            ),
        ),
        (
            connection(system, interface).map(|name| format!("NetworkManager, with {name}")),
            format!("sudo nmcli device set {interface} managed no"),
        ),
    ];
    let all = remedies.iter();
    let all: Vec<_> = all
        .filter_map(|(manager, remedy)| Some((manager.as_deref()?, remedy)))
        .collect();
    let fact: Vec<&str> = all.iter().map(|(manager, _)| *manager).collect();
    match all[..] {
        [] => Finding::good(check, "none"),
        [_] => Finding::good(check, fact.concat()),
        [(_, remedy), ..] => Finding::bad(
            check,
            fact.join(" and "),
            "two take turns in setting the address, and the board is lost in between",
            remedy,
        )
        .lasting(network::setup(interface, board)),
    }
}

fn method(system: &System<'_>, interface: &str, board: Option<Ipv4Addr>) -> Finding {
    let check = "where the address is from";
    let method = match connection(system, interface) {
        Some(name) => system
            .print("nmcli", &["-g", "ipv4.method", "connection", "show", &name])
            .map(|said| said.trim().to_owned()),
        None => stanza(system, interface),
    };
    let leased = of_networkd(system, interface, "leases").map(|_| "dhcp".to_owned());
    let method = method.or(leased);
    match method.as_deref() {
        Some(method @ ("auto" | "link-local" | "dhcp")) => Finding::bad(
            check,
            method,
            "a board gives no address: the port loses its own after a while",
            &network::setup(interface, board),
        ),
        Some(_) | None => Finding::good(check, "it is set"),
    }
}

fn firewall(system: &System<'_>, interface: &str, board: Option<Ipv4Addr>) -> Finding {
    let check = "firewall";
    let ufw = system.read("etc/ufw/ufw.conf").unwrap_or_default();
    let from = board.map_or("the board".to_owned(), |ip| ip.to_string());
    let reason = "it may throw the board's answers away, or those to discover's broadcasts";
    if ufw.lines().any(|line| line.trim() == "ENABLED=yes") {
        let allow = format!("sudo ufw allow in on {interface} from {from}");
        return Finding::note(check, "ufw", reason, &allow);
    }
    if system.runs("firewalld") {
        let zone = format!("sudo firewall-cmd --zone=trusted --change-interface={interface}");
        return Finding::note(check, "firewalld", reason, &zone)
            .lasting(format!("{zone} --permanent"));
    }
    // Only root is told of chains.
    let chains = system.print("nft", &["list", "chains"]).unwrap_or_default();
    let drops = |line: &str| line.contains(" hook input ") && line.contains("policy drop");
    if chains.lines().any(drops) {
        let remedy = format!(
            "let UDP from {from} in at {interface} in the chain with `hook input`: sudo nft list ruleset shows it"
        );
        return Finding::note(
            check,
            "a chain of nftables drops what no rule takes",
            reason,
            &remedy,
        )
        .lasting("the same rule in /etc/nftables.conf, or in what writes that chain");
    }
    Finding::good(check, "neither ufw nor firewalld")
}

fn senders(system: &System<'_>, interface: &str, board: Option<Ipv4Addr>) -> Finding {
    let check = "programs that send there";
    if system.exists(&format!("etc/ferrocnc/net-{interface}.nft")) {
        return Finding::good(check, "the rule of `ferrocnc net setup` keeps them off");
    }
    let avahi = system
        .read("etc/avahi/avahi-daemon.conf")
        .unwrap_or_default();
    let is_denied = avahi.lines().any(|line| {
        let mut halves = line.splitn(2, '=');
        halves.next().map(str::trim) == Some("deny-interfaces")
            && halves
                .next()
                .is_some_and(|list| list.split(',').any(|it| it.trim() == interface))
    });
    let found: Vec<_> = SENDERS
        .into_iter()
        .filter(|name| system.runs(name) && !(*name == "avahi-daemon" && is_denied))
        .collect();
    match found.is_empty() {
        true => Finding::good(check, "none that is known"),
        false => Finding::note(
            check,
            found.join(", "),
            "what it sends stands in front of the board's frames",
            &network::setup(interface, board),
        ),
    }
}
