//! The source of instructions: a job in the store, or the few instructions of homing. Instructions
//! can be inserted before its next one.

use crate::instruction::Instruction;
use crate::job::Pull;
use crate::store::{Id, JobReader, Store};

/// The job cannot be read any more.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Broken;

/// A source of instructions.
#[derive(Debug)]
pub struct Program {
    reader: Option<JobReader>,
    pull: Pull,
    first: heapless::Deque<Instruction, 4>,
    line: u32,
}

impl Program {
    /// An empty program: only its end.
    pub fn nothing() -> Self {
        Program {
            reader: None,
            pull: Pull::default(),
            first: heapless::Deque::new(),
            line: 0,
        }
    }

    /// Starts with a job of the store.
    pub fn job(&mut self, store: &Store, id: Id) {
        self.reader = Some(store.reader(id));
        self.pull = Pull::default();
        self.first.clear();
        self.line = 0;
    }

    /// This one instruction, then the end.
    pub fn only(&mut self, instruction: Instruction) {
        self.reader = None;
        self.line = 0;
        self.first.clear();
        self.insert(instruction);
    }

    /// Inserts before everything else, but after what was inserted before.
    pub fn insert(&mut self, instruction: Instruction) {
        // Four are enough for a way back and a tool change.
        let _ = self.first.push_back(instruction);
    }

    /// The next instruction and its line; `None`: none in this call.
    pub fn next(&mut self, store: &Store) -> Result<Option<(Instruction, u32)>, Broken> {
        if let Some(instruction) = self.first.pop_front() {
            return Ok(Some((instruction, self.line)));
        }
        let Some(reader) = &mut self.reader else {
            return Ok(Some((Instruction::End, self.line)));
        };
        let mut gone = false;
        let next = self.pull.next(|out| {
            let count = store.read(reader, out);
            gone = count.is_none();
            count.unwrap_or(0)
        });
        match next {
            Ok(_) | Err(_) if gone => Err(Broken),
            Err(_) => Err(Broken),
            Ok(Some((instruction, line))) => {
                self.line = line;
                Ok(Some((instruction, line)))
            }
            Ok(None) if self.pull.ended() => Ok(Some((Instruction::End, self.line))),
            Ok(None) => Ok(None),
        }
    }
}
