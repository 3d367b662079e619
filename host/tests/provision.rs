//! Library and tool on a segment of fake boards: find boards, tell them apart, give them addresses.

#[path = "common/fake_board.rs"]
mod common;
#[path = "common/tool.rs"]
mod ferrocnc_tool;

use common::flash::LanSegment;
use common::{FakeBoard, Time};
use ferrocnc::address;
use ferrocnc::client::Client;
use ferrocnc::discovery::Finder;
use ferrocnc::flash::Overview;
use ferrocnc::keys::Keys;
use ferrocnc::provision::{self, Change, ProvisionError};
use ferrocnc::uid::uid_text;
use ferrocnc_tool::{answer, complaint};
use std::net::Ipv4Addr;
use std::time::Duration;
use wire::flash::Origin;
use wire::settings::{Settings, mac_of_uid};
use wire::{Name, State};

const UIDS: [[u32; 2]; 3] = [[0xd162_0c8a, 1], [0xd162_0c8a, 2], [0xd162_0c8a, 3]];
const WAIT: Duration = Duration::from_millis(600);

fn named(name: &str, ip: [u8; 4]) -> Change {
    Change {
        ip: Some((Ipv4Addr::from(ip), None)),
        name: Some(Name::new(name).unwrap()),
        ..Change::default()
    }
}

fn client(board: &FakeBoard) -> Client {
    Client::open(&address::parse(&board.text(), 1234).unwrap()).unwrap()
}

#[test]
fn three_boards_with_one_address_are_told_apart_and_renamed_one_by_one() {
    let segment = LanSegment::of(&UIDS);
    let finder = Finder::at(segment.address).unwrap();
    let found = finder.all(WAIT).unwrap();
    assert_eq!(found.iter().map(|f| f.uid).collect::<Vec<_>>(), UIDS);
    assert!(found.iter().all(|f| f.here.ip == 0xc0a8_0232));
    for (n, uid) in UIDS.iter().enumerate() {
        let change = named(&format!("mill-{n}"), [192, 168, 2, 60 + n as u8]);
        let found = provision::set_by_uid(&finder, *uid, &change, &Keys::default()).unwrap();
        assert_eq!(found.here.name.text(), format!("mill-{n}"));
    }
    let ips: Vec<u32> = finder
        .all(WAIT)
        .unwrap()
        .iter()
        .map(|f| f.here.ip & 0xff)
        .collect();
    assert_eq!(ips, [60, 61, 62]);
    assert!(segment.look().iter().all(|board| board.saved == 1));
}

#[test]
fn a_lost_answer_is_asked_for_again_and_nothing_is_saved_twice() {
    let segment = LanSegment::of(&UIDS);
    let finder = Finder::at(segment.address).unwrap();
    segment.look()[1].lose = 2;
    assert_eq!(
        finder.one(UIDS[1], Duration::from_secs(3)).unwrap().uid,
        UIDS[1]
    );
    segment.look()[1].lose = 2;
    let settings = Settings {
        name: Name::new("again").unwrap(),
        ..Settings::default()
    };
    finder.set(UIDS[1], &settings, &Keys::default()).unwrap();
    assert_eq!(segment.look()[1].saved, 1);
}

#[test]
fn an_armed_board_and_an_unknown_one_are_said_in_a_sentence() {
    let segment = LanSegment::of(&UIDS);
    let finder = Finder::at(segment.address).unwrap();
    segment.look()[2].armed = true;
    let said = provision::set_by_uid(
        &finder,
        UIDS[2],
        &named("x", [192, 168, 2, 9]),
        &Keys::default(),
    );
    assert!(said.unwrap_err().to_string().contains("stop LinuxCNC"));
    assert_eq!(segment.look()[2].flash.origin, Origin::BuiltIn);
    let said = finder.one([9, 9], WAIT).unwrap_err().to_string();
    assert!(
        said.contains("0000-0009-0000-0009 does not answer"),
        "{said}"
    );
}

