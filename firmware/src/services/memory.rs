//! Tests the SDRAM: its size, and whether it stores data correctly.

/// Words that can be written and read, with any effect.
pub trait Cells {
    /// A word, by its byte offset.
    fn write(&mut self, at: usize, value: u32);
    /// See [`Cells::write`].
    fn read(&mut self, at: usize) -> u32;
}

/// Bytes of the data cache: a word this far away replaces another one in it.
const CACHE: usize = 0x1000;

/// Each of the 32 data lines has its own bits in these words, so that two connected lines differ.
const CODES: [u32; 5] = [
    0xaaaa_aaaa,
    0xcccc_cccc,
    0xf0f0_f0f0,
    0xff00_ff00,
    0xffff_0000,
];
/// Numbers with an odd count of 1s in their binary form; it differs where any of the words above
/// differs.
const ZERO: u32 = 0x9669_6996;

/// The pattern for the place of this address line, or for 0. No two of ten lines in a row have the
/// same.
fn pattern(at: usize) -> u32 {
    let line = at.trailing_zeros() as usize;
    let code = CODES.get(line % CODES.len()).copied().unwrap_or(0);
    match line / CODES.len() % 2 {
        _ if at == 0 => ZERO,
        0 => code,
        _ => !code,
    }
}

/// Writes a word for each address line above the first `used` bytes, each with other bits, and
/// reads them all back; then the same with all bits inverted. The lower lines are known to work,
/// because the data there is right. Returns the number of bytes if they work: the `window`, or half
/// of it on a card with half as much, where the window shows the memory twice. The first word is
/// overwritten.
pub fn size(cells: &mut impl Cells, used: usize, window: usize) -> Option<usize> {
    let lines = (2..window.ilog2())
        .map(|line| 1usize << line)
        .filter(|at| *at > used);
    let half = window / 2;
    let mut found = None;
    for turned in [0, u32::MAX] {
        let pattern = |at: usize| pattern(at) ^ turned;
        for at in lines.clone() {
            cells.write(at, pattern(at));
        }
        // On a card with half as much memory this is also the word in the middle of the window.
        cells.write(0, pattern(0));
        // Each of these is at a multiple of the cache's size, and so is read from the SDRAM.
        cells.read(CACHE);
        let size = if cells.read(half) == pattern(0) {
            half
        } else {
            window
        };
        let good = lines
            .clone()
            .filter(|at| *at < size)
            .all(|at| cells.read(at) == pattern(at));
        if !good || found.is_some_and(|found| found != size) {
            return None;
        }
        found = Some(size);
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeMap;

    const WINDOW: usize = 8 << 20;
    /// About the size of the program.
    const USED: usize = 200 * 1024;

    /// A chip with faults in its lines: `address` and `data` say what the lines become.
    struct Chip<A, D> {
        words: BTreeMap<usize, u32>,
        address: A,
        data: D,
    }

    impl<A: Fn(usize) -> usize, D: Fn(u32) -> u32> Cells for Chip<A, D> {
        fn write(&mut self, at: usize, value: u32) {
            assert!(at.is_multiple_of(4) && at < WINDOW);
            assert!(at == 0 || at > USED, "{at:#x} is the program's");
            self.words.insert((self.address)(at), value);
        }
        fn read(&mut self, at: usize) -> u32 {
            let word = self.words.get(&(self.address)(at));
            (self.data)(word.copied().unwrap_or(0xdead_5d5d))
        }
    }

    fn found(address: impl Fn(usize) -> usize, data: impl Fn(u32) -> u32) -> Option<usize> {
        let words = BTreeMap::new();
        let mut chip = Chip {
            words,
            address,
            data,
        };
        size(&mut chip, USED, WINDOW)
    }

    #[test]
    fn a_card_with_half_as_much_is_told_from_a_whole_one() {
        assert_eq!(found(|at| at, |word| word), Some(WINDOW));
        assert_eq!(found(|at| at % (WINDOW / 2), |word| word), Some(WINDOW / 2));
    }

    #[test]
    fn lines_of_half_a_card_are_looked_at_as_closely() {
        for bit in 0..32 {
            for other in 0..bit {
                let tied = |word: u32| {
                    let both = (word >> bit | word >> other) & 1;
                    word | both << bit | both << other
                };
                assert_eq!(
                    found(|at| at % (WINDOW / 2), tied),
                    None,
                    "{bit} and {other}"
                );
            }
        }
    }

    #[test]
    fn a_quarter_is_no_card_that_is_known() {
        assert_eq!(found(|at| at % (WINDOW / 4), |word| word), None);
    }

    #[test]
    fn a_data_line_that_is_stuck_or_tied_to_another_is_found() {
        for bit in 0..32 {
            assert_eq!(found(|at| at, |word| word | 1 << bit), None, "{bit} high");
            assert_eq!(found(|at| at, |word| word & !(1 << bit)), None, "{bit} low");
            for other in 0..bit {
                let tied = |word: u32| {
                    let both = word >> bit & word >> other & 1;
                    word & !(1 << bit | 1 << other) | both << bit | both << other
                };
                assert_eq!(found(|at| at, tied), None, "{bit} and {other}");
            }
        }
    }

    #[test]
    fn an_address_line_that_is_stuck_or_tied_to_another_is_found() {
        let beyond = |line: &u32| 1usize << line > USED;
        // The last line is missing on a card with half as much memory.
        for line in (2..WINDOW.ilog2() - 1).filter(beyond) {
            assert_eq!(
                found(|at| at & !(1 << line), |word| word),
                None,
                "{line} low"
            );
            for other in (line + 1..WINDOW.ilog2()).filter(beyond) {
                let tied = |at: usize| {
                    let both = at >> line & at >> other & 1;
                    at & !(1 << line | 1 << other) | both << line | both << other
                };
                assert_eq!(found(tied, |word| word), None, "{line} and {other}");
            }
        }
    }

    #[test]
    fn nothing_that_answers_is_no_memory() {
        assert_eq!(found(|at| at, |_| 0), None);
        assert_eq!(found(|at| at, |_| 0xdead_5d5d), None);
    }
}
