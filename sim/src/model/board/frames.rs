//! Frames on their way into a slot, as `banks.py` connects them with the filter, the fast path and
//! the registers.
//!
//! Clock by clock a word comes with the bus ([`Bus::word`]). The twin has no wire: there all words
//! of a frame come in one moment ([`Board::hear`]), and what follows takes its clocks.

use super::edge::{Executes, Pulses};
use super::registers::{WORD_BITS, place};
use super::{Board, Bus, pages};
use crate::model::fast_path::{Input, Output};
use crate::model::rx_admission::{self, Word};
use wire::regmap;

/// First of the pages that the fast path can name.
const FIRST_PAGE: u32 = pages::IDENT;
/// Words of the answer's slot that the fast path can write.
pub(super) const SLOT: usize = 128;
/// Clocks from the execution of a command to the first byte of its answer's preamble at the PHY.
const TO_WIRE: u64 = 9;
/// Bytes of an answer on the wire that are not in its slot, less the two that only are there.
const AROUND: u64 = 8 + 4 - 2;

/// The way from the answer's slot to the wire.
#[derive(Clone, Copy, Debug)]
pub(super) enum Transmitter {
    /// Something is being sent until this clock.
    Until(u64),
    /// As the test that clocks the board says: the slot can be sent, it is being sent.
    Told { free: bool, sending: bool },
}

/// The word address of a register that the fast path calls by this number.
fn address(number: u32) -> u32 {
    let (page, word) = (FIRST_PAGE + (number >> 7), number & 0x7f);
    page << WORD_BITS | word
}

impl Board {
    /// From now on the MAC is somewhere else: the answer's slot is free, or is being sent.
    pub fn line(&mut self, free: bool, sending: bool) {
        self.line = Transmitter::Told { free, sending };
    }

    /// All words of a frame, now; the last one is a clock in front of the next edge. True if the
    /// frame is executed in the edges to come.
    ///
    /// Nothing of an earlier frame is under way: [`Board::hears`].
    pub fn hear(&mut self, frame: impl IntoIterator<Item = Word>) -> bool {
        self.hub.catch_up(self.clock, &self.regs);
        for word in frame {
            let bus = Bus {
                word: Some(word),
                ..Bus::default()
            };
            let staged = self.frames_clock(&bus, &mut Pulses::default());
            if let Some((address, data)) = staged {
                let (page, word) = place(address);
                self.set(page, word as u32, data);
            }
        }
        if !self.hears() {
            self.full = self.clock + 1;
        }
        self.fast_path
            .does(&self.fast_input(&Bus::default(), &Pulses::default()))
            .take
    }

    /// The fast path is done with the last frame and its answer.
    pub fn hears(&self) -> bool {
        self.fast_path.quiet()
    }

    /// The clock by which the answer's slot has been sent, if the MAC is here.
    pub fn sent_at(&self) -> u64 {
        match self.line {
            Transmitter::Until(end) => end,
            Transmitter::Told { .. } => 0,
        }
    }

    /// The answer's slot, as words.
    pub fn answer(&mut self) -> &mut [u32] {
        &mut self.answer
    }

    /// The word that the fast path read in the clock before.
    pub fn gathered(&self) -> u32 {
        self.gathered
    }

    /// Length of the answer in its slot, bytes.
    pub fn answer_length(&self) -> usize {
        self.regs.length as usize
    }

    /// What filter and fast path do in a clock.
    pub fn frames(&self, bus: &Bus) -> (Output, bool) {
        let input = self.fast_input(bus, &self.pulses());
        (
            self.fast_path.does(&input),
            self.admission.refuses(self.regs.mode),
        )
    }

    pub(super) fn pass_status(&self) -> u32 {
        use regmap::fast_path::{STATUS_EXECUTED, STATUS_OUT, STATUS_SENDING};
        [
            (self.fast_path.executed(), STATUS_EXECUTED),
            (self.fast_path.out(), STATUS_OUT),
            (self.sending(), STATUS_SENDING),
        ]
        .into_iter()
        .fold(0, |word, (on, bit)| if on { word | bit } else { word })
    }

    fn sending(&self) -> bool {
        match self.line {
            Transmitter::Until(end) => self.clock < end,
            Transmitter::Told { sending, .. } => sending,
        }
    }

    fn fast_input(&self, bus: &Bus, pulses: &Pulses) -> Input {
        let (regs, hub) = (&self.regs, &self.hub);
        let data = bus.word.map_or(0, |word| word.data);
        Input {
            rst: bus.rst,
            run: pulses.run,
            ip_sum: regs.ip_sum,
            udp_sum: regs.udp_sum,
            condition: regs.condition,
            pass: pulses.pass,
            revoke: pulses.revoke,
            word: bus.word,
            compared: self.admission.compares(data),
            gate_now: hub.watchdog.status(hub.extreset.active(), hub.gpio.estop()),
            waiting: hub.timebase.pending(),
            select: regs.probe_arms >> 16,
            free: match self.line {
                Transmitter::Until(end) => self.clock >= end,
                Transmitter::Told { free, .. } => free,
            },
        }
    }

    /// One edge of filter, fast path and the answer's slot. Returns the word that is staged, as a
    /// bus cycle.
    pub(super) fn frames_clock(&mut self, bus: &Bus, pulses: &mut Pulses) -> Option<(u32, u32)> {
        let input = self.fast_input(bus, pulses);
        let does = self.fast_path.does(&input);
        if let Some(at) = does.puts {
            self.answer[at] = self.gathered;
        }
        if let Some(from) = does.gathers {
            let (page, word) = place(address(from));
            self.gathered = self.peek(page, word as u32);
        }
        if let (true, Transmitter::Until(_)) = (does.taken, self.line) {
            let bits = (u64::from(self.regs.length) + AROUND) * 8;
            let wire = (bits * u64::from(self.build.clock_hz)).div_ceil(1_000_000_000);
            self.line = Transmitter::Until(self.clock + 1 + TO_WIRE + wire);
        }
        self.admission.clock(&rx_admission::Input {
            header: pulses.header,
            mode: self.regs.mode,
            admit: pulses.admit,
            word: bus.word,
        });
        self.fast_path.clock(&input);
        pulses.executes = Executes {
            taken: does.taken,
            commit: does.commit,
            commit_timed: does.commit_timed,
        };
        let data = bus.word.map_or(0, |word| word.data);
        does.stages.map(|to| (address(to), data))
    }
}
