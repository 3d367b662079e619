//! The time from a server (RFC 4330, RFC 5905 in client mode): a question at the start and one each
//! hour. The stamps of the log and of the status page use it; nothing that moves the machine does.
//!
//! An answer counts only if it comes from the server that was asked, repeats the stamp of the
//! question, and is of a server that knows the time. Without an answer the question is asked again
//! after 16 s, then after ever longer times.

use crate::text::Out;

/// UDP port of servers.
pub const PORT: u16 = 123;
/// Bytes of a question and of an answer.
pub const PACKET: usize = 48;

/// 1970 in seconds since 1900.
const UNIX: u32 = 2_208_988_800;
const HOUR_MS: u32 = 3_600_000;
/// RFC 4330 asks for at least 15 s between two questions.
const AGAIN_MS: u32 = 16_000;
/// Version 4, a client.
const QUESTION: u8 = 4 << 3 | 3;
const SERVER: u8 = 4;
/// Leap indicator: the server's clock is not set.
const UNSET: u8 = 3;

/// The client.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Client {
    /// Address of the server, 0 for none.
    server: u32,
    /// When to ask next.
    due: Option<u32>,
    wait: u32,
    /// The stamp of the question that is open.
    asked: Option<[u8; 8]>,
    /// Unix time, and the milliseconds it was at.
    known: Option<(u32, u32)>,
}

impl Client {
    /// The server to ask, 0 for none. True if it is another one now.
    pub fn settle(&mut self, server: u32) -> bool {
        let other = self.server != server;
        if other {
            *self = Client {
                server,
                ..Client::default()
            };
        }
        other
    }

    /// Is a question due?
    pub fn busy(&self, now: u32) -> bool {
        let due = self.due.is_none_or(|due| now.wrapping_sub(due) as i32 >= 0);
        self.server != 0 && due
    }

    /// Writes the question if it is due; returns the server's address. `random` makes its stamp one
    /// that no other device can guess.
    pub fn poll(&mut self, now: u32, random: u32, packet: &mut [u8; PACKET]) -> Option<u32> {
        if !self.busy(now) {
            return None;
        }
        self.wait = match (self.asked, self.wait) {
            // It was answered, or is the first.
            (None, _) | (_, 0) => AGAIN_MS,
            (Some(_), wait) => wait.saturating_mul(2).min(HOUR_MS),
        };
        self.due = Some(now.wrapping_add(self.wait));
        let ([a, b, c, d], [e, f, g, h]) = (now.to_be_bytes(), random.to_be_bytes());
        let stamp = [a, b, c, d, e, f, g, h];
        self.asked = Some(stamp);
        *packet = [0; PACKET];
        packet[0] = QUESTION;
        if let Some(place) = packet.last_chunk_mut() {
            *place = stamp;
        }
        Some(self.server)
    }

    /// Takes a datagram from port [`PORT`] of that address. True if the time is known with it.
    pub fn take(&mut self, from: u32, packet: &[u8], now: u32) -> bool {
        let (Some(stamp), Some(packet)) = (self.asked, packet.first_chunk::<PACKET>()) else {
            return false;
        };
        let [first, stratum, ..] = *packet;
        let seconds = packet.get(40..44).and_then(|it| it.first_chunk());
        let seconds = seconds.map_or(0, |it| u32::from_be_bytes(*it));
        let right = from == self.server
            && first & 7 == SERVER
            && first >> 6 != UNSET
            && (1..16).contains(&stratum)
            && packet.get(24..32) == Some(&stamp)
            && seconds != 0;
        if right {
            // Era 1 begins in 2036: modulo 2^32 the difference is right in both.
            self.known = Some((seconds.wrapping_sub(UNIX), now));
            self.asked = None;
            self.wait = HOUR_MS;
            self.due = Some(now.wrapping_add(HOUR_MS));
        }
        right
    }

    /// Seconds since 1970; `None`: not known. The milliseconds wrap after 49 days; before that,
    /// there has been another answer, or the time is not known any more.
    pub fn unix(&self, now: u32) -> Option<u32> {
        const TRUSTED_MS: u32 = 24 * HOUR_MS;
        let (unix, at) = self.known?;
        let passed = now.wrapping_sub(at);
        (passed < TRUSTED_MS).then(|| unix.wrapping_add(passed / 1000))
    }
}

/// A date as RFC 3339 writes it: `2026-11-24T17:00:00Z`.
pub fn date(unix: u32, out: &mut Out) {
    let (mut days, seconds) = (unix / 86_400, unix % 86_400);
    let mut year = 1970;
    let length = |year: u32| 365 + u32::from(leap(year));
    while days >= length(year) {
        days -= length(year);
        year += 1;
    }
    let february = 28 + u32::from(leap(year));
    let mut month = 1;
    for length in [31, february, 31, 30, 31, 30, 31, 31, 30, 31, 30, 31] {
        if days < length {
            break;
        }
        days -= length;
        month += 1;
    }
    out.number(year);
    let parts = [
        ("-", month),
        ("-", days + 1),
        ("T", seconds / 3600),
        (":", seconds / 60 % 60),
        (":", seconds % 60),
    ];
    for (before, part) in parts {
        out.text(before).either(part < 10, "0", "").number(part);
    }
    out.text("Z");
}

