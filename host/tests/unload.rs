//! `unloadrt` while the machine is armed and its threads run on, and functions of one board in two
//! threads. `tests/turn.rs` tests the hand-over in every possible order, `tests/tests/trouble.rs`
//! under the real rtapi.

#[path = "common/fake_board.rs"]
mod common;

use common::FakeBoard;
use common::rig::{LOCKSTEP, PERIOD_NS, load};
use ferrocnc::fence::Fenced;
use ferrocnc::hal::fake::FakeHal;
use ferrocnc::module::{SharedBoard, unload};
use ferrocnc::turn::Turn;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// How often; a thousand times take a minute.
fn times() -> u32 {
    let given = std::env::var("FERROCNC_UNLOADS").ok();
    given.and_then(|text| text.parse().ok()).unwrap_or(20)
}

/// What `addf ferrocnc.0.read` and `addf ferrocnc.0.write` come to.
fn servo_thread(shared: &SharedBoard, done: &AtomicBool) {
    while !done.load(Ordering::Relaxed) {
        call(shared, |board| board.read(PERIOD_NS));
        call(shared, |board| board.write(PERIOD_NS));
        std::thread::sleep(Duration::from_micros(50));
    }
}

fn call(shared: &SharedBoard, work: impl FnOnce(&mut Fenced)) {
    let collisions = shared.collisions();
    shared.take(|board| {
        // Never after it was unloaded: the board is closed then.
        let board = board.as_mut().expect("a board that is there");
        board.collided(collisions);
        work(board);
    });
}

/// Until the board is armed, as long as that takes.
fn arm(hal: &FakeHal) {
    hal.set("ferrocnc.0.enable", true);
    for _ in 0..500 {
        hal.set("ferrocnc.0.enable-request", false);
        std::thread::sleep(Duration::from_millis(5));
        hal.set("ferrocnc.0.enable-request", true);
        for _ in 0..20 {
            std::thread::sleep(Duration::from_millis(1));
            if hal.get::<bool>("ferrocnc.0.enabled") {
                return;
            }
        }
    }
    panic!("it is not armed: {:?}", hal.said());
}

#[test]
fn a_board_is_unloaded_while_it_is_armed_and_its_threads_run_on() {
    let board = FakeBoard::mill6(LOCKSTEP);
    for n in 0..times() {
        let mut hal = FakeHal::new();
        let driver = load(&board, &mut hal);
        hal.set("ferrocnc.0.packet-read-timeout", 200_000_000);
        let shared: SharedBoard = Turn::new(Some(Fenced::new(driver, hal.messenger())));
        let done = AtomicBool::new(false);
        std::thread::scope(|scope| {
            scope.spawn(|| servo_thread(&shared, &done));
            arm(&hal);
            if n % 2 == 1 {
                // Two threads: one of them is turned away now and then, nothing worse.
                scope.spawn(|| servo_thread(&shared, &done));
                std::thread::sleep(Duration::from_millis(2));
            }
            let token = board.look().owner;
            assert!(token.is_some());
            let unloaded = unload(&shared).expect("no thread stays inside");
            let late = shared.late();
            assert!(unload(&shared).is_none(), "it is gone");
            drop(unloaded);
            // A thread that still has the address is turned away.
            while shared.late() < late + 5 {
                std::thread::sleep(Duration::from_micros(50));
            }
            done.store(true, Ordering::Relaxed);
        });
        for _ in 0..1000 {
            if board.look().owner.is_none() {
                break;
            }
            std::thread::sleep(Duration::from_millis(1));
        }
        assert!(
            board.look().owner.is_none(),
            "{n}: the session was not given back"
        );
    }
}

#[test]
fn functions_in_two_threads_are_told_once_and_one_waits_for_the_other_never() {
    let board = FakeBoard::mill6(LOCKSTEP);
    let mut hal = FakeHal::new();
    let driver = load(&board, &mut hal);
    let shared: SharedBoard = Turn::new(Some(Fenced::new(driver, hal.messenger())));
    for _ in 0..3 {
        shared.take(|_| {
            // Another thread comes while this one is inside, and goes on at once.
            std::thread::scope(|scope| {
                let other = scope.spawn(|| shared.take(|_| ()));
                assert_eq!(other.join().unwrap(), None);
            });
        });
        call(&shared, |board| board.read(PERIOD_NS));
        call(&shared, |board| board.write(PERIOD_NS));
    }
    assert_eq!(shared.collisions(), 3);
    let mut said = hal.said();
    said.retain(|line| line.contains("two threads"));
    assert_eq!(said.len(), 1, "{said:?}");
    assert!(said[0].contains("ferrocnc.0.read and ferrocnc.0.write to one thread"));
}
