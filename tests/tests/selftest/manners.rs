//! What the self-test changes on a good board, and what it does not change.

use crate::rig::*;
use ferrocnc_tests::flash;
use host::client::ClientError;
use host::selftest::Verdict;
use host::selftest::run::{Bench, Plan, idle, run};
use sim::environment::Output;
use sim::server::Device;
use std::sync::Arc;
use std::time::Duration;
use wire::map;
use wire::settings::{Settings, mac_of_uid};

#[test]
fn a_healthy_board_with_all_its_jumpers_is_found_healthy() {
    let board = Board::healthy();
    let report = board.test(true, &LOOPS);
    println!("{}", report.to_text());
    bad(&report, &[]);
    let good = |check: &str| {
        let of = |f: &&host::selftest::Finding| f.check == check;
        let finding = report.findings.iter().find(of);
        finding.unwrap_or_else(|| panic!("no {check}")).verdict == Verdict::Good
    };
    for check in [
        "gateware and firmware",
        "start",
        "gate",
        "flash",
        "flash slot A",
        "flash golden",
        "phy",
        "frames thrown away",
        "traffic",
        "system clock",
        "ethernet clock",
        "output pads",
        "output 0 out-00",
        "output stepgen 0 sg-00 STEP",
        "output stepgen 5 sg-05 DIR",
        "output pwm 4 pwm-04",
    ] {
        assert!(good(check), "{check}: {}", report.to_text());
    }
    for jumper in LOOPS {
        assert!(good(&format!("loop {jumper}")), "{}", report.to_text());
    }
    assert!(good("output 3 out-03"), "{}", report.to_text());
}

#[test]
fn an_input_that_follows_an_output_without_a_jumper_named_is_told() {
    let report = Board::healthy().test(true, &[]);
    bad(&report, &[]);
    let coupled = report
        .findings
        .iter()
        .find(|f| f.check == "output 3 out-03");
    let coupled = coupled.expect("output 3");
    assert_eq!(coupled.verdict, Verdict::Note);
    assert!(coupled.fact.contains("input 2 follows it"), "{coupled:?}");
}

#[test]
fn nothing_is_armed_that_was_not_asked_for() {
    let board = Board::healthy();
    let report = board.test(false, &[]);
    bad(&report, &[]);
    let mut twin = board.twin();
    let events = twin.environment_mut().take_events();
    assert_eq!(events, [], "the gate stayed closed");
    assert_eq!(twin.environment().edges.channel(0).count, 0);
}

#[test]
fn a_test_leaves_the_board_disarmed_free_and_set_as_it_was() {
    let board = Board::healthy();
    let settings: Vec<u32> = (0..8)
        .map(|n| map::CONFIG_STEPGEN + 4 * n)
        .chain((0..6).map(|n| map::CONFIG_ENCODER + n * map::CONFIG_STRIDE))
        .chain((0..5).map(|n| map::CONFIG_BOARD + 4 * n))
        .chain((0..11).map(|n| map::CONFIG_DEBOUNCE + 4 * n))
        .collect();
    let before = board.client().read(&settings).expect("settings");
    bad(&board.test(false, &LOOPS), &[]);
    let after = board.client().read(&settings).expect("settings");
    assert_eq!(before, after);
    let owner = board
        .client()
        .read(&[map::SESSION_OWNER_IP])
        .expect("an answer");
    assert_eq!(owner, [0]);
    let mut twin = board.twin();
    assert_eq!(twin.environment_mut().pins().gate, 0);
    let gate = twin.environment_mut().take_events();
    let opened = gate.iter().filter(|e| e.output == Output::Gate && e.level);
    assert_eq!(
        opened.count(),
        LOOPS.len(),
        "it was armed once for each part"
    );
    // Step generator 1 spoke quadrature: its pins rest where they are, and move when it speaks
    // steps again.
    let edges = &twin.environment_mut().edges;
    let broken = edges.violations().iter().filter(|v| v.channel != 1);
    assert_eq!(broken.count(), 0, "{:?}", edges.violations());
    drop(twin);

    // The outputs are two parts: the general ones, and those of step generators and PWMs.
    bad(&board.test(true, &LOOPS), &[]);
    let after = board.client().read(&settings).expect("settings");
    assert_eq!(before, after);
    let mut twin = board.twin();
    let pins = *twin.environment_mut().pins();
    assert_eq!((pins.gate, pins.pwm_out), (0, 0));
    let gate = twin.environment_mut().take_events();
    let opened = gate.iter().filter(|e| e.output == Output::Gate && e.level);
    assert_eq!(opened.count(), 2 + LOOPS.len());
}

