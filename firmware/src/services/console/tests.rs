use super::ask::hex_words;
use super::*;
use crate::cores::Ident;
use crate::fake::{ABI, BOOT, CLOCK, Notebook, Rig};
use crate::machine::{Lease, Machine};
use crate::net::Us;
use crate::server::Server;
use crate::services::telnet::{DO, ECHO, IAC, WILL};
use ::jobs::Outside;
use proptest::prelude::*;
use std::vec::Vec;
use wire::describe::Channels;
use wire::map::BoardConfig;
use wire::{MAX_WORDS, Refusal, map};

/// The board as the services see it, and how many words the last turn asked for.
struct ModelRom {
    machine: Machine<Notebook>,
    words: usize,
    datagrams: usize,
}

impl Outside for ModelRom {
    fn datagram(&mut self, request: &[u32], reply: &mut [u32; MAX_WORDS]) -> usize {
        self.datagrams += 1;
        self.words += request.len() - 4;
        let answer = self.machine.inside(request, reply, Machine::hold_path);
        answer.map_or(0, <[u32]>::len)
    }
    fn read_segments(&mut self, _: usize) -> u32 {
        0
    }
    fn write_segments(&mut self, _: usize, _: u32) {
        panic!("a console moved something");
    }
    fn now(&mut self) -> u64 {
        self.machine.board.now
    }
}

impl Network for ModelRom {
    fn send_frame(&mut self, _: &[u8]) {}
    fn us(&mut self) -> Us {
        self.machine.us
    }
    fn leased(&mut self, _: Option<Lease>) {}
    fn console(&mut self, visitor: usize, verb: Verb, words: &mut [u32; VISIT_WORDS]) -> Verdict {
        self.machine.visit(visitor, verb, words)
    }
}

/// A board with three consoles.
struct Bench {
    rom: ModelRom,
    reader: Reader,
    consoles: [Console; 3],
}

impl Bench {
    /// As it starts.
    fn new() -> Self {
        Bench::with(*Rig::new().server.ident())
    }

    fn with(ident: Ident) -> Self {
        let mut rom = ModelRom {
            machine: Machine::start(Notebook::new(), ident, ABI, BOOT),
            words: 0,
            datagrams: 0,
        };
        let (_, board) = ::jobs::inside::Inside::new(&mut rom).expect("it describes itself");
        Bench {
            rom,
            reader: Reader::new(board.channels, board.clock_hz),
            consoles: Default::default(),
        }
    }

    /// As a host has left it.
    fn of(rig: Rig) -> Self {
        let mut bench = Bench::with(*rig.server.ident());
        (bench.rom.machine.server, bench.rom.machine.board) = (rig.server, rig.board);
        // The loop does it behind each answer.
        bench.rom.machine.hold_path();
        bench
    }

    /// One turn of a console: the bytes it took and its text.
    fn turn(&mut self, visitor: usize, bytes: &[u8]) -> (usize, String, bool) {
        (self.rom.words, self.rom.datagrams) = (0, 0);
        let mut text = Text::new();
        let mut visit = Visit {
            visitor,
            reader: &mut self.reader,
            jobs: None,
            out: &mut self.rom,
        };
        let taken = self.consoles[visitor].turn(bytes, &mut visit, &mut text);
        assert!(self.rom.datagrams <= 1 && self.rom.words <= Reader::WORDS);
        assert!(text.bytes().len() <= PIECE_MAX, "{}", text.bytes().len());
        let said = text.bytes().iter().map(|byte| char::from(*byte)).collect();
        (taken, said, text.close)
    }

    /// All that a console answers to these bytes.
    fn hear(&mut self, visitor: usize, mut bytes: &[u8]) -> String {
        let mut heard = String::new();
        while self.consoles[visitor].busy() || !bytes.is_empty() {
            let busy = self.consoles[visitor].busy();
            let (taken, said, _) = self.turn(visitor, if busy { &[] } else { bytes });
            assert!(busy || taken > 0, "it takes no byte");
            bytes = &bytes[taken..];
            heard.push_str(&said);
        }
        heard
    }

    /// The answer to a line, without the prompts.
    fn say(&mut self, line: &str) -> String {
        let heard = self.hear(0, format!("{line}\n").as_bytes());
        heard.replace(PROMPT, "")
    }
}

