//! `ferrocnc config apply` and `read`, against a fake board whose pins are configured.

#[path = "common/fake_board.rs"]
mod common;
#[path = "common/tool.rs"]
mod tool;

use common::{EIGHT, FakeBoard, Time};
use ferrocnc::address;
use ferrocnc::client::{Client, ClientError};
use ferrocnc::flash::FlashError;
use ferrocnc::pins::{Copies, Facts, PinsError, Report};
use ferrocnc_config::pins::configuration;
use ferrocnc_config::read_board;
use std::net::SocketAddrV4;
use std::path::{Path, PathBuf};
use std::time::Duration;
use tool::{answer, complaint};
use wire::State;
use wire::flash::{Op, Origin, PAGE};
use wire::pins::{Built, Loaded, Verdict};

const HERE: Verdict = Verdict::InForce;

fn file(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../boards")
        .join(format!("{name}.toml"))
}

fn path(name: &str) -> String {
    file(name).to_str().unwrap().to_owned()
}

fn text(name: &str) -> String {
    std::fs::read_to_string(file(name)).unwrap()
}

fn client(board: &FakeBoard) -> Client {
    Client::open(&address::parse(&board.text(), 1234).unwrap()).unwrap()
}

fn short() -> Duration {
    Duration::from_millis(700)
}

fn apply(board: &FakeBoard, name: &str) -> Result<Report, PinsError> {
    applied(board, name, short())
}

fn applied(board: &FakeBoard, name: &str, patience: Duration) -> Result<Report, PinsError> {
    let mut client = client(board);
    let facts = Facts::read(&mut client)?;
    let copies = Copies::open(client, &facts, patience, &|_| {})?;
    let wanted = read_board(&file(name)).unwrap();
    let next = copies.next_generation();
    let bytes = configuration(&wanted, &text(name), facts.built, next).unwrap();
    copies.write(&bytes, "192.168.2.50:1234".parse().unwrap())
}

fn stored(board: &FakeBoard) -> String {
    let mut client = client(board);
    let facts = Facts::read(&mut client).unwrap();
    let bytes = Copies::open(client, &facts, short(), &|_| {})
        .unwrap()
        .read()
        .unwrap();
    let stored = ferrocnc_config::pins::Stored::new_checked(&bytes).unwrap();
    stored.text.to_owned()
}

#[test]
fn a_board_without_a_file_gets_one_and_gives_it_back_with_its_comments() {
    let board = FakeBoard::card();
    assert_eq!(board.look().channels.stepgens, 0);
    let said = answer(&["config", "apply", &board.text(), &path("mill6")]);
    for part in [
        "has the pins of mill6",
        "6 stepgen",
        "in copy 0",
        "of 24576 bytes",
    ] {
        assert!(said.contains(part), "{part} is not in {said}");
    }
    assert_eq!(said.lines().count(), 1, "{said}");
    assert_eq!(board.look().channels.stepgens, 6);
    assert_eq!(answer(&["config", "read", &board.text()]), text("mill6"));
    let json = answer(&["config", "read", &board.text(), "--json"]);
    let json: serde_json::Value = serde_json::from_str(&json).unwrap();
    assert_eq!(json["text"], text("mill6"));
    assert_eq!(
        (&json["configuration"], &json["in_force"]),
        (&"mill6".into(), &true.into())
    );
}

#[test]
fn the_next_file_goes_beside_the_one_in_force_and_a_third_over_the_first() {
    let board = FakeBoard::card();
    for (n, name) in ["mill6", "plotter", "75b_v8_26o23i6p"].iter().enumerate() {
        let report = apply(&board, name).unwrap();
        assert_eq!(
            (report.copy, report.generation),
            (n as u32 % 2, n as u32 + 1)
        );
        let loaded = Loaded {
            verdict: HERE,
            copy: Some(report.copy),
        };
        assert_eq!(board.look().flash.pins, Some(loaded));
        assert_eq!(stored(&board), text(name));
    }
    assert_eq!(board.look().flash.count(Op::EraseBlock), 0);
}

