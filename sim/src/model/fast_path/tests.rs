use super::*;
use crate::model::rx_admission::{self, RxAdmission};
use crate::stimulus::frames::{HOST, TOKEN, US, datagram, from_owner, udp_checksum};
use firmware::block::Shape;
use firmware::net;
use firmware::pass::{self, Expected};
use wire::describe::Channels;
use wire::etherbone::{HEADER, record};
use wire::map;
use wire::regmap::{command, status, timebase};

const SEQUENCE: u32 = 41;
const FLAGS: u32 = 3;
/// Gate open, watchdog awake.
const LIVE: u32 = 0b10_0001;

fn shape() -> Shape {
    Shape::new(Channels {
        stepgens: 3,
        encoders: 2,
        pwms: 2,
        inputs: 4,
        outputs: 4,
    })
}

/// The owner's next frame, without a UDP checksum. Its words from 18 on are their numbers.
fn frame() -> Vec<u32> {
    let count = shape().command;
    let head = [
        HEADER,
        0,
        record(count, 0),
        map::COMMAND,
        TOKEN,
        SEQUENCE,
        FLAGS,
    ];
    let rest = (18..).take(count - 3);
    let payload: Vec<u32> = head.into_iter().chain(rest).collect();
    from_owner(&payload)
}

/// With a right checksum.
fn summed(mut frame: Vec<u32>) -> Vec<u32> {
    frame[10] &= 0xffff_0000;
    frame[10] |= udp_checksum(&frame);
    frame
}

/// The core and the filter as firmware leaves them with a pass out, and what is around them.
struct Bench {
    core: FastPath,
    filter: RxAdmission,
    at_rest: Input,
    staged: Vec<(u32, u32)>,
    /// What it did, clock by clock, behind a frame.
    did: Vec<Output>,
}

impl Bench {
    /// With the prepared words and runs, but no pass.
    fn without_pass() -> Self {
        let expected = Expected::new(&US, &datagram(&HOST), shape().command, TOKEN);
        let mut bench = Bench {
            core: FastPath::default(),
            filter: RxAdmission::default(),
            at_rest: Input {
                ip_sum: expected.ip_sum as u16,
                udp_sum: expected.udp_sum as u16,
                condition: LIVE | fast_path::GATE_EXECUTES,
                gate_now: LIVE,
                free: true,
                ..Input::default()
            },
            staged: Vec::new(),
            did: Vec::new(),
        };
        let mut words = expected.words;
        words[pass::SEQUENCE_PLACE] = SEQUENCE;
        words[pass::FLAGS_PLACE] = FLAGS;
        for header in words.into_iter().enumerate() {
            bench.filter.clock(&rx_admission::Input {
                header: Some(header),
                ..rx_admission::Input::default()
            });
        }
        for run in pass::runs(&shape()).into_iter().enumerate() {
            bench.clock(|i| i.run = Some(run));
        }
        bench
    }

    fn new() -> Self {
        let mut bench = Self::without_pass();
        bench.pass();
        bench
    }

    fn pass(&mut self) {
        self.clock(|i| i.pass = true);
    }

    fn revoke(&mut self) {
        self.clock(|i| i.revoke = true);
    }

    /// One clock with the inputs at rest but for these.
    fn clock(&mut self, change: impl FnOnce(&mut Input)) -> Output {
        let mut input = self.at_rest;
        change(&mut input);
        self.made(&input)
    }

    fn made(&mut self, input: &Input) -> Output {
        let does = self.core.does(input);
        self.core.clock(input);
        does
    }

    fn word(&mut self, word: Word) {
        let mut input = self.at_rest;
        input.word = Some(word);
        input.compared = self.filter.compares(word.data);
        let does = self.made(&input);
        if let Some(to) = does.stages {
            self.staged.push((to, word.data));
        }
        self.filter.clock(&rx_admission::Input {
            word: Some(word),
            ..rx_admission::Input::default()
        });
    }

    fn words(&mut self, words: impl IntoIterator<Item = Word>) {
        words.into_iter().for_each(|word| self.word(word));
    }

    /// A frame, and the clocks behind it until the core is quiet. Was it executed?
    fn frame(&mut self, words: &[u32]) -> bool {
        self.staged.clear();
        self.words(whole(words));
        self.behind()
    }

    fn behind(&mut self) -> bool {
        self.did.clear();
        loop {
            let does = self.clock(|_| {});
            self.did.push(does);
            if self.core.quiet() {
                break;
            }
        }
        self.did.iter().any(|did| did.taken)
    }
}

fn whole(words: &[u32]) -> impl Iterator<Item = Word> + '_ {
    Word::of_frame(words, words.len() * 4)
}

/// A register as the fast path calls it.
fn register(page: u32, word: usize) -> u32 {
    (page - 8) << 7 | word as u32
}

#[test]
fn the_expected_frame_is_executed_with_and_without_a_checksum() {
    assert!(Bench::new().frame(&frame()));
    assert!(Bench::new().frame(&summed(frame())));
}

