//! Installs the packages in a fresh Debian that mmdebstrap makes, runs `tests/packages/fresh.sh`
//! there, and throws that Debian away: 12, with which they are built, then 13.

use crate::{root, step};
use anyhow::{Result, bail};
use std::path::PathBuf;
use std::process::Command;

/// Debian's numbers and names of the releases.
const RELEASES: [(&str, &str); 2] = [("12", "bookworm"), ("13", "trixie")];

/// What that Debian has before our packages come; Debian 13 has no `useradd` without being told.
const BEFORE: &str = "man-db,passwd";

/// The display of a machine that the tool has written: it homes all axes and runs a program.
const DISPLAY: &str = "tests/linuxcnc/machine/display.py";

/// What the script is told, in this order. `use` comes with network, HAL and processes of its own:
/// other tests have the same ports, and HAL's memory has the same keys everywhere.
const PARTS: [&str; 3] = [
    "chroot \"$1\" bash /packages/fresh.sh install",
    "unshare --net --ipc --pid --fork sh -c 'ip link set lo up && mount -t proc proc \"$1/proc\" && chroot \"$1\" bash /packages/fresh.sh use; result=$?; umount \"$1/proc\"; exit $result' - \"$1\"",
    "chroot \"$1\" bash /packages/fresh.sh purge",
];

/// Installs, uses and removes the packages in each Debian; how many tests passed.
pub fn check(packages: &[PathBuf]) -> Result<usize> {
    let mut passed = 0;
    for (number, release) in RELEASES {
        passed += in_a_fresh(number, release, packages)?;
    }
    Ok(passed)
}

fn in_a_fresh(number: &str, release: &str, packages: &[PathBuf]) -> Result<usize> {
    let mut install = Command::new("mmdebstrap");
    install.args(["--variant=apt", "--include", BEFORE]);
    let mut hook = |text: String| {
        install.arg(format!("--customize-hook={text}"));
    };
    hook("mkdir -p \"$1/packages\"".to_owned());
    let mut files: Vec<PathBuf> = packages.to_vec();
    files.push(root().join("tests/packages/fresh.sh"));
    hook(copy_in(&files, "/packages"));
    let mill = root().join("host/examples/mill");
    hook(copy_in(&[mill], "/packages"));
    hook(copy_in(&[root().join(DISPLAY)], "/packages/mill"));
    for part in PARTS {
        hook(part.to_owned());
    }
    // The Debian is of no use afterwards.
    install.args([release, "/dev/null"]);
    let log = format!("test-packages-{number}");
    let printed = step::run_quietly(
        &log,
        &format!("install, use and purge the packages in a fresh Debian {number}"),
        "4 min",
        &mut install,
    )?;
    let passed = printed.lines().filter(|line| line.starts_with("PASS "));
    let passed: Vec<&str> = passed.collect();
    for line in &passed {
        println!("    {line}");
    }
    match passed.is_empty() {
        true => bail!("nothing was tested; see target/logs/{log}.log"),
        false => Ok(passed.len()),
    }
}

/// mmdebstrap's own hook that copies files into the new Debian.
fn copy_in(files: &[PathBuf], to: &str) -> String {
    let files: Vec<String> = files
        .iter()
        .map(|file| file.display().to_string())
        .collect();
    format!("copy-in {} {to}", files.join(" "))
}
