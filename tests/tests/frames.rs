//! Raw frames into the MAC of the Verilated board, including frames that no stack would send. None
//! of them arms the machine, writes a register or makes the next frame be lost, and every one of
//! them is counted.

use ferrocnc_tests::flood::{INTRUDER_IP, KINDS, Kind, bare, checksum, read_of, tcp_segment};
use ferrocnc_tests::{BenchMachine, seed, wired};
use rand::seq::IndexedRandom;
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;
use sim::gmii;
use wire::board::crc32;
use wire::map;

/// Mutated frames; `FERROCNC_FRAMES` says another number.
const FRAMES: usize = 8_000;
/// Clocks a frame gets to itself: less than many take, so that all slots are full now and then.
const PACE: u64 = 2_500;
/// Frames between two looks at the registers.
const BATCH: usize = 1_000;

/// The byte at which an IP header begins, and the UDP header after one without options.
const IP: usize = 14;
const UDP: usize = 34;

/// Makes the IP header's checksum right, and says there is none for UDP.
fn sealed(mut frame: Vec<u8>) -> Vec<u8> {
    let words = usize::from(frame.get(IP).copied().unwrap_or(0) & 15);
    let end = IP + 4 * words;
    if words >= 5 && frame.len() >= end {
        frame[IP + 10..IP + 12].fill(0);
        let sum = checksum(&[&frame[IP..end]]);
        frame[IP + 10..IP + 12].copy_from_slice(&sum);
        if frame.len() >= end + 8 && frame[IP + 9] == 17 {
            frame[end + 6..end + 8].fill(0);
        }
    }
    frame
}

fn with(frame: &[u8], at: usize, bytes: &[u8]) -> Vec<u8> {
    let mut frame = frame.to_vec();
    frame[at..at + bytes.len()].copy_from_slice(bytes);
    frame
}

/// Sends a frame as it is and waits; how many datagrams came back.
fn answers(machine: &mut BenchMachine, wire: Vec<u8>) -> usize {
    machine.inject(wire);
    machine.run_clocks(40_000);
    machine.datagrams()
}

/// What is said of a frame, the frame, and how many answers it has; `good` says nothing wrong.
fn claims(good: &[u8]) -> Vec<(&'static str, Vec<u8>, usize)> {
    let length = good.len() as u16 - 14;
    let vlan = [&good[..12], &[0x81, 0, 0, 5], &good[12..]].concat();
    let mut options = [&good[..UDP], &[1; 40], &good[UDP..]].concat();
    options[IP] = 0x4f;
    options[IP + 2..IP + 4].copy_from_slice(&(length + 40).to_be_bytes());
    let mut long = good.to_vec();
    long.resize(200, 0);
    vec![
        ("as it should be", good.to_vec(), 1),
        ("ten words of IP options", sealed(options.clone()), 1),
        ("no UDP checksum", sealed(good.to_vec()), 1),
        ("padded to Ethernet's minimum", good.to_vec(), 1),
        ("a wrong IP checksum", with(good, IP + 10, &[0xde, 0xad]), 0),
        (
            "a wrong UDP checksum",
            with(good, UDP + 6, &[0xde, 0xad]),
            0,
        ),
        (
            "options that are not there",
            sealed(with(good, IP, &[0x4f])),
            0,
        ),
        ("an IP header of four words", with(good, IP, &[0x44]), 0),
        ("IP version 6", sealed(with(good, IP, &[0x65])), 0),
        (
            "IP says it is longer",
            sealed(with(good, IP + 2, &(length + 4).to_be_bytes())),
            0,
        ),
        (
            "IP says it is shorter",
            sealed(with(good, IP + 2, &(length - 4).to_be_bytes())),
            0,
        ),
        (
            "IP says 65535",
            sealed(with(good, IP + 2, &[0xff, 0xff])),
            0,
        ),
        ("IP says 0", sealed(with(good, IP + 2, &[0, 0])), 0),
        (
            "UDP says it is longer",
            sealed(with(good, UDP + 4, &[0xff, 0xff])),
            0,
        ),
        ("UDP says 7", sealed(with(good, UDP + 4, &[0, 7])), 0),
        (
            "a first fragment",
            sealed(with(good, IP + 6, &[0x20, 0])),
            0,
        ),
        ("a last fragment", sealed(with(good, IP + 6, &[0, 1])), 0),
        (
            "the reserved flag",
            sealed(with(good, IP + 6, &[0x80, 0])),
            0,
        ),
        ("a VLAN's tag", vlan, 0),
        ("EtherType IPv6", with(good, 12, &[0x86, 0xdd]), 0),
        ("EtherType ARP", with(good, 12, &[0x08, 0x06]), 0),
        (
            "a length for an EtherType",
            with(good, 12, &[0x00, 0x2e]),
            0,
        ),
        (
            "another board's MAC address",
            with(good, 0, &[2, 0, 0, 0, 0, 7]),
            0,
        ),
        ("the broadcast MAC address", with(good, 0, &[0xff; 6]), 0),
        (
            "another board's IP address",
            sealed(with(good, IP + 19, &[51])),
            0,
        ),
        ("another port", sealed(with(good, UDP + 2, &[4, 0xd3])), 0),
        ("a hundred bytes more than it says", long, 0),
    ]
}

