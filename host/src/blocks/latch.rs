//! `index-enable` and `probe-enable` of one channel: a request in, exactly one latched value out.
//!
//! The board's latch and this block shake hands over a network that may lose any datagram:
//!
//! ```text
//! pin (io)       ____/‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾\________   cleared together with the jump of the position
//! arm bit        _____/‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾\________
//! board's flag   ______________/‾‾‾‾‾‾‾‾‾‾‾‾‾\______   up: the value stands
//! select         _______________/‾‾‾‾‾‾‾‾‾‾‾‾\______
//! value answered _________________________v_________
//! ```
//!
//! Only confirmed states count. The arm bit rises only after an answer to a command that carried it
//! low said that the flag is low, so a flag left over from the last time is never taken for a new
//! one; a value counts only when the answer that carries it was selected for this channel *and*
//! says that the flag is up. A lost datagram costs a period, but never gives a wrong home position.
//!
//! The board commits arm bits only while its outputs are live, so a request waits until the machine
//! is armed.

use wire::units::Count;

/// What armed the latch.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Source {
    /// The channel's index pin.
    Index,
    /// The board's probe input.
    Probe,
}

/// What an answer says about one channel's latch.
#[derive(Clone, Copy, Debug, Default)]
pub struct LatchSample {
    /// The command it answers.
    pub sequence: u32,
    /// The board was executing commands.
    pub live: bool,
    /// The index flag.
    pub index: bool,
    /// The probe flag.
    pub probe: bool,
    /// The latch, if the command selected this channel.
    pub value: Option<Count>,
}

/// One arm bit.
#[derive(Clone, Copy, Debug, Default)]
struct Arm {
    up: bool,
    /// The first command that carried the bit as it is now; `None` before there was one.
    since: Option<u32>,
    /// The board has confirmed that bit and flag are both down.
    quiet: bool,
}

impl Arm {
    fn command(&mut self, wish: bool, sequence: u32) -> bool {
        if self.up && !wish {
            *self = Arm::default();
        } else if !self.up && wish && self.quiet {
            *self = Arm {
                up: true,
                ..Arm::default()
            };
        }
        self.since.get_or_insert(sequence);
        self.up
    }

    /// Takes the flag; `true` when it is up because of this arming.
    fn answered(&mut self, sequence: u32, flag: bool) -> bool {
        let heard = self
            .since
            .is_some_and(|since| sequence.wrapping_sub(since) as i32 >= 0);
        if heard && !self.up {
            self.quiet = !flag;
        }
        heard && self.up && flag
    }
}

/// Both sources of one channel.
#[derive(Clone, Copy, Debug, Default)]
pub struct Latching {
    index: Arm,
    probe: Arm,
    fetching: bool,
}

impl Latching {
    /// The arm bits (index, probe) of the command with this sequence number.
    pub fn command(&mut self, index: bool, probe: bool, live: bool, sequence: u32) -> (bool, bool) {
        if !live {
            self.forget();
            return (false, false);
        }
        let index = self.index.command(index, sequence);
        let probe = self.probe.command(probe, sequence);
        self.fetching &= index || probe;
        (index, probe)
    }

    /// Whether the next command should select this channel.
    pub fn wants_value(&self) -> bool {
        self.fetching
    }

    /// Takes an answer; returns the source and the latched value once they are certain.
    #[must_use]
    pub fn answered(&mut self, latch_sample: &LatchSample) -> Option<(Source, Count)> {
        if !latch_sample.live {
            self.forget();
            return None;
        }
        let index = self
            .index
            .answered(latch_sample.sequence, latch_sample.index);
        let probe = self
            .probe
            .answered(latch_sample.sequence, latch_sample.probe);
        self.fetching = index || probe;
        let value = latch_sample.value?;
        if index {
            self.index = Arm::default();
            self.fetching = probe;
            Some((Source::Index, value))
        } else if probe {
            self.probe = Arm::default();
            self.fetching = false;
            Some((Source::Probe, value))
        } else {
            None
        }
    }

