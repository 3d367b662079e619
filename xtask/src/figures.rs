//! `cargo xtask figures`: every measured figure stands once, in `docs/figures.json`, with its unit
//! and the command that prints it. `docs/figures.md` and the marked places of other pages are
//! written from that file.
//!
//! `--take` brings the values of `target/reports/*.json` into the file. Every figure says which
//! report has it and where, so none is written by hand. A figure whose report is not there keeps
//! its value, and the command names it; so does `--check` with a figure whose report has other
//! values.
//!
//! A page shows figures in two ways; what stands between the marks is written by this command:
//!
//! ```text
//! <!-- figures: turnaround image -->        a table
//! <!-- /figures -->
//! in <!-- figure: turnaround -->960 clocks<!-- /figure --> at most
//! ```

use crate::{root, step, target, tree};
use anyhow::{Context, Result, anyhow, bail};
use clap::Args;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::collections::{BTreeMap, HashMap};
use std::fs;
use std::path::PathBuf;

/// The figures themselves.
const DATA: &str = "docs/figures.json";

/// The page that has them all.
const PAGE: &str = "docs/figures.md";

/// What `cargo xtask figures` can be told.
#[derive(Args)]
pub struct Options {
    /// First take the values of the reports in target/reports into docs/figures.json.
    #[arg(long)]
    take: bool,
    /// Change nothing; fail if a page differs from docs/figures.json, and name the figures for
    /// which target/reports has other values.
    #[arg(long, conflicts_with = "take")]
    check: bool,
}

/// `docs/figures.json`.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Figures {
    sections: Vec<Section>,
}

/// A heading of the page.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Section {
    title: String,
    /// A sentence below the heading.
    about: String,
    figures: Vec<Figure>,
}

/// One figure: what was measured, what came out, which command prints it, and the report that has
/// it. No figure is written by hand.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Figure {
    id: String,
    what: String,
    /// `{}` stands for one value after the other.
    form: String,
    unit: String,
    command: String,
    values: Vec<Value>,
    from: Source,
}

/// Where a report has the values of a figure.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Source {
    /// A file in `target/reports`.
    report: String,
    /// One per value: `/axes/0/pulses`. `name=x` selects from a list, `a|b` is both, `*` is every
    /// element, and then a word in front says what is made of them: `max`, `min` or `sum`.
    paths: Vec<String>,
    /// The report counts only if it has these values: the day's soak, not the minute's.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    when: BTreeMap<String, Value>,
    /// What every value is multiplied by.
    #[serde(default = "one", skip_serializing_if = "is_one")]
    scale: f64,
    /// Digits after the point.
    #[serde(default)]
    digits: u32,
}

fn one() -> f64 {
    1.0
}

fn is_one(scale: &f64) -> bool {
    *scale == 1.0
}

/// Takes, writes or compares.
pub fn run(options: &Options) -> Result<()> {
    step::heading("figures");
    if options.take {
        take()?;
    }
    let stale = write(options.check)?;
    if options.check {
        for figure in measured_otherwise()? {
            step::note(&format!("target/reports has {figure}"));
        }
    }
    match (stale.is_empty(), options.check) {
        (true, _) => step::note(&format!("every page shows the figures of {DATA}")),
        (false, false) => step::note(&format!("written: {}", stale.join(", "))),
        (false, true) => bail!("{}", differs(&stale)),
    }
    Ok(())
}

/// What is said of pages that differ from the data.
pub fn differs(stale: &[String]) -> String {
    format!(
        "the figures in {} are not those of {DATA}; run `cargo xtask figures` and commit",
        stale.join(", ")
    )
}

/// Writes every page that differs from the data, or with `check` only names them.
pub fn write(check: bool) -> Result<Vec<String>> {
    let figures = read()?;
    let mut stale = Vec::new();
    for (path, before) in pages()? {
        let name = path.strip_prefix(root())?.display().to_string();
        let after = match name == PAGE {
            true => figures.page(),
            false => figures.fill(&before).with_context(|| name.clone())?,
        };
        if after == before {
            continue;
        }
        stale.push(name);
        if !check {
            fs::write(&path, after).with_context(|| format!("cannot write {}", path.display()))?;
        }
    }
    Ok(stale)
}

fn read() -> Result<Figures> {
    let text = fs::read_to_string(root().join(DATA)).with_context(|| DATA)?;
    let figures: Figures = serde_json::from_str(&text).with_context(|| DATA)?;
    figures.judge()?;
    Ok(figures)
}

