//! A file as a tree of values with their places, and the check of the tree against the known keys.
//!
//! The known keys are a list of [`Key`]s. The check, the remedies in its errors and the JSON schema
//! are made from the same list, so they cannot differ.

use crate::error::{Error, Place, Report};

/// A value and where it begins.
#[derive(Clone, Debug)]
pub struct Node {
    /// Where it begins, if it can be told.
    pub place: Option<Place>,
    /// What it is.
    pub value: Value,
}

/// What TOML and JSON can say, less what no board file needs.
#[derive(Clone, Debug)]
pub enum Value {
    /// In quotes.
    Text(String),
    /// A whole number.
    Integer(i64),
    /// True or false.
    Flag(bool),
    /// In brackets.
    List(Vec<Node>),
    /// Keys, where each stands, and its value.
    Table(Vec<(String, Option<Place>, Node)>),
    /// A float, a date, a null: kept as it is written, accepted nowhere.
    Other(String),
}

impl Value {
    /// As it would be written.
    pub fn show(&self) -> String {
        match self {
            Value::Text(text) => format!("{text:?}"),
            Value::Integer(number) => number.to_string(),
            Value::Flag(flag) => flag.to_string(),
            Value::List(nodes) => {
                let inner: Vec<String> = nodes.iter().map(|node| node.value.show()).collect();
                format!("[{}]", inner.join(", "))
            }
            Value::Table(_) => "a table".to_owned(),
            Value::Other(text) => text.clone(),
        }
    }
}

/// One key of a table.
#[derive(Debug)]
pub struct Key {
    /// As it is written.
    pub name: &'static str,
    /// It must be there.
    pub required: bool,
    /// What it may be.
    pub kind: Kind,
    /// What it is, as a phrase: "write {about}" is the remedy when it is missing or wrong.
    pub about: &'static str,
}

/// What a key's value may be.
#[derive(Debug)]
pub enum Kind {
    /// Any text in quotes.
    Text,
    /// A text with a pattern that an editor can check; the reader checks it with a better message.
    Shaped {
        /// A regular expression.
        pattern: &'static str,
        /// How long it may be.
        most: usize,
    },
    /// A whole number from `min` to `max`.
    Integer {
        /// The least.
        min: i64,
        /// The greatest.
        max: i64,
    },
    /// One of these words.
    OneOf(&'static [&'static str]),
    /// True or false.
    Flag,
    /// Whole or not.
    Number,
    /// The caller checks it.
    Any,
    /// A list of texts.
    Texts,
    /// A table with these keys.
    Table(&'static [Key]),
    /// An array of tables, and how many there may be.
    Tables(&'static [Key], usize),
    /// A table of names with a list of texts for each.
    Lists,
}

/// A key that must be there.
pub const fn must(name: &'static str, kind: Kind, about: &'static str) -> Key {
    Key {
        name,
        required: true,
        kind,
        about,
    }
}

/// A key that may be there.
pub const fn may(name: &'static str, kind: Kind, about: &'static str) -> Key {
    Key {
        name,
        required: false,
        kind,
        about,
    }
}

/// A table of a file that has been compared with its keys: what is asked of it is there, of its
/// kind and in range.
#[derive(Clone, Copy)]
pub struct Table<'n> {
    file: &'n str,
    place: Option<Place>,
    entries: &'n [(String, Option<Place>, Node)],
    keys: &'static [Key],
}

/// A table together with its path, as in `stepgen[1]`.
#[derive(Clone)]
pub struct At<'n> {
    /// The table.
    pub table: Table<'n>,
    /// Its path; empty for the whole file.
    pub path: String,
}

impl<'n> At<'n> {
    /// Refuses unknown, repeated and missing keys and values of the wrong kind.
    pub fn new(
        file: &'n str,
        path: &str,
        node: &'n Node,
        keys: &'static [Key],
    ) -> Result<Self, Error> {
        let Value::Table(entries) = &node.value else {
            return Err(Error::from(Report {
                file: file.to_owned(),
                place: node.place,
                key: path.to_owned(),
                value: node.value.show(),
                problem: "is not a table".to_owned(),
                remedy: format!("its keys are {}", list(keys)),
            }));
        };
        let at = At {
            table: Table {
                file,
                place: node.place,
                entries,
                keys,
            },
            path: path.to_owned(),
        };
        for (name, place, _) in entries {
            if !keys.iter().any(|key| key.name == name) {
                let nearest = nearest(name, keys.iter().map(|key| key.name));
                let hint = nearest.map_or(String::new(), |near| format!(" (did you mean {near}?)"));
                return Err(at.error_at(
                    *place,
                    name,
                    "",
                    "is not a known key".to_owned() + &hint,
                    format!("the keys are {}", list(keys)),
                ));
            }
        }
        for key in keys {
            match at.node(key.name) {
                None if key.required => {
                    return Err(at.error(
                        key.name,
                        "",
                        "is missing",
                        format!("write {}", key.about),
                    ));
                }
                Some(node) => at.check(key, node)?,
                None => {}
            }
        }
        Ok(at)
    }

