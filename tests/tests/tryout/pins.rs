//! What the pins do when a key is released, the tool is killed or the cable is pulled. Keys come at
//! made-up times and the twin's time passes with the exchanges, so the computer's speed is none of
//! it.

use crate::{PERIOD, twin};
use ferrocnc_tests::{Simulator, control};
use host::address;
use host::client::Client;
use host::tryout::board::Bench;
use host::tryout::{Arming, Edge, Key, Labelled, Layout, Motor, Tryout, Way};
use std::time::Duration;

/// Steps/s and steps/s^2: 250 ms and 250 steps to brake.
const SPEED: f64 = 2_000.0;
const ACCEL: f64 = 8_000.0;
const BRAKES: i64 = 250;
/// Steps of a period at full speed.
const PER_PERIOD: i64 = 10;

/// Each period has at most a step less than the one before, or two where one fell on the border.
fn is_soft(way: &[i64]) -> bool {
    way.windows(2).all(|two| two[0] - two[1] <= 2)
}

/// A hand at the keys, a tool without a terminal, a board.
struct Hand {
    // Goes before the board does.
    bench: Bench,
    twin: Simulator,
    tryout: Tryout,
    now: Duration,
}

impl Hand {
    /// Armed, at the fastest, with a distance that no test reaches.
    fn armed() -> Self {
        let twin = twin();
        let address = address::parse(&twin.udp().to_string(), 1234).expect("an address");
        let mut client = Client::open(&address).expect("a socket");
        let identity = client.identify().expect("the board");
        let motor = Motor {
            line: Labelled {
                name: "x".to_owned(),
                pins: String::new(),
                bit: 0,
            },
            scale: None,
            most: SPEED,
            accel: ACCEL,
            timing: [5_000, 5_000, 20_000, 20_000],
        };
        let layout = Layout {
            motors: vec![motor],
            ..Layout::default()
        };
        let patience = Duration::from_secs(1);
        let bench = Bench::take(client, &identity, &layout, patience).expect("its session");
        let mut hand = Hand {
            bench,
            twin,
            tryout: Tryout::new(layout),
            now: Duration::from_secs(1),
        };
        hand.period();
        for key in [Key::Faster, Key::Faster, Key::Faster] {
            hand.key(key);
        }
        hand.key(Key::Distance);
        hand.key(Key::Distance);
        hand.arm();
        hand
    }

    fn arm(&mut self) {
        self.key(Key::Arm);
        for _ in 0..20 {
            self.period();
        }
        assert_eq!(
            self.tryout.arming(),
            Arming::Armed,
            "{}",
            self.tryout.said()
        );
    }

    fn key(&mut self, key: Key) {
        self.tryout.key(key, self.now);
    }

    /// An exchange and the period after it; steps at the pins in that time.
    fn period(&mut self) -> i64 {
        let before = self.twin.steps();
        match self.bench.exchange(&self.tryout.order()) {
            Some(status) => self.tryout.answer(&status, self.now),
            None => self.tryout.silence(self.now),
        }
        self.now += PERIOD;
        self.twin.steps() - before
    }

    /// Holds the key for so many repeats of 40 ms; steps of the last period.
    fn hold(&mut self, repeats: u32) -> i64 {
        let mut last = 0;
        for _ in 0..repeats {
            self.key(Key::Move(Way::Plus, Edge::Down));
            last = (0..8).map(|_| self.period()).last().expect("eight");
        }
        last
    }

    /// The board alone: steps at the pins in so many milliseconds.
    fn alone(&self, ms: u32) -> i64 {
        let before = self.twin.steps();
        self.twin.run_ms(ms.into());
        self.twin.steps() - before
    }
}