#[test]
fn a_frame_that_lies_about_itself_is_not_answered_and_one_that_does_not_is() {
    let mut machine = BenchMachine::start();
    let good = machine.plain_read();
    let before = machine.registers();
    for (what, frame, expected) in claims(&good) {
        assert_eq!(
            answers(&mut machine, gmii::encode(&frame)),
            expected,
            "{what}"
        );
    }
    for length in [0, 1, 3, 4, 5, 13, 14, 15, 33, 41] {
        assert_eq!(
            answers(&mut machine, bare(&good[..length])),
            0,
            "a runt of {length} bytes"
        );
        assert_eq!(
            answers(&mut machine, gmii::encode(&good)),
            1,
            "and the frame behind it"
        );
    }
    for length in [1515, 1530, 1531, 1536, 2000, 9018] {
        let mut jumbo = good.clone();
        jumbo.resize(length, 0);
        assert_eq!(
            answers(&mut machine, bare(&jumbo)),
            0,
            "a jumbo of {length} bytes"
        );
        assert_eq!(
            answers(&mut machine, gmii::encode(&good)),
            1,
            "and the frame behind it"
        );
    }
    assert_eq!(machine.registers(), before);
}

#[test]
fn a_runt_costs_no_other_frame_whether_or_not_a_slot_is_free() {
    let mut machine = BenchMachine::start();
    let good = gmii::encode(&machine.plain_read());
    for length in 0..12 {
        let runt = bare(&vec![0xa5; length]);
        for wire in [&runt, &good] {
            machine.inject(wire.clone());
        }
        machine.run_clocks(60_000);
        assert_eq!(machine.datagrams(), 1, "behind a runt of {length} bytes");
        for wire in [&good, &good, &runt, &runt] {
            machine.inject(wire.clone());
        }
        machine.run_clocks(60_000);
        assert_eq!(
            machine.datagrams(),
            2,
            "in front of runts of {length} bytes"
        );
        assert_eq!(answers(&mut machine, good.clone()), 1, "behind them");
    }
}

/// One of many ways to spoil a frame, or several.
fn mutated(mut frame: Vec<u8>, rng: &mut Pcg64Mcg) -> Vec<u8> {
    for _ in 0..rng.random_range(1..=4) {
        let at = rng
            .random_range(0..frame.len().max(1))
            .min(frame.len().saturating_sub(1));
        match rng.random_range(0..8) {
            0 if !frame.is_empty() => frame[at] ^= 1 << rng.random_range(0..8),
            1 if !frame.is_empty() => frame[at] = rng.random(),
            2 => frame.truncate(at),
            3 => frame.extend(std::iter::repeat_n(
                rng.random::<u8>(),
                rng.random_range(1..200),
            )),
            // The headers, which decide: a length, a flag, a type.
            4 if frame.len() > 43 => {
                let at = *[12, 13, 14, 16, 17, 20, 21, 23, 36, 37, 38, 39]
                    .choose(rng)
                    .unwrap_or(&12);
                frame[at] = rng.random();
            }
            5 if frame.len() > 20 => {
                let tag = [0x81, 0, rng.random(), rng.random()];
                frame.splice(12..12, tag);
            }
            6 if frame.len() > 60 => {
                let part: Vec<u8> = frame[at / 2..at].to_vec();
                frame.splice(at..at, part);
            }
            _ => frame = sealed(frame),
        }
    }
    frame.truncate(9018);
    if rng.random_bool(0.5) {
        sealed(frame)
    } else {
        frame
    }
}