    fn check(&self, key: &Key, node: &Node) -> Result<(), Error> {
        let fits = match (&key.kind, &node.value) {
            (Kind::Text | Kind::Shaped { .. }, Value::Text(_))
            | (Kind::Flag, Value::Flag(_))
            | (Kind::Table(_) | Kind::Lists, Value::Table(_)) => true,
            (Kind::Any, _) | (Kind::Number, Value::Integer(_)) => true,
            (Kind::Number, Value::Other(text)) => {
                text.parse().is_ok_and(|number: f64| number.is_finite())
            }
            (Kind::OneOf(words), Value::Text(text)) => words.contains(&text.as_str()),
            (Kind::Integer { min, max }, Value::Integer(number)) => (min..=max).contains(&number),
            (Kind::Texts, Value::List(nodes)) => nodes
                .iter()
                .all(|node| matches!(node.value, Value::Text(_))),
            (Kind::Tables(_, most), Value::List(nodes)) => {
                if nodes.len() > *most {
                    let problem = format!(
                        "{} of them are more than the gateware has: {most}",
                        nodes.len()
                    );
                    return Err(self.error(
                        key.name,
                        "",
                        problem,
                        "take some away, or spread the machine over two boards",
                    ));
                }
                true
            }
            _ => false,
        };
        if fits {
            return Ok(());
        }
        let problem = match &key.kind {
            Kind::Text | Kind::Shaped { .. } => "is not a text in quotes".to_owned(),
            Kind::Integer { min, max } => match node.value {
                Value::Integer(_) => format!("is outside {min} to {max}"),
                _ => "is not a whole number".to_owned(),
            },
            Kind::OneOf(words) => format!("is not one of \"{}\"", words.join("\", \"")),
            Kind::Flag => "is neither true nor false".to_owned(),
            Kind::Number => "is not a number".to_owned(),
            Kind::Any => "is not what it should be".to_owned(),
            Kind::Texts => "is not a list of texts".to_owned(),
            Kind::Table(_) | Kind::Lists => "is not a table".to_owned(),
            Kind::Tables(..) => "is not an array of tables".to_owned(),
        };
        Err(self.error(
            key.name,
            &node.value.show(),
            problem,
            format!("write {}", key.about),
        ))
    }

