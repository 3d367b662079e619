//! Lcnc's `conf.ini`, as its GUI and `--saveconf` write it.

use super::ini::{Section, parse, refuse_machine};
use super::{Draft, Imported, mac};
use crate::board::{Channel, Class, ControlInput, Platforms};
use crate::error::{Error, Place, Report};
use crate::platform::Level;
use crate::tree::nearest;

/// A section's name, what it becomes, its keys' endings and ours.
pub(crate) type Channels = (&'static str, Class, &'static [(&'static str, &'static str)]);

/// Its sections: their keys' endings after the channel's number, and what they become.
pub(crate) const CHANNELS: [Channels; 5] = [
    ("inputs", Class::Input, &[("", "pin")]),
    ("outputs", Class::Output, &[("", "pin")]),
    ("pwms", Class::Pwm, &[("", "pin")]),
    ("encoders", Class::Encoder, &[("_a", "a"), ("_b", "b")]),
    (
        "stepgens",
        Class::Stepgen,
        &[("_step", "step"), ("_dir", "dir")],
    ),
];
const HARDWARE: [&str; 8] = [
    "board", "revision", "clock", "phy", "ip", "port", "mac", "reset_in",
];

/// Board and revision -> platform.
pub(crate) const PLATFORMS: &[(&str, &str, &str)] = &[
    ("5a-75b", "6.1", "5a-75b-6.1"),
    ("5a-75b", "7.0", "5a-75b-7.0"),
    ("5a-75b", "8.0", "5a-75b-8.0"),
    ("5a-75b", "8.2", "5a-75b-8.2"),
    ("5a-75e", "6.0", "5a-75e-6.0"),
    ("5a-75e", "7.1", "5a-75e-7.1"),
    ("5a-75e", "8.0", "5a-75e-6.0"),
    ("5a-75e", "8.2", "5a-75e-8.2"),
];

/// Imports an INI file's text under a name of its own.
pub fn lcnc(
    file: &str,
    text: &str,
    name: &str,
    platforms: &dyn Platforms,
) -> Result<Imported, Error> {
    refuse_machine(
        file,
        text,
        "the conf.ini with [Hardware] that Lcnc built the bitstream from, or that its --saveconf writes",
    )?;
    let sections = parse(file, text)?;
    let hardware = Hardware {
        file,
        section: find(file, &sections, "Hardware")?,
    };
    only_known(file, &sections)?;
    hardware.only_known()?;
    let mut draft = Draft::new(file, name, hardware.platform()?, platforms)?;
    "Lcnc.00".clone_into(&mut draft.prefix);
    hardware.clock(&mut draft)?;
    hardware.network(&mut draft)?;
    let reset = hardware.get("reset_in")?;
    // High or open is dead, as Lcnc has it.
    draft.board.ext_reset = ControlInput {
        pin: Some(reset.0.to_owned()),
        active: Level::High,
    };
    draft.origin("ext_reset.pin", "[Hardware] reset_in", Some(reset.1));

    for (name, class, keys) in CHANNELS {
        channels(&mut draft, file, find(file, &sections, name)?, class, keys)?;
    }
    let head = "Imported from Lcnc. Its channels keep their numbers; `names=lcnc` gives them their old HAL names (docs/migration.md).".to_owned();
    draft.finish(head)
}

