//! Watches the STEP and DIR pins: counts pulses, checks their timing, keeps or streams every step.
//!
//! This checks the whole chain, so it looks at the pins only. It knows no positions, no scales and
//! no firmware. The four rules, each in sys clocks:
//!
//! ```text
//! step  ____/‾‾‾‾\________/‾‾‾‾\_______________/‾‾‾‾\__     1 steplen    2 stepspace
//!           |-1--|---2----|    |--3--|----4----|            3 dirhold    4 dirsetup
//! dir   ‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾\________________
//! ```
//!
//! A pulse cut short because the gate closed in that very clock, or in the one before when a pin
//! closed it, is no violation: the gate must win. Nor is one that begins in the clock in which the
//! gate closes: STEP is a register and was decided a clock before. That is what is proven of the
//! core, too (`closed_gate_begins_nothing`).
//!
//! Up/down: both pins carry pulses, each held to rules 1 and 2. Quadrature: every edge of either
//! pin is a step, no two closer than steplen + stepspace, never both at once.

use std::io::{BufWriter, Write};
use std::path::Path;

use wire::map::StepType;

use crate::error::Error;

/// STEP/DIR pairs of the SoC's ports; a board may use fewer.
pub const CHANNELS: usize = wire::regmap::STEPGEN_MAX;

/// First bytes of an edge file ([`Recorder`]).
pub const FILE_MAGIC: [u8; 8] = *b"FCEDGES1";

/// Configured minima of one channel, in sys clocks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Timing {
    /// Shortest active time of STEP.
    pub steplen: u64,
    /// Shortest inactive time of STEP.
    pub stepspace: u64,
    /// From a DIR edge to the next STEP rise.
    pub dirsetup: u64,
    /// From STEP's fall to a DIR edge.
    pub dirhold: u64,
}

impl Default for Timing {
    /// What the gateware does with its registers at zero: one clock high, one clock low.
    fn default() -> Self {
        Timing {
            steplen: 1,
            stepspace: 1,
            dirsetup: 0,
            dirhold: 0,
        }
    }
}

/// Which rule a pulse broke.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Rule {
    /// STEP active for too short.
    Steplen,
    /// STEP inactive for too short.
    Stepspace,
    /// STEP rose too soon after a DIR edge.
    Dirsetup,
    /// DIR moved too soon after STEP's fall, or while STEP was active (`took` is then 0).
    Dirhold,
    /// STEP rose while the gate was closed, and was so in the clock before.
    Gate,
}

/// One broken rule.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Violation {
    /// Sys clock of the edge that broke it.
    pub clock: u64,
    /// Stepgen.
    pub channel: usize,
    /// The rule.
    pub rule: Rule,
    /// Clocks it should have taken.
    pub needed: u64,
    /// Clocks it took.
    pub took: u64,
}

/// One step: STEP became active.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Step {
    /// Sys clock of the rising edge.
    pub clock: u64,
    /// Stepgen.
    pub channel: u8,
    /// DIR said forward.
    pub forward: bool,
    /// Signed pulse count of the channel, this step included.
    pub count: i32,
}

/// The shortest times seen on a channel; `u64::MAX` where none was seen.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shortest {
    /// STEP active.
    pub steplen: u64,
    /// STEP inactive between two pulses.
    pub stepspace: u64,
    /// DIR edge to STEP rise.
    pub dirsetup: u64,
    /// STEP fall to DIR edge.
    pub dirhold: u64,
}

/// What is known of one channel.
#[derive(Clone, Debug)]
pub struct Channel {
    /// Pulses forward minus pulses backward.
    pub count: i64,
    /// Pulses either way.
    pub pulses: u64,
    /// DIR edges.
    pub reversals: u64,
    /// Clock of the last STEP rise.
    pub last_rise: Option<u64>,
    /// Clock of the last STEP fall.
    pub last_fall: Option<u64>,
    /// Clock of the last DIR edge.
    pub last_dir: Option<u64>,
    /// Shortest times seen.
    pub shortest: Shortest,
    /// The rules.
    pub timing: Timing,
    /// What the two pins carry.
    pub kind: StepType,
}

