//! The pins of a platform on one machine: the direction and the use of each.

use super::Modified;
use crate::error::Error;
use crate::platform::{Platform, Role, split};
use crate::tree::At;
use std::collections::BTreeMap;

/// The pins, which are used, and which way they may go.
pub(super) struct Wiring<'p> {
    platform: &'p Platform,
    modified: Modified,
    /// What is used, a shared line by its place among the shared: the name it has there and the key
    /// that has it.
    used: BTreeMap<String, (String, String)>,
    /// `j5` and `j5:shared` -> whether it can drive.
    ways: BTreeMap<String, bool>,
}

impl<'p> Wiring<'p> {
    pub(super) fn new(platform: &'p Platform) -> Self {
        Wiring {
            platform,
            modified: Modified::default(),
            used: BTreeMap::new(),
            ways: BTreeMap::new(),
        }
    }

    /// What was done to the PCB.
    pub(super) fn into_modified(self) -> Modified {
        self.modified
    }

    /// Takes down which headers have other buffers than as sold.
    pub(super) fn modify(&mut self, at: &At<'_>) -> Result<(), Error> {
        for (key, drives) in [("bus_switch", true), ("inputs", false)] {
            for (n, (name, place)) in at.texts(key).into_iter().enumerate() {
                let header = name.strip_suffix(":shared").unwrap_or(name);
                let which = format!("{key}[{n}]");
                if !self
                    .platform
                    .headers
                    .iter()
                    .any(|(known, _)| known == header)
                {
                    return Err(at.error_at(place, &which, &format!("{name:?}"), format!("is not a header of {}", self.platform.name), "write a header, as in \"j5\" for the lines it has to itself or \"j5:shared\" for those it shares".to_owned()));
                }
                if self.ways.insert(name.to_owned(), drives).is_some() {
                    return Err(at.error_at(
                        place,
                        &which,
                        &format!("{name:?}"),
                        "is there twice",
                        "say it once".to_owned(),
                    ));
                }
                let list = if drives {
                    &mut self.modified.bus_switch
                } else {
                    &mut self.modified.inputs
                };
                list.push(name.to_owned());
            }
        }
        Ok(())
    }

    /// The pin of a key, which nothing else uses from here on; `None` if there is none.
    pub(super) fn pin(
        &mut self,
        at: &At<'_>,
        key: &str,
        drives: bool,
    ) -> Result<Option<String>, Error> {
        let Some(name) = at.text(key).filter(|name| *name != "none") else {
            return Ok(None);
        };
        let shown = format!("{name:?}");
        let wrong = |problem: String, remedy: String| Err(at.error(key, &shown, problem, remedy));
        let Some((role, _)) = self.platform.pin(name) else {
            let (problem, remedy) = self.platform.no_such_pin(name);
            return wrong(problem, remedy);
        };
        let (header, index) = split(name).unwrap_or(("", 0));
        if let Some((problem, remedy)) = self.obstacle(role, header, drives) {
            return wrong(problem, remedy);
        }
        let line = match role {
            Role::Shared => format!("shared:{index}"),
            _ => name.to_owned(),
        };
        let holder = at.key(key);
        match self.used.get(&line) {
            Some((same, other)) if same == name => wrong(
                format!("is already {other}"),
                "every pin has one use; choose a free one".to_owned(),
            ),
            Some((same, other)) => wrong(
                format!("is the same line as \"{same}\", which is already {other}"),
                "pins 7 to 14 are one line on all headers; choose a free one".to_owned(),
            ),
            None => {
                self.used.insert(line, (name.to_owned(), holder));
                Ok(Some(name.to_owned()))
            }
        }
    }

    /// Why a pin of this role cannot be driven, or read, and what to write instead.
    fn obstacle(&self, role: Role, header: &str, drives: bool) -> Option<(String, String)> {
        let lines = match role {
            Role::Ground => {
                return Some((
                    "is ground".to_owned(),
                    format!(
                        "write one of {header}:0 to 2, 4 to 6 or, shared by all headers, 7 to 14"
                    ),
                ));
            }
            Role::Key if drives => {
                return Some((
                    "is the button, an input".to_owned(),
                    "write a header's pin, as in \"j1:0\"".to_owned(),
                ));
            }
            Role::Key => return None,
            Role::Own => header.to_owned(),
            Role::Shared => format!("{header}:shared"),
        };
        match (self.ways.get(&lines), drives) {
            (None, false) => Some((
                format!(
                    "cannot be read: {header} leaves the board through 74HC245 buffers, outputs as sold"
                ),
                format!(
                    "replace its buffers (docs/bringup.md) and say so, [modified] bus_switch = [\"{lines}\"], or use a pin of a header that is modified"
                ),
            )),
            (Some(false), true) => Some((
                format!("cannot be driven: [modified] inputs says that {lines} was turned round"),
                "use another header's pin, or replace the buffers by bus switches".to_owned(),
            )),
            _ => None,
        }
    }
}
