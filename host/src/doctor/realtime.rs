//! The realtime module: is it there, may LinuxCNC read it, is it for this processor, and of which
//! release is it?

use super::system::System;
use crate::finding::Finding;

/// Where `loadrt` finds the module.
const MODULE: &str = "usr/lib/linuxcnc/modules/ferrocnc.so";
/// In front of the release in a module's file.
const MARK: &[u8] = crate::module::VERSION_MARK.as_bytes();
/// Bits of a file's mode: everyone may read it.
const READABLE: u32 = 0o004;
/// ELF's classes.
const CLASSES: [(u8, u32); 2] = [(1, 32), (2, 64)];
/// ELF's machine of this program's processor; 0 if it is not known.
const MACHINE: u16 = match () {
    () if cfg!(target_arch = "x86_64") => 62,
    () if cfg!(target_arch = "aarch64") => 183,
    () if cfg!(target_arch = "arm") => 40,
    () if cfg!(target_arch = "riscv64") => 243,
    () => 0,
};

/// All checks of this module.
pub fn examine(system: &System<'_>) -> Vec<Finding> {
    vec![module(system), release(system, env!("CARGO_PKG_VERSION"))]
}

fn module(system: &System<'_>) -> Finding {
    let check = "module";
    if !system.exists(MODULE) {
        return Finding::bad(
            check,
            format!("/{MODULE} is not there"),
            "`loadrt ferrocnc` finds nothing",
            "sudo apt install ferrocnc-linuxcnc, or sudo ferrocnc install-module (docs/guide/first-machine.md)",
        );
    }
    let Some(head) = system.bytes::<20>(MODULE) else {
        return Finding::bad(
            check,
            format!("/{MODULE} cannot be read"),
            "a link that leads nowhere, or a file of another user",
            "build it again, and see where the link leads: ls -l",
        );
    };
    let machine = u16::from_le_bytes([head[18], head[19]]);
    if head[..4] != *b"\x7fELF" || (MACHINE != 0 && machine != MACHINE) {
        return Finding::bad(
            check,
            format!("/{MODULE} is for another processor"),
            "LinuxCNC cannot load it",
            "build it on this computer",
        );
    }
    let class = CLASSES.iter().find(|(code, _)| *code == head[4]);
    let bits = class.map_or(0, |(_, bits)| *bits);
    if bits != usize::BITS {
        return Finding::bad(
            check,
            format!(
                "/{MODULE} is of {bits} bits, this system of {}",
                usize::BITS
            ),
            "LinuxCNC cannot load it",
            "build it on this computer, or install the package of its architecture",
        );
    }
    if system.mode(MODULE).is_some_and(|mode| mode & READABLE == 0) {
        return Finding::bad(
            check,
            format!("/{MODULE} is not readable by all"),
            "`loadrt ferrocnc` of another user finds nothing",
            &format!("sudo chmod a+r /{MODULE}"),
        );
    }
    Finding::good(check, format!("/{MODULE}"))
}

fn release(system: &System<'_>, tool: &str) -> Finding {
    let check = "release of the module";
    let remedy = "sudo ferrocnc install-module, or packages of one release";
    let Some(bytes) = system.all(MODULE) else {
        return Finding::skipped(check, "not known", "there is no module to read", remedy);
    };
    let found = bytes
        .windows(MARK.len())
        .position(|part| part == MARK)
        .and_then(|at| {
            bytes
                .get(at + MARK.len()..)?
                .split(|byte| *byte == 0)
                .next()
        })
        .and_then(|version| std::str::from_utf8(version).ok());
    match found {
        Some(version) if version == tool => {
            Finding::good(check, format!("{version}, module and tool"))
        }
        Some(version) => Finding::note(
            check,
            format!("module {version}, tool {tool}"),
            "they are of two releases",
            remedy,
        ),
        None => Finding::note(
            check,
            format!("the module does not say, tool {tool}"),
            "it is older than the tool, or no module of FerroCNC",
            remedy,
        ),
    }
}
