use super::*;
use crate::fake::{ALICE, BOB, Chip, Rig};
use wire::images::Stub;
use wire::{Name, Refusal, crc};

const CLOCK: u32 = 60_000_000;
const FPGA: u32 = 0x4111_1043;

fn started(chip: &mut Chip) -> Flash {
    let mut flash = Flash::new();
    flash.find(chip, Trailer::NONE);
    flash.start(chip, Some(FPGA), Settings::default(), false);
    flash
}

/// Runs the started operation to its end.
fn finish(flash: &mut Flash, chip: &mut Chip) -> OpResult {
    let mut slices = 0;
    while flash.busy() {
        flash.poll(chip, slices * 60_000, CLOCK);
        slices += 1;
        assert!(slices < 100_000, "the operation does not end");
    }
    flash.word().result
}

fn run(flash: &mut Flash, chip: &mut Chip, op: Op, address: u32, length: u32) -> OpResult {
    flash.write_word(chip, map::FLASH_ADDRESS, address);
    flash.write_word(chip, map::FLASH_OP_LENGTH, length);
    flash.write_word(chip, map::FLASH_OP, op.code());
    finish(flash, chip)
}

fn fill(flash: &mut Flash, chip: &mut Chip, words: &[u32]) {
    for (address, word) in (map::FLASH_BUFFER..).step_by(4).zip(words) {
        flash.write_word(chip, address, *word);
    }
}

fn save(flash: &mut Flash, chip: &mut Chip, settings: &Settings) -> OpResult {
    fill(flash, chip, &settings.to_words());
    run(flash, chip, Op::SaveSettings, 0, 0)
}

/// An image of this many bytes in a slot.
fn image(chip: &mut Chip, slot: Slot, length: u32, build_id: u32) {
    let layout = Layout::of(chip.cells.len() as u32).unwrap();
    let area = layout.slot(slot);
    let bytes: Vec<u8> = (0..length).map(|n| (n * 7 + build_id) as u8).collect();
    let meta = Meta {
        length,
        crc: crc::crc32(&bytes),
        build_id,
        idcode: FPGA,
        configuration: Name::new("mill6").unwrap(),
        platform: Name::EMPTY,
    };
    chip.put(area.start, &bytes);
    chip.put(area.meta(), &meta.to_page());
}

/// The slot that the FPGA loads: it takes the first preamble.
fn loads(chip: &Chip) -> Option<u32> {
    let stubs = &chip.cells[..2 * SECTOR as usize];
    let at = stubs.windows(2).position(|pair| pair == [0xbd, 0xb3])?;
    let page = &stubs[at - Stub::SWITCH_AT..];
    Some(
        Stub::from_page(page)
            .expect("a preamble with nothing behind it")
            .target,
    )
}

#[test]
fn the_chip_is_known_by_its_ids() {
    let mut chip = Chip::new(0x40_0000);
    let flash = started(&mut chip);
    assert_eq!(flash.jedec(), 0xef_4016);
    assert_eq!(flash.uid(), [0x0102_0304, 0x0506_0708]);
    assert_eq!(flash.layout().unwrap().size, 0x40_0000);
    assert_eq!(flash.settings().mac[0], 2, "made from the unique id");
    assert!(chip.writes.is_empty(), "looking changes nothing");
}

#[test]
fn without_a_flash_every_operation_says_so() {
    let mut flash = Flash::new();
    flash.find(&mut NoFlash, Trailer::NONE);
    flash.start(&mut NoFlash, None, Settings::default(), false);
    assert_eq!((flash.jedec(), flash.uid()), (0, [0; 2]));
    for op in Op::ALL {
        flash.start_op(&mut NoFlash, *op);
        assert_eq!(flash.word().result, OpResult::NoFlash);
    }
    let mut chip = Chip::new(0x80_0000);
    let mut flash = started(&mut chip);
    assert_eq!(
        run(&mut flash, &mut chip, Op::Read, 0, 4),
        OpResult::Flash,
        "of an unknown size"
    );
}