/// The page of all figures, which need not be there yet, and every other page, with its text.
fn pages() -> Result<Vec<(PathBuf, String)>> {
    let mut found = tree::with_ending(root(), "md")?;
    found.push(PathBuf::from(PAGE));
    found.sort();
    found.dedup();
    let read = |page| {
        let path = root().join(page);
        let text = fs::read_to_string(&path).unwrap_or_default();
        (path, text)
    };
    Ok(found.into_iter().map(read).collect())
}

/// The reports that were read, by name; none where there is no such report.
#[derive(Default)]
struct Reports(HashMap<String, Option<Value>>);

impl Reports {
    /// The values that the reports have for a figure, or why there are none.
    fn values(&mut self, source: &Source) -> Result<Vec<Value>> {
        let report = self.0.entry(source.report.clone()).or_insert_with(|| {
            let text = fs::read_to_string(target("reports").join(&source.report)).ok()?;
            serde_json::from_str(&text).ok()
        });
        match report {
            Some(report) => source.values(report),
            None => bail!("no target/reports/{}", source.report),
        }
    }
}

/// Brings the values of the reports into the data.
fn take() -> Result<()> {
    let (mut figures, mut reports) = (read()?, Reports::default());
    let (mut taken, mut kept) = (0, Vec::new());
    for figure in figures.sections.iter_mut().flat_map(|s| &mut s.figures) {
        match reports.values(&figure.from) {
            Ok(values) => {
                figure.values = values;
                taken += 1;
            }
            Err(why) => kept.push(format!("{} ({why})", figure.id)),
        }
    }
    figures.judge()?;
    let text = serde_json::to_string_pretty(&figures)? + "\n";
    fs::write(root().join(DATA), text).with_context(|| DATA)?;
    step::note(&format!("{taken} figures taken from target/reports"));
    for figure in &kept {
        step::note(&format!("kept: {figure}"));
    }
    Ok(())
}

/// The figures for which the reports on this computer have other values. Those of a test with
/// random inputs differ from run to run, so this is no error.
fn measured_otherwise() -> Result<Vec<String>> {
    let (figures, mut reports) = (read()?, Reports::default());
    let found = figures.all().filter_map(|figure| {
        let values = reports.values(&figure.from).ok()?;
        let written = serde_json::to_string(&figure.values).ok()?;
        let measured = serde_json::to_string(&values).ok()?;
        (written != measured).then(|| format!("{}: {measured}, not {written}", figure.id))
    });
    Ok(found.collect())
}

impl Source {
    /// The values a report has for a figure, or why there are none.
    fn values(&self, report: &Value) -> Result<Vec<Value>> {
        for (path, wanted) in &self.when {
            let found = self.value(report, path)?;
            if found.as_f64() != wanted.as_f64() {
                bail!("{} was made with {path} {found}, not {wanted}", self.report);
            }
        }
        let values = self.paths.iter().map(|path| {
            let value = self.value(report, path)?;
            // A count has no digits after the point, even if its neighbours have some.
            if self.scale == 1.0 && value.is_u64() {
                return Ok(value);
            }
            let number = value
                .as_f64()
                .with_context(|| format!("{path} in {} is {value}", self.report))?;
            round(number * self.scale, self.digits)
        });
        values.collect()
    }

    fn value(&self, report: &Value, path: &str) -> Result<Value> {
        // A name may have spaces; a path begins with a slash, a word does not.
        let (word, path) = match path.starts_with('/') {
            true => ("", path),
            false => path.split_once(' ').unwrap_or(("", path)),
        };
        let mut found = vec![report];
        for segment in path.split('/').skip(1) {
            found = found.iter().flat_map(|at| children(at, segment)).collect();
        }
        let number = |value: &&Value| value.as_f64();
        let made = match word {
            "" => return found.first().map(|v| (*v).clone()).ok_or(self.lacks(path)),
            "max" => found.iter().filter_map(number).reduce(f64::max),
            "min" => found.iter().filter_map(number).reduce(f64::min),
            "sum" => found.iter().filter_map(number).reduce(|a, b| a + b),
            other => bail!("`{other}` before {path} is not one of max, min, sum"),
        };
        made.map(Value::from).ok_or(self.lacks(path))
    }

    fn lacks(&self, path: &str) -> anyhow::Error {
        anyhow!("{} has no {path}", self.report)
    }
}

/// What a segment of a path leads to.
fn children<'a>(value: &'a Value, segment: &str) -> Vec<&'a Value> {
    match (value, segment.split_once('=')) {
        (Value::Array(list), Some((key, wanted))) => list
            .iter()
            .filter(|item| plain(&item[key]) == wanted)
            .collect(),
        (Value::Array(list), None) if segment == "*" => list.iter().collect(),
        (Value::Object(map), None) if segment == "*" => map.values().collect(),
        (Value::Object(map), None) if segment.contains('|') => {
            segment.split('|').filter_map(|key| map.get(key)).collect()
        }
        (Value::Array(list), None) => segment
            .parse()
            .ok()
            .and_then(|n: usize| list.get(n))
            .into_iter()
            .collect(),
        (value, _) => value.get(segment).into_iter().collect(),
    }
}

