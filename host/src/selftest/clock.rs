//! The board's clock against the host's: is the rate what the board says, and are no clocks
//! missing?
//!
//! The fabric stamps each frame with its 64-bit wall clock as the frame's last byte arrives. The
//! host knows only that this was after it sent the question and before it had the answer. So two
//! stamps give a lower and an upper bound for the rate, and a busy host makes the bounds wider,
//! never wrong.
//!
//! ```text
//!   host   before |--------------| after          before |-------| after
//!   board            board ^                            board ^
//! ```
//!
//! The system clock is made from the PHY's 25 MHz crystal. The Ethernet clock is the receive clock:
//! a PHY that is the slave of a link at 1000 Mbit/s recovers it from the cable, so it is the other
//! end's crystal; one that is the master has its own. The gateware counts it and catches the count
//! together with its wall clock, so those two are compared to parts of a ppm, whatever the host
//! does. Of three clocks, two that agree say which is off.

use super::Finding;
use std::time::Duration;
use wire::LinkSpeed;
use wire::map::ETH_BEAT_CLOCKS;

/// 200 ppm: the card's crystal (50) and the host's (100), some more for the one that disciplines
/// it.
const GOOD_PPM: f64 = 200.0;
/// 1000 ppm: no crystal is that far off; another crystal or another divider is farther.
const BAD_PPM: f64 = 1000.0;
/// 100 us: a PLL that lost its lock takes longer to find it. A simulated board that paces itself by
/// the host's clock is up to that uneven on an idle computer.
const UNEVEN_S: f64 = 100e-6;

/// One stamp.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sample {
    /// The host's time before it asked.
    pub before: Duration,
    /// The wall clock at arrival.
    pub board: u64,
    /// The host's time when it had the answer.
    pub after: Duration,
    /// The wall clock's low word and the Ethernet clock's beats as the gateware caught them
    /// together; none if it counts no such clock, or caught them again while they were read.
    pub caught: Option<[u32; 2]>,
}

/// The Ethernet clock as it was counted.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Counted {
    /// Its clocks.
    clocks: f64,
    /// Clocks of the board meanwhile.
    board: f64,
}

/// Counts it over all looks that are close enough together for no counter to have gone round.
fn counted(samples: &[Sample]) -> Counted {
    let mut counted = Counted {
        clocks: 0.0,
        board: 0.0,
    };
    let caught: Vec<(u64, [u32; 2])> = samples
        .iter()
        .filter_map(|sample| Some((sample.board, sample.caught?)))
        .collect();
    for pair in caught.windows(2) {
        let [(before, [then, beats]), (after, [now, more])] = pair else {
            continue;
        };
        if after.wrapping_sub(*before) < 1 << 31 {
            counted.board += f64::from(now.wrapping_sub(*then));
            counted.clocks += f64::from(more.wrapping_sub(*beats)) * f64::from(ETH_BEAT_CLOCKS);
        }
    }
    counted
}

/// What the receive clock is at a speed.
fn nominal(speed: LinkSpeed) -> Option<f64> {
    match speed {
        LinkSpeed::M1000 => Some(125e6),
        LinkSpeed::M100 => Some(25e6),
        LinkSpeed::M10 => Some(2.5e6),
        LinkSpeed::Down => None,
    }
}

/// Parts per million by which the board's clock is fast: least and most, by the best pair of
/// stamps.
pub fn ppm(samples: &[Sample], hz: u32) -> Option<(f64, f64)> {
    let third = samples.len() / 3;
    let (early, late) = (samples.get(..third)?, samples.get(samples.len() - third..)?);
    let tightest = |samples: &[Sample]| -> Option<Sample> {
        let width = |sample: &&Sample| sample.after.saturating_sub(sample.before);
        samples.iter().min_by_key(width).copied()
    };
    let (a, b) = (tightest(early)?, tightest(late)?);
    let clocks = b.board.checked_sub(a.board)? as f64 / f64::from(hz);
    let (most, least) = (
        b.after.checked_sub(a.before)?.as_secs_f64(),
        b.before.checked_sub(a.after)?.as_secs_f64(),
    );
    (least > 0.0).then(|| ((clocks / most - 1.0) * 1e6, (clocks / least - 1.0) * 1e6))
}

