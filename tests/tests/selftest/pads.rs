//! Pads, and the Ethernet clock.

use crate::rig::*;
use host::selftest::Verdict;
use sim::pads::{Fault, Pad};
use sim::server::Device;
use wire::map;

#[test]
fn each_pad_that_is_stuck_or_shorted_is_found_as_itself() {
    let low = "driven high, its pad reads low; shorted to ground";
    let high = "driven low, its pad reads high; shorted to a supply";
    let defects = [
        (Fault::Low(Pad::Output(2)), vec![("output 2 out-02", low)]),
        (
            Fault::High(Pad::Output(5)),
            vec![
                ("output pads", "not as they are driven at rest: 5 out-05"),
                ("output 5 out-05", high),
            ],
        ),
        (
            Fault::Short(Pad::Output(1), Pad::Output(4)),
            vec![
                (
                    "output 1 out-01",
                    "not when output 4 out-04 is driven the same way",
                ),
                (
                    "output 4 out-04",
                    "not when output 1 out-01 is driven the same way",
                ),
            ],
        ),
        (
            Fault::Low(Pad::Step(2)),
            vec![("output stepgen 2 sg-02 STEP", low)],
        ),
        (
            Fault::High(Pad::Dir(5)),
            vec![("output stepgen 5 sg-05 DIR", high)],
        ),
        (
            Fault::Short(Pad::Step(3), Pad::Dir(4)),
            vec![
                ("output stepgen 3 sg-03 STEP", low),
                ("output stepgen 4 sg-04 DIR", low),
            ],
        ),
        (Fault::Low(Pad::Pwm(1)), vec![("output pwm 1 pwm-01", low)]),
        (
            Fault::High(Pad::Pwm(0)),
            vec![("output pwm 0 pwm-00", high)],
        ),
    ];
    for (fault, expected) in defects {
        let board = Board::with(&[]);
        board.twin().environment_mut().pads(fault);
        bad(&board.test(true, &[]), &expected);
    }
}

#[test]
fn a_pad_that_follows_another_is_found() {
    // Output 4 rests high: where two fight the low one wins, so it goes with output 1.
    let board = Board::with(&[]);
    let safe = map::CONFIG_BOARD + 4 * map::BoardConfig::GpioSafe as u32;
    let mut client = board.client();
    let session = client.acquire().expect("the session");
    client
        .write_then_read(safe, &[1 << 4], &[safe])
        .expect("a setting");
    client.release(&session);
    board
        .twin()
        .environment_mut()
        .pads(Fault::Short(Pad::Output(1), Pad::Output(4)));
    let report = board.test(true, &[]);
    let expected = [
        ("output pads", "not as they are driven at rest: 4 out-04"),
        (
            "output 1 out-01",
            "that of output 4 out-04 with it; the two are shorted",
        ),
        ("output 4 out-04", "driven high, its pad reads low"),
    ];
    bad(&report, &expected);
}

#[test]
fn a_pad_is_said_to_be_the_fpgas_own() {
    let board = Board::with(&[]);
    let report = board.test(true, &[]);
    for check in [
        "output pads",
        "output 0 out-00",
        "output stepgen 0 sg-00 STEP",
    ] {
        let fact = &finding(&report, check).fact;
        assert!(
            fact.contains("behind") && fact.contains("not seen"),
            "{fact}"
        );
    }
}

#[test]
fn an_ethernet_clock_that_is_off_is_found_and_so_is_which_of_three_it_is() {
    let test = |eth_ppm: i32, rate: f64| {
        let mut setup = setup(nor(), &[]);
        setup.eth_ppm = eth_ppm;
        let mut board = Board::start(setup);
        board.rate = rate;
        board.test(false, &[])
    };
    let tolerable = test(-80, 1.0);
    bad(&tolerable, &[]);
    assert!(
        finding(&tolerable, "ethernet clock")
            .fact
            .starts_with("-80."),
        "{}",
        tolerable.to_text()
    );
    bad(
        &test(5_000, 1.0),
        &[("ethernet clock", "so it is this one")],
    );
    // The host and the Ethernet agree that the board is slow.
    let slow = [
        ("system clock", "another crystal"),
        ("ethernet clock", "so it is the board's"),
    ];
    bad(&test(10_000, 0.99), &slow);
    // The same for the host, and it is the host: the board and the Ethernet agree.
    bad(
        &test(0, 0.99),
        &[("system clock", "another crystal or divider")],
    );
}

#[test]
fn a_link_at_100_has_the_clock_of_100() {
    let board = Board::healthy();
    board.twin().environment_mut().link(0b1011);
    let report = board.test(false, &[]);
    bad(&report, &[]);
    let fact = &finding(&report, "ethernet clock").fact;
    assert!(fact.contains("of 25 MHz"), "{fact}");
}

#[test]
fn gateware_without_read_back_is_told_as_such_and_tested_as_far_as_it_goes() {
    let mut setup = setup(nor(), &jumpers());
    setup.readback = false;
    let report = Board::start(setup).test(true, &LOOPS);
    bad(&report, &[]);
    for check in ["ethernet clock", "output pads"] {
        let skipped = finding(&report, check);
        assert_eq!(skipped.verdict, Verdict::Skipped);
        assert!(skipped.remedy.contains("flash it again"), "{skipped:?}");
    }
    assert!(
        finding(&report, "output 0 out-00")
            .fact
            .contains("the pad is not read")
    );
    assert!(!report.to_text().contains("STEP"), "{}", report.to_text());
}