/// A number as the data keeps it.
fn round(number: f64, digits: u32) -> Result<Value> {
    let factor = 10f64.powi(digits as i32);
    let rounded = (number * factor).round() / factor;
    if digits == 0 {
        return Ok(Value::from(rounded as i64));
    }
    serde_json::from_str(&format!("{rounded:.*}", digits as usize)).context("no number")
}

/// A value as a page shows it: thousands are set apart by spaces.
fn plain(value: &Value) -> String {
    let text = match value {
        Value::String(text) => return text.clone(),
        other => other.to_string(),
    };
    let (whole, rest) = match text.split_once('.') {
        Some((whole, rest)) => (whole, format!(".{rest}")),
        None => (text.as_str(), String::new()),
    };
    if whole.len() < 5 {
        return text;
    }
    let mut apart = String::new();
    for (n, digit) in whole.chars().enumerate() {
        if n > 0 && (whole.len() - n) % 3 == 0 {
            apart.push(' ');
        }
        apart.push(digit);
    }
    apart + &rest
}

impl Figure {
    /// The value with its unit.
    fn text(&self) -> String {
        let mut values = self.values.iter().map(plain);
        let mut text = String::new();
        for (n, part) in self.form.split("{}").enumerate() {
            if n > 0 {
                text += &values.next().unwrap_or_default();
            }
            text += part;
        }
        match self.unit.is_empty() {
            true => text,
            false => format!("{text} {}", self.unit),
        }
    }

    fn row(&self) -> String {
        format!("| {} | {} | `{}` |\n", self.what, self.text(), self.command)
    }
}

/// Columns of a line of prose.
const COLUMNS: usize = 100;

const HEAD: &str = "| what | figure | printed by |\n|---|---|---|\n";

impl Figures {
    /// Refuses data that no page could show.
    fn judge(&self) -> Result<()> {
        let mut seen = HashMap::new();
        for figure in self.all() {
            let (holes, values) = (figure.form.matches("{}").count(), figure.values.len());
            if holes != values {
                bail!(
                    "{DATA}: {} has {holes} places for {values} values",
                    figure.id
                );
            }
            if figure.from.paths.len() != holes {
                bail!(
                    "{DATA}: {} has {holes} places for {} paths",
                    figure.id,
                    figure.from.paths.len()
                );
            }
            if figure.command.contains("..") {
                bail!("{DATA}: the command of {} is not a whole one", figure.id);
            }
            if seen.insert(&figure.id, ()).is_some() {
                bail!("{DATA}: two figures are called {}", figure.id);
            }
        }
        Ok(())
    }

    fn all(&self) -> impl Iterator<Item = &Figure> {
        self.sections.iter().flat_map(|section| &section.figures)
    }

    fn get(&self, id: &str) -> Result<&Figure> {
        self.all()
            .find(|figure| figure.id == id)
            .with_context(|| format!("{DATA} has no figure `{id}`"))
    }

    /// `docs/figures.md`.
    fn page(&self) -> String {
        let mut page = String::from(
            "<!-- Generated from docs/figures.json by `cargo xtask figures`; do not edit. -->\n\
             # Figures\n\n\
             Every measured figure, with its unit and the command that prints it. All are from the\n\
             simulated board, the twin or the FPGA tools. Nothing has run on hardware yet.\n\n\
             `cargo xtask figures --take` brings the values of `target/reports/*.json` into\n\
             `docs/figures.json`; `cargo xtask figures` writes this page and the marked places of\n\
             other pages from that file. Sizes of cores and boards are in [size](size.md), clocks of\n\
             every configuration in [timing](timing.md).\n",
        );
        for section in &self.sections {
            let about = wrapped(&section.about, COLUMNS);
            page += &format!("\n## {}\n\n{about}\n\n{HEAD}", section.title);
            page.extend(section.figures.iter().map(Figure::row));
        }
        page
    }

    /// A page with its marked places filled.
    fn fill(&self, text: &str) -> Result<String> {
        let tables = replace(text, "<!-- figures:", "<!-- /figures -->", |ids| {
            let mut table = format!("\n{HEAD}");
            for id in ids.split_whitespace() {
                table += &self.get(id)?.row();
            }
            Ok(table)
        })?;
        replace(&tables, "<!-- figure:", "<!-- /figure -->", |id| {
            Ok(self.get(id)?.text())
        })
    }
}