fn said(line: &str) -> String {
    Bench::new().say(line)
}

#[test]
fn a_client_is_greeted_answered_and_let_go() {
    let mut bench = Bench::new();
    assert_eq!(bench.turn(0, b"net\n"), (0, PROMPT.to_owned(), false));
    let heard = bench.hear(0, b"\r\npwm 1\r\nquit\r\n");
    assert_eq!(
        heard,
        format!("{PROMPT}1: period 0 clocks, mode 0x00000000\r\n{PROMPT}bye\r\n")
    );
    assert_eq!(bench.turn(0, b"net\n"), (4, String::new(), false));
    let mut bench = Bench::new();
    bench.turn(0, &[]);
    bench.turn(0, b"quit\n");
    assert!(bench.turn(0, &[]).2, "it hangs up");
}

#[test]
fn the_board_states_its_name_its_image_and_its_link_speed() {
    let text = said("flash");
    assert!(
        text.contains("volatile") && text.contains("golden"),
        "{text}"
    );
    let text = said("settings");
    assert!(text.contains("from     built in\r\n"), "{text}");
    assert!(text.contains("address  192.168.2.50:1234, static 192.168.2.50:1234, /24\r\n"));
    assert!(
        text.contains("mac      00000299 3fca88c5\r\nkey      none\r\n"),
        "{text}"
    );
    assert!(said("link").starts_with("link down\r\nmac: no slot "));
    assert!(said("net").starts_with("address 192.168.2.50:1234\r\nframes in 0, out 0"));
}

#[test]
fn status_says_what_the_board_is_doing() {
    let text = said("status");
    let lines: Vec<&str> = text.lines().collect();
    assert_eq!(lines.len(), 10, "{text}");
    assert!(lines[0].starts_with("state    disarmed, reason "));
    assert_eq!(lines[1], "gate     closed, positions trusted");
    assert_eq!(lines[2], "session  free");
    assert_eq!(lines[3], "clock    60000000 Hz, now 0x00000000000003e8");
    assert_eq!(lines[4], "abi      firmware ab1ab1ab, gateware ab1ab1ab");
    assert!(lines[5].ends_with(", gateware 00000100"), "{text}");
    assert_eq!(lines[6], "boot     00000009, reboot requested");
    let calls = "longest call 0 clocks while a host moved the machine, 0 else";
    assert_eq!(
        lines[7],
        format!("services none: no SDRAM is used, {calls}")
    );
    let why = "why last: no exchange took it";
    assert_eq!(
        lines[8],
        format!("exchange 0 the fast way, 0 the long way, {why}")
    );
    assert_eq!(lines[9], "stack    100 of 100 bytes");
    let mut rig = Rig::new();
    rig.acquire();
    let text = Bench::of(rig).say("status");
    assert!(
        text.contains("session  192.168.2.1:40000, last sequence 0\r\n"),
        "{text}"
    );
}

#[test]
fn status_says_which_way_the_exchanges_took_and_why_the_last_one_was_long() {
    let mut bench = Bench::new();
    for why in wire::LongWay::ALL {
        let counters = bench.rom.machine.server.counters_mut();
        (counters.ways, counters.long_way) = ([u32::MAX, 12], why);
        let text = bench.say("status");
        let line = text.lines().find(|line| line.starts_with("exchange "));
        let wanted = format!(
            "exchange 4294967295 the fast way, 12 the long way, why last: {}",
            why.text()
        );
        assert_eq!(line, Some(wanted.as_str()));
    }
}

#[test]
fn a_stack_of_many_unused_parts_is_looked_at_part_by_part() {
    let mut rig = Rig::new();
    rig.board.free_stack = 5;
    let text = Bench::of(rig).say("status");
    assert!(text.contains("stack    100 of 10340 bytes\r\n"), "{text}");
}

