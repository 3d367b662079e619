//! A board that answers, clients that ask well and badly, and names of any kind.

use super::super::journal::{BYTES, Journal, Severity, Stamp};
use super::super::look::Facts;
use super::*;
use proptest::prelude::*;
use serde_json::Value as Json;
use wire::describe::{Channels, Describe, DescribeError, JobsState, WORDS};
use wire::exchange::StateWord;
use wire::regmap::{self, gpio, gpio_high};
use wire::{FaultReason, GateClose, LongWay, MAX_WORDS, ResetReason, State, map};

/// Why the last exchange took the long way.
const WHY: u32 = wire::refusal::COUNTERS_WAYS + 8;

/// A board of which every word can be read.
struct Fake {
    describe: [u32; WORDS],
    blob: Vec<u32>,
    state: StateWord,
    refuses: bool,
    /// Words asked for since the test looked, and the most in one question.
    asked: usize,
    most: usize,
    /// The clock, and what passes between two looks at it.
    clock: u64,
    passes: u64,
}

impl Fake {
    fn read(&self, address: u32) -> u32 {
        let blob = map::DESCRIBE_BLOB..map::SESSION;
        match address {
            _ if blob.contains(&address) => {
                let n = ((address - map::DESCRIBE_BLOB) / 4) as usize;
                self.blob.get(n).copied().unwrap_or(0)
            }
            ..map::DESCRIBE_BLOB => self.describe.get(address as usize / 4).map_or(0, |it| *it),
            map::STATUS => self.state.to_word(),
            map::FLASH_UID_HI => 0xd162_0c8a,
            map::FLASH_RUNNING => 1,
            map::FLASH_IP => 0xc0a8_0232,
            WHY => LongWay::Timed as u32,
            // 300 and 300 clocks: 100 000 steps/s at 60 MHz.
            map::CONFIG..map::COMMAND => 300,
            address => address,
        }
    }
}

impl Outside for Fake {
    fn datagram(&mut self, request: &[u32], reply: &mut [u32; MAX_WORDS]) -> usize {
        let addresses = &request[4..];
        self.asked += addresses.len();
        self.most = self.most.max(addresses.len());
        if self.refuses {
            return 0;
        }
        for (place, address) in reply[4..].iter_mut().zip(addresses) {
            *place = self.read(*address);
        }
        4 + addresses.len()
    }
    fn read_segments(&mut self, _: usize) -> u32 {
        unreachable!("the page reads windows")
    }
    fn write_segments(&mut self, _: usize, _: u32) {
        unreachable!("the page writes nothing")
    }
    fn now(&mut self) -> u64 {
        self.clock += self.passes;
        self.clock
    }
}

/// The board information with these names: kind, channel, name.
fn blob(names: &[(u8, u8, &str)]) -> Vec<u32> {
    let mut body = Vec::new();
    for (kind, channel, name) in names {
        body.extend([*kind, *channel, name.len() as u8, 0]);
        body.extend_from_slice(name.as_bytes());
        body.resize(body.len().next_multiple_of(4), 0);
    }
    let length = 16 + body.len() as u32;
    let mut words = vec![wire::board::MAGIC, 1, length, wire::crc::crc32(&body)];
    let chunks = body.as_chunks().0.iter();
    words.extend(chunks.map(|chunk| u32::from_be_bytes(*chunk)));
    words
}