impl Default for Channel {
    fn default() -> Self {
        Channel {
            count: 0,
            pulses: 0,
            reversals: 0,
            last_rise: None,
            last_fall: None,
            last_dir: None,
            shortest: Shortest {
                steplen: u64::MAX,
                stepspace: u64::MAX,
                dirsetup: u64::MAX,
                dirhold: u64::MAX,
            },
            timing: Timing::default(),
            kind: StepType::StepDir,
        }
    }
}

/// Counts, checks and keeps what the STEP/DIR pins do.
#[derive(Debug, Default)]
pub struct EdgeWatch {
    channels: [Channel; CHANNELS],
    step: u16,
    dir: u16,
    gate: bool,
    /// When the gate closed last.
    closed: Option<u64>,
    /// Channels with STEP active low at the pin.
    step_inverted: u16,
    /// Channels with DIR low for backward at the pin.
    dir_inverted: u16,
    violations: Vec<Violation>,
    violation_count: u64,
    kept: Option<Vec<Step>>,
    recorder: Option<Recorder>,
}

impl EdgeWatch {
    /// Violations kept in full; beyond, they are only counted.
    pub const KEPT_VIOLATIONS: usize = 1000;

    /// One channel.
    pub fn channel(&self, n: usize) -> &Channel {
        &self.channels[n]
    }

    /// Signed pulse counts of all channels.
    pub fn counts(&self) -> [i64; CHANNELS] {
        std::array::from_fn(|n| self.channels[n].count)
    }

    /// Pulses of all channels together.
    pub fn pulses(&self) -> u64 {
        self.channels.iter().map(|c| c.pulses).sum()
    }

    /// Check this channel against these minima from now on.
    pub fn set_timing(&mut self, n: usize, timing: Timing) {
        self.channels[n].timing = timing;
    }

    /// What this channel's two pins carry from now on. Set it before the channel moves.
    pub fn set_kind(&mut self, n: usize, kind: StepType) {
        self.channels[n].kind = kind;
    }

    /// Polarity at the pins, one bit per channel, as in the stepgens' mode registers: STEP active
    /// low instead of high, DIR low for backward instead of high. Set it before the channels move.
    pub fn set_polarity(&mut self, step_inverted: u16, dir_inverted: u16) {
        self.step = self.step ^ self.step_inverted ^ step_inverted;
        self.dir = self.dir ^ self.dir_inverted ^ dir_inverted;
        self.step_inverted = step_inverted;
        self.dir_inverted = dir_inverted;
    }

    /// Takes these levels without counting or checking the change.
    pub(crate) fn adopt(&mut self, step: u16, dir: u16) {
        self.step = step ^ self.step_inverted;
        self.dir = dir ^ self.dir_inverted;
    }

    /// The broken rules, the first [`Self::KEPT_VIOLATIONS`] of them.
    pub fn violations(&self) -> &[Violation] {
        &self.violations
    }

    /// How many rules were broken in all.
    pub fn violation_count(&self) -> u64 {
        self.violation_count
    }

    /// Forget the broken rules and shortest times, keep the counts.
    pub fn clear_violations(&mut self) {
        self.violations.clear();
        self.violation_count = 0;
        for channel in &mut self.channels {
            channel.shortest = Channel::default().shortest;
        }
    }

    /// Keep every step in memory from now on (for short runs); see [`Self::take_steps`].
    pub fn keep_steps(&mut self) {
        self.kept.get_or_insert_default();
    }

    /// The steps kept since the last call.
    pub fn take_steps(&mut self) -> Vec<Step> {
        self.kept.as_mut().map(std::mem::take).unwrap_or_default()
    }

    /// Stream every step into a file from now on.
    pub fn record(&mut self, recorder: Recorder) {
        self.recorder = Some(recorder);
    }

    /// Flush and close the stream; the number of steps in it.
    pub fn finish_recording(&mut self) -> Result<u64, Error> {
        match self.recorder.take() {
            Some(recorder) => recorder.finish(),
            None => Ok(0),
        }
    }

