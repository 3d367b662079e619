use embedded_hal::spi::{Operation, SpiDevice};
use proptest::prelude::*;

use super::pins::Wires;
use super::spi::Shared;
use super::*;

const UID: u64 = 0xd1b2_c3a4_0516_2738;

fn chip() -> Nor {
    Nor::new(Part::W25Q32JV.with(Times::QUICK), UID)
}

/// Sends bytes, then reads some.
fn talk(nor: &mut impl SpiDevice, send: &[u8], read: usize) -> Vec<u8> {
    let mut answer = vec![0; read];
    let done = nor.transaction(&mut [Operation::Write(send), Operation::Read(&mut answer)]);
    assert!(done.is_ok());
    answer
}

fn wait(nor: &mut Nor) {
    let begun = nor.now;
    while talk(nor, &[0x05], 1)[0] & 1 != 0 && !nor.dead() {
        assert!(nor.now < begun + 100_000_000_000, "busy for ever");
    }
}

fn order(order: u8, at: usize) -> Vec<u8> {
    vec![order, (at >> 16) as u8, (at >> 8) as u8, at as u8]
}

fn change(nor: &mut Nor, bytes: &[u8]) {
    talk(nor, &[0x06], 0);
    talk(nor, bytes, 0);
    wait(nor);
}

fn program(nor: &mut Nor, at: usize, bytes: &[u8]) {
    change(nor, &[&order(0x02, at)[..], bytes].concat());
}

fn read(nor: &mut impl SpiDevice, at: usize, count: usize) -> Vec<u8> {
    talk(nor, &order(0x03, at), count)
}

#[test]
fn it_says_what_it_is() {
    for part in Part::ALL {
        let mut nor = Nor::new(part, UID);
        assert_eq!(talk(&mut nor, &[0x9f], 3), part.jedec);
        let id = talk(&mut nor, &[0x4b, 0, 0, 0, 0], part.uid_bytes);
        assert_eq!(id[..8], UID.to_be_bytes());
        assert_eq!(talk(&mut nor, &[0xab, 0, 0, 0], 1), [part.jedec[2] - 1]);
        assert_eq!(nor.misuse(), []);
    }
}

#[test]
fn a_program_clears_bits_and_never_sets_one() {
    let mut nor = chip();
    program(&mut nor, 0x1234, &[0x0f, 0xf0]);
    assert_eq!(read(&mut nor, 0x1233, 4), [0xff, 0x0f, 0xf0, 0xff]);
    program(&mut nor, 0x1234, &[0x3c]);
    assert_eq!(read(&mut nor, 0x1234, 1), [0x0c]);
    assert_eq!(nor.misuse(), [Misuse::NotErased(0x1234)]);
}

#[test]
fn a_program_wraps_inside_its_page() {
    let mut nor = chip();
    program(&mut nor, 0x10fe, &[1, 2, 3, 4]);
    assert_eq!(read(&mut nor, 0x10fe, 3), [1, 2, 0xff]);
    assert_eq!(read(&mut nor, 0x1000, 3), [3, 4, 0xff]);
    assert_eq!(nor.misuse(), [Misuse::Wrapped(0x10fe)]);
}

#[test]
fn nothing_changes_without_a_write_enable_and_each_is_good_for_one_change() {
    let mut nor = chip();
    talk(&mut nor, &[&order(0x02, 0)[..], &[0]].concat(), 0);
    assert_eq!(read(&mut nor, 0, 1), [0xff]);
    program(&mut nor, 0, &[0]);
    talk(&mut nor, &order(0x20, 0), 0);
    wait(&mut nor);
    assert_eq!(read(&mut nor, 0, 1), [0]);
    assert_eq!(
        nor.misuse(),
        [Misuse::NotEnabled(2), Misuse::NotEnabled(0x20)]
    );
}

