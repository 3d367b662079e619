//! Events for a syslog server, as RFC 5424 has them, one UDP datagram each:
//!
//! ```text
//!   <131>1 2026-11-24T17:00:00Z mill ferrocnc 12 - - stopped: e-stop input
//!    |    |      |               |     |      start of the firmware
//!    |    version                name of the board
//!    facility local0, severity   `-` while the time is not known
//! ```
//!
//! The entries of the [journal](super::journal) are sent in their order, one a turn; what the
//! journal has lost meanwhile is not sent. UDP: whether a message arrived is not known.

use super::journal::{Entry, Journal};
use super::sntp::date;
use crate::text::{Out, Paper};

/// UDP port of servers.
pub const PORT: u16 = 514;
/// Longest message.
pub const MESSAGE: usize = 256;
/// Local use 0.
const FACILITY: u32 = 16;

/// Which entries have been sent.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Sender {
    /// Address of the server, 0 for none.
    server: u32,
    /// The next entry.
    next: u32,
}

impl Sender {
    /// From the journal's entry with this number on: what was logged before the start has been sent
    /// by the start that logged it.
    pub fn new(next: u32) -> Self {
        Sender { server: 0, next }
    }

    /// The server, 0 for none. True if it is another one now.
    pub fn settle(&mut self, server: u32) -> bool {
        core::mem::replace(&mut self.server, server) != server
    }

    /// Is there something to send?
    pub fn busy(&self, journal: &Journal) -> bool {
        self.server != 0 && self.next < journal.next()
    }

    /// Writes the next message; returns the server's address and its length.
    pub fn poll(
        &mut self,
        journal: &Journal,
        host: &str,
        room: &mut [u8; MESSAGE],
    ) -> Option<(u32, usize)> {
        if self.server == 0 {
            return None;
        }
        let numbers = journal.numbers();
        self.next = self.next.max(numbers.start);
        while self.next < numbers.end {
            let entry = journal.entry(self.next);
            self.next += 1;
            if let Some(entry) = entry {
                return Some((self.server, message(&entry, host, room)));
            }
        }
        None
    }
}

/// Writes a message; returns its length.
pub fn message(entry: &Entry, host: &str, room: &mut [u8; MESSAGE]) -> usize {
    let mut paper = Paper::new(room);
    let mut out = Out(&mut paper);
    let priority = FACILITY * 8 + entry.severity as u32;
    out.text("<").number(priority).text(">1 ");
    match entry.stamp.unix {
        Some(unix) => date(unix, &mut out),
        None => {
            out.text("-");
        }
    }
    out.text(" ").text(host).text(" ferrocnc ");
    out.number(entry.stamp.boot & 0xffff).text(" - - ");
    // Behind the header any text may stand, but servers put it into lines.
    out.ascii(entry.text.as_bytes());
    paper.used()
}

#[cfg(test)]
mod tests {
    use super::super::journal::{BYTES, SLOT, Severity, Stamp};
    use super::*;

    const SERVER: u32 = 0xc0a8_0201;

    fn sent(sender: &mut Sender, journal: &Journal) -> Vec<String> {
        let mut room = [0; MESSAGE];
        let mut all = Vec::new();
        while let Some((to, length)) = sender.poll(journal, "mill", &mut room) {
            assert_eq!(to, SERVER);
            all.push(String::from_utf8(room[..length].to_vec()).unwrap());
        }
        assert!(!sender.busy(journal));
        all
    }

    fn stamp(unix: Option<u32>) -> Stamp {
        Stamp {
            boot: 0xbeef_000c,
            uptime: 3,
            unix,
        }
    }

    #[test]
    fn events_leave_in_the_form_of_rfc_5424() {
        let mut memory = vec![0; BYTES];
        let mut journal = Journal::open(&mut memory);
        journal.log(stamp(None), Severity::Info, "before");
        let mut sender = Sender::new(journal.next());
        journal.log(stamp(None), Severity::Error, "stopped: e-stop\ninput");
        journal.log(stamp(Some(1_700_000_000)), Severity::Info, "armed");
        assert!(sent(&mut sender, &journal).is_empty(), "no server");
        sender.settle(SERVER);
        assert!(sender.busy(&journal));
        assert_eq!(
            sent(&mut sender, &journal),
            [
                "<131>1 - mill ferrocnc 12 - - stopped: e-stop.input",
                "<134>1 2023-11-14T22:13:20Z mill ferrocnc 12 - - armed",
            ]
        );
        journal.log(stamp(None), Severity::Warning, "link down");
        assert_eq!(sent(&mut sender, &journal).len(), 1);
    }

    #[test]
    fn what_the_journal_lost_is_skipped() {
        let mut memory = vec![0; 4 * SLOT];
        let mut journal = Journal::open(&mut memory);
        let mut sender = Sender::new(journal.next());
        sender.settle(SERVER);
        for n in 0..10 {
            journal.log(stamp(None), Severity::Info, &n.to_string());
        }
        assert_eq!(sent(&mut sender, &journal).len(), 4);
    }

    #[test]
    fn the_longest_entry_and_name_fit() {
        let mut memory = vec![0; BYTES];
        let mut journal = Journal::open(&mut memory);
        let text = "x".repeat(super::super::journal::TEXT);
        let unix = Some(u32::MAX);
        journal.log(stamp(unix), Severity::Error, &text);
        let mut room = [0; MESSAGE];
        let host = "h".repeat(wire::mdns::LABEL);
        let length = message(&journal.entry(1).unwrap(), &host, &mut room);
        assert!(room[..length].ends_with(text.as_bytes()));
    }
}