/// Refuses sections that Lcnc does not have.
fn only_known(file: &str, sections: &[Section<'_>]) -> Result<(), Error> {
    let known = || {
        CHANNELS
            .iter()
            .map(|(name, _, _)| *name)
            .chain(["Hardware"])
    };
    let Some(section) = sections
        .iter()
        .find(|section| !known().any(|name| name == section.name))
    else {
        return Ok(());
    };
    let near = nearest(section.name, known())
        .map_or(String::new(), |near| format!(" (did you mean [{near}]?)"));
    Err(error(
        file,
        section.place,
        &format!("[{}]", section.name),
        "",
        format!("is a section Lcnc does not have{near}"),
        "take it away".to_owned(),
    ))
}

fn channels(
    draft: &mut Draft<'_>,
    file: &str,
    section: &Section<'_>,
    class: Class,
    keys: &[(&str, &'static str)],
) -> Result<(), Error> {
    let path = |key: &str| format!("[{}] {key}", section.name);
    let mut entries = section.entries.iter();
    let mut number = 0;
    let mut count = None;
    let mut pins = Vec::new();
    let mut first = None;
    for entry in entries.by_ref() {
        if entry.key == "num" {
            count = Some((entry.value, entry.place));
            continue;
        }
        let (ending, ours) = keys[pins.len() % keys.len()];
        let wanted = format!("{number}{ending}");
        if entry.key != wanted {
            return Err(error(
                file,
                entry.place,
                &path(&entry.key),
                "",
                format!("is in the place of {wanted}"),
                "Lcnc numbers channels by the order of the lines; bring numbers and lines together"
                    .to_owned(),
            ));
        }
        first.get_or_insert(entry.place);
        pins.push((ours, entry.value.to_owned()));
        if pins.len() == keys.len() {
            draft.push(
                class,
                None,
                Channel::new(class, String::new(), std::mem::take(&mut pins)),
                path(&number.to_string()),
                first.take(),
            );
            number += 1;
        }
    }
    if let Some((key, _)) = pins.first() {
        return Err(error(
            file,
            section.place,
            &path(&number.to_string()),
            "",
            format!("has {key} and not all of its pins"),
            "write them all".to_owned(),
        ));
    }
    match count {
        Some((value, _)) if value.parse() == Ok(number) => Ok(()),
        Some((value, place)) => Err(error(
            file,
            place,
            &path("num"),
            value,
            format!("is not the number of channels above, {number}"),
            "correct it, or add what is missing".to_owned(),
        )),
        None => Err(error(
            file,
            section.place,
            &path("num"),
            "",
            "is missing".to_owned(),
            format!("write num = {number}"),
        )),
    }
}

fn find<'s, 't>(
    file: &str,
    sections: &'s [Section<'t>],
    name: &str,
) -> Result<&'s Section<'t>, Error> {
    sections
        .iter()
        .find(|section| section.name == name)
        .ok_or_else(|| {
            let report = Report {
                file: file.to_owned(),
                place: None,
                key: format!("[{name}]"),
                value: String::new(),
                problem: "is missing".to_owned(),
                remedy: "a conf.ini of Lcnc is wanted, as its --saveconf writes it".to_owned(),
            };
            Error::from(report)
        })
}

fn error(
    file: &str,
    place: Place,
    key: &str,
    value: &str,
    problem: String,
    remedy: String,
) -> Error {
    let value = if value.is_empty() {
        String::new()
    } else {
        format!("{value:?}")
    };
    Error::from(Report {
        file: file.to_owned(),
        place: Some(place),
        key: key.to_owned(),
        value,
        problem,
        remedy,
    })
}

struct Hardware<'s, 't> {
    file: &'s str,
    section: &'s Section<'t>,
}

impl<'t> Hardware<'_, 't> {
    fn only_known(&self) -> Result<(), Error> {
        let unknown = self
            .section
            .entries
            .iter()
            .find(|entry| !HARDWARE.contains(&entry.key.as_str()));
        unknown.map_or(Ok(()), |entry| {
            let near = nearest(&entry.key, HARDWARE.into_iter())
                .map_or(String::new(), |near| format!(" (did you mean {near}?)"));
            Err(error(
                self.file,
                entry.place,
                &format!("[Hardware] {}", entry.key),
                "",
                format!("is not a known key{near}"),
                format!("the keys are {}", HARDWARE.join(", ")),
            ))
        })
    }

    fn get(&self, key: &str) -> Result<(&'t str, Place), Error> {
        let entry = self.section.entries.iter().find(|entry| entry.key == key);
        entry
            .map(|entry| (entry.value, entry.place))
            .ok_or_else(|| {
                error(
                    self.file,
                    self.section.place,
                    &format!("[Hardware] {key}"),
                    "",
                    "is missing".to_owned(),
                    format!("a conf.ini of Lcnc has {}", HARDWARE.join(", ")),
                )
            })
    }

    /// The value of a key as `parse` understands it, and its place.
    fn read<T>(
        &self,
        key: &str,
        parse: impl Fn(&'t str) -> Option<T>,
        problem: &str,
        remedy: &str,
    ) -> Result<(T, Place), Error> {
        let (text, place) = self.get(key)?;
        let value = parse(text);
        let value = value
            .ok_or_else(|| self.wrong(key, (text, place), problem.to_owned(), remedy.to_owned()))?;
        Ok((value, place))
    }

    /// The platform with this board and revision.
    fn platform(&self) -> Result<&'static str, Error> {
        let (board, revision) = (self.get("board")?, self.get("revision")?);
        let mut known = PLATFORMS.iter();
        if let Some((_, _, platform)) = known.find(|(b, r, _)| *b == board.0 && *r == revision.0) {
            return Ok(platform);
        }
        let known: Vec<String> = PLATFORMS
            .iter()
            .map(|(b, r, _)| format!("{b} {r}"))
            .collect();
        Err(self.wrong(
            "revision",
            revision,
            format!("is not a revision of \"{}\" we know", board.0),
            format!("there is {}", known.join(", ")),
        ))
    }

    /// The clock, which is another here.
    fn clock(&self, draft: &mut Draft<'_>) -> Result<(), Error> {
        let (hz, _) = self.read(
            "clock",
            |text| {
                let hz = text.parse().ok();
                hz.filter(|hz: &f64| hz.is_finite() && *hz > 0.0)
            },
            "is not a frequency",
            "write it in hertz, as in 40000000.0",
        )?;
        draft.notes.push(format!(
            "The clock is 60 MHz, not {} MHz: the driver asks the board, nothing in HAL changes.",
            hz / 1e6
        ));
        Ok(())
    }

    /// Jack and addresses.
    fn network(&self, draft: &mut Draft<'_>) -> Result<(), Error> {
        (draft.board.phy, _) = self.read(
            "phy",
            |text| match text {
                "0" => Some(0),
                "1" => Some(1),
                _ => None,
            },
            "is neither 0 nor 1",
            "write the number of the jack you use",
        )?;
        let (address, place) = self.read(
            "ip",
            |text| text.parse::<std::net::Ipv4Addr>().ok(),
            "is not an IPv4 address",
            "write it as in 192.168.2.50",
        )?;
        draft.board.ipv4 = address.octets();
        draft.origin("network.ipv4", "[Hardware] ip", Some(place));
        (draft.board.udp_port, _) = self.read(
            "port",
            |text| text.parse().ok().filter(|port: &u16| *port != 0),
            "is not a UDP port",
            "write 1 to 65535",
        )?;
        let (address, place) = self.read(
            "mac",
            mac,
            "is not a MAC address",
            "write it as in 0x10e2d5000000",
        )?;
        draft.board.mac = Some(address);
        draft.origin("network.mac", "[Hardware] mac", Some(place));
        Ok(())
    }

    fn wrong(
        &self,
        key: &str,
        (value, place): (&str, Place),
        problem: String,
        remedy: String,
    ) -> Error {
        error(
            self.file,
            place,
            &format!("[Hardware] {key}"),
            value,
            problem,
            remedy,
        )
    }
}
