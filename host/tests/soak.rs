//! A short soak against the fake board: a count of exchanges, whatever time they take.

#[path = "common/fake_board.rs"]
mod common;

use common::{FakeBoard, Time};
use ferrocnc::address;
use ferrocnc::client::Client;
use ferrocnc::doctor::soak::run::{Plan, measure};
use std::time::Duration;

const PLAN: Plan = Plan {
    period: Duration::from_millis(20),
    exchanges: 50,
    cpu: None,
};

fn client(board: &FakeBoard) -> Client {
    let address = address::parse(&board.text(), 1234).expect("an address");
    Client::open(&address).expect("a socket")
}

#[test]
fn a_soak_counts_each_exchange_moves_nothing_and_gives_the_board_back() {
    let board = FakeBoard::mill6(Time::Wall);
    let measured = measure(client(&board), &PLAN, |_| true).expect("a measurement");
    assert_eq!(measured.asked, 50);
    assert_eq!(measured.wake.total(), 50);
    let counted = measured.exchange.total() + measured.late + measured.lost;
    assert_eq!(counted, 50, "in time, late and lost are all");
    let look = board.look();
    assert!(look.exchanges >= 50 && !look.gate && !look.command.enable);
    drop(look);
    // Free for the next one.
    client(&board).acquire().expect("a session");
}

#[test]
fn a_lost_answer_is_counted_as_lost() {
    let board = FakeBoard::mill6(Time::Wall);
    let measured = measure(client(&board), &PLAN, |done| {
        if done == 20 {
            board.look().knobs.drop_replies = 1;
        }
        true
    });
    let measured = measured.expect("a measurement");
    assert!(measured.lost >= 1, "{} lost", measured.lost);
}

#[test]
fn a_board_that_another_host_drives_is_refused() {
    let board = FakeBoard::mill6(Time::Wall);
    let mut owner = client(&board);
    owner.acquire().expect("a session");
    let hurried = client(&board).hurried(Duration::from_millis(50), Duration::from_millis(200));
    let why = measure(hurried, &PLAN, |_| true).expect_err("it is owned");
    assert!(why.to_string().contains("stop LinuxCNC there"), "{why}");
}
