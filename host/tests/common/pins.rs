//! The fake board's multiplexer: what its firmware makes of the configuration in its flash.

use super::{FakeBoard, Mind, Time};
use wire::board::crc32;
use wire::describe::Channels;
use wire::flash::is_newer;
use wire::pins::{Built, HEAD_WORDS, Head, Loaded, Verdict};
use wire::regmap::{address, ident};

/// The image of the 5A-75B 8.0.
pub const EIGHT: Built = Built {
    stepgens: 8,
    encoders: 8,
    pwms: 8,
    lines: 56,
};

impl FakeBoard {
    /// A 5A-75B 8.0 whose pins are configured and that has no file yet, at the address that the
    /// board files have.
    pub fn card() -> Self {
        let board = FakeBoard::mill6(Time::Lockstep(60_000));
        board.look().flash.looks = 0;
        board.look().become_image(EIGHT, "5a-75b-8.0");
        board
    }
}

/// What an image with configurable pins was built with.
#[derive(Clone, Copy, Debug)]
pub struct FakePins {
    pub built: Built,
    pub platform: u32,
    /// The factory pin is held at the next start.
    pub factory: bool,
    /// The gateware takes no route.
    pub refuses: bool,
}

impl Mind {
    /// The board gets an image whose pins are configured, and starts.
    pub fn become_image(&mut self, built: Built, platform: &str) {
        self.pins = Some(FakePins {
            built,
            platform: wire::pins::platform_number(platform),
            factory: false,
            refuses: false,
        });
        // Facts of the board; its channels have names when they are configured.
        self.names
            .retain(|(kind, ..)| matches!(kind, 1 | 2 | 13 | 14));
        self.load_pins();
    }

    /// As the firmware says it.
    pub(super) fn obstacle_of_pins(&self) -> u32 {
        match self.flash.pins {
            Some(loaded) if !loaded.verdict.usable() => wire::describe::OBSTACLE_PINS,
            _ => 0,
        }
    }

    /// As the firmware does it at the start.
    pub(super) fn load_pins(&mut self) {
        let Some(pins) = self.pins else { return };
        let copies = [0, 1].map(|copy| self.copy(copy));
        let newest = { copies.iter().zip(0..) }
            .filter_map(|(found, n)| Some((found.as_ref()?.0, n)))
            .reduce(|a, b| match is_newer(b.0.generation(), a.0.generation()) {
                true => b,
                false => a,
            });
        let verdict = match &newest {
            _ if pins.factory => Verdict::FactoryPin,
            None => Verdict::Missing,
            Some(_) if pins.refuses => Verdict::Refused,
            Some((head, _)) => head.check(pins.built, pins.platform),
        };
        self.channels = Channels::default();
        self.described = None;
        if let (Verdict::InForce, Some((head, n))) = (verdict, newest) {
            let [motion, general] = head.channels();
            self.channels = Channels::from_words(motion, general).unwrap();
            self.described = copies[n as usize].as_ref().map(|(_, blob)| blob.clone());
        }
        self.flash.pins = Some(Loaded {
            verdict,
            copy: newest.map(|(_, n)| n),
        });
    }

    /// A whole copy: the words in front, and its description.
    fn copy(&self, n: u32) -> Option<(Head, Vec<u8>)> {
        let start = self.flash.layout().pins_copy(n).start as usize;
        let bytes = &self.flash.bytes[start..];
        let mut words = [0; HEAD_WORDS];
        wire::words_from_bytes(&bytes[..HEAD_WORDS * 4], &mut words).unwrap();
        let head = Head(words);
        let body = &bytes[..head.bytes()? as usize];
        let description = body
            .get(HEAD_WORDS * 4..)?
            .get(..head.description() as usize)?;
        (crc32(&body[16..]) == head.crc()).then(|| (head, description.to_vec()))
    }

    /// Registers of the page `ident`.
    pub(super) fn ident(&self, at: u32) -> u32 {
        let Some(pins) = self.pins else { return 0 };
        let is = |word| at == address(ident::BASE, word);
        match pins.built.to_word() {
            word if is(ident::CHANNELS0) => word & 0x00ff_ffff,
            _ if is(ident::PINS) => pins.built.lines.into(),
            _ if is(ident::PLATFORM) => pins.platform,
            _ => 0,
        }
    }

    /// What became of its configuration.
    pub(super) fn loaded(&self) -> u32 {
        let fixed = Loaded {
            verdict: Verdict::Fixed,
            copy: None,
        };
        self.flash.pins.unwrap_or(fixed).to_word()
    }
}
