//! Outputs and jumpers: compares the driven levels with the received ones, and names the likely
//! defect.
//!
//! The gateware reads back the register in front of each general output, and the level at each pad
//! that it drives. A pad is the FPGA's own: the buffer behind it, its supply, the connector and the
//! wire are seen only by a jumper to an input.

use super::Finding;
use crate::client::Identity;
use wire::board::Kind;

/// Where a jumper begins.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Source {
    /// The first pin of a step generator; its second pin belongs to phase B if the sink is an
    /// encoder.
    Step(usize),
    /// The second pin of a step generator.
    Dir(usize),
    /// The first pin of a PWM.
    Pwm(usize),
    /// A general output.
    Output(usize),
}

/// Where it ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sink {
    /// Phase A (and B) of an encoder.
    Encoder(usize),
    /// A general input.
    Input(usize),
}

/// A jumper that is said to be there.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Loop {
    /// From.
    pub source: Source,
    /// To.
    pub sink: Sink,
    /// As it was given.
    pub text: String,
}

/// A channel by its name or number, among these kinds; with a kind in front only of that one.
fn channel(
    identity: &Identity,
    text: &str,
    kinds: &[(&str, Kind)],
) -> Result<(usize, usize), String> {
    let blob = identity.blob();
    let mut found = Vec::new();
    for (which, (prefix, kind)) in kinds.iter().enumerate() {
        let own = text
            .strip_prefix(prefix)
            .and_then(|rest| rest.strip_prefix('.'));
        let wanted = own.unwrap_or(text);
        let numbers = identity.numbers(*kind);
        let named = { numbers.iter().copied() }.find(|n| blob.text(*kind, *n) == Some(wanted));
        let numbered = wanted
            .parse()
            .ok()
            .filter(|n: &u8| own.is_some() && numbers.contains(n));
        if let Some(n) = named.or(numbered) {
            found.push((which, usize::from(n), own.is_some()));
        }
    }
    if let Some((which, n, _)) = found.iter().find(|(_, _, own)| *own) {
        return Ok((*which, *n));
    }
    let all: Vec<&str> = kinds.iter().map(|(prefix, _)| *prefix).collect();
    match found[..] {
        [(which, n, _)] => Ok((which, n)),
        [] => Err(format!(
            "\"{text}\" is no {} of this board; ferrocnc describe has their names",
            all.join(", no ")
        )),
        _ => Err(format!(
            "\"{text}\" may be one of several; say {}.{text}",
            all.join(&format!(".{text} or "))
        )),
    }
}

impl Loop {
    /// `SOURCE=SINK`: `x=spindle`, `stepgen.0=encoder.0`, `x.dir=input.3`, `output.2=door`.
    pub fn parse(identity: &Identity, text: &str) -> Result<Loop, String> {
        let Some((source, sink)) = text.split_once('=') else {
            return Err(format!("\"{text}\" is not SOURCE=SINK, such as x=spindle"));
        };
        let (bare, dir) = match source.strip_suffix(".dir") {
            Some(bare) => (bare, true),
            None => (source, false),
        };
        let sources = [
            ("stepgen", Kind::Stepgen),
            ("output", Kind::Output),
            ("pwm", Kind::Pwm),
        ];
        let source = match channel(identity, bare, if dir { &sources[..1] } else { &sources })? {
            (0, n) if dir => Source::Dir(n),
            (0, n) => Source::Step(n),
            (1, n) => Source::Output(n),
            (_, n) => Source::Pwm(n),
        };
        let sinks = [("encoder", Kind::Encoder), ("input", Kind::Input)];
        let sink = match channel(identity, sink, &sinks)? {
            (0, n) => Sink::Encoder(n),
            (_, n) => Sink::Input(n),
        };
        match (source, sink) {
            (Source::Step(_), Sink::Encoder(_)) | (_, Sink::Input(_)) => {}
            (_, Sink::Encoder(_)) => {
                return Err(format!(
                    "\"{text}\": an encoder counts steps; use an input for a level"
                ));
            }
        }
        if let Sink::Input(n) = sink
            && identity.has_pin(b'i', n, "estop")
        {
            return Err(format!(
                "\"{text}\": an e-stop input stops what drives it; use another"
            ));
        }
        Ok(Loop {
            source,
            sink,
            text: text.to_owned(),
        })
    }
}

/// What an output did: its register, if it has one to look at, and its pad, if that is read.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Output {
    /// Number, and name; of a step generator or PWM with its kind and pin.
    pub name: String,
    /// Levels ordered, and levels of the register in front.
    pub levels: Vec<(bool, bool)>,
    /// Levels ordered, and levels at the pad; empty where the gateware does not read it.
    pub pad: Vec<(bool, bool)>,
    /// Other pads that go with it.
    pub joined: Vec<String>,
    /// General inputs that changed with it.
    pub inputs: Vec<usize>,
}

