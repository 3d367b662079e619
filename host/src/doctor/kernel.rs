//! What the kernel was told or decides by itself: idle states, power of PCIe, parameters, the
//! driver of the graphics card.

use super::system::System;
use crate::finding::Finding;

/// Where the idle states of a processor are chosen.
const IDLE: &str = "sys/devices/system/cpu/cpuidle/current_driver";
/// Through this a program keeps processors awake; LinuxCNC does.
const AWAKE: &str = "dev/cpu_dma_latency";
/// How the links of PCIe save power.
pub(super) const ASPM: &str = "sys/module/pcie_aspm/parameters/policy";
/// Parameters of which some machines got better and some worse.
const TUNED: [&str; 3] = ["rcu_nocbs", "rcu_nocb_poll", "nohz_full"];
/// Drivers that hold processors up for long.
const GRAPHICS: [&str; 2] = ["nvidia", "fglrx"];

/// All checks of this module.
pub fn examine(system: &System<'_>) -> Vec<Finding> {
    vec![
        idle(system),
        pcie(system),
        parameters(system),
        graphics(system),
    ]
}

fn idle(system: &System<'_>) -> Finding {
    let check = "idle states";
    let driver = system.read(IDLE).unwrap_or_default();
    if driver.is_empty() || driver == "none" {
        return Finding::good(check, "none");
    }
    if system.exists(AWAKE) {
        return Finding::good(
            check,
            format!("{driver}; LinuxCNC keeps them off while it runs"),
        );
    }
    Finding::note(
        check,
        format!("{driver}, and there is no /{AWAKE}"),
        "LinuxCNC cannot keep the processors awake, and one that sleeps wakes up late",
        "no way without a restart",
    )
    .lasting("processor.max_cstate=1 intel_idle.max_cstate=0 in the kernel's command line, if measured better")
}

/// The word in brackets of a file like `default [performance] powersave`.
pub(super) fn selected(text: &str) -> Option<&str> {
    let (_, rest) = text.split_once('[')?;
    Some(rest.split_once(']')?.0)
}

fn pcie(system: &System<'_>) -> Finding {
    let check = "power of PCIe";
    let text = system.read(ASPM);
    match text.as_deref().and_then(selected) {
        None => Finding::good(check, "not controlled by the kernel"),
        Some("performance") => Finding::good(check, "performance"),
        Some(policy) => Finding::note(
            check,
            policy,
            "the link to the card may sleep between frames, and wakes up late",
            "echo performance | sudo tee /sys/module/pcie_aspm/parameters/policy",
        )
        .lasting("sudo ferrocnc doctor --fix, or pcie_aspm=off in the kernel's command line"),
    }
}

fn parameters(system: &System<'_>) -> Finding {
    let line = system.read("proc/cmdline").unwrap_or_default();
    let found: Vec<_> = line
        .split_whitespace()
        .filter(|word| {
            let name = word.split_once('=').map_or(*word, |(name, _)| name);
            TUNED.contains(&name)
        })
        .collect();
    // A fact for the report: some machines got better with them, some worse.
    Finding::good(
        "tuned parameters",
        match found.is_empty() {
            true => "none".to_owned(),
            false => found.join(" "),
        },
    )
}

fn graphics(system: &System<'_>) -> Finding {
    let check = "graphics driver";
    let modules = system.read("proc/modules").unwrap_or_default();
    let loaded = |name: &&str| {
        modules
            .lines()
            .any(|line| line.split(' ').next() == Some(name))
    };
    match GRAPHICS.iter().copied().find(loaded) {
        None => Finding::good(check, "none that is known to disturb"),
        Some(name) => Finding::note(
            check,
            name,
            "users report that it holds processors up for hundreds of microseconds",
            "sudo apt purge \"*nvidia*\", and use the free driver or the graphics of the processor",
        ),
    }
}
