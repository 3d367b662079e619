//! Checks what is in the packages: the files that must be there, nothing outside the folders of
//! Debian, no scripts, no path of this computer.

use super::{cargo_home, samples};
use crate::{root, setup, target, tree};
use anyhow::{Context, Result, bail};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

/// Beginnings of all paths.
const PLACES: [&str; 4] = [
    "./usr/bin/",
    "./usr/lib/linuxcnc/modules/",
    "./usr/lib/udev/rules.d/",
    "./usr/share/",
];

/// What a package must have: a part of its dependencies, and files with their modes.
struct Wanted {
    package: &'static str,
    depends: &'static str,
    files: &'static [(&'static str, &'static str)],
}

const PLAIN: &str = "-rw-r--r--";
const PROGRAM: &str = "-rwxr-xr-x";

const WANTED: [Wanted; 4] = [
    Wanted {
        package: "ferrocnc",
        depends: "libc6 (>= ",
        files: &[
            (PROGRAM, "./usr/bin/ferrocnc"),
            (PLAIN, "./usr/share/man/man1/ferrocnc.1.gz"),
            (PLAIN, "./usr/share/man/man1/ferrocnc-job-send.1.gz"),
            (PLAIN, "./usr/share/bash-completion/completions/ferrocnc"),
            (PLAIN, "./usr/share/zsh/vendor-completions/_ferrocnc"),
            (PLAIN, "./usr/share/fish/vendor_completions.d/ferrocnc.fish"),
            (PLAIN, "./usr/lib/udev/rules.d/60-ferrocnc-jtag.rules"),
            (PLAIN, "./usr/share/ferrocnc/boards/mill6.toml"),
            (
                PLAIN,
                "./usr/share/ferrocnc/boards/platforms/5a-75b-8.0.toml",
            ),
            (PLAIN, "./usr/share/doc/ferrocnc/copyright"),
        ],
    },
    Wanted {
        package: "ferrocnc-linuxcnc",
        depends: "linuxcnc-uspace (>= 2.9.0~)",
        files: &[
            (PLAIN, "./usr/lib/linuxcnc/modules/ferrocnc.so"),
            (PLAIN, "./usr/share/man/man9/ferrocnc.9.gz"),
            (PROGRAM, "./usr/bin/ferrocnc-twin"),
            (PLAIN, "./usr/share/man/man1/ferrocnc-twin.1.gz"),
            (PLAIN, "./usr/share/doc/ferrocnc-linuxcnc/copyright"),
        ],
    },
    Wanted {
        package: "ferrocnc-sim",
        depends: "libc6 (>= ",
        files: &[
            (PROGRAM, "./usr/bin/ferrocnc-sim"),
            (PLAIN, "./usr/share/man/man1/ferrocnc-sim.1.gz"),
            (
                PLAIN,
                "./usr/share/doc/ferrocnc-sim/examples/plant.example.toml",
            ),
            (PLAIN, "./usr/share/doc/ferrocnc-sim/copyright"),
        ],
    },
    Wanted {
        package: "ferrocnc-images",
        depends: "ferrocnc",
        files: &[(PLAIN, "./usr/share/ferrocnc/images/SHA256SUMS")],
    },
];

/// Checks each package.
pub fn check(packages: &[PathBuf]) -> Result<()> {
    for package in packages {
        one(package).with_context(|| package.display().to_string())?;
    }
    Ok(())
}

fn one(package: &Path) -> Result<()> {
    let field = |name: &str| dpkg(&["--field"], package, &[name]);
    let name = field("Package")?.trim().to_owned();
    let wanted = WANTED.iter().find(|wanted| wanted.package == name);
    let wanted = wanted.with_context(|| format!("nothing is known of {name}"))?;
    let depends = field("Depends")?;
    if !depends.contains(wanted.depends) {
        bail!("it depends on {depends}, not on {}", wanted.depends);
    }
    judge(&dpkg(&["--contents"], package, &[])?, wanted.files)?;
    // A package with scripts or files in /etc could leave something behind.
    let folder = target("deb/unpacked");
    let _ = fs::remove_dir_all(&folder);
    let at = folder.display().to_string();
    dpkg(&["--raw-extract"], package, &[&at])?;
    for file in tree::files(&folder.join("DEBIAN"))? {
        if !["control", "md5sums"].contains(&&*file.to_string_lossy()) {
            bail!("it has {}, which is run or kept", file.display());
        }
    }
    if name == "ferrocnc-linuxcnc" {
        samples::check(&folder.join("usr/share/linuxcnc/aux_examples"))?;
    }
    for place in [root().to_owned(), cargo_home()] {
        if let Some(file) = holding(&folder, &place)? {
            bail!("{} has the path {}", file.display(), place.display());
        }
    }
    fs::remove_dir_all(&folder).context("deb/unpacked")
}

