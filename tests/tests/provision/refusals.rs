//! Operations that no client and no sequence of operations may achieve.

use crate::rig::*;
use ferrocnc_tests::bench::Went;
use ferrocnc_tests::flash::{self, Boots, FIRST, boots, factory};
use ferrocnc_tests::seed;
use rand::{Rng, RngCore, SeedableRng};
use rand_pcg::Pcg32;
use wire::Refusal;
use wire::discovery::{Body, Message};
use wire::flash::{BLOCK, Op, OpResult, SECTOR, Slot};
use wire::map;

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
        report_cuts(&format!("protecting golden, {}", part.name), cuts);
    }
}
