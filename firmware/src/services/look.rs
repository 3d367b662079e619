//! What the status page asks the board: a few words of the windows at a time, as any host may.
//!
//! A call asks for sixteen words at most, as a guest of an armed machine may.

use heapless::String;
use jobs::{Outside, inside};
use wire::board::{Blob, HEADER_LEN, Kind, Pieces};
use wire::describe::{self, Channels, WORDS};
use wire::etherbone::{OVERHEAD, Request};
use wire::regmap::{ENCODER_MAX, IN_MAX, OUT_MAX, STEPGEN_MAX};
use wire::{GUEST_READS, map};

/// Reads words at these addresses. `None`: the board refused, or `N` is more than a guest may ask.
pub fn ask<const N: usize>(addresses: [u32; N], out: &mut impl Outside) -> Option<[u32; N]> {
    let (mut request, mut reply) = ([0; OVERHEAD + GUEST_READS], [0; OVERHEAD + GUEST_READS]);
    inside::ask(
        Request::new(&mut request).read(0, &addresses),
        &mut reply,
        out,
    )
}

/// Words of the board information that are kept: the whole ROM.
const BLOB_WORDS: usize = wire::regmap::BOARD_ROM_SIZE / 4;
/// Bytes of a channel's name; a longer one is cut.
const NAME: usize = 40;

/// A channel's own name, or none.
pub type ChannelName = String<NAME>;

/// What does not change while the firmware runs, read once in small pieces.
#[derive(Debug)]
pub struct Facts {
    /// What the board says of itself, except for its state.
    pub words: [u32; WORDS],
    /// The counts of channels.
    pub channels: Channels,
    /// The clock.
    pub clock_hz: u32,
    /// The flash's unique id.
    pub uid: [u32; 2],
    /// The PCB.
    pub board: ChannelName,
    /// The configuration.
    pub configuration: ChannelName,
    stepgens: [ChannelName; STEPGEN_MAX],
    encoders: [ChannelName; ENCODER_MAX],
    inputs: [ChannelName; IN_MAX],
    outputs: [ChannelName; OUT_MAX],
    blob: [u8; 4 * BLOB_WORDS],
    stage: Stage,
}

/// How far the reading is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Stage {
    /// Words of the description that are there.
    Describe(usize),
    Uid,
    /// Words of the board information that are there.
    Blob(usize),
    /// All is there, and not checked yet.
    Check,
    /// The names are being found in it.
    Names(Pieces),
    Done,
}

impl Default for Facts {
    fn default() -> Self {
        Self::new()
    }
}

impl Facts {
    /// Nothing is known.
    pub const fn new() -> Self {
        Facts {
            words: [0; WORDS],
            channels: Channels {
                stepgens: 0,
                encoders: 0,
                pwms: 0,
                inputs: 0,
                outputs: 0,
            },
            clock_hz: 0,
            uid: [0; 2],
            board: String::new(),
            configuration: String::new(),
            stepgens: [const { String::new() }; STEPGEN_MAX],
            encoders: [const { String::new() }; ENCODER_MAX],
            inputs: [const { String::new() }; IN_MAX],
            outputs: [const { String::new() }; OUT_MAX],
            blob: [0; 4 * BLOB_WORDS],
            stage: Stage::Describe(0),
        }
    }

    /// Are channels and clock known? Names may be missing.
    pub fn known(&self) -> bool {
        self.clock_hz != 0
    }

    /// Is everything known?
    pub fn done(&self) -> bool {
        self.stage == Stage::Done
    }

    /// The name of a stepgen; empty: none of its own.
    pub fn stepgen(&self, n: usize) -> &str {
        self.stepgens.get(n).map_or("", String::as_str)
    }

    /// The name of an encoder.
    pub fn encoder(&self, n: usize) -> &str {
        self.encoders.get(n).map_or("", String::as_str)
    }

    /// The name of an input.
    pub fn input(&self, n: usize) -> &str {
        self.inputs.get(n).map_or("", String::as_str)
    }