#[test]
fn refusals_are_told_by_reason() {
    let mut bench = Bench::new();
    bench.rom.machine.refuse(Refusal::ALL[0]);
    for _ in 0..3 {
        bench.rom.machine.refuse(*Refusal::ALL.last().unwrap());
    }
    let text = bench.say("net");
    assert!(text.contains("; refused 4\r\n"), "{text}");
    let counted: Vec<&str> = text.lines().filter(|line| line.starts_with("  ")).collect();
    let last = Refusal::ALL.last().unwrap().key();
    let wanted = [
        format!("  {} 1", Refusal::ALL[0].key()),
        format!("  {last} 3"),
    ];
    assert_eq!(counted, wanted);
}

#[test]
fn a_restart_needs_a_machine_at_rest_without_an_owner() {
    let mut bench = Bench::of(Rig::armed());
    assert_eq!(bench.say("restart"), "refused: the machine is armed\r\n");
    let mut rig = Rig::new();
    rig.acquire();
    let mut bench = Bench::of(rig);
    assert_eq!(bench.say("restart"), "refused: a host drives the board\r\n");
    assert!(!bench.rom.machine.server.wants_restart());
    assert_eq!(said("restart 1"), "? try help\r\n");
    let mut bench = Bench::new();
    assert_eq!(bench.say("restart"), "restarting\r\n");
    assert!(bench.rom.machine.server.wants_restart());
}

#[test]
fn a_board_with_a_key_restarts_for_a_friend_only_and_shows_itself_to_all() {
    const KEY: [u32; 4] = [5, 6, 7, 8];
    let mut bench = Bench::new();
    assert!(
        bench.say("login").starts_with("challenge 00000000"),
        "none is needed"
    );
    bench.rom.machine.server.auth.lock(KEY);
    assert!(bench.say("status").contains("disarmed"));
    assert!(bench.say("settings").contains("key      set"));
    let refused = "refused: the board has a key; use `ferrocnc console`\r\n";
    assert_eq!(bench.say("restart"), refused);
    for (key, said) in [
        ([5, 6, 7, 9], "refused: wrong answer\r\n"),
        (KEY, "welcome\r\n"),
    ] {
        let asked = bench.say("login");
        let (digits, uid) = asked.trim().strip_prefix(CHALLENGE).unwrap().split_at(32);
        assert_eq!(uid.len(), 16);
        let head = wire::auth::Purpose::Login.head(hex_words(digits).unwrap());
        let tag = crate::auth::tag(&key, &head, &[]);
        let tag: String = tag.iter().map(|word| format!("{word:08x}")).collect();
        assert_eq!(bench.say(&format!("login {tag}")), said);
    }
    let counters = bench.rom.machine.server.counters();
    assert_eq!(counters.refused[Refusal::Key.index()], 1);
    // The others are strangers.
    assert!(
        bench
            .hear(1, b"restart\n")
            .ends_with(&format!("{refused}{PROMPT}"))
    );
    assert_eq!(bench.say("restart"), "restarting\r\n");
    for wrong in ["login 12", "login x", &format!("login {}", "0".repeat(33))] {
        assert_eq!(bench.say(wrong), "? try help\r\n", "{wrong}");
    }
}

const LOOKS: [&str; 24] = [
    "help",
    "status",
    "net",
    "regs",
    "regs 14",
    "regs 200",
    "regs 255",
    "stepgen",
    "stepgen 5",
    "stepgen 6",
    "encoder",
    "encoder 5",
    "encoder 255",
    "pwm",
    "pwm 7",
    "gpio",
    "watchdog",
    "log",
    "link",
    "flash",
    "settings",
    "job",
    "",
    "nonsense",
];

#[test]
fn every_look_is_the_same_while_a_host_moves_the_machine_and_changes_nothing() {
    for line in LOOKS {
        let mut bench = Bench::of(Rig::armed());
        let before = bench.rom.machine.board.changes();
        let told = |server: &Server| {
            format!(
                "{:?} {:?} {:?}",
                server.session(),
                server.safety(),
                server.counters()
            )
        };
        let state = told(&bench.rom.machine.server);
        let text = bench.say(line);
        assert_eq!(bench.rom.machine.board.changes(), before, "{line}");
        assert_eq!(told(&bench.rom.machine.server), state, "{line}");
        assert!(
            text.is_ascii() && text.replace("\r\n", "").find(['\r', '\n']).is_none(),
            "{line}: {text:?}"
        );
        assert!(!text.contains("not while armed"), "{line}: {text}");
        let rest = said(line);
        assert_eq!(
            text.lines().count(),
            rest.lines().count(),
            "{line}: {text}\n{rest}"
        );
    }
    let mut bench = Bench::of(Rig::armed());
    assert!(bench.say("status").contains("state    armed"));
    assert_eq!(bench.say("login"), "? not while armed\r\n");
}

