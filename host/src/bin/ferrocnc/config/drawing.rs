//! `ferrocnc config pinout`: the headers in the terminal, as SVG, and as data for the pages.

use super::check::{described, is_of_platforms};
use super::{When, stem};
use crate::text::{drawn, say};
use anyhow::{Context, Result};
use ferrocnc_config::board::Platforms;
use ferrocnc_config::pinout::{self, Pinout, Use};
use ferrocnc_config::source::{Folder, read_text};
use ferrocnc_config::{Platform, read_board};
use serde_json::{Value, json};
use std::io::IsTerminal;
use std::path::{Path, PathBuf};

pub(super) fn draw(what: &Path, output: Option<&Path>, color: When, as_json: bool) -> Result<()> {
    let pinout = match platform(what)? {
        Some(platform) => Pinout::of_platform(&platform),
        None => Pinout::of_board(&read_board(what)?),
    };
    if let Some(file) = output {
        std::fs::write(file, pinout::svg(&pinout))
            .with_context(|| format!("cannot write {}", file.display()))?;
        return say(&format!("{}: written\n", file.display()));
    }
    if as_json {
        return say(&format!("{:#}\n", pinout_to_json(&pinout)));
    }
    let coloured = match color {
        When::Always => true,
        When::Never => false,
        When::Auto => std::io::stdout().is_terminal() && std::env::var_os("NO_COLOR").is_none(),
    };
    say(&drawn(&pinout, coloured))
}

/// A drawing as data.
pub(crate) fn pinout_to_json(pinout: &Pinout) -> Value {
    let usage = |usage: Use| json!({ "use": usage.key(), "title": usage.title(), "letter": usage.letter() });
    let with = |mut value: Value, more: Value| {
        if let (Value::Object(value), Value::Object(more)) = (&mut value, more) {
            value.extend(more);
        }
        value
    };
    let headers = pinout.headers.iter().map(|header| {
        let pins = header.pins.iter().map(|pin| {
            let more = json!({
                "pin": format!("{}:{}", header.name, pin.index), "number": pin.index + 1,
                "panel": pin.panel, "label": pin.label, "shared": pin.shared,
                "same_as": pin.same_as, "copy": pin.copy,
            });
            with(usage(pin.usage), more)
        });
        json!({ "name": header.name, "modified": header.modified, "pins": pins.collect::<Vec<_>>() })
    });
    let (key, label) = &pinout.key;
    json!({
        "title": pinout.title,
        "facts": pinout.facts,
        "uses": pinout.uses().map(usage).collect::<Vec<_>>(),
        "headers": headers.collect::<Vec<_>>(),
        "key": with(usage(*key), json!({ "label": label })),
    })
}

/// The platform of this name or file, if that is what it is.
fn platform(what: &Path) -> Result<Option<Platform>> {
    let name = what.to_str().unwrap_or_default();
    let in_checkout =
        Folder(Some(PathBuf::from("boards/platforms")).filter(|folder| folder.is_dir()));
    if let Some((file, text)) = in_checkout.text(name) {
        return Ok(Some(Platform::read(&file, name, &text)?));
    }
    if !is_of_platforms(what) {
        return Ok(None);
    }
    Ok(Some(Platform::read(name, &stem(what), &read_text(what)?)?))
}

/// What `pinout` draws of it.
pub(crate) fn pinout_of(name: &str, toml: &str) -> Result<Pinout> {
    let file = super::unsaved(name);
    Ok(Pinout::of_board(&described(&file, toml)?))
}
