//! `tests/mutants.toml`: the areas, and the survivors that are explained.

use anyhow::{Context, Result, bail};
use core::fmt;
use serde::Deserialize;
use std::path::Path;

/// The file.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub struct List {
    area: Vec<Area>,
    #[serde(default)]
    explained: Vec<Explained>,
}

/// Files, and the tests that answer for them.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Area {
    /// What it is called on the command line.
    pub name: String,
    /// What it is about.
    pub what: String,
    /// An honest guess on two idle cores.
    pub minutes: u32,
    /// Rust: the package with the files.
    pub package: Option<String>,
    /// Rust: the files that are mutated.
    #[serde(default)]
    pub files: Vec<String>,
    /// Rust: the package with the tests, if it is another one.
    pub tests_of: Option<String>,
    /// Rust: which of its test programs, as arguments of `cargo test`.
    #[serde(default)]
    pub targets: Vec<String>,
    /// Rust: which of their tests, as arguments of the program.
    #[serde(default)]
    pub filter: Vec<String>,
    /// Rust: the tests are long, so they are optimised.
    #[serde(default)]
    pub optimised: bool,
    /// Cores: a bench of `gateware/tests/mutants.sh`.
    pub bench: Option<String>,
}

/// A survivor that no test can tell from the code, or that may live for the reason given.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Explained {
    file: String,
    /// As `cargo mutants` words it: what is done, and in which function.
    mutation: String,
    /// The source line it is done in; without it, anywhere in the function.
    at: Option<String>,
    /// How many survivors are meant, where one line or function has several of the same wording.
    #[serde(default = "one")]
    count: usize,
    reason: String,
}

fn one() -> usize {
    1
}

/// A mutant that no test noticed.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Survivor {
    file: String,
    /// Line and column, for the reader only: they move.
    place: String,
    /// What was done to the code.
    pub mutation: String,
    /// The line it was done in.
    at: String,
}

impl Survivor {
    /// From `FILE:LINE:COLUMN: what was done in which function`.
    pub fn of_rust(line: &str, source: impl Fn(&str) -> Result<String>) -> Result<Self> {
        let parts: Vec<&str> = line.splitn(4, ':').collect();
        let [file, row, column, mutation] = parts[..] else {
            bail!("cargo mutants prints another form than the pinned version: {line}");
        };
        let number: usize = row.parse().with_context(|| format!("no line in: {line}"))?;
        let text = source(file)?;
        let at = text.lines().nth(number.saturating_sub(1)).unwrap_or("");
        Ok(Survivor {
            file: file.to_owned(),
            place: format!("{file}:{row}:{column}"),
            mutation: mutation.trim().to_owned(),
            at: at.trim().to_owned(),
        })
    }

    /// From `bench: what`.
    pub fn of_rtl(what: &str) -> Self {
        let file = "gateware/tests/mutants.sh".to_owned();
        Survivor {
            place: file.clone(),
            file,
            mutation: what.to_owned(),
            at: String::new(),
        }
    }
}

impl fmt::Display for Survivor {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}", self.place, self.mutation)?;
        match self.at.as_str() {
            "" => Ok(()),
            at => write!(f, "\n      {at}"),
        }
    }
}

impl Explained {
    fn fits(&self, survivor: &Survivor) -> bool {
        self.file == survivor.file
            && self.mutation == survivor.mutation
            && self.at.as_ref().is_none_or(|at| *at == survivor.at)
    }

    fn of(&self, area: &Area) -> bool {
        match &area.bench {
            Some(bench) => self.mutation.starts_with(&format!("{bench}: ")),
            None => area.files.contains(&self.file),
        }
    }
}

/// Survivors beside the list.
#[derive(Debug, Default, PartialEq, Eq)]
pub struct Verdict {
    /// How many the list explains.
    pub explained: usize,
    /// The others.
    pub missed: Vec<Survivor>,
    /// Entries with fewer survivors than they say.
    pub stale: Vec<String>,
}

impl List {
    /// Reads the file. An entry without a reason explains nothing and is refused.
    pub fn read(file: &Path) -> Result<Self> {
        let text =
            std::fs::read_to_string(file).with_context(|| format!("no {}", file.display()))?;
        Self::parse(&text).with_context(|| format!("in {}", file.display()))
    }

    fn parse(text: &str) -> Result<Self> {
        let list: List = toml::from_str(text)?;
        for area in &list.area {
            if area.bench.is_some() == area.package.is_some() {
                bail!("area {} has to have a package or a bench", area.name);
            }
        }
        for entry in &list.explained {
            if entry.reason.trim().is_empty() {
                bail!("{}, {}: no reason", entry.file, entry.mutation);
            }
            if !list.area.iter().any(|area| entry.of(area)) {
                bail!("{}, {}: in no area", entry.file, entry.mutation);
            }
        }
        Ok(list)
    }

