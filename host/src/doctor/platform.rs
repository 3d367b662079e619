//! Kernel, LinuxCNC and its rights.

use super::system::{Rights, System};
use crate::finding::Finding;

/// Where LinuxCNC's packages have what runs in real time.
const RTAPI_APP: &str = "usr/bin/rtapi_app";
/// What LinuxCNC's package asks for each user, bytes.
const LOCKED: u64 = 20_480 * 1024;
/// All checks of this module.
pub fn examine(system: &System<'_>) -> Vec<Finding> {
    vec![
        kernel(system),
        linuxcnc(system),
        rights(system),
        forced(system),
        locked(system),
    ]
}

fn kernel(system: &System<'_>) -> Finding {
    let check = "real-time kernel";
    let version = system.read("proc/version").unwrap_or_default();
    let realtime = system
        .read("sys/kernel/realtime")
        .is_some_and(|it| it == "1")
        || version.contains("PREEMPT_RT")
        || version.contains("PREEMPT RT");
    let release = system.read("proc/sys/kernel/osrelease").unwrap_or_default();
    if realtime {
        return Finding::good(check, release);
    }
    let package = match std::env::consts::ARCH {
        "aarch64" => "linux-image-rt-arm64",
        _ => "linux-image-rt-amd64",
    };
    Finding::bad(
        check,
        format!("{release} is none"),
        "another program can hold the servo thread up for milliseconds",
        &format!("sudo apt install {package}, and start the computer with it"),
    )
}

/// The version of an installed package, from dpkg's own list.
pub(super) fn installed(system: &System<'_>, name: &str) -> Option<String> {
    let list = system.read("var/lib/dpkg/status")?;
    let package = list.split("\n\n").find(|package| {
        let mut lines = package.lines();
        lines.next() == Some(&format!("Package: {name}"))
            && package.contains("\nStatus: install ok installed")
    })?;
    let line = package
        .lines()
        .find_map(|line| line.strip_prefix("Version: "))?;
    Some(line.to_owned())
}

fn linuxcnc(system: &System<'_>) -> Finding {
    let check = "LinuxCNC";
    let Some(version) = installed(system, "linuxcnc-uspace") else {
        return Finding::note(
            check,
            "no package linuxcnc-uspace",
            "a run-in-place build is not looked at",
            "sudo apt install linuxcnc-uspace, or nothing if you build LinuxCNC yourself",
        );
    };
    let plain = version
        .split_once(':')
        .map_or(version.as_str(), |(_, rest)| rest);
    let mut parts = plain
        .split(|c: char| !c.is_ascii_digit())
        .map(str::parse::<u32>);
    let number = (parts.next(), parts.next());
    match number {
        (Some(Ok(major)), Some(Ok(minor))) if (major, minor) >= (2, 9) => {
            Finding::good(check, version)
        }
        _ => Finding::bad(
            check,
            version,
            "the module is for LinuxCNC 2.9",
            "install the package of Debian 12 or later, or the project's own",
        ),
    }
}

fn rights(system: &System<'_>) -> Finding {
    let check = "rights of rtapi_app";
    if !system.exists(RTAPI_APP) {
        return Finding::skipped(
            check,
            "not installed by a package",
            "a run-in-place build has its own",
            "in a run-in-place build: sudo make setuid",
        );
    }
    match system.rights(RTAPI_APP) {
        Rights::Root => return Finding::good(check, "root's"),
        Rights::Capabilities => return Finding::good(check, "as capabilities"),
        Rights::User => {}
    }
    Finding::bad(
        check,
        "those of the user",
        "without them the servo thread has no real-time priority and its memory may be swapped out",
        "sudo chmod u+s /usr/bin/rtapi_app, or reinstall linuxcnc-uspace",
    )
}

fn forced(system: &System<'_>) -> Finding {
    let check = "forced real time";
    match (system.variable)("LINUXCNC_FORCE_REALTIME").filter(|value| !value.is_empty()) {
        None => Finding::good(check, "no"),
        Some(value) => Finding::note(
            check,
            format!("LINUXCNC_FORCE_REALTIME={value}"),
            "LinuxCNC does not tell of a kernel without real time then",
            "unset LINUXCNC_FORCE_REALTIME",
        )
        .lasting("remove the line from ~/.profile or ~/.bashrc"),
    }
}

fn locked(system: &System<'_>) -> Finding {
    let check = "locked memory";
    let limits = system.read("proc/self/limits").unwrap_or_default();
    let limit = limits.lines().find_map(|line| {
        let values = line.strip_prefix("Max locked memory")?;
        Some(values.split_whitespace().next()?.to_owned())
    });
    match limit {
        None => Finding::skipped(check, "not known", "/proc/self/limits does not say", ""),
        Some(limit)
            if limit == "unlimited" || limit.parse::<u64>().is_ok_and(|it| it >= LOCKED) =>
        {
            Finding::good(check, limit)
        }
        Some(limit) => Finding::note(
            check,
            format!("{limit} bytes"),
            "HAL of a user without rights needs 20 MiB; rtapi_app with root's rights does not",
            "ulimit -l 20480",
        )
        .lasting("`* - memlock 20480` in /etc/security/limits.d/ferrocnc.conf, and a new login"),
    }
}
