//! Finds the address of `NAME.local`, and lists boards, by multicast DNS.
//!
//! Its questions come from a port of their own, so that every answer comes back to it alone (RFC
//! 6762, 6.7): nothing has to be installed or joined on this computer. The board's side is in the
//! firmware's `services::mdns`, the messages in [`wire::mdns`].

use crate::uid::uid_parse;
use std::collections::BTreeMap;
use std::io;
use std::net::{Ipv4Addr, SocketAddr, SocketAddrV4, UdpSocket};
use std::time::{Duration, Instant};
use wire::mdns::{A, FERROCNC, GROUP, IN, Message, PORT, PTR, Record, SRV, TXT, UID, Writer};

/// How long a name is looked for. A board answers within 120 ms; one that still asks whether its
/// name is taken, within two seconds.
pub const WAIT: Duration = Duration::from_millis(3000);
/// Between two repetitions of a question, because datagrams may be lost.
const AGAIN: Duration = Duration::from_millis(700);

/// Between two looks at the sockets.
const LOOK: Duration = Duration::from_millis(5);

/// A board that announces itself.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Advert {
    /// Its unique id.
    pub uid: [u32; 2],
    /// Its name, without `.local`.
    pub name: String,
    /// Its Etherbone server.
    pub socket: SocketAddrV4,
}

/// A name that only multicast DNS knows: `mill.local`.
pub fn is_local(host: &str) -> bool {
    let host = host.strip_suffix('.').unwrap_or(host);
    let suffix = host.rsplit_once('.');
    suffix.is_some_and(|(name, last)| !name.is_empty() && last.eq_ignore_ascii_case("local"))
}

/// Where this name is, asked through every interface.
pub fn resolve(host: &str) -> io::Result<Option<Ipv4Addr>> {
    Asker::everywhere(None)?.resolve(host, WAIT)
}

/// Asks.
#[derive(Debug)]
pub struct Asker {
    sockets: Vec<UdpSocket>,
    to: SocketAddrV4,
}

impl Asker {
    /// Through all interfaces, or through one.
    pub fn everywhere(interface: Option<&str>) -> io::Result<Self> {
        let mut sockets = Vec::new();
        for found in if_addrs::get_if_addrs()? {
            let if_addrs::IfAddr::V4(address) = &found.addr else {
                continue;
            };
            let wanted = match interface {
                Some(name) => found.name == name,
                None => !address.ip.is_loopback(),
            };
            // The source address chooses the interface. One that has just lost it is left out.
            let socket = wanted.then(|| UdpSocket::bind((address.ip, 0)));
            if let Some(Ok(socket)) = socket {
                socket.set_multicast_ttl_v4(255)?;
                socket.set_nonblocking(true)?;
                sockets.push(socket);
            }
        }
        Ok(Asker {
            sockets,
            to: SocketAddrV4::new(GROUP.into(), PORT),
        })
    }

    /// At one address only: a responder that is known.
    pub fn at(to: SocketAddrV4) -> io::Result<Self> {
        let socket = UdpSocket::bind((Ipv4Addr::UNSPECIFIED, 0))?;
        socket.set_nonblocking(true)?;
        Ok(Asker {
            sockets: vec![socket],
            to,
        })
    }

    /// The address of a host.
    pub fn resolve(&self, host: &str, wait: Duration) -> io::Result<Option<Ipv4Addr>> {
        let labels: Vec<&str> = host.trim_end_matches('.').split('.').collect();
        let mut found = None;
        self.ask(&labels, A, wait, &mut |message| {
            let mut records = message.records();
            let ours = |record: &Record| record.name.is(&labels);
            found = records.find_map(|record| record.ip().filter(|_| ours(&record)));
            found.is_some()
        })?;
        Ok(found.map(Ipv4Addr::from))
    }

    /// Every board that answers in this time, by its unique id.
    pub fn boards(&self, wait: Duration) -> io::Result<Vec<Advert>> {
        let mut found = BTreeMap::new();
        self.ask(&FERROCNC, PTR, wait, &mut |message| {
            if let Some(advert) = advert(message) {
                found.insert(advert.uid, advert);
            }
            false
        })?;
        Ok(found.into_values().collect())
    }

    /// Asks until `heard` returns true or the time is over.
    fn ask(
        &self,
        name: &[&str],
        kind: u16,
        wait: Duration,
        heard: &mut dyn FnMut(&Message) -> bool,
    ) -> io::Result<()> {
        let mut id = [0; 2];
        getrandom::fill(&mut id).map_err(io::Error::other)?;
        let id = u16::from_be_bytes(id);
        let mut question = [0; 512];
        let mut writer = Writer::new(&mut question, id, 0);
        writer.question(name, kind, IN);
        let length = match writer.is_empty() {
            true => return Ok(()), // no name: an empty label, or one that is too long
            false => writer.finish(),
        };
        let began = Instant::now();
        let mut due = began;
        let mut room = [0; 9000];
        loop {
            let now = Instant::now();
            if now >= due {
                self.send(&question[..length])?;
                due = now + AGAIN;
            }
            let left = (began + wait).saturating_duration_since(now);
            if left.is_zero() || self.sockets.is_empty() {
                return Ok(());
            }
            std::thread::sleep(LOOK.min(left));
            for socket in &self.sockets {
                while let Ok((length, from)) = socket.recv_from(&mut room) {
                    let from_responder = match from {
                        SocketAddr::V4(from) => from.port() == self.to.port(),
                        SocketAddr::V6(_) => false,
                    };
                    let message = Message::parse(&room[..length]);
                    let ours = |message: &Message| message.is_response() && message.id == id;
                    if let Some(message) = message.filter(ours)
                        && from_responder
                        && heard(&message)
                    {
                        return Ok(());
                    }
                }
            }
        }
    }