/// Unix time in 32 bits ends in 2106: 2100 is no leap year.
fn leap(year: u32) -> bool {
    year.is_multiple_of(4) && year != 2100
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const SERVER_IP: u32 = 0xc0a8_0201;

    fn client() -> Client {
        let mut client = Client::default();
        client.settle(SERVER_IP);
        client
    }

    /// The answer of a server whose clock shows this many seconds since 1900.
    fn answer(question: &[u8; PACKET], seconds: u32) -> [u8; PACKET] {
        let mut packet = [0; PACKET];
        packet[0] = 4 << 3 | SERVER;
        packet[1] = 2;
        packet[24..32].copy_from_slice(&question[40..]);
        packet[40..44].copy_from_slice(&seconds.to_be_bytes());
        packet
    }

    fn said(unix: u32) -> String {
        let mut text = String::new();
        date(unix, &mut Out(&mut text));
        text
    }

    #[test]
    fn an_answer_sets_the_clock_and_an_hour_passes_before_the_next_question() {
        let mut client = client();
        let mut packet = [0; PACKET];
        assert_eq!(client.unix(0), None);
        assert_eq!(client.poll(5, 99, &mut packet), Some(SERVER_IP));
        assert_eq!(packet[0], 0x23);
        assert_eq!(client.poll(6, 99, &mut packet), None);
        let reply = answer(&packet, UNIX + 1_700_000_000);
        assert!(client.take(SERVER_IP, &reply, 100));
        assert!(!client.take(SERVER_IP, &reply, 100), "a second time");
        assert_eq!(client.unix(100 + 61_000), Some(1_700_000_061));
        assert!(!client.busy(100 + HOUR_MS - 1) && client.busy(100 + HOUR_MS));
        assert_eq!(client.unix(100 + 25 * HOUR_MS), None, "too long ago");
    }

    #[test]
    fn a_silent_server_is_asked_ever_more_seldom() {
        let mut client = client();
        let mut packet = [0; PACKET];
        let asked: Vec<u32> = (0..3 * HOUR_MS)
            .step_by(1000)
            .filter(|now| client.poll(*now, 1, &mut packet).is_some())
            .collect();
        assert_eq!(asked[..3], [0, 16_000, 48_000]);
        assert!(asked.len() < 14, "{asked:?}");
    }

    #[test]
    fn what_does_not_answer_the_question_is_no_time() {
        let mut client = client();
        let mut packet = [0; PACKET];
        client.poll(0, 1, &mut packet);
        let good = answer(&packet, UNIX + 1);
        let with = |at: usize, value: u8| {
            let mut bad = good;
            bad[at] = value;
            bad
        };
        assert!(!client.take(SERVER_IP + 1, &good, 0), "another host");
        assert!(!client.take(SERVER_IP, &good[..47], 0), "cut off");
        for (why, bad) in [
            ("not a server", with(0, 4 << 3 | 3)),
            ("its clock is not set", with(0, 3 << 6 | 4 << 3 | 4)),
            ("kiss of death", with(1, 0)),
            ("no stratum", with(1, 16)),
            ("another question", with(24, 0xff)),
            ("no time", answer(&packet, 0)),
        ] {
            assert!(!client.take(SERVER_IP, &bad, 0), "{why}");
        }
        assert!(client.take(SERVER_IP, &good, 0));
    }

    #[test]
    fn the_clock_goes_on_in_2036() {
        let mut client = client();
        let mut packet = [0; PACKET];
        client.poll(0, 1, &mut packet);
        // Seconds of era 1: 2^32 after 1900.
        assert!(client.take(SERVER_IP, &answer(&packet, 1), 0));
        assert_eq!(said(client.unix(0).unwrap()), "2036-02-07T06:28:17Z");
    }

    #[test]
    fn no_server_is_not_asked() {
        let mut client = Client::default();
        assert!(!client.busy(0) && client.poll(0, 1, &mut [0; PACKET]).is_none());
    }

    #[test]
    fn dates_are_those_of_the_calendar() {
        for (unix, wanted) in [
            (0, "1970-01-01T00:00:00Z"),
            (951_782_399, "2000-02-28T23:59:59Z"),
            (951_782_400, "2000-02-29T00:00:00Z"),
            (1_735_689_599, "2024-12-31T23:59:59Z"),
            (4_107_542_400, "2100-03-01T00:00:00Z"),
            (u32::MAX, "2106-02-07T06:28:15Z"),
        ] {
            assert_eq!(said(unix), wanted);
        }
    }

    proptest! {
        #[test]
        fn no_answer_upsets_it(packet in proptest::collection::vec(any::<u8>(), 0..60), now: u32) {
            let mut client = client();
            client.poll(0, 7, &mut [0; PACKET]);
            client.take(SERVER_IP, &packet, now);
            client.unix(now);
        }
    }
}