#[test]
fn a_page_is_programmed_read_back_summed_up_and_erased() {
    for size in [0x20_0000, 0x40_0000] {
        let mut chip = Chip::new(size);
        let mut flash = started(&mut chip);
        let at = flash.layout().unwrap().slot_b.start;
        let words: Vec<u32> = (0..64).map(|n| n * 0x0101_0101).collect();
        fill(&mut flash, &mut chip, &words);
        assert_eq!(
            run(&mut flash, &mut chip, Op::Program, at, 256),
            OpResult::Ok
        );
        fill(&mut flash, &mut chip, &[0; 64]);
        assert_eq!(run(&mut flash, &mut chip, Op::Read, at, 256), OpResult::Ok);
        assert_eq!(
            flash.read_word(map::FLASH_BUFFER + 4 * 63),
            63 * 0x0101_0101
        );
        assert_eq!(run(&mut flash, &mut chip, Op::Crc, at, 1000), OpResult::Ok);
        let wanted = crc::crc32(&chip.cells[at as usize..][..1000]);
        assert_eq!(flash.read_word(map::FLASH_CRC), wanted);
        assert_eq!(
            run(&mut flash, &mut chip, Op::EraseSector, at, 0),
            OpResult::Ok
        );
        assert!(chip.cells.iter().all(|cell| *cell == 0xff));
        assert_eq!(
            run(&mut flash, &mut chip, Op::EraseBlock, at, 0),
            OpResult::Ok
        );
    }
}

#[test]
fn nothing_but_the_slot_that_is_not_selected_can_be_erased_or_programmed() {
    let mut chip = Chip::new(0x40_0000);
    image(&mut chip, Slot::A, 500, 1);
    let mut flash = started(&mut chip);
    assert_eq!(run(&mut flash, &mut chip, Op::Select, 1, 0), OpResult::Ok);
    chip.writes.clear();
    let layout = *flash.layout().unwrap();
    for address in [
        0,
        0x1000,
        0x2000,
        layout.slot_a.start,
        layout.slot_a.end - PAGE,
        layout.settings,
        layout.settings + SECTOR,
        0x20_0000,
        layout.golden.start,
        layout.golden.meta(),
        layout.jump_page(),
        0x40_0000,
        u32::MAX - 0xff,
        layout.slot_b.start + 1,
    ] {
        for op in [Op::EraseSector, Op::EraseBlock, Op::Program] {
            if op == Op::Program && address == layout.slot_b.start + 1 {
                continue; // inside, and a page may begin anywhere
            }
            assert_eq!(
                run(&mut flash, &mut chip, op, address, 256),
                OpResult::Address,
                "{op} {address:x}"
            );
        }
    }
    let b = layout.slot_b.start;
    assert_eq!(
        run(&mut flash, &mut chip, Op::Program, b + 1, 256),
        OpResult::Address,
        "two pages"
    );
    assert_eq!(
        run(&mut flash, &mut chip, Op::Program, b, 0),
        OpResult::Value
    );
    assert_eq!(
        run(&mut flash, &mut chip, Op::Program, b, 257),
        OpResult::Value
    );
    assert_eq!(
        run(&mut flash, &mut chip, Op::Read, 0, 257),
        OpResult::Value
    );
    assert_eq!(
        run(&mut flash, &mut chip, Op::Read, 0x40_0000, 1),
        OpResult::Address
    );
    assert_eq!(
        run(&mut flash, &mut chip, Op::Crc, 0x3f_ffff, 2),
        OpResult::Address
    );
    // The key is among the settings.
    let settings = flash.layout().unwrap().settings;
    for (address, length) in [
        (settings, 1),
        (settings - 1, 2),
        (settings + 0x1fff, 1),
        (settings - 4, 0x3000),
    ] {
        let length = length.min(256);
        for op in [Op::Read, Op::Crc] {
            let result = run(&mut flash, &mut chip, op, address, length);
            assert_eq!(result, OpResult::Address, "{op} {length} at {address:#x}");
        }
    }
    for address in [settings - 1, settings + 0x2000] {
        assert_eq!(
            run(&mut flash, &mut chip, Op::Read, address, 1),
            OpResult::Ok
        );
    }
    assert_eq!(
        run(&mut flash, &mut chip, Op::Select, 3, 0),
        OpResult::Value
    );
    assert!(chip.writes.is_empty());
}