    /// The pins changed: this is how they stand after the sys edge `clock`. Returns the channels
    /// that stepped (forward mask, backward mask). Call it for every clock in which STEP, DIR or
    /// the gate changed.
    pub fn change(&mut self, clock: u64, step: u16, dir: u16, gate: bool) -> (u16, u16) {
        let step = step ^ self.step_inverted;
        let dir = dir ^ self.dir_inverted;
        if self.gate && !gate {
            self.closed = Some(clock);
        }
        // The pins' registers follow the gate by a clock when a pin closes it, and at once when its
        // own register does.
        let closed_now = !gate && self.closed.is_some_and(|at| clock <= at + 1);
        let (mut forward, mut backward) = (0, 0);
        let mut moved = (step ^ self.step) | (dir ^ self.dir);
        let (old_step, old_dir) = (self.step, self.dir);
        (self.step, self.dir, self.gate) = (step, dir, gate);
        while moved != 0 {
            let n = moved.trailing_zeros() as usize;
            let bit = 1u16 << n;
            moved &= moved - 1;
            let [a, b] = [step & bit != 0, dir & bit != 0];
            let [old_a, old_b] = [old_step & bit != 0, old_dir & bit != 0];
            let mut stepped = |ahead| {
                if ahead {
                    forward |= bit;
                } else {
                    backward |= bit;
                }
            };
            match self.channels[n].kind {
                StepType::StepDir => {
                    if b != old_b {
                        self.dir_edge(clock, n, a && old_a, closed_now);
                    }
                    if a && !old_a {
                        stepped(!b);
                        self.rise(clock, n, !b);
                    } else if !a && old_a {
                        self.fall(clock, n, closed_now);
                    }
                }
                StepType::UpDown => {
                    for (now, old, ahead) in [(a, old_a, true), (b, old_b, false)] {
                        if now && !old {
                            stepped(ahead);
                            self.rise(clock, n, ahead);
                        } else if !now && old {
                            self.fall(clock, n, closed_now);
                        }
                    }
                }
                StepType::Quadrature => {
                    if a != old_a && b != old_b {
                        self.judge(clock, n, Rule::Dirhold, 1, Some(0));
                        continue;
                    }
                    // After one edge, A and the old B differ: A leads, forwards.
                    let ahead = a != old_b;
                    stepped(ahead);
                    self.quadrature(clock, n, ahead);
                }
            }
        }
        (forward, backward)
    }

    fn rise(&mut self, clock: u64, n: usize, forward: bool) {
        let channel = &mut self.channels[n];
        channel.count += if forward { 1 } else { -1 };
        channel.pulses += 1;
        channel.last_rise = Some(clock);
        let timing = channel.timing;
        let space = channel.last_fall.map(|t| clock - t);
        let setup = channel.last_dir.map(|t| clock - t);
        if let Some(took) = space {
            channel.shortest.stepspace = channel.shortest.stepspace.min(took);
        }
        if let Some(took) = setup {
            channel.shortest.dirsetup = channel.shortest.dirsetup.min(took);
        }
        let step = Step {
            clock,
            channel: n as u8,
            forward,
            count: channel.count as i32,
        };
        if let Some(kept) = &mut self.kept {
            kept.push(step);
        }
        if let Some(recorder) = &mut self.recorder {
            recorder.put(step);
        }
        self.judge(clock, n, Rule::Stepspace, timing.stepspace.max(1), space);
        self.judge(clock, n, Rule::Dirsetup, timing.dirsetup, setup);
        if !self.gate && self.closed != Some(clock) {
            self.judge(clock, n, Rule::Gate, 1, Some(0));
        }
    }

    fn quadrature(&mut self, clock: u64, n: usize, forward: bool) {
        let channel = &mut self.channels[n];
        let timing = channel.timing;
        let took = channel.last_rise.map(|t| clock - t);
        // The levels have no meaning here; only the time since the last edge is checked.
        channel.last_fall = None;
        self.rise(clock, n, forward);
        let needed = timing.steplen.max(1) + timing.stepspace.max(1);
        self.judge(clock, n, Rule::Stepspace, needed, took);
    }

