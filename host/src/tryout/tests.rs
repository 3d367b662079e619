//! Keys, times and answers in; orders out.

use super::measured::{Change, Measured};
use super::{
    Act, Arming, Edge, IDLE, Key, LOST, Labelled, Layout, Motor, ON_FOR, Order, Row, Tryout, Way,
};
use std::time::Duration;
use wire::State;
use wire::describe::Channels;
use wire::exchange::{Status, status_words};
use wire::units::{Count, Position};

const CHANNELS: Channels = Channels {
    stepgens: 2,
    encoders: 1,
    pwms: 0,
    inputs: 1,
    outputs: 2,
};
/// Between two exchanges.
const EVERY: Duration = Duration::from_millis(5);

/// A board that does what it is told at once, and the clock.
struct Rig {
    tryout: Tryout,
    status: Status,
    now: Duration,
    /// Steps/s that reach the motors.
    most: f64,
    answers: bool,
}

fn line(bit: u8, name: &str) -> Labelled {
    Labelled {
        name: name.to_owned(),
        pins: String::new(),
        bit,
    }
}

fn motor(name: &str, scale: Option<f64>) -> Motor {
    Motor {
        line: line(0, name),
        scale,
        most: 1_600.0,
        accel: 8_000.0,
        timing: [5_000; 4],
    }
}

fn layout() -> Layout {
    Layout {
        inputs: vec![line(0, "probe")],
        outputs: vec![line(0, "enable"), line(1, "flood")],
        motors: vec![motor("x", Some(320.0)), motor("y", Some(-320.0))],
        encoders: vec![line(0, "spindle")],
        drive_enable: Some(0),
        unit: "mm".to_owned(),
    }
}

impl Rig {
    fn new() -> Self {
        let mut status =
            Status::parse(&vec![0; status_words(CHANNELS)], CHANNELS).expect("an empty status");
        status.state.state = State::Disarmed;
        status
            .stepgen
            .iter_mut()
            .for_each(|it| it.0 = Position::ZERO);
        let mut rig = Rig {
            tryout: Tryout::new(layout()),
            status,
            now: Duration::from_secs(1),
            most: 0.0,
            answers: true,
        };
        rig.run(10);
        rig
    }

    fn armed() -> Self {
        let mut rig = Rig::new();
        rig.key(Key::Arm);
        rig.run(20);
        assert_eq!(rig.tryout.arming(), Arming::Armed);
        rig
    }

    /// Armed, with this row selected.
    fn at(row: Row) -> Self {
        let mut rig = Rig::armed();
        while rig.tryout.row() != Some(row) {
            rig.key(Key::Next);
        }
        rig
    }

    fn key(&mut self, key: Key) -> Option<Act> {
        self.tryout.key(key, self.now)
    }

    fn right(&mut self) {
        self.key(Key::Move(Way::Plus, Edge::Down));
    }

    fn order(&self) -> Order {
        self.tryout.order()
    }

    /// So many milliseconds.
    fn run(&mut self, ms: u64) {
        for _ in 0..ms / 5 {
            self.now += EVERY;
            let order = self.tryout.order();
            if !self.answers {
                self.tryout.silence(self.now);
                continue;
            }
            let enabled = &mut self.status.state.enabled;
            *enabled = order.enable && (order.request || *enabled);
            if let Some((n, speed)) = order.motion {
                self.most = self.most.max(speed.abs());
                let steps = speed * EVERY.as_secs_f64();
                self.status.stepgen[n].0.0 += (steps * 2f64.powi(32)) as i64;
            }
            self.tryout.answer(&self.status, self.now);
        }
    }

    /// Holds the key for so long, as a terminal repeats it.
    fn hold(&mut self, ms: u64) {
        self.right();
        self.run(500);
        for _ in 0..ms / 40 {
            self.right();
            self.run(40);
        }
    }

    fn steps(&self, motor: usize) -> i64 {
        self.status.stepgen[motor].0.pulses()
    }
}

#[test]
fn nothing_is_armed_before_the_key_and_the_request_rises_after_the_board_has_heard() {
    let mut rig = Rig::new();
    assert_eq!(rig.order(), Order::default());
    rig.key(Key::Arm);
    let order = rig.order();
    assert!(order.enable && !order.request, "{order:?}");
    rig.run(5);
    assert!(rig.order().request);
    rig.run(20);
    assert_eq!(rig.tryout.arming(), Arming::Armed);
}

#[test]
fn the_drives_are_enabled_while_it_is_armed_and_only_then() {
    let mut rig = Rig::armed();
    assert_eq!(rig.order().on, 1);
    rig.key(Key::Arm);
    assert_eq!(rig.order(), Order::default());
}

