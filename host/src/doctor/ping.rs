//! The round trip of a ping at real-time priority, on whichever processor and on LinuxCNC's: what
//! kernel, card, cable and a board's firmware take, and how far it varies. `ping` measures it,
//! `chrt` gives it the priority.
//!
//! An exchange takes another way through the board; [`super::soak`] measures that one.

use super::cpu;
use super::soak::{PERIOD, microseconds};
use super::system::System;
use crate::finding::Finding;
use std::net::Ipv4Addr;
use std::time::Duration;

/// Seconds between two pings: LinuxCNC's usual servo period.
const INTERVAL: &str = "0.001";
/// The highest there is, so that nothing but the way counts.
const HIGHEST: &str = "99";
/// On LinuxCNC's processor: below LinuxCNC's own threads (98) and the kernel's timers.
const BELOW: &str = "90";
/// ns. Above this the longest is worth knowing. A limit of our own.
const LONG: u64 = 100_000;
/// ns. The same on LinuxCNC's processor: users of LinuxCNC report 46, 47 and 58 us as good, and 60
/// to 70 as just good enough.
const LONG_THERE: u64 = 70_000;

/// All checks of this module: each pings the board for so long.
pub fn examine(
    system: &System<'_>,
    interface: &str,
    board: Option<Ipv4Addr>,
    ping: Option<Duration>,
) -> Vec<Finding> {
    let there = cpu::linuxcncs(system);
    let checks = [
        ("round trip of a ping".to_owned(), None, LONG),
        (
            format!("the same on CPU {there}"),
            Some(there.to_string()),
            LONG_THERE,
        ),
    ];
    let Some(board) = board.filter(|_| interface != "lo") else {
        return Vec::new();
    };
    let each = checks.iter().map(|(check, cpu, long)| {
        if system.runs("rtapi_app") {
            let reason = "LinuxCNC runs, and each ping stands in front of a command";
            return Finding::skipped(check, "not measured", reason, "end LinuxCNC, then again");
        }
        match ping {
            Some(time) => judge(check, &said(system, board, time, cpu.as_deref()), *long),
            None => Finding::skipped(
                check,
                "not measured",
                "that takes a minute, and only root may",
                "sudo ferrocnc doctor BOARD --ping",
            ),
        }
    });
    each.collect()
}

/// What `ping` prints, on this processor if one is named.
fn said(system: &System<'_>, board: Ipv4Addr, time: Duration, cpu: Option<&str>) -> String {
    let count = time.as_nanos().div_ceil(PERIOD.as_nanos()).to_string();
    let board = board.to_string();
    let priority = if cpu.is_some() { BELOW } else { HIGHEST };
    let ping = [
        "chrt", "-f", priority, "ping", "-i", INTERVAL, "-q", "-c", &count, &board,
    ];
    let printed = match cpu {
        Some(cpu) => system.print("taskset", &[&["-c", cpu], &ping[..]].concat()),
        None => system.print(ping[0], &ping[1..]),
    };
    printed.unwrap_or_default()
}

/// What was measured: pings sent and answered, and their times in ns.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Measured {
    sent: u64,
    answered: u64,
    /// Shortest, mean, longest, deviation; none if there was no answer.
    times: Option<[u64; 4]>,
}

/// Reads the two lines at the end, by their numbers: `ping` may speak another language.
fn measured(text: &str) -> Option<Measured> {
    let counts = text.lines().find(|line| line.contains('%'))?;
    let mut counts = counts.split(|c: char| !c.is_ascii_digit());
    let mut count = || counts.find_map(|word| word.parse().ok());
    let times = text.lines().find_map(|line| {
        // `rtt min/avg/max/mdev = 0.046/0.047/0.058/0.003 ms`
        let (_, times) = line.split_once(" = ")?;
        let mut times = times.split(['/', ' ']).map(|ms| ms.parse::<f64>().ok());
        let mut next = || Some((times.next()?? * 1e6).round() as u64);
        Some([next()?, next()?, next()?, next()?])
    });
    Some(Measured {
        sent: count()?,
        answered: count()?,
        times,
    })
}

