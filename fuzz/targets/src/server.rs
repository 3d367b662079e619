//! A whole board with datagrams of good and bad hosts, time, and changes at its pins.
//!
//! The input is a script of steps: one byte for the kind, then the bytes the step needs. After
//! every step:
//!
//! * a refused datagram has changed nothing, and neither has one that only reads;
//! * the machine is armed only in the one legal way: session, `enable`, an edge of `enable-request`
//!   after it was seen low, a fresh command after that, no active pin;
//! * no pulse leaves while the gate is closed;
//! * the gate is open only while the machine is armed or stops;
//! * answers are packets.

use crate::byte_reader::{ByteReader, words};
use crate::watched::{self, Deeds, Inside, Watched};
use firmware::cores::Board;
use firmware::machine::{Guest, Lease, Machine};
use firmware::services::console::{Console, PIECE_MAX, Reader, Visit};
use firmware::session::Peer;
use firmware::text::Text;
use std::sync::atomic::Ordering::Relaxed;
use wire::describe::Channels;
use wire::etherbone::Record;
use wire::exchange::{Command, REQUEST_OVERHEAD, Status};
use wire::units::{Accel, Velocity};
use wire::{MAX_WORDS, Packet, Refusal, State, etherbone, map};

/// Longer scripts add nothing.
const STEPS: usize = 200;
/// At most a third of a simulated second: simulated time is expensive here.
const CLOCKS: u64 = 20_000_000;

/// The host, another program on it, and another host.
const PEERS: [Peer; 3] = [
    Peer {
        ip: 0xc0a8_0201,
        port: 40_000,
    },
    Peer {
        ip: 0xc0a8_0201,
        port: 40_001,
    },
    Peer {
        ip: 0xc0a8_0203,
        port: 40_000,
    },
];

/// The phases of `enable-request` in this session, in the words of the design.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Seen {
    Nothing,
    Low,
    Edge,
    Used,
}

/// A board and its observer.
pub struct Bench {
    /// The board.
    pub machine: Machine<Watched>,
    seen: Seen,
    state: State,
    sequence: u32,
    clocks: u64,
    /// What happened, for the message of a failure.
    story: Vec<String>,
}

/// A datagram, and what the server made of it.
struct Served<'w> {
    peer: Peer,
    words: &'w [u32],
    answer: Result<Vec<u32>, Refusal>,
    deeds: Deeds,
    /// The owner before it.
    owner: Option<Peer>,
    before: State,
    state: State,
}

impl Served<'_> {
    /// It was executed; the owner after it.
    fn executed(&self, reply: &[u32], story: &[String]) -> Option<Peer> {
        let deeds = self.deeds;
        let packet = Packet::new_checked(self.words)
            .unwrap_or_else(|why| panic!("executed though {why:?}\n{story:#?}"));
        let writes = packet.records().any(|record| !record.writes.is_empty());
        if !writes {
            assert_eq!(deeds, Default::default(), "reading did that\n{story:#?}");
            assert_eq!(self.before, self.state, "reading did that\n{story:#?}");
        }
        if !reply.is_empty() && !packet.is_probe() {
            let answer = Packet::new_checked(reply);
            assert!(answer.is_ok(), "the answer is {answer:?}\n{story:#?}");
        }
        if writes && self.owner.is_none_or(|owner| owner != self.peer) {
            // Another client's datagram that has an effect must have acquired the session first.
            let acquires = packet
                .records()
                .any(|record| writes_to(&record, map::SESSION_ACQUIRE));
            let free = self.owner.is_none();
            assert!(free, "another client's write was executed\n{story:#?}");
            let only_flash = deeds.commits + deeds.fed + deeds.written + deeds.armed == 0;
            assert!(
                acquires || only_flash,
                "without a session: {deeds:?}\n{story:#?}"
            );
            return acquires.then_some(self.peer);
        }
        self.owner
    }

    /// The command in it.
    fn command(&self, channels: Channels) -> Option<Command> {
        let packet = Packet::new_checked(self.words).ok()?;
        let record = packet.records().next()?;
        (record.write_base == map::COMMAND && !packet.is_probe())
            .then(|| Command::parse(record.writes, channels).ok())?
    }
}

