//! Four boards on one servo thread: their requests go out together, and a command takes effect at
//! the same instant on all of them, with any difference between their clocks.

#[path = "common/fake_board.rs"]
mod common;

use common::rig::{PERIOD_NS, load_with};
use common::{CLOCK_HZ, FakeBoard, Script, Time};
use ferrocnc::clock::Timebase;
use ferrocnc::driver::Driver;
use ferrocnc::group::Group;
use ferrocnc::hal::fake::FakeHal;
use std::sync::Arc;
use std::time::{Duration, Instant};
use wire::FaultReason;

/// The instants of four boards agree within this: the clock's resolution is 17 ns, the rest is what
/// a network that delays by 20 to 40 us leaves of the least delay.
const AGREE_NS: f64 = 3_000.0;

/// A computer with four boards. The test sets the time; each board has its own delays and crystal.
struct Shop {
    time: Arc<Timebase>,
    hal: FakeHal,
    boards: Vec<FakeBoard>,
    drivers: Vec<Driver>,
    now: i64,
}

impl Shop {
    fn new(seed: u64) -> Self {
        let time = Timebase::scripted();
        // Started at other times; crystals of +-100 ppm at worst.
        let clocks = [(5e9, 43.0), (7.1e12, -61.0), (1.0, 0.0), (3e15, 97.0)];
        let boards: Vec<FakeBoard> = clocks
            .into_iter()
            .zip(1u64..)
            .map(|((offset_ns, ppm), n)| {
                FakeBoard::scripted(Script {
                    host: Arc::clone(&time),
                    offset_ns,
                    ppm,
                    delay_ns: 20_000.0,
                    seed: seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ n,
                })
            })
            .collect();
        let mut hal = FakeHal::new();
        let mut drivers: Vec<Driver> = boards
            .iter()
            .enumerate()
            .map(|(n, board)| load_with(board, &mut hal, n).0)
            .collect();
        let group = Group::new();
        for (n, driver) in drivers.iter_mut().enumerate() {
            driver.join(&time, &group, boards.len());
            hal.set(&format!("ferrocnc.{n}.packet-read-timeout"), 2_000_000_000);
            // Only a loss in the script may make the watchdog bite.
            hal.set(&format!("ferrocnc.{n}.watchdog.timeout-ns"), 50_000_000u32);
        }
        Shop {
            time,
            hal,
            boards,
            drivers,
            now: 0,
        }
    }

    fn each(&self, pin: &str, value: bool) {
        for n in 0..self.boards.len() {
            self.hal.set(&format!("ferrocnc.{n}.{pin}"), value);
        }
    }

    /// The servo thread's time goes on.
    fn pass(&mut self, nanos: i64) {
        self.now += nanos;
        self.time.set(self.now);
    }

    /// Does something with one board and waits until the board has seen it; the time stands still
    /// meanwhile.
    fn seen(&mut self, n: usize, what: impl FnOnce(&mut Driver)) {
        let (before, unplugged) = {
            let board = self.boards[n].look();
            (board.exchanges, board.knobs.unplugged)
        };
        what(&mut self.drivers[n]);
        // A driver with a session sends each time: on a busy computer the board may take long.
        let patience = match (self.drivers[n].token(), unplugged) {
            (Some(_), false) => Duration::from_secs(30),
            _ => Duration::from_micros(400),
        };
        let begun = Instant::now();
        while begun.elapsed() < patience {
            if self.boards[n].look().exchanges != before {
                break;
            }
            std::thread::sleep(Duration::from_micros(20));
        }
    }

    fn exchanges(&self) -> Vec<u32> {
        self.boards
            .iter()
            .map(|board| board.look().exchanges)
            .collect()
    }

    /// One servo period: reads, the controller, writes one after the other.
    fn period(&mut self) {
        for n in 0..self.drivers.len() {
            self.drivers[n].read(PERIOD_NS);
            self.pass(3_000);
        }
        self.pass(100_000);
        for n in 0..self.drivers.len() {
            self.seen(n, |driver| driver.write(PERIOD_NS));
            self.pass(12_000);
        }
        self.pass(PERIOD_NS - 100_000 - 4 * 15_000);
    }