#[test]
fn what_is_not_asked_for_stays_and_a_mac_made_from_the_id_stays_that() {
    let segment = LanSegment::of(&UIDS);
    let finder = Finder::at(segment.address).unwrap();
    segment.look()[0].flash.settings.port = 4321;
    let change = Change {
        name: Some(Name::new("lathe").unwrap()),
        ..Change::default()
    };
    provision::set_by_uid(&finder, UIDS[0], &change, &Keys::default()).unwrap();
    let boards = segment.look();
    let settings = boards[0].flash.settings;
    assert_eq!((settings.port, settings.ip), (4321, 0xc0a8_0232));
    assert_eq!(
        (settings.mac, boards[0].flash.mac()),
        ([0; 6], mac_of_uid(UIDS[0]))
    );
    assert_eq!(settings.name.text(), "lathe");
}

#[test]
fn boards_that_share_an_address_are_not_reached_by_it() {
    let segment = LanSegment::of(&UIDS);
    let finder = Finder::at(segment.address).unwrap();
    let said = provision::reach(&finder, UIDS[1]).unwrap_err();
    assert!(matches!(said, ProvisionError::Shared { .. }));
    let said = said.to_string();
    assert!(
        said.contains("3 boards have the address 192.168.2.50"),
        "{said}"
    );
    assert!(
        said.contains(&format!("ferrocnc set --uid {}", uid_text(UIDS[1]))),
        "{said}"
    );
}

#[test]
fn settings_over_the_address_are_saved_with_the_key_kept_and_the_board_starts_anew() {
    let board = FakeBoard::mill6(Time::Lockstep(60_000));
    board.look().flash.settings.key = [1, 2, 3, 4];
    board.look().flash.settings.gateway = 0xc0a8_0201;
    let boots = board.look().boot_id;
    let change = named("mill", [192, 168, 2, 51]);
    let settings = provision::set_at(client(&board), &change).unwrap();
    assert_eq!(settings.ip, 0xc0a8_0233);
    {
        let mind = board.look();
        assert_eq!(mind.flash.settings.key, [1, 2, 3, 4]);
        assert_eq!(mind.flash.settings.gateway, 0xc0a8_0201);
        assert_eq!(mind.flash.settings.name.text(), "mill");
        assert_eq!(mind.flash.settings.mac, [0; 6], "made from the id, not set");
        assert!(mind.boot_id > boots);
    }
    // From now on the board requires its key; with the factory pin held it does not.
    let said = provision::forget_at(client(&board).with_keys(Keys::File("/none".into())));
    assert!(said.unwrap_err().to_string().contains("requires a key"));
    board.look().key = None;
    provision::forget_at(client(&board)).unwrap();
    let overview = Overview::read(&mut client(&board)).unwrap();
    assert_eq!(overview.origin, Origin::BuiltIn);
}

#[test]
fn an_armed_board_keeps_its_settings_and_says_why() {
    let board = FakeBoard::mill6(Time::Lockstep(60_000));
    board.look().state = State::Armed;
    let said = provision::set_at(client(&board), &named("mill", [10, 0, 0, 2])).unwrap_err();
    assert!(said.to_string().contains("the machine is armed"), "{said}");
    assert_eq!(board.look().flash.settings, Settings::default());
}

