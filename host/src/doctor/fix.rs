//! What the doctor repairs itself: values of the kernel that keep a processor from the servo
//! thread. A file of `tmpfiles.d` makes each of them at every start of the computer, and says what
//! they were before, so it is what undoes them, too. The port is repaired by [`crate::net`].

use super::kernel::{ASPM, selected};
use super::system::System;
use std::fs;
use std::io;

const FOLDER: &str = "etc/tmpfiles.d";
const BEFORE: &str = "# before: ";

/// A file of the kernel that gets another value.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Value {
    /// The file, below the root.
    pub path: String,
    /// What is in it now.
    pub now: String,
    /// What it gets.
    pub wanted: &'static str,
}

/// One thing to repair.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Fix {
    /// The doctor's check that finds it.
    pub check: &'static str,
    name: &'static str,
    /// What is changed.
    pub values: Vec<Value>,
}

/// What can be repaired here.
pub fn fixes(system: &System<'_>) -> Vec<Fix> {
    let cpus = "sys/devices/system/cpu";
    let governors = system.list(cpus).into_iter();
    let governors = governors.map(|cpu| format!("{cpus}/{cpu}/cpufreq/scaling_governor"));
    let all = [
        (
            "CPU frequency",
            "frequency",
            governors.collect(),
            "performance",
        ),
        (
            "real-time throttling",
            "throttling",
            vec!["proc/sys/kernel/sched_rt_runtime_us".to_owned()],
            "-1",
        ),
        (
            "power of PCIe",
            "pcie",
            vec![ASPM.to_owned()],
            "performance",
        ),
    ];
    let fixes = all.into_iter().map(|(check, name, paths, wanted)| {
        let values = paths.into_iter().filter_map(|path| {
            let text = system.read(&path)?;
            // Some files list all values, with the one that holds in brackets.
            let now = selected(&text).map_or(text.clone(), str::to_owned);
            (now != wanted).then_some(Value { path, now, wanted })
        });
        Fix {
            check,
            name,
            values: values.collect(),
        }
    });
    fixes.filter(|fix| !fix.values.is_empty()).collect()
}

impl Fix {
    /// The file that makes it last.
    pub fn path(&self) -> String {
        format!("{FOLDER}/ferrocnc-{}.conf", self.name)
    }

    /// What is in it. What an earlier one says of the values before it is kept.
    pub fn text(&self, earlier: Option<&str>) -> String {
        let mut text =
            "# Written by `ferrocnc doctor --fix`; `ferrocnc doctor --undo` takes it away.\n"
                .to_owned();
        let earlier: Vec<_> = earlier.into_iter().flat_map(before).collect();
        let known = |path: &str| earlier.iter().any(|(known, _)| *known == path);
        let news = self.values.iter().filter(|value| !known(&value.path));
        let news = news.map(|value| (value.path.as_str(), value.now.as_str()));
        let all: Vec<_> = earlier.iter().copied().chain(news).collect();
        for (path, value) in &all {
            text += &format!("{BEFORE}/{path} {value}\n");
        }
        let wanted = self.values.first().map_or("", |value| value.wanted);
        for (path, _) in &all {
            text += &format!("w /{path} - - - - {wanted}\n");
        }
        text
    }

    /// Repairs it, now and for every start. What fails is undone.
    pub fn apply(&self, system: &System<'_>) -> Result<(), String> {
        let path = self.path();
        let earlier = system.read(&path);
        let text = self.text(earlier.as_deref());
        fs::write(system.root.join(&path), text)
            .map_err(|error| format!("cannot write /{path}: {error}"))?;
        for value in &self.values {
            if let Err(error) = fs::write(system.root.join(&value.path), value.wanted) {
                let why = format!("cannot write {} to /{}: {error}", value.wanted, value.path);
                return Err(match undo_file(system, &path) {
                    Ok(()) => format!("{why}; all of this repair is undone"),
                    Err(left) => format!("{why}; {left}"),
                });
            }
        }
        Ok(())
    }
}

/// The files that `--fix` has written.
pub fn written(system: &System<'_>) -> Vec<String> {
    let ours = ["frequency", "throttling", "pcie"].map(|name| format!("ferrocnc-{name}.conf"));
    let names = system.list(FOLDER).into_iter();
    let names = names.filter(|name| ours.contains(name));
    names.map(|name| format!("{FOLDER}/{name}")).collect()
}

/// Takes one back: the values are as before, the file goes.
pub fn undo_file(system: &System<'_>, path: &str) -> Result<(), String> {
    let text = system.read(path).unwrap_or_default();
    let mut failed = Vec::new();
    for (file, value) in before(&text) {
        match fs::write(system.root.join(file), value) {
            // A processor that was switched off since.
            Err(error) if error.kind() != io::ErrorKind::NotFound => {
                failed.push(format!("cannot write {value} to /{file}: {error}"));
            }
            Ok(()) | Err(_) => {}
        }
    }
    if let Err(error) = fs::remove_file(system.root.join(path)) {
        failed.push(format!("cannot remove /{path}: {error}"));
    }
    match failed.is_empty() {
        true => Ok(()),
        false => Err(failed.join("; ")),
    }
}