    /// How far apart the boards have applied the last 200 commands, ns of this computer.
    fn apart(&self) -> f64 {
        let applied: Vec<Vec<f64>> = self
            .boards
            .iter()
            .map(|board| {
                let board = board.look();
                let script = board.script.as_ref().unwrap();
                let last = board.applied.len() - 200;
                let moments = board.applied[last..].iter();
                moments.map(|at| script.host_ns(*at as f64)).collect()
            })
            .collect();
        let mut worst = 0.0f64;
        for n in 0..200 {
            let moments = applied.iter().map(|moments| moments[n]);
            let first = moments.clone().fold(f64::MAX, f64::min);
            let last = moments.fold(f64::MIN, f64::max);
            worst = worst.max(last - first);
        }
        worst
    }

    fn arm(&mut self) {
        self.each("enable", true);
        for _ in 0..60 {
            self.period();
        }
        self.each("enable-request", true);
        for _ in 0..10 {
            self.period();
        }
        for n in 0..self.boards.len() {
            let enabled: bool = self.hal.get(&format!("ferrocnc.{n}.enabled"));
            assert!(enabled, "board {n}: {:?}", self.hal.said());
        }
    }
}

#[test]
fn four_boards_with_other_clocks_apply_a_command_at_one_instant() {
    for seed in 1..=3 {
        let mut shop = Shop::new(seed);
        shop.arm();
        for _ in 0..700 {
            shop.period();
        }
        let worst = shop.apart();
        println!("seed {seed}: four boards apply within {worst:.0} ns");
        assert!(worst < AGREE_NS, "seed {seed}: {worst} ns apart");
        for (n, ppm) in [(0, 43.0), (1, -61.0), (2, 0.0), (3, 97.0)] {
            let drift: f64 = shop.hal.get(&format!("ferrocnc.{n}.wallclock.drift-ppm"));
            assert!(
                (drift - ppm).abs() < 15.0,
                "seed {seed}, board {n}: {drift} ppm"
            );
        }
        // The offset is the board's own, plus the fastest way there.
        let offset: f64 = shop.hal.get("ferrocnc.0.wallclock.offset-ns");
        let true_offset = 5e9 + 43e-6 * shop.now as f64;
        let way = offset - true_offset;
        assert!((0.0..45_000.0).contains(&way), "seed {seed}: {way} ns");
    }
}

#[test]
fn a_board_whose_session_opens_later_applies_at_the_same_instant_as_the_others() {
    for late in 0..4 {
        let mut shop = Shop::new(5);
        shop.boards[late].look().knobs.unplugged = true;
        for _ in 0..30 {
            shop.period();
        }
        shop.boards[late].look().knobs.unplugged = false;
        for _ in 0..200 {
            shop.period();
        }
        shop.arm();
        for _ in 0..700 {
            shop.period();
        }
        let worst = shop.apart();
        println!("board {late} opens later: four boards apply within {worst:.0} ns");
        assert!(worst < AGREE_NS, "board {late}: {worst} ns apart");
    }
}

#[test]
fn a_board_alone_applies_at_once_unless_it_is_told_otherwise() {
    let board = FakeBoard::mill6(Time::Lockstep(u64::from(CLOCK_HZ) / 1000));
    let mut hal = FakeHal::new();
    let (mut driver, _) = load_with(&board, &mut hal, 0);
    driver.join(&Timebase::new(), &Group::new(), 1);
    assert_eq!(hal.get::<u32>("ferrocnc.0.apply-delay-ns"), 0);
    driver.join(&Timebase::new(), &Group::new(), 2);
    assert_eq!(hal.get::<u32>("ferrocnc.0.apply-delay-ns"), 250_000);
}

