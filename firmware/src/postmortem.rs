//! Keeps the number of starts and the reason of the last crash through a restart.
//!
//! The record is in RAM that start-up does not clear. A checksum tells a record from the content
//! after power-up.

use crate::text::{Out, Sink};
use wire::ResetReason;
use wire::map::{PANIC, PANIC_TEXT, PANIC_TEXT_LEN};

const TEXT_LEN: usize = PANIC_TEXT_LEN as usize;

/// The record. It consists of plain words, so that every bit pattern is a record, though hardly
/// ever a valid one.
#[derive(Clone, Debug)]
#[repr(C)]
pub struct Record {
    check: u32,
    boots: u32,
    deaths: u32,
    /// The reason of the next start, as a [`ResetReason`].
    parting: u32,
    length: u32,
    text: [u8; TEXT_LEN],
}

/// What the boot found out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Boot {
    /// Changes with every start.
    pub id: u32,
    /// The reason of this start.
    pub reset: ResetReason,
}

impl Record {
    /// After power-up.
    pub const EMPTY: Record = Record {
        check: 0,
        boots: 0,
        deaths: 0,
        parting: 0,
        length: 0,
        text: [0; TEXT_LEN],
    };

    /// Counts a start. An invalid record starts over; its first boot id comes from `seed`, so that
    /// a board which lost power has another id than before.
    pub fn boot(&mut self, seed: u32) -> Boot {
        if self.check != self.sum() {
            *self = Record::EMPTY; // its reason is power-up
            self.boots = seed << 16;
        }
        self.boots = self.boots.wrapping_add(1);
        let boot = Boot {
            id: self.boots,
            reset: ResetReason::from_code(self.parting as u8).unwrap_or(ResetReason::Unknown),
        };
        // The reason of a restart that leaves no other.
        self.part(ResetReason::Unknown);
        boot
    }

    /// Takes another first boot id. The state after power-up is the same every time, but the clock
    /// of the first write is not. Returns this start's id.
    pub fn rename(&mut self, seed: u32) -> u32 {
        self.boots = seed << 16 | self.boots & 0xffff;
        self.check = self.sum();
        self.boots
    }

    /// Records the reason of the next start.
    pub fn part(&mut self, why: ResetReason) {
        self.parting = why as u32;
        self.check = self.sum();
    }

    /// Writes the crash report. What does not fit is cut off.
    pub fn die(&mut self, why: ResetReason, cause: impl FnOnce(&mut Out)) {
        if self.check != self.sum() {
            *self = Record::EMPTY;
        }
        self.deaths = self.deaths.wrapping_add(1);
        self.length = 0;
        self.text = [0; TEXT_LEN];
        cause(&mut Out(self));
        self.part(why);
    }

    /// Number of crashes since power-up.
    pub fn deaths(&self) -> u32 {
        self.deaths
    }

    /// The last crash report, empty if there is none.
    pub fn text(&self) -> &[u8] {
        self.text.get(..self.length as usize).unwrap_or(&[])
    }

    /// A word of the panic window, by byte offset; 0 after the end.
    pub fn word(&self, offset: u32) -> u32 {
        match offset {
            0 => self.deaths,
            4 => self.length,
            _ => offset
                .checked_sub(PANIC_TEXT - PANIC)
                .and_then(|at| self.text.as_chunks::<4>().0.get(at as usize / 4))
                .map_or(0, |chunk| u32::from_be_bytes(*chunk)),
        }
    }

    /// FNV-1a over all words but the sum itself, never 0: cleared memory is not a record.
    fn sum(&self) -> u32 {
        let words = [self.boots, self.deaths, self.parting, self.length];
        let bytes = words.iter().flat_map(|word| word.to_le_bytes());
        let hash = bytes
            .chain(self.text.iter().copied())
            .fold(0x811c_9dc5u32, |hash, byte| {
                (hash ^ u32::from(byte)).wrapping_mul(0x0100_0193)
            });
        hash.max(1)
    }
}

impl Sink for Record {
    fn put(&mut self, text: &[u8]) {
        for byte in text {
            let Some(place) = self.text.get_mut(self.length as usize) else {
                break;
            };
            *place = *byte;
            self.length += 1;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_boot_is_a_power_up_and_every_boot_has_another_id() {
        let mut record = Record::EMPTY;
        let first = record.boot(3);
        assert_eq!(
            first,
            Boot {
                id: 0x3_0001,
                reset: ResetReason::PowerUp
            }
        );
        assert_eq!(record.boot(99).id, 0x3_0002);
    }

    #[test]
    fn another_first_boot_id_is_kept_over_a_restart() {
        let mut record = Record::EMPTY;
        let _ = record.boot(3);
        assert_eq!(record.rename(0xabcd_1234), 0x1234_0001);
        assert_eq!(record.boot(3).id, 0x1234_0002);
    }

    #[test]
    fn a_restart_on_request_says_so_and_one_without_a_word_is_unknown() {
        let mut record = Record::EMPTY;
        let _ = record.boot(0);
        record.part(ResetReason::Requested);
        assert_eq!(record.boot(0).reset, ResetReason::Requested);
        assert_eq!(record.boot(0).reset, ResetReason::Unknown);
    }

    #[test]
    fn a_death_is_told_once_as_a_crash_and_stays_readable() {
        let mut record = Record::EMPTY;
        let _ = record.boot(0);
        record.die(ResetReason::Panic, |out| {
            out.text("panicked at ").text("x.rs:").number(1);
        });
        assert_eq!(record.boot(0).reset, ResetReason::Panic);
        assert_eq!(record.boot(0).reset, ResetReason::Unknown);
        assert_eq!(
            (record.deaths(), record.text()),
            (1, &b"panicked at x.rs:1"[..])
        );
        assert_eq!((record.word(0), record.word(4)), (1, 18));
        assert_eq!(record.word(0x10).to_be_bytes(), *b"pani");
        assert_eq!((record.word(8), record.word(0x110)), (0, 0));
    }

    #[test]
    fn garbage_is_no_record() {
        let mut record = Record {
            check: 5,
            boots: 7,
            deaths: 9,
            parting: 2,
            length: 4_000_000,
            text: [255; TEXT_LEN],
        };
        assert_eq!(
            record.boot(0),
            Boot {
                id: 1,
                reset: ResetReason::PowerUp
            }
        );
        assert_eq!((record.deaths(), record.text()), (0, &b""[..]));
    }

    #[test]
    fn cleared_memory_is_no_record_either() {
        assert_ne!(Record::EMPTY.check, Record::EMPTY.sum());
    }

    #[test]
    fn a_long_text_is_cut_off() {
        let mut record = Record::EMPTY;
        let _ = record.boot(0);
        record.die(ResetReason::Trap, |out| {
            out.text(&"x".repeat(300));
        });
        assert_eq!(record.text().len(), TEXT_LEN);
        assert_eq!(record.boot(0).reset, ResetReason::Trap);
    }
}
