use super::*;
use crate::fake::{ABI, ALICE, BOOT, CLOCK, Change, EIGHT, Notebook, Rig};
use crate::machine::Machine;
use crate::session::Peer;
use proptest::prelude::*;
use wire::board;
use wire::crc::crc32;
use wire::describe::{BLOB_WORDS_AT, CHANNELS_AT, OBSTACLE_PINS, OBSTACLES_AT, address};
use wire::flash::{Op, PAGE, SECTOR};
use wire::pins::{LEVELS_AT, LINES_MAX, MAGIC, OUTPUTS_AT, ROUTE_WORDS, VERSION};
use wire::{MAX_WORDS, Refusal, State};

const PLATFORM: u32 = 7;
const SIZE: u32 = 0x40_0000;
/// Two step generators, an encoder, two PWMs.
const USED: u32 = 2 | 1 << 8 | 2 << 16;
/// What carries a line: its route, or none.
type Routed = (u8, u8);

fn to(words: &mut [u32], place: u8, route: u8) {
    let word = &mut words[usize::from(place / 4)];
    let mut bytes = word.to_le_bytes();
    bytes[usize::from(place % 4)] = route;
    *word = u32::from_le_bytes(bytes);
}

/// A configuration with these driven lines and these inputs.
fn head(driven: &[Routed], inputs: &[Routed]) -> Head {
    let mut words = [u32::from_le_bytes([NONE; 4]); HEAD_WORDS];
    words[..OUTPUTS_AT].fill(0);
    words[DRIVES_AT..INPUTS_AT].fill(0);
    words[LEVELS_AT..].fill(0);
    words[5..9].copy_from_slice(&[EIGHT.to_word(), PLATFORM, USED, 56 | 56 << 8]);
    for (line, route) in driven {
        to(&mut words[OUTPUTS_AT..], *line, *route);
        words[DRIVES_AT + usize::from(line / 32)] |= 1 << (line % 32);
    }
    for (sink, route) in inputs {
        to(&mut words[INPUTS_AT..], *sink, *route);
    }
    Head(words)
}

const DRIVEN: [Routed; 7] = [
    (0, 0),
    (1, 1),
    (2, EIGHT.pwm(0)),
    (3, (EIGHT.pwm(0) + 1) | INVERT),
    (4, EIGHT.own(4)),
    (5, EIGHT.enabled()),
    (40, EIGHT.own(40) | INVERT),
];

fn example() -> Head {
    let inputs = [
        (EIGHT.encoder(0), 8),
        (EIGHT.reset(), 9 | INVERT),
        (EIGHT.factory(), 11),
        (EIGHT.estop(0), 10),
    ];
    head(&DRIVEN, &inputs)
}

/// Board information with these entries.
fn description(entries: &[(u8, &[u8])]) -> Vec<u8> {
    let mut body = Vec::new();
    for (kind, value) in entries {
        body.extend([*kind, 0, value.len() as u8, 0]);
        body.extend(*value);
        body.resize(body.len().next_multiple_of(4), 0);
    }
    let length = (HEADER_LEN + body.len()) as u32;
    let words = [board::MAGIC, board::VERSION, length, crc32(&body)];
    [&words.map(u32::to_be_bytes).concat()[..], &body].concat()
}

/// That of the example, and what is left of it without channels.
const ENTRIES: [(u8, &[u8]); 5] = [
    (1, b"5a-75b"),
    (LIST, b"sx step=j1:0\ny"),
    (2, b"mill6"),
    (3, b"z"),
    (14, b"8.0"),
];
const FACTS: [(u8, &[u8]); 3] = [ENTRIES[0], ENTRIES[2], ENTRIES[4]];

fn words(bytes: &[u8]) -> Vec<u32> {
    let (words, _) = bytes.as_chunks();
    words.iter().map(|word| u32::from_be_bytes(*word)).collect()
}

/// The description as clients read it.
fn described(rig: &mut Rig) -> Vec<u32> {
    let count = rig.read(address(BLOB_WORDS_AT)).unwrap();
    let word = |n| rig.read(map::DESCRIBE_BLOB + 4 * n).unwrap();
    (0..count).map(word).collect()
}