#[test]
fn a_pass_is_for_one_command() {
    let mut bench = Bench::new();
    assert!(bench.core.out() && !bench.core.executed());
    assert!(bench.frame(&frame()));
    assert!(!bench.core.out() && bench.core.executed());
    assert!(!bench.frame(&frame()));
    bench.pass();
    assert!(bench.core.out() && !bench.core.executed());
    assert!(bench.frame(&frame()));
}

#[test]
fn without_a_pass_nothing_is_staged() {
    let mut bench = Bench::without_pass();
    assert!(!bench.frame(&frame()));
    assert_eq!(bench.staged, []);
}

#[test]
fn a_frame_that_differs_in_one_bit_of_any_compared_word_is_not_executed() {
    for number in 0..18 {
        let free = match number {
            5 => 0x0000_4000 | 0xffff_0000,
            // The IP sum is not compared but must be right; without a UDP sum there is none.
            12 => u32::MAX,
            _ => 0,
        };
        for bit in 0..32 {
            let mut other = frame();
            other[number] ^= 1 << bit;
            if number == 5 {
                // As its host would have summed it.
                let sum = (4..9).map(|n| {
                    if n == 6 {
                        other[n] & 0xffff_0000
                    } else {
                        other[n]
                    }
                });
                let mut sum: u64 = sum.map(u64::from).sum();
                while sum >> 16 != 0 {
                    sum = (sum >> 16) + (sum & 0xffff);
                }
                other[6] = other[6] & 0xffff_0000 | !sum as u32 & 0xffff;
            }
            let mut bench = Bench::new();
            let executed = bench.frame(&other);
            assert_eq!(executed, free >> bit & 1 == 1, "word {number}, bit {bit}");
            if !executed && !matches!(number, 10) {
                assert_eq!(bench.staged, [], "word {number}, bit {bit}");
            }
            assert_eq!(bench.core.out(), !executed);
        }
    }
}

#[test]
fn a_wrong_sum_of_any_word_is_found() {
    for number in 9..frame().len() {
        for bit in [0, 15, 16, 31] {
            let mut other = summed(frame());
            other[number] ^= 1 << bit;
            assert!(!Bench::new().frame(&other), "word {number}, bit {bit}");
        }
    }
}

#[test]
fn a_longer_or_shorter_frame_is_not_executed() {
    let right = frame();
    let mut longer = right.clone();
    longer.push(0);
    assert!(!Bench::new().frame(&longer));
    for length in 1..right.len() {
        assert!(!Bench::new().frame(&right[..length]), "{length} words");
    }
}

#[test]
fn a_frame_with_a_wrong_fcs_or_a_part_of_a_word_is_not_executed() {
    for spoil in [
        |word: &mut Word| word.bad = word.last,
        |word: &mut Word| word.whole = false,
    ] {
        let mut bench = Bench::new();
        bench.words(whole(&frame()).map(|mut word| {
            spoil(&mut word);
            word
        }));
        assert!(!bench.behind());
        // It was the frame, not the pass.
        assert!(bench.frame(&frame()));
    }
}

#[test]
fn a_pass_taken_back_is_none() {
    let mut bench = Bench::new();
    bench.revoke();
    assert!(!bench.frame(&frame()));
    // Before any word, ...
    let words = frame();
    for at in 0..words.len() {
        let mut bench = Bench::new();
        bench.words(whole(&words).take(at));
        bench.revoke();
        bench.words(whole(&words).skip(at));
        assert!(!bench.behind(), "in front of word {at}");
    }
    // ... but behind the decision it was used.
    let mut bench = Bench::new();
    bench.words(whole(&words));
    bench.revoke();
    assert!(bench.behind() && bench.core.executed());
}

#[test]
fn a_pass_handed_out_within_a_frame_is_not_for_it() {
    let words = frame();
    for at in 1..words.len() {
        let mut bench = Bench::without_pass();
        bench.words(whole(&words).take(at));
        bench.pass();
        bench.words(whole(&words).skip(at));
        assert!(!bench.behind(), "in front of word {at}");
        assert!(bench.frame(&words));
    }
    // Nor is one that was out, taken back and handed out again.
    let mut bench = Bench::new();
    bench.words(whole(&words).take(9));
    bench.revoke();
    bench.pass();
    bench.words(whole(&words).skip(9));
    assert!(!bench.behind());
}

#[test]
fn the_gate_must_read_as_firmware_said_when_the_frame_has_ended() {
    for bit in 0..8 {
        let mut bench = Bench::new();
        bench.at_rest.gate_now ^= 1 << bit;
        assert!(!bench.frame(&frame()), "bit {bit}");
        bench.at_rest.gate_now = LIVE;
        assert!(bench.frame(&frame()));
    }
    let mut bench = Bench::new();
    bench.words(whole(&frame()));
    bench.at_rest.gate_now = 0;
    assert!(!bench.behind());
}

#[test]
fn a_frame_that_comes_while_a_timed_commit_waits_takes_the_long_way() {
    let mut bench = Bench::new();
    bench.at_rest.waiting = true;
    assert!(!bench.frame(&frame()));
    bench.at_rest.waiting = false;
    assert!(bench.frame(&frame()));
}

