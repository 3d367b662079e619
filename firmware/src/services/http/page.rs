//! What the status page shows, in small steps: each asks the board for sixteen words at most and
//! writes a few hundred bytes, so that it can be made while a host moves the machine.

use super::super::journal::{Journal, when};
use super::super::look::{Facts, ask};
use super::form::{Form, Piece, Place, Section, Sheet, Value};
use super::request::Ask;
use crate::text::{Out, Paper, Sink};
use jobs::Outside;
use wire::channels::WORD_PINS;
use wire::describe::{
    BOOT_ID_AT, GATE_CLOSE_AT, JobsState, OBSTACLE_ABI, OBSTACLES_AT, RESET_REASON_AT, address,
};
use wire::exchange::{STATUS_ENCODER, STATUS_HEAD, STATUS_STEPGEN, StateWord, status_word};
use wire::flash::{LinkWord, Running};
use wire::map::{self, CONFIG_STEPGEN, CONFIG_STRIDE, StepgenConfig};
use wire::refusal::{COUNTERS_CALLS, COUNTERS_CUTS, COUNTERS_WAYS};
use wire::regmap::{self, gpio, gpio_high};
use wire::{FaultReason, GateClose, LongWay, Refusal, ResetReason, State};

/// Before the sections.
const HEAD: &[u8] = include_bytes!("head.html");
/// Behind them.
const TAIL: &[u8] = include_bytes!("tail.html");
/// Bytes of these in a step.
const SLICE: usize = 200;
/// Clocks behind which a turn begins no other step: the ROM ends services that take 100 000 while
/// the owner's machine is at rest. A piece full of steps took 330 000.
const ENOUGH: u64 = 20_000;
/// Entries of the journal on the page.
const ENTRIES: usize = 12;
/// Refusals in a step.
const REFUSALS: usize = 4;

/// What the page is made of, besides what the board answers.
#[derive(Debug)]
pub struct PageSource<'w, 'm> {
    /// Names, counts, versions.
    pub facts: &'w Facts,
    /// The log.
    pub journal: &'w Journal<'m>,
    /// The board's name in the network, without `.local`.
    pub host: &'w str,
    /// Seconds since power-up.
    pub uptime: u32,
    /// Seconds since 1970, if known.
    pub unix: Option<u32>,
}

const fn section(
    key: &'static str,
    title: &'static str,
    columns: &'static [&'static str],
) -> Section {
    Section {
        key,
        title,
        columns,
    }
}

/// The sections.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Part {
    Machine,
    Axes,
    Encoders,
    Inputs,
    Outputs,
    Board,
    Link,
    Versions,
    Counters,
    Refused,
    Log,
}

use Part::{
    Axes, Board, Counters, Encoders, Inputs, Link, Log, Machine, Outputs, Refused, Versions,
};

const PARTS: [Part; 11] = [
    Machine, Axes, Encoders, Inputs, Outputs, Board, Link, Versions, Counters, Refused, Log,
];

impl Part {
    fn section(self) -> &'static Section {
        match self {
            Machine => const { &section("machine", "Machine", &[]) },
            Axes => {
                const {
                    &section(
                        "axes",
                        "Axes",
                        &[
                            "",
                            "position, steps",
                            "velocity, steps/s",
                            "at most, steps/s",
                            "limited now",
                        ],
                    )
                }
            }
            Encoders => const { &section("encoders", "Encoders", &["", "count", "errors"]) },
            Inputs => const { &section("inputs", "Inputs", &["", "on"]) },
            Outputs => const { &section("outputs", "Outputs", &["", "on"]) },
            Board => const { &section("board", "Board", &[]) },
            Link => const { &section("link", "Network", &[]) },
            Versions => const { &section("versions", "Versions", &[]) },
            Counters => const { &section("counters", "Counters", &[]) },
            Refused => const { &section("refused", "Refused datagrams", &[]) },
            Log => const { &section("log", "Log, newest first", &["", ""]) },
        }
    }

    /// Steps between beginning and end.
    fn steps(self, source: &PageSource) -> usize {
        let channels = source.facts.channels;
        match self {
            Axes => channels.stepgens.into(),
            Encoders => channels.encoders.into(),
            Inputs => channels.inputs.into(),
            Outputs => channels.outputs.into(),
            Refused => Refusal::COUNT.div_ceil(REFUSALS),
            Log => ENTRIES,
            Counters => 4,
            Machine | Board | Versions => 3,
            Link => 2,
        }
    }
}

