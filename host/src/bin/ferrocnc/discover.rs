//! `ferrocnc discover`: lists every board on the segment, at any address.

use crate::text::version;
use anyhow::{Result, bail};
use clap::Args;
use ferrocnc::address;
use ferrocnc::client::Client;
use ferrocnc::discovery::{DiscoveryError, Finder, Found, WAIT, filters};
use ferrocnc::mdns;
use ferrocnc::provision;
use ferrocnc::uid::{mac_text, uid_text};
use serde_json::{Value, json};
use std::net::{Ipv4Addr, SocketAddrV4};
use std::time::Duration;

/// Where to look.
#[derive(Args)]
pub(crate) struct Where {
    /// Look through this interface only.
    #[arg(long, value_name = "NAME")]
    interface: Option<String>,
    /// Ask at this address only, not by broadcast: a simulated board, or one behind a router.
    #[arg(long, value_name = "IP[:PORT]", conflicts_with = "interface")]
    at: Option<String>,
}

impl Where {
    /// At this address if there is one, else through this interface or all.
    pub(crate) fn named(interface: Option<String>, at: Option<String>) -> Self {
        Where { interface, at }
    }

    /// The board at this address, or the one with this unique id.
    pub(crate) fn client(&self, board: Option<&str>, uid: Option<[u32; 2]>) -> Result<Client> {
        match (board, uid) {
            (Some(address), _) => crate::open(address),
            (None, Some(uid)) => {
                let (_, client) = provision::reach(&self.finder()?, uid)?;
                Ok(client.with_keys(crate::keys()))
            }
            (None, None) => bail!("which board? Name its address or --uid"),
        }
    }

    pub(crate) fn finder(&self) -> Result<Finder> {
        Ok(match &self.at {
            Some(at) => Finder::at(address::parse(at, wire::DISCOVERY_PORT)?.socket)?,
            None => Finder::everywhere(self.interface.as_deref())?,
        })
    }
}

#[derive(Args)]
pub(crate) struct Discover {
    #[command(flatten)]
    wherever: Where,
    /// Listen for so many milliseconds.
    #[arg(long, value_name = "MS", default_value_t = WAIT.as_millis() as u64)]
    wait: u64,
}

pub(crate) fn run(arguments: &Discover, as_json: bool) -> Result<()> {
    let boards = find(&arguments.wherever, Duration::from_millis(arguments.wait))?;
    if as_json {
        println!("{:#}", all_to_json(&boards));
        return Ok(());
    }
    let filters = match arguments.wherever.at {
        Some(_) => Vec::new(),
        None => filters(arguments.wherever.interface.as_deref()),
    };
    if boards.is_empty() {
        println!("no board answers");
        eprintln!(
            "Check power and cable (the port beside the power connector first), and whether a firewall lets UDP broadcasts in."
        );
    } else {
        print!("{}", to_text(&boards));
    }
    if !filters.is_empty() {
        eprint!("{}", advice(&filters));
    }
    Ok(())
}

/// The boards that are there.
pub(crate) fn find(wherever: &Where, wait: Duration) -> Result<Vec<Found>> {
    let finder = wherever.finder()?;
    Ok(match wherever.at {
        Some(_) => finder.all(wait)?,
        None => both_ways(&finder, wherever.interface.as_deref(), wait)?,
    })
}

/// The boards that answer the broadcast, and those that announce themselves by multicast DNS: some
/// switches and firewalls let only one of both through.
fn both_ways(finder: &Finder, interface: Option<&str>, wait: Duration) -> Result<Vec<Found>> {
    let (found, adverts) = std::thread::scope(|scope| {
        let asked = scope.spawn(|| mdns::Asker::everywhere(interface)?.boards(wait));
        (finder.all(wait), asked.join())
    });
    // Without multicast there is still the broadcast.
    let adverts = adverts.ok().and_then(Result::ok).unwrap_or_default();
    let mut found = match found {
        // A firewall that lets no broadcast out is an error of the socket.
        Err(DiscoveryError::Socket(_)) if !adverts.is_empty() => Vec::new(),
        found => found?,
    };
    for advert in adverts {
        if found.iter().any(|known| known.uid == advert.uid) {
            continue;
        }
        let at = SocketAddrV4::new(*advert.socket.ip(), wire::DISCOVERY_PORT);
        let answer = Finder::at(at)?.one(advert.uid, wait).ok();
        // The answer is a broadcast even then.
        found.extend(answer.or_else(|| Found::read(advert.socket).ok()));
    }
    Ok(found)
}

