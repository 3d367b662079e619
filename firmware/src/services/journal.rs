//! A log of events that outlives a restart of the firmware and of the services: a ring of entries
//! in SDRAM that no program clears. It does not outlive a loss of power.
//!
//! ```text
//!   word 0 magic   1 number   2 boot id   3 seconds since power-up   4 Unix time, 0 unknown
//!        5 severity << 8 | bytes of text    6.. text, 100 bytes    31 CRC-32 of words 1..=30
//! ```
//!
//! An entry's number says where it stands, so there is no head that could be wrong. What is found
//! at the start is an entry only if magic, number, place and CRC fit: memory after power-up is an
//! empty journal, and an entry that was being written when the power or the program went is
//! skipped. The magic is taken away first and written last.

use crate::text::Out;
use wire::crc::crc32;

/// Bytes of an entry.
pub const SLOT: usize = 128;
/// Longest text of an entry; a longer one takes several.
pub const TEXT: usize = 100;
/// Entries that are kept at most. The search for the newest takes some 10 000 clocks.
pub const SLOTS: usize = 256;
/// Bytes of the whole.
pub const BYTES: usize = SLOTS * SLOT;

/// "FJRN".
const MAGIC: u32 = 0x464a_524e;
/// If so many of the newest entries are torn, the others are not looked for.
const TORN: u32 = 8;
const TEXT_AT: usize = 24;
const CRC_AT: usize = SLOT - 4;
const _: () = assert!(TEXT_AT + TEXT == CRC_AT);

/// How bad it is: the numbers of syslog.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Severity {
    /// The machine stopped, or a part of the firmware failed.
    Error = 3,
    /// Something is not as it should be.
    Warning = 4,
    /// A change that is worth a line.
    Notice = 5,
    /// All else.
    Info = 6,
}

impl Severity {
    const fn from_code(code: u8) -> Self {
        match code {
            3 => Severity::Error,
            4 => Severity::Warning,
            5 => Severity::Notice,
            _ => Severity::Info,
        }
    }
}

/// When something was.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Stamp {
    /// The start of the firmware it was in.
    pub boot: u32,
    /// Seconds since power-up.
    pub uptime: u32,
    /// Seconds since 1970; `None`: not known.
    pub unix: Option<u32>,
}

/// An entry.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Entry<'j> {
    /// Its number.
    pub number: u32,
    /// When.
    pub stamp: Stamp,
    /// How bad.
    pub severity: Severity,
    /// What.
    pub text: &'j str,
}

/// The ring.
#[derive(Debug)]
pub struct Journal<'m> {
    slots: &'m mut [[u8; SLOT]],
    /// Number of the next entry.
    next: u32,
}

/// A word of an entry.
fn word(slot: &[u8; SLOT], n: usize) -> u32 {
    let bytes = slot.get(4 * n..4 * n + 4).and_then(|it| it.first_chunk());
    bytes.map_or(0, |bytes| u32::from_le_bytes(*bytes))
}

/// The entry in a slot, if there is one.
fn read(slot: &[u8; SLOT]) -> Option<Entry<'_>> {
    let (body, crc) = slot.split_last_chunk::<4>()?;
    let intact = word(slot, 0) == MAGIC && crc32(body.get(4..)?) == u32::from_le_bytes(*crc);
    let lengths = word(slot, 5);
    let text = body.get(TEXT_AT..)?.get(..(lengths & 0xff) as usize)?;
    let unix = word(slot, 4);
    intact.then_some(Entry {
        number: word(slot, 1),
        stamp: Stamp {
            boot: word(slot, 2),
            uptime: word(slot, 3),
            unix: (unix != 0).then_some(unix),
        },
        severity: Severity::from_code((lengths >> 8) as u8),
        text: core::str::from_utf8(text).ok()?,
    })
}

impl<'m> Journal<'m> {
    /// What is in this memory, from before or not; the first [`BYTES`] of it at most.
    pub fn open(memory: &'m mut [u8]) -> Self {
        let (slots, _) = memory.as_chunks_mut();
        let count = slots.len().min(SLOTS);
        let (slots, _) = slots.split_at_mut(count);
        let mut journal = Journal { slots, next: 1 };
        // Only magic, number and place of all entries; the CRC of the few that may be the newest.
        let mut below = u32::MAX;
        for _ in 0..TORN {
            let Some(newest) = journal.candidate(below) else {
                break;
            };
            if journal.entry(newest).is_some() {
                journal.next = newest + 1;
                break;
            }
            below = newest;
        }
        journal
    }