#[test]
fn all_requests_are_under_way_before_the_first_answer_is_waited_for() {
    let mut shop = Shop::new(7);
    shop.arm();
    for driver in &mut shop.drivers {
        driver.read(PERIOD_NS);
    }
    let before = shop.exchanges();
    for n in 0..4 {
        shop.seen(n, |driver| driver.read_request(PERIOD_NS));
    }
    // There was no read yet, and every board has been asked.
    let after = shop.exchanges();
    for (n, (before, after)) in before.iter().zip(&after).enumerate() {
        assert_eq!(after - before, 1, "board {n}");
    }
    let errors = |shop: &Shop| -> u32 {
        (0..4)
            .map(|n| {
                shop.hal
                    .get::<u32>(&format!("ferrocnc.{n}.packet-error-total"))
            })
            .sum()
    };
    let errors_before = errors(&shop);
    for driver in &mut shop.drivers {
        driver.read(PERIOD_NS);
    }
    assert_eq!(errors(&shop), errors_before);
}

#[test]
fn a_read_request_brings_feedback_from_this_period_and_costs_no_pulse() {
    let mut shop = Shop::new(11);
    // Without apply times the exact place at the next command is known.
    for n in 0..4 {
        shop.hal.set(&format!("ferrocnc.{n}.apply-delay-ns"), 0u32);
        let x = |pin: &str| format!("ferrocnc.{n}.stepgen.x.{pin}");
        shop.hal.set(&x("position-scale"), 800.0);
        shop.hal.set(&x("maxaccel"), 3000.0);
        shop.hal.set(&x("steplen"), 1000u32);
        shop.hal.set(&x("stepspace"), 1000u32);
    }
    shop.arm();
    shop.each("stepgen.x.enable", true);
    let mut worst = 0.0f64;
    for n in 0..500 {
        for n in 0..4 {
            shop.seen(n, |driver| driver.read_request(PERIOD_NS));
        }
        shop.pass(60_000);
        for driver in &mut shop.drivers {
            driver.read(PERIOD_NS);
        }
        shop.pass(140_000);
        let phase = f64::from(n.min(400)) / 400.0 * core::f64::consts::PI;
        let at = 5.0 * (1.0 - phase.cos());
        let predicted: Vec<f64> = (0..4)
            .map(|n| shop.hal.get(&format!("ferrocnc.{n}.stepgen.x.position-fb")))
            .collect();
        for n in 0..4 {
            shop.hal
                .set(&format!("ferrocnc.{n}.stepgen.x.position-cmd"), at);
        }
        for n in 0..4 {
            shop.seen(n, |driver| driver.write(PERIOD_NS));
        }
        // Where the boards were when that command arrived.
        if n > 5 {
            for (board, predicted) in shop.boards.iter().zip(&predicted) {
                let there = board.look().pulses(0) as f64;
                worst = worst.max((there - predicted * 800.0).abs());
            }
        }
        shop.pass(PERIOD_NS - 200_000);
    }
    // Half a step of rounding, and what the delay's jitter of 20 us is at 31 steps per period.
    assert!(worst < 1.5, "{worst} steps");
    for (n, board) in shop.boards.iter().enumerate() {
        assert_eq!(board.look().pulses(0), 8000, "board {n}");
    }
}

/// Board 2 is unplugged: runs until it is given up.
fn until_given_up(shop: &mut Shop) {
    shop.hal.set("ferrocnc.2.packet-read-timeout", 100_000);
    shop.boards[2].look().knobs.unplugged = true;
    for _ in 0..20 {
        shop.period();
        if shop.hal.get::<bool>("ferrocnc.2.io-error") {
            return;
        }
    }
    panic!("board 2 is not missed");
}

