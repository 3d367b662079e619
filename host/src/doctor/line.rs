//! What else is on the line to the board: frames that this computer sends by itself, programs that
//! ask everything there is, a switch, boards that look alike.

use super::network;
use super::system::System;
use crate::discovery::{Finder, Found, WAIT};
use crate::finding::Finding;
use std::collections::BTreeSet;
use std::net::Ipv4Addr;
use std::time::Duration;

/// Programs that ask addresses or ports, one after the other.
const SCANNERS: [&str; 7] = [
    "ping", "fping", "mtr", "nmap", "masscan", "arp-scan", "arping",
];

/// All checks of this module that only look. For `listen` the frames are counted that this computer
/// sends there.
pub fn examine(
    system: &System<'_>,
    interface: &str,
    board: Option<Ipv4Addr>,
    listen: Option<Duration>,
) -> Vec<Finding> {
    if interface == "lo" {
        return Vec::new();
    }
    vec![
        scans(system),
        between(system, interface, board),
        traffic(system, interface, board, listen),
    ]
}

fn scans(system: &System<'_>) -> Finding {
    let check = "pings and scans";
    let found: Vec<_> = SCANNERS
        .into_iter()
        .filter(|name| system.runs(name))
        .collect();
    match found.is_empty() {
        true => Finding::good(check, "none runs here"),
        false => Finding::note(
            check,
            found.join(", "),
            "each question takes the board's time and stands in front of a command",
            "end it while the machine runs, here and on other computers of the net",
        ),
    }
}

/// Neighbours on the port besides the board, which have answered.
fn others(system: &System<'_>, interface: &str, board: Option<Ipv4Addr>) -> usize {
    let table = system.read("proc/net/arp").unwrap_or_default();
    let lines = table.lines().skip(1).filter(|line| {
        let fields: Vec<_> = line.split_whitespace().collect();
        let [ip, _, flags, _, _, device] = fields[..] else {
            return false;
        };
        let flags = u32::from_str_radix(flags.trim_start_matches("0x"), 16).unwrap_or(0);
        let is_board = board.is_some_and(|board| ip == board.to_string());
        device == interface && flags != 0 && !is_board
    });
    lines.count()
}

fn between(system: &System<'_>, interface: &str, board: Option<Ipv4Addr>) -> Finding {
    let check = "switch in between";
    let arguments = ["-f", "keyvalue", "show", "neighbors", "ports", interface];
    let said = system.print("lldpcli", &arguments).unwrap_or_default();
    let announced = said
        .lines()
        .any(|line| line.starts_with(&format!("lldp.{interface}.")));
    let others = others(system, interface, board);
    let fact = match (announced, others) {
        (false, 0) => return Finding::good(check, "no sign of one"),
        (true, _) => "one announces itself by LLDP".to_owned(),
        (false, 1) => "one other address answers on the port".to_owned(),
        (false, _) => format!("{others} other addresses answer on the port"),
    };
    Finding::note(
        check,
        fact,
        "a switch holds frames back while it sends those of others; boards of one machine alone are no harm",
        "a cable from the port to the board, or a switch that nothing but boards is connected to",
    )
}

/// Frames that this computer has sent there: the tenth of the port's counters. Of the network
/// namespace that asks, which /sys is not.
fn sent(system: &System<'_>, interface: &str) -> Option<u64> {
    let table = system.read("proc/net/dev")?;
    let mut lines = table.lines().filter_map(|line| line.split_once(':'));
    let (_, counters) = lines.find(|(name, _)| name.trim() == interface)?;
    counters.split_whitespace().nth(9)?.parse().ok()
}

fn traffic(
    system: &System<'_>,
    interface: &str,
    board: Option<Ipv4Addr>,
    listen: Option<Duration>,
) -> Finding {
    let check = "frames sent there";
    let count = || sent(system, interface);
    if system.runs("rtapi_app") {
        return Finding::skipped(
            check,
            "not counted",
            "LinuxCNC runs, and sends to the board",
            "end LinuxCNC, then again",
        );
    }
    let Some(listen) = listen else {
        return Finding::skipped(
            check,
            "not counted",
            "that takes some seconds",
            "ferrocnc doctor BOARD --listen",
        );
    };
    let before = count();
    (system.wait)(listen);
    let (Some(before), Some(after)) = (before, count()) else {
        return Finding::skipped(check, "not known", "the kernel does not count them", "");
    };
    let (sent, seconds) = (after.saturating_sub(before), listen.as_secs_f64());
    match sent {
        0 => Finding::good(check, format!("none in {seconds} s")),
        _ => Finding::note(
            check,
            format!("{sent} in {seconds} s, none of them this tool's"),
            "each stands in front of a command: IPv6, multicast DNS, LLDP, time by broadcast",
            &format!("see which with: sudo tcpdump -ni {interface}; end what sends them"),
        )
        .lasting(network::setup(interface, board)),
    }
}

/// Asks by ARP how many own the board's address; only root may. Not while LinuxCNC runs.
pub fn owners(system: &System<'_>, interface: &str, board: Ipv4Addr) -> Finding {
    let check = "owners of the address";
    if interface == "lo" {
        return Finding::good(check, "this computer itself");
    }
    if system.runs("rtapi_app") {
        let reason = "LinuxCNC runs, and each question stands in front of a command";
        return Finding::skipped(check, "not asked", reason, "end LinuxCNC, then again");
    }
    let ip = board.to_string();
    let arguments = ["-c", "2", "-w", "2", "-I", interface, &ip];
    let said = system.print("arping", &arguments).unwrap_or_default();
    // `Unicast reply from 192.168.2.50 [02:00:00:00:00:01]  0.7ms`
    let of_line = |line: &str| Some(line.split_once('[')?.1.split_once(']')?.0.to_lowercase());
    let owners: BTreeSet<String> = said.lines().filter_map(of_line).collect();
    match owners.len() {
        0 => Finding::skipped(
            check,
            "not known",
            "arping is not there, or had no answer: only root may ask",
            "sudo apt install iputils-arping, and sudo ferrocnc doctor BOARD",
        ),
        1 => Finding::good(check, "one"),
        n => Finding::bad(
            check,
            format!("{n} answer for {ip}"),
            "a command reaches one of them, and not always the same",
            "give the board or the other device another address: ferrocnc set BOARD --ip IP",
        ),
    }
}