#[test]
fn of_the_pins_configurations_only_the_one_that_is_not_the_newest_can_be_written() {
    let mut chip = Chip::new(0x40_0000);
    let mut flash = started(&mut chip);
    let layout = *flash.layout().unwrap();
    let ops = [Op::EraseSector, Op::Program];
    for (verdict, newest) in [
        (Verdict::Fixed, None),
        (Verdict::Missing, None),
        (Verdict::InForce, Some(0)),
        (Verdict::FactoryPin, Some(1)),
        (Verdict::Output, Some(1)),
    ] {
        flash.pins = Loaded {
            verdict,
            copy: newest,
        };
        for (copy, op) in [0, 1].into_iter().flat_map(|n| ops.map(|op| (n, op))) {
            let area = layout.pins_copy(copy);
            let wanted = match verdict == Verdict::Fixed || newest == Some(copy) {
                true => OpResult::Address,
                false => OpResult::Ok,
            };
            for at in [area.start, area.end - SECTOR] {
                let result = run(&mut flash, &mut chip, op, at, PAGE);
                assert_eq!(result, wanted, "{op} copy {copy}, {verdict}");
            }
            for op in [Op::Read, Op::Crc] {
                let result = run(&mut flash, &mut chip, op, area.start, PAGE);
                assert_eq!(result, OpResult::Ok, "{op} copy {copy}");
            }
        }
    }
    // Not a block, which is more than a copy; and neither neighbour.
    flash.pins.copy = None;
    for (op, at) in [
        (Op::EraseBlock, layout.pins_copy(0).start & !0xffff),
        (Op::EraseSector, layout.pins_copy(0).start - SECTOR),
        (Op::EraseSector, layout.pins_copy(1).end),
        (Op::Program, layout.pins_copy(1).end),
    ] {
        let result = run(&mut flash, &mut chip, op, at, PAGE);
        assert_eq!(result, OpResult::Address, "{op} at {at:x}");
    }
}

#[test]
fn a_chip_that_does_not_do_as_told_is_noticed() {
    let mut chip = Chip::new(0x40_0000);
    image(&mut chip, Slot::B, 500, 1);
    let mut flash = started(&mut chip);
    let at = flash.layout().unwrap().slot_b.start;
    chip.stuck = true;
    fill(&mut flash, &mut chip, &[0x1234_5678]);
    for op in [Op::EraseSector, Op::EraseBlock, Op::Program, Op::Protect] {
        assert_eq!(
            run(&mut flash, &mut chip, op, at, 4),
            OpResult::Flash,
            "{op}"
        );
    }
    assert_eq!(
        save(&mut flash, &mut chip, &Settings::default()),
        OpResult::Flash
    );
    assert_eq!(
        run(&mut flash, &mut chip, Op::Select, 2, 0),
        OpResult::Flash
    );
}

#[test]
fn a_chip_that_stays_busy_is_given_up() {
    let mut chip = Chip::new(0x40_0000);
    let mut flash = started(&mut chip);
    let at = flash.layout().unwrap().slot_b.start;
    flash.write_word(&mut chip, map::FLASH_ADDRESS, at);
    flash.start_op(&mut chip, Op::EraseBlock);
    chip.looks = u32::MAX;
    assert!(!flash.poll(&mut chip, 1_000, CLOCK));
    assert!(!flash.poll(&mut chip, 4 * u64::from(CLOCK), CLOCK));
    assert!(flash.poll(&mut chip, 1_000 + 4 * u64::from(CLOCK), CLOCK));
    assert_eq!(flash.word().result, OpResult::Flash);
}

