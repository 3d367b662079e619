//! `fast_path.sv`: executes a command that firmware has judged in advance, and answers it.
//!
//! What comes in and goes out is drawn there. The words it stages and gathers are the board's
//! registers ([`super::board`]), the answer's slot is the MAC's; here is what decides.

use super::rx_admission::{Compared, Word};
use wire::regmap::fast_path;

/// Runs of the frame and of the answer.
pub const RUNS: usize = fast_path::IP_SUM - fast_path::RUN0;
/// The first run of the answer.
const ANSWER: usize = 4;
/// The word of a frame that is staged first.
const HEAD: u8 = 18;
/// Bits of a word's number in the answer's slot.
const INDEX: u32 = 0x7f;

/// Its inputs in a clock.
#[derive(Clone, Copy, Debug, Default)]
pub struct Input {
    /// Takes the pass back and ends an answer.
    pub rst: bool,
    /// A run is written, with its number.
    pub run: Option<(usize, u32)>,
    /// Sum of the words of the IP header that do not change.
    pub ip_sum: u16,
    /// Sum of pseudo header and ports.
    pub udp_sum: u16,
    /// The register `gate`.
    pub condition: u32,
    /// Pulses.
    pub pass: bool,
    /// See `pass`.
    pub revoke: bool,
    /// A word passes, ...
    pub word: Option<Word>,
    /// ... and is like this.
    pub compared: Compared,
    /// The gate's register.
    pub gate_now: u32,
    /// A timed commit is pending.
    pub waiting: bool,
    /// Whose latch was asked for, as staged.
    pub select: u32,
    /// The answer's slot can be sent.
    pub free: bool,
}

/// What it does in a clock.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Output {
    /// The word that passes is written to this register.
    pub stages: Option<u32>,
    /// The slot's writer forgets the frame that has ended.
    pub take: bool,
    /// Sample, feed, send.
    pub taken: bool,
    /// And commit, ...
    pub commit: bool,
    /// ... or commit at its time.
    pub commit_timed: bool,
    /// A word of the answer is read from this register.
    pub gathers: Option<u32>,
    /// What was read a clock ago is written to this word of the slot.
    pub puts: Option<usize>,
    /// The CPU's access to registers waits.
    pub hold: bool,
}

/// The core.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct FastPath {
    runs: [u32; RUNS],
    next: usize,
    address: u32,
    left: u32,
    ends: bool,
    skips: bool,
    mine: bool,
    alike: bool,
    complete: bool,
    gathering: bool,
    index: u32,
    sum: u32,
    carry: bool,
    unsummed: bool,
    taken: bool,
    puts: bool,
    put_at: u32,
    out: bool,
    executed: bool,
}

impl FastPath {
    /// A pass is out.
    pub fn out(&self) -> bool {
        self.out
    }

    /// A command has been executed since the last pass.
    pub fn executed(&self) -> bool {
        self.executed
    }

    /// Without a word and a write nothing happens in the next clocks.
    pub fn quiet(&self) -> bool {
        let busy = self.complete || self.taken || self.gathering || self.puts;
        !busy && self.mine == (self.mine && self.out)
    }

    /// What it does in this clock.
    pub fn does(&self, i: &Input) -> Output {
        let head = i.compared.at < HEAD;
        let stages = i.word.is_some() && self.mine && self.out && self.alike && !head;
        let gathers = self.gathering && !self.skips;
        let executes = self.taken && i.condition & fast_path::GATE_EXECUTES != 0;
        let timed = i.condition & fast_path::GATE_TIMED != 0;
        Output {
            stages: stages.then_some(self.address),
            take: self.takes(i),
            taken: self.taken,
            commit: executes && !timed,
            commit_timed: executes && timed,
            gathers: gathers.then_some(self.address),
            puts: self.puts.then_some(self.put_at as usize),
            hold: stages || self.complete || self.taken || gathers,
        }
    }

    /// The frame that ended a clock ago is executed.
    fn takes(&self, i: &Input) -> bool {
        let gate = i.gate_now == i.condition & fast_path::GATE_STATUS;
        self.complete && (self.right() || self.unsummed) && self.out && gate && i.free
    }

    /// The sum is that of a frame with a right checksum.
    fn right(&self) -> bool {
        let folded = (self.sum >> 16) + (self.sum & 0xffff) + u32::from(self.carry);
        folded >> 1 & 0x7fff == 0x7fff && folded & 1 != folded >> 16 & 1
    }

