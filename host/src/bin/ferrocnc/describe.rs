//! `ferrocnc describe`: prints a board's description of itself.

use crate::text::version;
use anyhow::{Result, bail};
use ferrocnc::client::{Client, Identity};
use ferrocnc::flash::Overview;
use ferrocnc::pins::remedy;
use ferrocnc::selftest::{gather, ways};
use ferrocnc::uid::{mac_text, uid_text};
use serde_json::{Value, json};
use std::io::Write;
use std::net::Ipv4Addr;
use wire::board::{Blob, Kind};
use wire::describe::Channels;
use wire::describe::{
    Describe, FEATURE_JOBS, JobsState, OBSTACLE_ABI, OBSTACLE_FLASH, OBSTACLE_PINS,
};
use wire::map;
use wire::pins::{Loaded, Verdict};
use wire::refusal::COUNTERS_CALLS;
use wire::settings::mac_of_uid;

pub(crate) fn run(client: &mut Client, as_json: bool) -> Result<()> {
    let description = Description::read(client)?;
    let mut out = std::io::stdout().lock();
    if as_json {
        writeln!(out, "{:#}", description.to_json())?;
    } else {
        write!(out, "{}", to_text(&description))?;
    }
    Ok(())
}

/// All that a board says of itself.
pub(crate) struct Description {
    identity: Identity,
    overview: Overview,
    calls: Calls,
    ways: ways::Facts,
    /// What became of the configuration of the pins, where they are configured.
    pins: Option<Loaded>,
}

impl Description {
    pub(crate) fn read(client: &mut Client) -> Result<Self> {
        let identity = client.identify()?;
        let pins = match identity.has_configured_pins() {
            true => Loaded::from_word(client.read(&[map::FLASH_PINS])?[0]),
            false => None,
        };
        Ok(Description {
            identity,
            pins,
            overview: Overview::read(client)?,
            calls: Calls::read(client)?,
            ways: gather::ways(client)?,
        })
    }

    pub(crate) fn to_json(&self) -> Value {
        let mut value = to_json(&self.identity, &self.overview);
        value["services_longest_call"] = self.calls.to_json();
        value["exchanges"] = ways_to_json(&self.ways);
        value["pins"] = json!(self.pins.map(|pins| pins.verdict.text()));
        value
    }
}

/// Clocks of the longest call of the services since the board's start.
#[derive(Clone, Copy)]
struct Calls {
    /// While a host moved the machine.
    moving: u32,
    /// At any other time.
    other: u32,
}

impl Calls {
    fn read(client: &mut Client) -> Result<Self> {
        let words = client.read_from(COUNTERS_CALLS, 2)?;
        let [moving, other] = words[..] else {
            bail!("the board answered {} words instead of two", words.len());
        };
        Ok(Calls { moving, other })
    }

    fn to_json(self) -> Value {
        json!({ "moving": self.moving, "else": self.other })
    }
}

/// Exchanges since the board's start, by the way they took.
pub(crate) fn ways_to_json(ways: &ways::Facts) -> Value {
    json!({ "fast": ways.fast, "long": ways.long, "last_long": ways.text() })
}

/// Names of one kind's channels, with their header pins.
fn channels(blob: &Blob<'_>, kind: Kind, class: char, numbers: &[u8]) -> Vec<(String, String)> {
    let pins = |n: u8| {
        let mut of_class = blob.entries().filter(|entry| {
            entry.kind == Kind::Pins
                && entry.channel == n
                && entry.value.first().copied() == Some(class as u8)
        });
        let text = of_class
            .next()
            .and_then(|entry| std::str::from_utf8(&entry.value[1..]).ok());
        text.unwrap_or("").to_owned()
    };
    { numbers.iter() }
        .map(|n| {
            let name = blob.text(kind, *n).unwrap_or("");
            (name.to_owned(), pins(*n))
        })
        .collect()
}

/// The kinds of channels, and the letters of their pins.
const CLASSES: [(&str, Kind, char); 5] = [
    ("stepgen", Kind::Stepgen, 's'),
    ("encoder", Kind::Encoder, 'e'),
    ("pwm", Kind::Pwm, 'p'),
    ("input", Kind::Input, 'i'),
    ("output", Kind::Output, 'o'),
];