#[test]
fn settings_go_to_the_other_copy_and_the_newest_counts() {
    let mut chip = Chip::new(0x40_0000);
    let mut origins = Vec::new();
    for last in 1..6 {
        let mut flash = started(&mut chip);
        let settings = Settings {
            ip: 0x0a00_0000 + last,
            ..Settings::default()
        };
        assert_eq!(save(&mut flash, &mut chip, &settings), OpResult::Ok);
        let again = started(&mut chip);
        assert_eq!(again.settings().ip, 0x0a00_0000 + last);
        origins.push(again.origin());
    }
    use Origin::{Copy0, Copy1};
    assert_eq!(origins, [Copy0, Copy1, Copy0, Copy1, Copy0]);
}

#[test]
fn settings_that_are_saved_already_are_not_written_again() {
    let mut chip = Chip::new(0x40_0000);
    let mut flash = started(&mut chip);
    assert_eq!(
        save(&mut flash, &mut chip, &Settings::default()),
        OpResult::Ok
    );
    let writes = chip.writes.len();
    assert_eq!(
        save(&mut flash, &mut chip, &Settings::default()),
        OpResult::Ok
    );
    assert_eq!(chip.writes.len(), writes);
}

#[test]
fn the_key_is_kept_when_asked_and_never_shown() {
    let mut chip = Chip::new(0x40_0000);
    let mut flash = started(&mut chip);
    let secret = Settings {
        key: [1, 2, 3, 4],
        ..Settings::default()
    };
    save(&mut flash, &mut chip, &secret);
    let mut flash = started(&mut chip);
    let shown: Vec<u32> = (0..32)
        .map(|n| flash.read_word(map::FLASH_SETTINGS + 4 * n))
        .collect();
    let shown = Settings::parse(shown[..].try_into().unwrap()).unwrap();
    assert_eq!(shown.key, [0; 4]);
    let renamed = Settings {
        name: Name::new("lathe").unwrap(),
        keep_key: true,
        ..shown
    };
    assert_eq!(save(&mut flash, &mut chip, &renamed), OpResult::Ok);
    let flash = started(&mut chip);
    assert_eq!(
        (flash.settings().key, flash.settings().name.text()),
        ([1, 2, 3, 4], "lathe")
    );
}

#[test]
fn nonsense_is_not_saved() {
    let mut chip = Chip::new(0x40_0000);
    let mut flash = started(&mut chip);
    let mut words = Settings::default().to_words();
    words[4] = 0;
    fill(&mut flash, &mut chip, &words);
    assert_eq!(
        run(&mut flash, &mut chip, Op::SaveSettings, 0, 0),
        OpResult::Value
    );
    assert!(chip.writes.is_empty());
}

#[test]
fn forgotten_settings_are_gone_and_a_held_factory_pin_only_ignores_them() {
    let mut chip = Chip::new(0x40_0000);
    let mut flash = started(&mut chip);
    let settings = Settings {
        ip: 0x0a00_0009,
        ..Settings::default()
    };
    save(&mut flash, &mut chip, &settings);
    let mut held = Flash::new();
    held.find(&mut chip, Trailer::NONE);
    held.start(&mut chip, None, Settings::default(), true);
    assert_eq!(
        (held.settings().ip, held.origin()),
        (Settings::default().ip, Origin::FactoryPin)
    );
    assert_eq!(started(&mut chip).origin(), Origin::Copy0);
    assert_eq!(
        run(&mut flash, &mut chip, Op::ForgetSettings, 0, 0),
        OpResult::Ok
    );
    assert_eq!(started(&mut chip).origin(), Origin::BuiltIn);
}

