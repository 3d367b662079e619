//! The files of a LinuxCNC configuration, as far as they say what a board does: the INI file with
//! what it includes, and its HAL files with the INI's values put in. Files of other kinds (Tcl,
//! HALCMD lines) are noted and not read.

use super::system::System;
use std::collections::BTreeMap;
use std::path::Path;

/// Where LinuxCNC looks for HAL files that are not in the configuration's folder.
const LIBRARY: &str = "usr/share/linuxcnc/hallib";
/// So deep may files include others.
const DEPTH: u32 = 4;

/// What they say.
#[derive(Clone, Debug, Default)]
pub struct Files {
    /// Section, key, value, in the order of the file.
    ini: Vec<(String, String, String)>,
    /// Functions in the order in which they are added to a thread, with the thread.
    pub functions: Vec<(String, String)>,
    /// A function has its place by number, so the order is not that of the lines.
    pub by_number: bool,
    /// Values of pins and parameters.
    pub values: BTreeMap<String, String>,
    /// Pins of every signal; true for one that is written as its source.
    pub signals: BTreeMap<String, Vec<(String, bool)>>,
    /// Files that were not read.
    pub unread: Vec<String>,
}

impl Files {
    /// Reads all of them; `None` if there is no such INI file.
    pub fn read(system: &System<'_>, ini: &str) -> Option<Self> {
        let mut files = Files::default();
        let folder = Path::new(ini).parent().unwrap_or(Path::new(""));
        files.include(&system.read(ini)?, system, folder, DEPTH);
        let halfiles: Vec<String> = ["HALFILE", "POSTGUI_HALFILE"]
            .iter()
            .flat_map(|key| files.all("HAL", key))
            .map(str::to_owned)
            .collect();
        for name in halfiles {
            files.load(system, folder, &name, DEPTH);
        }
        if files.all("HAL", "HALCMD").next().is_some() {
            files.unread.push("the lines HALCMD".to_owned());
        }
        Some(files)
    }

    /// The values of a key, in order.
    fn all<'f>(&'f self, section: &'f str, key: &'f str) -> impl Iterator<Item = &'f str> {
        let wanted = self
            .ini
            .iter()
            .filter(move |it| it.0 == section && it.1 == key);
        wanted.map(|it| it.2.as_str())
    }

    /// The value of a key.
    pub fn text(&self, section: &str, key: &str) -> Option<&str> {
        self.ini
            .iter()
            .find(|it| it.0 == section && it.1 == key)
            .map(|it| it.2.as_str())
    }

    /// The value of a key, if it is a number.
    pub fn number(&self, section: &str, key: &str) -> Option<f64> {
        self.text(section, key)?
            .split_whitespace()
            .next()?
            .parse()
            .ok()
    }

    /// What `setp` gives a pin or parameter, if it is a number.
    pub fn value(&self, name: &str) -> Option<f64> {
        self.values.get(name)?.parse().ok()
    }

    /// The signal of a pin.
    pub fn signal_of(&self, pin: &str) -> Option<&str> {
        let mut all = self.signals.iter();
        all.find(|(_, pins)| pins.iter().any(|(name, _)| name == pin))
            .map(|(signal, _)| signal.as_str())
    }

    /// Every pin and parameter that is named, once.
    pub fn named(&self) -> Vec<&str> {
        let pins = self.signals.values().flatten().map(|(pin, _)| pin.as_str());
        let mut all: Vec<_> = pins.chain(self.values.keys().map(String::as_str)).collect();
        all.sort_unstable();
        all.dedup();
        all
    }

    fn include(&mut self, text: &str, system: &System<'_>, folder: &Path, depth: u32) {
        let mut section = String::new();
        for line in text.lines().map(str::trim) {
            if let Some(name) = line.strip_prefix("#INCLUDE ") {
                let path = folder.join(name.trim());
                match system.read(&path.to_string_lossy()) {
                    Some(more) if depth > 0 => self.include(&more, system, folder, depth - 1),
                    Some(_) | None => self.unread.push(name.trim().to_owned()),
                }
            } else if line.starts_with(['#', ';']) {
            } else if let Some(name) = line.strip_prefix('[') {
                section = name.split(']').next().unwrap_or_default().trim().to_owned();
            } else if let Some((key, value)) = line.split_once('=') {
                let (key, value) = (key.trim().to_owned(), value.trim().to_owned());
                self.ini.push((section.clone(), key, value));
            }
        }
    }

    fn load(&mut self, system: &System<'_>, folder: &Path, name: &str, depth: u32) {
        // Arguments may follow the name of a Tcl file.
        let name = name.split_whitespace().next().unwrap_or_default();
        let own = folder.join(name);
        let library = Path::new(LIBRARY).join(name.trim_start_matches("LIB:"));
        let text = match name.ends_with(".tcl") || depth == 0 {
            true => None,
            false => [own, library]
                .iter()
                .find_map(|path| system.read(&path.to_string_lossy())),
        };
        let Some(text) = text else {
            self.unread.push(name.to_owned());
            return;
        };
        for line in text.replace("\\\n", " ").lines() {
            let words = self.words(line);
            let words: Vec<&str> = words.iter().map(String::as_str).collect();
            match words[..] {
                ["source", file] => self.load(system, folder, file, depth - 1),
                ["addf", function, thread, ref rest @ ..] => {
                    self.by_number |= rest.first().is_some_and(|place| *place != "-1");
                    self.functions
                        .push((function.to_owned(), thread.to_owned()));
                }
                ["setp", name, value, ..] | [name, "=", value] => {
                    self.values.insert(name.to_owned(), value.to_owned());
                }
                ["net", signal, ref pins @ ..] => self.connect(signal, pins),
                _ => {}
            }
        }
    }

    /// The words of a line, with the INI's values put in, and without its comment.
    fn words(&self, line: &str) -> Vec<String> {
        let words = line.split_whitespace();
        let words = words.take_while(|word| !word.starts_with('#'));
        words
            .map(|word| {
                let reference = word.strip_prefix('[').and_then(|rest| rest.split_once(']'));
                let value = reference
                    .and_then(|(section, key)| self.text(section, key.trim_matches(['(', ')'])));
                let value = value.and_then(|value| value.split_whitespace().next());
                value.unwrap_or(word).to_owned()
            })
            .collect()
    }

    fn connect(&mut self, signal: &str, words: &[&str]) {
        let arrow = words.iter().position(|word| *word == "=>");
        let pins = self.signals.entry(signal.to_owned()).or_default();
        for (n, word) in words.iter().enumerate() {
            if !["=>", "<=", "<=>"].contains(word) {
                pins.push(((*word).to_owned(), arrow.is_some_and(|at| n < at)));
            }
        }
    }
}
