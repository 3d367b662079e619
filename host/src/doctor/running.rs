//! What a LinuxCNC that runs says of itself in HAL: how much of the period the driver takes, which
//! answers did not come, how near the watchdog was. Read with `halcmd`, which changes nothing.

use super::system::System;
use crate::finding::{Finding, Verdict};
use std::collections::BTreeMap;

/// The driver's functions that the servo thread calls.
const FUNCTIONS: [&str; 3] = ["read-request", "read", "write"];
/// Percent of a period that they may take. A limit of our own: the other half is motion control's.
const SHARE: f64 = 50.0;
/// Percent of the watchdog's timeout that are to be left. A limit of our own.
const LEFT: f64 = 25.0;
/// Processor clocks from one servo period to the next.
const PERIOD: &str = "motion.servo.last-period";

/// All checks of this module. Without LinuxCNC there is only what it could measure.
pub fn examine(system: &System<'_>) -> Vec<Finding> {
    if !system.runs("rtapi_app") {
        return vec![Finding::skipped(
            "LinuxCNC's latency",
            "not measured",
            "that takes minutes, and the computer is to be as busy as it will be in the shop",
            "latency-histogram --nobase --nox, ten minutes, with a browser and disks at work: above 500 us it does not suffice",
        )];
    }
    let values = values(system);
    let boards: Vec<&str> = values
        .keys()
        .filter_map(|name| name.strip_suffix(".packet-error-total"))
        .filter(|name| name.starts_with("ferrocnc."))
        .collect();
    if boards.is_empty() {
        return vec![Finding::skipped(
            "the running machine",
            "HAL has no ferrocnc",
            "halcmd does not answer, or LinuxCNC runs without the driver",
            "give the command as the user of LinuxCNC: halcmd show pin ferrocnc.",
        )];
    }
    let each = boards.iter().flat_map(|board| {
        let hal = Hal {
            values: &values,
            board,
        };
        [hal.share(), hal.answers(), hal.margin()]
    });
    each.collect()
}

/// Pins and parameters with their values.
fn values(system: &System<'_>) -> BTreeMap<String, String> {
    let print = |what| system.print("halcmd", &["-s", "show", what]);
    let said = ["pin", "param"].map(|what| print(what).unwrap_or_default());
    let lines = said.iter().flat_map(|text| text.lines());
    let named = lines.filter_map(|line| {
        let mut words = line.split_whitespace().skip(3);
        let (value, name) = (words.next()?, words.next()?);
        Some((name.to_owned(), value.to_owned()))
    });
    named.collect()
}

/// A board's part of HAL.
struct Hal<'v> {
    values: &'v BTreeMap<String, String>,
    /// `ferrocnc.0`
    board: &'v str,
}

impl Hal<'_> {
    fn number(&self, name: &str) -> Option<f64> {
        // Scripts get hexadecimal numbers of some types.
        let text = self.values.get(name)?;
        match text.strip_prefix("0x") {
            Some(digits) => u32::from_str_radix(digits, 16).ok().map(f64::from),
            None => text.parse().ok(),
        }
    }

    fn own(&self, name: &str) -> Option<f64> {
        self.number(&format!("{}.{name}", self.board))
    }

    fn share(&self) -> Finding {
        let check = format!("{}'s time", self.board);
        let period = self.number(PERIOD).filter(|clocks| *clocks > 0.0);
        let longest = FUNCTIONS.map(|function| self.own(&format!("{function}.tmax")));
        let longest: f64 = longest.into_iter().flatten().sum();
        let Some(period) = period.filter(|_| longest > 0.0) else {
            return Finding::skipped(
                &check,
                "not known",
                "HAL has no times of its functions, or no period of motion control",
                "start the servo thread: LinuxCNC out of E-stop",
            );
        };
        let share = 100.0 * longest / period;
        let fact = format!("at most {share:.0} % of a servo period");
        match share <= SHARE {
            true => Finding::good(&check, fact),
            false => Finding::note(
                &check,
                fact,
                "motion control needs the rest; longest times since LinuxCNC started, also those of a page fault at the start",
                "setp the .tmax parameters to 0 and look again; then a longer SERVO_PERIOD, or `addf ferrocnc.0.read-request` first in the thread",
            )
            .lasting("[EMCMOT]SERVO_PERIOD in the INI file"),
        }
    }

    fn answers(&self) -> Finding {
        let check = format!("{}'s answers", self.board);
        let count = |name| self.own(name).unwrap_or(0.0);
        let wrong: Vec<String> = [
            ("packet-error-total", "missing"),
            ("packet-error-level", "level of missing ones"),
            ("link.errors", "frames damaged"),
            ("exchange.late", "late"),
            ("exchange.lost", "lost"),
        ]
        .into_iter()
        .filter(|(name, _)| count(name) > 0.0)
        .map(|(name, what)| format!("{what} {}", count(name)))
        .collect();
        if wrong.is_empty() {
            return Finding::good(&check, "all came in time");
        }
        let (verdict, reason) = match count("packet-error-level") > 0.0 {
            true => (
                Verdict::Bad,
                "answers are missing right now, and the board is given up at the limit",
            ),
            false => (
                Verdict::Note,
                "a period without an answer goes on with a guess of the position",
            ),
        };
        Finding::new(
            verdict,
            &check,
            wrong.join(", "),
            reason,
            "damaged frames: another cable; late ones: the findings on processor and port, then --soak",
        )
    }

    fn margin(&self) -> Finding {
        let check = format!("{}'s watchdog", self.board);
        let (least, timeout) = (
            self.own("watchdog.margin-ns-min"),
            self.own("watchdog.timeout-ns").filter(|ns| *ns > 0.0),
        );
        let none = [0.0, f64::from(u32::MAX)];
        let (Some(least), Some(timeout)) = (least, timeout) else {
            return Finding::skipped(&check, "not known", "HAL does not say", "");
        };
        if none.contains(&least) {
            return Finding::skipped(
                &check,
                "no margin yet",
                "it is counted from the moment at which the machine is armed",
                "arm the machine, let it move, then again",
            );
        }
        let left = 100.0 * least / timeout;
        let fact = format!("{left:.0} % of its timeout were left at least");
        match left > LEFT {
            true => Finding::good(&check, fact),
            false => Finding::note(
                &check,
                fact,
                "the servo thread was late, and a little later the machine stops",
                "see the findings on processor and port; setp watchdog.timeout-ns to five servo periods",
            )
            .lasting("the same line in the HAL file"),
        }
    }
}