fn board(channels: Channels, names: &[(u8, u8, &str)]) -> Fake {
    let blob = blob(names);
    let state = StateWord {
        state: State::Faulted,
        reason: FaultReason::EStop,
        position_trusted: true,
        enabled: false,
        session_yours: false,
        bitten: false,
        external_reset: false,
        accepted: false,
        link: true,
        estop: true,
        speed: wire::LinkSpeed::M1000,
        services: JobsState::None,
        link_errors: 0,
    };
    let describe = Describe {
        wire_version: wire::WIRE_VERSION,
        abi_firmware: 1,
        abi_gateware: 1,
        firmware_version: 0x0001_0203,
        gateware_version: 0x0001_0200,
        clock_hz: 60_000_000,
        channels,
        features: 0x0001_0001,
        boot_id: 9,
        blob_words: blob.len() as u32,
        state,
        obstacles: 0,
        reset_reason: ResetReason::PowerUp,
        gate_close: GateClose::Never,
    };
    let describe = describe.to_words();
    assert!(!matches!(
        Describe::parse(&describe),
        Err(DescribeError::Malformed)
    ));
    Fake {
        describe,
        blob,
        state,
        refuses: false,
        asked: 0,
        most: 0,
        clock: 0,
        passes: 0,
    }
}

const MILL: Channels = Channels {
    stepgens: 6,
    encoders: 6,
    pwms: 6,
    inputs: 12,
    outputs: 12,
};
const LARGEST: Channels = Channels {
    stepgens: 16,
    encoders: 16,
    pwms: 16,
    inputs: 64,
    outputs: 64,
};

fn mill() -> Fake {
    board(
        MILL,
        &[
            (1, 0, "5a-75b-8.0"),
            (2, 0, "mill6"),
            (3, 0, "x"),
            (3, 2, "z"),
            (6, 3, "probe"),
            (7, 1, "flood <coolant> & \"mist\""),
        ],
    )
}

/// More turns than it takes to read all words and then to find the names, a list at a time.
const READS: usize = 100;

fn facts(fake: &mut Fake) -> Facts {
    let mut facts = Facts::new();
    for _ in 0..READS {
        facts.read(true, fake);
    }
    assert!(facts.done() && facts.known());
    facts
}

fn logged(memory: &mut [u8], text: &str) {
    let stamp = Stamp {
        boot: 9,
        uptime: 75,
        unix: None,
    };
    Journal::open(memory).log(stamp, Severity::Error, text);
}

/// A whole answer: its head, its content, and the turns it took.
struct Got {
    head: String,
    content: String,
    turns: usize,
    longest: usize,
}

fn get(request: &str, load: Load, fake: &mut Fake, facts: &Facts, memory: &mut [u8]) -> Got {
    let mut connection = Connection::new();
    connection.open(0);
    assert_eq!(connection.take(request.as_bytes(), 0), request.len());
    answer(connection, load, fake, facts, memory).expect("an answer")
}

fn answer(
    mut connection: Connection,
    load: Load,
    fake: &mut Fake,
    facts: &Facts,
    memory: &mut [u8],
) -> Option<Got> {
    let journal = Journal::open(memory);
    let source = PageSource {
        facts,
        journal: &journal,
        host: "mill",
        uptime: 80,
        unix: None,
    };
    let (mut all, mut turns, mut longest) = (String::new(), 0, 0);
    loop {
        let mut piece = String::new();
        fake.asked = 0;
        let turn = connection.turn(&source, load, &mut piece, fake);
        assert!(piece.len() <= TURN_MAX, "{} bytes", piece.len());
        if load == Load::Moving {
            assert!(fake.asked <= 16, "{} words in a turn", fake.asked);
        }
        longest = longest.max(piece.len());
        turns += 1;
        all += &piece;
        match turn {
            Turn::Idle if all.is_empty() => return None,
            Turn::Idle => panic!("idle in the middle"),
            Turn::Wrote => assert!(turns < 1000, "no end"),
            Turn::Close => break,
        }
    }
    let (head, body) = all.split_once("\r\n\r\n").expect("a head");
    let chunked = head.contains("Transfer-Encoding: chunked");
    let content = if chunked && !body.is_empty() {
        dechunked(body)
    } else {
        body.to_owned()
    };
    Some(Got {
        head: head.to_owned(),
        content,
        turns,
        longest,
    })
}

