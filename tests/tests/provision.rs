//! A board's flash under the firmware: settings, images, discovery, with power lost at every step
//! of them.
//!
//! The firmware's library runs on the twin; its flash is the behavioural NOR, which can lose power
//! in any byte of a program and any part of an erase. A model of an ECP5 at power-up decides what
//! runs after that. So each test here is of the form "prepare, cut the power at step n, look", for
//! every n, or for thousands drawn from a printed seed.

use std::ops::Range;

use ferrocnc_tests::bench::{Bench, KEY, Went, packed};
use ferrocnc_tests::flash::{self, Boots, FIRST, boots, factory};
use ferrocnc_tests::seed;
use rand::{Rng, RngCore, SeedableRng};
use rand_pcg::Pcg32;
use sim::nor::{Cut, Misuse, Nor, Order, Part, Times};
use wire::discovery::{Body, Message};
use wire::flash::{BLOCK, Layout, Op, OpResult, Origin, PAGE, Running, SECTOR, Slot};
use wire::map;
use wire::settings::{Settings, mac_of_uid};
use wire::{Name, Refusal};

const UID: u64 = 0xd162_0c8a_1b2c_3d4e;
/// Build id of the updates.
const SECOND: u32 = 0xbbbb_0002;

/// The chips with short times, because ten thousand erases of 45 ms each would take too long.
fn parts() -> [Part; 3] {
    Part::ALL.map(|part| part.with(Times::QUICK))
}

fn board(part: Part) -> Bench {
    Bench::new(factory(part, UID))
}

fn settings(last_octet: u32, name: &str) -> Settings {
    Settings {
        ip: 0xc0a8_0200 + last_octet,
        name: Name::new(name).expect("a name"),
        key: KEY,
        ..Settings::default()
    }
}

/// All that can be compared after a save: the board numbers them itself, does not show the key, and
/// makes a hardware address where none is given.
fn seen(settings: &Settings) -> Settings {
    Settings {
        sequence: 0,
        keep_key: false,
        mac: match settings.mac {
            mac if mac == mac_of_uid([(UID >> 32) as u32, UID as u32]) => [0; 6],
            mac => mac,
        },
        ..settings.blanked()
    }
}

// ---- the plug -----------------------------------------------------------------------------------------------------------

/// Does `job` on copies of this flash, each time with the power failing one step later, in `seeds`
/// ways each; hands what is left to `judge`. How many cuts there were.
fn cut_everywhere<R>(
    nor: &Nor,
    seeds: Range<u64>,
    job: impl Fn(&mut Bench) -> R,
    judge: impl Fn(Bench, Cut),
) -> u64 {
    let mut whole = Bench::new(nor.copy());
    let begun = whole.nor().steps();
    job(&mut whole);
    let steps = whole.nor().steps() - begun;
    assert!(steps > 0, "nothing was written, so nothing can be cut");
    let mut cuts = 0;
    for step in 0..steps {
        for seed in seeds.clone() {
            let order = match seed % 2 {
                0 => Order::InOrder,
                _ => Order::AllAtOnce,
            };
            let mut bench = Bench::new(nor.copy());
            let cut = Cut {
                step: bench.nor().steps() + step,
                seed,
                order,
            };
            bench.cut_at(cut);
            job(&mut bench);
            assert!(bench.nor().dead(), "{cut:?} of {steps} steps never came");
            judge(bench, cut);
            cuts += 1;
        }
    }
    cuts
}

fn golden_of(nor: &Nor) -> Vec<u8> {
    let layout = flash::layout(nor);
    nor.cells()[layout.golden.start as usize..].to_vec()
}

// ---- what a board says ----------------------------------------------------------------------------------------------------

