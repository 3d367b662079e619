//! What of this computer makes exchanges late, or loses them.
//!
//! Every check reads: files below `/proc`, `/sys` and a few others, and what `ip`, `ethtool` and
//! `getcap` print. It needs no root, changes nothing, and takes no session, so it works while
//! LinuxCNC drives a board; but for the soak, which takes the board. A [`Finding`] says the fact, a
//! verdict, its reason, what to do now, and what makes that outlast a restart of the computer.
//!
//! | module | |
//! |---|---|
//! | [`platform`] | kernel, LinuxCNC, its rights |
//! | [`realtime`] | the module that LinuxCNC loads |
//! | [`linuxcnc`] | its real-time part: what an earlier run left, which build, which processor |
//! | [`cpu`] | what keeps a processor from the servo thread, BIOS |
//! | [`kernel`] | idle states, power of PCIe, parameters, graphics driver |
//! | [`port`] | the Ethernet port: driver, link, interrupts, power |
//! | [`card`] | its chip, the threads of its interrupts, what it puts together |
//! | [`network`] | addresses, routes, neighbours on it |
//! | [`others`] | managers, firewalls and programs that use the port, too |
//! | [`line`] | frames, switches and boards on the line that are not meant to be there |
//! | [`ping`] | the round trip of pings at real-time priority |
//! | [`board`] | what the board says: release, image, settings, refusals, key, way of exchanges |
//! | [`names`] | the names of its pins in HAL |
//! | [`running`] | what a LinuxCNC that runs says of itself |
//! | [`files`] | INI and HAL files of a configuration |
//! | [`machine`] | that configuration against the board |
//! | [`soak`] | the exchange itself, measured for a minute |
//! | [`system`] | where all of them read |
//! | [`fix`] | what is repaired if the operator says so |
//!
//! Where the checks and their limits come from: LinuxCNC's documentation of real time, the manual
//! page of Mesa's `hm2_eth`, and threads of LinuxCNC's users. A limit of our own says so.

pub mod board;
pub mod card;
pub mod cpu;
pub mod files;
pub mod fix;
pub mod kernel;
pub mod line;
pub mod linuxcnc;
pub mod machine;
pub mod names;
pub mod network;
pub mod others;
pub mod ping;
pub mod platform;
pub mod port;
pub mod realtime;
pub mod running;
pub mod soak;
pub mod system;

use crate::finding::{Finding, Report};
use std::net::Ipv4Addr;
use std::time::Duration;
use system::System;

/// What is looked at besides the computer itself.
#[derive(Clone, Debug, Default)]
pub struct Subject {
    /// The board's address.
    pub board: Option<Ipv4Addr>,
    /// The interface to it, if the routes are not to be asked.
    pub interface: Option<String>,
    /// Count for so long what this computer sends there.
    pub listen: Option<Duration>,
    /// Ping the board for so long, once on any processor and once on LinuxCNC's.
    pub ping: Option<Duration>,
}

impl Subject {
    /// The interface: the one that was named, or the one that leads to the board.
    pub fn port(&self, system: &System<'_>) -> Option<String> {
        let routed = || self.board.and_then(|ip| network::to(system, ip));
        self.interface.clone().or_else(routed)
    }
}

/// Looks at everything.
pub fn examine(system: &System<'_>, subject: &Subject) -> Report {
    let mut findings = platform::examine(system);
    findings.extend(realtime::examine(system));
    findings.extend(linuxcnc::examine(system));
    findings.extend(cpu::examine(system));
    findings.extend(kernel::examine(system));
    match subject.port(system) {
        Some(interface) => {
            findings.extend(port::examine(system, &interface));
            findings.extend(card::examine(system, &interface));
            findings.extend(network::examine(system, &interface, subject.board));
            findings.extend(others::examine(system, &interface, subject.board));
            let (board, listen) = (subject.board, subject.listen);
            findings.extend(line::examine(system, &interface, board, listen));
            // Behind the count of frames, which pings would be part of.
            findings.extend(ping::examine(system, &interface, board, subject.ping));
        }
        None => findings.push(no_interface(subject)),
    }
    findings.extend(running::examine(system));
    let kernel = system.read("proc/sys/kernel/osrelease");
    let processor = system.read("proc/cpuinfo").and_then(|text| {
        let line = text.lines().find(|line| line.starts_with("model name"))?;
        Some(line.split_once(": ")?.1.to_owned())
    });
    let unknown = || "unknown".to_owned();
    Report {
        about: "computer",
        head: vec![
            ("tool", env!("CARGO_PKG_VERSION").to_owned()),
            ("kernel", kernel.unwrap_or_else(unknown)),
            ("processor", processor.unwrap_or_else(unknown)),
            (
                "command line",
                system.read("proc/cmdline").unwrap_or_else(unknown),
            ),
        ],
        findings,
    }
}

fn no_interface(subject: &Subject) -> Finding {
    match subject.board {
        Some(ip) => Finding::bad(
            "interface",
            format!("no route to {ip}"),
            "no port of this computer has an address in the board's net",
            &network::setup("IF", Some(ip)),
        ),
        None => Finding::skipped(
            "interface",
            "not looked at",
            "no board and no interface was named",
            "`ferrocnc doctor BOARD`, or `--interface IF`",
        ),
    }
}

#[cfg(test)]
mod tests;
