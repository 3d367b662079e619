//! The configuration of the pins ([`wire::pins`]): finds it in flash at the start, has it checked,
//! and writes it to the gateware's multiplexer. [`crate::flash`] decides which copy may be written.
//!
//! ```text
//!   newest whole copy --> Head::check --> routes, rest levels --> driven lines, description
//!                             |                  |
//!                             +------------------+--> bad, missing, factory pin: nothing driven,
//!                                                     no route
//! ```
//!
//! A line's level while the gate is closed is not stored. It follows from its route and from the
//! settings in force, and changes with them ([`Pins::follow`]).

use crate::cores::{Board, Ident, Setting};
use crate::nor::Nor;
use core::ops::RangeInclusive;
use embedded_hal::spi::SpiDevice;
use wire::board::{HEADER_LEN, LIST};
use wire::crc::Crc32;
use wire::describe::{Channels, FEATURE_PINS};
use wire::flash::{Layout, is_newer};
use wire::map::{self, BoardConfig, PwmType, StepType, StepgenConfig};
use wire::pins::{
    Built, DRIVES_AT, GENERATION_AT, HEAD_WORDS, Head, INPUTS_AT, INVERT, Loaded, NONE, SOURCE,
    Verdict, route,
};
use wire::regmap::{self, BOARD_ROM_SIZE, ident, pinmux_in, pinmux_out};

/// A route takes 16 clocks, and a look at the status some more.
const LOOKS_MAX: u32 = 100;
/// Words of safe levels, and behind them as many of `keeps`.
const LEVEL_WORDS: usize = pinmux_out::DRIVES0 - pinmux_out::SAFE0;
/// Words of driven lines.
const DRIVE_WORDS: usize = INPUTS_AT - DRIVES_AT;
/// The length of a board blob and its CRC, in words from its beginning.
const BLOB_LENGTH_AT: usize = 2;
const BLOB_CRC_AT: usize = 3;
/// Entries of a board blob about channels: [`wire::board::Kind`], from `Stepgen` on.
const CHANNEL_KINDS: RangeInclusive<u8> = 3..=LIST;

/// The settings that a configuration has, in the order of [`Head::levels`].
const LEVELS: [BoardConfig; 4] = [
    BoardConfig::GpioSafe,
    BoardConfig::GpioSafeHigh,
    BoardConfig::GpioInvert,
    BoardConfig::GpioInvertHigh,
];

/// What the multiplexer was written with.
#[derive(Clone, Copy, Debug)]
pub struct Pins {
    built: Built,
    head: Head,
    /// Safe levels, then `keeps`.
    levels: [u32; LEVEL_WORDS],
}

impl Pins {
    /// Before the start.
    pub const fn new() -> Self {
        Pins {
            built: Built::from_word(0),
            head: Head([0; HEAD_WORDS]),
            levels: [0; LEVEL_WORDS],
        }
    }

    /// Finds the configuration in force and puts it into force: its channels are those of `ident`
    /// from now on, its description that of the board. True beside it if the factory pin is active.
    /// The gate is closed.
    #[inline(never)]
    pub fn start<B: Board>(
        &mut self,
        board: &mut B,
        ident: &mut Ident,
        layout: Option<Layout>,
    ) -> (Loaded, bool) {
        let mut factory = board.factory_pin();
        let mut verdict = Verdict::Fixed;
        let mut copy = None;
        if ident.features & FEATURE_PINS == 0 {
            return (Loaded { verdict, copy }, factory);
        }
        self.built = Built::from_word(ident.channels.to_words()[0]);
        self.built.lines = board.csr_read(regmap::address(ident::BASE, ident::PINS)) as u8;
        let platform = board.csr_read(regmap::address(ident::BASE, ident::PLATFORM));
        ident.channels = Channels::default();

        verdict = Verdict::Missing;
        let mut start = 0;
        if let Some(layout) = layout {
            copy = newest(&mut Nor(board.spi()), &layout, &mut self.head);
            start = layout.pins_copy(copy.unwrap_or(0)).start;
        }
        if copy.is_some() {
            verdict = match factory {
                true => Verdict::FactoryPin,
                false => self.head.check(self.built, platform),
            };
        }
        if verdict == Verdict::InForce {
            self.forget_modes(board, start);
            for (which, level) in LEVELS.into_iter().zip(self.head.levels()) {
                board.set(Setting::Board(which), *level);
            }
            if !self.rest(board) {
                verdict = Verdict::Refused;
            } else if board.factory_pin() {
                // Its line is known only now.
                (verdict, factory) = (Verdict::FactoryPin, true);
            } else if !self.drive(board, start) {
                verdict = Verdict::Refused;
            } else {
                let [channels0, channels1] = self.head.channels();
                ident.channels = Channels::from_words(channels0, channels1).unwrap_or_default();
            }
        }
        if verdict != Verdict::InForce {
            self.head.0.fill(u32::from_ne_bytes([NONE; 4]));
            if !(put(board, pinmux_out::DRIVES0, &[0; DRIVE_WORDS]) && self.rest(board)) {
                verdict = Verdict::Refused;
            }
            forget_channels(board);
        }
        let words = board.blob(BLOB_LENGTH_AT) / 4;
        ident.blob_words = words.min(BOARD_ROM_SIZE as u32 / 4);
        (Loaded { verdict, copy }, factory)
    }