#[test]
fn a_new_board_says_what_it_is_and_what_it_runs() {
    for part in parts() {
        let mut bench = board(part);
        let [a, b, c] = part.jedec;
        assert_eq!(
            bench.read(map::FLASH_JEDEC),
            u32::from_be_bytes([0, a, b, c])
        );
        let uid = [bench.read(map::FLASH_UID_HI), bench.read(map::FLASH_UID_LO)];
        assert_eq!(uid, [(UID >> 32) as u32, UID as u32]);
        assert_eq!(bench.read(map::FLASH_SIZE), part.bytes as u32);
        assert_eq!(bench.read(map::FLASH_RUNNING), Running::A.code());
        assert_eq!(bench.selected(), Some(Slot::A));
        assert_eq!(bench.read(map::FLASH_BUILD_ID), FIRST);
        assert_eq!(bench.read(map::FLASH_ORIGIN), Origin::BuiltIn.code());
        assert_eq!(bench.read(map::FLASH_PROTECTED), 1);
        assert_eq!(bench.settings().ip, 0xc0a8_0232);
        assert_eq!(bench.nor().misuse(), [], "{}", part.name);
    }
}

#[test]
fn a_board_with_an_empty_flash_says_so() {
    let mut bench = Bench::new(Nor::new(Part::W25Q32JV.with(Times::QUICK), UID));
    assert_eq!(bench.read(map::FLASH_RUNNING), Running::Volatile.code());
    assert_eq!(bench.selected(), None);
    assert_eq!(bench.read(map::FLASH_PROTECTED), 0);
    assert_eq!(bench.nor().misuse(), []);
}

#[test]
fn flash_is_read_and_summed_as_it_is() {
    let mut bench = board(parts()[0]);
    let cells = bench.nor().cells().to_vec();
    for (at, length) in [(0, 256), (0x1_0000, 256), (0x1_0003, 5), (0x3f_ff00, 256)] {
        assert_eq!(
            bench.read_flash(at, length),
            cells[at as usize..][..length as usize]
        );
    }
    for (at, length) in [(0, 256), (0x1_0000, 0xf_0000), (0x30_0000, 1000), (7, 1)] {
        assert_eq!(bench.op(Op::Crc, at, length, &[]), Went::OK);
        let expected = wire::crc::crc32(&cells[at as usize..][..length as usize]);
        assert_eq!(
            bench.read(map::FLASH_CRC),
            expected,
            "{length} from {at:#x}"
        );
    }
    assert_eq!(bench.nor().misuse(), []);
}

// ---- settings -----------------------------------------------------------------------------------------------------------

#[test]
fn settings_are_in_force_after_a_power_cycle_and_the_newest_win() {
    for part in parts() {
        let mut bench = board(part);
        for n in 1..8 {
            let new = settings(n, &format!("mill {n}"));
            assert_eq!(bench.save(&new), Went::OK);
            bench = bench.power_cycle();
            assert_eq!(seen(&bench.settings()), seen(&new));
            let origin = bench.read(map::FLASH_ORIGIN);
            assert!(origin == Origin::Copy0.code() || origin == Origin::Copy1.code());
        }
        assert_eq!(bench.op(Op::ForgetSettings, 0, 0, &[]), Went::OK);
        bench = bench.power_cycle();
        assert_eq!(bench.read(map::FLASH_ORIGIN), Origin::BuiltIn.code());
        assert_eq!(bench.settings().ip, 0xc0a8_0232);
        assert_eq!(bench.nor().misuse(), []);
    }
}

#[test]
fn the_factory_pin_sets_saved_settings_aside_and_does_not_erase_them() {
    let mut bench = board(parts()[0]);
    let saved = settings(77, "lost");
    assert_eq!(bench.save(&saved), Went::OK);
    bench = bench.power_cycle_with_factory_pin();
    assert_eq!(bench.read(map::FLASH_ORIGIN), Origin::FactoryPin.code());
    assert_eq!(bench.settings().ip, 0xc0a8_0232);
    bench = bench.power_cycle();
    assert_eq!(seen(&bench.settings()), seen(&saved));
}