/// Runs a script.
pub fn server(data: &[u8]) {
    script(data);
}

/// Runs a script; returns the board in its final state.
pub fn script(data: &[u8]) -> Bench {
    let mut bench = Bench::new();
    let mut input = ByteReader(data);
    for _ in 0..STEPS {
        if input.is_over() || bench.clocks > CLOCKS {
            break;
        }
        bench.step(&mut input);
    }
    bench
}

impl Default for Bench {
    fn default() -> Self {
        Self::new()
    }
}

impl Bench {
    /// A board that was just switched on.
    pub fn new() -> Self {
        let machine = watched::start();
        Bench {
            state: machine.server.safety().state(),
            machine,
            seen: Seen::Nothing,
            sequence: 0,
            clocks: 0,
            story: Vec::new(),
        }
    }

    fn step(&mut self, input: &mut ByteReader) {
        let step = input.byte();
        let peer = PEERS[usize::from(step >> 4) % PEERS.len()];
        match step & 15 {
            0 => self.datagram(peer, &words(input.many())),
            1 => self.write(peer, map::SESSION_ACQUIRE, input.byte().into()),
            2 | 3 => self.exchange(peer, input),
            4 => {
                let clocks = 1u64 << (input.byte() % 24);
                self.pass(clocks);
            }
            5 => {
                let [class, channel, field] = input.array();
                let base = [
                    map::CONFIG_STEPGEN,
                    map::CONFIG_ENCODER,
                    map::CONFIG_PWM,
                    map::CONFIG_BOARD,
                    map::CONFIG_DEBOUNCE,
                ][usize::from(class) % 5];
                let at = u32::from(channel % 20) * map::CONFIG_STRIDE + 4 * u32::from(field % 8);
                self.write(peer, base + at, input.word());
            }
            6 => {
                let [pins, inputs, link] = input.array();
                let environment = self.machine.board.model_board.environment();
                environment.ext_reset(pins & 1 != 0);
                environment.gpio_in(u64::from(inputs) << (pins >> 4));
                environment.link(if pins & 2 != 0 { link & 15 } else { 0b1101 });
                self.pass(64);
            }
            7 => {
                let addresses = words(input.some());
                let mut buffer = [0; MAX_WORDS];
                let mut request = etherbone::ReplyWriter::new(&mut buffer, etherbone::HEADER);
                request.read_record(u32::from(input.byte()), &addresses);
                let request = request.words().to_vec();
                self.datagram(peer, &request);
            }
            8 => {
                let own = self.machine.server.session().token_for(peer);
                let token = if input.byte() & 1 == 0 {
                    own
                } else {
                    input.word()
                };
                self.write(peer, map::SESSION_RELEASE, token);
            }
            9 => {
                let (operation, address, length) = (input.byte(), input.word(), input.half());
                self.write(peer, map::FLASH_ADDRESS, address);
                self.write(peer, map::FLASH_OP_LENGTH, length.into());
                self.write(peer, map::FLASH_OP, u32::from(operation % 16));
            }
            10 => {
                let page = u32::from(input.byte()) * wire::regmap::CSR_PAGE as u32;
                let at = map::SERVICE + page + 4 * u32::from(input.byte());
                self.write(peer, at, input.word());
            }
            11 => self.discovery(input),
            12 => {
                let (ip, gateway) = (input.word(), input.word());
                let prefix = input.byte();
                let lease = Lease {
                    ip,
                    prefix,
                    gateway,
                };
                self.machine.leased((prefix != 0).then_some(lease));
                self.tell(|| "a DHCP server".to_owned());
                self.untouched();
            }
            13 => self.console(input.some()),
            14 => self.write(peer, input.word(), input.word()),
            _ => self.records(peer, input),
        }
        self.send_broadcasts();
        self.holds();
    }

    fn tell(&mut self, what: impl FnOnce() -> String) {
        if crate::EXPLAIN.load(Relaxed) {
            self.story.push(what());
        }
    }

    fn write(&mut self, peer: Peer, address: u32, value: u32) {
        let words = [etherbone::HEADER, 0, 0x000f_0100, address, value];
        self.datagram(peer, &words);
    }