    fn node(&self, name: &str) -> Option<&'n Node> {
        debug_assert!(
            self.table.keys.iter().any(|key| key.name == name),
            "{name} is not asked for"
        );
        self.table
            .entries
            .iter()
            .find(|(key, _, _)| key == name)
            .map(|(_, _, node)| node)
    }

    /// The file as it was named to us.
    pub fn file(&self) -> &'n str {
        self.table.file
    }

    /// Path of one of our keys.
    pub fn key(&self, name: &str) -> String {
        join(&self.path, name)
    }

    /// The text of a key, if it is there.
    pub fn text(&self, name: &str) -> Option<&'n str> {
        match &self.node(name)?.value {
            Value::Text(text) => Some(text),
            _ => None,
        }
    }

    /// As [`At::text`], for a key this kind of table may not know.
    pub fn text_if(&self, name: &str) -> Option<&'n str> {
        self.table
            .keys
            .iter()
            .find(|key| key.name == name)
            .and_then(|key| self.text(key.name))
    }

    /// As [`At::flag`], for a key this kind of table may not know.
    pub fn flag_if(&self, name: &str) -> Option<bool> {
        self.table
            .keys
            .iter()
            .find(|key| key.name == name)
            .and_then(|key| self.flag(key.name))
    }

    /// The number of a key, if it is there.
    pub fn integer(&self, name: &str) -> Option<i64> {
        match self.node(name)?.value {
            Value::Integer(number) => Some(number),
            _ => None,
        }
    }

    /// As [`At::integer`], for a key this kind of table may not know.
    pub fn integer_if(&self, name: &str) -> Option<i64> {
        self.table
            .keys
            .iter()
            .find(|key| key.name == name)
            .and_then(|key| self.integer(key.name))
    }

    /// The flag of a key, if it is there.
    pub fn flag(&self, name: &str) -> Option<bool> {
        match self.node(name)?.value {
            Value::Flag(flag) => Some(flag),
            _ => None,
        }
    }

    /// The value of a key as it is written, if it is there.
    pub fn shown(&self, name: &str) -> Option<String> {
        self.node(name).map(|node| node.value.show())
    }

    /// As [`At::shown`], for a key this kind of table may not know.
    pub fn shown_if(&self, name: &str) -> Option<String> {
        self.table
            .keys
            .iter()
            .find(|key| key.name == name)
            .and_then(|key| self.shown(key.name))
    }

    /// The value of a key, of any kind.
    pub fn any(&self, name: &str) -> Option<&'n Node> {
        self.node(name)
    }

    /// The texts of a list, each with its place.
    pub fn texts(&self, name: &str) -> Vec<(&'n str, Option<Place>)> {
        self.node(name).map_or(Vec::new(), texts_of)
    }

    /// The lists of a table of lists: name, its place, its texts. A single text counts as a list of
    /// one.
    pub fn lists(&self, name: &str) -> Result<Vec<Listed<'n>>, Error> {
        let Some(Node {
            value: Value::Table(entries),
            ..
        }) = self.node(name)
        else {
            return Ok(Vec::new());
        };
        let mut lists = Vec::new();
        for (key, place, node) in entries {
            let Value::List(nodes) = &node.value else {
                return Err(self.error_at(
                    node.place,
                    &join(name, key),
                    &node.value.show(),
                    "is not a list",
                    "write a list of FPGA balls".to_owned(),
                ));
            };
            if let Some(wrong) = nodes
                .iter()
                .find(|node| !matches!(node.value, Value::Text(_)))
            {
                return Err(self.error_at(
                    wrong.place,
                    &join(name, key),
                    &wrong.value.show(),
                    "is not an FPGA ball",
                    "write it in quotes, as in \"P6\"".to_owned(),
                ));
            }
            lists.push((key.as_str(), *place, texts_of(node)));
        }
        Ok(lists)
    }

    /// The table of a key, checked.
    pub fn table(&self, name: &str) -> Result<Option<At<'n>>, Error> {
        let Some(node) = self.node(name) else {
            return Ok(None);
        };
        match self.kind(name) {
            Some(Kind::Table(keys)) => {
                At::new(self.table.file, &self.key(name), node, keys).map(Some)
            }
            _ => Ok(None),
        }
    }

    /// The tables of an array, each checked.
    pub fn tables(&self, name: &str) -> Result<Vec<At<'n>>, Error> {
        let (
            Some(Node {
                value: Value::List(nodes),
                ..
            }),
            Some(Kind::Tables(keys, _)),
        ) = (self.node(name), self.kind(name))
        else {
            return Ok(Vec::new());
        };
        let path = self.key(name);
        let tables = nodes.iter().enumerate();
        tables
            .map(|(n, node)| At::new(self.table.file, &format!("{path}[{n}]"), node, keys))
            .collect()
    }

    fn kind(&self, name: &str) -> Option<&'static Kind> {
        self.table
            .keys
            .iter()
            .find(|key| key.name == name)
            .map(|key| &key.kind)
    }

    /// Where the value of a key stands, or else its table.
    pub fn place(&self, name: &str) -> Option<Place> {
        let entry = self.table.entries.iter().find(|(key, _, _)| key == name);
        entry
            .and_then(|(_, place, node)| node.place.or(*place))
            .or(self.table.place)
    }

    /// Something is wrong with the value of a key.
    pub fn error(
        &self,
        name: &str,
        value: &str,
        problem: impl Into<String>,
        remedy: impl Into<String>,
    ) -> Error {
        self.error_at(self.place(name), name, value, problem, remedy.into())
    }

    /// Something is wrong at a place of its own.
    pub fn error_at(
        &self,
        place: Option<Place>,
        name: &str,
        value: &str,
        problem: impl Into<String>,
        remedy: String,
    ) -> Error {
        Error::from(Report {
            file: self.table.file.to_owned(),
            place,
            key: self.key(name),
            value: value.to_owned(),
            problem: problem.into(),
            remedy,
        })
    }
}