#[test]
fn settings_survive_the_plug_at_every_step_of_a_save() {
    let mut cuts = 0;
    for part in parts() {
        // The first save, the second, one onto an old copy, and forgetting.
        let mut bench = board(part);
        for saves in 0..4 {
            let old = bench.settings();
            let new = settings(100 + saves, "new");
            let nor = bench.nor().copy();
            cuts += cut_everywhere(
                &nor,
                0..6,
                |bench| bench.save(&new),
                |bench, cut| {
                    let mut bench = bench.power_cycle();
                    let now = seen(&bench.settings());
                    assert!(
                        now == seen(&old) || now == seen(&new),
                        "{} save {saves}, {cut:?}: {now:?}",
                        part.name
                    );
                    // And it can be set again.
                    let third = settings(200, "third");
                    assert_eq!(bench.save(&third), Went::OK, "{cut:?}");
                    let mut bench = bench.power_cycle();
                    assert_eq!(seen(&bench.settings()), seen(&third), "{cut:?}");
                },
            );
            assert_eq!(bench.save(&settings(saves + 1, "old")), Went::OK);
            bench = bench.power_cycle();
        }
    }
    println!("{cuts} cuts in saves");
}

#[test]
fn forgetting_settings_survives_the_plug_at_every_step() {
    let mut bench = board(parts()[0]);
    let built_in = bench.settings();
    for n in 1..3 {
        assert_eq!(bench.save(&settings(n, "saved")), Went::OK);
    }
    bench = bench.power_cycle();
    let saved = bench.settings();
    let nor = bench.nor().copy();
    let cuts = cut_everywhere(
        &nor,
        0..20,
        |bench| bench.op(Op::ForgetSettings, 0, 0, &[]),
        |bench, cut| {
            let mut bench = bench.power_cycle();
            let now = seen(&bench.settings());
            assert!(
                now == seen(&saved) || now == seen(&built_in),
                "{cut:?}: older settings came back: {now:?}"
            );
        },
    );
    println!("{cuts} cuts while forgetting");
}

#[test]
fn settings_told_by_discovery_survive_the_plug_at_every_step() {
    let bench = board(parts()[0]);
    let nor = bench.nor().copy();
    let new = settings(9, "told");
    let set = Message {
        nonce: 1,
        uid: [(UID >> 32) as u32, UID as u32],
        body: Body::Set(new),
    };
    let cuts = cut_everywhere(
        &nor,
        0..4,
        |bench| bench.discover(&set),
        |bench, cut| {
            let mut bench = bench.power_cycle();
            let now = seen(&bench.settings());
            assert!(
                now == seen(&new) || now.ip == 0xc0a8_0232,
                "{cut:?}: {now:?}"
            );
        },
    );
    println!("{cuts} cuts in a Set");
}

// ---- selecting ----------------------------------------------------------------------------------------------------------

/// A board with a second image in slot B, [`FIRST`] selected.
fn two_images(part: Part) -> Bench {
    let mut nor = factory(part, UID);
    let layout = flash::layout(&nor);
    let image = flash::image(SECOND, 3);
    nor.preload(layout.slot_b.start as usize, &image);
    let meta = flash::meta(&image, SECOND).to_page();
    nor.preload(layout.slot_b.meta() as usize, &meta);
    Bench::new(nor)
}

#[test]
fn selecting_back_and_forth_wears_two_sectors_slowly() {
    for part in parts() {
        let mut bench = two_images(part);
        for n in 0..100 {
            let (slot, build) = match n % 2 {
                0 => (Slot::B, SECOND),
                _ => (Slot::A, FIRST),
            };
            assert_eq!(bench.select(slot), Went::OK, "selection {n}");
            assert_eq!(bench.selected(), Some(slot));
            assert_eq!(
                boots(&bench.nor()),
                Boots::Slot(slot, build),
                "selection {n}"
            );
        }
        let nor = bench.nor();
        println!(
            "{}: 100 selections, sectors erased {} and {} times",
            part.name,
            nor.erases(0),
            nor.erases(SECTOR as usize)
        );
        assert!(nor.erases(0) + nor.erases(SECTOR as usize) <= 8);
        assert_eq!(nor.misuse(), []);
    }
}