/// An answer on its way: where the writing stands.
#[derive(Clone, Copy, Debug)]
pub struct Cursor {
    part: usize,
    step: usize,
    place: Place,
    /// Bytes of the text before or behind the sections.
    fixed: usize,
    /// The next entry of the journal.
    entry: u32,
    done: bool,
}

impl Cursor {
    /// Before the first byte, without a journal.
    pub const START: Cursor = Cursor {
        part: 0,
        step: 0,
        place: Place::START,
        fixed: 0,
        entry: 0,
        done: false,
    };

    /// Before the first byte.
    pub fn new(journal: &Journal) -> Self {
        Cursor {
            entry: journal.numbers().start,
            ..Cursor::START
        }
    }

    /// Is the last byte written?
    pub fn done(&self) -> bool {
        self.done
    }

    /// Writes on: until the piece is full or [`ENOUGH`] clocks have passed, or only a step. An
    /// answer that is not a page is written by the caller.
    pub fn fill(
        &mut self,
        which: Ask,
        one_step: bool,
        source: &PageSource,
        piece: &mut Piece,
        out: &mut impl Outside,
    ) {
        let begun = out.now();
        while !self.done {
            let (before, used) = (*self, piece.bytes().len());
            match which {
                Ask::Page => self.page(source, piece, out),
                Ask::Json => self.json(source, piece, out),
                Ask::Log => self.log(source, piece),
                Ask::Unknown | Ask::Method | Ask::Bad => self.done = true,
            }
            if piece.full() {
                piece.back_to(used);
                // A step that does not even fit into an empty piece is left out.
                if used > 0 {
                    *self = before;
                    return;
                }
            }
            let enough = one_step || out.now().wrapping_sub(begun) >= ENOUGH;
            if enough && !piece.bytes().is_empty() {
                return;
            }
        }
    }

    fn page(&mut self, source: &PageSource, piece: &mut Piece, out: &mut impl Outside) {
        if self.part == 0 && self.step == 0 && self.fixed < HEAD.len() {
            self.slice(HEAD, piece);
        } else if self.part < PARTS.len() {
            self.part(Form::Html, source, piece, out);
            if self.part == PARTS.len() {
                self.fixed = 0;
            }
        } else {
            self.slice(TAIL, piece);
            self.done = self.fixed >= TAIL.len();
        }
    }

    fn slice(&mut self, text: &[u8], piece: &mut Piece) {
        let rest = text.get(self.fixed..).unwrap_or(&[]);
        let (now, _) = rest.split_at(rest.len().min(SLICE));
        piece.put(now);
        self.fixed += now.len();
    }

    fn json(&mut self, source: &PageSource, piece: &mut Piece, out: &mut impl Outside) {
        if self.fixed == 0 {
            piece.put(b"{");
            self.fixed = 1;
        }
        self.part(Form::Json, source, piece, out);
        if self.part == PARTS.len() {
            piece.put(b"}\n");
            self.done = true;
        }
    }

    /// The journal as plain text, an entry a step.
    fn log(&mut self, source: &PageSource, piece: &mut Piece) {
        let numbers = source.journal.numbers();
        self.entry = self.entry.max(numbers.start);
        if let Some(entry) = source.journal.entry(self.entry) {
            let mut out = Out(piece);
            when(entry.stamp, &mut out);
            out.text(" ").ascii(entry.text.as_bytes()).text("\n");
        }
        self.entry = self.entry.saturating_add(1);
        self.done = self.entry >= numbers.end;
    }

    /// A step of a section.
    fn part(&mut self, form: Form, source: &PageSource, piece: &mut Piece, out: &mut impl Outside) {
        let Some(part) = PARTS.get(self.part) else {
            return;
        };
        let steps = part.steps(source);
        let mut sheet = Sheet {
            form,
            place: &mut self.place,
            section: part.section(),
            element: None,
            out: Out(piece),
        };
        match self.step.checked_sub(1) {
            None => sheet.open(),
            Some(step) if step < steps => write(*part, step, source, &mut sheet, out),
            Some(_) => sheet.close(),
        }
        self.step += 1;
        if self.step == steps + 2 {
            self.part += 1;
            self.step = 0;
        }
    }
}