#[test]
fn a_frame_whose_answer_could_not_be_sent_is_not_executed() {
    let mut bench = Bench::new();
    bench.at_rest.free = false;
    assert!(!bench.frame(&frame()));
    assert!(bench.core.out());
}

#[test]
fn a_frame_that_begins_while_the_last_answer_is_gathered_takes_the_long_way() {
    let mut bench = Bench::new();
    bench.words(whole(&frame()));
    for _ in 0..4 {
        bench.clock(|_| {});
    }
    bench.pass();
    bench.words(whole(&frame()));
    assert!(!bench.behind());
    assert!(bench.frame(&frame()));
}

#[test]
fn bits_above_the_selection_of_a_latch_are_firmware_s() {
    for bit in 16..32 {
        let mut other = frame();
        other[23] |= 1 << bit;
        assert_eq!(Bench::new().frame(&other), bit < 21, "bit {bit}");
    }
}

#[test]
fn the_words_go_where_the_runs_say() {
    let mut bench = Bench::new();
    assert!(bench.frame(&frame()));
    let to = |page, word, count| (0..count).map(move |n| register(page, word + n));
    let registers = to(timebase::PAGE, timebase::COMMIT_AT_LO, 2)
        .chain(to(command::PAGE, command::ENABLES, 4))
        .chain(to(command::PAGE, command::STEPGEN0_VELOCITY, 6))
        .chain(to(command::PAGE, command::PWM0_WIDTH, 2));
    let staged: Vec<(u32, u32)> = registers.zip(18..).collect();
    assert_eq!(bench.staged, staged);
}

#[test]
fn it_commits_two_clocks_behind_the_last_word_once_and_as_the_pass_says() {
    let (executes, timed) = (fast_path::GATE_EXECUTES, fast_path::GATE_TIMED);
    for (how, commit, commit_timed) in [
        (executes, true, false),
        (executes | timed, false, true),
        (0, false, false),
        (timed, false, false),
    ] {
        let mut bench = Bench::new();
        bench.at_rest.condition = LIVE | how;
        assert!(bench.frame(&frame()));
        let taken: Vec<usize> = (0..)
            .zip(&bench.did)
            .filter(|(_, did)| did.taken)
            .map(|(n, _)| n)
            .collect();
        assert_eq!(taken, [1]);
        assert!(bench.did[0].take);
        assert_eq!(
            (bench.did[1].commit, bench.did[1].commit_timed),
            (commit, commit_timed)
        );
        let others = bench.did.iter().filter(|did| !did.taken);
        assert_eq!(
            others.filter(|did| did.commit || did.commit_timed).count(),
            0
        );
    }
}

#[test]
fn the_answer_is_gathered_as_the_runs_say() {
    let mut bench = Bench::new();
    bench.at_rest.select = 3;
    assert!(bench.frame(&frame()));
    let gathered = bench.did.iter().filter_map(|did| did.gathers);
    let at = bench.did.iter().filter_map(|did| did.puts);
    let answer: Vec<(usize, u32)> = at.zip(gathered).collect();
    let word = |word| register(status::PAGE, word);
    // The status block begins with the state; its words 1, 6 and 7 are the firmware's.
    let first = net::PAYLOAD_WORD + firmware::block::REPLY_OVERHEAD;
    let (arrival, latch) = (
        wire::exchange::status_word::ARRIVAL_LO,
        word(status::ENCODER0_LATCH + 3),
    );
    assert_eq!(answer[0], (first + arrival, word(status::SAMPLE_LO)));
    assert_eq!(answer[2], (first + arrival + 2, word(status::SAMPLE_LO)));
    assert!(answer.iter().any(|(_, from)| *from == latch));
    assert_eq!(answer.len(), shape().status - 4);
    let end = first + shape().status;
    assert_eq!(answer.last().map(|(at, _)| *at), Some(end - 1));
    // What is read is written a clock later.
    for pair in bench.did.windows(2) {
        assert_eq!(pair[0].gathers.is_some(), pair[1].puts.is_some());
    }
}

#[test]
fn the_cpu_waits_while_a_word_is_staged_decided_or_gathered_and_not_longer() {
    let mut bench = Bench::new();
    assert!(bench.frame(&frame()));
    for (n, did) in bench.did.iter().enumerate() {
        let works = n < 2 || did.gathers.is_some();
        assert_eq!(did.hold, works, "clock {n}");
    }
}

#[test]
fn a_reset_takes_the_pass_back_and_ends_an_answer() {
    let mut bench = Bench::new();
    bench.clock(|i| i.rst = true);
    assert!(!bench.core.out() && !bench.frame(&frame()));
    bench.pass();
    bench.words(whole(&frame()));
    for _ in 0..4 {
        bench.clock(|_| {});
    }
    bench.clock(|i| i.rst = true);
    bench.clock(|_| {});
    assert!(bench.core.quiet() && !bench.core.executed());
}
