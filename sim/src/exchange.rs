//! Recognises exchanges on the wire and measures them. It does not check them; the firmware does.

use std::collections::HashMap;

use crate::gmii::Sent;
use crate::lan_segment::Endpoint;
use wire::etherbone::{FLAG_PROBE, HEADER_WORDS, MAGIC, OVERHEAD, counts};
use wire::exchange::{StateWord, command_word, status_word};

/// Where a first record's base write address stands, in words.
const BASE_AT: usize = OVERHEAD - 1;

/// A word of a datagram, which need not have whole words.
fn word(payload: &[u8], at: usize) -> Option<u32> {
    let (words, _) = payload.as_chunks();
    words.get(at).copied().map(u32::from_be_bytes)
}

/// A word of what a first record writes.
fn written(payload: &[u8], at: usize) -> Option<u32> {
    word(payload, OVERHEAD + at)
}

fn is_etherbone(payload: &[u8]) -> bool {
    word(payload, 0).is_some_and(|header| header >> 16 == MAGIC)
}

fn is_write(payload: &[u8]) -> bool {
    is_etherbone(payload) && word(payload, HEADER_WORDS).is_some_and(|record| counts(record).0 != 0)
}

/// The datagram reads, and writes nothing.
pub fn is_read(payload: &[u8]) -> bool {
    is_etherbone(payload) && !is_write(payload) && wants_reply(payload)
}

/// The datagram carries a command block (well-formed or not): an Etherbone write based at the
/// COMMAND window.
pub fn is_request(payload: &[u8]) -> bool {
    is_write(payload) && word(payload, BASE_AT) == Some(wire::map::COMMAND)
}

/// Sequence number of a command block.
pub fn sequence(payload: &[u8]) -> Option<u32> {
    is_request(payload)
        .then(|| written(payload, command_word::SEQUENCE))
        .flatten()
}

/// Flags of a command block.
fn flags(payload: &[u8]) -> Option<u32> {
    is_request(payload)
        .then(|| written(payload, command_word::FLAGS))
        .flatten()
}

/// The datagram asks for something that a board answers: reads, a probe or an exchange.
pub fn wants_reply(payload: &[u8]) -> bool {
    let probe = word(payload, 0).is_some_and(|header| header & FLAG_PROBE != 0);
    let (mut at, mut reads) = (HEADER_WORDS, false);
    while let Some(record) = word(payload, at) {
        let (writes, read) = counts(record);
        reads |= read != 0;
        // Each half that is there has a base address before its words.
        let words = |count: usize| if count == 0 { 0 } else { 1 + count };
        at += 1 + words(writes) + words(read);
    }
    is_request(payload) || probe || reads
}

/// What the harness reads out of a status block.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StatusHead {
    /// Sequence number echoed.
    pub sequence: u32,
    /// The state word.
    pub state: u32,
    /// Clocks the watchdog had left when the command arrived.
    pub watchdog_left: u32,
}

impl StatusHead {
    /// Of a reply to the exchange numbered `sequence`.
    pub fn parse(payload: &[u8], sequence: u32) -> Option<Self> {
        (is_write(payload)
            && word(payload, BASE_AT) == Some(sequence)
            && written(payload, status_word::SEQUENCE) == Some(sequence))
        .then_some(())?;
        Some(StatusHead {
            sequence,
            state: written(payload, status_word::STATE)?,
            watchdog_left: written(payload, status_word::WATCHDOG_LEFT)?,
        })
    }

    /// The gate was open.
    pub fn enabled(&self) -> bool {
        self.state & StateWord::ENABLED != 0
    }
}

/// A request the board has been or is being fed.
#[derive(Clone, Copy, Debug)]
struct Pending {
    id: u64,
    sequence: Option<u32>,
    flags: Option<u32>,
    /// A host has written something else since the exchange before this one.
    behind_a_write: bool,
    wire_len: usize,
    /// Times, once it has been fed in full.
    fed: Option<Sent>,
}