    /// The largest number below this one that stands where it should.
    fn candidate(&self, below: u32) -> Option<u32> {
        let mut newest = None;
        for (at, slot) in self.slots.iter().enumerate() {
            let number = word(slot, 1);
            let fits = word(slot, 0) == MAGIC && number < below && self.place(number) == Some(at);
            if fits && newest.is_none_or(|newest| newest < number) {
                newest = Some(number);
            }
        }
        newest
    }

    fn place(&self, number: u32) -> Option<usize> {
        (number as usize).checked_rem(self.slots.len())
    }

    /// The number of the next entry.
    pub fn next(&self) -> u32 {
        self.next
    }

    /// The numbers that may be there, from the oldest on.
    pub fn numbers(&self) -> core::ops::Range<u32> {
        self.next.saturating_sub(self.slots.len() as u32).max(1)..self.next
    }

    /// The entry with this number. `None`: overwritten, torn, or not yet written.
    pub fn entry(&self, number: u32) -> Option<Entry<'_>> {
        let slot = self.slots.get(self.place(number)?)?;
        let there = word(slot, 0) == MAGIC && word(slot, 1) == number;
        there.then(|| read(slot)).flatten()
    }

    /// Appends a text, in as many entries as it takes; an empty one in none.
    pub fn log(&mut self, stamp: Stamp, severity: Severity, text: &str) {
        let mut rest = text;
        while !rest.is_empty() {
            // A place between two characters: there is one.
            let Some((piece, behind)) = rest.split_at_checked(cut(rest)) else {
                break;
            };
            self.append(stamp, severity, piece);
            rest = behind;
        }
    }

    fn append(&mut self, stamp: Stamp, severity: Severity, text: &str) {
        let number = self.next;
        let place = self.place(number);
        let Some(slot) = place.and_then(|place| self.slots.get_mut(place)) else {
            return;
        };
        self.next = number.wrapping_add(1).max(1);
        let head = [
            0,
            number,
            stamp.boot,
            stamp.uptime,
            stamp.unix.unwrap_or(0),
            u32::from(severity as u8) << 8 | text.len() as u32,
        ];
        for (place, word) in slot.as_chunks_mut().0.iter_mut().zip(head) {
            *place = word.to_le_bytes();
        }
        if let Some(place) = slot.get_mut(TEXT_AT..TEXT_AT + text.len()) {
            place.copy_from_slice(text.as_bytes());
        }
        let crc = crc32(slot.get(4..CRC_AT).unwrap_or(&[]));
        if let Some(place) = slot.last_chunk_mut() {
            *place = crc.to_le_bytes();
        }
        if let Some(place) = slot.first_chunk_mut() {
            *place = MAGIC.to_le_bytes();
        }
    }
}

/// Where a text is cut: behind [`TEXT`] bytes or before, between two characters.
fn cut(text: &str) -> usize {
    let most = text.len().min(TEXT);
    let end = (1..=most).rev().find(|end| text.is_char_boundary(*end));
    end.unwrap_or(text.len())
}

/// When it was, for people: the time if it is known, or the start and the time since power-up.
pub fn when(stamp: Stamp, out: &mut Out) {
    match stamp.unix {
        Some(unix) => super::sntp::date(unix, out),
        None => {
            out.text("start ").number(stamp.boot & 0xffff).text(" +");
            duration(stamp.uptime, out);
        }
    }
}

