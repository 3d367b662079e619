//! Reads JSON as a tree with places: serde_json parses, and the slice of the text of each value
//! gives its place.

use crate::error::{Error, Place, Report};
use crate::tree::{Node, Value};
use serde::de::{Deserialize, Deserializer, MapAccess, Visitor};
use serde_json::value::RawValue;

/// Deeper than any configuration; a file of brackets must not become a stack of calls.
const DEPTH: usize = 32;

pub(super) fn parse(file: &str, text: &str) -> Result<Node, Error> {
    let raw: &RawValue = serde_json::from_str(text)
        .map_err(|e| wrong(file, text, Some((e.line(), e.column())), &e.to_string()))?;
    node(file, text, raw, DEPTH)
}

fn wrong(file: &str, text: &str, at: Option<(usize, usize)>, problem: &str) -> Error {
    // serde_json says the place in the message, too.
    let problem = problem
        .rsplit_once(" at line ")
        .map_or(problem, |(before, _)| before);
    let last = Place::of(text, text.len());
    Error::from(Report {
        file: file.to_owned(),
        place: Some(at.map_or(last, |(line, column)| Place {
            line: line.max(1),
            column: column.max(1),
        })),
        key: String::new(),
        value: String::new(),
        problem: format!("is not JSON: {problem}"),
        remedy:
            "expected a configuration of LiteX-CNC: the file that `litexcnc build_firmware` reads"
                .to_owned(),
    })
}

fn node(file: &str, text: &str, raw: &RawValue, depth: usize) -> Result<Node, Error> {
    let slice = raw.get();
    let offset = (slice.as_ptr() as usize).saturating_sub(text.as_ptr() as usize);
    let place = Place::of(text, offset);
    let error = |problem: &str| wrong(file, text, Some((place.line, place.column)), problem);
    let below = depth
        .checked_sub(1)
        .ok_or_else(|| error("it is nested too deeply"))?;
    let value = match slice.as_bytes().first() {
        Some(b'{') => {
            let Entries(entries) =
                serde_json::from_str(slice).map_err(|e| error(&e.to_string()))?;
            let mut table: Vec<(String, Option<Place>, Node)> = Vec::new();
            for (key, raw) in entries {
                let node = node(file, text, raw, below)?;
                if table.iter().any(|(known, _, _)| *known == key) {
                    return Err(wrong(
                        file,
                        text,
                        node.place.map(|p| (p.line, p.column)),
                        &format!("{key:?} is there twice"),
                    ));
                }
                table.push((key, node.place, node));
            }
            Value::Table(table)
        }
        Some(b'[') => {
            let list: Vec<&RawValue> =
                serde_json::from_str(slice).map_err(|e| error(&e.to_string()))?;
            let nodes: Result<Vec<Node>, Error> = list
                .into_iter()
                .map(|raw| node(file, text, raw, below))
                .collect();
            Value::List(nodes?)
        }
        Some(b'"') => Value::Text(serde_json::from_str(slice).map_err(|e| error(&e.to_string()))?),
        Some(b't' | b'f') => Value::Flag(slice == "true"),
        _ => slice
            .parse()
            .map_or_else(|_| Value::Other(slice.to_owned()), Value::Integer),
    };
    Ok(Node {
        place: Some(place),
        value,
    })
}

/// An object with all its entries, also those of one name.
struct Entries<'t>(Vec<(String, &'t RawValue)>);

impl<'t> Deserialize<'t> for Entries<'t> {
    fn deserialize<D: Deserializer<'t>>(deserializer: D) -> Result<Self, D::Error> {
        struct All;
        impl<'t> Visitor<'t> for All {
            type Value = Entries<'t>;

            fn expecting(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
                f.write_str("an object")
            }

            fn visit_map<M: MapAccess<'t>>(self, mut map: M) -> Result<Self::Value, M::Error> {
                let mut entries = Vec::new();
                while let Some(entry) = map.next_entry()? {
                    entries.push(entry);
                }
                Ok(Entries(entries))
            }
        }
        deserializer.deserialize_map(All)
    }
}