    /// The name of an output.
    pub fn output(&self, n: usize) -> &str {
        self.outputs.get(n).map_or("", String::as_str)
    }

    /// Reads on: at most sixteen words. The names are found when the machine stands (`rests`), a
    /// list at a time: all of them at once took 185 000 clocks on a board with nine axes, and the
    /// ROM ends a call of 100 000 if the machine has an owner.
    pub fn read(&mut self, rests: bool, out: &mut impl Outside) {
        match self.stage {
            Stage::Describe(have) => {
                let at = core::array::from_fn::<_, { WORDS / 2 }, _>(|n| have + n);
                let Some(words) = ask(at.map(describe::address), out) else {
                    return;
                };
                for (at, word) in at.into_iter().zip(words) {
                    if let Some(place) = self.words.get_mut(at) {
                        *place = word;
                    }
                }
                self.stage = Stage::Describe(have + at.len());
                if have + at.len() >= WORDS {
                    self.described();
                }
            }
            Stage::Uid => {
                if let Some(uid) = ask([map::FLASH_UID_HI, map::FLASH_UID_LO], out) {
                    self.uid = uid;
                    self.stage = Stage::Blob(0);
                }
            }
            Stage::Blob(have) => self.blob(have, out),
            Stage::Check if rests => {
                let blob = Blob::new_checked(&self.blob);
                self.stage = blob.map_or(Stage::Done, |blob| Stage::Names(blob.pieces()));
            }
            Stage::Names(pieces) if rests => self.name(pieces),
            Stage::Check | Stage::Names(_) | Stage::Done => {}
        }
    }

    fn described(&mut self) {
        self.stage = Stage::Done;
        if let Ok(board) = describe::Describe::parse(&self.words) {
            (self.channels, self.clock_hz) = (board.channels, board.clock_hz);
            self.stage = Stage::Uid;
        }
    }

    fn blob(&mut self, have: usize, out: &mut impl Outside) {
        const PIECE: usize = GUEST_READS;
        let at = |n: usize| map::DESCRIBE_BLOB + 4 * n as u32;
        // Words behind the blob read as 0.
        let Some(words) = ask::<PIECE>(core::array::from_fn(|n| at(have + n)), out) else {
            return;
        };
        let (places, _) = self.blob.as_chunks_mut();
        for (place, word) in places.iter_mut().skip(have).zip(words) {
            *place = word.to_be_bytes();
        }
        let have = have + PIECE;
        let all = self.words.get(describe::BLOB_WORDS_AT);
        let all = all.map_or(0, |words| *words as usize);
        self.stage = match have >= all.min(BLOB_WORDS) {
            true => Stage::Check,
            false => Stage::Blob(have),
        };
    }

    /// Finds the next names.
    fn name(&mut self, mut pieces: Pieces) {
        const _: () = assert!(HEADER_LEN <= 4 * BLOB_WORDS);
        let Some(entries) = pieces.next_of(&self.blob) else {
            self.stage = Stage::Done;
            return;
        };
        self.stage = Stage::Names(pieces);
        for entry in entries {
            let n = usize::from(entry.channel);
            let place = match entry.kind {
                Kind::Board => Some(&mut self.board),
                Kind::Configuration => Some(&mut self.configuration),
                Kind::Stepgen => self.stepgens.get_mut(n),
                Kind::Encoder => self.encoders.get_mut(n),
                Kind::Input => self.inputs.get_mut(n),
                Kind::Output => self.outputs.get_mut(n),
                Kind::Pwm
                | Kind::Pins
                | Kind::Mac
                | Kind::Ipv4
                | Kind::Port
                | Kind::Fpga
                | Kind::Platform => None,
            };
            if let Some(place) = place {
                place.clear();
                let text = core::str::from_utf8(entry.value).unwrap_or("?");
                // A name that is too long is cut behind a character.
                text.chars().all(|c| place.push(c).is_ok());
            }
        }
    }
}
