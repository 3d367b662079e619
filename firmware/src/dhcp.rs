//! A minimal DHCP client (RFC 2131): one server, one lease, every message broadcast.
//!
//! ```text
//!   Selecting --offer--> Requesting --ack--> Bound --half the lease--> Renewing --ack--> Bound
//!       ^ ^________ 4 tries ___|                ^                          |
//!       |________________ nak, or the lease is over _______________________|
//! ```
//!
//! It knows seconds and words, but no sockets and no clocks. Renewals are broadcast, too, which
//! servers treat as rebinding: so no address has to be resolved. After [`FALLBACK_SECONDS`] without
//! a lease the board uses its static address and keeps asking.

use wire::settings::unicast;

/// UDP port of clients.
pub const PORT: u16 = 68;
/// UDP port of servers.
pub const SERVER_PORT: u16 = 67;
/// 10 s: three tries. A board on a bench without a server should be usable before its user gives
/// up.
pub const FALLBACK_SECONDS: u32 = 10;
/// Words of a message: BOOTP's minimum of 300 bytes.
pub const WORDS: usize = 75;

/// Longest wait between two tries.
const PAUSE_MAX: u32 = 64;
const COOKIE: u32 = 0x6382_5363;
const COOKIE_AT: usize = 59;
/// A request by a client on Ethernet; the server's answer has 2 in the first byte.
const REQUEST: u32 = 0x0101_0600;
const REPLY: u32 = 0x0201_0600;
/// The server has to broadcast: we may not have the address yet.
const BROADCAST: u32 = 0x8000;

const DISCOVER: u8 = 1;
const OFFER: u8 = 2;
const REQUEST_TYPE: u8 = 3;
const ACK: u8 = 5;
const NAK: u8 = 6;

/// A server's offer.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Lease {
    /// Our address.
    pub ip: u32,
    /// Bits of its netmask.
    pub prefix: u8,
    /// The router, 0 for none.
    pub gateway: u32,
    server: u32,
    seconds: u32,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum State {
    Off,
    Selecting,
    Requesting,
    Bound,
    Renewing,
}

/// The client.
#[derive(Clone, Debug)]
pub struct Client {
    state: State,
    xid: u32,
    /// Second of the start, of the last try, and of the lease.
    began: u32,
    tried: u32,
    bound: u32,
    tries: u8,
    lease: Lease,
}

impl Client {
    /// A client that is switched off.
    pub const fn off() -> Self {
        Client {
            state: State::Off,
            xid: 0,
            began: 0,
            tried: 0,
            bound: 0,
            tries: 0,
            lease: Lease {
                ip: 0,
                prefix: 24,
                gateway: 0,
                server: 0,
                seconds: 0,
            },
        }
    }

    /// A client that asks; `seed` differs from board to board and from start to start.
    pub const fn on(seed: u32) -> Self {
        Client {
            state: State::Selecting,
            xid: seed,
            ..Self::off()
        }
    }

    /// Is the client switched on?
    pub fn enabled(&self) -> bool {
        self.state != State::Off
    }

    /// The lease, while there is one.
    pub fn lease(&self) -> Option<&Lease> {
        match self.state {
            State::Bound | State::Renewing => Some(&self.lease),
            State::Off | State::Selecting | State::Requesting => None,
        }
    }

    /// Has it asked for so long that the static address is used?
    pub fn gave_up(&self, second: u32) -> bool {
        second.wrapping_sub(self.began) >= FALLBACK_SECONDS
    }

    /// Call it once a second. True if a message is to be sent ([`Client::emit`]).
    pub fn tick(&mut self, second: u32) -> bool {
        let held = second.wrapping_sub(self.bound);
        match self.state {
            State::Off => return false,
            State::Bound if held < self.lease.seconds / 2 => return false,
            State::Bound => self.go(State::Renewing),
            State::Renewing if held >= self.lease.seconds => self.go(State::Selecting),
            State::Requesting if self.tries >= 4 => self.go(State::Selecting),
            State::Selecting | State::Requesting | State::Renewing => {}
        }
        // At once, then after 2, 4, 8, ... seconds.
        let pause = (1u32 << self.tries.min(6)).min(PAUSE_MAX);
        if self.tries > 0 && second.wrapping_sub(self.tried) < pause {
            return false;
        }
        if self.state == State::Selecting {
            self.xid = self.xid.wrapping_add(1);
        }
        self.tries = self.tries.saturating_add(1);
        self.tried = second;
        true
    }

    fn go(&mut self, state: State) {
        self.state = state;
        self.tries = 0;
    }

