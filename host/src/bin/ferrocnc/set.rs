//! `ferrocnc set`: changes a board's address, name, MAC and port, and the servers of its log.

use crate::discover::{Where, to_json};
use crate::text::{Told, tell};
use anyhow::{Context, Error, Result, bail};
use clap::{ArgGroup, Args};
use ferrocnc::client::Client;
use ferrocnc::provision::{self, Change, ProvisionError};
use ferrocnc::uid::{mac_text, uid_parse, uid_text};
use serde::Deserialize;
use serde_json::json;
use std::net::Ipv4Addr;
use std::time::Duration;
use wire::Name;

#[derive(Args)]
#[command(group(ArgGroup::new("which").required(true).args(["address", "uid"])))]
pub(crate) struct Set {
    /// IP[:port] of the board.
    #[arg(value_name = "BOARD")]
    address: Option<String>,
    /// The board with this unique id, at any address (ferrocnc discover shows ids).
    #[arg(long, value_name = "UID", value_parser = parse_uid)]
    uid: Option<[u32; 2]>,
    /// Its address, with the bits of the netmask if they are not as before: 192.168.2.51/24. Turns
    /// DHCP off.
    #[arg(long, value_name = "IP[/BITS]", value_parser = parse_ip)]
    ip: Option<(Ipv4Addr, Option<u8>)>,
    /// Its gateway; 0.0.0.0 for none.
    #[arg(long, value_name = "IP")]
    gateway: Option<Ipv4Addr>,
    /// Ask a DHCP server; the address given (or before) is what it falls back to after 10 s.
    #[arg(long)]
    dhcp: bool,
    /// Its name, up to 32 bytes.
    #[arg(long, value_parser = parse_name)]
    name: Option<Name>,
    /// Its MAC address, or `auto`: made from its unique id.
    #[arg(long, value_parser = parse_mac)]
    mac: Option<Mac>,
    /// Its UDP port for LinuxCNC.
    #[arg(long)]
    port: Option<u16>,
    /// The syslog server that gets the board's events, on its own network; 0.0.0.0 for none.
    #[arg(long, value_name = "IP")]
    syslog: Option<Ipv4Addr>,
    /// The server that the board asks for the time of its log, on its own network; 0.0.0.0 for
    /// none.
    #[arg(long, value_name = "IP")]
    sntp: Option<Ipv4Addr>,
    /// Forget all settings: the values built into its bitstream apply again.
    #[arg(long, conflicts_with_all = ["ip", "gateway", "dhcp", "name", "mac", "port", "syslog", "sntp"])]
    factory: bool,
    #[command(flatten)]
    wherever: Where,
}

pub(crate) fn run(arguments: &Set, as_json: bool) -> Result<()> {
    let change = Change {
        ip: arguments.ip,
        gateway: arguments.gateway,
        dhcp: arguments.dhcp.then_some(true),
        name: arguments.name,
        mac: arguments.mac.map(|mac| mac.0),
        port: arguments.port,
        syslog: arguments.syslog,
        sntp: arguments.sntp,
    };
    if change.is_empty() && !arguments.factory {
        bail!(
            "nothing to set: say --ip, --dhcp, --gateway, --name, --mac, --port, --syslog, --sntp \
             or --factory"
        );
    }
    let told = match (&arguments.address, arguments.uid) {
        (Some(address), _) => at(crate::open(address)?, &change, arguments.factory)?,
        (None, Some(uid)) => by_uid(uid, &change, arguments)?,
        (None, None) => bail!("which board? Name its address or --uid"),
    };
    tell(&told, as_json)
}

/// The same options from a page, which names the board by its address. Empty text is not given.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Wanted {
    board: String,
    #[serde(default)]
    ip: String,
    #[serde(default)]
    gateway: String,
    #[serde(default)]
    dhcp: bool,
    /// A name may become empty.
    name: Option<String>,
    #[serde(default)]
    mac: String,
    #[serde(default)]
    port: String,
    #[serde(default)]
    syslog: String,
    #[serde(default)]
    sntp: String,
    #[serde(default)]
    factory: bool,
}

