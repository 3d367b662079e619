//! Defects of the SDRAM, the flash, the cable, the clock and the jumpers.

use crate::rig::*;
use ferrocnc_tests::flash::{self, factory};
use sim::nor::{Nor, Part, Times};
use sim::plant::{Sink, Source};
use sim::server::Device;

#[test]
fn a_bad_sdram_is_found() {
    let mut setup = setup(nor(), &[]);
    setup.sdram = false;
    bad(
        &Board::start(setup).test(false, &[]),
        &[("sdram", "failed its test")],
    );
}

#[test]
fn a_flash_that_is_not_there_or_of_another_kind_is_found() {
    for (jedec, said) in [
        ([0xff, 0xff, 0xff], "no flash answers"),
        ([0, 0, 0], "no flash answers"),
        ([0xef, 0x40, 0x18], "of an unknown kind"),
        ([0xef, 0x40, 0x15], "this platform has 4 MiB"),
    ] {
        let mut nor = nor();
        if jedec == [0xef, 0x40, 0x15] {
            nor = factory(Part::W25Q16JV.with(Times::QUICK), UID);
        } else {
            let part = Part {
                jedec,
                ..Part::W25Q32JV.with(Times::QUICK)
            };
            let cells = nor.cells().to_vec();
            nor = Nor::new(part, UID);
            nor.preload(0, &cells);
        }
        let report = Board::start(setup(nor, &[])).test(false, &[]);
        bad(&report, &[("flash", said)]);
    }
}

#[test]
fn a_bit_that_fell_over_in_an_image_is_found() {
    let mut nor = nor();
    let golden = flash::layout(&nor).golden.start as usize;
    let byte = nor.cells()[golden + 100] ^ 4;
    nor.preload(golden + 100, &[byte]);
    let report = Board::start(setup(nor, &[])).test(false, &[]);
    bad(&report, &[("flash golden", "its meta page says")]);

    // In the selected one, the FPGA has found it first.
    let mut nor = self::nor();
    let slot = flash::layout(&nor).slot_a.start as usize;
    let byte = nor.cells()[slot + 100] ^ 4;
    nor.preload(slot + 100, &[byte]);
    let report = Board::start(setup(nor, &[])).test(false, &[]);
    let expected = [
        ("flash image that runs", "did not load"),
        ("flash slot A", "its meta page says"),
    ];
    bad(&report, &expected);
}

#[test]
fn a_cable_that_loses_or_damages_frames_is_found() {
    let trouble = |words: &str| {
        let board = Board::healthy();
        let identity = board.identity();
        drop(identity);
        let plan = words.parse().expect("a plan");
        board.twin().trouble(&plan).expect("trouble");
        board.test(false, &[])
    };
    let lost = trouble("from-board:loss=2% seed=7");
    bad(&lost, &[("traffic", "were lost")]);
    let damaged = trouble("to-board:corrupt=2% seed=7");
    bad(
        &damaged,
        &[
            ("frames thrown away", "MAC damaged"),
            ("traffic", "were lost"),
        ],
    );
}

#[test]
fn a_clock_with_the_wrong_crystal_is_found_and_one_with_a_tolerable_one_is_not() {
    let clock = |rate| {
        let mut board = Board::healthy();
        board.rate = rate;
        board.test(false, &[])
    };
    bad(&clock(1.0001), &[]);
    bad(
        &clock(0.8),
        &[("system clock", "another crystal or divider")],
    );
    bad(
        &clock(1.04),
        &[("system clock", "another crystal or divider")],
    );
}

#[test]
fn an_output_that_is_stuck_and_a_jumper_that_is_missing_are_found() {
    let mut stuck = jumpers();
    stuck[4].from = Source::Stuck(true);
    let report = Board::with(&stuck).test(false, &LOOPS);
    bad(&report, &[("loop output.3=in-02", "stays high")]);
    stuck[4].from = Source::Stuck(false);
    let report = Board::with(&stuck).test(false, &LOOPS);
    bad(&report, &[("loop output.3=in-02", "stays low")]);

    let missing = &jumpers()[2..];
    let report = Board::with(missing).test(false, &LOOPS[..1]);
    bad(&report, &[("loop sg-00=enc-02", "no pulse arrives")]);

    // Only STEP is there: no pulse is lost, and that DIR is not seen is said.
    let mut alone = jumpers();
    alone[1].from = Source::Stuck(false);
    let report = Board::with(&alone).test(false, &LOOPS[..1]);
    bad(&report, &[]);
    let said = report.to_text();
    assert!(said.contains("DIR does not arrive at B"), "{said}");
}

#[test]
fn crossed_jumpers_are_found() {
    let mut crossed = jumpers();
    (crossed[4].to, crossed[5].to) = (crossed[5].to, crossed[4].to);
    let report = Board::with(&crossed).test(false, &LOOPS[3..]);
    let expected = [
        ("loop output.3=in-02", "at input 3 instead"),
        ("loop pwm-04=in-03", "at input 2 instead"),
    ];
    bad(&report, &expected);

    let mut other = jumpers();
    (other[0].to, other[1].to) = (Sink::A(5), Sink::B(5));
    let report = Board::with(&other).test(false, &LOOPS[..1]);
    bad(&report, &[("loop sg-00=enc-02", "encoder 5 counted")]);

    let mut turned = jumpers();
    (turned[0].to, turned[1].to) = (Sink::B(2), Sink::A(2));
    let report = Board::with(&turned).test(false, &LOOPS[..1]);
    bad(&report, &[("loop sg-00=enc-02", "STEP arrives at B")]);
}

#[test]
fn an_encoder_that_misses_steps_is_found() {
    let mut weak = jumpers();
    weak[0].misses = 50;
    let report = Board::with(&weak).test(false, &LOOPS[..1]);
    bad(&report, &[("loop sg-00=enc-02", "steps are missing")]);
}
