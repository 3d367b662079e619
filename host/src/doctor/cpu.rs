//! What keeps a processor from the servo thread.

use super::system::{System, mask, numbers};
use crate::finding::Finding;
use std::collections::BTreeSet;

const CPUS: &str = "sys/devices/system/cpu";
/// From this number of processors on LinuxCNC's manual has one of them isolated.
const ENOUGH: usize = 4;

/// All checks of this module.
pub fn examine(system: &System<'_>) -> Vec<Finding> {
    let read = |name: &str| system.read(&format!("{CPUS}/{name}")).unwrap_or_default();
    let (online, isolated) = (numbers(&read("online")), numbers(&read("isolated")));
    vec![
        governor(system),
        isolation(&online, &isolated),
        threads(system, &isolated),
        interrupts(system, &isolated),
        throttling(system),
        clock(system),
        balance(system),
        virtual_machine(system),
        bios(system),
    ]
}

/// The processor that LinuxCNC takes for its threads: the highest of the isolated ones.
pub fn isolated(system: &System<'_>) -> Option<u32> {
    let isolated = system.read(&format!("{CPUS}/isolated"))?;
    numbers(&isolated).last().copied()
}

/// The same if none is isolated: the one that was chosen for it, or the highest there is.
pub fn linuxcncs(system: &System<'_>) -> u32 {
    let chosen = (system.variable)("RTAPI_CPU_NUMBER").and_then(|cpu| cpu.parse().ok());
    let online = || {
        let online = system.read(&format!("{CPUS}/online")).unwrap_or_default();
        numbers(&online).last().copied()
    };
    chosen
        .or_else(|| isolated(system))
        .or_else(online)
        .unwrap_or_default()
}

fn list(of: &BTreeSet<u32>) -> String {
    let all: Vec<_> = of.iter().map(u32::to_string).collect();
    all.join(",")
}

fn governor(system: &System<'_>) -> Finding {
    let check = "CPU frequency";
    let all: BTreeSet<String> = system
        .list(CPUS)
        .iter()
        .filter_map(|cpu| system.read(&format!("{CPUS}/{cpu}/cpufreq/scaling_governor")))
        .collect();
    let names: Vec<_> = all.iter().map(String::as_str).collect();
    match names[..] {
        [] => Finding::skipped(
            check,
            "does not change",
            "the kernel does not control it",
            "",
        ),
        ["performance"] => Finding::good(check, "performance"),
        _ => Finding::note(
            check,
            names.join(", "),
            "a processor that has slowed down is late with the next period",
            "echo performance | sudo tee /sys/devices/system/cpu/cpu*/cpufreq/scaling_governor",
        )
        .lasting("sudo ferrocnc doctor --fix"),
    }
}

fn isolation(online: &BTreeSet<u32>, isolated: &BTreeSet<u32>) -> Finding {
    let check = "isolated CPU";
    if !isolated.is_empty() {
        return Finding::good(check, list(isolated));
    }
    let count = online.len();
    if count < ENOUGH {
        return Finding::good(check, format!("none of {count}"));
    }
    let last = online.last().copied().unwrap_or_default();
    Finding::note(
        check,
        format!("none of {count}"),
        "other programs run on the servo thread's processor",
        "no way without a restart",
    )
    .lasting(format!(
        "isolcpus={last} in GRUB_CMDLINE_LINUX_DEFAULT of /etc/default/grub, then sudo update-grub; LinuxCNC takes the highest"
    ))
}

fn threads(system: &System<'_>, isolated: &BTreeSet<u32>) -> Finding {
    let check = "hyper-threads";
    if system
        .read(&format!("{CPUS}/smt/active"))
        .is_none_or(|it| it != "1")
    {
        return Finding::good(check, "none");
    }
    let siblings = |cpu: &u32| {
        let path = format!("{CPUS}/cpu{cpu}/topology/thread_siblings_list");
        numbers(&system.read(&path).unwrap_or_default())
    };
    if !isolated.is_empty() && isolated.iter().all(|cpu| siblings(cpu).is_subset(isolated)) {
        return Finding::good(check, "on, both of each isolated core");
    }
    Finding::note(
        check,
        "on",
        "the other thread of its core takes the servo thread's time",
        "echo off | sudo tee /sys/devices/system/cpu/smt/control",
    )
    .lasting("switch them off in the BIOS, or nosmt in the kernel's command line")
}

