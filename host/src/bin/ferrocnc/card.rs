//! `ferrocnc card identify`: which card is this? Of what is printed on it, and of what its FPGA
//! says through a JTAG cable, if there is one.

use crate::text::say;
use crate::{config, images};
use anyhow::{Context, Result, bail};
use clap::{Args, Subcommand};
use ferrocnc::image::fpga_name;
use ferrocnc::jtag::{DEFAULT_CABLE, JtagError, Loader};
use ferrocnc_config::platform::Platform;
use ferrocnc_config::source::Folder;
use serde_json::json;
use std::io::{BufRead as _, IsTerminal as _, Write as _};
use std::path::PathBuf;

/// Prints of cards that are wired as another one is, and that one's platform (docs/bringup.md).
const ALIKE: [(&str, &str); 1] = [("Colorlight 5A-75E V8.0", "5a-75e-6.0")];

/// The wires of a JTAG cable, and the pad of each: the same on all these cards
/// (docs/provisioning.md).
const WIRES: [(&str, &str); 5] = [
    ("TCK", "J27"),
    ("TMS", "J31"),
    ("TDI", "J32"),
    ("TDO", "J30"),
    ("GND", "J34"),
];

#[derive(Subcommand)]
pub(crate) enum CardCommand {
    /// Name a card by what is printed on it; asks its FPGA if a JTAG cable is plugged in. Says
    /// which wires to solder, and which installed images are for it.
    Identify(Identify),
}

#[derive(Args)]
pub(crate) struct Identify {
    /// What is printed on the card, as in "5A-75B V8.0". Asked for if not given.
    #[arg(value_name = "PRINTED")]
    printed: Option<String>,
    /// JTAG cable, by openFPGALoader's name for it.
    #[arg(long, short, default_value = DEFAULT_CABLE)]
    cable: String,
    /// Do not ask the FPGA.
    #[arg(long)]
    no_jtag: bool,
    /// Where installed images are.
    #[arg(long, value_name = "DIR", default_value = images::INSTALLED)]
    images: PathBuf,
}

pub(crate) fn run(command: &CardCommand, as_json: bool) -> Result<()> {
    let CardCommand::Identify(arguments) = command;
    let platforms = platforms()?;
    let printed = match &arguments.printed {
        Some(printed) => printed.clone(),
        None if as_json => bail!("--json does not ask; say what is printed on the card"),
        None => ask(&platforms)?,
    };
    let platform = named(&printed, &platforms)?;
    let fpga = match arguments.no_jtag {
        true => None,
        false => Some(Loader::new(&arguments.cable).detect()),
    };
    let images = images::all(&arguments.images);
    let images: Vec<&str> = images
        .iter()
        .filter(|image| image.platform == platform.name)
        .map(|image| image.configuration.as_str())
        .collect();
    // The letters behind the size are speed and package, which the id does not tell.
    let size = platform
        .device
        .split('-')
        .take(2)
        .collect::<Vec<_>>()
        .join("-");
    if as_json {
        let fpga = fpga.and_then(Result::ok);
        say(&format!(
            "{:#}\n",
            json!({
                "platform": platform.name, "title": platform.title, "device": platform.device,
                "fpga": fpga.map(fpga_name), "images": images,
            })
        ))?;
        return Ok(());
    }
    say(&format!(
        "{}: platform \"{}\" in board files\nFPGA:   {}\n",
        platform.title, platform.name, platform.device
    ))?;
    say(&match fpga {
        None => String::new(),
        Some(Ok(id)) if fpga_name(id).contains(&size) => {
            format!("JTAG:   an {} answers, as it should\n", fpga_name(id))
        }
        Some(Ok(id)) => format!(
            "JTAG:   an {} answers, and this card has an {size}: look at the print again\n",
            fpga_name(id)
        ),
        Some(Err(JtagError::NotInstalled | JtagError::NoCable(_))) => {
            "JTAG:   no cable yet\n".to_owned()
        }
        Some(Err(error)) => format!("JTAG:   {error}\n"),
    })?;
    say(&wires())?;
    say(&match images[..] {
        [] => format!("\nNo image for it is in {}.\n", arguments.images.display()),
        [one] => format!(
            "\nImage {one}: ferrocnc flash write --card {}\n",
            platform.name
        ),
        _ => format!(
            "\nImages {}: ferrocnc flash write --card {} --board NAME\n",
            images.join(", "),
            platform.name
        ),
    })
}

