//! Fault injection between host and board: which faults, when, how often, and from which seed.
//!
//! A [`Plan`] is parsed from text; a [`Script`] is a running plan, in sys clocks of the board; a
//! [`OneWay`] is one direction of the cable with the delayed frames on it. Time is simulated and
//! random numbers come from a seed: the same plan and the same frames give the same faults on every
//! machine.
//!
//! ```text
//!            Script::judge                        OneWay::due
//!   frame -->  lost? spoilt? twice? how late?  -->  |  |   |  -->  board or host
//!            Script::due: link down, CPU frozen, board restarted
//! ```
//!
//! It knows no Ethernet and no UDP. The type of the frames gives their length and the effect of
//! damage ([`Cargo`]).

use std::collections::{BTreeMap, VecDeque};
use std::time::Duration;

use rand::Rng;
use rand_pcg::Pcg32;

mod text;

pub use text::{Rejected, WORDS};

/// A switch that slows frames down buffers this much of them and drops the rest. 50 ms, a small
/// switch's buffer at 10 Mbit/s.
const BACKLOG: Duration = Duration::from_millis(50);
/// A frame that waits to be overtaken goes after this long even if none comes. Ten servo periods.
const OVERTAKE: Duration = Duration::from_millis(10);

/// A direction of the cable.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Direction {
    /// From the host.
    ToBoard,
    /// To the host.
    FromBoard,
}

/// Something that goes wrong.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Kind {
    /// A frame is lost with this probability.
    Loss(f64),
    /// So many frames are lost, from now on.
    Drop(u32),
    /// A frame comes twice with this probability.
    Duplicate(f64),
    /// A frame is overtaken by the next one with this probability.
    Reorder(f64),
    /// A frame comes this much later, evenly spread.
    Delay(Duration, Duration),
    /// A bit of a frame is turned over on the wire with this probability; its checksum no longer
    /// fits.
    Corrupt(f64),
    /// A datagram loses its end with this probability; its checksums fit what is left.
    Truncate(f64),
    /// The cable takes so many bits a second.
    Rate(u64),
    /// The cable is out, and the PHY says so.
    Pull,
    /// The host is paused: it neither sends nor receives; afterwards everything arrives at once.
    HostPause,
    /// The CPU's clock stands still.
    Freeze,
    /// The board restarts, memory of its last start kept.
    Reboot,
    /// The board's supply fails and comes back: nothing is kept but its flash.
    Power,
}

/// One rule of a plan.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rule {
    /// What.
    pub kind: Kind,
    /// Which way; `None` is both.
    pub direction: Option<Direction>,
    /// Since the plan was given: from when and, unless it stays, until when.
    pub window: Option<(Duration, Option<Duration>)>,
}

/// What is to go wrong.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Plan {
    /// The seed; `None` keeps the present random state.
    pub seed: Option<u64>,
    /// Earlier trouble ends first: everything, or the cable being out.
    pub ends: Option<Ends>,
    /// The rules. Of those without a window the last of its kind and direction holds.
    pub rules: Vec<Rule>,
}

/// The earlier faults that a plan ends first.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ends {
    /// All trouble.
    Everything,
    /// The cable is in again.
    Pull,
}

/// What a fault does to the board itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Act {
    /// What the PHY says of its link.
    Link(bool),
    /// The CPU's clock stands (`true`) or goes.
    Freeze(bool),
    /// A restart; `true` after the supply had failed.
    Reboot(bool),
}

/// What has gone wrong so far, in frames.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct FaultCounts {
    /// Offered, towards the board and from it.
    pub offered: [u64; 2],
    /// Lost, for any reason.
    pub lost: u64,
    /// Sent twice.
    pub duplicated: u64,
    /// Overtaken.
    pub reordered: u64,
    /// Made late.
    pub delayed: u64,
    /// Damaged on the wire.
    pub corrupted: u64,
    /// Cut short.
    pub truncated: u64,
}

/// A rule under way: its window in sys clocks.
#[derive(Clone, Copy, Debug)]
struct Active {
    rule: Rule,
    from: u64,
    until: u64,
}