    fn fall(&mut self, clock: u64, n: usize, closed_now: bool) {
        let channel = &mut self.channels[n];
        channel.last_fall = Some(clock);
        if closed_now {
            return;
        }
        let high = channel.last_rise.map(|t| clock - t);
        if let Some(took) = high {
            channel.shortest.steplen = channel.shortest.steplen.min(took);
        }
        let needed = channel.timing.steplen.max(1);
        self.judge(clock, n, Rule::Steplen, needed, high);
    }

    fn dir_edge(&mut self, clock: u64, n: usize, step_active: bool, closed_now: bool) {
        let channel = &mut self.channels[n];
        channel.last_dir = Some(clock);
        channel.reversals += 1;
        if closed_now {
            return;
        }
        let held = if step_active {
            Some(0)
        } else {
            channel.last_fall.map(|t| clock - t)
        };
        if let Some(took) = held {
            channel.shortest.dirhold = channel.shortest.dirhold.min(took);
        }
        // DIR must never move under an active STEP, even with a dirhold of 0.
        let needed = channel.timing.dirhold.max(u64::from(step_active));
        self.judge(clock, n, Rule::Dirhold, needed, held);
    }

    fn judge(&mut self, clock: u64, channel: usize, rule: Rule, needed: u64, took: Option<u64>) {
        let Some(took) = took.filter(|took| *took < needed) else {
            return;
        };
        self.violation_count += 1;
        if self.violations.len() < Self::KEPT_VIOLATIONS {
            self.violations.push(Violation {
                clock,
                channel,
                rule,
                needed,
                took,
            });
        }
    }
}

/// Streams steps into a file of 16-byte records, little-endian, after a 16-byte header:
///
/// ```text
/// header   "FCEDGES1", sys_clk_hz u64
/// record   clock u64, count i32 (signed, this step included), channel u8, forward u8, 0 u16
/// ```
///
/// numpy: `np.fromfile(f,
/// [('clock','<u8'),('count','<i4'),('channel','u1'),('forward','u1'),('zero','<u2')], offset=16)`.
pub struct Recorder {
    out: BufWriter<Box<dyn Write + Send>>,
    name: std::path::PathBuf,
    steps: u64,
    failed: Option<std::io::Error>,
}

impl std::fmt::Debug for Recorder {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Recorder")
            .field("name", &self.name)
            .field("steps", &self.steps)
            .finish_non_exhaustive()
    }
}

impl Recorder {
    /// Record into a new file.
    pub fn create(path: &Path, sys_clk_hz: u64) -> Result<Self, Error> {
        let file = std::fs::File::create(path).map_err(|source| Error::Write {
            path: path.into(),
            source,
        })?;
        Ok(Self::new(Box::new(file), path, sys_clk_hz))
    }

    fn new(out: Box<dyn Write + Send>, name: &Path, sys_clk_hz: u64) -> Self {
        let mut recorder = Recorder {
            out: BufWriter::with_capacity(1 << 16, out),
            name: name.into(),
            steps: 0,
            failed: None,
        };
        let mut header = [0; 16];
        header[..8].copy_from_slice(&FILE_MAGIC);
        header[8..].copy_from_slice(&sys_clk_hz.to_le_bytes());
        recorder.write(&header);
        recorder
    }

    fn put(&mut self, step: Step) {
        let mut record = [0; 16];
        record[..8].copy_from_slice(&step.clock.to_le_bytes());
        record[8..12].copy_from_slice(&step.count.to_le_bytes());
        record[12] = step.channel;
        record[13] = u8::from(step.forward);
        self.steps += 1;
        self.write(&record);
    }

    /// A write error is reported once, at the end.
    fn write(&mut self, bytes: &[u8]) {
        if self.failed.is_none() {
            self.failed = self.out.write_all(bytes).err();
        }
    }

    fn finish(mut self) -> Result<u64, Error> {
        let result = match self.failed.take() {
            Some(e) => Err(e),
            None => self.out.flush(),
        };
        result.map(|()| self.steps).map_err(|source| Error::Write {
            path: self.name.clone(),
            source,
        })
    }
}

