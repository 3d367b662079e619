//! A new image over the network, against a fake board with a flash.

#[path = "common/fake_board.rs"]
mod common;

use common::{FakeBoard, Time};
use ferrocnc::address;
use ferrocnc::client::Client;
use ferrocnc::flash::{FlashError, Word};
use ferrocnc::image::{self, Image};
use ferrocnc::update::{Event, Options, Report, UpdateError, update};
use std::cell::RefCell;
use std::net::SocketAddrV4;
use std::time::Duration;
use wire::State;
use wire::flash::{BLOCK, Op, Running, Slot};

const PLATFORM: &str = "5a-75b-8.0";
/// Two blocks and a bit.
const LENGTH: usize = 2 * BLOCK as usize + 1000;

fn image(build: u32) -> Image {
    Image::parse(&image::sample::file("mill6", PLATFORM, build, LENGTH)).unwrap()
}

/// A board as it comes from its first flash: image 1 in slot A, running and selected, image 2
/// golden.
fn board() -> FakeBoard {
    let board = FakeBoard::mill6(Time::Lockstep(60_000));
    {
        let flash = &mut board.look().flash;
        let layout = flash.layout();
        flash.put(layout.slot_a, &image(1));
        flash.put(layout.golden, &image(2));
        flash.selected = Some(Slot::A);
        flash.running = Running::A;
        flash.build_id = 1;
        flash.looks = 0;
    }
    board
}

fn client(board: &FakeBoard) -> Client {
    let address = address::parse(&board.text(), 1234).unwrap();
    Client::open(&address).unwrap()
}

fn run(board: &FakeBoard, image: &Image, options: &Options) -> Result<Report, UpdateError> {
    update(client(board), image, options, &|_| {})
}

fn short() -> Options {
    Options {
        patience: Duration::from_millis(700),
        ..Options::default()
    }
}

#[test]
fn an_update_goes_to_the_other_slot_is_verified_and_selected() {
    let board = board();
    board.look().flash.looks = 2;
    let report = run(&board, &image(7), &Options::default()).unwrap();
    assert_eq!((report.slot, report.written, report.kept), (Slot::B, 3, 0));
    assert_eq!((report.running, report.running_build), (Running::A, 1));
    assert_eq!(report.selected_build, 7);
    let mind = board.look();
    assert_eq!(mind.flash.selected, Some(Slot::B));
    assert_eq!(mind.flash.whole(Slot::B), Some(image(7).meta()));
    assert_eq!(
        mind.flash.whole(Slot::A),
        Some(image(1).meta()),
        "the old one"
    );
    let last: Vec<Op> = mind
        .flash
        .done
        .iter()
        .rev()
        .take(3)
        .map(|(op, _)| *op)
        .collect();
    assert_eq!(
        last,
        [Op::Select, Op::Read, Op::Program],
        "the meta page last"
    );
}

#[test]
fn the_next_update_goes_back_to_the_first_slot_and_the_same_one_writes_nothing() {
    let board = board();
    run(&board, &image(7), &Options::default()).unwrap();
    let report = run(&board, &image(8), &Options::default()).unwrap();
    assert_eq!(report.slot, Slot::A);
    let erased = board.look().flash.count(Op::EraseBlock);
    let report = run(&board, &image(7), &Options::default()).unwrap();
    assert_eq!((report.slot, report.written, report.kept), (Slot::B, 0, 3));
    assert_eq!(board.look().flash.count(Op::EraseBlock), erased);
}

#[test]
fn only_blocks_that_differ_are_written() {
    let board = board();
    let mut other = image(7);
    run(&board, &other, &Options::default()).unwrap();
    run(&board, &image(8), &Options::default()).unwrap();
    // The same but for one byte of the middle block.
    other.bytes[BLOCK as usize + 5] ^= 1;
    let other = Image::parse(&image::sample::wrap("mill6", PLATFORM, 9, &other.bytes)).unwrap();
    let report = run(&board, &other, &Options::default()).unwrap();
    assert_eq!((report.slot, report.written, report.kept), (Slot::B, 1, 2));
    assert_eq!(board.look().flash.whole(Slot::B), Some(other.meta()));
}

