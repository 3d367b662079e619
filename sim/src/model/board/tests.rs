use super::*;
use crate::stimulus::Chance;
use crate::stimulus::frames::Owner;
use proptest::prelude::*;
use rand::SeedableRng;
use rand_pcg::Pcg32;

const BUILD: Build = Build {
    channels: Channels {
        stepgens: 3,
        encoders: 2,
        pwms: 2,
        inputs: 40,
        outputs: 36,
    },
    clock_hz: 60_000,
    estop_mask: 8,
    estop_level: 8,
    abi: 1,
    version: 2,
    rom_words: 3,
    jobs: 2,
    readback: true,
};

/// Something a host, a firmware or a machine does, and how many clocks go by before it.
#[derive(Clone, Debug)]
enum Deed {
    Write(u32, u32, u32),
    Inputs(u64),
    Shaft(usize, u16),
    IndexPins(u16, u16, u16),
    Reset(bool),
    /// A whole segment.
    Segment([u32; 6]),
    /// A pass and an owner's frame, of this seed.
    Frame(u64),
}

fn word() -> impl Strategy<Value = u32> {
    (any::<u32>(), 0..32u32).prop_map(|(word, shift)| word >> shift)
}

fn deed() -> impl Strategy<Value = Deed> {
    let velocity = prop_oneof![
        Just(0),
        Just(i32::MAX),
        Just(-i32::MAX),
        -1000..1000,
        -4_000_000..4_000_000,
        -400_000_000..400_000_000
    ];
    let accel = prop_oneof![Just(0), Just(u32::MAX), 1..1000u32, 1..50_000_000u32];
    let time = prop_oneof![Just(0), Just(1), 0..40u32, 0..2000u32];
    let key = prop_oneof![
        6 => Just(regmap::watchdog::CONTROL_KEY_ARM),
        2 => Just(regmap::watchdog::CONTROL_KEY_CLEAR),
        1 => Just(regmap::watchdog::CONTROL_KEY_SOFT),
        1 => Just(regmap::watchdog::CONTROL_KEY_STOP)
    ];
    let command = pages::COMMAND;
    prop_oneof![
        3 => (0..3u32, velocity).prop_map(move |(n, v)| Deed::Write(command, 4 + 2 * n, v as u32)),
        2 => (0..3u32, accel.clone()).prop_map(move |(n, a)| Deed::Write(command, 5 + 2 * n, a)),
        2 => (0..2u32, 0..600u32, any::<bool>(), any::<u8>()).prop_map(move |(n, w, dir, part)| {
            Deed::Write(command, 36 + n, w << 8 | u32::from(part) | 1 << 30 | u32::from(dir) << 31)
        }),
        2 => (0..4u32, any::<u32>()).prop_map(move |(w, bits)| Deed::Write(command, w, bits | 7)),
        1 => any::<u32>().prop_map(move |bits| Deed::Write(command, 52, bits)),
        1 => (1..3u32, any::<u32>()).prop_map(|(w, bits)| Deed::Write(pages::GPIO_HIGH, w, bits)),
        6 => prop_oneof![Just(1u32), Just(2), Just(3), Just(4), Just(6)]
            .prop_map(|s| Deed::Write(pages::TIMEBASE, 7, s)),
        1 => (0..2u32, 0..3000u32).prop_map(|(w, at)| Deed::Write(pages::TIMEBASE, 6 - w, at * w)),
        1 => prop_oneof![Just(0), Just(regmap::timebase::GUARD_KEY_OPEN)]
            .prop_map(|word| Deed::Write(pages::TIMEBASE, regmap::timebase::GUARD as u32, word)),
        2 => key.prop_map(|key| Deed::Write(pages::WATCHDOG, 3, key)),
        3 => word().prop_map(|token| Deed::Write(pages::WATCHDOG, 2, token)),
        1 => (0..2u32, 0..20_000u32).prop_map(|(w, t)| Deed::Write(pages::WATCHDOG, w, t)),
        3 => (0..3u32, 0..4u32, time).prop_map(|(n, w, t)| Deed::Write(pages::STEPGEN + n, w, t)),
        1 => (0..3u32, accel).prop_map(|(n, a)| Deed::Write(pages::STEPGEN + n, 4, a)),
        1 => (0..3u32, 0..32u32).prop_map(|(n, mode)| Deed::Write(pages::STEPGEN + n, 5, mode)),
        1 => (0..2u32, 0..256u32).prop_map(|(n, mode)| Deed::Write(pages::ENCODER + n, 0, mode)),
        1 => (0..2u32, 0..256u32, 0..8u32).prop_map(|(n, f, less)| Deed::Write(pages::ENCODER + n, 1, f >> less)),
        1 => (0..2u32, 0..800u32).prop_map(|(n, period)| Deed::Write(pages::PWM + n, 0, period)),
        1 => (0..2u32, 0..32u32).prop_map(|(n, mode)| Deed::Write(pages::PWM + n, 1, mode)),
        1 => (1..3u32, 0..16u32).prop_map(|(w, bits)| Deed::Write(pages::GPIO, w, bits)),
        1 => (0..4u32, 0..4u32).prop_map(|(n, how)| Deed::Write(pages::GPIO, 7, n | how << 8)),
        1 => (0..4u32, 0..9u32).prop_map(|(n, limit)| Deed::Write(pages::DEBOUNCE, n, limit)),
        1 => (30..41u32, 0..9u32).prop_map(|(n, limit)| Deed::Write(pages::DEBOUNCE, n, limit)),
        1 => (0..8u32).prop_map(|pattern| Deed::Write(pages::LED, 0, pattern)),
        2 => (18..22u32, word()).prop_map(|(w, data)| Deed::Write(pages::SEGMENTS, w, data)),
        1 => Just(Deed::Write(pages::SEGMENTS, 18, 0x1_0000)),
        2 => (1..4u32).prop_map(|order| Deed::Write(pages::SEGMENTS, 17, order)),
        3 => (64..400u32, any::<u32>(), (-400_000_000..400_000_000i32), word(), any::<bool>()).prop_map(|(clocks, aux, v, a, last)| {
            Deed::Segment([clocks, aux, if last { 0 } else { v as u32 }, a, if last { 0 } else { !v as u32 >> 4 }, a >> 3])
        }),
        2 => (0..8u64, any::<u8>()).prop_map(|(low, high)| Deed::Inputs(low | u64::from(high) << 32)),
        8 => (0..2usize, 0..4u16).prop_map(|(n, phase)| Deed::Shaft(n, phase)),
        2 => (0..4u16, 0..4u16, 0..8u16).prop_map(|(i, m, s)| Deed::IndexPins(i, m, s)),
        1 => prop_oneof![9 => Just(false), 1 => Just(true)].prop_map(Deed::Reset),
        4 => any::<u64>().prop_map(Deed::Frame),
        1 => Just(Deed::Write(pages::FAST_PATH, 21, 1)),
    ]
}