/// The files of the kernel that a file of ours names, and their values before. It says nothing of
/// others.
pub fn before(text: &str) -> impl Iterator<Item = (&str, &str)> {
    text.lines().filter_map(|line| {
        let (path, value) = line
            .strip_prefix(BEFORE)?
            .trim_start_matches('/')
            .split_once(' ')?;
        let is_kernels =
            path.starts_with("sys/devices/") || path.starts_with("proc/sys/") || path == ASPM;
        (is_kernels && !path.contains("..")).then_some((path, value))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeMap;
    use std::path::{Path, PathBuf};

    const THROTTLING: &str = "proc/sys/kernel/sched_rt_runtime_us";

    fn governor(cpu: u32) -> String {
        format!("sys/devices/system/cpu/cpu{cpu}/cpufreq/scaling_governor")
    }

    /// A computer on which both are wrong, and its files.
    struct Made(PathBuf);

    impl Made {
        fn new(name: &str) -> Self {
            let name = format!("ferrocnc-fix-{name}-{}", std::process::id());
            let made = Made(std::env::temp_dir().join(name));
            let _ = fs::remove_dir_all(&made.0);
            made.file(THROTTLING, "950000");
            made.file(&governor(0), "powersave");
            made.file(&governor(1), "schedutil");
            made.file("etc/tmpfiles.d/other.conf", "w /sys/x - - - - 1\n");
            made
        }

        fn file(&self, path: &str, text: &str) {
            let path = self.0.join(path);
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            fs::write(path, text).unwrap();
        }

        fn system(&self) -> System<'static> {
            System {
                root: self.0.clone(),
                ..System::real()
            }
        }

        fn files(&self) -> BTreeMap<PathBuf, String> {
            fn read(folder: &Path, found: &mut BTreeMap<PathBuf, String>) {
                for entry in fs::read_dir(folder).unwrap() {
                    let path = entry.unwrap().path();
                    match path.is_dir() {
                        true => read(&path, found),
                        false => {
                            found.insert(path.clone(), fs::read_to_string(path).unwrap());
                        }
                    }
                }
            }
            let mut found = BTreeMap::new();
            read(&self.0, &mut found);
            found
        }
    }

    impl Drop for Made {
        fn drop(&mut self) {
            let _ = fs::remove_dir_all(&self.0);
        }
    }

    #[test]
    fn what_is_repaired_lasts_and_is_undone_to_the_values_before() {
        let made = Made::new("both");
        let (system, untouched) = (made.system(), made.files());
        let all = fixes(&system);
        let checks: Vec<_> = all.iter().map(|fix| fix.check).collect();
        assert_eq!(checks, ["CPU frequency", "real-time throttling"]);
        for fix in &all {
            fix.apply(&system).expect("it works");
        }
        assert_eq!(system.read(THROTTLING).as_deref(), Some("-1"));
        assert_eq!(system.read(&governor(1)).as_deref(), Some("performance"));
        let text = system
            .read("etc/tmpfiles.d/ferrocnc-frequency.conf")
            .unwrap();
        for cpu in [0, 1] {
            let line = format!("w /{} - - - - performance", governor(cpu));
            assert!(text.lines().any(|it| it == line), "{text}");
        }
        assert_eq!(fixes(&system), [], "nothing is left to repair");
        assert_eq!(written(&system).len(), 2);
        for path in written(&system) {
            undo_file(&system, &path).expect("it works");
        }
        assert_eq!(made.files(), untouched);
    }

    #[test]
    fn a_value_that_is_one_of_a_list_is_repaired_and_undone_by_its_name() {
        let made = Made::new("list");
        made.file(ASPM, "default performance [powersave] powersupersave");
        let system = made.system();
        let fix = fixes(&system).pop().expect("a repair");
        assert_eq!(
            (fix.check, fix.values[0].now.as_str()),
            ("power of PCIe", "powersave")
        );
        fix.apply(&system).expect("it works");
        assert_eq!(system.read(ASPM).as_deref(), Some("performance"));
        undo_file(&system, &written(&system)[0]).expect("it works");
        assert_eq!(system.read(ASPM).as_deref(), Some("powersave"));
    }

    #[test]
    fn a_second_repair_keeps_the_values_before_the_first() {
        let made = Made::new("twice");
        let (system, untouched) = (made.system(), made.files());
        fixes(&system)[0].apply(&system).expect("it works");
        // Another program has slowed one down again.
        made.file(&governor(0), "conservative");
        fixes(&system)[0].apply(&system).expect("it works");
        let text = system
            .read("etc/tmpfiles.d/ferrocnc-frequency.conf")
            .unwrap();
        assert_eq!(text.matches("\nw /").count(), 2, "{text}");
        undo_file(&system, &written(&system)[0]).expect("it works");
        assert_eq!(made.files(), untouched);
    }

    #[test]
    fn a_repair_that_the_kernel_refuses_is_undone() {
        let made = Made::new("refused");
        let system = made.system();
        let fix = fixes(&system).swap_remove(0);
        // What cannot be written, whatever the rights.
        let refused = made.0.join(governor(1));
        fs::remove_file(&refused).unwrap();
        fs::create_dir(&refused).unwrap();
        let why = fix.apply(&system).expect_err("a folder");
        assert!(why.contains(&governor(1)), "{why}");
        assert_eq!(system.read(&governor(0)).as_deref(), Some("powersave"));
        assert_eq!(written(&system), [""; 0]);
    }

    #[test]
    fn a_file_that_names_others_than_the_kernels_writes_none() {
        let text = "# before: /etc/passwd x\n# before: /sys/devices/../x 1\n# before: nothing\n";
        assert_eq!(before(text).count(), 0);
    }
}