fn dechunked(mut body: &str) -> String {
    let mut all = String::new();
    loop {
        let (length, rest) = body.split_once("\r\n").expect("a length");
        let length = usize::from_str_radix(length, 16).expect("hexadecimal");
        let (chunk, rest) = rest.split_at(length);
        all += chunk;
        body = rest.strip_prefix("\r\n").expect("an end");
        if length == 0 {
            assert!(body.is_empty());
            return all;
        }
    }
}

fn json(fake: &mut Fake, load: Load, memory: &mut [u8]) -> Json {
    let facts = facts(fake);
    let got = get(
        "GET /status.json HTTP/1.1\r\n\r\n",
        load,
        fake,
        &facts,
        memory,
    );
    assert!(got.head.starts_with("HTTP/1.1 200 OK\r\n"), "{}", got.head);
    serde_json::from_str(&got.content).unwrap_or_else(|why| panic!("{why}: {}", got.content))
}

#[test]
fn status_json_says_what_the_machine_is_doing_and_what_to_do() {
    let mut memory = vec![0; BYTES];
    logged(&mut memory, "stopped: e-stop input");
    for load in [Load::Rest, Load::Moving] {
        let status = json(&mut mill(), load, &mut memory);
        let machine = &status["machine"];
        assert_eq!(machine["state"], "faulted");
        assert_eq!(machine["reason"], "e-stop input");
        assert_eq!(machine["remedy"], FaultReason::EStop.remedy());
        assert_eq!(machine["emergency_stop"], true);
        assert_eq!(status["axes"].as_array().unwrap().len(), 6);
        assert_eq!(status["axes"][0]["name"], "x");
        assert_eq!(status["axes"][1]["name"], "stepgen 1");
        assert_eq!(status["axes"][0]["max_velocity"], 100_000);
        assert_eq!(status["inputs"][3]["name"], "probe");
        assert_eq!(status["outputs"][1]["name"], "flood <coolant> & \"mist\"");
        assert_eq!(status["board"]["configuration"], "mill6");
        assert_eq!(status["board"]["uptime"], 80);
        assert_eq!(status["link"]["ip"], "192.168.2.50");
        assert_eq!(status["versions"]["firmware"], "1.2.3");
        assert_eq!(
            status["refused"].as_object().unwrap().len(),
            wire::Refusal::COUNT
        );
        let counters = &status["counters"];
        assert_eq!(counters["fast_way"], wire::refusal::COUNTERS_WAYS);
        assert_eq!(counters["long_way"], wire::refusal::COUNTERS_WAYS + 4);
        assert_eq!(counters["long_way_reason"], LongWay::Timed.text());
        assert_eq!(status["log"][0]["text"], "stopped: e-stop input");
        assert_eq!(status["log"][0]["when"], "start 9 +0:01:15");
    }
}

#[test]
fn a_position_and_a_velocity_have_their_units() {
    let mut memory = vec![0; BYTES];
    let status = json(&mut mill(), Load::Rest, &mut memory);
    // What the fake says there: the addresses themselves.
    let at = map::STATUS + 4 * wire::exchange::STATUS_HEAD as u32;
    let position = f64::from(at) / 4_294_967_296.0 + f64::from(at + 4);
    let velocity = f64::from(at + 8) * 60e6 / 4_294_967_296.0;
    for (key, wanted) in [("position", position), ("velocity", velocity)] {
        let found = status["axes"][0][key].as_f64().unwrap();
        assert!((found - wanted).abs() < 0.011, "{key}: {found} {wanted}");
    }
}

#[test]
fn a_board_that_refuses_is_shown_with_gaps() {
    let mut memory = vec![0; BYTES];
    let mut fake = mill();
    let facts = facts(&mut fake);
    fake.refuses = true;
    let request = "GET /status.json HTTP/1.1\r\n\r\n";
    let got = get(request, Load::Rest, &mut fake, &facts, &mut memory);
    let status: Json = serde_json::from_str(&got.content).unwrap();
    assert_eq!(status["machine"]["state"], Json::Null);
    assert_eq!(status["axes"][0]["position"], Json::Null);
}