#[test]
fn erases_take_their_sector_or_block_and_nothing_else() {
    for (byte, size) in [(0x20, SECTOR), (0x52, BLOCK / 2), (0xd8, BLOCK)] {
        let mut nor = chip();
        nor.preload(0, &vec![0; 4 * BLOCK]);
        // Any address inside will do.
        change(&mut nor, &order(byte, 2 * BLOCK + 77));
        assert_eq!(read(&mut nor, 2 * BLOCK - 1, 1), [0]);
        assert_eq!(read(&mut nor, 2 * BLOCK, size), vec![0xff; size]);
        assert_eq!(read(&mut nor, 2 * BLOCK + size, 1), [0]);
        assert_eq!((nor.erases(2 * BLOCK), nor.erases(0)), (1, 0));
    }
}

#[test]
fn it_is_busy_for_as_long_as_its_data_sheet_says_and_deaf_meanwhile() {
    let mut nor = Nor::new(Part::W25Q32JV, UID);
    talk(&mut nor, &[0x06], 0);
    talk(&mut nor, &order(0x20, 0), 0);
    assert_eq!(talk(&mut nor, &[0x05], 1), [0x01]);
    assert_eq!(
        talk(&mut nor, &[0x9f], 3),
        [0xff; 3],
        "no chip drives the line"
    );
    nor.pass(44_000_000);
    assert!(nor.busy());
    nor.pass(1_000_000);
    assert!(!nor.busy());
    assert_eq!(nor.misuse(), [Misuse::WhileBusy(0x9f)]);
}

#[test]
fn protection_guards_what_the_data_sheets_say() {
    let quarter = |part: Part, bits: u8| {
        let mut nor = Nor::new(part.with(Times::QUICK), UID);
        change(&mut nor, &[0x01, bits << 2]);
        nor.protected()
    };
    assert_eq!(quarter(Part::W25Q32JV, 0b101), 0x30_0000..0x40_0000);
    assert_eq!(quarter(Part::W25Q16JV, 0b100), 0x18_0000..0x20_0000);
    assert_eq!(quarter(Part::GD25Q16C, 0b100), 0x18_0000..0x20_0000);
    assert_eq!(quarter(Part::W25Q32JV, 0b111), 0..0x40_0000);
    assert_eq!(quarter(Part::W25Q32JV, 0b001), 0x3f_0000..0x40_0000);
    assert_eq!(
        protected(4 << 20, [0x34, 0, 0]),
        0..0x10_0000,
        "from the bottom"
    );
    assert_eq!(
        protected(4 << 20, [0x34, 0x40, 0]),
        0x10_0000..0x40_0000,
        "the complement"
    );
    assert_eq!(
        protected(4 << 20, [0x44, 0, 0]),
        0x3f_f000..0x40_0000,
        "a sector"
    );
    assert!(quarter(Part::W25Q32JV, 0).is_empty());
}

#[test]
fn what_is_protected_stays_as_it_is_even_if_only_part_of_an_erase_would_touch_it() {
    let mut nor = chip();
    nor.preload(0x3f_0000, &[0x55]);
    change(&mut nor, &[0x01, 0b101 << 2]);
    for bytes in [
        [&order(0x02, 0x3f_0000)[..], &[0]].concat(),
        order(0x20, 0x3f_0000),
        order(0xd8, 0x3f_0000),
        vec![0xc7],
    ] {
        change(&mut nor, &bytes);
        assert_eq!(read(&mut nor, 0x3f_0000, 1), [0x55]);
    }
    assert_eq!(nor.misuse().len(), 4);
    program(&mut nor, 0x2f_ffff, &[0x12]);
    assert_eq!(read(&mut nor, 0x2f_ffff, 1), [0x12]);
}

#[test]
fn protection_survives_a_power_cycle_but_not_as_a_volatile_write() {
    let mut nor = chip();
    talk(&mut nor, &[0x50], 0);
    talk(&mut nor, &[0x01, 0x14], 0);
    wait(&mut nor);
    assert!(!nor.protected().is_empty());
    nor.power_up();
    assert!(nor.protected().is_empty());
    change(&mut nor, &[0x01, 0x14]);
    nor.power_up();
    assert_eq!(nor.protected(), 0x30_0000..0x40_0000);
}

