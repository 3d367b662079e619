use super::*;
use crate::model::board::{Build, pages};
use crate::model::{Board, board::Bus};
use jobs::instruction::{Feed, Instruction};
use jobs::plan::{AxisSetup, Output, Planner, Setup};
use motion::segment::{AXES, Segment};
use proptest::prelude::*;
use std::collections::VecDeque;
use wire::describe::Channels;

fn board(times: [u32; 4]) -> Board {
    let mut board = Board::new(Build {
        channels: Channels {
            stepgens: 3,
            encoders: 0,
            pwms: 0,
            inputs: 0,
            outputs: 16,
        },
        clock_hz: 10_000_000,
        estop_mask: 0,
        estop_level: 0,
        abi: 0,
        version: 0,
        rom_words: 0,
        jobs: AXES as u8,
        readback: true,
    });
    for n in 0..3 {
        for (word, time) in (0..).zip(times) {
            write(&mut board, pages::STEPGEN + n, word, time);
        }
    }
    write(
        &mut board,
        pages::WATCHDOG,
        regmap::watchdog::TIMEOUT,
        u32::MAX,
    );
    write(
        &mut board,
        pages::WATCHDOG,
        regmap::watchdog::CONTROL,
        regmap::watchdog::CONTROL_KEY_CLEAR,
    );
    write(
        &mut board,
        pages::WATCHDOG,
        regmap::watchdog::CONTROL,
        regmap::watchdog::CONTROL_KEY_ARM,
    );
    write(
        &mut board,
        pages::TIMEBASE,
        regmap::timebase::STROBE,
        regmap::timebase::STROBE_COMMIT,
    );
    board
}

/// As the bus does it: an access every second clock.
fn write(board: &mut Board, page: u32, word: usize, data: u32) {
    board.order(page, word as u32, data);
    board.clock(&Bus::default());
    board.clock(&Bus::default());
}

fn start(board: &mut Board) {
    write(
        board,
        pages::SEGMENTS,
        segments::CONTROL,
        segments::CONTROL_COMMAND_START,
    );
}

fn push(board: &mut Board, segment: &Segment) {
    for (at, word) in (0..).zip(segment.words()) {
        write(board, pages::SEGMENTS, at, word);
    }
    write(board, pages::SEGMENTS, segments::PUSH, 0);
}

fn status(board: &Board) -> u32 {
    board.peek(pages::SEGMENTS, segments::STATUS as u32)
}

fn position(board: &mut Board, axis: u32) -> i64 {
    write(
        board,
        pages::TIMEBASE,
        regmap::timebase::STROBE,
        regmap::timebase::STROBE_SAMPLE,
    );
    for _ in 0..20 {
        board.clock(&Bus::default());
    }
    let at = 8 + 3 * axis;
    let low = u64::from(board.peek(pages::STATUS, at));
    (u64::from(board.peek(pages::STATUS, at + 1)) << 32 | low) as i64
}

fn setup() -> Setup {
    let axis = |steps_per_mm: u64, mm_per_s: u32, mm_per_s2: u64| AxisSetup {
        steps_per_km: steps_per_mm * 1_000_000,
        max_speed: mm_per_s * 1_000_000,
        max_accel: mm_per_s2 * 1_000_000,
    };
    Setup {
        clock_hz: 10_000_000,
        axes: [
            axis(80, 200, 8000),
            axis(100, 150, 6000),
            axis(400, 40, 2000),
        ],
        chord_tolerance: 5000,
        junction_deviation: 20_000,
        aux_settle: 0,
    }
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(4) })]

    /// A plan, pushed as words and played by the cores' models, ends at rest with every axis on
    /// the exact step and the exact fraction of it. This holds for any step timing (which may
    /// hold path time) and any number of pauses.
    #[test]
    fn a_planned_job_ends_exactly_where_the_planner_says(
        places in proptest::collection::vec((-1_000_000..1_000_000i64, -1_000_000..1_000_000i64, -200_000..200_000i64), 1..6),
        times in (1..20u32, 1..20u32, 1..60u32, 1..60u32),
        paces in proptest::collection::vec(prop_oneof![Just(0u32), Just(PACE_ONE), 20_000..PACE_ONE], 1..20),
    ) {
        let mut planner = Planner::<16>::new(&setup()).unwrap();
        let lines = places.iter().enumerate().flat_map(|(n, &(x, y, z))| {
            let line = Instruction::Line { to: [x, y, z], feed: Feed::Rate(100_000_000) };
            let tool = (n % 3 == 2).then_some(Instruction::Aux { bits: n as u16 });
            [Some(line), tool].into_iter().flatten()
        });
        let mut program = lines.chain([Instruction::End]).peekable();
        let mut segments = VecDeque::new();
        loop {
            while planner.accepts() && program.peek().is_some() {
                prop_assert!(planner.push(&program.next().unwrap(), 0));
            }
            match planner.poll() {
                Some(Output::Segment(segment)) => segments.push_back(segment),
                Some(Output::End) => break,
                _ => {}
            }
        }
        let all = segments.len() as u32;
        let mut board = board([times.0, times.1, times.2, times.3]);
        write(&mut board, pages::SEGMENTS, segments::SLEW, 1 << 20);
        let (mut started, mut paces, mut clocks) = (false, paces.iter().cycle(), 0u64);
        loop {
            let now = status(&board);
            if started && now >> 8 & 3 == 0 {
                prop_assert_eq!((now >> 12 & 7) as u8, reason::DONE);
                break;
            }
            if now & 0xff < 60 && let Some(segment) = segments.pop_front() {
                push(&mut board, &segment);
            } else if !started {
                start(&mut board);
                started = true;
            } else {
                for _ in 0..100 {
                    board.clock(&Bus::default());
                }
                clocks += 100;
                if clocks.is_multiple_of(20_000) {
                    let pace = *paces.next().unwrap();
                    // A pause ends some time.
                    let pace = if clocks.is_multiple_of(40_000) { PACE_ONE } else { pace };
                    write(&mut board, pages::SEGMENTS, segments::PACE, pace);
                }
            }
        }
        prop_assert_eq!(board.peek(pages::SEGMENTS, segments::BEGUN as u32), all);
        for axis in 0..AXES {
            prop_assert_eq!(position(&mut board, axis as u32), planner.machine().axes[axis].position, "axis {}", axis);
        }
        prop_assert!(planner.machine().rests());
    }
}