/// How to receive answers that this computer drops.
fn advice(filters: &[String]) -> String {
    let settings = filters
        .iter()
        .map(|name| format!(" net.ipv4.conf.{name}.rp_filter=0"));
    format!(
        "Through {} this computer drops answers of boards with an address of another net (rp_filter). To hear them, until the next start:\n  sudo sysctl -w net.ipv4.conf.all.rp_filter=0{}\n",
        filters.join(" and "),
        settings.collect::<String>()
    )
}

fn name_or_dash(name: &str) -> &str {
    if name.is_empty() { "-" } else { name }
}

/// The reason why it cannot be changed now, in a word.
fn busy(found: &Found) -> &'static str {
    match (found.here.armed, found.here.owned) {
        (true, _) => "armed",
        (false, true) => "driven",
        (false, false) => "idle",
    }
}

fn to_text(boards: &[Found]) -> String {
    let mut rows = vec![
        [
            "unique id",
            "name",
            "address",
            "board",
            "configuration",
            "runs",
            "link",
            "state",
        ]
        .map(str::to_owned),
    ];
    for found in boards {
        let here = &found.here;
        let by = if here.dhcp { " (DHCP)" } else { "" };
        rows.push([
            uid_text(found.uid),
            name_or_dash(here.name.text()).to_owned(),
            format!("{}{by}", found.socket()),
            name_or_dash(here.platform.text()).to_owned(),
            name_or_dash(here.configuration.text()).to_owned(),
            here.running.text().to_owned(),
            here.speed.text().to_owned(),
            busy(found).to_owned(),
        ]);
    }
    let mut text = String::new();
    for row in &rows {
        let mut line = String::new();
        for (column, cell) in row.iter().enumerate() {
            let cells = rows.iter().map(|row| row[column].chars().count());
            let width = cells.max().unwrap_or(0);
            line += &format!("{cell:<width$}  ");
        }
        text += line.trim_end();
        text.push('\n');
    }
    for ip in shared(boards.iter().map(|found| Ipv4Addr::from(found.here.ip))) {
        text += &format!(
            "Several boards have the address {ip}: give all but one another (ferrocnc set --uid ... --ip ...)\n"
        );
    }
    for mac in shared(boards.iter().map(|found| mac_text(found.here.mac))) {
        text += &format!(
            "Several boards have the MAC address {mac}, which no switch can tell apart: give each its own (ferrocnc set --uid ... --mac auto)\n"
        );
    }
    text
}

/// Values that occur more than once.
fn shared<T: Ord + Clone>(all: impl Iterator<Item = T>) -> Vec<T> {
    let mut all: Vec<T> = all.collect();
    all.sort();
    let runs = all.chunk_by(|a, b| a == b);
    runs.filter(|run| run.len() > 1)
        .map(|run| run[0].clone())
        .collect()
}

pub(crate) fn all_to_json(boards: &[Found]) -> Value {
    let boards: Vec<Value> = boards.iter().map(to_json).collect();
    json!({ "boards": boards })
}

pub(crate) fn to_json(found: &Found) -> Value {
    let here = &found.here;
    json!({
        "uid": uid_text(found.uid),
        "mac": mac_text(here.mac),
        "ip": Ipv4Addr::from(here.ip).to_string(),
        "port": here.port,
        "dhcp": here.dhcp,
        "armed": here.armed,
        "owned": here.owned,
        "running": here.running.text(),
        "settings": here.origin.text(),
        "link_mbit": here.speed.mbit(),
        "wire_version": here.wire_version,
        "firmware_version": version(here.firmware_version),
        "build_id": format!("{:08x}", here.build_id),
        "name": here.name.text(),
        "configuration": here.configuration.text(),
        "platform": here.platform.text(),
    })
}