impl Wanted {
    fn change(&self) -> Result<Change> {
        Ok(Change {
            ip: given(&self.ip, parse_ip)?,
            gateway: given(&self.gateway, parse_server)?,
            dhcp: self.dhcp.then_some(true),
            name: self
                .name
                .as_deref()
                .map(parse_name)
                .transpose()
                .map_err(Error::msg)?,
            mac: given(&self.mac, parse_mac)?.map(|mac| mac.0),
            port: given(&self.port, parse_port)?,
            syslog: given(&self.syslog, parse_server)?,
            sntp: given(&self.sntp, parse_server)?,
        })
    }

    /// `ferrocnc set`.
    pub(crate) fn take(&self) -> Result<Told> {
        let change = self.change()?;
        match (change.is_empty(), self.factory) {
            (true, false) => bail!("nothing to set: no field is another one than before"),
            (false, true) => {
                bail!("built-in settings and settings of your own; take one of the two")
            }
            (true, true) | (false, false) => at(crate::open(&self.board)?, &change, self.factory),
        }
    }
}

fn given<T>(text: &str, parse: impl Fn(&str) -> Result<T, String>) -> Result<Option<T>> {
    let text = text.trim();
    let parsed = (!text.is_empty()).then(|| parse(text)).transpose();
    parsed.map_err(Error::msg)
}

fn by_uid(uid: [u32; 2], change: &Change, arguments: &Set) -> Result<Told> {
    let finder = arguments.wherever.finder()?;
    let found = if arguments.factory {
        let (_, client) = provision::reach(&finder, uid)?;
        provision::forget_at(client.with_keys(crate::keys()))
            .map_err(|error| untaken(error, "at the address built into it"))?;
        // Until its restart begins, the board gives its old settings.
        std::thread::sleep(Duration::from_millis(500));
        finder
            .until(uid, |here| here.origin == wire::flash::Origin::BuiltIn)
            .context("the settings are forgotten, but the board has not come back yet")?
    } else {
        provision::set_by_uid(&finder, uid, change, &crate::keys())?
    };
    Ok(told(&found))
}

fn told(found: &ferrocnc::discovery::Found) -> Told {
    let here = &found.here;
    let text = format!(
        "{} has {}{}, MAC {}, name {}",
        uid_text(found.uid),
        found.socket(),
        if here.dhcp { " from DHCP" } else { "" },
        mac_text(here.mac),
        if here.name.text().is_empty() {
            "-"
        } else {
            here.name.text()
        },
    );
    Told {
        json: to_json(found),
        text,
    }
}

fn at(client: Client, change: &Change, factory: bool) -> Result<Told> {
    let address = client.address().clone();
    if factory {
        provision::forget_at(client)
            .map_err(|error| untaken(error, "at the address built into it"))?;
        return Ok(Told {
            json: json!({ "factory": true }),
            text: format!(
                "{address} has erased its settings and starts with the built-in ones; ferrocnc discover shows its address"
            ),
        });
    }
    let elsewhere = match (change.ip, change.dhcp) {
        (_, Some(true)) => "at an address from DHCP".to_owned(),
        (Some((ip, _)), _) => format!("at {ip}"),
        (None, _) => format!("at {address}, by its new name and port"),
    };
    let settings = provision::set_at(client, change).map_err(|error| untaken(error, &elsewhere))?;
    let ip = Ipv4Addr::from(settings.ip);
    let text = if settings.dhcp {
        format!(
            "saved; the board restarts and asks a DHCP server ({ip} if none answers). ferrocnc discover shows its address"
        )
    } else {
        format!("saved; the board restarts at {ip}:{}", settings.port)
    };
    let json = json!({
        "ip": ip.to_string(),
        "prefix": settings.prefix,
        "gateway": Ipv4Addr::from(settings.gateway).to_string(),
        "dhcp": settings.dhcp,
        "port": settings.port,
        "name": settings.name.text(),
        "mac": mac_text(settings.mac),
    });
    Ok(Told { json, text })
}

