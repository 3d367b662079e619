//! Made-up times through the statistics, the judgement, the recommendation and the pictures.

use super::*;
use crate::finding::Verdict::{self, Bad, Good, Note};

/// 1000 exchanges of 80 us and a thread that wakes up in time, with a few others.
fn made(others: &[u64]) -> Measured {
    let mut measured = Measured::new(PERIOD, Priority::Realtime(Some(3)));
    for nanos in core::iter::repeat_n(80_000, 1000).chain(others.iter().copied()) {
        measured.exchange.record(nanos);
        measured.wake.record(8_000);
        measured.asked += 1;
    }
    measured
}

fn verdict(measured: &Measured, check: &str) -> Verdict {
    let report = measured.report("b".to_owned());
    let finding = report.findings.iter().find(|it| it.check == check);
    finding.expect("it was judged").verdict
}

#[test]
fn a_good_soak_has_only_good_findings_and_says_its_numbers() {
    let measured = made(&[110_000]);
    let report = measured.report("192.168.2.50".to_owned());
    assert_eq!(report.count(Good), report.findings.len(), "{report:?}");
    let text = report.to_text();
    for part in [
        "CPU 3",
        "p50 80",
        "longest 110 us",
        "none after 800 us",
        "SERVO_PERIOD = 250000",
    ] {
        assert!(text.contains(part), "{part}: {text}");
    }
    let json = measured.to_json();
    assert_eq!(json["exchange"]["max"], 110_000);
    assert_eq!(json["exchange"]["count"], 1001);
    assert_eq!(json["exchange"]["histogram"][1][1], 1);
}

#[test]
fn the_servo_period_has_room_for_two_of_the_longest_exchange_or_wake_up() {
    for (longest, latest, period) in [
        (100_000, 8_000, Some(250_000)),
        (125_001, 8_000, Some(500_000)),
        (100_000, 300_000, Some(1_000_000)),
        (700_000, 8_000, Some(2_000_000)),
        (1_000_001, 8_000, None),
    ] {
        let mut measured = made(&[longest]);
        measured.wake.record(latest);
        assert_eq!(measured.recommended(), period, "{longest}, {latest}");
        let wanted = period.map_or(Bad, |_| Good);
        assert_eq!(verdict(&measured, "servo period"), wanted);
    }
}

#[test]
fn no_period_is_recommended_while_answers_are_missing() {
    for (late, lost, check) in [(1, 0, "late answers"), (0, 1, "lost answers")] {
        let mut measured = made(&[]);
        (measured.late, measured.lost) = (late, lost);
        assert_eq!(measured.recommended(), None);
        assert_eq!(verdict(&measured, check), Bad);
        let report = measured.report("b".to_owned());
        assert!(report.to_text().contains("repair that first"));
    }
    let nothing = Measured::new(PERIOD, Priority::Realtime(None));
    assert_eq!(nothing.recommended(), None);
    assert_eq!(verdict(&nothing, "exchange"), Bad);
}

#[test]
fn an_exchange_beyond_half_of_the_period_and_a_late_thread_are_told() {
    assert_eq!(verdict(&made(&[500_000]), "exchange"), Good);
    assert_eq!(verdict(&made(&[500_001]), "exchange"), Note);
    let mut measured = made(&[]);
    measured.wake.record(500_001);
    assert_eq!(verdict(&measured, "wake-up"), Bad);
    measured.priority = Priority::Ordinary("not permitted".to_owned());
    assert_eq!(verdict(&measured, "wake-up"), Note);
    assert_eq!(verdict(&measured, "priority"), Note);
}

#[test]
fn the_watchdog_is_compared_with_the_longest_silence() {
    for (latest, wanted) in [(2_000_000, Good), (3_000_000, Note), (4_000_000, Bad)] {
        let mut measured = made(&[]);
        measured.wake.record(latest);
        assert_eq!(verdict(&measured, "watchdog"), wanted, "{latest}");
    }
}

#[test]
fn the_pictures_have_every_exchange() {
    let measured = made(&[60_000, 2_000_000]);
    let text = picture::text(&measured.exchange, 80);
    let counts = text.lines().map(|line| {
        let mut words = line.split_whitespace();
        words.nth(2).and_then(|count| count.parse::<u64>().ok())
    });
    assert_eq!(counts.map(Option::unwrap).sum::<u64>(), 1002, "{text}");
    assert!(text.lines().all(|line| line.len() <= 80), "{text}");
    assert!(text.lines().last().unwrap().ends_with('#'), "{text}");
    let svg = picture::svg(&measured, "a soak").expect("a plot");
    for part in ["<svg", "a soak", "p99.9", "time of an exchange"] {
        assert!(svg.contains(part), "{part}: {svg}");
    }
    let nothing = Measured::new(PERIOD, Priority::Realtime(None));
    assert_eq!(picture::text(&nothing.exchange, 80), "");
    assert!(picture::svg(&nothing, "nothing").is_ok());
}