#[test]
fn the_tool_lists_sets_and_warns() {
    let segment = LanSegment::of(&UIDS);
    let at = segment.address.to_string();
    let text = answer(&["discover", "--at", &at, "--wait", "600"]);
    for part in [
        "d162-0c8a-0000-0001",
        "192.168.2.50:1234",
        "5a-75b-8.0",
        "mill6",
        "1000 Mbit/s",
    ] {
        assert!(text.contains(part), "{part} missing in:\n{text}");
    }
    assert!(
        text.contains("Several boards have the address 192.168.2.50"),
        "{text}"
    );
    assert!(!text.contains("MAC"), "made from the ids: {text}");
    for board in segment.look().iter_mut().take(2) {
        board.flash.settings.mac = [0x10, 0xe2, 0xd5, 0, 0, 1];
    }
    let text = answer(&["discover", "--at", &at, "--wait", "600"]);
    assert!(
        text.contains("Several boards have the MAC address 10:e2:d5:00:00:01"),
        "{text}"
    );
    let said = answer(&[
        "set",
        "--at",
        &at,
        "--uid",
        "d1620c8a00000002",
        "--ip",
        "192.168.2.51",
        "--name",
        "lathe",
    ]);
    assert!(
        said.contains("d162-0c8a-0000-0002 has 192.168.2.51:1234"),
        "{said}"
    );
    assert!(said.contains("name lathe"), "{said}");
    let json = answer(&["--json", "discover", "--at", &at, "--wait", "600"]);
    let json: serde_json::Value = serde_json::from_str(&json).unwrap();
    let boards = json["boards"].as_array().unwrap();
    assert_eq!(boards.len(), 3);
    let lathe = boards
        .iter()
        .find(|board| board["name"] == "lathe")
        .unwrap();
    assert_eq!(lathe["ip"], "192.168.2.51");
    assert_eq!(lathe["settings"], "flash, copy 0");
}

#[test]
fn what_cannot_be_set_is_said_before_anything_is_sent() {
    for (arguments, expected) in [
        (&["set", "--uid", "d162"][..], "16 hex digits"),
        (&["set", "192.168.2.50"], "nothing to set"),
        (&["set", "--name", "x"], "--uid"),
        (&["set", "192.168.2.50", "--ip", "ten"], "192.168.2.51/24"),
        (
            &["set", "192.168.2.50", "--mac", "1:2:3"],
            "02:12:34:56:78:9a",
        ),
        (
            &["set", "192.168.2.50", "--factory", "--dhcp"],
            "cannot be used with",
        ),
        (
            &["discover", "--interface", "no-such-if0"],
            "no interface \"no-such-if0\"",
        ),
        (&["update"], "--uid"),
        (
            &["update", "192.168.2.50", "a.bit", "--board", "mill6"],
            "cannot be used with",
        ),
        (
            &[
                "update",
                "192.168.2.50",
                "a.bit",
                "--uid",
                "d1620c8a1b2c3d4e",
            ],
            "leave its address out",
        ),
        (
            &["update", "--uid", "d1620c8a1b2c3d4e", "/nowhere.bit"],
            "cannot read /nowhere.bit",
        ),
        (
            &[
                "update",
                "--uid",
                "d1620c8a1b2c3d4e",
                "a.bit",
                "--board",
                "mill6",
            ],
            "name one of the two",
        ),
        (
            &["update", "192.168.2.50", "/nowhere.bit"],
            "cannot read /nowhere.bit",
        ),
    ] {
        let said = complaint(arguments);
        assert!(said.contains(expected), "{arguments:?}: {said}");
    }
}

#[test]
fn the_tool_updates_and_says_what_runs_now_and_after_the_next_power_up() {
    let board = FakeBoard::mill6(Time::Lockstep(60_000));
    board.look().flash.looks = 0;
    let file = std::path::Path::new(env!("CARGO_TARGET_TMPDIR")).join("provision-update.bit");
    let bytes = ferrocnc::image::sample::file("mill6", "5a-75b-8.0", 0xabcd, 5000);
    std::fs::write(&file, &bytes).unwrap();
    let path = file.to_str().unwrap();
    let text = answer(&["update", &board.text(), path]);
    for part in [
        "slot A holds mill6 on 5a-75b-8.0, build 0000abcd",
        "runs now:              volatile (loaded by JTAG), build 0b1d0000",
        "after next power-up:   slot A, build 0000abcd",
        "Power the board off and on",
    ] {
        assert!(text.contains(part), "{part} missing in:\n{text}");
    }
    let json = answer(&["--json", "update", &board.text(), path, "--slot", "b"]);
    let json: serde_json::Value = serde_json::from_str(&json).unwrap();
    assert_eq!(
        (&json["slot"], &json["selected"]),
        (&"B".into(), &"B".into())
    );
    std::fs::write(&file, &bytes[..bytes.len() - 1]).unwrap();
    let said = complaint(&["update", &board.text(), path]);
    assert!(
        said.contains("provision-update.bit: it is cut short"),
        "{said}"
    );
    let text = answer(&["describe", &board.text()]);
    for part in [
        "d162-0c8a-1b2c-3d4e",
        "JEDEC id ef4015, 2 MiB, golden image protected",
        "after power-up slot B",
        "192.168.2.50/24:1234, MAC 02:",
        " from the unique id (built in)",
        "1000 Mbit/s, full duplex",
    ] {
        assert!(text.contains(part), "{part} missing in:\n{text}");
    }
}