/// A board that answers on the port.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Answer {
    /// Its unique id; zeros if its flash has none.
    pub uid: [u32; 2],
    /// Its address.
    pub ip: Ipv4Addr,
    /// Its hardware address.
    pub mac: [u8; 6],
}

impl Answer {
    fn of(found: &Found) -> Self {
        Answer {
            uid: found.uid,
            ip: found.here.ip.into(),
            mac: found.here.mac,
        }
    }
}

/// Asks which boards answer on the port, and whether two look alike. While LinuxCNC runs nothing is
/// asked, and on `lo` there are only simulated boards.
pub fn boards(system: &System<'_>, interface: &str) -> Vec<Finding> {
    let check = "boards on the port";
    if interface == "lo" {
        return Vec::new();
    }
    if system.runs("rtapi_app") {
        return vec![Finding::skipped(
            check,
            "not asked",
            "LinuxCNC runs, and every board would answer in front of its commands",
            "end LinuxCNC, then again",
        )];
    }
    let found = Finder::everywhere(Some(interface)).and_then(|finder| finder.all(WAIT));
    match found {
        Ok(found) => {
            let answers: Vec<Answer> = found.iter().map(Answer::of).collect();
            vec![alike(&answers)]
        }
        Err(error) => vec![Finding::skipped(
            check,
            "not asked",
            &error.to_string(),
            "ferrocnc discover",
        )],
    }
}

/// No two boards have one address, one hardware address or one unique id.
pub fn alike(answers: &[Answer]) -> Finding {
    let check = "boards on the port";
    let is_shared = |of: &dyn Fn(&Answer) -> Option<u64>| {
        let mut seen = BTreeSet::new();
        answers.iter().filter_map(of).any(|it| !seen.insert(it))
    };
    let count = match answers.len() {
        0 => "none answers a broadcast".to_owned(),
        1 => "one answers".to_owned(),
        n => format!("{n} answer"),
    };
    let macs = |it: &Answer| {
        let [a, b, c, d, e, f] = it.mac;
        Some(u64::from_be_bytes([0, 0, a, b, c, d, e, f]))
    };
    let shared_ip = answers
        .iter()
        .map(|it| it.ip)
        .find(|ip| answers.iter().filter(|it| it.ip == *ip).count() > 1);
    if let Some(ip) = shared_ip {
        return Finding::bad(
            check,
            format!("{count}, and several have the address {ip}"),
            "a command reaches one of them, and not always the same",
            "give one another address: ferrocnc set --uid UID --ip IP (ferrocnc discover shows ids)",
        );
    }
    if is_shared(&macs) {
        return Finding::bad(
            check,
            format!("{count}, and several have one hardware address"),
            "a switch sends commands to one of them, and not always the same",
            "let each have that of its unique id: ferrocnc set --uid UID --mac 00:00:00:00:00:00",
        );
    }
    let id = |it: &Answer| {
        let [hi, lo] = it.uid;
        (it.uid != [0, 0]).then_some(u64::from(hi) << 32 | u64::from(lo))
    };
    if is_shared(&id) {
        return Finding::bad(
            check,
            format!("{count}, and several have one unique id"),
            "settings and keys go by the id, so those of one would reach the other",
            "connect one at a time; the flash of one of them is a copy with its id",
        );
    }
    match answers.len() {
        0 => Finding::skipped(
            check,
            count,
            "no board, or a firewall that drops broadcasts",
            "ferrocnc discover",
        ),
        _ => Finding::good(check, format!("{count}, each with its own address and id")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::finding::Verdict::{Bad, Good, Skipped};

    fn answer(n: u8) -> Answer {
        Answer {
            uid: [1, n.into()],
            ip: Ipv4Addr::new(192, 168, 2, n),
            mac: [2, 0, 0, 0, 0, n],
        }
    }

    #[test]
    fn boards_that_look_alike_are_told_with_what_makes_them_differ() {
        assert_eq!(alike(&[]).verdict, Skipped);
        assert_eq!(alike(&[answer(1)]).verdict, Good);
        assert_eq!(alike(&[answer(1), answer(2)]).verdict, Good);
        type Change = fn(&mut Answer);
        let ways: [(Change, &str); 3] = [
            (|it| it.ip = answer(1).ip, "--ip"),
            (|it| it.mac = answer(1).mac, "--mac"),
            (|it| it.uid = answer(1).uid, "one at a time"),
        ];
        for (change, remedy) in ways {
            let mut second = answer(2);
            change(&mut second);
            let finding = alike(&[answer(1), second]);
            assert_eq!(finding.verdict, Bad, "{finding:?}");
            assert!(finding.remedy.contains(remedy), "{finding:?}");
            assert!(!finding.fact.contains("02:00"), "{finding:?}");
        }
    }

    #[test]
    fn boards_without_an_id_are_not_taken_for_one() {
        let mut both = [answer(1), answer(2)];
        for board in &mut both {
            board.uid = [0, 0];
        }
        assert_eq!(alike(&both).verdict, Good);
    }
}