#[test]
fn an_order_that_ends_inside_a_byte_is_none() {
    let mut nor = chip();
    nor.select();
    nor.byte(0x06);
    nor.deselect(3);
    assert_eq!(talk(&mut nor, &[0x05], 1), [0]);
    assert_eq!(nor.misuse(), [Misuse::Incomplete(0x06)]);
}

#[test]
fn reads_run_on_and_begin_again_at_the_end() {
    let mut nor = chip();
    nor.preload(0x3f_fffe, &[1, 2]);
    nor.preload(0, &[3, 4]);
    assert_eq!(read(&mut nor, 0x3f_fffe, 4), [1, 2, 3, 4]);
    assert_eq!(
        talk(&mut nor, &[0x0b, 0x3f, 0xff, 0xfe, 0], 4),
        [1, 2, 3, 4]
    );
}

// ---- power --------------------------------------------------------------------------------------

#[test]
fn a_program_can_be_cut_at_each_of_its_bytes() {
    for step in 0..4 {
        let mut nor = chip();
        nor.cut_at(Cut {
            step,
            seed: 7,
            order: Order::InOrder,
        });
        program(&mut nor, 0, &[0; 4]);
        assert!(nor.dead());
        assert_eq!(
            read(&mut nor, 0, 2),
            [0xff, 0xff],
            "a dead chip says nothing"
        );
        nor.power_up();
        let cells = read(&mut nor, 0, 4);
        let step = step as usize;
        assert!(cells[..step].iter().all(|b| *b == 0), "{cells:x?}");
        assert!(cells[step + 1..].iter().all(|b| *b == 0xff), "{cells:x?}");
    }
}

#[test]
fn the_byte_that_was_cut_is_anything_between() {
    let halves: std::collections::HashSet<u8> = (0..500)
        .map(|seed| {
            let mut nor = chip();
            nor.cut_at(Cut {
                step: 0,
                seed,
                order: Order::InOrder,
            });
            program(&mut nor, 0, &[0]);
            nor.cells()[0]
        })
        .collect();
    assert!(halves.len() > 150, "{} of 256", halves.len());
}

#[test]
fn an_erase_can_be_cut_before_while_clearing_while_setting_and_just_before_its_end() {
    let left = |step: u64| {
        let mut nor = chip();
        nor.preload(0, &[0xa5; SECTOR]);
        nor.cut_at(Cut {
            step,
            seed: 3,
            order: Order::InOrder,
        });
        change(&mut nor, &order(0x20, 0));
        assert!(nor.dead());
        assert_eq!(nor.cells()[SECTOR], 0xff);
        nor.cells()[..SECTOR].to_vec()
    };
    assert_eq!(left(0), [0xa5; SECTOR]);
    assert_eq!(left(4), [0; SECTOR]);
    let ones = |cells: &[u8]| cells.iter().map(|c| c.count_ones()).sum::<u32>();
    let shares: Vec<u32> = (0..ERASE_STEPS).map(|step| ones(&left(step))).collect();
    assert!(shares[..5].is_sorted_by(|a, b| a > b), "{shares:?}");
    assert!(shares[4..].is_sorted(), "{shares:?}");
    let missing = 8 * SECTOR as u32 - shares[ERASE_STEPS as usize - 1];
    assert!(
        (1..200).contains(&missing),
        "{missing} bits are missing at last"
    );
}

#[test]
fn without_a_cut_all_steps_are_counted() {
    let mut nor = chip();
    program(&mut nor, 0, &[0; 10]);
    change(&mut nor, &order(0x20, 0));
    change(&mut nor, &[0x01, 0x14]);
    assert_eq!(nor.steps(), 10 + ERASE_STEPS + 1);
}