/// The wires between cable and card.
fn wires() -> String {
    let mut text = "\n cable          pad of the card\n".to_owned();
    for (wire, pad) in WIRES {
        text += &format!("  {wire} o----------o {pad}\n");
    }
    text + " A cable that asks for the voltage gets 3.3 V from J33. The card itself needs its own 5 V.\n"
}

/// Those that the tool knows by itself.
fn platforms() -> Result<Vec<Platform>> {
    config::platforms(&Folder::default())
}

/// Letters and digits only: `5A-75B V8.0`, `5a75b 8.0` and `5a-75b-8.0` are one card.
fn plain(text: &str) -> String {
    let text = text.to_lowercase().replace("colorlight", "");
    let letters = text.chars().filter(char::is_ascii_alphanumeric);
    letters.filter(|letter| *letter != 'v').collect()
}

/// Prints, each with its card.
fn prints(platforms: &[Platform]) -> Vec<(&str, &Platform)> {
    let own = platforms.iter().map(|one| (one.title.as_str(), one));
    let alike = ALIKE.iter().filter_map(|(print, name)| {
        let card = platforms.iter().find(|one| one.name == *name);
        card.map(|card| (*print, card))
    });
    let mut prints: Vec<_> = own.chain(alike).collect();
    prints.sort_by_key(|(print, _)| *print);
    prints
}

fn named<'p>(printed: &str, platforms: &'p [Platform]) -> Result<&'p Platform> {
    let wanted = plain(printed);
    let prints = prints(platforms);
    let found = prints.iter().find(|(print, _)| plain(print) == wanted);
    found.map(|(_, card)| *card).with_context(|| {
        let known: Vec<&str> = prints.iter().map(|(print, _)| *print).collect();
        format!(
            "{printed:?} is no card that is known; known are {}. docs/bringup.md says how to describe another one",
            known.join(", ")
        )
    })
}

fn ask(platforms: &[Platform]) -> Result<String> {
    if !std::io::stdin().is_terminal() {
        bail!("say what is printed on the card, as in: ferrocnc card identify \"5A-75B V8.0\"");
    }
    say("Known cards:\n")?;
    for (print, _) in prints(platforms) {
        say(&format!("  {print}\n"))?;
    }
    eprint!("What is printed on yours? ");
    std::io::stderr().flush()?;
    let mut line = String::new();
    std::io::stdin().lock().read_line(&mut line)?;
    Ok(line.trim().to_owned())
}

#[cfg(test)]
mod tests {
    use super::{named, plain, platforms};

    #[test]
    fn a_card_is_known_however_its_print_is_typed() {
        let platforms = platforms().expect("platforms");
        for printed in [
            "5A-75B V8.0",
            "5a75b 8.0",
            "Colorlight 5A-75B v8.0",
            "5a-75b-8.0",
        ] {
            let found = named(printed, &platforms).expect(printed);
            assert_eq!(found.name, "5a-75b-8.0");
        }
    }

    #[test]
    fn a_card_that_is_wired_as_another_one_has_its_platform() {
        let platforms = platforms().expect("platforms");
        let found = named("5A-75E V8.0", &platforms).expect("a card");
        assert_eq!(found.name, "5a-75e-6.0");
    }

    #[test]
    fn an_unknown_card_is_answered_with_the_known_ones() {
        let error = named("i9", &platforms().expect("platforms")).expect_err("unknown");
        assert!(
            error.to_string().contains("Colorlight 5A-75E V8.2"),
            "{error}"
        );
    }

    #[test]
    fn no_two_cards_look_alike() {
        let platforms = platforms().expect("platforms");
        let prints = super::prints(&platforms);
        let names: Vec<String> = prints.iter().map(|(print, _)| plain(print)).collect();
        let mut once = names.clone();
        once.sort();
        once.dedup();
        assert_eq!(once.len(), names.len());
    }
}
