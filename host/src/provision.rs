//! Writes new settings to a board, found by its address or its unique id.
//!
//! Settings that are not named stay: the settings in force are read first, through the flash window
//! if the board can be reached, otherwise from its answer to discovery. The key is never read and
//! stays.

use crate::address::{self, Address};
use crate::client::Client;
use crate::discovery::{DiscoveryError, Finder, Found, WAIT};
use crate::flash::{FlashError, Flasher, Overview};
use crate::keys::{Key, KeyError, Keys};
use crate::uid::uid_text;
use std::net::Ipv4Addr;
use std::time::Duration;
use wire::Name;
use wire::discovery::Here;
use wire::flash::OpResult;
use wire::settings::{Settings, SettingsError, mac_of_uid};

/// How long to try a board that may not be reachable.
const SHORT: Duration = Duration::from_secs(1);

/// What is to change; `None` stays.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Change {
    /// Address, and bits of its netmask if they change, too.
    pub ip: Option<(Ipv4Addr, Option<u8>)>,
    /// 0.0.0.0 for none.
    pub gateway: Option<Ipv4Addr>,
    /// Ask a DHCP server.
    pub dhcp: Option<bool>,
    /// Name of the board.
    pub name: Option<Name>,
    /// All zeros: from the unique id.
    pub mac: Option<[u8; 6]>,
    /// Etherbone port.
    pub port: Option<u16>,
    /// Server for the board's events, 0.0.0.0 for none.
    pub syslog: Option<Ipv4Addr>,
    /// Server that knows the time, 0.0.0.0 for none.
    pub sntp: Option<Ipv4Addr>,
}

/// Why it did not work; it says what to do.
#[derive(Debug)]
pub enum ProvisionError {
    /// Over the flash window. The board has what it had.
    Flash(FlashError),
    /// The same, and the board may have done what it was told: the question was sent, and no answer
    /// says that it was refused.
    Unsure(FlashError),
    /// The new key cannot be stored, so it was not sent to the board.
    Key(KeyError),
    /// Over discovery.
    Discovery(DiscoveryError),
    /// No board can use these.
    Settings(SettingsError),
    /// Several boards have this address.
    Shared {
        /// The address.
        ip: Ipv4Addr,
        /// The boards with this address.
        uids: Vec<[u32; 2]>,
    },
    /// Another board answers at the address.
    Other {
        /// The id of the board that was meant.
        wanted: [u32; 2],
        /// The id of the board that answers.
        found: [u32; 2],
    },
    /// It cannot be reached to be told that.
    Unreachable(Ipv4Addr),
}

impl core::fmt::Display for ProvisionError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            ProvisionError::Flash(error) => write!(f, "{error}"),
            ProvisionError::Unsure(error) => write!(
                f,
                "{error}. The request was sent, and the board may have saved it: at its next start it may have the new settings or the old ones"
            ),
            ProvisionError::Key(error) => write!(f, "{error}; nothing was changed"),
            ProvisionError::Discovery(error) => write!(f, "{error}"),
            ProvisionError::Settings(error) => write!(
                f,
                "{}; nothing was changed",
                match error {
                    SettingsError::Value(4) =>
                        "no board can have this address in a net of this size",
                    SettingsError::Value(5) => "the netmask must have 1 to 30 bits",
                    SettingsError::Value(6) => "no gateway can have this address",
                    SettingsError::Value(7) =>
                        "this is not a MAC address of a single station: its first byte must be even",
                    SettingsError::Value(9) =>
                        "the port must be from 1 to 65535, and not 51234, where boards are found",
                    SettingsError::Value(22) => "no syslog server can have this address",
                    SettingsError::Value(23) => "no SNTP server can have this address",
                    SettingsError::Value(_)
                    | SettingsError::Magic
                    | SettingsError::Version(_)
                    | SettingsError::Crc => "no board can use these settings",
                }
            ),
            ProvisionError::Shared { ip, uids } => {
                let uids: Vec<String> = uids.iter().map(|uid| uid_text(*uid)).collect();
                write!(
                    f,
                    "{} boards have the address {ip} ({}); give one another address first: ferrocnc set --uid {} --ip ...",
                    uids.len(),
                    uids.join(", "),
                    uids.first().map_or("", String::as_str)
                )
            }
            ProvisionError::Other { wanted, found } => write!(
                f,
                "at that address answers {}, not {}; ferrocnc discover shows the address of each board",
                uid_text(*found),
                uid_text(*wanted)
            ),
            ProvisionError::Unreachable(ip) => write!(
                f,
                "the board is found, but cannot be reached at {ip} from here; give it an address of this computer's net first (ferrocnc set --uid ... --ip ...), or start it with its factory pin held"
            ),
        }
    }
}

impl std::error::Error for ProvisionError {}

impl From<FlashError> for ProvisionError {
    fn from(error: FlashError) -> Self {
        ProvisionError::Flash(error)
    }
}

impl From<DiscoveryError> for ProvisionError {
    fn from(error: DiscoveryError) -> Self {
        ProvisionError::Discovery(error)
    }
}

