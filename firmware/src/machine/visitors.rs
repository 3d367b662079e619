//! Decides what the clients of the services' consoles may do. The services make the text. The
//! decisions are here, so that a fault of the services cannot corrupt the key or the state.
//!
//! Each client logs in for itself: [`Machine`] keeps a bit for each of them.

use super::Machine;
use crate::auth::by_port;
use crate::cores::Board;
use crate::session::Peer;

/// Words that a [`Verb`] takes or gives.
pub const WORDS: usize = 6;

/// What a client's console asks for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum Verb {
    /// A client has connected: it has proved nothing.
    Connect = 0,
    /// Gives a challenge, four words, and the board's unique id, two.
    Challenge = 1,
    /// Takes the answer to the challenge, four words.
    Answer = 2,
    /// Restarts the firmware.
    Restart = 3,
    /// Asks whether the client may change anything now.
    Change = 4,
    /// With the number of a part of the stack: gives the bytes of the ROM's stack that were ever
    /// used, and its size. [`Verdict::NotNow`]: that part never was, ask for the next.
    Stack = 5,
}

impl Verb {
    const ALL: [Verb; 6] = [
        Verb::Connect,
        Verb::Challenge,
        Verb::Answer,
        Verb::Restart,
        Verb::Change,
        Verb::Stack,
    ];

    /// The verb with this number.
    pub fn from_code(code: u32) -> Option<Self> {
        Self::ALL.get(code as usize).copied()
    }
}

/// The answer to a [`Verb`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum Verdict {
    /// It is so, or it is done.
    Yes = 0,
    /// The owner of the machine needs the time.
    NotNow = 1,
    /// The board has a key, and the client has not proved that it has it.
    Key = 2,
    /// The answer to the challenge is wrong.
    Wrong = 3,
    /// The machine is armed.
    Armed = 4,
    /// A host owns the board.
    Owned = 5,
    /// The flash is busy.
    Flash = 6,
}

impl Verdict {
    const ALL: [Verdict; 7] = [
        Verdict::Yes,
        Verdict::NotNow,
        Verdict::Key,
        Verdict::Wrong,
        Verdict::Armed,
        Verdict::Owned,
        Verdict::Flash,
    ];

    /// The verdict with this number. An unknown one is no yes.
    pub fn from_code(code: u32) -> Self {
        let known = Self::ALL.get(code as usize).copied();
        known.unwrap_or(Verdict::NotNow)
    }
}

impl<B: Board> Machine<B> {
    /// Does what console number `visitor` asks for, if its client may.
    #[inline(never)]
    pub fn visit(&mut self, visitor: usize, verb: Verb, words: &mut [u32; WORDS]) -> Verdict {
        let bit = 1 << (visitor % 8);
        let before = self.server.auth.change(self.friends & bit != 0);
        let verdict = self.judge_visit(verb, words);
        self.friends &= !bit;
        if self.server.auth.change(before) {
            self.friends |= bit;
        }
        verdict
    }

    fn judge_visit(&mut self, verb: Verb, words: &mut [u32; WORDS]) -> Verdict {
        let rest = self.at_rest();
        match verb {
            Verb::Connect => {
                self.server.auth.greet();
                Verdict::Yes
            }
            // A hash takes as long as three exchanges.
            Verb::Challenge | Verb::Answer if !rest => Verdict::NotNow,
            Verb::Challenge => {
                // A frame brought the line a short time ago.
                self.server.auth.stir(self.board.now_lo());
                let [a, b, c, d] = *self.server.auth.challenge(by_port(wire::CONSOLE_PORT));
                let [uid_hi, uid_lo] = self.server.flash.uid();
                *words = [a, b, c, d, uid_hi, uid_lo];
                Verdict::Yes
            }
            Verb::Answer => {
                self.server.auth.stir(self.board.now_lo());
                let [a, b, c, d, ..] = *words;
                match self.server.auth.login(&[a, b, c, d]) {
                    Ok(()) => Verdict::Yes,
                    Err(why) => {
                        self.server.refuse(why);
                        Verdict::Wrong
                    }
                }
            }
            Verb::Restart => self.restart_for_visitor(rest),
            // While a job moves the machine, no host waits.
            Verb::Change if !rest && !self.session().is_owner(Peer::INSIDE) => Verdict::NotNow,
            Verb::Change if self.server.auth.trusted() => Verdict::Yes,
            Verb::Change => Verdict::Key,
            Verb::Stack => {
                let [part, ..] = *words;
                let Some((used, size)) = self.board.stack(part) else {
                    return Verdict::NotNow;
                };
                *words = [used, size, 0, 0, 0, 0];
                Verdict::Yes
            }
        }
    }

    fn restart_for_visitor(&mut self, rest: bool) -> Verdict {
        if !self.server.auth.trusted() {
            Verdict::Key
        } else if !rest {
            Verdict::Armed
        } else if self.session().owner().is_some() {
            Verdict::Owned
        } else if self.server.flash().busy() {
            Verdict::Flash
        } else {
            self.server.restart();
            Verdict::Yes
        }
    }
}

#[cfg(test)]
mod tests;