/// As it lies in flash.
fn stored(head: &Head, generation: u32) -> Vec<u8> {
    described_as(head, generation, &ENTRIES)
}

/// With another description.
fn described_as(head: &Head, generation: u32, entries: &[(u8, &[u8])]) -> Vec<u8> {
    let description = description(entries);
    let mut words = head.0;
    let bytes = 4 * HEAD_WORDS + description.len();
    words[..3].copy_from_slice(&[MAGIC, VERSION, bytes as u32]);
    words[GENERATION_AT] = generation;
    words[9] = description.len() as u32;
    let words = words.map(u32::to_be_bytes).concat();
    let mut bytes = [&words[..], &description].concat();
    let crc = crc32(&bytes[16..]);
    bytes[12..16].copy_from_slice(&crc.to_be_bytes());
    bytes
}

fn layout() -> Layout {
    Layout::of(SIZE).unwrap()
}

/// An image's board with these copies in its flash.
fn board(copies: [Option<&[u8]>; 2]) -> Notebook {
    let mut board = Notebook::new();
    board.mux.ident = (u32::from(EIGHT.lines), PLATFORM);
    board.described = words(&description(&[(1, b"5a-75b"), (14, b"8.0")]));
    for (copy, bytes) in (0..).zip(copies) {
        board
            .chip
            .put(layout().pins_copy(copy).start, bytes.unwrap_or(&[]));
    }
    board
}

/// The board starts.
fn started(mut board: Notebook) -> Rig {
    board.mux.log.clear();
    let ident = Ident {
        abi: ABI,
        version: 0,
        clock_hz: CLOCK,
        channels: Channels {
            stepgens: 8,
            encoders: 8,
            pwms: 8,
            inputs: 56,
            outputs: 56,
        },
        features: FEATURE_PINS,
        blob_words: 3,
    };
    let Machine { board, server, .. } = Machine::start(board, ident, ABI, BOOT);
    Rig {
        server,
        board,
        sequence: 0,
    }
}

fn loaded(rig: &mut Rig) -> (Verdict, Option<u32>) {
    let word = rig.read(map::FLASH_PINS).unwrap();
    let Loaded { verdict, copy } = Loaded::from_word(word).unwrap();
    (verdict, copy)
}

/// The board has this verdict and no channels, and nothing is driven or routed.
fn assert_idle(rig: &mut Rig, verdict: Verdict) {
    assert_eq!(loaded(rig).0, verdict);
    assert_eq!(rig.server.ident().channels, Channels::default());
    assert_eq!(rig.board.mux.driven(), []);
    let mux = &rig.board.mux;
    for (_, word) in mux.out.iter().filter(|(at, _)| **at < ROUTE_WORDS) {
        assert_eq!(word.to_le_bytes(), [NONE; 4]);
    }
    assert!(
        mux.inputs
            .values()
            .all(|word| word.to_le_bytes() == [NONE; 4])
    );
    let obstacles = rig.read(address(OBSTACLES_AT)).unwrap();
    let wanted = if verdict.usable() { 0 } else { OBSTACLE_PINS };
    assert_eq!(obstacles, wanted, "{verdict}");
}

#[test]
fn a_board_has_the_channels_the_description_and_the_pins_of_its_configuration() {
    let mut rig = started(board([None, Some(&stored(&example(), 3))]));
    assert_eq!(loaded(&mut rig), (Verdict::InForce, Some(1)));
    assert_eq!(rig.board.mux.driven(), DRIVEN);
    assert_eq!(rig.read(address(CHANNELS_AT)), Ok(USED));
    assert_eq!(rig.read(address(CHANNELS_AT + 1)), Ok(56 | 56 << 8));
    assert_eq!(rig.read(address(OBSTACLES_AT)), Ok(0));
    assert_eq!(described(&mut rig), words(&description(&ENTRIES)));
    let third = map::CONFIG_STEPGEN + 2 * map::CONFIG_STRIDE;
    rig.acquire();
    assert_eq!(
        rig.write(third, 1),
        Err(Refusal::Unmapped),
        "no such channel"
    );
    assert_eq!(rig.write(third - map::CONFIG_STRIDE, 1), Ok(()));
    rig.arm();
}

