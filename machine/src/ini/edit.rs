//! An INI file that is there gets what it has to say, and loses nothing of the user's.
//!
//! A line is ours if it reads exactly as we wrote it last; `before` are those lines. Ours change
//! with the machine, or go. Every other line stays where and as it is, also one with a key that we
//! would write: it counts, and is reported as a [`Conflict`]. Comments, order, foreign keys and
//! sections, line endings and what continues a line stay.

use super::Entry;

/// A line of the user's that says something else than the machine.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Conflict {
    /// Its number in the new file, from 1.
    pub line: usize,
    /// What the machine says.
    pub wanted: Entry,
    /// What the line says.
    pub says: String,
}

/// A file that has been edited.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Edited {
    /// The file.
    pub text: String,
    /// Its lines that are ours: the next `before`.
    pub ours: Vec<Entry>,
    /// Where the user has the last word.
    pub conflicts: Vec<Conflict>,
}

/// A line with its ending, and what it is.
struct IniLine {
    text: String,
    what: What,
    /// It stays.
    keep: bool,
}

enum What {
    /// `[SECTION]`.
    Section(String),
    /// `KEY = VALUE`.
    Value(Entry),
    /// A comment, nothing, the rest of a line before, or anything else.
    Other,
}

/// Makes `text` say what is wanted.
pub fn edit(text: &str, before: &[Entry], wanted: &[Entry]) -> Edited {
    let mut lines = parse(text);
    let ending = if text.contains("\r\n") { "\r\n" } else { "\n" };
    let mut ours = Vec::new();
    let mut open = Vec::new();
    let taken = mark(&mut lines, before, wanted);
    for (n, entry) in wanted.iter().enumerate() {
        match taken[n] {
            Some(Taken::Ours) => ours.push(entry.clone()),
            Some(Taken::Theirs) => {}
            None => open.push(entry),
        }
    }
    // Our lines with another value: in their place.
    for entry in open {
        let at = lines.iter().position(|line| {
            let is = |other: &Entry| same_key(other, entry) && is_ours(line, other, before);
            !line.keep && matches!(&line.what, What::Value(other) if is(other))
        });
        match at.filter(|_| !entry.is_list()) {
            Some(at) => {
                let end = line_ending(&lines[at].text).to_owned();
                lines[at].text = format!("{}{end}", entry.line());
                lines[at].what = What::Value(entry.clone());
                lines[at].keep = true;
            }
            None => insert(&mut lines, entry, ending),
        }
        ours.push(entry.clone());
    }
    lines.retain(|line| line.keep);
    // In the machine's order, whichever of them were there already.
    let ours: Vec<Entry> = wanted
        .iter()
        .filter(|entry| ours.contains(entry))
        .cloned()
        .collect();
    let conflicts = conflicts(&lines, &ours, wanted);
    let text = lines.iter().map(|line| line.text.as_str()).collect();
    Edited {
        text,
        ours,
        conflicts,
    }
}

fn same_key(a: &Entry, b: &Entry) -> bool {
    a.section == b.section && a.key == b.key
}

fn line_ending(line: &str) -> &str {
    &line[line.trim_end_matches(['\r', '\n']).len()..]
}

/// It reads as we wrote it.
fn is_ours(line: &IniLine, entry: &Entry, before: &[Entry]) -> bool {
    before.contains(entry) && line.text.trim_end_matches(['\r', '\n']) == entry.line()
}

fn parse(text: &str) -> Vec<IniLine> {
    let mut section = String::new();
    let mut continues = false;
    let lines = text.split_inclusive('\n').map(|whole| {
        let line = whole.trim();
        let is_rest = continues;
        continues = line.ends_with('\\');
        let what = if is_rest || line.starts_with(['#', ';']) {
            What::Other
        } else if let Some(name) = line.strip_prefix('[') {
            section = name.split(']').next().unwrap_or_default().trim().to_owned();
            What::Section(section.clone())
        } else if let Some((key, value)) = line.split_once('=') {
            What::Value(Entry {
                section: section.clone(),
                key: key.trim().to_owned(),
                value: value.trim().to_owned(),
            })
        } else {
            What::Other
        };
        IniLine {
            text: whole.to_owned(),
            what,
            keep: true,
        }
    });
    lines.collect()
}

#[derive(Clone, Copy)]
enum Taken {
    Ours,
    Theirs,
}

/// Marks our lines that nothing wants any more, and says which wanted entries are there.
fn mark(lines: &mut [IniLine], before: &[Entry], wanted: &[Entry]) -> Vec<Option<Taken>> {
    let mut taken = vec![None; wanted.len()];
    // A line that goes on in the next one is not what we wrote.
    let texts: Vec<bool> = lines
        .iter()
        .map(|line| match &line.what {
            What::Value(entry) => is_ours(line, entry, before),
            What::Section(_) | What::Other => false,
        })
        .collect();
    // The user's lines first: they count, wherever ours are.
    for own in [false, true] {
        for (line, is_ours) in lines.iter_mut().zip(&texts) {
            let What::Value(entry) = &line.what else {
                continue;
            };
            if *is_ours != own {
                continue;
            }
            let wants = |one: &Entry| match one.is_list() || own {
                true => one == entry,
                false => same_key(one, entry),
            };
            let found = wanted.iter().position(wants);
            match (found, own) {
                (Some(n), false) => taken[n] = Some(Taken::Theirs),
                (Some(n), true) if taken[n].is_none() => taken[n] = Some(Taken::Ours),
                // A second one of ours says the same.
                (Some(_), true) => line.keep = false,
                (None, true) => line.keep = false,
                (None, false) => {}
            }
        }
    }
    taken
}