impl Active {
    fn at(&self, now: u64) -> bool {
        (self.from..self.until).contains(&now)
    }

    fn for_frames(&self, direction: Direction, now: u64) -> bool {
        self.at(now) && self.rule.direction.is_none_or(|d| d == direction)
    }
}

/// What becomes of a frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Verdict {
    lost: bool,
    twice: bool,
    overtaken: bool,
    corrupt: bool,
    /// Sys clock at which it arrives.
    due: u64,
}

/// A plan under way.
#[derive(Debug)]
pub struct Script {
    hz: u64,
    rules: Vec<Active>,
    dice: [Pcg32; 2],
    /// Rate limit: when the cable is free again, for each direction.
    free_at: [u64; 2],
    acts: VecDeque<(u64, Act)>,
    link: bool,
    frozen: bool,
    /// What has gone wrong.
    pub counts: FaultCounts,
}

impl Script {
    /// No faults, on a board with a sys clock of `hz`.
    pub fn new(hz: u64) -> Self {
        Script {
            hz,
            rules: Vec::new(),
            dice: Self::dice(0),
            free_at: [0; 2],
            acts: VecDeque::new(),
            link: true,
            frozen: false,
            counts: FaultCounts::default(),
        }
    }

    fn dice(seed: u64) -> [Pcg32; 2] {
        // One for each direction, so that the faults of one direction do not change the random
        // numbers of the other.
        [Pcg32::new(seed, 1), Pcg32::new(seed, 2)]
    }

    fn clocks(&self, time: Duration) -> u64 {
        (time.as_nanos() * u128::from(self.hz) / 1_000_000_000) as u64
    }

    /// From the sys clock `now` on.
    pub fn follow(&mut self, plan: &Plan, now: u64) {
        if let Some(seed) = plan.seed {
            self.dice = Self::dice(seed);
        }
        match plan.ends {
            Some(Ends::Everything) => self.rules.clear(),
            Some(Ends::Pull) => self.rules.retain(|a| a.rule.kind != Kind::Pull),
            None => {}
        }
        for rule in &plan.rules {
            if rule.window.is_none() {
                self.rules.retain(|a| {
                    a.rule.window.is_some()
                        || std::mem::discriminant(&a.rule.kind)
                            != std::mem::discriminant(&rule.kind)
                        || (rule.direction.is_some() && a.rule.direction != rule.direction)
                });
            }
            let (from, until) = rule.window.unwrap_or((Duration::ZERO, None));
            let active = Active {
                rule: *rule,
                from: now + self.clocks(from),
                until: until.map_or(u64::MAX, |until| now + self.clocks(until)),
            };
            match rule.kind {
                Kind::Reboot => self.acts.push_back((active.from, Act::Reboot(false))),
                Kind::Power => self.acts.push_back((active.from, Act::Reboot(true))),
                _ => self.rules.push(active),
            }
        }
        self.acts.make_contiguous().sort_by_key(|(at, _)| *at);
    }

    /// Lose so many of the next frames in this direction, as `drop=N` does.
    pub fn drop_next(&mut self, direction: Direction, frames: u32) {
        self.once(direction, Kind::Drop(frames));
    }

    /// From now on this, in this direction.
    pub fn once(&mut self, direction: Direction, kind: Kind) {
        let rule = Rule {
            kind,
            direction: Some(direction),
            window: None,
        };
        let plan = Plan {
            rules: vec![rule],
            ..Plan::default()
        };
        self.follow(&plan, 0);
    }

    /// The cable is in.
    pub fn link(&self) -> bool {
        self.link
    }

    /// Nothing is going wrong and nothing will.
    pub fn quiet(&self) -> bool {
        self.rules.is_empty() && self.acts.is_empty() && self.link && !self.frozen
    }

