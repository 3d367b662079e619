//! Computes how long each test took from libtest's lines and the times at which they were printed.
//! libtest itself reports times with a nightly compiler only; cargo-nextest runs each test in a
//! process of its own, and the tests of a Verilated board share boards within a process.

use crate::step::Printed;
use std::sync::{Mutex, PoisonError};

/// Tests in the report.
const REPORTED: usize = 10;

/// The tests of all programs with their seconds; so many ran at a time.
fn tests(printed: &Printed, threads: usize) -> Vec<(String, f32)> {
    let mut programs: Vec<Program> = Vec::new();
    let mut offset = 0;
    for line in printed.text.split_inclusive('\n') {
        let (start, end) = (printed.at(offset), printed.at(offset + line.len() - 1));
        offset += line.len();
        if line.starts_with("running ") {
            programs.push(Program::at(start));
        }
        let Some(program) = programs.last_mut() else {
            continue;
        };
        let test = line
            .strip_prefix("test ")
            .and_then(|rest| rest.split_once(" ... "));
        // One at a time: the name comes when the test begins, and what it prints behind it.
        let ended = match threads {
            1 if test.is_some() || line.starts_with("test result") => Some(start),
            1 => None,
            _ => test.map(|_| end),
        };
        program
            .ends
            .extend(ended.filter(|_| threads > 1 || !program.names.is_empty()));
        program.names.extend(test.map(|(name, _)| name.to_owned()));
    }
    programs
        .iter()
        .flat_map(|program| program.tests(threads))
        .collect()
}

/// What was seen of a program.
struct Program {
    began: f32,
    /// Its tests as they were printed, and when each ended.
    names: Vec<String>,
    ends: Vec<f32>,
}

impl Program {
    fn at(began: f32) -> Self {
        Program {
            began,
            names: Vec::new(),
            ends: Vec::new(),
        }
    }

    /// libtest begins tests in the order of their names, so many at a time, and the next one when
    /// one has ended.
    fn tests(&self, threads: usize) -> Vec<(String, f32)> {
        let mut order = self.names.clone();
        order.sort();
        let begins = |name: &String| {
            let place = order.binary_search(name).unwrap_or(0);
            let before = place
                .checked_sub(threads)
                .and_then(|before| self.ends.get(before));
            before.copied().unwrap_or(self.began)
        };
        let ended = self.names.iter().zip(&self.ends);
        ended
            .map(|(name, end)| (name.clone(), end - begins(name)))
            .collect()
    }
}

/// The tests of this run so far.
static TESTS: Mutex<Vec<(String, f32)>> = Mutex::new(Vec::new());

/// Takes note of a test program's tests, of which so many ran at a time.
pub fn note(program: &str, printed: &Printed, threads: usize) {
    let mut noted = TESTS.lock().unwrap_or_else(PoisonError::into_inner);
    for (test, seconds) in tests(printed, threads.max(1)) {
        noted.push((format!("{program}::{test}"), seconds));
    }
}

/// The slowest tests noted, the slowest first, with their seconds.
pub fn slowest() -> Vec<(String, f32)> {
    let mut tests = TESTS.lock().unwrap_or_else(PoisonError::into_inner).clone();
    tests.sort_by(|a, b| b.1.total_cmp(&a.1));
    tests.truncate(REPORTED);
    tests
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Text that came piece by piece, each with its second.
    fn printed(pieces: &[(f32, &str)]) -> Printed {
        let mut printed = Printed::default();
        for (seconds, piece) in pieces {
            printed.text += piece;
            printed.growth.push((*seconds, printed.text.len()));
        }
        printed
    }

    fn named(tests: &[(String, f32)]) -> Vec<(&str, f32)> {
        tests
            .iter()
            .map(|(name, took)| (name.as_str(), *took))
            .collect()
    }

    #[test]
    fn of_two_tests_at_a_time_the_third_begins_when_the_first_of_them_ends() {
        let said = printed(&[
            (1.0, "Compiling\n\nrunning 4 tests\n"),
            (4.0, "test b ... ok\n"),
            (6.0, "test c has been running for over 60 seconds\n"),
            (11.0, "test a ... ok\n"),
            (12.0, "test d ... ok\n"),
            (14.0, "test c ... ok\n\ntest result: ok. 4 passed\n"),
        ]);
        let expected = [("b", 3.0), ("a", 10.0), ("d", 1.0), ("c", 10.0)];
        assert_eq!(named(&tests(&said, 2)), expected);
    }

    #[test]
    fn one_at_a_time_a_test_lasts_from_its_name_to_the_next_whatever_it_prints() {
        let said = printed(&[
            (1.0, "running 2 tests\ntest a ... "),
            (3.0, "sim: armed\nok\n"),
            (3.5, "test b ... "),
            (9.5, "ok\n"),
            (10.0, "\ntest result: ok. 2 passed\n"),
        ]);
        assert_eq!(named(&tests(&said, 1)), [("a", 2.5), ("b", 6.5)]);
    }

    #[test]
    fn each_program_begins_its_own_order() {
        let said = printed(&[
            (1.0, "running 1 test\n"),
            (4.0, "test z ... ok\n\ntest result: ok. 1 passed\n"),
            (5.0, "running 1 test\n"),
            (7.0, "test a ... ok\n\ntest result: ok. 1 passed\n"),
        ]);
        assert_eq!(named(&tests(&said, 2)), [("z", 3.0), ("a", 2.0)]);
    }

    #[test]
    fn output_without_tests_has_none() {
        assert!(tests(&printed(&[]), 2).is_empty());
        assert!(tests(&printed(&[(1.0, "error: no such thing\n")]), 1).is_empty());
    }
}