/// Names and pins of the channels of a board, in its board file's order.
pub(crate) fn classes(identity: &Identity) -> [(&'static str, Vec<(String, String)>); 5] {
    CLASSES.map(|(class, kind, letter)| {
        let numbers = identity.numbers(kind);
        (class, channels(&identity.blob(), kind, letter, &numbers))
    })
}

/// The same of a board info blob whose channels have the numbers from 0 on.
pub(crate) fn classes_of(
    blob: &Blob<'_>,
    counts: Channels,
) -> [(&'static str, Vec<(String, String)>); 5] {
    let counts = [
        counts.stepgens,
        counts.encoders,
        counts.pwms,
        counts.inputs,
        counts.outputs,
    ];
    let mut of_class = counts.into_iter();
    CLASSES.map(|(class, kind, letter)| {
        let numbers: Vec<u8> = (0..of_class.next().unwrap_or(0)).collect();
        (class, channels(blob, kind, letter, &numbers))
    })
}

fn network(identity: &Identity) -> (Option<String>, Option<String>, Option<u16>) {
    let blob = identity.blob();
    let value = |kind| {
        blob.entries()
            .find(|entry| entry.kind == kind)
            .map(|entry| entry.value)
    };
    let mac = value(Kind::Mac).map(|bytes| {
        let parts: Vec<String> = bytes.iter().map(|b| format!("{b:02x}")).collect();
        parts.join(":")
    });
    let ip = value(Kind::Ipv4).map(|bytes| {
        let parts: Vec<String> = bytes.iter().map(u8::to_string).collect();
        parts.join(".")
    });
    let port = value(Kind::Port).and_then(|bytes| bytes.try_into().ok().map(u16::from_be_bytes));
    (mac, ip, port)
}

/// The state of the services, and what it means for the operator.
fn services(features: u32) -> (JobsState, String) {
    let state = JobsState::of(features);
    let remedy = match state {
        JobsState::Alive if features & FEATURE_JOBS != 0 => {
            "consoles, DHCP; `ferrocnc job` sends and starts jobs"
        }
        JobsState::Alive => "consoles, DHCP",
        JobsState::Streamed => "the board stores no jobs, and has no console and no DHCP",
        JobsState::None => "the board has no console and no DHCP",
        JobsState::Sdram => {
            "bad solder joints or a bad chip; everything but consoles, DHCP and jobs works"
        }
        JobsState::Missing => {
            "`ferrocnc update` with this board's .bit; an image loaded by JTAG has none"
        }
        JobsState::Ended => {
            "the board loads them again when no host owns it; `ferrocnc log` says where"
        }
        JobsState::GivenUp => {
            "the machine goes on without them; `ferrocnc log` says where; restart the board"
        }
        JobsState::Loading => "it goes on whenever no host owns the board",
        JobsState::Damaged => {
            "`ferrocnc update` with this board's .bit; if that changes nothing, the SDRAM is faulty"
        }
        JobsState::Foreign => "`ferrocnc update` with this board's .bit",
    };
    (state, format!("{}: {remedy}", state.text()))
}

fn has_uid(overview: &Overview) -> bool {
    overview.uid != [0, 0]
}

/// Identity, running image, origin of the settings, state of the link.
fn flash_lines(overview: &Overview) -> Vec<(&'static str, String)> {
    let mut lines = Vec::new();
    if has_uid(overview) {
        lines.push(("unique id", uid_text(overview.uid)));
    }
    let flash = match (overview.jedec, overview.layout) {
        (0, _) => "none answers".to_owned(),
        (jedec, None) => format!("JEDEC id {jedec:06x}, of an unknown kind"),
        (jedec, Some(layout)) => {
            let golden = match overview.protected {
                true => "golden image protected",
                false => "golden image not protected",
            };
            format!("JEDEC id {jedec:06x}, {} MiB, {golden}", layout.size >> 20)
        }
    };
    lines.push(("flash", flash));
    let next = match overview.selected {
        Some(slot) => format!("slot {slot}"),
        None => "golden".to_owned(),
    };
    let build = overview.build_id;
    lines.push((
        "image",
        format!(
            "runs {}, build {build:08x}; after power-up {next}",
            overview.running
        ),
    ));
    match overview.settings {
        Ok(settings) => {
            let name = match settings.name.text() {
                "" => "unnamed".to_owned(),
                name => format!("\"{name}\""),
            };
            let by = if settings.dhcp { "DHCP, else " } else { "" };
            let ip = Ipv4Addr::from(settings.ip);
            lines.push((
                "settings",
                format!(
                    "{name}, {by}{ip}/{}:{}, MAC {} ({})",
                    settings.prefix,
                    settings.port,
                    match settings.mac == mac_of_uid(overview.uid) {
                        true => format!("{} from the unique id", mac_text(settings.mac)),
                        false => mac_text(settings.mac),
                    },
                    overview.origin
                ),
            ));
        }
        Err(error) => lines.push(("settings", error.to_string())),
    }
    let link = overview.link;
    let duplex = if link.full_duplex {
        "full duplex"
    } else {
        "half duplex"
    };
    lines.push((
        "link",
        match link.speed {
            wire::LinkSpeed::Down => format!("down, {} frames thrown away", link.errors),
            wire::LinkSpeed::M10 | wire::LinkSpeed::M100 | wire::LinkSpeed::M1000 => format!(
                "{}, {duplex}, {} frames thrown away",
                link.speed, link.errors
            ),
        },
    ));
    lines
}

fn to_json(identity: &Identity, overview: &Overview) -> Value {
    let describe = &identity.describe;
    let blob = identity.blob();
    let (mac, ip, port) = network(identity);
    let mut value = json!({
        "board": blob.text(Kind::Board, 0),
        "configuration": blob.text(Kind::Configuration, 0),
        "wire_version": describe.wire_version,
        "abi_firmware": describe.abi_firmware,
        "abi_gateware": describe.abi_gateware,
        "firmware_version": version(describe.firmware_version),
        "gateware_version": version(describe.gateware_version),
        "clock_hz": describe.clock_hz,
        "boot_id": describe.boot_id,
        "state": describe.state.state.text(),
        "fault_reason": describe.state.reason.text(),
        "enabled": describe.state.enabled,
        "position_trusted": describe.state.position_trusted,
        "bitten": describe.state.bitten,
        "external_reset": describe.state.external_reset,
        "estop": describe.state.estop,
        "obstacles": describe.obstacles,
        "services": services(describe.features).0.text(),
        "jobs": describe.features & FEATURE_JOBS != 0,
        "last_reset_reason": describe.reset_reason.text(),
        "last_gate_close": describe.gate_close.text(),
        "default_mac": mac,
        "default_ip": ip,
        "default_port": port,
        "fpga": blob.text(Kind::Fpga, 0),
        "platform": blob.text(Kind::Platform, 0),
        "uid": has_uid(overview).then(|| uid_text(overview.uid)),
        "flash": {
            "jedec": format!("{:06x}", overview.jedec),
            "bytes": overview.layout.map(|layout| layout.size),
            "golden_protected": overview.protected,
        },
        "running": overview.running.text(),
        "build_id": format!("{:08x}", overview.build_id),
        "selected": overview.selected.map(|slot| slot.text()),
        "ip": overview.ip.to_string(),
        "settings_origin": overview.origin.text(),
        "settings": overview.settings.ok().map(|settings| json!({
            "name": settings.name.text(),
            "dhcp": settings.dhcp,
            "ip": Ipv4Addr::from(settings.ip).to_string(),
            "prefix": settings.prefix,
            "gateway": Ipv4Addr::from(settings.gateway).to_string(),
            "mac": mac_text(settings.mac),
            "port": settings.port,
            "syslog": Ipv4Addr::from(settings.syslog).to_string(),
            "sntp": Ipv4Addr::from(settings.sntp).to_string(),
        })),
        "link": {
            "mbit": overview.link.speed.mbit(),
            "full_duplex": overview.link.full_duplex,
            "errors": overview.link.errors,
        },
    });
    for (class, list) in classes(identity) {
        value[class] = list
            .into_iter()
            .map(|(name, pins)| json!({ "name": name, "pins": pins }))
            .collect();
    }
    value
}

/// What became of the configuration of the pins, and what to do about it.
fn configured(pins: Loaded) -> String {
    let verdict = pins.verdict;
    match verdict {
        Verdict::InForce => format!(
            "configured by the board file above, copy {}",
            pins.copy.unwrap_or(0)
        ),
        _ => format!(
            "nothing is driven; the stored board file: {verdict}; {}",
            remedy(verdict)
        ),
    }
}

/// The state, what stopped it, and why it would not arm.
fn doing(describe: &Describe) -> String {
    let state = &describe.state;
    let mut doing = state.state.text().to_owned();
    if state.reason != wire::FaultReason::None {
        doing += &format!(", stopped by {}", state.reason);
    }
    if describe.obstacles & OBSTACLE_ABI != 0 {
        doing += ", will not arm: ABI mismatch";
    }
    if describe.obstacles & OBSTACLE_FLASH != 0 {
        doing += ", will not arm while its flash is written";
    }
    if describe.obstacles & OBSTACLE_PINS != 0 {
        doing += ", will not arm: its board file is not one for it";
    }
    doing
}

fn to_text(description: &Description) -> String {
    use std::fmt::Write;
    let Description {
        identity,
        overview,
        calls,
        ways,
        pins,
    } = description;
    let describe = &identity.describe;
    let blob = identity.blob();
    let mut text = String::new();
    let mut line = |name: &str, value: String| {
        // Writing to a String cannot fail.
        let _ = writeln!(text, "{name:<10} {value}");
    };
    line(
        "board",
        format!(
            "{}, configuration {}",
            blob.text(Kind::Board, 0).unwrap_or("unnamed"),
            blob.text(Kind::Configuration, 0).unwrap_or("unnamed")
        ),
    );
    line(
        "versions",
        format!(
            "firmware {}, gateware {}, wire {}",
            version(describe.firmware_version),
            version(describe.gateware_version),
            describe.wire_version
        ),
    );
    line(
        "abi",
        if describe.abi_firmware == describe.abi_gateware {
            format!("{:#010x}", describe.abi_firmware)
        } else {
            format!(
                "firmware {:#010x}, gateware {:#010x}: flash a matching pair",
                describe.abi_firmware, describe.abi_gateware
            )
        },
    );
    line(
        "clock",
        format!("{} MHz", f64::from(describe.clock_hz) / 1e6),
    );
    line("boot id", format!("{:#010x}", describe.boot_id));
    line("state", doing(describe));
    if let Some(pins) = pins {
        line("pins", configured(*pins));
    }
    line(
        "last",
        format!(
            "started by {}, gate: {}",
            describe.reset_reason, describe.gate_close
        ),
    );
    line("services", services(describe.features).1);
    line(
        "",
        format!(
            "longest call {} clocks while a host moved the machine, {} else",
            calls.moving, calls.other
        ),
    );
    line("exchanges", ways.to_string());
    if let (Some(mac), Some(ip), Some(port)) = network(identity) {
        line("default", format!("{ip}:{port}, MAC {mac}"));
    }
    for (name, value) in flash_lines(overview) {
        line(name, value);
    }
    for ((class, list), (_, kind, _)) in classes(identity).into_iter().zip(CLASSES) {
        let mut heads = core::iter::once(format!("{class} "));
        for (n, (name, pins)) in identity.numbers(kind).into_iter().zip(list) {
            let head = heads.next().unwrap_or_default();
            line(
                &head,
                format!("{n:>2}  {name:<16} {pins}").trim_end().to_owned(),
            );
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_state_of_the_services_is_told_in_words_of_its_own() {
        let mut seen = std::collections::BTreeSet::new();
        for state in JobsState::ALL {
            let features = FEATURE_JOBS | state.code() << JobsState::AT;
            let (told, text) = services(features);
            assert_eq!(told, *state);
            assert!(seen.insert(text.clone()), "{text}");
        }
        assert_eq!(seen.len(), 10);
        let (_, text) = services(JobsState::Sdram.code() << JobsState::AT);
        assert!(text.starts_with("the SDRAM failed its test: "), "{text}");
    }

    #[test]
    fn a_board_without_segments_says_nothing_of_jobs() {
        let (_, text) = services(JobsState::Alive.code() << JobsState::AT);
        assert!(!text.contains("jobs"), "{text}");
        let (state, _) = services(wire::describe::FEATURE_KEY);
        assert_eq!(state, JobsState::None);
    }
}