#[test]
fn the_channels_are_told_as_the_host_reads_them() {
    assert_eq!(said("help").lines().count(), HELP.len());
    assert_eq!(said("stepgen").lines().count(), 6);
    assert_eq!(said("stepgen 6"), "");
    let text = said("stepgen 5");
    assert!(
        text.starts_with("5: 4120 steps, 57 steps/s, latch 4213\r\n    steplen 300\r\n"),
        "{text}"
    );
    assert!(
        text.ends_with("dirhold 1200\r\n    stop-accel 0\r\n    mode 0\r\n"),
        "{text}"
    );
    assert!(said("stepgen").starts_with("0: 4105 steps, 57 steps/s\r\n1: 4108 steps"));
    assert!(said("encoder").starts_with("0: 4152, latch 4192, errors 0, edge at 0x00001039\r\n"));
    assert!(said("encoder 5").ends_with("\r\n    mode 0x00000000, filter 0 clocks\r\n"));
    let watchdog = said("watchdog");
    assert!(
        watchdog.contains("e-stop idle\r\ngate closed last: never opened"),
        "{watchdog}"
    );
    assert!(
        watchdog.ends_with("timeout 5000 us, left 5000 us\r\n"),
        "{watchdog}"
    );
    assert!(said("gpio").contains("inputs 0x00001002, e-stop latched 0x00001006"));
    assert_eq!(said("pwm").lines().count(), 6);
    assert_eq!(said("regs 14").lines().count(), 4);
    assert_eq!(said("regs 200"), "", "no page");
    assert_eq!(said("regs").lines().count(), 8);
    assert!(said("regs 15").starts_with("f0007800 00001000 00001001 "));
    assert!(said("rm -rf").contains("try help"));
}

#[test]
fn the_probe_is_told_by_its_input() {
    let mut bench = Bench::new();
    let probe = crate::cores::Setting::Board(BoardConfig::Probe);
    for (value, text) in [
        (5, "probe none\r\n"),
        (map::PROBE_ENABLE | 5, "probe input 5\r\n"),
        (
            map::PROBE_ENABLE | map::PROBE_INVERT | 5,
            "probe input 5, active low\r\n",
        ),
    ] {
        crate::cores::Board::set(&mut bench.rom.machine.board, probe, value);
        let said = bench.say("gpio");
        assert!(said.ends_with(text), "{said}");
    }
}

#[test]
fn the_last_obituary_is_told_whole() {
    for length in [0, 1, 27, 28, 29, 56, 255, 256] {
        let mut bench = Bench::new();
        let text: String = ('!'..='~').cycle().take(length).collect();
        bench
            .rom
            .machine
            .board
            .record
            .die(wire::ResetReason::Panic, |out| {
                out.text(&text);
            });
        let said = bench.say("log");
        let last = said.lines().nth(2).unwrap_or("");
        assert_eq!(last, text, "{said}");
        assert_eq!(said.lines().count(), if length == 0 { 2 } else { 3 });
    }
}

#[test]
fn the_largest_board_is_answered_in_pieces() {
    let sixteen = Channels {
        stepgens: 16,
        encoders: 16,
        pwms: 16,
        inputs: 64,
        outputs: 64,
    };
    for line in LOOKS {
        let mut rig = Rig::with_channels(sixteen);
        rig.board.latched.fill(0x8000_0001);
        let text = Bench::of(rig).say(line);
        let counted = matches!(line, "stepgen" | "encoder" | "pwm");
        assert!(!counted || text.lines().count() == 16, "{text}");
        assert!(line != "gpio" || text.contains(", from 32 on 0x"), "{text}");
    }
}

#[test]
fn a_board_without_jobs_says_so() {
    let refused = "no jobs here; `ferrocnc describe` says why\r\n";
    assert_eq!(said("job"), refused);
    assert_eq!(said("job list"), refused);
    assert_eq!(said("job start x"), refused);
}