#[test]
fn a_report_holds_no_key_no_mac_and_no_unique_id() {
    let board = Board::healthy();
    let report = board.test(true, &LOOPS);
    let text = report.to_text() + &report.to_json().to_string();
    let text = text.to_lowercase();
    let bytes =
        |bytes: &[u8]| -> Vec<String> { bytes.iter().map(|b| format!("{b:02x}")).collect() };
    let mac = bytes(&mac_of_uid([(UID >> 32) as u32, UID as u32]));
    let uid = bytes(&UID.to_be_bytes());
    let ip = board.client().read(&[map::FLASH_IP]).expect("its address")[0];
    for secret in [
        mac.join(":"),
        mac.concat(),
        uid.concat(),
        "d162-0c8a".to_owned(),
        std::net::Ipv4Addr::from(ip).to_string(),
        "127.0.0.1".to_owned(),
    ] {
        assert!(!text.contains(&secret), "{secret}: {text}");
    }
}

#[test]
fn a_board_held_by_its_external_reset_is_not_driven_and_says_so() {
    let board = Board::healthy();
    board.twin().environment_mut().ext_reset(true);
    let report = board.test(false, &LOOPS[..1]);
    bad(&report, &[("loop sg-00=enc-02", "external reset")]);
}

#[test]
fn a_board_that_falls_silent_leaves_a_report_of_what_was_seen_before() {
    let board = Board::healthy();
    let identity = board.identity();
    board.twin().freeze_cpu(true);
    let connect = || Ok::<_, ClientError>(board.client().with_patience(Duration::from_millis(400)));
    let mut time = BoardTime {
        twin: Arc::clone(&board.twin),
        rate: 1.0,
    };
    let report = run(
        &identity,
        &Plan::default(),
        &mut Bench {
            connect: &connect,
            time: &mut time,
            tell: &|_| {},
        },
    );
    bad(&report, &[("answers", "stopped answering")]);
    let text = report.to_text();
    assert!(
        text.contains("configuration") && !text.contains("127.0.0.1"),
        "{text}"
    );
}

#[test]
fn a_board_with_a_key_that_is_not_here_is_looked_at_and_not_driven() {
    let mut nor = nor();
    let settings = Settings {
        sequence: 1,
        key: [1, 2, 3, 4],
        ..Settings::default()
    };
    let at = flash::layout(&nor).settings as usize;
    nor.preload(at, &ferrocnc_tests::to_bytes(&settings.to_words()));
    let report = Board::start(setup(nor, &jumpers())).test(false, &LOOPS[..1]);
    bad(&report, &[("loop sg-00=enc-02", "the board has a key")]);
    let skipped = report.findings.iter().find(|f| f.check == "flash images");
    assert_eq!(skipped.expect("told").verdict, Verdict::Skipped);
}

#[test]
fn a_board_in_use_is_left_alone() {
    let board = Board::healthy();
    let mut owner = board.client();
    owner.acquire().expect("the session");
    let mut client = board.client();
    let identity = client.identify().expect("a board");
    let refused = idle(&mut client, &identity).expect_err("it is owned");
    assert!(refused.to_string().contains("is driven by"), "{refused}");
}