    /// The next sys clock after `now` at which [`Self::due`] may have something to say.
    pub fn next(&self, now: u64) -> u64 {
        if self.quiet() {
            return u64::MAX;
        }
        let windows = self.rules.iter().flat_map(|a| [a.from, a.until]);
        windows
            .chain(self.acts.iter().map(|(at, _)| *at))
            .filter(|at| *at > now)
            .min()
            .unwrap_or(u64::MAX)
    }

    /// What happens to the board at or before the sys clock `now` and has not been said yet.
    pub fn due(&mut self, now: u64) -> Option<Act> {
        if self.quiet() {
            return None;
        }
        let any = |kind| self.rules.iter().any(|a| a.rule.kind == kind && a.at(now));
        let (link, frozen) = (!any(Kind::Pull), any(Kind::Freeze));
        self.rules.retain(|a| a.until > now);
        if link != self.link {
            self.link = link;
            return Some(Act::Link(link));
        }
        if frozen != self.frozen {
            self.frozen = frozen;
            return Some(Act::Freeze(frozen));
        }
        let act = self.acts.front().filter(|(at, _)| *at <= now)?.1;
        self.acts.pop_front();
        Some(act)
    }

    /// What becomes of a frame of so many bytes that enters the cable at `now`.
    fn judge(&mut self, direction: Direction, now: u64, bytes: usize) -> Verdict {
        self.counts.offered[direction as usize] += 1;
        let mut verdict = Verdict {
            due: now,
            ..Verdict::default()
        };
        if self.rules.is_empty() {
            return verdict;
        }
        let (hz, backlog) = (self.hz, self.clocks(BACKLOG));
        let clocks = |time: Duration| (time.as_nanos() * u128::from(hz) / 1_000_000_000) as u64;
        let dice = &mut self.dice[direction as usize];
        // Random numbers are drawn in the order below, not in the order of the plan. So another
        // word in a plan does not change the numbers of the others, as long as it does not lose
        // frames.
        let mut delay = 0;
        let mut resume = now;
        for active in &mut self.rules {
            if !active.for_frames(direction, now) {
                continue;
            }
            match &mut active.rule.kind {
                Kind::Pull => verdict.lost = true,
                Kind::Drop(0) => {}
                Kind::Drop(n) => {
                    *n -= 1;
                    verdict.lost = true;
                }
                Kind::Loss(p) => verdict.lost |= dice.random_bool(*p),
                Kind::Duplicate(p) => verdict.twice |= dice.random_bool(*p),
                Kind::Reorder(p) => verdict.overtaken |= dice.random_bool(*p),
                Kind::Corrupt(p) => verdict.corrupt |= dice.random_bool(*p),
                Kind::Delay(from, to) => {
                    delay += dice.random_range(clocks(*from)..=clocks(*to));
                }
                Kind::Rate(bits) => {
                    let free = &mut self.free_at[direction as usize];
                    let start = now.max(*free);
                    if start - now > backlog {
                        verdict.lost = true;
                    } else {
                        *free = start + (bytes as u64 * 8 * hz).div_ceil(*bits);
                        delay += *free - now;
                    }
                }
                Kind::HostPause => resume = resume.max(active.until),
                Kind::Truncate(_) | Kind::Freeze | Kind::Reboot | Kind::Power => {}
            }
        }
        self.rules.retain(|a| a.rule.kind != Kind::Drop(0));
        verdict.due = resume.max(now + delay);
        let counts = &mut self.counts;
        if verdict.lost {
            counts.lost += 1;
            return verdict;
        }
        counts.duplicated += u64::from(verdict.twice);
        counts.reordered += u64::from(verdict.overtaken);
        counts.delayed += u64::from(verdict.due > now);
        counts.corrupted += u64::from(verdict.corrupt);
        verdict
    }

    /// A datagram on its way; its end may be cut off. Used where datagrams are made or taken,
    /// before or after their checksums.
    pub fn cut(&mut self, direction: Direction, now: u64, payload: &mut Vec<u8>) {
        let dice = &mut self.dice[direction as usize];
        for active in &self.rules {
            if let Kind::Truncate(p) = active.rule.kind
                && active.for_frames(direction, now)
                && !payload.is_empty()
                && dice.random_bool(p)
            {
                payload.truncate(dice.random_range(0..payload.len()));
                self.counts.truncated += 1;
            }
        }
    }

