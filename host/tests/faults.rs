//! Random bad networks: with any loss, repetition or delay of datagrams, positions agree in the end
//! and nothing moves without a command.

#[path = "common/fake_board.rs"]
mod common;

use common::{CLOCK_HZ, FakeBoard, Time};
use ferrocnc::address;
use ferrocnc::client::Client;
use ferrocnc::driver::Driver;
use ferrocnc::hal::fake::FakeHal;
use ferrocnc::link::Link;
use std::time::Duration;

const PERIOD_NS: i64 = 1_000_000;

/// Two seconds: an answer that is on its way arrives.
const PATIENT: i32 = 2_000_000_000;
/// The floor of `packet-read-timeout`.
const HASTY: i32 = 100_000;

/// xorshift64*: a seed is a whole network.
struct Random(u64);

impl Random {
    fn below(&mut self, limit: u64) -> u64 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        self.0.wrapping_mul(0x2545_f491_4f6c_dd1d) % limit
    }
}

fn bad_network(seed: u64) {
    let mut random = Random(seed);
    let board = FakeBoard::mill6(Time::Lockstep(u64::from(CLOCK_HZ) / 1000));
    let mut hal = FakeHal::new();
    let address = address::parse(&board.text(), 1234).unwrap();
    let mut client = Client::open(&address).unwrap();
    let identity = client.identify().unwrap();
    client.acquire().unwrap();
    let link = Link::new(client.into_socket()).unwrap();
    let say = hal.messenger();
    let mut driver = Driver::export(&mut hal, 0, address, &identity, link, say).unwrap();
    let mut period = |hal: &FakeHal| {
        driver.read(PERIOD_NS);
        let fb: f64 = hal.get("ferrocnc.0.stepgen.x.position-fb");
        let seen = board.look().datagrams;
        driver.write(PERIOD_NS);
        // A knob set before the board has seen this command would affect the wrong command.
        for _ in 0..2000 {
            if board.look().datagrams != seen {
                break;
            }
            std::thread::sleep(Duration::from_micros(50));
        }
        fb
    };
    hal.set("ferrocnc.0.packet-read-timeout", PATIENT);
    hal.set("ferrocnc.0.stepgen.x.position-scale", 400.0);
    hal.set("ferrocnc.0.stepgen.x.maxaccel", 3000.0);
    hal.set("ferrocnc.0.stepgen.x.steplen", 1000u32);
    hal.set("ferrocnc.0.stepgen.x.stepspace", 1000u32);
    // Machine time stands still in lockstep; only losses may make the watchdog bite.
    hal.set("ferrocnc.0.watchdog.timeout-ns", 20_000_000u32);
    hal.set("ferrocnc.0.enable", true);
    for _ in 0..100 {
        period(&hal);
        std::thread::sleep(Duration::from_millis(1));
    }
    hal.set("ferrocnc.0.enable-request", true);
    for _ in 0..20 {
        period(&hal);
    }
    assert!(hal.get::<bool>("ferrocnc.0.enabled"), "seed {seed}");
    hal.set("ferrocnc.0.stepgen.x.enable", true);

    let mut lost = 0u32;
    let mut last_fb = hal.get::<f64>("ferrocnc.0.stepgen.x.position-fb");
    for n in 0..900u32 {
        let phase = f64::from(n.min(800)) / 800.0 * core::f64::consts::PI;
        hal.set(
            "ferrocnc.0.stepgen.x.position-cmd",
            10.0 * (1.0 - phase.cos()),
        );
        // The test waits long for an answer that will come, because this computer may be slow, and
        // not for a lost one.
        let timeout = if lost > 0 { HASTY } else { PATIENT };
        hal.set("ferrocnc.0.packet-read-timeout", timeout);
        lost = lost.saturating_sub(1);
        // With more losses the driver must give the board up, which another test shows.
        let tolerable = hal.get::<i32>("ferrocnc.0.packet-error-level") <= 4;
        if n < 800 && lost == 0 && tolerable {
            let mut board = board.look();
            match random.below(60) {
                0 => (board.knobs.drop_requests, lost) = (1, 1),
                1 => (board.knobs.drop_replies, lost) = (1, 1),
                2 => (board.knobs.drop_replies, lost) = (2, 2),
                3 => board.knobs.duplicate_replies = !board.knobs.duplicate_replies,
                _ => {}
            }
        }
        let fb = period(&hal);
        // 39 units/s at most, so 0.04 per period; frozen for two periods it may catch up three.
        assert!((fb - last_fb).abs() < 0.2, "seed {seed}, period {n}: jump");
        last_fb = fb;
    }
    hal.set("ferrocnc.0.packet-read-timeout", PATIENT);
    for _ in 0..100 {
        period(&hal);
    }
    let said = hal.said();
    let errors = hal.get::<u32>("ferrocnc.0.packet-error-total");
    assert_eq!(
        board.look().pulses(0),
        8000,
        "seed {seed}, {errors} errors: {said:?}"
    );
    assert!(hal.get::<bool>("ferrocnc.0.enabled"), "seed {seed}");
    assert!(
        hal.get::<u32>("ferrocnc.0.packet-error-total") > 0,
        "seed {seed}"
    );
}

#[test]
fn a_bad_network_costs_no_pulse_and_no_jump() {
    for seed in 1..=8 {
        bad_network(seed * 0x9e37_79b9);
    }
}
