//! The configuration of a board's pins: which source each header line carries, and which line each
//! input of a core listens to. For gateware with a multiplexer
//! ([`crate::describe::FEATURE_PINS`]).
//!
//! ```text
//! word 0 "FPIN"
//!      1 version, 1
//!      2 bytes, a multiple of 4
//!      3 CRC-32 from word 4 on
//!      4 generation
//!      5 built: stepgens | encoders << 8 | pwms << 16 | lines << 24
//!      6 CRC-32 of the platform's name
//!      7 used: stepgens | encoders << 8 | pwms << 16
//!      8 used: inputs | outputs << 8
//!      9 bytes of the description
//!     10 bytes of the file's text
//!     11 zero
//!     12 routes of the outputs, 32 words
//!     44 driven lines, 4 words
//!     48 routes of the inputs, 32 words
//!     80 safe levels of the outputs, 2 words; which are inverted, 2 words
//!     84 the description, then the file's text
//! ```
//!
//! Big-endian words. A route is a byte, four in a word, the first one lowest: bits 6:0 the source,
//! [`NONE`] for none, bit 7 inverts. Inputs and outputs have the numbers of their lines. The
//! description is a [`crate::board`] blob and takes the place of the image's own.
//!
//! There are two copies in flash ([`crate::flash::Layout::pins_copy`]). The one with the higher
//! generation of the whole ones is in force from the next start on, of equal ones copy 0. A client
//! writes the other one, its first page last, so a power cut at any moment leaves the old or the
//! new one. When the new one is in force the client writes the same over the old one.

use crate::codes::codes;
use crate::crc::Crc32;

/// "FPIN".
pub const MAGIC: u32 = 0x4650_494e;
/// Version of the layout above.
pub const VERSION: u32 = 1;
/// Bytes of a copy.
pub const BYTES_MAX: u32 = 0x6000;

/// Words before the description.
pub const HEAD_WORDS: usize = 84;
/// Where the generation is, in words.
pub const GENERATION_AT: usize = 4;
/// Where the routes of the outputs are, in words.
pub const OUTPUTS_AT: usize = 12;
/// Where the driven lines are, in words.
pub const DRIVES_AT: usize = 44;
/// Where the routes of the inputs are, in words.
pub const INPUTS_AT: usize = 48;
/// Where the levels of the outputs are, in words: safe levels of outputs 0 to 31 and 32 to 63, then
/// which of them are inverted. As [`crate::map::BoardConfig`] has them.
pub const LEVELS_AT: usize = 80;
/// Words of the routes of either direction.
pub const ROUTE_WORDS: usize = 32;
/// Most header lines.
pub const LINES_MAX: u8 = 128;
/// E-stop inputs.
pub const ESTOPS: u8 = 4;

/// A route from no source: constant 0.
pub const NONE: u8 = 0x7f;
/// A route: its source is inverted.
pub const INVERT: u8 = 0x80;
/// A route: its source.
pub const SOURCE: u8 = 0x7f;

codes! {
    /// What became of the configuration of the pins, [`Loaded::verdict`].
    Verdict: u32 {
        /// It is in force.
        InForce = 0, "in force";
        /// None is stored: nothing is driven.
        Missing = 1, "none is stored";
        /// The factory pin was active at the start: nothing is driven.
        FactoryPin = 2, "not used: the factory pin was held";
        /// It is for an image of another card.
        Platform = 3, "for another card";
        /// It is for an image with other counts of channels.
        Built = 4, "for an image with other channels";
        /// A count is higher than what the image has, or a length does not fit.
        Counts = 5, "it asks for more than the image has";
        /// A line would be driven by what does not exist.
        Output = 6, "an output has no such source";
        /// An input would listen to a line that does not exist, or that is driven.
        Input = 7, "an input listens to no such line, or to a driven one";
        /// The gateware did not take a word.
        Refused = 8, "the gateware did not take it";
        /// The gateware has no multiplexer.
        Fixed = 9, "pins are part of this image";
    }
}