    /// Present and past faults, as text.
    pub fn told(&self, now: u64) -> String {
        let rules = self.rules.iter().map(|active| {
            let state = if active.at(now) { "" } else { "later:" };
            format!("{state}{}", active.rule)
        });
        let acts = self
            .acts
            .iter()
            .map(|(at, act)| format!("later:{act:?}@clock{at}"));
        let rules: Vec<String> = rules.chain(acts).collect();
        let rules = if rules.is_empty() {
            "none".into()
        } else {
            rules.join(" ")
        };
        let t = &self.counts;
        format!(
            "faults={rules} offered={}/{} lost={} duplicated={} reordered={} delayed={} corrupted={} truncated={}",
            t.offered[0],
            t.offered[1],
            t.lost,
            t.duplicated,
            t.reordered,
            t.delayed,
            t.corrupted,
            t.truncated
        )
    }
}

/// Anything that a cable can carry.
pub trait Cargo: Clone {
    /// Bytes on the wire, preamble and checksum included.
    fn wire_bytes(&self) -> usize;
    /// Inverts this bit, modulo the number of bits. False if every receiver would drop the result:
    /// then the frame is lost.
    #[must_use]
    fn damage(&mut self, bit: u64) -> bool;
}

/// One direction of the cable, and what is late on it.
#[derive(Debug)]
pub struct OneWay<T> {
    direction: Direction,
    late: BTreeMap<(u64, u64), T>,
    /// Waits to be overtaken.
    held: Option<(u64, T)>,
    order: u64,
    spoilt: u32,
}

impl<T: Cargo> OneWay<T> {
    /// A cable with nothing on it.
    pub fn new(direction: Direction) -> Self {
        OneWay {
            direction,
            late: BTreeMap::new(),
            held: None,
            order: 0,
            spoilt: 0,
        }
    }

    /// Frames so far that came damaged and were thrown away for it.
    pub fn spoilt(&self) -> u32 {
        self.spoilt
    }

    fn put(&mut self, due: u64, item: T) {
        self.late.insert((due, self.order), item);
        self.order += 1;
    }

    /// A frame enters at the sys clock `now`. The part that arrives is there for [`Self::due`], at
    /// once if no fault delays it.
    pub fn enter(&mut self, script: &mut Script, now: u64, mut item: T) {
        let verdict = script.judge(self.direction, now, item.wire_bytes());
        if verdict.lost {
            return;
        }
        if verdict.corrupt {
            let bit = script.dice[self.direction as usize].random();
            if !item.damage(bit) {
                script.counts.lost += 1;
                self.spoilt += 1;
                return;
            }
        }
        if verdict.overtaken && self.held.is_none() {
            self.held = Some((verdict.due + script.clocks(OVERTAKE), item));
            return;
        }
        if verdict.twice {
            self.put(verdict.due, item.clone());
        }
        self.put(verdict.due, item);
        if let Some((_, held)) = self.held.take() {
            self.put(verdict.due, held);
        }
    }

    /// The next frame that has arrived by the sys clock `now`.
    pub fn due(&mut self, now: u64) -> Option<T> {
        if let Some((_, held)) = self.held.take_if(|(until, _)| *until <= now) {
            self.put(now, held);
        }
        let first = self.late.first_entry()?;
        (first.key().0 <= now).then(|| first.remove())
    }

    /// The sys clock at which the next one arrives.
    pub fn next(&self) -> u64 {
        let late = self.late.first_key_value().map(|((due, _), _)| *due);
        let held = self.held.as_ref().map(|(until, _)| *until);
        late.into_iter().chain(held).min().unwrap_or(u64::MAX)
    }