#[test]
fn the_first_page_is_programmed_last_and_then_the_whole_is_summed_up() {
    let board = FakeBoard::card();
    apply(&board, "mill6").unwrap();
    let start = board.look().flash.layout().pins_copy(0).start;
    let done = board.look().flash.done.clone();
    let changes: Vec<(Op, u32)> = { done.iter().copied() }
        .filter(|(op, _)| *op != Op::Read)
        .collect();
    assert_eq!(changes[0], (Op::EraseSector, start));
    let last = |start| {
        [
            (Op::Crc, start + PAGE),
            (Op::Program, start),
            (Op::Crc, start),
        ]
    };
    let (first, second) = changes.split_at(changes.len() / 2);
    assert!(first.ends_with(&last(start)), "{first:?}");
    let other = board.look().flash.layout().pins_copy(1).start;
    assert_eq!(second[0], (Op::EraseSector, other));
    assert!(second.ends_with(&last(other)), "{second:?}");
}

#[test]
fn a_page_that_wears_out_after_an_apply_brings_no_file_of_before_back() {
    let board = FakeBoard::card();
    apply(&board, "plotter").unwrap();
    let report = apply(&board, "mill6").unwrap();
    {
        let mut mind = board.look();
        let start = mind.flash.layout().pins_copy(report.copy).start as usize;
        mind.flash.bytes[start + 700] &= 0xa5;
        mind.power_cycle();
        let loaded = mind.flash.pins.unwrap();
        assert_eq!((loaded.verdict, loaded.copy), (HERE, Some(1 - report.copy)));
    }
    assert_eq!(stored(&board), text("mill6"));
    let report = apply(&board, "plotter").unwrap();
    assert_eq!((report.generation, stored(&board)), (3, text("plotter")));
}

#[test]
fn a_cut_after_any_operation_leaves_the_old_file_in_force_or_the_new_one() {
    let whole = FakeBoard::card();
    apply(&whole, "plotter").unwrap();
    let before = whole.look().flash.done.len() as u32;
    apply(&whole, "mill6").unwrap();
    let operations = whole.look().flash.done.len() as u32 - before;
    let mut seen = [0, 0];
    for cut in 1..operations {
        let board = FakeBoard::card();
        apply(&board, "plotter").unwrap();
        board.look().flash.silent_after = Some(cut);
        let said = applied(&board, "mill6", Duration::from_millis(250)).unwrap_err();
        let (told, said) = match said {
            PinsError::Second { why, .. } => (true, *why),
            said => (false, said),
        };
        let lost = matches!(
            said,
            PinsError::Gone { .. }
                | PinsError::Flash(FlashError::Lost { .. } | FlashError::Client(_))
        );
        assert!(lost, "cut after {cut}: {said}");
        board.look().knobs.unplugged = false;
        board.look().power_cycle();
        let verdict = board.look().flash.pins.unwrap().verdict;
        assert_eq!(verdict, HERE, "cut after {cut}");
        let now = stored(&board);
        let new = now == text("mill6");
        assert!(new || now == text("plotter"), "cut after {cut}: a mixture");
        assert!(new || !told, "cut after {cut}: told to be in force");
        seen[usize::from(new)] += 1;
    }
    assert!(seen[0] > 10 && seen[1] > 0, "{seen:?}");
}

#[test]
fn a_first_page_of_which_only_the_beginning_was_programmed_is_no_file() {
    let board = FakeBoard::card();
    apply(&board, "plotter").unwrap();
    let before = board.look().flash.bytes.clone();
    apply(&board, "mill6").unwrap();
    // As it was when the new copy was written, and the one before not yet.
    let area = board.look().flash.layout().pins_copy(1);
    let (start, end) = (area.start as usize, area.end as usize);
    let mut written = before;
    written[start..end].copy_from_slice(&board.look().flash.bytes[start..end]);
    for length in 0..=PAGE as usize {
        let mut mind = board.look();
        mind.flash.bytes.clone_from(&written);
        mind.flash.bytes[start + length..start + PAGE as usize].fill(0xff);
        mind.power_cycle();
        // What is not programmed yet may happen to be as it should be: ff.
        let whole = mind.flash.bytes == written;
        let loaded = mind.flash.pins.unwrap();
        assert_eq!(loaded.verdict, HERE);
        assert_eq!(loaded.copy, Some(u32::from(whole)), "{length} bytes");
    }
}