/// Both slots hold images, and slot A or B is selected: what is seen before and after selection `n`
/// of an alternating row.
fn turn(n: usize) -> (Slot, Boots, Boots) {
    let (a, b) = (Boots::Slot(Slot::A, FIRST), Boots::Slot(Slot::B, SECOND));
    match n % 2 {
        0 => (Slot::B, a, b),
        _ => (Slot::A, b, a),
    }
}

/// One cut in thirty-two selections is different: the first stub sector is full, the live stub lies
/// in the second, and the first is erased. While its cells rise from 0 to 1 any two of them may
/// pass through a preamble, and the FPGA reads that sector first. Then it is the golden image that
/// runs, which is what it is there for, and the old slot stays selected: the test shows that this
/// happens nowhere else, that the board reports it, and that another selection repairs it.
#[test]
fn selecting_survives_the_plug_at_every_step_of_forty_selections() {
    let mut bench = two_images(parts()[0]);
    let to_golden = std::cell::Cell::new(0);
    let mut cuts = 0;
    for n in 0..40 {
        let (slot, old, new) = turn(n);
        let nor = bench.nor().copy();
        cuts += cut_everywhere(
            &nor,
            0..2,
            |bench| bench.select(slot),
            |bench, cut| {
                let now = boots(&bench.nor());
                let erasing = bench.nor().erases(0) > 0;
                let mut bench = bench.power_cycle();
                if erasing && matches!(now, Boots::Golden(_)) {
                    to_golden.set(to_golden.get() + 1);
                    assert_eq!(bench.read(map::FLASH_RUNNING), Running::Golden.code());
                    assert_eq!(bench.selected(), Some(slot.other()), "{cut:?}");
                } else {
                    assert!(now == old || now == new, "selection {n}, {cut:?}: {now:?}");
                }
                assert_eq!(bench.select(slot), Went::OK, "selection {n} again, {cut:?}");
                assert_eq!(boots(&bench.nor()), new, "selection {n} again, {cut:?}");
            },
        );
        assert_eq!(bench.select(slot), Went::OK);
        bench = bench.power_cycle();
    }
    println!(
        "{cuts} cuts in selections, {} of them ran golden",
        to_golden.get()
    );
}

/// How often that is, given that the power fails within these 45 ms of one selection in thirty-two.
#[test]
fn an_erase_of_the_stubs_that_is_cut_seldom_runs_the_golden_image_and_is_repaired() {
    let mut bench = two_images(parts()[0]);
    let mut n = 0;
    while bench.nor().erases(0) == 0 {
        let before = bench.nor().copy();
        assert_eq!(bench.select(turn(n).0), Went::OK);
        if bench.nor().erases(0) > 0 {
            bench = Bench::new(before);
            break;
        }
        n += 1;
    }
    let (slot, old, new) = turn(n);
    let nor = bench.nor().copy();
    let mut whole = Bench::new(nor.copy());
    let begun = whole.nor().steps();
    assert_eq!(whole.select(slot), Went::OK);
    let steps = whole.nor().steps() - begun;
    let (mut cut_in_erase, mut golden) = (0, 0);
    for seed in 0..2_000 {
        let mut bench = Bench::new(nor.copy());
        let step = bench.nor().steps() + seed % steps;
        bench.cut_at(Cut {
            step,
            seed,
            order: Order::InOrder,
        });
        bench.select(slot);
        cut_in_erase += u32::from(bench.nor().erases(0) > 0);
        let now = boots(&bench.nor());
        let fell = matches!(now, Boots::Golden(_));
        golden += u32::from(fell);
        assert!(fell || now == old || now == new, "seed {seed}: {now:?}");
        let mut bench = bench.power_cycle();
        assert_eq!(bench.select(slot), Went::OK, "seed {seed}");
        assert_eq!(boots(&bench.nor()), new, "seed {seed}");
    }
    println!("{golden} of {cut_in_erase} cuts in or behind the erase ran golden");
    assert!(golden < cut_in_erase);
}