/// How a request was answered.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Timing {
    /// End of the last request byte to start of the first reply byte, sys clocks, rounded up.
    pub turnaround: u64,
    /// Start of the first request byte to end of the last reply byte, sys clocks, rounded up.
    pub total: u64,
    /// Request bytes on the wire, preamble and FCS included.
    pub request_bytes: usize,
    /// Reply bytes on the wire, preamble and FCS included.
    pub reply_bytes: usize,
}

/// Smallest, middle and largest of some figures.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct Spread {
    /// Smallest.
    pub min: u64,
    /// Middle one, the lower of two.
    pub median: u64,
    /// Largest.
    pub max: u64,
}

impl Spread {
    /// Of a list; `None` when it is empty.
    pub fn of(values: &[u32]) -> Option<Self> {
        let mut sorted = values.to_vec();
        sorted.sort_unstable();
        Some(Spread {
            min: u64::from(*sorted.first()?),
            median: u64::from(sorted[(sorted.len() - 1) / 2]),
            max: u64::from(*sorted.last()?),
        })
    }
}

/// What an exchange says of the machine: its flags, and the state and the gate in its answer.
type MachineSaid = (Option<u32>, u32);

/// Bits of a state word: the state and the gate.
const STATE_AND_GATE: u32 = ((1 << StateWord::SPEED_SHIFT) - 1) | StateWord::ENABLED;

/// Matches replies with requests and keeps the figures of exchanges.
#[derive(Debug, Default)]
pub struct Meter {
    pending: HashMap<Endpoint, Vec<Pending>>,
    /// Turnaround of every answered exchange in order, sys clocks.
    pub turnarounds: Vec<u32>,
    /// The same exchanges from the first byte in to the last byte out, sys clocks.
    pub totals: Vec<u32>,
    /// Which of them, counted from 1, the firmware cannot foresee: the first, those behind another
    /// write of a host (session, settings), and those that have other flags than the one before or
    /// are answered with another state or gate.
    pub unforeseen: Vec<usize>,
    last_machine: Option<MachineSaid>,
    wrote: bool,
    /// Exchanges fed to the board.
    pub requested: u64,
    /// Exchanges answered.
    pub answered: u64,
    /// Least the watchdog had left at the arrival of a command while the gate was open, sys clocks.
    pub watchdog_margin: Option<u32>,
    /// State word of the last status block.
    pub last_state: Option<u32>,
}

impl Meter {
    /// Requests remembered per sender; older ones were lost.
    const REMEMBERED: usize = 8;

    /// Frame `id` to the board is a datagram from `from`.
    pub fn request(&mut self, id: u64, from: Endpoint, payload: &[u8], wire_len: usize) {
        let sequence = sequence(payload);
        self.requested += u64::from(sequence.is_some());
        let behind_a_write = sequence.is_some() && core::mem::take(&mut self.wrote);
        self.wrote |= sequence.is_none() && is_write(payload);
        let list = self.pending.entry(from).or_default();
        if list.len() == Self::REMEMBERED {
            list.remove(0);
        }
        list.push(Pending {
            id,
            sequence,
            flags: flags(payload),
            behind_a_write,
            wire_len,
            fed: None,
        });
    }

    /// A frame has been fed in full.
    pub fn sent(&mut self, sent: Sent) {
        for pending in self.pending.values_mut().flatten() {
            if pending.id == sent.id {
                pending.fed = Some(sent);
            }
        }
    }