/// The installed images: of these board files, for these cards.
fn packaged(name: &str, boards: &[(&str, &str)]) -> String {
    let images = std::path::Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
    let _ = std::fs::remove_dir_all(&images);
    for (configuration, platform) in boards {
        let folder = images.join(configuration);
        std::fs::create_dir_all(&folder).unwrap();
        let file = |build| ferrocnc::image::sample::file(configuration, platform, build, 5000);
        let image = |build| ferrocnc::image::Image::parse(&file(build)).unwrap();
        let flash = ferrocnc::flash_file::sample::file(0x20_0000, &image(0xabcd), &image(2));
        std::fs::write(folder.join(format!("{configuration}.flash")), flash).unwrap();
        std::fs::write(folder.join(format!("{configuration}.bit")), file(0xabcd)).unwrap();
    }
    images.to_str().unwrap().to_owned()
}

#[test]
fn without_a_file_the_installed_image_for_the_boards_card_is_written() {
    let board = FakeBoard::mill6(Time::Lockstep(60_000));
    board.look().flash.looks = 0;
    let cards = [
        ("lathe", "5a-75b-8.0"),
        ("mill6", "5a-75b-8.0"),
        ("mill6e", "5a-75e-7.1"),
    ];
    let images = packaged("update-installed", &cards);
    let update = ["update", &board.text(), "--images", &images];
    let said = answer(&update);
    assert!(said.contains("slot A holds mill6 on 5a-75b-8.0"), "{said}");
    let said = answer(&[&update[..], &["--board", "lathe", "--slot", "b"]].concat());
    assert!(said.contains("slot B holds lathe on 5a-75b-8.0"), "{said}");
    let said = complaint(&[&update[..], &["--board", "mill6e"]].concat());
    assert!(
        said.contains("is mill6e for 5a-75b-8.0") && said.contains("--board"),
        "{said}"
    );
}

#[test]
fn a_card_whose_pins_are_configured_gets_its_own_image_and_never_that_of_a_board_file() {
    let board = FakeBoard::card();
    let fixed = ("mill6", "5a-75b-8.0");
    let images = packaged("update-fixed", &[fixed]);
    let said = complaint(&["update", &board.text(), "--images", &images]);
    assert!(said.contains("is 5a-75b-8.0 for 5a-75b-8.0"), "{said}");
    let images = packaged("update-card", &[fixed, ("5a-75b-8.0", "5a-75b-8.0")]);
    let said = answer(&["update", &board.text(), "--images", &images]);
    let wanted = "slot A holds 5a-75b-8.0 on 5a-75b-8.0";
    assert!(said.contains(wanted), "{said}");
}

#[test]
fn without_an_installed_image_or_a_card_an_update_says_what_to_do() {
    let board = FakeBoard::mill6(Time::Lockstep(60_000));
    let update = |images: &str| complaint(&["update", &board.text(), "--images", images]);
    let said = update("/nowhere");
    assert!(
        said.contains("install the package ferrocnc-images"),
        "{said}"
    );
    let said = update(&packaged("update-other", &[("mill6", "5a-75e-7.1")]));
    assert!(
        said.contains("is mill6 for 5a-75b-8.0; it has mill6 for 5a-75e-7.1"),
        "{said}"
    );
    assert_eq!(said.lines().count(), 1, "{said}");
    // 14 is the card's name.
    board.look().names.retain(|(kind, ..)| *kind != 14);
    let said = update("/nowhere");
    assert!(
        said.contains("does not say which card it is; name a file"),
        "{said}"
    );
}
