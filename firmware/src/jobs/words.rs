//! FPGA G's protocol: words into instructions, instructions into the queue, and its status word.
//!
//! An instruction counts when its last word has come, as there; words may come one by one or many at once. Those of one that is refused are
//! gone, those that came behind them in the same request, too.

use motion::fpgag::{CURVE_WORDS, Command, Curve, Error, Move, WORDS, status};
use motion::segment::AXES;
use motion::words::{Limits, Player, Word};

/// Instructions that wait.
const DEPTH: usize = 64;

/// The status word of a request that was refused for another reason: nothing was executed.
pub const NOT_NOW: u32 = status::FULL | status::PARSE_ERROR;

/// A command that moves nothing.
pub fn harmless(command: u8) -> bool {
    !matches!(
        Command::from_code(command),
        Some(Command::Start | Command::Gcode)
    )
}

/// What a client of this protocol has sent.
#[derive(Debug)]
pub struct Words {
    player: Player<DEPTH>,
    form: u8,
    words: heapless::Vec<u32, CURVE_WORDS>,
    /// Instructions are begun.
    pub executes: bool,
}

impl Words {
    /// Of motors that are there.
    pub fn new(limits: Limits, positions: [i64; AXES]) -> Self {
        Words {
            player: Player::new(limits, positions),
            form: 0,
            words: heapless::Vec::new(),
            executes: true,
        }
    }

    /// Its instructions.
    pub fn player(&mut self) -> &mut Player<DEPTH> {
        &mut self.player
    }

    /// It begins, with the motors there; what waits is refused if that is beyond the limits now.
    pub fn begin(&mut self, positions: [i64; AXES]) -> Result<(), Error> {
        self.executes = true;
        self.player.begin_at(positions)
    }

    /// Words of instructions in this form; the status word.
    pub fn gcode(&mut self, form: u8, words: impl Iterator<Item = u32>) -> u32 {
        if form != self.form {
            self.words.clear();
            self.form = form;
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

    /// The status word.
    pub fn status(&self) -> u32 {
        if self.player.full() { status::FULL } else { 0 }
    }
}
