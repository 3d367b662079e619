//! Where the doctor reads: files below a root, and what programs print. Tests make both up.

use std::collections::BTreeSet;
use std::os::unix::fs::MetadataExt;
use std::path::PathBuf;
use std::process::Command;
use std::time::Duration;

/// Runs a program; what it prints, `None` if it is not there.
pub type Run<'s> = dyn Fn(&str, &[&str]) -> Option<String> + 's;

/// The capabilities of a real-time program: a priority, and memory that stays where it is.
const REALTIME: [&str; 2] = ["cap_sys_nice", "cap_ipc_lock"];

/// With whose rights a program runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Rights {
    /// Root's: the file says so.
    Root,
    /// Those of the user, and what a real-time program needs besides.
    Capabilities,
    /// Those of the user.
    User,
}

/// A computer.
pub struct System<'s> {
    /// `/`, or a made-up one.
    pub root: PathBuf,
    /// The number of its user `root`.
    pub root_uid: u32,
    /// Runs its programs.
    pub run: &'s Run<'s>,
    /// Reads a variable of the environment.
    pub variable: &'s dyn Fn(&str) -> Option<String>,
    /// Lets time go by.
    pub wait: &'s dyn Fn(Duration),
}

impl System<'static> {
    /// This computer.
    pub fn real() -> Self {
        System {
            root: PathBuf::from("/"),
            root_uid: 0,
            run: &|program, arguments| {
                let done = Command::new(program).args(arguments).output().ok()?;
                // ethtool says on stderr what a card does not support.
                let both = [done.stdout, done.stderr].concat();
                Some(String::from_utf8_lossy(&both).into_owned())
            },
            variable: &|name| std::env::var(name).ok(),
            wait: &std::thread::sleep,
        }
    }
}

impl System<'_> {
    /// A file without white space around it; `None` if it cannot be read.
    pub fn read(&self, path: &str) -> Option<String> {
        let bytes = std::fs::read(self.root.join(path)).ok()?;
        Some(String::from_utf8_lossy(&bytes).trim().to_owned())
    }

    /// The first bytes of a file.
    pub fn bytes<const N: usize>(&self, path: &str) -> Option<[u8; N]> {
        let bytes = std::fs::read(self.root.join(path)).ok()?;
        bytes.first_chunk().copied()
    }

    /// All bytes of a file.
    pub fn all(&self, path: &str) -> Option<Vec<u8>> {
        std::fs::read(self.root.join(path)).ok()
    }

    /// The mode of a file, of what a link leads to.
    pub fn mode(&self, path: &str) -> Option<u32> {
        let found = std::fs::metadata(self.root.join(path)).ok()?;
        Some(found.mode())
    }

    /// Is it there?
    pub fn exists(&self, path: &str) -> bool {
        self.root.join(path).symlink_metadata().is_ok()
    }

    /// The names in a folder, sorted; none if there is no such folder.
    pub fn list(&self, path: &str) -> Vec<String> {
        let entries = std::fs::read_dir(self.root.join(path));
        let names = entries.into_iter().flatten().flatten();
        let mut names: Vec<_> = names
            .map(|entry| entry.file_name().to_string_lossy().into_owned())
            .collect();
        names.sort();
        names
    }

    /// Where a link leads, as text.
    pub fn link(&self, path: &str) -> Option<String> {
        let to = std::fs::read_link(self.root.join(path)).ok()?;
        Some(to.to_string_lossy().into_owned())
    }

    /// What a program may that a user may not, if it is a real-time one.
    pub fn rights(&self, program: &str) -> Rights {
        let file = self.root.join(program);
        let found = std::fs::metadata(&file);
        if found.is_ok_and(|it| it.mode() & 0o4000 != 0 && it.uid() == self.root_uid) {
            return Rights::Root;
        }
        let said = self.print("getcap", &[&file.to_string_lossy()]);
        let said = said.unwrap_or_default();
        match REALTIME.iter().all(|capability| said.contains(capability)) {
            true => Rights::Capabilities,
            false => Rights::User,
        }
    }

    /// A process of this name runs.
    pub fn runs(&self, name: &str) -> bool {
        self.list("proc").iter().any(|process| {
            process.bytes().all(|byte| byte.is_ascii_digit())
                && self
                    .read(&format!("proc/{process}/comm"))
                    .is_some_and(|found| found == name)
        })
    }

    /// The program is where root's programs are looked for.
    pub fn has_program(&self, name: &str) -> bool {
        let path = (self.variable)("PATH").unwrap_or_default();
        let mut folders = path.split(':').chain(["/usr/sbin", "/sbin"]);
        folders.any(|folder| {
            let file = format!("{}/{name}", folder.trim_start_matches('/'));
            self.root.join(file).is_file()
        })
    }

    /// What a program prints.
    pub fn print(&self, program: &str, arguments: &[&str]) -> Option<String> {
        (self.run)(program, arguments)
    }
}

/// The numbers of a list like `1,3-5`.
pub fn numbers(list: &str) -> BTreeSet<u32> {
    let mut found = BTreeSet::new();
    for part in list.split(',') {
        let (first, last) = part.split_once('-').unwrap_or((part, part));
        if let (Ok(first), Ok(last)) = (first.trim().parse(), last.trim().parse::<u32>()) {
            found.extend(first..=last.min(4095));
        }
    }
    found
}

/// The numbers of a mask like `00000000,0000000f`.
pub fn mask(text: &str) -> BTreeSet<u32> {
    let digits = text.trim().replace(',', "");
    let bits = digits.chars().rev().enumerate().filter_map(|(at, digit)| {
        let nibble = digit.to_digit(16)?;
        Some(
            (0..4)
                .filter(move |bit| nibble >> bit & 1 != 0)
                .map(move |bit| 4 * at as u32 + bit),
        )
    });
    bits.flatten().collect()
}
