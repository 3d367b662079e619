//! Checks the PHY's link and the cable: the reported state, and the loss among some thousand
//! datagrams.

use super::Finding;
use std::time::Duration;
use wire::LinkSpeed;
use wire::flash::LinkWord;

/// The facts.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Facts {
    /// The link before.
    pub before: LinkWord,
    /// And after.
    pub after: LinkWord,
    /// Questions asked.
    pub asked: u32,
    /// Of these never answered.
    pub missing: u32,
    /// Answers with other words than requested.
    pub wrong: u32,
    /// Datagrams the board refused meanwhile.
    pub refused: u32,
    /// Round trips: shortest, median, longest.
    pub trips: [Duration; 3],
}

/// Judges them.
pub fn judge(facts: &Facts) -> Vec<Finding> {
    vec![phy(facts), errors(facts), traffic(facts)]
}

fn phy(facts: &Facts) -> Finding {
    let (check, link) = ("phy", facts.after);
    let duplex = match link.full_duplex {
        true => "full duplex",
        false => "half duplex",
    };
    match link.speed {
        LinkSpeed::Down => Finding::note(
            check,
            "says nothing of its link, and the board answers over it",
            "the PHY's in-band status is off, so only the watchdog stops the machine when the cable is pulled",
            "say which card this is when you send the report",
        ),
        speed if !link.full_duplex => Finding::bad(
            check,
            format!("{speed}, {duplex}"),
            "frames of both sides collide and wait",
            "use a switch instead of a hub, and do not set a fixed speed at the other end",
        ),
        LinkSpeed::M1000 => Finding::good(check, format!("{}, {duplex}", link.speed)),
        speed @ (LinkSpeed::M10 | LinkSpeed::M100) => Finding::note(
            check,
            format!("{speed}, {duplex}"),
            "the card can do 1000 Mbit/s; a missing pair of wires or an older switch makes it slower",
            "if the other end can do gigabit, try another cable",
        ),
    }
}

fn errors(facts: &Facts) -> Finding {
    let check = "frames thrown away";
    let since = facts.after.errors.wrapping_sub(facts.before.errors) & 0xff_ffff;
    let fact = format!("{since} in the test, {} since power-up", facts.after.errors);
    match (since, facts.before.errors) {
        (0, 0) => Finding::good(check, fact),
        (0, _) => Finding::note(
            check,
            fact,
            "frames with a wrong checksum came earlier, such as while the cable was plugged in",
            "look again later (`ferrocnc watch`); the count should stand",
        ),
        (_, _) => Finding::bad(
            check,
            fact,
            "frames reach the board's MAC damaged: cable, jack, or the wires between PHY and FPGA",
            "try another cable and another port; if it stays, check the joints of the PHY",
        ),
    }
}

fn traffic(facts: &Facts) -> Finding {
    let check = "traffic";
    let [least, median, most] = facts.trips.map(|trip| trip.as_secs_f64() * 1e6);
    let fact = format!(
        "{} of {} questions answered, {least:.0} / {median:.0} / {most:.0} us (min/median/max)",
        facts.asked - facts.missing,
        facts.asked
    );
    let reason = match (facts.missing, facts.wrong, facts.refused) {
        (0, 0, 0) => return Finding::good(check, fact),
        (0, 0, refused) => {
            format!("the board refused {refused} datagrams: damaged where no checksum looks")
        }
        (missing, 0, _) => format!("{missing} questions or their answers were lost"),
        (_, wrong, _) => format!("{wrong} answers hold other words than the same question before"),
    };
    Finding::bad(
        check,
        fact,
        &reason,
        "try another cable and port, without Wi-Fi or a hub; then check the PHY's joints",
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::selftest::Verdict::{self, Bad, Good, Note};

    fn verdicts(change: impl Fn(&mut Facts)) -> Vec<Verdict> {
        let word = LinkWord {
            speed: LinkSpeed::M1000,
            full_duplex: true,
            errors: 0,
        };
        let mut facts = Facts {
            before: word,
            after: word,
            asked: 1000,
            missing: 0,
            wrong: 0,
            refused: 0,
            trips: [Duration::from_micros(100); 3],
        };
        change(&mut facts);
        judge(&facts)
            .iter()
            .map(|finding| finding.verdict)
            .collect()
    }

    #[test]
    fn each_defect_of_a_link_is_found() {
        assert_eq!(verdicts(|_| {}), [Good; 3]);
        assert_eq!(verdicts(|f| f.after.errors = 1), [Good, Bad, Good]);
        let before = |f: &mut Facts| (f.before.errors, f.after.errors) = (3, 3);
        assert_eq!(verdicts(before), [Good, Note, Good]);
        // The counter wraps.
        let wraps = |f: &mut Facts| (f.before.errors, f.after.errors) = (0xff_ffff, 0);
        assert_eq!(verdicts(wraps), [Good, Bad, Good]);
        assert_eq!(verdicts(|f| f.missing = 1), [Good, Good, Bad]);
        assert_eq!(verdicts(|f| f.refused = 1), [Good, Good, Bad]);
        assert_eq!(verdicts(|f| f.wrong = 1), [Good, Good, Bad]);
        assert_eq!(
            verdicts(|f| f.after.speed = LinkSpeed::M100),
            [Note, Good, Good]
        );
        assert_eq!(
            verdicts(|f| f.after.speed = LinkSpeed::Down),
            [Note, Good, Good]
        );
        assert_eq!(verdicts(|f| f.after.full_duplex = false), [Bad, Good, Good]);
    }
}