    /// A datagram came for `to`, its bytes on the wire from tick `first` to `last`. Returns how it
    /// fits a request.
    pub fn reply(
        &mut self,
        to: Endpoint,
        payload: &[u8],
        (first, last, wire_len): (u64, u64, usize),
        clocks: impl Fn(u64) -> u64,
    ) -> Option<Timing> {
        let list = self.pending.get_mut(&to)?;
        // An exchange by its sequence number; anything else is the answer to the last request
        // before it.
        let by_sequence = list.iter().position(|p| {
            p.sequence
                .is_some_and(|s| p.fed.is_some() && StatusHead::parse(payload, s).is_some())
        });
        let before =
            |p: &Pending| p.sequence.is_none() && p.fed.is_some_and(|sent| sent.last <= first);
        let at = by_sequence.or_else(|| list.iter().position(before))?;
        let request = list.remove(at);
        let sent = request.fed?;
        let timing = Timing {
            turnaround: clocks(first.saturating_sub(sent.last)),
            total: clocks(last.saturating_sub(sent.first)),
            request_bytes: request.wire_len,
            reply_bytes: wire_len,
        };
        if let Some(head) = request.sequence.and_then(|s| StatusHead::parse(payload, s)) {
            self.turnarounds.push(timing.turnaround as u32);
            self.totals.push(timing.total as u32);
            let machine = (request.flags, head.state & STATE_AND_GATE);
            let last = self.last_machine.replace(machine);
            if request.behind_a_write || last != Some(machine) {
                self.unforeseen.push(self.turnarounds.len());
            }
            self.answer(head);
        }
        Some(timing)
    }