#[test]
fn a_held_key_for_arming_does_not_arm_again() {
    let mut rig = Rig::armed();
    for _ in 0..30 {
        rig.run(40);
        rig.key(Key::Arm);
    }
    assert_eq!(rig.tryout.arming(), Arming::Off);
    rig.run(1000);
    rig.key(Key::Arm);
    rig.run(20);
    assert_eq!(rig.tryout.arming(), Arming::Armed);
}

#[test]
fn a_board_with_an_estop_is_not_asked() {
    let mut rig = Rig::new();
    rig.status.state.estop = true;
    rig.run(5);
    rig.key(Key::Arm);
    assert_eq!(rig.tryout.arming(), Arming::Off);
    assert!(rig.tryout.said().contains("e-stop"));
}

#[test]
fn a_board_that_does_not_arm_is_no_longer_asked() {
    let mut rig = Rig::new();
    rig.key(Key::Arm);
    for _ in 0..250 {
        rig.now += EVERY;
        rig.tryout.answer(&rig.status.clone(), rig.now);
    }
    assert_eq!(rig.tryout.arming(), Arming::Off);
    assert!(
        rig.tryout.said().contains("does not arm"),
        "{}",
        rig.tryout.said()
    );
}

#[test]
fn one_output_is_on_at_a_time_and_goes_off_by_itself() {
    let mut rig = Rig::at(Row::Output(1));
    rig.key(Key::Enter);
    assert_eq!(rig.order().on, 0b11);
    rig.run(ON_FOR.as_millis() as u64 - 10);
    assert_eq!(rig.order().on, 0b11);
    rig.run(20);
    assert_eq!(rig.order().on, 0b01);
    rig.key(Key::Enter);
    rig.key(Key::Enter);
    assert_eq!(rig.order().on, 0b01, "the same key again");
    rig.key(Key::Enter);
    rig.key(Key::Previous);
    assert_eq!(rig.order().on, 0b01, "another row");
}

#[test]
fn nothing_is_switched_or_moved_before_it_is_armed() {
    let mut rig = Rig::new();
    rig.key(Key::Next);
    rig.key(Key::Enter);
    assert_eq!(rig.order(), Order::default());
    rig.key(Key::Next);
    rig.hold(1000);
    assert_eq!((rig.order(), rig.steps(0)), (Order::default(), 0));
}

#[test]
fn a_press_alone_moves_nothing() {
    let mut rig = Rig::at(Row::Motor(0));
    rig.right();
    rig.run(2000);
    assert_eq!(rig.steps(0), 0);
    // Nor does another one that comes too late to be its repeat.
    rig.right();
    rig.run(1000);
    assert_eq!(rig.steps(0), 0);
}

#[test]
fn a_held_key_moves_and_its_release_is_seen_a_fifth_of_a_second_later() {
    let mut rig = Rig::at(Row::Motor(0));
    rig.key(Key::Distance);
    rig.hold(400);
    assert!(
        rig.order()
            .motion
            .is_some_and(|(n, speed)| n == 0 && speed > 0.0)
    );
    rig.run(150);
    assert!(rig.order().motion.is_some());
    rig.run(60);
    assert_eq!(rig.order().motion, None);
    let stopped = rig.steps(0);
    rig.run(500);
    assert_eq!(rig.steps(0), stopped);
}

#[test]
fn a_terminal_that_tells_the_release_stops_at_once() {
    let mut rig = Rig::at(Row::Motor(0));
    rig.hold(200);
    rig.key(Key::Move(Way::Plus, Edge::Up));
    assert_eq!(rig.order().motion, None);
}

#[test]
fn every_other_key_stops_a_jog() {
    let others = [
        Key::Stop,
        Key::Next,
        Key::Enter,
        Key::Faster,
        Key::Mark,
        Key::Measure,
        Key::Backspace,
        Key::Move(Way::Minus, Edge::Down),
    ];
    for key in others {
        let mut rig = Rig::at(Row::Motor(0));
        rig.hold(200);
        assert!(rig.order().motion.is_some());
        rig.key(key);
        assert_eq!(rig.order().motion, None, "{key:?}");
    }
}

#[test]
fn a_jog_goes_its_distance_to_the_step_and_no_faster_than_it_may() {
    let mut rig = Rig::at(Row::Motor(0));
    for _ in 0..10 {
        rig.key(Key::Faster);
    }
    rig.hold(3000);
    assert_eq!(rig.steps(0), 320);
    assert!(rig.most <= 1_600.0, "{}", rig.most);
    // The key that is still held begins no other one.
    for _ in 0..20 {
        rig.right();
        rig.run(40);
    }
    assert_eq!(rig.steps(0), 320);
}

#[test]
fn a_reversed_motor_goes_the_other_way() {
    let mut rig = Rig::at(Row::Motor(1));
    rig.hold(3000);
    assert_eq!(rig.steps(1), -320);
}

