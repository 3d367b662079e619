//! Finds boards with any address, and gives a board a new address.
//!
//! The question is a broadcast on every interface. The answer is a broadcast too, so it arrives
//! even if board and computer have addresses in different nets, or several boards have the same
//! address.
//!
//! ```text
//!   eth0 192.168.2.1  --- 255.255.255.255:51234 "which?" --> board 192.168.2.50  (d162-..)
//!   eth1 10.0.0.7     --- 255.255.255.255:51234 "which?" --> board 192.168.2.50  (5be3-..)
//!   0.0.0.0, same port <-- 255.255.255.255 "here", twice
//! ```
//!
//! A datagram to 255.255.255.255 leaves through the interface that its socket is bound to, so there
//! is one sending socket per interface. A socket bound to an address does not receive broadcasts,
//! so one more socket listens at the same port.

use crate::address::Address;
use crate::client::{Client, nonce};
use crate::flash::{FlashError, Overview};
use crate::keys::{Key, KeyError, Keys};
use crate::uid::uid_text;
use socket2::{Domain, Protocol, SockAddr, Socket, Type};
use std::io;
use std::net::{Ipv4Addr, SocketAddrV4, UdpSocket};
use std::time::{Duration, Instant};
use wire::board::Kind;
use wire::describe::FEATURE_KEY;
use wire::discovery::{Body, Here, Message, WORDS_MAX};
use wire::flash::OpResult;
use wire::settings::Settings;
use wire::{DISCOVERY_PORT, MAX_PAYLOAD, MAX_WORDS, Name, State, map};

/// 1.5 s: a board answers within milliseconds; if its firmware is busy with its flash, within a
/// second.
pub const WAIT: Duration = Duration::from_millis(1500);
/// Between two repetitions of a question, because datagrams may be lost.
const AGAIN: Duration = Duration::from_millis(400);
/// 8 s: settings are saved in a second, by a slow flash in three.
const SET_PATIENCE: Duration = Duration::from_secs(8);
/// A board that restarts: less than 1 s, up to 10 s more until a DHCP server that is not there
/// is given up.
const RESTART_PATIENCE: Duration = Duration::from_secs(15);

/// A wrong key is not tried oftener than this.
const PROOFS: u32 = 3;

/// Why boards cannot be looked for.
#[derive(Debug)]
pub enum DiscoveryError {
    /// No such interface.
    Interface(String),
    /// No interface has an address.
    NoInterface,
    /// The sockets.
    Socket(io::Error),
    /// That board does not answer.
    Silent([u32; 2]),
    /// It received the order, perhaps, but has not confirmed it.
    Unsure([u32; 2]),
    /// It answers and says no.
    Refused(OpResult),
    /// It has a key that this computer cannot show.
    Key([u32; 2], KeyError),
}

impl core::fmt::Display for DiscoveryError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            DiscoveryError::Interface(name) => write!(
                f,
                "this computer has no interface \"{name}\"; ip link shows their names"
            ),
            DiscoveryError::NoInterface => f.write_str(
                "no interface of this computer has an IPv4 address; give one to the interface the board is at, or name it with --interface",
            ),
            DiscoveryError::Socket(error) => write!(f, "cannot broadcast: {error}"),
            DiscoveryError::Silent(uid) => write!(
                f,
                "the board {} does not answer; ferrocnc discover shows the boards that answer",
                uid_text(*uid)
            ),
            DiscoveryError::Unsure(uid) => write!(
                f,
                "the board {} has not answered the request: it may have its new settings or the old ones; ferrocnc discover shows which, and the same command again does no harm",
                uid_text(*uid)
            ),
            DiscoveryError::Refused(OpResult::Armed) => f.write_str(
                "the board is armed, or LinuxCNC drives it; stop LinuxCNC, then try again",
            ),
            DiscoveryError::Key(uid, error) => write!(f, "{}: {error}", uid_text(*uid)),
            DiscoveryError::Refused(result) => write!(f, "the board says: {result}"),
        }
    }
}

impl std::error::Error for DiscoveryError {}

impl From<io::Error> for DiscoveryError {
    fn from(error: io::Error) -> Self {
        DiscoveryError::Socket(error)
    }
}

/// A board that answered.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Found {
    /// Its unique id; zeros if its flash has none.
    pub uid: [u32; 2],
    /// What it says of itself.
    pub here: Here,
}

