//! The names that a board's pins get in HAL: do they fit, and which of them have the number of
//! their channel instead of its name to fit?

use super::platform::installed;
use super::system::System;
use crate::address::Address;
use crate::client::Identity;
use crate::driver::Driver;
use crate::finding::Finding;
use crate::hal::Direction;
use crate::hal::fake::FakeHal;
use crate::link::Link;
use std::collections::BTreeSet;
use std::net::{Ipv4Addr, SocketAddrV4, UdpSocket};
use wire::board::HAL_NAME_LEN;

/// Longest names in HAL from LinuxCNC 2.10 on.
const LATER: usize = 55;
/// A pin or parameter.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Pin {
    /// Its name in HAL.
    pub name: String,
    /// The same with its channel's number, without its board: `stepgen.0.position-cmd`.
    pub logical: String,
    /// Which way it goes.
    pub direction: Direction,
}

/// All that the driver exports for this board, as board 0; `None` if this computer gives no socket.
pub fn pins(identity: &Identity) -> Option<Vec<Pin>> {
    // Nothing is sent through it.
    let socket = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).ok()?;
    let address = Address {
        text: String::new(),
        socket: SocketAddrV4::new(Ipv4Addr::LOCALHOST, 1),
    };
    let mut hal = FakeHal::new();
    let say = hal.messenger();
    let link = Link::new(socket).ok()?;
    let driver = Driver::export(&mut hal, 0, address, identity, link, say).ok()?;
    let all = driver.catalogue().iter().map(|exported| Pin {
        name: exported.name.to_string_lossy().into_owned(),
        logical: exported.logical.clone(),
        direction: exported.direction,
    });
    Some(all.collect())
}

/// The longest name against what this LinuxCNC takes.
pub fn examine(system: &System<'_>, pins: &[Pin]) -> Finding {
    let check = "names in HAL";
    let version = installed(system, "linuxcnc-uspace").unwrap_or_default();
    let limit = match is_later(&version) {
        true => LATER,
        false => HAL_NAME_LEN,
    };
    let longest = pins.iter().max_by_key(|pin| pin.name.len());
    let Some(longest) = longest.map(|pin| pin.name.as_str()) else {
        return Finding::skipped(
            check,
            "not known",
            "the board's pins could not be listed",
            "",
        );
    };
    let length = longest.len();
    if length > limit {
        return Finding::bad(
            check,
            format!("{longest} has {length} characters"),
            &format!("this LinuxCNC takes {limit}, so `loadrt ferrocnc` fails"),
            "shorter names in the board file: ferrocnc config check",
        );
    }
    let fact = format!("at most {length} characters of {limit}");
    let numbered = numbered(pins);
    match numbered.first() {
        None => Finding::good(check, fact),
        Some(first) => Finding::good(
            check,
            format!(
                "{fact}; {} have their channel's number, because its name is long, as {first}",
                numbered.len()
            ),
        ),
    }
}

/// 2.10 or later, as in `1:2.10.0~pre1`.
fn is_later(version: &str) -> bool {
    let plain = version.split_once(':').map_or(version, |it| it.1);
    let mut numbers = plain
        .split(|c: char| !c.is_ascii_digit())
        .map(str::parse::<u32>);
    match (numbers.next(), numbers.next()) {
        (Some(Ok(major)), Some(Ok(minor))) => (major, minor) >= (2, 10),
        _ => false,
    }
}

/// Pins by the number of a channel that has a name: other pins of it have the name.
fn numbered(pins: &[Pin]) -> Vec<&str> {
    // `ferrocnc.0.encoder.spindle.position` and `encoder.5.position`
    let channel = |pin: &Pin| {
        let name = pin.name.split('.').nth(3)?.to_owned();
        let (channel, _) = pin.logical.rsplit_once('.')?;
        Some((channel.to_owned(), name))
    };
    let all: Vec<_> = pins
        .iter()
        .filter_map(|pin| Some((pin, channel(pin)?)))
        .collect();
    let is_number = |name: &str| name.bytes().all(|byte| byte.is_ascii_digit());
    let is_named: BTreeSet<&str> = all
        .iter()
        .filter(|(_, (_, name))| !is_number(name))
        .map(|(_, (channel, _))| channel.as_str())
        .collect();
    all.iter()
        .filter(|(_, (channel, name))| is_number(name) && is_named.contains(channel.as_str()))
        .map(|(pin, _)| pin.name.as_str())
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::finding::Verdict;

    fn pin(name: &str, logical: &str) -> Pin {
        Pin {
            name: name.to_owned(),
            logical: logical.to_owned(),
            direction: Direction::Out,
        }
    }

    #[test]
    fn a_later_linuxcnc_takes_longer_names() {
        for (version, later) in [
            ("1:2.9.0~pre1+git20230208-1", false),
            ("2.9.4", false),
            ("1:2.10.0~pre1", true),
            ("", false),
        ] {
            assert_eq!(is_later(version), later, "{version}");
        }
    }

    #[test]
    fn a_pin_that_has_lost_its_channels_name_is_told() {
        let mask = "ferrocnc.0.encoder.01.index-mask-invert";
        let all = [
            pin("ferrocnc.0.encoder.spindle.position", "encoder.1.position"),
            pin(mask, "encoder.1.index-mask-invert"),
            pin("ferrocnc.0.encoder.00.position", "encoder.0.position"),
        ];
        assert_eq!(numbered(&all), [mask], "channel 0 has no name");
    }

    #[test]
    fn a_name_that_hal_does_not_take_is_bad() {
        let system = System {
            root: "/nowhere".into(),
            ..System::real()
        };
        let long = format!("ferrocnc.0.{}", "x".repeat(50));
        let finding = examine(&system, &[pin(&long, "x")]);
        assert_eq!(finding.verdict, Verdict::Bad, "{finding:?}");
        assert!(finding.remedy.contains("shorter names"), "{finding:?}");
        assert_eq!(examine(&system, &[]).verdict, Verdict::Skipped);
        let short = examine(&system, &[pin("ferrocnc.0.enable", "enable")]);
        assert_eq!(short.verdict, Verdict::Good);
    }
}