impl Change {
    /// Is nothing to change?
    pub fn is_empty(&self) -> bool {
        *self == Change::default()
    }

    /// The settings with the change, if a board can use them.
    pub fn apply(&self, to: &Settings) -> Result<Settings, ProvisionError> {
        let mut settings = Settings {
            keep_key: true,
            key: [0; 4],
            ..*to
        };
        if let Some((ip, prefix)) = self.ip {
            settings.ip = ip.into();
            settings.prefix = prefix.unwrap_or(settings.prefix);
            // An address turns DHCP off, unless the command also asks for DHCP: then it is the
            // fallback.
            settings.dhcp = false;
        }
        if let Some(gateway) = self.gateway {
            settings.gateway = gateway.into();
        }
        settings.dhcp = self.dhcp.unwrap_or(settings.dhcp);
        settings.name = self.name.unwrap_or(settings.name);
        settings.mac = self.mac.unwrap_or(settings.mac);
        settings.port = self.port.unwrap_or(settings.port);
        settings.syslog = self.syslog.map_or(settings.syslog, u32::from);
        settings.sntp = self.sntp.map_or(settings.sntp, u32::from);
        settings.check().map_err(ProvisionError::Settings)?;
        Ok(settings)
    }

    /// Does the board report the requested settings?
    pub fn is_in_force(&self, settings: &Settings, here: &Here) -> bool {
        let address = settings.dhcp || here.ip == settings.ip;
        let mac = settings.mac == [0; 6] || here.mac == settings.mac;
        address && mac && here.port == settings.port && here.name == settings.name
    }
}

/// The settings of a board from its answer to discovery. The answer does not hold net, gateway and
/// servers: a net of 256 addresses, and none of the others are assumed.
pub fn settings_of(found: &Found) -> Settings {
    let here = &found.here;
    Settings {
        dhcp: here.dhcp,
        ip: here.ip,
        mac: given_mac(found.uid, here.mac),
        port: here.port,
        name: here.name,
        ..Settings::default()
    }
}

/// The settings in force, as they would be given: a MAC address made from the unique id is not one
/// that was set.
fn in_force(overview: &Overview) -> Result<Settings, FlashError> {
    let settings = overview.settings.map_err(FlashError::Settings)?;
    Ok(Settings {
        mac: given_mac(overview.uid, settings.mac),
        ..settings
    })
}

/// Zeros for what the board makes itself.
fn given_mac(uid: [u32; 2], mac: [u8; 6]) -> [u8; 6] {
    match mac_of_uid(uid) == mac {
        true => [0; 6],
        false => mac,
    }
}

/// The board with this id, if no other board has its address.
pub fn reach(finder: &Finder, uid: [u32; 2]) -> Result<(Found, Client), ProvisionError> {
    let found = finder.one(uid, WAIT)?;
    let ip = found.here.ip;
    let boards = finder.all(WAIT)?;
    let others = boards
        .iter()
        .filter(|other| other.here.ip == ip && other.uid != uid)
        .map(|other| other.uid);
    let uids: Vec<[u32; 2]> = core::iter::once(uid).chain(others).collect();
    if uids.len() > 1 {
        return Err(ProvisionError::Shared {
            ip: ip.into(),
            uids,
        });
    }
    let client = Client::open(&address_of(&found)).map_err(FlashError::Client)?;
    let mut client = client.with_patience(SHORT);
    let overview = Overview::read(&mut client).map_err(|error| match error {
        FlashError::Client(_) => ProvisionError::Unreachable(ip.into()),
        error => error.into(),
    })?;
    if overview.uid != uid {
        return Err(ProvisionError::Other {
            wanted: uid,
            found: overview.uid,
        });
    }
    Ok((found, client.with_patience(crate::client::PATIENCE)))
}

/// Where a found board is, as an address.
pub fn address_of(found: &Found) -> Address {
    let socket = found.socket();
    let text = socket.to_string();
    let text = text
        .strip_suffix(&format!(":{}", wire::DEFAULT_PORT))
        .map_or(text.clone(), str::to_owned);
    address::parse(&text, wire::DEFAULT_PORT).unwrap_or(Address { text, socket })
}

/// Changes the settings of the board with this id, at any address; returns its answer to discovery
/// afterwards.
pub fn set_by_uid(
    finder: &Finder,
    uid: [u32; 2],
    change: &Change,
    keys: &Keys,
) -> Result<Found, ProvisionError> {
    let found = finder.one(uid, WAIT)?;
    let base = match reach(finder, uid) {
        Ok((_, mut client)) => in_force(&Overview::read(&mut client)?).ok(),
        // A shared or foreign address: only the answer to discovery is left.
        Err(_) => None,
    };
    let settings = change.apply(&base.unwrap_or_else(|| settings_of(&found)))?;
    finder.set(uid, &settings, keys)?;
    Ok(finder.until(uid, |here| change.is_in_force(&settings, here))?)
}