#[test]
fn a_chip_in_a_file_is_there_the_next_time() {
    let path = std::env::temp_dir().join(format!("ferrocnc-nor-{}", std::process::id()));
    let _ = std::fs::remove_file(&path);
    {
        let mut nor =
            Nor::in_file(&path, Part::GD25Q16C.with(Times::QUICK), UID).expect("a new one");
        program(&mut nor, 0x1f_fff0, b"golden");
        change(&mut nor, &[0x01, 0x10, 0x00]);
    }
    let nor = Nor::in_file(&path, Part::W25Q32JV, UID).expect("the same one");
    assert_eq!(nor.part().bytes, 2 << 20, "its size says which it is");
    assert_eq!(nor.cells()[0x1f_fff0..][..6], *b"golden");
    assert_eq!(nor.protected(), 0x18_0000..0x20_0000);
    std::fs::write(&path, b"short").expect("written");
    assert!(Nor::in_file(&path, Part::W25Q32JV, UID).is_err());
    let _ = std::fs::remove_file(beside(&path));
    let _ = std::fs::remove_file(&path);
}

// ---- wires --------------------------------------------------------------------------------------

/// A master on the wires: SCK a quarter of the clock, as `rtl/spi.sv`.
struct Master {
    wires: Wires,
    now: u64,
}

impl Master {
    fn set(&mut self, cs_n: bool, sck: bool, mosi: bool) -> bool {
        self.now += 33;
        self.wires.set(self.now, cs_n, sck, mosi)
    }

    fn byte(&mut self, byte: u8) -> u8 {
        (0..8).rev().fold(0, |came, bit| {
            let mosi = byte >> bit & 1 != 0;
            self.set(false, false, mosi);
            let miso = self.set(false, true, mosi);
            let held = self.wires.set(self.now + 1, false, true, !mosi);
            assert_eq!(miso, held, "MISO moves with falling edges only");
            self.set(false, false, mosi);
            came << 1 | u8::from(miso)
        })
    }

    fn talk(&mut self, send: &[u8], read: usize) -> Vec<u8> {
        self.set(false, false, false);
        for byte in send {
            self.byte(*byte);
        }
        let answer = (0..read).map(|_| self.byte(0)).collect();
        self.set(true, false, false);
        answer
    }
}

#[test]
fn an_idle_bus_reads_ones_and_a_clock_without_select_is_noted() {
    let mut wires = Wires::new(Shared::new(chip()));
    assert!(wires.set(0, true, false, false));
    assert!(wires.set(1, true, true, false));
    assert_eq!(wires.chip().chip().misuse(), [Misuse::StrayClock]);
}

proptest! {
    /// Both front ends are the same chip.
    #[test]
    fn wires_and_bytes_agree(
        talks in prop::collection::vec(
            (prop::sample::select(vec![0x06u8, 0x05, 0x35, 0x9f, 0x03, 0x0b, 0x02, 0x20, 0x4b, 0x01, 0x04]),
             prop::collection::vec(any::<u8>(), 0..8), 0usize..6),
            1..40),
    ) {
        let mut by_bytes = chip();
        let by_wires = Shared::new(chip());
        let mut master = Master { wires: Wires::new(by_wires.clone()), now: 0 };
        for (order, operands, count) in talks {
            let send: Vec<u8> = std::iter::once(order).chain(operands).collect();
            prop_assert_eq!(talk(&mut by_bytes, &send, count), master.talk(&send, count));
            // Each keeps its own time: let both be ready.
            by_bytes.pass(10_000);
            master.now += 10_000;
        }
        let by_wires = by_wires.chip();
        prop_assert!(by_bytes.cells() == by_wires.cells());
        prop_assert_eq!(by_bytes.misuse(), by_wires.misuse());
        prop_assert_eq!(by_bytes.registers(), by_wires.registers());
    }

    /// With any input nothing panics and nothing protected changes.
    #[test]
    fn noise_hurts_nothing_that_is_protected(
        talks in prop::collection::vec(prop::collection::vec(any::<u8>(), 0..300), 1..60),
    ) {
        let mut nor = chip();
        nor.preload(0x3f_0000, &[0x42; 16]);
        change(&mut nor, &[0x01, 0x94, 0x01]);
        for bytes in talks {
            talk(&mut nor, &[0x06], 0);
            talk(&mut nor, &bytes, 4);
            nor.pass(10_000);
        }
        prop_assert_eq!(&nor.cells()[0x3f_0000..0x3f_0010], &[0x42; 16]);
    }
}
