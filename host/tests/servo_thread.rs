//! The servo thread must not allocate, and a panic must not leave it.

#[path = "common/fake_board.rs"]
mod common;

use common::rig::load_with;
use common::{CLOCK_HZ, FakeBoard, Time};
use ferrocnc::address;
use ferrocnc::client::Client;
use ferrocnc::clock::Timebase;
use ferrocnc::driver::Driver;
use ferrocnc::fence::Fenced;
use ferrocnc::group::Group;
use ferrocnc::hal::Messenger;
use ferrocnc::hal::fake::FakeHal;
use ferrocnc::link::Link;
use ferrocnc::names::{self, Scheme};
use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::time::Duration;

const PERIOD_NS: i64 = 1_000_000;

thread_local! {
    static WATCHED: Cell<bool> = const { Cell::new(false) };
    static COUNT: Cell<u32> = const { Cell::new(0) };
}

/// Counts allocations of the watching thread only.
struct Counting;

fn hit() {
    if WATCHED.get() {
        COUNT.set(COUNT.get() + 1);
    }
}

// SAFETY: everything is passed on to the system allocator.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        hit();
        // SAFETY: the caller's promise.
        unsafe { System.alloc(layout) }
    }
    unsafe fn dealloc(&self, memory: *mut u8, layout: Layout) {
        hit();
        // SAFETY: the caller's promise.
        unsafe { System.dealloc(memory, layout) }
    }
    unsafe fn realloc(&self, memory: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        hit();
        // SAFETY: the caller's promise.
        unsafe { System.realloc(memory, layout, size) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

fn allocations(work: impl FnOnce()) -> u32 {
    COUNT.set(0);
    WATCHED.set(true);
    work();
    WATCHED.set(false);
    COUNT.get()
}

/// Says nothing and allocates nothing, as RTAPI's message queue does.
fn silent() -> Messenger {
    Box::new(|_, _| {})
}

fn load(board: &FakeBoard, hal: &mut FakeHal, say: Messenger) -> Driver {
    let address = address::parse(&board.text(), 1234).unwrap();
    let mut client = Client::open(&address).unwrap();
    let identity = client.identify().unwrap();
    client.acquire().unwrap();
    let link = Link::new(client.into_socket()).unwrap();
    Driver::export(hal, 0, address, &identity, link, say).unwrap()
}

fn run(driver: &mut Driver, periods: usize) {
    for _ in 0..periods {
        driver.read(PERIOD_NS);
        driver.write(PERIOD_NS);
        std::thread::sleep(Duration::from_micros(200));
    }
}

#[test]
fn the_counter_counts() {
    assert_eq!(allocations(|| drop(std::hint::black_box(Box::new(1)))), 2);
}

#[test]
fn the_servo_functions_never_allocate_whatever_the_board_does() {
    let board = FakeBoard::mill6(Time::Lockstep(u64::from(CLOCK_HZ) / 1000));
    let mut hal = FakeHal::new();
    let mut driver = load(&board, &mut hal, silent());
    hal.set("ferrocnc.0.packet-read-timeout", 20_000_000);
    hal.set("ferrocnc.0.stepgen.x.control-type", true);
    hal.set("ferrocnc.0.stepgen.x.velocity-cmd", 10.0);
    hal.set("ferrocnc.0.stepgen.x.enable", true);
    let counted = allocations(|| {
        // Session, settings, arming.
        run(&mut driver, 100);
        hal.set("ferrocnc.0.enable", true);
        hal.set("ferrocnc.0.enable-request", true);
        run(&mut driver, 50);
    });
    assert_eq!(counted, 0, "connecting and arming");
    assert!(hal.get::<bool>("ferrocnc.0.enabled"));

    let counted = allocations(|| {
        // Refused numbers are told of, too.
        hal.set("ferrocnc.0.stepgen.x.maxaccel", f64::NAN);
        hal.set("ferrocnc.0.stepgen.x.velocity-cmd", f64::INFINITY);
        run(&mut driver, 5);
        hal.set("ferrocnc.0.stepgen.x.maxaccel", 1.0);
        hal.set("ferrocnc.0.stepgen.x.velocity-cmd", 10.0);
    });
    assert_eq!(counted, 0, "invalid numbers");

    // Setting a knob locks a mutex and may allocate: outside the count.
    board.look().knobs.duplicate_replies = true;
    board.look().knobs.drop_replies = 2;
    assert_eq!(allocations(|| run(&mut driver, 50)), 0, "loss, repetition");
    board.look().advance(60_000 * 100);
    assert_eq!(
        allocations(|| run(&mut driver, 300)),
        0,
        "bite, new session"
    );
    board.look().knobs.unplugged = true;
    hal.set("ferrocnc.0.packet-read-timeout", 1_000_000);
    assert_eq!(allocations(|| run(&mut driver, 50)), 0, "no cable");
    drop(board);
    assert_eq!(allocations(|| run(&mut driver, 200)), 0, "refused");
}

#[test]
fn other_drivers_names_and_read_requests_allocate_nothing_either() {
    for scheme in [Scheme::Lcnc, Scheme::LitexCnc(Vec::new())] {
        let board = FakeBoard::mill6(Time::Lockstep(u64::from(CLOCK_HZ) / 1000));
        let mut hal = FakeHal::new();
        let (mut driver, identity) = load_with(&board, &mut hal, 0);
        let glue = names::export(&scheme, &mut hal, 0, &identity, &driver).unwrap();
        driver.adopt(glue);
        driver.join(&Timebase::new(), &Group::new(), 2);
        hal.set("ferrocnc.0.packet-read-timeout", 20_000_000);
        let counted = allocations(|| {
            run(&mut driver, 50);
            hal.set("ferrocnc.0.enable", true);
            hal.set("ferrocnc.0.enable-request", true);
            hal.set("ferrocnc.0.encoder.x.index-enable", true);
            // Beyond four windows of the clock's comparison.
            for _ in 0..300 {
                driver.read_request(PERIOD_NS);
                driver.read(PERIOD_NS);
                driver.write(PERIOD_NS);
            }
        });
        assert_eq!(counted, 0, "{scheme:?}");
        assert!(hal.get::<bool>("ferrocnc.0.enabled"), "{scheme:?}");
    }
}

#[test]
fn a_panic_stops_at_the_fence_and_stays_stopped() {
    let board = FakeBoard::mill6(Time::Lockstep(u64::from(CLOCK_HZ) / 1000));
    let mut hal = FakeHal::new();
    let say = hal.messenger();
    let mut fenced = Fenced::new(load(&board, &mut hal, silent()), say);
    hal.set("ferrocnc.0.enable", true);
    for n in 0..300 {
        hal.set("ferrocnc.0.enable-request", n > 150);
        fenced.read(PERIOD_NS);
        fenced.write(PERIOD_NS);
        std::thread::sleep(Duration::from_micros(300));
    }
    assert!(hal.get::<bool>("ferrocnc.0.enabled"));

    fenced.guard(|_| panic!("injected by the test"));
    assert!(!hal.get::<bool>("ferrocnc.0.enabled"));
    let before = board.look().datagrams;
    hal.set("ferrocnc.0.io-error", false);
    for _ in 0..20 {
        fenced.read(PERIOD_NS);
        fenced.write(PERIOD_NS);
    }
    assert!(hal.get::<bool>("ferrocnc.0.io-error"), "cannot be cleared");
    assert_eq!(hal.get::<u32>("ferrocnc.0.fault-code"), 26, "it says so");
    assert_eq!(board.look().datagrams, before, "nothing is sent any more");
    let said = hal.said();
    assert_eq!(said.len(), 1, "one message: {said:?}");
    assert!(said[0].contains("watchdog stops the machine"), "{said:?}");

    // The board stops the machine.
    board.look().advance(60_000 * 1000);
    assert!(!board.look().gate);
}