impl Found {
    /// Where its Etherbone server is, as it says.
    pub fn socket(&self) -> SocketAddrV4 {
        SocketAddrV4::new(self.here.ip.into(), self.here.port)
    }

    /// The board with its Etherbone server there, from what every client may read: a firewall may
    /// drop its broadcast answers.
    pub fn read(at: SocketAddrV4) -> Result<Self, FlashError> {
        let mut client = Client::open(&Address {
            text: at.to_string(),
            socket: at,
        })?;
        let (identity, overview) = (client.identify()?, Overview::read(&mut client)?);
        let owner = client.read(&[map::SESSION_OWNER_IP])?;
        let settings = overview.settings.map_err(FlashError::Settings)?;
        let describe = &identity.describe;
        let name = |kind| Name::cut(identity.blob().text(kind, 0).unwrap_or(""));
        let armed = match describe.state.state {
            State::Disarmed | State::Faulted => false,
            State::Boot | State::Armed | State::Stopping => true,
        };
        let here = Here {
            mac: settings.mac,
            ip: overview.ip.to_bits(),
            port: at.port(),
            dhcp: settings.dhcp && overview.ip.to_bits() != settings.ip,
            armed,
            owned: owner != [0],
            keyed: describe.features & FEATURE_KEY != 0,
            running: overview.running,
            origin: overview.origin,
            speed: overview.link.speed,
            wire_version: describe.wire_version,
            firmware_version: describe.firmware_version,
            build_id: overview.build_id,
            name: settings.name,
            configuration: name(Kind::Configuration),
            platform: name(Kind::Platform),
        };
        let uid = overview.uid;
        Ok(Found { uid, here })
    }
}

/// Asks all boards on the segments this computer is at.
#[derive(Debug)]
pub struct Finder {
    senders: Vec<UdpSocket>,
    receiver: UdpSocket,
    to: SocketAddrV4,
}

impl Finder {
    /// Through all interfaces, or through one.
    pub fn everywhere(interface: Option<&str>) -> Result<Self, DiscoveryError> {
        if let Some(name) = interface
            && !std::path::Path::new("/sys/class/net").join(name).exists()
        {
            return Err(DiscoveryError::Interface(name.to_owned()));
        }
        let receiver = socket(Ipv4Addr::UNSPECIFIED, 0, interface)?;
        let port = receiver.local_addr()?.port();
        let mut senders = Vec::new();
        for (name, ip, loopback) in interfaces()? {
            let named = interface == Some(&name);
            if named || (interface.is_none() && !loopback) {
                // If an interface has just lost its address, the others are still asked.
                senders.extend(socket(ip, port, interface));
            }
        }
        match interface {
            // Without an address, but there: the receiver is bound to it.
            Some(_) if senders.is_empty() => senders.push(receiver.try_clone()?),
            None if senders.is_empty() => return Err(DiscoveryError::NoInterface),
            Some(_) | None => {}
        }
        Ok(Finder {
            senders,
            receiver,
            to: SocketAddrV4::new(Ipv4Addr::BROADCAST, DISCOVERY_PORT),
        })
    }

    /// Asks at one address only: a board with a known address, or a simulated one.
    pub fn at(to: SocketAddrV4) -> Result<Self, DiscoveryError> {
        let receiver = socket(Ipv4Addr::UNSPECIFIED, 0, None)?;
        Ok(Finder {
            senders: vec![receiver.try_clone()?],
            receiver,
            to,
        })
    }

    /// Every board that answers in this time, each once, in order of name and id.
    pub fn all(&self, wait: Duration) -> Result<Vec<Found>, DiscoveryError> {
        let mut found: Vec<Found> = Vec::new();
        self.ask([0, 0], Body::Discover, wait, &mut |message| {
            if let Body::Here(here) = message.body {
                // Without an id the MAC tells them apart.
                let same = |other: &Found| other.uid == message.uid && other.here.mac == here.mac;
                if !found.iter().any(same) {
                    found.push(Found {
                        uid: message.uid,
                        here,
                    });
                }
            }
            false
        })?;
        found.sort_by_key(|found| (found.here.name.text().to_owned(), found.uid));
        Ok(found)
    }