#[test]
fn a_lost_link_switches_off_and_needs_the_key_again() {
    let mut rig = Rig::at(Row::Motor(0));
    rig.key(Key::Distance);
    rig.hold(400);
    rig.answers = false;
    rig.run(u64::from(LOST) * 5);
    assert_eq!(rig.order(), Order::default());
    rig.answers = true;
    for _ in 0..20 {
        rig.right();
        rig.run(40);
    }
    assert_eq!(rig.order(), Order::default());
    rig.key(Key::Arm);
    rig.run(20);
    assert_eq!(rig.tryout.arming(), Arming::Armed);
    assert_eq!(rig.order().motion, None, "the jog of before is over");
}

#[test]
fn one_lost_answer_is_none() {
    let mut rig = Rig::at(Row::Motor(0));
    rig.hold(200);
    rig.answers = false;
    rig.run(u64::from(LOST - 1) * 5);
    rig.answers = true;
    rig.run(5);
    assert!(rig.order().motion.is_some());
}

#[test]
fn a_stop_of_the_board_ends_it() {
    let mut rig = Rig::at(Row::Output(1));
    rig.key(Key::Enter);
    rig.status.state.enabled = false;
    rig.tryout.answer(&rig.status.clone(), rig.now);
    assert_eq!(rig.order(), Order::default());
    assert!(
        rig.tryout.said().contains("stopped"),
        "{}",
        rig.tryout.said()
    );
}

#[test]
fn a_minute_without_a_key_switches_off() {
    let mut rig = Rig::armed();
    rig.run(IDLE.as_millis() as u64 - 100);
    assert_eq!(rig.tryout.arming(), Arming::Armed);
    rig.run(200);
    assert_eq!(rig.tryout.arming(), Arming::Off);
}

#[test]
fn an_encoder_is_counted_from_its_mark_and_over_the_end_of_its_count() {
    let mut rig = Rig::at(Row::Encoder(0));
    rig.status.encoder[0].count = Count(u32::MAX);
    rig.run(5);
    rig.key(Key::Mark);
    rig.status.encoder[0].count = Count(3999);
    rig.run(5);
    assert_eq!(rig.tryout.turned(0), 4000);
}

fn typed(rig: &mut Rig, text: &str) {
    rig.key(Key::Measure);
    for digit in text.chars() {
        rig.key(Key::Digit(digit));
    }
    rig.key(Key::Enter);
}

#[test]
fn what_was_measured_makes_a_scale_and_w_offers_it() {
    let mut rig = Rig::at(Row::Motor(0));
    assert_eq!(rig.key(Key::Write), None);
    typed(&mut rig, "9.8");
    assert!(rig.tryout.found().is_none(), "it has not moved");
    rig.key(Key::Escape);
    rig.key(Key::Arm);
    rig.status.stepgen[0].0 = Position(3200 << 32);
    rig.run(1000);
    typed(&mut rig, "9.8");
    let found = rig.tryout.found().expect("a scale").clone();
    assert!((found.scale - 3200.0 / 9.8).abs() < 1e-9);
    assert!(
        rig.tryout.said().contains("326.530612"),
        "{}",
        rig.tryout.said()
    );
    assert_eq!(rig.key(Key::Write), Some(Act::Write(found)));
}

#[test]
fn a_ratio_near_a_power_of_two_is_of_the_microsteps_and_any_other_of_the_pitch() {
    let change = |typed| {
        Measured::new(0, 3200, typed, Some(320.0))
            .expect(typed)
            .change()
    };
    assert_eq!(change("5.02"), Some(Change::Microsteps(2.0)));
    assert_eq!(change("40"), Some(Change::Microsteps(0.25)));
    let Some(Change::Pitch(factor)) = change("9.8") else {
        panic!("of the pitch");
    };
    assert!((factor - 0.98).abs() < 1e-9);
    assert_eq!(
        Measured::new(0, 3200, "9.8", None)
            .expect("a scale")
            .change(),
        None
    );
}

#[test]
fn a_minus_says_that_it_went_the_other_way() {
    let other = Measured::new(0, 3200, "-10", Some(320.0)).expect("a scale");
    assert!(other.is_reversed());
    let same = Measured::new(0, 3200, "10", Some(-320.0)).expect("a scale");
    assert!(!same.is_reversed() && same.scale == -320.0);
    // Jogged to the left: a ruler has no sign.
    let left = Measured::new(0, -3200, "10", Some(320.0)).expect("a scale");
    assert_eq!(left.scale, 320.0);
}

#[test]
fn no_number_and_no_way_are_refused() {
    for (typed, steps) in [
        ("", 10),
        ("9,8", 10),
        ("0", 10),
        ("inf", 10),
        ("NaN", 10),
        ("1", 0),
    ] {
        assert!(
            Measured::new(0, steps, typed, None).is_err(),
            "{typed} {steps}"
        );
    }
}