/// A named list: its name, where the name stands, its texts and where they stand.
pub type Listed<'n> = (&'n str, Option<Place>, Vec<(&'n str, Option<Place>)>);

fn texts_of(node: &Node) -> Vec<(&str, Option<Place>)> {
    let Value::List(nodes) = &node.value else {
        return Vec::new();
    };
    nodes
        .iter()
        .filter_map(|node| match &node.value {
            Value::Text(text) => Some((text.as_str(), node.place)),
            _ => None,
        })
        .collect()
}

fn join(path: &str, name: &str) -> String {
    match path {
        "" => name.to_owned(),
        _ if name.is_empty() => path.to_owned(),
        _ => format!("{path}.{name}"),
    }
}

fn list(keys: &[Key]) -> String {
    let names: Vec<&str> = keys.iter().map(|key| key.name).collect();
    names.join(", ")
}

/// The known word that was probably meant: at most two letters away, and at most half of the word.
pub fn nearest<'w>(word: &str, known: impl Iterator<Item = &'w str>) -> Option<&'w str> {
    let near = known.map(|name| (distance(word, name), name)).min()?;
    (near.0 <= 2 && near.0 * 2 <= near.1.len()).then_some(near.1)
}

fn distance(a: &str, b: &str) -> usize {
    let b: Vec<char> = b.chars().collect();
    let mut row: Vec<usize> = (0..=b.len()).collect();
    for (i, left) in a.chars().enumerate() {
        let mut diagonal = row[0];
        row[0] = i + 1;
        for (j, right) in b.iter().enumerate() {
            let substituted = diagonal + usize::from(left != *right);
            diagonal = row[j + 1];
            row[j + 1] = substituted.min(diagonal + 1).min(row[j] + 1);
        }
    }
    row[b.len()]
}

/// Reads TOML into a tree.
pub fn parse_toml(file: &str, text: &str) -> Result<Node, Error> {
    let document: toml_edit::ImDocument<&str> =
        toml_edit::ImDocument::parse(text).map_err(|error| {
            Error::from(Report {
                file: file.to_owned(),
                place: error.span().map(|span| Place::of(text, span.start)),
                key: String::new(),
                value: String::new(),
                problem: format!(
                    "is not TOML: {}",
                    error.message().trim().replace('\n', ", ")
                ),
                remedy: "`ferrocnc config new` writes one to begin with".to_owned(),
            })
        })?;
    Ok(Node {
        place: None,
        value: table(text, document.as_table()),
    })
}

fn table(text: &str, table: &dyn toml_edit::TableLike) -> Value {
    let entries = table.iter().map(|(name, item)| {
        let place = table
            .key(name)
            .and_then(toml_edit::Key::span)
            .map(|span| Place::of(text, span.start));
        (name.to_owned(), place, item_node(text, item))
    });
    Value::Table(entries.collect())
}

fn item_node(text: &str, item: &toml_edit::Item) -> Node {
    let place = item.span().map(|span| Place::of(text, span.start));
    let value = match item {
        toml_edit::Item::None => Value::Other("nothing".to_owned()),
        toml_edit::Item::Value(value) => return value_node(text, value),
        toml_edit::Item::Table(inner) => table(text, inner),
        toml_edit::Item::ArrayOfTables(tables) => {
            let node = |inner: &toml_edit::Table| Node {
                place: inner.span().map(|span| Place::of(text, span.start)),
                value: table(text, inner),
            };
            Value::List(tables.iter().map(node).collect())
        }
    };
    Node { place, value }
}

fn value_node(text: &str, value: &toml_edit::Value) -> Node {
    use toml_edit::Value as Toml;
    Node {
        place: value.span().map(|span| Place::of(text, span.start)),
        value: match value {
            Toml::String(text) => Value::Text(text.value().clone()),
            Toml::Integer(number) => Value::Integer(*number.value()),
            Toml::Boolean(flag) => Value::Flag(*flag.value()),
            Toml::Float(number) => Value::Other(number.value().to_string()),
            Toml::Datetime(date) => Value::Other(date.value().to_string()),
            Toml::Array(values) => {
                Value::List(values.iter().map(|value| value_node(text, value)).collect())
            }
            Toml::InlineTable(inner) => table(text, inner),
        },
    }
}
