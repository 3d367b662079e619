//! The hand-over of a board between realtime threads and `unloadrt`, in every order in which it can
//! happen: loom runs the same source file as the driver, with its own atomics, and reports any two
//! accesses without an order.

mod sync {
    pub use loom::cell::UnsafeCell;
    pub use loom::sync::atomic::{AtomicU32, Ordering};
}

#[path = "../src/turn.rs"]
#[allow(dead_code)]
mod turn;

use loom::sync::Arc;
use loom::thread;
use turn::Turn;

/// A driver: what it did, and whether it was taken away.
#[derive(Default)]
struct Board {
    calls: u32,
    gone: bool,
}

impl Board {
    fn called(&mut self) {
        assert!(!self.gone, "a thread is in a driver that is gone");
        self.calls += 1;
    }
}

fn shut(turn: &Turn<Board>) -> Option<u32> {
    let patient = || {
        thread::yield_now();
        true
    };
    turn.shut(patient, |board| {
        board.gone = true;
        board.calls
    })
}

#[test]
fn a_thread_that_runs_on_while_the_driver_is_unloaded_never_meets_it_again() {
    loom::model(|| {
        let turn = Arc::new(Turn::new(Board::default()));
        let servo = Arc::clone(&turn);
        let servo = thread::spawn(move || {
            let calls = [servo.take(Board::called), servo.take(Board::called)];
            calls.iter().filter(|call| call.is_some()).count() as u32
        });
        let seen = shut(&turn).expect("no other thread shuts it");
        let called = servo.join().unwrap();
        assert_eq!(
            seen, called,
            "what it did is not what the unloading thread sees"
        );
        assert_eq!((turn.late(), turn.collisions()), (2 - called, 0));
        assert!(turn.take(Board::called).is_none());
    });
}

#[test]
fn of_two_threads_and_an_unloading_one_never_two_are_inside() {
    loom::model(|| {
        let turn = Arc::new(Turn::new(Board::default()));
        let threads = [0, 1].map(|_| {
            let turn = Arc::clone(&turn);
            thread::spawn(move || u32::from(turn.take(Board::called).is_some()))
        });
        let seen = shut(&turn).expect("no other thread shuts it");
        let called: u32 = threads.map(|thread| thread.join().unwrap()).iter().sum();
        assert_eq!(seen, called);
        assert_eq!(turn.late() + turn.collisions(), 2 - called);
    });
}

#[test]
fn of_two_threads_that_unload_one_has_it() {
    loom::model(|| {
        let turn = Arc::new(Turn::new(Board::default()));
        let other = Arc::clone(&turn);
        let other = thread::spawn(move || shut(&other).is_some());
        let ours = shut(&turn).is_some();
        assert!(ours != other.join().unwrap());
    });
}

#[test]
fn a_thread_that_waits_no_longer_leaves_it_alone() {
    loom::model(|| {
        let turn = Arc::new(Turn::new(Board::default()));
        let servo = Arc::clone(&turn);
        let servo = thread::spawn(move || servo.take(Board::called).is_some());
        let had = turn.shut(|| false, |board| board.gone = true).is_some();
        let called = servo.join().unwrap();
        assert!(had || called, "not had although no thread was inside");
    });
}