fn registers() -> impl Iterator<Item = (u32, u32)> {
    let wide = (8..16).flat_map(|page| (0..120).map(move |word| (page, word)));
    let wide = wide.chain((0..30).map(|word| (pages::SEGMENTS, word)));
    let wide = wide.chain((0..5).map(|word| (pages::PADS, word)));
    let wide = wide.chain((0..5).map(|word| (pages::GPIO_HIGH, word)));
    let wide = wide.chain((0..23).map(|word| (pages::FAST_PATH, word)));
    let wide = wide.chain((0..19).map(|word| (pages::RX_ADMISSION, word)));
    wide.chain((16..64).flat_map(|page| (0..6).map(move |word| (page, word))))
}

/// A write on the bus of both, and the two clocks that it takes.
fn write_both(slow: &mut Board, fast: &mut Board, page: u32, word: u32, data: u32) {
    for board in [&mut *slow, &mut *fast] {
        board.order(page, word, data);
    }
    let until = slow.clocks() + 2;
    while slow.clocks() < until {
        slow.clock(&Bus::default());
    }
    while fast.clocks() < until {
        fast.run(until);
    }
}

#[test]
fn a_frame_with_a_pass_is_committed_sampled_and_fed_in_one_clock_and_answered_from_that_sample() {
    let mut board = Board::new(Build {
        estop_mask: 0,
        ..BUILD
    });
    let mut owner = Owner::new(BUILD.channels);
    let random = &mut Pcg32::seed_from_u64(1);
    let spend = |board: &mut Board, clocks| {
        let until = board.clocks() + clocks;
        while board.clocks() < until {
            board.run(until);
        }
    };
    let (page, word) = (pages::WATCHDOG, regmap::watchdog::TIMEOUT as u32);
    board.set(page, word, 10_000);
    for key in [
        regmap::watchdog::CONTROL_KEY_CLEAR,
        regmap::watchdog::CONTROL_KEY_ARM,
    ] {
        spend(&mut board, 10);
        board.order(page, regmap::watchdog::CONTROL as u32, key);
    }
    spend(&mut board, 2);
    let mut executed = 0;
    for (page, word, data) in owner.prepare(0) {
        board.order(page, word, data);
        spend(&mut board, 2);
    }
    for _ in 0..40 {
        let status = regmap::watchdog::STATUS as u32;
        let gate = board.read(page, status);
        for (page, word, data) in owner.hand_out(random, gate) {
            board.order(page, word, data);
            spend(&mut board, 2);
        }
        // Done with before the next frame.
        let at = board.clocks() + 100;
        let frame = owner.frame(random, at);
        let (words, before) = (frame.clone(), board.clocks());
        if !board.hear(frame) {
            spend(&mut board, 200);
            continue;
        }
        executed += 1;
        spend(&mut board, 2);
        // Taken in the clock that begins one behind the last word's.
        assert_eq!(board.sample, before + 1);
        assert_eq!(board.read(page, regmap::watchdog::REMAINING as u32), 10_000);
        let commits = board.regs.condition >> 8 == 1;
        if commits {
            assert_eq!(board.regs.enables_now, words[20].data);
        }
        spend(&mut board, 200);
        let first = 11 + 4;
        let answer = board.answer()[first..].to_vec();
        assert_eq!(answer[4], (before + 1) as u32);
        assert_eq!(answer[6], board.left_caught);
        assert_eq!(answer[10], board.gpio_caught[0]);
        assert_eq!(answer.last(), Some(&board.gpio_caught[1]));
        // Nothing is sampled meanwhile.
        let words = [
            regmap::status::STEPGEN0_POSITION_LO,
            regmap::status::ENCODER0_COUNT,
        ];
        assert_eq!(
            [answer[15], answer[24]],
            words.map(|word| board.status(word))
        );
    }
    assert!(executed > 10, "{executed}");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(150))]

    #[test]
    fn from_event_to_event_is_the_same_as_clock_by_clock(
        story in prop::collection::vec((prop_oneof![0..4u64, 0..200u64, 0..3000u64], deed()), 1..100)
    ) {
        let (mut slow, mut fast) = (Board::new(BUILD), Board::new(BUILD));
        let mut pins = Pins::default();
        let mut owner = Owner::new(BUILD.channels);
        for (page, word, data) in owner.prepare(3) {
            write_both(&mut slow, &mut fast, page, word, data);
        }
        let mut made = 0;
        for (wait, deed) in &story {
            // Two clocks at least, as the bus has them between two writes.
            let until = slow.clocks() + wait + 2;
            while fast.clocks() < until {
                let changed = fast.run(until);
                while slow.clocks() < fast.clocks() {
                    let before = slow.out;
                    let last = slow.clocks() + 1 == fast.clocks();
                    slow.clock(&Bus::default());
                    made += 1;
                    prop_assert!(last || slow.out == before, "clock {}: a change was skipped", slow.clocks());
                }
                prop_assert_eq!(&slow.out, &fast.out, "clock {}, changed {}", slow.clocks(), changed);
            }
            match *deed {
                Deed::Write(page, word, data) => {
                    slow.order(page, word, data);
                    fast.order(page, word, data);
                }
                Deed::Inputs(levels) => pins.gpio_in = levels,
                Deed::Shaft(n, phase) => {
                    put(&mut pins.enc_a, n, phase & 1 != 0);
                    put(&mut pins.enc_b, n, phase & 2 != 0);
                }
                Deed::IndexPins(index, mask, step) => {
                    (pins.enc_i, pins.enc_mask, pins.step_index) = (index, mask, step);
                }
                Deed::Reset(on) => pins.ext_reset = on.into(),
                Deed::Segment(words) => {
                    for (at, data) in (0..).zip(words).chain([(16, 0)]) {
                        write_both(&mut slow, &mut fast, pages::SEGMENTS, at, data);
                    }
                }
                Deed::Frame(seed) => {
                    let random = &mut Pcg32::seed_from_u64(seed);
                    if !random.one_in(8) {
                        let gate = slow.read(pages::WATCHDOG, regmap::watchdog::STATUS as u32);
                        for (page, word, data) in owner.hand_out(random, gate) {
                            write_both(&mut slow, &mut fast, page, word, data);
                        }
                    }
                    let at = slow.clocks() + u64::from(random.below(300));
                    let frame = owner.frame(random, at);
                    prop_assert_eq!(slow.hears(), fast.hears());
                    if slow.hears() {
                        let executed = slow.hear(frame.iter().copied());
                        prop_assert_eq!(executed, fast.hear(frame));
                    }
                }
            }
            slow.drive(&pins);
            fast.drive(&pins);
        }
        prop_assert_eq!(slow.answer(), fast.answer());
        for (page, word) in registers() {
            prop_assert_eq!(slow.read(page, word), fast.read(page, word), "page {} word {} after {} clocks", page, word, made);
        }
    }
}