#[test]
fn the_golden_image_can_be_protected_and_that_is_seen() {
    for size in [0x20_0000, 0x40_0000] {
        let mut chip = Chip::new(size);
        chip.status = 0x1c; // some boards are delivered like this: all of it
        let mut flash = started(&mut chip);
        assert!(!flash.protected());
        assert_eq!(run(&mut flash, &mut chip, Op::Protect, 0, 0), OpResult::Ok);
        assert!(flash.protected() && started(&mut chip).protected());
    }
}

#[test]
fn only_a_whole_image_for_this_fpga_is_selected() {
    let mut chip = Chip::new(0x40_0000);
    let mut flash = started(&mut chip);
    assert_eq!(
        run(&mut flash, &mut chip, Op::Select, 1, 0),
        OpResult::Image,
        "none"
    );
    image(&mut chip, Slot::A, 700, 5);
    let at = flash.layout().unwrap().slot_a.start as usize;
    chip.cells[at + 699] ^= 1;
    assert_eq!(
        run(&mut flash, &mut chip, Op::Select, 1, 0),
        OpResult::Image,
        "a bit fell over"
    );
    chip.cells[at + 699] ^= 1;
    let mut other = Flash::new();
    other.find(&mut chip, Trailer::NONE);
    other.start(&mut chip, Some(0x4111_2043), Settings::default(), false);
    assert_eq!(
        run(&mut other, &mut chip, Op::Select, 1, 0),
        OpResult::Image,
        "another FPGA"
    );
    assert!(chip.writes.is_empty());
    assert_eq!(run(&mut flash, &mut chip, Op::Select, 1, 0), OpResult::Ok);
    assert_eq!(
        (flash.selected(), loads(&chip)),
        (Some(Slot::A), Some(at as u32))
    );
}

#[test]
fn at_every_step_of_a_hundred_selections_the_old_slot_or_the_new_one_loads() {
    let mut chip = Chip::new(0x40_0000);
    image(&mut chip, Slot::A, 100, 1);
    image(&mut chip, Slot::B, 100, 2);
    let mut flash = started(&mut chip);
    assert_eq!(run(&mut flash, &mut chip, Op::Select, 1, 0), OpResult::Ok);
    let layout = *flash.layout().unwrap();
    let mut erases = 0;
    for n in 0..100 {
        let (old, new) = if n % 2 == 0 {
            (Slot::A, Slot::B)
        } else {
            (Slot::B, Slot::A)
        };
        let (old, target) = (layout.slot(old).start, layout.slot(new).start);
        flash.write_word(&mut chip, map::FLASH_ADDRESS, new.code());
        flash.start_op(&mut chip, Op::Select);
        let mut switched = false;
        while flash.busy() {
            flash.poll(&mut chip, 0, CLOCK);
            let now = loads(&chip).expect("something loads");
            switched |= now == target;
            assert_eq!(now, if switched { target } else { old }, "selection {n}");
            // A firmware that starts now sees the same.
            let seen = started(&mut chip.clone()).selected();
            assert_eq!(seen.map(|slot| layout.slot(slot).start), Some(now));
        }
        assert_eq!(flash.word().result, OpResult::Ok);
        assert!(switched, "selection {n}");
        erases += chip
            .writes
            .iter()
            .filter(|(command, _)| *command == 0x20)
            .count();
        chip.writes.clear();
    }
    assert!(
        (4..=8).contains(&erases),
        "{erases} erases for a hundred selections"
    );
}

#[test]
fn what_runs_is_told_from_the_trailer_and_the_selected_slot() {
    use wire::images::Role;
    let mut chip = Chip::new(0x40_0000);
    image(&mut chip, Slot::B, 100, 2);
    let mut flash = started(&mut chip);
    run(&mut flash, &mut chip, Op::Select, 2, 0);
    for (role, build_id, running) in [
        (Role::Image, 2, Running::B),
        (Role::Image, 3, Running::Volatile),
        (Role::Golden, 2, Running::Golden),
    ] {
        let mut flash = Flash::new();
        flash.find(&mut chip, Trailer { build_id, role });
        assert_eq!(flash.running(), running);
    }
}

