//! Etherbone datagrams: the golden vectors of LiteX, what a compatible server must decide on, and
//! malformed ones.

use ferrocnc_tests::{BenchMachine, hex, seed};
use rand::{Rng, RngCore, SeedableRng};
use rand_pcg::Pcg32;
use wire::exchange::Command;
use wire::regmap::timebase;
use wire::{Refusal, map, regmap};

#[test]
fn a_probe_is_answered_with_its_payload() {
    let mut machine = BenchMachine::start();
    let reply = machine.ask(&hex("4e6f1144 00000000 12345678"));
    assert_eq!(reply, Some(hex("4e6f1244 00000000 12345678")));
    assert_eq!(
        machine.ask(&hex("4e6f1144 00000000")),
        None,
        "a bare probe header has nothing to echo"
    );
}

#[test]
fn two_words_are_read_and_the_return_address_comes_back() {
    let mut machine = BenchMachine::start();
    let words = [machine.read(0x100), machine.read(0x104)];
    let reply = machine
        .ask(&hex(
            "4e6f1044 00000000 000f0002 deadbeef 00000100 00000104",
        ))
        .expect("a reply");
    assert_eq!(reply[..16], hex("4e6f1044 00000000 000f0200 deadbeef")[..]);
    assert_eq!(
        reply[16..],
        [words[0].to_be_bytes(), words[1].to_be_bytes()].concat()
    );
    assert_eq!(
        words[0],
        wire::board::MAGIC,
        "the board blob begins at 0x100"
    );
}

/// `ferrocnc selftest` measures the board's clock by these two words, without a session.
#[test]
fn the_stamp_read_through_the_service_window_is_that_of_the_frame_that_asks() {
    let mut machine = BenchMachine::start();
    let [lo, hi] = [timebase::ARRIVAL_LO, timebase::ARRIVAL_HI]
        .map(|word| regmap::address(timebase::BASE, word));
    for pause in [0, 777, 60_000] {
        machine.run_clocks(pause);
        let before = machine.clock();
        let reply = machine.ask_words(&[0x4e6f_1044, 0, 0x000f_0002, 7, lo, hi]);
        let after = machine.clock();
        let reply = reply.expect("an answer");
        let stamp = u64::from(reply[5]) << 32 | u64::from(reply[4]);
        // The wall clock begins with the end of the reset, some clocks after the simulation.
        assert!(
            (before - 64..after).contains(&stamp),
            "{before} {stamp} {after}"
        );
    }
}

#[test]
fn a_write_to_the_description_changes_nothing_and_is_not_answered() {
    let mut machine = BenchMachine::start();
    let before = machine.registers();
    assert_eq!(
        machine.ask(&hex(
            "4e6f1044 00000000 000f0200 00000020 11223344 55667788"
        )),
        None
    );
    assert_eq!(machine.registers(), before);
    assert_eq!(machine.refusals(Refusal::ReadOnly), 1);
}

#[test]
fn no_reads_means_no_answer() {
    let mut machine = BenchMachine::start();
    assert_eq!(
        machine.ask(&hex("4e6f1444 00000000 000f0001 00000077 00000100")),
        None
    );
    assert_eq!(
        machine.read(0x100),
        wire::board::MAGIC,
        "and the board goes on"
    );
}

#[test]
fn an_empty_record_is_harmless() {
    let mut machine = BenchMachine::start();
    let before = machine.registers();
    assert_eq!(
        machine.ask(&hex("4e6f1044 00000000 000f0000 00000000")),
        None
    );
    assert_eq!(machine.registers(), before);
}

#[test]
fn the_reply_goes_to_the_senders_port() {
    let mut machine = BenchMachine::start();
    for port in [1234, 2, 65535, 40_000] {
        let reply = machine.ask_from(port, &hex("4e6f1044 00000000 000f0001 00000007 00000000"));
        assert_eq!(
            reply.expect("a reply")[16..],
            wire::describe::MAGIC.to_be_bytes(),
            "port {port}"
        );
    }
}

/// What is wrong, the datagram, and the reason it is refused for.
const MALFORMED: &[(&str, &str, Refusal)] = &[
    (
        "wrong magic",
        "4e6e1044 00000000 000f0001 00000000 00000100",
        Refusal::Magic,
    ),
    (
        "wrong version",
        "4e6f2044 00000000 000f0001 00000000 00000100",
        Refusal::Version,
    ),
    (
        "wrong widths",
        "4e6f1011 00000000 000f0001 00000000 00000100",
        Refusal::Width,
    ),
    (
        "a probe's reply",
        "4e6f1244 00000000 00000000",
        Refusal::ProbeReply,
    ),
    (
        "half a word enabled",
        "4e6f1044 00000000 00030100 00020000 00000001",
        Refusal::ByteEnable,
    ),
    (
        "FIFO access",
        "4e6f1044 00000000 400f0100 00020000 00000001",
        Refusal::RecordFlags,
    ),
    (
        "unaligned read",
        "4e6f1044 00000000 000f0001 00000000 00000101",
        Refusal::Alignment,
    ),
    (
        "unaligned write",
        "4e6f1044 00000000 000f0100 00020002 00000001",
        Refusal::Alignment,
    ),
    (
        "unmapped read",
        "4e6f1044 00000000 000f0001 00000000 40000000",
        Refusal::Unmapped,
    ),
    (
        "unmapped write",
        "4e6f1044 00000000 000f0100 40000000 00000001",
        Refusal::Unmapped,
    ),
    (
        "truncated write",
        "4e6f1044 00000000 000f0200 00020000 00000001",
        Refusal::Truncated,
    ),
    (
        "truncated read",
        "4e6f1044 00000000 000f0002 00000000 00000100",
        Refusal::Truncated,
    ),
    (
        "read of 255 in a short datagram",
        "4e6f1044 00000000 000f00ff 00000000 00000100",
        Refusal::Truncated,
    ),
    (
        "padded write",
        "4e6f1044 00000000 000f0100 00020000 00000001 00000000",
        Refusal::Padded,
    ),
    (
        "padded read",
        "4e6f1044 00000000 000f0001 00000000 00000100 00000000",
        Refusal::Padded,
    ),
    (
        "second record bad",
        "4e6f1044 00000000 000f0100 00020000 00000001 000f0300 00020004 00000002",
        Refusal::Truncated,
    ),
    (
        "ragged",
        "4e6f1044 00000000 000f0001 00000000 000001",
        Refusal::Ragged,
    ),
    ("header only", "4e6f1044 00000000", Refusal::Short),
    ("half a header", "4e6f1044", Refusal::Short),
    (
        "write without a session",
        "4e6f1044 00000000 000f0100 00020000 00000001",
        Refusal::NotOwner,
    ),
    (
        "command of another board",
        "4e6f1044 00000000 000f0100 00030000 00000001",
        Refusal::BlockLength,
    ),
];