/// Every `data-k` of the page.
fn keys(page: &str) -> Vec<&str> {
    let cells = page.split("<td data-k=").skip(1);
    cells
        .map(|cell| cell.split([' ', '>']).next().unwrap())
        .collect()
}

#[test]
fn each_cell_of_the_page_has_its_value_in_the_json() {
    let mut memory = vec![0; BYTES];
    for n in 0..20 {
        logged(&mut memory, &format!("event {n}"));
    }
    let mut fake = mill();
    let status = json(&mut fake, Load::Rest, &mut memory);
    let facts = facts(&mut fake);
    let got = get(
        "GET / HTTP/1.1\r\n\r\n",
        Load::Rest,
        &mut fake,
        &facts,
        &mut memory,
    );
    let page = &got.content;
    assert!(page.starts_with("<!doctype html>") && page.trim_end().ends_with("</script>"));
    let keys = keys(page);
    assert!(keys.len() > 100, "{}", keys.len());
    for key in keys {
        let mut value = &status;
        for part in key.split('.') {
            value = match part.parse::<usize>() {
                Ok(number) => &value[number],
                Err(_) => &value[part],
            };
        }
        let shown = key == "machine.driven_by" || key == "board.time";
        assert!(!value.is_null() || shown, "{key}");
    }
    for outside in ["http:", "https:", "src=", "href="] {
        assert!(!page.contains(outside), "{outside}");
    }
    assert!(page.contains("flood &lt;coolant&gt; &amp; &quot;mist&quot;"));
    assert!(page.contains("event 19") && !page.contains("event 7<"));
}

#[test]
fn a_page_is_the_same_in_large_and_in_small_pieces() {
    let mut memory = vec![0; BYTES];
    logged(&mut memory, "event");
    let mut fake = board(LARGEST, &[]);
    let facts = facts(&mut fake);
    for path in ["/", "/status.json", "/log"] {
        let request = format!("GET {path} HTTP/1.1\r\n\r\n");
        let large = get(&request, Load::Rest, &mut fake, &facts, &mut memory);
        let small = get(&request, Load::Moving, &mut fake, &facts, &mut memory);
        assert_eq!(large.content, small.content);
        // A board whose every step takes all the time of a turn: as in motion.
        fake.passes = 20_000;
        let slow = get(&request, Load::Rest, &mut fake, &facts, &mut memory);
        fake.passes = 0;
        assert_eq!(slow.content, small.content);
        assert_eq!((slow.turns, slow.longest), (small.turns, small.longest));
        assert!(path == "/log" || large.turns < small.turns, "{path}");
        assert!(small.longest <= 330, "{path}: {}", small.longest);
        println!(
            "{path}: {} bytes, {} turns at rest, {} in motion, of {} bytes at most",
            large.content.len(),
            large.turns,
            small.turns,
            small.longest
        );
    }
    assert!(fake.most <= wire::GUEST_READS);
}

#[test]
fn a_client_of_http_1_0_gets_the_content_as_it_is() {
    let mut memory = vec![0; BYTES];
    let mut fake = mill();
    let facts = facts(&mut fake);
    let request = "GET /status.json HTTP/1.0\n\n";
    let got = get(request, Load::Rest, &mut fake, &facts, &mut memory);
    assert!(!got.head.contains("chunked"));
    serde_json::from_str::<Json>(&got.content).unwrap();
}

#[test]
fn head_is_answered_without_content() {
    let mut memory = vec![0; BYTES];
    let mut fake = mill();
    let facts = facts(&mut fake);
    for (path, status) in [("/", "200"), ("/log", "200"), ("/x", "404")] {
        let request = format!("HEAD {path} HTTP/1.1\r\nHost: mill.local\r\n\r\n");
        let got = get(&request, Load::Rest, &mut fake, &facts, &mut memory);
        assert!(
            got.head.starts_with(&format!("HTTP/1.1 {status}")),
            "{}",
            got.head
        );
        assert!(got.content.is_empty());
    }
}

