//! Endless datagrams from the board's address: the work of the servo thread for them has a bound,
//! in datagrams and not in time.

#[path = "common/fake_board.rs"]
mod common;

use common::rig::{PERIOD_NS, Rig};
use ferrocnc::link::{LOOKS, Link};
use std::net::UdpSocket;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// A link, and the other end of it.
fn link() -> (Link, UdpSocket) {
    let (ours, theirs) = (
        UdpSocket::bind("127.0.0.1:0").unwrap(),
        UdpSocket::bind("127.0.0.1:0").unwrap(),
    );
    ours.connect(theirs.local_addr().unwrap()).unwrap();
    theirs.connect(ours.local_addr().unwrap()).unwrap();
    (Link::new(ours).unwrap(), theirs)
}

/// Takes what is there; how many datagrams of whole words that were.
fn take(link: &mut Link) -> u32 {
    let mut looks = LOOKS;
    let mut count = 0;
    while link.receive(Instant::now(), &mut looks).is_some() {
        count += 1;
    }
    count
}

/// What this thread has used of its processor: a figure that other programs on this computer leave
/// alone.
fn cpu_time() -> Duration {
    let mut time = libc::timespec {
        tv_sec: 0,
        tv_nsec: 0,
    };
    // SAFETY: `time` is a valid place for the answer.
    let failed = unsafe { libc::clock_gettime(libc::CLOCK_THREAD_CPUTIME_ID, &mut time) };
    assert_eq!(failed, 0);
    Duration::new(time.tv_sec as u64, time.tv_nsec as u32)
}

#[test]
fn a_period_looks_at_so_many_datagrams_and_throws_the_rest_away_unread() {
    for junk in [&b"four"[..], b"odd"] {
        let (mut link, board) = link();
        for _ in 0..LOOKS + 32 {
            board.send(junk).unwrap();
        }
        let whole = if junk.len() == 4 { LOOKS } else { 0 };
        assert_eq!(take(&mut link), whole);
        assert_eq!(link.calls(), u64::from(LOOKS));
        assert_eq!(link.discard(), 32);
        assert_eq!(link.calls(), u64::from(LOOKS) + 1, "in one call");
        assert_eq!((take(&mut link), link.discard()), (0, 0), "it is empty");
    }
}

#[test]
fn while_datagrams_come_without_a_pause_every_period_ends_after_as_many_calls() {
    for flooders in [1, 2] {
        let (mut link, board) = link();
        let done = AtomicBool::new(false);
        let mut longest = [Duration::ZERO; 2];
        std::thread::scope(|scope| {
            for _ in 0..flooders {
                scope.spawn(|| {
                    while !done.load(Ordering::Relaxed) {
                        let _ = board.send(b"four");
                    }
                });
            }
            for _ in 0..1000 {
                let (before, began, busy) = (link.calls(), Instant::now(), cpu_time());
                take(&mut link);
                link.discard();
                longest[0] = longest[0].max(began.elapsed());
                longest[1] = longest[1].max(cpu_time() - busy);
                // One that finds nothing ends the taking; eight throw away.
                assert!(link.calls() - before <= u64::from(LOOKS) + 1 + 8);
            }
            done.store(true, Ordering::Relaxed);
        });
        let [clock, cpu] = longest;
        println!("{flooders} flooders: a period's read {clock:?} at most, {cpu:?} of its thread");
    }
}

#[test]
fn a_flood_that_lets_answers_through_costs_none_and_is_told_once() {
    let mut rig = Rig::armed();
    rig.hal.said();
    let missing: u32 = rig.hal.get("ferrocnc.0.packet-error-total");
    // All of one period's and what is left of the last one's are fewer than a period looks at.
    rig.board.look().knobs.flood = (20, 60);
    rig.travel(1.0, 100);
    assert!(rig.enabled(), "{:?}", rig.hal.said());
    assert_eq!(rig.hal.get::<u32>("ferrocnc.0.packet-error-total"), missing);
    let said = rig.hal.said();
    assert_eq!(said.len(), 1, "{said:?}");
    assert!(said[0].contains("what floods the network"), "{said:?}");
}

#[test]
fn a_flood_that_buries_the_answers_stops_the_machine_and_not_the_servo_thread() {
    let mut rig = Rig::armed();
    rig.board.look().knobs.flood = (LOOKS + 60, 0);
    for _ in 0..40 {
        let before = rig.driver.calls();
        rig.driver.read(PERIOD_NS);
        let made = rig.driver.calls() - before;
        // Each look may have found nothing at first and waited.
        assert!(
            made <= 3 * u64::from(LOOKS) + 1 + 8,
            "{made} system calls in a read"
        );
        rig.driver.write(PERIOD_NS);
        std::thread::sleep(Duration::from_millis(1));
    }
    assert!(!rig.enabled());
    assert!(rig.hal.get::<u32>("ferrocnc.0.packet-discarded-total") > 0);
}