#[test]
fn every_malformed_datagram_is_refused_for_its_own_reason_and_changes_nothing() {
    let mut machine = BenchMachine::start();
    let before = machine.registers();
    for (name, datagram, reason) in MALFORMED {
        let counted = machine.refusals(*reason);
        assert_eq!(
            machine.ask(&hex(datagram)),
            None,
            "{name}: must not be answered"
        );
        assert_eq!(
            machine.refusals(*reason),
            counted + 1,
            "{name}: must be counted as {}",
            reason.key()
        );
    }
    assert_eq!(machine.registers(), before, "no register may have changed");
}

#[test]
fn an_empty_datagram_and_one_longer_than_a_frame_carries_are_dropped() {
    let mut machine = BenchMachine::start();
    let before = machine.registers();
    assert_eq!(machine.ask(&[]), None);
    let mut longest = hex("4e6f1044 00000000");
    longest.resize(wire::MAX_PAYLOAD, 0);
    assert_eq!(machine.ask(&longest), None);
    longest.resize(wire::MAX_PAYLOAD + 128, 0);
    assert_eq!(machine.ask(&longest), None, "a jumbo frame");
    assert_eq!(machine.registers(), before);
}

#[test]
fn writes_and_reads_share_a_record_and_records_share_a_datagram() {
    let mut machine = BenchMachine::start();
    machine.acquire();
    let steplen = map::CONFIG_STEPGEN;
    let request = [
        0x4e6f_1044,
        0,
        0x000f_0101,
        steplen,
        77,
        0xaaaa,
        steplen,
        0x000f_0001,
        0xbbbb,
        0x0,
    ];
    let reply = machine.ask_words(&request).expect("a reply");
    let expected = [
        0x4e6f_1044,
        0,
        0x000f_0100,
        0xaaaa,
        77,
        0x000f_0100,
        0xbbbb,
        wire::describe::MAGIC,
    ];
    assert_eq!(reply, expected, "the record reads what it has just written");
}

#[test]
fn a_long_read_is_answered_whole_and_the_board_goes_on() {
    let mut machine = BenchMachine::start();
    let addresses: Vec<u32> = (0..255).map(|i| map::DESCRIBE + 4 * (i % 64)).collect();
    let mut request = vec![0x4e6f_1044, 0, 0x000f_00ff, 9];
    request.extend(addresses);
    let reply = machine.ask_words(&request).expect("a reply");
    assert_eq!((reply.len(), reply[2], reply[3]), (4 + 255, 0x000f_ff00, 9));
    assert_eq!(reply[4], wire::describe::MAGIC);
}

#[test]
fn back_to_back_datagrams_are_both_answered() {
    let mut machine = BenchMachine::start();
    let request = hex("4e6f1044 00000000 000f0001 00000001 00000000");
    assert_eq!(
        machine.ask_back_to_back(&[request.clone(), request]).len(),
        2
    );
}

#[test]
fn ten_thousand_random_datagrams_later_a_normal_exchange_still_works() {
    let mut machine = BenchMachine::start();
    let seed = seed();
    let mut random = Pcg32::seed_from_u64(seed);
    let before = machine.registers();
    for _ in 0..10_000 {
        let mut datagram = match random.random_range(0..4) {
            // Random bytes, random bytes after a good header, and good datagrams with a few bits or
            // their end knocked off.
            0 => vec![0; random.random_range(0..64)],
            1 => [
                hex("4e6f1044 00000000"),
                vec![0; random.random_range(0..64)],
            ]
            .concat(),
            2 => hex("4e6f1044 00000000 000f0101 00020000 00000001 00000000 00000100"),
            _ => machine.command_bytes(&Command {
                token: random.next_u32(),
                ..Command::default()
            }),
        };
        let noise_from = if datagram.len() > 8 { 8 } else { 0 };
        if datagram[noise_from..].iter().all(|byte| *byte == 0) {
            random.fill_bytes(&mut datagram[noise_from..]);
        } else {
            for _ in 0..random.random_range(1..4) {
                let bit = random.random_range(0..datagram.len() * 8);
                datagram[bit / 8] ^= 1 << (bit % 8);
            }
            let length = random.random_range(0..=datagram.len());
            datagram.truncate(length);
        }
        machine.tell_from(random.random_range(1024..u16::MAX), &datagram);
    }
    assert_eq!(
        machine.registers(),
        before,
        "seed {seed}: a register changed"
    );
    machine.acquire();
    let status = machine.exchange(&mut Command::default());
    assert!(
        status.state.accepted,
        "seed {seed}: the exchange was not executed"
    );
}