#[test]
fn thousands_of_mutated_frames_arm_nothing_write_nothing_and_are_all_counted() {
    let given = std::env::var("FERROCNC_FRAMES")
        .ok()
        .and_then(|text| text.parse().ok());
    let total = given.unwrap_or(FRAMES);
    let seed = seed();
    let mut rng = Pcg64Mcg::seed_from_u64(seed);
    let mut machine = BenchMachine::start();
    let registers = machine.registers();
    // What is known to be right, and would do something if it were from the owner: reads, a write,
    // an exchange, ARP, ping, TCP.
    let command = machine.enabled_command();
    let command = machine.command_bytes(&command);
    let mut originals = vec![machine.plain_read()];
    for payload in [
        read_of((0..40).map(|n| map::STATUS + 4 * n)),
        ferrocnc_tests::hex("4e6f1044 00000000 000f0100 00020000 00000001"),
        ferrocnc_tests::hex("4e6f1144 00000000 00000000"),
        command,
    ] {
        originals.push(machine.datagram_frame(&payload));
    }
    for kind in &KINDS[..KINDS.len() - 1] {
        if !matches!(kind, Kind::Jumbo | Kind::BadFcs | Kind::Runt) {
            let wire = machine.frame(*kind, &mut rng);
            originals.push(wire[8..wire.len() - 4].to_vec());
        }
    }
    let (before, sent) = (machine.mail(), machine.sent());
    for n in 0..total {
        let original = originals.choose(&mut rng).cloned().unwrap_or_default();
        let mut wire = bare(&mutated(original, &mut rng));
        match rng.random_range(0..20) {
            0 => {
                let at = rng.random_range(8..wire.len());
                wire[at] ^= 1 << rng.random_range(0..8);
            }
            1 => wire[rng.random_range(0..8)] ^= 0x10,
            _ => {}
        }
        // A frame right after it, or later.
        machine.inject(wire);
        if rng.random_bool(0.7) {
            machine.run_clocks(rng.random_range(0..2 * PACE));
        }
        if n % BATCH == BATCH - 1 {
            // Four of the longest reads may still be in the slots, a fifth in work.
            machine.run_clocks(700_000);
            assert!(!machine.gate_open(), "seed {seed}, frame {n}: armed");
            assert_eq!(
                machine.registers(),
                registers,
                "seed {seed}, up to frame {n}"
            );
        }
    }
    machine.run_clocks(400_000);
    let after = machine.mail().since(&before);
    println!("{total} frames: {after:?}");
    let sent = machine.sent() - sent;
    assert!(
        after.accounts_for(sent),
        "seed {seed}: {sent} frames, {after:?}"
    );
}

#[test]
fn a_preamble_is_seven_bytes_and_a_delimiter() {
    let mut machine = BenchMachine::start();
    let good = machine.plain_read();
    let whole = gmii::encode(&good);
    let fcs = crc32(&good).to_le_bytes();
    assert!(whole.ends_with(&fcs));
    for (what, preamble) in [
        ("none", &[][..]),
        ("a delimiter alone", &[0xd5]),
        ("no delimiter", &[0x55; 8]),
        ("noise", &[0x12, 0x34, 0x56, 0x78]),
    ] {
        let wire = [preamble, &whole[8..]].concat();
        assert_eq!(answers(&mut machine, wire), 0, "{what}");
        assert_eq!(
            answers(&mut machine, whole.clone()),
            1,
            "and the frame behind it"
        );
    }
}

const SYN: u8 = 2;
const RST: u8 = 4;
const PSH: u8 = 8;
const ACK: u8 = 16;

/// What the console says when it waits for a line.
const PROMPT: &str = "ferrocnc> ";
/// Looks of 2 ms for the end of an answer: 200 ms, more than ten turns of services that rest.
const PATIENCE: usize = 100;

/// A visitor of the console, segment by segment: its next number, and the board's.
struct Visitor<'m> {
    machine: &'m mut BenchMachine,
    seq: u32,
    ack: u32,
}