impl Verdict {
    /// Can the board be armed with what became of its configuration?
    pub const fn usable(self) -> bool {
        match self {
            Verdict::InForce | Verdict::Missing | Verdict::FactoryPin | Verdict::Fixed => true,
            Verdict::Platform
            | Verdict::Built
            | Verdict::Counts
            | Verdict::Output
            | Verdict::Input
            | Verdict::Refused => false,
        }
    }
}

/// [`crate::map::FLASH_PINS`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Loaded {
    /// What became of it.
    pub verdict: Verdict,
    /// Which copy is the newest whole one.
    pub copy: Option<u32>,
}

impl Loaded {
    /// As a word: the verdict, and above it (bits 9:8) the copy's number plus 1.
    pub const fn to_word(self) -> u32 {
        let copy = match self.copy {
            Some(copy) => (copy & 1) + 1,
            None => 0,
        };
        self.verdict.code() | copy << 8
    }

    /// From a word; `None` if it is invalid.
    pub const fn from_word(word: u32) -> Option<Self> {
        let Some(verdict) = Verdict::from_code(word & 0xff) else {
            return None;
        };
        let copy = match word >> 8 {
            0 => None,
            copy @ 1..=2 => Some(copy - 1),
            _ => return None,
        };
        Some(Loaded { verdict, copy })
    }
}

/// What an image was built with, and the numbers that follow from it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Built {
    /// Step generators.
    pub stepgens: u8,
    /// Encoders.
    pub encoders: u8,
    /// PWM generators.
    pub pwms: u8,
    /// Header lines, a multiple of 4.
    pub lines: u8,
}

impl Built {
    /// As word 5 of a configuration.
    pub const fn to_word(self) -> u32 {
        u32::from_le_bytes([self.stepgens, self.encoders, self.pwms, self.lines])
    }

    /// From word 5; every word is one.
    pub const fn from_word(word: u32) -> Self {
        let [stepgens, encoders, pwms, lines] = word.to_le_bytes();
        Built {
            stepgens,
            encoders,
            pwms,
            lines,
        }
    }

    // Sources of the outputs --------------------------------------------------------------------

    /// STEP of a step generator; DIR is the next source.
    pub const fn step(self, n: u8) -> u8 {
        2 * n
    }

    /// The first pin of a PWM; the second is the next source.
    pub const fn pwm(self, n: u8) -> u8 {
        2 * (self.stepgens + n)
    }

    /// High while the gate is open.
    pub const fn enabled(self) -> u8 {
        2 * (self.stepgens + self.pwms)
    }

    /// Changes every 4096 clocks while the gate is open: for a charge pump.
    pub const fn heartbeat(self) -> u8 {
        self.enabled() + 1
    }

    /// Sources every line can carry, a multiple of 4.
    pub const fn sources(self) -> u8 {
        (self.enabled() + 2).next_multiple_of(4)
    }

    /// The general output of a line, which only the line itself can carry; each four lines have
    /// theirs under these numbers.
    pub const fn own(self, line: u8) -> u8 {
        self.sources() + line % 4
    }

    // Inputs of the cores -----------------------------------------------------------------------

    /// A of an encoder; B, index and mask follow.
    pub const fn encoder(self, n: u8) -> u8 {
        4 * n
    }

    /// The index of a step generator.
    pub const fn index(self, n: u8) -> u8 {
        4 * self.encoders + n
    }

    /// The external reset: 1 stops.
    pub const fn reset(self) -> u8 {
        self.index(self.stepgens).next_multiple_of(4)
    }

    /// The line of the card's button, behind the header lines: an input only, low while pressed.
    pub const fn key(self) -> u8 {
        self.lines
    }

    /// The factory pin: 1 is active. It has no effect behind the start.
    pub const fn factory(self) -> u8 {
        self.reset() + 1
    }

    /// An e-stop input: 1 stops. Its latch is bit `n` of the status block's `estop`.
    pub const fn estop(self, n: u8) -> u8 {
        self.reset() + 4 + n
    }

    /// Inputs of the cores, a multiple of 4.
    pub const fn sinks(self) -> u8 {
        self.reset() + 4 + ESTOPS
    }
}