// ---- updates ------------------------------------------------------------------------------------------------------------

#[test]
fn an_update_runs_at_the_next_power_up_and_the_one_after_goes_to_the_other_slot() {
    for part in parts() {
        let mut bench = board(part);
        let golden = golden_of(&bench.nor());
        for (n, slot) in [Slot::B, Slot::A, Slot::B].into_iter().enumerate() {
            let build = SECOND + n as u32;
            let before = bench.read(map::FLASH_BUILD_ID);
            assert_eq!(bench.update(build, 20), None);
            assert_eq!(
                bench.read(map::FLASH_BUILD_ID),
                before,
                "it runs until then"
            );
            bench = bench.power_cycle();
            assert_eq!(bench.read(map::FLASH_BUILD_ID), build);
            let running = [Running::A, Running::B][slot.code() as usize - 1];
            assert_eq!(bench.read(map::FLASH_RUNNING), running.code());
        }
        assert_eq!(golden_of(&bench.nor()), golden);
        assert_eq!(bench.nor().misuse(), [], "{}", part.name);
    }
}

/// Old or new selected, golden whole, and the same command again goes through.
fn judge_update(bench: Bench, golden: &[u8], build: u32, told: &dyn std::fmt::Debug) -> Bench {
    let now = boots(&bench.nor());
    let old_or_new = match now {
        Boots::Slot(_, found) => found == FIRST || found == build,
        Boots::Golden(_) | Boots::Nothing => false,
    };
    assert!(old_or_new, "{told:?}: {now:?}");
    assert!(golden_of(&bench.nor()) == golden, "{told:?}: golden");
    let mut bench = bench.power_cycle();
    assert_eq!(bench.update(build, 14), None, "{told:?}: the next try");
    assert!(matches!(boots(&bench.nor()), Boots::Slot(_, found) if found == build));
    assert!(golden_of(&bench.nor()) == golden, "{told:?}: golden");
    bench
}

#[test]
fn an_update_survives_the_plug_at_every_byte() {
    for part in [parts()[0], parts()[2]] {
        let nor = factory(part, UID);
        let golden = golden_of(&nor);
        let cuts = cut_everywhere(
            &nor,
            0..2,
            |bench| bench.update(SECOND, 14),
            |bench, cut| drop(judge_update(bench, &golden, SECOND, &cut)),
        );
        println!("{}: {cuts} cuts in an update", part.name);
    }
}

#[test]
fn updates_survive_a_plug_that_is_pulled_again_and_again() {
    let seed = seed();
    let mut random = Pcg32::seed_from_u64(seed);
    let part = parts()[1];
    let golden = golden_of(&factory(part, UID));
    let mut cuts = 0;
    for story in 0..150 {
        let mut bench = Bench::new(factory(part, UID));
        // Every try is cut somewhere; many never get to their end.
        for try_number in 0..6 {
            let step = bench.nor().steps() + random.random_range(0..2_400);
            let order = [Order::InOrder, Order::AllAtOnce][random.random_range(0..2)];
            let cut = Cut {
                step,
                seed: random.next_u64(),
                order,
            };
            bench.cut_at(cut);
            let went = bench.update(SECOND, 28);
            assert!(
                matches!(went, None | Some(Went::Dark)),
                "seed {seed}, story {story}, try {try_number}: {went:?}"
            );
            cuts += u32::from(bench.nor().dead());
            let now = boots(&bench.nor());
            assert!(
                matches!(now, Boots::Slot(_, FIRST | SECOND)),
                "seed {seed}, story {story}, try {try_number}, {cut:?}: {now:?}"
            );
            bench = bench.power_cycle();
        }
        judge_update(bench, &golden, SECOND, &(seed, story));
    }
    println!("{cuts} cuts in 900 tries");
}