#[test]
fn a_line_is_driven_only_behind_all_routes_and_levels() {
    let rig = started(board([Some(&stored(&example(), 1)), None]));
    let base = |base: usize, words: core::ops::Range<usize>| {
        words.map(move |word| regmap::address(base, word))
    };
    let lines = usize::from(EIGHT.lines) / 4;
    let sinks = usize::from(EIGHT.sinks()) / 4;
    let drives = base(pinmux_out::BASE, 40..44);
    let wanted: Vec<u32> = base(pinmux_in::BASE, 0..sinks)
        .chain(base(pinmux_out::BASE, 0..lines))
        .chain(base(pinmux_out::BASE, 32..40))
        .chain(drives)
        .collect();
    let log = &rig.board.mux.log;
    assert_eq!(log.iter().map(|(at, _)| *at).collect::<Vec<_>>(), wanted);
    let gate = rig
        .board
        .done
        .iter()
        .position(|it| *it == Change::Order(crate::cores::Control::Close));
    assert_eq!(gate, Some(0), "the gate is closed before");
}

#[test]
fn a_restart_lets_go_of_no_line_and_a_start_without_a_configuration_of_all() {
    let drives = |rig: &Rig| -> Vec<u32> {
        let first = regmap::address(pinmux_out::BASE, pinmux_out::DRIVES0);
        let log = rig.board.mux.log.iter();
        log.filter(|(at, _)| *at == first)
            .map(|(_, word)| *word)
            .collect()
    };
    let rig = started(board([Some(&stored(&example(), 1)), None]));
    let all = drives(&rig);
    assert_eq!(all.len(), 1);
    let rig = started(rig.board);
    assert_eq!(drives(&rig), all, "the same once more, and never 0");
    let mut board = rig.board;
    board.factory = true;
    assert_eq!(drives(&started(board)), [0]);
}

#[test]
fn a_pwm_that_was_inverted_rests_high_behind_a_restart_and_not_with_another_file() {
    let modes = [
        Setting::Stepgen(0, StepgenConfig::Mode),
        Setting::PwmMode(0),
        Setting::PwmMode(7),
    ];
    let told = |rig: &mut Rig| modes.map(|mode| rig.board.setting(mode));
    let high = |rig: &Rig| bit(rig, pinmux_out::SAFE0, 2);
    let other = described_as(&example(), 2, &[ENTRIES[0], (LIST, b"sx step=j1:0\nx")]);

    let mut rig = started(board([Some(&stored(&example(), 1)), None]));
    for mode in modes {
        rig.board.set(mode, map::PWM_INVERT);
    }
    let mut rig = started(rig.board);
    assert_eq!((told(&mut rig), high(&rig)), ([map::PWM_INVERT; 3], true));
    let mut board = rig.board;
    board.chip.put(layout().pins_copy(1).start, &other);
    let mut rig = started(board);
    assert_eq!(loaded(&mut rig), (Verdict::InForce, Some(1)));
    assert_eq!((told(&mut rig), high(&rig)), ([0; 3], false));
}

#[test]
fn without_a_configuration_a_board_drives_nothing_and_has_no_channels() {
    let mut rig = started(board([None, None]));
    assert_idle(&mut rig, Verdict::Missing);
    assert_eq!(loaded(&mut rig).1, None);
}

#[test]
fn what_an_earlier_start_wrote_is_overwritten_and_only_facts_of_the_card_stay() {
    let mut rig = started(board([Some(&stored(&example(), 1)), None]));
    assert_eq!(loaded(&mut rig), (Verdict::InForce, Some(0)));
    rig.board.chip.put(layout().pins_copy(0).start, &[0]);
    let mut rig = started(rig.board);
    assert_idle(&mut rig, Verdict::Missing);
    assert_eq!(described(&mut rig), words(&description(&FACTS)));
    let mut rig = started(rig.board);
    assert_eq!(described(&mut rig), words(&description(&FACTS)), "again");
    // One that is none: whatever it says of its lengths, nothing behind it is written.
    for length in [0, 20, 0x1000, u32::MAX] {
        rig.board.described = (0..1024).map(|n| 0x01ff_ff00 + n).collect();
        rig.board.described[BLOB_LENGTH_AT] = length;
        rig = started(rig.board);
        assert_eq!(rig.board.described.len(), 1024);
    }
}