#[test]
fn an_axis_brakes_softly_from_a_fifth_of_a_second_after_the_last_repeat() {
    let mut hand = Hand::armed();
    assert_eq!(hand.hold(15), PER_PERIOD, "full speed");
    let mut way = Vec::new();
    while hand.tryout.said() != "released" {
        way.push(hand.period());
    }
    assert!(way.len() <= 42, "{} periods", way.len());
    assert!(way.iter().all(|steps| *steps == PER_PERIOD), "{way:?}");
    let way: Vec<i64> = (0..60).map(|_| hand.period()).collect();
    // It takes its time, loses a fifth of a step of speed a period, and the drive stays on. The
    // last steps are further apart than a period.
    assert!(is_soft(&way), "{way:?}");
    let last = way.iter().rposition(|steps| *steps != 0);
    assert!((45..=54).contains(&last.expect("it moved")), "{way:?}");
    let sum: i64 = way.iter().sum();
    assert!((BRAKES..=BRAKES + 2 * PER_PERIOD).contains(&sum), "{sum}");
    assert!(hand.twin.is_open());
    assert_eq!(hand.alone(100), 0);
}

#[test]
fn a_released_key_brakes_at_once_where_the_terminal_tells_it() {
    let mut hand = Hand::armed();
    hand.hold(15);
    hand.key(Key::Move(Way::Plus, Edge::Up));
    let sum: i64 = (0..60).map(|_| hand.period()).sum();
    assert!((BRAKES..=BRAKES + 2 * PER_PERIOD).contains(&sum), "{sum}");
}

#[test]
fn a_jog_ends_on_its_step_at_the_pins_too() {
    let mut hand = Hand::armed();
    // From 10 000 steps to 100, over 10.
    hand.key(Key::Distance);
    hand.key(Key::Distance);
    let from = hand.twin.steps();
    hand.hold(40);
    assert_eq!(hand.tryout.said(), "there");
    assert_eq!(hand.twin.steps() - from, 100);
}

#[test]
fn a_killed_tool_leaves_an_axis_that_the_board_brakes_softly_and_then_lets_go() {
    let hand = {
        let mut hand = Hand::armed();
        assert_eq!(hand.hold(15), PER_PERIOD);
        hand
    };
    // Nothing is exchanged any more, as after a kill. The watchdog waits for 200 ms.
    let mut way: Vec<i64> = (0..38).map(|_| hand.alone(5)).collect();
    assert!(way.iter().all(|steps| *steps == PER_PERIOD), "{way:?}");
    assert!(hand.twin.is_open());
    way.clear();
    while hand.twin.is_open() {
        way.push(hand.alone(5));
    }
    assert!(is_soft(&way), "{way:?}");
    let sum: i64 = way.iter().sum();
    assert!((BRAKES..=BRAKES + 5 * PER_PERIOD).contains(&sum), "{way:?}");
    assert_eq!(
        way.last(),
        Some(&0),
        "it stood when the gate closed: {way:?}"
    );
    assert!(way.len() <= 105, "half a second of grace: {}", way.len());
    assert_eq!(hand.alone(500), 0);
}

#[test]
fn a_pulled_cable_stops_the_axis_and_plugged_in_it_rests_until_it_is_armed_again() {
    let mut hand = Hand::armed();
    hand.hold(15);
    let from = hand.twin.steps();
    control(hand.twin.control(), "fault pull");
    for _ in 0..host::tryout::LOST {
        hand.period();
    }
    assert_eq!(hand.tryout.arming(), Arming::Off, "{}", hand.tryout.said());
    hand.alone(1_000);
    let way = hand.twin.steps() - from;
    assert!((BRAKES..=BRAKES + 50 * PER_PERIOD).contains(&way), "{way}");
    assert!(!hand.twin.is_open());
    control(hand.twin.control(), "fault plug");
    // Longer than the board keeps a session that is silent.
    hand.alone(4_000);
    let mut periods = 0;
    while hand.tryout.status().is_none() {
        hand.period();
        periods += 1;
        assert!(periods < 200, "{}", hand.tryout.said());
    }
    hand.hold(20);
    assert_eq!(hand.hold(5), 0);
    assert!(!hand.twin.is_open());
    hand.arm();
    assert_eq!(hand.period(), 0, "the jog of before is over");
    assert_eq!(hand.hold(20), PER_PERIOD);
}

#[test]
fn disarming_in_motion_brakes_too() {
    let mut hand = Hand::armed();
    hand.hold(15);
    hand.key(Key::Arm);
    let way: Vec<i64> = (0..80).map(|_| hand.period()).collect();
    assert!(is_soft(&way), "{way:?}");
    assert_eq!(way.last(), Some(&0));
    assert!(!hand.twin.is_open());
}