// ---- refusals -----------------------------------------------------------------------------------------------------------

#[test]
fn only_the_slot_that_is_not_selected_can_be_erased_or_programmed() {
    for part in parts() {
        let mut bench = board(part);
        let layout = flash::layout(&bench.nor());
        let before = bench.nor().cells().to_vec();
        let forbidden = [
            0,
            SECTOR,
            layout.slot_a.start,
            layout.slot_a.meta(),
            layout.settings,
            layout.settings + SECTOR,
            layout.golden.start,
            layout.golden.meta(),
            layout.jump_page(),
            layout.size,
            !0xff,
        ];
        for at in forbidden {
            for (op, length) in [
                (Op::EraseSector, 0),
                (Op::EraseBlock, 0),
                (Op::Program, 256),
            ] {
                let at = if op == Op::EraseBlock {
                    at / BLOCK * BLOCK
                } else {
                    at
                };
                let went = bench.op(op, at, length, &[0; 64]);
                assert_eq!(went, Went::Done(OpResult::Address), "{op} at {at:#x}");
            }
        }
        // Across the border of the slot, across a page, and nothing at all.
        let end = layout.slot_b.end;
        for (at, length) in [(end - 128, 256), (layout.slot_b.start + 1, 256)] {
            let went = bench.op(Op::Program, at, length, &[0; 64]);
            assert!(matches!(
                went,
                Went::Done(OpResult::Address | OpResult::Value)
            ));
        }
        assert!(bench.nor().cells() == before);
        assert_eq!(bench.nor().misuse(), [], "the chip was not even asked");
    }
}

#[test]
fn an_image_that_is_not_whole_or_for_another_fpga_is_not_selected() {
    let part = parts()[0];
    let layout = Layout::of(part.bytes as u32).expect("a size boards have");
    let image = flash::image(SECOND, 14);
    let good = flash::meta(&image, SECOND);
    let with = |image: &[u8], meta: [u8; PAGE as usize]| {
        let mut nor = factory(part, UID);
        nor.preload(layout.slot_b.start as usize, image);
        nor.preload(layout.slot_b.meta() as usize, &meta);
        Bench::new(nor)
    };
    let mut damaged = image.clone();
    damaged[500] ^= 1;
    let mut torn = good.to_page();
    torn[20] ^= 1;
    let other = wire::images::Meta {
        idcode: 0x4111_2043,
        ..good
    };
    let longer = wire::images::Meta {
        length: layout.slot_b.image_max() + 1,
        ..good
    };
    for (what, mut bench) in [
        ("nothing", with(&[], [0xff; PAGE as usize])),
        (
            "an image without a meta page",
            with(&image, [0xff; PAGE as usize]),
        ),
        ("a truncated image", with(&image[..700], good.to_page())),
        ("a damaged image", with(&damaged, good.to_page())),
        ("a torn meta page", with(&image, torn)),
        ("another FPGA's", with(&image, other.to_page())),
        ("one longer than its slot", with(&image, longer.to_page())),
    ] {
        assert_eq!(bench.select(Slot::B), Went::Done(OpResult::Image), "{what}");
        assert_eq!(boots(&bench.nor()), Boots::Slot(Slot::A, FIRST), "{what}");
    }
    let mut bench = with(&image, good.to_page());
    assert_eq!(bench.op(Op::Select, 3, 0, &[]), Went::Done(OpResult::Value));
    assert_eq!(bench.select(Slot::B), Went::OK);
}