    /// Through every interface; an error if none took it.
    fn send(&self, bytes: &[u8]) -> io::Result<()> {
        let mut sent = self.sockets.is_empty();
        let mut failed = None;
        for socket in &self.sockets {
            match socket.send_to(bytes, self.to) {
                Ok(_) => sent = true,
                Err(error) => failed = Some(error),
            }
        }
        match failed {
            Some(error) if !sent => Err(error),
            Some(_) | None => Ok(()),
        }
    }
}

/// The board that a message is about.
fn advert(message: &Message) -> Option<Advert> {
    let mut records = message.records();
    let instance = records.find_map(|record| {
        let points = record.kind == PTR && record.name.is(&FERROCNC);
        let to = points.then(|| record.name_at(0)).flatten()?;
        to.instance_of(&FERROCNC)
    })?;
    let of = |kind: u16| {
        message.records().find(move |record| {
            let label = record.name.instance_of(&FERROCNC);
            record.kind == kind && label.is_some_and(|it| it.eq_ignore_ascii_case(instance))
        })
    };
    let ip = message.records().find_map(|record| record.ip())?;
    let port = of(SRV)?.port()?;
    let uid = of(TXT)?.strings().find_map(|string| {
        let digits = string.strip_prefix(UID.as_bytes())?;
        uid_parse(std::str::from_utf8(digits).ok()?)
    })?;
    Some(Advert {
        uid,
        name: String::from_utf8_lossy(instance).into_owned(),
        socket: SocketAddrV4::new(ip.into(), port),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use wire::mdns::{AUTHORITY, RESPONSE, Section};

    /// A responder on the loopback that answers a question with these records, in the form of the
    /// board's.
    fn responder() -> (SocketAddrV4, std::thread::JoinHandle<()>) {
        let socket = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
        let SocketAddr::V4(at) = socket.local_addr().unwrap() else {
            unreachable!("bound to an IPv4 address")
        };
        let thread = std::thread::spawn(move || {
            let mut room = [0; 512];
            let (length, from) = socket.recv_from(&mut room).unwrap();
            let id = Message::parse(&room[..length]).unwrap().id;
            // Another's answer is to be ignored.
            for (id, last) in [(id ^ 1, 8), (id, 7)] {
                let mut out = [0; 512];
                let mut writer = Writer::new(&mut out, id, RESPONSE | AUTHORITY);
                let ip = [10, 0, 0, last];
                let host = &["mill", "local"][..];
                let instance = &["mill", "_ferrocnc", "_udp", "local"][..];
                writer.record(Section::Answer, (&FERROCNC, PTR, IN, 10), |data| {
                    data.name(instance)
                });
                writer.record(Section::Additional, (instance, SRV, IN, 10), |data| {
                    data.put(&[0, 0, 0, 0, 4, 210]) && data.name(host)
                });
                writer.record(Section::Additional, (instance, TXT, IN, 10), |data| {
                    data.string(UID.as_bytes(), b"d1620c8a1b2c3d4e")
                });
                writer.record(Section::Additional, (host, A, IN, 10), |data| data.put(&ip));
                let length = writer.finish();
                socket.send_to(&out[..length], from).unwrap();
            }
        });
        (at, thread)
    }

    #[test]
    fn names_of_multicast_dns_end_in_local() {
        for (host, local) in [
            ("mill.local", true),
            ("Mill.LOCAL.", true),
            ("mill", false),
            ("local", false),
            (".local", false),
            ("mill.local.example", false),
            ("192.168.2.50", false),
        ] {
            assert_eq!(is_local(host), local, "{host}");
        }
    }

    #[test]
    fn a_name_is_found_by_the_answer_to_this_question() {
        let (at, thread) = responder();
        let found = Asker::at(at).unwrap().resolve("MILL.local", WAIT).unwrap();
        thread.join().unwrap();
        assert_eq!(found, Some(Ipv4Addr::new(10, 0, 0, 7)));
    }

    #[test]
    fn a_board_is_found_with_its_id_name_and_port() {
        let (at, thread) = responder();
        let found = Asker::at(at).unwrap().boards(AGAIN / 2).unwrap();
        thread.join().unwrap();
        assert_eq!(found.len(), 1);
        assert_eq!(found[0].uid, [0xd162_0c8a, 0x1b2c_3d4e]);
        assert_eq!(
            (found[0].name.as_str(), found[0].socket.port()),
            ("mill", 1234)
        );
    }

    #[test]
    fn what_is_no_name_is_not_asked_for() {
        let asker = Asker::at(SocketAddrV4::new(Ipv4Addr::LOCALHOST, 9)).unwrap();
        for host in ["a..local", &format!("{}.local", "x".repeat(64))] {
            assert_eq!(asker.resolve(host, WAIT).unwrap(), None);
        }
    }
}