/// Behind the last value of its section, or in a new one at the end.
fn insert(lines: &mut Vec<IniLine>, entry: &Entry, ending: &str) {
    let is = |line: &IniLine| match &line.what {
        What::Section(name) => *name == entry.section,
        What::Value(value) => value.section == entry.section,
        What::Other => false,
    };
    let new = IniLine {
        text: format!("{}{ending}", entry.line()),
        what: What::Value(entry.clone()),
        keep: true,
    };
    if let Some(last) = lines.last_mut()
        && line_ending(&last.text).is_empty()
    {
        last.text += ending;
    }
    // What continues a line belongs to it.
    let at = lines.iter().rposition(is).map(|at| {
        let mut end = at;
        while lines[end].text.trim_end().ends_with('\\') && end + 1 < lines.len() {
            end += 1;
        }
        end + 1
    });
    match at {
        Some(at) => lines.insert(at, new),
        None => {
            let gap = if lines.is_empty() { "" } else { ending };
            lines.push(IniLine {
                text: format!("{gap}[{}]{ending}", entry.section),
                what: What::Section(entry.section.clone()),
                keep: true,
            });
            lines.push(new);
        }
    }
}

/// The user's lines that say something else.
fn conflicts(lines: &[IniLine], ours: &[Entry], wanted: &[Entry]) -> Vec<Conflict> {
    let mut found = Vec::new();
    // A gap before a new section is in its line.
    let mut number = 0;
    for line in lines {
        number += line.text.matches('\n').count().max(1);
        let What::Value(entry) = &line.what else {
            continue;
        };
        let differs = |one: &&Entry| {
            same_key(one, entry)
                && one.value != entry.value
                && !one.is_list()
                && !ours.contains(one)
        };
        if let Some(one) = wanted.iter().find(differs) {
            found.push(Conflict {
                line: number,
                wanted: one.clone(),
                says: entry.value.clone(),
            });
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::{Edited, edit};
    use crate::ini::Entry;

    fn entry(section: &str, key: &str, value: &str) -> Entry {
        Entry {
            section: section.to_owned(),
            key: key.to_owned(),
            value: value.to_owned(),
        }
    }

    fn scale(value: &str) -> Entry {
        entry("JOINT_0", "SCALE", value)
    }

    #[test]
    fn an_empty_file_gets_sections_and_values() {
        let wanted = [entry("EMC", "VERSION", "1.1"), scale("400")];
        let Edited {
            text,
            ours,
            conflicts,
        } = edit("", &[], &wanted);
        assert_eq!(text, "[EMC]\nVERSION = 1.1\n\n[JOINT_0]\nSCALE = 400\n");
        assert_eq!((ours, conflicts), (wanted.to_vec(), vec![]));
    }

    #[test]
    fn our_line_follows_the_machine_and_what_is_around_it_stays() {
        let text = "# mine\n[JOINT_0]\n; scale\nSCALE = 400\nMINE=1\n\n[X]\nSCALE = 400";
        let edited = edit(text, &[scale("400")], &[scale("800")]);
        assert_eq!(edited.text, text.replacen("400", "800", 1));
        assert_eq!(edited.ours, [scale("800")]);
    }

    #[test]
    fn what_is_ours_is_told_in_the_order_of_the_machine() {
        let wanted = [scale("800"), entry("EMC", "VERSION", "1.1")];
        let first = edit("", &[], &wanted[1..]);
        let second = edit(&first.text, &first.ours, &wanted);
        assert_eq!(second.ours, wanted);
    }

    #[test]
    fn a_line_that_the_user_changed_stays_and_is_told() {
        let text = "[JOINT_0]\nSCALE = 401.5\n";
        let edited = edit(text, &[scale("400")], &[scale("800")]);
        assert_eq!(edited.text, text);
        let told = &edited.conflicts[0];
        assert_eq!((told.line, told.says.as_str()), (2, "401.5"));
        assert!(edited.ours.is_empty());
    }

    #[test]
    fn a_line_that_the_user_formatted_is_the_users() {
        let text = "[JOINT_0]\nSCALE=400\n";
        let edited = edit(text, &[scale("400")], &[scale("400")]);
        assert_eq!((edited.text.as_str(), edited.conflicts.len()), (text, 0));
        assert!(edited.ours.is_empty());
    }

    #[test]
    fn a_line_of_ours_that_nothing_wants_goes() {
        let text = "[JOINT_3]\nSCALE = 400\n# why\n";
        let gone = entry("JOINT_3", "SCALE", "400");
        assert_eq!(edit(text, &[gone], &[]).text, "[JOINT_3]\n# why\n");
    }

    #[test]
    fn files_of_the_user_stay_in_the_list() {
        let text = "[HAL]\r\nHALFILE = mine.hal\r\n\r\n[X]\r\n";
        let edited = edit(text, &[], &[entry("HAL", "HALFILE", "ferrocnc.hal")]);
        let both = "[HAL]\r\nHALFILE = mine.hal\r\nHALFILE = ferrocnc.hal\r\n\r\n[X]\r\n";
        assert_eq!(edited.text, both);
    }

    #[test]
    fn what_continues_a_line_is_not_torn_from_it() {
        let text = "[JOINT_0]\nNOTE = one \\\nSCALE = 3\n";
        let edited = edit(text, &[], &[scale("400")]);
        assert_eq!(edited.text, format!("{text}SCALE = 400\n"));
    }
}