    /// The board with this id.
    pub fn one(&self, uid: [u32; 2], wait: Duration) -> Result<Found, DiscoveryError> {
        let mut found = None;
        self.ask(uid, Body::Discover, wait, &mut |message| {
            if let Body::Here(here) = message.body
                && message.uid == uid
            {
                found = Some(Found { uid, here });
            }
            found.is_some()
        })?;
        found.ok_or(DiscoveryError::Silent(uid))
    }

    /// Gives the board with this id settings; it restarts with them. If it has a key, that is
    /// looked for there.
    pub fn set(
        &self,
        uid: [u32; 2],
        settings: &Settings,
        keys: &Keys,
    ) -> Result<(), DiscoveryError> {
        let mut body = Body::Set(*settings);
        // The keys it may have, and with which of them it was told how often.
        let mut found: Vec<(Key, std::path::PathBuf)> = Vec::new();
        let (mut at, mut tries) = (0, 0);
        let number = nonce();
        loop {
            let mut answer = None;
            self.ask_as(number, uid, body, SET_PATIENCE, &mut |message| {
                if let (true, Body::Done(_) | Body::Prove(_)) = (message.uid == uid, message.body) {
                    answer = Some(message.body);
                }
                answer.is_some()
            })?;
            let challenge = match answer {
                Some(Body::Done(OpResult::Ok)) => {
                    if let Some((_, path)) = found.get(at) {
                        keys.accepted(uid, path);
                    }
                    return Ok(());
                }
                Some(Body::Done(result)) => return Err(DiscoveryError::Refused(result)),
                Some(Body::Prove(challenge)) => challenge,
                Some(_) | None => return Err(DiscoveryError::Unsure(uid)),
            };
            if found.is_empty() {
                found = keys
                    .find(uid)
                    .map_err(|error| DiscoveryError::Key(uid, error))?;
            } else if tries >= PROOFS {
                // More than once: its Done was lost, and it restarted with another challenge.
                (at, tries) = (at + 1, 0);
            }
            let Some((key, _)) = found.get(at) else {
                let tried = found.into_iter().map(|(_, path)| path).collect();
                return Err(DiscoveryError::Key(uid, KeyError::Wrong(tried)));
            };
            body = proven(key, challenge, number, uid, settings);
            tries += 1;
        }
    }

    /// Waits until the board with this id has restarted and reports the requested settings.
    pub fn until(
        &self,
        uid: [u32; 2],
        settled: impl Fn(&Here) -> bool,
    ) -> Result<Found, DiscoveryError> {
        let began = Instant::now();
        loop {
            let answer = self.one(uid, AGAIN * 2);
            match answer {
                Ok(found) if settled(&found.here) => return Ok(found),
                Ok(_) | Err(DiscoveryError::Silent(_)) if began.elapsed() < RESTART_PATIENCE => {
                    std::thread::sleep(AGAIN / 4);
                }
                other => return other,
            }
        }
    }

    /// Asks until `heard` returns true or the time is over.
    fn ask(
        &self,
        uid: [u32; 2],
        body: Body,
        wait: Duration,
        heard: &mut dyn FnMut(Message) -> bool,
    ) -> Result<(), DiscoveryError> {
        self.ask_as(nonce(), uid, body, wait, heard)
    }

    fn ask_as(
        &self,
        nonce: u32,
        uid: [u32; 2],
        body: Body,
        wait: Duration,
        heard: &mut dyn FnMut(Message) -> bool,
    ) -> Result<(), DiscoveryError> {
        let mut words = [0; WORDS_MAX];
        let words = Message { nonce, uid, body }.emit(&mut words);
        let mut request = [0; WORDS_MAX * 4];
        let length = wire::words_to_bytes(words, &mut request);
        let began = Instant::now();
        let mut due = began;
        loop {
            let now = Instant::now();
            if now >= due {
                self.send(&request[..length])?;
                due = now + AGAIN;
            }
            let left = (began + wait).saturating_duration_since(now);
            if left.is_zero() {
                return Ok(());
            }
            let until = left.min(due.saturating_duration_since(now));
            // 1 ms at least: 0 would mean for ever.
            self.receiver
                .set_read_timeout(Some(until.max(Duration::from_millis(1)).min(AGAIN / 8)))?;
            // A broadcast arrives at the receiver, a datagram for this computer at a sender.
            let mut sockets: Vec<&UdpSocket> = vec![&self.receiver];
            sockets.extend(&self.senders);
            for socket in sockets {
                while let Some(message) = receive(socket) {
                    if message.nonce == nonce && heard(message) {
                        return Ok(());
                    }
                }
            }
        }
    }