fn judge(check: &str, text: &str, long: u64) -> Finding {
    let repair = "repair what the findings on processor and port say, then again";
    let Some(Measured {
        sent,
        answered,
        times,
    }) = measured(text)
    else {
        return Finding::skipped(
            check,
            "not measured",
            "ping or chrt is not there, or may not: only root has that priority",
            "sudo apt install iputils-ping util-linux, and sudo ferrocnc doctor BOARD --ping",
        );
    };
    let Some([shortest, mean, longest, deviation]) = times else {
        return Finding::bad(
            check,
            format!("none of {sent} was answered"),
            "the board is off, its address is another one, or something drops pings",
            "ferrocnc discover, then the findings on the port and the firewall",
        );
    };
    let [least, mean, most, deviation, spread] = [
        shortest,
        mean,
        longest,
        deviation,
        longest.saturating_sub(shortest),
    ]
    .map(microseconds);
    let fact = format!(
        "{least} to {most}, mean {mean}; spread {spread}, deviation {deviation}; of {sent} pings"
    );
    let half = u64::try_from(PERIOD.as_nanos() / 2).unwrap_or(u64::MAX);
    if answered < sent {
        return Finding::bad(
            check,
            format!("{} lost; {fact}", sent - answered),
            "a lost exchange is a period without a command",
            "another cable, away from motor leads; then the findings on the port",
        );
    }
    match longest {
        _ if longest <= long => Finding::good(check, fact),
        _ if longest < half => Finding::note(
            check,
            fact,
            &format!("longer than {} at worst", microseconds(long)),
            repair,
        ),
        _ => Finding::bad(
            check,
            fact,
            "half of a servo period of 1 ms and more at worst: little is left for motion control",
            repair,
        ),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::finding::Verdict::{Bad, Good, Note, Skipped};

    /// As ping of Debian 12 prints it.
    const SAID: &str = "PING 192.168.2.50 (192.168.2.50) 56(84) bytes of data.

--- 192.168.2.50 ping statistics ---
60000 packets transmitted, 60000 received, 0% packet loss, time 59999ms
rtt min/avg/max/mdev = 0.046/0.047/0.058/0.003 ms
";

    #[test]
    fn the_counts_and_times_of_ping_are_read_in_any_language() {
        let wanted = Measured {
            sent: 60_000,
            answered: 60_000,
            times: Some([46_000, 47_000, 58_000, 3_000]),
        };
        assert_eq!(measured(SAID), Some(wanted));
        let other = SAID.replace("packets transmitted", "Pakete gesendet");
        assert_eq!(measured(&other), Some(wanted));
        let busy = SAID.replace("0.003 ms", "0.003 ms, pipe 2");
        assert_eq!(measured(&busy), Some(wanted));
        assert_eq!(measured("ping: cannot flood"), None);
        assert_eq!(measured(""), None);
    }

    #[test]
    fn the_longest_is_judged_and_a_lost_one_is_bad() {
        let verdict = |text: &str, long| judge("x", text, long).verdict;
        assert_eq!(verdict(SAID, LONG_THERE), Good);
        for (longest, verdicts) in [
            ("0.070", [Good, Good]),
            ("0.071", [Good, Note]),
            ("0.101", [Note, Note]),
            ("0.500", [Bad, Bad]),
        ] {
            let text = SAID.replace("0.058", longest);
            let found = [LONG, LONG_THERE].map(|long| verdict(&text, long));
            assert_eq!(found, verdicts, "{longest} ms");
        }
        let lost = judge("x", &SAID.replace("60000 received", "59998 received"), LONG);
        assert_eq!(lost.verdict, Bad);
        assert!(lost.fact.starts_with("2 lost"), "{lost:?}");
        let (counts, _) = SAID.split_once("rtt").unwrap();
        assert_eq!(verdict(&counts.replace(" 60000 r", " 0 r"), LONG), Bad);
        assert_eq!(verdict("chrt: failed to set pid 0's policy", LONG), Skipped);
    }

    #[test]
    fn the_spread_is_told() {
        let fact = judge("x", SAID, LONG).fact;
        assert!(fact.contains("46.0 us to 58.0 us"), "{fact}");
        assert!(fact.contains("spread 12.0 us"), "{fact}");
    }
}
