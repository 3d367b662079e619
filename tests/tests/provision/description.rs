//! A board's description of its flash, and the information it reads there.

use crate::rig::*;
use ferrocnc_tests::bench::{Bench, Went, packed};
use ferrocnc_tests::flash::{self, FIRST};
use sim::nor::{Misuse, Nor, Part, Times};
use wire::flash::{Op, OpResult, Origin, Running, Slot};
use wire::map;

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
