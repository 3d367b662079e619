//! Lcnc's `conf.ini`, as its `--saveconf` writes it.

use super::{Way, Written, pin};
use crate::board::{Board, Class};
use crate::error::Error;
use crate::import::{LCNC_CHANNELS, LCNC_PLATFORMS};
use crate::platform::Level;
use std::fmt::Write;

/// `assert < 16` and `assert < 32` in its `Lcnc.py`.
const fn most(class: Class) -> usize {
    match class {
        Class::Stepgen | Class::Encoder | Class::Pwm => 15,
        Class::Input | Class::Output => 31,
    }
}

/// Writes a board as Lcnc's configuration, or says all that cannot be said in it.
pub fn lcnc(board: &Board) -> Result<Written, Vec<Error>> {
    let mut way = Way::new(board, "Lcnc");
    let known = LCNC_PLATFORMS
        .iter()
        .find(|(_, _, platform)| *platform == board.platform.name);
    let (card, revision) = known.map_or(("", ""), |(card, revision, _)| (*card, *revision));
    if known.is_none() {
        let names: Vec<&str> = LCNC_PLATFORMS.iter().map(|(_, _, name)| *name).collect();
        way.refuse(
            "platform",
            &board.platform.name,
            "it does not know the card",
            &format!("it knows {}", names.join(", ")),
        );
    }
    let reset = reset(&mut way);
    way.ours_alone();
    let [a, b, c, d] = board.ipv4;
    let mac = way.mac();
    let mut text = format!(
        "[Hardware]\nboard = {card}\nrevision = {revision}\nclock = 40000000.0\nphy = {}\nip = {a}.{b}.{c}.{d}\nport = {}\nmac = {mac}\nreset_in = {reset}\n",
        board.phy, board.udp_port
    );
    for (section, class, keys) in LCNC_CHANNELS {
        channels(&mut way, &mut text, section, class, keys);
    }
    way.note(
        "Lcnc has no names: its channels are numbers, in the order of the board file.".to_owned(),
    );
    way.finish(text)
}

/// The pin that stops the machine, which Lcnc always has.
fn reset(way: &mut Way<'_>) -> String {
    let line = &way.board.ext_reset;
    match line.pin.as_deref() {
        None => way.refuse(
            "ext_reset.pin",
            "none",
            "it always has a reset pin",
            "write a free input pin",
        ),
        Some("key") => way.refuse(
            "ext_reset.pin",
            "key",
            "it knows pins of headers only",
            "write a free input pin of a header",
        ),
        Some(_) if line.active == Level::Low => way.refuse(
            "ext_reset.active",
            "low",
            "its reset pin stops the machine when it is high or open",
            "write \"high\", and wire a contact that opens",
        ),
        Some(_) => {}
    }
    line.pin.clone().unwrap_or_default()
}

fn channels(
    way: &mut Way<'_>,
    text: &mut String,
    section: &str,
    class: Class,
    keys: &[(&str, &'static str)],
) {
    let channels = way.board.of(class);
    let pins: Vec<&str> = keys.iter().map(|(_, ours)| *ours).collect();
    let _ = write!(text, "\n[{section}]\n");
    for (n, channel) in channels.iter().enumerate() {
        let key = format!("{}[{n}]", class.key());
        let kinds = class.types().first().copied();
        way.only(class, n, kinds.as_slice(), &pins);
        if channel.pins.iter().any(|(_, pin)| pin == "key") {
            way.refuse(
                &key,
                "key",
                "it knows pins of headers only",
                "write a pin of a header",
            );
        }
        if let Some(level) = channel.estop {
            way.refuse(
                &format!("{key}.estop"),
                level.word(),
                "its one stop is reset_in",
                "write the pin as ext_reset, or take estop away",
            );
        }
        if channel.safe == Some(Level::High) {
            way.refuse(
                &format!("{key}.safe"),
                "high",
                "its outputs are low while the board is dead",
                "write \"low\", and invert it outside",
            );
        }
        if channel.invert {
            way.refuse(
                &format!("{key}.invert"),
                "true",
                "only HAL inverts there",
                "take it away, and set output.NN.inv in HAL",
            );
        }
        for (ending, ours) in keys {
            let _ = writeln!(text, "{n}{ending} = {}", pin(channel, ours));
        }
    }
    if channels.len() > most(class) {
        let why = format!("it has at most {} of them", most(class));
        way.refuse(
            class.key(),
            &channels.len().to_string(),
            &why,
            "take some away",
        );
    }
    let _ = writeln!(text, "num = {}", channels.len());
}