#[test]
fn one_board_that_falls_silent_stops_the_others_in_the_same_period() {
    let mut shop = Shop::new(13);
    for n in 0..4 {
        shop.hal
            .set(&format!("ferrocnc.{n}.stepgen.x.position-scale"), 800.0);
        shop.hal
            .set(&format!("ferrocnc.{n}.stepgen.x.maxaccel"), 1000.0);
        shop.hal
            .set(&format!("ferrocnc.{n}.stepgen.x.velocity-cmd"), 10.0);
    }
    shop.arm();
    shop.each("stepgen.x.control-type", true);
    shop.each("stepgen.x.enable", true);
    for _ in 0..50 {
        shop.period();
    }
    shop.hal.said();
    until_given_up(&mut shop);
    for n in [0, 1, 3] {
        assert!(
            !shop.boards[n].look().command.enable,
            "board {n} was not told"
        );
        assert!(!shop.hal.get::<bool>(&format!("ferrocnc.{n}.enabled")));
        assert_eq!(
            shop.hal.get::<u32>(&format!("ferrocnc.{n}.fault-reason")),
            102
        );
        let code: u32 = shop.hal.get(&format!("ferrocnc.{n}.fault-code"));
        assert_eq!(code, 25, "another board stopped");
    }
    for _ in 0..40 {
        shop.period();
    }
    for n in [0, 1, 3] {
        let board = shop.boards[n].look();
        assert!(!board.gate && !board.moving(), "board {n} goes on");
        assert_eq!(board.reason, FaultReason::HostDisable, "softly");
        drop(board);
        assert_eq!(
            shop.hal.get::<u32>(&format!("ferrocnc.{n}.fault-reason")),
            102
        );
        assert!(!shop.hal.get::<bool>(&format!("ferrocnc.{n}.io-error")));
    }
    assert_eq!(
        shop.hal.get::<u32>("ferrocnc.2.fault-reason"),
        u32::from(FaultReason::LinkDown.code())
    );
    let said = shop.hal.said();
    let errors: Vec<_> = said.iter().filter(|s| s.starts_with("error")).collect();
    assert_eq!(errors.len(), 1, "{errors:?}");
    assert!(errors[0].contains("board 2") && errors[0].contains("the other boards with it"));
}

#[test]
fn no_board_is_armed_while_another_does_not_answer_and_all_are_when_it_does() {
    let mut shop = Shop::new(17);
    shop.arm();
    until_given_up(&mut shop);
    shop.hal.said();
    let ask = |shop: &mut Shop| {
        shop.each("enable-request", false);
        shop.period();
        shop.period();
        shop.each("enable-request", true);
        for _ in 0..10 {
            shop.period();
        }
    };
    ask(&mut shop);
    for n in 0..4 {
        assert!(!shop.hal.get::<bool>(&format!("ferrocnc.{n}.enabled")));
    }
    let said = shop.hal.said();
    let errors = said
        .iter()
        .filter(|s| s.contains("board 2 of the group does not answer"));
    assert_eq!(errors.count(), 3, "one answer to one question: {said:?}");

    // The board went on, and its watchdog bit. The request is still high, which arms no board.
    shop.boards[2].look().advance(60_000 * 100);
    shop.boards[2].look().knobs.unplugged = false;
    shop.hal.set("ferrocnc.2.packet-read-timeout", 500_000_000);
    for _ in 0..220 {
        shop.period();
    }
    for n in 0..4 {
        assert!(!shop.hal.get::<bool>(&format!("ferrocnc.{n}.enabled")));
    }
    ask(&mut shop);
    for n in 0..4 {
        let enabled: bool = shop.hal.get(&format!("ferrocnc.{n}.enabled"));
        assert!(enabled, "board {n}: {:?}", shop.hal.said());
        assert_eq!(
            shop.hal.get::<u32>(&format!("ferrocnc.{n}.fault-reason")),
            0
        );
    }
}