/// After two updates without a power cycle the slot of the running image has another build.
#[test]
fn the_slot_of_the_running_image_is_its_own_only_while_it_has_its_build() {
    use wire::images::Role;
    let mut chip = Chip::new(0x40_0000);
    image(&mut chip, Slot::B, 100, 2);
    let mut flash = started(&mut chip);
    run(&mut flash, &mut chip, Op::Select, 2, 0);
    let mut flash = Flash::new();
    let (build_id, role) = (2, Role::Image);
    let trailer = Trailer { build_id, role };
    flash.find(&mut chip, trailer);
    let start = Layout::of(0x40_0000).unwrap().slot_b.start;
    assert_eq!(flash.image(&mut chip), Some((start, 100)));
    image(&mut chip, Slot::B, 200, 3);
    assert_eq!(flash.running(), Running::B);
    assert_eq!(flash.image(&mut chip), None, "another build");
}

proptest::proptest! {
    #![proptest_config(proptest::prelude::ProptestConfig::with_cases(64))]

    /// Reads, erases, programs and CRCs at any place, with polls in between or not.
    #[test]
    fn no_raw_operation_reaches_what_must_survive(
        asked in proptest::collection::vec((1u32..6, 0u32..1100, 0u32..0x1_0000, 0u32..600), 1..30),
        selected in 0u32..3,
        newest in 0u32..4,
    ) {
        let mut chip = Chip::new(0x40_0000);
        image(&mut chip, Slot::A, 300, 1);
        image(&mut chip, Slot::B, 300, 2);
        chip.put(0x30_0000, &[0x55; 4096]);
        chip.put(0x3f_ff00, &[0x66; 256]);
        let mut flash = started(&mut chip);
        save(&mut flash, &mut chip, &Settings::default());
        if selected > 0 {
            run(&mut flash, &mut chip, Op::Select, selected, 0);
        }
        let pins = [None, Some(0), Some(1)].get(newest as usize).copied();
        if let Some(copy) = pins {
            let verdict = Verdict::InForce;
            flash.pins = Loaded { verdict, copy };
        }
        let before = chip.cells.clone();
        for (op, block, offset, length) in asked {
            // A quarter of the addresses are not aligned.
            let offset = if offset & 3 == 0 { offset & !0xfff } else { offset };
            let address = (block << 12).wrapping_add(offset);
            run(&mut flash, &mut chip, Op::from_code(op).unwrap(), address, length);
        }
        let layout = Layout::of(0x40_0000).unwrap();
        let free = |at, copy| pins.is_some_and(|newest| newest != Some(copy))
            && layout.pins_copy(copy).contains(at, 1);
        let writable = |at: u32| layout.writable(Slot::from_code(selected), at, 1)
            || free(at, 0) || free(at, 1);
        let spoilt = (0..0x40_0000u32)
            .step_by(16)
            .find(|at| !writable(*at) && chip.cells[*at as usize..][..16] != before[*at as usize..][..16]);
        proptest::prop_assert_eq!(spoilt, None);
    }
}

// Over the wire.

fn rig() -> Rig {
    let mut rig = Rig::new();
    let Rig { server, board, .. } = &mut rig;
    server.flash.find(&mut board.chip, Trailer::NONE);
    let settings = Settings::default();
    server.flash.start(&mut board.chip, None, settings, false);
    rig
}

fn settle(rig: &mut Rig) {
    while rig.server.flash.busy() {
        rig.server.poll_flash(&mut rig.board);
    }
}

