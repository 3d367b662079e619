//! `docs/pins.md` says what the driver exports: every pin, its type, its direction, and the other drivers'
//! names for it.

mod common;

use common::rig::load_with;
use common::{FakeBoard, Time};
use ferrocnc::hal::fake::FakeHal;
use ferrocnc::hal::{Direction, Type};
use ferrocnc::names::{self, Scheme};
use std::collections::{BTreeMap, BTreeSet};

const PAGE: &str = include_str!("../../docs/pins.md");

/// Everything a `mill6` exports under a scheme.
fn export(scheme: Option<&Scheme>) -> FakeHal {
    let board = FakeBoard::mill6(Time::Lockstep(60_000));
    let mut hal = FakeHal::new();
    let (driver, identity) = load_with(&board, &mut hal, 0);
    if let Some(scheme) = scheme {
        names::export(scheme, &mut hal, 0, &identity, &driver).unwrap();
    }
    hal
}

fn kind(ty: Type, direction: Direction) -> String {
    let ty = match ty {
        Type::Bit => "bit",
        Type::Float => "float",
        Type::S32 => "s32",
        Type::U32 => "u32",
    };
    let direction = match direction {
        Direction::In => "in",
        Direction::Out => "out",
        Direction::Io => "io",
        Direction::ReadOnly => "ro",
        Direction::ReadWrite => "rw",
    };
    format!("{ty} {direction}")
}

/// The name without its board, and `<nn>` for the channel.
fn general(name: &str, prefix: &str) -> Option<String> {
    let name = name.strip_prefix(prefix)?;
    let mut parts: Vec<&str> = name.split('.').collect();
    let classes = [
        "stepgen", "encoder", "pwm", "gpio", "input", "output", "estop",
    ];
    for n in 0..parts.len().saturating_sub(2) {
        if classes.contains(&parts[n]) {
            parts[n + 1] = "<nn>";
        }
    }
    Some(parts.join("."))
}

/// Cells of every table row whose first cell is a name in backquotes.
fn rows() -> impl Iterator<Item = Vec<&'static str>> {
    PAGE.lines()
        .filter(|line| line.starts_with("| `"))
        .map(|line| line.trim_matches('|').split('|').map(str::trim).collect())
}

/// The names in a cell, with whether they are starred.
fn listed(cell: &str) -> Vec<(String, bool)> {
    let words = cell.split_whitespace().filter(|word| *word != "-");
    words
        .map(|word| {
            (
                word.trim_matches(['`', '*']).to_owned(),
                word.ends_with('*'),
            )
        })
        .collect()
}

#[test]
fn every_pin_is_on_the_page_with_its_type_and_nothing_else_is() {
    let exported: BTreeMap<String, String> = export(None)
        .list()
        .map(|(name, ty, direction)| (general(name, "ferrocnc.0.").unwrap(), kind(ty, direction)))
        .collect();
    let page: BTreeMap<String, String> = rows()
        .filter(|row| row.len() == 6)
        .map(|row| (row[0].trim_matches('`').to_owned(), row[1].to_owned()))
        .collect();
    for (name, kind) in &exported {
        assert_eq!(page.get(name), Some(kind), "{name} is {kind}, on the page");
    }
    for name in page.keys() {
        assert!(exported.contains_key(name), "{name} is on the page only");
    }
}

/// Aliases and pins of their own, exported under `prefix`, against a column of the page.
fn compare(scheme: &Scheme, prefix: &str, column: usize, alone: &str) {
    let hal = export(Some(scheme));
    let aliases: BTreeSet<String> = hal
        .aliases()
        .filter_map(|(name, _, _)| general(name, prefix))
        .collect();
    let own: BTreeMap<String, String> = hal
        .list()
        .filter_map(|(name, ty, direction)| Some((general(name, prefix)?, kind(ty, direction))))
        .collect();
    let mut page = BTreeSet::new();
    for row in rows().filter(|row| row.len() == 6) {
        page.extend(listed(row[column]));
    }
    for row in rows().filter(|row| row.len() == 3) {
        if let Some(name) = row[0].trim_matches('`').strip_prefix(alone) {
            assert_eq!(own.get(name).map(String::as_str), Some(row[1]), "{name}");
            page.insert((name.to_owned(), true));
        }
    }
    let exported = aliases.into_iter().map(|name| (name, false));
    let exported: BTreeSet<_> = exported
        .chain(own.into_keys().map(|name| (name, true)))
        .collect();
    let missing: Vec<_> = exported.difference(&page).collect();
    let invented: Vec<_> = page.difference(&exported).collect();
    assert!(
        missing.is_empty() && invented.is_empty(),
        "not on the page: {missing:?}; only there: {invented:?}"
    );
}

#[test]
fn lcncs_column_is_what_names_lcnc_exports() {
    compare(&Scheme::Lcnc, "Lcnc.00.", 3, "Lcnc.<nn>.");
}

#[test]
fn litexcncs_column_is_what_names_litexcnc_exports() {
    let scheme = Scheme::LitexCnc(vec!["test".to_owned()]);
    compare(&scheme, "test.", 4, "NAME.");
    let own = Scheme::LitexCnc(Vec::new());
    let hal = export(Some(&own));
    assert!(
        hal.aliases()
            .any(|(name, _, _)| name == "mill6.watchdog.reset")
    );
}

/// What a HAL file calls ours: the words that begin with `prefix`.
fn words<'f>(file: &'f str, prefix: &str) -> Vec<&'f str> {
    file.lines()
        .filter_map(|line| line.split('#').next())
        .flat_map(str::split_whitespace)
        .filter(|word| word.starts_with(prefix))
        .collect()
}

#[test]
fn every_pin_the_example_files_name_exists() {
    let litexcnc = Scheme::LitexCnc(vec!["test".to_owned()]);
    let mill = include_str!("../examples/mill/mill.hal");
    for (scheme, prefix, functions, file) in [
        (None, "ferrocnc.0.", &["read", "write"][..], mill),
        (
            Some(Scheme::Lcnc),
            "Lcnc.00.",
            &["update"],
            include_str!("../examples/peers/lcnc.hal"),
        ),
        (
            Some(litexcnc),
            "test.",
            &["read", "write"],
            include_str!("../examples/peers/litexcnc.hal"),
        ),
    ] {
        let hal = export(scheme.as_ref());
        let known: BTreeSet<&str> = hal
            .list()
            .chain(hal.aliases())
            .map(|(name, _, _)| name)
            .collect();
        let used = words(file, prefix);
        assert!(used.len() > 40, "{prefix}: {}", used.len());
        for name in used {
            let function = name
                .strip_prefix(prefix)
                .is_some_and(|f| functions.contains(&f));
            assert!(function || known.contains(name), "{name}");
        }
    }
}
