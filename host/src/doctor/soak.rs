//! A soak: the exchange of the servo thread, a thousand times a second for a minute, without
//! LinuxCNC. What it measures is judged here; [`run`] does it, [`picture`] draws it.
//!
//! The board is taken for that time and never enabled: every command says that nothing may move,
//! and the outputs stay at their safe levels.

pub mod picture;
pub mod run;

use super::system::System;
use crate::blocks::{packets, watchdog};
use crate::finding::{Finding, Report};
use crate::histogram::{Histogram, Quantile};
use serde_json::{Value, json};
use std::time::Duration;

/// 1 ms, LinuxCNC's usual servo period.
pub const PERIOD: Duration = Duration::from_millis(1);
/// Servo periods to choose from, in ns.
const PERIODS: [u64; 5] = [250_000, 500_000, 1_000_000, 2_000_000, 4_000_000];
/// A period has room for so many of the longest exchange: what `read` waits for leaves half of it.
const ROOM: u64 = 2;
/// Processes of a LinuxCNC that runs.
const LINUXCNC: [&str; 3] = ["rtapi_app", "linuxcncsvr", "milltask"];
/// LinuxCNC's documents call a thread that is later than this unfit for hardware that makes steps.
const LATEST_WAKE: u64 = 500_000;
/// A watchdog with less than a quarter of its timeout left is near to biting. A limit of our own.
const NEAR: u64 = 4;

/// With which priority it was measured.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Priority {
    /// That of the servo thread; on this processor, if one is isolated.
    Realtime(Option<u32>),
    /// That of any program, because of this.
    Ordinary(String),
}

/// What was measured.
#[derive(Clone, Debug)]
pub struct Measured {
    /// The time between two exchanges.
    pub period: Duration,
    /// The priority of the thread.
    pub priority: Priority,
    /// Commands sent and counted.
    pub asked: u64,
    /// How long exchanges took that were answered in time.
    pub exchange: Histogram,
    /// How late the thread woke up.
    pub wake: Histogram,
    /// Answers that came after `read` had gone on.
    pub late: u64,
    /// Answers that never came.
    pub lost: u64,
}

impl Measured {
    /// Of nothing yet.
    pub fn new(period: Duration, priority: Priority) -> Self {
        Measured {
            period,
            priority,
            asked: 0,
            exchange: Histogram::default(),
            wake: Histogram::default(),
            late: 0,
            lost: 0,
        }
    }

    /// The judgement on it.
    pub fn report(&self, board: String) -> Report {
        Report {
            about: "soak",
            head: vec![
                ("board", board),
                ("period", microseconds(self.period_ns())),
                ("exchanges", self.asked.to_string()),
            ],
            findings: vec![
                self.priority(),
                self.exchange(),
                self.late(),
                self.lost(),
                self.wake(),
                self.watchdog(),
                self.servo_period(),
            ],
        }
    }

    /// The numbers, in ns, and the histogram: the longest time of each counter, and its count.
    pub fn to_json(&self) -> Value {
        let of = |histogram: &Histogram| {
            let counted: Vec<_> = histogram.counted().map(|it| json!([it.0, it.1])).collect();
            json!({
                "count": histogram.total(),
                "p50": histogram.quantile(Quantile::P50),
                "p99": histogram.quantile(Quantile::P99),
                "p99.9": histogram.quantile(Quantile::P99_9),
                "max": histogram.max(),
                "histogram": counted,
            })
        };
        json!({
            "period": self.period_ns(),
            "asked": self.asked,
            "late": self.late,
            "lost": self.lost,
            "exchange": of(&self.exchange),
            "wake": of(&self.wake),
        })
    }

    /// The shortest servo period that leaves room for the longest exchange and the latest wake-up,
    /// and lets the watchdog wait for two; none if answers are missing, or if there is no such one.
    pub fn recommended(&self) -> Option<u64> {
        if self.late > 0 || self.lost > 0 || self.exchange.total() == 0 {
            return None;
        }
        let least = self.exchange.max().max(self.wake.max());
        let least = least.saturating_mul(ROOM);
        let most = u64::from(watchdog::DEFAULT_TIMEOUT_NS) / 2;
        let mut periods = PERIODS.into_iter();
        periods.find(|period| (least..=most).contains(period))
    }

    fn period_ns(&self) -> u64 {
        to_ns(self.period)
    }

    /// What `read` waits at most.
    fn read_timeout(&self) -> u64 {
        packets::default_timeout_ns(self.period_ns() as i64)
    }

    fn priority(&self) -> Finding {
        let check = "priority";
        match &self.priority {
            Priority::Realtime(None) => Finding::good(check, "real-time"),
            Priority::Realtime(Some(cpu)) => {
                Finding::good(check, format!("real-time, on CPU {cpu}, which is isolated"))
            }
            Priority::Ordinary(why) => Finding::note(
                check,
                format!("that of any program: {why}"),
                "other programs hold the measurement up, so LinuxCNC's times are better than these",
                "sudo ferrocnc doctor BOARD --soak",
            ),
        }
    }