    /// A restart keeps the settings of the cores, and a PWM that another file's host had inverted
    /// would rest high: with another description than the start before left, all modes are those of
    /// power-up. With the same one they stay, so no line changes.
    #[cold] // Otherwise the exchange's code lies worse in the cache: 5049 clocks, not 4827.
    #[inline(never)]
    fn forget_modes<B: Board>(&self, board: &mut B, copy: u32) {
        let mut crc = [0];
        let at = copy + 4 * (HEAD_WORDS + BLOB_CRC_AT) as u32;
        let read = Nor(board.spi()).words(at, &mut crc);
        if read.is_ok() && crc == [board.blob(BLOB_CRC_AT)] {
            return;
        }
        for stepgen in 0..self.built.stepgens {
            board.set(Setting::Stepgen(stepgen, StepgenConfig::Mode), 0);
        }
        for pwm in 0..self.built.pwms {
            board.set(Setting::PwmMode(pwm), 0);
        }
    }

    /// All routes, and the levels that follow from them. A line that an earlier start has driven
    /// goes on and rests: a restart lets go of no line, because its pull-up would make a pulse of
    /// that. False if the gateware refused a word.
    #[inline(never)]
    fn rest<B: Board>(&mut self, board: &mut B) -> bool {
        let Built { lines, .. } = self.built;
        let (inputs, outputs) = (self.head.inputs(), self.head.outputs());
        let inputs = inputs.get(..usize::from(self.built.sinks() / 4));
        let outputs = outputs.get(..usize::from(lines / 4));
        self.levels = levels(board, self.built, self.head.outputs());
        put(board, INPUTS, inputs.unwrap_or(&[]))
            && put(board, pinmux_out::ROUTE0, outputs.unwrap_or(&[]))
            && put(board, pinmux_out::SAFE0, &self.levels)
    }

    /// The driven lines, then the description. False if the gateware or the flash refused a word.
    fn drive<B: Board>(&self, board: &mut B, copy: u32) -> bool {
        if !put(board, pinmux_out::DRIVES0, self.head.drives()) {
            return false;
        }
        let description = copy + 4 * HEAD_WORDS as u32;
        for word in 0..self.head.description().div_ceil(4) {
            let mut value = [0];
            if Nor(board.spi())
                .words(description + 4 * word, &mut value)
                .is_err()
            {
                return false;
            }
            let [value] = value;
            board.describe(word as usize, value);
        }
        true
    }

    /// A setting may have changed: writes the levels at rest if they have changed with it. The gate
    /// is closed. False if the gateware refused a word.
    #[inline(never)]
    pub fn follow<B: Board>(&mut self, board: &mut B) -> bool {
        let levels = levels(board, self.built, self.head.outputs());
        let same = levels == self.levels;
        self.levels = levels;
        same || put(board, pinmux_out::SAFE0, &levels)
    }
}

impl Default for Pins {
    fn default() -> Self {
        Self::new()
    }
}

/// Does this setting decide about the level of a pin at rest?
pub const fn decides(setting: Setting) -> bool {
    match setting {
        Setting::Stepgen(_, StepgenConfig::Mode) | Setting::PwmMode(_) => true,
        Setting::Board(board) => !matches!(
            board,
            BoardConfig::WatchdogTimeout | BoardConfig::WatchdogGrace | BoardConfig::Probe
        ),
        Setting::Stepgen(..)
        | Setting::PwmPeriod(_)
        | Setting::EncoderMode(_)
        | Setting::EncoderFilter(_)
        | Setting::Debounce(_) => false,
    }
}

/// The number of the newest whole copy; its head is in `head`.
fn newest<S: SpiDevice>(nor: &mut Nor<S>, layout: &Layout, head: &mut Head) -> Option<u32> {
    let mut newest = None;
    for copy in 0..2 {
        if whole(nor, layout, copy, head) {
            let generation = head.generation();
            newest = match newest {
                Some((_, other)) if !is_newer(generation, other) => newest,
                Some(_) | None => Some((copy, generation)),
            };
        }
    }
    // The other one was read meanwhile.
    newest
        .map(|(copy, _)| copy)
        .filter(|copy| whole(nor, layout, *copy, head))
}

/// Reads the head of a copy. Is the copy whole?
#[inline(never)]
fn whole<S: SpiDevice>(nor: &mut Nor<S>, layout: &Layout, copy: u32, head: &mut Head) -> bool {
    const SUMMED_AT: u32 = 4 * GENERATION_AT as u32;
    let start = layout.pins_copy(copy).start;
    let read = nor.words(start, &mut head.0);
    let Some(bytes) = head.bytes().filter(|_| read.is_ok()) else {
        return false;
    };
    let mut crc = Crc32::new();
    let summed = nor.each(start + SUMMED_AT, bytes - SUMMED_AT, &mut |bytes| {
        crc.update(bytes);
    });
    summed.is_ok() && crc.value() == head.crc()
}