/// What `dpkg-deb` prints of a package.
pub fn dpkg(what: &[&str], package: &Path, more: &[&str]) -> Result<String> {
    let mut dpkg = Command::new("dpkg-deb");
    dpkg.args(what).arg(package).args(more);
    setup::output(&mut dpkg).with_context(|| format!("dpkg-deb {what:?} failed"))
}

/// Judges the list that `dpkg-deb --contents` prints.
fn judge(list: &str, wanted: &[(&str, &str)]) -> Result<()> {
    let mut files = Vec::new();
    for line in list.lines() {
        let mut words = line.split_whitespace();
        let (mode, owner) = (words.next(), words.next());
        // cargo-deb writes numbers alone.
        let (Some(mode), Some("root/root" | "0/0"), Some(path)) = (mode, owner, words.nth(3))
        else {
            bail!("not root's, or not understood: {line}");
        };
        if mode.starts_with('d') {
            continue;
        }
        if !PLACES.iter().any(|place| path.starts_with(place)) {
            bail!("{path} lies where no file of ours belongs");
        }
        files.push((mode, path));
    }
    let missing = wanted.iter().find(|file| !files.contains(file));
    match missing {
        Some((mode, path)) => bail!("there is no {path} with the mode {mode}"),
        None => Ok(()),
    }
}

/// The first file below a folder with this path in it.
fn holding(folder: &Path, path: &Path) -> Result<Option<PathBuf>> {
    let path = path.as_os_str().as_encoded_bytes();
    for file in tree::files(folder)? {
        let bytes = fs::read(folder.join(&file))?;
        if bytes.windows(path.len()).any(|part| part == path) {
            return Ok(Some(file));
        }
    }
    Ok(None)
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIST: &str = "\
drwxr-xr-x root/root 0 2026-01-01 00:00 ./usr/
-rwxr-xr-x 0/0 9 2026-01-01 00:00 ./usr/bin/ferrocnc
-rw-r--r-- root/root 9 2026-01-01 00:00 ./usr/share/a
";

    #[test]
    fn a_file_that_is_missing_misplaced_or_of_another_user_is_named() {
        assert!(judge(LIST, &[(PROGRAM, "./usr/bin/ferrocnc")]).is_ok());
        let said =
            |list: &str, mode, path| format!("{:#}", judge(list, &[(mode, path)]).unwrap_err());
        assert!(said(LIST, PLAIN, "./usr/bin/ferrocnc").contains("with the mode -rw-r--r--"));
        assert!(said(LIST, PLAIN, "./usr/share/b").contains("./usr/share/b"));
        let elsewhere = LIST.replace("share/a", "local/a");
        assert!(said(&elsewhere, PLAIN, "./usr/share/a").contains("./usr/local/a lies"));
        let others = LIST.replace("root/root 9", "a/a 9");
        assert!(said(&others, PLAIN, "./usr/share/a").contains("not root's"));
    }

    #[test]
    fn a_path_is_found_in_a_program() {
        let folder = target("tmp/holding");
        fs::create_dir_all(folder.join("a")).unwrap();
        fs::write(folder.join("a/b"), b"\0\x7f/home/x/y\xff").unwrap();
        let found = |path: &str| holding(&folder, Path::new(path)).unwrap();
        assert_eq!(found("/home/x"), Some(PathBuf::from("a/b")));
        assert_eq!(found("/home/z"), None);
        fs::remove_dir_all(&folder).unwrap();
    }
}
