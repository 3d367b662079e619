//! A LinuxCNC configuration against the board: order of the functions, names of pins, step timing,
//! what the stepgens have in reserve, following error, homing, watchdog, e-stop.
//!
//! `ferrocnc machine write` makes files that are right; these checks are for those made by hand.

mod estop;

use super::files::Files;
use super::names::Pin;
use crate::blocks::watchdog;
use crate::finding::Finding;
use crate::hal::Direction;
use std::collections::BTreeSet;

/// ns of a second.
const SECOND: f64 = 1e9;
/// LinuxCNC's own period if the file says none, ns.
const PERIOD: f64 = 1e6;
/// The driver's own step timing, ns.
const TIMING: f64 = 5_000.0;
/// The same of a change of direction, ns.
const TURN: f64 = 20_000.0;
/// The stepgen's limits above LinuxCNC's, so that it can catch up.
const RESERVE: f64 = 1.25;
/// The same with backlash, which LinuxCNC adds at once.
const WITH_BACKLASH: f64 = 2.0;
/// Of what an axis moves in a period at full speed: less than this is the noise of sampling.
const NOISE: f64 = 0.1;
/// What rounding of decimal numbers in files may do.
const ROUNDING: f64 = 1.0 - 1e-9;

/// All checks of this module; `pins` are the board's, if it was asked.
pub fn examine(files: &Files, pins: Option<&[Pin]>) -> Vec<Finding> {
    let machine = Configured { files };
    let mut findings = vec![machine.order(), machine.names(pins), machine.writers(pins)];
    match machine.axes().is_empty() {
        false => findings.extend([
            machine.timing(),
            machine.reserve(),
            machine.following(),
            machine.homing(),
        ]),
        true => findings.push(Finding::skipped(
            "axes",
            "no joint leads to a stepgen of ferrocnc",
            "pins have other names, or a component is in between, so step timing, limits and homing are not checked",
            "compare them yourself: docs/guide/tuning.md",
        )),
    }
    findings.extend([machine.watchdog(), machine.estop()]);
    if !files.unread.is_empty() {
        findings.push(Finding::skipped(
            "other files",
            files.unread.join(", "),
            "only INI and HAL files are read, so what these say is not known",
            "look at them yourself",
        ));
    }
    findings
}

struct Configured<'f> {
    files: &'f Files,
}

/// A stepgen of the board and the joint that commands it.
struct Axis {
    joint: String,
    section: String,
    stepgen: String,
}

/// Good if nothing is wrong, else what is.
fn judged(check: &str, good: &str, wrong: &[String], reason: &str, remedy: &str) -> Finding {
    match wrong.is_empty() {
        true => Finding::good(check, good),
        false => Finding::bad(check, wrong.join("; "), reason, remedy),
    }
}