/// Writes a step of a section.
fn write(part: Part, n: usize, source: &PageSource, sheet: &mut Sheet, out: &mut impl Outside) {
    match part {
        Machine => machine(n, sheet, out),
        Axes => axis(n, source, sheet, out),
        Encoders => encoder(n, source, sheet, out),
        Inputs => {
            let on = bit([IN_NOW, IN_NOW_HIGH], n, out);
            pin(n, ("input ", source.facts.input(n)), on, sheet);
        }
        Outputs => {
            let on = bit([OUT_NOW, OUT_NOW_HIGH], n, out);
            pin(n, ("output ", source.facts.output(n)), on, sheet);
        }
        Board => board(n, source, sheet, out),
        Link => link(n, source, sheet, out),
        Versions => versions(n, source, sheet, out),
        Counters => counters(n, sheet, out),
        Refused => refused(n, sheet, out),
        Log => entry(n, source, sheet),
    }
}

const IN_NOW: u32 = regmap::address(gpio::BASE, gpio::IN_NOW);
const IN_NOW_HIGH: u32 = regmap::address(gpio_high::BASE, gpio_high::IN_NOW);
const OUT_NOW: u32 = regmap::address(gpio::BASE, gpio::OUT_NOW);
const OUT_NOW_HIGH: u32 = regmap::address(gpio_high::BASE, gpio_high::OUT_NOW);

/// The level of a pin: of the first 32, or of those behind them.
fn bit([low, high]: [u32; 2], n: usize, out: &mut impl Outside) -> Option<bool> {
    let (address, bit) = match n.checked_sub(WORD_PINS.into()) {
        None => (low, n),
        Some(behind) => (high, behind),
    };
    let [word] = ask([address], out)?;
    Some(word.checked_shr(bit as u32)? & 1 != 0)
}

/// A channel's own name, or its kind and number.
fn name(n: usize, (kind, own): (&str, &str), sheet: &mut Sheet) {
    let mut room = [0; 16];
    let mut paper = Paper::new(&mut room);
    Out(&mut paper).text(kind).number(n as u32);
    let used = paper.used();
    let numbered = core::str::from_utf8(room.get(..used).unwrap_or(&[])).unwrap_or("");
    let text = if own.is_empty() { numbered } else { own };
    sheet.field("name", "", Value::Text(text));
}

fn pin(n: usize, names: (&str, &str), on: Option<bool>, sheet: &mut Sheet) {
    sheet.element(n);
    name(n, names, sheet);
    sheet.field("on", "", on);
    sheet.end();
}