#[test]
fn any_client_may_look_and_operate_while_the_board_has_no_owner() {
    let mut rig = rig();
    assert_eq!(rig.read(map::FLASH_JEDEC), Ok(0xef_4016));
    rig.write(map::FLASH_ADDRESS, 0x1_0000).unwrap();
    assert_eq!(
        rig.write_as(BOB, map::FLASH_OP, Op::EraseSector.code()),
        Ok(())
    );
    let word = OpWord::from_word(rig.read(map::FLASH_OP).unwrap()).unwrap();
    assert!(word.busy && word.result == OpResult::Busy);
    settle(&mut rig);
    let word = OpWord::from_word(rig.read(map::FLASH_OP).unwrap()).unwrap();
    assert_eq!((word.busy, word.result), (false, OpResult::Ok));
    rig.acquire();
    assert_eq!(rig.write_as(BOB, map::FLASH_OP, 1), Err(Refusal::NotOwner));
    assert_eq!(rig.write_as(ALICE, map::FLASH_OP, 0), Err(Refusal::Value));
    assert_eq!(rig.write(map::FLASH_CRC, 0), Err(Refusal::ReadOnly));
    assert_eq!(rig.write(map::FLASH_SETTINGS, 0), Err(Refusal::ReadOnly));
    assert_eq!(
        rig.read(map::FLASH + map::FLASH_LEN),
        Err(Refusal::Unmapped)
    );
}

#[test]
fn operands_and_operation_may_be_one_datagram_and_nothing_may_follow_it() {
    let mut rig = rig();
    let read = |count: u32, more: &[u32]| {
        let mut words = vec![
            0x4e6f_1044,
            0,
            0x000f_0000 | count << 8,
            map::FLASH_ADDRESS,
            0,
            4,
        ];
        words.extend([
            0x000f_0101,
            map::FLASH_OP,
            Op::Read.code(),
            0x77,
            map::FLASH_OP,
        ]);
        words.extend(more);
        words
    };
    let answer = rig.send(&read(2, &[])).unwrap();
    assert_eq!(OpWord::from_word(answer[4]).unwrap().op, Some(Op::Read));
    let behind = [0x000f_0100, map::FLASH_ADDRESS, 1];
    assert_eq!(rig.send(&read(2, &behind)), Err(Refusal::Busy));
}

#[test]
fn while_an_operation_runs_nothing_else_is_taken_and_the_machine_is_not_armed() {
    let mut rig = rig();
    rig.acquire();
    rig.write(map::FLASH_ADDRESS, 0x1_0000).unwrap();
    rig.write(map::FLASH_OP, Op::EraseBlock.code()).unwrap();
    for (address, value) in [
        (map::FLASH_OP, 1),
        (map::FLASH_ADDRESS, 0),
        (map::FLASH_BUFFER, 0),
        (map::SESSION_REBOOT, map::REBOOT_KEY),
    ] {
        assert_eq!(rig.write(address, value), Err(Refusal::Busy), "{address:x}");
    }
    let obstacles = rig
        .read(wire::describe::address(wire::describe::OBSTACLES_AT))
        .unwrap();
    assert_eq!(obstacles, wire::describe::OBSTACLE_FLASH);
    for (enable, request) in [(true, false), (true, true), (true, true), (true, true)] {
        let status = rig.exchange(enable, request).unwrap();
        assert_eq!(status.state.state, wire::State::Disarmed);
    }
    settle(&mut rig);
    assert_eq!(
        rig.read(wire::describe::address(wire::describe::OBSTACLES_AT)),
        Ok(0)
    );
    let status = rig.exchange(true, true).unwrap();
    assert_eq!(
        status.state.state,
        wire::State::Disarmed,
        "the edge is used up"
    );
    for request in [false, true, true] {
        rig.exchange(true, request).unwrap();
    }
    assert_eq!(rig.server.safety().state(), wire::State::Armed);
    assert_eq!(rig.write(map::FLASH_OP, 1), Err(Refusal::Armed));
}