/// Changes the settings of the board at an address. They are saved and the board restarts; what
/// it will then have.
pub fn set_at(client: Client, change: &Change) -> Result<Settings, ProvisionError> {
    let mut client = client;
    let overview = Overview::read(&mut client)?;
    let settings = change.apply(&in_force(&overview)?)?;
    let mut flasher = Flasher::new(client, crate::client::PATIENCE, |_| {});
    flasher.may_write()?;
    flasher.save(&settings).map_err(told)?;
    flasher.restart();
    Ok(settings)
}

/// The error of an operation on the settings. Only a refusal that depends on the operation alone
/// proves that it was not done, because the answer may belong to any of its repetitions.
fn told(error: FlashError) -> ProvisionError {
    match error {
        FlashError::NoFlash { .. }
        | FlashError::Failed {
            result: OpResult::Value | OpResult::NoFlash,
            ..
        } => ProvisionError::Flash(error),
        _ => ProvisionError::Unsure(error),
    }
}

/// Gives a board a key, or removes it. All other settings stay, and the board restarts. `keep`
/// saves the key on this computer; it is called when the board is ready for the key, and before the
/// key is sent.
pub fn set_key(
    client: Client,
    key: Option<Key>,
    keep: impl FnOnce(&Key) -> Result<(), KeyError>,
) -> Result<(), ProvisionError> {
    let mut client = client;
    let settings = in_force(&Overview::read(&mut client)?)?;
    let settings = Settings {
        key: key.map_or(wire::auth::NONE, |key| key.words()),
        keep_key: false,
        ..settings
    };
    let mut flasher = Flasher::new(client, crate::client::PATIENCE, |_| {});
    flasher.may_write()?;
    if let Some(key) = &key {
        keep(key).map_err(ProvisionError::Key)?;
    }
    flasher.save(&settings).map_err(told)?;
    flasher.restart();
    Ok(())
}

/// Has a board forget its settings and restart with what is built into its bitstream.
pub fn forget_at(client: Client) -> Result<(), ProvisionError> {
    let mut flasher = Flasher::new(client, crate::client::PATIENCE, |_| {});
    flasher.may_write()?;
    flasher.forget().map_err(told)?;
    flasher.restart();
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn change(ip: &str, prefix: Option<u8>) -> Change {
        Change {
            ip: Some((ip.parse().unwrap(), prefix)),
            ..Change::default()
        }
    }

    #[test]
    fn only_what_is_asked_for_changes_and_the_key_stays() {
        let now = Settings {
            dhcp: true,
            prefix: 16,
            gateway: 0xc0a8_0201,
            port: 99,
            mac: [2, 0, 0, 0, 0, 1],
            key: [0; 4],
            ..Settings::default()
        };
        let named = Change {
            name: Some(Name::new("mill").unwrap()),
            ..Change::default()
        };
        let settings = named.apply(&now).unwrap();
        let expected = Settings {
            name: Name::new("mill").unwrap(),
            keep_key: true,
            ..now
        };
        assert_eq!(settings, expected);
        assert!(
            change("10.0.0.7", Some(8))
                .apply(&now)
                .is_ok_and(|s| !s.dhcp && s.prefix == 8)
        );
        let fallback = Change {
            dhcp: Some(true),
            ..change("10.0.0.7", None)
        };
        assert!(
            fallback
                .apply(&now)
                .is_ok_and(|s| s.dhcp && s.ip == 0x0a00_0007)
        );
    }

    #[test]
    fn servers_are_set_kept_and_removed() {
        let server = Some(Ipv4Addr::new(192, 168, 2, 1));
        let both = Change {
            syslog: server,
            sntp: server,
            ..Change::default()
        };
        let set = both.apply(&Settings::default()).unwrap();
        assert_eq!((set.syslog, set.sntp), (0xc0a8_0201, 0xc0a8_0201));
        let none = Change {
            syslog: Some(Ipv4Addr::UNSPECIFIED),
            ..Change::default()
        };
        let left = none.apply(&set).unwrap();
        assert_eq!((left.syslog, left.sntp), (0, 0xc0a8_0201));
        let loopback = Change {
            sntp: Some(Ipv4Addr::LOCALHOST),
            ..Change::default()
        };
        let refused = loopback.apply(&set).unwrap_err().to_string();
        assert!(refused.contains("SNTP"), "{refused}");
    }

    #[test]
    fn what_no_board_can_live_with_is_refused_before_anything_is_sent() {
        for (change, word) in [
            (
                change("192.168.2.255", None),
                "no board can have this address",
            ),
            (change("127.0.0.1", None), "no board can have this address"),
            (change("10.0.0.7", Some(31)), "1 to 30 bits"),
            (
                Change {
                    port: Some(51234),
                    ..Change::default()
                },
                "not 51234",
            ),
            (
                Change {
                    mac: Some([1, 0, 0, 0, 0, 0]),
                    ..Change::default()
                },
                "must be even",
            ),
            (
                Change {
                    gateway: Some(Ipv4Addr::BROADCAST),
                    ..Change::default()
                },
                "no gateway",
            ),
        ] {
            let said = change.apply(&Settings::default()).unwrap_err().to_string();
            assert!(said.contains(word), "{said}");
        }
    }
}