/// What is wrong at a pad.
fn judge_pad(check: &str, output: &Output) -> Option<Finding> {
    let remedy = "look for bridges at the FPGA and at the inputs of its buffer: what hangs on the header is behind that buffer";
    let fails = |level| output.pad.contains(&(level, !level));
    let seen = match (fails(true), fails(false)) {
        (false, false) if output.joined.is_empty() => return None,
        (false, false) => "its pad goes high and low",
        (true, false) => "driven high, its pad reads low",
        (false, true) => "driven low, its pad reads high",
        (true, true) => "its pad reads neither high nor low as it is driven",
    };
    let joined = output.joined.join(", ");
    let (fact, reason) = match (joined.as_str(), fails(true), fails(false)) {
        ("", true, false) => (
            seen.to_owned(),
            "shorted to ground or to a pin that is low, or a pad that is dead",
        ),
        ("", false, true) => (
            seen.to_owned(),
            "shorted to a supply or to a pin that is high, or a pad that is dead",
        ),
        ("", _, _) => (
            seen.to_owned(),
            "another driver at the same wire, or the platform file names the wrong pin",
        ),
        (_, false, false) => (
            format!("{seen}, and that of {joined} with it"),
            "the two are shorted",
        ),
        _ => (
            format!("{seen}, and not when {joined} is driven the same way"),
            "the two are shorted",
        ),
    };
    Some(Finding::bad(check, fact, reason, remedy))
}

/// Judges one.
pub fn judge_output(output: &Output) -> Finding {
    let check = &format!("output {}", output.name);
    if let Some((wanted, _)) = output.levels.iter().find(|(wanted, seen)| wanted != seen) {
        let level = if *wanted { "high" } else { "low" };
        return Finding::bad(
            check,
            format!("ordered {level}, and its register is not"),
            "the gateware does not follow its registers",
            "send this report: no wiring can do this",
        );
    }
    if let Some(finding) = judge_pad(check, output) {
        return finding;
    }
    let fact = match output.pad[..] {
        [] => "its register goes high and low; the pad is not read",
        _ => "its pad goes high and low; what is behind the pad is not seen",
    };
    match output.inputs[..] {
        [] => Finding::good(check, fact),
        _ => {
            let inputs: Vec<String> = output.inputs.iter().map(usize::to_string).collect();
            Finding::note(
                check,
                format!("{fact}; input {} follows it", inputs.join(", ")),
                "a wire, a jumper, or a short between pins",
                "name the jumper with --loop, or find the short",
            )
        }
    }
}

/// Judges the general outputs' pads with the gate closed: what drives them, and what they are.
pub fn judge_rest(driven: u64, seen: u64, names: &[String]) -> Finding {
    let check = "output pads";
    let wrong: Vec<&str> = names
        .iter()
        .enumerate()
        .filter(|(n, _)| (driven ^ seen) >> n & 1 != 0)
        .map(|(_, name)| name.as_str())
        .collect();
    if !wrong.is_empty() {
        return Finding::bad(
            check,
            format!("not as they are driven at rest: {}", wrong.join(", ")),
            "shorted to ground, to a supply or to another pin, or a pad that is dead",
            "`--outputs` says which way; look for bridges at the FPGA and at the inputs of its buffers",
        );
    }
    Finding::good(
        check,
        format!(
            "{} at rest as they are driven; what is behind a pad (buffer, header) is not seen",
            names.len()
        ),
    )
}

/// What a level did on its way.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Levels {
    /// The jumper, as it was given.
    pub name: String,
    /// What may have been driven, one of these; several where only the pattern is known.
    pub driven: Vec<Vec<bool>>,
    /// All general inputs at these moments.
    pub inputs: Vec<u64>,
    /// The one it should come out at.
    pub wanted: usize,
    /// The inputs there are.
    pub there: Vec<usize>,
}

impl Levels {
    fn at(&self, input: usize) -> Vec<bool> {
        self.inputs
            .iter()
            .map(|word| word >> input & 1 != 0)
            .collect()
    }

    fn follows(&self, input: usize) -> bool {
        let seen = self.at(input);
        self.driven.contains(&seen)
    }
}