    /// The word makes the frame another one than that of the pass.
    fn differs(word: &Word, compared: Compared) -> bool {
        let Compared { at, high, low } = compared;
        // Number, flags and checksums change from frame to frame; word 12 is padding.
        let unlike = match at {
            5 | 12 => false,
            6 | 10 => !high,
            0..HEAD => !high || !low,
            _ => false,
        };
        let fragment = at == 5 && word.data & 0xbfff != 0;
        unlike || fragment || Self::unknown(word, compared)
    }

    /// Bits above the selection of a latch.
    fn unknown(word: &Word, compared: Compared) -> bool {
        compared.at == 23 && word.data >> 21 != 0
    }

    /// One rising edge.
    pub fn clock(&mut self, i: &Input) {
        let does = self.does(i);
        let take = does.take;
        let (gathering, turns, was_complete) = (self.gathering, self.left == 0, self.complete);
        let (at, head) = (i.compared.at, i.compared.at < HEAD);
        let index = match self.skips {
            true => self.address & INDEX,
            false => (self.index + u32::from(does.gathers.is_some())) & INDEX,
        };
        (self.puts, self.put_at) = (does.gathers.is_some(), self.index);

        self.complete = !i.rst
            && i.word.is_some_and(|word| {
                let good = word.last && word.whole && !word.bad;
                let like = self.mine && self.out && self.alike && !Self::unknown(&word, i.compared);
                good && like && !head && turns && self.ends
            });
        let (mine, ip_wrong) = (self.mine && self.out, at == 8 && !self.right());
        self.mine = mine;
        if let Some(word) = &i.word {
            if at == 0 {
                self.mine = self.out && !i.waiting && !gathering && !was_complete;
            }
            let over = !head && turns && self.ends;
            let differs = Self::differs(word, i.compared);
            self.alike = (self.alike || at == 0) && !differs && !ip_wrong && !over;
            self.add(at, word.data, i);
        }
        self.turn(i, &does, turns);
        self.index = index;

        self.taken = !i.rst && take;
        self.out = !i.rst && (i.pass || (self.out && !i.revoke && !take));
        self.executed = !i.rst && (take || (self.executed && !i.pass));
        if let Some((number, run)) = i.run {
            self.runs[number] = run;
        }
    }

    /// The sums: a carry is added a word later.
    fn add(&mut self, at: u8, data: u32, i: &Input) {
        match at {
            4 | 9 => {
                self.sum = if at == 4 { i.ip_sum } else { i.udp_sum }.into();
                self.carry = false;
            }
            5 | 6 | 10.. => {
                let more = u64::from(self.sum) + u64::from(data) + u64::from(self.carry);
                (self.carry, self.sum) = (more >> 32 != 0, more as u32);
            }
            _ => {}
        }
        if at == 10 {
            self.unsummed = data & 0xffff == 0;
        }
    }

    /// The runs: a word as it comes, then a word or a clock of the answer every clock.
    fn turn(&mut self, i: &Input, does: &Output, turns: bool) {
        let (gathering, ended, at) = (self.gathering, self.ends, i.compared.at);
        let follows = match gathering {
            true => turns,
            false => i.word.is_some() && (at == HEAD - 1 || (at >= HEAD && turns)),
        };
        if follows {
            let run = self.runs[self.next];
            let select = match run & fast_path::RUN0_SELECT != 0 {
                true => i.select & 0x1f,
                false => 0,
            };
            self.ends = run & fast_path::RUN0_END != 0 || self.next == RUNS - 1;
            self.skips = run & fast_path::RUN0_SKIP != 0;
            self.left = (run & fast_path::RUN0_COUNT) >> fast_path::RUN0_COUNT_SHIFT;
            self.address = run & fast_path::RUN0_REGISTER | select;
            self.next = (self.next + 1) % RUNS;
        } else if gathering || does.stages.is_some() {
            let most = fast_path::RUN0_COUNT >> fast_path::RUN0_COUNT_SHIFT;
            self.address = (self.address + u32::from(!self.skips)) & fast_path::RUN0_REGISTER;
            self.left = self.left.wrapping_sub(1) & most;
        }
        if i.word.is_some() && !gathering && at == 0 {
            self.next = 0;
        }
        if does.take {
            // Behind a run of no words.
            (self.gathering, self.skips, self.ends) = (true, true, false);
            (self.left, self.next) = (0, ANSWER);
        } else if gathering && turns && ended {
            self.gathering = false;
        }
        self.gathering &= !i.rst;
    }
}

#[cfg(test)]
mod tests;