/// Read an edge file back: the clock frequency and the steps. Trailing bytes of a torn record are
/// ignored.
pub fn read_file(bytes: &[u8]) -> Option<(u64, Vec<Step>)> {
    let (header, records) = bytes.split_at_checked(16)?;
    let hz = u64::from_le_bytes(header[8..].try_into().ok()?);
    let steps = records
        .chunks_exact(16)
        .map(|r| Step {
            clock: u64::from_le_bytes(std::array::from_fn(|i| r[i])),
            count: i32::from_le_bytes(std::array::from_fn(|i| r[8 + i])),
            channel: r[12],
            forward: r[13] != 0,
        })
        .collect();
    header.starts_with(&FILE_MAGIC).then_some((hz, steps))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn watch(timing: Timing) -> EdgeWatch {
        let mut w = EdgeWatch::default();
        w.set_timing(0, timing);
        w.change(0, 0, 0, true);
        w
    }

    const T: Timing = Timing {
        steplen: 5,
        stepspace: 7,
        dirsetup: 11,
        dirhold: 13,
    };

    #[test]
    fn exact_timing_is_no_violation() {
        let mut w = watch(T);
        w.change(100, 0, 1, true);
        assert_eq!(w.change(111, 1, 1, true), (0, 1));
        w.change(116, 0, 1, true);
        w.change(123, 1, 1, true);
        w.change(128, 0, 1, true);
        w.change(141, 0, 0, true);
        assert_eq!(w.change(152, 1, 0, true), (1, 0));
        assert_eq!(w.violations(), []);
        assert_eq!(
            (
                w.channel(0).count,
                w.channel(0).pulses,
                w.channel(0).reversals
            ),
            (-1, 3, 2)
        );
        assert_eq!(
            w.channel(0).shortest,
            Shortest {
                steplen: 5,
                stepspace: 7,
                dirsetup: 11,
                dirhold: 13
            }
        );
    }

    #[test]
    fn one_clock_less_is_one_violation_each() {
        let mut w = watch(T);
        w.change(100, 0, 1, true);
        w.change(110, 1, 1, true);
        w.change(114, 0, 1, true);
        w.change(120, 1, 1, true);
        w.change(125, 0, 1, true);
        w.change(137, 0, 0, true);
        let rules: Vec<_> = w
            .violations()
            .iter()
            .map(|v| (v.rule, v.needed, v.took))
            .collect();
        assert_eq!(
            rules,
            [
                (Rule::Dirsetup, 11, 10),
                (Rule::Steplen, 5, 4),
                (Rule::Stepspace, 7, 6),
                (Rule::Dirhold, 13, 12)
            ]
        );
        assert_eq!(w.violation_count(), 4);
    }

    #[test]
    fn dir_under_an_active_step_is_always_wrong() {
        let mut w = watch(Timing::default());
        w.change(10, 1, 0, true);
        w.change(11, 1, 1, true);
        assert_eq!(w.violations()[0].rule, Rule::Dirhold);
    }

    #[test]
    fn dir_may_move_as_step_falls_without_dirhold() {
        let mut w = watch(Timing::default());
        w.change(10, 1, 0, true);
        w.change(11, 0, 1, true);
        assert_eq!(w.violations(), []);
    }

    #[test]
    fn the_gate_may_cut_a_pulse_but_not_start_one() {
        let mut w = watch(T);
        w.change(100, 1, 0, true);
        w.change(101, 0, 0, false);
        assert_eq!(w.violations(), []);
        w.change(200, 1, 0, false);
        assert_eq!(w.violations()[0].rule, Rule::Gate);
        // The reset pin closes the gate at once, the pin's register follows in the next clock and
        // no later.
        for (falls, broken) in [(301, 0), (302, 1)] {
            let mut w = watch(T);
            w.change(298, 1, 0, true);
            w.change(300, 1, 0, false);
            w.change(falls, 0, 0, false);
            assert_eq!(w.violation_count(), broken, "STEP falls at {falls}");
        }
    }

    #[test]
    fn a_pulse_may_begin_in_the_clock_in_which_the_gate_closes_and_in_none_behind_it() {
        for (rises, broken) in [(300, 0), (301, 1), (302, 1)] {
            let mut w = watch(T);
            w.change(200, 0, 0, true);
            if rises > 300 {
                w.change(300, 0, 0, false);
            }
            w.change(rises, 1, 0, false);
            w.change(rises + 1, 0, 0, false);
            let gate = w.violations().iter().filter(|v| v.rule == Rule::Gate);
            assert_eq!(gate.count(), broken, "STEP rises at {rises}");
        }
    }

    #[test]
    fn inverted_pins_count_alike() {
        let mut w = EdgeWatch::default();
        w.set_polarity(2, 2);
        w.change(0, 2, 2, true);
        assert_eq!(w.change(10, 0, 2, true), (2, 0));
        w.change(20, 2, 0, true);
        assert_eq!(w.change(30, 0, 0, true), (0, 2));
        assert_eq!((w.channel(1).count, w.channel(1).pulses), (0, 2));
    }

    #[test]
    fn up_and_down_pulses_count_on_their_own_pins() {
        let mut w = watch(T);
        w.set_kind(0, StepType::UpDown);
        assert_eq!(w.change(100, 1, 0, true), (1, 0));
        w.change(105, 0, 0, true);
        assert_eq!(w.change(112, 0, 1, true), (0, 1));
        w.change(117, 0, 0, true);
        assert_eq!(w.change(124, 0, 1, true), (0, 1));
        assert_eq!((w.channel(0).count, w.channel(0).pulses), (-1, 3));
        assert_eq!(w.violations(), []);
    }

    #[test]
    fn every_quadrature_edge_is_a_step() {
        let mut w = watch(T);
        w.set_kind(0, StepType::Quadrature);
        let walk = [(1, 0), (1, 1), (0, 1), (0, 0), (1, 0), (0, 0), (0, 1)];
        for (i, (a, b)) in walk.into_iter().enumerate() {
            w.change(100 + 12 * i as u64, a, b, true);
        }
        assert_eq!(
            (w.channel(0).count, w.channel(0).pulses),
            (3, walk.len() as u64)
        );
        assert_eq!(w.violations(), []);
        w.change(195 - 12, 1, 1, true);
        w.change(195, 0, 0, true);
        assert_eq!(w.violation_count(), 2, "too soon, and both at once");
    }

    #[test]
    fn all_channels_step_in_one_clock() {
        let mut w = EdgeWatch::default();
        w.change(0, 0, 0xff00, true);
        assert_eq!(w.change(50, 0xffff, 0xff00, true), (0x00ff, 0xff00));
        assert_eq!(w.pulses(), 16);
        assert_eq!(w.counts()[15], -1);
    }

    #[test]
    fn a_file_tells_the_same_steps() {
        #[derive(Clone, Default)]
        struct Shared(std::sync::Arc<std::sync::Mutex<Vec<u8>>>);
        impl Write for Shared {
            fn write(&mut self, b: &[u8]) -> std::io::Result<usize> {
                self.0.lock().unwrap().write(b)
            }
            fn flush(&mut self) -> std::io::Result<()> {
                Ok(())
            }
        }
        let shared = Shared::default();
        let mut w = watch(Timing::default());
        w.keep_steps();
        w.record(Recorder::new(
            Box::new(shared.clone()),
            Path::new("memory"),
            60_000_000,
        ));
        for i in 0..100 {
            w.change(10 * i + 1, 3, 2, true);
            w.change(10 * i + 5, 0, 2, true);
        }
        assert_eq!(w.finish_recording().unwrap(), 200);
        let (hz, steps) = read_file(&shared.0.lock().unwrap()).unwrap();
        assert_eq!(hz, 60_000_000);
        assert_eq!(steps, w.take_steps());
        assert_eq!(
            steps[199],
            Step {
                clock: 991,
                channel: 1,
                forward: false,
                count: -100
            }
        );
        assert!(read_file(b"short").is_none());
    }
}