/// Judges one.
pub fn judge_levels(facts: &Levels) -> Finding {
    let check = &format!("loop {}", facts.name);
    let moments = facts.inputs.len();
    let seen = facts.at(facts.wanted);
    if moments == 0 {
        return Finding::bad(
            check,
            "nothing was driven",
            "the board stopped before",
            "see above",
        );
    }
    if facts.follows(facts.wanted) {
        return Finding::good(check, format!("{moments} of {moments} levels arrive"));
    }
    let inverted: Vec<bool> = seen.iter().map(|level| !level).collect();
    if facts.driven.contains(&inverted) {
        return Finding::note(
            check,
            format!("{moments} of {moments} levels arrive turned over"),
            "something between inverts: a buffer, an optocoupler, `invert` in the board file",
            "this is right if it is intended",
        );
    }
    let elsewhere: Vec<usize> = { facts.there.iter().copied() }
        .filter(|n| *n != facts.wanted && facts.follows(*n))
        .collect();
    if let [other, ..] = elsewhere[..] {
        return Finding::bad(
            check,
            format!("the levels arrive at input {other} instead"),
            "the jumper is in another pin, or two jumpers are crossed",
            "compare with `ferrocnc config pinout`",
        );
    }
    let stuck = match (seen.contains(&true), seen.contains(&false)) {
        (true, false) => Some((
            "high",
            "nothing drives the input (the FPGA pulls up), or the output is stuck at high",
        )),
        (false, true) => Some((
            "low",
            "the input or the output is held low: a short to ground, a stuck output, no supply at a buffer",
        )),
        _ => None,
    };
    if let Some((level, reason)) = stuck {
        return Finding::bad(
            check,
            format!("the input stays {level}"),
            reason,
            "is the jumper in? Can this header be read at all (docs/bringup.md, Inputs)? Measure both pins",
        );
    }
    let right = |driven: &Vec<bool>| driven.iter().zip(&seen).filter(|(a, b)| a == b).count();
    let most = facts.driven.iter().map(right).max().unwrap_or(0);
    Finding::bad(
        check,
        format!("{most} of {moments} levels arrive"),
        "a loose jumper, or a level between high and low",
        "measure the level at the input: 3.3 V and 0 V, nothing between",
    )
}

/// What became of pulses.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    /// The jumper, as it was given.
    pub name: String,
    /// Pulses forwards, as the step generator counts them.
    pub forward: i64,
    /// Pulses backwards.
    pub backward: i64,
    /// Counts of the encoder meanwhile: A rises, down while B is high.
    pub counted_forward: i64,
    /// The same backwards.
    pub counted_backward: i64,
    /// Other encoders that counted.
    pub others: Vec<usize>,
    /// Counts of the encoder with up for A and down for B, if nothing was counted otherwise.
    pub up_down: Option<(i64, i64)>,
}