    /// The board may have forgotten the latch: begin again.
    pub fn forget(&mut self) {
        *self = Latching::default();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn latch_sample(sequence: u32, index: bool, value: Option<u32>) -> LatchSample {
        LatchSample {
            sequence,
            live: true,
            index,
            probe: false,
            value: value.map(Count),
        }
    }

    #[test]
    fn a_flag_left_over_from_the_last_time_is_not_taken_again() {
        let mut latch = Latching::default();
        assert_eq!(latch.command(true, false, true, 1), (false, false));
        assert_eq!(latch.answered(&latch_sample(1, true, Some(50))), None);
        assert_eq!(latch.command(true, false, true, 2), (false, false));
        assert_eq!(latch.answered(&latch_sample(2, false, Some(50))), None);
        assert_eq!(latch.command(true, false, true, 3), (true, false));
    }

    #[test]
    fn an_answer_from_before_the_arm_bit_fell_proves_nothing() {
        let mut latch = Latching::default();
        latch.command(true, false, true, 7);
        assert_eq!(latch.answered(&latch_sample(6, false, None)), None);
        assert_eq!(latch.command(true, false, true, 8), (false, false));
        assert_eq!(latch.answered(&latch_sample(7, false, None)), None);
        assert_eq!(latch.command(true, false, true, 9), (true, false));
    }

    #[test]
    fn a_value_counts_only_if_it_was_selected_and_its_flag_is_up() {
        let mut latch = Latching::default();
        latch.command(true, false, true, 1);
        let _ = latch.answered(&latch_sample(1, false, None));
        latch.command(true, false, true, 2);
        assert_eq!(latch.answered(&latch_sample(2, false, Some(9))), None);
        assert_eq!(latch.answered(&latch_sample(3, true, None)), None);
        assert!(latch.wants_value());
        let caught = latch.answered(&latch_sample(4, true, Some(77)));
        assert_eq!(caught, Some((Source::Index, Count(77))));
        assert!(!latch.wants_value());
    }

    #[test]
    fn index_and_probe_share_a_latch_and_keep_their_own_flags() {
        let mut latch = Latching::default();
        latch.command(true, true, true, 1);
        let _ = latch.answered(&latch_sample(1, false, None));
        assert_eq!(latch.command(true, true, true, 2), (true, true));
        let probe = LatchSample {
            probe: true,
            ..latch_sample(3, false, Some(5))
        };
        assert_eq!(latch.answered(&probe), Some((Source::Probe, Count(5))));
        // The index goes on waiting, the probe's bit falls.
        assert_eq!(latch.command(true, false, true, 4), (true, false));
    }

    #[test]
    fn a_wish_waits_until_the_machine_is_live() {
        let mut latch = Latching::default();
        for sequence in 1..5 {
            assert_eq!(latch.command(true, false, false, sequence), (false, false));
        }
        assert_eq!(latch.command(true, false, true, 5), (false, false));
        let _ = latch.answered(&latch_sample(5, false, None));
        assert_eq!(latch.command(true, false, true, 6), (true, false));
    }

    /// The gateware's latch, committed and sampled like the real one.
    #[derive(Default)]
    struct Board {
        arm: bool,
        seen_low: bool,
        value: Option<u32>,
    }

    impl Board {
        /// One period of an axis at `count`; its index is up while `count % 100 < 3`.
        fn turn(&mut self, count: u32) {
            let index = count % 100 < 3;
            if self.arm && self.value.is_none() && index && self.seen_low {
                self.value = Some(count);
            }
            self.seen_low = !index;
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(400))]

        /// With any loss of commands and answers and any moment of a request, every value taken is
        /// the first index after a pending request, and the pin falls with it.
        #[test]
        fn whatever_is_lost_only_true_values_are_taken(
            lost in proptest::collection::vec(0u8..8, 400),
            wish in proptest::collection::vec(proptest::bool::weighted(0.03), 400),
            withdraw in proptest::collection::vec(proptest::bool::weighted(0.02), 400),
        ) {
            let (mut latch, mut board) = (Latching::default(), Board::default());
            let (mut pin, mut wished_at) = (false, 0u32);
            for n in 0..400usize {
                let count = 1000 + n as u32;
                if wish[n] && !pin {
                    (pin, wished_at) = (true, count);
                }
                if withdraw[n] {
                    pin = false;
                }
                let selected = latch.wants_value();
                let (arm, _) = latch.command(pin, false, true, n as u32);
                board.turn(count);
                if lost[n] == 0 {
                    continue;
                }
                // Sampled on the clock of the commit.
                let answer = latch_sample(n as u32, board.value.is_some(), selected.then(|| board.value.unwrap_or(1)));
                board.arm = arm;
                if !arm {
                    board.value = None;
                }
                if lost[n] == 1 {
                    continue;
                }
                if let Some((_, value)) = latch.answered(&answer) {
                    prop_assert!(pin, "there was no request");
                    prop_assert!(value.0 % 100 < 3 && value.0 >= wished_at, "{} before {wished_at}", value.0);
                    prop_assert!(count - value.0 < 100, "an old index");
                    pin = false;
                }
            }
        }
    }
}
