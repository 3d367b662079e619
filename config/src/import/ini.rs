//! INI as Python's configparser writes it, with the line number of every section and key. The
//! crates for INI keep no line numbers and accept a key that is given twice.

use crate::error::{Error, Place, Report};

/// A section: its name, its place, its entries in the order of the file.
pub(super) struct Section<'t> {
    pub name: &'t str,
    pub place: Place,
    pub entries: Vec<Entry<'t>>,
}

/// A key and its value. Keys are lower case, as configparser makes them.
pub(super) struct Entry<'t> {
    pub key: String,
    pub value: &'t str,
    pub place: Place,
}

/// Sections of every machine's INI, none of a board's.
const OF_LINUXCNC: [&str; 7] = [
    "[EMC]",
    "[DISPLAY]",
    "[TASK]",
    "[RS274NGC]",
    "[EMCMOT]",
    "[KINS]",
    "[TRAJ]",
];

/// Refuses the INI file of a LinuxCNC machine by name. Its keys may be there twice, so that
/// [`parse`] would complain about something else. `wanted` is what the import reads.
pub(super) fn refuse_machine(file: &str, text: &str, wanted: &str) -> Result<(), Error> {
    let mut lines = text.lines().enumerate();
    let Some((n, section)) = lines.find_map(|(n, line)| {
        let known = OF_LINUXCNC.iter().find(|known| **known == line.trim());
        known.map(|known| (n, *known))
    }) else {
        return Ok(());
    };
    Err(Error::from(Report {
        file: file.to_owned(),
        place: Some(Place {
            line: n + 1,
            column: 1,
        }),
        key: section.to_owned(),
        value: String::new(),
        problem: "is a section of a machine's INI file, the one that LinuxCNC starts with"
            .to_owned(),
        remedy: format!("name the board's file instead: {wanted}"),
    }))
}

pub(super) fn parse<'t>(file: &str, text: &'t str) -> Result<Vec<Section<'t>>, Error> {
    let mut sections: Vec<Section<'t>> = Vec::new();
    for (n, line) in text.lines().enumerate() {
        let place = Place {
            line: n + 1,
            column: 1,
        };
        let error = |key: &str, problem: &str, remedy: &str| {
            Error::from(Report {
                file: file.to_owned(),
                place: Some(place),
                key: key.to_owned(),
                value: format!("{:?}", line.trim()),
                problem: problem.to_owned(),
                remedy: remedy.to_owned(),
            })
        };
        let bare = line.trim();
        if bare.is_empty() || bare.starts_with(['#', ';']) {
            continue;
        }
        if let Some(name) = bare
            .strip_prefix('[')
            .and_then(|rest| rest.strip_suffix(']'))
        {
            if sections.iter().any(|section| section.name == name) {
                return Err(error("", "begins a section a second time", "make them one"));
            }
            sections.push(Section {
                name,
                place,
                entries: Vec::new(),
            });
            continue;
        }
        let Some((key, value)) = bare.split_once(['=', ':']) else {
            return Err(error(
                "",
                "is neither a section, [name], nor a key, name = value",
                "look at the line",
            ));
        };
        let Some(section) = sections.last_mut() else {
            return Err(error(
                "",
                "is before the first section",
                "begin with [Hardware]",
            ));
        };
        let key = key.trim().to_lowercase();
        let path = format!("[{}] {key}", section.name);
        if line.starts_with([' ', '\t']) {
            return Err(error(
                &path,
                "goes on with the line above it",
                "begin it at the left",
            ));
        }
        if section.entries.iter().any(|entry| entry.key == key) {
            return Err(error(&path, "is there twice", "take one away"));
        }
        section.entries.push(Entry {
            key,
            value: value.trim(),
            place,
        });
    }
    Ok(sections)
}