    /// Through every interface; an error if none took it.
    fn send(&self, bytes: &[u8]) -> Result<(), DiscoveryError> {
        let mut sent = false;
        let mut failed = None;
        for sender in &self.senders {
            match sender.send_to(bytes, self.to) {
                Ok(_) => sent = true,
                // A pulled cable, or a refusal by another host: the other interfaces may work.
                Err(error) => failed = Some(error),
            }
        }
        match failed {
            Some(error) if !sent && error.kind() != io::ErrorKind::ConnectionRefused => {
                Err(error.into())
            }
            Some(_) | None => Ok(()),
        }
    }
}

/// A datagram that is a message, if one comes before the socket's patience ends.
fn receive(socket: &UdpSocket) -> Option<Message> {
    let mut bytes = [0; MAX_PAYLOAD];
    let mut words = [0; MAX_WORDS];
    loop {
        let (length, _) = socket.recv_from(&mut bytes).ok()?;
        let parsed = wire::words_from_bytes(&bytes[..length], &mut words).and_then(Message::parse);
        // Another program may use this port, too; take the next datagram.
        if let Ok(message) = parsed {
            return Some(message);
        }
    }
}

/// The Set with the answer to the challenge.
fn proven(
    key: &Key,
    challenge: [u32; wire::auth::WORDS],
    nonce: u32,
    uid: [u32; 2],
    settings: &Settings,
) -> Body {
    let body = Body::Proven(*settings, wire::auth::NONE);
    let mut words = [0; WORDS_MAX];
    let words = Message { nonce, uid, body }.emit(&mut words);
    let signed = wire::discovery::proof(words).map_or(&[][..], |(signed, _)| signed);
    Body::Proven(*settings, key.set(challenge, signed))
}

fn socket(ip: Ipv4Addr, port: u16, interface: Option<&str>) -> io::Result<UdpSocket> {
    let socket = Socket::new(Domain::IPV4, Type::DGRAM, Some(Protocol::UDP))?;
    socket.set_broadcast(true)?;
    socket.set_reuse_address(true)?;
    if let Some(interface) = interface {
        socket.bind_device(Some(interface.as_bytes()))?;
    }
    socket.bind(&SockAddr::from(SocketAddrV4::new(ip, port)))?;
    // Only the receiver waits; it is told how long.
    if port == 0 {
        socket.set_read_timeout(Some(AGAIN))?;
    } else {
        socket.set_nonblocking(true)?;
    }
    Ok(socket.into())
}

/// Name, address, whether it is the computer itself.
fn interfaces() -> io::Result<Vec<(String, Ipv4Addr, bool)>> {
    let all = if_addrs::get_if_addrs()?;
    Ok(all
        .into_iter()
        .filter_map(|interface| match interface.addr {
            if_addrs::IfAddr::V4(ref v4) => {
                Some((interface.name.clone(), v4.ip, v4.ip.is_loopback()))
            }
            if_addrs::IfAddr::V6(_) => None,
        })
        .collect())
}

/// Interfaces through which this computer throws answers of boards with an address of another net
/// away.
///
/// `rp_filter` 1 drops a datagram if the answer to its sender would leave through another
/// interface. 2 drops it if there is no route to its sender at all; a default route is a route to
/// every address.
pub fn filters(interface: Option<&str>) -> Vec<String> {
    let value = |name: &str| -> u8 {
        let path = format!("/proc/sys/net/ipv4/conf/{name}/rp_filter");
        let text = std::fs::read_to_string(path).unwrap_or_default();
        text.trim().parse().unwrap_or(0)
    };
    let routes = std::fs::read_to_string("/proc/net/route").unwrap_or_default();
    let destinations = routes.lines().map(|line| line.split_whitespace().nth(1));
    let has_default = destinations.flatten().any(|to| to == "00000000");
    // The larger of the two counts.
    let all = value("all");
    let mut names: Vec<String> = interfaces()
        .unwrap_or_default()
        .into_iter()
        .filter(|(name, _, loopback)| match interface {
            Some(interface) => name == interface,
            None => !loopback,
        })
        .map(|(name, ..)| name)
        .filter(|name| match value(name).max(all) {
            0 => false,
            1 => true,
            _ => !has_default,
        })
        .collect();
    names.dedup();
    names
}