/// Says where to look for a board that may have been changed.
fn untaken(error: ProvisionError, elsewhere: &str) -> anyhow::Error {
    match error {
        ProvisionError::Unsure(_) => anyhow::Error::new(error).context(format!(
            "it is not known whether the board has changed; it may be where it was or {elsewhere} (ferrocnc discover shows it), and the same command again does no harm"
        )),
        error => error.into(),
    }
}

/// A MAC address; clap takes an array for a list.
#[derive(Clone, Copy)]
struct Mac([u8; 6]);

pub(crate) fn parse_uid(text: &str) -> Result<[u32; 2], String> {
    uid_parse(text).ok_or_else(|| "a unique id is 16 hex digits: d162-0c8a-1b2c-3d4e".to_owned())
}

fn parse_ip(text: &str) -> Result<(Ipv4Addr, Option<u8>), String> {
    let (ip, prefix) = match text.split_once('/') {
        Some((ip, prefix)) => (ip, Some(prefix)),
        None => (text, None),
    };
    let wrong =
        || format!("\"{text}\" is not IP[/BITS]; write it as 192.168.2.51 or 192.168.2.51/24");
    let ip = ip.parse().map_err(|_| wrong())?;
    let prefix = prefix.map(str::parse).transpose().map_err(|_| wrong())?;
    Ok((ip, prefix))
}

fn parse_server(text: &str) -> Result<Ipv4Addr, String> {
    let wrong = |_| format!("\"{text}\" is not an IP address; write it as 192.168.2.1");
    text.parse().map_err(wrong)
}

fn parse_port(text: &str) -> Result<u16, String> {
    let wrong = |_| format!("\"{text}\" is not a port: a number from 1 to 65535");
    text.parse().map_err(wrong)
}

fn parse_name(text: &str) -> Result<Name, String> {
    Name::new(text).map_err(|_| "a name has at most 32 bytes and no control characters".to_owned())
}

fn parse_mac(text: &str) -> Result<Mac, String> {
    if text == "auto" {
        return Ok(Mac([0; 6]));
    }
    let wrong =
        || format!("\"{text}\" is not a MAC address; write it as 02:12:34:56:78:9a, or auto");
    let bytes: Result<Vec<u8>, _> = text
        .split([':', '-'])
        .map(|part| match part.len() {
            2 => u8::from_str_radix(part, 16).map_err(|_| wrong()),
            _ => Err(wrong()),
        })
        .collect();
    let bytes: [u8; 6] = bytes?.try_into().map_err(|_| wrong())?;
    match bytes {
        [0, 0, 0, 0, 0, 0] => {
            Err("0 is not a MAC address; auto makes one from the unique id".to_owned())
        }
        bytes => Ok(Mac(bytes)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_are_read_as_people_write_them() {
        assert_eq!(parse_ip("10.0.0.7"), Ok((Ipv4Addr::new(10, 0, 0, 7), None)));
        assert_eq!(
            parse_ip("10.0.0.7/8"),
            Ok((Ipv4Addr::new(10, 0, 0, 7), Some(8)))
        );
        for text in ["10.0.0", "10.0.0.7/", "10.0.0.7/x", "ten"] {
            assert!(parse_ip(text).unwrap_err().contains(text), "{text}");
        }
        assert_eq!(
            parse_mac("02:12:34:56:78:9A").map(|mac| mac.0),
            Ok([2, 0x12, 0x34, 0x56, 0x78, 0x9a])
        );
        assert_eq!(parse_mac("auto").map(|mac| mac.0), Ok([0; 6]));
        for text in [
            "02:12:34:56:78",
            "2:12:34:56:78:9a",
            "02:12:34:56:78:9g",
            "00:00:00:00:00:00",
        ] {
            assert!(parse_mac(text).is_err(), "{text}");
        }
    }
}