#[test]
fn settings_that_no_board_can_use_are_refused() {
    let mut bench = board(parts()[0]);
    for bad in [
        Settings {
            ip: 0,
            ..settings(1, "")
        },
        Settings {
            prefix: 31,
            ..settings(1, "")
        },
        Settings {
            port: 0,
            ..settings(1, "")
        },
        Settings {
            mac: [1, 0, 0, 0, 0, 0],
            ..settings(1, "")
        },
    ] {
        assert_eq!(bench.save(&bad), Went::Done(OpResult::Value), "{bad:?}");
    }
    let mut torn = settings(1, "").to_words();
    torn[4] ^= 1;
    let went = bench.op(Op::SaveSettings, 0, 0, &torn);
    assert_eq!(went, Went::Done(OpResult::Value));
    assert_eq!(bench.nor().programs(), 0);
}

#[test]
fn a_client_that_does_not_own_the_board_changes_nothing() {
    let mut bench = board(parts()[0]);
    bench.acquire();
    let refused = bench.op_from_a_stranger(Op::ForgetSettings);
    assert_eq!(refused, Went::Refused);
    let counter = map::COUNTERS_REFUSED + 4 * Refusal::NotOwner.index() as u32;
    assert!(bench.read(counter) > 0);
    assert_eq!(bench.nor().programs(), 0);
}

#[test]
fn an_armed_machine_refuses_every_change_and_is_not_disturbed() {
    let mut bench = board(parts()[0]);
    bench.arm();
    let before = bench.nor().cells().to_vec();
    let layout = flash::layout(&bench.nor());
    for (op, address) in [
        (Op::EraseSector, layout.slot_b.start),
        (Op::EraseBlock, layout.slot_b.start),
        (Op::Program, layout.slot_b.start),
        (Op::Select, Slot::B.code()),
        (Op::SaveSettings, 0),
        (Op::ForgetSettings, 0),
        (Op::Protect, 0),
    ] {
        let went = bench.op(op, address, 256, &settings(1, "x").to_words());
        assert!(
            matches!(went, Went::Refused | Went::Done(OpResult::Armed)),
            "{op}: {went:?}"
        );
        bench.exchange();
    }
    let set = Message {
        nonce: 5,
        uid: [(UID >> 32) as u32, UID as u32],
        body: Body::Set(settings(1, "x")),
    };
    let answer = bench.discover(&set).map(|answer| answer.body);
    assert_eq!(answer, Some(Body::Done(OpResult::Armed)));
    assert!(bench.exchange().state.enabled, "it is armed still");
    assert!(bench.nor().cells() == before);
}

#[test]
fn no_order_of_operations_touches_golden_or_leaves_a_board_that_does_not_boot() {
    let seed = seed();
    let mut random = Pcg32::seed_from_u64(seed);
    let mut bench = board(parts()[2]);
    let golden = golden_of(&bench.nor());
    let layout = flash::layout(&bench.nor());
    let places = [
        0,
        layout.slot_a.start,
        layout.slot_b.start,
        layout.slot_a.meta(),
        layout.slot_b.meta(),
        layout.settings,
        layout.golden.start,
        layout.jump_page(),
    ];
    for n in 0..4_000 {
        let op = Op::ALL[random.random_range(0..Op::ALL.len())];
        let near = places[random.random_range(0..places.len())];
        let address = match random.random_range(0..4) {
            0 => random.next_u32(),
            1 => random.random_range(0..4),
            2 => near,
            _ => near.wrapping_add(random.random_range(0..0x3000)) & !0xff,
        };
        let length = [0, 1, 255, 256, 257, u32::MAX][random.random_range(0..6)];
        let noise: Vec<u32> = (0..64).map(|_| random.next_u32()).collect();
        let buffer = match random.random_range(0..3) {
            0 => settings(random.random_range(1..255), "noise")
                .to_words()
                .to_vec(),
            _ => noise,
        };
        bench.op(op, address, length, &buffer);
        let now = boots(&bench.nor());
        assert_eq!(
            now,
            Boots::Slot(Slot::A, FIRST),
            "seed {seed}, operation {n}: {op} {address:#x} {length}"
        );
    }
    assert!(golden_of(&bench.nor()) == golden, "seed {seed}");
    assert_eq!(bench.read(map::FLASH_PROTECTED), 1);
}