fn interrupts(system: &System<'_>, isolated: &BTreeSet<u32>) -> Finding {
    let check = "interrupts";
    let Some(default) = system.read("proc/irq/default_smp_affinity") else {
        return Finding::skipped(check, "not known", "/proc/irq is not there", "");
    };
    let shared: BTreeSet<u32> = mask(&default).intersection(isolated).copied().collect();
    if shared.is_empty() {
        return Finding::good(check, format!("to {}", list(&mask(&default))));
    }
    let kept = mask(&default).difference(isolated).copied().collect();
    Finding::note(
        check,
        format!("also to CPU {}", list(&shared)),
        "devices interrupt the isolated processor",
        "no way without a restart for those that are in use",
    )
    .lasting(format!(
        "irqaffinity={} in the kernel's command line",
        list(&kept)
    ))
}

fn throttling(system: &System<'_>) -> Finding {
    let check = "real-time throttling";
    match system
        .read("proc/sys/kernel/sched_rt_runtime_us")
        .as_deref()
    {
        Some("-1") => Finding::good(check, "off"),
        None => Finding::skipped(check, "not known", "this kernel does not say", ""),
        Some(runtime) => Finding::note(
            check,
            format!("{runtime} us of every second"),
            "a servo thread that takes more is stopped for the rest",
            "sudo sysctl -w kernel.sched_rt_runtime_us=-1",
        )
        .lasting("sudo ferrocnc doctor --fix"),
    }
}

fn clock(system: &System<'_>) -> Finding {
    let check = "clock";
    let path = "sys/devices/system/clocksource/clocksource0/current_clocksource";
    match system.read(path).as_deref() {
        Some(good @ ("tsc" | "arch_sys_counter" | "kvm-clock")) => Finding::good(check, good),
        None => Finding::skipped(check, "not known", "this kernel does not say", ""),
        Some(slow) => Finding::bad(
            check,
            slow,
            "each look at it takes microseconds",
            "see with `dmesg | grep -i tsc` why the kernel does not use the processor's own",
        )
        .lasting("remove clocksource= from the kernel's command line; a newer BIOS"),
    }
}

fn balance(system: &System<'_>) -> Finding {
    let check = "irqbalance";
    match system.runs("irqbalance") {
        false => Finding::good(check, "does not run"),
        true => Finding::note(
            check,
            "runs",
            "it moves the port's interrupts from processor to processor",
            "sudo systemctl stop irqbalance",
        )
        .lasting("sudo systemctl disable irqbalance"),
    }
}

fn virtual_machine(system: &System<'_>) -> Finding {
    let check = "virtual machine";
    let flags = system.read("proc/cpuinfo").unwrap_or_default();
    let inside = flags
        .lines()
        .any(|line| line.starts_with("flags") && line.split(' ').any(|flag| flag == "hypervisor"));
    match inside {
        false => Finding::good(check, "no"),
        true => Finding::bad(
            check,
            "yes",
            "its host takes the processor away at any time",
            "a computer of its own",
        ),
    }
}

/// What the BIOS does is not to be read, but for two settings: whether the processor may run faster
/// than its clock, and whether its idle states are there.
fn bios(system: &System<'_>) -> Finding {
    let check = "BIOS";
    let version = ["bios_vendor", "bios_version", "bios_date"];
    let version = version.map(|name| system.read(&format!("sys/class/dmi/id/{name}")));
    let version: Vec<String> = version.into_iter().flatten().collect();
    let turbo = match (
        system
            .read(&format!("{CPUS}/intel_pstate/no_turbo"))
            .as_deref(),
        system.read(&format!("{CPUS}/cpufreq/boost")).as_deref(),
    ) {
        (Some("0"), _) | (None, Some("1")) => Some(true),
        (Some("1"), _) | (None, Some("0")) => Some(false),
        _ => None,
    };
    let mut fact = match version.is_empty() {
        true => "not known".to_owned(),
        false => version.join(" "),
    };
    fact += match turbo {
        Some(true) => ", turbo on",
        Some(false) => ", turbo off",
        None => "",
    };
    let remedy = "switch turbo, C-states, power saving and legacy USB off there; sudo hwlatdetect --duration=60 shows what the BIOS takes: 20 us is much";
    match turbo {
        Some(true) => Finding::note(
            check,
            fact,
            "the clock of a processor changes with its load, and what else the BIOS does is not to be read from here",
            remedy,
        )
        .lasting("the BIOS keeps it"),
        Some(false) | None => Finding::skipped(
            check,
            fact,
            "its power saving and its interrupts (SMI) are not to be read from here",
            remedy,
        ),
    }
}