impl Visitor<'_> {
    const PORT: u16 = 4000;

    fn frame(&mut self, flags: u8, seq: u32, ack: u32, data: &[u8]) -> Vec<u8> {
        let segment = tcp_segment(Self::PORT, flags, seq, ack, data);
        self.machine.ip(INTRUDER_IP, 6, 0, &segment)
    }

    /// Sends a frame as it is; flags, number, acknowledgement and data of what comes back soon.
    fn hears(&mut self, frame: &[u8]) -> Vec<(u8, u32, u32, Vec<u8>)> {
        self.machine.rig().take_frames();
        self.machine.inject(gmii::encode(frame));
        self.listens()
    }

    /// The same of what comes in the next 2 ms.
    fn listens(&mut self) -> Vec<(u8, u32, u32, Vec<u8>)> {
        self.machine.run_clocks(120_000);
        let word =
            |frame: &[u8], at: usize| u32::from_be_bytes(frame[at..at + 4].try_into().unwrap());
        let sent = self.machine.rig().take_frames().into_iter();
        let to_us = |frame: &Vec<u8>| {
            frame[12..14] == [8, 0] && frame[23] == 6 && frame[30..34] == INTRUDER_IP.octets()
        };
        sent.filter(to_us)
            .map(|frame| {
                let end = IP + usize::from(u16::from_be_bytes([frame[16], frame[17]]));
                (
                    frame[47],
                    word(&frame, 38),
                    word(&frame, 42),
                    frame[54..end].to_vec(),
                )
            })
            .collect()
    }

    /// Comes in.
    fn enters(machine: &mut BenchMachine) -> Visitor<'_> {
        machine.rig().capture_frames();
        let mut visitor = Visitor {
            machine,
            seq: 0x1234_5678,
            ack: 0,
        };
        let knock = visitor.frame(SYN, visitor.seq, 0, b"");
        // The services have begun a moment ago: their first answers come from a cold cache.
        let mut welcome = visitor.hears(&knock);
        welcome.extend(visitor.listens());
        assert_eq!((welcome[0].0, welcome[0].2), (SYN | ACK, 0x1234_5679));
        visitor.seq += 1;
        visitor.ack = welcome[0].1 + 1;
        assert_eq!(visitor.says(b"", PROMPT), PROMPT);
        visitor
    }

    /// Says something as it should be said; the answer up to this end, which is acknowledged.
    fn says(&mut self, text: &[u8], end: &str) -> String {
        let frame = self.frame(PSH | ACK, self.seq, self.ack, text);
        let mut heard = self.hears(&frame);
        self.seq += text.len() as u32;
        let mut answer = Vec::new();
        for _ in 0..PATIENCE {
            for (_, seq, ack, data) in &heard {
                if (*seq, *ack) == (self.ack, self.seq) {
                    answer.extend(data);
                    self.ack += data.len() as u32;
                }
            }
            let spoken = heard.iter().any(|(_, _, _, data)| !data.is_empty());
            if !spoken && answer.ends_with(end.as_bytes()) {
                break;
            }
            // The services have other things to do, too: a part of an answer may take a few turns.
            heard = if spoken {
                let frame = self.frame(ACK, self.seq, self.ack, b"");
                self.hears(&frame)
            } else {
                self.listens()
            };
        }
        String::from_utf8(answer).expect("text")
    }
}

#[test]
fn forged_segments_do_not_harm_a_console_session_and_its_keepalives_are_answered() {
    let mut machine = BenchMachine::boot(wired::mill());
    let mut visitor = Visitor::enters(&mut machine);
    let (seq, ack) = (visitor.seq, visitor.ack);
    let keepalive = visitor.frame(ACK, seq - 1, ack, b"");
    assert_eq!(visitor.hears(&keepalive), [(ACK, ack, seq, Vec::new())]);
    let quit = visitor.frame(PSH | ACK, seq, ack, b"quit\n");
    let forged = [
        ("a reset one off", visitor.frame(RST, seq + 1, 0, b"")),
        (
            "a reset far off",
            visitor.frame(RST | ACK, seq - 50_000, ack, b""),
        ),
        ("another SYN", visitor.frame(SYN, seq + 77, 0, b"")),
        (
            "an ACK of what was never sent",
            visitor.frame(PSH | ACK, seq, ack + 1, b"quit\n"),
        ),
        ("no ACK", visitor.frame(PSH, seq, ack, b"quit\n")),
        (
            "data far off",
            visitor.frame(PSH | ACK, seq + 5_000, ack, b"quit\n"),
        ),
        ("a wrong TCP checksum", with(&quit, 50, &[!quit[50]])),
        ("a wrong IP checksum", with(&quit, 24, &[!quit[24]])),
        ("a first fragment", sealed(with(&quit, 20, &[0x20, 0]))),
        ("a last fragment", sealed(with(&quit, 20, &[0, 1]))),
        ("a header of 60 bytes", with(&quit, 46, &[0xf0])),
    ];
    for (what, frame) in forged {
        for (flags, from, expected, data) in visitor.hears(&frame) {
            assert_eq!(
                (flags, from, expected, data.len()),
                (ACK, ack, seq, 0),
                "{what}"
            );
        }
    }
    let link = visitor.says(b"link\n", PROMPT);
    assert!(link.starts_with("link "), "{link}");
    let quit = visitor.says(b"quit\n", "\n");
    assert!(quit.starts_with("bye"), "{quit}");
}