/// Steps from one stamp to the next that no clock near `rate` times the nominal one can have made.
fn jumps(samples: &[Sample], hz: u32, rate: f64) -> usize {
    let broken = |pair: &[Sample]| {
        let [a, b] = pair else { return false };
        let clocks = b.board as f64 - a.board as f64;
        let per = f64::from(hz) * rate;
        let most = b.after.saturating_sub(a.before).as_secs_f64() * per * 1.001 + UNEVEN_S * per;
        let least = b.before.saturating_sub(a.after).as_secs_f64() * per * 0.999 - UNEVEN_S * per;
        !(least..=most).contains(&clocks)
    };
    samples.windows(2).filter(|pair| broken(pair)).count()
}

/// Judges the stamps of a board that says its clock has `hz` and its link this speed. `readback`:
/// its gateware counts the Ethernet clock.
pub fn judge(samples: &[Sample], hz: u32, speed: LinkSpeed, readback: bool) -> Vec<Finding> {
    let by_host = ppm(samples, hz);
    let ethernet = match readback {
        true => ethernet(&counted(samples), hz, speed, by_host),
        false => Finding::skipped(
            "ethernet clock",
            "not measured",
            "this board's gateware has no counter in that clock",
            "build and flash it again: `ferrocnc update` with a .bit of this version",
        ),
    };
    vec![system(samples, hz), ethernet]
}

/// So far from what it should be, at least, if it lies between these two.
fn off((least, most): (f64, f64)) -> f64 {
    match least <= 0.0 && most >= 0.0 {
        true => 0.0,
        false => least.abs().min(most.abs()),
    }
}

/// The receive clock against the board's, and by what this computer says of that, which of them is
/// off.
fn ethernet(counted: &Counted, hz: u32, speed: LinkSpeed, by_host: Option<(f64, f64)>) -> Finding {
    let check = "ethernet clock";
    if counted.board < f64::from(hz) / 1e3 {
        return Finding::skipped(check, "not measured", "too few looks", "more `--seconds`");
    }
    let rate = counted.clocks / counted.board * f64::from(hz);
    // The PHY that says nothing of its link: what it is nearest to.
    let nearest = [125e6, 25e6, 2.5e6_f64]
        .into_iter()
        .min_by(|a, b| (rate / a).ln().abs().total_cmp(&(rate / b).ln().abs()))
        .unwrap_or(125e6);
    let wanted = nominal(speed).unwrap_or(nearest);
    let mhz = wanted / 1e6;
    if counted.clocks == 0.0 {
        return Finding::bad(
            check,
            "stands still",
            "but frames arrive and leave: its wire to the counter is broken, or the PHY stops it between frames",
            "send this report, with the card's name",
        );
    }
    let differs = (rate / wanted - 1.0) * 1e6;
    // Two beats: one at each end.
    let unsure = 2.0 * f64::from(ETH_BEAT_CLOCKS) / counted.clocks * 1e6;
    let fact =
        format!("{differs:+.1} ppm of {mhz} MHz, give or take {unsure:.1}, by the board's clock");
    let apart = off((differs - unsure, differs + unsure));
    if apart <= GOOD_PPM {
        return Finding::good(check, fact);
    }
    if apart > 100_000.0 && (rate / nearest - 1.0).abs() < 0.01 {
        let says =
            format!("the PHY reports a link at {speed}, but this is the clock of another speed");
        let remedy = "the PHY's in-band status, or its wires to the FPGA; send this report";
        return Finding::bad(check, fact, &says, remedy);
    }
    let board = by_host.map(off);
    // By this computer's clock: one ratio times the other.
    let times = |a: f64, b: f64| ((1.0 + a * 1e-6) * (1.0 + b * 1e-6) - 1.0) * 1e6;
    let by_host = by_host.map(|(least, most)| {
        off((
            times(least, differs - unsure),
            times(most, differs + unsure),
        ))
    });
    let (reason, remedy) = match (board, by_host) {
        (Some(board), _) if board <= GOOD_PPM => (
            "the board's clock and this computer's agree, so it is this one: the crystal of the PHY or of the cable's other end",
            "another switch or port; if it stays, the PHY's crystal",
        ),
        (_, Some(ethernet)) if ethernet <= GOOD_PPM => (
            "this clock and this computer's agree, so it is the board's: see `system clock`",
            "compare the card with its platform (docs/bringup.md)",
        ),
        _ => (
            "the board's clock, this one and this computer's all differ",
            "another computer, another switch, and look again",
        ),
    };
    match apart > BAD_PPM {
        true => Finding::bad(check, fact, reason, remedy),
        false => Finding::note(check, fact, reason, remedy),
    }
}