#[test]
fn a_held_factory_pin_leaves_the_configuration_alone() {
    let mut held = board([Some(&stored(&example(), 1)), None]);
    held.factory = true;
    let mut rig = started(held);
    assert_idle(&mut rig, Verdict::FactoryPin);
    assert_eq!(loaded(&mut rig).1, Some(0));
    rig.board.factory = false;
    assert_eq!(loaded(&mut started(rig.board)).0, Verdict::InForce);
}

#[test]
fn a_factory_pin_on_a_line_counts_before_anything_is_driven() {
    let mut held = board([Some(&stored(&example(), 1)), None]);
    held.mux.factory_line = true;
    let mut rig = started(held);
    assert_idle(&mut rig, Verdict::FactoryPin);
    let driven = |(at, word): &(u32, u32)| {
        (*at as usize - pinmux_out::BASE) / 4 >= pinmux_out::DRIVES0 && *word != 0
    };
    let outputs = rig.board.mux.log.iter();
    let mut outputs = outputs.filter(|(at, _)| (*at as usize) < pinmux_in::BASE);
    assert!(!outputs.any(driven), "at no time");
    assert_eq!(
        rig.read(map::FLASH_ORIGIN),
        Ok(wire::flash::Origin::FactoryPin.code())
    );
}

#[test]
fn a_board_whose_pins_are_part_of_the_image_says_so() {
    let mut rig = Rig::new();
    assert_eq!(loaded(&mut rig), (Verdict::Fixed, None));
    let ident = *rig.server.ident();
    let mut machine = Machine::start(rig.board, ident, ABI, BOOT);
    assert_eq!(machine.server.ident(), &ident);
    assert_eq!(machine.board.mux.log, []);
    let mut reply = [0; MAX_WORDS];
    let ask = [0x4e6f_1044, 0, 0x000f_0001, 0x77, map::FLASH_PINS];
    let answer = machine.datagram(&ask, ALICE, &mut reply).unwrap();
    assert_eq!(answer[4], Verdict::Fixed.code());
}

#[test]
fn a_board_with_a_configuration_that_is_none_for_it_is_never_armed() {
    let changed = |word: usize, value: u32| {
        let mut head = example();
        head.0[word] = value;
        head
    };
    for (head, verdict) in [
        (changed(6, PLATFORM + 1), Verdict::Platform),
        (changed(5, 6), Verdict::Built),
        (changed(7, 9), Verdict::Counts),
        (head(&[(0, 4)], &[]), Verdict::Output),
        (head(&DRIVEN, &[(0, 3)]), Verdict::Input),
    ] {
        let mut rig = started(board([Some(&stored(&head, 1)), None]));
        assert_idle(&mut rig, verdict);
        assert_eq!(loaded(&mut rig).1, Some(0));
        rig.acquire();
        for request in [false, true, true, true] {
            let status = rig.exchange(true, request).unwrap();
            assert_eq!(status.state.state, State::Disarmed, "{verdict}");
        }
    }
}

#[test]
fn a_word_the_gateware_does_not_take_leaves_nothing_driven() {
    let bytes = stored(&example(), 1);
    let words = started(board([Some(&bytes), None])).board.mux.log.len();
    for takes in 0..words {
        let mut refusing = board([Some(&bytes), None]);
        refusing.mux.takes = Some(takes);
        let mut rig = started(refusing);
        assert_eq!(loaded(&mut rig), (Verdict::Refused, Some(0)), "{takes}");
        assert_eq!(rig.server.ident().channels, Channels::default());
        let last_drives = words - DRIVE_WORDS;
        if takes <= last_drives {
            assert_eq!(rig.board.mux.driven(), [], "{takes}");
        }
        assert_eq!(rig.read(address(OBSTACLES_AT)), Ok(OBSTACLE_PINS));
    }
}

