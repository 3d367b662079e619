//! A mangled file never causes a panic and is never accepted silently.

use ferrocnc_config::board::Platforms;
use ferrocnc_config::import::{lcnc, litexcnc};
use ferrocnc_config::source::{BUILT_IN, Folder};
use ferrocnc_config::{Board, Error, Platform, write};
use proptest::prelude::*;
use std::collections::BTreeSet;

const GOOD: &str = include_str!("../../boards/mill6.toml");

fn read(text: &str) -> Result<Board, Error> {
    Board::read("boards/mill6.toml", "mill6", text, &Folder::default())
}

#[derive(Clone, Debug)]
enum Mangle {
    Delete(prop::sample::Index),
    Repeat(prop::sample::Index),
    Swap(prop::sample::Index, prop::sample::Index),
    Put(prop::sample::Index, char),
    Lose(prop::sample::Index),
    Cut(prop::sample::Index),
    Say(prop::sample::Index, &'static str),
}

fn mangles() -> impl Strategy<Value = Vec<Mangle>> {
    let index = any::<prop::sample::Index>;
    let words = prop::sample::select(
        &[
            "\"", "[", "]", "{", "}", "=", "\n", "0", "-1", "1e9", "null", "true", "j1:0",
            "\"j1:3\"", "[[pwm]]", "\u{0}", "\\u0000", ":", "#", ";", "é",
        ][..],
    );
    let one = prop_oneof![
        index().prop_map(Mangle::Delete),
        index().prop_map(Mangle::Repeat),
        (index(), index()).prop_map(|(a, b)| Mangle::Swap(a, b)),
        (index(), any::<char>()).prop_map(|(at, c)| Mangle::Put(at, c)),
        (index(), prop::char::range(' ', '~')).prop_map(|(at, c)| Mangle::Put(at, c)),
        index().prop_map(Mangle::Lose),
        index().prop_map(Mangle::Cut),
        (index(), words).prop_map(|(at, word)| Mangle::Say(at, word)),
    ];
    prop::collection::vec(one, 1..4)
}

fn mangled(text: &str, mangles: &[Mangle]) -> String {
    let mut text = text.to_owned();
    for mangle in mangles {
        let mut lines: Vec<&str> = text.split_inclusive('\n').collect();
        let mut chars: Vec<char> = text.chars().collect();
        if chars.is_empty() {
            return text;
        }
        text = match mangle {
            Mangle::Delete(at) => {
                lines.remove(at.index(lines.len()));
                lines.concat()
            }
            Mangle::Repeat(at) => {
                let at = at.index(lines.len());
                lines.insert(at, lines[at]);
                lines.concat()
            }
            Mangle::Swap(a, b) => {
                let (a, b) = (a.index(lines.len()), b.index(lines.len()));
                lines.swap(a, b);
                lines.concat()
            }
            Mangle::Put(at, c) => {
                let at = at.index(chars.len());
                chars[at] = *c;
                chars.into_iter().collect()
            }
            Mangle::Lose(at) => {
                chars.remove(at.index(chars.len()));
                chars.into_iter().collect()
            }
            Mangle::Cut(at) => {
                chars.truncate(at.index(chars.len()));
                chars.into_iter().collect()
            }
            Mangle::Say(at, word) => {
                let at = at.index(chars.len());
                chars.splice(at..at, word.chars());
                chars.into_iter().collect()
            }
        };
    }
    text
}

/// INI without what does not count: comments, empty lines, spaces around keys and values.
fn ini_lines(text: &str) -> Vec<String> {
    let bare = text
        .lines()
        .map(str::trim)
        .filter(|line| !line.is_empty() && !line.starts_with(['#', ';']));
    bare.map(|line| {
        let parts: Vec<&str> = line.splitn(2, ['=', ':']).map(str::trim).collect();
        if parts.len() == 2 {
            format!("{}={}", parts[0].to_lowercase(), parts[1])
        } else {
            line.to_owned()
        }
    })
    .collect()
}

/// The same lines in their sections, in any order of the sections.
fn ini_sections(text: &str) -> BTreeSet<(String, Vec<String>)> {
    let mut sections = vec![(String::new(), Vec::new())];
    for line in ini_lines(text) {
        if line.starts_with('[') {
            sections.push((line, Vec::new()));
        } else if let Some(last) = sections.last_mut() {
            last.1.push(line);
        }
    }
    // Within a section only the channels' order counts, and that order is checked.
    sections
        .into_iter()
        .map(|(name, mut lines)| {
            lines.sort();
            (name, lines)
        })
        .collect()
}

/// Numbers by value, as a reader of numbers sees them.
fn same_but_for_writing(a: &str, b: &str) -> bool {
    let clock = |text: &str| {
        let lines = ini_sections(text);
        lines
            .into_iter()
            .map(|(name, lines)| {
                (
                    name,
                    lines
                        .into_iter()
                        .map(|line| match line.split_once('=') {
                            Some((key @ ("clock" | "port" | "num"), value)) => {
                                format!("{key}={:?}", value.parse::<f64>().ok())
                            }
                            Some(("mac", value)) => format!(
                                "mac={:?}",
                                u64::from_str_radix(
                                    value.trim_start_matches("0x").trim_start_matches("0X"),
                                    16
                                )
                                .ok()
                            ),
                            _ => line,
                        })
                        .collect::<Vec<_>>(),
                )
            })
            .collect::<BTreeSet<_>>()
    };
    clock(a) == clock(b)
}

/// Every value of a JSON file counts: if it is changed or removed, the import changes, gives a
/// note, or refuses the file. The test tries every value of every sample, changed and removed,
/// because a random draw of a few hundred would miss most single values.
#[test]
fn no_value_of_a_json_file_is_dropped_silently() {
    let samples = [
        include_str!("samples/six_axis.json"),
        include_str!("samples/lathe.json"),
        include_str!("samples/plasma.json"),
    ];
    let import = |text: &str| litexcnc("mill.json", text, "mill", &Folder::default());
    let mut silent = Vec::new();
    for good in samples {
        let before = import(good).unwrap().toml;
        let sample: serde_json::Value = serde_json::from_str(good).unwrap();
        for path in paths(&sample, "") {
            for gone in [false, true] {
                if says_nothing(&sample, &path, gone) {
                    continue;
                }
                let tree = if gone {
                    without(&sample, &path)
                } else {
                    changed(&sample, &path)
                };
                if import(&tree.to_string()).is_ok_and(|after| after.toml == before) {
                    silent.push(format!("{path} {}", if gone { "gone" } else { "changed" }));
                }
            }
        }
    }
    assert!(silent.is_empty(), "no effect: {silent:#?}");
}

/// Values that repeat a default, and the shape of a waveform that is not generated.
fn says_nothing(tree: &serde_json::Value, path: &str, gone: bool) -> bool {
    let meant_anyway = [
        "/connection_type",
        "/ethphy",
        "/tx_delay",
        "/io_standard",
        "/output_type",
    ];
    let ends = |keys: &[&str]| keys.iter().any(|key| path.ends_with(key));
    path.contains("/waveform")
        || ends(&["/speed", "/max_frequency"])
        || gone && ends(&meant_anyway)
        || gone && path.ends_with("/soft_stop") && tree.pointer(path) == Some(&false.into())
}

fn without(tree: &serde_json::Value, path: &str) -> serde_json::Value {
    let mut tree = tree.clone();
    let (parent, key) = path.rsplit_once('/').unwrap();
    match tree.pointer_mut(parent).unwrap() {
        serde_json::Value::Object(map) => {
            map.remove(key);
        }
        serde_json::Value::Array(list) => {
            list.remove(key.parse().unwrap());
        }
        _ => unreachable!(),
    }
    tree
}

fn changed(tree: &serde_json::Value, path: &str) -> serde_json::Value {
    let mut tree = tree.clone();
    let value = tree.pointer_mut(path).unwrap();
    *value = match value {
        serde_json::Value::Bool(flag) => (!*flag).into(),
        serde_json::Value::Number(_) => 77.into(),
        serde_json::Value::String(text) => format!("{text}7").into(),
        _ => "something else".into(),
    };
    tree
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 256, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn mangled_toml_is_refused_or_means_what_it_says(mangles in mangles()) {
        let text = mangled(GOOD, &mangles);
        if let Ok(board) = read(&text) {
            let toml = write::to_toml(&board, &[]);
            let same = write::to_toml(&read(GOOD).unwrap(), &[]) == toml;
            let tree = |text: &str| text.parse::<toml::Table>().unwrap();
            prop_assert_eq!(same, tree(&text) == tree(GOOD), "accepted silently:\n{}", text);
            let again = Board::read("again.toml", "mill6", &toml, &Folder::default()).unwrap();
            prop_assert_eq!(write::to_toml(&again, &[]), toml);
        }
    }

    #[test]
    fn mangled_platforms_are_refused_or_read(which in 0..BUILT_IN.len(), mangles in mangles()) {
        let (name, good) = BUILT_IN[which];
        let text = mangled(good, &mangles);
        if Platform::read("p.toml", name, &text).is_ok() {
            prop_assert!(text.parse::<toml::Table>().is_ok());
        }
    }

    #[test]
    fn mangled_ini_is_refused_or_means_what_it_says(mangles in mangles()) {
        let good = include_str!("samples/router.ini");
        let text = mangled(good, &mangles);
        let import = |text: &str| lcnc("router.ini", text, "router", &Folder::default());
        if let Ok(imported) = import(&text) {
            let same = imported.toml == import(good).unwrap().toml;
            prop_assert!(!same || same_but_for_writing(&text, good), "accepted silently:\n{}", text);
        }
    }

    #[test]
    fn mangled_json_is_refused_or_means_what_it_says(which in 0..3usize, mangles in mangles()) {
        let good = [include_str!("samples/six_axis.json"), include_str!("samples/lathe.json"), include_str!("samples/plasma.json")][which];
        let text = mangled(good, &mangles);
        let import = |text: &str| litexcnc("mill.json", text, "mill", &Folder::default());
        if let Ok(imported) = import(&text) {
            prop_assert!(serde_json::from_str::<serde_json::Value>(&text).is_ok());
            prop_assert!(Board::read("again.toml", "mill", &imported.toml, &Folder::default()).is_ok());
        }
    }

    #[test]
    fn noise_is_refused(text in "\\PC*") {
        prop_assert!(read(&text).is_err());
        prop_assert!(lcnc("x.ini", &text, "x", &Folder::default()).is_err());
        prop_assert!(litexcnc("x.json", &text, "x", &Folder::default()).is_err());
        prop_assert!(Folder::default().text(&text).is_none() || BUILT_IN.iter().any(|(name, _)| *name == text));
    }
}

/// JSON pointers of everything below the root.
fn paths(tree: &serde_json::Value, path: &str) -> Vec<String> {
    let children: Vec<(String, &serde_json::Value)> = match tree {
        serde_json::Value::Object(map) => map
            .iter()
            .map(|(key, value)| (format!("{path}/{key}"), value))
            .collect(),
        serde_json::Value::Array(list) => list
            .iter()
            .enumerate()
            .map(|(n, value)| (format!("{path}/{n}"), value))
            .collect(),
        _ => Vec::new(),
    };
    children
        .into_iter()
        .flat_map(|(path, value)| [vec![path.clone()], paths(value, &path)].concat())
        .collect()
}
