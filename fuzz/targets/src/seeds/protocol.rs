//! Etherbone, the exchange, discovery, DHCP and the description.

use super::{SIX, Seed, message, settings};
use crate::byte_reader::bytes;
use sim::board_facts::BoardFacts;
use wire::describe::{Describe, JobsState};
use wire::discovery::{Body, Here};
use wire::exchange::{Command, REQUEST_OVERHEAD, StateWord};
use wire::flash::{OpResult, Origin, Running};
use wire::{FaultReason, GateClose, LinkSpeed, Name, ResetReason, State, etherbone, map};

fn state() -> StateWord {
    StateWord {
        state: State::Armed,
        reason: FaultReason::None,
        position_trusted: true,
        enabled: true,
        session_yours: true,
        bitten: false,
        external_reset: false,
        accepted: true,
        link: true,
        estop: false,
        speed: LinkSpeed::M1000,
        services: JobsState::None,
        link_errors: 0,
    }
}

fn command() -> Vec<u32> {
    let mut buffer = [0; REQUEST_OVERHEAD + wire::exchange::COMMAND_MAX];
    let command = Command {
        token: 0x1234_5678,
        sequence: 7,
        enable: true,
        enable_request: true,
        stepgen_enable: 0x3f,
        ..Command::default()
    };
    command
        .emit_request(SIX, &mut buffer)
        .unwrap_or(&[])
        .to_vec()
}

fn status() -> Vec<u32> {
    let mut words = vec![0; wire::exchange::status_words(SIX)];
    words[0] = state().to_word();
    words[1] = 7;
    words
}

/// LiteX's golden vectors, then ours.
pub(super) fn etherbone_seeds() -> Vec<Seed> {
    let [h, probe] = [etherbone::HEADER, etherbone::HEADER_PROBE];
    let all: [(&str, Vec<u32>); 9] = [
        ("probe", vec![probe, 0, 0]),
        (
            "read_two",
            vec![h, 0, 0x000f_0002, 0xdead_beef, 0x100, 0x104],
        ),
        (
            "write_two",
            vec![h, 0, 0x000f_0200, 0x20, 0x1122_3344, 0x5566_7788],
        ),
        (
            "write_and_read_then_read",
            vec![
                h,
                0,
                0x000f_0101,
                0x20,
                7,
                0xaa,
                0x100,
                0x000f_0001,
                0xbb,
                0x104,
            ],
        ),
        ("no_reads", vec![h | 0x400, 0, 0x000f_0001, 0, 0x100]),
        ("acquire", vec![h, 0, 0x000f_0100, map::SESSION_ACQUIRE, 7]),
        ("exchange", command()),
        ("write_cut_short", vec![h, 0, 0x000f_0200, 0x20, 1]),
        ("padded", vec![h, 0, 0x000f_0100, 0x20, 1, 0]),
    ];
    let mut seeds: Vec<Seed> = all
        .into_iter()
        .map(|(name, words)| ("etherbone", name, bytes(&words)))
        .collect();
    seeds.push(("etherbone", "ragged", bytes(&[h, 0])[..7].to_vec()));
    seeds
}

pub(super) fn exchange_seeds() -> Vec<Seed> {
    let input = |mode: u8, words: &[u32]| {
        let mut input = vec![6, 6, 6, 12, 12, mode];
        input.extend(bytes(&[6, 7]));
        input.extend(bytes(words));
        input
    };
    let mut reply = vec![
        etherbone::HEADER,
        0,
        0x000f_0000 | (status().len() as u32) << 8,
        7,
    ];
    reply.extend(status());
    vec![
        (
            "exchange",
            "command_of_six_axes",
            input(1, &command()[REQUEST_OVERHEAD..]),
        ),
        ("exchange", "status_of_six_axes", input(2, &status())),
        ("exchange", "answer_to_six_axes", input(0, &reply)),
    ]
}

pub(super) fn discovery_seeds() -> Vec<Seed> {
    let here = Here {
        mac: [0x12, 0xe2, 0xd5, 0, 0, 1],
        ip: 0xc0a8_0232,
        port: 1234,
        dhcp: false,
        armed: false,
        owned: true,
        keyed: false,
        running: Running::A,
        origin: Origin::BuiltIn,
        speed: LinkSpeed::M1000,
        wire_version: wire::WIRE_VERSION,
        firmware_version: 0x100,
        build_id: 9,
        name: Name::cut("mill"),
        configuration: Name::cut("mill6"),
        platform: Name::cut("5a-75b-8.0"),
    };
    let input = |mode: u8, body| [vec![mode], message(body)].concat();
    vec![
        ("discovery", "discover", input(0, Body::Discover)),
        ("discovery", "here", input(0, Body::Here(here))),
        ("discovery", "set", input(1, Body::Set(settings()))),
        ("discovery", "done", input(0, Body::Done(OpResult::Ok))),
    ]
}

pub(super) fn dhcp_seeds() -> Vec<Seed> {
    // Netmask, router, lease time, server.
    let options = [
        1, 4, 255, 255, 255, 0, 3, 4, 10, 0, 0, 1, 51, 4, 0, 0, 14, 16, 54, 4, 10, 0, 0, 1, 255,
    ];
    let answer = |kind: u8| {
        let mut step = vec![kind << 2 | 2, 10, 0, 0, 99, options.len() as u8];
        step.extend(options);
        step
    };
    let later = |second: u32| [vec![0], second.to_be_bytes().to_vec()].concat();
    let seed = vec![0, 0, 0, 9];
    let lease = [seed.clone(), answer(2), answer(5)].concat();
    vec![
        ("dhcp", "offer_and_ack", lease.clone()),
        (
            "dhcp",
            "lease_renewed",
            [lease.clone(), later(2000), answer(5)].concat(),
        ),
        (
            "dhcp",
            "lease_over",
            [lease.clone(), later(4000), later(4001), answer(2)].concat(),
        ),
        ("dhcp", "nak", [lease, later(2000), answer(6)].concat()),
        (
            "dhcp",
            "no_server",
            [seed, later(4), later(12), later(40)].concat(),
        ),
    ]
}

pub(super) fn describe_seeds() -> Vec<Seed> {
    let describe = Describe {
        wire_version: wire::WIRE_VERSION,
        abi_firmware: 1,
        abi_gateware: 1,
        firmware_version: 0x100,
        gateware_version: 0x100,
        clock_hz: 60_000_000,
        channels: SIX,
        features: 0,
        boot_id: 9,
        blob_words: 100,
        state: state(),
        obstacles: 0,
        reset_reason: ResetReason::PowerUp,
        gate_close: GateClose::Never,
    };
    let words = bytes(&describe.to_words());
    let board = |name| BoardFacts::named(name).map_or(Vec::new(), |facts| facts.blob);
    let input = |mode: u8, blob: &[u8]| [vec![mode], words.clone(), blob.to_vec()].concat();
    // Two lists: names that HAL can bear and names that it cannot.
    let odd = b"s\nx\nx s\nX\nspindle-on step=j1:0\n";
    let mut lists = vec![0; 16];
    lists.extend([9, 0, odd.len() as u8, 0]);
    lists.extend(odd);
    lists.resize(lists.len().next_multiple_of(4), 0);
    vec![
        ("describe", "mill6", input(3, &board("mill6"))),
        ("describe", "mill6_as_it_is", input(0, &board("mill6"))),
        (
            "describe",
            "mill6_with_names_of_lcnc",
            input(7, &board("mill6")),
        ),
        (
            "describe",
            "max_with_names_of_litexcnc",
            input(11, &board("max")),
        ),
        ("describe", "odd_names", input(3, &lists)),
    ]
}
