//! The manual page ferrocnc-twin(1): made of what the program says if it is told nothing, which is
//! the text at the beginning of its file.

use crate::root;
use anyhow::{Context, Result, bail};
use roff::{Inline, Roff, bold, roman};
use std::fs;

/// The program, with its text between quotes.
const PROGRAM: &str = "host/packaging/ferrocnc-twin";
const QUOTES: &str = "\"\"\"";
/// In front of the line for a HAL file, and of an argument and its meaning.
const INDENT: &str = "  ";

/// The page.
pub fn page() -> Result<String> {
    let program = fs::read_to_string(root().join(PROGRAM)).context(PROGRAM)?;
    write(&program)
}

/// The page of this program.
fn write(program: &str) -> Result<String> {
    let said = program.split(QUOTES).nth(1);
    let said = said.with_context(|| format!("{PROGRAM} does not say what it is"))?;
    let mut blocks = said.trim().split("\n\n");
    let mut next = || {
        blocks
            .next()
            .with_context(|| format!("{PROGRAM}: too short"))
    };
    let (what, line) = (next()?, next()?);
    let mut page = Roff::new();
    // The date is that of the package.
    page.control(
        "TH",
        ["FERROCNC-TWIN", "1", " ", "FerroCNC", "HAL Component"],
    );
    page.control("SH", ["NAME"]);
    page.text([roman(format!("ferrocnc-twin - {what}"))]);
    page.control("SH", ["SYNOPSIS"]);
    page.text([bold(line.trim())]);
    page.control("SH", ["DESCRIPTION"]);
    for block in blocks {
        match block.starts_with(INDENT) {
            true => arguments(&mut page, block)?,
            false => {
                page.control("PP", []);
                page.text(inlines(&block.replace('\n', " ")));
            }
        }
    }
    page.control("SH", ["SEE ALSO"]);
    let others = [
        bold("ferrocnc-machine-write"),
        bold("ferrocnc-sim"),
        bold("loadusr"),
    ];
    for (other, comma) in others.into_iter().zip([", ", ", ", ""]) {
        page.text([other, roman(format!("(1){comma}"))]);
    }
    Ok(page.render())
}

/// A list: in each line an argument, two spaces or more, and what it is.
fn arguments(page: &mut Roff, block: &str) -> Result<()> {
    for line in block.lines() {
        let Some((name, meaning)) = line.trim().split_once(INDENT) else {
            bail!("{PROGRAM}: no argument with its meaning: {line}");
        };
        page.control("TP", []);
        page.text([bold(name)]);
        page.text(inlines(meaning.trim()));
    }
    Ok(())
}

/// What is between back quotes is bold.
fn inlines(text: &str) -> Vec<Inline> {
    let parts = text.split('`').enumerate();
    let inline = |(at, part): (usize, &str)| match at % 2 {
        0 => roman(part),
        _ => bold(part),
    };
    parts.map(inline).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_page_has_every_argument_of_the_line_for_a_hal_file() {
        let page = page().unwrap();
        let (_, synopsis) = page.split_once(".SH SYNOPSIS\n").unwrap();
        let synopsis = synopsis.lines().next().unwrap();
        let names = ["MACHINE.toml", "BOARD.toml", "ADDRESS:PORT", "ARGUMENT"];
        for name in names {
            assert!(synopsis.contains(name), "{synopsis}");
            assert!(page.contains(&format!(".TP\n\\fB{name}\\fR\n")), "{page}");
        }
        assert_eq!(page.matches(".TP\n").count(), names.len());
        assert!(
            page.contains("ferrocnc\\-twin \\- the simulated board"),
            "{page}"
        );
    }

    #[test]
    fn a_text_that_makes_no_page_is_an_error() {
        for program in [
            "no text",
            "\"\"\"a\"\"\"",
            "\"\"\"a\n\n  b\n\n  noun\n\"\"\"",
        ] {
            assert!(write(program).is_err(), "{program}");
        }
    }
}