/// The route at `place` of words like those of a configuration.
pub fn route(words: &[u32], place: u8) -> u8 {
    let word = words.get(usize::from(place / 4)).copied().unwrap_or(!0);
    word.to_le_bytes()[usize::from(place % 4)]
}

/// The words before the description.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Head(pub [u32; HEAD_WORDS]);

impl Head {
    /// The length of the whole in bytes, if this begins a configuration of this layout. Its CRC is
    /// still to be computed, with [`Head::crc`].
    pub fn bytes(&self) -> Option<u32> {
        let [magic, version, bytes, ..] = self.0;
        let inside = (HEAD_WORDS as u32 * 4..=BYTES_MAX).contains(&bytes) && bytes % 4 == 0;
        (magic == MAGIC && version == VERSION && inside).then_some(bytes)
    }

    /// The CRC that the bytes from word 4 on must have.
    pub const fn crc(&self) -> u32 {
        self.0[3]
    }

    /// The higher of two is newer, modulo 2^32.
    pub const fn generation(&self) -> u32 {
        self.0[GENERATION_AT]
    }

    /// What it is for.
    pub const fn built(&self) -> Built {
        Built::from_word(self.0[5])
    }

    /// CRC-32 of the name of the platform it is for.
    pub const fn platform(&self) -> u32 {
        self.0[6]
    }

    /// The channels it uses, as the two words of a description.
    pub const fn channels(&self) -> [u32; 2] {
        [self.0[7], self.0[8]]
    }

    /// Bytes of the description, which follows.
    pub const fn description(&self) -> u32 {
        self.0[9]
    }

    /// Bytes of the file's text, which follows the description.
    pub const fn text(&self) -> u32 {
        self.0[10]
    }

    /// Routes of the outputs.
    pub fn outputs(&self) -> &[u32] {
        self.0.get(OUTPUTS_AT..DRIVES_AT).unwrap_or(&[])
    }

    /// Lines that are driven, one bit per line.
    pub fn drives(&self) -> &[u32] {
        self.0.get(DRIVES_AT..INPUTS_AT).unwrap_or(&[])
    }

    /// Is the line driven?
    pub fn driven(&self, line: u8) -> bool {
        let word = self.drives().get(usize::from(line / 32));
        word.is_some_and(|word| word >> (line % 32) & 1 != 0)
    }

    /// Routes of the inputs.
    pub fn inputs(&self) -> &[u32] {
        self.0.get(INPUTS_AT..LEVELS_AT).unwrap_or(&[])
    }

    /// Safe levels of the outputs, and which of them are inverted: two words each.
    pub fn levels(&self) -> &[u32] {
        self.0.get(LEVELS_AT..HEAD_WORDS).unwrap_or(&[])
    }

    /// Whether an image with these counts, of the platform whose name has this CRC-32, can be
    /// configured so: every driven line carries what exists and is used, every input listens to a
    /// line that exists and is not driven, or to the button, and lines and inputs that do not exist
    /// have no route.
    pub fn check(&self, image: Built, platform: u32) -> Verdict {
        if self.platform() != platform {
            return Verdict::Platform;
        }
        if self.built() != image {
            return Verdict::Built;
        }
        let [stepgens, encoders, pwms, more] = self.0[7].to_le_bytes();
        let [inputs, outputs, ..] = self.0[8].to_le_bytes();
        let most = image.lines.min(crate::regmap::IN_MAX as u8);
        let counts = stepgens <= image.stepgens
            && encoders <= image.encoders
            && pwms <= image.pwms
            && inputs <= most
            && outputs <= most
            && more == 0
            && self.0[8] >> 16 == 0;
        let room = self.bytes().unwrap_or(0).checked_sub(HEAD_WORDS as u32 * 4);
        let (described, text) = (self.description(), self.text());
        let used = described
            .checked_add(text)
            .and_then(|it| it.checked_next_multiple_of(4));
        if !counts || used != room || described > crate::regmap::BOARD_ROM_SIZE as u32 {
            return Verdict::Counts;
        }
        for line in 0..LINES_MAX {
            let source = route(self.outputs(), line) & SOURCE;
            let there = source < 2 * stepgens
                || (image.pwm(0)..image.pwm(pwms)).contains(&source)
                || (image.enabled()..=image.heartbeat()).contains(&source)
                || source == image.own(line) && line < outputs
                || source == NONE;
            if !(there && line < image.lines || source == NONE && !self.driven(line)) {
                return Verdict::Output;
            }
        }
        for sink in 0..LINES_MAX {
            let line = route(self.inputs(), sink) & SOURCE;
            let there = line < image.lines && !self.driven(line) || line == image.key();
            let listens = sink < image.sinks() && there;
            if line != NONE && !listens {
                return Verdict::Input;
            }
        }
        Verdict::InForce
    }
}