/// Hours, minutes, seconds.
pub fn duration(seconds: u32, out: &mut Out) {
    out.number(seconds / 3600);
    for part in [seconds / 60 % 60, seconds % 60] {
        out.text(":").either(part < 10, "0", "").number(part);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const STAMP: Stamp = Stamp {
        boot: 7,
        uptime: 61,
        unix: None,
    };

    fn texts(journal: &Journal) -> Vec<String> {
        let entries = journal.numbers().filter_map(|n| journal.entry(n));
        entries.map(|entry| entry.text.to_owned()).collect()
    }

    #[test]
    fn what_was_logged_is_there_after_a_restart() {
        let mut memory = vec![0xa5; BYTES];
        let mut journal = Journal::open(&mut memory);
        assert!(texts(&journal).is_empty());
        journal.log(STAMP, Severity::Error, "stopped: e-stop input");
        let unix = Some(1_700_000_000);
        journal.log(Stamp { unix, ..STAMP }, Severity::Info, "armed");
        let mut journal = Journal::open(&mut memory);
        assert_eq!(texts(&journal), ["stopped: e-stop input", "armed"]);
        let first = journal.entry(1).unwrap();
        assert_eq!((first.stamp, first.severity), (STAMP, Severity::Error));
        assert_eq!(journal.entry(2).unwrap().stamp.unix, unix);
        journal.log(STAMP, Severity::Info, "again");
        assert_eq!(journal.next(), 4);
    }

    #[test]
    fn the_oldest_make_room() {
        let mut memory = vec![0; 4 * SLOT];
        let mut journal = Journal::open(&mut memory);
        for n in 0..10 {
            journal.log(STAMP, Severity::Info, &n.to_string());
        }
        assert_eq!(texts(&journal), ["6", "7", "8", "9"]);
        assert_eq!(texts(&Journal::open(&mut memory)), ["6", "7", "8", "9"]);
    }

    #[test]
    fn an_entry_that_is_torn_is_skipped() {
        for torn in 0..SLOT {
            let mut memory = vec![0; 8 * SLOT];
            let mut journal = Journal::open(&mut memory);
            for text in ["one", "two", "three"] {
                journal.log(STAMP, Severity::Info, text);
            }
            memory[3 * SLOT + torn] ^= 0x10;
            let mut journal = Journal::open(&mut memory);
            // What is behind the end of the text is summed, too.
            assert_eq!(texts(&journal), ["one", "two"], "byte {torn}");
            journal.log(STAMP, Severity::Info, "four");
            assert_eq!(texts(&journal), ["one", "two", "four"]);
        }
    }

    #[test]
    fn a_long_text_takes_several_entries_cut_between_characters() {
        let mut memory = vec![0; BYTES];
        let mut journal = Journal::open(&mut memory);
        let long = "\u{e4}".repeat(130);
        journal.log(STAMP, Severity::Error, &long);
        journal.log(STAMP, Severity::Error, "");
        let pieces = texts(&journal);
        assert_eq!((pieces.len(), pieces.concat()), (3, long));
    }

    #[test]
    fn no_memory_is_no_journal() {
        let mut memory = [0; SLOT - 1];
        let mut journal = Journal::open(&mut memory);
        journal.log(STAMP, Severity::Info, "lost");
        assert!(texts(&journal).is_empty() && journal.entry(1).is_none());
    }

    #[test]
    fn a_time_is_for_people() {
        let said = |stamp| {
            let mut text = String::new();
            when(stamp, &mut Out(&mut text));
            text
        };
        assert_eq!(said(STAMP), "start 7 +0:01:01");
        let unix = Some(1_700_000_000);
        assert_eq!(said(Stamp { unix, ..STAMP }), "2023-11-14T22:13:20Z");
    }

    proptest! {
        #[test]
        fn garbage_is_an_empty_journal_that_can_be_written(
            garbage in proptest::collection::vec(any::<u8>(), 0..6 * SLOT),
            magics in proptest::collection::vec(0usize..6, 0..6),
        ) {
            let mut memory = garbage;
            // Not even with the right magic and number.
            for slot in magics {
                if let Some(head) = memory.get_mut(slot * SLOT..slot * SLOT + 8) {
                    head[..4].copy_from_slice(&MAGIC.to_le_bytes());
                    head[4..].copy_from_slice(&(slot as u32).to_le_bytes());
                }
            }
            let room = memory.len() >= SLOT;
            let mut journal = Journal::open(&mut memory);
            prop_assert!(texts(&journal).is_empty());
            journal.log(STAMP, Severity::Info, "new");
            prop_assert_eq!(texts(&journal).len(), usize::from(room));
        }
    }
}