#[test]
fn quick_does_not_read_everything_back() {
    let board = board();
    run(
        &board,
        &image(7),
        &Options {
            quick: true,
            ..Options::default()
        },
    )
    .unwrap();
    let reads = board.look().flash.count(Op::Read);
    assert!(reads < 10, "{reads}");
}

#[test]
fn what_is_not_for_this_board_is_refused_before_anything_is_touched() {
    let board = board();
    let with = |file: Vec<u8>| Image::parse(&file).unwrap();
    let platform = with(image::sample::file("mill6", "5a-75e-7.1", 7, 2000));
    let said = run(&board, &platform, &Options::default()).unwrap_err();
    assert!(matches!(said, UpdateError::Platform { .. }));
    assert!(
        said.to_string()
            .contains("the file is for the platform 5a-75e-7.1, the board is 5a-75b-8.0")
    );
    let mut fpga = image(7);
    fpga.idcode = 0x4111_2043;
    let said = run(&board, &fpga, &Options::default()).unwrap_err();
    assert!(
        said.to_string()
            .contains("for LFE5U-45F, the board has LFE5U-25F-6BG256C"),
        "{said}"
    );
    let room = board.look().flash.layout().slot_b.image_max() as usize;
    let long = with(image::sample::file("mill6", PLATFORM, 7, room + 1));
    let said = run(&board, &long, &Options::default()).unwrap_err();
    assert!(matches!(said, UpdateError::TooLong { .. }), "{said}");
    let said = run(
        &board,
        &image(7),
        &Options {
            slot: Some(Slot::A),
            ..Options::default()
        },
    );
    assert!(matches!(said, Err(UpdateError::Selected(Slot::A))));
    assert_eq!(board.look().flash.done, []);
    let forced = Options {
        force_platform: true,
        ..Options::default()
    };
    assert!(run(&board, &platform, &forced).is_ok());
}

#[test]
fn an_armed_or_driven_board_is_refused_and_says_so() {
    let board = board();
    board.look().state = State::Armed;
    let said = run(&board, &image(7), &short()).unwrap_err();
    assert!(said.to_string().contains("the machine is armed"), "{said}");
    board.look().state = State::Disarmed;
    let owner = SocketAddrV4::new([10, 0, 0, 9].into(), 4000);
    board.look().knobs.foreign_owner = Some(owner);
    let said = run(&board, &image(7), &short()).unwrap_err();
    assert!(
        said.to_string().contains("driven by 10.0.0.9:4000"),
        "{said}"
    );
    assert_eq!(board.look().flash.done, []);
}

#[test]
fn a_board_that_is_armed_under_way_keeps_the_old_image_selected() {
    let board = board();
    let armed = RefCell::new(false);
    let said = update(client(&board), &image(7), &short(), &|event| {
        if let Event::Step("writing", part) = event
            && part > 0.3
            && !armed.replace(true)
        {
            board.look().state = State::Armed;
        }
    });
    assert!(
        matches!(said, Err(UpdateError::Flash(FlashError::Armed(_)))),
        "{said:?}"
    );
    assert_eq!(board.look().flash.selected, Some(Slot::A));
    assert!(board.look().flash.whole(Slot::A).is_some());
}

#[test]
fn lost_datagrams_are_not_noticed() {
    let board = board();
    board.look().flash.looks = 1;
    let dropped = RefCell::new(0);
    let report = update(client(&board), &image(7), &Options::default(), &|event| {
        if let Event::Step(_, _) = event
            && *dropped.borrow() < 12
        {
            *dropped.borrow_mut() += 1;
            board.look().knobs.drop_requests += 1;
        }
    });
    assert_eq!(report.unwrap().written, 3);
    assert_eq!(board.look().flash.whole(Slot::B), Some(image(7).meta()));
}