#[test]
fn a_line_is_a_command_with_at_most_one_number() {
    for (line, ask) in [
        ("status", Ask::Status),
        ("  stepgen   3 ", Ask::Stepgen(Some(3))),
        ("stepgen", Ask::Stepgen(None)),
        ("encoder 255", Ask::Encoder(Some(255))),
        ("regs 14", Ask::Regs(Some(14))),
        ("", Ask::Nothing),
        ("  job start my part 2", Ask::Job),
        ("exit", Ask::Quit),
    ] {
        assert_eq!(Ask::parse(line), ask, "{line}");
    }
    for garbage in [
        "reboot",
        "stepgen 256",
        "stepgen -1",
        "status 1",
        "stepgen 1 2",
        "jobs",
        "set x",
        "\u{e9} 1",
    ] {
        assert_eq!(Ask::parse(garbage), Ask::Unknown, "{garbage}");
    }
}

#[test]
fn a_line_that_is_too_long_is_dropped_whole_and_the_next_one_is_answered() {
    let heard = said(&format!("{}\nwatchdog", "x".repeat(5000)));
    assert!(
        heard.starts_with("? a line has at most 64 characters\r\nasleep"),
        "{heard}"
    );
}

#[test]
fn a_telnet_client_sees_what_it_types_and_finds_its_lines_again() {
    let mut bench = Bench::new();
    bench.turn(0, &[]);
    let first = [IAC, DO, 3, IAC, DO, ECHO];
    let offer: String = [IAC, WILL, 1, IAC, WILL, 3]
        .map(char::from)
        .iter()
        .collect();
    assert_eq!(bench.hear(0, &first), offer);
    let answer = "0: period 0 clocks, mode 0x00000000\r\nferrocnc> ";
    assert_eq!(bench.hear(0, b"pwn 0\x7f\x7f\x7fm 0\r\0"), {
        let back = "\x08\x1b[K".repeat(3);
        format!("pwn 0{back}m 0\r\n{answer}")
    });
    assert_eq!(
        bench.hear(0, b"\x1b[A\r\0"),
        format!("pwm 0\x1b[K\r\n{answer}")
    );
    assert_eq!(bench.hear(0, b"x\x03"), format!("x^C\r\n{PROMPT}"));
    assert_eq!(bench.hear(0, b"\x04"), "\r\nbye\r\n");
}

#[test]
fn the_next_client_finds_nothing_of_its_predecessor() {
    let mut bench = Bench::new();
    bench.hear(0, &[IAC, DO, ECHO]);
    bench.hear(0, b"pwm 0\r\0net");
    bench.consoles[0].open();
    assert_eq!(bench.turn(0, &[]).1, PROMPT);
    let heard = bench.hear(0, b"\x1b[A\x10\n");
    assert_eq!(heard, PROMPT, "no echo, no line, none kept");
}

#[test]
fn three_clients_are_answered_between_each_others_lines() {
    let mut bench = Bench::new();
    let alone: Vec<String> = ["help", "stepgen", "status"].map(said).to_vec();
    let lines: [&[u8]; 3] = [b"help\n", b"stepgen\n", b"status\n"];
    let mut heard = [(); 3].map(|()| String::new());
    let mut left = lines;
    while (0..3).any(|n| bench.consoles[n].busy() || !left[n].is_empty()) {
        for n in 0..3 {
            let busy = bench.consoles[n].busy();
            let (taken, said, _) = bench.turn(n, if busy { &[] } else { left[n] });
            left[n] = &left[n][taken..];
            heard[n].push_str(&said);
        }
    }
    for (heard, alone) in heard.iter().zip(&alone) {
        assert_eq!(&heard.replace(PROMPT, ""), alone);
    }
    assert_eq!(bench.reader.clock_hz, CLOCK);
}

proptest! {
    #[test]
    fn no_bytes_break_a_console_or_change_the_board(
        bytes in prop::collection::vec(prop_oneof![any::<u8>(), Just(b'\n'), Just(IAC)], 0..300)
    ) {
        let mut bench = Bench::of(Rig::armed());
        let before = bench.rom.machine.board.changes();
        bench.hear(0, &bytes);
        prop_assert_eq!(bench.rom.machine.board.changes(), before);
    }
}