/// A text that may not be known.
fn text(text: Option<&'static str>) -> Value<'static> {
    text.map_or(Value::Nothing, Value::Text)
}

fn machine(n: usize, sheet: &mut Sheet, out: &mut impl Outside) {
    let at = [
        map::STATUS,
        map::STATUS + 4 * status_word::ESTOP as u32,
        address(OBSTACLES_AT),
        map::SESSION_OWNER_IP,
    ];
    let words = ask(at, out);
    let state = words.and_then(|[state, ..]| StateWord::from_word(state).ok());
    match n {
        0 => {
            let foreign = words.is_some_and(|[_, _, obstacles, _]| obstacles & OBSTACLE_ABI != 0);
            let why = state.map(|it| it.reason);
            let remedy = state.and_then(|it| match it.state {
                State::Armed | State::Boot => None,
                State::Disarmed | State::Stopping | State::Faulted if foreign => {
                    Some(FaultReason::AbiMismatch.remedy())
                }
                State::Disarmed | State::Stopping | State::Faulted => Some(it.reason.remedy()),
            });
            sheet.field("state", "State", text(state.map(|it| it.state.text())));
            sheet.field("reason", "Last stop", text(why.map(FaultReason::text)));
            sheet.field("remedy", "What to do", text(remedy));
        }
        1 => {
            sheet.field("outputs_live", "Outputs live", state.map(|it| it.enabled));
            let trusted = state.map(|it| it.position_trusted);
            sheet.field("position_trusted", "Positions trusted", trusted);
            let owner = words.filter(|[.., owner]| *owner != 0);
            let owner = owner.map_or(Value::Nothing, |[.., owner]| Value::Ip(owner));
            sheet.field("driven_by", "Driven by", owner);
        }
        _ => {
            sheet.field("emergency_stop", "Emergency stop", state.map(|it| it.estop));
            let tripped = words.map_or(Value::Nothing, |[_, tripped, ..]| Value::Hex(tripped));
            sheet.field("estop_inputs", "by inputs", tripped);
            let reset = state.map(|it| it.external_reset);
            sheet.field("external_reset", "External reset", reset);
        }
    }
}

fn axis(n: usize, source: &PageSource, sheet: &mut Sheet, out: &mut impl Outside) {
    let at = map::STATUS + 4 * (STATUS_HEAD + n * STATUS_STEPGEN) as u32;
    let config = CONFIG_STEPGEN + n as u32 * CONFIG_STRIDE;
    let words = ask(
        [
            at,
            at + 4,
            at + 8,
            map::STATUS + 4 * status_word::FLAGS0 as u32,
            config + 4 * StepgenConfig::Steplen as u32,
            config + 4 * StepgenConfig::Stepspace as u32,
        ],
        out,
    );
    let clock = source.facts.clock_hz;
    let fixed = |value: Option<i64>| value.map_or(Value::Nothing, Value::Fixed);
    let position = words.map(|[low, high, ..]| (u64::from(high) << 32 | u64::from(low)) as i64);
    // One unit of velocity is the clock / 2^32.
    let velocity = words.map(|[_, _, velocity, ..]| i64::from(velocity as i32) * i64::from(clock));
    let most = words.and_then(|[.., high, low]| clock.checked_div(high.wrapping_add(low)));
    sheet.element(n);
    name(n, ("stepgen ", source.facts.stepgen(n)), sheet);
    sheet.field("position", "", fixed(position));
    sheet.field("velocity", "", fixed(velocity));
    sheet.field("max_velocity", "", most);
    let limited = words.map(|[_, _, _, flags, ..]| flags >> (16 + n) & 1 != 0);
    sheet.field("limited", "", limited);
    sheet.end();
}

fn encoder(n: usize, source: &PageSource, sheet: &mut Sheet, out: &mut impl Outside) {
    let stepgens = usize::from(source.facts.channels.stepgens) * STATUS_STEPGEN;
    let at = map::STATUS + 4 * (STATUS_HEAD + stepgens + n * STATUS_ENCODER) as u32;
    let words = ask([at, at + 4], out);
    let count = words.map_or(Value::Nothing, |[count, _]| Value::Signed(count as i32));
    let errors = words.map(|[_, edge]| edge >> wire::exchange::EDGE_TIME_BITS);
    sheet.element(n);
    name(n, ("encoder ", source.facts.encoder(n)), sheet);
    sheet.field("count", "", count);
    sheet.field("errors", "", errors);
    sheet.end();
}

fn board(n: usize, source: &PageSource, sheet: &mut Sheet, out: &mut impl Outside) {
    let facts = source.facts;
    match n {
        0 => {
            sheet.field("name", "Name", Value::Text(source.host));
            sheet.field("board", "Card", Value::Text(&facts.board));
            sheet.field(
                "configuration",
                "Configuration",
                Value::Text(&facts.configuration),
            );
        }
        1 => {
            let [high, low] = facts.uid;
            let mut uid = [0; 16];
            Out(&mut Paper::new(&mut uid)).hex(high).hex(low);
            let uid = core::str::from_utf8(&uid).unwrap_or("");
            sheet.field("uid", "Unique id", Value::Text(uid));
            let features = ask([address(wire::describe::FEATURES_AT)], out);
            let services = features.map(|[features]| JobsState::of(features).text());
            sheet.field("services", "Services", text(services));
        }
        _ => {
            sheet.field(
                "uptime",
                "Seconds since power-up",
                Value::Number(source.uptime),
            );
            let time = source.unix.map_or(Value::Nothing, Value::Date);
            sheet.field("time", "Time", time);
        }
    }
}

fn link(n: usize, source: &PageSource, sheet: &mut Sheet, out: &mut impl Outside) {
    let words = ask([map::STATUS, map::FLASH_LINK, map::FLASH_IP], out);
    let up = words.and_then(|[state, ..]| StateWord::from_word(state).ok());
    let link = words.map(|[_, link, _]| LinkWord::from_word(link));
    if n == 0 {
        let ip = words.map_or(Value::Nothing, |[.., ip]| Value::Ip(ip));
        sheet.field("host", "Name.local", Value::Text(source.host));
        sheet.field("ip", "Address", ip);
        sheet.field("up", "Link up", up.map(|it| it.link));
    } else {
        sheet.field("speed", "Speed", text(link.map(|it| it.speed.text())));
        sheet.field("full_duplex", "Full duplex", link.map(|it| it.full_duplex));
        sheet.field("errors", "Frames lost", link.map(|it| it.errors));
    }
}

fn versions(n: usize, source: &PageSource, sheet: &mut Sheet, out: &mut impl Outside) {
    let [_, version, abi, _, firmware, gateware, ..] = source.facts.words;
    match n {
        0 => {
            sheet.field("firmware", "Firmware", Value::Version(firmware));
            sheet.field("gateware", "Gateware", Value::Version(gateware));
            sheet.field("wire", "Protocol", Value::Number(version));
            sheet.field("register_map", "Register map", Value::Hex(abi));
        }
        1 => {
            let words = ask([map::FLASH_BUILD_ID, map::FLASH_RUNNING], out);
            let build = words.map_or(Value::Nothing, |[build, _]| Value::Hex(build));
            let running = words.and_then(|[_, running]| Running::from_code(running));
            sheet.field("build", "Build", build);
            sheet.field("running", "Running", text(running.map(Running::text)));
        }
        _ => {
            let at = [BOOT_ID_AT, RESET_REASON_AT, GATE_CLOSE_AT];
            let words = ask(at.map(address), out);
            let id = words.map_or(Value::Nothing, |[id, ..]| Value::Hex(id));
            let reset = words.and_then(|[_, why, _]| ResetReason::from_code(why as u8));
            let close = words.and_then(|[_, _, why]| GateClose::from_code(why as u8));
            sheet.field("boot_id", "Start of the firmware", id);
            sheet.field(
                "started_because",
                "because of",
                text(reset.map(ResetReason::text)),
            );
            sheet.field(
                "gate_closed_by",
                "Gate closed by",
                text(close.map(GateClose::text)),
            );
        }
    }
}

fn counters(n: usize, sheet: &mut Sheet, out: &mut impl Outside) {
    let at = map::COUNTERS;
    match n {
        0 => {
            let words = ask([at, at + 4], out);
            sheet.field("received", "Datagrams received", words.map(|[it, _]| it));
            sheet.field("sent", "Datagrams sent", words.map(|[_, it]| it));
        }
        1 => {
            let words = ask([at + 8, COUNTERS_CUTS], out);
            sheet.field("exchanges", "Exchanges", words.map(|[it, _]| it));
            sheet.field("cuts", "Pulses cut off", words.map(|[_, it]| it));
        }
        2 => {
            let at = COUNTERS_WAYS;
            let words = ask([at, at + 4, at + 8], out);
            let (fast, long) = (words.map(|[it, ..]| it), words.map(|[_, it, _]| it));
            sheet.field("fast_way", "Answered by the gateware", fast);
            sheet.field("long_way", "Answered by the firmware", long);
            let why = words.and_then(|[.., it]| LongWay::from_code(it));
            let title = "Why the last one was";
            sheet.field("long_way_reason", title, text(why.map(LongWay::text)));
        }
        _ => {
            let words = ask([COUNTERS_CALLS, COUNTERS_CALLS + 4], out);
            let moving = words.map(|[it, _]| it);
            let title = "Longest call of the services while moving, clocks";
            sheet.field("longest_call_moving", title, moving);
            let other = words.map(|[_, it]| it);
            sheet.field("longest_call_else", "The same at other times", other);
        }
    }
}

fn refused(n: usize, sheet: &mut Sheet, out: &mut impl Outside) {
    let first = n * REFUSALS;
    let at = |n: usize| map::COUNTERS_REFUSED + 4 * (first + n) as u32;
    let words = ask::<REFUSALS>(core::array::from_fn(at), out);
    let reasons = Refusal::ALL.get(first..).unwrap_or(&[]);
    for (n, reason) in reasons.iter().take(REFUSALS).enumerate() {
        let count = words.and_then(|words| words.get(n).copied());
        sheet.field(reason.key(), reason.key(), count);
    }
}

/// An entry of the journal, the newest first. A page has all rows, so that new entries find theirs.
fn entry(n: usize, source: &PageSource, sheet: &mut Sheet) {
    let number = source.journal.next().checked_sub(1 + n as u32);
    let entry = number.and_then(|number| source.journal.entry(number));
    if entry.is_none() && sheet.form == Form::Json {
        return;
    }
    let mut room = [0; 40];
    let mut paper = Paper::new(&mut room);
    if let Some(entry) = entry {
        when(entry.stamp, &mut Out(&mut paper));
    }
    let used = paper.used();
    let time = core::str::from_utf8(room.get(..used).unwrap_or(&[])).unwrap_or("");
    sheet.element(n);
    sheet.field("when", "", Value::Text(time));
    sheet.field(
        "text",
        "",
        Value::Text(entry.map_or("", |entry| entry.text)),
    );
    sheet.end();
}