    /// The areas with these names or with names that begin so; without names all areas.
    pub fn areas(&self, names: &[String]) -> Result<Vec<&Area>> {
        let is = |area: &Area, name: &str| {
            area.name == name || area.name.starts_with(&format!("{name}-"))
        };
        for name in names {
            if !self.area.iter().any(|area| is(area, name)) {
                let known: Vec<&str> = self.area.iter().map(|area| area.name.as_str()).collect();
                bail!("there is no area {name}; there are {}", known.join(", "));
            }
        }
        let wanted = |area: &&Area| names.is_empty() || names.iter().any(|name| is(area, name));
        Ok(self.area.iter().filter(wanted).collect())
    }

    /// Whether an entry is meant for this mutant.
    pub fn explains(&self, survivor: &Survivor) -> bool {
        self.explained.iter().any(|entry| entry.fits(survivor))
    }

    /// Which survivors of an area the list explains, and which of its entries have none.
    pub fn judge(&self, area: &Area, survivors: &[Survivor]) -> Verdict {
        let mut verdict = Verdict::default();
        let entries: Vec<&Explained> = self.explained.iter().filter(|e| e.of(area)).collect();
        let mut left: Vec<usize> = entries.iter().map(|entry| entry.count).collect();
        for survivor in survivors {
            let mut open = entries.iter().zip(left.iter_mut());
            match open.find(|(entry, left)| **left > 0 && entry.fits(survivor)) {
                Some((_, left)) => {
                    *left -= 1;
                    verdict.explained += 1;
                }
                None => verdict.missed.push(survivor.clone()),
            }
        }
        let unused = entries.iter().zip(&left).filter(|(_, left)| **left > 0);
        verdict.stale = unused
            .map(|(entry, left)| format!("{}: {} ({left} of them)", entry.file, entry.mutation))
            .collect();
        verdict
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIST: &str = r#"
[[area]]
name = "firmware-session"
what = "the owner of the motion"
minutes = 1
package = "firmware"
files = ["session.rs"]

[[area]]
name = "rtl-pwm"
what = "pulse widths"
minutes = 1
bench = "pwm"

[[explained]]
file = "session.rs"
mutation = "replace | with ^ in token"
at = "low | high"
count = 2
reason = "the bits are apart"
"#;

    fn survivor(line: &str) -> Survivor {
        let source = "first\n  low | high\n";
        Survivor::of_rust(line, |_| Ok(source.to_owned())).unwrap()
    }

    #[test]
    fn a_survivor_is_known_by_the_text_of_its_source_line() {
        let list = List::parse(LIST).unwrap();
        let area = list.areas(&["firmware".to_owned()]).unwrap()[0];
        let known = survivor("session.rs:2:7: replace | with ^ in token");
        let elsewhere = survivor("session.rs:1:7: replace | with ^ in token");
        let other = survivor("session.rs:2:7: replace | with & in token");
        assert!(list.explains(&known) && !list.explains(&elsewhere) && !list.explains(&other));
        let verdict = list.judge(area, &[known.clone(), elsewhere.clone(), other.clone()]);
        assert_eq!(verdict.explained, 1);
        assert_eq!(verdict.missed, [elsewhere, other]);
        assert_eq!(verdict.stale.len(), 1, "two were meant, one is there");
        let verdict = list.judge(area, &[known.clone(), known.clone(), known.clone()]);
        assert_eq!((verdict.explained, verdict.missed.len()), (2, 1));
        assert!(verdict.stale.is_empty());
    }

    #[test]
    fn an_entry_is_stale_in_its_own_area_only() {
        let list = List::parse(LIST).unwrap();
        let stale = |name: &str| {
            let area = list.areas(&[name.to_owned()]).unwrap()[0];
            list.judge(area, &[]).stale.len()
        };
        assert_eq!((stale("firmware-session"), stale("rtl-pwm")), (1, 0));
    }

    #[test]
    fn an_entry_without_a_reason_or_an_area_is_refused() {
        assert!(List::parse(&LIST.replace("the bits are apart", " ")).is_err());
        assert!(List::parse(&LIST.replace("file = \"session.rs\"", "file = \"x.rs\"")).is_err());
    }

    #[test]
    fn an_unknown_area_is_refused_with_the_list_of_areas() {
        let list = List::parse(LIST).unwrap();
        let Err(why) = list.areas(&["firm".to_owned()]) else {
            panic!("taken");
        };
        assert!(why.to_string().contains("firmware-session, rtl-pwm"));
        assert_eq!(list.areas(&[]).unwrap().len(), 2);
    }

    #[test]
    fn the_committed_list_can_be_read() {
        List::read(&crate::root().join("tests/mutants.toml")).unwrap();
    }
}