#[test]
fn the_newest_whole_copy_is_in_force_also_when_the_count_wraps() {
    let first = stored(&example(), 0);
    for (a, b, newest) in [
        (1, 2, 1),
        (2, 1, 0),
        (u32::MAX, 0, 1),
        (0, u32::MAX, 0),
        (0x7fff_ffff, 0x8000_0000, 1),
        (5, 5, 0),
    ] {
        let (a, b) = (stored(&example(), a), stored(&head(&[], &[]), b));
        let mut rig = started(board([Some(&a), Some(&b)]));
        assert_eq!(loaded(&mut rig), (Verdict::InForce, Some(newest)));
        let wanted: &[Routed] = if newest == 0 { &DRIVEN } else { &[] };
        assert_eq!(rig.board.mux.driven(), wanted);
    }
    // A bad one that is newer is not replaced by an old one: that is not what was asked for.
    let bad = stored(&head(&[(0, 4)], &[]), 1);
    let mut rig = started(board([Some(&first), Some(&bad)]));
    assert_idle(&mut rig, Verdict::Output);
}

#[test]
fn a_copy_that_is_cut_or_damaged_at_any_byte_leaves_the_other_in_force() {
    let (old, new) = (stored(&head(&[], &[]), 1), stored(&example(), 2));
    let at = layout().pins_copy(1).start;
    let mut board = board([Some(&old), Some(&new)]);
    for byte in 0..new.len() {
        for cut in [true, false] {
            let mut damaged = new.clone();
            match cut {
                true => damaged[byte..].fill(0xff),
                false => damaged[byte] ^= 4,
            }
            if damaged == new {
                continue;
            }
            board.chip.put(at, &damaged);
            let mut rig = started(board);
            assert_eq!(
                loaded(&mut rig),
                (Verdict::InForce, Some(0)),
                "{byte} {cut}"
            );
            board = rig.board;
        }
    }
    let mut both = old;
    both[100] ^= 1;
    board.chip.put(layout().pins_copy(0).start, &both);
    assert_idle(&mut started(board), Verdict::Missing);
}

/// What a client does to write a copy: erase, then the pages, the first one last.
#[test]
fn after_every_step_of_a_write_the_old_or_the_new_is_in_force() {
    let (old, new) = (stored(&head(&[], &[]), 9), stored(&example(), 10));
    let mut rig = started(board([Some(&old), None]));
    let area = layout().pins_copy(1);
    // What a longer one before has left.
    rig.board.chip.put(area.start, &stored(&example(), 8));
    let mut steps: Vec<(Op, u32, &[u8])> = (area.start..area.end)
        .step_by(SECTOR as usize)
        .map(|at| (Op::EraseSector, at, &[][..]))
        .collect();
    let pages = (area.start..)
        .step_by(PAGE as usize)
        .zip(new.chunks(PAGE as usize));
    steps.extend(
        pages
            .map(|(at, page)| (Op::Program, at, page))
            .collect::<Vec<_>>()
            .into_iter()
            .rev(),
    );
    let last = steps.len() - 1;
    for (n, (op, at, page)) in steps.into_iter().enumerate() {
        for (address, word) in (map::FLASH_BUFFER..).step_by(4).zip(page.chunks(4)) {
            let word = u32::from_be_bytes(word.try_into().unwrap());
            rig.write(address, word).unwrap();
        }
        rig.write(map::FLASH_ADDRESS, at).unwrap();
        rig.write(map::FLASH_OP_LENGTH, page.len() as u32).unwrap();
        rig.write(map::FLASH_OP, op.code()).unwrap();
        while rig.server.flash.busy() {
            rig.server.poll_flash(&mut rig.board);
        }
        let result = rig.server.flash.word().result;
        assert_eq!(result, wire::flash::OpResult::Ok, "{op} at {at:x}");
        let mut again = started(rig.board.clone());
        let wanted = (Verdict::InForce, Some(u32::from(n == last)));
        assert_eq!(loaded(&mut again), wanted, "{op} at {at:x}");
    }
}