    /// Several writes and reads in one datagram.
    fn records(&mut self, peer: Peer, input: &mut ByteReader) {
        let mut buffer = [0; MAX_WORDS];
        let mut packet = etherbone::ReplyWriter::new(&mut buffer, etherbone::HEADER);
        for _ in 0..input.byte() % 8 {
            let [kind, count] = input.array();
            let base = [
                map::SESSION_ACQUIRE,
                map::SESSION_RELEASE,
                map::CONFIG_STEPGEN,
                map::CONFIG_BOARD,
                map::FLASH_OP,
                map::COMMAND,
                map::SESSION_REBOOT,
                map::SERVICE,
            ][usize::from(kind) % 8];
            if kind & 8 != 0 {
                packet.read_record(base, &[base, base + 4]);
            } else {
                let count = count % 40;
                packet.write_record(base + 4 * u32::from(kind >> 4), count);
                for _ in 0..count {
                    packet.push(input.word());
                }
            }
        }
        let packet = packet.words().to_vec();
        self.datagram(peer, &packet);
    }

    /// A command block like a host's, with different errors.
    fn exchange(&mut self, peer: Peer, input: &mut ByteReader) {
        let [flags, ahead, velocities] = input.array();
        let session = self.machine.server.session();
        self.sequence = self.sequence.wrapping_add(1);
        let mut command = Command {
            token: session.token_for(peer),
            sequence: session.last_sequence().wrapping_add(match ahead {
                0..128 => 1,
                _ => ahead as i8 as u32,
            }),
            enable: flags & 1 != 0,
            enable_request: flags & 2 != 0,
            stepgen_enable: 0x3f,
            ..Command::default()
        };
        if flags & 4 != 0 {
            command.token ^= input.word();
        }
        if flags & 8 != 0 {
            command.apply_at = Some(wire::units::Clocks(
                self.machine.board.now() + u64::from(input.half()) * 16,
            ));
        }
        // At most 14 kHz: pulses are expensive, too.
        command.stepgen = [(
            Velocity(i32::from(velocities as i8) << 13),
            Accel::UNLIMITED,
        ); 16];
        let channels = watched::ident(&self.machine).channels;
        let mut buffer = [0; REQUEST_OVERHEAD + wire::exchange::COMMAND_MAX];
        let request = command.emit_request(channels, &mut buffer);
        let mut request = request.expect("it fits").to_vec();
        if flags & 16 != 0 {
            for _ in 0..input.byte() % 8 {
                let at = usize::from(input.byte()) % request.len();
                request[at] = input.word();
            }
        }
        if flags & 32 != 0 {
            request.truncate(usize::from(input.byte()));
        }
        self.datagram(peer, &request);
    }

    /// One datagram, and the properties that must hold after it.
    pub fn datagram(&mut self, peer: Peer, words: &[u32]) {
        let words = &words[..words.len().min(MAX_WORDS)];
        let machine = &mut self.machine;
        let channels = watched::ident(machine).channels;
        let owner = machine.server.session().owner();
        // A bite is noticed at the next look at the gate, which may be in this datagram.
        let undisturbed = machine.server.safety().running(machine.board.gate());
        let before = machine.server.safety().state();
        let refusals = machine.server.counters().refused_total;
        machine.board.take();
        let mut buffer = [0; MAX_WORDS];
        let answer = machine
            .datagram(words, peer, &mut buffer)
            .map(<[u32]>::to_vec);
        let deeds = machine.board.take();
        let state = machine.server.safety().state();
        self.tell(|| {
            format!("{peer:x?} {words:x?}: {answer:x?}, {deeds:?}, {before:?} -> {state:?}")
        });
        let story = &self.story;
        let counted = self
            .machine
            .server
            .counters()
            .refused_total
            .wrapping_sub(refusals);
        assert_eq!(
            counted,
            u32::from(answer.is_err()),
            "not counted\n{story:#?}"
        );
        let served = Served {
            peer,
            words,
            answer,
            deeds,
            owner,
            before,
            state,
        };
        let owner = match &served.answer {
            Err(why) => {
                assert!(
                    !deeds.took_effect(),
                    "refused for {why:?}, but {deeds:?}\n{story:#?}"
                );
                assert!(
                    state == before || !undisturbed,
                    "refused, but {before:?} became {state:?}\n{story:#?}"
                );
                owner
            }
            Ok(reply) => served.executed(reply, story),
        };
        self.armed_legally(&served, owner, channels);
        self.state = state;
        let owners = self.machine.server.session().is_owner(peer);
        if self.machine.due(self.machine.patience(owners)) {
            self.machine.housekeeping();
        }
        self.machine.board.take();
    }