/// Takes the channels out of the description: none is there. The image's own names none, but an
/// earlier start may have left that of a configuration.
fn forget_channels<B: Board>(board: &mut B) {
    let end = (board.blob(BLOB_LENGTH_AT) as usize / 4).min(BOARD_ROM_SIZE / 4);
    let (mut from, mut to) = (HEADER_LEN / 4, HEADER_LEN / 4);
    let mut crc = Crc32::new();
    while from < end {
        // Kind, channel, bytes that follow.
        let [kind, _, length, _] = board.blob(from).to_be_bytes();
        let next = from + 1 + usize::from(length).div_ceil(4);
        if next > end {
            break;
        }
        while from < next {
            if !CHANNEL_KINDS.contains(&kind) {
                let word = board.blob(from);
                board.describe(to, word);
                crc.update(&word.to_be_bytes());
                to += 1;
            }
            from += 1;
        }
    }
    board.describe(BLOB_LENGTH_AT, 4 * to as u32);
    board.describe(BLOB_CRC_AT, crc.value());
}

/// The numbers of the words of the outputs begin at 0, those of the inputs here.
const INPUTS: usize = 0x100;

/// Writes words of the multiplexer, the first one with number `at`, and waits for each until it is
/// complete. False if one had no effect: the next ones are not written.
#[inline(never)]
fn put<B: Board>(board: &mut B, at: usize, words: &[u32]) -> bool {
    let (base, at, status) = match at.checked_sub(INPUTS) {
        Some(at) => (pinmux_in::BASE, at, pinmux_in::STATUS),
        None => (pinmux_out::BASE, at, pinmux_out::STATUS),
    };
    let status = regmap::address(base, status);
    let mut address = regmap::address(base, at);
    for word in words {
        board.csr_write(address, *word);
        let mut looks = LOOKS_MAX;
        let mut state = 0;
        while state & pinmux_out::STATUS_IDLE == 0 && looks != 0 {
            state = board.csr_read(status);
            looks -= 1;
        }
        if state & (pinmux_out::STATUS_IDLE | pinmux_out::STATUS_REFUSED) != pinmux_out::STATUS_IDLE
        {
            return false;
        }
        address += 4;
    }
    true
}

const _: () = assert!(pinmux_in::STATUS_IDLE == pinmux_out::STATUS_IDLE);
const _: () = assert!(pinmux_in::STATUS_REFUSED == pinmux_out::STATUS_REFUSED);

/// Safe levels of all lines, then `keeps`, with the settings in force.
#[inline(never)]
fn levels<B: Board>(board: &mut B, built: Built, outputs: &[u32]) -> [u32; LEVEL_WORDS] {
    let mut levels = [0; LEVEL_WORDS];
    let (safe, keeps) = levels.split_at_mut(LEVEL_WORDS / 2);
    for line in 0..built.lines {
        let route = route(outputs, line);
        let (level, keep) = at_rest(board, built, line, route & SOURCE);
        let level = level ^ u32::from(route & INVERT != 0);
        let word = usize::from(line / 32);
        if let (Some(safe), Some(keeps)) = (safe.get_mut(word), keeps.get_mut(word)) {
            *safe |= level << (line % 32);
            *keeps |= u32::from(keep) << (line % 32);
        }
    }
    levels
}

/// The level of a source while the gate is closed, 0 or 1, and whether its line rather keeps the
/// level it had when the gate closed: an edge of DIR or of a quadrature line would disturb the last
/// pulse, or be one.
fn at_rest<B: Board>(board: &mut B, built: Built, line: u8, source: u8) -> (u32, bool) {
    let second = u32::from(source & 1);
    if source < built.pwm(0) {
        let mode = board.setting(Setting::Stepgen(source / 2, StepgenConfig::Mode));
        let kind = mode >> map::STEPGEN_TYPE_SHIFT & 3;
        let keeps =
            kind == StepType::Quadrature as u32 || second != 0 && kind != StepType::UpDown as u32;
        // The two bits of polarity are in the order of the two sources.
        return (mode >> second & 1, keeps);
    }
    let level = if source < built.enabled() {
        let mode = board.setting(Setting::PwmMode((source - built.pwm(0)) / 2));
        let pulses = mode >> map::PWM_TYPE_SHIFT & 3 == PwmType::UpDown as u32
            || u32::from(mode & map::PWM_SWAP != 0) == second;
        mode & u32::from(pulses)
    } else if source == built.own(line) {
        let (safe, invert) = match line < 32 {
            true => (BoardConfig::GpioSafe, BoardConfig::GpioInvert),
            false => (BoardConfig::GpioSafeHigh, BoardConfig::GpioInvertHigh),
        };
        let level = board.setting(Setting::Board(safe)) ^ board.setting(Setting::Board(invert));
        level >> (line % 32)
    } else {
        0
    };
    (level & 1, false)
}

const _: () = assert!(map::STEPGEN_STEP_INVERT == 1 && map::STEPGEN_DIR_INVERT == 2);
const _: () = assert!(map::PWM_INVERT == 1);

#[cfg(test)]
mod tests;