#[test]
fn what_is_not_there_or_not_allowed_says_so() {
    let mut memory = vec![0; BYTES];
    let mut fake = mill();
    let facts = facts(&mut fake);
    let long = format!("GET /{} HTTP/1.1\r\n\r\n", "x".repeat(200));
    let slow = format!("GET / HTTP/1.1\r\n{}", "a: b\r\n".repeat(1000));
    for (request, status) in [
        ("GET /favicon.ico HTTP/1.1\r\n\r\n", "404"),
        ("GET /log/ HTTP/1.1\r\n\r\n", "404"),
        ("POST / HTTP/1.1\r\nContent-Length: 3\r\n\r\na=b", "405"),
        ("DELETE /x HTTP/1.1\r\n\r\n", "405"),
        ("GET /\r\n\r\n", "400"),
        ("GET / HTTP/2.0\r\n\r\n", "400"),
        ("GET  / HTTP/1.1\r\n\r\n", "400"),
        ("GET relative HTTP/1.1\r\n\r\n", "400"),
        ("\u{16}\u{3}\u{1}\r\n\r\n", "400"),
        (&long, "400"),
        (&slow, "400"),
        ("GET /?x=1 HTTP/1.1\r\n\r\n", "200"),
        ("GET http://mill.local/ HTTP/1.1\r\n\r\n", "200"),
        ("\r\nGET / HTTP/1.1\r\n\r\n", "200"),
    ] {
        let got = get(request, Load::Rest, &mut fake, &facts, &mut memory);
        let begin = format!("HTTP/1.1 {status} ");
        assert!(got.head.starts_with(&begin), "{request:?}: {}", got.head);
        if status != "200" {
            let length = format!("Content-Length: {}", got.content.len());
            assert!(got.head.contains(&length), "{}", got.head);
            assert_eq!(got.head.contains("Allow: GET, HEAD"), status == "405");
        }
    }
}

#[test]
fn without_time_it_is_busy_and_says_when_to_come_again() {
    let mut memory = vec![0; BYTES];
    let mut fake = mill();
    let facts = facts(&mut fake);
    fake.asked = 0;
    let got = get(
        "GET / HTTP/1.1\r\n\r\n",
        Load::Busy,
        &mut fake,
        &facts,
        &mut memory,
    );
    assert!(got.head.starts_with("HTTP/1.1 503 ") && got.head.contains("Retry-After: 2"));
    assert_eq!((got.turns, fake.asked), (1, 0));
}

#[test]
fn a_slow_client_is_given_up() {
    let mut connection = Connection::new();
    connection.open(1000);
    connection.take(b"GET / HT", 2000);
    assert!(!connection.late(1000 + REQUEST_MS - 1) && connection.late(1000 + REQUEST_MS));
    connection.take(b"TP/1.1\r\n\r\n", 4000);
    assert!(connection.answers() && !connection.late(4000 + ANSWER_MS - 1));
    assert!(connection.late(4000 + ANSWER_MS));
}

#[test]
fn names_are_found_only_while_the_machine_stands() {
    let mut fake = mill();
    let mut facts = Facts::new();
    for _ in 0..READS {
        fake.asked = 0;
        facts.read(false, &mut fake);
        assert!(fake.asked <= wire::GUEST_READS);
    }
    assert!(facts.known() && !facts.done() && facts.stepgen(0).is_empty());
    for _ in 0..READS {
        facts.read(true, &mut fake);
    }
    assert!(facts.done() && facts.stepgen(0) == "x");
}

/// Names that a board information can have, of bytes that hurt.
fn names() -> impl Strategy<Value = Vec<(u8, u8, String)>> {
    let name = prop_oneof![
        "[<>&\"'\\\\\n\t\u{1}\u{7f}\u{2028}a]{0,60}",
        "\\PC{0,40}",
        Just("\u{1}".repeat(60)),
        Just("\"".repeat(60)),
    ];
    proptest::collection::vec((1u8..8, 0u8..32, name), 0..12)
}