/// The CRC-32 of a platform's name, as `ident.platform` has it.
pub fn platform_number(name: &str) -> u32 {
    let mut crc = Crc32::new();
    crc.update(name.as_bytes());
    crc.value()
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use std::vec;
    use std::vec::Vec;

    const EIGHT: Built = Built {
        stepgens: 8,
        encoders: 8,
        pwms: 8,
        lines: 56,
    };

    #[test]
    fn every_source_and_every_input_has_a_number_of_its_own() {
        let mut sources: Vec<u8> = (0..8)
            .flat_map(|n| [EIGHT.step(n), EIGHT.step(n) + 1])
            .collect();
        sources.extend((0..8).flat_map(|n| [EIGHT.pwm(n), EIGHT.pwm(n) + 1]));
        sources.extend([EIGHT.enabled(), EIGHT.heartbeat()]);
        assert_eq!(sources, (0..34).collect::<Vec<_>>());
        assert_eq!((EIGHT.sources(), EIGHT.own(5)), (36, 37));
        let mut sinks: Vec<u8> = (0..8)
            .flat_map(|n| (0..4).map(move |k| EIGHT.encoder(n) + k))
            .collect();
        sinks.extend((0..8).map(|n| EIGHT.index(n)));
        sinks.extend([EIGHT.reset(), EIGHT.factory()]);
        assert_eq!(sinks, (0..42).collect::<Vec<_>>());
        sinks = (0..ESTOPS).map(|n| EIGHT.estop(n)).collect();
        assert_eq!((sinks, EIGHT.sinks()), (vec![44, 45, 46, 47], 48));
    }

    #[test]
    fn the_largest_image_has_room_in_the_words() {
        let most = Built {
            stepgens: 16,
            encoders: 16,
            pwms: 16,
            lines: 120,
        };
        assert!(most.own(3) < NONE && most.sinks() <= LINES_MAX && most.lines < NONE);
    }

    #[test]
    fn what_became_of_it_is_a_word_and_the_same_again() {
        for verdict in Verdict::ALL {
            for copy in [None, Some(0), Some(1)] {
                let loaded = Loaded {
                    verdict: *verdict,
                    copy,
                };
                assert_eq!(Loaded::from_word(loaded.to_word()), Some(loaded));
            }
        }
        assert_eq!(Loaded::from_word(0x300), None);
        assert_eq!(Loaded::from_word(0xff), None);
    }

    /// Nothing is routed, and nothing follows.
    fn empty() -> Head {
        let mut words = [u32::from_le_bytes([NONE; 4]); HEAD_WORDS];
        words[..OUTPUTS_AT].fill(0);
        words[DRIVES_AT..INPUTS_AT].fill(0);
        words[LEVELS_AT..].fill(0);
        words[..3].copy_from_slice(&[MAGIC, VERSION, 4 * HEAD_WORDS as u32]);
        words[5..8].copy_from_slice(&[EIGHT.to_word(), 7, 0x0002_0102]);
        words[8] = 56 | 56 << 8;
        Head(words)
    }

    fn with(change: impl FnOnce(&mut [u32; HEAD_WORDS])) -> Verdict {
        let mut head = empty();
        change(&mut head.0);
        head.check(EIGHT, 7)
    }

    /// Changes a route.
    fn to(words: &mut [u32], place: u8, route: u8) {
        let word = &mut words[usize::from(place / 4)];
        let mut bytes = word.to_le_bytes();
        bytes[usize::from(place % 4)] = route;
        *word = u32::from_le_bytes(bytes);
    }

    fn output(line: u8, route: u8) -> Verdict {
        with(|words| {
            to(&mut words[OUTPUTS_AT..], line, route);
            words[DRIVES_AT + usize::from(line / 32)] |= 1 << (line % 32);
        })
    }

    #[test]
    fn an_output_carries_what_is_there_and_used() {
        // Two step generators and two PWMs are used.
        for source in [
            0,
            3,
            EIGHT.pwm(0),
            EIGHT.pwm(1) + 1,
            32,
            33,
            EIGHT.own(55),
            NONE,
        ] {
            assert_eq!(output(55, source), Verdict::InForce, "{source}");
            assert_eq!(output(55, source | INVERT), Verdict::InForce, "{source}");
        }
        for source in [4, 15, EIGHT.pwm(2), 31, 34, 35, EIGHT.own(54), 40, 124] {
            assert_eq!(output(55, source), Verdict::Output, "{source}");
        }
        assert_eq!(output(56, NONE), Verdict::Output, "no such line");
    }

    #[test]
    fn an_input_listens_to_a_line_that_is_there_and_not_driven() {
        let input = |sink, line| with(|words| to(&mut words[INPUTS_AT..], sink, line));
        for (sink, line) in [(0, 0), (47, 55), (3, 55 | INVERT), (100, NONE)] {
            assert_eq!(input(sink, line), Verdict::InForce, "{sink} {line}");
        }
        for (sink, line) in [(0, 57), (48, 0), (48, 56), (127, 3), (5, 126)] {
            assert_eq!(input(sink, line), Verdict::Input, "{sink} {line}");
        }
        let driven = with(|words| {
            to(&mut words[INPUTS_AT..], 0, 9);
            words[DRIVES_AT] = 1 << 9;
        });
        assert_eq!(driven, Verdict::Input);
    }

    #[test]
    fn the_button_is_an_input_and_no_output() {
        let key = EIGHT.key();
        for sink in [
            EIGHT.reset(),
            EIGHT.factory(),
            EIGHT.estop(3),
            EIGHT.encoder(0),
        ] {
            let verdict = with(|words| to(&mut words[INPUTS_AT..], sink, key | INVERT));
            assert_eq!(verdict, Verdict::InForce, "{sink}");
        }
        assert_eq!(output(key, EIGHT.enabled()), Verdict::Output);
    }

    #[test]
    fn a_configuration_for_another_board_or_of_more_than_it_has_is_none() {
        assert_eq!(empty().check(EIGHT, 7), Verdict::InForce);
        assert_eq!(empty().check(EIGHT, 8), Verdict::Platform);
        let six = Built {
            stepgens: 6,
            ..EIGHT
        };
        assert_eq!(empty().check(six, 7), Verdict::Built);
        for (word, value) in [
            (7, 9),
            (7, 9 << 8),
            (7, 9 << 16),
            (7, 1 << 24),
            (8, 57),
            (8, 57 << 8),
            (8, 1 << 16),
        ] {
            assert_eq!(
                with(|words| words[word] = value),
                Verdict::Counts,
                "{word} {value:#x}"
            );
        }
        for (described, text, bytes) in [
            (4, 0, 0),
            (0, 5, 4),
            (u32::MAX, 1, 0),
            (0, u32::MAX, 0),
            (0x1004, 0, 0x1004),
        ] {
            let verdict = with(|words| {
                words[2] += bytes;
                (words[9], words[10]) = (described, text);
            });
            assert_eq!(verdict, Verdict::Counts, "{described} {text} {bytes}");
        }
        let whole = with(|words| {
            words[2] += 16;
            (words[9], words[10]) = (8, 5);
        });
        assert_eq!(whole, Verdict::InForce);
    }

    #[test]
    fn a_length_that_cannot_be_is_no_configuration() {
        for bytes in [
            0,
            4 * HEAD_WORDS as u32 - 4,
            4 * HEAD_WORDS as u32 + 2,
            BYTES_MAX + 4,
            u32::MAX,
        ] {
            let mut head = empty();
            head.0[2] = bytes;
            assert_eq!(head.bytes(), None, "{bytes}");
        }
        assert_eq!(empty().bytes(), Some(336));
    }
}
