//! The manual page ferrocnc(9): the module's parameters as `host/src/module.rs` declares them, and
//! `docs/pins.md`, which a test compares with what the driver exports. A line of that page that
//! this cannot say is an error, not left out.

use crate::root;
use anyhow::{Context, Result, bail};
use roff::{Inline, Roff, bold, italic, roman};
use std::fs;

/// The page.
pub fn page() -> Result<String> {
    let read = |file: &str| fs::read_to_string(root().join(file)).with_context(|| file.to_owned());
    write(&read("host/src/module.rs")?, &read("docs/pins.md")?)
}

/// The page of these two files.
fn write(module: &str, pins: &str) -> Result<String> {
    let mut page = Roff::new();
    // The date is that of the package.
    page.control("TH", ["FERROCNC", "9", " ", "FerroCNC", "HAL Component"]);
    page.control("SH", ["NAME"]);
    page.text([roman("ferrocnc - LinuxCNC driver of FerroCNC boards")]);
    page.control("SH", ["SYNOPSIS"]);
    page.text(inlines(
        "**loadrt ferrocnc boards=**IP[:port][,IP[:port]...] [**names=**...] [**key=**FILE]",
    ));
    let parameters = parameters(module);
    if parameters.is_empty() {
        bail!("host/src/module.rs declares no parameter");
    }
    for (name, meaning) in parameters {
        page.control("TP", []);
        page.text([bold(format!("{name}="))]);
        page.text([roman(meaning)]);
    }
    body(&mut page, pins)?;
    page.control("SH", ["SEE ALSO"]);
    page.text(inlines("**ferrocnc**(1), **linuxcnc**(1)"));
    Ok(page.render())
}

/// The module's parameters and what it says of them.
fn parameters(module: &str) -> Vec<(&str, &str)> {
    let parts = module.split("rtapi_info_description_").skip(1);
    let declared = parts.filter_map(|part| {
        let (name, rest) = part.split_once(',')?;
        let text = rest.trim_start().strip_prefix("c\"")?;
        Some((name, text.split_once('"')?.0))
    });
    declared.collect()
}

/// The pages' sections, paragraphs, lists and tables.
fn body(page: &mut Roff, pins: &str) -> Result<()> {
    // A paragraph ends where something else begins.
    let mut paragraph = String::new();
    let pins = without_comments(pins);
    for line in pins.lines().chain([""]) {
        let goes_on = !line.is_empty() && !line.starts_with(['#', '|', '*', '<']);
        if goes_on {
            if !paragraph.is_empty() {
                paragraph.push(' ');
            }
            paragraph.push_str(line.trim());
            continue;
        }
        if !paragraph.is_empty() {
            page.text(inlines(&paragraph));
            page.control("PP", []);
            paragraph.clear();
        }
        if let Some(title) = line.strip_prefix("# ").or(line.strip_prefix("## ")) {
            page.control("SH", [title.to_uppercase().as_str()]);
        } else if line.starts_with('|') {
            row(page, line)?;
        } else if let Some(item) = line.strip_prefix("* ") {
            page.control("IP", ["\u{2022}", "2"]);
            item.clone_into(&mut paragraph);
        } else if !line.is_empty() {
            bail!("docs/pins.md: no place in the manual page for: {line}");
        }
    }
    Ok(())
}

/// The page without its comments.
fn without_comments(page: &str) -> String {
    let mut parts = page.split("<!--");
    let first = parts.next().unwrap_or_default().to_owned();
    parts.fold(first, |text, part| {
        text + part.split_once("-->").map_or("", |(_, after)| after)
    })
}

/// A row of a table: a pin, its type, what it means, and other drivers' names for it.
fn row(page: &mut Roff, line: &str) -> Result<()> {
    let cells: Vec<&str> = line.trim_matches('|').split('|').map(str::trim).collect();
    let (name, kind, meaning, others): (_, _, _, &[&str]) = match cells.as_slice() {
        ["ours" | "theirs", ..] => return Ok(()),
        [first, ..] if first.starts_with("---") => return Ok(()),
        [name, kind, meaning] => (name, kind, meaning, &[]),
        [name, kind, meaning, others @ ..] if others.len() == 3 => (name, kind, meaning, others),
        _ => bail!("docs/pins.md: a row with {} cells: {line}", cells.len()),
    };
    page.control("TP", []);
    page.text([bold(name.trim_matches('`')), roman(format!(" ({kind})"))]);
    page.text(inlines(meaning));
    let drivers = ["Lcnc", "LiteX-CNC", "hostmot2"].into_iter().zip(others);
    let names: Vec<String> = drivers
        .filter(|(_, name)| **name != "-")
        .map(|(driver, name)| format!("{driver}: {name}"))
        .collect();
    if !names.is_empty() {
        page.control("br", []);
        page.text(inlines(&names.join("; ")));
    }
    Ok(())
}