#[test]
fn an_estop_at_one_board_stops_the_others_softly_and_a_wish_of_the_host_does_not() {
    let mut shop = Shop::new(19);
    shop.arm();
    shop.hal.set("ferrocnc.1.enable", false);
    for _ in 0..5 {
        shop.period();
    }
    for n in [0, 2, 3] {
        assert!(shop.hal.get::<bool>(&format!("ferrocnc.{n}.enabled")));
    }
    shop.boards[3].look().knobs.estop = 1 << 11;
    for _ in 0..5 {
        shop.period();
    }
    for n in [0, 2] {
        assert!(!shop.hal.get::<bool>(&format!("ferrocnc.{n}.enabled")));
        assert_eq!(
            shop.hal.get::<u32>(&format!("ferrocnc.{n}.fault-reason")),
            103
        );
        assert_eq!(shop.boards[n].look().reason, FaultReason::HostDisable);
    }
    assert_eq!(
        shop.hal.get::<u32>("ferrocnc.3.fault-reason"),
        u32::from(FaultReason::EStop.code())
    );
}

#[test]
fn a_board_taken_out_of_the_group_neither_stops_the_others_nor_is_stopped() {
    let mut shop = Shop::new(23);
    shop.arm();
    shop.hal.set("ferrocnc.2.stop-group", false);
    until_given_up(&mut shop);
    for _ in 0..10 {
        shop.period();
    }
    for n in [0, 1, 3] {
        assert!(
            shop.hal.get::<bool>(&format!("ferrocnc.{n}.enabled")),
            "board {n}"
        );
    }
    shop.hal.set("ferrocnc.3.stop-group", false);
    shop.boards[0].look().knobs.estop = 1 << 11;
    for _ in 0..5 {
        shop.period();
    }
    assert!(!shop.hal.get::<bool>("ferrocnc.1.enabled"));
    assert!(shop.hal.get::<bool>("ferrocnc.3.enabled"));
}

#[test]
fn a_driver_that_is_halted_stops_the_others() {
    let mut shop = Shop::new(29);
    shop.arm();
    for driver in &mut shop.drivers {
        driver.read(PERIOD_NS);
    }
    // As the fence does after a panic.
    shop.drivers[1].halt();
    for n in [0, 2, 3] {
        shop.seen(n, |driver| driver.write(PERIOD_NS));
        assert!(!shop.boards[n].look().command.enable, "board {n}");
        assert_eq!(
            shop.hal.get::<u32>(&format!("ferrocnc.{n}.fault-reason")),
            101
        );
    }
}

#[test]
fn four_boards_are_waited_for_together() {
    // Each answers 10 ms late. One after the other that is 40 ms a period; the time is printed, not
    // judged.
    let boards: Vec<FakeBoard> = (0..4)
        .map(|_| FakeBoard::mill6(Time::Lockstep(u64::from(CLOCK_HZ) / 1000)))
        .collect();
    let mut hal = FakeHal::new();
    let mut drivers: Vec<Driver> = boards
        .iter()
        .enumerate()
        .map(|(n, board)| load_with(board, &mut hal, n).0)
        .collect();
    for n in 0..4 {
        hal.set(&format!("ferrocnc.{n}.packet-read-timeout"), 2_000_000_000);
    }
    let period = |drivers: &mut [Driver]| {
        drivers.iter_mut().for_each(|driver| driver.read(PERIOD_NS));
        drivers
            .iter_mut()
            .for_each(|driver| driver.write(PERIOD_NS));
    };
    for _ in 0..200 {
        period(&mut drivers);
        std::thread::sleep(Duration::from_millis(1));
    }
    for board in &boards {
        board.look().knobs.delay = Duration::from_millis(10);
    }
    for count in [1, 4] {
        let start = std::time::Instant::now();
        for _ in 0..10 {
            for driver in &mut drivers[..count] {
                driver.read_request(PERIOD_NS);
            }
            period(&mut drivers[..count]);
        }
        println!("{count} boards: {:?} for ten periods", start.elapsed());
    }
    for n in 0..4 {
        let missing: u32 = hal.get(&format!("ferrocnc.{n}.packet-error-total"));
        assert_eq!(missing, 0, "board {n}");
    }
}
