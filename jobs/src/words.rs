//! FPGA G's protocol: turns words into instructions, puts instructions into the queue, and makes
//! the status word.
//!
//! An instruction counts when its last word has come, as there; words may come one by one or many
//! at once. Those of one that is refused are gone, those that came after them in the same request,
//! too.
//!
//! An instruction is of one client and in one form. Words of another client, or in the other form,
//! do not complete it: it is dropped, and both clients are told by a parse error, the one that
//! comes now and the one that began it when it goes on.

use crate::fpgag::{CURVE_WORDS, Curve, Error, FpgagCommand, Move, WORDS, status};
use crate::player::{Limits, Player, Word};
use motion::segment::{AXES, Segment};

/// Largest number of waiting instructions.
const DEPTH: usize = 64;

/// The status word of a request that was refused for another reason: nothing was executed.
pub const NOT_NOW: u32 = status::FULL | status::PARSE_ERROR;

/// A command that moves nothing.
pub fn harmless(command: u8) -> bool {
    !matches!(
        FpgagCommand::from_code(command),
        Some(FpgagCommand::Start | FpgagCommand::Gcode)
    )
}

/// A command that ends motion.
pub fn halts(command: u8) -> bool {
    FpgagCommand::from_code(command) == Some(FpgagCommand::Stop)
}

/// The words a client of this protocol has sent.
#[derive(Debug)]
pub struct Words {
    player: Player<DEPTH>,
    form: u8,
    /// The client whose instruction `words` begin.
    client: u32,
    words: heapless::Vec<u32, CURVE_WORDS>,
    /// The client whose half instruction was dropped for another's words, and that has not been
    /// told.
    torn: Option<u32>,
    /// Instructions are begun.
    pub executes: bool,
}

impl Words {
    /// For motors at these positions.
    pub fn new(limits: Limits, positions: [i64; AXES]) -> Self {
        Words {
            player: Player::new(limits, positions),
            form: 0,
            client: 0,
            torn: None,
            words: heapless::Vec::new(),
            executes: true,
        }
    }

    /// The next segment; `None`: there is none now.
    pub fn poll(&mut self) -> Option<Segment> {
        self.player.poll(self.executes)
    }

    /// Sets the limits for new instructions; a waiting one is checked again when it begins.
    pub fn set_limits(&mut self, limits: Limits) {
        self.player.set_limits(limits);
    }

    /// Begins, with the motors at these positions and these limits; refuses the waiting
    /// instructions if they exceed them.
    pub fn begin(&mut self, limits: Limits, positions: [i64; AXES]) -> Result<(), Error> {
        self.executes = true;
        self.player.begin_at(limits, positions)
    }

    /// Words of this client's instructions in this form; the status word.
    pub fn gcode(&mut self, client: u32, form: u8, words: impl Iterator<Item = u32>) -> u32 {
        if self.tears(client, form) {
            return status::PARSE_ERROR;
        }
        let length = match form {
            0 => WORDS,
            1 => CURVE_WORDS,
            _ => return status::PARSE_ERROR,
        };
        for word in words {
            if self.words.is_empty() && self.player.full() {
                return status::FULL;
            }
            let _ = self.words.push(word);
            if self.words.len() < length {
                continue;
            }
            let parsed = match (self.words.first_chunk(), self.words.first_chunk()) {
                (_, Some(words)) if form == 1 => Curve::parse(*words).map(Word::Curve),
                (Some(words), _) => Move::parse(*words).map(Word::Move),
                (None, _) => return status::PARSE_ERROR,
            };
            self.words.clear();
            if parsed.and_then(|word| self.player.push(word)).is_err() {
                return status::PARSE_ERROR;
            }
        }
        0
    }

    /// These words come in the middle of another instruction, or are the rest of one that was
    /// dropped.
    fn tears(&mut self, client: u32, form: u8) -> bool {
        let told = self.torn == Some(client);
        if told {
            self.torn = None;
        }
        let torn = !self.words.is_empty() && (client, form) != (self.client, self.form);
        if torn && client != self.client {
            self.torn = Some(self.client);
        }
        if torn {
            self.words.clear();
        }
        (self.client, self.form) = (client, form);
        torn || told
    }

    /// The status word.
    pub fn status(&self) -> u32 {
        if self.player.full() { status::FULL } else { 0 }
    }
}
