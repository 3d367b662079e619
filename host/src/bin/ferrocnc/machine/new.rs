//! `ferrocnc machine new`: a first machine.toml, from a sample and answers.

use crate::consent;
use anyhow::{Context, Result, bail};
use clap::Args;
use ferrocnc::replace::replace;
use ferrocnc_machine::read;
use ferrocnc_machine::template::{Slot, TEMPLATES, template};
use std::io::{BufRead, Write};
use std::path::PathBuf;

#[derive(Args)]
pub(crate) struct New {
    /// The file to write.
    #[arg(value_name = "MACHINE.toml", default_value = "machine.toml")]
    file: PathBuf,
    /// Take this sample as it is, and ask nothing.
    #[arg(long, value_parser = TEMPLATES.map(|(name, _, _)| name))]
    from: Option<String>,
    /// With --from: the machine's name.
    #[arg(long, requires = "from")]
    name: Option<String>,
    /// With --from: the card, as in 5a-75b-8.0.
    #[arg(long, requires = "from")]
    platform: Option<String>,
    /// With --from: the board's address, as in 192.168.2.50.
    #[arg(long, requires = "from")]
    address: Option<String>,
    /// Overwrite it.
    #[arg(long)]
    force: bool,
}

/// A question: which value it is about, and what it asks.
pub(super) struct Question {
    pub(super) table: &'static str,
    pub(super) key: &'static str,
    pub(super) asks: &'static str,
}

const fn question(table: &'static str, key: &'static str, asks: &'static str) -> Question {
    Question { table, key, asks }
}

pub(super) const MACHINE: [Question; 7] = [
    question("", "name", "Its name, of its files"),
    question("", "units", "Its unit, mm or inch"),
    question("", "gui", "User interface"),
    question("[board]", "platform", "The card, as printed on it"),
    question("[board]", "address", "The board's address"),
    question(
        "[board]",
        "modified",
        "Headers with bus switches, where inputs go, as in [\"j7\", \"j8\"]",
    ),
    question(
        "[estop]",
        "source",
        "E-stop chain: input, external (KEY terminal) or software",
    ),
];

pub(super) const AXIS: [Question; 9] = [
    question(
        "[[axis]]",
        "motor_steps",
        "full steps of the motor in a turn",
    ),
    question("[[axis]]", "microsteps", "microsteps"),
    question(
        "[[axis]]",
        "gear",
        "turns of the motor in a turn of the screw",
    ),
    question("[[axis]]", "pitch", "units in a turn of the screw"),
    question("[[axis]]", "min", "least coordinate"),
    question("[[axis]]", "max", "greatest coordinate"),
    question("[[axis]]", "speed", "greatest speed, units a second"),
    question(
        "[[axis]]",
        "acceleration",
        "acceleration, units a second, a second",
    ),
    question(
        "[[axis]]",
        "drive",
        "drive: a preset, or { steplen = .., stepspace = .., dirsetup = .., dirhold = .. }",
    ),
];

pub(crate) fn run(new: &New) -> Result<()> {
    consent::may_write(&new.file, new.force)?;
    let text = match &new.from {
        Some(name) => taken(new, name)?,
        None => asked(&mut std::io::stdin().lock(), &mut std::io::stderr())?,
    };
    replace(&new.file, text.as_bytes(), 0o644)
        .with_context(|| format!("cannot write {}", new.file.display()))?;
    let file = new.file.display();
    crate::text::say(&format!(
        "{file}: written; put your numbers in, then: ferrocnc machine check {file}\n"
    ))
}

pub(super) fn sample(name: &str) -> Result<String> {
    let names = TEMPLATES.map(|(name, _, _)| name).join(", ");
    let text =
        template(name).with_context(|| format!("there is no sample {name}, only {names}"))?;
    Ok(text.to_owned())
}

fn taken(new: &New, name: &str) -> Result<String> {
    let mut text = sample(name)?;
    for (table, key, value) in [
        ("", "name", &new.name),
        ("[board]", "platform", &new.platform),
        ("[board]", "address", &new.address),
    ] {
        if let Some(value) = value {
            text = put(&text, table, 0, key, value)?;
        }
    }
    Ok(text)
}