    /// Writes the message to be sent.
    pub fn emit(&self, mac: [u8; 6], name: &str, words: &mut [u32; WORDS]) {
        let [a, b, c, d, e, f] = mac;
        *words = [0; WORDS];
        let renewing = self.state == State::Renewing;
        let head = [
            REQUEST,
            self.xid,
            BROADCAST,
            if renewing { self.lease.ip } else { 0 },
            0,
            0,
            0,
            u32::from_be_bytes([a, b, c, d]),
            u32::from_be_bytes([e, f, 0, 0]),
        ];
        for (place, word) in words.iter_mut().zip(head) {
            *place = word;
        }
        let mut options: heapless::Vec<u8, { (WORDS - COOKIE_AT - 1) * 4 }> = heapless::Vec::new();
        // There is room for all options: 3 + 5 + 6 + 6 + 2 + 32 + 1 bytes of 60.
        let mut put = |bytes: &[u8]| {
            let _ = options.extend_from_slice(bytes);
        };
        let kind = if self.state == State::Selecting {
            DISCOVER
        } else {
            REQUEST_TYPE
        };
        put(&[53, 1, kind]);
        // Netmask, router, lease time.
        put(&[55, 3, 1, 3, 51]);
        if self.state == State::Requesting {
            put(&[50, 4]);
            put(&self.lease.ip.to_be_bytes());
            put(&[54, 4]);
            put(&self.lease.server.to_be_bytes());
        }
        if !name.is_empty() {
            put(&[12, name.len() as u8]);
            put(name.as_bytes());
        }
        put(&[255]);
        options.resize(options.capacity(), 0).unwrap_or(());
        let options = options.as_chunks::<4>().0.iter();
        let tail = core::iter::once(COOKIE).chain(options.map(|chunk| u32::from_be_bytes(*chunk)));
        for (place, word) in words.iter_mut().skip(COOKIE_AT).zip(tail) {
            *place = word;
        }
    }