#[test]
fn protecting_golden_survives_the_plug_and_is_there_at_last() {
    for part in parts() {
        let mut nor = factory(part, UID);
        nor.lock(0);
        let layout = flash::layout(&nor);
        let golden = golden_of(&nor);
        let cuts = cut_everywhere(
            &nor,
            0..16,
            |bench| bench.op(Op::Protect, 0, 0, &[]),
            |bench, cut| {
                let mut bench = bench.power_cycle();
                assert_eq!(bench.op(Op::Protect, 0, 0, &[]), Went::OK, "{cut:?}");
                assert_eq!(bench.read(map::FLASH_PROTECTED), 1);
                let protected = bench.nor().protected();
                assert_eq!(protected, layout.protected() as usize..layout.size as usize);
                assert!(golden_of(&bench.nor()) == golden);
                assert_eq!(bench.update(SECOND, 3), None, "{cut:?}: slots are free");
            },
        );
        assert!(cuts >= 16, "{}", part.name);
    }
}

// ---- discovery ----------------------------------------------------------------------------------------------------------

#[test]
fn three_boards_with_one_address_are_told_apart_and_named_one_by_one() {
    let part = parts()[0];
    let uids = [0x11, 0x22, 0x33].map(|n| UID + n);
    let mut boards = uids.map(|uid| Bench::new(factory(part, uid)));
    let halves = |uid: u64| [(uid >> 32) as u32, uid as u32];
    let mut macs = std::collections::HashSet::new();
    for (bench, uid) in boards.iter_mut().zip(uids) {
        let who = bench.who();
        assert_eq!((who.nonce, who.uid), (77, halves(uid)));
        let Body::Here(here) = who.body else {
            panic!("{who:?}");
        };
        assert_eq!((here.ip, here.port), (0xc0a8_0232, 1234));
        assert_eq!((here.running, here.build_id), (Running::A, FIRST));
        macs.insert(here.mac);
    }
    let expected: std::collections::HashSet<_> =
        uids.into_iter().map(halves).map(mac_of_uid).collect();
    assert_eq!(macs, expected, "each has a hardware address of its own");
    // Each is told in turn, and every board receives it.
    for (n, uid) in (0u32..).zip(uids) {
        let new = settings(101 + n, &format!("axis {n}"));
        let set = Message {
            nonce: 1000 + n,
            uid: halves(uid),
            body: Body::Set(new),
        };
        for (bench, own) in boards.iter_mut().zip(uids) {
            let answer = bench.discover(&set);
            let expected = (own == uid).then_some(Message {
                body: Body::Done(OpResult::Ok),
                ..set
            });
            assert_eq!(answer, expected, "board {own:x} told what is for {uid:x}");
        }
    }
    // They have started anew by themselves.
    for (n, bench) in (0u32..).zip(&mut boards) {
        bench.pass(200);
        let Body::Here(here) = bench.who().body else {
            panic!("no answer");
        };
        assert_eq!(here.ip, 0xc0a8_0200 + 101 + n);
        assert_eq!(here.name.text(), format!("axis {n}"));
    }
}

#[test]
fn a_program_of_bytes_that_wrap_never_reaches_the_chip() {
    let mut bench = board(parts()[0]);
    let area = flash::layout(&bench.nor()).slot_b;
    assert_eq!(bench.op(Op::EraseSector, area.start, 0, &[]), Went::OK);
    assert_eq!(bench.program(area.start + 250, &[1; 6]), Went::OK);
    let went = bench.op(Op::Program, area.start + 250, 7, &packed(&[0; 7]));
    assert!(
        matches!(went, Went::Done(OpResult::Address | OpResult::Value)),
        "{went:?}"
    );
    let wrapped = |misuse: &Misuse| matches!(misuse, Misuse::Wrapped(_));
    assert!(!bench.nor().misuse().iter().any(wrapped));
    assert_eq!(bench.read_flash(area.start + 250, 6), [1; 6]);
}