/// Markdown of one paragraph: code and strong words are bold, other stressed ones italic, of a link
/// its text stays.
fn inlines(markdown: &str) -> Vec<Inline> {
    let mut found = Vec::new();
    let mut rest = markdown;
    while let Some(at) = rest.find(['`', '*', '[']) {
        let (before, mark) = rest.split_at(at);
        let strong = ["**", "`"].into_iter().find(|sign| mark.starts_with(sign));
        let said = match strong {
            Some(sign) => mark[sign.len()..]
                .split_once(sign)
                .map(|(text, after)| (bold(text), after)),
            None => emphasis(mark)
                .map(|(text, after)| (italic(text), after))
                .or_else(|| link(mark).map(|(text, after)| (roman(text), after))),
        };
        found.push(roman(before));
        // A sign that opens nothing is text.
        let (inline, after) = said.unwrap_or_else(|| (roman(&mark[..1]), &mark[1..]));
        found.push(inline);
        rest = after;
    }
    found.push(roman(rest));
    found
}

/// The word between stars that begins here, and what follows it. A star behind a name is none.
fn emphasis(mark: &str) -> Option<(&str, &str)> {
    let (text, after) = mark.strip_prefix('*')?.split_once('*')?;
    text.starts_with(char::is_alphanumeric)
        .then_some((text, after))
}

/// The text of the link that begins here, and what follows it.
fn link(mark: &str) -> Option<(&str, &str)> {
    let (text, rest) = mark.strip_prefix('[')?.split_once("](")?;
    // `[` of an optional word, then a link.
    (!text.contains('[')).then_some(())?;
    let (_, after) = rest.split_once(')')?;
    Some((text, after))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_page_has_every_parameter_and_every_pin() {
        let page = page().unwrap();
        for said in [".SH BOARD", "boards=", "key=", "watchdog.has\\-bitten"] {
            assert!(page.contains(said), "{said}");
        }
        let pins = fs::read_to_string(root().join("docs/pins.md")).unwrap();
        let rows = pins.lines().filter(|line| line.starts_with("| `")).count();
        let tagged = page.lines().filter(|line| *line == ".TP").count();
        assert!(rows > 100, "{rows} rows found");
        assert_eq!(tagged, rows + 3, "pins and three parameters");
    }

    #[test]
    fn a_row_says_type_meaning_and_other_names() {
        let module = "rtapi_info_description_key,\n c\"A file\".as_ptr()";
        let pins = "<!-- not\nthis -->\n# Pins\n\nSee [this](a.md), [or] **not** *it*:\n`a` 2 * 3.\n\n\
            | ours | type | meaning | Lcnc | LiteX-CNC | hostmot2 |\n|---|---|---|---|---|---|\n\
            | `x.y` | bit in | may `move` | - | `x`* | `z` |\n";
        let page = write(module, pins).unwrap();
        let (_, page) = page.split_once(".SH PINS\n").unwrap();
        let wanted = "See this, [or] \\fBnot\\fR \\fIit\\fR: \\fBa\\fR 2 * 3.\n.PP\n\
            .TP\n\\fBx.y\\fR (bit in)\nmay \\fBmove\\fR\n\
            .br\nLiteX\\-CNC: \\fBx\\fR*; hostmot2: \\fBz\\fR\n";
        assert!(page.starts_with(wanted), "{page}");
    }

    #[test]
    fn what_has_no_place_is_an_error() {
        let module = "rtapi_info_description_key, c\"A file\"";
        for pins in ["| `x` | bit |\n", "<table>\n"] {
            assert!(write(module, pins).is_err(), "{pins}");
        }
    }
}