#[test]
fn what_was_cut_off_is_written_again_by_the_same_command() {
    let board = FakeBoard::card();
    apply(&board, "plotter").unwrap();
    board.look().flash.silent_after = Some(20);
    apply(&board, "mill6").unwrap_err();
    board.look().knobs.unplugged = false;
    let report = apply(&board, "mill6").unwrap();
    assert_eq!((report.copy, stored(&board)), (1, text("mill6")));
}

#[test]
fn generations_go_on_past_their_end() {
    let board = FakeBoard::card();
    let wanted = read_board(&file("mill6")).unwrap();
    let bytes = configuration(&wanted, &text("mill6"), EIGHT, u32::MAX).unwrap();
    {
        let mut mind = board.look();
        let start = mind.flash.layout().pins_copy(0).start as usize;
        mind.flash.bytes[start..start + bytes.len()].copy_from_slice(&bytes);
        mind.power_cycle();
    }
    let report = apply(&board, "plotter").unwrap();
    assert_eq!((report.copy, report.generation), (1, 0));
    assert_eq!(stored(&board), text("plotter"));
}

#[test]
fn an_armed_or_driven_board_is_refused_and_nothing_is_erased() {
    let board = FakeBoard::card();
    board.look().state = State::Armed;
    let said = complaint(&["config", "apply", &board.text(), &path("mill6")]);
    assert!(said.contains("the machine is armed"), "{said}");
    board.look().state = State::Disarmed;
    let owner = SocketAddrV4::new([10, 0, 0, 9].into(), 4000);
    board.look().knobs.foreign_owner = Some(owner);
    let said = complaint(&["config", "apply", &board.text(), &path("mill6")]);
    assert!(said.contains("driven by 10.0.0.9:4000"), "{said}");
    assert_eq!(board.look().flash.count(Op::EraseSector), 0);
}

#[test]
fn a_board_with_a_key_takes_a_file_only_from_its_owner() {
    let board = FakeBoard::card();
    let key = ferrocnc::keys::Key::random().unwrap();
    board.look().flash.settings.key = key.words();
    board.look().key = Some(key);
    let home = std::env::temp_dir().join(format!("ferrocnc-apply-{}", std::process::id()));
    std::fs::create_dir_all(&home).unwrap();
    let right = home.join("right.key");
    ferrocnc::keys::write(&right, &key).unwrap();
    let said = apply(&board, "mill6").unwrap_err();
    let no_key = matches!(
        said,
        PinsError::Flash(FlashError::Client(ClientError::Key(..)))
    );
    assert!(no_key, "{said}");
    assert_eq!(board.look().flash.count(Op::EraseSector), 0);
    let right = right.to_str().unwrap();
    answer(&[
        "config",
        "apply",
        &board.text(),
        &path("mill6"),
        "--key",
        right,
    ]);
    assert_eq!(board.look().channels.stepgens, 6);
    // Where the board is after it has moved, the client has the key, too.
    let keys = ferrocnc::keys::Keys::named(Some(Path::new(right)));
    let here = client(&board).with_keys(keys);
    let mut there = here.elsewhere(here.address()).unwrap();
    there.acquire().unwrap();
    std::fs::remove_dir_all(&home).unwrap();
}

#[test]
fn a_file_for_another_image_is_refused_before_the_board_is_touched() {
    let board = FakeBoard::card();
    let few = Built {
        stepgens: 4,
        ..EIGHT
    };
    for (built, platform, name, parts) in [
        (
            few,
            "5a-75b-8.0",
            "mill6",
            ["stepgen: is there 6 times", "image has 4"],
        ),
        (
            EIGHT,
            "5a-75b-7.0",
            "mill6",
            ["is not the card's", "5a-75b-7.0"],
        ),
        (
            EIGHT,
            "5a-75b-8.0",
            "max",
            ["sys_clk_hz: 50000000", "write 60000000"],
        ),
    ] {
        board.look().become_image(built, platform);
        let said = complaint(&["config", "apply", &board.text(), &path(name)]);
        for part in parts {
            assert!(said.contains(part), "{part} is not in {said}");
        }
    }
    assert_eq!(board.look().flash.done, []);
}