    /// Behind a datagram of which `owner` owns the session: the machine is armed by a command only.
    fn armed_legally(&mut self, served: &Served, owner: Option<Peer>, channels: Channels) {
        let (story, words) = (&self.story, served.words);
        match (served.command(channels), &served.answer) {
            (Some(command), Ok(reply)) => {
                if !reply.is_empty() {
                    let status = Status::parse_reply(reply, channels);
                    let status =
                        status.unwrap_or_else(|why| panic!("a status {why:?}\n{story:#?}"));
                    assert_eq!(status.sequence, command.sequence, "{story:#?}");
                }
                assert_eq!(
                    owner,
                    Some(served.peer),
                    "another client's command was executed\n{story:#?}"
                );
                self.commanded(&command, served.before, served.state);
            }
            (Some(_) | None, Ok(_) | Err(_)) => {
                assert!(
                    served.state != State::Armed || served.before == State::Armed,
                    "armed without a command\n{story:#?}"
                );
                assert_eq!(served.deeds.armed, 0, "armed without a command\n{story:#?}");
                // Acquired, or released: an earlier low level does not count any more.
                if served.answer.is_ok() && words.len() > 2 && rewrote_session(words) {
                    self.seen = Seen::Nothing;
                }
            }
        }
    }

    /// The owner's command was accepted.
    fn commanded(&mut self, command: &Command, before: State, state: State) {
        let story = &self.story;
        if state == State::Armed && before != State::Armed {
            let pins = self.machine.board.gate();
            assert_eq!(self.seen, Seen::Edge, "armed without an edge\n{story:#?}");
            assert!(
                command.enable && command.enable_request,
                "armed by {command:?}\n{story:#?}"
            );
            assert!(!pins.pinned_now(), "armed with an active pin\n{story:#?}");
            assert_eq!(before, State::Disarmed, "{story:#?}");
        }
        let stopped = before == State::Armed && state != State::Armed;
        self.seen = match (self.seen, command.enable_request) {
            (_, _) if stopped => Seen::Nothing,
            (_, false) => Seen::Low,
            // An edge counts only where arming is possible: at rest.
            (Seen::Low, true) if state == State::Disarmed => Seen::Edge,
            (Seen::Low | Seen::Edge | Seen::Used, true) => Seen::Used,
            (Seen::Nothing, true) => Seen::Nothing,
        };
    }

    fn discovery(&mut self, input: &mut ByteReader) {
        let mut message = words(input.many());
        if let Some([.., body]) = message.split_first_chunk_mut::<6>().map(|(_, b)| [b])
            && let Some([settings @ .., crc]) = body.first_chunk_mut::<32>()
        {
            *crc = wire::crc::crc32_words(settings);
        }
        let owned = self.machine.server.session().owner().is_some();
        let mut buffer = [0; MAX_WORDS];
        let answer = self.machine.discover(&message, 50_000, &mut buffer);
        if !answer.is_empty() {
            let parsed = wire::discovery::Message::parse(answer);
            assert!(parsed.is_ok(), "{parsed:?} of {message:x?}");
        }
        let deeds = self.machine.board.take();
        assert!(
            !(owned && deeds.took_effect()),
            "an owned board executed {message:x?}: {deeds:?}"
        );
        self.tell(|| format!("discovery {message:x?}: {deeds:?}"));
    }

    fn untouched(&mut self) {
        let deeds = self.machine.board.take();
        let story = &self.story;
        assert_eq!(deeds, Default::default(), "{story:#?}");
    }

    fn console(&mut self, bytes: &[u8]) {
        type_in(&mut self.machine, bytes);
        self.tell(|| format!("console {:?}", String::from_utf8_lossy(bytes)));
        self.untouched();
    }