#[test]
fn the_pins_configuration_is_written_by_the_rules_of_images() {
    let mut rig = started(board([None, None]));
    let at = layout().pins_copy(0).start;
    rig.acquire();
    rig.write(map::FLASH_ADDRESS, at).unwrap();
    let stranger = Peer { ip: 1, port: 1 };
    let erase = Op::EraseSector.code();
    assert_eq!(
        rig.write_as(stranger, map::FLASH_OP, erase),
        Err(Refusal::NotOwner)
    );
    rig.arm();
    assert_eq!(rig.write(map::FLASH_OP, erase), Err(Refusal::Armed));
}

// Levels at rest.

/// The same in other words: safe level and `keeps` of a source, without its route's inversion.
fn plainly(board: &mut Notebook, line: u8, source: u8) -> (bool, bool) {
    for n in 0..8 {
        let mode = board.setting(Setting::Stepgen(n, StepgenConfig::Mode));
        let kind = StepType::from_code(mode >> 2 & 3).unwrap();
        if source == EIGHT.step(n) {
            return (mode & 1 != 0, kind == StepType::Quadrature);
        }
        if source == EIGHT.step(n) + 1 {
            return (mode & 2 != 0, kind != StepType::UpDown);
        }
        let mode = board.setting(Setting::PwmMode(n));
        let (invert, swap) = (mode & 1 != 0, mode & 16 != 0);
        let both = mode >> 1 & 3 == 1;
        if source == EIGHT.pwm(n) {
            return (invert && (!swap || both), false);
        }
        if source == EIGHT.pwm(n) + 1 {
            return (invert && (swap || both), false);
        }
    }
    if source != EIGHT.own(line) {
        return (false, false);
    }
    let [safe, invert] = match line {
        0..32 => [BoardConfig::GpioSafe, BoardConfig::GpioInvert],
        _ => [BoardConfig::GpioSafeHigh, BoardConfig::GpioInvertHigh],
    };
    let bit = |board: &mut Notebook, which| board.setting(Setting::Board(which)) >> (line % 32) & 1;
    (bit(board, safe) != bit(board, invert), false)
}

/// The word of the multiplexer with the bit of this line.
fn bit(rig: &Rig, first: usize, line: u8) -> bool {
    rig.board.mux.out[&(first + usize::from(line / 32))] >> (line % 32) & 1 != 0
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    #[test]
    fn levels_at_rest_are_those_of_the_cores(
        routes in proptest::collection::vec(0u8..128, 56),
        inverted: u64,
        modes in proptest::collection::vec((0u32..4, 0u32..3, 0u32..4, 0u32..3), 8),
        gpio: [u32; 4],
    ) {
        let mut board = board([None, None]);
        for (n, (step, kind, pwm, pwm_kind)) in (0..).zip(modes) {
            board.set(Setting::Stepgen(n, StepgenConfig::Mode), step | kind << 2);
            let mode = pwm & 1 | pwm_kind << 1 | (pwm >> 1) << 4;
            board.set(Setting::PwmMode(n), mode);
        }
        for (which, value) in [
            BoardConfig::GpioSafe, BoardConfig::GpioInvert,
            BoardConfig::GpioSafeHigh, BoardConfig::GpioInvertHigh,
        ].into_iter().zip(gpio) {
            board.set(Setting::Board(which), value);
        }
        let mut outputs = [0; ROUTE_WORDS];
        let inverts = |line: u8| inverted >> line & 1 != 0;
        for (line, source) in (0u8..).zip(&routes) {
            to(&mut outputs, line, source | if inverts(line) { INVERT } else { 0 });
        }
        let found = levels(&mut board, EIGHT, &outputs);
        for (line, source) in (0u8..).zip(routes) {
            let (level, keeps) = plainly(&mut board, line, source);
            let at = |first: usize| found[first + usize::from(line / 32)] >> (line % 32) & 1 != 0;
            prop_assert_eq!(at(0), level != inverts(line), "level of {}, {}", line, source);
            prop_assert_eq!(at(4), keeps, "{} keeps {}", line, source);
        }
        prop_assert_eq!([found[2], found[3], found[6], found[7]], [0; 4], "no such lines");
        prop_assert_eq!(found[1] >> 24 | found[5] >> 24, 0);
    }
}