impl Configured<'_> {
    fn period(&self) -> f64 {
        let said = self.files.number("EMCMOT", "SERVO_PERIOD");
        said.filter(|ns| *ns > 0.0).unwrap_or(PERIOD)
    }

    /// `ferrocnc.0` and so on, of the functions.
    fn boards(&self) -> BTreeSet<&str> {
        let all = self.files.functions.iter();
        let ours = all.filter(|(function, _)| function.starts_with("ferrocnc."));
        ours.filter_map(|(function, _)| Some(function.rsplit_once('.')?.0))
            .collect()
    }

    fn axes(&self) -> Vec<Axis> {
        let joints = self.files.signals.values().flat_map(|pins| {
            let joint = pins.iter().find_map(|(pin, _)| {
                let number = pin.strip_prefix("joint.")?.strip_suffix(".motor-pos-cmd")?;
                Some(number.to_owned())
            });
            let stepgens = pins
                .iter()
                .filter(|(pin, _)| pin.starts_with("ferrocnc.") && pin.contains(".stepgen."))
                .filter_map(|(pin, _)| pin.strip_suffix(".position-cmd"));
            stepgens
                .filter_map(|stepgen| {
                    let number = joint.clone()?;
                    Some(Axis {
                        section: format!("JOINT_{number}"),
                        joint: format!("joint {number}"),
                        stepgen: stepgen.to_owned(),
                    })
                })
                .collect::<Vec<_>>()
        });
        joints.collect()
    }

    /// What `setp` gives a pin of an axis.
    fn own(&self, axis: &Axis, pin: &str) -> Option<f64> {
        self.files.value(&format!("{}.{pin}", axis.stepgen))
    }

    fn order(&self) -> Finding {
        let check = "order of the functions";
        let (boards, files) = (self.boards(), self.files);
        if boards.is_empty() || files.by_number {
            return Finding::skipped(
                check,
                "not known",
                "no function of ferrocnc is added, or places are given by number",
                "read, then motion-command-handler, motion-controller, the rest, then write",
            );
        }
        let place = |wanted: &str| files.functions.iter().position(|(name, _)| name == wanted);
        let motion = (place("motion-command-handler"), place("motion-controller"));
        let mut wrong = Vec::new();
        let (mut last_read, mut first_write) = (None, None);
        for board in boards {
            let (read, write) = (
                place(&format!("{board}.read")),
                place(&format!("{board}.write")),
            );
            let (Some(read), Some(write)) = (read, write) else {
                wrong.push(format!("{board} has no read or no write"));
                continue;
            };
            if motion.0.is_some_and(|at| read > at) {
                wrong.push(format!("{board}.read comes after motion-command-handler"));
            }
            if motion.1.is_some_and(|at| write < at) {
                wrong.push(format!("{board}.write comes before motion-controller"));
            }
            last_read = last_read.max(Some(read));
            first_write = Some(first_write.map_or(write, |at: usize| at.min(write)));
        }
        if wrong.is_empty() && last_read > first_write {
            wrong.push("a board is read after another one was written".to_owned());
        }
        judged(
            check,
            "reads, motion, writes",
            &wrong,
            "a command or a position is a period older than it has to be",
            "addf in this order: every read, motion-command-handler, motion-controller, the rest, every write",
        )
    }

    fn names(&self, pins: Option<&[Pin]>) -> Finding {
        let check = "pins in HAL files";
        let Some(pins) = pins else {
            return Finding::skipped(
                check,
                "not compared",
                "no board was asked",
                "ferrocnc doctor BOARD --ini FILE",
            );
        };
        let known: BTreeSet<&str> = pins
            .iter()
            .filter_map(|pin| pin.name.strip_prefix("ferrocnc.0."))
            .collect();
        let named = self.files.named();
        let ours = named.iter().filter(|name| name.starts_with("ferrocnc.0."));
        let (mut count, mut wrong) = (0, Vec::new());
        for name in ours {
            count += 1;
            let own = name.strip_prefix("ferrocnc.0.").unwrap_or_default();
            // Times of functions are HAL's own.
            if !known.contains(own) && !own.ends_with(".tmax") {
                wrong.push((*name).to_owned());
            }
        }
        judged(
            check,
            &format!("{count} of board 0, all there"),
            &wrong,
            "the board has no such pin, so LinuxCNC does not start",
            "ferrocnc describe BOARD shows the names; a board file with these channels makes them",
        )
    }

    fn writers(&self, pins: Option<&[Pin]>) -> Finding {
        let outs: BTreeSet<&str> = pins
            .unwrap_or_default()
            .iter()
            .filter(|pin| pin.direction == Direction::Out)
            .map(|pin| pin.name.as_str())
            .collect();
        let wrong: Vec<String> = self
            .files
            .signals
            .iter()
            .filter_map(|(signal, pins)| {
                let writes = |it: &&(String, bool)| it.1 || outs.contains(it.0.as_str());
                let all: BTreeSet<&str> = pins
                    .iter()
                    .filter(writes)
                    .map(|(pin, _)| pin.as_str())
                    .collect();
                let all: Vec<&str> = all.into_iter().collect();
                (all.len() > 1).then(|| format!("{signal} by {}", all.join(" and ")))
            })
            .collect();
        judged(
            "writers of signals",
            "one each",
            &wrong,
            "a signal takes its value from one pin; HAL refuses the second",
            "a signal of its own for each, joined by a component such as or2",
        )
    }

    fn timing(&self) -> Finding {
        let period = self.period();
        let mut wrong = Vec::new();
        for axis in self.axes() {
            let time = |pin, otherwise| self.own(&axis, pin).unwrap_or(otherwise);
            let one = time("steplen", TIMING) + time("stepspace", TIMING);
            let speed = self.files.number(&axis.section, "MAX_VELOCITY");
            let scale = self.own(&axis, "position-scale");
            if let (Some(speed), Some(scale)) = (speed, scale) {
                let rate = speed * scale.abs();
                if one * rate * ROUNDING > SECOND {
                    let most = SECOND / one;
                    wrong.push(format!(
                        "{} needs {rate:.0} steps/s and steplen + stepspace allow {most:.0}",
                        axis.joint
                    ));
                }
            }
            for pin in ["dirsetup", "dirhold"] {
                if time(pin, TURN) >= period {
                    wrong.push(format!("{}: {pin} is a servo period or more", axis.joint));
                }
            }
        }
        judged(
            "step timing",
            "leaves room for every axis at full speed",
            &wrong,
            "the axis falls behind, and LinuxCNC stops with a following error",
            "shorter times, as the drive's manual has them, or a lower MAX_VELOCITY, or fewer microsteps",
        )
    }

    fn reserve(&self) -> Finding {
        let mut wrong = Vec::new();
        for axis in self.axes() {
            let backlash = self.files.number(&axis.section, "BACKLASH");
            let least = match backlash.is_some_and(|backlash| backlash != 0.0) {
                true => WITH_BACKLASH,
                false => RESERVE,
            };
            for (pin, key, least) in [
                ("maxaccel", "MAX_ACCELERATION", least),
                ("maxvel", "MAX_VELOCITY", RESERVE),
            ] {
                let limits = (self.own(&axis, pin), self.files.number(&axis.section, key));
                // 0 is none.
                let (Some(own), Some(limit)) = limits else {
                    continue;
                };
                if own != 0.0 && own < least * limit * ROUNDING {
                    let joint = &axis.joint;
                    wrong.push(format!(
                        "{joint}: {pin} {own} is below {least} x {key} {limit}"
                    ));
                }
            }
        }
        judged(
            "the stepgens' reserve",
            "every stepgen may do more than LinuxCNC asks",
            &wrong,
            "a stepgen that is behind cannot catch up",
            "STEPGEN_MAXVEL 1.25 times MAX_VELOCITY, STEPGEN_MAXACCEL 1.25 times MAX_ACCELERATION, twice with BACKLASH",
        )
    }

    fn following(&self) -> Finding {
        let seconds = self.period() / SECOND;
        let mut wrong = Vec::new();
        for axis in self.axes() {
            let number = |key| self.files.number(&axis.section, key);
            let noise = number("MAX_VELOCITY").unwrap_or(0.0) * seconds * NOISE;
            let (wide, narrow) = (number("FERROR"), number("MIN_FERROR"));
            for (key, limit) in [("FERROR", wide), ("MIN_FERROR", narrow)] {
                if limit.is_some_and(|limit| limit < noise * ROUNDING) {
                    let joint = &axis.joint;
                    wrong.push(format!(
                        "{joint}: {key} is below {noise:.4}, the noise of a period"
                    ));
                }
            }
            if let (Some(wide), Some(narrow)) = (wide, narrow)
                && wide < narrow
            {
                wrong.push(format!("{}: FERROR is below MIN_FERROR", axis.joint));
            }
        }
        judged(
            "following error",
            "its limits are above the noise of a period",
            &wrong,
            "LinuxCNC stops although the axis is where it should be",
            "MIN_FERROR a tenth of what the axis moves in a period at full speed, or more; FERROR ten times that",
        )
    }

    fn homing(&self) -> Finding {
        let mut wrong = Vec::new();
        for axis in self.axes() {
            let number = |key| self.files.number(&axis.section, key);
            let or_zero = |key| number(key).unwrap_or(0.0);
            let (search, latch) = (or_zero("HOME_SEARCH_VEL"), or_zero("HOME_LATCH_VEL"));
            let joint = &axis.joint;
            if search != 0.0 && latch == 0.0 {
                wrong.push(format!("{joint}: HOME_SEARCH_VEL without HOME_LATCH_VEL"));
            }
            let (Some(min), Some(max)) = (number("MIN_LIMIT"), number("MAX_LIMIT")) else {
                continue;
            };
            let (home, offset) = (or_zero("HOME"), or_zero("HOME_OFFSET"));
            if home < min || home > max {
                wrong.push(format!("{joint}: HOME {home} is outside {min} to {max}"));
            }
            // In the middle, a switch may be on either side.
            let middle = (min + max) / 2.0;
            let is_away = (offset < middle && search > 0.0) || (offset > middle && search < 0.0);
            if is_away {
                wrong.push(format!(
                    "{joint}: HOME_SEARCH_VEL leads away from HOME_OFFSET {offset}, which is near the other end"
                ));
            }
        }
        judged(
            "homing",
            "agrees with the limits",
            &wrong,
            "the axis runs away from its switch, or homes to where it may not be",
            "HOME_SEARCH_VEL towards the switch, HOME_OFFSET where the switch is, HOME between the limits",
        )
    }

    fn watchdog(&self) -> Finding {
        let check = "watchdog and servo period";
        let period = self.period();
        let mut wrong = Vec::new();
        for board in self.boards() {
            let said = self.files.value(&format!("{board}.watchdog.timeout-ns"));
            let timeout = said.unwrap_or(f64::from(watchdog::DEFAULT_TIMEOUT_NS));
            if timeout < 2.0 * period {
                wrong.push(format!("{board}: {timeout} ns for periods of {period} ns"));
            }
        }
        judged(
            check,
            "it waits for two periods or more",
            &wrong,
            "one late period stops the machine",
            "setp ferrocnc.0.watchdog.timeout-ns to five servo periods",
        )
    }
}

#[cfg(test)]
mod tests;