fn system(samples: &[Sample], hz: u32) -> Finding {
    let check = "system clock";
    let mhz = f64::from(hz) / 1e6;
    let backwards = samples
        .windows(2)
        .filter(|pair| pair[1].board <= pair[0].board)
        .count();
    if backwards > 0 {
        return Finding::bad(
            check,
            format!(
                "stood still or ran backwards {backwards} times in {} looks",
                samples.len()
            ),
            "the 64-bit wall clock only ever counts up",
            "check the supply's 1.1 V and 2.5 V, and build the bitstream with its timing checks on",
        );
    }
    let Some((least, most)) = ppm(samples, hz) else {
        return Finding::skipped(
            check,
            "not measured",
            "too few looks",
            "give more `--seconds`",
        );
    };
    let middle = (least + most) / 2.0;
    let fact = format!(
        "{middle:+.0} ppm of {mhz} MHz, give or take {:.0}, by this computer's clock",
        (most - least) / 2.0
    );
    let jumps = jumps(samples, hz, 1.0 + middle * 1e-6);
    if jumps > 0 {
        return Finding::bad(
            check,
            format!("{jumps} jumps; {fact}"),
            "clocks are missing between some measurements: the PLL loses its lock, or the PHY stops its clock",
            "check the supply and the PHY's clock output; send this report",
        );
    }
    let nearest = off((least, most));
    if nearest > BAD_PPM {
        let reason = "every rate, time and velocity is off by that factor: another crystal or divider than the platform file's";
        let remedy =
            "compare the card with its platform (docs/bringup.md); the crystal is at the PHY";
        return Finding::bad(check, fact, reason, remedy);
    }
    if nearest > GOOD_PPM {
        return Finding::note(
            check,
            fact,
            "more than two crystals differ by",
            "is this computer's clock being set right now? Try again in some minutes",
        );
    }
    if least.abs().max(most.abs()) > BAD_PPM {
        return Finding::note(
            check,
            fact,
            "this computer or the network is too busy for a better measurement",
            "give more `--seconds`",
        );
    }
    Finding::good(check, fact)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::selftest::Verdict::{self, Bad, Good, Note, Skipped};
    use proptest::prelude::*;

    const HZ: u32 = 60_000_000;

    /// Looks every 100 ms at a clock of this rate; the answer takes `trip` and was stamped after a
    /// third of it.
    fn looks(rate: f64, trip: Duration) -> Vec<Sample> {
        let look = |n: u32| {
            let before = Duration::from_millis(100) * n;
            let stamped = before + trip / 3;
            Sample {
                before,
                board: 1_000 + (stamped.as_secs_f64() * f64::from(HZ) * rate) as u64,
                after: before + trip,
                caught: None,
            }
        };
        (0..30).map(look).collect()
    }

    fn verdict(samples: &[Sample]) -> Verdict {
        judge(samples, HZ, LinkSpeed::M1000, false)[0].verdict
    }

    #[test]
    fn a_clock_is_good_until_no_crystal_is_that_far_off() {
        let trip = Duration::from_micros(200);
        for (rate, expected) in [
            (1.0, Good),
            (1.0001, Good),
            (0.9999, Good),
            (1.0006, Note),
            (0.9994, Note),
            (1.25, Bad),
            (0.8, Bad),
            (1.01, Bad),
        ] {
            assert_eq!(verdict(&looks(rate, trip)), expected, "{rate}");
        }
        assert_eq!(verdict(&[]), Skipped);
    }

    #[test]
    fn a_slow_network_says_less_and_never_something_wrong() {
        assert_eq!(verdict(&looks(1.0, Duration::from_millis(20))), Note);
        assert_eq!(verdict(&looks(1.25, Duration::from_millis(20))), Bad);
    }

    #[test]
    fn a_clock_that_jumps_or_goes_back_is_found() {
        let trip = Duration::from_micros(200);
        let mut samples = looks(1.0, trip);
        samples[15..]
            .iter_mut()
            .for_each(|sample| sample.board -= 100_000);
        assert_eq!(verdict(&samples), Bad);
        let mut samples = looks(1.0, trip);
        samples[15].board = samples[14].board;
        assert_eq!(verdict(&samples), Bad);
    }

    /// The same looks, with the Ethernet clock at so many hertz counted beside.
    fn beside(rate: f64, hertz: f64) -> Vec<Sample> {
        let mut samples = looks(rate, Duration::from_micros(200));
        for sample in &mut samples {
            // Caught a little before the stamp; both counters have gone round since power-up.
            let clock = sample.board - 700 + (1 << 32);
            let beats = clock as f64 / f64::from(HZ) / rate * hertz / 4.0 + 4_294_000_000.0;
            sample.caught = Some([clock as u32, beats as u64 as u32]);
        }
        samples
    }

    #[test]
    fn of_three_clocks_two_that_agree_say_which_is_off() {
        let finding = |rate: f64, hertz: f64, speed| {
            let mut findings = judge(&beside(rate, hertz), HZ, speed, true);
            let ethernet = findings.remove(1);
            (ethernet.verdict, ethernet.fact, ethernet.reason)
        };
        let right = 125e6;
        let (verdict, fact, _) = finding(1.0, right * 1.000_08, LinkSpeed::M1000);
        assert_eq!(verdict, Good, "{fact}");
        assert!(
            fact.starts_with("+80.") || fact.starts_with("+79.9"),
            "{fact}"
        );
        assert_eq!(finding(1.0, 25e6, LinkSpeed::M100).0, Good);
        assert_eq!(finding(1.0, 2.5e6, LinkSpeed::M10).0, Good);
        assert_eq!(finding(1.0, 25e6, LinkSpeed::Down).0, Good);
        for (rate, hertz, expected, said) in [
            (1.0, right * 1.000_5, Note, "so it is this one"),
            (1.0, right * 1.01, Bad, "so it is this one"),
            (1.04, right, Bad, "so it is the board's"),
            (1.000_5, right, Note, "so it is the board's"),
            (1.02, right * 0.98, Bad, "all differ"),
            (1.0, 25e6, Bad, "of another speed"),
            (1.0, 0.0, Bad, "frames arrive and leave"),
        ] {
            let (verdict, fact, reason) = finding(rate, hertz, LinkSpeed::M1000);
            assert_eq!(verdict, expected, "{rate} {hertz}: {fact}");
            assert!(reason.contains(said), "{rate} {hertz}: {reason}");
        }
        // This computer's clock is off: the other two agree.
        assert_eq!(finding(1.04, right * 1.04, LinkSpeed::M1000).0, Good);
    }

    #[test]
    fn a_gateware_without_the_counter_is_told_as_such() {
        let skipped = &judge(&looks(1.0, Duration::ZERO), HZ, LinkSpeed::M1000, false)[1];
        assert_eq!(skipped.verdict, Skipped);
        assert!(skipped.reason.contains("no counter"), "{skipped:?}");
        assert_eq!(judge(&[], HZ, LinkSpeed::M1000, true)[1].verdict, Skipped);
    }

    proptest! {
        #[test]
        fn the_rate_lies_within_its_bounds(
            rate in 0.5f64..2.0,
            trips in proptest::collection::vec((1u64..50_000, 0.0f64..1.0), 9..40),
        ) {
            let look = |(n, (trip, at)): (usize, &(u64, f64))| {
                let before = Duration::from_millis(100) * n as u32;
                let trip = Duration::from_micros(*trip);
                let stamped = before.as_secs_f64() + trip.as_secs_f64() * at;
                Sample {
                    before,
                    board: (stamped * f64::from(HZ) * rate) as u64,
                    after: before + trip,
                    caught: None,
                }
            };
            let samples: Vec<Sample> = trips.iter().enumerate().map(look).collect();
            if let Some((least, most)) = ppm(&samples, HZ) {
                let true_ppm = (rate - 1.0) * 1e6;
                prop_assert!((least - 1.0..=most + 1.0).contains(&true_ppm), "{least} {true_ppm} {most}");
            }
        }
    }
}
