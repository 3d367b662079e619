//! Looks, in a debug build, whether the rule of [`super`] is kept. In the image it is nothing.

use crate::cores::Board;
use crate::machine::Machine;
#[cfg(debug_assertions)]
use crate::{block::Shape, cores::Gate, pass, safety::Safety, session::Session};

/// What the rule is about, as it was.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Witness(Option<Kept>);

#[cfg(not(debug_assertions))]
type Kept = core::convert::Infallible;

/// Session, state, staged words, and the fast path's transmit slot.
#[cfg(debug_assertions)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Kept {
    session: Session,
    safety: Safety,
    state_word: u32,
    flags: u32,
    staged: u32,
    slot: u32,
}

impl Witness {
    /// Of nothing.
    pub(super) const NONE: Witness = Witness(None);
}

#[cfg(not(debug_assertions))]
impl Witness {
    /// Of the machine as it is.
    #[inline(always)]
    pub(super) fn of<B: Board>(_: &mut Machine<B>) -> Self {
        Witness::NONE
    }

    /// Fails if something has changed.
    #[inline(always)]
    pub(super) fn is_unchanged<B: Board>(&self, _: &mut Machine<B>) {}

    /// Fails if something has changed since the pass was handed out that is back now.
    #[inline(always)]
    pub(super) fn has_kept<B: Board>(&mut self, _: &mut Machine<B>, _executed: bool) {}
}

#[cfg(debug_assertions)]
impl Witness {
    pub(super) fn of<B: Board>(machine: &mut Machine<B>) -> Self {
        let Machine { board, server, .. } = machine;
        let words = |shape: &Shape| (pass::answer_length(shape) + 2).div_ceil(4);
        let staged = (0..wire::regmap::command::WORDS).map(|word| board.staged(word));
        let staged = sum(staged);
        let slot = sum((0..words(server.shape())).map(|word| board.prepared(word)));
        Witness(Some(Kept {
            session: server.session,
            safety: server.safety,
            state_word: server.state_word(Gate(0)),
            flags: server.flags,
            staged,
            slot,
        }))
    }

    pub(super) fn is_unchanged<B: Board>(&self, machine: &mut Machine<B>) {
        if self.0.is_some() {
            let now = Witness::of(machine);
            assert_eq!(*self, now, "a guest has changed what the fast path shares");
        }
    }

    /// The gateware stages the words of frames that it does not execute, too, and writes the answer
    /// to the one it does. The state machine notes when it saw the machine last.
    pub(super) fn has_kept<B: Board>(&mut self, machine: &mut Machine<B>, executed: bool) {
        let Some(mut before) = self.0.take() else {
            return;
        };
        let Witness(Some(now)) = Witness::of(machine) else {
            return;
        };
        (before.safety, before.staged) = (now.safety, now.staged);
        if executed {
            before.slot = now.slot;
        }
        assert_eq!(before, now, "changed while a pass was out");
    }
}

/// FNV-1a of words.
#[cfg(debug_assertions)]
fn sum(words: impl Iterator<Item = u32>) -> u32 {
    words.fold(0x811c_9dc5, |sum, word| {
        (sum ^ word).wrapping_mul(0x0100_0193)
    })
}