#[test]
fn an_underrun_brakes_and_says_so_and_nothing_starts_before_clear() {
    let mut board = board([1, 1, 1, 1]);
    for n in 0..3 {
        write(
            &mut board,
            pages::STEPGEN + n,
            regmap::stepgen::STOP_ACCEL,
            1 << 28,
        );
    }
    let segment = Segment {
        clocks: 2000,
        velocity: [1 << 16, -(1 << 15), 0],
        accel: [1 << 30; 3],
        ..Segment::default()
    };
    push(&mut board, &segment);
    push(&mut board, &segment);
    start(&mut board);
    let mut clocks = 0;
    while status(&board) >> 8 & 3 != 0 {
        board.clock(&Bus::default());
        clocks += 1;
    }
    assert!((4000..10_000).contains(&clocks), "{clocks} clocks");
    assert_eq!((status(&board) >> 12 & 7) as u8, reason::UNDERRUN);
    let rest = position(&mut board, 0);
    push(&mut board, &segment);
    start(&mut board);
    let refused = (status(&board) >> 16 & 31) as u8;
    assert_eq!(refused, refused::NOT_NOW | refused::START);
    for _ in 0..5000 {
        board.clock(&Bus::default());
    }
    assert_eq!(position(&mut board, 0), rest);
    write(
        &mut board,
        pages::SEGMENTS,
        segments::CONTROL,
        segments::CONTROL_COMMAND_CLEAR,
    );
    push(&mut board, &segment);
    start(&mut board);
    assert_eq!(status(&board) >> 8 & 3, State::Settle as u32);
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(48) })]

    /// [`Board::run`], which skips quiet clocks, and clock by clock: the same pins and
    /// registers at every look.
    #[test]
    fn many_clocks_of_a_segment_at_once_are_those_clocks_one_by_one(
        motions in proptest::collection::vec((64..5000u32, -(1i32 << 28)..1 << 28, -(1i32 << 26)..1 << 26, 0..4u16), 1..12),
        times in (1..20u32, 1..20u32, 1..60u32, 1..60u32),
        looks in proptest::collection::vec((1..900u64, 0..40u8), 20..200),
    ) {
        let (mut slow, mut fast) = (board([times.0, times.1, times.2, times.3]), board([times.0, times.1, times.2, times.3]));
        for board in [&mut slow, &mut fast] {
            write(board, pages::SEGMENTS, segments::SLEW, 1 << 20);
            write(board, pages::SEGMENTS, segments::MASK, 3);
            for (clocks, x, y, aux) in &motions {
                let segment = Segment { clocks: *clocks, velocity: [*x, *y, 0], accel: [1 << 24, 0, 1], aux: *aux, tag: 7 };
                push(board, &segment);
            }
            start(board);
        }
        for (clocks, deed) in looks {
            let until = slow.clocks() + clocks;
            while slow.clocks() < until {
                slow.clock(&Bus::default());
            }
            while fast.clocks() < until {
                fast.run(until);
            }
            prop_assert_eq!(slow.pins(), fast.pins(), "clock {}", until);
            for word in 22..27 {
                prop_assert_eq!(slow.peek(pages::SEGMENTS, word), fast.peek(pages::SEGMENTS, word), "word {} in clock {}", word, until);
            }
            // Now and then a pause, a stop, another segment.
            let (word, data) = match deed {
                0 | 1 => (18, 0),
                2..6 => (18, PACE_ONE),
                6 => (18, PACE_ONE / 3),
                7 => (17, 2),
                8 => (17, 3),
                9..14 => (16, 0),
                _ => continue,
            };
            for board in [&mut slow, &mut fast] {
                if word == 16 {
                    push(board, &Segment { clocks: 700, velocity: [1 << 25, 0, 0], accel: [1 << 22, 0, 1], aux: 1, tag: 8 });
                } else {
                    write(board, pages::SEGMENTS, word, data);
                }
            }
        }
    }
}
