//! `rx_admission.sv`: compares the headers of a frame with one set of words, and discards guests
//! without a ticket.

use wire::regmap::rx_admission;

/// Words that are compared.
pub const PLACES: usize = rx_admission::MODE - rx_admission::HEADER0;
/// The number of a word from which on they are not counted.
pub const LAST: u8 = 24;
/// Upper half of a word.
const HIGH: u32 = 0xffff_0000;
/// What ARP and IPv4 differ in.
const ARP: u32 = 0x0800 ^ 0x0806;

/// A word on its way into the receive slots, as a slot reads.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Word {
    /// Its four bytes, the first on the wire in bits 31:24.
    pub data: u32,
    /// It is the frame's last.
    pub last: bool,
    /// With the last: all four bytes are the frame's.
    pub whole: bool,
    /// With the last: the FCS is wrong.
    pub bad: bool,
    /// The frame has found a slot free.
    pub room: bool,
}

impl Word {
    /// The words of a whole frame with a right FCS that finds a slot free. `bytes`: of the frame
    /// without FCS, with the two in front of it.
    pub fn of_frame(words: &[u32], bytes: usize) -> impl Iterator<Item = Word> + '_ {
        words.iter().enumerate().map(move |(n, data)| Word {
            data: *data,
            last: n + 1 == words.len(),
            whole: bytes.is_multiple_of(4),
            bad: false,
            room: true,
        })
    }
}

/// Its inputs in a clock.
#[derive(Clone, Copy, Debug, Default)]
pub struct Input {
    /// An expected word is written, at its place.
    pub header: Option<(usize, u32)>,
    /// Which words make a guest.
    pub mode: u32,
    /// Pulse: a ticket, if there is none.
    pub admit: bool,
    /// A word passes.
    pub word: Option<Word>,
}

/// How the word that passes compares.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Compared {
    /// Its number; [`LAST`] stays.
    pub at: u8,
    /// Bits 31:16 of it are as expected; false without a place.
    pub high: bool,
    /// Bits 15:0.
    pub low: bool,
}

/// The filter.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RxAdmission {
    expected: [u32; PLACES],
    at: u8,
    place: usize,
    same: bool,
    arp: bool,
    ticket: bool,
    refused: u32,
}

impl Default for RxAdmission {
    fn default() -> Self {
        RxAdmission {
            expected: [0; PLACES],
            at: 0,
            place: 0,
            same: true,
            arp: false,
            ticket: false,
            refused: 0,
        }
    }
}

impl RxAdmission {
    /// Guests discarded for want of a ticket.
    pub fn refused(&self) -> u32 {
        self.refused
    }

    /// How a word compares that passes in this clock.
    pub fn compares(&self, data: u32) -> Compared {
        let differ = data ^ self.expected[self.place];
        Compared {
            at: self.at,
            high: differ & HIGH == 0,
            low: differ & !HIGH == 0,
        }
    }

    fn guests(&self, mode: u32) -> bool {
        mode != 0 && !(self.same && self.at >= 15)
    }

    /// A frame that ends in this clock is to be discarded.
    pub fn refuses(&self, mode: u32) -> bool {
        self.guests(mode) && !self.ticket
    }

    /// One rising edge.
    pub fn clock(&mut self, i: &Input) {
        let (guests, refuses) = (self.guests(i.mode), self.refuses(i.mode));
        let ends = i
            .word
            .is_some_and(|word| word.last && !word.bad && word.room);
        if let Some(word) = i.word {
            self.pass(word, i.mode);
        }
        if let Some((place, word)) = i.header {
            self.expected[place] = word;
        }
        self.ticket = i.admit || (self.ticket && !(ends && guests));
        self.refused = self.refused.wrapping_add((ends && refuses).into());
    }

    fn pass(&mut self, word: Word, mode: u32) {
        let differ = word.data ^ self.expected[self.place];
        let is_arp = self.at == 3 && differ & ARP == ARP;
        let counts = match self.at {
            0 | 1 => mode != 0,
            2 | 3 | 7 | 9 => mode & 2 != 0 && !self.arp,
            _ => false,
        };
        let unlike = differ & !ARP != 0 || (differ & ARP != 0 && !is_arp);
        self.same = word.last || (self.same && !(counts && unlike));
        self.arp = !word.last && (self.arp || is_arp);
        // Words 5 and 12 have no place. Behind the last place the count begins again.
        let placed = self.at != 5 && self.at != 12;
        self.place = (self.place + usize::from(placed)) % PLACES;
        self.at = (self.at + 1).min(LAST);
        if word.last {
            (self.at, self.place) = (0, 0);
        }
    }
}

#[cfg(test)]
mod tests;