/// A value as it may be typed: a text needs no quotes.
pub(super) fn put(
    text: &str,
    table: &str,
    number: usize,
    key: &str,
    answer: &str,
) -> Result<String> {
    let slot = Slot { table, number, key };
    let old = slot.get(text).unwrap_or_default();
    let is_bare = !answer.starts_with(['"', '[', '{']);
    let value = match old.starts_with('"') && is_bare {
        true => format!("\"{answer}\""),
        false => answer.to_owned(),
    };
    let new = slot.set(text, &value);
    match read("answer", &new) {
        Ok(_) => Ok(new),
        // The answer has broken the text, so no key is to blame.
        Err(error) if error.key.is_empty() => {
            bail!("{answer} is no value of {key}: write it as {old} is written")
        }
        Err(error) => bail!("{} {}; {}", error.value, error.problem, error.remedy),
    }
}

/// Asks until an answer can be read. No answer is what stands there.
fn ask(
    input: &mut impl BufRead,
    output: &mut impl Write,
    asks: &str,
    old: &str,
    mut take: impl FnMut(&str) -> Result<()>,
) -> Result<()> {
    loop {
        write!(output, "{asks} [{old}]: ")?;
        output.flush()?;
        let mut answer = String::new();
        if input.read_line(&mut answer)? == 0 {
            bail!("the answers ended before the questions; --from takes a sample and asks nothing");
        }
        let answer = answer.trim();
        if answer.is_empty() {
            return Ok(());
        }
        match take(answer) {
            Ok(()) => return Ok(()),
            Err(error) => writeln!(output, "  {error:#}")?,
        }
    }
}

fn asked(input: &mut impl BufRead, output: &mut impl Write) -> Result<String> {
    writeln!(output, "Enter takes what is in brackets.")?;
    for (name, about, _) in TEMPLATES {
        writeln!(output, "  {name}: {about}")?;
    }
    let mut text = sample("mill")?;
    ask(input, output, "Which machine", "mill", |answer| {
        text = sample(answer)?;
        Ok(())
    })?;
    for Question { table, key, asks } in MACHINE {
        one(input, output, &mut text, (table, 0, key), asks)?;
    }
    let mut number = 0;
    while let Some(name) = letter(&text, number) {
        for Question { table, key, asks } in AXIS {
            let asks = format!("{name}: {asks}");
            one(input, output, &mut text, (table, number, key), &asks)?;
        }
        number += 1;
    }
    Ok(text)
}

/// The letter of an axis, if there are so many.
pub(super) fn letter(text: &str, number: usize) -> Option<String> {
    let slot = Slot {
        table: "[[axis]]",
        number,
        key: "letter",
    };
    let letter = slot.get(text)?;
    Some(letter.trim_matches('"').to_uppercase())
}

/// One value of the file.
fn one(
    input: &mut impl BufRead,
    output: &mut impl Write,
    text: &mut String,
    (table, number, key): (&str, usize, &str),
    asks: &str,
) -> Result<()> {
    let Some(old) = (Slot { table, number, key }).get(text) else {
        return Ok(());
    };
    ask(input, output, asks, old.trim_matches('"'), |answer| {
        *text = put(text, table, number, key, answer)?;
        Ok(())
    })
}

#[cfg(test)]
mod tests {
    use super::asked;
    use ferrocnc_machine::template::template;

    /// What comes of these answers, and what was said.
    fn answers(lines: &str) -> (anyhow::Result<String>, String) {
        let mut said = Vec::new();
        let text = asked(&mut lines.as_bytes(), &mut said);
        (text, String::from_utf8_lossy(&said).into_owned())
    }

    #[test]
    fn no_answers_are_the_sample() {
        let (text, _) = answers(&"\n".repeat(100));
        assert_eq!(text.ok().as_deref(), template("mill"));
    }

    #[test]
    fn an_answer_is_in_the_file_with_the_comment_behind_it() {
        let mut lines = vec![""; 100];
        (lines[0], lines[1], lines[8]) = ("router", "big-one", "400");
        let (text, _) = answers(&lines.join("\n"));
        let text = text.expect("it is read");
        assert!(
            text.contains("name = \"big-one\"             # of router.toml"),
            "{text}"
        );
        let first = "motor_steps = 400           # full steps";
        assert_eq!(text.matches(first).count(), 1, "{text}");
    }

    #[test]
    fn an_answer_that_cannot_be_read_is_asked_for_again() {
        let (text, said) = answers(&format!("drill\nmill\nbig one\nbig\n{}", "\n".repeat(100)));
        assert!(
            text.is_ok_and(|text| text.contains("name = \"big\"")),
            "{said}"
        );
        assert!(said.contains("there is no sample drill"), "{said}");
        assert!(said.contains("is not a name for files"), "{said}");
    }

    #[test]
    fn answers_that_end_too_soon_write_nothing() {
        let (text, _) = answers("mill\n");
        assert!(text.is_err_and(|error| error.to_string().contains("--from")));
    }
}