    /// An exchange has been answered like this.
    pub(crate) fn answer(&mut self, head: StatusHead) {
        self.answered += 1;
        // The command that opens the gate arrives while the watchdog still sleeps and has nothing
        // left.
        let was_enabled = self
            .last_state
            .is_some_and(|state| StatusHead { state, ..head }.enabled());
        self.last_state = Some(head.state);
        if head.enabled() && was_enabled {
            let least = self.watchdog_margin.unwrap_or(u32::MAX);
            self.watchdog_margin = Some(least.min(head.watchdog_left));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::net::Ipv4Addr;

    const ME: Endpoint = (Ipv4Addr::new(192, 168, 2, 1), 40000);

    fn packet(words: &[u32]) -> Vec<u8> {
        words.iter().flat_map(|w| w.to_be_bytes()).collect()
    }

    fn request(sequence: u32) -> Vec<u8> {
        packet(&[
            0x4e6f_1044,
            0,
            0x000f_0300,
            wire::map::COMMAND,
            0x1111,
            sequence,
            1,
        ])
    }

    fn status(sequence: u32, state: u32, left: u32) -> Vec<u8> {
        packet(&[
            0x4e6f_1044,
            0,
            0x000f_0700,
            sequence,
            state,
            sequence,
            0,
            0,
            0,
            0,
            left,
        ])
    }

    #[test]
    fn tells_exchanges_from_other_datagrams() {
        assert_eq!(sequence(&request(7)), Some(7));
        let read = packet(&[0x4e6f_1044, 0, 0x000f_0001, 0, wire::map::COMMAND]);
        let write = packet(&[0x4e6f_1044, 0, 0x000f_0100, wire::map::SESSION, 5]);
        let probe = packet(&[0x4e6f_1144, 0]);
        assert_eq!([&read, &write, &probe].map(|p| is_request(p)), [false; 3]);
        let both = packet(&[
            0x4e6f_1044,
            0,
            0x000f_0100,
            wire::map::SESSION,
            5,
            0x000f_0001,
            0,
            0,
        ]);
        let asked = [&read, &write, &probe, &request(1), &both].map(|p| wants_reply(p));
        assert_eq!(asked, [true, false, true, true, true]);
        assert!(!is_request(b"") && !wants_reply(b"Nope"));
    }

    fn fed(meter: &mut Meter, id: u64, payload: &[u8], first: u64, last: u64) {
        meter.request(id, ME, payload, payload.len() + 54);
        meter.sent(Sent { id, first, last });
    }

    #[test]
    fn turnaround_is_last_byte_in_to_first_byte_out() {
        let mut meter = Meter::default();
        fed(&mut meter, 9, &request(4), 0, 100);
        meter
            .reply(ME, &status(4, 1 << 17, 0), (200, 300, 200), |t| {
                t.div_ceil(25)
            })
            .unwrap();
        fed(&mut meter, 0, &request(5), 1000, 2000);
        let timing = meter
            .reply(ME, &status(5, 1 << 17, 300), (4510, 6000, 200), |t| {
                t.div_ceil(25)
            })
            .unwrap();
        assert_eq!((timing.turnaround, timing.total), (101, 200));
        assert_eq!((timing.reply_bytes, timing.request_bytes), (200, 28 + 54));
        assert_eq!(
            (meter.requested, meter.answered, meter.watchdog_margin),
            (2, 2, Some(300))
        );
    }

    #[test]
    fn a_lost_reply_does_not_shift_the_others() {
        let mut meter = Meter::default();
        fed(&mut meter, 0, &request(5), 0, 100);
        fed(&mut meter, 1, &request(6), 1000, 1100);
        let timing = meter
            .reply(ME, &status(6, 0, 10), (1200, 1300, 0), |t| t)
            .unwrap();
        assert_eq!(timing.turnaround, 100);
        assert_eq!((meter.requested, meter.answered), (2, 1));
        assert_eq!(meter.watchdog_margin, None, "a closed gate has no margin");
    }

    #[test]
    fn the_first_exchange_one_behind_settings_and_changes_are_unforeseen() {
        let mut meter = Meter::default();
        let gate = StateWord::ENABLED;
        let link_error = 1 << StateWord::ERRORS_SHIFT;
        let settings = packet(&[0x4e6f_1044, 0, 0x000f_0100, wire::map::SESSION, 5]);
        let read = packet(&[0x4e6f_1044, 0, 0x000f_0001, 0, wire::map::COMMAND]);
        // Before it, its flags, and the state word: frames that the MAC dropped are no change.
        let exchanges: [(&[&[u8]], u32, u32); 9] = [
            (&[], 0, 1),
            (&[&settings, &read], 0, 1),
            (&[&read], 0, 1),
            (&[], 1, 1),
            (&[], 3, 1),
            (&[], 3, 2),
            (&[], 3, 2 | gate),
            (&[], 3, 2 | gate | link_error),
            (&[], 1, 2 | gate | link_error),
        ];
        for (n, (before, flags, state)) in (1..).zip(exchanges) {
            for other in before {
                fed(&mut meter, 100, other, 0, 0);
            }
            let mut command = request(n);
            let at = 4 * (OVERHEAD + command_word::FLAGS);
            command[at..at + 4].copy_from_slice(&u32::to_be_bytes(flags));
            fed(&mut meter, n.into(), &command, 0, 100);
            let answer = status(n, state, 0);
            meter.reply(ME, &answer, (200, 300, 0), |t| t).unwrap();
        }
        assert_eq!(meter.unforeseen, [1, 2, 4, 5, 6, 7, 9]);
    }

    #[test]
    fn plain_replies_are_matched_in_order_and_not_counted() {
        let mut meter = Meter::default();
        let read = packet(&[0x4e6f_1044, 0, 0x000f_0001, 0, 0]);
        fed(&mut meter, 0, &read, 0, 100);
        let answer = packet(&[0x4e6f_1044, 0, 0x000f_0100, 0, 0x4643_5231]);
        assert_eq!(
            meter
                .reply(ME, &answer, (160, 200, 0), |t| t)
                .unwrap()
                .turnaround,
            60
        );
        assert_eq!(meter.answered, 0);
        assert!(meter.reply(ME, &answer, (160, 200, 0), |t| t).is_none());
        assert!(
            meter
                .reply((ME.0, 1), &answer, (160, 200, 0), |t| t)
                .is_none()
        );
    }

    #[test]
    fn spread_of_a_list() {
        assert_eq!(Spread::of(&[]), None);
        assert_eq!(
            Spread::of(&[5, 1, 9, 7]),
            Some(Spread {
                min: 1,
                median: 5,
                max: 9
            })
        );
    }
}