#[test]
fn a_cable_pulled_and_put_back_is_waited_for() {
    let board = board();
    board.look().flash.silent_after = Some(300);
    let words = RefCell::new(Vec::new());
    let report = update(client(&board), &image(7), &Options::default(), &|event| {
        if let Event::Word(word) = event {
            words.borrow_mut().push(word);
            if let Word::Silent(_) = word {
                board.look().knobs.unplugged = false;
            }
        }
    });
    assert_eq!(report.unwrap().selected_build, 7);
    let words = words.into_inner();
    assert_eq!(words, [Word::Silent(Duration::from_secs(60)), Word::Back]);
}

#[test]
fn a_cut_anywhere_leaves_the_old_image_selected_and_the_same_command_goes_on() {
    // Every operation of an update, some of them; then again to the end.
    let whole = board();
    run(&whole, &image(7), &short()).unwrap();
    let operations = whole.look().flash.done.len() as u32;
    let erased = whole.look().flash.count(Op::EraseBlock);
    for cut in (1..operations).step_by(operations as usize / 9) {
        let board = board();
        board.look().flash.silent_after = Some(cut);
        let said = run(&board, &image(7), &short()).unwrap_err();
        assert!(
            said.to_string().contains("give the same command again"),
            "{cut}: {said}"
        );
        {
            let mut mind = board.look();
            mind.knobs.unplugged = false;
            let selected = mind.flash.selected.unwrap();
            assert!(mind.flash.whole(selected).is_some(), "cut after {cut}");
            assert!(
                mind.flash.count(Op::Select) == 0 || selected == Slot::B,
                "cut after {cut}"
            );
        }
        let report = run(&board, &image(7), &short()).unwrap();
        assert_eq!(
            board.look().flash.whole(Slot::B),
            Some(image(7).meta()),
            "cut after {cut}"
        );
        assert_eq!(board.look().flash.selected, Some(report.slot));
        // At most the block that was under way is done twice.
        let again = board.look().flash.count(Op::EraseBlock);
        assert!(again <= erased + 1, "cut after {cut}: {again} erased");
    }
}

#[test]
fn a_board_that_restarts_under_way_is_gone_on_with() {
    let board = board();
    let restarted = RefCell::new(false);
    let report = update(client(&board), &image(7), &Options::default(), &|event| {
        if let Event::Step("writing", part) = event
            && part > 0.5
            && !restarted.replace(true)
        {
            board.look().reboot();
        }
    });
    assert_eq!(report.unwrap().selected_build, 7);
}

#[test]
fn a_flash_that_does_not_hold_a_bit_is_found_out_and_the_old_image_stays() {
    let board = board();
    let weak = board.look().flash.layout().slot_b.start + BLOCK + 77;
    board.look().flash.weak = Some(weak);
    let said = run(&board, &image(7), &short()).unwrap_err();
    assert!(said.to_string().contains("stays selected"), "{said}");
    assert_eq!(board.look().flash.selected, Some(Slot::A));
    assert_eq!(board.look().flash.whole(Slot::B), None);
}

#[test]
fn a_board_without_flash_or_without_golden_image_is_told_apart() {
    let board = board();
    let golden = board.look().flash.layout().golden;
    board.look().flash.bytes[golden.meta() as usize] = 0;
    let warned = RefCell::new(0);
    let done = update(client(&board), &image(7), &Options::default(), &|event| {
        *warned.borrow_mut() += u32::from(event == Event::NoGolden);
    });
    assert!(done.is_ok());
    assert_eq!(warned.into_inner(), 1);
    board.look().flash.jedec = 0;
    board.look().flash.bytes.clear();
    let said = run(&board, &image(7), &short()).unwrap_err();
    assert!(said.to_string().contains("no flash answers"), "{said}");
}

#[test]
fn an_unprotected_golden_image_is_protected_on_the_way() {
    let board = board();
    board.look().flash.protected = false;
    run(&board, &image(7), &Options::default()).unwrap();
    assert!(board.look().flash.protected);
}
