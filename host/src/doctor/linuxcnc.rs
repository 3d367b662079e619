//! LinuxCNC's real-time part: what an earlier run left behind, which build runs, on which
//! processor.

use super::system::{System, numbers};
use crate::finding::Finding;

/// Keys of the shared memory of RTAPI and HAL.
const KEYS: [u32; 3] = [0x4841_4c32, 0x4848_4c34, 0x64];
/// Where packages have their programs.
const PACKAGED: &str = "/usr";

/// All checks of this module.
pub fn examine(system: &System<'_>) -> Vec<Finding> {
    vec![stale(system), build(system), processor(system)]
}

fn stale(system: &System<'_>) -> Finding {
    let check = "HAL of an earlier run";
    if system.runs("rtapi_app") {
        return Finding::good(check, "LinuxCNC runs now");
    }
    let table = system.read("proc/sysvipc/shm").unwrap_or_default();
    let left: Vec<String> = table
        .lines()
        .filter_map(|line| line.split_whitespace().next()?.parse::<u32>().ok())
        .filter(|key| KEYS.contains(key))
        .map(|key| format!("{key:#x}"))
        .collect();
    if left.is_empty() {
        return Finding::good(check, "none");
    }
    Finding::note(
        check,
        format!("shared memory {}", left.join(", ")),
        "LinuxCNC did not end in order; the next one may refuse to start",
        &format!("halrun -U; if it stays: ipcrm -M {}", left.join(" -M ")),
    )
}

/// The folder of a run-in-place build, if its programs come first.
fn in_place(system: &System<'_>) -> Option<String> {
    let path = (system.variable)("PATH")?;
    let first = path
        .split(':')
        .find(|folder| system.exists(&format!("{}/rtapi_app", folder.trim_start_matches('/'))))?;
    let folder = first.strip_suffix("/bin")?;
    (!folder.starts_with(PACKAGED)).then(|| folder.to_owned())
}

fn build(system: &System<'_>) -> Finding {
    let check = "LinuxCNC's build";
    let Some(folder) = in_place(system) else {
        return Finding::good(check, "the package's");
    };
    let module = format!("{folder}/rtlib/ferrocnc.so");
    if system.exists(module.trim_start_matches('/')) {
        return Finding::note(
            check,
            format!("the one in {folder}"),
            "it loads its own ferrocnc.so, not the package's, and may have an older one",
            &format!("ferrocnc install-module --rip {folder}"),
        );
    }
    Finding::bad(
        check,
        format!("the one in {folder}"),
        "it has no ferrocnc.so: `loadrt ferrocnc` finds nothing",
        &format!("ferrocnc install-module --rip {folder}"),
    )
}

fn processor(system: &System<'_>) -> Finding {
    let check = "LinuxCNC's CPU";
    let isolated = system.read("sys/devices/system/cpu/isolated");
    let isolated = numbers(&isolated.unwrap_or_default());
    let chosen = (system.variable)("RTAPI_CPU_NUMBER").filter(|value| !value.is_empty());
    match chosen {
        None => Finding::good(check, "the highest isolated one"),
        Some(cpu) if cpu.parse().is_ok_and(|cpu| isolated.contains(&cpu)) => {
            Finding::good(check, format!("{cpu}, isolated"))
        }
        Some(cpu) => Finding::note(
            check,
            format!("RTAPI_CPU_NUMBER={cpu}"),
            "other programs run on it, because it is not isolated",
            "unset RTAPI_CPU_NUMBER",
        )
        .lasting("remove the line from ~/.profile or ~/.bashrc, or isolate that CPU"),
    }
}
