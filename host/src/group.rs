//! Several boards that are one machine: a stop of one board stops all.
//!
//! With a gantry on two boards, or three axes on one board and the fourth on another, if an axis
//! goes on while another has stopped, the machine crashes. So a board that is given up, stops by
//! itself or is halted raises the alarm, and every other board of the group is told to stop softly
//! by its next command. All reads come before all writes in a servo thread, so that next command is
//! this period's:
//!
//! ```text
//!   read.0  read.1  read.2 !      motion      write.0  write.1  write.2
//!                          alarm  ----------> stop     stop     -
//! ```
//!
//! A thread that reads and writes one board after the other tells those before the dead one a
//! period later.
//!
//! No board of the group is armed while another one does not answer. `stop-group` takes a board out
//! of it.

use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering::Relaxed};

/// What is known of the others. Relaxed: one servo thread usually, and a period later at worst if
/// it is not.
#[derive(Debug, Default)]
pub struct Group {
    /// The last alarm: the number of alarms, times 256, plus the index of its board.
    alarm: AtomicU32,
    /// Boards that do not answer, one bit each.
    lost: AtomicU32,
}

impl Group {
    /// An empty group.
    pub fn new() -> Arc<Self> {
        Arc::default()
    }

    /// Board `index` has stopped without a command to stop.
    pub fn raise(&self, index: usize) {
        let count = self.alarm.load(Relaxed) >> 8;
        let alarm = count.wrapping_add(1) << 8 | (index as u32 & 0xff);
        self.alarm.store(alarm, Relaxed);
    }

    /// The board with an alarm newer than `heard`.
    pub fn alarm(&self, heard: &mut u32) -> Option<usize> {
        let alarm = self.alarm.load(Relaxed);
        let news = alarm != *heard;
        *heard = alarm;
        news.then_some((alarm & 0xff) as usize)
    }

    /// Whether board `index` answers.
    pub fn answers(&self, index: usize, it_does: bool) {
        if it_does {
            self.lost.fetch_and(!(1 << index), Relaxed);
        } else {
            self.lost.fetch_or(1 << index, Relaxed);
        }
    }

    /// Another board than `index` that does not answer.
    pub fn lost_beside(&self, index: usize) -> Option<usize> {
        let others = self.lost.load(Relaxed) & !(1 << index);
        (others != 0).then_some(others.trailing_zeros() as usize)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_board_hears_an_alarm_once_and_the_next_one_again() {
        let group = Group::new();
        let mut heard = [0; 3];
        assert_eq!(group.alarm(&mut heard[0]), None);
        for _ in 0..2 {
            group.raise(2);
            for heard in &mut heard {
                assert_eq!(group.alarm(heard), Some(2));
                assert_eq!(group.alarm(heard), None);
            }
        }
    }

    #[test]
    fn a_board_that_does_not_answer_is_seen_by_the_others_only() {
        let group = Group::new();
        group.answers(1, false);
        assert_eq!(group.lost_beside(0), Some(1));
        assert_eq!(group.lost_beside(1), None);
        group.answers(1, true);
        assert_eq!(group.lost_beside(0), None);
    }
}
