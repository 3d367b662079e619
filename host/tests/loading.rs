//! A `loadrt` that fails prints the problem and the remedy in one sentence.

#[path = "common/fake_board.rs"]
mod common;

use common::{FakeBoard, Knobs, Time};
use ferrocnc::address;
use ferrocnc::client::{Client, Identity};
use std::time::{Duration, Instant};

const LOCKSTEP: Time = Time::Lockstep(60_000);

/// All requests of `loadrt` to a board before it exports anything to HAL.
fn connect(address: &str) -> Result<Identity, String> {
    let address = address::parse(address, wire::DEFAULT_PORT).map_err(|e| e.to_string())?;
    let text = |error: ferrocnc::client::ClientError| error.to_string();
    let mut client = Client::open(&address)
        .map_err(text)?
        .with_patience(Duration::from_millis(600));
    let identity = client.identify().map_err(text)?;
    client.check(&identity).map_err(text)?;
    client.acquire().map_err(text)?;
    Ok(identity)
}

fn refused(knobs: Knobs) -> String {
    let board = FakeBoard::mill6(LOCKSTEP);
    board.look().knobs = knobs;
    connect(&board.text()).unwrap_err()
}

#[track_caller]
fn says(message: &str, parts: &[&str]) {
    for part in parts {
        assert!(message.contains(part), "{part:?} missing in: {message}");
    }
    assert!(!message.contains('\n'), "one sentence: {message}");
}

#[test]
fn a_good_board_is_known_by_name_and_owned() {
    let board = FakeBoard::mill6(LOCKSTEP);
    let identity = connect(&board.text()).unwrap();
    let name = identity.blob().text(wire::board::Kind::Configuration, 0);
    assert_eq!(name, Some("mill6"));
    assert!(board.look().owner.is_some());
}

#[test]
fn a_lossy_network_only_costs_time() {
    let board = FakeBoard::mill6(LOCKSTEP);
    board.look().knobs.drop_requests = 2;
    connect(&board.text()).unwrap();
}

#[test]
fn an_unreachable_board_is_named_with_how_long_it_was_tried() {
    let port = std::net::UdpSocket::bind("127.0.0.1:0").unwrap();
    let silent = port.local_addr().unwrap().to_string();
    let start = Instant::now();
    let message = connect(&silent).unwrap_err();
    says(
        &message,
        &[&silent, "no answer", "0.", "check power, cable"],
    );
    assert!(start.elapsed() < Duration::from_secs(5));
    drop(port);
    let message = connect(&silent).unwrap_err();
    says(&message, &[&silent, "refused"]);
}

#[test]
fn a_wrong_abi_is_told_with_both_numbers() {
    let message = refused(Knobs {
        abi_gateware: Some(0x1234_5678),
        ..Knobs::default()
    });
    says(
        &message,
        &["0xfe440c4c", "0x12345678", "flash a matching pair"],
    );
}

#[test]
fn a_wrong_wire_version_is_told_with_both_numbers() {
    let message = refused(Knobs {
        wire_version: Some(7),
        ..Knobs::default()
    });
    let ours = format!("this driver {}", wire::WIRE_VERSION);
    says(&message, &["wire version 7", &ours, "reflash"]);
}

#[test]
fn something_that_is_no_board_is_told_by_its_first_word() {
    let message = refused(Knobs {
        magic: Some(0x4c69_7465),
        ..Knobs::default()
    });
    says(&message, &["not a FerroCNC board", "0x4c697465"]);
}

#[test]
fn a_damaged_board_information_says_so() {
    let message = refused(Knobs {
        bad_blob: true,
        ..Knobs::default()
    });
    says(&message, &["damaged", "rebuild the bitstream"]);
}

#[test]
fn a_board_that_another_host_drives_is_told_with_its_owner() {
    let message = refused(Knobs {
        foreign_owner: Some("192.168.2.7:4711".parse().unwrap()),
        ..Knobs::default()
    });
    says(&message, &["192.168.2.7:4711", "stop LinuxCNC there"]);
}

#[test]
fn a_second_linuxcnc_on_this_computer_is_told_that_it_is_the_second() {
    let board = FakeBoard::mill6(LOCKSTEP);
    let address = address::parse(&board.text(), wire::DEFAULT_PORT).unwrap();
    let mut first = Client::open(&address).unwrap();
    first.acquire().unwrap();
    let port = board.look().owner.unwrap().port();
    let message = connect(&board.text()).unwrap_err();
    let owner = format!("127.0.0.1:{port}");
    says(
        &message,
        &[
            &owner,
            "another program on this computer",
            "stop LinuxCNC there",
        ],
    );
    // And the first goes on undisturbed.
    assert_eq!(board.look().owner.unwrap().port(), port);
}