#[test]
fn a_board_with_fixed_pins_says_so_and_what_to_do() {
    let board = FakeBoard::mill6(Time::Lockstep(60_000));
    for arguments in [
        &["config", "apply", &board.text(), &path("mill6")][..],
        &["config", "read", &board.text()],
    ] {
        let said = complaint(arguments);
        assert!(said.contains("part of its image"), "{said}");
        assert!(said.contains("ferrocnc update"), "{said}");
    }
    assert_eq!(board.look().flash.done, []);
}

#[test]
fn a_board_that_does_not_use_what_was_written_is_found_out() {
    let board = FakeBoard::card();
    board.look().pins.as_mut().unwrap().factory = true;
    let said = apply(&board, "mill6").unwrap_err();
    assert!(
        matches!(said, PinsError::Unused(loaded) if loaded.verdict == Verdict::FactoryPin),
        "{said}"
    );
    assert!(
        said.to_string().contains("release the factory pin"),
        "{said}"
    );
    board.look().pins.as_mut().unwrap().factory = false;
    board.look().pins.as_mut().unwrap().refuses = true;
    let said = apply(&board, "mill6").unwrap_err().to_string();
    assert!(said.contains("the gateware did not take it"), "{said}");
}

#[test]
fn a_flash_that_does_not_hold_a_bit_is_found_out_and_the_file_before_stays() {
    let board = FakeBoard::card();
    apply(&board, "plotter").unwrap();
    let weak = board.look().flash.layout().pins_copy(1).start + 2 * PAGE + 5;
    board.look().flash.weak = Some(weak);
    let said = apply(&board, "mill6").unwrap_err();
    assert!(matches!(said, PinsError::Differs(_)), "{said}");
    board.look().power_cycle();
    assert_eq!(stored(&board), text("plotter"));
}

#[test]
fn a_board_that_stays_where_it_was_is_found_there_though_the_file_has_another_address() {
    let board = FakeBoard::card();
    let mut client = client(&board);
    let facts = Facts::read(&mut client).unwrap();
    let wanted = read_board(&file("mill6")).unwrap();
    let copies = Copies::open(client, &facts, short(), &|_| {}).unwrap();
    let bytes = configuration(
        &wanted,
        &text("mill6"),
        facts.built,
        copies.next_generation(),
    );
    let elsewhere = "127.0.0.1:9".parse().unwrap();
    let report = copies.write(&bytes.unwrap(), elsewhere).unwrap();
    assert_eq!(report.moved, None, "it has answered where it was");
    assert_eq!(board.look().flash.origin, Origin::BuiltIn);
}

#[test]
fn a_file_is_read_to_a_file_and_never_over_another_one() {
    let board = FakeBoard::card();
    let said = complaint(&["config", "read", &board.text()]);
    assert!(
        said.contains("no configuration of the pins is stored"),
        "{said}"
    );
    apply(&board, "mill6").unwrap();
    let folder = std::env::temp_dir().join(format!("ferrocnc-read-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let to = folder.join("mill6.toml");
    let to = to.to_str().unwrap();
    answer(&["config", "read", &board.text(), "-o", to]);
    assert_eq!(std::fs::read_to_string(to).unwrap(), text("mill6"));
    let said = complaint(&["config", "read", &board.text(), "-o", to]);
    assert!(said.contains("is there already"), "{said}");
    let said = complaint(&["config", "read", &board.text(), "-o", "mill6.txt"]);
    assert!(said.contains("ends in .toml"), "{said}");
    std::fs::remove_dir_all(&folder).unwrap();
}

#[test]
fn a_command_without_a_file_says_how_it_is_meant() {
    let board = FakeBoard::card();
    let said = complaint(&["config", "apply", &board.text()]);
    assert!(
        said.contains("ferrocnc config apply BOARD FILE.toml"),
        "{said}"
    );
}