    fn exchange(&self) -> Finding {
        let (check, of) = ("exchange", &self.exchange);
        let [p50, p99, p99_9] = [Quantile::P50, Quantile::P99, Quantile::P99_9]
            .map(|quantile| microseconds(of.quantile(quantile)));
        let longest = microseconds(of.max());
        let fact = format!("p50 {p50}, p99 {p99}, p99.9 {p99_9}, longest {longest}");
        match of.total() {
            0 => Finding::bad(
                check,
                "none was answered in time",
                "the board or the way to it is too slow for this period",
                "ferrocnc doctor BOARD, and ferrocnc selftest BOARD",
            ),
            _ if of.max() * ROOM <= self.period_ns() => Finding::good(check, fact),
            _ => Finding::note(
                check,
                fact,
                "more than half of the period: little is left for motion control",
                "ferrocnc doctor BOARD says what of this computer makes exchanges slow",
            ),
        }
    }

    fn late(&self) -> Finding {
        let (check, limit) = ("late answers", microseconds(self.read_timeout()));
        match self.late {
            0 => Finding::good(check, format!("none after {limit}")),
            late => Finding::bad(
                check,
                format!("{late} after {limit}, the read timeout"),
                "each is a period without feedback, and five in a row stop the machine",
                "ferrocnc doctor BOARD says what of this computer makes them late",
            ),
        }
    }

    fn lost(&self) -> Finding {
        let check = "lost answers";
        match self.lost {
            0 => Finding::good(check, "none"),
            lost => Finding::bad(
                check,
                lost.to_string(),
                "frames disappear on the way, or something throws them away",
                "another cable, away from motor leads; the findings on the port of ferrocnc doctor BOARD",
            ),
        }
    }

    fn wake(&self) -> Finding {
        let (check, max) = ("wake-up", self.wake.max());
        let p99 = microseconds(self.wake.quantile(Quantile::P99));
        let fact = format!("p99 {p99}, latest {}", microseconds(max));
        let reason = "LinuxCNC's documents want a servo thread that is never later than 500 us";
        let remedy = "ferrocnc doctor; latency-histogram shows what other programs do to it";
        match &self.priority {
            _ if max <= LATEST_WAKE => Finding::good(check, fact),
            Priority::Realtime(_) => Finding::bad(check, fact, reason, remedy),
            Priority::Ordinary(_) => Finding::note(check, fact, reason, "measure with sudo"),
        }
    }

    fn watchdog(&self) -> Finding {
        let check = "watchdog";
        let timeout = u64::from(watchdog::DEFAULT_TIMEOUT_NS);
        let silence = self.period_ns() + self.wake.max() + self.exchange.max();
        let fact = format!(
            "{} between two commands at most, its timeout is {}",
            microseconds(silence),
            microseconds(timeout)
        );
        let remedy = "a larger watchdog.timeout-ns, after the findings above are in order";
        match timeout.checked_sub(silence) {
            Some(left) if left >= timeout / NEAR => Finding::good(check, fact),
            Some(_) => Finding::note(check, fact, "it is near to stopping the machine", remedy),
            None => Finding::bad(check, fact, "it would have stopped the machine", remedy),
        }
    }

    fn servo_period(&self) -> Finding {
        let check = "servo period";
        match self.recommended() {
            Some(period) => Finding::good(check, format!("[EMCMOT] SERVO_PERIOD = {period}")),
            None if self.late > 0 || self.lost > 0 => Finding::bad(
                check,
                "none is recommended",
                "answers are late or lost",
                "repair that first, then measure again",
            ),
            None => Finding::bad(
                check,
                "none is recommended",
                "no period has twice the time of the longest exchange and of the latest wake-up, and half of the watchdog's timeout",
                "repair what makes them long, then measure again",
            ),
        }
    }
}

/// Why nothing is measured now: LinuxCNC runs, and either would make the other late.
pub fn refusal(system: &System<'_>) -> Option<String> {
    let running = LINUXCNC.iter().find(|name| system.runs(name))?;
    Some(format!(
        "LinuxCNC runs on this computer ({running}), and either would make the other late; end \
         LinuxCNC, then measure"
    ))
}

/// A duration in ns.
fn to_ns(duration: Duration) -> u64 {
    u64::try_from(duration.as_nanos()).unwrap_or(u64::MAX)
}

/// ns for people.
pub fn microseconds(nanos: u64) -> String {
    match nanos {
        u64::MAX => "beyond 1 s".to_owned(),
        0..100_000 => format!("{:.1} us", nanos as f64 / 1e3),
        _ => format!("{:.0} us", nanos as f64 / 1e3),
    }
}

#[cfg(test)]
mod tests;
