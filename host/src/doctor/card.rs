//! What the network card and its driver do beyond the settings of [`super::port`]: the chip, the
//! threads of its interrupts, what they put together.

use super::system::System;
use crate::finding::Finding;

/// Chips that users report good times with, as `lspci` writes them.
const GOOD: [&str; 5] = ["I210", "I211", "I350", "82574", "82576"];
/// What a kernel gives to its threads of interrupts.
const USUAL: u32 = 50;
/// LinuxCNC's own threads have this priority.
const RTAPI: u32 = 98;

/// All checks of this module.
pub fn examine(system: &System<'_>, interface: &str) -> Vec<Finding> {
    if !system.exists(&format!("sys/class/net/{interface}/device")) {
        return Vec::new();
    }
    vec![
        chip(system, interface),
        threads(system, interface),
        offloads(system, interface),
    ]
}

fn chip(system: &System<'_>, interface: &str) -> Finding {
    let check = "chip";
    let device = system.link(&format!("sys/class/net/{interface}/device"));
    let device = device.unwrap_or_default();
    let slot = device.rsplit('/').next().unwrap_or_default();
    let said = system.print("lspci", &["-s", slot]).unwrap_or_default();
    let Some((_, name)) = said.trim().split_once(": ") else {
        return Finding::skipped(
            check,
            "not known",
            "lspci does not say",
            "sudo apt install pciutils",
        );
    };
    if name.contains("I219") {
        return Finding::note(
            check,
            name,
            "users of EtherCAT report late frames with it",
            "if the soak is bad: a card with an i210 or i350",
        );
    }
    match GOOD.iter().any(|good| name.contains(good)) {
        true => Finding::good(check, name),
        false => Finding::skipped(
            check,
            name,
            "nothing is known of its times",
            "`ferrocnc doctor BOARD --soak` measures them",
        ),
    }
}

/// The threads of the port's interrupts: number and real-time priority.
fn of_interrupts(system: &System<'_>, interface: &str) -> Vec<(String, u32)> {
    let all = system.list("proc").into_iter();
    let numbered = all.filter(|name| name.bytes().all(|byte| byte.is_ascii_digit()));
    let threads = numbered.filter_map(|process| {
        let name = system.read(&format!("proc/{process}/comm"))?;
        let (_, port) = name.strip_prefix("irq/")?.split_once('-')?;
        let queue = format!("{interface}-");
        if port != interface && !port.starts_with(&queue) {
            return None;
        }
        let stat = system.read(&format!("proc/{process}/stat"))?;
        // Behind the name, which is in brackets, the priority is the 38th.
        let fields = stat.rsplit_once(')')?.1;
        let priority = fields.split_whitespace().nth(37)?.parse().ok()?;
        Some((process, priority))
    });
    threads.collect()
}

fn threads(system: &System<'_>, interface: &str) -> Finding {
    let check = "interrupt threads";
    let threads = of_interrupts(system, interface);
    let priorities: Vec<_> = threads.iter().map(|it| it.1.to_string()).collect();
    let wrong = threads
        .iter()
        .find(|(_, priority)| !(USUAL..RTAPI).contains(priority));
    match (threads.first(), wrong) {
        (None, _) => Finding::good(check, "none: this kernel serves interrupts at once"),
        (Some(_), None) => Finding::good(check, format!("priority {}", priorities.join(", "))),
        (Some(_), Some((process, _))) => Finding::note(
            check,
            format!("priority {}", priorities.join(", ")),
            "below 50 other programs come first, from 98 on it comes before LinuxCNC itself",
            &format!("sudo chrt -f -p 80 {process}, and measure"),
        )
        .lasting("the same line in a unit of systemd of type oneshot"),
    }
}

fn offloads(system: &System<'_>, interface: &str) -> Finding {
    let check = "offloads";
    let Some(text) = system.print("ethtool", &["-k", interface]) else {
        return Finding::skipped(
            check,
            "not known",
            "there is no ethtool",
            "sudo apt install ethtool",
        );
    };
    let is_on = |name: &str| {
        text.lines()
            .filter_map(|line| line.trim().strip_prefix(name)?.strip_prefix(": "))
            .any(|value| value.starts_with("on") && !value.contains("fixed"))
    };
    let words: Vec<_> = [
        ("generic-receive-offload", "gro"),
        ("large-receive-offload", "lro"),
    ]
    .into_iter()
    .filter(|(name, _)| is_on(name))
    .map(|(_, word)| format!("{word} off"))
    .collect();
    if words.is_empty() {
        return Finding::good(check, "off");
    }
    let command = format!("ethtool -K {interface} {}", words.join(" "));
    Finding::note(
        check,
        words.join(", ").replace("off", "on"),
        "the kernel looks whether the next frame belongs to this one; the effect is small",
        &format!("sudo {command}"),
    )
    .lasting(format!(
        "`up {command}` below `iface {interface}` in /etc/network/interfaces, or a dispatcher script of NetworkManager"
    ))
}