    /// Removes everything from the cable: its board is gone.
    pub fn clear(&mut self) {
        self.late.clear();
        self.held = None;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const HZ: u64 = 60_000_000;
    const MS: u64 = HZ / 1000;

    #[derive(Clone, Debug, PartialEq, Eq)]
    struct Letter(u32);

    impl Cargo for Letter {
        fn wire_bytes(&self) -> usize {
            125
        }
        fn damage(&mut self, bit: u64) -> bool {
            self.0 ^= 0x8000_0000 >> (bit % 8);
            true
        }
    }

    struct Cable {
        script: Script,
        line: OneWay<Letter>,
        heard: Vec<(u64, u32)>,
    }

    impl Cable {
        fn with(plan: &str) -> Self {
            let mut script = Script::new(HZ);
            script.follow(&plan.parse().expect("a plan"), 0);
            Cable {
                script,
                line: OneWay::new(Direction::ToBoard),
                heard: Vec::new(),
            }
        }

        /// One letter a millisecond, from 0; what is late is waited for.
        fn send(mut self, letters: u32) -> Vec<(u64, u32)> {
            for n in 0..letters + 1000 {
                let now = u64::from(n) * MS;
                while self.line.next() <= now {
                    let at = self.line.next();
                    let letter = self.line.due(at).expect("what is due is there");
                    self.heard.push((at, letter.0));
                }
                if n < letters {
                    self.line.enter(&mut self.script, now, Letter(n));
                }
                while let Some(letter) = self.line.due(now) {
                    self.heard.push((now, letter.0));
                }
            }
            self.heard
        }
    }

    fn numbers(heard: &[(u64, u32)]) -> Vec<u32> {
        heard.iter().map(|(_, n)| *n).collect()
    }

    #[test]
    fn without_a_plan_everything_arrives_at_once_and_in_order() {
        let heard = Cable::with("").send(100);
        assert!(heard.iter().all(|(at, n)| *at == u64::from(*n) * MS));
        assert_eq!(numbers(&heard), (0..100).collect::<Vec<_>>());
    }

    #[test]
    fn loss_is_as_frequent_as_asked_and_the_same_for_the_same_seed() {
        let run = |plan: &str| numbers(&Cable::with(plan).send(100_000));
        let (a, b, c) = (
            run("loss=1% seed=7"),
            run("loss=0.01 seed=7"),
            run("loss=1% seed=8"),
        );
        assert_eq!(a, b);
        assert_ne!(a, c);
        let lost = 100_000 - a.len();
        // Mean 1000, standard deviation 31.
        assert!(
            (850..1150).contains(&lost),
            "{lost} of 100 000 lost, seed 7"
        );
    }

    #[test]
    fn a_word_for_one_direction_leaves_the_other_alone() {
        assert_eq!(Cable::with("from-board:loss=1").send(10).len(), 10);
        assert_eq!(Cable::with("to-board:loss=1").send(10).len(), 0);
    }

    #[test]
    fn a_cable_is_out_from_when_until_when_it_says() {
        let mut cable = Cable::with("pull@10ms..20ms");
        let script = &mut cable.script;
        assert_eq!((script.next(0), script.due(0)), (10 * MS, None));
        assert_eq!(script.due(10 * MS), Some(Act::Link(false)));
        assert_eq!((script.due(10 * MS), script.next(10 * MS)), (None, 20 * MS));
        assert_eq!(script.due(20 * MS), Some(Act::Link(true)));
        assert!(script.quiet());
        let heard = numbers(&Cable::with("pull@10ms..20ms").send(30));
        assert_eq!(heard, (0..10).chain(20..30).collect::<Vec<_>>());
    }

    #[test]
    fn plug_ends_a_pull_and_off_ends_everything() {
        let mut script = Script::new(HZ);
        script.follow(&"pull loss=0.5".parse().unwrap(), 0);
        assert_eq!(script.due(0), Some(Act::Link(false)));
        script.follow(&"plug".parse().unwrap(), 5);
        assert_eq!(script.due(5), Some(Act::Link(true)));
        assert!(!script.quiet());
        script.follow(&"off".parse().unwrap(), 6);
        assert!(script.quiet());
    }

    #[test]
    fn a_paused_host_gets_everything_at_once_when_it_is_back() {
        let heard = Cable::with("host-pause@3ms..8ms").send(10);
        assert_eq!(numbers(&heard), (0..10).collect::<Vec<_>>());
        let at: Vec<u64> = heard.iter().map(|(at, _)| at / MS).collect();
        assert_eq!(at, [0, 1, 2, 8, 8, 8, 8, 8, 8, 9]);
    }

    #[test]
    fn an_overtaken_frame_comes_behind_the_next_one_and_is_not_lost() {
        let heard = numbers(&Cable::with("reorder=0.2 seed=3").send(1000));
        let mut sorted = heard.clone();
        sorted.sort_unstable();
        assert_eq!(sorted, (0..1000).collect::<Vec<_>>());
        assert!(heard.windows(2).filter(|w| w[0] > w[1]).count() > 100);
        // By one place only.
        assert!(
            heard
                .iter()
                .enumerate()
                .all(|(n, at)| n.abs_diff(*at as usize) <= 1)
        );
    }

    #[test]
    fn a_late_frame_is_as_late_as_asked() {
        let heard = Cable::with("delay=1ms..3ms seed=5").send(1000);
        assert_eq!(heard.len(), 1000);
        let late = |(at, n): &(u64, u32)| at - u64::from(*n) * MS;
        assert!(heard.iter().all(|h| (MS..=3 * MS).contains(&late(h))));
        assert!(
            heard.iter().any(|h| late(h) < 3 * MS / 2)
                && heard.iter().any(|h| late(h) > 5 * MS / 2)
        );
    }

    #[test]
    fn duplicates_and_damage_are_counted() {
        let mut cable = Cable::with("dup=1");
        cable.line.enter(&mut cable.script, 0, Letter(1));
        assert_eq!(
            (cable.line.due(0), cable.line.due(0)),
            (Some(Letter(1)), Some(Letter(1)))
        );
        assert_eq!(cable.script.counts.duplicated, 1);
        let mut cable = Cable::with("corrupt=1");
        cable.line.enter(&mut cable.script, 0, Letter(1));
        assert_ne!(cable.line.due(0), Some(Letter(1)));
        assert_eq!(cable.script.counts.corrupted, 1);
    }

    #[test]
    fn a_slow_cable_spaces_frames_and_drops_what_it_cannot_keep() {
        // 125 bytes at 1 Mbit/s are a millisecond: what comes every millisecond just fits.
        let heard = Cable::with("rate=1Mbit").send(100);
        assert!(heard.iter().all(|(at, n)| *at == (u64::from(*n) + 1) * MS));
        let heard = Cable::with("rate=500kbit").send(1000);
        assert!((500..560).contains(&heard.len()), "{}", heard.len());
    }

    #[test]
    fn drop_counts_frames() {
        assert_eq!(numbers(&Cable::with("drop=3").send(6)), [3, 4, 5]);
    }

    #[test]
    fn a_cut_datagram_is_shorter_by_at_least_a_byte() {
        let mut script = Script::new(HZ);
        script.follow(&"truncate=1 seed=1".parse().unwrap(), 0);
        for _ in 0..100 {
            let mut payload = vec![0; 40];
            script.cut(Direction::ToBoard, 0, &mut payload);
            assert!(payload.len() < 40);
        }
        assert_eq!(script.counts.truncated, 100);
    }

    #[test]
    fn starts_and_freezes_come_when_they_are_due() {
        let mut script = Script::new(HZ);
        script.follow(
            &"reboot@2ms freeze@1ms..3ms power@4ms".parse().unwrap(),
            10 * MS,
        );
        let mut acts = Vec::new();
        let mut now = 10 * MS;
        loop {
            while let Some(act) = script.due(now) {
                acts.push((now / MS, act));
            }
            now = script.next(now);
            if now == u64::MAX {
                break;
            }
        }
        assert_eq!(
            acts,
            [
                (11, Act::Freeze(true)),
                (12, Act::Reboot(false)),
                (13, Act::Freeze(false)),
                (14, Act::Reboot(true))
            ]
        );
    }
}