#[test]
fn dir_and_quadrature_lines_keep_their_level_and_step_does_not() {
    let mut rig = started(board([Some(&stored(&example(), 1)), None]));
    let keeps = |rig: &Rig| [0, 1, 2, 4].map(|line| bit(rig, pinmux_out::KEEPS0, line));
    assert_eq!(keeps(&rig), [false, true, false, false]);
    rig.acquire();
    let mode = map::CONFIG_STEPGEN + 4 * StepgenConfig::Mode as u32;
    for (kind, wanted) in [
        (StepType::Quadrature, [true, true, false, false]),
        (StepType::UpDown, [false; 4]),
        (StepType::StepDir, [false, true, false, false]),
    ] {
        rig.write(mode, (kind as u32) << 2).unwrap();
        assert_eq!(keeps(&rig), wanted, "{kind:?}");
    }
}

#[test]
fn levels_at_rest_follow_the_settings_and_are_written_only_if_they_change() {
    let mut rig = started(board([Some(&stored(&example(), 1)), None]));
    rig.acquire();
    let safe = |rig: &Rig, line| bit(rig, pinmux_out::SAFE0, line);
    assert_eq!([0, 3, 40].map(|line| safe(&rig, line)), [false, true, true]);
    let raw = |setting: Setting| setting.address() as u32;
    let mode = map::CONFIG_STEPGEN + 4 * StepgenConfig::Mode as u32;
    let board_word = |which: BoardConfig| map::CONFIG_BOARD + 4 * which as u32;
    for (address, value, line, wanted) in [
        (mode, 1, 0, true),
        (raw(Setting::Stepgen(0, StepgenConfig::Mode)), 0, 0, false),
        (map::CONFIG_PWM + 4, 1, 2, true),
        (raw(Setting::PwmMode(0)), 1 | 16, 3, false),
        (board_word(BoardConfig::GpioSafe), 1 << 4, 4, true),
        (board_word(BoardConfig::GpioInvert), 1 << 4, 4, false),
        (board_word(BoardConfig::GpioSafeHigh), 1 << 8, 40, false),
        (
            raw(Setting::Board(BoardConfig::GpioInvertHigh)),
            1 << 8,
            40,
            true,
        ),
    ] {
        rig.board.mux.log.clear();
        rig.write(address, value).unwrap();
        assert_eq!(safe(&rig, line), wanted, "{address:x} {value:x}");
        assert_eq!(rig.board.mux.log.len(), LEVEL_WORDS);
        rig.board.mux.log.clear();
        rig.write(address, value).unwrap();
        assert_eq!(rig.board.mux.log, [], "again");
    }
    rig.arm();
    assert_eq!(rig.write(mode, 1), Err(Refusal::Armed));
    assert_eq!(rig.write(map::CONFIG_PWM, 600), Ok(()), "a period");
    assert_eq!(rig.board.mux.log, []);
}

#[test]
fn outputs_rest_at_the_levels_of_the_configuration_before_a_host_is_there() {
    let mut head = example();
    // An output of each word is safe high, and inverted in the second.
    head.0[LEVELS_AT..].copy_from_slice(&[1 << 4, 1 << 8, 0, 1 << 8]);
    let mut rig = started(board([Some(&stored(&head, 1)), None]));
    let safe = |rig: &Rig, line| bit(rig, pinmux_out::SAFE0, line);
    // The route of line 40 inverts once more.
    assert_eq!([4, 40].map(|line| safe(&rig, line)), [true, true]);
    let read = |rig: &mut Rig, which| rig.board.setting(Setting::Board(which));
    assert_eq!(read(&mut rig, BoardConfig::GpioSafe), 1 << 4);
    assert_eq!(read(&mut rig, BoardConfig::GpioInvertHigh), 1 << 8);
}

