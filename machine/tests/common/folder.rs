//! A folder in memory, with a machine's files.
#![allow(dead_code, missing_docs)]

use ferrocnc_config::source::Folder as Platforms;
use ferrocnc_config::{Board, Error};
use ferrocnc_machine::plan::{Files, Plan, Wishes, plan};
use ferrocnc_machine::template::template;
use ferrocnc_machine::{CncMachine, read};
use std::collections::BTreeMap;

#[derive(Clone, Default)]
pub struct Folder(pub BTreeMap<String, String>);

impl Files for Folder {
    fn text(&self, name: &str) -> Result<Option<String>, Error> {
        Ok(self.0.get(name).cloned())
    }

    fn board(&self, name: &str) -> Result<Board, Error> {
        let stem = name.trim_end_matches(".toml");
        let text = self.0.get(name).expect("the board file");
        Board::read(name, stem, text, &Platforms::default())
    }
}

impl Folder {
    pub fn written(text: &str) -> Self {
        let mut folder = Folder::default();
        folder.write(&machine(text));
        folder
    }

    pub fn plan(&self, machine: &CncMachine) -> Result<Plan, Vec<Error>> {
        plan(machine, self, &Platforms::default(), Wishes::default())
    }

    pub fn write(&mut self, machine: &CncMachine) -> Plan {
        let plan = self
            .plan(machine)
            .unwrap_or_else(|errors| panic!("{errors:?}"));
        for change in &plan.changes {
            self.put(&change.name, &change.after);
        }
        plan
    }

    pub fn put(&mut self, name: &str, text: &str) {
        self.0.insert(name.to_owned(), text.to_owned());
    }

    pub fn file(&self, name: &str) -> String {
        self.0
            .get(name)
            .cloned()
            .unwrap_or_else(|| panic!("no {name}"))
    }
}

pub fn sample(name: &str) -> String {
    template(name).expect("a sample").to_owned()
}

pub fn read_sample(name: &str) -> CncMachine {
    machine(&sample(name))
}

pub fn machine(text: &str) -> CncMachine {
    read("machine.toml", text).unwrap_or_else(|error| panic!("{error}"))
}

/// A sample, with the first of this changed.
pub fn with(name: &str, old: &str, new: &str) -> String {
    let text = sample(name);
    assert!(text.contains(old), "{name} has no {old}");
    text.replacen(old, new, 1)
}

/// The mill on the image of mill6.
pub fn on_mill6() -> String {
    let text = with(
        "mill",
        "platform = \"5a-75b-8.0\" ",
        "file = \"mill6.toml\" ",
    );
    text.replace("modified = ", "# modified = ")
}

/// The value of a key in an INI file; empty if it is not there.
pub fn value(ini: &str, section: &str, key: &str) -> String {
    let begin = format!("[{section}]\n");
    let (_, rest) = ini.split_once(&begin).expect("the section");
    let section = rest.split("\n[").next().unwrap_or_default();
    let line = section
        .lines()
        .find_map(|line| line.strip_prefix(&format!("{key} = ")));
    line.unwrap_or_default().to_owned()
}

pub fn errors<T>(result: Result<T, Vec<Error>>) -> Vec<String> {
    let errors = result.err().expect("it is refused");
    errors.iter().map(ToString::to_string).collect()
}