/// Prose in lines of so many characters at most.
fn wrapped(text: &str, columns: usize) -> String {
    let (mut done, mut length) = (String::new(), 0);
    for word in text.split_whitespace() {
        let more = word.chars().count();
        if length > 0 && length + 1 + more > columns {
            done.push('\n');
            length = 0;
        } else if length > 0 {
            done.push(' ');
            length += 1;
        }
        done += word;
        length += more;
    }
    done
}

/// Replaces what stands between each pair of marks; `make` is given what the first mark names.
fn replace(
    text: &str,
    begin: &str,
    end: &str,
    make: impl Fn(&str) -> Result<String>,
) -> Result<String> {
    let mut done = String::new();
    let mut rest = text;
    while let Some((before, behind)) = rest.split_once(begin) {
        let (names, behind) = behind
            .split_once("-->")
            .context("a mark without its `-->`")?;
        let (_, behind) = behind
            .split_once(end)
            .with_context(|| format!("no `{end}` after `{begin}{names}-->`"))?;
        done += &format!("{before}{begin}{names}-->{}{end}", make(names.trim())?);
        rest = behind;
    }
    Ok(done + rest)
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn source(report: &str, paths: &[&str]) -> Source {
        Source {
            report: report.to_owned(),
            paths: paths.iter().map(|path| (*path).to_owned()).collect(),
            when: BTreeMap::new(),
            scale: 1.0,
            digits: 0,
        }
    }

    #[test]
    fn every_page_shows_the_figures_of_the_data() {
        let stale = write(true).unwrap_or_else(|error| panic!("{error:#}"));
        assert!(stale.is_empty(), "{}", differs(&stale));
    }

    #[test]
    fn prose_is_wrapped_between_words() {
        assert_eq!(wrapped("a bc def", 4), "a bc\ndef");
        assert_eq!(wrapped("abcdef g", 4), "abcdef\ng");
        assert_eq!(wrapped("", 4), "");
    }

    #[test]
    fn a_page_that_differs_is_found() {
        let figures = read().unwrap();
        let first = figures.all().next().unwrap();
        let stale = format!("<!-- figure: {} -->1<!-- /figure -->", first.id);
        let fresh = figures.fill(&stale).unwrap();
        assert_ne!(fresh, stale);
        assert_eq!(figures.fill(&fresh).unwrap(), fresh);
        assert!(
            figures
                .fill("<!-- figure: none -->1<!-- /figure -->")
                .is_err()
        );
        assert!(figures.fill("<!-- figures: none").is_err());
    }

    #[test]
    fn a_report_gives_its_values() {
        let report = json!({"rows": [{"name": "a", "n": 1.26}, {"name": "b", "n": 4}], "of": 60});
        let mut source = source(
            "x.json",
            &[
                "/rows/name=b/n",
                "max /rows/*/n",
                "sum /rows/*/n",
                "/rows/0/n",
            ],
        );
        assert_eq!(
            source.values(&report).unwrap(),
            [json!(4), json!(4), json!(5), json!(1)]
        );
        let of_two = json!({"a": {"n": 1}, "b": {"n": 2}, "c": {"n": 4}});
        let both = self::source("x.json", &["sum /a|b/n"]);
        assert_eq!(both.values(&of_two).unwrap(), [json!(3)]);
        source.digits = 1;
        assert_eq!(source.values(&report).unwrap()[0], json!(4), "a count");
        source.scale = 10.0;
        assert_eq!(source.values(&report).unwrap()[3], json!(12.6));
        source.when.insert("/of".to_owned(), json!(30));
        assert!(source.values(&report).is_err(), "a report of another run");
        source.when.clear();
        source.paths.push("/nothing".to_owned());
        assert!(source.values(&report).is_err(), "a path that is not there");
    }

    #[test]
    fn a_name_in_a_path_may_have_spaces() {
        let report =
            json!({"cases": [{"name": "at rest", "n": 5}, {"name": "a, at rest", "n": 6}]});
        let paths = ["/cases/name=a, at rest/n", "max /cases/name=at rest/n"];
        let source = source("x.json", &paths);
        assert_eq!(source.values(&report).unwrap(), [json!(6), json!(5)]);
    }

    #[test]
    fn thousands_are_set_apart() {
        assert_eq!(plain(&json!(1234)), "1234");
        assert_eq!(plain(&json!(2_927_842)), "2 927 842");
        assert_eq!(plain(&json!(12345.5)), "12 345.5");
        assert_eq!(plain(&json!("none")), "none");
    }
}
