//! One channel of a machine, as a table of the board file describes it.

use super::class::{Class, PinKey};
use super::wiring::Wiring;
use crate::error::Error;
use crate::hal;
use crate::platform::Level;
use crate::tree::At;
use std::collections::BTreeMap;
use std::fmt::Write;
use wire::channels::WORD_PINS;

/// One channel.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Channel {
    /// As HAL will call it.
    pub name: String,
    /// One of the class' types; empty where it has none.
    pub kind: String,
    /// Key and pin, in the order of [`Class::pins`]; only those it has.
    pub pins: Vec<(&'static str, String)>,
    /// Inputs: the level that stops.
    pub estop: Option<Level>,
    /// Outputs: the level of the pin while not armed.
    pub safe: Option<Level>,
    /// Outputs: the pin is the other way round.
    pub invert: bool,
    /// Inputs and outputs: the number in LiteX-CNC's row of both.
    pub litexcnc: Option<u8>,
    /// The name in LiteX-CNC's JSON.
    pub litexcnc_name: Option<String>,
}

impl Channel {
    /// A channel of the class' usual type on these pins. An output is safe low.
    pub fn new(class: Class, name: String, pins: Vec<(&'static str, String)>) -> Self {
        let usual = class.types().first().copied();
        Channel {
            name,
            kind: usual.unwrap_or_default().to_owned(),
            pins,
            estop: None,
            safe: (class == Class::Output).then_some(Level::Low),
            invert: false,
            litexcnc: None,
            litexcnc_name: None,
        }
    }

    /// The safe level of an output as the cores have it: `gpio.sv` turns it over with the rest.
    pub fn is_safe_high(&self) -> bool {
        (self.safe == Some(Level::High)) != self.invert
    }

    /// The pin of a key.
    pub fn pin(&self, key: &str) -> Option<&str> {
        self.pins
            .iter()
            .find(|(known, _)| *known == key)
            .map(|(_, pin)| pin.as_str())
    }

    /// The pins and what else the host should know, as the blob tells it: `step=j1:0 dir=j1:1
    /// type=up_down`. A type that would be meant anyway is not written.
    pub fn text(&self, class: Class) -> String {
        let mut text = String::new();
        for (key, pin) in &self.pins {
            let _ = write!(text, "{key}={pin} ");
        }
        if !self.kind.is_empty() && class.types().first() != Some(&self.kind.as_str()) {
            let _ = write!(text, "type={} ", self.kind);
        }
        if let Some(level) = self.estop {
            let _ = write!(text, "estop={} ", level.word());
        }
        if self.safe == Some(Level::High) {
            text += "safe=high ";
        }
        if self.invert {
            text += "invert=true ";
        }
        if let Some(number) = self.litexcnc {
            let _ = write!(text, "gpio={number} ");
        }
        if let Some(name) = &self.litexcnc_name {
            // The board has little room: nothing means the name above.
            let name = Some(name).filter(|name| **name != self.name);
            let _ = write!(text, "as={} ", name.map_or("", String::as_str));
        }
        text.truncate(text.trim_end().len());
        text
    }

    /// Whether it cannot do without a pin.
    pub(super) fn needs(&self, (key, needed, _): &PinKey) -> bool {
        *needed && !(self.kind == "counter" && *key == "b")
    }

    /// Reads the table of number `n` of its class. `names` are those of the class so far.
    pub(super) fn read(
        at: &At<'_>,
        class: Class,
        n: usize,
        names: &mut BTreeMap<String, usize>,
        wiring: &mut Wiring<'_>,
    ) -> Result<Self, Error> {
        let name = own_name(at, class)?;
        if let Some(other) = names.insert(name.to_owned(), n) {
            return Err(at.error(
                "name",
                &format!("{name:?}"),
                format!("is already {}[{other}]'s", class.key()),
                "give every channel of a kind a name of its own",
            ));
        }
        let mut channel = Channel {
            name: name.to_owned(),
            kind: at
                .text_if("type")
                .or(class.types().first().copied())
                .unwrap_or_default()
                .to_owned(),
            pins: Vec::new(),
            estop: Level::of(at.text_if("estop")),
            safe: Level::of(at.text_if("safe")),
            invert: at.flag_if("invert").unwrap_or(false),
            litexcnc: at
                .integer_if("litexcnc")
                .and_then(|number| u8::try_from(number).ok()),
            litexcnc_name: litexcnc_name(at, class)?,
        };
        for (key, _, drives) in class.pins() {
            if let Some(pin) = wiring.pin(at, key, *drives)? {
                channel.pins.push((key, pin));
            }
        }
        channel.judge_pins(at, class)?;
        if n >= usize::from(WORD_PINS)
            && let Some(level) = channel.estop
        {
            return Err(at.error(
                "estop",
                &format!("{:?}", level.word()),
                format!("stands at input {n}, and only the first {WORD_PINS} can stop the machine"),
                "write this [[gpio_in]] further up in the file",
            ));
        }
        Ok(channel)
    }

    /// Refuses pins that do not make a whole channel of its type.
    fn judge_pins(&self, at: &At<'_>, class: Class) -> Result<(), Error> {
        // A channel without any pin is one for simulation; one with some but not all is a mistake.
        if !self.pins.is_empty() {
            for key in class.pins().iter().filter(|key| self.needs(key)) {
                if self.pin(key.0).is_none() {
                    let other = self.pins[0].0;
                    let copy = format!("{}_n", key.0);
                    let remedy = match self.pin(&copy) {
                        Some(pin) => {
                            format!("{copy} = {pin:?} is its inverted copy; write {} too", key.0)
                        }
                        None => format!("write it, as in {} = \"j1:0\"", key.0),
                    };
                    return Err(at.error(
                        key.0,
                        "",
                        format!("is missing though {other} is there"),
                        remedy,
                    ));
                }
            }
        }
        if self.kind == "counter" && self.pin("b").is_some() {
            return Err(at.error(
                "b",
                "",
                "has no meaning for type = \"counter\", which counts a alone",
                "take b or the type away",
            ));
        }
        if class == Class::Pwm
            && matches!(self.kind.as_str(), "up_down" | "dir_pwm")
            && !self.pins.is_empty()
            && self.pin("dir").is_none()
        {
            return Err(at.error(
                "dir",
                "",
                format!("is missing: type = \"{}\" needs two pins", self.kind),
                "write dir, the second one, or take the type away",
            ));
        }
        Ok(())
    }
}

/// What LiteX-CNC called it, if it had a name there.
fn litexcnc_name(at: &At<'_>, class: Class) -> Result<Option<String>, Error> {
    let Some(name) = at.text_if("litexcnc_name") else {
        return Ok(None);
    };
    let hal = class.hal();
    let wrong = |problem: String, remedy: String| {
        Err(at.error("litexcnc_name", &format!("{name:?}"), problem, remedy))
    };
    if !wire::board::is_foreign_name(name) {
        return wrong(
            "cannot be part of a name in a HAL file".to_owned(),
            "write it as LiteX-CNC's JSON has it, as in \"j1:10\", or take it away".to_owned(),
        );
    }
    if name.len() > hal.litexcnc_room() {
        let pin = hal.litexcnc_pin("b", name);
        return wrong(
            format!(
                "is too long: HAL takes {} characters and {pin} has {}",
                wire::board::HAL_NAME_LEN,
                pin.len()
            ),
            "shorten it, here and in the HAL file".to_owned(),
        );
    }
    Ok(Some(name.to_owned()))
}

/// Its name, if HAL can bear that.
fn own_name<'a>(at: &At<'a>, class: Class) -> Result<&'a str, Error> {
    let name = at.text("name").unwrap_or_default();
    let shown = format!("{name:?}");
    let hal = class.hal();
    if !hal::is_name(name) {
        let better = hal::nearest_name(name, hal.room());
        let hint = if better.is_empty() {
            String::new()
        } else {
            format!(", as in \"{better}\"")
        };
        return Err(at.error(
            "name",
            &shown,
            "cannot be part of a HAL name",
            format!("use a-z, 0-9 and hyphens, a letter first{hint}"),
        ));
    }
    if name.len() > hal.room() {
        let pin = hal.pin(name);
        return Err(at.error(
            "name",
            &shown,
            format!(
                "is too long: HAL has {} characters and {pin} is {}",
                wire::board::HAL_NAME_MAX,
                pin.len()
            ),
            format!("use up to {} characters for a {}", hal.room(), class.key()),
        ));
    }
    Ok(name)
}