#[test]
fn a_full_last_piece_with_its_framing_fits_into_a_turn() {
    let mut written = String::new();
    let request = Request {
        ask: Ask::Json,
        head: false,
        pieces: true,
    };
    put(&request, &[b'x'; PIECE], true, &mut written);
    assert_eq!(written.len(), TURN_MAX);
}

#[test]
fn every_pin_is_shown_at_its_own_level_those_behind_the_first_32_too() {
    let mut memory = vec![0; BYTES];
    let mut fake = board(LARGEST, &[]);
    let status = json(&mut fake, Load::Rest, &mut memory);
    // Each register of this board reads as its own address.
    for (pins, registers) in [
        (
            "inputs",
            [
                regmap::address(gpio::BASE, gpio::IN_NOW),
                regmap::address(gpio_high::BASE, gpio_high::IN_NOW),
            ],
        ),
        (
            "outputs",
            [
                regmap::address(gpio::BASE, gpio::OUT_NOW),
                regmap::address(gpio_high::BASE, gpio_high::OUT_NOW),
            ],
        ),
    ] {
        for n in 0..64 {
            let level = registers[n / 32] >> (n % 32) & 1 != 0;
            assert_eq!(status[pins][n]["on"], level, "{pins} {n}");
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn any_names_and_events_give_valid_json_and_no_markup(names in names(), event: String) {
        let short: Vec<(u8, u8, &str)> =
            names.iter().map(|(kind, n, name)| (*kind, *n, name.as_str())).collect();
        let mut fake = board(LARGEST, &short);
        let mut memory = vec![0; BYTES];
        logged(&mut memory, &event);
        for load in [Load::Rest, Load::Moving] {
            let status = json(&mut fake, load, &mut memory);
            prop_assert_eq!(status["axes"].as_array().unwrap().len(), 16);
            prop_assert_eq!(status["inputs"].as_array().unwrap().len(), 64);
        }
        let facts = facts(&mut fake);
        let got = get("GET / HTTP/1.1\r\n\r\n", Load::Rest, &mut fake, &facts, &mut memory);
        // The cells hold text alone.
        for cell in got.content.split("<td ").skip(1) {
            let (_, text) = cell.split_once('>').unwrap();
            // The next cell, row or end of the table.
            let Some(end) = text.find('<') else { continue };
            let next = &text[end..];
            prop_assert!(next.starts_with("<tr>") || next.starts_with("</table>"), "{}", next);
        }
    }

    #[test]
    fn any_bytes_end_in_an_answer_or_are_given_up(
        bytes in proptest::collection::vec(any::<u8>(), 0..6000),
        good in any::<bool>(),
    ) {
        let mut fake = mill();
        let facts = facts(&mut fake);
        let mut memory = vec![0; BYTES];
        let mut connection = Connection::new();
        connection.open(0);
        if good {
            connection.take(b"GET /status.json HTTP/1.1\r\n", 0);
        }
        for piece in bytes.chunks(70) {
            prop_assert_eq!(connection.take(piece, 0), piece.len());
        }
        prop_assert!(connection.late(REQUEST_MS) || connection.answers());
        answer(connection, Load::Rest, &mut fake, &facts, &mut memory);
    }
}

#[test]
fn every_step_fits_into_an_empty_piece() {
    // The longest names there can be, all of characters that take six bytes.
    let long = "\"".repeat(60);
    let all: Vec<(u8, u8, &str)> = (0..32)
        .flat_map(|n| [(6, n, long.as_str())])
        .chain((0..16).map(|n| (3, n, long.as_str())))
        .take(28)
        .collect();
    let mut fake = board(LARGEST, &all);
    let mut memory = vec![0; BYTES];
    logged(&mut memory, &"\u{1}".repeat(100));
    let status = json(&mut fake, Load::Moving, &mut memory);
    assert_eq!(status["inputs"][0]["name"].as_str().unwrap().len(), 40);
    assert_eq!(status["log"][0]["text"].as_str().unwrap().len(), 100);
}