#[test]
fn a_board_whose_levels_at_rest_were_refused_is_not_armed() {
    let mut rig = started(board([Some(&stored(&example(), 1)), None]));
    rig.acquire();
    rig.board.mux.takes = Some(0);
    let mode = map::CONFIG_STEPGEN + 4 * StepgenConfig::Mode as u32;
    rig.write(mode, 1).unwrap();
    assert_eq!(loaded(&mut rig).0, Verdict::Refused);
    assert_eq!(rig.read(address(OBSTACLES_AT)), Ok(OBSTACLE_PINS));
    for request in [false, true, true, true] {
        let status = rig.exchange(true, request).unwrap();
        assert_eq!(status.state.state, State::Disarmed);
    }
}

// Any configuration at all.

/// A configuration, most often legal: lines and inputs by chance, and some words changed.
fn any_head() -> impl Strategy<Value = Head> {
    let routed = || proptest::collection::vec((0u8..60, any::<u8>()), 0..12);
    let change = (5usize..HEAD_WORDS, any::<u32>());
    let changes = proptest::collection::vec(change, 0..2);
    (routed(), routed(), 0u8..4, changes).prop_map(|(driven, inputs, tame, changes)| {
        let source = |(line, route): Routed| match tame {
            // Sources that are used, lines that are there.
            0 => (line, route),
            _ => (
                line % 50,
                [route & 0x83, EIGHT.own(line % 50), 32 | route & 0x81][route as usize % 3],
            ),
        };
        let driven: Vec<Routed> = driven.into_iter().map(source).collect();
        let mut inputs = inputs;
        if tame > 0 {
            inputs.retain_mut(|(sink, line)| {
                (*sink, *line) = (*sink % 48, *line % 56);
                driven.iter().all(|(other, _)| other != line)
            });
        }
        let mut head = head(&driven, &inputs);
        if tame < 2 {
            changes
                .into_iter()
                .for_each(|(word, value)| head.0[word] = value);
        }
        head
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(1600))]

    #[test]
    fn a_board_drives_what_a_legal_configuration_says_and_nothing_with_an_illegal_one(
        head in any_head(),
    ) {
        let bytes = stored(&head, 1);
        let mut rig = started(board([Some(&bytes), None]));
        let (verdict, _) = loaded(&mut rig);
        if verdict != Verdict::InForce {
            assert_idle(&mut rig, verdict);
            prop_assert!(!verdict.usable());
            let own = words(&description(&[(1, b"5a-75b"), (14, b"8.0")]));
            prop_assert_eq!(described(&mut rig), own);
            return Ok(());
        }
        let [stepgens, _, pwms, _] = head.channels()[0].to_le_bytes();
        let outputs = (head.channels()[1] >> 8) as u8;
        let driven = rig.board.mux.driven();
        for line in 0..LINES_MAX {
            let route = driven.iter().find(|(driven, _)| *driven == line);
            prop_assert_eq!(route.is_some(), head.driven(line));
            let Some((_, route)) = route else { continue };
            let source = route & SOURCE;
            prop_assert!(line < EIGHT.lines);
            let there = (0..stepgens).any(|n| [EIGHT.step(n), EIGHT.step(n) + 1].contains(&source))
                || (0..pwms).any(|n| [EIGHT.pwm(n), EIGHT.pwm(n) + 1].contains(&source))
                || [EIGHT.enabled(), EIGHT.heartbeat(), NONE].contains(&source)
                || line < outputs && source == EIGHT.own(line);
            prop_assert!(there, "line {} carries {}", line, source);
        }
        for sink in 0..EIGHT.sinks() {
            let word = rig.board.mux.inputs[&usize::from(sink / 4)];
            let line = word.to_le_bytes()[usize::from(sink % 4)] & SOURCE;
            let idle = driven.iter().all(|(driven, _)| *driven != line);
            prop_assert!(line == NONE || idle, "input {} listens to output {}", sink, line);
        }
    }
}