    fn pass(&mut self, clocks: u64) {
        let gate = self.machine.board.gate();
        let pulses = self.machine.board.model_board.environment().edges.pulses();
        self.clocks += clocks;
        watched::pass(&mut self.machine, clocks, (clocks / 60_000).clamp(1, 8));
        let now = self.machine.board.model_board.environment().edges.pulses();
        self.tell(|| format!("{clocks} clocks"));
        let story = &self.story;
        assert!(
            gate.open() || pulses == now,
            "pulses through a closed gate\n{story:#?}"
        );
        let deeds = self.machine.board.take();
        assert_eq!(
            (deeds.armed, deeds.fed, deeds.written),
            (0, 0, 0),
            "time did that\n{story:#?}"
        );
    }

    fn send_broadcasts(&mut self) {
        for _ in 0..4 {
            if !self.machine.has_broadcast() {
                break;
            }
            let mut buffer = [0; MAX_WORDS];
            if let Some(broadcast) = self.machine.next_broadcast(&mut buffer) {
                assert!(broadcast.words <= MAX_WORDS && broadcast.words > 0);
            }
            self.machine.moved();
        }
        self.machine.board.take();
    }

    /// The properties that always hold.
    fn holds(&mut self) {
        let story = &self.story;
        let machine = &mut self.machine;
        let (gate, state) = (machine.board.gate(), machine.server.safety().state());
        let live = matches!(state, State::Armed | State::Stopping);
        assert!(
            live || !gate.open(),
            "{state:?} and the gate is open\n{story:#?}"
        );
        if state != State::Armed && self.state == State::Armed {
            self.seen = Seen::Nothing;
        }
        self.state = state;
        let owner = machine.server.session().owner();
        assert!(
            state != State::Armed || owner.is_some(),
            "armed without an owner\n{story:#?}"
        );
        if owner.is_none() {
            self.seen = Seen::Nothing;
        }
    }
}

/// Does it contain a word for this address?
fn writes_to(record: &Record, address: u32) -> bool {
    (0..record.writes.len() as u32).any(|n| record.write_base.wrapping_add(4 * n) == address)
}

/// Did this change the session's owner? Other words in the session's bank do not: a response
/// without a challenge is accepted and ignored.
fn rewrote_session(words: &[u32]) -> bool {
    Packet::new_checked(words).is_ok_and(|packet| {
        packet.records().any(|record| {
            writes_to(&record, map::SESSION_ACQUIRE) || writes_to(&record, map::SESSION_RELEASE)
        })
    })
}

/// Bytes of a client of a console. A turn's text is not longer than it may be, and does not disturb
/// a terminal: what it sends beside text are the keys' echo and telnet's answers.
fn type_in(machine: &mut Machine<Watched>, mut bytes: &[u8]) {
    let ident = *watched::ident(machine);
    let mut reader = Reader::new(ident.channels, ident.clock_hz);
    let mut console = Console::new();
    let mut outer = Inside {
        machine: Guest::of(machine),
        sent: Vec::new(),
    };
    let mut text = Text::new();
    while !text.close && (console.busy() || !bytes.is_empty()) {
        text.clear();
        let busy = console.busy();
        let mut visit = Visit {
            visitor: 0,
            reader: &mut reader,
            jobs: None,
            out: &mut outer,
        };
        let taken = console.turn(if busy { &[] } else { bytes }, &mut visit, &mut text);
        assert!(busy || taken > 0, "it takes no byte");
        bytes = &bytes[taken..];
        let said = text.bytes();
        assert!(said.len() <= PIECE_MAX, "{} bytes", said.len());
        let plain = |byte: &u8| matches!(byte, b' '..=b'~' | b'\r' | b'\n');
        assert!(!busy || said.iter().all(plain), "{said:?}");
    }
}

thread_local! {
    static CONSOLE: std::cell::RefCell<Option<Bench>> = const { std::cell::RefCell::new(None) };
}

/// Bytes of a client of the console: lines or telnet's own bytes, answers that fit, and no effect
/// on the board.
pub fn console(data: &[u8]) {
    // No console line changes the board, which is asserted: so one board is enough for all inputs.
    let mut bench = CONSOLE.take().unwrap_or_default();
    type_in(&mut bench.machine, data);
    bench.untouched();
    CONSOLE.set(Some(bench));
}