/// Judges one.
pub fn judge_counts(facts: &Counts) -> Finding {
    let check = &format!("loop {}", facts.name);
    let (sent, back) = (facts.forward.abs(), facts.backward.abs());
    let (there, again) = (facts.counted_forward, facts.counted_backward);
    let fact = format!("{sent} steps forwards and {back} back, {there} and {again} counted");
    if sent == 0 || back == 0 {
        return Finding::bad(
            check,
            fact,
            "the step generator made no pulses",
            "see above",
        );
    }
    if (there.abs(), again.abs()) == (sent, back) {
        return match there.signum() == again.signum() {
            false => Finding::good(check, format!("{fact}; DIR arrives at B")),
            true => Finding::note(
                check,
                format!("{fact}; DIR does not arrive at B"),
                "no pulse is lost, and the direction pin is not seen: B is not jumpered, or its pin is stuck",
                "jumper DIR to B as well to see it",
            ),
        };
    }
    // A pin that rests high may count once when it is connected to another.
    if there.abs() <= 1 && again.abs() <= 1 {
        let (up, down) = facts.up_down.unwrap_or_default();
        if up.abs() >= sent - 1 && down.abs() >= back - 1 {
            return Finding::bad(
                check,
                fact,
                "STEP arrives at B: the two wires are exchanged",
                "exchange A and B at one end",
            );
        }
        if let [other, ..] = facts.others[..] {
            return Finding::bad(
                check,
                format!("{fact}; encoder {other} counted"),
                "the jumper is in another encoder's pins, or two jumpers are crossed",
                "compare with `ferrocnc config pinout`",
            );
        }
        return Finding::bad(
            check,
            fact,
            "no pulse arrives: no jumper, a stuck pin, or a header that cannot be read",
            "is the jumper in? Can the encoder's header be read at all (docs/bringup.md, Inputs)? Measure both pins",
        );
    }
    let lost = (sent - there.abs()) + (back - again.abs());
    if lost > 0 {
        return Finding::bad(
            check,
            fact,
            &format!(
                "{lost} steps are missing: a level between low and high, or a filter longer than the pulse"
            ),
            "measure the level at A: 3.3 V and 0 V; shorten the jumper; a divider with lower resistance",
        );
    }
    Finding::bad(
        check,
        fact,
        &format!(
            "{} counts too many: the edge rings, or DIR moves while STEP is high",
            -lost
        ),
        "shorten the jumper, and give it ground beside it",
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::selftest::Verdict::{self, Bad, Good, Note};

    #[test]
    fn an_output_is_as_good_as_its_register() {
        let output = |levels: &[(bool, bool)], inputs: &[usize]| Output {
            name: "0".into(),
            levels: levels.to_vec(),
            inputs: inputs.to_vec(),
            ..Output::default()
        };
        let right = [(true, true), (false, false)];
        assert_eq!(judge_output(&output(&right, &[])).verdict, Good);
        assert_eq!(judge_output(&output(&right, &[3])).verdict, Note);
        let stuck = [(true, true), (false, true)];
        assert_eq!(judge_output(&output(&stuck, &[])).verdict, Bad);
    }

    #[test]
    fn a_pad_that_does_not_follow_is_shorted_and_it_is_said_to_what() {
        let finding = |pad: &[(bool, bool)], joined: &[&str]| {
            judge_output(&Output {
                name: "0".into(),
                levels: vec![(true, true), (false, false)],
                pad: pad.to_vec(),
                joined: joined.iter().map(|name| (*name).to_owned()).collect(),
                inputs: Vec::new(),
            })
        };
        let right = [(true, true), (false, false)];
        let good = finding(&right, &[]);
        assert_eq!(good.verdict, Good);
        assert!(good.fact.contains("behind the pad is not seen"), "{good:?}");
        for (pad, joined, fact, reason) in [
            (
                &[(true, false), (false, false)][..],
                &[][..],
                "driven high, its pad reads low",
                "to ground",
            ),
            (
                &[(true, true), (false, true)],
                &[],
                "driven low, its pad reads high",
                "to a supply",
            ),
            (
                &[(true, false), (false, true)],
                &[],
                "neither",
                "another driver",
            ),
            (
                &right,
                &["output 4"],
                "that of output 4 with it",
                "the two are shorted",
            ),
            (
                &[(true, false), (false, false)],
                &["output 4"],
                "when output 4 is driven the same way",
                "the two are shorted",
            ),
        ] {
            let bad = finding(pad, joined);
            assert_eq!(bad.verdict, Bad, "{bad:?}");
            assert!(
                bad.fact.contains(fact) && bad.reason.contains(reason),
                "{bad:?}"
            );
        }
    }

    #[test]
    fn pads_rest_at_the_levels_that_drive_them() {
        let names = ["0".to_owned(), "1 lamp".to_owned()];
        assert_eq!(judge_rest(0b10, 0b10, &names).verdict, Good);
        let bad = judge_rest(0b10, 0b00, &names);
        assert_eq!(bad.verdict, Bad);
        assert!(bad.fact.ends_with("1 lamp"), "{bad:?}");
    }

    fn levels(input: impl Fn(bool) -> u64) -> Finding {
        let driven = vec![true, false, true, true, false];
        judge_levels(&Levels {
            name: "a=b".into(),
            inputs: driven.iter().map(|level| input(*level)).collect(),
            driven: vec![driven],
            wanted: 2,
            there: (0..8).collect(),
        })
    }

    #[test]
    fn a_level_arrives_stays_away_or_comes_out_elsewhere() {
        let of = |finding: Finding| (finding.verdict, finding.fact);
        assert_eq!(levels(|level| u64::from(level) << 2).verdict, Good);
        assert_eq!(levels(|level| u64::from(!level) << 2).verdict, Note);
        assert_eq!(of(levels(|_| 4)), (Bad, "the input stays high".into()));
        assert_eq!(of(levels(|_| 0)), (Bad, "the input stays low".into()));
        let (verdict, fact) = of(levels(|level| u64::from(level) << 5));
        assert_eq!((verdict, fact.contains("input 5")), (Bad, true));
    }

    fn counts(forward: i64, backward: i64) -> Counts {
        Counts {
            name: "x=e".into(),
            forward: 100,
            backward: -100,
            counted_forward: forward,
            counted_backward: backward,
            ..Counts::default()
        }
    }

    fn reason(facts: &Counts) -> (Verdict, String) {
        let finding = judge_counts(facts);
        (finding.verdict, finding.reason)
    }

    #[test]
    fn pulses_are_all_there_or_it_is_said_which_way_they_went() {
        assert_eq!(reason(&counts(-100, 100)).0, Good);
        assert_eq!(reason(&counts(100, 100)).0, Note);
        for (facts, word) in [
            (counts(0, 0), "no pulse"),
            (counts(90, -90), "20 steps are missing"),
            (counts(101, -100), "1 counts too many"),
            (
                Counts {
                    up_down: Some((-100, 0)),
                    ..counts(0, 0)
                },
                "no pulse",
            ),
            (
                Counts {
                    up_down: Some((-100, -101)),
                    ..counts(1, 0)
                },
                "exchanged",
            ),
            (
                Counts {
                    others: vec![3],
                    ..counts(0, 0)
                },
                "another encoder",
            ),
        ] {
            let (verdict, why) = reason(&facts);
            assert!(verdict == Bad && why.contains(word), "{word}: {why}");
        }
    }
}