    /// Takes a server's answer of this many bytes. True if a message is to be sent at once.
    pub fn take(&mut self, mac: [u8; 6], words: &[u32], length: usize, second: u32) -> bool {
        let [a, b, c, d, e, f] = mac;
        let word = |n: usize| words.get(n).copied().unwrap_or(0);
        let ours = word(0) == REPLY
            && word(1) == self.xid
            && word(7) == u32::from_be_bytes([a, b, c, d])
            && word(8) >> 16 == u32::from(u16::from_be_bytes([e, f]))
            && word(COOKIE_AT) == COOKIE;
        if !ours || self.state == State::Off {
            return false;
        }
        let mut lease = Lease {
            ip: word(4),
            prefix: 24,
            gateway: 0,
            server: 0,
            seconds: u32::MAX,
        };
        let mut kind = 0;
        let byte = |at: usize| {
            let word = words.get(at / 4).filter(|_| at < length)?;
            word.to_be_bytes().get(at % 4).copied()
        };
        let mut at = (COOKIE_AT + 1) * 4;
        while let Some(code) = byte(at) {
            at += 1;
            match code {
                0 => continue,
                255 => break,
                _ => {}
            }
            let Some(count) = byte(at).map(usize::from) else {
                break;
            };
            let value = (1..=4usize.min(count)).fold(0, |value, n| {
                value << 8 | u32::from(byte(at + n).unwrap_or(0))
            });
            match (code, count) {
                (53, 1) => kind = value as u8,
                (1, 4) => lease.prefix = value.leading_ones() as u8,
                (3, 4..) => lease.gateway = value,
                (51, 4) => lease.seconds = value,
                (54, 4) => lease.server = value,
                _ => {}
            }
            at += 1 + count;
        }
        match (self.state, kind) {
            (State::Selecting, OFFER) if unicast(lease.ip) => {
                self.lease = lease;
                self.go(State::Requesting);
                return self.tick(second);
            }
            (State::Requesting | State::Renewing, ACK) if lease.ip == self.lease.ip => {
                self.lease = lease;
                self.bound = second;
                self.go(State::Bound);
            }
            (State::Requesting | State::Renewing, NAK) => self.go(State::Selecting),
            _ => {}
        }
        false
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MAC: [u8; 6] = [2, 1, 2, 3, 4, 5];
    const IP: u32 = 0xc0a8_0763;

    /// A server's answer to what was sent.
    fn answer(sent: &[u32; WORDS], kind: u8, lease: u32) -> Vec<u32> {
        let mut words = sent.to_vec();
        words[0] = REPLY;
        words[4] = IP;
        words.truncate(COOKIE_AT + 1);
        let [l0, l1, l2, l3] = lease.to_be_bytes();
        let options = [
            53, 1, kind, 0, 1, 4, 255, 255, 255, 0, 3, 8, 192, 168, 7, 1, 9, 9, 9, 9, 51, 4, l0,
            l1, l2, l3, 54, 4, 192, 168, 7, 2, 6, 0, 255, 0,
        ];
        words.extend(
            options
                .as_chunks::<4>()
                .0
                .iter()
                .map(|b| u32::from_be_bytes(*b)),
        );
        words
    }

    fn sent(client: &Client) -> [u32; WORDS] {
        let mut words = [0; WORDS];
        client.emit(MAC, "mill", &mut words);
        words
    }

    fn kind(words: &[u32; WORDS]) -> u8 {
        (words[60] >> 8) as u8
    }

    fn give(client: &mut Client, type_: u8, lease: u32, second: u32) -> bool {
        let words = answer(&sent(client), type_, lease);
        client.take(MAC, &words, words.len() * 4, second)
    }

    fn bound(lease: u32) -> Client {
        let mut client = Client::on(7);
        assert!(client.tick(0));
        assert_eq!(kind(&sent(&client)), DISCOVER);
        assert!(give(&mut client, OFFER, lease, 0), "asks at once");
        assert_eq!(kind(&sent(&client)), REQUEST_TYPE);
        assert!(!give(&mut client, ACK, lease, 0));
        client
    }

    #[test]
    fn an_address_is_offered_asked_for_and_used() {
        let client = bound(3600);
        let lease = client.lease().unwrap();
        assert_eq!(
            (lease.ip, lease.prefix, lease.gateway),
            (IP, 24, 0xc0a8_0701)
        );
    }

    #[test]
    fn without_a_server_it_gives_up_after_ten_seconds_and_keeps_asking() {
        let mut client = Client::on(7);
        let asked: Vec<u32> = (0..200).filter(|second| client.tick(*second)).collect();
        assert_eq!(asked[..6], [0, 2, 6, 14, 30, 62]);
        assert!(!client.gave_up(9) && client.gave_up(10));
        assert!(client.lease().is_none());
    }

    #[test]
    fn half_a_lease_is_renewed_and_a_whole_one_is_lost() {
        let mut client = bound(100);
        assert!((1..50).all(|second| !client.tick(second)));
        assert!(client.tick(50));
        let words = sent(&client);
        assert_eq!((kind(&words), words[3]), (REQUEST_TYPE, IP));
        assert!(!give(&mut client, ACK, 100, 51));
        assert!(!client.tick(100), "renewed at 51");
        assert!(client.tick(101));
        let asked = (102..151).filter(|second| client.tick(*second)).count();
        assert!(asked >= 4);
        assert!(client.lease().is_some());
        client.tick(151);
        assert!(client.lease().is_none());
    }

    #[test]
    fn a_no_begins_anew() {
        let mut client = bound(100);
        client.tick(50);
        give(&mut client, NAK, 100, 50);
        assert!(client.lease().is_none());
        assert!(client.tick(51));
        assert_eq!(kind(&sent(&client)), DISCOVER);
    }

    #[test]
    fn strangers_and_scraps_are_ignored() {
        let mut client = Client::on(7);
        client.tick(0);
        let offer = answer(&sent(&client), OFFER, 100);
        for word in [0, 1, 7, 8, COOKIE_AT] {
            let mut other = offer.clone();
            other[word] ^= 0x0100_0000;
            assert!(!client.take(MAC, &other, other.len() * 4, 0), "word {word}");
        }
        for length in 0..(COOKIE_AT + 1) * 4 + 3 {
            let words = &offer[..length.div_ceil(4)];
            assert!(!client.take(MAC, words, length, 0), "{length} bytes");
        }
        assert!(client.take(MAC, &offer, offer.len() * 4, 0));
        assert!(!Client::off().take(MAC, &offer, offer.len() * 4, 0));
    }

    proptest::proptest! {
        #[test]
        fn whatever_a_server_says_nothing_breaks(mut tail in proptest::collection::vec(0u32.., 0..80), cut in 0usize..400) {
            let mut client = Client::on(7);
            client.tick(0);
            let mut words = answer(&sent(&client), OFFER, 100);
            words.truncate(COOKIE_AT + 1);
            words.append(&mut tail);
            let length = (words.len() * 4).min(cut);
            client.take(MAC, &words, length, 1);
            client.tick(2);
        }
    }
}
