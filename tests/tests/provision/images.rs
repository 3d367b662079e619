//! Images: updated and selected.

use crate::rig::*;
use ferrocnc_tests::bench::{Bench, Went};
use ferrocnc_tests::flash::{self, Boots, FIRST, boots, factory};
use ferrocnc_tests::seed;
use rand::{Rng, RngCore, SeedableRng};
use rand_pcg::Pcg32;
use sim::nor::{Cut, Order, Part};
use wire::flash::{Layout, Op, OpResult, PAGE, Running, SECTOR, Slot};
use wire::map;

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
    println!("{} cuts in selections ran golden", to_golden.get());
    report_cuts("selections", cuts);
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
    let cuts = 2_000;
    for seed in 0..cuts {
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
    report_cuts("a selection that erases", cuts);
    assert!(golden < cut_in_erase);
}

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
        report_cuts(&format!("an update, {}", part.name), cuts);
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
    report_cuts("updates again and again", u64::from(cuts));
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
    for (what, image, meta) in [
        ("nothing", &[][..], [0xff; PAGE as usize]),
        (
            "an image without a meta page",
            &image[..],
            [0xff; PAGE as usize],
        ),
        ("a truncated image", &image[..700], good.to_page()),
        ("a damaged image", &damaged[..], good.to_page()),
        ("a torn meta page", &image[..], torn),
        ("another FPGA's", &image[..], other.to_page()),
        ("one longer than its slot", &image[..], longer.to_page()),
    ] {
        // One board at a time: seven do not fit on a test's stack.
        let mut bench = with(image, meta);
        assert_eq!(bench.select(Slot::B), Went::Done(OpResult::Image), "{what}");
        assert_eq!(boots(&bench.nor()), Boots::Slot(Slot::A, FIRST), "{what}");
    }
    let mut bench = with(&image, good.to_page());
    assert_eq!(bench.op(Op::Select, 3, 0, &[]), Went::Done(OpResult::Value));
    assert_eq!(bench.select(Slot::B), Went::OK);
}
